#include "onboard/drivers/sensors/register_device.h"

#include <stddef.h>

#define US_PER_MS 1000U

void register_device_start(register_device_t *d, int32_t number, const device_program_t *program, uint32_t now_us)
{
    static const register_device_t none;

    *d = none;
    d->number = number;
    d->program = program;
    d->since_us = now_us;
}

void register_device_fail(register_device_t *d, uint32_t fault, uint32_t now_us)
{
    d->faults |= fault;
    d->fault_count++;
    d->is_running = false;
    d->step = 0;
    d->waits = true;
    d->since_us = now_us;
    d->pause_us = DEVICE_PAUSE_US;
}

void register_device_repeat(register_device_t *d, uint32_t pause_us, uint32_t now_us)
{
    d->step = (d->step > d->program->loop_from) ? (d->step - 1) : (d->program->count - 1);
    d->waits = true;
    d->since_us = now_us;
    d->pause_us = pause_us;
}

int32_t read_big_endian(const uint8_t bytes[2])
{
    const int32_t number = ((int32_t)bytes[0] * 256) + (int32_t)bytes[1];

    return (number < 32768) ? number : (number - 65536);
}

static void advance(register_device_t *d)
{
    d->step = ((d->step + 1) < d->program->count) ? (d->step + 1) : d->program->loop_from;
}

static void begin_step(register_device_t *d, uint32_t now_us)
{
    const device_step_t *s = &d->program->steps[d->step];
    bool begun = false;

    d->since_us = now_us;
    if (s->kind == (uint8_t)STEP_WAIT) {
        d->waits = true;
        d->pause_us = US_PER_MS * s->value;
        advance(d);
    } else {
        const int32_t count = d->program->address_bytes;

        d->out[0] = (uint8_t)(s->address >> 8U);
        d->out[count - 1] = (uint8_t)(s->address & 0xFFU);
        if (s->kind == (uint8_t)STEP_WRITE) {
            d->out[count] = s->value;
            begun = bus_begin(d->number, d->out, count + 1, NULL, 0);
        } else {
            d->out[0] |= d->program->read_flag;
            begun = bus_begin(d->number, d->out, count, d->data, (s->kind == (uint8_t)STEP_READ) ? (int32_t)s->value : 1);
        }
        d->is_running = begun;
        if (!begun) {
            register_device_fail(d, DEVICE_REFUSES, now_us);
        }
    }
}

/* Conclude the present step, whose transfer is over; return whether it brought data. */
static bool conclude_step(register_device_t *d, uint32_t now_us)
{
    const device_step_t *s = &d->program->steps[d->step];
    const bool fits = d->data[0] == s->value;
    bool brought = false;

    d->is_running = false;
    if ((s->kind == (uint8_t)STEP_IDENTITY) && !fits) {
        register_device_fail(d, DEVICE_UNKNOWN, now_us);
    } else if ((s->kind == (uint8_t)STEP_SETTING) && !fits) {
        register_device_fail(d, DEVICE_FORGETS, now_us);
    } else {
        brought = s->kind == (uint8_t)STEP_READ;
        d->read_from = brought ? (int32_t)s->address : d->read_from;
        advance(d);
    }
    return brought;
}

bool register_device_step(register_device_t *d, uint32_t now_us)
{
    bool brought = false;

    if (d->is_running) {
        const int32_t now = bus_poll(d->number);

        if (now == (int32_t)BUS_DONE) {
            brought = conclude_step(d, now_us);
        } else if (now == (int32_t)BUS_ERROR) {
            register_device_fail(d, DEVICE_REFUSES, now_us);
        } else if ((now_us - d->since_us) > DEVICE_TIMEOUT_US) {
            bus_abort(d->number);
            register_device_fail(d, DEVICE_SILENT, now_us);
        } else {
            /* under way */
        }
    }
    if (d->waits && ((now_us - d->since_us) >= d->pause_us)) {
        d->waits = false;
    }
    /* New data are read by the driver before another transfer may write there. */
    if (!d->is_running && !d->waits && !brought) {
        begin_step(d, now_us);
    }
    return brought;
}
