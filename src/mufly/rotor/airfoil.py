"""Airfoils: by NACA designation, from the database that comes with AeroSandbox, or from a coordinate file.

An :class:`Airfoil` is a closed contour of chord one, in the frame of its source: x from 0 at the nose to 1 at the
tail, y up, points from the tail over the upper side to the nose and back along the lower side (Selig order). The
angle of attack is measured against the x axis of that frame, which for a NACA section is its chord line.
"""

from __future__ import annotations

import difflib
import hashlib
import math
import re
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.contour import read_contour
from mufly.rotor.naca import naca

__all__ = ["Airfoil", "database_airfoils", "load_airfoil", "sides", "with_gurney"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Airfoil:
    """A section.

    Attributes
    ----------
    name : str
        As asked for, in lower case.
    coordinates : (n, 2) array
        Contour over chord in Selig order.
    source : str
        Formula, database or file.
    gurney : float
        Height of a Gurney flap over chord, part of the contour; 0 without.
    thickness_ratio, thickness_at : float
        Greatest thickness (normal to the x axis) over chord, and its x.
    camber, camber_at : float
        Greatest distance of the mean line from the x axis over chord, signed, and its x.
    """

    name: str
    coordinates: Array
    source: str
    gurney: float = 0.0
    thickness_ratio: float = field(init=False)
    thickness_at: float = field(init=False)
    camber: float = field(init=False)
    camber_at: float = field(init=False)

    def __post_init__(self) -> None:
        upper, lower = sides(self.coordinates)
        x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, 401)))
        y_u, y_l = np.interp(x, *upper.T), np.interp(x, *lower.T)
        thick, mean = y_u - y_l, 0.5 * (y_u + y_l)
        i, j = int(np.argmax(thick)), int(np.argmax(np.abs(mean)))
        for name, value in (
            ("thickness_ratio", thick[i]),
            ("thickness_at", x[i]),
            ("camber", mean[j]),
            ("camber_at", x[j]),
        ):
            object.__setattr__(self, name, float(value))
        self.coordinates.setflags(write=False)

    def digest(self) -> str:
        """Return a hash of the contour, to a ten-millionth of the chord."""
        rounded = np.round(self.coordinates * 1e7).astype(np.int64)
        return hashlib.sha256(rounded.tobytes()).hexdigest()


def sides(coordinates: Array) -> tuple[Array, Array]:
    """Split a Selig contour at its nose into upper and lower side, each with x rising."""
    nose = int(np.argmin(coordinates[:, 0]))
    upper, lower = coordinates[: nose + 1][::-1], coordinates[nose:]
    return upper[np.argsort(upper[:, 0], kind="stable")], lower[np.argsort(lower[:, 0], kind="stable")]


@cache
def _database() -> dict[str, Path]:
    found = find_spec("aerosandbox")  # looked up, not imported: that takes two seconds
    if found is None or found.origin is None:
        return {}
    folder = Path(found.origin).parent / "geometry" / "airfoil" / "airfoil_database"
    return {f.stem.lower(): f for f in sorted(folder.glob("*.dat"))}


def database_airfoils() -> list[str]:
    """Return the names in AeroSandbox's database (UIUC's collection, about 2 000)."""
    return list(_database())


def load_airfoil(name_or_path: str | Path) -> Airfoil:
    """Get an airfoil by name or from a file.

    Parameters
    ----------
    name_or_path : str or Path
        ``"naca4412"``, ``"NACA 23012"``, a name that :func:`database_airfoils` lists, or the path of a file in
        Selig's or Lednicer's order. With ``"+gurney1.5"`` appended, the section carries a Gurney flap of 1.5 %
        of the chord on its lower side.

    Raises
    ------
    InputError
        If there is no such airfoil or its contour is open, crosses itself or has too few points.
    """
    text = str(name_or_path)
    base, plus, flap = text.rpartition("+gurney")
    if plus:
        return with_gurney(load_airfoil(base), _percent(text, flap))
    path = Path(name_or_path)
    if path.is_file():
        return Airfoil(path.stem.lower(), read_contour(path), str(path))
    name = re.sub(r"^naca[\s_-]*", "naca", text.lower().strip())
    digits = re.fullmatch(r"naca(\d{4,5})", name)
    # Five digits that begin with 6, or that no five-digit mean line fits, are series 6 or 16 in the database.
    series = name in _database() and digits is not None and (len(digits[1]) == 5 and digits[1][0] == "6")
    if digits is not None and not series:
        try:
            return Airfoil(name, naca(digits[1]), f"NACA {digits[1]}, formula")
        except InputError:
            if name not in _database():
                raise
    for key in (text.lower(), name, text.lower().removesuffix(".dat")):
        if key in _database():
            return Airfoil(key, read_contour(_database()[key]), "AeroSandbox's database (UIUC)")
    raise InputError(text, "", "no such airfoil or file", _near(name))


def _near(name: str) -> str:
    near = difflib.get_close_matches(name, _database(), n=3)
    known = (
        f"did you mean {' or '.join(near)}?" if near else "give a NACA number, a database name or a .dat file"
    )
    return known


def _percent(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value <= 8.0:
        raise InputError(
            where, "", f"a Gurney flap of {text!r} % is not possible", "give a height above 0 and up to 8"
        )
    return value / 100.0


def with_gurney(airfoil: Airfoil, height: float) -> Airfoil:
    """Return the section with a Gurney flap at its tail, on the lower side.

    The flap stands normal to the chord at x = 1. Air that comes to rest in the corner ahead of it forms a bubble about
    as long as the flap is high (Liebeck, Journal of Aircraft 15, 1978), so the contour that the outer flow sees is a
    ramp over the last 1.5 heights, ending in a blunt tail: the lower side is lowered by ``h s^2 (3 - 2 s)``,
    ``s = 1 - (1 - x)/(1.5 h)``.

    Parameters
    ----------
    airfoil : Airfoil
        The clean section.
    height : float
        Flap height over chord, above 0 and up to 0.08.
    """
    upper, lower = sides(airfoil.coordinates)
    start = 1.0 - 1.5 * height
    ramp = np.linspace(start, 1.0, 16)
    x = np.concatenate((lower[lower[:, 0] < start - 1e-9, 0], ramp))
    s = np.clip(1.0 - (1.0 - x) / (1.5 * height), 0.0, 1.0)
    y = np.interp(x, *lower.T) - height * s**2 * (3.0 - 2.0 * s)
    contour = np.concatenate((upper[::-1], np.column_stack((x, y))[1:]))
    percent = f"{100 * height:g}"
    return Airfoil(
        f"{airfoil.name}+gurney{percent}", contour, f"{airfoil.source}; Gurney flap {percent} %", height
    )
