"""Matching of a picture to a keyframe of the floor's map.

The keyframe is warped to the predicted pose, its points are tracked in the picture (:mod:`mufly.slam.image_tools`), and
the camera's pose follows from them (:mod:`mufly.slam.camera_pose`). If few points of a weak floor are tracked, all
patches are aligned together (:mod:`mufly.slam.images.direct_alignment`). :func:`rejection_reason` tests a match against
the prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.slam.camera_frame import HEADING_DRIFT_RAD_S, TRACKING_LOST_AFTER_S, CameraFrame, MotionPrior
from mufly.slam.camera_pose import (
    POSE_HEADING,
    POSE_TILT,
    PoseEstimate,
    ViewPrior,
    attitude_matrix,
    compute_ray_slopes,
    solve_pose,
    solve_pose_by_ransac,
)
from mufly.slam.image_tools import (
    Undistorter,
    are_pixels_in_mask,
    match_brightness,
    subtract_local_mean,
    track_points,
    warp_over_picture,
    warp_picture,
)
from mufly.slam.images.direct_alignment import (
    FloorPoints,
    add_point_errors,
    align_picture_with_keyframe,
    pixel_floor_jacobian,
)
from mufly.slam.images.patch_information import measure_patch_shifts
from mufly.slam.keyframe_map import FloorMap, view_overlap
from mufly.slam.place_recognition import MIN_ORB_INLIERS, CorrelationPeak, correlate_pictures, is_unambiguous
from mufly.slam.pose_graph import HEADING_INDEX, LOG_HEIGHT_INDEX, TILT_SLICE

_Array = NDArray[np.float64]
MIN_PATCH_CORRELATION = 0.5
_MAX_UNEXPLAINED_PIXEL_ERROR_PX = 5.0  # maximum unexplained error of a point (pixels)
_TILT_DRIFT_PER_HEIGHT = 0.005
"""Change of position between pictures by tilt errors, over the height (docs/log/2026-11-24-slam-accuracy.md)."""
_MAX_UNEXPLAINED_TURN_RAD = 0.015  # change of the heading between pictures by tilt errors (rad)
_MIN_TRACK_SIGMA_PX = 0.08  # least standard deviation of a tracked point
_MAX_STRIPE_RESIDUAL = 1.7  # of a floor with texture along one direction, where the next stripe looks the same
_ASSUMED_ROTOR_SPEED_RAD_S = 400.0  # where it is not reported
_STRIPES_REASON = "the floor shows texture along one direction only"
POINT_VARIANCE_INFLATION = 3.0
"""Ratio of the joint variance of all points to that of independent points, for correlated errors of neighbours.

