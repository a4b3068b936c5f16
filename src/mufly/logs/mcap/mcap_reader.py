"""The MCAP container, read: everything that is whole, whatever bytes of the file are missing or damaged.

A record whose length leads nowhere, or a chunk whose checksum is wrong, is left out and noted; reading goes on at the
next record that stands as it should: where the length leads, where the index at the end says that a chunk begins, or
where the bytes look like the head of one (MCAP specification, "Records": opcode, length; a chunk's times, sizes,
checksum, compression). Of a chunk that the end of the file cuts the messages before the cut are kept. How many messages
are missing is told by the statistics in the index, in our own files by their numbers, and by the message indexes that
stand behind each chunk.
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
from mufly.logs.mcap.mcap_writer import MAGIC, MESSAGE, MESSAGE_FIELDS, UNFINISHED

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
_FOOTER_SIZE = _HEAD.size + 20
_MESSAGE_SIZE = _HEAD.size + MESSAGE_FIELDS
_PRIVATE = 0x80
_PASSED_OVER = (Opcode.MESSAGE_INDEX, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX,
                Opcode.STATISTICS, Opcode.SUMMARY_OFFSET, *range(_PRIVATE, 256))  # fmt: skip
# A chunk's head: opcode; lengths below 1 TB; a compression that is read here.
_CHUNK_LIKE = re.compile(
    rb"\x06.{5}\x00{3}.{21}\x00{3}.{4}(?:\x04\x00{3}zstd|\x03\x00{3}lz4|\x00{4})", re.DOTALL
)
# Heads of other records that stand beside chunks, and of messages, shorter than 4 GB.
_RECORD_LIKE = re.compile(rb"[\x09\x0c\x0f].{4}\x00{4}", re.DOTALL)
_MESSAGE_LIKE = re.compile(rb"[\x03\x04\x05\x09\x0c\x0f].{4}\x00{4}", re.DOTALL)
_NAMED_PARTS = 3


class LostPart(NamedTuple):
    """A part of a file that could not be used.

    Attributes
    ----------
    what : str
        In words: ``"a chunk of 4151 bytes at byte 15434 cannot be read (wrong checksum)"``.
    offset, size : int
        Where it stands (bytes).
    messages : int
        Those that are known to be missing with it; 0 if nobody knows.
    first_ns, last_ns : int
        Times of the first and the last of them; 0 if nobody knows.
    """

    what: str
    offset: int
    size: int
    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0


@dataclass
class McapContents:
    """What could be read of a file.

    Attributes
    ----------
    metadata, attachments : dict
    messages : dict
        From a topic to (time_ns, content) in order.
    complete : bool
        Whether the file has its end mark and no damage.
    lost : list of LostPart
    expected : int
        Messages that the file had, as far as it tells; 0 if it does not.
    remarks : list of str
        What else is wrong: how it ends, its index, ...
    """

    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    complete: bool = False
    lost: list[LostPart] = field(default_factory=list)
    expected: int = 0
    remarks: list[str] = field(default_factory=list)

    def describe_damage(self, zero_ns: int | None = None) -> str:
        """Return in words what is missing; times count from ``zero_ns``, by default from the first that is missing.

        It is ``""`` for a whole file.
        """
        if zero_ns is None:
            zero_ns = min((p.first_ns for p in self.lost if p.first_ns), default=0)
        said = [_part_in_words(part, zero_ns) for part in self.lost[:_NAMED_PARTS]]
        more = self.lost[_NAMED_PARTS:]
        if more:
            said.append(f"{sum(p.size for p in more)} bytes in {len(more)} more places, too")
        count = sum(len(m) for m in self.messages.values())
        if self.expected > count:
            said.append(f"{count} of {self.expected} messages are here")
        return "; ".join(said + self.remarks)


def _part_in_words(part: LostPart, zero_ns: int) -> str:
    if not part.first_ns:
        return part.what + (f", {part.messages} messages are missing" if part.messages else "")
    first_s, last_s = (part.first_ns - zero_ns) / 1e9, (part.last_ns - zero_ns) / 1e9
    which = f"{part.messages} messages" if part.messages else "messages"
    return f"{part.what}, {which} from {first_s:.2f} to {last_s:.2f} s are missing"


def read_mcap(path: str | Path) -> McapContents:
    """Read all messages, metadata and attachments that are whole.

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
    return _McapWalk(data).walk_records()


class _Summary(NamedTuple):
    """The index at the end: what it repeats, and where records begin."""

    channels: tuple[tuple[int, str], ...] = ()
    expected: int = 0
    places: tuple[int, ...] = ()
    sound: bool = True
    end: int = 0


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))


