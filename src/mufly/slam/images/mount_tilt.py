r"""Tilt of the camera against the vehicle's attitude, measured by pixels alone.

Tracking estimates the tilt errors of a picture and of its keyframe with the filter's deviation as prior, which draws a
tilted mount to zero for many seconds. The pixels alone show the tilt by the perspective of the floor. Over a baseline
of d heights a tilt u shears the floor by u d / 2. A change of height by the ratio r bends it by (r - 1) u x^2 / f at
x pixels from the middle.

With the residual cost of a picture, linear about its estimated pose,

    1/2 delta^T J delta - g^T delta,    delta = (pose, tilt of the picture, tilt of the keyframe),

a tilted mount u gives both tilts the same value in the vehicle's axes. Elimination of the pose (N, E, height by the
sonar, heading) leaves a cost of u with the information Lambda (2, 2) and the right side lambda. Both are added up over
pictures with exponential forgetting; u = Lambda^-1 lambda. Own derivation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.slam.camera_pose import POSE_HEIGHT, POSE_SIZE, POSE_TILT, PoseEstimate, ViewPrior

_Array = NDArray[np.float64]
_MEMORY_S = 3.0  # time constant of the forgetting
_MIN_INFORMATION = 1e-3 * math.radians(1.0) ** -2  # of u (1/rad^2), where the pixels show nothing
_COMMON_TILT = np.vstack([np.eye(POSE_TILT, POSE_TILT + 2), *[np.eye(2, POSE_TILT + 2, POSE_TILT)] * 2])
"""Changes of a pose (8,) by those of N, E, height, heading and a common tilt (6,)."""


class MountTilt:
    """Tilt about x and y of the vehicle (2,), from tracked pictures.

    Attributes
    ----------
    information : (2, 2) array
        Information on the tilt (1/rad^2).
    """

    def __init__(self) -> None:
        self._time_s = math.nan
        self.information, self._right = np.zeros((2, 2)), np.zeros(2)

    @property
    def tilt_rad(self) -> _Array:
        """Most likely tilt (2,) (rad)."""
        return np.asarray(np.linalg.solve(self.information + _MIN_INFORMATION * np.eye(2), self._right), np.float64)

    def deviations(self, sigma_rad: float) -> float:
        """Return the number of standard deviations by which the tilt differs from zero.

        ``sigma_rad`` is the standard deviation of the attitude's tilt about an axis.
        """
        tilt = self.tilt_rad
        covariance = np.linalg.inv(self.information + _MIN_INFORMATION * np.eye(2)) + sigma_rad**2 * np.eye(2)
        return math.sqrt(float(tilt @ np.linalg.solve(covariance, tilt)))

    def add_picture(
        self, time_s: float, pose: PoseEstimate, keyframe_tilt_rad: _Array, view: ViewPrior, inflation: float
    ) -> None:
        """Add a picture.

        Parameters
        ----------
        time_s : float
        pose : PoseEstimate
            Pose relative to a keyframe, of a floor with texture in both directions, solved with a free tilt: robust
            weights at a tilt of zero would reject the points that show it.
        keyframe_tilt_rad : (2,) array
            Tilt error of the keyframe, to which the pose's deviations refer (rad).
        view : ViewPrior
            Height by the sonar with its standard deviation.
        inflation : float
            Ratio of the variance of the pose to that of independent points.
        """
        keep = math.exp((self._time_s - time_s) / _MEMORY_S) if self._time_s < time_s else 1.0
        self._time_s = time_s
        information, right = common_tilt(pose, keyframe_tilt_rad, view)
        self.information = keep * self.information + information / inflation
        self._right = keep * self._right + right / inflation


def common_tilt(pose: PoseEstimate, keyframe_tilt_rad: _Array, view: ViewPrior) -> tuple[_Array, _Array]:
    """Return Lambda (2, 2) and lambda (2,) of a tilt that picture and keyframe share (above)."""
    zero = np.zeros(POSE_SIZE)  # change of the pose to tilts of zero
    zero[POSE_TILT:] = -np.concatenate([pose.tilt_error_rad, keyframe_tilt_rad + pose.keyframe_tilt_error_rad])
    normal = _COMMON_TILT.T @ pose.pixel_information @ _COMMON_TILT
    right = _COMMON_TILT.T @ (pose.pixel_gradient - pose.pixel_information @ zero)
    normal[POSE_HEIGHT, POSE_HEIGHT] += view.height_sigma_m**-2
    right[POSE_HEIGHT] += (view.height_m - pose.height_m) * view.height_sigma_m**-2
    cross = normal[POSE_TILT:, :POSE_TILT]
    eliminated = np.linalg.solve(normal[:POSE_TILT, :POSE_TILT], np.column_stack([cross.T, right[:POSE_TILT]]))
    return normal[POSE_TILT:, POSE_TILT:] - cross @ eliminated[:, :2], right[POSE_TILT:] - cross @ eliminated[:, 2]
