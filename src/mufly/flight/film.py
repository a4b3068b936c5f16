"""The camera of a flight: when a picture is due, how the vehicle moves at its middle, what is wrong with the camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mufly.camera import Camera, Floor, Motion, Renderer, StreamServer, encode
from mufly.dynamics import model_parameters, rotation
from mufly.dynamics.state import ATTITUDE, hover_speeds
from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.grammar import read_span
from mufly.sensors import Truth
from mufly.vehicle import Vehicle
from mufly.world import World

SPOILS: Mapping[str, str] = {
    "covered": "the lens is covered: pictures are black",
    "dark": "the light is off: a hundredth of it is left",
    "unplugged": "no pictures come",
}
"""What can go wrong with the camera."""
SHOWN_QUALITY = 85
"""Of the JPEG of pictures that are shown; they have been through the radio's before."""


@dataclass(frozen=True)
class Spoil:
    """What goes wrong with the camera, and when (s)."""

    kind: str
    start_s: float = 0.0
    stop_s: float = math.inf


def parse_spoil(text: str) -> Spoil:
    """Return what ``"covered@20s+5s"`` says; start and duration may be left out.

    Raises
    ------
    InputError
        If it is none of :data:`SPOILS`.
    """
    kind, _, when = text.strip().partition("@")
    if kind not in SPOILS:
        raise ArgumentError("camera_fault", text, "is none", suggest_name(kind, SPOILS))
    try:
        return Spoil(kind, *read_span("", when))
    except InputError as error:
        raise ArgumentError("camera_fault", text, error.problem, error.remedy) from None


class Film:
    """A camera on a vehicle that flies.

    Parameters
    ----------
    camera : Camera
    floor : Floor
    vehicle : Vehicle
    world : World
        Its boxes are seen.
    seed : int
    spoils : tuple of Spoil
    """

    def __init__(
        self,
        camera: Camera,
        floor: Floor,
        vehicle: Vehicle,
        world: World,
        seed: int,
        spoils: tuple[Spoil, ...] = (),
    ) -> None:
        self._given = camera, floor, world
        self._seed, self._spoils = seed, spoils
        self._hover = float(np.mean(hover_speeds(model_parameters(vehicle))))
        self.reset()

    def reset(self) -> None:
        self.renderer = self.another()
        self.phase, self.last_s, self._due_s = np.zeros(2), math.nan, -math.inf

    def another(self) -> Renderer:
        """Return one more renderer of the same pictures."""
        return Renderer(*self._given, seed=self._seed)

    def due(self, truth: Truth) -> bool:
        """Turn the rotors on to this instant, and say whether a picture is due; asked in every period."""
        t = truth.time_s
        if not math.isnan(self.last_s):
            self.phase = np.mod(self.phase + truth.rotor_speed * (t - self.last_s), 2 * math.pi)
        self.last_s = t
        if t < self._due_s - 1e-9:
            return False
        period = float(self._given[0].sensor.period)
        self._due_s = (t if t - self._due_s > period else self._due_s) + period
        return True

    def light(self, time_s: float) -> float | None:
        """Return how much light there is, 1 as it should be; None: no pictures come."""
        active = {s.kind for s in self._spoils if s.start_s <= time_s < s.stop_s}
        if "unplugged" in active:
            return None
        return 0.0 if "covered" in active else (0.01 if "dark" in active else 1.0)

    def motion(self, truth: Truth) -> Motion:
        """How it moves at the middle of a picture."""
        share = min(1.5, (float(np.mean(truth.rotor_speed)) / self._hover) ** 2)
        return Motion(
            truth.time_s, truth.position.copy(), truth.velocity.copy(), rotation(truth.state[ATTITUDE]),
            truth.rates.copy(), truth.rotor_speed.copy(), self.phase.copy(), share,
        )  # fmt: skip


class Stream:
    """Pictures of a flight for others to look at: rendered and sent, no more.

    Parameters
    ----------
    film : Film
    server : StreamServer
    """

    def __init__(self, film: Film, server: StreamServer) -> None:
        self._film, self._server = film, server

    def look(self, truth: Truth) -> None:
        """Send a picture, if one is due."""
        light = self._film.light(truth.time_s)
        if self._film.due(truth) and light is not None:
            picture = self._film.renderer.render(self._film.motion(truth), light)
            self._server.publish(encode(picture, SHOWN_QUALITY), truth.time_s)

    def reset(self) -> None:
        self._film.reset()

    def close(self) -> None:
        self._server.close()
