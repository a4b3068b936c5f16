"""Numba type of eight numbers (lanes), one for each of eight vehicles.

Compiled source that works on numbers also works on lanes: each operation acts on eight numbers in vector registers and
rounds as it does on one. A comparison gives a mask. A decision on a mask is a selection
(:mod:`mufly.dynamics.branch_selection`), so that a lane never depends on its neighbours.

============== =====================================================================================
LaneVector     eight numbers
LaneMask       eight truth values
LaneRows       rows of eight numbers: a state or a derivative of eight vehicles
LaneTable      a table of each vehicle; an index is one number, or eight
LaneRecord     a NumPy record of each vehicle; its integers are those of the first
============== =====================================================================================

Whole numbers from :func:`int` of lanes are lanes, too, exact up to 2^53. Sine and cosine are those of
:mod:`mufly.compiled.portable_math`, by the same operations.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core import cgutils
from numba.core.typing import templates

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import HALF_PI_PARTS, MAX_ANGLE_RAD, TWO_OVER_PI

# Numba declares types for a part of its functions only.
_numba_types: Any = types
_get_function: Any = cgutils.get_or_insert_function
infer_getattr: Any = templates.infer_getattr
infer_global: Any = templates.infer_global
signature: Any = templates.signature
intrinsic: Any = extending.intrinsic
lower_builtin: Any = extending.lower_builtin
lower_cast: Any = extending.lower_cast
lower_getattr_generic: Any = extending.lower_getattr_generic
register_model: Any = extending.register_model
AbstractTemplate: Any = templates.AbstractTemplate
AttributeTemplate: Any = templates.AttributeTemplate
PrimitiveModel: Any = extending.models.PrimitiveModel

LANES = 8
"""Vehicles in a block."""

_LLVM_DOUBLE, _LLVM_INT64, _LLVM_BIT, _LLVM_INT32 = ir.DoubleType(), ir.IntType(64), ir.IntType(1), ir.IntType(32)
_LLVM_DOUBLE_LANES, _LLVM_BIT_LANES, _LLVM_INT64_LANES = (
    ir.VectorType(kind, LANES) for kind in (_LLVM_DOUBLE, _LLVM_BIT, _LLVM_INT64)
)
_LLVM_POINTER = ir.IntType(8).as_pointer()
_ALIGNMENT_BYTES = 64


class LaneVector(types.Type):
    """Numba type of eight numbers, one for each vehicle of a block."""

    def __init__(self) -> None:
        super().__init__(name="LaneVector")

    def unify(self, typingctx: Any, other: Any) -> Any:
        return self if isinstance(other, types.Float | types.Integer) else None


class LaneMask(types.Type):
    """Numba type of eight truth values, one for each vehicle of a block."""

    def __init__(self) -> None:
        super().__init__(name="LaneMask")


class LaneRows(types.Type):
    """Numba type of an array (rows, 8) in memory, such as a state of eight vehicles: one row per state variable."""

    def __init__(self) -> None:
        super().__init__(name="LaneRows")


class LaneTable(types.Type):
    """Numba type of eight arrays (length, columns), one for each vehicle of a block, such as its contact points."""

    def __init__(self, length: int, columns: int) -> None:
        self.length, self.columns = length, columns
        super().__init__(name=f"LaneTable({length}, {columns})")


class SharedIntegers(types.Type):
    """Numba type of integers that all vehicles of a block share."""

    def __init__(self) -> None:
        super().__init__(name="SharedIntegers")


class LaneRecord(types.Type):
    """Numba type of a NumPy record for each vehicle of a block: a row of addresses, then a row for each number."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self.dtype = dtype
        fields = {name: dtype.fields[name] for name in dtype.names or ()} if dtype.fields else {}
        self.numbers = [n for n, (kind, _, *_) in fields.items() if kind.shape == () and kind.kind == "f"]
        self.row_count = 1 + len(self.numbers)
        super().__init__(name=f"LaneRecord({hash(str(dtype)) & 0xFFFFFFFF:x})")

    def __reduce__(self) -> tuple[Any, ...]:
        return LaneRecord, (self.dtype,)


LANE_VECTOR_TYPE, LANE_MASK_TYPE, LANE_ROWS_TYPE, SHARED_INTEGERS_TYPE = (
    LaneVector(),
    LaneMask(),
    LaneRows(),
    SharedIntegers(),
)


