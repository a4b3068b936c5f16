"""From topics to signals: a column map applied to a log, with units converted and what was guessed said in words."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.angle_unit import UnitGuess, guess_angle_units
from mufly.logs.clock import usable_samples
from mufly.logs.column_map import ColumnMap, SignalEntry
from mufly.logs.flat import our_name
from mufly.logs.raw import RawLog, RawTable
from mufly.logs.resample import euler_angles, unwrap
from mufly.logs.signals import signal_named, split_name
from mufly.logs.units import conversion, known_unit, split_header

__all__ = ["Series", "map_signals", "raw_field"]

_ANGLES, _RATES = ("roll", "pitch", "yaw"), ("p", "q", "r")
_ALIASES = {"roll": _ANGLES[0], "phi": "roll", "pitch": "pitch", "theta": "pitch", "yaw": "yaw", "psi": "yaw"}


@dataclass(frozen=True)
class Series:
    """One component of a signal on its own, increasing clock.

    ``unit`` is what the values are in, ``""`` as long as nobody has said; ``source`` names topic and column.
    """

    variable: str
    label: str | None
    time: NDArray[np.float64]
    values: NDArray[Any]
    unit: str
    source: str
    hold: bool = False
    long_name: str = ""

    @property
    def key(self) -> str:
        """``variable.label``."""
        return self.variable if self.label is None else f"{self.variable}.{self.label}"


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
            unit = "1" if not unit and ours and _signal_unit(variable) == "1" else unit
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
    found, said = _angles_settled(list(out.values()))
    return [_finished(_to_si(s)) for s in found], words + said


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


def _signal_unit(variable: str) -> str:
    signal = signal_named(variable)
    return signal.units if signal is not None else ""


def _to_si(series: Series) -> Series:
    """Convert to the signal's unit; units that nobody knows stay as they are."""
    if series.values.dtype.kind in "US":
        return series
    wanted = _signal_unit(series.variable) or None
    unit = series.unit or wanted or "1"
    if unit == wanted or (wanted is None and not known_unit(unit)):
        return replace(series, unit=unit, values=series.values.astype(np.float64))
    if unit == "us" and wanted == "us":
        return series
    try:
        reached, factor, offset = conversion(unit, wanted)
    except InputError as error:
        raise InputError(
            series.source, series.key, f"the unit {unit!r} {error.problem}", error.remedy
        ) from None
    return replace(series, unit=reached, values=series.values.astype(np.float64) * factor + offset)


def _finished(series: Series) -> Series:
    angle = series.variable.endswith("_attitude") or (series.label is None and series.variable in _ALIASES)
    if angle and series.unit == "rad":
        return replace(series, values=unwrap(series.values))
    return series


def _role(series: Series) -> tuple[str, str, int] | None:
    """("measured", "angle", 0) for the roll angle of measured_attitude or a column called roll or phi; else None."""
    prefix, _, kind = series.variable.partition("_")
    if kind == "attitude" and series.label in _ANGLES:
        return prefix, "angle", _ANGLES.index(series.label)
    if kind == "rates" and series.label in _RATES:
        return prefix, "rate", _RATES.index(series.label)
    if series.label is None and series.variable.lower() in _ALIASES:
        return "", "angle", _ANGLES.index(_ALIASES[series.variable.lower()])
    if series.label is None and series.variable in _RATES:
        return "", "rate", _RATES.index(series.variable)
    return None


def _angles_settled(series: list[Series]) -> tuple[list[Series], list[str]]:
    """Guess the units of angles and rates that name none; check those that do. Says every guess."""
    groups: dict[str, dict[tuple[str, int], Series]] = {}
    for s in series:
        role = _role(s)
        if role is not None and s.values.dtype.kind not in "US":
            groups.setdefault(role[0], {})[role[1], role[2]] = s
    settled: dict[str, str] = {}
    words: list[str] = []
    for prefix in sorted(groups, key=lambda p: p != "measured"):
        group = groups[prefix]
        for kind in ("angle", "rate"):
            members = [s for (k, _), s in group.items() if k == kind]
            if not members:
                continue
            what = members[0].variable if prefix else ", ".join(s.variable for s in members)
            guess, unit = _guess(group, kind)
            unnamed = [s for s in members if not s.unit]
            si = "rad" if kind == "angle" else "rad/s"
            deg = "deg" if kind == "angle" else "deg/s"
            if unnamed:
                like = settled.get(f"{groups.get('measured', {}).get((kind, 0), unnamed[0]).key}", "")
                chosen = {"deg": deg, "rad": si}.get(unit) or like or si
                why = (
                    guess.reason if unit else "as in measured_" + {"angle": "attitude", "rate": "rates"}[kind]
                )
                if not unit and not like:
                    why = "nothing in the data tells otherwise"
                words.append(f"{what} names no unit and is taken to be in {chosen} ({why})")
                settled |= {s.key: chosen for s in unnamed}
            for s in members:
                if s.unit == si and unit == "deg":
                    words.append(
                        f"{s.key} ({s.source}) is said to be in {si} but looks like {deg} ({guess.reason}); "
                        f'if it is, give unit = "{deg}" in a column map'
                    )
                    break
                if s.unit == deg and unit == "rad":
                    words.append(
                        f"{s.key} ({s.source}) is said to be in {deg} but looks like {si} ({guess.reason}); "
                        f'if it is, give unit = "{si}" in a column map'
                    )
                    break
    return [replace(s, unit=settled.get(s.key, s.unit)) for s in series], words


def _guess(group: dict[tuple[str, int], Series], kind: str) -> tuple[UnitGuess, str]:
    """Judge by the first axis that tells."""
    last = UnitGuess("", "", "")
    for axis in range(3):
        angle, rate = group.get(("angle", axis)), group.get(("rate", axis))
        main = angle if kind == "angle" else rate
        if main is None:
            continue
        clock = (angle or main).time
        a = None if angle is None else _near_unwrapped(angle.values.astype(np.float64))
        if rate is None:
            r = None
        elif rate.time is clock:
            r = rate.values.astype(np.float64)
        else:
            known = np.isfinite(rate.values)
            r = np.interp(clock, rate.time[known], rate.values[known]) if known.any() else None
        last = guess_angle_units(clock, a, r, bounded=axis < 2)
        said = last.angle if kind == "angle" else last.rate
        if said:
            return last, said
    return last, ""


def _near_unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take out jumps by a full turn, be it 2 pi or 360."""
    known = np.isfinite(angle)
    out = angle.copy()
    if known.any():
        period = 360.0 if np.ptp(angle[known]) > 4 * np.pi else 2 * np.pi
        out[known] = np.unwrap(angle[known], period=period)
    return out
