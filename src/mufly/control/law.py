"""The control law that runs on board: pure functions of gains, state, reference and measurement, one call a period.

Each controller is ``u = C x + D e``, ``x+ = A x + B e + M (sat(u) - u)`` (:mod:`mufly.control.discretise`).

Heave-yaw. The reference passes a second-order filter whose acceleration and speed are limited to what the motors can
give, so that a step does not rail them. A reference that comes with its rate and stays within the limits passes
unchanged but for ``acceleration / bandwidth^2``, and is set ahead by its rate times the lag of the closed loop. The
command is a voltage, as a fraction of the design voltage: what the battery has left bounds it, ``[0, U/U_design]``, and
the motor input is command over that bound. Where both motors cannot have what they ask for, yaw goes first: the
difference of the two is kept, their mean gives way. Otherwise a rail in heave would spin the fuselage.

Where in flight the height trails the filtered reference by more than the slack (a blow, a fall, sticks beyond what the
motors give), the reference stays that far away, at rest, until the height has come back to it (``heave_wait``). A
greater error would ask the motors for more than they can take back in time: it swings between the rails for good. On
the floor the error may grow, which is what gets the motors going.

Roll-pitch. Tilt references are limited; servos saturate one by one.

Position. ``v_ref = K_p (P_ref - P) + v_ff`` in N-E, limited in length; velocity controller; acceleration feedforward
``theta = -a_x / g``, ``phi = a_y / g``; tilt limited in length, the excess given back to the controller; last the tilt
is turned by the heading. The thesis turns the velocity errors into body axes instead (Fig. 6.9). At a constant heading
that is the same, since the controller treats both directions alike; but here its integrators stay with the wind,
which does not turn with the fuselage, and climb does not leak into the horizontal axes.

Gains are records (:mod:`mufly.control.gains`), first states come from :mod:`mufly.control.engage`. Units SI and
radians, motor inputs 0..1 as (upper, lower), servo inputs -1..1.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mufly.control.gains import (
    HEAVE_YAW_STATE,
    ORIGIN_PSI,
    ORIGIN_Z,
    ROLL_PITCH_ORDER,
    SHAPED_PSI,
    SHAPED_R,
    SHAPED_W,
    SHAPED_Z,
    VELOCITY_ORDER,
    VOLTAGE,
)

__all__ = ["heave_wait", "heave_yaw_step", "position_step", "roll_pitch_step"]


@njit(cache=True)
def _clip(value, low, high):  # type: ignore[no-untyped-def]
    return min(max(value, low), high)


@njit(cache=True)
def _output(g, x, e, u):  # type: ignore[no-untyped-def]
    for i in range(u.shape[0]):
        s = 0.0
        for j in range(g.A.shape[0]):
            s += g.C[i, j] * x[j]
        for j in range(e.shape[0]):
            s += g.D[i, j] * e[j]
        u[i] = s


@njit(cache=True)
def _advance(g, x, e, excess, new):  # type: ignore[no-untyped-def]
    n = g.A.shape[0]
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += g.A[i, j] * x[j]
        for j in range(e.shape[0]):
            s += g.B[i, j] * e[j]
        for j in range(excess.shape[0]):
            s += g.M[i, j] * excess[j]
        new[i] = s


@njit(cache=True)
def _shape(value, rate, target, target_rate, bandwidth, acceleration, speed, period):  # type: ignore[no-untyped-def]
    """One step of the reference filter: critically damped near the target, on a braking parabola far from it."""
    gap = target - value
    # Speed at which half the acceleration still brakes in time; linear near the target.
    braking, slope = 0.5 * acceleration, 0.5 * bandwidth
    linear = braking / (slope * slope)
    wanted = slope * gap
    if abs(gap) > linear:
        wanted = math.copysign(math.sqrt(2.0 * braking * (abs(gap) - 0.5 * linear)), gap)
    wanted = _clip(wanted + target_rate, -speed, speed)
    rate += period * _clip(2.0 * bandwidth * (wanted - rate), -acceleration, acceleration)
    return value + period * rate, rate


@njit(cache=True)
def heave_wait(gains, state, z):  # type: ignore[no-untyped-def]
    """State of heave-yaw, in flight, with a filtered reference no further from the height z (m, down) than the slack.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS``
    state : (17,) array
        From ``heave_yaw_initial`` or the previous step; not changed.
    z : float
        Measured (m).

    Returns
    -------
    (17,) array
    """
    trails = z - state[SHAPED_Z]
    if abs(trails) <= gains.heave_slack:
        return state
    new = state.copy()
    new[SHAPED_Z], new[SHAPED_W] = z - math.copysign(gains.heave_slack, trails), 0.0
    return new


@njit(cache=True)
def heave_yaw_step(gains, state, reference, measurement, voltage):  # type: ignore[no-untyped-def]
    """One period of the heave-yaw controller.

    Parameters
    ----------
    gains : record of type ``HEAVE_YAW_GAINS``
    state : (17,) array
        From ``heave_yaw_initial`` or the previous call; not changed.
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
    state : (17,) array
    """
    new = np.empty(HEAVE_YAW_STATE)
    new[ORIGIN_Z], new[ORIGIN_PSI] = state[ORIGIN_Z], state[ORIGIN_PSI]
    new[SHAPED_Z], new[SHAPED_W] = _shape(
        state[SHAPED_Z],
        state[SHAPED_W],
        reference[0],
        reference[2],
        gains.heave_bandwidth,
        gains.heave_acceleration,
        gains.heave_speed,
        gains.period,
    )
    new[SHAPED_PSI], new[SHAPED_R] = _shape(
        state[SHAPED_PSI],
        state[SHAPED_R],
        reference[1],
        reference[3],
        gains.yaw_bandwidth,
        gains.yaw_acceleration,
        gains.yaw_rate,
        gains.period,
    )
    # A reading far off the design voltage is a fault of the sensor, not a battery.
    believed = _clip(voltage, 0.5 * gains.design_voltage, 1.5 * gains.design_voltage)
    new[VOLTAGE] = state[VOLTAGE] + gains.voltage_blend * (believed - state[VOLTAGE])
    top = new[VOLTAGE] / gains.design_voltage

    e = np.empty(5)
    # Lead only on the rate that the reference itself brings: a bare step must not be sharpened.
    climb = _clip(new[SHAPED_W], min(reference[2], 0.0), max(reference[2], 0.0))
    turn = _clip(new[SHAPED_R], min(reference[3], 0.0), max(reference[3], 0.0))
    e[0] = new[SHAPED_Z] + gains.heave_lead * climb - new[ORIGIN_Z]
    e[1] = new[SHAPED_PSI] + gains.yaw_lead * turn - new[ORIGIN_PSI]
    e[2], e[3], e[4] = new[ORIGIN_Z] - measurement[0], new[ORIGIN_PSI] - measurement[1], -measurement[2]
    u = np.empty(2)
    _output(gains, state, e, u)
    lower, upper = gains.trim[0] + u[0], gains.trim[1] + u[1]
    half = _clip(0.5 * (upper - lower), -0.5 * top, 0.5 * top)
    mean = _clip(0.5 * (upper + lower), abs(half), top - abs(half))
    excess = np.empty(2)
    excess[0], excess[1] = mean - half - lower, mean + half - upper
    _advance(gains, state, e, excess, new)
    motor_input = np.empty(2)
    # top - |half| + |half| may be a little more than top: rounding.
    motor_input[0] = _clip((mean + half) / top, 0.0, 1.0)
    motor_input[1] = _clip((mean - half) / top, 0.0, 1.0)
    return motor_input, new


@njit(cache=True)
def roll_pitch_step(gains, state, reference, measurement):  # type: ignore[no-untyped-def]
    """One period of the roll-pitch controller.

    Parameters
    ----------
    gains : record of type ``ROLL_PITCH_GAINS``
    state : (8,) array
        From ``roll_pitch_initial`` or the previous call; not changed.
    reference : (2,) array
        phi, theta (rad).
    measurement : (4,) array
        phi, theta (rad), p, q (rad/s).

    Returns
    -------
    servo_input : (2,) array
        Servo 1 (pitch), servo 2 (roll); -1..1.
    state : (8,) array
    """
    e = np.empty(4)
    for i in range(2):
        e[i] = _clip(reference[i], -gains.tilt_limit, gains.tilt_limit) - measurement[i]
        e[i + 2] = -measurement[i + 2]
    servo, excess, new = np.empty(2), np.empty(2), np.empty(ROLL_PITCH_ORDER)
    _output(gains, state, e, servo)
    for i in range(2):
        wanted = servo[i] + gains.trim[i]
        servo[i] = _clip(wanted, -1.0, 1.0)
        excess[i] = servo[i] - wanted
    _advance(gains, state, e, excess, new)
    return servo, new


@njit(cache=True)
def position_step(  # type: ignore[no-untyped-def]
    gains,
    state,
    position_reference,
    velocity_reference,
    acceleration_reference,
    position,
    velocity,
    heading,
):
    """One period of the position cascade: position P, velocity H-infinity, tilt references.

    Parameters
    ----------
    gains : record of type ``POSITION_GAINS``
    state : (6,) array
        From ``position_initial`` or the previous call; not changed.
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
    """
    v_n = velocity_reference[0] + gains.position_gain * (position_reference[0] - position[0])
    v_e = velocity_reference[1] + gains.position_gain * (position_reference[1] - position[1])
    speed = math.sqrt(v_n * v_n + v_e * v_e)
    if speed > gains.speed_limit:
        v_n, v_e = v_n * gains.speed_limit / speed, v_e * gains.speed_limit / speed
    e, tilt, excess, new = np.empty(2), np.empty(2), np.empty(2), np.empty(VELOCITY_ORDER)
    e[0], e[1] = v_n - velocity[0], v_e - velocity[1]
    _output(gains, state, e, tilt)
    phi = tilt[0] + acceleration_reference[1] / gains.gravity
    theta = tilt[1] - acceleration_reference[0] / gains.gravity
    size = math.sqrt(phi * phi + theta * theta)
    factor = gains.tilt_limit / size if size > gains.tilt_limit else 1.0
    excess[0], excess[1] = (factor - 1.0) * phi, (factor - 1.0) * theta
    c, s = factor * math.cos(heading), factor * math.sin(heading)
    tilt[0], tilt[1] = c * phi + s * theta, c * theta - s * phi
    _advance(gains, state, e, excess, new)
    return tilt, new
