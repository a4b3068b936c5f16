"""Euler angles, quaternions and rotation matrices of arrays.

An attitude is roll, pitch and yaw (rad) in the aviation order: yaw, then pitch, then roll. A quaternion is (w, x, y, z)
and rotates body axes to north, east, down. (Diebel 2006, "Representing Attitude", eq. 290.) Compiled code has separate
functions: :func:`mufly.dynamics.body_to_ned_matrix`, and :mod:`mufly.estimate.filter.strapdown` for the filter.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Array = NDArray[np.float64]


def quaternion_from_euler(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the quaternion (w, x, y, z) of yaw, then pitch, then roll (rad); inverse of eq. 4.2."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return np.array(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def quaternions_from_euler(attitude: _Array) -> _Array:
    """Return the quaternions (n, 4) of attitudes (n, 3)."""
    half = 0.5 * attitude
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    return np.column_stack(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def euler_from_quaternion(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Return roll, pitch, yaw (rad).

    Parameters
    ----------
    quaternion : (..., 4) array_like
        Unit quaternions (w, x, y, z).

    Returns
    -------
    (..., 3) array
        Roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if q.ndim == 1:
        # Fast path for single quaternions: scalars take a third of the time of zero-dimensional arrays.
        w, x, y, z = q.tolist()
        sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
        roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return np.array([roll, np.arcsin(sine), yaw])
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def euler_from_unnormalised_quaternion(quaternion: _Array) -> _Array:
    """Return roll, pitch and yaw of logged quaternions, which need not be normalised.

    Parameters
    ----------
    quaternion : (n, 4) array
        Quaternions of any length; a length below 0.5 is no attitude.

    Returns
    -------
    (n, 3) array
        Angles (rad); NaN without attitude.
    """
    length = np.linalg.norm(quaternion, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        out = euler_from_quaternion(quaternion / length[:, None])
    out[~(length > 0.5)] = np.nan
    return out


def body_to_ned_matrices(attitude: _Array) -> _Array:
    """Return the rotation matrices (n, 3, 3) from body axes to N-E-D of attitudes (n, 3)."""
    (s1, s2, s3), (c1, c2, c3) = np.sin(attitude).T, np.cos(attitude).T
    return np.stack(
        [
            np.stack([c2 * c3, s1 * s2 * c3 - c1 * s3, c1 * s2 * c3 + s1 * s3], axis=-1),
            np.stack([c2 * s3, s1 * s2 * s3 + c1 * c3, c1 * s2 * s3 - s1 * c3], axis=-1),
            np.stack([-s2, s1 * c2, c1 * c2], axis=-1),
        ],
        axis=-2,
    )
