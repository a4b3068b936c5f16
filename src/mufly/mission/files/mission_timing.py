"""Expected duration of a mission, used by all displays and endurance checks.

The duration runs from the start signal until landing with the rotors at rest. It includes spin-up, climb, the
legs, settling, waits, the return, and the landing with its slow end. A leg is a turn and a change of height on the
spot, then the path, from rest to rest (`mufly.mission.trajectory`). A scan and detours around obstacles in the file
may be added. Own derivation.

A detour around an obstacle runs straight to the contour at `FOLLOW_CONTOUR_MARGIN_M` beyond the clearance. It follows
the contour on the shorter side until the straight path to the goal keeps the clearance, then continues straight from
rest.
This is the behaviour of :mod:`mufly.mission.detour`, which however detects the obstacle only in flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.mission.avoidance import BLOCKED_PATH_MARGIN_M, PATH_LOOK_AHEAD_M
from mufly.mission.detour import CLEAR_PATH_MARGIN_M, FOLLOW_CONTOUR_MARGIN_M
from mufly.mission.files.mission_schema import (
    ROTOR_SPIN_UP_TIME_S,
    SLOW_LANDING_HEIGHT_M,
    Mission,
    plan_leg_trajectory,
    position_after_take_off,
)
from mufly.mission.trajectory import Trajectory, TrajectoryLimits, make_motion_profile, plan_straight
from mufly.world import Box, Cylinder, World, compute_obstacle_distances

SETTLE_TIME_S = 0.25
"""Mean time from the end of a leg's reference until the waypoint counts as reached (s)."""

SCAN_TIME_BEFORE_DEPARTURE_S = 3.0
"""Time of a scan before departure (s)."""

ROTOR_RUN_DOWN_TIME_S = 1.0
"""Time of the rotors' run-down after touchdown (s)."""

DESCENT_LAG_S = 0.15
"""Time constant of changes of the descent rate in a landing (s)."""

_TOUCHDOWN_DEPTH_M, _INTEGRATION_STEP_S = 0.03, 0.02
_ARC_POINT_COUNT = 12

_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlannedLeg:
    """A planned leg: waypoint, trajectory, and end of the wait there (s since the start signal)."""

    waypoint_number: int
    trajectory: Trajectory
    length_m: float
    reached_s: float
    wait_end_s: float


@dataclass(frozen=True, slots=True)
class MissionTiming:
    """Times of a mission in s since the start signal.

    Attributes
    ----------
    take_off_done_s : float
        The take-off reaches its height.
    legs : tuple of PlannedLeg
        One leg a waypoint.
    above_landing_s : float
        Above the landing place: after the last wait or, with ``at_end = "return"``, after the return leg.
    landed_s : float
        Landed, rotors at rest.
    path_length_m : float
        Length of the reference from lift-off to touchdown, without detours (m).
    """

    take_off_done_s: float
    legs: tuple[PlannedLeg, ...]
    above_landing_s: float
    landed_s: float
    path_length_m: float


def compute_mission_timing(mission: Mission) -> MissionTiming:
    """Return the expected times of a mission, leg by leg, from the start signal to the landing.

    Parameters
    ----------
    mission : Mission
        Mission with the limits as flown: those of the file, reduced to the controllers' capability
        (:func:`mufly.mission.reduce_mission_limits`).

    Examples
    --------
    >>> from mufly.mission import compute_mission_timing, load_mission
    >>> round(compute_mission_timing(load_mission("demonstration")).landed_s)
    78
    """
    plan = plan_legs(mission)
    up_s = compute_take_off_time(mission)
    here, heading = position_after_take_off(mission), math.radians(mission.start_heading_deg)
    left_s, path_m = up_s, mission.take_off.height_m
    if plan:
        here, left_s = np.array(mission.waypoint[-1].position_m), plan[-1].wait_end_s
        heading = plan[-1].trajectory.start_heading + plan[-1].trajectory.turn_angle
        path_m += sum(leg.length_m for leg in plan)
    back = plan_return_leg(mission, heading)
    if back is not None:
        took, length = _compute_leg_time_and_length(mission, back, mission.trajectory_limits, len(plan))
        left_s, path_m = left_s + took, path_m + length
    height = -float(here[2])
    landed_s = left_s + compute_landing_time(height, mission)
    return MissionTiming(up_s, tuple(plan), left_s, landed_s, path_m + height)


def compute_take_off_time(mission: Mission) -> float:
    """Return the time from the start signal until the take-off reaches its height (s)."""
    climb = plan_straight((0.0, 0.0, 0.0), (0.0, 0.0, -mission.take_off.height_m), 0.0, mission.trajectory_limits)
    return ROTOR_SPIN_UP_TIME_S + climb.duration_s


