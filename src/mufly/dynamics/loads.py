"""Thrust and torque of both rotors: by constant coefficients, or by a map over speeds and axial velocity.

Constants (eqs 4.11, 4.12): ``T = cT pi rho R^4 Omega^2``, ``Q = cQ pi rho R^5 Omega |Omega|``. With a map (Sec. 4.3.1
asks for one beyond 0.5 m/s) ``cT`` and ``cQ`` of each rotor are functions of

    mean speed (Omega_up + Omega_dw)/2,    Omega_dw / Omega_up,    climb velocity / (mean speed R)

with the climb velocity that of the mast through the air, along the mast. The map is held at its edges, so thrust and
torque go to zero with the speeds as ``Omega^2`` does, whatever the ratios are then.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mufly.rotor.map_kernel import at, interpolate
from mufly.vehicle import Vehicle

__all__ = ["climb_velocity", "coefficient_bounds", "inside_map", "map_coefficients", "rotor_loads"]

_STANDSTILL = 1e-3  # rad/s; below this a rotor makes no force that could be measured


@njit(cache=True, error_model="numpy")
def climb_velocity(x, wind):  # type: ignore[no-untyped-def]
    """Return the velocity through the air along the mast, positive upwards (m/s), at state ``x``."""
    qw, qx, qy, qz = x[6], x[7], x[8], x[9]
    up_n, up_e, up_d = -2 * (qx * qz + qw * qy), -2 * (qy * qz - qw * qx), 2 * (qx * qx + qy * qy) - 1
    return up_n * (x[3] - wind[0]) + up_e * (x[4] - wind[1]) + up_d * (x[5] - wind[2])


@njit(cache=True, error_model="numpy")
def map_coefficients(speed_up, speed_dw, climb, p):  # type: ignore[no-untyped-def]
    """Return thrust over the speed's square (N s2) of upper and lower rotor, then torque (N m s2), by the map."""
    up, dw = abs(speed_up), abs(speed_dw)
    mean = 0.5 * (up + dw)
    ratio = dw / max(up, _STANDSTILL)
    climb_ratio = climb / (max(mean, _STANDSTILL) * p.map_radius)
    t_up, q_up, t_dw, q_dw = interpolate(
        p.map_thrust_up, p.map_torque_up, p.map_thrust_dw, p.map_torque_dw,
        p.map_size, p.map_start, p.map_per_step, mean, ratio, climb_ratio,
    )  # fmt: skip
    return t_up, t_dw, q_up, q_dw


def rotor_loads(p: np.void, speed_up: float, speed_dw: float, climb: float = 0.0) -> tuple[float, ...]:
    """Return thrust (N) of upper and lower rotor, then torque (N m) of upper and lower, as the flight model has them.

    Parameters
    ----------
    p : record of type ``PARAMETERS``
    speed_up, speed_dw : float
        Rotor speeds (rad/s).
    climb : float
        Velocity through the air along the mast, positive upwards (m/s).
    """
    c = (p["thrust_up"], p["thrust_dw"], p["torque_up"], p["torque_dw"])
    if p["map_nodes"] > 0:
        c = map_coefficients(speed_up, speed_dw, climb, p)
    up, dw = speed_up * abs(speed_up), speed_dw * abs(speed_dw)
    return float(c[0] * speed_up**2), float(c[1] * speed_dw**2), float(c[2] * up), float(c[3] * dw)


def inside_map(vehicle: Vehicle, speed_up: float, speed_dw: float, climb: float) -> bool:
    """Tell whether a vehicle's coefficient map holds a point, or answers from its edge; True without a map.

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
    tip = max(mean, _STANDSTILL) * float(vehicle.rotors.radius)
    return not bool(at(m, mean, abs(speed_dw) / max(abs(speed_up), _STANDSTILL), climb / tip)[1])


def coefficient_bounds(p: np.void, name: str) -> tuple[float, float, float]:
    """Return what a coefficient and its slopes cannot exceed; for ``longest_step``.

    With c over s (mean speed), r (ratio of the speeds) and m (climb ratio V / (s R)), thrust or torque is
    ``c Omega^2``. Its slope over the speed of either rotor is at most ``(2 |c| + s |dc/ds| + r |dc/dr| + m |dc/dm|)
    Omega``, and over the climb velocity ``|dc/dm| Omega^2 / (s R)``, at most ``2 |dc/dm| Omega / R``, because Omega is
    at most 2 s. Slopes of c are those between neighbouring points.

    Parameters
    ----------
    p : record of type ``PARAMETERS``
    name : str
        ``"thrust_up"``, ``"thrust_dw"``, ``"torque_up"`` or ``"torque_dw"``.

    Returns
    -------
    greatest, per_speed, per_climb : float
        Of ``|c|``; of the slope over the rotor's own speed over ``Omega``; of that over climb over ``Omega``.
    """
    n = int(p["map_nodes"])
    if n == 0:
        return float(p[name]), 2 * float(p[name]), 0.0
    table = p[f"map_{name}"][:n].reshape(p["map_size"])
    steps = np.array([1.0 / q if q > 0 else 0.0 for q in p["map_per_step"]])
    last = p["map_start"] + (p["map_size"] - 1) * steps
    reach = np.maximum(np.abs(p["map_start"]), np.abs(last))
    slopes = [
        float(np.max(np.abs(np.diff(table, axis=k)), initial=0.0) * p["map_per_step"][k]) for k in range(3)
    ]
    greatest = float(np.max(np.abs(table)))
    return greatest, 2 * greatest + float(reach @ slopes), 2 * slopes[2] / float(p["map_radius"])
