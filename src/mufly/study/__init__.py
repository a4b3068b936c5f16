"""Which rotor and which drive are best? Sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.airfoils import TABLE_3_3, choose_airfoils, thesis_airfoils
from mufly.study.evaluate import Results, evaluate
from mufly.study.files import read_results, write_results, write_stations
from mufly.study.limits import parse_limit
from mufly.study.map_pictures import map_picture
from mufly.study.optimise import Optimum, optimise
from mufly.study.pair import PairPoint, PairSetup, alone, bladings_of, solve_pair
from mufly.study.pair_optimise import PAIR_FREE, PairOptimum, check_by_wake, optimise_pair, pair_limit
from mufly.study.pair_sweep import sweep_pairs
from mufly.study.parameters import PAIR, PARAMETERS, parse_quantity, parse_settings, parse_values
from mufly.study.pictures import gear_picture, lines_picture, rank_picture
from mufly.study.rank import rank_airfoils
from mufly.study.rotor_pictures import blade_picture, stations_picture
from mufly.study.setup import METHODS, MODELS, Setup
from mufly.study.shape import reshape
from mufly.study.sweep import sweep
from mufly.study.wake_pictures import field_picture, history_picture, rotor_loads_picture, wake_picture

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
