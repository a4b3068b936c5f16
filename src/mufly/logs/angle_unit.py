"""Degrees or radians? A guess from the range of an angle and from its rate, with the reasons in words.

Three tests. Roll and pitch never leave +-180 deg, so values beyond 2 pi are degrees; no small helicopter turns faster
than 35 rad/s (2000 deg/s, the range of its gyroscopes), so a rate beyond is in deg/s. And the derivative of an angle is
its rate (for small angles, d(phi)/dt = p): the slope of the one over the other, both low-passed, is near 1 if both have
the same unit, near 57.3 if the angle is in degrees and the rate in rad/s, near 1/57.3 the other way round.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["UnitGuess", "guess_angle_units", "rate_ratio"]

_Array = NDArray[np.float64]
Unit = Literal["deg", "rad", ""]
_DEG = 180 / np.pi
_RATE_LIMIT = 35.0
_LEAST_CORRELATION = 0.6


class UnitGuess(NamedTuple):
    """Units of an angle and its rate (``""``: cannot be told) and the reason in words."""

    angle: Unit
    rate: Unit
    reason: str


def rate_ratio(time: _Array, angle: _Array, rate: _Array) -> tuple[float, float]:
    """Return slope and correlation of d(angle)/dt over the rate, both averaged over about a tenth of a second.

    Parameters
    ----------
    time, angle, rate : (n,) arrays
        On one clock; NaN is left out.

    Returns
    -------
    slope, correlation : float
        NaN where there is too little to compare.
    """
    known = np.isfinite(angle) & np.isfinite(rate) & np.isfinite(time)
    t, a, r = time[known], angle[known], rate[known]
    if len(t) < 20:
        return float("nan"), float("nan")
    step = float(np.median(np.diff(t)))
    width = max(1, round(0.1 / step)) if step > 0 else 1
    n = len(t) // width * width
    if n // width < 10:
        return float("nan"), float("nan")
    # Over a block, the mean rate is the difference of the angle at its ends.
    blocks = np.arange(0, n - width, width)
    span = t[blocks + width] - t[blocks]
    with np.errstate(divide="ignore", invalid="ignore"):
        change = (a[blocks + width] - a[blocks]) / span
    inner = np.concatenate(([0.0], np.cumsum(np.diff(t) * 0.5 * (r[1:] + r[:-1]))))
    mean = (inner[blocks + width] - inner[blocks]) / span
    even = span < 3 * width * step
    change, mean = change[even], mean[even]
    if len(change) < 10 or change.std() == 0 or mean.std() == 0:
        return float("nan"), float("nan")
    correlation = float(np.corrcoef(change, mean)[0, 1])
    return float(np.sign(correlation) * change.std() / mean.std()), correlation


def guess_angle_units(
    time: _Array, angle: _Array | None = None, rate: _Array | None = None, *, bounded: bool = True
) -> UnitGuess:
    """Guess whether an angle and its rate are in degrees or radians.

    Parameters
    ----------
    time : (n,) array
        s.
    angle, rate : (n,) arrays, optional
        What is known of the two; the rate is that of the same angle.
    bounded : bool
        Whether the angle stays within half a turn (roll and pitch; not an unwrapped yaw).

    Returns
    -------
    UnitGuess
        "" where neither range nor consistency tells.
    """
    peak = _peak(angle)
    fast = _peak(rate)
    by_angle: Unit = "deg" if bounded and peak > 2 * np.pi else ""
    by_rate: Unit = "deg" if fast > _RATE_LIMIT else ""
    reasons = []
    if by_angle:
        reasons.append(f"values up to {peak:.3g} are no radians")
    if by_rate:
        reasons.append(f"rates up to {fast:.3g} are too fast for rad/s")
    if angle is not None and rate is not None:
        slope, correlation = rate_ratio(time, angle, rate)
        if abs(correlation) > _LEAST_CORRELATION:
            kind = int(np.rint(np.log(abs(slope)) / np.log(_DEG)))
            said = f"d/dt of the angle is {slope:.3g} times the rate"
            if kind == 1:
                return UnitGuess("deg", "rad", said)
            if kind == -1:
                return UnitGuess("rad", "deg", said)
            if kind == 0:
                both: Unit = "deg" if by_angle or by_rate else "rad"
                if both == "rad" and peak < 0.2 and fast < 1.0:
                    both = ""  # a few degrees or a few radians: consistent, and nothing to tell them apart
                return UnitGuess(both, both, "; ".join([*reasons, said]))
    if not reasons and bounded and np.isfinite(peak) and 1.0 < peak <= np.pi:
        # In degrees this would be a vehicle that never tilts by four.
        return UnitGuess("", by_rate, f"values up to {peak:.3g} could be either")
    return UnitGuess(by_angle, by_rate, "; ".join(reasons))


def _peak(x: _Array | None) -> float:
    """The size that all but a thousandth of the values stay below, so that single outliers decide nothing."""
    if x is None or not np.isfinite(x).any():
        return float("nan")
    return float(np.quantile(np.abs(x[np.isfinite(x)]), 0.999))
