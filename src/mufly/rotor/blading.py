"""Blades as arrays for the solver: stations, polars, and the corrections that depend on geometry only.

Stations sit in the middle of panels whose edges follow x = x0 + (1 - x0) (1 - cos t) / 2 with t uniform. They are dense
at hub and tip, where the loading varies fastest.

Corrections of a blade element calculation; derivations: docs/explanation/bemt.md, their effect on the error:
docs/log/2026-11-28-bemt-accuracy.md.

* ``tip_loss``: ``"prandtl"`` is F = (2/pi) acos exp(-f), f = N (R - r) / (2 r |sin phi|).
  This is Glauert's form of Prandtl's factor (Leishman, sec. 3.3.10). ``"effective_radius"`` is eq. 3.13 of the
  dissertation: no lift beyond R_e = R (1 - 1.386 lambda / (N sqrt(1 + lambda^2))); ``"none"``.
* ``hub_loss``: the same factor at the inner end of the blade, f = N (r - r0) / (2 r0 |sin phi|).
* ``swirl``: induced velocity at right angles to the relative wind, not to the disc.
* ``lifting_surface``: flow tangency at three quarters of the chord (below).
* ``stall_delay``: stall delay due to rotation. Centrifugal and Coriolis forces act on the separated air of a rotating
  blade, so that the pressure stays closer to that of attached flow than in two dimensions. Attached potential flow
  gives a thin section the normal force c_n = 2 pi sin a cos a (a = alpha - alpha_0). A fraction g of the lift deficit
  of the polar is restored. Leading-edge suction is not: the recovered force is normal to the chord (own derivation)::

      delta c_l = g (2 pi sin a cos^2 a - c_l),    delta c_d = delta c_l tan alpha

  g is published, from boundary-layer theory and wind turbines: ``"dumitrescu-cardos"`` 1 - exp(-1.25 / (r/c - 1)) (J.
  Phys. Conf. Ser. 75, 012022, 2007), which stays below 1 for every chord; ``"snel"`` 3 (c/r)^2 (ECN-C-93-052, 1994);
  ``"chaviaropoulos-hansen"`` 2.2 (c/r) cos^4 theta (J. Fluids Eng. 122, 2000), both cut at 1; ``"none"``. The model
  applies in full up to |alpha| = 30 degrees, fades out at 50, and never lowers the lift.

Finite chord: the blade as a lifting surface with one row of horseshoe vortices (own derivation,
docs/explanation/bemt.md).

Blade element theory represents the blade by a line. On a blade of aspect ratio 2.5 to 6 the downwash of its own
trailing vortices grows along the chord, and the flow has to be tangent to the whole chord. Weissinger's rule (NACA TM
1120, 1947) satisfies tangency at three quarters of the chord with the vortex at one quarter. The rule is exact for a
flat plate in two dimensions. With G the circulation of the panels of one blade::

    w_34 = A34 G     downwash at three quarters of the chord from the blade's own bound and near trailing vortices
    w_14 = A14 G     the same on the quarter chord line, as seen by a lifting line
    G / (pi c)       downwash of the bound vortex alone at three quarters of the chord in two dimensions

A two-dimensional section with the downwash w_14 has an angle of attack that is too large by

    d_alpha = [A34 - A14 - diag(1 / (pi c))] G / W = e c_l,      e = c [(A34 - A14) G - G / (pi c)] / (2 G).

e vanishes for large aspect ratio. The contributions of the other blades and the far wake to w_34 and w_14 are nearly
equal and cancel. Only the near wake counts: straight legs to the trailing edge, then circular arcs. The shape of G is
that of the blade alone in solid body rotation, A34 G = Omega r. For an elliptic wing e = (sqrt(1 + (2 / AR)^2) - 1) /
(2 pi), which is Helmbold's formula. The straight-wing limit of this module agrees with Weissinger's lift slopes.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError
from mufly.rotor.effective_pitch import estimate_pitch_offset_prior
from mufly.rotor.geometry import Rotor
from mufly.rotor.sections import polar_engines
from mufly.rotor.sections.polar_engines import PolarEngine
from mufly.rotor.sections.polar_file import is_polar_file
from mufly.rotor.sections.polar_table import PolarStack, PolarTable, stack_polars

Array = NDArray[np.float64]

TipLossModel = Literal["prandtl", "effective_radius", "none"]
StallDelayModel = Literal["dumitrescu-cardos", "snel", "chaviaropoulos-hansen", "none"]


@dataclass(frozen=True)
class Corrections:
    """Switches of the corrections to blade element theory; measurements are compared with the default set.

    Attributes
    ----------
    tip_loss, hub_loss, swirl, lifting_surface, stall_delay
        See the module docstring.
    drag_factor, lift_factor : float
        Multipliers of the section coefficients; 1 unless the user calibrates them on a measured rotor.

    Thesis: eq. 3.13.
    """

    tip_loss: TipLossModel = "prandtl"
    hub_loss: bool = True
    swirl: bool = True
    lifting_surface: bool = True
    stall_delay: StallDelayModel = "dumitrescu-cardos"
    lift_factor: float = 1.0
    drag_factor: float = 1.0

    def __post_init__(self) -> None:
        for key, allowed in (
            ("tip_loss", ("prandtl", "effective_radius", "none")),
            ("stall_delay", ("dumitrescu-cardos", "snel", "chaviaropoulos-hansen", "none")),
        ):
            if getattr(self, key) not in allowed:
                raise InputError(
                    "corrections",
                    key,
                    f"{getattr(self, key)!r} is unknown",
                    f"choose one of {', '.join(allowed)}",
                )
        for key in ("lift_factor", "drag_factor"):
            if not 0.0 < getattr(self, key) < 10.0:
                raise InputError("corrections", key, f"is {getattr(self, key):g}", "give a factor between 0 and 10")

    @property
    def is_calibrated(self) -> bool:
        """True if a factor was set by hand or by calibration."""
        return self.lift_factor != 1.0 or self.drag_factor != 1.0


TEXTBOOK_CORRECTIONS = Corrections(lifting_surface=False, stall_delay="none")  # textbook blade element momentum theory


def stall_delay_strength(kind: StallDelayModel, chord_over_r: Array) -> Array:
    """Return the share g of the lift lost by stall that rotation restores at each station, (stations,).

    For Chaviaropoulos and Hansen the factor cos^4 theta is left out.

    Parameters
    ----------
    kind : str
        Model.
    chord_over_r : array
        Local chord over local radius.
    """
    if kind == "dumitrescu-cardos":
        return 1.0 - np.exp(-1.25 * chord_over_r / np.maximum(1.0 - chord_over_r, 1e-6))
    if kind == "snel":
        return np.minimum(3.0 * chord_over_r**2, 1.0)
    if kind == "chaviaropoulos-hansen":
        return np.minimum(2.2 * chord_over_r, 1.0)
    return np.zeros_like(chord_over_r)


def blunt_edge_drag_product(edge_m: float, chord_m: Array) -> Array:
    """Return the drag of a blunt trailing edge as the constant product c_d c_f^(1/3), (stations,).

    c_d is the added drag coefficient, c_f that of the section without the blunt edge.

    Hoerner (Fluid-Dynamic Drag, 1965, ch. III): the base drag of an edge of thickness h in plane flow is C_DB = 0.135 /
    (c_f c / h)^(1/3) on the area of the base, so that c_d = 0.135 (h / c)^(4/3) / c_f^(1/3). The ratio h / c is limited
    to 0.1, because edges thin out towards a pointed tip.

    Parameters
    ----------
    edge_m : float
        Thickness h (m).
    chord_m : (stations,) array
    """
    return np.asarray(0.135 * np.minimum(edge_m / chord_m, 0.1) ** (4.0 / 3.0), dtype=np.float64)


def find_zero_lift_angle(table: PolarTable) -> float:
    """Return the zero-lift angle (rad) of a polar at the Reynolds number nearest to 3e5.

    If there are several, the angle closest to zero is returned; without one, 0. The potential-flow lift line of the
    stall delay models passes through this angle. The boundary layer is thin there, so the angle is close to the
    inviscid one.
    """
    near = np.abs(table.alpha_rad) <= np.deg2rad(20.0)
    row = int(np.argmin(np.abs(np.log(table.reynolds / 3e5))))
    a, cl = table.alpha_rad[near], table.cl[row, near]
    cross = np.flatnonzero((cl[:-1] <= 0.0) & (cl[1:] > 0.0))
    if cross.size == 0:
        return 0.0
    angles = a[cross] - cl[cross] * (a[cross + 1] - a[cross]) / (cl[cross + 1] - cl[cross])
    return float(angles[np.argmin(np.abs(angles))])


Integers = NDArray[np.int64]

STATION_COUNT = 24
_DEFAULT_THICKNESS_RATIO = 0.12  # over chord, of a section whose polar states none


@dataclass(frozen=True, eq=False)
class Blading:
    """One or several rotors as arrays for the solver; created by :func:`prepare_blading`.

    Attributes
    ----------
    rotors : tuple of Rotor
        The rotors, ``n`` of them.
    corrections : Corrections
        Active corrections.
    r_m, dr_m, chord_m, twist_rad, angle_loss_per_cl_rad, stall_delay_strength : (n, stations) arrays
        Radius, panel width and chord (m), twist (rad); loss of angle e per lift coefficient (rad), stall delay strength
        g.
    edge_drag : (n, stations) array
        Drag constant of the blunt trailing edge, see :func:`blunt_edge_drag_product`.
    first_polar, second_polar, second_weight : (n, stations) arrays
        Indices of the two polars in the stack, and weight of the second.
    polars : PolarStack
        Polars of all rotors.
    polar_zero_lift_rad, polar_thickness_ratio : (tables,) arrays
        Zero-lift angle and thickness over chord of each polar; 0.12 if the polar states none.
    """

    rotors: tuple[Rotor, ...]
    corrections: Corrections
    r_m: Array
    dr_m: Array
    chord_m: Array
    twist_rad: Array
    angle_loss_per_cl_rad: Array
    stall_delay_strength: Array
    edge_drag: Array
    first_polar: Integers
    second_polar: Integers
    second_weight: Array
    polars: PolarStack
    polar_zero_lift_rad: Array
    polar_thickness_ratio: Array

    @cached_property
    def kernel_arrays(self) -> Any:
        """All arrays as a :data:`Blades` tuple for the kernels."""
        names: tuple[str, ...] = Blades._fields
        return Blades(*(getattr(self, name) for name in names))

    @property
    def is_calibrated(self) -> bool:
        """True if factors were set by hand, or a rotor's sections were fitted to measurements."""
        return self.corrections.is_calibrated or any(rotor.fit is not None for rotor in self.rotors)

    @property
    def radius_m(self) -> Array:
        """Radius of each rotor."""
        return np.array([rotor.radius_m for rotor in self.rotors])

    @property
    def hub_radius_m(self) -> Array:
        """Hub radius of each rotor."""
        return np.array([rotor.hub_radius_m for rotor in self.rotors])

    @property
    def blades(self) -> Array:
        """Number of blades of each rotor."""
        return np.array([float(rotor.blades) for rotor in self.rotors])


