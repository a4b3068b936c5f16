"""Coefficient maps of a coaxial pair over mean speed, speed ratio and climb: computation and interpolation.

A point (s, r, m) of the map is the pair at

    Omega_up = 2 s / (1 + r),    Omega_dw = r Omega_up,    V = m s R

(:mod:`mufly.vehicle.coefficient_map` gives the reason for these axes). Neighbours are solved in succession, and each
point starts from the inflow or the wake of the previous one; the path reverses at the end of every row. Solved points
are stored in a file beside the map, and an interrupted run resumes from it. If the method does not converge, as in
descents with the wakes blown back through the discs, the point takes the mean of its solved neighbours and is marked as
not solved.

Interpolation is smooth for linearisation and fast for Runge-Kutta stages. Over ratio and climb it uses Catmull-Rom
cubics, which pass through the points with continuous slopes,

    f(t) = f_0 + t (f_1 - f_-1)/2 + t^2 (f_-1 - 5/2 f_0 + 2 f_1 - f_2/2) + t^3 (3/2 (f_0 - f_1) + (f_2 - f_-1)/2)

with the missing point beyond an edge extrapolated linearly from the last two. Over the mean speed, where coefficients
vary little, it is linear. Beyond an edge the value at the edge is kept.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError, MuflyError
from mufly.files.answer_store import StoredResultLines, hash_inputs
from mufly.rotor.blading import Blading
from mufly.rotor.rotor_solver import solve_from_neighbour, solve_system
from mufly.rotor.rotor_system import Air, OperatingCondition, RotorSystem, SystemSolution, WakeSettings
from mufly.rotor.validity_checks import VORTEX_RING_DESCENT_RATIOS, VortexRingWarning, check_pitch
from mufly.vehicle import CoefficientMap, MapTables
from mufly.vehicle.coefficient_map import MAX_MAP_NODES, format_map_table

Array = NDArray[np.float64]
MapPointValues = tuple[
    float, float, float, float, bool
]  # c_T, c_Q of upper and lower rotor; whether the method converged

_MIN_SOLVED_FRACTION = 0.5


def make_climb_axis_over_tip_speed(
    climb_m_s: Sequence[float], mean_speed_rad_s: Sequence[float], radius_m: float
) -> Array:
    """Return a climb axis that covers these climb velocities (m/s) at every one of these mean speeds."""
    return np.asarray(climb_m_s, dtype=np.float64) / (min(mean_speed_rad_s) * radius_m)


def order_points_by_neighbour(shape: tuple[int, int, int]) -> list[tuple[int, int, int]]:
    """Return the points in an order in which each is a neighbour of the previous one."""
    points: list[tuple[int, int, int]] = []
    for k in range(shape[0]):
        rows = range(shape[1]) if k % 2 == 0 else range(shape[1] - 1, -1, -1)
        for j in rows:
            # From fast climb, where wakes converge quickly, to descent, and back.
            back = (len(points) // shape[2]) % 2 == 1
            points += [(k, j, i) for i in (range(shape[2]) if back else range(shape[2] - 1, -1, -1))]
    return points


def compute_coax_map(
    upper: Blading,
    lower: Blading,
    *,
    spacing_m: float,
    upper_pitch_rad: float,
    lower_pitch_rad: float,
    mean_speed_rad_s: Sequence[float],
    ratio: Sequence[float],
    climb_ratio: Sequence[float],
    method: Literal["bemt", "wake"] = "bemt",
    air: Air | None = None,
    settings: WakeSettings | None = None,
    name: str = "",
    note: str = "",
    kept: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> CoefficientMap:
    """Compute the thrust and torque coefficients of a coaxial pair over mean speed, speed ratio and climb.

    Parameters
    ----------
    upper, lower : Blading
        Upper and lower rotor, the first rotor of each; both have the same radius.
    spacing_m, upper_pitch_rad, lower_pitch_rad, air
        As in :class:`mufly.rotor.RotorSystem` and :class:`mufly.rotor.OperatingCondition`.
    mean_speed_rad_s, ratio, climb_ratio : sequences of float
        Axes, increasing in equal steps; see :class:`mufly.vehicle.MapTables` and
        :func:`make_climb_axis_over_tip_speed`.
    method : 'bemt' or 'wake'
        Blade elements (milliseconds a point) or vortex wakes (seconds).
    settings : WakeSettings, optional
        Of the wake method.
    name, note : str
        Name of the map, and a note for its ``settings``.
    kept : Path, optional
        File of solved points; an interrupted run resumes from it. It is deleted at the end.
    progress : callable, optional
        ``progress(done, total)`` after each point.

    Returns
    -------
    CoefficientMap

    Raises
    ------
    InputError
        If the radii differ, an axis is invalid, ``kept`` contains the points of another map, or the rotors cannot be
        solved together.
    MuflyError
        If fewer than half of the points are solved.
    """
    radius = float(upper.rotors[0].radius_m)
    if abs(lower.rotors[0].radius_m / radius - 1.0) > 1e-6:
        raise InputError(
            "coax map", lower.rotors[0].name, f"has R {1e3 * lower.rotors[0].radius_m:g} mm, the upper rotor "
            f"{1e3 * radius:g} mm", "the rotors of a vehicle have the same radius: give two such rotors",
        )  # fmt: skip
    gas = air or Air()
    axes = tuple(np.asarray(a, dtype=np.float64) for a in (mean_speed_rad_s, ratio, climb_ratio))
    _check_map_axes(axes)
    shape = (axes[0].size, axes[1].size, axes[2].size)
    how = (settings or WakeSettings()) if method == "wake" else None
    about: dict[str, Any] = {
        "method": method,
        "upper": upper.rotors[0].name,
        "lower": lower.rotors[0].name,
        "radius_m": radius,
        "spacing_m": spacing_m,
        "upper_pitch_deg": round(math.degrees(upper_pitch_rad), 9),
        "lower_pitch_deg": round(math.degrees(lower_pitch_rad), 9),
        "density_kg_m3": gas.density_kg_m3,
        "viscosity_Pa_s": gas.viscosity_Pa_s,
        "settings": "; ".join(filter(None, [note, "" if how is None else _describe_wake_settings(how)])),
    }
    check_pitch("coax map", "pitch_rad", [upper_pitch_rad, lower_pitch_rad])
    system = RotorSystem.from_coaxial_pair(upper, lower, spacing_m=spacing_m)
    store: StoredResultLines[MapPointValues] = StoredResultLines(
        kept, lambda row: (tuple(row[0]), tuple(row[1])), other=_WRONG_MAP_MESSAGE,
        question=hash_inputs(about, *axes, hash_bladings(upper, lower)),
    )  # fmt: skip
    points = order_points_by_neighbour(shape)
    values = np.full((*shape, 4), np.nan)
    solved = np.zeros(shape, dtype=np.bool_)
    reason = ""
    last: SystemSolution | None = None
    for done, point in enumerate(points):
        if progress is not None:
            progress(done, len(points))
        answer = store.known.get(point)
        if answer is None:
            mean, r, m = (float(a[k]) for a, k in zip(axes, point, strict=True))
            up = 2.0 * mean / (1.0 + r)
            at = OperatingCondition((upper_pitch_rad, lower_pitch_rad), (up, r * up), None, m * mean * radius, gas)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", VortexRingWarning)  # the description reports it
                    pair = solve_from_neighbour(partial(solve_system, system, at, method, settings=how), last)
                a, b = pair.rotors
                answer, last = (a.c_T, a.c_Q, b.c_T, b.c_Q, pair.converged), pair if pair.converged else None
            except InputError:
                raise
            except MuflyError as error:
                reason, last = str(error), None
                answer = (math.nan, math.nan, math.nan, math.nan, False)
            store.append_result(point, answer, [point, answer])
        *coefficients, converged = answer
        values[point], solved[point] = coefficients, converged and np.all(np.isfinite(coefficients))
    if progress is not None:
        progress(len(points), len(points))
    if np.mean(solved) < _MIN_SOLVED_FRACTION:
        store.delete_file()
        raise MuflyError(
            f"coax map: only {np.count_nonzero(solved)} of {solved.size} points are solved"
            + (f" (last: {reason})" if reason else "; the wakes do not converge")
            + "; reduce the descent, or use method 'bemt'"
        )
    values = _fill_unsolved_points(values, solved)
    upper_T, upper_Q, lower_T, lower_Q = np.moveaxis(values, -1, 0)
    tables = MapTables(axes[0], axes[1], axes[2], upper_T, upper_Q, lower_T, lower_Q, solved)
    made = CoefficientMap(
        name=name or f"{about['upper']}-{about['lower']}-{method}",
        description=f"{about['upper']} above {about['lower']}, {1e3 * spacing_m:g} mm apart, "
        f"{about['upper_pitch_deg']:g} and {about['lower_pitch_deg']:g} deg, by {method}; "
        f"{np.count_nonzero(solved)} of {solved.size} points solved" + _describe_vortex_ring_points(tables),
        table=format_map_table(tables),
        **about,
    )
    store.delete_file()
    return made


def _describe_vortex_ring_points(tables: MapTables) -> str:
    """Return a note on the number of map points in vortex ring state (Leishman 2006, Sec. 2.13.6).

    The hover induced velocity that scales the descent is that of one disc with the thrust of both rotors.
    """
    ratio = tables.ratio[None, :, None]
    up = 2.0 / (1.0 + ratio)  # upper speed over the mean
    thrust = np.maximum(tables.cT_upper * up**2 + tables.cT_lower * (ratio * up) ** 2, 0.0)
    sink = -tables.climb_ratio / np.sqrt(np.maximum(0.5 * thrust, 1e-12))
    count = np.count_nonzero((sink > VORTEX_RING_DESCENT_RATIOS[0]) & (sink < VORTEX_RING_DESCENT_RATIOS[1]))
    return f"; {count} descend into their own wake; means of oscillating loads" if count else ""


def _describe_wake_settings(how: WakeSettings) -> str:
    return (
        f"{how.model} wake, step {how.step_deg:g} deg, {how.turns:g} turns, tolerance {how.tolerance:g}, "
        f"core {how.core:g}"
    )


def _check_map_axes(axes: Sequence[Array]) -> None:
    for key, axis, least in zip(("mean speed", "ratio", "climb"), axes, (1, 2, 2), strict=True):
        if axis.size < least:
            raise InputError("coax map", key, f"has {axis.size} value", f"give {least} or more")
        if not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0):
            raise InputError("coax map", key, "does not increase", "give finite values, each above the last")
        if key != "climb" and axis[0] <= 0:
            raise InputError("coax map", key, f"{axis[0]:g} is out of range", "give numbers above 0")
        if axis.size > 2 and np.ptp(np.diff(axis)) > 1e-6 * np.ptp(axis):
            raise InputError("coax map", key, "is not evenly spaced", "give equal steps")
    if not axes[2][0] <= 0.0 <= axes[2][-1]:
        raise InputError("coax map", "climb", "does not include 0 (hover)", "give a range that holds it")
    nodes = math.prod(a.size for a in axes)
    if nodes > MAX_MAP_NODES:
        raise InputError("coax map", "", f"{nodes} points", f"give fewer points ({MAX_MAP_NODES} at most)")


def _fill_unsolved_points(values: Array, solved: NDArray[np.bool_]) -> Array:
    """Fill unsolved points with the mean of their neighbours along the three axes, starting beside solved points."""
    found = np.where(solved[..., None], values, np.nan)
    known = solved.copy()
    while not known.all():
        total, count = np.zeros_like(found), np.zeros(known.shape)
        for axis in range(3):
            for shift in (1, -1):
                to = [slice(None)] * 3
                source = [slice(None)] * 3
                to[axis], source[axis] = (slice(1, None), slice(None, -1))[::shift]
                there = known[tuple(source)]
                total[tuple(to)] += np.where(there[..., None], found[tuple(source)], 0.0)
                count[tuple(to)] += there
        new = ~known & (count > 0)
        found[new] = total[new] / count[new][:, None]
        known |= new
    return found


def hash_bladings(*bladings: Blading) -> str:
    """Return the hash of blades and polars."""
    parts: list[object] = []
    for b in bladings:
        parts += [b.r_m, b.chord_m, b.twist_rad, b.polars.grid, b.blades, repr(b.corrections)]
    return hash_inputs(*parts)


_WRONG_MAP_MESSAGE = (
    "holds the points of another map that was stopped",
    "resume that map, delete this file, or write to another file",
)


@cached_njit(error_model="numpy")
def _cubic_weights(x: float, n: int) -> tuple[int, float, float, float, float]:
    """Return the index of the first of the four map points used in cubic interpolation at ``x``, and their weights.

    ``x`` is the position in steps from the first of ``n`` points.
    """
    x = min(max(x, 0.0), n - 1.0)
    i = min(int(x), n - 2)
    t = x - i
    a = t * (-0.5 + t * (1.0 - 0.5 * t))
    b = 1.0 + t * t * (-2.5 + 1.5 * t)
    c = t * (0.5 + t * (2.0 - 1.5 * t))
    d = t * t * (-0.5 + 0.5 * t)
    if i == 0:
        b, c, a = b + 2.0 * a, c - a, 0.0
    if i == n - 2:
        c, b, d = c + 2.0 * d, b - d, 0.0
    return i - 1, a, b, c, d


@cached_njit(error_model="numpy")
def interpolate_coefficient_tables(
    upper_t: Array,
    upper_q: Array,
    lower_t: Array,
    lower_q: Array,
    size: NDArray[np.int64],
    start: Array,
    per_step: Array,
    mean: float,
    ratio: float,
    climb_ratio: float,
) -> tuple[float, float, float, float]:
    """Interpolate thrust and torque of both rotors of a coefficient map at one speed, speed ratio and climb ratio.

    Parameters
    ----------
    upper_t, upper_q, lower_t, lower_q : (nodes,) arrays
        Thrust and torque of upper and lower rotor, in the order of C over (mean speed, ratio, climb).
    size : (3,) integer array
        Number of values on each axis.
    start, per_step : (3,) arrays
        First value of each axis, and reciprocal of its step.
    mean, ratio, climb_ratio : float
        Point of interpolation.

    Returns
    -------
    upper thrust, upper torque, lower thrust, lower torque : float
    """
    ns, nr, nc = size[0], size[1], size[2]
    s = min(max((mean - start[0]) * per_step[0], 0.0), ns - 1.0)
    k0 = min(int(s), max(ns - 2, 0))
    s -= k0
    j0, ra, rb, rc, rd = _cubic_weights((ratio - start[1]) * per_step[1], nr)
    i0, ca, cb, cc, cd = _cubic_weights((climb_ratio - start[2]) * per_step[2], nc)
    # At the edges a neighbour is missing; its weight is zero, so any index is valid.
    i_a, i_b, i_c, i_d = max(i0, 0), i0 + 1, i0 + 2, min(i0 + 3, nc - 1)
    ut = uq = lt = lq = 0.0
    for k in range(2):
        w = s if k == 1 else 1.0 - s
        if w == 0.0:
            continue
        for j in range(4):
            v = w * (ra if j == 0 else rb if j == 1 else rc if j == 2 else rd)
            row = ((k0 + k) * nr + min(max(j0 + j, 0), nr - 1)) * nc
            a, b, c, d = row + i_a, row + i_b, row + i_c, row + i_d
            ut += v * (ca * upper_t[a] + cb * upper_t[b] + cc * upper_t[c] + cd * upper_t[d])
            uq += v * (ca * upper_q[a] + cb * upper_q[b] + cc * upper_q[c] + cd * upper_q[d])
            lt += v * (ca * lower_t[a] + cb * lower_t[b] + cc * lower_t[c] + cd * lower_t[d])
            lq += v * (ca * lower_q[a] + cb * lower_q[b] + cc * lower_q[c] + cd * lower_q[d])
    return ut, uq, lt, lq


@lru_cache(maxsize=32)
def pack_map_tables(coefficients: CoefficientMap) -> tuple[Any, ...]:
    """Pack a map into the first seven arguments of :func:`interpolate_coefficient_tables`; its tables hold c_T and
    c_Q.
    """
    t = coefficients.decode_map_tables()
    axes = (t.mean_speed_rad_s, t.ratio, t.climb_ratio)
    step = [float((a[-1] - a[0]) / (a.size - 1)) if a.size > 1 else np.inf for a in axes]
    return (
        t.cT_upper.ravel(), t.cQ_upper.ravel(), t.cT_lower.ravel(), t.cQ_lower.ravel(),
        np.array(t.grid_shape, dtype=np.int64), np.array([float(a[0]) for a in axes]), 1.0 / np.array(step),
    )  # fmt: skip


def interpolate_map(
    coefficients: CoefficientMap, mean_speed_rad_s: ArrayLike, ratio: ArrayLike, climb_ratio: ArrayLike
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the thrust and torque coefficients of a map at given points, interpolated as in the flight model.

    Parameters
    ----------
    coefficients : CoefficientMap
    mean_speed_rad_s, ratio, climb_ratio : array_like
        Points, broadcast against each other (shape ...); axes as in :class:`mufly.vehicle.MapTables`.

    Returns
    -------
    values : (..., 4) array
        c_T upper, c_Q upper, c_T lower, c_Q lower.
    outside : (...) array of bool
        True where a point lies beyond an edge of ratio or climb, or beyond the range of mean speeds if there are
        several. The value at the edge is returned there.
    """
    points = np.broadcast_arrays(*(np.asarray(v, dtype=np.float64) for v in (mean_speed_rad_s, ratio, climb_ratio)))
    arguments = pack_map_tables(coefficients)
    flat = zip(*(p.ravel().tolist() for p in points), strict=True)
    values = np.array([interpolate_coefficient_tables(*arguments, *point) for point in flat]).reshape(
        *points[0].shape, 4
    )
    outside = np.zeros(points[0].shape, dtype=np.bool_)
    for p, axis in zip(points, coefficients.decode_map_tables()[:3], strict=True):
        if axis.size > 1:
            slack = 1e-9 * float(axis[-1] - axis[0])
            outside |= (p < axis[0] - slack) | (p > axis[-1] + slack)
    return values, outside
