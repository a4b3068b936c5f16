"""What a recording holds: one table of quantities, from which everything else derives.

A flight is a row of float64 values every sampling instant: column 0 is the time (s), the others are the
quantities in the order of the table. The table says the unit of each, its labelled dimension, and in which
topic of the file it travels. The writer, the schemas inside the file, the reader, the CSV header and
``docs/recordings.md`` follow it; a file carries its own copy, so that it stays readable when the table grows.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import orjson
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """One quantity of a recording.

    Attributes
    ----------
    name : str
        Variable of the dataset (``truth_position``).
    topic, field : str
        Where it travels in the file (``/truth``, ``position``).
    dim : str or None
        Its labelled dimension besides time (see :data:`LABELS`), None for a scalar.
    units, long_name : str
        Written to the variable's attributes, the schema and the CSV header; ``"1"`` is a pure number.
    """

    name: str
    topic: str
    field: str
    dim: str | None
    units: str
    long_name: str


LABELS: dict[str, tuple[str, ...] | tuple[int, ...]] = {
    "axis": ("N", "E", "D"),
    "angle": ("roll", "pitch", "yaw"),
    "rate": ("p", "q", "r"),
    "rotor": ("upper", "lower"),
    "servo": (1, 2),
    "body": ("x", "y", "z"),
    "control": ("roll", "pitch", "yaw", "thrust"),
}
"""Labels of every dimension but ``beam`` and ``channel``, which count from 0 and from 1."""

_cg = "of the centre of gravity"
QUANTITIES: tuple[Quantity, ...] = (
    Quantity("truth_position", "/truth", "position", "axis", "m", f"true position {_cg}"),
    Quantity("truth_velocity", "/truth", "velocity", "axis", "m/s", f"true velocity {_cg}"),
    Quantity("truth_attitude", "/truth", "attitude", "angle", "rad", "true attitude"),
    Quantity("truth_rates", "/truth", "rates", "rate", "rad/s", "true body rates"),
    Quantity("truth_rotor_speed", "/truth", "rotor_speed", "rotor", "rad/s", "true rotor speed"),
    Quantity("wind", "/truth", "wind", "axis", "m/s", "velocity of the air"),
    Quantity("measured_position", "/measured", "position", "axis", "m", f"measured position {_cg}"),
    Quantity("measured_velocity", "/measured", "velocity", "axis", "m/s", f"measured velocity {_cg}"),
    Quantity("measured_attitude", "/measured", "attitude", "angle", "rad", "measured attitude"),
    Quantity("measured_rates", "/measured", "rates", "rate", "rad/s", "measured body rates"),
    Quantity("reference_position", "/reference", "position", "axis", "m", "reference position"),
    Quantity("reference_velocity", "/reference", "velocity", "axis", "m/s", "reference velocity"),
    Quantity("reference_attitude", "/reference", "attitude", "angle", "rad", "commanded attitude"),
    Quantity("motor_input", "/actuators", "motor_input", "rotor", "1", "motor input, 0 to 1"),
    Quantity("servo_input", "/actuators", "servo_input", "servo", "1", "servo input, -1 to 1"),
    Quantity("battery_voltage", "/battery", "voltage", None, "V", "battery terminal voltage"),
    Quantity("battery_current", "/battery", "current", None, "A", "battery current"),
    Quantity("battery_charge", "/battery", "charge", None, "1", "battery charge left, 0 to 1"),
    Quantity("range", "/ranges", "range", "beam", "m", "distance to the nearest obstacle along a beam"),
)
"""The table: what a recording holds, in the order of its columns (column 0 is the time)."""


class Event(NamedTuple):
    """Something that happened: time (s), mission state entered or held, text, level (info, warning, error)."""

    time_s: float
    state: str
    text: str
    level: str = "info"


@dataclass(frozen=True)
class Layout:
    """Which column of a row holds what.

    Attributes
    ----------
    quantities : tuple of Quantity
        In the order of the columns; those of one topic stand together.
    beams : int
        Number of range beams.
    other_labels : tuple of (dim, labels)
        Labels of dimensions that :data:`LABELS` does not have, in recordings made from other people's logs.
    """

    quantities: tuple[Quantity, ...]
    beams: int
    other_labels: tuple[tuple[str, tuple[str, ...] | tuple[int, ...]], ...] = ()

    def __post_init__(self) -> None:
        if list(self.topics) != [topic for topic, _ in groupby(q.topic for q in self.quantities)]:
            raise ValueError("the quantities of a topic must stand together")

    def labels(self, quantity: Quantity) -> tuple[str, ...] | tuple[int, ...]:
        """Labels along the quantity's dimension; empty for a scalar."""
        if quantity.dim is None:
            return ()
        if quantity.dim == "beam":
            return tuple(range(self.beams))
        return dict(self.other_labels).get(quantity.dim) or LABELS[quantity.dim]

    @cached_property
    def columns(self) -> dict[str, slice]:
        """Columns of each variable in a row, ``{"truth_position": slice(1, 4), ...}``; time is column 0."""
        found: dict[str, slice] = {}
        first = 1
        for quantity in self.quantities:
            width = len(self.labels(quantity)) if quantity.dim else 1
            found[quantity.name] = slice(first, first + width)
            first += width
        return found

    @cached_property
    def width(self) -> int:
        """Number of columns of a row, the time included."""
        return max((part.stop for part in self.columns.values()), default=1)

    @cached_property
    def topics(self) -> dict[str, tuple[Quantity, ...]]:
        """The quantities of each topic, in order."""
        names = dict.fromkeys(quantity.topic for quantity in self.quantities)
        return {name: tuple(q for q in self.quantities if q.topic == name) for name in names}

    def to_json(self) -> str:
        """Text form, kept inside every recording."""
        content: dict[str, object] = {"beams": self.beams, "quantities": [asdict(q) for q in self.quantities]}
        if self.other_labels:
            content["labels"] = dict(self.other_labels)
        return orjson.dumps(content).decode()

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Inverse of :meth:`to_json`."""
        content = orjson.loads(text)
        others = tuple((dim, tuple(labels)) for dim, labels in content.get("labels", {}).items())
        return cls(tuple(Quantity(**q) for q in content["quantities"]), int(content["beams"]), others)


def standard_layout(beams: int = 8) -> Layout:
    """Layout of the rows of a flight with ``beams`` range beams (see :data:`QUANTITIES`)."""
    return Layout(QUANTITIES, beams)


# ----------------------------------------------------------------------------
# Names of signals: what they measure, their labels and units, and how they look as one column of a table.
#
# The names are those of our own recordings (:mod:`mufly.logs.signals`), a few more that other vehicles log, and
# whatever a
# user likes to call the rest. ``signal`` names a whole variable, ``signal.label`` one component of it
# (``measured_attitude.roll``).


_PREFIXES = ("truth", "measured", "estimated", "reference")
_KINDS: Mapping[str, tuple[str | None, str, str]] = {
    "position": ("axis", "m", "position"),
    "velocity": ("axis", "m/s", "velocity"),
    "attitude": ("angle", "rad", "attitude"),
    "rates": ("rate", "rad/s", "body rates"),
    "rotor_speed": ("rotor", "rad/s", "rotor speed"),
    "acceleration": ("body", "m/s^2", "specific force along the body axes"),
}
_OTHERS: Mapping[str, tuple[str | None, str, str]] = {
    "actuator_control": ("control", "1", "control to the mixer, -1 to 1"),
    "actuator_output": ("channel", "us", "output to the actuators, pulse length"),
    "pilot_input": ("channel", "us", "channel of the pilot's remote control, pulse length"),
}


class Signal(NamedTuple):
    """A variable: its labelled dimension (None for a scalar), labels (empty: any number), units, meaning."""

    name: str
    dim: str | None
    labels: tuple[str, ...] | tuple[int, ...]
    units: str
    long_name: str


def signal_named(name: str) -> Signal | None:
    """Return what is known of a variable by its name, None for a name of the user's own."""
    for quantity in QUANTITIES:
        if quantity.name == name:
            labels = () if quantity.dim in (None, "beam") else LABELS[str(quantity.dim)]
            return Signal(name, quantity.dim, labels, quantity.units, quantity.long_name)
    prefix, _, rest = name.partition("_")
    if prefix in _PREFIXES and rest in _KINDS:
        dim, units, meaning = _KINDS[rest]
        word = {"truth": "true", "reference": "reference"}.get(prefix, prefix)
        return Signal(name, dim, LABELS[dim] if dim else (), units, f"{word} {meaning}")
    if name in _OTHERS:
        dim, units, meaning = _OTHERS[name]
        return Signal(name, dim, LABELS.get(dim or "", ()), units, meaning)
    return None


