"""Recorder of a flight: rows of numbers to an MCAP file, with messages for Foxglove's 3-D panel.

Field names and schema names are those of the Foxglove message schemas (docs.foxglove.dev, message schemas):
``foxglove.FrameTransforms``, ``foxglove.PoseInFrame``, ``foxglove.SceneUpdate``, ``foxglove.Log``.

Frames: ``world`` has x north, y west, z up. ``ned`` is the inertial frame of mufly, rotated by half a turn about x.
``body`` is the helicopter's frame, x forward, y right, z down. Positions in these messages are rounded to a
micrometre; the other topics hold the exact numbers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Protocol

import numpy as np
import orjson
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError, MuflyError
from mufly.logs.mcap import FlightEvent, McapWriter, RecordingLayout, make_flight_row_layout, rows_to_dataset
from mufly.logs.mcap_recording import (
    FLIGHT_METADATA_NAME,
    LAYOUT_METADATA_NAME,
    OUTCOME_METADATA_NAME,
    RECORDING_FORMAT_VERSION,
    ChannelRegistry,
    TopicEncoder,
    add_metadata_checksum,
    encode_json_numbers,
    foxglove_time,
    json_object_schema,
)
from mufly.mission import Mission, format_mission_toml
from mufly.rotations import quaternions_from_euler
from mufly.vehicle import Vehicle, format_vehicle_toml
from mufly.world import World

BODY_COLOUR = (0.20, 0.20, 0.20, 1.0)
ROTOR_COLOUR = (0.00, 0.45, 0.70, 0.45)
OBSTACLE_COLOUR = (0.55, 0.55, 0.55, 0.60)
WAYPOINT_COLOUR = (0.84, 0.37, 0.00, 0.90)
TRACK_COLOUR = (0.00, 0.45, 0.70, 1.0)


def _array_schema(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER_SCHEMA, _TEXT_SCHEMA, _FLAG_SCHEMA = {"type": "number"}, {"type": "string"}, {"type": "boolean"}
_INTEGER_SCHEMA = {"type": "integer"}
_TIME_SCHEMA = json_object_schema({"sec": _INTEGER_SCHEMA, "nsec": _INTEGER_SCHEMA}, "time")
_DURATION_SCHEMA = json_object_schema({"sec": _INTEGER_SCHEMA, "nsec": _INTEGER_SCHEMA}, "duration")
_VECTOR_SCHEMA = json_object_schema(dict.fromkeys("xyz", _NUMBER_SCHEMA), "foxglove.Vector3")
_POINT_SCHEMA = json_object_schema(dict.fromkeys("xyz", _NUMBER_SCHEMA), "foxglove.Point3")
_QUATERNION_SCHEMA = json_object_schema(dict.fromkeys("xyzw", _NUMBER_SCHEMA), "foxglove.Quaternion")
_COLOUR_SCHEMA = json_object_schema(dict.fromkeys("rgba", _NUMBER_SCHEMA), "foxglove.Color")
_POSE_SCHEMA = json_object_schema({"position": _VECTOR_SCHEMA, "orientation": _QUATERNION_SCHEMA}, "foxglove.Pose")
_TRANSFORM_SCHEMA = json_object_schema(
    {
        "timestamp": _TIME_SCHEMA,
        "parent_frame_id": _TEXT_SCHEMA,
        "child_frame_id": _TEXT_SCHEMA,
        "translation": _VECTOR_SCHEMA,
        "rotation": _QUATERNION_SCHEMA,
    },
    "foxglove.FrameTransform",
)
_SOLID_FIELDS = {"pose": _POSE_SCHEMA, "size": _VECTOR_SCHEMA, "color": _COLOUR_SCHEMA}
_LINE_FIELDS = {
    "type": _INTEGER_SCHEMA,
    "pose": _POSE_SCHEMA,
    "thickness": _NUMBER_SCHEMA,
    "scale_invariant": _FLAG_SCHEMA,
    "points": _array_schema(_POINT_SCHEMA),
    "color": _COLOUR_SCHEMA,
    "colors": _array_schema(_COLOUR_SCHEMA),
    "indices": _array_schema(_INTEGER_SCHEMA),
}
_LABEL_FIELDS = {
    "pose": _POSE_SCHEMA,
    "billboard": _FLAG_SCHEMA,
    "font_size": _NUMBER_SCHEMA,
    "scale_invariant": _FLAG_SCHEMA,
    "color": _COLOUR_SCHEMA,
    "text": _TEXT_SCHEMA,
}
_ENTITY_SCHEMA = json_object_schema(
    {
        "timestamp": _TIME_SCHEMA,
        "frame_id": _TEXT_SCHEMA,
        "id": _TEXT_SCHEMA,
        "lifetime": _DURATION_SCHEMA,
        "frame_locked": _FLAG_SCHEMA,
        "metadata": _array_schema(json_object_schema({"key": _TEXT_SCHEMA, "value": _TEXT_SCHEMA})),
        "cubes": _array_schema(json_object_schema(_SOLID_FIELDS, "foxglove.CubePrimitive")),
        "spheres": _array_schema(json_object_schema(_SOLID_FIELDS, "foxglove.SpherePrimitive")),
        "cylinders": _array_schema(
            json_object_schema(
                _SOLID_FIELDS | {"bottom_scale": _NUMBER_SCHEMA, "top_scale": _NUMBER_SCHEMA},
                "foxglove.CylinderPrimitive",
            )
        ),
        "lines": _array_schema(json_object_schema(_LINE_FIELDS, "foxglove.LinePrimitive")),
        "texts": _array_schema(json_object_schema(_LABEL_FIELDS, "foxglove.TextPrimitive")),
    },
    "foxglove.SceneEntity",
)
_DELETION_SCHEMA = json_object_schema(
    {"timestamp": _TIME_SCHEMA, "type": _INTEGER_SCHEMA, "id": _TEXT_SCHEMA}, "foxglove.SceneEntityDeletion"
)

SCHEMAS: dict[str, dict[str, Any]] = {
    "foxglove.FrameTransforms": json_object_schema(
        {"transforms": _array_schema(_TRANSFORM_SCHEMA)}, "foxglove.FrameTransforms"
    ),
    "foxglove.PoseInFrame": json_object_schema(
        {"timestamp": _TIME_SCHEMA, "frame_id": _TEXT_SCHEMA, "pose": _POSE_SCHEMA}, "foxglove.PoseInFrame"
    ),
    "foxglove.SceneUpdate": json_object_schema(
        {"deletions": _array_schema(_DELETION_SCHEMA), "entities": _array_schema(_ENTITY_SCHEMA)},
        "foxglove.SceneUpdate",
    ),
}
"""JSON schemas of the messages for the 3-D panel, by name."""


def make_pose_message_parts() -> tuple[list[bytes], list[bytes]]:
    """Return the constant text parts of Foxglove's ``/tf`` and pose messages, between which numbers are inserted.

    Returns
    -------
    transforms, pose : list of bytes
        Texts before, between and after the numbers sec, nsec, (``/tf``: sec, nsec again,) x, y, z, qx, qy, qz, qw.
    """
    place = [b',"y":', b',"z":', b'},"ROTATION":{"x":', b',"y":', b',"z":', b',"w":']
    rotation = [part.replace(b"ROTATION", b"rotation") for part in place]
    orientation = [part.replace(b"ROTATION", b"orientation") for part in place]
    transforms = [
        b'{"transforms":[{"timestamp":{"sec":',
        b',"nsec":',
        b'},"parent_frame_id":"world","child_frame_id":"ned","translation":{"x":0,"y":0,"z":0},'
        b'"rotation":{"x":1,"y":0,"z":0,"w":0}},{"timestamp":{"sec":',
        b',"nsec":',
        b'},"parent_frame_id":"ned","child_frame_id":"body","translation":{"x":',
        *rotation,
        b"}}]}",
    ]
    pose = [
        b'{"timestamp":{"sec":',
        b',"nsec":',
        b'},"frame_id":"ned","pose":{"position":{"x":',
        *orientation,
        b"}}}",
    ]
    return transforms, pose


def _to_xyz(values: ArrayLike) -> dict[str, float]:
    return dict(zip("xyz", (round(float(v), 6) for v in np.asarray(values).ravel()), strict=True))


def _to_rgba(colour: Sequence[float]) -> dict[str, float]:
    return dict(zip("rgba", colour, strict=True))


def _make_pose(position: ArrayLike, yaw: float = 0.0) -> dict[str, Any]:
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
    return {"position": _to_xyz(position), "orientation": turn}


def _make_entity(time_ns: int, frame: str, name: str, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {
        "timestamp": foxglove_time(time_ns),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "metadata": [],
        **{kind: primitives.get(kind, []) for kind in kinds},
    }


def _make_cylinder(position: ArrayLike, diameter: float, height: float, colour: Sequence[float]) -> dict[str, Any]:
    return {
        "pose": _make_pose(position),
        "size": _to_xyz((diameter, diameter, height)),
        "bottom_scale": 1.0,
        "top_scale": 1.0,
        "color": _to_rgba(colour),
    }


def encode_scene_message(
    time_ns: int,
    *,
    waypoints: Sequence[ArrayLike] = (),
    world: World | None = None,
    rotor_radius: float = 0.0875,
) -> bytes:
    """Return the static objects (waypoints, obstacles) and the helicopter's shape as a ``foxglove.SceneUpdate``.

    Parameters
    ----------
    time_ns : int
        Time of the message (ns since 1970).
    waypoints : sequence of (3,)
        Waypoints N, E, D (m).
    world : World, optional
        Its boxes and cylinders are drawn.
    rotor_radius : float
        Rotor radius (m), which scales the drawn helicopter.
    """
    r = rotor_radius
    entities = [
        _make_entity(
            time_ns,
            "body",
            "helicopter",
            cylinders=[
                _make_cylinder((0, 0, 0.1 * r), 0.5 * r, 1.4 * r, BODY_COLOUR),
                _make_cylinder((0, 0, -0.65 * r), 2 * r, 0.02 * r, ROTOR_COLOUR),
                _make_cylinder((0, 0, -1.0 * r), 2 * r, 0.02 * r, ROTOR_COLOUR),
            ],
            cubes=[
                {
                    "pose": _make_pose((0.35 * r, 0, 0.5 * r)),
                    "size": _to_xyz((0.5 * r, 0.12 * r, 0.12 * r)),
                    "color": _to_rgba(WAYPOINT_COLOUR),
                }
            ],
        )
    ]
    for number, waypoint in enumerate(waypoints, 1):
        sphere = {
            "pose": _make_pose(waypoint),
            "size": _to_xyz((0.1, 0.1, 0.1)),
            "color": _to_rgba(WAYPOINT_COLOUR),
        }
        label = {
            "pose": _make_pose(np.subtract(waypoint, (0.0, 0.0, 0.15))),
            "billboard": True,
            "font_size": 14.0,
            "scale_invariant": True,
            "color": _to_rgba((0.0, 0.0, 0.0, 1.0)),
            "text": str(number),
        }
        entities.append(_make_entity(time_ns, "ned", f"waypoint {number}", spheres=[sphere], texts=[label]))
    world = world or World()
    cubes = [
        {
            "pose": _make_pose(box.centre, box.yaw),
            "size": _to_xyz(box.size),
            "color": _to_rgba(OBSTACLE_COLOUR),
        }
        for box in world.boxes
    ]
    posts = [
        _make_cylinder((*post.centre, -post.foot - 0.5 * post.height), 2 * post.radius, post.height, OBSTACLE_COLOUR)
        for post in world.cylinders
    ]
    if cubes or posts:
        entities.append(_make_entity(time_ns, "ned", "obstacles", cubes=cubes, cylinders=posts))
    return orjson.dumps({"deletions": [], "entities": entities})


def encode_track_message(time_ns: int, track: NDArray[np.float64]) -> bytes:
    """Return the track flown so far as one line, ``foxglove.SceneUpdate``.

    Parameters
    ----------
    time_ns : int
        Time of the message.
    track : (n, 3) array
        N, E, D (m).
    """
    points = [dict(zip("xyz", p, strict=True)) for p in np.round(track, 4).tolist()]
    line = {
        "type": 0,
        "pose": _make_pose((0, 0, 0)),
        "thickness": 2.0,
        "scale_invariant": True,
        "points": points,
        "color": _to_rgba(TRACK_COLOUR),
        "colors": [],
        "indices": [],
    }
    return orjson.dumps({"deletions": [], "entities": [_make_entity(time_ns, "ned", "track", lines=[line])]})


# ----------------------------------------------------------------------------
# Conversion of rows of numbers to the messages of a chunk.
#
# Every recording has the topics of its layout, a clock and events (:mod:`mufly.logs.mcap_recording`); a flight adds
# the messages of the 3-D view.


TRACK_POINT_COUNT = 400
TF_TOPIC, REFERENCE_POSE_TOPIC, SCENE_TOPIC, TRACK_TOPIC = "/tf", "/reference_pose", "/scene", "/track"


class RecordingEncoder:
    """Encoder that converts a block of recorded rows to the messages of one MCAP chunk."""

    def __init__(self, file: ChannelRegistry, layout: RecordingLayout, start_time_ns: int) -> None:
        self._start = start_time_ns
        self._columns = layout.column_slices
        self._rows = TopicEncoder(file, layout, start_time_ns)
        views = {
            TF_TOPIC: "foxglove.FrameTransforms",
            REFERENCE_POSE_TOPIC: "foxglove.PoseInFrame",
            SCENE_TOPIC: "foxglove.SceneUpdate",
            TRACK_TOPIC: "foxglove.SceneUpdate",
        }
        self._views = {
            topic: file.add_channel(topic, name, orjson.dumps(SCHEMAS[name])) for topic, name in views.items()
        }
        self._track = np.empty((0, 3))
        self._track_step = 1
        self._track_seen = 0

    def encode_scene(self, view: Mapping[str, Any]) -> tuple[int, int, bytes]:
        return self._views[SCENE_TOPIC], self._start, encode_scene_message(self._start, **view)

    def last_time_ns(self, rows: NDArray[np.float64]) -> int:
        """Return the wall time of the last row (ns)."""
        return self._rows.wall_times_ns(rows[-1:])[0]

    def encode_rows(
        self, rows: NDArray[np.float64], states: Sequence[str], events: Sequence[FlightEvent]
    ) -> list[tuple[int, int, bytes]]:
        out = self._rows.encode_messages(rows, states, events)
        if len(rows):
            with np.errstate(over="ignore", invalid="ignore"):  # overflowing numbers are recorded, not drawn
                self._add_poses(out, rows, self._rows.wall_times_ns(rows))
        out.sort(key=lambda message: message[1])
        return out

    def _add_poses(self, out: list[tuple[int, int, bytes]], rows: NDArray[np.float64], times: Sequence[int]) -> None:
        """Add helicopter, reference and track for the 3-D view."""
        sec, nsec = ([str(part).encode() for part in parts] for parts in zip(*map(_split_time, times), strict=True))
        for prefix, topic, pieces in zip(
            ("truth", "reference"), (TF_TOPIC, REFERENCE_POSE_TOPIC), make_pose_message_parts(), strict=True
        ):
            position, attitude = self._drawn_pose(rows, prefix)
            turn = np.roll(quaternions_from_euler(attitude), -1, axis=1)  # Foxglove: x, y, z, w
            drawn = np.round(np.hstack((position, turn)), 6).astype(np.float64)
            numbers = encode_json_numbers(drawn)
            repeat = 2 if topic == TF_TOPIC else 1
            for time_ns, s, ns, row in zip(times, sec, nsec, numbers, strict=True):
                if b"null" not in row:
                    gaps: list[bytes] = [b""] * (2 * len(pieces) - 1)
                    gaps[::2] = pieces
                    gaps[1::2] = [s, ns] * repeat + row
                    out.append((self._views[topic], time_ns, b"".join(gaps)))
        position, _ = self._drawn_pose(rows, "truth")
        mine = np.arange(self._track_seen, self._track_seen + len(rows)) % self._track_step == 0
        self._track_seen += len(rows)
        self._track = np.concatenate((self._track, position[mine & np.isfinite(position).all(axis=1)]))
        if len(self._track) > TRACK_POINT_COUNT:
            self._track = self._track[::2]
            self._track_step *= 2
        shown = np.concatenate((self._track, position[-1:][np.isfinite(position[-1:]).all(axis=1)]))
        out.append((self._views[TRACK_TOPIC], times[-1], encode_track_message(times[-1], shown)))

    def _drawn_pose(self, rows: NDArray[np.float64], prefix: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return position and attitude for the 3-D view; an unknown truth is replaced by the estimate."""
        both = [rows[:, self._columns[f"{prefix}_{name}"]] for name in ("position", "attitude")]
        if prefix == "truth" and "estimated_position" in self._columns and np.isnan(both[0]).any():
            believed = [rows[:, self._columns[f"estimated_{name}"]] for name in ("position", "attitude")]
            both = [np.where(np.isnan(known), other, known) for known, other in zip(both, believed, strict=True)]
        return both[0], both[1]


