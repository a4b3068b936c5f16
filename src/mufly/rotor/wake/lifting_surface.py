"""Blade of the wake method: a lifting surface with one chordwise row of panels, and the shape of its wake.

Every panel has a bound vortex Gamma on the quarter chord line; vortices trail from the panel edges along the chord to
the trailing edge and on into the wake. The flow is evaluated at two places (Weissinger, NACA TM 1120, 1947):

* At three quarters of the chord it gives the angle of attack. From the velocity induced there by all vortices, that of
  the infinite bound vortex of a two-dimensional section, Gamma / (pi c), is subtracted, because the polar contains it.
  With n and t the directions normal to the chord and along it, w the velocity of the air past the point,

      tan alpha = (w.n + Gamma / (pi c)) / w.t,       Gamma = W c c_l(alpha, Re) / 2

  With c_l = 2 pi sin(alpha) this is tangency, w.n = 0: the inviscid lattice. A polar adds the effect of the boundary
    layer on lift. Stall delay is modelled as in mufly.rotor.blading.
  * At the quarter chord it gives the force: rho W x Gamma, and the drag rho W c c_d W / 2 along W. The trailing
    vortices on the chord have the force rho W x Gamma, too. The inflow past the tip gives the side edge of a wide blade
    a few per cent of the lift; without it the momentum of the wake exceeds the loads.

  The relative wind of the rotating blade crosses the side edges: behind the quarter chord it enters over the tip and
  leaves over the root. Flow that leaves does not turn around the edge (Kutta condition). The root is therefore a
  trailing edge: its vortex follows the wind from the quarter chord on and has no force. A root vortex bound to the
  blade up to the trailing edge would give a spurious download: for c/R = 1/3 a fifth of the thrust of the inner half.

  Frame: z up along the shaft, the blade on the x axis and moving towards y, the wake behind it.

  Vortices leave the trailing edge at the panel edges; their age zeta is the angle the rotor has turned since.

**Prescribed** (A. J. Landgrebe, J. Am. Helicopter Soc. 17(4), 1972; as given by Leishman, sec. 10.7.1), from measured
wakes of slender blades, with c_T, solidity sigma, linear twist theta_1 in degrees (root to tip) and N blades:

    tip vortex   r/R = 0.78 + 0.22 exp(-(0.145 + 27 c_T) zeta)
                 z/R = k1 zeta to the next blade (zeta = 2 pi/N), then with slope k2
                 k1 = -0.25 (c_T/sigma + 0.001 theta_1),  k2 = -(1.41 + 0.0141 theta_1) sqrt(c_T/2)
    sheet        z/R linear in r from the root: at r = R slope -2.2 sqrt(c_T/2), after the next blade -2.7 sqrt(c_T/2);
                 at r = 0 nothing to zeta = pi/2, then theta_1/128 (0.45 theta_1 + 18) sqrt(c_T/2)

Vortices outboard of the greatest circulation join the tip vortex within the first 60 degrees; the others form the sheet
and contract like the tip vortex. The climb velocity is added.

**Far wake**: below the last free point every filament continues as a helix. Its radius tends to the mean of the last
turn; its pitch is that of the last turn. It ends several radii below the rotor
(docs/log/2026-11-28-wake-convergence.md).

**Chords.** The points of a filament are 30 degrees apart; for the induced velocity the arcs between them are divided
into chords of 5 degrees. Chords of 30 degrees would miss the induction of the curvature nearby, an error of first order
in the step: docs/log/2026-11-28-wake-single-rotors.md.

**Core** (r_c0 a tenth of the chord; Squire's growth with Bhagwat and Leishman's a1, J. Am. Helicopter Soc. 47, 2002)::

    r_c^2 = r_c0^2 + (0.7 d)^2 + h^2 + 4 alpha nu (1 + a1 |Gamma| / nu) zeta / Omega + r_lim^2 (1 - exp(-(0.1 zeta)^2))

alpha = 1.25643 and a1 = 2e-4. d is the distance of neighbouring filaments at the blade, because the cores of a vortex
sheet have to overlap. h = r_0 exp(1 - r/r_0), with r_0 the radius of the cut-out, represents mixing at hub and shaft.
r_lim is 0.15 R for one rotor and 0.2 R for two, or larger if the wake does not converge. Real wakes break down into
turbulence after a turn or two; old vortices with thin cores would roll up without limit.
docs/log/2026-11-28-wake-convergence.md shows the effect of the radii.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError
from mufly.rotor.blading import Blading, compute_panel_middles_and_edges
from mufly.rotor.rotor_system import Air, LiftingSurface
from mufly.rotor.sections.section_coefficients import SectionParameters, section_coefficients
from mufly.rotor.wake.biot_savart import filament_influence

Array = NDArray[np.float64]

CHORDWISE_CORE_RADII = 1e-4  # R; core of the trailing vortices on the chord
_MAX_ALPHA_STEP_RAD = 0.05  # rad; greatest Newton step, keeps a panel on its branch of the polar
_CIRCULATION_TOLERANCE = 1e-9  # of the greatest circulation
_MAX_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class BladeState:
    """Solution on a blade: circulation (m^2/s), angle of attack (rad), coefficients, speed at 3/4 chord (m/s)."""

    circulation_m2_s: Array
    alpha_rad: Array
    cl: Array
    cd: Array
    speed_m_s: Array
    is_converged: bool


def make_lifting_surface(blading: Blading, which: int, pitch_rad: float, speed_rad_s: float) -> LiftingSurface:
    """Make the lifting surface of a blade; its stations become panels.

    Raises
    ------
    InputError
        If a chord is not positive.
    """
    rotor = blading.rotors[which]
    big = rotor.radius_m
    mid, edges = compute_panel_middles_and_edges(float(rotor.hub_cutout), blading.r_m.shape[1])
    chord, edge_chord = blading.chord_m[which], rotor.chord_m(edges)
    if not np.all(chord > 0.0):
        raise InputError(rotor.name, "blade.chord", "is zero somewhere", "give a chord above 0 everywhere")
    theta, edge_theta = blading.twist_rad[which] + pitch_rad, rotor.twist_rad(edges) + pitch_rad

    def chord_direction(angle: Array) -> Array:
        return np.stack([np.zeros_like(angle), -np.cos(angle), -np.sin(angle)], axis=1)

    def points_on_axis(x: Array) -> Array:
        return np.stack([x * big, np.zeros_like(x), np.zeros_like(x)], axis=1)

    tangent = chord_direction(theta)
    width = np.diff(edges) * big
    quarter = points_on_axis(edges)
    tail = quarter + 0.75 * edge_chord[:, None] * chord_direction(edge_theta)
    tail[0] = quarter[0]  # the air leaves over the root edge, so it is a trailing edge, too
    return LiftingSurface(
        blade_count=rotor.blades,
        radius_m=big,
        speed_rad_s=speed_rad_s,
        chord_m=chord,
        pitch_rad=theta,
        panel_width_m=width,
        quarter_chord_m=points_on_axis(mid),
        control_points_m=points_on_axis(mid) + 0.5 * chord[:, None] * tangent,
        normal=np.stack([np.zeros_like(theta), -np.sin(theta), np.cos(theta)], axis=1),
        tangent=tangent,
        edge_quarter_chord_m=quarter,
        trailing_edge_m=tail,
        edge_chord_m=edge_chord,
        filament_spacing_m=np.concatenate([width[:1], 0.5 * (width[1:] + width[:-1]), width[-1:]]),
    )


def rotate_vectors(vectors: Array, angle_rad: float | NDArray[Any]) -> Array:
    """Return vectors (..., 3) rotated about the shaft; angles broadcast against (...)."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    first = c * x - s * y
    out = np.empty((*first.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = first, s * x + c * y, z
    return out


def sum_over_blades(points: Array, blades: int, one: Callable[[Array], Array]) -> Array:
    """Return the velocity or influence of all blades at points (m, 3); ``one`` computes that of one blade at points."""
    angle = 2.0 * math.pi / blades * np.arange(blades)[:, None]
    each = one(rotate_vectors(points, -angle).reshape(-1, 3))
    each = each.reshape(blades, len(points), *each.shape[1:])
    total: Array = rotate_vectors(each, angle.reshape(blades, *[1] * (each.ndim - 2))).sum(axis=0)
    return total


def compute_bound_vortex_influence(surface: LiftingSurface, points: Array) -> Array:
    """Return the velocity at points (m, 3) per bound circulation of each panel, all blades: (m, n, 3) array (1/m)."""
    edge = surface.edge_quarter_chord_m
    paths = np.stack([edge[:-1], edge[1:]], axis=1)
    core = np.full((paths.shape[0], 1), 1e-6 * surface.radius_m)
    return sum_over_blades(points, surface.blade_count, lambda p: filament_influence(p, paths, core))


@cached_njit(error_model="numpy")
def _evaluate_sections(
    alpha: Array,
    log_re: Array,
    mach: Array,
    blades: Any,
    which: int,
    rotation: Array,
    lift: float,
    drag: float,
    out: Array,
) -> None:
    for i in range(alpha.size):
        first, second, weight = (
            blades.first_polar[which, i],
            blades.second_polar[which, i],
            blades.second_weight[which, i],
        )
        zero = blades.polar_zero_lift_rad[first]
        zero += weight * (blades.polar_zero_lift_rad[second] - zero)
        thick = blades.polar_thickness_ratio[first]
        thick += weight * (blades.polar_thickness_ratio[second] - thick)
        edge = blades.edge_drag[which, i]
        section = SectionParameters(first, second, weight, zero, rotation[i], lift, drag, thick, edge)
        out[i, 0], out[i, 1] = section_coefficients(alpha[i], log_re[i], mach[i], section, blades.polars)


def solve_circulation(
    surface: LiftingSurface,
    blading: Blading,
    which: int,
    wind: Array,
    unit: Array,
    air: Air,
    start: Array | None,
    *,
    inviscid: bool = False,
) -> BladeState:
    """Find the circulation of the panels by Newton's method.

    Parameters
    ----------
    surface : LiftingSurface
    blading : Blading
        Polars and corrections of the sections.
    which : int
        Rotor of the blading.
    wind : (n, 3) array
        Velocity of the air past the control points without this rotor's own vortices (m/s).
    unit : (n, n, 3) array
        Velocity at the control points per circulation of each panel and its trailing vortices, all blades (1/m).
    air : Air
    start : (n,) array, optional
        First guess of the circulation (m2/s).
    inviscid : bool
        Use c_l = 2 pi sin(alpha) without drag: the inviscid lattice.

    Thesis: eq. 3.14.
    """
    c = surface.chord_m
    own = np.diag(1.0 / (math.pi * c))
    normal_unit = np.einsum("ikc,ic->ik", unit, surface.normal)
    tangent_unit = np.einsum("ikc,ic->ik", unit, surface.tangent)
    normal_wind = np.sum(wind * surface.normal, axis=1)
    tangent_wind = np.sum(wind * surface.tangent, axis=1)
    log_unit = math.log(air.density_kg_m3 / air.viscosity_Pa_s) + np.log(c)
    fixes = blading.corrections
    g = blading.stall_delay_strength[which]
    if fixes.stall_delay == "chaviaropoulos-hansen":
        g = g * np.cos(surface.pitch_rad) ** 4
    factors = float(fixes.lift_factor), float(fixes.drag_factor)
    out = np.empty((c.size, 2))

    def lift_and_drag(alpha: Array, speed: Array) -> tuple[Array, Array]:
        if inviscid:
            return 2.0 * math.pi * np.sin(alpha), np.zeros_like(alpha)
        log_re = log_unit + np.log(np.maximum(speed, 1e-6))
        _evaluate_sections(alpha, log_re, speed / air.sound_m_s, blading.kernel_arrays, which, g, *factors, out)
        return out[:, 0].copy(), out[:, 1].copy()

    gamma = np.zeros(c.size) if start is None else start.copy()
    for _ in range(_MAX_ITERATIONS):
        wn = normal_wind + normal_unit @ gamma + gamma / (math.pi * c)
        wt = tangent_wind + tangent_unit @ gamma
        speed, alpha = np.hypot(wn, wt), np.arctan2(wn, wt)
        cl, cd = lift_and_drag(alpha, speed)
        slope = np.maximum((lift_and_drag(alpha + 1e-4, speed)[0] - cl) / 1e-4, 0.0)
        turn = (normal_unit + own) / speed[:, None]  # d alpha / d gamma
        jacobian = (0.5 * speed * c * slope)[:, None] * turn - np.eye(c.size)
        step = np.linalg.solve(jacobian, gamma - 0.5 * speed * c * cl)
        size = np.max(np.abs(turn @ step))
        gamma = gamma + min(1.0, _MAX_ALPHA_STEP_RAD / max(size, 1e-300)) * step
        if np.max(np.abs(step)) <= _CIRCULATION_TOLERANCE * max(np.max(np.abs(gamma)), 1e-12):
            return BladeState(gamma, alpha, cl, cd, speed, True)
    return BladeState(gamma, alpha, cl, cd, speed, False)


def chordwise_leg_points(surface: LiftingSurface) -> Array:
    """Return two Gauss points on the chordwise part of each trailing vortex: (2 (n + 1), 3) array, edge by edge."""
    begin, end = surface.edge_quarter_chord_m, surface.trailing_edge_m
    where = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))
    return np.stack([begin + x * (end - begin) for x in where], axis=1).reshape(-1, 3)


