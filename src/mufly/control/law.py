"""Control law on board: pure functions of gains, state, reference and measurement, called once a period.

Each controller is ``u = C x + D e``, ``x+ = x + F x + B e + M (sat(u) - u)`` with ``F = A - I``; M is the anti-windup
gain of :mod:`mufly.control.implementation`. Slow states and integrators change little in a period. A sum that began
with the state would round the change to the state's last digit. In single precision this is an error of a few
thousandths of the change, with the same sign every period, and in heave-yaw it would reach the actuators. Heave-yaw
therefore stores the rounding error and adds it in the next period (compensated summation; Kahan, Comm. ACM 8, 1965),
also for the filtered references.

Heave-yaw. A second-order filter limits acceleration and speed of the reference to the motors' capability, so that a
step does not saturate them. A reference with its rate, within the limits, passes unchanged except for
``acceleration / bandwidth^2``, and is advanced by its rate times the lag of the closed loop. The command is a voltage,
as a fraction of the design voltage. The battery bounds it to ``[0, U/U_design]``, and the motor input is the command
over that bound. If both motors saturate, yaw has priority: the difference of the two commands is kept and the mean
is reduced. Otherwise saturation in heave would spin the fuselage.

In flight the height may trail the filtered reference (after a gust, in a fall, with stick inputs beyond the motors'
capability). Then the reference slows down and stays within the slack of the height until the height has caught up
(``limit_heave_reference``). A greater error would request more thrust than the motors can reduce in time. A reference
that stopped at once would cost a heavy vehicle thrust that it needs. On the ground the error may grow, which starts
the motors.

Roll-pitch. Tilt references are limited; servos saturate one by one. A schedule adds outputs in proportion to the square
of the forward speed (:mod:`mufly.control.tuning.output_schedule`); the states are those of the unscheduled law.

Position. ``v_ref = K_p (P_ref - P) + v_ff`` in N-E, limited in length; velocity controller; acceleration feedforward
``theta = -a_x / g``, ``phi = a_y / g``; tilt limited in length, the excess fed to the controller's anti-windup; at last
the tilt is rotated by the heading. The thesis rotates the velocity errors into body axes instead (Fig. 6.9). At a
constant heading both are equal, since the controller treats both directions alike. In N-E, however, the integrators
hold the wind, which does not turn with the fuselage, and climb does not leak into the horizontal axes.

Gains are NumPy records, padded with zero states to a fixed order: the compiled law is the same for every vehicle, and
Numba reads ``gains.F`` as fast as a C struct. Units are SI and radians, motor inputs 0..1 as (upper, lower), servo
inputs -1..1. The states of the law are flat arrays. That of heave-yaw holds the controller's states, the filtered
references, the origins of height and heading, the filtered battery voltage, and the rounding errors.

The law starts bumplessly from any actuator state. The controller's first state gives the present input as output and
moves least from there: least squares of ``(I - A) x - B e`` subject to ``C x + D e = output``. The slow modes then hold
the offset. That state is linear in ``e`` and the output: the gains hold its matrices, ``x = E e + U output``.

The same code runs on board in C (:mod:`mufly.firmware`), equal to the last bit: sums keep their order.
"""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import sine_cosine
from mufly.control.implementation import DiscreteController
from mufly.control.linear_systems import Array
from mufly.errors import MuflyError


@cached_njit
def _clip_value(value: float, low: float, high: float) -> float:
    # Written out because min and max of equal or missing numbers differ between languages (docs/reference/firmware.md).
    if value < low:
        return low
    if value > high:
        return high
    return value


@cached_njit
def _add_with_rounding_error(value: float, change: float, dropped: float) -> tuple[float, float]:
    """Return the sum of ``value`` and ``change``, and its rounding error.

    The caller passes the rounding error as ``dropped`` in the next addition.
    """
    more = change + dropped
    total = value + more
    return total, more - (total - value)


@cached_njit
def _compute_output(g: Any, x: Array, e: Array, u: Array) -> None:
    for i in range(u.shape[0]):
        s = 0.0
        for j in range(g.F.shape[0]):
            s += g.C[i, j] * x[j]
        for j in range(e.shape[0]):
            s += g.D[i, j] * e[j]
        u[i] = s


