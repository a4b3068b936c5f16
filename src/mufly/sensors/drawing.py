"""Random numbers drawn inside compiled code, the same that NumPy's generator gives, from the same generator.

NumPy fills arrays by two functions of its own library, which take the address of a generator's state
(``numpy.random.Generator`` calls them too, so that the stream of numbers is one, whoever asks for the next). Where a
system does not export them, stand-ins ask the generator itself: slower, and the same numbers.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.random import _generator
from numpy.typing import NDArray

from mufly.calling import call_at
from mufly.compiled import compiled

_FILL = ctypes.CFUNCTYPE(None, ctypes.c_size_t, ctypes.c_ssize_t, ctypes.POINTER(ctypes.c_double))
_NAMES = ("random_standard_normal_fill", "random_standard_uniform_fill")
_known: dict[int, np.random.Generator] = {}


def _stand_in(name: str) -> Any:
    """Fill by asking the generator that has its state there."""

    def fill(state: int, count: int, out: Any) -> None:
        rng = _known[state]
        draw = rng.standard_normal if "normal" in name else rng.random
        np.ctypeslib.as_array(out, (count,))[:] = draw(count)

    return _FILL(fill)


def _fillers() -> tuple[list[Any], bool]:
    """The two functions, and whether they are NumPy's."""
    try:
        library = ctypes.CDLL(_generator.__file__)
        return [getattr(library, name) for name in _NAMES], True
    except (AttributeError, OSError):
        return [_stand_in(name) for name in _NAMES], False


_held, _own = _fillers()
_places = [ctypes.cast(f, ctypes.c_void_p).value or 0 for f in _held]


def source_of(rng: np.random.Generator) -> NDArray[np.int64]:
    """Return what compiled functions draw from (3,); for as long as the generator lives."""
    state = int(rng.bit_generator.ctypes.bit_generator.value)
    if not _own:
        _known[state] = rng
    return np.array([*_places, state], dtype=np.int64)


@compiled
def normals(source, out):  # type: ignore[no-untyped-def]
    """Fill an array (C order) with the next unit normal numbers of a source."""
    call_at(source[0], (source[2], np.int64(out.size), np.int64(out.ctypes.data)))


@compiled
def uniforms(source, out):  # type: ignore[no-untyped-def]
    """Fill an array (C order) with the next numbers of a source, even between 0 and 1."""
    call_at(source[1], (source[2], np.int64(out.size), np.int64(out.ctypes.data)))
