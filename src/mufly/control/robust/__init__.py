"""Robustness: the structured singular value, and the bounds of a vehicle's uncertain parameters."""

from mufly.control.robust.parameter_robustness import (
    LoopRobustness,
    ParameterRobustness,
    analyse_parameter_robustness,
)
from mufly.control.robust.parameter_spreads import default_spreads
from mufly.control.robust.structured_singular_value import (
    Block,
    MuUpperBound,
    mu_upper_bound,
)

__all__ = [
    "Block",
    "LoopRobustness",
    "MuUpperBound",
    "ParameterRobustness",
    "analyse_parameter_robustness",
    "default_spreads",
    "mu_upper_bound",
]
