"""Design studies of rotors and drives: sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.case_evaluation import (
    StudyResults,
    build_operating_condition,
    build_rotor_system,
    evaluate_cases,
    solve_case,
    solve_isolated_rotors,
)
from mufly.study.pair_optimisation import (
    PAIR_FREE_PARAMETERS,
    PairOptimum,
    optimise_pair,
    parse_pair_limit,
    verify_optimum_by_wake,
)
from mufly.study.rotor_optimisation import RotorOptimum, optimise_rotor
from mufly.study.study_parameters import (
    PAIR_PARAMETERS,
    ROTOR_PARAMETERS,
    parse_design_limit,
    parse_parameter_and_values,
    parse_parameter_settings,
    parse_parameter_value,
)
from mufly.study.study_pictures import (
    draw_gear_curve,
    draw_parameter_sweep,
    draw_ranking_extremes,
)
from mufly.study.study_setup import AERODYNAMIC_METHODS, BEMT_MODELS, StudySetup, reshape_rotor
from mufly.study.sweeps import (
    TABLE_3_3_AIRFOILS,
    expand_airfoil_names,
    list_thesis_airfoils,
    rank_airfoils,
    read_study_results,
    sweep_parameters,
    write_spanwise_loads,
    write_study_results,
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
    "build_operating_condition",
    "build_rotor_system",
    "draw_gear_curve",
    "draw_parameter_sweep",
    "draw_ranking_extremes",
    "evaluate_cases",
    "expand_airfoil_names",
    "list_thesis_airfoils",
    "optimise_pair",
    "optimise_rotor",
    "parse_design_limit",
    "parse_pair_limit",
    "parse_parameter_and_values",
    "parse_parameter_settings",
    "parse_parameter_value",
    "rank_airfoils",
    "read_study_results",
    "reshape_rotor",
    "solve_case",
    "solve_isolated_rotors",
    "sweep_parameters",
    "verify_optimum_by_wake",
    "write_spanwise_loads",
    "write_study_results",
]