def split_name(text: str, where: str) -> tuple[Signal | None, str, str | None]:
    """Split ``"measured_attitude.roll"`` into signal, variable and label.

    Returns
    -------
    signal : Signal or None
        What is known of the variable.
    variable : str
    label : str or None
        None for the whole variable.

    Raises
    ------
    InputError
        If a known variable has no such label.
    """
    variable, _, label = text.partition(".")
    signal = signal_named(variable)
    if signal is not None and label and signal.labels and label not in map(str, signal.labels):
        wanted = ", ".join(f"{variable}.{k}" for k in signal.labels)
        raise InputError(where, text, "is no component of this signal", f"use one of: {wanted}")
    if signal is not None and label and signal.dim is None:
        raise InputError(where, text, "is a scalar", f"write {variable}")
    if signal is None and not variable.isidentifier():
        raise InputError(where, text, "is no name for a signal", "use letters, digits and underscores")
    if label and signal is None:
        raise InputError(where, text, "is not a signal with components", f"write {variable}_{label}")
    return signal, variable, label or None


def is_held(name: str) -> bool:
    """Whether a signal is commanded: it jumps and stands still as it likes, and no outlier or drop-out can be told."""
    return name.startswith(("reference_", "motor_input", "servo_input", "actuator_", "pilot_input"))


