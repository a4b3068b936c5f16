"""Checks of log channels: missing values, constant, frozen, saturated, outliers; degrees instead of radians.

Outliers are found by Hampel's filter (Hampel 1974; Pearson et al. 2016, "Generalized Hampel Filters"): their distance
to the median of a short window exceeds a number of robust standard deviations. The standard deviation comes from a
window ten times as long, because seven samples determine it poorly. It is at least the typical step between samples,
so that the crest of a fast but smooth motion is no outlier.

Three tests distinguish degrees from radians. Roll and pitch stay within +-180 deg, so values beyond 2 pi are degrees.
No small helicopter turns faster than 35 rad/s (2000 deg/s, the range of its gyroscopes), so a larger rate is in deg/s.
The derivative of an angle is its rate (for small angles, d(phi)/dt = p). The slope of the derivative over the rate,
both low-passed, is near 1 for equal units, near 57.3 for an angle in degrees and a rate in rad/s, and near 1/57.3 in
the opposite case. Any other slope shows that angle and rate do not belong together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import median_filter, percentile_filter

from mufly.logs.mcap import split_dataset_into_channels
from mufly.logs.raw_log import Channel
from mufly.quantities.quantity_table import find_physical_limits, is_command_signal
from mufly.results import result

_Array = NDArray[np.float64]
_MAX_EXAMINED_SAMPLES = 400_000


@result
class ChannelReport:
    """Statistics and faults of one channel, from :func:`examine_channel`.

    Attributes
    ----------
    name, units : str
    samples : int
    nan_fraction : float
        Share of NaN.
    constant : bool
    smallest, largest, mean, std : float
        Statistics of the finite values.
    outlier_times_s : tuple of float
        Times of the outliers (s).
    frozen_intervals_s : tuple of (begin_s, end_s)
        Stretches of one repeated value (s).
    at_minimum_fraction, at_maximum_fraction : float
        Share of samples at the limits.
    """

    name: str
    units: str
    samples: int
    nan_fraction: float
    constant: bool = False
    smallest: float = math.nan
    largest: float = math.nan
    mean: float = math.nan
    std: float = math.nan
    outlier_times_s: tuple[float, ...] = ()
    frozen_intervals_s: tuple[tuple[float, float], ...] = ()
    at_minimum_fraction: float = 0.0
    at_maximum_fraction: float = 0.0

    def describe_faults(self) -> list[str]:
        """Return one sentence per fault, except for a constant channel; empty for a faultless channel."""
        unit = "" if self.units in ("", "1") else f" {self.units}"
        out = []
        if self.nan_fraction == 1:
            return [f"{self.name}: no values"]
        if self.nan_fraction > 0:
            out.append(f"{self.name}: {100 * self.nan_fraction:.2g} % of the values are missing")
        if self.constant:
            return out  # LogReport.faults reports all constant channels in one sentence
        if self.outlier_times_s:
            many = "1 outlier" if len(self.outlier_times_s) == 1 else f"{len(self.outlier_times_s)} outliers"
            out.append(f"{self.name}: {many}, at {_format_times(self.outlier_times_s)} s")
        if self.frozen_intervals_s:
            longest = max(b - a for a, b in self.frozen_intervals_s)
            many = (
                "drops out once"
                if len(self.frozen_intervals_s) == 1
                else f"drops out {len(self.frozen_intervals_s)} times"
            )
            at = _format_times([a for a, _ in self.frozen_intervals_s])
            out.append(f"{self.name}: {many} (one value repeated, {longest:.3g} s at most), at {at} s")
        for share, limit, word in (
            (self.at_minimum_fraction, self.smallest, "minimum"),
            (self.at_maximum_fraction, self.largest, "maximum"),
        ):
            if share > 0:
                out.append(f"{self.name}: {100 * share:.2g} % of the values sit at its {word}, {limit:.4g}{unit}")
        return out


def _format_times(times: Any) -> str:
    shown = [f"{t:.2f}" for t in list(times)[:4]]
    return ", ".join(shown) + (", ..." if len(times) > 4 else "")


def examine_channel(time: _Array, x: _Array, name: str, units: str = "") -> ChannelReport:
    """Return the statistics of a channel, and its outliers, frozen values and saturation.

    Parameters
    ----------
    time : (n,) array
        Time (s).
    x : (n,) array
        Values, in ``units``; NaN is missing.
    name, units : str
    """
    known = x[np.isfinite(x)]
    if not len(known):
        return ChannelReport(name, units, len(x), 1.0 if len(x) else 0.0)
    # A reference at a limit is intended, and the truth of a simulation has no faults.
    planned = name.startswith(("reference_", "truth_"))
    low, high = (0.0, 0.0) if planned else compute_saturated_fractions(x)
    held = planned or is_command_signal(name)
    return ChannelReport(
        name=name,
        units=units,
        samples=len(x),
        nan_fraction=1 - len(known) / len(x),
        constant=bool(len(known) > 1 and known.min() == known.max()),
        smallest=float(known.min()),
        largest=float(known.max()),
        mean=float(known.mean()),
        std=float(known.std()),
        outlier_times_s=() if held else tuple(time[find_outliers(x)].tolist()),
        frozen_intervals_s=() if held else tuple((float(time[a]), float(time[b - 1])) for a, b in find_frozen_runs(x)),
        at_minimum_fraction=low,
        at_maximum_fraction=high,
    )


def numeric_channels(data: xr.Dataset) -> list[Channel]:
    """Return the numeric channels of a dataset, component by component."""
    numbers = [c for c in split_dataset_into_channels(data) if c.values.dtype.kind in "fiub"]
    return [c._replace(values=c.values.astype(np.float64)) for c in numbers]


def examine_channels(
    channels: Sequence[Channel], progress: Callable[[int, int], None] | None = None
) -> list[ChannelReport]:
    """Return a report on each channel's first 400 000 samples; ``progress`` is called with (done, all)."""
    out = []
    for k, c in enumerate(channels):
        part = slice(_MAX_EXAMINED_SAMPLES)
        out.append(examine_channel(c.time[part], c.values[part], c.name, c.units))
        if progress is not None:
            progress(k + 1, len(channels))
    return out


