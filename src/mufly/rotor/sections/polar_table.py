"""Section coefficients of one airfoil over the full circle of angle of attack and a range of Reynolds numbers.

A :class:`PolarTable` has a uniform grid in alpha (-180 to 180 degrees) and in the logarithm of the Reynolds number, so
that one multiplication finds the cell. Inside a cell the interpolation is

* over alpha: a cubic through four neighbours with centred slopes (Catmull and Rom 1974, tension 1/2)::

      c(t) = c0 + t/2 [ (c1 - c-1) + t (2 c-1 - 5 c0 + 4 c1 - c2) + t^2 (3 (c0 - c1) + c2 - c-1) ],   0 <= t < 1

  It reproduces quadratics exactly and has a continuous slope. Newton and secant steps therefore meet no kinks, and
  finite differences of a rotor's thrust over pitch are meaningful. Its weights are constants.
* over log Re: linear, because the coefficients vary slowly, no solver takes a derivative in this direction, and linear
  interpolation cannot overshoot to negative drag.

Beyond its Reynolds numbers a table returns the value at its nearest edge. :func:`extrapolation_flags` reports these
points and the angles outside the range computed by the engine, where the values are an extension.

**Extension to the full circle.** A section far beyond stall behaves like a plate. Its forces are those measured on
four symmetrical sections over the full circle (Sheldahl and Klimas, SAND80-2114, 1981), scaled to a blade of finite
span. From 30 degrees on they are equal for all sections and Reynolds numbers. With m_l(a), m_d(a) the measured
coefficients of infinite span::

    c_l = C_max m_l(a) / M,    c_d = c_f + (C_max - c_f) (m_d(a) - m_d(180)) / M,    M = m_d(90) - m_d(180)

``C_max`` is the drag of a plate across the flow, 1.11 + 0.018 AR up to AR = 50 and 2.01 for infinite span (Hoerner,
Fluid-Dynamic Drag, 1965, ch. III; Viterna and Corrigan, NASA CP-2230, 1982), c_f the engine's least drag. Below 30
degrees, where sections differ, the curve tends to zero at 0 like the normal force of a plate. The difference between
section and plate at the last known angle a_s fades out as s^2 (3 - 2 s) up to a_s + 20 degrees, at least 40. The form
is intended for stalled sections. If an engine ends before stall, its last value fades in the same way, so that the
table is continuous. Negative angles are the mirror image. The force acts at 1/4 + |a|/(2 pi) of the chord: a quarter
from the leading edge at small angles, half at 90 degrees, a quarter from the trailing edge at 180 degrees::

    c_m = -N |a|/(2 pi) + (c_m,s - plate's at a_s) (fading)

Inside the engine's range the table is a cubic spline through the computed values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.rotor.sections.section_data import EnginePolars

Array = NDArray[np.float64]

ALPHA_GRID: Array = np.linspace(-math.pi, math.pi, 721)  # half a degree
OUTSIDE_ALPHA_BIT = 1  # bit: angle outside the engine's range, value is an extension
OUTSIDE_REYNOLDS_BIT = 2  # bit: Reynolds number outside the table, value is that of its edge

_ALPHA_CELL_COUNT = ALPHA_GRID.size - 1
_CELLS_PER_RADIAN = _ALPHA_CELL_COUNT / (2.0 * math.pi)
_FULL_TURN_RAD = 2.0 * math.pi
_VALID_RANGE_TOLERANCE = 1e-9


@result(eq=False)
class PolarTable:
    """Lift, drag and moment coefficients of a section.

    Attributes
    ----------
    name : str
        Name of the airfoil.
    alpha_rad : (na,) array
        Angle of attack, uniform from -pi to pi.
    reynolds : (nr,) array
        Chord Reynolds numbers, in geometric progression.
    cl, cd, cm : (nr, na) array
        Coefficients per chord; ``cm`` about the quarter chord, nose up positive.
    alpha_valid_rad : (nr, 2) array
        Lowest and highest angle that the engine computed at each Reynolds number; the rest is an extension.
    source : str
        Description of the engine and its settings, or of the file.
    n_crit : float
        Amplification exponent at transition of the computation; nan for measured tables.
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
        if self.alpha_rad is not ALPHA_GRID and not np.allclose(self.alpha_rad, ALPHA_GRID, atol=1e-9, rtol=0):
            raise MuflyError(f"polar {self.name}: alpha is not the grid of half a degree from -180 to 180 degrees")
        if any(c.shape != shape or not np.all(np.isfinite(c)) for c in (self.cl, self.cd, self.cm)):
            raise MuflyError(f"polar {self.name}: coefficients are not finite arrays of shape {shape}")
        steps = np.diff(np.log(self.reynolds))
        if not (np.all(self.reynolds > 0) and np.all(steps > 0) and np.allclose(steps, steps[:1], rtol=1e-6)):
            raise MuflyError(f"polar {self.name}: Reynolds numbers do not rise in geometric progression")


