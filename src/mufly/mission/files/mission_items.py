"""Conversion between MAVLink mission items and :class:`mufly.mission.Mission`.

| item (MAV_CMD) | meaning |
|---|---|
| NAV_TAKEOFF (22) | height of the take-off, straight up (no x, y, heading); only before the first waypoint |
| NAV_WAYPOINT (16) | waypoint; parameter 1: wait (s), 4: heading (deg; NaN: the nose points along the path) |
| NAV_LOITER_TIME (19) | waypoint; parameter 1: wait (s); parameter 4 is not a heading (exit of fixed wings) |
| NAV_DELAY (93) | parameter 1: longer wait (s) at the previous waypoint or after the take-off |
| NAV_LOITER_UNLIM (17) | waypoint with parameter 4: heading, and hover there; only as the last item |
| NAV_LAND (21) | fly to its x, y (unless not given), with parameter 4: heading, then land; only as the last |
| NAV_RETURN_TO_LAUNCH (20) | fly home and land; only as the last item |
| DO_CHANGE_SPEED (178) | parameter 2: speed (m/s) of the legs that follow, -2: the mission's own |
| CONDITION_YAW (115) | parameter 1: heading (deg) of the next waypoint without a heading; absolute only |

Frames: LOCAL_NED (1; x, y in 1e-4 m) and LOCAL_ENU (4); with a global origin also GLOBAL (0, 5: altitude above the
sea) and GLOBAL_RELATIVE_ALT (3, 6: above the origin). Items without a place may be in any frame. A mission that ends
without 17, 20 or 21 ends in a hover. A mission with an item that cannot be flown exactly as described is refused as a
whole, with the field at fault.

Speeds, accelerations, obstacle avoidance and the room come from the mission loaded previously: items do not hold them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

from pydantic import ValidationError

from mufly.mission.files.mission_schema import MIN_WAYPOINT_HEIGHT_M, Mission, TakeOff, Waypoint

COORDINATE_NOT_GIVEN = 2**31 - 1
"""Value of an x or y that is not given."""
FRAMES_ABOVE_SEA, FRAMES_ABOVE_ORIGIN, FRAMES_ABOVE_TERRAIN = (0, 5), (3, 6), (10, 11)
"""Global values of MAV_FRAME, with altitude above the sea, above the origin, and above the terrain."""
LOCAL_FRAMES = (1, 4, 7, 8, 9, 12, 20, 21)
"""Values of MAV_FRAME in metres."""
_EARTH_RADIUS_M = 6_378_137.0
_EARTH_ECCENTRICITY_SQ = 6.694379990141e-3


@dataclass(frozen=True)
class GlobalOrigin:
    """Origin of N, E, D: latitude and longitude (deg), altitude above the sea (m)."""

    lat_deg: float
    lon_deg: float
    alt_m: float

    @cached_property
    def _metres_per_deg(self) -> tuple[float, float]:
        phi = math.radians(self.lat_deg)
        w = 1.0 - _EARTH_ECCENTRICITY_SQ * math.sin(phi) ** 2
        north = _EARTH_RADIUS_M * (1.0 - _EARTH_ECCENTRICITY_SQ) / w**1.5 + self.alt_m
        east = (_EARTH_RADIUS_M / math.sqrt(w) + self.alt_m) * math.cos(phi)
        return math.radians(north), math.radians(east)

    def to_global(self, north: float, east: float, down: float) -> tuple[float, float, float]:
        """Return latitude, longitude (deg) and altitude (m) of a place N, E, D (m)."""
        n, e = self._metres_per_deg
        return self.lat_deg + north / n, self.lon_deg + east / e, self.alt_m - down

    def to_local(self, lat_deg: float, lon_deg: float, alt_m: float, frame: int = 0) -> tuple[float, float, float]:
        """Return N, E, D (m) of a place on the globe; its altitude is above the sea unless the MAV_FRAME differs."""
        n, e = self._metres_per_deg
        away = math.remainder(lon_deg - self.lon_deg, 360.0) if math.isfinite(lon_deg) else math.nan
        down = -alt_m if frame in FRAMES_ABOVE_ORIGIN else self.alt_m - alt_m
        return (lat_deg - self.lat_deg) * n, away * e, down


class MissionResultCode(IntEnum):
    """Result codes of the MAVLink mission protocol (MAV_MISSION_RESULT)."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


