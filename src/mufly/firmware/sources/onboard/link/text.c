#include "onboard/link/text.h"

#define MAX_SHOWN REAL(1e6)

static void append(char out[TEXT_LENGTH], int32_t *length, char c)
{
    if (*length < (TEXT_LENGTH - 1)) {
        out[*length] = c;
        *length += 1;
    }
}

static void append_integer(char out[TEXT_LENGTH], int32_t *length, uint32_t value, int32_t least)
{
    char digits[12];
    uint32_t left = value;
    int32_t count = 0;

    do {
        digits[count] = (char)('0' + (char)(left % 10U));
        left /= 10U;
        count++;
    } while (((left > 0U) || (count < least)) && (count < 10));
    while (count > 0) {
        count--;
        append(out, length, digits[count]);
    }
}

/* A number with so many decimals; trim: without trailing zeros. */
static void append_number(char out[TEXT_LENGTH], int32_t *length, real_t number, int32_t decimals, bool trim)
{
    real_t size = real_abs(number);
    uint32_t scale = 1U;
    int32_t places = decimals;

    if (!(size < MAX_SHOWN)) {
        append(out, length, '?'); /* not a number, or out of range */
    } else {
        uint32_t whole;
        uint32_t part;

        for (int32_t i = 0; i < decimals; i++) {
            scale *= 10U;
        }
        whole = (uint32_t)size;
        part = (uint32_t)(((size - (real_t)whole) * (real_t)scale) + REAL(0.5));
        if (part >= scale) {
            whole++;
            part -= scale;
        }
        while (trim && (places > 0) && ((part % 10U) == 0U)) {
            part /= 10U;
            places--;
        }
        if ((number < REAL(0.0)) && ((whole > 0U) || (part > 0U))) {
            append(out, length, '-');
        }
        append_integer(out, length, whole, 1);
        if (places > 0) {
            append(out, length, '.');
            append_integer(out, length, part, places);
        }
    }
}

int32_t write_message_text(const message_t *m, char out[TEXT_LENGTH])
{
    const bool known = (m->code >= 0) && (m->code < (int32_t)SAY_COUNT);
    const char *from = known ? mufly_texts[m->code] : "";
    int32_t length = 0;
    int32_t shown = 0;
    int32_t i = 0;

    while (from[i] != '\0') {
        if (from[i] == '{') {
            int32_t decimals = 3;
            bool trim = true;

            while ((from[i] != '}') && (from[i] != '\0')) {
                if ((from[i] == '.') && (from[i + 1] >= '0') && (from[i + 1] <= '4')) {
                    trim = from[i + 2] == 'g'; /* significant digits, of a number from 1 to 10 */
                    decimals = (int32_t)(from[i + 1] - '0') - (trim ? 1 : 0);
                }
                i++;
            }
            append_number(out, &length, (shown < MESSAGE_NUMBERS) ? m->number[shown] : REAL(0.0), decimals, trim);
            shown++;
        } else {
            append(out, &length, from[i]);
        }
        if (from[i] != '\0') {
            i++;
        }
    }
    out[length] = '\0';
    return length;
}
