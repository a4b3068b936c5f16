"""Writer of the MCAP container: appended blocks of messages in a file that is valid after every write.

MCAP (specification: mcap.dev/spec) is a sequence of records, each ``opcode (u8), length (u64), content``.
Messages sit in chunks (compressed, with a checksum); schemas and channels precede the messages that use them;
after the data come an index and an end mark. After every write the file has an end mark without an index, which the
next write replaces: a killed program leaves a complete MCAP file, which any reader reads sequentially. A truncated file
(after a loss of power) has no end mark, but its complete chunks stay readable.

The record layouts come from the package ``mcap``. Its ``Writer`` takes about 5 microseconds a message for Python
objects; a flight has ten messages a row, so this module frames a whole block of messages at once.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, BinaryIO

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
MESSAGE_HEAD_STRUCT = struct.Struct("<BQHIQQ")
"""Head of a message: opcode, length, channel, sequence, log time, publish time."""
MESSAGE_FIELDS_SIZE = 2 + 4 + 8 + 8
"""Bytes of a message before its content, without opcode and length."""
UNFINISHED_METADATA_NAME = "mufly.unfinished"
"""Name of the metadata before the end mark of an unfinished file."""


def _encode_record(record: Any) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _encode_records(records_of_a_kind: Iterable[Any]) -> bytes:
    return b"".join(_encode_record(record) for record in records_of_a_kind)


_UNFINISHED_END = (
    _encode_records((records.Metadata(UNFINISHED_METADATA_NAME, {}), records.DataEnd(0)))
    + struct.pack("<BQQQI", Opcode.FOOTER, 8 + 8 + 4, 0, 0, 0)
    + MAGIC
)


class McapWriter:
    """Append-only MCAP file of JSON messages.

    Parameters
    ----------
    stream : binary file, open for writing, at its beginning
    library : str
        Name and version of the writing program.

    Notes
    -----
    Every write leaves a complete file, and is one ``write`` and one ``flush``. Chunks are compressed by Zstandard at
    level 1, to between a fifth and a third of the bytes of JSON numbers, in 4 microseconds a row. Level 3 takes 1.5
    times as long and saves nothing; LZ4 is a quarter faster and needs nearly twice the bytes.
    """

    def __init__(self, stream: BinaryIO, library: str) -> None:
        self._stream = stream
        self._compress = zstandard.ZstdCompressor(level=1).compress
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._introduced = 0
        # Encoded one by one, since a recording of hours has one chunk a second.
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._counts: defaultdict[int, int] = defaultdict(int)
        self._end = 0
        self._append_data(MAGIC + _encode_record(records.Header(profile="", library=library)))

    def _append_data(self, data: bytes, end: bytes = _UNFINISHED_END) -> int:
        """Append data where the end mark stands, and the end mark again; return the offset of the data.

        The rest of an interrupted write is overwritten.
        """
        start = self._end
        self._stream.seek(start)
        self._stream.write(data + end)
        self._stream.truncate()
        self._stream.flush()
        self._end = start + len(data)
        return start

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Register a topic and its JSON schema, written with the next chunk; return the channel number."""
        known = {s.name: s.id for s in self._schemas}
        if schema_name not in known:
            known[schema_name] = len(self._schemas) + 1
            self._schemas.append(records.Schema(known[schema_name], schema, "jsonschema", schema_name))
        number = len(self._channels) + 1
        self._channels.append(records.Channel(number, topic, "json", {}, known[schema_name]))
        return number

    def write_metadata(self, name: str, content: dict[str, str]) -> None:
        """Append a metadata record."""
        data = _encode_record(records.Metadata(name=name, metadata=content))
        start = self._append_data(data)
        self._metadata_indexes.append(records.MetadataIndex(start, len(data), name))

    def write_attachment(self, name: str, media_type: str, content: bytes, time_ns: int) -> None:
        """Append a file."""
        data = _encode_record(records.Attachment(time_ns, time_ns, name, media_type, content))
        start = self._append_data(data)
        index = records.AttachmentIndex(start, len(data), time_ns, time_ns, len(content), name, media_type)
        self._attachment_indexes.append(index)

    def write_chunk(self, messages: Sequence[tuple[int, int, bytes]]) -> None:
        """Append messages to the file as one chunk.

        Parameters
        ----------
        messages : sequence of (channel, time_ns, content)
            In order of time, at least one.
        """
        head = b"".join(_encode_record(r) for r in [*self._schemas, *self._channels]) if not self._introduced else b""
        parts, offset, counts = [head], len(head), dict(self._counts)
        entries: defaultdict[int, array[int]] = defaultdict(lambda: array("Q"))
        pack = MESSAGE_HEAD_STRUCT.pack
        for channel, time_ns, content in messages:
            count = counts.get(channel, 0)
            counts[channel] = count + 1
            size = MESSAGE_FIELDS_SIZE + len(content)
            parts.append(pack(Opcode.MESSAGE, size, channel, count & 0xFFFFFFFF, time_ns, time_ns))
            parts.append(content)
            entries[channel].extend((time_ns, offset))
            offset += size + 9
        plain = b"".join(parts)
        packed = self._compress(plain)
        first, last = messages[0][1], messages[-1][1]
        chunk = _encode_record(records.Chunk("zstd", packed, last, first, zlib.crc32(plain), len(plain)))
        indexes, places = [], {}
        place = self._end + len(chunk)
        for channel, values in entries.items():
            content = values.tobytes()  # little-endian, as on every machine that Numba supports
            index = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(content), channel, len(content)) + content
            places[channel] = place
            place += len(index)
            indexes.append(index)
        tail = b"".join(indexes)
        start = self._append_data(chunk + tail)
        self._counts = defaultdict(int, counts)
        self._introduced = 1
        self._chunk_indexes += _encode_record(
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

    def finish_file(self) -> None:
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
        data_end = _encode_record(records.DataEnd(0))
        summary_start = self._end + len(data_end)
        summary, offsets = b"", []
        groups: list[tuple[Opcode, bytes]] = [
            (Opcode.SCHEMA, _encode_records(self._schemas)),
            (Opcode.CHANNEL, _encode_records(self._channels)),
            (Opcode.STATISTICS, _encode_record(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, _encode_records(self._attachment_indexes)),
            (Opcode.METADATA_INDEX, _encode_records(self._metadata_indexes)),
        ]
        for opcode, content in groups:
            if content:
                offsets.append(records.SummaryOffset(opcode, summary_start + len(summary), len(content)))
                summary += content
        offset_start = summary_start + len(summary)
        summary += b"".join(_encode_record(record) for record in offsets)
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, summary_start, offset_start)
        crc = zlib.crc32(footer_head, zlib.crc32(summary))
        self._append_data(data_end + summary + footer_head + struct.pack("<I", crc), MAGIC)
