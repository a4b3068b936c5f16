"""Two recordings in one plot: their clocks aligned by an event that both have, the second at the instants of the first.

Recordings of different flights begin at different times, run at different rates and hold different signals. A
:class:`Comparison` shifts the clock of the second so that take-off (or arming, or the start) coincides, interpolates it
onto the instants of the first, across no gap, and takes another source of a quantity where the second has not the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError
from mufly.quantities import quantity_named
from mufly.station.replay import SOURCES, Recording
from mufly.units import factor_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Array = NDArray[np.float64]

ALIGNMENTS = ("take-off", "arming", "start", "clock")
"""By what two recordings are aligned; "clock": their times as they stand."""
PREFIX = "compared/"
"""Of the names of signals of the second recording, among those of the first."""
LEFT_M = 0.1
"""How far above where it stood a vehicle has taken off (m)."""
GAP_S = 0.5
"""Samples that are farther apart are not connected, unless the signal is slower (s)."""
_DEFAULT = ("position", "velocity", "attitude", "rotor_speed", "motor_input", "battery_voltage")


def event_time(recording: Recording, by: str) -> float:
    """Return when a recording took off, was armed or began (s of its clock); NaN if it does not show it."""
    columns, times = recording.columns, recording.times
    if by in ("start", "clock"):
        return float(times[0]) if by == "start" else 0.0
    if by == "arming":
        motors = [c for name, c in columns.items() if name.startswith("motor_input")]
        turning = np.any([np.nan_to_num(c) > 0.0 for c in motors], axis=0) if motors else np.zeros(1, bool)
    else:
        down = next(
            (c for s in SOURCES if np.isfinite(c := _column(recording, f"{s}_position_D")).any()), None
        )
        if down is None:
            return math.nan
        turning = down < down[np.isfinite(down)][0] - LEFT_M
    return float(times[np.argmax(turning)]) if turning.any() else math.nan


def _column(recording: Recording, name: str) -> _Array:
    return recording.columns.get(name, np.full(len(recording.times), math.nan))


@dataclass(frozen=True)
class Comparison:
    """A second recording on the clock of a first.

    Attributes
    ----------
    first, second : Recording
    by : str
        One of :data:`ALIGNMENTS`.
    offset_s : float
        By how much the second is moved later beyond that (s).

    Examples
    --------
    >>> import numpy as np
    >>> from mufly.station.replay import Recording
    >>> def hop(start_s):
    ...     t = start_s + np.arange(0.0, 3.0, 0.1)
    ...     down = {"truth_position_D": np.where(t - start_s < 1.0, 0.0, -1.0)}
    ...     return Recording("hop", t, down, {}, np.full(30, ""), (), None, np.zeros(0), 1.0, {})
    >>> round(Comparison(hop(0.0), hop(100.0)).shift_s, 6)
    -100.0
    """

    first: Recording
    second: Recording
    by: str = "take-off"
    offset_s: float = 0.0

    def __post_init__(self) -> None:
        if self.by not in ALIGNMENTS:
            raise ArgumentError("align", self.by, "is no event", f"use {', '.join(ALIGNMENTS)}")
        if not math.isfinite(self.offset_s):
            raise ArgumentError("offset", f"{self.offset_s:g}", "is no time", "give seconds")

    @cached_property
    def _events(self) -> tuple[float, str]:
        times = [event_time(r, self.by) for r in (self.first, self.second)]
        if all(map(math.isfinite, times)):
            return times[0] - times[1], ""
        without = " and ".join(
            r.name for r, t in zip((self.first, self.second), times, strict=True) if t != t
        )
        starts = [event_time(r, "start") for r in (self.first, self.second)]
        return starts[0] - starts[1], f"no {self.by} in {without}: aligned by the start"

    @property
    def shift_s(self) -> float:
        """What is added to the times of the second (s)."""
        return self._events[0] + self.offset_s

    @property
    def note(self) -> str:
        """Why it is aligned otherwise than asked, "" if it is not."""
        return self._events[1]

    def source_of(self, name: str) -> str:
        """Return the signal of the second beside ``name`` of the first: the same, or of another source; "" if none."""
        if np.isfinite(_column(self.second, name)).any():
            return name
        source, _, rest = name.partition("_")
        others = [f"{s}_{rest}" for s in SOURCES] if source in SOURCES else []
        return next((n for n in others if np.isfinite(_column(self.second, n)).any()), "")

    def sampled(self, name: str, times: _Array) -> _Array:
        """Return a signal of the second at times (n,; s) of the first; NaN beyond its ends and in its gaps."""
        own = self.source_of(name)
        out = np.full(len(times), math.nan)
        if not own or not len(times):
            return out
        values = _column(self.second, own)
        known = np.isfinite(values)
        t, v = self.second.times[known] + self.shift_s, values[known]
        if self.second.units.get(own) == "rad":
            v = np.unwrap(v)
        at = np.clip(np.searchsorted(t, times), 1, max(len(t) - 1, 1))
        inside = (times >= t[0]) & (times <= t[-1])
        if len(t) > 1:
            steps = np.diff(t)
            near = steps[at - 1] <= max(GAP_S, 2.5 * float(np.median(steps)))
            out[inside & near] = np.interp(times[inside & near], t, v)
        elif len(t):
            out[np.abs(times - t[0]) < 1e-6] = v[0]
        return out

    def difference(self, name: str) -> _Array:
        """Return the first less the second (n,) at the instants of the first; angles within half a turn."""
        off = _column(self.first, name) - self.sampled(name, self.first.times)
        if self.first.units.get(name) == "rad":
            off = np.arctan2(np.sin(off), np.cos(off))
        return np.asarray(off)

    def track(self) -> _Array:
        """Return where the second was (n, 3; N, E, D, m); NaN where it does not say."""
        names = [f"estimated_position_{axis}" for axis in "NED"]
        found = [_column(self.second, self.source_of(name) or name) for name in names]
        return np.column_stack(found)


def compared_signals(c: Comparison, chosen: Sequence[str] = ()) -> dict[str, list[str]]:
    """Return ``{quantity: [names]}`` of the first that both recordings have, of its most believed source.

    Parameters
    ----------
    c : Comparison
    chosen : sequence of str
        Quantities (``attitude``), or signals (``measured_attitude``, ``measured_attitude_roll``); none: the usual ones.

    Raises
    ------
    ArgumentError
        If nothing of what was chosen is in both.
    """
    out: dict[str, list[str]] = {}
    for wanted in chosen or _DEFAULT:
        wanted = wanted.replace(".", "_")
        tried = (
            [wanted] if wanted.partition("_")[0] in SOURCES else [f"{s}_{wanted}" for s in SOURCES] + [wanted]
        )
        for variable in tried:
            known = quantity_named(variable)
            names = (
                [f"{variable}_{label}" for label in known.labels] if known and known.labels else [variable]
            )
            both = [n for n in names if np.isfinite(_column(c.first, n)).any() and c.source_of(n)]
            if both:
                out[wanted] = both
                break
        else:
            if chosen:
                held = ", ".join(sorted({n.rpartition("_")[0] for n in c.first.columns})[:12])
                raise ArgumentError("signal", wanted, "is not in both recordings", f"the first has {held}")
    if not out:
        raise ArgumentError("signal", "", "the recordings have nothing in common", "name a signal of both")
    return out


def draw_comparison(c: Comparison, names: Sequence[str], title: str = "") -> Figure:
    """Draw signals of both recordings in one axis each, the first solid, the second dashed, over the first's time.

    Parameters
    ----------
    c : Comparison
    names : sequence of str
        Of the first; :func:`compared_signals` gives them.
    title : str
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 1.0 + 1.75 * len(names)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    t = c.first.times
    for ax, name in zip(axes, names, strict=True):
        unit, shown, factor = _shown_unit(c, name)
        one, two = _column(c.first, name), c.sampled(name, t)
        if unit == "rad":
            one, two = _together(one, two)
        ax.plot(t, factor * one, "-", color="#1769a5", label=c.first.name)
        other = c.source_of(name)
        ax.plot(
            t,
            factor * two,
            "--",
            color="#b85c00",
            label=c.second.name + ("" if other == name else f" ({other})"),
        )
        ax.set_ylabel(name.replace("_", " ") + ("" if shown == "1" else f"\n({shown})"))
        ax.grid(alpha=0.3)
    labels = axes[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper center", ncols=2, frameon=False)
    axes[-1].set_xlabel(f"Time of {c.first.name} (s)")
    if title:
        axes[0].set_title(title)
    return figure


def _shown_unit(c: Comparison, name: str) -> tuple[str, str, float]:
    """SI unit of a signal, the one that a person reads, and what to multiply by."""
    unit = c.first.units.get(name, "1")
    shown = "rpm" if "rotor_speed" in name else {"rad": "deg", "rad/s": "deg/s"}.get(unit, unit)
    return unit, shown, factor_of(unit, shown) if shown != unit else 1.0


def _together(one: _Array, two: _Array) -> tuple[_Array, _Array]:
    """Angles without jumps, the second in the turn of the first."""
    known = np.isfinite(one)
    one = one.copy()
    one[known] = np.unwrap(one[known])
    both = np.isfinite(one) & np.isfinite(two)
    turns = np.round(np.median((one - two)[both]) / (2.0 * math.pi)) if both.any() else 0.0
    return one, two + 2.0 * math.pi * turns


def difference_rows(c: Comparison, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return by how much they differ: ``signal``, ``units``, ``rms``, ``largest``, ``at_s`` of the first's clock."""
    out = []
    for name in names:
        off = c.difference(name)
        known = np.isfinite(off)
        if not known.any():
            continue
        k = int(np.nanargmax(np.abs(off)))
        _, shown, factor = _shown_unit(c, name)
        rms = float(np.sqrt(np.mean(off[known] ** 2)))
        out.append(
            {"signal": name, "units": shown, "rms": factor * rms, "largest": factor * float(off[k]),
             "at_s": float(c.first.times[k])}
        )  # fmt: skip
    return out
