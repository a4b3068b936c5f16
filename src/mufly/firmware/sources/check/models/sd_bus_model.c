#include "check/models/sd_bus_model.h"

static const sd_bus_model_t *attached;

void sd_bus_model_attach(const sd_bus_model_t *model)
{
    attached = model;
}

bool sd_bus_begin(bool selected, const uint8_t out[], uint8_t in[], int32_t count)
{
    return attached->begin(selected, out, in, count);
}

int32_t sd_bus_poll(void)
{
    return attached->poll();
}

void sd_bus_speed(bool fast)
{
    attached->speed(fast);
}
