"""How long will the mission in a vehicle take? The reckoning of :func:`mufly.mission.compute_timing`, from items.

A vehicle of mufly has told its limits as parameters; what its items do not carry (splines, scanning, obstacles) is that
of the mission file that the station knows. Of another autopilot's vehicle the speeds are those of the parameters that
PX4 and ArduPilot have for them; where none is told, the default of a mission file, which is said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

from mufly.flight import TunableParameter
from mufly.mission import Mission, MissionTiming, Waypoint, compute_timing
from mufly.mission import TrajectoryLimits as TrajectoryLimits
from mufly.mission.mission_items import (
    GlobalOrigin,
    MissionCommand,
    MissionItem,
    MissionRefusedError,
    is_global,
    mission_from_items,
)
from mufly.mission.mission_schema import Limits, TakeOff
from mufly.station.mission_rows import DELAY_COMMANDS, rows_from_items
from mufly.station.signal_history import VehicleSnapshot
from mufly.units import GRAVITY

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
"""Parameters that tell a limit, by key of ``[limits]``: the first that the vehicle has, and the factor to the key's
unit. mufly's, PX4's, ArduPilot's (the older in cm/s, the newer in m/s)."""

MAX_FLOWN_ITEMS = 2000
"""Items of a mission with jumps that are followed at most."""


@dataclass(frozen=True, slots=True)
class MissionDuration:
    """What a mission in a vehicle takes.

    Attributes
    ----------
    duration_s : float
        From the start signal, or from now where it is being flown, until it has landed (s).
    assumptions : str
        What was assumed because the vehicle does not tell it, in words; "" if nothing.
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
    """Return what the mission that a vehicle holds takes; None if there is no waypoint in it.

    Parameters
    ----------
    items : sequence of Item
        As the vehicle holds them; of ArduPilot without its home.
    s : Snapshot
        Where the vehicle stands, and which item it flies to.
    parameters : mapping
        Of the vehicle, as far as they are read.
    origin : Origin, optional
        Of items on the globe; without it the first of their places.
    base : Mission, optional
        The mission file of the vehicle, where the station knows it.
    """
    told, avoidance = limits_from_parameters(parameters), _avoidance_from_parameters(parameters)
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
        needed -= timing.legs[k - 1].departure_s if k else timing.take_off_done_s
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
    """Timing of items, which item each waypoint came from, and what was assumed; None without a waypoint."""
    limited = _apply_limits(base, told, avoidance)
    limits = limited.limits
    mission, came_from, left_out = _mission_from_items(items, limited, origin)
    if not mission.waypoint:
        return None
    if start:
        mission = _replace_parts(mission, start_m=start[:2], start_heading_deg=start[2])
    words = [] if told else [f"{limits.speed_m_s:g} m/s assumed"]
    return compute_timing(mission), came_from, ", ".join([*words, *left_out])


def mission_with_limits(parameters: Mapping[str, TunableParameter], base: Mission | None = None) -> Mission:
    """A mission without waypoints that has a vehicle's limits, as far as its parameters or a mission file tell them."""
    told = tuple(limits_from_parameters(parameters).items())
    return _apply_limits(base or Mission(), told, _avoidance_from_parameters(parameters))


def _apply_limits(
    base: Mission, told: tuple[tuple[str, float], ...], avoidance: tuple[tuple[str, float], ...]
) -> Mission:
    limits = Limits.model_construct(**{**base.limits.model_dump(), **dict(told)})
    eyes = {key: bool(value) if key == "enabled" else value for key, value in avoidance}
    return _replace_parts(base, limits=limits, avoidance=base.avoidance.model_copy(update=eyes))


def limits_from_parameters(parameters: Mapping[str, TunableParameter]) -> dict[str, float]:
    """Return the limits that a vehicle's parameters tell, under the keys and in the units of a mission file."""
    found = {}
    for key, sources in LIMIT_PARAMETERS.items():
        values = ((parameters[name].value * factor) for name, factor in sources if name in parameters)
        value = next((v for v in values if math.isfinite(v) and v > 0.0), None)
        if value is not None:
            found[key] = value
    return found


def _replace_parts(mission: Mission, **parts: object) -> Mission:
    """The same with other parts; not validated: what others fly may be beyond the bounds of a mission file."""
    held = {name: getattr(mission, name) for name in Mission.model_fields}
    return Mission.model_construct(**{**held, **parts})


