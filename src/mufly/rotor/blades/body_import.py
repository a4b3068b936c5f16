"""Import of bodies: a rotor from the triangle surface of a blade or of a whole rotor.

Frame: the blade lies along x, its leading edge towards y, the shaft along z with thrust upwards. Lengths are in m.

A plane x = r cuts a triangle surface in closed curves. On the curve nearest to y = 0 the two points furthest apart are
leading and trailing edge; they give chord and twist. The leading edge is the end that is thicker at most stations, or,
at equal thickness, the higher end. A body is moved onto its shaft (:mod:`mufly.rotor.blades.scanned_pose`) and turned
about it until a blade lies along x; its hub is left out. If the sections scatter by more than
:data:`_MAX_EXACT_SCATTER_CHORDS` or have gaps, smooth contours are fitted
(:mod:`mufly.rotor.blades.scanned_sections`). The radius is then reduced by the expected excess of the outermost vertex.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, InputError
from mufly.rotor.blades.blade_solid import read_step, read_stl
from mufly.rotor.blades.scanned_pose import SHAFT_DIRECTIONS, count_blades, find_shaft
from mufly.rotor.blades.scanned_sections import (
    SectionCut,
    cut_triangles,
    estimate_scatter,
    find_cut_ends,
    fit_section,
)
from mufly.rotor.geometry import Rotor, make_rotor
from mufly.rotor.sections.airfoil import load_airfoil, split_sides

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

_MM_PER_M = 1e3
_MIN_RADIUS_IF_MM_M, _MAX_RADIUS_IF_MM_M = 8e-3, 5.0  # m, range of radii in which mm is assumed as the unit
_LENGTH_UNITS_M = {"m": 1.0, "in": 0.0254, "cm": 0.01, "mm": 1e-3, "um": 1e-6}
_END_THICKNESS_REGION_CHORDS, _END_THICKNESS_TOLERANCE_FRACTION = (
    0.15,
    0.25,
)  # of the chord; of the thickness in that region
# Of the chord: thickest blunt trailing edge, and greatest distance of its corners along the chord.
_MAX_BLUNT_TAIL_CHORDS, _BLUNT_TAIL_TOLERANCE_CHORDS = 0.1, 2e-3

_BLOCK_CUTS = 4  # neighbouring cuts share vertices
_FIT_GRID_COUNT, _FIT_WINDOW_RADII = 160, 0.07  # cuts along the blade; half the span of the cuts of one section
_MAX_EXACT_SCATTER_CHORDS = 2.5e-4  # of the chord: above, sections are fitted
_MAX_EXACT_BRIDGED_RATIO = 0.005  # of the outline
_MIN_ROTOR_RADIUS_M, _MAX_ROTOR_RADIUS_M = 5e-3, 20.0
_MAX_BLADES_OF_A_BODY = 12
_MAX_SIGN_ERROR_RAD, _MAX_SIGN_ERROR_CHORDS = math.radians(0.5), 3e-3  # of angle and camber taken as zero
_MAX_SHAFT_MISS_RADII, _MAX_USUAL_ROOT_RADII = 0.05, 0.35
_VERTEX_OVER_CUT_SCATTER = 1.3  # points of a cut lie between two vertices
_TIP_MARGIN_SCATTERS = 8.0  # from the tip to the last section
_MAX_ASSUMED_TIP_SWEEP_RAD = math.radians(20.0)
_MAX_BLADE_CHORD_JUMP_FRACTION, _MAX_BLADE_TWIST_JUMP_RAD = (
    0.2,
    math.radians(8.0),
)  # of chord or thickness; of the angle, between neighbouring cuts


@dataclass(frozen=True, eq=False)
class BladeSlice:
    """Cross-section of a blade at a radius.

    Attributes
    ----------
    r_m, chord_m, twist_rad : float
    contour : (n, 2) array
        Coordinates over chord, in Selig's order.
    """

    r_m: float
    chord_m: float
    twist_rad: float
    contour: Array


class OrientedCut(NamedTuple):
    """Cut of a blade at a radius, its nose towards +y, clockwise, with the indices of nose and tail."""

    r_m: float
    cut: SectionCut
    nose: int
    tail: int


def cut_blade(corners_m: Array, r_m: Sequence[float] | Array) -> list[OrientedCut]:
    """Return the cuts of a triangle surface, (n, 3, 3), at radii; radii without a closed curve are skipped."""
    lines = [(float(r), cut) for r in r_m if (cut := cut_triangles(corners_m, float(r))) is not None]
    ends = [_farthest_points(cut.points_m) for _, cut in lines]
    ahead = sum(_find_leading_edge_sign(cut.points_m, i, j) for (_, cut), (i, j) in zip(lines, ends, strict=True))
    sign = 1.0 if ahead >= 0.0 else -1.0
    out = []
    for (r, cut), (i, j) in zip(lines, ends, strict=True):
        flat, bridged = cut.points_m * [sign, 1.0], cut.bridged
        if _signed_area(flat) > 0.0:  # nose to the right: tail, upper side, nose is clockwise
            flat, i, j = flat[::-1], len(flat) - 1 - i, len(flat) - 1 - j
            bridged = np.roll(bridged[::-1], -1)
        nose, tail = (i, j) if flat[i, 0] > flat[j, 0] else (j, i)
        out.append(OrientedCut(r, SectionCut(flat, bridged), nose, tail))
    return out


def slice_blade(corners_m: Array, r_m: Sequence[float] | Array) -> list[BladeSlice]:
    """Return the cross-sections of a triangle surface, (n, 3, 3), at radii; the method is in the module docstring.

    Radii without a closed curve are skipped.
    """
    return [_normalise_cut(cut.r_m, cut.cut.points_m, cut.nose, cut.tail) for cut in cut_blade(corners_m, r_m)]


def _normalise_cut(r: float, flat: Array, nose: int, tail: int) -> BladeSlice:
    """Return chord, twist and contour of a cut with its nose towards +y, clockwise."""
    # Corners of a blunt trailing edge, one of which is the farthest point: the chord ends midway between them.
    edge = np.flatnonzero(
        np.hypot(*(flat - flat[tail]).T) < _MAX_BLUNT_TAIL_CHORDS * np.hypot(*(flat[tail] - flat[nose]))
    )
    edge = edge[
        (flat[edge] - flat[nose]) @ (flat[tail] - flat[nose])
        > (1.0 - _BLUNT_TAIL_TOLERANCE_CHORDS) * np.sum((flat[tail] - flat[nose]) ** 2)
    ]
    upper, lower = edge[np.argmax(flat[edge, 1])], edge[np.argmin(flat[edge, 1])]
    end = 0.5 * (flat[upper] + flat[lower])
    to_tail = end - flat[nose]
    chord = float(np.hypot(*to_tail))
    along, across = to_tail / chord, np.array([to_tail[1], -to_tail[0]]) / chord
    moved = flat - flat[nose]
    contour = np.roll(np.column_stack((moved @ along, moved @ across)) / chord, -upper, axis=0)
    last = (lower - upper) % len(contour)
    # On rough tails the lower corner may precede the upper one.
    contour = contour[: last + 1] if 2 * last > len(contour) else np.concatenate((contour, contour[:1]))
    return BladeSlice(r, chord, math.atan2(-to_tail[1], -to_tail[0]), contour)


class SurfaceQuality(NamedTuple):
    """Scatter of a surface's vertices (m), excess of the outermost one (m), bridged part of the sections' outlines."""

    scatter_m: float
    tip_excess_m: float
    bridged_ratio: float
    noisy: bool


def _assess_surface(corners: Array, radius: float) -> SurfaceQuality:
    """Return the quality of a surface; sections of a noisy one are fitted."""
    cuts = cut_blade(corners, radius * np.linspace(0.4, 0.9, 11))
    if not cuts:
        return SurfaceQuality(0.0, 0.0, 0.0, False)
    scatter = float(np.median([estimate_scatter(c.cut.points_m, c.nose, c.tail) for c in cuts]))
    chord = float(np.median([float(np.hypot(*np.ptp(c.cut.points_m, axis=0))) for c in cuts]))
    bridged = float(np.mean([c.cut.bridged_ratio for c in cuts]))
    if scatter <= _MAX_EXACT_SCATTER_CHORDS * chord and bridged <= _MAX_EXACT_BRIDGED_RATIO:
        return SurfaceQuality(0.0, 0.0, bridged, False)
    # The outermost of n vertices at the tip lies beyond it by their greatest normal deviate.
    near = corners.reshape(-1, 3)[corners.reshape(-1, 3)[:, 0] > radius - 5.0 * scatter]
    count = len(np.unique(np.round(near / (1e-7 * radius)), axis=0))
    excess = _VERTEX_OVER_CUT_SCATTER * scatter * float(norm.ppf(1.0 - 0.6 / (count + 0.2)))
    return SurfaceQuality(scatter, max(excess, 0.0), bridged, True)


class FitQuality(NamedTuple):
    """Scatter of a surface, and standard deviations of the contours (m) and angles (rad) fitted to it."""

    scatter_m: float
    contour_std_m: float
    angle_std_rad: float


def _smooth_slices(corners: Array, r_m: Array, radius: float, scatter: float) -> tuple[list[BladeSlice], FitQuality]:
    """Return sections fitted to the cuts around each radius, and the quality of the fits between 0.4 and 0.9 R.

    The standard deviation is half the rms difference of fits to two halves of the cuts, which alternate in blocks.
    """
    grid = np.linspace(float(r_m[0]), radius - 4.0 * scatter, _FIT_GRID_COUNT)
    cuts = cut_blade(corners, grid)
    at = np.array([c.r_m for c in cuts])
    ends = [find_cut_ends(c.cut.points_m, c.nose, c.tail) for c in cuts]
    middles = corners[:, :, 0].mean(axis=1)

    def fit_slice(r: float, chosen: Integers, half: float, share: float) -> tuple[BladeSlice, float] | None:
        fit = None
        if chosen.size > 2:
            vertices = int(share * float(np.sum(np.abs(middles - r) < half))) // 2
            fit = fit_section(r, at[chosen], [cuts[k].cut for k in chosen], [ends[k] for k in chosen], vertices)
        if fit is None:
            return None
        return _normalise_cut(r, fit.points_m, *_find_nose_and_tail(fit.points_m)), fit.scatter_m

    slices, scatters, apart = [], [], []
    with threadpool_limits(1, "blas"):
        for r in r_m.tolist():
            half = min(_FIT_WINDOW_RADII * radius, max(0.5 * (radius - r), 0.01 * radius))
            near = np.flatnonzero(np.abs(at - r) < half)
            found = fit_slice(r, near, half, 1.0)
            if found is None:
                continue
            slices.append(found[0])
            if 0.4 * radius < r < 0.9 * radius:
                scatters.append(found[1])
                block = near // _BLOCK_CUTS % 2
                parts = [fit_slice(r, near[block == k], half, 0.5) for k in (0, 1)]
                if parts[0] is not None and parts[1] is not None:
                    apart.append(_compare_slices(parts[0][0], parts[1][0]))
    if len(slices) < 4 or not apart:
        raise InputError("blade", "", "has a surface too rough for its sections", "smooth or repeat the scan")
    contour, angle = 0.5 * np.sqrt(np.mean(np.square(apart), axis=0))
    return slices, FitQuality(float(np.median(scatters)), float(contour), float(angle))


def _compare_slices(one: BladeSlice, other: BladeSlice) -> tuple[float, float]:
    """Return the rms distance of two contours about their chord lines (m) and the difference of their angles (rad)."""
    x = np.linspace(0.02, 0.98, 49)
    sides = zip(split_sides(one.contour), split_sides(other.contour), strict=True)
    misses = [np.interp(x, *a.T) - np.interp(x, *b.T) for a, b in sides]
    return one.chord_m * float(np.sqrt(np.mean(np.square(misses)))), one.twist_rad - other.twist_rad


def _find_nose_and_tail(flat: Array) -> tuple[int, int]:
    i, j = _farthest_points(flat)
    return (i, j) if flat[i, 0] > flat[j, 0] else (j, i)


def _find_leading_edge_sign(loop: Array, i: int, j: int) -> float:
    """Return a positive value if the leading edge of a section is its end with the greater y, else a negative one.

    The leading edge is the thicker end, or, at equal thickness, the higher end.
    """
    front, back = (i, j) if loop[i, 0] > loop[j, 0] else (j, i)
    chord = loop[back] - loop[front]
    size = float(np.hypot(*chord))
    along = (loop - loop[front]) @ chord / size**2
    across = (loop - loop[front]) @ [chord[1], -chord[0]] / size**2
    first, last = (
        float(np.ptp(across[part]))
        for part in (along < _END_THICKNESS_REGION_CHORDS, along > 1.0 - _END_THICKNESS_REGION_CHORDS)
    )
    if abs(first - last) > _END_THICKNESS_TOLERANCE_FRACTION * max(first, last):
        return math.copysign(1.0, first - last)
    return math.copysign(1.0, -chord[1]) if chord[1] else 0.0


def rotor_from_body(
    path: str | Path,
    *,
    unit_m: float | None = None,
    folder: str | Path,
    blades: int | None = None,
    name: str = "",
    axis: str | None = None,
    centre: Sequence[float] | None = None,
) -> tuple[Rotor, tuple[str, ...]]:
    """Make a rotor from the solid of a blade or of a whole rotor; write the contours of its sections to ``folder``.

    Parameters
    ----------
    path : str or Path
        STL or STEP file; the shaft lies along z through the origin, thrust upwards. A body whose blades lie elsewhere
        in the plane of the disc is turned; a hub is removed. A whole rotor is moved onto its shaft, and turned over if
        it lies upside down.
    unit_m : float, optional
        Unit of length of an STL file (m); STEP files state it. Default: mm, if the radius is then plausible.
    folder : str or Path
        Folder of the contours ``NAME-K.dat``, to which the rotor refers.
    blades : int, optional
        Number of blades. Default: those of the body; 2 if it is a single blade.
    name : str
        Name of the rotor. Default: the file's.
    axis : str, optional
        Direction of the thrust in the file, one of :data:`mufly.rotor.blades.scanned_pose.SHAFT_DIRECTIONS`. Default:
        z, or -z if the body lies upside down.
    centre : sequence of float, optional
        Point of the shaft, x, y and optionally z, in the file's axes (m). Default: the origin, or the axis of symmetry
        of a whole rotor.

    Returns
    -------
    rotor : Rotor
    notes : tuple of str
        Values that were guessed.

    Raises
    ------
    InputError
        If the file contains no solid, or no plane cuts a closed section.
    """
    where, called = Path(path).name, name or Path(path).stem
    step = Path(path).suffix.lower() in (".step", ".stp")
    notes: list[str] = []
    corners = read_step(path) if step else read_stl(path, unit_m or 1.0 / _MM_PER_M)
    corners, counted = _place_on_shaft(corners, where, axis, centre, notes)
    corners, turned = _turn_blade_to_x(corners)
    corners = _turn_upright(corners, notes, given=axis is not None)
    radius = float(corners[:, :, 0].max())
    if not radius > 0.0:
        raise InputError(where, "", "has no surface at x > 0", "orient the body: one blade along x, shaft along z")
    outer = corners[
        (corners[:, :, 0] > 0.5 * radius).all(axis=1) & (np.abs(corners[:, :, 1]) < 0.5 * radius).all(axis=1)
    ]
    if outer.size and np.ptp(outer[:, :, 2]) > np.ptp(outer[:, :, 1]):
        raise InputError(
            where, "", "has a blade with its chord along z, the direction of the shaft",
            "give --axis with the direction of the thrust in the file, as --axis x",
        )  # fmt: skip
    share = np.linspace(0.05, 1.0, 200)[:-1]
    found = {s.r_m: s for s in slice_blade(corners, radius * share)}
    # The blade begins at the innermost radius where the section's nose lies in front of the x axis and its tail behind.
    good = [s for s in found.values() if s.chord_m < 0.6 * radius and float(np.ptp(s.contour[:, 1])) < 0.5]
    quality = _assess_surface(corners, radius)
    good = _drop_hub_slices(good, float(share[1] - share[0]) * radius, noisy=quality.noisy)
    if len(good) < 4:
        raise InputError(where, "", "has no closed sections along x", "give one closed blade along x")
    least, greatest = (
        (_MIN_RADIUS_IF_MM_M, _MAX_RADIUS_IF_MM_M) if unit_m is None else (_MIN_ROTOR_RADIUS_M, _MAX_ROTOR_RADIUS_M)
    )
    if not step and not least <= radius <= greatest:
        written = radius / (unit_m or 1.0 / _MM_PER_M)
        likely = [
            f"{u} (R {_MM_PER_M * f * written:.4g} mm)" for u, f in _LENGTH_UNITS_M.items() if 0.01 < f * written < 0.7
        ]
        problem = (
            f"is not known: {where} reaches {written:.4g} along x, in mm no rotor's radius"
            if unit_m is None
            else f"is wrong: {where} would have a radius of {_MM_PER_M * radius:.4g} mm"
        )
        raise ArgumentError("unit", "", problem, f"give its unit, as unit={' or '.join(likely) or 'mm'}")
    first = good[0].r_m
    radius -= quality.tip_excess_m
    if counted == 1:
        _check_shaft_of_blade(corners, where, radius, first, given=centre is not None, notes=notes)
    inner = float(corners[:, :, 0].min())
    first = max(first, inner + _TIP_MARGIN_SCATTERS * quality.scatter_m if inner > 0.0 else 0.0)
    last = radius - max(0.005 * radius, _TIP_MARGIN_SCATTERS * quality.scatter_m)
    wanted = first + (last - first) * 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, 15)))
    if quality.noisy:
        cut, fit = _smooth_slices(corners, wanted, radius, quality.scatter_m)
        notes.append(
            f"the surface scatters by {_MM_PER_M * fit.scatter_m:.2g} mm: smooth sections were fitted, with standard "
            f"deviations of {_MM_PER_M * fit.contour_std_m:.2g} mm of the contour and "
            f"{math.degrees(fit.angle_std_rad):.2g} degrees of the angle"
        )
    else:
        cut = slice_blade(corners, wanted)
    if quality.bridged_ratio > 0.0:
        notes.append(
            f"gaps of the surface were closed: {100 * quality.bridged_ratio:.1f} % of the outlines of the sections"
        )
    files = []
    for k, s in enumerate(cut):
        file = Path(folder) / f"{called}-{k}.dat"
        rows = "\n".join(f"{x:.6f} {y:.6f}" for x, y in _drop_duplicate_points(s.contour))
        file.write_text(f"{called}, r {_MM_PER_M * s.r_m:.2f} mm\n{rows}\n", encoding="utf-8")
        load_airfoil(file)
        files.append(str(file))
    x = np.array([s.r_m / radius for s in cut])
    x[-1] = 1.0
    notes[:0] = [f"{len(cut)} sections from {x[0]:.2f} R on, sweep and rake are ignored"]
    if turned:
        notes.append(f"the body was turned by {math.degrees(turned):.0f} degrees about the shaft: a blade lies along x")
    if counted > 1 and counted != blades:
        stated = "" if blades is None else f", not {blades}: --blades prevails"
        notes.append(f"the body has {counted} blades{stated}")
    elif counted == 1 and blades is None:
        notes.append("two blades assumed; give --blades for another number")
    blades = blades or (counted if counted > 1 else 2)
    rotor = make_rotor(
        name=called, radius_m=radius, chord_m=[s.chord_m for s in cut], twist_rad=[s.twist_rad for s in cut],
        airfoils=files, r_over_R=x, blades=blades or 2, hub_cutout=float(x[0]), source="CAD",
        description=f"cut from {where}",
    )  # fmt: skip
    return rotor, tuple(notes)


def _place_on_shaft(
    corners: Array, where: str, axis: str | None, centre: Sequence[float] | None, notes: list[str]
) -> tuple[Array, int]:
    """Return the body with its shaft along z through the origin, and its number of blades."""
    if axis is not None and axis not in SHAFT_DIRECTIONS:
        raise ArgumentError("axis", repr(axis), "is unknown", f"use one of: {', '.join(SHAFT_DIRECTIONS)}")
    if centre is not None:
        if len(centre) not in (2, 3) or not np.all(np.isfinite(centre)):
            raise ArgumentError("centre", "", "is no point", "give x,y or x,y,z of a point of the shaft")
        corners = corners - np.array([*centre, 0.0])[:3]
    if axis is not None:
        corners = corners @ np.array(SHAFT_DIRECTIONS[axis]).T
    shaft = find_shaft(corners)
    if centre is None and shaft.centre_m != (0.0, 0.0):
        corners = corners - [*shaft.centre_m, 0.0]
        x, y = (f"{_MM_PER_M * v:.2f}" for v in shaft.centre_m)
        notes.append(f"the rotor's axis of symmetry lies at ({x}, {y}) mm: moved there; --centre gives another shaft")
    counted = shaft.blades if shaft.blades > 1 and centre is None else count_blades(corners)
    if counted > _MAX_BLADES_OF_A_BODY:
        raise InputError(where, "", f"would have {counted} blades", "give --centre, a point of the shaft")
    return corners, counted


def _turn_upright(corners: Array, notes: list[str], *, given: bool) -> Array:
    """Return a body turned over about x if that makes angle or camber positive at mid-span."""
    over = corners * [1.0, -1.0, -1.0]
    as_given = _count_plausible_signs(corners)
    if not given and _count_plausible_signs(over) > as_given:
        notes.append("the body lay upside down, with negative thrust, and was turned over; --axis z keeps it as it is")
        return over
    if as_given < 2:
        notes.append("blade angle or camber is negative at mid-span: if the body lies upside down, give --axis -z")
    return corners


def _count_plausible_signs(corners: Array) -> int:
    """Return how many of blade angle and camber at mid-span are not negative."""
    slices = slice_blade(corners, float(corners[:, :, 0].max()) * np.linspace(0.5, 0.85, 8))
    if not slices:
        return 2
    cambers = []
    for s in slices:
        upper, lower = split_sides(s.contour)
        cambers.append(0.5 * float(np.interp(0.5, *upper.T) + np.interp(0.5, *lower.T)))
    twist = float(np.median([s.twist_rad for s in slices]))
    return int(twist > -_MAX_SIGN_ERROR_RAD) + int(float(np.median(cambers)) > -_MAX_SIGN_ERROR_CHORDS)


def _check_shaft_of_blade(
    corners: Array, where: str, radius: float, first: float, *, given: bool, notes: list[str]
) -> None:
    """Raise an error if the cuts of a single blade do not point to the shaft; note a blade that begins far out."""
    cuts = cut_blade(corners, first + (radius - first) * np.linspace(0.1, 0.9, 9))
    if given or len(cuts) < 4:
        return
    r = np.array([c.r_m for c in cuts])
    low, high = (float(np.polyfit(r, [edge(c.cut.points_m[:, 0]) for c in cuts], 1)[1]) for edge in (np.min, np.max))
    miss = max(min(low, high), -max(low, high), 0.0)
    if miss > _MAX_SHAFT_MISS_RADII * radius:
        raise InputError(
            where, "", f"has a blade that passes the shaft at {_MM_PER_M * miss:.3g} mm",
            "give --centre X,Y, a point of the shaft in the file",
        )  # fmt: skip
    if first > _MAX_USUAL_ROOT_RADII * radius:
        notes.append(
            f"the blade begins at {first / radius:.2f} R: is the shaft at the origin of the file? --centre moves it"
        )


def _turn_blade_to_x(corners: Array) -> tuple[Array, float]:
    """Turn a body about the shaft, z, until its longest blade lies along x; return it and the angle (rad).

    A body that already reaches its radius within 20 degrees of x is not turned, because a swept tip does not show the
    direction of the blade. Otherwise the middle of the chord is fitted by a r + b w over the radius r and the width w
    of the blade, and a is the remaining angle of the blade.
    """
    points = corners.reshape(-1, 3)
    size, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    tips = size > 0.99 * size.max()
    if np.any(tips & (np.abs(angle) < _MAX_ASSUMED_TIP_SWEEP_RAD)):
        return corners, 0.0
    first = angle[np.argmax(size)]
    apart = (angle - first + math.pi) % (2.0 * math.pi) - math.pi
    blade = (size > 0.7 * size.max()) & (np.abs(apart) < _MAX_ASSUMED_TIP_SWEEP_RAD)
    turn = -float(first + 0.5 * (apart[blade].min() + apart[blade].max()))
    near = _turn_about_shaft(corners, turn)
    radii = float(near[:, :, 0].max()) * np.linspace(0.35, 0.95, 13)
    cuts = [(r, cut.points_m[:, 0]) for r in radii if (cut := cut_triangles(near, float(r))) is not None]
    if len(cuts) > 2:
        ends = np.array([(r, y.min(), y.max()) for r, y in cuts])
        shape = np.column_stack((ends[:, 0], ends[:, 2] - ends[:, 1]))
        turn -= math.atan(float(np.linalg.lstsq(shape, 0.5 * (ends[:, 1] + ends[:, 2]), rcond=None)[0][0]))
    return _turn_about_shaft(corners, turn), turn


def _turn_about_shaft(corners: Array, angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]))


def _drop_hub_slices(slices: list[BladeSlice], step_m: float, *, noisy: bool = False) -> list[BladeSlice]:
    """Return the slices outside the hub, where chord, thickness or angle jump, or where cuts are missing.

    On noisy surfaces, medians over five cuts are compared.
    """
    table = np.array([(math.log(s.chord_m), math.log(float(np.ptp(s.contour[:, 1]))), s.twist_rad) for s in slices])
    if noisy:
        padded = np.concatenate((table[:1], table[:1], table, table[-1:], table[-1:]))
        table = np.median([padded[k : k + len(table)] for k in range(5)], axis=0)
    middle = next((k for k, s in enumerate(slices) if s.r_m > 0.5 * slices[-1].r_m), 0)
    for k in range(middle, 0, -1):
        jump, bent = np.max(np.abs(table[k, :2] - table[k - 1, :2])), abs(table[k, 2] - table[k - 1, 2])
        if (
            slices[k].r_m - slices[k - 1].r_m > (6.5 if noisy else 2.5) * step_m
            or jump > _MAX_BLADE_CHORD_JUMP_FRACTION
            or bent > _MAX_BLADE_TWIST_JUMP_RAD
        ):
            return slices[k:]
    return slices


def _drop_duplicate_points(contour: Array) -> Array:
    """Return a contour without coincident points."""
    step = np.hypot(*np.diff(contour, axis=0).T)
    return contour[np.concatenate(([True], step > 1e-5))]


def _signed_area(loop: Array) -> float:
    x, y = loop.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _farthest_points(loop: Array) -> tuple[int, int]:
    """Return the indices of the two points of a curve that are furthest apart."""
    apart = np.sum((loop[:, None] - loop[None]) ** 2, axis=2)
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    return int(i), int(j)
