"""A log as it was written: topics, each a table on its own clock, nothing resampled or renamed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LogWarning", "RawLog", "RawTable"]


class LogWarning(UserWarning):
    """Something about a log that its reader guessed or repaired, in words."""


@dataclass(frozen=True)
class RawTable:
    """One topic of a log.

    Attributes
    ----------
    name : str
        Topic: ``"vehicle_attitude"``; a second instance is ``"battery_status:1"``.
    time : (n,) float64 array
        Seconds since the start of the log, as they were written: not necessarily increasing.
    fields : dict of str to (n,) array
        Numbers, or text (dtype str).
    units : dict of str to str
        Units of those fields for which the file says one.
    """

    name: str
    time: NDArray[np.float64]
    fields: dict[str, NDArray[Any]]
    units: dict[str, str] = field(default_factory=dict)

    @property
    def rate_hz(self) -> float:
        """Rate of the median step of the clock; NaN for fewer than two different instants."""
        steps = np.diff(self.time)
        steps = steps[steps > 0]
        return float(1 / np.median(steps)) if len(steps) else float("nan")


@dataclass(frozen=True)
class RawLog(Mapping[str, RawTable]):
    """A whole log: a mapping from topic to :class:`RawTable`.

    Attributes
    ----------
    path : str
    kind : str
        ``"MCAP"``, ``"CSV"``, ``"ULog"``, ``"DataFlash"``, ``"MAVLink tlog"``, ``"Parquet"`` or ``"NetCDF"``.
    tables : dict of str to RawTable
    start_time : str
        Wall time of the instant 0 (ISO 8601, UTC), ``""`` where the file does not tell.
    info : dict
        What the file says of itself: vehicle, software, ...
    messages : tuple of (time_s, level, text)
        What the vehicle said.
    dropouts : tuple of (time_s, duration_s)
        Where the logger itself says that it lost data.
    complete : bool
        Whether the file ends as it should, without damage.
    notes : tuple of str
        What the reader repaired or guessed, in words.
    """

    path: str
    kind: str
    tables: dict[str, RawTable]
    start_time: str = ""
    info: dict[str, Any] = field(default_factory=dict)
    messages: tuple[tuple[float, str, str], ...] = ()
    dropouts: tuple[tuple[float, float], ...] = ()
    complete: bool = True
    notes: tuple[str, ...] = ()

    def __getitem__(self, topic: str) -> RawTable:
        return self.tables[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __len__(self) -> int:
        return len(self.tables)

    @property
    def span(self) -> tuple[float, float]:
        """First and last instant of any topic whose clock runs (s); zeros for an empty log."""
        ends = [
            (np.nanmin(t.time), np.nanmax(t.time)) for t in self.tables.values() if np.isfinite(t.time).any()
        ]
        ends = [(a, b) for a, b in ends if b > a] or ends
        return (float(min(a for a, _ in ends)), float(max(b for _, b in ends))) if ends else (0.0, 0.0)
