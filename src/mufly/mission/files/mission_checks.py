"""Feasibility checks of a mission before take-off: paths against obstacles, flight time against the battery.

The helicopter hovers most of the time, so a mission's charge is the hover current times the time of its reference
trajectories and waits. Climbing at v_c adds the power m g v_c: 0.5 W of 30 W for muFly at 0.5 m/s. It is neglected, as
are the savings of forward flight and descent. The `usable` fraction of the charge must cover the total.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import hover_current_A
from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, format_toml_value, read_toml, validate_model
from mufly.mission.files.geofence import check_mission_inside_fence
from mufly.mission.files.ground_files import ground_text_to_mission_tables, is_ground_station_text
from mufly.mission.files.mission_schema import MIN_WAYPOINT_HEIGHT_M, Mission, limits_to_file_units
from mufly.mission.files.mission_timing import (
    compute_landing_time,
    compute_mission_timing,
    compute_take_off_time,
    plan_legs,
    plan_return_leg,
)
from mufly.mission.machine.mission_state import prepare_mission_plan
from mufly.mission.trajectory import Trajectory, TrajectoryLimits
from mufly.results import result
from mufly.vehicle import Vehicle
from mufly.world import World, compute_obstacle_distances, find_nearest_obstacle

WAYPOINT_MARGIN_M = 0.1
"""Margin of waypoints from obstacles beyond the clearance (m), so that a detour can still reach them."""

_VERTICAL_PATH_START_DOWN_M = -0.05


def check_mission_clearance(mission: Mission, where: str) -> None:
    """Check waypoints and paths against the floor and obstacles.

    Obstacles on a level leg are allowed if the beams can detect them. Climbs, descents, take-off and landing must be
    free, since the beams look sideways only; and a leg must not pass closely over or under an obstacle.

    Parameters
    ----------
    mission : Mission
        Mission to check.
    where : str
        File name for error messages.

    Raises
    ------
    InputError
        If a check fails; the message names the key, the obstacle and the remedy.
    """
    if not mission.waypoint:
        raise InputError(where, "waypoint", "the mission has no waypoint", "add at least one [[waypoint]]")
    clear = mission.avoidance.clearance_m
    world = mission.world
    has_obstacles = bool(world.boxes or world.cylinders)
    for i, waypoint in enumerate(mission.waypoint):
        key, (n, e, d) = f"waypoint[{i + 1}].position_m", waypoint.position_m
        if d > -MIN_WAYPOINT_HEIGHT_M:
            what = "under the floor" if d > 0.0 else "on the floor" if d == 0.0 else "too low to fly"
            raise InputError(
                where,
                key,
                f"[{n:g}, {e:g}, {d:g}] is {what}",
                f"D counts downward: give a D of at most {-MIN_WAYPOINT_HEIGHT_M:g}",
            )
        least, name = find_nearest_obstacle(world, waypoint.position_m)
        if least < clear + WAYPOINT_MARGIN_M:
            raise InputError(
                where,
                key,
                f"[{n:g}, {e:g}, {d:g}] is {_describe_distance(least, name)}",
                f"keep {clear + WAYPOINT_MARGIN_M:.2f} m from obstacles (avoidance.clearance_m + "
                f"{WAYPOINT_MARGIN_M:g})",
            )
    start = np.array([*mission.start_m, _VERTICAL_PATH_START_DOWN_M])
    _check_vertical_path(mission, where, "start_m", start, -mission.take_off.height_m, "the take-off")
    for leg in plan_legs(mission):
        key = f"waypoint[{leg.waypoint_number}].position_m"
        way = leg.trajectory
        track = _sample_leg_positions(way) if way.spline_curve is not None or has_obstacles else np.empty((0, 3))
        if way.spline_curve is None:
            begin = np.array(way.start)
            _check_vertical_path(mission, where, key, begin, way.goal[2], "the change of height before it")
        elif track[:, 2].max() > -MIN_WAYPOINT_HEIGHT_M:
            raise InputError(
                where,
                key,
                f"the spline to it descends to a height of {-track[:, 2].max():.2f} m",
                f'keep it above {MIN_WAYPOINT_HEIGHT_M:g} m, or use path.kind = "straight"',
            )
        _check_paths_over_and_under_obstacles(mission, where, key, track)
    last = f"waypoint[{len(mission.waypoint)}].position_m"
    end = np.array(mission.waypoint[-1].position_m)
    back = plan_return_leg(mission)
    if back is not None:
        last, end = "at_end", np.array(back.goal)
        if has_obstacles:
            _check_paths_over_and_under_obstacles(mission, where, last, _sample_leg_positions(back))
    _check_vertical_path(mission, where, last, end, _VERTICAL_PATH_START_DOWN_M, "the landing")
    check_mission_inside_fence(mission, where)


def _sample_leg_positions(way: Trajectory) -> NDArray[np.float64]:
    """Return 200 positions (200, 3) along a leg."""
    times = np.linspace(way.path_start_s, way.duration_s, 200)
    return np.array([way.evaluate(float(t)).position for t in times])


def _describe_distance(least: float, name: str) -> str:
    if least >= 0.0:
        return f"{least:.2f} m from the {name}"
    return f"beyond the {name}" if name.endswith(" wall") or name == "ceiling" else f"inside the {name}"


def _check_vertical_path(
    mission: Mission, where: str, key: str, position: NDArray[np.float64], to: float, what: str
) -> None:
    count = max(2, math.ceil(abs(to - position[2]) / 0.05) + 1)
    column = np.tile(position, (count, 1))
    column[:, 2] = np.linspace(position[2], to, count)
    least, which = compute_obstacle_distances(mission.world, column)
    k = int(np.argmin(least))
    if least[k] < mission.avoidance.clearance_m:
        n, e, d = column[k]
        raise InputError(
            where,
            key,
            f"{what} passes [{n:g}, {e:g}, {d:.2f}], "
            f"{_describe_distance(least[k], mission.world.obstacle_names[which[k]])}",
            f"keep {mission.avoidance.clearance_m:g} m from obstacles (avoidance.clearance_m)",
        )


def _check_paths_over_and_under_obstacles(mission: Mission, where: str, key: str, track: NDArray[np.float64]) -> None:
    """Refuse a track that passes an obstacle's top or foot closely: level beams pass over or under it."""
    world = mission.world
    spans = [(b.name, b.centre[2] - 0.5 * b.size[2], b.centre[2] + 0.5 * b.size[2]) for b in world.boxes]
    spans += [(c.name, -c.foot - c.height, -c.foot) for c in world.cylinders]
    clear = mission.avoidance.clearance_m
    for k, (name, top, foot) in enumerate(spans):
        one = (
            World(world.boxes[k : k + 1])
            if k < len(world.boxes)
            else World((), (world.cylinders[k - len(world.boxes)],))
        )
        near = compute_obstacle_distances(one, track)[0] < clear
        missed = near & ((track[:, 2] < top + _BEAM_HIT_MARGIN_M) | (track[:, 2] > foot - _BEAM_HIT_MARGIN_M))
        if missed.any():
            height = -track[missed][0, 2]
            raise InputError(
                where,
                key,
                f"the path to it, at a height of {height:.2f} m, passes the {name} (from "
                f"{round(-foot, 2) + 0.0:.2f} m "
                f"to {-top:.2f} m high) where the level beams may miss it",
                f"keep {clear:g} m from its top or foot, or fly {_BEAM_HIT_MARGIN_M:g} m inside its height, "
                "where the beams hit it",
            )


