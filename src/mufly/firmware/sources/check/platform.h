/* What the self-test asks of where it runs. */
#ifndef MUFLY_PLATFORM_H
#define MUFLY_PLATFORM_H

#include <stdint.h>

void platform_start(void);
uint32_t platform_count(void); /* ticks of a clock since the start; 0 where nobody counts */
void platform_print(const char *what, uint64_t number);
void platform_end(void);

#endif