def _register_primitive(kind: type, make: Callable[[Any], ir.Type]) -> None:
    class LaneDataModel(PrimitiveModel):
        def __init__(self, manager: Any, fe_type: Any) -> None:
            super().__init__(manager, fe_type, make(fe_type))

    register_model(kind)(LaneDataModel)


for _kind, _ir_type in (
    (LaneVector, _LLVM_DOUBLE_LANES), (LaneMask, _LLVM_BIT_LANES), (LaneRows, _LLVM_POINTER),
    (LaneTable, _LLVM_INT64_LANES), (SharedIntegers, _LLVM_POINTER), (LaneRecord, _LLVM_POINTER),
):  # fmt: skip
    _register_primitive(_kind, lambda _, made=_ir_type: made)  # type: ignore[misc]


def _constant_index(k: int) -> ir.Constant:
    return ir.Constant(_LLVM_INT32, k)


def _emit_lane_broadcast(builder: Any, value: Any, vector: ir.VectorType = _LLVM_DOUBLE_LANES) -> Any:
    empty = ir.Constant(vector, ir.Undefined)
    return builder.shuffle_vector(
        builder.insert_element(empty, value, _constant_index(0)), empty,
        ir.Constant(ir.VectorType(_LLVM_INT32, LANES), [0] * LANES),
    )  # fmt: skip


