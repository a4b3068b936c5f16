"""How do its rotors lift? Airfoils, polars, blade geometry, blade element momentum theory, the coaxial pair."""

from mufly.rotor.airfoil import Airfoil, database_airfoils, load_airfoil
from mufly.rotor.blading import Blading, prepare
from mufly.rotor.build import polar, polars
from mufly.rotor.coax_map import climb_ratios, coax_map
from mufly.rotor.coaxial import CoaxialResult, balance_torque, coaxial
from mufly.rotor.compare import Comparison, calibrate, compare
from mufly.rotor.corrections import PLAIN, Corrections
from mufly.rotor.geometry import BladeSections, Rotor, blade_thickness_m
from mufly.rotor.hover import Air, BatchResult, RotorResult, hover, hover_batch
from mufly.rotor.load import (
    builtin_rotors,
    load_rotor,
    make_rotor,
    replace_rotor,
    rotor_from,
    rotor_toml,
)
from mufly.rotor.measurements import Measurements, read_measurements
from mufly.rotor.polar import PolarStack, PolarTable, lookup, outside, stack_polars
from mufly.rotor.thrust import solve_thrust
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
