// A board for the sketches on this machine: Serial is standard input and output, two speed controllers hang on pins 2
// and 3 and speak bidirectional DShot300. The counter of cycles goes on with every look at it, so that whoever waits by
// it waits, and the edges on a pin have times.
#pragma once
#include <stdint.h>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <unistd.h>
#include <vector>

#define MUFLY_HOST
typedef unsigned char byte;
#define constrain(x, low, high) ((x) < (low) ? (low) : ((x) > (high) ? (high) : (x)))
#define max(a, b) ((a) > (b) ? (a) : (b))
enum { A0 = 14, A1, A2, A3 };
const int HIGH = 1, LOW = 0, OUTPUT = 1, INPUT = 0, INPUT_PULLUP = 2, FALLING = 2;
inline unsigned long micros() {
  timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return t.tv_sec * 1000000UL + t.tv_nsec / 1000;
}
inline unsigned long millis() { return micros() / 1000; }
inline void noInterrupts() {}
inline void interrupts() {}
inline void delayMicroseconds(int) {}
inline void pinMode(int, int) {}
inline int digitalRead(int) { return 0; }
inline void digitalWrite(int, int) {}
inline int digitalPinToInterrupt(int pin) { return pin; }
inline void attachInterrupt(int, void (*)(), int) {}
inline int analogRead(int pin) { return pin == A2 ? 310 : 542; }  // 11 V; 1 A

struct Port {
  int waiting = -1;
  void begin(long) { fcntl(0, F_SETFL, O_NONBLOCK); }
  int available() {
    unsigned char c;
    if (waiting < 0 && ::read(0, &c, 1) == 1) waiting = c;
    return waiting >= 0;
  }
  int read() { int c = available() ? waiting : -1; waiting = -1; return c; }
  void print(const char *text) { if (::write(1, text, strlen(text)) < 0) exit(1); }
  void print(char c) { if (::write(1, &c, 1) < 0) exit(1); }
};
static Port Serial;

const unsigned long RATE = 600000000UL;
static unsigned long counter;
inline unsigned long cycles() { return counter += 12; }

// A speed controller and its motor: hears frames by their edges, answers, turns.
struct Controller {
  struct Edge { double at_us; bool high; };
  std::vector<Edge> edges;   // of the frame that is coming in
  std::vector<double> reply;  // when it changes the level of the line (us)
  double rpm = 0, last_s = 0;
  int throttle = 0;
  long bad = 0, good = 0;

  void turn() {
    double now = micros() / 1e6, dt = last_s ? now - last_s : 0;
    last_s = now;
    double goal = throttle < 48 ? 0 : 12000.0 * (throttle - 47) / 2000;
    rpm += (goal - rpm) * (1 - exp(-dt / 0.05));
  }
  void hear(double now_us) {
    unsigned frame = 0;
    bool fits = edges.size() == 32;
    for (size_t k = 0; fits && k < 32; k += 2) {
      double low = edges[k + 1].at_us - edges[k].at_us, bit = k ? edges[k].at_us - edges[k - 2].at_us : 10.0 / 3;
      bool one = fabs(low - 2.5) < 0.2;
      fits = !edges[k].high && edges[k + 1].high && (one || fabs(low - 1.25) < 0.2) && fabs(bit - 10.0 / 3) < 0.1;
      frame = frame << 1 | one;
    }
    edges.clear();
    reply.clear();
    unsigned v = frame >> 4;
    fits = fits && ((v ^ v >> 4 ^ v >> 8) & 0xF) == (~frame & 0xF);
    (fits ? good : bad)++;
    if (!fits) return;
    throttle = v >> 1;
    turn();
    if (!getenv("DSHOT_DUMB")) answer(now_us + 28.0);
  }
  void answer(double at_us) {
    static const int CODE[16] = {0x19, 0x1B, 0x12, 0x13, 0x1D, 0x15, 0x16, 0x17, 0x1A, 9, 0xA, 0xB, 0x1E, 0xD, 0xE, 0xF};
    unsigned value = 0xFFF, exponent = 0;
    if (rpm > 10) {
      unsigned long period = lround(60e6 / (rpm * 7));
      while (period >> exponent > 0x1FF) exponent++;
      value = exponent > 7 ? 0xFFF : exponent << 9 | period >> exponent;
    }
    value = value << 4 | (~(value ^ value >> 4 ^ value >> 8) & 0xF);
    unsigned long wire = 1;
    for (int k = 12; k >= 0; k -= 4) wire = wire << 5 | CODE[value >> k & 0xF];
    for (int b = 20; b >= 0; b--)
      if (wire >> b & 1) reply.push_back(at_us + (20 - b) * 8.0 / 3);
    if (reply.size() % 2) reply.push_back(at_us + 21 * 8.0 / 3);  // lets go of the line
  }
};
static Controller controllers[2];
inline double now_us() { return counter / (RATE / 1e6); }
inline void level(int pin, bool high) {
  counter += 12;
  auto &edges = controllers[pin - 2].edges;
  if (edges.empty() ? !high : edges.back().high != high) edges.push_back({now_us(), high});
}
inline bool level(int pin) {
  counter += 12;
  int passed = 0;
  for (double at : controllers[pin - 2].reply) passed += now_us() >= at;
  return passed % 2 == 0;
}
inline void direction(int pin, bool out) { if (!out) controllers[pin - 2].hear(now_us()); }
