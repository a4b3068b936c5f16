"""Where the page is served: host, port and token, chosen and bound before anything heavy is loaded."""

from __future__ import annotations

import socket

from mufly.errors import InputError
from mufly.station.page.guard import is_loopback, new_token

__all__ = ["Address", "choose_address"]

PORT = 8080
PORTS_TRIED = 40


class Address:
    """Where the page is: a bound socket, its host, port and token."""

    def __init__(self, bound: socket.socket, host: str, token: str) -> None:
        self.socket, self.host, self.token = bound, host, token
        self.port = int(bound.getsockname()[1])

    @property
    def url(self) -> str:
        """What to open; the token is in it, once, where one is needed."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::", "") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")


def choose_address(host: str = "127.0.0.1", port: int | None = None, token: str | None = None) -> Address:
    """Bind the page's port.

    Parameters
    ----------
    host : str
        Any other than loopback needs a token; one is made if none is given.
    port : int, optional
        Default: 8080, or the next one that is free.
    token : str, optional

    Raises
    ------
    InputError
        If the address is none of this machine, or the port that was asked for is taken.
    """
    if token is not None and len(token) < 8:
        raise InputError(
            "--token", "", "is shorter than 8 characters", "give a longer one, or none to have one made"
        )
    secret = token or ("" if is_loopback(host) else new_token())
    tried = [port] if port is not None else [*range(PORT, PORT + PORTS_TRIED), 0]
    try:
        family, _, _, _, _ = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InputError(
            "--host", host, f"is no address ({error.strerror})", "give an address of this machine"
        ) from None
    for number in tried:
        bound = socket.socket(family, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((host, number))
            bound.listen(128)
        except OSError as error:
            bound.close()
            if number == tried[-1]:
                what = "--port" if port is not None else "--host"
                problem = f"cannot listen on {host}:{number} ({error.strerror})"
                raise InputError(what, "", problem, "give another one, or leave it out") from None
            continue
        bound.setblocking(False)
        return Address(bound, host, secret)
    raise AssertionError("a port was tried")
