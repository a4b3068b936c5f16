"""Recordings as MCAP files for Foxglove and PlotJuggler.

:mod:`mufly.logs.mcap` defines the columns of a row; :func:`read_recording` returns the recorded
:class:`xarray.Dataset`, equal to the last bit. JSON has no NaN and no infinity: both are written as ``null`` and read
as NaN. The numbers of a block are written as JSON in one call (orjson prints the shortest text that restores the same
float64) and inserted between constant pieces of text, which needs no dictionary for each message.

Foreign logs become recordings, too (:func:`write_mcap`): floating-point signals over time, the state of the mission and
events are written; other text is not. Foreign MCAP files are read as topics.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import orjson
import xarray as xr
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Metadata
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.mcap import (
    FlightEvent,
    McapContents,
    McapWriter,
    RecordingLayout,
    read_events,
    read_mcap,
    rows_to_dataset,
    to_json_value,
)
from mufly.logs.raw_log import LogWarning, RawLog, RawTable, find_foreign_epoch_stamps, format_wall_time
from mufly.quantities.quantity_table import DIMENSION_LABELS, SIGNAL_SOURCES, Quantity, quantities_recorded_in

RECORDING_FORMAT_VERSION = 1
ROW_CLOCK_TOPIC = "/mission"
EVENT_TOPIC = "/events"
FLIGHT_METADATA_NAME = "mufly.flight"
LAYOUT_METADATA_NAME = "mufly.layout"
OUTCOME_METADATA_NAME = "mufly.outcome"
FOXGLOVE_LEVELS = {"info": 2, "warning": 3, "error": 4}  # levels of foxglove.Log


def read_recording(path: str | Path) -> xr.Dataset:
    """Read a recording, complete or truncated at any byte.

    Parameters
    ----------
    path : str or Path
        MCAP file written by :class:`mufly.flight.FlightRecorder`.

    Returns
    -------
    xarray.Dataset
        Dataset as from :func:`rows_to_dataset`. ``attrs["complete"]`` is False when the file has no end mark or a
        damaged chunk; a :class:`mufly.logs.LogWarning` then describes the missing parts. Every complete row is read; a
        truncated file loses at most the last second.

    Raises
    ------
    InputError
        If the file does not exist, is no MCAP file, is no recording of this package, or has no complete chunk of rows.
    """
    return recording_from_contents(read_mcap(path), str(path))


def is_recording(contents: McapContents) -> bool:
    """Return whether this package wrote the file."""
    return LAYOUT_METADATA_NAME in contents.metadata and FLIGHT_METADATA_NAME in contents.metadata


def recording_from_contents(contents: McapContents, where: str) -> xr.Dataset:
    """Return the dataset in the contents of a recording; errors as :func:`read_recording`."""
    if not is_recording(contents):
        remedy = "give a file written by mufly (its metadata say so)"
        raise InputError(where, "", "is an MCAP file but not a recording of mufly", remedy)
    try:
        layout = RecordingLayout.from_json(
            verify_and_remove_checksum(contents.metadata[LAYOUT_METADATA_NAME])["layout"]
        )
        attributes = _parse_attributes(contents.metadata[FLIGHT_METADATA_NAME])
    except (KeyError, TypeError, ValueError) as error:
        problem = f"the description at its beginning is damaged ({error})"
        raise InputError(where, "", problem, "use another copy of the file") from error
    attributes["complete"] = contents.is_complete
    try:
        attributes |= _parse_attributes(contents.metadata.get(OUTCOME_METADATA_NAME, add_metadata_checksum({})))
    except (KeyError, TypeError, ValueError):
        attributes["complete"] = False
    rows, states = _join_topic_rows(contents, layout)
    damage = contents.describe_damage(int(attributes.get("start_time_ns", 0)))
    if not states:
        raise InputError(
            where,
            "",
            f"contains no rows{f' that can be read ({damage})' if contents.lost_parts else ''}",
            "give another copy of the file"
            if contents.lost_parts
            else "the flight ended before its first row was on disk",
        )
    if not attributes["complete"]:
        note = f"is damaged, cut off or still being written; what is whole, to {rows[-1, 0]:g} s, is here"
        warnings.warn(f"{Path(where).name}: {note}{f' ({damage})' if damage else ''}", LogWarning, stacklevel=3)
    return rows_to_dataset(rows, states, layout, attributes=attributes, events=_parse_events(contents))


def add_metadata_checksum(texts: Mapping[str, str]) -> dict[str, str]:
    """Add a checksum, since MCAP protects chunks but not metadata."""
    return {**texts, "crc32": str(zlib.crc32(orjson.dumps(dict(texts), option=orjson.OPT_SORT_KEYS)))}


def verify_and_remove_checksum(texts: Mapping[str, str]) -> dict[str, str]:
    """Remove the checksum of :func:`add_metadata_checksum`; ValueError if it is wrong."""
    content = {key: value for key, value in texts.items() if key != "crc32"}
    if add_metadata_checksum(content) != texts:
        raise ValueError("wrong checksum")
    return content


def _parse_attributes(texts: Mapping[str, str]) -> dict[str, Any]:
    return {key: orjson.loads(value) for key, value in verify_and_remove_checksum(texts).items()}


def _join_topic_rows(contents: McapContents, layout: RecordingLayout) -> tuple[NDArray[np.float64], list[str]]:
    """Return a recording's rows of numbers and mission states, joined from the messages, one per topic and row."""
    found = {t: contents.messages_by_topic.get(t, []) for t in (ROW_CLOCK_TOPIC, *layout.quantities_by_topic)}
    if not contents.is_complete:
        found = _select_complete_rows(found)
    clock = [orjson.loads(data) for _, data in found[ROW_CLOCK_TOPIC]]
    n = len(clock)
    table: list[list[list[float | None]]] = [[[entry["time"]] for entry in clock]]
    for topic, quantities in layout.quantities_by_topic.items():
        messages = found[topic]
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
    return np.hstack(blocks) if n else np.empty((0, layout.column_count)), [entry["state"] for entry in clock[:n]]