@lower_cast(types.Float, LaneVector)
@lower_cast(types.Integer, LaneVector)
@lower_cast(types.IntegerLiteral, LaneVector)
def _lower_number_to_lanes(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    return _emit_lane_broadcast(builder, context.cast(builder, value, _numba_types.unliteral(source), types.float64))


def _is_number(kind: Any) -> bool:
    return isinstance(kind, LaneVector | types.Float | types.Integer | types.IntegerLiteral)


def _declare_lane_overload(function: Any, count: int, result: Any) -> None:
    """Declare a function of ``count`` numbers to Numba for calls in which at least one argument is a lane vector."""

    class LaneOverloadTemplate(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            if len(arguments) == count and any(isinstance(a, LaneVector) for a in arguments):
                return signature(result, *[LANE_VECTOR_TYPE] * count) if all(map(_is_number, arguments)) else None
            return None

    infer_global(function)(LaneOverloadTemplate)


def _register_operation(
    functions: Iterable[Any], count: int, emit: Callable[..., Any], result: Any = LANE_VECTOR_TYPE
) -> None:
    """Register Python functions of ``count`` numbers with Numba for lane vectors; ``emit`` writes their LLVM code."""
    for function in functions:
        _declare_lane_overload(function, count, result)

        def lower_to_llvm(context: Any, builder: Any, made: Any, values: Any, emit: Any = emit) -> Any:
            return emit(builder, *values)

        lower_builtin(function, *[LaneVector] * count)(lower_to_llvm)


def _make_intrinsic_emitter(name: str) -> Callable[..., Any]:
    def emit_intrinsic_call(builder: Any, x: Any) -> Any:
        kind = ir.FunctionType(_LLVM_DOUBLE_LANES, [_LLVM_DOUBLE_LANES])
        return builder.call(_get_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), [x])

    return emit_intrinsic_call


_register_operation([operator.add, operator.iadd], 2, lambda b, x, y: b.fadd(x, y))
_register_operation([operator.sub, operator.isub], 2, lambda b, x, y: b.fsub(x, y))
_register_operation([operator.mul, operator.imul], 2, lambda b, x, y: b.fmul(x, y))
_register_operation([operator.truediv, operator.itruediv], 2, lambda b, x, y: b.fdiv(x, y))
for _function, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _register_operation([_function], 2, lambda b, x, y, sign=_sign: b.fcmp_ordered(sign, x, y), LANE_MASK_TYPE)
_register_operation([operator.ne], 2, lambda b, x, y: b.fcmp_unordered("!=", x, y), LANE_MASK_TYPE)
# As Numba's min and max of two numbers, which keep the first if they are equal.
_register_operation([min], 2, lambda b, x, y: b.select(b.fcmp_ordered("<", y, x), y, x))
_register_operation([max], 2, lambda b, x, y: b.select(b.fcmp_ordered(">", y, x), y, x))
_register_operation([operator.neg], 1, lambda b, x: b.fneg(x))
_register_operation([abs], 1, _make_intrinsic_emitter("fabs"))
_register_operation([math.sqrt], 1, _make_intrinsic_emitter("sqrt"))
_register_operation([int], 1, _make_intrinsic_emitter("trunc"))
_register_operation([math.floor], 1, _make_intrinsic_emitter("floor"))


# ----------------------------------------------------------------------------
# Decisions: the names that mufly.dynamics.branch_selection writes.


def select(test: Any, a: Any, b: Any) -> Any:
    """Return ``a`` where ``test`` is true, else ``b``."""
    raise NotImplementedError


def any_of(test: Any) -> Any:
    """Return True if a test holds for any vehicle of the block."""
    raise NotImplementedError


def both_of(a: Any, b: Any) -> Any:
    """Return ``a and b``."""
    raise NotImplementedError


def negate(test: Any) -> Any:
    """Return ``not test``."""
    raise NotImplementedError


def require_uniform(test: Any) -> Any:
    """Return ``test``, which must have the same result for all vehicles of a block, as one bool for ``if``."""
    raise NotImplementedError


def whole_number(x: Any) -> Any:
    """Stand for ``np.uint64`` in source rewritten for lanes; ``x`` stays unchanged.

    :mod:`mufly.dynamics.branch_selection` rewrites the source.
    """
    raise NotImplementedError


def _declare_lane_decision(function: Any, make: Callable[..., Any]) -> None:
    class LaneDecisionTemplate(AbstractTemplate):
        def generic(self, arguments: Any, keywords: Any) -> Any:
            return make(*arguments)

    infer_global(function)(LaneDecisionTemplate)


def _select_signature(test: Any, a: Any, b: Any) -> Any:
    if not isinstance(test, LaneMask | types.Boolean):
        return None
    if isinstance(a, LaneVector) or isinstance(b, LaneVector) or isinstance(test, LaneMask):
        return signature(LANE_VECTOR_TYPE, test, LANE_VECTOR_TYPE, LANE_VECTOR_TYPE)
    return signature(types.float64, test, types.float64, types.float64)


def _mask_or_boolean_signature(result_of_mask: Any) -> Callable[..., Any]:
    def find_decision_signature(*tests: Any) -> Any:
        if all(isinstance(t, LaneMask | types.Boolean) for t in tests):
            is_mask = any(isinstance(t, LaneMask) for t in tests)
            return signature(result_of_mask if is_mask else types.boolean, *tests)
        return None

    return find_decision_signature


_declare_lane_decision(select, _select_signature)
_declare_lane_decision(any_of, _mask_or_boolean_signature(types.boolean))
_declare_lane_decision(require_uniform, _mask_or_boolean_signature(types.boolean))
_declare_lane_decision(negate, _mask_or_boolean_signature(LANE_MASK_TYPE))
_declare_lane_decision(both_of, _mask_or_boolean_signature(LANE_MASK_TYPE))
_declare_lane_decision(whole_number, lambda x: signature(x, x) if _is_number(x) else None)


@lower_builtin(select, types.Any, types.Any, types.Any)
def _lower_select(context: Any, builder: Any, made: Any, values: Any) -> Any:
    test = values[0]
    if isinstance(made.args[0], types.Boolean):
        test = context.cast(builder, test, made.args[0], types.boolean)
        test = builder.trunc(test, _LLVM_BIT) if test.type != _LLVM_BIT else test
    return builder.select(test, values[1], values[2])


@lower_builtin(any_of, types.Any)
def _lower_any_of(context: Any, builder: Any, made: Any, values: Any) -> Any:
    if not isinstance(made.args[0], LaneMask):
        return values[0]
    bits = builder.bitcast(values[0], ir.IntType(LANES))
    return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(LANES), 0))


@lower_builtin(require_uniform, types.Any)
def _lower_require_uniform(context: Any, builder: Any, made: Any, values: Any) -> Any:
    if not isinstance(made.args[0], LaneMask):
        return values[0]
    return builder.extract_element(values[0], _constant_index(0))


@lower_builtin(negate, types.Any)
def _lower_negate(context: Any, builder: Any, made: Any, values: Any) -> Any:
    return builder.not_(values[0])


@lower_builtin(both_of, types.Any, types.Any)
def _lower_both_of(context: Any, builder: Any, made: Any, values: Any) -> Any:
    a, b = (
        v
        if isinstance(kind, LaneMask) or not isinstance(made.return_type, LaneMask)
        else _emit_lane_broadcast(builder, v, _LLVM_BIT_LANES)
        for v, kind in zip(values, made.args, strict=True)
    )
    return builder.and_(a, b)


