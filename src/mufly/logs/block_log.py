"""Reader of a board's log from the image of its block device (SD card or flash): sessions in ULog format.

The board appends blocks of 512 bytes in a ring (``onboard/log/block_log.h`` of the flight software). A block holds,
as little-endian words: magic, session, index in the session, sequence, count of payload bytes and offset of the first
message that begins in it, payload, CRC-32 of all before. Each start of the board begins a session with index 0. A block
with a wrong checksum counts as missing; reading continues at the next message.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from mufly.errors import InputError
from mufly.logs.raw_log import RawLog
from mufly.logs.ulog import HEADER_SIZE as ULOG_HEADER_SIZE
from mufly.logs.ulog import parse_ulog
from mufly.results import result

BLOCK_LOG_FORMAT = "mufly block log"
BLOCK_BYTES = 512
_MAGIC = b"mlog"
_HEADER_STRUCT = struct.Struct("<4s3IHH")
_NO_MESSAGE_START = 0xFFFF


@result(json="session=number bytes=ulog_byte_count missing_blocks whole=has_begin")
class BlockLogSession:
    """Part of a board's log that was written between one start of the board and the next.

    Attributes
    ----------
    number : int
        Number of the session, counted up by the board.
    ulog : bytes
        Contents, as a ULog file.
    missing_blocks : int
        Blocks between the first and the last one that are overwritten or damaged.
    has_begin : bool
        Whether the session's definitions exist; without them the session cannot be read.
    """

    number: int
    ulog: bytes
    missing_blocks: int
    has_begin: bool

    @property
    def ulog_byte_count(self) -> int:
        """Size of the session as a ULog file (bytes)."""
        return len(self.ulog)


def looks_like_block_log(head: bytes) -> bool:
    """Return whether these first bytes of a file contain a block log's header at a multiple of 512 bytes."""
    return any(head.startswith(_MAGIC, at) for at in range(0, len(head), BLOCK_BYTES))


def split_image_into_sessions(image: bytes) -> list[BlockLogSession]:
    """Return the sessions (one for each start of the board) in the image of a block device, the latest last."""
    count = len(image) // BLOCK_BYTES
    blocks = np.frombuffer(image[: count * BLOCK_BYTES], np.uint8).reshape(count, BLOCK_BYTES)
    sessions: dict[int, dict[int, tuple[int, int, bytes]]] = {}
    for k in np.flatnonzero((blocks[:, :4] == np.frombuffer(_MAGIC, np.uint8)).all(axis=1)):
        block = blocks[k].tobytes()
        if struct.pack("<I", zlib.crc32(block[:-4])) == block[-4:]:
            _, session, index, sequence, used, first = _HEADER_STRUCT.unpack_from(block)
            known = sessions.setdefault(session, {}).get(index)
            if known is None or known[0] < sequence:
                payload = block[_HEADER_STRUCT.size : _HEADER_STRUCT.size + used]
                sessions[session][index] = (sequence, first, payload)
    latest = sorted(sessions, key=lambda number: max(b[0] for b in sessions[number].values()))
    return [_join_blocks(number, sessions[number]) for number in latest]


def _join_blocks(number: int, blocks: dict[int, tuple[int, int, bytes]]) -> BlockLogSession:
    out, missing, expected = bytearray(), 0, 0
    last_begin = ULOG_HEADER_SIZE  # begin of the last message that begins before a gap
    for index in sorted(blocks):
        _, first, payload = blocks[index]
        if index != expected:
            missing += index - expected
            del out[_find_end_of_messages(out, last_begin) :]
            payload, first = (b"", _NO_MESSAGE_START) if first == _NO_MESSAGE_START else (payload[first:], 0)
        if first != _NO_MESSAGE_START:
            last_begin = max(len(out) + first, ULOG_HEADER_SIZE)
        out += payload
        expected = index + 1
    del out[_find_end_of_messages(out, last_begin) :]
    return BlockLogSession(number, bytes(out), missing, 0 in blocks)


def _find_end_of_messages(data: bytearray, start: int) -> int:
    """Return the offset after the last complete message; a message begins at ``start``."""
    at = start
    while at + 3 <= len(data):
        size = struct.unpack_from("<H", data, at)[0]
        if at + 3 + size > len(data):
            break
        at += 3 + size
    return at


def read_block_log(path: str | Path) -> RawLog:
    """Read the latest session in the image of a block device.

    Raises
    ------
    InputError
        If no session has its definitions.
    """
    sessions = [s for s in split_image_into_sessions(Path(path).read_bytes()) if s.has_begin]
    if not sessions:
        raise InputError(
            str(path), "", "contains no complete beginning of a session", "give the image of the whole device"
        )
    return parse_ulog(sessions[-1].ulog, str(path))
