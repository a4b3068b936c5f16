"""Report on a log: format, topics, signals and faults, as numbers and text."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, welch

from mufly.errors import ArgumentError, InputError
from mufly.logs.channel_checks import ChannelReport, examine_channels, numeric_channels
from mufly.logs.column_map import ColumnMap, find_raw_field, load_column_map
from mufly.logs.delay_estimation import DelayReport, estimate_channel_delays
from mufly.logs.log_io import extract_log_channels, join_channels_at_highest_rate, read_topics_and_dataset
from mufly.logs.mcap import make_flight_row_layout
from mufly.logs.raw_log import MIN_GAP_STEPS, Channel, ClockReport, RawLog, examine_time_stamps, resample_signal
from mufly.quantities.quantity_table import SIGNAL_SOURCES, is_command_signal
from mufly.quantities.units import find_conversion_factor
from mufly.results import ShownBlock, make_lines_block, make_table_block, result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ColumnMapInput = str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap | None
# Gaps of more topics than this are reported in one sentence.
_MAX_LISTED_TOPICS = 5
_MAX_SHOWN_LINES = 40  # of a section of a report
ProgressCallback = Callable[[int, int], None]


@result
class LogReport:
    """Result of :func:`examine_log`.

    Attributes
    ----------
    raw : RawLog
        Log as read.
    clocks : dict of str to ClockReport
        Checks of the clocks, by topic.
    signals : list of ChannelReport
        Checks of every signal with a name of this package or of the user's map.
    sources : dict of str to str
        Topic and field of each signal.
    delays : list of DelayReport
    notes : list of str
        Guesses and repairs.
    """

    raw: RawLog
    clocks: dict[str, ClockReport]
    signals: list[ChannelReport]
    sources: dict[str, str]
    delays: list[DelayReport]
    notes: list[str]

    def list_faults(self) -> list[str]:
        """Return one sentence per fault of the log."""
        out = self.raw.describe_damage()
        if self.raw.dropouts:
            lost = sum(d for _, d in self.raw.dropouts)
            times = "once" if len(self.raw.dropouts) == 1 else f"{len(self.raw.dropouts)} times"
            out.append(f"the logger reports data loss {times}, {lost:.3g} s in all")
        one = len(self.clocks) == 1
        holes = {k: c for k, c in self.clocks.items() if len(c.gaps)}
        many = len(holes) > _MAX_LISTED_TOPICS
        if many:
            where, (start, end) = max(
                ((k, g) for k, c in holes.items() for g in c.gaps.tolist()), key=lambda h: h[1][1] - h[1][0]
            )
            out.append(
                f"{len(holes)} of {len(self.clocks)} topics have gaps, the longest {end - start:.3g} s at "
                f"{start:.2f} s ({where})"
            )
        for k, c in self.clocks.items():
            words = replace(c, gaps=np.empty((0, 2))).describe_faults() if many else c.describe_faults()
            out += words if one else [f"topic {k}: {w}" for w in words]
        out += [w for s in self.signals for w in s.describe_faults()]
        still = [s for s in self.signals if s.constant]
        if still:
            values = (f"{s.name} ({s.smallest:.4g}{'' if s.units in ('', '1') else ' ' + s.units})" for s in still)
            out.append(f"constant throughout: {', '.join(values)}")
        return out

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the blocks of the report: format, topics, signals, delays, notes and faults."""
        raw = self.raw
        start, end = raw.time_span
        facts = [raw.format_name, f"{end - start:.2f} s", f"from {start:.2f} to {end:.2f} s"]
        facts += [f"began {raw.start_time}"] if raw.start_time else []
        facts += [str(raw.info[k]) for k in ("sys_name", "ver_hw", "system", "recorded by") if raw.info.get(k)]
        facts += [f"{len(raw.info['parameters'])} parameters"] if raw.info.get("parameters") else []
        topics = []
        for name, table in raw.items():
            clock = self.clocks[name]
            signals = (s.partition(".")[0] for s, source in self.sources.items() if source.startswith(f"{name}/"))
            rate, gaps = _format_number(clock.rate_hz, 4), f"{len(clock.gaps) or ''}"
            given = ", ".join(dict.fromkeys(signals))
            topics.append((name, f"{len(table.time)}", rate, f"{len(table.fields)}", gaps, given))
        rows = [
            (s.name, "" if s.units == "1" else s.units, *map(_format_number, (s.smallest, s.mean, s.largest, s.std)))
            for s in self.signals
        ]
        said = [f"{f'{t:.2f} s, ' if t == t else ''}{level}: {text}" for t, level, text in raw.messages]
        faults = self.list_faults()
        blocks: list[ShownBlock] = [
            make_lines_block(f"  {', '.join(facts)}", head=Path(raw.path).name),
            make_table_block(("topic", "messages", "rate (Hz)", "fields", "gaps", "signals"), topics, text=(0, 5)),
        ]
        if rows:
            heads = ("signal", "unit", "min", "mean", "max", "std")
            blocks += [
                make_table_block(heads, rows[:_MAX_SHOWN_LINES], text=(0, 1)),
                *_make_omitted_count_block(len(rows)),
            ]
        return [
            *blocks,
            *_section_blocks("Delays", [d.describe_delay() for d in self.delays]),
            *_section_blocks("Messages of the vehicle", said),
            *_section_blocks("Assumed, repaired or refused", self.notes, "yellow"),
            *_section_blocks("Faults", faults, "yellow"),
            *([] if faults else [make_lines_block("No faults found.")]),
        ]

    def as_record(self) -> dict[str, Any]:
        """Return the report as a dictionary for JSON, in SI units."""
        start, end = self.raw.time_span
        topics = [
            {
                "name": name,
                "messages": len(table.time),
                "rate_hz": clock.rate_hz,
                "jitter": clock.jitter_ratio,
                "gaps_s": clock.gaps,
                "backward": clock.backward,
                "repeated": clock.repeated,
                "fields": {f: table.units.get(f, "") for f in table.fields},
            }
            for (name, table), clock in zip(self.raw.items(), self.clocks.values(), strict=True)
        ]
        told = ("delay_s", "std_s", "low_s", "high_s")
        delays = [
            {
                "reference": d.reference,
                "response": d.response,
                # An undetermined delay is reported without a number.
                **{k: getattr(d.delay, k) if d.delay.is_determined else None for k in told},
                "correlation": d.delay.correlation,
                "determined": d.delay.is_determined,
            }
            for d in self.delays
        ]
        return {
            "path": self.raw.path,
            "format": self.raw.format_name,
            "start_time": self.raw.start_time,
            "from_s": start,
            "to_s": end,
            "complete": self.raw.is_complete,
            "topics": topics,
            "signals": [{**asdict(s), "source": self.sources.get(s.name, "")} for s in self.signals],
            "delays": delays,
            "dropouts": [{"time_s": t, "duration_s": d} for t, d in self.raw.dropouts],
            "messages": [{"time_s": t, "level": level, "text": text} for t, level, text in self.raw.messages],
            "parameters": len(self.raw.info.get("parameters", {})),
            "notes": self.notes,
            "faults": self.list_faults(),
        }


