r"""Information of image patches about the shift between two pictures, without the bias by noise.

A patch of the warped keyframe, T, and one of the picture, I, are samples of the same floor with independent noise.
Least squares for the shift d (Lucas and Kanade 1981, with the mean of both gradients: Malis 2004) is

    G d = b,    b = sum g (T - I),    g = (g_T + g_I) / 2,    cov(d) = v G^-1,    v = a^2 mean (T - I)^2

since smoothing by s pixels correlates the noise over a = sum_k (1 - |k| / m) exp(-k^2 / 4 s^2) pixels along each side
of a patch of m pixels. For pictures without noise, G = sum g g^T is the
structure tensor, and cov(d) the Cramer-Rao bound (Robinson and Milanfar 2004). Noise adds gradients of its own, which
look like texture. The cross tensor contains the floor alone, since the noise of both pictures is independent:

    G = sum (g_T g_I^T + g_I g_T^T) / 2,    E[G] = sum (gradient of the floor)(gradient of the floor)^T.

**Directions without texture.** Over all patches of a picture, the sum S of G along a direction v scatters with

    F^2 = sum_i (P_T,i P_I,i - G_i^2) c / n,    c = 3 pi / 2 s^2,

where P are the powers of both gradients along v in a patch of n pixels (floor and noise). The area c, over which
products of noise gradients are correlated, is the integral of the squared autocorrelation of a smoothed gradient.
Vibration bends stripes in a rolling shutter: by a random slope e of the rows (rms), different in both pictures. So
stripes across v with the sum S' add e^2 S' / 2 to S. A direction has information if S exceeds
:data:`MIN_TEXTURE_SIGNIFICANCE` F + 2 e^2 S'.
Along all other directions the negative part of every tensor is removed, and all tensors are scaled so that their sum
remains S. Own derivation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit

_Array = NDArray[np.float64]
MIN_TEXTURE_SIGNIFICANCE = 4.0
"""Least ratio of the texture along a direction to the scatter of noise, for the direction to count as seen."""
_BENDING_ERROR_FACTOR = 2.0
"""Factor on e^2 S', above."""
(
    GRADIENT_XX_COLUMN,
    GRADIENT_XY_COLUMN,
    GRADIENT_YY_COLUMN,
    SHIFT_X_COLUMN,
    SHIFT_Y_COLUMN,
    TEMPLATE_GRADIENT_XX_COLUMN,
    TEMPLATE_GRADIENT_XY_COLUMN,
    TEMPLATE_GRADIENT_YY_COLUMN,
    PICTURE_GRADIENT_XX_COLUMN,
    PICTURE_GRADIENT_XY_COLUMN,
    PICTURE_GRADIENT_YY_COLUMN,
    GREY_VARIANCE_COLUMN,
) = range(12)
"""Columns of a patch's sums: G, b, both pictures' own tensors, and mean square difference."""
PATCH_SUM_COUNT = 12


class PatchShifts(NamedTuple):
    """Measured shifts of patches.

    Attributes
    ----------
    information : (n, 2, 2) array
        Information on the shift (1/pixel^2); singular along directions without texture.
    shift_px : (n, 2) array
        Shift of the picture's patch that matches the template; zero along directions without texture.
    significance : (2,) array
        S over its least value for information, along ``directions``.
    directions : (2, 2) array
        Unit vectors over the floor (N, E), one a row: the least known one first.
    cramer_rao_bound_px : (2,) array
        Cramer-Rao bound of the common shift of all patches along ``directions`` (pixels of a level camera); infinite
        without texture.
    """

    information: _Array
    shift_px: _Array
    significance: _Array
    directions: _Array
    cramer_rao_bound_px: _Array

    @property
    def textured_directions(self) -> NDArray[np.bool_]:
        """Mask (2,) of the directions in which the patches have texture."""
        return self.significance > 1.0


def measure_patch_shifts(
    template: NDArray[np.float32],
    picture: NDArray[np.float32],
    points: _Array,
    there: _Array,
    smooth: float,
    axes: _Array,
    half: int = 10,
    row_slope: float = 0.0,
    caution: float = 1.0,
) -> PatchShifts:
    """Measure the shifts of patches.

    Parameters
    ----------
    template, picture : (rows, columns) float32 arrays
        Smoothed by ``smooth`` (pixels), without background.
    points, there : (n, 2) arrays
        Middles of the patches in both (pixels); patches beyond the border have no information.
    axes : (n, 2, 2) array
        Shifts of the pixels by N and E, in units of the height over the focal length: for a level camera a rotation.
    half : int
        Half the side of a patch (pixels).
    row_slope : float
        Rms slope of vertical lines by vibration in a rolling shutter.
    caution : float
        Factor on the least S; above one if the shift is poorly known, because chance then finds a false match.
    """
    sums = np.zeros((len(points), PATCH_SUM_COUNT))
    _sum_patches(template, picture, np.ascontiguousarray(points), np.ascontiguousarray(there), half, sums)
    return estimate_patch_shifts(sums, smooth, axes, (2 * half - 1) ** 2, row_slope, caution)


