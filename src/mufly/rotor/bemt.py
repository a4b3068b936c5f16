"""Blade element momentum theory: thrust, torque and power of a rotor in hover, climb and descent.

Each station has one unknown, which is always bracketed. One point or a batch is solved. Coefficients are Leishman's:
c_T = T / (rho pi R^4 Omega^2), c_Q = Q / (rho pi R^5 Omega^2); the figure of merit is T sqrt(T / (2 rho A)) / P.

At radius r the blade meets V (axial, positive in climb) and Omega r. U and phi_U are magnitude and angle of their sum.
The induced velocity u_n stands at right angles to the relative wind W (Betz; a lifting line induces no velocity along
W). With phi the angle of W against the disc, all velocities follow from phi alone:

    W = U cos(phi - phi_U)         u_n = U sin(phi - phi_U)        axial u = u_n cos phi, swirl u_t = u_n sin phi

Blade: the section works at alpha, phi = theta - alpha - e c_l(alpha) (e c_l: finite chord, see
:mod:`mufly.rotor.blading`). Momentum through the annulus with loss factor F, lift only (profile drag leaves no bound
vorticity):

    N c W^2 c_l cos phi / 2 = 4 pi r F |V + u| u  =>  u_h^2 = N c W^2 c_l cos phi / (8 pi r F),   u = u_h g(V / u_h)

g is 1 in hover and -x/2 + sqrt(x^2/4 + 1) in climb. Momentum theory has no solution in descent between x = 0 and -2.
There g is the polynomial through measurements of Leishman, eq. 2.99, with the last term adjusted so that g = 1 at
x = -2, where it meets the windmill branch -x/2 - sqrt(x^2/4 - 1). Negative lift is the mirror image.

Residual: R(alpha) = u_n - u / cos phi. With e = 0 it is -U at phi = phi_U - pi/2 and +U at phi_U + pi/2, because W and
the blade force vanish there. At phi = phi_U it has the sign of -c_l. This sign selects the half that contains a root,
and Illinois steps with bisection find it. With e > 0 the root lies between the zero-lift angle (R has the sign of
theta - alpha_0 - phi_U) and alpha = theta - phi_U (R has the sign of -c_l). These signs agree at angles beyond maximum
lift; e is then set to 0 for that station.

Compressible flow, at the Mach number of the wind W:
:func:`mufly.rotor.sections.section_coefficients.equivalent_incompressible_alpha`.

Forces per span:  dT = rho/2 W^2 c N (c_l cos phi - c_d sin phi),  dQ = rho/2 W^2 c N (c_l sin phi + c_d cos phi) r.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError
from mufly.results import result
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.rotor_system import Air, PlacedRotor, RotorResult
from mufly.rotor.sections.polar_table import PolarStack, flag_extrapolated_stack_points
from mufly.rotor.sections.section_coefficients import PolarGrid, SectionParameters, section_coefficients
from mufly.rotor.validity_checks import RotorValidityWarning, check_pitch, compute_tip_mach, warn_tip_mach

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Stream = tuple[Array, Array, Array]

_TIP_LOSS_CODES = {"none": 0, "prandtl": 1, "effective_radius": 2}
_MIN_CASES_PER_THREAD = 128  # cases per thread below which a second thread does not pay
# Columns of the station table.
STATION_COLUMNS = (
    "alpha_rad",
    "phi_rad",
    "axial_induced_m_s",
    "swirl_m_s",
    "cl",
    "cd",
    "reynolds",
    "loss",
    "dT_N",
    "dQ_Nm",
)
_MAX_ITERATIONS = 80
_ROOT_TOLERANCE_RAD = 1e-10  # rad


@result(eq=False)
class BatchResult:
    """Loads of many operating points; every array has the shape of the broadcast inputs.

    Attributes
    ----------
    thrust_N, torque_Nm, power_W, figure_of_merit, c_T, c_Q : arrays
        Values of the whole rotor, as in a :class:`RotorResult`.
    """

    thrust_N: Array
    torque_Nm: Array
    power_W: Array
    figure_of_merit: Array
    c_T: Array
    c_Q: Array


def _compute_power_and_coefficients(
    thrust: Any, torque: Any, speed: Any, radius: Any, density: float
) -> dict[str, Any]:
    """Return power (W), figure of merit, c_T and c_Q; scalars or arrays."""
    power, area = torque * speed, math.pi * radius**2
    scale = density * area * radius**2 * speed**2
    useful = (thrust > 0.0) & (power > 0.0)
    lift = np.where(useful, thrust, 0.0)
    ideal = lift * np.sqrt(lift / (2.0 * density * area))
    return {
        "power_W": power,
        "figure_of_merit": np.where(useful, ideal / np.where(useful, power, 1.0), np.nan)[()],
        "c_T": thrust / scale,
        "c_Q": torque / (scale * radius),
    }


def _check_operating_points(pitch: Array, speed: Array, climb: Array) -> None:
    check_pitch("rotor", "pitch_rad", pitch)
    for name, values, least, remedy in (
        ("speed_rad_s", speed, 0.0, "give a number above 0"),
        ("climb_m_s", climb, -math.inf, "give a finite number"),
    ):
        bad = ~(np.isfinite(values) & (values > least))
        if np.any(bad):
            raise InputError("rotor", name, f"is {values[bad].flat[0]:g}", remedy)


def _solve_points(
    blading: Blading,
    which: ArrayLike,
    pitch: Array,
    speed: Array,
    climb: Array,
    air: Air,
    keep: bool,
    stream: Stream | None = None,
) -> tuple[Array, Array]:
    n, fixes = pitch.size, blading.corrections
    cases = BemtCases(
        np.broadcast_to(np.asarray(which, dtype=np.int64), pitch.shape).flatten(),
        pitch,
        speed,
        climb,
        np.empty((0, 0, 3)) if stream is None else np.stack(stream, axis=-1)[None],
        float(air.density_kg_m3),
        float(air.viscosity_Pa_s / air.density_kg_m3),
        float(air.sound_m_s),
    )
    on = CorrectionSwitches(
        _TIP_LOSS_CODES[fixes.tip_loss],
        int(fixes.hub_loss),
        int(fixes.swirl),
        int(fixes.stall_delay == "chaviaropoulos-hansen"),
        float(fixes.lift_factor),
        float(fixes.drag_factor),
    )
    totals = np.empty((n, 2))
    stations = np.empty((n if keep else 0, blading.r_m.shape[1], len(STATION_COLUMNS)))
    args = (cases, blading.kernel_arrays, on, totals, stations)
    workers = min(os.cpu_count() or 1, n // _MIN_CASES_PER_THREAD) if n >= 2 * _MIN_CASES_PER_THREAD else 1
    if workers < 2:
        solve_cases(0, n, *args)
    else:
        # The kernel releases the GIL; plain threads also work when the caller is itself a thread.
        bounds = np.linspace(0, n, 4 * workers + 1).astype(int)
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(lambda k: solve_cases(int(bounds[k]), int(bounds[k + 1]), *args), range(4 * workers)))
    return totals, stations


def _flag_extrapolated_stations(blading: Blading, which: int, alpha: Array, reynolds: Array) -> NDArray[np.uint8]:
    """Flag the stations of one rotor outside their polars' range; a mixed section is outside if either polar is."""
    both, weight = np.stack((blading.first_polar[which], blading.second_polar[which])), blading.second_weight[which]
    first, second = flag_extrapolated_stack_points(blading.polars, both, alpha, reynolds)
    flags: NDArray[np.uint8] = first * (weight < 1.0) | second * (weight > 0.0)
    return flags