def _section_blocks(title: str, lines: Sequence[str], style: str = "") -> list[ShownBlock]:
    if not lines:
        return []
    shown = (f"  {line}" for line in lines[:_MAX_SHOWN_LINES])
    return [
        make_lines_block(title, style="bold"),
        make_lines_block(*shown, style=style),
        *_make_omitted_count_block(len(lines)),
    ]


def _make_omitted_count_block(count: int) -> list[ShownBlock]:
    if count <= _MAX_SHOWN_LINES:
        return []
    return [make_lines_block(f"  and {count - _MAX_SHOWN_LINES} more (--json lists all)", style="dim")]


def _format_number(value: float, digits: int = 3) -> str:
    return "" if value != value else f"{value:.{digits}g}" if abs(value) < 10**digits else f"{value:.0f}"


def select_fields_of_fastest_topics(raw: RawLog) -> list[Channel]:
    """Return the first numeric fields of the fastest topics, for the display of a log without a column map."""
    out = []
    for table in sorted(raw.values(), key=lambda t: -len(t.time))[:6]:
        numbers = [(f, v) for f, v in table.fields.items() if v.dtype.kind in "biuf"][:6]
        out += [Channel(f"{table.name}/{f}", table.units.get(f, ""), table.time, v.astype(float)) for f, v in numbers]
    return out


