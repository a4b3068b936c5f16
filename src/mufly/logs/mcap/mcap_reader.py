"""Reader of the MCAP container: all intact records, also of a damaged or truncated file.

A record with an impossible length, or a chunk with a wrong checksum, is omitted and reported. Reading continues at the
next valid record. It is found by the length, by the index at the end (chunks), or by the form of a record's head (MCAP
specification, "Records": opcode, length; a chunk's times, sizes, checksum, compression). Of a chunk cut by the end of
the file the messages before the cut are kept. The number of missing messages follows from the statistics in the index,
from the message indexes after each chunk, and in this package's files from the messages' numbers.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from mufly.errors import InputError
from mufly.logs.mcap.mcap_writer import MAGIC, MESSAGE_FIELDS_SIZE, MESSAGE_HEAD_STRUCT, UNFINISHED_METADATA_NAME

_RECORD_HEAD_STRUCT = struct.Struct("<BQ")
_CHUNK_HEAD_STRUCT = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
_FOOTER_SIZE = _RECORD_HEAD_STRUCT.size + 20
_MESSAGE_DATA_OFFSET = _RECORD_HEAD_STRUCT.size + MESSAGE_FIELDS_SIZE
_FIRST_PRIVATE_OPCODE = 0x80
_IGNORED_OPCODES = (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX,
                Opcode.STATISTICS, Opcode.SUMMARY_OFFSET, *range(_FIRST_PRIVATE_OPCODE, 256))  # fmt: skip
# Head of a chunk: opcode; lengths below 1 TB; a supported compression.
_CHUNK_HEAD_PATTERN = re.compile(
    rb"\x06.{5}\x00{3}.{21}\x00{3}.{4}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
)
# Heads of other records next to chunks, and of messages, shorter than 4 GB.
_RECORD_HEAD_PATTERN = re.compile(rb"[\x09\x0c\x0f].{4}\x00{4}", re.DOTALL)
_MESSAGE_HEAD_PATTERN = re.compile(rb"[\x03\x04\x05\x09\x0c\x0f].{4}\x00{4}", re.DOTALL)
_MAX_DESCRIBED_PARTS = 3
_CRC_SIZE = 4


class LostPart(NamedTuple):
    """Part of a damaged file that cannot be read.

    Attributes
    ----------
    description : str
        Description: ``"a chunk of 4151 bytes at byte 15434 cannot be read (wrong checksum)"``.
    offset, size : int
        Position and size in the file (bytes).
    message_count : int
        Number of messages known to be missing with it; 0 if unknown.
    first_ns, last_ns : int
        Times of the first and the last missing message (ns); 0 if unknown.
    """

    description: str
    offset: int
    size: int
    message_count: int = 0
    first_ns: int = 0
    last_ns: int = 0


@dataclass
class McapContents:
    """All messages, metadata and attachments that could be read from a file.

    Attributes
    ----------
    metadata, attachments : dict
    messages_by_topic : dict
        Messages of each topic as (time_ns, content), in order.
    is_complete : bool
        Whether the file has its end mark and no damage.
    lost_parts : list of LostPart
    expected_messages : int
        Number of messages that the file had, by its own count; 0 if unknown.
    other_faults : list of str
        Other faults: a missing end mark, a damaged index, ...
    """

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages_by_topic: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    is_complete: bool = False
    lost_parts: list[LostPart] = field(default_factory=list)
    expected_messages: int = 0
    other_faults: list[str] = field(default_factory=list)

    def describe_damage(self, zero_ns: int | None = None) -> str:
        """Describe the missing parts; times count from ``zero_ns``, by default from the first missing time.

        The text is ``""`` for a complete file.
        """
        if zero_ns is None:
            zero_ns = min((p.first_ns for p in self.lost_parts if p.first_ns), default=0)
        said = [_describe_lost_part(part, zero_ns) for part in self.lost_parts[:_MAX_DESCRIBED_PARTS]]
        more = self.lost_parts[_MAX_DESCRIBED_PARTS:]
        if more:
            said.append(f"{sum(p.size for p in more)} bytes in {len(more)} more places, too")
        count = sum(len(m) for m in self.messages_by_topic.values())
        if self.expected_messages > count:
            said.append(f"{count} of {self.expected_messages} messages are in the file")
        return "; ".join(said + self.other_faults)


def _describe_lost_part(part: LostPart, zero_ns: int) -> str:
    if not part.first_ns:
        return part.description + (f", {part.message_count} messages are missing" if part.message_count else "")
    first_s, last_s = (part.first_ns - zero_ns) / 1e9, (part.last_ns - zero_ns) / 1e9
    which = f"{part.message_count} messages" if part.message_count else "messages"
    return f"{part.description}, {which} from {first_s:.2f} to {last_s:.2f} s are missing"


def read_mcap(path: str | Path) -> McapContents:
    """Read all intact messages, metadata and attachments.

    Raises
    ------
    InputError
        If the file cannot be opened, is empty, or does not begin as an MCAP file.
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
    return _McapScanner(data).read_records()


