"""From rows of numbers to the messages of a chunk.

The topics of the layout, the clock and the events are those of every recording (:mod:`mufly.logs.messages`); a flight
adds what the 3-D view needs (:mod:`mufly.flight.scene`).
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
from mufly.logs.messages import TopicEncoder, json_rows

__all__ = ["Encoder"]

TRACK_POINTS = 400
TF_TOPIC, REFERENCE_POSE_TOPIC, SCENE_TOPIC, TRACK_TOPIC = "/tf", "/reference_pose", "/scene", "/track"


class Encoder:
    """Turns a block of rows into the messages of one chunk."""

    def __init__(self, file: McapFile, layout: Layout, start_time_ns: int) -> None:
        self._start = start_time_ns
        self._columns = layout.columns
        self._rows = TopicEncoder(file, layout, start_time_ns)
        views = {
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
        out = self._rows.messages(rows, states, events)
        if len(rows):
            with np.errstate(over="ignore", invalid="ignore"):  # absurd numbers are recorded, not drawn
                self._poses(out, rows, self._rows.times(rows))
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
            position, attitude = self._place(rows, prefix)
            turn = scene.quaternions(attitude)
            drawn = np.round(np.hstack((position, turn)), 6).astype(np.float64)
            numbers = json_rows(drawn)
            repeat = 2 if topic == TF_TOPIC else 1
            for time_ns, s, ns, row in zip(times, sec, nsec, numbers, strict=True):
                if b"null" not in row:
                    gaps: list[bytes] = [b""] * (2 * len(pieces) - 1)
                    gaps[::2] = pieces
                    gaps[1::2] = [s, ns] * repeat + row
                    out.append((self._views[topic], time_ns, b"".join(gaps)))
        position, _ = self._place(rows, "truth")
        mine = np.arange(self._track_seen, self._track_seen + len(rows)) % self._track_step == 0
        self._track_seen += len(rows)
        self._track = np.concatenate((self._track, position[mine & np.isfinite(position).all(axis=1)]))
        if len(self._track) > TRACK_POINTS:
            self._track = self._track[::2]
            self._track_step *= 2
        shown = np.concatenate((self._track, position[-1:][np.isfinite(position[-1:]).all(axis=1)]))
        out.append((self._views[TRACK_TOPIC], times[-1], scene.track_message(times[-1], shown)))

    def _place(
        self, rows: NDArray[np.float64], prefix: str
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and attitude to be drawn; where the truth is not known, what the vehicle believes of itself."""
        both = [rows[:, self._columns[f"{prefix}_{name}"]] for name in ("position", "attitude")]
        if prefix == "truth" and "estimated_position" in self._columns and np.isnan(both[0]).any():
            believed = [rows[:, self._columns[f"estimated_{name}"]] for name in ("position", "attitude")]
            both = [
                np.where(np.isnan(known), other, known) for known, other in zip(both, believed, strict=True)
            ]
        return both[0], both[1]


def _split_time(time_ns: int) -> tuple[int, int]:
    return time_ns // 1_000_000_000, time_ns % 1_000_000_000
