"""Coaxial pairs by blade elements and vortex tubes whose wakes convect each other, in tens of milliseconds.

The mean wake of a rotor is a set of coaxial tubes of ring vortices that start at its disc. With m = F u the mean axial
velocity of an annulus of the isolated rotor by momentum theory, the tube between two annuli has the strength D, the
step of m there. A semi-infinite tube of radius R and strength 1 induces at radius r and distance z below its disc
(above: z < 0) the axial velocity (Callaghan and Maslen, NASA TN D-465, 1960; Branlard and Gaunaa, Wind Energy 18, 2015)

    K(r, z; R) = [r < R] + z k / (2 pi sqrt(r R)) [K(k) + (R - r) / (R + r) Pi(n, k)]
    k^2 = 4 r R / ((R + r)^2 + z^2),    n = 4 r R / (R + r)^2                     complete elliptic integrals

On the axis K is 1 + z / sqrt(R^2 + z^2): 0 far above, 1 at the disc, 2 far below. Above the disc it is much smaller at
the edge; below the disc and outside the tube it is negative: air flows up around the edge of the stream.

**Contraction.** Continuity on the axis narrows the tubes from r to s r, s(z) = 1 / sqrt(1 + z / sqrt(R^2 + z^2)) below
the disc. The field below is that of straight tubes at r / s. Streams do not cross: below the lower disc an annulus of
the upper wake keeps its position among the tubes of the lower wake.

**Convection.** The circulation sets the rate at which vorticity is shed; its density in the wake is this rate over the
convection velocity. If the other rotor changes that velocity from w_0 to w_0 + w, the strength of the tube becomes D p
with p = w_0 / (w_0 + w). For w < 0 the tangent p = 1 - w / w_0 is used, an assumption without theory. w_0 is the sum of
climb and the axial velocity of the rotor's own tubes (mean of both sides). w is the velocity of the other rotor's tubes
plus that of the change p - 1 of its own tubes. Each tube is divided into cells, each with its own p.

**Roll-up.** Vorticity shed outside the greatest velocity of the stream rolls up into the tip vortex within a fraction
of a turn. Those tubes have common values of w_0 and w, the means weighted by strength. The root vortex alone would
stand still or rise; it moves with the sheet beside it, as in the vortex wake.

**Onset flow of a blade**: the velocity of the other rotor's tubes at the disc and that of the change of its own tubes.
A lower rotor also receives the swirl of the upper stream from lift and profile drag
(:func:`mufly.rotor.bemt.compute_slipstream`): r u is conserved downstream while r becomes s r. The unchanged own tubes
are part of the momentum balance.

The upper rotor is hardly affected by the lower rotor, as measured: the velocity added by the lower rotor at the upper
disc nearly equals the loss of induction of the upper wake, which is convected faster. No constant is fitted. Neglected
are the passing of blades, the path of the tip vortex during roll-up, mixing, and the effect of the lower rotor on the
contraction of the upper wake.

A jump of a polar or of p can leave single stations alternating between two values. The iteration then continues with
steps 2 / (k + 8), and its last turn counts if thrust and torque of both rotors stay within 0.2 % of the pair's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError, MuflyError
from mufly.rotor.bemt import compute_slipstream, solve_placed_rotor
from mufly.rotor.rotor_system import Air, PlacedRotor, SystemSolution, WakeSettings

Array = NDArray[np.float64]

_MAX_OUTER_TUBES = 8  # greatest number of tubes besides the innermost
_TUBE_CELL_STARTS_RADII = np.array([0.0, 0.1, 0.25, 0.45, 0.75, 1.25, 2.0])  # start of each cell of a tube, over R
_TUBE_CELL_MIDDLES_RADII = np.array([0.05, 0.175, 0.35, 0.6, 1.0, 1.6, 3.0])
_POINTS_PER_PANEL = 3  # sample points on a panel within a stream
_MIN_CONVECTION_SPEED_RATIO = 0.1  # least convection velocity over the greatest of the wake, so that p stays finite
_MAX_ITERATIONS, _RESTART_INTERVAL, _ANDERSON_MEMORY, _ANDERSON_MIXING = 200, 40, 12, 0.3
_CONVERGENCE_TOLERANCE = 1e-5  # of the greatest induced velocity
_MAX_DAMPED_ITERATIONS, _LOAD_RANGE_WINDOW_ITERATIONS = 200, 40
_LOAD_TOLERANCE = 2e-3  # of thrust and torque of the pair: range over the judged iterations
_MIN_INDUCED_TO_TIP_SPEED_RATIO = (
    0.005  # of the tip speed: least induced velocity of that scale; below, a rotor carries no load
)


@cached_njit(error_model="numpy")
def compute_tube_velocity_ratio(r: float, z: float, radius: float) -> float:
    """Return the axial velocity that a semi-infinite vortex tube induces, over the velocity in its disc (K of the
    module docstring).

    The two elliptic integrals combine into Bulirsch's cel(k', p, a, b) (Numer. Math. 7, 1965), as in Derby and Olbert's
    formula for solenoids (Am. J. Phys. 78, 2010).
    """
    if radius <= 0.0:
        return 0.0
    if r < 1e-6 * radius:
        return 1.0 + z / math.hypot(radius, z)
    if abs(r - radius) < 1e-6 * radius:
        return 0.5 * (
            compute_tube_velocity_ratio(r * (1.0 - 2e-6), z, radius)
            + compute_tube_velocity_ratio(r * (1.0 + 2e-6), z, radius)
        )
    inside = 1.0 if r < radius else 0.0
    if z == 0.0:
        return inside
    both = (radius + r) * (radius + r) + z * z
    alpha = (radius - r) / (radius + r)
    if abs(alpha) < 1e-7:
        alpha = math.copysign(1e-7, alpha)
    kc = math.sqrt(((radius - r) * (radius - r) + z * z) / both)
    p, a, b, e, em = alpha * alpha, 1.0 + alpha, alpha * alpha + alpha, kc, 1.0
    p = math.sqrt(p)
    b /= p
    k = kc
    while True:
        f = a
        a += b / p
        g = e / p
        b = 2.0 * (b + f * g)
        p += g
        g = em
        em += k
        if abs(g - k) <= 1e-8 * g:
            break
        k = 2.0 * math.sqrt(e)
        e = k * em
    integral = 0.5 * math.pi * (b + a * em) / (em * (em + p))
    return inside + z / (math.pi * math.sqrt(both)) * integral


def compute_tube_axis_velocity_ratio(distance_m: float, radius_m: float) -> float:
    """Return the velocity on the axis of a tube over the velocity in its disc, 0 to 2, at a distance below the disc."""
    return 1.0 + distance_m / math.hypot(radius_m, distance_m)


def compute_wake_radius_ratio(distance_m: float, radius_m: float) -> float:
    """Return the radius of a wake tube at a distance below the disc over its radius in the disc; 1 above the disc."""
    return 1.0 / math.sqrt(compute_tube_axis_velocity_ratio(max(distance_m, 0.0), radius_m))


@cached_njit(error_model="numpy")
def _fill_cell_influence(out: Array, r: Array, z: Array, tubes: Array, starts: Array) -> None:
    """Fill ``out`` with the axial velocity at points (r, z) per unit strength of each axial cell of each tube.

    The last cell of a tube is semi-infinite.
    """
    for i in range(out.shape[0]):
        for j in range(tubes.size):
            above = compute_tube_velocity_ratio(r[i], z[i] - starts[0], tubes[j])
            for c in range(starts.size):
                below = (
                    compute_tube_velocity_ratio(r[i], z[i] - starts[c + 1], tubes[j]) if c + 1 < starts.size else 0.0
                )
                out[i, j * starts.size + c] = above - below
                above = below


def select_tube_edges(stations: int) -> NDArray[np.int64]:
    """Return the indices of the blade's panel edges at which vortex tubes begin, at most nine at even steps."""
    return np.unique(np.linspace(0, stations, min(stations, _MAX_OUTER_TUBES) + 1).round().astype(np.int64))


