/* Registers of the STM32F405 that this board uses, after ST's reference manual RM0090: addresses, bits, access.
 *
 * Every access goes through two functions, so that the same drivers run on this machine against a model of the registers
 * (-DREGISTER_MODEL). */
#ifndef MUFLY_REGISTERS_H
#define MUFLY_REGISTERS_H

#include <stdbool.h>
#include <stdint.h>

#ifdef REGISTER_MODEL
uint32_t register_get(uint32_t address);
void register_set(uint32_t address, uint32_t value);
uint32_t memory_address(const void *memory); /* as a register of the DMA holds it */
void interrupts_hold(bool held);
void sleep_until_interrupt(void);
#else
#define ALWAYS_INLINE static inline __attribute__((always_inline))

ALWAYS_INLINE uint32_t register_get(uint32_t address)
{
    return *(volatile uint32_t *)address;
}

ALWAYS_INLINE void register_set(uint32_t address, uint32_t value)
{
    *(volatile uint32_t *)address = value;
}

ALWAYS_INLINE uint32_t memory_address(const void *memory)
{
    return (uint32_t)memory;
}

ALWAYS_INLINE void interrupts_hold(bool held)
{
    if (held) {
        __asm__ volatile("cpsid i" ::: "memory");
    } else {
        __asm__ volatile("cpsie i\n isb" ::: "memory");
    }
}

ALWAYS_INLINE void sleep_until_interrupt(void)
{
    __asm__ volatile("dsb\n wfi" ::: "memory");
}
#endif

static inline void register_change(uint32_t address, uint32_t clear, uint32_t set)
{
    register_set(address, (register_get(address) & ~clear) | set);
}

/* Clocks and resets */
#define RCC 0x40023800U
#define RCC_CR (RCC + 0x00U)
#define RCC_PLLCFGR (RCC + 0x04U)
#define RCC_CFGR (RCC + 0x08U)
#define RCC_AHB1ENR (RCC + 0x30U)
#define RCC_APB1ENR (RCC + 0x40U)
#define RCC_APB2ENR (RCC + 0x44U)
#define RCC_CSR (RCC + 0x74U)
#define CR_HSEON (1UL << 16U)
#define CR_HSERDY (1UL << 17U)
#define CR_PLLON (1UL << 24U)
#define CR_PLLRDY (1UL << 25U)
#define PLLCFGR_HSE (1UL << 22U)
#define CFGR_SW_PLL 2U
#define CFGR_SWS (3UL << 2U)
#define CFGR_SWS_PLL (2UL << 2U)
#define CFGR_PPRE1_4 (5UL << 10U)
#define CFGR_PPRE2_2 (4UL << 13U)
#define AHB1_GPIO_ABC 7U
#define AHB1_DMA_BOTH (3UL << 21U)
#define APB1_TIM2 1U
#define APB1_TIM3 2U
#define APB1_TIM5 8U
#define APB1_SPI3 (1UL << 15U)
#define APB1_USART2 (1UL << 17U)
#define APB1_I2C1 (1UL << 21U)
#define APB2_TIM8 2U
#define APB2_USART1 (1UL << 4U)
#define APB2_ADC1 (1UL << 8U)
#define APB2_SPI1 (1UL << 12U)
#define CSR_RMVF (1UL << 24U)
#define CSR_BORRSTF (1UL << 25U)
#define CSR_PINRSTF (1UL << 26U)
#define CSR_PORRSTF (1UL << 27U)
#define CSR_SFTRSTF (1UL << 28U)
#define CSR_IWDGRSTF (1UL << 29U)

/* Flash */
#define FLASH_MEMORY 0x08000000U
#define FLASH_ACR 0x40023C00U
#define FLASH_KEYR 0x40023C04U
#define FLASH_SR 0x40023C0CU
#define FLASH_CR 0x40023C10U
#define ACR_168_MHZ 0x705U /* five wait states; prefetch, instruction and data cache */
#define ACR_DCEN (1UL << 10U)
#define ACR_DCRST (1UL << 12U)
#define FLASH_KEY_1 0x45670123U
#define FLASH_KEY_2 0xCDEF89ABU
#define FLASH_CR_PG 1U
#define FLASH_CR_SER 2U
#define FLASH_CR_PSIZE_32 (2UL << 8U)
#define FLASH_CR_STRT (1UL << 16U)
#define FLASH_CR_LOCK (1UL << 31U)
#define FLASH_SR_ERRORS 0xF2U /* OPERR, WRPERR, PGAERR, PGPERR, PGSERR */
#define FLASH_SR_BSY (1UL << 16U)

/* Pins: ports A, B, C */
#define GPIO_A 0x40020000U
#define GPIO_B 0x40020400U
#define GPIO_C 0x40020800U
#define GPIO_MODER 0x00U
#define GPIO_OTYPER 0x04U
#define GPIO_OSPEEDR 0x08U
#define GPIO_PUPDR 0x0CU
#define GPIO_BSRR 0x18U
#define GPIO_AFRL 0x20U

/* Serial ports */
#define USART1 0x40011000U
#define USART2 0x40004400U
#define USART_SR 0x00U
#define USART_DR 0x04U
#define USART_BRR 0x08U
#define USART_CR1 0x0CU
#define USART_CR2 0x10U
#define SR_PE 1U
#define SR_FE 2U
#define SR_NE 4U
#define SR_ORE 8U
#define SR_RXNE 32U
#define SR_TXE 128U
#define CR1_RE (1UL << 2U)
#define CR1_TE (1UL << 3U)
#define CR1_RXNEIE (1UL << 5U)
#define CR1_TXEIE (1UL << 7U)
#define CR1_PCE (1UL << 10U)
#define CR1_M (1UL << 12U)
#define CR1_UE (1UL << 13U)
#define CR2_STOP_2 (2UL << 12U)

