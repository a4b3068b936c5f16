"""Controllers: design by several methods, analysis, order reduction, discretisation and the control law on board."""

from mufly.control.analysis import plots as _plots  # noqa: F401  draws results of the room
from mufly.control.analysis.loop_margins import DiskMargin, compute_input_noise_std, disk_margin
from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import DEFAULT_CONTROL_RATE_HZ, FlightController, design_flight_controller
from mufly.control.implementation import (
    ControllerReduction,
    DiscreteController,
    ReducedCandidate,
    discretise_controller,
    reduce_controller,
)
from mufly.control.law import (
    heave_yaw_init,
    heave_yaw_step,
    limit_heave_reference,
    position_init,
    position_step,
    roll_pitch_init,
    roll_pitch_step,
)
from mufly.control.linear_systems import (
    LoopAnalysis,
    LoopCurves,
    analyse_loop,
    compute_loop_singular_values,
    connect_blocks,
    frequency_response,
    hinf_norm,
    sample_plant,
    singular_values,
)
from mufly.control.synthesis.h2 import H2Result, h2_norm, h2syn
from mufly.control.synthesis.hinf import HinfResult, compute_lower_lft, hinfsyn
from mufly.control.synthesis.lqg import LqgResult, LqgWeights, design_lqg
from mufly.control.synthesis.weighting_schemes import (
    DesignSettings,
    OneDegreeWeights,
    SignalScaling,
    TransferFunction,
    TwoDegreeWeights,
    make_one_dof_generalised_plant,
    make_two_dof_generalised_plant,
)

__all__ = [
    "DEFAULT_CONTROL_RATE_HZ",
    "ControllerDesign",
    "ControllerReduction",
    "DesignSettings",
    "DiscreteController",
    "DiskMargin",
    "FlightController",
    "H2Result",
    "HinfResult",
    "LoopAnalysis",
    "LoopCurves",
    "LqgResult",
    "LqgWeights",
    "OneDegreeWeights",
    "ReducedCandidate",
    "SignalScaling",
    "TransferFunction",
    "TwoDegreeWeights",
    "analyse_loop",
    "compute_input_noise_std",
    "compute_loop_singular_values",
    "compute_lower_lft",
    "connect_blocks",
    "design_flight_controller",
    "design_lqg",
    "discretise_controller",
    "disk_margin",
    "frequency_response",
    "h2_norm",
    "h2syn",
    "heave_yaw_init",
    "heave_yaw_step",
    "hinf_norm",
    "hinfsyn",
    "limit_heave_reference",
    "make_one_dof_generalised_plant",
    "make_two_dof_generalised_plant",
    "position_init",
    "position_step",
    "reduce_controller",
    "roll_pitch_init",
    "roll_pitch_step",
    "sample_plant",
    "singular_values",
]
