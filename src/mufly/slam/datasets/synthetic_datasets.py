"""Synthetic data sets: pictures rendered along a path, with simulated vehicle data and truth.

Paths are laps of a square with round corners, those of a recorded flight, or a motion by hand with still rotors. On a
lap the vehicle sways, and it tilts according to its acceleration: pitch = -a_x / g, roll = a_y / g in the axes of its
heading, plus a random 0.4 degrees. A hand turns the vehicle by about 20 degrees about all axes.

The vehicle data (telemetry) are tilt with a first-order Gauss-Markov error (2 s), height above the floor with one of
1 cm over 1 s, rates with bias and noise, and rotor speeds. A folder holds

    camera.toml, pictures/000000.jpg, pictures.csv (time, file), telemetry.csv, truth.txt (TUM: t x y z qx qy qz qw),
    imu.csv, sonar.csv

in N-E-D. The layouts "euroc" and "tum" also have their own files (:mod:`mufly.slam.datasets.dataset_readers`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.camera import Camera, Floor, Renderer, VehicleMotion
from mufly.dynamics import GRAVITY, body_to_ned_matrix
from mufly.errors import ArgumentError, InputError
from mufly.rotations import quaternion_from_euler
from mufly.slam.camera_frame import CameraFrame, FrameEstimate
from mufly.world import Box, World

_Array = NDArray[np.float64]
PATH_RATE_HZ = 200.0
TILT_SIGMA_RAD, TILT_CORRELATION_TIME_S = math.radians(0.5), 2.0
HEIGHT_SIGMA_M, HEIGHT_CORRELATION_TIME_S = 0.01, 1.0
PHASE_SIGMA_RAD = 0.05
"""Standard deviation of the rotors' phases from commutation (rad)."""
_GYRO_BIAS_RAD_S, _GYRO_NOISE_RAD_S = math.radians(0.3), 0.01
_SWAY_AMPLITUDE_M = 0.03  # amplitude of the swaying of a path around a square
_ROTOR_SPEEDS_RAD_S = 2 * math.pi * np.array([60.0, 70.0])


