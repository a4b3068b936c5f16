"""Who watches? The ground station: what it knows of a vehicle, what it asks of it, and its page."""

from mufly.flight.parameters import Parameter
from mufly.station.ground import GroundLink, Station
from mufly.station.history import Check, History, Message, MissionRow, Outcome, Request, Snapshot
from mufly.station.recorder import StationRecorder
from mufly.station.remote import RemoteVehicle

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
