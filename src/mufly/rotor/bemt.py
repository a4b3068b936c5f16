"""Blade element momentum theory in hover, climb and descent: one unknown a station, bracketed whatever is asked.

At radius r the blade meets V (axial, positive in climb) and Omega r; U and phi_U are size and angle of their
sum. The induced velocity u_n stands at right angles to the relative wind W (Betz; a lifting line induces no
velocity along W), so with phi the angle of W against the disc, everything follows from phi alone:

    W = U cos(phi - phi_U)         u_n = U sin(phi - phi_U)        axial u = u_n cos phi, swirl u_t = u_n sin phi

Blade: the section works at alpha, phi = theta - alpha - e c_l(alpha) (e c_l: finite chord, module
``lifting_surface``). Momentum through the annulus with loss factor F, lift only (profile drag leaves no bound
vorticity):

    N c W^2 c_l cos phi / 2 = 4 pi r F |V + u| u  =>  u_h^2 = N c W^2 c_l cos phi / (8 pi r F),   u = u_h g(V / u_h)

g is 1 in hover and -x/2 + sqrt(x^2/4 + 1) in climb; in descent momentum theory has no answer between x = 0 and
-2 and g is the polynomial through measurements of Leishman, eq. 2.99, brought to 1 at x = -2 to meet the
windmill branch -x/2 - sqrt(x^2/4 - 1). Negative lift is the mirror image.

Residual: R(alpha) = u_n - u / cos phi. With e = 0 it is -U at phi = phi_U - pi/2 and +U at phi_U + pi/2,
because W and with it the blade force vanish there, and it has the sign of -c_l at phi = phi_U: a root always
lies in the half that this sign tells, and Illinois steps with bisection find it. With e > 0 the root lies
between the zero-lift angle (R has the sign of theta - alpha_0 - phi_U) and alpha = theta - phi_U (R has the
sign of -c_l); where these signs agree, at angles at which the lift has already turned over, e is dropped for
that station.

Forces per span:  dT = rho/2 W^2 c N (c_l cos phi - c_d sin phi),  dQ = rho/2 W^2 c N (c_l sin phi + c_d cos phi) r.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mufly.rotor.polar import coefficients

__all__ = ["FIELDS", "descent_inflow", "section_coefficients", "solve_cases"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

# Columns of the station table.
FIELDS = ("alpha_rad", "phi_rad", "inflow_m_s", "swirl_m_s", "cl", "cd", "reynolds", "loss", "dT_N", "dQ_Nm")
_MAX_STEPS = 80
_TOLERANCE = 1e-10  # rad
_FADE_FROM, _FADE_TO = math.radians(30.0), math.radians(50.0)


@njit(cache=True, error_model="numpy")
def descent_inflow(x: float) -> float:
    """Induced over hover-induced velocity, g(x), at V / u_h = x, continuous for all x."""
    if x >= 0.0:
        return -0.5 * x + math.sqrt(0.25 * x * x + 1.0)
    if x > -2.0:
        quartic = 1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x)))
        return quartic - 0.026 * (0.5 * x) ** 4  # Leishman's constants leave 1.026 at x = -2
    return -0.5 * x - math.sqrt(max(0.25 * x * x - 1.0, 0.0))


@njit(cache=True, error_model="numpy")
def _prandtl(f: float) -> float:
    """Prandtl's loss factor; beyond f = 37 it is 1 to the last bit."""
    return 2.0 / math.pi * math.acos(math.exp(-f)) if f < 37.0 else 1.0


@njit(cache=True, error_model="numpy")
def section_coefficients(
    alpha: float, log_re: float, first: int, second: int, weight: float,
    grid: Array, log_re0: float, per_log_re: float, zero_lift: Array, g: float, scale: Any,
) -> tuple[float, float]:  # fmt: skip
    """Lift and drag coefficient of a station: mixed polars, rotation, calibration."""
    cl, cd = coefficients(grid, log_re0, per_log_re, first, alpha, log_re)
    if weight > 0.0:
        cl2, cd2 = coefficients(grid, log_re0, per_log_re, second, alpha, log_re)
        cl, cd = cl + weight * (cl2 - cl), cd + weight * (cd2 - cd)
    if g > 0.0:
        fade = min(max((_FADE_TO - abs(alpha)) / (_FADE_TO - _FADE_FROM), 0.0), 1.0)
        if fade > 0.0:
            a = alpha - (zero_lift[first] + weight * (zero_lift[second] - zero_lift[first]))
            attached = 2.0 * math.pi * math.sin(a) * math.cos(a) ** 2
            if attached * (attached - cl) > 0.0:
                gain = g * fade * (attached - cl)
                cl += gain
                cd += max(gain * math.tan(alpha), 0.0)  # the recovered force is normal to the chord
    return scale[0] * cl, scale[1] * cd


