"""Contact with the floor (D = 0): compliant legs, and the rim of the upper rotor once it has tipped over.

Every contact point below the floor by ``d`` is pushed up as a spring with damper that cannot pull, and rubs by
Coulomb friction, smoothed around rest so that the equations stay integrable::

    N = max(0, k d + c dd/dt)            F_t = -min(mu N / sqrt(v_t^2 + v_slip^2), c_t) v_t

Around rest friction is viscous, so a steady push ``F < mu N`` lets the vehicle creep at about
``v_slip F / (mu N)``. The bound ``c_t`` keeps the viscous yaw mode ``sum(c_t r^2) / Izz`` slower than 2000 1/s, which
steps of 1 ms resolve even when a hard landing presses a point down with many times its share of the weight.

The legs' compliance stands for legs and floor together. Own derivation; the thesis has no ground model.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mufly.dynamics.parameters import GRAVITY
from mufly.dynamics.state import rotation
from mufly.vehicle import Vehicle

__all__ = ["contact_wrench", "lowest_point", "standing_height"]


@njit(cache=True, error_model="numpy")
def contact_wrench(x, p):  # type: ignore[no-untyped-def]
    """Return the force of the floor (N-E-D, N) and its moment (body axes, N m) as six numbers."""
    a = rotation(x[6:10])
    f_n = f_e = f_d = m_x = m_y = m_z = 0.0
    for k in range(p.contact_count):
        rx, ry, rz = p.contact_points[k, 0], p.contact_points[k, 1], p.contact_points[k, 2]
        depth = x[2] + a[2, 0] * rx + a[2, 1] * ry + a[2, 2] * rz
        if depth <= 0.0:
            continue
        # Velocity of the point: body v + W x r, in N-E-D.
        vx = x[11] * rz - x[12] * ry
        vy = x[12] * rx - x[10] * rz
        vz = x[10] * ry - x[11] * rx
        v_n = x[3] + a[0, 0] * vx + a[0, 1] * vy + a[0, 2] * vz
        v_e = x[4] + a[1, 0] * vx + a[1, 1] * vy + a[1, 2] * vz
        v_d = x[5] + a[2, 0] * vx + a[2, 1] * vy + a[2, 2] * vz
        normal = max(0.0, p.leg_stiffness * depth + p.leg_damping * v_d)
        rub = p.leg_friction * normal / math.sqrt(v_n * v_n + v_e * v_e + p.slip_speed * p.slip_speed)
        rub = min(rub, p.friction_bound[k])
        g_n, g_e, g_d = -rub * v_n, -rub * v_e, -normal
        f_n += g_n
        f_e += g_e
        f_d += g_d
        gx = a[0, 0] * g_n + a[1, 0] * g_e + a[2, 0] * g_d
        gy = a[0, 1] * g_n + a[1, 1] * g_e + a[2, 1] * g_d
        gz = a[0, 2] * g_n + a[1, 2] * g_e + a[2, 2] * g_d
        m_x += ry * gz - rz * gy
        m_y += rz * gx - rx * gz
        m_z += rx * gy - ry * gx
    return f_n, f_e, f_d, m_x, m_y, m_z


@njit(cache=True, error_model="numpy")
def lowest_point(x, p):  # type: ignore[no-untyped-def]
    """Return depth below the floor (m; negative: above) and index of the lowest contact point."""
    a = rotation(x[6:10])
    depth, index = -math.inf, 0
    for k in range(p.contact_count):
        c = p.contact_points[k]
        d = x[2] + a[2, 0] * c[0] + a[2, 1] * c[1] + a[2, 2] * c[2]
        if d > depth:
            depth, index = d, k
    return depth, index


def standing_height(vehicle: Vehicle) -> float:
    """Return the height (m) of the centre of gravity when the vehicle stands still with its rotors at rest.

    The weight is taken to be shared equally by the legs that reach lowest.
    """
    z: NDArray[np.float64] = vehicle.contact.legs.array()[:, 2]
    lowest = float(z.max())
    carrying = int(np.sum(z > lowest - 1e-6))
    return lowest - float(vehicle.body.mass) * GRAVITY / (carrying * float(vehicle.contact.stiffness))
