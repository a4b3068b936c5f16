"""Column maps: assignment of a foreign log's topics and columns to signals, with unit, sign and notes on guesses.

A map is a TOML file (or a dictionary of the same shape); the built-in maps for PX4 and ArduPilot are such files, too.
It has one table per signal::

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

The value is ``sign * factor * column + offset`` in ``unit``, and is then converted to the signal's SI unit. Without
``unit`` the unit stated by the file or the header is used. Of several entries for one signal the first entry with
existing columns is used.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.errors import InputError
from mufly.files.input_files import read_toml, validate_model
from mufly.logs.channel_checks import UnitGuess, apply_physical_limits, guess_angle_units
from mufly.logs.raw_log import (
    Channel,
    RawLog,
    RawTable,
    select_usable_samples,
    unwrap_angle,
)
from mufly.quantities.quantity_grammar import parse_column_map_lines
from mufly.quantities.quantity_table import find_quantity, parse_column_name, split_signal_name
from mufly.quantities.units import normalise_unit, split_header, unit_conversion
from mufly.rotations import euler_from_unnormalised_quaternion

_BUILTIN_MAPS_FOLDER = files("mufly.logs") / "maps"


class _MapTable(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeEntry(_MapTable):
    """Table ``[time]`` of a column map: the clock of a CSV file."""

    column: str | None = Field(None, description="header of the column that holds the time")
    unit: str | None = Field(None, description="unit of the time, s if left out")
    rate_hz: float | None = Field(None, gt=0, description="rate of the rows, for a table without a clock")


class SignalEntry(_MapTable):
    """Table ``[[signal]]`` of a column map: one signal and its source columns."""

    name: str = Field(description="mufly's name of a whole signal, or with .label of one component")
    columns: tuple[str, ...] = Field(min_length=1, description="columns or fields, one for each component")
    topic: str | None = Field(None, description="topic or message, for logs that have them")
    unit: str | None = Field(None, description="unit of the columns")
    sign: float | tuple[float, ...] = Field(1.0, description="1 or -1, for all components or for each")
    factor: float = Field(1.0, description="factor before the conversion of the unit")
    offset: float = Field(0.0, description="added after sign and factor, in the unit of the column")
    quaternion: bool = Field(False, description="four columns w, x, y, z become roll, pitch, yaw")
    hold: bool = Field(False, description="hold the last value between samples instead of interpolating")
    absent: tuple[str, ...] = Field((), description="columns that must be empty; otherwise the entry is skipped")
    long_name: str = Field("", description="what the signal means")

    @model_validator(mode="after")
    def _check_components(self) -> SignalEntry:
        try:
            signal, _, label = split_signal_name(self.name, "map")
        except InputError as error:
            raise _entry_error("name", f"{self.name!r} {error.problem}", error.remedy) from None
        if self.quaternion:
            wanted = 4
        elif signal is None or label is not None or signal.dim is None:
            wanted = 1
        else:
            wanted = len(signal.component_labels) or len(self.columns)
        if len(self.columns) != wanted:
            problem = f"{self.name} has {len(self.columns)} columns"
            remedy = f'give {wanted}, or map one component (name = "signal.label")'
            if signal is not None and signal.dim in ("rotor", "servo") and label is None:
                remedy += "; actuator_command has as many components as there are motors"
            raise _entry_error("columns", problem, remedy)
        if isinstance(self.sign, tuple) and len(self.sign) != len(self.columns):
            raise _entry_error(
                "sign",
                f"{len(self.sign)} signs for {len(self.columns)} columns",
                "give one for all, or one for each column",
            )
        return self

    @property
    def column_signs(self) -> tuple[float, ...]:
        """Sign (1 or -1) of each column."""
        return self.sign if isinstance(self.sign, tuple) else (self.sign,) * len(self.columns)


class ColumnMap(_MapTable):
    """Column map: assigns columns of a log to signals, with unit, sign, factor and clock."""

    title: str = ""
    kind: Literal["", "ULog", "DataFlash", "MAVLink tlog", "Crazyflie"] = ""
    time: TimeEntry = TimeEntry(column=None, unit=None, rate_hz=None)
    signal: tuple[SignalEntry, ...] = ()


def _entry_error(key: str, problem: str, remedy: str) -> PydanticCustomError:
    return PydanticCustomError("mufly", "{problem}", {"problem": problem, "remedy": remedy, "key": key})


def load_column_map(columns: str | Path | Mapping[str, Any] | Sequence[str] | ColumnMap) -> ColumnMap:
    """Read a column map.

    Parameters
    ----------
    columns : path, name, mapping, sequence of str or ColumnMap
        A TOML file; the name of a built-in map; a mapping, either of the shape of such a file or just
        ``{"measured_rates.p": "gyro_x(deg/s)"}``; or texts as on the command line,
        ``"measured_rates.p=-gyro_x(deg/s)"`` (:func:`mufly.quantities.quantity_grammar.parse_column_map_lines`);
        ``time`` stands for the clock.

    Raises
    ------
    InputError
        For the first fault of the map.
    """
    if isinstance(columns, ColumnMap):
        return columns
    if isinstance(columns, str | Path):
        return validate_model(ColumnMap, *read_toml(columns, _BUILTIN_MAPS_FOLDER, "column map"))
    tables: dict[str, Any] = {"signal": []}
    if isinstance(columns, Mapping):
        if not columns or set(columns) <= set(ColumnMap.model_fields):
            return validate_model(ColumnMap, columns, "column map")
        tables["signal"] = [{"name": name, **entry} for name, entry in columns.items() if isinstance(entry, Mapping)]
        columns = {name: entry for name, entry in columns.items() if not isinstance(entry, Mapping)}
    for line in parse_column_map_lines(columns):
        if line.name == "time":
            tables["time"] = {"column": ",".join(line.columns), "unit": line.unit or None}
            continue
        entry = {"name": line.name, "columns": line.columns, "sign": line.signs, "unit": line.unit or None}
        tables["signal"].append(entry | ({"topic": line.topic} if line.topic else {}))
    return validate_model(ColumnMap, tables, "column map")


_ANGLE_LABELS, _RATE_LABELS = ("roll", "pitch", "yaw"), ("p", "q", "r")
_ANGLE_ALIASES = {
    "roll": "roll",
    "phi": "roll",
    "pitch": "pitch",
    "theta": "pitch",
    "yaw": "yaw",
    "psi": "yaw",
}
_ChannelsByRole = dict[tuple[str, int], Channel]


def _signal_unit(variable: str) -> str:
    known = find_quantity(variable)
    return known.units if known is not None else ""


def _convert_to_si(c: Channel) -> Channel:
    """Convert to the signal's SI unit and unwrap angles; unknown units are unchanged."""
    if c.is_text:
        return c
    wanted = _signal_unit(c.signal_name) or None
    unit = c.units or wanted or "1"
    values = c.values.astype(np.float64)
    # Hertz of an unknown signal is a frequency, not a rotational speed, for which headers use rps.
    if unit != wanted and (wanted is not None or (normalise_unit(unit) and unit != "Hz")):
        try:
            unit, factor, offset = unit_conversion(unit, wanted)
        except InputError as error:
            raise InputError(c.source, c.name, f"the unit {unit!r} {error.problem}", error.remedy) from None
        values = values * factor + offset
    angle = c.signal_name.endswith("_attitude") or (c.component_label is None and c.signal_name in _ANGLE_ALIASES)
    return c._replace(units=unit, values=unwrap_angle(values) if angle and unit == "rad" else values)


