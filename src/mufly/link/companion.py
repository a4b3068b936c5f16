"""Vision companion of a vehicle: receives attitude and height, sends VISION_POSITION_ESTIMATE.

It is the other end of :mod:`mufly.link.vision_input`, for any autopilot that accepts the message. Sources of its data:

* Clock: TIMESYNC is requested once a second. Of the answers of the last 30 s the one with the shortest round trip
  counts: offset = vehicle's time - (sent + received) / 2. Its error is at most half the round trip. If two answers
  contradict each other, a clock was adjusted, and older answers are discarded. Before the first answer, the offset is
  the least difference of arrival time and stamp.
* Tilt: ATTITUDE, with the accuracy from ODOMETRY, else one degree.
* Height: a DISTANCE_SENSOR that points down, else LOCAL_POSITION_NED.
* Velocity and position: LOCAL_POSITION_NED, with the accuracy from ESTIMATOR_STATUS. They initialise the map, and the
  search after tracking is lost.
* Vibration: RAW_RPM of the first two rotors, which shake the camera.

On the floor a camera has no reliable features in view, and an autopilot without another position source cannot be armed
without a position. Until the map begins, the companion therefore sends the origin
(:meth:`VisionCompanion.stationary_result`).

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

from mufly.link.codec import FrameDecoder, FrameEncoder, MavMessage, mavlink, to_float32
from mufly.link.ports import Endpoint, Peer, open_port
from mufly.link.vision_input import CLOCK_OFFSET_WINDOW_S, SAME_CLOCK_TOLERANCE_S, pack_pose_covariance
from mufly.slam import FrameEstimate, TrackingResult

_Array = NDArray[np.float64]
COMPANION_COMPONENT_ID = 197
REQUESTED_RATE_HZ = 50.0
MESSAGE_HISTORY_S, MAX_MESSAGE_AGE_S = 3.0, 0.5
"""Duration for which messages are kept, and greatest age of a message relative to its picture (s)."""
_REQUEST_PERIOD_S = 1.0
_REQUESTED_MESSAGE_IDS = (
    mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_RAW_RPM
)  # fmt: skip
_ORIENTATION_DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
_DEFAULT_TILT_SIGMA_RAD, _HEIGHT_SIGMA_M = math.radians(1.0), 0.02
_MIN_TILT_SIGMA_RAD, _TILT_CORRELATION_TIME_S = math.radians(0.15), 20.0
"""Least standard deviation of the tilt, and correlation time of a filter's tilt error (docs/explanation/slam.md)."""
_DEFAULT_POSITION_SIGMA_M, _DEFAULT_HEADING_SIGMA_RAD = 0.1, math.radians(2.0)
"""Standard deviations of position (m) and heading that are assumed where none is received."""
_STATIONARY_SIGMA_M = 0.002
_TILT_VARIANCE_INDICES = 15, 18  # indices of roll and pitch in the upper triangle of a (6, 6) covariance
_CLOCK_DRIFT_TOLERANCE_S = 0.003  # drift between two clocks in 30 s


