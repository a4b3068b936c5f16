"""Outliers, drop-outs and saturation of one channel. One function a fault.

Outliers are found as Hampel's filter finds them (Hampel 1974; Pearson et al. 2016, "Generalized Hampel Filters"):
further from the median of a short window than so many robust standard deviations. The spread is taken from a window ten
times as long, since seven samples tell it badly, and is at least the typical step from sample to sample, so that the
crest of a fast but smooth motion is none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, percentile_filter

__all__ = ["find_frozen", "find_outliers", "find_saturation"]

_Array = NDArray[np.float64]
_MAD = 1.4826


def find_outliers(x: _Array, *, half_window: int = 3, sigmas: float = 7.0) -> NDArray[np.int64]:
    """Return the samples that stand alone, up to ``half_window`` in a row.

    Parameters
    ----------
    x : (n,) array
        On its own clock: interpolated signals have corners that look like outliers. NaN is no outlier.
    half_window : int
        Samples on either side of the one that is judged.
    sigmas : float
        Robust standard deviations that a sample may lie from the median of its window. Of Gaussian noise, 7 with this
        window flags fewer than one sample in a million.

    Returns
    -------
    (k,) int array
    """
    known = np.flatnonzero(np.isfinite(x))
    values = x[known]
    wide = 20 * half_window + 1
    if len(values) < wide:
        return np.empty(0, dtype=np.int64)
    away = np.abs(values - median_filter(values, size=2 * half_window + 1, mode="nearest"))
    step = np.abs(np.diff(values, append=values[-1]))
    spread = np.maximum(
        _MAD * median_filter(away, size=wide, mode="nearest"), median_filter(step, size=wide, mode="nearest")
    )
    quantum = float(step[step > 0].min()) if (step > 0).any() else 0.0
    floor = max(0.5 * float(np.median(spread)), quantum, 1e-12 * float(np.abs(values).max()))
    # In the course of a manoeuvre large steps are common; of Gaussian noise, a tenth of all steps exceeds 2.3 sigma.
    usual = 3 * percentile_filter(step, 90, size=wide, mode="nearest")
    flagged = away > np.maximum(sigmas * np.maximum(spread, floor), usual)
    # Coarse signals step by many quanta as a rule: where steps of that size are common they are no outliers.
    if (step > 0).mean() < 0.2 and (step > 0).any():
        flagged &= away > 5 * float(np.median(step[step > 0]))
    out = known[flagged]
    return np.asarray(out[_short_runs(out, half_window)], dtype=np.int64)


def _short_runs(index: NDArray[np.int64], longest: int) -> NDArray[np.bool_]:
    """Which of the increasing indices belong to runs of at most ``longest`` neighbours."""
    if not len(index):
        return np.empty(0, dtype=bool)
    run = np.cumsum(np.append(0, np.diff(index) > 1))
    return np.asarray(np.bincount(run)[run] <= longest)


def _runs(flag: NDArray[np.bool_]) -> NDArray[np.int64]:
    """First and past-the-last index of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    return edges.reshape(-1, 2)


def find_frozen(x: _Array, *, at_least: int = 8) -> NDArray[np.int64]:
    """Return runs of one repeated value in a channel that otherwise changes at every sample.

    Parameters
    ----------
    x : (n,) array
    at_least : int
        Length of the shortest run that counts.

    Returns
    -------
    (k, 2) int array
        First and past-the-last sample. Empty for a channel that repeats itself as a rule (held inputs, coarse
        resolution): more than a fifth of its samples are like the one before. What stands still at the beginning or the
        end of the record has not begun yet, or is over.
    """
    same = np.diff(x) == 0
    if len(x) < 4 * at_least or same.mean() > 0.2:
        return np.empty((0, 2), dtype=np.int64)
    runs = _runs(same) + np.array([0, 1])
    inner = (runs[:, 0] > 0) & (runs[:, 1] < len(x))
    return runs[inner & (runs[:, 1] - runs[:, 0] >= at_least)]


def find_saturation(x: _Array, *, at_least: int = 5) -> tuple[float, float]:
    """Return the share of samples that sit at the channel's minimum and at its maximum.

    Only values that are held there for ``at_least`` samples at a time count, and only at an end of the range that the
    channel meets more often than the values just beside it (a clipped signal piles up at the limit; a signal with a
    few levels piles up everywhere).
    """
    values = x[np.isfinite(x)]
    if len(values) < 10 * at_least or values.min() == values.max():
        return 0.0, 0.0
    levels = np.unique(values)
    if len(levels) < 10:
        return 0.0, 0.0
    shares = []
    margin = 0.02 * (levels[-1] - levels[0])
    for limit, near in (
        (levels[0], values <= levels[0] + margin),
        (levels[-1], values >= levels[-1] - margin),
    ):
        runs = _runs(values == limit)
        runs = runs[runs[:, 1] - runs[:, 0] >= at_least]
        held = int((runs[:, 1] - runs[:, 0]).sum())
        shares.append(held / len(values) if held > 0.5 * near.sum() else 0.0)
    return shares[0], shares[1]
