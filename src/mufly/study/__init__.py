"""Which rotor and which drive are best? Sweeps over any parameter, rankings of airfoils, optimisation."""

from mufly.study.evaluate import Results, evaluate
from mufly.study.files import read_results, write_results
from mufly.study.parameters import PARAMETERS, parse_quantity, parse_settings, parse_values
from mufly.study.setup import Setup
from mufly.study.shape import reshape
from mufly.study.sweep import sweep

__all__ = [
    "PARAMETERS",
    "Results",
    "Setup",
    "evaluate",
    "parse_quantity",
    "parse_settings",
    "parse_values",
    "read_results",
    "reshape",
    "sweep",
    "write_results",
]
