r"""Checks of a camera against gyroscopes and attitude: frozen pictures, clock, mounting, focal length, delay, dirt.

**Motion of the picture.** A camera with rates w (its own axes) over a floor at height h moves the picture's middle by

    p = f (-w_y, w_x) - (f / h) (v_x, v_y)

in pixels per second; v is its velocity. A helicopter accelerates as it tilts, v' = g (-theta, phi) in the axes of its
heading, so attitude alone gives v up to a constant. Slow parts are removed from both sides by the same high pass
(:data:`_MOTION_HIGH_PASS_S`), since biases, drag and wind are slow. With p and the measured motion y as complex numbers
(picture x + i y), a camera that differs from its file shows

    y = m p + n conj(p) + k p',        p' the derivative of p.

| camera | m | n | k |
|---|---|---|---|
| as in its file | 1 | 0 | 0 |
| turned about its axis by a | e^(i a) | 0 | 0 |
| focal length in error by the factor s | s | 0 | 0 |
| mirrored | 0 | of size 1 | 0 |
| pictures late by t | 1 | 0 | -t |

A vehicle with still rotors is carried by hand: p is then the rotation alone, and the residuals contain the way.
Recursive least squares with exponential forgetting (:data:`_FIT_MEMORY_S`) gives m, n, k and their covariance from the
residuals (Ljung, *System Identification*, 1999, Sec. 11.2), times (1 + r) / (1 - r) by hand, for residuals with the
correlation r from picture to picture. A fault is reported if a steady estimate deviates by
:data:`_MIN_FAULT_DEVIATION_SIGMAS` standard deviations and by a least amount. A second estimate forgets within
:data:`_GROSS_FIT_MEMORY_S`, so that an opposite motion is also found soon after a time without fault. Pictures that are
flipped along x or y or both have y = -conj(p), conj(p) or -p. These have no unknown number, so a sequential test of
each axis against y = p finds them first (Wald, *Sequential Analysis*, 1947). Own derivation.

**Tilt.** Tracking estimates the errors of the reported tilt from the shear of the floor
(:mod:`mufly.slam.camera_pose`). An error that stays beyond the filter's deviation shows a tilted mount. A small tilt
moves the place by the height times it, so poses continue with that deviation; without them the landing is blind.

**Copies.** Noise makes any two new pictures differ, so identical pictures are copies.

**Dirt** stays at its pixels. In the mean of n pictures of different floor the dirt remains, while the floor, with grey
levels of deviation s, averages out to s / sqrt(n). A pixel is dirty under two conditions: its mean differs from the
surroundings by more than :data:`_MIN_DIRT_CONTRAST_SIGMAS` s / sqrt(n), and its own deviation is below
:data:`_DIRT_MAX_DEVIATION_FRACTION` s, since dirt hides the floor. The pictures of the mean were taken at different
places: a hover would show the same floor at the same pixels. On a straight path, bands along it stay, too, so the
mean must also differ from its surroundings along the path. More than :data:`_MAX_DIRT_FRACTION` of a picture is not
dirt but a floor that repeats along the path, such as stripes.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, body_from_camera_rotation
from mufly.dynamics import GRAVITY
from mufly.slam.camera_frame import CameraFrame, FrameEstimate
from mufly.slam.image_tools import are_pixels_in_mask, correlate_patches, import_opencv, subtract_local_mean
from mufly.slam.images.direct_alignment import add_point_errors
from mufly.slam.images.patch_information import measure_patch_shifts

_Array = NDArray[np.float64]
_MOTION_HIGH_PASS_S, _FIT_MEMORY_S, _GROSS_FIT_MEMORY_S, _VELOCITY_DECAY_S = 0.4, 6.0, 1.2, 4.0
_MIN_FAULT_DEVIATION_SIGMAS, _MIN_FAULT_FIT_FRAMES, _MIN_GROSS_FIT_FRAMES = 5.0, 40, 12
_MIN_REPORTED_TURN_ERROR_RAD, _MIN_REPORTED_FOCAL_ERROR_FRACTION, _MIN_REPORTED_DELAY_ERROR_S = (
    math.radians(7.0),
    0.1,
    0.03,
)
"""Least errors of turn, focal length (fraction) and delay that are reported."""
_MIN_PLAUSIBLE_FOCAL_SCALE = 0.5
"""Scale below which no focal length is wrong, but the estimate passes from 1 to that of a flip."""
_FROZEN_PICTURE_COUNT, _STOPPED_CLOCK_COUNT = 4, 4
_FAULT_CONFIRM_COUNT, _GROSS_FAULT_CONFIRM_COUNT, _FAULT_REPORT_HOLD_S = 10, 6, 10.0
"""Consecutive pictures that confirm a fault, and a gross fault; time for which a fault is reported after it was last
seen (s)."""
_LOCAL_MEAN_SIDE_PX = 25  # side of the mean that is subtracted, at half the resolution
_MIN_CAMERA_CHECK_HEIGHT_M = 0.2  # below which the height is known too poorly
_MOUNT_TILT_AVERAGE_S, _MOUNT_TILT_FAULT_SIGMAS, _MIN_MOUNT_TILT_FAULT_RAD, _MAX_USABLE_MOUNT_TILT_RAD = (
    1.5,
    2.5,
    math.radians(1.2),
    math.radians(3.0),
)
FAULTY_MOUNT_TILT_SIGMA_RAD = math.radians(4.0)
"""Standard deviation of the tilt of a mount that is reported, and not refused (rad). Tracking finds a part of it."""
_DIRT_PICTURE_REDUCTION, _DIRT_BACKGROUND_BLUR_PX, _DIRT_MIN_MOTION_PX, _DIRT_MIN_PICTURES, _DIRT_MAX_PICTURES = (
    4,
    8.0,
    40.0,
    7,
    9,
)
"""Reduction of the picture, smoothing of the surroundings (reduced pixels), least distance between the places of two
pictures (pixels), and least and largest number of pictures."""
_DIRT_PATH_SMOOTHING_PX = 16.0  # smoothing of the surroundings along the path (reduced pixels)
_MIN_DIRT_CONTRAST_SIGMAS, _DIRT_MAX_DEVIATION_FRACTION, _MIN_DIRT_GREY_LEVELS, _MAX_DIRT_FRACTION, _DIRT_MARGIN_PX = (
    5.0,
    0.5,
    10.0,
    0.25,
    12,
)
_MIN_LIT_GREY_STD = 2.0
"""Standard deviation of grey levels below which equal pictures are dark, not frozen."""
_GROSS_FAULT_SIGMAS = 3.0
_MAX_RESIDUAL_CORRELATION = 0.95  # of neighbouring residuals
_FLIP_SIGMA_PX_S, _MAX_FLIP_LOG_LIKELIHOOD_STEP, _FLIP_LOG_LIKELIHOOD_LIMIT = 15.0, 3.0, 15.0
"""Usual residual of the motion along an axis (pixels/s), and the largest step and the limit of the logarithm of the
likelihood ratio between a flipped and a correct axis."""
_HAND_CARRIED_FLIP_SIGMA_PX_S = 60.0
"""The same by hand, where the place moves by an unknown velocity."""
_DOUBTED_FLIP_SIGMA_PX_S = 30.0
"""The least of the same against the vehicle's velocity after a break of tracking, without high pass."""
_FLIP_MEMORY_S, _MAX_FLIP_RESIDUAL_FRACTION = 0.5, 0.25
"""Memory of the residuals (s), and largest fraction of the motion that a flip leaves; other faults leave more."""
_MAX_SETTLED_CHANGE_FRACTION, _MAX_SETTLED_CHANGE = 0.3, 0.05
"""Largest change of a steady estimate over the confirming pictures: fraction of its deviation, and absolute."""
_MIRRORED_MESSAGE = "the picture moves mirrored against the gyroscopes: check the camera's driver"
_MIN_CORRELATED_POINTS, _CORRELATION_WINDOW_PX, _MIN_CORRELATION, _MIN_STRONG_CORRELATION = 24, 21, 0.5, 0.85
_REVERSED_MESSAGE = "the picture moves opposite to the vehicle: check mount.turn and the camera's driver"
_UPSIDE_DOWN_MESSAGE = "the camera is upside down against the gyroscopes: check mount.turn"
_ROLLING_SHUTTER_SHIFT_SIGMA_PX = 1.0
"""Deviation of a patch by vibration in a rolling shutter (pixels of half the resolution)."""


