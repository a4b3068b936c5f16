"""The pitch of the lower rotor at which the torques of a coaxial pair cancel, by either method.

At given speeds a pair is balanced by pitch: ln(Q_lower / Q_upper) is a smooth, rising function of the lower pitch,
close to a line, so secant steps find its root in three to six solutions. With a thrust both speeds are scaled by
sqrt(T_wanted / T) after every step, their ratio kept: coefficients depend on speed through the Reynolds number only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol, TypeVar

from mufly.errors import InputError, MuflyError
from mufly.rotor.blading import Blading
from mufly.rotor.coaxial import CoaxialResult, coaxial
from mufly.rotor.hover import Air
from mufly.rotor.wake.pair import coaxial_wake
from mufly.rotor.wake.result import WakeSettings, WakeSolution

__all__ = ["balance_pitch", "balance_pitch_wake"]

_TRIES = 25
_FIRST_SLOPE = 8.0  # 1/rad: torque grows like pitch^1.5 or so
_SLOPES = (1.0, 80.0)  # what a secant may say of blades that do not stall
_LONGEST_STEP = math.radians(4.0)
_RANGE = (math.radians(-10.0), math.radians(45.0))


class _Loaded(Protocol):
    @property
    def thrust_N(self) -> float: ...
    @property
    def torque_Nm(self) -> float: ...


_T = TypeVar("_T")


def _balanced(
    solve: Callable[[float, float], tuple[_T, _Loaded, _Loaded]],
    start_rad: float,
    thrust_N: float | None,
    tolerance: float,
) -> _T:
    """Solution at which torques cancel; ``solve(lower pitch, factor on both speeds)``."""
    if thrust_N is not None and not 0.0 < thrust_N < math.inf:
        raise InputError("coaxial", "thrust_N", f"is {thrust_N:g}", "give a number above 0")
    pitch, factor, slope = start_rad, 1.0, _FIRST_SLOPE
    last: tuple[float, float] | None = None
    fault = math.nan
    for _ in range(_TRIES):
        now, upper, lower = solve(pitch, factor)
        total = upper.thrust_N + lower.thrust_N
        if not upper.torque_Nm > 0.0:
            raise MuflyError(
                "coaxial: the upper rotor takes no torque at this pitch, so nothing is to be balanced"
            )
        if thrust_N is not None and not total > 0.0:
            raise MuflyError("coaxial: no thrust at these pitches, so no speed gives the one asked for")
        fault = math.log(max(lower.torque_Nm / upper.torque_Nm, 1e-3))
        short = 0.0 if thrust_N is None else math.log(thrust_N / total)
        if abs(fault) <= tolerance and abs(short) <= tolerance:
            return now
        if last is not None and abs(pitch - last[0]) > 1e-7:
            slope = min(max((fault - last[1]) / (pitch - last[0]), _SLOPES[0]), _SLOPES[1])
        last = (pitch, fault)
        pitch -= max(min(fault / slope, _LONGEST_STEP), -_LONGEST_STEP)
        pitch = min(max(pitch, _RANGE[0]), _RANGE[1])
        factor *= math.exp(max(min(0.5 * short, 1.0), -1.0))
    raise MuflyError(
        f"coaxial: no lower pitch between {math.degrees(_RANGE[0]):.0f} and {math.degrees(_RANGE[1]):.0f} degrees "
        f"balances the torques in {_TRIES} tries; they still differ by {100 * abs(math.expm1(fault)):.2g} %"
    )


def balance_pitch(
    upper: Blading,
    lower: Blading,
    *,
    spacing_m: float,
    upper_pitch_rad: float,
    upper_speed_rad_s: float,
    lower_speed_rad_s: float,
    thrust_N: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
) -> CoaxialResult:
    """Find the lower pitch at which the torques cancel, by blade element momentum theory.

    Parameters
    ----------
    upper, lower, spacing_m, upper_pitch_rad, climb_m_s, air
        As for :func:`mufly.rotor.coaxial`.
    upper_speed_rad_s, lower_speed_rad_s : float
        Speeds; with a thrust, only their ratio counts.
    thrust_N : float, optional
        Thrust of the pair; both speeds are scaled until it is there.

    Raises
    ------
    InputError
        If the thrust is not above zero.
    MuflyError
        If no pitch between -10 and 45 degrees balances the torques, to 1e-7 of the upper one.
    """

    def solve(pitch: float, factor: float) -> tuple[CoaxialResult, _Loaded, _Loaded]:
        r = coaxial(
            upper, lower, spacing_m=spacing_m, upper_pitch_rad=upper_pitch_rad, lower_pitch_rad=pitch,
            upper_speed_rad_s=factor * upper_speed_rad_s, lower_speed_rad_s=factor * lower_speed_rad_s,
            climb_m_s=climb_m_s, air=air,
        )  # fmt: skip
        return r, r.upper, r.lower

    return _balanced(solve, upper_pitch_rad, thrust_N, 1e-7)


def balance_pitch_wake(
    upper: Blading,
    lower: Blading,
    *,
    spacing_m: float,
    upper_pitch_rad: float,
    upper_speed_rad_s: float,
    lower_speed_rad_s: float,
    thrust_N: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    start: WakeSolution | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> WakeSolution:
    """Find the same by the wake method, to 1e-3 or the wake's tolerance; each try starts from the last wake.

    Raises
    ------
    InputError, MuflyError
        As :func:`balance_pitch`, and if a wake on the way does not converge.
    """
    how = settings or WakeSettings()
    known = [start]

    def solve(pitch: float, factor: float) -> tuple[WakeSolution, _Loaded, _Loaded]:
        s = coaxial_wake(
            upper, lower, spacing_m=spacing_m, upper_pitch_rad=upper_pitch_rad, lower_pitch_rad=pitch,
            upper_speed_rad_s=factor * upper_speed_rad_s, lower_speed_rad_s=factor * lower_speed_rad_s,
            climb_m_s=climb_m_s, air=air, settings=how, start=known[0], progress=progress,
        )  # fmt: skip
        if not s.converged:
            raise MuflyError(f"coaxial: at {math.degrees(pitch):.2f} degrees below the wake is {s.message}")
        known[0] = s
        return s, s.rotors[0], s.rotors[1]

    return _balanced(solve, upper_pitch_rad, thrust_N, max(1e-3, how.tolerance))
