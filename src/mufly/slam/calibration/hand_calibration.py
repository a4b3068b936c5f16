r"""Calibration of a camera on its vehicle, moved by hand over a flat, level floor (batch least squares).

The recording holds pictures, gyroscopes, accelerometers and, if possible, the height (sonar). Unknown are the focal
length, principal point, first radial coefficient, rotation of the mount, place of the camera, delay of the stamps,
bias and scale of the gyroscopes, bias of the accelerometers and the initial tilt. Each segment of a few pictures
(:mod:`mufly.slam.calibration.point_tracks`) has seven more: velocity, logarithm of the camera's height, rotation error.

**Model.** Integrated rates give the attitude R(t); the specific force f gives the velocity up to a constant,

    v(t) = v_k + C(t) - C(t_k),    C' = R f + g,    p(t) = integral of v.

The camera has the attitude R R_c and the place p + R l, l its lever arm. The ray of a point in the first picture of a
segment meets the floor; the last picture shows this floor point. Each pixel has the time of its row: stamp less delay
plus row offset. Residuals, divided by their deviations, are

- pixels of the points in the last picture (Huber weights; deviation from their median absolute residual);
- steps of velocity, and of the height of the floor, between neighbouring segments;
- height of the camera against the sonar; rotation errors against the noise of the gyroscopes;
- priors of principal point, radial coefficient, lever arm, sensor scales and biases (:data:`_SHARED_PRIOR_SIGMA`).

Attitude, gravity and rates determine rotations in absolute terms, so the focal length needs no chessboard. It is the
ratio of pixels to radians; the perspective of the picture separates it from the scale of the gyroscopes. Mount and tilt
can be separated because the floor is level and gravity is measured. Gauss-Newton solves the sparse normal equations;
standard deviations are those of their inverse, times :data:`_STD_INFLATION_FACTOR`, since errors of neighbouring tracks
and segments are correlated. The pictures are then tracked again with patches warped by this fit, and fitted again.
Tracking by shift alone has errors of some hundredths of a pixel where the motion varies within a patch, which would
shift the principal point by pixels.

Own derivation, after Furgale, Rehder and Siegwart, *Unified Temporal and Spatial Calibration for Multi-Sensor Systems*,
2013 (Kalibr); noise from differences as in von Neumann, 1941.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from mufly.camera import Camera, body_from_camera_rotation, unproject_pixels
from mufly.camera.camera_model import BODY_FROM_DOWN_CAMERA, project_points
from mufly.errors import InputError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.slam.calibration.inertial_motion import (
    InertialData,
    IntegratedMotion,
    estimate_white_noise,
    integrate_inertial_data,
    multiply_quaternions,
    quaternion_exponential,
    rotation_matrices,
)
from mufly.slam.calibration.point_tracks import PointTracks, retrack_segments, track_segments
from mufly.slam.datasets.dataset_readers import (
    detect_dataset_layout,
    find_inertial_file,
    open_picture_source,
    read_inertial_data,
)
from mufly.vehicle.quantity import Quantity

_Array = NDArray[np.float64]
SEGMENT_PICTURE_COUNT = 3
"""Pictures from the first to the last of a segment."""
_STD_INFLATION_FACTOR = 2.0
"""Factor on all standard deviations, determined on other recordings than those used for validation."""
_SIGMAS_PER_95_PERCENT = 1.96
_MIN_SEGMENTS = 20
_MAX_FOCAL_SIGMA_FRACTION, _MAX_MOUNT_SIGMA_RAD = 0.03, math.radians(1.5)
_MAX_ITERATIONS, _STEP_TOLERANCE_SIGMAS, _ROW_TIME_ITERATIONS = 15, 0.05, 3
_DELAY_GRID_S = np.arange(-0.15, 0.301, 0.01)

FOCAL_SLICE, CENTRE_SLICE, RADIAL_SLICE, MOUNT_SLICE, DELAY_SLICE = (
    slice(0, 1),
    slice(1, 3),
    slice(3, 4),
    slice(4, 7),
    slice(7, 8),
)
GYRO_BIAS_SLICE, GYRO_SCALE_SLICE, ACCEL_BIAS_SLICE, LEVER_SLICE = (slice(a, a + 3) for a in (8, 11, 14, 17))
TILT_SLICE = slice(20, 22)
SHARED_UNKNOWN_COUNT, SEGMENT_UNKNOWN_COUNT = 22, 7
"""Unknowns of the whole recording (tilt has two), and of a segment: velocity, logarithm of the height, rotation."""
_VELOCITY_SLICE, _LOG_HEIGHT_INDEX, _TURN_ERROR_SLICE = slice(0, 3), 3, slice(4, 7)
_VELOCITY_STEP_COLUMNS, _FLOOR_STEP_COLUMN, _HEIGHT_ERROR_COLUMN, _ROTATION_ERROR_COLUMNS = (
    slice(0, 3),
    3,
    4,
    slice(5, 8),
)  # columns of residuals
_SHARED_PRIOR_SIGMA = np.array(
    [0.5, 8.0, 8.0, 0.03, 3.0, 3.0, 3.0, 0.3, *[0.2] * 3, *[0.03] * 3, *[0.3] * 3, *[0.1] * 3, 0.5, 0.5]
)
"""Deviations of the priors: focal length (fraction), centre (pixels of a 320 pixel picture), k1, mount (rad), delay
(s), gyroscopes (rad/s, fraction), accelerometers (m/s^2), lever arm (m), initial tilt (rad)."""
_SHARED_DIFFERENCE_STEPS = np.array(
    [1e-4, 0.05, 0.05, 1e-4, *[1e-4] * 3, 1e-4, *[1e-4] * 3, *[1e-4] * 3, *[1e-3] * 3, *[1e-3] * 3, 1e-4, 1e-4]
)
_SEGMENT_DIFFERENCE_STEPS = np.array([*[1e-3] * 3, 1e-4, *[1e-4] * 3])
_SONAR_SIGMA_M, _VELOCITY_STEP_SIGMA_M_S, _FLOOR_STEP_SIGMA_M = 0.025, 0.02, 0.004
_GIVEN_HEIGHT_STD_FRACTION = 0.2
"""Standard deviation of a given mean height, as a fraction of it."""
_MIN_PIXEL_SIGMA, _HUBER_THRESHOLD_SIGMAS = 0.05, 1.5
_MIN_GYRO_EXPLAINED_FRACTION = 0.3


@result(json="values deviations residual_px segments tracks")
class HandCalibration:
    """Camera with calibrated focal length, mounting and delay, and their standard deviations."""

    values: dict[str, float] = field(metadata={"unit": "1", "meaning": "estimates; the names state units"})
    deviations: dict[str, float] = field(metadata={"unit": "1", "meaning": "one sigma of each"})
    residual_px: float = field(metadata={"unit": "1", "meaning": "deviation of a point along an axis (pixels)"})
    segments: int = field(metadata={"unit": "1", "meaning": "segments of pictures"})
    tracks: int = field(metadata={"unit": "1", "meaning": "tracks of points"})
    camera: Camera = field(repr=False, metadata={"unit": "", "meaning": "the initial camera with these values"})

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the calibration as a sentence and a table."""
        rows = [
            (n, f"{v:.5g}", f"{v - _SIGMAS_PER_95_PERCENT * s:.5g} to {v + _SIGMAS_PER_95_PERCENT * s:.5g}")
            for (n, v), s in zip(self.values.items(), self.deviations.values(), strict=True)
        ]
        said = f"{self.tracks} tracks in {self.segments} segments; residual {self.residual_px:.2f} pixels"
        return [make_lines_block(said), make_table_block(("", "found", "95 % interval"), rows)]


