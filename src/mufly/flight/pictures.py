"""Pictures of a flight: the track in three dimensions and the histories over time.

``track``: see :mod:`mufly.flight.picture_track`. ``history``: everything a flight is judged by, over time, with
references (dashed) and the mission's states as background bands. ``position``: north, east and height large, with
the tracking error. Angles are in degrees; colours are told apart by the colour-blind as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from mufly.flight.picture_parts import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    STATE_COLOURS,
    STYLE,
    VERMILION,
    runs,
    state_handles,
    tint,
    title,
)
from mufly.flight.picture_track import draw_track
from mufly.world import World

__all__ = ["STATE_COLOURS", "draw_flight", "draw_history", "draw_position", "draw_track"]

_Array = NDArray[np.float64]


def draw_flight(
    dataset: xr.Dataset,
    folder: str | Path,
    *,
    waypoints: Sequence[ArrayLike] = (),
    world: World | None = None,
    formats: Sequence[str] = ("png",),
    dpi: int = 130,
) -> list[Path]:
    """Draw all pictures of a flight into a folder.

    Parameters
    ----------
    dataset : xarray.Dataset
        A recording.
    folder : str or Path
        Made if it is not there.
    waypoints : sequence of (3,)
        N, E, D (m), numbered in this order.
    world : World, optional
        Its boxes and cylinders are drawn.
    formats : sequence of str
        ``"png"``, ``"svg"``, ``"pdf"``.
    dpi : int
        Resolution of the PNG.

    Returns
    -------
    list of Path
        ``track``, ``history``, ``position`` in each format. The same flight gives the same bytes.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    paths = []
    with mpl.rc_context(STYLE):
        for name, figure in (
            ("track", draw_track(dataset, waypoints=waypoints, world=world)),
            ("history", draw_history(dataset)),
            ("position", draw_position(dataset)),
        ):
            for kind in formats:
                paths.append(target / f"{name}.{kind}")
                unstamped = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
                figure.savefig(paths[-1], dpi=dpi, metadata=unstamped)
    return paths


def draw_history(dataset: xr.Dataset) -> Figure:
    """Position, velocity, attitude, rates, rotor speeds, inputs and battery over time."""
    figure = Figure(figsize=(12.0, 11.4))
    panels: Any = figure.subplots(5, 2, sharex=True)
    figure.subplots_adjust(left=0.06, right=0.985, top=0.925, bottom=0.05, hspace=0.27, wspace=0.15)
    deg, up = 180.0 / np.pi, np.array([1.0, 1.0, -1.0])
    data = {name: values.values for name, values in dataset.items()}
    axes, colours = ("north", "east", "height"), (BLUE, VERMILION, GREEN)
    p = panels.ravel()
    _lines(
        p[0],
        dataset,
        "Position (m)",
        axes,
        colours,
        data["truth_position"] * up,
        data["reference_position"] * up,
    )
    _lines(
        p[1],
        dataset,
        "Velocity (m/s)",
        axes,
        colours,
        data["truth_velocity"] * up,
        data["reference_velocity"] * up,
    )
    angles, wanted = data["truth_attitude"] * deg, data["reference_attitude"] * deg
    _lines(
        p[2],
        dataset,
        "Roll and pitch (deg)",
        ("roll", "pitch"),
        colours,
        angles[:, :2],
        wanted[:, :2],
        span=4.0,
    )
    _lines(p[3], dataset, "Heading (deg)", ("heading",), (BLUE,), angles[:, 2:], wanted[:, 2:], span=10.0)
    rates = data["truth_rates"] * deg
    _lines(p[4], dataset, "Roll and pitch rate (deg/s)", ("p", "q"), colours, rates[:, :2], span=20.0)
    _lines(p[5], dataset, "Yaw rate (deg/s)", ("r",), (BLUE,), rates[:, 2:], span=20.0)
    rotors = ("upper", "lower")
    _lines(p[6], dataset, "Rotor speed (rad/s)", rotors, colours, data["truth_rotor_speed"])
    _lines(p[7], dataset, "Motor input (0 to 1)", rotors, colours, data["motor_input"], limits=(0.0, 1.0))
    servos = ("1, pitch", "2, roll")
    _lines(p[8], dataset, "Servo input (-1 to 1)", servos, colours, data["servo_input"], limits=(-1.0, 1.0))
    _lines(
        p[9],
        dataset,
        "Battery voltage (V)",
        ("voltage",),
        (BLUE,),
        data["battery_voltage"][:, None],
        span=0.5,
    )
    for ax in p[8:]:
        ax.set_xlabel("Time (s)")
    _header(figure, dataset, 0.985)
    return figure


def draw_position(dataset: xr.Dataset) -> Figure:
    """North, east and height over time with their references, and the distance from the reference."""
    figure = Figure(figsize=(9.0, 8.4))
    panels: Any = figure.subplots(4, 1, sharex=True)
    figure.subplots_adjust(left=0.085, right=0.98, top=0.905, bottom=0.06, hspace=0.24)
    up = np.array([1.0, 1.0, -1.0])
    truth, reference = dataset.truth_position.values * up, dataset.reference_position.values * up
    measured = dataset.measured_position.values * up
    for k, name in enumerate(("North", "East", "Height")):
        ax = panels[k]
        ax.plot(dataset.time, measured[:, k], color=GREY, lw=0.8, alpha=0.8, label="measured")
        _lines(ax, dataset, f"{name} (m)", ("true",), (BLUE,), truth[:, k : k + 1], reference[:, k : k + 1])
    error = 100.0 * np.linalg.norm(truth - reference, axis=1)[:, None]
    _lines(panels[3], dataset, "Distance from the reference (cm)", ("",), (VERMILION,), error)
    panels[3].set_ylim(bottom=0.0)
    panels[3].set_xlabel("Time (s)")
    _header(figure, dataset, 0.985)
    return figure


def _header(figure: Figure, dataset: xr.Dataset, top: float) -> None:
    handles = state_handles([name for name, _, _ in runs(dataset)])
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.99, top), ncols=len(handles))
    figure.text(0.02, top - 0.005, title(dataset), fontsize=10, va="top")


def _lines(
    ax: Axes,
    dataset: xr.Dataset,
    heading: str,
    labels: Sequence[str],
    colours: Sequence[str],
    values: _Array,
    reference: _Array | None = None,
    limits: tuple[float, float] | None = None,
    span: float = 0.0,
) -> None:
    """One panel: values (n, k), dashed references (n, k), limits as thin lines, states as bands.

    The height of the panel covers at least ``span``, so that noise does not look like motion.
    """
    time = dataset.time.values
    for state, first, last in runs(dataset):
        ax.axvspan(time[first], time[last], color=tint(state), lw=0, zorder=0)
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