@dataclass(frozen=True, slots=True)
class MissionItem:
    """Mission item with the fields of MISSION_ITEM_INT: x, y in 1e-4 m or 1e-7 deg, z in m."""

    seq: int
    frame: int
    command: int
    current: int = 0
    autocontinue: int = 1
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    y: int = 0
    z: float = 0.0
    mission_type: int = 0


class MissionCommand(IntEnum):
    """MAV_CMD of items that are flown or displayed here, by MAVLink's names."""

    NAV_WAYPOINT = 16
    NAV_LOITER_UNLIM = 17
    NAV_LOITER_TURNS = 18
    NAV_LOITER_TIME = 19
    NAV_RETURN_TO_LAUNCH = 20
    NAV_LAND = 21
    NAV_TAKEOFF = 22
    NAV_SPLINE_WAYPOINT = 82
    NAV_DELAY = 93
    CONDITION_DELAY = 112
    CONDITION_YAW = 115
    DO_JUMP = 177
    DO_CHANGE_SPEED = 178
    NAV_FENCE_RETURN_POINT = 5000
    NAV_FENCE_POLYGON_VERTEX_INCLUSION = 5001
    NAV_FENCE_POLYGON_VERTEX_EXCLUSION = 5002
    NAV_FENCE_CIRCLE_INCLUSION = 5003
    NAV_FENCE_CIRCLE_EXCLUSION = 5004


FRAME_LOCAL_NED, FRAME_LOCAL_ENU = 1, 4
"""Values of MAV_FRAME."""
_END_ACTION_BY_COMMAND: dict[int, str] = {
    MissionCommand.NAV_LOITER_UNLIM: "hover",
    MissionCommand.NAV_LAND: "land",
    MissionCommand.NAV_RETURN_TO_LAUNCH: "return",
}
_SAME_POSITION_TOLERANCE_M = 0.05
_UNSUPPORTED_COMMANDS: dict[int, str] = {
    31: "NAV_LOITER_TO_ALT", 84: "NAV_VTOL_TAKEOFF", 85: "NAV_VTOL_LAND", 114: "CONDITION_DISTANCE", 179: "DO_SET_HOME",
    181: "DO_SET_RELAY", 183: "DO_SET_SERVO", 189: "DO_LAND_START", 195: "DO_SET_ROI_LOCATION", 197: "DO_SET_ROI_NONE",
    201: "DO_SET_ROI", 203: "DO_DIGICAM_CONTROL", 205: "DO_MOUNT_CONTROL", 206: "DO_SET_CAM_TRIGG_DIST",
    211: "DO_GRIPPER", 530: "SET_CAMERA_MODE", 1000: "DO_GIMBAL_MANAGER_PITCHYAW", 2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE", 2500: "VIDEO_START_CAPTURE", 2501: "VIDEO_STOP_CAPTURE",
} | {
    int(command): command.name
    for command in (
        MissionCommand.NAV_LOITER_TURNS, MissionCommand.NAV_SPLINE_WAYPOINT, MissionCommand.CONDITION_DELAY,
        MissionCommand.DO_JUMP,
    )
}  # fmt: skip
"""MAV_CMD that ground stations use in missions and that cannot be flown here."""

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MissionWithItems:
    """A mission and the corresponding items.

    Attributes
    ----------
    mission : Mission
    items : tuple of MissionItem
    waypoint_item_index : tuple of int
        Index of the item of each waypoint.
    """

    mission: Mission
    items: tuple[MissionItem, ...]
    waypoint_item_index: tuple[int, ...]

    def first_waypoint_from_item(self, item: int) -> int | None:
        """Return the first waypoint from this item or a later one; None if there is none."""
        return next((k for k, i in enumerate(self.waypoint_item_index) if i >= item), None)


class MissionRefusedError(Exception):
    """Error for a mission that cannot be flown: result code to acknowledge, reason, and item at fault."""

    def __init__(self, result: MissionResultCode, why: str, item: int | None = None) -> None:
        super().__init__(f"mission: {why}" if item is None else f"mission item {item}: {why}")
        self.result, self.why, self.item = result, why, item


def _make_refusal(item: MissionItem, result: MissionResultCode, why: str) -> MissionRefusedError:
    return MissionRefusedError(result, why, item.seq)


