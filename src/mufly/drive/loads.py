"""What a rotor asks of its drive: thrust and torque over speed, for one rotor or for many at once.

A load is a function ``load(speed_rad_s, case)``: speeds (m,) of the cases with the numbers ``case`` (m,), answered with
thrust (N) and torque (N m), each (m,). The numbers select among arrays that the load may hold, one entry a case; a load
of a single rotor has no need of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.rotor import Air, Blading, hover_batch

__all__ = ["RotorLoad", "blade_load", "coefficient_load", "scaled_load"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
RotorLoad = Callable[[Array, Integers], tuple[Array, Array]]


def coefficient_load(c_T: float, c_Q: float, *, radius_m: float, density_kg_m3: float = 1.2) -> RotorLoad:
    """Return the load of a rotor with constant coefficients, as eq. 3.18 takes it.

    Parameters
    ----------
    c_T, c_Q : float
        T / (rho pi R^4 Omega^2), Q / (rho pi R^5 Omega^2).
    radius_m, density_kg_m3 : float
        R and rho.
    """
    thrust = c_T * density_kg_m3 * math.pi * radius_m**4
    torque = c_Q * density_kg_m3 * math.pi * radius_m**5
    return lambda speed, case: (thrust * speed**2, torque * speed**2)


def blade_load(
    blading: Blading,
    *,
    pitch_rad: ArrayLike,
    which: ArrayLike = 0,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
) -> RotorLoad:
    """Return the load of blades as blade element momentum theory sees them: the coefficients change with speed.

    Parameters
    ----------
    blading : Blading
        One or several rotors.
    pitch_rad, climb_m_s, which : array_like
        Pitch setting (rad), axial speed (m/s) and rotor of each case; scalars hold for all.
    air : Air, optional
        Density and viscosity.
    """
    pitch, climb = np.asarray(pitch_rad, dtype=np.float64), np.asarray(climb_m_s, dtype=np.float64)
    index = np.asarray(which, dtype=np.int64)

    def of(values: NDArray, case: Integers) -> NDArray:
        return values if values.ndim == 0 else values[case]

    def load(speed: Array, case: Integers) -> tuple[Array, Array]:
        r = hover_batch(
            blading, pitch_rad=of(pitch, case), speed_rad_s=speed, climb_m_s=of(climb, case), which=of(index, case),
            air=air,
        )  # fmt: skip
        return r.thrust_N, r.torque_Nm

    return load


def scaled_load(load: RotorLoad, speed_rad_s: float, thrust_N: float, torque_Nm: float) -> RotorLoad:
    """Return a load with thrust and torque scaled so that it goes through a point of one rotor that is known better.

    Parameters
    ----------
    load : RotorLoad
        Of one rotor.
    speed_rad_s, thrust_N, torque_Nm : float
        The point, from a wake or a bench.

    Raises
    ------
    InputError
        If the load has no thrust or torque there, or not of the same sign.
    """
    thrust, torque = load(np.array([float(speed_rad_s)]), np.array([0]))
    factors = []
    for name, known, ours in (("thrust_N", thrust_N, thrust[0]), ("torque_Nm", torque_Nm, torque[0])):
        if not known * ours > 0.0:
            raise InputError(
                "load", name, f"is {ours:.3g} where {known:.3g} is known", "check the operating point"
            )
        factors.append(known / ours)

    def scaled(speed: Array, case: Integers) -> tuple[Array, Array]:
        thrust, torque = load(speed, case)
        return factors[0] * thrust, factors[1] * torque

    return scaled
