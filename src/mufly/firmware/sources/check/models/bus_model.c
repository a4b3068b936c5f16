#include "check/models/bus_model.h"

#include <stddef.h>

#define SRF10_TIME_US 24000U

static bus_model_t *model;

void bus_model_attach(bus_model_t *buses)
{
    model = buses;
}

void bus_model_reset(bus_model_t *buses, int32_t device)
{
    model_device_t *d = &buses->devices[device];

    d->resets++;
    if (device == (int32_t)DEVICE_IMU) {
        for (int32_t i = 0x4E; i <= 0x52; i++) {
            d->registers[i] = 0U;
        }
        d->registers[0x75] = 0x47U;
    } else if (device == (int32_t)DEVICE_BAROMETER) {
        d->registers[0xF4] = 0U;
        d->registers[0xD0] = 0x58U;
    } else if (device == (int32_t)DEVICE_LASER) {
        for (int32_t i = 0x2D; i <= 0x88; i++) {
            d->registers[i] = 0U;
        }
        d->registers[0x31] = 2U;
        d->registers[0x10F] = 0xEAU;
        d->registers[0x110] = 0xCCU;
        d->measures = false;
    } else {
        d->registers[0] = 6U;
        d->registers[1] = 0x80U;
    }
}

static bool is_spi(int32_t device)
{
    return (device == (int32_t)DEVICE_IMU) || ((device == (int32_t)DEVICE_BAROMETER) && model->barometer_on_spi);
}

/* The laser's measurement is over once its time is, if its clear of the interrupt went before. */
static void finish_measurement(model_device_t *d)
{
    if (d->measures && ((int32_t)(model->now_us - d->busy_until_us) >= 0)) {
        d->measures = false;
        d->registers[0x31] = (uint8_t)(2U | (uint8_t)((d->registers[0x30] & 0x10U) == 0U));
    }
}

/* A written register takes effect. */
static void write_register(int32_t device, uint16_t address, uint8_t value)
{
    model_device_t *d = &model->devices[device];
    uint16_t at = address;

    if (is_spi(device) && (device == (int32_t)DEVICE_BAROMETER)) {
        at |= 0x80U; /* the upper bit says read or write; all its registers have it set */
    }
    if ((device == (int32_t)DEVICE_IMU) && (at == 0x11U) && (value == 0x01U)) {
        bus_model_reset(model, device);
    } else if ((device == (int32_t)DEVICE_BAROMETER) && (at == 0xE0U) && (value == 0xB6U)) {
        bus_model_reset(model, device);
    } else if ((device == (int32_t)DEVICE_LASER) && (at == 0U) && (value == 0U)) {
        bus_model_reset(model, device);
    } else if ((device == (int32_t)DEVICE_LASER) && (at == 0x86U) && (value == 1U)) {
        d->registers[0x31] = 2U;
    } else if ((device == (int32_t)DEVICE_LASER) && (at == 0x87U) && (value == 0x10U) && (d->registers[0x85] == 1U)) {
        d->measures = true;
        d->busy_until_us = model->now_us + (uint32_t)d->takes_us;
    } else if (device == (int32_t)DEVICE_SONAR) {
        if ((at == 0U) && (value == 0x52U)) {
            d->busy_until_us = model->now_us + SRF10_TIME_US;
        }
        /* its registers read something else than was written */
    } else if ((d->held == 0U) || (d->held != at)) {
        d->registers[at] = value;
    } else {
        /* held */
    }
}

bool bus_begin(int32_t device, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count)
{
    model_device_t *d = &model->devices[device];
    const bool works = !d->refuses && !d->is_open;

    if (works) {
        const bool silent = d->is_silent;

        d->transfers++;
        d->is_open = true;
        d->polls_left = d->polls;
        d->in = in;
        d->in_count = in_count;
        if (device == (int32_t)DEVICE_LASER) {
            d->address = (uint16_t)((out[0] * 256U) + out[1]);
            finish_measurement(d);
        } else {
            d->address = is_spi(device) && (in_count > 0) && (device == (int32_t)DEVICE_IMU) ? (uint8_t)(out[0] & 0x7FU) : out[0];
        }
        if ((in_count == 0) && !silent && !d->reports_error) {
            write_register(device, d->address, out[out_count - 1]);
        }
    }
    return works;
}

int32_t bus_poll(int32_t device)
{
    model_device_t *d = &model->devices[device];
    int32_t answer = (int32_t)BUS_DONE;

    if (!d->is_open) {
        answer = (int32_t)BUS_ERROR;
    } else if (d->is_silent || (d->polls_left > 0)) {
        d->polls_left--;
        answer = (int32_t)BUS_BUSY;
    } else {
        const uint32_t busy_us = d->busy_until_us - model->now_us;
        const bool deaf = (device == (int32_t)DEVICE_SONAR) && (busy_us > 0U) && (busy_us <= SRF10_TIME_US);

        for (int32_t i = 0; i < d->in_count; i++) {
            d->in[i] = deaf ? 0xFFU : d->registers[(d->address + i) & ((device == (int32_t)DEVICE_LASER) ? 0x1FF : 0xFF)];
        }
        d->is_open = false;
        answer = d->reports_error ? (int32_t)BUS_ERROR : (int32_t)BUS_DONE;
    }
    return answer;
}

void bus_abort(int32_t device)
{
    model_device_t *d = &model->devices[device];

    d->aborts++;
    d->is_open = false;
    if ((d->stuck_aborts > 0) && (d->aborts >= (uint32_t)d->stuck_aborts)) {
        d->is_silent = false;
    }
}