def mission_from_items(items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None) -> MissionWithItems:
    """Return the mission that items describe.

    Parameters
    ----------
    items : sequence of MissionItem
        Items, numbered from 0.
    base : Mission
        Source of all other settings.
    origin : GlobalOrigin or None
        Origin for items on the globe.

    Raises
    ------
    MissionRefusedError
        If the mission cannot be flown exactly as described.
    """
    waypoints: list[Waypoint] = []
    came_from: list[int] = []
    take_off: TakeOff = base.take_off
    speed: float | None = None
    heading: float | None = None
    end: str = "hover" if items else base.at_end
    for item in items:
        if item.seq and items[item.seq - 1].command in _END_ACTION_BY_COMMAND:
            raise _make_refusal(
                item, MissionResultCode.INVALID_SEQUENCE, "nothing can follow a landing or an endless hover"
            )
        if item.command == MissionCommand.NAV_TAKEOFF:
            if waypoints:
                raise _make_refusal(item, MissionResultCode.INVALID_SEQUENCE, "a take-off comes before all waypoints")
            take_off = _make_table_or_refuse(
                item, TakeOff, height_m=-_read_flight_down_m(item, origin), wait_s=base.take_off.wait_s
            )
        elif item.command in (
            MissionCommand.NAV_WAYPOINT,
            MissionCommand.NAV_LOITER_TIME,
            MissionCommand.NAV_LOITER_UNLIM,
        ):
            headed = item.command != MissionCommand.NAV_LOITER_TIME
            own = _read_heading_deg(item, 3, MissionResultCode.INVALID_PARAM4) if headed else None
            place = _read_flight_position(item, origin)
            wait = 0.0 if item.command == MissionCommand.NAV_LOITER_UNLIM else _read_wait_s(item)
            waypoints.append(_make_waypoint(item, place, wait, heading if own is None else own, speed))
            came_from.append(item.seq)
            heading = None
        elif item.command == MissionCommand.NAV_DELAY and waypoints:
            w = waypoints[-1]
            longer = w.wait_s + _read_wait_s(item)
            waypoints[-1] = _make_waypoint(item, w.position_m, longer, w.heading_deg, w.speed_m_s)
        elif item.command == MissionCommand.NAV_DELAY:
            take_off = _make_table_or_refuse(
                item, TakeOff, height_m=take_off.height_m, wait_s=take_off.wait_s + _read_wait_s(item)
            )
        elif item.command == MissionCommand.DO_CHANGE_SPEED:
            speed = _read_speed_m_s(item, speed)
        elif item.command == MissionCommand.CONDITION_YAW:
            *_, is_relative = item.params
            if is_relative == 1.0:
                raise _make_refusal(
                    item, MissionResultCode.INVALID_PARAM4, "a relative turn is not supported in a mission"
                )
            if is_relative != 0.0 and not math.isnan(is_relative):
                why = f"parameter 4 is {is_relative:g}; give 0, an absolute heading"
                raise _make_refusal(item, MissionResultCode.INVALID_PARAM4, why)
            heading = _read_heading_deg(item, 0, MissionResultCode.INVALID_PARAM1)
        elif item.command not in (MissionCommand.NAV_LAND, MissionCommand.NAV_RETURN_TO_LAUNCH):
            raise _make_refusal(item, MissionResultCode.UNSUPPORTED, f"{_command_name(item.command)} cannot be flown")
        if item.command == MissionCommand.NAV_LAND and waypoints:
            over = _position_before_landing(item, origin, waypoints[-1])
            if over is not None:
                own = _read_heading_deg(item, 3, MissionResultCode.INVALID_PARAM4)
                waypoints.append(_make_waypoint(item, over, 0.0, heading if own is None else own, speed))
                came_from.append(item.seq)
                heading = None
        end = _END_ACTION_BY_COMMAND.get(item.command, end)
    if heading is not None:
        last = next(i for i in reversed(items) if i.command == MissionCommand.CONDITION_YAW)
        raise _make_refusal(
            last, MissionResultCode.INVALID_SEQUENCE, "no waypoint follows that could have this heading"
        )
    if items and not waypoints:
        raise MissionRefusedError(MissionResultCode.INVALID, "the mission has no waypoint")
    parts: dict[str, Any] = {name: getattr(base, name) for name in Mission.model_fields}
    parts |= {"take_off": take_off, "waypoint": tuple(waypoints), "at_end": end}
    return MissionWithItems(Mission(**parts), tuple(items), tuple(came_from))


