"""A log examined: what it is, its topics, its signals, and what is wrong with them, as numbers and in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mufly.errors import InputError
from mufly.logs.clock import ClockReport
from mufly.logs.column_map import ColumnMap, load_map
from mufly.logs.delays import DelayReport, check_delays
from mufly.logs.join import joined
from mufly.logs.layout import QUANTITIES
from mufly.logs.mapping import raw_field
from mufly.logs.quality import Channel, ChannelReport, channels_of, check_channels, check_log
from mufly.logs.raw import RawLog
from mufly.logs.read import open_log, series_of

__all__ = ["LogReport", "channels", "examine"]

_Columns = str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap | None
# Gaps of more topics than this are told in one sentence.
_MANY_TOPICS = 5
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class LogReport:
    """What :func:`examine` found.

    Attributes
    ----------
    raw : RawLog
        The log itself.
    clocks : dict of str to ClockReport
        By topic.
    signals : list of ChannelReport
        Of every signal with a name of ours (or of the user's map).
    sources : dict of str to str
        Topic and field from which a signal comes.
    delays : list of DelayReport
    notes : list of str
        What was guessed and repaired.
    """

    raw: RawLog
    clocks: dict[str, ClockReport]
    signals: list[ChannelReport]
    sources: dict[str, str]
    delays: list[DelayReport]
    notes: list[str]

    def faults(self) -> list[str]:
        """Everything that is wrong, a sentence each."""
        out = [] if self.raw.complete else ["the file is damaged or cut off; what could be read is here"]
        if self.raw.dropouts:
            lost = sum(d for _, d in self.raw.dropouts)
            times = "once" if len(self.raw.dropouts) == 1 else f"{len(self.raw.dropouts)} times"
            out.append(f"the logger says that it lost data {times}, {lost:.3g} s in all")
        one = len(self.clocks) == 1
        holes = {k: c for k, c in self.clocks.items() if len(c.gaps)}
        many = len(holes) > _MANY_TOPICS
        if many:
            where, (start, end) = max(
                ((k, g) for k, c in holes.items() for g in c.gaps.tolist()), key=lambda h: h[1][1] - h[1][0]
            )
            out.append(
                f"{len(holes)} of {len(self.clocks)} topics have gaps, the longest {end - start:.3g} s at "
                f"{start:.2f} s ({where})"
            )
        for k, c in self.clocks.items():
            words = replace(c, gaps=np.empty((0, 2))).words() if many else c.words()
            out += words if one else [f"topic {k}: {w}" for w in words]
        out += [w for s in self.signals for w in s.words()]
        still = [s for s in self.signals if s.constant]
        if still:
            values = (
                f"{s.name} ({s.smallest:.4g}{'' if s.units in ('', '1') else ' ' + s.units})" for s in still
            )
            out.append(f"constant throughout: {', '.join(values)}")
        return out

    def to_dict(self) -> dict[str, Any]:
        """For JSON, SI units."""
        start, end = self.raw.span
        topics = [
            {
                "name": name,
                "messages": len(table.time),
                "rate_hz": self.clocks[name].rate_hz,
                "jitter": self.clocks[name].jitter,
                "gaps_s": self.clocks[name].gaps,
                "backward": self.clocks[name].backward,
                "repeated": self.clocks[name].repeated,
                "fields": {f: table.units.get(f, "") for f in table.fields},
            }
            for name, table in self.raw.items()
        ]
        delays = [
            {
                "reference": d.reference,
                "response": d.response,
                "delay_s": d.delay.delay_s,
                "std_s": d.delay.std_s,
                "low_s": d.delay.low_s,
                "high_s": d.delay.high_s,
                "correlation": d.delay.correlation,
            }
            for d in self.delays
        ]
        return {
            "path": self.raw.path,
            "format": self.raw.kind,
            "start_time": self.raw.start_time,
            "from_s": start,
            "to_s": end,
            "complete": self.raw.complete,
            "topics": topics,
            "signals": [{**asdict(s), "source": self.sources.get(s.name, "")} for s in self.signals],
            "delays": delays,
            "dropouts": [{"time_s": t, "duration_s": d} for t, d in self.raw.dropouts],
            "messages": [{"time_s": t, "level": level, "text": text} for t, level, text in self.raw.messages],
            "parameters": len(self.raw.info.get("parameters", {})),
            "notes": self.notes,
            "faults": self.faults(),
        }


def channels(
    path: str | Path, columns: _Columns = None, fields: Sequence[str] = (), progress: Progress | None = None
) -> tuple[RawLog, list[Channel], dict[str, str], list[str]]:
    """Open a log and return its signals, each component on its own clock.

    Parameters
    ----------
    path : str or Path
    columns : optional
        Column map, as :func:`load_map` takes it.
    fields : sequence of str
        Fields ``topic/field`` to take as they are, besides.
    progress : callable, optional
        Called with (bytes read, bytes in all).

    Returns
    -------
    raw : RawLog
    channels : list of Channel
    sources : dict of str to str
        Topic and field of each.
    notes : list of str

    Raises
    ------
    InputError
        As :func:`read_log`. A log that can be read but not understood has no channels, and a note says why.
    """
    given = None if columns is None else load_map(columns)
    raw, recording = open_log(path, None if given is None else given.time, progress)
    out: list[Channel] = []
    sources: dict[str, str] = {}
    notes = list(raw.notes)
    recording = recording if given is None else None
    if recording is not None:
        out = channels_of(recording)
        where = {q.name: f"{q.topic}/{q.field}" for q in QUANTITIES} if raw.kind == "MCAP" else {}
        sources = {c.name: where.get(c.name.partition(".")[0], "") for c in out}
    else:
        try:
            series, said = series_of(raw, given)
        except InputError as error:
            if given is not None:
                raise
            series, said = [], [f"{error.key + ': ' if error.key else ''}{error.problem}; {error.remedy}"]
        notes += said
        out = [Channel(s.key, s.unit, s.time, s.values) for s in series if s.values.dtype.kind not in "US"]
        sources = {s.key: s.source for s in series}
    for name in fields:
        table, field = raw_field(raw, name)
        values = table.fields[field]
        if values.dtype.kind in "US":
            raise InputError(str(path), name, "is text", "choose a number")
        order = np.argsort(table.time, kind="stable")
        out.append(
            Channel(
                f"{table.name}/{field}",
                table.units.get(field, ""),
                table.time[order],
                values[order].astype(float),
            )
        )
    return raw, out, sources, notes


def examine(
    path: str | Path, columns: _Columns = None, *, delays: bool = True, progress: Progress | None = None
) -> LogReport:
    """Read a log and say what it is and what is wrong with it.

    Parameters
    ----------
    path : str or Path
    columns : optional
        Column map, as :func:`load_map` takes it.
    delays : bool
        Whether to estimate the delays between references and measurements.
    progress : callable, optional
        Called with (done, all) while a long log is read and examined.

    Raises
    ------
    InputError
        If the file is no log, or the map does not fit it.
    """
    raw, found, sources, notes = channels(path, columns, progress=progress)
    between: list[DelayReport] = []
    if delays and found:
        wanted = ("attitude", "rates", "velocity", "position")
        pairs = [
            c for c in found if c.name.partition(".")[0].partition("_")[2] in wanted and len(c.time) > 30
        ]
        if pairs:
            try:
                between = check_delays(joined(pairs))
            except InputError as error:  # a wild time stamp: all else can still be said
                notes.append(f"no delays: {error.problem}; {error.remedy}")
    reports = check_channels(found, progress)
    return LogReport(raw, check_log(raw), reports, sources, between, notes)
