"""The wake method: blades as lifting surfaces, wakes of vortex filaments, prescribed or free, one rotor or two."""

from mufly.rotor.wake.field import induced_velocity
from mufly.rotor.wake.pair import balance_torque_wake, coaxial_wake, hover_wake
from mufly.rotor.wake.result import Placed, Wake, WakeSettings, WakeSolution
from mufly.rotor.wake.solver import solve

__all__ = [
    "Placed",
    "Wake",
    "WakeSettings",
    "WakeSolution",
    "balance_torque_wake",
    "coaxial_wake",
    "hover_wake",
    "induced_velocity",
    "solve",
]