Blades = namedtuple(  # type: ignore[misc]
    "Blades", [*(f.name for f in fields(Blading)[2:]), "radius_m", "hub_radius_m", "blades"], module=__name__
)


def compute_panel_middles_and_edges(cutout: float, stations: int) -> tuple[Array, Array]:
    """Return middles and edges of the panels (r/R).

    Returns
    -------
    mid : (stations,) array
        Radii of the middles over R.
    edges : (stations + 1,) array
        Radii of the edges over R.
    """
    t = np.linspace(0.0, np.pi, stations + 1)
    span = 1.0 - cutout
    edges = cutout + span * 0.5 * (1.0 - np.cos(t))
    middle = cutout + span * 0.5 * (1.0 - np.cos(0.5 * (t[1:] + t[:-1])))
    return middle, edges


def prepare_blading(
    rotors: Rotor | Sequence[Rotor],
    polars: Mapping[str, PolarTable] | None = None,
    *,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    corrections: Corrections | None = None,
    stations: int = STATION_COUNT,
) -> Blading:
    """Convert rotors to arrays for :func:`mufly.rotor.bemt.solve_rotor` and the other solvers.

    Parameters
    ----------
    rotors : Rotor or sequence of Rotor
        One rotor, or several for one batch.
    polars : mapping, optional
        Polar by airfoil name, for every airfoil of the rotors. By default ``engine`` computes them (or reads them from
        the cache) at ``n_crit`` and with the trips of each rotor, for Reynolds numbers from 2e3 to 6e6.
    corrections : Corrections, optional
        Default: all that docs/explanation/bemt.md recommends.
    stations : int
        Stations along a blade; 24 give thrust and torque within 0.1 % of 200.

    Raises
    ------
    InputError
        If an airfoil has no polar, or fewer than four stations are asked for.
    """
    many = (rotors,) if isinstance(rotors, Rotor) else tuple(rotors)
    fixes = corrections or Corrections()
    if not many:
        raise InputError("rotor", "", "no rotor given", "give at least one")
    if stations < 4:
        raise InputError("rotor", "stations", f"{stations} is too few for a blade", "give 4 or more")
    fits = [None if rotor.fit is None else (rotor.fit.candidates[0].change, rotor.fit.reynolds) for rotor in many]
    computed: dict[Any, Mapping[str, PolarTable]] = {}
    for rotor in many:
        same = (rotor.airfoil_names(), rotor.transition_at_n_crit(n_crit))
        if polars is None and same not in computed:
            computed[same] = compute_rotor_polars(rotor, n_crit=n_crit, engine=engine)
    known = [computed.get((r.airfoil_names(), r.transition_at_n_crit(n_crit)), polars or {}) for r in many]
    found: dict[tuple[Any, ...], PolarTable] = {}  # one table for each airfoil, fit and transition
    own: list[dict[str, tuple[Any, ...]]] = []  # key in it of each rotor's airfoils
    for rotor, fit, at_hand in zip(many, fits, known, strict=True):
        made = rotor.fit.n_crit if rotor.fit is not None else math.nan
        transition = rotor.transition_at_n_crit(n_crit) if polars is None else None
        own.append({name: (name, fit, transition) for name in rotor.airfoil_names()})
        for name, key in own[-1].items():
            if name not in at_hand:
                raise InputError(
                    "rotor", f"airfoil {name}", "has no polar", f"give one of {', '.join(sorted(at_hand))}"
                )
            if abs(at_hand[name].n_crit - made) > 1e-9:
                raise InputError(
                    f"rotor {rotor.name}", "fit", f"was fitted with polars at n_crit {made:g}, but the "
                    f"given polars are at {at_hand[name].n_crit:g}", "use the same n_crit, or delete [fit] "
                    "from the file",
                )  # fmt: skip
            if key not in found:
                found[key] = at_hand[name] if fit is None else apply_section_fit(at_hand[name], *fit)
    keys, tables = list(found), list(found.values())
    shape = (len(many), stations)
    r, dr, chord, twist, e, g, base, weight = (np.zeros(shape) for _ in range(8))
    first, second = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    for k, rotor in enumerate(many):
        big = rotor.radius_m
        mid, edges = compute_panel_middles_and_edges(float(rotor.hub_cutout), stations)
        cut = rotor.sections_at(mid)
        index = np.array([keys.index(own[k][name]) for name in cut.airfoil_names], dtype=np.int64)
        r[k], dr[k], chord[k] = mid * big, np.diff(edges) * big, cut.chord_m
        twist[k] = cut.twist_rad + estimate_pitch_offset_prior(rotor).offset_mean_rad
        if rotor.fit is not None:
            twist[k] += rotor.fit.candidates[0].change[0]
        first[k] = index[cut.first_airfoil]
        second[k] = index[cut.second_airfoil]
        weight[k] = cut.second_weight
        if fixes.lifting_surface:
            e[k] = compute_angle_loss_per_cl(mid, edges, cut.chord_m / big, rotor.chord_m(edges) / big)
        g[k] = stall_delay_strength(fixes.stall_delay, chord[k] / r[k])
        base[k] = blunt_edge_drag_product(float(rotor.trailing_edge), chord[k])
    stack = stack_polars(tables)
    return Blading(
        rotors=many,
        corrections=fixes,
        r_m=r,
        dr_m=dr,
        chord_m=chord,
        twist_rad=twist,
        angle_loss_per_cl_rad=e,
        stall_delay_strength=g,
        edge_drag=base,
        first_polar=first,
        second_polar=second,
        second_weight=weight,
        polars=stack,
        polar_zero_lift_rad=np.array([find_zero_lift_angle(table) for table in tables]),
        polar_thickness_ratio=np.nan_to_num([table.thickness_ratio for table in tables], nan=_DEFAULT_THICKNESS_RATIO),
    )