/* Timers */
#define TIM2 0x40000000U
#define TIM3 0x40000400U
#define TIM5 0x40000C00U
#define TIM8 0x40010400U
#define TIM_CR1 0x00U
#define TIM_DIER 0x0CU
#define TIM_SR 0x10U
#define TIM_EGR 0x14U
#define TIM_CCMR1 0x18U
#define TIM_CCMR2 0x1CU
#define TIM_CCER 0x20U
#define TIM_CNT 0x24U
#define TIM_PSC 0x28U
#define TIM_ARR 0x2CU
#define TIM_CCR1 0x34U
#define TIM_CCR2 0x38U
#define TIM_CCR3 0x3CU
#define TIM_CCR4 0x40U
#define TIM_BDTR 0x44U
#define TIM_CEN 1U
#define TIM_UPDATE 1U           /* UIE, UIF and UG */
#define TIM_CC1DE (1UL << 9U)
#define TIM_CC2DE (1UL << 10U)
#define TIM_PWM_BOTH 0x6868U    /* PWM mode 1 with preload, of two channels */
#define TIM_MOE (1UL << 15U)

/* DMA: offsets from its base */
#define DMA1 0x40026000U
#define DMA2 0x40026400U
#define DMA_STREAM(n) (0x10U + (0x18U * (n)))
#define DMA_LISR 0x00U
#define DMA_LIFCR 0x08U
#define DMA_HIFCR 0x0CU
#define DMA_CR 0x00U
#define DMA_NDTR 0x04U
#define DMA_PAR 0x08U
#define DMA_M0AR 0x0CU
#define DMA_EN 1U
#define DMA_TO_PERIPHERAL (1UL << 6U)
#define DMA_MINC (1UL << 10U)
#define DMA_WORDS ((2UL << 13U) | (2UL << 11U))
#define DMA_CHANNEL(n) ((uint32_t)(n) << 25U)
#define DMA_S0_ERRORS 0x0DU /* FEIF0, DMEIF0, TEIF0 */
#define DMA_S0_DONE 0x20U
#define DMA_S0_ALL 0x3DU
#define DMA_S2_ALL (0x3DUL << 16U)
#define DMA_S3_ALL (0x3DUL << 22U)
#define DMA_S5_ALL (0x3DUL << 6U) /* in HIFCR */

/* SPI */
#define SPI1 0x40013000U
#define SPI3 0x40003C00U
#define SPI_CR1 0x00U
#define SPI_CR2 0x04U
#define SPI_SR 0x08U
#define SPI_DR 0x0CU
#define SPI_MODE_0 0U
#define SPI_MODE_3 3U       /* CPHA, CPOL */
#define SPI_MSTR 4U
#define SPI_BR_2 0U
#define SPI_BR_16 (3UL << 3U)
#define SPI_BR_128 (6UL << 3U)
#define SPI_SPE (1UL << 6U)
#define SPI_SSI_SSM (3UL << 8U)
#define SPI_DMA_BOTH 3U     /* RXDMAEN, TXDMAEN */
#define SPI_SR_MODF (1UL << 5U)
#define SPI_SR_OVR (1UL << 6U)
#define SPI_SR_BSY (1UL << 7U)

/* I2C 1 */
#define I2C1 0x40005400U
#define I2C_CR1 0x00U
#define I2C_CR2 0x04U
#define I2C_DR 0x10U
#define I2C_SR1 0x14U
#define I2C_SR2 0x18U
#define I2C_CCR 0x1CU
#define I2C_TRISE 0x20U
#define I2C_PE 1U
#define I2C_START (1UL << 8U)
#define I2C_STOP (1UL << 9U)
#define I2C_ACK (1UL << 10U)
#define I2C_POS (1UL << 11U)
#define I2C_SWRST (1UL << 15U)
#define I2C_ITERREN (1UL << 8U)
#define I2C_ITEVTEN (1UL << 9U)
#define I2C_ITBUFEN (1UL << 10U)
#define I2C_SB 1U
#define I2C_ADDR 2U
#define I2C_BTF 4U
#define I2C_RXNE (1UL << 6U)
#define I2C_TXE (1UL << 7U)
#define I2C_ERRORS 0xF00U /* OVR, AF, ARLO, BERR */
#define I2C_BUSY 2U

/* ADC 1 */
#define ADC1 0x40012000U
#define ADC_SR (ADC1 + 0x00U)
#define ADC_CR2 (ADC1 + 0x08U)
#define ADC_SMPR1 (ADC1 + 0x0CU)
#define ADC_SQR3 (ADC1 + 0x34U)
#define ADC_DR (ADC1 + 0x4CU)
#define ADC_EOC 2U
#define ADC_ADON 1U
#define ADC_SWSTART (1UL << 30U)

/* Watchdog of its own clock (32 kHz) */
#define IWDG_KR 0x40003000U
#define IWDG_PR 0x40003004U
#define IWDG_RLR 0x40003008U
#define IWDG_SR 0x4000300CU
#define IWDG_UNLOCK 0x5555U
#define IWDG_FEED 0xAAAAU
#define IWDG_START 0xCCCCU

/* Core */
#define NVIC_ISER 0xE000E100U
#define SCB_CPACR 0xE000ED88U
#define SCB_CFSR 0xE000ED28U
#define SCB_AIRCR 0xE000ED0CU
#define AIRCR_RESET 0x05FA0004U
#define IRQ_I2C1_EVENT 31U
#define IRQ_I2C1_ERROR 32U
#define IRQ_USART1 37U
#define IRQ_USART2 38U
#define IRQ_TIM5 50U

#endif
