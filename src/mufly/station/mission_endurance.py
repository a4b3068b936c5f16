"""Duration of the mission in a vehicle: :func:`mufly.mission.compute_mission_timing` applied to mission items.

A mufly vehicle publishes its limits as parameters. Splines, scanning and obstacles, which items do not hold, are taken
from the mission file known to the station. For other autopilots the speeds are PX4's and ArduPilot's parameters. A
missing limit takes the default of a mission file, and the result lists that assumption.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from mufly.flight import TunableParameter
from mufly.mission import Mission, MissionTiming, Waypoint, compute_mission_timing
from mufly.mission import TrajectoryLimits as TrajectoryLimits
from mufly.mission.files.mission_items import (
    GlobalOrigin,
    MissionCommand,
    MissionItem,
    MissionRefusedError,
    has_global_position,
    mission_from_items,
)
from mufly.mission.files.mission_schema import Limits, TakeOff
from mufly.quantities.units import GRAVITY
from mufly.station.mission_rows import DELAY_COMMANDS, rows_from_items
from mufly.station.signal_history import VehicleSnapshot

_LimitSources = tuple[tuple[str, float], ...]
LIMIT_PARAMETERS: dict[str, _LimitSources] = {
    "speed_m_s": (("LIM_SPEED", 1.0), ("MPC_XY_CRUISE", 1.0), ("WPNAV_SPEED", 0.01), ("WP_SPD", 1.0)),
    "climb_m_s": (("LIM_CLIMB", 1.0), ("MPC_Z_V_AUTO_UP", 1.0), ("WPNAV_SPEED_UP", 0.01), ("WP_SPD_UP", 1.0)),
    "descent_m_s": (
        ("LIM_DESCENT", 1.0),
        ("MPC_Z_V_AUTO_DN", 1.0),
        ("WPNAV_SPEED_DN", 0.01),
        ("WP_SPD_DN", 1.0),
    ),
    "touchdown_m_s": (("LIM_TOUCHDOWN", 1.0), ("MPC_LAND_SPEED", 1.0), ("LAND_SPEED", 0.01)),
    "acceleration_m_s2": (("LIM_ACCEL", 1.0), ("MPC_ACC_HOR", 1.0), ("WPNAV_ACCEL", 0.01), ("WP_ACC", 1.0)),
    "climb_acceleration_m_s2": (("LIM_CLIMB_ACC", 1.0), ("MPC_ACC_UP_MAX", 1.0), ("WPNAV_ACCEL_Z", 0.01)),
    "yaw_rate_deg_s": (("LIM_YAWRATE", 1.0), ("MPC_YAWRAUTO_MAX", 1.0), ("ATC_SLEW_YAW", 0.01)),
    "yaw_acceleration_deg_s2": (("LIM_YAWACC", 1.0),),
}
"""Parameters of the limits, by key of ``[limits]``: candidate names in order (mufly, PX4, ArduPilot old in cm/s and new
in m/s), each with the factor to the key's unit. The first that the vehicle has is used."""

MAX_FOLLOWED_ITEMS = 2000
"""Largest number of items followed in a mission with jumps."""


@dataclass(frozen=True, slots=True)
class MissionDuration:
    """Predicted duration of a mission in a vehicle.

    Attributes
    ----------
    duration_s : float
        Time until landed (s), from the start signal, or from the present if the mission is being flown.
    assumptions : str
        Values assumed because the vehicle does not publish them, in words; "" if none.
    """

    duration_s: float
    assumptions: str = ""


def estimate_mission_duration(
    items: Sequence[MissionItem],
    s: VehicleSnapshot,
    parameters: Mapping[str, TunableParameter],
    *,
    origin: GlobalOrigin | None = None,
    base: Mission | None = None,
) -> MissionDuration | None:
    """Return the predicted duration of a vehicle's mission; None if it has no waypoint.

    Parameters
    ----------
    items : sequence of MissionItem
        Items in the vehicle; ArduPilot's without the home item.
    s : VehicleSnapshot
        Vehicle's position and current item.
    parameters : mapping
        Vehicle's parameters read so far.
    origin : GlobalOrigin, optional
        Origin for items in global frames; default: the first global position among them.
    base : Mission, optional
        Mission file of the vehicle, if the station knows it.
    """
    told, avoidance = read_mission_limits(parameters), _avoidance_from_parameters(parameters)
    place, heading = s.estimate.position.tolist(), float(s.estimate.attitude[2])
    start: tuple[float, ...] = ()
    if not s.flying and all(map(math.isfinite, (*place, heading))):
        degrees = math.degrees(math.remainder(heading, math.tau))
        start = (round(place[0], 2), round(place[1], 2), round(degrees))
    known = _compute_timing(tuple(items), tuple(told.items()), avoidance, origin, base or Mission(), start)
    if known is None:
        return None
    timing, came_from, words = known
    needed = timing.landed_s
    if s.flying and s.mission_running and s.mission_row is not None:
        k = next((k for k, item in enumerate(came_from) if item >= s.mission_row), len(came_from))
        needed -= timing.legs[k - 1].wait_end_s if k else timing.take_off_done_s
    return MissionDuration(needed, words)