A compromise over twelve floors (docs/log/2026-11-24-slam-accuracy.md): edges with true tilts need 3.9, results less."""
_COMMON_SHAKE_FRACTION, _COMMON_SIGMA_PX = 0.1, 0.05
"""Deviation of a place that no number of points reduces: fraction of the vibration's rms that remains unmodelled, and
part without vibration (pixels)."""
_JOINT_ALIGNMENT_BELOW_FRACTION = 0.75  # of the points in view, below which all patches are aligned together
_NO_UNKNOWN_DIRECTIONS = np.zeros((0, 2))
_TILT_COVARIANCE_INDEX = np.ix_([6, 7, 4, 5], [6, 7, 4, 5])  # tilt errors of the picture, then of the keyframe


@dataclass(frozen=True)
class FrameContext:
    """A picture before it is matched to a keyframe, with prior knowledge of its pose, sensor errors and vibration.

    Attributes
    ----------
    frame : CameraFrame
    picture : (rows, columns) uint8 array
        Undistorted picture.
    view : ViewPrior
    usable_mask : (rows, columns) uint8 array
        Pixels of the undistorted picture without border and dirt.
    motion : MotionPrior
        Motion since the last results.
    position_sigma_m : float
        Standard deviation of the predicted position along an axis (m).
    predicted_sensor_errors : (3,) array
        Predicted errors of tilt (rad) and sonar (ln h).
    error_transition : tuple of two (3,) arrays
        Factors and noise variances from the newest keyframe's errors to those of the picture.
    undistorter : Undistorter
    shake_rms_px : float
        Rms of the vibration along an axis (pixels).
    shake_tilt_rad : float
        The same as a tilt (rad), where vibration is not modelled.
    row_time_s : float
        Time between the exposures of two rows (s).
    rng : numpy.random.Generator
        Source of the random point pairs.
    """

    frame: CameraFrame
    picture: NDArray[np.uint8]
    view: ViewPrior
    usable_mask: NDArray[np.uint8]
    motion: MotionPrior
    position_sigma_m: float
    predicted_sensor_errors: _Array
    error_transition: tuple[_Array, _Array]
    undistorter: Undistorter
    shake_rms_px: float
    shake_tilt_rad: float
    row_time_s: float
    rng: np.random.Generator

    @property
    def texture_threshold_factor(self) -> float:
        """Factor on the threshold of texture above which a direction counts as known.

        It is larger if the last results lacked texture in one direction.
        """
        return 2.0 if self.motion.has_texture_in_one_direction else 1.0

    @property
    def row_slope(self) -> float:
        """Rms slope by which vibration bends vertical lines in a picture with a rolling shutter."""
        fastest = float(self.view.rotor_speeds_rad_s.max(initial=_ASSUMED_ROTOR_SPEED_RAD_S))
        return self.shake_rms_px * self.row_time_s * fastest

    def view_overlap(self, a: _Array, b: _Array) -> float:
        """Return the share of node ``b``'s view that node ``a`` also sees (:func:`keyframe_map.view_overlap`)."""
        return view_overlap(a, b, *self.undistorter.view_ratios)


@dataclass(frozen=True)
class KeyframeMatch:
    """Result of matching a picture to a keyframe: pose, inliers and their information.

    Attributes
    ----------
    keyframe_index : int
        Number of the keyframe.
    pose : PoseEstimate
    inlier_indices : (n,) int array
        Points of the keyframe that are inliers.
    inlier_pixels : (n, 2) array
        Inliers in the undistorted picture.
    exposure_offsets_s : (n,) array
        Exposure times of the inliers, from the middle of the picture (s).
    pixel_information : (n, 2, 2) array
        Information matrices of the inliers' pixels, reduced by the errors of the keyframe's points (1/pixels^2).
    tracked_count : int
        Number of tracked points.
    untextured_directions : (k, 2) array
        Unit vectors N, E of directions without texture.
    cramer_rao_bound_px : (2,) array
        Cramer-Rao bound of the common shift of all patches along the directions of least and of most texture
        (pixels).
    significances : (2,) array
        Significance of the texture along the directions of least and of most texture, at the pose; 1 is the least with
        which a direction is known.
    common_variance_m2 : float
        Variance of the place by errors that all points of the picture share (m^2).
    """

    keyframe_index: int
    pose: PoseEstimate
    inlier_indices: NDArray[np.intp]
    inlier_pixels: _Array
    exposure_offsets_s: _Array
    pixel_information: _Array
    tracked_count: int
    untextured_directions: _Array
    cramer_rao_bound_px: _Array
    significances: _Array
    common_variance_m2: float = 0.0

    @classmethod
    def from_pose(cls, pose: PoseEstimate) -> KeyframeMatch:
        """Return the match of the first keyframe to itself."""
        nobody = np.zeros(0, np.intp)
        return cls(
            0,
            pose,
            nobody,
            np.zeros((0, 2)),
            np.zeros(0),
            np.zeros((0, 2, 2)),
            0,
            _NO_UNKNOWN_DIRECTIONS,
            np.zeros(2),
            np.ones(2),
        )

    def cramer_rao_bound_m(self, view: ViewPrior) -> float:
        """Return the Cramer-Rao bound (m) of the position along the least certain direction with texture."""
        bounds = self.cramer_rao_bound_px[np.isfinite(self.cramer_rao_bound_px) & (self.cramer_rao_bound_px > 0.0)]
        return float(bounds.max(initial=0.0)) * view.height_m / view.focal_px or math.nan

    @property
    def pose_graph_node(self) -> _Array:
        """N, E (m), heading (rad), ln h of the camera."""
        p = self.pose
        return np.array([*p.state[:2], p.heading_rad, math.log(p.height_m)])

    @property
    def least_texture_significance(self) -> float:
        """Significance of the texture along the least known direction."""
        return float(self.significances.min())

    @property
    def mean_position_variance(self) -> float:
        """Mean variance of N and E due to pixel noise, tilts known (m^2); infinite if a direction shows no texture."""
        if len(self.untextured_directions) or not len(self.inlier_indices):
            return math.inf
        return 0.5 * float(np.trace(np.linalg.inv(self.pose.pixel_information[:POSE_TILT, :POSE_TILT])[:2, :2]))

    @property
    def variance_inflation(self) -> float:
        """Ratio of the pose's variance to that from points with independent errors.

        Neighbouring points have correlated errors (:data:`POINT_VARIANCE_INFLATION`). Vibration that is not modelled
        shifts all points of a picture alike, so the variance does not fall below ``common_variance_m2``.
        """
        return POINT_VARIANCE_INFLATION + self.common_variance_m2 / self.mean_position_variance

    @property
    def textured_projection(self) -> _Array:
        """Projection (2, 2) of N, E onto the directions with texture."""
        known: _Array = np.eye(2) - self.untextured_directions.T @ self.untextured_directions
        return known


