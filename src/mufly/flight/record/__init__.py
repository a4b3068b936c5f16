"""Output of a flight: the recording, its summary, its pictures."""
