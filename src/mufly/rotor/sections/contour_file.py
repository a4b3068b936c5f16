"""Reader of airfoil coordinate files, and validation of contours.

Two orders are in use. Selig's order is one list from the tail over the upper side to the nose and back along the lower
side. Lednicer's order is a line with the two counts, which may be missing, then the upper and the lower side, each from
nose to tail. A closed curve that begins elsewhere is reordered to begin at the tail. Titles before and remarks after
the coordinates are ignored. Text is UTF-8 or UTF-16; numbers may have decimal commas or Fortran's exponents (1.0D-3). A
valid contour has enough points, closes at the tail (up to a blunt base), encloses an area and does not cross itself.

A user's contour may lie anywhere in the plane. With p_t the middle of the tail, p_n the point furthest from it (nose),
c their distance and the tilt of the chord line, nose up, a = atan2(y_n - y_t, x_t - x_n):

* both ends off the x axis by more than :data:`_CHORD_AXIS_TOLERANCE` c: the contour is moved so that one of them lies
  on the axis;
* abs(a) > :data:`_MAX_KEPT_TILT_RAD`: the contour is turned about its nose by a, so that the chord line is the x axis.
  Below, the frame of the file is kept, because flat undersides of catalogue sections (up to 3.9 degrees) lie along x;
* always: x is shifted and both are scaled so that x runs from 0 to 1.
"""

from __future__ import annotations

import math
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.files.text_table import decode_text

Array = NDArray[np.float64]


class SectionChangeWarning(UserWarning):
    """Warning that the data of a section was changed before use, for instance moved or rotated."""


_MIN_POINTS = 20
_MAX_TAIL_GAP = 0.12  # of chord; a contour whose ends lie further apart is not closed
_CHORD_AXIS_TOLERANCE = 2e-3  # of chord
_MIN_WARNED_SCALE_CHANGE = 0.02  # of chord; smaller changes of scale give no warning
_MAX_KEPT_TILT_RAD = math.radians(4.0)
_MAX_TAIL_ALIGNED_TILT_RAD = math.radians(
    0.6
)  # below this tilt the tail, which is better defined than the nose, fixes the axis
_MIN_WARNED_TILT_RAD = math.radians(1.5)  # greater tilts give a warning
_NOSE_TAIL_REGION_CHORDS = 0.05  # of chord: region in which nose and tail differ
_BLUNT_TAIL_TOLERANCE_CHORDS = 1e-3  # of chord: distance of the corners of a blunt tail
_FORTRAN_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")


def read_contour(path: Path) -> Array:
    """Return the contour in an airfoil database's coordinate file, scaled to chord 1 but not rotated.

    Returns
    -------
    (n, 2) array
        Contour of chord 1 in Selig order, as returned by :func:`validate_contour`.

    Raises
    ------
    InputError
        If the file cannot be read or holds no sound contour.
    """
    where = str(path)
    return validate_contour(_order_from_tail(_read_points(path, where), where), where)


def read_custom_contour(path: Path) -> tuple[Array, str]:
    """Return the contour in a coordinate file, moved and turned onto the x axis, and a description of the change.

    A :class:`SectionChangeWarning` reports the change.

    Returns
    -------
    contour : (n, 2) array
        Contour of chord 1 in Selig order.
    words : str
        Description of translation, rotation or scaling; empty without any.

    Raises
    ------
    InputError
        If the file cannot be read or holds no sound contour.
    """
    where = str(path)
    contour, words = align_contour(_order_from_tail(_read_points(path, where), where))
    checked = validate_contour(contour, where)
    if words:
        warnings.warn(f"{path.name}: {words}", SectionChangeWarning, stacklevel=2)
    return checked, words