@lower_builtin(whole_number, types.Any)
def _lower_whole_number(context: Any, builder: Any, made: Any, values: Any) -> Any:
    return values[0]


# ----------------------------------------------------------------------------
# Memory: rows, tables and records.


def _emit_row_pointer(builder: Any, base: Any, row: Any, kind: Any = _LLVM_DOUBLE_LANES) -> Any:
    return builder.gep(builder.bitcast(base, kind.as_pointer()), [row])


def _emit_load_row(builder: Any, base: Any, row: Any, kind: Any = _LLVM_DOUBLE_LANES) -> Any:
    value = builder.load(_emit_row_pointer(builder, base, row, kind))
    value.align = _ALIGNMENT_BYTES
    return value


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        held, index = arguments
        if isinstance(held, LaneRows) and isinstance(index, types.Integer):
            return signature(LANE_VECTOR_TYPE, held, types.intp)
        if isinstance(held, SharedIntegers) and isinstance(index, types.Integer):
            return signature(types.int64, held, types.intp)
        if isinstance(held, LaneTable):
            if isinstance(index, types.Integer):
                return signature(LANE_VECTOR_TYPE, held, types.intp)
            if isinstance(index, LaneVector):
                return signature(LANE_VECTOR_TYPE, held, LANE_VECTOR_TYPE)
            if isinstance(index, types.BaseTuple) and len(index) == 2:
                return signature(LANE_VECTOR_TYPE, held, _numba_types.UniTuple(types.intp, 2))
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, arguments: Any, keywords: Any) -> Any:
        held, index, value = arguments
        if isinstance(held, LaneRows) and isinstance(index, types.Integer) and _is_number(value):
            return signature(types.none, held, types.intp, LANE_VECTOR_TYPE)
        return None


@lower_builtin(operator.getitem, LaneRows, types.Integer)
def _lower_get_lane_row(context: Any, builder: Any, made: Any, values: Any) -> Any:
    return _emit_load_row(builder, *values)


@lower_builtin(operator.setitem, LaneRows, types.Integer, LaneVector)
def _lower_set_lane_row(context: Any, builder: Any, made: Any, values: Any) -> Any:
    stored = builder.store(values[2], _emit_row_pointer(builder, values[0], values[1]))
    stored.align = _ALIGNMENT_BYTES
    return context.get_dummy_value()


@lower_builtin(operator.getitem, SharedIntegers, types.Integer)
def _lower_get_shared_integer(context: Any, builder: Any, made: Any, values: Any) -> Any:
    return builder.load(builder.gep(builder.bitcast(values[0], _LLVM_INT64.as_pointer()), [values[1]]))


def _emit_gather_from_addresses(builder: Any, addresses: Any, offset: Any) -> Any:
    """Load one double from each of eight addresses; ``offset`` holds eight distances, counted in doubles."""
    where = builder.add(addresses, builder.shl(offset, ir.Constant(_LLVM_INT64_LANES, [3] * LANES)))
    out = ir.Constant(_LLVM_DOUBLE_LANES, ir.Undefined)
    for k in range(LANES):
        at = builder.inttoptr(builder.extract_element(where, _constant_index(k)), _LLVM_DOUBLE.as_pointer())
        out = builder.insert_element(out, builder.load(at), _constant_index(k))
    return out


@lower_builtin(operator.getitem, LaneTable, LaneVector)
def _lower_get_table_entries(context: Any, builder: Any, made: Any, values: Any) -> Any:
    # An index that is not a number, of a vehicle that has left the model, reads the first entry.
    first, last = (ir.Constant(_LLVM_DOUBLE_LANES, [float(k)] * LANES) for k in (0, made.args[0].length - 1))
    inside = builder.select(builder.fcmp_ordered(">=", values[1], first), values[1], first)
    inside = builder.select(builder.fcmp_ordered("<=", inside, last), inside, last)
    index = builder.sext(builder.fptosi(inside, ir.VectorType(_LLVM_INT32, LANES)), _LLVM_INT64_LANES)
    return _emit_gather_from_addresses(builder, values[0], index)


@lower_builtin(operator.getitem, LaneTable, types.Integer)
def _lower_get_table_entry(context: Any, builder: Any, made: Any, values: Any) -> Any:
    return _emit_gather_from_addresses(builder, values[0], _emit_lane_broadcast(builder, values[1], _LLVM_INT64_LANES))