def compute_rotor_polars(
    rotor: Rotor, airfoils: Iterable[str] = (), *, n_crit: float = 0.1, engine: PolarEngine = "neuralfoil"
) -> dict[str, PolarTable]:
    """Return the polars of a rotor's sections by airfoil name, with its trips and its surface.

    Parameters
    ----------
    rotor : Rotor
    airfoils : iterable of str
        Airfoils in place of the rotor's.
    n_crit, engine
        As for :func:`prepare_blading`.

    Raises
    ------
    InputError
        If an airfoil is unknown, or a trip or a rough surface is given for a table of coefficients.
    """
    names = list(dict.fromkeys(airfoils)) or list(rotor.airfoil_names())
    transition = rotor.transition_at_n_crit(n_crit)
    if transition != (n_crit, (1.0, 1.0)):
        fixed = next((n for n in names if engine == "table" or is_polar_file(n)), None)
        key = next((k for k in ("trip_upper", "trip_lower") if getattr(rotor.blade, k) is not None), "surface")
        if fixed is not None:
            raise InputError(
                f"rotor {rotor.name}", f"blade.{key}", f"cannot move the transition of {fixed}, which is a table",
                "delete it, or give an airfoil with a contour",
            )  # fmt: skip
    return polar_engines.compute_airfoil_polars(names, n_crit=transition.n_crit, engine=engine, xtr=transition.xtr)


