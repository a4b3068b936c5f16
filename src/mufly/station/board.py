"""What a vehicle's signals are at the moment: who told them, and until when they are believed.

Several messages may tell the same; of such a group the best that comes is believed. A signal that comes more seldom
than rows of the history do is held for a while (`HOLD_S`) and then is not known any more. Headings are carried on past
north, so that lines of them do not jump.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from mufly.logs.layout import Layout, Quantity
from mufly.station.history import History

__all__ = ["HOLD_S", "Board"]

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