def match_keyframe(
    floor_map: FloorMap, k: int, context: FrameContext, node: _Array, coarse: bool = False
) -> KeyframeMatch | None:
    """Match a picture to keyframe ``k``; return None without a match.

    Parameters
    ----------
    floor_map : FloorMap
    k : int
        Index of the keyframe.
    context : FrameContext
    node : (4,) array
        Predicted N, E (m), heading (rad), ln h of the camera.
    coarse : bool
        Whether to correlate small pictures first.
    """
    view, picture, straight = context.view, context.picture, context.undistorter
    keyframe, at = floor_map.keyframes[k], floor_map.nodes[k]
    if coarse:
        found = correlate_keyframe(floor_map, k, context, node)
        if found is None or found[1].is_ambiguous:
            return None
        node = found[0]
    homography = _floor_homography(floor_map, k, context, node)
    template, covered = warp_over_picture(match_brightness(keyframe.picture, picture), homography, picture)
    h = np.column_stack([keyframe.pixels, np.ones(len(keyframe.pixels))]) @ homography.T
    there = h[:, :2] / h[:, 2:]
    clean = are_pixels_in_mask(context.usable_mask, there) & are_pixels_in_mask(context.usable_mask, keyframe.pixels)
    use = np.nonzero((h[:, 2] > 0) & (keyframe.missed < 8) & are_pixels_in_mask(covered, there) & clean)[0]
    if len(use) < MIN_ORB_INLIERS:
        return None
    tilts = floor_map.predict_covariance(k, *context.error_transition)[_TILT_COVARIANCE_INDEX]
    # A match further away than the total uncertainty is a false one, for example the next tile.
    unsure = 0.0 if coarse else context.position_sigma_m / view.height_m * view.focal_px
    tilted = view.focal_px * math.sqrt(tilts[0, 0] + tilts[2, 2])
    reach = _MAX_UNEXPLAINED_PIXEL_ERROR_PX + 4.0 * unsure + 3.0 * (context.shake_rms_px + tilted)
    # Without repeats, a search over the whole picture is best.
    looked = reach if len(floor_map.texture_repeat_offsets(k, view.focal_px)) else math.inf
    seen, correlation, sigma = track_points(template, picture, there[use], straight.smoothing_sigma_px, looked)
    good = (correlation > MIN_PATCH_CORRELATION) & (sigma < 1.5)
    good &= are_pixels_in_mask(context.usable_mask, seen) & (np.hypot(*(seen - there[use]).T) < reach)
    flat = subtract_local_mean(template), subtract_local_mean(picture)
    points = FloorPoints(
        floor_map.locate_points(k)[use],
        floor_map.points_tilt_jacobian(k)[use],
        tilts,
        # In pixels of the present picture
        np.sqrt(keyframe.variance[use]) * math.exp(at[LOG_HEIGHT_INDEX]) / view.height_m * view.focal_px,
        there[use],
        straight.exposure_time_offsets_s(there[use]),
    )
    match = None
    if good.sum() >= MIN_ORB_INLIERS:
        match = _match_points(floor_map, k, context, node, flat, points, use, good, seen, sigma)
    if match is not None and len(match.inlier_indices) >= _JOINT_ALIGNMENT_BELOW_FRACTION * len(use):
        return match
    # Few points of a weak floor are tracked, while all its patches together are known well. Where many points are
    # tracked, all patches may disagree instead: neighbouring bricks look alike.
    direct = _match_directly(k, context, node, flat, points, use)
    if direct is not None and (match is None or direct.mean_position_variance < match.mean_position_variance):
        return direct
    if match is None and not coarse and len(keyframe.pixels) >= MIN_ORB_INLIERS:
        return match_keyframe(floor_map, k, context, node, coarse=True)
    return match


