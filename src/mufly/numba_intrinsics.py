"""Calls of C functions by address from compiled code.

Numba calls C functions by their types. Here only the address is known, and all arguments are pointers or 64-bit
integers. A compiled loop can therefore call libraries that are built or loaded later.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _call_c_function(context: Any, address: Any, arguments: Any) -> Any:
    """Call the C function at an address with pointers; return the lowest byte of its result."""
    count = len(arguments)

    def generate_call(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(8), [word] * count)
        pointers = [builder.extract_value(given[1], k) for k in range(count)]
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), pointers)

    return types.int8(address, arguments), generate_call


call_c_function: Any = intrinsic(_call_c_function)
"""``call_c_function(address, (argument, ...))``, arguments of type int64."""


def _borrow_arrays(context: Any, what: Any) -> Any:
    def drop_reference_count(ctx: Any, builder: Any, kind: Any, value: Any) -> Any:
        if isinstance(kind, types.Array):
            array = ctx.make_array(kind)(ctx, builder, value)
            array.meminfo = ir.Constant(array.meminfo.type, None)
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            for k, part in enumerate(tuple(kind)):  # type: ignore[var-annotated, arg-type]
                inside = drop_reference_count(ctx, builder, part, builder.extract_value(value, k))
                value = builder.insert_value(value, inside, k)
        return value

    def generate_borrow(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        return drop_reference_count(ctx, builder, what, given[0])

    return what(what), generate_borrow


borrow_arrays: Any = intrinsic(_borrow_arrays)
"""``borrow_arrays(array)``: the same array, or tuple of arrays and tuples, without reference counting.

Numba updates the reference count of an array atomically whenever it is passed on, which can dominate the time of a
loop. The result is valid only while another reference exists: arrays passed by the caller, or rows of an array that is
used later.
"""