def plan_legs(mission: Mission) -> list[PlannedLeg]:
    """Return the planned legs, one per waypoint, with their times."""
    position, heading = position_after_take_off(mission), math.radians(mission.start_heading_deg)
    time = compute_take_off_time(mission) + mission.take_off.wait_s
    plan = []
    for i, waypoint in enumerate(mission.waypoint):
        way = plan_leg_trajectory(mission, i, position, heading)
        took, length = _compute_leg_time_and_length(mission, way, mission.leg_limits(i), i)
        reached = time + took
        time = reached + waypoint.wait_s
        plan.append(PlannedLeg(i + 1, way, length, reached, time))
        position, heading = np.array(waypoint.position_m), heading + way.turn_angle
    return plan


def plan_return_leg(mission: Mission, heading: float = 0.0) -> Trajectory | None:
    """Return the planned leg from the last waypoint to above the start; None if the mission does not return.

    Parameters
    ----------
    mission : Mission
    heading : float
        Heading at the last waypoint (rad).
    """
    if mission.at_end != "return" or not mission.waypoint:
        return None
    last = mission.waypoint[-1].position_m
    return plan_straight(last, (*mission.start_m, last[2]), heading, mission.trajectory_limits)


def compute_landing_rate(above: float, descent: float, touchdown: float, acceleration: float) -> float:
    """Return the descent rate of a landing at a height ``above`` the floor (m/s).

    v^2 = v1^2 + 2 (a/2) h: half the acceleration reduces descent to touchdown speed at the slow landing height.
    """
    return min(descent, math.sqrt(touchdown * touchdown + max(0.0, above - SLOW_LANDING_HEIGHT_M) * acceleration))


def compute_landing_time(height: float, mission: Mission) -> float:
    """Return the time from the land signal, at rest at a ``height`` (m), until the rotors are at rest (s).

    The landing law is that of :func:`mufly.mission.machine.ground_phases.step_landing`.
    """
    q = mission.limits
    return _integrate_landing_time(float(height), q.climb_acceleration_m_s2, q.descent_m_s, q.touchdown_m_s)


@lru_cache(maxsize=1024)  # the checks before every flight of a campaign ask for the same landings
def _integrate_landing_time(height: float, a: float, steady: float, touchdown: float) -> float:
    # The phase of constant descent rate is skipped analytically.
    slow = SLOW_LANDING_HEIGHT_M + (steady * steady - touchdown * touchdown) / a
    skipped = max(0.0, height - slow - 4.0 * steady)
    above, speed, rate, time = height - skipped, 0.0, 0.0, skipped / steady
    while above > -_TOUCHDOWN_DEPTH_M:
        wanted = compute_landing_rate(above, steady, touchdown, a)
        ask = min(max((wanted - speed) / DESCENT_LAG_S, -a), a)
        rate += (ask - rate) * min(1.0, _INTEGRATION_STEP_S / 0.1)
        speed += rate * _INTEGRATION_STEP_S
        above -= max(speed, 1e-3) * _INTEGRATION_STEP_S
        time += _INTEGRATION_STEP_S
    return time + ROTOR_RUN_DOWN_TIME_S


def compute_time_to_land_at(mission: Mission, here: ArrayLike, place: ArrayLike) -> float:
    """Return the time to fly from one place (3,) to another (3,) with a mission's limits, and to land there (s)."""
    a, b = (np.asarray(v, dtype=np.float64) for v in (here, place))
    start = np.array([a[0], a[1], min(float(a[2]), -mission.take_off.height_m)]) if a[2] > -0.2 else a
    way = plan_straight(start, b, 0.0, mission.trajectory_limits)
    return way.duration_s + compute_landing_time(max(-float(b[2]), 0.0), mission)


def _compute_leg_time_and_length(
    mission: Mission, way: Trajectory, limits: TrajectoryLimits, number: int
) -> tuple[float, float]:
    """Return duration (s) and length (m) of leg ``number`` (from 0).

    The duration includes scanning for obstacles, detours around them, and settling at the waypoint.
    """
    length = (
        way.path_profile.distance
        if way.spline_curve is not None
        else abs(way.goal[2] - way.start[2]) + way.path_profile.distance
    )
    look_s = SCAN_TIME_BEFORE_DEPARTURE_S if mission.scans_by_yawing and way.path_profile.distance > 0.0 else 0.0
    around_s, near = _estimate_detour_time(mission, way, limits)
    if near and number:
        look_s = 0.0  # the previous leg detected such a near obstacle, and the detour begins at once
    return way.duration_s + look_s + around_s + SETTLE_TIME_S, length


# ----------------------------------------------------------------------------
# Detours around obstacles in the file.


