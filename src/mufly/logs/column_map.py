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

import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.errors import InputError
from mufly.logs.signals import split_name
from mufly.tables import builtin_names, read_tables, validated

__all__ = ["ColumnMap", "SignalEntry", "TimeEntry", "builtin_maps", "load_map"]

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
