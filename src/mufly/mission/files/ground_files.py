"""Mission files of other ground stations: QGroundControl's plan (JSON) and waypoint file ("QGC WPL 110").

Both hold MAVLink items, mostly on the globe. These are converted to metres north and east of the planned home, where
the helicopter stands at the start: ``plannedHomePosition`` of a plan, the first line of a waypoint file. Heights are
relative to home. Positions in LOCAL_NED stay as they are. An item that cannot be flown exactly as described is refused,
with its number and a remedy.

Sources: https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html and
https://mavlink.io/en/file_formats/#mission_plain_text_file.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mufly.errors import InputError
from mufly.mission.files.geofence import (
    EXCLUSION_CIRCLE,
    EXCLUSION_VERTEX,
    INCLUSION_CIRCLE,
    INCLUSION_VERTEX,
    fence_from_items,
)
from mufly.mission.files.mission_items import (
    COORDINATE_NOT_GIVEN,
    FRAMES_ABOVE_SEA,
    LOCAL_FRAMES,
    GlobalOrigin,
    MissionCommand,
    MissionItem,
    MissionRefusedError,
    has_global_position,
    mission_from_items,
)
from mufly.mission.files.mission_schema import Mission

MISSION_FILE_ENDINGS = (".toml", ".plan", ".waypoints", ".txt")
"""Endings of readable mission files."""

GROUND_STATION_DESCRIPTION_PREFIX = "from a ground station's file"
"""Prefix of the description of a mission from a ground station's file."""

_WAYPOINT_FILE_HEADER = "QGC WPL"
_EDIT_PLAN_REMEDY = "change or delete it in the ground station, and save the plan again"
_NAN = math.nan
_IMPORTED_TABLES: tuple[str, ...] = ("take_off", "waypoint", "at_end", "fence")


@dataclass(frozen=True, slots=True)
class GroundStationFile:
    """Content of a ground station's file.

    Attributes
    ----------
    items : tuple of MissionItem
        Items, numbered from 0.
    item_locations : tuple of str
        Location of each item: "item 2", "line 4".
    home : GlobalOrigin or None
        The planned home.
    ignored_parts : tuple of str
        Descriptions of the parts of the file that are not flown.
    fence_items : tuple of MissionItem
        Items of the geofence.
    """

    items: tuple[MissionItem, ...]
    item_locations: tuple[str, ...]
    home: GlobalOrigin | None
    ignored_parts: tuple[str, ...] = ()
    fence_items: tuple[MissionItem, ...] = ()


def is_ground_station_text(text: str) -> bool:
    """Return whether a text is a file of another ground station, not TOML."""
    head = text.lstrip("\ufeff \t\r\n")
    return head.startswith((_WAYPOINT_FILE_HEADER, "{"))


def ground_text_to_mission_tables(text: str, where: str) -> dict[str, Any]:
    """Convert the text of another ground station's mission file to the tables of this package's mission file.

    Parameters
    ----------
    text : str
        Content of the file.
    where : str
        Name of the file for error messages.

    Raises
    ------
    InputError
        If an item or line cannot be read or flown; the message names it and the remedy.
    """
    head = text.lstrip("\ufeff \t\r\n")
    found = _parse_waypoint_file(head, where) if head.startswith(_WAYPOINT_FILE_HEADER) else _parse_plan(head, where)
    if not found.items:
        raise InputError(where, "mission", "contains no items", "plan a take-off and waypoints first")
    home = found.home or _first_global_position(found.items)
    try:
        plan = mission_from_items(found.items, Mission(), home)
    except MissionRefusedError as refusal:
        key = "" if refusal.item is None else found.item_locations[refusal.item]
        raise InputError(where, key, refusal.why, _refusal_remedy(refusal, found)) from None
    try:
        fence = fence_from_items(found.fence_items, None, home)
    except MissionRefusedError as refusal:
        raise InputError(where, "geoFence", refusal.why, _EDIT_PLAN_REMEDY) from None
    tables: dict[str, Any] = plan.mission.replace_parts(fence=fence).model_dump(exclude_none=True)
    kept = {key: tables[key] for key in _IMPORTED_TABLES if key in tables}
    return {"description": _describe_mission(found, home), **kept}


def _refusal_remedy(refusal: MissionRefusedError, found: GroundStationFile) -> str:
    item = None if refusal.item is None else found.items[refusal.item]
    if item is not None and item.frame in (10, 11):
        return "set its altitude mode to relative to launch, and save the plan again"
    return _EDIT_PLAN_REMEDY


