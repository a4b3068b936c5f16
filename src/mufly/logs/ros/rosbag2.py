"""Bags of ROS 2 (rosbag2), read and written without ROS.

A bag is a folder with ``metadata.yaml`` and one file of messages, here MCAP with CDR messages and their definitions.
``ros2 bag play`` publishes it; Foxglove opens the MCAP file. The package ``rosbags`` (Apache-2.0) does the encoding.
A bag from mufly holds the attributes of its recording under ``custom_data``, so that the same clock is read back.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError, convert_write_errors
from mufly.logs.column_map import ColumnMap
from mufly.logs.mcap import read_events, to_json_value
from mufly.logs.raw_log import LogWarning, RawLog, RawTable, format_wall_time
from mufly.logs.ros.ros_messages import (
    EVENT_LEVELS,
    EVENT_TOPIC,
    EVENT_TYPE,
    IMAGE_TOPIC,
    IMAGE_TYPE,
    NANOSECONDS_PER_SECOND,
    STATE_TOPIC,
    STATE_TYPE,
    RangeSensorGeometry,
    compute_stamp_times_ns,
    decode_fields,
    extract_row_message,
    find_rows_for_topic,
    select_ros_topics,
    stamp_message,
)
from mufly.quantities.quantity_table import find_quantity

BAG_ENDING = ".rosbag2"
"""Ending of a bag's folder in mufly's commands; ROS accepts any name."""
METADATA_FILE = "metadata.yaml"
_BAG_VERSION = 8  # rosbag2 of Iron, read by every later release
_CUSTOM_DATA_KEY = "mufly"
_BLOCK_ROWS = 1000
_MAX_SIGNAL_LIST_LENGTH = 64  # a longer list is a picture or a point cloud
_NODE_TYPE_BASE, _NODE_TYPE_NAME, _NODE_TYPE_ARRAY = 1, 2, 3  # kinds of fields in the type system of rosbags


def _import_rosbags() -> ModuleType:
    try:
        import rosbags.highlevel
        import rosbags.rosbag2
        import rosbags.typesys
    except ImportError as error:
        remedy = "install it: pip install 'mufly[rosbag]'"
        raise InputError("rosbag2", "", "needs rosbags, which is not installed", remedy) from error
    return rosbags


def is_bag(path: Path) -> bool:
    """Return whether a path is the folder of a bag."""
    return path.is_dir() and (path / METADATA_FILE).is_file()


class _MessageMaker:
    """Maker of CDR messages from nested dictionaries; missing fields are zero."""

    def __init__(self, store: Any) -> None:
        self._store = store
        self._makers: dict[str, Callable[[Mapping[str, Any]], Any]] = {}

    def serialize(self, message_type: str, content: Mapping[str, Any]) -> bytes:
        return bytes(self._store.serialize_cdr(self._message_maker(message_type)(content), message_type))

    def _message_maker(self, message_type: str) -> Callable[[Mapping[str, Any]], Any]:
        if message_type not in self._makers:
            cls = self._store.types[message_type]
            fields = [(name, self._field_converter(kind)) for name, kind in self._store.fielddefs[message_type][1]]
            self._makers[message_type] = lambda content: cls(*[make(content.get(name)) for name, make in fields])
        return self._makers[message_type]

    def _field_converter(self, field: tuple[Any, Any]) -> Callable[[Any], Any]:
        """Return the function that converts a plain value to a message's field; None becomes zero or empty."""
        kind, about = int(field[0]), field[1]
        if kind == _NODE_TYPE_BASE:
            zero: Any = "" if about[0] == "string" else 0
            return lambda value: zero if value is None else value
        if kind == _NODE_TYPE_NAME:
            make = self._message_maker(about)
            return lambda value: make(value or {})
        (inner_kind, inner), length = about
        if int(inner_kind) == _NODE_TYPE_NAME:
            one = self._message_maker(inner)
            return lambda value: [one(v) for v in value or ()]
        if inner[0] == "string":
            return lambda value: list(value or ())
        zeros = np.zeros(length if kind == _NODE_TYPE_ARRAY else 0, dtype=inner[0])
        return lambda value: zeros if value is None else np.asarray(value, dtype=zeros.dtype)


