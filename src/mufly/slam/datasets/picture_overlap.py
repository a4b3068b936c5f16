"""Check that neighbouring pictures share enough floor to be tracked, by ORB features (Rublee et al. 2011)."""

from __future__ import annotations

import math
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.slam.datasets.dataset_readers import STILL_PICTURE_REMEDY, FrameSource
from mufly.slam.image_tools import import_opencv

MIN_TRACKED_OVERLAP = 0.9
"""Least share of a picture that its neighbour also shows, for tracking."""
_COMPARED_PICTURE_COUNT, _MIN_COMPARED_PAIRS = 30, 3
"""Number of pictures, from the middle of a folder, that are compared, and least number of pairs with common floor."""
_MIN_MATCHED_FEATURES, _MAX_DESCRIPTOR_DISTANCE_RATIO = 12, 0.8
_SUFFICIENT_TRACKED_FRACTION = 0.5
"""Fraction of tracked pictures above which the overlap is not measured."""


def require_picture_overlap(source: FrameSource, tracked_share: float) -> None:
    """Raise InputError if few pictures of a folder were tracked and neighbouring ones share too little of the floor.

    Parameters
    ----------
    source : FrameSource
        Pictures that were tracked; sources that are no folder are not checked.
    tracked_share : float
        Share of the pictures that have a position.
    """
    if tracked_share > _SUFFICIENT_TRACKED_FRACTION or not math.isfinite(source.interval_s):
        return
    first = max(0, (source.frame_count - _COMPARED_PICTURE_COUNT) // 2)
    pictures = [frame.picture for frame in islice(source.read_frames(), first, first + _COMPARED_PICTURE_COUNT)]
    shares = [share for a, b in pairwise(pictures) if (share := measure_picture_overlap(a, b)) is not None]
    if len(shares) >= _MIN_COMPARED_PAIRS and (overlap := float(np.median(shares))) < MIN_TRACKED_OVERLAP:
        raise InputError(
            source.name,
            "",
            f"{tracked_share:.0%} of the pictures have a position: neighbouring pictures share {overlap:.0%} of the "
            f"floor, and tracking needs {MIN_TRACKED_OVERLAP:.0%}",
            STILL_PICTURE_REMEDY,
        )


def measure_picture_overlap(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float | None:
    """Return the share of a picture that another also shows; None if no common floor is recognised."""
    cv2 = import_opencv()
    orb = cv2.ORB_create(nfeatures=800, fastThreshold=7)
    (points, words), (others, other_words) = (orb.detectAndCompute(picture, None) for picture in (first, second))
    if words is None or other_words is None:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(words, other_words, k=2)
    good = [p[0] for p in pairs if len(p) == 2 and p[0].distance < _MAX_DESCRIPTOR_DISTANCE_RATIO * p[1].distance]
    if len(good) < _MIN_MATCHED_FEATURES:
        return None
    here = np.array([points[g.queryIdx].pt for g in good])
    there = np.array([others[g.trainIdx].pt for g in good])
    motion, inliers = cv2.estimateAffinePartial2D(here, there)
    if motion is None or int(inliers.sum()) < _MIN_MATCHED_FEATURES:
        return None
    rows, columns = first.shape
    moved = cv2.warpAffine(np.full((rows, columns), 255, np.uint8), motion, (columns, rows))
    return float((moved > 127).mean())
