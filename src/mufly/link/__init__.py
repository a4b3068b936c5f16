"""Who speaks with whom? MAVLink, both ends of it, as protocol machines with sockets at the edge."""

from mufly.link.codec import Codec, Counts, Encoder, Outgoing
from mufly.link.conventions import Mode, Origin, custom_mode, mode_of, mode_of_custom, parse_origin
from mufly.link.missions import Plan, Refusal, items_of, plan_of
from mufly.link.ports import Endpoint, Peer, Port, open_port, parse_endpoint, wait
from mufly.link.process import Report, VehicleProcess, run, start_vehicle
from mufly.link.vehicle import VehicleLink
from mufly.logs.tlog import TlogWriter

__all__ = [
    "Codec",
    "Counts",
    "Encoder",
    "Endpoint",
    "Mode",
    "Origin",
    "Outgoing",
    "Peer",
    "Plan",
    "Port",
    "Refusal",
    "Report",
    "TlogWriter",
    "VehicleLink",
    "VehicleProcess",
    "custom_mode",
    "items_of",
    "mode_of",
    "mode_of_custom",
    "open_port",
    "parse_endpoint",
    "parse_origin",
    "plan_of",
    "run",
    "start_vehicle",
    "wait",
]