def apply_section_fit(table: PolarTable, change: Sequence[float], reynolds: float) -> PolarTable:
    """Return a polar with its coefficients changed by a :class:`mufly.rotor.geometry.SectionFit`.

    Equations: :mod:`mufly.rotor.measured.rotor_fit`.
    """
    _, lift, drag, lift_exponent, drag_exponent, lift_curvature, drag_curvature = (*change, 0.0, 0.0)[:7]
    ratio = np.log(np.clip(table.reynolds / reynolds, *_FIT_REYNOLDS_RATIO_RANGE))[:, None]
    bend = ratio**2 / (1.0 + 0.25 * ratio**2)
    place = np.log(table.reynolds)
    k = int(np.clip(np.searchsorted(place, math.log(reynolds)) - 1, 0, place.size - 2))
    part = min(max((math.log(reynolds) - place[k]) / (place[k + 1] - place[k]), 0.0), 1.0)
    middle = (1.0 - part) * table.cd[k] + part * table.cd[k + 1]
    cd = table.cd * np.exp(drag_exponent * ratio + drag_curvature * bend) + math.expm1(drag) * middle
    return replace(
        table,
        cl=table.cl * np.exp(lift + lift_exponent * ratio + lift_curvature * bend),
        cd=np.maximum(cd, _MIN_FITTED_DRAG_FRACTION * table.cd),
    )