@lru_cache(maxsize=256)
def _tube_influence(source: bytes, target: bytes, below_m: float) -> tuple[Array, Array]:
    """Return the axial velocities at the target's disc and in its wake, per unit strength of each cell of the source.

    The first one is averaged over the panels of the target's disc, the second one holds at the middles of the target's
    own wake cells.

    ``source`` and ``target`` are the panel edges of two rotors (m), or of one; ``below_m`` is the distance of the
    target below the source (m).
    """
    edges, at = np.frombuffer(source), np.frombuffer(target)
    tubes, starts = edges[select_tube_edges(edges.size - 1)], float(edges[-1]) * _TUBE_CELL_STARTS_RADII
    own = float(at[-1])
    narrow = compute_wake_radius_ratio(below_m, float(edges[-1]))
    parts = (np.arange(_POINTS_PER_PANEL) + 0.5) / _POINTS_PER_PANEL
    r = (at[:-1, None] + np.diff(at)[:, None] * parts).ravel()
    disc = np.zeros((r.size, tubes.size * starts.size))
    _fill_cell_influence(disc, r / narrow, np.full(r.size, below_m), tubes, starts)
    disc = disc.reshape(at.size - 1, _POINTS_PER_PANEL, -1).mean(axis=1)
    depth = own * _TUBE_CELL_MIDDLES_RADII
    follow = np.array([compute_wake_radius_ratio(min(d, max(-below_m, 0.0)), own) / narrow for d in depth])
    leaving = at[select_tube_edges(at.size - 1)]
    wake = np.zeros((leaving.size * depth.size, tubes.size * starts.size))
    _fill_cell_influence(wake, np.outer(leaving, follow).ravel(), np.tile(below_m + depth, leaving.size), tubes, starts)
    return disc, wake