def _read_summary(data: bytes) -> _Summary | None:
    """Return what the index tells; None for a file without an end mark, nothing of it if its checksum is wrong."""
    mark = data.rfind(MAGIC, len(MAGIC))
    at = mark - _FOOTER_SIZE
    if mark < 0 or at < len(MAGIC) or _HEAD.unpack_from(data, at) != (Opcode.FOOTER, 20):
        return None
    start, _, crc = struct.unpack_from("<QQI", data, at + _HEAD.size)
    end = mark + len(MAGIC)
    if not start:
        return _Summary(end=end)
    if not len(MAGIC) <= start <= at or (crc and zlib.crc32(memoryview(data)[start : mark - 4]) != crc):
        return _Summary(sound=False, end=end)
    channels, places, expected = [], [start], 0
    try:
        while start < at:
            opcode, length = _HEAD.unpack_from(data, start)
            content = data[start + _HEAD.size : start + _HEAD.size + length]
            start += _HEAD.size + length
            if opcode == Opcode.CHANNEL:
                channel = records.Channel.read(_stream(content))
                channels.append((channel.id, channel.topic))
            elif opcode == Opcode.STATISTICS:
                expected = records.Statistics.read(_stream(content)).message_count
            elif opcode == Opcode.CHUNK_INDEX:
                places.append(struct.unpack_from("<Q", content, 16)[0])
            elif opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
                places.append(struct.unpack_from("<Q", content)[0])
    except Exception:  # An index without checksum can be damaged in any way.
        return _Summary(sound=False, end=end)
    return _Summary(tuple(channels), expected, tuple(sorted(places)), end=end)


