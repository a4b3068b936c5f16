"""What is asked of a wake other than one point: a thrust, or every point of a measurement.

The wake is dear and blade element momentum theory (BEMT) is not, and the ratio of the two hardly changes from one
point to a near one. So BEMT, scaled to the wake at the last point, finds the next one: with T_w / T_b the ratio there,
the point is sought at which BEMT gives T_wanted T_b / T_w. Two or three wakes are enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mufly.errors import InputError, MuflyError
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.compare import Comparison
from mufly.rotor.geometry import Rotor
from mufly.rotor.hover import Air
from mufly.rotor.measurements import Measurements
from mufly.rotor.thrust import solve_thrust
from mufly.rotor.wake.pair import hover_wake
from mufly.rotor.wake.result import WakeSettings, WakeSolution

__all__ = ["compare_wake", "solve_thrust_wake"]

Progress = Callable[[int, float, float], None]

_REACHED = 1e-3  # of the thrust: what a converged wake can tell
_TRIES = 8


def solve_thrust_wake(
    blading: Blading | Rotor,
    *,
    thrust_N: float,
    pitch_rad: float | None = None,
    speed_rad_s: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    which: int = 0,
    settings: WakeSettings | None = None,
    progress: Progress | None = None,
) -> WakeSolution:
    """Find the speed (at given pitch) or the pitch (at given speed) for a thrust, to 0.1 % or the wake's tolerance.

    Arguments as for :func:`mufly.rotor.solve_thrust`. A wake on the way that does not converge is returned as it is,
    marked so.

    Raises
    ------
    InputError
        If neither or both of pitch and speed are given, or the thrust is out of reach.
    MuflyError
        If eight tries do not find it.
    """
    if not 0.0 < thrust_N < math.inf:
        raise InputError("rotor", "thrust", f"is {thrust_N:g} N", "give a number above 0")
    case, how = as_blading(blading), settings or WakeSettings()
    enough = max(_REACHED, how.tolerance)
    wanted, known, reached = thrust_N, None, math.nan
    for _ in range(_TRIES):
        b = solve_thrust(
            case, thrust_N=wanted, pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air,
            which=which,
        )  # fmt: skip
        known = hover_wake(
            case, pitch_rad=b.pitch_rad, speed_rad_s=b.speed_rad_s, climb_m_s=climb_m_s, air=air, which=which,
            settings=how, start=known, progress=progress,
        )  # fmt: skip
        reached = known.rotors[0].thrust_N
        if not known.converged or abs(reached / thrust_N - 1.0) <= enough:
            return known
        if not reached > 0.0:
            break
        wanted = thrust_N * b.thrust_N / reached
    raise MuflyError(
        f"rotor: {thrust_N:g} N is not found in {_TRIES} tries; the last wake gives {reached:.4g} N"
    )


def compare_wake(
    blading: Blading | Rotor,
    measured: Measurements,
    *,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Comparison, list[str]]:
    """Predict every measured point by the wake method.

    Parameters
    ----------
    blading : Blading or Rotor
    measured : Measurements
    air : Air, optional
        Density and viscosity at the bench.
    settings : WakeSettings, optional
    progress : callable, optional
        Called with points done and points in all.

    Returns
    -------
    comparison : Comparison
        Points whose wake did not converge hold nan.
    faults : list of str
        Why not, for each point; empty where it did.
    """
    case, n = as_blading(blading), measured.thrust_N.size
    thrust, torque, faults = np.full(n, np.nan), np.full(n, np.nan), [""] * n
    known: WakeSolution | None = None
    # Neighbours in pitch and speed one after the other: each wake starts from the one before.
    for done, k in enumerate(np.lexsort((measured.speed_rad_s, measured.pitch_rad)).tolist()):
        if progress is not None:
            progress(done, n)
        pitch, speed = float(measured.pitch_rad[k]), float(measured.speed_rad_s[k])
        now = hover_wake(case, pitch_rad=pitch, speed_rad_s=speed, air=air, settings=settings, start=known)
        if not now.converged and known is not None:
            now = hover_wake(case, pitch_rad=pitch, speed_rad_s=speed, air=air, settings=settings)
        if now.converged:
            known = now
            thrust[k], torque[k] = now.rotors[0].thrust_N, now.rotors[0].torque_Nm
        else:
            faults[k] = now.message
    if progress is not None:
        progress(n, n)
    return (
        Comparison(
            measured,
            thrust,
            torque,
            thrust / measured.thrust_N - 1.0,
            torque / measured.torque_Nm - 1.0,
            case.corrections.calibrated,
        ),
        faults,
    )
