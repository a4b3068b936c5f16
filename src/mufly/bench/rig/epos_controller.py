"""Driver of maxon EPOS motor controllers: CANopen objects (SDO) over a serial line.

Frames, from the maxon "EPOS4 Communication Guide" (rel8759, 2019-11), ch. 2.2; the example of its ch. 2.2.9 is a test:

    0x90 0x02 | OpCode | Len | Len words of data, low byte first | CRC, low byte first

Len counts words. The CRC is CCITT's, x^16 + x^12 + x^5 + 1 from 0, over the frame's words (Len the high byte of the
first, OpCode its low), high byte first. Every 0x90 after the first two bytes is doubled (byte stuffing). The guide's
requests:

    ReadObject   0x60  node, index (word), subindex                    ->  0x00  error (4 bytes), value (4 bytes)
    WriteObject  0x68  node, index (word), subindex, value (4 bytes)   ->  0x00  error (4 bytes)

EPOS2 has the same frames and the opcodes 0x10 and 0x11, with index, subindex, node in that order. The older EPOS 24/5
of the dissertation's bench acknowledges every half of a frame with a letter, and is not supported by this driver.

Objects are those of CiA 402 (control word 0x6040, status word 0x6041, mode 0x6060, target velocity 0x60FF in rpm) and
maxon's (averaged velocity and current). The serial line has no watchdog: a motor continues to turn if the cable is
disconnected. Connect an emergency button to the digital input "quick stop".
"""

from __future__ import annotations

import binascii
import struct
import time
from dataclasses import dataclass

from mufly.bench.rig.bench_devices import DeviceError, Samples
from mufly.bench.rig.serial_line import REPLY_TIMEOUT_s, SerialLine, SerialMotor
from mufly.quantities.units import RPM

FRAME_ESCAPE_BYTE, FRAME_START_BYTE = 0x90, 0x02
MAX_REQUEST_TRIES = 3
_ERROR_CODE_BYTES = 4  # the error code, first in an answer
_READS_PER_STATUS_CHECK = 10  # readings between two checks of the status word

CONTROL_WORD_OBJECT = (0x6040, 0)
STATUS_WORD_OBJECT = (0x6041, 0)
OPERATION_MODE_OBJECT = (0x6060, 0)
TARGET_VELOCITY_OBJECT = (0x60FF, 0)
ERROR_CODE_OBJECT = (0x603F, 0)
SHUTDOWN_COMMAND, ENABLE_COMMAND, QUICK_STOP_COMMAND, FAULT_RESET_COMMAND = 0x0006, 0x000F, 0x0002, 0x0080
PROFILE_VELOCITY_MODE = 3


@dataclass(frozen=True)
class EposProtocol:
    """Differences between generations of EPOS controllers: opcodes, whether a request begins with the node number, and
    the dictionary objects (CANopen) of mean velocity and current.
    """

    read_opcode: int
    write_opcode: int
    node_comes_first: bool
    velocity_object: tuple[int, int]
    current_object: tuple[int, int]


EPOS_PROTOCOLS = {
    4: EposProtocol(0x60, 0x68, True, (0x30D3, 1), (0x30D1, 1)),
    2: EposProtocol(0x10, 0x11, False, (0x2028, 0), (0x2027, 0)),
}


