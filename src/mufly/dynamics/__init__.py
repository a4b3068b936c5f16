"""Flight dynamics: equations of motion, trim, linearisation, simulation, wind and ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mufly.dynamics.casadi_equations import casadi_model
from mufly.dynamics.equations_of_motion import (
    compute_battery_supply,
    find_deepest_contact,
    standing_attitude,
    standing_height,
    standing_state,
    state_derivative,
)
from mufly.dynamics.hover_limits import MAX_TIP_MACH, compute_tip_mach_number, judge_hover
from mufly.dynamics.linearisation import (
    HoverPerformance,
    Linearisation,
    Trim,
    extract_submodel,
    find_trim,
    hover_current_A,
    hover_performance,
    linearise_vehicle,
)
from mufly.dynamics.model_state import (
    INPUT_SIZE,
    PARAMETER_DTYPE,
    STATE_SIZE,
    ModelParameters,
    body_to_ned_matrix,
    compute_hover_rotor_speeds,
    initial_state,
    model_parameters,
)
from mufly.dynamics.similarity import scale_vehicle_by_similarity
from mufly.dynamics.simulation import (
    DEFAULT_STEP_S,
    DrydenWind,
    describe_excess_wind,
    describe_max_level_speed,
    dryden_filter,
    find_longest_stable_step,
    find_model_airspeed_limits,
    find_step_limiting_parameter,
    integrate_state,
    max_level_speed_band,
    simulate_open_loop,
    state_dataset,
)
from mufly.quantities.units import GRAVITY
from mufly.rotations import euler_from_quaternion, quaternion_from_euler

if TYPE_CHECKING:
    from mufly.dynamics.lane_equations import integrate_batch

__all__ = [
    "DEFAULT_STEP_S",
    "GRAVITY",
    "INPUT_SIZE",
    "MAX_TIP_MACH",
    "PARAMETER_DTYPE",
    "STATE_SIZE",
    "DrydenWind",
    "HoverPerformance",
    "Linearisation",
    "ModelParameters",
    "Trim",
    "body_to_ned_matrix",
    "casadi_model",
    "compute_battery_supply",
    "compute_hover_rotor_speeds",
    "compute_tip_mach_number",
    "describe_excess_wind",
    "describe_max_level_speed",
    "dryden_filter",
    "euler_from_quaternion",
    "extract_submodel",
    "find_deepest_contact",
    "find_longest_stable_step",
    "find_model_airspeed_limits",
    "find_step_limiting_parameter",
    "find_trim",
    "hover_current_A",
    "hover_performance",
    "initial_state",
    "integrate_batch",
    "integrate_state",
    "judge_hover",
    "linearise_vehicle",
    "max_level_speed_band",
    "model_parameters",
    "quaternion_from_euler",
    "scale_vehicle_by_similarity",
    "simulate_open_loop",
    "standing_attitude",
    "standing_height",
    "standing_state",
    "state_dataset",
    "state_derivative",
]


def __getattr__(name: str) -> Any:
    """Import :func:`integrate_batch` on first use."""
    if name == "integrate_batch":
        from mufly.dynamics.lane_equations import integrate_batch

        return integrate_batch
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