_REYNOLDS_STATION_RATIO = 0.75  # r/R at which a blade's Reynolds number is reported


def warn_reynolds_range(blading: Blading, which: ArrayLike, speed_rad_s: ArrayLike, air: Air) -> None:
    """Issue a :class:`RotorValidityWarning` if the Reynolds number at 0.75 R lies outside the range of the polar.

    Parameters
    ----------
    blading : Blading
    which : array_like of int
        Rotor of each point.
    speed_rad_s : array_like
    air : Air
    """
    rotors = np.arange(len(blading.rotors))
    station = np.argmin(np.abs(blading.r_m - _REYNOLDS_STATION_RATIO * blading.radius_m[:, None]), axis=1)
    size = blading.r_m[rotors, station] * blading.chord_m[rotors, station]
    speed = np.asarray(speed_rad_s, dtype=np.float64)
    reynolds = size[np.asarray(which)] * speed * air.density_kg_m3 / air.viscosity_Pa_s
    spans = np.exp(blading.polars.log_reynolds_limits[blading.first_polar[rotors, station]])
    low, high = spans[np.asarray(which)].T.reshape(2, *reynolds.shape)
    beyond = np.flatnonzero((reynolds < low) | (reynolds > high))
    if beyond.size:
        least, most = float(reynolds.flat[beyond].min()), float(reynolds.flat[beyond].max())
        at = f"{least:.3g}" if most < 1.005 * least else f"{least:.3g} to {most:.3g}"
        lowest, highest = float(low.flat[beyond[0]]), float(high.flat[beyond[0]])
        table = f"{lowest:.3g}" if highest < 1.005 * lowest else f"{lowest:.3g} to {highest:.3g}"
        warnings.warn(
            f"the Reynolds number at {_REYNOLDS_STATION_RATIO:g} R, {at}, is beyond that of its polar, {table}: the "
            "coefficients are those of the polar's edge",
            RotorValidityWarning, stacklevel=3,
        )  # fmt: skip


