/* Functions of memory.c with the names and types of the C library's. */
#ifndef MUFLY_MEMORY_H
#define MUFLY_MEMORY_H

#include <stddef.h>

void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

#endif