def calibrate_from_folder(
    folder: Path, camera: Camera, *, height_m: float | None = None,
    on_picture: Callable[[int, int], None] | None = None,
) -> HandCalibration:  # fmt: skip
    """Calibrate a camera from a folder with pictures of a floor, inertial data and, if possible, heights.

    Parameters
    ----------
    folder : Path
        In the layout of mufly (``pictures.csv``, ``imu.csv``, ``sonar.csv``) or of EuRoC.
    camera : Camera
        Initial values of the estimated parameters, and all other parameters (distortion except k1, readout).
    height_m : float, optional
        Mean height above the floor (m), for a folder without ``sonar.csv``; known to 20 %.
    on_picture : callable, optional
        Called with the number of each picture and the number of all.

    Raises
    ------
    InputError
        If pictures or inertial data are missing, there are too few tracks, the pictures are mirrored, or the motion
        does not determine focal length or mount.
    """
    undelayed = camera.shutter.delay.model_copy(update={"value": 0.0})
    stamped = camera.model_copy(update={"shutter": camera.shutter.model_copy(update={"delay": undelayed})})
    source = open_picture_source(folder, stamped, height_m=height_m)
    file = find_inertial_file(folder, detect_dataset_layout(folder)) if folder.is_dir() else None
    if file is None:
        raise InputError(
            str(folder), "imu.csv", "is missing",
            "give a folder of mufly's or EuRoC's layout with rates and specific force",
        )  # fmt: skip
    imu = InertialData(*read_inertial_data(file))
    heights: list[tuple[float, float]] = []

    def iterate_pictures() -> Iterator[tuple[float, NDArray[np.uint8]]]:
        for frame in source.read_frames():
            heights.append((frame.time_s, frame.vehicle_estimate.height_m))
            yield frame.time_s, frame.picture

    def report_picture(k: int) -> None:
        if on_picture is not None:
            on_picture(k + 1, source.frame_count)

    tracks = track_segments(iterate_pictures(), SEGMENT_PICTURE_COUNT, report_picture)
    times, values = np.array(heights).T
    return fit_camera(
        tracks, camera, imu, height_m=lambda t: np.interp(t, times, values), frames=iterate_pictures,
        height_sigma_m=_SONAR_SIGMA_M if height_m is None else _GIVEN_HEIGHT_STD_FRACTION * height_m,
    )  # fmt: skip