def _attitude_role(c: Channel) -> tuple[str, str, int] | None:
    """Return prefix, kind and axis of a channel: ("measured", "angle", 0) for roll, None if not attitude or rates."""
    prefix, _, kind = c.signal_name.partition("_")
    if kind == "attitude" and c.component_label in _ANGLE_LABELS:
        return prefix, "angle", _ANGLE_LABELS.index(c.component_label)
    if kind == "rates" and c.component_label in _RATE_LABELS:
        return prefix, "rate", _RATE_LABELS.index(c.component_label)
    if c.component_label is None and c.signal_name.lower() in _ANGLE_ALIASES:
        return "", "angle", _ANGLE_LABELS.index(_ANGLE_ALIASES[c.signal_name.lower()])
    if c.component_label is None and c.signal_name in _RATE_LABELS:
        return "", "rate", _RATE_LABELS.index(c.signal_name)
    return None


def _determine_angle_units(channels: list[Channel]) -> tuple[list[Channel], list[str]]:
    """Guess missing units of angles and rates, and check stated units; return the channels and notes on guesses."""
    groups: dict[str, _ChannelsByRole] = {}
    for c in channels:
        role = _attitude_role(c)
        if role is not None and not c.is_text:
            groups.setdefault(role[0], {})[role[1], role[2]] = c
    settled: dict[str, str] = {}
    words: list[str] = []
    for prefix in sorted(groups, key=lambda p: p != "measured"):
        group = groups[prefix]
        in_degrees = {c.units for c in group.values()} == {"deg", "deg/s"}
        for kind, named, si, deg in (
            ("angle", "attitude", "rad", "deg"),
            ("rate", "rates", "rad/s", "deg/s"),
        ):
            members = [c for (k, _), c in group.items() if k == kind]
            if not members:
                continue
            what = members[0].signal_name if prefix else ", ".join(c.signal_name for c in members)
            unnamed = [c for c in members if not c.units]
            guess, unit = _guess_group_unit(group, kind, named=not unnamed)
            if unnamed:
                like = settled.get(groups.get("measured", {}).get((kind, 0), unnamed[0]).name, "")
                chosen = {"deg": deg, "rad": si}.get(unit) or like or si
                why = guess.reason if unit else f"as in measured_{named}"
                if not unit and not like:
                    why = "not contradicted by the data"
                words.append(f"{what} names no unit and is taken to be in {chosen} ({why})")
                settled |= {c.name: chosen for c in unnamed}
            # Angle and rate that agree in degrees do not contradict stated units.
            agreed = in_degrees and guess.angle == guess.rate
            for c in members:
                other = {(si, "deg"): deg, (deg, "rad"): si}.get((c.units, unit))
                if other and not agreed:
                    words.append(
                        f"{c.name} ({c.source}) is said to be in {c.units} but looks like {other} ({guess.reason}); "
                        f'if it is, give unit = "{other}" in a column map'
                    )
                    break
            if kind == "rate" and guess.is_contradictory:
                angle = next(c for (k, _), c in group.items() if k == "angle")
                which = f"{members[0].signal_name} by its size" if guess.rate else "one of the two"
                words.append(
                    f"{angle.signal_name} ({angle.source}) and {members[0].signal_name} ({members[0].source}) "
                    f"do not belong "
                    f"together ({guess.reason}): the unit of {which} is wrong; give it in a column map"
                )
    return [c._replace(units=settled.get(c.name, c.units)) for c in channels], words


