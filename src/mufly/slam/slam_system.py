"""Visual SLAM: positions with covariance from pictures, by tracking of keyframes, loop closure and relocalisation.

A picture is undistorted, and its pose is predicted from the last result, velocity and rates. The keyframe with the
largest overlap is warped to that pose, its points are tracked in the picture (:mod:`mufly.slam.image_tools`), and the
camera's pose follows from them (:mod:`mufly.slam.camera_pose`). Residuals of inliers correct the keyframe's points,
which averages vibration and noise out of the map. When the overlap is small, the picture becomes a new keyframe.

At intervals the picture is matched to a keyframe without an edge to the present one that should be in view. A loop
closes under three conditions: enough inliers, a result within the covariance of the map, and no other place within
reach that looks the same. On a floor of tiles the covariance alone decides; if it is too large, no loop closes.

Results that are not trusted are not published; :class:`TrackingResult` gives the reason. After a loss the system
searches around the predicted pose first, later in the whole map by ORB (Rublee et al. 2011). It accepts the latter
when three results agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, body_from_camera_rotation, check_picture_size
from mufly.slam.camera_frame import CameraFrame, Odometry
from mufly.slam.camera_pose import (
    POSE_SIZE,
    PX_HEIGHT,
    PX_KEYFRAME_TILT,
    PX_TILT,
    SHAKE_SIZE,
    PoseEstimate,
    ViewPrior,
    attitude_matrix,
    d_rays_d_tilt,
    normalised_rays,
    ransac_two_points,
    solve_pose,
)
from mufly.slam.image_tools import (
    Undistorter,
    detect_corners,
    is_in_mask,
    match_brightness,
    track_points,
    warp_over_picture,
    warp_picture,
)
from mufly.slam.images.camera_monitor import CameraMonitor, CameraVerdict
from mufly.slam.images.direct_alignment import FloorPoints, add_point_errors, align_picture, floor_axes
from mufly.slam.images.patch_information import measure_patches, remove_background
from mufly.slam.keyframe_map import FloorMap, Keyframe, compose_pose, remove_pose_fit, view_overlap
from mufly.slam.place_recognition import MIN_INLIERS, correlate_pictures, is_unambiguous, relocalize_by_orb
from mufly.slam.pose_graph import (
    EDGE_SIZE,
    EDGE_TILT_A,
    EDGE_TILT_B,
    HEADING,
    LN_HEIGHT,
    PLACE,
    TILT,
    GraphEdge,
    fuse_pose,
    relative_pose,
    relative_pose_jacobians,
)

_Array = NDArray[np.float64]
MIN_CORRELATION = 0.5
MIN_HEIGHT_M = 0.1  # least camera height for the start of a map
TOO_NEAR_REASON = "too near to the floor"
"""Reason of a missing result below that height."""
DIRT_MESSAGE = "dirt on the lens: a part of the picture does not move with the floor and is not used"
FEW_INLIERS = 30  # below this number of inliers a new keyframe may help
NEW_KEYFRAME_OVERLAP = 0.55  # least overlap of a keyframe and the picture
LOOP_MIN_OVERLAP, LOOP_CHECK_INTERVAL = 0.4, 8
LOOP_MAX_CHI2 = 28.0  # of eight numbers: rejects one true closure in 2000
_LOOP_SEARCH_SIGMAS = 2.5  # standard deviations within which keyframes are searched
VARIANCE_INFLATION = 3.0
"""Ratio of the joint variance of all points to that of independent points, for correlated errors of neighbours.

A compromise over twelve floors (docs/log/2026-11-24-slam-accuracy.md): edges with true tilts need 3.9, results less."""
_WHITE_LEVEL, _MAX_WHITE_SHARE = 248, 0.02
"""Grey level, and largest share of brighter pixels in a keyframe: a camera that was covered overexposes for half a
second, and white areas have no corners."""
_STRAY_PX = 5.0  # maximum unexplained error of a point (pixels)
_TILT_DRIFT_PER_HEIGHT = 0.005
"""Change of position between pictures by tilt errors, over the height (docs/log/2026-11-24-slam-accuracy.md)."""
_LOST_AFTER_S, _RELOCALIZE_INTERVAL = 0.7, 4
_MIN_TRACK_SIGMA_PX = 0.08  # least standard deviation of a tracked point
_MAX_FREE_SIGMA_M = 5.0
"""Largest standard deviation of a place along a direction without texture (m)."""
_MAX_STRIPE_RESIDUAL = 1.7  # of a floor with texture along one direction, where the next stripe looks the same
_HEADING_DRIFT_RAD_S = 0.01  # of integrated rates
_USUAL_ROTOR_SPEED_RAD_S = 400.0  # where it is not reported
_WEAK_SIGNIFICANCE = 1.7  # of the texture, below which a new keyframe follows earlier
_CAUTION_AFTER_S = 0.1  # of results without texture along one direction
_STRIPES_REASON = "the floor shows texture along one direction only"
_MIN_TRACKED_SHARE = 0.75  # of the points in view, below which all patches are aligned together
MAX_KNOWN_SIGMA = (0.5, 0.5, 0.5, 0.5)
"""Standard deviations of N, E, D (m) and heading (rad) from which an axis counts as unknown."""
_NO_DIRECTION = np.zeros((0, 2))
_MIN_CONFIRMATIONS = 3
_SHAKE_GAIN, _SHAKE_LEARNED_FRAMES, _SHAKE_REMAINING_SHARE = 0.02, 150, 0.3
"""Learning of the vibration: weight of a picture, number of pictures, and remaining share of the uncertainty."""
_BRIDGE_AFTER_S, _YOUNG_BRIDGE_AFTER_S, _YOUNG_MAP_KEYFRAMES, _TRIAL_FRAMES = 1.5, 0.1, 5, 25
"""Time (s) after which a lost system continues from the vehicle's estimate; the shorter time for a young map.

