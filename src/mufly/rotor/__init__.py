"""How do its rotors lift? Airfoils, polars, blade geometry."""

from mufly.rotor.airfoil import Airfoil, database_airfoils, load_airfoil
from mufly.rotor.build import polar, polars
from mufly.rotor.geometry import BladeSections, Rotor, blade_thickness_m
from mufly.rotor.load import (
    builtin_rotors,
    load_rotor,
    make_rotor,
    replace_rotor,
    rotor_from,
    rotor_toml,
)
from mufly.rotor.polar import PolarStack, PolarTable, lookup, outside, stack_polars

__all__ = [
    "Airfoil",
    "BladeSections",
    "PolarStack",
    "PolarTable",
    "Rotor",
    "blade_thickness_m",
    "builtin_rotors",
    "database_airfoils",
    "load_airfoil",
    "load_rotor",
    "lookup",
    "make_rotor",
    "outside",
    "polar",
    "polars",
    "replace_rotor",
    "rotor_from",
    "rotor_toml",
    "stack_polars",
]
