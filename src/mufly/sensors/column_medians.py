"""Medians of many columns at once, in vector registers.

A sorting network makes the same exchanges in all columns (Batcher's, as in Knuth, The Art of Computer Programming 3,
5.2.2 M); exchanges that cannot reach the middle rows are left out. The network sorts keys of 32 bits instead of the
values: a value rounded to a fraction of its noise, then the number of its row. Rounding keeps the order, so the key in
the middle names the row of the median. A column in which two rounded values near the middle are equal is sorted by its
values. The medians are therefore those of the values to the last bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.numba_intrinsics import borrow_arrays

_Array = NDArray[np.float64]
_MAX_KEY_DEVIATION_SIGMAS = (
    32.0  # of values from their level, in units of their noise; beyond, columns are sorted by their values
)


def median_comparators(rows: int) -> _Array:
    """Return the pairs of rows (n, 2) that a sorting network compares to bring the four middle rows in order.

    These four rows hold the one or two rows of the median, and a neighbour on each side.
    """
    top = 1
    while 2 * top < rows:
        top *= 2
    network, p = [], top
    while p > 0:
        q, r, d = top, 0, p
        while True:
            network += [(i, i + d) for i in range(rows - d) if i & p == r]
            if q == p:
                break
            d, q, r = q - p, q // 2, p
        p //= 2
    low, high = (rows - 1) // 2, rows // 2
    needed, kept = {low - 1, low, high, high + 1}, []
    for i, j in reversed(network):
        if i in needed or j in needed:
            needed |= {i, j}
            kept.append((i, j))
    return np.array(kept[::-1], dtype=np.float64).reshape(-1, 2)


@cached_njit(error_model="numpy")
def _sort_column(values: _Array, column: int, columns: int, out: _Array) -> None:
    """Write the sorted values of a column to ``out`` (rows,)."""
    for r in range(out.size):
        value, k = values[r * columns + column], r
        while k > 0 and out[k - 1] > value:
            out[k] = out[k - 1]
            k -= 1
        out[k] = value


@cached_njit(error_model="numpy")
def write_column_medians(values: _Array, levels: _Array, comparators: _Array, rows: int, medians: _Array) -> None:
    """Write the median of each column to ``medians`` (columns,).

    Parameters
    ----------
    values : (rows * columns,) array
        Row by row, in units of their noise.
    levels : (columns,) array
        Value near which each column's median is expected; the result does not depend on it.
    comparators : (n, 2) array
        Exchanges of :func:`median_comparators`.
    rows : int
        At least 4.
    medians : (columns,) array
    """
    columns, bits = medians.size, 0
    while 1 << bits < rows:
        bits += 1
    most, factor, mask = 2.0 ** (31 - bits) - 2.0, np.int32(1 << bits), (1 << bits) - 1
    scale = 2.0 ** (31 - bits) / _MAX_KEY_DEVIATION_SIGMAS
    all_keys = np.empty(values.size, np.int32)
    keys, level, out = borrow_arrays(all_keys), borrow_arrays(levels), borrow_arrays(medians)
    for r in range(rows):
        value, key = (
            borrow_arrays(values[r * columns : (r + 1) * columns]),
            borrow_arrays(keys[r * columns : (r + 1) * columns]),
        )
        row = np.int32(r)
        for k in range(columns):
            rounded = np.int32(max(min((value[k] - level[k]) * scale, most), -most))
            key[k] = np.int32(rounded * factor) + row
    for c in range(comparators.shape[0]):
        i, j = int(comparators[c, 0]) * columns, int(comparators[c, 1]) * columns
        first, second = borrow_arrays(keys[i : i + columns]), borrow_arrays(keys[j : j + columns])
        for k in range(columns):
            u, v = first[k], second[k]
            first[k], second[k] = min(u, v), max(u, v)
    low, high = (rows - 1) // 2, rows // 2
    for k in range(columns):
        a, b = keys[low * columns + k], keys[high * columns + k]
        below, above = keys[(low - 1) * columns + k] >> bits, keys[(high + 1) * columns + k] >> bits
        if below < a >> bits and b >> bits < above and (a == b or a >> bits < b >> bits):
            out[k] = 0.5 * (values[(a & mask) * columns + k] + values[(b & mask) * columns + k])
        else:
            column = np.empty(rows)
            _sort_column(values, k, columns, column)
            out[k] = 0.5 * (column[low] + column[high])
    all_keys[0] = 0  # this use keeps the borrowed array alive up to here
