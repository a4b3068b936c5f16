"""What are its parameters? Fits to bench and flight data, with uncertainty and validation."""

from mufly.identify.demo import Demo, run_demo
from mufly.identify.fit import Progress, fit_flights
from mufly.identify.free import Free, choose_free
from mufly.identify.record import Record, check_record, record_from, split
from mufly.identify.result import Estimate, Fit, RecordFit
from mufly.identify.split_fit import fit_split
from mufly.identify.written import with_estimates

__all__ = [
    "Demo",
    "Estimate",
    "Fit",
    "Free",
    "Progress",
    "Record",
    "RecordFit",
    "check_record",
    "choose_free",
    "fit_flights",
    "fit_split",
    "record_from",
    "run_demo",
    "split",
    "with_estimates",
]
