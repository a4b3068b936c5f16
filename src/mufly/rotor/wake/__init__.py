"""The wake method: blades as lifting surfaces, wakes of vortex filaments, prescribed or free, one rotor or two."""

from mufly.rotor.wake.field import BladePassing, blade_passing, induced_velocity, momentum_thrust
from mufly.rotor.wake.result import Placed, Wake, WakeSettings, WakeSolution, check_rotors
from mufly.rotor.wake.solver import solve_wake

__all__ = [
    "BladePassing",
    "Placed",
    "Wake",
    "WakeSettings",
    "WakeSolution",
    "blade_passing",
    "check_rotors",
    "induced_velocity",
    "momentum_thrust",
    "solve_wake",
]
