"""Compiled episodes of many environments: starts, actions, motion of the vehicles, observations and rewards.

A step of an environment is one period, by default 20 ms, in which the wind is constant. The action acts after a delay
of a part of the period, drawn for each episode; until then the preceding action acts. Every environment has its own
source of random numbers (:mod:`mufly.sensors.rng`) and is therefore independent of the number of environments.

With ``sensors="noisy"`` an observation has the errors of an estimate, from the sensors of the vehicle file. Position
and heading have the correlated and the white error of the position fix. The velocity has the white error over the
period of the fixes. Roll and pitch have the error of the level. The rates have the white noise of the gyroscopes over a
step. There is no filter. A Gauss-Markov process of variance 1 and time constant tau is sampled exactly, ``e[k+1] =
d e[k] + sqrt(1 - d^2) n``, ``d = exp(-T / tau)``.

With ``sensors="fitted"`` an observation is the estimate of a filter on simulated sensors
(:mod:`mufly.gym.filter_units`); an episode starts in the hover of a flight.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import portable_atan2, sine_cosine
from mufly.dynamics.equations_of_motion import compute_battery_supply, find_deepest_contact
from mufly.dynamics.lane_equations import assign_vehicles_to_blocks, integrate_lanes
from mufly.dynamics.model_state import (
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_VELOCITY,
    NED_POSITION_SLICE,
    STATE_SIZE,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
)
from mufly.flight.policy.observation import (
    ACTION_SIZE,
    MAX_RANGE_M,
    OBS_TASK_INPUTS,
    OBSERVED_RANGE_COUNT,
    fill_common_observation,
    heading_direction,
    map_action_to_inputs,
)
from mufly.gym.fleet import MIN_START_CHARGE
from mufly.gym.tasks import (
    PILLAR_COUNT,
    PILLAR_ROW_SIZE,
    TASK_OBSTACLE,
    TASK_WAYPOINT,
    compute_reward_and_end,
    draw_random_waypoint,
    shift_task_target,
    write_start_targets_pillars,
)
from mufly.sensors.rng import draw_normals, draw_uniforms
from mufly.world.obstacles import compute_first_hit_distance, compute_packed_obstacle_distances

_Array = NDArray[np.float64]
_Ints = NDArray[np.int64]

_UNIFORMS_PER_EPISODE = 40  # drawn at the start of an episode
_MAX_START_TILT_RAD, _MAX_START_SPEED_M_S, _MAX_START_RATE_RAD_S = 0.15, 0.3, 0.3
ESTIMATE_ERROR_POSITION_INDEX, ESTIMATE_ERROR_HEADING_INDEX, ESTIMATE_ERROR_TILT_INDEX, ESTIMATE_ERROR_COUNT = (
    0,
    3,
    4,
    6,
)
"""Indices of the correlated errors of an estimate."""
WHITE_NOISE_POSITION_INDEX, WHITE_NOISE_VELOCITY_INDEX, WHITE_NOISE_HEADING_INDEX, WHITE_NOISE_RATES_INDEX = 0, 1, 2, 3
"""Indices of the standard deviations of an estimate's white errors."""
(
    DRAWN_POSITION_NOISE_INDEX,
    DRAWN_VELOCITY_NOISE_INDEX,
    DRAWN_RATE_NOISE_INDEX,
    DRAWN_HEADING_NOISE_INDEX,
    DRAWN_ERROR_DRIFT_INDEX,
) = 0, 3, 6, 9, 10
"""First indices, in the normal numbers of a step, of those for white and for correlated errors."""


class EpisodeArrays(NamedTuple):
    """State, task, random source and wind of the present episode of each of n environments, as arrays.

    Attributes
    ----------
    state : (n, 21) array
        States of the flight model.
    random_source : (n,) array
        Sources of random numbers (:mod:`mufly.sensors.rng`).
    target, next_target : (n, 3) array
        Target and the target after it (m).
    heading : (n, 2) array
        Cosine and sine of the target heading.
    action, previous_inputs, inputs : (n, 4) array
        Action, and inputs of the flight model in the preceding step and in this one.
    wind_velocity : (n, 3) array
        Velocity of the air (m/s).
    vehicle_index, wind_series_index, wind_sample : (n,) array
        Index of the vehicle in the fleet, of the wind, and of the wind's sample.
    delay_steps, step_count, reached_target_count : (n,) array
        Delay in integration steps, steps of the episode, number of reached targets.
    distance, speed, action_change_squared : (n,) array
        Distance to the target (m), speed (m/s), square of the last change of the action.
    estimate_error : (n, 6) array
        Correlated errors of the estimate, of variance 1.
    pillars : (n, 6, 5) array
        Columns of ``Obstacle``, packed as in :class:`mufly.world.World`.
    """

    state: _Array
    random_source: NDArray[np.uint64]
    target: _Array
    next_target: _Array
    heading: _Array
    action: _Array
    previous_inputs: _Array
    inputs: _Array
    wind_velocity: _Array
    vehicle_index: _Ints
    wind_series_index: _Ints
    wind_sample: _Ints
    delay_steps: _Ints
    step_count: _Ints
    distance: _Array
    speed: _Array
    action_change_squared: _Array
    estimate_error: _Array
    pillars: _Array
    reached_target_count: _Ints


