"""The simulated vehicle in real time: the loop that runs it, and a process of its own for that loop."""
