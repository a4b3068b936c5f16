#include "onboard/drivers/sensors/bmp280.h"

#define CALIBRATION 0x88U
#define CALIBRATION_BYTES 24
#define ID 0xD0U
#define RESET 0xE0U
#define CTRL_MEAS 0xF4U
#define CONFIG 0xF5U
#define PRESS_MSB 0xF7U
#define IDENTITY 0x58U
#define RESET_WORD 0xB6U
#define FORCED_X2_X16 0x55U /* osrs_t 2, osrs_p 5, mode 1: one measurement, then sleep */
#define NO_FILTER 0x00U
#define NO_MEASUREMENT 0x80000
#define SPI_WRITE_MASK 0x7FU
#define LEAST_PA REAL(30000.0) /* of the sensor */
#define MOST_PA REAL(110000.0)

/* On I2C and, without the upper bit of the written addresses, on SPI. Each measurement takes 43.2 ms at most. */
#define STEPS(mask)                                                                                                        \
    {                                                                                                                      \
        {STEP_WRITE, RESET & (mask), RESET_WORD}, {STEP_WAIT, 0, 3}, {STEP_IDENTITY, ID, IDENTITY},                        \
            {STEP_READ, CALIBRATION, CALIBRATION_BYTES}, {STEP_WRITE, CONFIG & (mask), NO_FILTER},                         \
            {STEP_WRITE, CTRL_MEAS & (mask), FORCED_X2_X16}, {STEP_WAIT, 0, 44}, {STEP_READ, PRESS_MSB, 6},                \
    }
static const device_step_t steps_i2c[] = STEPS(0xFFU);
static const device_step_t steps_spi[] = STEPS(SPI_WRITE_MASK);
static const device_program_t program_i2c = {steps_i2c, 8, 5, 0x00U, 1};
static const device_program_t program_spi = {steps_spi, 8, 5, 0x80U, 1};

void bmp280_start(bmp280_t *b, bool on_spi, uint32_t now_us)
{
    static const bmp280_t none;

    *b = none;
    register_device_start(&b->device, (int32_t)DEVICE_BAROMETER, on_spi ? &program_spi : &program_i2c, now_us);
}

/* Calibration: words, the less significant byte first; the first of each kind is unsigned. */
static void read_calibration(bmp280_t *b)
{
    for (int32_t i = 0; i < 12; i++) {
        const uint8_t bytes[2] = {b->device.data[(2 * i) + 1], b->device.data[2 * i]};
        const int32_t number = read_big_endian(bytes);
        const bool is_unsigned = (i == 0) || (i == 3);
        const real_t value = (real_t)((is_unsigned && (number < 0)) ? (number + 65536) : number);

        if (i < 3) {
            b->t[i] = value;
        } else {
            b->p[i - 3] = value;
        }
    }
    b->is_calibrated = (b->t[0] > REAL(0.0)) && (b->p[0] > REAL(0.0)) && (b->t[0] < REAL(65535.0));
}

void bmp280_compensate(bmp280_t *b, int32_t raw_pressure, int32_t raw_temperature)
{
    const real_t raw_t = (real_t)raw_temperature;
    const real_t coarse = (raw_t / REAL(131072.0)) - (b->t[0] / REAL(8192.0));
    const real_t t_fine = (((raw_t / REAL(16384.0)) - (b->t[0] / REAL(1024.0))) * b->t[1]) + (coarse * coarse * b->t[2]);
    const real_t *p = b->p;
    const real_t x = (t_fine / REAL(2.0)) - REAL(64000.0);
    const real_t offset = ((((x * x * p[5]) / REAL(32768.0)) + (x * p[4] * REAL(2.0))) / REAL(4.0)) + (p[3] * REAL(65536.0));
    const real_t slope = (((p[2] * x * x) / REAL(524288.0)) + (p[1] * x)) / REAL(524288.0);
    const real_t scale = (REAL(1.0) + (slope / REAL(32768.0))) * p[0];
    const real_t first = (((REAL(1048576.0) - (real_t)raw_pressure) - (offset / REAL(4096.0))) * REAL(6250.0)) / scale;
    const real_t square = (p[8] * first * first) / REAL(2147483648.0);

    b->temperature = t_fine / REAL(5120.0);
    b->pressure = first + ((square + ((first * p[7]) / REAL(32768.0)) + p[6]) / REAL(16.0));
}

/* Three bytes of a raw number, of which the upper 20 bits count. */
static int32_t read_raw(const uint8_t bytes[3])
{
    return ((int32_t)bytes[0] * 4096) + ((int32_t)bytes[1] * 16) + ((int32_t)bytes[2] / 16);
}

bool bmp280_step(bmp280_t *b, uint32_t now_us)
{
    bool fresh = register_device_step(&b->device, now_us);

    if (fresh && (b->device.read_from == (int32_t)CALIBRATION)) {
        fresh = false;
        read_calibration(b);
        if (!b->is_calibrated) {
            register_device_fail(&b->device, DEVICE_IMPLAUSIBLE, now_us);
        }
    } else if (fresh) {
        const int32_t raw = read_raw(&b->device.data[0]);

        bmp280_compensate(b, raw, read_raw(&b->device.data[3]));
        fresh = (raw != NO_MEASUREMENT) && (b->pressure > LEAST_PA) && (b->pressure < MOST_PA);
        if (fresh) {
            b->device.faults = 0U;
        } else {
            register_device_fail(&b->device, DEVICE_IMPLAUSIBLE, now_us);
        }
    } else {
        /* nothing new */
    }
    return fresh;
}
