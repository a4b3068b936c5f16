"""What there is to be seen of SLAM at work: a picture with its features, what was made of it, and the map."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, project
from mufly.slam.mapping import Map
from mufly.slam.system import Answer
from mufly.slam.vision import pinhole


@dataclass(frozen=True, eq=False)
class Sketch:
    """A map as it is drawn.

    Attributes
    ----------
    keyframes : (n, 3) float array
        N, E (m) and heading (rad) of the camera.
    ties : (m, 3) int array
        Two keyframes, and whether that closes a loop (1) or follows the way (0).
    """

    keyframes: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    ties: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class Counts:
    """What became of the pictures of a flight so far.

    Attributes
    ----------
    taken : int
    lost : int
        By the radio.
    answered : int
        That SLAM looked at.
    trusted : int
        Of these: those that gave a place.
    """

    taken: int = 0
    lost: int = 0
    answered: int = 0
    trusted: int = 0


@dataclass(frozen=True, eq=False)
class Sight:
    """A picture that was looked at, as a station shows it.

    Attributes
    ----------
    jpeg : bytes
    answer : Answer or None
        What was made of it; None of one that nobody looked at (the vehicle stands).
    features : (n, 2) float array
        Points that agree, in pixels of the picture.
    latency_s : float
        From the middle of its exposure until the vehicle knew the answer.
    work_s : float
        Of it: what looking took.
    said : str
        What is wrong at present, "" if nothing is.
    counts : Counts
    sketch : Sketch
    path : (n, 2) float array
        N, E (m) of the answers so far, thinned.
    """

    time_s: float
    jpeg: bytes
    answer: Answer | None = None
    features: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    latency_s: float = float("nan")
    work_s: float = float("nan")
    said: str = ""
    counts: Counts = field(default_factory=Counts)
    sketch: Sketch = field(default_factory=Sketch)
    path: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))


def sketched(floor_map: Map) -> Sketch:
    """Return how a map is drawn."""
    ties = [(e.first, e.second, e.closes) for e in floor_map.edges]
    return Sketch(floor_map.nodes[:, :3].astype(np.float32), np.array(ties, dtype=np.int32).reshape(-1, 3))


def features_of(camera: Camera, answer: Answer) -> NDArray[np.float32]:
    """Return where the points that agree are (n, 2) in the picture as it was taken, distortion and all (pixels)."""
    focal, middle = pinhole(camera)
    return project(camera, (answer.pixels - middle) / focal).astype(np.float32)