@lru_cache(maxsize=32)
def _compute_timing(
    items: tuple[MissionItem, ...],
    told: tuple[tuple[str, float], ...],
    avoidance: tuple[tuple[str, float], ...],
    origin: GlobalOrigin | None,
    base: Mission,
    start: tuple[float, ...],
) -> tuple[MissionTiming, tuple[int, ...], str] | None:
    """Compute the timing of mission items; None without a waypoint.

    Return also the item index of each waypoint, and the assumptions as text.
    """
    limited = _apply_limits(base, told, avoidance)
    limits = limited.limits
    mission, came_from, left_out = _mission_from_items(items, limited, origin)
    if not mission.waypoint:
        return None
    if start:
        mission = _replace_parts_unchecked(mission, start_m=start[:2], start_heading_deg=start[2])
    words = [] if told else [f"{limits.speed_m_s:g} m/s assumed"]
    return compute_mission_timing(mission), came_from, ", ".join([*words, *left_out])


def make_mission_with_limits(parameters: Mapping[str, TunableParameter], base: Mission | None = None) -> Mission:
    """Return a mission without waypoints, with the limits known from a vehicle's parameters or a mission file."""
    told = tuple(read_mission_limits(parameters).items())
    return _apply_limits(base or Mission(), told, _avoidance_from_parameters(parameters))


def _apply_limits(
    base: Mission, told: tuple[tuple[str, float], ...], avoidance: tuple[tuple[str, float], ...]
) -> Mission:
    limits = Limits.model_construct(**{**base.limits.model_dump(), **dict(told)})
    eyes = {key: bool(value) if key == "enabled" else value for key, value in avoidance}
    return _replace_parts_unchecked(base, limits=limits, avoidance=base.avoidance.model_copy(update=eyes))


def read_mission_limits(parameters: Mapping[str, TunableParameter]) -> dict[str, float]:
    """Return the limits among a vehicle's parameters, under the keys and in the units of a mission file."""
    found = {}
    for key, sources in LIMIT_PARAMETERS.items():
        values = ((parameters[name].value * factor) for name, factor in sources if name in parameters)
        value = next((v for v in values if math.isfinite(v) and v > 0.0), None)
        if value is not None:
            found[key] = value
    return found


def _replace_parts_unchecked(mission: Mission, **parts: object) -> Mission:
    """Return a copy of the mission with the fields ``parts`` replaced, without validation.

    Vehicles of other makers may exceed the bounds of a mission file.
    """
    held = {name: getattr(mission, name) for name in Mission.model_fields}
    return Mission.model_construct(**{**held, **parts})


_PARAMETER_BY_CONTROLLER_LIMIT = {
    "speed": "CTL_SPEED_MAX",
    "climb": "CTL_HEAVE_SPD",
    "descent": "CTL_HEAVE_SPD",
    "acceleration": "CTL_TILT_MAX",
    "climb_acceleration": "CTL_HEAVE_ACC",
    "yaw_rate": "CTL_YAW_RATE",
    "yaw_acceleration": "CTL_YAW_ACC",
}


def trajectory_limits_from_parameters(parameters: Mapping[str, TunableParameter]) -> TrajectoryLimits | None:
    """Return the limits that a mufly vehicle's controllers can follow (:func:`mufly.flight.derive_trajectory_limits`);
    None if its parameters lack them."""
    if not set(_PARAMETER_BY_CONTROLLER_LIMIT.values()) <= parameters.keys():
        return None
    told = {key: parameters[name].value for key, name in _PARAMETER_BY_CONTROLLER_LIMIT.items()}
    if not all(math.isfinite(v) and v > 0.0 for v in told.values()):
        return None
    told["acceleration"] = math.radians(told["acceleration"]) * GRAVITY
    told |= {key: math.radians(told[key]) for key in ("yaw_rate", "yaw_acceleration")}
    return TrajectoryLimits(**told)


