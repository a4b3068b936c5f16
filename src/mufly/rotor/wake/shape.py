"""Shape of a rotor's wake: where its vortices lie before they are freed, how they go on below, how they spread.

Vortices leave the trailing edge at the panel edges; zeta is their age as an angle the rotor has turned since.

**Prescribed** (A. J. Landgrebe, J. Am. Helicopter Soc. 17(4), 1972; as given by Leishman, sec. 10.7.1), from measured
wakes of slender blades, with c_T, solidity sigma, linear twist theta_1 in degrees (root to tip) and N blades:

    tip vortex   r/R = 0.78 + 0.22 exp(-(0.145 + 27 c_T) zeta)
                 z/R = k1 zeta to the next blade (zeta = 2 pi/N), then with slope k2
                 k1 = -0.25 (c_T/sigma + 0.001 theta_1),  k2 = -(1.41 + 0.0141 theta_1) sqrt(c_T/2)
    sheet        z/R linear in r from the root: at r = R slope -2.2 sqrt(c_T/2), after the next blade -2.7 sqrt(c_T/2);
                 at r = 0 nothing to zeta = pi/2, then theta_1/128 (0.45 theta_1 + 18) sqrt(c_T/2)

Vortices outboard of the greatest circulation belong to the tip vortex, which they join within the first 60 degrees;
the others form the sheet and contract like the tip vortex. In climb the speed of climb is added.

**Far wake**: below the last free point every filament goes on as a helix, its radius settling to the mean of its last
turn and its pitch that of its last turn. Where it ends, several radii below, is a matter of the convergence study.

**Core** (r_c0 a tenth of the chord; Squire's growth with Bhagwat and Leishman's a1, J. Am. Helicopter Soc. 47, 2002)::

    r_c^2 = r_c0^2 + (0.7 d)^2 + h^2 + 4 alpha nu (1 + a1 |Gamma| / nu) zeta / Omega + r_lim^2 (1 - exp(-(0.1 zeta)^2))

alpha = 1.25643, a1 = 2e-4, d the distance of neighbouring filaments at the blade (a sheet of vortices needs cores that
overlap), h = r_0 exp(1 - r/r_0) with r_0 the radius of the cut-out (hub and shaft stir what leaves the root), and
r_lim = 0.15 R for one rotor, 0.2 R for two, more if need be: real wakes break down into turbulence after a turn or two,
and a lattice whose old vortices stay sharp goes on winding them up without end. docs/wake.md shows what each term does.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.rotor.wake.blade import Surface

__all__ = ["ages_of", "core_radii", "extended", "prescribed"]

Array = NDArray[np.float64]

_LAMB = 1.25643
_SQUIRE = 2e-4
_BREAKDOWN = 0.1  # 1/rad
_OVERLAP = 0.7


def ages_of(turns: float, step_rad: float) -> Array:
    """Ages (rad) of the points of the free wake, 0 at the trailing edge."""
    return np.arange(max(round(turns * 2.0 * math.pi / step_rad), 1) + 1, dtype=np.float64) * step_rad


def prescribed(
    surface: Surface, age: Array, c_T: float, circulation: Array | None, climb_m_s: float
) -> Array:
    """Landgrebe's wake.

    Parameters
    ----------
    surface : Surface
    age : (k,) array
        Ages (rad).
    c_T : float
        Thrust coefficient; its size is used.
    circulation : (n,) array or None
        Of the panels, to find where the tip vortex begins; without it, at 0.85 R.
    climb_m_s : float

    Returns
    -------
    (n + 1, k, 3) array
        Points of the filaments in the blade's frame (m).
    """
    R, omega, n = surface.radius_m, surface.speed_rad_s, surface.blades
    c_T = min(max(abs(c_T), 1e-5), 0.05)
    r = surface.quarter_m[:, 0]
    sigma = n * float(np.sum(surface.chord_m * surface.width_m)) / (math.pi * R**2)
    slope = np.polyfit(r / R, np.degrees(surface.theta_rad), 1, w=np.sqrt(surface.width_m) * r)[0]
    twist = float(np.clip(slope, -20.0, 5.0))
    next_blade = 2.0 * math.pi / n
    root = math.sqrt(0.5 * c_T)

    def two_slopes(first: float, second: float, bend: float) -> Array:
        return np.where(age < bend, first * age, first * bend + second * (age - bend))

    k1 = -0.25 * (c_T / sigma + 0.001 * twist)
    k2 = -max(1.41 + 0.0141 * twist, 0.5) * root
    tip_r = 0.78 + 0.22 * np.exp(-(0.145 + 27.0 * c_T) * age)
    tip_z = two_slopes(min(k1, 0.0), k2, next_blade)
    sheet_tip = two_slopes(-2.2 * root, -2.7 * root, next_blade)
    sheet_root = two_slopes(0.0, min(twist / 128.0 * (0.45 * twist + 18.0), 0.0) * root, 0.5 * math.pi)

    tail = surface.edge_tail_m
    r0, azimuth0 = np.hypot(tail[:, 0], tail[:, 1]), np.arctan2(tail[:, 1], tail[:, 0])
    x = surface.edge_quarter_m[:, 0] / R
    begin = 0.85 if circulation is None else min(float(r[int(np.argmax(np.abs(circulation)))] / R), 0.95)
    join = np.where(x[:, None] > begin, 1.0 - np.exp(-3.0 * age / (math.pi / 3.0)), 0.0)
    radius = (r0 / R)[:, None] * tip_r
    radius += join * (tip_r * r0[-1] / R - radius)
    fall = sheet_root + x[:, None] * (sheet_tip - sheet_root)
    fall += join * (tip_z - fall)
    angle = azimuth0[:, None] - age
    z = tail[:, 2, None] + R * fall - climb_m_s / omega * age
    return np.stack([R * radius * np.cos(angle), R * radius * np.sin(angle), z], axis=2)


def extended(
    surface: Surface, free: Array, age: Array, far_turns: float, far_step_rad: float
) -> tuple[Array, Array]:
    """The whole filaments: from the quarter chord line through the free wake to the end of the far wake.

    Returns
    -------
    paths : (n + 1, points, 3) array
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
    # Chords of a circle enclose less than the circle; the far polygon gets the area of the helix.
    r_mean = r_mean * math.sqrt(far_step_rad / math.sin(far_step_rad))
    r = r_mean[:, None] + (r_last - r_mean)[:, None] * np.exp(-beyond)
    angle = np.arctan2(last[:, 1], last[:, 0])[:, None] - beyond
    far = np.stack([r * np.cos(angle), r * np.sin(angle), last[:, 2, None] + pitch[:, None] * beyond], axis=2)
    paths = np.concatenate([surface.edge_quarter_m[:, None], free, far], axis=1)
    return paths, np.concatenate([[0.0], age, age[-1] + beyond])


def core_radii(
    surface: Surface, age: Array, strength: Array, viscosity_m2_s: float, core: float, limit: float
) -> Array:
    """Core radius (m) of every segment of the filaments; next to none on the chord itself.

    Parameters
    ----------
    age : (points,) array
        From :func:`extended`.
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
    r = surface.edge_quarter_m[:, 0]
    hub = r[0] * np.exp(1.0 - r / max(r[0], 1e-9)) if r[0] > 0.0 else np.zeros_like(r)
    first2 = (core * surface.edge_chord_m) ** 2 + (_OVERLAP * surface.spacing_m) ** 2 + hub**2
    spread = 4.0 * _LAMB * (viscosity_m2_s + _SQUIRE * np.abs(strength)) / surface.speed_rad_s
    breakdown = (limit * surface.radius_m) ** 2 * (1.0 - np.exp(-((_BREAKDOWN * middle) ** 2)))
    core2 = first2[:, None] + spread[:, None] * middle + breakdown
    core2[:, 0] = (1e-4 * surface.radius_m) ** 2
    return np.sqrt(core2)
