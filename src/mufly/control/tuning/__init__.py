"""Controllers of fixed order, tuned for several aims at once by a minimiser for functions with kinks."""

from mufly.control.tuning.nonsmooth_bfgs import Minimum, minimise_nonsmooth

__all__ = ["Minimum", "minimise_nonsmooth"]