_BEAM_HIT_MARGIN_M = 0.15
"""Distance of a beam inside an obstacle's height that ensures a hit despite the helicopter's tilt (m)."""


@result
class MissionEstimate:
    """Planned time, length and charge of a mission.

    Attributes
    ----------
    duration_s : float
        Time from the start signal until landing with the rotors at rest (s).
    path_m : float
        Length of the reference from lift-off to touchdown (m).
    charge_Ah, charge_fraction : float
        Charge used, and its fraction of the battery's charge.
    """

    duration_s: float
    path_m: float
    charge_Ah: float
    charge_fraction: float

    @property
    def charge_As(self) -> float:
        """Charge used (As)."""
        return 3600.0 * self.charge_Ah


def check_mission_endurance(
    mission: Mission, *, hover_current_A: float, capacity_Ah: float, charge: float = 1.0, where: str = ""
) -> MissionEstimate:
    """Estimate time and charge of a mission, and refuse it if the battery does not suffice.

    Parameters
    ----------
    mission : Mission
        Mission with checked geometry.
    hover_current_A : float
        Battery current in hover (A), electronics included.
    capacity_Ah : float
        Charge of the full battery (A h), of which the share ``battery.usable`` is available.
    charge : float
        Present charge, as a fraction of the full battery's.
    where : str
        File name for error messages; the mission's name by default.

    Returns
    -------
    MissionEstimate
        Time, length and charge.

    Raises
    ------
    InputError
        If the charge does not suffice; the message names the first part beyond it: take-off height, waypoint, wait or
        landing.
    """
    where = where or mission.name
    share = mission.battery.usable if charge >= 1.0 else max(0.0, mission.battery.usable - (1.0 - charge))
    lasts = 3600.0 * share * capacity_Ah / hover_current_A
    present = "" if charge >= 1.0 else f", charged to {charge:.0%}"
    remedy = (
        f"the battery lasts {lasts:.0f} s ({share:.0%} of {capacity_Ah * 1000:.0f} mA h at "
        f"{hover_current_A:.1f} A{present}): "
    )
    remedy += "charge it, or " if present else ""

    timing = compute_mission_timing(mission)
    height, up = mission.take_off.height_m, compute_take_off_time(mission)
    least = up + compute_landing_time(height, mission)
    if least > lasts:
        raise InputError(
            where,
            "take_off.height_m",
            f"{height:g} m is out of reach: climb and landing take {_format_seconds(least)}",
            remedy + "take off lower",
        )
    for leg, waypoint in zip(timing.legs, mission.waypoint, strict=True):
        key = f"waypoint[{leg.waypoint_number}]"
        landing = compute_landing_time(-waypoint.position_m[2], mission)
        rise = abs(waypoint.position_m[2] - leg.trajectory.start[2])
        if leg.reached_s + landing > lasts:
            vertical = rise > leg.trajectory.path_profile.distance
            raise InputError(
                where,
                f"{key}.position_m",
                f"{waypoint.position_m[2]:g} m (D) is out of reach"
                if vertical
                else f"is out of reach: flight and landing take {_format_seconds(leg.reached_s + landing)}",
                remedy + ("fly lower" if vertical else "shorten the path, fly faster, or wait less before it"),
            )
        if leg.wait_end_s + landing > lasts:
            raise InputError(
                where,
                f"{key}.wait_s",
                f"{waypoint.wait_s:g} is too long: the mission so far and the landing take "
                f"{_format_seconds(leg.wait_end_s + landing)}",
                remedy + "wait less",
            )
    time = timing.landed_s
    if time > lasts:
        problem = f'"return" is out of reach: the mission and the return take {_format_seconds(time)}'
        raise InputError(where, "at_end", problem, remedy + 'end with "land", or shorten the mission')
    charge = time * hover_current_A / 3600.0
    return MissionEstimate(time, timing.path_length_m, charge, charge / capacity_Ah)