class _McapWalk:
    """One pass over a file, record after record."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._contents = McapContents()
        self._summary = _read_summary(data)
        self._topics: dict[int, list[tuple[int, bytes]]] = {}
        for number, topic in self._summary.channels if self._summary else ():
            self._topics[number] = self._contents.messages.setdefault(topic, [])
        self._counts: dict[int, int] = {}
        self._numbered = False  # our own writer counts the messages of each channel
        self._chunked = False
        self._skipped = 0  # messages that their numbers say were there
        self._crc_wrong = False

    def walk_records(self) -> McapContents:
        """Read every record that is whole."""
        data, contents, end = self._data, self._contents, len(self._data)
        at, finished = len(MAGIC), False
        passed = at  # where a run of records begins that are passed over: their lengths are not proven
        while at + _HEAD.size <= end and not finished:
            opcode, length = _HEAD.unpack_from(data, at)
            stop = at + _HEAD.size + length
            if opcode == Opcode.FOOTER and length == 20:
                finished = True
            elif stop > end or not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
                at = self._skip_part(at, stop, opcode, passed)
                passed = at
            else:
                problem = self._take_record(opcode, at, stop)
                finished = opcode == Opcode.DATA_END and not problem
                passed = passed if opcode in _PASSED_OVER else stop
                at = stop if not problem else self._skip_damaged(problem, opcode, at, stop)
        if not finished and at < end:
            contents.lost.append(LostPart(f"at byte {at} the file ends inside a record", at, end - at))
        count = sum(len(m) for m in contents.messages.values())
        contents.expected = self._summary.expected if self._summary else 0
        if not contents.expected and self._skipped:
            contents.expected = count + self._skipped
        contents.remarks += self._describe_rest(finished)
        contents.complete = not contents.remarks and not contents.lost and contents.expected <= count
        return contents

    def _take_record(self, opcode: int, at: int, stop: int) -> str:
        """Take a record beside the chunks, or a chunk; return what is wrong with it, ``""`` if nothing is."""
        start = at + _HEAD.size
        try:
            if opcode == Opcode.CHUNK:
                self._chunked = True
                plain = _unpack_chunk(self._data, start, stop)
                return (
                    ""
                    if self._take_messages(plain) == len(plain)
                    else f"part of a chunk at byte {at} is damaged"
                )
            if opcode == Opcode.MESSAGE:
                return (
                    ""
                    if self._take_messages(self._data[at:stop]) == stop - at
                    else f"a message at byte {at} is damaged"
                )
            self._take_other(opcode, self._data[start:stop])
            if opcode == Opcode.DATA_END:
                (crc,) = struct.unpack_from("<I", self._data, start)
                self._crc_wrong = bool(crc) and zlib.crc32(memoryview(self._data)[:at]) != crc
        except Exception as error:  # A damaged record can fail in any way.
            what = "a chunk" if opcode == Opcode.CHUNK else "a record"
            reason = str(error) if isinstance(error, ValueError) and "\n" not in str(error) else "its content"
            return f"{what} of {stop - at} bytes at byte {at} cannot be read ({reason[:90]})"
        return ""

    def _take_messages(self, plain: bytes) -> int:
        """Take the records of a chunk; return how many bytes of it stand as they should."""
        at, end = 0, len(plain)
        unpack, topics, counts, numbered = MESSAGE.unpack_from, self._topics, self._counts, self._numbered
        while at < end:
            if plain[at] == Opcode.MESSAGE and at + _MESSAGE_SIZE <= end:
                _, size, number, count, time_ns, _ = unpack(plain, at)
                stop = at + 9 + size
                if stop > end or size < MESSAGE_FIELDS:
                    return at
                found = topics.get(number)
                if found is None:
                    found = topics[number] = self._contents.messages.setdefault(f"channel {number}", [])
                found.append((time_ns, plain[at + _MESSAGE_SIZE : stop]))
                if numbered:
                    expected = counts.get(number, 0)
                    if count != expected:
                        self._skipped += (count - expected) & 0xFFFFFFFF
                    counts[number] = (count + 1) & 0xFFFFFFFF
            else:
                if at + _HEAD.size > end:
                    return at
                opcode, size = _HEAD.unpack_from(plain, at)
                stop = at + _HEAD.size + size
                if stop > end or opcode == Opcode.MESSAGE:
                    return at
                self._take_other(opcode, plain[at + _HEAD.size : stop])
            at = stop
        return at

    def _take_other(self, opcode: int, content: bytes) -> None:
        """Take a record that is no message; ValueError and others if it is damaged."""
        contents = self._contents
        if opcode == Opcode.CHANNEL:
            channel = records.Channel.read(_stream(content))
            before = contents.messages.pop(f"channel {channel.id}", [])
            self._topics[channel.id] = contents.messages.setdefault(channel.topic, before)
        elif opcode == Opcode.HEADER:
            self._numbered = records.Header.read(_stream(content)).library.startswith("mufly")
        elif opcode == Opcode.METADATA:
            metadata = records.Metadata.read(_stream(content))
            contents.metadata[metadata.name] = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = records.Attachment.read(_stream(content))
            crc = struct.unpack_from("<I", content, len(content) - 4)[0]
            if crc and zlib.crc32(content[:-4]) != crc:
                raise ValueError("wrong checksum")
            contents.attachments[attachment.name] = attachment.data

    def _skip_damaged(self, problem: str, opcode: int, at: int, stop: int) -> int:
        """Note a damaged record and return where reading goes on."""
        after = stop if self._stands(stop) else self._next_record(at + 1)
        messages, first_ns, last_ns = self._indexed_messages(stop) if opcode == Opcode.CHUNK else (0, 0, 0)
        self._contents.lost.append(LostPart(problem, at, after - at, messages, first_ns, last_ns))
        return after

    def _skip_part(self, at: int, stop: int, opcode: int, passed: int) -> int:
        """Note a record that the file's end cuts, or bytes that are none, and return where reading goes on."""
        data, end = self._data, len(self._data)
        after = self._next_record(passed + 1)
        at = at if after >= at else passed
        if after < end or stop <= end or opcode != Opcode.CHUNK:
            cut = after == end and stop > end and Opcode.HEADER <= opcode <= Opcode.DATA_END
            what = (
                f"at byte {at} the file ends inside a record"
                if cut
                else f"{after - at} bytes at byte {at} are damaged"
            )
            self._contents.lost.append(LostPart(what, at, after - at))
            return after
        self._chunked = True
        first_ns, last_ns = struct.unpack_from("<QQ", data.ljust(at + 25, b"\0"), at + _HEAD.size)
        before = sum(len(m) for m in self._contents.messages.values())
        try:
            self._take_messages(_unpack_cut_chunk(data, at + _HEAD.size))
        except Exception:  # Nothing of it can be unpacked.
            before = -1
        kept = sum(len(m) for m in self._contents.messages.values()) - before if before >= 0 else 0
        what = f"at byte {at} the file ends inside a chunk, {end - at} of {stop - at} bytes of it are there"
        if kept:  # times of what is missing are not known
            what, first_ns, last_ns = f"{what}, with {kept} whole messages", 0, 0
        self._contents.lost.append(LostPart(what, at, end - at, 0, first_ns, last_ns))
        return end

    def _stands(self, at: int) -> bool:
        """Whether a record stands at an offset, and another or the end mark behind it."""
        data, end = self._data, len(self._data)
        for _ in range(2):
            if at + _HEAD.size > end:
                return False
            opcode, length = _HEAD.unpack_from(data, at)
            if not (Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _PRIVATE):
                return False
            at += _HEAD.size + length
            if at > end:
                return False
            if at == end or (opcode == Opcode.FOOTER and data.startswith(MAGIC, at)):
                return True
        return True

    def _next_record(self, start: int) -> int:
        """Where the next record stands at or behind an offset; the end of the file if none does."""
        data, end = self._data, len(self._data)
        best = next(
            (p for p in (self._summary.places if self._summary else ()) if p >= start and self._stands(p)),
            end,
        )
        patterns = [_CHUNK_LIKE, _RECORD_LIKE] if self._chunked else [_CHUNK_LIKE, _MESSAGE_LIKE]
        for pattern in patterns:
            for found in pattern.finditer(data, start, best):
                if self._stands(found.start()):
                    best = found.start()
                    break
        return best

    def _indexed_messages(self, at: int) -> tuple[int, int, int]:
        """Count and times of the messages that the message indexes at an offset list; zeros without any."""
        data, end, times = self._data, len(self._data), list[int]()
        while at + _HEAD.size + 6 <= end and data[at] == Opcode.MESSAGE_INDEX:
            length = _HEAD.unpack_from(data, at)[1]
            stop = at + _HEAD.size + length
            if stop > end or length < 6 or (length - 6) % 16:
                break
            values = struct.unpack_from(f"<{(length - 6) // 8}Q", data, at + _HEAD.size + 6)
            times += values[::2]
            at = stop
        return len(times), min(times, default=0), max(times, default=0)

    def _describe_rest(self, finished: bool) -> list[str]:
        """What is wrong besides lost parts, in words."""
        summary, data = self._summary, self._data
        nameless = [t for t in self._contents.messages if t.startswith("channel ")]
        said = (
            [f"the names of some topics are lost, which are here as {', '.join(nameless)}"]
            if nameless
            else []
        )
        if self._crc_wrong and not self._contents.lost:
            said.append("something outside its chunks is damaged (wrong checksum of the data)")
        if UNFINISHED in self._contents.metadata:
            return [*said, "its writer was stopped before it had finished, or still writes"]
        if summary is None or not finished:
            return [*said, "it has no end mark"]
        if not summary.sound:
            return [*said, "the index at its end is damaged"]
        behind = len(data) - summary.end
        return [*said, f"{behind} bytes behind its end mark are none of it"] if behind else said


