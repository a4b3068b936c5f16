"""All of it at once: the flight software, the closed loop, the recorder, pictures and numbers of a flight."""

from mufly.flight.controllers import Actuators, Controllers
from mufly.flight.loop import Progress, fly
from mufly.flight.pictures import draw_flight
from mufly.flight.recorder import Recorder
from mufly.flight.response import Setpoint, respond
from mufly.flight.software import FlightSoftware
from mufly.flight.summary import Summary, summarise, summary_rows
from mufly.logs.layout import Event, standard_layout
from mufly.logs.recording import events_of, read_attachments, read_recording, to_csv

__all__ = [
    "Actuators",
    "Controllers",
    "Event",
    "FlightSoftware",
    "Progress",
    "Recorder",
    "Setpoint",
    "Summary",
    "draw_flight",
    "events_of",
    "fly",
    "read_attachments",
    "read_recording",
    "respond",
    "standard_layout",
    "summarise",
    "summary_rows",
    "to_csv",
]