# Largest fraction of values outside the limits that count as outliers; a larger fraction indicates a wrong unit.
_MAX_REMOVED_FRACTION = 0.05


def apply_physical_limits(
    channels: Sequence[Channel], assumed: Callable[[Channel], bool]
) -> tuple[list[Channel], list[str]]:
    """Check signals against the physical limits of their quantities
    (:data:`mufly.quantities.quantity_table.PHYSICAL_LIMITS`).

    Parameters
    ----------
    channels : sequence of Channel
        Channels in SI units.
    assumed : callable
        Function that returns whether the unit of a channel is only assumed by this package. If so, single values
        outside the limits become missing, and a signal outside them is omitted. A channel whose unit the user or the
        header states is kept, and the contradiction is reported.

    Returns
    -------
    channels : list of Channel
    words : list of str
        One sentence per signal.
    """
    groups: dict[str, list[Channel]] = {}
    for c in channels:
        groups.setdefault(c.signal_name, []).append(c)
    out: dict[str, Channel | None] = {c.name: c for c in channels}
    words = []
    for variable, group in groups.items():
        limits = find_physical_limits(variable)
        group = [c for c in group if not c.is_text]
        if limits is None or not group:
            continue
        bad = [(c.values < limits.low) | (c.values > limits.high) for c in group]
        count = sum(int(b.sum()) for b in bad)
        if not count:
            continue
        first = next(c for c, b in zip(group, bad, strict=True) if b.any())
        what = f"{variable} ({first.source})" if first.source else variable
        peak = max((v for c, b in zip(group, bad, strict=True) for v in c.values[b].tolist()), key=abs)
        unit = "" if first.units in ("", "1") else f" {first.units}"
        most = max(float(b.sum()) / max(int(np.isfinite(c.values).sum()), 1) for c, b in zip(group, bad, strict=True))
        if not assumed(first):
            words.append(f"{what} reaches {peak:.4g}{unit}, but {limits.reason}: is its unit right?")
        elif most <= _MAX_REMOVED_FRACTION:
            many = "1 value is" if count == 1 else f"{count} values are"
            words.append(f"{what}: {many} implausible ({peak:.4g}{unit}; {limits.reason}) and replaced by NaN")
            out |= {c.name: c._replace(values=np.where(b, np.nan, c.values)) for c, b in zip(group, bad, strict=True)}
        else:
            words.append(
                f"{what} reaches {peak:.4g}{unit}, but {limits.reason}: not used; give its unit in a column map"
            )
            out |= dict.fromkeys(c.name for c in group)
    return [c for c in out.values() if c is not None], words


_MAD_TO_STD = 1.4826
_MEDIAN_HALF_WINDOW_SAMPLES = 3  # samples on either side of the judged one; longest run of outliers
_OUTLIER_THRESHOLD_SIGMAS = 7.0  # flags fewer than one sample in a million of Gaussian noise
_MIN_FROZEN_SAMPLES, _MIN_SATURATED_SAMPLES = 8, 5  # samples of a run


