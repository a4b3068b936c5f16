#include "onboard/drivers/sensors/vl53l1x.h"

#define SOFT_RESET 0x0000U
#define VHV_CONFIG_TIMEOUT_MACROP_LOOP_BOUND 0x0008U
#define VHV_CONFIG_INIT 0x000BU
#define PAD_I2C_HV_EXTSUP_CONFIG 0x002EU
#define GPIO_HV_MUX_CTRL 0x0030U
#define GPIO_TIO_HV_STATUS 0x0031U
#define ANA_CONFIG_SPAD_SEL_PSWIDTH 0x0033U
#define ANA_CONFIG_VCSEL_PULSE_WIDTH_OFFSET 0x0034U
#define SIGMA_ESTIMATOR_EFFECTIVE_PULSE_WIDTH_NS 0x0036U
#define SIGMA_ESTIMATOR_EFFECTIVE_AMBIENT_WIDTH_NS 0x0037U
#define SIGMA_ESTIMATOR_SIGMA_REF_MM 0x0038U
#define ALGO_CROSSTALK_COMPENSATION_VALID_HEIGHT_MM 0x0039U
#define ALGO_RANGE_IGNORE_VALID_HEIGHT_MM 0x003EU
#define ALGO_RANGE_MIN_CLIP 0x003FU
#define ALGO_CONSISTENCY_CHECK_TOLERANCE 0x0040U
#define SYSTEM_INTERRUPT_CONFIG_GPIO 0x0046U
#define CAL_CONFIG_VCSEL_START 0x0047U
#define GLOBAL_CONFIG_VCSEL_WIDTH 0x004AU
#define PHASECAL_CONFIG_TIMEOUT_MACROP 0x004BU
#define PHASECAL_CONFIG_TARGET 0x004CU
#define DSS_CONFIG_ROI_MODE_CONTROL 0x004FU
#define SYSTEM_THRESH_RATE_HIGH 0x0050U
#define SYSTEM_THRESH_RATE_LOW 0x0052U
#define DSS_CONFIG_MANUAL_EFFECTIVE_SPADS_SELECT 0x0054U
#define DSS_CONFIG_APERTURE_ATTENUATION 0x0057U
#define DSS_CONFIG_MAX_SPADS_LIMIT 0x0058U
#define DSS_CONFIG_MIN_SPADS_LIMIT 0x0059U
#define MM_CONFIG_TIMEOUT_MACROP_A_LO 0x005BU
#define RANGE_CONFIG_TIMEOUT_MACROP_A 0x005EU
#define RANGE_CONFIG_VCSEL_PERIOD_A 0x0060U
#define RANGE_CONFIG_TIMEOUT_MACROP_B 0x0061U
#define RANGE_CONFIG_VCSEL_PERIOD_B 0x0063U
#define RANGE_CONFIG_SIGMA_THRESH 0x0064U
#define RANGE_CONFIG_MIN_COUNT_RATE_RTN_LIMIT_MCPS 0x0066U
#define RANGE_CONFIG_VALID_PHASE_LOW 0x0068U
#define RANGE_CONFIG_VALID_PHASE_HIGH 0x0069U
#define SYSTEM_SEED_CONFIG 0x0077U
#define SD_CONFIG_WOI_SD0 0x0078U
#define SD_CONFIG_WOI_SD1 0x0079U
#define SD_CONFIG_INITIAL_PHASE_SD0 0x007AU
#define SD_CONFIG_INITIAL_PHASE_SD1 0x007BU
#define SD_CONFIG_QUANTIFIER 0x007EU
#define ROI_CONFIG_USER_ROI_CENTRE_SPAD 0x007FU
#define ROI_CONFIG_USER_ROI_REQUESTED_GLOBAL_XY_SIZE 0x0080U
#define SYSTEM_SEQUENCE_CONFIG 0x0081U
#define SYSTEM_GROUPED_PARAMETER_HOLD 0x0082U
#define FIRMWARE_ENABLE 0x0085U
#define SYSTEM_INTERRUPT_CLEAR 0x0086U
#define SYSTEM_MODE_START 0x0087U
#define RESULT_RANGE_STATUS 0x0089U
#define IDENTIFICATION_MODEL_ID 0x010FU
#define IDENTIFICATION_MODULE_TYPE 0x0110U

#define MODEL_ID 0xEAU
#define MODULE_TYPE 0xCCU
#define SINGLE_SHOT 0x10U
#define RESULT_BYTES 15     /* up to FINAL_CROSSTALK_CORRECTED_RANGE_MM_SD0 */
#define RANGE_BYTE 13
#define STATUS_MASK 0x1FU
#define LOOP_STEPS 5        /* the last ones measure, again and again */
#define FIRST_MS 150U       /* the first measurement also calibrates */
#define BUDGET_MS 35U       /* of 33 ms, with its overhead */
#define REPEAT_US 4000U
#define MAX_WAITS 20        /* 0.1 s or more */
#define M_PER_MM REAL(0.001)
#define LEAST_M REAL(0.04)
#define MOST_M REAL(3.6)

