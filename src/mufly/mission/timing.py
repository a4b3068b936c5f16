"""How long does a mission take? The one reckoning that every display and every judgement of endurance reads.

From the start signal until it has landed with its rotors at rest: speeding up the rotors, the climb, each leg as its
reference is flown (`mufly.mission.trajectory`: turn and height on the spot, then the way, from rest to rest), looking
around before a leg where it scans, the way around obstacles that the file names, settling, waits, the way home, and
the descent by the law of the landing with its slow end. Own derivation.

A way around an obstacle: straight on until the contour at `FOLLOW_M` beyond the clearance, along that on the shorter
side until the straight way to the goal keeps the clearance, then straight on from rest. So flies
:mod:`mufly.mission.detour`, which sees the obstacle only as it comes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.mission.avoidance import ENTER_M, LOOK_M
from mufly.mission.detour import FOLLOW_M, LEAVE_M
from mufly.mission.schema import SLOW_FROM_M, SPIN_UP_S, Mission, above_start, leg_trajectory
from mufly.mission.trajectory import Limits, Trajectory, profile, straight
from mufly.world import Box, Cylinder, World, distances

SETTLE_S = 0.25
"""Mean time from the end of a leg's reference until the waypoint counts as reached (s)."""

LOOK_AROUND_S = 3.0
"""Time that a scanning helicopter looks around before it leaves (s)."""

RAMP_DOWN_S = 1.0
"""Time that the rotors take to stop after touchdown (s)."""

SINK_LAG_S = 0.15
"""Time constant with which a landing goes over to another rate of descent (s)."""

_TOUCH_M, _STEP_S = 0.03, 0.02
_ARC = 12

_Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Leg:
    """One waypoint in the plan: its trajectory and when the wait there is over (s since the start signal)."""

    number: int
    trajectory: Trajectory
    length_m: float
    reached_s: float
    left_s: float


@dataclass(frozen=True, slots=True)
class MissionTiming:
    """When a mission is where; times in s since the start signal.

    Attributes
    ----------
    up_s : float
        The take-off has reached its height.
    legs : tuple of Leg
        One a waypoint.
    home_s : float
        Above where it lands: after the last wait or, with ``at_end = "return"``, after the way home.
    landed_s : float
        Landed, rotors at rest.
    path_m : float
        Length of the reference from lift-off to touchdown, without ways around obstacles (m).
    """

    up_s: float
    legs: tuple[Leg, ...]
    home_s: float
    landed_s: float
    path_m: float


def expected_timing(mission: Mission) -> MissionTiming:
    """Return when a mission is where, as it is expected to be flown.

    Parameters
    ----------
    mission : Mission
        With the limits that are flown: those of the file, brought down to what the controllers can follow
        (:func:`mufly.mission.slowed`).

    Examples
    --------
    >>> from mufly.mission import expected_timing, load_mission
    >>> round(expected_timing(load_mission("demonstration")).landed_s)
    77
    """
    plan = legs(mission)
    up_s = take_off_time(mission)
    here, heading = above_start(mission), math.radians(mission.start_heading_deg)
    left_s, path_m = up_s, mission.take_off.height_m
    if plan:
        here, left_s = np.array(mission.waypoint[-1].position_m), plan[-1].left_s
        heading = plan[-1].trajectory.heading + plan[-1].trajectory.turn
        path_m += sum(leg.length_m for leg in plan)
    back = homeward(mission, heading)
    if back is not None:
        took, length = _leg_time(mission, back, mission.trajectory_limits, len(plan))
        left_s, path_m = left_s + took, path_m + length
    height = -float(here[2])
    landed_s = left_s + landing_time(height, mission)
    return MissionTiming(up_s, tuple(plan), left_s, landed_s, path_m + height)


def take_off_time(mission: Mission) -> float:
    """Time from the start signal until the take-off has reached its height (s)."""
    climb = straight((0.0, 0.0, 0.0), (0.0, 0.0, -mission.take_off.height_m), 0.0, mission.trajectory_limits)
    return SPIN_UP_S + climb.duration_s


