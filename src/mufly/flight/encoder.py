"""From rows of numbers to the messages of a chunk.

Every topic of the layout gets one JSON message a row, and the 3-D view gets its own (see
:mod:`mufly.flight.scene`). The numbers of a block are written as JSON in one call (orjson prints the shortest
text that reads back to the same float64) and then fitted between constant pieces of text, which spares a
dictionary for every message.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson
from numpy.typing import NDArray

from mufly.flight import scene
from mufly.logs.layout import Event, Layout
from mufly.logs.mcap_file import McapFile
from mufly.logs.recording import CLOCK_TOPIC, EVENT_TOPIC, LEVELS

__all__ = ["Encoder"]

TRACK_POINTS = 400
TF_TOPIC, REFERENCE_POSE_TOPIC, SCENE_TOPIC, TRACK_TOPIC = "/tf", "/reference_pose", "/scene", "/track"


class Encoder:
    """Turns a block of rows into the messages of one chunk."""

    def __init__(self, file: McapFile, layout: Layout, start_time_ns: int) -> None:
        self._start = start_time_ns
        self._columns = layout.columns
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
            CLOCK_TOPIC, "mufly.mission", orjson.dumps(scene.json_schema(clock, "mufly.mission"))
        )
        views = {
            EVENT_TOPIC: "foxglove.Log",
            TF_TOPIC: "foxglove.FrameTransforms",
            REFERENCE_POSE_TOPIC: "foxglove.PoseInFrame",
            SCENE_TOPIC: "foxglove.SceneUpdate",
            TRACK_TOPIC: "foxglove.SceneUpdate",
        }
        self._views = {
            topic: file.add_channel(topic, name, orjson.dumps(scene.SCHEMAS[name]))
            for topic, name in views.items()
        }
        self._track = np.empty((0, 3))
        self._track_step = 1
        self._track_seen = 0

    def scene(self, view: Mapping[str, Any]) -> tuple[int, int, bytes]:
        return self._views[SCENE_TOPIC], self._start, scene.scene_message(self._start, **view)

    def messages(
        self, rows: NDArray[np.float64], states: Sequence[str], events: Sequence[Event]
    ) -> list[tuple[int, int, bytes]]:
        out: list[tuple[int, int, bytes]] = []
        if len(rows):
            times = (np.rint(rows[:, 0] * 1e9).astype(np.int64) + self._start).tolist()
            numbers = _json_rows(rows)
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
            with np.errstate(over="ignore", invalid="ignore"):  # absurd numbers are recorded, not drawn
                self._poses(out, rows, times)
        for event in events:
            time_ns = self._start + round(event.time_s * 1e9)
            content = {
                "timestamp": scene.stamp(time_ns),
                "level": LEVELS.get(event.level, 2),
                "message": event.text,
                "name": event.state,
                "file": "",
                "line": 0,
                "time": event.time_s,
            }
            out.append((self._views[EVENT_TOPIC], time_ns, orjson.dumps(content)))
        out.sort(key=lambda message: message[1])
        return out

    def _poses(
        self, out: list[tuple[int, int, bytes]], rows: NDArray[np.float64], times: Sequence[int]
    ) -> None:
        """Helicopter, reference and track for the 3-D view."""
        sec, nsec = (
            [str(part).encode() for part in parts] for parts in zip(*map(_split_time, times), strict=True)
        )
        for prefix, topic, pieces in zip(
            ("truth", "reference"), (TF_TOPIC, REFERENCE_POSE_TOPIC), scene.transform_pieces(), strict=True
        ):
            position = rows[:, self._columns[f"{prefix}_position"]]
            turn = scene.quaternions(rows[:, self._columns[f"{prefix}_attitude"]])
            drawn = np.round(np.hstack((position, turn)), 6).astype(np.float64)
            numbers = _json_rows(drawn)
            repeat = 2 if topic == TF_TOPIC else 1
            for time_ns, s, ns, row in zip(times, sec, nsec, numbers, strict=True):
                if b"null" not in row:
                    gaps: list[bytes] = [b""] * (2 * len(pieces) - 1)
                    gaps[::2] = pieces
                    gaps[1::2] = [s, ns] * repeat + row
                    out.append((self._views[topic], time_ns, b"".join(gaps)))
        position = rows[:, self._columns["truth_position"]]
        mine = np.arange(self._track_seen, self._track_seen + len(rows)) % self._track_step == 0
        self._track_seen += len(rows)
        self._track = np.concatenate((self._track, position[mine & np.isfinite(position).all(axis=1)]))
        if len(self._track) > TRACK_POINTS:
            self._track = self._track[::2]
            self._track_step *= 2
        shown = np.concatenate((self._track, position[-1:][np.isfinite(position[-1:]).all(axis=1)]))
        out.append((self._views[TRACK_TOPIC], times[-1], scene.track_message(times[-1], shown)))


def _split_time(time_ns: int) -> tuple[int, int]:
    return time_ns // 1_000_000_000, time_ns % 1_000_000_000


def _json_rows(rows: NDArray[np.float64]) -> list[list[bytes]]:
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
            properties[quantity.field] = scene.json_schema(dict.fromkeys(labels, number))
    return scene.json_schema(properties, f"mufly.{topic[1:]}")