@cached_njit
def _add_scheduled_output(g: Any, x: Array, e: Array, speed: float, u: Array) -> None:
    """Add the outputs for forward flight to ``u``, weighted by the squared speed (at most 1); nothing at speed NaN."""
    share = g.schedule * (speed * speed)
    if not share > 0.0:
        return
    share = 1.0 if share > 1.0 else share
    for i in range(u.shape[0]):
        s = 0.0
        for j in range(g.F.shape[0]):
            s += g.C_forward_change[i, j] * x[j]
        for j in range(e.shape[0]):
            s += g.D_forward_change[i, j] * e[j]
        u[i] += share * s


@cached_njit
def _controller_state_change(g: Any, i: int, x: Array, e: Array, excess: Array) -> float:
    """Return the change of the state ``x[i]`` in one period; ``excess`` is saturated minus demanded output."""
    s = 0.0
    for j in range(g.F.shape[0]):
        s += g.F[i, j] * x[j]
    for j in range(e.shape[0]):
        s += g.B[i, j] * e[j]
    for j in range(excess.shape[0]):
        s += g.M[i, j] * excess[j]
    return s


@cached_njit
def _write_next_state(g: Any, x: Array, e: Array, excess: Array, new: Array) -> None:
    for i in range(g.F.shape[0]):
        new[i] = x[i] + _controller_state_change(g, i, x, e, excess)


@cached_njit
def _filter_reference(
    value: float,
    dropped: float,
    rate: float,
    target: float,
    target_rate: float,
    bandwidth: float,
    acceleration: float,
    speed: float,
    period: float,
) -> tuple[float, float, float]:
    """Advance the reference filter by one period; return its value, rounding error and rate.

    The filter is critically damped near the target, and follows a braking parabola far from it.
    """
    gap = target - value
    # Speed from which half the acceleration brakes in time; linear near the target.
    braking, slope = 0.5 * acceleration, 0.5 * bandwidth
    linear = braking / (slope * slope)
    wanted = slope * gap
    if abs(gap) > linear:
        wanted = math.copysign(math.sqrt(2.0 * braking * (abs(gap) - 0.5 * linear)), gap)
    wanted = _clip_value(wanted + target_rate, -speed, speed)
    rate += period * _clip_value(2.0 * bandwidth * (wanted - rate), -acceleration, acceleration)
    value, dropped = _add_with_rounding_error(value, period * rate, dropped)
    return value, dropped, rate


@cached_njit
def _limit_lead_rate(rate: float, whole: float) -> float:
    """Clip ``rate`` to the interval between zero and ``whole``, which may be negative."""
    if whole > 0.0:
        return _clip_value(rate, 0.0, whole)
    return _clip_value(rate, whole, 0.0)


@cached_njit
def heave_yaw_init(gains: Any, measurement: Array, motor_input: Array, voltage: float) -> Array:
    """Return the state with which the heave-yaw controller starts without a jump of the motor inputs.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS_DTYPE``
    measurement : (3,) array
        Present z (m), psi (rad), r (rad/s); the references start from there.
    motor_input : (2,) array
        Present inputs of the upper and lower motor (0..1), for example on the ground.
    voltage : float
        Measured battery voltage (V).

    Returns
    -------
    (29,) array
        State for the first ``heave_yaw_step``; with the reference at the measurement its output is ``motor_input``.
    """
    believed = _clip_value(voltage, 0.5 * gains.design_voltage, 1.5 * gains.design_voltage)
    e, output, state = np.zeros(5), np.empty(2), np.zeros(HEAVE_YAW_STATE_SIZE)
    e[-1] = -measurement[2]
    for i in range(2):  # lower, upper
        output[i] = motor_input[1 - i] * believed / gains.design_voltage - gains.trim[i]
    _initialise_state(gains, e, output, state)
    state[FILTERED_Z_INDEX], state[FILTERED_W_INDEX], state[FILTERED_PSI_INDEX], state[FILTERED_R_INDEX] = (
        measurement[0],
        0.0,
        measurement[1],
        0.0,
    )
    state[CONTROLLER_ORIGIN_Z_INDEX], state[CONTROLLER_ORIGIN_PSI_INDEX], state[FILTERED_VOLTAGE_INDEX] = (
        measurement[0],
        measurement[1],
        believed,
    )
    return state


