"""What the pictures of a flight share: colours, style, and the stretches of the mission's states.

The colours are those of Okabe and Ito (2008, "Color universal design"), which the colour-blind can tell apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.colors import to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

__all__ = [
    "BLACK",
    "BLUE",
    "GREEN",
    "GREY",
    "ORANGE",
    "STATE_COLOURS",
    "STYLE",
    "VERMILION",
    "colour",
    "runs",
    "state_handles",
    "tint",
    "title",
]

BLACK, GREY = "#222222", "#8c8c8c"
BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#56B4E9",
)
STATE_COLOURS = {
    "init": GREY,
    "take-off": ORANGE,
    "hover": SKY,
    "waypoint": BLUE,
    "obstacle": VERMILION,
    "landing": GREEN,
    "rc": PURPLE,
}
"""Colour of each state of the mission (any other state is drawn like ``init``)."""

STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
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


def runs(dataset: xr.Dataset) -> list[tuple[str, int, int]]:
    """(state, first, last) of every stretch of one state; ``last`` belongs to the next stretch too."""
    states = dataset.mission_state.values
    edges = [0, *(np.flatnonzero(states[1:] != states[:-1]) + 1), len(states) - 1]
    names = [str(states[a]).lower().replace("_", "-") for a in edges[:-1]]
    return [(name, int(a), int(b)) for name, (a, b) in zip(names, pairwise(edges), strict=True)]


def colour(state: str) -> str:
    return STATE_COLOURS.get(state, GREY)


def tint(state: str) -> tuple[float, float, float]:
    red, green, blue = (1 - 0.19 * (1 - part) for part in to_rgb(colour(state)))
    return red, green, blue


def title(dataset: xr.Dataset) -> str:
    names = [str(dataset.attrs[key]) for key in ("vehicle", "mission", "outcome") if dataset.attrs.get(key)]
    return ", ".join(names)


def state_handles(names: Sequence[str], lines: bool = False) -> list[Any]:
    used = [name for name in STATE_COLOURS if name in names]
    used += [name for name in dict.fromkeys(names) if name not in STATE_COLOURS]
    if lines:
        return [Line2D([], [], color=colour(name), lw=2.4, label=name) for name in used]
    return [Patch(color=tint(name), label=name) for name in used]