def solve_rotor(
    blading: Blading | Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    which: int = 0,
    stream: Stream | None = None,
) -> RotorResult:
    """Compute the loads of one rotor at one operating point.

    Parameters
    ----------
    blading : Blading or Rotor
        From :func:`mufly.rotor.blading.prepare_blading`; a rotor is prepared with all defaults at every call.
    pitch_rad : float
        Pitch setting, added to the twist (rad).
    speed_rad_s : float
        Rotor speed (rad/s), above 0.
    climb_m_s : float
        Axial speed of the rotor through the air (m/s), positive in climb; 0 is hover.
    air : Air, optional
        Density and viscosity.
    which : int
        Index of the rotor in the blading.
    stream : (axial, tangential, wake), optional
        Velocity of the air at each station due to another rotor, (stations,) arrays (m/s). ``axial`` points down
        through the disc, ``tangential`` against the blade's motion. ``wake`` is the part of ``axial`` that the momentum
        balance counts as flow through the annulus: all of it, or none if :mod:`mufly.rotor.vortex_tube` models its
        effect on the wake.

    Raises
    ------
    InputError
        If the speed is not above zero or a number is not finite.
    """
    placed = PlacedRotor(ensure_blading(blading), float(pitch_rad), float(speed_rad_s), index_in_blading=which)
    return solve_placed_rotor(placed, float(climb_m_s), air or Air(), stream)


def solve_placed_rotor(placed: PlacedRotor, climb_m_s: float, air: Air, stream: Stream | None = None) -> RotorResult:
    """Solve one rotor of a system at its place, pitch and speed; ``stream`` and errors are those of
    :func:`solve_rotor`.
    """
    point = _operating_point_arrays(placed, climb_m_s)
    _check_operating_points(*point)
    totals, stations = _solve_points(placed.blading, placed.index_in_blading, *point, air, True, stream)
    columns = {name: stations[0, :, i].copy() for i, name in enumerate(STATION_COLUMNS)}
    return build_rotor_result(placed, climb_m_s, air, float(totals[0, 0]), float(totals[0, 1]), columns)


def _operating_point_arrays(placed: PlacedRotor, climb_m_s: float) -> tuple[Array, Array, Array]:
    return np.array([placed.pitch_rad]), np.array([placed.speed_rad_s]), np.array([climb_m_s])


def build_rotor_result(
    placed: PlacedRotor,
    climb_m_s: float,
    air: Air,
    thrust_N: float,
    torque_Nm: float,
    columns: Mapping[str, Any],
) -> RotorResult:
    """Assemble the result of an operating point from thrust, torque and station table (``STATION_COLUMNS``).

    Thesis: eqs 3.3 to 3.5.
    """
    blading, which, speed_rad_s = placed.blading, placed.index_in_blading, placed.speed_rad_s
    radius = blading.rotors[which].radius_m
    coefficients = _compute_power_and_coefficients(thrust_N, torque_Nm, speed_rad_s, radius, air.density_kg_m3)
    flags = _flag_extrapolated_stations(blading, which, columns["alpha_rad"], columns["reynolds"])
    size = np.abs(columns["dT_N"])
    return RotorResult(
        pitch_rad=placed.pitch_rad,
        speed_rad_s=speed_rad_s,
        climb_m_s=climb_m_s,
        thrust_N=thrust_N,
        torque_Nm=torque_Nm,
        **coefficients,
        r_m=blading.r_m[which],
        dr_m=blading.dr_m[which],
        chord_m=blading.chord_m[which],
        theta_rad=blading.twist_rad[which] + placed.pitch_rad,
        **columns,
        outside=flags,
        outside_share=float(size[flags > 0].sum() / size.sum()) if size.sum() > 0 else 0.0,
        calibrated=blading.is_calibrated,
    )


