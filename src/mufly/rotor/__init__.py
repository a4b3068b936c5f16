"""How do its rotors lift? Airfoils, polars, blade geometry, blade element momentum theory, the coaxial pair."""

from mufly.rotor.airfoil import Airfoil, database_airfoils, load_airfoil
from mufly.rotor.bemt import Air, BatchResult, RotorResult, hover, hover_batch
from mufly.rotor.blading import PLAIN, Blading, Corrections, prepare
from mufly.rotor.engines import polar, polars
from mufly.rotor.geometry import (
    BladeSections,
    Rotor,
    blade_thickness_m,
    builtin_rotors,
    load_rotor,
    make_rotor,
    replace_rotor,
    rotor_from,
    rotor_toml,
)
from mufly.rotor.maps import climb_ratios, coax_map
from mufly.rotor.measurements import Comparison, Measurements, calibrate, compare, read_measurements
from mufly.rotor.polar_table import PolarStack, PolarTable, lookup, outside, stack_polars
from mufly.rotor.system import CoaxialResult, balance_torque, coaxial, solve_thrust
from mufly.rotor.uncertainty import Band, Doubt, interval

__all__ = [
    "PLAIN",
    "Air",
    "Airfoil",
    "Band",
    "BatchResult",
    "BladeSections",
    "Blading",
    "CoaxialResult",
    "Comparison",
    "Corrections",
    "Doubt",
    "Measurements",
    "PolarStack",
    "PolarTable",
    "Rotor",
    "RotorResult",
    "balance_torque",
    "blade_thickness_m",
    "builtin_rotors",
    "calibrate",
    "climb_ratios",
    "coax_map",
    "coaxial",
    "compare",
    "database_airfoils",
    "hover",
    "hover_batch",
    "interval",
    "load_airfoil",
    "load_rotor",
    "lookup",
    "make_rotor",
    "outside",
    "polar",
    "polars",
    "prepare",
    "read_measurements",
    "replace_rotor",
    "rotor_from",
    "rotor_toml",
    "solve_thrust",
    "stack_polars",
]
