"""What a filter believes beyond position, velocity, attitude and rates, and what it thinks of each of its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]

ERROR_STATES: tuple[str, ...] = (
    "position_N", "position_E", "position_D",
    "velocity_N", "velocity_E", "velocity_D",
    "turn_N", "turn_E", "turn_D",
    "gyro_bias_p", "gyro_bias_q", "gyro_bias_r",
    "accelerometer_bias_x", "accelerometer_bias_y", "accelerometer_bias_z",
    "floor_height",
    "fix_bias_N", "fix_bias_E", "fix_bias_D", "fix_bias_heading",
    "wind_N", "wind_E",
    "thrust_scale",
    "pressure_bias",
    "magnetic_heading_bias",
)  # fmt: skip
"""The error state, in order: m, m/s, rad (turns about N, E, D), rad/s, m/s^2, m, m and rad, m/s, 1, Pa, rad."""

Status = Literal["fused", "rejected", "missing", "faulty", "waiting"]


@dataclass(frozen=True, slots=True)
class Check:
    """What is thought of one sensor.

    Attributes
    ----------
    name : str
        Of its reading (:data:`mufly.sensors.READINGS`).
    status : str
        ``"fused"``: believed. ``"rejected"``: it comes, but what it says does not fit. ``"missing"``: it was there and
        comes no more. ``"faulty"``: what it says cannot be right in itself. ``"waiting"``: not needed, or nothing yet.
    innovation, sigma, ratio : float
        Of its worst component: reading less what was expected, the deviation that this was expected to have (both in
        SI units), and the quotient.
    age_s : float
        Since the last measurement that was used (s).
    reason : str
        Why it is so, in plain words; empty while all is well.
    """

    name: str
    status: Status = "waiting"
    innovation: float = 0.0
    sigma: float = 0.0
    ratio: float = 0.0
    age_s: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What a filter believes besides the motion.

    Attributes
    ----------
    gyro_bias : (3,) array
        (rad/s), body axes.
    accelerometer_bias : (3,) array
        (m/s^2), body axes.
    floor_height : float
        Of the surface under the sonar above D = 0 (m, positive up).
    fix_bias : (4,) array
        What the position fix is off by: N, E, D (m), heading (rad).
    wind : (2,) array
        N, E (m/s).
    thrust_scale : float
        True thrust over that of the model (1).
    sigma : (n,) array
        Standard deviations of the whole error state, in the order of :data:`ERROR_STATES`.
    checks : sequence of Check
        One for each sensor of the vehicle.
    """

    gyro_bias: _Array
    accelerometer_bias: _Array
    floor_height: float
    fix_bias: _Array
    wind: _Array
    thrust_scale: float
    sigma: _Array
    checks: Sequence[Check] = ()
