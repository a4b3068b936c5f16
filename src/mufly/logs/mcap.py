"""The MCAP container: blocks of messages appended to a file, and a reader that survives a cut.

MCAP (specification: mcap.dev/spec) is a sequence of records, each ``opcode (u8), length (u64), content``.
Messages sit in chunks (compressed, with a checksum); schemas and channels precede the messages that use them;
after the data comes an index and an end mark. A file that ends early has no end mark, but its whole chunks
are as good as ever: that is what makes a recording survive a crash.

The record layouts come from the package ``mcap``. Its ``Writer`` spends about 5 microseconds a message on
Python objects; a flight has ten messages a row, so here a whole block of messages is framed at once.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode

from mufly.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
# Opcode, length, channel, sequence, log time, publish time.
_MESSAGE = struct.Struct("<BQHIQQ")
_MESSAGE_HEAD = 2 + 4 + 8 + 8


def _bytes(record: Any) -> bytes:
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _packed(records_of_a_kind: Iterable[Any]) -> bytes:
    return b"".join(_bytes(record) for record in records_of_a_kind)


class McapFile:
    """Append-only MCAP file of JSON messages.

    Parameters
    ----------
    stream : binary file, open for writing, at its beginning
    library : str
        Name and version of the program that writes.

    Notes
    -----
    Every write leaves the file at a record boundary, as one ``write`` and one ``flush``. Chunks are compressed
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

    def _append(self, data: bytes) -> int:
        """Write at the last record boundary (what an interrupted write left behind goes); its offset."""
        start = self._end
        if self._stream.tell() != start:
            self._stream.seek(start)
            self._stream.truncate()
        self._stream.write(data)
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
        self._append(data_end + summary + footer_head + struct.pack("<I", crc) + MAGIC)


@dataclass
class McapContents:
    """What could be read of a file: ``messages`` maps a topic to (time_ns, content) in order."""

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    complete: bool = False


def read_mcap(path: str | Path) -> McapContents:
    """Read all messages, metadata and attachments, up to the first record that is cut off or damaged.

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
    try:
        for opcode, content in _walk(data, len(MAGIC)):
            if opcode == Opcode.MESSAGE:
                number, _, time_ns, _ = struct.unpack_from("<HIQQ", content)
                topics[number].append((time_ns, content[_MESSAGE_HEAD:]))
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
                contents.complete = data.endswith(MAGIC)
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