def read_channels(
    path: str | Path,
    columns: _ColumnMapInput = None,
    fields: Sequence[str] = (),
    progress: ProgressCallback | None = None,
) -> tuple[RawLog, list[Channel], dict[str, str], list[str]]:
    """Open a log and return its signals, each component on its own clock.

    Parameters
    ----------
    path : str or Path
    columns : optional
        Column map, as for :func:`load_column_map`.
    fields : sequence of str
        Additional fields ``topic/field``, not converted.
    progress : callable, optional
        Called with (bytes read, total bytes).

    Returns
    -------
    raw : RawLog
    channels : list of Channel
    sources : dict of str to str
        Topic and field of each channel.
    notes : list of str

    Raises
    ------
    InputError
        As for :func:`read_log`. A log without known signals has no channels, and a note gives the reason.
    """
    given = None if columns is None else load_column_map(columns)
    raw, recording = read_topics_and_dataset(path, None if given is None else given.time, progress)
    notes = list(raw.notes)
    if recording is not None and given is None:
        ours = make_flight_row_layout().quantities if raw.format_name == "MCAP" else ()
        where = {q.name: f"{q.topic}/{q.field}" for q in ours}
        out = [c._replace(source=where.get(c.signal_name, "")) for c in numeric_channels(recording)]
    else:
        try:
            out, said = extract_log_channels(raw, given)
        except InputError as error:
            if given is not None:
                raise
            out, said = [], [f"{error.key + ': ' if error.key else ''}{error.problem}; {error.remedy}"]
        notes += said
    sources = {c.name: c.source for c in out}
    out = [c for c in out if not c.is_text]
    for name in fields:
        table, field = find_raw_field(raw, name)
        values = table.fields[field]
        if values.dtype.kind in "US":
            raise InputError(str(path), name, "is text", "choose a field that contains numbers")
        order = np.argsort(table.time, kind="stable")
        units = table.units.get(field, "")
        out.append(Channel(f"{table.name}/{field}", units, table.time[order], values[order].astype(float)))
    return raw, out, sources, notes


def examine_log(
    path: str | Path,
    columns: _ColumnMapInput = None,
    *,
    delays: bool = True,
    progress: ProgressCallback | None = None,
) -> LogReport:
    """Read a log and report its contents and faults.

    Parameters
    ----------
    path : str or Path
    columns : optional
        Column map, as for :func:`load_column_map`.
    delays : bool
        Whether to estimate the delays between references and measurements.
    progress : callable, optional
        Called with (done, total) while a long log is read and examined.

    Raises
    ------
    InputError
        If the file is no log, or the map does not fit it.
    """
    raw, found, sources, notes = read_channels(path, columns, progress=progress)
    between: list[DelayReport] = []
    if delays and found:
        wanted = ("attitude", "rates", "velocity", "position")
        pairs = [c for c in found if c.signal_name.partition("_")[2] in wanted and len(c.time) > 30]
        if pairs:
            try:
                between = estimate_channel_delays(join_channels_at_highest_rate(pairs))
            except InputError as error:  # an invalid time stamp: the rest is still reported
                notes.append(f"no delays: {error.problem}; {error.remedy}")
    reports = examine_channels(found, progress)
    clocks = {name: examine_time_stamps(table.time) for name, table in raw.items()}
    return LogReport(raw, clocks, reports, sources, between, notes)


# Pictures: signals over time, each on its own clock, and their spectra. Signals of one kind share a picture, with one
# panel for each component, so that reference, measurement and truth of a component are overlaid. Angles are drawn in
# degrees. Colours are those of Okabe and Ito (2008), which are distinguishable with colour blindness.