_MIN_THROUGHFLOW_RATIO = 0.2  # of the greatest axial velocity through a disc: least that convects swirl of drag
_MAX_DRAG_SWIRL_NUMBER = 0.6  # of the swirl of drag; beyond it a jet breaks down


def compute_drag_swirl_momentum(
    pull_N_m: Array, down_m_s: Array, density_kg_m3: float, r_m: Array, dr_m: Array
) -> Array:
    """Return the moment of momentum r u (m^2/s), (stations,), that profile drag per span adds to the slipstream.

    Vortices represent only the swirl that comes with lift. The torque of the profile drag also adds angular momentum to
    the air of each annulus. With v the axial velocity down through the annulus (mean over azimuth) and D' = N rho/2 W^2
    c c_d cos(phi) the drag of all N blades per span:

        rho v 2 pi r dr  r u = D' r dr                                        (moment of momentum; own derivation)

    Annuli with little axial flow, as at the root, convect no swirl downstream. The swirl number of the whole stream is

        S = sum D' r dr / (R sum rho v^2 2 pi r dr)                                            (v > 0; R: the tip)

    A jet with S above 0.6 breaks down (Gupta, Lilley, Syred, Swirl Flows, 1984, ch. 1), and mixing consumes its swirl.
    Then r u is multiplied by 0.6 / S: a rotor that moves no air down leaves no swirl below it (own assumption).
    """
    least = _MIN_THROUGHFLOW_RATIO * float(np.max(np.abs(down_m_s))) + 1e-9
    turning: Array = pull_N_m / (2.0 * math.pi * density_kg_m3 * np.maximum(down_m_s, least))
    momentum = 2.0 * math.pi * density_kg_m3 * float(np.sum(np.maximum(down_m_s, 0.0) ** 2 * r_m * dr_m))
    torque = float(np.sum(pull_N_m * r_m * dr_m))
    allowed = _MAX_DRAG_SWIRL_NUMBER * float(np.max(r_m + 0.5 * dr_m)) * momentum
    return turning if torque <= allowed else turning * (allowed / torque)


def compute_slipstream(
    placed: PlacedRotor, climb_m_s: float, air: Air, stream: Stream, turns: bool = True
) -> tuple[Array, Array, Array]:
    """Return axial velocity at the blades (m/s), Prandtl's factor F, and moment of momentum of the slipstream (m^2/s).

    The moment of momentum r u is the radius times the swirl velocity.

    All are (stations,) arrays. Lift contributes twice the mean tangential velocity F u_t in the disc, profile drag
    :func:`compute_drag_swirl_momentum`. Without the swirl correction, or with ``turns`` false, r u is zero.
    """
    blading, which = placed.blading, placed.index_in_blading
    _, stations = _solve_points(blading, which, *_operating_point_arrays(placed, climb_m_s), air, True, stream)
    _, phi, inflow, swirl, cl, cd, _, loss, thrust, torque = stations[0].T
    turning = np.zeros_like(inflow)
    if turns and blading.corrections.swirl:
        r, dr = blading.r_m[which], blading.dr_m[which]
        force = np.hypot(thrust, torque / r) / np.hypot(cl, cd)  # force per unit coefficient
        pull = force / dr * cd * np.cos(phi)
        turning = 2.0 * loss * swirl * r + compute_drag_swirl_momentum(
            pull, climb_m_s + stream[0] + loss * inflow, air.density_kg_m3, r, dr
        )
    return inflow, loss, turning


