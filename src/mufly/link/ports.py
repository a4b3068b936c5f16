"""Sockets and serial lines, as ports that never block and never raise into the loop that serves them.

Every port has a few peers; bytes come from a peer and go to one. A cable that is pulled, a peer that vanishes or a
full buffer costs frames, which MAVLink is made to bear, but never parts of one: what is handed to :meth:`Port.send`
goes out as a whole or not at all. What a user should know of (a call that fails, a device that is gone) is said once,
until it changes.
"""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket
import time
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from mufly.errors import InputError
from mufly.link.endpoint import Endpoint

__all__ = ["Peer", "Port", "open_port", "wait"]

RETRY_S = 1.0
"""Time between two attempts to call a TCP server or to open a serial device (s)."""
PEERS = 32
"""So many peers a listening port serves; the one that was silent for longest makes room."""
_READS = 256  # datagrams or blocks taken in one call
_BLOCK = 65_536
_QUEUE = 65_536  # bytes that may wait to go out on a stream
_RECEIVE_BUFFER = 1 << 20
_LATER = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR, errno.ENOBUFS}


class Peer(NamedTuple):
    """The other end of a channel: the endpoint it is heard on, and its address there."""

    endpoint: str
    address: str


class Port(ABC):
    """An open endpoint.

    Parameters
    ----------
    endpoint : Endpoint
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._selector = selectors.DefaultSelector()
        self._notices: list[str] = []
        self._said = ""

    @abstractmethod
    def receive(self) -> list[tuple[Peer, bytes]]:
        """Return what came in since the last call, a bounded amount of it. Also calls again where a call failed."""

    @abstractmethod
    def send(self, peer: Peer | None, data: bytes) -> None:
        """Send a frame to a peer; to all of the port's peers if None."""

    @property
    @abstractmethod
    def peers(self) -> list[Peer]:
        """Those who can be sent to: whom it was told to call, and who was heard."""

    def fileno(self) -> int:
        """A descriptor that becomes readable when there is something to receive; -1 where the system has none.

        It stays the same while connections come and go.
        """
        number = getattr(self._selector, "fileno", None)
        return -1 if number is None else int(number())

    def notices(self) -> list[str]:
        """What happened to the port since the last call, one line each."""
        said, self._notices = self._notices, []
        return said

    def close(self) -> None:
        """Give everything back."""
        for key in list(self._selector.get_map().values()):
            self._selector.unregister(key.fileobj)
            close = getattr(key.fileobj, "close", None)
            if close is not None:
                close()
        self._selector.close()

    def _say(self, text: str) -> None:
        """Say what changed, once."""
        if text != self._said:
            self._said = text
            self._notices.append(f"{self.endpoint}: {text}")


class _Udp(Port):
    """Datagrams, to one address or to whoever was heard."""

    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        family, address = _resolve(endpoint, socket.SOCK_DGRAM, where)
        self._target = Peer(str(endpoint), _name(address))
        self._addresses: OrderedDict[Peer, Any] = OrderedDict()
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_BROADCAST):
            with contextlib.suppress(OSError):
                self._socket.setsockopt(
                    socket.SOL_SOCKET, option, _RECEIVE_BUFFER if option == socket.SO_RCVBUF else 1
                )
        if endpoint.listens:
            _bind(self._socket, address, endpoint, where)
        else:
            self._socket.bind(("", 0))
            self._addresses[self._target] = address
        self._selector.register(self._socket, selectors.EVENT_READ)

    @property
    def port(self) -> int:
        """Number of the port it is bound to."""
        return int(self._socket.getsockname()[1])

    @property
    def peers(self) -> list[Peer]:
        return list(self._addresses)

    def receive(self) -> list[tuple[Peer, bytes]]:
        out = []
        for _ in range(_READS):
            try:
                data, address = self._socket.recvfrom(_BLOCK)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an earlier datagram found nobody there: its sender is told here
                continue
            peer = Peer(str(self.endpoint), _name(address))
            if peer not in self._addresses and len(self._addresses) >= PEERS:
                oldest = next(p for p in self._addresses if self.endpoint.listens or p != self._target)
                del self._addresses[oldest]
            self._addresses[peer] = address
            self._addresses.move_to_end(peer)
            out.append((peer, data))
        return out

    def send(self, peer: Peer | None, data: bytes) -> None:
        for name in self.peers if peer is None else [peer]:
            address = self._addresses.get(name)
            if address is not None:
                try:
                    self._socket.sendto(data, address)
                except OSError as error:
                    if error.errno not in _LATER | {errno.ECONNREFUSED}:
                        self._say(f"cannot send to {name.address} ({error.strerror or error})")