def _select_complete_rows(found: dict[str, list[tuple[int, bytes]]]) -> dict[str, list[tuple[int, bytes]]]:
    """Return the messages of complete rows; all messages of a row have the same time."""
    times = [{t for t, _ in messages} for messages in found.values()]
    whole = set.intersection(*times) if times else set()
    return {topic: [m for m in messages if m[0] in whole] for topic, messages in found.items()}


def _parse_events(contents: McapContents) -> list[FlightEvent]:
    entries = (orjson.loads(data) for _, data in contents.messages_by_topic.get(EVENT_TOPIC, []))
    levels = {number: name for name, number in FOXGLOVE_LEVELS.items()}
    return [FlightEvent(e["time"], e["name"], e["message"], levels.get(e["level"], "info")) for e in entries]


def read_attachments(path: str | Path) -> dict[str, bytes]:
    """Return the files attached to a recording: ``{"mission.toml": b"...", "vehicle.toml": b"..."}``.

    Raises
    ------
    InputError
        If the file does not exist or is no MCAP file.
    """
    return read_mcap(path).attachments


def read_recording_summary(path: str | Path) -> dict[str, Any]:
    """Return metadata of a recording without its signals, in about 1 % of the time for reading the signals.

    Returns
    -------
    dict
        Attributes of :func:`read_recording` (none for a foreign MCAP file), ``duration_s`` from the first message to
        the last, and ``complete``.

    Raises
    ------
    InputError
        If the file does not exist, is no MCAP file, or is empty.
    """
    facts: dict[str, Any] = {"complete": True}
    first, last, count, metadata = 0, 0, 0, {}
    try:
        with open(path, "rb") as stream:
            reader = make_reader(stream)
            found = reader.get_summary()
            metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        if found is None or found.statistics is None:
            raise ValueError("no summary")
        first, last = found.statistics.message_start_time, found.statistics.message_end_time
        count = found.statistics.message_count
    except Exception:  # The library raises any error on a damaged file; its records are then read one by one.
        with suppress(Exception):
            first, last, count, metadata = _scan_records(path)
        facts["complete"] = False
        if not count:  # Damaged or no MCAP: a complete read gives the reason.
            contents = read_mcap(path)
            times = [t for messages in contents.messages_by_topic.values() for t, _ in (messages[:1] + messages[-1:])]
            first, last, count = min(times, default=0), max(times, default=0), len(times)
            metadata, facts["complete"] = contents.metadata, contents.is_complete
    if not count:
        raise InputError(str(path), "", "contains no messages", "it ended before its first second was written to disk")
    for name in (FLIGHT_METADATA_NAME, OUTCOME_METADATA_NAME):
        with suppress(KeyError, TypeError, ValueError):
            facts |= _parse_attributes(metadata[name])
    return {"start_time_ns": first} | facts | {"duration_s": (last - first) * 1e-9}