def solve_rotor_batch(
    blading: Blading | Rotor,
    *,
    pitch_rad: ArrayLike,
    speed_rad_s: ArrayLike,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
    which: ArrayLike = 0,
) -> BatchResult:
    """Compute many operating points on all cores; the results equal those of :func:`solve_rotor` bit for bit.

    Parameters
    ----------
    blading : Blading or Rotor
        One or several rotors.
    pitch_rad, speed_rad_s, climb_m_s : array_like
        As for :func:`solve_rotor`, broadcast against each other and ``index_in_blading``.
    air : Air, optional
        Density and viscosity of all points.
    which : array_like of int
        Rotor of each point.

    Raises
    ------
    InputError
        If a speed is not above zero, a number is not finite or a rotor does not exist.
    """
    gas, blading = air or Air(), ensure_blading(blading)
    *points, which_rotor = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (pitch_rad, speed_rad_s, climb_m_s)), np.asarray(which)
    )
    shape = which_rotor.shape
    _check_operating_points(*points)
    index = which_rotor.astype(np.int64).ravel()
    if index.size and (index.min() < 0 or index.max() >= len(blading.rotors)):
        raise InputError(
            "rotor",
            "which",
            f"has an index out of range: there are {len(blading.rotors)} rotors",
            "give indices from 0",
        )
    pitch, speed, climb = (v.flatten() for v in points)
    totals, _ = _solve_points(blading, index, pitch, speed, climb, gas, False)
    thrust, torque = totals[:, 0], totals[:, 1]
    radius = blading.radius_m[index]
    if index.size:
        warn_tip_mach(compute_tip_mach(1.0, float(np.max(np.hypot(radius * speed, climb))), gas))
    values = {"thrust_N": thrust, "torque_Nm": torque}
    values |= _compute_power_and_coefficients(thrust, torque, speed, radius, gas.density_kg_m3)
    return BatchResult(**{name: v.reshape(shape) for name, v in values.items()})


# The kernel


class BemtCases(NamedTuple):
    """Operating points to be solved.

    Attributes
    ----------
    index_in_blading : (cases,) ints
        Rotor of each case: first index of the arrays of the blades.
    pitch_rad, speed_rad_s, climb_m_s : (cases,) arrays
        Speeds above 0.
    stream_m_s : (cases, stations, 3) array or (0, ...)
        Axial (down) and tangential (against the blade) velocity due to another rotor, and the part of the axial
        velocity that momentum theory counts as V.
    density_kg_m3, kinematic_viscosity_m2_s, speed_of_sound_m_s : float
        Properties of the air.
    """

    index_in_blading: Integers
    pitch_rad: Array
    speed_rad_s: Array
    climb_m_s: Array
    stream_m_s: Array
    density_kg_m3: float
    kinematic_viscosity_m2_s: float
    speed_of_sound_m_s: float


class CorrectionSwitches(NamedTuple):
    """Corrections of blade element theory, encoded as numbers for the compiled solver.

    Attributes
    ----------
    tip_loss_code : int
        0 none, 1 Prandtl, 2 effective radius.
    has_hub_loss, has_swirl, has_cos4_stall_delay : int
        1 if hub loss, swirl and the factor cos^4 theta on the strength of stall delay are active.
    lift_factor, drag_factor : float
        Factors on the section coefficients.
    """

    tip_loss_code: int
    has_hub_loss: int
    has_swirl: int
    has_cos4_stall_delay: int
    lift_factor: float
    drag_factor: float


@cached_njit(error_model="numpy")
def induced_velocity_ratio(x: float) -> float:
    """Return the ratio g(x) of induced velocity to induced velocity in hover at x = V / u_h, continuous for all x."""
    if x >= 0.0:
        return -0.5 * x + math.sqrt(0.25 * x * x + 1.0)
    if x > -2.0:
        quartic = 1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x)))
        return quartic - 0.026 * (0.5 * x) ** 4  # Leishman's constants give 1.026 at x = -2
    return -0.5 * x - math.sqrt(max(0.25 * x * x - 1.0, 0.0))


@cached_njit(error_model="numpy")
def _prandtl_loss(f: float) -> float:
    """Return Prandtl's loss factor F(f); above f = 37 it is exactly 1."""
    return 2.0 / math.pi * math.acos(math.exp(-f)) if f < 37.0 else 1.0


class StationGeometry(NamedTuple):
    """Geometry of a station: radius and chord (m), pitch theta (rad), number of blades, R and hub radius (m)."""

    r_m: float
    chord_m: float
    pitch_rad: float
    blade_count: float
    rotor_radius_m: float
    hub_radius_m: float


class StationFlow(NamedTuple):
    """Onset flow of a station: axial velocity (m/s), total speed (m/s) and inflow angle (rad), log Re, Mach number."""

    axial_m_s: float
    speed_m_s: float
    inflow_angle_rad: float
    log_reynolds: float
    mach: float


