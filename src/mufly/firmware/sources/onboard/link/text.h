/* Log entries as English text, for stations that show STATUSTEXT. */
#ifndef MUFLY_TEXT_H
#define MUFLY_TEXT_H

#include "mission/machine/mission_state.h"

#define TEXT_LENGTH 100

/* Templates of log_messages.h, with numbers as {:g}, {:.2f} or {}: texts.c, made from log_messages.py of mufly.mission. */
extern const char *const mufly_texts[SAY_COUNT];

/* Write the text of a message, ended by a zero; return its length. */
int32_t write_message_text(const message_t *m, char out[TEXT_LENGTH]);

#endif
