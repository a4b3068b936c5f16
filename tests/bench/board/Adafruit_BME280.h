#pragma once
struct Adafruit_BME280 {
  bool begin(int) { return true; }
  float readTemperature() { return 21.5; }
  float readPressure() { return 95000; }
  float readHumidity() { return 40; }
};