def estimate_patch_shifts(
    sums: _Array, smooth: float, axes: _Array, pixels: int, row_slope: float = 0.0, caution: float = 1.0
) -> PatchShifts:
    """Return shifts and information of n patches from sums over their pixels (n, 12), as the module docstring derives.

    Parameters
    ----------
    smooth : float
        Smoothing of the pictures (pixels).
    axes : (n, 2, 2) array
        As for :func:`measure_patch_shifts`.
    pixels : int
        Pixels of a patch.
    row_slope, caution : float
        As for :func:`measure_patch_shifts`.
    """
    smooth = max(smooth, 0.3)
    side = math.sqrt(pixels)
    v = max(1.0, 2.0 * math.sqrt(math.pi) * smooth - 4.0 * smooth**2 / side) ** 2 * np.maximum(
        sums[:, GREY_VARIANCE_COLUMN], 1e-6
    )
    # Over the floor, where a direction without texture is the same for all patches
    across = np.swapaxes(axes, 1, 2)
    own, template, picture = (
        across @ (_tensors_from_sums(sums, at) / v[:, None, None]) @ axes
        for at in (GRADIENT_XX_COLUMN, TEMPLATE_GRADIENT_XX_COLUMN, PICTURE_GRADIENT_XX_COLUMN)
    )
    pull = np.einsum("nji,nj->ni", axes, sums[:, [SHIFT_X_COLUMN, SHIFT_Y_COLUMN]] / v[:, None])
    total = own.sum(axis=0)
    directions = np.linalg.eigh(total)[1].T
    own, template, picture = (directions @ q @ directions.T for q in (own, template, picture))
    strength, along = np.einsum("nkk->k", own), np.einsum("nkk->nk", own)
    power = np.einsum("nkk->nk", template) * np.einsum("nkk->nk", picture)
    scatter = np.sqrt(np.maximum(power - along**2, 0.0).sum(axis=0) * 1.5 * math.pi * smooth**2 / pixels)
    least = MIN_TEXTURE_SIGNIFICANCE * scatter + _BENDING_ERROR_FACTOR * row_slope**2 * np.maximum(strength[::-1], 0.0)
    significance = strength / np.maximum(caution * least, 1e-12)
    known = significance > 1.0
    values, vectors = _find_tensor_eigenvectors(own * np.outer(known, known))
    kept = np.einsum("nij,nj->i", vectors**2, values)
    scale = np.sqrt(np.where(known, strength / np.maximum(kept, 1e-12), 0.0))
    kept = np.einsum("nij,nj,nkj->nik", vectors, values, vectors) * np.outer(scale, scale)
    values, vectors = _find_tensor_eigenvectors(kept)
    with np.errstate(divide="ignore"):
        inverse = np.where(values > _MIN_PATCH_INFORMATION_PER_PX2, 1.0 / values, 0.0)
        bound = np.where(known, 1.0 / np.sqrt(np.maximum(strength, 1e-12)), math.inf)
    values = np.where(values > _MIN_PATCH_INFORMATION_PER_PX2, values, 0.0)
    kept = np.einsum("nij,nj,nkj->nik", vectors, values, vectors)
    shift = np.einsum("nij,nj,nkj,nk->ni", vectors, inverse, vectors, pull @ directions.T * known) @ directions
    back = np.linalg.inv(axes)
    information = np.swapaxes(back, 1, 2) @ (directions.T @ kept @ directions) @ back
    return PatchShifts(information, np.einsum("nij,nj->ni", axes, shift), significance, directions, bound)


def _find_tensor_eigenvectors(tensors: _Array) -> tuple[_Array, _Array]:
    """Return the eigenvalues (n, 2), not below zero, and eigenvectors (n, 2, 2) of symmetric tensors (n, 2, 2)."""
    a, b, c = tensors[:, 0, 0], tensors[:, 0, 1], tensors[:, 1, 1]
    angle = 0.5 * np.arctan2(2.0 * b, a - c)
    mean, half = 0.5 * (a + c), np.hypot(0.5 * (a - c), b)
    cos, sin = np.cos(angle), np.sin(angle)
    vectors = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
    return np.maximum(np.stack([mean + half, mean - half], axis=1), 0.0), vectors


_MIN_PATCH_INFORMATION_PER_PX2 = 1e-4
"""Least information of a patch along a direction (1/pixel^2): a deviation of 100 pixels."""


def _tensors_from_sums(sums: _Array, at: int) -> _Array:
    """Return symmetric tensors (n, 2, 2) whose elements xx, xy, yy are columns ``at`` to ``at + 2`` of the sums."""
    return sums[:, [at, at + 1, at + 1, at + 2]].reshape(-1, 2, 2)


