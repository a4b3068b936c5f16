"""From rows of numbers to the messages of a chunk: every topic of a layout, the clock and the events.

The numbers of a block are written as JSON in one call (orjson prints the shortest text that reads back to the same
float64) and then fitted between constant pieces of text, which spares a dictionary for every message.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from mufly.logs.layout import Event, Layout
from mufly.logs.mcap_file import McapFile
from mufly.logs.recording import CLOCK_TOPIC, EVENT_TOPIC, LEVELS

__all__ = ["TopicEncoder", "json_rows", "json_schema", "stamp"]


def json_schema(properties: dict[str, Any], title: str = "") -> dict[str, Any]:
    """JSON schema of an object with these properties, all required."""
    head = {"title": title} if title else {}
    return {**head, "type": "object", "properties": properties, "required": list(properties)}


def stamp(time_ns: int) -> dict[str, int]:
    """Time of a Foxglove message."""
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}


_text, _integer = {"type": "string"}, {"type": "integer"}
_time = json_schema({"sec": _integer, "nsec": _integer}, "time")
LOG_SCHEMA = json_schema(
    {
        "timestamp": _time,
        "level": _integer,
        "message": _text,
        "name": _text,
        "file": _text,
        "line": _integer,
        "time": {"type": "number", "description": "time since the start of the recording (s)"},
    },
    "foxglove.Log",
)
"""JSON schema of an event (foxglove.Log)."""


class TopicEncoder:
    """Announces the topics of a layout in a file and turns blocks of rows into their messages."""

    def __init__(self, file: McapFile, layout: Layout, start_time_ns: int) -> None:
        self._start = start_time_ns
        self._topics: list[tuple[int, slice, list[bytes]]] = []
        for topic, quantities in layout.topics.items():
            channel = file.add_channel(topic, f"mufly.{topic[1:]}", orjson.dumps(_schema(layout, topic)))
            columns = slice(
                layout.columns[quantities[0].name].start, layout.columns[quantities[-1].name].stop
            )
            self._topics.append((channel, columns, _pieces(layout, topic)))
        clock = {
            "time": {"type": "number", "description": "time since the start of the recording (s)"},
            "state": {"type": "string", "description": "state of the mission"},
        }
        self._clock = file.add_channel(
            CLOCK_TOPIC, "mufly.mission", orjson.dumps(json_schema(clock, "mufly.mission"))
        )
        self._log = file.add_channel(EVENT_TOPIC, "foxglove.Log", orjson.dumps(LOG_SCHEMA))

    def times(self, rows: NDArray[np.float64]) -> list[int]:
        """Wall time of every row (ns)."""
        return (np.rint(rows[:, 0] * 1e9).astype(np.int64) + self._start).tolist()

    def messages(
        self, rows: NDArray[np.float64], states: Sequence[str], events: Sequence[Event]
    ) -> list[tuple[int, int, bytes]]:
        """Messages (channel, time in ns, content) of a block of rows and of events; not in order of time."""
        out: list[tuple[int, int, bytes]] = []
        if len(rows):
            times = self.times(rows)
            numbers = json_rows(rows)
            names = {state: orjson.dumps(state) for state in set(states)}
            join = b"".join
            for channel, columns, pieces in self._topics:
                gaps = pieces.copy()
                for time_ns, row in zip(times, numbers, strict=True):
                    gaps[1::2] = row[columns]
                    out.append((channel, time_ns, join(gaps)))
            for time_ns, row, state in zip(times, numbers, states, strict=True):
                line = join((b'{"time":', row[0], b',"state":', names[state], b"}"))
                out.append((self._clock, time_ns, line))
        for event in events:
            time_ns = self._start + round(event.time_s * 1e9)
            content = {
                "timestamp": stamp(time_ns),
                "level": LEVELS.get(event.level, 2),
                "message": event.text,
                "name": event.state,
                "file": "",
                "line": 0,
                "time": event.time_s,
            }
            out.append((self._log, time_ns, orjson.dumps(content)))
        return out


def json_rows(rows: NDArray[np.float64]) -> list[list[bytes]]:
    """JSON text of every number; NaN and infinity become null."""
    text = orjson.dumps(np.ascontiguousarray(rows), option=orjson.OPT_SERIALIZE_NUMPY)
    return [row.split(b",") for row in text[2:-2].split(b"],[")]


def _pieces(layout: Layout, topic: str) -> list[bytes]:
    """Constant text of a topic's message, with an empty gap at every second place for each number."""
    pieces, text = [], b"{"
    for k, quantity in enumerate(layout.topics[topic]):
        text += b"," * bool(k) + orjson.dumps(quantity.field) + b":"
        labels = layout.labels(quantity)
        if quantity.dim is None:
            pieces += [text, b""]
            text = b""
            continue
        listed = quantity.dim == "beam"
        text += b"[" if listed else b"{"
        for j, label in enumerate(labels):
            key = b"" if listed else orjson.dumps(str(label)) + b":"
            pieces += [text + b"," * bool(j) + key, b""]
            text = b""
        text += b"]" if listed else b"}"
    return [*pieces, text + b"}"]


def _schema(layout: Layout, topic: str) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    for quantity in layout.topics[topic]:
        # Null (not a number) occurs too, but viewers refuse a schema with a choice of types.
        number = {"type": "number", "description": f"{quantity.long_name} ({quantity.units})"}
        if quantity.dim is None:
            properties[quantity.field] = number
        elif quantity.dim == "beam":
            properties[quantity.field] = {"type": "array", "items": number}
        else:
            labels = [str(label) for label in layout.labels(quantity)]
            properties[quantity.field] = json_schema(dict.fromkeys(labels, number))
    return json_schema(properties, f"mufly.{topic[1:]}")
