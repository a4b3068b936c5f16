"""The MCAP container: blocks of messages appended to a file, and a reader that survives a cut.

MCAP (specification: mcap.dev/spec) is a sequence of records, each ``opcode (u8), length (u64), content``.
Messages sit in chunks (compressed, with a checksum); schemas and channels precede the messages that use them;
after the data comes an index and an end mark. A file that is being written has an end mark after every write, without
an index, which the next write takes the place of: a killed program leaves a whole MCAP file, that any reader reads from
beginning to end. One that was cut (a pulled plug) has no end mark, but its whole chunks are as good as ever.

The record layouts come from the package ``mcap``. Its ``Writer`` spends about 5 microseconds a message on
Python objects; a flight has ten messages a row, so here a whole block of messages is framed at once.
"""

from __future__ import annotations

import csv
import json
import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import orjson
import xarray as xr
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.topics import Channel
from mufly.quantities import LABELS, Quantity, kept_by, quantity_named

MAGIC = b"\x89MCAP0\r\n"
# Opcode, length, channel, sequence, log time, publish time.
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = 2 + 4 + 8 + 8
UNFINISHED = "mufly.unfinished"
"""Name of the metadata that stand before the end mark of a file that was not finished."""


def _bytes(record: Any) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _packed(records_of_a_kind: Iterable[Any]) -> bytes:
    return b"".join(_bytes(record) for record in records_of_a_kind)


_OPEN_END = (
    _packed((records.Metadata(UNFINISHED, {}), records.DataEnd(0)))
    + struct.pack("<BQQQI", Opcode.FOOTER, 8 + 8 + 4, 0, 0, 0)
    + MAGIC
)


class McapFile:
    """Append-only MCAP file of JSON messages.

    Parameters
    ----------
    stream : binary file, open for writing, at its beginning
    library : str
        Name and version of the program that writes.

    Notes
    -----
    Every write leaves a whole file, as one ``write`` and one ``flush``. Chunks are compressed
    by Zstandard at level 1: a fifth to a third of the bytes of JSON numbers, in 4 microseconds a row (level 3
    takes half as long again and saves nothing; LZ4 is a quarter quicker and leaves nearly twice the bytes).
    """

    def __init__(self, stream: BinaryIO, library: str) -> None:
        self._stream = stream
        self._compress = zstandard.ZstdCompressor(level=1).compress
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._introduced = 0
        # Packed as they come: a recording of hours has one a second.
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._end = 0
        self._append(MAGIC + _bytes(records.Header(profile="", library=library)))

    def _append(self, data: bytes, end: bytes = _OPEN_END) -> int:
        """Write in place of the end mark (what an interrupted write left behind goes); the offset of the data."""
        start = self._end
        self._stream.seek(start)
        self._stream.write(data + end)
        self._stream.truncate()
        self._stream.flush()
        self._end = start + len(data)
        return start

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Announce a topic and its JSON schema; goes out with the next chunk. Returns the channel's number."""
        known = {s.name: s.id for s in self._schemas}
        if schema_name not in known:
            known[schema_name] = len(self._schemas) + 1
            self._schemas.append(records.Schema(known[schema_name], schema, "jsonschema", schema_name))
        number = len(self._channels) + 1
        self._channels.append(records.Channel(number, topic, "json", {}, known[schema_name]))
        return number

    def write_metadata(self, name: str, content: dict[str, str]) -> None:
        """Append a record of names and texts."""
        data = _bytes(records.Metadata(name=name, metadata=content))
        start = self._append(data)
        self._metadata_indexes.append(records.MetadataIndex(start, len(data), name))

    def write_attachment(self, name: str, media_type: str, content: bytes, time_ns: int) -> None:
        """Append a file."""
        data = _bytes(records.Attachment(time_ns, time_ns, name, media_type, content))
        start = self._append(data)
        index = records.AttachmentIndex(start, len(data), time_ns, time_ns, len(content), name, media_type)
        self._attachment_indexes.append(index)

    def write_chunk(self, messages: Sequence[tuple[int, int, bytes]]) -> None:
        """Append one chunk.

        Parameters
        ----------
        messages : sequence of (channel, time_ns, content)
            In order of time, at least one.
        """
        head = b"".join(_bytes(r) for r in [*self._schemas, *self._channels]) if not self._introduced else b""
        parts, offset, counts = [head], len(head), dict(self._counts)
        entries: defaultdict[int, array[int]] = defaultdict(lambda: array("Q"))
        pack = _MESSAGE.pack
        for channel, time_ns, content in messages:
            count = counts.get(channel, 0)
            counts[channel] = count + 1
            size = _MESSAGE_HEAD + len(content)
            parts.append(pack(Opcode.MESSAGE, size, channel, count & 0xFFFFFFFF, time_ns, time_ns))
            parts.append(content)
            entries[channel].extend((time_ns, offset))
            offset += size + 9
        plain = b"".join(parts)
        packed = self._compress(plain)
        first, last = messages[0][1], messages[-1][1]
        chunk = _bytes(records.Chunk("zstd", packed, last, first, zlib.crc32(plain), len(plain)))
        indexes, places = [], {}
        place = self._end + len(chunk)
        for channel, values in entries.items():
            content = values.tobytes()  # little-endian, as on every machine that Numba supports
            index = (
                struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)) + content
            )
            places[channel] = place
            place += len(index)
            indexes.append(index)
        tail = b"".join(indexes)
        start = self._append(chunk + tail)
        self._counts = defaultdict(int, counts)
        self._introduced = 1
        self._chunk_indexes += _bytes(
            records.ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=len(tail),
                message_index_offsets=places,
                message_start_time=first,
                uncompressed_size=len(plain),
            )
        )
        self._chunks += 1
        self._first_ns = first if self._first_ns is None else min(self._first_ns, first)
        self._last_ns = max(self._last_ns, last)

    def finish(self) -> None:
        """Append the index and the end mark."""
        statistics = records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns or 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        data_end = _bytes(records.DataEnd(0))
        summary_start = self._end + len(data_end)
        summary, offsets = b"", []
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, _packed(self._schemas)),
            (Opcode.CHANNEL, _packed(self._channels)),
            (Opcode.STATISTICS, _bytes(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, _packed(self._attachment_indexes)),
            (Opcode.METADATA_INDEX, _packed(self._metadata_indexes)),
        ]
        for opcode, content in groups:
            if content:
                offsets.append(records.SummaryOffset(opcode, summary_start + len(summary), len(content)))
                summary += content
        offset_start = summary_start + len(summary)
        summary += b"".join(_bytes(record) for record in offsets)
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, summary_start, offset_start)
        crc = zlib.crc32(footer_head, zlib.crc32(summary))
        self._append(data_end + summary + footer_head + struct.pack("<I", crc), MAGIC)


