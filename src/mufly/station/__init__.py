"""Who watches? The ground station: what it knows of a vehicle, what it asks of it, and its page."""

from mufly.flight.parameters import Parameter
from mufly.station.ground import GroundLink, Station
from mufly.station.history import History
from mufly.station.recorder import StationRecorder
from mufly.station.remote import RemoteVehicle
from mufly.station.view import Check, Message, MissionRow, Outcome, Request, Snapshot

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
