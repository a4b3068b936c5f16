"""Column maps: which column of a foreign log is which of our signals, in which unit and with which sign.

A map is a TOML file (or a dictionary of the same shape); the maps for PX4 and ArduPilot that come with the package are
such files too. One table a signal::

    [time]
    column = "t"
    unit = "ms"

    [[signal]]
    name = "measured_attitude"        # whole signal: as many columns as it has components
    columns = ["phi", "theta", "psi"]
    unit = "deg"

    [[signal]]
    name = "measured_rates.p"         # or one component
    topic = "gyro"                    # for logs with topics
    columns = ["x"]
    sign = -1

The value is ``sign * factor * column + offset`` in ``unit``, and is then converted to the signal's SI unit. Where
``unit`` is left out, the unit that the file or the header names is used. Of several entries for one signal the first
whose columns are there is taken.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.errors import InputError
from mufly.logs.quality import UnitGuess, guess_angle_units
from mufly.logs.signals import our_name, signal_named, split_name
from mufly.logs.topics import RawLog, RawTable, euler_angles, unwrap, usable_samples
from mufly.tables import builtin_names, read_tables, validated
from mufly.units import conversion, known_unit, split_header

_MAPS = files("mufly.logs") / "maps"
# On a command line: name=column, name=-column, name=topic/column(unit); brackets may be square.
_UNIT = r"[\[(](?P<unit>[^\[\]()]*[^\d\[\]()][^\[\]()]*)[\])]"
_SHORT = re.compile(rf"^(?P<sign>-?)(?:(?P<topic>[^/\[(]+)/)?(?P<column>.+?)(?:{_UNIT})?$")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeEntry(_Table):
    """``[time]``: the clock of a CSV file."""

    column: str | None = Field(None, description="header of the column that holds the time")
    unit: str | None = Field(None, description="unit of the time, s if left out")
    rate_hz: float | None = Field(None, gt=0, description="rate of the rows, for a table without a clock")


class SignalEntry(_Table):
    """``[[signal]]``: one signal and where it comes from."""

    name: str = Field(description="our name, of a whole signal or with .label of one component")
    columns: tuple[str, ...] = Field(min_length=1, description="columns or fields, one a component")
    topic: str | None = Field(None, description="topic or message, for logs that have them")
    unit: str | None = Field(None, description="unit of the columns")
    sign: float | tuple[float, ...] = Field(1.0, description="1 or -1, for all components or for each")
    factor: float = Field(1.0, description="factor before the conversion of the unit")
    offset: float = Field(0.0, description="added after sign and factor, in the unit of the column")
    quaternion: bool = Field(False, description="four columns w, x, y, z become roll, pitch, yaw")
    hold: bool = Field(False, description="hold the last value between samples instead of interpolating")
    long_name: str = Field("", description="what the signal means")

    @model_validator(mode="after")
    def _components(self) -> SignalEntry:
        try:
            signal, _, label = split_name(self.name, "map")
        except InputError as error:
            raise _wrong("name", f"{self.name!r} {error.problem}", error.remedy) from None
        if self.quaternion:
            wanted = 4
        elif signal is None or label is not None or signal.dim is None:
            wanted = 1
        else:
            wanted = len(signal.labels) or len(self.columns)
        if len(self.columns) != wanted:
            problem = f"{self.name} has {len(self.columns)} columns"
            raise _wrong("columns", problem, f'give {wanted}, or map one component (name = "signal.label")')
        if isinstance(self.sign, tuple) and len(self.sign) != len(self.columns):
            raise _wrong("sign", f"{len(self.sign)} signs", "give one, or one a column")
        return self

    @property
    def signs(self) -> tuple[float, ...]:
        """One sign a column."""
        return self.sign if isinstance(self.sign, tuple) else (self.sign,) * len(self.columns)


class ColumnMap(_Table):
    """A column map; see the module's documentation."""

    title: str = ""
    kind: Literal["", "ULog", "DataFlash", "MAVLink tlog"] = ""
    time: TimeEntry = TimeEntry(column=None, unit=None, rate_hz=None)
    signal: tuple[SignalEntry, ...] = ()


def _wrong(key: str, problem: str, remedy: str) -> PydanticCustomError:
    return PydanticCustomError("mufly", "{problem}", {"problem": problem, "remedy": remedy, "key": key})


def builtin_maps() -> list[str]:
    """Names of the maps that come with the package."""
    return builtin_names(_MAPS)


def load_map(columns: str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap) -> ColumnMap:
    """Read a column map.

    Parameters
    ----------
    columns : path, name, mapping, sequence of str or ColumnMap
        A TOML file; the name of a built-in map; a mapping, either of the shape of such a file or just
        ``{"measured_rates.p": "gyro_x[deg/s]"}``; or texts as on the command line,
        ``"measured_rates.p=-gyro_x[deg/s]"``. In the short form a column may have a sign before it, a topic and a
        slash, and its unit in brackets behind it; several columns of a whole signal stand between commas;
        ``time`` stands for the clock.

    Raises
    ------
    InputError
        Naming the first fault.
    """
    if isinstance(columns, ColumnMap):
        return columns
    if isinstance(columns, str | Path):
        tables, where = read_tables(columns, _MAPS, "column map")
        return validated(ColumnMap, tables, where)
    if isinstance(columns, Mapping):
        if not columns or set(columns) <= set(ColumnMap.model_fields):
            return validated(ColumnMap, columns, "column map")
        pairs = list(columns.items())
    else:
        pairs = []
        for text in columns:
            name, found, column = text.partition("=")
            if not found:
                problem = "does not say which column"
                raise InputError(
                    "--column", text, problem, "write NAME=COLUMN, measured_rates.p=gyro_x[deg/s]"
                )
            pairs.append((name.strip(), column.strip()))
    return validated(ColumnMap, _from_pairs(pairs), "column map")


def _from_pairs(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    tables: dict[str, Any] = {"signal": []}
    for name, value in pairs:
        if isinstance(value, Mapping):
            tables["signal"].append({"name": name, **value})
            continue
        match = _SHORT.match(str(value))
        if match is None:
            raise InputError("--column", name, f"{value!r} names no column", "write COLUMN or COLUMN[unit]")
        if name == "time":
            tables["time"] = {"column": match["column"], "unit": match["unit"]}
            continue
        entry = {"name": name, "columns": match["column"].split(","), "unit": match["unit"]}
        if match["sign"]:
            entry["sign"] = -1.0
        if match["topic"]:
            entry["topic"] = match["topic"]
        tables["signal"].append(entry)
    return tables


# ----------------------------------------------------------------------------
# One component of a signal on its own clock, and its units: converted, or guessed for angles and said.


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


def unit_of(variable: str) -> str:
    signal = signal_named(variable)
    return signal.units if signal is not None else ""


def in_si(series: Series) -> Series:
    """Convert to the signal's unit; units that nobody knows stay as they are."""
    if series.values.dtype.kind in "US":
        return series
    wanted = unit_of(series.variable) or None
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


def without_jumps(series: Series) -> Series:
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


def settle_angles(series: list[Series]) -> tuple[list[Series], list[str]]:
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


# ----------------------------------------------------------------------------
# From topics to signals: a column map applied to a log, with units converted and what was guessed said in words.


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