def _guess_group_unit(group: _ChannelsByRole, kind: str, named: bool) -> tuple[UnitGuess, str]:
    """Return the unit of angles or rates as guessed from the first axis (roll, pitch, yaw) whose data decide.

    A rate reference is the output of the attitude controller, not the derivative of the attitude reference. A roll
    angle with stated unit may be unwrapped; pitch stays within half a turn.
    """
    last = UnitGuess("", "", "")
    apart = any(c.signal_name.startswith("reference_") for c in group.values())
    for axis in range(3):
        angle, rate = group.get(("angle", axis)), group.get(("rate", axis))
        main = angle if kind == "angle" else rate
        if main is None:
            continue
        clock = (angle or main).time
        a = r = None
        if angle is not None:  # unwrap jumps of 2 pi or 360
            a = angle.values.astype(np.float64)
            known = a[np.isfinite(a)]
            a = unwrap_angle(a, 360.0 if len(known) and np.ptp(known) > 4 * np.pi else 2 * np.pi)
        if apart and kind == "angle":
            rate = None
        elif apart:
            a = None
        if rate is not None and rate.time is clock:
            r = rate.values.astype(np.float64)
        elif rate is not None:
            there = np.isfinite(rate.values)
            r = np.interp(clock, rate.time[there], rate.values[there]) if there.any() else None
        last = guess_angle_units(clock, a, r, bounded=axis == 1 if named else axis < 2, named=named)
        said = last.angle if kind == "angle" else last.rate
        if said or last.is_contradictory:
            return last, said
    return last, ""


