"""Cases of a study of single rotors by the wake method: one wake a case, and a search where a thrust or duty is given.

The speed that gives a thrust, or at which a motor settles, is found with blade element momentum theory scaled to the
wake at the last speed (as in :mod:`mufly.rotor.wake.search`), until the speed stands still.

Neighbouring cases start from each other's wake. A wake so begun agrees with one begun afresh within the tolerance
of convergence, not bit by bit; a case that does not converge that way is begun afresh before it is called failed. A
wake that settled only with thicker cores than the one remembered is no start for others: they would inherit them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.drive import RotorLoad
from mufly.errors import InputError
from mufly.rotor import Air, Blading
from mufly.rotor.wake import WakeSettings, WakeSolution, hover_wake

__all__ = ["WAKE_LOCK", "WakeAnswers", "remember", "solve_wakes"]

Array = NDArray[np.float64]

# The wake's sums run on all cores by themselves, and Numba's plain threading layer serves one caller at a time.
WAKE_LOCK = threading.Lock()

_STILL = 5e-4  # of the speed: 0.1 % of the thrust
_TRIES = 8
_LAST: dict[WakeSettings, WakeSolution] = {}  # the last converged wake, for the next case


@dataclass(frozen=True, eq=False)
class WakeAnswers:
    """(n,) arrays, nan where ``reason`` is not empty."""

    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    outside_share: Array
    core_limit: Array
    reason: list[str]


def remember(last: dict[WakeSettings, WakeSolution], settings: WakeSettings, now: WakeSolution) -> None:
    """Keep a converged wake as the start of the next case, unless its cores are thicker than those of the one kept."""
    known = last.get(settings)
    if known is None or (now.settings.core_limit or 0.0) <= (known.settings.core_limit or 0.0):
        last.clear()
        last[settings] = now


def _one(
    blading: Blading, which: int, pitch: float, speed: float, climb: float, air: Air, settings: WakeSettings
) -> WakeSolution:
    known = _LAST.get(settings)
    now: WakeSolution | None = None
    for start in [known, None] if known is not None else [None]:
        now = hover_wake(
            blading, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=air, which=which, settings=settings,
            start=start,
        )  # fmt: skip
        if now.converged:
            remember(_LAST, settings, now)
            return now
    assert now is not None
    return now


def solve_wakes(
    blading: Blading,
    which: NDArray[np.int64],
    pitch_rad: Array,
    climb_m_s: Array,
    air: Air,
    settings: WakeSettings,
    load: RotorLoad,
    speed_rad_s: Array,
    find: Callable[[RotorLoad], Array] | None,
) -> WakeAnswers:
    """Solve cases by the wake method.

    Parameters
    ----------
    blading : Blading
    which, pitch_rad, climb_m_s : (n,) arrays
        Rotor, pitch and axial speed of each case.
    air : Air
    settings : WakeSettings
    load : RotorLoad
        Of blade element theory.
    speed_rad_s : (n,) array
        Speeds, or what blade element theory takes for them; nan where it finds none.
    find : callable, optional
        Speeds of all cases for a load, if they are sought.
    """
    n = pitch_rad.size
    speed_, thrust_, torque_, share_, core_ = (np.full(n, np.nan) for _ in range(5))
    out = WakeAnswers(speed_, thrust_, torque_, share_, core_, [""] * n)
    factors = np.ones((2, n))
    speed, todo = (
        speed_rad_s.copy(),
        [k for k in range(n) if np.isfinite(speed_rad_s[k]) and speed_rad_s[k] > 0],
    )

    def scaled(omega: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        thrust, torque = load(omega, index)
        return thrust * factors[0, index], torque * factors[1, index]

    for _ in range(_TRIES):
        for k in list(todo):
            try:
                with WAKE_LOCK:
                    now = _one(blading, int(which[k]), pitch_rad[k], speed[k], climb_m_s[k], air, settings)
            except InputError as error:
                out.reason[k] = str(error)
                todo.remove(k)
                continue
            r = now.rotors[0]
            if not now.converged:
                out.reason[k] = f"wake {now.message}"
                todo.remove(k)
                continue
            out.speed_rad_s[k], out.thrust_N[k], out.torque_Nm[k] = speed[k], r.thrust_N, r.torque_Nm
            out.outside_share[k] = r.outside_share
            out.core_limit[k] = now.settings.core_limit if now.settings.core_limit is not None else np.nan
            if find is None:
                todo.remove(k)
                continue
            thrust, torque = load(speed[k : k + 1], np.array([k]))
            factors[:, k] = r.thrust_N / thrust[0], r.torque_Nm / torque[0]
            if not np.all((factors[:, k] > 0.1) & (factors[:, k] < 10.0)):
                out.reason[k] = "wake and blade element theory are too far apart to look for a speed"
                todo.remove(k)
        if not todo or find is None:
            break
        following = find(scaled)
        for k in list(todo):
            if not np.isfinite(following[k]):
                out.reason[k] = "the wake method finds no speed for it"
                todo.remove(k)
            elif abs(following[k] / speed[k] - 1.0) <= max(_STILL, 0.5 * settings.tolerance):
                todo.remove(k)
            else:
                speed[k] = following[k]
    for k in todo:
        out.reason[k] = f"the speed does not stand still in {_TRIES} wakes"
    return out
