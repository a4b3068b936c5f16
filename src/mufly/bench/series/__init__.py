"""Measurement series on the test bench: plan, run, record and analysis."""
