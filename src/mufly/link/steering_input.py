"""Set-points streamed by a program, and manual control by sticks.

Set-points are SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT, here a :class:`mufly.mission.SetPoint`.

Position, velocity and heading of each frame:

* LOCAL_NED (1): N-E-D from the origin; N-E-D; from north.
* LOCAL_OFFSET_NED (7): N-E-D from the present position; N-E-D; from north.
* BODY_NED (8), BODY_OFFSET_NED (9), BODY_FRD (12): ahead, right and down of the present position, level; ahead, right,
  down; from the nose.
* GLOBAL (0, 5), GLOBAL_RELATIVE_ALT (3, 6): global, with altitude above the sea (0, 5) or above the origin (3, 6);
  N-E-D; from north.

Fields excluded by ``type_mask`` and NaN are not given. Accelerations and forces are not supported. A message without
other fields, or with unknown bits in its mask, is ignored.

Sticks are RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, the thesis's state "RC". While any of the channels 1 to 4 is
overridden (not 0, not 65535), the pilot flies; when all are released, the helicopter hovers. A ground station with a
joystick sends MANUAL_CONTROL all the time. It counts only after a manual mode was requested (DO_SET_MODE to ALTCTL and
the like).

======================= =============== ======================== ==============================
stick                   channel         MANUAL_CONTROL           request at full deflection
======================= =============== ======================== ==============================
right                   1 up            y = 1000                 roll to the right (STK_TILT)
back                    2 up            x = -1000                nose up (STK_TILT)
throttle up             3 up            z = 1000 (500: neither)  climb (STK_CLIMB)
turn right              4 up            r = 1000                 turn to the right (STK_YAWRATE)
======================= =============== ======================== ==============================

Channels are 1000 to 2000 us, 1500 in the middle; the dead band is 3 % to either side. The directions are those of PX4
and ArduPilot (MAVLink's own text has r reversed).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mufly.estimate import Estimate
from mufly.flight import Autopilot
from mufly.link.codec import FRAMES_ABOVE_ORIGIN, FRAMES_ABOVE_SEA, GlobalOrigin, MavMessage, decode_coordinate
from mufly.mission import REQUEST_ACCEPTED, RequestAnswer, SetPoint, reject_temporarily

FloatTriple = tuple[float, float, float]

_IGNORE_HEADING, _IGNORE_YAW_RATE, _KNOWN_MASK_BITS = 0x400, 0x800, 0xFFF
_FRAME_LOCAL, _FRAME_LOCAL_OFFSET, _FRAMES_BODY = 1, 7, (8, 9, 12)


def parse_set_point(message: MavMessage, measured: Estimate, origin: GlobalOrigin | None) -> SetPoint | None:
    """Return the set-point of a message; None if it has none that is supported here.

    Parameters
    ----------
    message : SET_POSITION_TARGET_LOCAL_NED or SET_POSITION_TARGET_GLOBAL_INT
    measured : Estimate
        Present position and heading, for relative frames.
    origin : GlobalOrigin or None
        Global position of N, E, D = 0, for global frames.
    """
    mask, frame = message.type_mask, message.coordinate_frame
    if mask & ~_KNOWN_MASK_BITS:
        return None
    on_globe = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    given = _parse_global_position(message, origin) if on_globe else (message.x, message.y, message.z)
    if given is None or (not on_globe and frame not in (_FRAME_LOCAL, _FRAME_LOCAL_OFFSET, *_FRAMES_BODY)):
        return None
    place = _mask_ignored_axes(given, mask)
    speed = _mask_ignored_axes((message.vx, message.vy, message.vz), mask >> 3)
    heading = math.nan if mask & _IGNORE_HEADING else float(message.yaw)
    yaw_rate = math.nan if mask & _IGNORE_YAW_RATE else float(message.yaw_rate)
    if not on_globe and frame in _FRAMES_BODY:
        yaw = float(measured.attitude[2])
        place, speed, heading = (
            _rotate_body_to_ned(place, yaw),
            _rotate_body_to_ned(speed, yaw),
            heading + yaw,
        )
    if not on_globe and frame != _FRAME_LOCAL:
        n, e, d = measured.position.tolist()
        place = (place[0] + n, place[1] + e, place[2] + d)
    out = SetPoint(
        None if all(math.isnan(v) for v in place) else place,
        None if all(math.isnan(v) for v in speed) else speed,
        None if math.isnan(heading) else heading,
        None if math.isnan(yaw_rate) else yaw_rate,
    )
    return None if out == SetPoint() else out


def _mask_ignored_axes(values: FloatTriple, mask: int) -> FloatTriple:
    n, e, d = (math.nan if mask & 1 << k else float(v) for k, v in enumerate(values))
    return n, e, d


def _rotate_body_to_ned(ahead_right_down: FloatTriple, yaw: float) -> FloatTriple:
    """Return a body vector (ahead, right, down) in N, E, D; if only one of ahead and right is NaN, it counts as 0."""
    a, r, d = ahead_right_down
    if math.isnan(a) != math.isnan(r):
        a, r = (0.0 if math.isnan(v) else v for v in (a, r))
    c, s = math.cos(yaw), math.sin(yaw)
    return c * a - s * r, s * a + c * r, d


def _parse_global_position(message: MavMessage, origin: GlobalOrigin | None) -> FloatTriple | None:
    frame = message.coordinate_frame
    if origin is None or frame not in (*FRAMES_ABOVE_SEA, *FRAMES_ABOVE_ORIGIN):
        return None
    lat, lon = (decode_coordinate(v, 1e-7) for v in (message.lat_int, message.lon_int))
    return origin.to_local(lat, lon, message.alt, frame)


STICK_TIMEOUT_S = 1.0
"""Age at which sticks expire (s)."""
_STICK_DEADBAND = 0.03
_RELEASED_CHANNEL_PULSES_US = (0, 65535)
_AXIS_NOT_GIVEN = 32767


@dataclass(frozen=True, slots=True)
class StickDeflection:
    """Stick deflections from -1 to 1: right, back (nose up), up, turn right."""

    roll: float = 0.0
    pitch: float = 0.0
    climb: float = 0.0
    yaw: float = 0.0


def _apply_deadband(*values: float) -> StickDeflection:
    held = [min(max(v, -1.0), 1.0) for v in values]
    return StickDeflection(
        *(
            math.copysign((abs(v) - _STICK_DEADBAND) / (1.0 - _STICK_DEADBAND), v) if abs(v) > _STICK_DEADBAND else 0.0
            for v in held
        )
    )


def parse_rc_override(message: MavMessage) -> StickDeflection | None:
    """Return the sticks of an RC_CHANNELS_OVERRIDE; None if channels 1 to 4 are all released."""
    pulses = [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw]
    if all(us in _RELEASED_CHANNEL_PULSES_US for us in pulses):
        return None
    return _apply_deadband(*(0.0 if us in _RELEASED_CHANNEL_PULSES_US else (us - 1500) / 500 for us in pulses))


def parse_manual_control(message: MavMessage) -> StickDeflection:
    """Return the stick deflections in a MANUAL_CONTROL."""
    x, y, z, r = (None if v == _AXIS_NOT_GIVEN else v / 1000 for v in (message.x, message.y, message.z, message.r))
    return _apply_deadband(y or 0.0, -(x or 0.0), 0.0 if z is None else 2.0 * z - 1.0, r or 0.0)


class StickInputHandler:
    """Handler of stick messages, which commands the autopilot by the latest stick deflections.

    Parameters
    ----------
    autopilot : Autopilot
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._manual, self._heard_s = StickDeflection(), -math.inf
        self._by_hand = False
        self._overridden = False

    @property
    def is_manual_mode(self) -> bool:
        """Return whether the sticks are in use because a manual mode was requested."""
        return self._by_hand

    def handle_rc_override(self, message: MavMessage) -> RequestAnswer:
        """Apply the sticks of an RC_CHANNELS_OVERRIDE, or end manual control if the channels are released."""
        wanted = parse_rc_override(message)
        if wanted is not None:
            self._overridden = True
            return self._set_autopilot_sticks(wanted)
        if self._overridden:
            self._overridden = False
            return self._autopilot.release_sticks()
        return REQUEST_ACCEPTED

    def handle_manual_control(self, now_s: float, message: MavMessage) -> RequestAnswer:
        """Take the sticks of a MANUAL_CONTROL, and pass them to the autopilot if a manual mode is active."""
        self._manual, self._heard_s = parse_manual_control(message), now_s
        return self._set_autopilot_sticks(self._manual) if self._by_hand else REQUEST_ACCEPTED

    def enter_manual_mode(self, now_s: float) -> RequestAnswer:
        """Enter manual mode on request."""
        if self._overridden:
            return REQUEST_ACCEPTED
        if now_s - self._heard_s > STICK_TIMEOUT_S:
            return reject_temporarily("no sticks; stream MANUAL_CONTROL or RC_CHANNELS_OVERRIDE first")
        self._by_hand = True
        return self._set_autopilot_sticks(self._manual)

    def release_sticks(self) -> None:
        """Leave manual mode: another mode is requested, or the sticks have expired."""
        if self._by_hand or self._overridden:
            self._autopilot.release_sticks()
        self._by_hand = self._overridden = False

    def forget_sticks(self) -> None:
        """Discard the sticks after a change of the commander."""
        self.release_sticks()
        self._manual, self._heard_s = StickDeflection(), -math.inf

    def _set_autopilot_sticks(self, d: StickDeflection) -> RequestAnswer:
        tilt, turn, climb = (
            self._autopilot.parameters[name].value for name in ("STK_TILT", "STK_YAWRATE", "STK_CLIMB")
        )
        tilt, turn = math.radians(tilt), math.radians(turn)
        return self._autopilot.set_sticks(d.roll * tilt, d.pitch * tilt, d.yaw * turn, d.climb * climb)