@dataclass(frozen=True)
class CameraDiagnosis:
    """Result of the checks of a camera: its fault, or none.

    Attributes
    ----------
    fault : str
        One of "", "frozen", "clock", "mirrored", "turned", "tilted", "focal length", "delay".
    message : str
        One line for the user.
    """

    fault: str = ""
    message: str = ""


_HEALTHY_DIAGNOSIS = CameraDiagnosis()


class CameraMonitor:
    """Monitor that detects faults of a camera from its pictures and the vehicle's motion.

    Parameters
    ----------
    camera : Camera
    focal_px, smooth : float
        Focal length and smoothing of undistorted pictures (pixels).
    """

    def __init__(self, camera: Camera, focal_px: float, smooth: float) -> None:
        self._camera, self._focal_px, self._smooth = camera, focal_px, 0.5 * math.hypot(smooth, 1.0)
        self._camera_from_body = body_from_camera_rotation(camera).T
        self._last_raw: NDArray[np.uint8] | None = None
        self._equal_count = self._stopped_count = 0
        self._last_small: NDArray[np.uint8] | None = None
        self._last_frame: CameraFrame | None = None
        self._last_level_velocity = np.zeros(2)
        self._slow = np.zeros(2, complex)  # slow parts of y and p
        self._past: list[tuple[complex, complex]] = []  # y and p at the latest pictures, high-passed
        self._fit, self._quick_fit = MotionFit(_FIT_MEMORY_S), MotionFit(_GROSS_FIT_MEMORY_S)
        self._flips, self._is_doubted = FlipTest(), False
        self._latest: deque[NDArray[np.complex128]] = deque(maxlen=_FAULT_CONFIRM_COUNT)  # estimates
        self._candidate, self._candidate_count = _HEALTHY_DIAGNOSIS, 0
        self._verdict, self._held_until_s = _HEALTHY_DIAGNOSIS, -math.inf
        self._tilt, self._tilt_weight, self._tilt_time_s = np.zeros(2), 0.0, math.nan
        self._tilt_verdict, self._tilt_held_until_s = _HEALTHY_DIAGNOSIS, -math.inf
        self._dirt = DirtMask()

    @property
    def motion_coefficients(self) -> NDArray[np.complex128]:
        """Estimated coefficients m, n and k (3,) of the motion in the picture; 1, 0 and 0 for a correct camera."""
        return self._fit.estimate

    @property
    def motion_coefficient_sigma(self) -> _Array:
        """Standard deviations (3,) of the coefficients m, n and k along one axis."""
        return self._fit.sigma

    def check_picture_times(self, time_s: float, last_time_s: float) -> CameraDiagnosis:
        """Return the fault of a stopped clock if the times of several pictures do not advance, else no fault."""
        self._stopped_count = self._stopped_count + 1 if time_s <= last_time_s else 0
        if self._stopped_count < _STOPPED_CLOCK_COUNT:
            return _HEALTHY_DIAGNOSIS
        return CameraDiagnosis("clock", f"the times of the pictures do not advance (at {time_s:.3f} s)")

    def count_if_copy(self, picture: NDArray[np.uint8]) -> bool:
        """Return whether a picture is a copy of the one before; counts copies."""
        before, self._last_raw = self._last_raw, picture
        equal = (
            before is not None
            and float(self._camera.quality.noise) > 0.0
            and np.array_equal(before, picture)
            and float(picture[::4, ::4].std()) > _MIN_LIT_GREY_STD
        )
        self._equal_count = self._equal_count + 1 if equal else 0
        return equal

    @property
    def frozen_picture_diagnosis(self) -> CameraDiagnosis:
        """The verdict on frozen pictures, that is successive identical copies."""
        if self._equal_count < _FROZEN_PICTURE_COUNT:
            return _HEALTHY_DIAGNOSIS
        return CameraDiagnosis("frozen", "the pictures are frozen: they are identical")

    @property
    def dirt_mask(self) -> NDArray[np.uint8] | None:
        """Nonzero at dirty pixels of the undistorted picture; None if it is clean."""
        return self._dirt.mask

    def check_motion(self, frame: CameraFrame, picture: NDArray[np.uint8]) -> CameraDiagnosis:
        """Return the verdict on the motion of the undistorted picture."""
        self._measure_motion(frame, picture)
        return self.diagnose_at(frame.time_s)

    def diagnose_at(self, time_s: float) -> CameraDiagnosis:
        """Return the camera fault that holds at a time (s), if any; during a fault no pose is used."""
        return self._verdict if time_s < self._held_until_s else _HEALTHY_DIAGNOSIS

    def diagnose_tilt_at(self, time_s: float) -> CameraDiagnosis:
        """Return the fault of a tilted mount if it holds at a time (s); poses are less accurate meanwhile."""
        return self._tilt_verdict if time_s < self._tilt_held_until_s else _HEALTHY_DIAGNOSIS

    def check_tilt(self, time_s: float, tilt_error_rad: _Array, sigma_rad: float) -> None:
        """Update the check of the mount by tracking's tilt error (2,) and the filter's standard deviation (rad)."""
        dt = time_s - self._tilt_time_s if self._tilt_time_s < time_s else 0.0
        self._tilt_time_s = time_s
        keep = math.exp(-dt / _MOUNT_TILT_AVERAGE_S)
        self._tilt = keep * self._tilt + (1.0 - keep) * tilt_error_rad
        self._tilt_weight = keep * self._tilt_weight + 1.0 - keep
        size = math.hypot(*self._tilt) / max(self._tilt_weight, 1e-9)
        if self._tilt_weight > 0.7 and size > max(_MIN_MOUNT_TILT_FAULT_RAD, _MOUNT_TILT_FAULT_SIGMAS * sigma_rad):
            message = f"the floor is seen {math.degrees(size):.1f} degrees off the attitude: check the camera's mount"
            verdict, until_s = CameraDiagnosis("tilted", message), time_s + _FAULT_REPORT_HOLD_S
            if size > _MAX_USABLE_MOUNT_TILT_RAD:
                self._verdict, self._held_until_s = verdict, until_s
            else:  # one report, whose message stays
                held = self.diagnose_tilt_at(time_s)
                self._tilt_verdict, self._tilt_held_until_s = held if held.fault else verdict, until_s
            self._tilt, self._tilt_weight = np.zeros(2), 0.0

    def restart_flip_test(self) -> None:
        """Test anew whether the picture is flipped, since tracking has broken (:mod:`mufly.slam.tracking_breaks`)."""
        self._flips.forget_pictures()
        self._is_doubted = True

    def end_motion_doubt(self) -> None:
        """End the doubt, since a keyframe from before the break is recognised."""
        self._flips, self._is_doubted = FlipTest(), False

    @property
    def is_motion_doubted(self) -> bool:
        """Whether the motion of the picture has not yet agreed with the vehicle's after a break of tracking."""
        return self._is_doubted

    def _measure_motion(self, frame: CameraFrame, picture: NDArray[np.uint8]) -> None:
        small = import_opencv().pyrDown(picture)
        before, last = self._last_small, self._last_frame
        self._last_small, self._last_frame = small, frame
        if before is None or last is None:
            return
        dt = frame.time_s - last.time_s
        velocity = self._last_level_velocity
        self._advance_velocity(last.vehicle_estimate, frame.vehicle_estimate, min(dt, 0.5))
        moved = None
        if (
            0.0 < dt < 1.6 * float(self._camera.sensor.period)
            and frame.vehicle_estimate.height_m > _MIN_CAMERA_CHECK_HEIGHT_M
        ):
            moved = measure_picture_shift(before, small, self._smooth, self._dirt.wide_mask)
        if moved is None:
            self._past = []
            return
        yaw_rate = 0.5 * (last.vehicle_estimate.heading_rate_rad_s + frame.vehicle_estimate.heading_rate_rad_s)
        self._dirt.shift_stored_positions(2.0 * moved, yaw_rate * dt)
        if self._dirt.sees_new_floor:
            clean = self._dirt.mask is None
            self._dirt.add_picture(picture)
            if clean and self._dirt.mask is not None:  # it has held the motion back
                self._fit.forget_pictures()
                self._quick_fit.forget_pictures()
        y = 2.0 * moved / dt
        if self._is_doubted:
            self._test_doubted_motion(last.vehicle_estimate, frame.vehicle_estimate, dt, y)
        velocity = 0.5 * (velocity + self._last_level_velocity)
        p = self._predict_motion(last.vehicle_estimate, frame.vehicle_estimate, velocity)
        self._slow = low_pass_motion(self._slow, np.array([y, p]), dt, yaw_rate)
        self._past = [*self._past[-2:], (y - self._slow[0], p - self._slow[1])]
        if len(self._past) == 3:
            (_, p0), (y, p), (_, p2) = self._past
            row = np.array([p, p.conjugate(), (p2 - p0) / (2.0 * dt)])
            driven = bool(frame.vehicle_estimate.rotor_speed.any())
            for fit in (self._fit, self._quick_fit):
                fit.add_picture(dt, row, y)
            if not self._is_doubted:
                self._flips.add_picture(dt, p, y, _FLIP_SIGMA_PX_S if driven else _HAND_CARRIED_FLIP_SIGMA_PX_S)
            self._latest.append(self.motion_coefficients[:2].copy())
            self._confirm_fault(frame.time_s)

    def _test_doubted_motion(self, before: FrameEstimate, now: FrameEstimate, dt: float, y: complex) -> None:
        """Test the motion after a break against the vehicle's velocity, which no picture has changed since.

        A steady velocity shows a flip at once. Without a velocity, the motion by tilt and rotation is used.
        """
        velocity = self._last_level_velocity
        if now.velocity is not None and now.place is not None:
            turned = complex(now.velocity[0], now.velocity[1]) * cmath.exp(-1j * float(now.place[2]))
            velocity = np.array([turned.real, turned.imag])
        sigma = max(_DOUBTED_FLIP_SIGMA_PX_S, self._fit.residual_rms)
        self._flips.add_picture(dt, self._predict_motion(before, now, velocity), y, sigma)
        self._is_doubted = not self._flips.is_motion_correct

    def _confirm_fault(self, time_s: float) -> None:
        """Set the camera's verdict to a fault once several pictures in a row show it."""
        is_known = self._fit.weight > _MIN_FAULT_FIT_FRAMES
        flip = found = self._flips.judge_flips()
        if not found.fault:
            found = detect_reversed_picture(self._quick_fit.estimate, self._quick_fit.sigma)
        if not found.fault and is_known and self._is_fit_settled:
            found = diagnose_camera_from_motion(self.motion_coefficients, self.motion_coefficient_sigma)
        if not found.fault:
            found = detect_reversed_picture(self.motion_coefficients, self.motion_coefficient_sigma)
        self._candidate_count = self._candidate_count + 1 if found.fault == self._candidate.fault else 1
        self._candidate = found
        needed = 1 if flip.fault else _FAULT_CONFIRM_COUNT if is_known else _GROSS_FAULT_CONFIRM_COUNT
        if found.fault and self._candidate_count >= needed:
            if time_s > self._held_until_s or self._verdict.fault != found.fault:
                self._verdict = found
            self._held_until_s = time_s + _FAULT_REPORT_HOLD_S

    @property
    def _is_fit_settled(self) -> bool:
        """Whether m and n have settled; during a change of the camera their values are meaningless."""
        first, last = self._latest[0], self._latest[-1]
        off = float(np.abs(last - [1.0, 0.0]).max())
        return float(np.abs(last - first).max()) < max(_MAX_SETTLED_CHANGE, _MAX_SETTLED_CHANGE_FRACTION * off)

    def _advance_velocity(self, before: FrameEstimate, now: FrameEstimate, dt: float) -> None:
        """Integrate forward and right velocity from the tilt; the velocity decays, so that errors do not add up.

        With still rotors a hand carries the vehicle, whose velocity is unknown.
        """
        if not now.rotor_speed.any():
            self._last_level_velocity = np.zeros(2)
            return
        pitch, roll = 0.5 * (before.pitch + now.pitch), 0.5 * (before.roll + now.roll)
        push = GRAVITY * np.array([-math.tan(pitch), math.tan(roll)])
        push = push + now.heading_rate_rad_s * np.array([self._last_level_velocity[1], -self._last_level_velocity[0]])
        self._last_level_velocity = math.exp(-dt / _VELOCITY_DECAY_S) * self._last_level_velocity + dt * push

    def _predict_motion(self, before: FrameEstimate, now: FrameEstimate, velocity: _Array) -> complex:
        """Return the floor's predicted motion in the picture (pixels/s), p of the module docstring."""
        w = self._camera_from_body @ (0.5 * (before.rates + now.rates))
        place = self._camera.mount.place.to_array()[0]
        lever = np.cross(0.5 * (before.rates + now.rates), place)
        v = self._camera_from_body @ (np.append(velocity, 0.0) + lever)
        flow = np.array([-w[1], w[0]]) - v[:2] / max(0.1, now.height_m - place[2])
        return self._focal_px * complex(flow[0], flow[1])


