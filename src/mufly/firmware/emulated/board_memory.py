"""Compare two memories of a board field by field: every byte of a field counts, padding does not.

Two fields of floating-point type are also equal if both are NaN: processors make the bits of a NaN in
different ways, and no result depends on them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_Bytes = NDArray[np.uint8]


class MemoryLayout:
    """Layout of a C record: which of its bytes belong to fields.

    Parameters
    ----------
    ffi : cffi.FFI
        Declarations of the record.
    name : str
        Type of the record.
    """

    def __init__(self, ffi: Any, name: str) -> None:
        self._ffi, self._type = ffi, ffi.typeof(name)
        self.size = int(ffi.sizeof(name))
        self._used = np.zeros(self.size, dtype=bool)
        self._floats: dict[int, int] = {}  # width by offset
        self._mark_field_bytes(self._type, 0)

    def _mark_field_bytes(self, kind: Any, offset: int) -> None:
        if kind.kind == "struct":
            for _, field in kind.fields:
                self._mark_field_bytes(field.type, offset + field.offset)
        elif kind.kind == "array":
            width = self._ffi.sizeof(kind.item)
            for k in range(kind.length):
                self._mark_field_bytes(kind.item, offset + k * width)
        else:
            width = self._ffi.sizeof(kind)
            self._used[offset : offset + width] = True
            if kind.cname in ("float", "double"):
                self._floats[offset] = width

    def describe_first_difference(self, ours: _Bytes, theirs: _Bytes) -> str:
        """Return the name of the first field in which two memories differ, with both values; "" if all fields are
        equal.
        """
        if ours.tobytes() == theirs.tobytes():
            return ""
        for at in np.flatnonzero((ours != theirs) & self._used).tolist():
            name, start, kind = self._field_at(at)
            pair = [self._read_value(memory, start, kind) for memory in (ours, theirs)]
            if not (start in self._floats and pair[0] != pair[0] and pair[1] != pair[1]):
                return f"{name}: {pair[0]!r} and {pair[1]!r}"
        return ""

    def _read_value(self, memory: _Bytes, start: int, kind: Any) -> Any:
        part = memory[start : start + self._ffi.sizeof(kind)].tobytes()
        return self._ffi.from_buffer(f"{kind.cname} *", part)[0]

    def _field_at(self, at: int) -> tuple[str, int, Any]:
        """Return name, offset and type of the scalar field that contains the byte at ``at``."""
        kind, start, name = self._type, 0, ""
        while kind.kind in ("struct", "array"):
            if kind.kind == "array":
                width = self._ffi.sizeof(kind.item)
                k = (at - start) // width
                kind, start, name = kind.item, start + k * width, f"{name}[{k}]"
            else:
                label, field = next(
                    (n, f) for n, f in kind.fields
                    if start + f.offset <= at < start + f.offset + self._ffi.sizeof(f.type)
                )  # fmt: skip
                kind, start, name = field.type, start + field.offset, f"{name}.{label}".lstrip(".")
        return name, start, kind
