"""Where the other end of a link is: ``udp:127.0.0.1:14550``, ``serial:/dev/ttyUSB0:57600`` and their like.

Programs for MAVLink have settled on these words (pymavlink, MAVProxy, MAVSDK): ``udpin`` and ``tcpin`` listen,
``udpout`` and ``tcp`` call. Plain ``udp`` is what each side does by custom: a vehicle sends to the address, where
ground stations wait for it; a station listens there.
"""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass
from typing import Literal

from mufly.errors import InputError

__all__ = ["Endpoint", "Kind", "parse_endpoint"]

Kind = Literal["udpin", "udpout", "tcp", "tcpin", "serial"]
_KINDS: tuple[Kind, ...] = ("udpin", "udpout", "tcp", "tcpin", "serial")
_EXAMPLES = (
    "write for example udp:127.0.0.1:14550, udpin:0.0.0.0:14550, udpout:192.168.0.7:14550, tcp:127.0.0.1:5760, "
    "tcpin:127.0.0.1:5760, udp:[::1]:14550 or serial:/dev/ttyUSB0:57600"
)
_BAUD = 57_600  # the custom of telemetry radios
_HOST_PORT = re.compile(r"(?:(?P<host>\[[^\]]*\]|[^:\[\]]*):)?(?P<port>[^:]*)")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a link.

    Attributes
    ----------
    kind : str
        ``"udpin"``, ``"udpout"``, ``"tcp"`` (calls), ``"tcpin"`` (listens) or ``"serial"``.
    host : str
        Name or address without brackets; the device of a serial link.
    port : int
        Number of the port; the baud rate of a serial link.
    """

    kind: Kind
    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host and self.kind != "serial" else self.host
        return f"{self.kind}:{host}:{self.port}"

    @property
    def listens(self) -> bool:
        """Whether it waits for others to call."""
        return self.kind in ("udpin", "tcpin")

    @property
    def beyond_loopback(self) -> bool:
        """Whether it listens where other machines can reach it."""
        if not self.listens or self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True

    @property
    def explanation(self) -> str:
        """What it does, in words: "sends to 127.0.0.1 port 14550 (UDP)"."""
        if self.kind == "serial":
            return f"speaks over {self.host} at {self.port} baud"
        place = f"{self.host} port {self.port}"
        return {
            "udpin": f"listens at {place} (UDP)",
            "udpout": f"sends to {place} (UDP)",
            "tcp": f"calls {place} (TCP)",
            "tcpin": f"waits for calls at {place} (TCP)",
        }[self.kind]


def parse_endpoint(
    text: str, role: Literal["vehicle", "station"], where: str = "--link", least_port: int = 1
) -> Endpoint:
    """Read an endpoint.

    Parameters
    ----------
    text : str
        ``KIND:HOST:PORT`` or ``serial:DEVICE[:BAUD]``; HOST left out means this machine, an IPv6 address stands in
        brackets.
    role : str
        Who asks: what plain ``udp`` means depends on it.
    where : str
        Option or file that holds the text, for the message of an error.
    least_port : int
        0 lets a listening endpoint take any free port (tests).

    Raises
    ------
    InputError
        If it is none.
    """
    word, colon, rest = text.strip().partition(":")
    kind = ("udpout" if role == "vehicle" else "udpin") if word.lower() == "udp" else word.lower()
    if kind not in _KINDS or not colon:
        raise InputError(where, "", f"{text!r} is no MAVLink endpoint", _EXAMPLES)
    if kind == "serial":
        return _serial(text, rest, where)
    found = _HOST_PORT.fullmatch(rest)
    if found is None:
        remedy = (
            "put an IPv6 address in brackets, as in udp:[::1]:14550" if rest.count(":") > 1 else _EXAMPLES
        )
        raise InputError(where, "", f"{text!r} has no host and port that can be told apart", remedy)
    number = found["port"]
    if not (number.isascii() and number.isdigit()) or not least_port <= int(number) <= 65535:
        raise InputError(where, "", f"{text!r}: port {number!r} is no number from 1 to 65535", _EXAMPLES)
    given = found["host"] or "127.0.0.1"
    host = given.strip("[]")
    if given.startswith("["):
        try:
            ipaddress.ip_address(host.partition("%")[0])
        except ValueError:
            raise InputError(where, "", f"{text!r}: {host!r} is no IPv6 address", _EXAMPLES) from None
    return Endpoint(kind, host, int(number))


def _serial(text: str, rest: str, where: str) -> Endpoint:
    device, colon, baud = rest.rpartition(":")
    # Names of devices may hold colons themselves (/dev/serial/by-path/pci-0000:00:14.0-usb-0:1).
    if not colon or not (baud.isascii() and baud.isdigit()):
        device, baud = rest, str(_BAUD)
    if not device:
        raise InputError(
            where, "", f"{text!r} names no device", "write for example serial:/dev/ttyUSB0:57600"
        )
    if not 300 <= int(baud) <= 12_000_000:
        raise InputError(
            where, "", f"{text!r}: {baud} is no baud rate", "write for example serial:/dev/ttyUSB0:57600"
        )
    return Endpoint("serial", device, int(baud))
