"""The wake method: blades as lifting surfaces, wakes of vortex filaments, prescribed or free, one rotor or two."""

from mufly.rotor.wake.field import induced_velocity, momentum_thrust
from mufly.rotor.wake.pair import balance_torque_wake, coaxial_wake, hover_wake
from mufly.rotor.wake.phase import BladePassing, blade_passing
from mufly.rotor.wake.result import Placed, Wake, WakeSettings, WakeSolution
from mufly.rotor.wake.search import compare_wake, solve_thrust_wake
from mufly.rotor.wake.solver import solve
from mufly.rotor.wake.trim_pitch import balance_pitch, balance_pitch_wake

__all__ = [
    "BladePassing",
    "Placed",
    "Wake",
    "WakeSettings",
    "WakeSolution",
    "balance_pitch",
    "balance_pitch_wake",
    "balance_torque_wake",
    "blade_passing",
    "coaxial_wake",
    "compare_wake",
    "hover_wake",
    "induced_velocity",
    "momentum_thrust",
    "solve",
    "solve_thrust_wake",
]
