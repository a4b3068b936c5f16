"""Blade elements over azimuth with one flap mode and dynamic inflow, solved by harmonic balance (Numba).

psi = 0 aft, increasing with the rotation; the air meets the disc with V from the front and V_z from above.
The flap angle is beta = q0 + q1c cos psi + q1s sin psi + q2c cos 2 psi + q2s sin 2 psi. p and q are the rates of the
hub, u is the mean induced velocity of the annulus and u_t its swirl. At station r of the blade at psi:

    U_T = Omega r + V sin psi - u_t + stream_t            U_R = V cos psi

    U_P = V_z + stream + u + R Omega (r/R) (lc cos psi + ls sin psi) + r beta' - r (p sin psi + q cos psi) + U_R beta

    onset = theta - atan2(U_P, U_T)      theta = twist + th0 + th1c cos psi + th1s sin psi      (full circle)

The flap mode is the rigid shape r with the moment of inertia I and the frequency nu Omega. Per harmonic n

    I Omega^2 (nu^2 - n^2) q_n = [int r F_z dr]_n + 2 Omega I (p cos psi - q sin psi)_n

Mean inflow of an annulus: u = w u_a + (1 - w) l0 Omega R. u_a is the momentum balance of the annulus with Prandtl's
factor F, as in :mod:`mufly.rotor.bemt`, l0 the mean of :mod:`mufly.rotor.forward.inflow`, and w = cos chi. In axial
flow (w = 1) the equations are those of blade element momentum theory. In edgewise flow the wake leaves backwards and
an annulus no longer feeds itself; tip loss is then the factor 1 - (1 - w) (1 - F) on the lift (own rule).

Unknowns are u of each station, the five flap coefficients, l0, lc and ls. The derivatives of the section forces
with U_P, and near the solution with swirl and tip loss, give the whole Jacobian. Stations couple through eight global
unknowns only, so that Newton steps eliminate them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.rotor.forward.azimuth_elements import (
    AzimuthBlade,
    AzimuthPoint,
    compute_annulus_swirl_and_losses,
    compute_element_forces,
)
from mufly.rotor.forward.inflow import momentum_induced_velocity, pitt_peters_inflow

Array = NDArray[np.float64]

GLOBAL_UNKNOWN_COUNT = 8
(
    UNKNOWN_CONING,
    UNKNOWN_FLAP_COS,
    UNKNOWN_FLAP_SIN,
    UNKNOWN_FLAP_COS_2,
    UNKNOWN_FLAP_SIN_2,
    UNKNOWN_INFLOW,
    UNKNOWN_INFLOW_COS,
    UNKNOWN_INFLOW_SIN,
) = range(GLOBAL_UNKNOWN_COUNT)
"""Unknowns q0, q1c, q1s, q2c, q2s (rad), l0, lc, ls (over Omega R), and their residuals."""
DERIVATIVE_BY_INDUCED_VELOCITY, DERIVATIVE_BY_INFLOW_COS, DERIVATIVE_BY_INFLOW_SIN = 0, 6, 7
"""Places of u, lc and ls among the variables of the slopes of a station; the flap coefficients lie between."""
FORCE_MEAN, FORCE_COS, FORCE_SIN, FORCE_COS_2, FORCE_SIN_2, FORCE_MEAN_LIFT = range(6)
"""Mean and harmonics of the force of a station, and its mean lift in the axial direction."""
(
    BLADE_THRUST,
    BLADE_FLAP_MOMENT,
    BLADE_FLAP_MOMENT_COS,
    BLADE_FLAP_MOMENT_SIN,
    BLADE_FLAP_MOMENT_COS_2,
    BLADE_FLAP_MOMENT_SIN_2,
) = range(6)
"""Thrust, mean and harmonics of the flap moment of a blade."""
PRANDTL_LOSS_FACTOR, PRANDTL_LOSS_DERIVATIVE = 0, 1
"""Prandtl's factor of an annulus, and its slope over u."""
ANNULUS_SWIRL, ANNULUS_LOSS, ANNULUS_DRAG = range(3)
"""Columns of an annulus of a solution."""
(
    ROTOR_THRUST, ROTOR_TORQUE, ROTOR_H_FORCE, ROTOR_Y_FORCE, ROTOR_MOMENT_COS, ROTOR_MOMENT_SIN,
    ROTOR_INDUCED_POWER, ROTOR_PROFILE_POWER, ROTOR_CLIMB_POWER, ROTOR_THRUST_COS_2, ROTOR_THRUST_SIN_2,
) = range(11)  # fmt: skip
"""Loads of a solution."""
ROTOR_LOAD_COUNT = 11
MAX_NEWTON_STEPS = 80
NEWTON_RESIDUAL_TOLERANCE = 1e-10
INFLOW_CODES = {"annular": 0, "pitt-peters": 1, "uniform": 2, "prescribed": 3}
FIELD_INDUCED_VELOCITY, FIELD_ONSET_ANGLE, FIELD_LIFT, FIELD_DRAG, FIELD_REYNOLDS, FIELD_THRUST = range(6)
FIELD_COLUMNS = (
    "axial_induced_m_s",
    "onset_angle_rad",
    "lift_coefficient",
    "drag_coefficient",
    "reynolds",
    "thrust_per_length_N_m",
)
_MAX_FULL_JACOBIAN_RESIDUAL = 0.02
"""Residual below which Newton steps see how swirl and tip loss change with the inflow. Farther away, and in descent,
these slopes lead astray."""