@cached_njit(error_model="numpy")
def _sample_patch(a: NDArray[np.float32], x: float, y: float, half: int, out: NDArray[np.float32]) -> None:
    """Write the bilinear samples of a patch (2 half + 1, 2 half + 1)."""
    j, i = math.floor(x), math.floor(y)
    u, v = np.float32(x - j), np.float32(y - i)
    one = np.float32(1.0)
    p, q, r, s = (one - v) * (one - u), (one - v) * u, v * (one - u), v * u
    n = 2 * half + 1
    for row in range(n):
        k = i - half + row
        for column in range(n):
            m = j - half + column
            out[row, column] = p * a[k, m] + q * a[k, m + 1] + r * a[k + 1, m] + s * a[k + 1, m + 1]


@cached_njit(error_model="numpy")
def _sum_patches(
    template: NDArray[np.float32],
    picture: NDArray[np.float32],
    points: _Array,
    there: _Array,
    half: int,
    sums: _Array,
) -> None:
    """Write the sums over the pixels of each patch, as :func:`estimate_patch_shifts` takes them, to ``sums``
    (n, 12).
    """
    high, wide = picture.shape
    n = 2 * half + 1
    a, b = np.empty((n, n), np.float32), np.empty((n, n), np.float32)
    edge = half + 1.0
    for i in range(len(points)):
        x, y, u, v = points[i, 0], points[i, 1], there[i, 0], there[i, 1]
        if not (
            edge <= x < wide - edge and edge <= y < high - edge and edge <= u < wide - edge and edge <= v < high - edge
        ):
            continue
        _sample_patch(template, x, y, half, a)
        _sample_patch(picture, u, v, half, b)
        s = np.zeros(PATCH_SUM_COUNT)
        sum_ax = sum_ay = sum_bx = sum_by = total = 0.0
        for r in range(1, n - 1):
            for c in range(1, n - 1):
                ax, ay = 0.5 * (a[r, c + 1] - a[r, c - 1]), 0.5 * (a[r + 1, c] - a[r - 1, c])
                bx, by = 0.5 * (b[r, c + 1] - b[r, c - 1]), 0.5 * (b[r + 1, c] - b[r - 1, c])
                off = a[r, c] - b[r, c]
                s[GRADIENT_XX_COLUMN] += ax * bx
                s[GRADIENT_XY_COLUMN] += 0.5 * (ax * by + ay * bx)
                s[GRADIENT_YY_COLUMN] += ay * by
                s[SHIFT_X_COLUMN] += 0.5 * (ax + bx) * off
                s[SHIFT_Y_COLUMN] += 0.5 * (ay + by) * off
                s[TEMPLATE_GRADIENT_XX_COLUMN] += ax * ax
                s[TEMPLATE_GRADIENT_XY_COLUMN] += ax * ay
                s[TEMPLATE_GRADIENT_YY_COLUMN] += ay * ay
                s[PICTURE_GRADIENT_XX_COLUMN] += bx * bx
                s[PICTURE_GRADIENT_XY_COLUMN] += bx * by
                s[PICTURE_GRADIENT_YY_COLUMN] += by * by
                s[GREY_VARIANCE_COLUMN] += off * off
                sum_ax += ax
                sum_ay += ay
                sum_bx += bx
                sum_by += by
                total += off
        # The difference of the mean grey levels is unknown, so a constant gradient shows no shift.
        one = 1.0 / ((n - 2) * (n - 2))
        s[GRADIENT_XX_COLUMN] -= one * sum_ax * sum_bx
        s[GRADIENT_XY_COLUMN] -= 0.5 * one * (sum_ax * sum_by + sum_ay * sum_bx)
        s[GRADIENT_YY_COLUMN] -= one * sum_ay * sum_by
        s[SHIFT_X_COLUMN] -= 0.5 * one * (sum_ax + sum_bx) * total
        s[SHIFT_Y_COLUMN] -= 0.5 * one * (sum_ay + sum_by) * total
        s[TEMPLATE_GRADIENT_XX_COLUMN] -= one * sum_ax * sum_ax
        s[TEMPLATE_GRADIENT_XY_COLUMN] -= one * sum_ax * sum_ay
        s[TEMPLATE_GRADIENT_YY_COLUMN] -= one * sum_ay * sum_ay
        s[PICTURE_GRADIENT_XX_COLUMN] -= one * sum_bx * sum_bx
        s[PICTURE_GRADIENT_XY_COLUMN] -= one * sum_bx * sum_by
        s[PICTURE_GRADIENT_YY_COLUMN] -= one * sum_by * sum_by
        s[GREY_VARIANCE_COLUMN] = one * (s[GREY_VARIANCE_COLUMN] - one * total * total)
        sums[i] = s