def _panel_edges_m(p: PlacedRotor) -> Array:
    radius = p.blading.rotors[p.index_in_blading].radius_m
    return radius - np.concatenate((np.cumsum(p.blading.dr_m[p.index_in_blading][::-1])[::-1], [0.0]))


def _tube_strengths(area: Array, first: NDArray[np.int64], inflow: Array, loss: Array) -> Array:
    """Return the strengths D of the vortex tubes from inflow and loss factor of the annuli.

    ``area``: areas of the annuli. ``first``: index of the first annulus inside each tube.
    """
    mean = np.add.reduceat(inflow * loss * area, first) / np.add.reduceat(area, first)
    return np.concatenate(([-mean[0]], mean[:-1] - mean[1:], [mean[-1]]))


def _make_convection_matrix(steps: Array) -> Array:
    """Return the matrix (tubes, tubes) that turns the axial velocities at the tubes into their convection velocities.

    The outermost tubes roll up into the tip vortex and move together, weighted by strength; the root tube moves with
    its neighbour.
    """
    count, tip = steps.size, 0
    while tip < count and steps[count - 1 - tip] * steps[-1] > 0.0:
        tip += 1
    out = np.eye(count)
    if tip > 1:
        out[-tip:, -tip:] = steps[-tip:] / steps[-tip:].sum()
    if tip < count - 1:
        out[0, :2] = 0.0, 1.0
    return out


def make_stream_interpolation(r_m: Array, edge_m: float, narrow: float, at_m: Array, width_m: Array) -> Array:
    """Return the matrix (panels, stations) that interpolates values at a rotor's stations to panels in its slipstream.

    Parameters
    ----------
    r_m : (stations,) array
        Radii of the rotor's stations (m); values are linear between them.
    edge_m, narrow : float
        Radius of the disc (m), and contraction s between disc and panels.
    at_m, width_m : (panels,) arrays
        Radii and widths of the panels (m); a panel across the edge of the stream counts the part inside.
    """
    inside = np.clip((narrow * edge_m - at_m) / width_m + 0.5, 0.0, 1.0)
    place = np.interp(at_m / narrow, r_m, np.arange(r_m.size, dtype=np.float64))
    first = np.minimum(place.astype(np.int64), r_m.size - 2)
    part, row = place - first, np.arange(at_m.size)
    read = np.zeros((at_m.size, r_m.size))
    read[row, first], read[row, first + 1] = inside * (1.0 - part), inside * part
    return read


