"""What is wrong with a channel: missing values, constant, frozen, saturated, outliers. One function a fault.

Outliers are found as Hampel's filter finds them (Hampel 1974; Pearson et al. 2016, "Generalized Hampel Filters"):
further from the median of a short window than so many robust standard deviations. The spread is taken from a window ten
times as long, since seven samples tell it badly, and is at least the typical step from sample to sample, so that the
crest of a fast but smooth motion is none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import median_filter, percentile_filter

from mufly.errors import InputError
from mufly.logs.clock import ClockReport, check_clock
from mufly.logs.delay import Delay, body_rates_of_attitude, estimate_delay
from mufly.logs.flat import columns_of
from mufly.logs.raw import RawLog
from mufly.logs.resample import unwrap

__all__ = [
    "Channel", "ChannelReport", "DelayReport", "channels_of", "check_channel", "check_channels", "check_delays",
    "check_log", "find_frozen", "find_outliers", "find_saturation", "is_held",
]  # fmt: skip

_Array = NDArray[np.float64]
_MAD = 1.4826
_SAMPLES_EXAMINED = 400_000


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


@dataclass(frozen=True)
class ChannelReport:
    """What :func:`check_channel` found.

    Attributes
    ----------
    name, units : str
    samples : int
    missing : float
        Share of NaN.
    constant : bool
    smallest, largest, mean, std : float
        Of what is known.
    outliers : tuple of float
        Times of the outliers (s).
    frozen : tuple of (begin_s, end_s)
    at_minimum, at_maximum : float
        Share of samples at the limits.
    """

    name: str
    units: str
    samples: int
    missing: float
    constant: bool
    smallest: float
    largest: float
    mean: float
    std: float
    outliers: tuple[float, ...]
    frozen: tuple[tuple[float, float], ...]
    at_minimum: float
    at_maximum: float

    def words(self) -> list[str]:
        """The faults but that it is constant, a sentence each; empty for a sound channel."""
        unit = "" if self.units in ("", "1") else f" {self.units}"
        out = []
        if self.missing == 1:
            return [f"{self.name}: no value at all"]
        if self.missing > 0:
            out.append(f"{self.name}: {100 * self.missing:.2g} % of the values are missing")
        if self.constant:
            return out  # several channels that stand still make one sentence: LogReport.faults
        if self.outliers:
            many = "1 outlier" if len(self.outliers) == 1 else f"{len(self.outliers)} outliers"
            out.append(f"{self.name}: {many}, at {_times(self.outliers)} s")
        if self.frozen:
            longest = max(b - a for a, b in self.frozen)
            many = "drops out once" if len(self.frozen) == 1 else f"drops out {len(self.frozen)} times"
            at = _times([a for a, _ in self.frozen])
            out.append(f"{self.name}: {many} (one value repeated, {longest:.3g} s at most), at {at} s")
        for share, limit, word in (
            (self.at_minimum, self.smallest, "minimum"),
            (self.at_maximum, self.largest, "maximum"),
        ):
            if share > 0:
                out.append(
                    f"{self.name}: {100 * share:.2g} % of the values sit at its {word}, {limit:.4g}{unit}"
                )
        return out


def _times(times: Any) -> str:
    shown = [f"{t:.2f}" for t in list(times)[:4]]
    return ", ".join(shown) + (", ..." if len(times) > 4 else "")


def is_held(name: str) -> bool:
    """Whether a signal is commanded: it jumps and stands still as it likes, and no outlier or drop-out can be told."""
    return name.startswith(("reference_", "motor_input", "servo_input", "actuator_", "pilot_input"))


def check_channel(time: _Array, x: _Array, name: str, units: str = "") -> ChannelReport:
    """Examine one channel.

    Parameters
    ----------
    time : (n,) array
        s.
    x : (n,) array
    name, units : str
    """
    known = x[np.isfinite(x)]
    if not len(known):
        nan = float("nan")
        return ChannelReport(
            name, units, len(x), 1.0 if len(x) else 0.0, False, nan, nan, nan, nan, (), (), 0.0, 0.0
        )
    # A reference that stays at a limit was planned so, and the truth of a simulation has no faults.
    planned = name.startswith(("reference_", "truth_"))
    low, high = (0.0, 0.0) if planned else find_saturation(x)
    held = planned or is_held(name)
    return ChannelReport(
        name=name,
        units=units,
        samples=len(x),
        missing=1 - len(known) / len(x),
        constant=bool(len(known) > 1 and known.min() == known.max()),
        smallest=float(known.min()),
        largest=float(known.max()),
        mean=float(known.mean()),
        std=float(known.std()),
        outliers=() if held else tuple(time[find_outliers(x)].tolist()),
        frozen=() if held else tuple((float(time[a]), float(time[b - 1])) for a, b in find_frozen(x)),
        at_minimum=low,
        at_maximum=high,
    )


class Channel(NamedTuple):
    """One component of a signal on its own clock, for :func:`check_channels`."""

    name: str
    units: str
    time: _Array
    values: _Array


def channels_of(data: xr.Dataset) -> list[Channel]:
    """Return the numbers of signals on one clock, component by component."""
    time = data["time"].values
    return [
        Channel(
            c.variable if c.label is None else f"{c.variable}.{c.label}",
            c.units,
            time,
            c.values.astype(np.float64),
        )
        for c in columns_of(data)
        if c.values.dtype.kind in "fiub"
    ]


def check_channels(
    channels: Sequence[Channel], progress: Callable[[int, int], None] | None = None
) -> list[ChannelReport]:
    """Examine channels, long ones by their first 400 000 samples; ``progress`` is called with (done, all)."""
    out = []
    for k, c in enumerate(channels):
        part = slice(_SAMPLES_EXAMINED)
        out.append(check_channel(c.time[part], c.values[part], c.name, c.units))
        if progress is not None:
            progress(k + 1, len(channels))
    return out


def check_log(raw: RawLog) -> dict[str, ClockReport]:
    """Examine the clock of every topic."""
    return {name: check_clock(table.time) for name, table in raw.items()}


@dataclass(frozen=True)
class DelayReport:
    """The delay from one channel to another, by name."""

    reference: str
    response: str
    delay: Delay

    def words(self) -> str:
        """In one line."""
        return f"{self.response} after {self.reference}: {self.delay.words()}"


def check_delays(data: xr.Dataset, *, least_correlation: float = 0.3) -> list[DelayReport]:
    """Estimate the delays that a flight's record can show.

    From references to measurements, component by component, and from the derivative of the measured attitude to the
    measured body rates: these two are one motion, so a delay there is one of the instrument or the logger.

    Parameters
    ----------
    data : xarray.Dataset
        On an even clock.
    least_correlation : float
        Pairs that agree less, with the delay taken out, are left out.
    """
    time = data["time"].values
    pairs: list[tuple[str, str, _Array, _Array, bool]] = []
    for kind in ("attitude", "rates", "velocity", "position"):
        wanted, seen = f"reference_{kind}", f"measured_{kind}"
        if wanted in data and seen in data and data[wanted].dims == data[seen].dims:
            for label in data[seen][str(data[seen].dims[1])].values.tolist():
                place = f".{label}"
                a = data[wanted].loc[:, label].values
                b = data[seen].loc[:, label].values
                if kind == "attitude":
                    a, b = unwrap(a), unwrap(b)
                pairs.append((wanted + place, seen + place, a, b, True))
    if "measured_attitude" in data and "measured_rates" in data:
        implied = body_rates_of_attitude(time, unwrap(data["measured_attitude"].values))
        for k, label in enumerate("pqr"):
            name = f"d(measured_attitude)/dt, {label}"
            rate = data["measured_rates"].values[:, k]
            pairs.append((name, f"measured_rates.{label}", implied[:, k], rate, False))
    out = []
    for reference, response, x, y, causal in pairs:
        try:
            found = estimate_delay(time, x.astype(np.float64), y.astype(np.float64), causal=causal)
        except InputError:  # constant, or too short: nothing to say
            continue
        if abs(found.correlation) >= least_correlation and not found.at_limit:
            out.append(DelayReport(reference, response, found))
    return out
