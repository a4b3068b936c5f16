"""A recording: a labelled table on a clock, in memory, on disk and as CSV.

One table (:data:`QUANTITIES`) says which quantities a flight has, in which unit, over which labels, and in
which topic of the file they travel. The writer (:mod:`mufly.flight.recorder`), the schemas inside the file,
the reader and the column headers of the CSV all derive from it, and the file carries its own copy, so that a
recording stays readable when the table grows.

In memory a flight is a row of float64 values every sampling instant: column 0 is the time (s), the others are
the quantities in the order of the table. :func:`to_dataset` gives those columns their names, and
:func:`read_recording` returns the same :class:`xarray.Dataset` from a file, equal to the last bit.
JSON has no NaN and no infinity: both are written ``null`` and come back as NaN.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.flight.mcap_file import McapContents, read_mcap

__all__ = [
    "QUANTITIES",
    "Event",
    "Layout",
    "Quantity",
    "events_of",
    "read_attachments",
    "read_recording",
    "standard_layout",
    "to_csv",
    "to_dataset",
]

FORMAT = 1
CLOCK_TOPIC = "/mission"
EVENT_TOPIC = "/events"
METADATA_FLIGHT = "mufly.flight"
METADATA_LAYOUT = "mufly.layout"
METADATA_OUTCOME = "mufly.outcome"
LEVELS = {"info": 2, "warning": 3, "error": 4}  # of foxglove.Log


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
}
"""Labels of every dimension but ``beam``, which counts from 0."""

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
    """

    quantities: tuple[Quantity, ...]
    beams: int

    def __post_init__(self) -> None:
        if list(self.topics) != [topic for topic, _ in groupby(q.topic for q in self.quantities)]:
            raise ValueError("the quantities of a topic must stand together")

    def labels(self, quantity: Quantity) -> tuple[str, ...] | tuple[int, ...]:
        """Labels along the quantity's dimension; empty for a scalar."""
        if quantity.dim is None:
            return ()
        return tuple(range(self.beams)) if quantity.dim == "beam" else LABELS[quantity.dim]

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
        content = {"beams": self.beams, "quantities": [asdict(q) for q in self.quantities]}
        return orjson.dumps(content).decode()

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Inverse of :meth:`to_json`."""
        content = orjson.loads(text)
        return cls(tuple(Quantity(**q) for q in content["quantities"]), int(content["beams"]))


def standard_layout(beams: int = 8) -> Layout:
    """Layout of the rows of a flight with ``beams`` range beams (see :data:`QUANTITIES`)."""
    return Layout(QUANTITIES, beams)


def to_dataset(
    rows: NDArray[np.float64],
    states: Sequence[str],
    layout: Layout,
    *,
    attributes: Mapping[str, Any] | None = None,
    events: Sequence[Event] = (),
) -> xr.Dataset:
    """Give the columns of a flight their names.

    Parameters
    ----------
    rows : (n, layout.width) array
        One row an instant; column 0 is the time (s).
    states : sequence of n str
        Mission state at each instant.
    layout : Layout
        Which column is what.
    attributes : mapping, optional
        Attributes of the dataset (vehicle, mission, seed, ...).
    events : sequence of Event, optional
        Become ``event_time``, ``event_state``, ``event_text``, ``event_level`` over the dimension ``event``.

    Returns
    -------
    xarray.Dataset
        Coordinate ``time`` (s); every variable has ``units`` and ``long_name``.
    """
    coords: dict[str, Any] = {"time": ("time", rows[:, 0].copy(), {"units": "s", "long_name": "time"})}
    variables: dict[str, Any] = {}
    for quantity in layout.quantities:
        block = rows[:, layout.columns[quantity.name]].copy()
        attrs = {"units": quantity.units, "long_name": quantity.long_name}
        if quantity.dim is None:
            variables[quantity.name] = ("time", block[:, 0], attrs)
        else:
            coords[quantity.dim] = list(layout.labels(quantity))
            variables[quantity.name] = (("time", quantity.dim), block, attrs)
    variables["mission_state"] = ("time", np.array(states, dtype=str), {"long_name": "state of the mission"})
    variables["event_time"] = (
        "event",
        np.array([event.time_s for event in events], dtype=np.float64),
        {"units": "s", "long_name": "time of the event"},
    )
    for part in ("state", "text", "level"):
        variables[f"event_{part}"] = ("event", np.array([getattr(e, part) for e in events], dtype=str))
    return xr.Dataset(variables, coords, dict(attributes or {}))


def events_of(dataset: xr.Dataset) -> list[Event]:
    """The events of a recording, in order of time."""
    parts = (dataset[f"event_{part}"].values.tolist() for part in ("time", "state", "text", "level"))
    return [Event(*values) for values in zip(*parts, strict=True)]


def read_recording(path: str | Path) -> xr.Dataset:
    """Read a recording, finished or cut off at any byte.

    Parameters
    ----------
    path : str or Path
        MCAP file written by :class:`mufly.flight.Recorder`.

    Returns
    -------
    xarray.Dataset
        As :func:`to_dataset` makes it. ``attrs["complete"]`` is False when the file ends before its end mark
        or holds a damaged chunk; everything up to the last whole chunk (at most one second is lost) is there.

    Raises
    ------
    InputError
        No such file, not an MCAP file, not a recording of mufly, or no whole chunk of rows in it.
    """
    where = str(path)
    contents = read_mcap(path)
    try:
        layout = Layout.from_json(contents.metadata[METADATA_LAYOUT]["layout"])
        flight = contents.metadata[METADATA_FLIGHT] | contents.metadata.get(METADATA_OUTCOME, {})
    except KeyError:
        remedy = "give a file written by mufly (its metadata say so)"
        raise InputError(where, "", "is an MCAP file, but no recording of mufly", remedy) from None
    except (ValueError, TypeError) as error:
        raise InputError(
            where, METADATA_LAYOUT, f"cannot be read ({error})", "the file is damaged"
        ) from error
    rows, states = _rows(contents, layout)
    if not states:
        raise InputError(where, "", "holds no rows", "the flight ended before its first row was on disk")
    attributes = {key: orjson.loads(value) for key, value in flight.items()}
    attributes["complete"] = contents.complete
    return to_dataset(rows, states, layout, attributes=attributes, events=_events(contents))


def _rows(contents: McapContents, layout: Layout) -> tuple[NDArray[np.float64], list[str]]:
    """Put the messages of all topics side by side again; every topic has one message a row."""
    clock = [orjson.loads(data) for _, data in contents.messages.get(CLOCK_TOPIC, [])]
    n = len(clock)
    table: list[list[list[float | None]]] = [[[entry["time"]] for entry in clock]]
    for topic, quantities in layout.topics.items():
        messages = contents.messages.get(topic, [])
        n = min(n, len(messages))
        fields = [(q.field, q.dim) for q in quantities]
        part: list[list[float | None]] = []
        for _, data in messages:
            message = orjson.loads(data)
            row: list[float | None] = []
            for field, dim in fields:
                value = message[field]
                if dim is None:
                    row.append(value)
                else:
                    row += value if dim == "beam" else value.values()
            part.append(row)
        table.append(part)
    blocks = [np.array(part[:n], dtype=np.float64).reshape(n, -1) for part in table]  # None becomes NaN
    return np.hstack(blocks), [entry["state"] for entry in clock[:n]]


def _events(contents: McapContents) -> list[Event]:
    entries = (orjson.loads(data) for _, data in contents.messages.get(EVENT_TOPIC, []))
    levels = {number: name for name, number in LEVELS.items()}
    return [Event(e["time"], e["name"], e["message"], levels.get(e["level"], "info")) for e in entries]


def read_attachments(path: str | Path) -> dict[str, bytes]:
    """Files carried inside a recording: ``{"mission.toml": b"...", "vehicle.toml": b"..."}``.

    Raises
    ------
    InputError
        No such file, or not an MCAP file.
    """
    return read_mcap(path).attachments


def to_csv(dataset: xr.Dataset, path: str | Path) -> Path:
    """Write a recording as one comma-separated table, one row an instant.

    The header names variable, label and unit, ``truth_position_N [m]``; a pure number has no unit. Values are
    written with as many digits as bring back the same float64; NaN is an empty cell.

    Returns
    -------
    Path
        The file written.
    """
    header, columns = ["time [s]"], [dataset["time"].values.tolist()]
    for name, variable in dataset.data_vars.items():
        if "time" not in variable.dims:
            continue
        units = variable.attrs.get("units", "1")
        unit = "" if units == "1" else f" [{units}]"
        if variable.ndim == 1:
            header.append(f"{name}{unit}")
            columns.append(variable.values.tolist())
        else:
            for label in variable[variable.dims[1]].values:
                header.append(f"{name}_{label}{unit}")
                columns.append(variable.loc[:, label].values.tolist())
    target = Path(path)
    with target.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        # A value that differs from itself is NaN.
        writer.writerows(["" if v != v else v for v in row] for row in zip(*columns, strict=True))
    return target
