"""The sum of :mod:`.kernel` on a GPU that CUDA knows, where there is one; off unless asked for.

One thread a point; the segments pass through every thread. The arithmetic is that of the CPU's kernel, in double
precision, so results agree to rounding.
"""

from __future__ import annotations

import math

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.rotor.wake.kernel import TINY_M2

__all__ = ["gpu_available", "induce_gpu"]

Array = NDArray[np.float64]

_THREADS = 128


def gpu_available() -> bool:
    """True if Numba finds a CUDA device."""
    try:
        return bool(cuda.is_available())  # type: ignore[no-untyped-call]
    except Exception:  # a broken driver is no GPU
        return False


@cuda.jit
def _induce(points, start, end, strength, core, out):  # type: ignore[no-untyped-def]
    i = cuda.grid(1)  # type: ignore[attr-defined]
    if i >= points.shape[0]:
        return
    px, py, pz = points[i, 0], points[i, 1], points[i, 2]
    sx, sy, sz = 0.0, 0.0, 0.0
    for k in range(start.shape[1]):
        ax, ay, az = px - start[0, k], py - start[1, k], pz - start[2, k]
        bx, by, bz = px - end[0, k], py - end[1, k], pz - end[2, k]
        cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        c2 = cx * cx + cy * cy + cz * cz
        ra = 1.0 / math.sqrt(ax * ax + ay * ay + az * az + TINY_M2)
        rb = 1.0 / math.sqrt(bx * bx + by * by + bz * bz + TINY_M2)
        along = (
            (ax - bx) * (ax * ra - bx * rb)
            + (ay - by) * (ay * ra - by * rb)
            + (az - bz) * (az * ra - bz * rb)
        )
        f = strength[k] * along / math.sqrt(c2 * c2 + core[k])
        sx += f * cx
        sy += f * cy
        sz += f * cz
    out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


def induce_gpu(points: Array, segments: tuple[Array, Array, Array, Array]) -> Array:
    """As :func:`mufly.rotor.wake.kernel.induce`.

    Raises
    ------
    MuflyError
        If there is no GPU.
    """
    if not gpu_available():
        raise MuflyError("wake: no CUDA device was found; leave the gpu setting off")
    out = cuda.device_array((points.shape[0], 3), dtype=np.float64)
    inputs = [cuda.to_device(np.ascontiguousarray(a)) for a in (points, *segments)]
    _induce[(points.shape[0] + _THREADS - 1) // _THREADS, _THREADS](*inputs, out)
    return np.asarray(out.copy_to_host())