def low_pass_motion(
    slow: NDArray[np.complex128], motion: NDArray[np.complex128], dt: float, yaw_rate_rad_s: float
) -> NDArray[np.complex128]:
    """Return the low-pass filtered motion in the picture: ``slow``, updated by the ``motion`` of the next ``dt`` (s).

    A velocity that is steady in N-E axes, as in a steady wind, rotates in the picture when the vehicle yaws. The slow
    part is rotated in the same way, so that yawing does not count as motion.
    """
    keep = math.exp(-dt / _MOTION_HIGH_PASS_S)
    turned: NDArray[np.complex128] = keep * cmath.exp(-1j * yaw_rate_rad_s * dt) * slow + (1.0 - keep) * motion
    return turned


class FlipTest:
    """Sequential test whether pictures are mirrored along x, along y, or along both (turned by 180 degrees)."""

    def __init__(self) -> None:
        self._ratio = np.full(
            2, -_FLIP_LOG_LIKELIHOOD_LIMIT
        )  # logarithm of the likelihood ratio, flipped over correct; x, y
        self._squares = np.zeros((2, 2))  # of the residuals, by flips along x and y
        self._motion_square, self._is_restarted = 0.0, False

    def forget_pictures(self) -> None:
        """Forget the pictures: a flipped and a correct axis are equally likely."""
        self._ratio = np.zeros(2)
        self._squares, self._motion_square, self._is_restarted = np.zeros((2, 2)), 0.0, True

    @property
    def is_motion_correct(self) -> bool:
        """Whether both axes are correct with near certainty."""
        return bool(self._ratio.max() < -0.5 * _FLIP_LOG_LIKELIHOOD_LIMIT)

    def add_picture(self, dt: float, predicted: complex, measured: complex, sigma: float = _FLIP_SIGMA_PX_S) -> None:
        """Add the predicted and the measured motion of a picture, ``dt`` (s) after the one before.

        ``sigma`` is the usual residual along an axis (pixels/s).
        """
        p, y = np.array([predicted.real, predicted.imag]), np.array([measured.real, measured.imag])
        # (y + p)^2 - (y - p)^2 = 4 p y; halved again, since the errors of successive pictures are alike
        step = np.clip(-p * y / sigma**2, -_MAX_FLIP_LOG_LIKELIHOOD_STEP, _MAX_FLIP_LOG_LIKELIHOOD_STEP)
        self._ratio = np.clip(self._ratio + step, -_FLIP_LOG_LIKELIHOOD_LIMIT, 1.2 * _FLIP_LOG_LIKELIHOOD_LIMIT)
        keep = math.exp(-dt / _FLIP_MEMORY_S)
        (x0, y0), (x1, y1) = (y - p) ** 2, (y + p) ** 2
        self._squares = keep * self._squares + np.array([[x0 + y0, x0 + y1], [x1 + y0, x1 + y1]])
        self._motion_square = keep * self._motion_square + float(y @ y)

    def judge_flips(self) -> CameraDiagnosis:
        """Return the verdict whether the pictures are flipped along an axis."""
        flipped = self._ratio > _FLIP_LOG_LIKELIHOOD_LIMIT
        is_known = flipped | (self._ratio < -0.5 * _FLIP_LOG_LIKELIHOOD_LIMIT)
        if not flipped.any() or not (is_known.all() or self._is_restarted):
            return _HEALTHY_DIAGNOSIS
        if self._squares[int(flipped[0]), int(flipped[1])] > _MAX_FLIP_RESIDUAL_FRACTION * self._motion_square:
            return _HEALTHY_DIAGNOSIS
        if not is_known.all():
            return CameraDiagnosis("turned", _REVERSED_MESSAGE)
        return (
            CameraDiagnosis("turned", _UPSIDE_DOWN_MESSAGE)
            if flipped.all()
            else CameraDiagnosis("mirrored", _MIRRORED_MESSAGE)
        )


