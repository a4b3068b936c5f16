"""What is wrong with a channel: missing values, constant, frozen, saturated, outliers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.logs.clock import ClockReport, check_clock
from mufly.logs.faults import find_frozen, find_outliers, find_saturation
from mufly.logs.flat import columns_of
from mufly.logs.raw import RawLog
from mufly.logs.signals import is_held

__all__ = ["Channel", "ChannelReport", "channels_of", "check_channel", "check_channels", "check_log"]

_Array = NDArray[np.float64]
_SAMPLES_EXAMINED = 400_000


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
