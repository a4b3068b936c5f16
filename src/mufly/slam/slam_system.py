"""Visual SLAM: positions with covariance from pictures, by tracking of keyframes, loop closure and relocalisation.

A picture is undistorted, and its pose is predicted from the last result, velocity and rates. It is matched to the
keyframe with the largest overlap (:mod:`mufly.slam.keyframe_matching`). When the overlap is small, the picture becomes
a new keyframe, and at intervals a loop is searched (:mod:`mufly.slam.map_growth`).

Results that are not trusted are not published; :class:`TrackingResult` gives the reason. After a loss the system
searches around the predicted pose first, later in the whole map by ORB (Rublee et al. 2011). A result of ORB is
accepted when three results agree, and none is farther from the prediction than its deviation allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, body_from_camera_rotation, check_picture_size
from mufly.slam.camera_frame import (
    HEADING_DRIFT_RAD_S,
    TRACKING_LOST_AFTER_S,
    CameraFrame,
    MotionPrior,
    Odometry,
)
from mufly.slam.camera_pose import POSE_SIZE, SHAKE_COEFFICIENT_COUNT, PoseEstimate, ViewPrior, attitude_matrix
from mufly.slam.image_tools import Undistorter
from mufly.slam.images.camera_monitor import FAULTY_MOUNT_TILT_SIGMA_RAD, CameraDiagnosis, CameraMonitor
from mufly.slam.keyframe_map import FloorMap
from mufly.slam.keyframe_matching import FrameContext, KeyframeMatch, match_keyframe, rejection_reason
from mufly.slam.map_growth import (
    SAME_PICTURE_ERROR_TRANSITION,
    LoopSearch,
    correct_keyframe_points,
    create_keyframe,
    insert_keyframe,
    make_node,
    pose_information,
)
from mufly.slam.place_recognition import MIN_ORB_INLIERS, relocalize_by_orb
from mufly.slam.pose_graph import (
    HEADING_INDEX,
    LOG_HEIGHT_INDEX,
    PLACE_SLICE,
    TILT_SLICE,
    GraphEdge,
    fuse_pose,
    relative_pose,
)
from mufly.slam.tracking_breaks import MIN_BREAK_HEIGHT_M, TrackingBreaks

_Array = NDArray[np.float64]
MIN_CAMERA_HEIGHT_M = 0.1  # least camera height for the start of a map
TOO_NEAR_REASON = "too near to the floor"
"""Reason of a missing result below that height."""
DIRT_MESSAGE = "dirt on the lens: pixels that do not move with the floor are not used"
MAX_NEW_KEYFRAME_INLIERS = 30  # below this number of inliers a new keyframe may help
MIN_KEYFRAME_OVERLAP = 0.55  # least overlap of a keyframe and the picture
LOOP_CHECK_INTERVAL_FRAMES = 8
_RELOCALIZE_INTERVAL_FRAMES = 4
_NEW_KEYFRAME_TEXTURE_SIGNIFICANCE = 1.7  # of the texture, below which a new keyframe follows earlier
MAX_KNOWN_AXIS_SIGMA = (0.5, 0.5, 0.5, 0.5)
"""Standard deviations of N, E, D (m) and heading (rad) from which an axis counts as unknown."""
_MIN_RELOCALIZATION_CONFIRMATIONS, _MAX_RELOCALIZATION_SIGMAS, _MAX_RELOCALIZATION_TURN_RAD = 3, 4.0, 0.3
"""Relocalisation by ORB: number of results that must agree, and largest distance from the prediction (in its standard
deviations) and turn against it; a place beyond them looks alike."""
_SHAKE_LEARNING_WEIGHT, _MIN_SHAKE_LEARNING_FRAMES, _SHAKE_REMAINING_FRACTION = 0.02, 150, 0.3
"""Learning of the vibration: weight of a picture, number of pictures, and remaining fraction of the uncertainty."""
_BRIDGE_AFTER_S, _YOUNG_BRIDGE_AFTER_S, _MAX_YOUNG_MAP_KEYFRAMES, _KEYFRAME_TRIAL_FRAMES = 1.5, 0.1, 5, 25
"""Time (s) after which a lost system continues from the vehicle's estimate; the shorter time for a young map.

