"""Signals with clocks of their own onto one common clock.

Between samples a signal is interpolated linearly or, if it is held (an input, a reference), keeps its last value. A
signal that is sampled faster than the new clock is first low-pass filtered without phase shift (the Kaiser-window FIR
filter of SciPy's ``resample_poly``, whose delay is taken out), so that noise above half the new rate does not fold
down; a held signal is not filtered. Where a signal has no sample within its own gap length the result is NaN: a gap
stays a gap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import resample_poly

from mufly.errors import InputError
from mufly.logs.clock import GAP_FACTOR

__all__ = ["common_clock", "euler_angles", "resample", "unwrap"]

_Array = NDArray[np.float64]
_MOST = 50_000_000


def common_clock(spans: list[tuple[float, float]], rate_hz: float) -> _Array:
    """Return instants at a rate from the first beginning to the last end, counted from the instant 0.

    Parameters
    ----------
    spans : list of (begin_s, end_s)
    rate_hz : float

    Raises
    ------
    InputError
        If that makes more than 50 million instants: then a time stamp is wrong.
    """
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    if not (last - first) * rate_hz < _MOST:
        problem = f"lasts from {first:.6g} to {last:.6g} s, at {rate_hz:.6g} Hz too many instants"
        raise InputError("the log", "time", problem, "a time stamp is wrong, or give a lower rate")
    tolerance = 1e-6
    low, high = np.ceil(first * rate_hz - tolerance), np.floor(last * rate_hz + tolerance)
    out: _Array = np.arange(low, high + 1) / rate_hz + 0.0  # no -0.0
    return out


def resample(
    time: _Array, values: _Array, onto: _Array, *, hold: bool = False, gap_s: float | None = None
) -> _Array:
    """Bring a signal onto another clock.

    Parameters
    ----------
    time : (n,) array
        Increasing (s).
    values : (n,) array
        NaN counts as missing.
    onto : (m,) array
        Increasing and evenly spaced (s).
    hold : bool
        Keep the last value instead of interpolating.
    gap_s : float, optional
        Longest step that is bridged (s). Default: five median steps of the signal.

    Returns
    -------
    (m,) array
        NaN before the first and after the last sample, and in gaps.
    """
    known = np.isfinite(values)
    t, x = time[known], values[known]
    if len(t) < 2:
        return np.full(len(onto), np.nan)
    step = float(np.median(np.diff(t)))
    longest = GAP_FACTOR * step if gap_s is None else gap_s
    new_step = float(onto[1] - onto[0]) if len(onto) > 1 else step
    slack = 1e-6 * min(step, new_step)
    before = np.searchsorted(t, onto + slack, side="right") - 1
    if hold:
        out = x[np.clip(before, 0, None)].copy()
    else:
        if new_step > 1.5 * step:
            t_even, x = _low_passed(t, x, new_step, step)
            out = np.interp(onto, t_even, x)
        else:
            out = np.interp(onto, t, x)
    # The instant is known if it lies on a sample or between two that are near each other.
    left = t[np.clip(before, 0, None)]
    right = t[np.clip(before + 1, None, len(t) - 1)]
    on_sample = np.abs(onto - left) <= slack
    bridged = right - left <= longest
    if hold:
        bridged |= (before == len(t) - 1) & (onto - left <= step)
        out[before < 0] = np.nan
    inside = (onto >= t[0] - slack) & (onto <= t[-1] + (step if hold else slack))
    out[~(inside & (on_sample | bridged))] = np.nan
    return out


def _low_passed(t: _Array, x: _Array, new_step: float, step: float) -> tuple[_Array, _Array]:
    """The signal without what lies above half the new rate, on an even clock of the new step."""
    factor = max(int(np.ceil(new_step / step)), 2)
    start = np.floor(t[0] / new_step) * new_step
    n = int(np.ceil((t[-1] - start) / new_step)) * factor + 1
    fine = start + np.arange(n) * (new_step / factor)
    even = np.interp(fine, t, x)
    low: _Array = np.asarray(resample_poly(even, 1, factor, padtype="line"), dtype=np.float64)
    return fine[::factor], low


def unwrap(angle: _Array) -> _Array:
    """Take the jumps by a full turn out of an angle (rad) over the first axis, past missing values."""
    out = angle.copy()
    for column in out.reshape(len(out), -1).T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    return out


def euler_angles(quaternion: _Array) -> _Array:
    """Return roll, pitch and yaw of quaternions that turn body axes into N-E-D.

    Parameters
    ----------
    quaternion : (n, 4) array
        w, x, y, z; need not be of length 1. One shorter than a half is no attitude.

    Returns
    -------
    (n, 3) array
        rad, in the aviation order (yaw, then pitch, then roll); NaN where there is no attitude. (Diebel 2006,
        "Representing Attitude", eq. 290.)
    """
    length = np.linalg.norm(quaternion, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = (quaternion / length[:, None]).T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    out: _Array = np.column_stack((roll, pitch, yaw))
    out[~(length > 0.5)] = np.nan
    return out
