"""Pictures of a flight: the track in three dimensions and the histories over time.

- ``track``: the true path, coloured by the state of the mission, over its shadow on the floor, with the reference,
  the numbered waypoints and the obstacles. The axes are east, north and height, with one scale. Matplotlib does not
  sort by depth, so the path is drawn over half-transparent obstacles.
- ``history``: states, inputs and battery over time, with references (dashed) and the mission's states as background
  bands.
- ``position``: north, east and height in large panels, with the tracking error.

Angles are in degrees. The colours are distinguishable for colour-blind readers (Okabe and Ito 2008, "Color universal
design").
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from numpy.typing import ArrayLike, NDArray

from mufly.flight.record.flight_summary import find_state_runs
from mufly.world import World

BLACK, GREY = "#222222", "#8c8c8c"
BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
VERMILION, PURPLE, SKY_BLUE = "#D55E00", "#CC79A7", "#56B4E9"
STATE_COLOURS = {
    "init": GREY,
    "take-off": ORANGE,
    "hover": SKY_BLUE,
    "waypoint": BLUE,
    "obstacle": VERMILION,
    "landing": GREEN,
    "rc": PURPLE,
}
"""Colour of each state of the mission (any other state is drawn like ``init``)."""

PLOT_STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,  # a fixed position saves the search for ticks under the title
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#b0b0b0",
    "grid.linewidth": 0.5,
    "grid.alpha": 0.5,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "legend.handlelength": 1.6,
    "svg.hashsalt": "mufly",
    "svg.fonttype": "none",
}

FAST_PNG_OPTIONS: dict[str, Any] = {"pil_kwargs": {"compress_level": 1}}
"""Fast PNG compression; the files are a fifth larger."""

TRACK_SHADOW_COLOUR, OBSTACLE_COLOUR, OBSTACLE_EDGE_COLOUR = "#b5b5b5", "#c4bcae", "#7d7566"
REFERENCE_DASHES = (0, (4, 3))

_Array = NDArray[np.float64]


def draw_flight_pictures(
    dataset: xr.Dataset,
    folder: str | Path,
    *,
    waypoints: Sequence[ArrayLike] = (),
    world: World | None = None,
) -> list[Path]:
    """Draw all pictures of a flight into a folder.

    Parameters
    ----------
    dataset : xarray.Dataset
        A recording.
    folder : str or Path
        Created if missing.
    waypoints : sequence of (3,)
        Waypoints N, E, D (m), numbered in this order.
    world : World, optional
        Its boxes and cylinders are drawn.

    Returns
    -------
    list of Path
        ``track.png``, ``history.png``, ``position.png``. The same flight gives the same bytes.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    paths = []
    with mpl.rc_context(PLOT_STYLE):
        for name, figure in (
            ("track", draw_track(dataset, waypoints=waypoints, world=world)),
            ("history", draw_history(dataset)),
            ("position", draw_position(dataset)),
        ):
            paths.append(target / f"{name}.png")
            figure.savefig(paths[-1], dpi=130, **FAST_PNG_OPTIONS)
    return paths


def draw_history(dataset: xr.Dataset) -> Figure:
    """Draw position, velocity, attitude, rates, rotor speeds, inputs and battery over time."""
    figure = Figure(figsize=(12.0, 11.4))
    panels: Any = figure.subplots(5, 2, sharex=True)
    figure.subplots_adjust(left=0.06, right=0.985, top=0.925, bottom=0.05, hspace=0.27, wspace=0.15)
    d, up, deg = dataset, np.array([1.0, 1.0, -1.0]), 180.0 / np.pi
    angles, wanted = d.truth_attitude.values * deg, d.reference_attitude.values * deg
    rates = d.truth_rates.values * deg
    axes, rotors, servos = ("north", "east", "height"), ("upper", "lower"), ("1, pitch", "2, roll")
    shown: tuple[tuple[str, tuple[str, ...], _Array, _Array | None, dict[str, Any]], ...] = (
        ("Position (m)", axes, d.truth_position.values * up, d.reference_position.values * up, {}),
        ("Velocity (m/s)", axes, d.truth_velocity.values * up, d.reference_velocity.values * up, {}),
        ("Roll and pitch (deg)", ("roll", "pitch"), angles[:, :2], wanted[:, :2], {"span": 4.0}),
        ("Heading (deg)", ("heading",), angles[:, 2:], wanted[:, 2:], {"span": 10.0}),
        ("Roll and pitch rate (deg/s)", ("p", "q"), rates[:, :2], None, {"span": 20.0}),
        ("Yaw rate (deg/s)", ("r",), rates[:, 2:], None, {"span": 20.0}),
        ("Rotor speed (rad/s)", rotors, d.truth_rotor_speed.values, None, {}),
        ("Motor input (0 to 1)", rotors, d.motor_input.values, None, {"limits": (0.0, 1.0)}),
        ("Servo input (-1 to 1)", servos, d.servo_input.values, None, {"limits": (-1.0, 1.0)}),
        ("Battery voltage (V)", ("voltage",), d.battery_voltage.values[:, None], None, {"span": 0.5}),
    )
    for ax, (heading, labels, values, reference, options) in zip(panels.ravel(), shown, strict=True):
        _draw_panel(ax, dataset, heading, labels, values, reference, **options)
    for ax in panels[-1]:
        ax.set_xlabel("Time (s)")
    _draw_header(figure, dataset, 0.985)
    return figure


