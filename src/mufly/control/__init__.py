"""How is it held? H-infinity design, analysis, order reduction, discretisation and the control law on board."""

from mufly.control.analysis import LoopAnalysis, LoopCurves, analyse, loop_curves, sample_plant
from mufly.control.design import DEFAULT_RATE_HZ, design
from mufly.control.discretise import DiscreteController, discretise
from mufly.control.engage import heave_yaw_initial, position_initial, roll_pitch_initial
from mufly.control.hinf import HinfResult, close_loop, hinfsyn
from mufly.control.law import heave_wait, heave_yaw_step, position_step, roll_pitch_step
from mufly.control.linear import connect, frequency_response, hinf_norm, singular_values
from mufly.control.reduction import Candidate, Reduction, reduce_controller
from mufly.control.result import Design, FlightController
from mufly.control.schemes import (
    OneDegreeWeights,
    Scaling,
    TransferFunction,
    TwoDegreeWeights,
    one_degree_plant,
    two_degree_plant,
)
from mufly.control.settings import Settings

__all__ = [
    "DEFAULT_RATE_HZ",
    "Candidate",
    "Design",
    "DiscreteController",
    "FlightController",
    "HinfResult",
    "LoopAnalysis",
    "LoopCurves",
    "OneDegreeWeights",
    "Reduction",
    "Scaling",
    "Settings",
    "TransferFunction",
    "TwoDegreeWeights",
    "analyse",
    "close_loop",
    "connect",
    "design",
    "discretise",
    "frequency_response",
    "heave_wait",
    "heave_yaw_initial",
    "heave_yaw_step",
    "hinf_norm",
    "hinfsyn",
    "loop_curves",
    "one_degree_plant",
    "position_initial",
    "position_step",
    "reduce_controller",
    "roll_pitch_initial",
    "roll_pitch_step",
    "sample_plant",
    "singular_values",
    "two_degree_plant",
]
