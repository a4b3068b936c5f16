"""Image processing by OpenCV, an optional dependency: undistortion, smoothing, corners, tracks, matches.

Tracks (Lucas and Kanade 1981, pyramids by Bouguet 2000) go from a keyframe's picture, warped to the predicted view, to
the present picture. The template is therefore always the original keyframe, and only a shift has to be found. Two
numbers describe the quality of a track. The correlation rho of the two patches (zero mean, normalised) is the share of
the signal that comes from the floor; tracked noise alone has 0.1 to 0.3. The covariance of the shift is

    C = s^2 G^-1,    G = rho sum (grad I)(grad I)^T,    s^2 the mean square of the patches' difference,

as usual for least squares (e.g. Foerstner and Guelch 1987); the factor rho removes the gradients of the noise.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, camera_matrix, distortion_coefficients
from mufly.compiled.numba_cache import cached_njit
from mufly.errors import MuflyError

_Array = NDArray[np.float64]
_Picture = NDArray[np.uint8]
GRID_CELL_PX = 20
"""Cell size of the uniform grid, with one corner per cell (pixels)."""
BORDER_MARGIN_PX = 14  # pixels at the border without corners
TRACKING_WINDOW_PX = 21
MIN_REPEAT_CORRELATION = 0.5
"""Autocorrelation from which a picture counts as periodic."""
_PATCH_HALF_SIZE_PX = 10  # half the side of a compared patch
_LOCAL_MEAN_SIDE_PX = 31  # side of the mean that is subtracted: vignette and shadows move with the camera
_TRACKING_MEAN_SIDE_PX = 85
"""The same for tracking: half the largest window of the pyramid, so that the texture of its coarse levels remains."""
_FLAT_GREY_LEVEL = 128.0  # mean grey level of a picture without background


@functools.cache
def import_opencv() -> Any:
    """Import OpenCV and return it.

    Raises
    ------
    MuflyError
        If OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise MuflyError(
            "OpenCV, which image processing needs, is not installed; run: pip install 'mufly[vision]'"
        ) from None
    cv2.setNumThreads(1)  # the core is shared with a flight
    return cv2


def pinhole_parameters(camera: Camera) -> tuple[float, _Array]:
    """Return focal length and principal point (2,) of undistorted pictures (pixels)."""
    focal = 0.5 * (float(camera.lens.focal_x) + float(camera.lens.focal_y))
    return focal, np.array([(camera.sensor.width - 1) / 2, (camera.sensor.height - 1) / 2])


