"""Breaks of tracking: pictures that contradict a keyframe of the same floor.

A camera that is flipped or exchanged in flight still shows a floor. The tracker finds points even in a picture that has
nothing to do with the keyframe, since each patch moves to the place that suits it best. The texture that keyframe and
picture share at the pose then falls far below the usual one; such a match is refused
(:meth:`TrackingBreaks.rejection_reason`).

If several pictures in a row fail, although by the prediction they see the keyframe's floor and are as rich in contrast,
tracking is broken. A new keyframe at the vehicle's estimate would follow a flipped picture without a contradiction.
Therefore the motion of the picture must first agree with the vehicle's
(:meth:`mufly.slam.images.camera_monitor.CameraMonitor.restart_flip_test`), or a keyframe from before the break must be
recognised. Own derivation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mufly.slam.keyframe_matching import KeyframeMatch

_MIN_USUAL_TEXTURE_FRACTION, _USUAL_TEXTURE_MEMORY_FRAMES, _MIN_RICH_SIGNIFICANCE = 0.55, 4.0, 3.0
"""Least share of the usual significance of texture at which a match is accepted (geometric mean of both directions),
memory of the usual one, and usual significance from which this holds; that of weaker floors varies too much."""
_BREAK_FRAMES, _MIN_BREAK_OVERLAP, _MIN_BREAK_CONTRAST_FRACTION = 3, 0.5, 0.5
"""Break: failed pictures in a row, least predicted overlap with the keyframe, least contrast over the keyframe's."""
MIN_BREAK_HEIGHT_M = 0.3
"""Height of the camera from which matches are tested. Below it the texture changes fast with the height."""
UNLIKE_KEYFRAME_REASON = "the picture does not look like its keyframe"


class TrackingBreaks:
    """Usual texture of matches, and pictures in a row that fail.

    Attributes
    ----------
    keyframe_count : int
        Number of keyframes in the map before the last break.
    """

    def __init__(self) -> None:
        # Along the directions of least and of most texture: of all matches, and of those to each keyframe
        self._usual_significances = np.zeros(2)
        self._usual_of_keyframe: dict[int, NDArray[np.float64]] = {}
        self._failed_count = 0
        self.keyframe_count = 0

    def rejection_reason(self, match: KeyframeMatch) -> str:
        """Return the reason to reject a match whose texture is far weaker than usual; "" if it is accepted.

        The usual texture is the lesser of that of all matches and of matches to this keyframe. A new keyframe has none,
        so that a poorer floor is accepted after a loss.
        """
        own = self._usual_of_keyframe.get(match.keyframe_index)
        usual = np.zeros(2) if own is None else np.minimum(own, self._usual_significances)
        if usual.min() < _MIN_RICH_SIGNIFICANCE:
            return ""
        share = np.maximum(np.sort(match.significances), 0.0) / usual
        return UNLIKE_KEYFRAME_REASON if share.prod() < _MIN_USUAL_TEXTURE_FRACTION**2 else ""

    def add_match(self, match: KeyframeMatch) -> None:
        """Average the texture of an accepted match, and end the count of failed pictures."""
        self._failed_count = 0
        now = np.sort(match.significances)
        usual = self._usual_significances if self._usual_significances.any() else now
        own = self._usual_of_keyframe.get(match.keyframe_index, now)
        self._usual_significances = usual + (now - usual) / _USUAL_TEXTURE_MEMORY_FRAMES
        self._usual_of_keyframe[match.keyframe_index] = own + (now - own) / _USUAL_TEXTURE_MEMORY_FRAMES

    def add_failure(self, overlap: float, picture: NDArray[np.uint8], keyframe: NDArray[np.uint8], count: int) -> bool:
        """Count a failed picture; return whether tracking breaks with it.

        Parameters
        ----------
        overlap : float
            Predicted share of the picture's view that the keyframe also sees.
        picture, keyframe : (rows, columns) uint8 arrays
            The picture, and that of the keyframe.
        count : int
            Number of keyframes in the map.
        """
        contrast, usual = (float(q[::4, ::4].std()) for q in (picture, keyframe))
        if overlap < _MIN_BREAK_OVERLAP or contrast < _MIN_BREAK_CONTRAST_FRACTION * usual:
            self._failed_count = 0
            return False
        self._failed_count += 1
        if self._failed_count != _BREAK_FRAMES:
            return False
        self.keyframe_count = count
        return True

    def restart_for_new_map(self) -> None:
        """Forget the usual texture, and all keyframes: another map begins."""
        self._usual_significances, self._usual_of_keyframe, self.keyframe_count = np.zeros(2), {}, 0