class MotionFit:
    """Recursive least squares, with forgetting, of the coefficients in y = m p + n conj(p) + k p' (module docstring).

    Parameters
    ----------
    memory_s : float
        Time constant of the forgetting (s).

    Attributes
    ----------
    estimate, sigma : (3,) arrays
        m, n and k, and their standard deviations along one axis.
    weight : float
        Effective number of pictures.
    """

    def __init__(self, memory_s: float) -> None:
        self._memory_s = memory_s
        self.estimate, self.sigma = np.array([1.0, 0.0, 0.0], complex), np.full(3, np.inf)
        self.forget_pictures()

    @property
    def residual_rms(self) -> float:
        """Root mean square of the residuals along one axis (pixels/s)."""
        return math.sqrt(0.5 * self._square / max(self.weight, 1.0))

    def forget_pictures(self) -> None:
        """Forget the pictures, but keep the estimate."""
        self._normal, self._right = np.zeros((3, 3), complex), np.zeros(3, complex)
        self._square = self._lagged = self.weight = 0.0
        self._last_off = 0j

    def add_picture(self, dt: float, row: NDArray[np.complex128], y: complex) -> None:
        """Update the coefficients by a picture's motion ``y`` and regressors (3,), ``dt`` (s) after the one before.

        The deviations allow for the correlation of successive residuals.
        """
        keep = math.exp(-dt / self._memory_s)
        off = y - row @ self.estimate
        limit = 4.0 * math.sqrt(max(self._square / max(self.weight, 1.0), 1.0))
        w = 1.0 if self.weight < 10.0 or abs(off) < limit else limit / abs(off)  # Huber
        self._normal = keep * self._normal + w * np.outer(row.conj(), row)
        self._right = keep * self._right + w * row.conj() * y
        self._square, self.weight = keep * self._square + w * abs(off) ** 2, keep * self.weight + w
        self._lagged = keep * self._lagged + w * (off * self._last_off.conjugate()).real
        self._last_off = off
        if self.weight < _MIN_GROSS_FIT_FRAMES:
            return
        inverse = np.linalg.inv(self._normal + 1e-6 * np.eye(3))
        self.estimate = inverse @ self._right
        rho = min(max(self._lagged / max(self._square, 1e-9), 0.0), _MAX_RESIDUAL_CORRELATION)
        alike = (1.0 + rho) / (1.0 - rho)
        self.sigma = np.sqrt(np.abs(np.diag(inverse)) * alike * self._square / max(self.weight - 3.0, 1.0) / 2.0)


