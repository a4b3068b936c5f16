// Two speed controllers of models behind a microcontroller: bidirectional DShot300 out, speed from the controllers' own
// answers (no Hall sensor needed), speed held here, watchdog here. The lines are those of mufly/bench/rig/esc.py.
// Board: Raspberry Pi Pico (core "arduino-pico") or Teensy 4. Controllers: BLHeli_32, Bluejay, AM32 with bidirectional DShot.
//
//   pin 2, 3    signal of the controllers (3.3 V, no resistor; ground beside it)
//   A0, A1      current, 0.1 V/A about 1.65 V (a Hall sensor for 3.3 V)        A2      supply, divided by 11
//
// A motor that has not been spoken to for 500 ms is stopped, whatever the computer does; one that does not answer, too.
// A frame is 11 bits of throttle (0 stops, 48 to 2047), one that asks for telemetry, four of check sum; the line rests
// high. 30 us later the controller answers on the same wire: period of the electrical turn as e m (m << e us), four bits
// of check sum, each nibble as five bits, a change of level for each 1 of them, at 5/4 of the rate.

const int AXES = 2, POLE_PAIRS = 7;  // of the motors: half the number of their magnets
const int SIGNAL_PIN[AXES] = {2, 3}, CURRENT_PIN[AXES] = {A0, A1}, SUPPLY_PIN = A2;
const float VOLT = 3.3 / 1023.0, AMPERE = VOLT / 0.1, DIVIDER = 11.0;
const unsigned long WATCHDOG_ms = 500, SPINUP_ms = 3000, SILENT_ms = 200;
const float KP = 0.050, KI = 0.300;  // steps of throttle per rpm, per rpm s: start low, raise until it holds
const long LOWEST = 48, HIGHEST = 2047;

#if defined(ARDUINO_ARCH_RP2040)
inline unsigned long cycles() { return rp2040.getCycleCount(); }
inline void level(int pin, bool high) { gpio_put(pin, high); }
inline bool level(int pin) { return gpio_get(pin); }
inline void direction(int pin, bool out) { gpio_set_dir(pin, out); if (!out) gpio_pull_up(pin); }
const unsigned long RATE = F_CPU;
#elif defined(__IMXRT1062__)
inline unsigned long cycles() { return ARM_DWT_CYCCNT; }
inline void level(int pin, bool high) { digitalWriteFast(pin, high); }
inline bool level(int pin) { return digitalReadFast(pin); }
inline void direction(int pin, bool out) { pinMode(pin, out ? OUTPUT : INPUT_PULLUP); }
const unsigned long RATE = F_CPU;
#elif !defined(MUFLY_HOST)
#error "needs a counter of cycles and quick pins: a Raspberry Pi Pico or a Teensy 4"
#endif

const unsigned long BIT = RATE / 300000UL, ONE = BIT * 3 / 4, ZERO = BIT * 3 / 8, REPLY_BIT = RATE / 375000UL;
const unsigned long REPLY_WAIT = RATE / 1000000UL * 60;
const int REPLY_BITS = 21, NOTHING = -1;

float target_rpm[AXES], integral[AXES], rpm[AXES];
long throttle[AXES];
unsigned long heard_ms, started_ms[AXES], answered_ms[AXES], told_ms, sent_us, held_us;
unsigned int number;
char line[64];
int length;

uint16_t crc16(const char *text, int n) {
  uint16_t crc = 0xFFFF;
  for (int i = 0; i < n; i++) {
    crc ^= (uint16_t)(byte)text[i] << 8;
    for (int b = 0; b < 8; b++) crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
  }
  return crc;
}

void say(const char *body) {
  char sum[6];
  snprintf(sum, sizeof sum, "*%04X", crc16(body, strlen(body)));
  Serial.print('$'); Serial.print(body); Serial.print(sum); Serial.print('\n');
}

unsigned int frame_of(long value) {
  unsigned int v = value << 1;
  return v << 4 | (~(v ^ v >> 4 ^ v >> 8) & 0xF);  // the sum is inverted: that asks for an answer on the wire
}

// The 16 bits of an answer from the 21 on the wire, NOTHING where they make no sense.
long decoded(unsigned long wire) {
  static const signed char NIBBLE[32] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, 9, 10, 11, -1, 13, 14, 15,
                                         -1, -1, 2, 3, -1, 5, 6, 7, -1, 0, 8, 1, -1, 4, 12, -1};
  long value = 0;
  for (int k = 15; k >= 0; k -= 5) {
    int nibble = NIBBLE[wire >> k & 0x1F];
    if (nibble < 0) return NOTHING;
    value = value << 4 | nibble;
  }
  return ((value ^ value >> 4 ^ value >> 8 ^ value >> 12) & 0xF) == 0xF ? value >> 4 : NOTHING;
}

void send(int pin, unsigned int frame) {
  direction(pin, true);
  unsigned long start = cycles();
  for (int b = 15; b >= 0; b--) {
    unsigned long low = frame >> b & 1 ? ONE : ZERO;
    level(pin, false);
    while (cycles() - start < low);
    level(pin, true);
    while (cycles() - start < BIT);
    start += BIT;
  }
  direction(pin, false);
}