_RECORD_HEAD_STRUCT = struct.Struct("<BQ")  # opcode, length
_TIME_RANGE_STRUCT = struct.Struct("<QQ")
_MAGIC_SIZE_BYTES = 8
_MESSAGE_OPCODE, _CHUNK_OPCODE, _METADATA_OPCODE, _LAST_OPCODE = 0x05, 0x06, 0x0C, 0x0F


def _scan_records(path: str | Path) -> tuple[int, int, int, dict[str, Any]]:
    """Return first and last time (ns), numbers of chunks and messages, and metadata of a file without end mark.

    Only the heads of chunks are read, which hold the times. Zeros for a file damaged before its last byte.
    """
    first, last, count, metadata = 0, 0, 0, {}
    with open(path, "rb") as stream:
        size = stream.seek(0, 2)
        at = _MAGIC_SIZE_BYTES
        while at + _RECORD_HEAD_STRUCT.size <= size:
            stream.seek(at)
            opcode, length = _RECORD_HEAD_STRUCT.unpack(stream.read(_RECORD_HEAD_STRUCT.size))
            at += _RECORD_HEAD_STRUCT.size + length
            if not 0 < opcode <= _LAST_OPCODE:
                return 0, 0, 0, {}
            if at > size:
                break
            if opcode == _METADATA_OPCODE:
                found = Metadata.read(ReadDataStream(BytesIO(stream.read(length))))
                metadata[found.name] = found.metadata
            elif opcode in (_CHUNK_OPCODE, _MESSAGE_OPCODE):
                if opcode == _MESSAGE_OPCODE:
                    stream.seek(6, 1)  # channel, sequence
                begin, end = _TIME_RANGE_STRUCT.unpack(stream.read(_TIME_RANGE_STRUCT.size))
                first, last = (
                    min(first, begin) if count else begin,
                    max(last, end if opcode == _CHUNK_OPCODE else begin),
                )
                count += 1
    return first, last, count, metadata


def json_object_schema(properties: dict[str, Any], title: str = "") -> dict[str, Any]:
    """Return the JSON schema of an object with these properties, all required."""
    head = {"title": title} if title else {}
    return {**head, "type": "object", "properties": properties, "required": list(properties)}


def foxglove_time(time_ns: int) -> dict[str, int]:
    """Return a time (ns) as the seconds and nanoseconds of a Foxglove message."""
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}


_TEXT_SCHEMA, _INTEGER_SCHEMA = {"type": "string"}, {"type": "integer"}
_TIME_SCHEMA = json_object_schema({"sec": _INTEGER_SCHEMA, "nsec": _INTEGER_SCHEMA}, "time")
FOXGLOVE_LOG_SCHEMA = json_object_schema(
    {
        "timestamp": _TIME_SCHEMA,
        "level": _INTEGER_SCHEMA,
        "message": _TEXT_SCHEMA,
        "name": _TEXT_SCHEMA,
        "file": _TEXT_SCHEMA,
        "line": _INTEGER_SCHEMA,
        "time": {"type": "number", "description": "time since the start of the recording (s)"},
    },
    "foxglove.Log",
)
"""JSON schema of an event (foxglove.Log)."""