class _IndexSummary(NamedTuple):
    """Contents of the index at the end of an MCAP file: its channels, number of messages, and offsets of records."""

    channels: tuple[tuple[int, str], ...] = ()
    expected_messages: int = 0
    record_offsets: tuple[int, ...] = ()
    is_valid: bool = True
    end_offset: int = 0


def _to_stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _read_summary(data: bytes) -> _IndexSummary | None:
    """Return the index; None for a file without end mark, an empty index if its checksum is wrong."""
    mark = data.rfind(MAGIC, len(MAGIC))
    at = mark - _FOOTER_SIZE
    if mark < 0 or at < len(MAGIC) or _RECORD_HEAD_STRUCT.unpack_from(data, at) != (Opcode.FOOTER, 20):
        return None
    start, _, crc = struct.unpack_from("<QQI", data, at + _RECORD_HEAD_STRUCT.size)
    end = mark + len(MAGIC)
    if not start:
        return _IndexSummary(end_offset=end)
    if not len(MAGIC) <= start <= at or (crc and zlib.crc32(memoryview(data)[start : mark - _CRC_SIZE]) != crc):
        return _IndexSummary(is_valid=False, end_offset=end)
    channels, places, expected = [], [start], 0
    try:
        while start < at:
            opcode, length = _RECORD_HEAD_STRUCT.unpack_from(data, start)
            content = data[start + _RECORD_HEAD_STRUCT.size : start + _RECORD_HEAD_STRUCT.size + length]
            start += _RECORD_HEAD_STRUCT.size + length
            if opcode == Opcode.CHANNEL:
                channel = records.Channel.read(_to_stream(content))
                channels.append((channel.id, channel.topic))
            elif opcode == Opcode.STATISTICS:
                expected = records.Statistics.read(_to_stream(content)).message_count
            elif opcode == Opcode.CHUNK_INDEX:
                places.append(struct.unpack_from("<Q", content, 16)[0])
            elif opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
                places.append(struct.unpack_from("<Q", content)[0])
    except Exception:  # An index without checksum can be damaged in any way.
        return _IndexSummary(is_valid=False, end_offset=end)
    return _IndexSummary(tuple(channels), expected, tuple(sorted(places)), end_offset=end)


