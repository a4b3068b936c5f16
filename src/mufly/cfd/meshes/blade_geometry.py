"""Geometry of a rotor that its rotor file does not contain: hub, blade tips, winglets, plates and Gurney flaps.

The blade follows a line of radius y with offsets aft of and above the straight quarter chord line, in chords of the
tip. Along a tip t runs from 0 to 1::

    chord    1 - (1 - taper) t                     or, round, sqrt(1 - t^2), ended where its edges slope 60 degrees
    aft      aft t                                 0.75 (1 - taper): straight trailing edge; 0.25 (1 - taper): straight
                                                   middle; -0.25 (1 - taper): straight nose
    winglet  an arc of radius ``bend_radius_chords`` to the angle ``cant``, then straight to ``height``; the blade's
             radius stays; ``curved``: its chords follow the circle about the shaft

The end face of a round tip is curved by the rest of the ellipse, so that the whole outline is half an ellipse.

The dissertation gives no dimensions of its tips and winglets (Figs 3.37 and 3.39 are drawings without sizes):
``thesis-1``, ``thesis-2`` and ``winglet-1`` to ``winglet-3`` are guesses of their shape.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

Array = NDArray[np.float64]
ROUND_TIP_END_SLOPE_RAD = math.radians(60.0)
"""Slope at which the edges of a round tip end (rad)."""
_DISPLACEMENT_FADE_CHORDS, _UPRIGHT_REACH_BEND_RATIO, _BACK_TURN_RADIUS_RATIO = 5.0, 0.5, 2.0
"""Chords above and below the blade over which displacements fade; bend radii over which sections turn upright; bend
radii of the turn beyond the end."""
_MAX_CANT_RAD = math.radians(70.0)


@dataclass(frozen=True)
class BladeTip:
    """Shape of a blade tip; all lengths are multiples of the rotor file's tip chord.

    Attributes
    ----------
    length : float
        Length of the tip inwards; 0 for a square end.
    taper : float
        Chord at the end over chord at the beginning of the tip.
    aft : float
        Offset of the end aft, quarter chord to quarter chord.
    round : bool
        Half an ellipse, as long as ``length``, instead of straight edges.
    cant_rad, height, bend_radius_chords : float
        Cant angle of a winglet (negative: down), its height and its bend radius; they determine ``length``.
    plate_above, plate_below : float
        Heights of an end plate above and below the blade.
    curved : bool
        True if the winglet follows the circle about the shaft. A straight winglet lies along the tip's chord. With a
        chord of a third of the radius its relative wind comes at 5 degrees from outside at the nose and at 14 degrees
        from inside at the tail, so it has a side load.
    """

    length: float = 0.0
    taper: float = 1.0
    aft: float = 0.0
    round: bool = False
    cant_rad: float = 0.0
    height: float = 0.0
    bend_radius_chords: float = 0.5
    plate_above: float = 0.0
    plate_below: float = 0.0
    curved: bool = False

    def __post_init__(self) -> None:
        def raise_tip_error(key: str, remedy: str) -> None:
            raise InputError("tip", key, f"is {getattr(self, key):g}", remedy)

        if not 0.0 <= self.length <= 10.0:
            raise_tip_error("length", "give 0 to 10 chords")
        if not 0.15 <= self.taper <= 2.0:
            raise_tip_error("taper", "give 0.15 to 2: a pointed tip cannot be meshed")
        if not abs(self.cant_rad) <= _MAX_CANT_RAD:
            raise_tip_error("cant_rad", f"give at most {_MAX_CANT_RAD:.3g} (70 degrees); a plate stands at 90")
        if self.cant_rad:
            if not 0.3 <= self.bend_radius_chords <= 3.0:
                raise_tip_error("bend_radius_chords", "give 0.3 to 3 chords")
            turn = self.bend_radius_chords * (1.0 - math.cos(self.cant_rad))
            if not turn <= self.height <= 3.0:
                raise_tip_error("height", f"give {turn:.3g} (what the turn takes) to 3 chords")
        for key in ("plate_above", "plate_below"):
            if not (getattr(self, key) == 0.0 or 0.02 <= getattr(self, key) <= 0.35):
                raise_tip_error(key, "give 0 or 0.02 to 0.35 chords: the mesh's ring holds no higher one")
        if self.plate_above and self.plate_below and self.plate_above != self.plate_below:
            raise_tip_error("plate_below", f"give {self.plate_above:g} as above, or 0")
        if self.length and not self.round:
            steepest = max(abs(self.aft - 0.25 * (1 - self.taper)), abs(self.aft + 0.75 * (self.taper - 1)))
            if steepest > 2.2 * self.length:
                raise_tip_error(
                    "length", f"an edge would slope more than 65 degrees: give at least {steepest / 2.2:.2g}"
                )


BLADE_TIPS: Mapping[str, BladeTip] = MappingProxyType(
    {
        "square": BladeTip(),
        "round": BladeTip(length=0.5, round=True),
        "tapered": BladeTip(length=0.9, taper=0.5, aft=0.125),
        "swept": BladeTip(length=0.75, aft=0.75 * math.tan(math.radians(30.0))),
        "swept-tapered": BladeTip(length=0.75, taper=0.5, aft=0.375),
        "thesis-1": BladeTip(length=0.3, taper=0.47, aft=0.53 * 0.6),
        "thesis-2": BladeTip(length=0.9, taper=0.4, aft=0.6 * 0.25),
        "winglet-up": BladeTip(cant_rad=math.radians(60.0), height=0.5, taper=0.7),
        "winglet-down": BladeTip(cant_rad=math.radians(-60.0), height=0.5, taper=0.7),
        "plate-up": BladeTip(plate_above=0.25),
        "plate-down": BladeTip(plate_below=0.25),
        "winglet-1": BladeTip(plate_above=0.12, plate_below=0.12),
        "winglet-2": BladeTip(cant_rad=math.radians(70.0), height=0.5, bend_radius_chords=0.4, taper=0.8),
        "winglet-3": BladeTip(cant_rad=math.radians(-70.0), height=0.5, bend_radius_chords=0.4, taper=0.8),
        "winglet-2-curved": BladeTip(
            cant_rad=math.radians(70.0), height=0.5, bend_radius_chords=0.4, taper=0.8, curved=True
        ),
        "winglet-3-curved": BladeTip(
            cant_rad=math.radians(-70.0), height=0.5, bend_radius_chords=0.4, taper=0.8, curved=True
        ),
    }
)
"""Predefined blade tips by name."""


@dataclass(frozen=True)
class HubCylinder:
    """Cylindrical hub around the shaft that rotates with the blades.

    Attributes
    ----------
    radius_m, half_height_m : float
    joined : bool
        True if the hub is joined to the blade roots (grips); else it ends in flats, with a gap of air to the roots.
    """

    radius_m: float
    half_height_m: float
    joined: bool = True

    def __post_init__(self) -> None:
        for key in ("radius_m", "half_height_m"):
            if not 0.0 < getattr(self, key) < math.inf:
                raise InputError("hub", key, f"is {getattr(self, key):g} m", "give a number above 0")


@dataclass(frozen=True)
class BladeGeometry:
    """Parts of a rotor's geometry that its rotor file does not contain: blade tips, hub and Gurney flap.

    Attributes
    ----------
    tip : BladeTip
    hub : HubCylinder or None
    gurney_height : float
        Height over chord of a Gurney flap below the trailing edge, from root to tip; 0 for none.
    """

    tip: BladeTip = BladeTip()
    hub: HubCylinder | None = None
    gurney_height: float = 0.0

    def __post_init__(self) -> None:
        if not (self.gurney_height == 0.0 or 0.003 <= self.gurney_height <= 0.1):
            raise InputError("gurney", "height", f"is {self.gurney_height:g} chords", "give 0 or 0.003 to 0.1")
        if self.gurney_height and (self.tip.plate_above or self.tip.plate_below):
            raise InputError(
                "tip", "plate", "cannot be combined with a Gurney flap", "give a tip plate or a Gurney flap"
            )


def make_tip_hub_geometry(
    tip: str = "square", hub_m: float = 0.0, gurney: float = 0.0, *, hub_joined: bool = True
) -> BladeGeometry:
    """Make the geometry from the name of a tip, a hub radius (m) and a Gurney flap; the hub's height equals its radius.

    Raises
    ------
    InputError
        If there is no such tip, or a value is impossible.
    """
    if tip not in BLADE_TIPS:
        raise InputError("tip", tip, "is not a tip", f"use one of: {', '.join(BLADE_TIPS)}")
    return BladeGeometry(BLADE_TIPS[tip], HubCylinder(hub_m, 0.5 * hub_m, hub_joined) if hub_m else None, gurney)


@dataclass(frozen=True, eq=False)
class BladeLine:
    """Positions of the sections of a blade; arrays of (sections,).

    Attributes
    ----------
    radius_m, aft_m, height_m : arrays
        Radius; offsets aft of and above the straight line, along and normal to the tip's chord.
    cant_rad : array
        Angle of the line to the disc.
    chord_ratio : array
        Chord over that of the rotor file.
    rounding_fraction : array
        Fraction of the curvature of a round tip's end face, 0 to 1.
    """

    radius_m: Array
    aft_m: Array
    height_m: Array
    cant_rad: Array
    chord_ratio: Array
    rounding_fraction: Array


def compute_blade_line_length(tip: BladeTip, root_m: float, radius_m: float, chord_m: float) -> float:
    """Return the length (m) of the curve through the blade's sections, from the root to the tip at the rotor radius."""
    turn, straight = _winglet_lengths(tip, chord_m)
    b, a = tip.bend_radius_chords * chord_m, abs(tip.cant_rad)
    out = b * math.sin(a) + straight * math.cos(a)
    if tip.round:
        return radius_m - root_m - tip.length * chord_m * (1.0 - math.sin(ROUND_TIP_END_SLOPE_RAD))
    if out > 0.6 * (radius_m - root_m) or tip.length * chord_m > 0.9 * (radius_m - root_m):
        raise InputError("tip", "", "is too long for the blade", "give a shorter one, or a longer blade")
    return radius_m - root_m - out + turn + straight


