"""Calls of C functions by address from compiled code, and arrays without reference counting.

Numba calls C functions by their types. Here only the address is known, and all arguments are pointers or 64-bit
integers. A compiled loop can therefore call libraries that are built or loaded later.
"""

# mypy: disable-error-code="no-untyped-call"
# Numba's interface for new types has no annotations.

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer, infer_getattr, signature
from numba.extending import (
    intrinsic,
    lower_builtin,
    lower_getattr_generic,
    models,
    register_model,
)


def _call_c_function(context: Any, address: Any, arguments: Any) -> Any:
    """Call the C function at an address with pointers as arguments; return the lowest byte of its result."""
    count = len(arguments)

    def generate_call(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(8), [word] * count)
        pointers = [builder.extract_value(given[1], k) for k in range(count)]
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), pointers)

    return types.int8(address, arguments), generate_call


call_c_function: Any = intrinsic(_call_c_function)
"""``call_c_function(address, (argument, ...))``, arguments of type int64."""


def _drop_reference_count(ctx: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = ctx.make_array(kind)(ctx, builder, value)
        array.meminfo = ir.Constant(array.meminfo.type, None)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        for k, part in enumerate(tuple(kind)):  # type: ignore[var-annotated, arg-type]
            inside = _drop_reference_count(ctx, builder, part, builder.extract_value(value, k))
            value = builder.insert_value(value, inside, k)
    return value


def _borrow_arrays(context: Any, what: Any) -> Any:
    def generate_borrow(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        return _drop_reference_count(ctx, builder, what, given[0])

    return what(what), generate_borrow


borrow_arrays: Any = intrinsic(_borrow_arrays)
"""``borrow_arrays(array)``: the same array, or tuple of arrays and tuples, without reference counting.

Numba updates the reference count of an array atomically whenever it is passed on, which can dominate the time of a
loop. The result is valid only while another reference exists: arrays passed by the caller, or rows of an array that is
used later.
"""


class TupleReference(types.Type):
    """Numba type of a tuple that compiled code reads by its address; a member is loaded only where it is used.

    Passed by value, a tuple of sixty arrays is some 400 numbers, which every use copies.
    """

    def __init__(self, of: Any) -> None:
        self.of = of
        super().__init__(name=f"TupleReference({of})")

    def member_type(self, index: int) -> Any:
        """Return the type of a member: nested named tuples are read by address too."""
        of = self.of[index]
        return TupleReference(of) if isinstance(of, types.BaseNamedTuple) else of


@register_model(TupleReference)
class _TupleReferenceModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: TupleReference) -> None:
        super().__init__(manager, kind, manager.lookup(kind.of).get_value_type().as_pointer())


def _load_member(builder: Any, kind: TupleReference, address: Any, index: int) -> Any:
    member = cgutils.gep_inbounds(builder, address, 0, index)
    return member if isinstance(kind.member_type(index), TupleReference) else builder.load(member)


@infer_getattr
class _TypeTupleReferenceAttribute(AttributeTemplate):
    key = TupleReference

    def generic_resolve(self, kind: TupleReference, name: str) -> Any:  # type: ignore[override]
        fields = getattr(kind.of, "fields", ())
        return kind.member_type(fields.index(name)) if name in fields else None


@lower_getattr_generic(TupleReference)
def _load_field(ctx: Any, builder: Any, kind: TupleReference, value: Any, name: str) -> Any:
    return _load_member(builder, kind, value, kind.of.fields.index(name))


@infer
class _TupleReferenceItems(AbstractTemplate):
    key = "static_getitem"

    def generic(self, given: Any, keywords: Any) -> Any:
        kind, index = given
        if isinstance(kind, TupleReference) and isinstance(index, int):
            return signature(kind.member_type(index), *given)
        return None


@lower_builtin("static_getitem", TupleReference, types.IntegerLiteral)
def _load_item(ctx: Any, builder: Any, what: Any, given: Any) -> Any:
    value, index = given
    return _load_member(builder, what.args[0], value, index)


def _reference_to_tuple(context: Any, what: Any) -> Any:
    kind = TupleReference(what)

    def generate_reference(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = _drop_reference_count(ctx, builder, what, given[0])
        return cgutils.alloca_once_value(builder, value)

    return kind(what), generate_reference


refer_to: Any = intrinsic(_reference_to_tuple)
"""``refer_to(tuple)``: a :class:`TupleReference` to a tuple of arrays and tuples, without reference counting.

The reference ends with the function that makes it. See :data:`borrow_arrays` for the lifetime of the arrays.
"""


def _store_tuple(context: Any, what: Any, address: Any) -> Any:
    def generate_store(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        value = _drop_reference_count(ctx, builder, what, given[0])
        builder.store(value, builder.inttoptr(given[1], value.type.as_pointer()))
        return ctx.get_dummy_value()

    return types.void(what, address), generate_store


store_tuple: Any = intrinsic(_store_tuple)
"""``store_tuple(tuple, address)``: write a tuple of arrays, records and tuples to a memory address (int64).

:data:`tuple_size` tells the room it takes. Only addresses of the arrays are stored: the caller keeps the arrays.
"""


def _tuple_size(context: Any, what: Any) -> Any:
    def generate_size(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        return ctx.get_constant(types.int64, ctx.get_abi_sizeof(ctx.get_value_type(what)))

    return types.int64(what), generate_size


tuple_size: Any = intrinsic(_tuple_size)
"""``tuple_size(tuple)``: bytes that :data:`store_tuple` writes."""


def _reference_at_address(context: Any, address: Any, like: Any) -> Any:
    kind = TupleReference(like)

    def generate_address(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.inttoptr(given[0], ctx.get_value_type(kind))

    return kind(address, like), generate_address


refer_at: Any = intrinsic(_reference_at_address)
"""``refer_at(address, like)``: a :class:`TupleReference` to a tuple of the type of ``like`` that was stored there."""
