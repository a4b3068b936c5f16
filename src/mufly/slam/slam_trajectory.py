"""Trajectory of SLAM results: collection, file in TUM's text format, table for recordings, and picture."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.results import ResultColumn, ShownBlock, draws, make_lines_block, result, tabulate_fields
from mufly.slam.camera_frame import CameraFrame
from mufly.slam.datasets.dataset_writers import write_tum_trajectory
from mufly.slam.slam_system import SlamSystem, TrackingResult
from mufly.slam.trajectory_evaluation import TrajectoryEvaluation, read_poses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Array = NDArray[np.float64]
_EPOCH_TIME_LIMIT_S = 1e6
"""Limit (s) above which times count from 1970; plots show them relative to the first one."""


@result(eq=False)
class SlamTrajectory:
    """Trajectory of SLAM results.

    Attributes
    ----------
    time : (n,) array
        Times of the results (s).
    heading : (n,) array
        Headings (rad).
    position : (n, 3) array
        N, E, D (m).
    covariance : (n, 4, 4) array
        Covariances of N, E, D, heading.
    pictures : int
        Number of pictures.
    failure_reason_counts : dict
        Reasons for pictures without a result, and their counts.
    texture_bound_m : float
        Median of the Cramer-Rao bounds of the place (m), NaN if unknown.
    """

    time: _Array
    position: _Array
    heading: _Array
    covariance: _Array
    pictures: int
    failure_reason_counts: dict[str, int]
    texture_bound_m: float = np.nan

    @property
    def median_position_sigma_m(self) -> float:
        """Median over all results of the greatest horizontal standard deviation (m)."""
        if not len(self.time):
            return float("nan")
        return float(np.median(np.sqrt(np.linalg.eigvalsh(self.covariance[:, :2, :2])[:, -1])))

    def to_dataset(self) -> xr.Dataset:
        """Return the trajectory as a table over its times."""
        sigma = np.sqrt(np.einsum("nii->ni", self.covariance)) if len(self.time) else np.zeros((0, 4))
        return xr.Dataset(
            {
                "estimated_position": (("time", "axis"), self.position),
                "estimated_position_sigma": (("time", "axis"), sigma[:, :3]),
                "heading": ("time", self.heading, {"units": "rad"}),
                "heading_sigma": ("time", sigma[:, -1], {"units": "rad"}),
            },
            {"time": self.time, "axis": ["N", "E", "D"]},
        )

    def write_tum_file(self, file: Path) -> None:
        """Write the trajectory in TUM's text format, with covariance."""
        attitude = np.column_stack([np.zeros((len(self.time), 2)), self.heading])
        write_tum_trajectory(file, self.time, self.position, attitude, "N-E-D, metres; heading alone", self.covariance)


@result(
    eq=False,
    json="pictures=trajectory.pictures answered=trajectory.time.size not_answered=trajectory.failure_reason_counts "
    "missed keyframes closures camera_faults texture_bound_m=trajectory.texture_bound_m "
    "median_position_sigma_m=trajectory.median_position_sigma_m errors stopped_by",
)
class SlamSummary:
    """Summary of a run of SLAM.

    Attributes
    ----------
    trajectory : SlamTrajectory
    missed : list of str
        Losses of a live source, in words.
    keyframes, closures : int
        Keyframes of the map, and closed loops.
    camera_verdicts : dict
        First time (s) and message of each fault of the camera, by its name.
    errors : TrajectoryEvaluation or None
        Errors to the truth.
    stopped_by : str
        Fault that ended the run early; "" without one.
    """

    trajectory: SlamTrajectory
    missed: list[str]
    keyframes: int
    closures: int
    camera_verdicts: dict[str, tuple[float, str]]
    errors: TrajectoryEvaluation | None
    stopped_by: str

    @property
    def camera_faults(self) -> dict[str, str]:
        """Messages of the camera's faults, by name."""
        return {name: message for name, (_, message) in self.camera_verdicts.items()}

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the camera's faults, the number of results, reasons of failures, and errors."""
        found = self.trajectory
        faults = (f"from {time_s:.1f} s on {message}" for time_s, message in self.camera_verdicts.values())
        reasons = sorted(found.failure_reason_counts.items(), key=lambda item: -item[1])
        bounds = (
            ResultColumn("median_position_sigma_m", "mm", ".1f", "place known to (median)"),
            ResultColumn("texture_bound_m", "mm", ".2f", "bound of a picture by noise (Cramer-Rao)"),
        )
        return [
            make_lines_block(*faults, mark="Warning", style="yellow"),
            make_lines_block(
                f"{len(found.time)} of {found.pictures} pictures have a position",
                *(f"  {count} not: {reason}" for reason, count in reasons),
                *(f"  {line}" for line in self.missed),
                f"{self.keyframes} keyframes, {self.closures} loops closed",
            ),
            *([tabulate_fields(found, bounds)] if np.isfinite(found.texture_bound_m) else ()),
            *(self.errors.make_printed_blocks() if self.errors is not None else ()),
        ]


