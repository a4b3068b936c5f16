"""The track of a flight in three dimensions.

The true path, coloured by the state of the mission, over its shadow on the floor, with the reference, the numbered
waypoints and the obstacles. Axes east, north, height: right-handed, up is up, one scale for all three. Matplotlib
does not sort by depth, so the path is drawn over the obstacles and these are half transparent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import ArrayLike, NDArray

from mufly.flight.picture_parts import BLACK, GREEN, GREY, ORANGE, colour, runs, state_handles, title
from mufly.world import World

__all__ = ["draw_track"]

SHADOW, SOLID, SOLID_EDGE = "#b5b5b5", "#c4bcae", "#7d7566"
DASHES = (0, (4, 3))

_Array = NDArray[np.float64]


def _enu(ned: ArrayLike) -> _Array:
    """North, east, down to east, north, height."""
    x = np.asarray(ned, dtype=np.float64)
    return np.stack((x[..., 1], x[..., 0], -x[..., 2]), axis=-1)


def draw_track(
    dataset: xr.Dataset, *, waypoints: Sequence[ArrayLike] = (), world: World | None = None
) -> Figure:
    """The track in three dimensions (see :func:`draw_flight` for the parameters)."""
    figure = Figure(figsize=(8.4, 6.0))
    ax: Any = figure.add_axes((0.0, 0.045, 1.0, 1.02), projection="3d", computed_zorder=False)
    truth = _enu(dataset.truth_position.values)
    reference = _enu(dataset.reference_position.values)
    marks = _enu(np.array([np.asarray(w, dtype=np.float64) for w in waypoints]).reshape(-1, 3))
    solids = _solids(world or World())
    _frame(ax, np.concatenate((truth, marks, *(np.concatenate(faces) for faces in solids))))
    floor = truth * (1, 1, 0)
    ax.plot(*floor.T, color=SHADOW, lw=2.2, solid_capstyle="round", zorder=1)
    for faces in solids:
        edges = SOLID_EDGE if len(faces) < 10 else "none"
        shape = Poly3DCollection(faces, facecolors=SOLID, edgecolors=edges, lw=0.6, alpha=0.6)
        shape.set_zorder(2)
        ax.add_collection3d(shape)
        ax.plot(*np.vstack((faces[-1], faces[-1][:1])).T, color=SOLID_EDGE, lw=0.7, zorder=2)
    posts = np.stack((marks, marks * (1, 1, 0)), axis=1)
    if len(posts):
        ax.add_collection3d(Line3DCollection(posts, colors=GREY, lw=0.8, linestyles=":", zorder=2))
        ax.scatter(*posts[:, 1].T, s=8, color=GREY, depthshade=False, zorder=2)
    ax.plot(*reference.T, color=BLACK, lw=0.9, ls=DASHES, zorder=3)
    stretches = runs(dataset)
    for state, first, last in stretches:
        ax.plot(
            *truth[first : last + 1].T,
            color=colour(state),
            lw=4.5 if state == "take-off" else 2.2,
            solid_capstyle="round",
            zorder=4,
        )
    ax.scatter(*marks.T, s=150, color="white", edgecolors=BLACK, linewidths=1.1, depthshade=False, zorder=6)
    for number, mark in enumerate(marks, 1):
        ax.text(*mark, str(number), ha="center", va="center", fontsize=8, fontweight="bold", zorder=7)
    ends = {"marker": "^", "s": 120, "edgecolors": BLACK, "linewidths": 0.8, "depthshade": False, "zorder": 8}
    ax.scatter(*truth[0], color=ORANGE, **ends)
    ax.scatter(*truth[-1], color=GREEN, **(ends | {"marker": "s", "s": 46}))
    handles = [
        *state_handles([name for name, _, _ in stretches], lines=True),
        Line2D([], [], color=BLACK, lw=0.9, ls=DASHES, label="reference"),
        Line2D([], [], color=SHADOW, lw=2.2, label="shadow"),
        _marker("^", ORANGE, "start"),
        _marker("s", GREEN, "end"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 9), columnspacing=1.3)
    figure.text(0.02, 0.965, title(dataset), fontsize=10)
    return figure


def _marker(shape: str, colour: str, label: str) -> Line2D:
    return Line2D(
        [], [], marker=shape, color=colour, markeredgecolor=BLACK, mew=0.8, ms=7, ls="", label=label
    )


def _frame(ax: Any, points: _Array) -> None:
    """Equal scale on all axes, the floor at the bottom, quiet panes."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    low[2], high[2] = 0.0, max(high[2], 0.5)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    half[:2] = np.maximum(half[:2] + 0.35, 0.75)
    low[:2], high[:2] = (middle - half)[:2], (middle + half)[:2]
    high[2] *= 1.08
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(high - low, zoom=1.13)
    ax.set(xlabel="East (m)", ylabel="North (m)", zlabel="Height (m)")
    ax.view_init(elev=24, azim=-56)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 1.0))
        axis.line.set_color("#555555")
        axis.set_major_locator(mpl.ticker.MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    ax.zaxis.set_pane_color((0.985, 0.985, 0.98, 1.0))


def _solids(world: World) -> list[list[_Array]]:
    """Faces of every obstacle, east, north, height."""
    solids = []
    for box in world.boxes:
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        base = 0.5 * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * box.size[:2]
        outline = base @ np.array([(c, s), (-s, c)]) + box.centre[:2]
        solids.append(_prism(outline, -box.centre[2] - 0.5 * box.size[2], box.size[2]))
    for cylinder in world.cylinders:
        angle = np.linspace(0.0, 2 * np.pi, 33)[:-1]
        circle = cylinder.radius * np.column_stack((np.cos(angle), np.sin(angle))) + cylinder.centre
        solids.append(_prism(circle, cylinder.foot, cylinder.height))
    return solids


def _prism(outline: _Array, foot: float, height: float) -> list[_Array]:
    """Faces over an outline of north, east corners."""
    flat = outline[:, ::-1]
    low = np.column_stack((flat, np.full(len(flat), foot)))
    top = low + np.array([0.0, 0.0, height])
    sides = [np.array([low[k - 1], low[k], top[k], top[k - 1]]) for k in range(len(flat))]
    return [*sides, top]