def mission_to_items(mission: Mission) -> MissionWithItems:
    """Return a mission as items in LOCAL_NED."""
    if not mission.waypoint:
        return MissionWithItems(mission, (), ())
    items = [
        MissionItem(
            0,
            FRAME_LOCAL_NED,
            MissionCommand.NAV_TAKEOFF,
            params=(0.0, 0.0, 0.0, math.nan),
            z=-mission.take_off.height_m,
        )
    ]
    came_from: list[int] = []
    speed: float | None = None
    for w in mission.waypoint:
        if w.speed_m_s != speed:
            speed = w.speed_m_s
            items.append(
                MissionItem(
                    0,
                    FRAME_LOCAL_NED,
                    MissionCommand.DO_CHANGE_SPEED,
                    params=(1.0, -2.0 if speed is None else speed, -1.0, 0.0),
                )
            )
        n, e, d = w.position_m
        heading = math.nan if w.heading_deg is None else w.heading_deg
        came_from.append(len(items))
        items.append(
            MissionItem(
                0,
                FRAME_LOCAL_NED,
                MissionCommand.NAV_WAYPOINT,
                params=(w.wait_s, 0.0, 0.0, heading),
                x=_to_tenth_mm(n),
                y=_to_tenth_mm(e),
                z=d,
            )
        )
    last = items[-1]
    if mission.at_end == "land":
        items.append(replace(last, command=MissionCommand.NAV_LAND, params=(0.0, 0.0, 0.0, math.nan), z=0.0))
    elif mission.at_end == "return":
        items.append(MissionItem(0, FRAME_LOCAL_NED, MissionCommand.NAV_RETURN_TO_LAUNCH))
    numbered = tuple(replace(item, seq=k, current=int(k == 0)) for k, item in enumerate(items))
    return MissionWithItems(mission, numbered, tuple(came_from))


def is_global_frame(item: MissionItem) -> bool:
    """Return whether an item's frame has coordinates in degrees on the globe."""
    return item.frame in (*FRAMES_ABOVE_SEA, *FRAMES_ABOVE_ORIGIN, *FRAMES_ABOVE_TERRAIN)


def has_global_position(item: MissionItem) -> bool:
    """Return whether an item has a place on the globe."""
    return is_global_frame(item) and (item.x, item.y) != (0, 0)


def decode_coordinate(number: int, factor: float) -> float:
    """Return a coordinate of MISSION_ITEM_INT: ``number`` times ``factor``, or NaN if ``number`` marks a missing
    coordinate.
    """
    return math.nan if number == COORDINATE_NOT_GIVEN else number * factor


def _command_name(number: int) -> str:
    entry = _UNSUPPORTED_COMMANDS.get(number)
    return f"command {number}" if entry is None else f"command {number} ({entry})"


def make_fence_item(
    seq: int, command: int, first: float, north: float, east: float, origin: GlobalOrigin | None
) -> MissionItem:
    """Return a fence item at a horizontal position (m), with ``first`` as first parameter of its command.

    The position is global with an origin, else LOCAL_NED.
    """
    params = (first, 0.0, 0.0, 0.0)
    if origin is None:
        return MissionItem(
            seq,
            FRAME_LOCAL_NED,
            command,
            params=params,
            x=_to_tenth_mm(north),
            y=_to_tenth_mm(east),
            mission_type=1,
        )
    lat, lon, _ = origin.to_global(north, east, 0.0)
    return MissionItem(seq, 0, command, params=params, x=round(lat * 1e7), y=round(lon * 1e7), mission_type=1)


def _to_tenth_mm(metres: float) -> int:
    return round(metres * 1e4)


def _make_table_or_refuse(item: MissionItem, table: type, **values: Any) -> Any:
    """Return an instance of ``table``, a class of the mission schema; refuse the item if a value is out of bounds."""
    try:
        return table(**values)
    except ValidationError as error:
        first = error.errors()[0]
        field = str(first["loc"][0]) if first["loc"] else ""
        blame = {
            "height_m": MissionResultCode.INVALID_PARAM7,
            "wait_s": MissionResultCode.INVALID_PARAM1,
            "heading_deg": MissionResultCode.INVALID_PARAM4,
            "speed_m_s": MissionResultCode.INVALID,
        }.get(field, MissionResultCode.INVALID)
        raise _make_refusal(item, blame, f"{field} {values.get(field)!r}: {first['msg'].lower()}") from error


def _make_waypoint(
    item: MissionItem, place: Triple, wait_s: float, heading: float | None, speed: float | None
) -> Waypoint:
    made: Waypoint = _make_table_or_refuse(
        item, Waypoint, position_m=place, wait_s=wait_s, heading_deg=heading, speed_m_s=speed
    )
    return made


def _read_wait_s(item: MissionItem) -> float:
    wait = item.params[0]
    if math.isnan(wait):
        return 0.0
    if item.command == MissionCommand.NAV_DELAY and wait == -1.0:
        why = "a delay until a time of day is not supported; give seconds in parameter 1"
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM1, why)
    if not 0.0 <= wait <= 3600.0:
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM1, f"a wait of {wait:g} s is outside of 0 to 3600 s")
    return wait