class PolarStack(NamedTuple):
    """Several polar tables on one grid, for Numba kernels; created by :func:`stack_polars`.

    ``grid`` has shape (tables, nr, 723, 2): the last axis is (cl, cd), the alpha axis is padded by one point at each
    end so that the cubic needs no wrap-around.
    """

    grid: Array
    log_reynolds_min: float
    rows_per_log_reynolds: float
    log_reynolds_limits: Array  # (tables, 2)
    alpha_valid_rad: Array  # (tables, nr, 2)


@cached_njit
def interpolate_polar_stack(stack: PolarStack, k: int, alpha: float, log_reynolds: float) -> tuple[float, float]:
    """Interpolate lift and drag coefficient of table ``k`` of a stack at one point; for use inside kernels.

    Parameters
    ----------
    stack : PolarStack
    k : int
        Index of the table.
    alpha : float
        Angle of attack (rad), any finite value.
    log_reynolds : float
        Natural logarithm of the Reynolds number; clamped to the table.
    """
    grid = stack.grid
    u = (alpha + math.pi) * _CELLS_PER_RADIAN
    u -= _ALPHA_CELL_COUNT * math.floor(u / _ALPHA_CELL_COUNT)
    i = int(u)
    if i >= _ALPHA_CELL_COUNT:  # rounding just below a full turn
        i, u = 0, 0.0
    t = u - i
    t2, t3 = t * t, t * t * t
    w0 = 0.5 * (-t3 + 2.0 * t2 - t)
    w1 = 0.5 * (3.0 * t3 - 5.0 * t2 + 2.0)
    w2 = 0.5 * (-3.0 * t3 + 4.0 * t2 + t)
    w3 = 0.5 * (t3 - t2)
    last = grid.shape[1] - 1
    v = min(max((log_reynolds - stack.log_reynolds_min) * stack.rows_per_log_reynolds, 0.0), float(last))
    j = min(int(v), max(last - 1, 0))
    s = v - j
    before, left, right, after = i, i + 1, i + 2, i + 3
    a = grid[k, j]
    b = grid[k, min(j + 1, last)]
    cl_a = w0 * a[before, 0] + w1 * a[left, 0] + w2 * a[right, 0] + w3 * a[after, 0]
    cl_b = w0 * b[before, 0] + w1 * b[left, 0] + w2 * b[right, 0] + w3 * b[after, 0]
    cd_a = w0 * a[before, 1] + w1 * a[left, 1] + w2 * a[right, 1] + w3 * a[after, 1]
    cd_b = w0 * b[before, 1] + w1 * b[left, 1] + w2 * b[right, 1] + w3 * b[after, 1]
    return cl_a + s * (cl_b - cl_a), cd_a + s * (cd_b - cd_a)


@cached_njit
def _fill_coefficients(stack: PolarStack, alpha: Array, log_re: Array, out: Array) -> None:
    for n in range(alpha.size):
        out[n, 0], out[n, 1] = interpolate_polar_stack(stack, 0, alpha[n], log_re[n])