@cached_njit
def limit_heave_reference(gains: Any, state: Array, z: float) -> Array:
    """Limit the height reference in flight to a distance (slack, m) from the height ``z``; return the new heave-yaw
    state.

    The slack is the permitted distance of the reference from the height. The permitted speed of the reference falls
    with this distance and is zero at the slack. The reference brakes by twice the acceleration that the filter may add
    in the same period, so its net deceleration is that of any stop. If the vehicle climbs more slowly, the reference
    settles at the vehicle's speed.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS_DTYPE``
    state : (29,) array
        State from ``heave_yaw_init`` or the previous step; not changed.
    z : float
        Measured height z (m, down).

    Returns
    -------
    (29,) array
    """
    trails = z - state[FILTERED_Z_INDEX]
    left = 1.0 - abs(trails) / gains.heave_tracking_error_limit
    fastest = gains.heave_speed * left if left > 0.0 else 0.0
    away = state[FILTERED_W_INDEX] if trails < 0.0 else -state[FILTERED_W_INDEX]
    if left >= 0.0 and away <= fastest:
        return state
    new = state.copy()
    if left < 0.0:
        new[FILTERED_Z_INDEX] = z - math.copysign(gains.heave_tracking_error_limit, trails)
        new[REFERENCE_ROUNDING_ERROR_Z_INDEX] = 0.0
    less = _clip_value(away - fastest, 0.0, 2.0 * gains.heave_acceleration * gains.period)
    new[FILTERED_W_INDEX] += -less if trails < 0.0 else less
    return new


@cached_njit
def heave_yaw_step(
    gains: Any, state: Array, reference: Array, measurement: Array, voltage: float
) -> tuple[Array, Array]:
    """Run one period of the heave-yaw controller; return the motor inputs and the new state.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS_DTYPE``
    state : (29,) array
        State from ``heave_yaw_init`` or the previous call; not changed.
    reference : (4,) array
        z (m, down), psi (rad, continuous), and their rates (m/s, rad/s; zero is allowed).
    measurement : (3,) array
        z (m), psi (rad, continuous), r (rad/s).
    voltage : float
        Measured battery voltage (V).

    Returns
    -------
    motor_input : (2,) array
        Upper, lower; 0..1.
    state : (29,) array
    """
    z, psi, climb, turn = reference[0], reference[1], reference[2], reference[3]
    new = np.empty(HEAVE_YAW_STATE_SIZE)
    new[CONTROLLER_ORIGIN_Z_INDEX], new[CONTROLLER_ORIGIN_PSI_INDEX] = (
        state[CONTROLLER_ORIGIN_Z_INDEX],
        state[CONTROLLER_ORIGIN_PSI_INDEX],
    )
    new[FILTERED_Z_INDEX], new[REFERENCE_ROUNDING_ERROR_Z_INDEX], new[FILTERED_W_INDEX] = _filter_reference(
        state[FILTERED_Z_INDEX],
        state[REFERENCE_ROUNDING_ERROR_Z_INDEX],
        state[FILTERED_W_INDEX],
        z,
        climb,
        gains.heave_bandwidth,
        gains.heave_acceleration,
        gains.heave_speed,
        gains.period,
    )
    new[FILTERED_PSI_INDEX], new[REFERENCE_ROUNDING_ERROR_PSI_INDEX], new[FILTERED_R_INDEX] = _filter_reference(
        state[FILTERED_PSI_INDEX],
        state[REFERENCE_ROUNDING_ERROR_PSI_INDEX],
        state[FILTERED_R_INDEX],
        psi,
        turn,
        gains.yaw_bandwidth,
        gains.yaw_acceleration,
        gains.yaw_rate,
        gains.period,
    )
    # A reading far from the design voltage is a sensor fault.
    believed = _clip_value(voltage, 0.5 * gains.design_voltage, 1.5 * gains.design_voltage)
    new[FILTERED_VOLTAGE_INDEX] = state[FILTERED_VOLTAGE_INDEX] + gains.voltage_blend * (
        believed - state[FILTERED_VOLTAGE_INDEX]
    )
    top = new[FILTERED_VOLTAGE_INDEX] / gains.design_voltage

    e = np.empty(5)
    # Lead only on the reference's own rate: a bare step must not be sharpened.
    climb = _limit_lead_rate(new[FILTERED_W_INDEX], climb)
    turn = _limit_lead_rate(new[FILTERED_R_INDEX], turn)
    e[_ERROR_Z_INDEX] = new[FILTERED_Z_INDEX] + gains.heave_lead * climb - new[CONTROLLER_ORIGIN_Z_INDEX]
    e[_ERROR_PSI_INDEX] = new[FILTERED_PSI_INDEX] + gains.yaw_lead * turn - new[CONTROLLER_ORIGIN_PSI_INDEX]
    e[_MEASURED_Z_INDEX], e[_MEASURED_PSI_INDEX] = (
        new[CONTROLLER_ORIGIN_Z_INDEX] - measurement[0],
        new[CONTROLLER_ORIGIN_PSI_INDEX] - measurement[1],
    )
    e[_MEASURED_R_INDEX] = -measurement[2]
    u = np.empty(2)
    _compute_output(gains, state, e, u)
    lower, upper = gains.trim[0] + u[0], gains.trim[1] + u[1]
    half = _clip_value(0.5 * (upper - lower), -0.5 * top, 0.5 * top)
    mean = _clip_value(0.5 * (upper + lower), abs(half), top - abs(half))
    excess = np.empty(2)
    excess[0], excess[1] = mean - half - lower, mean + half - upper
    for i in range(HEAVE_YAW_ORDER):
        new[i], new[STATE_ROUNDING_ERRORS_START + i] = _add_with_rounding_error(
            state[i], _controller_state_change(gains, i, state, e, excess), state[STATE_ROUNDING_ERRORS_START + i]
        )
    motor_input = np.empty(2)
    # By rounding, top - |half| + |half| may exceed top.
    motor_input[0] = _clip_value((mean + half) / top, 0.0, 1.0)
    motor_input[1] = _clip_value((mean - half) / top, 0.0, 1.0)
    return motor_input, new