def find_outliers(x: _Array) -> NDArray[np.int64]:
    """Return the indices of outliers: at most 3 successive samples far from the median of their neighbours.

    Parameters
    ----------
    x : (n,) array
        Signal on its own clock, because corners of interpolated signals resemble outliers. NaN is no outlier.

    Returns
    -------
    (k,) int array
    """
    known = np.flatnonzero(np.isfinite(x))
    values = x[known]
    wide = 20 * _MEDIAN_HALF_WINDOW_SAMPLES + 1
    if len(values) < wide:
        return np.empty(0, dtype=np.int64)
    away = np.abs(values - median_filter(values, size=2 * _MEDIAN_HALF_WINDOW_SAMPLES + 1, mode="nearest"))
    step = np.abs(np.diff(values, append=values[-1]))
    spread = np.maximum(
        _MAD_TO_STD * median_filter(away, size=wide, mode="nearest"),
        median_filter(step, size=wide, mode="nearest"),
    )
    quantum = float(step[step > 0].min()) if (step > 0).any() else 0.0
    floor = max(0.5 * float(np.median(spread)), quantum, 1e-12 * float(np.abs(values).max()))
    # Large steps are common in a manoeuvre; in Gaussian noise a tenth of all steps exceeds 2.3 sigma.
    usual = 3 * percentile_filter(step, 90, size=wide, mode="nearest")
    flagged = away > np.maximum(_OUTLIER_THRESHOLD_SIGMAS * np.maximum(spread, floor), usual)
    # Common steps of several quanta in coarse signals are no outliers.
    if (step > 0).mean() < 0.2 and (step > 0).any():
        flagged &= away > 5 * float(np.median(step[step > 0]))
    out = known[flagged]
    return np.asarray(out[_mask_short_runs(out, _MEDIAN_HALF_WINDOW_SAMPLES)], dtype=np.int64)


def _mask_short_runs(index: NDArray[np.int64], longest: int) -> NDArray[np.bool_]:
    """Return a mask of the indices in runs of at most ``longest`` consecutive numbers; ``index`` increases."""
    if not len(index):
        return np.empty(0, dtype=bool)
    run = np.cumsum(np.append(0, np.diff(index) > 1))
    return np.asarray(np.bincount(run)[run] <= longest)


