"""Position fixes by camera: rendered pictures of the flight, SLAM in a separate process, and a radio link.

    truth --> picture --radio--> SLAM process --radio--> position_fix, with the time of the picture

A picture is rendered at the middle of its exposure. The filter's estimate (tilt, height, velocity, rates) of the
previous period is predicted to that time and sent with the picture. The radio loses some pictures. A result arrives at
t + latency + abs(jitter) of simulated time: the flight waits for the SLAM process, so that equal seeds give equal
flights. Untrusted results are not sent; half a second without a trusted result is reported with the reason. Trusted
results are sent at most at the rate of the statistical fix, because errors of consecutive pictures are correlated and
the filter's computing time is limited.

The sensor replaces the statistical ``position_fix``. Its errors are described to the filter in the same way: white
noise, and a random-walk bias (docs/log/2026-11-24-slam-accuracy.md).

Until the sonar reads more than on the floor, the fix is the start position with 2 mm of noise. Without these fixes the
filter would lose the height while the legs carry a part of the weight. The SLAM map begins with the first picture
from 10 cm above the floor, at the estimated position.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import (
    Camera,
    PictureRecorder,
    Renderer,
    StreamServer,
    VehicleMotion,
    encode_jpeg,
    find_floor,
)
from mufly.dynamics import standing_height
from mufly.errors import MuflyError
from mufly.estimate import Estimate
from mufly.estimate.filter.filter_records import ERROR_FIX_BIAS, ERROR_FIX_HEADING, ERROR_GYRO_BIAS
from mufly.flight.fixes.fix_monitor import CorrectedPath, FixCorrection, FixMonitor
from mufly.flight.fixes.onboard_camera import SHOWN_JPEG_QUALITY, CameraFault, OnboardCamera, PictureStreamServer
from mufly.mission import Mission
from mufly.sensors import Reading, Readings, Sensor, Truth
from mufly.sensors.sonar import max_standing_sonar_range
from mufly.slam import (
    PHASE_SIGMA_RAD,
    CameraFrame,
    FrameEstimate,
    PictureCounts,
    SlamProcess,
    TrackedPicture,
    TrackingResult,
    find_distorted_inlier_pixels,
    format_camera_toml,
    import_opencv,
)
from mufly.vehicle import Vehicle
from mufly.vehicle.quantity import Quantity
from mufly.vehicle.sensor_schema import PositionFixParameters
from mufly.world import World

_Array = NDArray[np.float64]
MIN_FIX_INTERVAL_S, FIX_SILENCE_TIMEOUT_S, FIX_RECOVERY_TIME_S = 0.066, 0.5, 1.0
"""Least time between two fixes (s); time without fixes, and time with fixes again, until the report (s)."""
_STATIONARY_NOISE_M = 0.002
LANDED_HEIGHT_M = 0.2
"""Estimated height (m) below which the sonar's least reading after a flight means a landing, not a sonar fault."""
PATH_SPACING_M, MAX_PATH_POINTS = 0.03, 1500
_TILT_CORRELATION_S, _HEIGHT_CORRELATION_S = 20.0, 2.0
"""Correlation times of the filter's errors of tilt and height (s)."""
MAX_FIX_SIGMA_M = 0.2
"""Largest standard deviation of an accepted external fix (m)."""
_MIN_FAULT_TURN_RAD, _MIN_SCALE_ERROR, _MIN_FAULT_SIGMAS = math.radians(10.0), 0.1, 5.0
"""Least turn (rad) and error of scale of the motion against the accelerometers that are reported, and least number of
deviations."""
_MIN_CORRECTABLE_SCALE, _CORRECTED_SIGMA_M, _MAX_CORRECTED_STEP_M = 0.3, 0.1, 0.3
"""Least scale of a path that is corrected, standard deviation that a corrected position gets along an axis (m), and
least distance of two results that counts as a jump of the map (m)."""
_MAX_SENT_SIGMA_M = 0.6
"""Largest standard deviation of a sent fix (m): a mission would land with a larger one."""


DEFAULT_FLOOR = "rich"
"""Floor of a flight whose settings and mission name none, one of :data:`mufly.camera.FLOOR_KINDS`."""


