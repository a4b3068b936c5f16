"""Rotors in forward flight: blade elements over azimuth, flapping and dynamic inflow."""

from mufly.rotor.forward.forward_results import (
    BladeFlap,
    CyclicResponse,
    ForwardCondition,
    ForwardResult,
    ForwardSweep,
)
from mufly.rotor.forward.forward_solver import (
    blade_flap,
    blade_flap_band,
    cyclic_response,
    lock_number,
    solve_forward,
    sweep_forward,
)
from mufly.rotor.forward.skewed_pair import ForwardPair, PairSweep, solve_forward_pair, sweep_forward_pair

__all__ = [
    "BladeFlap",
    "CyclicResponse",
    "ForwardCondition",
    "ForwardPair",
    "ForwardResult",
    "ForwardSweep",
    "PairSweep",
    "blade_flap",
    "blade_flap_band",
    "cyclic_response",
    "lock_number",
    "solve_forward",
    "solve_forward_pair",
    "sweep_forward",
    "sweep_forward_pair",
]
