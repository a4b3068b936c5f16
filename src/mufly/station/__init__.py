"""Who watches? The ground station: what it knows of a vehicle, what it asks of it, and its page.

What the room offers loads on first use: the address of the page and what it shows while the rest loads are here before
the flight software is.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mufly.flight.parameters import Parameter
    from mufly.station.ground import GroundLink, Station
    from mufly.station.history import Check, History, Message, MissionRow, Outcome, Request, Snapshot
    from mufly.station.recorder import StationRecorder
    from mufly.station.remote import RemoteVehicle

_HOMES = {
    "mufly.flight.parameters": ("Parameter",),
    "mufly.station.ground": ("GroundLink", "Station"),
    "mufly.station.history": ("Check", "History", "Message", "MissionRow", "Outcome", "Request", "Snapshot"),
    "mufly.station.recorder": ("StationRecorder",),
    "mufly.station.remote": ("RemoteVehicle",),
}
__all__ = [
    "Check",
    "GroundLink",
    "History",
    "Message",
    "MissionRow",
    "Outcome",
    "Parameter",
    "RemoteVehicle",
    "Request",
    "Snapshot",
    "Station",
    "StationRecorder",
]


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module 'mufly.station' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
