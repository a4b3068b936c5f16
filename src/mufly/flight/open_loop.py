"""Motors without a controller: speeding up and running down on the floor, and coming down when measurements are lost.

Two rotors at a share s of the voltages that hold the helicopter up turn s times as fast and lift s^2 times as much.
Speeding up to 0.9 leaves a fifth of the weight on the legs. Sinking blindly at 0.98 the weight is 0.04 short: it falls
at 0.04 g and touches down from 2 m at 1.3 m/s (drag left out).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.mission import RAMP_DOWN_S, SPIN_UP_S

__all__ = ["ramp_down", "sink", "spin_up", "way_down_s"]

SPIN_UP_SHARE = 0.9
SINK_SHARE = 0.98
_MARGIN_S = 1.0

_Array = NDArray[np.floating[Any]]


def spin_up(hover_V: _Array, elapsed_s: float, battery_V: float) -> _Array:
    """Motor inputs (2,) while the rotors speed up, ``elapsed_s`` (s) after they began.

    Half of the time is to rise, half for the slow upper rotor to follow.

    Parameters
    ----------
    hover_V : (2,) array
        Motor voltages of hover (V).
    elapsed_s, battery_V : float
    """
    share = SPIN_UP_SHARE * min(1.0, 2.0 * elapsed_s / SPIN_UP_S)
    return np.minimum(share * hover_V / battery_V, 1.0)


def ramp_down(released: _Array, elapsed_s: float) -> _Array:
    """Motor inputs (2,) after touchdown: from ``released`` (2,) to zero within a second."""
    return released * max(0.0, 1.0 - elapsed_s / RAMP_DOWN_S)


def sink(held_up_V: _Array, left_s: float, battery_V: float) -> _Array:
    """Motor inputs (2,) of a blind way down: a little below what held it up (V), to zero in its last second."""
    share = SINK_SHARE * min(1.0, left_s / RAMP_DOWN_S)
    return np.minimum(share * held_up_V / battery_V, 1.0)


def way_down_s(height_m: float, gravity: float) -> float:
    """How long a blind way down takes from a height (m), with a second to spare (s); ``gravity`` in m/s2."""
    return math.sqrt(2.0 * max(0.0, height_m) / ((1.0 - SINK_SHARE**2) * gravity)) + _MARGIN_S