def stack_polars(tables: Sequence[PolarTable]) -> PolarStack:
    """Interpolate tables to a common Reynolds grid for kernels.

    Tables with equal Reynolds numbers are copied. Otherwise all tables are interpolated at the Reynolds numbers of the
    finest table, stretched over the union of their ranges; each is clamped to its own range.

    Raises
    ------
    MuflyError
        If there is no table.
    """
    if not tables:
        raise MuflyError("no polar given; give at least one airfoil")
    first = tables[0].reynolds
    if all(
        t.reynolds.shape == first.shape and (t.reynolds is first or np.allclose(t.reynolds, first, rtol=1e-9))
        for t in tables
    ):
        reynolds = first
    else:
        n = max(t.reynolds.size for t in tables)
        low, high = min(t.reynolds[0] for t in tables), max(t.reynolds[-1] for t in tables)
        reynolds = np.geomspace(low, high, max(n, 2))
    grid = np.empty((len(tables), reynolds.size, _ALPHA_CELL_COUNT + 3, 2))
    valid = np.empty((len(tables), reynolds.size, 2))
    log_re = np.log(reynolds)
    for k, table in enumerate(tables):
        own = log_re if table.reynolds is reynolds else np.log(table.reynolds)
        for c, coefficient in enumerate((table.cl, table.cd)):
            rows = _interpolate_log_reynolds(coefficient, own, log_re)
            grid[k, :, 1:-1, c] = rows
            grid[k, :, 0, c] = rows[:, -2]
            grid[k, :, -1, c] = rows[:, 1]
        valid[k] = _interpolate_log_reynolds(table.alpha_valid_rad, own, log_re)
    span = np.array([[math.log(t.reynolds[0]), math.log(t.reynolds[-1])] for t in tables])
    per_step = (log_re.size - 1) / (log_re[-1] - log_re[0]) if log_re.size > 1 else 0.0
    return PolarStack(grid, float(log_re[0]), float(per_step), span, valid)


def _interpolate_log_reynolds(rows: Array, own: Array, wanted: Array) -> Array:
    """Interpolate rows (nr, n), known at ln Re ``own``, linearly to ln Re ``wanted``, without extrapolation."""
    if own is wanted or (own.shape == wanted.shape and np.allclose(own, wanted, atol=1e-12, rtol=0)):
        return rows
    if own.size == 1:
        return np.repeat(rows, wanted.size, axis=0)
    v = np.clip((wanted - own[0]) / (own[-1] - own[0]) * (own.size - 1), 0, own.size - 1)
    j = np.minimum(v.astype(np.int64), own.size - 2)
    s = (v - j)[:, None]
    return rows[j] * (1 - s) + rows[j + 1] * s


