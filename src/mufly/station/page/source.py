"""What the page reads of a vehicle or a recording: the reading half of the seam, as a protocol."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.station.view import Check, Message, MissionRow, Parameter, Snapshot

__all__ = ["SignalHistory", "Source"]

_Array = NDArray[np.floating[Any]]


class SignalHistory(Protocol):
    """Signals over time; see :class:`mufly.station.replay.ReplayHistory`."""

    @property
    def names(self) -> Sequence[str]:
        """Flat names of all signals."""

    def unit(self, name: str) -> str:
        """SI unit of a signal."""

    def since(self, time_s: float, names: Sequence[str]) -> tuple[_Array, _Array]:
        """Return times (n,) later than ``time_s`` and values (n, k)."""

    def window(self, seconds: float, names: Sequence[str]) -> tuple[_Array, _Array]:
        """Return the last ``seconds``."""


class Source(Protocol):
    """A vehicle or a recording, as the page reads it."""

    @property
    def name(self) -> str:
        """What it is called."""

    @property
    def kind(self) -> str:
        """One of "mufly", "other" and "recording"."""

    @property
    def snapshot(self) -> Snapshot:
        """The present."""

    @property
    def history(self) -> SignalHistory:
        """The past."""

    @property
    def messages(self) -> Sequence[Message]:
        """What it said."""

    @property
    def mission(self) -> Sequence[MissionRow]:
        """Its mission table."""

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """Its parameters, by name."""

    @property
    def checks(self) -> Sequence[Check]:
        """Its pre-flight checks."""
