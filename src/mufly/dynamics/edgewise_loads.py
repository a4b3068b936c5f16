"""Loads of a flight map in the equations of motion, and the phase of the swash plate.

:func:`mufly.dynamics.equations_of_motion.state_derivative` includes them.
:func:`~mufly.dynamics.equations_of_motion.state_derivative_from_tilt_sines`, which the estimator uses, contains
neither. State and inputs are unchanged.

Map. With w the velocity of a hub through the air, (w_x, w_y) its part across the mast, K = rho pi R^3 and Omega the
speed of the rotor, a rotor adds, in body axes (columns: :mod:`mufly.vehicle.flight_map`)

    F = K Omega [-(drag) w + (side_force) z x w + R (rate_force) (p, q) + R (rate_side) z x (p, q)] + thrust_excess T n

    M = K R Omega [(roll_moment) w + (pitch_moment) z x w + R (rate_damping) (p, q) + R (rate_coupling) z x (p, q)]

and the torque ``torque_excess Q``, with z x (a, b) = (-b, a). The linear drag ``rotors.inplane_drag`` is replaced.
Thrust T, torque Q and disc normal n are those of the flight model: in axial flow and in hover, thrust and torque are
unchanged. The table is entered with the mean edgewise velocity and the mean climb of both hubs.

The map is computed at zero cyclic pitch. A cyclic input causes only the identified tilt of the flight model: linkage,
time constant and flap frequency were identified together, so no hub moment of a cyclic input is added.

Phase. The tilt of the lower tip-path plane follows the input turned by ``swash_plate.phase`` along the rotation of the
lower rotor (clockwise from above):

    T_f,dw d(a, b)/dt = R(phase) l_dw theta_max (servo 2, -servo 1) - (a, b)
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.dynamics.model_state import (
    MODEL_ATTITUDE,
    MODEL_RATES,
    MODEL_SPEED_LOWER,
    MODEL_SPEED_UPPER,
    MODEL_SWASH_PITCH,
    MODEL_SWASH_ROLL,
    MODEL_VELOCITY,
    U_SERVO_1,
    U_SERVO_2,
    ModelParameters,
    rotation_entries,
)
from mufly.rotor.forward.edgewise_map import interpolate_flow_loads, interpolate_rate_loads

_Array = NDArray[np.float64]

_MIN_ROTOR_SPEED_RAD_S = 1e-3  # rad/s
_MAP_EDGE_TOLERANCE = 1e-6  # steps
(
    _THRUST_INDEX,
    _TORQUE_INDEX,
    _DRAG_INDEX,
    _SIDE_INDEX,
    _ROLL_MOMENT_INDEX,
    _PITCH_MOMENT_INDEX,
    _LOWER_THRUST_INDEX,
    _LOWER_TORQUE_INDEX,
    _LOWER_DRAG_INDEX,
) = range(9)
"""Indices of the flow's loads in :data:`mufly.vehicle.flight_map.ROTOR_LOAD_COLUMNS`, upper rotor first."""
_FIRST_LOWER_RATE_LOAD_INDEX = 4  # first load of rates of the lower rotor


MapWrench = tuple[float, float, float, float, float, float, float, float, float, float]