def fit_camera(
    tracks: PointTracks, camera: Camera, imu: InertialData, *, height_m: Callable[[_Array], _Array],
    height_sigma_m: float = _SONAR_SIGMA_M,
    frames: Callable[[], Iterable[tuple[float, NDArray[np.uint8]]]] | None = None,
) -> HandCalibration:  # fmt: skip
    """Estimate lens, mounting and delay of a camera from tracks of floor points, inertial data and heights.

    Parameters
    ----------
    tracks : PointTracks
        Tracks in raw pictures of ``camera``'s size.
    camera : Camera
        Initial values of the estimated parameters, and all other parameters.
    imu : InertialData
        Inertial data, on the clock to which the delay refers.
    height_m : callable
        Function from times (n,) (s) to heights (n,) of the inertial unit above the floor (m).
    height_sigma_m : float
        Standard deviation of these heights (m).
    frames : callable, optional
        Returns stamps (s) and raw pictures, to track them again with patches warped by the first fit.

    Raises
    ------
    InputError
        As :func:`calibrate_from_folder`.
    """
    margin = float(_DELAY_GRID_S[-1])
    inside = (tracks.times_s[:, 0] > imu.time_s[0] + margin) & (tracks.times_s[:, 1] < imu.time_s[-1] - margin)
    tracks = _select_segments(tracks, inside)
    if len(tracks.times_s) < _MIN_SEGMENTS:
        raise InputError(
            "pictures", "", f"{len(tracks.times_s)} segments show the floor and have inertial data",
            "record 60 s over a floor with texture, 0.3 to 1.5 m above it",
        )  # fmt: skip
    problem = _CalibrationProblem.prepare_problem(tracks, camera, imu, height_m, height_sigma_m)
    shared, segment_states, covariance, sigma_px = _minimise_weighted_residuals(
        problem, problem.shared, problem.segment_states
    )
    if frames is not None:
        att = problem.integrate_inertial_data(shared)
        again = retrack_segments(
            frames(), tracks.times_s, lambda k, px: problem.predict_first_pixels(shared, segment_states, att, k, px)
        )
        problem = replace(problem, tracks=again)
        shared, segment_states, covariance, sigma_px = _minimise_weighted_residuals(problem, shared, segment_states)
    return problem.make_calibration(shared, _STD_INFLATION_FACTOR**2 * covariance, sigma_px)


def _minimise_weighted_residuals(
    problem: _CalibrationProblem, shared: _Array, segment_states: _Array
) -> tuple[_Array, _Array, _Array, float]:
    """Minimise the weighted residuals of tracks, segments and priors over all unknowns, by Gauss-Newton steps.

    Return the shared unknowns, the segments' states, the covariance of the shared unknowns, and the standard deviation
    of the pixel residuals.
    """
    covariance, sigma_px = np.zeros((SHARED_UNKNOWN_COUNT, SHARED_UNKNOWN_COUNT)), 0.0
    for _ in range(_MAX_ITERATIONS):
        sigma_px = problem.pixel_sigma(shared, segment_states)
        jacobian, residual = problem.linearise_residuals(shared, segment_states, sigma_px)
        factor = splu((jacobian.T @ jacobian).tocsc())
        step = -factor.solve(jacobian.T @ residual)
        shared = shared + step[:SHARED_UNKNOWN_COUNT]
        segment_states = segment_states + step[SHARED_UNKNOWN_COUNT:].reshape(-1, SEGMENT_UNKNOWN_COUNT)
        unit = np.zeros((len(step), SHARED_UNKNOWN_COUNT))
        unit[:SHARED_UNKNOWN_COUNT] = np.eye(SHARED_UNKNOWN_COUNT)
        covariance = factor.solve(unit)[:SHARED_UNKNOWN_COUNT]
        if np.abs(step[:SHARED_UNKNOWN_COUNT] / np.sqrt(np.diag(covariance))).max() < _STEP_TOLERANCE_SIGMAS:
            break
    return shared, segment_states, covariance, sigma_px


