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

from mufly.rotor import Air, Blading, hover_batch

__all__ = ["RotorLoad", "blade_load", "coefficient_load"]

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
