#include "check/models/register_access.h"

#include "boards/stm32/registers.h"

static register_model_t *attached;

void register_model_attach(register_model_t *model)
{
    attached = model;
}

uint32_t register_get(uint32_t address)
{
    return attached->get(address);
}

void register_set(uint32_t address, uint32_t value)
{
    attached->set(address, value);
}

void interrupts_hold(bool held)
{
    attached->hold(held);
}

uint32_t memory_address(const void *memory)
{
    int32_t number = 0;

    while ((number < attached->memory_count) && (attached->memory[number] != memory)) {
        number++;
    }
    if ((number == attached->memory_count) && (number < 16)) {
        attached->memory[number] = memory;
        attached->memory_count++;
    }
    return MODEL_MEMORY + (uint32_t)number;
}
