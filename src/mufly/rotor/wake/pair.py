"""Hover and axial flight by the wake method, with the arguments of the blade element functions they stand beside."""

from __future__ import annotations

import math
from collections.abc import Callable

from mufly.errors import InputError, MuflyError
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.hover import Air
from mufly.rotor.wake.result import Placed, WakeSettings, WakeSolution
from mufly.rotor.wake.solver import solve

__all__ = ["balance_torque_wake", "coaxial_wake", "hover_wake"]

Progress = Callable[[int, float, float], None]

_BALANCED = 1e-3  # of the upper rotor's torque, or of the thrust asked for: what a converged wake can tell
_TRIES = 12


def hover_wake(
    blading: Blading | Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    which: int = 0,
    settings: WakeSettings | None = None,
    start: WakeSolution | None = None,
    progress: Progress | None = None,
) -> WakeSolution:
    """One rotor in hover or axial flight; arguments as for :func:`mufly.rotor.hover`, ``rotors[0]`` is the answer.

    See Also
    --------
    solve : the method, its settings, and when a solution is marked as not converged.
    """
    placed = Placed(as_blading(blading), pitch_rad, speed_rad_s, which=which)
    return solve([placed], air=air, climb_m_s=climb_m_s, settings=settings, start=start, progress=progress)


def coaxial_wake(
    upper: Blading,
    lower: Blading,
    *,
    spacing_m: float,
    upper_pitch_rad: float,
    lower_pitch_rad: float,
    upper_speed_rad_s: float,
    lower_speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    start: WakeSolution | None = None,
    progress: Progress | None = None,
) -> WakeSolution:
    """A coaxial pair; arguments as for :func:`mufly.rotor.coaxial`, ``rotors`` are (upper, lower).

    Raises
    ------
    InputError
        If spacing or a speed is not above zero, or the blades would touch.
    """
    if not 0.0 < spacing_m < math.inf:
        raise InputError("coaxial", "spacing_m", f"is {spacing_m:g}", "give a distance above 0")
    rotors = (
        Placed(upper, upper_pitch_rad, upper_speed_rad_s, 0.0, 1),
        Placed(lower, lower_pitch_rad, lower_speed_rad_s, -spacing_m, -1),
    )
    return solve(rotors, air=air, climb_m_s=climb_m_s, settings=settings, start=start, progress=progress)


def balance_torque_wake(
    upper: Blading,
    lower: Blading,
    *,
    spacing_m: float,
    upper_pitch_rad: float,
    lower_pitch_rad: float,
    upper_speed_rad_s: float | None = None,
    thrust_N: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    start: WakeSolution | None = None,
    progress: Progress | None = None,
) -> WakeSolution:
    """Find the speeds at which the torques cancel, as :func:`mufly.rotor.balance_torque` does with blade elements.

    Give ``upper_speed_rad_s``, and the lower speed is found; or ``thrust_N``, and both are. Each try starts from the
    wake of the last one.

    Raises
    ------
    InputError
        If neither or both are given.
    MuflyError
        If no balance is found, or a wake on the way there does not converge.
    """
    if (upper_speed_rad_s is None) == (thrust_N is None):
        raise InputError("coaxial", "", "needs one of upper speed and thrust", "give one; the other is found")
    if thrust_N is not None and not 0.0 < thrust_N < math.inf:
        raise InputError("coaxial", "thrust_N", f"is {thrust_N:g}", "give a number above 0")
    how = settings or WakeSettings()
    enough = max(_BALANCED, how.tolerance)
    up = upper_speed_rad_s if upper_speed_rad_s is not None else 300.0
    ratio = 1.1
    known = start
    torque_slope, tries = None, 0
    last: tuple[float, float] | None = None
    while tries < _TRIES:
        tries += 1
        now = coaxial_wake(
            upper, lower, spacing_m=spacing_m, upper_pitch_rad=upper_pitch_rad, lower_pitch_rad=lower_pitch_rad,
            upper_speed_rad_s=up, lower_speed_rad_s=up * ratio, climb_m_s=climb_m_s, air=air, settings=how,
            start=known, progress=progress,
        )  # fmt: skip
        if not now.converged:
            raise MuflyError(
                f"coaxial: at {up:.4g} and {up * ratio:.4g} rad/s the wake is {now.message}; try a larger core_limit"
            )
        known = now
        a, b = now.rotors
        fault = math.log(max(b.torque_Nm, 1e-12) / max(a.torque_Nm, 1e-12))
        total = a.thrust_N + b.thrust_N
        short = 0.0 if thrust_N is None else math.log(thrust_N / total) if total > 0.0 else math.nan
        if not (math.isfinite(fault) and math.isfinite(short)):
            raise MuflyError("coaxial: no thrust at these pitches, so no speed gives the one asked for")
        if abs(fault) <= enough and abs(short) <= enough:
            return now
        # ln(torque ratio) over ln(speed ratio) is close to a line; for isolated rotors its slope is 2.
        here = (math.log(ratio), fault)
        if last is not None and abs(here[0] - last[0]) > 1e-4:
            slope = (here[1] - last[1]) / (here[0] - last[0])
            if 1.0 < slope < 10.0:
                torque_slope = slope
        last = here
        ratio = math.exp(here[0] - max(min(fault / (torque_slope or 2.6), 0.3), -0.3))
        up *= math.exp(max(min(0.5 * short, 1.0), -1.0))
    raise MuflyError(
        f"coaxial: no balance found in {_TRIES} tries; the torques still differ by {100 * fault:.2g} %"
    )
