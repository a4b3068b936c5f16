"""Design studies of rotors and drives: sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.case_evaluation import (
    StudyResults,
    build_condition,
    build_system,
    evaluate_cases,
    solve_case,
    solve_isolated_rotors,
)
from mufly.study.rotor_optimisation import (
    PAIR_FREE_PARAMETERS,
    PairOptimum,
    RotorOptimum,
    optimise_pair,
    optimise_rotor,
    parse_pair_limit,
    verify_by_wake,
)
from mufly.study.study_parameters import (
    PAIR_PARAMETERS,
    ROTOR_PARAMETERS,
    parse_limit,
    parse_parameter_and_values,
    parse_parameter_settings,
    parse_parameter_value,
)
from mufly.study.study_pictures import (
    draw_gear_curve,
    draw_ranking,
    draw_sweep,
)
from mufly.study.study_setup import AERODYNAMIC_METHODS, BEMT_MODELS, StudySetup, reshape_rotor
from mufly.study.sweeps import (
    TABLE_3_3_AIRFOILS,
    expand_airfoil_names,
    rank_airfoils,
    read_results,
    sweep_parameters,
    thesis_airfoils,
    write_results,
    write_stations,
)

__all__ = [
    "AERODYNAMIC_METHODS",
    "BEMT_MODELS",
    "PAIR_FREE_PARAMETERS",
    "PAIR_PARAMETERS",
    "ROTOR_PARAMETERS",
    "TABLE_3_3_AIRFOILS",
    "PairOptimum",
    "RotorOptimum",
    "StudyResults",
    "StudySetup",
    "build_condition",
    "build_system",
    "draw_gear_curve",
    "draw_ranking",
    "draw_sweep",
    "evaluate_cases",
    "expand_airfoil_names",
    "optimise_pair",
    "optimise_rotor",
    "parse_limit",
    "parse_pair_limit",
    "parse_parameter_and_values",
    "parse_parameter_settings",
    "parse_parameter_value",
    "rank_airfoils",
    "read_results",
    "reshape_rotor",
    "solve_case",
    "solve_isolated_rotors",
    "sweep_parameters",
    "thesis_airfoils",
    "verify_by_wake",
    "write_results",
    "write_stations",
]
