"""How to move along a line in time: rest to rest, with limits on speed and acceleration.

The speed rises from 0 to its peak V as V S(t / T_a), stays there, and falls the same way, with the quintic step

    S(x) = 10 x^3 - 15 x^4 + 6 x^5,   S' = 30 x^2 (1 - x)^2,   integral_0^x S = 5/2 x^4 - 3 x^5 + x^6,

so that acceleration and jerk are continuous and zero at both ends. S' peaks at 15/8, hence T_a = 15 V / (8 a) uses
the whole acceleration a; since integral_0^1 S = 1/2 both ramps together cover V T_a. A way d shorter than that is
flown with the lower peak V = sqrt(8 a d / 15) and no cruise. Own derivation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Profile", "profile", "step_down", "step_down_way"]

_PEAK = 15.0 / 8.0


@dataclass(frozen=True, slots=True)
class Profile:
    """Way over time, from rest to rest.

    Attributes
    ----------
    way : float
        Total way (m or rad), not negative.
    speed : float
        Peak speed (1/s of that).
    ramp_s, cruise_s : float
        Duration of one ramp and of the cruise (s).
    """

    way: float
    speed: float
    ramp_s: float
    cruise_s: float

    @property
    def duration_s(self) -> float:
        """Time from rest to rest (s)."""
        return 2.0 * self.ramp_s + self.cruise_s

    def at(self, t: float) -> tuple[float, float, float]:
        """Way, speed and acceleration at time ``t`` (s); at rest before 0 and after the end."""
        ramp = self.ramp_s
        if t <= 0.0 or ramp == 0.0:
            return (0.0 if t <= 0.0 else self.way), 0.0, 0.0
        left = 2.0 * ramp + self.cruise_s - t
        if left <= 0.0:
            return self.way, 0.0, 0.0
        if t >= ramp and left >= ramp:
            return self.speed * (t - 0.5 * ramp), self.speed, 0.0
        x = min(t, left) / ramp
        x2 = x * x
        way = self.speed * ramp * x2 * x2 * (2.5 - 3.0 * x + x2)
        speed = self.speed * x2 * x * (10.0 - 15.0 * x + 6.0 * x2)
        acceleration = self.speed / ramp * 30.0 * x2 * (1.0 - x) ** 2
        return (way, speed, acceleration) if t < left else (self.way - way, speed, -acceleration)


def profile(way: float, speed: float, acceleration: float) -> Profile:
    """Make the quickest profile of this family.

    Parameters
    ----------
    way : float
        Way to go (m or rad), at least 0.
    speed, acceleration : float
        Limits, above 0.

    Returns
    -------
    Profile
        Its speed and acceleration never exceed the limits and reach at least one of them.
    """
    if way <= 0.0:
        return Profile(0.0, 0.0, 0.0, 0.0)
    peak = min(speed, math.sqrt(acceleration * way / _PEAK))
    ramp = _PEAK * peak / acceleration
    return Profile(way, peak, ramp, max(0.0, way / peak - ramp))


def step_down(x: float) -> tuple[float, float, float]:
    """Smooth step from 1 to 0 over x in [0, 1]: value 1 - S, its slope, and its integral from 0 to x."""
    if x <= 0.0:
        return 1.0, 0.0, 0.0
    if x >= 1.0:
        return 0.0, 0.0, 0.5
    x2 = x * x
    return (
        1.0 - x2 * x * (10.0 - 15.0 * x + 6.0 * x2),
        -30.0 * x2 * (1.0 - x) ** 2,
        x - x2 * x2 * (2.5 - 3.0 * x + x2),
    )


def step_down_way(speed: float, acceleration: float) -> tuple[float, float]:
    """Time (s) and way to stop from ``speed`` with `step_down` and no more than ``acceleration``."""
    duration = _PEAK * abs(speed) / acceleration
    return duration, 0.5 * abs(speed) * duration
