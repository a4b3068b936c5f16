"""How is it held? H-infinity design, analysis, order reduction, discretisation and the control law on board."""

from mufly.control.designs import DEFAULT_RATE_HZ, Design, FlightController, design
from mufly.control.hinf import HinfResult, close_loop, hinfsyn
from mufly.control.implementation import (
    Candidate,
    DiscreteController,
    Reduction,
    discretise,
    reduce_controller,
)
from mufly.control.law import (
    heave_wait,
    heave_yaw_initial,
    heave_yaw_step,
    position_initial,
    position_step,
    roll_pitch_initial,
    roll_pitch_step,
)
from mufly.control.linear import (
    LoopAnalysis,
    LoopCurves,
    analyse,
    connect,
    frequency_response,
    hinf_norm,
    loop_curves,
    sample_plant,
    singular_values,
)
from mufly.control.schemes import (
    OneDegreeWeights,
    Scaling,
    Settings,
    TransferFunction,
    TwoDegreeWeights,
    one_degree_plant,
    two_degree_plant,
)

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
