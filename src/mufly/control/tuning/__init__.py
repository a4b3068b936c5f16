"""Controllers of fixed order, tuned for several aims at once by a minimiser for functions with kinks."""

from mufly.control.tuning.fixed_order import Aim, TunedController, flight_aims, reduced_starts, tune_controller
from mufly.control.tuning.nonsmooth_bfgs import Minimum, minimise_nonsmooth

__all__ = [
    "Aim",
    "Minimum",
    "TunedController",
    "flight_aims",
    "minimise_nonsmooth",
    "reduced_starts",
    "tune_controller",
]