def velocity_derivative_weights(trig: Array) -> Array:
    """Return weights with which a sum over azimuth gives the derivatives of harmonics of a force, (azimuths, 2, 40).

    Each is the derivative of U_P, the velocity perpendicular to the blade's path, by one unknown, times a harmonic.

    Entry 8 h + k belongs to the harmonic h (1, c, s, 2c, 2s) and the unknown k (u, five flap coefficients, lc, ls).
    The first table is over V, the second over Omega r, the column of u over 1.
    """
    count = trig.shape[0]
    one, c, s, c2, s2 = trig.T
    none = np.zeros(count)
    over_edgewise = (none, c, c * c, c * s, c * c2, c * s2, none, none)
    over_rotation = (one, none, -s, c, -2.0 * s2, 2.0 * c2, c, s)
    weights = np.array([1.0, 2.0, 2.0, 2.0, 2.0]) / count * trig
    tables = [
        np.stack([weights[:, h] * w for h in range(5) for w in way], axis=1) for way in (over_edgewise, over_rotation)
    ]
    return np.ascontiguousarray(np.stack(tables, axis=1))


@cached_njit(error_model="numpy")
def _sum_element_forces(
    blade: AzimuthBlade, point: AzimuthPoint, inflow: Array, x: Array, share: float, trig: Array, ways: Array,
    fresh: bool, near: bool, sums: Array, slopes: Array, losses: Array,
) -> None:  # fmt: skip
    """Fill ``sums`` with the harmonics over azimuth of the force at each station, ``slopes`` with their derivatives.

    Parameters
    ----------
    inflow : (stations,) array
        Mean induced velocity u (m/s).
    x : (8,) array
        Flap coefficients (rad), l0, lc and ls.
    share : float
        w of the module docstring.
    trig : (azimuths, 5) array
        1, cos psi, sin psi, cos 2 psi, sin 2 psi.
    sums : (stations, 6) array
        Filled with mean and harmonics of F_z (N/m; 1, c, s, 2c, 2s) and the mean of the lift in the axial direction.
    ways : (azimuths, 2, 40) array
        :func:`velocity_derivative_weights`.
    fresh : bool
        True to fill in the derivatives as well.
    near : bool
        True to take the change of swirl and losses with u into the derivatives.
    slopes : (stations, 6, 8) array
        Filled with the derivatives of the sums with u (m/s), the five flap coefficients, lc and ls.
    losses : (stations, 2) array
        Filled with Prandtl's factor, and if ``fresh`` with its derivative with u (s/m).
    """
    speed, edgewise = point.speed_rad_s, point.edgewise_m_s
    count = trig.shape[0]
    row_scale = blade.rows_per_log_reynolds
    for i in range(blade.r_m.size):
        for h in range(6):
            sums[i, h] = 0.0
    by_edgewise, by_rotation, by_annulus = np.empty(40), np.empty(40), np.empty(6)
    lift_by_edgewise, lift_by_rotation = np.empty(8), np.empty(8)
    swirl_u, loss_u, share_u, tip = 0.0, 0.0, 0.0, speed * blade.radius_m
    for i in range(blade.r_m.size):
        r, chord = blade.r_m[i], blade.chord_m[i]
        stream, around = 0.0, 0.0
        for n in range(count):
            stream += point.stream_m_s[n, i] / count
            around += point.swirl_m_s[n, i] / count
        swirl, loss, lift_share = compute_annulus_swirl_and_losses(blade, point, i, inflow[i], stream, around, share)
        losses[i, PRANDTL_LOSS_FACTOR] = loss
        if near:
            nudge = 1e-6 * tip
            swirl_u, loss_u, share_u = compute_annulus_swirl_and_losses(
                blade, point, i, inflow[i] + nudge, stream, around, share
            )
            swirl_u, loss_u = (swirl_u - swirl) / nudge, (loss_u - loss) / nudge
            share_u = (share_u - lift_share) / (nudge * lift_share)
        if fresh:
            losses[i, PRANDTL_LOSS_DERIVATIVE] = loss_u
        half = 0.5 * point.density_kg_m3 * chord
        row_zero = row_scale * (math.log(chord / point.kinematic_viscosity_m2_s) - blade.log_reynolds_min)
        for h in range(6):
            by_annulus[h] = 0.0
        for k in range(40):
            by_edgewise[k] = by_rotation[k] = 0.0
        for k in range(8):
            lift_by_edgewise[k] = lift_by_rotation[k] = 0.0
        for n in range(count):
            c, s, c2, s2 = (
                trig[n, FORCE_COS],
                trig[n, FORCE_SIN],
                trig[n, FORCE_COS_2],
                trig[n, FORCE_SIN_2],
            )
            along = edgewise * c
            flap = (
                x[UNKNOWN_CONING]
                + x[UNKNOWN_FLAP_COS] * c
                + x[UNKNOWN_FLAP_SIN] * s
                + x[UNKNOWN_FLAP_COS_2] * c2
                + x[UNKNOWN_FLAP_SIN_2] * s2
            )
            flapping = speed * (
                x[UNKNOWN_FLAP_SIN] * c
                - x[UNKNOWN_FLAP_COS] * s
                + 2.0 * (x[UNKNOWN_FLAP_SIN_2] * c2 - x[UNKNOWN_FLAP_COS_2] * s2)
            )
            across = speed * r + edgewise * s - swirl + point.swirl_m_s[n, i]
            down = (
                point.axial_m_s + point.stream_m_s[n, i] + inflow[i]
                + speed * r * (x[UNKNOWN_INFLOW_COS] * c + x[UNKNOWN_INFLOW_SIN] * s)
                + r * (flapping - point.roll_rate_rad_s * s - point.pitch_rate_rad_s * c) + along * flap
            )  # fmt: skip
            theta = blade.twist_rad[i] + point.collective_rad + point.cyclic_cos_rad * c + point.cyclic_sin_rad * s
            force, _, lift, _, _, slope, lift_slope, force_t, lift_t = compute_element_forces(
                blade.section_table[i], theta, across, down, half, row_zero, row_scale, lift_share
            )
            for h in range(5):
                sums[i, h] += (1.0 if h == 0 else 2.0) * trig[n, h] / count * force
            sums[i, FORCE_MEAN_LIFT] += lift / count
            if not fresh:
                continue
            more, lift_more = share_u * lift - swirl_u * force_t, share_u * lift - swirl_u * lift_t
            for h in range(5):
                by_annulus[h] += (1.0 if h == 0 else 2.0) * trig[n, h] / count * more
            by_annulus[FORCE_MEAN_LIFT] += lift_more / count
            for k in range(40):
                by_edgewise[k] += slope * ways[n, 0, k]
                by_rotation[k] += slope * ways[n, 1, k]
            for k in range(8):
                lift_by_edgewise[k] += lift_slope * ways[n, 0, k]
                lift_by_rotation[k] += lift_slope * ways[n, 1, k]
        if fresh:
            for k in range(8):
                turning = 1.0 if k == 0 else speed * r
                for h in range(5):
                    slopes[i, h, k] = edgewise * by_edgewise[8 * h + k] + turning * by_rotation[8 * h + k]
                slopes[i, FORCE_MEAN_LIFT, k] = edgewise * lift_by_edgewise[k] + turning * lift_by_rotation[k]
            for h in range(6):
                slopes[i, h, DERIVATIVE_BY_INDUCED_VELOCITY] += by_annulus[h]


