"""What the passing of blades adds to a coaxial pair's mean loads.

The wakes are those of the solved pair, each standing still in its own rotor's frame; for every relative azimuth the
blades meet the other rotor's vortices where they then are, and the circulation is that of the instant. This is
quasi-steady: vorticity shed by the change of circulation is left out, so peaks come out somewhat high. Blades pass
N times in a relative revolution for rotors of N blades, at N (Omega_1 + Omega_2) / 2 pi.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.wake.result import WakeSolution
from mufly.rotor.wake.solver import first_shape
from mufly.rotor.wake.unit import Unit, from_other_at, solve_blade

__all__ = ["BladePassing", "blade_passing"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class BladePassing:
    """Loads over the relative azimuth.

    Attributes
    ----------
    azimuth_rad : (m,) array
        How far the blades of the two rotors stand apart; 0 where they lie above each other.
    thrust_N, torque_Nm : (2, m) arrays
        Upper and lower rotor, in the order of the solution's rotors.
    passing_hz : float
        Frequency at which blades pass.
    """

    azimuth_rad: Array
    thrust_N: Array
    torque_Nm: Array
    passing_hz: float


def blade_passing(solution: WakeSolution, *, points: int = 24) -> BladePassing:
    """Loads of a solved pair over one passing of blades.

    Parameters
    ----------
    solution : WakeSolution
        Of two rotors with as many blades each.
    points : int
        Relative azimuths.

    Raises
    ------
    InputError
        If the solution is not one of two rotors, or their numbers of blades differ.
    """
    if len(solution.wakes) != 2:
        raise InputError("wake", "solution", "is not one of a pair", "solve two rotors")
    rotors = [wake.placed for wake in solution.wakes]
    settings, air, climb = solution.settings, solution.air, solution.climb_m_s
    units = [Unit(p, settings) for p in rotors]
    if units[0].surface.blades != units[1].surface.blades:
        raise InputError("wake", "blades", "differ between the rotors", "give rotors of as many blades")
    first_shape(units, solution, climb)
    for unit in units:
        unit.lay_out(settings, air.viscosity_Pa_s / air.density_kg_m3)
    circulation = [unit.state for unit in units]
    blades = units[0].surface.blades
    azimuth = np.arange(points) * 2.0 * math.pi / blades / points
    thrust, torque = np.empty((2, points)), np.empty((2, points))
    for i, angle in enumerate(azimuth):
        winds = [from_other_at(a, b, a.sensors, float(angle)) for a, b in (units, units[::-1])]
        for k, unit in enumerate(units):
            unit.state = circulation[k]
            solve_blade(unit, winds[k], air, climb, settings)
            thrust[k, i], torque[k, i] = unit.thrust, unit.torque
    relative = sum(p.speed_rad_s for p in rotors)
    return BladePassing(azimuth, thrust, torque, blades * relative / (2.0 * math.pi))