@cached_njit(error_model="numpy")
def _compute_momentum_residual(
    alpha: float,
    e: float,
    flow: StationFlow,
    at: StationGeometry,
    section: SectionParameters,
    polars: PolarStack,
    on: CorrectionSwitches,
) -> Any:
    """Return the residual R of the momentum balance, then phi, c_l, c_d, W, F, u, u_t and log Re (module docstring).

    Thesis: eqs 3.11, 3.12.
    """
    speed = flow.speed_m_s
    part = max(math.cos(at.pitch_rad - alpha - flow.inflow_angle_rad), 1e-3)
    log_re = flow.log_reynolds + math.log(part)
    cl, cd = section_coefficients(alpha, log_re, flow.mach * part, section, polars)
    phi = at.pitch_rad - alpha - e * cl
    turn = phi - flow.inflow_angle_rad
    if turn >= 0.5 * math.pi:
        return speed, phi, cl, cd, 0.0, 1.0, speed, 0.0, log_re
    if turn <= -0.5 * math.pi:
        return -speed, phi, cl, cd, 0.0, 1.0, -speed, 0.0, log_re
    wind, normal = speed * math.cos(turn), speed * math.sin(turn)
    cosine, sine = math.cos(phi), math.sin(phi)
    loss, size = 1.0, abs(sine)
    if size > 1e-12:
        if on.tip_loss_code == 1:
            loss = _prandtl_loss(0.5 * at.blade_count * (at.rotor_radius_m - at.r_m) / (at.r_m * size))
        if on.has_hub_loss == 1 and at.hub_radius_m > 0.0:
            loss *= _prandtl_loss(0.5 * at.blade_count * (at.r_m - at.hub_radius_m) / (at.hub_radius_m * size))
        loss = max(loss, 1e-6)
    if on.has_swirl == 0 and cosine > 1e-9:
        wind = speed * math.cos(flow.inflow_angle_rad) / cosine
    load = at.blade_count * at.chord_m * wind * wind * cl * cosine / (8.0 * math.pi * at.r_m * loss)
    hover = math.sqrt(abs(load))
    momentum = 0.0
    if hover > 0.0:
        sign = 1.0 if load > 0.0 else -1.0
        momentum = sign * hover * induced_velocity_ratio(sign * flow.axial_m_s / hover)
    if on.has_swirl == 0:
        axial = normal
        u = axial / cosine if cosine > 1e-9 else 0.0
        return axial - momentum * cosine, phi, cl, cd, wind, loss, u, 0.0, log_re
    over = cosine if abs(cosine) > 1e-9 else math.copysign(1e-9, cosine)
    return normal - momentum / over, phi, cl, cd, wind, loss, normal * cosine, normal * sine, log_re


@cached_njit(error_model="numpy")
def _solve_station(
    e: float,
    flow: StationFlow,
    at: StationGeometry,
    section: SectionParameters,
    polars: PolarStack,
    on: CorrectionSwitches,
) -> Any:
    """Solve one station; return alpha and the values at the root.

    Thesis: eqs 3.6 to 3.10.
    """
    speed = flow.speed_m_s
    middle = at.pitch_rad - flow.inflow_angle_rad
    b = x = middle
    out = _compute_momentum_residual(b, e, flow, at, section, polars, on)
    a, fa, fb = b, out[0], out[0]
    if e > 0.0:
        a = section.polar_zero_lift_rad
        fa = _compute_momentum_residual(a, e, flow, at, section, polars, on)[0]
        if fa * fb > 0.0 or abs(a - b) > 0.5 * math.pi:
            e = 0.0
            out = _compute_momentum_residual(b, e, flow, at, section, polars, on)
            fb = out[0]
    if e <= 0.0:
        # phi grows as alpha falls: R < 0 at phi_U puts the root at smaller alpha.
        a = middle - 0.5 * math.pi if fb < 0.0 else middle + 0.5 * math.pi
        fa = -speed if fb > 0.0 else speed  # where W vanishes
    side, width = 0, abs(b - a)
    for step in range(_MAX_ITERATIONS):
        if abs(out[0]) <= _ROOT_TOLERANCE_RAD * speed:
            break
        x = b - fb * (b - a) / (fb - fa)
        if step % 3 == 2:  # bisect at every third step
            if abs(b - a) > 0.5 * width:
                x = 0.5 * (a + b)
            width = abs(b - a)
        out = _compute_momentum_residual(x, e, flow, at, section, polars, on)
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
        if abs(b - a) < _ROOT_TOLERANCE_RAD:
            break
    return x, out


