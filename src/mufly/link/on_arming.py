"""A flight mode that is chosen on the floor, before arming: what the vehicle does once it is armed.

QGroundControl's "start mission" chooses PX4's mode AUTO MISSION first, waits until the heartbeat shows it, and arms
then; a PX4 begins at that moment. So does this vehicle, if it is armed within :data:`KEPT_S`; after that, and whenever
another mode is chosen, the choice is forgotten. AUTO TAKEOFF works the same way.
"""

from __future__ import annotations

import math
from typing import Literal

__all__ = ["KEPT_S", "Choice", "OnArming"]

KEPT_S = 10.0
"""For how long a choice holds (s)."""

Choice = Literal["take-off", "mission", ""]


class OnArming:
    """What is chosen, and since when."""

    def __init__(self) -> None:
        self._choice: Choice = ""
        self._since_s = -math.inf

    def choose(self, now_s: float, choice: Choice) -> None:
        """Choose, or forget ("")."""
        self._choice, self._since_s = choice, now_s

    def chosen(self, now_s: float) -> Choice:
        """Return what is chosen now."""
        return self._choice if now_s - self._since_s <= KEPT_S else ""
