"""Signal table: layout of rows on one clock, and conversion between datasets and plain columns.

A flight is a row of float64 values every sampling instant: column 0 is the time (s), the others are the quantities
of :mod:`mufly.quantities.quantity_table` in their order. The writer, the schemas inside the file, the reader, the CSV
header and ``docs/reference/recordings.md`` follow a :class:`RecordingLayout`; a file carries its own copy, so that it
stays readable when the table grows.

As a plain column a component is called ``variable_label`` (``measured_attitude_roll``). Information outside the columns
(the dataset's attributes, events, labels of a user's own dimensions) is stored as one JSON text where the format
allows.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
import xarray as xr
from numpy.typing import NDArray

from mufly.logs.raw_log import Channel
from mufly.quantities.quantity_table import DIMENSION_LABELS, Quantity, find_quantity, quantities_recorded_in

_LAYOUT_FIELDS = (
    "name",
    "topic",
    "field",
    "dim",
    "units",
    "long_name",
)  # stored fields of a quantity
_TIME_ATTRIBUTES = {"units": "s", "long_name": "time"}
_EVENT_VARIABLES = ("event_time", "event_state", "event_text", "event_level")


class FlightEvent(NamedTuple):
    """Event of a flight: time (s), mission state, text, level (info, warning, error)."""

    time_s: float
    state: str
    text: str
    level: str = "info"


@dataclass(frozen=True)
class RecordingLayout:
    """Layout of a row of numbers: which quantity each column holds.

    Attributes
    ----------
    quantities : tuple of Quantity
        Quantities in the order of the columns; those of one topic are adjacent.
    beam_count : int
        Number of range beams.
    foreign_labels : tuple of (dim, labels)
        Labels of dimensions that :mod:`mufly.quantities.quantity_table` does not have, in recordings made from foreign
        logs.
    """

    quantities: tuple[Quantity, ...]
    beam_count: int
    foreign_labels: tuple[tuple[str, tuple[str, ...] | tuple[int, ...]], ...] = ()

    def __post_init__(self) -> None:
        if list(self.quantities_by_topic) != [topic for topic, _ in groupby(q.topic for q in self.quantities)]:
            raise ValueError("the quantities of a topic must be neighbours")

    def component_labels(self, quantity: Quantity) -> tuple[str, ...] | tuple[int, ...]:
        """Return the labels along the quantity's dimension; empty for a scalar."""
        if quantity.dim is None:
            return ()
        if quantity.dim == "beam":
            return tuple(range(self.beam_count))
        return dict(self.foreign_labels).get(quantity.dim) or DIMENSION_LABELS[quantity.dim]

    @cached_property
    def column_slices(self) -> dict[str, slice]:
        """Return the columns of each variable in a row, ``{"truth_position": slice(1, 4), ...}``; time is column 0."""
        found: dict[str, slice] = {}
        first = 1
        for quantity in self.quantities:
            width = len(self.component_labels(quantity)) if quantity.dim else 1
            found[quantity.name] = slice(first, first + width)
            first += width
        return found

    @cached_property
    def column_count(self) -> int:
        """Number of columns of a row, time included."""
        return max((part.stop for part in self.column_slices.values()), default=1)

    @cached_property
    def quantities_by_topic(self) -> dict[str, tuple[Quantity, ...]]:
        """Return the quantities of each topic, in order."""
        names = dict.fromkeys(quantity.topic for quantity in self.quantities)
        return {name: tuple(q for q in self.quantities if q.topic == name) for name in names}

    def to_json(self) -> str:
        """Return the layout as JSON text, stored in every recording."""
        content: dict[str, object] = {
            "beams": self.beam_count,
            "quantities": [{k: getattr(q, k) for k in _LAYOUT_FIELDS} for q in self.quantities],
        }
        if self.foreign_labels:
            content["labels"] = dict(self.foreign_labels)
        return orjson.dumps(content).decode()

    @classmethod
    def from_json(cls, text: str) -> RecordingLayout:
        """Return the layout of a JSON text, the inverse of :meth:`to_json`."""
        content = orjson.loads(text)
        others = tuple((dim, tuple(labels)) for dim, labels in content.get("labels", {}).items())
        return cls(tuple(Quantity(**q) for q in content["quantities"]), int(content["beams"]), others)


@cache
def make_flight_row_layout(beams: int = 8, *, sensors: bool = False) -> RecordingLayout:
    """Return the layout of a flight's rows with ``beams`` range beams and, if ``sensors``, sensor models' signals."""
    return RecordingLayout(
        quantities_recorded_in("flight", "sensors") if sensors else quantities_recorded_in("flight"), beams
    )


