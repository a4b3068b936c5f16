"""Rotors beside measurements: comparison, fits, and the uncertainty of predictions."""