def write_rosbag2(
    dataset: xr.Dataset,
    path: Path,
    *,
    limits: RangeSensorGeometry | None = None,
    pictures: Iterable[tuple[float, bytes]] = (),
) -> tuple[str, ...]:
    """Write a recording as a bag of ROS 2: :data:`mufly.logs.ros.ros_messages.ROS_TOPICS`, state, events, pictures.

    Parameters
    ----------
    dataset : xarray.Dataset
        Signals on one clock, as from :func:`mufly.logs.read_log`.
    path : Path
        Folder of the bag. An existing bag is replaced when the new one is complete.
    limits : RangeSensorGeometry, optional
        Geometry of the range sensors; default no limits.
    pictures : iterable of (time_s, bytes)
        JPEG pictures of the camera.

    Returns
    -------
    tuple of str
        Topics written. Signals without a topic are not written.

    Raises
    ------
    InputError
        If rosbags is missing, no signal has a topic, or the folder cannot be written.
    """
    bags = _import_rosbags()
    blocks = {
        str(name): np.asarray(v.values, dtype=np.float64).reshape(len(dataset["time"]), -1)
        for name, v in dataset.data_vars.items()
        if v.dims[:1] == ("time",) and v.ndim <= 2 and v.dtype.kind in "fiub"
    }
    topics = [t for t in select_ros_topics(blocks) if len(find_rows_for_topic(t, blocks))]
    if not topics:
        raise InputError(str(path), "", "no signal has a ROS topic", "choose motion, sensors, battery or references")
    if path.exists() and not is_bag(path):
        raise InputError(str(path), "", "exists and is no bag", "choose another name")
    start_ns = int(dataset.attrs.get("start_time_ns", 0))
    store = bags.typesys.get_typestore(bags.typesys.Stores.ROS2_JAZZY)
    maker, connections = _MessageMaker(store), dict[str, Any]()
    part = path.with_name(f".{path.name}.part")  # the file in a bag has the name of the folder that it was written to
    with convert_write_errors(path, "choose another folder or free disk space"):
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(parents=True)
        writer = bags.rosbag2.Writer(
            part / path.stem, version=_BAG_VERSION, storage_plugin=bags.rosbag2.StoragePlugin.MCAP
        )
        writer.set_compression(bags.rosbag2.CompressionMode.STORAGE, bags.rosbag2.CompressionFormat.ZSTD)
        try:
            with writer:
                writer.set_custom_data(_CUSTOM_DATA_KEY, json.dumps(to_json_value(dataset.attrs)))
                messages = _iterate_messages(
                    dataset, blocks, topics, limits or RangeSensorGeometry(), start_ns, pictures
                )
                for time_ns, topic, kind, content in messages:
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=store)
                    writer.write(connections[topic], time_ns, maker.serialize(kind, content))
            if path.exists():
                shutil.rmtree(path)
            (part / path.stem).rename(path)
        finally:
            shutil.rmtree(part, ignore_errors=True)
    return tuple(connections)