def rows_to_dataset(
    rows: NDArray[np.float64] | Sequence[NDArray[np.float64]],
    states: Sequence[str],
    layout: RecordingLayout,
    *,
    attributes: Mapping[str, Any] | None = None,
    events: Sequence[FlightEvent] = (),
) -> xr.Dataset:
    """Convert the columns of a flight to a labelled dataset.

    Parameters
    ----------
    rows : (n, layout.width) array, or sequence of such arrays
        One row for each instant, in one block or several; column 0 is the time (s).
    states : sequence of n str
        Mission state at each instant.
    layout : RecordingLayout
        Layout of the columns.
    attributes : mapping, optional
        Attributes of the dataset (vehicle, mission, seed, ...).
    events : sequence of FlightEvent, optional
        Events, which become ``event_time``, ``event_state``, ``event_text``, ``event_level`` over the dimension
        ``event``.

    Returns
    -------
    xarray.Dataset
        Coordinate ``time`` (s); every variable has ``units`` and ``long_name``.
    """
    blocks = [rows] if isinstance(rows, np.ndarray) else rows
    variables: dict[str, Any] = {}
    for quantity in layout.quantities:
        columns = layout.column_slices[quantity.name]
        block = np.concatenate([part[:, columns] for part in blocks])
        attrs = {"units": quantity.units, "long_name": quantity.long_name}
        if quantity.dim is None:
            variables[quantity.name] = ("time", block[:, 0], attrs)
        else:
            variables[quantity.name] = (("time", quantity.dim), block, attrs)
    variables["mission_state"] = ("time", np.array(states, dtype=str), {"long_name": "state of the mission"})
    coordinates = _make_coordinates(np.concatenate([part[:, 0] for part in blocks]), layout)
    return xr.Dataset(variables | make_event_variables(events), coordinates, dict(attributes or {}))


def _make_coordinates(time_s: NDArray[np.float64], layout: RecordingLayout) -> xr.Coordinates:
    """Return the time and the labels of all dimensions of a layout, with their indexes."""
    time = {"time": xr.Variable("time", time_s, _TIME_ATTRIBUTES)}
    index = xr.indexes.PandasIndex.from_variables(time, options={})
    labels = _make_label_coordinates(layout)
    return xr.Coordinates(
        {**index.create_variables(time), **labels.variables}, indexes={"time": index, **labels.xindexes}
    )


@lru_cache(maxsize=32)
def _make_label_coordinates(layout: RecordingLayout) -> xr.Coordinates:
    """Return the labels of all dimensions, cached because indexes of text are slow to make."""
    labels = {q.dim: list(layout.component_labels(q)) for q in layout.quantities if q.dim is not None}
    return xr.Dataset(coords=labels).coords


def make_event_variables(events: Sequence[FlightEvent]) -> dict[str, Any]:
    """Return the variables of a dataset for events, over the dimension ``event``."""
    parts = zip(*events, strict=True) if events else [()] * len(_EVENT_VARIABLES)
    return {name: _event_variable(name, values) for name, values in zip(_EVENT_VARIABLES, parts, strict=True)}


def _event_variable(name: str, values: Sequence[Any]) -> tuple[Any, ...]:
    if name == "event_time":
        attrs = {"units": "s", "long_name": "time of the event"}
        return "event", np.array(values, dtype=np.float64), attrs
    return "event", np.array(values, dtype=str)


def read_events(dataset: xr.Dataset) -> list[FlightEvent]:
    """Return the events of a recording in order of time."""
    parts = (dataset[name].values.tolist() for name in _EVENT_VARIABLES)
    return [FlightEvent(*values) for values in zip(*parts, strict=True)]


def split_dataset_into_channels(dataset: xr.Dataset) -> list[Channel]:
    """Return the components of every variable over time, in order."""
    time = dataset["time"].values
    out = []
    # Variables, not data arrays: xarray searches all n coordinates for each array that it creates.
    for key in dataset.data_vars:
        name, variable = str(key), dataset.variables[key]
        units = str(variable.attrs.get("units", "1"))
        if "time" not in variable.dims or variable.ndim > 2:
            continue
        if variable.ndim == 1:
            out.append(Channel(name, units, time, variable.values))
            continue
        dim = next(d for d in variable.dims if d != "time")
        block = variable.transpose("time", dim).values
        for k, label in enumerate(dataset[dim].values.tolist()):
            out.append(Channel(f"{name}.{label}", units, time, block[:, k]))
    return out