@dataclass(frozen=True)
class VehiclePath:
    """Path of a vehicle over a fine time grid, N-E-D.

    Attributes
    ----------
    time_s : (n,) array
        Increasing times (s).
    position_m, velocity_m_s, attitude_rad, body_rates_rad_s : (n, 3) arrays
        Position (m), velocity (m/s), roll, pitch and continuous yaw (rad), p, q, r (rad/s).
    rotor_speeds_rad_s, rotor_phases_rad : (n, 2) arrays
        Upper, lower (rad/s, rad).
    """

    time_s: _Array
    position_m: _Array
    velocity_m_s: _Array
    attitude_rad: _Array
    body_rates_rad_s: _Array
    rotor_speeds_rad_s: _Array
    rotor_phases_rad: _Array

    def motion_at(self, time_s: float) -> VehicleMotion:
        """Return the motion at a time (s)."""
        k = min(max(int(np.searchsorted(self.time_s, time_s)) - 1, 0), len(self.time_s) - 2)
        a = (time_s - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        x, v, e, w, o, f = (
            (1 - a) * q[k] + a * q[k + 1]
            for q in (
                self.position_m,
                self.velocity_m_s,
                self.attitude_rad,
                self.body_rates_rad_s,
                self.rotor_speeds_rad_s,
                self.rotor_phases_rad,
            )
        )
        shaking = 1.0 if o.any() else 0.0
        return VehicleMotion(time_s, x, v, body_to_ned_matrix(quaternion_from_euler(*e)), w, o, f, shaking)


def make_square_path(
    *,
    duration_s: float,
    side_m: float = 3.0,
    height_m: float = 1.0,
    speed_m_s: float = 0.4,
    seed: int = 0,
) -> VehiclePath:
    """Return a path around a square with round corners, at a constant speed.

    Parameters
    ----------
    duration_s : float
    side_m : float
        Side of the square (m); 0 hovers.
    height_m : float
        Mean height above the floor (m); it varies by a tenth.
    speed_m_s : float
    seed : int
    """
    if not (duration_s > 0 and side_m >= 0 and height_m > 0.1 and 0 <= speed_m_s <= 5):
        raise ArgumentError("path", "", "is none", "give duration, side, height (over 0.1 m) and speed above zero")
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration_s + 0.5, 1.0 / PATH_RATE_HZ)
    way = np.cumsum(speed_m_s * np.clip(t / 1.5, 0.0, 1.0)) / PATH_RATE_HZ
    p = np.zeros((len(t), 3))
    if side_m > 0.0:
        p[:, :2] = _trace_square(way, side_m)
    for axis, most in ((0, _SWAY_AMPLITUDE_M), (1, _SWAY_AMPLITUDE_M), (2, 0.4 * _SWAY_AMPLITUDE_M)):
        for _ in range(4):
            w = 2 * math.pi * rng.uniform(0.1, 0.8)
            p[:, axis] += most * rng.uniform(0.3, 0.7) * np.sin(w * t + rng.uniform(0, 2 * math.pi))
    p[:, 2] -= height_m * (1.0 + 0.1 * np.sin(2 * math.pi * t / 17.0))
    p[:, :2] -= p[0, :2]
    yaw = 0.06 * np.sin(2 * math.pi * t / 9.0 + rng.uniform(0, 6))
    v = np.asarray(np.gradient(p, t, axis=0))
    a = _smooth_rows_twice(np.gradient(v, t, axis=0), 40)
    c, s = np.cos(yaw), np.sin(yaw)
    forward, right = c * a[:, 0] + s * a[:, 1], -s * a[:, 0] + c * a[:, 1]
    tremble = np.zeros((len(t), 2))
    for k in range(2):
        for _ in range(4):
            w = 2 * math.pi * rng.uniform(0.5, 3.0)
            tremble[:, k] += math.radians(0.3) * np.sin(w * t + rng.uniform(0, 2 * math.pi))
    attitude = np.stack([right / GRAVITY + tremble[:, 0], -forward / GRAVITY + tremble[:, 1], yaw], axis=1)
    speed = _ROTOR_SPEEDS_RAD_S * (1.0 + 0.03 * np.sin(2 * math.pi * t / 3.0)[:, None])
    return VehiclePath(
        t, p, v, attitude, _compute_body_rates(t, attitude), speed, np.cumsum(speed, axis=0) / PATH_RATE_HZ
    )


def make_handheld_path(*, duration_s: float, height_m: float = 0.8, seed: int = 0) -> VehiclePath:
    """Return a motion by hand with still rotors, for :mod:`mufly.slam.calibration.hand_calibration`.

    Angles and place are sums of sines of 0.15 to 0.9 Hz: roll and pitch of 12 degrees rms, yaw of 25, place of 8 cm.
    The first 0.8 s are at rest.

    Parameters
    ----------
    duration_s : float
    height_m : float
        Mean height above the floor (m).
    seed : int
    """
    if not (duration_s > 0 and height_m > 0.2):
        raise ArgumentError("path", "", "is none", "give a duration above zero and a height over 0.2 m")
    rng = np.random.default_rng([seed, 36])
    t = np.arange(0.0, duration_s + 0.5, 1.0 / PATH_RATE_HZ)
    rms = np.array([*np.radians([12.0, 12.0, 25.0]), 0.08, 0.08, 0.08 * min(1.0, height_m)])
    grown = np.clip((t - 0.8) / 2.0, 0.0, 1.0)
    grown = grown**3 * (10.0 - 15.0 * grown + 6.0 * grown**2)  # smooth to the second derivative
    waves = np.zeros((len(t), 6))
    for k in range(6):
        for _ in range(5):
            w = 2 * math.pi * rng.uniform(0.15, 0.9)
            waves[:, k] += rms[k] * math.sqrt(2.0 / 5.0) * np.sin(w * t + rng.uniform(0, 2 * math.pi))
    waves *= grown[:, None]
    attitude, moved = np.hsplit(waves, 2)
    p = moved - [0.0, 0.0, height_m]
    still = np.zeros((len(t), 2))
    return VehiclePath(
        t, p, np.asarray(np.gradient(p, t, axis=0)), attitude, _compute_body_rates(t, attitude), still, still
    )


