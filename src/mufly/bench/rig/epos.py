"""A motor controller of the EPOS kind: CANopen objects (SDO) over a serial line.

Frames, from the maxon "EPOS4 Communication Guide" (rel8759, 2019-11), ch. 2.2; the example of its ch. 2.2.9 is a test:

    0x90 0x02 | OpCode | Len | Len words of data, low byte first | CRC, low byte first

Len counts words. The CRC is CCITT's, x^16 + x^12 + x^5 + 1 from 0, over the frame's words (Len the high byte of the
first, OpCode its low), high byte first. Every 0x90 after the first two bytes is doubled (byte stuffing). The guide's
requests:

    ReadObject   0x60  node, index (word), subindex                    ->  0x00  error (4 bytes), value (4 bytes)
    WriteObject  0x68  node, index (word), subindex, value (4 bytes)   ->  0x00  error (4 bytes)

EPOS2 has the same frames and the opcodes 0x10 and 0x11, with index, subindex, node in that order. The older EPOS 24/5
of the dissertation's bench acknowledges every half of a frame with a letter instead, and is not spoken to by this
driver.

Objects are those of CiA 402 (control word 0x6040, status word 0x6041, mode 0x6060, target velocity 0x60FF in rpm) and
maxon's (averaged velocity and current). There is no watchdog on the serial line: if the cable is pulled while a motor
turns, it goes on turning. Use the digital input "quick stop" for a button that somebody can reach.
"""

from __future__ import annotations

import binascii
import struct
import time
from dataclasses import dataclass

from mufly.bench.rig.devices import DeviceError, Samples
from mufly.bench.rig.line import PATIENCE_s, SerialLine
from mufly.units import RPM

DLE, STX = 0x90, 0x02
TRIES = 3
_STATUS_EVERY = 10  # readings between two looks at the status word

CONTROL, STATUS, MODE, TARGET, ERROR = (0x6040, 0), (0x6041, 0), (0x6060, 0), (0x60FF, 0), (0x603F, 0)
SHUTDOWN, ENABLE, QUICK_STOP, FAULT_RESET = 0x0006, 0x000F, 0x0002, 0x0080
PROFILE_VELOCITY = 3


@dataclass(frozen=True)
class Generation:
    """What differs between controllers: opcodes, order of a request, objects of averaged velocity and current."""

    read: int
    write: int
    node_first: bool
    velocity: tuple[int, int]
    current: tuple[int, int]


GENERATIONS = {
    4: Generation(0x60, 0x68, True, (0x30D3, 1), (0x30D1, 1)),
    2: Generation(0x10, 0x11, False, (0x2028, 0), (0x2027, 0)),
}


