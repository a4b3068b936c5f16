"""Observation and action of learned policies and of the environments of :mod:`mufly.gym`.

An observation holds only quantities of an estimate, so that a policy can fly on a filter. The heading frame is level:
x along the vehicle's heading, y to the right, z down.

======================  ==============================================================================================
index                   meaning
======================  ==============================================================================================
``OBS_POSITION_ERROR``  target minus position, heading frame (m)
``OBS_VELOCITY``        velocity, heading frame (m/s)
``OBS_DOWN_DIRECTION``  direction of gravity, body axes
``OBS_RATES``           p, q, r (rad/s)
``OBS_HEADING``         sine and cosine of target heading minus heading
``OBS_SUPPLY_VOLTAGE``  battery voltage over nominal voltage, minus 1
``OBS_LAST_ACTION``     action of the preceding step
``OBS_HEIGHT``          height above the floor (m)
``OBS_TASK_INPUTS``     Waypoint: the next target minus position, heading frame (m). Obstacle: distances (m) to the
                        nearest surface in eight level directions, clockwise from the heading
======================  ==============================================================================================

An action has four numbers from -1 to 1: collective, turn to the right, forward, right. With the inputs of hover
``trim``, the inputs of the flight model are

    motor upper, lower = trim + 0.3 collective +- 0.15 turn        servo 1 = forward,  servo 2 = right

The C code of an exported policy (``firmware/sources/policy``) performs the same operations in the same order.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import U_MOTOR_LOWER, U_MOTOR_UPPER, U_SERVO_1, U_SERVO_2

_Array = NDArray[np.float64]

(
    OBS_POSITION_ERROR,
    OBS_VELOCITY,
    OBS_DOWN_DIRECTION,
    OBS_RATES,
    OBS_HEADING,
    OBS_SUPPLY_VOLTAGE,
    OBS_LAST_ACTION,
    OBS_HEIGHT,
    OBS_TASK_INPUTS,
) = (0, 3, 6, 9, 12, 14, 15, 19, 20)
ACTION_SIZE = 4
OBSERVED_RANGE_COUNT = 8
"""Number of the level directions in which the task ``Obstacle`` observes distances."""
MAX_RANGE_M = 4.0
MAX_COLLECTIVE_DUTY_OFFSET, MAX_YAW_DUTY_OFFSET = 0.3, 0.15
"""Largest offsets from the duties of hover (1): of both motors together, and of each in opposite directions."""
ACTION_NAMES = ("collective", "turn_right", "forward", "right")

_COMMON_OBSERVATION_UNITS = {
    "error_forward": "m", "error_right": "m", "error_down": "m", "velocity_forward": "m/s", "velocity_right": "m/s",
    "velocity_down": "m/s", "down_x": "1", "down_y": "1", "down_z": "1", "roll_rate": "rad/s", "pitch_rate": "rad/s",
    "yaw_rate": "rad/s", "heading_error_sine": "1", "heading_error_cosine": "1", "supply": "1",
    **{f"last_{name}": "1" for name in ACTION_NAMES}, "height": "m",
}  # fmt: skip

_COMMON_OBSERVATION_LIMITS = (
    (10.0,) * 3 + (20.0,) * 3 + (1.0,) * 3 + (50.0,) * 3 + (1.0,) * 2 + (1.0,) + (1.0,) * ACTION_SIZE + (20.0,)
)


def observation_limits(task: str) -> tuple[_Array, _Array]:
    """Return the lowest and the highest observation of a task; observations are clipped to them."""
    extra = {"waypoint": (10.0,) * 3, "obstacle": (MAX_RANGE_M,) * OBSERVED_RANGE_COUNT}.get(task, ())
    high = np.array(_COMMON_OBSERVATION_LIMITS + extra)
    low = -high
    if task == "obstacle":
        low[OBS_TASK_INPUTS:] = 0.0
    return low, high


def observation_units(task: str) -> dict[str, str]:
    """Return the names of a task's observation in order, each with its unit."""
    extra = {
        "waypoint": [f"next_error_{axis}" for axis in ("forward", "right", "down")],
        "obstacle": [f"range_{round(360 * k / OBSERVED_RANGE_COUNT)}_deg" for k in range(OBSERVED_RANGE_COUNT)],
    }.get(task, [])
    return {**_COMMON_OBSERVATION_UNITS, **dict.fromkeys(extra, "m")}


@cached_njit(error_model="numpy")
def map_action_to_inputs(action: _Array, trim: _Array, inputs: _Array) -> None:
    """Convert an action (4,) to the inputs (4,) of the flight model, relative to the hover inputs ``trim`` (4,)."""
    up, turned, servo_1, servo_2 = action[0], action[1], action[2], action[3]
    collective, turn = MAX_COLLECTIVE_DUTY_OFFSET * up, MAX_YAW_DUTY_OFFSET * turned
    inputs[U_MOTOR_UPPER] = min(max(trim[U_MOTOR_UPPER] + collective + turn, 0.0), 1.0)
    inputs[U_MOTOR_LOWER] = min(max(trim[U_MOTOR_LOWER] + collective - turn, 0.0), 1.0)
    inputs[U_SERVO_1] = servo_1
    inputs[U_SERVO_2] = servo_2


@cached_njit(error_model="numpy")
def heading_direction(w: float, x: float, y: float, z: float) -> tuple[float, float]:
    """Return cosine and sine of the heading of a unit quaternion; north where the nose points straight up or down."""
    north, east = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    length = math.sqrt(north * north + east * east)
    if length < 1e-9:
        return 1.0, 0.0
    return north / length, east / length


@cached_njit(error_model="numpy")
def fill_common_observation(
    out: _Array,
    error: _Array,
    velocity: _Array,
    down: tuple[float, float, float],
    rates: _Array,
    heading: tuple[float, float],
    target_heading: tuple[float, float],
    supply: float,
    action: _Array,
    height: float,
) -> None:
    """Write the part of an observation that all tasks share.

    Parameters
    ----------
    out : (n,) array
        Output; the first ``OBS_TASK_INPUTS`` numbers are written.
    error, velocity : (3,) array
        Target minus position (m), and velocity (m/s), N-E-D.
    down : (float, float, float)
        Direction of gravity, body axes.
    rates : (3,) array
        p, q, r (rad/s).
    heading, target_heading : (float, float)
        Cosine and sine.
    supply : float
        Battery voltage over nominal voltage.
    action : (4,) array
        Action of the preceding step.
    height : float
        Height above the floor (m).
    """
    c, s = heading
    out[OBS_POSITION_ERROR], out[OBS_POSITION_ERROR + 1] = c * error[0] + s * error[1], c * error[1] - s * error[0]
    out[OBS_POSITION_ERROR + 2] = error[2]
    out[OBS_VELOCITY], out[OBS_VELOCITY + 1] = c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]
    out[OBS_VELOCITY + 2] = velocity[2]
    out[OBS_DOWN_DIRECTION], out[OBS_DOWN_DIRECTION + 1], out[OBS_DOWN_DIRECTION + 2] = down
    out[OBS_RATES], out[OBS_RATES + 1], out[OBS_RATES + 2] = rates[0], rates[1], rates[2]
    out[OBS_HEADING] = target_heading[1] * c - target_heading[0] * s
    out[OBS_HEADING + 1] = target_heading[0] * c + target_heading[1] * s
    out[OBS_SUPPLY_VOLTAGE] = supply - 1.0
    for i in range(ACTION_SIZE):
        out[OBS_LAST_ACTION + i] = action[i]
    out[OBS_HEIGHT] = height