def position_init(gains: np.void) -> Array:
    """Return the state of the position cascade at rest.

    Returns
    -------
    (6,) array
    """
    return np.zeros(gains["F"].shape[0])


HEAVE_YAW_ORDER, ROLL_PITCH_ORDER, VELOCITY_ORDER = 10, 8, 6
_f8 = np.float64


def _matrix_fields(order: int, inputs: int, outputs: int) -> list[tuple[str, type, tuple[int, ...]]]:
    return [
        ("F", _f8, (order, order)),
        ("B", _f8, (order, inputs)),
        ("C", _f8, (outputs, order)),
        ("D", _f8, (outputs, inputs)),
        ("M", _f8, (order, outputs)),
        ("E", _f8, (order, inputs)),
        ("U", _f8, (order, outputs)),
    ]


GAIN_UNITS = {
    "trim": "1",  # heave-yaw: lower, upper, as fractions of the design voltage; roll-pitch: servo 1, servo 2
    "design_voltage": "V",
    "voltage_blend": "1",  # weight of a new voltage measurement in its filter
    "period": "s",
    "heave_bandwidth": "rad/s",  # of the reference filter
    "heave_acceleration": "m/s2",
    "heave_speed": "m/s",
    "heave_lead": "s",  # lead of the reference that compensates the loop's lag
    "heave_tracking_error_limit": "m",  # largest error of height before the filtered reference waits
    "yaw_bandwidth": "rad/s",
    "yaw_acceleration": "rad/s2",
    "yaw_rate": "rad/s",
    "yaw_lead": "s",
    "tilt_limit": "rad",
    "schedule": "s2/m2",  # inverse square of the scheduled speed; 0 without a schedule
    "position_gain": "1/s",
    "speed_limit": "m/s",
    "gravity": "m/s2",
}
"""Units of the gains other than matrices."""