def _match_points(
    floor_map: FloorMap, k: int, context: FrameContext, node: _Array, flat: tuple[Any, Any], points: FloorPoints,
    use: NDArray[np.intp], good: NDArray[np.bool_], seen: _Array, sigma: _Array,
) -> KeyframeMatch | None:  # fmt: skip
    """Match tracked points to keyframe ``k``; return None if they disagree, or have texture in one direction only."""
    view, straight, keyframe = context.view, context.undistorter, floor_map.keyframes[k]
    use, seen, sigma = use[good], seen[good], sigma[good]
    places, bend, own = (q[good] for q in (points.positions_m, points.floor_shift_by_tilt, points.sigma_px))
    seconds, pixels = straight.exposure_time_offsets_s(seen), seen - straight.principal_point
    sigma = np.hypot(np.hypot(sigma, _MIN_TRACK_SIGMA_PX), own)
    rough = np.hypot(np.hypot(sigma, 0.5), context.shake_rms_px) / view.focal_px
    _, _, _, fits = solve_pose_by_ransac(
        places[:, 0] + 1j * places[:, 1],
        compute_ray_slopes(view, pixels, seconds, attitude_matrix(view), view.shake_amplitudes_px),
        rough,
        view.height_m,
        view.height_sigma_m,
        context.rng,
    )
    if fits.sum() < MIN_ORB_INLIERS:
        return None
    begin = np.array([node[0], node[1], view.height_m, node[HEADING_INDEX]])
    isotropic = sigma[:, None, None] ** -2 * np.eye(2)
    pose = solve_pose(
        view, begin, places[fits], bend[fits], points.tilt_covariance, pixels[fits], seconds[fits], isotropic[fits]
    )
    if pose.inlier_mask.sum() < MIN_ORB_INLIERS:
        return None
    keep = np.nonzero(fits)[0][pose.inlier_mask]
    # Tracks fit the noise of their patch, so the texture is measured where the pose expects each point.
    expected = seen[keep] - pose.pixel_residuals[pose.inlier_mask]
    axes = pixel_floor_jacobian(view, pose.state, pose.shake_amplitudes_px, places[keep], bend[keep], seconds[keep])
    patches = measure_patch_shifts(
        *flat, points.template_pixels[good][keep], expected, straight.smoothing_sigma_px, axes,
        row_slope=context.row_slope, caution=context.texture_threshold_factor,
    )  # fmt: skip
    if not patches.textured_directions.all():
        return None
    information = add_point_errors(patches.information, np.hypot(own[keep], _MIN_TRACK_SIGMA_PX))
    pose = solve_pose(
        view, pose.state[:POSE_TILT], places[keep], bend[keep], points.tilt_covariance, pixels[keep], seconds[keep],
        information,
    )  # fmt: skip
    out = np.ones(len(use), bool)
    out[keep] = False
    keyframe.missed[use[out]] += 1
    keyframe.missed[use[keep]] = np.maximum(keyframe.missed[use[keep]] - 2, -4)
    return KeyframeMatch(
        k, pose, use[keep], seen[keep], seconds[keep], information, len(use), _NO_UNKNOWN_DIRECTIONS,
        patches.cramer_rao_bound_px, patches.significance, _common_place_variance(context),
    )  # fmt: skip