@lower_builtin(operator.getitem, LaneTable, types.UniTuple)
def _lower_get_table_entry_of_row(context: Any, builder: Any, made: Any, values: Any) -> Any:
    row, column = (builder.extract_value(values[1], k) for k in range(2))
    index = builder.add(builder.mul(row, ir.Constant(_LLVM_INT64, made.args[0].columns)), column)
    return _emit_gather_from_addresses(builder, values[0], _emit_lane_broadcast(builder, index, _LLVM_INT64_LANES))


@infer_getattr
class _TableAttributes(AttributeTemplate):
    key = LaneTable

    def resolve_shape(self, table: Any) -> Any:
        return _numba_types.UniTuple(types.int64, 1)


@lower_getattr_generic(LaneTable)
def _lower_get_shape(context: Any, builder: Any, table: Any, value: Any, name: str) -> Any:
    return ir.Constant(ir.ArrayType(_LLVM_INT64, 1), [ir.Constant(_LLVM_INT64, table.length)])


@infer_getattr
class _RecordAttributes(AttributeTemplate):
    key = LaneRecord

    def generic_resolve(self, record: Any, name: str) -> Any:
        if name not in record.dtype.fields:
            return None
        kind = record.dtype.fields[name][0]
        if kind.shape == ():
            return LANE_VECTOR_TYPE if kind.kind == "f" else types.int64
        if kind.base.kind != "f":
            return SHARED_INTEGERS_TYPE
        return LaneTable(kind.shape[0], kind.shape[1] if len(kind.shape) > 1 else 1)


@lower_getattr_generic(LaneRecord)
def _lower_get_record_field(context: Any, builder: Any, record: Any, value: Any, name: str) -> Any:
    kind, offset = record.dtype.fields[name][:2]
    if name in record.numbers:
        return _emit_load_row(builder, value, ir.Constant(_LLVM_INT64, 1 + record.numbers.index(name)))
    addresses = _emit_load_row(builder, value, ir.Constant(_LLVM_INT64, 0), _LLVM_INT64_LANES)
    if kind.base.kind == "f":
        return builder.add(addresses, ir.Constant(_LLVM_INT64_LANES, [offset] * LANES))
    first = builder.add(builder.extract_element(addresses, _constant_index(0)), ir.Constant(_LLVM_INT64, offset))
    if kind.shape == ():
        return builder.load(builder.inttoptr(first, _LLVM_INT64.as_pointer()))
    return builder.inttoptr(first, _LLVM_POINTER)


def _emit_row_allocation(builder: Any, rows: int) -> Any:
    with builder.goto_entry_block():
        memory = builder.alloca(_LLVM_DOUBLE_LANES, ir.Constant(_LLVM_INT32, rows))
        memory.align = _ALIGNMENT_BYTES
    return builder.bitcast(memory, _LLVM_POINTER)


@intrinsic(prefer_literal=True)
def make_rows(context: Any, count: Any) -> Any:
    """``make_rows(21)``: allocate 21 rows of eight numbers on the stack; the number of rows is a compile-time
    constant.
    """

    def emit_rows(ctx: Any, builder: Any, made: Any, values: Any) -> Any:
        return _emit_row_allocation(builder, count.literal_value)

    return LANE_ROWS_TYPE(count), emit_rows


@intrinsic
def put_number(context: Any, rows: Any, row: Any, lane: Any, value: Any) -> Any:
    """``put_number(rows, row, lane, value)``: write one vehicle's number into a row."""

    def emit_number_store(ctx: Any, builder: Any, made: Any, values: Any) -> Any:
        into, which, number, stored = values
        base = builder.bitcast(into, _LLVM_DOUBLE.as_pointer())
        at = builder.add(builder.mul(which, ir.Constant(_LLVM_INT64, LANES)), number)
        builder.store(stored, builder.gep(base, [at]))
        return ctx.get_dummy_value()

    return types.none(LANE_ROWS_TYPE, types.intp, types.intp, types.float64), emit_number_store


@intrinsic
def take_number(context: Any, rows: Any, row: Any, lane: Any) -> Any:
    """``take_number(rows, row, lane)``: read one vehicle's number."""

    def emit_number_load(ctx: Any, builder: Any, made: Any, values: Any) -> Any:
        base = builder.bitcast(values[0], _LLVM_DOUBLE.as_pointer())
        at = builder.add(builder.mul(values[1], ir.Constant(_LLVM_INT64, LANES)), values[2])
        return builder.load(builder.gep(base, [at]))

    return types.float64(LANE_ROWS_TYPE, types.intp, types.intp), emit_number_load


