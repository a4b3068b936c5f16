"""Who speaks with whom? MAVLink, both ends of it, as protocol machines with sockets at the edge."""

from mufly.link.authority import Authority
from mufly.link.clients import Source
from mufly.link.codec import Codec, Counts, Encoder, MavMessage, Outgoing, TextPieces, Texts, mavlink
from mufly.link.commands import COMMANDS, MESSAGE_REQUESTS, Command, command_of
from mufly.link.conventions import Mode, Origin, custom_mode, mode_of, mode_of_custom, parse_origin
from mufly.link.mission_transfer import (
    GIVE_UP_S,
    Ack,
    ClearAll,
    Count,
    Item,
    MissionResult,
    Note,
    Notes,
    Receiver,
    RequestItem,
    RequestList,
    Sender,
    note_of,
    to_mavlink,
)
from mufly.link.missions import Plan, Refusal, items_of, plan_of
from mufly.link.parameters import LINK_PARAMETERS, WHOLE_RANGE, decoded, encoded
from mufly.link.ports import Endpoint, Peer, Port, open_port, parse_endpoint, wait
from mufly.link.process import Report, VehicleProcess, run, start_vehicle, warm_up
from mufly.link.telemetry import STATES, STREAMS, Instant
from mufly.link.vehicle import VehicleLink
from mufly.logs.tlog import TlogWriter

__all__ = [
    "COMMANDS",
    "GIVE_UP_S",
    "LINK_PARAMETERS",
    "MESSAGE_REQUESTS",
    "STATES",
    "STREAMS",
    "WHOLE_RANGE",
    "Ack",
    "Authority",
    "ClearAll",
    "Codec",
    "Command",
    "Count",
    "Counts",
    "Encoder",
    "Endpoint",
    "Instant",
    "Item",
    "MavMessage",
    "MissionResult",
    "Mode",
    "Note",
    "Notes",
    "Origin",
    "Outgoing",
    "Peer",
    "Plan",
    "Port",
    "Receiver",
    "Refusal",
    "Report",
    "RequestItem",
    "RequestList",
    "Sender",
    "Source",
    "TextPieces",
    "Texts",
    "TlogWriter",
    "VehicleLink",
    "VehicleProcess",
    "command_of",
    "custom_mode",
    "decoded",
    "encoded",
    "items_of",
    "mavlink",
    "mode_of",
    "mode_of_custom",
    "note_of",
    "open_port",
    "parse_endpoint",
    "parse_origin",
    "plan_of",
    "run",
    "start_vehicle",
    "to_mavlink",
    "wait",
    "warm_up",
]
