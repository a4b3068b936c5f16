"""Tasks of the environments: start, target, reward and end of an episode.

========  ================================================================================================
Hover     hold a point 0.2 to 2 m above the floor and a heading, from up to 0.5 m beside it; a step earns at most 1
Waypoint  fly to points within 1.5 m, one after the other; reward 5 at 0.2 m from a point, 2 for each metre of
          approach
Obstacle  fly 4 m north around six columns between walls 4 m apart; reward 10 at the target, 2 for each metre of
          approach
Land      descend to a point on the floor; reward 10 for a soft touchdown, minus 5 for each metre beside the point,
          2 for each metre of approach
========  ================================================================================================

With e the distance (m), v the speed (m/s), psi the heading error, w the body rates (rad/s) and a the action, a step of
Hover earns

    0.3 / (1 + 4 e^2) + 0.3 / (1 + 100 e^2) + 0.2 (1 + cos psi) / 2 + 0.2 / (1 + w^2 + 10 v^2) - 0.1 (a - a_before)^2

The other tasks cost 0.02 (a - a_before)^2 + 0.01 (1 - cos psi) a step. A fall costs 5; in Hover it costs the remaining
rewards.

An episode of Obstacle or Land terminates with success. Each episode terminates with a fall: a leg or rotor on the floor
(Land: a hard touchdown), a rotor at a column or wall, or more than 60 degrees of tilt. More than 3 m from the target
(Obstacle: 6 m) counts as a fall, too. Time truncates an episode.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.world import World
from mufly.world.obstacles import Room

_Array = NDArray[np.float64]

TASK_NAMES = ("hover", "waypoint", "obstacle", "land")
TASK_HOVER, TASK_WAYPOINT, TASK_OBSTACLE, TASK_LAND = range(4)
TASK_DURATIONS_S = (10.0, 20.0, 20.0, 10.0)
"""Default length of an episode of each task."""

PILLAR_COUNT = 6
PILLAR_NORTH_INDEX, PILLAR_EAST_INDEX, PILLAR_RADIUS_INDEX, PILLAR_TOP_INDEX, PILLAR_FOOT_INDEX, PILLAR_ROW_SIZE = (
    0,
    1,
    2,
    3,
    4,
    5,
)
"""Indices of a column: axis, radius, upper and lower end (m; down is positive)."""
OBSTACLE_WORLD = World(room=Room((-3.0, 3.0), (-2.0, 2.0), 2.5))
"""Walls and ceiling of ``Obstacle``; its columns differ from episode to episode."""

REACHED_DISTANCE_M = 0.2
LOST_DISTANCE_M, LOST_DISTANCE_OBSTACLE_M = 3.0, 6.0
MIN_UPRIGHT_COSINE = 0.5  # cosine of the tilt
OBSTACLE_TARGET_HEIGHT_M = 1.0
OBSTACLE_START_NORTH_M = -2.0
HOVER_HEIGHTS_M = (0.2, 2.0)
START_SPREAD_M = 0.5
SOFT_LANDING_SPEED_M_S, SOFT_LANDING_UPRIGHT_COSINE = 0.5, 0.94  # touchdown: greatest speed, least cosine of the tilt
_FAILURE_REWARD = -5.0


@cached_njit(error_model="numpy")
def write_start_targets_pillars(
    kind: int, r: _Array, start: _Array, target: _Array, after: _Array, columns: _Array
) -> None:
    """Write a task's start, target and next target (three numbers each; N-E-D, m), and its pillars, ``columns`` (6, 5).

    ``r`` are uniform random numbers; ``columns`` has the layout of a packed :class:`mufly.world.World`.
    """
    target[0], target[1], target[2] = 0.0, 0.0, -OBSTACLE_TARGET_HEIGHT_M
    if kind == TASK_HOVER:  # a height that differs from episode to episode is no measure of the error
        target[2] = -(HOVER_HEIGHTS_M[0] + (HOVER_HEIGHTS_M[1] - HOVER_HEIGHTS_M[0]) * r[3])
    for i in range(3):
        start[i] = target[i] + START_SPREAD_M * (2.0 * r[i] - 1.0)
    if kind == TASK_HOVER:
        start[2] = min(start[2], -HOVER_HEIGHTS_M[0])
    elif kind == TASK_WAYPOINT:
        draw_random_waypoint(r[3:6], target)
        draw_random_waypoint(r[6:9], after)
    elif kind == TASK_OBSTACLE:
        start[0], target[0] = OBSTACLE_START_NORTH_M + 0.4 * (r[0] - 0.5), 2.0
        target[1] = 2.0 * (r[3] - 0.5)
        for k in range(PILLAR_COUNT):
            columns[k, PILLAR_NORTH_INDEX] = -1.3 + 2.6 * (k + r[4 + k]) / PILLAR_COUNT
            columns[k, PILLAR_EAST_INDEX] = 3.2 * (r[10 + k] - 0.5)
            columns[k, PILLAR_RADIUS_INDEX] = 0.1 + 0.15 * r[16 + k]
            columns[k, PILLAR_TOP_INDEX], columns[k, PILLAR_FOOT_INDEX] = -2.5, 0.0
    elif kind == TASK_LAND:
        start[2] = -0.8 - 0.7 * r[2]
        target[2] = 0.0


@cached_njit(error_model="numpy")
def shift_task_target(kind: int, start: _Array, place: _Array, target: _Array) -> None:
    """Shift the target (3,) of a task from its planned start (3,) to the place (3,) where the vehicle hovers.

    Hover and Land keep the drawn distance between start and target; the heights of their targets stay in range. The
    targets of Waypoint and Obstacle stay.
    """
    if kind in (TASK_HOVER, TASK_LAND):
        target[0] += place[0] - start[0]
        target[1] += place[1] - start[1]
    if kind == TASK_HOVER:
        target[2] = min(max(target[2] + place[2] - start[2], -HOVER_HEIGHTS_M[1]), -HOVER_HEIGHTS_M[0])


@cached_njit(error_model="numpy")
def draw_random_waypoint(r: _Array, point: _Array) -> None:
    """Write a random waypoint (3,; N-E-D, m), computed from three uniform random numbers."""
    point[0], point[1], point[2] = 3.0 * (r[0] - 0.5), 3.0 * (r[1] - 0.5), -0.5 - 1.5 * r[2]


@cached_njit(error_model="numpy")
def compute_reward_and_end(
    kind: int, before: float, now: float, heading_cosine: float, rates_squared: float, change_squared: float,
    upright: float, speed: float, touches: bool, collides: bool,
) -> tuple[float, bool, bool]:  # fmt: skip
    """Return the reward of a step, whether the step ends the episode, and whether it ends with success.

    Parameters
    ----------
    kind : int
        Index of the task in :data:`TASK_NAMES`.
    before, now : float
        Distance to the target before and after the step (m).
    heading_cosine : float
        Cosine of the heading error.
    rates_squared, change_squared : float
        Square sums of the body rates (rad2/s2) and of the change of the action.
    upright : float
        Cosine of the tilt.
    speed : float
        Greatest speed at begin and end of the step (m/s).
    touches, collides : bool
        Whether a leg or a rotor touches the floor, and a rotor an obstacle.
    """
    far = now > (LOST_DISTANCE_OBSTACLE_M if kind == TASK_OBSTACLE else LOST_DISTANCE_M)
    lost = not (upright > MIN_UPRIGHT_COSINE) or far or collides or not (speed < 100.0)
    if kind == TASK_HOVER:
        if lost or touches:
            return 0.0, True, False
        still = 0.2 / (1.0 + rates_squared + 10.0 * speed * speed)
        near = 0.3 / (1.0 + 4.0 * now * now) + 0.3 / (1.0 + 100.0 * now * now)
        return near + still + 0.1 * (1.0 + heading_cosine) - 0.1 * change_squared, False, False
    reward = 2.0 * (before - now) - 0.02 * change_squared - 0.01 * (1.0 - heading_cosine)
    if kind == TASK_LAND and touches and not lost:
        soft = speed < SOFT_LANDING_SPEED_M_S and upright > SOFT_LANDING_UPRIGHT_COSINE
        return (reward + max(10.0 - 5.0 * now, 0.0), True, True) if soft else (_FAILURE_REWARD, True, False)
    if lost or touches:
        return _FAILURE_REWARD, True, False
    if now < REACHED_DISTANCE_M and kind == TASK_WAYPOINT:
        return reward + 5.0, False, True
    if now < REACHED_DISTANCE_M and kind == TASK_OBSTACLE:
        return reward + 10.0, True, True
    return reward, False, False
