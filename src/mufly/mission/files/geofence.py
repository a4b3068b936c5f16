"""Geofence of a vehicle: distances to its bounds, and its MAVLink items.

A place is inside if it lies in the polygon and in the circle, below the ceiling and in no keep-out zone; absent bounds
do not limit. Distances are horizontal for zones and vertical for the ceiling. The even-odd rule defines the interior
of a polygon.

Items: NAV_FENCE_POLYGON_VERTEX_INCLUSION (5001) and _EXCLUSION (5002), a vertex each with the number of vertices in
parameter 1; NAV_FENCE_CIRCLE_INCLUSION (5003) and _EXCLUSION (5004), radius in parameter 1. Coordinates are in
LOCAL_NED (1; x, y in 1e-4 m) or, with an origin, on the globe. Ceiling and action have no items: a vehicle keeps its
own. https://mavlink.io/en/services/mission.html#geofence_fence.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationError

from mufly.errors import InputError
from mufly.mission.files.mission_items import (
    GlobalOrigin,
    MissionCommand,
    MissionItem,
    MissionRefusedError,
    MissionResultCode,
    make_fence_item,
    read_item_horizontal_position,
)
from mufly.mission.files.mission_schema import Fence, Mission
from mufly.mission.files.mission_timing import plan_legs, plan_return_leg

INCLUSION_VERTEX = MissionCommand.NAV_FENCE_POLYGON_VERTEX_INCLUSION
EXCLUSION_VERTEX = MissionCommand.NAV_FENCE_POLYGON_VERTEX_EXCLUSION
INCLUSION_CIRCLE = MissionCommand.NAV_FENCE_CIRCLE_INCLUSION
EXCLUSION_CIRCLE = MissionCommand.NAV_FENCE_CIRCLE_EXCLUSION
FENCE_MARGIN_M = 0.2
"""Margin inside the fence for missions and targets (m): the deviation of a flight in gusts."""
_CIRCLE_POINT_COUNT = 48

_Array = NDArray[np.float64]


def fence_margins(fence: Fence, places: ArrayLike) -> tuple[_Array, list[str]]:
    """Return the distance of places inside each bound of a fence (m, negative outside), and the names of the bounds.

    Parameters
    ----------
    fence : Fence
    places : (n, 3) array
        N, E, D (m).

    Returns
    -------
    margins : (bounds, n) array
        Distance inside each bound (m), negative outside.
    names : list of str
        Names of the bounds.
    """
    at = np.asarray(places, dtype=np.float64).reshape(-1, 3)
    rows: list[_Array] = []
    names: list[str] = []
    if fence.polygon_m:
        rows.append(_distance_inside_polygon(fence.polygon_m, at))
        names.append("the fence")
    if fence.centre_m is not None and fence.radius_m is not None:
        rows.append(fence.radius_m - np.hypot(*(at[:, :2] - np.array(fence.centre_m)).T))
        names.append("the fence's circle")
    if fence.ceiling_m is not None:
        rows.append(fence.ceiling_m + at[:, 2])
        names.append("the fence's ceiling")
    for zone in fence.keep_out_m:
        rows.append(-_distance_inside_polygon(zone, at))
        names.append("a keep-out zone")
    for n, e, radius in fence.keep_out_circles_m:
        rows.append(np.hypot(at[:, 0] - n, at[:, 1] - e) - radius)
        names.append("a keep-out circle")
    return np.array(rows).reshape(len(rows), len(at)), names


def describe_fence_violation(fence: Fence | None, places: ArrayLike, keep_m: float = 0.0) -> str:
    """Return the reason why places are not all inside a fence; "" if they are, or without a fence.

    Parameters
    ----------
    fence : Fence or None
    places : (n, 3) array
        N, E, D (m).
    keep_m : float
        Required distance inside the fence (m).

    Examples
    --------
    >>> from mufly.mission import Fence, describe_fence_violation
    >>> describe_fence_violation(Fence(centre_m=(0.0, 0.0), radius_m=10.0), (0.0, 500.0, -1.0))
    "490 m outside the fence's circle"
    """
    if fence is None:
        return ""
    margins, names = fence_margins(fence, places)
    if not margins.size:
        return ""
    worst = np.where(np.isfinite(margins), margins, -math.inf).min(axis=1)
    k = int(np.argmin(worst))
    if worst[k] >= keep_m:
        return ""
    if worst[k] >= 0.0:
        return f"{abs(worst[k]):.2f} m from {names[k]}, less than the required {keep_m:g} m"
    far = f"{-worst[k]:.0f} m" if worst[k] < -10.0 else f"{max(-worst[k], 0.01):.2f} m"
    side = "inside" if names[k].startswith("a keep") else "above" if names[k].endswith("ceiling") else "outside"
    return f"{far} {side} {names[k]}"


def distance_inside_fence(fence: Fence, place: ArrayLike) -> float:
    """Return the distance of a place (3,) inside a fence (m); negative outside."""
    margins, _ = fence_margins(fence, place)
    return float(np.where(np.isfinite(margins), margins, -math.inf).min()) if margins.size else math.inf


def describe_path_fence_violation(fence: Fence | None, here: ArrayLike, place: ArrayLike) -> str:
    """Return why a path, first vertical to the goal's height, then level, leaves a fence; "" if it does not.

    From outside the fence any path is permitted.
    """
    a, b = (np.asarray(v, dtype=np.float64) for v in (here, place))
    if fence is None or describe_fence_violation(fence, a):
        return ""
    corner = np.array([a[0], a[1], b[2]])
    count = max(2, math.ceil(float(np.linalg.norm(b - corner)) / 0.1) + 1)
    level = corner + np.linspace(0.0, 1.0, count)[:, None] * (b - corner)
    fault = describe_fence_violation(fence, level)
    return f"the path leads {fault}" if fault else ""


def check_mission_inside_fence(mission: Mission, where: str) -> None:
    """Check that a mission stays inside its own fence.

    Raises
    ------
    InputError
        If the mission leaves its fence; the message names the key, the distance and the remedy.
    """
    fence = mission.fence
    if fence is None:
        return
    n, e = mission.start_m
    up = [(n, e, -h) for h in np.linspace(0.0, mission.take_off.height_m, 20)]
    for key, places in (("start_m", up[:1]), ("take_off.height_m", up)):
        _require_inside_fence(fence, places, where, key)
    for leg in plan_legs(mission):
        times = np.linspace(0.0, leg.trajectory.duration_s, max(50, math.ceil(leg.length_m / 0.1)))
        track = [leg.trajectory.evaluate(float(t)).position for t in times]
        _require_inside_fence(fence, track, where, f"waypoint[{leg.waypoint_number}].position_m")
    back = plan_return_leg(mission)
    if back is not None:
        times = np.linspace(0.0, back.duration_s, max(50, math.ceil(back.path_profile.distance / 0.1)))
        _require_inside_fence(fence, [back.evaluate(float(t)).position for t in times], where, "at_end")


def _require_inside_fence(fence: Fence, places: Sequence[Sequence[float]], where: str, key: str) -> None:
    fault = describe_fence_violation(fence, places, FENCE_MARGIN_M)
    if fault:
        raise InputError(where, key, f"leads {fault}", "move it inside, or enlarge [fence]")


def fence_outlines(fence: Fence) -> list[tuple[bool, list[tuple[float, float]]]]:
    """Return the outlines of a fence's zones: whether to stay inside, and corners N, E (m)."""
    out = [(True, list(fence.polygon_m))] if fence.polygon_m else []
    if fence.centre_m is not None and fence.radius_m is not None:
        out.append((True, _circle_outline(*fence.centre_m, fence.radius_m)))
    out += [(False, list(zone)) for zone in fence.keep_out_m]
    return out + [(False, _circle_outline(*circle)) for circle in fence.keep_out_circles_m]


