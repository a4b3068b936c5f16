// Two speed controllers of models behind a microcontroller: PWM out, speed held here, watchdog here.
// The lines are those of mufly/bench/rig/esc.py. Board: any Arduino with two interrupt pins (Uno, Nano, Leonardo, ...).
//
//   pin 9, 10   pulses to the controllers (1000 to 2000 us, 50 Hz)      pin 2, 3   one pulse a turn (Hall, optical)
//   A0, A1      current, 0.1 V/A about 2.5 V (ACS712-20A)               A2, A3     voltage at the motor, divided by 6
//
// A motor that has not been spoken to for 500 ms is stopped, whatever the computer does.

#include <Servo.h>

const int AXES = 2;
const int PULSE_PIN[AXES] = {9, 10}, SPEED_PIN[AXES] = {2, 3}, CURRENT_PIN[AXES] = {A0, A1}, VOLTAGE_PIN[AXES] = {A2, A3};
const float VOLT = 5.0 / 1023.0, AMPERE = VOLT / 0.1, DIVIDER = 6.0;
const unsigned long WATCHDOG_ms = 500, SPINUP_ms = 3000;
const float KP = 0.010, KI = 0.030;  // us per rpm, us per rpm s: start low, raise until it holds

Servo esc[AXES];
volatile unsigned long turn_us[AXES], period_us[AXES];
float target_rpm[AXES], integral[AXES];
unsigned long heard_ms, started_ms[AXES], told_ms, held_ms;
unsigned int number;
char line[64];
int length;

void turned0() { unsigned long now = micros(); period_us[0] = now - turn_us[0]; turn_us[0] = now; }
void turned1() { unsigned long now = micros(); period_us[1] = now - turn_us[1]; turn_us[1] = now; }

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

float rpm_of(int k) {
  noInterrupts();
  unsigned long since = micros() - turn_us[k], period = period_us[k];
  interrupts();
  return since > 300000UL || period == 0 ? 0.0 : 60e6 / max(period, since);
}

void stop(int k) {
  target_rpm[k] = 0;
  integral[k] = 0;
  esc[k].writeMicroseconds(1000);
}

void hear(char *body) {
  char answer[64];
  int axis, rpm;
  heard_ms = millis();
  if (body[0] == 'X') {
    for (int k = 0; k < AXES; k++) stop(k);
    say("OK,X");
  } else if (sscanf(body, "S,%d,%d", &axis, &rpm) == 2 && axis >= 0 && axis < AXES && rpm >= 0) {
    if (rpm == 0) stop(axis);
    else {
      if (target_rpm[axis] == 0) started_ms[axis] = millis();
      target_rpm[axis] = rpm;
    }
    snprintf(answer, sizeof answer, "OK,S,%d,%d", axis, rpm);
    say(answer);
  }
}

void setup() {
  Serial.begin(115200);
  for (int k = 0; k < AXES; k++) {
    esc[k].attach(PULSE_PIN[k], 1000, 2000);
    esc[k].writeMicroseconds(1000);
    pinMode(SPEED_PIN[k], INPUT_PULLUP);
  }
  attachInterrupt(digitalPinToInterrupt(SPEED_PIN[0]), turned0, FALLING);
  attachInterrupt(digitalPinToInterrupt(SPEED_PIN[1]), turned1, FALLING);
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
    char text[32];
    if (now - heard_ms > WATCHDOG_ms) {
      stop(k);
      snprintf(text, sizeof text, "F,%d,watchdog", k);
      say(text);
    } else if (now - started_ms[k] > SPINUP_ms && rpm_of(k) < 100) {
      stop(k);
      snprintf(text, sizeof text, "F,%d,no speed signal", k);
      say(text);
    }
  }
  if (now - held_ms >= 20) {  // the controllers take a pulse every 20 ms
    float dt = (now - held_ms) / 1000.0;
    held_ms = now;
    for (int k = 0; k < AXES; k++) {
      if (target_rpm[k] <= 0) continue;
      float error = target_rpm[k] - rpm_of(k);
      integral[k] = constrain(integral[k] + KI * error * dt, 0.0, 1000.0);
      esc[k].writeMicroseconds((int)constrain(1000 + integral[k] + KP * error, 1000, 2000));
    }
    char text[80];
    int n = snprintf(text, sizeof text, "T,%u", number++);
    for (int k = 0; k < AXES; k++)
      n += snprintf(text + n, sizeof text - n, ",%ld,%ld,%ld,0", (long)rpm_of(k),
                    (long)(1000 * (analogRead(CURRENT_PIN[k]) * VOLT - 2.5) / 0.1), (long)(1000 * analogRead(VOLTAGE_PIN[k]) * VOLT * DIVIDER));
    say(text);
  }
}
