"""Which rotor and which drive are best? Sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.evaluation import PairPoint, PairSetup, Results, alone, bladings_of, evaluate, solve_pair
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
    blade_picture,
    field_picture,
    gear_picture,
    history_picture,
    lines_picture,
    map_picture,
    rank_picture,
    rotor_loads_picture,
    stations_picture,
    wake_picture,
)
from mufly.study.ranking import TABLE_3_3, choose_airfoils, rank_airfoils, thesis_airfoils
from mufly.study.setup import METHODS, MODELS, Setup, reshape
from mufly.study.sweeps import read_results, sweep, sweep_pairs, write_results, write_stations

__all__ = [
    "METHODS",
    "MODELS",
    "PAIR",
    "PAIR_FREE",
    "PARAMETERS",
    "TABLE_3_3",
    "Optimum",
    "PairOptimum",
    "PairPoint",
    "PairSetup",
    "Results",
    "Setup",
    "alone",
    "blade_picture",
    "bladings_of",
    "check_by_wake",
    "choose_airfoils",
    "evaluate",
    "field_picture",
    "gear_picture",
    "history_picture",
    "lines_picture",
    "map_picture",
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
    "rotor_loads_picture",
    "solve_pair",
    "stations_picture",
    "sweep",
    "sweep_pairs",
    "thesis_airfoils",
    "wake_picture",
    "write_results",
    "write_stations",
]
