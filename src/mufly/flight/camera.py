"""Position by camera: pictures of the flight as it is flown, SLAM in a process of its own, and a radio between.

    truth --> picture --radio--> SLAM's process --radio--> position_fix, with the picture's own time

The picture is rendered at the middle of its exposure; with it goes what the vehicle's filter believes then of tilt,
height, velocity and rates (its state one period of the flight software before, turned on by the rates). What the
radio loses does not come back. An answer is known at t + latency + |jitter|, whatever the wall's clock says: the
flight waits for the other process, so the same seed flies the same flight. Answers that are not trusted are not sent;
after half a second without one the reason is told. Of the others go as many as the statistical fix would have made:
errors of pictures that follow each other hang together, and the filter has no time for all.

It takes the place of the statistical ``position_fix`` and goes through the same door. For the filter its errors are
described in the same words: white noise, and a bias that wanders (docs/slam.md has them measured).

Until the sonar first says more than the least that it can, the vehicle stands where it was put, or has just left it:
that is told, with 2 mm of noise. A filter that heard nothing while the legs carry a part of the weight would lose its
height. The map begins with the first picture from 10 cm up, where the vehicle then believes to be.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, Motion, PictureRecorder, Renderer, StreamServer, encode, make_floor
from mufly.dynamics import standing_height
from mufly.errors import MuflyError
from mufly.estimate import Estimate
from mufly.estimate.layout import EX_FIX_BIAS, EX_FIX_HEADING, EX_GYRO_BIAS
from mufly.flight.film import SHOWN_QUALITY, Film, Spoil, Stream
from mufly.sensors import Reading, Sensor, Truth
from mufly.slam import (
    PHASE_SIGMA,
    Answer,
    Counts,
    Frame,
    Sight,
    SlamProcess,
    Telling,
    camera_toml,
    features_of,
    opencv,
)
from mufly.vehicle import Vehicle
from mufly.vehicle.quantity import Quantity
from mufly.vehicle.sensing import PositionFix
from mufly.world import World

_Array = NDArray[np.float64]
ANSWER_S, SILENT_S, BACK_S = 0.066, 0.5, 1.0
"""Between two answers that are sent; without any, until that is told; with some again, until that is told (s)."""
_STANDS_NOISE_M = 0.002
LANDED_M = 0.2
"""Height as believed, below which one that flew and whose sonar says its least has landed: sonars fail in the air."""
PATH_STEP_M, MOST_PATH = 0.03, 1500
_TILT_TIME_S, _HEIGHT_TIME_S = 20.0, 2.0
"""Over which the filter's errors of tilt and height hang together: in three flights tilts were off by 0.12 degrees on
average over ten seconds, and went by 0.05 around that (s)."""
KNOWN_M = 0.2
"""A place from outside that is known less well is refused (m)."""
_SENT_M = 0.6
"""A place of its own that is known less well is not sent: a mission would land for that (m)."""


@dataclass(frozen=True)
class Eye:
    """What a flight on pictures needs to know.

    Attributes
    ----------
    camera : Camera
    floor : str
        Of :data:`mufly.camera.FLOORS`.
    shadows : float
        Share of the light that shadows take.
    spoils : tuple of Spoil
    on_answer : callable, optional
        Called with each answer as it is known.
    stream : (str, int), optional
        Host and port where its pictures are sent as MJPEG, before the radio spoils them.
    """

    camera: Camera
    floor: str = "rich"
    shadows: float = 0.3
    spoils: tuple[Spoil, ...] = ()
    on_answer: Callable[[Answer], None] | None = None
    stream: tuple[str, int] | None = None


def filmed(eye: Eye, vehicle: Vehicle, world: World, seed: int) -> Film:
    """Return the camera of a flight."""
    return Film(
        eye.camera, make_floor(eye.floor, seed, shadows=eye.shadows), vehicle, world, seed, eye.spoils
    )


def streamed(eye: Eye, vehicle: Vehicle, world: World, seed: int) -> Stream | None:
    """Return what sends the pictures of a flight that another program looks at; None where they are sent nowhere."""
    return (
        None if eye.stream is None else Stream(filmed(eye, vehicle, world, seed), StreamServer(*eye.stream))
    )


def told_errors(camera: Camera) -> PositionFix:
    """Return how the filter describes fixes by this camera: the table ``sensors.position_fix`` of a vehicle."""

    def q(value: float, unit: str) -> Quantity:
        return Quantity(value=value, unit=unit, source="estimated", note=f"V-SLAM by {camera.name}")

    return PositionFix(
        period=q(max(ANSWER_S, float(camera.sensor.period)), "s"),
        latency=q(float(camera.radio.latency), "s"),
        jitter=q(float(camera.radio.jitter), "s"),
        noise=q(0.01, "m"), wander=q(0.03, "m"), wander_time=q(3.0, "s"),
        heading_noise=q(math.radians(0.3), "rad"), heading_wander=q(math.radians(1.2), "rad"),
        dropout=q(float(camera.radio.loss), "1"),
    )  # fmt: skip


def sighted(vehicle: Vehicle, camera: Camera) -> Vehicle:
    """Return the vehicle with the camera in place of its statistical position fix.

    Raises
    ------
    MuflyError
        If it has no sensors that a filter could fly on.
    """
    if vehicle.sensors is None or vehicle.sensors.imu is None or vehicle.sensors.sonar is None:
        raise MuflyError(
            f"{vehicle.name} has no inertial unit and sonar, without which pictures tell no place"
        )
    sensors = vehicle.sensors.model_copy(update={"position_fix": told_errors(camera)})
    return vehicle.model_copy(update={"sensors": sensors})


def least_height(vehicle: Vehicle) -> float:
    """Return up to which reading the sonar says no more than the least that it can (m)."""
    sonar = vehicle.sensors.sonar if vehicle.sensors is not None else None
    return 0.0 if sonar is None else float(sonar.min_range) + 0.5 * float(sonar.resolution)


class CameraSensor(Sensor):
    """Reads ``position_fix`` (4,): N, E, D (m) and heading (rad), from pictures.

    Parameters
    ----------
    eye : Eye
    vehicle : Vehicle
    world : World
        Its boxes are seen.
    start : (3,) tuple
        N, E (m) and heading (rad) where the vehicle stands.
    seed : int

    Attributes
    ----------
    believe : callable
        Returns the latest estimate, or None, and what the sonar said last (m), or NaN.
    answer : Answer or None
        The latest that came, trusted or not.
    picture : (rows, columns) uint8 array or None
        The latest.
    wander_s : float
        Over which errors of its fixes hang together.
    on_sight : callable or None
        Told of every picture that was looked at (:class:`mufly.slam.Sight`); with it pictures are made on the floor,
        too, which nobody looks at.
    """

    def __init__(
        self, eye: Eye, vehicle: Vehicle, world: World, start: tuple[float, float, float], seed: int
    ) -> None:
        opencv()  # say at once what is missing
        self._eye, self._start, self._seed = eye, start, seed
        self._least_m = least_height(vehicle)
        self._stands_m = standing_height(vehicle)
        self._film = filmed(eye, vehicle, world, seed)
        self._fixes = told_errors(eye.camera)
        self.wander_s = float(self._fixes.wander_time)
        self.believe: Callable[[], tuple[Estimate | None, float]] = lambda: (None, math.nan)
        self.on_sight: Callable[[Sight], None] | None = None
        self._process: SlamProcess | None = None
        self.stream = None if eye.stream is None else StreamServer(*eye.stream)
        self._record: PictureRecorder | None = None
        self.reset()

    def reset(self) -> None:
        self._end()
        self._rng = np.random.default_rng([self._seed, 91])
        self._film.reset()
        self._scale = 1.0 + 0.01 * float(self._rng.standard_normal())
        self._offset = self._rng.uniform(0.0, 2 * math.pi, 2)
        # When due; what is known without looking, or the picture as it is shown
        self._queue: list[tuple[float, Answer | bytes]] = []
        self.taken = self.lost = self.answered = self.trusted = 0
        self._path: list[tuple[float, float]] = []
        self._floor_view: Renderer | None = None
        self._begun, self._stood = False, True
        self.answer: Answer | None = None
        self.picture: NDArray[np.uint8] | None = None
        self._fix: dict[str, Reading] = {}
        self._wrong, self._trusted_s, self._since_s = "", math.inf, math.nan

    def close(self) -> None:
        """End the other process, and the stream."""
        self._end()
        if self.stream is not None:
            self.stream.close()
            self.stream = None
        if self._record is not None:
            self._record.close()

    def record(self, path: Path, start_ns: int) -> None:
        """Keep the pictures that are looked at, and what is told with them, from now on; ``start_ns`` is the wall's
        time (ns since 1970) of the instant 0."""
        facts = {"floor": self._eye.floor, "seed": str(self._seed), "camera": self._eye.camera.name}
        self._record = PictureRecorder(path, camera_toml(self._eye.camera), start_ns, facts)

    def _end(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None

    def right(self, truth: Truth) -> dict[str, Any]:
        return {"position_fix": np.append(truth.position, truth.attitude[2])}

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        if self._film.due(truth):
            self._take(truth)
        while self._queue and self._queue[0][0] <= t + 1e-9:
            self._receive(self._queue.pop(0)[1])
        return self._fix

    def news(self) -> str:
        """What there is to be told: that it has given no position for a while, and why, or that it does again."""
        t = self._film.last_s
        if not self._wrong and t - self._trusted_s > SILENT_S and not self._stood:
            late = self.answer is None or t - self.answer.time_s > SILENT_S + float(
                self._eye.camera.radio.latency
            )
            why = "no pictures come" if late or self.answer is None else self.answer.reason
            self._wrong, self._since_s = why, math.nan
            return f"the camera gives no position: {why}"
        if self._wrong and t - self._trusted_s < SILENT_S:
            self._since_s = t if math.isnan(self._since_s) else self._since_s
            if t - self._since_s >= BACK_S:
                self._wrong = ""
                return "the camera gives its position again"
        return ""

    def _take(self, truth: Truth) -> None:
        """Take a picture and send it."""
        t, camera = truth.time_s, self._eye.camera
        lost, jitter = (
            self._rng.uniform() < float(camera.radio.loss),
            abs(float(self._rng.standard_normal())),
        )
        if self._process is None:  # while it stands, so that no flight waits until it can look
            self._process = SlamProcess(camera, start=self._start, seed=self._seed)
        told = self._telling(truth)
        if told is None:
            return
        self._stood = told.standing and (not self._begun or told.height_m < LANDED_M)
        light = self._film.light(t)
        if light is None:
            return
        # They come back in the order in which they were sent.
        due = t + float(camera.radio.latency)
        due = max(due + float(camera.radio.jitter) * jitter, self._queue[-1][0] if self._queue else 0.0)
        if told.standing and not self._begun:
            if not lost:
                self._queue.append((due, self._stands(t)))
            if self._watched:
                self._show_floor(self._film.motion(truth), light)
            return
        self._begun = True
        self.picture = self._film.renderer.render(self._film.motion(truth), light)
        self.taken += 1
        self.lost += bool(lost)
        shown = self._shown(t)
        if lost:
            return
        assert self._process is not None
        self._process.send(Frame(t, self.picture, told))
        if self._record is not None:
            self._record.add(t, shown, asdict(told))
        self._queue.append((due, shown))

    def _show_floor(self, motion: Motion, light: float) -> None:
        """A picture for those who watch: by chance of its own, so that a flight is the same with and without them."""
        if self._floor_view is None:
            self._floor_view = self._film.another()
        self.picture = self._floor_view.render(motion, light)
        shown = self._shown(motion.time_s)
        if self.on_sight is not None:
            self.on_sight(Sight(motion.time_s, shown, stands=True, counts=self._counts()))

    @property
    def _watched(self) -> bool:
        return self.on_sight is not None or self.stream is not None

    def _shown(self, time_s: float) -> bytes:
        """The picture as a JPEG, sent to who watches; b"" where nobody does."""
        if self.picture is None or not (self._watched or self._record):
            return b""
        jpeg = encode(self.picture, SHOWN_QUALITY)
        if self.stream is not None:
            self.stream.publish(jpeg, time_s)
        return jpeg

    def _counts(self) -> Counts:
        return Counts(self.taken, self.lost, self.answered, self.trusted)

    def _stands(self, time_s: float) -> Answer:
        """It has not moved since it was put there."""
        *noise, turn = _STANDS_NOISE_M * self._rng.standard_normal(4)
        place = np.array([self._start[0], self._start[1], -self._stands_m]) + noise
        covariance = _STANDS_NOISE_M**2 * np.eye(4)
        return Answer(time_s, True, "it stands", place, self._start[2] + turn, covariance)

    def _telling(self, truth: Truth) -> Telling | None:
        """What the vehicle believes at this instant: its estimate of a period ago, turned on."""
        estimate, sonar = self.believe()
        if estimate is None or not np.isfinite(estimate.attitude).all():
            return None
        dt = max(0.0, truth.time_s - estimate.time_s)
        roll, pitch, yaw = (float(a) for a in estimate.attitude)
        p, q, r = (float(w) for w in estimate.rates)
        roll += dt * (p + math.tan(pitch) * (q * math.sin(roll) + r * math.cos(roll)))
        pitch += dt * (q * math.cos(roll) - r * math.sin(roll))
        sigma = np.sqrt(np.diag(estimate.covariance))
        x = estimate.position + dt * estimate.velocity
        # Places of the map are those of fixes: with what these are believed to be off by, and without its uncertainty.
        bias = np.zeros(4) if estimate.beliefs is None else estimate.beliefs.fix_bias
        north, east, height, v_north, v_east, _, roll_off, pitch_off, yaw_off = sigma[:EX_GYRO_BIAS].tolist()
        place = math.sqrt(max(max(north, east) ** 2 - float(self._fixes.wander) ** 2, 0.01**2))
        heading = math.sqrt(max(yaw_off**2 - float(self._fixes.heading_wander) ** 2, 0.005**2))
        return Telling(
            roll, pitch, max(0.02, -float(x[2])), estimate.rates.copy(), self._scale * truth.rotor_speed,
            self._film.phase + self._offset + PHASE_SIGMA * self._rng.standard_normal(2),
            tilt_sigma=max(math.radians(0.15), roll_off, pitch_off), height_sigma=max(0.006, height),
            tilt_time_s=_TILT_TIME_S, height_time_s=_HEIGHT_TIME_S,
            velocity=estimate.velocity.copy(), standing=not sonar > self._least_m,
            place=np.array([x[0] + bias[0], x[1] + bias[1], yaw + bias[EX_FIX_HEADING - EX_FIX_BIAS]]),
            place_sigma=(place, heading), velocity_sigma=max(0.01, v_north, v_east),
        )  # fmt: skip

    def _receive(self, known: Answer | bytes) -> None:
        if not isinstance(known, Answer):
            assert self._process is not None
            jpeg, known = known, _sure(self._process.receive())
            self.answered += 1
            self.trusted += known.trusted
            if self.on_sight is not None:
                self.on_sight(self._sight(jpeg, known))
        self.answer = known
        if self._eye.on_answer is not None:
            self._eye.on_answer(known)
        if known.trusted:
            self._trusted_s = self._film.last_s
        last = self._fix.get("position_fix")
        if known.trusted and (last is None or known.time_s - last.time_s > ANSWER_S - 1e-3):
            place = np.append(known.position, known.heading)
            self._fix = {"position_fix": Reading(place, known.time_s, True, known.covariance)}

    def _sight(self, jpeg: bytes, answer: Answer) -> Sight:
        assert self._process is not None
        path, place = self._path, (float(answer.position[0]), float(answer.position[1]))
        if answer.trusted and (not path or math.dist(path[-1], place) > PATH_STEP_M):
            path.append(place)
            if len(path) > MOST_PATH:
                del path[::2]
        return Sight(
            answer.time_s, jpeg, answer, features_of(self._eye.camera, answer),
            self._film.last_s - answer.time_s, self._process.work_s, self._wrong, self._counts(), self._process.sketch,
            np.array(path, np.float32).reshape(-1, 2), self._stood,
        )  # fmt: skip


def _sure(answer: Answer) -> Answer:
    """The answer, not trusted where it is not sure enough."""
    sigma = math.sqrt(max(float(answer.covariance[0, 0]), float(answer.covariance[1, 1])))
    if not answer.trusted or sigma <= _SENT_M:
        return answer
    return replace(answer, trusted=False, reason=f"its place is known to {sigma:.2f} m only")