def _read_heading_deg(item: MissionItem, k: int, blame: MissionResultCode) -> float | None:
    deg = item.params[k]
    if math.isnan(deg):
        return None
    if abs(deg) > 360.0:
        raise _make_refusal(item, blame, f"a heading of {deg:g} deg is outside of +-360")
    return deg


def _read_speed_m_s(item: MissionItem, before: float | None) -> float | None:
    kind, speed = item.params[0], item.params[1]
    if kind not in (0.0, 1.0):
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM1, "only the horizontal speed (0, 1) can be changed")
    if speed in (-1.0, -2.0):
        return before if speed == -1.0 else None
    if not 0.0 < speed <= 3.0:
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM2, f"a speed of {speed:g} m/s is outside of 0 to 3")
    return float(f"{speed:.7g}")


def _read_down_m(item: MissionItem, origin: GlobalOrigin | None) -> float | None:
    """Return D of an item (m); None if the frame is unknown or its origin is missing."""
    if item.frame == FRAME_LOCAL_NED:
        return item.z
    if item.frame == FRAME_LOCAL_ENU or (item.frame in FRAMES_ABOVE_ORIGIN and origin is not None):
        return -item.z
    return origin.alt_m - item.z if item.frame in FRAMES_ABOVE_SEA and origin is not None else None


def _read_flight_down_m(item: MissionItem, origin: GlobalOrigin | None) -> float:
    """Return D of an item (m), which must be above the floor."""
    down = _read_down_m(item, origin)
    if down is None:
        why = f"frame {item.frame} is not supported; use LOCAL_NED (1)"
        if item.frame in FRAMES_ABOVE_TERRAIN:
            why = f"frame {item.frame} has heights above the terrain, which are not supported; use LOCAL_NED (1)"
        if item.frame in (*FRAMES_ABOVE_SEA, *FRAMES_ABOVE_ORIGIN):
            why = f"frame {item.frame} needs a global origin; use LOCAL_NED (1), or set the vehicle's origin"
        raise _make_refusal(item, MissionResultCode.UNSUPPORTED_FRAME, why)
    if not math.isfinite(down) or down > -MIN_WAYPOINT_HEIGHT_M:
        raise _make_refusal(
            item,
            MissionResultCode.INVALID_PARAM7,
            f"height {-down:g} m is too low; give at least {MIN_WAYPOINT_HEIGHT_M:g} m",
        )
    return float(f"{down:.7g}")


def read_item_horizontal_position(item: MissionItem, origin: GlobalOrigin | None) -> tuple[float, float]:
    """Return N and E of an item (m); NaN if not given."""
    if item.frame in (FRAME_LOCAL_NED, FRAME_LOCAL_ENU):
        a, b = (decode_coordinate(v, 1e-4) for v in (item.x, item.y))
        return (a, b) if item.frame == FRAME_LOCAL_NED else (b, a)
    if origin is None:
        return math.nan, math.nan
    if item.command == MissionCommand.NAV_LAND and (item.x, item.y) == (0, 0):
        return math.nan, math.nan  # land at the present place
    lat, lon = (decode_coordinate(v, 1e-7) for v in (item.x, item.y))
    n, e, _ = origin.to_local(lat, lon, 0.0)
    return n, e


def read_item_position(item: MissionItem, origin: GlobalOrigin | None) -> Triple:
    """Return N, E, D of an item (m); NaN if not given, or unknown without origin or terrain height."""
    down = _read_down_m(item, origin)
    return *read_item_horizontal_position(item, origin), math.nan if down is None else down


def _read_flight_position(item: MissionItem, origin: GlobalOrigin | None) -> Triple:
    down = _read_flight_down_m(item, origin)
    n, e = read_item_horizontal_position(item, origin)
    if math.isnan(n):
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM5_X, "x is not given")
    if math.isnan(e):
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM6_Y, "y is not given")
    return n, e, down


def _position_before_landing(item: MissionItem, origin: GlobalOrigin | None, last: Waypoint) -> Triple | None:
    """Return the position above the landing point at the height of the last waypoint.

    None if the last waypoint already lies there, or the item has no position.
    """
    n, e = read_item_horizontal_position(item, origin)
    before = last.position_m
    if math.isnan(n) or math.isnan(e) or math.dist((n, e), before[:2]) < _SAME_POSITION_TOLERANCE_M:
        return None
    return n, e, before[2]