def _format_seconds(t: float) -> str:
    return f"{t:.0f} s" if t < 1e5 else f"{t:.1e} s"


# ----------------------------------------------------------------------------
# Conversion of a mission file (TOML) to a checked `Mission`, and back.


_BUILTIN_FOLDER = resources.files("mufly.mission") / "builtin"


def list_builtin_missions() -> list[str]:
    """Return the names of the missions that come with mufly."""
    return builtin_file_names(_BUILTIN_FOLDER)


def load_mission(name_or_path: str | Path) -> Mission:
    """Read a mission by built-in name or from a TOML file, and check it.

    Parameters
    ----------
    name_or_path : str or Path
        A name from `list_builtin_missions`, or the path of a mission file, or of a plan (``.plan``) or waypoint
        file (``.waypoints``) of QGroundControl or Mission Planner.

    Returns
    -------
    Mission
        Immutable, checked mission: known keys, possible values, waypoints in free air.

    Raises
    ------
    InputError
        If the file is invalid; the message names file, key, value and remedy. Waypoints are counted from 1.
    """
    name = str(name_or_path)
    if name not in list_builtin_missions() and Path(name).is_file():
        try:
            tables = read_mission_tables(Path(name).read_text(encoding="utf-8-sig"), name)
            return parse_mission(_resolve_floor_picture_path(tables, name), name)
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(name, "", f"cannot be read ({error})", "give a text file in UTF-8") from error
    tables, where = read_toml(name_or_path, _BUILTIN_FOLDER, "mission")
    return parse_mission({"name": Path(where).stem, **_resolve_floor_picture_path(tables, where)}, where)


def _resolve_floor_picture_path(tables: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the tables with the path of a floor's picture, which is relative to the mission file."""
    floor = tables.get("floor")
    if not isinstance(floor, dict) or not isinstance(texture := floor.get("texture"), str):
        return tables
    if not (picture := Path(where).parent / texture).is_file():
        return tables
    return {**tables, "floor": {**floor, "texture": str(picture.resolve())}}


def read_mission_tables(text: str, where: str) -> dict[str, Any]:
    """Return the tables of a mission file: TOML, or a plan or waypoint file of QGroundControl or Mission Planner.

    Parameters
    ----------
    text : str
        Content of the file.
    where : str
        Name of the file for error messages, and of a mission without a name.

    Raises
    ------
    InputError
        If the text has none of these formats, or cannot be flown.
    """
    if is_ground_station_text(text):
        return {"name": Path(where).stem, **ground_text_to_mission_tables(text, where)}
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, "", f"is not valid TOML ({error})", "correct that line") from error
    return {"name": Path(where).stem, **tables}