class EpisodeSettings(NamedTuple):
    """Settings of all environments of a vector.

    Attributes
    ----------
    task_index, max_steps : int
        Index of the task, and steps of an episode.
    max_delay_steps : int
        Greatest delay of an action, in integration steps.
    trim_inputs : (4,) array
        Inputs for an action of zero.
    nominal_V, rotor_radius_m : float
        Nominal voltage of the battery, radius of the rotors (m).
    room_limits : (6,) array
        Packed walls and ceiling of ``Obstacle``.
    observation_low, observation_high : (m,) array
        Bounds of an observation.
    has_errors : bool
        Whether an observation has errors.
    starts_in_hover : bool
        Whether episodes start in the hover of a flight, and not turned and moving.
    error_decay, error_std : (6,) array
        Decay in a step and standard deviation of the correlated errors.
    white_noise_std : (4,) array
        White standard deviations of position (m), velocity (m/s), heading (rad) and rates (rad/s).
    """

    task_index: int
    max_steps: int
    max_delay_steps: int
    trim_inputs: _Array
    nominal_V: float
    rotor_radius_m: float
    room_limits: _Array
    observation_low: _Array
    observation_high: _Array
    has_errors: bool
    starts_in_hover: bool
    error_decay: _Array
    error_std: _Array
    white_noise_std: _Array


def make_episodes(count: int) -> EpisodeArrays:
    """Return the arrays of ``count`` environments before their first episode."""
    n = count

    def zero_integers() -> _Ints:
        return np.zeros(n, dtype=np.int64)

    return EpisodeArrays(
        state=np.zeros((n, STATE_SIZE)),
        random_source=np.zeros(n, dtype=np.uint64),
        target=np.zeros((n, 3)),
        next_target=np.zeros((n, 3)),
        heading=np.zeros((n, 2)),
        action=np.zeros((n, ACTION_SIZE)),
        previous_inputs=np.zeros((n, 4)),
        inputs=np.zeros((n, 4)),
        wind_velocity=np.zeros((n, 3)),
        vehicle_index=zero_integers(),
        wind_series_index=zero_integers(),
        wind_sample=zero_integers(),
        delay_steps=zero_integers(),
        step_count=zero_integers(),
        distance=np.zeros(n),
        speed=np.zeros(n),
        action_change_squared=np.zeros(n),
        estimate_error=np.zeros((n, ESTIMATE_ERROR_COUNT)),
        pillars=np.zeros((n, PILLAR_COUNT, PILLAR_ROW_SIZE)),
        reached_target_count=zero_integers(),
    )


@cached_njit(error_model="numpy")
def copy_numbers(source: _Array, target: _Array) -> None:
    """Copy an array (n,); a loop compiles in a tenth of the time of a slice."""
    for i in range(source.size):
        target[i] = source[i]


