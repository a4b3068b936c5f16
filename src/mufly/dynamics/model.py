"""Equations of motion of a coaxial micro helicopter: the only place where they are written.

Simulation, trim, linearisation, identification, estimation and code export all call :func:`derivative`.
Source: thesis chapter 4 and appendix A, read as docs/thesis-errata.md says; derivations in docs/dynamics.md.

Rigid body, N-E-D velocity ``v``, body rates ``W``, attitude ``A`` (body to N-E-D)::

    m dv/dt = A F + m g e_D                                   F, M in body axes
    I dW/dt = M - W x I W                                     (A.6)

Rotors, ``T = cT pi rho R^4 Omega^2`` and ``Q`` alike (:mod:`mufly.dynamics.loads`: constants, or a map over speeds
and climb), thrust along the tilted disc normal ``n``::

    F = T_up n_up + T_dw n_dw + fuselage drag
    M = sum r_i x T_i n_i + z_B [(Q_up + Jr_up dOmega_up) - (Q_dw + Jr_dw dOmega_dw)]          (A.8, 4.13)
    n_dw = (-sin b, cos b sin a, -cos a cos b)                a, b: tilt_roll, tilt_pitch
    n_up = mast + l_up * (component of the bar's normal across the mast), made unit

Swash plate: ``T_f,dw da/dt = l_dw theta_max servo_2 - a``, ``T_f,dw db/dt = l_dw theta_max servo_1 - b`` with the
sign that pitches the nose down for positive servo 1. Stabiliser bar: its normal ``s`` (N-E-D) follows the mast
axis ``u``: ``T_f,up ds/dt = u - (u.s) s``. Motors and battery: :mod:`mufly.drive`. Fuselage: downwash drag,
constant in flight (eq. 4.19) and fading with the thrust once that is below half the weight, and
``-rho/2 cD_i A_i |w_i| w_i`` along each body axis, ``w`` the velocity through the air (eq. 4.18).
Floor: :mod:`mufly.dynamics.ground`.
"""

from __future__ import annotations

import math

from numba import njit

from mufly.drive.battery import interpolate, terminal_voltage
from mufly.drive.motor import armature_current, rotor_acceleration
from mufly.dynamics.ground import contact_wrench
from mufly.dynamics.loads import climb_velocity, map_coefficients
from mufly.dynamics.parameters import GRAVITY

__all__ = ["battery_state", "derivative"]


@njit(cache=True, error_model="numpy")
def _clip(value, low, high):  # type: ignore[no-untyped-def]
    return min(max(value, low), high)


@njit(cache=True, error_model="numpy")
def battery_state(x, motor_up, motor_dw, p):  # type: ignore[no-untyped-def]
    """Return terminal voltage (V) and supply current (A) for motor inputs 0..1 at state ``x``."""
    emf = p.kE * p.gear_ratio
    conductance = (motor_up * motor_up + motor_dw * motor_dw) / p.R_ohm
    source = (motor_up * emf * x[18] + motor_dw * emf * x[19]) / p.R_ohm
    voltage = terminal_voltage(
        interpolate(p.battery_curve, x[20]), p.battery_resistance, conductance, source, p.electronics_current
    )
    return voltage, p.electronics_current + conductance * voltage - source