class Undistorter:
    """Removes the lens distortion from pictures and smooths them.

    The result is a pinhole picture of the same focal length, with the principal point in its middle.
    """

    def __init__(self, camera: Camera) -> None:
        cv2 = import_opencv()
        size = (camera.sensor.width, camera.sensor.height)
        self.picture_size = size
        self.focal_px, self.principal_point = pinhole_parameters(camera)
        # Smoothing according to the noise (pixels, one sigma), before any detection
        self.smoothing_sigma_px = min(2.2, 0.8 + 0.1 * float(camera.quality.noise))
        wanted = np.array(
            [
                [self.focal_px, 0, self.principal_point[0]],
                [0, self.focal_px, self.principal_point[1]],
                [0, 0, 1.0],
            ]
        )
        self.camera_matrix = wanted
        # Sides of the picture over the focal length: width, height
        self.view_ratios = size[0] / self.focal_px, size[1] / self.focal_px
        self._remap_tables = cv2.initUndistortRectifyMap(
            camera_matrix(camera), distortion_coefficients(camera), None, wanted, size, cv2.CV_16SC2
        )
        rows = cv2.initUndistortRectifyMap(
            camera_matrix(camera), distortion_coefficients(camera), None, wanted, size, cv2.CV_32FC1
        )[1]
        self._exposure_offsets_s = (rows / (size[1] - 1) - 0.5) * float(camera.shutter.readout)
        seen = np.full((size[1], size[0]), 255, np.uint8)
        self.valid_mask = cv2.erode(cv2.remap(seen, *self._remap_tables, cv2.INTER_LINEAR), np.ones((5, 5), np.uint8))

    def undistort_picture(self, picture: _Picture) -> _Picture:
        """Return the undistorted, smoothed picture."""
        cv2 = import_opencv()
        out = cv2.remap(picture, *self._remap_tables, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return cv2.GaussianBlur(out, (0, 0), self.smoothing_sigma_px)

    def exposure_time_offsets_s(self, pixels: _Array) -> _Array:
        """Return exposure times of pixels (n, 2) of an undistorted picture, relative to the middle row (s)."""
        c = np.clip(np.rint(pixels).astype(int), 0, np.array(self.picture_size) - 1)
        return self._exposure_offsets_s[c[:, 1], c[:, 0]].astype(np.float64)


def detect_corners(picture: _Picture, seen: _Picture, most: int = 150) -> _Array:
    """Return the best corner (n, 2) of each cell of a uniform grid (pixels); cells without a good corner have none."""
    cv2 = import_opencv()
    strength = cv2.cornerMinEigenVal(picture, 7, 3)
    strength[seen == 0] = 0.0
    strength[:BORDER_MARGIN_PX] = strength[-BORDER_MARGIN_PX:] = 0.0
    strength[:, :BORDER_MARGIN_PX] = strength[:, -BORDER_MARGIN_PX:] = 0.0
    high, wide = (n // GRID_CELL_PX for n in picture.shape)
    cells = (
        strength[: high * GRID_CELL_PX, : wide * GRID_CELL_PX]
        .reshape(high, GRID_CELL_PX, wide, GRID_CELL_PX)
        .swapaxes(1, 2)
    )
    flat = cells.reshape(high * wide, GRID_CELL_PX * GRID_CELL_PX)
    best = flat.argmax(axis=1)
    value = flat[np.arange(len(flat)), best]
    keep = np.argsort(value)[::-1][:most]
    keep = keep[value[keep] > 1e-7]
    rows, columns = np.divmod(keep, wide)
    return np.column_stack(
        [columns * GRID_CELL_PX + best[keep] % GRID_CELL_PX, rows * GRID_CELL_PX + best[keep] // GRID_CELL_PX]
    ).astype(float)


def warp_picture(picture: _Picture, homography: _Array, size: tuple[int, int]) -> _Picture:
    """Return a picture warped by a homography; black outside the original."""
    cv2 = import_opencv()
    return cv2.warpPerspective(picture, homography, size, flags=cv2.INTER_LINEAR)


def subtract_local_mean(picture: NDArray[np.uint8], side: int = _LOCAL_MEAN_SIDE_PX) -> NDArray[np.float32]:
    """Return a picture as floats without its local mean over ``side`` pixels."""
    cv2 = import_opencv()
    mean = cv2.blur(picture, (side, side))
    return np.asarray(cv2.subtract(picture, mean, dtype=cv2.CV_32F))


def match_brightness(picture: _Picture, other: _Picture) -> _Picture:
    """Return a picture scaled to the mean brightness of another, since the tracker compares grey levels."""
    ratio = float(other.mean()) / max(float(picture.mean()), 1.0)
    return import_opencv().convertScaleAbs(picture, alpha=ratio) if abs(ratio - 1.0) > 0.03 else picture


def warp_over_picture(picture: _Picture, homography: _Array, over: _Picture) -> tuple[_Picture, _Picture]:
    """Warp a picture over another one; return the result, and a mask of the warped area, shrunk by a margin.

    The margin is :data:`BORDER_MARGIN_PX`.

    Outside, the result is the other picture. A black edge, fixed in the image, would bias all pyramid windows over it.
    """
    cv2 = import_opencv()
    size = (over.shape[1], over.shape[0])
    out = over.copy()
    cv2.warpPerspective(picture, homography, size, dst=out, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT)
    high, wide = picture.shape
    corner = np.array([[0.0, 0, 1], [wide - 1, 0, 1], [wide - 1, high - 1, 1], [0, high - 1, 1]]) @ homography.T
    reach = np.zeros_like(over)
    if (corner[:, 2] > 0).all():
        cv2.fillConvexPoly(reach, np.rint(corner[:, :2] / corner[:, 2:]).astype(np.int32), 255)
    edge = np.zeros_like(reach)
    edge[BORDER_MARGIN_PX:-BORDER_MARGIN_PX, BORDER_MARGIN_PX:-BORDER_MARGIN_PX] = 255
    return out, cv2.erode(reach, np.ones((2 * BORDER_MARGIN_PX - 1, 2 * BORDER_MARGIN_PX - 1), np.uint8)) & edge


def find_repeat_shifts(picture: Any) -> _Array:
    """Return the shifts (n, 2) by which a picture repeats (pixels), or (0, 2) if it does not.

    They are the side peaks of the correlation of its middle with the whole picture and a quarter beyond.
    """
    cv2 = import_opencv()
    small = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
    small -= cv2.GaussianBlur(small, (0, 0), 10)  # remove vignette and shadows, which correlate at any shift
    high, wide = small.shape
    top, left = high // 4, wide // 4
    wider = cv2.copyMakeBorder(small, top, top, left, left, cv2.BORDER_CONSTANT, value=0.0)
    score = cv2.matchTemplate(wider, small[top : high - top, left : wide - left], cv2.TM_CCOEFF_NORMED)
    peak = (score == cv2.dilate(score, np.ones((7, 7), np.uint8))) & (score > MIN_REPEAT_CORRELATION)
    rows, columns = np.nonzero(peak)
    shift = 2.0 * np.stack([columns - 2 * left, rows - 2 * top], axis=1)
    return np.asarray(shift[np.abs(shift).max(axis=1) > 8.0], np.float64)


def are_pixels_in_mask(mask: _Picture, pixels: _Array) -> NDArray[np.bool_]:
    """Return the mask (n,) of the pixels (n, 2) inside a mask picture."""
    high, wide = mask.shape
    x, y = np.rint(pixels).astype(int).T
    inside = (x >= 0) & (x < wide) & (y >= 0) & (y < high)
    out: NDArray[np.bool_] = inside.copy()
    out[inside] = mask[y[inside], x[inside]] > 0
    return out


def _choose_max_pyramid_level(reach: float) -> int:
    return 3 if math.isinf(reach) else min(3, max(1, math.ceil(math.log2(reach / (TRACKING_WINDOW_PX // 2)))))


def track_points(
    template: _Picture, picture: _Picture, points: _Array, smooth: float, reach: float
) -> tuple[_Array, _Array, _Array]:
    """Track points (n, 2) of a template in a picture; return positions, patch correlations and standard deviations.

    Both pictures are already smoothed by ``smooth`` (pixels). The pyramid has just enough levels for half a window to
    span ``reach`` (pixels); with more levels the windows jump to the next tile. Pictures are tracked without their
    local mean, since the large windows of coarse levels otherwise follow vignette and shadows instead of the floor.

    Returns
    -------
    there : (n, 2) array
        Points in the picture.
    correlation : (n,) array
        Correlation of the patches; 0 for lost points.
    sigma : (n,) array
        Standard deviation of the position along an axis (pixels), root mean square of both.
    """
    cv2 = import_opencv()
    from_ = points.astype(np.float32).reshape(-1, 1, 2)
    to = from_.copy()
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.02)
    flat = (
        cv2.add(subtract_local_mean(q, _TRACKING_MEAN_SIDE_PX), _FLAT_GREY_LEVEL, dtype=cv2.CV_8U)
        for q in (template, picture)
    )
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        *flat,
        from_,
        to,
        winSize=(TRACKING_WINDOW_PX, TRACKING_WINDOW_PX),
        maxLevel=_choose_max_pyramid_level(reach),
        criteria=stop,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    there = there.reshape(-1, 2).astype(np.float64)
    correlation, sigma = np.zeros(len(points)), np.full(len(points), 1e3)
    correlate_patches(template, picture, points, there, found.reshape(-1), smooth, correlation, sigma)
    return there, correlation, sigma


@cached_njit(error_model="numpy")
def _interpolate_grey(a: NDArray[np.uint8], x: float, y: float) -> float:
    i, j = math.floor(y), math.floor(x)
    u, v = y - i, x - j
    return (1 - u) * ((1 - v) * a[i, j] + v * a[i, j + 1]) + u * ((1 - v) * a[i + 1, j] + v * a[i + 1, j + 1])


@cached_njit(error_model="numpy")
def correlate_patches(
    template: NDArray[np.uint8],
    picture: NDArray[np.uint8],
    points: _Array,
    there: _Array,
    found: NDArray[np.uint8],
    smooth: float,
    correlation: _Array,
    sigma: _Array,
) -> None:
    """Write the correlation of patches in two pictures to ``correlation``, their shift's deviation (px) to ``sigma``.

    Patches that are not ``found``, or cross the edge of a picture, are left out.
    """
    high, wide = picture.shape
    n = 2 * _PATCH_HALF_SIZE_PX + 1
    a, b = np.empty((n, n)), np.empty((n, n))
    for i in range(len(points)):
        edge = _PATCH_HALF_SIZE_PX + 1.0
        x, y, u, v = points[i, 0], points[i, 1], there[i, 0], there[i, 1]
        inside = (
            edge <= x < wide - edge and edge <= y < high - edge and edge <= u < wide - edge and edge <= v < high - edge
        )
        if found[i] == 0 or not inside:
            continue
        mean_a = mean_b = 0.0
        dark = False
        for r in range(n):
            for c in range(n):
                a[r, c] = _interpolate_grey(template, x + c - _PATCH_HALF_SIZE_PX, y + r - _PATCH_HALF_SIZE_PX)
                b[r, c] = _interpolate_grey(picture, u + c - _PATCH_HALF_SIZE_PX, v + r - _PATCH_HALF_SIZE_PX)
                mean_a += a[r, c]
                mean_b += b[r, c]
        for r in range(n):
            dark = dark or a[r, 0] == 0.0 or a[r, n - 1] == 0.0  # the template ends here
        mean_a /= n * n
        mean_b /= n * n
        aa = bb = ab = 0.0
        for r in range(n):
            for c in range(n):
                p, q = a[r, c] - mean_a, b[r, c] - mean_b
                aa += p * p
                bb += q * q
                ab += p * q
        if aa <= 0.0 or bb <= 0.0 or dark:
            continue
        rho = ab / math.sqrt(aa * bb)
        gain = math.sqrt(bb / aa)
        gxx = gyy = gxy = 0.0
        for r in range(1, n - 1):
            for c in range(1, n - 1):
                gx, gy = 0.5 * (a[r, c + 1] - a[r, c - 1]), 0.5 * (a[r + 1, c] - a[r - 1, c])
                gxx += gx * gx
                gyy += gy * gy
                gxy += gx * gy
        differ = (aa * gain * gain + bb - 2 * gain * ab) / (n * n)
        share = max(rho, 0.05) * gain * gain
        det = (gxx * gyy - gxy * gxy) * share
        correlation[i] = rho
        # Smoothing correlates the noise of neighbouring pixels: all within one smoothing spot count as one.
        alike = max(1.0, 4.0 * math.pi * smooth * smooth)
        sigma[i] = math.sqrt(0.5 * alike * differ * (gxx + gyy) / max(det, 1e-9))
