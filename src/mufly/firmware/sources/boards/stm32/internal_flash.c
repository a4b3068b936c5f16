/* Two sectors of the internal flash. While the flash programs or erases, up to 0.8 s, the processor cannot read it: the code that
 * waits and feeds the watchdog lies in RAM (.fast), and interrupts, whose code lies in flash, are held. */
#include "boards/stm32/stm32f405.h"

#define FIRST_SECTOR 2U
#define FIRST_ADDRESS (FLASH_MEMORY + 0x8000U)
#define SECTOR_BYTES 0x4000U
#define PATIENCE_PROGRAM 100000U
#define PATIENCE_ERASE 60000000U /* 2 s and more at 168 MHz */

#ifdef REGISTER_MODEL
#define IN_RAM
#else
#define IN_RAM __attribute__((section(".fast"), noinline, long_call))
#endif

static uint32_t address_of(int32_t sector, int32_t word)
{
    return FIRST_ADDRESS + ((uint32_t)sector * SECTOR_BYTES) + (4U * (uint32_t)word);
}

static bool is_in_range(int32_t sector, int32_t word)
{
    return (sector >= 0) && (sector < 2) && (word >= 0) && (word < FLASH_SECTOR_WORDS);
}

uint32_t internal_flash_read(int32_t sector, int32_t word)
{
    return is_in_range(sector, word) ? register_get(address_of(sector, word)) : 0xFFFFFFFFU;
}

static void unlock(void)
{
    if ((register_get(FLASH_CR) & FLASH_CR_LOCK) != 0U) {
        register_set(FLASH_KEYR, FLASH_KEY_1);
        register_set(FLASH_KEYR, FLASH_KEY_2);
    }
    register_set(FLASH_SR, FLASH_SR_ERRORS); /* each is cleared by a one */
}

/* Start the operation, wait for its end and feed the watchdog meanwhile; return whether the hardware reports no error. */
IN_RAM static bool run_operation(uint32_t control, uint32_t address, uint32_t value, uint32_t patience)
{
    bool busy = true;

    interrupts_hold(true);
    register_set(FLASH_CR, control);
    register_set(address, value);
    for (uint32_t n = 0U; busy && (n < patience); n++) {
        busy = (register_get(FLASH_SR) & FLASH_SR_BSY) != 0U;
        register_set(IWDG_KR, IWDG_FEED);
    }
    interrupts_hold(false);
    return !busy && ((register_get(FLASH_SR) & FLASH_SR_ERRORS) == 0U);
}

static void lock(void)
{
    register_set(FLASH_CR, FLASH_CR_LOCK);
    register_change(FLASH_ACR, ACR_DCEN, 0U); /* the data cache may hold words from before */
    register_change(FLASH_ACR, 0U, ACR_DCRST);
    register_change(FLASH_ACR, ACR_DCRST, ACR_DCEN);
}

bool internal_flash_program(int32_t sector, int32_t word, uint32_t value)
{
    bool done = false;

    if (is_in_range(sector, word)) {
        unlock();
        done = run_operation(FLASH_CR_PG | FLASH_CR_PSIZE_32, address_of(sector, word), value, PATIENCE_PROGRAM);
        lock();
    }
    return done;
}

bool internal_flash_erase(int32_t sector)
{
    const uint32_t control = FLASH_CR_SER | FLASH_CR_PSIZE_32 | ((FIRST_SECTOR + (uint32_t)sector) << 3U);
    bool done = false;

    if (is_in_range(sector, 0)) {
        unlock();
        register_set(FLASH_CR, control);
        done = run_operation(control, FLASH_CR, control | FLASH_CR_STRT, PATIENCE_ERASE);
        lock();
    }
    return done;
}