_HEAVE_YAW_SCALAR_FIELDS = (
    "design_voltage", "voltage_blend", "period", "heave_bandwidth", "heave_acceleration", "heave_speed",
    "heave_lead", "heave_tracking_error_limit", "yaw_bandwidth", "yaw_acceleration", "yaw_rate", "yaw_lead",
)  # fmt: skip
HEAVE_YAW_GAINS_DTYPE = np.dtype(
    [
        *_matrix_fields(HEAVE_YAW_ORDER, 5, 2),
        ("trim", _f8, (2,)),
        *((name, _f8) for name in _HEAVE_YAW_SCALAR_FIELDS),
    ]
)
SCHEDULE_FIELDS = ("C_forward_change", "D_forward_change", "schedule")
"""Last fields of the roll-pitch gains, which the code on board has only for a scheduled design."""
ROLL_PITCH_GAINS_DTYPE = np.dtype(
    [
        *_matrix_fields(ROLL_PITCH_ORDER, 4, 2),
        ("trim", _f8, (2,)),
        ("tilt_limit", _f8),
        ("C_forward_change", _f8, (2, ROLL_PITCH_ORDER)),
        ("D_forward_change", _f8, (2, 4)),
        ("schedule", _f8),
    ]
)
POSITION_GAINS_DTYPE = np.dtype(
    [
        *_matrix_fields(VELOCITY_ORDER, 2, 2),
        *((name, _f8) for name in ("position_gain", "speed_limit", "tilt_limit", "gravity")),
    ]
)
# Indices in the heave-yaw state after the controller's states: filtered references, origins, filtered voltage, rounding
# errors of the controller's states and of the references.
(
    FILTERED_Z_INDEX,
    FILTERED_W_INDEX,
    FILTERED_PSI_INDEX,
    FILTERED_R_INDEX,
    CONTROLLER_ORIGIN_Z_INDEX,
    CONTROLLER_ORIGIN_PSI_INDEX,
    FILTERED_VOLTAGE_INDEX,
    STATE_ROUNDING_ERRORS_START,
) = range(HEAVE_YAW_ORDER, HEAVE_YAW_ORDER + 8)
_ERROR_Z_INDEX, _ERROR_PSI_INDEX, _MEASURED_Z_INDEX, _MEASURED_PSI_INDEX, _MEASURED_R_INDEX = range(
    5
)  # inputs of the heave-yaw controller
REFERENCE_ROUNDING_ERROR_Z_INDEX, REFERENCE_ROUNDING_ERROR_PSI_INDEX = (
    STATE_ROUNDING_ERRORS_START + HEAVE_YAW_ORDER,
    STATE_ROUNDING_ERRORS_START + HEAVE_YAW_ORDER + 1,
)
HEAVE_YAW_STATE_SIZE = REFERENCE_ROUNDING_ERROR_PSI_INDEX + 1


def pack_gains(dtype: np.dtype, controller: DiscreteController, **values: object) -> np.void:
    """Return the gains record of a controller; missing states up to the record's order are filled with zeros.

    Raises
    ------
    MuflyError
        If the controller has more states than the record holds, or other signals.
    """
    record = np.zeros((), dtype=dtype)
    order, inputs = record["B"].shape
    n = controller.order
    if n > order or controller.B.shape[1] != inputs:
        raise MuflyError(
            f"control law: a controller of order {n} with {controller.B.shape[1]} inputs does not fit a record of "
            f"order {order} with {inputs}; reduce it further"
        )
    record["F"] = -np.eye(order)
    record["F"][:n, :n] += controller.A
    record["B"][:n], record["C"][:, :n] = controller.B, controller.C
    record["D"], record["M"][:n] = controller.D, controller.M
    record["E"][:n], record["U"][:n] = _initial_state_gains(controller)
    for name, value in values.items():
        record[name] = value
    return cast(np.void, record[()])


def _initial_state_gains(controller: DiscreteController) -> tuple[Array, Array]:
    """Return the matrices E and U that give a controller's initial state ``E e + U output``.

    From this state the controller gives ``output`` at input ``e``, and the state changes least in the next period.

    Lagrange: ``G = I - A``, minimise |G x - B e|^2 subject to C x = output - D e::

        [G'G  C'] [x]   [G'B e         ]
        [C    0 ] [l] = [output - D e  ]
    """
    A, B, C, D = controller.A, controller.B, controller.C, controller.D
    n, m = A.shape[0], C.shape[0]
    G = np.eye(n) - A
    system = np.block([[G.T @ G, C.T], [C, np.zeros((m, m))]])
    solved = np.linalg.pinv(system, rcond=np.finfo(float).eps * (n + m))[:n]
    E: Array = solved[:, :n] @ G.T @ B - solved[:, n:] @ D
    return E, solved[:, n:]


@cached_njit
def _initialise_state(g: Any, e: Array, output: Array, x: Array) -> None:
    for i in range(g.F.shape[0]):
        s = 0.0
        for j in range(e.shape[0]):
            s += g.E[i, j] * e[j]
        for j in range(output.shape[0]):
            s += g.U[i, j] * output[j]
        x[i] = s


