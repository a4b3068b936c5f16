"""Weighted sums of rows of a table, as an interpolation in a flight map needs them.

Numba compiles the functions column by column. For arrays they have a second form that sums four columns at once in a
vector register, in the same order, so that both give the same bits. :mod:`mufly.dynamics.lane_row_sums` has the form
for lanes of vehicles. The functions here are also the source of the translations to C and to symbols.
"""

# mypy: disable-error-code="no-untyped-def"
# Numba's interface for typed functions has no annotations.

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Numba declares types for a part of its functions only.
_intrinsic: Any = extending.intrinsic
_overload: Any = extending.overload
_types: Any = types

FLOW_COLUMN_COUNT, RATE_COLUMN_COUNT = 12, 8
_FLOW_ROW_GROUP_COUNT, _ROWS_PER_GROUP = 5, 3  # groups of rows of the flow's loads, and rows of a group
_INT64_TYPE, _FOUR_DOUBLES_TYPE = ir.IntType(64), ir.VectorType(ir.DoubleType(), 4)
Spread = Callable[[int, int], Any]


def _sum_weighted_groups(
    table: Array, first: int, later: int, stride: int, ca: float, cb: float, cc: float, cd: float, ce: float
) -> float:
    """Return the sum of five numbers of a table times the weights ``ca`` to ``ce``.

    Three lie at index ``first`` and each ``stride`` after it, two at ``later`` and ``stride`` after it.
    """
    n, m = np.uint64(first), np.uint64(later)
    s, t = np.uint64(first + stride), np.uint64(first + 2 * stride)
    return ca * table[n] + cb * table[s] + cc * table[t] + cd * table[m] + ce * table[np.uint64(later + stride)]


def _sum_flow_column(
    table: Array, first: int, later: int, stride: int, ca: float, cb: float, cc: float, cd: float, ce: float,
    ea: float, eb: float, ec: float,
) -> float:  # fmt: skip
    """Return one column of :func:`sum_flow_rows`."""
    a = _sum_weighted_groups(table, first, later, stride, ca, cb, cc, cd, ce)
    b = _sum_weighted_groups(table, first + 12, later + 12, stride, ca, cb, cc, cd, ce)
    c = _sum_weighted_groups(table, first + 24, later + 24, stride, ca, cb, cc, cd, ce)
    return ea * a + eb * b + ec * c


