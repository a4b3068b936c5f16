"""Types of translated functions: numbers, tables, records and tuples, and their names in C."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

C_DOUBLE, C_INT64, C_BOOL, C_VOID = "double", "int64_t", "bool", "void"


@dataclass(frozen=True)
class TableType:
    """Type of an array of numbers with a given shape."""

    element: str
    shape: tuple[int, ...]


@dataclass(frozen=True)
class TableTupleType:
    """Type of a tuple of arrays, which are separate arguments in C."""

    parts: tuple[TableType, ...]


@dataclass(frozen=True)
class RecordType:
    """Type of a pointer to a C struct that stands for a NumPy record."""

    name: str
    fields: np.dtype[Any]


@dataclass(frozen=True)
class TupleType:
    """Type of a tuple of numbers, which is a struct in C."""

    parts: tuple[Any, ...]

    @property
    def name(self) -> str:
        """Name of the tuple's C struct: a letter for each number; for a nested tuple, its length and letters."""
        letters = {C_DOUBLE: "r", C_INT64: "i", C_BOOL: "b"}
        return "tuple_" + "".join(
            letters[p] if isinstance(p, str) else f"{len(p.parts)}{p.name.removeprefix('tuple_')}" for p in self.parts
        )


CType = str | TableType | TableTupleType | RecordType | TupleType


def name_result_type(kind: CType) -> str:
    """Return the C type of a function's result; ``void`` for a table, which the function writes to an argument."""
    if isinstance(kind, TableType):
        return C_VOID
    return kind.name if isinstance(kind, TupleType) else str(kind)


def pointer_declaration(kind: TableType, name: str) -> str:
    """Return the declaration of a pointer to the first row of a table."""
    inner = "".join(f"[{n}]" for n in kind.shape[1:])
    return f"{kind.element} (*{name}){inner}" if inner else f"{kind.element} *{name}"
