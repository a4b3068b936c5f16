"""The simulated vehicle in real time: its loop, and a process for it."""