@dataclass(frozen=True)
class CameraConfig:
    """Settings of a flight with an onboard camera.

    Attributes
    ----------
    camera : Camera
        Camera that SLAM assumes.
    true_camera : Camera, optional
        Camera that takes the pictures, of the same size, if ``camera`` is wrong. Default: ``camera``.
    floor_texture : str, optional
        Floor for :func:`mufly.camera.find_floor`: a kind, a package's picture or a picture file. Default: the floor of
        the mission, or :data:`DEFAULT_FLOOR`.
    floor_width_m : float, optional
        Width on the ground of a floor picture (m).
    shadow_fraction : float
        Share of the light that shadows remove.
    camera_faults : tuple of CameraFault
    on_tracking_result : callable, optional
        Called with each tracking result when it is received.
    stream_address : (str, int), optional
        Host and port of an MJPEG stream of the pictures, without losses of the radio.
    """

    camera: Camera
    floor_texture: str | None = None
    floor_width_m: float | None = None
    shadow_fraction: float = 0.3
    camera_faults: tuple[CameraFault, ...] = ()
    on_tracking_result: Callable[[TrackingResult], None] | None = None
    stream_address: tuple[str, int] | None = None
    true_camera: Camera | None = None

    @property
    def floor_name(self) -> str:
        """Return the name of the floor: the texture, or :data:`DEFAULT_FLOOR`."""
        return self.floor_texture or DEFAULT_FLOOR


def default_to_mission_floor(eye: CameraConfig, mission: Mission) -> CameraConfig:
    """Return the camera's settings, with the mission's floor if the settings have none."""
    if eye.floor_texture is not None or mission.floor is None:
        return eye
    width = mission.floor.width_m if eye.floor_width_m is None else eye.floor_width_m
    return replace(eye, floor_texture=mission.floor.texture, floor_width_m=width)


def make_camera(eye: CameraConfig, vehicle: Vehicle, world: World, seed: int) -> OnboardCamera:
    """Return the onboard camera of a flight, with its floor and faults."""
    return OnboardCamera(
        eye.true_camera or eye.camera,
        find_floor(eye.floor_name, eye.floor_width_m).make_floor(seed, eye.shadow_fraction),
        vehicle,
        world,
        seed,
        eye.camera_faults,
    )


def make_picture_stream(eye: CameraConfig, vehicle: Vehicle, world: World, seed: int) -> PictureStreamServer | None:
    """Return the stream of a flight's pictures for another program; None without a stream address."""
    return (
        None
        if eye.stream_address is None
        else PictureStreamServer(make_camera(eye, vehicle, world, seed), StreamServer(*eye.stream_address))
    )


def make_camera_fix_parameters(camera: Camera) -> PositionFixParameters:
    """Return the filter's error model of a camera's fixes: the vehicle's table ``sensors.position_fix``."""

    def make_quantity(value: float, unit: str) -> Quantity:
        return Quantity(value=value, unit=unit, source="estimated", note=f"V-SLAM by {camera.name}")

    return PositionFixParameters(
        period=make_quantity(max(MIN_FIX_INTERVAL_S, float(camera.sensor.period)), "s"),
        latency=make_quantity(float(camera.radio.latency), "s"),
        latency_jitter=make_quantity(float(camera.radio.jitter), "s"),
        noise=make_quantity(0.01, "m"), drift=make_quantity(0.03, "m"), drift_correlation_time=make_quantity(3.0, "s"),
        heading_noise=make_quantity(math.radians(0.3), "rad"), heading_drift=make_quantity(math.radians(1.2), "rad"),
        dropout_probability=make_quantity(float(camera.radio.loss), "1"),
    )  # fmt: skip


def replace_fix_by_camera(vehicle: Vehicle, camera: Camera) -> Vehicle:
    """Return the vehicle with a camera as source of position fixes, in place of the statistical model of fixes.

    Raises
    ------
    MuflyError
        If the vehicle lacks an inertial unit or a sonar.
    """
    if vehicle.sensors is None or vehicle.sensors.imu is None or vehicle.sensors.sonar is None:
        raise MuflyError(
            f"{vehicle.name} has no inertial unit and sonar, which a camera's fixes require; add them to [sensors]"
        )
    sensors = vehicle.sensors.model_copy(update={"position_fix": make_camera_fix_parameters(camera)})
    return vehicle.model_copy(update={"sensors": sensors})