def _describe_mission(found: GroundStationFile, home: GlobalOrigin | None) -> str:
    words = [GROUND_STATION_DESCRIPTION_PREFIX]
    if any(has_global_position(item) for item in found.items) and home is not None:
        of = "its planned home" if found.home is not None else "its first waypoint"
        words.append(f"metres from {of}, {home.lat_deg:.7g}, {home.lon_deg:.7g}")
    words += [f"{part} not used" for part in found.ignored_parts]
    return "; ".join(words)


def _first_global_position(items: Sequence[MissionItem]) -> GlobalOrigin | None:
    """Return the first place on the globe, as a substitute for a home."""
    first = next((i for i in items if has_global_position(i) and COORDINATE_NOT_GIVEN not in (i.x, i.y)), None)
    return None if first is None else GlobalOrigin(first.x / 1e7, first.y / 1e7, 0.0)


# ---- waypoint files


def _parse_waypoint_file(text: str, where: str) -> GroundStationFile:
    items: list[MissionItem] = []
    places: list[str] = []
    for k, line in enumerate(text.splitlines()[1:], 2):
        parts = line.split()
        if not parts or line.lstrip().startswith("#"):
            continue
        key = f"line {k}"
        if len(parts) != 12:
            problem = f"has {len(parts)} columns; a waypoint has 12"
            raise InputError(where, key, problem, "save the file again in the ground station")
        try:
            _, _, frame, command, *rest, _ = parts
            *parameters, heading, north, east, height = map(float, rest)
        except ValueError:
            remedy = "save the file again in the ground station"
            raise InputError(where, key, f"{line.strip()[:60]!r} is not a waypoint", remedy) from None
        # These files cannot express "no heading"; their programs write 0.
        numbers = (*parameters, _NAN if heading == 0.0 else heading, north, east, height)
        items.append(_make_mission_item(len(items), int(frame), int(command), numbers, where, key))
        places.append(key)
    home = None
    # The first line is the home: a waypoint in height above the sea.
    if (
        len(items) > 1
        and items[0].command == MissionCommand.NAV_WAYPOINT
        and items[0].frame in FRAMES_ABOVE_SEA
        and has_global_position(items[0])
    ):
        first = items.pop(0)
        places.pop(0)
        home = GlobalOrigin(first.x / 1e7, first.y / 1e7, first.z if math.isfinite(first.z) else 0.0)
    numbered = tuple(_renumber_item(item, k) for k, item in enumerate(items))
    return GroundStationFile(numbered, tuple(places), home)


def _renumber_item(item: MissionItem, k: int) -> MissionItem:
    return MissionItem(k, item.frame, item.command, params=item.params, x=item.x, y=item.y, z=item.z)


def _make_mission_item(
    seq: int, frame: int, command: int, numbers: Sequence[float], where: str, key: str
) -> MissionItem:
    scale = 1e4 if frame in LOCAL_FRAMES else 1e7
    p1, p2, p3, p4, *level, z = numbers
    if any(math.isinf(v) for v in numbers) or any(abs(v) * scale >= COORDINATE_NOT_GIVEN for v in level):
        raise InputError(where, key, "has an invalid coordinate", _EDIT_PLAN_REMEDY)
    x, y = (COORDINATE_NOT_GIVEN if math.isnan(v) else round(v * scale) for v in level)
    return MissionItem(seq, frame, command, params=(p1, p2, p3, p4), x=x, y=y, z=z)


# ---- plans


def _parse_plan(text: str, where: str) -> GroundStationFile:
    try:
        content = json.loads(text)
    except ValueError as error:
        raise InputError(where, "", f"is not valid JSON ({error})", "save the plan again") from None
    kind = content.get("fileType") if isinstance(content, dict) else None
    if kind != "Plan":
        problem = "is JSON, but no plan" if kind is None else f"is of the type {str(kind)[:30]!r}, not a plan"
        raise InputError(where, "fileType", problem, "give a QGroundControl plan (.plan), or a mission file in TOML")
    mission = _require_json_object(content.get("mission"), where, "mission")
    items: list[MissionItem] = []
    places: list[str] = []
    for k, entry in enumerate(_require_json_list(mission.get("items"), where, "mission.items"), 1):
        for one in _flatten_items(_require_json_object(entry, where, f"item {k}"), where, f"item {k}"):
            items.append(_parse_plan_item(len(items), one, where, f"item {k}"))
            places.append(f"item {k}")
    rally = content.get("rallyPoints")
    points = rally.get("points") if isinstance(rally, dict) else None
    left_out = [f"{len(points)} rally points"] if isinstance(points, list) and points else []
    home = _parse_home(mission.get("plannedHomePosition"))
    fence = _parse_fence_items(content.get("geoFence"), where)
    return GroundStationFile(tuple(items), tuple(places), home, tuple(left_out), fence)


