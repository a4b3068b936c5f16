"""The devices of a test bench, each behind the same few calls, and a bench of our own aerodynamics to try things on."""