@cached_njit(error_model="numpy", forceinline=True)
def compute_airspeed_vector(x: _Array, wind: _Array) -> tuple[float, float, float]:
    """Return the velocity of the centre of gravity through the air, body axes (m/s)."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = rotation_entries(
        x[MODEL_ATTITUDE], x[MODEL_ATTITUDE + 1], x[MODEL_ATTITUDE + 2], x[MODEL_ATTITUDE + 3]
    )
    n, e, d = x[MODEL_VELOCITY] - wind[0], x[MODEL_VELOCITY + 1] - wind[1], x[MODEL_VELOCITY + 2] - wind[2]
    return a00 * n + a10 * e + a20 * d, a01 * n + a11 * e + a21 * d, a02 * n + a12 * e + a22 * d


@cached_njit(error_model="numpy", forceinline=True)
def find_map_coordinates(x: _Array, wind: _Array, p: ModelParameters) -> tuple[float, float, float]:
    """Return a state's coordinates in the flight map, a table of rotor loads over flight speed.

    They are lower over upper rotor speed, then climb ratio and edgewise coordinate e, both counted in grid steps of
    their axes.

    Parameters
    ----------
    x : (21,) array
        State.
    wind : (3,) array
        N-E-D (m/s).
    p : record of :class:`ModelParameters`
    """
    air_x, air_y, air_z = compute_airspeed_vector(x, wind)
    up, dw = abs(x[MODEL_SPEED_UPPER]), abs(x[MODEL_SPEED_LOWER])
    tip = max(0.5 * (up + dw), _MIN_ROTOR_SPEED_RAD_S) * p.flight_map_radius
    z = 0.5 * (p.z_up + p.z_dw)
    v_x, v_y = air_x + x[MODEL_RATES + 1] * z, air_y - x[MODEL_RATES] * z
    square = v_x * v_x + v_y * v_y
    edge = square / (square + p.flight_map_knee2 * tip * tip)
    # One division instead of two, which a processor does one after the other.
    least_up = max(up, _MIN_ROTOR_SPEED_RAD_S)
    each = 1.0 / (tip * least_up)
    climb = (-air_z * (each * least_up) - p.flight_map_start[0]) * p.flight_map_inverse_steps[0]
    return dw * (each * tip), climb, edge * p.flight_map_inverse_steps[1]


@cached_njit(error_model="numpy", forceinline=True)
def _flow_loads(
    p: ModelParameters, point: tuple[float, float, float]
) -> tuple[float, float, float, float, float, float, float, float, float, float, float, float]:
    """Interpolate the flight map, a table over flight speed; return six loads of the upper, then of the lower rotor.

    The loads are the first six names of :data:`mufly.vehicle.flight_map.ROTOR_LOAD_COLUMNS`.
    """
    away = min(max(point[0], p.flight_map_speed_ratios[1]), p.flight_map_speed_ratios[2]) - p.flight_map_speed_ratios[0]
    return interpolate_flow_loads(
        p.flight_map_table, p.flight_map_size[0], p.flight_map_size[1], away, point[1], point[2]
    )


@cached_njit(error_model="numpy", forceinline=True)
def _rotor_hub_wrench(
    hub: tuple[float, float, float, float], turning: tuple[float, float, float, float], v_x: float, v_y: float,
    roll: float, pitch: float, scale: float, radius: float, inplane: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a rotor's force (N) along body x and y, then its moment (N m) about the hub, about body x and y.

    Arguments are the loads of the flow from ``drag`` on and those of rates, the velocity of the hub, both rates,
    K Omega, R, and the linear drag that is replaced.
    """
    drag_slope, side_slope, roll_slope, pitch_slope = hub
    force, sideways, damping, coupling = turning
    drag, arm = scale * drag_slope - inplane, scale * radius
    side, turned = scale * side_slope, arm * radius
    f_x = -drag * v_x - side * v_y + arm * (force * roll - sideways * pitch)
    f_y = -drag * v_y + side * v_x + arm * (force * pitch + sideways * roll)
    m_x = arm * (roll_slope * v_x - pitch_slope * v_y) + turned * (damping * roll - coupling * pitch)
    m_y = arm * (roll_slope * v_y + pitch_slope * v_x) + turned * (damping * pitch + coupling * roll)
    return f_x, f_y, m_x, m_y


@cached_njit(error_model="numpy", forceinline=True)
def flight_map_loads(
    x: _Array, air: tuple[float, float], point: tuple[float, float, float], p: ModelParameters
) -> MapWrench:
    """Return the forces, moments, and factors on thrust and torque that a flight map adds, in body axes.

    Parameters
    ----------
    x : (21,) array
        State.
    air : (float, float)
        Velocity through the air across the mast, body axes (m/s).
    point : (float, float, float)
        From :func:`find_map_coordinates`.
    p : record of :class:`ModelParameters`

    Returns
    -------
    tuple of 10 floats
        In-plane force along x and y of the upper, then of the lower rotor (N); hub moments of both rotors about x and
        y (N m); factors of thrust, then of torque, of upper and lower rotor.
    """
    air_x, air_y = air
    roll, pitch = x[MODEL_RATES], x[MODEL_RATES + 1]
    speed_up, speed_dw = abs(x[MODEL_SPEED_UPPER]), abs(x[MODEL_SPEED_LOWER])
    flow = _flow_loads(p, point)
    turning = interpolate_rate_loads(p.flight_map_rate_loads, p.flight_map_size[1], point[2])
    ux, uy, mx_up, my_up = _rotor_hub_wrench(
        flow[_DRAG_INDEX:_LOWER_THRUST_INDEX], turning[:_FIRST_LOWER_RATE_LOAD_INDEX],
        air_x + pitch * p.z_up, air_y - roll * p.z_up, roll, pitch,
        p.flight_map_scale * speed_up, p.flight_map_radius, p.inplane * speed_up,
    )  # fmt: skip
    lx, ly, mx_dw, my_dw = _rotor_hub_wrench(
        flow[_LOWER_DRAG_INDEX:], turning[_FIRST_LOWER_RATE_LOAD_INDEX:],
        air_x + pitch * p.z_dw, air_y - roll * p.z_dw, roll, pitch,
        p.flight_map_scale * speed_dw, p.flight_map_radius, p.inplane * speed_dw,
    )  # fmt: skip
    return (
        ux, uy, lx, ly, mx_up + mx_dw, my_up + my_dw,
        1.0 + flow[_THRUST_INDEX], 1.0 + flow[_LOWER_THRUST_INDEX], 1.0 + flow[_TORQUE_INDEX],
        1.0 + flow[_LOWER_TORQUE_INDEX],
    )  # fmt: skip