@intrinsic
def allocate_lane_record(context: Any, like: Any) -> Any:
    """``allocate_lane_record(array)``: allocate empty records of eight vehicles, with the fields of a structured
    array.
    """
    from numba.np.numpy_support import as_dtype

    record = LaneRecord(as_dtype(like.dtype))

    def emit_record_allocation(ctx: Any, builder: Any, made: Any, values: Any) -> Any:
        return _emit_row_allocation(builder, record.row_count)

    return record(like), emit_record_allocation


@intrinsic
def put_record(context: Any, record: Any, lane: Any, address: Any) -> Any:
    """``put_record(record, lane, address)``: copy one vehicle's record from an address into its lane."""

    def emit_record_copy(ctx: Any, builder: Any, made: Any, values: Any) -> Any:
        memory, lane_value, at = values
        words = builder.bitcast(memory, _LLVM_INT64.as_pointer())
        builder.store(at, builder.gep(words, [lane_value]))
        numbers = builder.bitcast(memory, _LLVM_DOUBLE.as_pointer())
        for k, name in enumerate(record.numbers):
            offset = record.dtype.fields[name][1]
            source = builder.inttoptr(builder.add(at, ir.Constant(_LLVM_INT64, offset)), _LLVM_DOUBLE.as_pointer())
            to = builder.add(ir.Constant(_LLVM_INT64, (1 + k) * LANES), lane_value)
            builder.store(builder.load(source), builder.gep(numbers, [to]))
        return ctx.get_dummy_value()

    return types.none(record, types.intp, types.intp), emit_record_copy


# ----------------------------------------------------------------------------
# Sine and cosine: the operations of mufly.compiled.portable_math.sine_cosine, with selections.

_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = HALF_PI_PARTS


@cached_njit(error_model="numpy")
def _lane_sine_cosine(x: Any) -> Any:
    known = abs(x) < MAX_ANGLE_RAD
    n = int(x * TWO_OVER_PI + select(x >= 0.0, x * 0.0 + 0.5, x * 0.0 - 0.5))
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    q = r * r
    s = -1.0 / 1307674368000.0 + q * (1.0 / 355687428096000.0)
    s = 1.0 / 6227020800.0 + q * s
    s = -1.0 / 39916800.0 + q * s
    s = 1.0 / 362880.0 + q * s
    s = -1.0 / 5040.0 + q * s
    s = 1.0 / 120.0 + q * s
    s = -1.0 / 6.0 + q * s
    s = r + r * (q * s)
    c = -1.0 / 87178291200.0 + q * (1.0 / 20922789888000.0)
    c = 1.0 / 479001600.0 + q * c
    c = -1.0 / 3628800.0 + q * c
    c = 1.0 / 40320.0 + q * c
    c = -1.0 / 720.0 + q * c
    c = 1.0 / 24.0 + q * c
    c = -0.5 + q * c
    c = 1.0 + q * c
    quadrant = n - 4.0 * math.floor(0.25 * n)
    odd = quadrant - 2.0 * math.floor(0.5 * quadrant) == 1.0
    sine, cosine = select(odd, c, s), select(odd, s, c)
    sine = select(quadrant >= 2.0, -sine, sine)
    cosine = select(quadrant * (3.0 - quadrant) > 1.0, -cosine, cosine)
    return select(known, sine, x * 0.0), select(known, cosine, x * 0.0 + 1.0)


@cached_njit(error_model="numpy")
def lane_sine(x: Any) -> Any:
    """Return the sine of eight angles (rad)."""
    return _lane_sine_cosine(x)[0]


@cached_njit(error_model="numpy")
def lane_cosine(x: Any) -> Any:
    """Return the cosine of eight angles (rad)."""
    return _lane_sine_cosine(x)[1]


LANE_NAMES: dict[str, Any] = {
    "select": select, "any_of": any_of, "both_of": both_of, "negate": negate, "require_uniform": require_uniform,
    "whole_number": whole_number, "sine_of": lane_sine, "cosine_of": lane_cosine,
}  # fmt: skip
"""Names that :func:`mufly.dynamics.branch_selection.replace_branches_by_selection` writes."""