@cached_njit(error_model="numpy")
def _fill_global_residual(blade: AzimuthBlade, point: AzimuthPoint, x: Array, loads: Array, out: Array) -> float:
    """Write the residuals of the five flap and three inflow equations to ``out`` (8,); return the weight w.

    w is the share of the annulus's own momentum balance in its inflow (module docstring).

    ``loads``: thrust (N) and harmonics of the flap moment (N m) of one blade.
    """
    speed, radius = point.speed_rad_s, blade.radius_m
    if math.isinf(blade.flap_ratio):
        for n in range(5):
            out[n] = x[n]
    else:
        scale = blade.flap_inertia_about_shaft_kg_m2 * speed * speed
        square = blade.flap_ratio * blade.flap_ratio
        out[UNKNOWN_CONING] = square * x[UNKNOWN_CONING] - loads[BLADE_FLAP_MOMENT] / scale
        out[UNKNOWN_FLAP_COS] = (
            (square - 1.0) * x[UNKNOWN_FLAP_COS]
            - loads[BLADE_FLAP_MOMENT_COS] / scale
            - 2.0 * point.roll_rate_rad_s / speed
        )
        out[UNKNOWN_FLAP_SIN] = (
            (square - 1.0) * x[UNKNOWN_FLAP_SIN]
            - loads[BLADE_FLAP_MOMENT_SIN] / scale
            + 2.0 * point.pitch_rate_rad_s / speed
        )
        out[UNKNOWN_FLAP_COS_2] = (square - 4.0) * x[UNKNOWN_FLAP_COS_2] - loads[BLADE_FLAP_MOMENT_COS_2] / scale
        out[UNKNOWN_FLAP_SIN_2] = (square - 4.0) * x[UNKNOWN_FLAP_SIN_2] - loads[BLADE_FLAP_MOMENT_SIN_2] / scale
    if point.inflow_code == 3:
        out[UNKNOWN_INFLOW], out[UNKNOWN_INFLOW_COS], out[UNKNOWN_INFLOW_SIN] = (
            x[UNKNOWN_INFLOW],
            x[UNKNOWN_INFLOW_COS],
            x[UNKNOWN_INFLOW_SIN],
        )
        return 0.0
    disc = point.density_kg_m3 * math.pi * radius * radius * (speed * radius) ** 2
    stream = 0.0
    for i in range(blade.r_m.size):
        for n in range(point.stream_m_s.shape[0]):
            stream += point.stream_m_s[n, i] * blade.r_m[i] * blade.dr_m[i]
    stream *= 2.0 / (radius * radius * point.stream_m_s.shape[0])
    tip = speed * radius
    c_c = 0.5 * blade.blade_count * loads[BLADE_FLAP_MOMENT_COS] / (disc * radius)
    c_s = 0.5 * blade.blade_count * loads[BLADE_FLAP_MOMENT_SIN] / (disc * radius)
    l0, lc, ls, cosine = pitt_peters_inflow(
        blade.blade_count * loads[BLADE_THRUST] / disc, c_c if point.inflow_code < 2 else 0.0, c_s, x[UNKNOWN_INFLOW],
        (point.axial_m_s + stream) / tip, point.edgewise_m_s / tip,
    )  # fmt: skip
    out[UNKNOWN_INFLOW] = x[UNKNOWN_INFLOW] - l0
    if point.inflow_code == 2:
        out[UNKNOWN_INFLOW_COS], out[UNKNOWN_INFLOW_SIN] = x[UNKNOWN_INFLOW_COS], x[UNKNOWN_INFLOW_SIN]
    else:
        out[UNKNOWN_INFLOW_COS], out[UNKNOWN_INFLOW_SIN] = x[UNKNOWN_INFLOW_COS] - lc, x[UNKNOWN_INFLOW_SIN] - ls
    return cosine if point.inflow_code == 0 else 0.0


