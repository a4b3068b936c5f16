/* Calls of the host by a program on an emulated Arm processor (Semihosting for AArch32 and AArch64, Arm Ltd.). */
#ifndef MUFLY_SEMIHOSTING_H
#define MUFLY_SEMIHOSTING_H

#include <stdint.h>

#define HOST_OPEN 0x01U
#define HOST_PRINT 0x04U
#define HOST_WRITE 0x05U
#define HOST_READ 0x06U
#define HOST_EXIT 0x18U

/* Call the host with an operation and its arguments; return its answer. */
uint32_t ask_host(uint32_t what, const void *with);

#endif
