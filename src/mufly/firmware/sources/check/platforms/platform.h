/* Platform functions of the self-tests. */
#ifndef MUFLY_PLATFORM_H
#define MUFLY_PLATFORM_H

#include <stdint.h>

void platform_start(void);
uint32_t platform_count(void); /* clock ticks since the start; 0 without a counter */
void platform_print(const char *what, uint64_t number);
void platform_end(void);

#endif