@njit(cache=True, error_model="numpy")
def _residual(
    alpha: float, e: float, theta: float, op: Any, st: Any, ix: Any, polars: Any, scale: Any
) -> Any:
    """Return R of the module docstring and what comes with it: phi, c_l, c_d, W, F, u, u_t, log Re."""
    climb, mode, hub, swirl, speed, phi_u, log_unit = op
    r, chord, weight, g, blades, radius, hub_r = st
    grid, log_re0, per_log_re, zero_lift = polars
    log_re = log_unit + math.log(max(math.cos(theta - alpha - phi_u), 1e-3))
    cl, cd = section_coefficients(
        alpha, log_re, ix[0], ix[1], weight, grid, log_re0, per_log_re, zero_lift, g, scale
    )
    phi = theta - alpha - e * cl
    turn = phi - phi_u
    if turn >= 0.5 * math.pi:
        return speed, phi, cl, cd, 0.0, 1.0, speed, 0.0, log_re
    if turn <= -0.5 * math.pi:
        return -speed, phi, cl, cd, 0.0, 1.0, -speed, 0.0, log_re
    wind, normal = speed * math.cos(turn), speed * math.sin(turn)
    cosine, sine = math.cos(phi), math.sin(phi)
    loss, size = 1.0, abs(sine)
    if size > 1e-12:
        if mode == 1:
            loss = _prandtl(0.5 * blades * (radius - r) / (r * size))
        if hub == 1 and hub_r > 0.0:
            loss *= _prandtl(0.5 * blades * (r - hub_r) / (hub_r * size))
        loss = max(loss, 1e-6)
    if swirl == 0 and cosine > 1e-9:
        wind = speed * math.cos(phi_u) / cosine
    load = blades * chord * wind * wind * cl * cosine / (8.0 * math.pi * r * loss)
    hover = math.sqrt(abs(load))
    momentum = 0.0
    if hover > 0.0:
        sign = 1.0 if load > 0.0 else -1.0
        momentum = sign * hover * descent_inflow(sign * climb / hover)
    if swirl == 0:
        axial = normal
        u = axial / cosine if cosine > 1e-9 else 0.0
        return axial - momentum * cosine, phi, cl, cd, wind, loss, u, 0.0, log_re
    over = cosine if abs(cosine) > 1e-9 else math.copysign(1e-9, cosine)
    return normal - momentum / over, phi, cl, cd, wind, loss, normal * cosine, normal * sine, log_re


@njit(cache=True, error_model="numpy")
def _station(theta: float, e: float, zero: float, op: Any, st: Any, ix: Any, polars: Any, scale: Any) -> Any:
    """Solve one station; return alpha, e as used and the values at the root."""
    speed = op[4]
    middle = theta - op[5]
    b = x = middle
    out = _residual(b, e, theta, op, st, ix, polars, scale)
    a, fa, fb = b, out[0], out[0]
    if e > 0.0:
        a = zero
        fa = _residual(a, e, theta, op, st, ix, polars, scale)[0]
        if fa * fb > 0.0 or abs(a - b) > 0.5 * math.pi:
            e = 0.0
            out = _residual(b, e, theta, op, st, ix, polars, scale)
            fb = out[0]
    if e <= 0.0:
        # phi grows as alpha falls: R < 0 at phi_U puts the root at smaller alpha.
        a = middle - 0.5 * math.pi if fb < 0.0 else middle + 0.5 * math.pi
        fa = -speed if fb > 0.0 else speed  # where the wind vanishes
    side, width = 0, abs(b - a)
    for step in range(_MAX_STEPS):
        if abs(out[0]) <= _TOLERANCE * speed:
            break
        x = b - fb * (b - a) / (fb - fa)
        if step % 3 == 2:  # halve when three secants have not
            if abs(b - a) > 0.5 * width:
                x = 0.5 * (a + b)
            width = abs(b - a)
        out = _residual(x, e, theta, op, st, ix, polars, scale)
        if out[0] * fb > 0.0:
            b, fb = x, out[0]
            if side == 1:
                fa *= 0.5
            side = 1
        else:
            a, fa = x, out[0]
            if side == -1:
                fb *= 0.5
            side = -1
        if abs(b - a) < _TOLERANCE:
            break
    return x, e, out