/* Status of a measurement. */
enum { VCSEL_CONTINUITY = 1, VCSEL_WATCHDOG = 2, NO_VHV_VALUE = 3, RANGE_COMPLETE = 9, MULTIPLE_CLIP = 17, STREAM_COUNT_0 = 18 };

#define WORD(address, value) {STEP_WRITE, (address), (value) >> 8U}, {STEP_WRITE, (address) + 1U, (value) & 0xFFU}

/* Long distance, 33 ms, all single-photon diodes, I2C pulled up above 1.8 V. One measurement after the other is started: the free
 * running mode depends on a trimmed oscillator. */
static const device_step_t steps[] = {
    {STEP_WRITE, SOFT_RESET, 0x00U},
    {STEP_WAIT, 0, 1},
    {STEP_WRITE, SOFT_RESET, 0x01U},
    {STEP_WAIT, 0, 3}, /* 1.2 ms at most */
    {STEP_IDENTITY, IDENTIFICATION_MODEL_ID, MODEL_ID},
    {STEP_IDENTITY, IDENTIFICATION_MODULE_TYPE, MODULE_TYPE},
    {STEP_WRITE, PAD_I2C_HV_EXTSUP_CONFIG, 0x01U},
    {STEP_WRITE, GPIO_HV_MUX_CTRL, 0x01U}, /* ready: bit 0 of GPIO_TIO_HV_STATUS is 1 */
    {STEP_WRITE, ANA_CONFIG_SPAD_SEL_PSWIDTH, 0x02U},
    {STEP_WRITE, ANA_CONFIG_VCSEL_PULSE_WIDTH_OFFSET, 0x08U},
    {STEP_WRITE, SIGMA_ESTIMATOR_EFFECTIVE_PULSE_WIDTH_NS, 8U},
    {STEP_WRITE, SIGMA_ESTIMATOR_EFFECTIVE_AMBIENT_WIDTH_NS, 16U},
    {STEP_WRITE, SIGMA_ESTIMATOR_SIGMA_REF_MM, 1U},
    {STEP_WRITE, ALGO_CROSSTALK_COMPENSATION_VALID_HEIGHT_MM, 1U},
    {STEP_WRITE, ALGO_RANGE_IGNORE_VALID_HEIGHT_MM, 0xFFU},
    {STEP_WRITE, ALGO_RANGE_MIN_CLIP, 0U},
    {STEP_WRITE, ALGO_CONSISTENCY_CHECK_TOLERANCE, 0x0FU},
    {STEP_WRITE, SYSTEM_INTERRUPT_CONFIG_GPIO, 0x20U}, /* a new sample */
    {STEP_WRITE, CAL_CONFIG_VCSEL_START, 0x0BU},
    {STEP_WRITE, GLOBAL_CONFIG_VCSEL_WIDTH, 0x02U},
    {STEP_WRITE, PHASECAL_CONFIG_TIMEOUT_MACROP, 0x0AU},
    {STEP_WRITE, PHASECAL_CONFIG_TARGET, 0x21U},
    {STEP_WRITE, DSS_CONFIG_ROI_MODE_CONTROL, 0x05U},
    WORD(SYSTEM_THRESH_RATE_HIGH, 0U),
    WORD(SYSTEM_THRESH_RATE_LOW, 0U),
    {STEP_WRITE, DSS_CONFIG_MANUAL_EFFECTIVE_SPADS_SELECT, 200U},
    {STEP_WRITE, DSS_CONFIG_APERTURE_ATTENUATION, 0x38U},
    {STEP_WRITE, DSS_CONFIG_MAX_SPADS_LIMIT, 0xFFU},
    {STEP_WRITE, DSS_CONFIG_MIN_SPADS_LIMIT, 1U},
    {STEP_WRITE, MM_CONFIG_TIMEOUT_MACROP_A_LO, 8U},
    WORD(RANGE_CONFIG_TIMEOUT_MACROP_A, 0x0060U),
    {STEP_WRITE, RANGE_CONFIG_VCSEL_PERIOD_A, 0x0FU},
    WORD(RANGE_CONFIG_TIMEOUT_MACROP_B, 0x006EU),
    {STEP_WRITE, RANGE_CONFIG_VCSEL_PERIOD_B, 0x0DU},
    WORD(RANGE_CONFIG_SIGMA_THRESH, 360U),                     /* 90 mm */
    WORD(RANGE_CONFIG_MIN_COUNT_RATE_RTN_LIMIT_MCPS, 128U),    /* 1 million counts per second */
    {STEP_WRITE, RANGE_CONFIG_VALID_PHASE_LOW, 0x08U},
    {STEP_WRITE, RANGE_CONFIG_VALID_PHASE_HIGH, 0xB8U},
    {STEP_WRITE, SYSTEM_SEED_CONFIG, 1U},
    {STEP_WRITE, SD_CONFIG_WOI_SD0, 0x0FU},
    {STEP_WRITE, SD_CONFIG_WOI_SD1, 0x0DU},
    {STEP_WRITE, SD_CONFIG_INITIAL_PHASE_SD0, 0x0EU},
    {STEP_WRITE, SD_CONFIG_INITIAL_PHASE_SD1, 0x0EU},
    {STEP_WRITE, SD_CONFIG_QUANTIFIER, 2U},
    {STEP_WRITE, ROI_CONFIG_USER_ROI_CENTRE_SPAD, 0xC7U},
    {STEP_WRITE, ROI_CONFIG_USER_ROI_REQUESTED_GLOBAL_XY_SIZE, 0xFFU},
    {STEP_WRITE, SYSTEM_SEQUENCE_CONFIG, 0x9BU},
    {STEP_WRITE, SYSTEM_GROUPED_PARAMETER_HOLD, 0U},
    {STEP_WRITE, FIRMWARE_ENABLE, 1U},
    {STEP_SETTING, RANGE_CONFIG_VCSEL_PERIOD_A, 0x0FU},
    {STEP_SETTING, SYSTEM_SEQUENCE_CONFIG, 0x9BU},
    {STEP_WRITE, SYSTEM_MODE_START, SINGLE_SHOT},
    {STEP_WAIT, 0, FIRST_MS},
    {STEP_WRITE, VHV_CONFIG_TIMEOUT_MACROP_LOOP_BOUND, 0x09U}, /* from now on calibrate from the last temperature */
    {STEP_WRITE, VHV_CONFIG_INIT, 0U},
    {STEP_WRITE, SYSTEM_INTERRUPT_CLEAR, 1U},
    {STEP_WRITE, SYSTEM_MODE_START, SINGLE_SHOT},
    {STEP_WAIT, 0, BUDGET_MS},
    {STEP_READ, GPIO_TIO_HV_STATUS, 1},
    {STEP_READ, RESULT_RANGE_STATUS, RESULT_BYTES},
};
#define STEPS ((int32_t)(sizeof(steps) / sizeof(steps[0])))
static const device_program_t program = {steps, STEPS, STEPS - LOOP_STEPS, 0x00U, 2};

