"""The speed or the pitch at which a rotor gives a thrust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.hover import Air, RotorResult, hover, hover_batch

__all__ = ["FASTEST_TIP_M_S", "solve_thrust"]

Array = NDArray[np.float64]

FASTEST_TIP_M_S = 240.0
"""Tip speed (m/s) above which air is no longer incompressible, as polars and theory take it to be: Mach 0.7."""


def solve_thrust(
    blading: Blading | Rotor,
    *,
    thrust_N: float,
    pitch_rad: float | None = None,
    speed_rad_s: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    speed_limits_rad_s: tuple[float, float] | None = None,
    pitch_limits_rad: tuple[float, float] = (-0.35, 0.7),
    which: int = 0,
) -> RotorResult:
    """Find the speed (at given pitch) or the pitch (at given speed) that gives a thrust.

    Give exactly one of ``pitch_rad`` and ``speed_rad_s``; the other is found, to 1e-9 of its range. The unknown
    is sought on 64 points between its limits first, and then between the two lowest ones that enclose the
    thrust, so that of two pitches with the same thrust, below and beyond stall, the lower is returned. Speeds are
    sought up to :data:`FASTEST_TIP_M_S` at the tip.

    Raises
    ------
    InputError
        If neither or both are given, or no value within the limits gives the thrust; the message names the
        greatest thrust there is.
    """
    if (pitch_rad is None) == (speed_rad_s is None):
        raise InputError("rotor", "thrust", "needs one of pitch and speed", "give one; the other is found")
    by_speed, case = speed_rad_s is None, as_blading(blading)
    fastest = FASTEST_TIP_M_S / float(case.radius_m[which])
    low, high = (speed_limits_rad_s or (1.0, fastest)) if by_speed else pitch_limits_rad
    grid = np.geomspace(low, high, 64) if by_speed else np.linspace(low, high, 64)

    def thrust(values: Array) -> Array:
        pitch, speed = (pitch_rad, values) if by_speed else (values, speed_rad_s)
        assert pitch is not None
        assert speed is not None
        return hover_batch(
            case, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb_m_s, air=air, which=which
        ).thrust_N

    for _ in range(8):  # each pass narrows the interval by 63, to below 1e-13 of the first
        short = thrust(grid) - thrust_N
        cross = np.flatnonzero((short[:-1] <= 0.0) & (short[1:] >= 0.0))
        if cross.size == 0:
            key, unit = ("speed", "rad/s") if by_speed else ("pitch", "rad")
            reached = float(short.max() + thrust_N)
            raise InputError(
                "rotor", "thrust", f"{thrust_N:g} N is out of reach: at most {reached:.4g} N",
                f"ask for less, or widen the {key} limits ({low:g} to {high:g} {unit})",
            )  # fmt: skip
        i = int(cross[0])
        if grid[i + 1] - grid[i] <= 1e-12 * max(abs(grid[i]), 1e-3):
            break
        grid = np.linspace(grid[i], grid[i + 1], 64)
    x = float(grid[i] if abs(short[i]) <= abs(short[i + 1]) else grid[i + 1])
    if by_speed:
        assert pitch_rad is not None
        return hover(case, pitch_rad=pitch_rad, speed_rad_s=x, climb_m_s=climb_m_s, air=air, which=which)
    assert speed_rad_s is not None
    return hover(case, pitch_rad=x, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air, which=which)
