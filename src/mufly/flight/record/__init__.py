"""What stays of a flight: the recording, its numbers, its pictures."""
