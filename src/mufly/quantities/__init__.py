"""Quantities: units, their grammar, the table of recorded signals and the table of sensors."""
