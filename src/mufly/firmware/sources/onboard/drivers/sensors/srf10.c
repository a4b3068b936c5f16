#include "onboard/drivers/sensors/srf10.h"

#define COMMAND 0x00U
#define UNUSED 0x01U      /* reads 0x80 */
#define GAIN 0x01U        /* written */
#define RANGE 0x02U       /* written: (value + 1) * 43 mm; read: answer, two bytes */
#define IDENTITY 0x80U
#define GAIN_INDOORS 0x08U
#define RANGE_3_M 0x45U
#define IN_MICROSECONDS 0x52U
#define STILL_RANGING 0xFFFF /* the bus rests high: the device does not answer while it listens */
#define HALF_SOUND_SPEED REAL(1.717e-4) /* m/us at 20 degrees */
#define LEAST_M REAL(0.03)
#define MOST_M REAL(3.1)

static const device_step_t steps[] = {
    {STEP_IDENTITY, UNUSED, IDENTITY}, {STEP_WRITE, GAIN, GAIN_INDOORS}, {STEP_WRITE, RANGE, RANGE_3_M},
    {STEP_WRITE, COMMAND, IN_MICROSECONDS}, {STEP_WAIT, 0, 25}, {STEP_READ, RANGE, 2},
};
static const device_program_t program = {steps, 6, 3, 0x00U, 1};

void srf10_start(srf10_t *s, uint32_t now_us)
{
    static const srf10_t none;

    *s = none;
    register_device_start(&s->device, (int32_t)DEVICE_SONAR, &program, now_us);
}

bool srf10_step(srf10_t *s, uint32_t now_us)
{
    bool fresh = register_device_step(&s->device, now_us);

    if (fresh) {
        const int32_t echo_us = ((int32_t)s->device.data[0] * 256) + (int32_t)s->device.data[1];

        s->range = HALF_SOUND_SPEED * (real_t)echo_us;
        s->has_echo = (s->range >= LEAST_M) && (s->range <= MOST_M);
        if ((echo_us == STILL_RANGING) || ((echo_us != 0) && (s->range > (REAL(2.0) * MOST_M)))) {
            fresh = false;
            register_device_fail(&s->device, DEVICE_IMPLAUSIBLE, now_us);
        } else {
            s->device.faults = 0U;
        }
    }
    return fresh;
}
