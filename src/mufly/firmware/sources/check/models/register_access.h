/* Access to registers for drivers of boards/stm32 on this machine: each read and write calls a function of the test. */
#ifndef MUFLY_REGISTER_ACCESS_H
#define MUFLY_REGISTER_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t (*get)(uint32_t address);
    void (*set)(uint32_t address, uint32_t value);
    void (*hold)(bool held);
    const void *memory[16]; /* by number; memory_address returns MODEL_MEMORY + the number */
    int32_t memory_count;
} register_model_t;

#define MODEL_MEMORY 0x20000000U

void register_model_attach(register_model_t *model);

#endif
