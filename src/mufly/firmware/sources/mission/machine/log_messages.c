#include "mission/machine/log_messages.h"

message_t make_message_4(int32_t code, real_t a, real_t b, real_t c, real_t d)
{
    message_t m;

    m.code = code;
    m.number[0] = a;
    m.number[1] = b;
    m.number[2] = c;
    m.number[3] = d;
    for (int32_t i = 0; i < MESSAGE_SENSORS; i++) {
        m.faulty_sensors[i].sensor = -1;
        m.faulty_sensors[i].status = 0;
        m.faulty_sensors[i].why = 0;
        m.faulty_sensors[i].number = REAL(0.0);
    }
    return m;
}

message_t make_message_3(int32_t code, real_t a, real_t b, real_t c)
{
    return make_message_4(code, a, b, c, REAL(0.0));
}

message_t make_message_2(int32_t code, real_t a, real_t b)
{
    return make_message_4(code, a, b, REAL(0.0), REAL(0.0));
}

message_t make_message_1(int32_t code, real_t a)
{
    return make_message_4(code, a, REAL(0.0), REAL(0.0), REAL(0.0));
}

message_t make_message(int32_t code)
{
    return make_message_4(code, REAL(0.0), REAL(0.0), REAL(0.0), REAL(0.0));
}

bool is_same_message(const message_t *a, const message_t *b)
{
    bool same = a->code == b->code;

    for (int32_t i = 0; i < MESSAGE_NUMBERS; i++) {
        const bool equal = (a->number[i] <= b->number[i]) && (a->number[i] >= b->number[i]);
        same = same && (equal || (real_is_nan(a->number[i]) && real_is_nan(b->number[i])));
    }
    return same;
}
