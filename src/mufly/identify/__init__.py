"""What are its parameters? Fits to bench and flight data, with uncertainty and validation."""

from mufly.identify.consistency import check_record
from mufly.identify.flight.demo import Demo, run_demo
from mufly.identify.flight.fit import fit_flights, fit_split
from mufly.identify.flight.free import Free, choose_free
from mufly.identify.flight.plan import Limits, Plan, design
from mufly.identify.flight.polarity import check_flights
from mufly.identify.flight.search import Progress
from mufly.identify.flight.signals import Excitation, excitation
from mufly.identify.linear.fit import LinearFit
from mufly.identify.linear.identification import LinearResult, identify_linear
from mufly.identify.motor import GearKnowledge, MotorFit, fit_motor
from mufly.identify.record import Columns, Record, read_columns, record_from, split
from mufly.identify.report import Section, write_report
from mufly.identify.residuals import Quality, qualities, quality, what_is_missing
from mufly.identify.result import Estimate, Fit, RecordFit, with_estimates
from mufly.identify.rotor import RotorFit, fit_rotor

__all__ = [
    "Columns",
    "Demo",
    "Estimate",
    "Excitation",
    "Fit",
    "Free",
    "GearKnowledge",
    "Limits",
    "LinearFit",
    "LinearResult",
    "MotorFit",
    "Plan",
    "Progress",
    "Quality",
    "Record",
    "RecordFit",
    "RotorFit",
    "Section",
    "check_flights",
    "check_record",
    "choose_free",
    "design",
    "excitation",
    "fit_flights",
    "fit_motor",
    "fit_rotor",
    "fit_split",
    "identify_linear",
    "qualities",
    "quality",
    "read_columns",
    "record_from",
    "run_demo",
    "split",
    "what_is_missing",
    "with_estimates",
    "write_report",
]