A map is young up to this number of keyframes, too few to relocalise. A new keyframe is on trial for this number of
pictures."""


@dataclass(frozen=True)
class TrackingResult:
    """Result of a picture.

    Attributes
    ----------
    time_s : float
        Time of the picture.
    trusted : bool
    reason : str
        Reason why the result is not trusted.
    position : (3,) array
        N, E, D (m) of the vehicle's centre of gravity; NaN if unknown.
    heading : float
        Heading (rad).
    covariance : (4, 4) array
        Covariance of N, E, D, heading. Along a direction without texture it is that of the prediction.
    keyframe : int
        Number of the matched keyframe.
    tracked_count, inlier_count : int
        Tracked points, inliers.
    inlier_pixels : (n, 2) array
        Inliers in the undistorted picture.
    texture_bound_m : float
        Cramer-Rao bound of the place, by the contrast of the floor against the noise of both pictures (m), along the
        least known direction with texture.
    residual_ratio : float
        Ratio of the residuals to their expected size.
    is_new_keyframe, is_loop_closed : bool
        Whether the picture became a keyframe, whether a loop was closed.
    camera_note : str
        Defect of the camera in spite of which the result is trusted.
    """

    time_s: float
    trusted: bool
    reason: str = ""
    position: _Array = field(default_factory=lambda: np.full(3, math.nan))
    heading: float = math.nan
    covariance: _Array = field(default_factory=lambda: np.full((4, 4), math.nan))
    keyframe: int = -1
    tracked_count: int = 0
    inlier_count: int = 0
    inlier_pixels: _Array = field(default_factory=lambda: np.zeros((0, 2)), repr=False)
    residual_ratio: float = math.nan
    texture_bound_m: float = math.nan
    is_new_keyframe: bool = False
    is_loop_closed: bool = False
    camera_note: str = ""

    @property
    def known_axes(self) -> NDArray[np.bool_]:
        """Mask (4,) of N, E, D and heading: whether the deviation is below :data:`MAX_KNOWN_SIGMA`."""
        known: NDArray[np.bool_] = np.diag(self.covariance) < np.square(MAX_KNOWN_SIGMA)
        return known


@dataclass(frozen=True)
class _KeyframeMatch:
    """A picture matched to a keyframe."""

    keyframe: int
    pose: PoseEstimate
    inlier_indices: NDArray[np.intp]  # indices of the inliers
    inlier_pixels: _Array  # inliers in the undistorted picture
    exposure_offsets_s: _Array
    pixel_information: _Array  # (n, 2, 2), with the points' own errors
    tracked_count: int
    shift_px: float  # difference to the prediction (pixels)
    unknown: _Array  # unit vectors N, E (k, 2) of directions without texture
    bound_px: _Array  # Cramer-Rao bound of the shift of all patches in two directions
    significance: float  # of the texture along the least known direction, 1 at the least

    def bound_m(self, view: ViewPrior) -> float:
        """Return the Cramer-Rao bound of the place along the least known direction with texture (m)."""
        bounds = self.bound_px[np.isfinite(self.bound_px) & (self.bound_px > 0.0)]
        return float(bounds.max(initial=0.0)) * view.height_m / view.focal_px or math.nan

    @property
    def graph_node(self) -> _Array:
        p = self.pose
        return np.array([*p.state[:2], p.heading_rad, math.log(p.height_m)])


class SlamSystem:
    """Visual SLAM over a floor.

    Parameters
    ----------
    camera : Camera
    floor_map : FloorMap, optional
        Map in which to localise; by default a new one that begins at the first picture.
    start : (3,) array_like
        N, E (m), heading (rad) of the vehicle at the first picture of a new map.
    seed : int
        Seed of the random point pairs.
    """

    def __init__(
        self,
        camera: Camera,
        floor_map: FloorMap | None = None,
        *,
        start: Any = (0.0, 0.0, 0.0),
        seed: int = 0,
    ) -> None:
        self.camera = camera
        self.floor_map = FloorMap(start) if floor_map is None else floor_map
        self._undistorter = Undistorter(camera)
        self._has_given_map = floor_map is not None
        self._body_from_camera, self._camera_position_m = (
            body_from_camera_rotation(camera),
            camera.mount.place.to_array()[0],
        )
        self._rng = np.random.default_rng(seed)
        size, focal = self._undistorter.picture_size, self._undistorter.focal_px
        self._view_width_ratio, self._view_height_ratio = size[0] / focal, size[1] / focal
        self._has_rolling_shutter = float(camera.shutter.readout) > 0.005
        shaking = float(camera.quality.shaking)
        self._shake_sigma_px, self._shake_rms_px = 0.5 * shaking, shaking / math.sqrt(2.0)
        self._shake_amplitudes_px, self._shake_frame_count = (
            np.zeros(SHAKE_SIZE),
            0,
        )  # learnt amplitudes, and the number of pictures
        self._shake_tilt_rad = 0.0
        self._reference_index = -1
        self._last_node = np.zeros(4)  # node of the last result
        self._velocity_m_s = np.zeros(2)
        # Predicted errors of tilt and sonar, and their correlation with those of the newest keyframe
        self._predicted_errors, self._error_transition = np.zeros(3), [np.zeros(3), np.ones(3)]
        self._odometry: Odometry | None = None  # since the last result
        self._known_odometry: Odometry | None = None  # since the last result with texture in all directions
        self._last_time_s = math.nan
        self._position_sigma_m = 0.0  # of the predicted position (m)
        self._frame_count = self._frames_since_loop_check = 0
        self._found_poses: list[tuple[float, _Array]] = []
        # For each keyframe, the number of failed loop closures and the overlap at the last one
        self._failed_closures: dict[int, tuple[int, float]] = {}
        self._trial_frame_count = 0  # pictures matched to a keyframe on trial; 0: there is none
        self.undistorted_picture: NDArray[np.uint8] | None = None
        self.monitor = CameraMonitor(camera, self._undistorter.focal_px, self._undistorter.smoothing_sigma_px)
        self.camera_verdicts: dict[str, tuple[float, str]] = {}  # first time (s) and message of each fault
        self._usable = self._undistorter.valid_mask
        self.is_closing_loops = True  # whether loop closure is active
        self.on_closure: Callable[[int, int], None] = lambda a, b: None

    # ------------------------------------------------------------------ Processing of a picture

    def process_frame(self, frame: CameraFrame) -> TrackingResult:
        """Process a picture and return its result.

        Raises
        ------
        InputError
            If the picture does not have the camera's size.
        """
        check_picture_size(self.camera, frame.picture.shape, f"picture at {frame.time_s:g} s")
        verdict = self.monitor.check_stamp(frame.time_s, self._last_time_s)
        if frame.time_s <= self._last_time_s:
            return self._refuse(frame, verdict, "older than the picture before")
        self._last_time_s = frame.time_s
        self._frame_count += 1
        if self.monitor.is_copy(frame.picture):
            return self._refuse(frame, self.monitor.frozen_verdict, "a copy of the picture before")
        picture = self.undistorted_picture = self._undistorter.undistort_picture(frame.picture)
        verdict = self.monitor.check_motion(frame, picture)
        if verdict.fault:
            return self._refuse(frame, verdict, "")
        self._usable = self._usable_mask(frame.time_s)
        view = self._make_view(frame)
        if not self.floor_map.keyframes:
            return self._start_map(frame, view, picture)
        if self._odometry is None:
            return self._relocalize(frame, view, picture, "not found in the map yet")
        self._odometry = self._odometry.advance_to(frame.time_s, frame.vehicle_estimate)
        if self._known_odometry is not None:
            self._known_odometry = self._known_odometry.advance_to(frame.time_s, frame.vehicle_estimate)
        elapsed = self._odometry.elapsed_s
        node = self._predict_node(frame, view, self._odometry)
        pixels_off = self._position_sigma_m / view.height_m * view.focal_px
        match = None
        for k in self._select_reference_keyframes(node, elapsed > _LOST_AFTER_S):
            match = self._match_keyframe(k, view, picture, node, coarse=pixels_off > 12.0)
            if match is not None:
                break
        why = self._rejection_reason(match, view, node)
        if match is None or why:
            if (
                len(self.floor_map.keyframes) == 1
                and frame.vehicle_estimate.place is not None
                and not self._has_given_map
            ):
                # Near the floor pictures overlap little: restart a map of one keyframe.
                self.floor_map = FloorMap(self.floor_map.start_pose)
                return self._start_map(frame, view, picture)
            if self._should_bridge(frame, view, elapsed):
                return self._bridge_gap(frame, view, picture, why)
            if elapsed > _LOST_AFTER_S or self._trial_frame_count > 0:
                return self._relocalize(frame, view, picture, why)
            return TrackingResult(frame.time_s, False, why, keyframe=self._reference_index)
        if self._trial_frame_count > 0 and (answer := self._confirm_trial(frame, view, picture, match)) is not None:
            return answer
        return self._accept_match(frame, view, picture, match)

    def _refuse(self, frame: CameraFrame, verdict: CameraVerdict, why: str) -> TrackingResult:
        """Return a result that is not trusted, and keep the verdict on the camera."""
        self._note_verdict(frame.time_s, verdict)
        return TrackingResult(frame.time_s, False, verdict.message or why, keyframe=-1)

    def _note_verdict(self, time_s: float, verdict: CameraVerdict) -> None:
        if verdict.fault:
            self.camera_verdicts.setdefault(verdict.fault, (time_s, verdict.message))

    def _usable_mask(self, time_s: float) -> NDArray[np.uint8]:
        """Return the mask of the undistorted picture without its border and dirt."""
        dirt = self.monitor.dirt_mask
        if dirt is None:
            return self._undistorter.valid_mask
        self._note_verdict(time_s, CameraVerdict("dirt", DIRT_MESSAGE))
        return np.where(dirt > 0, 0, self._undistorter.valid_mask).astype(np.uint8)

    def _make_view(self, frame: CameraFrame) -> ViewPrior:
        told = frame.vehicle_estimate
        # With a global shutter, vibration looks like any tilt; only its phase distinguishes it.
        modelled = bool(told.rotor_speed.any()) and (self._has_rolling_shutter or told.rotor_phase is not None)
        self._shake_tilt_rad = (
            0.0 if self._has_rolling_shutter or modelled else self._shake_rms_px / self._undistorter.focal_px
        )
        view = ViewPrior(
            self._undistorter.focal_px,
            self._body_from_camera,
            told.roll,
            told.pitch,
            told.rates,
            np.zeros(3),
            1.0,
            told.height_sigma,
            self._shake_sigma_px if modelled else 0.0,
            told.rotor_speed,
        )
        if told.rotor_phase is not None:
            view = view._replace(rotor_phases_rad=told.rotor_phase, shake_amplitudes_px=self._shake_amplitudes_px)
            if self._shake_frame_count > _SHAKE_LEARNED_FRAMES:
                view = view._replace(shake_sigma_px=_SHAKE_REMAINING_SHARE * view.shake_sigma_px)
        height = max(MIN_HEIGHT_M, told.height_m)
        self._predicted_errors, *self._error_transition = self.floor_map.predict_sensor_errors(
            frame.time_s, (told.tilt_sigma, told.tilt_time_s, self._shake_tilt_rad),
            (told.height_sigma / height, told.height_time_s),
        )  # fmt: skip
        view = view._replace(tilt_error_rad=self._predicted_errors[:2])
        turn = attitude_matrix(view, None, self._last_node[HEADING])
        velocity = np.array([*self._velocity_m_s, 0.0]) if told.velocity is None else told.velocity
        velocity = velocity + turn @ np.cross(told.rates, self._camera_position_m)
        return view._replace(
            velocity_m_s=velocity,
            height_m=max(0.05, told.height_m - float((turn @ self._camera_position_m)[2])),
        )

    def _predict_node(self, frame: CameraFrame, view: ViewPrior, way: Odometry) -> _Array:
        """Return the predicted node and set ``_position_sigma_m``, its standard deviation (m).

        The prediction is the odometry since the last result, or after a time without one the vehicle's estimate, if
        that is more accurate.
        """
        moved, self._position_sigma_m = way.predict_displacement(self._velocity_m_s)
        believed = 0.05 + 2.0 * frame.vehicle_estimate.place_sigma[0]
        if (
            way.elapsed_s > _LOST_AFTER_S
            and frame.vehicle_estimate.place is not None
            and believed < self._position_sigma_m
        ):
            n, e, heading = frame.vehicle_estimate.place
            self._position_sigma_m = believed
            return self._node_from_pose(self._pose_from_vehicle(view, n, e, heading))[:4]
        return np.append(self._last_node[:LN_HEIGHT] + moved, math.log(view.height_m))

    def _select_reference_keyframes(self, node: _Array, lost: bool) -> list[int]:
        """Return keyframes to match: the last one, unless another is much better; all, if tracking is lost."""
        near = (
            range(len(self.floor_map.keyframes))
            if lost
            else {self._reference_index, *self.floor_map.connected_keyframes(self._reference_index)}
        )
        share = {
            k: view_overlap(self.floor_map.nodes[k], node, self._view_width_ratio, self._view_height_ratio)
            for k in near
        }
        share[self._reference_index] += 0.1
        ordered = sorted(share, key=lambda k: -share[k])
        return [k for k in ordered[:2] if share[k] > 0.15] or [self._reference_index]

    # ------------------------------------------------------------------ Matching to a keyframe

    def _match_keyframe(
        self, k: int, view: ViewPrior, picture: Any, node: _Array, coarse: bool = False
    ) -> _KeyframeMatch | None:
        """Match a picture to keyframe ``k`` from about ``node``; return None without a match."""
        straight, keyframe, at = self._undistorter, self.floor_map.keyframes[k], self.floor_map.nodes[k]
        shift = 0.0
        if coarse:
            found = self._align_coarsely(k, view, picture, node, 3.0 * self._position_sigma_m + 0.03)
            if found is None:
                return None
            shift = math.hypot(*(found[:2] - node[:2])) / view.height_m * view.focal_px
            node = found
        homography = self._floor_homography(k, view, node)
        template, covered = warp_over_picture(match_brightness(keyframe.picture, picture), homography, picture)
        h = np.column_stack([keyframe.pixels, np.ones(len(keyframe.pixels))]) @ homography.T
        there = h[:, :2] / h[:, 2:]
        clean = is_in_mask(self._usable, there) & is_in_mask(self._usable, keyframe.pixels)
        use = np.nonzero((h[:, 2] > 0) & (keyframe.missed < 8) & is_in_mask(covered, there) & clean)[0]
        if len(use) < MIN_INLIERS:
            return None
        tilts = self.floor_map.predict_covariance(k, *self._error_transition)[4:8, 4:8][
            np.ix_([2, 3, 0, 1], [2, 3, 0, 1])
        ]
        # A match further away than the total uncertainty is a false one, for example the next tile.
        unsure = 0.0 if coarse else self._position_sigma_m / view.height_m * view.focal_px
        tilted = view.focal_px * math.sqrt(tilts[0, 0] + tilts[2, 2])
        reach = _STRAY_PX + 4.0 * unsure + 3.0 * (self._shake_rms_px + tilted)
        # Without repeats, a search over the whole picture is best.
        looked = reach if len(self.floor_map.repeat_offsets(k, view.focal_px)) else math.inf
        seen, correlation, sigma = track_points(template, picture, there[use], straight.smoothing_sigma_px, looked)
        good = (correlation > MIN_CORRELATION) & (sigma < 1.5)
        good &= is_in_mask(self._usable, seen) & (np.hypot(*(seen - there[use]).T) < reach)
        flat = remove_background(template), remove_background(picture)
        points = FloorPoints(
            self.floor_map.locate_points(k)[use],
            self.floor_map.points_tilt_jacobian(k)[use],
            tilts,
            # In pixels of the present picture
            np.sqrt(keyframe.variance[use]) * math.exp(at[LN_HEIGHT]) / view.height_m * view.focal_px,
            there[use],
            straight.exposure_offsets(there[use]),
        )
        match = None
        if good.sum() >= MIN_INLIERS:
            match = self._match_points(k, view, node, flat, points, use, good, seen, sigma, shift)
        if match is not None and len(match.inlier_indices) >= _MIN_TRACKED_SHARE * len(use):
            return match
        # Few points of a weak floor are tracked, while all its patches together are known well.
        direct = self._match_directly(k, view, node, flat, points, use, shift)
        if direct is not None and (match is None or not len(direct.unknown)):
            return direct
        if match is None and not coarse and len(keyframe.pixels) >= MIN_INLIERS:
            return self._match_keyframe(k, view, picture, node, coarse=True)
        return match

    def _match_points(
        self, k: int, view: ViewPrior, node: _Array, flat: tuple[Any, Any], points: FloorPoints,
        use: NDArray[np.intp], good: NDArray[np.bool_], seen: _Array, sigma: _Array, shift: float,
    ) -> _KeyframeMatch | None:  # fmt: skip
        """Match tracked points to keyframe ``k``; return None if they disagree, or show texture in one direction."""
        straight, keyframe = self._undistorter, self.floor_map.keyframes[k]
        use, seen, sigma = use[good], seen[good], sigma[good]
        places, bend, own = (q[good] for q in (points.positions_m, points.tilt_jacobian, points.sigma_px))
        seconds, pixels = straight.exposure_offsets(seen), seen - straight.principal_point
        sigma = np.hypot(np.hypot(sigma, _MIN_TRACK_SIGMA_PX), own)
        rough = np.hypot(np.hypot(sigma, 0.5), self._shake_rms_px) / view.focal_px
        _, _, _, fits = ransac_two_points(
            places[:, 0] + 1j * places[:, 1],
            normalised_rays(view, pixels, seconds, attitude_matrix(view), view.shake_amplitudes_px),
            rough,
            view.height_m,
            view.height_sigma_m,
            self._rng,
        )
        if fits.sum() < MIN_INLIERS:
            return None
        begin = np.array([node[0], node[1], view.height_m, node[HEADING]])
        isotropic = sigma[:, None, None] ** -2 * np.eye(2)
        pose = solve_pose(
            view, begin, places[fits], bend[fits], points.tilt_covariance, pixels[fits], seconds[fits], isotropic[fits]
        )
        if pose.inlier_mask.sum() < MIN_INLIERS:
            return None
        keep = np.nonzero(fits)[0][pose.inlier_mask]
        # Tracks fit the noise of their patch, so the texture is measured where the pose expects each point.
        expected = seen[keep] - pose.pixel_residuals[pose.inlier_mask]
        axes = floor_axes(view, pose.state, pose.shake_amplitudes_px, places[keep], bend[keep], seconds[keep])
        patches = measure_patches(
            *flat, points.template_pixels[good][keep], expected, straight.smoothing_sigma_px, axes,
            row_slope=self._row_slope(view), caution=self._caution,
        )  # fmt: skip
        if not patches.known.all():
            return None
        information = add_point_errors(patches.information, np.hypot(own[keep], _MIN_TRACK_SIGMA_PX))
        pose = solve_pose(
            view, pose.state[:PX_TILT], places[keep], bend[keep], points.tilt_covariance, pixels[keep], seconds[keep],
            information,
        )  # fmt: skip
        out = np.ones(len(use), bool)
        out[keep] = False
        keyframe.missed[use[out]] += 1
        keyframe.missed[use[keep]] = np.maximum(keyframe.missed[use[keep]] - 2, -4)
        return _KeyframeMatch(
            k, pose, use[keep], seen[keep], seconds[keep], information, len(use), shift, _NO_DIRECTION,
            patches.bound_px, float(patches.significance.min()),
        )  # fmt: skip

    def _match_directly(
        self, k: int, view: ViewPrior, node: _Array, flat: tuple[Any, Any], points: FloorPoints,
        use: NDArray[np.intp], shift: float,
    ) -> _KeyframeMatch | None:  # fmt: skip
        """Match all patches of a picture to keyframe ``k`` together; return None without texture in any direction."""
        straight = self._undistorter
        begin = np.array([node[0], node[1], view.height_m, node[HEADING]])
        points = points._replace(sigma_px=np.hypot(points.sigma_px, _MIN_TRACK_SIGMA_PX))
        found = align_picture(
            view,
            begin,
            *flat,
            points,
            straight.principal_point,
            straight.smoothing_sigma_px,
            self._free_sigma(),
            self._row_slope(view),
            self._caution,
        )
        if found is None:
            return None
        seen = (np.trace(found.information, axis1=1, axis2=2) > 0.0) & is_in_mask(self._usable, found.pixels)
        keep = np.nonzero(found.pose.inlier_mask & seen)[0]
        if len(keep) < MIN_INLIERS:
            return None
        return _KeyframeMatch(
            k, found.pose, use[keep], found.pixels[keep], points.exposure_offsets_s[keep], found.information[keep],
            len(use), shift, found.unknown, found.patches.bound_px, float(found.patches.significance.min()),
        )  # fmt: skip

    @property
    def _caution(self) -> float:
        """Factor on the texture that a direction needs: larger after results without texture along it."""
        known, latest = self._known_odometry, self._odometry
        striped = known is None or latest is None or known.elapsed_s > latest.elapsed_s + _CAUTION_AFTER_S
        return 2.0 if striped else 1.0

    def _row_slope(self, view: ViewPrior) -> float:
        """Return the rms slope by which vibration bends vertical lines in a rolling shutter."""
        row_s = float(self.camera.shutter.readout) / self.camera.sensor.height
        return self._shake_rms_px * row_s * float(view.rotor_speeds_rad_s.max(initial=_USUAL_ROTOR_SPEED_RAD_S))

    def _free_sigma(self) -> tuple[float, float]:
        """Return the deviations of the predicted place (m) and heading (rad) since a picture showed both directions."""
        if self._known_odometry is None:
            return _MAX_FREE_SIGMA_M, 0.1
        sigma_m = 0.005 + self._known_odometry.predict_displacement(self._velocity_m_s)[1]
        return min(_MAX_FREE_SIGMA_M, sigma_m), 0.003 + _HEADING_DRIFT_RAD_S * self._known_odometry.elapsed_s

    def _floor_homography(self, k: int, view: ViewPrior, node: _Array) -> _Array:
        """Return the homography over the floor from a keyframe's undistorted picture to the view from a node."""
        keyframe, at = self.floor_map.keyframes[k], self.floor_map.nodes[k]
        c, s = math.cos(at[HEADING]), math.sin(at[HEADING])
        x, y = at[TILT] - keyframe.tilt
        tilt = np.array([[1.0, 0.0, y], [0.0, 1.0, -x], [-y, x, 1.0]])
        then = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt @ keyframe.turn
        now = attitude_matrix(view, None, node[HEADING]) @ self._body_from_camera
        h = math.exp(at[LN_HEIGHT])
        way = np.array([at[0] - node[0], at[1] - node[1], view.height_m - h])
        plane = h * np.eye(3) + np.outer(way, [0.0, 0.0, 1.0])
        m = self._undistorter.camera_matrix
        return m @ now.T @ plane @ then @ np.linalg.inv(m)

    def _align_coarsely(self, k: int, view: ViewPrior, picture: Any, node: _Array, reach: float) -> _Array | None:
        """Return the node by correlation of small pictures within a reach (m); None if it is ambiguous."""
        seen = warp_picture(
            self.floor_map.keyframes[k].picture,
            self._floor_homography(k, view, node),
            self._undistorter.picture_size,
        )
        pixel = correlate_pictures(seen, picture, max(10.0, reach / view.height_m * view.focal_px))
        if pixel is None:
            return None
        # The shift of the warped keyframe against the picture is the camera's displacement over the floor.
        d = attitude_matrix(view, None, node[HEADING]) @ self._body_from_camera @ np.append(pixel / view.focal_px, 0.0)
        return node + np.array([d[0] * view.height_m, d[1] * view.height_m, 0.0, 0.0])

    def _rejection_reason(self, match: _KeyframeMatch | None, view: ViewPrior, node: _Array) -> str:
        """Return the reason not to trust a match; "" if it is trusted."""
        if match is None:
            return _STRIPES_REASON if self._caution > 1.0 else "too little of the floor is recognised"
        pose = match.pose
        if len(match.inlier_indices) < max(MIN_INLIERS, 0.4 * match.tracked_count):
            return f"only {len(match.inlier_indices)} of {match.tracked_count} points agree"
        if pose.residual_scale > (_MAX_STRIPE_RESIDUAL if len(match.unknown) else 4.0):
            return "points scatter more than they may"
        # Along directions without texture there is nothing to check.
        known = np.eye(2) - match.unknown.T @ match.unknown
        sigma = math.sqrt((known @ pose.covariance[:2, :2] @ known).diagonal().max())
        if sigma > 0.1 + 0.03 * view.height_m:
            return "the place is not known well enough"
        way = known @ (pose.state[:2] - node[:2])
        off = math.hypot(*way)
        if off > 4.0 * (self._position_sigma_m + sigma) + 0.08 * view.height_m:
            return f"{off:.2f} m off from where it should be"
        if self._odometry is None or not self._odometry.has_all_velocities or self._odometry.last_info.place is None:
            return ""  # there is no ambiguity test for a map that cannot be restarted
        alike = self.floor_map.repeat_offsets(match.keyframe, view.focal_px) @ known
        alike = alike[np.hypot(*alike.T) > 0.03 * view.height_m]
        unsure = math.hypot(self._position_sigma_m, math.sqrt(2.0) * sigma, _TILT_DRIFT_PER_HEIGHT * view.height_m)
        if not is_unambiguous(way, alike, unsure):
            nearest = np.hypot(*alike.T).min()
            return f"the floor repeats every {nearest:.2f} m, and {off:.2f} m off it may be another place"
        return ""

    # ------------------------------------------------------------------ Keyframes, edges and loop closure

    def _accept_match(self, frame: CameraFrame, view: ViewPrior, picture: Any, match: _KeyframeMatch) -> TrackingResult:
        assert self._odometry is not None
        elapsed, node = self._odometry.elapsed_s, match.graph_node
        if 0.0 < elapsed < 0.5:
            gain = min(1.0, 3.0 * elapsed)
            known = np.eye(2) - match.unknown.T @ match.unknown
            self._velocity_m_s = self._velocity_m_s + gain * known @ (
                (node[:2] - self._last_node[:2]) / elapsed - self._velocity_m_s
            )
        else:
            self._velocity_m_s = np.zeros(2)
        self._last_node, self._odometry, self._reference_index = (
            node,
            Odometry(frame.time_s, frame.vehicle_estimate),
            match.keyframe,
        )
        if not len(match.unknown):
            self._known_odometry = self._odometry
        self._found_poses = []
        self.monitor.check_tilt(frame.time_s, match.pose.tilt_error_rad, frame.vehicle_estimate.tilt_sigma)
        self._refine_keyframe(view, match)
        made = closed = False
        share = view_overlap(
            self.floor_map.nodes[match.keyframe], node, self._view_width_ratio, self._view_height_ratio
        )
        few = share < 0.85 and (len(match.inlier_indices) < FEW_INLIERS or match.significance < _WEAK_SIGNIFICANCE)
        if (share < NEW_KEYFRAME_OVERLAP or few) and len(match.inlier_indices) >= MIN_INLIERS:
            made = self._insert_keyframe(frame, view, picture, match)
        self._frames_since_loop_check += 1
        if self.is_closing_loops and (self._frames_since_loop_check >= LOOP_CHECK_INTERVAL or made):
            self._frames_since_loop_check = 0
            made, closed = self._try_loop_closure(frame, view, picture, match, made)
        return self._make_result(frame, view, match, made, closed)

    def _refine_keyframe(self, view: ViewPrior, match: _KeyframeMatch) -> None:
        """Correct the keyframe's points by their residuals, and learn the vibration.

        A rotor at two revolutions a picture shakes consecutive pictures alike: their difference holds little of the
        vibration, which would bend the floor permanently. Slow learning over all phases finds it.
        """
        if view.rotor_phases_rad.any():
            self._shake_frame_count += 1
            gain = max(_SHAKE_GAIN, 1.0 / self._shake_frame_count)
            self._shake_amplitudes_px = self._shake_amplitudes_px + gain * (
                match.pose.shake_amplitudes_px - self._shake_amplitudes_px
            )
        keyframe, at = self.floor_map.keyframes[match.keyframe], self.floor_map.nodes[match.keyframe]
        seen = self._level_rays(view, match.pose, match.inlier_pixels, match.exposure_offsets_s)
        z = match.pose.height_m * np.exp(1j * match.pose.heading_rad)
        c = complex(match.pose.state[0], match.pose.state[1])
        to_keyframe = (c - complex(at[0], at[1]) + z * seen) / np.exp(at[LN_HEIGHT] + 1j * at[HEADING])
        ratio = match.pose.height_m / math.exp(at[LN_HEIGHT])
        # Refer to the tilt error for which the slopes were computed
        tilt = self.floor_map.nodes[match.keyframe, TILT] + match.pose.keyframe_tilt_error_rad - keyframe.tilt
        move = d_rays_d_tilt(keyframe.slopes[match.inlier_indices]) @ tilt
        to_keyframe = to_keyframe - (move[:, 0] + 1j * move[:, 1])
        # Root mean square of both axes; a point with texture along one direction is not refined.
        information = match.pixel_information
        det = np.linalg.det(information)
        sigmas = np.sqrt(0.5 * np.trace(information, axis1=1, axis2=2) / np.maximum(det, 1e-12))
        sigmas = np.where(det > 1e-8, sigmas, 100.0)
        # Residuals that pose and tilt errors can explain are not the floor's shape.
        own = keyframe.slopes[match.inlier_indices]
        to_keyframe = own + remove_pose_fit(to_keyframe - own, own, seen, 1.0 / sigmas)
        keyframe.refine_points(
            match.inlier_indices,
            to_keyframe,
            (sigmas * ratio / view.focal_px) ** 2 + 1e-12,
            view.focal_px,
        )

    def _level_rays(
        self, view: ViewPrior, pose: PoseEstimate, pixels: _Array, seconds: _Array
    ) -> NDArray[np.complex128]:
        """Return slopes with heading 0 of pixels of the undistorted picture, referred to the middle of its exposure."""
        turn = attitude_matrix(view, pose.tilt_error_rad, pose.heading_rad)
        m = normalised_rays(view, pixels - self._undistorter.principal_point, seconds, turn, pose.shake_amplitudes_px)
        move = (view.velocity_m_s[0] + 1j * view.velocity_m_s[1]) * seconds
        down = 1.0 - view.velocity_m_s[2] * seconds / pose.height_m
        return (m * down + move / pose.height_m) * np.exp(-1j * pose.heading_rad)

    def _create_keyframe(
        self, frame: CameraFrame, view: ViewPrior, picture: Any, pose: PoseEstimate, sigma: float
    ) -> Keyframe | None:
        pixels = detect_corners(picture, self._usable)
        if len(pixels) < MIN_INLIERS or np.mean(picture > _WHITE_LEVEL) > _MAX_WHITE_SHARE:
            return None
        seconds = self._undistorter.exposure_offsets(pixels)
        turn = _remove_heading(attitude_matrix(view, pose.tilt_error_rad, pose.heading_rad), pose.heading_rad)
        return Keyframe(
            frame.time_s,
            picture.copy(),
            turn @ self._body_from_camera,
            pixels,
            self._level_rays(view, pose, pixels, seconds),
            np.full(len(pixels), (sigma / view.focal_px) ** 2),
            np.zeros(len(pixels), np.int64),
            pose.tilt_error_rad.copy(),
            math.log(view.height_m),
            view.height_sigma_m / view.height_m,
            frame.vehicle_estimate.height_time_s,
            frame.vehicle_estimate.tilt_sigma,
            frame.vehicle_estimate.tilt_time_s,
            self._shake_tilt_rad,
        )

    def _start_map(self, frame: CameraFrame, view: ViewPrior, picture: Any) -> TrackingResult:
        """Create the first keyframe of a map."""
        if view.height_m < MIN_HEIGHT_M:
            return TrackingResult(frame.time_s, False, TOO_NEAR_REASON)
        if frame.vehicle_estimate.place is not None:
            self.floor_map.start_pose, self.floor_map.start_sigma = (
                frame.vehicle_estimate.place,
                frame.vehicle_estimate.place_sigma,
            )
        n, e, heading = self.floor_map.start_pose
        pose = self._pose_from_vehicle(view, n, e, heading)
        keyframe = self._create_keyframe(frame, view, picture, pose, math.hypot(0.5, self._shake_rms_px))
        if keyframe is None:
            return TrackingResult(frame.time_s, False, "no corners on the floor to begin a map with, or too bright")
        self._reference_index = self.floor_map.add_keyframe(keyframe, self._node_from_pose(pose), [])
        self._last_node = self.floor_map.nodes[self._reference_index, PLACE].copy()
        self._odometry = self._known_odometry = Odometry(frame.time_s, frame.vehicle_estimate)
        nobody = np.zeros(0, np.intp)
        match = _KeyframeMatch(
            0, pose, nobody, np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2, 2)), 0, 0.0, _NO_DIRECTION, np.zeros(2), 1.0
        )
        answer = self._make_result(frame, view, match, True, False)
        if frame.vehicle_estimate.place is None:
            return answer
        # The result only repeats the input.
        return replace(answer, trusted=False, reason="the map begins")

    def _should_bridge(self, frame: CameraFrame, view: ViewPrior, elapsed: float) -> bool:
        """Return whether to continue from the vehicle's estimate, since no keyframe is recognised."""
        if frame.vehicle_estimate.place is None or view.height_m < MIN_HEIGHT_M or self._should_relocalize:
            return False
        return self._trial_frame_count > 0 or elapsed > (
            _YOUNG_BRIDGE_AFTER_S if self._is_map_young else _BRIDGE_AFTER_S
        )

    @property
    def _should_relocalize(self) -> bool:
        """Return whether to search the whole map with this picture."""
        return not self._is_map_young and (bool(self._found_poses) or self._frame_count % _RELOCALIZE_INTERVAL == 0)

    @property
    def _is_map_young(self) -> bool:
        """Whether the map is too small for relocalisation."""
        return len(self.floor_map.keyframes) - (self._trial_frame_count > 0) <= _YOUNG_MAP_KEYFRAMES

    def _confirm_trial(
        self, frame: CameraFrame, view: ViewPrior, picture: Any, match: _KeyframeMatch
    ) -> TrackingResult | None:
        """Match another picture to the keyframe on trial; return None once the keyframe is trusted.

        Until then the rest of the map is searched, too: relocalisation there replaces the trial.
        """
        if self._should_relocalize and (found := self._find_in_map(frame, view, picture)) is not None:
            return self._accept_match(frame, view, picture, found)
        self._trial_frame_count += 1
        if self._trial_frame_count <= (_MIN_CONFIRMATIONS if self._is_map_young else _TRIAL_FRAMES):
            self._last_node, self._odometry = match.graph_node, Odometry(frame.time_s, frame.vehicle_estimate)
            self._known_odometry = self._odometry
            self._refine_keyframe(view, match)
            return TrackingResult(frame.time_s, False, "new map begun, not yet confirmed")
        self._trial_frame_count = 0
        return None

    def _bridge_gap(self, frame: CameraFrame, view: ViewPrior, picture: Any, why: str) -> TrackingResult:
        """Create a keyframe on trial at the vehicle's estimate, with an edge to the last one of that uncertainty."""
        if self._trial_frame_count > 0:
            self.floor_map.drop_last_keyframe()
            self._reference_index = len(self.floor_map.keyframes) - 1
            self._trial_frame_count = 0
        assert frame.vehicle_estimate.place is not None
        n, e, heading = (float(q) for q in frame.vehicle_estimate.place)
        pose = self._pose_from_vehicle(view, n, e, heading)
        keyframe = self._create_keyframe(frame, view, picture, pose, math.hypot(0.5, self._shake_rms_px))
        if keyframe is None:
            return TrackingResult(frame.time_s, False, "no corners on the floor, or too bright")
        place, turn = frame.vehicle_estimate.place_sigma
        last, second = self._reference_index, len(self.floor_map.keyframes)
        node, before = self._node_from_pose(pose), self.floor_map.nodes[last]
        h = math.exp(before[LN_HEIGHT])
        off = np.array([place / h, place / h, max(turn, 1e-3), 0.1])
        edge = GraphEdge(
            last, second, np.concatenate([relative_pose(before, node), before[TILT], node[TILT]]),
            np.diag(np.concatenate([off**-2, np.zeros(4)])),
        )  # fmt: skip
        self._reference_index = self.floor_map.add_keyframe(keyframe, node, [edge])
        self._last_node, self._odometry = (
            self.floor_map.nodes[self._reference_index, PLACE].copy(),
            Odometry(frame.time_s, frame.vehicle_estimate),
        )
        self._known_odometry = self._odometry
        self._trial_frame_count = 1
        return TrackingResult(frame.time_s, False, why)

    def _pose_from_vehicle(self, view: ViewPrior, n: float, e: float, heading: float) -> PoseEstimate:
        """Return the pose of a vehicle at N, E (m) with a heading (rad), as far as it is known."""
        lever = attitude_matrix(view, None, heading) @ self._camera_position_m
        x = np.array([n + lever[0], e + lever[1], view.height_m, heading, *view.tilt_error_rad, 0.0, 0.0])
        nothing = np.zeros((POSE_SIZE, POSE_SIZE))
        return PoseEstimate(
            x,
            self._shake_amplitudes_px,
            nothing,
            nothing,
            np.zeros(POSE_SIZE),
            1.0,
            np.zeros(0),
            np.zeros((0, 2)),
        )

    def _insert_keyframe(self, frame: CameraFrame, view: ViewPrior, picture: Any, match: _KeyframeMatch) -> bool:
        """Make a keyframe of the picture."""
        keyframe = self._create_keyframe(frame, view, picture, match.pose, 0.4)
        if keyframe is None:
            return False
        # Edges to other keyframes that see it constrain it better
        others = sorted(
            self.floor_map.connected_keyframes(match.keyframe),
            key=lambda k: (
                -view_overlap(
                    self.floor_map.nodes[k], match.graph_node, self._view_width_ratio, self._view_height_ratio
                )
            ),
        )
        node = match.graph_node
        k = self.floor_map.add_keyframe(
            keyframe,
            self._node_from_pose(match.pose),
            [self._make_edge(match, len(self.floor_map.keyframes))],
        )
        # It is the newest keyframe from here on
        self._error_transition, view = (
            [np.ones(3), np.full(3, 1e-10)],
            view._replace(tilt_error_rad=self.floor_map.nodes[k, TILT].copy()),
        )
        for other in others[:1]:
            if view_overlap(self.floor_map.nodes[other], node, self._view_width_ratio, self._view_height_ratio) > 0.25:
                second = self._match_keyframe(other, view, picture, node)
                if second is not None and not self._rejection_reason(second, view, node):
                    self.floor_map.try_add_edge(self._make_edge(second, k))
        self._reference_index, self._last_node = k, self.floor_map.nodes[k, PLACE].copy()
        return True

    def _node_from_pose(self, pose: PoseEstimate) -> _Array:
        """Return the node of a pose: N, E, heading, ln h, errors of the tilt and of the sonar."""
        height_error = self._predicted_errors[2]
        return np.array(
            [*pose.state[:2], pose.heading_rad, math.log(pose.height_m), *pose.tilt_error_rad, height_error]
        )

    def _make_edge(self, match: _KeyframeMatch, second: int, closes: bool = False) -> GraphEdge:
        """Return the edge between the matched keyframe and a picture that is node ``second``."""
        at, pose = self.floor_map.nodes[match.keyframe], match.pose
        tilt = at[TILT] + pose.keyframe_tilt_error_rad
        _, by_b = relative_pose_jacobians(at, match.graph_node)
        # Jacobian of N, E, height, heading, tilt of the picture, tilt of the keyframe by the edge's eight numbers
        change = np.zeros((POSE_SIZE, EDGE_SIZE))
        change[:4, :4] = np.linalg.inv(by_b)[[0, 1, LN_HEIGHT, HEADING]]
        change[PX_HEIGHT] *= pose.height_m
        change[PX_TILT:PX_KEYFRAME_TILT, EDGE_TILT_B] = change[PX_KEYFRAME_TILT:, EDGE_TILT_A] = np.eye(2)
        return GraphEdge(
            match.keyframe,
            second,
            np.concatenate([relative_pose(at, match.graph_node), tilt, pose.tilt_error_rad]),
            change.T @ (pose.pixel_information / VARIANCE_INFLATION + pose.prior_information) @ change,
            change.T @ (pose.pixel_gradient / VARIANCE_INFLATION + pose.prior_gradient),
            closes,
        )

    def _try_loop_closure(
        self, frame: CameraFrame, view: ViewPrior, picture: Any, match: _KeyframeMatch, made: bool
    ) -> tuple[bool, bool]:
        """Try to close a loop to a keyframe without an edge to the present one.

        Returns whether the picture is a keyframe, and whether a loop was closed. Candidates are keyframes that the
        map's covariance permits to be in view.
        """
        here = self._reference_index
        most = _LOOP_SEARCH_SIGMAS * math.sqrt(np.linalg.eigvalsh(self.floor_map.joint_covariance(here)[:2, :2])[-1])
        near, may = {here, *self.floor_map.connected_keyframes(here)}, []
        for k in range(len(self.floor_map.keyframes)):
            t = relative_pose(self.floor_map.nodes[k], self._last_node)
            way, h = math.hypot(t[0], t[1]), math.exp(self.floor_map.nodes[k, LN_HEIGHT])
            if k in near or h * way > most + h * math.hypot(self._view_width_ratio, self._view_height_ratio):
                continue
            sigma = math.sqrt(np.linalg.eigvalsh(self.floor_map.edge_covariance(k, here)[:2, :2])[-1])
            t[:2] *= max(0.0, 1.0 - _LOOP_SEARCH_SIGMAS * sigma / max(way, 1e-9))
            node = compose_pose(self.floor_map.nodes[k], t)
            if (
                view_overlap(self.floor_map.nodes[k], node, self._view_width_ratio, self._view_height_ratio)
                > LOOP_MIN_OVERLAP
            ):
                share = view_overlap(
                    self.floor_map.nodes[k], self._last_node, self._view_width_ratio, self._view_height_ratio
                )
                tries, before = self._failed_closures.get(k, (0, 0.0))
                may.append((-round(share - before, 1), tries, -share, k, node, h * sigma))
        if not may:
            return made, False
        # Candidates with the largest gain of overlap since their last trial come first
        _, tries, share, k, node, sigma = min(may, key=lambda m: m[:3])
        self._failed_closures[k] = (tries + 1, -share)
        return self._close_loop(k, frame, view, picture, match, made, node, sigma)

    def _close_loop(
        self,
        k: int,
        frame: CameraFrame,
        view: ViewPrior,
        picture: Any,
        match: _KeyframeMatch,
        made: bool,
        node: _Array,
        sigma: float,
    ) -> tuple[bool, bool]:
        """Close a loop to keyframe ``k`` if all tests pass.

        ``node`` is the predicted pose, ``sigma`` (m) the standard deviation of its position.
        """
        spread, self._position_sigma_m = self._position_sigma_m, 2.0 * sigma
        # Always coarse: this search includes the test for other places that look the same.
        other = self._match_keyframe(k, view, picture, node, coarse=True)
        self._position_sigma_m = spread
        if (
            other is None
            or len(other.unknown)
            or len(other.inlier_indices) < max(1.5 * MIN_INLIERS, 0.5 * other.tracked_count)
            or other.pose.residual_scale > 3.0
        ):
            return made, False
        if not made and not self._insert_keyframe(frame, view, picture, match):
            return False, False
        here = self._reference_index
        edge = self._make_edge(other, here, closes=True)
        off = edge.compute_residual(self.floor_map.nodes[k], self.floor_map.nodes[here])
        if edge.compute_chi2(
            off, self.floor_map.edge_covariance(k, here)
        ) > LOOP_MAX_CHI2 or not self.floor_map.try_add_edge(edge, LOOP_MAX_CHI2):
            return True, False
        self._last_node = self.floor_map.nodes[here, PLACE].copy()
        self._failed_closures = {}
        self.on_closure(k, here)
        return True, True

    def _make_result(
        self, frame: CameraFrame, view: ViewPrior, match: _KeyframeMatch, made: bool, closed: bool
    ) -> TrackingResult:
        """Return the result: the pose fused from map, tilts, sonar and pixels."""
        pose, here = match.pose, self._reference_index
        if made:  # the picture is in the map
            node, known = self.floor_map.nodes[here, PLACE], self.floor_map.joint_covariance(here)[:4, :4]
        else:
            at = self.floor_map.nodes[here]
            tilts = np.concatenate([pose.tilt_error_rad - view.tilt_error_rad, pose.keyframe_tilt_error_rad])
            seen = pose.pixel_information / VARIANCE_INFLATION + pose.prior_information
            pull = pose.pixel_gradient / VARIANCE_INFLATION + pose.prior_gradient
            belief, height = (
                self.floor_map.predict_covariance(here, *self._error_transition),
                math.log(view.height_m) - self._predicted_errors[2],
            )
            node, known = fuse_pose(at[PLACE], belief, match.graph_node, tilts, seen, pull, height)
        for u in match.unknown:  # at least the variance of the prediction since the direction was seen
            along = np.concatenate([u, np.zeros(2)])
            known = known + max(0.0, self._free_sigma()[0] ** 2 - along @ known @ along) * np.outer(along, along)
        lever = attitude_matrix(view, pose.tilt_error_rad, node[HEADING]) @ self._camera_position_m
        h = math.exp(node[LN_HEIGHT])
        position = np.array([node[0] - lever[0], node[1] - lever[1], -h - lever[2]])
        to = np.zeros((4, 4))  # derivatives of N, E, D, heading by N, E, heading, ln h
        to[0, 0] = to[1, 1] = to[-1, HEADING] = 1.0
        to[2, LN_HEIGHT] = -h
        heading = (node[HEADING] + math.pi) % (2 * math.pi) - math.pi
        return TrackingResult(
            frame.time_s, True, "", position, heading, to @ known @ to.T, here,
            match.tracked_count, len(match.inlier_indices), match.inlier_pixels, pose.residual_scale,
            match.bound_m(view), made, closed, "" if self.monitor.dirt_mask is None else DIRT_MESSAGE,
        )  # fmt: skip

    # ------------------------------------------------------------------ Relocalisation

    def _relocalize(self, frame: CameraFrame, view: ViewPrior, picture: Any, why: str) -> TrackingResult:
        """Search the whole map by ORB; accept the result when several in a row agree."""
        lost = TrackingResult(frame.time_s, False, why or "lost", keyframe=-1)
        if self._frame_count % _RELOCALIZE_INTERVAL and not self._found_poses:
            return lost
        match = self._find_in_map(frame, view, picture)
        if match is not None:
            return self._accept_match(frame, view, picture, match)
        return replace(lost, reason="found, to be confirmed") if self._found_poses else lost

    def _find_in_map(self, frame: CameraFrame, view: ViewPrior, picture: Any) -> _KeyframeMatch | None:
        """Match the picture to any keyframe not on trial; return None until several pictures in a row agree."""
        found, self._found_poses = self._found_poses, []
        known = len(self.floor_map.keyframes) - (self._trial_frame_count > 0)
        node = relocalize_by_orb(self.floor_map, known, view, picture, self._undistorter, self._shake_rms_px, self._rng)
        match = None if node is None else self._match_keyframe(node[0], view, picture, node[1])
        if (
            match is None
            or len(match.unknown)
            or len(match.inlier_indices) < 1.5 * MIN_INLIERS
            or match.pose.residual_scale > 3.0
        ):
            return None
        here = match.graph_node
        if found and math.hypot(*(here[:2] - found[-1][1][:2])) > 0.1 + 1.0 * (frame.time_s - found[-1][0]):
            found = []
        self._found_poses = [*found, (frame.time_s, here)]
        if len(self._found_poses) < _MIN_CONFIRMATIONS:
            return None
        if self._trial_frame_count > 0:
            self.floor_map.drop_last_keyframe()
            self._trial_frame_count = 0
        self._odometry, self._velocity_m_s, self._last_node = (
            Odometry(frame.time_s, frame.vehicle_estimate),
            np.zeros(2),
            here,
        )
        self._known_odometry = self._odometry
        return match


def _remove_heading(turn: _Array, heading: float) -> _Array:
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