def compute_standing_sonar_limit(vehicle: Vehicle) -> float:
    """Return the sonar reading (m) up to which the vehicle may still stand on the floor."""
    sonar = vehicle.sensors.sonar if vehicle.sensors is not None else None
    return 0.0 if sonar is None else max_standing_sonar_range(vehicle) + 0.5 * float(sonar.resolution)


class CameraSensor(Sensor):
    """Sensor of ``position_fix`` (4,): N, E, D (m) and heading (rad), from pictures.

    Parameters
    ----------
    eye : CameraConfig
    vehicle : Vehicle
    world : World
        Its boxes are visible.
    start : (3,) tuple
        Start position N, E (m) and heading (rad).
    seed : int

    Attributes
    ----------
    estimate_source : callable
        Returns the latest estimate, or None, and the latest sonar reading (m), or NaN.
    last_result : TrackingResult or None
        Latest result, trusted or not.
    last_picture : (rows, columns) uint8 array or None
        Latest picture.
    fix_drift_time_s : float
        Correlation time of the fixes' errors (s).
    on_map_view : callable or None
        Called with every tracked picture (:class:`mufly.slam.TrackedPicture`). With it pictures are also rendered on
        the floor, without tracking.
    """

    def __init__(
        self, eye: CameraConfig, vehicle: Vehicle, world: World, start: tuple[float, float, float], seed: int
    ) -> None:
        import_opencv()  # an early error if OpenCV is missing
        self._eye, self._start, self._seed = eye, start, seed
        self._least_m = compute_standing_sonar_limit(vehicle)
        self._stands_m = standing_height(vehicle)
        self._film = make_camera(eye, vehicle, world, seed)
        self._fixes = make_camera_fix_parameters(eye.camera)
        self.fix_drift_time_s = float(self._fixes.drift_correlation_time)
        self.estimate_source: Callable[[], tuple[Estimate | None, float]] = lambda: (None, math.nan)
        self.on_map_view: Callable[[TrackedPicture], None] | None = None
        self._monitor = FixMonitor(float(self._fixes.drift))
        self._process: SlamProcess | None = None
        self.stream_server = None if eye.stream_address is None else StreamServer(*eye.stream_address)
        self._record: PictureRecorder | None = None
        self.reset()

    def reset(self) -> None:
        self._stop_slam()
        self._rng = np.random.default_rng([self._seed, 91])
        self._film.reset()
        self._scale = 1.0 + 0.01 * float(self._rng.standard_normal())
        self._offset = self._rng.uniform(0.0, 2 * math.pi, 2)
        # Time due; result without tracking, or the picture as JPEG
        self._queue: list[tuple[float, TrackingResult | bytes]] = []
        self.taken_count = self.lost_count = self.answered_count = self.trusted_count = 0
        self._path: list[tuple[float, float]] = []
        self._floor_view: Renderer | None = None
        self._begun, self._stood = False, True
        self.last_result: TrackingResult | None = None
        self.last_picture: NDArray[np.uint8] | None = None
        self._fix: dict[str, Reading] = {}
        self._wrong, self._trusted_s, self._since_s = "", math.nan, math.nan
        self._monitor.reset()
        self._corrected_path: CorrectedPath | None = None  # of a camera that is turned or has a wrong focal length
        self._compared_s = -math.inf  # time of the latest result that was compared with the accelerometers
        self._fault = ""  # the latest defect of the camera that was reported

    def close(self) -> None:
        """End the SLAM process and the stream."""
        self._stop_slam()
        if self.stream_server is not None:
            self.stream_server.close()
            self.stream_server = None
        if self._record is not None:
            self._record.close()

    def open_picture_recording(self, path: Path, start_ns: int) -> None:
        """Open a recording; it then receives each picture that SLAM tracks, with the pose estimate.

        ``start_ns`` is the wall-clock time (ns since 1970) of the instant 0.
        """
        facts = {"floor": self._eye.floor_name, "seed": str(self._seed), "camera": self._eye.camera.name}
        self._record = PictureRecorder(path, format_camera_toml(self._eye.camera), start_ns, facts)

    def _stop_slam(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def error_free_readings(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        if self._film.advance_and_check_due(truth):
            self._take_and_send_picture(truth)
        while self._queue and self._queue[0][0] <= t + 1e-9:
            self._receive_result(self._queue.pop(0)[1])
        return self._fix

    def update_fix_monitor(self, readings: Readings, estimate: Estimate, is_resting: bool) -> None:
        """Pass the latest readings to the comparison with the accelerometers (:class:`FixMonitor`)."""
        self._monitor.propagate_inertial_path(readings, estimate, is_resting)

    def _compare_with_accelerometers(self, known: TrackingResult) -> TrackingResult:
        """Return a trusted result; if its path contradicts the accelerometers, on the corrected path and less certain.

        Without a position the vehicle would land blind. The corrected path begins at the filter's position, also after
        a jump of the path.
        """
        if known.time_s - self._compared_s > MIN_FIX_INTERVAL_S - 1e-3:
            self._compared_s = known.time_s
            self._monitor.find_fix_refusal(known.time_s, np.append(known.position, known.heading))
        factor, sigma = self._monitor.long_fit
        fault = judge_camera_path_ratio(factor, sigma)
        if not fault:
            self._corrected_path = None
            return known
        place = complex(known.position[0], known.position[1])
        if self._corrected_path is None or abs(place - self._corrected_path.measured) > _MAX_CORRECTED_STEP_M:
            self._corrected_path = self._monitor.begin_corrected_path(known.time_s, place)
        if abs(factor) < _MIN_CORRECTABLE_SCALE or not cmath.isfinite(self._corrected_path.position):
            self._corrected_path = None
            return replace(known, trusted=False, reason=fault, camera_fault=fault)
        here = self._corrected_path.correct_next_fix(place, FixCorrection(1.0 / factor))
        unsure = np.diag([_CORRECTED_SIGMA_M**2, _CORRECTED_SIGMA_M**2, 0.0, 0.0])
        position = np.array([here.real, here.imag, known.position[2]])
        return replace(known, position=position, covariance=known.covariance + unsure, camera_fault=fault)

    def take_tracking_report(self) -> str:
        """Return a new report of a faulty camera, of missing fixes with the reason, or of their recovery, or "".

        A fault is reported when it is found, also after the fixes have stopped for another reason.
        """
        t, result = self._film.last_time_s, self.last_result
        fault = "" if result is None or self._stood else result.camera_fault
        if result is not None and fault and fault != self._fault:
            self._fault = fault
            return f"camera: {fault}" if result.trusted else self._report_loss(fault)
        if not t - self._trusted_s < FIX_SILENCE_TIMEOUT_S:
            self._since_s = math.nan
            if self._wrong or self._stood or math.isnan(self._trusted_s):
                return ""
            latency = float(self._eye.camera.radio.latency)
            is_late = result is None or t - result.time_s > FIX_SILENCE_TIMEOUT_S + latency
            return self._report_loss("no pictures arrive" if result is None or is_late else result.reason)
        if self._wrong:
            self._since_s = t if math.isnan(self._since_s) else self._since_s
            if t - self._since_s >= FIX_RECOVERY_TIME_S:
                self._wrong = self._fault = ""
                return "position from the camera is available again"
        return ""

    def _report_loss(self, why: str) -> str:
        """Return the report of missing fixes, and begin to wait for their recovery."""
        self._wrong, self._since_s = why, math.nan
        return f"no position from the camera: {why}"

    def _take_and_send_picture(self, truth: Truth) -> None:
        """Take a picture and send it."""
        t, camera = truth.time_s, self._eye.camera
        lost, jitter = (
            self._rng.uniform() < float(camera.radio.loss),
            abs(float(self._rng.standard_normal())),
        )
        if self._process is None:  # started on the floor, so that no flight waits for its start
            self._process = SlamProcess(camera, start=self._start, seed=self._seed)
        told = self._make_frame_estimate(truth)
        if told is None:
            return
        self._stood = told.standing and (not self._begun or told.height_m < LANDED_HEIGHT_M)
        light = self._film.light_level(t)
        if light is None:
            return
        # Results arrive in the order of their pictures.
        due = t + float(camera.radio.latency)
        due = max(due + float(camera.radio.jitter) * jitter, self._queue[-1][0] if self._queue else 0.0)
        if told.standing and not self._begun:
            if not lost:
                self._queue.append((due, self._make_stationary_result(t)))
            if self._has_viewers:
                self._show_stationary_view(self._film.compute_motion_at_exposure(truth), light)
            return
        self._begun = True
        self.last_picture = self._film.render_picture(truth, light)
        self.taken_count += 1
        self.lost_count += bool(lost)
        shown = self._encode_and_publish_picture(t)
        if lost:
            return
        assert self._process is not None
        self._process.send_frame(CameraFrame(t, self.last_picture, told))
        if self._record is not None:
            self._record.add_picture(t, shown, asdict(told))
        self._queue.append((due, shown))

    def _show_stationary_view(self, motion: VehicleMotion, light: float) -> None:
        """Render a picture of the resting vehicle for viewers; a separate random generator keeps the flight
        unchanged by viewers.
        """
        if self._floor_view is None:
            self._floor_view = self._film.make_renderer()
        self.last_picture = self._floor_view.render_picture(motion, light)
        shown = self._encode_and_publish_picture(motion.time_s)
        if self.on_map_view is not None:
            self.on_map_view(TrackedPicture(motion.time_s, shown, is_standing=True, counts=self._picture_counts()))

    @property
    def _has_viewers(self) -> bool:
        return self.on_map_view is not None or self.stream_server is not None

    def _encode_and_publish_picture(self, time_s: float) -> bytes:
        """Return the picture as a JPEG, and publish it to the stream; b"" without viewers and recorder."""
        if self.last_picture is None or not (self._has_viewers or self._record):
            return b""
        jpeg = encode_jpeg(self.last_picture, SHOWN_JPEG_QUALITY)
        if self.stream_server is not None:
            self.stream_server.publish_picture(jpeg, time_s)
        return jpeg

    def _picture_counts(self) -> PictureCounts:
        return PictureCounts(self.taken_count, self.lost_count, self.answered_count, self.trusted_count)

    def _make_stationary_result(self, time_s: float) -> TrackingResult:
        """Return a trusted tracking result at the start position plus noise, for a vehicle that has not moved."""
        *noise, turn = _STATIONARY_NOISE_M * self._rng.standard_normal(4)
        place = np.array([self._start[0], self._start[1], -self._stands_m]) + noise
        covariance = _STATIONARY_NOISE_M**2 * np.eye(4)
        return TrackingResult(time_s, True, "it stands", place, self._start[2] + turn, covariance)

    def _make_frame_estimate(self, truth: Truth) -> FrameEstimate | None:
        """Return the estimate of the previous period, propagated to the picture's time; None without an estimate."""
        estimate, sonar = self.estimate_source()
        if estimate is None or not np.isfinite(estimate.attitude).all():
            return None
        dt = max(0.0, truth.time_s - estimate.time_s)
        roll, pitch, yaw = (float(a) for a in estimate.attitude)
        p, q, r = (float(w) for w in estimate.rates)
        roll += dt * (p + math.tan(pitch) * (q * math.sin(roll) + r * math.cos(roll)))
        pitch += dt * (q * math.cos(roll) - r * math.sin(roll))
        sigma = np.sqrt(np.diag(estimate.covariance))
        x = estimate.position + dt * estimate.velocity
        # Map coordinates are those of the fixes: the estimated fix bias is added, and its uncertainty is left out.
        bias = np.zeros(4) if estimate.auxiliary_states is None else estimate.auxiliary_states.fix_bias
        north, east, height, v_north, v_east, _, roll_off, pitch_off, yaw_off = sigma[:ERROR_GYRO_BIAS].tolist()
        place = math.sqrt(max(max(north, east) ** 2 - float(self._fixes.drift) ** 2, 0.01**2))
        heading = math.sqrt(max(yaw_off**2 - float(self._fixes.heading_drift) ** 2, 0.005**2))
        return FrameEstimate(
            roll, pitch, max(0.02, -float(x[2])), estimate.rates.copy(), self._scale * truth.rotor_speed,
            self._film.rotor_phase + self._offset + PHASE_SIGMA_RAD * self._rng.standard_normal(2),
            tilt_sigma=max(math.radians(0.15), roll_off, pitch_off), height_sigma=max(0.006, height),
            tilt_time_s=_TILT_CORRELATION_S, height_time_s=_HEIGHT_CORRELATION_S,
            velocity=estimate.velocity.copy(), standing=not sonar > self._least_m,
            place=np.array([x[0] + bias[0], x[1] + bias[1], yaw + bias[ERROR_FIX_HEADING - ERROR_FIX_BIAS]]),
            place_sigma=(place, heading), velocity_sigma=max(0.01, v_north, v_east),
        )  # fmt: skip

    def _receive_result(self, known: TrackingResult | bytes) -> None:
        if not isinstance(known, TrackingResult):
            assert self._process is not None
            jpeg, known = known, _reject_uncertain(self._process.receive_result())
            known = self._compare_with_accelerometers(known) if known.trusted else known
            self.answered_count += 1
            self.trusted_count += known.trusted
            if self.on_map_view is not None:
                self.on_map_view(self._make_tracked_picture(jpeg, known))
        self.last_result = known
        if self._eye.on_tracking_result is not None:
            self._eye.on_tracking_result(known)
        if known.trusted:
            self._trusted_s = self._film.last_time_s
        last = self._fix.get("position_fix")
        if known.trusted and (last is None or known.time_s - last.time_s > MIN_FIX_INTERVAL_S - 1e-3):
            place = np.append(known.position, known.heading)
            self._fix = {"position_fix": Reading(place, known.time_s, True, known.covariance)}

    def _make_tracked_picture(self, jpeg: bytes, answer: TrackingResult) -> TrackedPicture:
        assert self._process is not None
        path, place = self._path, (float(answer.position[0]), float(answer.position[1]))
        if answer.trusted and (not path or math.dist(path[-1], place) > PATH_SPACING_M):
            path.append(place)
            if len(path) > MAX_PATH_POINTS:
                del path[::2]
        return TrackedPicture(
            answer.time_s,
            jpeg,
            answer,
            find_distorted_inlier_pixels(self._eye.camera, answer),
            self._film.last_time_s - answer.time_s,
            self._process.processing_time_s,
            self._wrong,
            self._picture_counts(),
            self._process.map_view,
            np.array(path, np.float32).reshape(-1, 2),
            self._stood,
        )


def judge_camera_path_ratio(factor: complex, sigma: float) -> str:
    """Return the fault of a camera from the ratio of its path to that of the accelerometers; "" without a fault.

    Parameters
    ----------
    factor : complex
        Path by the camera over that by the accelerometers, as N + i E (:attr:`FixMonitor.long_fit`).
    sigma : float
        Its standard deviation along one axis.
    """
    turn, scale = abs(cmath.phase(factor)), abs(factor)
    if turn > max(_MIN_FAULT_TURN_RAD, _MIN_FAULT_SIGMAS * sigma / max(scale, 0.2)):
        return "the camera is turned against the accelerometers: check mount.turn"
    if abs(scale - 1.0) > max(_MIN_SCALE_ERROR, _MIN_FAULT_SIGMAS * sigma):
        how = "shorter" if scale < 1.0 else "longer"
        return f"the path is {how} than by the accelerometers: check the focal length"
    return ""


def _reject_uncertain(answer: TrackingResult) -> TrackingResult:
    """Return the tracking result, marked as untrusted if the standard deviation is too large."""
    sigma = math.sqrt(max(float(answer.covariance[0, 0]), float(answer.covariance[1, 1])))
    if not answer.trusted or sigma <= _MAX_SENT_SIGMA_M:
        return answer
    return replace(answer, trusted=False, reason=f"its position has a standard deviation of {sigma:.2f} m")