@dataclass
class McapContents:
    """What could be read of a file: ``messages`` maps a topic to (time_ns, content) in order."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    complete: bool = False


def read_mcap(path: str | Path) -> McapContents:
    """Read all messages, metadata and attachments, up to the first record that is cut off, damaged or not there.

    A kind of record that a wrong byte made unknown is passed over by every reader; in our own files the numbers of
    messages tell that one is missing.

    Raises
    ------
    InputError
        The file cannot be opened, is empty, or does not begin as an MCAP file does.
    """
    where = str(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
        raise InputError(where, "", problem, "give the path of a recording (.mcap)") from error
    if not data:
        raise InputError(where, "", "is empty", "give a recording (.mcap)")
    if not data.startswith(MAGIC):
        raise InputError(where, "", "is not an MCAP file", "give a recording (.mcap)")
    contents = McapContents()
    topics: dict[int, list[tuple[int, bytes]]] = {}
    counts: dict[int, int] = {}
    numbered = False
    try:
        for opcode, content in _walk(data, len(MAGIC)):
            if opcode == Opcode.MESSAGE:
                number, count, time_ns, _ = struct.unpack_from("<HIQQ", content)
                if numbered and count != counts.get(number, 0) & 0xFFFFFFFF:
                    raise ValueError("messages are missing")
                counts[number] = counts.get(number, 0) + 1
                topics[number].append((time_ns, content[_MESSAGE_HEAD:]))
            elif opcode == Opcode.HEADER:
                numbered = records.Header.read(_stream(content)).library.startswith("mufly")
            elif opcode == Opcode.CHANNEL:
                channel = records.Channel.read(_stream(content))
                topics[channel.id] = contents.messages.setdefault(channel.topic, [])
            elif opcode == Opcode.METADATA:
                metadata = records.Metadata.read(_stream(content))
                contents.metadata[metadata.name] = metadata.metadata
            elif opcode == Opcode.ATTACHMENT:
                attachment = records.Attachment.read(_stream(content))
                contents.attachments[attachment.name] = attachment.data
            elif opcode == Opcode.FOOTER:
                contents.complete = data.endswith(MAGIC) and UNFINISHED not in contents.metadata
                break
    except Exception:  # A damaged record can fail in any way; what came before it is sound.
        contents.complete = False
    return contents


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _walk(data: bytes, offset: int) -> Iterator[tuple[int, bytes]]:
    """Yield (opcode, content) of each whole record, those inside chunks too; stops where the data end."""
    while offset + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        start, offset = offset + 9, offset + 9 + length
        if offset > len(data):
            return
        if opcode == Opcode.CHUNK:
            yield from _walk(_unpack(records.Chunk.read(_stream(data[start:offset]))), 0)
        else:
            yield opcode, data[start:offset]


def _unpack(chunk: records.Chunk) -> bytes:
    """Return the records of a chunk; ValueError if its checksum or its compression is none of ours."""
    plain = bytes(chunk.data)
    if chunk.compression == "zstd":
        plain = zstandard.ZstdDecompressor().decompress(plain, max_output_size=chunk.uncompressed_size)
    elif chunk.compression:
        raise ValueError(f"compression {chunk.compression}")
    if chunk.uncompressed_crc and zlib.crc32(plain) != chunk.uncompressed_crc:
        raise ValueError("checksum")
    return plain


# ----------------------------------------------------------------------------
# Signals on one clock: which column of a row holds what, a dataset's components as plain columns, and back.
#
# A flight is a row of float64 values every sampling instant: column 0 is the time (s), the others are the quantities
# of :mod:`mufly.quantities` in their order. The writer, the schemas inside the file, the reader, the CSV header and
# ``docs/recordings.md`` follow a :class:`Layout`; a file carries its own copy, so that it stays readable when the
# table grows.
#
# As a plain column a component is called ``variable_label`` (``measured_attitude_roll``). What columns alone cannot
# say (the dataset's attributes, events, labels of a user's own dimensions) travels as one JSON text where the format
# has room for it.


_TOLD = ("name", "topic", "field", "dim", "units", "long_name")  # what a file says of a quantity
_TIME = {"units": "s", "long_name": "time"}
_EVENT = ("event_time", "event_state", "event_text", "event_level")


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
    other_labels : tuple of (dim, labels)
        Labels of dimensions that :mod:`mufly.quantities` does not have, in recordings made from other people's logs.
    """

    quantities: tuple[Quantity, ...]
    beams: int
    other_labels: tuple[tuple[str, tuple[str, ...] | tuple[int, ...]], ...] = ()

    def __post_init__(self) -> None:
        if list(self.topics) != [topic for topic, _ in groupby(q.topic for q in self.quantities)]:
            raise ValueError("the quantities of a topic must stand together")

    def labels(self, quantity: Quantity) -> tuple[str, ...] | tuple[int, ...]:
        """Labels along the quantity's dimension; empty for a scalar."""
        if quantity.dim is None:
            return ()
        if quantity.dim == "beam":
            return tuple(range(self.beams))
        return dict(self.other_labels).get(quantity.dim) or LABELS[quantity.dim]

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
        content: dict[str, object] = {
            "beams": self.beams,
            "quantities": [{k: getattr(q, k) for k in _TOLD} for q in self.quantities],
        }
        if self.other_labels:
            content["labels"] = dict(self.other_labels)
        return orjson.dumps(content).decode()

    @classmethod
    def from_json(cls, text: str) -> Layout:
        """Inverse of :meth:`to_json`."""
        content = orjson.loads(text)
        others = tuple((dim, tuple(labels)) for dim, labels in content.get("labels", {}).items())
        return cls(tuple(Quantity(**q) for q in content["quantities"]), int(content["beams"]), others)


