#include "onboard/drivers/sensors/icm42688.h"

#define TEMP_DATA1 0x1DU /* then acceleration x, y, z and rates x, y, z; 14 bytes */
#define DEVICE_CONFIG 0x11U
#define PWR_MGMT0 0x4EU
#define GYRO_CONFIG0 0x4FU
#define ACCEL_CONFIG0 0x50U
#define GYRO_ACCEL_CONFIG0 0x52U
#define WHO_AM_I 0x75U
#define SOFT_RESET 0x01U
#define IDENTITY 0x47U
#define LOW_NOISE_BOTH 0x0FU
#define ODR_1KHZ 0x06U     /* with the largest full scale, whose bits are 0 */
#define BANDWIDTH 0x44U    /* both: a tenth of the rate */
#define SAMPLE_BYTES 14
#define MAX_REPEATED 20    /* noise changes the last bit of one of seven channels far sooner */

#define G_PER_COUNT (REAL(9.80665) / REAL(2048.0))
#define RATE_PER_COUNT (REAL(0.017453292519943295) / REAL(16.4))
#define NO_SAMPLE (-32768)

static const device_step_t steps[] = {
    {STEP_WRITE, DEVICE_CONFIG, SOFT_RESET},
    {STEP_WAIT, 0, 2},
    {STEP_IDENTITY, WHO_AM_I, IDENTITY},
    {STEP_WRITE, GYRO_CONFIG0, ODR_1KHZ},
    {STEP_WRITE, ACCEL_CONFIG0, ODR_1KHZ},
    {STEP_WRITE, GYRO_ACCEL_CONFIG0, BANDWIDTH},
    {STEP_WRITE, PWR_MGMT0, LOW_NOISE_BOTH},
    {STEP_WAIT, 0, 45}, /* of the gyroscopes, from sleep to a valid rate */
    {STEP_SETTING, GYRO_CONFIG0, ODR_1KHZ},
    {STEP_SETTING, ACCEL_CONFIG0, ODR_1KHZ},
    {STEP_SETTING, PWR_MGMT0, LOW_NOISE_BOTH},
    {STEP_READ, TEMP_DATA1, SAMPLE_BYTES},
};
static const device_program_t program = {steps, 12, 11, 0x80U, 1};

void icm42688_start(icm42688_t *imu, uint32_t now_us)
{
    static const icm42688_t none;

    *imu = none;
    register_device_start(&imu->device, (int32_t)DEVICE_IMU, &program, now_us);
}

bool icm42688_step(icm42688_t *imu, uint32_t now_us)
{
    bool fresh = register_device_step(&imu->device, now_us);

    if (fresh) {
        static const real_t signs[3] = {REAL(1.0), REAL(-1.0), REAL(-1.0)};
        const uint8_t *data = imu->device.data;
        bool same = true;
        bool none = true;

        for (int32_t i = 0; i < SAMPLE_BYTES; i++) {
            same = same && (data[i] == imu->last[i]);
            imu->last[i] = data[i];
        }
        imu->repeated = same ? (imu->repeated + 1) : 0;
        for (int32_t i = 0; i < 3; i++) {
            const int32_t force = read_big_endian(&data[2 + (2 * i)]);
            const int32_t rate = read_big_endian(&data[8 + (2 * i)]);

            none = none && (force == NO_SAMPLE) && (rate == NO_SAMPLE);
            imu->acceleration[i] = signs[i] * G_PER_COUNT * (real_t)force;
            imu->rates[i] = signs[i] * RATE_PER_COUNT * (real_t)rate;
            imu->clipping[i] = ((force >= 32767) || (force <= -32768)) ? REAL(1.0) : REAL(0.0);
        }
        imu->temperature = ((real_t)read_big_endian(data) / REAL(132.48)) + REAL(298.15);
        if (none || (imu->repeated >= MAX_REPEATED)) {
            fresh = false;
            imu->repeated = 0;
            register_device_fail(&imu->device, DEVICE_IMPLAUSIBLE, now_us);
        } else {
            imu->device.faults = 0U;
        }
    }
    return fresh;
}
