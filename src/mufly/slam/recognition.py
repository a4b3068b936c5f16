"""Where was this seen before? A picture looked for in all of the map, by ORB (Rublee et al. 2011).

Words that have one clear counterpart in a keyframe are put to the two-point solution of :mod:`pose`; the keyframe that
most of them agree on is the place, unless another has nearly as many: a floor of tiles has no answer.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.slam.mapping import Map
from mufly.slam.pose import View, level, slopes, two_points
from mufly.slam.vision import Straightener, opencv

_Array = NDArray[np.float64]
ENOUGH = 14
"""Points that have to agree, at least."""


def recognised(
    floor_map: Map, known: int, view: View, picture: Any, straight: Straightener, shake_rms: float,
    rng: np.random.Generator,
) -> tuple[int, _Array] | None:  # fmt: skip
    """Return the keyframe and node that ORB's matches speak for, if no other place does nearly as much.

    Parameters
    ----------
    floor_map : Map
    known : int
        How many of its keyframes are looked through, from the first.
    view : View
    picture : (rows, columns) uint8 array
        Straight.
    straight : Straightener
    shake_rms : float
        Of the shaking along an axis (pixels).
    rng : numpy.random.Generator
        Of the points drawn by chance.
    """
    cv2 = opencv()
    orb = cv2.ORB_create(nfeatures=400, scaleFactor=1.3, nlevels=4, fastThreshold=7)
    points, words = orb.detectAndCompute(picture, None)
    if words is None or len(points) < ENOUGH:
        return None
    pixels = np.array([p.pt for p in points])
    seconds = straight.seconds(pixels)
    m = slopes(view, pixels - straight.middle, seconds, level(view))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    results: list[tuple[int, int, _Array]] = []
    for k, keyframe in enumerate(floor_map.keyframes[:known]):
        if keyframe.described is None:
            theirs, described = orb.detectAndCompute(keyframe.picture, None)
            where = np.array([p.pt for p in theirs]).reshape(-1, 2)
            rays = (
                np.column_stack([(where - straight.middle) / view.focal, np.ones(len(where))])
                @ keyframe.turn.T
            )
            keyframe.described = (described, (rays[:, 0] + 1j * rays[:, 1]) / rays[:, 2])
        described, theirs_m = keyframe.described
        if described is None or len(described) < ENOUGH:
            continue
        pairs = matcher.knnMatch(words, described, k=2)
        good = [
            p[0] for p in pairs if len(p) == 2 and p[0].distance < 0.8 * p[1].distance and p[0].distance < 70
        ]
        if len(good) < ENOUGH:
            continue
        at = floor_map.nodes[k]
        places = complex(at[0], at[1]) + np.exp(at[3] + 1j * at[2]) * theirs_m[[g.trainIdx for g in good]]
        rough = np.full(len(good), math.hypot(2.0, 1.5 * shake_rms) / view.focal)
        c, h, heading, fits = two_points(
            places, m[[g.queryIdx for g in good]], rough, view.height, view.height_sigma, rng, 200
        )
        if fits.sum() >= ENOUGH:
            results.append((int(fits.sum()), k, np.array([c.real, c.imag, heading, math.log(h)])))
    if not results:
        return None
    results.sort(key=lambda r: -r[0])
    count, k, node = results[0]
    for other, _, elsewhere in results[1:]:
        apart = math.hypot(*(elsewhere[:2] - node[:2])) > 0.3 * view.height
        if apart and other > 0.6 * count:
            return None
    return k, node