def add_imu_errors(rows: _Array, seed: int = 0) -> _Array:
    """Return rows of time, rates and specific force with the errors of a small MEMS unit.

    Gyroscopes: bias 0.5 degrees/s, scale 1 %, white noise 5 mrad/s a sample; accelerometers: bias 0.05 m/s^2, scale
    0.3 %, noise 0.05 m/s^2 (one sigma each).
    """
    rng = np.random.default_rng([seed, 37])
    out = rows.copy()
    for part, bias, scale, noise in ((slice(1, 4), math.radians(0.5), 0.01, 0.005), (slice(4, 7), 0.05, 0.003, 0.05)):
        values = out[:, part]
        values *= 1.0 + scale * rng.standard_normal(3)
        values += bias * rng.standard_normal(3) + noise * rng.standard_normal(values.shape)
    return out


def _trace_square(way: _Array, side: float) -> _Array:
    """Return points (n, 2) at distances along a square with round corners."""
    radius = 0.25 * side
    straight, arc = side - 2 * radius, 0.5 * math.pi * radius
    part = straight + arc
    k, along = np.floor(way / part), np.mod(way, part)
    on_arc = np.maximum(along - straight, 0.0) / radius
    x = np.minimum(along, straight) + radius * np.sin(on_arc)
    y = radius * (1.0 - np.cos(on_arc))
    start = np.zeros((int(k.max()) + 2, 2))
    for i in range(1, len(start)):
        h = 0.5 * math.pi * (i - 1)
        step = np.array([straight + radius, radius])
        start[i] = start[i - 1] + np.array([[math.cos(h), -math.sin(h)], [math.sin(h), math.cos(h)]]) @ step
    side_of = 0.5 * math.pi * k
    n = start[k.astype(int), 0] + np.cos(side_of) * x - np.sin(side_of) * y
    e = start[k.astype(int), 1] + np.sin(side_of) * x + np.cos(side_of) * y
    return np.stack([n, e], axis=1)


