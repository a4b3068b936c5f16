"""Tracks of floor points over short segments of a sequence, as raw pixels with their exposure times.

A segment begins at a picture, where corners are detected, and ends a few pictures later; the next one begins there.
Lucas and Kanade's method follows the corners from picture to picture, always with the patch of the segment's first
picture, so that errors do not add up. A point that does not return to its start when tracked backwards is dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.slam.image_tools import detect_corners, import_opencv

_Array = NDArray[np.float64]
_MAX_TRACKED_POINTS, _MIN_TRACKED_POINTS = 70, 12
_TRACKING_WINDOW_PX, _PYRAMID_LEVEL_COUNT, _MAX_FORWARD_BACKWARD_PX = 17, 3, 0.7
_SMOOTHING_PX, _LOCAL_MEAN_PX = 1.2, 12.0
_WARP_GRID_STEP_PX, _MAX_PREDICTION_SHIFT_PX = 8, 3.0
"""Grid of the predicted map (pixels), and largest shift from the prediction (pixels)."""
_NORMALISED_GREY_MEAN, _NORMALISED_GREY_GAIN = 128.0, 256.0


@dataclass(frozen=True)
class PointTracks:
    """Tracks of n floor points in m short segments of a picture sequence.

    Attributes
    ----------
    times_s : (m, 2) array
        Stamps of the first and last picture of each segment (s).
    segment : (n,) int array
        Segment of each track, rising.
    first_px, last_px : (n, 2) arrays
        Raw pixels (column, row) in the first and the last picture.
    """

    times_s: _Array
    segment: NDArray[np.int64]
    first_px: _Array
    last_px: _Array


def track_segments(
    frames: Iterable[tuple[float, NDArray[np.uint8]]], length: int, on_picture: Callable[[int], None] = lambda k: None
) -> PointTracks:
    """Track corners over segments of ``length`` pictures; return their pixels at both ends of each segment.

    Parameters
    ----------
    frames : iterable of (float, array)
        Stamps (s) and pictures (rows, columns), uint8.
    length : int
        Pictures from the first to the last of a segment.
    on_picture : callable
        Called with the number of each picture.

    Returns
    -------
    PointTracks
        Segments with fewer than 12 points are omitted.
    """
    times: list[tuple[float, float]] = []
    owners: list[NDArray[np.int64]] = []
    first_px: list[_Array] = []
    last_px: list[_Array] = []
    first: NDArray[np.uint8] | None = None
    start_s, start, now = math.nan, np.zeros((0, 2)), np.zeros((0, 2))
    for k, (time_s, raw) in enumerate(frames):
        picture = _normalise_brightness(raw)
        if first is not None and len(now):
            now, kept = _track_points(first, picture, start, now)
            start, now = start[kept], now[kept]
        if k % length == 0:
            if first is not None and len(now) >= _MIN_TRACKED_POINTS:
                back, kept = _track_points(picture, first, now, start)
                good = kept & (np.hypot(*(back - start).T) < _MAX_FORWARD_BACKWARD_PX)
                if good.sum() >= _MIN_TRACKED_POINTS:
                    owners.append(np.full(int(good.sum()), len(times), np.int64))
                    times.append((start_s, time_s))
                    first_px.append(start[good])
                    last_px.append(now[good])
            first, start_s = picture, time_s
            start = detect_corners(picture, np.full_like(picture, 255), _MAX_TRACKED_POINTS)
            now = start.copy()
        on_picture(k)
    if not times:
        return PointTracks(np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    return PointTracks(np.array(times), np.concatenate(owners), np.concatenate(first_px), np.concatenate(last_px))


def retrack_segments(
    frames: Iterable[tuple[float, NDArray[np.uint8]]], times_s: _Array, predict_first: Callable[[int, _Array], _Array]
) -> PointTracks:
    """Track segments again with the first picture warped onto the last one by a prediction.

    Parameters
    ----------
    frames : iterable of (float, array)
        As for :func:`track_segments`.
    times_s : (m, 2) array
        Stamps of the first and last picture of each segment (s).
    predict_first : callable
        Segment and pixels (n, 2) of its last picture to pixels (n, 2) of the first one.

    Returns
    -------
    PointTracks
        With the segments of ``times_s``, of which some may have no tracks.
    """
    cv2 = import_opencv()
    starts, ends = ({float(t): k for k, t in enumerate(c)} for c in times_s.T)
    held: dict[int, NDArray[np.uint8]] = {}
    owners: list[NDArray[np.int64]] = []
    first_px: list[_Array] = []
    last_px: list[_Array] = []
    for time_s, raw in frames:
        at_start, at_end = starts.get(time_s), ends.get(time_s)
        if at_start is None and at_end is None:
            continue
        picture = _normalise_brightness(raw)
        if at_end is not None and (first := held.pop(at_end, None)) is not None:
            k, (high, wide) = at_end, picture.shape
            x, y = (np.arange(0, n + _WARP_GRID_STEP_PX, _WARP_GRID_STEP_PX, dtype=np.float64) for n in (wide, high))
            nodes = np.stack(np.meshgrid(x, y), axis=-1)
            coarse = predict_first(k, nodes.reshape(-1, 2)).reshape(nodes.shape).astype(np.float32)
            v, u = (np.mgrid[:high, :wide] / _WARP_GRID_STEP_PX).astype(np.float32)
            fine = cv2.remap(coarse, u, v, cv2.INTER_LINEAR)
            template = cv2.remap(first, fine[..., 0], fine[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            inside = (fine > 0).all(axis=-1) & (fine[..., 0] < wide - 1) & (fine[..., 1] < high - 1)
            seen = cv2.erode(
                inside.astype(np.uint8), np.ones((_TRACKING_WINDOW_PX + 2, _TRACKING_WINDOW_PX + 2), np.uint8)
            )
            points = detect_corners(template, seen, _MAX_TRACKED_POINTS)
            there, kept = _track_points(template, picture, points, points)
            kept &= np.hypot(*(there - points).T) < _MAX_PREDICTION_SHIFT_PX
            if kept.sum() >= _MIN_TRACKED_POINTS:
                owners.append(np.full(int(kept.sum()), k, np.int64))
                first_px.append(predict_first(k, points[kept]))
                last_px.append(there[kept])
        if at_start is not None:
            held[at_start] = picture
    if not owners:
        return PointTracks(times_s, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2)))
    return PointTracks(times_s, np.concatenate(owners), np.concatenate(first_px), np.concatenate(last_px))


def _normalise_brightness(raw: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a smoothed picture divided by its local mean, so that vignetting does not bias the tracks."""
    cv2 = import_opencv()
    picture = cv2.GaussianBlur(raw, (0, 0), _SMOOTHING_PX).astype(np.float32)
    mean = cv2.GaussianBlur(picture, (0, 0), _LOCAL_MEAN_PX)
    ratio = picture / np.maximum(mean, 1.0) - 1.0
    return np.clip(_NORMALISED_GREY_MEAN + _NORMALISED_GREY_GAIN * ratio, 0.0, 255.0).astype(np.uint8)


def _track_points(
    template: NDArray[np.uint8], picture: NDArray[np.uint8], points: _Array, guess: _Array
) -> tuple[_Array, NDArray[np.bool_]]:
    """Track points of a template into a picture from a guess; return their pixels (n, 2) and a mask of those found."""
    if not len(points):
        return points, np.zeros(0, np.bool_)
    cv2 = import_opencv()
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        template, picture, points.astype(np.float32).reshape(-1, 1, 2),
        guess.astype(np.float32).reshape(-1, 1, 2).copy(), winSize=(_TRACKING_WINDOW_PX, _TRACKING_WINDOW_PX),
        maxLevel=_PYRAMID_LEVEL_COUNT, criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    there = there.reshape(-1, 2).astype(np.float64)
    high, wide = picture.shape
    half = _TRACKING_WINDOW_PX // 2
    inside = (there > half).all(axis=1) & (there[:, 0] < wide - half) & (there[:, 1] < high - half)
    return there, (found.reshape(-1) > 0) & inside
