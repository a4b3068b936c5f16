"""Airfoils: by NACA designation, from the database that comes with AeroSandbox, or from a coordinate file.

An :class:`Airfoil` is a closed contour of chord 1 in the frame of its source: x from 0 at the nose to 1 at the tail, y
up. Its points run from the tail over the upper side to the nose and back along the lower side (Selig order). The angle
of attack is measured against the x axis of that frame, which for a NACA section is its chord line.

NACA four- and five-digit sections follow from their formulas, with lengths over chord.

Four digits ``mptt`` (Jacobs, Ward, Pinkerton, NACA Report 460, 1933), m = max camber, p = its place, t = thickness::

    y_t = 5 t (0.2969 sqrt x - 0.1260 x - 0.3516 x^2 + 0.2843 x^3 - 0.1015 x^4)
    y_c = m/p^2 (2 p x - x^2)                     x <= p
        = m/(1-p)^2 (1 - 2p + 2 p x - x^2)        x >  p
    upper, lower = (x -+ y_t sin a,  y_c +- y_t cos a),   tan a = dy_c/dx

Five digits ``lpstt`` (Reports 537 and 610; constants as tabulated by Ladson and Brooks, NASA TM X-3284, 1975):
design lift 0.15 l, camber's place p/20, s = 0 normal or 1 reflexed (no moment about the quarter chord)::

    normal   y_c = k1/6 (x^3 - 3 r x^2 + r^2 (3 - r) x)   x <= r;   k1 r^3/6 (1 - x)  beyond
    reflexed y_c = k1/6 ((x-r)^3 - K (1-r)^3 x - r^3 x + r^3)            x <= r
                 = k1/6 (K (x-r)^3 - K (1-r)^3 x - r^3 x + r^3)          x >  r,   K = (3 (r - p/20)^2 - r^3) / (1-r)^3

``r`` and ``k1`` are tabulated for a design lift of 0.3 and ``k1`` scales with it. The blunt tail of the original
thickness formula (0.25 % of chord for t = 0.12) is kept. Files: :mod:`mufly.rotor.sections.contour_file`.
"""

from __future__ import annotations

import math
import re
from dataclasses import field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, suggest_name
from mufly.files.answer_store import hash_inputs
from mufly.results import result
from mufly.rotor.sections.contour_file import read_contour, read_custom_contour

Array = NDArray[np.float64]

MAX_THICKNESS_RATIO = 0.4
"""Greatest thickness over chord of a section."""
_SAME_THICKNESS_TOLERANCE = 5e-4  # of chord: a contour and its designation differ by less


@result(eq=False)
class Airfoil:
    """Airfoil section: contour, thickness and camber.

    Attributes
    ----------
    name : str
        Name as requested, in lower case.
    coordinates : (n, 2) array
        Contour over chord in Selig order.
    source : str
        Origin: formula, database or file.
    gurney : float
        Height of a Gurney flap over chord, part of the contour; 0 without.
    thickness_ratio, max_thickness_position : float
        Greatest thickness (normal to the x axis) over chord, and its x.
    camber, max_camber_position : float
        Greatest distance of the mean line from the x axis over chord, signed, and its x.
    """

    name: str
    coordinates: Array
    source: str
    gurney: float = 0.0
    thickness_ratio: float = field(init=False)
    max_thickness_position: float = field(init=False)
    camber: float = field(init=False)
    max_camber_position: float = field(init=False)

    def __post_init__(self) -> None:
        upper, lower = split_sides(self.coordinates)
        x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, 401)))
        y_u, y_l = np.interp(x, *upper.T), np.interp(x, *lower.T)
        thick, mean = y_u - y_l, 0.5 * (y_u + y_l)
        i, j = int(np.argmax(thick)), int(np.argmax(np.abs(mean)))
        for name, value in (
            ("thickness_ratio", thick[i]),
            ("max_thickness_position", x[i]),
            ("camber", mean[j]),
            ("max_camber_position", x[j]),
        ):
            object.__setattr__(self, name, float(value))
        self.coordinates.setflags(write=False)

    def contour_hash(self) -> str:
        """Return a hash of the contour's coordinates, rounded to 1e-7 of the chord."""
        rounded = np.round(self.coordinates * 1e7).astype(np.int64)
        return hash_inputs(rounded)


def split_sides(coordinates: Array) -> tuple[Array, Array]:
    """Split a Selig contour at its nose into upper and lower side, each with x rising."""
    nose = int(np.argmin(coordinates[:, 0]))
    upper, lower = coordinates[: nose + 1][::-1], coordinates[nose:]
    return upper[np.argsort(upper[:, 0], kind="stable")], lower[np.argsort(lower[:, 0], kind="stable")]