def legs(mission: Mission) -> list[Leg]:
    """The planned legs, one a waypoint, with the times at which they are flown."""
    position, heading = above_start(mission), math.radians(mission.start_heading_deg)
    time = take_off_time(mission) + mission.take_off.wait_s
    plan = []
    for i, waypoint in enumerate(mission.waypoint):
        way = leg_trajectory(mission, i, position, heading)
        took, length = _leg_time(mission, way, mission.leg_limits(i), i)
        reached = time + took
        time = reached + waypoint.wait_s
        plan.append(Leg(i + 1, way, length, reached, time))
        position, heading = np.array(waypoint.position_m), heading + way.turn
    return plan


def homeward(mission: Mission, heading: float = 0.0) -> Trajectory | None:
    """The way back from the last waypoint to above the start, as planned, where the mission ends with one.

    Parameters
    ----------
    mission : Mission
    heading : float
        At the last waypoint (rad).
    """
    if mission.at_end != "return" or not mission.waypoint:
        return None
    last = mission.waypoint[-1].position_m
    return straight(last, (*mission.start_m, last[2]), heading, mission.trajectory_limits)


def landing_rate(above: float, descent: float, touchdown: float, acceleration: float) -> float:
    """Rate of descent that a landing asks for at a height ``above`` the floor (m/s).

    v^2 = v1^2 + 2 (a/2) h: half the acceleration brings it from descent to touchdown speed where that begins.
    """
    return min(descent, math.sqrt(touchdown * touchdown + max(0.0, above - SLOW_FROM_M) * acceleration))


def landing_time(height: float, mission: Mission) -> float:
    """Time from the land signal, at rest at a ``height`` (m), until the rotors are at rest (s).

    The law is that of :func:`mufly.mission.phases.sink`.
    """
    q = mission.limits
    a, steady = q.climb_acceleration_m_s2, q.descent_m_s
    # Where it sinks at a steady rate nothing happens that a step would tell.
    slow = SLOW_FROM_M + (steady * steady - q.touchdown_m_s * q.touchdown_m_s) / a
    skipped = max(0.0, height - slow - 4.0 * steady)
    above, speed, rate, time = height - skipped, 0.0, 0.0, skipped / steady
    while above > -_TOUCH_M:
        wanted = landing_rate(above, steady, q.touchdown_m_s, a)
        ask = min(max((wanted - speed) / SINK_LAG_S, -a), a)
        rate += (ask - rate) * min(1.0, _STEP_S / 0.1)
        speed += rate * _STEP_S
        above -= max(speed, 1e-3) * _STEP_S
        time += _STEP_S
    return time + RAMP_DOWN_S


def reach_time(mission: Mission, here: ArrayLike, place: ArrayLike) -> float:
    """Time to fly from a place (3,) to another (3,) with a mission's limits, and to land there (s)."""
    a, b = (np.asarray(v, dtype=np.float64) for v in (here, place))
    start = np.array([a[0], a[1], min(float(a[2]), -mission.take_off.height_m)]) if a[2] > -0.2 else a
    way = straight(start, b, 0.0, mission.trajectory_limits)
    return way.duration_s + landing_time(max(-float(b[2]), 0.0), mission)


def _leg_time(mission: Mission, way: Trajectory, limits: Limits, number: int) -> tuple[float, float]:
    """Time (s) and length of the reference (m) of a leg (``number`` from 0), with what its reference does not tell."""
    length = way.way.way if way.curve is not None else abs(way.goal[2] - way.start[2]) + way.way.way
    look_s = LOOK_AROUND_S if mission.scans and way.way.way > 0.0 else 0.0
    around_s, near = _around_obstacles(mission, way, limits)
    if near and number:
        look_s = 0.0  # an obstacle so near was seen from the leg before, and is gone around at once
    return way.duration_s + look_s + around_s + SETTLE_S, length


# ----------------------------------------------------------------------------
# Around the obstacles that a file names.


