/* Pins of the board: compare with its schematic. These suit the usual layout of a flight controller with an STM32F405. */
#ifndef MUFLY_PINS_H
#define MUFLY_PINS_H

#include "boards/stm32/registers.h"

#define IMU_SELECT_PORT GPIO_C /* chip selects, active low */
#define IMU_SELECT_PIN 2U
#define BAROMETER_SELECT_PORT GPIO_B
#define BAROMETER_SELECT_PIN 3U
#define CARD_SELECT_PORT GPIO_C
#define CARD_SELECT_PIN 1U
#define I2C_PORT GPIO_B        /* with resistors to 3.3 V on the board */
#define I2C_SCL_PIN 8U
#define I2C_SDA_PIN 9U
#define CRYSTAL_MHZ 8U
#define BATTERY_CHANNEL 15U    /* of ADC 1: C5 */

/* Port, pin, mode (1 output, 2 alternate function, 3 analogue), function. */
typedef struct {
    uint32_t port, pin, mode, function;
} pin_t;

#define PIN_TABLE                                                                                                       \
    {                                                                                                                   \
        {GPIO_A, 9U, 2U, 7U}, {GPIO_A, 10U, 2U, 7U},                       /* USART 1: link */                          \
        {GPIO_A, 3U, 2U, 7U},                                              /* USART 2: receiver */                      \
        {GPIO_A, 5U, 2U, 5U}, {GPIO_A, 6U, 2U, 5U}, {GPIO_A, 7U, 2U, 5U}, /* SPI 1 */                                   \
        {GPIO_C, 10U, 2U, 6U}, {GPIO_C, 11U, 2U, 6U}, {GPIO_C, 12U, 2U, 6U}, /* SPI 3: SD card */                       \
        {I2C_PORT, I2C_SCL_PIN, 2U, 4U}, {I2C_PORT, I2C_SDA_PIN, 2U, 4U}, /* I2C 1: ranging */                          \
        {CARD_SELECT_PORT, CARD_SELECT_PIN, 1U, 0U},                                                                    \
        {GPIO_C, 6U, 2U, 3U}, {GPIO_C, 7U, 2U, 3U},                       /* TIM 8: upper and lower motor */            \
        {GPIO_B, 0U, 2U, 2U}, {GPIO_B, 1U, 2U, 2U},                       /* TIM 3: servos 1 and 2 */                   \
        {GPIO_C, 5U, 3U, 0U},                                             /* battery */                                 \
        {IMU_SELECT_PORT, IMU_SELECT_PIN, 1U, 0U}, {BAROMETER_SELECT_PORT, BAROMETER_SELECT_PIN, 1U, 0U},               \
    }

#endif