def collect_results(answers: Iterable[TrackingResult]) -> SlamTrajectory:
    """Collect the results of SLAM in a trajectory; pictures without an accepted pose are counted."""
    good: list[TrackingResult] = []
    failure_reason_counts: dict[str, int] = {}
    count = 0
    for a in answers:
        count += 1
        if a.trusted:
            good.append(a)
        else:
            words = " ".join(w for w in a.reason.split() if not any(c.isdigit() for c in w))
            failure_reason_counts[words] = failure_reason_counts.get(words, 0) + 1
    return SlamTrajectory(
        np.array([a.time_s for a in good]), np.array([a.position for a in good]).reshape(-1, 3),
        np.array([a.heading for a in good]), np.array([a.covariance for a in good]).reshape(-1, 4, 4), count,
        failure_reason_counts, _finite_median([a.texture_bound_m for a in good]),
    )  # fmt: skip


def _finite_median(values: list[float]) -> float:
    finite = [v for v in values if np.isfinite(v)]
    return float(np.median(finite)) if finite else float("nan")


def run_slam(
    slam: SlamSystem,
    frames: Iterable[CameraFrame],
    on_answer: Callable[[int, TrackingResult], None] = lambda k, a: None,
) -> SlamTrajectory:
    """Run SLAM over pictures and return the trajectory."""

    def process_frames() -> Iterable[TrackingResult]:
        for k, frame in enumerate(frames):
            a = slam.process_frame(frame)
            on_answer(k, a)
            yield a

    return collect_results(process_frames())


def read_trajectory(file: Path) -> SlamTrajectory:
    """Read a trajectory written by :meth:`SlamTrajectory.write_tum_file`, or any other (without covariance: NaN).

    Skipped rows count as pictures without a result. Errors are those of
    :func:`mufly.slam.trajectory_evaluation.read_poses`.
    """
    poses = read_poses(file)
    covariance = np.full((len(poses.time_s), 4, 4), np.nan)
    if poses.extra_cells and all(len(cells) == 10 for cells in poses.extra_cells):
        upper = np.triu_indices(4)
        for k, cells in enumerate(poses.extra_cells):
            covariance[k][upper] = [float(c) for c in cells]
            covariance[k] = covariance[k] + np.triu(covariance[k], 1).T - np.tril(covariance[k], -1)
        low = np.tril_indices(4, -1)
        covariance[:, low[0], low[1]] = covariance[:, low[1], low[0]]
    lost = poses.file_pose_count - len(poses.time_s)
    return SlamTrajectory(
        poses.time_s,
        poses.position,
        poses.heading,
        covariance,
        poses.file_pose_count,
        {"left out": lost} if lost else {},
    )


@draws(SlamTrajectory)
def plot_trajectory(
    trajectory: SlamTrajectory,
    slam: SlamSystem | None = None,
    truth: tuple[_Array, _Array, _Array] | None = None,
) -> Figure:
    """Draw the path from above with the keyframes and their edges, and errors with their standard deviations."""
    from matplotlib.figure import Figure

    t, x = trajectory.time, trajectory.position
    since = float(t[0]) if len(t) and t[0] > _EPOCH_TIME_LIMIT_S else 0.0
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    if truth is not None:
        left.plot(truth[1][:, 1], truth[1][:, 0], color="0.6", lw=3, label="true")
    left.plot(x[:, 1], x[:, 0], color="tab:blue", lw=1, label="V-SLAM")
    if slam is not None and len(slam.floor_map.nodes):
        nodes = slam.floor_map.nodes
        for e in slam.floor_map.edges:
            pair = nodes[[e.first_index, e.second_index]]
            left.plot(
                pair[:, 1],
                pair[:, 0],
                color="tab:red" if e.is_loop_closure else "0.75",
                lw=1.2 if e.is_loop_closure else 0.7,
            )
        left.plot(nodes[:, 1], nodes[:, 0], "s", ms=4, color="k", label="keyframes")
        left.plot([], [], color="tab:red", label="loops closed")
    left.set(xlabel="east (m)", ylabel="north (m)", aspect="equal", title="from above")
    left.legend(loc="best", fontsize=8)
    names = ("north", "east", "height", "heading (0.1 rad)")
    deviation = np.sqrt(np.einsum("nii->ni", trajectory.covariance)) if len(t) else np.zeros((0, 4))
    for k, name in enumerate(names[:2]):
        colour = f"C{k}"
        if truth is not None:
            off = x[:, k] - np.interp(t, truth[0], truth[1][:, k])
            right.plot(t - since, 100 * off, color=colour, lw=1, label=f"error {name}")
        label = f"deviation told {name}" if truth is None else None
        band = 200 * deviation[:, k]
        right.fill_between(t - since, -band, band, color=colour, alpha=0.15, lw=0, label=label)
    what = "twice the reported deviation" if truth is None else "errors, and twice the reported deviation"
    right.set(xlabel="time since the first (s)" if since else "time (s)", ylabel="cm", title=what)
    right.legend(loc="best", fontsize=8)
    return figure