def _find_runs(flag: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the first and past-the-last index of each run of true values, (k, 2)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    return edges.reshape(-1, 2)


def find_frozen_runs(x: _Array) -> NDArray[np.int64]:
    """Return runs of one repeated value in a channel that otherwise changes at every sample.

    Parameters
    ----------
    x : (n,) array
        Values of the channel.

    Returns
    -------
    (k, 2) int array
        First and past-the-last sample of each run. It is empty for a channel that usually repeats itself (held inputs,
        coarse resolution), with more than a fifth of equal neighbours. Runs at the beginning or the end of the record
        do not count, nor do turning points, which a signal enters and leaves by its smallest step.
    """
    steps = np.abs(np.diff(x))
    same = steps == 0
    if len(x) < 4 * _MIN_FROZEN_SAMPLES or same.mean() > 0.2:
        return np.empty((0, 2), dtype=np.int64)
    runs = _find_runs(same) + np.array([0, 1])
    runs = runs[(runs[:, 0] > 0) & (runs[:, 1] < len(x)) & (runs[:, 1] - runs[:, 0] >= _MIN_FROZEN_SAMPLES)]
    least = steps[steps > 0].min(initial=np.inf)
    turned = np.maximum(steps[runs[:, 0] - 1], steps[runs[:, 1] - 1]) < 1.5 * least
    return runs[~turned]


def compute_saturated_fractions(x: _Array) -> tuple[float, float]:
    """Return the share of samples that sit at the channel's minimum and at its maximum.

    Only runs of 5 equal samples count, and only at an extreme value that is more frequent than the values
    next to it. A clipped signal accumulates at the limit; a signal with few levels accumulates everywhere.
    """
    values = x[np.isfinite(x)]
    if len(values) < 10 * _MIN_SATURATED_SAMPLES or values.min() == values.max():
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
        runs = _find_runs(values == limit)
        runs = runs[runs[:, 1] - runs[:, 0] >= _MIN_SATURATED_SAMPLES]
        held = int((runs[:, 1] - runs[:, 0]).sum())
        shares.append(held / len(values) if held > 0.5 * near.sum() else 0.0)
    return shares[0], shares[1]


AngleUnit = Literal["deg", "rad", ""]
_DEG_PER_RAD = 180 / np.pi
_MAX_RATE_OF_UNSTATED_UNIT_RAD_S = 35.0
# A stated unit is contradicted only by rates (rad/s) beyond the range of all gyroscopes.
_MAX_RATE_OF_STATED_UNIT_RAD_S = 70.0
_MIN_ANGLE_RATE_CORRELATION = 0.6
# Largest ratio of the slope to its nominal value; averaging over 0.1 s makes noise negligible.
_MAX_SLOPE_TO_NOMINAL_RATIO = 1.35


class UnitGuess(NamedTuple):
    """Units of an angle and its rate (``""`` if undecidable), the reason, and whether the two disagree."""

    angle: AngleUnit
    rate: AngleUnit
    reason: str
    is_contradictory: bool = False


def fit_angle_rate_slope(time: _Array, angle: _Array, rate: _Array) -> tuple[float, float]:
    """Return slope and correlation of d(angle)/dt over the rate, both averaged over about a tenth of a second.

    Parameters
    ----------
    time, angle, rate : (n,) arrays
        Angle and rate on one clock; NaN is omitted.

    Returns
    -------
    slope, correlation : float
        Slope and correlation; NaN for too few samples.
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
    time: _Array,
    angle: _Array | None = None,
    rate: _Array | None = None,
    *,
    bounded: bool = True,
    named: bool = False,
) -> UnitGuess:
    """Guess whether an angle and its rate are in degrees or radians.

    Parameters
    ----------
    time : (n,) array
        s.
    angle, rate : (n,) arrays, optional
        Angle and its rate, as far as available.
    bounded : bool
        Whether the angle stays within half a turn (roll and pitch; not an unwrapped yaw).
    named : bool
        Whether the units are stated, so that a contradiction needs stronger evidence.

    Returns
    -------
    UnitGuess
        Guess; ``""`` if neither range nor consistency decides.
    """
    peak = _robust_peak(angle)
    fast = _robust_peak(rate)
    by_angle: AngleUnit = "deg" if bounded and peak > 2 * np.pi else ""
    by_rate: AngleUnit = (
        "deg" if fast > (_MAX_RATE_OF_STATED_UNIT_RAD_S if named else _MAX_RATE_OF_UNSTATED_UNIT_RAD_S) else ""
    )
    reasons = []
    if by_angle:
        reasons.append(f"values up to {peak:.3g} are too large for radians")
    if by_rate:
        reasons.append(f"rates up to {fast:.3g} are too fast for rad/s")
    if angle is not None and rate is not None:
        slope, correlation = fit_angle_rate_slope(time, angle, rate)
        if abs(correlation) > _MIN_ANGLE_RATE_CORRELATION:
            said = f"d/dt of the angle is {slope:.3g} times the rate"

            def slope_is_near(factor: float) -> bool:
                return abs(np.log(abs(slope) / factor)) < np.log(_MAX_SLOPE_TO_NOMINAL_RATIO)

            if slope_is_near(_DEG_PER_RAD):
                return UnitGuess("deg", "rad", said)
            if slope_is_near(1 / _DEG_PER_RAD):
                return UnitGuess("rad", "deg", said)
            if slope_is_near(1.0):
                both: AngleUnit = "deg" if by_angle or by_rate else "rad"
                if both == "rad" and peak < 0.2 and fast < 1.0:
                    both = ""  # a few degrees or a few radians: consistent, and nothing to tell them apart
                return UnitGuess(both, both, "; ".join([*reasons, said]))
            # Neither: noise or another factor than that of degrees. The range may show which of the two is wrong.
            far = max(abs(slope), 1 / abs(slope)) > 3
            return UnitGuess(by_angle, by_rate, "; ".join([*reasons, said]), far)
    if not reasons and bounded and np.isfinite(peak) and 1.0 < peak <= np.pi:
        # In degrees the vehicle would never tilt by four degrees.
        return UnitGuess("", by_rate, f"values up to {peak:.3g} may be degrees or radians")
    return UnitGuess(by_angle, by_rate, "; ".join(reasons))


def _robust_peak(x: _Array | None) -> float:
    """Return the 99.9 % quantile of the absolute values, which is robust against single outliers."""
    if x is None or not np.isfinite(x).any():
        return float("nan")
    return float(np.quantile(np.abs(x[np.isfinite(x)]), 0.999))