def _match_directly(
    k: int, context: FrameContext, node: _Array, flat: tuple[Any, Any], points: FloorPoints, use: NDArray[np.intp]
) -> KeyframeMatch | None:
    """Match all patches of a picture to keyframe ``k`` together; return None without texture in any direction."""
    view, straight = context.view, context.undistorter
    begin = np.array([node[0], node[1], view.height_m, node[HEADING_INDEX]])
    points = points._replace(sigma_px=np.hypot(points.sigma_px, _MIN_TRACK_SIGMA_PX))
    found = align_picture_with_keyframe(
        view,
        begin,
        *flat,
        points,
        straight.principal_point,
        straight.smoothing_sigma_px,
        context.motion.unobserved_sigma,
        context.row_slope,
        context.texture_threshold_factor,
    )
    if found is None:
        return None
    seen = (np.trace(found.information, axis1=1, axis2=2) > 0.0) & are_pixels_in_mask(context.usable_mask, found.pixels)
    keep = np.nonzero(found.pose.inlier_mask & seen)[0]
    if len(keep) < MIN_ORB_INLIERS:
        return None
    return KeyframeMatch(
        k, found.pose, use[keep], found.pixels[keep], points.exposure_offsets_s[keep], found.information[keep],
        len(use), found.untextured_directions, found.patches.cramer_rao_bound_px,
        found.patches.significance, _common_place_variance(context),
    )  # fmt: skip


def _common_place_variance(context: FrameContext) -> float:
    """Return the variance (m^2) that common pixel errors, such as vibration, give to the position along an axis."""
    common_px = math.hypot(_COMMON_SHAKE_FRACTION * context.shake_rms_px, _COMMON_SIGMA_PX)
    return (common_px * context.view.height_m / context.view.focal_px) ** 2


def _unexplained_turn(match: KeyframeMatch, context: FrameContext, node: _Array) -> float:
    """Return the deviation of the heading from its prediction (rad); 0 if it lies within its uncertainty."""
    latest = context.motion.since_last_result
    if latest is None or latest.elapsed_s > TRACKING_LOST_AFTER_S:
        return 0.0
    off = match.pose.heading_rad - float(node[HEADING_INDEX])
    off = abs((off + math.pi) % (2.0 * math.pi) - math.pi)
    sigma = math.sqrt(float(match.pose.covariance[POSE_HEADING, POSE_HEADING]))
    return off if off > _MAX_UNEXPLAINED_TURN_RAD + 4.0 * (sigma + HEADING_DRIFT_RAD_S * latest.elapsed_s) else 0.0


def _floor_homography(floor_map: FloorMap, k: int, context: FrameContext, node: _Array) -> _Array:
    """Return the homography from a keyframe's undistorted picture to the view of the floor from a node."""
    view, keyframe, at = context.view, floor_map.keyframes[k], floor_map.nodes[k]
    c, s = math.cos(at[HEADING_INDEX]), math.sin(at[HEADING_INDEX])
    x, y = at[TILT_SLICE] - keyframe.tilt
    tilt = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [-y, x, 1.0]])
    then = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt @ keyframe.turn
    now = attitude_matrix(view, None, node[HEADING_INDEX]) @ view.body_from_camera
    h = math.exp(at[LOG_HEIGHT_INDEX])
    way = np.array([at[0] - node[0], at[1] - node[1], view.height_m - h])
    plane = h * np.eye(3) + np.outer(way, [0.0, 0.0, 1.0])
    m = context.undistorter.camera_matrix
    return m @ now.T @ plane @ then @ np.linalg.inv(m)


