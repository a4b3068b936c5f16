"""The wake method: blades as lifting surfaces, wakes of vortex filaments, prescribed or free, one rotor or two."""

from mufly.rotor.system import Placed, Wake, WakeSettings, check_rotors
from mufly.rotor.wake.field import BladePassing, blade_passing, induced_velocity, momentum_thrust
from mufly.rotor.wake.solver import solve_wake

__all__ = [
    "BladePassing",
    "Placed",
    "Wake",
    "WakeSettings",
    "blade_passing",
    "check_rotors",
    "induced_velocity",
    "momentum_thrust",
    "solve_wake",
]
