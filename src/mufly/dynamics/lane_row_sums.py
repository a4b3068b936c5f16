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

from mufly.dynamics.numba_lanes import LANES, VECTOR, intrinsic
from mufly.rotor.forward.row_sums import (
    FLOW_COLUMN_COUNT,
    RATE_COLUMN_COUNT,
    emit_flow_sum,
    emit_rate_sum,
    pick_numbers,
    spread_number,
)

_types: Any = types
_DOUBLE, _WORD = ir.DoubleType(), ir.IntType(64)
_VECTOR, _WORDS = ir.VectorType(_DOUBLE, LANES), ir.VectorType(_WORD, LANES)
_INDICES = ir.VectorType(ir.IntType(32), LANES)


def _lane_form(table: Any, places: tuple[Any, ...], weights: int, columns: int, emit: Callable[..., list[Any]]) -> Any:
    """Return Numba type and code of a sum; indices are lanes, or integers common to all vehicles; weights are lanes."""
    kinds = [_types.int64 if isinstance(k, types.Integer) else VECTOR for k in places] + [VECTOR] * weights
    made = _types.UniTuple(VECTOR, columns)(table, *kinds)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        indices = [_whole_places(builder, v) for v in given[1 : 1 + len(places)]]
        weights, quartets = given[1 + len(places) :], []
        for lane in range(LANES):

            def spread(k: int, count: int, lane: int = lane) -> Any:
                return spread_number(builder, weights[k], count, lane)

            k = ir.Constant(ir.IntType(32), lane)
            pointer = builder.inttoptr(builder.extract_element(given[0], k), _DOUBLE.as_pointer())
            own = [v if v.type == _WORD else builder.extract_element(v, k) for v in indices]
            quartets.append(emit(builder, pointer, own, spread, LANES))
        numbers = [n for of_lanes in zip(*quartets, strict=True) for n in _transpose(builder, of_lanes)]
        return context.make_tuple(builder, signature.return_type, numbers)

    return made, generate


def _transpose(builder: Any, quartets: Sequence[Any]) -> list[Any]:
    """Return four vectors of eight lanes from the eight lanes' vectors of four numbers."""
    pairs = [pick_numbers(builder, quartets[k], range(8), quartets[k + 2]) for k in (0, 1, 4, 5)]
    out = []
    for column in range(4):
        near, far = (
            pick_numbers(builder, a, (column, 8 + column, 4 + column, 12 + column), b)
            for a, b in (pairs[:2], pairs[2:])
        )
        out.append(pick_numbers(builder, near, range(8), far))
    return out


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
    return _lane_form(table, (first, later, stride), 8, FLOW_COLUMN_COUNT, emit_flow_sum)


@intrinsic
def sum_rate_lanes(context, table, first, ea, eb, ec):
    """:func:`mufly.rotor.forward.row_sums.sum_rate_rows` for lanes."""
    return _lane_form(table, (first,), 3, RATE_COLUMN_COUNT, emit_rate_sum)


LANE_ROW_SUMS: dict[str, Any] = {"sum_flow_rows": sum_flow_lanes, "sum_rate_rows": sum_rate_lanes}
"""Functions for single vehicles by name, and their counterparts for lanes."""
