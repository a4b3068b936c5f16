#include "onboard/storage/fault_record.h"

#define MAGIC 0x6D75466CU

/* FNV-1a over all words but the last, the checksum. */
static uint32_t compute_checksum(const fault_record_t *r)
{
    const uint32_t words[] = {r->magic, r->restarts, r->in_flight, r->cause, r->motors_ran,
                              r->state, r->time_ms, r->fault_address, r->fault_status};
    uint32_t sum = 2166136261U;

    for (uint32_t i = 0U; i < (sizeof(words) / sizeof(words[0])); i++) {
        for (uint32_t shift = 0U; shift < 32U; shift += 8U) {
            sum = (sum ^ ((words[i] >> shift) & 0xFFU)) * 16777619U;
        }
    }
    return sum;
}

int32_t fault_record_begin(fault_record_t *r, uint32_t cause)
{
    static const fault_record_t none;
    int32_t kind = RESTART_COLD;

    if ((r->magic == MAGIC) && (r->checksum == compute_checksum(r)) && (cause != RESET_BY_POWER)) {
        kind = (r->motors_ran != 0U) ? RESTART_IN_FLIGHT : RESTART_ON_FLOOR;
        r->restarts++;
        r->in_flight += (r->motors_ran != 0U) ? 1U : 0U;
    } else {
        *r = none;
        r->magic = MAGIC;
    }
    r->cause = cause;
    r->motors_ran = 0U;
    r->checksum = compute_checksum(r);
    return kind;
}

void fault_record_update(fault_record_t *r, bool motors_run, int32_t state, real_t time_s)
{
    r->motors_ran = motors_run ? 1U : 0U;
    r->state = (uint32_t)state;
    r->time_ms = ((time_s > REAL(0.0)) && (time_s < REAL(4e6))) ? (uint32_t)(time_s * REAL(1000.0)) : 0U;
    r->checksum = compute_checksum(r);
}

void fault_record_fault(fault_record_t *r, uint32_t address, uint32_t status)
{
    r->fault_address = address;
    r->fault_status = status;
    r->checksum = compute_checksum(r);
}
