/* A device behind registers, on SPI or I2C: identity, set-up and measurements as a table of steps, one after the other, without
 * waiting. Transfers are the board's, by DMA or interrupts; each has 5 ms. After any fault the device is initialised again, 0.1 s later. */
#ifndef MUFLY_REGISTER_DEVICE_H
#define MUFLY_REGISTER_DEVICE_H

#include "real.h"

#define DEVICE_DATA_BYTES 32
#define DEVICE_TIMEOUT_US 5000U
#define DEVICE_PAUSE_US 100000U

/* Numbers of the devices on the board's buses. */
enum { DEVICE_IMU, DEVICE_BAROMETER, DEVICE_SONAR, DEVICE_LASER, DEVICE_COUNT };

/* Begin to write so many bytes, then to read so many, in one transaction; the memory belongs to the bus until bus_poll returns another
 * value than BUS_BUSY. false: the bus refuses. Functions of the board. */
bool bus_begin(int32_t device, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count);
enum { BUS_DONE, BUS_BUSY, BUS_ERROR };
int32_t bus_poll(int32_t device);

/* End a transfer that takes too long, and free the bus: SPI: deselect and reset; I2C: nine clocks and a stop. */
void bus_abort(int32_t device);

/* Write value to a register; read a register, which must hold value (identity: the device's, else a setting); read value bytes
 * from a register on; wait value milliseconds. */
enum { STEP_WRITE, STEP_IDENTITY, STEP_SETTING, STEP_READ, STEP_WAIT };

typedef struct {
    uint8_t kind;
    uint16_t address;
    uint8_t value;
} device_step_t;

typedef struct {
    const device_step_t *steps;
    int32_t count, loop_from; /* after the last step follows this one */
    uint8_t read_flag;        /* set in the address of a read: 0x80 on SPI */
    int32_t address_bytes;    /* 1, or 2: the more significant first */
} device_program_t;

/* Faults, as bits, since the latest data. */
#define DEVICE_REFUSES 1U      /* the bus takes no transfer, or reports an error (I2C: no acknowledge) */
#define DEVICE_SILENT 2U       /* a transfer or a measurement took too long */
#define DEVICE_UNKNOWN 4U      /* another identity */
#define DEVICE_FORGETS 8U      /* a setting does not hold */
#define DEVICE_IMPLAUSIBLE 16U /* implausible data: set by its driver */

typedef struct {
    int32_t number;
    const device_program_t *program;
    int32_t step;
    bool is_running; /* a transfer is under way */
    bool waits;
    uint32_t since_us, pause_us;
    uint32_t faults, fault_count;
    uint8_t out[3];
    uint8_t data[DEVICE_DATA_BYTES];
    int32_t read_from; /* register of the data */
} register_device_t;

void register_device_start(register_device_t *d, int32_t number, const device_program_t *program, uint32_t now_us);

/* Advance; return whether data of a STEP_READ are new in d->data. Call once a period or more often; a call ends and begins at most
 * one transfer. now_us: a clock that wraps around. */
bool register_device_step(register_device_t *d, uint32_t now_us);

/* Repeat the step that has just brought data, after a pause: its device is not ready. */
void register_device_repeat(register_device_t *d, uint32_t pause_us, uint32_t now_us);

/* Begin anew after a pause, because of a fault. */
void register_device_fail(register_device_t *d, uint32_t fault, uint32_t now_us);

/* Two bytes, the more significant first, as a signed number. */
int32_t read_big_endian(const uint8_t bytes[2]);

#endif
