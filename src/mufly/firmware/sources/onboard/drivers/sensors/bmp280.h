/* Barometer Bosch BMP280 on SPI or I2C (data sheet BST-BMP280-DS001, register map and compensation of sections 3.11 and 4): pressure
 * 16 times, temperature twice oversampled, one value in 50 ms. */
#ifndef MUFLY_BMP280_H
#define MUFLY_BMP280_H

#include "onboard/drivers/sensors/register_device.h"

typedef struct {
    register_device_t device;
    real_t t[3], p[9];   /* calibration of the device: dig_T1 ..., dig_P1 ... */
    bool is_calibrated;
    real_t pressure;     /* Pa */
    real_t temperature;  /* degrees Celsius */
} bmp280_t;

/* read_flag: 0x80 on SPI, where the address of a write has its upper bit cleared, else 0. */
void bmp280_start(bmp280_t *b, bool on_spi, uint32_t now_us);

/* Advance; return whether there is a new pressure. */
bool bmp280_step(bmp280_t *b, uint32_t now_us);

/* Pressure and temperature of two raw numbers of 20 bits, by the calibration in b. */
void bmp280_compensate(bmp280_t *b, int32_t raw_pressure, int32_t raw_temperature);

#endif