def _around_obstacles(mission: Mission, way: Trajectory, limits: Limits) -> tuple[float, bool]:
    """How much longer a leg takes (s) for the obstacles on its level way; whether one is near its start."""
    clear, world = mission.avoidance.clearance_m, mission.world
    if not mission.avoidance.enabled or way.way.way == 0.0 or not (world.boxes or world.cylinders):
        return 0.0, False
    at, goal = np.array([*way.start[:2], way.goal[2]]), np.array(way.goal)
    longer_s, near = 0.0, False
    for k in range(len(world.boxes) + len(world.cylinders)):
        met = _first_met(world, at, goal, clear)
        if met is None:
            break
        which, entry = met
        along, leave = _contour(world, which, entry, goal, clear)
        straight_on = _apart(entry, at)
        near = near or (k == 0 and straight_on < LOOK_M)
        # It comes to rest before it goes on, and goes along the contour at its own speed.
        before = profile(_apart(goal, at), limits.speed, limits.acceleration).duration_s
        ramp = profile(math.inf, mission.avoidance.speed_m_s, limits.acceleration).ramp_s
        after = profile(_apart(goal, leave), limits.speed, limits.acceleration).duration_s
        longer_s += straight_on / limits.speed + along / mission.avoidance.speed_m_s + ramp + after - before
        at = leave
    return max(longer_s, 0.0), near


def _apart(a: _Array, b: _Array) -> float:
    return float(np.linalg.norm(a - b))


def _single(world: World, k: int) -> World:
    n = len(world.boxes)
    return World((world.boxes[k],)) if k < n else World((), (world.cylinders[k - n],))


def _first_met(world: World, at: _Array, goal: _Array, clear: float) -> tuple[int, _Array] | None:
    """The obstacle that is met first on a line, and where its contour is; None: the line is clear."""
    count = max(2, math.ceil(_apart(goal, at) / 0.02) + 1)
    line = at + np.linspace(0.0, 1.0, count)[:, None] * (goal - at)
    met: tuple[int, int] | None = None
    for k in range(len(world.boxes) + len(world.cylinders)):
        away, _ = distances(_single(world, k), line)
        if float(away.min()) >= clear + ENTER_M:
            continue
        first = int(np.argmax(away < clear + FOLLOW_M))
        if met is None or first < met[1]:
            met = (k, first)
    return None if met is None else (met[0], line[met[1]])


def _outline(obstacle: Box | Cylinder, off: float) -> _Array:
    """Points (n, 2) of the level contour at a distance from an obstacle, all around."""
    if isinstance(obstacle, Cylinder):
        turn = np.linspace(0.0, math.tau, 8 * _ARC, endpoint=False)
        return np.array(obstacle.centre[:2]) + (obstacle.radius + off) * np.stack(
            [np.cos(turn), np.sin(turn)], 1
        )
    half, parts = 0.5 * np.array(obstacle.size[:2]), []
    for quarter, corner in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        turn = 0.5 * math.pi * quarter + np.linspace(0.0, 0.5 * math.pi, _ARC)
        parts.append(half * corner + off * np.stack([np.cos(turn), np.sin(turn)], 1))
    c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
    return np.concatenate(parts) @ np.array([[c, s], [-s, c]]) + np.array(obstacle.centre[:2])


def _contour(world: World, k: int, entry: _Array, goal: _Array, clear: float) -> tuple[float, _Array]:
    """Length along the contour of obstacle ``k`` on the shorter side (m), and where it is left for the goal."""
    n = len(world.boxes)
    obstacle = world.boxes[k] if k < n else world.cylinders[k - n]
    outline, alone = _outline(obstacle, clear + FOLLOW_M), _single(world, k)
    first = int(np.argmin(np.linalg.norm(outline - entry[:2], axis=1)))
    found: list[tuple[float, float, _Array]] = []
    share = np.linspace(0.0, 1.0, 60)[:, None]
    for step in (1, -1):
        length, here = 0.0, entry[:2]
        for j in range(1, len(outline)):
            spot = outline[(first + step * j) % len(outline)]
            length, here = length + _apart(spot, here), spot
            place = np.array([*here, goal[2]])
            away, _ = distances(alone, place + share * (goal - place))
            if float(away.min()) >= clear + LEAVE_M:
                break
        place = np.array([*here, goal[2]])
        found.append((length + _apart(goal, place), length, place))
    _, length, place = min(found, key=lambda side: side[0])
    return length, place
