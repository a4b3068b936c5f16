"""Forces of a blade element at an azimuth, and swirl and losses of an annulus (Numba).

Symbols and equations: :mod:`mufly.rotor.forward.azimuth_kernel`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit

Array = NDArray[np.float64]

_TABLE_CELLS_PER_RAD = 720.0 / (2.0 * math.pi)  # cells of a section table per radian


class AzimuthBlade(NamedTuple):
    """Rotor as arrays and numbers for the compiled solver over azimuth.

    Attributes
    ----------
    r_m, dr_m, chord_m, twist_rad : (stations,) arrays
    section_table : (stations, Reynolds numbers, 723, 2) array
        :func:`mufly.rotor.forward.section_tables.tabulate_section_coefficients`.
    log_reynolds_min, rows_per_log_reynolds : float
        Grid of the tables.
    blade_count, radius_m, hub_radius_m : float
    has_tip_loss, has_hub_loss, has_swirl : int
        1 if the correction is active.
    flap_inertia_about_shaft_kg_m2 : float
        Moment of inertia of a blade about the shaft.
    flap_ratio : float
        nu; infinite for blades that do not flap.
    """

    r_m: Array
    dr_m: Array
    chord_m: Array
    twist_rad: Array
    section_table: Array
    log_reynolds_min: float
    rows_per_log_reynolds: float
    blade_count: float
    radius_m: float
    hub_radius_m: float
    has_tip_loss: int
    has_hub_loss: int
    has_swirl: int
    flap_inertia_about_shaft_kg_m2: float
    flap_ratio: float


class AzimuthPoint(NamedTuple):
    """Operating point in wind axes for the compiled solver over azimuth.

    Attributes
    ----------
    speed_rad_s, edgewise_m_s, axial_m_s : float
        Omega, V and V_z.
    collective_rad, cyclic_cos_rad, cyclic_sin_rad : float
        th0, th1c, th1s.
    roll_rate_rad_s, pitch_rate_rad_s : float
        p and q.
    density_kg_m3, kinematic_viscosity_m2_s : float
    stream_m_s, swirl_m_s : (azimuths, stations) arrays
        Velocity of the air due to another rotor: down through the disc, and against the motion of the blades.
    inflow_code : int
        A value of :data:`mufly.rotor.forward.azimuth_kernel.INFLOW_CODES`.
    """

    speed_rad_s: float
    edgewise_m_s: float
    axial_m_s: float
    collective_rad: float
    cyclic_cos_rad: float
    cyclic_sin_rad: float
    roll_rate_rad_s: float
    pitch_rate_rad_s: float
    density_kg_m3: float
    kinematic_viscosity_m2_s: float
    stream_m_s: Array
    swirl_m_s: Array
    inflow_code: int


@cached_njit(error_model="numpy")
def _interpolate_section_coefficients(
    table: Array, onset: float, row: float
) -> tuple[float, float, float, float, float, float]:
    """Interpolate c_l and c_d of a station: cubic in the onset angle, linear between Reynolds numbers.

    Returns c_l and c_d, their slopes over the angle (1/rad), and their slopes over the row.
    """
    u = (onset + math.pi) * _TABLE_CELLS_PER_RAD
    u -= 720.0 * math.floor(u / 720.0)
    i = int(u)
    if i >= 720:
        i, u = 0, 0.0
    t = u - i
    t2, t3 = t * t, t * t * t
    w0, w1 = 0.5 * (-t3 + 2.0 * t2 - t), 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)
    w2, w3 = 0.5 * (-3.0 * t3 + 4.0 * t2 + t), 0.5 * (t3 - t2)
    d0, d1 = 0.5 * (-3.0 * t2 + 4.0 * t - 1.0), 0.5 * (9.0 * t2 - 10.0 * t)
    d2, d3 = 0.5 * (-9.0 * t2 + 8.0 * t + 1.0), 0.5 * (3.0 * t2 - 2.0 * t)
    last = table.shape[0] - 1
    v = min(max(row, 0.0), float(last))
    j = min(int(v), max(last - 1, 0))
    s = v - j
    k = min(j + 1, last)
    before, left, right, after = i, i + 1, i + 2, i + 3
    l0, l1, l2, l3 = table[j, before, 0], table[j, left, 0], table[j, right, 0], table[j, after, 0]
    m0, m1, m2, m3 = table[k, before, 0], table[k, left, 0], table[k, right, 0], table[k, after, 0]
    cl, cl2 = w0 * l0 + w1 * l1 + w2 * l2 + w3 * l3, w0 * m0 + w1 * m1 + w2 * m2 + w3 * m3
    dl, dl2 = d0 * l0 + d1 * l1 + d2 * l2 + d3 * l3, d0 * m0 + d1 * m1 + d2 * m2 + d3 * m3
    l0, l1, l2, l3 = table[j, before, 1], table[j, left, 1], table[j, right, 1], table[j, after, 1]
    m0, m1, m2, m3 = table[k, before, 1], table[k, left, 1], table[k, right, 1], table[k, after, 1]
    cd, cd2 = w0 * l0 + w1 * l1 + w2 * l2 + w3 * l3, w0 * m0 + w1 * m1 + w2 * m2 + w3 * m3
    dd, dd2 = d0 * l0 + d1 * l1 + d2 * l2 + d3 * l3, d0 * m0 + d1 * m1 + d2 * m2 + d3 * m3
    inside = 1.0 if 0.0 <= row <= last else 0.0
    return (
        cl + s * (cl2 - cl), cd + s * (cd2 - cd),
        _TABLE_CELLS_PER_RAD * (dl + s * (dl2 - dl)), _TABLE_CELLS_PER_RAD * (dd + s * (dd2 - dd)),
        inside * (cl2 - cl), inside * (cd2 - cd),
    )  # fmt: skip


@cached_njit(error_model="numpy")
def compute_element_forces(
    table: Array, theta: float, across: float, down: float, half_rho_c: float, row_zero: float, per_row: float,
    lift_share: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Return the forces of a blade element per span, their slopes, and c_d.

    These are F_z, F_T, lift in the axial direction, radial drag per U_R, c_d, and the slopes (N s/m^2) of F_z and of
    the lift over U_P, then over U_T.
    """
    square = across * across + down * down + 1e-12
    wind = math.sqrt(square)
    cl, cd, cl_angle, cd_angle, cl_row, cd_row = _interpolate_section_coefficients(
        table, theta - math.atan2(down, across), row_zero + per_row * 0.5 * math.log(square)
    )
    cl *= lift_share
    k = half_rho_c * wind
    lift = k * cl * across
    # The angle falls with U_P by U_T / W^2 and rises with U_T by U_P / W^2; row and W grow with both.
    along_p, along_t = down / square, across / square
    cl_p = lift_share * (per_row * along_p * cl_row - along_t * cl_angle)
    cd_p = per_row * along_p * cd_row - along_t * cd_angle
    cl_t = lift_share * (per_row * along_t * cl_row + along_p * cl_angle)
    cd_t = per_row * along_t * cd_row + along_p * cd_angle
    lift_p = k * (along_p * cl + cl_p) * across
    lift_t = k * ((along_t * cl + cl_t) * across + cl)
    return (
        lift - k * cd * down, k * (cl * down + cd * across), lift, k * cd, cd,
        lift_p - k * ((along_p * cd + cd_p) * down + cd), lift_p, lift_t - k * (along_t * cd + cd_t) * down, lift_t,
    )  # fmt: skip