def align_contour(contour: Array) -> tuple[Array, str]:
    """Return a contour moved, turned and mirrored so that its chord line lies along x, and a description of the change.

    See the module docstring for the rules.

    Parameters
    ----------
    contour : (n, 2) array
        Contour that starts and ends at the tail.

    Returns
    -------
    placed : (n, 2) array
        Contour with its chord line along x.
    words : str
        Description of the change; empty without any.
    """
    if len(contour) < 3 or not (np.all(np.isfinite(contour)) and np.ptp(contour[:, 0]) > 0.0):
        return contour, ""
    done = []
    tail = 0.5 * (contour[0] + contour[-1])
    nose = contour[int(np.argmax(np.hypot(*(contour - tail).T)))]
    if nose[0] - tail[0] > abs(nose[1] - tail[1]):  # tail on the left
        contour, nose, tail = contour * [-1.0, 1.0], nose * [-1.0, 1.0], tail * [-1.0, 1.0]
        done.append("mirrored, as its nose is at the greater x")
    chord = float(np.hypot(*(tail - nose)))
    tilt = math.atan2(nose[1] - tail[1], tail[0] - nose[0])
    end = tail if abs(tilt) < _MAX_TAIL_ALIGNED_TILT_RAD else nose
    up = -float(end[1]) if min(abs(nose[1]), abs(tail[1])) > _CHORD_AXIS_TOLERANCE * chord else 0.0
    if abs(tilt) > _MAX_KEPT_TILT_RAD:
        c, s = math.cos(tilt), math.sin(tilt)
        contour = nose + (contour - nose) @ np.array([[c, s], [-s, c]])
        done.append(f"turned by {math.degrees(tilt):+.2f} degrees onto its chord line")
    if up:
        contour = contour + np.array([0.0, up])
    low, size = float(contour[:, 0].min()), float(np.ptp(contour[:, 0]))
    if up or abs(low) > _CHORD_AXIS_TOLERANCE * size:
        done.append(f"moved by ({-low / size + 0.0:.3g}, {up / size:.3g}) chords")
    if abs(size - 1.0) > _MIN_WARNED_SCALE_CHANGE:
        done.append(f"scaled by {1.0 / size:.3g}")
    words = f"the contour was {', '.join(done)}: x now runs from 0 to 1" if done else ""
    if _MIN_WARNED_TILT_RAD < abs(tilt) <= _MAX_KEPT_TILT_RAD:
        words += f"{'; ' if words else ''}its chord line stands {math.degrees(tilt):+.1f} degrees to the x axis, from "
        words += "which the angle of attack counts"
    return contour, words


def _read_points(path: Path, where: str) -> list[tuple[int, list[float]]]:
    """Read points with their line numbers: two numbers each, or three with a constant third."""
    try:
        lines = decode_text(path.read_bytes()).splitlines()
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error})", "give a text file of coordinates") from error
    points: list[tuple[int, list[float]]] = []
    odd: tuple[int, str] | None = None  # a line after the first point that is no point
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        numbers = _parse_numbers(line)
        if len(numbers) not in (2, 3) or (points and len(numbers) != len(points[0][1])):
            odd = odd or ((number, line.strip()) if points else None)
        elif odd is not None:
            raise InputError(where, f"line {odd[0]}", f"{odd[1]!r} is not a point", "give x and y on each line")
        else:
            points.append((number, numbers))
    for number, numbers in points:
        if not all(map(math.isfinite, numbers)):
            raise InputError(where, f"line {number}", "a coordinate is not a number", "give finite coordinates")
        if len(numbers) == 3 and numbers[2] != points[0][1][2]:
            raise InputError(where, f"line {number}", "has three coordinates", "give x and y of a flat section")
    return [(number, numbers[:2]) for number, numbers in points]


def _parse_numbers(line: str) -> list[float]:
    """Return the numbers of a line; an empty list if one of its words is not a number."""
    words = [w.rstrip(",;") for w in line.replace(";", " ").split()]
    decimal = "." not in line and len(words) > 1 and any("," in w for w in words)  # 0,25 0,1
    words = [w.replace(",", ".") for w in words] if decimal else line.replace(",", " ").replace(";", " ").split()
    try:
        return [float(w) for w in words]
    except ValueError:
        pass
    try:
        return [float(_FORTRAN_EXPONENT.sub("e", w)) for w in words]
    except ValueError:
        return []