_MIN_FITTED_DRAG_FRACTION = 0.3  # of the polar's drag: least drag of a fit
_FIT_REYNOLDS_RATIO_RANGE = (0.2, 5.0)  # range of Re / Re_m in which the fitted exponents apply


def ensure_blading(rotor: Rotor | Blading) -> Blading:
    """Return a blading unchanged; prepare a rotor with all defaults (about 1 ms; prepare once outside loops)."""
    return rotor if isinstance(rotor, Blading) else prepare_blading(rotor)


NEAR_WAKE_AGE_RAD = 0.5 * math.pi  # a quarter turn: longer wakes change e by less than 0.003 outside the inner fifth
_NEAR_WAKE_POINTS = 14  # thrust within 0.03 % of 96


@cached_njit
def _segment_downwash(px: float, py: float, ax: float, ay: float, bx: float, by: float) -> float:
    """Return the z velocity at a point of the plane z = 0 due to a unit vortex from a to b in that plane."""
    ux, uy, vx, vy = px - ax, py - ay, px - bx, py - by
    lu, lv = math.sqrt(ux * ux + uy * uy), math.sqrt(vx * vx + vy * vy)
    depth = lu * lv * (lu * lv + ux * vx + uy * vy)
    if depth < 1e-18:
        return 0.0
    return (ux * vy - uy * vx) * (lu + lv) / depth / (4.0 * math.pi)