@cached_njit(nogil=True, error_model="numpy")
def solve_cases(
    start: int,
    stop: int,
    cases: BemtCases,
    blades: Any,
    on: CorrectionSwitches,
    totals: Array,
    stations: Array,
) -> None:
    """Compute thrust and torque of the cases ``start`` to ``stop``.

    Parameters
    ----------
    cases : BemtCases
    blades : mufly.rotor.blading.Blades
        Arrays of the blades, from ``Blading.kernel_arrays``.
    on : CorrectionSwitches
    totals : (cases, 2) array
        Filled with thrust (N) and torque (N m).
    stations : (cases, stations, 10) array or (0, ...)
        Filled with :data:`STATION_COLUMNS` unless its first axis is empty.
    """
    density, stack = cases.density_kg_m3, blades.polars
    polars = PolarGrid(stack.grid, stack.log_reynolds_min, stack.rows_per_log_reynolds)
    keep, meets = stations.shape[0] > 0, cases.stream_m_s.shape[0] > 0
    for case in range(start, stop):
        k = cases.index_in_blading[case]
        pitch, speed, climb = cases.pitch_rad[case], cases.speed_rad_s[case], cases.climb_m_s[case]
        count, radius = blades.blades[k], blades.radius_m[k]
        effective = radius
        # The effective radius depends on the mean inflow: four passes settle it to 1e-4 R.
        for _ in range(4 if on.tip_loss_code == 2 else 1):
            thrust, torque, inflow, area = 0.0, 0.0, 0.0, 0.0
            for i in range(blades.r_m.shape[1]):
                r, dr, chord = blades.r_m[k, i], blades.dr_m[k, i], blades.chord_m[k, i]
                theta = pitch + blades.twist_rad[k, i]
                rotation = blades.stall_delay_strength[k, i]
                if on.has_cos4_stall_delay == 1:
                    rotation *= math.cos(theta) ** 4
                share = 1.0
                if on.tip_loss_code == 2:
                    share = min(max((effective - r) / dr + 0.5, 0.0), 1.0)
                first, second, weight = blades.first_polar[k, i], blades.second_polar[k, i], blades.second_weight[k, i]
                zero = blades.polar_zero_lift_rad[first]
                zero += weight * (blades.polar_zero_lift_rad[second] - zero)
                thick = blades.polar_thickness_ratio[first]
                thick += weight * (blades.polar_thickness_ratio[second] - thick)
                edge = blades.edge_drag[k, i]
                section = SectionParameters(
                    first, second, weight, zero, rotation, on.lift_factor * share, on.drag_factor, thick, edge
                )
                at = StationGeometry(r, chord, theta, count, radius, blades.hub_radius_m[k])
                axial, across, carried = climb, speed * r, climb
                if meets:
                    axial += cases.stream_m_s[case, i, 0]
                    across += cases.stream_m_s[case, i, 1]
                    carried += cases.stream_m_s[case, i, 2]
                total = math.hypot(axial, across)
                log_unit = math.log(max(total * chord / cases.kinematic_viscosity_m2_s, 1e-3))
                flow = StationFlow(
                    carried, total, math.atan2(axial, across), log_unit, total / cases.speed_of_sound_m_s
                )
                alpha, out = _solve_station(blades.angle_loss_per_cl_rad[k, i], flow, at, section, polars, on)
                _, phi, cl, cd, wind, loss, u, u_t, log_re = out
                push = 0.5 * density * wind * wind * chord * count * dr
                d_thrust = push * (cl * math.cos(phi) - cd * math.sin(phi))
                d_torque = push * (cl * math.sin(phi) + cd * math.cos(phi)) * r
                thrust += d_thrust
                torque += d_torque
                inflow += u * r * dr
                area += r * dr
                if keep:
                    column = (alpha, phi, u, u_t, cl, cd, math.exp(log_re), loss, d_thrust, d_torque)
                    for c, value in enumerate(column):
                        stations[case, i, c] = value
            if on.tip_loss_code == 2:
                lam = max(inflow / area + climb, 0.0) / (speed * radius)
                effective = radius * (1.0 - 1.386 / count * lam / math.sqrt(1.0 + lam * lam))
        totals[case, 0], totals[case, 1] = thrust, torque