def make_swirl_influence_matrix(r_m: Array, edge_m: float, distance_m: float, at_m: Array, width_m: Array) -> Array:
    """Return the matrix from moment of momentum r u (m^2/s) at a rotor's stations to swirl u (m/s) at panels
    downstream.

    r u is conserved downstream, r becomes s r. Swirl is zero inside the blade roots, and there is no mixing.
    """
    s = compute_wake_radius_ratio(distance_m, edge_m)
    read = make_stream_interpolation(r_m, edge_m, s, at_m, width_m)
    out: Array = read * ((at_m >= s * r_m[0]) / at_m)[:, None]
    return out


def make_lower_rotor_swirl_matrix(source: PlacedRotor, target: PlacedRotor) -> Array:
    """Return the matrix from a rotor's moment of momentum to the swirl at the stations of a lower rotor.

    It is multiplied by the moment of momentum r u of the upper rotor's stream (m2/s). The result is a velocity (m/s),
    positive against the motion of the lower rotor's blades.
    """
    r, dr = target.blading.r_m[target.index_in_blading], target.blading.dr_m[target.index_in_blading]
    edge, apart = source.blading.rotors[source.index_in_blading].radius_m, source.height_m - target.height_m
    return (
        -source.rotation_sign
        * target.rotation_sign
        * make_swirl_influence_matrix(source.blading.r_m[source.index_in_blading], edge, apart, r, dr)
    )


