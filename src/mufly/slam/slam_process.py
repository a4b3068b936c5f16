"""SLAM in a separate process: pictures are sent there, and results are fetched on request.

The sender continues while a picture is processed, and waits only when it requests a result that is not ready. A
simulation therefore receives each result at the same simulated time, at any speed of the machine. Each result comes
with a drawing of the map; :class:`TrackedPicture` is the data that a ground station shows.
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
from mufly.slam.camera_frame import CameraFrame, FrameEstimate
from mufly.slam.image_tools import import_opencv, pinhole_parameters
from mufly.slam.keyframe_map import FloorMap
from mufly.slam.slam_system import SlamSystem, TrackingResult


@dataclass(frozen=True, eq=False)
class MapView:
    """SLAM map for display: poses of the keyframes, and the edges between them.

    Attributes
    ----------
    keyframe_poses : (n, 3) float array
        N, E (m) and heading (rad) of the camera.
    edge_indices : (m, 3) int array
        Two keyframes, and 1 for a loop closure or 0 for an edge along the path.
    """

    keyframe_poses: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    edge_indices: NDArray[np.int32] = field(default_factory=lambda: np.zeros((0, 3), np.int32))


@dataclass(frozen=True, eq=False)
class PictureCounts:
    """Numbers of pictures in a flight: taken, lost by the radio, processed, and trusted.

    Attributes
    ----------
    taken_count : int
        Pictures taken by the camera.
    lost_count : int
        Pictures lost by the radio.
    processed_count : int
        Pictures processed by SLAM.
    trusted_count : int
        Processed pictures with a trusted position.
    """

    taken_count: int = 0
    lost_count: int = 0
    processed_count: int = 0
    trusted_count: int = 0


@dataclass(frozen=True, eq=False)
class TrackedPicture:
    """A processed picture for display at a ground station.

    Attributes
    ----------
    jpeg : bytes
    result : TrackingResult or None
        Result; None for a picture that was not processed (the vehicle stands).
    feature_pixels : (n, 2) float array
        Inliers, in pixels of the picture.
    latency_s : float
        Time from the middle of the exposure until the result reached the vehicle.
    processing_time_s : float
        Part of the latency spent on processing.
    warning : str
        Present warning, "" if there is none.
    counts : PictureCounts
    map_view : MapView
    path_points_m : (n, 2) float array
        N, E (m) of the results so far, thinned.
    is_standing : bool
        Whether the vehicle stands on the floor, where no position is needed.
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
    path_points_m: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    is_standing: bool = False


def make_map_view(floor_map: FloorMap) -> MapView:
    """Return a copy of a SLAM map for display."""
    ties = [(e.first_index, e.second_index, e.is_loop_closure) for e in floor_map.edges]
    return MapView(floor_map.nodes[:, :3].astype(np.float32), np.array(ties, dtype=np.int32).reshape(-1, 3))


def find_distorted_inlier_pixels(camera: Camera, answer: TrackingResult) -> NDArray[np.float32]:
    """Return the pixels (n, 2) of the inliers in the original, distorted picture."""
    focal, middle = pinhole_parameters(camera)
    return project_points(camera, (answer.inlier_pixels - middle) / focal).astype(np.float32)


class SlamProcess:
    """SLAM in a separate process; the constructor returns once it is ready, after some seconds of compilation.

    Parameters
    ----------
    camera : Camera
    start : (3,) tuple
        N, E (m), heading (rad) of the vehicle at the first picture.
    seed : int
        Seed of the random point pairs.

    Attributes
    ----------
    map_view : MapView
        Map at the latest result.
    processing_time_s : float
        Processing time of the latest result.

    Raises
    ------
    MuflyError
        If OpenCV is not installed.
    """

    def __init__(self, camera: Camera, *, start: Any = (0.0, 0.0, 0.0), seed: int = 0) -> None:
        import_opencv()
        # No child of multiprocessing: a vehicle may itself be one, and such a child cannot have children.
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from mufly.slam.slam_process import worker_main; worker_main()"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )  # fmt: skip
        self.map_view, self.processing_time_s = MapView(), 0.0
        self._write_message((camera, tuple(start), seed))
        self._read_message()  # the process is ready

    def _write_message(self, message: Any) -> None:
        assert self._process.stdin is not None
        try:
            pickle.dump(message, self._process.stdin, pickle.HIGHEST_PROTOCOL)
            self._process.stdin.flush()
        except (OSError, ValueError) as error:
            raise MuflyError(f"the SLAM process has ended ({error})") from error

    def send_frame(self, frame: CameraFrame) -> None:
        """Send a picture for processing.

        Raises
        ------
        MuflyError
            If the process has ended.
        """
        self._write_message(frame)

    def receive_result(self) -> TrackingResult:
        """Wait for the result of the oldest pending picture.

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
            raise MuflyError(f"the SLAM process has ended ({error})") from error

    def close(self) -> None:
        """Stop the process."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(OSError):
            self._process.stdin.close()  # the end of input stops the process
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def worker_main() -> None:
    """Run the process: pictures come on standard input, results go to standard output, both pickled."""
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process stops this one
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
    """Load and compile all functions before the first picture of a flight."""
    slam = SlamSystem(camera)
    rows, columns = camera.sensor.height, camera.sensor.width
    rough = np.random.default_rng(0).integers(0, 256, (rows // 4 + 2, columns // 4 + 2), dtype=np.uint8)
    picture = np.ascontiguousarray(rough.repeat(4, axis=0).repeat(4, axis=1)[:rows, :columns])
    for k in range(2):
        slam.process_frame(CameraFrame(k * float(camera.sensor.period), picture, FrameEstimate(0.0, 0.0, 1.0)))
