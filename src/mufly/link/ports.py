"""Sockets and serial lines, as ports that never block and never raise into the loop that serves them.

Every port has a few peers; bytes come from a peer and go to one. A cable that is pulled, a peer that vanishes or a
full buffer costs frames, which MAVLink is made to bear, but never parts of one: what is handed to :meth:`Port.send`
goes out as a whole or not at all. What a user should know of (a call that fails, a device that is gone) is said once,
until it changes.
"""

from __future__ import annotations

import selectors
import time
from collections.abc import Iterable

from mufly.link.endpoint import Endpoint
from mufly.link.port import PEERS, Peer, Port
from mufly.link.port_stream import RETRY_S, SerialPort, TcpClient, TcpServer
from mufly.link.port_udp import UdpPort

__all__ = ["PEERS", "RETRY_S", "Peer", "Port", "open_port", "wait"]


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
        return UdpPort(endpoint, where)
    if endpoint.kind == "tcpin":
        return TcpServer(endpoint, where)
    if endpoint.kind == "tcp":
        return TcpClient(endpoint, where)
    return SerialPort(endpoint)


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