def solve_tubes(
    rotors: tuple[PlacedRotor, ...],
    climb_m_s: float,
    air: Air,
    settings: WakeSettings | None = None,
    start: SystemSolution | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> SystemSolution:
    """Solve a coaxial pair by BEMT and vortex tubes, one rotor by BEMT alone; called by
    :func:`mufly.rotor.solve_system`.

    Raises
    ------
    InputError
        For three rotors or more.
    MuflyError
        If the wakes do not converge, as in descents with the wakes blown back through the discs.
    """
    if len(rotors) > 2:
        raise InputError("rotor", "method", f"'tubes' solves pairs, not {len(rotors)} rotors", "use 'bemt'")
    if len(rotors) == 1:
        return SystemSolution((solve_placed_rotor(rotors[0], climb_m_s, air),), rotors, climb_m_s, air, "tubes")
    keys = [_panel_edges_m(p).tobytes() for p in rotors]
    gap = rotors[0].height_m - rotors[1].height_m
    own = [_tube_influence(k, k, 0.0) for k in keys]
    other = [_tube_influence(keys[1], keys[0], -gap), _tube_influence(keys[0], keys[1], gap)]
    stations = [p.blading.r_m.shape[1] for p in rotors]
    sizes = [*stations, *(w[1].shape[0] for w in own)]
    cuts, cells = np.cumsum(sizes)[:-1], _TUBE_CELL_STARTS_RADII.size
    annuli = [
        (p.blading.r_m[p.index_in_blading] * p.blading.dr_m[p.index_in_blading], select_tube_edges(n)[:-1])
        for p, n in zip(rotors, stations, strict=True)
    ]
    turned = make_lower_rotor_swirl_matrix(*rotors)
    found: list[tuple[Array, Array, Array]] = []
    met_by: list[tuple[Array, Array, Array]] = []

    def iterate_streams(x: Array) -> Array:
        """Return the next iterate of ``x``: onset velocities at both discs, and the strength factor p of each cell."""
        *streams, p0, p1 = np.split(x, cuts)
        found.clear()
        met_by.clear()
        swirl = np.zeros(stations[0])
        for k, (p, stream) in enumerate(zip(rotors, streams, strict=True)):
            if k:
                swirl = turned @ found[0][2]
            met_by.append((stream, swirl, np.zeros_like(stream)))
            found.append(compute_slipstream(p, climb_m_s, air, met_by[k], turns=k == 0))
        bare = [_tube_strengths(*a, u, loss) for a, (u, loss, _) in zip(annuli, found, strict=True)]
        steps = [np.repeat(s, cells) for s in bare]
        thinned = []
        for k, share in enumerate((p0, p1)):
            together = _make_convection_matrix(bare[k])
            alone = (together @ (own[k][1] @ steps[k] + climb_m_s).reshape(-1, cells)).ravel()
            alone = np.hypot(alone, max(_MIN_CONVECTION_SPEED_RATIO * float(np.max(np.abs(alone))), least))
            w = other[k][1] @ (steps[1 - k] * (p1, p0)[k]) + own[k][1] @ (steps[k] * (share - 1.0))
            ratio = (together @ w.reshape(-1, cells)).ravel() / alone
            thinned.append(np.where(ratio > 0.0, 1.0 / (1.0 + np.maximum(ratio, 0.0)), 1.0 - ratio))
        met = [
            other[k][0] @ (steps[1 - k] * thinned[1 - k]) + own[k][0] @ (steps[k] * (thinned[k] - 1.0)) for k in (0, 1)
        ]
        return np.concatenate((*met, *thinned))

    x = np.concatenate((np.zeros(sum(stations)), np.ones(sum(sizes[2:]))))
    least = _MIN_INDUCED_TO_TIP_SPEED_RATIO * max(
        p.speed_rad_s * p.blading.rotors[p.index_in_blading].radius_m for p in rotors
    )
    if start is not None and [v.size for v in start.coupling_variables] == sizes:
        x = np.concatenate(start.coupling_variables)
    points: list[Array] = []
    misses: list[Array] = []
    loads: list[Array] = []

    def collect_solution(turns: int, words: str) -> SystemSolution:
        both = (solve_placed_rotor(p, climb_m_s, air, m) for p, m in zip(rotors, met_by, strict=True))
        streams = tuple(np.split(x, cuts))
        return SystemSolution(tuple(both), rotors, climb_m_s, air, "tubes", True, words, turns, streams)

    for turn in range(1, _MAX_ITERATIONS + _MAX_DAMPED_ITERATIONS + 1):
        miss = iterate_streams(x) - x
        size = sum(float(np.max(np.abs(u * loss))) for u, loss, _ in found)
        far_off = float(np.max(np.abs(miss[: cuts[1]]))) / max(size, least)
        if progress is not None:
            progress(turn, far_off, math.nan)
        if far_off <= _CONVERGENCE_TOLERANCE:
            return collect_solution(turn, f"settled in {turn} turns")
        if turn > _MAX_ITERATIONS:
            if turn > _MAX_ITERATIONS + _MAX_DAMPED_ITERATIONS - _LOAD_RANGE_WINDOW_ITERATIONS:
                now = collect_solution(turn, "")
                loads.append(np.array([(r.thrust_N, r.torque_Nm) for r in now.rotors]))
            x = x + 2.0 / (turn - _MAX_ITERATIONS + 8.0) * miss
            continue
        # Anderson's acceleration.
        points, misses = [*points[-_ANDERSON_MEMORY + 1 :], x], [*misses[-_ANDERSON_MEMORY + 1 :], miss]
        x = x + _ANDERSON_MIXING * miss
        if turn % _RESTART_INTERVAL == 0:  # its memory may stem from other branches of the polars
            points, misses = [], []
        if len(points) > 1:
            bends, ways = np.diff(misses, axis=0).T, np.diff(points, axis=0).T
            x = x - (ways + _ANDERSON_MIXING * bends) @ np.linalg.lstsq(bends, miss, rcond=1e-8)[0]
    spread = float(np.max(np.ptp(loads, axis=0) / np.sum(np.abs(loads[-1]), axis=0)))
    if spread <= _LOAD_TOLERANCE:
        return collect_solution(
            turn, f"converged in {turn} iterations except for single stations; loads within {spread:.1e}"
        )
    raise MuflyError(
        f"coaxial: the two wakes do not converge at {climb_m_s:g} m/s climb; "
        f"the stream still changes by {far_off:.1e} of its value per iteration; tubes need rotors that push "
        "air down: raise the pitch, bring the speeds together, or use the method bemt or wake"
    )
