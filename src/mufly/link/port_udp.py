"""Datagrams: to one address, or to whoever was heard."""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
from collections import OrderedDict
from typing import Any

from mufly.link.endpoint import Endpoint
from mufly.link.port import PEERS, READ_BYTES, READS, Peer, Port, bind, resolve, text_of_address

__all__ = ["UdpPort"]

_RECEIVE_BUFFER = 1 << 20
_LATER = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR, errno.ENOBUFS, errno.ECONNREFUSED}


class UdpPort(Port):
    """Datagrams, to one address or to whoever was heard."""

    def __init__(self, endpoint: Endpoint, where: str) -> None:
        super().__init__(endpoint)
        family, address = resolve(endpoint, socket.SOCK_DGRAM, where)
        self._target = Peer(str(endpoint), text_of_address(address))
        self._addresses: OrderedDict[Peer, Any] = OrderedDict()
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        for option in (socket.SO_RCVBUF, socket.SO_BROADCAST):
            with contextlib.suppress(OSError):
                self._socket.setsockopt(
                    socket.SOL_SOCKET, option, _RECEIVE_BUFFER if option == socket.SO_RCVBUF else 1
                )
        if endpoint.listens:
            bind(self._socket, address, endpoint, where)
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

    @property
    def targets(self) -> list[Peer]:
        return [] if self.endpoint.listens else [self._target]

    def receive(self) -> list[tuple[Peer, bytes]]:
        out = []
        for _ in range(READS):
            try:
                data, address = self._socket.recvfrom(READ_BYTES)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an earlier datagram found nobody there: its sender is told here
                continue
            peer = Peer(str(self.endpoint), text_of_address(address))
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
                    if error.errno not in _LATER:
                        self._say(f"cannot send to {name.address} ({error.strerror or error})")