# ----------------------------------------------------------------------------
# A labelled dataset as plain columns, and back: what CSV, Parquet and ULog have in common.
#
# A component becomes a column ``variable_label`` (``measured_attitude_roll``). What columns alone cannot say (the
# dataset's attributes, events, labels of a user's own dimensions) travels as one JSON text where the format has room
# for it.


@dataclass(frozen=True)
class FlatColumn:
    """One component of one variable: ``label`` is None for a scalar; text has the dtype str."""

    variable: str
    label: str | int | None
    values: NDArray[Any]
    units: str

    @property
    def name(self) -> str:
        """``variable_label``."""
        return self.variable if self.label is None else f"{self.variable}_{self.label}"


def columns_of(dataset: xr.Dataset) -> list[FlatColumn]:
    """Return the components of every variable over time, in order."""
    out = []
    for key, variable in dataset.data_vars.items():
        name, units = str(key), str(variable.attrs.get("units", "1"))
        if "time" not in variable.dims or variable.ndim > 2:
            continue
        if variable.ndim == 1:
            out.append(FlatColumn(name, None, variable.values, units))
            continue
        dim = next(d for d in variable.dims if d != "time")
        block = variable.transpose("time", dim)
        for k, label in enumerate(block[dim].values.tolist()):
            out.append(FlatColumn(name, label, block.values[:, k], units))
    return out


def our_name(column: str) -> tuple[str, str | None] | None:
    """Split a column ``measured_attitude_roll`` into our variable and label; None if it is none of ours."""
    if signal_named(column) is not None:
        signal = signal_named(column)
        return (column, None) if signal is not None and signal.dim is None else None
    name, _, label = column.rpartition("_")
    signal = signal_named(name) if name else None
    if signal is None or signal.dim is None:
        return None
    if signal.labels:
        return (name, label) if label in map(str, signal.labels) else None
    return (name, label) if label.isdigit() else None


