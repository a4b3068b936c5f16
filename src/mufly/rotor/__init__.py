"""How do its rotors lift? Airfoils, polars, blade geometry."""

from mufly.rotor.airfoil import Airfoil, database_airfoils, load_airfoil
from mufly.rotor.build import polar, polars
from mufly.rotor.geometry import Rotor
from mufly.rotor.polar import PolarStack, PolarTable, lookup, outside, stack_polars

__all__ = [
    "Airfoil",
    "PolarStack",
    "PolarTable",
    "Rotor",
    "database_airfoils",
    "load_airfoil",
    "lookup",
    "outside",
    "polar",
    "polars",
    "stack_polars",
]