def _circle_outline(n: float, e: float, radius: float) -> list[tuple[float, float]]:
    turns = (math.tau * k / _CIRCLE_POINT_COUNT for k in range(_CIRCLE_POINT_COUNT))
    return [(n + radius * math.cos(t), e + radius * math.sin(t)) for t in turns]


def _distance_inside_polygon(corners: Sequence[tuple[float, float]], at: _Array) -> _Array:
    """Return the depth of places (n, 3) in a polygon (m); negative outside."""
    a = np.array(corners, dtype=np.float64)
    b = np.roll(a, -1, axis=0)
    p = at[:, None, :2]
    side = b - a
    share = np.clip(((p - a) * side).sum(-1) / np.maximum((side * side).sum(-1), 1e-12), 0.0, 1.0)
    away = np.linalg.norm(p - (a + share[..., None] * side), axis=-1).min(axis=1)
    crosses = (a[:, 1] > p[..., 1]) != (b[:, 1] > p[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        north = a[:, 0] + (p[..., 1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * side[:, 0]
    inside = (crosses & (p[..., 0] < north)).sum(axis=1) % 2 == 1
    depth: _Array = np.where(inside, away, -away)
    return depth


# ---- MAVLink items


def fence_to_items(fence: Fence | None, origin: GlobalOrigin | None = None) -> tuple[MissionItem, ...]:
    """Return a fence as mission items: in degrees if an origin is given, as ground stations need, else in LOCAL_NED."""
    if fence is None:
        return ()
    made: list[tuple[int, float, float, float]] = []
    for command, zones in ((INCLUSION_VERTEX, [fence.polygon_m]), (EXCLUSION_VERTEX, list(fence.keep_out_m))):
        made += [(command, float(len(zone)), n, e) for zone in zones for n, e in zone]
    if fence.centre_m is not None and fence.radius_m is not None:
        made.append((INCLUSION_CIRCLE, fence.radius_m, *fence.centre_m))
    made += [(EXCLUSION_CIRCLE, radius, n, e) for n, e, radius in fence.keep_out_circles_m]
    return tuple(make_fence_item(k, *one, origin) for k, one in enumerate(made))


def fence_from_items(items: Sequence[MissionItem], base: Fence | None, origin: GlobalOrigin | None) -> Fence | None:
    """Return the fence that items describe, with the ceiling of ``base``; None without items and ceiling.

    Parameters
    ----------
    items : sequence of MissionItem
        Items, numbered from 0.
    base : Fence or None
        Source of ceiling and action.
    origin : GlobalOrigin or None
        Origin for items on the globe.

    Raises
    ------
    MissionRefusedError
        If the fence cannot be kept exactly as described.
    """
    zones: dict[int, list[list[tuple[float, float]]]] = {INCLUSION_VERTEX: [], EXCLUSION_VERTEX: []}
    circles: dict[int, list[tuple[float, float, float]]] = {INCLUSION_CIRCLE: [], EXCLUSION_CIRCLE: []}
    left = 0
    for item in items:
        if left and item.command != items[item.seq - 1].command:
            raise _make_refusal(
                item, MissionResultCode.INVALID_SEQUENCE, f"{left} vertices of the polygon before it are missing"
            )
        if item.command in zones:
            if not left:
                left = _vertex_count(item)
                zones[item.command].append([])
            elif item.params[0] != items[item.seq - 1].params[0]:
                raise _make_refusal(
                    item, MissionResultCode.INVALID_PARAM1, "vertices of one polygon state different counts"
                )
            zones[item.command][-1].append(_require_horizontal_position(item, origin))
            left -= 1
        elif item.command in circles:
            radius = item.params[0]
            if not 0.0 < radius <= 1e4:
                raise _make_refusal(
                    item, MissionResultCode.INVALID_PARAM1, f"a radius of {radius:g} m is outside of 0 to 1e4 m"
                )
            circles[item.command].append((*_require_horizontal_position(item, origin), float(f"{radius:.7g}")))
        elif item.command != MissionCommand.NAV_FENCE_RETURN_POINT:
            raise _make_refusal(item, MissionResultCode.UNSUPPORTED, f"command {item.command} is not a fence item")
    if left:
        raise _make_refusal(
            items[-1], MissionResultCode.INVALID_SEQUENCE, f"{left} vertices of its polygon are missing"
        )
    for command, many in (
        (INCLUSION_VERTEX, zones[INCLUSION_VERTEX]),
        (INCLUSION_CIRCLE, circles[INCLUSION_CIRCLE]),
    ):
        if len(many) > 1:
            last = next(i for i in reversed(items) if i.command == command)
            raise _make_refusal(
                last, MissionResultCode.UNSUPPORTED, "only one inclusion polygon and one inclusion circle are supported"
            )
    parts: dict[str, Any] = {} if base is None else {"ceiling_m": base.ceiling_m, "action": base.action}
    if not items and parts.get("ceiling_m") is None:
        return None
    if zones[INCLUSION_VERTEX]:
        parts["polygon_m"] = tuple(zones[INCLUSION_VERTEX][0])
    if circles[INCLUSION_CIRCLE]:
        n, e, radius = circles[INCLUSION_CIRCLE][0]
        parts |= {"centre_m": (n, e), "radius_m": radius}
    parts |= {
        "keep_out_m": tuple(map(tuple, zones[EXCLUSION_VERTEX])),
        "keep_out_circles_m": tuple(circles[EXCLUSION_CIRCLE]),
    }
    try:
        return Fence(**parts)
    except ValidationError as error:
        raise MissionRefusedError(MissionResultCode.INVALID, f"fence: {error.errors()[0]['msg'].lower()}") from error


def _make_refusal(item: MissionItem, result: MissionResultCode, why: str) -> MissionRefusedError:
    return MissionRefusedError(result, f"of the fence: {why}", item.seq)


def _vertex_count(item: MissionItem) -> int:
    count = item.params[0]
    if not (count == round(count, 0) and 3.0 <= count <= 1000.0 if math.isfinite(count) else False):
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM1, f"a polygon of {count:g} vertices; give 3 or more")
    return int(count)


def _require_horizontal_position(item: MissionItem, origin: GlobalOrigin | None) -> tuple[float, float]:
    n, e = read_item_horizontal_position(item, origin)
    if not (math.isfinite(n) and math.isfinite(e)):
        raise _make_refusal(item, MissionResultCode.INVALID_PARAM5_X, "use LOCAL_NED (1), or set the vehicle's origin")
    return round(n, 4), round(e, 4)