def dataset_of(
    time: NDArray[np.float64],
    columns: Sequence[FlatColumn],
    attributes: Mapping[str, Any] | None = None,
    notes: Mapping[str, Mapping[str, Any]] | None = None,
) -> xr.Dataset:
    """Put columns on one clock together as a dataset; components that are missing are NaN.

    Parameters
    ----------
    time : (n,) array
        s.
    columns : sequence of FlatColumn
        With n values each.
    attributes : mapping, optional
        Of the dataset.
    notes : mapping, optional
        Further attributes, by variable.
    """
    coords: dict[str, Any] = {"time": ("time", time, {"units": "s", "long_name": "time"})}
    variables: dict[str, Any] = {}
    groups: dict[str, list[FlatColumn]] = {}
    for column in columns:
        groups.setdefault(column.variable, []).append(column)
    # Variables that count their channels share that dimension, so it is as long as the longest of them.
    counted: dict[str, list[int]] = {}
    for name, group in groups.items():
        signal = signal_named(name)
        if signal is not None and signal.dim and not signal.labels:
            counted.setdefault(signal.dim, []).extend(int(str(c.label)) for c in group)
    for name, group in groups.items():
        signal = signal_named(name)
        attrs = {"units": group[0].units, "long_name": signal.long_name if signal else name.replace("_", " ")}
        attrs |= dict((notes or {}).get(name, {}))
        if group[0].values.dtype.kind in "US":
            attrs.pop("units")
        if signal is None or signal.dim is None:
            variables[name] = ("time", group[0].values, attrs)
            continue
        labels: tuple[Any, ...] = signal.labels or tuple(sorted(set(counted[signal.dim])))
        coords[signal.dim] = list(labels)
        found = {str(c.label): c.values for c in group}
        missing = np.full(len(time), np.nan)
        block = np.column_stack([found.get(str(k), missing) for k in labels])
        variables[name] = (("time", signal.dim), block, attrs)
    return xr.Dataset(variables, coords, dict(attributes or {}))


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def describe(dataset: xr.Dataset) -> str:
    """Return as JSON what the columns do not say, for :func:`restore`."""
    variables = {}
    for key, variable in dataset.data_vars.items():
        if "time" in variable.dims and variable.ndim <= 2:
            dim = next((str(d) for d in variable.dims if d != "time"), None)
            labels = None if dim is None else plain(variable[dim].values)
            variables[str(key)] = {"dim": dim, "labels": labels, "attrs": plain(variable.attrs)}
    events = {str(k): plain(v.values) for k, v in dataset.data_vars.items() if v.dims == ("event",)}
    content = {"variables": variables, "events": events, "attributes": plain(dataset.attrs)}
    return json.dumps(content)


def restore(time: NDArray[np.float64], columns: Mapping[str, NDArray[Any]], description: str) -> xr.Dataset:
    """Inverse of :func:`columns_of` and :func:`describe`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If columns and description do not belong together.
    """
    content = json.loads(description)
    coords: dict[str, Any] = {"time": ("time", time, {"units": "s", "long_name": "time"})}
    variables: dict[str, Any] = {}
    for name, about in content["variables"].items():
        dim, labels, attrs = about["dim"], about["labels"], about["attrs"]
        if dim is None:
            variables[name] = ("time", columns[name], attrs)
            continue
        known = LABELS.get(dim)
        coords[dim] = list(known) if known and list(map(str, known)) == list(map(str, labels)) else labels
        block = np.column_stack([columns[f"{name}_{label}"] for label in labels])
        variables[name] = (("time", dim), block, attrs)
    for name, values in content["events"].items():
        kind: type = np.float64 if name == "event_time" else str
        attrs = {"units": "s", "long_name": "time of the event"} if name == "event_time" else {}
        variables[name] = ("event", np.array(values, dtype=kind), attrs)
    return xr.Dataset(variables, coords, content["attributes"])