class _Stream:
    """A connection that carries bytes in order: frames wait here until there is room for them."""

    def __init__(self, read: Callable[[int], bytes], write: Callable[[Any], int]) -> None:
        self._read, self._write = read, write
        self._waiting = bytearray()

    def receive(self) -> tuple[bytes, bool]:
        """Return the bytes that came, and whether the other end is gone."""
        out = bytearray()
        try:
            self.flush()
            for _ in range(_READS):
                block = self._read(_BLOCK)
                if not block:
                    return bytes(out), True
                out += block
        except (BlockingIOError, InterruptedError):
            pass
        except OSError:
            return bytes(out), True
        return bytes(out), False

    def send(self, data: bytes) -> None:
        """Queue a frame, or drop it whole if there is no room; raises OSError if the other end is gone."""
        if len(self._waiting) + len(data) <= _QUEUE:
            self._waiting += data
        self.flush()

    def flush(self) -> None:
        while self._waiting:
            try:
                sent = self._write(self._waiting)
            except (BlockingIOError, InterruptedError):
                return
            if not sent:
                return
            del self._waiting[:sent]


class _TcpServer(Port):
    """Waits for calls and serves several at once."""

    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        family, address = _resolve(endpoint, socket.SOCK_STREAM, where)
        self._server = socket.socket(family, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.setblocking(False)
        _bind(self._server, address, endpoint, where)
        self._server.listen(8)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._streams: OrderedDict[Peer, tuple[socket.socket, _Stream]] = OrderedDict()

    @property
    def port(self) -> int:
        """Number of the port it is bound to."""
        return int(self._server.getsockname()[1])

    @property
    def peers(self) -> list[Peer]:
        return list(self._streams)

    def receive(self) -> list[tuple[Peer, bytes]]:
        self._accept()
        out = []
        for peer, (_, stream) in list(self._streams.items()):
            data, gone = stream.receive()
            if data:
                self._streams.move_to_end(peer)
                out.append((peer, data))
            if gone:
                self._drop(peer)
        return out

    def send(self, peer: Peer | None, data: bytes) -> None:
        for name in self.peers if peer is None else [peer]:
            if name in self._streams:
                try:
                    self._streams[name][1].send(data)
                except OSError:
                    self._drop(name)

    def _accept(self) -> None:
        for _ in range(PEERS):
            try:
                connection, address = self._server.accept()
            except OSError:
                return
            if len(self._streams) >= PEERS:
                self._drop(next(iter(self._streams)))
            _prepare(connection)
            self._selector.register(connection, selectors.EVENT_READ)
            peer = Peer(str(self.endpoint), _name(address))
            self._streams[peer] = (connection, _Stream(connection.recv, connection.send))
            self._notices.append(f"{self.endpoint}: {peer.address} has called")

    def _drop(self, peer: Peer) -> None:
        connection, _ = self._streams.pop(peer)
        self._selector.unregister(connection)
        connection.close()
        self._notices.append(f"{self.endpoint}: {peer.address} has hung up")


class _Caller(Port):
    """A connection that is made again whenever it breaks: to a TCP server, or to a serial device."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._peer = Peer(str(endpoint), f"{endpoint.host}:{endpoint.port}")
        self._line: Any = None
        self._stream: _Stream | None = None
        self._retry_s = -RETRY_S

    @abstractmethod
    def _open(self) -> None:
        """Try to connect; raises OSError. Sets the line, and the stream once it stands."""

    @property
    def peers(self) -> list[Peer]:
        return [] if self._stream is None else [self._peer]

    def receive(self) -> list[tuple[Peer, bytes]]:
        if self._stream is None:
            self._try()
        if self._stream is None:
            return []
        data, gone = self._stream.receive()
        if gone:
            self._lose("the connection was lost; trying again")
        return [(self._peer, data)] if data else []

    def send(self, peer: Peer | None, data: bytes) -> None:
        if self._stream is not None and peer in (None, self._peer):
            try:
                self._stream.send(data)
            except OSError:
                self._lose("the connection was lost; trying again")

    def _try(self) -> None:
        now_s = time.monotonic()
        if self._line is None and now_s - self._retry_s < RETRY_S:
            return
        try:
            if self._line is None:
                self._retry_s = now_s
            self._open()
        except OSError as error:
            self._lose(f"cannot connect ({error.strerror or error}); trying again")

    def _up(self, stream: _Stream) -> None:
        self._stream = stream
        self._say("connected")

    def _lose(self, why: str) -> None:
        if self._line is not None:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(self._line)
            self._line.close()
        self._line = self._stream = None
        self._say(why)


class _TcpClient(_Caller):
    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        self._family, self._address = _resolve(endpoint, socket.SOCK_STREAM, where)

    def _open(self) -> None:
        if self._line is None:
            self._line = socket.socket(self._family, socket.SOCK_STREAM)
            _prepare(self._line)
        state = self._line.connect_ex(self._address)
        if state in (errno.EINPROGRESS, errno.EALREADY, errno.EWOULDBLOCK):
            if time.monotonic() - self._retry_s > 5.0 * RETRY_S:
                raise TimeoutError(errno.ETIMEDOUT, "nobody answers")
            return
        if state not in (0, errno.EISCONN):
            raise OSError(state, os.strerror(state))
        self._selector.register(self._line, selectors.EVENT_READ)
        self._up(_Stream(self._line.recv, self._line.send))


class _Serial(_Caller):
    def _open(self) -> None:
        import serial

        try:
            line = serial.Serial(
                self.endpoint.host, self.endpoint.port, timeout=0, write_timeout=0, exclusive=_exclusive()
            )
        except ValueError as error:
            raise OSError(errno.EINVAL, str(error)) from error
        self._line = line
        if os.name == "posix":
            self._selector.register(line, selectors.EVENT_READ)

        def read(size: int) -> bytes:
            data = line.read(min(size, 4096))
            if not data:
                raise BlockingIOError
            return bytes(data)

        def write(data: bytearray) -> int:
            # pyserial would go round and round on a full line; the system says so at once.
            return os.write(line.fileno(), data) if os.name == "posix" else line.write(data) or 0

        self._up(_Stream(read, write))


def open_port(endpoint: Endpoint, where: str = "--link") -> Port:
    """Open an endpoint.

    Parameters
    ----------
    endpoint : Endpoint
    where : str
        Option or file that named it, for the message of an error.

    Raises
    ------
    InputError
        If its host is unknown or its port is in use. A server that does not answer or a device that is not there is
        no error: the port tries again, and says so.
    """
    if endpoint.kind in ("udpin", "udpout"):
        return _Udp(endpoint, where)
    if endpoint.kind == "tcpin":
        return _TcpServer(endpoint, where)
    if endpoint.kind == "tcp":
        return _TcpClient(endpoint, where)
    return _Serial(endpoint)


def wait(ports: Iterable[Port], timeout_s: float) -> None:
    """Sleep until a port has something to receive, for ``timeout_s`` at most."""
    numbers = [n for n in (port.fileno() for port in ports) if n >= 0]
    if not numbers or timeout_s <= 0.0:
        time.sleep(max(0.0, timeout_s))
        return
    with selectors.DefaultSelector() as selector:
        for number in numbers:
            selector.register(number, selectors.EVENT_READ)
        selector.select(timeout_s)


def _resolve(endpoint: Endpoint, kind: int, where: str) -> tuple[int, Any]:
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)
    except (OSError, UnicodeError) as error:
        raise InputError(
            where, "", f"host {endpoint.host!r} of {endpoint} is not known ({error})", "give its address"
        ) from error
    # IPv4 first: the other end of a link that says "localhost" is an old program more often than a new one.
    family, _, _, _, address = min(found, key=lambda f: f[0] != socket.AF_INET)
    return family, address


def _bind(line: socket.socket, address: Any, endpoint: Endpoint, where: str) -> None:
    try:
        line.bind(address)
    except OSError as error:
        line.close()
        raise InputError(
            where,
            "",
            f"cannot listen at {endpoint} ({error.strerror or error})",
            "end the program that does, or give another port",
        ) from error


def _prepare(line: socket.socket) -> None:
    line.setblocking(False)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _exclusive() -> bool | None:
    return True if os.name == "posix" else None


def _name(address: Any) -> str:
    host, port = address[0], address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