_PUBLISHED_AIRFOIL_SOURCES = {"sda1075": "Deters, Ananda, Selig, AIAA 2014-2151, Table 4"}
"""Airfoils with a file beside this module, and the publication of their coordinates."""


@cache
def _list_database_files() -> dict[str, Path]:
    found = find_spec("aerosandbox")  # not imported, because that takes two seconds
    if found is None or found.origin is None:
        return {}
    folder = Path(found.origin).parent / "geometry" / "airfoil" / "airfoil_database"
    return {f.stem.lower(): f for f in sorted(folder.glob("*.dat"))}


def list_database_airfoils() -> list[str]:
    """Return the names in AeroSandbox's database (UIUC's collection, about 2 000)."""
    return list(_list_database_files())


def load_airfoil(name_or_path: str | Path) -> Airfoil:
    """Load an airfoil by name or from a file.

    Parameters
    ----------
    name_or_path : str or Path
        ``"naca4412"``, ``"NACA 23012"``, ``"sda1075"``, a name that :func:`list_database_airfoils` lists, or the path
        of a file in Selig's or Lednicer's order. With ``"+gurney1.5"`` appended, the section carries a Gurney flap of
        1.5 % of the chord on its lower side. With ``"+thick8"``, it is 8 % thick about its own mean line. With
        ``"+scaled8"``, all its heights are scaled so that it is 8 % thick, which keeps a flat side flat. With
        ``"+blend40-clarky"``, the contour lies 40 % of the way to that of Clark Y.

    Raises
    ------
    InputError
        If there is no such airfoil or its contour is open, crosses itself or has too few points.
    """
    text = str(name_or_path)
    base, plus, flap = text.rpartition("+gurney")
    if plus:
        return add_gurney_flap(load_airfoil(base), _parse_percent(text, flap, "a Gurney flap", "a height", 8.0))
    for suffix, change in (("+thick", set_airfoil_thickness), ("+scaled", scale_airfoil_heights)):
        base, plus, thick = text.rpartition(suffix)
        if plus:
            most = 100.0 * MAX_THICKNESS_RATIO
            return change(load_airfoil(base), _parse_percent(text, thick, "a section", "a thickness", most))
    base, plus, other = text.rpartition("+blend")
    if plus:
        percent, _, second = other.partition("-")
        share = _parse_percent(text, percent, "a blend", "a share", 100.0)
        return blend_airfoils(load_airfoil(base), load_airfoil(second), share)
    path = Path(name_or_path)
    if path.is_file():
        contour, words = read_custom_contour(path)
        return Airfoil(path.stem.lower(), contour, f"{path}; {words}" if words else str(path))
    name = re.sub(r"^naca[\s_-]*", "naca", text.lower().strip())
    digits = re.fullmatch(r"naca(\d{4,5})", name)
    # Five digits that begin with 6, or that fit no five-digit mean line, are series 6 or 16 of the database.
    series = name in _list_database_files() and digits is not None and (len(digits[1]) == 5 and digits[1][0] == "6")
    if digits is not None and not series:
        try:
            return Airfoil(name, naca_contour(digits[1]), f"NACA {digits[1]}, formula")
        except InputError:
            if name not in _list_database_files():
                raise
    for key in (text.lower(), name, text.lower().removesuffix(".dat")):
        if key in _list_database_files():
            return Airfoil(key, read_contour(_list_database_files()[key]), "AeroSandbox's database (UIUC)")
    if text.lower().removesuffix(".dat") in _PUBLISHED_AIRFOIL_SOURCES:
        key = text.lower().removesuffix(".dat")
        contour, _ = read_custom_contour(Path(__file__).parent / f"{key}.dat")
        return Airfoil(key, contour, _PUBLISHED_AIRFOIL_SOURCES[key])
    otherwise = "give a NACA number, a database name or a .dat file"
    raise InputError(
        text,
        "",
        "no such airfoil or file",
        suggest_name(name, [*_list_database_files(), *_PUBLISHED_AIRFOIL_SOURCES], otherwise),
    )


def name_thickened_airfoil(name: str, thickness: float) -> str:
    """Return the name of an airfoil with another thickness (over chord), as :func:`load_airfoil` takes it.

    A Gurney flap keeps its height.
    """
    clean, flap, height = name.partition("+gurney")
    return f"{clean}+thick{100.0 * thickness:.4g}{flap}{height}"