_CONTROLLER_LIMIT_PARAMETERS = {
    "speed": "CTL_SPEED_MAX",
    "climb": "CTL_HEAVE_SPD",
    "descent": "CTL_HEAVE_SPD",
    "acceleration": "CTL_TILT_MAX",
    "climb_acceleration": "CTL_HEAVE_ACC",
    "yaw_rate": "CTL_YAW_RATE",
    "yaw_acceleration": "CTL_YAW_ACC",
}


def trajectory_limits_from_parameters(parameters: Mapping[str, TunableParameter]) -> TrajectoryLimits | None:
    """What the controllers of a vehicle of mufly can follow (:func:`mufly.flight.controller_limits`); None if it does
    not tell."""
    if not set(_CONTROLLER_LIMIT_PARAMETERS.values()) <= parameters.keys():
        return None
    told = {key: parameters[name].value for key, name in _CONTROLLER_LIMIT_PARAMETERS.items()}
    if not all(math.isfinite(v) and v > 0.0 for v in told.values()):
        return None
    told["acceleration"] = math.radians(told["acceleration"]) * GRAVITY
    told |= {key: math.radians(told[key]) for key in ("yaw_rate", "yaw_acceleration")}
    return TrajectoryLimits(**told)


_AVOIDANCE_KEYS = {"AVD_ENABLE": "enabled", "AVD_CLEARANCE": "clearance_m", "AVD_SPEED": "speed_m_s"}


def _avoidance_from_parameters(parameters: Mapping[str, TunableParameter]) -> tuple[tuple[str, float], ...]:
    """Keys of ``[avoidance]`` that a vehicle's parameters tell."""
    held = {key: parameters[name].value for name, key in _AVOIDANCE_KEYS.items() if name in parameters}
    return tuple((key, value) for key, value in held.items() if math.isfinite(value))


def _mission_from_items(
    items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None
) -> tuple[Mission, tuple[int, ...], list[str]]:
    """The mission of items, which item each waypoint came from, and what is left out, in words."""
    try:
        plan = mission_from_items(items, base, origin)
        return _replace_parts(base, waypoint=plan.mission.waypoint, take_off=plan.mission.take_off,
                        at_end=plan.mission.at_end), plan.waypoint_item_index, []  # fmt: skip
    except (MissionRefusedError, ValueError):
        return _approximate_mission(items, base, origin or _first_global_place(items))


def _follow_jumps(items: Sequence[MissionItem]) -> tuple[list[MissionItem], bool]:
    """Items as they are flown, DO_JUMP (parameter 1: to which item, 2: how often) followed; whether one is endless."""
    flown: list[MissionItem] = []
    left = {
        item.seq: int(item.params[1])
        for item in items
        if item.command == MissionCommand.DO_JUMP and item.params[1] > 0.0
    }
    endless = any(item.command == MissionCommand.DO_JUMP and item.params[1] < 0.0 for item in items)
    k = 0
    while k < len(items) and len(flown) < MAX_FLOWN_ITEMS:
        item, k = items[k], k + 1
        if item.command != MissionCommand.DO_JUMP:
            flown.append(item)
        elif left.get(item.seq, 0) > 0 and 0 <= item.params[0] < len(items):
            left[item.seq] -= 1
            k = int(item.params[0])
    return flown, endless


def _first_global_place(items: Sequence[MissionItem]) -> GlobalOrigin | None:
    """The first place on the globe among items, for want of an origin."""
    first = next(filter(is_global, items), None)
    if first is None or abs(first.x) > 90e7:
        return None
    return GlobalOrigin(first.x / 1e7, first.y / 1e7, 0.0)


def _approximate_mission(
    items: Sequence[MissionItem], base: Mission, origin: GlobalOrigin | None
) -> tuple[Mission, tuple[int, ...], list[str]]:
    """The same of items that no mission file can say: places, waits and speeds, flown straight."""
    waypoints: list[Waypoint] = []
    came_from: list[int] = []
    left_out: list[str] = []
    take_off, speed, end = base.take_off, None, "hover"
    flown, endless = _follow_jumps(items)
    left_out += ["without its endless jump"] if endless else []
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
    mission = _replace_parts(base, waypoint=tuple(waypoints), take_off=take_off, at_end=end)
    return mission, tuple(came_from), left_out