void vl53l1x_start(vl53l1x_t *s, uint32_t now_us)
{
    static const vl53l1x_t none;

    *s = none;
    register_device_start(&s->device, (int32_t)DEVICE_LASER, &program, now_us);
}

/* Go on to the result when the measurement is over; else look again later, for a while. */
static void check_ready(vl53l1x_t *s, uint32_t now_us)
{
    const bool ready = (s->device.data[0] & 1U) != 0U;

    s->waits = ready ? 0 : (s->waits + 1);
    if (s->waits > MAX_WAITS) {
        s->waits = 0;
        register_device_fail(&s->device, DEVICE_SILENT, now_us);
    } else if (!ready) {
        register_device_repeat(&s->device, REPEAT_US, now_us);
    } else {
        /* the result follows */
    }
}

/* Read a result; return whether it says anything of the range. */
static bool read_result(vl53l1x_t *s, uint32_t now_us)
{
    const uint8_t *data = s->device.data;
    const int32_t status = (int32_t)(data[0] & STATUS_MASK);
    const int32_t range_mm = ((int32_t)data[RANGE_BYTE] * 256) + (int32_t)data[RANGE_BYTE + 1];
    const bool broken = (status == (int32_t)VCSEL_CONTINUITY) || (status == (int32_t)VCSEL_WATCHDOG) ||
                        (status == (int32_t)NO_VHV_VALUE) || (status == (int32_t)MULTIPLE_CLIP) || (status == 0);

    if (broken) {
        register_device_fail(&s->device, DEVICE_IMPLAUSIBLE, now_us);
    } else {
        s->range = M_PER_MM * (real_t)range_mm;
        s->has_echo = (status == (int32_t)RANGE_COMPLETE) && (s->range >= LEAST_M) && (s->range <= MOST_M);
        s->device.faults = 0U;
    }
    return !broken && (status != (int32_t)STREAM_COUNT_0);
}

bool vl53l1x_step(vl53l1x_t *s, uint32_t now_us)
{
    bool fresh = register_device_step(&s->device, now_us);

    if (fresh && (s->device.read_from == (int32_t)GPIO_TIO_HV_STATUS)) {
        check_ready(s, now_us);
        fresh = false;
    } else if (fresh) {
        fresh = read_result(s, now_us);
    } else {
        /* nothing new */
    }
    return fresh;
}
