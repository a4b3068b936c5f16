"""The pilot's sticks on their way to a vehicle: MANUAL_CONTROL, for as long as somebody holds them.

A window says where its sticks are some twenty times a second. What it said last is streamed to the vehicle until it is
:data:`STICK_TIMEOUT_S` old; then nothing is sent any more, the station asks for a hover, and whatever becomes of that,
the vehicle lets go by its own time-out. Nothing here decides whether it may be flown by hand: that is for the vehicle.
"""

from __future__ import annotations

import math

from mufly.link import mavlink
from mufly.link.codec import MavMessage
from mufly.link.steering_input import StickDeflection

STREAM_PERIOD_S = 0.04
STICK_TIMEOUT_S = 0.8
"""Less than a vehicle of mufly waits for (1 s), and many times what a window lets pass between two words (0.05 s)."""


def manual_control_message(d: StickDeflection, system: int) -> MavMessage:
    """MANUAL_CONTROL of sticks, -1 to 1: right, back, up, turn right.

    The signs are those that PX4, ArduPilot and mufly take (:func:`mufly.link.steering_input.parse_manual_control`): x
    forward, y right, z 500 in the middle, r turns right.
    """
    x, y, z, r = (round(1000.0 * v) for v in (-d.pitch, d.roll, 0.5 + 0.5 * d.climb, d.yaw))
    return mavlink.MAVLink_manual_control_message(system, x, y, z, r, 0)


class PilotSticks:
    """The sticks of one vehicle, as this station holds them.

    Parameters
    ----------
    system : int
        The vehicle's.
    """

    def __init__(self, system: int) -> None:
        self._system = system
        self._held: StickDeflection | None = None
        self._fresh = False
        self._heard_s = self._sent_s = -math.inf

    @property
    def is_held(self) -> bool:
        """Whether somebody holds them."""
        return self._held is not None

    def set_deflection(self, roll: float, pitch: float, climb: float, yaw: float) -> bool:
        """Take where they are (-1..1: right, back, up, turn right); False, and nothing taken, if one is no number."""
        values = (roll, pitch, climb, yaw)
        if not all(map(math.isfinite, values)):
            return False
        self._held, self._fresh = StickDeflection(*(min(max(v, -1.0), 1.0) for v in values)), True
        return True

    def release_sticks(self) -> None:
        """Nobody holds them any more."""
        self._held, self._fresh = None, False

    def step(self, now_s: float) -> list[MavMessage]:
        """What is to be sent now; sticks that nobody has moved of late are let go."""
        if self._held is None:
            return []
        if self._fresh:
            self._heard_s, self._fresh = now_s, False
        if now_s - self._heard_s > STICK_TIMEOUT_S:
            self.release_sticks()
            return []
        if now_s - self._sent_s < STREAM_PERIOD_S:
            return []
        self._sent_s = now_s
        return [manual_control_message(self._held, self._system)]