def _parse_percent(where: str, text: str, what: str, size: str, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= most:
        raise InputError(where, "", f"{what} of {text!r} % is out of range", f"give {size} above 0 and up to {most:g}")
    return value / 100.0


def set_airfoil_thickness(airfoil: Airfoil, thickness: float) -> Airfoil:
    """Return the section with its thickness scaled about the mean line; the camber is kept.

    The mean line halves the section normal to the x axis. So does the family of NACA Report 460, whose members share
    mean lines. A section that has the thickness to 0.05 % of the chord keeps its contour to the last bit.
    """
    if abs(airfoil.thickness_ratio - thickness) < _SAME_THICKNESS_TOLERANCE:
        return _modified_airfoil(airfoil, airfoil.coordinates, "thick", thickness, "with a thickness of")
    half = 0.5 * thickness / airfoil.thickness_ratio
    upper, lower = split_sides(airfoil.coordinates)
    (x_u, y_u), (x_l, y_l) = upper.T, lower.T
    opposite_l, opposite_u = np.interp(x_u, x_l, y_l), np.interp(x_l, x_u, y_u)
    upper_side = np.column_stack((x_u, 0.5 * (y_u + opposite_l) + half * (y_u - opposite_l)))
    lower_side = np.column_stack((x_l, 0.5 * (y_l + opposite_u) + half * (y_l - opposite_u)))
    contour = np.concatenate((upper_side[::-1], lower_side[1:]))
    return _modified_airfoil(airfoil, contour, "thick", thickness, "with a thickness of")


def scale_airfoil_heights(airfoil: Airfoil, thickness: float) -> Airfoil:
    """Return the section with all heights, including camber, scaled to a thickness over chord.

    Propellers with Clark Y sections are made so (NACA Report 640): the lower side stays flat.
    """
    scaled = airfoil.coordinates * [1.0, thickness / airfoil.thickness_ratio]
    return _modified_airfoil(airfoil, scaled, "scaled", thickness, "scaled to a thickness of")


def name_blended_airfoil(first: str, second: str, share: float) -> str:
    """Return the name of the blend of two airfoils, as :func:`load_airfoil` takes it; ``share`` is the second's."""
    if share <= 0.0 or first == second:
        return first
    return second if share >= 1.0 else f"{first}+blend{100.0 * share:.4g}-{second}"


def blend_airfoils(first: Airfoil, second: Airfoil, share: float) -> Airfoil:
    """Return the section whose heights are (1 - share) those of one section plus share times those of another.

    Heights are mixed at the same places of the chord, side by side.
    """
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, _POINTS_PER_SIDE)))
    upper, lower = (
        (1.0 - share) * np.interp(x, *a.T) + share * np.interp(x, *b.T)
        for a, b in zip(split_sides(first.coordinates), split_sides(second.coordinates), strict=True)
    )
    contour = np.concatenate((np.column_stack((x, upper))[::-1], np.column_stack((x, lower))[1:]))
    percent = f"{100 * share:.4g}"
    return Airfoil(
        f"{first.name}+blend{percent}-{second.name}", contour, f"{first.source}; {percent} % {second.source}"
    )


def _modified_airfoil(airfoil: Airfoil, contour: Array, suffix: str, thickness: float, word: str) -> Airfoil:
    percent = f"{100 * thickness:g}"
    return Airfoil(f"{airfoil.name}+{suffix}{percent}", contour, f"{airfoil.source}; {word} {percent} %")


def add_gurney_flap(airfoil: Airfoil, height: float) -> Airfoil:
    """Return the section with a Gurney flap at its tail, on the lower side.

    The flap is normal to the chord at x = 1. A separation bubble in the corner ahead of it is about as long as the flap
    is high (Liebeck, Journal of Aircraft 15, 1978). The effective contour is therefore a ramp over the last 1.5 heights
    that ends in a blunt tail. The lower side is lowered by ``h s^2 (3 - 2 s)``, ``s = 1 - (1 - x)/(1.5 h)``.

    Parameters
    ----------
    airfoil : Airfoil
        The clean section.
    height : float
        Flap height over chord, above 0 and up to 0.08.
    """
    upper, lower = split_sides(airfoil.coordinates)
    start = 1.0 - 1.5 * height
    ramp = np.linspace(start, 1.0, 16)
    x = np.concatenate((lower[lower[:, 0] < start - 1e-9, 0], ramp))
    s = np.clip(1.0 - (1.0 - x) / (1.5 * height), 0.0, 1.0)
    y = np.interp(x, *lower.T) - height * s**2 * (3.0 - 2.0 * s)
    contour = np.concatenate((upper[::-1], np.column_stack((x, y))[1:]))
    percent = f"{100 * height:g}"
    return Airfoil(f"{airfoil.name}+gurney{percent}", contour, f"{airfoil.source}; Gurney flap {percent} %", height)