_Array = NDArray[np.float64]
_PLOT_STYLE: Any = {
    "font.size": 9.0, "axes.titlesize": 10.0, "axes.titlelocation": "left", "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "axes.axisbelow": True, "grid.alpha": 0.35, "grid.linewidth": 0.5,
    "lines.linewidth": 1.1, "legend.frameon": False, "legend.fontsize": 8.0, "svg.fonttype": "none",
    "svg.hashsalt": "mufly",
}  # fmt: skip
_PLOT_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222", "#8c8c8c")
_LINE_STYLE_BY_SOURCE = {
    "truth": ("#222222", "-"), "measured": ("#0072B2", "-"), "estimated": ("#009E73", "-"),
    "reference": ("#D55E00", "--"),
}  # fmt: skip
_PLOT_UNIT_BY_SI_UNIT = {"rad": "deg", "rad/s": "deg/s"}
# More points than a picture has columns are drawn as the extremes of each column.
_MAX_PLOT_COLUMNS = 3000
_PICTURE_ORDER = (
    "attitude",
    "rates",
    "position",
    "velocity",
    "acceleration",
    "rotor_speed",
    "inputs",
    "battery",
)
_INPUT_SIGNALS = (
    "motor_input",
    "servo_input",
    "actuator_control",
    "actuator_output",
    "actuator_command",
    "pilot_input",
)


class _PlotPlace(NamedTuple):
    """Place of a channel in the plots: picture, panel, kind of source ("" if there is only one) and legend text."""

    picture: str
    panel: str
    source: str
    legend: str


def _find_plot_place(c: Channel) -> _PlotPlace:
    if "/" in c.name:
        topic, _, field = c.name.rpartition("/")
        return _PlotPlace(topic.strip("/").replace("/", "_"), re.split(r"[\[.]", field)[0], "", field)
    source, _, rest = c.signal_name.partition("_")
    panel = c.component_label or c.signal_name.replace("_", " ")
    if source in SIGNAL_SOURCES and rest:
        return _PlotPlace(rest, panel, source, SIGNAL_SOURCES[source])
    alone = "battery" if source == "battery" else c.signal_name if c.component_label else "others"
    picture = "inputs" if c.signal_name in _INPUT_SIGNALS else alone
    return _PlotPlace(picture, c.signal_name.replace("_", " "), "", panel)


def group_channels_by_picture(channels: Sequence[Channel]) -> dict[str, list[Channel]]:
    """Sort channels into pictures: ``{"attitude": [...], "inputs": [...], ...}``, in a fixed order."""
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(_find_plot_place(channel).picture, []).append(channel)
    rank = {k: i for i, k in enumerate(_PICTURE_ORDER)}
    return dict(sorted(groups.items(), key=lambda g: rank.get(g[0], len(_PICTURE_ORDER))))


def compute_power_spectrum(time: _Array, values: _Array) -> tuple[_Array, _Array]:
    """Return frequencies (Hz) and power spectral density (unit^2/Hz) of a channel.

    Welch's method with Hann windows of at most a quarter of the record, on the channel's median step. Short gaps are
    bridged linearly; with longer gaps the longest stretch between them is used.

    Raises
    ------
    InputError
        If the stretch has fewer than 32 samples.
    """
    known = np.isfinite(values)
    t, x = time[known], values[known]
    if len(t) >= 32:
        step = float(np.median(np.diff(t)))
        edges = np.concatenate(([0], np.flatnonzero(np.diff(t) > 10 * MIN_GAP_STEPS * step) + 1, [len(t)]))
        k = int(np.diff(edges).argmax())
        t, x = t[edges[k] : edges[k + 1]], x[edges[k] : edges[k + 1]]
    if len(t) < 32:
        raise InputError("spectrum", "", f"{len(t)} samples", "choose a longer part (at least 32 samples)")
    even = np.arange(t[0], t[-1], step)
    on_grid = resample_signal(t, x, even, gap_s=np.inf)
    segment = max(32, min(len(even), 2 ** int(np.log2(max(len(even) / 4, 32)))))
    frequency, density = welch(detrend(on_grid), fs=1 / step, nperseg=segment, detrend="constant")
    return frequency[1:], density[1:]


