// Two load cells, each on an HX711 (24 bits, 80 readings a second with its pin RATE high), and a BME280 if there is one.
// The lines are those of mufly/bench/rig/cells.py. Board: any Arduino.
//
//   pin 4, 5    DOUT of the force and of the torque cell's converter       pin 6   their clocks, together
//   SDA, SCL    BME280 (comment USE_BME280 out where there is none; library "Adafruit BME280")

#define USE_BME280
#ifdef USE_BME280
#include <Adafruit_BME280.h>
Adafruit_BME280 air;
bool has_air;
#endif

const int CELLS = 2, DATA[CELLS] = {4, 5}, CLOCK = 6;
unsigned int number;
unsigned long air_ms;

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

void setup() {
  Serial.begin(115200);
  pinMode(CLOCK, OUTPUT);
  for (int k = 0; k < CELLS; k++) pinMode(DATA[k], INPUT);
#ifdef USE_BME280
  has_air = air.begin(0x76) || air.begin(0x77);
#endif
  say("B,cells,1");
}

void loop() {
  bool ready = true;
  for (int k = 0; k < CELLS; k++) ready = ready && digitalRead(DATA[k]) == LOW;
  if (ready) {
    long value[CELLS] = {0, 0};
    noInterrupts();  // a clock that stays high for 60 us switches the converter off
    for (int bit = 0; bit < 25; bit++) {  // 24 bits, and one more for channel A with gain 128
      digitalWrite(CLOCK, HIGH);
      delayMicroseconds(1);
      if (bit < 24)
        for (int k = 0; k < CELLS; k++) value[k] = value[k] << 1 | digitalRead(DATA[k]);
      digitalWrite(CLOCK, LOW);
      delayMicroseconds(1);
    }
    interrupts();
    char text[64];
    int n = snprintf(text, sizeof text, "C,%u", number++ & 0xFFFF);
    for (int k = 0; k < CELLS; k++)
      n += snprintf(text + n, sizeof text - n, ",%ld", value[k] & 0x800000L ? value[k] - 0x1000000L : value[k]);
    say(text);
  }
#ifdef USE_BME280
  if (has_air && millis() - air_ms >= 1000) {
    air_ms = millis();
    char text[64];
    snprintf(text, sizeof text, "A,%ld,%ld,%ld", (long)(100 * air.readTemperature()), (long)air.readPressure(),
             (long)(10 * air.readHumidity()));
    say(text);
  }
#endif
}