long answer(int pin) {
  unsigned long from = cycles();
  while (level(pin))
    if (cycles() - from > REPLY_WAIT) return NOTHING;
  unsigned long began = cycles(), last = began, wire = 0;
  int bits = 0;
  bool now = false;
  while (cycles() - began < (REPLY_BITS + 1) * REPLY_BIT) {
    if (level(pin) == now) continue;
    unsigned long at = cycles(), n = (at - last + REPLY_BIT / 2) / REPLY_BIT;
    if (n == 0 || bits + n > REPLY_BITS) return NOTHING;
    wire = wire << n | 1UL << (n - 1);
    bits += n;
    last = at;
    now = !now;
  }
  if (bits < REPLY_BITS) wire = wire << (REPLY_BITS - bits) | 1UL << (REPLY_BITS - bits - 1);
  return decoded(wire);
}

void exchange(int k) {
  noInterrupts();  // a quarter of a millisecond
  send(SIGNAL_PIN[k], frame_of(throttle[k]));
  long value = answer(SIGNAL_PIN[k]);
  interrupts();
  if (value == NOTHING) return;
  long exponent = value >> 9, mantissa = value & 0x1FF;
  if (exponent > 0 && !(mantissa & 0x100)) return;  // extended telemetry, which is not asked for
  answered_ms[k] = millis();
  float period_us = (mantissa + (exponent > 0 ? 0.5 : 0.0)) * (1L << exponent);  // the last bits are cut off: their middle
  rpm[k] = value == 0xFFF || mantissa == 0 ? 0.0 : 60e6 / period_us / POLE_PAIRS;
}

void stop(int k) {
  target_rpm[k] = 0;
  integral[k] = 0;
  throttle[k] = 0;
}

void hear(char *body) {
  char reply[64];
  int axis, speed;
  heard_ms = millis();
  if (body[0] == 'X') {
    for (int k = 0; k < AXES; k++) stop(k);
    say("OK,X");
  } else if (sscanf(body, "S,%d,%d", &axis, &speed) == 2 && axis >= 0 && axis < AXES && speed >= 0) {
    if (speed == 0) stop(axis);
    else {
      if (target_rpm[axis] == 0) started_ms[axis] = millis();
      target_rpm[axis] = speed;
    }
    snprintf(reply, sizeof reply, "OK,S,%d,%d", axis, speed);
    say(reply);
  }
}

void setup() {
  Serial.begin(115200);
  for (int k = 0; k < AXES; k++) {
    pinMode(SIGNAL_PIN[k], INPUT_PULLUP);
    level(SIGNAL_PIN[k], true);
  }
  say("B,esc,1");
}

void loop() {
  while (Serial.available()) {
    char c = Serial.read();
    if (c == '$') length = 0;
    else if (c == '\n') {
      line[length] = 0;
      char *star = strrchr(line, '*');
      if (star) {
        *star = 0;
        if (strtol(star + 1, 0, 16) == crc16(line, star - line)) hear(line);
      }
      length = 0;
    } else if (length < (int)sizeof line - 1) line[length++] = c;
  }
  unsigned long now = millis();
  for (int k = 0; k < AXES; k++) {
    if (target_rpm[k] <= 0) continue;
    const char *why = 0;
    if (now - heard_ms > WATCHDOG_ms) why = "watchdog";
    else if (now - answered_ms[k] > SILENT_ms && now - started_ms[k] > SILENT_ms) why = "does not answer";
    else if (now - started_ms[k] > SPINUP_ms && rpm[k] < 100) why = "does not turn";
    if (!why) continue;
    stop(k);
    char text[32];
    snprintf(text, sizeof text, "F,%d,%s", k, why);
    say(text);
  }
  if (micros() - sent_us >= 1000) {  // controllers want to hear something all the time; this also arms them, by zeros
    sent_us = micros();
    for (int k = 0; k < AXES; k++) exchange(k);
  }
  if (micros() - held_us >= 5000) {
    float dt = (micros() - held_us) / 1e6;
    held_us = micros();
    for (int k = 0; k < AXES; k++) {
      if (target_rpm[k] <= 0) continue;
      float error = target_rpm[k] - rpm[k];
      integral[k] = constrain(integral[k] + KI * error * dt, 0.0, (float)(HIGHEST - LOWEST));
      throttle[k] = constrain((long)(LOWEST + integral[k] + KP * error), LOWEST, HIGHEST);
    }
  }
  if (now - told_ms >= 20) {
    told_ms = now;
    char text[80];
    int n = snprintf(text, sizeof text, "T,%u", number++);
    float supply = analogRead(SUPPLY_PIN) * VOLT * DIVIDER;
    for (int k = 0; k < AXES; k++)
      n += snprintf(text + n, sizeof text - n, ",%ld,%ld,%ld,0", (long)rpm[k],
                    (long)(1000 * (analogRead(CURRENT_PIN[k]) * VOLT - 1.65) / 0.1), (long)(1000 * supply * throttle[k] / HIGHEST));
    say(text);
  }
}
