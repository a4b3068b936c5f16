"""Simulated flights: flight software, closed loop, recorder, pictures and summary."""

from mufly.flight.autopilot import Autopilot
from mufly.flight.controllers import Actuators, Controllers, derive_trajectory_limits
from mufly.flight.flight_software import FlightSoftware
from mufly.flight.flight_state import FlightState
from mufly.flight.mission_flight import ALIGNMENT_TIMEOUT_S, FlightProgress, fly_mission
from mufly.flight.record.estimate_pictures import draw_estimate, draw_estimate_pictures, draw_sensor_innovations
from mufly.flight.record.flight_pictures import draw_flight_pictures
from mufly.flight.record.flight_summary import FlightSummary, summarise_flight, summary_rows
from mufly.flight.record.recorder import FlightRecorder
from mufly.flight.record.sensor_log import (
    ReadingErrors,
    ReadingLog,
    compute_reading_errors,
    draw_sensor_readings,
    fly_and_log_sensors,
    write_sensor_logs,
)
from mufly.flight.record.sensor_recording import (
    has_sensor_readings,
    iterate_readings_and_inputs,
    list_truths,
    replace_estimates,
    replay_estimator,
)
from mufly.flight.simulated_flight import Flight
from mufly.flight.simulated_plant import ControllerReference, SimulatedPlant, simulate_controller_response
from mufly.flight.tunable_parameters import TunableParameter
from mufly.logs.mcap import FlightEvent, make_flight_row_layout, read_events, write_recording_csv
from mufly.logs.mcap_recording import read_attachments, read_recording
from mufly.mission import RequestAnswer, SetPoint

__all__ = [
    "ALIGNMENT_TIMEOUT_S",
    "Actuators",
    "Autopilot",
    "ControllerReference",
    "Controllers",
    "Flight",
    "FlightEvent",
    "FlightProgress",
    "FlightRecorder",
    "FlightSoftware",
    "FlightState",
    "FlightSummary",
    "ReadingErrors",
    "ReadingLog",
    "RequestAnswer",
    "SetPoint",
    "SimulatedPlant",
    "TunableParameter",
    "compute_reading_errors",
    "derive_trajectory_limits",
    "draw_estimate",
    "draw_estimate_pictures",
    "draw_flight_pictures",
    "draw_sensor_innovations",
    "draw_sensor_readings",
    "fly_and_log_sensors",
    "fly_mission",
    "has_sensor_readings",
    "iterate_readings_and_inputs",
    "list_truths",
    "make_flight_row_layout",
    "read_attachments",
    "read_events",
    "read_recording",
    "replace_estimates",
    "replay_estimator",
    "simulate_controller_response",
    "summarise_flight",
    "summary_rows",
    "write_recording_csv",
    "write_sensor_logs",
]
