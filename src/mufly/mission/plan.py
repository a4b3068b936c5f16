"""The legs of a mission: which trajectory leads to which waypoint, and when."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.mission.schema import Mission
from mufly.mission.trajectory import Trajectory, curved, straight

__all__ = ["SETTLE_S", "Leg", "above_start", "homeward", "leg_trajectory", "legs"]

SPIN_UP_S = 3.0
"""Time that the rotors take to speed up before lift-off (s)."""

SLOW_FROM_M = 0.4
"""Height (m) below which a landing goes at the touchdown speed."""

SETTLE_S = 1.0
"""What settling at each waypoint is reckoned to take on top of its reference (s)."""


def leg_trajectory(
    mission: Mission,
    index: int,
    start: NDArray[np.float64],
    heading: float,
    *,
    nose_offset: float = 0.0,
) -> Trajectory:
    """The way to waypoint ``index`` (from 0) from wherever the helicopter is.

    Parameters
    ----------
    mission : Mission
        With its path kind and limits.
    index : int
        Which waypoint.
    start : (3,) array
        N, E, D (m).
    heading : float
        Heading at the start (rad).
    nose_offset : float
        Angle of the nose from the direction of flight (rad) where the waypoint asks for no heading.
    """
    waypoint = mission.waypoint[index]
    goal = np.array(waypoint.position_m)
    final = None if waypoint.heading_deg is None else math.radians(waypoint.heading_deg)
    limits = mission.leg_limits(index)
    if mission.path.kind == "straight":
        return straight(start, goal, heading, limits, final_heading=final, nose_offset=nose_offset)
    before = np.array(mission.waypoint[index - 1].position_m) if index else above_start(mission)
    # Chord directions through the neighbours (Catmull-Rom), so that the curve has no kink at a waypoint.
    after = np.array(mission.waypoint[index + 1].position_m) if index + 1 < len(mission.waypoint) else goal
    further = np.array(mission.waypoint[index - 2].position_m) if index > 1 else above_start(mission)
    leaving = goal - further if index else goal - before
    return curved(
        start, goal, leaving, after - before, heading, limits, final_heading=final, nose_offset=nose_offset
    )


def above_start(mission: Mission) -> NDArray[np.float64]:
    """Where the take-off ends, N, E, D (m)."""
    return np.array([*mission.start_m, -mission.take_off.height_m])


def homeward(mission: Mission) -> Trajectory | None:
    """The way back from the last waypoint to above the start, as planned, where the mission ends with one."""
    if mission.at_end != "return" or not mission.waypoint:
        return None
    last = mission.waypoint[-1].position_m
    goal = (*mission.start_m, last[2])
    return straight(last, goal, 0.0, mission.trajectory_limits)


@dataclass(frozen=True, slots=True)
class Leg:
    """One waypoint in the plan: its trajectory and when the wait there is over (s since the start signal)."""

    number: int
    trajectory: Trajectory
    length_m: float
    reached_s: float
    left_s: float


def legs(mission: Mission) -> list[Leg]:
    """The planned legs, one a waypoint, with the times at which they are flown."""
    limits = mission.trajectory_limits
    position, heading = above_start(mission), math.radians(mission.start_heading_deg)
    standing = np.array([*mission.start_m, 0.0])
    time = SPIN_UP_S + straight(standing, position, heading, limits).duration_s + SETTLE_S
    time += mission.take_off.wait_s
    plan = []
    for i, waypoint in enumerate(mission.waypoint):
        way = leg_trajectory(mission, i, position, heading)
        reached = time + way.duration_s + SETTLE_S
        time = reached + waypoint.wait_s
        length = abs(way.goal[2] - way.start[2]) + way.way.way if way.curve is None else way.way.way
        plan.append(Leg(i + 1, way, length, reached, time))
        position, heading = np.array(waypoint.position_m), heading + way.turn
    return plan