@njit(cache=True, nogil=True, error_model="numpy")
def solve_cases(
    start: int, stop: int,
    which: Integers, pitch: Array, speed: Array, climb: Array, density: Array, viscosity: Array,
    stream: Array,
    r: Array, dr: Array, chord: Array, twist: Array, first: Integers, second: Integers,
    weight: Array, e: Array, g: Array,
    blades: Array, radius: Array, hub_r: Array,
    grid: Array, log_re0: float, per_log_re: float, zero_lift: Array,
    mode: int, hub: int, swirl: int, cos4: int, scale: Array,
    totals: Array, stations: Array,
) -> None:  # fmt: skip
    """Thrust and torque of the cases ``start`` to ``stop``.

    Parameters
    ----------
    which : (cases,) ints
        Blade of each case: first index of ``r`` and its companions.
    pitch, speed, climb, density, viscosity : (cases,) arrays
        rad, rad/s (above 0), m/s, kg/m3, kinematic m2/s.
    stream : (cases, stations, 2) array or (0, ...)
        Axial (down) and tangential (against the blade) velocity of the air that another rotor sends, m/s.
    r, dr, chord, twist, first, second, weight, e, g : (blades, stations) arrays
        Stations: radius and width (m), chord (m), twist (rad), polars and their mix, finite-chord factor,
        strength of rotation.
    blades, radius, hub_r : (blades,) arrays
        Number of blades, radius, hub radius (m).
    grid, log_re0, per_log_re, zero_lift
        Polars as stacked, and their zero-lift angles (rad).
    mode, hub, swirl, cos4, scale
        0 no tip loss, 1 Prandtl, 2 effective radius; hub loss; swirl; factor cos^4 theta on g; factors on lift and
        drag.
    totals : (cases, 2) array
        Filled with thrust (N) and torque (N m).
    stations : (cases, stations, 10) array or (0, ...)
        Filled with :data:`FIELDS` unless its first axis is empty.
    """
    polars = (grid, log_re0, per_log_re, zero_lift)
    keep, meets = stations.shape[0] > 0, stream.shape[0] > 0
    for case in range(start, stop):
        k = which[case]
        effective = radius[k]
        # The effective radius depends on the mean inflow: four passes settle it to 1e-4 R.
        for _ in range(4 if mode == 2 else 1):
            thrust, torque, inflow, area = 0.0, 0.0, 0.0, 0.0
            for i in range(r.shape[1]):
                theta = pitch[case] + twist[k, i]
                rotation = g[k, i]
                if cos4 == 1:
                    rotation *= math.cos(theta) ** 4
                share = 1.0
                if mode == 2:
                    share = min(max((effective - r[k, i]) / dr[k, i] + 0.5, 0.0), 1.0)
                factors = (scale[0] * share, scale[1])
                st = (
                    r[k, i],
                    chord[k, i],
                    weight[k, i],
                    rotation,
                    blades[k],
                    radius[k],
                    hub_r[k],
                )
                ix = (first[k, i], second[k, i])
                zero = zero_lift[ix[0]] + weight[k, i] * (zero_lift[ix[1]] - zero_lift[ix[0]])
                axial, across = climb[case], speed[case] * r[k, i]
                if meets:
                    axial += stream[case, i, 0]
                    across += stream[case, i, 1]
                u_total = math.hypot(axial, across)
                log_unit = math.log(max(u_total * chord[k, i] / viscosity[case], 1e-3))
                op = (axial, mode, hub, swirl, u_total, math.atan2(axial, across), log_unit)
                alpha, _e, out = _station(theta, e[k, i], zero, op, st, ix, polars, factors)
                _, phi, cl, cd, wind, loss, u, u_t, log_re = out
                push = 0.5 * density[case] * wind * wind * chord[k, i] * blades[k] * dr[k, i]
                d_thrust = push * (cl * math.cos(phi) - cd * math.sin(phi))
                d_torque = push * (cl * math.sin(phi) + cd * math.cos(phi)) * r[k, i]
                thrust += d_thrust
                torque += d_torque
                inflow += u * r[k, i] * dr[k, i]
                area += r[k, i] * dr[k, i]
                if keep:
                    row = stations[case, i]
                    row[0], row[1], row[2], row[3], row[4] = alpha, phi, u, u_t, cl
                    row[5], row[6], row[7], row[8], row[9] = cd, math.exp(log_re), loss, d_thrust, d_torque
            if mode == 2:
                lam = max(inflow / area + climb[case], 0.0) / (speed[case] * radius[k])
                effective = radius[k] * (1.0 - 1.386 / blades[k] * lam / math.sqrt(1.0 + lam * lam))
        totals[case, 0], totals[case, 1] = thrust, torque
