"""From the range that an engine covers to the full circle of angle of attack.

A section far past stall is a plate: the pressure on it acts normal to the chord, N = C_max sin a, whatever its shape.
With the skin's drag along the chord this gives::

    c_l = C_max sin a cos a,    c_d = C_max sin^2 a + c_f cos^2 a                                    (plate)

``C_max`` is the drag of a plate across the flow, 1.11 + 0.018 AR up to AR = 50 and 2.01 for an endless one (Hoerner,
Fluid-Dynamic Drag, 1965, ch. III; Viterna and Corrigan, NASA CP-2230, 1982). Between the last known angle a_s and 90
degrees Viterna and Corrigan add to the plate what the section still has at a_s, fading out with the angle::

    c_l = C_max sin a cos a + A cos^2 a / sin a,   A = (c_l,s - C_max sin a_s cos a_s) sin a_s / cos^2 a_s
    c_d = C_max sin^2 a + B cos a,                 B = (c_d,s - C_max sin^2 a_s) / cos a_s

so that both meet the known values at a_s and the plate at 90 degrees, where c_l = 0 and c_d = C_max. The form is meant
for a stalled end and grows without bound as a_s goes to zero: where an engine gives up below 15 degrees, sin a in
the extra lift is not let below sin 15 degrees (in A likewise, so that c_l,s is still met). Negative angles are
the mirror image. With the flow from behind (beyond 90 degrees) the section is taken as the plate, with the
engine's least drag for ``c_f``; c_l and c_d are continuous at 90 degrees. The plate's force acts at
1/4 + |a|/(2 pi) of the chord: the quarter from the leading edge at small angles, half across the flow, the
quarter from the other edge from behind::

    c_m = -N |a|/(2 pi) + (c_m,s - plate's at a_s) cos a / cos a_s      up to 90 degrees, the first term beyond

What the engine computed is not touched: inside its range the table is a cubic spline through its values.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from mufly.errors import InputError, MuflyError
from mufly.rotor.polar import ALPHA_GRID, PolarTable
from mufly.rotor.section import SectionData

__all__ = ["ASPECT_RATIO", "extend", "plate_drag"]

Array = NDArray[np.float64]

ASPECT_RATIO = 5.0  # blades of micro rotors have 2.5 to 8; C_max then lies within 5 % of the value for 5
_STALL = math.radians(15.0)
_COARSE = math.radians(2.5)  # known angles further apart than this are joined without overshoot
_LEAST_DRAG = 0.5  # of the least known drag; guards against overshoot of the spline


def plate_drag(aspect_ratio: float) -> float:
    """Drag coefficient of a flat plate across the flow (Viterna and Corrigan, NASA CP-2230, after Hoerner).

    Parameters
    ----------
    aspect_ratio : float
        Span over chord, above 0; infinity gives the two-dimensional value 2.01.
    """
    if not aspect_ratio > 0:
        raise InputError("polar", "aspect_ratio", f"{aspect_ratio:g} is not possible", "give a value above 0")
    return 1.11 + 0.018 * aspect_ratio if aspect_ratio <= 50 else 2.01


def _plate_moment(alpha: Array | float, c_max: float) -> Array:
    a = np.asarray(alpha)
    return -c_max * np.sin(a) * np.abs(a) / (2 * math.pi)


def _towards_broadside(
    alpha: Array, end: float, at_end: tuple[Array, Array, Array], c_max: float
) -> tuple[Array, Array, Array]:
    """Viterna's extension for positive angles from ``end`` to a right angle; ``at_end`` has one value a row."""
    cl_s, cd_s, cm_s = (v[:, None] for v in at_end)
    s, c = np.sin(alpha), np.cos(alpha)
    s_end, c_end = math.sin(end), math.cos(end)
    least = math.sin(_STALL)
    extra = (cl_s - c_max * s_end * c_end) * max(s_end, least) / c_end**2
    cl = c_max * s * c + extra * c**2 / np.maximum(s, least)
    cd = c_max * s**2 + (cd_s - c_max * s_end**2) / c_end * c
    cm = _plate_moment(alpha, c_max) + (cm_s - _plate_moment(end, c_max)) / c_end * c
    return cl, cd, cm


def extend(data: SectionData, *, aspect_ratio: float = ASPECT_RATIO) -> PolarTable:
    """Make the full-circle table of what an engine computed.

    Parameters
    ----------
    data : SectionData
        Known values; in each row they are joined by a spline and extended beyond the first and the last.
    aspect_ratio : float
        Span over chord of the blade, for the drag across the flow.

    Raises
    ------
    MuflyError
        If a Reynolds number has fewer than two known angles, or all of them on one side of 60 degrees.
    """
    c_max = plate_drag(aspect_ratio)
    shape = (data.reynolds.size, ALPHA_GRID.size)
    cl, cd, cm, valid = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((shape[0], 2))
    for known in np.unique(data.known, axis=0):  # rows that know the same angles are done together
        rows = np.flatnonzero(np.all(data.known == known, axis=1))
        a = data.alpha_rad[known]
        if a.size < 2 or a[0] > math.radians(60) or a[-1] < -math.radians(60):
            raise MuflyError(
                f"polar {data.name}: {a.size} known angles at Re {data.reynolds[rows[0]]:.0f} are too few; "
                "give two at least between -60 and 60 degrees"
            )
        values = tuple(v[np.ix_(rows, known)] for v in (data.cl, data.cd, data.cm))
        cl[rows], cd[rows], cm[rows] = _circle(a, values, c_max)
    for row, inside in enumerate(data.valid):
        span = data.alpha_rad[inside]
        valid[row] = (span[0], span[-1]) if span.size else (0.0, 0.0)
    return PolarTable(
        data.name, ALPHA_GRID.copy(), data.reynolds.copy(), cl, cd, cm, valid, data.source, data.n_crit,
        data.thickness_ratio, data.camber,
    )  # fmt: skip


def _circle(a: Array, values: tuple[Array, ...], c_max: float) -> tuple[Array, Array, Array]:
    """Rows that know the angles ``a``: spline inside, Viterna up to a right angle, plate beyond."""
    right = math.pi / 2
    grid, rows = ALPHA_GRID, len(values[0])
    skin = values[1].min(axis=1, keepdims=True)
    s, c = np.sin(grid), np.cos(grid)
    cl, cd = np.tile(c_max * s * c, (rows, 1)), c_max * s**2 + skin * c**2
    cm = np.tile(_plate_moment(grid, c_max), (rows, 1))
    for sign, end, k in ((1.0, float(a[-1]), -1), (-1.0, -float(a[0]), 0)):
        if end < right:
            part = (sign * grid > end) & (sign * grid <= right)
            at_end = (sign * values[0][:, k], values[1][:, k], sign * values[2][:, k])
            front = _towards_broadside(sign * grid[part], end, at_end, c_max)
            cl[:, part], cd[:, part], cm[:, part] = sign * front[0], front[1], sign * front[2]
    inside = (grid >= a[0] - 1e-12) & (grid <= a[-1] + 1e-12)
    spline = CubicSpline if a.size > 3 and np.diff(a).max() < _COARSE else PchipInterpolator
    for out, value in zip((cl, cd, cm), values, strict=True):
        out[:, inside] = spline(a, value, axis=1)(np.clip(grid[inside], a[0], a[-1]))
    return cl, np.maximum(cd, _LEAST_DRAG * skin), cm