def _winglet_lengths(tip: BladeTip, chord_m: float) -> tuple[float, float]:
    """Return the lengths (m) of a winglet's bend and of the straight part beyond it."""
    a = abs(tip.cant_rad)
    if not a:
        return 0.0, 0.0
    rise = tip.height - tip.bend_radius_chords * (1.0 - math.cos(a))
    return tip.bend_radius_chords * a * chord_m, rise / math.sin(a) * chord_m


def compute_blade_line(tip: BladeTip, s: Array, span: tuple[float, float], chord_m: float) -> BladeLine:
    """Compute the curve on which the blade's sections lie, at lengths s along it (m, from the shaft).

    Beyond the end of the blade the curve bends back until it is parallel to the disc.

    Parameters
    ----------
    tip : BladeTip
    s : (n,) array
        Lengths along the line, increasing (m).
    span : (float, float)
        s of root and end (m).
    chord_m : float
        Tip chord of the rotor file (m).
    """
    end = span[1]
    turn, straight = _winglet_lengths(tip, chord_m)
    cant = np.zeros(len(s))
    y, up = s.copy(), np.zeros(len(s))
    length = tip.length * chord_m
    if turn:
        begin, sign = end - turn - straight, math.copysign(1.0, tip.cant_rad)
        a, b = abs(tip.cant_rad), tip.bend_radius_chords * chord_m
        back = _BACK_TURN_RADIUS_RATIO * turn
        corners = [begin, begin + turn, end, end + back]
        cant = sign * np.interp(s, corners, [0.0, a, a, 0.0])
        # Exact along the two arcs and the straight piece between them.
        p, q = np.clip(s - begin, 0.0, turn) / b, np.clip(s - end, 0.0, back) / (_BACK_TURN_RADIUS_RATIO * b)
        flat = np.clip(s - begin - turn, 0.0, straight)
        y = np.minimum(s, begin) + b * np.sin(p) + flat * math.cos(a) + np.maximum(s - end - back, 0.0)
        y += _BACK_TURN_RADIUS_RATIO * b * (math.sin(a) - np.sin(a - q))
        up = sign * (
            b * (1.0 - np.cos(p)) + flat * math.sin(a) + _BACK_TURN_RADIUS_RATIO * b * (np.cos(a - q) - math.cos(a))
        )
        length = turn + straight
    t = np.clip((s - (end - length)) / length, 0.0, 1.0) if length else np.zeros(len(s))
    bow = np.zeros(len(s))
    if tip.round:
        reach = math.sin(ROUND_TIP_END_SLOPE_RAD)
        t = np.clip((s - (end - reach * length)) / length, 0.0, reach)
        chord = np.sqrt(1.0 - t * t)
        aft = 0.25 * (1.0 - chord)
        near = np.clip(1.0 - np.where(s < end, end - s, s - end) / (np.where(s < end, 1.2, 2.0) * length), 0.0, 1.0)
        bow = near * near * (3.0 - 2.0 * near)
    else:
        chord, aft = 1.0 - (1.0 - tip.taper) * t, tip.aft * t
    return BladeLine(y, aft * chord_m, up, cant, chord, bow)


