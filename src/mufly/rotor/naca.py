"""NACA four- and five-digit sections from their formulas, lengths over chord.

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
thickness formula (0.25 % of chord for t = 0.12) is kept.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["naca"]

Array = NDArray[np.float64]

_PER_SIDE = 100
# Mean lines for a design lift of 0.3, by the place of camber in twentieths: r, k1.
_NORMAL = {
    1: (0.0580, 361.400),
    2: (0.1260, 51.640),
    3: (0.2025, 15.957),
    4: (0.2900, 6.643),
    5: (0.3910, 3.230),
}
_REFLEXED = {2: (0.1300, 51.990), 3: (0.2170, 15.793), 4: (0.3180, 6.520), 5: (0.4410, 3.191)}


def _thickness(x: Array, t: float) -> Array:
    return 5 * t * (0.2969 * np.sqrt(x) - 0.1260 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1015 * x**4)


def _four_digit_mean(x: Array, m: float, p: float) -> tuple[Array, Array]:
    if m == 0.0:
        return np.zeros_like(x), np.zeros_like(x)
    front = x <= p
    divisor = np.where(front, p**2, (1 - p) ** 2)
    y = m / divisor * np.where(front, 2 * p * x - x**2, 1 - 2 * p + 2 * p * x - x**2)
    return y, 2 * m / divisor * (p - x)


def _five_digit_mean(x: Array, digits: str) -> tuple[Array, Array]:
    lift, twentieth, reflexed = int(digits[0]), int(digits[1]), digits[2] == "1"
    r, k1 = (_REFLEXED if reflexed else _NORMAL)[twentieth]
    front = x <= r
    if not reflexed:
        y = np.where(front, x**3 - 3 * r * x**2 + r**2 * (3 - r) * x, r**3 * (1 - x))
        slope = np.where(front, 3 * x**2 - 6 * r * x + r**2 * (3 - r), -(r**3))
    else:
        ratio = (3 * (r - twentieth / 20) ** 2 - r**3) / (1 - r) ** 3
        gain = np.where(front, 1.0, ratio)
        y = gain * (x - r) ** 3 - ratio * (1 - r) ** 3 * x - r**3 * x + r**3
        slope = 3 * gain * (x - r) ** 2 - ratio * (1 - r) ** 3 - r**3
    scale = k1 / 6 * lift / 2  # tabulated for the second family
    return scale * y, scale * slope


def naca(digits: str, per_side: int = _PER_SIDE) -> Array:
    """Return the contour of a NACA four- or five-digit section.

    Parameters
    ----------
    digits : str
        ``"4412"``, ``"23012"``, ``"23112"`` (reflexed).
    per_side : int
        Points on each side, crowded towards nose and tail.

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
        raise InputError(
            where, "", "is no NACA designation", "give four or five digits, as naca4412 or naca23012"
        )
    t = int(digits[-2:]) / 100
    if not 0.01 <= t <= 0.40:
        raise InputError(
            where, "", f"a thickness of {t:.0%} is not possible", "let the last two digits be 01 to 40"
        )
    x = 0.5 * (1.0 - np.cos(np.linspace(0.0, math.pi, per_side)))
    if len(digits) == 4:
        m, p = int(digits[0]) / 100, int(digits[1]) / 10
        if (m == 0) != (p == 0):
            raise InputError(
                where, "", "has camber without a place, or a place without camber", "as in naca4412"
            )
        y_c, slope = _four_digit_mean(x, m, p)
    else:
        families = {"0": _NORMAL, "1": _REFLEXED}
        if int(digits[0]) == 0 or digits[2] not in families:
            normal = f"naca{digits[:2]}0{digits[3:]}"
            remedy = f"let the first digit be 1 to 9, the third 0 (normal) or 1 (reflexed), as {normal}"
            raise InputError(where, "", f"mean line {digits[:3]} is unknown", remedy)
        if int(digits[1]) not in families[digits[2]]:
            places = ", ".join(str(k) for k in families[digits[2]])
            remedy = f"let the second digit be one of {places}"
            raise InputError(where, "", f"mean line {digits[:3]} is unknown", remedy)
        y_c, slope = _five_digit_mean(x, digits)
    y_t, a = _thickness(x, t), np.arctan(slope)
    upper = np.column_stack((x - y_t * np.sin(a), y_c + y_t * np.cos(a)))
    lower = np.column_stack((x + y_t * np.sin(a), y_c - y_t * np.cos(a)))
    return np.concatenate((upper[::-1], lower[1:]))