def _select_segments(tracks: PointTracks, keep: NDArray[np.bool_]) -> PointTracks:
    number = np.cumsum(keep) - 1
    kept = keep[tracks.segment] if len(tracks.segment) else np.zeros(0, np.bool_)
    return PointTracks(tracks.times_s[keep], number[tracks.segment[kept]], tracks.first_px[kept], tracks.last_px[kept])


@dataclass(frozen=True)
class _CalibrationProblem:
    """Residuals of the calibration and their derivatives."""

    tracks: PointTracks
    camera: Camera
    imu: InertialData
    heights_m: _Array
    height_sigma_m: float
    mount: _Array
    start: _Array
    shared: _Array
    segment_states: _Array
    gyro_noise: float
    accel_noise: float
    is_next_linked: NDArray[np.bool_]

    @classmethod
    def prepare_problem(
        cls, tracks: PointTracks, camera: Camera, imu: InertialData, height_m: Callable[[_Array], _Array],
        height_sigma_m: float,
    ) -> _CalibrationProblem:  # fmt: skip
        """Return the problem with initial values."""
        calm = imu.force_m_s2[: max(2, int(np.searchsorted(imu.time_s, imu.time_s[0] + 1.0)))].mean(axis=0)
        roll, pitch = math.atan2(-calm[1], -calm[2]), math.atan2(calm[0], math.hypot(calm[1], calm[2]))
        start = multiply_quaternions(
            quaternion_exponential(np.array([[0.0, pitch, 0.0]])), quaternion_exponential(np.array([[roll, 0.0, 0.0]]))
        )[0]
        delay, focal, turn = _guess_delay_focal_turn(tracks, camera, imu)
        mount = rotation_matrices(quaternion_exponential(np.array([[0.0, 0.0, turn]])))[0] @ body_from_camera_rotation(
            camera
        )
        shared = np.zeros(SHARED_UNKNOWN_COUNT)
        shared[FOCAL_SLICE], shared[DELAY_SLICE] = math.log(focal), delay
        shared[LEVER_SLICE] = camera.mount.place.to_array()[0]
        heights = height_m(tracks.times_s[:, 0] - delay)
        segment_states = np.zeros((len(tracks.times_s), SEGMENT_UNKNOWN_COUNT))
        segment_states[:, _LOG_HEIGHT_INDEX] = np.log(np.maximum(0.05, heights - shared[LEVER_SLICE][2]))
        gap = tracks.times_s[1:, 0] - tracks.times_s[:-1, 1]
        return cls(
            tracks, camera, imu, heights, height_sigma_m, mount, start, shared, segment_states,
            estimate_white_noise(imu.rates_rad_s), estimate_white_noise(imu.force_m_s2), np.abs(gap) < 1e-6,
        )  # fmt: skip

    @property
    def prior_mean(self) -> _Array:
        """Prior means of the unknowns that all segments share: lens, mounting, delay, errors of the inertial unit."""
        mean = np.zeros(SHARED_UNKNOWN_COUNT)
        mean[LEVER_SLICE] = self.camera.mount.place.to_array()[0]
        mean[DELAY_SLICE] = self.shared[DELAY_SLICE]
        return mean

    def integrate_inertial_data(self, shared: _Array) -> IntegratedMotion:
        """Return attitude, velocity and displacement by the inertial data, with the sensor errors in ``shared``."""
        tilt = quaternion_exponential(np.array([[*shared[TILT_SLICE], 0.0]]))
        return integrate_inertial_data(
            self.imu, multiply_quaternions(tilt, self.start[None])[0], gyro_bias=shared[GYRO_BIAS_SLICE],
            gyro_scale=shared[GYRO_SCALE_SLICE], accel_bias=shared[ACCEL_BIAS_SLICE],
        )  # fmt: skip

    def camera_with_lens(self, shared: _Array) -> Camera:
        """Return the camera with the estimated lens."""
        lens, scale = self.camera.lens, math.exp(shared[FOCAL_SLICE][0])

        def copy_with_value(q: Quantity, value: float) -> Quantity:
            return q.model_copy(update={"value": float(value)})

        return self.camera.model_copy(update={"lens": lens.model_copy(update={
            "focal_x": copy_with_value(lens.focal_x, float(lens.focal_x) * scale),
            "focal_y": copy_with_value(lens.focal_y, float(lens.focal_y) * scale),
            "centre_x": copy_with_value(lens.centre_x, float(lens.centre_x) + shared[CENTRE_SLICE][0]),
            "centre_y": copy_with_value(lens.centre_y, float(lens.centre_y) + shared[CENTRE_SLICE][1]),
            "k1": copy_with_value(lens.k1, float(lens.k1) + shared[RADIAL_SLICE][0]),
        })})  # fmt: skip

    def mount_rotation(self, shared: _Array) -> _Array:
        """Return the rotation matrix (3, 3) from camera to body axes."""
        return np.asarray(self.mount @ _make_rotation_matrix(shared[MOUNT_SLICE]))

    def _row_time_offsets_s(self, pixels: _Array) -> _Array:
        rows = self.camera.sensor.height
        return np.asarray((pixels[:, 1] / (rows - 1.0) - 0.5) * float(self.camera.shutter.readout))

    def point_residuals(self, shared: _Array, segment_states: _Array, att: IntegratedMotion) -> _Array:
        """Return the pixel residuals (n, 2) of the tracks."""
        tr = self.tracks
        return (
            self._transfer_points(shared, segment_states, att, tr.segment, tr.first_px, tr.last_px, True) - tr.last_px
        )

    def predict_first_pixels(
        self, shared: _Array, segment_states: _Array, att: IntegratedMotion, segment: int, last_px: _Array
    ) -> _Array:
        """Predict the pixels (n, 2) of floor points in a segment's first picture from those in its last."""
        k, first_px = np.full(len(last_px), segment), last_px
        for _ in range(_ROW_TIME_ITERATIONS):
            first_px = self._transfer_points(shared, segment_states, att, k, last_px, first_px, False)
        return first_px

    def _transfer_points(
        self, shared: _Array, segment_states: _Array, att: IntegratedMotion, k: NDArray[np.int64], pixels: _Array,
        rows_of: _Array, is_forward: bool,
    ) -> _Array:  # fmt: skip
        """Map floor points from the first to the last picture of segments ``k``, or back; return pixels (n, 2).

        The rows of ``rows_of`` (n, 2) give the exposure times of the result. ``is_forward``: from the first picture to
        the last.
        """
        lens, mount, lever = self.camera_with_lens(shared), self.mount_rotation(shared), shared[LEVER_SLICE]
        begin, end = (self.tracks.times_s - shared[DELAY_SLICE]).T
        v, e = segment_states[:, _VELOCITY_SLICE], segment_states[k, _TURN_ERROR_SLICE]
        speed0, way0 = att.velocity_at(begin), att.displacement_at(begin)

        def floor_position_at(t: _Array, turn: _Array) -> _Array:
            dt = (t - begin[k])[:, None]
            moved = v[k] * dt + att.displacement_at(t) - way0[k] - speed0[k] * dt
            return np.asarray(moved + turn @ lever)

        here, there = (begin, end) if is_forward else (end, begin)
        ta, tb = here[k] + self._row_time_offsets_s(pixels), there[k] + self._row_time_offsets_s(rows_of)
        turn_a, turn_b = att.rotation_at(ta), att.rotation_at(tb)
        floor_d = (att.rotation_at(begin) @ lever)[k, 2] + np.exp(segment_states[k, _LOG_HEIGHT_INDEX])
        ray = np.concatenate([unproject_pixels(lens, pixels), np.ones((len(k), 1))], axis=1) @ mount.T
        if not is_forward:
            ray = ray + np.cross(e, ray)
        d = np.einsum("nij,nj->ni", turn_a, ray)
        at = floor_position_at(ta, turn_a)
        point = at + d * ((floor_d - at[:, 2]) / np.maximum(d[:, 2], 0.05))[:, None]
        seen = np.einsum("nji,nj->ni", turn_b, point - floor_position_at(tb, turn_b))
        if is_forward:
            seen = seen - np.cross(e, seen)
        seen = seen @ mount
        seen[:, 2] = np.maximum(seen[:, 2], 0.02)
        return project_points(lens, seen)

    def segment_state_residuals(self, shared: _Array, segment_states: _Array, att: IntegratedMotion) -> _Array:
        """Return the residuals (segments, 8) of the segments' states, each over its standard deviation.

        Columns: jumps of velocity (3) and of the floor's height (1) at the next segment, deviation from the measured
        height (1), and errors of the rotation (3).
        """
        begin, end = (self.tracks.times_s - shared[DELAY_SLICE]).T
        v, height = segment_states[:, _VELOCITY_SLICE], np.exp(segment_states[:, _LOG_HEIGHT_INDEX])
        lever_d = np.einsum("nij,j->ni", att.rotation_at(begin), shared[LEVER_SLICE])[:, 2]
        speed, way = att.velocity_at(begin), att.displacement_at(begin)
        dt = (end - begin)[:, None]
        out = np.zeros((len(begin), 8))
        step = (v[1:] - v[:-1] - speed[1:] + speed[:-1]) / self._velocity_sigma
        moved = (v[:-1] * dt[:-1] + way[1:] - way[:-1] - speed[:-1] * dt[:-1])[:, 2]
        floor = moved + lever_d[1:] + height[1:] - lever_d[:-1] - height[:-1]
        out[:-1, _VELOCITY_STEP_COLUMNS] = step * self.is_next_linked[:, None]
        out[:-1, _FLOOR_STEP_COLUMN] = floor / _FLOOR_STEP_SIGMA_M * self.is_next_linked
        out[:, _HEIGHT_ERROR_COLUMN] = (height + lever_d - self.heights_m) / self.height_sigma_m
        out[:, _ROTATION_ERROR_COLUMNS] = segment_states[:, _TURN_ERROR_SLICE] / self._rotation_sigma
        return out

    @property
    def _median_segment_duration_s(self) -> float:
        return float(np.median(np.diff(self.tracks.times_s, axis=1)))

    @property
    def _median_sample_interval_s(self) -> float:
        return float(np.median(np.diff(self.imu.time_s)))

    @property
    def _velocity_sigma(self) -> float:
        return math.hypot(
            _VELOCITY_STEP_SIGMA_M_S,
            self.accel_noise * math.sqrt(self._median_sample_interval_s * self._median_segment_duration_s),
        )

    @property
    def _rotation_sigma(self) -> float:
        return max(1e-5, self.gyro_noise * math.sqrt(self._median_sample_interval_s * self._median_segment_duration_s))

    def pixel_sigma(self, shared: _Array, segment_states: _Array) -> float:
        """Return the robust standard deviation of the pixel residuals along one axis (pixels), from their median."""
        r = self.point_residuals(shared, segment_states, self.integrate_inertial_data(shared))
        return max(_MIN_PIXEL_SIGMA, 1.4826 * float(np.median(np.abs(r))))

    def linearise_residuals(self, shared: _Array, segment_states: _Array, sigma_px: float) -> tuple[Any, _Array]:
        """Return the sparse Jacobian of all weighted residuals with respect to the unknowns, and the residuals."""
        att = self.integrate_inertial_data(shared)
        points, chain = (
            self.point_residuals(shared, segment_states, att),
            self.segment_state_residuals(shared, segment_states, att),
        )
        size = np.hypot(*points.T) / sigma_px
        weight = np.sqrt(np.minimum(1.0, _HUBER_THRESHOLD_SIGMAS / np.maximum(size, 1e-9)))[:, None] / sigma_px
        n, m = points.size, chain.size
        dense = np.empty((n + m, SHARED_UNKNOWN_COUNT))
        for j in range(SHARED_UNKNOWN_COUNT):
            moved = shared.copy()
            moved[j] += _SHARED_DIFFERENCE_STEPS[j]
            integral = GYRO_BIAS_SLICE.start <= j < LEVER_SLICE.start or j >= TILT_SLICE.start
            other = self.integrate_inertial_data(moved) if integral else att
            dense[:n, j] = (
                weight * (self.point_residuals(moved, segment_states, other) - points)
            ).ravel() / _SHARED_DIFFERENCE_STEPS[j]
            dense[n:, j] = (
                self.segment_state_residuals(moved, segment_states, other) - chain
            ).ravel() / _SHARED_DIFFERENCE_STEPS[j]
        rows, columns, values = [], [], []
        of_point = np.repeat(self.tracks.segment, 2)
        of_chain = np.repeat(np.arange(len(segment_states)), chain.shape[1])
        for j in range(SEGMENT_UNKNOWN_COUNT):
            moved = segment_states.copy()
            moved[:, j] += _SEGMENT_DIFFERENCE_STEPS[j]
            change = (weight * (self.point_residuals(shared, moved, att) - points)).ravel() / _SEGMENT_DIFFERENCE_STEPS[
                j
            ]
            rows.append(np.arange(n))
            columns.append(SHARED_UNKNOWN_COUNT + SEGMENT_UNKNOWN_COUNT * of_point + j)
            values.append(change)
            for parity in (0, 1):  # a row depends on its segment and the next
                mask = np.arange(len(segment_states)) % 2 == parity
                moved = segment_states.copy()
                moved[mask, j] += _SEGMENT_DIFFERENCE_STEPS[j]
                change = (self.segment_state_residuals(shared, moved, att) - chain).ravel() / _SEGMENT_DIFFERENCE_STEPS[
                    j
                ]
                whose = np.where(mask[of_chain], of_chain, of_chain + 1)
                used = (whose < len(segment_states)) & (change != 0.0)
                rows.append(n + np.flatnonzero(used))
                columns.append(SHARED_UNKNOWN_COUNT + SEGMENT_UNKNOWN_COUNT * whose[used] + j)
                values.append(change[used])
        width = SHARED_UNKNOWN_COUNT + segment_states.size
        sparse = sp.coo_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n + m, width)
        )
        wide = sp.hstack([sp.csr_matrix(dense), sp.csr_matrix((n + m, segment_states.size))])
        prior_sigma = self._prior_sigmas
        prior: Any = sp.hstack(
            [sp.diags(1.0 / prior_sigma), sp.csr_matrix((SHARED_UNKNOWN_COUNT, segment_states.size))]
        )
        jacobian: Any = sp.vstack([sparse + wide, prior], format="csr")
        off = (shared - self.prior_mean) / prior_sigma
        return jacobian, np.concatenate([(weight * points).ravel(), chain.ravel(), off])

    @property
    def _prior_sigmas(self) -> _Array:
        out = _SHARED_PRIOR_SIGMA.copy()
        out[CENTRE_SLICE] *= self.camera.sensor.width / 320.0
        return out

    def make_calibration(self, shared: _Array, covariance: _Array, sigma_px: float) -> HandCalibration:
        """Return the calibrated camera with deviations; raise InputError if the motion does not determine it."""
        sigma = np.sqrt(np.diag(covariance))
        if sigma[FOCAL_SLICE][0] > _MAX_FOCAL_SIGMA_FRACTION or sigma[MOUNT_SLICE].max() > _MAX_MOUNT_SIGMA_RAD:
            raise InputError(
                "pictures", "", f"this motion leaves the focal length uncertain by {100 * sigma[FOCAL_SLICE][0]:.1f} "
                "% and "
                f"the mount by {math.degrees(sigma[MOUNT_SLICE].max()):.1f} degrees (one sigma)",
                "turn the vehicle by 20 degrees about all three axes, repeatedly, for 60 s",
            )  # fmt: skip
        lens, mount = self.camera_with_lens(shared), self.mount_rotation(shared)
        angles, slopes = _mount_angles(mount), np.empty((3, 3))
        for j in range(3):
            turned = shared.copy()
            turned[MOUNT_SLICE.start + j] += 1e-5
            slopes[:, j] = (_mount_angles(self.mount_rotation(turned)) - angles) / 1e-5
        angle_sigma = np.sqrt(np.diag(slopes @ covariance[MOUNT_SLICE, MOUNT_SLICE] @ slopes.T))
        focal = float(lens.lens.focal_x)
        values = {
            "focal_x_px": (focal, focal * sigma[FOCAL_SLICE][0]),
            "focal_y_px": (float(lens.lens.focal_y), float(lens.lens.focal_y) * sigma[FOCAL_SLICE][0]),
            "centre_x_px": (float(lens.lens.centre_x), sigma[CENTRE_SLICE][0]),
            "centre_y_px": (float(lens.lens.centre_y), sigma[CENTRE_SLICE][1]),
            "k1": (float(lens.lens.k1), sigma[RADIAL_SLICE][0]),
            **{
                f"mount_{name}_deg": (math.degrees(a), math.degrees(s))
                for name, a, s in zip(("roll", "pitch", "turn"), angles, angle_sigma, strict=True)
            },
            "delay_ms": (1e3 * shared[DELAY_SLICE][0], 1e3 * sigma[DELAY_SLICE][0]),
            **{
                f"lever_{a}_mm": (1e3 * shared[LEVER_SLICE][k], 1e3 * sigma[LEVER_SLICE][k])
                for k, a in enumerate("xyz")
            },
            **{
                f"gyro_bias_{a}_deg_s": (
                    math.degrees(shared[GYRO_BIAS_SLICE][k]),
                    math.degrees(sigma[GYRO_BIAS_SLICE][k]),
                )
                for k, a in enumerate("xyz")
            },
            **{
                f"gyro_scale_{a}": (1.0 + shared[GYRO_SCALE_SLICE][k], sigma[GYRO_SCALE_SLICE][k])
                for k, a in enumerate("xyz")
            },
        }
        return HandCalibration(
            {n: float(v) for n, (v, _) in values.items()}, {n: float(s) for n, (_, s) in values.items()},
            sigma_px / math.sqrt(2.0), len(self.tracks.times_s), len(self.tracks.segment),
            _with_calibrated_values(lens, {n: (float(v), float(s)) for n, (v, s) in values.items()}),
        )  # fmt: skip