def fade_out_cubic(t: Array) -> Array:
    """Return a cubic of t that falls from 1 at t = 0 to 0 at t = 1, with zero slope at both ends."""
    u = np.clip(t, 0.0, 1.0)
    return (1.0 - u) ** 2 * (1.0 + 2.0 * u)


def place_sections(
    xz: Array,
    line: BladeLine,
    tip: BladeTip,
    *,
    angle_rad: float,
    chord_m: float,
    half_m: float,
    level_m: float,
) -> Array:
    """Place the sections of a blade along its curve; return the positions of all their points.

    Sections of a winglet are normal to it. Above and below the blade they turn upright over a length below the bend
    radius, so that neighbours do not intersect. With n the height over the blade and h = tanh(n / l) ::

        y  = y_line - sin(cant) l h,    up = up_line - (1 - cos(cant)) l h

    Displacements fade to zero at the sides of the box and at level lines.

    Parameters
    ----------
    xz : (sections, points, 2) array
        Points of straight sections, the quarter chord at (0, 0) (m).
    line : BladeLine
    tip : BladeTip
    angle_rad : float
        Angle of the tip's chord to the disc, nose up.
    chord_m : float
        Tip chord of the rotor file.
    half_m, level_m : float
        Half width of the box of the sections; height above and below the disc beyond which its lines are level.

    Returns
    -------
    (sections, points, 3) array
    """
    x, z = xz[..., 0], xz[..., 1]
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    q, n = c * x - s * z, s * x + c * z  # along the chord, and above it
    near = 1.5 * chord_m
    keep = fade_out_cubic((np.abs(x) - near) / (half_m - near))
    keep = keep * fade_out_cubic(
        (np.abs(z) - 0.5 * chord_m) / (min(_DISPLACEMENT_FADE_CHORDS * chord_m, level_m) - 0.5 * chord_m)
    )
    reach = _UPRIGHT_REACH_BEND_RATIO * tip.bend_radius_chords * chord_m
    h = reach * np.tanh(n / reach)
    y = line.radius_m[:, None] - np.sin(line.cant_rad)[:, None] * h * keep
    up = (line.height_m[:, None] - (1.0 - np.cos(line.cant_rad))[:, None] * h) * keep
    aft = line.aft_m[:, None] * keep
    if tip.round:
        a, b, w = 0.5 * chord_m, tip.length * chord_m, 0.5 * chord_m * math.cos(ROUND_TIP_END_SLOPE_RAD)
        middle = q - 0.25 * (line.chord_ratio * chord_m)[:, None]
        inner = np.minimum(np.abs(middle), w)
        slope, run = b / a / math.tan(ROUND_TIP_END_SLOPE_RAD), 0.3 * chord_m
        shape = b * (np.sqrt(1.0 - (inner / a) ** 2) - math.sin(ROUND_TIP_END_SLOPE_RAD))
        shape -= slope * run * (1.0 - np.exp(-(np.abs(middle) - inner) / run))
        y = y + line.rounding_fraction[:, None] * shape * keep
    x_out = x + c * aft + s * up
    if tip.curved:
        # sqrt(r^2 - x^2) instead of r, in the part of sin(cant); ahead of and behind the blade no further.
        along = chord_m * np.tanh(x_out / chord_m)
        r = np.maximum(line.radius_m[:, None], 1.5 * chord_m)
        bend = np.sqrt(r**2 - along**2) - r
        y = y + np.sin(np.abs(line.cant_rad))[:, None] * keep * bend
    return np.stack((x_out, y, z - s * aft + c * up), axis=-1)
