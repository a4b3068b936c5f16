"""What the flight software is told at one instant: a table of measured values on the clock of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Measurement"]


@dataclass(frozen=True, slots=True)
class Measurement:
    """Measured values at one instant.

    Attributes
    ----------
    time_s : float
        Time since the start of the recording.
    position : (3,) array
        N, E, D (m), of the centre of gravity.
    velocity : (3,) array
        N, E, D (m/s).
    attitude : (3,) array
        Roll, pitch, yaw (rad); yaw is continuous (it does not jump at +-pi).
    rates : (3,) array
        p, q, r (rad/s), body axes.
    ranges : (n,) array
        Distance to the nearest obstacle along each beam of the range ring (m); the ring's greatest range
        where nothing was seen.
    battery_voltage : float
        Terminal voltage (V).
    """

    time_s: float
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    attitude: NDArray[np.float64]
    rates: NDArray[np.float64]
    ranges: NDArray[np.float64]
    battery_voltage: float
