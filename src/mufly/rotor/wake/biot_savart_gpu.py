"""Biot-Savart sum on a CUDA device; optional and off by default.

Each thread handles one point and loops over all segments. The arithmetic is that of :mod:`.biot_savart` in double
precision; results agree to rounding.
"""

from __future__ import annotations

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.rotor.wake.biot_savart import evaluate_biot_savart_kernel

Array = NDArray[np.float64]

_THREADS_PER_BLOCK = 128


def is_gpu_available() -> bool:
    """True if Numba finds a CUDA device."""
    try:
        return bool(cuda.is_available())  # type: ignore[no-untyped-call]
    except Exception:  # a broken driver counts as no GPU
        return False


_evaluate_biot_savart_kernel = cuda.jit(evaluate_biot_savart_kernel, device=True)  # type: ignore[no-untyped-call]


@cuda.jit
def _induced_velocity_kernel(points: Array, start: Array, end: Array, strength: Array, core: Array, out: Array) -> None:
    i = cuda.grid(1)  # type: ignore[attr-defined]
    if i >= points.shape[0]:
        return
    px, py, pz = points[i, 0], points[i, 1], points[i, 2]
    sx, sy, sz = 0.0, 0.0, 0.0
    for k in range(start.shape[1]):
        vx, vy, vz = _evaluate_biot_savart_kernel(
            px, py, pz, start[0, k], start[1, k], start[2, k], end[0, k], end[1, k], end[2, k], core[k]
        )
        sx += strength[k] * vx
        sy += strength[k] * vy
        sz += strength[k] * vz
    out[i, 0], out[i, 1], out[i, 2] = sx, sy, sz


def induce_velocity_gpu(points: Array, segments: tuple[Array, Array, Array, Array]) -> Array:
    """Compute :func:`mufly.rotor.wake.biot_savart.induce_velocity` on the GPU.

    Raises
    ------
    MuflyError
        If there is no GPU.
    """
    if not is_gpu_available():
        raise MuflyError("wake: no CUDA device was found; leave the gpu setting off")
    out = cuda.device_array((points.shape[0], 3), dtype=np.float64)
    inputs = [cuda.to_device(np.ascontiguousarray(a)) for a in (points, *segments)]
    _induced_velocity_kernel[(points.shape[0] + _THREADS_PER_BLOCK - 1) // _THREADS_PER_BLOCK, _THREADS_PER_BLOCK](
        *inputs, out
    )
    return np.asarray(out.copy_to_host())
