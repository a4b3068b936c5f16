"""Comparison of two recordings in one plot, with aligned clocks and a common time axis.

Recordings of different flights differ in start time, rate and signals. A :class:`RecordingComparison` shifts the clock
of the second recording so that take-off, arming or the start coincides. It interpolates the second recording onto the
instants of the first, but not across gaps. A quantity missing in the second is taken from another of its sources.
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
from mufly.quantities.quantity_table import find_quantity
from mufly.quantities.units import find_conversion_factor
from mufly.results import ShownTable, make_table_block
from mufly.station.replay import MOTION_SOURCES, FlightRecording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_Array = NDArray[np.float64]

ALIGNMENT_EVENTS = ("take-off", "arming", "start", "clock")
"""Events that align two recordings; "clock": no alignment."""
COMPARED_PREFIX = "compared/"
"""Prefix of the second recording's signals among those of the first."""
MIN_TAKEN_OFF_HEIGHT_M = 0.1
"""Height above the start position that counts as taken off (m)."""
MAX_INTERPOLATED_GAP_S = 0.5
"""Largest gap between samples that is interpolated, except for slower signals (s)."""
_DEFAULT_QUANTITIES = ("position", "velocity", "attitude", "rotor_speed", "motor_input", "battery_voltage")


def find_event_time(recording: FlightRecording, by: str) -> float:
    """Return the time of take-off, arming or start of a recording (s of its clock); NaN if the event is absent."""
    columns, times = recording.columns, recording.times_s
    if by in ("start", "clock"):
        return float(times[0]) if by == "start" else 0.0
    if by == "arming":
        motors = [c for name, c in columns.items() if name.startswith("motor_input")]
        turning = np.any([np.nan_to_num(c) > 0.0 for c in motors], axis=0) if motors else np.zeros(1, bool)
    else:
        down = next(
            (c for s in MOTION_SOURCES if np.isfinite(c := _find_column(recording, f"{s}_position_D")).any()),
            None,
        )
        if down is None:
            return math.nan
        turning = down < down[np.isfinite(down)][0] - MIN_TAKEN_OFF_HEIGHT_M
    return float(times[np.argmax(turning)]) if turning.any() else math.nan


def _find_column(recording: FlightRecording, name: str) -> _Array:
    return recording.columns.get(name, np.full(len(recording.times_s), math.nan))


