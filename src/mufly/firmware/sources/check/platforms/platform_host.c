#include "check/platforms/platform.h"

#include <inttypes.h>
#include <stdio.h>

void platform_start(void)
{
}

uint32_t platform_count(void)
{
    return 0U;
}

void platform_print(const char *what, uint64_t number)
{
    (void)printf("%s%016" PRIx64 "\n", what, number);
}

void platform_end(void)
{
}
