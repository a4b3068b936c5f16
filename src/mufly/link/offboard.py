"""Set-points that a program streams: SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT as a `SetPoint` of the mission.

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
"""

from __future__ import annotations

import math

from mufly.link.dialect import MavMessage
from mufly.link.geodesy import Origin
from mufly.mission import SetPoint
from mufly.sensors import Measurement

__all__ = ["set_point_of"]

Triple = tuple[float, float, float]

_NO_HEADING, _NO_YAW_RATE, _KNOWN_BITS = 0x400, 0x800, 0xFFF
_LOCAL, _OFFSET, _BODY = 1, 7, (8, 9, 12)
_ABOVE_SEA, _ABOVE_ORIGIN = (0, 5), (3, 6)
_INT32_MAX = 2**31 - 1


def set_point_of(message: MavMessage, measured: Measurement, origin: Origin | None) -> SetPoint | None:
    """Return what a message asks for; None if that is nothing, or nothing that is understood here.

    Parameters
    ----------
    message : SET_POSITION_TARGET_LOCAL_NED or SET_POSITION_TARGET_GLOBAL_INT
    measured : Measurement
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
    if origin is None or frame not in (*_ABOVE_SEA, *_ABOVE_ORIGIN):
        return None
    lat, lon = (math.nan if v == _INT32_MAX else v * 1e-7 for v in (message.lat_int, message.lon_int))
    n, e, d = origin.to_local(lat, lon, message.alt)
    return n, e, -message.alt if frame in _ABOVE_ORIGIN else d