class _McapScanner:
    """One pass over a file, record after record."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._contents = McapContents()
        self._summary = _read_summary(data)
        self._topics: dict[int, list[tuple[int, bytes]]] = {}
        for number, topic in self._summary.channels if self._summary else ():
            self._topics[number] = self._contents.messages_by_topic.setdefault(topic, [])
        self._counts: dict[int, int] = {}
        self._numbered = False  # this package's writer numbers the messages of each channel
        self._chunked = False
        self._skipped = 0  # number of messages missing by their sequence numbers
        self._crc_wrong = False

    def read_records(self) -> McapContents:
        """Read every intact record."""
        data, contents, end = self._data, self._contents, len(self._data)
        at, finished = len(MAGIC), False
        passed = at  # start of a run of skipped records, whose lengths are not confirmed
        while at + _RECORD_HEAD_STRUCT.size <= end and not finished:
            opcode, length = _RECORD_HEAD_STRUCT.unpack_from(data, at)
            stop = at + _RECORD_HEAD_STRUCT.size + length
            if opcode == Opcode.FOOTER and length == 20:
                finished = True
            elif stop > end or not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _FIRST_PRIVATE_OPCODE):
                at = self._skip_lost_part(at, stop, opcode, passed)
                passed = at
            else:
                problem = self._read_record(opcode, at, stop)
                finished = opcode == Opcode.DATA_END and not problem
                passed = passed if opcode in _IGNORED_OPCODES else stop
                at = stop if not problem else self._skip_damaged(problem, opcode, at, stop)
        if not finished and at < end:
            contents.lost_parts.append(LostPart(f"at byte {at} the file ends inside a record", at, end - at))
        count = sum(len(m) for m in contents.messages_by_topic.values())
        contents.expected_messages = self._summary.expected_messages if self._summary else 0
        if not contents.expected_messages and self._skipped:
            contents.expected_messages = count + self._skipped
        contents.other_faults += self._describe_other_faults(finished)
        contents.is_complete = (
            not contents.other_faults and not contents.lost_parts and contents.expected_messages <= count
        )
        return contents

    def _read_record(self, opcode: int, at: int, stop: int) -> str:
        """Store the contents of a chunk or of a record outside chunks; return its fault as text, ``""`` without one."""
        start = at + _RECORD_HEAD_STRUCT.size
        try:
            if opcode == Opcode.CHUNK:
                self._chunked = True
                plain = _unpack_chunk(self._data, start, stop)
                return (
                    "" if self._read_chunk_records(plain) == len(plain) else f"part of a chunk at byte {at} is damaged"
                )
            if opcode == Opcode.MESSAGE:
                return (
                    ""
                    if self._read_chunk_records(self._data[at:stop]) == stop - at
                    else f"a message at byte {at} is damaged"
                )
            self._read_other_record(opcode, self._data[start:stop])
            if opcode == Opcode.DATA_END:
                (crc,) = struct.unpack_from("<I", self._data, start)
                self._crc_wrong = bool(crc) and zlib.crc32(memoryview(self._data)[:at]) != crc
        except Exception as error:  # A damaged record can fail in any way.
            what = "a chunk" if opcode == Opcode.CHUNK else "a record"
            reason = str(error) if isinstance(error, ValueError) and "\n" not in str(error) else "its content"
            return f"{what} of {stop - at} bytes at byte {at} cannot be read ({reason[:90]})"
        return ""

    def _read_chunk_records(self, plain: bytes) -> int:
        """Store the messages and channels of an unpacked chunk; return the number of bytes up to the first fault."""
        at, end = 0, len(plain)
        unpack, topics, counts, numbered = (
            MESSAGE_HEAD_STRUCT.unpack_from,
            self._topics,
            self._counts,
            self._numbered,
        )
        while at < end:
            if plain[at] == Opcode.MESSAGE and at + _MESSAGE_DATA_OFFSET <= end:
                _, size, number, count, time_ns, _ = unpack(plain, at)
                stop = at + 9 + size
                if stop > end or size < MESSAGE_FIELDS_SIZE:
                    return at
                found = topics.get(number)
                if found is None:
                    found = topics[number] = self._contents.messages_by_topic.setdefault(f"channel {number}", [])
                found.append((time_ns, plain[at + _MESSAGE_DATA_OFFSET : stop]))
                if numbered:
                    expected = counts.get(number, 0)
                    if count != expected:
                        self._skipped += (count - expected) & 0xFFFFFFFF
                    counts[number] = (count + 1) & 0xFFFFFFFF
            else:
                if at + _RECORD_HEAD_STRUCT.size > end:
                    return at
                opcode, size = _RECORD_HEAD_STRUCT.unpack_from(plain, at)
                stop = at + _RECORD_HEAD_STRUCT.size + size
                if stop > end or opcode == Opcode.MESSAGE:
                    return at
                self._read_other_record(opcode, plain[at + _RECORD_HEAD_STRUCT.size : stop])
            at = stop
        return at

    def _read_other_record(self, opcode: int, content: bytes) -> None:
        """Process a record other than a message; a damaged record raises ValueError or another error."""
        contents = self._contents
        if opcode == Opcode.CHANNEL:
            channel = records.Channel.read(_to_stream(content))
            before = contents.messages_by_topic.pop(f"channel {channel.id}", [])
            self._topics[channel.id] = contents.messages_by_topic.setdefault(channel.topic, before)
        elif opcode == Opcode.HEADER:
            self._numbered = records.Header.read(_to_stream(content)).library.startswith("mufly")
        elif opcode == Opcode.METADATA:
            metadata = records.Metadata.read(_to_stream(content))
            contents.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(_to_stream(content))
            crc = struct.unpack_from("<I", content, len(content) - _CRC_SIZE)[0]
            if crc and zlib.crc32(content[:-_CRC_SIZE]) != crc:
                raise ValueError("wrong checksum")
            contents.attachments[attachment.name] = attachment.data

    def _skip_damaged(self, problem: str, opcode: int, at: int, stop: int) -> int:
        """Register a damaged record and return the offset at which to continue."""
        after = stop if self._is_record_at(stop) else self._find_next_record(at + 1)
        messages, first_ns, last_ns = self._summarise_message_indexes(stop) if opcode == Opcode.CHUNK else (0, 0, 0)
        self._contents.lost_parts.append(LostPart(problem, at, after - at, messages, first_ns, last_ns))
        return after

    def _skip_lost_part(self, at: int, stop: int, opcode: int, passed: int) -> int:
        """Add a truncated record or invalid bytes to the lost parts; return the offset at which to continue.

        The record would extend from ``at`` to ``stop``; the next valid record is searched after ``passed``.
        """
        data, end = self._data, len(self._data)
        after = self._find_next_record(passed + 1)
        at = at if after >= at else passed
        if after < end or stop <= end or opcode != Opcode.CHUNK:
            cut = after == end and stop > end and Opcode.HEADER <= opcode <= Opcode.DATA_END
            what = (
                f"at byte {at} the file ends inside a record" if cut else f"{after - at} bytes at byte {at} are damaged"
            )
            self._contents.lost_parts.append(LostPart(what, at, after - at))
            return after
        self._chunked = True
        first_ns, last_ns = struct.unpack_from("<QQ", data.ljust(at + 25, b"\0"), at + _RECORD_HEAD_STRUCT.size)
        before = sum(len(m) for m in self._contents.messages_by_topic.values())
        try:
            self._read_chunk_records(_unpack_truncated_chunk(data, at + _RECORD_HEAD_STRUCT.size))
        except Exception:  # No part can be unpacked.
            before = -1
        kept = sum(len(m) for m in self._contents.messages_by_topic.values()) - before if before >= 0 else 0
        what = f"at byte {at} the file ends inside a chunk, {end - at} of {stop - at} bytes of it are there"
        if kept:  # times of the missing messages are unknown
            what, first_ns, last_ns = f"{what}, with {kept} complete messages", 0, 0
        self._contents.lost_parts.append(LostPart(what, at, end - at, 0, first_ns, last_ns))
        return end

    def _is_record_at(self, at: int) -> bool:
        """Return whether a record begins at an offset and is followed by another record or the end mark."""
        data, end = self._data, len(self._data)
        for _ in range(2):
            if at + _RECORD_HEAD_STRUCT.size > end:
                return False
            opcode, length = _RECORD_HEAD_STRUCT.unpack_from(data, at)
            if not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _FIRST_PRIVATE_OPCODE):
                return False
            at += _RECORD_HEAD_STRUCT.size + length
            if at > end:
                return False
            if at == end or (opcode == Opcode.FOOTER and data.startswith(MAGIC, at)):
                return True
        return True

    def _find_next_record(self, start: int) -> int:
        """Return the offset of the next record at or after an offset; the end of the file without one."""
        data, end = self._data, len(self._data)
        best = next(
            (
                p
                for p in (self._summary.record_offsets if self._summary else ())
                if p >= start and self._is_record_at(p)
            ),
            end,
        )
        patterns = (
            [_CHUNK_HEAD_PATTERN, _RECORD_HEAD_PATTERN]
            if self._chunked
            else [_CHUNK_HEAD_PATTERN, _MESSAGE_HEAD_PATTERN]
        )
        for pattern in patterns:
            for found in pattern.finditer(data, start, best):
                if self._is_record_at(found.start()):
                    best = found.start()
                    break
        return best

    def _summarise_message_indexes(self, at: int) -> tuple[int, int, int]:
        """Return number and first and last time of the messages in the indexes at an offset; zeros without an index."""
        data, end, times = self._data, len(self._data), list[int]()
        while at + _RECORD_HEAD_STRUCT.size + 6 <= end and data[at] == Opcode.MESSAGE_INDEX:
            length = _RECORD_HEAD_STRUCT.unpack_from(data, at)[1]
            stop = at + _RECORD_HEAD_STRUCT.size + length
            if stop > end or length < 6 or (length - 6) % 16:
                break
            values = struct.unpack_from(f"<{(length - 6) // 8}Q", data, at + _RECORD_HEAD_STRUCT.size + 6)
            times += values[::2]
            at = stop
        return len(times), min(times, default=0), max(times, default=0)

    def _describe_other_faults(self, finished: bool) -> list[str]:
        """Return sentences on faults other than lost parts: lost topic names, wrong checksum, missing end or index."""
        summary, data = self._summary, self._data
        nameless = [t for t in self._contents.messages_by_topic if t.startswith("channel ")]
        said = [f"the names of some topics are lost; these topics are called {', '.join(nameless)}"] if nameless else []
        if self._crc_wrong and not self._contents.lost_parts:
            said.append("data outside the chunks are damaged (wrong checksum)")
        if UNFINISHED_METADATA_NAME in self._contents.metadata:
            return [*said, "the writer was stopped before the end, or is still writing"]
        if summary is None or not finished:
            return [*said, "it has no end mark"]
        if not summary.is_valid:
            return [*said, "the index at the end is damaged"]
        behind = len(data) - summary.end_offset
        return [*said, f"{behind} bytes after the end mark do not belong to the file"] if behind else said


def _parse_chunk_head(data: bytes, start: int) -> tuple[str, int, int, int, int]:
    """Return compression, uncompressed size, CRC, and begin and expected end of the packed records."""
    _, _, size, crc, name_length = _CHUNK_HEAD_STRUCT.unpack_from(data, start)
    at = start + _CHUNK_HEAD_STRUCT.size
    name = data[at : at + name_length].decode("ascii", "replace") if name_length <= 32 else "?"
    (packed,) = struct.unpack_from("<Q", data, at + name_length)
    at += name_length + 8
    return name, size, crc, at, at + packed


_DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, size: packed,
    "zstd": lambda packed, size: zstandard.ZstdDecompressor().decompress(packed, max_output_size=size),
    "lz4": lambda packed, size: lz4.frame.decompress(packed),
}
_PARTIAL_DECOMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "": lambda packed: packed,
    "zstd": lambda packed: zstandard.ZstdDecompressor().decompressobj().decompress(packed),
    "lz4": lambda packed: lz4.frame.LZ4FrameDecompressor().decompress(packed),
}


def _unpack_chunk(data: bytes, start: int, stop: int) -> bytes:
    """Return the records of a chunk; ValueError if its size, checksum or compression is wrong."""
    name, size, crc, first, last = _parse_chunk_head(data, start)
    if last != stop:
        raise ValueError("wrong size")
    if name not in _DECOMPRESSORS:
        raise ValueError(f"packed by {name!r}, which is not read here; repack it: mcap compress")
    plain = bytes(_DECOMPRESSORS[name](data[first:last], size))
    if crc and zlib.crc32(plain) != crc:
        raise ValueError("wrong checksum")
    return plain


def _unpack_truncated_chunk(data: bytes, start: int) -> bytes:
    """Return the records of a chunk that the file's end cuts, up to the cut."""
    name, _, _, first, _ = _parse_chunk_head(data, start)
    return bytes(_PARTIAL_DECOMPRESSORS[name](data[first:]))
