"""From topics to signals: a column map applied to a log, with units converted and what was guessed said in words."""

from __future__ import annotations

import difflib
import re
from itertools import takewhile

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.clock import usable_samples
from mufly.logs.column_map import ColumnMap, SignalEntry
from mufly.logs.flat import our_name
from mufly.logs.raw import RawLog, RawTable
from mufly.logs.resample import euler_angles
from mufly.logs.series import Series, in_si, settle_angles, unit_of, without_jumps
from mufly.logs.signals import signal_named, split_name
from mufly.logs.units import known_unit, split_header

__all__ = ["map_signals", "raw_field"]


def map_signals(
    raw: RawLog, given: ColumnMap | None, standard: ColumnMap | None, wanted: tuple[str, ...] = ()
) -> tuple[list[Series], list[str]]:
    """Apply column maps to a log.

    Parameters
    ----------
    raw : RawLog
    given : ColumnMap, optional
        The user's; what it names must be there.
    standard : ColumnMap, optional
        Taken for what the user's leaves open, as far as it is there. A log that is a single table also gives its
        columns by their own names: all of them without a map of the user's, else only those with names of ours.
    wanted : tuple of str
        Names of the user's choice; ``topic/field`` takes a field as it is.

    Returns
    -------
    series : list of Series
        In SI units, angles without jumps.
    words : list of str
        What was guessed or repaired.

    Raises
    ------
    InputError
        If the user's map names what is not there, a unit is unknown, or a clock cannot be repaired.
    """
    out: dict[str, Series] = {}
    words: list[str] = []
    clocks: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}

    def clock_of(table: RawTable) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        if table.name not in clocks:
            index, said = usable_samples(table.time, raw.path, table.name if len(raw) > 1 else "")
            words.extend(said)
            clocks[table.name] = index, table.time[index]
        return clocks[table.name]

    entries = [(e, True) for e in (given.signal if given else ())]
    entries += [(e, False) for e in (standard.signal if standard else ())]
    used: set[tuple[str, str]] = set()
    for entry, must in entries:
        table = _table_of(raw, entry, must)
        if table is not None and not must:
            entry = _as_far_as_there(entry, table)
        names = None if table is None else _resolve(raw, table, entry, must)
        if table is None or names is None:
            continue
        used |= {(table.name, n) for n in names}
        index, time = clock_of(table)
        for series in _entry_series(table, entry, names, index, time):
            out.setdefault(series.key, series)
    if len(raw) == 1 and standard is None:
        table = next(iter(raw.values()))
        index, time = clock_of(table)
        for name, values in table.fields.items():
            ours = our_name(name)
            if (table.name, name) in used or (ours is None and given is not None):
                continue
            variable, label = ours or (_identifier(name), None)
            unit = _spelled(table.units.get(name, ""))
            unit = "1" if not unit and ours and unit_of(variable) == "1" else unit
            one = Series(variable, label, time, values[index], unit, name, long_name="" if ours else name)
            out.setdefault(one.key, one)
    for name in wanted:
        if "/" in name:
            table, field = raw_field(raw, name)
            index, time = clock_of(table)
            unit = _spelled(table.units.get(field, ""))
            variable = _identifier(f"{table.name}_{field}")
            out[variable] = Series(
                variable, None, time, table.fields[field][index], unit, name, long_name=name
            )
    found, said = settle_angles(list(out.values()))
    return [without_jumps(in_si(s)) for s in found], words + said


def raw_field(raw: RawLog, name: str) -> tuple[RawTable, str]:
    """Find ``topic/field`` in a log.

    Raises
    ------
    InputError
        If there is none, naming what comes near.
    """
    topic, _, field = name.rpartition("/")
    if topic not in raw and f"/{topic.lstrip('/')}" in raw:
        topic = f"/{topic.lstrip('/')}"
    if topic not in raw:
        raise InputError(raw.path, name, "there is no such topic", _near(topic, list(raw), "topics"))
    if field not in raw[topic].fields:
        remedy = _near(field, list(raw[topic].fields), "fields")
        raise InputError(raw.path, name, f"topic {topic} has no such field", remedy)
    return raw[topic], field


