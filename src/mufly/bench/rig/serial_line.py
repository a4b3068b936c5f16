"""Serial port with text lines protected by a checksum.

The sketches of this package, and self-built devices, send lines of ASCII

    $BODY*HHHH\\n        HHHH: CRC-16 of BODY (x^16 + x^12 + x^5 + 1, start 0xFFFF), four capital hexadecimal digits

A line with a wrong checksum is discarded and counted, because bytes are lost on long cables near motors. An eight-bit
checksum would accept one damaged line in 256.
"""

from __future__ import annotations

import binascii
import contextlib
import time
from abc import ABC, abstractmethod
from typing import Any

from mufly.bench.rig.bench_devices import DeviceError

REPLY_TIMEOUT_s = 0.25
"""Time after which an unanswered request is repeated."""
SILENCE_TIMEOUT_s = 0.6
"""Time without a line after which a device that sends without request counts as silent."""
_MAX_LINE_BYTES = 4096


class SerialLine:
    """Serial port with short timeouts; every fault raises a DeviceError with the device's name.

    Parameters
    ----------
    port : str
        ``"/dev/ttyUSB0"``, ``"COM3"``.
    baud : int
    name : str
        Name of the device in messages.
    """

    def __init__(self, port: str, baud: int, name: str) -> None:
        self.port, self.baud, self.name = port, baud, f"{name} ({port})"
        self._line: Any = None

    def open(self) -> None:
        """Open or reopen the port, and discard waiting bytes."""
        import serial

        self.close()
        try:
            self._line = serial.Serial(self.port, self.baud, timeout=0.02, write_timeout=0.2)
            self._line.reset_input_buffer()
        except (OSError, ValueError) as error:
            self._line = None
            raise DeviceError(
                f"{self.name}: cannot be opened ({error}); check the plug and the permission to use the port"
            ) from error

    def write(self, data: bytes) -> None:
        """Send bytes through the serial port."""
        if self._line is None:
            raise DeviceError(f"{self.name}: is not open")
        try:
            self._line.write(data)
        except OSError as error:  # includes pyserial's own exceptions and timeouts
            raise DeviceError(f"{self.name}: accepts no data ({error})") from error

    def read(self, wait_s: float = 0.0) -> bytes:
        """Return the received bytes; wait up to ``wait_s`` for the first byte."""
        if self._line is None:
            raise DeviceError(f"{self.name}: is not open")
        try:
            waiting = self._line.in_waiting
            if not waiting and wait_s > 0.0:
                self._line.timeout = wait_s
                first = self._line.read(1)
                return bytes(first + self._line.read(self._line.in_waiting)) if first else b""
            return bytes(self._line.read(waiting)) if waiting else b""
        except OSError as error:
            raise DeviceError(f"{self.name}: is disconnected ({error})") from error

    def close(self) -> None:
        """Close the port."""
        if self._line is not None:
            with contextlib.suppress(OSError):
                self._line.close()
            self._line = None


class SerialMotor(ABC):
    """Motor controller on a serial line, which stops its motors before it closes the line."""

    _line: SerialLine
    _is_open: bool

    @abstractmethod
    def stop(self) -> None:
        """Stop all axes at once."""

    def close(self) -> None:
        """Stop and close the connection."""
        try:
            self.stop()
        finally:
            self._is_open = False
            self._line.close()


def compute_crc16(data: bytes) -> int:
    """Return the CRC-16 of bytes: polynomial 0x1021, start 0xFFFF, no reflection."""
    return binascii.crc_hqx(data, 0xFFFF)


def append_checksum(body: str) -> bytes:
    """Return a text line with its checksum appended."""
    raw = body.encode("ascii")
    return b"$" + raw + b"*%04X\n" % compute_crc16(raw)


class ChecksummedSerialLine(SerialLine):
    """Serial port for lines with checksums.

    Attributes
    ----------
    broken_line_count : int
        Number of discarded lines.
    """

    def __init__(self, port: str, baud: int, name: str) -> None:
        super().__init__(port, baud, name)
        self.broken_line_count = 0
        self._partial_line = b""
        self.last_line_s = time.monotonic()

    def open(self) -> None:
        super().open()
        self._partial_line = b""
        self.last_line_s = time.monotonic()

    def read_lines(self, wait_s: float = 0.0) -> list[list[str]]:
        """Return the complete, valid lines received, each as a list of its comma-separated fields."""
        data = self._partial_line + self.read(wait_s)
        *whole, self._partial_line = data.split(b"\n")
        if len(self._partial_line) > _MAX_LINE_BYTES:  # longer than any valid line
            self._partial_line = b""
            self.broken_line_count += 1
        out = []
        for raw in whole:
            # A line without end runs into the next line, which is still valid.
            body, star, total = raw[raw.rfind(b"$") + 1 :].strip().rpartition(b"*")
            if not star or b"$" not in raw or total != b"%04X" % compute_crc16(body):
                self.broken_line_count += 1
                continue
            out.append(body.decode("ascii", errors="replace").split(","))
        if out:
            self.last_line_s = time.monotonic()
        return out

    def check_silence(self) -> None:
        """Raise DeviceError if no complete line arrived within ``SILENCE_TIMEOUT_s``."""
        silent = time.monotonic() - self.last_line_s
        if silent > SILENCE_TIMEOUT_s:
            raise DeviceError(f"{self.name}: silent for {silent:.1f} s ({self.broken_line_count} broken lines so far)")

    def send_line(self, body: str) -> None:
        """Send a text line with its checksum appended."""
        self.write(append_checksum(body))