def _interpolate_table(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> tuple[Array, Array]:
    a, re = np.broadcast_arrays(np.asarray(alpha, dtype=np.float64), np.asarray(reynolds, dtype=np.float64))
    if not (np.all(np.isfinite(a)) and np.all(re > 0)):
        raise MuflyError(f"polar {table.name}: angle of attack has to be finite and the Reynolds number above 0")
    out = np.empty((a.size, 2))
    _fill_coefficients(stack_polars([table]), a.ravel(), np.log(re).ravel(), out)
    return out[:, 0].reshape(a.shape), out[:, 1].reshape(a.shape)


def lookup_lift_drag(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> tuple[Array, Array]:
    """Interpolate lift and drag coefficient of a table.

    Parameters
    ----------
    table : PolarTable
        Polar of the section.
    alpha : array_like
        Angle of attack (rad), any finite value, periodic.
    reynolds : array_like
        Chord Reynolds number, broadcast against ``alpha``; clamped to the table (see :func:`extrapolation_flags`).

    Returns
    -------
    cl, cd : arrays of the broadcast shape

    Raises
    ------
    MuflyError
        If an angle is not finite or a Reynolds number not above zero.

    Thesis: eqs 3.1, 3.2.
    """
    return _interpolate_table(table, alpha, reynolds)


def lookup_moment(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> Array:
    """Interpolate the moment coefficient about the quarter chord; arguments as for :func:`lookup_lift_drag`."""
    return _interpolate_table(replace(table, cl=table.cm), alpha, reynolds)[0]


def extrapolation_flags(table: PolarTable, alpha: ArrayLike, reynolds: ArrayLike) -> NDArray[np.uint8]:
    """Return a bit field for each point: whether its angle of attack or Reynolds number is outside a table's computed
    range.

    Returns
    -------
    array of uint8, broadcast shape
        0 inside; bit ``OUTSIDE_ALPHA_BIT`` where the angle lies beyond the engine's range at that Reynolds number,
        bit ``OUTSIDE_REYNOLDS_BIT`` where the Reynolds number lies beyond the table.
    """
    a, re = np.broadcast_arrays(np.asarray(alpha, dtype=np.float64), np.asarray(reynolds, dtype=np.float64))
    return flag_extrapolated_stack_points(stack_polars([table]), 0, a.ravel(), re.ravel()).reshape(a.shape)


def flag_extrapolated_stack_points(
    stack: PolarStack, k: int | NDArray[np.int64], alpha: Array, reynolds: Array
) -> NDArray[np.uint8]:
    """Return a bit field for each point (n,), as :func:`extrapolation_flags`, for tables of a stack.

    ``k`` is one table index, or (..., n) indices with a table per point.
    """
    log_re, rows = np.log(reynolds), stack.grid.shape[1]
    v = np.clip((log_re - stack.log_reynolds_min) * stack.rows_per_log_reynolds, 0.0, rows - 1.0)
    j = np.minimum(v.astype(np.int64), max(rows - 2, 0))
    s = (v - j)[:, None]
    limits = (1.0 - s) * stack.alpha_valid_rad[k, j] + s * stack.alpha_valid_rad[k, np.minimum(j + 1, rows - 1)]
    span = stack.log_reynolds_limits[k]
    a = (alpha + math.pi) % _FULL_TURN_RAD - math.pi
    beyond_alpha = (a < limits[..., 0] - _VALID_RANGE_TOLERANCE) | (a > limits[..., 1] + _VALID_RANGE_TOLERANCE)
    beyond_re = (log_re < span[..., 0] - _VALID_RANGE_TOLERANCE) | (log_re > span[..., 1] + _VALID_RANGE_TOLERANCE)
    return (beyond_alpha * OUTSIDE_ALPHA_BIT + beyond_re * OUTSIDE_REYNOLDS_BIT).astype(np.uint8)


DEFAULT_ASPECT_RATIO = 5.0  # blades of micro rotors have 2.5 to 8; C_max then lies within 5 % of the value for 5
_MAX_SPLINE_STEP_RAD = math.radians(2.5)  # wider gaps between known angles are interpolated without overshoot
_MIN_SPLINE_DRAG_FRACTION = 0.5  # of the least known drag; limits undershoot of the spline


def flat_plate_drag(aspect_ratio: float) -> float:
    """Return the drag coefficient of a flat plate normal to the flow (Viterna and Corrigan, NASA CP-2230, after
    Hoerner).

    Parameters
    ----------
    aspect_ratio : float
        Span over chord, above 0; infinity gives the two-dimensional value 2.01.
    """
    if not aspect_ratio > 0:
        raise InputError("polar", "aspect_ratio", f"{aspect_ratio:g} is out of range", "give a value above 0")
    return 1.11 + 0.018 * aspect_ratio if aspect_ratio <= 50 else 2.01


# Lift and drag of NACA 0012, 0015, 0018 and 0021, 30 to 180 degrees in steps of 5: Sheldahl and Klimas, Aerodynamic
# Characteristics of Seven Symmetrical Airfoil Sections Through 180-Degree Angle of Attack, SAND80-2114, 1981.
_MEASURED_DEEP_STALL_START_DEG = 30.0
_MEASURED_DEEP_STALL_CL = np.array([
    0.855, 0.980, 1.035, 1.050, 1.020, 0.955, 0.875, 0.760, 0.630, 0.500, 0.365, 0.230, 0.090, -0.050, -0.185, -0.320,
    -0.450, -0.575, -0.670, -0.760, -0.850, -0.930, -0.980, -0.900, -0.770, -0.670, -0.635, -0.680, -0.850, -0.660, 0.0,
])  # fmt: skip
_MEASURED_DEEP_STALL_CD = np.array([
    0.570, 0.745, 0.920, 1.075, 1.215, 1.345, 1.470, 1.575, 1.665, 1.735, 1.780, 1.800, 1.800, 1.780, 1.750, 1.700,
    1.635, 1.555, 1.465, 1.350, 1.225, 1.085, 0.925, 0.755, 0.575, 0.420, 0.320, 0.230, 0.140, 0.055, 0.025,
])  # fmt: skip
_STALL_BLEND_WIDTH_RAD, _MIN_STALL_BLEND_END_RAD = math.radians(20.0), math.radians(40.0)


def _stalled_coefficient_shapes() -> tuple[Array, Array]:
    """Return m_l / M and (m_d - m_d(180)) / M on :data:`ALPHA_GRID`, from measured lift and drag of stalled sections.

    The module docstring defines m_l, m_d and M.
    """
    size = np.abs(ALPHA_GRID)
    at = np.deg2rad(np.linspace(_MEASURED_DEEP_STALL_START_DEG, 180.0, _MEASURED_DEEP_STALL_CL.size))
    drag = _MEASURED_DEEP_STALL_CD - _MEASURED_DEEP_STALL_CD[-1]
    start = float(at[0])
    beyond = np.maximum(size, start)
    near = size < start
    lift = PchipInterpolator(at, _MEASURED_DEEP_STALL_CL)(beyond)
    lift = np.where(near, _MEASURED_DEEP_STALL_CL[0] * np.sin(2.0 * size) / math.sin(2.0 * start), lift)
    push = PchipInterpolator(at, drag)(beyond)
    push = np.where(near, drag[0] * (np.sin(size) / math.sin(start)) ** 2, push)
    across = float(np.interp(0.5 * math.pi, at, drag))
    return np.sign(ALPHA_GRID) * lift / across, push / across


_STALLED_CL_SHAPE, _STALLED_CD_SHAPE = _stalled_coefficient_shapes()


def extend_polar_to_full_circle(data: EnginePolars, *, aspect_ratio: float = DEFAULT_ASPECT_RATIO) -> PolarTable:
    """Extend section coefficients of an engine to all angles of attack (full circle) by flat-plate data.

    Parameters
    ----------
    data : EnginePolars
        Known values; each row is interpolated by a spline and extended beyond its first and last angle.
    aspect_ratio : float
        Span over chord of the blade, for the drag across the flow.

    Raises
    ------
    MuflyError
        If a Reynolds number has fewer than two known angles, or only angles on one side of 60 degrees.
    """
    c_max = flat_plate_drag(aspect_ratio)
    shape = (data.reynolds.size, ALPHA_GRID.size)
    cl, cd, cm, valid = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((shape[0], 2))
    for known in np.unique(data.known, axis=0):  # rows with the same known angles are processed together
        rows = np.flatnonzero(np.all(data.known == known, axis=1))
        a = data.alpha_rad[known]
        if a.size < 2 or a[0] > math.radians(60) or a[-1] < -math.radians(60):
            raise MuflyError(
                f"polar {data.name}: {a.size} known angles at Re {data.reynolds[rows[0]]:.0f} are too few; "
                "give two at least between -60 and 60 degrees"
            )
        values = tuple(v[np.ix_(rows, known)] for v in (data.cl, data.cd, data.cm))
        cl[rows], cd[rows], cm[rows] = _blend_into_stall(a, values, c_max)
    for row, inside in enumerate(data.valid):
        span = data.alpha_rad[inside]
        valid[row] = (span[0], span[-1]) if span.size else (0.0, 0.0)
    return PolarTable(
        data.name, ALPHA_GRID.copy(), data.reynolds.copy(), cl, cd, cm, valid, data.source, data.n_crit,
        data.thickness_ratio, data.camber,
    )  # fmt: skip


def _blend_into_stall(a: Array, values: tuple[Array, ...], c_max: float) -> tuple[Array, Array, Array]:
    """Extend cl, cd and cm ``values``, known at angles ``a`` (rad), to the full circle.

    Between the known angles they are splines; beyond, they blend into the coefficients of stalled sections, whose drag
    coefficient normal to the flow is ``c_max``.
    """
    grid, rows = ALPHA_GRID, len(values[0])
    skin = values[1].min(axis=1, keepdims=True)
    normal = c_max * (_STALLED_CL_SHAPE * np.cos(grid) + _STALLED_CD_SHAPE * np.sin(grid))
    circle = (
        np.tile(c_max * _STALLED_CL_SHAPE, (rows, 1)),
        (c_max - skin) * _STALLED_CD_SHAPE + skin,
        np.tile(-normal * np.abs(grid) / (2.0 * math.pi), (rows, 1)),
    )
    out = tuple(c.copy() for c in circle)
    for sign, end, k in ((1.0, float(a[-1]), -1), (-1.0, -float(a[0]), 0)):
        gone = min(max(end + _STALL_BLEND_WIDTH_RAD, _MIN_STALL_BLEND_END_RAD), math.pi)
        part = (sign * grid > end) & (sign * grid < gone)
        s = (gone - sign * grid[part]) / max(gone - end, 1e-9)
        own = s**2 * (3.0 - 2.0 * s)
        last = int(np.argmin(np.abs(grid - sign * end)))
        for c, base, value in zip(out, circle, values, strict=True):
            c[:, part] += own * (value[:, k] - base[:, last])[:, None]
    inside = (grid >= a[0] - 1e-12) & (grid <= a[-1] + 1e-12)
    spline = CubicSpline if a.size > 3 and np.diff(a).max() < _MAX_SPLINE_STEP_RAD else PchipInterpolator
    for c, value in zip(out, values, strict=True):
        c[:, inside] = spline(a, value, axis=1)(np.clip(grid[inside], a[0], a[-1]))
    cl, cd, cm = out
    return cl, np.maximum(cd, _MIN_SPLINE_DRAG_FRACTION * skin), cm