def _with_calibrated_values(camera: Camera, found: dict[str, tuple[float, float]]) -> Camera:
    """Return the camera with calibrated lens, mounting and delay; all but the position get standard deviations."""
    note = "by hand over a floor"

    def calibrated_quantity(name: str, scale: float, unit: str) -> Quantity:
        value, std = found[name]
        return Quantity(value=scale * value, unit=unit, source="measured", note=note, std=scale * std)

    lens = {
        name: calibrated_quantity(key, 1.0, "1")
        for name, key in (
            ("focal_x", "focal_x_px"), ("focal_y", "focal_y_px"), ("centre_x", "centre_x_px"),
            ("centre_y", "centre_y_px"), ("k1", "k1"),
        )
    }  # fmt: skip
    place = camera.mount.place.model_copy(update={"value": (tuple(1e-3 * found[f"lever_{a}_mm"][0] for a in "xyz"),)})
    mount: dict[str, Any] = {
        n: calibrated_quantity(f"mount_{n}_deg", math.pi / 180, "rad") for n in ("roll", "pitch", "turn")
    }
    return camera.model_copy(
        update={
            "lens": camera.lens.model_copy(update=lens),
            "mount": camera.mount.model_copy(update={**mount, "place": place}),
            "shutter": camera.shutter.model_copy(update={"delay": calibrated_quantity("delay_ms", 1e-3, "s")}),
        }
    )