def _iterate_messages(
    dataset: xr.Dataset, blocks: Mapping[str, NDArray[np.float64]], topics: list[Any], limits: RangeSensorGeometry,
    start_ns: int, pictures: Iterable[tuple[float, bytes]],
) -> Iterator[tuple[int, str, str, dict[str, Any]]]:  # fmt: skip
    """Yield (time of arrival in ns, topic, type, content), in order of time within a block of rows."""
    time = dataset["time"].values.astype(np.float64)
    states = dataset["mission_state"].values.tolist() if "mission_state" in dataset else []
    events = read_events(dataset) if "event_time" in dataset else []
    images = iter(sorted(pictures, key=lambda one: one[0]))
    image = next(images, None)
    for first in range(0, len(time), _BLOCK_ROWS):
        rows = slice(first, first + _BLOCK_ROWS)
        until = np.inf if rows.stop >= len(time) else time[rows.stop]
        part = {name: block[rows] for name, block in blocks.items()}
        arrival = np.rint(time[rows] * NANOSECONDS_PER_SECOND).astype(np.int64) + start_ns
        out: list[tuple[int, str, str, dict[str, Any]]] = []
        for topic in topics:
            index = find_rows_for_topic(topic, part)
            mine = {name: block[index] for name, block in part.items()}
            columns = topic.encode(mine, limits)
            stamps = compute_stamp_times_ns(topic, mine, time[rows][index], start_ns)
            for k, (row, stamp) in enumerate(zip(index.tolist(), stamps.tolist(), strict=True)):
                content = extract_row_message(columns, k)
                stamp_message(content, stamp)
                out.append((int(arrival[row]), topic.name, topic.message_type, content))
        for k, state in enumerate(states[rows]):
            out.append((int(arrival[k]), STATE_TOPIC, STATE_TYPE, {"data": state}))
        while events and events[0].time_s < until:
            event = events.pop(0)
            when = round(event.time_s * NANOSECONDS_PER_SECOND) + start_ns
            content = {
                "stamp": {"sec": when // NANOSECONDS_PER_SECOND, "nanosec": when % NANOSECONDS_PER_SECOND},
                "level": EVENT_LEVELS.get(event.level, EVENT_LEVELS["info"]),
                "name": event.state,
                "msg": event.text,
            }
            out.append((when, EVENT_TOPIC, EVENT_TYPE, content))
        while image is not None and image[0] < until:
            when = round(image[0] * NANOSECONDS_PER_SECOND) + start_ns
            content = {"header": {"frame_id": "camera"}, "format": "jpeg", "data": np.frombuffer(image[1], np.uint8)}
            stamp_message(content, when)
            out.append((when, IMAGE_TOPIC, IMAGE_TYPE, content))
            image = next(images, None)
        yield from sorted(out, key=lambda message: message[0])


def read_rosbag2(path: str | Path) -> RawLog:
    """Read a bag of ROS 2: its topics with their fields, and signals in N-E-D and body axes beside them.

    A message counts at the time of its header, else of its arrival. Fields are named ``pose.pose.position.x`` and
    ``covariance[0]``; lists above 64 elements (pictures, clouds) are skipped. The signals of
    :func:`mufly.logs.ros.ros_messages.decode_fields` are fields like ``estimated_position.N``.

    Parameters
    ----------
    path : str or Path
        Folder of the bag, or its file of messages.

    Raises
    ------
    InputError
        If rosbags is missing, or the bag is damaged, empty, or of unknown types only.
    """
    bags = _import_rosbags()
    where, folder = str(path), Path(path) if Path(path).is_dir() else Path(path).parent
    attributes = _read_custom_data(folder / METADATA_FILE)
    times: dict[str, list[int]] = {}
    found: dict[str, list[Any]] = {}
    kinds: dict[str, str] = {}
    unread: dict[str, str] = {}
    store = bags.typesys.get_typestore(bags.typesys.Stores.LATEST)
    try:
        with bags.highlevel.AnyReader([Path(path)], default_typestore=store) as reader:
            for connection, arrival_ns, data in reader.messages():
                topic = connection.topic
                if topic in unread:
                    continue
                try:
                    message = reader.deserialize(data, connection.msgtype)
                except KeyError:
                    unread[topic] = connection.msgtype
                    continue
                kinds[topic] = connection.msgtype
                times.setdefault(topic, []).append(_read_header_stamp_ns(message) or arrival_ns)
                found.setdefault(topic, []).append(message)
    except Exception as error:  # the library raises its own errors, and those of YAML, SQLite and MCAP
        if isinstance(error, InputError):
            raise
        problem = f"cannot be read as a bag of ROS 2 ({error})"
        raise InputError(where, "", problem, "give the folder with metadata.yaml, or another copy") from error
    if not found:
        what = f"types unknown: {', '.join(sorted(set(unread.values())))}" if unread else "no messages"
        raise InputError(where, "", f"contains no readable topic ({what})", "record topics of standard types")
    zero = int(attributes.get("start_time_ns", 0)) if attributes else min(min(t) for t in times.values())
    ours, tables = attributes is not None, {}
    for topic, messages in found.items():
        fields = dict(_iterate_message_fields(messages))
        time = (np.array(times[topic], dtype=np.int64) - zero) / NANOSECONDS_PER_SECOND
        units: dict[str, str] = {}
        for name, values in decode_fields(topic, kinds[topic], fields, ours=ours).items():
            known = find_quantity(name)
            for column, one in zip(_column_names(name, values.shape[1]), values.T, strict=True):
                fields[column] = one
                units[column] = known.units if known is not None else "1"
        tables[topic] = RawTable(topic, time, fields, units)
    notes = tuple(f"{topic}: {kind} is an unknown type; the topic is skipped" for topic, kind in unread.items())
    for note in notes:
        warnings.warn(f"{Path(path).name}: {note}", LogWarning, stacklevel=3)
    return RawLog(
        path=where,
        format_name="rosbag2",
        tables_by_topic=tables,
        start_time=format_wall_time(zero / 1e9) if zero > 10**18 // 2 else "",
        info={"recorded by": "mufly", **attributes} if attributes is not None else {},
        notes=notes,
    )


def bag_column_map(raw: RawLog) -> ColumnMap:
    """Return the map from the decoded fields of a bag to signals; if several topics contain a signal, the first one is
    used.
    """
    entries: list[dict[str, Any]] = []
    for topic, table in raw.items():
        for name in dict.fromkeys(f.partition(".")[0] for f in table.units):
            columns = [f for f in table.units if f.partition(".")[0] == name]
            held = name.startswith("reference_") or name in ("motor_input", "servo_input")
            entries.append({"name": name, "topic": topic, "columns": columns, "hold": held})
    if STATE_TOPIC in raw and "data" in raw[STATE_TOPIC].fields:
        entries.append({"name": "mission_state", "topic": STATE_TOPIC, "columns": ["data"], "hold": True})
    return ColumnMap.model_validate({"title": "ROS 2", "signal": entries})


def _column_names(signal: str, count: int) -> list[str]:
    known = find_quantity(signal)
    if known is None or known.dim is None:
        return [signal]
    return [f"{signal}.{label}" for label in (known.component_labels or range(count))]  # only beams have no labels


def _read_custom_data(path: Path) -> dict[str, Any] | None:
    """Return the attributes that mufly wrote into a bag; None for a bag of another program."""
    from ruamel.yaml import YAML

    with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
        content = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        found: dict[str, Any] = json.loads(content["rosbag2_bagfile_information"]["custom_data"][_CUSTOM_DATA_KEY])
        return found
    return None


def _read_header_stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header (ns); 0 without one."""
    header = getattr(message, "header", message)
    stamp = getattr(header, "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * NANOSECONDS_PER_SECOND + int(stamp.nanosec)


def _iterate_message_fields(values: list[Any], name: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the fields of messages of one type by name, each (n,); NaN where a list is shorter than the longest."""
    first = values[0]
    if dataclasses.is_dataclass(first):
        for field in dataclasses.fields(first):
            inner = f"{name}.{field.name}" if name else field.name
            yield from _iterate_message_fields([getattr(v, field.name) for v in values], inner)
    elif isinstance(first, np.ndarray | list):
        count = max(map(len, values))
        if count > _MAX_SIGNAL_LIST_LENGTH:
            return
        for k in range(count):
            there = [j for j, v in enumerate(values) if len(v) > k]
            for part, column in _iterate_message_fields([values[j][k] for j in there], f"{name}[{k}]"):
                if len(there) < len(values):
                    text = column.dtype.kind == "U"
                    whole: NDArray[Any] = np.full(len(values), "" if text else np.nan, column.dtype if text else float)
                    whole[there] = column
                    column = whole
                yield part, column
    else:
        yield name, np.array(values, dtype=str if isinstance(first, str) else np.float64)