@dataclass(frozen=True)
class RecordingComparison:
    """Two recordings, the second on the clock of the first.

    Attributes
    ----------
    first_recording, second_recording : FlightRecording
    alignment_event : str
        One of :data:`ALIGNMENT_EVENTS`.
    manual_offset_s : float
        Additional delay of the second recording (s).

    Examples
    --------
    >>> import numpy as np
    >>> from mufly.station.replay import FlightRecording
    >>> def hop(start_s):
    ...     t = start_s + np.arange(0.0, 3.0, 0.1)
    ...     down = {"truth_position_D": np.where(t - start_s < 1.0, 0.0, -1.0)}
    ...     return FlightRecording("hop", t, down, {}, np.full(30, ""), (), None, np.zeros(0), 1.0, {})
    >>> round(RecordingComparison(hop(0.0), hop(100.0)).total_shift_s, 6)
    -100.0
    """

    first_recording: FlightRecording
    second_recording: FlightRecording
    alignment_event: str = "take-off"
    manual_offset_s: float = 0.0

    def __post_init__(self) -> None:
        if self.alignment_event not in ALIGNMENT_EVENTS:
            raise ArgumentError(
                "align", self.alignment_event, "is not an event for the alignment", f"use {', '.join(ALIGNMENT_EVENTS)}"
            )
        if not math.isfinite(self.manual_offset_s):
            raise ArgumentError("offset", f"{self.manual_offset_s:g}", "is not a time", "give seconds")

    @cached_property
    def _shift_and_note(self) -> tuple[float, str]:
        times = [find_event_time(r, self.alignment_event) for r in (self.first_recording, self.second_recording)]
        if all(map(math.isfinite, times)):
            return times[0] - times[1], ""
        without = " and ".join(
            r.name for r, t in zip((self.first_recording, self.second_recording), times, strict=True) if t != t
        )
        starts = [find_event_time(r, "start") for r in (self.first_recording, self.second_recording)]
        return starts[0] - starts[1], f"no {self.alignment_event} in {without}: aligned by the start"

    @property
    def total_shift_s(self) -> float:
        """Return the shift added to the second recording's times (s)."""
        return self._shift_and_note[0] + self.manual_offset_s

    @property
    def alignment_note(self) -> str:
        """Return the reason for an alignment other than requested; "" if as requested."""
        return self._shift_and_note[1]

    def find_counterpart(self, name: str) -> str:
        """Return the name of the second recording's signal that corresponds to one of the first; "" if there is none.

        It may come from another source.
        """
        if np.isfinite(_find_column(self.second_recording, name)).any():
            return name
        source, _, rest = name.partition("_")
        others = [f"{s}_{rest}" for s in MOTION_SOURCES] if source in MOTION_SOURCES else []
        return next((n for n in others if np.isfinite(_find_column(self.second_recording, n)).any()), "")

    def sample_second_recording(self, name: str, times: _Array) -> _Array:
        """Return a signal of the second recording at times (n,; s) of the first; NaN outside its range and in its
        gaps.
        """
        own = self.find_counterpart(name)
        out = np.full(len(times), math.nan)
        if not own or not len(times):
            return out
        values = _find_column(self.second_recording, own)
        known = np.isfinite(values)
        t, v = self.second_recording.times_s[known] + self.total_shift_s, values[known]
        if self.second_recording.units.get(own) == "rad":
            v = np.unwrap(v)
        at = np.clip(np.searchsorted(t, times), 1, max(len(t) - 1, 1))
        inside = (times >= t[0]) & (times <= t[-1])
        if len(t) > 1:
            steps = np.diff(t)
            near = steps[at - 1] <= max(MAX_INTERPOLATED_GAP_S, 2.5 * float(np.median(steps)))
            out[inside & near] = np.interp(times[inside & near], t, v)
        elif len(t):
            out[np.abs(times - t[0]) < 1e-6] = v[0]
        return out

    def signal_difference(self, name: str) -> _Array:
        """Return first minus second (n,) at the instants of the first; angles wrapped to half a turn."""
        off = _find_column(self.first_recording, name) - self.sample_second_recording(
            name, self.first_recording.times_s
        )
        if self.first_recording.units.get(name) == "rad":
            off = np.arctan2(np.sin(off), np.cos(off))
        return np.asarray(off)

    def second_recording_track(self) -> _Array:
        """Return the positions (n, 3; N, E, D, m) of the second recording; NaN if unknown."""
        names = [f"estimated_position_{axis}" for axis in "NED"]
        found = [_find_column(self.second_recording, self.find_counterpart(name) or name) for name in names]
        return np.column_stack(found)


def find_shared_signals(c: RecordingComparison, chosen: Sequence[str] = ()) -> dict[str, list[str]]:
    """Return the quantities in both recordings with the names of their signals, ``{quantity: [names]}``.

    The signals are those of the first recording's preferred source.

    Parameters
    ----------
    c : RecordingComparison
    chosen : sequence of str
        Quantities (``attitude``), or signals (``measured_attitude``, ``measured_attitude_roll``); none: the usual ones.

    Raises
    ------
    ArgumentError
        If both recordings share none of the chosen quantities.
    """
    out: dict[str, list[str]] = {}
    for wanted in chosen or _DEFAULT_QUANTITIES:
        wanted = wanted.replace(".", "_")
        tried = (
            [wanted]
            if wanted.partition("_")[0] in MOTION_SOURCES
            else [f"{s}_{wanted}" for s in MOTION_SOURCES] + [wanted]
        )
        for variable in tried:
            known = find_quantity(variable)
            names = (
                [f"{variable}_{label}" for label in known.component_labels]
                if known and known.component_labels
                else [variable]
            )
            both = [n for n in names if np.isfinite(_find_column(c.first_recording, n)).any() and c.find_counterpart(n)]
            if both:
                out[wanted] = both
                break
        else:
            if chosen:
                held = ", ".join(sorted({n.rpartition("_")[0] for n in c.first_recording.columns})[:12])
                raise ArgumentError("signal", wanted, "is not in both recordings", f"the first has {held}")
    if not out:
        raise ArgumentError("signal", "", "the recordings share no signal", "name a signal of both recordings")
    return out


