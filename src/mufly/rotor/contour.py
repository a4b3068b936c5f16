"""Coordinate files of airfoils, and what makes a contour sound.

Two orders are in use. Selig's: one list from the tail over the upper side to the nose and back along the lower side.
Lednicer's: a line with the two counts, then the upper and the lower side, each from nose to tail. Titles before and
remarks behind the coordinates are passed over. A sound contour has points enough, closes at the tail (up to a blunt
base), encloses an area and does not cross itself.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["checked_contour", "read_contour"]

Array = NDArray[np.float64]

_FEWEST = 20
_WIDEST_TAIL = 0.12  # of chord; a contour whose ends lie further apart is not closed


def read_contour(path: Path) -> Array:
    """Read a coordinate file in Selig's or Lednicer's order.

    Returns
    -------
    (n, 2) array
        Chord one, Selig order, as :func:`checked_contour` leaves it.

    Raises
    ------
    InputError
        If the file cannot be read or holds no sound contour.
    """
    where = str(path)
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error})", "give a text file of coordinates") from error
    points: list[list[float]] = []
    odd: tuple[int, str] | None = None  # a line after the first point that is none itself
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            numbers = [float(w) for w in words]
        except ValueError:
            numbers = []
        if len(numbers) != 2:
            odd = odd or ((number, line.strip()) if points else None)
        elif odd is not None:
            raise InputError(where, f"line {odd[0]}", f"{odd[1]!r} is no point", "give x and y on each line")
        else:
            points.append(numbers)
    contour = np.array(points, dtype=np.float64).reshape(-1, 2)
    if len(contour) and contour[0].min() > 1.5 and np.allclose(contour[0], np.round(contour[0]), atol=1e-3):
        contour = _from_lednicer(contour, where)
    return checked_contour(contour, where)


def _from_lednicer(table: Array, where: str) -> Array:
    """Lednicer: a line with the two counts, then upper and lower side, each from nose to tail."""
    n_upper, n_lower = (round(float(v)) for v in table[0])
    if len(table) - 1 != n_upper + n_lower:
        raise InputError(
            where,
            "",
            f"announces {n_upper} + {n_lower} points and has {len(table) - 1}",
            "correct the counts",
        )
    upper, lower = table[1 : 1 + n_upper], table[1 + n_upper :]
    first = 1 if len(lower) and np.allclose(lower[0], upper[0], atol=1e-6) else 0
    return np.concatenate((upper[::-1], lower[first:]))


def checked_contour(contour: Array, where: str) -> Array:
    """Bring a contour to chord one in Selig order, or say what is wrong with it.

    Parameters
    ----------
    contour : (n, 2) array
        Any scale and either direction of travel, starting at the tail.
    where : str
        What an error calls the place.

    Raises
    ------
    InputError
        If points are too few or not finite, or the contour is open, flat or crosses itself.
    """
    if len(contour) and not np.all(np.isfinite(contour)):
        raise InputError(where, "", "a coordinate is not a number", "give finite coordinates")
    if len(contour) > 1:
        step = np.linalg.norm(np.diff(contour, axis=0), axis=1)
        contour = contour[np.concatenate(([True], step > 1e-9))]
    if len(contour) < _FEWEST:
        raise InputError(
            where, "", f"{len(contour)} points are too few for a contour", f"give at least {_FEWEST}"
        )
    low, chord = contour[:, 0].min(), np.ptp(contour[:, 0])
    if not chord > 0:
        raise InputError(where, "", "all points have the same x", "give x from 0 (nose) to 1 (tail)")
    contour = (contour - [low, 0.0]) / chord
    nose = int(np.argmin(contour[:, 0]))
    gap = float(np.linalg.norm(contour[0] - contour[-1]))
    if gap > _WIDEST_TAIL or min(contour[0, 0], contour[-1, 0]) < 0.9:
        raise InputError(
            where, "", f"the contour is open: its ends are {gap:.3g} chords apart",
            "list points from the tail over the nose back to the tail",
        )  # fmt: skip
    if nose in (0, len(contour) - 1):
        raise InputError(where, "", "the contour has only one side", "give upper and lower side")
    x, y = contour.T
    area = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    if area < 0:  # lower side first
        contour = contour[::-1]
    crossing = _first_crossing(contour)
    if crossing is not None:
        i, j = crossing
        raise InputError(
            where, "", f"the contour crosses itself near x = {contour[i, 0]:.3f} (points {i + 1} and {j + 1})",
            "correct or remove those points",
        )  # fmt: skip
    if not abs(area) > 1e-3:
        raise InputError(
            where, "", f"the contour encloses {abs(area):.2g} chord^2", "give a section with thickness"
        )
    return np.ascontiguousarray(contour)


def _first_crossing(contour: Array) -> tuple[int, int] | None:
    """First pair of segments that cross, by the signs of the four triangles that their ends span."""
    p, d = contour[:-1], np.diff(contour, axis=0)
    q = contour[1:]

    def cross(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
        return ax * by - ay * bx

    def side(point: Array) -> Array:
        """Side of each segment (row) on which each point (column) lies."""
        return cross(
            d[:, None, 0], d[:, None, 1], point[None, :, 0] - p[:, None, 0], point[None, :, 1] - p[:, None, 1]
        )

    parts = side(p) * side(q) < -1e-18
    hit = np.triu(parts & parts.T, k=2)
    if not hit.any():
        return None
    i, j = np.argwhere(hit)[0]
    return int(i), int(j)
