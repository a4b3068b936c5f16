"""Onboard camera of a simulated flight: timing of pictures, motion during the exposure, and camera faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, Floor, Renderer, StreamServer, VehicleMotion, encode_jpeg
from mufly.dynamics import body_to_ned_matrix, model_parameters
from mufly.dynamics.model_state import ATTITUDE_SLICE, compute_hover_rotor_speeds
from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_time_span
from mufly.sensors import Truth
from mufly.vehicle import Vehicle
from mufly.world import World

CAMERA_FAULTS: Mapping[str, str] = {
    "covered": "the lens is covered: pictures are black",
    "dark": "the light is off: a hundredth of the brightness remains",
    "unplugged": "no pictures arrive",
    "frozen": "the camera repeats the same picture",
    "mirrored": "pictures are mirrored left to right",
    "inverted": "the camera is mounted upside down",
    "dirty": "two dark spots are on the lens",
}
"""Kinds of camera faults and their descriptions."""
SHOWN_JPEG_QUALITY = 85
"""JPEG quality of displayed pictures."""


@dataclass(frozen=True)
class CameraFault:
    """Fault of the camera, with start and end (s)."""

    kind: str
    start_s: float = 0.0
    stop_s: float = math.inf


def parse_camera_fault(text: str) -> CameraFault:
    """Parse a camera fault such as ``"covered@20s+5s"``; start and duration are optional.

    Raises
    ------
    InputError
        If the kind is not in :data:`CAMERA_FAULTS`, or the times are invalid.
    """
    kind, _, when = text.strip().partition("@")
    if kind not in CAMERA_FAULTS:
        raise ArgumentError("camera_fault", text, "is none", suggest_name(kind, CAMERA_FAULTS))
    try:
        return CameraFault(kind, *parse_time_span("", when))
    except InputError as error:
        raise ArgumentError("camera_fault", text, error.problem, error.remedy) from None


_DIRT_SPOTS = ((0.33, 0.31, 0.05), (0.62, 0.72, 0.06))
"""Dark spots: row and column as fractions of the picture's height and width, radius as a fraction of its width."""


def add_dirt(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with two dark, blurred spots at fixed pixels."""
    high, wide = picture.shape
    row, column = np.mgrid[:high, :wide]
    clear = np.ones(picture.shape)
    for y, x, radius in _DIRT_SPOTS:
        away = np.hypot(row - y * high, column - x * wide) - radius * wide
        clear *= 1.0 / (1.0 + np.exp(-away / (0.005 * wide)))
    return (picture * clear + 30.0 * (1.0 - clear)).astype(np.uint8)


class OnboardCamera:
    """A camera on a flying vehicle.

    Parameters
    ----------
    camera : Camera
    floor : Floor
    vehicle : Vehicle
    world : World
        Its boxes are visible.
    seed : int
    spoils : tuple of CameraFault
        Faults of the camera.
    """

    def __init__(
        self,
        camera: Camera,
        floor: Floor,
        vehicle: Vehicle,
        world: World,
        seed: int,
        spoils: tuple[CameraFault, ...] = (),
    ) -> None:
        self._given = camera, floor, world
        self._seed, self._spoils = seed, spoils
        self._hover = float(np.mean(compute_hover_rotor_speeds(model_parameters(vehicle))))
        self.reset()

    def reset(self) -> None:
        self.renderer = self.make_renderer()
        self._frozen_picture: NDArray[np.uint8] | None = None
        self.rotor_phase, self.last_time_s, self._due_s = np.zeros(2), math.nan, -math.inf

    def make_renderer(self) -> Renderer:
        """Return another renderer with the settings of this camera."""
        return Renderer(*self._given, seed=self._seed)

    def advance_and_check_due(self, truth: Truth) -> bool:
        """Advance the rotors to this instant, and return whether a picture is due; call this every period."""
        t = truth.time_s
        if not math.isnan(self.last_time_s):
            self.rotor_phase = np.mod(self.rotor_phase + truth.rotor_speed * (t - self.last_time_s), 2 * math.pi)
        self.last_time_s = t
        if t < self._due_s - 1e-9:
            return False
        period = float(self._given[0].sensor.period)
        self._due_s = (t if t - self._due_s > period else self._due_s) + period
        return True

    def light_level(self, time_s: float) -> float | None:
        """Return the fraction of light (0..1) that reaches the camera under its faults; None if it is unplugged."""
        active = {s.kind for s in self._spoils if s.start_s <= time_s < s.stop_s}
        if "unplugged" in active:
            return None
        return 0.0 if "covered" in active else (0.01 if "dark" in active else 1.0)

    def render_picture(self, truth: Truth, light: float) -> NDArray[np.uint8]:
        """Return the picture at this instant, with the camera's faults."""
        picture = self.renderer.render_picture(self.compute_motion_at_exposure(truth), light)
        active = {s.kind for s in self._spoils if s.start_s <= truth.time_s < s.stop_s}
        if "mirrored" in active:
            picture = np.ascontiguousarray(picture[:, ::-1])
        if "inverted" in active:
            picture = np.ascontiguousarray(picture[::-1, ::-1])
        if "dirty" in active:
            picture = add_dirt(picture)
        if "frozen" in active:
            self._frozen_picture = picture if self._frozen_picture is None else self._frozen_picture
            return self._frozen_picture
        self._frozen_picture = None
        return picture

    def compute_motion_at_exposure(self, truth: Truth) -> VehicleMotion:
        """Return position, attitude, velocity and rates of the vehicle at the middle of the exposure."""
        share = min(1.5, (float(np.mean(truth.rotor_speed)) / self._hover) ** 2)
        return VehicleMotion(
            truth.time_s, truth.position.copy(), truth.velocity.copy(), body_to_ned_matrix(truth.state[ATTITUDE_SLICE]),
            truth.rates.copy(), truth.rotor_speed.copy(), self.rotor_phase.copy(), share,
        )  # fmt: skip


class PictureStreamServer:
    """Server that streams a flight's rendered pictures to other programs (MJPEG).

    Parameters
    ----------
    film : OnboardCamera
    server : StreamServer
    """

    def __init__(self, film: OnboardCamera, server: StreamServer) -> None:
        self._film, self._server = film, server

    def send_if_due(self, truth: Truth) -> None:
        """Render and publish a picture if one is due."""
        light = self._film.light_level(truth.time_s)
        if self._film.advance_and_check_due(truth) and light is not None:
            picture = self._film.render_picture(truth, light)
            self._server.publish_picture(encode_jpeg(picture, SHOWN_JPEG_QUALITY), truth.time_s)

    def reset(self) -> None:
        self._film.reset()

    def close(self) -> None:
        self._server.close()
