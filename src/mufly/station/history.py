"""Which signals a station keeps of a vehicle: the columns of its history and of its recordings.

They are those of a flight's recording (:mod:`mufly.logs.layout`) with what else a vehicle tells over a link: what it
believes of itself (``estimated_``), what its rotors were measured to turn at, the pilot's sticks, and how good the link
is. As plain columns they are called ``variable_label`` (``estimated_position_N``), as in :mod:`mufly.logs.layout`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mufly.logs.layout import Layout
from mufly.quantities import Quantity, kept_by

BEAMS = 8
"""So many beams are kept; a vehicle with more is shown, but its ranges are not kept."""
PILOT_CHANNELS = 8


def station_layout() -> Layout:
    """Return the table of what a station keeps of one vehicle."""
    labels = (("channel", tuple(range(1, PILOT_CHANNELS + 1))),)
    return Layout(kept_by("flight", "station"), BEAMS, labels)


def column_names(layout: Layout) -> tuple[str, ...]:
    """Names of the columns behind the time, ``("truth_position_N", ...)``."""
    names: list[str] = []
    for quantity in layout.quantities:
        labels = layout.labels(quantity)
        names += [f"{quantity.name}_{label}" for label in labels] if quantity.dim else [quantity.name]
    return tuple(names)


def column_units(layout: Layout) -> tuple[str, ...]:
    """Units of the same columns."""
    return tuple(q.units for q in layout.quantities for _ in (layout.labels(q) if q.dim else (None,)))


# ----------------------------------------------------------------------------
# What a station remembers of a vehicle: the last ten minutes of every signal, in memory that does not grow.
#
# Rows of numbers on one clock, in a ring: a new row takes the place of the oldest. Times are float64 (a float32 clock
# would tick in steps of 8 ms after a day), values float32, which hold every signal to seven digits.


class History:
    """Ring of rows.

    Parameters
    ----------
    layout : Layout, optional
        What the columns are; default :func:`mufly.station.history.station_layout`.
    seconds, rate_Hz : float
        How far back it reaches at that many rows a second; at fewer it reaches further.
    """

    def __init__(self, layout: Layout | None = None, seconds: float = 600.0, rate_Hz: float = 100.0) -> None:
        self.layout = layout or station_layout()
        self.names = column_names(self.layout)
        self._index = {name: k for k, name in enumerate(self.names)}
        self._units = dict(zip(self.names, column_units(self.layout), strict=True))
        self._size = max(2, round(seconds * rate_Hz))
        # Not filled: memory is taken row by row as they come, so a vehicle that says little costs little.
        self._times = np.empty(self._size)
        # One column more than there are signals: that of every name that is none.
        self._values = np.empty((self._size, len(self.names) + 1), dtype=np.float32)
        self._width = len(self.names)
        self._next = self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def newest_s(self) -> float:
        """Time of the newest row (s); NaN while there is none."""
        return float(self._times[self._next - 1]) if self._count else np.nan

    @property
    def oldest_s(self) -> float:
        """Time of the oldest row (s); NaN while there is none."""
        return float(self._times[self._next if self._count == self._size else 0]) if self._count else np.nan

    def unit(self, name: str) -> str:
        """Unit of a signal; ``"1"`` is a pure number.

        Raises
        ------
        KeyError
            If there is no such signal.
        """
        return self._units[name]

    def append(self, time_s: float, values: NDArray[np.floating]) -> None:
        """Add a row.

        Parameters
        ----------
        time_s : float
            Later than that of the last row, or the row is left out.
        values : (n_signals,) array
            In the order of :attr:`names`.
        """
        if self._count and not time_s > self._times[self._next - 1]:
            return
        self._times[self._next] = time_s
        self._values[self._next, : self._width] = values
        self._values[self._next, self._width] = np.nan
        self._next = (self._next + 1) % self._size
        self._count = min(self._count + 1, self._size)

    def since(
        self, time_s: float, names: Sequence[str] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the rows later than a time.

        Parameters
        ----------
        time_s : float
        names : sequence of k names, optional
            Default all.

        Returns
        -------
        times : (n,) array
            s, increasing.
        values : (n, k) array
            NaN where a signal was not known then, or has a name that is not known at all.
        """
        picked = slice(0, self._width) if names is None else [self._index.get(name, -1) for name in names]
        parts = []
        for part in self._parts():
            first = part.start + int(np.searchsorted(self._times[part], time_s, side="right"))
            if first < part.stop:
                parts.append(slice(first, part.stop))
        if not parts:
            width = self._width if names is None else len(names)
            return np.empty(0), np.empty((0, width), dtype=np.float32)
        if len(parts) == 1:  # the common case of a page that asks for the newest rows; copies, as below
            return self._times[parts[0]].copy(), self._values[parts[0]][:, picked].copy()
        times = np.concatenate([self._times[part] for part in parts])
        return times, np.concatenate([self._values[part][:, picked] for part in parts])

    def window(
        self, seconds: float, names: Sequence[str] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the rows of the last ``seconds``, as :meth:`since` does."""
        return self.since(self.newest_s - seconds if self._count else 0.0, names)

    def clear(self) -> None:
        """Forget everything."""
        self._next = self._count = 0

    def _parts(self) -> tuple[slice, ...]:
        """Rows in order of time: older part, newer part."""
        if self._count < self._size:
            return (slice(0, self._count),)
        return slice(self._next, self._size), slice(0, self._next)


# ----------------------------------------------------------------------------
# What a vehicle's signals are at the moment: who told them, and until when they are believed.
#
# Several messages may tell the same; of such a group the best that comes is believed. A signal that comes more seldom
# than rows of the history do is held for a while (`HOLD_S`) and then is not known any more. Headings are carried on
# past
# north, so that lines of them do not jump.


HOLD_S = 1.5
"""A signal that was not told for so long is not known (s)."""
SLOW_HOLD_S = 6.0
"""The same for what vehicles tell once a second or less: battery, link (s)."""
_SLOW = ("battery", "link")


class Board:
    """The present of all signals of a history.

    Parameters
    ----------
    history : History
        Which has the signals.

    Attributes
    ----------
    values : (n_signals,) array
        In the order of ``history.names``; NaN is not known.
    index : dict
        Name of a signal -> its place.
    columns : dict
        Name of a variable (``"estimated_position"``) -> slice of its places.
    """

    def __init__(self, history: History) -> None:
        self._names = history.names
        self.index = {name: k for k, name in enumerate(self._names)}
        self.values: NDArray[np.float64] = np.full(len(self._names), np.nan)
        self.columns: dict[str, slice] = {}
        for quantity in history.layout.quantities:
            name, width = _first(history.layout, quantity)
            self.columns[quantity.name] = slice(self.index[name], self.index[name] + width)
        self._told: dict[str, tuple[int, float]] = {}  # group -> rank and time of the message last believed
        self._owned: dict[str, set[int]] = {}  # group -> its places

    def get(self, name: str) -> NDArray[np.float64]:
        """Return the present value of a variable, NaN where it is not known."""
        return self.values[self.columns[name]].copy()

    def believed(self, now_s: float, group: str, rank: int) -> bool:
        """Whether to believe a message of this rank now (0 is best); notes that it told."""
        told = self._told.get(group)
        if told is not None and told[0] < rank and now_s - told[1] < HOLD_S:
            return False
        self._told[group] = rank, now_s
        return True

    def set(self, group: str, k: int, value: float) -> None:
        """Put a value in place ``k``, told by a message of a group."""
        self._owned.setdefault(group, set()).add(k)
        if self._names[k].endswith("_yaw") and math.isfinite(value):
            value = self._carried_on(k, value)
        self.values[k] = value

    def put(self, group: str, name: str, values: Iterable[float]) -> None:
        """Put the values of a variable."""
        first = self.columns[name].start
        for j, value in enumerate(values):
            self.set(group, first + j, float(value))

    def forget(self, now_s: float) -> list[str]:
        """Take away what was not told for long; returns the groups."""
        gone = [
            group
            for group, (_, told_s) in self._told.items()
            if now_s - told_s > (SLOW_HOLD_S if group in _SLOW else HOLD_S)
        ]
        for group in gone:
            del self._told[group]
            self.values[list(self._owned.get(group, ()))] = math.nan
        return gone

    def _carried_on(self, k: int, angle: float) -> float:
        """Return the angle in the turn nearest to its last value, or else to the estimated heading."""
        near = self.values[k]
        if not math.isfinite(near):
            near = self.values[self.index["estimated_attitude_yaw"]]
        if not math.isfinite(near):
            return angle
        return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))


def _first(layout: Layout, quantity: Quantity) -> tuple[str, int]:
    """Name of the first signal of a variable, and how many it has."""
    labels = layout.labels(quantity)
    return (f"{quantity.name}_{labels[0]}", len(labels)) if quantity.dim else (quantity.name, 1)
