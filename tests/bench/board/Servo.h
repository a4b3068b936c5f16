#pragma once
struct Servo {
  void attach(int, int, int) {}
  void writeMicroseconds(int) {}
};
