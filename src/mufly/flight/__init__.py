"""All of it at once: the flight software, the closed loop, the recorder, pictures and numbers of a flight."""

from mufly.flight.autopilot import Autopilot
from mufly.flight.controllers import Actuators, Controllers, able
from mufly.flight.flight import ALIGNED_WITHIN_S, Flight, Progress, fly
from mufly.flight.parameters import Parameter
from mufly.flight.plant import Demand, Plant, respond
from mufly.flight.record.estimate_pictures import draw_belief, draw_checks, draw_estimate
from mufly.flight.record.pictures import draw_flight
from mufly.flight.record.recorder import Recorder
from mufly.flight.record.sensor_log import (
    ReadingErrors,
    SensorLog,
    draw_sensors,
    listen,
    reading_errors,
    write_sensor_logs,
)
from mufly.flight.record.summary import Summary, summarise, summary_rows
from mufly.flight.sensed import believed, is_sensed, readings_of, replay, truths_of
from mufly.flight.software import FlightSoftware
from mufly.flight.state import FlightState
from mufly.logs.mcap import Event, events_of, standard_layout, to_csv
from mufly.logs.recording import read_attachments, read_recording
from mufly.mission import Answer, SetPoint

__all__ = [
    "ALIGNED_WITHIN_S",
    "Actuators",
    "Answer",
    "Autopilot",
    "Controllers",
    "Demand",
    "Event",
    "Flight",
    "FlightSoftware",
    "FlightState",
    "Parameter",
    "Plant",
    "Progress",
    "ReadingErrors",
    "Recorder",
    "SensorLog",
    "SetPoint",
    "Summary",
    "able",
    "believed",
    "draw_belief",
    "draw_checks",
    "draw_estimate",
    "draw_flight",
    "draw_sensors",
    "events_of",
    "fly",
    "is_sensed",
    "listen",
    "read_attachments",
    "read_recording",
    "reading_errors",
    "readings_of",
    "replay",
    "respond",
    "standard_layout",
    "summarise",
    "summary_rows",
    "to_csv",
    "truths_of",
    "write_sensor_logs",
]