_POINTS_PER_SIDE = 100
# Mean lines for a design lift of 0.3, by the position of camber in twentieths of the chord: r, k1.
_NACA5_NORMAL_CAMBER_LINES = {
    1: (0.0580, 361.400),
    2: (0.1260, 51.640),
    3: (0.2025, 15.957),
    4: (0.2900, 6.643),
    5: (0.3910, 3.230),
}
_NACA5_REFLEX_CAMBER_LINES = {2: (0.1300, 51.990), 3: (0.2170, 15.793), 4: (0.3180, 6.520), 5: (0.4410, 3.191)}


def _naca_half_thickness(x: Array, t: float) -> Array:
    return 5 * t * (0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)


def _four_digit_camber_line(x: Array, m: float, p: float) -> tuple[Array, Array]:
    if m == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    front = x <= p
    divisor = np.where(front, p**2, (1 - p) ** 2)
    y = m / divisor * np.where(front, 2 * p * x - x**2, 1 - 2 * p + 2 * p * x - x**2)
    return y, 2 * m / divisor * (p - x)


def _five_digit_camber_line(x: Array, digits: str) -> tuple[Array, Array]:
    lift, twentieth, reflexed = int(digits[0]), int(digits[1]), digits[2] == "1"
    r, k1 = (_NACA5_REFLEX_CAMBER_LINES if reflexed else _NACA5_NORMAL_CAMBER_LINES)[twentieth]
    front = x <= r
    if not reflexed:
        y = np.where(front, x**3 - 3 * r * x**2 + r**2 * (3 - r) * x, r**3 * (1 - x))
        slope = np.where(front, 3 * x**2 - 6 * r * x + r**2 * (3 - r), -(r**3))
    else:
        ratio = (3 * (r - twentieth / 20) ** 2 - r**3) / (1 - r) ** 3
        gain = np.where(front, 1.0, ratio)
        y = gain * (x - r) ** 3 - ratio * (1 - r) ** 3 * x - r**3 * x + r**3
        slope = 3 * gain * (x - r) ** 2 - ratio * (1 - r) ** 3 - r**3
    scale = k1 / 6 * lift / 2  # tabulated for the second series
    return scale * y, scale * slope


def naca_contour(digits: str, per_side: int = _POINTS_PER_SIDE) -> Array:
    """Return the contour of a NACA four- or five-digit section.

    Parameters
    ----------
    digits : str
        ``"4412"``, ``"23012"``, ``"23112"`` (reflexed).
    per_side : int
        Number of points on each side, denser towards nose and tail.

    Returns
    -------
    (2 per_side - 1, 2) array

    Raises
    ------
    InputError
        If the digits name no section.
    """
    where = f"naca{digits}"
    if not (digits.isdigit() and len(digits) in (4, 5)):
        raise InputError(where, "", "is not a NACA designation", "give four or five digits, as naca4412 or naca23012")
    t = int(digits[-2:]) / 100
    if not 0.01 <= t <= 0.40:
        raise InputError(where, "", f"a thickness of {t:.0%} is out of range", "give 01 to 40 as the last two digits")
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, per_side)))
    if len(digits) == 4:
        m, p = int(digits[0]) / 100, int(digits[1]) / 10
        if (m == 0) != (p == 0):
            raise InputError(
                where, "", "has camber without position, or position without camber", "give both, as in naca4412"
            )
        y_c, slope = _four_digit_camber_line(x, m, p)
    else:
        families = {"0": _NACA5_NORMAL_CAMBER_LINES, "1": _NACA5_REFLEX_CAMBER_LINES}
        if int(digits[0]) == 0 or digits[2] not in families:
            normal = f"naca{digits[:2]}0{digits[-2:]}"
            remedy = f"let the first digit be 1 to 9, the third 0 (normal) or 1 (reflexed), as {normal}"
            raise InputError(where, "", f"mean line {digits[:3]} is unknown", remedy)
        if int(digits[1]) not in families[digits[2]]:
            places = ", ".join(str(k) for k in families[digits[2]])
            remedy = f"let the second digit be one of {places}"
            raise InputError(where, "", f"mean line {digits[:3]} is unknown", remedy)
        y_c, slope = _five_digit_camber_line(x, digits)
    y_t, a = _naca_half_thickness(x, t), np.arctan(slope)
    upper = np.column_stack((x - y_t * np.sin(a), y_c + y_t * np.cos(a)))
    lower = np.column_stack((x + y_t * np.sin(a), y_c - y_t * np.cos(a)))
    return np.concatenate((upper[::-1], lower[1:]))
