"""Sockets and serial lines as ports, which never block and never raise errors into the loop that calls them.

Every port has a few peers; bytes are received from a peer and sent to one. A pulled cable, a lost peer or a full buffer
costs whole frames, which MAVLink tolerates, but never parts of one: :meth:`Port.send_frame` sends all of a frame or
nothing. Events (a failed call, a lost device) are reported once, until they change.

An endpoint is the address of the other end: ``udp:127.0.0.1:14550``, ``serial:/dev/ttyUSB0:57600`` and the like. The
names are those of MAVLink programs (pymavlink, MAVProxy, MAVSDK): ``udpin`` and ``tcpin`` listen, ``udpout`` and
``tcp`` call. Plain ``udp`` depends on the side: a vehicle sends to the address, a ground station listens on it.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import re
import selectors
import socket
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from mufly.errors import ArgumentError

MAX_PEERS = 32
"""Largest number of peers of a listening port; the peer that was silent for longest makes room."""
MAX_READS_PER_CALL, MAX_READ_BYTES = 256, 65_536
"""Largest number of datagrams or blocks received in one call, and the largest size of one (bytes)."""
RECONNECT_PERIOD_S = 1.0
"""Time between two attempts to call a TCP server or to open a serial device (s)."""
_MAX_DISCARD_READS = 100
_TCP_USER_TIMEOUT_MS = 2000
"""Time without acknowledgement after which a TCP connection is dropped, with its queued data (ms)."""
_STALE_INPUT_TEXT = "closed: unread bytes had accumulated"
_MAX_QUEUE_BYTES = 65_536  # largest size of the output queue
_SERIAL_BLOCK_BYTES = 4096
_CONNECTION_LOST_TEXT = "the connection was lost; trying again"
_SERIAL_QUEUE_S = 0.3
_RECEIVE_BUFFER_BYTES = 1 << 20
_DEVICE_ERROR_TEXTS = {
    errno.ENOENT: "there is no such device; plug it in",
    errno.ENODEV: "there is no such device; plug it in",
    errno.ENXIO: "there is no such device; plug it in",
    errno.EACCES: "no permission; on Linux its group is dialout or uucp: join it and log in again",
    errno.EBUSY: "another program uses it; end that one",
    errno.EAGAIN: "another program uses it; end that one",
    errno.ENOTTY: "it is no serial device",
    errno.EISDIR: "it is no serial device",
    errno.EINVAL: "not a serial device, or the baud rate is not supported",
}
_TRANSIENT_ERRORS = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR, errno.ENOBUFS, errno.ECONNREFUSED}

EndpointKind = Literal["udpin", "udpout", "tcp", "tcpin", "serial"]
_ENDPOINT_KINDS: tuple[EndpointKind, ...] = ("udpin", "udpout", "tcp", "tcpin", "serial")
_ENDPOINT_EXAMPLES = (
    "write for example udp:127.0.0.1:14550, udpin:0.0.0.0:14550, udpout:192.168.0.7:14550, tcp:127.0.0.1:5760, "
    "tcpin:127.0.0.1:5760, udp:[::1]:14550 or serial:/dev/ttyUSB0:57600"
)
_SERIAL_EXAMPLE = "write for example serial:/dev/ttyUSB0:57600"
_DEFAULT_BAUD = 57_600  # usual for telemetry radios
_HOST_PORT_PATTERN = re.compile(r"(?:(?P<host>\[[^\]]*\]|[^:\[\]]*):)?(?P<port>[^:]*)")


def open_port(endpoint: Endpoint, where: str = "endpoint") -> Port:
    """Open the UDP, TCP or serial connection of an endpoint, and return its port.

    Parameters
    ----------
    endpoint : Endpoint
    where : str
        Source of the endpoint, for error messages.

    Raises
    ------
    InputError
        If its host is unknown or its port is in use. A server that does not answer and an absent device are no errors:
        the port retries, and reports it.
    """
    kinds: dict[EndpointKind, Callable[[Endpoint], Port]] = {
        "udpin": UdpPort,
        "udpout": UdpPort,
        "tcp": TcpClient,
        "tcpin": TcpServer,
        "serial": SerialPort,
    }
    try:
        return kinds[endpoint.kind](endpoint)
    except ArgumentError as error:
        raise error.with_location(where) from error


MAX_REQUEST_AGE_S = 1.0
"""Greatest delay with which a request to a vehicle is executed (s); older requests are dropped."""
_BOOT_CLOCK_ID = getattr(time, "CLOCK_BOOTTIME", None)


def read_boot_clock() -> float:
    """Return a monotonic clock (s) that also runs while the machine is suspended.

    Linux stops ``time.monotonic`` during a suspension and has CLOCK_BOOTTIME for this; elsewhere they are the same.
    """
    return time.monotonic() if _BOOT_CLOCK_ID is None else time.clock_gettime(_BOOT_CLOCK_ID)


def wait_for_input(ports: Iterable[Port], timeout_s: float) -> None:
    """Sleep until a port has something to receive, for ``timeout_s`` at most."""
    numbers = [n for n in (port.fileno() for port in ports) if n >= 0]
    if not numbers or timeout_s <= 0.0:
        time.sleep(max(0.0, timeout_s))
        return
    with selectors.DefaultSelector() as selector:
        for number in numbers:
            selector.register(number, selectors.EVENT_READ)
        selector.select(timeout_s)


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Address of one end of a link: kind of connection, host and port number.

    Attributes
    ----------
    kind : str
        ``"udpin"``, ``"udpout"``, ``"tcp"`` (calls), ``"tcpin"`` (listens) or ``"serial"``.
    host : str
        Name or address without brackets; the device of a serial link.
    port : int
        Number of the port; the baud rate of a serial link.
    """

    kind: EndpointKind
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host and self.kind != "serial" else self.host
        return f"{self.kind}:{host}:{self.port}"

    @property
    def is_listening(self) -> bool:
        """Return whether the port waits for incoming connections."""
        return self.kind in ("udpin", "tcpin")

    @property
    def is_beyond_loopback(self) -> bool:
        """Return whether the port listens on a non-loopback address."""
        if not self.is_listening or self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True

    @property
    def explanation(self) -> str:
        """Return a description: "sends to 127.0.0.1 port 14550 (UDP)"."""
        if self.kind == "serial":
            return f"uses {self.host} at {self.port} baud"
        place = f"{self.host} port {self.port}"
        return {
            "udpin": f"listens at {place} (UDP)",
            "udpout": f"sends to {place} (UDP)",
            "tcp": f"calls {place} (TCP)",
            "tcpin": f"waits for calls at {place} (TCP)",
        }[self.kind]


