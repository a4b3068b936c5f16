"""Free ports for tests."""

import random
import socket

LOWEST, HIGHEST = 20_000, 32_000
"""Ports below those that Linux gives to sockets without a port of their own, so that none takes a probed port."""


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """Return a port of 127.0.0.1 that no socket of this kind uses now."""
    while True:
        port = random.SystemRandom().randint(LOWEST, HIGHEST)
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