def compute_panel_loads(
    surface: LiftingSurface, state: BladeState, wind: Array, leg_wind: Array, air: Air
) -> tuple[Array, Array]:
    """Compute thrust (N) and torque (N m) of each panel, all blades.

    Parameters
    ----------
    wind : (n, 3) array
        Total velocity of the air past the quarter chord points (m/s).
    leg_wind : (2 (n + 1), 3) array
        Total velocity at :func:`chordwise_leg_points`.
    """
    wy, wz = wind[:, 1], wind[:, 2]
    speed = np.hypot(wy, wz)  # the spanwise component of the wind gives no lift
    drag = 0.5 * speed * surface.chord_m * state.cd
    up = (-wy * state.circulation_m2_s + drag * wz) * surface.panel_width_m
    back = (wz * state.circulation_m2_s + drag * wy) * surface.panel_width_m
    thrust, torque = up, -back * surface.quarter_chord_m[:, 0]

    gamma = np.diff(np.concatenate([[0.0], state.circulation_m2_s, [0.0]])) * -1.0
    leg = surface.trailing_edge_m - surface.edge_quarter_chord_m
    at = chordwise_leg_points(surface).reshape(-1, 2, 3)
    force = 0.5 * np.cross(leg_wind.reshape(-1, 2, 3), gamma[:, None, None] * leg[:, None, :])
    legs_up = force[:, :, 2].sum(axis=1)
    legs_torque = (at[:, :, 1] * force[:, :, 0] - at[:, :, 0] * force[:, :, 1]).sum(axis=1)
    for edge, panel in ((legs_up, thrust), (legs_torque, torque)):  # half to each neighbour, all at the ends
        share = 0.5 * edge
        share[0], share[-1] = edge[0], edge[-1]
        panel += share[:-1] + share[1:]
    scale = surface.blade_count * air.density_kg_m3
    return scale * thrust, scale * torque


