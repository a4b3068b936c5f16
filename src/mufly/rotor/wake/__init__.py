"""Wake method: blades as lifting surfaces with prescribed or free wakes of vortex filaments, for one or two rotors."""

from mufly.rotor.rotor_system import PlacedRotor, RotorWake, WakeSettings
from mufly.rotor.validity_checks import check_rotors
from mufly.rotor.wake.induced_flow import (
    BladePassingLoads,
    compute_blade_passing_loads,
    compute_momentum_flux_thrust,
    induced_velocity,
)
from mufly.rotor.wake.wake_solver import solve_wake

__all__ = [
    "BladePassingLoads",
    "PlacedRotor",
    "RotorWake",
    "WakeSettings",
    "check_rotors",
    "compute_blade_passing_loads",
    "compute_momentum_flux_thrust",
    "induced_velocity",
    "solve_wake",
]