def _split_time(time_ns: int) -> tuple[int, int]:
    return time_ns // 1_000_000_000, time_ns % 1_000_000_000


# ----------------------------------------------------------------------------
# Recorder: rows of a flight to a file that is valid at any moment.
#
# A row is copied into a block; after a second of recorded time the block is written as one finished chunk of an
# MCAP file. A crash, a full disk or a power failure costs at most the last second.


BLOCK_DURATION_S = 1.0
BLOCK_ROWS = 1024


class RowViewer(Protocol):
    """Interface of a receiver of recorded rows and events, such as
    :class:`mufly.flight.record.live_view.LiveViewThread`.
    """

    def receive_row(self, row: NDArray[np.float64], state: str) -> None:
        """Receive the row of one instant; the receiver has to copy it."""

    def receive_event(self, event: FlightEvent) -> None:
        """Receive an event."""


class FlightRecorder:
    """Record a flight, row by row.

    Parameters
    ----------
    path : str, Path or None
        MCAP file to write (overwritten); None records to memory only.
    attributes : mapping, optional
        Attributes in JSON types: vehicle name, mission name, seed, wind, versions, ... The recorder adds
        ``start_time`` (ISO 8601, UTC), ``start_time_ns`` and ``format``.
    layout : RecordingLayout, optional
        Columns of a row; default :func:`make_flight_row_layout` with eight beams.
    attachments : mapping, optional
        Texts to attach, ``{"mission.toml": ..., "vehicle.toml": ...}``.
    scene_view : mapping, optional
        Keyword arguments of :func:`mufly.flight.record.recorder.encode_scene_message`.
    start_time_ns : int, optional
        Wall time of the instant 0 (ns since 1970); default the present time.
    keep : bool
        Whether all rows stay in memory for :meth:`to_dataset`; otherwise the memory does not grow with the flight.

    Raises
    ------
    InputError
        If the file cannot be created, or an attribute has no JSON form.

    Attributes
    ----------
    views : list of RowViewer
        Live views of the rows.

    Notes
    -----
    Use as a context manager. An exception in the block also finishes the file, with the outcome "interrupted"
    (Ctrl-C) or "crashed".
    """

    def __init__(
        self,
        path: str | Path | None,
        attributes: Mapping[str, Any] | None = None,
        *,
        layout: RecordingLayout | None = None,
        attachments: Mapping[str, str | bytes] | None = None,
        scene_view: Mapping[str, Any] | None = None,
        start_time_ns: int | None = None,
        keep: bool = True,
    ) -> None:
        self._keep = keep
        self.layout = layout or make_flight_row_layout()
        self.start_time_ns = time.time_ns() if start_time_ns is None else start_time_ns
        started = datetime.fromtimestamp(self.start_time_ns / 1e9, UTC).isoformat(timespec="milliseconds")
        clock = {"start_time": started, "start_time_ns": self.start_time_ns, "format": RECORDING_FORMAT_VERSION}
        self._attributes: dict[str, Any] = {**(attributes or {}), **clock}
        self._outcome: dict[str, Any] = {"outcome": "unfinished", "reason": ""}
        self._block = np.empty((BLOCK_ROWS, self.layout.column_count))
        self._states: list[str] = []
        self._n = 0
        self._flush_at = -np.inf
        self._last_time = -np.inf
        self._events: list[FlightEvent] = []
        self._all_rows: list[NDArray[np.float64]] = []
        self._all_states: list[str] = []
        self._all_events: list[FlightEvent] = []
        self._closed = False
        self.scene_view, self.views = dict(scene_view or {}), list[RowViewer]()
        self._path = None if path is None else Path(path)
        self._stream: BinaryIO | None = None
        if self._path is not None:
            self._open_file(self._path, attachments or {})

    def _open_file(self, path: Path, attachments: Mapping[str, str | bytes]) -> None:
        values = _encode_metadata(str(path), self._attributes)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("wb")
        except OSError as error:
            problem = f"cannot be written ({error.strerror})"
            raise InputError(str(path), "", problem, "choose another folder") from error
        self._file = McapWriter(self._stream, f"mufly {self._attributes.get('version', '')}".strip())
        self._encoder = RecordingEncoder(self._file, self.layout, self.start_time_ns)
        self._file.write_metadata(FLIGHT_METADATA_NAME, add_metadata_checksum(values))
        self._file.write_metadata(LAYOUT_METADATA_NAME, add_metadata_checksum({"layout": self.layout.to_json()}))
        for name, content in attachments.items():
            data = content.encode() if isinstance(content, str) else bytes(content)
            self._file.write_attachment(name, "text/plain", data, self.start_time_ns)
        self._file.write_chunk([self._encoder.encode_scene(self.scene_view)])

    def append_row(self, row: NDArray[np.float64], state: str) -> None:
        """Append the row of one instant.

        Parameters
        ----------
        row : (layout.column_count,) float64 array
            Time (s) and the columns of the layout; copied. Times must increase.
        state : str
            State of the mission.
        """
        if row[0] >= self._flush_at or self._n == BLOCK_ROWS:
            self._flush_block(float(row[0]))
        self._block[self._n] = row
        self._states.append(state)
        self._n += 1
        for view in self.views:
            view.receive_row(row, state)

    def append_rows(self, rows: NDArray[np.float64], states: Sequence[str]) -> None:
        """Append many rows (n, layout.column_count), each with the state of the mission.

        Without a file the array itself is kept: the caller must not change it afterwards.
        """
        for view in self.views:
            for row, state in zip(rows, states, strict=True):
                view.receive_row(row, state)
        if self._stream is None and len(rows):
            self._flush_block(float(rows[0, 0]))
            self._keep_rows(rows, self._count_increasing(rows), states)
            return
        first = 0
        while first < len(rows):
            if rows[first, 0] >= self._flush_at or self._n == BLOCK_ROWS:
                self._flush_block(float(rows[first, 0]))
            before = first + int(np.searchsorted(rows[first:, 0], self._flush_at))
            stop = min(max(before, first + 1), first + BLOCK_ROWS - self._n)
            self._block[self._n : self._n + stop - first] = rows[first:stop]
            self._states += states[first:stop]
            self._n += stop - first
            first = stop

    def add_event(self, time_s: float, state: str, text: str, level: str = "info") -> None:
        """Append an event: a transition, a warning (``level="warning"``) or an error."""
        self._events.append(FlightEvent(float(time_s), state, text, level))
        for view in self.views:
            view.receive_event(self._events[-1])

    def set_outcome(self, outcome: str, reason: str = "", **attributes: Any) -> None:
        """Set the outcome of the flight and further attributes, which :meth:`close` writes."""
        self._outcome = {"outcome": outcome, "reason": reason, **attributes}

    def close(self) -> None:
        """Write the remaining rows, the outcome, the index and the end mark; a second call has no effect."""
        if self._closed:
            return
        self._closed = True
        if self._stream is None:
            self._flush_block(np.inf)
            return
        try:
            self._flush_block(np.inf)
            outcome = _encode_metadata(str(self._path), self._outcome)
            self._file.write_metadata(OUTCOME_METADATA_NAME, add_metadata_checksum(outcome))
            self._file.finish_file()
        except OSError as error:
            raise self._make_write_error(error) from error
        finally:
            with suppress(OSError):  # buffered data that a full disk rejected
                self._stream.close()

    def to_dataset(self) -> xr.Dataset:
        """Return the rows recorded so far, in the form of :func:`mufly.flight.read_recording`.

        Raises
        ------
        MuflyError
            If the rows were not kept in memory.
        """
        if not self._keep:
            raise MuflyError(f"rows are not kept in memory; read {self._path or 'a recording on disk'}")
        attributes = {**self._attributes, **(self._outcome if self._closed else {}), "complete": self._closed}
        return rows_to_dataset(
            [*self._all_rows, self._block[: self._n]],
            self._all_states + self._states,
            self.layout,
            attributes=attributes,
            events=self._all_events + self._events,
        )

    def __enter__(self) -> FlightRecorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and self._outcome["outcome"] == "unfinished":
            stopped = isinstance(error, KeyboardInterrupt)
            self.set_outcome("interrupted" if stopped else "crashed", "" if stopped else str(error))
        self.close()

    def _flush_block(self, time_s: float) -> None:
        """Write the rows and events collected since the last write, and collect the next ones from ``time_s`` on."""
        rows, states, events = self._block[: self._n].copy(), self._states, self._events
        valid = self._count_increasing(rows)
        if valid < len(rows):
            self._n, self._states = valid, states[:valid]  # the valid rows are still written
            raise self._make_time_error(rows, valid)
        if self._stream is not None and (len(rows) or events):
            try:
                self._file.write_chunk(self._encoder.encode_rows(rows, states, events))
            except OSError as error:
                raise self._make_write_error(error) from error
        # No external calls here, so that Ctrl-C cannot interrupt between these lines.
        self._n = 0
        self._states = []
        self._events = []
        self._flush_at = time_s + BLOCK_DURATION_S
        if len(rows):
            self._last_time = rows[-1, 0]
        if self._keep:
            self._all_rows += (rows,)
            self._all_states += states
            self._all_events += events

    def _keep_rows(self, rows: NDArray[np.float64], valid: int, states: Sequence[str]) -> None:
        """Keep the first ``valid`` rows, whose times increase, in memory without a copy.

        Raise an error if there are more rows, because the time of the next one does not increase.
        """
        if valid:
            self._last_time = rows[valid - 1, 0]
        if self._keep:
            self._all_rows += (rows[:valid],)
            self._all_states += states[:valid]
        if valid < len(rows):
            raise self._make_time_error(rows, valid)

    def _count_increasing(self, rows: NDArray[np.float64]) -> int:
        """Return the number of leading rows whose times increase."""
        if not len(rows):
            return 0
        wrong = ~(np.diff(rows[:, 0], prepend=self._last_time) > 0)
        return int(wrong.argmax()) if wrong.any() else len(rows)

    def _make_time_error(self, rows: NDArray[np.float64], k: int) -> MuflyError:
        before = rows[k - 1, 0] if k else self._last_time
        return MuflyError(f"the times of a recording's rows must increase: {rows[k, 0]:g} s follows {before:g} s")

    def _make_write_error(self, error: OSError) -> MuflyError:
        return MuflyError(f"{self._path}: the recording cannot be written ({error.strerror})")


