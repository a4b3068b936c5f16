"""Signals of any log as a recording of ours: MCAP, to be opened in Foxglove and PlotJuggler.

Floating-point signals over time, the state of the mission and events go into the file; other text does not (a recording
has one text, the state). A variable without a name of ours travels in the topic ``/signals``.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import orjson
import xarray as xr

from mufly.errors import InputError
from mufly.logs.flat import plain
from mufly.logs.layout import LABELS, QUANTITIES, Layout, Quantity
from mufly.logs.mcap_file import McapFile
from mufly.logs.messages import TopicEncoder
from mufly.logs.recording import FORMAT, METADATA_FLIGHT, METADATA_LAYOUT, METADATA_OUTCOME, events_of, seal

__all__ = ["layout_of", "write_mcap"]

_BLOCK_ROWS = 1000
_TOPICS = {"truth": "/truth", "measured": "/measured", "estimated": "/estimated", "reference": "/reference"}


def layout_of(dataset: xr.Dataset) -> Layout:
    """Return the columns of a recording that holds a dataset's numbers over time."""
    known = {q.name: q for q in QUANTITIES}
    found: list[Quantity] = []
    labels: dict[str, tuple[Any, ...]] = {}
    beams = 0
    for key, variable in dataset.data_vars.items():
        name = str(key)
        if "time" not in variable.dims or variable.ndim > 2 or variable.dtype.kind not in "fiub":
            continue
        dim = next((str(d) for d in variable.dims if d != "time"), None)
        here = () if dim is None else tuple(dataset[dim].values.tolist())
        units, meaning = str(variable.attrs.get("units", "1")), str(variable.attrs.get("long_name", name))
        prefix, _, rest = name.partition("_")
        if name in known and known[name].dim == dim:
            quantity = known[name]
            quantity = Quantity(name, quantity.topic, quantity.field, dim, units, meaning)
        elif prefix in _TOPICS and rest:
            quantity = Quantity(name, _TOPICS[prefix], rest, dim, units, meaning)
        else:
            quantity = Quantity(name, "/signals", name, dim, units, meaning)
        if dim == "beam":
            beams = len(here)
        elif dim is not None and LABELS.get(dim) != here:
            labels[dim] = here
        found.append(quantity)
    order = {topic: k for k, topic in enumerate(dict.fromkeys(q.topic for q in found))}
    found.sort(key=lambda q: order[q.topic])
    return Layout(tuple(found), beams, tuple(labels.items()))


def write_mcap(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as a recording, which :func:`mufly.logs.read_recording` reads back.

    Raises
    ------
    InputError
        If its clock does not increase or it holds no numbers over time.
    """
    layout = layout_of(dataset)
    time = dataset["time"].values.astype(np.float64)
    if not layout.quantities or not len(time):
        raise InputError(
            str(path), "", "there is nothing to write", "choose signals that are numbers over time"
        )
    if not (np.diff(time) > 0).all():
        raise InputError(str(path), "time", "does not increase", "resample it: give a rate")
    rows = np.empty((len(time), layout.width))
    rows[:, 0] = time
    for q in layout.quantities:
        variable = dataset[q.name] if q.dim is None else dataset[q.name].transpose("time", q.dim)
        rows[:, layout.columns[q.name]] = variable.values.reshape(len(time), -1)
    states = dataset["mission_state"].values.tolist() if "mission_state" in dataset else [""] * len(time)
    events = events_of(dataset) if "event_time" in dataset else []
    attributes = {"start_time_ns": _start_ns(dataset), "format": FORMAT, **plain(dataset.attrs)}
    attributes.pop("complete", None)
    outcome = {k: attributes.pop(k) for k in ("outcome", "reason") if k in attributes}
    with path.open("wb") as stream:
        file = McapFile(stream, f"mufly {attributes.get('version', '')}".strip())
        encoder = TopicEncoder(file, layout, int(attributes["start_time_ns"]))
        file.write_metadata(METADATA_FLIGHT, seal(_texts(attributes)))
        file.write_metadata(METADATA_LAYOUT, seal({"layout": layout.to_json()}))
        for start in range(0, len(time), _BLOCK_ROWS):
            part = slice(start, start + _BLOCK_ROWS)
            last = start + _BLOCK_ROWS >= len(time)
            until = np.inf if last else time[part][-1]
            now = [e for e in events if e.time_s <= until]
            events = events[len(now) :]
            messages = encoder.messages(rows[part], states[part], now)
            file.write_chunk(sorted(messages, key=lambda m: m[1]))
        file.write_metadata(METADATA_OUTCOME, seal(_texts(outcome)))
        file.finish()


def _texts(content: dict[str, Any]) -> dict[str, str]:
    return {key: orjson.dumps(value).decode() for key, value in content.items()}


def _start_ns(dataset: xr.Dataset) -> int:
    """Wall time of the instant 0; 0 (1970) where nobody knows, so that no date is made up."""
    if "start_time_ns" in dataset.attrs:
        return int(dataset.attrs["start_time_ns"])
    try:
        return round(datetime.fromisoformat(str(dataset.attrs.get("start_time", ""))).timestamp() * 1e9)
    except ValueError:
        return 0