def _make_rotation_matrix(vector: _Array) -> _Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,)."""
    return rotation_matrices(quaternion_exponential(vector[None]))[0]


def _mount_angles(mount: _Array) -> _Array:
    """Return roll, pitch and turn (3,) of the rotation from camera to body axes."""
    r = mount @ BODY_FROM_DOWN_CAMERA.T
    return np.array(
        [math.atan2(r[2, 1], r[2, 2]), -math.asin(max(-1.0, min(1.0, r[2, 0]))), math.atan2(r[1, 0], r[0, 0])]
    )


def _guess_delay_focal_turn(tracks: PointTracks, camera: Camera, imu: InertialData) -> tuple[float, float, float]:
    """Return the delay (s), focal length factor and camera turn (rad) that fit the picture's motion to the gyroscopes.

    The motion y of the middle of the picture is regressed on that of the rotation alone, y = m p + n conj(p); the
    delay is that of the best fit.
    """
    flow = np.array([np.median(a, axis=0) for a in _split_by_segment(tracks, tracks.last_px - tracks.first_px)])
    y = flow[:, 0] + 1j * flow[:, 1]
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(
        0.5 * (imu.rates_rad_s[1:] + imu.rates_rad_s[:-1]) * np.diff(imu.time_s)[:, None], axis=0)])  # fmt: skip
    angle = angle @ body_from_camera_rotation(camera)
    focal = float(camera.lens.focal_x)
    best = (-1.0, 0.0, 1.0 + 0j, 0j)
    for delay in _DELAY_GRID_S:
        first, last = (
            np.stack([np.interp(t - delay, imu.time_s, a) for a in angle.T], axis=1) for t in tracks.times_s.T
        )
        turned = last - first
        p = focal * (-turned[:, 1] + 1j * turned[:, 0])
        p, z = p - p.mean(), y - y.mean()
        a = np.stack([p, p.conj()], axis=1)
        (m, n), *_ = np.linalg.lstsq(a, z, rcond=None)
        share = 1.0 - float(np.sum(np.abs(z - a @ [m, n]) ** 2) / max(np.sum(np.abs(z) ** 2), 1e-12))
        if share > best[0]:
            best = (share, float(delay), m, n)
    share, delay, m, n = best
    if share < _MIN_GYRO_EXPLAINED_FRACTION:
        raise InputError(
            "pictures", "", "the motion of the pictures does not follow the gyroscopes",
            "turn the vehicle rather than shift it, and check that both clocks are the same",
        )  # fmt: skip
    if abs(n) > abs(m):
        raise InputError(
            "pictures", "", "the pictures move mirrored against the gyroscopes", "check the camera's driver"
        )
    return delay, float(np.clip(abs(m), 0.6, 1.6)), float(np.angle(m))


def _split_by_segment(tracks: PointTracks, values: _Array) -> list[_Array]:
    return np.split(values, np.flatnonzero(np.diff(tracks.segment)) + 1)
