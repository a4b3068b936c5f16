"""A series on the test bench: its plan, its run, its record, and what it says."""