def draw_position(dataset: xr.Dataset) -> Figure:
    """Draw north, east and height over time with their references, and the distance from the reference."""
    figure = Figure(figsize=(9.0, 8.4))
    *panels, last = figure.subplots(4, 1, sharex=True)
    figure.subplots_adjust(left=0.085, right=0.98, top=0.905, bottom=0.06, hspace=0.24)
    up = np.array([1.0, 1.0, -1.0])
    truth, reference = dataset.truth_position.values * up, dataset.reference_position.values * up
    measured = dataset.measured_position.values * up
    for k, name in enumerate(("North", "East", "Height")):
        ax = panels[k]
        if np.isfinite(measured[:, k]).any():  # only an ideal sensor measures the position itself
            ax.plot(dataset.time, measured[:, k], color=GREY, lw=0.8, alpha=0.8, label="measured")
        _draw_panel(ax, dataset, f"{name} (m)", ("true",), truth[:, k : k + 1], reference[:, k : k + 1])
    error = 100.0 * np.linalg.norm(truth - reference, axis=1)[:, None]
    _draw_panel(last, dataset, "Distance from the reference (cm)", ("",), error, colours=(VERMILION,))
    last.set_ylim(bottom=0.0)
    last.set_xlabel("Time (s)")
    _draw_header(figure, dataset, 0.985)
    return figure


def _draw_header(figure: Figure, dataset: xr.Dataset, top: float) -> None:
    handles = state_legend_handles([name for name, _, _ in find_state_runs(dataset)])
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, top), ncols=len(handles))
    figure.text(0.02, top - 0.005, flight_title(dataset), fontsize=10, va="top")


def _draw_panel(
    ax: Axes,
    dataset: xr.Dataset,
    heading: str,
    labels: Sequence[str],
    values: _Array,
    reference: _Array | None = None,
    *,
    colours: Sequence[str] = (BLUE, VERMILION, GREEN),
    limits: tuple[float, float] | None = None,
    span: float = 0.0,
) -> None:
    """Draw one panel: values (n, k) as lines, references (n, k) dashed, limits thin, states of the mission as bands.

    The height of the panel covers at least ``span``, so that noise does not look like motion.
    """
    time = dataset.time.values
    draw_time_spans(ax, [(time[a], time[b], state_tint(state)) for state, a, b in find_overlapping_state_runs(dataset)])
    for k, (label, colour) in enumerate(zip(labels, colours, strict=False)):
        ax.plot(time, values[:, k], color=colour, label=label, zorder=3)
        if reference is not None:
            dark = [0.55 * part for part in to_rgb(colour)]
            ax.plot(time, reference[:, k], color=dark, lw=1.0, ls=(0, (4, 2)), zorder=4)
    if reference is not None:
        ax.plot([], [], color=BLACK, lw=1.0, ls=(0, (4, 2)), label="reference")
    for limit in limits or ():
        ax.axhline(limit, color=BLACK, lw=0.8, ls=":", zorder=2)
    low, high = ax.get_ylim()
    if high - low < span:
        ax.set_ylim(0.5 * (low + high - span), 0.5 * (low + high + span))
    ax.set_title(heading, pad=4)
    ax.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    if any(labels):
        ax.legend(loc="lower right", bbox_to_anchor=(1.01, 0.975), ncols=5, borderpad=0.1, columnspacing=1.2)


# The track in three dimensions


def _ned_to_enu(ned: ArrayLike) -> _Array:
    """Convert north, east, down to east, north, height."""
    x = np.asarray(ned, dtype=np.float64)
    return np.stack((x[..., 1], x[..., 0], -x[..., 2]), axis=-1)


