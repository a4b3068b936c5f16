"""Random numbers of sensors, drawn in blocks by compiled code.

A second of simulated flight needs 140 000 normal numbers, mostly noise of pixels and of the inertial unit. NumPy's
generators draw these one by one; vector registers draw four or eight at once. Only sums, products, divisions, roots and
shifts are used, so that every processor draws the same numbers to the last bit.

The k-th 64-bit number of a source is that of splitmix64: a counter, with a random start and an odd increment, whose
bits are mixed (Steele, Lea, Flood, Fast splittable pseudorandom number generators, OOPSLA 2014; constants of Stafford's
mix 13). The upper 52 bits give a number between 0 and 1. Two such numbers, u and v, give two normal numbers

    sqrt(-2 ln u) cos(2 pi v),     sqrt(-2 ln u) sin(2 pi v)

(Box and Muller, Ann. Math. Stat. 29, 1958). The logarithm is computed by the series of atanh, sine and cosine within an
eighth of a turn by their Taylor series, all to 1e-13. The largest magnitude is 8.5 standard deviations.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from llvmlite.binding import add_symbol
from numba import types
from numba.extending import intrinsic
from numba.np.numpy_support import carray
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays

_Array = NDArray[np.float64]


def make_random_source(rng: np.random.Generator) -> NDArray[np.uint64]:
    """Return the state (1,) of a new random source for compiled functions, seeded by ``rng``."""
    return rng.integers(2**64, size=1, dtype=np.uint64)


def _bitcast_intrinsic(make: Any, kind: Any) -> Any:
    """Return a Numba intrinsic that reinterprets the 64 bits of its argument as a number of another type."""

    def emit_bitcast(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.bitcast(given[0], make)

    return lambda context, number: (kind(number), emit_bitcast)


_bits_to_float: Any = intrinsic(_bitcast_intrinsic(ir.DoubleType(), types.float64))
_float_to_bits: Any = intrinsic(_bitcast_intrinsic(ir.IntType(64), types.uint64))

_COUNTER_STEP, _MIX_FACTOR_1, _MIX_FACTOR_2 = (
    np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)
_TWO_COUNTER_STEPS = np.uint64(2 * int(_COUNTER_STEP) % 2**64)
_27, _30, _31, _12, _52, _2 = (np.uint64(n) for n in (27, 30, 31, 12, 52, 2))
_EXPONENT_OF_ONE = np.uint64(0x3FF0000000000000)  # exponent bits of numbers from 1 to 2
_FRACTION_MASK = np.uint64(0x000FFFFFFFFFFFFF)
_TWO_POW_52_BITS = np.uint64(0x4330000000000000)  # 2^52: its last bits hold an integer
_LN2, _ROOT2 = math.log(2.0), math.sqrt(2.0)
_ATANH_3, _ATANH_5, _ATANH_7, _ATANH_9, _ATANH_11, _ATANH_13, _ATANH_15 = (1.0 / n for n in (3, 5, 7, 9, 11, 13, 15))
_SINE_3, _SINE_5, _SINE_7, _SINE_9, _SINE_11, _SINE_13 = (
    (-1.0) ** (n // 2) / math.factorial(n) for n in (3, 5, 7, 9, 11, 13)
)
_COSINE_2, _COSINE_4, _COSINE_6, _COSINE_8, _COSINE_10, _COSINE_12, _COSINE_14 = (
    (-1.0) ** (n // 2) / math.factorial(n) for n in (2, 4, 6, 8, 10, 12, 14)
)


@cached_njit(error_model="numpy")
def _uniform_1_to_2(counter: np.uint64) -> float:
    """Return a uniform number from 1 to 2 for a counter."""
    z = (counter ^ (counter >> _30)) * _MIX_FACTOR_1
    z = (z ^ (z >> _27)) * _MIX_FACTOR_2
    return _bits_to_float(((z ^ (z >> _31)) >> _12) | _EXPONENT_OF_ONE)


@cached_njit(error_model="numpy")
def _normal_pair(a: float, b: float) -> tuple[float, float]:
    """Return two standard normal numbers from two uniform numbers between 1 and 2."""
    bits = _float_to_bits(2.0 - a)  # above 0, up to 1
    power = _bits_to_float(_TWO_POW_52_BITS | (bits >> _52)) - 4503599627371519.0  # 2^52 + 1023
    m = _bits_to_float((bits & _FRACTION_MASK) | _EXPONENT_OF_ONE)
    big = m > _ROOT2
    m = 0.5 * m if big else m
    power = power + 1.0 if big else power
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = 1.0 + q * (
        _ATANH_3 + q * (_ATANH_5 + q * (_ATANH_7 + q * (_ATANH_9 + q * (_ATANH_11 + q * (_ATANH_13 + q * _ATANH_15)))))
    )
    far = math.sqrt(-(power * _LN2 + 2.0 * s * series))  # the factor sqrt(2) is in the lines below
    x = b - 1.5  # turns
    y = abs(x) - 0.25
    t = 2.0 * math.pi * (abs(y) - 0.125)
    p = t * t
    sine = t * (1.0 + p * (_SINE_3 + p * (_SINE_5 + p * (_SINE_7 + p * (_SINE_9 + p * (_SINE_11 + p * _SINE_13))))))
    cosine = 1.0 + p * (
        _COSINE_2
        + p * (_COSINE_4 + p * (_COSINE_6 + p * (_COSINE_8 + p * (_COSINE_10 + p * (_COSINE_12 + p * _COSINE_14)))))
    )
    first, second = far * (cosine - sine), far * (cosine + sine)
    return first if x > 0.0 else -first, second if y > 0.0 else -second


# Vector code is long, so the function is compiled once and all sensors call it by its symbol.
_pointer: Any = types.CPointer
_FILL_SIGNATURE = types.void(_pointer(types.uint64), _pointer(types.float64), types.int64)


@numba.cfunc(_FILL_SIGNATURE, cache=True, error_model="numpy")
def _fill_normals(source: Any, numbers: Any, size: int) -> None:
    counter, out = carray(source, 1), carray(numbers, size)
    start, half = counter[0], size // 2
    counter[0] = start + np.uint64(size + size % 2) * _COUNTER_STEP
    at = start
    for i in range(half):
        out[i], out[half + i] = _normal_pair(_uniform_1_to_2(at), _uniform_1_to_2(at + _COUNTER_STEP))
        at += _TWO_COUNTER_STEPS
    if size % 2:
        out[2 * half] = _normal_pair(_uniform_1_to_2(at), _uniform_1_to_2(at + _COUNTER_STEP))[0]


add_symbol("mufly_normals", _fill_normals.address)
_external_normals: Any = types.ExternalFunction("mufly_normals", _FILL_SIGNATURE)


@cached_njit(error_model="numpy")
def draw_normals(source: NDArray[np.uint64], out: _Array) -> None:
    """Fill an array (n,) with the next standard normal numbers of a source."""
    _external_normals(borrow_arrays(source).ctypes, borrow_arrays(out).ctypes, out.size)


@cached_njit(error_model="numpy")
def draw_uniforms(source: NDArray[np.uint64], out: _Array) -> None:
    """Fill an array (n,) with the next uniform numbers of a source in [0, 1)."""
    start = source[0]
    source[0] = start + np.uint64(out.size) * _COUNTER_STEP
    for i in range(out.size):
        out[i] = _uniform_1_to_2(start + np.uint64(i) * _COUNTER_STEP) - 1.0
