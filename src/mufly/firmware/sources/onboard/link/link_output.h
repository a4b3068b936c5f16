/* Output of a link: a ring of encoded messages, and texts. */
#ifndef MUFLY_LINK_OUTPUT_H
#define MUFLY_LINK_OUTPUT_H

#include "onboard/link/vehicle_link.h"

#define VEHICLE_SYSTEM 1U
#define VEHICLE_COMPONENT 1U

/* Queue a message; return whether there was room for it. */
bool send_message(link_t *k, mavlink_message_t *m);

/* A number as an unsigned field; unknown where it does not fit. */
uint32_t to_unsigned_field(real_t value, real_t most, uint32_t unknown);

/* Queue STATUSTEXT messages of a text; of a string that ends in zero. */
void send_text(link_t *k, const char *text, int32_t length, uint32_t severity);
void send_string(link_t *k, const char *text, uint32_t severity);

#endif
