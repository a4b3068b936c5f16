"""A mission as rows of a table, and as items of MAVLink.

Rows are what a page shows (:class:`mufly.station.view.MissionRow`); items are what travels. Ours go in metres, in the
frame LOCAL_NED (x and y in 1e-4 m); items in a global frame are shown in metres from the vehicle's origin. A mission
file becomes items in :mod:`mufly.link.missions`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace

from mufly.errors import InputError
from mufly.link.geodesy import Origin
from mufly.link.transfer_notes import Item
from mufly.station.view import MissionRow

__all__ = ["items_of", "rows_of"]

LOCAL_NED = 1
WAYPOINT, RETURN, LAND, TAKE_OFF, HEADING, SPEED = 16, 20, 21, 22, 115, 178  # MAV_CMD
OWN_SPEED = "the mission's own"
"""Text of a row that ends what an earlier row said of speed (-2 in MAVLink)."""
_ACTIONS = {
    TAKE_OFF: "take off",
    WAYPOINT: "waypoint",
    SPEED: "speed",
    LAND: "land",
    RETURN: "return",
    HEADING: "turn",
}
_OTHERS = {
    17: "stay",
    18: "circles",
    19: "stay for",
    82: "spline waypoint",
    93: "wait",
    112: "wait",
    177: "jump",
}
_COMMANDS = {action: command for command, action in _ACTIONS.items()}
_GLOBAL = {0: 0, 5: 0, 3: 1, 6: 1, 10: 1, 11: 1}  # MAV_FRAME: 0 height over the sea, 1 over home
_NOT_GIVEN = 2**31 - 1
_NUMBER = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")


def items_of(rows: Sequence[MissionRow], where: str = "mission") -> list[Item]:
    """Return the items of the rows of a table.

    Raises
    ------
    InputError
        If a row cannot be sent.
    """
    items = []
    for k, row in enumerate(rows):
        command = _COMMANDS.get(row.action)
        if command is None:
            raise InputError(
                where, f"row {k + 1}", f"{row.action!r} cannot be sent", f"use {', '.join(_COMMANDS)}"
            )
        if command in (WAYPOINT, TAKE_OFF) and not all(map(math.isfinite, row.position)):
            raise InputError(where, f"row {k + 1}", "has no place", "give N, E and D in metres")
        heading_deg = math.degrees(row.heading_rad)
        if command == SPEED:
            number = _NUMBER.search("-2" if row.text == OWN_SPEED else row.text)
            if number is None:
                raise InputError(where, f"row {k + 1}", "has no speed", 'write for example "0.4 m/s"')
            items.append(_speed(float(number[0])))
        elif command == HEADING:
            items.append(replace(_item(HEADING, (0.0, 0.0, 0.0)), params=(heading_deg, 0.0, 0.0, 0.0)))
        else:
            place = row.position if all(map(math.isfinite, row.position)) else (0.0, 0.0, 0.0)
            items.append(_item(command, place, row.wait_s, heading_deg))
    return _numbered(items)


def rows_of(items: Sequence[Item], origin: Origin | None = None, reached: int = 0) -> list[MissionRow]:
    """Return the rows of a table of items.

    Parameters
    ----------
    items : sequence of Item
    origin : Origin, optional
        Where N, E, D are 0, for items in a global frame.
    reached : int
        So many of the first rows are behind the vehicle.
    """
    return [_row(item, origin, k < reached) for k, item in enumerate(items)]


def _row(item: Item, origin: Origin | None, reached: bool) -> MissionRow:
    command = item.command
    action = _ACTIONS.get(command) or _OTHERS.get(command, f"command {command}")
    position, text = (math.nan,) * 3, ""
    if command == SPEED:
        speed = item.params[1]
        return MissionRow(action, reached=reached, text=OWN_SPEED if speed == -2.0 else f"{speed:g} m/s")
    if command == HEADING:
        return MissionRow(action, heading_rad=math.radians(item.params[0]), reached=reached)
    if item.frame == LOCAL_NED and command in (*_ACTIONS, *_OTHERS) and command != RETURN:
        position = (item.x / 1e4, item.y / 1e4, item.z)
    elif item.frame in _GLOBAL and item.x != _NOT_GIVEN:
        position, text = _from_global(item, origin)
    elif command not in _ACTIONS:
        text = " ".join(f"{p:g}" for p in (*item.params, item.x, item.y, item.z))
    has_hold = command in (WAYPOINT, 19, 82, 93, 112)
    wait_s = item.params[0] if has_hold and math.isfinite(item.params[0]) else 0.0
    heading = math.radians(item.params[3]) if command in (WAYPOINT, TAKE_OFF, LAND) else math.nan
    return MissionRow(action, position, heading, wait_s, reached, text)


def _from_global(item: Item, origin: Origin | None) -> tuple[tuple[float, float, float], str]:
    latitude, longitude = item.x / 1e7, item.y / 1e7
    if (item.x, item.y) == (0, 0):
        return (math.nan,) * 3, ""
    if origin is None:
        return (math.nan,) * 3, f"{latitude:.6f} {longitude:.6f} deg, {item.z:g} m"
    north, east, down = origin.to_local(latitude, longitude, item.z)
    return (north, east, -item.z if _GLOBAL[item.frame] else down), ""


def _item(
    command: int, position: tuple[float, float, float], wait_s: float = 0.0, heading_deg: float = math.nan
) -> Item:
    x, y = (round(v * 1e4) for v in position[:2])
    return Item(0, LOCAL_NED, command, params=(wait_s, 0.0, 0.0, heading_deg), x=x, y=y, z=position[2])


def _speed(speed_m_s: float) -> Item:
    return Item(
        0, LOCAL_NED, SPEED, params=(1.0, speed_m_s, -1.0, 0.0)
    )  # 1: over ground, -1: throttle as it is


def _numbered(items: Sequence[Item]) -> list[Item]:
    return [replace(item, seq=k) for k, item in enumerate(items)]
