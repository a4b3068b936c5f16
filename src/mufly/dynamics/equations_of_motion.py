"""Equations of motion of a coaxial micro helicopter.

Simulation, trim, linearisation, identification, estimation and code export all call :func:`state_derivative`. Source:
thesis chapter 4 and appendix A, with the corrections of docs/thesis/thesis-errata.md; derivations in
docs/explanation/dynamics.md.

Rigid body, N-E-D velocity ``v``, body rates ``W``, attitude ``A`` (body to N-E-D)::

    m dv/dt = A F + m g e_D                                   F, M in body axes
    I dW/dt = M - W x I W                                     (A.6)

Rotors, ``T = cT pi rho R^4 Omega^2`` and ``Q`` likewise (constants, or a map over speeds and climb, see below), with
thrust along the tilted disc normal ``n``::

    F = T_up n_up + H_up + T_dw n_dw + H_dw + fuselage drag
    M = sum r_i x (T_i n_i + H_i) + z_B [(Q_up + Jr_up dOmega_up) - (Q_dw + Jr_dw dOmega_dw)]          (A.8, 4.13)
    n_dw = (-sin b, cos b sin a, -cos a cos b)                a, b: tilt_roll, tilt_pitch
    n_up = mast + l_up * (component of the bar's normal across the mast), made unit

Swash plate: ``T_f,dw da/dt = l_dw theta_max servo_2 - a``, ``T_f,dw db/dt = l_dw theta_max servo_1 - b`` with the
sign that pitches the nose down for positive servo 1. Stabiliser bar: its normal ``s`` (N-E-D) follows the mast
axis ``u``: ``T_f,up ds/dt = u - (u.s) s``. Motors and battery: :mod:`mufly.drive`. Fuselage: downwash drag,
constant in flight (eq. 4.19) and fading with the thrust once that is below half the weight, and
``-rho/2 cD_i A_i |w_i| w_i`` along each body axis, ``w`` the velocity through the air (eq. 4.18).

Thrust and torque by constants (eqs 4.11, 4.12): ``T = cT pi rho R^4 Omega^2``, ``Q = cQ pi rho R^5 Omega |Omega|``.
With a map (recommended by Sec. 4.3.1 beyond 0.5 m/s) ``cT`` and ``cQ`` of each rotor are functions of

    mean speed (Omega_up + Omega_dw)/2,    Omega_dw / Omega_up,    climb velocity / (mean speed R)

with the climb velocity that of the mast through the air, along the mast.

Drag in the disc plane (H-force; linear in the edgewise velocity if that is small compared with the tip speed)::

    H = -cH rho pi R^3 |Omega| (w - n (n.w))         w = A^T (v - wind) + W x r, the hub's velocity through the air

It results from the velocity difference of advancing and retreating blade (blade elements in
docs/explanation/dynamics.md; Leishman 2006, Sec. 3.5 for the forces, Mahony, Kumar and Corke 2012 for the linear form).
It is always dissipative: ``H.w <= 0``.

Beyond its edges the map keeps the value at the edge. Thrust and torque therefore tend to zero with the speeds as
``Omega^2``, at any speed ratio.

Contact with the floor (D = 0): the contact points are the compliant legs and, after tipping over, the rim of the upper
rotor. A point at the depth ``d`` below the floor has a spring and a damper that only push, and Coulomb friction,
smoothed near rest so that the equations remain integrable::

    N = max(0, k d + c dd/dt)            F_t = -min(mu N / sqrt(v_t^2 + v_slip^2), c_t) v_t

Near rest friction is viscous, so a steady force ``F < mu N`` makes the vehicle creep at about ``v_slip F / (mu N)``.
The bound ``c_t`` keeps the viscous yaw mode ``sum(c_t r^2) / Izz`` slower than 2000 1/s, which steps of 1 ms resolve
even in a hard landing with many times the weight on a point.

The compliance includes legs and floor. Own derivation; the thesis has no ground model.

Ground effect, if the vehicle file enables it (``rotors.ground_effect``): the floor deflects a rotor's wake and
increases the thrust at the same speed and torque. Cheeseman and Bennett (ARC R&M 3021, 1955) use the image of a source
below the floor. With h the hub's height, V the air's velocity along the floor and v the induced velocity in hover,

    T / T_free = 1 / (1 - s),    s = (R / 4h)^2 / (1 + (V / v)^2),    v^2 = T_free / (2 rho pi R^2)

with the increment multiplied by ``rotors.ground_effect``. Each rotor has its own height and image. Below h = R/2, where
a source no longer represents a disc, the value at R/2 holds. A comparison with measured and computed curves is in
docs/log/2026-11-28-wake-single-rotors.md.

Edgewise flow, rate damping and the phase of the swash plate (``rotors.flight_map``, ``swash_plate.phase``):
:mod:`mufly.dynamics.edgewise_loads`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.drive.drive_train import armature_current, interpolate_table, rotor_acceleration, terminal_voltage
from mufly.dynamics.edgewise_loads import add_swash_phase_effect, find_map_coordinates, flight_map_loads
from mufly.dynamics.model_state import (
    ATTITUDE_SLICE,
    MODEL_ATTITUDE,
    MODEL_BAR_NORMAL,
    MODEL_CHARGE,
    MODEL_POSITION,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    U_MOTOR_LOWER,
    U_MOTOR_UPPER,
    U_SERVO_1,
    U_SERVO_2,
    ModelParameters,
    body_to_ned_matrix,
    initial_state,
    rotation_entries,
)
from mufly.quantities.units import GRAVITY
from mufly.rotor.coax_maps import interpolate_coefficient_tables as maps_interpolate
from mufly.rotor.coax_maps import interpolate_map
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]


@cached_njit(error_model="numpy")
def _clip_value(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@cached_njit(error_model="numpy")
def compute_battery_supply(x: _Array, motor_up: float, motor_dw: float, p: ModelParameters) -> tuple[float, float]:
    """Return terminal voltage (V) and supply current (A) for motor inputs 0..1 at state ``x``."""
    emf = p.kE * p.gear_ratio
    conductance = (motor_up * motor_up + motor_dw * motor_dw) / p.R_ohm
    source = (motor_up * emf * x[MODEL_SPEED_UPPER] + motor_dw * emf * x[MODEL_SPEED_LOWER]) / p.R_ohm
    open_circuit = interpolate_table(p.battery_curve, x[MODEL_CHARGE])
    voltage = terminal_voltage(open_circuit, p.battery_resistance, conductance, source, p.electronics_current)
    return voltage, p.electronics_current + conductance * voltage - source


@cached_njit(error_model="numpy")
def _inplane_drag(
    nx: float,
    ny: float,
    nz: float,
    air_x: float,
    air_y: float,
    air_z: float,
    p: float,
    q: float,
    z: float,
    slope: float,
) -> tuple[float, float, float]:
    """Return the drag of a rotor in its disc plane (N, body axes).

    Arguments are unit normal, air velocity (m/s), body rates (rad/s), hub position (m) and drag coefficient (N s/m).
    """
    slope = abs(slope)
    x, y = air_x + q * z, air_y - p * z
    along = nx * x + ny * y + nz * air_z
    return slope * (along * nx - x), slope * (along * ny - y), slope * (along * nz - air_z)


@cached_njit(error_model="numpy", forceinline=True)
def state_derivative(x: _Array, u: _Array, wind: _Array, p: ModelParameters, dx: _Array) -> None:
    """Write the time derivative of the state into ``dx``.

    Parameters
    ----------
    x : (21,) array
        State, see :mod:`mufly.dynamics.model_state`.
    u : (4,) array
        Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1); saturated here.
    wind : (3,) array
        Velocity of the air, N-E-D (m/s).
    p : record of :class:`ModelParameters`
    dx : (21,) array
        Output: dx/dt.

    Thesis: eqs 4.5 to 4.10, 4.13 to 4.23, 4.31.
    """
    ratio = climb = edge = 0.0
    # The place in the map comes first, so that a processor does the rest while it waits for the division.
    if p.flight_map_node_count > 0:
        ratio, climb, edge = find_map_coordinates(x, wind, p)
    a, b = x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH]
    sin_a, cos_a, sin_b, cos_b = math.sin(a), math.cos(a), math.sin(b), math.cos(b)
    _derivative_with_map(x, u, wind, p, sin_a, cos_a, sin_b, cos_b, True, True, (ratio, climb, edge), dx)
    if p.ground_effect > 0.0:
        _add_ground_effect(x, wind, p, dx)
    if p.swash_phase != 0.0:
        add_swash_phase_effect(u, p, dx)


# Inlining is forced: with a map LLVM would not inline the function, which slows single flights by a tenth.
@cached_njit(error_model="numpy", forceinline=True)
def state_derivative_from_tilt_sines(
    x: _Array,
    u: _Array,
    wind: _Array,
    p: ModelParameters,
    sin_a: float,
    cos_a: float,
    sin_b: float,
    cos_b: float,
    floor: bool,
    dx: _Array,
) -> None:
    """Compute :func:`state_derivative` with given sine and cosine of the swash plate's tilt about x and y.

    On-board code uses those of :mod:`mufly.compiled.portable_math`. Without ``floor`` ground contact is left out.
    """
    _derivative_with_map(x, u, wind, p, sin_a, cos_a, sin_b, cos_b, floor, False, (0.0, 0.0, 0.0), dx)


@cached_njit(error_model="numpy", forceinline=True)
def _derivative_with_map(
    x: _Array, u: _Array, wind: _Array, p: ModelParameters, sin_a: float, cos_a: float, sin_b: float, cos_b: float,
    floor: bool, mapped: bool, point: tuple[float, float, float], dx: _Array,
) -> None:  # fmt: skip
    """Compute :func:`state_derivative_from_tilt_sines`; if ``mapped``, with the loads of the vehicle's flight map.

    ``point`` is from :func:`mufly.dynamics.edgewise_loads.find_map_coordinates`. The estimator's function has no map:
    the compiler removes it.
    """
    # Called first, because a later call would spill the registers. The speeds are read twice: a local variable from
    # here on costs 3 % of a step.
    kT_up, kT_dw, kQ_up, kQ_dw = p.thrust_up, p.thrust_dw, p.torque_up, p.torque_dw
    if p.map_node_count > 0:
        kT_up, kT_dw, kQ_up, kQ_dw = interpolate_coefficient_map(
            x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER], compute_axial_climb_velocity(x, wind), p
        )
    motor_up, motor_dw = _clip_value(u[U_MOTOR_UPPER], 0.0, 1.0), _clip_value(u[U_MOTOR_LOWER], 0.0, 1.0)
    servo_1, servo_2 = _clip_value(u[U_SERVO_1], -1.0, 1.0), _clip_value(u[U_SERVO_2], -1.0, 1.0)
    qw, qx, qy, qz = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    wx, wy, wz = x[MODEL_RATES], x[MODEL_RATES + 1], x[MODEL_RATES + 2]
    alpha, beta = x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH]
    bar_n, bar_e, bar_d = x[MODEL_BAR_NORMAL], x[MODEL_BAR_NORMAL + 1], x[MODEL_BAR_NORMAL + 2]
    speed_up, speed_dw = x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER]

    # Attitude: columns are the body axes in N-E-D.
    a00, a01, a02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    a10, a11, a12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    a20, a21, a22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)

    # Motors and battery.
    voltage, supply_current = compute_battery_supply(x, motor_up, motor_dw, p)
    drag_up, drag_dw = kQ_up * speed_up * abs(speed_up), kQ_dw * speed_dw * abs(speed_dw)

    # Thrust directions. Lower rotor: tilted by the swash plate.
    thrust_dw = kT_dw * speed_dw * speed_dw
    # Upper rotor: tilted against the mast as the bar's disc is, times l_up.
    nx = p.bar_gain * (a00 * bar_n + a10 * bar_e + a20 * bar_d)
    ny = p.bar_gain * (a01 * bar_n + a11 * bar_e + a21 * bar_d)
    nz = -math.sqrt(max(1.0 - nx * nx - ny * ny, 0.0))
    thrust_up = kT_up * speed_up * speed_up

    # Fuselage: velocity through the air in body axes.
    air_n, air_e, air_d = x[MODEL_VELOCITY] - wind[0], x[MODEL_VELOCITY + 1] - wind[1], x[MODEL_VELOCITY + 2] - wind[2]
    air_x = a00 * air_n + a10 * air_e + a20 * air_d
    air_y = a01 * air_n + a11 * air_e + a21 * air_d
    air_z = a02 * air_n + a12 * air_e + a22 * air_d
    lift_up, lift_dw = thrust_up, thrust_dw
    ux = uy = lx = ly = hub_x = hub_y = 0.0
    if p.flight_map_node_count > 0 and mapped:
        ux, uy, lx, ly, hub_x, hub_y, more_up, more_dw, torque_up, torque_dw = flight_map_loads(
            x, (air_x, air_y), point, p
        )
        lift_up, lift_dw = more_up * thrust_up, more_dw * thrust_dw
        drag_up, drag_dw = torque_up * drag_up, torque_dw * drag_dw
    current_up = armature_current(motor_up, voltage, speed_up, p.kE, p.R_ohm, p.gear_ratio)
    current_dw = armature_current(motor_dw, voltage, speed_dw, p.kE, p.R_ohm, p.gear_ratio)
    accel_up = rotor_acceleration(
        current_up, speed_up, drag_up, p.kM, p.dR, p.Mf, p.gear_ratio, p.gear_efficiency, p.J_up
    )
    accel_dw = rotor_acceleration(
        current_dw, speed_dw, drag_dw, p.kM, p.dR, p.Mf, p.gear_ratio, p.gear_efficiency, p.J_dw
    )
    fx_dw = -sin_b * lift_dw
    fy_dw = cos_b * sin_a * lift_dw
    fz_dw = -cos_a * cos_b * lift_dw
    fx_up = nx * lift_up
    fy_up = ny * lift_up
    fz_up = nz * lift_up
    if p.inplane > 0.0:
        h_x, h_y, h_z = _inplane_drag(nx, ny, nz, air_x, air_y, air_z, wx, wy, p.z_up, p.inplane * speed_up)
        fx_up, fy_up, fz_up = fx_up + h_x, fy_up + h_y, fz_up + h_z
        nx, ny, nz = -sin_b, cos_b * sin_a, -cos_a * cos_b
        h_x, h_y, h_z = _inplane_drag(nx, ny, nz, air_x, air_y, air_z, wx, wy, p.z_dw, p.inplane * speed_dw)
        fx_dw, fy_dw, fz_dw = fx_dw + h_x, fy_dw + h_y, fz_dw + h_z
    if p.flight_map_node_count > 0 and mapped:
        fx_up, fy_up, fx_dw, fy_dw = fx_up + ux, fy_up + uy, fx_dw + lx, fy_dw + ly
    fx = fx_up + fx_dw - p.drag_over_speed2_x * abs(air_x) * air_x
    fy = fy_up + fy_dw - p.drag_over_speed2_y * abs(air_y) * air_y
    # Without thrust there is no downwash: a helicopter at rest or on its side has no downwash drag.
    downwash = p.downwash_drag * min(1.0, 2.0 * (thrust_up + thrust_dw) / (p.mass * GRAVITY))
    fz = fz_up + fz_dw - p.drag_over_speed2_z * abs(air_z) * air_z + downwash

    mx = -p.z_up * fy_up - p.z_dw * fy_dw
    my = p.z_up * fx_up + p.z_dw * fx_dw
    if p.flight_map_node_count > 0 and mapped:
        mx, my = mx + hub_x, my + hub_y
    mz = (drag_up + p.Jreact_up * accel_up) - (drag_dw + p.Jreact_dw * accel_dw)

    f_n = a00 * fx + a01 * fy + a02 * fz
    f_e = a10 * fx + a11 * fy + a12 * fz
    f_d = a20 * fx + a21 * fy + a22 * fz
    if floor and x[MODEL_POSITION + 2] + p.contact_reach > 0.0:
        c_n, c_e, c_d, c_mx, c_my, c_mz = contact_wrench(x, p)
        f_n += c_n
        f_e += c_e
        f_d += c_d
        mx += c_mx
        my += c_my
        mz += c_mz

    dx[MODEL_POSITION], dx[MODEL_POSITION + 1], dx[MODEL_POSITION + 2] = (
        x[MODEL_VELOCITY],
        x[MODEL_VELOCITY + 1],
        x[MODEL_VELOCITY + 2],
    )
    dx[MODEL_VELOCITY], dx[MODEL_VELOCITY + 1], dx[MODEL_VELOCITY + 2] = (
        f_n / p.mass,
        f_e / p.mass,
        f_d / p.mass + GRAVITY,
    )
    dx[MODEL_ATTITUDE] = 0.5 * (-qx * wx - qy * wy - qz * wz)
    dx[MODEL_ATTITUDE + 1] = 0.5 * (qw * wx + qy * wz - qz * wy)
    dx[MODEL_ATTITUDE + 2] = 0.5 * (qw * wy - qx * wz + qz * wx)
    dx[MODEL_ATTITUDE + 3] = 0.5 * (qw * wz + qx * wy - qy * wx)
    dx[MODEL_RATES] = (mx - (p.Izz - p.Iyy) * wy * wz) / p.Ixx
    dx[MODEL_RATES + 1] = (my - (p.Ixx - p.Izz) * wz * wx) / p.Iyy
    dx[MODEL_RATES + 2] = (mz - (p.Iyy - p.Ixx) * wx * wy) / p.Izz
    # z_dw < 0: the tilt that pitches the nose down is negative in beta.
    dx[MODEL_SWASH_ROLL] = p.swash_rate * (p.swash_gain * servo_2 - alpha)
    dx[MODEL_SWASH_PITCH] = p.swash_rate * (-p.swash_gain * servo_1 - beta)
    along = -(a02 * bar_n + a12 * bar_e + a22 * bar_d)
    dx[MODEL_BAR_NORMAL] = p.bar_rate * (-a02 - along * bar_n)
    dx[MODEL_BAR_NORMAL + 1] = p.bar_rate * (-a12 - along * bar_e)
    dx[MODEL_BAR_NORMAL + 2] = p.bar_rate * (-a22 - along * bar_d)
    dx[MODEL_SPEED_UPPER], dx[MODEL_SPEED_LOWER] = accel_up, accel_dw
    dx[MODEL_CHARGE] = -supply_current / p.battery_capacity


_MIN_GROUND_HEIGHT_RATIO = 0.5  # least height over R in the ground effect model


@cached_njit(error_model="numpy")
def ground_effect_thrust_increment(thrust: float, height: float, across_squared: float, p: ModelParameters) -> float:
    """Return the thrust increment (N) due to the floor at a hub height (m) and squared air velocity along the floor."""
    if thrust <= 0.0:
        return 0.0
    near = 0.25 * p.ground_radius / max(height, _MIN_GROUND_HEIGHT_RATIO * p.ground_radius)
    induced_squared = thrust / p.ground_thrust_over_induced_speed2
    s = near * near * induced_squared / (induced_squared + across_squared)
    return p.ground_effect * thrust * s / (1.0 - s)


@cached_njit(error_model="numpy")
def _add_ground_effect(x: _Array, wind: _Array, p: ModelParameters, dx: _Array) -> None:
    """Add the accelerations by the ground effect on the rotors' thrust to the derivative ``dx``; see the module
    docstring.
    """
    speed_up, speed_dw, height = x[MODEL_SPEED_UPPER], x[MODEL_SPEED_LOWER], -x[MODEL_POSITION + 2]
    kT_up, kT_dw = p.thrust_up, p.thrust_dw
    if p.map_node_count > 0:
        kT_up, kT_dw, _, _ = interpolate_coefficient_map(speed_up, speed_dw, compute_axial_climb_velocity(x, wind), p)
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = rotation_entries(
        x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    )
    v_n, v_e = x[MODEL_VELOCITY] - wind[0], x[MODEL_VELOCITY + 1] - wind[1]
    across = v_n * v_n + v_e * v_e
    up = ground_effect_thrust_increment(kT_up * speed_up * speed_up, height - a22 * p.z_up, across, p)
    dw = ground_effect_thrust_increment(kT_dw * speed_dw * speed_dw, height - a22 * p.z_dw, across, p)
    nx = p.bar_gain * (a00 * x[MODEL_BAR_NORMAL] + a10 * x[MODEL_BAR_NORMAL + 1] + a20 * x[MODEL_BAR_NORMAL + 2])
    ny = p.bar_gain * (a01 * x[MODEL_BAR_NORMAL] + a11 * x[MODEL_BAR_NORMAL + 1] + a21 * x[MODEL_BAR_NORMAL + 2])
    alpha, beta = x[MODEL_SWASH_ROLL], x[MODEL_SWASH_PITCH]
    sin_b, cos_b = math.sin(beta), math.cos(beta)
    fx_up, fy_up, fz_up = up * nx, up * ny, -up * math.sqrt(max(1.0 - nx * nx - ny * ny, 0.0))
    fx_dw, fy_dw, fz_dw = -dw * sin_b, dw * cos_b * math.sin(alpha), -dw * cos_b * math.cos(alpha)
    fx, fy, fz = fx_up + fx_dw, fy_up + fy_dw, fz_up + fz_dw
    dx[MODEL_VELOCITY] += (a00 * fx + a01 * fy + a02 * fz) / p.mass
    dx[MODEL_VELOCITY + 1] += (a10 * fx + a11 * fy + a12 * fz) / p.mass
    dx[MODEL_VELOCITY + 2] += (a20 * fx + a21 * fy + a22 * fz) / p.mass
    dx[MODEL_RATES] -= (p.z_up * fy_up + p.z_dw * fy_dw) / p.Ixx
    dx[MODEL_RATES + 1] += (p.z_up * fx_up + p.z_dw * fx_dw) / p.Iyy


_MIN_ROTOR_SPEED_RAD_S = 1e-3  # rad/s; below this speed rotor forces are negligible


@cached_njit(error_model="numpy")
def compute_axial_climb_velocity(x: _Array, wind: _Array) -> float:
    """Return the velocity through the air along the mast, positive upwards (m/s), at state ``x``."""
    qw, qx, qy, qz = x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    up_n, up_e, up_d = -2 * (qx * qz + qw * qy), -2 * (qy * qz - qw * qx), 2 * (qx * qx + qy * qy) - 1
    return (
        up_n * (x[MODEL_VELOCITY] - wind[0])
        + up_e * (x[MODEL_VELOCITY + 1] - wind[1])
        + up_d * (x[MODEL_VELOCITY + 2] - wind[2])
    )


@cached_njit(error_model="numpy")
def interpolate_coefficient_map(
    speed_up: float, speed_dw: float, climb: float, p: ModelParameters
) -> tuple[float, float, float, float]:
    """Interpolate thrust and torque over squared speed of both rotors in the coefficient map.

    The results are thrust over squared speed (N s^2) of upper and lower rotor, then torque over squared speed (N m
    s^2).
    """
    up, dw = abs(speed_up), abs(speed_dw)
    mean = 0.5 * (up + dw)
    ratio = dw / max(up, _MIN_ROTOR_SPEED_RAD_S)
    climb_ratio = climb / (max(mean, _MIN_ROTOR_SPEED_RAD_S) * p.map_radius)
    t_up, q_up, t_dw, q_dw = maps_interpolate(
        p.thrust_over_speed2_table_up, p.torque_over_speed2_table_up,
        p.thrust_over_speed2_table_dw, p.torque_over_speed2_table_dw,
        p.map_size, p.map_start, p.map_inverse_steps, mean, ratio, climb_ratio,
    )  # fmt: skip
    return t_up, t_dw, q_up, q_dw


def rotor_loads(p: np.void, speed_up: float, speed_dw: float, climb: float = 0.0) -> tuple[float, ...]:
    """Return thrust (N) of upper and lower rotor, then torque (N m) of upper and lower rotor, by the flight model.

    Parameters
    ----------
    p : record of :class:`ModelParameters`
    speed_up, speed_dw : float
        Rotor speeds (rad/s).
    climb : float
        Velocity through the air along the mast, positive upwards (m/s).
    """
    c = (p["thrust_up"], p["thrust_dw"], p["torque_up"], p["torque_dw"])
    if p["map_node_count"] > 0:
        c = interpolate_coefficient_map(speed_up, speed_dw, climb, p)
    thrust_up, thrust_dw, torque_up, torque_dw = c
    up, dw = speed_up * abs(speed_up), speed_dw * abs(speed_dw)
    return float(thrust_up * speed_up**2), float(thrust_dw * speed_dw**2), float(torque_up * up), float(torque_dw * dw)


def is_inside_coefficient_map(vehicle: Vehicle, speed_up: float, speed_dw: float, climb: float) -> bool:
    """Return True if a point lies within a vehicle's coefficient map, or there is no map.

    Parameters
    ----------
    vehicle : Vehicle
    speed_up, speed_dw, climb : float
        As for :func:`rotor_loads`.
    """
    m = vehicle.rotors.coefficient_map
    if m is None:
        return True
    mean = 0.5 * (abs(speed_up) + abs(speed_dw))
    tip = max(mean, _MIN_ROTOR_SPEED_RAD_S) * float(vehicle.rotors.radius)
    return not bool(
        interpolate_map(m, mean, abs(speed_dw) / max(abs(speed_up), _MIN_ROTOR_SPEED_RAD_S), climb / tip)[1]
    )


def bound_map_coefficient(p: np.void, name: str) -> tuple[float, float, float]:
    """Return upper bounds of a map coefficient, and of its load's slopes over rotor speed and climb velocity.

    With c over s (mean speed), r (ratio of the speeds) and m (climb ratio V / (s R)), thrust or torque is
    ``c Omega^2``. Its slope over the speed of either rotor is at most ``(2 |c| + s |dc/ds| + r |dc/dr| + m |dc/dm|)
    Omega``, and over the climb velocity ``|dc/dm| Omega^2 / (s R)``, at most ``2 |dc/dm| Omega / R``, because Omega is
    at most 2 s. Slopes of c are those between neighbouring points.

    Parameters
    ----------
    p : record of :class:`ModelParameters`
    name : str
        ``"thrust_up"``, ``"thrust_dw"``, ``"torque_up"`` or ``"torque_dw"``.

    Returns
    -------
    greatest, per_speed, per_climb : float
        Bounds of ``|c|``, of the slope over the rotor's own speed divided by ``Omega``, and of the slope over climb
        divided by ``Omega``.
    """
    n = int(p["map_node_count"])
    if n == 0:
        return float(p[name]), 2 * float(p[name]), 0.0
    what, side = name.split("_")
    table = p[f"{what}_over_speed2_table_{side}"][:n].reshape(p["map_size"])
    steps = np.array([1.0 / q if q > 0 else 0.0 for q in p["map_inverse_steps"]])
    last = p["map_start"] + (p["map_size"] - 1) * steps
    reach = np.maximum(np.abs(p["map_start"]), np.abs(last))
    slopes = [float(np.max(np.abs(np.diff(table, axis=k)), initial=0.0) * p["map_inverse_steps"][k]) for k in range(3)]
    greatest = float(np.max(np.abs(table)))
    return greatest, 2 * greatest + float(reach @ slopes), 2 * slopes[2] / float(p["map_radius"])


@cached_njit(error_model="numpy")
def contact_wrench(x: _Array, p: ModelParameters) -> tuple[float, float, float, float, float, float]:
    """Return the contact force of the floor (N-E-D, N) and its moment (body axes, N m) as six numbers."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = rotation_entries(
        x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    )
    f_n = f_e = f_d = m_x = m_y = m_z = 0.0
    for k in range(p.contact_count):
        rx, ry, rz = p.contact_points[k, 0], p.contact_points[k, 1], p.contact_points[k, 2]
        depth = x[MODEL_POSITION + 2] + a20 * rx + a21 * ry + a22 * rz
        if depth <= 0.0:
            continue
        # Velocity of the point: body v + W x r, in N-E-D.
        vx = x[MODEL_RATES + 1] * rz - x[MODEL_RATES + 2] * ry
        vy = x[MODEL_RATES + 2] * rx - x[MODEL_RATES] * rz
        vz = x[MODEL_RATES] * ry - x[MODEL_RATES + 1] * rx
        v_n = x[MODEL_VELOCITY] + a00 * vx + a01 * vy + a02 * vz
        v_e = x[MODEL_VELOCITY + 1] + a10 * vx + a11 * vy + a12 * vz
        v_d = x[MODEL_VELOCITY + 2] + a20 * vx + a21 * vy + a22 * vz
        normal = max(0.0, p.leg_stiffness * depth + p.leg_damping * v_d)
        rub = p.leg_friction * normal / math.sqrt(v_n * v_n + v_e * v_e + p.slip_speed * p.slip_speed)
        rub = min(rub, p.contact_friction_damping_limit[k])
        g_n, g_e, g_d = -rub * v_n, -rub * v_e, -normal
        f_n += g_n
        f_e += g_e
        f_d += g_d
        gx = a00 * g_n + a10 * g_e + a20 * g_d
        gy = a01 * g_n + a11 * g_e + a21 * g_d
        gz = a02 * g_n + a12 * g_e + a22 * g_d
        m_x += ry * gz - rz * gy
        m_y += rz * gx - rx * gz
        m_z += rx * gy - ry * gx
    return f_n, f_e, f_d, m_x, m_y, m_z


