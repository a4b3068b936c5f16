"""Drivers of test bench devices with a common interface, and a simulated bench."""
