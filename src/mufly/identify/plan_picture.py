"""Picture of a plan: the signal, its spectrum beside the vehicle's modes, the flight it leads to, what it will tell."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.identify.excitation import spectrum
from mufly.identify.plan import Candidate, Plan
from mufly.identify.simulate import OUTPUT_UNITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["plan_picture"]

Array = NDArray[np.float64]

_COLOURS = {"chirp": "#0072B2", "multisine": "#009E73", "3211": "#D55E00", "doublet": "#CC79A7"}
_INPUTS = ("motor upper", "motor lower", "servo 1", "servo 2")
_SHOWN = {
    "yaw": ("yaw", "r", "height"), "heave": ("height", "yaw"), "roll": ("roll", "pitch", "p"),
    "pitch": ("pitch", "roll", "q"),
}  # fmt: skip
_LINES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
_WORST = 1e3  # per cent; bars of what is not seen end there


def plan_picture(plan: Plan, chosen: Candidate | None = None) -> Figure:
    """Draw a plan.

    Parameters
    ----------
    plan : Plan
    chosen : Candidate, optional
        The signal that is to be flown; the best by default.
    """
    from matplotlib.figure import Figure

    c = plan.best if chosen is None else chosen
    figure = Figure(figsize=(10.5, 7.6), layout="constrained")
    axes = figure.subplots(2, 2)
    _signal(axes[0, 0], c)
    _spectra(axes[0, 1], plan)
    _flight(axes[1, 0], plan, c)
    _accuracy(axes[1, 1], plan)
    figure.suptitle(
        f"{plan.vehicle}, {plan.channel}: {c.signal.kind}, {c.signal.words}; amplitude {100 * c.amplitude:.1f} % of "
        f"the input's range ({c.bound_by})",
        fontsize="medium",
    )
    return figure


def _signal(ax: Axes, c: Candidate) -> None:
    moved = np.flatnonzero(np.any(c.added != 0, axis=0))
    for line, k in zip(_LINES, moved, strict=False):
        ax.step(
            c.signal.time_s,
            c.added[:, k],
            where="post",
            color=line,
            linewidth=1.2,
            label=f"added to {_INPUTS[k]}",
        )
    for line, k in zip(_LINES, moved, strict=False):
        about = c.record.inputs[:, k] - c.record.inputs[0, k]
        ax.step(
            c.signal.time_s, about, where="post", color=line, linewidth=0.8, alpha=0.5, linestyle="--",
            label=f"{_INPUTS[k]} as flown, less hover",
        )  # fmt: skip
    ax.set_xlabel("Time (s)")
    ax.set_ylabel("Input (share of range)")
    ax.legend(fontsize="x-small", loc="upper left", ncols=2)
    ax.margins(y=0.25)
    ax.grid(alpha=0.3)


def _spectra(ax: Axes, plan: Plan) -> None:
    top = 0.0
    for c in plan.candidates:
        frequency, amplitude = spectrum(c.amplitude * c.signal.value, float(c.signal.time_s[1]))
        inside = (frequency > 0) & (frequency < 4 * plan.band_rad_s[1] / (2 * math.pi))
        ax.plot(
            frequency[inside], amplitude[inside], color=_COLOURS[c.signal.kind], linewidth=1.2, label=c.signal.kind,
            marker="." if c.signal.kind == "multisine" else None, markersize=3,
        )  # fmt: skip
        top = max(top, float(amplitude[inside].max()))
    low, high = (w / (2 * math.pi) for w in plan.band_rad_s)
    ax.axvspan(low, high, color="0.5", alpha=0.1, linewidth=0, label="band")
    for k, mode in enumerate(plan.modes_rad_s):
        ax.axvline(
            mode / (2 * math.pi),
            color="0.3",
            linestyle=":",
            linewidth=1,
            label=None if k else "modes of the channel",
        )
    ax.set_xscale("log")
    ax.set_ylim(0, 1.1 * top)
    ax.set_xlabel("Frequency (Hz)")
    ax.set_ylabel("Amplitude (share of range)")
    ax.legend(fontsize="x-small")
    ax.grid(alpha=0.3, which="both")


def _flight(ax: Axes, plan: Plan, c: Candidate) -> None:
    shown = [o for o in _SHOWN[plan.channel] if o in c.record.outputs]
    labels = []
    for line, name in zip(_LINES, shown, strict=False):
        unit, factor = OUTPUT_UNITS[name], 1.0
        if unit.startswith("rad"):
            unit, factor = unit.replace("rad", "deg"), math.degrees(1.0)
        if unit == "m":
            unit, factor = "cm", 100.0
        y = c.record.measured[:, c.record.outputs.index(name)]
        y = factor * (y - y[0])
        noise = factor * plan.noise[name]
        ax.plot(c.signal.time_s, y, color=line, linewidth=1.2, label=f"{name} ({unit})")
        ax.fill_between(c.signal.time_s, y - noise, y + noise, color=line, alpha=0.2, linewidth=0)
        labels.append(unit)
    ax.set_xlabel("Time (s)")
    ax.set_ylabel(f"Expected change ({', '.join(dict.fromkeys(labels))})")
    ax.legend(fontsize="x-small", loc="upper left", title="band: noise", title_fontsize="x-small")
    ax.grid(alpha=0.3)


def _accuracy(ax: Axes, plan: Plan) -> None:
    symbols = [f.symbol for f in plan.free]
    at, width = np.arange(len(symbols)), 0.8 / len(plan.candidates)
    for k, c in enumerate(plan.candidates):
        value = np.minimum(100 * c.relative_std, _WORST)
        ax.bar(
            at + (k - 0.5 * (len(plan.candidates) - 1)) * width, value, width=0.9 * width,
            color=_COLOURS[c.signal.kind], label=f"{c.signal.kind}, {100 * c.amplitude:.1f} %",
        )  # fmt: skip
    ax.axhline(50, color="0.3", linestyle=":", linewidth=1)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(lambda x, _: f"{x:g}" if f"{x:e}"[0] in "25" else "")
    ax.set_xticks(at, symbols, rotation=30 if len(symbols) > 6 else 0)
    ax.set_xlabel("Parameter (above the dotted line: hardly seen)")
    ax.set_ylabel("Expected standard deviation (% of value)")
    ax.legend(fontsize="x-small", title="kind, amplitude", title_fontsize="x-small")
    ax.grid(alpha=0.3, axis="y")
