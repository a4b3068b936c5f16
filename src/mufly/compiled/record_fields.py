"""Declaration of records by classes with typed, documented fields, the source of NumPy types and C structs.

A class declares its fields with :func:`real_or_array_field` and :func:`int_or_array_field` and annotates them for
editors and type checkers; it is never instantiated. Compiled functions take a NumPy record of :func:`make_record_dtype`
in its place, whose fields Numba reads as fast as those of a C struct.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Field:
    """Field of a record.

    Attributes
    ----------
    shape : tuple
        Integers, or names of sizes that differ between records.
    is_int : bool
        True for integers, false for real numbers.
    meaning, unit : str
    source : str
        Parameter of a vehicle file with the same value; "" if computed.
    """

    shape: tuple[int | str, ...]
    is_int: bool
    meaning: str
    unit: str = ""
    source: str = ""


def real_or_array_field(meaning: str, *shape: int | str, unit: str = "", source: str = "") -> Any:
    """Declare a field of a record that holds a real number or an array of real numbers."""
    return Field(shape, False, meaning, unit, source)


def int_or_array_field(meaning: str, *shape: int | str) -> Any:
    """Declare a field of a record that holds an integer or an array of integers."""
    return Field(shape, True, meaning)


def record_fields(record: type) -> dict[str, Field]:
    """Return the fields of a declared record by name, in order."""
    return {name: field for name, field in vars(record).items() if isinstance(field, Field)}


def make_record_dtype(record: type, kind: Any = np.float64, int_kind: Any = np.int32, **sizes: int) -> np.dtype:
    """Return the NumPy type of a declared record with the memory layout of a C struct.

    Parameters
    ----------
    record : type
        Declaring class.
    kind, int_kind : type
        Types of real numbers and of integers.
    **sizes : int
        Sizes named in shapes.
    """
    return np.dtype(
        [
            (
                name,
                int_kind if field.is_int else kind,
                tuple(sizes[n] if isinstance(n, str) else n for n in field.shape),
            )
            for name, field in record_fields(record).items()
        ],
        align=True,
    )