A map is young up to this number of keyframes, too few to relocalise. A new keyframe is on trial for this number of
pictures."""


@dataclass(frozen=True)
class TrackingResult:
    """Result of a picture: pose with covariance, or the reason why there is none.

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
    keyframe_index : int
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
    camera_fault : str
        Defect of the camera that the checks report (:mod:`mufly.slam.images.camera_monitor`); a result that is trusted
        nevertheless does without the defective pixels, or has a larger covariance.
    """

    time_s: float
    trusted: bool
    reason: str = ""
    position: _Array = field(default_factory=lambda: np.full(3, math.nan))
    heading: float = math.nan
    covariance: _Array = field(default_factory=lambda: np.full((4, 4), math.nan))
    keyframe_index: int = -1
    tracked_count: int = 0
    inlier_count: int = 0
    inlier_pixels: _Array = field(default_factory=lambda: np.zeros((0, 2)), repr=False)
    residual_ratio: float = math.nan
    texture_bound_m: float = math.nan
    is_new_keyframe: bool = False
    is_loop_closed: bool = False
    camera_fault: str = ""

    @property
    def known_axes(self) -> NDArray[np.bool_]:
        """Mask (4,) of N, E, D and heading: whether the standard deviation is below :data:`MAX_KNOWN_AXIS_SIGMA`."""
        known: NDArray[np.bool_] = np.diag(self.covariance) < np.square(MAX_KNOWN_AXIS_SIGMA)
        return known


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
        self._has_given_map = floor_map is not None
        self._undistorter = Undistorter(camera)
        self._body_from_camera = body_from_camera_rotation(camera)
        self._camera_position_m = camera.mount.place.to_array()[0]
        self._rng = np.random.default_rng(seed)
        self._has_rolling_shutter = float(camera.shutter.readout) > 0.005
        shaking = float(camera.quality.shaking)
        self._shake_sigma_px, self._shake_rms_px = 0.5 * shaking, shaking / math.sqrt(2.0)
        self._shake_amplitudes_px = np.zeros(SHAKE_COEFFICIENT_COUNT)  # learnt
        self._shake_frame_count = 0
        self._reference_index = -1
        self._last_node = np.zeros(4)  # node of the last result
        self._motion = MotionPrior()
        self._last_time_s = math.nan
        self._frame_count = self._frames_since_loop_check = 0
        self._found_poses: list[tuple[float, _Array]] = []
        self._loop_search, self._breaks = LoopSearch(), TrackingBreaks()
        self._trial_frame_count = 0  # pictures matched to a keyframe on trial; 0: there is none
        self.undistorted_picture: NDArray[np.uint8] | None = None
        self.monitor = CameraMonitor(camera, self._undistorter.focal_px, self._undistorter.smoothing_sigma_px)
        self.camera_verdicts: dict[str, tuple[float, str]] = {}  # first time (s) and message of each fault
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
        verdict = self.monitor.check_picture_times(frame.time_s, self._last_time_s)
        if frame.time_s <= self._last_time_s:
            return self._make_untrusted_result(frame, verdict, "not later than the previous picture")
        self._last_time_s = frame.time_s
        self._frame_count += 1
        if self.monitor.count_if_copy(frame.picture):
            return self._make_untrusted_result(
                frame, self.monitor.frozen_picture_diagnosis, "a copy of the previous picture"
            )
        picture = self.undistorted_picture = self._undistorter.undistort_picture(frame.picture)
        verdict = self.monitor.check_motion(frame, picture)
        if verdict.fault:
            return self._make_untrusted_result(frame, verdict, "")
        self._motion = self._motion.advance_to(frame, float(self._last_node[HEADING_INDEX]))
        context = self._make_context(frame, picture)
        if not self.floor_map.keyframes:
            return self._start_map(context)
        if self._motion.since_last_result is None:
            return self._relocalize(context, "not found in the map yet")
        return self._track(context)

    def _track(self, context: FrameContext) -> TrackingResult:
        """Match the picture to keyframes that its predicted pose lets it see, and return the result."""
        frame, way = context.frame, context.motion.since_last_result
        assert way is not None
        elapsed = way.elapsed_s
        node, sigma_m = self._predict_node(context, way)
        context = replace(context, position_sigma_m=sigma_m)
        coarse = sigma_m / context.view.height_m * context.view.focal_px > 12.0
        match = None
        for k in self._select_reference_keyframes(context, node, elapsed > TRACKING_LOST_AFTER_S):
            match = match_keyframe(self.floor_map, k, context, node, coarse=coarse)
            if match is not None:
                break
        why = rejection_reason(self.floor_map, match, context, node)
        is_high = context.view.height_m > MIN_BREAK_HEIGHT_M
        if match is not None and not why and is_high:
            why = self._breaks.rejection_reason(match)
        if match is None or why:
            if is_high and not self._trial_frame_count:
                self._count_failure(context, node)
            if (
                len(self.floor_map.keyframes) == 1
                and frame.vehicle_estimate.place is not None
                and not self._has_given_map
            ):
                # Near the floor pictures overlap little: restart a map of one keyframe.
                self.floor_map = FloorMap(self.floor_map.start_pose)
                self._breaks.restart_for_new_map()
                return self._start_map(context)
            if self._should_bridge(context, elapsed):
                return self._bridge_gap(context, why)
            if elapsed > TRACKING_LOST_AFTER_S or self._trial_frame_count > 0:
                return self._relocalize(context, why)
            return TrackingResult(frame.time_s, False, why, keyframe_index=self._reference_index)
        if self._trial_frame_count > 0 and (answer := self._confirm_trial(context, match)) is not None:
            return answer
        if self.monitor.is_motion_doubted and match.keyframe_index >= self._breaks.keyframe_count:
            return self._follow_unconfirmed(context, match, "the motion of the picture is not yet confirmed")
        return self._accept_match(context, match)

    def _count_failure(self, context: FrameContext, node: _Array) -> None:
        """Count a picture without a match at its predicted node; doubt its motion if tracking breaks."""
        k = self._reference_index
        overlap = context.view_overlap(self.floor_map.nodes[k], node)
        keyframe = self.floor_map.keyframes[k].picture
        if self._breaks.add_failure(overlap, context.picture, keyframe, len(self.floor_map.keyframes)):
            self.monitor.restart_flip_test()

    def _make_untrusted_result(self, frame: CameraFrame, verdict: CameraDiagnosis, why: str) -> TrackingResult:
        """Return the result of a picture without a trusted pose, with the reason; a fault of the camera is stored."""
        self._record_camera_fault(frame.time_s, verdict)
        return TrackingResult(frame.time_s, False, verdict.message or why, camera_fault=verdict.message)

    def _record_camera_fault(self, time_s: float, verdict: CameraDiagnosis) -> None:
        if verdict.fault:
            self.camera_verdicts.setdefault(verdict.fault, (time_s, verdict.message))

    def _make_usable_mask(self, time_s: float) -> NDArray[np.uint8]:
        """Return the mask of the undistorted picture without its border and dirt."""
        dirt = self.monitor.dirt_mask
        if dirt is None:
            return self._undistorter.valid_mask
        self._record_camera_fault(time_s, CameraDiagnosis("dirt", DIRT_MESSAGE))
        return np.where(dirt > 0, 0, self._undistorter.valid_mask).astype(np.uint8)

    # ------------------------------------------------------------------ Prediction

    def _make_context(self, frame: CameraFrame, picture: NDArray[np.uint8]) -> FrameContext:
        """Return the picture with the prior of attitude, height and sensor errors; the position is predicted later."""
        told = frame.vehicle_estimate
        # With a global shutter, vibration looks like any tilt; only its phase distinguishes it.
        modelled = bool(told.rotor_speed.any()) and (self._has_rolling_shutter or told.rotor_phase is not None)
        shake_tilt_rad = (
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
            if self._shake_frame_count > _MIN_SHAKE_LEARNING_FRAMES:
                view = view._replace(shake_sigma_px=_SHAKE_REMAINING_FRACTION * view.shake_sigma_px)
        height = max(MIN_CAMERA_HEIGHT_M, told.height_m)
        predicted_sensor_errors, keep, noise = self.floor_map.predict_sensor_errors(
            frame.time_s, (told.tilt_sigma, told.tilt_time_s, shake_tilt_rad),
            (told.height_sigma / height, told.height_time_s),
        )  # fmt: skip
        view = view._replace(expected_tilt_error_rad=predicted_sensor_errors[:2])
        turn = attitude_matrix(view, None, self._last_node[HEADING_INDEX])
        velocity = np.array([*self._motion.velocity_m_s, 0.0]) if told.velocity is None else told.velocity
        velocity = velocity + turn @ np.cross(told.rates, self._camera_position_m)
        view = view._replace(
            velocity_m_s=velocity,
            height_m=max(0.05, told.height_m - float((turn @ self._camera_position_m)[2])),
        )
        return FrameContext(
            frame, picture, view, self._make_usable_mask(frame.time_s), self._motion, 0.0, predicted_sensor_errors,
            (keep, noise), self._undistorter, self._shake_rms_px, shake_tilt_rad,
            float(self.camera.shutter.readout) / self.camera.sensor.height, self._rng,
        )  # fmt: skip

    def _predict_node(self, context: FrameContext, way: Odometry) -> tuple[_Array, float]:
        """Return the predicted node (4,) and the standard deviation of its position (m).

        The prediction is the odometry since the last result, or after a time without one the vehicle's estimate, if
        that is more accurate.
        """
        estimate = context.frame.vehicle_estimate
        moved, sigma_m = way.predict_displacement(context.motion.velocity_m_s)
        believed = 0.05 + 2.0 * estimate.place_sigma[0]
        if way.elapsed_s > TRACKING_LOST_AFTER_S and estimate.place is not None and believed < sigma_m:
            return make_node(context, self._pose_from_vehicle(context.view, *estimate.place))[PLACE_SLICE], believed
        return np.append(self._last_node[:LOG_HEIGHT_INDEX] + moved, math.log(context.view.height_m)), sigma_m

    def _pose_from_vehicle(self, view: ViewPrior, n: float, e: float, heading: float) -> PoseEstimate:
        """Return the camera pose of a vehicle at N, E (m) with a heading (rad), without information from pixels."""
        lever = attitude_matrix(view, None, heading) @ self._camera_position_m
        x = np.array([n + lever[0], e + lever[1], view.height_m, heading, *view.expected_tilt_error_rad, 0.0, 0.0])
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

    def _select_reference_keyframes(self, context: FrameContext, node: _Array, lost: bool) -> list[int]:
        """Return keyframes to match: the last one, unless another is much better; all, if tracking is lost."""
        near = (
            range(len(self.floor_map.keyframes))
            if lost
            else {self._reference_index, *self.floor_map.connected_keyframes(self._reference_index)}
        )
        share = {k: context.view_overlap(self.floor_map.nodes[k], node) for k in near}
        share[self._reference_index] += 0.1
        ordered = sorted(share, key=lambda k: -share[k])
        return [k for k in ordered[:2] if share[k] > 0.15] or [self._reference_index]

    # ------------------------------------------------------------------ Accepted matches

    def _accept_match(self, context: FrameContext, match: KeyframeMatch) -> TrackingResult:
        """Update motion and map by a trusted match, and return its result."""
        frame, before = context.frame, self._motion
        assert before.since_last_result is not None
        elapsed, node = before.since_last_result.elapsed_s, match.pose_graph_node
        velocity = np.zeros(2)
        if 0.0 < elapsed < 0.5:
            gain = min(1.0, 3.0 * elapsed)
            velocity = before.velocity_m_s + gain * match.textured_projection @ (
                (node[:2] - self._last_node[:2]) / elapsed - before.velocity_m_s
            )
        now = replace(before, velocity_m_s=velocity).restart_at(frame)
        self._motion = (
            replace(now, since_textured_result=before.since_textured_result)
            if len(match.untextured_directions)
            else now
        )
        context = replace(context, motion=self._motion)
        self._last_node, self._reference_index = node, match.keyframe_index
        self._found_poses = []
        self._breaks.add_match(match)
        if self.monitor.is_motion_doubted:
            self.monitor.end_motion_doubt()
        self.monitor.check_tilt(frame.time_s, match.pose.tilt_error_rad, frame.vehicle_estimate.tilt_sigma)
        self._learn_vibration(context.view, match.pose)
        correct_keyframe_points(self.floor_map, context, match)
        made = closed = False
        inliers = len(match.inlier_indices)
        share = context.view_overlap(self.floor_map.nodes[match.keyframe_index], node)
        few = share < 0.85 and (
            inliers < MAX_NEW_KEYFRAME_INLIERS or match.least_texture_significance < _NEW_KEYFRAME_TEXTURE_SIGNIFICANCE
        )
        if (share < MIN_KEYFRAME_OVERLAP or few) and inliers >= MIN_ORB_INLIERS:
            made = self._insert_keyframe(context, match)
        self._frames_since_loop_check += 1
        if self.is_closing_loops and (self._frames_since_loop_check >= LOOP_CHECK_INTERVAL_FRAMES or made):
            self._frames_since_loop_check = 0
            made, closed = self._try_loop_closure(context, match, made)
        return self._make_result(context, match, made, closed)

    def _learn_vibration(self, view: ViewPrior, pose: PoseEstimate) -> None:
        """Average the amplitudes of the camera's vibration over pictures.

        A rotor that turns twice per picture distorts consecutive pictures alike, so their difference shows little of
        the vibration, and the map would stay distorted. Over many pictures the rotor phases drift, so the average shows
        the vibration.
        """
        if view.rotor_phases_rad.any():
            self._shake_frame_count += 1
            gain = max(_SHAKE_LEARNING_WEIGHT, 1.0 / self._shake_frame_count)
            self._shake_amplitudes_px = self._shake_amplitudes_px + gain * (
                pose.shake_amplitudes_px - self._shake_amplitudes_px
            )

    def _insert_keyframe(self, context: FrameContext, match: KeyframeMatch) -> bool:
        """Make the picture a keyframe and the reference of tracking; return False if the picture is unsuitable."""
        k = insert_keyframe(self.floor_map, context, match)
        if k is None:
            return False
        self._reference_index, self._last_node = k, self.floor_map.nodes[k, PLACE_SLICE].copy()
        return True

    def _try_loop_closure(self, context: FrameContext, match: KeyframeMatch, made: bool) -> tuple[bool, bool]:
        """Try to close a loop; return whether the picture is a keyframe, and whether a loop was closed.

        Candidates are keyframes without an edge to the present one.
        """
        if made:
            context = replace(context, error_transition=SAME_PICTURE_ERROR_TRANSITION)
        other = self._loop_search.match_next_candidate(self.floor_map, self._reference_index, context, self._last_node)
        if other is None or (not made and not self._insert_keyframe(context, match)):
            return made, False
        here = self._reference_index
        if not self._loop_search.close_loop(self.floor_map, other, here):
            return True, False
        self._last_node = self.floor_map.nodes[here, PLACE_SLICE].copy()
        self.on_closure(other.keyframe_index, here)
        return True, True

    def _make_result(self, context: FrameContext, match: KeyframeMatch, made: bool, closed: bool) -> TrackingResult:
        """Return the picture's result, its pose fused from map, tilts, sonar and pixels."""
        view, pose, here = context.view, match.pose, self._reference_index
        if made:  # the picture is in the map
            node, known = self.floor_map.nodes[here, PLACE_SLICE], self.floor_map.joint_covariance(here)[:4, :4]
        else:
            at = self.floor_map.nodes[here]
            tilts = np.concatenate([pose.tilt_error_rad - view.expected_tilt_error_rad, pose.keyframe_tilt_error_rad])
            belief = self.floor_map.predict_covariance(here, *context.error_transition)
            height = math.log(view.height_m) - context.predicted_sensor_errors[2]
            node, known = fuse_pose(
                at[PLACE_SLICE], belief, match.pose_graph_node, tilts, *pose_information(match), height
            )
        for u in match.untextured_directions:  # at least the variance of the prediction since the direction was seen
            along = np.concatenate([u, np.zeros(2)])
            free = context.motion.unobserved_sigma[0] ** 2 - along @ known @ along
            known = known + max(0.0, free) * np.outer(along, along)
        lever = attitude_matrix(view, pose.tilt_error_rad, node[HEADING_INDEX]) @ self._camera_position_m
        h = math.exp(node[LOG_HEIGHT_INDEX])
        position = np.array([node[0] - lever[0], node[1] - lever[1], -h - lever[2]])
        to = np.zeros((4, 4))  # derivatives of N, E, D, heading by N, E, heading, ln h
        to[0, 0] = to[1, 1] = to[-1, HEADING_INDEX] = 1.0
        to[2, LOG_HEIGHT_INDEX] = -h
        heading = (node[HEADING_INDEX] + math.pi) % (2 * math.pi) - math.pi
        covariance, tilted = to @ known @ to.T, self.monitor.diagnose_tilt_at(context.frame.time_s)
        if tilted.fault:
            self._record_camera_fault(context.frame.time_s, tilted)
            covariance[[0, 1], [0, 1]] += (h * FAULTY_MOUNT_TILT_SIGMA_RAD) ** 2
        dirt = "" if self.monitor.dirt_mask is None else DIRT_MESSAGE
        return TrackingResult(
            context.frame.time_s, True, "", position, heading, covariance, here,
            match.tracked_count, len(match.inlier_indices), match.inlier_pixels, pose.residual_ratio,
            match.cramer_rao_bound_m(view), made, closed, tilted.message or dirt,
        )  # fmt: skip

    # ------------------------------------------------------------------ Start of a map, and bridges over gaps

    def _start_map(self, context: FrameContext) -> TrackingResult:
        """Create the first keyframe of a map."""
        frame = context.frame
        if context.view.height_m < MIN_CAMERA_HEIGHT_M:
            return TrackingResult(frame.time_s, False, TOO_NEAR_REASON)
        if frame.vehicle_estimate.place is not None:
            self.floor_map.start_pose, self.floor_map.start_sigma = (
                frame.vehicle_estimate.place,
                frame.vehicle_estimate.place_sigma,
            )
        pose = self._pose_from_vehicle(context.view, *self.floor_map.start_pose)
        keyframe = create_keyframe(context, pose, math.hypot(0.5, self._shake_rms_px))
        if keyframe is None:
            return TrackingResult(frame.time_s, False, "cannot begin a map: no corners on the floor, or too bright")
        self._reference_index = self.floor_map.add_keyframe(keyframe, make_node(context, pose), [])
        self._last_node = self.floor_map.nodes[self._reference_index, PLACE_SLICE].copy()
        self._motion = self._motion.restart_at(frame)
        answer = self._make_result(context, KeyframeMatch.from_pose(pose), True, False)
        if frame.vehicle_estimate.place is None:
            return answer
        # The result only repeats the input.
        return replace(answer, trusted=False, reason="the map begins")

    def _should_bridge(self, context: FrameContext, elapsed: float) -> bool:
        """Return whether to continue from the vehicle's estimate, since no keyframe is recognised."""
        has_place = context.frame.vehicle_estimate.place is not None
        if not has_place or context.view.height_m < MIN_CAMERA_HEIGHT_M or self._should_relocalize:
            return False
        return self._trial_frame_count > 0 or elapsed > (
            _YOUNG_BRIDGE_AFTER_S if self._is_map_young else _BRIDGE_AFTER_S
        )

    @property
    def _should_relocalize(self) -> bool:
        """Whether to search the whole map with this picture."""
        return not self._is_map_young and (
            bool(self._found_poses) or self._frame_count % _RELOCALIZE_INTERVAL_FRAMES == 0
        )

    @property
    def _is_map_young(self) -> bool:
        """Whether the map is too small for relocalisation."""
        return len(self.floor_map.keyframes) - (self._trial_frame_count > 0) <= _MAX_YOUNG_MAP_KEYFRAMES

    def _confirm_trial(self, context: FrameContext, match: KeyframeMatch) -> TrackingResult | None:
        """Count a match as confirmation of the keyframe on trial; return None once there are enough.

        A keyframe is on trial from a gap in tracking until its confirmation. Until then the rest of the map is
        searched, too: relocalisation there replaces the trial.
        """
        if self._should_relocalize and (found := self._relocalize_among_keyframes(context)) is not None:
            return self._accept_match(context, found)
        self._trial_frame_count += 1
        needed = _MIN_RELOCALIZATION_CONFIRMATIONS if self._is_map_young else _KEYFRAME_TRIAL_FRAMES
        if self._trial_frame_count <= needed or self.monitor.is_motion_doubted:
            return self._follow_unconfirmed(context, match, "new map begun, not yet confirmed")
        self._trial_frame_count = 0
        return None

    def _follow_unconfirmed(self, context: FrameContext, match: KeyframeMatch, why: str) -> TrackingResult:
        """Track a match whose pose is not published."""
        self._last_node, self._motion = match.pose_graph_node, self._motion.restart_at(context.frame)
        self._learn_vibration(context.view, match.pose)
        correct_keyframe_points(self.floor_map, context, match)
        return TrackingResult(context.frame.time_s, False, why)

    def _end_trial(self) -> None:
        """Drop the keyframe on trial, which further pictures have not confirmed, if there is one."""
        if self._trial_frame_count > 0:
            self.floor_map.drop_last_keyframe()
            self._trial_frame_count = 0

    def _bridge_gap(self, context: FrameContext, why: str) -> TrackingResult:
        """Bridge a gap in tracking by a keyframe on trial at the vehicle's estimated position.

        Its edge to the last keyframe has the uncertainty of the estimate.
        """
        frame = context.frame
        if self._trial_frame_count > 0:
            self._end_trial()
            self._reference_index = len(self.floor_map.keyframes) - 1
        assert frame.vehicle_estimate.place is not None
        n, e, heading = (float(q) for q in frame.vehicle_estimate.place)
        pose = self._pose_from_vehicle(context.view, n, e, heading)
        keyframe = create_keyframe(context, pose, math.hypot(0.5, self._shake_rms_px))
        if keyframe is None:
            return TrackingResult(frame.time_s, False, "no corners on the floor, or too bright")
        place, turn = frame.vehicle_estimate.place_sigma
        last, second = self._reference_index, len(self.floor_map.keyframes)
        node, before = make_node(context, pose), self.floor_map.nodes[last]
        h = math.exp(before[LOG_HEIGHT_INDEX])
        off = np.array([place / h, place / h, max(turn, 1e-3), 0.1])
        edge = GraphEdge(
            last, second, np.concatenate([relative_pose(before, node), before[TILT_SLICE], node[TILT_SLICE]]),
            np.diag(np.concatenate([off**-2, np.zeros(4)])),
        )  # fmt: skip
        self._reference_index = self.floor_map.add_keyframe(keyframe, node, [edge])
        self._last_node = self.floor_map.nodes[self._reference_index, PLACE_SLICE].copy()
        self._motion = self._motion.restart_at(frame)
        self._trial_frame_count = 1
        return TrackingResult(frame.time_s, False, why)

    # ------------------------------------------------------------------ Relocalisation

    def _relocalize(self, context: FrameContext, why: str) -> TrackingResult:
        """Search the whole map for the picture by ORB; accept the place when several pictures in a row agree."""
        lost = TrackingResult(context.frame.time_s, False, why or "lost", keyframe_index=-1)
        if self._frame_count % _RELOCALIZE_INTERVAL_FRAMES and not self._found_poses:
            return lost
        match = self._relocalize_among_keyframes(context)
        if match is not None:
            return self._accept_match(context, match)
        return replace(lost, reason="found, to be confirmed") if self._found_poses else lost

    def _relocalize_among_keyframes(self, context: FrameContext) -> KeyframeMatch | None:
        """Relocalise the picture among the keyframes that are not on trial; None until several pictures agree."""
        time_s = context.frame.time_s
        found, self._found_poses = self._found_poses, []
        known = len(self.floor_map.keyframes) - (self._trial_frame_count > 0)
        at = relocalize_by_orb(
            self.floor_map, known, context.view, context.picture, self._undistorter, self._shake_rms_px, self._rng
        )
        match = None if at is None else match_keyframe(self.floor_map, at[0], context, at[1])
        if (
            match is None
            or len(match.untextured_directions)
            or len(match.inlier_indices) < 1.5 * MIN_ORB_INLIERS
            or match.pose.residual_ratio > 3.0
            or self._breaks.rejection_reason(match)
        ):
            return None
        here = match.pose_graph_node
        if self._is_far_from_prediction(context, here):
            return None
        if found and math.hypot(*(here[:2] - found[-1][1][:2])) > 0.1 + 1.0 * (time_s - found[-1][0]):
            found = []
        self._found_poses = [*found, (time_s, here)]
        if len(self._found_poses) < _MIN_RELOCALIZATION_CONFIRMATIONS:
            return None
        self._end_trial()
        self._motion = MotionPrior().restart_at(context.frame)
        self._last_node = here
        return match

    def _is_far_from_prediction(self, context: FrameContext, node: _Array) -> bool:
        """Return whether a node is farther from the predicted one, or turned more, than the prediction allows."""
        way = context.motion.since_last_result
        if way is None:
            return False
        predicted, sigma_m = self._predict_node(context, way)
        turned = abs(math.remainder(node[HEADING_INDEX] - predicted[HEADING_INDEX], 2.0 * math.pi))
        if turned > _MAX_RELOCALIZATION_TURN_RAD + HEADING_DRIFT_RAD_S * way.elapsed_s:
            return True
        return math.hypot(*(node[:2] - predicted[:2])) > _MAX_RELOCALIZATION_SIGMAS * sigma_m