def compute_frame_crc(opcode: int, data: bytes) -> int:
    """Return the CRC of a frame's words."""
    words = bytes((len(data) // 2, opcode))
    words += b"".join(data[k : k + 2][::-1] for k in range(0, len(data), 2))
    return binascii.crc_hqx(words, 0)


def build_frame(opcode: int, data: bytes) -> bytes:
    """Return the bytes of a frame with byte stuffing; ``data`` has an even length."""
    body = bytes((opcode, len(data) // 2)) + data + struct.pack("<H", compute_frame_crc(opcode, data))
    return bytes((FRAME_ESCAPE_BYTE, FRAME_START_BYTE)) + body.replace(
        bytes((FRAME_ESCAPE_BYTE,)), bytes((FRAME_ESCAPE_BYTE, FRAME_ESCAPE_BYTE))
    )


class FrameParser:
    """Parser of frames in a byte stream, robust against lost bytes.

    Attributes
    ----------
    broken_frame_count : int
        Number of frames with a wrong CRC.
    """

    def __init__(self) -> None:
        self.broken_frame_count = 0
        self._frame_body: bytearray | None = None
        self._after_dle = False

    def feed_bytes(self, data: bytes) -> list[tuple[int, bytes]]:
        """Parse further bytes; return opcode and data of every completed frame."""
        out = []
        for byte in data:
            if self._after_dle:
                self._after_dle = False
                if byte == FRAME_START_BYTE:
                    self.broken_frame_count += self._frame_body is not None and len(self._frame_body) > 0
                    self._frame_body = bytearray()
                    continue
                if byte != FRAME_ESCAPE_BYTE:  # neither a start nor a stuffed byte: bytes were lost
                    self.broken_frame_count += self._frame_body is not None
                    self._frame_body = None
                    continue
            elif byte == FRAME_ESCAPE_BYTE:
                self._after_dle = True
                continue
            if self._frame_body is None:
                continue
            self._frame_body.append(byte)
            if len(self._frame_body) >= 2 and len(self._frame_body) == 4 + 2 * self._frame_body[1]:
                opcode, payload = self._frame_body[0], bytes(self._frame_body[2:-2])
                if struct.unpack("<H", self._frame_body[-2:])[0] == compute_frame_crc(opcode, payload):
                    out.append((opcode, payload))
                else:
                    self.broken_frame_count += 1
                self._frame_body = None
        return out


class EposController(SerialMotor):
    """Driver of one motor on an EPOS2 or EPOS4; a :class:`mufly.bench.rig.bench_devices.Device`.

    Parameters
    ----------
    port : str
    axis : 'upper' or 'lower'
    baud : int
        Baud rate; 115200 is the factory setting. It has no effect over USB.
    node : int
    generation : 2 or 4
    direction : 1 or -1
        Sense of motor rotation that gives lift.
    gear : float
        Motor speed over rotor speed.
    """

    def __init__(
        self, port: str, axis: str, *, baud: int = 115_200, node: int = 1, generation: int = 4, direction: int = 1,
        gear: float = 1.0,
    ) -> None:  # fmt: skip
        self._line = SerialLine(port, baud, f"EPOS {axis}")
        self.name = self._line.name
        self.driven_axes = (axis,)
        self.channel_names = (f"speed_{axis}", f"current_{axis}")
        self._axis, self._node, self._protocol = axis, node, EPOS_PROTOCOLS[generation]
        self._direction, self._gear = direction, gear
        self._frames = FrameParser()
        self._target, self._read_count, self._is_open = 0.0, 0, False

    @property
    def broken_frame_count(self) -> int:
        """Number of received frames that were discarded because of a wrong checksum or form."""
        return self._frames.broken_frame_count

    def _send_request(
        self, opcode: int, data: bytes, tries: int = MAX_REQUEST_TRIES, patience_s: float = REPLY_TIMEOUT_s
    ) -> bytes:
        """Send a request until it is answered; return the data that follow the error code in the answer."""
        for _ in range(tries):
            self._line.read()
            self._frames = FrameParser() if self._frames.broken_frame_count > 1000 else self._frames
            self._line.write(build_frame(opcode, data))
            until = time.monotonic() + patience_s
            while (left := until - time.monotonic()) > 0:
                for answer, payload in self._frames.feed_bytes(self._line.read(left)):
                    if answer != 0x00 or len(payload) < _ERROR_CODE_BYTES:
                        continue
                    code = struct.unpack("<I", payload[:_ERROR_CODE_BYTES])[0]
                    if code == 0x0504_0005 or code & 0xFFFF_0000 == 0x0F00_0000:
                        break  # the device rejected a damaged frame: repeat
                    if code:
                        raise DeviceError(f"{self.name}: refuses the request (error 0x{code:08X})")
                    return payload[_ERROR_CODE_BYTES:]
        raise DeviceError(f"{self.name}: does not answer ({tries} tries of {patience_s:g} s)")

    def _object_address(self, item: tuple[int, int]) -> bytes:
        index, sub = item
        if self._protocol.node_comes_first:
            return struct.pack("<BHB", self._node, index, sub)
        return struct.pack("<HBB", index, sub, self._node)

    def read_object(self, item: tuple[int, int]) -> int:
        """Return the value of an object of the controller's dictionary (CANopen), as a signed number of 32 bits."""
        data = self._send_request(self._protocol.read_opcode, self._object_address(item))
        if len(data) < 4:
            raise DeviceError(f"{self.name}: an answer is too short")
        return int(struct.unpack("<i", data[:4])[0])

    def write_object(
        self,
        item: tuple[int, int],
        value: int,
        tries: int = MAX_REQUEST_TRIES,
        patience_s: float = REPLY_TIMEOUT_s,
    ) -> None:
        """Write a value to an object of the controller's dictionary (CANopen)."""
        self._send_request(
            self._protocol.write_opcode,
            self._object_address(item) + struct.pack("<i", value),
            tries,
            patience_s,
        )

    def open(self) -> None:
        self._line.open()
        self._frames = FrameParser()
        self._target, self._is_open = 0.0, True
        self.write_object(CONTROL_WORD_OBJECT, FAULT_RESET_COMMAND)
        self.write_object(OPERATION_MODE_OBJECT, PROFILE_VELOCITY_MODE)
        self.write_object(TARGET_VELOCITY_OBJECT, 0)
        self.write_object(CONTROL_WORD_OBJECT, SHUTDOWN_COMMAND)
        self.write_object(CONTROL_WORD_OBJECT, ENABLE_COMMAND)
        self._check_state()

    def _check_state(self) -> None:
        # CiA 402: bits 0 to 3, 5 and 6 of the status word; xxxx xxxx x01x 0111 is "operation enabled".
        status = self.read_object(STATUS_WORD_OBJECT) & 0xFFFF
        if status & 0x006F != 0x0027:
            code = self.read_object(ERROR_CODE_OBJECT) & 0xFFFF
            what = f"has a fault (error 0x{code:04X})" if status & 0x0008 else "is not enabled; was it reset?"
            raise DeviceError(f"{self.name}: {what} (status 0x{status:04X})")

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        target = round(self._direction * self._gear * speed_rad_s / RPM)
        if speed_rad_s != 0.0 and self._target == 0.0:
            self.write_object(CONTROL_WORD_OBJECT, SHUTDOWN_COMMAND)  # required after a quick stop
            self.write_object(CONTROL_WORD_OBJECT, ENABLE_COMMAND)
        self.write_object(TARGET_VELOCITY_OBJECT, target)
        if target:
            self.write_object(CONTROL_WORD_OBJECT, ENABLE_COMMAND)
        self._target = speed_rad_s
        if target:
            self._check_state()

    def read_new_samples(self) -> Samples:
        self._read_count += 1
        if self._target and self._read_count % _READS_PER_STATUS_CHECK == 0:
            self._check_state()
        # EPOS2 returns the current as the low 16 bits.
        rpm = self.read_object(self._protocol.velocity_object)
        milliampere = self.read_object(self._protocol.current_object)
        if not self._protocol.node_comes_first:
            milliampere = (milliampere & 0xFFFF) - (0x10000 if milliampere & 0x8000 else 0)
        return {
            f"speed_{self._axis}": [self._direction * rpm * RPM / self._gear],
            f"current_{self._axis}": [self._direction * milliampere / 1000.0],
        }

    def stop(self) -> None:
        self._target = 0.0
        if self._is_open:
            self.write_object(CONTROL_WORD_OBJECT, QUICK_STOP_COMMAND, tries=2, patience_s=0.1)
