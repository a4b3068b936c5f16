#include "words.h"

message_t say_4(int32_t code, real_t a, real_t b, real_t c, real_t d)
{
    message_t m;

    m.code = code;
    m.number[0] = a;
    m.number[1] = b;
    m.number[2] = c;
    m.number[3] = d;
    for (int32_t i = 0; i < SAID_SENSORS; i++) {
        m.because[i].sensor = -1;
        m.because[i].status = 0;
        m.because[i].why = 0;
        m.because[i].number = REAL(0.0);
    }
    return m;
}

message_t say_3(int32_t code, real_t a, real_t b, real_t c)
{
    return say_4(code, a, b, c, REAL(0.0));
}

message_t say_2(int32_t code, real_t a, real_t b)
{
    return say_4(code, a, b, REAL(0.0), REAL(0.0));
}

message_t say_1(int32_t code, real_t a)
{
    return say_4(code, a, REAL(0.0), REAL(0.0), REAL(0.0));
}

message_t say(int32_t code)
{
    return say_4(code, REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0));
}

bool say_same(const message_t *a, const message_t *b)
{
    bool same = a->code == b->code;

    for (int32_t i = 0; i < SAID_NUMBERS; i++) {
        const bool equal = (a->number[i] <= b->number[i]) && (a->number[i] >= b->number[i]);
        same = same && (equal || (real_missing(a->number[i]) && real_missing(b->number[i])));
    }
    return same;
}