@cached_njit(error_model="numpy", nogil=True)
def start_episodes(
    e: EpisodeArrays, s: EpisodeSettings, which: NDArray[np.bool_], states: _Array, inputs: _Array, series: _Ints,
    winds: _Array,
) -> None:  # fmt: skip
    """Start a new episode in the environments that the mask ``which`` (n,) selects.

    ``states`` (k, 21), ``inputs`` (k, 4) and ``series`` (k,) are those of the fleet in hover, ``winds`` is
    (w, samples, 3).
    """
    r, start = np.empty(_UNIFORMS_PER_EPISODE), np.empty(3)
    for k in range(which.size):
        if not which[k]:
            continue
        draw_uniforms(e.random_source[k : k + 1], r)
        e.vehicle_index[k], e.wind_series_index[k] = int(r[0] * states.shape[0]), int(r[1] * winds.shape[0])
        e.wind_sample[k], e.delay_steps[k] = int(r[2] * winds.shape[1]), int(r[3] * (s.max_delay_steps + 1))
        x = e.state[k]
        if series[e.vehicle_index[k]] >= 0:
            e.wind_series_index[k] = series[e.vehicle_index[k]]
        copy_numbers(states[e.vehicle_index[k]], x)
        write_start_targets_pillars(s.task_index, r[14:], start, e.target[k], e.next_target[k], e.pillars[k])
        # Start heading, and target heading within a quarter turn of it; no heading to hold on the way to a target.
        yaw = math.pi * (2.0 * r[4] - 1.0)
        if s.starts_in_hover:
            shift_task_target(s.task_index, start, x[NED_POSITION_SLICE], e.target[k])
            c, sn = heading_direction(
                x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
            )
            yaw = portable_atan2(sn, c)
        else:
            copy_numbers(start, x[NED_POSITION_SLICE])
        wanted = yaw + 0.5 * math.pi * (2.0 * r[5] - 1.0)
        e.heading[k, 1], e.heading[k, 0] = sine_cosine(wanted)
        if not s.starts_in_hover:
            roll, pitch = _MAX_START_TILT_RAD * (2.0 * r[6] - 1.0), _MAX_START_TILT_RAD * (2.0 * r[7] - 1.0)
            _set_attitude(x, roll, pitch, yaw)
            for i in range(3):
                x[MODEL_VELOCITY + i] = _MAX_START_SPEED_M_S * (2.0 * r[8 + i] - 1.0)
                x[MODEL_RATES + i] = _MAX_START_RATE_RAD_S * (2.0 * r[11 + i] - 1.0)
            x[MODEL_CHARGE] = MIN_START_CHARGE + (1.0 - MIN_START_CHARGE) * r[39]
        copy_numbers(inputs[e.vehicle_index[k]], e.inputs[k])
        copy_numbers(winds[e.wind_series_index[k], e.wind_sample[k]], e.wind_velocity[k])
        for i in range(ACTION_SIZE):
            e.action[k, i] = 0.0
        e.step_count[k], e.reached_target_count[k], e.action_change_squared[k] = 0, 0, 0.0
        e.distance[k], e.speed[k] = _target_distance(x, e.target[k]), _speed(x)
        if s.has_errors:
            draw_normals(e.random_source[k : k + 1], e.estimate_error[k])


@cached_njit(error_model="numpy")
def _set_attitude(x: _Array, roll: float, pitch: float, yaw: float) -> None:
    """Write the attitude, with the stabiliser bar's disc normal to the mast."""
    s1, c1 = sine_cosine(0.5 * roll)
    s2, c2 = sine_cosine(0.5 * pitch)
    s3, c3 = sine_cosine(0.5 * yaw)
    x[MODEL_ATTITUDE] = c1 * c2 * c3 + s1 * s2 * s3
    x[MODEL_ATTITUDE + 1] = s1 * c2 * c3 - c1 * s2 * s3
    x[MODEL_ATTITUDE + 2] = c1 * s2 * c3 + s1 * c2 * s3
    x[MODEL_ATTITUDE + 3] = c1 * c2 * s3 - s1 * s2 * c3
    w, i, j, k = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1] = -2.0 * (i * k + w * j), -2.0 * (j * k - w * i)
    x[MODEL_BAR_NORMAL + 2] = 2.0 * (i * i + j * j) - 1.0


@cached_njit(error_model="numpy")
def _target_distance(x: _Array, target: _Array) -> float:
    n, e, d = target[0] - x[MODEL_POSITION], target[1] - x[MODEL_POSITION + 1], target[2] - x[MODEL_POSITION + 2]
    return math.sqrt(n * n + e * e + d * d)


@cached_njit(error_model="numpy")
def _speed(x: _Array) -> float:
    return math.sqrt(
        x[MODEL_VELOCITY] * x[MODEL_VELOCITY]
        + x[MODEL_VELOCITY + 1] * x[MODEL_VELOCITY + 1]
        + x[MODEL_VELOCITY + 2] * x[MODEL_VELOCITY + 2]
    )


