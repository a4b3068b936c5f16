"""A recording: a labelled table on a clock, in memory, on disk and as CSV.

:mod:`mufly.logs.layout` says what the columns of a flight are. :func:`to_dataset` gives them their names, and
:func:`read_recording` returns the same :class:`xarray.Dataset` from a file, equal to the last bit. JSON has no NaN
and no infinity: both are written ``null`` and come back as NaN.
"""

from __future__ import annotations

import csv
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.layout import QUANTITIES, Event, Layout, Quantity, standard_layout
from mufly.logs.mcap_file import McapContents, read_mcap

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
    if METADATA_LAYOUT not in contents.metadata or METADATA_FLIGHT not in contents.metadata:
        remedy = "give a file written by mufly (its metadata say so)"
        raise InputError(where, "", "is an MCAP file, but no recording of mufly", remedy)
    try:
        layout = Layout.from_json(unseal(contents.metadata[METADATA_LAYOUT])["layout"])
        attributes = _attributes(contents.metadata[METADATA_FLIGHT])
    except (KeyError, TypeError, ValueError) as error:
        problem = f"the description at its beginning is damaged ({error})"
        raise InputError(where, "", problem, "no remedy but another copy of the file") from error
    attributes["complete"] = contents.complete
    try:
        attributes |= _attributes(contents.metadata.get(METADATA_OUTCOME, seal({})))
    except (KeyError, TypeError, ValueError):
        attributes["complete"] = False
    rows, states = _rows(contents, layout)
    if not states:
        raise InputError(where, "", "holds no rows", "the flight ended before its first row was on disk")
    return to_dataset(rows, states, layout, attributes=attributes, events=_events(contents))


def seal(texts: Mapping[str, str]) -> dict[str, str]:
    """Add a checksum: MCAP protects chunks, but not metadata."""
    return {**texts, "crc32": str(zlib.crc32(orjson.dumps(dict(texts), option=orjson.OPT_SORT_KEYS)))}


def unseal(texts: Mapping[str, str]) -> dict[str, str]:
    """Inverse of :func:`seal`; ValueError if the checksum is wrong."""
    content = {key: value for key, value in texts.items() if key != "crc32"}
    if seal(content) != texts:
        raise ValueError("wrong checksum")
    return content


def _attributes(texts: Mapping[str, str]) -> dict[str, Any]:
    return {key: orjson.loads(value) for key, value in unseal(texts).items()}


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
    blocks = [np.array(part[:n], dtype=np.float64) for part in table if n]  # None becomes NaN
    return np.hstack(blocks) if n else np.empty((0, layout.width)), [entry["state"] for entry in clock[:n]]


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
