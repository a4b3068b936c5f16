"""What are its parameters? Fits to bench and flight data, with uncertainty and validation."""

from mufly.identify.demo import Demo, run_demo
from mufly.identify.excitation import Excitation, excitation
from mufly.identify.fit import Progress, fit_flights
from mufly.identify.free import Free, choose_free
from mufly.identify.linear import identify_linear
from mufly.identify.linear_columns import Columns, read_columns
from mufly.identify.linear_result import LinearFit, LinearResult
from mufly.identify.missing import what_is_missing
from mufly.identify.motor import GearKnowledge, MotorFit, fit_motor
from mufly.identify.plan import Limits, Plan, design
from mufly.identify.record import Record, record_from, split
from mufly.identify.record_check import check_record
from mufly.identify.report import Section, write_report
from mufly.identify.residuals import Quality, qualities, quality
from mufly.identify.result import Estimate, Fit, RecordFit
from mufly.identify.rotor_fit import RotorFit
from mufly.identify.split_fit import fit_split
from mufly.identify.static_rotor import fit_rotor
from mufly.identify.written import with_estimates

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
