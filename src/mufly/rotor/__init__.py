"""How do its rotors lift? Airfoils, polars, blade geometry, blade element momentum theory, the coaxial pair."""

from mufly.rotor.bemt import BatchResult, hover, hover_batch, warn_of_reynolds
from mufly.rotor.blade_files import read_blade
from mufly.rotor.blading import PLAIN, Blading, Corrections, prepare
from mufly.rotor.families import FAMILIES
from mufly.rotor.fitting import RotorFit, fit_rotor
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
from mufly.rotor.measurements import (
    Comparison,
    Measurements,
    calibrate,
    compare,
)
from mufly.rotor.pictures import (
    blade_picture,
    field_picture,
    fit_picture,
    history_picture,
    map_picture,
    plane_velocity,
    rotor_loads_picture,
    stations_picture,
    wake_picture,
)
from mufly.rotor.sections.airfoil import Airfoil, database_airfoils, load_airfoil
from mufly.rotor.sections.engines import polar, polars
from mufly.rotor.sections.polar_file import is_polar_file
from mufly.rotor.sections.polar_table import PolarStack, PolarTable, lookup, outside, stack_polars
from mufly.rotor.solution import FASTEST_TIP_M_S, METHODS, solve, solve_thrust
from mufly.rotor.system import (
    Air,
    Condition,
    Method,
    Result,
    RotorResult,
    RotorWarning,
    System,
    VortexRingWarning,
    tip_mach,
)
from mufly.rotor.uncertainty import Band, Doubt, interval

__all__ = [
    "FAMILIES",
    "FASTEST_TIP_M_S",
    "METHODS",
    "PLAIN",
    "Air",
    "Airfoil",
    "Band",
    "BatchResult",
    "BladeSections",
    "Blading",
    "Comparison",
    "Condition",
    "Corrections",
    "Doubt",
    "Measurements",
    "Method",
    "PolarStack",
    "PolarTable",
    "Result",
    "Rotor",
    "RotorFit",
    "RotorResult",
    "RotorWarning",
    "System",
    "VortexRingWarning",
    "blade_picture",
    "blade_thickness_m",
    "builtin_rotors",
    "calibrate",
    "climb_ratios",
    "coax_map",
    "compare",
    "database_airfoils",
    "field_picture",
    "fit_picture",
    "fit_rotor",
    "history_picture",
    "hover",
    "hover_batch",
    "interval",
    "is_polar_file",
    "load_airfoil",
    "load_rotor",
    "lookup",
    "make_rotor",
    "map_picture",
    "outside",
    "plane_velocity",
    "polar",
    "polars",
    "prepare",
    "read_blade",
    "replace_rotor",
    "rotor_from",
    "rotor_loads_picture",
    "rotor_toml",
    "solve",
    "solve_thrust",
    "stack_polars",
    "stations_picture",
    "tip_mach",
    "wake_picture",
    "warn_of_reynolds",
]