def sum_flow_rows(
    table: Array, first: int, later: int, stride: int, ca: float, cb: float, cc: float, cd: float, ce: float,
    ea: float, eb: float, ec: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Return the 12 column sums of five groups of three neighbouring rows, each row times the weights of group and row.

    Groups are added first, then rows.

    Parameters
    ----------
    table : array
        Rows one after the other.
    first, later : int
        Place of the first row of the first three groups, which are ``stride`` apart, and of the other two.
    stride : int
        Number of places between two groups of rows.
    ca, cb, cc, cd, ce : float
        Weights of the groups.
    ea, eb, ec : float
        Weights of the rows of a group.
    """
    return (
        _sum_flow_column(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 1, later + 1, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 2, later + 2, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 3, later + 3, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 4, later + 4, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 5, later + 5, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 6, later + 6, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 7, later + 7, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 8, later + 8, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 9, later + 9, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 10, later + 10, stride, ca, cb, cc, cd, ce, ea, eb, ec),
        _sum_flow_column(table, first + 11, later + 11, stride, ca, cb, cc, cd, ce, ea, eb, ec),
    )


def sum_rate_rows(
    table: Array, first: int, ea: float, eb: float, ec: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the weighted sum of three neighbouring rows of 8 columns, beginning at index ``first``."""
    return (
        _sum_rate_column(table, first, ea, eb, ec),
        _sum_rate_column(table, first + 1, ea, eb, ec),
        _sum_rate_column(table, first + 2, ea, eb, ec),
        _sum_rate_column(table, first + 3, ea, eb, ec),
        _sum_rate_column(table, first + 4, ea, eb, ec),
        _sum_rate_column(table, first + 5, ea, eb, ec),
        _sum_rate_column(table, first + 6, ea, eb, ec),
        _sum_rate_column(table, first + 7, ea, eb, ec),
    )


def _sum_rate_column(table: Array, first: int, ea: float, eb: float, ec: float) -> float:
    """Return one column of :func:`sum_rate_rows`."""
    return ea * table[np.uint64(first)] + eb * table[np.uint64(first + 8)] + ec * table[np.uint64(first + 16)]


def emit_repeated_number(builder: Any, number: Any, count: int, lane: int = 0) -> Any:
    """Emit code for a vector that repeats a number, or an element of a vector, ``count`` times."""
    if not isinstance(number.type, ir.VectorType):
        number = builder.insert_element(
            ir.Constant(_FOUR_DOUBLES_TYPE, ir.Undefined), number, _make_int32_constant(lane)
        )
    return emit_vector_selection(builder, number, [lane] * count)


def emit_vector_selection(builder: Any, vector: Any, places: Sequence[int], other: Any = None) -> Any:
    """Emit code that selects elements of a vector; indices beyond its length select from another vector."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(places)), list(places))
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined) if other is None else other, mask)


def _make_int32_constant(k: int) -> Any:
    return ir.Constant(ir.IntType(32), k)


def _emit_weighted_sum(builder: Any, weights: Iterable[Any], values: Iterable[Any]) -> Any:
    total = None
    for weight, value in zip(weights, values, strict=True):
        part = builder.fmul(weight, value)
        total = part if total is None else builder.fadd(total, part)
    return total


def _emit_load_numbers(builder: Any, table: Any, place: Any, offset: int, count: int) -> Any:
    at = builder.gep(builder.gep(table, [place]), [ir.Constant(_INT64_TYPE, offset)])
    values = builder.load(builder.bitcast(at, ir.VectorType(ir.DoubleType(), count).as_pointer()))
    values.align = 8
    return values


def _emit_quartet_split(builder: Any, vector: Any) -> list[Any]:
    if vector.type.count == 4:
        return [vector]
    return [emit_vector_selection(builder, vector, range(k, k + 4)) for k in range(0, vector.type.count, 4)]


def emit_flow_sum(builder: Any, table: Any, places: Sequence[Any], spread: Spread, width: int) -> list[Any]:
    """Emit the compiled code of :func:`sum_flow_rows`.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
    table : llvmlite value
        Pointer to the first number.
    places : sequence of llvmlite values
        ``first``, ``later`` and ``stride``.
    spread : callable
        ``spread(k, count)`` writes a vector of ``count`` times the weight ``k``.
    width : int
        Numbers in a vector of the sum over the groups: 4, or 8.

    Returns
    -------
    list of llvmlite values
        Vectors of four columns.
    """
    first, later, stride = places
    starts = [first, *(builder.add(first, builder.mul(stride, ir.Constant(_INT64_TYPE, k))) for k in (1, 2))]
    starts += [later, builder.add(later, stride)]
    quartets, whole = [], _ROWS_PER_GROUP * FLOW_COLUMN_COUNT
    for c in range(0, whole, width):  # the three rows lie one after the other
        count = min(width, whole - c)
        weights = [spread(k, count) for k in range(_FLOW_ROW_GROUP_COUNT)]
        parts = [_emit_load_numbers(builder, table, start, c, count) for start in starts]
        quartets += _emit_quartet_split(builder, _emit_weighted_sum(builder, weights, parts))
    along = [spread(_FLOW_ROW_GROUP_COUNT + k, 4) for k in range(_ROWS_PER_GROUP)]
    step = FLOW_COLUMN_COUNT // 4
    return [_emit_weighted_sum(builder, along, quartets[c::step]) for c in range(step)]


def emit_rate_sum(builder: Any, table: Any, places: Sequence[Any], spread: Spread, width: int) -> list[Any]:
    """Emit code for :func:`sum_rate_rows`, as :func:`emit_flow_sum` does."""
    out = []
    for c in range(0, RATE_COLUMN_COUNT, width):
        rows = [
            _emit_load_numbers(builder, table, places[0], RATE_COLUMN_COUNT * i + c, width)
            for i in range(_ROWS_PER_GROUP)
        ]
        out += _emit_quartet_split(
            builder, _emit_weighted_sum(builder, [spread(k, width) for k in range(_ROWS_PER_GROUP)], rows)
        )
    return out


def _make_intrinsic(columns: int, arguments: str, emit: Any) -> Any:
    """Return the Numba intrinsic of a row sum; ``arguments`` has an i for each integer and an f for each float."""
    kinds = [_types.int64 if a == "i" else _types.float64 for a in arguments]

    def type_row_sum(table: Any) -> tuple[Any, Any]:
        made = _types.UniTuple(_types.float64, columns)(table, *kinds)

        def generate_row_sum(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            data, whole = context.make_array(table)(context, builder, given[0]).data, 1 + arguments.count("i")
            quartets = emit(
                builder, data, given[1:whole], lambda k, n: emit_repeated_number(builder, given[whole + k], n), 4
            )
            numbers = [builder.extract_element(q, _make_int32_constant(k)) for q in quartets for k in range(4)]
            return context.make_tuple(builder, signature.return_type, numbers)

        return made, generate_row_sum

    return type_row_sum


_flow_form = _make_intrinsic(FLOW_COLUMN_COUNT, "iiiffffffff", emit_flow_sum)
_rate_form = _make_intrinsic(RATE_COLUMN_COUNT, "ifff", emit_rate_sum)


@_intrinsic
def _sum_flow_intrinsic(context, table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    return _flow_form(table)


@_intrinsic
def _sum_rates_intrinsic(context, table, first, ea, eb, ec):
    return _rate_form(table)


# Numba compares the names of the arguments, and takes an annotation for a part of the name.
@_overload(sum_flow_rows)
def _overload_sum_flow_rows(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    def sum_in_vectors(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
        return _sum_flow_intrinsic(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec)

    return sum_in_vectors


@_overload(sum_rate_rows)
def _overload_sum_rate_rows(table, first, ea, eb, ec):
    def sum_in_vectors(table, first, ea, eb, ec):
        return _sum_rates_intrinsic(table, first, ea, eb, ec)

    return sum_in_vectors