def correlate_keyframe(
    floor_map: FloorMap, k: int, context: FrameContext, node: _Array
) -> tuple[_Array, CorrelationPeak] | None:
    """Correlate a picture with a keyframe at reduced size; return the picture's node (4,) and the correlation peak.

    The shift is searched within three standard deviations of the predicted position. The result is None if there is no
    peak.

    Parameters
    ----------
    floor_map : FloorMap
    k : int
        Index of the keyframe.
    context : FrameContext
    node : (4,) array
        Predicted node of the picture.
    """
    view = context.view
    seen = warp_picture(
        floor_map.keyframes[k].picture,
        _floor_homography(floor_map, k, context, node),
        context.undistorter.picture_size,
    )
    reach = 3.0 * context.position_sigma_m + 0.03
    peak = correlate_pictures(seen, context.picture, max(10.0, reach / view.height_m * view.focal_px))
    if peak is None:
        return None
    # The shift of the warped keyframe against the picture is the camera's displacement over the floor.
    d = (
        attitude_matrix(view, None, node[HEADING_INDEX])
        @ view.body_from_camera
        @ np.append(peak.shift_px / view.focal_px, 0.0)
    )
    return node + np.array([d[0] * view.height_m, d[1] * view.height_m, 0.0, 0.0]), peak


def rejection_reason(floor_map: FloorMap, match: KeyframeMatch | None, context: FrameContext, node: _Array) -> str:
    """Return the reason to reject a match; "" if it is accepted.

    A match is tested by its inliers, its residuals, its covariance, its distance from the predicted ``node`` (4,), and
    the places within reach that look the same (:func:`mufly.slam.place_recognition.is_unambiguous`).
    """
    if match is None:
        return (
            _STRIPES_REASON
            if context.motion.has_texture_in_one_direction
            else "too few points of the floor are recognised"
        )
    pose, height = match.pose, context.view.height_m
    if len(match.inlier_indices) < max(MIN_ORB_INLIERS, 0.4 * match.tracked_count):
        return f"only {len(match.inlier_indices)} of {match.tracked_count} points agree"
    if pose.residual_ratio > (_MAX_STRIPE_RESIDUAL if len(match.untextured_directions) else 4.0):
        return "the points scatter too much"
    # Along directions without texture there is nothing to check.
    known = match.textured_projection
    sigma = math.sqrt((known @ pose.covariance[:2, :2] @ known).diagonal().max())
    if sigma > 0.1 + 0.03 * height:
        return "the position is too uncertain"
    way = known @ (pose.state[:2] - node[:2])
    off = math.hypot(*way)
    if off > 4.0 * (context.position_sigma_m + sigma) + 0.08 * height:
        return f"{off:.2f} m from the predicted position"
    if (turned := _unexplained_turn(match, context, node)) > 0.0:
        return f"turned by {math.degrees(turned):.1f} degrees against the gyroscopes"
    latest = context.motion.since_last_result
    if latest is None or not latest.has_all_velocities or latest.last_info.place is None:
        return ""  # there is no ambiguity test for a map that cannot be restarted
    alike = floor_map.texture_repeat_offsets(match.keyframe_index, context.view.focal_px) @ known
    alike = alike[np.hypot(*alike.T) > 0.03 * height]
    unsure = math.hypot(context.position_sigma_m, math.sqrt(2.0) * sigma, _TILT_DRIFT_PER_HEIGHT * height)
    if not is_unambiguous(way, alike, unsure):
        nearest = np.hypot(*alike.T).min()
        return f"the floor repeats every {nearest:.2f} m, and {off:.2f} m from the prediction it may be another place"
    return ""