def _smooth_rows_twice(a: _Array, n: int) -> _Array:
    """Return the rows smoothed twice by a moving average over ``n`` rows; edge values are repeated."""
    kernel = np.ones(n) / n
    for _ in range(2):
        a = np.stack(
            [np.convolve(np.pad(c, (n // 2, n - 1 - n // 2), mode="edge"), kernel, "valid") for c in a.T],
            axis=1,
        )
    return a


def _compute_body_rates(t: _Array, attitude: _Array) -> _Array:
    """Return the body rates of attitudes (thesis: eq. 4.3 inverted)."""
    d: _Array = np.gradient(attitude, t, axis=0)
    (roll, pitch, _), (dr, dp, dy) = attitude.T, d.T
    return np.stack(
        [
            dr - dy * np.sin(pitch),
            dp * np.cos(roll) + dy * np.sin(roll) * np.cos(pitch),
            dy * np.cos(roll) * np.cos(pitch) - dp * np.sin(roll),
        ],
        axis=1,
    )


def path_from_recording(recording: xr.Dataset, where: str = "recording") -> VehiclePath:
    """Return the path of a recorded flight.

    Raises
    ------
    InputError
        If the recording holds no truth.
    """
    for name in ("truth_position", "truth_velocity", "truth_attitude", "truth_rates"):
        if name not in recording:
            raise InputError(where, name, "is missing", "give a recording of a simulated flight")
    t = recording["time"].values.astype(np.float64)
    speed = (
        recording["truth_rotor_speed"].values
        if "truth_rotor_speed" in recording
        else np.tile(_ROTOR_SPEEDS_RAD_S, (len(t), 1))
    )
    phase = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(t)[:, None], axis=0)])
    x, v, e, w = (recording[f"truth_{q}"].values for q in ("position", "velocity", "attitude", "rates"))
    return VehiclePath(t, x, v, np.unwrap(e, axis=0), w, speed, phase)


class FrameEstimateSimulator:
    """Simulator of the vehicle's data for each picture, with errors like those of its filter."""

    def __init__(self, camera: Camera, seed: int = 0, *, tilt_sigma: float = TILT_SIGMA_RAD) -> None:
        self._camera, self._rng, self._tilt_sigma = camera, np.random.default_rng(seed), tilt_sigma
        self._tilt_error: _Array = tilt_sigma * self._rng.standard_normal(2)
        self._height_error: float = HEIGHT_SIGMA_M * float(self._rng.standard_normal())
        self._phase_offset = self._rng.uniform(0.0, 2 * math.pi, 2)
        self._gyro_bias = _GYRO_BIAS_RAD_S * self._rng.standard_normal(3)
        self._last_time_s = math.nan

    def simulate_estimate(self, motion: VehicleMotion) -> FrameEstimate:
        """Return what the vehicle's filter would report for a picture: the true motion with simulated errors."""
        dt = 0.0 if math.isnan(self._last_time_s) else motion.time_s - self._last_time_s
        self._last_time_s = motion.time_s
        rng = self._rng
        keep = math.exp(-dt / TILT_CORRELATION_TIME_S)
        self._tilt_error = keep * self._tilt_error + self._tilt_sigma * math.sqrt(
            1 - keep * keep
        ) * rng.standard_normal(2)
        keep = math.exp(-dt / HEIGHT_CORRELATION_TIME_S)
        self._height_error = (
            keep * self._height_error + HEIGHT_SIGMA_M * math.sqrt(1 - keep * keep) * rng.standard_normal()
        )
        r = motion.attitude
        roll, pitch = math.atan2(r[2, 1], r[2, 2]), -math.asin(r[2, 0])
        return FrameEstimate(
            roll + self._tilt_error[0], pitch + self._tilt_error[1], -float(motion.position[2]) + self._height_error,
            motion.rates + self._gyro_bias + _GYRO_NOISE_RAD_S * rng.standard_normal(3), motion.rotor_speed.copy(),
            motion.rotor_phase + self._phase_offset + PHASE_SIGMA_RAD * rng.standard_normal(2),
            tilt_sigma=max(self._tilt_sigma, math.radians(0.05)), height_sigma=HEIGHT_SIGMA_M,
            tilt_time_s=TILT_CORRELATION_TIME_S, height_time_s=HEIGHT_CORRELATION_TIME_S,
        )  # fmt: skip


def render_frames(
    camera: Camera,
    floor: Floor,
    path: VehiclePath,
    *,
    duration_s: float | None = None,
    world: World | None = None,
    seed: int = 0,
    light: Callable[[float], float] = lambda t: 1.0,
    lose: bool = False,
) -> Iterator[tuple[CameraFrame, VehicleMotion]]:
    """Yield pictures along a path, with the vehicle's data and the true motion.

    Parameters
    ----------
    lose : bool
        Drop pictures at the camera's radio loss rate.
    light : callable
        Time (s) to the light of the room.
    """
    renderer = Renderer(camera, floor, world, seed=seed)
    teller = FrameEstimateSimulator(camera, seed + 1)
    rng = np.random.default_rng([seed, 2])
    period = float(camera.sensor.period)
    begin = float(path.time_s[0])
    end = float(path.time_s[-1]) if duration_s is None else begin + duration_s
    for k in range(int((end - begin) / period)):
        motion = path.motion_at(begin + (k + 0.5) * period)
        picture, told = renderer.render_picture(motion, light(motion.time_s)), teller.simulate_estimate(motion)
        if lose and rng.uniform() < float(camera.radio.loss):
            continue
        yield CameraFrame(motion.time_s, picture, told), motion


def scatter_boxes(count: int, side_m: float, seed: int) -> World:
    """Return a world with random low boxes on the floor, in and around a square of this side."""
    rng = np.random.default_rng([seed, 77])
    boxes = []
    for _ in range(count):
        size = (*rng.uniform(0.1, 0.35, 2), rng.uniform(0.03, 0.12))
        n, e = rng.uniform(-0.8, side_m + 0.8, 2)
        boxes.append(Box((n, e, -0.5 * size[2]), size, rng.uniform(0, 3.1)))
    return World(boxes=tuple(boxes))
