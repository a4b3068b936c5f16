r"""Direct alignment: the pose of the camera from patches of a whole picture, for floors whose points cannot be tracked.

On a weak floor (concrete, felt) the texture of a single patch is below the noise, and on a striped floor a point can
slide along the stripe. All patches together still determine the pose. Every patch gives a linear measurement of its
shift,
:mod:`mufly.slam.images.patch_information`, at the pixel where the present pose expects it; the pose follows by
:func:`mufly.slam.camera_pose.solve_pose`, and both are repeated from a quarter of the resolution to the full one.
That is Gauss-Newton on the grey levels of all patches (sparse image alignment: Forster, Pizzoli and Scaramuzza, *SVO*,
2014), with weights for outliers and without the gradients of the noise.

Along a direction without texture the prediction is kept, with its variance. If no direction has texture, there is
no result.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.slam.camera_pose import (
    POSE_HEADING,
    POSE_HEIGHT,
    POSE_TILT,
    PoseEstimate,
    ViewPrior,
    predict_pixels,
    solve_pose,
)
from mufly.slam.image_tools import import_opencv
from mufly.slam.images.patch_information import PatchShifts, measure_patch_shifts

_Array = NDArray[np.float64]
_HALVINGS_AND_PATCH_HALF_SIZES = ((2, 5), (1, 7), (0, 10), (0, 10))
"""Number of halvings of the picture, and half the side of a patch (pixels), for each iteration."""


class FloorPoints(NamedTuple):
    """Points of a keyframe in the view of a picture.

    Attributes
    ----------
    positions_m : (n, 3) array
        N, E, D (m).
    floor_shift_by_tilt : (n, 2, 2) array
        Derivatives along N and E by the keyframe's tilt error (m/rad).
    tilt_covariance : (4, 4) array
        Covariance of the tilt errors of the picture and of the keyframe.
    sigma_px : (n,) array
        Standard deviations of the points in pixels of the picture.
    template_pixels : (n, 2) array
        Pixels in the warped keyframe.
    exposure_offsets_s : (n,) array
    """

    positions_m: _Array
    floor_shift_by_tilt: _Array
    tilt_covariance: _Array
    sigma_px: _Array
    template_pixels: _Array
    exposure_offsets_s: _Array


class AlignedPicture(NamedTuple):
    """A picture aligned to a keyframe.

    Attributes
    ----------
    pose : PoseEstimate
    pixels : (n, 2) array
        Measured pixels of the points.
    information : (n, 2, 2) array
        Information of these pixels (1/pixel^2), reduced by the points' own errors.
    patches : PatchShifts
    untextured_directions : (k, 2) array
        Unit vectors N, E along which the place is only predicted.
    """

    pose: PoseEstimate
    pixels: _Array
    information: _Array
    patches: PatchShifts
    untextured_directions: _Array


def add_point_errors(information: _Array, sigma_px: _Array) -> _Array:
    """Return the information matrices (n, 2, 2) of pixels with errors ``sigma_px`` (n,) of their floor points added."""
    spread = np.eye(2) + (sigma_px**2)[:, None, None] * information
    out = np.linalg.solve(spread, information)
    return np.asarray(0.5 * (out + np.swapaxes(out, 1, 2)))


def pixel_floor_jacobian(
    view: ViewPrior, state: _Array, shakes: _Array, points: _Array, bend: _Array, seconds: _Array
) -> _Array:
    """Return the derivatives (n, 2, 2) of pixels (axis 1) with respect to N and E of their floor points (axis 2).

    Their unit is the focal length (pixels) over the height (m).

    Arguments are those of :func:`mufly.slam.camera_pose.predict_pixels`.
    """
    step = 1e-3 * state[POSE_HEIGHT]
    here = predict_pixels(view, state, shakes, points, bend, seconds)
    moved = [predict_pixels(view, state, shakes, points + step * np.eye(3)[k], bend, seconds) - here for k in (0, 1)]
    return np.stack(moved, axis=2) / (1e-3 * view.focal_px)


def align_picture_with_keyframe(
    view: ViewPrior,
    start: _Array,
    template: NDArray[np.float32],
    picture: NDArray[np.float32],
    points: FloorPoints,
    principal_point: _Array,
    smooth: float,
    unobserved_sigma: tuple[float, float],
    row_slope: float,
    caution: float,
) -> AlignedPicture | None:
    """Align a picture with a warped keyframe; return None if no direction shows texture.

    Parameters
    ----------
    view : ViewPrior
    start : (4,) array
        Predicted N, E, height, heading.
    template, picture : (rows, columns) float32 arrays
        Warped keyframe and picture, without background.
    points : FloorPoints
    principal_point : (2,) array
        Of the undistorted picture (pixels).
    smooth : float
        Smoothing of both pictures (pixels).
    unobserved_sigma : (2,) tuple
        Standard deviations of the prediction along directions without texture (m), and of the heading then (rad).
    row_slope : float
        Rms slope of vertical lines by vibration.
    caution : float
        As for :func:`mufly.slam.images.patch_information.measure_patch_shifts`.
    """
    cv2 = import_opencv()
    pyramid = [(template, picture, smooth)]
    for _ in range(_HALVINGS_AND_PATCH_HALF_SIZES[0][0]):
        t, p, s = pyramid[-1]
        pyramid.append((cv2.pyrDown(t), cv2.pyrDown(p), 0.5 * math.hypot(s, 1.0)))
    seconds, out = points.exposure_offsets_s, None
    begin = np.concatenate([start, view.expected_tilt_error_rad, np.zeros(2)])
    seen = view.shake_amplitudes_px, points.positions_m, points.floor_shift_by_tilt, seconds
    expected, axes = principal_point + predict_pixels(view, begin, *seen), pixel_floor_jacobian(view, begin, *seen)
    for level, half in _HALVINGS_AND_PATCH_HALF_SIZES:
        t, p, s = pyramid[level]
        scale = 2.0**level
        middle = 0.5 * (scale - 1.0)  # of a coarse pixel, in fine ones
        patches = measure_patch_shifts(
            t, p, (points.template_pixels - middle) / scale, (expected - middle) / scale, s, axes, half, row_slope,
            caution,
        )  # fmt: skip
        if not patches.textured_directions.any():
            if level:
                continue
            return None
        information = add_point_errors(patches.information / scale**2, points.sigma_px)
        pixels = expected + scale * patches.shift_px
        untextured_directions = patches.directions[~patches.textured_directions]
        pose = solve_pose(
            view, start, points.positions_m, points.floor_shift_by_tilt, points.tilt_covariance,
            pixels - principal_point, seconds,
            information, _prediction_information(untextured_directions, unobserved_sigma),
        )  # fmt: skip
        expected = pixels - pose.pixel_residuals
        out = AlignedPicture(pose, pixels, information, patches, untextured_directions)
    return out


def _prediction_information(untextured_directions: _Array, sigma: tuple[float, float]) -> _Array | None:
    """Return the information matrix (4, 4) of the predicted pose: directions without texture, and the heading.

    It is None if all directions have texture.

    The heading is included, since vibration bends stripes as a turn does.
    """
    if not len(untextured_directions):
        return None
    out = np.zeros((POSE_TILT, POSE_TILT))
    out[:POSE_HEIGHT, :POSE_HEIGHT] = untextured_directions.T @ untextured_directions / sigma[0] ** 2
    out[POSE_HEADING, POSE_HEADING] = sigma[1] ** -2
    return out
