"""Which rotor and which drive are best? Sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.evaluation import Results, alone, condition_of, evaluate, solve_case, system_of
from mufly.study.optimisation import (
    PAIR_FREE,
    Optimum,
    PairOptimum,
    check_by_wake,
    optimise,
    optimise_pair,
    pair_limit,
)
from mufly.study.parameters import PAIR, PARAMETERS, parse_limit, parse_quantity, parse_settings, parse_values
from mufly.study.pictures import (
    gear_picture,
    lines_picture,
    rank_picture,
)
from mufly.study.setup import METHODS, MODELS, Setup, reshape
from mufly.study.sweeps import (
    TABLE_3_3,
    choose_airfoils,
    rank_airfoils,
    read_results,
    sweep,
    thesis_airfoils,
    write_results,
    write_stations,
)

__all__ = [
    "METHODS",
    "MODELS",
    "PAIR",
    "PAIR_FREE",
    "PARAMETERS",
    "TABLE_3_3",
    "Optimum",
    "PairOptimum",
    "Results",
    "Setup",
    "alone",
    "check_by_wake",
    "choose_airfoils",
    "condition_of",
    "evaluate",
    "gear_picture",
    "lines_picture",
    "optimise",
    "optimise_pair",
    "pair_limit",
    "parse_limit",
    "parse_quantity",
    "parse_settings",
    "parse_values",
    "rank_airfoils",
    "rank_picture",
    "read_results",
    "reshape",
    "solve_case",
    "sweep",
    "system_of",
    "thesis_airfoils",
    "write_results",
    "write_stations",
]
