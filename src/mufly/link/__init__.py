"""Who speaks with whom? MAVLink, both ends of it, as protocol machines with sockets at the edge."""

from mufly.link.codec import Codec, Counts, Encoder, Outgoing
from mufly.link.endpoint import Endpoint, parse_endpoint
from mufly.link.geodesy import Origin, parse_origin
from mufly.link.missions import Plan, Refusal, items_of, plan_of
from mufly.link.modes import Mode, custom_mode, mode_of, mode_of_custom
from mufly.link.ports import Peer, Port, open_port, wait
from mufly.link.process import VehicleProcess, start_vehicle
from mufly.link.runner import Report, run
from mufly.link.tlog import TlogWriter
from mufly.link.vehicle import VehicleLink

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
