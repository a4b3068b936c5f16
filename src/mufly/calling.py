"""C functions called from compiled code by their addresses.

Numba knows functions of C by their types; what is known here is an address and that all arguments are pointers or whole
numbers of 64 bits. So one compiled loop calls whichever library was built or loaded after it had been compiled.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _by_address(context: Any, address: Any, arguments: Any) -> Any:
    """Call the C function at an address with pointers; returns the lowest byte of what it returns."""
    count = len(arguments)

    def make(ctx: Any, builder: Any, signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(8), [word] * count)
        pointers = [builder.extract_value(given[1], k) for k in range(count)]
        return builder.call(builder.inttoptr(given[0], kind.as_pointer()), pointers)

    return types.int8(address, arguments), make


call_at: Any = intrinsic(_by_address)
"""``call_at(address, (argument, ...))``, arguments of type int64."""
