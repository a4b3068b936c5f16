"""What every port is: a few peers, bytes from them and to them, never blocking, never raising into the loop."""

from __future__ import annotations

import selectors
import socket
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

from mufly.errors import InputError
from mufly.link.endpoint import Endpoint

__all__ = ["PEERS", "READS", "READ_BYTES", "Peer", "Port", "bind", "resolve", "text_of_address"]

PEERS = 32
"""So many peers a listening port serves; the one that was silent for longest makes room."""
READS, READ_BYTES = 256, 65_536
"""Datagrams or blocks taken in one call, and the greatest size of one (bytes)."""


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

    @property
    def targets(self) -> list[Peer]:
        """Those of its peers whom it was told to call, and has, if they can be called."""
        return []

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


def resolve(endpoint: Endpoint, kind: int, where: str) -> tuple[int, Any]:
    try:
        found = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)
    except (OSError, UnicodeError) as error:
        raise InputError(
            where, "", f"host {endpoint.host!r} of {endpoint} is not known ({error})", "give its address"
        ) from error
    # IPv4 first: the other end of a link that says "localhost" is an old program more often than a new one.
    family, _, _, _, address = min(found, key=lambda f: f[0] != socket.AF_INET)
    return family, address


def bind(line: socket.socket, address: Any, endpoint: Endpoint, where: str) -> None:
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


def text_of_address(address: Any) -> str:
    host, port = address[0], address[1]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