def _order_from_tail(points: list[tuple[int, list[float]]], where: str) -> Array:
    """Return the points of a file, in whatever order, as a contour (n, 2) from the tail around the nose to the tail."""
    contour = np.array([p for _, p in points], dtype=np.float64).reshape(-1, 2)
    if len(contour) < 3:
        return contour
    counts = contour[0]
    if counts.min() > 1.5 and np.allclose(counts, np.round(counts), atol=1e-3):
        if len(contour) - 1 == round(float(counts.sum())):
            return _lednicer_to_selig(contour[1:], round(float(counts[0])))
        if contour[1:].max() < 0.5 * counts.max():  # the counts are no point of the contour
            raise InputError(
                where, "", f"announces {counts[0]:g} + {counts[1]:g} points and has {len(contour) - 1}",
                "correct the counts",
            )  # fmt: skip
    low, size = float(contour[:, 0].min()), float(np.ptp(contour[:, 0]))
    if not size > 0:
        return contour
    x = (contour[:, 0] - low) / size
    back = np.flatnonzero((x[:-1] > 0.9) & (x[1:] < 0.1))
    if x[0] < 0.1 and back.size == 1:
        return _lednicer_to_selig(contour, int(back[0]) + 1)
    gap = float(np.hypot(*(contour[0] - contour[-1]))) / size
    if gap > _MAX_TAIL_GAP or x[0] > 0.9:
        return contour
    # A closed curve that begins elsewhere, or at a tail with the least x.
    ring = contour[:-1] if gap < 1e-9 else contour
    x = x[: len(ring)]
    if _thickness_near_end(ring, x < _NOSE_TAIL_REGION_CHORDS) < 0.5 * _thickness_near_end(
        ring, x > 1.0 - _NOSE_TAIL_REGION_CHORDS
    ):
        x = 1.0 - x
    tail = int(np.argmax(x))
    ring, x = np.roll(ring, -tail, axis=0), np.roll(x, -tail)
    if x[-1] > 1.0 - _BLUNT_TAIL_TOLERANCE_CHORDS:  # a blunt tail; the contour begins at its second corner
        return ring
    if x[1] > 1.0 - _BLUNT_TAIL_TOLERANCE_CHORDS:
        return np.roll(ring, -1, axis=0)
    return np.concatenate((ring, ring[:1]))


def _thickness_near_end(ring: Array, end: NDArray[np.bool_]) -> float:
    return float(np.ptp(ring[end, 1])) if np.count_nonzero(end) > 1 else math.inf


def _lednicer_to_selig(table: Array, n_upper: int) -> Array:
    """Convert Lednicer's order (upper and lower side, each from nose to tail) to Selig's."""
    upper, lower = table[:n_upper], table[n_upper:]
    first = 1 if len(lower) and len(upper) and np.allclose(lower[0], upper[0], atol=1e-6) else 0
    return np.concatenate((upper[::-1], lower[first:]))


def validate_contour(contour: Array, where: str) -> Array:
    """Return a contour scaled to chord 1 and put in Selig order; raise an error if it is invalid.

    Parameters
    ----------
    contour : (n, 2) array
        Contour in any scale and either sense, starting at the tail.
    where : str
        Name of the source in errors.

    Raises
    ------
    InputError
        If there are too few points, a point is not finite, or the contour is open, flat or crosses itself.
    """
    if len(contour) and not np.all(np.isfinite(contour)):
        raise InputError(where, "", "a coordinate is not a number", "give finite coordinates")
    if len(contour) > 1:
        step = np.linalg.norm(np.diff(contour, axis=0), axis=1)
        contour = contour[np.concatenate(([True], step > 1e-9))]
    if len(contour) < _MIN_POINTS:
        raise InputError(
            where, "", f"{len(contour)} points are too few for a contour",
            f"give at least {_MIN_POINTS} lines of x and y",
        )  # fmt: skip
    low, chord = contour[:, 0].min(), np.ptp(contour[:, 0])
    if not chord > 0:
        raise InputError(where, "", "all points have the same x", "give x from 0 (nose) to 1 (tail)")
    contour = (contour - [low, 0.0]) / chord
    nose = int(np.argmin(contour[:, 0]))
    gap = float(np.linalg.norm(contour[0] - contour[-1]))
    if gap > _MAX_TAIL_GAP or min(contour[0, 0], contour[-1, 0]) < 0.9:
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
        raise InputError(where, "", f"the contour encloses {abs(area):.2g} chord^2", "give a section with thickness")
    return np.ascontiguousarray(contour)


def _first_crossing(contour: Array) -> tuple[int, int] | None:
    """Return the indices of the first two segments of a contour that cross; None if there are none.

    Segments cross if the ends of each lie on different sides of the other.
    """
    p, d = contour[:-1], np.diff(contour, axis=0)
    q = contour[1:]

    def cross_product(ax: Array, ay: Array, bx: Array, by: Array) -> Array:
        return ax * by - ay * bx

    def side_of_segment(point: Array) -> Array:
        """Return a matrix whose sign tells on which side of segment i (row) the point j (column) lies."""
        return cross_product(
            d[:, None, 0], d[:, None, 1], point[None, :, 0] - p[:, None, 0], point[None, :, 1] - p[:, None, 1]
        )

    parts = side_of_segment(p) * side_of_segment(q) < -1e-18
    hit = np.triu(parts & parts.T, k=2)
    if not hit.any():
        return None
    i, j = np.argwhere(hit)[0]
    return int(i), int(j)