def _chunk_parts(data: bytes, start: int) -> tuple[str, int, int, int, int]:
    """Compression, uncompressed size, CRC, and where the packed records begin and should end."""
    _, _, size, crc, name_length = _CHUNK.unpack_from(data, start)
    at = start + _CHUNK.size
    name = data[at : at + name_length].decode("ascii", "replace") if name_length <= 32 else "?"
    (packed,) = struct.unpack_from("<Q", data, at + name_length)
    at += name_length + 8
    return name, size, crc, at, at + packed


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, size: packed,
    "zstd": lambda packed, size: zstandard.ZstdDecompressor().decompress(packed, max_output_size=size),
    "lz4": lambda packed, size: lz4.frame.decompress(packed),
}
_UNPACK_CUT: dict[str, Callable[[bytes], bytes]] = {
    "": lambda packed: packed,
    "zstd": lambda packed: zstandard.ZstdDecompressor().decompressobj().decompress(packed),
    "lz4": lambda packed: lz4.frame.LZ4FrameDecompressor().decompress(packed),
}


def _unpack_chunk(data: bytes, start: int, stop: int) -> bytes:
    """Return the records of a chunk; ValueError if its size, checksum or compression is wrong."""
    name, size, crc, first, last = _chunk_parts(data, start)
    if last != stop:
        raise ValueError("wrong size")
    if name not in _UNPACK:
        raise ValueError(f"packed by {name!r}, which is not read here; repack it: mcap compress")
    plain = bytes(_UNPACK[name](data[first:last], size))
    if crc and zlib.crc32(plain) != crc:
        raise ValueError("wrong checksum")
    return plain


def _unpack_cut_chunk(data: bytes, start: int) -> bytes:
    """Return the records of a chunk that the file's end cuts, up to the cut."""
    name, _, _, first, _ = _chunk_parts(data, start)
    return bytes(_UNPACK_CUT[name](data[first:]))