def make_dataset_from_channels(time: NDArray[np.float64], channels: Sequence[Channel]) -> xr.Dataset:
    """Join channels on one clock to a dataset; missing components are NaN.

    Parameters
    ----------
    time : (n,) array
        Time (s).
    channels : sequence of Channel
        Channels with n values each; their own clocks are ignored.
    """
    coords: dict[str, Any] = {"time": ("time", time, _TIME_ATTRIBUTES)}
    variables: dict[str, Any] = {}
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(channel.signal_name, []).append(channel)
    # Variables that number their channels share a dimension, which is as long as the longest of them.
    counted: dict[str, list[int]] = {}
    for name, group in groups.items():
        known = find_quantity(name)
        if known is not None and known.dim and not known.component_labels:
            counted.setdefault(known.dim, []).extend(int(str(c.component_label)) for c in group)
    for name, group in groups.items():
        known, values = find_quantity(name), group[0].values
        attrs = {} if values.dtype.kind in "US" else {"units": group[0].units}
        attrs["long_name"] = known.long_name if known else name.replace("_", " ")
        if known is None or known.dim is None:
            variables[name] = ("time", values, attrs)
            continue
        labels: tuple[Any, ...] = known.component_labels or tuple(sorted(set(counted[known.dim])))
        coords[known.dim] = list(labels)
        found = {c.component_label: c.values for c in group}
        missing = np.full(len(time), np.nan)
        block = np.column_stack([found.get(str(k), missing) for k in labels])
        variables[name] = (("time", known.dim), block, attrs)
    return xr.Dataset(variables, coords)


def to_json_value(value: Any) -> Any:
    """Return a value in a type of JSON."""
    if isinstance(value, Mapping):
        return {str(k): to_json_value(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [to_json_value(v) for v in value]
    if isinstance(value, np.ndarray):
        return to_json_value(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def encode_dataset_metadata(dataset: xr.Dataset) -> str:
    """Return labels, attributes and all else of a dataset but its numbers over time as JSON, for
    :func:`restore_dataset`.
    """
    variables = {}
    for key, variable in dataset.data_vars.items():
        if "time" in variable.dims and variable.ndim <= 2:
            dim = next((str(d) for d in variable.dims if d != "time"), None)
            labels = None if dim is None else to_json_value(variable[dim].values)
            variables[str(key)] = {"dim": dim, "labels": labels, "attrs": to_json_value(variable.attrs)}
    events = {str(k): to_json_value(v.values) for k, v in dataset.data_vars.items() if v.dims == ("event",)}
    content = {"variables": variables, "events": events, "attributes": to_json_value(dataset.attrs)}
    return json.dumps(content)


def restore_dataset(time: NDArray[np.float64], columns: Mapping[str, NDArray[Any]], description: str) -> xr.Dataset:
    """Return the dataset from its numbers over time and the text of :func:`encode_dataset_metadata`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If columns and description do not match.
    """
    content = json.loads(description)
    coords: dict[str, Any] = {"time": ("time", time, _TIME_ATTRIBUTES)}
    variables: dict[str, Any] = {}
    for name, about in content["variables"].items():
        dim, labels, attrs = about["dim"], about["labels"], about["attrs"]
        if dim is None:
            variables[name] = ("time", columns[name], attrs)
            continue
        known = DIMENSION_LABELS.get(dim)
        coords[dim] = list(known) if known and list(map(str, known)) == list(map(str, labels)) else labels
        block = np.column_stack([columns[f"{name}_{label}"] for label in labels])
        variables[name] = (("time", dim), block, attrs)
    for name, values in content["events"].items():
        variables[name] = _event_variable(name, values)
    return xr.Dataset(variables, coords, content["attributes"])


def write_recording_csv(dataset: xr.Dataset, path: str | Path) -> Path:
    """Write a recording as a comma-separated table, one row for each instant.

    The header has variable, label and unit, ``truth_position_N [m]``; a dimensionless number has no unit. Values have
    enough digits to restore the same float64; NaN is an empty cell.

    Returns
    -------
    Path
        The file written.
    """
    channels = [
        Channel("time", "s", dataset["time"].values, dataset["time"].values),
        *split_dataset_into_channels(dataset),
    ]
    header = [c.column_name + (f" [{c.units}]" if c.units != "1" else "") for c in channels]
    columns = [c.values.tolist() for c in channels]
    target = Path(path)
    with target.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        # A value that differs from itself is NaN.
        writer.writerows(["" if v != v else v for v in row] for row in zip(*columns, strict=True))
    return target