@cached_njit
def roll_pitch_init(gains: Any, measurement: Array) -> Array:
    """Return the initial state of the roll-pitch controller, which leaves the servos at trim for a level reference.

    Parameters
    ----------
    gains : record of type ``ROLL_PITCH_GAINS_DTYPE``
    measurement : (4,) array
        phi, theta (rad), p, q (rad/s).

    Returns
    -------
    (8,) array
    """
    e, state = np.empty(4), np.empty(ROLL_PITCH_ORDER)
    for i in range(4):
        e[i] = -measurement[i]
    _initialise_state(gains, e, np.zeros(2), state)
    return state


@cached_njit
def roll_pitch_step(gains: Any, state: Array, reference: Array, measurement: Array) -> tuple[Array, Array]:
    """Run one period of the roll-pitch controller; return the servo inputs and the new state.

    Parameters
    ----------
    gains : record of type ``ROLL_PITCH_GAINS_DTYPE``
    state : (8,) array
        State from ``roll_pitch_init`` or the previous call; not changed.
    reference : (2,) array
        phi, theta (rad).
    measurement : (4,) or (5,) array
        phi, theta (rad), p, q (rad/s); with a schedule also the forward speed (m/s).

    Returns
    -------
    servo_input : (2,) array
        Servo 1 (pitch), servo 2 (roll); -1..1.
    state : (8,) array
    """
    e = np.empty(4)
    for i in range(2):
        e[i] = _clip_value(reference[i], -gains.tilt_limit, gains.tilt_limit) - measurement[i]
        e[i + 2] = -measurement[i + 2]
    servo, excess, new = np.empty(2), np.empty(2), np.empty(ROLL_PITCH_ORDER)
    _compute_output(gains, state, e, servo)
    if gains.schedule > 0.0:
        _add_scheduled_output(gains, state, e, measurement[4], servo)
    for i in range(2):
        wanted = servo[i] + gains.trim[i]
        servo[i] = _clip_value(wanted, -1.0, 1.0)
        excess[i] = servo[i] - wanted
    _write_next_state(gains, state, e, excess, new)
    return servo, new


@cached_njit
def position_step(
    gains: Any,
    state: Array,
    position_reference: Array,
    velocity_reference: Array,
    acceleration_reference: Array,
    position: Array,
    velocity: Array,
    heading: float,
) -> tuple[Array, Array]:
    """Run one period of the position cascade; return the references of roll and pitch, and the new state.

    Parameters
    ----------
    gains : record of type ``POSITION_GAINS_DTYPE``
    state : (6,) array
        State from ``position_init`` or the previous call; not changed.
    position_reference, velocity_reference, acceleration_reference : (3,) array
        N, E, D (m, m/s, m/s2); zero velocity and acceleration mean no feedforward. D is not used.
    position, velocity : (3,) array
        Measured N, E, D (m, m/s).
    heading : float
        psi (rad).

    Returns
    -------
    tilt_reference : (2,) array
        phi, theta (rad).
    state : (6,) array

    Thesis: Fig. 6.9.
    """
    v_n = velocity_reference[0] + gains.position_gain * (position_reference[0] - position[0])
    v_e = velocity_reference[1] + gains.position_gain * (position_reference[1] - position[1])
    speed = math.sqrt(v_n * v_n + v_e * v_e)
    if speed > gains.speed_limit:
        v_n, v_e = v_n * gains.speed_limit / speed, v_e * gains.speed_limit / speed
    e, tilt, excess, new = np.empty(2), np.empty(2), np.empty(2), np.empty(VELOCITY_ORDER)
    e[0], e[1] = v_n - velocity[0], v_e - velocity[1]
    _compute_output(gains, state, e, tilt)
    phi = tilt[0] + acceleration_reference[1] / gains.gravity
    theta = tilt[1] - acceleration_reference[0] / gains.gravity
    size = math.sqrt(phi * phi + theta * theta)
    factor = gains.tilt_limit / size if size > gains.tilt_limit else 1.0
    excess[0], excess[1] = (factor - 1.0) * phi, (factor - 1.0) * theta
    sine, cosine = sine_cosine(heading)
    c, s = factor * cosine, factor * sine
    tilt[0], tilt[1] = c * phi + s * theta, c * theta - s * phi
    _write_next_state(gains, state, e, excess, new)
    return tilt, new