@cached_njit(error_model="numpy", nogil=True)
def apply_actions_and_wind(
    e: EpisodeArrays, s: EpisodeSettings, actions: NDArray[np.float32], which: NDArray[np.bool_], winds: _Array
) -> None:
    """Set the actions (n, 4) of the environments in ``which``, and advance their wind by one sample."""
    for k in range(which.size):
        if not which[k]:
            continue
        change = 0.0
        for i in range(ACTION_SIZE):
            a = min(max(float(actions[k, i]), -1.0), 1.0)
            change += (a - e.action[k, i]) ** 2
            e.action[k, i] = a
        e.action_change_squared[k] = change
        copy_numbers(e.inputs[k], e.previous_inputs[k])
        map_action_to_inputs(e.action[k], s.trim_inputs, e.inputs[k])
        e.wind_sample[k] = (e.wind_sample[k] + 1) % winds.shape[1]
        copy_numbers(winds[e.wind_series_index[k], e.wind_sample[k]], e.wind_velocity[k])


def integrate_episodes(
    e: EpisodeArrays, fleet: NDArray[np.void], group: _Ints, dt: float, steps: int, threads: int = 1
) -> None:
    """Integrate all vehicles over a period of ``steps`` steps of ``dt`` (s).

    ``group`` (k,) of the fleet's vehicles is that of :func:`mufly.dynamics.lane_equations.group_vehicles`. Vehicles of
    ended episodes move, too; they start anew before anyone observes them.
    """
    blocks = assign_vehicles_to_blocks(group[e.vehicle_index])
    integrate_lanes(
        e.state,
        e.previous_inputs,
        e.inputs,
        e.delay_steps,
        e.wind_velocity,
        fleet,
        e.vehicle_index,
        blocks,
        dt,
        steps,
        threads=threads,
    )


