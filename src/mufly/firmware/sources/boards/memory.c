/* Functions that the compiler calls to copy and clear records; a board without a C library needs them. Words are copied where
 * aligned, as a C library does. volatile keeps the compiler from calling them in themselves. */
#include "boards/memory.h"

#include <stdint.h>

void *memcpy(void *to, const void *from, size_t count)
{
    size_t i = 0U;

    if (((((uintptr_t)to) | ((uintptr_t)from)) & 3U) == 0U) {
        while ((i + 4U) <= count) {
            *(volatile uint32_t *)((uint8_t *)to + i) = *(const uint32_t *)((const uint8_t *)from + i);
            i += 4U;
        }
    }
    while (i < count) {
        ((volatile uint8_t *)to)[i] = ((const uint8_t *)from)[i];
        i++;
    }
    return to;
}

void *memset(void *to, int value, size_t count)
{
    for (size_t i = 0U; i < count; i++) {
        ((volatile uint8_t *)to)[i] = (uint8_t)value;
    }
    return to;
}
