"""Aerodynamics of rotors: airfoils, polars, blade geometry, blade element momentum theory, wakes, the coaxial pair."""

from mufly.rotor.bemt import BatchResult, solve_rotor, solve_rotor_batch, warn_reynolds_range
from mufly.rotor.blades.blade_families import BLADE_FAMILY_PRIORS
from mufly.rotor.blades.blade_files import import_rotor
from mufly.rotor.blading import TEXTBOOK_CORRECTIONS, Blading, Corrections, prepare_blading
from mufly.rotor.coax_maps import compute_coax_map, make_climb_axis_over_tip_speed
from mufly.rotor.effective_pitch import PitchOffsetPrior, estimate_pitch_offset_prior
from mufly.rotor.geometry import (
    BladeSections,
    Rotor,
    blade_thickness_m,
    format_rotor_toml,
    list_builtin_rotors,
    load_rotor,
    make_rotor,
    replace_rotor,
    rotor_from_tables,
)
from mufly.rotor.measured.bench_comparison import (
    MeasurementComparison,
    RotorMeasurements,
    calibrate_blading,
    compare_measurements,
)
from mufly.rotor.measured.rotor_fit import RotorFit, add_zero_load_points, fit_rotor
from mufly.rotor.measured.uncertainty import (
    InputUncertainty,
    PredictionInterval,
    predict_interval,
    predict_system_interval,
)
from mufly.rotor.rotor_pictures import (
    compute_shaft_plane_velocity,
    draw_blade,
    draw_coefficient_map,
    draw_flow_field,
    draw_pair_spanwise_loads,
    draw_rotor_fit,
    draw_spanwise_loads,
    draw_wake,
    draw_wake_convergence,
)
from mufly.rotor.rotor_solver import MAX_TIP_SPEED_M_S, METHODS, solve_for_thrust, solve_system
from mufly.rotor.rotor_system import (
    Air,
    OperatingCondition,
    RotorResult,
    RotorSystem,
    SolverMethod,
    SystemSolution,
    tabulate_blade_stations,
)
from mufly.rotor.sections.airfoil import Airfoil, list_database_airfoils, load_airfoil
from mufly.rotor.sections.polar_engines import compute_airfoil_polars, compute_polar
from mufly.rotor.sections.polar_file import is_polar_file
from mufly.rotor.sections.polar_table import (
    PolarStack,
    PolarTable,
    extrapolation_flags,
    lookup_lift_drag,
    stack_polars,
)
from mufly.rotor.structure import structure_pictures as _structure_pictures  # noqa: F401  draws results of the room
from mufly.rotor.structure.blade_structure import BladeStructure
from mufly.rotor.structure.elastic_rotor import ElasticRotorResult, solve_elastic_rotor
from mufly.rotor.structure.flap_modes import CampbellDiagram, FlapMode, compute_campbell, compute_flap_mode
from mufly.rotor.structure.materials import MATERIALS, Material
from mufly.rotor.validity_checks import (
    RotorValidityWarning,
    VortexRingWarning,
    compute_tip_mach,
    describe_supersonic_tips,
)

__all__ = [
    "BLADE_FAMILY_PRIORS",
    "MATERIALS",
    "MAX_TIP_SPEED_M_S",
    "METHODS",
    "TEXTBOOK_CORRECTIONS",
    "Air",
    "Airfoil",
    "BatchResult",
    "BladeSections",
    "BladeStructure",
    "Blading",
    "CampbellDiagram",
    "Corrections",
    "ElasticRotorResult",
    "FlapMode",
    "InputUncertainty",
    "Material",
    "MeasurementComparison",
    "OperatingCondition",
    "PitchOffsetPrior",
    "PolarStack",
    "PolarTable",
    "PredictionInterval",
    "Rotor",
    "RotorFit",
    "RotorMeasurements",
    "RotorResult",
    "RotorSystem",
    "RotorValidityWarning",
    "SolverMethod",
    "SystemSolution",
    "VortexRingWarning",
    "add_zero_load_points",
    "blade_thickness_m",
    "calibrate_blading",
    "compare_measurements",
    "compute_airfoil_polars",
    "compute_campbell",
    "compute_coax_map",
    "compute_flap_mode",
    "compute_polar",
    "compute_shaft_plane_velocity",
    "compute_tip_mach",
    "describe_supersonic_tips",
    "draw_blade",
    "draw_coefficient_map",
    "draw_flow_field",
    "draw_pair_spanwise_loads",
    "draw_rotor_fit",
    "draw_spanwise_loads",
    "draw_wake",
    "draw_wake_convergence",
    "estimate_pitch_offset_prior",
    "extrapolation_flags",
    "fit_rotor",
    "format_rotor_toml",
    "import_rotor",
    "is_polar_file",
    "list_builtin_rotors",
    "list_database_airfoils",
    "load_airfoil",
    "load_rotor",
    "lookup_lift_drag",
    "make_climb_axis_over_tip_speed",
    "make_rotor",
    "predict_interval",
    "predict_system_interval",
    "prepare_blading",
    "replace_rotor",
    "rotor_from_tables",
    "solve_elastic_rotor",
    "solve_for_thrust",
    "solve_rotor",
    "solve_rotor_batch",
    "solve_system",
    "stack_polars",
    "tabulate_blade_stations",
    "warn_reynolds_range",
]
