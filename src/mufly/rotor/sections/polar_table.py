"""Section coefficients of one airfoil over the full circle of angle of attack and a range of Reynolds numbers.

A :class:`PolarTable` stands on a uniform grid in alpha (-180 to 180 degrees) and in the logarithm of the Reynolds
number, so that finding the cell is one multiplication. Inside a cell:

* over alpha a cubic through four neighbours with centred slopes (Catmull and Rom 1974, tension 1/2)::

      c(t) = c0 + t/2 [ (c1 - c-1) + t (2 c-1 - 5 c0 + 4 c1 - c2) + t^2 (3 (c0 - c1) + c2 - c-1) ],   0 <= t < 1

  It reproduces quadratics exactly and has a continuous slope: Newton and secant steps on a blade element do not
  stumble over kinks every half degree, as they would with straight lines, and a finite difference of a rotor's
  thrust over pitch is the derivative of something. Its weights are fixed numbers, no second table is needed.
* over log Re straight lines: the coefficients change slowly there (the same polar, a third apart), no solver takes
  a derivative along it, and a straight line cannot overshoot into negative drag.

Beyond its Reynolds numbers a table answers with its nearest edge; :func:`outside` says for which points that was
so, and which angles lie outside the range that the engine computed (there the values are an extension).

From the range that an engine covers to the full circle of angle of attack.

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
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from mufly.compiled import compiled
from mufly.errors import InputError, MuflyError
from mufly.rotor.sections.section import SectionData

Array = NDArray[np.float64]

ALPHA_GRID: Array = np.linspace(-math.pi, math.pi, 721)  # half a degree
OUTSIDE_ALPHA = 1  # bit: angle beyond what the engine computed, value is extended
OUTSIDE_REYNOLDS = 2  # bit: Reynolds number beyond the table, value is that of its edge

_CELLS = ALPHA_GRID.size - 1
_PER_RADIAN = _CELLS / (2.0 * math.pi)
_TURN = 2.0 * math.pi
_SLACK = 1e-9


@dataclass(frozen=True, eq=False)
class PolarTable:
    """Lift, drag and moment of a section.

    Attributes
    ----------
    name : str
        Airfoil.
    alpha_rad : (na,) array
        Angle of attack, uniform from -pi to pi.
    reynolds : (nr,) array
        Chord Reynolds numbers, in geometric progression.
    cl, cd, cm : (nr, na) array
        Coefficients per chord; ``cm`` about the quarter chord, nose up positive.
    alpha_valid_rad : (nr, 2) array
        Lowest and highest angle that the engine computed at each Reynolds number; the rest is an extension.
    source : str
        Engine and its settings, or the file, in words.
    n_crit : float
        Amplification exponent of transition that the table was computed with; nan for measured tables.
    thickness_ratio, camber : float
        Greatest thickness and greatest camber over chord; nan where the geometry is unknown.
    """

    name: str
    alpha_rad: Array
    reynolds: Array
    cl: Array
    cd: Array
    cm: Array
    alpha_valid_rad: Array
    source: str
    n_crit: float = math.nan
    thickness_ratio: float = math.nan
    camber: float = math.nan

    def __post_init__(self) -> None:
        shape = (self.reynolds.size, self.alpha_rad.size)
        if not np.allclose(self.alpha_rad, ALPHA_GRID, atol=1e-9, rtol=0):
            raise MuflyError(
                f"polar {self.name}: alpha is not the grid of half a degree from -180 to 180 degrees"
            )
        if any(c.shape != shape or not np.all(np.isfinite(c)) for c in (self.cl, self.cd, self.cm)):
            raise MuflyError(f"polar {self.name}: coefficients are not finite arrays of shape {shape}")
        steps = np.diff(np.log(self.reynolds))
        if not (np.all(self.reynolds > 0) and np.all(steps > 0) and np.allclose(steps, steps[:1], rtol=1e-6)):
            raise MuflyError(f"polar {self.name}: Reynolds numbers do not rise in geometric progression")


class PolarStack(NamedTuple):
    """Several tables on one grid, as Numba kernels take them. Make it with :func:`stack_polars`.

    ``grid`` has shape (tables, nr, 723, 2): the last axis is (cl, cd), the alpha axis is padded by one point
    below and one above so that the cubic needs no wrap-around.
    """

    grid: Array
    log_reynolds_min: float
    per_log_reynolds: float
    log_reynolds_range: Array  # (tables, 2)
    alpha_valid_rad: Array  # (tables, nr, 2)


@compiled
def coefficients(stack: PolarStack, k: int, alpha: float, log_reynolds: float) -> tuple[float, float]:
    """Lift and drag coefficient of table ``k`` of a stack at one point; for use inside kernels.

    Parameters
    ----------
    stack : PolarStack
    k : int
        Table.
    alpha : float
        Angle of attack (rad), any finite value.
    log_reynolds : float
        Natural logarithm of the Reynolds number; clamped to the table.
    """
    grid = stack.grid
    u = (alpha + math.pi) * _PER_RADIAN
    u -= _CELLS * math.floor(u / _CELLS)
    i = int(u)
    if i >= _CELLS:  # rounding just below a full turn
        i, u = 0, 0.0
    t = u - i
    t2, t3 = t * t, t * t * t
    w0 = 0.5 * (-t3 + 2.0 * t2 - t)
    w1 = 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)
    w2 = 0.5 * (-3.0 * t3 + 4.0 * t2 + t)
    w3 = 0.5 * (t3 - t2)
    last = grid.shape[1] - 1
    v = min(max((log_reynolds - stack.log_reynolds_min) * stack.per_log_reynolds, 0.0), float(last))
    j = min(int(v), max(last - 1, 0))
    s = v - j
    a = grid[k, j]
    b = grid[k, min(j + 1, last)]
    cl_a = w0 * a[i, 0] + w1 * a[i + 1, 0] + w2 * a[i + 2, 0] + w3 * a[i + 3, 0]
    cl_b = w0 * b[i, 0] + w1 * b[i + 1, 0] + w2 * b[i + 2, 0] + w3 * b[i + 3, 0]
    cd_a = w0 * a[i, 1] + w1 * a[i + 1, 1] + w2 * a[i + 2, 1] + w3 * a[i + 3, 1]
    cd_b = w0 * b[i, 1] + w1 * b[i + 1, 1] + w2 * b[i + 2, 1] + w3 * b[i + 3, 1]
    return cl_a + s * (cl_b - cl_a), cd_a + s * (cd_b - cd_a)


@compiled
def _many(stack: PolarStack, alpha: Array, log_re: Array, out: Array) -> None:
    for n in range(alpha.size):
        out[n, 0], out[n, 1] = coefficients(stack, 0, alpha[n], log_re[n])


def stack_polars(tables: Sequence[PolarTable]) -> PolarStack:
    """Put tables on one Reynolds grid, as kernels take them.

    Tables whose Reynolds numbers agree are copied; otherwise all are read off at the numbers of the finest one,
    stretched over the union of their ranges (each still clamped to its own range).

    Raises
    ------
    MuflyError
        If there is no table.
    """
    if not tables:
        raise MuflyError("no polar given; give at least one airfoil")
    first = tables[0].reynolds
    if all(t.reynolds.shape == first.shape and np.allclose(t.reynolds, first, rtol=1e-9) for t in tables):
        reynolds = first
    else:
        n = max(t.reynolds.size for t in tables)
        low, high = min(t.reynolds[0] for t in tables), max(t.reynolds[-1] for t in tables)
        reynolds = np.geomspace(low, high, max(n, 2))
    grid = np.empty((len(tables), reynolds.size, _CELLS + 3, 2))
    valid = np.empty((len(tables), reynolds.size, 2))
    log_re = np.log(reynolds)
    for k, table in enumerate(tables):
        own = np.log(table.reynolds)
        for c, coefficient in enumerate((table.cl, table.cd)):
            rows = _at_log_reynolds(coefficient, own, log_re)
            grid[k, :, 1:-1, c] = rows
            grid[k, :, 0, c] = rows[:, -2]
            grid[k, :, -1, c] = rows[:, 1]
        valid[k] = _at_log_reynolds(table.alpha_valid_rad, own, log_re)
    span = np.array([[math.log(t.reynolds[0]), math.log(t.reynolds[-1])] for t in tables])
    per_step = (log_re.size - 1) / (log_re[-1] - log_re[0]) if log_re.size > 1 else 0.0
    return PolarStack(grid, float(log_re[0]), float(per_step), span, valid)


def _at_log_reynolds(rows: Array, own: Array, wanted: Array) -> Array:
    """Rows (nr, n) at other Reynolds numbers, linear in log Re, clamped."""
    if own.shape == wanted.shape and np.allclose(own, wanted, atol=1e-12, rtol=0):
        return rows
    if own.size == 1:
        return np.repeat(rows, wanted.size, axis=0)
    v = np.clip((wanted - own[0]) / (own[-1] - own[0]) * (own.size - 1), 0, own.size - 1)
    j = np.minimum(v.astype(np.int64), own.size - 2)
    s = (v - j)[:, None]
    return rows[j] * (1 - s) + rows[j + 1] * s


def _read(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> tuple[Array, Array]:
    a, re = np.broadcast_arrays(np.asarray(alpha, dtype=np.float64), np.asarray(reynolds, dtype=np.float64))
    if not (np.all(np.isfinite(a)) and np.all(re > 0)):
        raise MuflyError(
            f"polar {table.name}: angle of attack has to be finite and the Reynolds number above 0"
        )
    out = np.empty((a.size, 2))
    _many(stack_polars([table]), a.ravel(), np.log(re).ravel(), out)
    return out[:, 0].reshape(a.shape), out[:, 1].reshape(a.shape)


def lookup(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> tuple[Array, Array]:
    """Lift and drag coefficient.

    Parameters
    ----------
    table : PolarTable
        The section.
    alpha : array_like
        Angle of attack (rad), any finite value; whole turns do not matter.
    reynolds : array_like
        Chord Reynolds number, broadcast against ``alpha``; clamped to the table (see :func:`outside`).

    Returns
    -------
    cl, cd : arrays of the broadcast shape

    Raises
    ------
    MuflyError
        If an angle is not finite or a Reynolds number not above zero.

    Thesis: eqs 3.1, 3.2.
    """
    return _read(table, alpha, reynolds)


def lookup_cm(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> Array:
    """Moment coefficient about the quarter chord; arguments as for :func:`lookup`."""
    return _read(replace(table, cl=table.cm), alpha, reynolds)[0]


def outside(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> NDArray[np.uint8]:
    """Say which points a table answers by extension.

    Returns
    -------
    array of uint8, broadcast shape
        0 inside; bit ``OUTSIDE_ALPHA`` where the angle lies beyond the engine's range at that Reynolds number,
        bit ``OUTSIDE_REYNOLDS`` where the Reynolds number lies beyond the table.
    """
    a, re = np.broadcast_arrays(np.asarray(alpha, dtype=np.float64), np.asarray(reynolds, dtype=np.float64))
    return outside_of(stack_polars([table]), 0, a.ravel(), re.ravel()).reshape(a.shape)


def outside_of(
    stack: PolarStack, k: int | NDArray[np.int64], alpha: Array, reynolds: Array
) -> NDArray[np.uint8]:
    """The same for tables ``k`` of a stack, at points (n,): one, or (..., n) for a table a point."""
    log_re, rows = np.log(reynolds), stack.grid.shape[1]
    v = np.clip((log_re - stack.log_reynolds_min) * stack.per_log_reynolds, 0.0, rows - 1.0)
    j = np.minimum(v.astype(np.int64), max(rows - 2, 0))
    s = (v - j)[:, None]
    limits = (1.0 - s) * stack.alpha_valid_rad[k, j] + s * stack.alpha_valid_rad[
        k, np.minimum(j + 1, rows - 1)
    ]
    span = stack.log_reynolds_range[k]
    a = (alpha + math.pi) % _TURN - math.pi
    beyond_alpha = (a < limits[..., 0] - _SLACK) | (a > limits[..., 1] + _SLACK)
    beyond_re = (log_re < span[..., 0] - _SLACK) | (log_re > span[..., 1] + _SLACK)
    return (beyond_alpha * OUTSIDE_ALPHA + beyond_re * OUTSIDE_REYNOLDS).astype(np.uint8)


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
