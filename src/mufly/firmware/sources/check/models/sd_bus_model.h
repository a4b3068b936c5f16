/* Bus of an SD card for tests: each call goes to a function of the test. */
#ifndef MUFLY_SD_BUS_MODEL_H
#define MUFLY_SD_BUS_MODEL_H

#include "onboard/drivers/sd_card.h"

typedef struct {
    bool (*begin)(bool selected, const uint8_t *out, uint8_t *in, int32_t count); /* NULL as in sd_bus_begin */
    int32_t (*poll)(void);
    void (*speed)(bool fast);
} sd_bus_model_t;

void sd_bus_model_attach(const sd_bus_model_t *model);

#endif