def detect_reversed_picture(estimate: NDArray[np.complex128], sigma: _Array) -> CameraDiagnosis:
    """Return the fault of a mirrored or reversed picture if the motion shows it clearly, else no fault.

    A few pictures suffice.
    """
    m, n, _ = estimate
    if abs(n) > 0.5 + _GROSS_FAULT_SIGMAS * sigma[1] and abs(n) > abs(m) + _GROSS_FAULT_SIGMAS * sigma[0]:
        return CameraDiagnosis("mirrored", _MIRRORED_MESSAGE)
    if m.real < -0.3 - _GROSS_FAULT_SIGMAS * sigma[0]:
        return CameraDiagnosis("turned", _UPSIDE_DOWN_MESSAGE)
    return _HEALTHY_DIAGNOSIS


def diagnose_camera_from_motion(estimate: NDArray[np.complex128], sigma: _Array) -> CameraDiagnosis:
    """Return the verdict on the camera from m, n, k and their standard deviations along one axis (module docstring)."""
    m, n, k = estimate
    if max(sigma[0], sigma[1]) > 0.2:
        return _HEALTHY_DIAGNOSIS
    if abs(n) > 0.5 and abs(n) > 1.5 * abs(m):
        return CameraDiagnosis("mirrored", _MIRRORED_MESSAGE)
    turn, scale, s = cmath.phase(m), abs(m), sigma[0]
    if abs(turn) > max(_MIN_REPORTED_TURN_ERROR_RAD, _MIN_FAULT_DEVIATION_SIGMAS * s / max(scale, 0.2)) and scale > 0.4:
        how = "upside down" if abs(turn) > math.radians(150.0) else f"turned by {math.degrees(turn):.0f} degrees"
        return CameraDiagnosis("turned", f"the camera is {how} against the gyroscopes: check mount.turn")
    delay = -(k / m).real if scale > 0.4 else 0.0
    if abs(delay) > max(_MIN_REPORTED_DELAY_ERROR_S, _MIN_FAULT_DEVIATION_SIGMAS * sigma[2] / max(scale, 0.2)):
        return CameraDiagnosis("delay", f"the pictures are {1e3 * delay:.0f} ms late against the gyroscopes")
    # Stripes hold back the motion along them: n is then as large as the deviation of m.
    if scale > _MIN_PLAUSIBLE_FOCAL_SCALE and abs(scale - 1.0) > max(
        _MIN_REPORTED_FOCAL_ERROR_FRACTION, _MIN_FAULT_DEVIATION_SIGMAS * s, 2.0 * abs(n)
    ):
        or_dirt = " and the lens for dirt" if scale < 1.0 else ""
        return CameraDiagnosis(
            "focal length",
            f"the picture moves {scale:.2f} times as far as the gyroscopes: check the focal length{or_dirt}",
        )
    return _HEALTHY_DIAGNOSIS


