"""What is streamed to steer it: set-points from a program, and a pilot's sticks.

Set-points are SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT, here a `SetPoint` of the mission.

========================= ===========================================================================================
frame                     position, velocity and heading are
========================= ===========================================================================================
LOCAL_NED (1)             N-E-D from the origin; N-E-D; from north
LOCAL_OFFSET_NED (7)      N-E-D from where it is now; N-E-D; from north
BODY_NED (8),             ahead, right and down of where it is now, level; ahead, right, down; from the nose
BODY_OFFSET_NED (9),
BODY_FRD (12)
GLOBAL (0, 5),            on the globe, with altitude above the sea (0, 5) or above the origin (3, 6); N-E-D; from north
GLOBAL_RELATIVE_ALT (3, 6)
========================= ===========================================================================================

Fields that ``type_mask`` leaves out, and those that are no numbers, are not given. Accelerations and forces are not
followed; a message that gives nothing else, or whose mask has bits that this vehicle does not know, says nothing.

Sticks are RC_CHANNELS_OVERRIDE and MANUAL_CONTROL, the thesis's state "RC". An override is what its name says: while
any of the channels 1 to 4 is given (not 0, not 65535), the pilot flies; when all are released, the helicopter hovers.
MANUAL_CONTROL comes all the time from ground stations with a joystick, so it only counts once a mode for flying by
hand has been asked for (DO_SET_MODE to ALTCTL and its like).

======================= =============== ======================== ==============================
stick                   channel         MANUAL_CONTROL           asks for, at its end
======================= =============== ======================== ==============================
right                   1 up            y = 1000                 roll to the right (STK_TILT)
back                    2 up            x = -1000                nose up (STK_TILT)
throttle up             3 up            z = 1000 (500: neither)  climb (STK_CLIMB)
turn right              4 up            r = 1000                 turn to the right (STK_YAWRATE)
======================= =============== ======================== ==============================

Channels are 1000 to 2000 us, 1500 in the middle; a middle of 3 % to either side is dead. The directions are those of
PX4 and ArduPilot (MAVLink's own text has r the other way round).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mufly.estimate import Estimate
from mufly.flight import Autopilot
from mufly.link.codec import MavMessage, unscaled
from mufly.link.conventions import ABOVE_ORIGIN, ABOVE_SEA, Origin
from mufly.mission import ACCEPTED, Answer, SetPoint, later

Triple = tuple[float, float, float]

_NO_HEADING, _NO_YAW_RATE, _KNOWN_BITS = 0x400, 0x800, 0xFFF
_LOCAL, _OFFSET, _BODY = 1, 7, (8, 9, 12)


def set_point_of(message: MavMessage, measured: Estimate, origin: Origin | None) -> SetPoint | None:
    """Return what a message asks for; None if that is nothing, or nothing that is understood here.

    Parameters
    ----------
    message : SET_POSITION_TARGET_LOCAL_NED or SET_POSITION_TARGET_GLOBAL_INT
    measured : Estimate
        Where it is now, for frames that start there.
    origin : Origin or None
        For frames on the globe.
    """
    mask, frame = message.type_mask, message.coordinate_frame
    if mask & ~_KNOWN_BITS:
        return None
    on_globe = message.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    given = _from_globe(message, origin) if on_globe else (message.x, message.y, message.z)
    if given is None or (not on_globe and frame not in (_LOCAL, _OFFSET, *_BODY)):
        return None
    place = _masked(given, mask)
    speed = _masked((message.vx, message.vy, message.vz), mask >> 3)
    heading = math.nan if mask & _NO_HEADING else float(message.yaw)
    yaw_rate = math.nan if mask & _NO_YAW_RATE else float(message.yaw_rate)
    if not on_globe and frame in _BODY:
        yaw = float(measured.attitude[2])
        place, speed, heading = _turned(place, yaw), _turned(speed, yaw), heading + yaw
    if not on_globe and frame != _LOCAL:
        n, e, d = measured.position.tolist()
        place = (place[0] + n, place[1] + e, place[2] + d)
    out = SetPoint(
        None if all(math.isnan(v) for v in place) else place,
        None if all(math.isnan(v) for v in speed) else speed,
        None if math.isnan(heading) else heading,
        None if math.isnan(yaw_rate) else yaw_rate,
    )
    return None if out == SetPoint() else out


def _masked(values: Triple, mask: int) -> Triple:
    n, e, d = (math.nan if mask & 1 << k else float(v) for k, v in enumerate(values))
    return n, e, d


def _turned(ahead_right_down: Triple, yaw: float) -> Triple:
    """Ahead and right as north and east; an axis that is not given has no direction, so neither has the other."""
    a, r, d = ahead_right_down
    if math.isnan(a) != math.isnan(r):
        a, r = (0.0 if math.isnan(v) else v for v in (a, r))
    c, s = math.cos(yaw), math.sin(yaw)
    return c * a - s * r, s * a + c * r, d


def _from_globe(message: MavMessage, origin: Origin | None) -> Triple | None:
    frame = message.coordinate_frame
    if origin is None or frame not in (*ABOVE_SEA, *ABOVE_ORIGIN):
        return None
    lat, lon = (unscaled(v, 1e-7) for v in (message.lat_int, message.lon_int))
    return origin.to_local(lat, lon, message.alt, frame)


FRESH_S = 1.0
"""Sticks that have not been heard for so long are not there (s)."""
_DEAD = 0.03
_RELEASED = (0, 65535)
_NOT_GIVEN = 32767


@dataclass(frozen=True, slots=True)
class Deflection:
    """Sticks from -1 to 1: right, back (nose up), up, turn right."""

    roll: float = 0.0
    pitch: float = 0.0
    climb: float = 0.0
    yaw: float = 0.0


def _deflection(*values: float) -> Deflection:
    held = [min(max(v, -1.0), 1.0) for v in values]
    return Deflection(
        *(math.copysign((abs(v) - _DEAD) / (1.0 - _DEAD), v) if abs(v) > _DEAD else 0.0 for v in held)
    )


def of_channels(message: MavMessage) -> Deflection | None:
    """Return the sticks of an RC_CHANNELS_OVERRIDE; None if channels 1 to 4 are all released."""
    pulses = [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw]
    if all(us in _RELEASED for us in pulses):
        return None
    return _deflection(*(0.0 if us in _RELEASED else (us - 1500) / 500 for us in pulses))


def of_manual_control(message: MavMessage) -> Deflection:
    """Return the sticks of a MANUAL_CONTROL."""
    x, y, z, r = (None if v == _NOT_GIVEN else v / 1000 for v in (message.x, message.y, message.z, message.r))
    return _deflection(y or 0.0, -(x or 0.0), 0.0 if z is None else 2.0 * z - 1.0, r or 0.0)


class ManualControl:
    """Whose sticks count, and what they ask of the autopilot.

    Parameters
    ----------
    autopilot : Autopilot
    """

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._manual, self._heard_s = Deflection(), -math.inf
        self._by_hand = False
        self._overridden = False

    @property
    def by_mode(self) -> bool:
        """Whether they count because a mode for flying by hand was asked for."""
        return self._by_hand

    def override(self, message: MavMessage) -> Answer:
        """Take an RC_CHANNELS_OVERRIDE."""
        wanted = of_channels(message)
        if wanted is not None:
            self._overridden = True
            return self._fly(wanted)
        if self._overridden:
            self._overridden = False
            return self._autopilot.sticks_off()
        return ACCEPTED

    def manual(self, now_s: float, message: MavMessage) -> Answer:
        """Take a MANUAL_CONTROL."""
        self._manual, self._heard_s = of_manual_control(message), now_s
        return self._fly(self._manual) if self._by_hand else ACCEPTED

    def by_hand(self, now_s: float) -> Answer:
        """A mode for flying by hand is asked for."""
        if self._overridden:
            return ACCEPTED
        if now_s - self._heard_s > FRESH_S:
            return later("no sticks; stream MANUAL_CONTROL or RC_CHANNELS_OVERRIDE first")
        self._by_hand = True
        return self._fly(self._manual)

    def off(self) -> None:
        """Another mode is asked for, or the pilot is not heard any more."""
        if self._by_hand or self._overridden:
            self._autopilot.sticks_off()
        self._by_hand = self._overridden = False

    def forget(self) -> None:
        """There is another commander: what was heard of sticks was not said by that one."""
        self.off()
        self._manual, self._heard_s = Deflection(), -math.inf

    def _fly(self, d: Deflection) -> Answer:
        tilt, turn, climb = (
            self._autopilot.parameters[name].value for name in ("STK_TILT", "STK_YAWRATE", "STK_CLIMB")
        )
        tilt, turn = math.radians(tilt), math.radians(turn)
        return self._autopilot.sticks(d.roll * tilt, d.pitch * tilt, d.yaw * turn, d.climb * climb)
