"""Which rotor and which drive are best? Sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.airfoils import TABLE_3_3, choose_airfoils, thesis_airfoils
from mufly.study.evaluate import Results, evaluate
from mufly.study.files import read_results, write_results, write_stations
from mufly.study.limits import parse_limit
from mufly.study.map_pictures import map_picture
from mufly.study.optimise import Optimum, optimise
from mufly.study.parameters import PARAMETERS, parse_quantity, parse_settings, parse_values
from mufly.study.pictures import gear_picture, lines_picture, rank_picture
from mufly.study.rank import rank_airfoils
from mufly.study.rotor_pictures import blade_picture, stations_picture
from mufly.study.setup import MODELS, Setup
from mufly.study.shape import reshape
from mufly.study.sweep import sweep

__all__ = [
    "MODELS",
    "PARAMETERS",
    "TABLE_3_3",
    "Optimum",
    "Results",
    "Setup",
    "blade_picture",
    "choose_airfoils",
    "evaluate",
    "gear_picture",
    "lines_picture",
    "map_picture",
    "optimise",
    "parse_limit",
    "parse_quantity",
    "parse_settings",
    "parse_values",
    "rank_airfoils",
    "rank_picture",
    "read_results",
    "reshape",
    "stations_picture",
    "sweep",
    "thesis_airfoils",
    "write_results",
    "write_stations",
]
