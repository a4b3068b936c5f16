"""How do its rotors lift? Airfoils, polars, blade geometry."""

from mufly.rotor.geometry import Rotor
from mufly.rotor.polar import PolarStack, PolarTable, lookup, outside, stack_polars

__all__ = ["PolarStack", "PolarTable", "Rotor", "lookup", "outside", "stack_polars"]
