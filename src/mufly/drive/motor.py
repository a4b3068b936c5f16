"""Brushless motor with gear and rotor (thesis Secs 3.1.4 and 4.4.2).

The controller applies the mean voltage ``duty * voltage``; the inductance is neglected (eq. 4.26)::

    I_A          = (duty * U - kE * i * Omega) / R                          armature current
    J dOmega/dt  = kM * I_A / i - dR * Omega - Q / (i^2 * eta)              eq. 4.29

with gear ratio ``i = motor speed / rotor speed`` and the drag torque ``Q`` of the rotor. ``J`` is the inertia
that the motor sees. The supply gives ``duty * I_A`` (mean of the chopped current).
"""

from __future__ import annotations

from numba import njit

__all__ = ["armature_current", "rotor_acceleration"]


@njit(cache=True, error_model="numpy")
def armature_current(duty, voltage, speed, back_emf_constant, resistance, gear_ratio):  # type: ignore[no-untyped-def]
    """Return the armature current (A) of a motor whose rotor turns at ``speed`` (rad/s); eq. 4.24 without L."""
    return (duty * voltage - back_emf_constant * gear_ratio * speed) / resistance


@njit(cache=True, error_model="numpy")
def rotor_acceleration(  # type: ignore[no-untyped-def]
    current, speed, drag_torque, torque_constant, friction, gear_ratio, gear_efficiency, inertia
):
    """Return dOmega/dt (rad/s2) of a rotor at ``speed`` (rad/s) under ``drag_torque`` (N m); eq. 4.29."""
    drive = torque_constant * current / gear_ratio - friction * speed
    return (drive - drag_torque / (gear_ratio * gear_ratio * gear_efficiency)) / inertia
