"""A serial line, and lines of text with a check sum on it.

The sketches of this package, and any device that one builds oneself, speak lines of ASCII

    $BODY*HHHH\\n        HHHH: CRC-16 of BODY (x^16 + x^12 + x^5 + 1, start 0xFFFF), four capital hexadecimal digits

A line whose sum does not fit is passed over and counted: bytes get lost on long cables beside motors, and half a
number is a wrong one. (A sum of eight bits let one damaged line in 256 through.)
"""

from __future__ import annotations

import binascii
import contextlib
import time
from typing import Any

from mufly.bench.rig.bench_devices import DeviceError

REPLY_TIMEOUT_s = 0.25
"""A device that has not answered a request after this time is asked again."""
SILENCE_TIMEOUT_s = 0.6
"""A device that talks by itself and has not done so for this time is silent."""
_MAX_LINE_BYTES = 4096


class SerialLine:
    """A serial port that does not block for long; every fault is a DeviceError with the device's name.

    Parameters
    ----------
    port : str
        ``"/dev/ttyUSB0"``, ``"COM3"``.
    baud : int
    name : str
        Of the device, for messages.
    """

    def __init__(self, port: str, baud: int, name: str) -> None:
        self.port, self.baud, self.name = port, baud, f"{name} ({port})"
        self._line: Any = None

    def open(self) -> None:
        """Open, or open anew; what was waiting is thrown away."""
        import serial

        self.close()
        try:
            self._line = serial.Serial(self.port, self.baud, timeout=0.02, write_timeout=0.2)
            self._line.reset_input_buffer()
        except (OSError, ValueError) as error:
            self._line = None
            raise DeviceError(f"{self.name}: cannot be opened ({error}); is it plugged in, and yours?") from error

    def write(self, data: bytes) -> None:
        """Send bytes."""
        if self._line is None:
            raise DeviceError(f"{self.name}: is not open")
        try:
            self._line.write(data)
        except OSError as error:  # of which pyserial's own and its time-out are kinds
            raise DeviceError(f"{self.name}: takes no bytes ({error})") from error

    def read(self, wait_s: float = 0.0) -> bytes:
        """Return what came; waits so long for a first byte."""
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
            raise DeviceError(f"{self.name}: is gone ({error})") from error

    def close(self) -> None:
        """Close."""
        if self._line is not None:
            with contextlib.suppress(OSError):
                self._line.close()
            self._line = None


def compute_crc16(data: bytes) -> int:
    """Return the CRC-16 of bytes: polynomial 0x1021, start 0xFFFF, nothing reflected."""
    return binascii.crc_hqx(data, 0xFFFF)


def with_checksum(body: str) -> bytes:
    """Return a line with its check sum."""
    raw = body.encode("ascii")
    return b"$" + raw + b"*%04X\n" % compute_crc16(raw)


class ChecksummedLine(SerialLine):
    """A serial port on which lines with check sums come and go.

    Attributes
    ----------
    broken_lines : int
        Lines that were passed over.
    """

    def __init__(self, port: str, baud: int, name: str) -> None:
        super().__init__(port, baud, name)
        self.broken_lines = 0
        self._partial_line = b""
        self.last_line_s = time.monotonic()

    def open(self) -> None:
        super().open()
        self._partial_line = b""
        self.last_line_s = time.monotonic()

    def read_lines(self, wait_s: float = 0.0) -> list[list[str]]:
        """Return the lines that came whole, each as its cells."""
        data = self._partial_line + self.read(wait_s)
        *whole, self._partial_line = data.split(b"\n")
        if len(self._partial_line) > _MAX_LINE_BYTES:  # no device of ours says so much in a line
            self._partial_line = b""
            self.broken_lines += 1
        out = []
        for raw in whole:
            # A line that lost its end runs into the next one, which is still good.
            body, star, total = raw[raw.rfind(b"$") + 1 :].strip().rpartition(b"*")
            if not star or b"$" not in raw or total != b"%04X" % compute_crc16(body):
                self.broken_lines += 1
                continue
            out.append(body.decode("ascii", errors="replace").split(","))
        if out:
            self.last_line_s = time.monotonic()
        return out

    def check_silence(self) -> None:
        """Raise DeviceError if nothing whole has come for too long."""
        silent = time.monotonic() - self.last_line_s
        if silent > SILENCE_TIMEOUT_s:
            raise DeviceError(f"{self.name}: silent for {silent:.1f} s ({self.broken_lines} broken lines so far)")

    def send_line(self, body: str) -> None:
        """Send a line."""
        self.write(with_checksum(body))
