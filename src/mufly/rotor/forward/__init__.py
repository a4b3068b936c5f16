"""Rotors in forward flight: blade elements over azimuth, flapping and dynamic inflow."""

from mufly.rotor.forward import forward_pictures as _forward_pictures  # noqa: F401  draws results of the room
from mufly.rotor.forward.forward_results import (
    CyclicResponse,
    ForwardCondition,
    ForwardResult,
    ForwardSweep,
    RigidFlapMode,
)
from mufly.rotor.forward.forward_solver import (
    compute_cyclic_response,
    estimate_flap_mode_range,
    lock_number,
    make_flap_mode,
    solve_forward,
    sweep_forward,
)
from mufly.rotor.forward.skewed_pair import ForwardPair, PairSweep, solve_forward_pair, sweep_forward_pair

__all__ = [
    "CyclicResponse",
    "ForwardCondition",
    "ForwardPair",
    "ForwardResult",
    "ForwardSweep",
    "PairSweep",
    "RigidFlapMode",
    "compute_cyclic_response",
    "estimate_flap_mode_range",
    "lock_number",
    "make_flap_mode",
    "solve_forward",
    "solve_forward_pair",
    "sweep_forward",
    "sweep_forward_pair",
]
