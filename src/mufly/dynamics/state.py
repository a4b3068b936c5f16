"""The state of the flight model, laid out in one flat array.

=====  ======================  ==============================================================================
index  name                    meaning
=====  ======================  ==============================================================================
0:3    position                N, E, D of the centre of gravity (m)
3:6    velocity                N, E, D (m/s)
6:10   quaternion              attitude w, x, y, z: turns body vectors into N-E-D, unit length
10:13  rates                   p, q, r (rad/s), body axes
13     tilt_roll               alpha_dw, tilt of the lower tip-path plane about x (rad)
14     tilt_pitch              beta_dw, tilt of the lower tip-path plane about y (rad)
15:18  bar normal              upward normal of the stabiliser bar's disc in N-E-D, unit length
18:20  rotor_speed             upper, lower (rad/s)
20     charge                  fraction of the battery's charge that is left
=====  ======================  ==============================================================================

The input is ``[motor upper, motor lower, servo 1, servo 2]``: motors 0..1, servos -1..1. Positive servo 1 pitches
the nose down, positive servo 2 rolls to the right (docs/thesis-errata.md, point 2).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled import compiled

STATE_SIZE = 21
INPUT_SIZE = 4


@compiled(error_model="numpy")
def rotation(quaternion):  # type: ignore[no-untyped-def]
    """Return the 3x3 matrix that turns body vectors into N-E-D, for a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


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
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=-1)


def initial_state(
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    attitude: ArrayLike = (0.0, 0.0, 0.0),
    rates: ArrayLike = (0.0, 0.0, 0.0),
    rotor_speed: ArrayLike = (0.0, 0.0),
    bar_attitude: ArrayLike | None = None,
    charge: float = 1.0,
) -> NDArray[np.float64]:
    """Build a state.

    Parameters
    ----------
    position, velocity : (3,) array_like
        N, E, D (m, m/s).
    attitude : (3,) array_like
        Roll, pitch, yaw (rad).
    rates : (3,) array_like
        p, q, r (rad/s).
    rotor_speed : (2,) array_like
        Upper, lower (rad/s).
    bar_attitude : (2,) array_like, optional
        Roll and pitch (rad) of the stabiliser bar's disc at the heading of the fuselage; by default the disc is
        square to the mast.
    charge : float
        Fraction of the battery's charge.

    Returns
    -------
    (21,) array
    """
    roll, pitch, yaw = np.asarray(attitude, dtype=np.float64)
    state = np.zeros(STATE_SIZE)
    state[0:3] = position
    state[3:6] = velocity
    state[6:10] = quaternion_from_euler(roll, pitch, yaw)
    state[10:13] = rates
    bar_roll, bar_pitch = (roll, pitch) if bar_attitude is None else np.asarray(bar_attitude, np.float64)
    state[15:18] = -rotation(quaternion_from_euler(float(bar_roll), float(bar_pitch), yaw))[:, 2]
    state[18:20] = rotor_speed
    state[20] = charge
    return state
