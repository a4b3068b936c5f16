"""VISION_POSITION_ESTIMATE in both directions: fixes from external SLAM, and publication of the vehicle's fix.

In: fixes of position and heading that another program computes. Their variances are those of the message.

The field ``usec`` is the time of the fix by the vehicle's clock if the sender synchronised its clock by TIMESYNC, as
PX4 requires. For any other clock (Unix time, time since the sender's start) the offset is the least difference of
arrival time and ``usec`` over the last 30 s: the fastest message counts as if it had no delay. The remaining delay
(exposure, processing, fastest transmission) is PX4's parameter EKF2_EV_DELAY. ``usec`` 0 means the time of arrival.

Out: the last received fix, with its own time; a fix from pictures also has its covariance.

Source: https://mavlink.io/en/messages/common.html#VISION_POSITION_ESTIMATE.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mufly.link.codec import MavMessage, MessageSource, to_float32

_Array = NDArray[np.float64]
SAME_CLOCK_TOLERANCE_S = 2.0
"""Difference below which a message's time is on the vehicle's clock (s)."""
CLOCK_OFFSET_WINDOW_S = 30.0
SENDER_TIMEOUT_S = 1.0
"""Silence after which another sender may replace the present one (s)."""
REFUSAL_PERIOD_S = 5.0
_POSE_INDICES = np.array([0, 1, 2, 5])  # x, y, z, yaw
_UPPER_TRIANGLE = np.triu_indices(6)


def unpack_pose_covariance(triangle: list[float]) -> _Array | None:
    """Return the covariance (4, 4) of N, E, D and heading from a message's upper triangle (21,); None if unknown.

    A covariance of zeros, which some senders send if they know none, counts as unknown.
    """
    values = np.array(triangle, dtype=np.float64)
    if math.isnan(values[0]) or not values.any():
        return None
    whole = np.zeros((6, 6))
    whole[_UPPER_TRIANGLE] = values
    whole = whole + np.triu(whole, 1).T
    return whole[np.ix_(_POSE_INDICES, _POSE_INDICES)]


def pack_pose_covariance(covariance: _Array) -> list[float]:
    """Return the upper triangle (21,) for a message from the covariance (4, 4) of N, E, D and heading.

    The entries of roll and pitch are zero.
    """
    whole = np.zeros((6, 6))
    whole[np.ix_(_POSE_INDICES, _POSE_INDICES)] = covariance
    return [to_float32(v) for v in whole[_UPPER_TRIANGLE]]


class VisionInput:
    """Receiver of VISION_POSITION_ESTIMATE messages of one sender; reports why a position is rejected.

    Parameters
    ----------
    give : callable or None
        Called with present time (s), time of the fix (s), position and heading (4,) and covariance; returns the reason
        of a rejection (:meth:`mufly.flight.fixes.external_fixes.ExternalFixes.submit_fix`). None: no receiver.
    note : callable
        Called with a text and its level.
    """

    def __init__(
        self,
        give: Callable[[float, float, _Array, _Array | None], str] | None,
        note: Callable[[str, str], None],
    ) -> None:
        self._give, self._note = give, note
        self._sender: MessageSource | None = None
        self._heard_s = -math.inf
        self._offsets: deque[tuple[float, float]] = deque()
        self._told: dict[str, float] = {}
        self._refused = 0
        self._counter = -1
        self.delay_s = 0.0

    def handle_position_message(self, now_s: float, flight_s: float, sender: MessageSource, m: MavMessage) -> None:
        """Process a message received at ``flight_s`` by the vehicle's clock."""
        if self._give is None:
            self._report_refusal(
                now_s, "the vehicle does not use external positions", "start the vehicle with --position link"
            )
            return
        if self._sender not in (None, sender) and now_s - self._heard_s < SENDER_TIMEOUT_S:
            self._report_refusal(now_s, f"{sender} sends, too", f"{self._sender} is heard")
            return
        if sender != self._sender:
            self._sender, self._counter = sender, -1
            self._offsets.clear()
            self._note(f"positions are received over the link from {sender}", "info")
        self._heard_s = now_s
        place = np.array([m.x, m.y, m.z, m.yaw], dtype=np.float64)
        time_s = self._vehicle_time_s(flight_s, int(m.usec))
        if why := self._give(flight_s, time_s, place, unpack_pose_covariance(m.covariance)):
            self._refused += 1
            self._report_refusal(now_s, why)
            return
        counter = int(getattr(m, "reset_counter", 0))
        if self._counter not in (-1, counter):
            self._note("the sender of the positions reports a jump of its map", "warning")
        self._counter = counter

    def _vehicle_time_s(self, flight_s: float, usec: int) -> float:
        if usec == 0:
            return flight_s - self.delay_s
        theirs_s = usec * 1e-6
        if abs(theirs_s - flight_s) < SAME_CLOCK_TOLERANCE_S:
            return theirs_s
        self._offsets.append((flight_s, flight_s - theirs_s))
        while self._offsets[0][0] < flight_s - CLOCK_OFFSET_WINDOW_S:
            self._offsets.popleft()
        return theirs_s + min(offset for _, offset in self._offsets) - self.delay_s

    def _report_refusal(self, now_s: float, why: str, remedy: str = "") -> None:
        """Report why a position was refused, each kind of reason at most once in ``REFUSAL_PERIOD_S``."""
        kind = "".join(c for c in why if not c.isdigit())
        if now_s - self._told.get(kind, -math.inf) < REFUSAL_PERIOD_S:
            return
        self._told[kind] = now_s
        more = f" ({self._refused} so far)" if self._refused > 1 else ""
        self._note(f"position by link refused{more}: {why}{'; ' + remedy if remedy else ''}", "warning")