@cached_njit(error_model="numpy")
def _sum_blade_loads(blade: AzimuthBlade, sums: Array, loads: Array) -> None:
    for h in range(6):
        loads[h] = 0.0
    for i in range(blade.r_m.size):
        loads[BLADE_THRUST] += sums[i, FORCE_MEAN] * blade.dr_m[i]
        for h in range(5):
            loads[h + 1] += sums[i, h] * blade.r_m[i] * blade.dr_m[i]


@cached_njit(error_model="numpy")
def _solve_linear_in_place(matrix: Array, side: Array) -> None:
    """Replace ``side`` by the solution of a small linear system (Gauss, partial pivoting)."""
    n = side.size
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[best, k]):
                best = i
        side[k], side[best] = side[best], side[k]
        for j in range(k, n):
            matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
        for i in range(k + 1, n):
            ratio = matrix[i, k] / matrix[k, k]
            side[i] -= ratio * side[k]
            for j in range(k, n):
                matrix[i, j] -= ratio * matrix[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            side[k] -= matrix[k, j] * side[j]
        side[k] /= matrix[k, k]


@cached_njit(error_model="numpy")
def _fill_station_residuals(
    blade: AzimuthBlade, point: AzimuthPoint, inflow: Array, x: Array, share: float, sums: Array, slopes: Array,
    losses: Array, miss: Array, local: Array,
) -> float:  # fmt: skip
    """Write the residual of each station's inflow equation (m/s) to ``miss``, and its derivatives to ``local``.

    The derivatives are those by u, then by the eight unknowns ``x``. Return the largest residual over the tip speed.
    """
    tip, count, largest = point.speed_rad_s * blade.radius_m, point.stream_m_s.shape[0], 0.0
    for i in range(blade.r_m.size):
        own, slope = 0.0, 0.0
        if share > 0.0:
            stream = 0.0
            for n in range(count):
                stream += point.stream_m_s[n, i] / count
            factor = blade.blade_count / (
                4.0 * math.pi * blade.r_m[i] * point.density_kg_m3 * losses[i, PRANDTL_LOSS_FACTOR]
            )
            hover, axial = factor * sums[i, FORCE_MEAN_LIFT], point.axial_m_s + stream
            annulus = (inflow[i] - (1.0 - share) * x[UNKNOWN_INFLOW] * tip) / share
            if share > 0.5 and annulus > 0.0 and axial >= 0.0:
                # The balance as u sqrt(V^2 + (V_z + u)^2) = u_h^2: smooth where the load vanishes, as at the tip.
                flow = math.sqrt(point.edgewise_m_s * point.edgewise_m_s + (axial + annulus) * (axial + annulus))
                rate = max(flow + annulus * (axial + annulus) / max(flow, 1e-9 * tip), 1e-3 * tip)
                slope = share * factor / rate
                miss[i] = share * (annulus * flow - hover) / rate
            else:
                nudge = 1e-8 * tip * tip + 1e-6 * abs(hover)
                for side in range(2):
                    value = momentum_induced_velocity(hover + side * nudge, axial, point.edgewise_m_s)
                    if side == 0:
                        own = value
                    else:
                        slope = share * factor * (value - own) / nudge
                miss[i] = inflow[i] - share * own - (1.0 - share) * x[UNKNOWN_INFLOW] * tip
        else:
            miss[i] = inflow[i] - x[UNKNOWN_INFLOW] * tip
        largest = max(largest, abs(miss[i]) / tip)
        by_inflow = (
            slopes[i, FORCE_MEAN_LIFT, DERIVATIVE_BY_INDUCED_VELOCITY]
            - sums[i, FORCE_MEAN_LIFT] * losses[i, PRANDTL_LOSS_DERIVATIVE] / losses[i, PRANDTL_LOSS_FACTOR]
        )
        own_slope = 1.0 - slope * by_inflow  # negative where a descent has several solutions
        local[i, 0] = own_slope if abs(own_slope) > 0.2 else math.copysign(0.2, own_slope)
        for k in range(5):
            local[i, k + 1] = -slope * slopes[i, FORCE_MEAN_LIFT, k + 1]
        local[i, 1 + UNKNOWN_INFLOW] = -(1.0 - share) * tip
        local[i, 1 + UNKNOWN_INFLOW_COS], local[i, 1 + UNKNOWN_INFLOW_SIN] = (
            -slope * slopes[i, FORCE_MEAN_LIFT, DERIVATIVE_BY_INFLOW_COS],
            -slope * slopes[i, FORCE_MEAN_LIFT, DERIVATIVE_BY_INFLOW_SIN],
        )
    return largest


@cached_njit(error_model="numpy")
def _differentiate_global_residual(
    blade: AzimuthBlade, point: AzimuthPoint, x: Array, loads: Array, out: Array
) -> tuple[Array, Array]:
    """Return the derivatives of the flap and inflow residuals ``out`` by ``loads``, (8, 6), and by ``x``, (8, 8)."""
    by_load, by_state, other = (
        np.zeros((GLOBAL_UNKNOWN_COUNT, 6)),
        np.zeros((GLOBAL_UNKNOWN_COUNT, GLOBAL_UNKNOWN_COUNT)),
        np.zeros(GLOBAL_UNKNOWN_COUNT),
    )
    moved_loads, moved = np.zeros(6), np.zeros(GLOBAL_UNKNOWN_COUNT)
    for k in range(GLOBAL_UNKNOWN_COUNT):
        moved[k] = x[k]
    for k in range(6):
        moved_loads[k] = loads[k]
    for k in range(6):
        nudge = 1e-6 * abs(loads[k]) + 1e-9
        moved_loads[k] += nudge
        _fill_global_residual(blade, point, moved, moved_loads, other)
        moved_loads[k] = loads[k]
        for m in range(GLOBAL_UNKNOWN_COUNT):
            by_load[m, k] = (other[m] - out[m]) / nudge
    for k in range(GLOBAL_UNKNOWN_COUNT):
        nudge = 1e-7
        moved[k] += nudge
        _fill_global_residual(blade, point, moved, moved_loads, other)
        moved[k] = x[k]
        for m in range(GLOBAL_UNKNOWN_COUNT):
            by_state[m, k] = (other[m] - out[m]) / nudge
    return by_load, by_state


@cached_njit(error_model="numpy")
def _newton_step(
    blade: AzimuthBlade, slopes: Array, by_load: Array, matrix: Array, out: Array, miss: Array, local: Array
) -> Array:
    """Return the Newton step (8,) of the flap and inflow unknowns, after elimination of the inflow of each station.

    ``matrix`` is overwritten.
    """
    side = np.zeros(GLOBAL_UNKNOWN_COUNT)
    for m in range(GLOBAL_UNKNOWN_COUNT):
        side[m] = -out[m]
    per_length = np.zeros(5)
    direct = np.zeros(GLOBAL_UNKNOWN_COUNT)  # derivatives with u, the flap coefficients, lc and ls
    for i in range(blade.r_m.size):
        for m in range(GLOBAL_UNKNOWN_COUNT):
            for h in range(5):
                per_length[h] = by_load[m, h + 1] * blade.r_m[i] * blade.dr_m[i]
            per_length[0] += by_load[m, 0] * blade.dr_m[i]
            for k in range(GLOBAL_UNKNOWN_COUNT):
                total = 0.0
                for h in range(5):
                    total += per_length[h] * slopes[i, h, k]
                direct[k] = total
            through = direct[0] / local[i, 0]
            side[m] += through * miss[i]
            for k in range(GLOBAL_UNKNOWN_COUNT):
                matrix[m, k] -= through * local[i, k + 1]
                if k != UNKNOWN_INFLOW:
                    matrix[m, k] += direct[k + 1 if k < 5 else k]
    _solve_linear_in_place(matrix, side)
    return side


@cached_njit(error_model="numpy", nogil=True)
def solve_azimuth_point(
    blade: AzimuthBlade, point: AzimuthPoint, trig: Array, ways: Array, inflow: Array, x: Array
) -> tuple[int, float, float]:
    """Solve the unknowns ``inflow`` and ``x`` of an operating point in place, by Newton's method.

    Return the number of steps, the last residual, and the weight w of annulus inflow.

    Parameters
    ----------
    blade : AzimuthBlade
    point : AzimuthPoint
    trig : (azimuths, 5) array
        1, cos psi, sin psi, cos 2 psi, sin 2 psi.
    ways : (azimuths, 2, 40) array
        :func:`velocity_derivative_weights`.
    inflow : (stations,) array
        Mean induced velocity of each annulus (m/s): the start, replaced by the solution. Kept for the inflow code 3.
    x : (8,) array
        The other unknowns: the start, replaced by the solution.
    """
    ns, tip = blade.r_m.size, point.speed_rad_s * blade.radius_m
    sums, slopes, losses = np.zeros((ns, 6)), np.zeros((ns, 6, GLOBAL_UNKNOWN_COUNT)), np.ones((ns, 2))
    miss, local, loads, out = np.zeros(ns), np.zeros((ns, 9)), np.zeros(6), np.zeros(GLOBAL_UNKNOWN_COUNT)
    for i in range(ns):
        local[i, 0] = 1.0
    share, size, best, slow = 1.0 if point.inflow_code == 0 else 0.0, 1e9, 1e9, 1.0
    previous = 1e9
    by_load, by_state = np.zeros((GLOBAL_UNKNOWN_COUNT, 6)), np.zeros((GLOBAL_UNKNOWN_COUNT, GLOBAL_UNKNOWN_COUNT))
    matrix = np.zeros((GLOBAL_UNKNOWN_COUNT, GLOBAL_UNKNOWN_COUNT))
    for step in range(MAX_NEWTON_STEPS):
        fresh = step < 3 or size > 1e-3 or size > 0.3 * previous  # else the last derivatives are good enough
        previous = size
        _sum_element_forces(
            blade, point, inflow, x, share, trig, ways, fresh, size < _MAX_FULL_JACOBIAN_RESIDUAL, sums, slopes, losses
        )
        _sum_blade_loads(blade, sums, loads)
        share = _fill_global_residual(blade, point, x, loads, out)
        size = 0.0
        for k in range(GLOBAL_UNKNOWN_COUNT):
            size = max(size, abs(out[k]))
        if point.inflow_code != 3:
            size = max(size, _fill_station_residuals(blade, point, inflow, x, share, sums, slopes, losses, miss, local))
        if size < NEWTON_RESIDUAL_TOLERANCE:
            return step, size, share
        if not size < 1e6:
            break
        if size > 2.0 * best and step > 3:
            slow = max(0.5 * slow, 0.05)
        elif size < best:
            best, slow = size, min(1.3 * slow, 1.0)
        if fresh:
            by_load, by_state = _differentiate_global_residual(blade, point, x, loads, out)
        for m in range(GLOBAL_UNKNOWN_COUNT):
            for k in range(GLOBAL_UNKNOWN_COUNT):
                matrix[m, k] = by_state[m, k]
        change = _newton_step(blade, slopes, by_load, matrix, out, miss, local)
        largest = 1e-12
        for k in range(GLOBAL_UNKNOWN_COUNT):
            largest = max(largest, abs(change[k]) / (0.2 if k < 5 else 0.05))
        part = slow * min(1.0, 1.0 / largest)
        for i in range(ns):
            turn = -miss[i]
            for k in range(GLOBAL_UNKNOWN_COUNT):
                turn -= local[i, k + 1] * change[k]
            inflow[i] += part * min(max(turn / local[i, 0], -0.05 * tip), 0.05 * tip)
        for k in range(GLOBAL_UNKNOWN_COUNT):
            x[k] += part * change[k]
    return MAX_NEWTON_STEPS, size, share


@cached_njit(error_model="numpy", nogil=True)
def integrate_loads(
    blade: AzimuthBlade, point: AzimuthPoint, trig: Array, inflow: Array, induced: Array, x: Array, share: float,
    fields: Array, totals: Array, annuli: Array,
) -> None:  # fmt: skip
    """Fill the arrays of a solved operating point: values over the disc, total loads, and values of each annulus.

    Parameters
    ----------
    induced : (azimuths, stations) array
        Further induced velocity (m/s), added to the inflow of the state.
    fields : (azimuths, stations, 6) array
        Filled with :data:`FIELD_COLUMNS`.
    totals : (11,) array
        Filled, for all blades, with thrust (N), torque (N m), H and Y force (N), cosine and sine of the aerodynamic
        moment int r F_z (N m), and induced, profile and axial power (W). The last two
        are cos 2 psi and sin 2 psi of the thrust of one blade (N).
    annuli : (stations, 3) array
        Filled with swirl u_t (m/s), Prandtl's factor, and the mean drag of all blades along the motion (N/m).
    """
    speed, edgewise, count = point.speed_rad_s, point.edgewise_m_s, trig.shape[0]
    for k in range(totals.size):
        totals[k] = 0.0
    row_scale = blade.rows_per_log_reynolds
    for i in range(blade.r_m.size):
        r, chord, dr = blade.r_m[i], blade.chord_m[i], blade.dr_m[i]
        stream, around = 0.0, 0.0
        for n in range(count):
            stream += point.stream_m_s[n, i] / count
            around += point.swirl_m_s[n, i] / count
        swirl, loss, lift_share = compute_annulus_swirl_and_losses(blade, point, i, inflow[i], stream, around, share)
        annuli[i, ANNULUS_SWIRL], annuli[i, ANNULUS_LOSS], annuli[i, ANNULUS_DRAG] = swirl, loss, 0.0
        half = 0.5 * point.density_kg_m3 * chord
        row_zero = row_scale * (math.log(chord / point.kinematic_viscosity_m2_s) - blade.log_reynolds_min)
        weight = blade.blade_count * dr / count
        for n in range(count):
            c, s, c2, s2 = (
                trig[n, FORCE_COS],
                trig[n, FORCE_SIN],
                trig[n, FORCE_COS_2],
                trig[n, FORCE_SIN_2],
            )
            along = edgewise * c
            flap = (
                x[UNKNOWN_CONING]
                + x[UNKNOWN_FLAP_COS] * c
                + x[UNKNOWN_FLAP_SIN] * s
                + x[UNKNOWN_FLAP_COS_2] * c2
                + x[UNKNOWN_FLAP_SIN_2] * s2
            )
            flapping = speed * (
                x[UNKNOWN_FLAP_SIN] * c
                - x[UNKNOWN_FLAP_COS] * s
                + 2.0 * (x[UNKNOWN_FLAP_SIN_2] * c2 - x[UNKNOWN_FLAP_COS_2] * s2)
            )
            around_here = point.swirl_m_s[n, i] - swirl
            across = speed * r + edgewise * s + around_here
            made = inflow[i] + speed * r * (x[UNKNOWN_INFLOW_COS] * c + x[UNKNOWN_INFLOW_SIN] * s) + induced[n, i]
            met = made + point.stream_m_s[n, i]
            down = (
                point.axial_m_s + met + along * flap
                + r * (flapping - point.roll_rate_rad_s * s - point.pitch_rate_rad_s * c)
            )  # fmt: skip
            theta = blade.twist_rad[i] + point.collective_rad + point.cyclic_cos_rad * c + point.cyclic_sin_rad * s
            force, turn, _, radial, cd, _, _, _, _ = compute_element_forces(
                blade.section_table[i], theta, across, down, half, row_zero, row_scale, lift_share
            )
            outward = radial * along - force * flap
            wind = math.sqrt(across * across + down * down)
            fields[n, i, FIELD_INDUCED_VELOCITY] = made
            onset = theta - math.atan2(down, across)
            fields[n, i, FIELD_ONSET_ANGLE] = (onset + math.pi) % (2.0 * math.pi) - math.pi
            fields[n, i, FIELD_LIFT] = (force * across + turn * down) / (half * wind**3 + 1e-300)
            fields[n, i, FIELD_DRAG] = cd
            fields[n, i, FIELD_REYNOLDS] = wind * chord / point.kinematic_viscosity_m2_s
            fields[n, i, FIELD_THRUST] = force
            totals[ROTOR_THRUST] += weight * force
            totals[ROTOR_TORQUE] += weight * turn * r
            totals[ROTOR_H_FORCE] += weight * (turn * s + outward * c)
            totals[ROTOR_Y_FORCE] += weight * (outward * s - turn * c)
            totals[ROTOR_MOMENT_COS] += weight * force * r * c
            totals[ROTOR_MOMENT_SIN] += weight * force * r * s
            totals[ROTOR_INDUCED_POWER] += weight * (force * met - turn * around_here)
            totals[ROTOR_PROFILE_POWER] += weight * (radial * wind * wind + radial * along * along)
            totals[ROTOR_CLIMB_POWER] += weight * force * point.axial_m_s
            totals[ROTOR_THRUST_COS_2] += 2.0 * dr / count * force * c2
            totals[ROTOR_THRUST_SIN_2] += 2.0 * dr / count * force * s2
            annuli[i, ANNULUS_DRAG] += blade.blade_count / count * radial * across