def _near(name: str, known: list[str], what: str) -> str:
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    shown = near or known[:10]
    more = f" and {len(known) - 10} more" if not near and len(known) > 10 else ""
    return f"{'did you mean' if near else f'{what} are:'} {', '.join(shown)}{more}{'?' if near else ''}"


def _table_of(raw: RawLog, entry: SignalEntry, must: bool) -> RawTable | None:
    if entry.topic is None:
        if len(raw) == 1:
            return next(iter(raw.values()))
        problem = f"{entry.name} names no topic, and the log has {len(raw)}"
        raise InputError(
            raw.path, entry.name, problem, f"add topic = ..., one of: {', '.join(list(raw)[:8])}"
        )
    if entry.topic in raw:
        return raw[entry.topic]
    if must:
        raise InputError(
            raw.path, entry.topic, "there is no such topic", _near(entry.topic, list(raw), "topics")
        )
    return None


def _as_far_as_there(entry: SignalEntry, table: RawTable) -> SignalEntry:
    """Of a signal with any number of channels, the first ones that the topic has."""
    signal = signal_named(entry.name)
    if signal is None or signal.dim is None or signal.labels:
        return entry
    there = tuple(takewhile(lambda c: c in table.fields, entry.columns))
    return entry.model_copy(update={"columns": there}) if there else entry


def _resolve(raw: RawLog, table: RawTable, entry: SignalEntry, must: bool) -> list[str] | None:
    """The fields that an entry means; None if they are not there, or there without a single value."""
    low = {name.lower(): name for name in table.fields}
    names = []
    for column in entry.columns:
        bare = split_header(column)[0]
        name = next(
            (n for n in (column, bare) if n in table.fields), low.get(column.lower(), low.get(bare.lower()))
        )
        if name is None:
            if must:
                remedy = _near(column, list(table.fields), "columns")
                raise InputError(raw.path, column, "there is no such column", remedy)
            return None
        names.append(name)
    if entry.quaternion and not must:
        block = np.column_stack([table.fields[n] for n in names])
        return names if np.isfinite(euler_angles(block)).any() else None
    return names


def _entry_series(
    table: RawTable, entry: SignalEntry, names: list[str], index: NDArray[np.int64], time: NDArray[np.float64]
) -> list[Series]:
    signal, variable, label = split_name(entry.name, "map")
    columns = [table.fields[n][index] for n in names]
    units = [
        known_unit(entry.unit) or entry.unit if entry.unit else _spelled(table.units.get(n, ""))
        for n in names
    ]
    # A header's unit inside the map's own column name counts too.
    units = [u or split_header(c)[1] for u, c in zip(units, entry.columns, strict=True)]
    if entry.quaternion:
        values = euler_angles(np.column_stack(columns).astype(np.float64))
        columns, units, sources = list(values.T), ["rad"] * 3, [f"{table.name}/{names[0]}.."] * 3
        signs: tuple[float, ...] = (1.0, 1.0, 1.0) if isinstance(entry.sign, float) else entry.signs[1:]
    else:
        sources, signs = [f"{table.name}/{n}" for n in names], entry.signs
    if label is not None:
        labels: list[str | None] = [label]
    elif signal is None or signal.dim is None:
        labels = [None]
    else:
        labels = [str(k) for k in (signal.labels or range(1, len(columns) + 1))]
    out = []
    for one, column, unit, sign, source in zip(labels, columns, units, signs, sources, strict=True):
        if column.dtype.kind not in "US":
            column = sign * entry.factor * column.astype(np.float64) + entry.offset
        out.append(Series(variable, one, time, column, unit, source, entry.hold, entry.long_name))
    return out


def _identifier(name: str) -> str:
    text = re.sub(r"\W+", "_", name).strip("_") or "signal"
    return f"_{text}" if text[0].isdigit() else text


def _spelled(unit: str) -> str:
    return known_unit(unit) or unit
