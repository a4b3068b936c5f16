"""Weighted sums of rows of a table (:mod:`mufly.rotor.forward.row_sums`) for eight vehicles in lanes.

Each vehicle reads rows of its own table. Rows are summed in vector registers, vehicle by vehicle, and the sums are then
distributed to the lanes. This needs a quarter of the memory loads of a gather of each number.
"""

# mypy: disable-error-code="no-untyped-def"
# Numba's interface for typed functions has no annotations.

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types

from mufly.dynamics.numba_lanes import LANES, VECTOR, intrinsic
from mufly.rotor.forward.row_sums import FLOW_COLUMNS, RATE_COLUMNS, emit_flow_sum, emit_rate_sum

_types: Any = types
_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
_VECTOR, _WORDS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_WORD, LANES)
_INDICES = ir.VectorType(ir.IntType(32), LANES)


def _lane_form(table: Any, places: tuple[Any, ...], weights: int, columns: int, emit: Callable[..., list[Any]]) -> Any:
    """Return Numba type and code of a sum; indices are lanes, or integers common to all vehicles; weights are lanes."""
    kinds = [_types.int64 if isinstance(k, types.Integer) else VECTOR for k in places] + [VECTOR] * weights
    made = _types.UniTuple(VECTOR, columns)(table, *kinds)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        values = [_whole_places(builder, v) for v in given[1 : 1 + len(places)]] + list(given[1 + len(places) :])
        sums = [ir.Constant(_VECTOR, ir.Undefined)] * columns
        for lane in (ir.Constant(ir.IntType(32), k) for k in range(LANES)):
            pointer = builder.inttoptr(builder.extract_element(given[0], lane), _DOUBLE.as_pointer())
            own = [v if v.type == _WORD else builder.extract_element(v, lane) for v in values]
            for c, total in enumerate(emit(builder, pointer, *own)):
                sums[c] = builder.insert_element(sums[c], total, lane)
        return context.make_tuple(builder, signature.return_type, sums)

    return made, generate


def _whole_places(builder: Any, place: Any) -> Any:
    """Return table indices as integers; NaN (a vehicle whose state has diverged) becomes 0."""
    if place.type == _WORD:
        return place
    none = ir.Constant(_VECTOR, [0.0] * LANES)
    inside = builder.select(builder.fcmp_ordered(">=", place, none), place, none)
    return builder.sext(builder.fptosi(inside, _INDICES), _WORDS)


@intrinsic
def sum_flow_lanes(context, table, first, later, stride, ca, cb, cc, cd, ce, ea, eb, ec):
    """:func:`mufly.rotor.forward.row_sums.sum_flow_rows` for lanes."""
    return _lane_form(table, (first, later, stride), 8, FLOW_COLUMNS, emit_flow_sum)


@intrinsic
def sum_rate_lanes(context, table, first, ea, eb, ec):
    """:func:`mufly.rotor.forward.row_sums.sum_rate_rows` for lanes."""
    return _lane_form(table, (first,), 3, RATE_COLUMNS, emit_rate_sum)


LANE_ROW_SUMS: dict[str, Any] = {"sum_flow_rows": sum_flow_lanes, "sum_rate_rows": sum_rate_lanes}
"""Functions for single vehicles by name, and their counterparts for lanes."""