def _parse_fence_items(content: object, where: str) -> tuple[MissionItem, ...]:
    """Return the zones of a plan's geofence as items."""
    if not isinstance(content, dict):
        return ()
    made: list[tuple[int, float, object]] = []
    for k, zone in enumerate(content.get("polygons") or (), 1):
        table = _require_json_object(zone, where, f"geoFence.polygons[{k}]")
        corners = _require_json_list(table.get("polygon"), where, f"geoFence.polygons[{k}]")
        vertex = INCLUSION_VERTEX if table.get("inclusion", True) else EXCLUSION_VERTEX
        made += [(vertex, float(len(corners)), corner) for corner in corners]
    for k, zone in enumerate(content.get("circles") or (), 1):
        table = _require_json_object(zone, where, f"geoFence.circles[{k}]")
        circle = _require_json_object(table.get("circle"), where, f"geoFence.circles[{k}]")
        radius = circle.get("radius")
        shape = INCLUSION_CIRCLE if table.get("inclusion", True) else EXCLUSION_CIRCLE
        made.append((shape, float(radius) if isinstance(radius, int | float) else _NAN, circle.get("center")))
    items = []
    for k, (command, first, place) in enumerate(made):
        at = _parse_home(place)
        if at is None:
            raise InputError(where, "geoFence", f"{place!r:.40} is not a place", "save the plan again")
        items.append(
            _make_mission_item(k, 0, command, (first, 0.0, 0.0, 0.0, at.lat_deg, at.lon_deg, 0.0), where, "geoFence")
        )
    return tuple(items)


def _flatten_items(entry: Mapping[str, Any], where: str, key: str) -> list[Mapping[str, Any]]:
    """Return the simple items of an entry: itself, or the items of a survey."""
    if entry.get("type") != "ComplexItem":
        return [entry]
    made = entry.get("TransectStyleComplexItem")
    parts = made.get("Items") if isinstance(made, dict) else None
    if isinstance(parts, list) and parts:
        return [_require_json_object(part, where, key) for part in parts]
    kind = str(entry.get("complexItemType", "complex item"))[:40]
    raise InputError(where, key, f"a {kind} cannot be flown", "plan simple waypoints in its place")


def _parse_plan_item(seq: int, entry: Mapping[str, Any], where: str, key: str) -> MissionItem:
    frame, command, params = entry.get("frame"), entry.get("command"), entry.get("params")
    whole = all(isinstance(v, int) and not isinstance(v, bool) for v in (frame, command))
    if not whole or not isinstance(params, list) or len(params) != 7:
        raise InputError(where, key, "has no frame, command and seven params", "save the plan again")
    try:
        numbers = [_NAN if v is None else float(v) for v in params]
    except (TypeError, ValueError):
        raise InputError(where, key, "has params that are not numbers", "save the plan again") from None
    assert isinstance(frame, int)
    assert isinstance(command, int)
    return _make_mission_item(seq, frame, command, numbers, where, key)


def _parse_home(value: object) -> GlobalOrigin | None:
    """Return the home position; None if it is missing, zero or out of range."""
    if not isinstance(value, list) or len(value) < 2:
        return None
    numbers = [float(v) if isinstance(v, int | float) and not isinstance(v, bool) else _NAN for v in value[:3]]
    lat, lon, alt = [*numbers, 0.0][:3]
    known = abs(lat) <= 85.0 and abs(lon) <= 180.0 and (lat, lon) != (0.0, 0.0)
    return GlobalOrigin(lat, lon, alt if math.isfinite(alt) else 0.0) if known else None


def _require_json_object(value: object, where: str, key: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise InputError(where, key, "is missing or no table", "save the plan again in QGroundControl")
    return value


def _require_json_list(value: object, where: str, key: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(where, key, "is missing or no list", "save the plan again in QGroundControl")
    return value
