"""Answers as a trajectory: gathered, written as TUM's text, as a table for recordings, and drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.slam.evaluation import read_poses
from mufly.slam.frame import Frame
from mufly.slam.system import Answer, Slam
from mufly.slam.writers import write_tum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

from mufly.results import result

_Array = NDArray[np.float64]
_OF_DAY_S = 1e6
"""Times beyond count from 1970; they are drawn from the first on."""


@result(eq=False, picture="mufly.slam.trajectory:draw")
class Trajectory:
    """What was answered.

    Attributes
    ----------
    time, heading : (n,) arrays
        s, rad.
    position : (n, 3) array
        N, E, D (m).
    covariance : (n, 4, 4) array
        Of N, E, D, heading.
    pictures : int
        How many there were.
    reasons : dict
        Why others were not answered, and how often.
    """

    time: _Array
    position: _Array
    heading: _Array
    covariance: _Array
    pictures: int
    reasons: dict[str, int]

    def dataset(self) -> xr.Dataset:
        """As a table on its clock."""
        sigma = np.sqrt(np.einsum("nii->ni", self.covariance)) if len(self.time) else np.zeros((0, 4))
        return xr.Dataset(
            {
                "estimated_position": (("time", "axis"), self.position),
                "estimated_position_sigma": (("time", "axis"), sigma[:, :3]),
                "heading": ("time", self.heading, {"units": "rad"}),
                "heading_sigma": ("time", sigma[:, 3], {"units": "rad"}),
            },
            {"time": self.time, "axis": ["N", "E", "D"]},
        )

    def write(self, file: Path) -> None:
        """Write it as TUM's text, with covariance."""
        attitude = np.column_stack([np.zeros((len(self.time), 2)), self.heading])
        write_tum(file, self.time, self.position, attitude, "N-E-D, metres; heading alone", self.covariance)


def gathered(answers: Iterable[Answer]) -> Trajectory:
    """Gather answers; those that are not trusted are counted."""
    good: list[Answer] = []
    reasons: dict[str, int] = {}
    count = 0
    for a in answers:
        count += 1
        if a.trusted:
            good.append(a)
        else:
            words = " ".join(w for w in a.reason.split() if not any(c.isdigit() for c in w))
            reasons[words] = reasons.get(words, 0) + 1
    return Trajectory(
        np.array([a.time_s for a in good]), np.array([a.position for a in good]).reshape(-1, 3),
        np.array([a.heading for a in good]), np.array([a.covariance for a in good]).reshape(-1, 4, 4), count, reasons,
    )  # fmt: skip


def run(
    slam: Slam, frames: Iterable[Frame], on_answer: Callable[[int, Answer], None] = lambda k, a: None
) -> Trajectory:
    """Go through pictures."""

    def answers() -> Iterable[Answer]:
        for k, frame in enumerate(frames):
            a = slam.step(frame)
            on_answer(k, a)
            yield a

    return gathered(answers())


def read_trajectory(file: Path) -> Trajectory:
    """Read what :meth:`Trajectory.write` wrote, or any trajectory (without covariance: NaN).

    Rows that are left out count as pictures without an answer. Errors are those of
    :func:`mufly.slam.evaluation.read_poses`.
    """
    poses = read_poses(file)
    covariance = np.full((len(poses.time), 4, 4), np.nan)
    if poses.more and all(len(cells) == 10 for cells in poses.more):
        upper = np.triu_indices(4)
        for k, cells in enumerate(poses.more):
            covariance[k][upper] = [float(c) for c in cells]
            covariance[k] = covariance[k] + np.triu(covariance[k], 1).T - np.tril(covariance[k], -1)
        low = np.tril_indices(4, -1)
        covariance[:, low[0], low[1]] = covariance[:, low[1], low[0]]
    lost = poses.rows - len(poses.time)
    return Trajectory(
        poses.time, poses.position, poses.heading, covariance, poses.rows, {"left out": lost} if lost else {}
    )


def draw(
    trajectory: Trajectory, slam: Slam | None = None, truth: tuple[_Array, _Array, _Array] | None = None
) -> Figure:
    """Draw the way from above with the keyframes and their ties, and errors with their deviations."""
    from matplotlib.figure import Figure

    t, x = trajectory.time, trajectory.position
    since = float(t[0]) if len(t) and t[0] > _OF_DAY_S else 0.0
    figure = Figure(figsize=(11, 5.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    if truth is not None:
        left.plot(truth[1][:, 1], truth[1][:, 0], color="0.6", lw=3, label="true")
    left.plot(x[:, 1], x[:, 0], color="tab:blue", lw=1, label="V-SLAM")
    if slam is not None and len(slam.map.nodes):
        nodes = slam.map.nodes
        for e in slam.map.edges:
            pair = nodes[[e.first, e.second]]
            left.plot(
                pair[:, 1], pair[:, 0], color="tab:red" if e.closes else "0.75", lw=1.2 if e.closes else 0.7
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
    what = "twice the deviation told" if truth is None else "errors, and twice the deviation told"
    right.set(xlabel="time since the first (s)" if since else "time (s)", ylabel="cm", title=what)
    right.legend(loc="best", fontsize=8)
    return figure
