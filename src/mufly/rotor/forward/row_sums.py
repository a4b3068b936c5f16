"""Weighted sums of rows of a table, as an interpolation in a flight map needs them.

Numba compiles the functions column by column. For arrays they have a second form that sums four columns at once in a
vector register, in the same order, so that both give the same bits. :mod:`mufly.dynamics.lane_row_sums` has the form
for lanes of vehicles. The sources here are what is translated to C and to symbols.
"""

# mypy: disable-error-code="no-untyped-def"
# Numba's interface for typed functions has no annotations.

from __future__ import annotations

from collections.abc import Iterable
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

FLOW_COLUMNS, RATE_COLUMNS = 12, 8
_GROUPS = 5  # of rows of the flow's loads
_WORD, _QUARTET = ir.IntType(64), ir.VectorType(ir.DoubleType(), 4)


def sum_flow_rows(
    table: Array, first: int, later: int, stride: int, ca: float, cb: float, cc: float, cd: float, ce: float,
    ea: float, eb: float, ec: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float, float]:  # fmt: skip
    """Return the weighted sum of five times three neighbouring rows of 12 columns.

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
    t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = t8 = t9 = t10 = t11 = 0.0
    for j in range(5):
        v = ca if j == 0 else cb if j == 1 else cc if j == 2 else cd if j == 3 else ce
        row = first + stride * j if j < 3 else later + stride * (j - 3)
        for i in range(3):
            f = v * (ea if i == 0 else eb if i == 1 else ec)
            n = np.uint64(row + 12 * i)
            t0 += f * table[n]
            t1 += f * table[n + np.uint64(1)]
            t2 += f * table[n + np.uint64(2)]
            t3 += f * table[n + np.uint64(3)]
            t4 += f * table[n + np.uint64(4)]
            t5 += f * table[n + np.uint64(5)]
            t6 += f * table[n + np.uint64(6)]
            t7 += f * table[n + np.uint64(7)]
            t8 += f * table[n + np.uint64(8)]
            t9 += f * table[n + np.uint64(9)]
            t10 += f * table[n + np.uint64(10)]
            t11 += f * table[n + np.uint64(11)]
    return t0, t1, t2, t3, t4, t5, t6, t7, t8, t9, t10, t11


def sum_rate_rows(
    table: Array, first: int, ea: float, eb: float, ec: float
) -> tuple[float, float, float, float, float, float, float, float]:
    """Return the weighted sum of three neighbouring rows of 8 columns; ``first`` is the place of the first."""
    t0 = t1 = t2 = t3 = t4 = t5 = t6 = t7 = 0.0
    for i in range(3):
        f = ea if i == 0 else eb if i == 1 else ec
        n = np.uint64(first + 8 * i)
        t0 += f * table[n]
        t1 += f * table[n + np.uint64(1)]
        t2 += f * table[n + np.uint64(2)]
        t3 += f * table[n + np.uint64(3)]
        t4 += f * table[n + np.uint64(4)]
        t5 += f * table[n + np.uint64(5)]
        t6 += f * table[n + np.uint64(6)]
        t7 += f * table[n + np.uint64(7)]
    return t0, t1, t2, t3, t4, t5, t6, t7


def emit_row_sum(builder: Any, table: Any, rows: Iterable[tuple[Any, Any]], columns: int) -> list[Any]:
    """Write the weighted sum of rows in the language of LLVM; return its numbers.

    Parameters
    ----------
    builder : llvmlite.ir.IRBuilder
    table : llvmlite value
        Pointer to the first number.
    rows : iterable of (place, weight)
        Place of the first number of each row, and its weight.
    columns : int
        Multiple of 4.
    """
    lanes = [ir.Constant(ir.IntType(32), k) for k in range(4)]
    sums: list[Any] = [ir.Constant(_QUARTET, [0.0] * 4)] * (columns // 4)
    for place, weight in rows:
        vector = ir.Constant(_QUARTET, ir.Undefined)
        for lane in lanes:
            vector = builder.insert_element(vector, weight, lane)
        for c in range(len(sums)):
            at = builder.gep(table, [builder.add(place, ir.Constant(_WORD, 4 * c))])
            values = builder.load(builder.bitcast(at, _QUARTET.as_pointer()))
            values.align = 8
            sums[c] = builder.fadd(sums[c], builder.fmul(vector, values))
    return [builder.extract_element(total, lane) for total in sums for lane in lanes]


def emit_flow_sum(builder: Any, table: Any, first: Any, later: Any, stride: Any, *weights: Any) -> list[Any]:
    """Write :func:`sum_flow_rows`; arguments and results are llvmlite values."""
    rows = []
    groups, along = weights[:_GROUPS], weights[_GROUPS:]
    for j, v in enumerate(groups):
        start, k = (first, j) if j < 3 else (later, j - 3)
        row = builder.add(start, builder.mul(stride, ir.Constant(_WORD, k)))
        for i, w in enumerate(along):
            rows.append((builder.add(row, ir.Constant(_WORD, FLOW_COLUMNS * i)), builder.fmul(v, w)))
    return emit_row_sum(builder, table, rows, FLOW_COLUMNS)


def emit_rate_sum(builder: Any, table: Any, first: Any, *weights: Any) -> list[Any]:
    """Write :func:`sum_rate_rows`; arguments and results are llvmlite values."""
    rows = [(builder.add(first, ir.Constant(_WORD, RATE_COLUMNS * i)), w) for i, w in enumerate(weights)]
    return emit_row_sum(builder, table, rows, RATE_COLUMNS)


def _make_intrinsic(columns: int, arguments: str, emit: Any) -> Any:
    """Return the form for arrays; ``arguments`` has an i for each integer and an f for each number."""
    kinds = [_types.int64 if a == "i" else _types.float64 for a in arguments]

    def typed(table: Any) -> tuple[Any, Any]:
        made = _types.UniTuple(_types.float64, columns)(table, *kinds)

        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            data = context.make_array(table)(context, builder, given[0]).data
            numbers = emit(builder, data, *given[1:])
            return context.make_tuple(builder, signature.return_type, numbers)

        return made, generate

    return typed


_flow_form = _make_intrinsic(FLOW_COLUMNS, "iiiffffffff", emit_flow_sum)
_rate_form = _make_intrinsic(RATE_COLUMNS, "ifff", emit_rate_sum)


@_intrinsic
def _sum_flow(context, table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    return _flow_form(table)


@_intrinsic
def _sum_rates(context, table, first, ea, eb, ec):
    return _rate_form(table)


# Numba compares the names of the arguments, and takes an annotation for a part of the name.
@_overload(sum_flow_rows)
def _choose_flow_form(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    def in_vectors(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
        return _sum_flow(table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec)

    return in_vectors


@_overload(sum_rate_rows)
def _choose_rate_form(table, first, ea, eb, ec):
    def in_vectors(table, first, ea, eb, ec):
        return _sum_rates(table, first, ea, eb, ec)

    return in_vectors