def draw_comparison(c: RecordingComparison, names: Sequence[str], title: str = "") -> Figure:
    """Draw signals of both recordings, one axes each, over the first's time: first solid, second dashed.

    Parameters
    ----------
    c : RecordingComparison
    names : sequence of str
        Signals of the first, from :func:`find_shared_signals`.
    title : str
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 1.0 + 1.75 * len(names)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True))
    t = c.first_recording.times_s
    for ax, name in zip(axes, names, strict=True):
        unit, shown, factor = _display_unit(c, name)
        one, two = _find_column(c.first_recording, name), c.sample_second_recording(name, t)
        if unit == "rad":
            one, two = _unwrap_angle_pair(one, two)
        ax.plot(t, factor * one, "-", color="#1769a5", label=c.first_recording.name)
        other = c.find_counterpart(name)
        ax.plot(
            t,
            factor * two,
            "--",
            color="#b85c00",
            label=c.second_recording.name + ("" if other == name else f" ({other})"),
        )
        ax.set_ylabel(name.replace("_", " ") + ("" if shown == "1" else f"\n({shown})"))
        ax.grid(alpha=0.3)
    labels = axes[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper center", ncols=2, frameon=False)
    axes[-1].set_xlabel(f"Time of {c.first_recording.name} (s)")
    if title:
        axes[0].set_title(title)
    return figure


def _display_unit(c: RecordingComparison, name: str) -> tuple[str, str, float]:
    """Return a signal's SI unit, its display unit and the factor from the first to the second."""
    unit = c.first_recording.units.get(name, "1")
    shown = "rpm" if "rotor_speed" in name else {"rad": "deg", "rad/s": "deg/s"}.get(unit, unit)
    return unit, shown, find_conversion_factor(unit, shown) if shown != unit else 1.0


def _unwrap_angle_pair(one: _Array, two: _Array) -> tuple[_Array, _Array]:
    """Return both angles unwrapped, the second shifted by full turns to the first."""
    known = np.isfinite(one)
    one = one.copy()
    one[known] = np.unwrap(one[known])
    both = np.isfinite(one) & np.isfinite(two)
    turns = np.round(np.median((one - two)[both]) / (2.0 * math.pi)) if both.any() else 0.0
    return one, two + 2.0 * math.pi * turns


def difference_rows(c: RecordingComparison, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return rms and largest difference of signals between two recordings, one dictionary for each signal.

    Keys: ``signal``, ``units``, ``rms``, ``largest``, and ``at_s``, the time of the largest difference on the first's
    clock.
    """
    out = []
    for name in names:
        off = c.signal_difference(name)
        known = np.isfinite(off)
        if not known.any():
            continue
        k = int(np.nanargmax(np.abs(off)))
        _, shown, factor = _display_unit(c, name)
        rms = float(np.sqrt(np.mean(off[known] ** 2)))
        out.append(
            {"signal": name, "units": shown, "rms": factor * rms, "largest": factor * float(off[k]),
             "at_s": float(c.first_recording.times_s[k])}
        )  # fmt: skip
    return out


def difference_table(c: RecordingComparison, names: Sequence[str]) -> ShownTable:
    """Return a table of the differences between two recordings, per signal."""
    rows = [
        (
            r["signal"],
            "" if r["units"] == "1" else r["units"],
            *(_format_cell(r[k]) for k in ("rms", "largest", "at_s")),
        )
        for r in difference_rows(c, names)
    ]
    return make_table_block(("signal", "unit", "rms difference", "largest", "at (s)"), rows, text=(0, 1))


def _format_cell(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