# Inlined by force: with a map in it LLVM finds it too long, and single flights would slow down by a tenth.
@njit(cache=True, error_model="numpy", forceinline=True)
def derivative(x, u, wind, p, dx):  # type: ignore[no-untyped-def]
    """Write the time derivative of the state into ``dx``.

    Parameters
    ----------
    x : (21,) array
        State, see :mod:`mufly.dynamics.state`.
    u : (4,) array
        Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1); saturated here.
    wind : (3,) array
        Velocity of the air, N-E-D (m/s).
    p : record of type ``PARAMETERS``
    dx : (21,) array
        Overwritten with dx/dt.
    """
    # First of all, because what is in registers would not outlive the call.
    kT_up, kT_dw, kQ_up, kQ_dw = p.thrust_up, p.thrust_dw, p.torque_up, p.torque_dw
    if p.map_nodes > 0:
        kT_up, kT_dw, kQ_up, kQ_dw = map_coefficients(x[18], x[19], climb_velocity(x, wind), p)
    motor_up, motor_dw = _clip(u[0], 0.0, 1.0), _clip(u[1], 0.0, 1.0)
    servo_1, servo_2 = _clip(u[2], -1.0, 1.0), _clip(u[3], -1.0, 1.0)
    qw, qx, qy, qz = x[6], x[7], x[8], x[9]
    wx, wy, wz = x[10], x[11], x[12]
    alpha, beta = x[13], x[14]
    bar_n, bar_e, bar_d = x[15], x[16], x[17]
    speed_up, speed_dw = x[18], x[19]

    # Attitude: columns are the body axes in N-E-D.
    a00, a01, a02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    a10, a11, a12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    a20, a21, a22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)

    # Motors and battery.
    voltage, supply_current = battery_state(x, motor_up, motor_dw, p)
    drag_up, drag_dw = kQ_up * speed_up * abs(speed_up), kQ_dw * speed_dw * abs(speed_dw)
    current_up = armature_current(motor_up, voltage, speed_up, p.kE, p.R_ohm, p.gear_ratio)
    current_dw = armature_current(motor_dw, voltage, speed_dw, p.kE, p.R_ohm, p.gear_ratio)
    accel_up = rotor_acceleration(
        current_up, speed_up, drag_up, p.kM, p.dR, p.gear_ratio, p.gear_efficiency, p.J_up
    )
    accel_dw = rotor_acceleration(
        current_dw, speed_dw, drag_dw, p.kM, p.dR, p.gear_ratio, p.gear_efficiency, p.J_dw
    )

    # Thrust directions. Lower rotor: tilted by the swash plate.
    cos_b = math.cos(beta)
    thrust_dw = kT_dw * speed_dw * speed_dw
    fx_dw = -math.sin(beta) * thrust_dw
    fy_dw = cos_b * math.sin(alpha) * thrust_dw
    fz_dw = -math.cos(alpha) * cos_b * thrust_dw
    # Upper rotor: tilted against the mast as the bar's disc is, times l_up.
    nx = p.bar_gain * (a00 * bar_n + a10 * bar_e + a20 * bar_d)
    ny = p.bar_gain * (a01 * bar_n + a11 * bar_e + a21 * bar_d)
    thrust_up = kT_up * speed_up * speed_up
    fx_up = nx * thrust_up
    fy_up = ny * thrust_up
    fz_up = -math.sqrt(max(1.0 - nx * nx - ny * ny, 0.0)) * thrust_up

    # Fuselage: velocity through the air in body axes.
    air_n, air_e, air_d = x[3] - wind[0], x[4] - wind[1], x[5] - wind[2]
    air_x = a00 * air_n + a10 * air_e + a20 * air_d
    air_y = a01 * air_n + a11 * air_e + a21 * air_d
    air_z = a02 * air_n + a12 * air_e + a22 * air_d
    fx = fx_up + fx_dw - p.drag_x * abs(air_x) * air_x
    fy = fy_up + fy_dw - p.drag_y * abs(air_y) * air_y
    # No thrust, no downwash: a helicopter at rest or lying on its side is not pushed along.
    downwash = p.downwash * min(1.0, 2.0 * (thrust_up + thrust_dw) / (p.mass * GRAVITY))
    fz = fz_up + fz_dw - p.drag_z * abs(air_z) * air_z + downwash

    mx = -p.z_up * fy_up - p.z_dw * fy_dw
    my = p.z_up * fx_up + p.z_dw * fx_dw
    mz = (drag_up + p.Jreact_up * accel_up) - (drag_dw + p.Jreact_dw * accel_dw)

    f_n = a00 * fx + a01 * fy + a02 * fz
    f_e = a10 * fx + a11 * fy + a12 * fz
    f_d = a20 * fx + a21 * fy + a22 * fz
    if x[2] + p.contact_reach > 0.0:
        c_n, c_e, c_d, c_mx, c_my, c_mz = contact_wrench(x, p)
        f_n += c_n
        f_e += c_e
        f_d += c_d
        mx += c_mx
        my += c_my
        mz += c_mz

    dx[0], dx[1], dx[2] = x[3], x[4], x[5]
    dx[3], dx[4], dx[5] = f_n / p.mass, f_e / p.mass, f_d / p.mass + GRAVITY
    dx[6] = 0.5 * (-qx * wx - qy * wy - qz * wz)
    dx[7] = 0.5 * (qw * wx + qy * wz - qz * wy)
    dx[8] = 0.5 * (qw * wy - qx * wz + qz * wx)
    dx[9] = 0.5 * (qw * wz + qx * wy - qy * wx)
    dx[10] = (mx - (p.Izz - p.Iyy) * wy * wz) / p.Ixx
    dx[11] = (my - (p.Ixx - p.Izz) * wz * wx) / p.Iyy
    dx[12] = (mz - (p.Iyy - p.Ixx) * wx * wy) / p.Izz
    # z_dw < 0: the tilt that pitches the nose down is negative in beta.
    dx[13] = p.swash_rate * (p.swash_gain * servo_2 - alpha)
    dx[14] = p.swash_rate * (-p.swash_gain * servo_1 - beta)
    along = -(a02 * bar_n + a12 * bar_e + a22 * bar_d)
    dx[15] = p.bar_rate * (-a02 - along * bar_n)
    dx[16] = p.bar_rate * (-a12 - along * bar_e)
    dx[17] = p.bar_rate * (-a22 - along * bar_d)
    dx[18], dx[19] = accel_up, accel_dw
    dx[20] = -supply_current / p.battery_capacity