def extract_mapped_channels(
    raw: RawLog, given: ColumnMap | None, standard: ColumnMap | None, wanted: tuple[str, ...] = ()
) -> tuple[list[Channel], list[str]]:
    """Return the signals of a log as channels in SI units, by column maps.

    Parameters
    ----------
    raw : RawLog
    given : ColumnMap, optional
        Map of the user; its columns must exist.
    standard : ColumnMap, optional
        Map for signals that the user's map does not name; missing columns are skipped. A log with a single table also
        gives its columns by their own names: all of them without a map of the user, else only standard signal names.
    wanted : tuple of str
        Names chosen by the user; ``topic/field`` reads a field without conversion.

    Returns
    -------
    channels : list of Channel
        Channels in SI units, with unwrapped angles.
    words : list of str
        Notes on guesses and repairs.

    Raises
    ------
    InputError
        If the user's map names a missing column, a unit is unknown, or a clock cannot be repaired.
    """
    out: dict[str, Channel] = {}
    words: list[str] = []
    clocks: dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]] = {}

    def select_clock_samples(table: RawTable) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        if table.name not in clocks:
            index, said = select_usable_samples(table.time, raw.path, table.name if len(raw) > 1 else "")
            words.extend(said)
            clocks[table.name] = index, table.time[index]
        return clocks[table.name]

    entries = [(e, True) for e in (given.signal if given else ())]
    entries += [(e, False) for e in (standard.signal if standard else ())]
    used: set[tuple[str, str]] = set()
    ours_by_guess: set[str] = set()
    for entry, must in entries:
        found = _resolve_map_entry(raw, entry, must)
        if found is None:
            continue
        table, entry, names = found
        used |= {(table.name, n) for n in names}
        for channel in _make_channels(table, entry, names, *select_clock_samples(table), believed=must):
            if channel.name not in out:
                out[channel.name] = channel
                ours_by_guess |= set() if must else {channel.signal_name}
    if len(raw) == 1 and standard is None:
        table = next(iter(raw.values()))
        index, time = select_clock_samples(table)
        for name, values in table.fields.items():
            ours = parse_column_name(name)
            if (table.name, name) in used or (ours is None and given is not None):
                continue
            variable, label = ours or (_to_identifier(name), None)
            unit = _normalise_unit(table.units.get(name, ""))
            unit = "1" if not unit and ours and _signal_unit(variable) == "1" else unit
            key = f"{variable}.{label}" if label else variable
            one = Channel(key, unit, time, values[index], name, long_name="" if ours else name)
            out.setdefault(key, one)
    for name in wanted:
        if "/" in name:
            table, field = find_raw_field(raw, name)
            index, time = select_clock_samples(table)
            unit = _normalise_unit(table.units.get(field, ""))
            variable = _to_identifier(f"{table.name}_{field}")
            values = table.fields[field][index]
            out[variable] = Channel(variable, unit, time, values, name, long_name=name)
    settled, said = _determine_angle_units(list(out.values()))
    shares, called = _rename_normalised_outputs([_convert_to_si(c) for c in settled])
    sound, beyond = apply_physical_limits(shares, lambda c: c.signal_name in ours_by_guess)
    return sound, words + said + called + beyond + _describe_unknown_units(sound)


def _describe_unknown_units(channels: list[Channel]) -> list[str]:
    """Return a sentence about units that are not in the table of units."""
    found: dict[str, str] = {}
    for c in channels:
        if c.units and not c.is_text and not normalise_unit(c.units) and c.units != _signal_unit(c.signal_name):
            found.setdefault(c.units, c.name)
    if not found:
        return []
    named = ", ".join(f"{unit} ({name})" for unit, name in list(found.items())[:8])
    return [f"unknown units, values unchanged: {named}{', ...' if len(found) > 8 else ''}"]


def _rename_normalised_outputs(channels: list[Channel]) -> tuple[list[Channel], list[str]]:
    """Rename actuator outputs that never exceed 1 to commands, because no pulse is that short."""
    outputs = [c for c in channels if c.signal_name == "actuator_output" and not c.is_text]
    largest = max((float(np.nanmax(np.abs(c.values))) for c in outputs if np.isfinite(c.values).any()), default=0.0)
    if not 0 < largest <= 1:
        return channels, []
    known = {c.name for c in channels}
    out = []
    for c in channels:
        if c.signal_name == "actuator_output":
            name = f"actuator_command.{c.component_label}"
            if name in known:
                continue
            c = c._replace(name=name, units="1")
        out.append(c)
    return out, [
        f"{outputs[0].source} holds fractions of the full output instead of pulse lengths: mapped to actuator_command"
    ]


def find_raw_field(raw: RawLog, name: str) -> tuple[RawTable, str]:
    """Return the table of a log and the name of its field that ``topic/field`` denotes.

    Raises
    ------
    InputError
        If the topic or the field does not exist; the error suggests similar names.
    """
    topic, _, field = name.rpartition("/")
    if topic not in raw and f"/{topic.lstrip('/')}" in raw:
        topic = f"/{topic.lstrip('/')}"
    if topic not in raw:
        raise InputError(raw.path, name, "there is no such topic", _suggest_names(topic, list(raw), "topics"))
    if field not in raw[topic].fields:
        remedy = _suggest_names(field, list(raw[topic].fields), "fields")
        raise InputError(raw.path, name, f"topic {topic} has no such field", remedy)
    return raw[topic], field


def _suggest_names(name: str, known: list[str], what: str) -> str:
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    shown = near or known[:10]
    more = f" and {len(known) - 10} more" if not near and len(known) > 10 else ""
    return f"{'did you mean' if near else f'{what} are:'} {', '.join(shown)}{more}{'?' if near else ''}"