@cached_njit(error_model="numpy")
def tip_path_tilt_target(servo_1: Any, servo_2: Any, gain: Any, phase: Any) -> tuple[Any, Any]:
    """Return the tilt (rad) about x and y that given servo inputs command to the lower rotor's tip-path plane.

    Parameters
    ----------
    servo_1, servo_2 : float
        Servo inputs, limited by the caller. Uncompiled, all arguments may be arrays.
    gain : float
        Tilt at full input (rad), ``swash_gain``.
    phase : float
        ``swash_phase`` (rad).
    """
    cosine, sine = np.cos(phase), np.sin(phase)
    return gain * (cosine * servo_2 + sine * servo_1), -gain * (cosine * servo_1 - sine * servo_2)


@cached_njit(error_model="numpy")
def add_swash_phase_effect(u: _Array, p: ModelParameters, dx: _Array) -> None:
    """Add to the time derivative ``dx`` the effect of the swash plate's phase on the commanded tilt of the lower
    tip-path plane.
    """
    servo_1, servo_2 = min(max(u[U_SERVO_1], -1.0), 1.0), min(max(u[U_SERVO_2], -1.0), 1.0)
    less, sine = math.cos(p.swash_phase) - 1.0, math.sin(p.swash_phase)
    full = p.swash_rate * p.swash_gain
    # The thrust leans forward with servo 1 and to the right with servo 2; positive turns forward to the right.
    dx[MODEL_SWASH_ROLL] += full * (less * servo_2 + sine * servo_1)
    dx[MODEL_SWASH_PITCH] -= full * (less * servo_1 - sine * servo_2)


def edgewise_load_factors(
    x: _Array, wind: _Array, p: np.void | ModelParameters
) -> tuple[tuple[float, float], tuple[float, float]]:  # fmt: skip
    """Return the factors by which a flight map multiplies thrust and torque of the upper and of the lower rotor at a
    state.
    """
    flow = _flow_loads(p, find_map_coordinates(x, wind, p))
    return (1.0 + flow[_THRUST_INDEX], 1.0 + flow[_TORQUE_INDEX]), (
        1.0 + flow[_LOWER_THRUST_INDEX],
        1.0 + flow[_LOWER_TORQUE_INDEX],
    )


def is_inside_flight_map(x: _Array, wind: _Array, p: np.void) -> bool:
    """Return True if a state lies within the vehicle's flight map; beyond its edges the values at the edge hold."""
    ratio, climb, edge = find_map_coordinates(x, wind, p)
    last = p["flight_map_size"] - 1
    return bool(
        p["flight_map_speed_ratios"][1] <= ratio <= p["flight_map_speed_ratios"][2]
        and -_MAP_EDGE_TOLERANCE <= climb <= last[0] + _MAP_EDGE_TOLERANCE
        and edge <= last[1] + _MAP_EDGE_TOLERANCE
    )


def flight_map_rate_bound(p: np.void, speed: float) -> float:
    """Return an upper bound of the rates (1/s) that a flight map adds, for ``find_longest_stable_step``.

    Parameters
    ----------
    p : record of :class:`ModelParameters`
    speed : float
        Greatest rotor speed (rad/s).
    """
    if p["flight_map_node_count"] == 0:
        return 0.0
    scale, radius = float(p["flight_map_scale"]) * speed, float(p["flight_map_radius"])
    used = 12 * int(p["flight_map_node_count"])
    flow = np.abs(p["flight_map_table"][:used]).reshape(-1, 6).max(axis=0)
    rates = np.abs(p["flight_map_rate_loads"]).reshape(-1, 4).max(axis=0)
    arm, inertia = max(abs(float(p["z_up"])), radius), float(min(p["Ixx"], p["Iyy"]))
    linear = (flow[_DRAG_INDEX] + flow[_SIDE_INDEX]) * (1.0 / float(p["mass"]) + arm**2 / inertia)
    moment = (flow[_ROLL_MOMENT_INDEX] + flow[_PITCH_MOMENT_INDEX]) * radius * arm / inertia
    turning = float(rates.sum()) * radius * arm / inertia
    return 2.0 * scale * float(linear + moment + turning)