def parse_mission(tables: Mapping[str, Any], where: str = "mission") -> Mission:
    """Return a checked mission from nested dictionaries with the keys of a mission file.

    Parameters
    ----------
    tables : mapping
        As TOML gives it: ``{"waypoint": [{"position_m": [1, 0, -1]}], ...}``.
    where : str
        Name of the source for error messages.

    Raises
    ------
    InputError
        See `load_mission`.
    """
    mission = validate_model(Mission, tables, where)
    check_mission_clearance(mission, where)
    return mission


def format_mission_toml(mission: Mission) -> str:
    """Return the text of a mission file, defaults included, which `load_mission` reads as an equal mission."""
    lines: list[str] = []
    tables: list[tuple[str, dict[str, Any]]] = []
    for key, value in mission.model_dump(exclude_none=True).items():
        if isinstance(value, dict):
            tables.append((f"[{key}]", value))
        elif isinstance(value, list | tuple) and (not value or isinstance(value[0], dict)):
            tables += [(f"[[{key}]]", item) for item in value]
        else:
            lines.append(f"{key} = {format_toml_value(value)}")
    for head, table in tables:
        lines += ["", head, *(f"{k} = {format_toml_value(v)}" for k, v in table.items())]
    return "\n".join(lines) + "\n"


# ----------------------------------------------------------------------------
# Check that a vehicle can fly a mission, called before a flight by the command line and by `mufly.flight.fly_mission`.


def check_mission_for_vehicle(
    vehicle: Vehicle,
    mission: Mission,
    *,
    vehicle_file: str = "",
    mission_file: str = "",
    able: TrajectoryLimits | None = None,
) -> MissionEstimate:
    """Check that the vehicle hovers, that the mission suits it and that its battery suffices.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
        Checked mission, as `load_mission` returns it.
    vehicle_file, mission_file : str
        Names for error messages; the names of vehicle and mission by default.
    able : TrajectoryLimits, optional
        Limits of the vehicle's controllers (:func:`mufly.flight.derive_trajectory_limits`): the mission is flown no
        faster.

    Returns
    -------
    MissionEstimate
        Time, length and charge.

    Raises
    ------
    InputError
        If a check fails; the message names file, key, value and remedy.
    """
    try:
        current = hover_current_A(vehicle)
    except InputError as error:
        raise error.with_location(vehicle_file or vehicle.name) from None
    where = mission_file or mission.name
    try:
        prepare_mission_plan(mission, vehicle)
    except InputError as error:
        raise error.with_location(where) from None
    capacity_Ah = float(vehicle.battery.capacity) / 3600.0
    if able is not None:
        mission, _ = reduce_mission_limits(mission, able)
    return check_mission_endurance(mission, hover_current_A=current, capacity_Ah=capacity_Ah, where=where)


# ----------------------------------------------------------------------------
# Reduction of a mission's limits to the helicopter's capability.
#
# A helicopter overshoots a reference that is faster than itself. Decisive is not the speed but that the reference
# brakes no harder than the helicopter can. So each limit of the mission is reduced, before the flight, to a share of
# the controllers' limits.


MISSION_FRACTION_OF_CONTROL_LIMITS = 0.8
"""Fraction of the controllers' limits available to a mission; the rest is for corrections."""


def reduce_mission_limits(mission: Mission, able: TrajectoryLimits) -> tuple[Mission, str]:
    """Reduce a mission's limits to the helicopter's capability.

    Parameters
    ----------
    mission : Mission
        Mission with its own limits.
    able : TrajectoryLimits
        Limits of the controllers, SI units.

    Returns
    -------
    mission : Mission
        Mission with reduced limits; the same object if none changed.
    changes : str
        Description of the changes: ``"climb_m_s 0.8 in place of 2"``; empty without changes.
    """
    can = limits_to_file_units(able)
    most = MISSION_FRACTION_OF_CONTROL_LIMITS * able.speed
    hasty = [k for k, w in enumerate(mission.waypoint) if w.speed_m_s is not None and w.speed_m_s > most]
    slower = {
        key: MISSION_FRACTION_OF_CONTROL_LIMITS * most
        for key, most in can.items()
        if MISSION_FRACTION_OF_CONTROL_LIMITS * most < getattr(mission.limits, key)
    }
    if not slower and not hasty:
        return mission, ""
    words = [f"{key} {value:.2g} in place of {getattr(mission.limits, key):g}" for key, value in slower.items()]
    words += [f"waypoint[{k + 1}].speed_m_s {most:.2g} in place of {mission.waypoint[k].speed_m_s:g}" for k in hasty]
    limits = mission.limits.model_copy(update=slower)
    waypoints = tuple(
        w.model_copy(update={"speed_m_s": most}) if k in hasty else w for k, w in enumerate(mission.waypoint)
    )
    return mission.replace_parts(limits=limits, waypoint=waypoints), ", ".join(words)
