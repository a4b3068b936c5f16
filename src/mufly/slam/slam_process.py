"""SLAM in a process of its own: pictures go there, answers come back, each when it is asked for.

Whoever sends pictures goes on while they are looked at, and waits where it asks for an answer that is not there yet. So
a simulation says by its own clock when an answer is known, and is the same however fast the machine is. With an answer
comes the map as it is drawn; :class:`TrackedPicture` is all that a station shows of it.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.camera import Camera, project_points
from mufly.errors import MuflyError
from mufly.slam.camera_frame import CameraFrame, FrameInfo
from mufly.slam.image_tools import load_opencv, pinhole_parameters
from mufly.slam.keyframe_map import FloorMap
from mufly.slam.slam_system import SlamSystem, TrackingResult


@dataclass(frozen=True, eq=False)
class MapView:
    """A map as it is drawn.

    Attributes
    ----------
    keyframe_poses : (n, 3) float array
        N, E (m) and heading (rad) of the camera.
    edge_indices : (m, 3) int array
        Two keyframes, and whether that closes a loop (1) or follows the way (0).
    """

    keyframe_poses: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    edge_indices: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class PictureCounts:
    """What became of the pictures of a flight so far.

    Attributes
    ----------
    taken_count : int
    lost_count : int
        By the radio.
    processed_count : int
        That SLAM looked at.
    trusted_count : int
        Of these: those that gave a place.
    """

    taken_count: int = 0
    lost_count: int = 0
    processed_count: int = 0
    trusted_count: int = 0


@dataclass(frozen=True, eq=False)
class TrackedPicture:
    """A picture that was looked at, as a station shows it.

    Attributes
    ----------
    jpeg : bytes
    result : Answer or None
        What was made of it; None of one that nobody looked at (the vehicle stands).
    feature_pixels : (n, 2) float array
        Points that agree, in pixels of the picture.
    latency_s : float
        From the middle of its exposure until the vehicle knew the answer.
    processing_time_s : float
        Of it: what looking took.
    warning : str
        What is wrong at present, "" if nothing is.
    counts : Counts
    map_view : Sketch
    path_m : (n, 2) float array
        N, E (m) of the answers so far, thinned.
    is_standing : bool
        It is on the floor, where nobody asks for a position.
    """

    time_s: float
    jpeg: bytes
    result: TrackingResult | None = None
    feature_pixels: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    latency_s: float = float("nan")
    processing_time_s: float = float("nan")
    warning: str = ""
    counts: PictureCounts = field(default_factory=PictureCounts)
    map_view: MapView = field(default_factory=MapView)
    path_m: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    is_standing: bool = False


def make_map_view(floor_map: FloorMap) -> MapView:
    """Return how a map is drawn."""
    ties = [(e.first_index, e.second_index, e.is_loop_closure) for e in floor_map.edges]
    return MapView(floor_map.nodes[:, :3].astype(np.float32), np.array(ties, dtype=np.int32).reshape(-1, 3))


def locate_features(camera: Camera, answer: TrackingResult) -> NDArray[np.float32]:
    """Return where the points that agree are (n, 2) in the picture as it was taken, distortion and all (pixels)."""
    focal, middle = pinhole_parameters(camera)
    return project_points(camera, (answer.inlier_pixels - middle) / focal).astype(np.float32)


class SlamProcess:
    """Looks at pictures elsewhere; made once the other process can, after a few seconds where nothing is compiled.

    Parameters
    ----------
    camera : Camera
    start : (3,) tuple
        N, E (m), heading (rad) of the vehicle at the first picture.
    seed : int
        Of the points drawn by chance.

    Attributes
    ----------
    map_view : Sketch
        The map as of the latest answer.
    processing_time_s : float
        How long that one took.

    Raises
    ------
    MuflyError
        If there is no OpenCV.
    """

    def __init__(self, camera: Camera, *, start: Any = (0.0, 0.0, 0.0), seed: int = 0) -> None:
        load_opencv()
        # No child of multiprocessing: a vehicle may itself be one, and those have none.
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from mufly.slam.slam_process import worker_main; worker_main()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
        self.map_view, self.processing_time_s = MapView(), 0.0
        self._write_message((camera, tuple(start), seed))
        self._read_message()  # it can look now

    def _write_message(self, message: Any) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(message, self._process.stdin, pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise MuflyError(f"the process that looks at pictures has ended ({error})") from error

    def send_frame(self, frame: CameraFrame) -> None:
        """Have a picture looked at.

        Raises
        ------
        MuflyError
            If the process has ended.
        """
        self._write_message(frame)

    def receive_result(self) -> TrackingResult:
        """Wait for the answer to the oldest picture that none has come to.

        Raises
        ------
        MuflyError
            If the process has ended.
        """
        answer, sketch, self.processing_time_s = self._read_message()
        assert isinstance(answer, TrackingResult)
        self.map_view = sketch or self.map_view
        return answer

    def _read_message(self) -> Any:
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except (EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
            raise MuflyError(f"the process that looks at pictures has ended ({error})") from error

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()  # nothing more to look at: it ends
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def worker_main() -> None:
    """The other process: pictures come in on standard input, answers go out on standard output, both pickled."""
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it ends it
    pictures, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(EOFError, OSError):
        camera, start, seed = pickle.load(pictures)
        _warm_up(camera)
        slam = SlamSystem(camera, start=start, seed=seed)
        pickle.dump("ready", answers, pickle.HIGHEST_PROTOCOL)
        answers.flush()
        told = None
        while True:
            frame = pickle.load(pictures)
            began = time.perf_counter()
            answer = slam.process_frame(frame)
            work_s = time.perf_counter() - began
            sketch = None if slam.floor_map.solution is told else make_map_view(slam.floor_map)
            told = slam.floor_map.solution
            pickle.dump((answer, sketch, work_s), answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()


def _warm_up(camera: Camera) -> None:
    """Load and compile what looking takes, before anybody waits for an answer in flight."""
    slam = SlamSystem(camera)
    rows, columns = camera.sensor.height, camera.sensor.width
    rough = np.random.default_rng(0).integers(0, 256, (rows // 4 + 2, columns // 4 + 2), dtype=np.uint8)
    picture = np.ascontiguousarray(rough.repeat(4, axis=0).repeat(4, axis=1)[:rows, :columns])
    for k in range(2):
        slam.process_frame(CameraFrame(k * float(camera.sensor.period), picture, FrameInfo(0.0, 0.0, 1.0)))
