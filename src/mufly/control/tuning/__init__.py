"""Controllers of fixed order, tuned for several goals at once by a minimiser for functions with kinks."""

from mufly.control.tuning.fixed_order import (
    NormGoal,
    TunedController,
    make_flight_goals,
    reduce_start_controllers,
    tune_controller,
)
from mufly.control.tuning.nonsmooth_bfgs import Minimum, minimise_nonsmooth

__all__ = [
    "Minimum",
    "NormGoal",
    "TunedController",
    "make_flight_goals",
    "minimise_nonsmooth",
    "reduce_start_controllers",
    "tune_controller",
]
