"""Conversion of mission items to the rows of the page's mission table.

Items in the frames LOCAL_NED and LOCAL_ENU have metres; items in a global frame are shown in metres from the vehicle's
origin. Rows are not converted back: a station uploads a mission file, which :mod:`mufly.mission.files.mission_items`
converts to items.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from mufly.mission.files.mission_items import (
    COORDINATE_NOT_GIVEN,
    FRAME_LOCAL_ENU,
    FRAME_LOCAL_NED,
    FRAMES_ABOVE_TERRAIN,
    GlobalOrigin,
    MissionItem,
    has_global_position,
    is_global_frame,
    read_item_position,
)
from mufly.mission.files.mission_items import MissionCommand as Cmd
from mufly.station.signal_history import MissionRow

DEFAULT_SPEED_TEXT = "default"
"""Text of a row that ends an earlier speed setting (-2 in MAVLink)."""
_ACTION_BY_COMMAND: dict[int, str] = {
    Cmd.NAV_TAKEOFF: "take off",
    Cmd.NAV_WAYPOINT: "waypoint",
    Cmd.DO_CHANGE_SPEED: "speed",
    Cmd.NAV_LAND: "land",
    Cmd.NAV_RETURN_TO_LAUNCH: "return",
    Cmd.CONDITION_YAW: "heading",
}
_OTHER_ACTIONS: dict[int, str] = {
    Cmd.NAV_LOITER_UNLIM: "loiter",
    Cmd.NAV_LOITER_TURNS: "loiter (turns)",
    Cmd.NAV_LOITER_TIME: "loiter (time)",
    Cmd.NAV_SPLINE_WAYPOINT: "spline waypoint",
    Cmd.NAV_DELAY: "wait",
    Cmd.CONDITION_DELAY: "wait",
    Cmd.DO_JUMP: "jump",
}
DELAY_COMMANDS = (Cmd.NAV_DELAY, Cmd.CONDITION_DELAY)
"""Wait commands without a position."""
_HEADING_COMMANDS = (Cmd.NAV_WAYPOINT, Cmd.NAV_TAKEOFF, Cmd.NAV_LAND, Cmd.NAV_LOITER_UNLIM)
"""Commands whose parameter 4 is a heading (deg; NaN: none), unlike NAV_LOITER_TIME and NAV_LOITER_TURNS."""
_POSITION_COMMANDS = (*_HEADING_COMMANDS, Cmd.NAV_LOITER_TURNS, Cmd.NAV_LOITER_TIME, Cmd.NAV_SPLINE_WAYPOINT)
_HOLD_COMMANDS = (Cmd.NAV_WAYPOINT, Cmd.NAV_LOITER_TIME, Cmd.NAV_SPLINE_WAYPOINT, *DELAY_COMMANDS)
_NO_POSITION = (math.nan, math.nan, math.nan)


def rows_from_items(
    items: Sequence[MissionItem], origin: GlobalOrigin | None = None, reached: int = 0
) -> list[MissionRow]:
    """Return the rows of the page's mission table that show mission items.

    Parameters
    ----------
    items : sequence of MissionItem
    origin : GlobalOrigin, optional
        Global position of N, E, D = 0, for items in a global frame.
    reached : int
        Number of rows that the vehicle has passed, from the first on.
    """
    return [_make_row(item, origin, k < reached) for k, item in enumerate(items)]


def _make_row(item: MissionItem, origin: GlobalOrigin | None, reached: bool) -> MissionRow:
    command = item.command
    action = _ACTION_BY_COMMAND.get(command) or _OTHER_ACTIONS.get(command, f"command {command}")
    position, text = _NO_POSITION, ""
    if command == Cmd.DO_CHANGE_SPEED:
        speed = item.params[1]
        words = {-2.0: DEFAULT_SPEED_TEXT, -1.0: "unchanged"}.get(speed, f"{speed:g} m/s")
        of = {2.0: "climb ", 3.0: "descent "}.get(item.params[0], "")
        return MissionRow(action, reached=reached, text=of + words)
    if command == Cmd.CONDITION_YAW:
        return MissionRow(action, heading_rad=math.radians(item.params[0]), reached=reached)
    if item.frame in (FRAME_LOCAL_NED, FRAME_LOCAL_ENU) and command in _POSITION_COMMANDS:
        position = read_item_position(item, origin)
    elif is_global_frame(item) and item.x != COORDINATE_NOT_GIVEN:
        if has_global_position(item):
            position, text = read_item_position(item, origin), _describe_hidden_position(item, origin)
    elif command not in _ACTION_BY_COMMAND:
        text = " ".join(f"{p:g}" for p in (*item.params, item.x, item.y, item.z))
    wait_s = item.params[0] if command in _HOLD_COMMANDS and math.isfinite(item.params[0]) else 0.0
    heading = math.radians(item.params[-1]) if command in _HEADING_COMMANDS else math.nan
    return MissionRow(action, position, heading, wait_s, reached, text)


def _describe_hidden_position(item: MissionItem, origin: GlobalOrigin | None) -> str:
    """Return the part of an item's position that a row in metres cannot show, as text; "" if there is none.

    It is the height above terrain or, without an origin, latitude, longitude and height.
    """
    over_terrain = item.frame in FRAMES_ABOVE_TERRAIN
    height = f"{item.z:g} m above the terrain" if over_terrain else f"{item.z:g} m"
    if origin is None:
        return f"{item.x / 1e7:.6f} {item.y / 1e7:.6f} deg, {height}"
    return height if over_terrain else ""


def is_same_mission(a: Sequence[MissionItem], b: Sequence[MissionItem]) -> bool:
    """Return whether two missions are flown alike; the current item is ignored, NaN equals NaN."""
    return [_make_flight_comparison_key(item) for item in a] == [_make_flight_comparison_key(item) for item in b]


def _make_flight_comparison_key(item: MissionItem) -> tuple[object, ...]:
    numbers = (None if math.isnan(v) else round(v, 4) for v in (*item.params, item.z))
    return item.frame, item.command, item.x, item.y, *numbers
