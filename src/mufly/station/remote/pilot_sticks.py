"""MANUAL_CONTROL stream of a pilot's sticks to a vehicle.

A browser window sends its stick positions about twenty times a second. The latest position is streamed to the vehicle
until it is :data:`STICK_TIMEOUT_S` old. Then the stream ends and the station requests a hover; if that request is lost,
the vehicle's own time-out applies. The vehicle decides whether manual flight is allowed.
"""

from __future__ import annotations

import math

from mufly.link import mavlink
from mufly.link.codec import MavMessage
from mufly.link.steering_input import StickDeflection

STREAM_PERIOD_S = 0.04
STICK_TIMEOUT_S = 0.8
"""Age at which stick positions expire (s): below the vehicle's time-out (1 s), far above the window's 0.05 s period."""


def manual_control_message(d: StickDeflection, system: int) -> MavMessage:
    """Return MANUAL_CONTROL for sticks in -1 to 1: right, back, up, turn right.

    Signs follow PX4, ArduPilot and mufly (:func:`mufly.link.steering_input.parse_manual_control`): x forward, y right,
    z 500 in the middle, r turns right.
    """
    x, y, z, r = (round(1000.0 * v) for v in (-d.pitch, d.roll, 0.5 + 0.5 * d.climb, d.yaw))
    return mavlink.MAVLink_manual_control_message(system, x, y, z, r, 0)


class PilotSticks:
    """Stick state of one vehicle, as held by this station.

    Parameters
    ----------
    system : int
        System number of the vehicle.
    """

    def __init__(self, system: int) -> None:
        self._system = system
        self._held: StickDeflection | None = None
        self._fresh = False
        self._heard_s = self._sent_s = -math.inf

    @property
    def is_held(self) -> bool:
        """Return whether a pilot holds the sticks."""
        return self._held is not None

    def set_deflections(self, roll: float, pitch: float, climb: float, yaw: float) -> bool:
        """Set stick positions (-1 to 1: right, back, up, turn right).

        Return False, and change nothing, if any position is not finite.
        """
        values = (roll, pitch, climb, yaw)
        if not all(map(math.isfinite, values)):
            return False
        self._held, self._fresh = StickDeflection(*(min(max(v, -1.0), 1.0) for v in values)), True
        return True

    def release_sticks(self) -> None:
        """Release the sticks."""
        self._held, self._fresh = None, False

    def take_due_messages(self, now_s: float) -> list[MavMessage]:
        """Return the messages to send; release the sticks after the time-out."""
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
