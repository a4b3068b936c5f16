"""Place recognition: correlation near a predicted place, and ORB over the whole map (Rublee et al. 2011).

Descriptors with one clear match in a keyframe go to the two-point solution of :mod:`mufly.slam.camera_pose`. The
keyframe with the most inliers is the result, unless another has nearly as many: a floor of tiles gives no result.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.slam.camera_pose import ViewPrior, attitude_matrix, compute_ray_slopes, solve_pose_by_ransac
from mufly.slam.image_tools import Undistorter, find_repeat_shifts, import_opencv
from mufly.slam.keyframe_map import FloorMap
from mufly.slam.pose_graph import HEADING_INDEX, LOG_HEIGHT_INDEX

_Array = NDArray[np.float64]
MIN_ORB_INLIERS = 14
"""Least number of inliers."""
MAX_SECOND_PEAK_RATIO = 0.75
"""Ratio of the second peak of the correlation to the first above which the place is ambiguous."""
MAX_SECOND_INLIER_RATIO = 0.6
"""Ratio of the inliers of another place to the inliers of the best place, above which the place is ambiguous."""
MIN_PLACE_DISTANCE_HEIGHTS = 0.3
"""Least distance of two results over the height at which they are different places."""
MAX_OTHER_PLACE_LIKELIHOOD = 1e-3
"""Largest relative probability of another place that looks the same."""


def relocalize_by_orb(
    floor_map: FloorMap, known: int, view: ViewPrior, picture: Any, straight: Undistorter, shake_rms: float,
    rng: np.random.Generator,
) -> tuple[int, _Array] | None:  # fmt: skip
    """Return the keyframe on which most ORB matches agree, and the node (pose) of the picture.

    The result is None if another place has nearly as many inliers, or the picture repeats itself.

    Parameters
    ----------
    floor_map : FloorMap
    known : int
        Number of its keyframes that are searched, from the first.
    view : ViewPrior
    picture : (rows, columns) uint8 array
        Undistorted picture.
    straight : Undistorter
    shake_rms : float
        Rms of the vibration along an axis (pixels).
    rng : numpy.random.Generator
        Source of the random point pairs.
    """
    if len(find_repeat_shifts(picture)):  # all tiles have the same descriptors
        return None
    cv2 = import_opencv()
    orb = cv2.ORB_create(nfeatures=400, scaleFactor=1.3, nlevels=4, fastThreshold=7)
    points, words = orb.detectAndCompute(picture, None)
    if words is None or len(points) < MIN_ORB_INLIERS:
        return None
    pixels = np.array([p.pt for p in points])
    seconds = straight.exposure_time_offsets_s(pixels)
    m = compute_ray_slopes(view, pixels - straight.principal_point, seconds, attitude_matrix(view))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    results: list[tuple[int, int, _Array]] = []
    for k, keyframe in enumerate(floor_map.keyframes[:known]):
        if keyframe.orb_features is None:
            theirs, described = orb.detectAndCompute(keyframe.picture, None)
            where = np.array([p.pt for p in theirs]).reshape(-1, 2)
            rays = (
                np.column_stack([(where - straight.principal_point) / view.focal_px, np.ones(len(where))])
                @ keyframe.turn.T
            )
            keyframe.orb_features = (described, (rays[:, 0] + 1j * rays[:, 1]) / rays[:, 2])
        described, theirs_m = keyframe.orb_features
        if described is None or len(described) < MIN_ORB_INLIERS:
            continue
        pairs = matcher.knnMatch(words, described, k=2)
        good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.8 * p[1].distance and p[0].distance < 70]
        if len(good) < MIN_ORB_INLIERS:
            continue
        at = floor_map.nodes[k]
        places = (
            complex(at[0], at[1])
            + np.exp(at[LOG_HEIGHT_INDEX] + 1j * at[HEADING_INDEX]) * theirs_m[[g.trainIdx for g in good]]
        )
        rough = np.full(len(good), math.hypot(2.0, 1.5 * shake_rms) / view.focal_px)
        c, h, heading, fits = solve_pose_by_ransac(
            places, m[[g.queryIdx for g in good]], rough, view.height_m, view.height_sigma_m, rng, 200
        )
        if fits.sum() >= MIN_ORB_INLIERS:
            results.append((int(fits.sum()), k, np.array([c.real, c.imag, heading, math.log(h)])))
    if not results:
        return None
    results.sort(key=lambda r: -r[0])
    count, k, node = results[0]
    for other, _, elsewhere in results[1:]:
        if are_places_apart(elsewhere, node, view.height_m) and other > MAX_SECOND_INLIER_RATIO * count:
            return None
    return k, node


def are_places_apart(a: _Array, b: _Array, height_m: float) -> bool:
    """Return whether two nodes (N, E, ...) are different places at a height (m)."""
    return math.hypot(*(a[:2] - b[:2])) > MIN_PLACE_DISTANCE_HEIGHTS * height_m


class CorrelationPeak(NamedTuple):
    """Correlation of a keyframe with a picture.

    Attributes
    ----------
    shift_px : (2,) array
        Shift with the highest correlation (pixels).
    score, second_score : float
        Correlation at the highest and at the second peak; ``second_score`` is -1 if there is no second peak.
    """

    shift_px: _Array
    score: float
    second_score: float

    @property
    def is_ambiguous(self) -> bool:
        """Whether keyframe and picture correlate nearly as much at another shift within reach."""
        return self.second_score > MAX_SECOND_PEAK_RATIO * self.score


def correlate_pictures(seen: Any, picture: Any, reach: float) -> CorrelationPeak | None:
    """Return the peak of the correlation of small copies of a warped keyframe picture and a picture.

    The result is None if the two pictures do not correlate.

    Parameters
    ----------
    seen, picture : (rows, columns) uint8 arrays
        Keyframe, warped to the predicted view and black outside, and present picture.
    reach : float
        Largest shift (pixels), limited to half a picture.
    """
    cv2 = import_opencv()
    size = (picture.shape[1], picture.shape[0])
    small = (size[0] // 4, size[1] // 4)
    a = cv2.resize(seen, small, interpolation=cv2.INTER_AREA).astype(np.float32)
    b = cv2.resize(picture, small, interpolation=cv2.INTER_AREA).astype(np.float32)
    b -= cv2.GaussianBlur(b, (0, 0), 8)
    inside = (a > 0).astype(np.float32)
    mean = cv2.GaussianBlur(a, (0, 0), 8) / np.maximum(cv2.GaussianBlur(inside, (0, 0), 8), 0.05)
    a = (a - mean) * inside
    most = (small[0] // 2, small[1] // 2)
    padded = cv2.copyMakeBorder(a, most[1] // 2, most[1] // 2, most[0] // 2, most[0] // 2, cv2.BORDER_CONSTANT)
    mask = cv2.copyMakeBorder(inside, most[1] // 2, most[1] // 2, most[0] // 2, most[0] // 2, cv2.BORDER_CONSTANT)
    # The template is the middle of the picture; shifts reach up to half of it.
    top, left = small[1] // 4, small[0] // 4
    template = b[top : top + most[1], left : left + most[0]]
    score = cv2.matchTemplate(padded, template, cv2.TM_CCOEFF_NORMED)
    share = cv2.matchTemplate(mask, np.ones_like(template), cv2.TM_CCORR) / template.size
    score[(share < 0.5) | ~np.isfinite(score)] = -1.0
    middle = np.array([top + most[1] // 2, left + most[0] // 2])
    rows, columns = np.indices(score.shape)
    off = np.hypot(rows - middle[0], columns - middle[1]) * 4.0
    score[off > reach] = -1.0
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    peak = float(score[best])
    if peak < 0.35:
        return None
    away = np.hypot(rows - best[0], columns - best[1])
    shift = np.array([(best[1] - middle[1]) * 4.0, (best[0] - middle[0]) * 4.0])
    return CorrelationPeak(shift, peak, float(score[away > 4.0].max(initial=-1.0)))


def is_unambiguous(off: _Array, alike: _Array, sigma: float) -> bool:
    """Return whether a place is much more likely than all other places that look the same.

    The place is ``off`` (2,) from its prediction, which has the deviation ``sigma`` along an axis; the places at
    offsets ``alike`` (n, 2) from it look the same. A Gaussian prediction gives the probability of each relative to it,

        p_k / p = exp(-(|off + alike_k|^2 - |off|^2) / (2 sigma^2)),

    which must be below :data:`MAX_OTHER_PLACE_LIKELIHOOD` for all. The right place (off = 0) passes while sigma is
    below 0.27 of the distance to the next; a place at half that distance from the prediction never passes.
    """
    further = ((off + alike) ** 2).sum(axis=1) - (off**2).sum()
    return bool((further > -2.0 * math.log(MAX_OTHER_PLACE_LIKELIHOOD) * sigma**2).all())