def _thin_points(time: _Array, values: _Array) -> tuple[_Array, _Array]:
    """Return the points to draw, with NaN at gaps; many points are reduced to the extremes of each pixel column."""
    known = np.isfinite(time)
    t, x = time[known], values[known]
    if len(t) > 2 * _MAX_PLOT_COLUMNS:
        parts = np.linspace(0, len(t), _MAX_PLOT_COLUMNS + 1).astype(int)[:-1]
        low = np.minimum.reduceat(np.where(np.isnan(x), np.inf, x), parts)
        high = np.maximum.reduceat(np.where(np.isnan(x), -np.inf, x), parts)
        empty = ~np.isfinite(low)
        pair = np.column_stack((low, high))
        pair[empty] = np.nan
        return np.repeat(t[parts], 2), pair.ravel()
    if len(t) > 2:
        steps = np.diff(t)
        wide = np.flatnonzero(steps > MIN_GAP_STEPS * np.median(steps)) + 1
        t, x = np.insert(t, wide, t[wide - 1]), np.insert(x, wide, np.nan)
    return t, x


def draw_channels(channels: Sequence[Channel], *, title: str = "", spectra: bool = False) -> Figure:
    """Draw channels of one kind, over time or as spectra.

    Parameters
    ----------
    channels : sequence of Channel
        Channels of one group of :func:`group_channels_by_picture`.
    title : str
    spectra : bool
        Draw power spectral densities instead of time histories; channels that are too short are omitted.

    Raises
    ------
    InputError
        If spectra are requested and no channel is long enough.
    """
    import matplotlib
    from matplotlib.figure import Figure

    # One panel for each component of overlaid signals, otherwise one for each variable or unit.
    panels: dict[tuple[str, str], list[Channel]] = {}
    for c in channels:
        panels.setdefault((_find_plot_place(c).panel, "" if c.units == "1" else c.units), []).append(c)
    with matplotlib.rc_context(_PLOT_STYLE):
        figure = Figure(figsize=(8.5, 0.7 + 1.75 * len(panels)), layout="constrained")
        axes = np.atleast_1d(figure.subplots(len(panels), 1, sharex=True))
        drawn, above = 0, [""]
        for ax, ((name, unit), members) in zip(axes, panels.items(), strict=True):
            shown = _PLOT_UNIT_BY_SI_UNIT.get(unit, unit)
            scale = find_conversion_factor(unit, shown) if shown != unit else 1.0
            several = len({c.signal_name for c in members}) > 1 or len(members) == 1
            legends = [_find_plot_place(c).legend for c in members]
            for k, c in enumerate(members):
                source = _find_plot_place(c).source
                colour, dash = _PLOT_COLOURS[k % len(_PLOT_COLOURS)], "-" if k < len(_PLOT_COLOURS) else "--"
                if several and source:
                    colour, dash = _LINE_STYLE_BY_SOURCE[source]
                if spectra:
                    try:
                        x, y = compute_power_spectrum(c.time, c.values * scale)
                    except InputError:
                        continue
                    keep = y > 0
                    if not keep.any():
                        continue
                    ax.loglog(x[keep], y[keep], dash, color=colour, label=legends[k])
                else:
                    t, y = _thin_points(c.time, c.values * scale)
                    style = "steps-post" if is_command_signal(c.name) and len(t) <= 2 * _MAX_PLOT_COLUMNS else "default"
                    ax.plot(t, y, dash, color=colour, label=legends[k], drawstyle=style)
                drawn += 1
            text = name[:1].upper() + name[1:] if len(name) > 1 else name
            density = f"(({shown})²/Hz)" if "/" in shown else f"({shown}²/Hz)" if shown else "(1/Hz)"
            inner = density if spectra else f"({shown})" if shown else ""
            ax.set_ylabel(f"{text}\n{inner}".rstrip())
            named = len(legends) == 1 and legends[0].lower() == name.lower()
            if legends != above and not named and ax.get_lines():  # a legend that holds for every panel is drawn once
                ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)
            above = legends
        if spectra and not drawn:
            raise ArgumentError("spectra", "", "no channel is long enough", "choose a longer part")
        axes[-1].set_xlabel("Frequency (Hz)" if spectra else "Time (s)")
        axes[0].set_title(title)
    return figure