@cached_njit(error_model="numpy")
def find_deepest_contact(x: _Array, p: ModelParameters) -> tuple[float, int]:
    """Return depth below the floor (m; negative: above) and index of the lowest contact point."""
    a = body_to_ned_matrix(x[ATTITUDE_SLICE])
    depth, index = -math.inf, 0
    for k in range(p.contact_count):
        c = p.contact_points[k]
        d = x[MODEL_POSITION + 2] + a[2, 0] * c[0] + a[2, 1] * c[1] + a[2, 2] * c[2]
        if d > depth:
            depth, index = d, k
    return depth, index


def _standing_down_axis(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the downward direction in body axes (3,) of the standing vehicle: normal to the plane of the legs' tips.

    If the tips are not coplanar (to 0.01 mm), the supporting legs are undetermined, and the vehicle stands upright.
    """
    legs = vehicle.contact.legs.to_array()
    if np.ptp(legs[:, 2]) == 0.0:
        return np.array([0.0, 0.0, 1.0])
    normal = np.linalg.svd(legs - legs.mean(axis=0))[2][2]
    if np.ptp(legs @ normal) > 1e-5 or abs(normal[2]) < 0.5:
        return np.array([0.0, 0.0, 1.0])
    return np.asarray(normal * np.sign(normal[2]))


def standing_attitude(vehicle: Vehicle) -> tuple[float, float]:
    """Return roll and pitch (rad) of the vehicle standing on a level floor, which depend on unequal legs.

    ``n``, normal to the plane of the tips (body axes, down), points down. It is the third row of the rotation to N-E-D:
    ``n = (-sin theta, sin phi cos theta, cos phi cos theta)``. Own derivation.
    """
    n = _standing_down_axis(vehicle)
    return math.atan2(n[1], n[2]), -math.asin(n[0])


def standing_height(vehicle: Vehicle) -> float:
    """Return the height (m) of the centre of gravity when the vehicle stands still with its rotors at rest.

    The lowest legs share the weight equally.
    """
    z: NDArray[np.float64] = vehicle.contact.legs.to_array() @ _standing_down_axis(vehicle)
    lowest = float(z.max())
    carrying = int(np.sum(z > lowest - 1e-6))
    return lowest - float(vehicle.body.mass) * GRAVITY / (carrying * float(vehicle.contact.stiffness))


def standing_state(vehicle: Vehicle, north_east_m: tuple[float, float], heading_rad: float) -> NDArray[np.float64]:
    """Return the state (21,) in which the vehicle stands still on the floor with its rotors at rest."""
    return initial_state(
        position=(*north_east_m, -standing_height(vehicle)),
        attitude=(*standing_attitude(vehicle), heading_rad),
    )