@cached_njit(error_model="numpy", nogil=True)
def compute_rewards_and_ends(
    e: EpisodeArrays, s: EpisodeSettings, which: NDArray[np.bool_], fleet: NDArray[np.void], reward: _Array,
    terminated: NDArray[np.bool_], truncated: NDArray[np.bool_], success: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Write the rewards and ends of a step for the environments in ``which``; set the next target after a reached
    waypoint.
    """
    boxes, r = np.empty((0, 8)), np.empty(3)
    for k in range(which.size):
        if not which[k]:
            continue
        x = e.state[k]
        p = fleet[e.vehicle_index[k]]
        now = _target_distance(x, e.target[k])
        touches = x[MODEL_POSITION + 2] + p.contact_reach > 0.0 and find_deepest_contact(x, p)[0] > 0.0
        collides = False
        if s.task_index == TASK_OBSTACLE:
            near = compute_packed_obstacle_distances(
                x[NED_POSITION_SLICE].reshape(1, 3), boxes, e.pillars[k], s.room_limits
            )[0][0]
            collides = not near > s.rotor_radius_m
        w, i, j, z = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
        c, sn = heading_direction(w, i, j, z)
        speed = max(_speed(x), e.speed[k])  # legs stop a vehicle within a step
        e.speed[k] = _speed(x)
        rates = x[MODEL_RATES] ** 2 + x[MODEL_RATES + 1] ** 2 + x[MODEL_RATES + 2] ** 2
        reward[k], terminated[k], success[k] = compute_reward_and_end(
            s.task_index, e.distance[k], now, e.heading[k, 0] * c + e.heading[k, 1] * sn, rates,
            e.action_change_squared[k], 1.0 - 2.0 * (i * i + j * j), speed, touches, collides,
        )  # fmt: skip
        if success[k]:
            e.reached_target_count[k] += 1
            if s.task_index == TASK_WAYPOINT:
                copy_numbers(e.next_target[k], e.target[k])
                draw_uniforms(e.random_source[k : k + 1], r)
                draw_random_waypoint(r, e.next_target[k])
                now = _target_distance(x, e.target[k])
        e.distance[k] = now
        e.step_count[k] += 1
        truncated[k] = not terminated[k] and e.step_count[k] >= s.max_steps


@cached_njit(error_model="numpy", nogil=True)
def observe_episodes(
    e: EpisodeArrays, s: EpisodeSettings, which: NDArray[np.bool_], fleet: NDArray[np.void], estimate: _Array,
    volts: _Array, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Write the observations (n, m) of the environments that the mask ``which`` selects; draw errors of estimation.

    ``estimate`` (n, 21) are the observed states: the true ones or those of a filter; ``volts`` (n,) the measured
    voltages (V), NaN for the true one.
    """
    row, boxes = np.empty(s.observation_low.size), np.empty((0, 8))
    error, velocity, rates, white = (
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.empty(DRAWN_ERROR_DRIFT_INDEX + ESTIMATE_ERROR_COUNT),
    )
    for k in range(which.size):
        if not which[k]:
            continue
        x = estimate[k]
        p = fleet[e.vehicle_index[k]]
        for i in range(3):
            error[i] = e.target[k, i] - x[MODEL_POSITION + i]
            velocity[i] = x[MODEL_VELOCITY + i]
            rates[i] = x[MODEL_RATES + i]
        w, qx, qy, qz = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
        down_x, down_y = 2.0 * (qx * qz - w * qy), 2.0 * (qy * qz + w * qx)
        down_z = 1.0 - 2.0 * (qx * qx + qy * qy)
        c, sn = heading_direction(w, qx, qy, qz)
        if s.has_errors:
            draw_normals(e.random_source[k : k + 1], white)
            drift = e.estimate_error[k]
            for i in range(3):
                error[i] -= (
                    s.error_std[ESTIMATE_ERROR_POSITION_INDEX + i] * drift[ESTIMATE_ERROR_POSITION_INDEX + i]
                    + s.white_noise_std[WHITE_NOISE_POSITION_INDEX] * white[DRAWN_POSITION_NOISE_INDEX + i]
                )
                velocity[i] += s.white_noise_std[WHITE_NOISE_VELOCITY_INDEX] * white[DRAWN_VELOCITY_NOISE_INDEX + i]
                rates[i] += s.white_noise_std[WHITE_NOISE_RATES_INDEX] * white[DRAWN_RATE_NOISE_INDEX + i]
            noise = s.white_noise_std[WHITE_NOISE_HEADING_INDEX] * white[DRAWN_HEADING_NOISE_INDEX]
            turn_s, turn_c = sine_cosine(
                s.error_std[ESTIMATE_ERROR_HEADING_INDEX] * drift[ESTIMATE_ERROR_HEADING_INDEX] + noise
            )
            c, sn = c * turn_c - sn * turn_s, sn * turn_c + c * turn_s
            down_x -= s.error_std[ESTIMATE_ERROR_TILT_INDEX + 1] * drift[ESTIMATE_ERROR_TILT_INDEX + 1]
            down_y += s.error_std[ESTIMATE_ERROR_TILT_INDEX] * drift[ESTIMATE_ERROR_TILT_INDEX]
            for i in range(ESTIMATE_ERROR_COUNT):
                drift[i] = (
                    s.error_decay[i] * drift[i]
                    + math.sqrt(1.0 - s.error_decay[i] * s.error_decay[i]) * white[DRAWN_ERROR_DRIFT_INDEX + i]
                )
        voltage = volts[k]
        if voltage != voltage:
            voltage = compute_battery_supply(e.state[k], e.inputs[k, U_MOTOR_UPPER], e.inputs[k, U_MOTOR_LOWER], p)[0]
        fill_common_observation(
            row, error, velocity, (down_x, down_y, down_z), rates, (c, sn), (e.heading[k, 0], e.heading[k, 1]),
            voltage / s.nominal_V, e.action[k], -e.target[k, 2] + error[2],
        )  # fmt: skip
        if s.task_index == TASK_WAYPOINT:
            north, east = (
                e.next_target[k, 0] - e.target[k, 0] + error[0],
                e.next_target[k, 1] - e.target[k, 1] + error[1],
            )
            row[OBS_TASK_INPUTS], row[OBS_TASK_INPUTS + 1] = c * north + sn * east, c * east - sn * north
            row[OBS_TASK_INPUTS + 2] = e.next_target[k, 2] - e.target[k, 2] + error[2]
        elif s.task_index == TASK_OBSTACLE:
            for i in range(OBSERVED_RANGE_COUNT):
                sa, ca = sine_cosine(i * 2.0 * math.pi / OBSERVED_RANGE_COUNT)
                row[OBS_TASK_INPUTS + i] = compute_first_hit_distance(
                    e.state[k, :3],
                    c * ca - sn * sa,
                    sn * ca + c * sa,
                    0.0,
                    MAX_RANGE_M,
                    boxes,
                    e.pillars[k],
                    s.room_limits,
                )
        for i in range(row.size):
            v = row[i]
            out[k, i] = min(max(v, s.observation_low[i]), s.observation_high[i]) if v == v else 0.0
