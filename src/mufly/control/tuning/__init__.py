"""Controllers of fixed order, tuned for several aims at once by a minimiser for functions with kinks."""

from mufly.control.tuning.fixed_order import (
    NormAim,
    TunedController,
    flight_aims,
    reduce_start_controllers,
    tune_controller,
)
from mufly.control.tuning.nonsmooth_bfgs import Minimum, minimise_nonsmooth

__all__ = [
    "Minimum",
    "NormAim",
    "TunedController",
    "flight_aims",
    "minimise_nonsmooth",
    "reduce_start_controllers",
    "tune_controller",
]