def draw_track(dataset: xr.Dataset, *, waypoints: Sequence[ArrayLike] = (), world: World | None = None) -> Figure:
    """Draw the track in three dimensions (see :func:`draw_flight_pictures` for the parameters)."""
    figure = Figure(figsize=(8.4, 6.0))
    ax: Any = figure.add_axes((0.0, 0.045, 1.0, 1.02), projection="3d", computed_zorder=False)
    truth = _ned_to_enu(dataset.truth_position.values)
    reference = _ned_to_enu(dataset.reference_position.values)
    marks = _ned_to_enu(np.array([np.asarray(w, dtype=np.float64) for w in waypoints]).reshape(-1, 3))
    solids = _obstacle_faces(world or World())
    _set_equal_axes(ax, np.concatenate((truth, marks, *(np.concatenate(faces) for faces in solids))))
    floor = truth * (1, 1, 0)
    ax.plot(*floor.T, color=TRACK_SHADOW_COLOUR, lw=2.2, solid_capstyle="round", zorder=1)
    for faces in solids:
        edges = OBSTACLE_EDGE_COLOUR if len(faces) < 10 else "none"
        shape = Poly3DCollection(faces, facecolors=OBSTACLE_COLOUR, edgecolors=edges, lw=0.6, alpha=0.6)
        shape.set_zorder(2)
        ax.add_collection3d(shape)
        ax.plot(*np.vstack((faces[-1], faces[-1][:1])).T, color=OBSTACLE_EDGE_COLOUR, lw=0.7, zorder=2)
    posts = np.stack((marks, marks * (1, 1, 0)), axis=1)
    if len(posts):
        ax.add_collection3d(Line3DCollection(posts, colors=GREY, lw=0.8, linestyles=":", zorder=2))
        ax.scatter(*posts[:, 1].T, s=8, color=GREY, depthshade=False, zorder=2)
    ax.plot(*reference.T, color=BLACK, lw=0.9, ls=REFERENCE_DASHES, zorder=3)
    for state, first, last in find_overlapping_state_runs(dataset):
        ax.plot(
            *truth[first : last + 1].T,
            color=state_colour(state),
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
        *state_legend_handles([name for name, _, _ in find_state_runs(dataset)], lines=True),
        Line2D([], [], color=BLACK, lw=0.9, ls=REFERENCE_DASHES, label="reference"),
        Line2D([], [], color=TRACK_SHADOW_COLOUR, lw=2.2, label="shadow"),
        _make_legend_marker("^", ORANGE, "start"),
        _make_legend_marker("s", GREEN, "end"),
    ]
    figure.legend(handles=handles, loc="lower center", ncols=min(len(handles), 9), columnspacing=1.3)
    figure.text(0.02, 0.965, flight_title(dataset), fontsize=10)
    return figure


def _make_legend_marker(shape: str, colour: str, label: str) -> Line2D:
    return Line2D([], [], marker=shape, color=colour, markeredgecolor=BLACK, mew=0.8, ms=7, ls="", label=label)


def _set_equal_axes(ax: Any, points: _Array) -> None:
    """Set equal scales on all three axes, the floor as lower limit, and a plain background."""
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


def _obstacle_faces(world: World) -> list[list[_Array]]:
    """Return the faces of every obstacle, east, north, height."""
    solids = []
    for box in world.boxes:
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        base = 0.5 * np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * box.size[:2]
        outline = base @ np.array([(c, s), (-s, c)]) + box.centre[:2]
        solids.append(_prism_faces(outline, -box.centre[2] - 0.5 * box.size[2], box.size[2]))
    for cylinder in world.cylinders:
        angle = np.linspace(0.0, 2 * np.pi, 33)[:-1]
        circle = cylinder.radius * np.column_stack((np.cos(angle), np.sin(angle))) + cylinder.centre
        solids.append(_prism_faces(circle, cylinder.foot, cylinder.height))
    return solids


def _prism_faces(outline: _Array, foot: float, height: float) -> list[_Array]:
    """Return the faces of a vertical prism over a polygon of corners (north, east), from ``foot`` up by ``height``
    (m).
    """
    flat = outline[:, ::-1]
    low = np.column_stack((flat, np.full(len(flat), foot)))
    top = low + np.array([0.0, 0.0, height])
    sides = [np.array([low[k - 1], low[k], top[k], top[k - 1]]) for k in range(len(flat))]
    return [*sides, top]


# Shared parts of the pictures


def find_overlapping_state_runs(dataset: xr.Dataset) -> list[tuple[str, int, int]]:
    """Return (state, first row, last row) of every run of one state; the last row is also the next run's first row."""
    last = len(dataset.mission_state) - 1
    return [(name, a, min(b, last)) for name, a, b in find_state_runs(dataset)]


def draw_time_spans(ax: Any, spans: Sequence[tuple[float, float, Any]], low: float = 0.0, high: float = 1.0) -> None:
    """Draw time spans as coloured bands between the heights ``low`` and ``high`` (0..1) of a panel."""
    corners = [[(a, low), (a, high), (b, high), (b, low)] for a, b, _ in spans]
    where, colours = ax.get_xaxis_transform(), [c for _, _, c in spans]
    drawn = PolyCollection(corners, facecolors=colours, lw=0, zorder=0, transform=where, antialiased=False)
    ax.add_collection(drawn, autolim=False)


def state_colour(state: str) -> str:
    return STATE_COLOURS.get(state, GREY)


def state_tint(state: str) -> tuple[float, float, float]:
    red, green, blue = (1 - 0.19 * (1 - part) for part in to_rgb(state_colour(state)))
    return red, green, blue


def flight_title(dataset: xr.Dataset) -> str:
    names = [str(dataset.attrs[key]) for key in ("vehicle", "mission", "outcome") if dataset.attrs.get(key)]
    return ", ".join(names)


def state_legend_handles(names: Sequence[str], lines: bool = False) -> list[Any]:
    used = [name for name in STATE_COLOURS if name in names]
    used += [name for name in dict.fromkeys(names) if name not in STATE_COLOURS]
    if lines:
        return [Line2D([], [], color=state_colour(name), lw=2.4, label=name) for name in used]
    return [Patch(color=state_tint(name), label=name) for name in used]
