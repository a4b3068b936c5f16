"""A companion of a vehicle that sees where it is: hears attitude and height, answers with VISION_POSITION_ESTIMATE.

The other end of :mod:`mufly.link.vision`, for any autopilot that takes the message. It goes by the vehicle's clock:
TIMESYNC is asked for once a second, and of its answers of the last half minute the one with the shortest way counts,
offset = theirs - (sent + received) / 2. Until there is one, the least of arrival - stamp is taken. ATTITUDE tells the
tilt; DISTANCE_SENSOR that looks down tells the height, or else LOCAL_POSITION_NED. Both are asked for at
:data:`ASKED_HZ`.

Source: https://mavlink.io/en/services/timesync.html; component number MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.link.codec import Codec, Encoder, MavMessage, mavlink, single
from mufly.link.ports import Endpoint, Peer, open_port
from mufly.link.vision import WINDOW_S, triangle_of
from mufly.slam import Answer, Telling

_Array = NDArray[np.float64]
COMPONENT = 197
ASKED_HZ = 50.0
KEPT_S, OLD_S = 3.0, 0.5
"""What was told is kept for so long; what is older than a picture by more does not belong to it (s)."""
_ASK_S = 1.0
_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
_TILT_SIGMA, _HEIGHT_SIGMA = math.radians(1.0), 0.02


class Companion:
    """Speaks to one autopilot; sockets and clocks are the caller's.

    Attributes
    ----------
    system : int or None
        Of the vehicle; None until it is heard.
    """

    def __init__(self) -> None:
        self.system: int | None = None
        self._codec = Codec()
        self._encode: Encoder | None = None
        self._asked_s = -math.inf
        self._synced: deque[tuple[float, float, float]] = deque()  # when, way (s), offset (s)
        self._guessed: deque[tuple[float, float]] = deque()
        self._tilt: deque[tuple[float, ...]] = deque()  # their time, roll, pitch, p, q, r
        self._height: deque[tuple[float, float]] = deque()
        self._ranged_s = -math.inf

    @property
    def offset_s(self) -> float:
        """The vehicle's clock less ours (s); NaN while it is not known."""
        if self._synced:
            return min(self._synced, key=lambda s: s[1])[2]
        return max((offset for _, offset in self._guessed), default=math.nan)

    def receive(self, now_s: float, data: bytes) -> None:
        """Take bytes that came."""
        for m in self._codec.receive(now_s, "vehicle", data):
            kind, system = m.get_type(), m.get_srcSystem()
            if kind == "HEARTBEAT" and self.system is None:
                if m.autopilot != mavlink.MAV_AUTOPILOT_INVALID and m.type != mavlink.MAV_TYPE_GCS:
                    self.system = system
                    self._encode = Encoder(system, COMPONENT)
            elif system != self.system:
                continue
            elif kind == "TIMESYNC" and m.tc1:
                sent_s = m.ts1 * 1e-9
                if 0.0 <= now_s - sent_s < 1.0:
                    self._keep(self._synced, now_s, now_s - sent_s, m.tc1 * 1e-9 - 0.5 * (sent_s + now_s))
            elif kind == "ATTITUDE":
                t = self._stamped(now_s, m.time_boot_ms)
                self._add(self._tilt, (t, m.roll, m.pitch, m.rollspeed, m.pitchspeed, m.yawspeed))
            elif kind == "DISTANCE_SENSOR" and m.orientation == _DOWN:
                if m.min_distance <= m.current_distance <= m.max_distance:
                    self._ranged_s = now_s
                    self._add(self._height, (self._stamped(now_s, m.time_boot_ms), 0.01 * m.current_distance))
            elif kind == "LOCAL_POSITION_NED" and now_s - self._ranged_s > 1.0:
                self._add(self._height, (self._stamped(now_s, m.time_boot_ms), -m.z))

    def _stamped(self, now_s: float, boot_ms: int) -> float:
        theirs_s = 1e-3 * boot_ms
        self._keep(self._guessed, now_s, theirs_s - now_s)
        return theirs_s

    @staticmethod
    def _keep(row: deque[Any], now_s: float, *values: float) -> None:
        row.append((now_s, *values))
        while row[0][0] < now_s - WINDOW_S:
            row.popleft()

    @staticmethod
    def _add(row: deque[Any], values: tuple[float, ...]) -> None:
        if row and values[0] <= row[-1][0]:
            if values[0] > row[-1][0] - KEPT_S:
                return
            row.clear()  # the vehicle was started anew
        row.append(values)
        while row[0][0] < values[0] - KEPT_S:
            row.popleft()

    def step(self, now_s: float) -> list[bytes]:
        """Return what is due to be sent: a heartbeat, a question for the time, and for what is needed."""
        if self._encode is None or now_s - self._asked_s < _ASK_S:
            return []
        first, self._asked_s = math.isinf(self._asked_s), now_s
        said: list[MavMessage] = [
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
            ),
            mavlink.MAVLink_timesync_message(0, round(now_s * 1e9)),
        ]
        if first or not self._tilt:
            for number in (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED):
                said.append(mavlink.MAVLink_command_long_message(
                    self.system, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / ASKED_HZ, 0, 0, 0, 0, 0
                ))  # fmt: skip
        return [self._encode(m) for m in said]

    def telling(self, time_s: float) -> Telling | None:
        """Return what the vehicle told of an instant by our clock; None where it told nothing near it."""
        t = time_s + self.offset_s
        if not self._tilt or not self._height or not math.isfinite(t):
            return None
        if (
            t - self._tilt[-1][0] > OLD_S
            or self._tilt[0][0] - t > OLD_S
            or abs(t - self._height[-1][0]) > 2 * OLD_S
        ):
            return None
        a, h = np.array(self._tilt), np.array(self._height)
        roll, pitch, *rates = (float(np.interp(t, a[:, 0], c)) for c in a.T[1:])
        height = float(np.interp(t, h[:, 0], h[:, 1]))
        return Telling(
            roll,
            pitch,
            max(0.02, height),
            np.array(rates),
            tilt_sigma=_TILT_SIGMA,
            height_sigma=_HEIGHT_SIGMA,
        )

    def say(self, answer: Answer) -> bytes | None:
        """Return the message for a trusted answer whose time is by our clock; None while there is nobody to hear it."""
        if self._encode is None or not answer.trusted or math.isnan(self.offset_s):
            return None
        usec = round(1e6 * (answer.time_s + self.offset_s))
        n, e, d = (single(float(v)) for v in answer.position)
        return self._encode(mavlink.MAVLink_vision_position_estimate_message(
            max(0, usec), n, e, d, math.nan, math.nan, single(answer.heading), triangle_of(answer.covariance), 0
        ))  # fmt: skip


class CompanionPort:
    """A companion on an endpoint, served whenever a picture comes.

    Parameters
    ----------
    endpoint : Endpoint
        Where the vehicle is.

    Attributes
    ----------
    companion : Companion

    Raises
    ------
    InputError
        If it cannot be opened.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.companion = Companion()
        self._port = open_port(endpoint, "--link")
        self._peer: Peer | None = None

    def serve(self, now_s: float) -> None:
        """Take what has come, and send what is due; ``now_s`` by the clock of the day (s)."""
        for peer, data in self._port.receive():
            self.companion.receive(now_s, data)
            if self.companion.system is not None and self._peer is None:
                self._peer = peer
        for data in self.companion.step(now_s):
            self._port.send(self._peer, data)

    def told(self, times: _Array) -> Sequence[Telling | None]:
        """What the vehicle told of times (n,) by the clock of the day."""
        self.serve(time.time())
        return [self.companion.telling(t) for t in times.tolist()]

    def say(self, answer: Answer) -> None:
        """Send a trusted answer."""
        if self._peer is not None and (data := self.companion.say(answer)) is not None:
            self._port.send(self._peer, data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()
