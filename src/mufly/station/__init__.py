"""The ground station: telemetry of vehicles, requests to them, recordings, and the operator's page.

Attributes of the package load on first use, so that the page's address and start page appear before the flight
software is loaded.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mufly.flight.tunable_parameters import TunableParameter
    from mufly.station.ground_station import GroundLink, GroundStation
    from mufly.station.remote.remote_vehicle import RemoteVehicle
    from mufly.station.signal_history import (
        MissionRow,
        OperatorRequest,
        PreflightCheck,
        RequestOutcome,
        SignalHistory,
        StatusMessage,
        VehicleSnapshot,
    )
    from mufly.station.station_recorder import StationRecorder

_NAMES_BY_MODULE = {
    "mufly.flight.tunable_parameters": ("TunableParameter",),
    "mufly.station.ground_station": ("GroundLink", "GroundStation"),
    "mufly.station.signal_history": (
        "PreflightCheck",
        "SignalHistory",
        "StatusMessage",
        "MissionRow",
        "RequestOutcome",
        "OperatorRequest",
        "VehicleSnapshot",
    ),
    "mufly.station.station_recorder": ("StationRecorder",),
    "mufly.station.remote.remote_vehicle": ("RemoteVehicle",),
}
__all__ = [
    "GroundLink",
    "GroundStation",
    "MissionRow",
    "OperatorRequest",
    "PreflightCheck",
    "RemoteVehicle",
    "RequestOutcome",
    "SignalHistory",
    "StationRecorder",
    "StatusMessage",
    "TunableParameter",
    "VehicleSnapshot",
]


def __getattr__(name: str) -> Any:
    for home, names in _NAMES_BY_MODULE.items():
        if name in names:
            return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module 'mufly.station' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