def crc_of(opcode: int, data: bytes) -> int:
    """Return the CRC of a frame's words."""
    words = bytes((len(data) // 2, opcode))
    words += b"".join(data[k : k + 2][::-1] for k in range(0, len(data), 2))
    return binascii.crc_hqx(words, 0)


def frame(opcode: int, data: bytes) -> bytes:
    """Return a frame as it goes over the line; ``data`` has an even length."""
    body = bytes((opcode, len(data) // 2)) + data + struct.pack("<H", crc_of(opcode, data))
    return bytes((DLE, STX)) + body.replace(bytes((DLE,)), bytes((DLE, DLE)))


class Frames:
    """Finds frames in bytes as they come, whatever was lost before.

    Attributes
    ----------
    broken : int
        Frames whose sum did not fit.
    """

    def __init__(self) -> None:
        self.broken = 0
        self._body: bytearray | None = None
        self._escape = False

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return opcode and data of every frame that is whole now."""
        out = []
        for byte in data:
            if self._escape:
                self._escape = False
                if byte == STX:
                    self.broken += self._body is not None and len(self._body) > 0
                    self._body = bytearray()
                    continue
                if byte != DLE:  # neither a beginning nor a doubled one: something was lost
                    self.broken += self._body is not None
                    self._body = None
                    continue
            elif byte == DLE:
                self._escape = True
                continue
            if self._body is None:
                continue
            self._body.append(byte)
            if len(self._body) >= 2 and len(self._body) == 4 + 2 * self._body[1]:
                opcode, payload = self._body[0], bytes(self._body[2:-2])
                if struct.unpack("<H", self._body[-2:])[0] == crc_of(opcode, payload):
                    out.append((opcode, payload))
                else:
                    self.broken += 1
                self._body = None
        return out


class Epos:
    """One motor on an EPOS2 or EPOS4; a :class:`mufly.bench.rig.devices.Device`.

    Parameters
    ----------
    port : str
    axis : 'upper' or 'lower'
    baud : int
        115200 is how they are delivered; over USB it does not matter.
    node : int
    generation : 2 or 4
    direction : 1 or -1
        Sense of the motor's rotation that lifts.
    gear : float
        Motor speed over rotor speed.
    """

    def __init__(
        self, port: str, axis: str, *, baud: int = 115_200, node: int = 1, generation: int = 4, direction: int = 1,
        gear: float = 1.0,
    ) -> None:  # fmt: skip
        self._line = SerialLine(port, baud, f"EPOS {axis}")
        self.name = self._line.name
        self.axes = (axis,)
        self.channels = (f"speed_{axis}", f"current_{axis}")
        self._axis, self._node, self._kind = axis, node, GENERATIONS[generation]
        self._direction, self._gear = direction, gear
        self._frames = Frames()
        self._target, self._reads, self._opened = 0.0, 0, False

    @property
    def broken(self) -> int:
        """Frames that were passed over."""
        return self._frames.broken

    def _ask(self, opcode: int, data: bytes, tries: int = TRIES, patience_s: float = PATIENCE_s) -> bytes:
        """Send a request until it is answered; return the answer's data after the error code."""
        for _ in range(tries):
            self._line.read()
            self._frames = Frames() if self._frames.broken > 1000 else self._frames
            self._line.write(frame(opcode, data))
            until = time.monotonic() + patience_s
            while (left := until - time.monotonic()) > 0:
                for answer, payload in self._frames.feed(self._line.read(left)):
                    if answer != 0x00 or len(payload) < 4:
                        continue
                    code = struct.unpack("<I", payload[:4])[0]
                    if code == 0x0504_0005 or code & 0xFFFF_0000 == 0x0F00_0000:
                        break  # it did not understand a frame that was damaged: again
                    if code:
                        raise DeviceError(f"{self.name}: refuses the request (error 0x{code:08X})")
                    return payload[4:]
        raise DeviceError(f"{self.name}: does not answer ({tries} tries of {patience_s:g} s)")

    def _where(self, item: tuple[int, int]) -> bytes:
        index, sub = item
        if self._kind.node_first:
            return struct.pack("<BHB", self._node, index, sub)
        return struct.pack("<HBB", index, sub, self._node)

    def get(self, item: tuple[int, int]) -> int:
        """Return an object's value, as a signed number of 32 bits."""
        data = self._ask(self._kind.read, self._where(item))
        if len(data) < 4:
            raise DeviceError(f"{self.name}: an answer is too short")
        return int(struct.unpack("<i", data[:4])[0])

    def set(
        self, item: tuple[int, int], value: int, tries: int = TRIES, patience_s: float = PATIENCE_s
    ) -> None:
        """Set an object's value."""
        self._ask(self._kind.write, self._where(item) + struct.pack("<i", value), tries, patience_s)

    def open(self) -> None:
        self._line.open()
        self._frames = Frames()
        self._target, self._opened = 0.0, True
        self.set(CONTROL, FAULT_RESET)
        self.set(MODE, PROFILE_VELOCITY)
        self.set(TARGET, 0)
        self.set(CONTROL, SHUTDOWN)
        self.set(CONTROL, ENABLE)
        self._check_state()

    def _check_state(self) -> None:
        # CiA 402: bits 0 to 3, 5 and 6 of the status word; xxxx xxxx x01x 0111 is "operation enabled".
        status = self.get(STATUS) & 0xFFFF
        if status & 0x006F != 0x0027:
            code = self.get(ERROR) & 0xFFFF
            what = f"has a fault (error 0x{code:04X})" if status & 0x0008 else "is not enabled; was it reset?"
            raise DeviceError(f"{self.name}: {what} (status 0x{status:04X})")

    def turn(self, axis: str, speed_rad_s: float) -> None:
        target = round(self._direction * self._gear * speed_rad_s / RPM)
        if speed_rad_s != 0.0 and self._target == 0.0:
            self.set(CONTROL, SHUTDOWN)  # after a quick stop it has to be enabled anew
            self.set(CONTROL, ENABLE)
        self.set(TARGET, target)
        if target:
            self.set(CONTROL, ENABLE)
        self._target = speed_rad_s
        if target:
            self._check_state()

    def read(self) -> Samples:
        self._reads += 1
        if self._target and self._reads % _STATUS_EVERY == 0:
            self._check_state()
        # EPOS2 answers current with 16 bits; the value lies in the low ones.
        rpm, milliampere = self.get(self._kind.velocity), self.get(self._kind.current)
        if not self._kind.node_first:
            milliampere = (milliampere & 0xFFFF) - (0x10000 if milliampere & 0x8000 else 0)
        return {
            f"speed_{self._axis}": [self._direction * rpm * RPM / self._gear],
            f"current_{self._axis}": [self._direction * milliampere / 1000.0],
        }

    def stop(self) -> None:
        self._target = 0.0
        if self._opened:
            self.set(CONTROL, QUICK_STOP, tries=2, patience_s=0.1)

    def close(self) -> None:
        try:
            self.stop()
        finally:
            self._opened = False
            self._line.close()