class VisionCompanion:
    """MAVLink component of an onboard vision computer; the caller supplies the received bytes and the time.

    Attributes
    ----------
    system : int or None
        MAVLink system of the vehicle; None until it is heard.
    has_sender_stamps : bool
        Whether pictures have stamps of their sender. Stamps close to the vehicle's clock are taken as its time.
    """

    def __init__(self) -> None:
        self.has_sender_stamps = False
        self.system: int | None = None
        self._codec = FrameDecoder()
        self._encode: FrameEncoder | None = None
        self._asked_s = -math.inf
        self._synced: deque[tuple[float, float, float]] = deque()  # time, round trip (s), offset (s)
        self._guessed: deque[tuple[float, float]] = deque()
        self._tilt: deque[tuple[float, ...]] = deque()  # vehicle's time, roll, pitch, yaw, p, q, r
        self._motion: deque[tuple[float, ...]] = deque()  # vehicle's time, N, E, velocities
        self._height: deque[tuple[float, float]] = deque()
        self._ranged_s, self._accuracy = -math.inf, _DEFAULT_POSITION_SIGMA_M
        self._rotors, self._tilt_sigma = np.zeros(2), _DEFAULT_TILT_SIGMA_RAD
        self._rng = np.random.default_rng(0)

    @property
    def clock_offset_s(self) -> float:
        """Vehicle's clock minus the local clock (s); NaN while unknown."""
        if self._synced:
            return min(self._synced, key=lambda s: s[1])[2]
        return max((offset for _, offset in self._guessed), default=math.nan)

    def clock_offset_at(self, time_s: float) -> float:
        """Return the time (s) to add to a picture's stamp to obtain the vehicle's time.

        The offset is 0 for stamps by the vehicle's clock, else ``clock_offset_s``.
        """
        ours = self.has_sender_stamps and self._tilt and abs(time_s - self._tilt[-1][0]) < SAME_CLOCK_TOLERANCE_S
        return 0.0 if ours else self.clock_offset_s

    def process_bytes(self, now_s: float, data: bytes) -> None:
        """Process bytes received from the autopilot."""
        for m in self._codec.decode_bytes(now_s, "vehicle", data):
            kind, system = m.get_type(), m.get_srcSystem()
            if kind == "HEARTBEAT" and self.system is None:
                if m.autopilot != mavlink.MAV_AUTOPILOT_INVALID and m.type != mavlink.MAV_TYPE_GCS:
                    self.system = system
                    self._encode = FrameEncoder(system, COMPANION_COMPONENT_ID)
            elif system != self.system:
                continue
            elif kind == "TIMESYNC" and m.tc1:
                sent_s = m.ts1 * 1e-9
                if 0.0 <= now_s - sent_s < 1.0:
                    way, offset = now_s - sent_s, m.tc1 * 1e-9 - 0.5 * (sent_s + now_s)
                    if any(abs(offset - o) > 0.5 * (way + w) + _CLOCK_DRIFT_TOLERANCE_S for _, w, o in self._synced):
                        self._synced.clear()  # the error of each is at most half its round trip: a clock was set
                        self._guessed.clear()
                    self._append_clock_sample(self._synced, now_s, way, offset)
            elif kind == "ATTITUDE":
                t = self._record_boot_time(now_s, m.time_boot_ms)
                self._append_to_history(self._tilt, (t, m.roll, m.pitch, m.yaw, m.rollspeed, m.pitchspeed, m.yawspeed))
            elif kind == "DISTANCE_SENSOR" and m.orientation == _ORIENTATION_DOWN:
                if m.min_distance <= m.current_distance <= m.max_distance:
                    self._ranged_s = now_s
                    self._append_to_history(
                        self._height,
                        (self._record_boot_time(now_s, m.time_boot_ms), 0.01 * m.current_distance),
                    )
            elif kind == "LOCAL_POSITION_NED":
                t = self._record_boot_time(now_s, m.time_boot_ms)
                self._append_to_history(self._motion, (t, m.x, m.y, m.vx, m.vy, m.vz))
                if now_s - self._ranged_s > 1.0:
                    self._append_to_history(self._height, (t, -m.z))
            elif kind == "ODOMETRY" and (told := m.pose_covariance):
                roll, pitch = (told[k] for k in _TILT_VARIANCE_INDICES)
                if roll > 0.0 and pitch > 0.0:
                    self._tilt_sigma = max(_MIN_TILT_SIGMA_RAD, math.sqrt(max(roll, pitch)))
            elif kind == "RAW_RPM" and m.index < len(self._rotors) and math.isfinite(m.frequency):
                self._rotors[m.index] = abs(m.frequency) * 2 * math.pi / 60
            elif kind == "ESTIMATOR_STATUS" and 0.0 < m.pos_horiz_accuracy < math.inf:
                self._accuracy = m.pos_horiz_accuracy

    def _record_boot_time(self, now_s: float, boot_ms: int) -> float:
        theirs_s = 1e-3 * boot_ms
        self._append_clock_sample(self._guessed, now_s, theirs_s - now_s)
        return theirs_s

    @staticmethod
    def _append_clock_sample(row: deque[Any], now_s: float, *values: float) -> None:
        row.append((now_s, *values))
        while row[0][0] < now_s - CLOCK_OFFSET_WINDOW_S:
            row.popleft()

    @staticmethod
    def _append_to_history(row: deque[Any], values: tuple[float, ...]) -> None:
        if row and values[0] <= row[-1][0]:
            if values[0] > row[-1][0] - MESSAGE_HISTORY_S:
                return
            row.clear()  # the vehicle restarted
        row.append(values)
        while row[0][0] < values[0] - MESSAGE_HISTORY_S:
            row.popleft()

    def take_due_messages(self, now_s: float) -> list[bytes]:
        """Return the messages that are due: heartbeat, time synchronisation and requests for the streams needed."""
        if self._encode is None or now_s - self._asked_s < _REQUEST_PERIOD_S:
            return []
        first, self._asked_s = math.isinf(self._asked_s), now_s
        said: list[MavMessage] = [
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER, 8, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
            ),
            mavlink.MAVLink_timesync_message(0, round(now_s * 1e9)),
        ]
        if first or not self._tilt:
            for number in _REQUESTED_MESSAGE_IDS:
                said.append(
                    mavlink.MAVLink_command_long_message(
                        self.system,
                        1,
                        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                        0,
                        number,
                        1e6 / REQUESTED_RATE_HZ,
                        0,
                        0,
                        0,
                        0,
                        0,
                    )
                )
        return [self._encode(m) for m in said]

    def frame_info_at(self, time_s: float) -> FrameEstimate | None:
        """Return the vehicle's state at ``time_s``, interpolated between messages; None without a message near that
        time.

        ``time_s`` is on the local or on the vehicle's clock.
        """
        t = time_s + self.clock_offset_at(time_s)
        if not self._tilt or not self._height or not math.isfinite(t):
            return None
        if (
            t - self._tilt[-1][0] > MAX_MESSAGE_AGE_S
            or self._tilt[0][0] - t > MAX_MESSAGE_AGE_S
            or abs(t - self._height[-1][0]) > 2 * MAX_MESSAGE_AGE_S
        ):
            return None
        a, h = np.array(self._tilt), np.array(self._height)
        roll, pitch, yaw, *rates = (float(np.interp(t, a[:, 0], c)) for c in np.unwrap(a[:, 1:], axis=0).T)
        height = float(np.interp(t, h[:, 0], h[:, 1]))
        velocity = place = None
        if self._motion and abs(t - self._motion[-1][0]) < MAX_MESSAGE_AGE_S:
            m = np.array(self._motion)
            n, e, *v = (float(np.interp(t, m[:, 0], c)) for c in m.T[1:])
            velocity, place = np.array(v), np.array([n, e, math.remainder(yaw, 2 * math.pi)])
        return FrameEstimate(
            roll, pitch, max(0.02, height), np.array(rates), self._rotors.copy(), tilt_sigma=self._tilt_sigma,
            tilt_time_s=_TILT_CORRELATION_TIME_S, height_sigma=_HEIGHT_SIGMA_M, velocity=velocity, place=place,
            place_sigma=(self._accuracy, _DEFAULT_HEADING_SIGMA_RAD),
        )  # fmt: skip

    def stationary_result(self, time_s: float, told: FrameEstimate) -> TrackingResult:
        """Return the tracking result for a picture before take-off: the origin, at this height, with 2 mm of noise.

        Without noise the autopilot would reject the position, which never changes, as frozen.
        """
        *off, turned = _STATIONARY_SIGMA_M * self._rng.standard_normal(4)
        place = np.array([0.0, 0.0, -told.height_m]) + off
        return TrackingResult(time_s, True, "it stands", place, float(turned), _STATIONARY_SIGMA_M**2 * np.eye(4))

    def encode_position(self, answer: TrackingResult) -> bytes | None:
        """Return a trusted SLAM result as a VISION_POSITION_ESTIMATE; None if it cannot be sent."""
        if self._encode is None or not answer.trusted or math.isnan(self.clock_offset_at(answer.time_s)):
            return None
        usec = round(1e6 * (answer.time_s + self.clock_offset_at(answer.time_s)))
        n, e, d = (to_float32(float(v)) for v in answer.position)
        return self._encode(mavlink.MAVLink_vision_position_estimate_message(
            max(0, usec), n, e, d, math.nan, math.nan, to_float32(answer.heading),
            pack_pose_covariance(answer.covariance), 0,
        ))  # fmt: skip


