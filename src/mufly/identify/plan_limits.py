"""How far a planned flight may go: limits on motion and inputs, and which of them a flight comes nearest to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import euler_from_quaternion

__all__ = ["Limits"]

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Limits:
    """How far a flight may go from its hover, and how near inputs may come to their ends.

    Attributes
    ----------
    attitude_rad, heading_rad, rates_rad_s : float
        Roll and pitch; yaw; any body rate.
    height_m, place_m : float
        Up and down; across.
    motor, servo : float
        Motor inputs stay within ``motor`` to ``1 - motor``; servo inputs within ``1 - servo``.
    """

    attitude_rad: float = math.radians(20)
    heading_rad: float = math.radians(90)
    rates_rad_s: float = 4.0
    height_m: float = 0.5
    place_m: float = 1.0
    motor: float = 0.05
    servo: float = 0.1

    def used(self, states: Array, inputs: Array) -> tuple[Array, list[str]]:
        """Return the share of every limit that flights (b, n, ...) use, (b, limits), and the limits' names."""
        angle = euler_from_quaternion(states[..., 6:10])
        heading = np.unwrap(angle[..., 2], axis=1)
        at = states[..., 0:3] - states[:, :1, 0:3]
        shares = {
            "attitude": np.abs(angle[..., :2]).max(axis=(1, 2)) / self.attitude_rad,
            "heading": np.abs(heading - heading[:, :1]).max(axis=1) / self.heading_rad,
            "body rates": np.abs(states[..., 10:13]).max(axis=(1, 2)) / self.rates_rad_s,
            "height": np.abs(at[..., 2]).max(axis=1) / self.height_m,
            "place": np.linalg.norm(at[..., :2], axis=2).max(axis=1) / self.place_m,
            "motor input": np.abs(inputs[..., :2] - 0.5).max(axis=(1, 2)) / (0.5 - self.motor),
            "servo input": np.abs(inputs[..., 2:]).max(axis=(1, 2)) / (1.0 - self.servo),
        }
        table = np.column_stack(list(shares.values()))
        return np.where(np.isfinite(table), table, np.inf), list(shares)
