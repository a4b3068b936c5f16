"""An MCAP file as topics: ours before it becomes a table on one clock, or any other with JSON messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.layout import Layout
from mufly.logs.mcap_file import McapContents, read_mcap
from mufly.logs.raw import RawLog, RawTable
from mufly.logs.recording import METADATA_FLIGHT, METADATA_LAYOUT, unseal

__all__ = ["is_recording", "raw_mcap"]

# A list longer than this is a picture or a cloud of points, no signal.
_LONGEST_LIST = 64
# Topics of ours that hold drawings and words.
_NO_SIGNALS = ("/tf", "/scene", "/track", "/reference_pose", "/events")


def is_recording(contents: McapContents) -> bool:
    """Whether this package wrote the file."""
    return METADATA_LAYOUT in contents.metadata and METADATA_FLIGHT in contents.metadata


def raw_mcap(path: str | Path) -> RawLog:
    """Read the JSON messages of an MCAP file; numbers inside tables become fields ``position.N``.

    Raises
    ------
    InputError
        If it is no MCAP file, or none of its messages is JSON.
    """
    contents = read_mcap(path)
    ours = is_recording(contents)
    stamps = [m[0] for messages in contents.messages.values() for m in messages]
    if not stamps:
        raise InputError(str(path), "", "holds no messages", "the recording ended before its first second")
    zero = min(stamps)
    units = _units(contents) if ours else {}
    tables: dict[str, RawTable] = {}
    unread = []
    for topic, messages in contents.messages.items():
        if not messages or (ours and topic in _NO_SIGNALS):
            continue
        try:
            rows = [dict(_leaves(orjson.loads(data))) for _, data in messages]
        except orjson.JSONDecodeError:
            unread.append(topic)
            continue
        time = (np.array([t for t, _ in messages], dtype=np.int64) - zero) / 1e9
        names = dict.fromkeys(name for row in rows for name in row)
        fields = {name: _values([row.get(name) for row in rows]) for name in names}
        tables[topic] = RawTable(topic, time, fields, units.get(topic, {}))
    if not tables:
        problem = f"holds no JSON messages (topics: {', '.join(unread) or 'none'})"
        raise InputError(str(path), "", problem, "convert its messages to JSON first")
    notes = (f"topics in another encoding than JSON are left out: {', '.join(unread)}",) if unread else ()
    return RawLog(
        path=str(path),
        kind="MCAP",
        tables=tables,
        # A log whose wall time nobody knew begins in 1970.
        start_time=datetime.fromtimestamp(zero / 1e9, UTC).isoformat(timespec="milliseconds")
        if zero > 10**18 // 2
        else "",
        info={"recorded by": "mufly"} if ours else {},
        complete=contents.complete,
        notes=notes,
    )


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _leaves(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        if len(value) <= _LONGEST_LIST:
            for k, inner in enumerate(value):
                yield from _leaves(inner, f"{name}[{k}]")
    else:
        yield name, value


def _values(values: list[Any]) -> NDArray[Any]:
    if any(isinstance(v, str) for v in values):
        return np.array(["" if v is None else str(v) for v in values], dtype=str)
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def _units(contents: McapContents) -> dict[str, dict[str, str]]:
    try:
        layout = Layout.from_json(unseal(contents.metadata[METADATA_LAYOUT])["layout"])
    except (KeyError, TypeError, ValueError):
        return {}
    out: dict[str, dict[str, str]] = {}
    for topic, quantities in layout.topics.items():
        for q in quantities:
            labels = layout.labels(q)
            names = [q.field] if q.dim is None else [f"{q.field}.{k}" for k in labels]
            names = [f"{q.field}[{k}]" for k in labels] if q.dim == "beam" else names
            out.setdefault(topic, {}).update(dict.fromkeys(names, q.units))
    return out