def parse_endpoint(
    text: str, role: Literal["vehicle", "station"], where: str = "endpoint", least_port: int = 1
) -> Endpoint:
    """Return the endpoint that a text such as ``udp:127.0.0.1:14550`` describes.

    Parameters
    ----------
    text : str
        ``KIND:HOST:PORT`` or ``serial:DEVICE[:BAUD]``; an empty HOST means this machine, an IPv6 address is
        written in brackets.
    role : str
        Side that opens the endpoint, which decides the meaning of plain ``udp``.
    where : str
        Source of the text, for error messages.
    least_port : int
        0 lets a listening endpoint take any free port (tests).

    Raises
    ------
    InputError
        If the text is no endpoint.
    """

    def make_endpoint_error(problem: str, remedy: str = _ENDPOINT_EXAMPLES) -> ArgumentError:
        return ArgumentError(where, "", f"{text!r}{problem}", remedy)

    word, colon, rest = text.strip().partition(":")
    kind = ("udpout" if role == "vehicle" else "udpin") if word.lower() == "udp" else word.lower()
    if kind not in _ENDPOINT_KINDS or not colon:
        raise make_endpoint_error(" is not a MAVLink endpoint")
    if kind == "serial":
        device, colon, baud = rest.rpartition(":")
        # Device names may contain colons (/dev/serial/by-path/pci-0000:00:14.0-usb-0:1).
        if not colon or not (baud.isascii() and baud.isdigit()):
            device, baud = rest, str(_DEFAULT_BAUD)
        if not device:
            raise make_endpoint_error(" names no device", _SERIAL_EXAMPLE)
        if not 300 <= int(baud) <= 12_000_000:
            raise make_endpoint_error(f": {baud} is no baud rate", _SERIAL_EXAMPLE)
        return Endpoint("serial", device, int(baud))
    found = _HOST_PORT_PATTERN.fullmatch(rest)
    if found is None:
        brackets = "put an IPv6 address in brackets, as in udp:[::1]:14550"
        raise make_endpoint_error(
            " states no valid host and port",
            brackets if rest.count(":") > 1 else _ENDPOINT_EXAMPLES,
        )
    number = found["port"]
    if not (number.isascii() and number.isdigit()) or not least_port <= int(number) <= 65535:
        raise make_endpoint_error(f": port {number!r} is no number from 1 to 65535")
    given = found["host"] or "127.0.0.1"
    host = given.strip("[]")
    if given.startswith("["):
        try:
            ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            raise make_endpoint_error(f": {host!r} is no IPv6 address") from None
    return Endpoint(kind, host, int(number))