def standard_layout(beams: int = 8, *, sensors: bool = False) -> Layout:
    """Layout of the rows of a flight with ``beams`` range beams, on ideal sensors or on its own."""
    return Layout(kept_by("flight", "sensors") if sensors else kept_by("flight"), beams)


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
    coords: dict[str, Any] = {"time": ("time", rows[:, 0].copy(), _TIME)}
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
    parts = zip(*events, strict=True) if events else [()] * len(_EVENT)
    variables |= {name: _event_part(name, values) for name, values in zip(_EVENT, parts, strict=True)}
    return xr.Dataset(variables, coords, dict(attributes or {}))


def _event_part(name: str, values: Sequence[Any]) -> tuple[Any, ...]:
    if name == "event_time":
        attrs = {"units": "s", "long_name": "time of the event"}
        return "event", np.array(values, dtype=np.float64), attrs
    return "event", np.array(values, dtype=str)


def events_of(dataset: xr.Dataset) -> list[Event]:
    """The events of a recording, in order of time."""
    parts = (dataset[name].values.tolist() for name in _EVENT)
    return [Event(*values) for values in zip(*parts, strict=True)]


def columns_of(dataset: xr.Dataset) -> list[Channel]:
    """Return the components of every variable over time, in order."""
    time = dataset["time"].values
    out = []
    # Variables, not arrays: to make an array of each of n, xarray looks through all n coordinates anew.
    for key in dataset.data_vars:
        name, variable = str(key), dataset.variables[key]
        units = str(variable.attrs.get("units", "1"))
        if "time" not in variable.dims or variable.ndim > 2:
            continue
        if variable.ndim == 1:
            out.append(Channel(name, units, time, variable.values))
            continue
        dim = next(d for d in variable.dims if d != "time")
        block = variable.transpose("time", dim).values
        for k, label in enumerate(dataset[dim].values.tolist()):
            out.append(Channel(f"{name}.{label}", units, time, block[:, k]))
    return out


