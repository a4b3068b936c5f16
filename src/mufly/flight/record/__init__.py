"""Output of a flight: recording, summary and pictures."""
