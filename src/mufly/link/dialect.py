"""The MAVLink dialect that both ends of the link speak: ``common``, in the second version of the wire format.

pymavlink decides by an environment variable, when it is first imported, which wire format it packs; so it is imported
here and nowhere else in this room. Source of every message, field and enumeration: https://mavlink.io/en/messages/common.html
"""

from __future__ import annotations

import contextlib
import io
import math
import os
from typing import Any

os.environ["MAVLINK20"] = "1"
with contextlib.redirect_stdout(io.StringIO()):
    from pymavlink.dialects.v20 import common as mavlink

__all__ = [
    "FLOAT_MOST",
    "MavMessage",
    "MavlinkError",
    "mavlink",
    "message_name",
    "single",
    "text_of",
    "within",
]

MavMessage = Any
"""A message of pymavlink (``mavlink.MAVLink_message``), which carries no types worth checking."""
MavlinkError: type[Exception] = mavlink.MAVError

FLOAT_MOST = 3.4028234663852886e38
"""The largest number that a ``float`` field can hold."""


def single(value: float) -> float:
    """Return ``value`` as a ``float`` field can hold it: beyond its range it is not known (NaN)."""
    return float(value) if abs(value) <= FLOAT_MOST else math.nan


def within(value: float, least: int, greatest: int, unknown: int = 0) -> int:
    """Return ``value`` rounded and held within the bounds of an integer field; ``unknown`` if it is no number."""
    if not math.isfinite(value):
        return unknown
    return int(min(max(round(value), least), greatest))


def message_name(number: int) -> str:
    """Return the name of the message with an id, or ``"message 1234"`` if this dialect has none."""
    kind = mavlink.mavlink_map.get(number)
    return str(kind.msgname) if kind is not None else f"message {number}"


def text_of(text: str, size: int = 50) -> bytes:
    """Return ``text`` as a ``char[size]`` field takes it: UTF-8, never cut inside a character."""
    return text.encode(errors="replace")[:size].decode(errors="ignore").encode()
