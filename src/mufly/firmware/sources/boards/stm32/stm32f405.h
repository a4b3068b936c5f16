/* Peripherals of an STM32F405, without any vendor's code. No function waits without a bound. */
#ifndef MUFLY_STM32F405_H
#define MUFLY_STM32F405_H

#include "boards/stm32/registers.h"

#define FULL_SPEED_HZ 168000000U
#define SERIAL_RING 256U

/* Start crystal and PLL; return the processor's clock (Hz): FULL_SPEED_HZ, or that of the internal oscillator, 16 MHz, where crystal
 * or PLL do not start: then the board must not fly. */
uint32_t clock_start(void);

/* Cause of the latest reset, RESET_BY_... of fault_record.h; clears the flags. */
uint32_t reset_cause(void);

/* Reset the processor. */
void reset_processor(void);

/* Start the watchdog, which resets the processor 50 ms after the latest feed; nothing stops it. */
void watchdog_start(void);
void watchdog_feed(void);

/* Timer 2 counts microseconds; timer 5 interrupts at a rate. */
void timers_start(uint32_t clock_Hz, uint32_t rate_Hz);
uint32_t timer_us(void);
void timer_end_interrupt(void);

/* Pins and their functions: those of pins.c. */
void pins_start(void);
void pin_set(uint32_t port, uint32_t pin, bool high);

/* A serial port with rings, filled and emptied by its interrupt. At 420 000 baud that costs below 2 % of the processor. */
typedef struct {
    uint32_t base;
    volatile uint32_t head, tail;           /* received */
    volatile uint32_t send_head, send_tail; /* to be sent */
    volatile uint32_t errors;               /* bytes lost: overrun, frame, parity, noise, no room */
    uint8_t received[SERIAL_RING];
    uint8_t sending[SERIAL_RING];
} serial_port_t;

/* bus_Hz: clock of the port's bus; sbus: 8E2 in place of 8N1, the inverter is the board's. */
void serial_start(serial_port_t *s, uint32_t base, uint32_t bus_Hz, uint32_t baud, bool sbus);
void serial_interrupt(serial_port_t *s);
int32_t serial_read(serial_port_t *s, uint8_t *to, int32_t most);
int32_t serial_write(serial_port_t *s, const uint8_t *from, int32_t count);

/* Sectors 2 and 3 of the flash, 16 kB each, as sectors 0 and 1 of hal.h. */
#define FLASH_SECTOR_WORDS 4096
uint32_t internal_flash_read(int32_t sector, int32_t word);
bool internal_flash_program(int32_t sector, int32_t word, uint32_t value);
bool internal_flash_erase(int32_t sector);

/* SPI by DMA, one transfer at a time. Both ports use streams 0 and 5 of their DMA. */
typedef struct {
    uint32_t base, dma, channel;
    uint32_t select_port, select_pin; /* of the present device */
    bool is_running;
} spi_port_t;

void spi_port_start(spi_port_t *s, uint32_t base, uint32_t mode, uint32_t divider);
void spi_port_speed(spi_port_t *s, uint32_t mode, uint32_t divider);

/* Exchange bytes; out: NULL sends 0xFF; in: NULL drops what comes. false: a transfer is under way. */
bool spi_port_begin(spi_port_t *s, const uint8_t out[], uint8_t in[], int32_t count);
int32_t spi_port_poll(spi_port_t *s); /* BUS_... of register_device.h */
void spi_port_abort(spi_port_t *s);

/* Sensors on SPI 1: bytes out, then bytes in, in one selection of the device; at most SPI_BYTES in all. */
#define SPI_BYTES 40
void spi_start(void);
bool spi_begin(uint32_t port, uint32_t pin, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count);
int32_t spi_poll(void);
void spi_abort(void);

/* I2C 1 by interrupts, one transfer at a time: bytes out, then bytes in after a repeated start. The memory belongs to the bus until
 * i2c_poll returns another value than BUS_BUSY. bus_Hz: clock of its bus. false: a transfer is under way, or a line is held low, which
 * nine clocks and a stop then free. */
void i2c_start(uint32_t bus_Hz);
bool i2c_begin(uint32_t address, const uint8_t out[], int32_t out_count, uint8_t in[], int32_t in_count);
int32_t i2c_poll(void); /* BUS_... of register_device.h */
void i2c_abort(void);
void i2c_event_interrupt(void);
void i2c_error_interrupt(void);

/* SD card on SPI 3: functions of sd_card.h. */
void card_bus_start(void);

/* Motors by DShot300 on timer 8, servos on timer 3: pulses in microseconds every 20 ms. */
#define DSHOT_BIT_TICKS 560U /* at 168 MHz */
void outputs_start(uint32_t clock_Hz);
void motors_send(uint32_t first[], uint32_t second[], uint32_t count); /* compare values; the memory stays the timer's */
void servos_set(uint32_t first_us, uint32_t second_us);

/* Count of the battery's voltage, 12 bits; a larger value: no new conversion. */
void adc_start(void);
uint32_t adc_read(void);

#endif
