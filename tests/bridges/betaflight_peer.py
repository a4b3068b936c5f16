"""Scripted Betaflight: the UDP packets and the serial port of its software in the loop, by their description."""

import socket
import struct
import threading

from mufly.bridges.autopilot_gains import AutopilotGains, CascadeGains

REST, IDLE = (1000, 1000, 1500, 1500), (1050, 1050, 1500, 1500)
_LEVEL = {
    "position": 0.76,
    "velocity": 2.9,
    "velocity_integral": 2.15,
    "velocity_derivative": 0.34,
    "rate_integral": 4.0,
}
GAINS = AutopilotGains(
    "mufly-1.1", 0.7555, 6.67, -0.0356, CascadeGains(**_LEVEL, angle=8.31, rate_proportional=0.345),
    CascadeGains(**_LEVEL, angle=6.66, rate_proportional=0.430),
    CascadeGains(angle=5.0, rate_proportional=0.048, rate_integral=0.746),
    CascadeGains(position=1.0, velocity=5.44, velocity_integral=1.0, velocity_derivative=1.27), (),
)  # fmt: skip
"""Rounded gains of ``mufly autopilot gains betaflight --vehicle mufly-1.1``; the design takes seconds."""


class Peer:
    """Betaflight's UDP ports: receives states and channels, answers with outputs when the test says so."""

    def __init__(self) -> None:
        self.state, self.channels = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for line in (self.state, self.channels):
            line.bind(("127.0.0.1", 0))
            line.settimeout(20.0)
        self.restart()
        self.output_port = 0
        self._serial = socket.create_server(("127.0.0.1", 0))  # connections wait in its queue

    @property
    def ports(self) -> tuple[int, int, int]:
        return tuple(line.getsockname()[1] for line in (self.state, self.channels, self._serial))

    def restart(self) -> None:
        self._outputs = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._outputs.bind(("127.0.0.1", 0))

    def receive_state(self) -> tuple[float, ...]:
        return struct.unpack("<18d", self.state.recv(65536))

    def receive_channels(self) -> tuple[int, ...]:
        """Return the newest channels that have come."""
        pulses = struct.unpack("<d16H", self.channels.recv(65536))[1:]
        self.channels.setblocking(False)
        try:
            while True:
                pulses = struct.unpack("<d16H", self.channels.recv(65536))[1:]
        except BlockingIOError:
            self.channels.settimeout(20.0)
        return pulses

    def send(self, data: bytes) -> None:
        self._outputs.sendto(data, ("127.0.0.1", self.output_port))

    def send_outputs(self, pulses: tuple[float, ...] = REST, motors: int = 2) -> None:
        self.send(struct.pack("<H2x16f", motors, *pulses, *[0.0] * (16 - len(pulses))))

    def answer(self, pulses: tuple[float, ...] = REST, motors: int = 2) -> tuple[float, ...]:
        """Answer one state with outputs; return the state."""
        state = self.receive_state()
        self.send_outputs(pulses, motors)
        return state


class SerialPort:
    """Betaflight's serial port: a command line after "#", MSP answers before it."""

    def __init__(self, flags: int = 0, refused: str = "") -> None:
        self._flags, self._refused = flags, refused
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.lines: list[str] = []
        self.requests = 0
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        first = b""
        while not first:  # a connection without data asks whether the port is open
            line, _ = self._server.accept()
            first = line.recv(1)
        if first == b"$":
            self._answer_msp(line)
            return
        line.sendall(b"\r\nEntering CLI Mode, type 'exit' to return\r\n\r\n# ")
        text = b""
        while data := line.recv(65536):
            text += data
            while b"\r\n" in text:
                command, _, text = text.partition(b"\r\n")
                self.lines.append(command.decode())
                line.sendall(command + b"\r\n")
                if command == b"save":
                    line.close()
                    return
                if self._refused and command.decode().startswith(self._refused):
                    line.sendall(b"###ERROR IN set: INVALID NAME###\r\n")
                line.sendall(b"\r\n# ")

    def _answer_msp(self, line: socket.socket) -> None:
        line.recv(65536)
        self.requests += 1
        payload = struct.pack("<HHHIBHBBBBBIB", 125, 0, 33, 0, 0, 10, 4, 4, 1, 0, 29, self._flags, 0)
        body = bytes([len(payload), 150]) + payload
        check = 0
        for byte in body:
            check ^= byte
        line.sendall(b"$M>" + body + bytes([check]))
        line.recv(1)