class CompanionPort:
    """Vision companion with its port to the vehicle; the caller exchanges messages at every picture.

    Parameters
    ----------
    endpoint : Endpoint
        Address of the vehicle.

    Attributes
    ----------
    companion : VisionCompanion

    Raises
    ------
    InputError
        If the endpoint cannot be opened.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.companion = VisionCompanion()
        self._port = open_port(endpoint, "--link")
        self._peer: Peer | None = None

    def exchange_messages(self, now_s: float) -> None:
        """Process received messages, and send what is due; ``now_s`` is Unix time (s)."""
        for peer, data in self._port.receive_bytes():
            self.companion.process_bytes(now_s, data)
            if self.companion.system is not None and self._peer is None:
                self._peer = peer
        for data in self.companion.take_due_messages(now_s):
            self._port.send_frame(self._peer, data)

    def frame_infos_at(self, times: _Array) -> Sequence[FrameEstimate | None]:
        """Return the vehicle's state at each of the Unix times (n,) (s); None where it is unknown."""
        self.exchange_messages(time.time())
        return [self.companion.frame_info_at(t) for t in times.tolist()]

    def send_position(self, answer: TrackingResult) -> None:
        """Send the position of an accepted SLAM result to the autopilot."""
        if self._peer is not None and (data := self.companion.encode_position(answer)) is not None:
            self._port.send_frame(self._peer, data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()