class DirtMask:
    """Mask of pixels that do not change while the floor moves.

    Attributes
    ----------
    mask : (rows, columns) uint8 array or None
        Nonzero at dirt, with a margin; None if there is none.
    wide_mask : (rows, columns) uint8 array or None
        The same with a margin for windows at half the resolution.
    """

    def __init__(self) -> None:
        self._pictures: deque[NDArray[np.float32]] = deque(maxlen=_DIRT_MAX_PICTURES)
        self._places: deque[complex] = deque(maxlen=_DIRT_MAX_PICTURES)
        self.mask: NDArray[np.uint8] | None = None
        self.wide_mask: NDArray[np.uint8] | None = None

    def shift_stored_positions(self, moved_px: complex, turned_rad: float) -> None:
        """Rotate the stored positions by the vehicle's yaw (rad), then shift them by the floor's motion (pixels)."""
        turn = cmath.exp(-1j * turned_rad)
        self._places = deque((turn * place + moved_px for place in self._places), _DIRT_MAX_PICTURES)

    @property
    def sees_new_floor(self) -> bool:
        """Whether the present picture shows another part of the floor than all pictures stored in this mask."""
        return all(abs(place) > _DIRT_MIN_MOTION_PX for place in self._places)

    def add_picture(self, picture: NDArray[np.uint8]) -> None:
        """Add an undistorted picture of another part of the floor to the stored ones, and compute the mask from all."""
        cv2 = import_opencv()
        high, wide = picture.shape
        small = cv2.resize(
            picture, (wide // _DIRT_PICTURE_REDUCTION, high // _DIRT_PICTURE_REDUCTION), interpolation=cv2.INTER_AREA
        ).astype(np.float32)
        small -= cv2.GaussianBlur(small, (0, 0), _DIRT_BACKGROUND_BLUR_PX)
        self._pictures.append(small)
        self._places.append(0j)
        count = len(self._pictures)
        if count < _DIRT_MIN_PICTURES:
            return
        mean, variance = np.mean(self._pictures, axis=0), np.var(self._pictures, axis=0, ddof=1)
        usual = math.sqrt(float(np.median(variance)))
        least = max(_MIN_DIRT_GREY_LEVELS, _MIN_DIRT_CONTRAST_SIGMAS * usual / math.sqrt(count))
        still = cv2.blur(variance, (3, 3)) < (_DIRT_MAX_DEVIATION_FRACTION * usual) ** 2
        beside = np.abs(mean - cv2.filter2D(mean, -1, self._path_kernel()))
        dirty = ((np.abs(mean) > least) & (beside > least) & still).astype(np.uint8)
        dirty = cv2.morphologyEx(dirty, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        self.mask = self.wide_mask = None
        if 0 < int(dirty.sum()) < _MAX_DIRT_FRACTION * dirty.size:
            whole = cv2.resize(dirty, (wide, high), interpolation=cv2.INTER_NEAREST)
            self.mask, self.wide_mask = (
                cv2.dilate(whole, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
                for margin in (_DIRT_MARGIN_PX, _DIRT_MARGIN_PX + _CORRELATION_WINDOW_PX)
            )

    def _path_kernel(self) -> _Array:
        """Return a smoothing kernel along the principal axis of the positions of the stored pictures."""
        places = np.array(self._places) - np.mean(self._places)
        # The sum of squares has twice the angle of the axis.
        axis = cmath.exp(0.5j * cmath.phase(complex((places**2).sum())))
        reach = round(2.0 * _DIRT_PATH_SMOOTHING_PX)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        along, across = x * axis.real + y * axis.imag, y * axis.real - x * axis.imag
        kernel = np.exp(-0.5 * (along / _DIRT_PATH_SMOOTHING_PX) ** 2 - 0.5 * (across / 0.7) ** 2)
        out: _Array = kernel / kernel.sum()
        return out


def measure_picture_shift(
    before: NDArray[np.uint8], now: NDArray[np.uint8], smooth: float, dirt: NDArray[np.uint8] | None = None
) -> complex | None:
    """Return the shift of the picture's centre from ``before`` to ``now`` (pixels); None if a direction lacks texture.

    Points are tracked, and a shift, a rotation and a scale are fitted to them. Noise draws tracks to no motion, so on
    a floor whose patches correlate less than :data:`_MIN_STRONG_CORRELATION` all patches are then aligned together,
    with the information of :mod:`mufly.slam.images.patch_information`.

    Parameters
    ----------
    before, now : (rows, columns) uint8 arrays
        The two pictures (grey levels).
    smooth : float
        Their smoothing (pixels).
    dirt : (2 rows, 2 columns) uint8 array, optional
        Mask of dirty pixels at twice the resolution.
    """
    cv2 = import_opencv()
    high, wide = now.shape
    x, y = np.meshgrid(np.linspace(14, wide - 15, 10), np.linspace(14, high - 15, 7))
    points = np.column_stack([x.ravel(), y.ravel()])
    if dirt is not None:
        points = points[~are_pixels_in_mask(dirt, 2.0 * points)]
        if len(points) < _MIN_CORRELATED_POINTS:
            return None
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        before, now, points.astype(np.float32).reshape(-1, 1, 2), None,
        winSize=(_CORRELATION_WINDOW_PX, _CORRELATION_WINDOW_PX), maxLevel=2,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02),
    )  # fmt: skip
    there = there.reshape(-1, 2).astype(np.float64)
    correlation, sigma = np.zeros(len(points)), np.full(len(points), 1e3)
    correlate_patches(before, now, points, there, found.reshape(-1), smooth, correlation, sigma)
    good = correlation > _MIN_CORRELATION
    if good.sum() < _MIN_CORRELATED_POINTS // 2:
        return None
    cx, cy = (points - [0.5 * (wide - 1), 0.5 * (high - 1)]).T
    one, none = np.ones(len(points)), np.zeros(len(points))
    jacobian = np.stack([np.stack([one, none, cx, -cy], axis=1), np.stack([none, one, cy, cx], axis=1)], axis=1)
    fit, use = np.zeros(4), good
    for _ in range(3):
        fit = np.linalg.lstsq(jacobian[use].reshape(-1, 4), (there - points)[use].ravel(), rcond=None)[0]
        off = np.hypot(*(there - points - jacobian @ fit).T)
        use = good & (off < max(0.5, 2.5 * float(np.median(off[good]))))
    if use.sum() < _MIN_CORRELATED_POINTS // 2:
        return None
    if float(correlation[good].mean()) > _MIN_STRONG_CORRELATION:
        return complex(fit[0], fit[1])
    flat = subtract_local_mean(before, _LOCAL_MEAN_SIDE_PX), subtract_local_mean(now, _LOCAL_MEAN_SIDE_PX)
    coarse = (cv2.pyrDown(flat[0]), cv2.pyrDown(flat[1]), 0.5 * math.hypot(smooth, 1.0))
    level_axes, known = np.tile(np.eye(2), (len(points), 1, 1)), False
    for scale, half, (a, b, s) in ((2.0, 5, coarse), (1.0, 7, (*flat, smooth)), (1.0, 7, (*flat, smooth))):
        moved = jacobian @ fit
        middle = 0.5 * (scale - 1.0)
        patches = measure_patch_shifts(
            a, b, (points - middle) / scale, (points + moved - middle) / scale, s, level_axes, half
        )
        known = bool(patches.textured_directions.all())
        if not known:
            continue
        shift = moved + scale * patches.shift_px
        information = add_point_errors(
            patches.information / scale**2, np.full(len(points), _ROLLING_SHUTTER_SHIFT_SIGMA_PX)
        )
        for _ in range(2):
            off = shift - jacobian @ fit
            square = np.einsum("ni,nij,nj->n", off, information, off)
            weight = information / (1.0 + square / 8.0)[:, None, None]
            normal = np.einsum("nki,nkl,nlj->ij", jacobian, weight, jacobian)
            if np.linalg.cond(normal) > 1e12:
                return None
            fit = np.linalg.solve(normal, np.einsum("nki,nkl,nl->i", jacobian, weight, shift))
    return complex(fit[0], fit[1]) if known else None