def _estimate_detour_time(mission: Mission, way: Trajectory, limits: TrajectoryLimits) -> tuple[float, bool]:
    """Return a leg's extra time (s) for obstacles on its level path, and whether one is near its start."""
    clear, world = mission.avoidance.clearance_m, mission.world
    if not mission.avoidance.enabled or way.path_profile.distance == 0.0 or not (world.boxes or world.cylinders):
        return 0.0, False
    at, goal = np.array([*way.start[:2], way.goal[2]]), np.array(way.goal)
    longer_s, near = 0.0, False
    for k in range(len(world.boxes) + len(world.cylinders)):
        met = _find_first_obstacle(world, at, goal, clear)
        if met is None:
            break
        which, entry = met
        along, leave = _measure_contour_detour(world, which, entry, goal, clear)
        straight_on = _distance_between(entry, at)
        near = near or (k == 0 and straight_on < PATH_LOOK_AHEAD_M)
        # The reference comes to rest before it continues, and follows the contour at its own speed.
        before = make_motion_profile(_distance_between(goal, at), limits.speed, limits.acceleration).duration_s
        ramp = make_motion_profile(math.inf, mission.avoidance.speed_m_s, limits.acceleration).ramp_s
        after = make_motion_profile(_distance_between(goal, leave), limits.speed, limits.acceleration).duration_s
        longer_s += straight_on / limits.speed + along / mission.avoidance.speed_m_s + ramp + after - before
        at = leave
    return max(longer_s, 0.0), near


def _distance_between(a: _Array, b: _Array) -> float:
    return float(np.linalg.norm(a - b))


def _world_with_one_obstacle(world: World, k: int) -> World:
    n = len(world.boxes)
    return World((world.boxes[k],)) if k < n else World((), (world.cylinders[k - n],))


def _find_first_obstacle(world: World, at: _Array, goal: _Array, clear: float) -> tuple[int, _Array] | None:
    """Return the first obstacle on a line and the point where its contour is met; None if the line is clear."""
    count = max(2, math.ceil(_distance_between(goal, at) / 0.02) + 1)
    line = at + np.linspace(0.0, 1.0, count)[:, None] * (goal - at)
    met: tuple[int, int] | None = None
    for k in range(len(world.boxes) + len(world.cylinders)):
        away, _ = compute_obstacle_distances(_world_with_one_obstacle(world, k), line)
        if float(away.min()) >= clear + BLOCKED_PATH_MARGIN_M:
            continue
        first = int(np.argmax(away < clear + FOLLOW_CONTOUR_MARGIN_M))
        if met is None or first < met[1]:
            met = (k, first)
    return None if met is None else (met[0], line[met[1]])


def _outline_around_obstacle(obstacle: Box | Cylinder, off: float) -> _Array:
    """Return points (n, 2) of the closed level contour at a distance from an obstacle."""
    if isinstance(obstacle, Cylinder):
        turn = np.linspace(0.0, math.tau, 8 * _ARC_POINT_COUNT, endpoint=False)
        return np.array(obstacle.centre[:2]) + (obstacle.radius + off) * np.stack([np.cos(turn), np.sin(turn)], 1)
    half, parts = 0.5 * np.array(obstacle.size[:2]), []
    for quarter, corner in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        turn = 0.5 * math.pi * quarter + np.linspace(0.0, 0.5 * math.pi, _ARC_POINT_COUNT)
        parts.append(half * corner + off * np.stack([np.cos(turn), np.sin(turn)], 1))
    c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
    return np.concatenate(parts) @ np.array([[c, s], [-s, c]]) + np.array(obstacle.centre[:2])


def _measure_contour_detour(world: World, k: int, entry: _Array, goal: _Array, clear: float) -> tuple[float, _Array]:
    """Return the length along the contour of obstacle ``k`` on the shorter side (m), and the point of departure."""
    n = len(world.boxes)
    obstacle = world.boxes[k] if k < n else world.cylinders[k - n]
    outline, alone = (
        _outline_around_obstacle(obstacle, clear + FOLLOW_CONTOUR_MARGIN_M),
        _world_with_one_obstacle(world, k),
    )
    first = int(np.argmin(np.linalg.norm(outline - entry[:2], axis=1)))
    found: list[tuple[float, float, _Array]] = []
    share = np.linspace(0.0, 1.0, 60)[:, None]
    for step in (1, -1):
        length, here = 0.0, entry[:2]
        for j in range(1, len(outline)):
            spot = outline[(first + step * j) % len(outline)]
            length, here = length + _distance_between(spot, here), spot
            place = np.array([*here, goal[2]])
            away, _ = compute_obstacle_distances(alone, place + share * (goal - place))
            if float(away.min()) >= clear + CLEAR_PATH_MARGIN_M:
                break
        place = np.array([*here, goal[2]])
        found.append((length + _distance_between(goal, place), length, place))
    _, length, place = min(found, key=lambda side: side[0])
    return length, place
