"""Identification of vehicle parameters from bench and flight data, with uncertainty and validation."""

from mufly.identify import fit_pictures as _fit_pictures  # noqa: F401  draws results of the room
from mufly.identify.fit_report import ReportSection, write_fit_report
from mufly.identify.fit_result import FitResult, ParameterEstimate, RecordPrediction, apply_estimates
from mufly.identify.flight.excitation_plan import ExcitationPlan, FlightLimits, design_excitation
from mufly.identify.flight.excitation_signals import ExcitationSignal, make_excitation
from mufly.identify.flight.flight_fit import fit_dynamics_parts_separately, fit_flight_records
from mufly.identify.flight.free_parameters import FreeParameter, choose_free_parameters
from mufly.identify.flight.identification_demo import IdentificationDemo, run_identification_demo
from mufly.identify.flight.input_polarity import check_flight_records
from mufly.identify.flight.staged_search import FitProgress
from mufly.identify.flight_record import FlightRecord, UniformLogTable, make_flight_record, read_columns, split_record
from mufly.identify.linear import response_pictures as _response_pictures  # noqa: F401  draws results of the room
from mufly.identify.linear.linear_fit import LinearFit
from mufly.identify.linear.linear_identification import LinearResult, identify_linear_model
from mufly.identify.motor_fit import GearKnowledge, MotorFit, fit_motor
from mufly.identify.record_consistency import require_consistent_record
from mufly.identify.residual_analysis import (
    PredictionQuality,
    assess_prediction,
    assess_record_predictions,
    describe_model_deficiencies,
)
from mufly.identify.rotor_coefficients import RotorCoefficientFit, fit_rotor_coefficients

__all__ = [
    "ExcitationPlan",
    "ExcitationSignal",
    "FitProgress",
    "FitResult",
    "FlightLimits",
    "FlightRecord",
    "FreeParameter",
    "GearKnowledge",
    "IdentificationDemo",
    "LinearFit",
    "LinearResult",
    "MotorFit",
    "ParameterEstimate",
    "PredictionQuality",
    "RecordPrediction",
    "ReportSection",
    "RotorCoefficientFit",
    "UniformLogTable",
    "apply_estimates",
    "assess_prediction",
    "assess_record_predictions",
    "check_flight_records",
    "choose_free_parameters",
    "describe_model_deficiencies",
    "design_excitation",
    "fit_dynamics_parts_separately",
    "fit_flight_records",
    "fit_motor",
    "fit_rotor_coefficients",
    "identify_linear_model",
    "make_excitation",
    "make_flight_record",
    "read_columns",
    "require_consistent_record",
    "run_identification_demo",
    "split_record",
    "write_fit_report",
]