class ChannelRegistry(Protocol):
    """Destination of a recording's topics, which gives each a channel number: a file, or a server of live views."""

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Register a topic and its JSON schema; return the channel number."""


class TopicEncoder:
    """Encoder that registers the topics of a layout and converts blocks of rows to messages."""

    def __init__(self, file: ChannelRegistry, layout: RecordingLayout, start_time_ns: int) -> None:
        self._start = start_time_ns
        self._topics: list[tuple[int, slice, list[bytes]]] = []
        for topic, quantities in layout.quantities_by_topic.items():
            channel = file.add_channel(topic, f"mufly.{topic[1:]}", orjson.dumps(_topic_schema(layout, topic)))
            columns = slice(
                layout.column_slices[quantities[0].name].start, layout.column_slices[quantities[-1].name].stop
            )
            self._topics.append((channel, columns, _message_template(layout, topic)))
        clock = {
            "time": {"type": "number", "description": "time since the start of the recording (s)"},
            "state": {"type": "string", "description": "state of the mission"},
        }
        self._clock = file.add_channel(
            ROW_CLOCK_TOPIC, "mufly.mission", orjson.dumps(json_object_schema(clock, "mufly.mission"))
        )
        self._log = file.add_channel(EVENT_TOPIC, "foxglove.Log", orjson.dumps(FOXGLOVE_LOG_SCHEMA))

    def wall_times_ns(self, rows: NDArray[np.float64]) -> list[int]:
        """Return the wall time of every row (ns)."""
        return (np.rint(rows[:, 0] * 1e9).astype(np.int64) + self._start).tolist()

    def encode_messages(
        self, rows: NDArray[np.float64], states: Sequence[str], events: Sequence[FlightEvent]
    ) -> list[tuple[int, int, bytes]]:
        """Return the messages (channel, time in ns, content) of a block of rows and of events, not sorted by time."""
        out: list[tuple[int, int, bytes]] = []
        if len(rows):
            times = self.wall_times_ns(rows)
            numbers = encode_json_numbers(rows)
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
                "timestamp": foxglove_time(time_ns),
                "level": FOXGLOVE_LEVELS.get(event.level, 2),
                "message": event.text,
                "name": event.state,
                "file": "",
                "line": 0,
                "time": event.time_s,
            }
            out.append((self._log, time_ns, orjson.dumps(content)))
        return out


def encode_json_numbers(rows: NDArray[np.float64]) -> list[list[bytes]]:
    """Return the JSON text of every number; NaN and infinity become null."""
    text = orjson.dumps(np.ascontiguousarray(rows), option=orjson.OPT_SERIALIZE_NUMPY)
    return [row.split(b",") for row in text[2:-2].split(b"],[")]


def _message_template(layout: RecordingLayout, topic: str) -> list[bytes]:
    """Return a topic's message as constant texts, alternating with an empty element for each number."""
    pieces, text = [], b"{"
    for k, quantity in enumerate(layout.quantities_by_topic[topic]):
        text += b"," * bool(k) + orjson.dumps(quantity.field) + b":"
        labels = layout.component_labels(quantity)
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


def _topic_schema(layout: RecordingLayout, topic: str) -> dict[str, Any]:
    properties: dict[str, Any] = {}
    for quantity in layout.quantities_by_topic[topic]:
        # Values may be null (NaN), but viewers reject a schema with a choice of types.
        number = {"type": "number", "description": f"{quantity.long_name} ({quantity.units})"}
        if quantity.dim is None:
            properties[quantity.field] = number
        elif quantity.dim == "beam":
            properties[quantity.field] = {"type": "array", "items": number}
        else:
            labels = [str(label) for label in layout.component_labels(quantity)]
            properties[quantity.field] = json_object_schema(dict.fromkeys(labels, number))
    return json_object_schema(properties, f"mufly.{topic[1:]}")


_BLOCK_ROWS = 1000


def layout_from_dataset(dataset: xr.Dataset) -> RecordingLayout:
    """Return the row layout, topics and columns, in which a recording stores a dataset's numbers over time."""
    known = {q.name: q for q in quantities_recorded_in("flight")}
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
        source, _, rest = name.partition("_")
        topic, field = (f"/{source}", rest) if source in SIGNAL_SOURCES and rest else ("/signals", name)
        if name in known and known[name].dim == dim:
            topic, field = known[name].topic, known[name].field
        if dim == "beam":
            beams = len(here)
        elif dim is not None and DIMENSION_LABELS.get(dim) != here:
            labels[dim] = here
        found.append(Quantity(name, topic, field, dim, units, meaning))
    order = {topic: k for k, topic in enumerate(dict.fromkeys(q.topic for q in found))}
    found.sort(key=lambda q: order[q.topic])
    return RecordingLayout(tuple(found), beams, tuple(labels.items()))


