"""Pictures of a log: signals over time, each on its own clock, and their spectra.

Signals of one kind share a picture, their components a panel each, so that reference, measurement and truth of one
component lie on each other. Angles are drawn in degrees. Colours are those of Okabe and Ito (2008), which the
colour-blind can tell apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, welch

from mufly.errors import InputError
from mufly.logs.clock import GAP_FACTOR
from mufly.logs.quality import Channel
from mufly.logs.resample import resample
from mufly.logs.signals import is_held

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_channels", "grouped", "spectrum"]

_Array = NDArray[np.float64]
_STYLE: Any = {
    "font.size": 9.0, "axes.titlesize": 10.0, "axes.titlelocation": "left", "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True, "grid.alpha": 0.35, "grid.linewidth": 0.5,
    "lines.linewidth": 1.1, "legend.frameon": False, "legend.fontsize": 8.0, "svg.fonttype": "none",
    "svg.hashsalt": "mufly",
}  # fmt: skip
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222", "#8c8c8c")
_LOOK = {
    "truth": ("#222222", "-"), "measured": ("#0072B2", "-"), "estimated": ("#009E73", "-"),
    "reference": ("#D55E00", "--"),
}  # fmt: skip
_WORDS = {"truth": "true"}
_DEGREES = {"rad": ("deg", 180 / math.pi), "rad/s": ("deg/s", 180 / math.pi)}
# More points than a picture has columns are drawn as the extremes of each column.
_COLUMNS = 3000
_ORDER = ("attitude", "rates", "position", "velocity", "acceleration", "rotor_speed", "inputs", "battery")
_INPUTS = ("motor_input", "servo_input", "actuator_control", "actuator_output", "pilot_input")


def _kind(name: str) -> str:
    """The picture that a channel belongs to."""
    if "/" in name:
        return name.rpartition("/")[0].strip("/").replace("/", "_")
    variable = name.partition(".")[0]
    prefix, _, rest = variable.partition("_")
    if prefix in _LOOK and rest:
        return rest
    if variable in _INPUTS:
        return "inputs"
    return "battery" if prefix == "battery" else "others" if "." not in name else variable


def grouped(channels: Sequence[Channel]) -> dict[str, list[Channel]]:
    """Sort channels into pictures: ``{"attitude": [...], "inputs": [...], ...}``, in a fixed order."""
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(_kind(channel.name), []).append(channel)
    rank = {k: i for i, k in enumerate(_ORDER)}
    return dict(sorted(groups.items(), key=lambda g: rank.get(g[0], len(_ORDER))))


def _panels(channels: Sequence[Channel]) -> dict[tuple[str, str], list[Channel]]:
    """Panels of a picture: one a component for signals that lie on each other, one a variable or unit otherwise."""
    panels: dict[tuple[str, str], list[Channel]] = {}
    for c in channels:
        variable, _, label = c.name.partition(".")
        unit = "" if c.units == "1" else c.units
        if "/" in c.name:
            key = (c.name.rpartition("/")[2].partition("[")[0].partition(".")[0], unit)
        elif variable.partition("_")[0] in _LOOK and label:
            key = (label, unit)
        else:
            key = (variable.replace("_", " "), unit)
        panels.setdefault(key, []).append(c)
    return panels


def spectrum(time: _Array, values: _Array) -> tuple[_Array, _Array]:
    """Return frequencies (Hz) and power spectral density (unit^2/Hz) of a channel.

    Welch's method with Hann windows of a quarter of the record at most, on the channel's median step; short gaps
    are bridged linearly, and of longer ones the longest stretch between them is taken.

    Raises
    ------
    InputError
        If fewer than 32 samples are left.
    """
    known = np.isfinite(values)
    t, x = time[known], values[known]
    if len(t) >= 32:
        step = float(np.median(np.diff(t)))
        edges = np.concatenate(([0], np.flatnonzero(np.diff(t) > 10 * GAP_FACTOR * step) + 1, [len(t)]))
        k = int(np.diff(edges).argmax())
        t, x = t[edges[k] : edges[k + 1]], x[edges[k] : edges[k + 1]]
    if len(t) < 32:
        raise InputError("spectrum", "", f"{len(t)} samples", "choose a longer part (at least 32 samples)")
    even = np.arange(t[0], t[-1], step)
    on_grid = resample(t, x, even, gap_s=np.inf)
    segment = max(32, min(len(even), 2 ** int(np.log2(max(len(even) / 4, 32)))))
    frequency, density = welch(detrend(on_grid), fs=1 / step, nperseg=segment, detrend="constant")
    return frequency[1:], density[1:]


def _thinned(time: _Array, values: _Array) -> tuple[_Array, _Array]:
    """Points to draw: gaps opened by a NaN, and the extremes of each column where there are too many."""
    known = np.isfinite(time)
    t, x = time[known], values[known]
    if len(t) > 2 * _COLUMNS:
        parts = np.linspace(0, len(t), _COLUMNS + 1).astype(int)[:-1]
        low = np.minimum.reduceat(np.where(np.isnan(x), np.inf, x), parts)
        high = np.maximum.reduceat(np.where(np.isnan(x), -np.inf, x), parts)
        empty = ~np.isfinite(low)
        pair = np.column_stack((low, high))
        pair[empty] = np.nan
        return np.repeat(t[parts], 2), pair.ravel()
    if len(t) > 2:
        steps = np.diff(t)
        wide = np.flatnonzero(steps > GAP_FACTOR * np.median(steps)) + 1
        t, x = np.insert(t, wide, t[wide - 1]), np.insert(x, wide, np.nan)
    return t, x


def draw_channels(channels: Sequence[Channel], *, title: str = "", spectra: bool = False) -> Figure:
    """Draw channels of one kind, over time or as spectra.

    Parameters
    ----------
    channels : sequence of Channel
        One of the groups of :func:`grouped`.
    title : str
    spectra : bool
        Power spectral densities instead of time histories; channels that are too short for one are left out.

    Raises
    ------
    InputError
        If spectra are wanted and no channel is long enough.
    """
    import matplotlib
    from matplotlib.figure import Figure

    panels = _panels(channels)
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(8.5, 0.7 + 1.75 * len(panels)), layout="constrained")
        axes = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
        drawn, above = 0, [""]
        for ax, ((name, unit), members) in zip(axes, panels.items(), strict=True):
            shown, scale = _DEGREES.get(unit, (unit, 1.0))
            several = len({c.name.partition(".")[0] for c in members}) > 1 or len(members) == 1
            for k, c in enumerate(members):
                colour, dash = _look(c, k, several)
                if spectra:
                    try:
                        x, y = spectrum(c.time, c.values * scale)
                    except InputError:
                        continue
                    keep = y > 0
                    if not keep.any():
                        continue
                    ax.loglog(x[keep], y[keep], dash, color=colour, label=_label(c))
                else:
                    t, y = _thinned(c.time, c.values * scale)
                    style = "steps-post" if is_held(c.name) and len(t) <= 2 * _COLUMNS else "default"
                    ax.plot(t, y, dash, color=colour, label=_label(c), drawstyle=style)
                drawn += 1
            text = name[:1].upper() + name[1:] if len(name) > 1 else name
            density = f"(({shown})²/Hz)" if "/" in shown else f"({shown}²/Hz)" if shown else "(1/Hz)"
            inner = density if spectra else f"({shown})" if shown else ""
            ax.set_ylabel(f"{text}\n{inner}".rstrip())
            labels = [_label(c) for c in members]
            named = len(labels) == 1 and labels[0].lower() == name.lower()
            if labels != above and not named:  # what holds for every panel is said once
                _legend(ax)
            above = labels
        if spectra and not drawn:
            raise InputError("--spectrum", "", "no channel is long enough", "choose a longer part")
        axes[-1].set_xlabel("Frequency (Hz)" if spectra else "Time (s)")
        axes[0].set_title(title)
    return figure


def _look(channel: Channel, number: int, overlay: bool) -> tuple[str, str]:
    prefix = channel.name.partition("_")[0]
    if overlay and prefix in _LOOK and "/" not in channel.name:
        return _LOOK[prefix]
    return _COLOURS[number % len(_COLOURS)], "-" if number < len(_COLOURS) else "--"


def _label(channel: Channel) -> str:
    if "/" in channel.name:
        return channel.name.rpartition("/")[2]
    variable, _, label = channel.name.partition(".")
    prefix = variable.partition("_")[0]
    if prefix in _LOOK:
        return _WORDS.get(prefix, prefix)
    return label or variable.replace("_", " ")


def _legend(ax: Axes) -> None:
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        ax.legend(handles, labels, loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