@cached_njit(error_model="numpy")
def compute_annulus_swirl_and_losses(
    blade: AzimuthBlade, point: AzimuthPoint, i: int, u: float, stream: float, around: float, share: float
) -> tuple[float, float, float]:
    """Return swirl u_t (m/s), Prandtl's factor F, and the tip loss factor on the lift for the annulus of station ``i``.

    ``u`` is the mean inflow of the annulus (m/s).
    """
    r, turn = blade.r_m[i], point.speed_rad_s * blade.r_m[i] + around
    down = point.axial_m_s + stream + u
    swirl = 0.0
    if blade.has_swirl == 1:
        full = 0.5 * (turn - math.sqrt(max(turn * turn - 4.0 * u * down, 0.0)))
        swirl = share * full
    loss = 1.0
    slope = abs(down) / math.sqrt(down * down + (turn - swirl) * (turn - swirl) + 1e-300)
    if slope > 1e-9:
        if blade.has_tip_loss == 1:
            f = 0.5 * blade.blade_count * (blade.radius_m - r) / (r * slope)
            if f < 37.0:
                loss = 2.0 / math.pi * math.acos(math.exp(-f))
        if blade.has_hub_loss == 1 and blade.hub_radius_m > 0.0:
            f = 0.5 * blade.blade_count * (r - blade.hub_radius_m) / (blade.hub_radius_m * slope)
            if f < 37.0:
                loss *= 2.0 / math.pi * math.acos(math.exp(-f))
    loss = max(loss, 1e-6)
    return swirl, loss, 1.0 - (1.0 - share) * (1.0 - loss)
