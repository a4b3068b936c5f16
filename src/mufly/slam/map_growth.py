"""Growth of the floor's map: new keyframes, their edges, refined points, and loop closures.

Residuals of inliers correct a keyframe's points, which averages vibration and noise out of the map. A loop is closed
under three conditions: enough inliers, a result within the covariance of the map, and no other place within that
covariance that looks nearly the same, in this keyframe or in another. On a floor of tiles no loop is closed if the
covariance is too large.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mufly.slam.camera_pose import (
    POSE_HEIGHT,
    POSE_KEYFRAME_TILT,
    POSE_SIZE,
    POSE_TILT,
    PoseEstimate,
    attitude_matrix,
    compute_ray_slopes,
    d_rays_d_tilt,
)
from mufly.slam.image_tools import detect_corners
from mufly.slam.keyframe_map import FloorMap, Keyframe, compose_pose, residuals_without_pose_error
from mufly.slam.keyframe_matching import (
    FrameContext,
    KeyframeMatch,
    correlate_keyframe,
    match_keyframe,
    rejection_reason,
)
from mufly.slam.place_recognition import MAX_SECOND_PEAK_RATIO, MIN_ORB_INLIERS, are_places_apart, is_unambiguous
from mufly.slam.pose_graph import (
    EDGE_FIRST_TILT_SLICE,
    EDGE_QUANTITY_COUNT,
    EDGE_SECOND_TILT_SLICE,
    HEADING_INDEX,
    LOG_HEIGHT_INDEX,
    TILT_SLICE,
    GraphEdge,
    relative_pose,
    relative_pose_jacobians,
)

_Array = NDArray[np.float64]
LOOP_MIN_OVERLAP = 0.4
LOOP_MAX_CHI2 = 28.0  # of eight numbers: rejects one true closure in 2000
_LOOP_SEARCH_SIGMAS = 2.5  # standard deviations within which keyframes are searched
_MAX_COMPARED_OTHER_PLACES = 8  # keyframes that are compared with the best before a loop is closed
SAME_PICTURE_ERROR_TRANSITION = (np.ones(3), np.full(3, 1e-10))
"""Correlation factors and noise variances between errors of a picture and the newest keyframe if both are the same."""
_OVEREXPOSED_GREY_LEVEL, _MAX_OVEREXPOSED_FRACTION = 248, 0.02
"""Overexposure: grey level, and largest fraction of brighter pixels in a keyframe. A camera that was covered
overexposes for half a second; white areas have no corners."""


def make_node(context: FrameContext, pose: PoseEstimate) -> _Array:
    """Return the node (7,) of a pose: N, E, heading, ln h, errors of the tilt and of the sonar."""
    height_error = context.predicted_sensor_errors[2]
    return np.array([*pose.state[:2], pose.heading_rad, math.log(pose.height_m), *pose.tilt_error_rad, height_error])


def create_keyframe(context: FrameContext, pose: PoseEstimate, sigma_px: float) -> Keyframe | None:
    """Return the picture as a keyframe with points of deviation ``sigma_px``; None without corners or if too bright."""
    frame, view, picture = context.frame, context.view, context.picture
    pixels = detect_corners(picture, context.usable_mask)
    if len(pixels) < MIN_ORB_INLIERS or np.mean(picture > _OVEREXPOSED_GREY_LEVEL) > _MAX_OVEREXPOSED_FRACTION:
        return None
    seconds = context.undistorter.exposure_time_offsets_s(pixels)
    turn = _remove_heading(attitude_matrix(view, pose.tilt_error_rad, pose.heading_rad), pose.heading_rad)
    return Keyframe(
        frame.time_s,
        picture.copy(),
        turn @ view.body_from_camera,
        pixels,
        _compute_level_ray_slopes(context, pose, pixels, seconds),
        np.full(len(pixels), (sigma_px / view.focal_px) ** 2),
        np.zeros(len(pixels), np.int64),
        pose.tilt_error_rad.copy(),
        math.log(view.height_m),
        view.height_sigma_m / view.height_m,
        frame.vehicle_estimate.height_time_s,
        frame.vehicle_estimate.tilt_sigma,
        frame.vehicle_estimate.tilt_time_s,
        context.shake_tilt_rad,
    )


def insert_keyframe(floor_map: FloorMap, context: FrameContext, match: KeyframeMatch) -> int | None:
    """Make a keyframe of a matched picture; return its number, or None if the picture is unsuitable.

    It has an edge to the matched keyframe, and to the connected one with the largest overlap.
    """
    keyframe = create_keyframe(context, match.pose, 0.4)
    if keyframe is None:
        return None
    # Edges to other keyframes that see it constrain it better
    node = match.pose_graph_node
    others = sorted(
        floor_map.connected_keyframes(match.keyframe_index),
        key=lambda k: -context.view_overlap(floor_map.nodes[k], node),
    )
    edge = make_edge(floor_map, match, len(floor_map.keyframes))
    k = floor_map.add_keyframe(keyframe, make_node(context, match.pose), [edge])
    # It is the newest keyframe from here on
    view = context.view._replace(expected_tilt_error_rad=floor_map.nodes[k, TILT_SLICE].copy())
    context = replace(context, view=view, error_transition=SAME_PICTURE_ERROR_TRANSITION)
    for other in others[:1]:
        if context.view_overlap(floor_map.nodes[other], node) > 0.25:
            second = match_keyframe(floor_map, other, context, node)
            if second is not None and not rejection_reason(floor_map, second, context, node):
                floor_map.try_add_edge(make_edge(floor_map, second, k))
    return k


def make_edge(floor_map: FloorMap, match: KeyframeMatch, second: int, closes: bool = False) -> GraphEdge:
    """Return the edge from the matched keyframe to the picture, node ``second``; ``closes`` marks a loop closure."""
    at, pose = floor_map.nodes[match.keyframe_index], match.pose
    tilt = at[TILT_SLICE] + pose.keyframe_tilt_error_rad
    _, by_b = relative_pose_jacobians(at, match.pose_graph_node)
    # Jacobian of N, E, height, heading, tilt of the picture, tilt of the keyframe by the edge's eight numbers
    change = np.zeros((POSE_SIZE, EDGE_QUANTITY_COUNT))
    change[:4, :4] = np.linalg.inv(by_b)[[0, 1, LOG_HEIGHT_INDEX, HEADING_INDEX]]
    change[POSE_HEIGHT] *= pose.height_m
    change[POSE_TILT:POSE_KEYFRAME_TILT, EDGE_SECOND_TILT_SLICE] = change[
        POSE_KEYFRAME_TILT:, EDGE_FIRST_TILT_SLICE
    ] = np.eye(2)
    information, gradient = pose_information(match)
    return GraphEdge(
        match.keyframe_index,
        second,
        np.concatenate([relative_pose(at, match.pose_graph_node), tilt, pose.tilt_error_rad]),
        change.T @ information @ change,
        change.T @ gradient,
        closes,
    )


def pose_information(match: KeyframeMatch) -> tuple[_Array, _Array]:
    """Return information matrix (8, 8) and gradient (8,) of a match's pose, from pixels and prior together.

    The part of the pixels is reduced, since the errors of points are correlated.
    """
    pose, inflation = match.pose, match.variance_inflation
    return (
        pose.pixel_information / inflation + pose.prior_information,
        pose.pixel_gradient / inflation + pose.prior_gradient,
    )


def correct_keyframe_points(floor_map: FloorMap, context: FrameContext, match: KeyframeMatch) -> None:
    """Correct the points of the matched keyframe by their residuals."""
    view, pose = context.view, match.pose
    keyframe, at = floor_map.keyframes[match.keyframe_index], floor_map.nodes[match.keyframe_index]
    seen = _compute_level_ray_slopes(context, pose, match.inlier_pixels, match.exposure_offsets_s)
    z = pose.height_m * np.exp(1j * pose.heading_rad)
    c = complex(pose.state[0], pose.state[1])
    to_keyframe = (c - complex(at[0], at[1]) + z * seen) / np.exp(at[LOG_HEIGHT_INDEX] + 1j * at[HEADING_INDEX])
    ratio = pose.height_m / math.exp(at[LOG_HEIGHT_INDEX])
    # Refer to the tilt error for which the slopes were computed
    tilt = at[TILT_SLICE] + pose.keyframe_tilt_error_rad - keyframe.tilt
    move = d_rays_d_tilt(keyframe.slopes[match.inlier_indices]) @ tilt
    to_keyframe = to_keyframe - (move[:, 0] + 1j * move[:, 1])
    # Root mean square of both axes; a point with texture along one direction is not refined.
    information = match.pixel_information
    det = np.linalg.det(information)
    sigmas = np.sqrt(0.5 * np.trace(information, axis1=1, axis2=2) / np.maximum(det, 1e-12))
    sigmas = np.where(det > 1e-8, sigmas, 100.0)
    # Residuals that pose and tilt errors can explain are not the floor's shape.
    own = keyframe.slopes[match.inlier_indices]
    to_keyframe = own + residuals_without_pose_error(to_keyframe - own, own, seen, 1.0 / sigmas)
    keyframe.refine_points(
        match.inlier_indices,
        to_keyframe,
        (sigmas * ratio / view.focal_px) ** 2 + 1e-12,
        view.focal_px,
    )


class LoopSearch:
    """Search for keyframes to which a loop can be closed; failed candidates are remembered."""

    def __init__(self) -> None:
        # For each keyframe, the number of failed closures and the overlap at the last one
        self._failed_closures: dict[int, tuple[int, float]] = {}

    def match_next_candidate(
        self, floor_map: FloorMap, here: int, context: FrameContext, last_node: _Array
    ) -> KeyframeMatch | None:
        """Match the picture to the next candidate for a loop closure; return None without a match.

        A candidate has no edge to keyframe ``here``.

        Candidates are keyframes that the map's covariance permits to be in view from ``last_node`` (4,), the node of
        the last result. Those with the largest gain of overlap since their last trial come first.
        """
        most = _LOOP_SEARCH_SIGMAS * math.sqrt(np.linalg.eigvalsh(floor_map.joint_covariance(here)[:2, :2])[-1])
        most_in_view = math.hypot(*context.undistorter.view_ratios)
        near, may = {here, *floor_map.connected_keyframes(here)}, []
        for k in range(len(floor_map.keyframes)):
            t = relative_pose(floor_map.nodes[k], last_node)
            way, h = math.hypot(t[0], t[1]), math.exp(floor_map.nodes[k, LOG_HEIGHT_INDEX])
            if k in near or h * way > most + h * most_in_view:
                continue
            sigma = math.sqrt(np.linalg.eigvalsh(floor_map.edge_covariance(k, here)[:2, :2])[-1])
            t[:2] *= max(0.0, 1.0 - _LOOP_SEARCH_SIGMAS * sigma / max(way, 1e-9))
            node = compose_pose(floor_map.nodes[k], t)
            if context.view_overlap(floor_map.nodes[k], node) > LOOP_MIN_OVERLAP:
                share = context.view_overlap(floor_map.nodes[k], last_node)
                tries, before = self._failed_closures.get(k, (0, 0.0))
                may.append((-round(share - before, 1), tries, -share, k, node, h * sigma))
        if not may:
            return None
        may.sort(key=lambda m: m[:3])
        _, tries, share, k, node, sigma = may[0]
        self._failed_closures[k] = (tries + 1, -share)
        # Always coarse: this search includes the test for other places in the keyframe that look the same.
        match = match_keyframe(floor_map, k, replace(context, position_sigma_m=2.0 * sigma), node, coarse=True)
        if (
            match is None
            or len(match.untextured_directions)
            or len(match.inlier_indices) < max(1.5 * MIN_ORB_INLIERS, 0.5 * match.tracked_count)
            or match.pose.residual_ratio > 3.0
            or _is_place_ambiguous(floor_map, match, context, last_node, [(m[3], m[4], m[5]) for m in may[1:]])
        ):
            return None
        return match

    def close_loop(self, floor_map: FloorMap, match: KeyframeMatch, here: int) -> bool:
        """Add a match as a loop-closing edge from its keyframe to keyframe ``here``; return whether it was added.

        It is not added if it contradicts the map's covariance.
        """
        k, edge = match.keyframe_index, make_edge(floor_map, match, here, closes=True)
        off = edge.compute_residual(floor_map.nodes[k], floor_map.nodes[here])
        if edge.compute_chi2(off, floor_map.edge_covariance(k, here)) > LOOP_MAX_CHI2:
            return False
        if not floor_map.try_add_edge(edge, LOOP_MAX_CHI2):
            return False
        self._failed_closures = {}
        return True


def _is_place_ambiguous(
    floor_map: FloorMap, match: KeyframeMatch, context: FrameContext, last_node: _Array,
    others: list[tuple[int, _Array, float]],
) -> bool:  # fmt: skip
    """Return whether a match is ambiguous: another keyframe that may be in view looks nearly like the matched place.

    ``others`` are keyframes with the predicted node of the picture and its standard deviation (m). Their places are
    compared by the correlation of small pictures, as are two places within a keyframe. The place of the last result,
    ``last_node``, is not compared, since a loop that is to be closed contradicts it.
    """
    place, height = match.pose_graph_node, context.view.height_m
    first = correlate_keyframe(floor_map, match.keyframe_index, replace(context, position_sigma_m=0.0), place)
    least = 0.0 if first is None else MAX_SECOND_PEAK_RATIO * first[1].score
    off = place[:2] - last_node[:2]
    for k, node, sigma in others[:_MAX_COMPARED_OTHER_PLACES]:
        found = correlate_keyframe(floor_map, k, replace(context, position_sigma_m=2.0 * sigma), node)
        if found is None or found[1].score < least:
            continue
        other = found[0]
        apart = are_places_apart(other, place, height) and are_places_apart(other, last_node, height)
        if apart and not is_unambiguous(off, (other - place)[None, :2], sigma):
            return True
    return False


def _compute_level_ray_slopes(
    context: FrameContext, pose: PoseEstimate, pixels: _Array, seconds: _Array
) -> NDArray[np.complex128]:
    """Return the slopes of rays through pixels as a level camera of heading 0 would see them at mid-exposure."""
    view = context.view
    turn = attitude_matrix(view, pose.tilt_error_rad, pose.heading_rad)
    centred = pixels - context.undistorter.principal_point
    m = compute_ray_slopes(view, centred, seconds, turn, pose.shake_amplitudes_px)
    move = (view.velocity_m_s[0] + 1j * view.velocity_m_s[1]) * seconds
    down = 1.0 - view.velocity_m_s[2] * seconds / pose.height_m
    return (m * down + move / pose.height_m) * np.exp(-1j * pose.heading_rad)


def _remove_heading(turn: _Array, heading: float) -> _Array:
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ turn