def write_mcap(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as a recording, for :func:`mufly.logs.read_recording`.

    Raises
    ------
    InputError
        If the clock does not increase or the dataset has no numbers over time.
    """
    layout = layout_from_dataset(dataset)
    time = dataset["time"].values.astype(np.float64)
    if not layout.quantities or not len(time):
        raise InputError(str(path), "", "there are no signals to write", "choose signals that are numbers over time")
    if not (np.diff(time) > 0).all():
        raise InputError(str(path), "time", "does not increase", "resample it: give a rate")
    rows = np.empty((len(time), layout.column_count))
    rows[:, 0] = time
    for q in layout.quantities:
        variable = dataset[q.name] if q.dim is None else dataset[q.name].transpose("time", q.dim)
        rows[:, layout.column_slices[q.name]] = variable.values.reshape(len(time), -1)
    states = dataset["mission_state"].values.tolist() if "mission_state" in dataset else [""] * len(time)
    events = read_events(dataset) if "event_time" in dataset else []
    attributes = {
        "start_time_ns": _start_time_ns(dataset),
        "format": RECORDING_FORMAT_VERSION,
        **to_json_value(dataset.attrs),
    }
    attributes.pop("complete", None)
    outcome = {k: attributes.pop(k) for k in ("outcome", "reason") if k in attributes}
    with path.open("wb") as stream:
        file = McapWriter(stream, f"mufly {attributes.get('version', '')}".strip())
        encoder = TopicEncoder(file, layout, int(attributes["start_time_ns"]))
        file.write_metadata(FLIGHT_METADATA_NAME, add_metadata_checksum(_encode_json_texts(attributes)))
        file.write_metadata(LAYOUT_METADATA_NAME, add_metadata_checksum({"layout": layout.to_json()}))
        for start in range(0, len(time), _BLOCK_ROWS):
            part = slice(start, start + _BLOCK_ROWS)
            last = start + _BLOCK_ROWS >= len(time)
            until = np.inf if last else time[part][-1]
            now = [e for e in events if e.time_s <= until]
            events = events[len(now) :]
            messages = encoder.encode_messages(rows[part], states[part], now)
            file.write_chunk(sorted(messages, key=lambda m: m[1]))
        file.write_metadata(OUTCOME_METADATA_NAME, add_metadata_checksum(_encode_json_texts(outcome)))
        file.finish_file()


def _encode_json_texts(content: dict[str, Any]) -> dict[str, str]:
    return {key: orjson.dumps(value).decode() for key, value in content.items()}


def _start_time_ns(dataset: xr.Dataset) -> int:
    """Return the wall time of time zero; 0 (1970) if unknown, so that no date is invented."""
    if "start_time_ns" in dataset.attrs:
        return int(dataset.attrs["start_time_ns"])
    try:
        return round(datetime.fromisoformat(str(dataset.attrs.get("start_time", ""))).timestamp() * 1e9)
    except ValueError:
        return 0


# A longer list is a picture or a point cloud, no signal.
_MAX_SIGNAL_LIST_LENGTH = 64
# Topics of this package's recordings with drawings and texts.
_TOPICS_WITHOUT_SIGNALS = ("/tf", "/scene", "/track", "/reference_pose", "/events")


def parse_json_topics(contents: McapContents, where: str) -> RawLog:
    """Return the JSON messages of an MCAP file as topics; numbers in nested objects become fields ``position.N``.

    Raises
    ------
    InputError
        If there is no message, or no message is JSON.
    """
    ours = is_recording(contents)
    if not any(contents.messages_by_topic.values()):
        damage = contents.describe_damage()
        raise InputError(
            where, "", f"contains no messages{f' that can be read ({damage})' if damage else ''}",
            "give another copy of the file" if contents.lost_parts else "the recording ended before its first second",
        )  # fmt: skip
    times = {k: np.array([t for t, _ in m], dtype=np.float64) / 1e9 for k, m in contents.messages_by_topic.items()}
    foreign, strange = find_foreign_epoch_stamps(times)
    zero = min(
        t for k, m in contents.messages_by_topic.items() for (t, _), f in zip(m, foreign[k], strict=True) if not f
    )
    units = _units_by_topic(contents) if ours else {}
    tables: dict[str, RawTable] = {}
    unread, notes = [], []
    for topic, written in contents.messages_by_topic.items():
        if not written or (ours and topic in _TOPICS_WITHOUT_SIGNALS):
            continue
        kept, rows = _parse_json_rows([content for _, content in written])
        if not rows:
            unread.append(topic)
            continue
        if len(rows) < len(written):
            notes.append(f"{topic}: {len(written) - len(rows)} of {len(written)} messages are not JSON and are skipped")
        time = (np.array([written[k][0] for k in kept], dtype=np.int64) - zero) / 1e9
        time[foreign[topic][kept]] = np.nan
        names = dict.fromkeys(name for row in rows for name in row)
        fields = {name: _to_array([row.get(name) for row in rows]) for name in names}
        tables[topic] = RawTable(topic, time, fields, units.get(topic, {}))
    if not tables:
        problem = f"contains no JSON messages (topics: {', '.join(unread) or 'none'})"
        raise InputError(where, "", problem, "convert its messages to JSON first")
    if unread:
        notes.append(f"topics in another encoding than JSON are skipped: {', '.join(unread)}")
    notes += [w for w in strange if w.partition(": ")[0] in tables]
    return RawLog(
        path=where,
        format_name="MCAP",
        tables_by_topic=tables,
        # A log with unknown wall time begins in 1970.
        start_time=format_wall_time(zero / 1e9) if zero > 10**18 // 2 else "",
        info={"recorded by": "mufly"} if ours else {},
        is_complete=contents.is_complete,
        notes=tuple(notes),
        damage_text=contents.describe_damage(zero),
    )


_JSON_SAMPLE_SIZE = 20


def _parse_json_rows(contents: list[bytes]) -> tuple[Sequence[int], list[dict[str, Any]]]:
    """Return the indices of the JSON messages, and their values by field; none if few messages of a sample are JSON."""
    try:
        return range(len(contents)), [dict(_iterate_leaves(orjson.loads(data))) for data in contents]
    except orjson.JSONDecodeError:
        sample = contents[:: 1 + len(contents) // _JSON_SAMPLE_SIZE]
        if sum(map(_is_json, sample)) < len(sample) / 2:
            return (), []
        kept = [k for k, data in enumerate(contents) if _is_json(data)]
        return kept, [dict(_iterate_leaves(orjson.loads(contents[k]))) for k in kept]


def _is_json(data: bytes) -> bool:
    try:
        orjson.loads(data)
    except orjson.JSONDecodeError:
        return False
    return True


def _iterate_leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _iterate_leaves(inner, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        if len(value) <= _MAX_SIGNAL_LIST_LENGTH:
            for k, inner in enumerate(value):
                yield from _iterate_leaves(inner, f"{name}[{k}]")
    else:
        yield name, value


def _to_array(values: list[Any]) -> NDArray[Any]:
    if any(isinstance(v, str) for v in values):
        return np.array(["" if v is None else str(v) for v in values], dtype=str)
    return np.array([np.nan if v is None else v for v in values], dtype=np.float64)


def _units_by_topic(contents: McapContents) -> dict[str, dict[str, str]]:
    try:
        layout = RecordingLayout.from_json(
            verify_and_remove_checksum(contents.metadata[LAYOUT_METADATA_NAME])["layout"]
        )
    except (KeyError, TypeError, ValueError):
        return {}
    out: dict[str, dict[str, str]] = {}
    for topic, quantities in layout.quantities_by_topic.items():
        for q in quantities:
            labels = layout.component_labels(q)
            names = [q.field] if q.dim is None else [f"{q.field}.{k}" for k in labels]
            names = [f"{q.field}[{k}]" for k in labels] if q.dim == "beam" else names
            out.setdefault(topic, {}).update(dict.fromkeys(names, q.units))
    return out
