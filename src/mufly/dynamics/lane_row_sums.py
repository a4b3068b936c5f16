"""Weighted sums of rows of a table (:mod:`mufly.rotor.forward.row_sums`) for eight vehicles in lanes.

Each vehicle reads rows of its own table. Rows are summed in vector registers, vehicle by vehicle, and the sums are then
distributed to the lanes. This needs a quarter of the memory loads of a gather of each number.
"""

# mypy: disable-error-code="no-untyped-def"
# Numba's interface for typed functions has no annotations.

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir
from numba import types

from mufly.dynamics.numba_lanes import LANE_VECTOR_TYPE, LANES, intrinsic
from mufly.rotor.forward.row_sums import (
    FLOW_COLUMN_COUNT,
    RATE_COLUMN_COUNT,
    emit_flow_sum,
    emit_rate_sum,
    emit_repeated_number,
    emit_vector_selection,
)

_types: Any = types
_LLVM_DOUBLE, _LLVM_INT64 = ir.DoubleType(), ir.IntType(64)
_LLVM_DOUBLE_LANES, _LLVM_INT64_LANES = ir.VectorType(_LLVM_DOUBLE, LANES), ir.VectorType(_LLVM_INT64, LANES)
_LLVM_INT32_LANES = ir.VectorType(ir.IntType(32), LANES)


def _lane_sum_code(
    table: Any, places: tuple[Any, ...], weights: int, columns: int, emit: Callable[..., list[Any]]
) -> Any:
    """Return Numba's type and code of a weighted sum of table rows for eight vehicles.

    Weights are lanes (vectors of eight); indices are lanes, or integers common to all vehicles.
    """
    kinds = [_types.int64 if isinstance(k, types.Integer) else LANE_VECTOR_TYPE for k in places] + [
        LANE_VECTOR_TYPE
    ] * weights
    made = _types.UniTuple(LANE_VECTOR_TYPE, columns)(table, *kinds)

    def generate_lane_code(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        indices = [_emit_integer_indices(builder, v) for v in given[1 : 1 + len(places)]]
        weights, quartets = given[1 + len(places) :], []
        for lane in range(LANES):

            def broadcast_to_lanes(k: int, count: int, lane: int = lane) -> Any:
                return emit_repeated_number(builder, weights[k], count, lane)

            k = ir.Constant(ir.IntType(32), lane)
            pointer = builder.inttoptr(builder.extract_element(given[0], k), _LLVM_DOUBLE.as_pointer())
            own = [v if v.type == _LLVM_INT64 else builder.extract_element(v, k) for v in indices]
            quartets.append(emit(builder, pointer, own, broadcast_to_lanes, LANES))
        numbers = [n for of_lanes in zip(*quartets, strict=True) for n in _emit_lane_transpose(builder, of_lanes)]
        return context.make_tuple(builder, signature.return_type, numbers)

    return made, generate_lane_code


def _emit_lane_transpose(builder: Any, quartets: Sequence[Any]) -> list[Any]:
    """Transpose eight vectors of four numbers, one vector for each lane, to four vectors of eight lanes."""
    pairs = [emit_vector_selection(builder, quartets[k], range(8), quartets[k + 2]) for k in (0, 1, 4, 5)]
    out = []
    for column in range(4):
        near, far = (
            emit_vector_selection(builder, a, (column, 8 + column, 4 + column, 12 + column), b)
            for a, b in (pairs[:2], pairs[2:])
        )
        out.append(emit_vector_selection(builder, near, range(8), far))
    return out


def _emit_integer_indices(builder: Any, place: Any) -> Any:
    """Return table indices as integers; NaN (a vehicle whose state has diverged) becomes 0."""
    if place.type == _LLVM_INT64:
        return place
    none = ir.Constant(_LLVM_DOUBLE_LANES, [0.0] * LANES)
    inside = builder.select(builder.fcmp_ordered(">=", place, none), place, none)
    return builder.sext(builder.fptosi(inside, _LLVM_INT32_LANES), _LLVM_INT64_LANES)


@intrinsic
def sum_flow_lanes(context, table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    """Return the sums of :func:`mufly.rotor.forward.row_sums.sum_flow_rows` for eight vehicles at once."""
    return _lane_sum_code(table, (first, later, stride), 8, FLOW_COLUMN_COUNT, emit_flow_sum)


@intrinsic
def sum_rate_lanes(context, table, first, ea, eb, ec):
    """Return the sums of :func:`mufly.rotor.forward.row_sums.sum_rate_rows` for eight vehicles at once."""
    return _lane_sum_code(table, (first,), 3, RATE_COLUMN_COUNT, emit_rate_sum)


LANE_ROW_SUMS: dict[str, Any] = {"sum_flow_rows": sum_flow_lanes, "sum_rate_rows": sum_rate_lanes}
"""Functions for single vehicles by name, and their counterparts for lanes."""
