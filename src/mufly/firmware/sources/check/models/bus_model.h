/* The devices of onboard/drivers on their buses, as register files with faults. Functions bus_... of this machine. */
#ifndef MUFLY_BUS_MODEL_H
#define MUFLY_BUS_MODEL_H

#include "onboard/drivers/sensors/register_device.h"

typedef struct {
    uint8_t registers[512];
    uint16_t held;          /* a register that takes no value; 0: none */
    int32_t polls;          /* that a transfer takes */
    bool refuses, reports_error, is_silent;
    int32_t stuck_aborts;   /* aborts after which a silent bus works again; 0: never */
    uint32_t busy_until_us; /* does not answer until then: reads give 0xFF (SRF10); measures until then (VL53L1X) */
    int32_t takes_us;       /* time of a measurement (VL53L1X) */
    bool measures;
    uint32_t transfers, aborts, resets;
    /* the transfer under way */
    bool is_open;
    int32_t polls_left, in_count;
    uint8_t *in;
    uint16_t address;
} model_device_t;

typedef struct {
    model_device_t devices[DEVICE_COUNT];
    uint32_t now_us;
    bool barometer_on_spi;
} bus_model_t;

/* The buses of the following calls. */
void bus_model_attach(bus_model_t *buses);

/* Registers of a device after its power-up; data are up to the caller. */
void bus_model_reset(bus_model_t *buses, int32_t device);

#endif