_AVOIDANCE_KEY_BY_PARAMETER = {"AVD_ENABLE": "enabled", "AVD_CLEARANCE": "clearance_m", "AVD_SPEED": "speed_m_s"}


def _avoidance_from_parameters(parameters: Mapping[str, TunableParameter]) -> tuple[tuple[str, float], ...]:
    """Return the settings of a mission file's table ``[avoidance]`` among a vehicle's parameters: (key, value)."""
    held = {key: parameters[name].value for name, key in _AVOIDANCE_KEY_BY_PARAMETER.items() if name in parameters}
    return tuple((key, value) for key, value in held.items() if math.isfinite(value))


def _mission_from_items(
    items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None
) -> tuple[Mission, tuple[int, ...], list[str]]:
    """Make a mission of items; return also each waypoint's item index, and descriptions of the parts not flown."""
    try:
        plan = mission_from_items(items, base, origin)
        return _replace_parts_unchecked(base, waypoint=plan.mission.waypoint, take_off=plan.mission.take_off,
                        at_end=plan.mission.at_end), plan.waypoint_item_index, []  # fmt: skip
    except (MissionRefusedError, ValueError):
        return _approximate_mission(items, base, origin or _first_global_position(items))


def _follow_jumps(items: Sequence[MissionItem]) -> tuple[list[MissionItem], bool]:
    """Return the items in flight order with DO_JUMP executed, and whether a jump is endless."""
    flown: list[MissionItem] = []
    left = {
        item.seq: int(item.params[1])
        for item in items
        if item.command == MissionCommand.DO_JUMP and item.params[1] > 0.0
    }
    endless = any(item.command == MissionCommand.DO_JUMP and item.params[1] < 0.0 for item in items)
    k = 0
    while k < len(items) and len(flown) < MAX_FOLLOWED_ITEMS:
        item, k = items[k], k + 1
        if item.command != MissionCommand.DO_JUMP:
            flown.append(item)
        elif left.get(item.seq, 0) > 0 and 0 <= item.params[0] < len(items):
            left[item.seq] -= 1
            k = int(item.params[0])
    return flown, endless


def _first_global_position(items: Sequence[MissionItem]) -> GlobalOrigin | None:
    """Return the first global position among items, to replace a missing origin."""
    first = next(filter(has_global_position, items), None)
    if first is None or abs(first.x) > 90e7:
        return None
    return GlobalOrigin(first.x / 1e7, first.y / 1e7, 0.0)


def _approximate_mission(
    items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None
) -> tuple[Mission, tuple[int, ...], list[str]]:
    """Approximate items that a mission file cannot express, by places, waits, speeds and straight legs."""
    waypoints: list[Waypoint] = []
    came_from: list[int] = []
    left_out: list[str] = []
    take_off, speed, end = base.take_off, None, "hover"
    flown, endless = _follow_jumps(items)
    left_out += ["endless jump omitted"] if endless else []
    for item, row in zip(flown, rows_from_items(flown, origin), strict=True):
        n, e, d = row.position
        placed = all(map(math.isfinite, row.position))
        if item.command == MissionCommand.DO_CHANGE_SPEED:
            speed = {-1.0: speed, -2.0: None}.get(item.params[1], item.params[1])
        elif item.command == MissionCommand.NAV_TAKEOFF:
            take_off = TakeOff.model_construct(height_m=-d if placed and d < 0.0 else take_off.height_m, wait_s=0.0)
        elif item.command in DELAY_COMMANDS and waypoints:
            waypoints[-1] = waypoints[-1].model_copy(update={"wait_s": waypoints[-1].wait_s + row.wait_s})
        elif item.command == MissionCommand.NAV_RETURN_TO_LAUNCH:
            end = "return"
        elif placed and item.command not in DELAY_COMMANDS:
            wait = row.wait_s
            if item.command == MissionCommand.NAV_LOITER_TURNS:
                pace = speed or base.limits.speed_m_s
                wait += abs(item.params[0]) * math.tau * abs(item.params[2]) / pace if pace > 0.0 else 0.0
            height = waypoints[-1].position_m[2] if item.command == MissionCommand.NAV_LAND and waypoints else d
            end = "land" if item.command == MissionCommand.NAV_LAND else end
            waypoints.append(
                Waypoint.model_construct(
                    position_m=(n, e, min(height, -1e-3)), wait_s=wait, heading_deg=None, speed_m_s=speed
                )
            )
            came_from.append(item.seq)
    mission = _replace_parts_unchecked(base, waypoint=tuple(waypoints), take_off=take_off, at_end=end)
    return mission, tuple(came_from), left_out