_LAMB_OSEEN_ALPHA = 1.25643
_SQUIRE_COEFFICIENT = 2e-4
_CORE_BREAKDOWN_RATE_PER_RAD = 0.1  # 1/rad
_CORE_OVERLAP = 0.7


def free_wake_ages(turns: float, step_rad: float) -> Array:
    """Return the ages (rad) of the points of the free wake, 0 at the trailing edge."""
    return np.arange(max(round(turns * 2.0 * math.pi / step_rad), 1) + 1, dtype=np.float64) * step_rad


def prescribe_landgrebe_wake(
    surface: LiftingSurface, age: Array, c_T: float, circulation: Array | None, climb_m_s: float
) -> Array:
    """Return the wake prescribed by Landgrebe's formulas.

    Parameters
    ----------
    surface : LiftingSurface
    age : (k,) array
        Ages (rad).
    c_T : float
        Thrust coefficient; its absolute value is used.
    circulation : (n,) array or None
        Circulation of the panels, whose maximum bounds the tip vortex; default: 0.85 R.
    climb_m_s : float

    Returns
    -------
    (n + 1, k, 3) array
        Points of the filaments in the blade's frame (m).
    """
    R, omega, n = surface.radius_m, surface.speed_rad_s, surface.blade_count
    c_T = min(max(abs(c_T), 1e-5), 0.05)
    r = surface.quarter_chord_m[:, 0]
    sigma = n * float(np.sum(surface.chord_m * surface.panel_width_m)) / (math.pi * R**2)
    slope = np.polyfit(r / R, np.degrees(surface.pitch_rad), 1, w=np.sqrt(surface.panel_width_m) * r)[0]
    twist = float(np.clip(slope, -20.0, 5.0))
    next_blade = 2.0 * math.pi / n
    root = math.sqrt(0.5 * c_T)

    def piecewise_descent(first: float, second: float, bend: float) -> Array:
        return np.where(age < bend, first * age, first * bend + second * (age - bend))

    k1 = -0.25 * (c_T / sigma + 0.001 * twist)
    k2 = -max(1.41 + 0.0141 * twist, 0.5) * root
    tip_r = 0.78 + 0.22 * np.exp(-(0.145 + 27.0 * c_T) * age)
    tip_z = piecewise_descent(min(k1, 0.0), k2, next_blade)
    sheet_tip = piecewise_descent(-2.2 * root, -2.7 * root, next_blade)
    sheet_root = piecewise_descent(0.0, min(twist / 128.0 * (0.45 * twist + 18.0), 0.0) * root, 0.5 * math.pi)

    tail = surface.trailing_edge_m
    r0, azimuth0 = np.hypot(tail[:, 0], tail[:, 1]), np.arctan2(tail[:, 1], tail[:, 0])
    x = surface.edge_quarter_chord_m[:, 0] / R
    begin = 0.85 if circulation is None else min(float(r[int(np.argmax(np.abs(circulation)))] / R), 0.95)
    join = np.where(x[:, None] > begin, 1.0 - np.exp(-3.0 * age / (math.pi / 3.0)), 0.0)
    radius = (r0 / R)[:, None] * tip_r
    radius += join * (tip_r * r0[-1] / R - radius)
    fall = sheet_root + x[:, None] * (sheet_tip - sheet_root)
    fall += join * (tip_z - fall)
    angle = azimuth0[:, None] - age
    z = tail[:, 2, None] + R * fall - climb_m_s / omega * age
    return np.stack([R * radius * np.cos(angle), R * radius * np.sin(angle), z], axis=2)