def dataset_of(time: NDArray[np.float64], channels: Sequence[Channel]) -> xr.Dataset:
    """Put channels whose values are on one clock together as a dataset; components that are missing are NaN.

    Parameters
    ----------
    time : (n,) array
        s.
    channels : sequence of Channel
        With n values each; their own clocks do not matter.
    """
    coords: dict[str, Any] = {"time": ("time", time, _TIME)}
    variables: dict[str, Any] = {}
    groups: dict[str, list[Channel]] = {}
    for channel in channels:
        groups.setdefault(channel.variable, []).append(channel)
    # Variables that count their channels share that dimension, so it is as long as the longest of them.
    counted: dict[str, list[int]] = {}
    for name, group in groups.items():
        known = quantity_named(name)
        if known is not None and known.dim and not known.labels:
            counted.setdefault(known.dim, []).extend(int(str(c.label)) for c in group)
    for name, group in groups.items():
        known, values = quantity_named(name), group[0].values
        attrs = {} if values.dtype.kind in "US" else {"units": group[0].units}
        attrs["long_name"] = known.long_name if known else name.replace("_", " ")
        if known is None or known.dim is None:
            variables[name] = ("time", values, attrs)
            continue
        labels: tuple[Any, ...] = known.labels or tuple(sorted(set(counted[known.dim])))
        coords[known.dim] = list(labels)
        found = {c.label: c.values for c in group}
        missing = np.full(len(time), np.nan)
        block = np.column_stack([found.get(str(k), missing) for k in labels])
        variables[name] = (("time", known.dim), block, attrs)
    return xr.Dataset(variables, coords)


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set):
        return [plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def describe(dataset: xr.Dataset) -> str:
    """Return as JSON what the columns do not say, for :func:`restore`."""
    variables = {}
    for key, variable in dataset.data_vars.items():
        if "time" in variable.dims and variable.ndim <= 2:
            dim = next((str(d) for d in variable.dims if d != "time"), None)
            labels = None if dim is None else plain(variable[dim].values)
            variables[str(key)] = {"dim": dim, "labels": labels, "attrs": plain(variable.attrs)}
    events = {str(k): plain(v.values) for k, v in dataset.data_vars.items() if v.dims == ("event",)}
    content = {"variables": variables, "events": events, "attributes": plain(dataset.attrs)}
    return json.dumps(content)


def restore(time: NDArray[np.float64], columns: Mapping[str, NDArray[Any]], description: str) -> xr.Dataset:
    """Inverse of :func:`columns_of` and :func:`describe`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If columns and description do not belong together.
    """
    content = json.loads(description)
    coords: dict[str, Any] = {"time": ("time", time, _TIME)}
    variables: dict[str, Any] = {}
    for name, about in content["variables"].items():
        dim, labels, attrs = about["dim"], about["labels"], about["attrs"]
        if dim is None:
            variables[name] = ("time", columns[name], attrs)
            continue
        known = LABELS.get(dim)
        coords[dim] = list(known) if known and list(map(str, known)) == list(map(str, labels)) else labels
        block = np.column_stack([columns[f"{name}_{label}"] for label in labels])
        variables[name] = (("time", dim), block, attrs)
    for name, values in content["events"].items():
        variables[name] = _event_part(name, values)
    return xr.Dataset(variables, coords, content["attributes"])


def to_csv(dataset: xr.Dataset, path: str | Path) -> Path:
    """Write a recording as one comma-separated table, one row an instant.

    The header names variable, label and unit, ``truth_position_N [m]``; a pure number has no unit. Values are
    written with as many digits as bring back the same float64; NaN is an empty cell.

    Returns
    -------
    Path
        The file written.
    """
    channels = [Channel("time", "s", dataset["time"].values, dataset["time"].values), *columns_of(dataset)]
    header = [c.column + (f" [{c.units}]" if c.units != "1" else "") for c in channels]
    columns = [c.values.tolist() for c in channels]
    target = Path(path)
    with target.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(header)
        # A value that differs from itself is NaN.
        writer.writerows(["" if v != v else v for v in row] for row in zip(*columns, strict=True))
    return target
