"""How does it move? Equations of motion, trim, linearisation, simulation, wind and ground."""

from mufly.dynamics.linearisation import (
    HoverPerformance,
    Linearisation,
    Trim,
    hover_current_A,
    hover_performance,
    linearise,
    submodel,
    trim,
)
from mufly.dynamics.model import battery_state, derivative, lowest_point, standing_height
from mufly.dynamics.similarity import similar_vehicle
from mufly.dynamics.simulation import (
    DEFAULT_STEP_S,
    DrydenWind,
    advance,
    advance_batch,
    fastest_part,
    longest_step,
    model_air,
    outside_model,
    simulate,
    state_dataset,
)
from mufly.dynamics.state import (
    INPUT_SIZE,
    PARAMETERS,
    STATE_SIZE,
    euler_from_quaternion,
    hover_speeds,
    initial_state,
    model_parameters,
    quaternion_from_euler,
    rotation,
)
from mufly.units import GRAVITY

__all__ = [
    "DEFAULT_STEP_S",
    "GRAVITY",
    "INPUT_SIZE",
    "PARAMETERS",
    "STATE_SIZE",
    "DrydenWind",
    "HoverPerformance",
    "Linearisation",
    "Trim",
    "advance",
    "advance_batch",
    "battery_state",
    "derivative",
    "euler_from_quaternion",
    "fastest_part",
    "hover_current_A",
    "hover_performance",
    "hover_speeds",
    "initial_state",
    "linearise",
    "longest_step",
    "lowest_point",
    "model_air",
    "model_parameters",
    "outside_model",
    "quaternion_from_euler",
    "rotation",
    "similar_vehicle",
    "simulate",
    "standing_height",
    "state_dataset",
    "submodel",
    "trim",
]
