"""Attitude, velocity and displacement by integration of inertial data, and operations on arrays of quaternions.

Rates w give the attitude q' = q w / 2 with a constant rate in each step; specific force f gives C' = R(q) f + g from
rest at the first instant. Products of all steps up to each are formed by a prefix scan (Hillis and Steele, 1986), so
that no loop over samples is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import GRAVITY

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class InertialData:
    """Rates and specific force of an inertial unit, body axes.

    Attributes
    ----------
    time_s : (n,) array
        Rising times (s).
    rates_rad_s, force_m_s2 : (n, 3) arrays
    """

    time_s: _Array
    rates_rad_s: _Array
    force_m_s2: _Array


@dataclass(frozen=True)
class IntegratedMotion:
    """Attitude, velocity and displacement at the times of the samples.

    Attributes
    ----------
    time_s : (n,) array
    quaternion : (n, 4) array
        From body axes to N-E-D.
    rates : (n, 3) array
        Constant from each time to the next (rad/s).
    velocity, displacement : (n, 3) arrays
        N, E, D, from rest at the origin (m/s, m).
    """

    time_s: _Array
    quaternion: _Array
    rates: _Array
    velocity: _Array
    displacement: _Array

    def rotation_at(self, t: _Array) -> _Array:
        """Return rotation matrices (n, 3, 3) from body axes to N-E-D."""
        k, dt = self._locate_samples(t)
        return rotation_matrices(
            multiply_quaternions(self.quaternion[k], quaternion_exponential(self.rates[k] * dt[:, None]))
        )

    def velocity_at(self, t: _Array) -> _Array:
        k, dt = self._locate_samples(t)
        return self.velocity[k] + (self.velocity[k + 1] - self.velocity[k]) * (dt / self._sample_interval_s(k))[:, None]

    def displacement_at(self, t: _Array) -> _Array:
        k, dt = self._locate_samples(t)
        share = (dt / self._sample_interval_s(k))[:, None]
        return self.displacement[k] + dt[:, None] * (
            self.velocity[k] + 0.5 * share * (self.velocity[k + 1] - self.velocity[k])
        )

    def _sample_interval_s(self, k: NDArray[np.int64]) -> _Array:
        return np.asarray(self.time_s[k + 1] - self.time_s[k])

    def _locate_samples(self, t: _Array) -> tuple[NDArray[np.int64], _Array]:
        k = np.clip(np.searchsorted(self.time_s, t) - 1, 0, len(self.time_s) - 2)
        return k, t - self.time_s[k]


def integrate_inertial_data(
    imu: InertialData, start: _Array, *, gyro_bias: _Array, gyro_scale: _Array, accel_bias: _Array
) -> IntegratedMotion:
    """Integrate attitude, velocity and displacement.

    Parameters
    ----------
    imu : InertialData
    start : (4,) array
        Quaternion of the initial attitude.
    gyro_bias, gyro_scale : (3,) arrays
        Bias (rad/s) and error of the scale (share) of the gyroscopes.
    accel_bias : (3,) array
        Bias of the accelerometers (m/s^2).
    """
    t = imu.time_s
    rates = (imu.rates_rad_s - gyro_bias) / (1.0 + gyro_scale)
    dt = np.diff(t)[:, None]
    mean = 0.5 * (rates[1:] + rates[:-1])
    q = np.concatenate([start[None], quaternion_exponential(mean * dt)])
    reach = 1
    while reach < len(q):  # products of all steps up to each (prefix scan)
        q = np.concatenate([q[:reach], multiply_quaternions(q[:-reach], q[reach:])])
        reach *= 2
    q = q / np.linalg.norm(q, axis=1)[:, None]
    accel = np.einsum("nij,nj->ni", rotation_matrices(q), imu.force_m_s2 - accel_bias)
    accel[:, 2] += GRAVITY
    velocity = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (accel[1:] + accel[:-1]) * dt, axis=0)])
    displacement = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt, axis=0)])
    return IntegratedMotion(t, q, np.concatenate([mean, mean[-1:]]), velocity, displacement)


def estimate_white_noise(values: _Array) -> float:
    """Return the standard deviation of white noise on smooth signals (n, 3), from their third differences."""
    third = np.diff(values, n=3, axis=0)
    return float(np.sqrt(np.median(third**2) / 0.4549 / 20.0))


def quaternion_exponential(w: _Array) -> _Array:
    """Return unit quaternions (n, 4) of rotation vectors (n, 3)."""
    half = 0.5 * np.linalg.norm(w, axis=1)
    return np.concatenate([np.cos(half)[:, None], 0.5 * np.sinc(half / math.pi)[:, None] * w], axis=1)


def multiply_quaternions(a: _Array, b: _Array) -> _Array:
    """Return the products (n, 4) of quaternions."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack([
        aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
    ], axis=1)  # fmt: skip


def rotation_matrices(q: _Array) -> _Array:
    """Return the rotation matrices (n, 3, 3) of unit quaternions (n, 4)."""
    w, x, y, z = q.T
    return np.stack([
        np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
        np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
        np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
    ], axis=-2)  # fmt: skip