@cached_njit
def near_wake_downwash(
    points: Array, edge_x: Array, edge_c: Array, turn: float, straight: float, arc_points: int
) -> Array:
    """Return the downwash at points that each panel of one blade causes by its near wake, per unit circulation.

    Parameters
    ----------
    points : (m, 2) array
        Evaluation points: coordinate along the blade, distance behind the quarter chord line.
    edge_x, edge_c : (n + 1,) arrays
        Radius and chord at the panel edges (any one unit of length).
    turn : float
        Azimuth (rad) that the trailing arcs cover.
    straight : float
        Length of straight wake instead of arcs, for a wing in translation; 0 for a rotor.
    arc_points : int
        Number of points on each arc, denser near the blade.

    Returns
    -------
    (m, n) array
        Velocity opposite to the lift, per unit circulation (1 / length).
    """
    m, n = points.shape[0], edge_x.shape[0] - 1
    trail = np.zeros((m, n + 1))
    path = np.empty((arc_points + 1, 2))  # points of one trailing vortex: quarter chord, trailing edge, wake
    for j in range(n + 1):
        r, tail = edge_x[j], 0.75 * edge_c[j]
        path[0, 0], path[0, 1] = r, 0.0
        for k in range(arc_points):
            s = (k / (arc_points - 1.0)) ** 2
            if straight > 0.0:
                path[k + 1, 0], path[k + 1, 1] = r, tail + straight * s
            else:
                cosine, sine = math.cos(turn * s), math.sin(turn * s)
                path[k + 1, 0], path[k + 1, 1] = r * cosine - tail * sine, r * sine + tail * cosine
        for i in range(m):
            w = 0.0
            for k in range(arc_points):
                w += _segment_downwash(
                    points[i, 0], points[i, 1], path[k, 0], path[k, 1], path[k + 1, 0], path[k + 1, 1]
                )
            trail[i, j] = w
    out = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            bound = _segment_downwash(points[i, 0], points[i, 1], edge_x[j], 0.0, edge_x[j + 1], 0.0)
            out[i, j] = bound + trail[i, j + 1] - trail[i, j]
    return out


def compute_angle_loss_per_cl(
    mid_x: Array, edge_x: Array, mid_c: Array, edge_c: Array, *, straight_wake: float = 0.0
) -> Array:
    """Return the lifting-surface factor e: loss of angle of attack (rad) per unit lift coefficient, (n,).

    Parameters
    ----------
    mid_x, mid_c : (n,) arrays
        Radius and chord in the middle of the panels (unit: R).
    edge_x, edge_c : (n + 1,) arrays
        The same at their edges.
    straight_wake : float
        Length of a straight wake in uniform wind, for checks against wings; 0 for a rotor.
    """
    key = tuple(np.ascontiguousarray(v, dtype=np.float64).tobytes() for v in (mid_x, edge_x, mid_c, edge_c))
    return _cached_angle_loss_per_cl(*key, straight_wake).copy()


@lru_cache(maxsize=4096)  # sweeps over airfoils, pitch and speed keep the planform
def _cached_angle_loss_per_cl(
    mid: bytes, edge: bytes, mid_chord: bytes, edge_chord: bytes, straight_wake: float
) -> Array:
    mid_x, edge_x, mid_c, edge_c = (np.frombuffer(v) for v in (mid, edge, mid_chord, edge_chord))
    n = mid_x.size
    quarter = np.column_stack((mid_x, np.zeros(n)))
    behind = np.column_stack((mid_x, 0.5 * mid_c))
    args = (edge_x, edge_c, NEAR_WAKE_AGE_RAD, straight_wake, _NEAR_WAKE_POINTS)
    a34 = near_wake_downwash(behind, *args)
    a14 = near_wake_downwash(quarter, *args)
    wind = np.ones(n) if straight_wake > 0 else mid_x
    circulation = np.linalg.solve(a34, wind)
    lost = (a34 - a14) @ circulation - circulation / (math.pi * mid_c)
    e = 0.5 * mid_c * lost / circulation
    # The ratio is undefined where the reference loading is zero; the wake of a blade never increases its own angle.
    return np.clip(np.where(circulation > 0.0, e, 0.0), 0.0, 5.0)