class Peer(NamedTuple):
    """Other side of a connection: name of our endpoint that reaches it, and its address."""

    endpoint: str
    address: str


class Port(ABC):
    """Open UDP, TCP or serial connection of an endpoint to one or several peers.

    Parameters
    ----------
    endpoint : Endpoint

    Attributes
    ----------
    problem : str
        Reason why nothing can be received at present, naming the port; "" if all is well.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._lines: OrderedDict[Peer, Any] = OrderedDict()  # peers that can be sent to, each with its connection
        self._selector = selectors.DefaultSelector()
        self._notices: list[str] = []
        self._said = ""
        self.problem = ""

    @abstractmethod
    def receive_bytes(self) -> list[tuple[Peer, bytes]]:
        """Return the bytes received since the last call, up to a bound; reconnect where a connection failed."""

    @abstractmethod
    def _send_to_peer(self, peer: Peer, data: bytes) -> None:
        """Send a frame to a known peer; an OSError of the socket or stream passes through."""

    @abstractmethod
    def _handle_send_error(self, peer: Peer, error: OSError) -> None:
        """Report a failed transmission to a peer, or drop the peer or connection, as the kind of port requires."""

    def send_frame(self, peer: Peer | None, data: bytes) -> None:
        """Send a frame to a peer; to all peers of the port if None."""
        for name in self.reachable_peers if peer is None else [peer]:
            if name in self._lines:
                try:
                    self._send_to_peer(name, data)
                except OSError as error:
                    self._handle_send_error(name, error)

    @property
    def reachable_peers(self) -> list[Peer]:
        """Return the peers that can be sent to: configured ones, and those that were heard."""
        return list(self._lines)

    @property
    def configured_targets(self) -> list[Peer]:
        """Return the configured peers to which frames can be sent before they have been heard."""
        return []

    def discard_input(self) -> None:
        """Discard waiting input, which arrived while the port was not served."""
        for _ in range(_MAX_DISCARD_READS):
            if not self.receive_bytes():
                return

    def fileno(self) -> int:
        """Return a descriptor that becomes readable with the next input; -1 where the system has none.

        It stays the same while connections come and go.
        """
        number = getattr(self._selector, "fileno", None)
        return -1 if number is None else int(number())

    def take_notices(self) -> list[str]:
        """Return the events of the port since the last call, one line each."""
        said, self._notices = self._notices, []
        return said

    def close(self) -> None:
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
            close = getattr(key.fileobj, "close", None)
            if close is not None:
                close()
        self._selector.close()

    def _note_change(self, text: str) -> None:
        """Report a change once."""
        if text != self._said:
            self._said = text
            self._notices.append(f"{self.endpoint}: {text}")


def _resolve_address(endpoint: Endpoint, kind: int) -> tuple[int, Any]:
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)
    except (OSError, UnicodeError) as error:
        raise ArgumentError(
            "endpoint", "", f"host {endpoint.host!r} of {endpoint} is not known ({error})", "give its address"
        ) from error
    # IPv4 first: a program at the other end that says "localhost" more often listens there.
    family, _, _, _, address = min(found, key=lambda f: f[0] != socket.AF_INET)
    return family, address


def _bind_socket(line: socket.socket, address: Any, endpoint: Endpoint) -> None:
    try:
        line.bind(address)
    except OSError as error:
        line.close()
        raise ArgumentError(
            "endpoint",
            "",
            f"cannot listen at {endpoint} ({error.strerror or error})",
            "end the program that does, or give another port",
        ) from error


def _format_address(address: Any) -> str:
    host, port = address[0], address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


class UdpPort(Port):
    """A datagram port, to one address or to all peers heard."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        family, address = _resolve_address(endpoint, socket.SOCK_DGRAM)
        self._target = Peer(str(endpoint), _format_address(address))
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_BROADCAST):
            with contextlib.suppress(OSError):
                self._socket.setsockopt(
                    socket.SOL_SOCKET, option, _RECEIVE_BUFFER_BYTES if option == socket.SO_RCVBUF else 1
                )
        if endpoint.is_listening:
            _bind_socket(self._socket, address, endpoint)
        else:
            self._socket.bind(("", 0))
            self._lines[self._target] = address
        self._selector.register(self._socket, selectors.EVENT_READ)

    @property
    def bound_port_number(self) -> int:
        """UDP port number to which the socket is bound."""
        return int(self._socket.getsockname()[1])

    @property
    def configured_targets(self) -> list[Peer]:
        return [] if self.endpoint.is_listening else [self._target]

    def receive_bytes(self) -> list[tuple[Peer, bytes]]:
        out = []
        for _ in range(MAX_READS_PER_CALL):
            try:
                data, address = self._socket.recvfrom(MAX_READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # no receiver for an earlier datagram: reported to its sender here
                continue
            peer = Peer(str(self.endpoint), _format_address(address))
            if peer not in self._lines and len(self._lines) >= MAX_PEERS:
                oldest = next(p for p in self._lines if self.endpoint.is_listening or p != self._target)
                del self._lines[oldest]
            self._lines[peer] = address
            self._lines.move_to_end(peer)
            out.append((peer, data))
        return out

    def _send_to_peer(self, peer: Peer, data: bytes) -> None:
        self._socket.sendto(data, self._lines[peer])

    def _handle_send_error(self, peer: Peer, error: OSError) -> None:
        if error.errno not in _TRANSIENT_ERRORS:
            self._note_change(f"cannot send to {peer.address} ({error.strerror or error})")


class ByteStream:
    """A stream connection, with a queue of frames that wait for room in the buffer."""

    def __init__(
        self, read: Callable[[int], bytes], write: Callable[[Any], int], most_waiting: int = _MAX_QUEUE_BYTES
    ) -> None:
        self._read, self._write, self._most = read, write, most_waiting
        self._waiting = bytearray()

    def receive_bytes(self) -> tuple[bytes, bool]:
        """Return the received bytes, and whether the other end is gone."""
        out = bytearray()
        try:
            self.send_queued_frames()
            for _ in range(MAX_READS_PER_CALL):
                block = self._read(MAX_READ_BYTES)
                if not block:
                    return bytes(out), True
                out += block
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            return bytes(out), True
        return bytes(out), False

    def queue_frame(self, data: bytes) -> None:
        """Queue a frame, or drop it whole if the queue is full; raise OSError if the other end is gone."""
        if len(self._waiting) + len(data) <= self._most:
            self._waiting += data
        self.send_queued_frames()

    def send_queued_frames(self) -> None:
        while self._waiting:
            try:
                sent = self._write(self._waiting)
            except (BlockingIOError, InterruptedError):
                return
            if not sent:
                return
            del self._waiting[:sent]


class TcpServer(Port):
    """TCP server that accepts several connections."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        family, address = _resolve_address(endpoint, socket.SOCK_STREAM)
        self._server = socket.socket(family, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.setblocking(False)
        _bind_socket(self._server, address, endpoint)
        self._server.listen(8)
        self._selector.register(self._server, selectors.EVENT_READ)

    @property
    def bound_port_number(self) -> int:
        """Number of the port it is bound to."""
        return int(self._server.getsockname()[1])

    def receive_bytes(self) -> list[tuple[Peer, bytes]]:
        self._accept_connections()
        out = []
        for peer, (_, stream) in list(self._lines.items()):
            data, gone = stream.receive_bytes()
            if data:
                self._lines.move_to_end(peer)
                out.append((peer, data))
            if gone:
                self._drop_peer(peer)
        return out

    def discard_input(self) -> None:
        # More input waits at the other end: only a new connection has none.
        for peer in self.reachable_peers:
            self._drop_peer(peer)

    def _send_to_peer(self, peer: Peer, data: bytes) -> None:
        self._lines[peer][1].queue_frame(data)

    def _handle_send_error(self, peer: Peer, error: OSError) -> None:
        self._drop_peer(peer)

    def _accept_connections(self) -> None:
        for _ in range(MAX_PEERS):
            try:
                connection, address = self._server.accept()
            except OSError:
                return
            if len(self._lines) >= MAX_PEERS:
                self._drop_peer(next(iter(self._lines)))
            _configure_socket(connection)
            self._selector.register(connection, selectors.EVENT_READ)
            peer = Peer(str(self.endpoint), _format_address(address))
            self._lines[peer] = (connection, ByteStream(connection.recv, connection.send))
            self._notices.append(f"{self.endpoint}: {peer.address} has connected")

    def _drop_peer(self, peer: Peer) -> None:
        connection, _ = self._lines.pop(peer)
        self._selector.unregister(connection)
        connection.close()
        self._notices.append(f"{self.endpoint}: {peer.address} has disconnected")


class ReconnectingPort(Port):
    """A connection to a TCP server or a serial device, renewed whenever it breaks."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._peer = Peer(str(endpoint), f"{endpoint.host}:{endpoint.port}")
        self._line: Any = None
        self._retry_s = -RECONNECT_PERIOD_S

    @abstractmethod
    def _attempt_connection(self) -> None:
        """Try to connect; raise OSError on failure.

        Implementations set the socket and, once connected, the stream.
        """

    @property
    def configured_targets(self) -> list[Peer]:
        return self.reachable_peers

    def receive_bytes(self) -> list[tuple[Peer, bytes]]:
        if self._peer not in self._lines:
            self._reconnect_when_due()
        if self._peer not in self._lines:
            return []
        data, gone = self._lines[self._peer].receive_bytes()
        if gone:
            self._drop_connection(_CONNECTION_LOST_TEXT)
        return [(self._peer, data)] if data else []

    def _send_to_peer(self, peer: Peer, data: bytes) -> None:
        self._lines[peer].queue_frame(data)

    def _handle_send_error(self, peer: Peer, error: OSError) -> None:
        self._drop_connection(_CONNECTION_LOST_TEXT)

    def _reconnect_when_due(self) -> None:
        now_s = time.monotonic()
        if self._line is None and now_s - self._retry_s < RECONNECT_PERIOD_S:
            return
        try:
            if self._line is None:
                self._retry_s = now_s
            self._attempt_connection()
        except OSError as error:
            self._drop_connection(f"cannot connect ({error.strerror or error}); trying again")

    def _set_connected(self, stream: ByteStream) -> None:
        self._lines[self._peer] = stream
        self.problem = ""
        self._note_change("connected")

    def _drop_connection(self, why: str) -> None:
        if self._line is not None:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(self._line)
            self._line.close()
        self._line = None
        self._lines.clear()
        self.problem = f"{self.endpoint}: {why}"
        self._note_change(why)


class TcpClient(ReconnectingPort):
    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._family, self._address = _resolve_address(endpoint, socket.SOCK_STREAM)

    def discard_input(self) -> None:
        if self.reachable_peers:
            self._drop_connection(_STALE_INPUT_TEXT)

    def _attempt_connection(self) -> None:
        if self._line is None:
            self._line = socket.socket(self._family, socket.SOCK_STREAM)
            _configure_socket(self._line)
        state = self._line.connect_ex(self._address)
        if state in (errno.EINPROGRESS, errno.EALREADY, errno.EWOULDBLOCK):
            if time.monotonic() - self._retry_s > 5.0 * RECONNECT_PERIOD_S:
                raise TimeoutError(errno.ETIMEDOUT, "nobody answers")
            return
        if state not in (0, errno.EISCONN):
            raise OSError(state, os.strerror(state))
        self._selector.register(self._line, selectors.EVENT_READ)
        self._set_connected(ByteStream(self._line.recv, self._line.send))


class SerialPort(ReconnectingPort):
    def _attempt_connection(self) -> None:
        import serial

        try:
            line = serial.Serial(
                self.endpoint.host,
                self.endpoint.port,
                timeout=0,
                write_timeout=0,
                exclusive=True if os.name == "posix" else None,
            )
        except ValueError as error:
            raise OSError(errno.EINVAL, str(error)) from error
        except OSError as error:
            # pyserial gives some error numbers in the text only.
            told = re.search(r"\((\d+), '", str(error))
            number = error.errno or (int(told[1]) if told else errno.EIO)
            raise OSError(number, _DEVICE_ERROR_TEXTS.get(number) or str(error.strerror or error)) from error
        self._line = line
        if os.name == "posix":
            self._selector.register(line, selectors.EVENT_READ)

        def read_block(size: int) -> bytes:
            data = line.read(min(size, _SERIAL_BLOCK_BYTES))
            if not data:
                raise BlockingIOError
            return bytes(data)

        def write_block(data: bytearray) -> int:
            # pyserial would loop on a full line; the system call returns at once.
            return os.write(line.fileno(), data) if os.name == "posix" else line.write(data) or 0

        # Ten bits a byte; data that would be older than this when sent is dropped.
        self._set_connected(
            ByteStream(read_block, write_block, max(600, round(_SERIAL_QUEUE_S * self.endpoint.port / 10)))
        )


def _configure_socket(line: socket.socket) -> None:
    line.setblocking(False)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_USER_TIMEOUT"):  # else a command may wait for minutes in the system, and be executed then
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _TCP_USER_TIMEOUT_MS)