def extend_filaments(
    surface: LiftingSurface, free: Array, age: Array, far_turns: float, far_step_rad: float, parts: int = 1
) -> tuple[Array, Array]:
    """Extend filaments from the quarter chord line through the free wake to the end of the far wake.

    ``parts`` is the number of chords for every arc between points of the free wake.

    Returns
    -------
    paths : (n + 1, points, 3) array
        Points of the filaments in the blade's frame (m).
    age : (points,) array
        0 at quarter chord and trailing edge.
    """
    step = age[1] - age[0]
    per_turn = min(round(2.0 * math.pi / step), age.size - 1)
    last, before = free[:, -1], free[:, -1 - per_turn]
    radius = np.hypot(free[:, -per_turn:, 0], free[:, -per_turn:, 1])
    r_last, r_mean = radius[:, -1], radius.mean(axis=1)
    pitch = (last[:, 2] - before[:, 2]) / (per_turn * step)
    beyond = far_step_rad * np.arange(1, max(round(far_turns * 2.0 * math.pi / far_step_rad), 1) + 1)
    # Chords of a circle enclose less area than the circle; the far polygon gets the area of the helix.
    r_mean = r_mean * math.sqrt(far_step_rad / math.sin(far_step_rad))
    r = r_mean[:, None] + (r_last - r_mean)[:, None] * np.exp(-beyond)
    angle = np.arctan2(last[:, 1], last[:, 0])[:, None] - beyond
    far = np.stack([r * np.cos(angle), r * np.sin(angle), last[:, 2, None] + pitch[:, None] * beyond], axis=2)
    fine, fine_age = subdivide_arcs(free, age, parts)
    paths = np.concatenate([surface.edge_quarter_chord_m[:, None], fine, far], axis=1)
    return paths, np.concatenate([[0.0], fine_age, age[-1] + beyond])


