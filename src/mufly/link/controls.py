"""What commands act on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.geodesy import Origin
from mufly.link.on_arming import OnArming
from mufly.link.sticks import Sticks

if TYPE_CHECKING:
    from mufly.flight import Autopilot
    from mufly.link.mission_desk import MissionDesk

__all__ = ["Controls"]


@dataclass(frozen=True)
class Controls:
    """What commands act on.

    Attributes
    ----------
    autopilot : Autopilot
    desk : MissionDesk
    sticks : Sticks
    on_arming : OnArming
    origin : Origin or None
    reset : callable
        Puts a simulation back to its start.
    now_s : float
    """

    autopilot: Autopilot
    desk: MissionDesk
    sticks: Sticks
    on_arming: OnArming
    origin: Origin | None
    reset: Callable[[], None]
    now_s: float
