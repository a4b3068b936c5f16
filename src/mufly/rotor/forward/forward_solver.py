"""Rotor in forward flight: blade elements over azimuth, one flap mode, dynamic inflow.

:func:`solve_forward` solves one point, :func:`sweep_forward` a range of airspeeds with the response to cyclic pitch.
Equations: :mod:`mufly.rotor.forward.azimuth_kernel` and docs/explanation/forward-flight.md.

A point is solved in wind axes, so that wind from any azimuth is one rotation of inputs and loads. A rotor that turns
clockwise from above is the mirror image of one that turns anticlockwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.rotor.bemt import solve_rotor
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.forward.azimuth_elements import AzimuthBlade, AzimuthPoint
from mufly.rotor.forward.azimuth_kernel import (
    FIELD_COLUMNS,
    FIELD_THRUST,
    GLOBAL_UNKNOWN_COUNT,
    INFLOW_CODES,
    NEWTON_RESIDUAL_TOLERANCE,
    ROTOR_LOAD_COUNT,
    UNKNOWN_CONING,
    UNKNOWN_FLAP_COS,
    UNKNOWN_FLAP_COS_2,
    UNKNOWN_FLAP_SIN,
    UNKNOWN_FLAP_SIN_2,
    UNKNOWN_INFLOW,
    UNKNOWN_INFLOW_COS,
    UNKNOWN_INFLOW_SIN,
    integrate_loads,
    solve_azimuth_point,
    velocity_derivative_weights,
)
from mufly.rotor.forward.forward_results import (
    CyclicResponse,
    DiscFields,
    ForwardCondition,
    ForwardResult,
    ForwardSweep,
    RigidFlapMode,
    SolverState,
)
from mufly.rotor.forward.inflow import momentum_induced_velocity
from mufly.rotor.forward.section_tables import tabulate_section_coefficients
from mufly.rotor.geometry import Rotor
from mufly.rotor.rotor_system import Air
from mufly.rotor.structure.flap_modes import ASSUMED_STRUCTURE, compute_flap_mode, make_blade_beam
from mufly.rotor.validity_checks import (
    SUPERSONIC_TIP_REMEDY,
    VORTEX_RING_DESCENT_RATIOS,
    check_pitch,
    describe_supersonic_tips,
    warn_tip_mach,
)

Array = NDArray[np.float64]
InflowModel = Literal["annular", "pitt-peters", "uniform"]

AZIMUTH_COUNT = 24
LIFT_SLOPE_PER_RAD = 5.7
"""Lift slope (1/rad) of the Lock number."""
MAX_ADVANCE_RATIO = 0.35
"""Advance ratio up to which strips and polars are sound; beyond, reversed flow covers much of the retreating side."""
_MAX_ACCEPTED_RESIDUAL = 1e-6  # of tip speed or angle, where Newton steps stall above their tolerance
_MAX_VORTEX_RING_ADVANCE_RATIO = 0.1  # advance ratio below which a descent may be in vortex ring state


def make_flap_mode(rotor: Rotor, frequency_ratio: float, *, mass_kg: float | None = None) -> RigidFlapMode:
    """Return a flap mode of given frequency with the inertia of the blade's beam.

    Parameters
    ----------
    rotor : Rotor
    frequency_ratio : float
        Flap frequency over rotor speed, 1 or more; infinite for a rigid blade.
    mass_kg : float, optional
        Mass of one blade outside the cut-out. Default: that of ``[blade.structure]``, else of solid ABS.

    Raises
    ------
    InputError
        If a value is out of range, or an airfoil has no contour.
    """
    if not frequency_ratio >= 1.0:
        raise InputError(
            "flap", "frequency_ratio", f"is {frequency_ratio:g}", "give 1 (free hinge at the shaft) or more"
        )
    if mass_kg is not None and not 0.0 < mass_kg < math.inf:
        raise InputError("flap", "mass_kg", f"is {mass_kg:g}", "give a mass above 0")
    beam = make_blade_beam(rotor, rotor.blade.structure or ASSUMED_STRUCTURE)
    scale = 1.0 if mass_kg is None else mass_kg / float(beam.integrate_over_span(beam.mass_kg_m))
    return RigidFlapMode(frequency_ratio, scale * float(beam.flap_inertia_about_shaft_kg_m2))


def estimate_flap_mode_range(
    rotor: Rotor, speed_rad_s: float, *, pitch_rad: float = 0.0, mass_kg: float | None = None
) -> tuple[tuple[RigidFlapMode, RigidFlapMode], str]:
    """Return the flap modes at both ends of the band of a blade's flap frequency, and the basis of the band.

    Parameters
    ----------
    rotor : Rotor
    speed_rad_s, pitch_rad : float
        Rotor speed, and pitch setting.
    mass_kg : float, optional
        As for :func:`make_flap_mode`.
    """
    mode = compute_flap_mode(rotor, speed_rad_s, pitch_rad=pitch_rad)
    low, high = (make_flap_mode(rotor, max(ratio, 1.0), mass_kg=mass_kg) for ratio in (mode.ratio_low, mode.ratio_high))
    return (low, high), f"band of the flap frequency: {mode.assumptions}"


def lock_number(r_m: Array, dr_m: Array, chord_m: Array, flap: RigidFlapMode, air: Air) -> float:
    """Return the Lock number, the ratio of aerodynamic to inertial forces in flapping.

    It is 4 rho a int c r^3 dr / I with a = 5.7 per rad; for a constant chord, rho a c R^4 / I.

    Parameters
    ----------
    r_m, dr_m, chord_m : (stations,) arrays
        Radius, width and chord of the stations (m).
    flap : RigidFlapMode
    air : Air
    """
    return 4.0 * air.density_kg_m3 * LIFT_SLOPE_PER_RAD * float(np.sum(chord_m * r_m**3 * dr_m)) / flap.inertia_kg_m2


def _check_condition(c: ForwardCondition) -> None:
    check_pitch("rotor forward", "pitch_rad", c.pitch_rad)
    check_pitch("rotor forward", "cyclic_rad", c.cyclic_rad)
    if not 0.0 < c.speed_rad_s < math.inf:
        raise InputError(
            "rotor forward", "speed_rad_s", f"is {c.speed_rad_s:g}",
            "give a speed above 0: a rotor at rest has no azimuth to average over",
        )  # fmt: skip
    if not 0.0 <= c.edgewise_m_s < math.inf:
        raise InputError(
            "rotor forward", "edgewise_m_s", f"is {c.edgewise_m_s:g}",
            "give 0 or more; wind_azimuth_rad turns the direction",
        )  # fmt: skip
    for name in ("climb_m_s", "wind_azimuth_rad", "rates_rad_s"):
        if not np.all(np.isfinite(getattr(c, name))):
            raise InputError("rotor forward", name, "is not finite", "give finite numbers")
    if c.rotation_sign not in (1, -1):
        raise InputError("rotor forward", "rotation_sign", f"is {c.rotation_sign}", "give 1 or -1")


@lru_cache(maxsize=8)
def make_azimuth_grid(count: int) -> tuple[Array, Array, Array]:
    """Return azimuths psi (rad), the table (1, cos psi, sin psi, cos 2 psi, sin 2 psi), (count, 5), and weights.

    The weights are those of :func:`mufly.rotor.forward.azimuth_kernel.velocity_derivative_weights`.
    """
    psi: Array = np.arange(count, dtype=np.float64) * (2.0 * math.pi / count)
    trig = np.stack((np.ones(count), np.cos(psi), np.sin(psi), np.cos(2 * psi), np.sin(2 * psi)), axis=1)
    return psi, trig, velocity_derivative_weights(trig)


def make_azimuth_blade(blading: Blading, which: int, flap: RigidFlapMode, air: Air) -> AzimuthBlade:
    """Return a rotor of ``blading`` as arrays for the compiled solver over azimuth."""
    fixes, stack = blading.corrections, blading.polars
    return AzimuthBlade(
        blading.r_m[which], blading.dr_m[which], blading.chord_m[which], blading.twist_rad[which],
        tabulate_section_coefficients(blading, which, air), stack.log_reynolds_min, stack.rows_per_log_reynolds,
        float(blading.blades[which]), float(blading.radius_m[which]), float(blading.hub_radius_m[which]),
        int(fixes.tip_loss == "prandtl"), int(fixes.hub_loss), int(fixes.swirl), float(flap.inertia_kg_m2),
        float(flap.frequency_ratio),
    )  # fmt: skip


def solve_forward(
    blading: Blading | Rotor,
    condition: ForwardCondition,
    flap: RigidFlapMode | None = None,
    *,
    inflow: InflowModel = "annular",
    start: ForwardResult | None = None,
    which: int = 0,
    azimuths: int = AZIMUTH_COUNT,
    stream_m_s: Array | None = None,
    swirl_m_s: Array | None = None,
) -> ForwardResult:
    """Solve the steady periodic loads, flapping and inflow of a rotor.

    Parameters
    ----------
    blading : Blading or Rotor
    condition : ForwardCondition
    flap : RigidFlapMode, optional
        Default: a blade that does not flap.
    inflow : 'annular', 'pitt-peters' or 'uniform'
        Mean inflow by annuli in axial flow and Pitt-Peters' mean in edgewise flow; Pitt-Peters alone; or uniform.
    start : ForwardResult, optional
        Similar point to start from.
    which : int
        Index of the rotor in the blading.
    azimuths : int
        Azimuths of the harmonic balance, 12 or more.
    stream_m_s, swirl_m_s : (azimuths, stations) arrays, optional
        Velocity of the air due to another rotor in wind axes: down through the disc, and against the motion of the
        blades.

    Raises
    ------
    InputError
        If a value is impossible.
    MuflyError
        If the Newton steps do not converge.
    """
    blading = ensure_blading(blading)
    c, rotor = condition, blading.rotors[which]
    _check_condition(c)
    air_speed = rotor.radius_m * c.speed_rad_s + c.edgewise_m_s  # of the advancing tip, in the disc
    mach = math.hypot(air_speed, c.climb_m_s) / c.air.sound_m_s
    fault = describe_supersonic_tips(rotor.radius_m, c.speed_rad_s, c.air)
    if fault:
        raise ArgumentError("speed_rad_s", "", fault, SUPERSONIC_TIP_REMEDY)
    if mach >= 1.0:
        raise ArgumentError(
            "edgewise_m_s", "", f"{c.edgewise_m_s:g} m/s gives the advancing tip Mach {mach:.2f}",
            "stay below 1: the method has no shock model",
        )  # fmt: skip
    warn_tip_mach(mach)
    if inflow not in ("annular", "pitt-peters", "uniform"):
        raise InputError("rotor forward", "inflow", f"{inflow!r} is unknown", "use annular, pitt-peters or uniform")
    if not 12 <= azimuths <= 720:
        raise InputError("rotor forward", "azimuths", f"is {azimuths}", "give 12 to 720")
    flap = flap or RigidFlapMode(math.inf, make_flap_mode(rotor, math.inf).inertia_kg_m2)
    hand = float(c.rotation_sign)
    turn = hand * c.wind_azimuth_rad
    cosine, sine = math.cos(turn), math.sin(turn)
    th_c, th_s = c.cyclic_rad
    p, q = hand * c.rates_rad_s[0], c.rates_rad_s[1]
    psi, trig, ways = make_azimuth_grid(azimuths)
    none = np.zeros((azimuths, blading.r_m.shape[1]))
    point = AzimuthPoint(
        float(c.speed_rad_s), float(c.edgewise_m_s), float(c.climb_m_s), float(c.pitch_rad),
        th_c * cosine - th_s * sine, th_c * sine + th_s * cosine, p * cosine + q * sine, q * cosine - p * sine,
        float(c.air.density_kg_m3), float(c.air.viscosity_Pa_s / c.air.density_kg_m3),
        none if stream_m_s is None else np.ascontiguousarray(stream_m_s, dtype=np.float64),
        none if swirl_m_s is None else np.ascontiguousarray(swirl_m_s, dtype=np.float64), INFLOW_CODES[inflow],
    )  # fmt: skip
    blade = make_azimuth_blade(blading, which, flap, c.air)
    speeds, x, steps, share = _find_solution(blading, which, c, blade, point, trig, ways, start)
    fields, totals = np.empty((azimuths, none.shape[1], len(FIELD_COLUMNS))), np.empty(ROTOR_LOAD_COUNT)
    annuli = np.empty((none.shape[1], 3))
    integrate_loads(blade, point, trig, speeds, none, x, share, fields, totals, annuli)
    return _make_result(c, flap, blade, x, totals, steps, psi, fields, SolverState(speeds, x, annuli))


def _find_solution(
    blading: Blading, which: int, c: ForwardCondition, blade: AzimuthBlade, point: AzimuthPoint, trig: Array,
    ways: Array, start: ForwardResult | None,
) -> tuple[Array, Array, int, float]:  # fmt: skip
    """Solve a point, starting from a given solution, else from a guess, else from axial flow.

    Return inflow, unknowns, number of steps, and the weight w of annulus inflow.
    """
    tip = point.speed_rad_s * blade.radius_m
    total = 0

    def start_from_axial_flow() -> tuple[Array, Array]:
        """Return the inflow (m/s) and global unknowns of the point without its edgewise velocity, to start from."""
        mean = np.asarray(point.stream_m_s.mean(axis=0))
        found = solve_rotor(
            blading, pitch_rad=c.pitch_rad, speed_rad_s=c.speed_rad_s, climb_m_s=c.climb_m_s, air=c.air, which=which,
            stream=(mean, np.asarray(point.swirl_m_s.mean(axis=0)), mean),
        )  # fmt: skip
        down = c.climb_m_s + 2.0 * float(np.sum(mean * blade.r_m * blade.dr_m)) / blade.radius_m**2
        x = np.zeros(GLOBAL_UNKNOWN_COUNT)
        x[UNKNOWN_INFLOW] = momentum_induced_velocity(0.5 * found.c_T * tip**2, down, 0.0) / tip
        return found.axial_induced_m_s.copy(), x

    def guess_start_state() -> tuple[Array, Array]:
        x = np.zeros(GLOBAL_UNKNOWN_COUNT)
        x[UNKNOWN_INFLOW] = 0.05
        return np.full(blade.r_m.size, 0.05 * tip), x

    guesses = []
    if start is not None and start.state.axial_induced_m_s.size == blade.r_m.size:
        scale = tip / (start.speed_rad_s * blade.radius_m)
        guesses.append((scale * start.state.axial_induced_m_s, start.state.unknowns.copy()))
    makers = (
        (guess_start_state, start_from_axial_flow)
        if c.climb_m_s >= 0.0 or c.edgewise_m_s > 0.1 * tip
        else (start_from_axial_flow,)
    )
    for k in range(len(guesses) + len(makers)):
        inflow, x = guesses[k] if k < len(guesses) else makers[k - len(guesses)]()
        inflow = inflow.copy()
        steps, size, share = solve_azimuth_point(blade, point, trig, ways, inflow, x)
        total += steps
        if size < NEWTON_RESIDUAL_TOLERANCE:
            return inflow, x, total, share
    inflow, x = start_from_axial_flow()
    for part in np.linspace(0.0, 1.0, 9):
        nearer = point._replace(edgewise_m_s=part * point.edgewise_m_s)
        steps, size, share = solve_azimuth_point(blade, nearer, trig, ways, inflow, x)
        total += steps
        if not size < 1e-2:
            break
    if size < _MAX_ACCEPTED_RESIDUAL:
        return inflow, x, total, share
    raise MuflyError(
        f"rotor forward: no steady solution at {point.edgewise_m_s:g} m/s edgewise and {point.axial_m_s:g} m/s along "
        f"the shaft (residual {size:.1e}); blades stall or the wake returns to the disc"
    )


def _make_result(
    c: ForwardCondition, flap: RigidFlapMode, blade: AzimuthBlade, x: Array, totals: Array, steps: int, psi: Array,
    fields: Array, state: SolverState,
) -> ForwardResult:  # fmt: skip
    hand, radius, density = float(c.rotation_sign), blade.radius_m, c.air.density_kg_m3
    tip = c.speed_rad_s * radius
    cosine, sine = math.cos(c.wind_azimuth_rad), math.sin(c.wind_azimuth_rad)
    turn_cos, turn_sin = cosine, hand * sine
    thrust, torque, h_w, y_w, m_c, m_s, induced, profile, _, t2c, t2s = totals
    y_w *= hand
    p_w = hand * c.rates_rad_s[0] * turn_cos + c.rates_rad_s[1] * turn_sin
    q_w = c.rates_rad_s[1] * turn_cos - hand * c.rates_rad_s[0] * turn_sin
    gyroscopic = blade.blade_count * flap.inertia_kg_m2 * c.speed_rad_s
    roll_w, pitch_w = hand * (-m_s + gyroscopic * q_w), -m_c - gyroscopic * p_w
    forward = -h_w * cosine - y_w * sine
    right = -h_w * sine + y_w * cosine
    force_scale = density * math.pi * radius**2 * tip**2
    axial = c.climb_m_s
    hover = math.sqrt(max(thrust, 0.0) / (2.0 * density * math.pi * radius**2))
    mu = c.edgewise_m_s / tip
    notes = []
    if mu > MAX_ADVANCE_RATIO:
        notes.append(f"advance ratio above {MAX_ADVANCE_RATIO:g}: reversed flow, no unsteady aerodynamics")
    if (
        mu < _MAX_VORTEX_RING_ADVANCE_RATIO
        and VORTEX_RING_DESCENT_RATIOS[0] * hover < -axial < VORTEX_RING_DESCENT_RATIOS[1] * hover
    ):
        notes.append("vortex ring or turbulent wake state: no steady wake; a curve through measured means")
    thrusting = np.abs(fields[..., FIELD_THRUST]) * blade.dr_m
    stalled = float(thrusting[np.abs(fields[..., 1]) > _STALL_ANGLE_RAD].sum() / max(thrusting.sum(), 1e-300))
    if stalled > 0.2:
        notes.append("sections beyond 20 degrees carry more than a fifth of the thrust: no dynamic stall")
    columns = {name: fields[..., k] for k, name in enumerate(FIELD_COLUMNS)}
    return ForwardResult(
        edgewise_m_s=c.edgewise_m_s,
        climb_m_s=c.climb_m_s,
        pitch_rad=c.pitch_rad,
        speed_rad_s=c.speed_rad_s,
        flap_frequency_ratio=flap.frequency_ratio,
        lock_number=lock_number(blade.r_m, blade.dr_m, blade.chord_m, flap, c.air),
        advance_ratio=mu,
        thrust_N=float(thrust),
        torque_Nm=float(torque),
        power_W=float(torque * c.speed_rad_s),
        h_force_N=float(-forward),
        y_force_N=float(right),
        roll_moment_Nm=float(roll_w * cosine - pitch_w * sine),
        pitch_moment_Nm=float(roll_w * sine + pitch_w * cosine),
        coning_rad=float(x[UNKNOWN_CONING]),
        flap_cos_rad=float(x[UNKNOWN_FLAP_COS] * turn_cos + x[UNKNOWN_FLAP_SIN] * turn_sin),
        flap_sin_rad=float(x[UNKNOWN_FLAP_SIN] * turn_cos - x[UNKNOWN_FLAP_COS] * turn_sin),
        flap_2_per_rev_rad=math.hypot(x[UNKNOWN_FLAP_COS_2], x[UNKNOWN_FLAP_SIN_2]),
        blade_thrust_2_per_rev_N=math.hypot(t2c, t2s),
        inflow_mean=float(x[UNKNOWN_INFLOW]),
        inflow_cos=float(x[UNKNOWN_INFLOW_COS]),
        inflow_sin=float(x[UNKNOWN_INFLOW_SIN]),
        induced_power_W=float(induced),
        profile_power_W=float(profile),
        c_T=float(thrust / force_scale),
        c_Q=float(torque / (force_scale * radius)),
        c_H=float(-forward / force_scale),
        is_outside_range=bool(notes),
        notes=tuple(notes),
        steps=steps,
        disc=DiscFields(psi, blade.r_m, **columns),
        state=state,
    )


_STALL_ANGLE_RAD = math.radians(20.0)


def compute_cyclic_response(
    blading: Blading | Rotor,
    condition: ForwardCondition,
    flap: RigidFlapMode,
    *,
    amplitude_rad: float = math.radians(1.0),
    inflow: InflowModel = "annular",
    start: ForwardResult | None = None,
    which: int = 0,
) -> CyclicResponse:
    """Return the response of flapping and hub moment to cyclic pitch, by central differences.

    The response to (th1c, th1s) is a matrix of two by two. The result is gain and angle of its part that rotates with
    the input. In edgewise flow the two directions differ by terms of order mu^2.

    Parameters
    ----------
    blading, condition, flap, inflow, start, which
        As for :func:`solve_forward`.
    amplitude_rad : float
        Amplitude of the cyclic pitch, above 0.
    """
    if not amplitude_rad > 0.0:
        raise InputError("rotor forward", "cyclic", f"is {amplitude_rad:g} rad", "give an amplitude above 0")
    blading = ensure_blading(blading)
    hand = float(condition.rotation_sign)
    tilt, moment = np.zeros((2, 2)), np.zeros((2, 2))
    for k in range(2):
        for sign in (1.0, -1.0):
            cyclic = list(condition.cyclic_rad)
            cyclic[k] += sign * amplitude_rad
            moved = solve_forward(
                blading, replace(condition, cyclic_rad=(cyclic[0], cyclic[1])), flap, inflow=inflow, start=start,
                which=which,
            )  # fmt: skip
            part = 0.5 * sign / amplitude_rad
            tilt[:, k] += part * np.array([moved.flap_cos_rad, moved.flap_sin_rad])
            # Lift aft lowers the nose, lift at psi = 90 degrees rolls away from that side.
            moment[:, k] += part * np.array([-moved.pitch_moment_Nm, -hand * moved.roll_moment_Nm])
    turned = [complex(0.5 * (m[0, 0] + m[1, 1]), 0.5 * (m[1, 0] - m[0, 1])) for m in (tilt, moment)]
    disc = math.pi * float(blading.radius_m[which]) ** 3 * (condition.speed_rad_s * float(blading.radius_m[which])) ** 2
    least = (1e-9, 1e-8 * condition.air.density_kg_m3 * disc)  # below, an angle is rounding
    angles = [math.atan2(z.imag, z.real) if abs(z) > low else math.nan for z, low in zip(turned, least, strict=True)]
    return CyclicResponse(abs(turned[0]), angles[0], abs(turned[1]), angles[1])


def sweep_forward(
    blading: Blading | Rotor,
    conditions: Sequence[ForwardCondition],
    flaps: Sequence[RigidFlapMode],
    *,
    flap_basis: str = "",
    cyclic_rad: float = math.radians(1.0),
) -> ForwardSweep:
    """Solve a rotor at several conditions for several flap modes; each solution starts from the previous one.

    Parameters
    ----------
    blading : Blading or Rotor
    conditions : sequence of ForwardCondition
    flaps : sequence of RigidFlapMode
    flap_basis : str
        Origin of the flap modes, for the text.
    cyclic_rad : float
        Amplitude of cyclic pitch of the responses.
    """
    if not conditions or not flaps:
        raise InputError("rotor forward", "", "has no points", "give at least one airspeed and one flap frequency")
    blading = ensure_blading(blading)
    points, answers = [], []
    for flap in flaps:
        line: list[ForwardResult] = []
        for c in conditions:
            line.append(solve_forward(blading, c, flap, start=line[-1] if line else None))
        points.append(tuple(line))
        answers.append(
            tuple(
                compute_cyclic_response(blading, c, flap, amplitude_rad=cyclic_rad, start=at)
                for c, at in zip(conditions, line, strict=True)
            )
        )
    return ForwardSweep(blading.rotors[0].name, tuple(flaps), flap_basis, tuple(points), tuple(answers), cyclic_rad)