def _encode_metadata(where: str, content: Mapping[str, Any]) -> dict[str, str]:
    """Return attributes as MCAP metadata, with values as JSON text."""
    out: dict[str, str] = {}
    for key, value in content.items():
        try:
            out[key] = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()
        except TypeError as error:
            problem = f"cannot be recorded ({error})"
            raise InputError(where, key, problem, "give text, numbers, lists or tables") from error
    return out


def open_flight_recorder(
    path: str | Path | None,
    attributes: Mapping[str, Any],
    vehicle: Vehicle,
    mission: Mission,
    *,
    sensors: bool,
    keep: bool,
) -> FlightRecorder:
    """Return the recorder of a simulated flight; its file holds vehicle and mission, and their scene.

    Parameters
    ----------
    path : str or Path, optional
        MCAP file.
    attributes : mapping
    vehicle : Vehicle
    mission : Mission
    sensors : bool
        Whether rows have the readings of sensors.
    keep : bool
        Whether rows stay in memory.
    """
    files = {"vehicle.toml": format_vehicle_toml(vehicle), "mission.toml": format_mission_toml(mission)} if path else {}
    scene = {
        "world": mission.world,
        "waypoints": [w.position_m for w in mission.waypoint],
        "rotor_radius": float(vehicle.rotors.radius),
    }
    layout = make_flight_row_layout(vehicle.range_ring.count, sensors=sensors)
    return FlightRecorder(path, attributes, layout=layout, attachments=files, scene_view=scene, keep=keep)