def subdivide_arcs(free: Array, age: Array, parts: int) -> tuple[Array, Array]:
    """Return filaments and ages with ``parts`` chords for every arc between free points.

    Positions are interpolated linearly in a frame that turns with the age, which is exact for a helix.
    """
    if parts < 2:
        return free, age
    step = age[1] - age[0]
    weight = np.arange(parts) / parts
    here, there = free[:, :-1], rotate_vectors(free[:, 1:], step)
    pieces = [rotate_vectors(here + w * (there - here), -w * step) for w in weight]
    ages = np.append((age[:-1, None] + step * weight).ravel(), age[-1])
    return np.concatenate([np.stack(pieces, axis=2).reshape(len(free), -1, 3), free[:, -1:]], axis=1), ages


def compute_core_radii(
    surface: LiftingSurface, age: Array, strength: Array, viscosity_m2_s: float, core: float, limit: float
) -> Array:
    """Return the core radius (m) of every segment of the filaments; nearly 0 for the segment on the blade's own chord.

    Parameters
    ----------
    age : (points,) array
        From :func:`extend_filaments`.
    strength : (n + 1,) array
        Circulation of the filaments (m2/s).
    viscosity_m2_s : float
        Kinematic viscosity.
    core : float
        r_c0 over the local chord.
    limit : float
        r_lim over the rotor radius.
    """
    middle = 0.5 * (age[1:] + age[:-1])
    r = surface.edge_quarter_chord_m[:, 0]
    hub = r[0] * np.exp(1.0 - r / max(r[0], 1e-9)) if r[0] > 0.0 else np.zeros_like(r)
    first2 = (core * surface.edge_chord_m) ** 2 + (_CORE_OVERLAP * surface.filament_spacing_m) ** 2 + hub**2
    spread = 4.0 * _LAMB_OSEEN_ALPHA * (viscosity_m2_s + _SQUIRE_COEFFICIENT * np.abs(strength)) / surface.speed_rad_s
    breakdown = (limit * surface.radius_m) ** 2 * (1.0 - np.exp(-((_CORE_BREAKDOWN_RATE_PER_RAD * middle) ** 2)))
    core2 = first2[:, None] + spread[:, None] * middle + breakdown
    core2[:, 0] = (CHORDWISE_CORE_RADII * surface.radius_m) ** 2
    return np.sqrt(core2)
