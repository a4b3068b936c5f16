"""What a station remembers of a vehicle: the last ten minutes of every signal, in memory that does not grow.

Rows of numbers on one clock, in a ring: a new row takes the place of the oldest. Times are float64 (a float32 clock
would tick in steps of 8 ms after a day), values float32, which hold every signal to seven digits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mufly.logs.layout import Layout
from mufly.station.signals import column_names, column_units, station_layout

__all__ = ["History"]


class History:
    """Ring of rows.

    Parameters
    ----------
    layout : Layout, optional
        What the columns are; default :func:`mufly.station.signals.station_layout`.
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