def _resolve_map_entry(raw: RawLog, entry: SignalEntry, must: bool) -> tuple[RawTable, SignalEntry, list[str]] | None:
    """Return the table and field names of a column map's entry, and the entry with the columns that exist.

    None if its fields are missing or empty; an error if they ``must`` exist.
    """
    if entry.topic is None and len(raw) != 1:
        problem = f"{entry.name} names no topic, and the log has {len(raw)}"
        raise InputError(raw.path, entry.name, problem, f"add topic = ..., one of: {', '.join(list(raw)[:8])}")
    topic = entry.topic if entry.topic is not None else next(iter(raw))
    if topic not in raw:
        if must:
            raise InputError(raw.path, topic, "there is no such topic", _suggest_names(topic, list(raw), "topics"))
        return None
    table = raw[topic]
    if any(c in table.fields and _has_value(table.fields[c]) for c in entry.absent):
        return None
    known = find_quantity(entry.name)
    if not must and known is not None and known.dim and not known.component_labels:
        # A signal with any number of channels uses the leading channels that exist in the topic.
        there = tuple(takewhile(lambda c: c in table.fields and _has_value(table.fields[c]), entry.columns))
        entry = entry.model_copy(update={"columns": there}) if there else entry
    low = {name.lower(): name for name in table.fields}
    names = []
    for column in entry.columns:
        bare = split_header(column)[0]
        name = next((n for n in (column, bare) if n in table.fields), low.get(column.lower(), low.get(bare.lower())))
        if name is None:
            if must:
                remedy = _suggest_names(column, list(table.fields), "columns")
                raise InputError(raw.path, column, "there is no such column", remedy)
            return None
        names.append(name)
    if entry.quaternion and not must:
        block = np.column_stack([table.fields[n] for n in names])
        if not np.isfinite(euler_from_unnormalised_quaternion(block)).any():
            return None
    return table, entry, names


def _has_value(values: NDArray[Any]) -> bool:
    return values.dtype.kind in "US" or bool(np.isfinite(values.astype(np.float64)).any())


def _make_channels(
    table: RawTable,
    entry: SignalEntry,
    names: list[str],
    index: NDArray[np.int64],
    time: NDArray[np.float64],
    *,
    believed: bool,
) -> list[Channel]:
    """Return the channels of one entry of a column map, a channel for each component.

    A unit stated in the file takes precedence over the map's, unless the map is ``believed``.
    """
    signal, variable, label = split_signal_name(entry.name, "map")
    columns = [table.fields[n][index] for n in names]
    own = [_normalise_unit(table.units.get(n, "")) for n in names]
    units = [
        (normalise_unit(entry.unit) or entry.unit)
        if entry.unit and (believed or not _same_dimension(u, entry.unit))
        else u
        for u in own
    ]
    # A unit in the column name of the map counts, too.
    units = [u or split_header(c)[1] for u, c in zip(units, entry.columns, strict=True)]
    if entry.quaternion:
        values = euler_from_unnormalised_quaternion(np.column_stack(columns).astype(np.float64))
        columns, units, sources = list(values.T), ["rad"] * 3, [f"{table.name}/{names[0]}.."] * 3
        signs: tuple[float, ...] = (1.0, 1.0, 1.0) if isinstance(entry.sign, float) else entry.column_signs[1:]
    else:
        sources, signs = [f"{table.name}/{n}" for n in names], entry.column_signs
    if label is not None:
        labels: list[str | None] = [label]
    elif signal is None or signal.dim is None:
        labels = [None]
    else:
        first = 0 if signal.dim == "beam" else 1
        labels = [str(k) for k in (signal.component_labels or range(first, first + len(columns)))]
    out = []
    for one, column, unit, sign, source in zip(labels, columns, units, signs, sources, strict=True):
        if column.dtype.kind not in "US":
            column = sign * entry.factor * column.astype(np.float64) + entry.offset
        name = f"{variable}.{one}" if one else variable
        out.append(Channel(name, unit, time, column, source, entry.hold, entry.long_name))
    return out


def _same_dimension(unit: str, other: str) -> bool:
    return (
        bool(normalise_unit(unit) and normalise_unit(other)) and unit_conversion(unit)[0] == unit_conversion(other)[0]
    )


def _to_identifier(name: str) -> str:
    text = re.sub(r"\W+", "_", name).strip("_") or "signal"
    text = "time_column" if text == "time" else text  # avoids a clash with the clock
    return f"_{text}" if text[0].isdigit() else text


def _normalise_unit(unit: str) -> str:
    return normalise_unit(unit) or unit
