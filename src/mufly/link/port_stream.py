"""Connections that carry bytes in order: TCP, called or calling, and serial lines.

A frame goes out as a whole or not at all: it waits until there is room for it, and is dropped when too much waits
already.
"""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket
import time
from abc import abstractmethod
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from mufly.link.endpoint import Endpoint
from mufly.link.port import PEERS, READ_BYTES, READS, Peer, Port, bind, resolve, text_of_address

__all__ = ["RETRY_S", "SerialPort", "TcpClient", "TcpServer"]

RETRY_S = 1.0
"""Time between two attempts to call a TCP server or to open a serial device (s)."""
_QUEUE = 65_536  # bytes that may wait to go out
_SERIAL_BLOCK = 4096
_SERIAL_LAG_S = 0.3


class Stream:
    """A connection that carries bytes in order: frames wait here until there is room for them."""

    def __init__(
        self, read: Callable[[int], bytes], write: Callable[[Any], int], most_waiting: int = _QUEUE
    ) -> None:
        self._read, self._write, self._most = read, write, most_waiting
        self._waiting = bytearray()

    def receive(self) -> tuple[bytes, bool]:
        """Return the bytes that came, and whether the other end is gone."""
        out = bytearray()
        try:
            self.flush()
            for _ in range(READS):
                block = self._read(READ_BYTES)
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
        if len(self._waiting) + len(data) <= self._most:
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


class TcpServer(Port):
    """Waits for calls and serves several at once."""

    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        family, address = resolve(endpoint, socket.SOCK_STREAM, where)
        self._server = socket.socket(family, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._server.setblocking(False)
        bind(self._server, address, endpoint, where)
        self._server.listen(8)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._streams: OrderedDict[Peer, tuple[socket.socket, Stream]] = OrderedDict()

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
            peer = Peer(str(self.endpoint), text_of_address(address))
            self._streams[peer] = (connection, Stream(connection.recv, connection.send))
            self._notices.append(f"{self.endpoint}: {peer.address} has called")

    def _drop(self, peer: Peer) -> None:
        connection, _ = self._streams.pop(peer)
        self._selector.unregister(connection)
        connection.close()
        self._notices.append(f"{self.endpoint}: {peer.address} has hung up")


class Caller(Port):
    """A connection that is made again whenever it breaks: to a TCP server, or to a serial device."""

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._peer = Peer(str(endpoint), f"{endpoint.host}:{endpoint.port}")
        self._line: Any = None
        self._stream: Stream | None = None
        self._retry_s = -RETRY_S

    @abstractmethod
    def _open(self) -> None:
        """Try to connect; raises OSError. Sets the line, and the stream once it stands."""

    @property
    def peers(self) -> list[Peer]:
        return [] if self._stream is None else [self._peer]

    @property
    def targets(self) -> list[Peer]:
        return self.peers

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

    def _up(self, stream: Stream) -> None:
        self._stream = stream
        self._say("connected")

    def _lose(self, why: str) -> None:
        if self._line is not None:
            with contextlib.suppress(KeyError, ValueError):
                self._selector.unregister(self._line)
            self._line.close()
        self._line = self._stream = None
        self._say(why)


class TcpClient(Caller):
    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        self._family, self._address = resolve(endpoint, socket.SOCK_STREAM, where)

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
        self._up(Stream(self._line.recv, self._line.send))


class SerialPort(Caller):
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
            data = line.read(min(size, _SERIAL_BLOCK))
            if not data:
                raise BlockingIOError
            return bytes(data)

        def write(data: bytearray) -> int:
            # pyserial would go round and round on a full line; the system says so at once.
            return os.write(line.fileno(), data) if os.name == "posix" else line.write(data) or 0

        # Ten bits to a byte; what would be older than this when it leaves is better not sent.
        self._up(Stream(read, write, max(600, round(_SERIAL_LAG_S * self.endpoint.port / 10))))


def _prepare(line: socket.socket) -> None:
    line.setblocking(False)
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _exclusive() -> bool | None:
    return True if os.name == "posix" else None
