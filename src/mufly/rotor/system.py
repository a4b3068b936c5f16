"""Two rotors above each other, turning against each other: blade element momentum theory, both ways.

The wake of a rotor is a tube of ring vortices, semi-infinite, that starts at its disc. On a disc of radius R
with induced velocity v, such a tube moves the air at distance z below the disc (above: z < 0) at (Leishman,
sec. 2.2; exact on the axis of a uniform tube)

    v(z) = v k(z),   k(z) = 1 + z / sqrt(R^2 + z^2)      0 far above, 1 at the disc, 2 far below

and continuity moves the stream surface from r to r / sqrt(k). So, with h the distance between the discs:

* The lower rotor meets, inside R / sqrt(k(h)), the upper one's stream: down k v_u, and round 2 u_t,u sqrt(k)
(angular
  momentum, twice the swirl in the disc), against its own motion because it turns the other way. Outside it
  meets still air.
* The upper rotor meets k(-h) v_l of the lower one, over its whole disc as the stream widens upwards; swirl does
not reach up.

The two are solved in turn until the inflow stands still; each turn is one BEMT solution of each rotor. The tube
is that of the undisturbed upper rotor: the lower rotor's pull on the shape of the upper wake is left out, as is
the passing of blades.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.rotor.bemt import Air, RotorResult, hover, hover_batch, induced_velocities
from mufly.rotor.blading import Blading, as_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.wake.result import Placed, WakeSettings, WakeSolution
from mufly.rotor.wake.solver import solve

Array = NDArray[np.float64]

_TURNS = 200
_BALANCED = 1e-7  # of the upper rotor's torque, or of the thrust asked for
_SETTLED = 1e-8  # of the greatest induced velocity


@dataclass(frozen=True, eq=False)
class CoaxialResult:
    """A coaxial pair at one point.

    Attributes
    ----------
    upper, lower : RotorResult
        Each rotor in the presence of the other.
    thrust_N, power_W : float
        Of the pair.
    yaw_torque_Nm : float
        Torque of the lower less that of the upper rotor; 0 in trim.
    figure_of_merit : float
        T sqrt(T / (2 rho A)) / P with one disc area, the larger; nan unless thrust and power are positive.
    turns : int
        How often the pair was solved.
    sent_up_m_s : (stations,) array
        Axial velocity that the lower rotor sends to the stations of the upper.
    """

    upper: RotorResult
    lower: RotorResult
    thrust_N: float
    power_W: float
    yaw_torque_Nm: float
    figure_of_merit: float
    turns: int
    sent_up_m_s: Array


def tube_speed(distance_m: float, radius_m: float) -> float:
    """k(z) of the module docstring: speed on the axis of a wake tube over that in the disc, 0 to 2."""
    return 1.0 + distance_m / math.hypot(radius_m, distance_m)


def _carried(
    r_m: Array, induced: tuple[Array, Array], at_r: Array, at_dr: Array, disc_radius: float, k: float
) -> tuple[Array, Array]:
    """Axial and tangential velocity that a rotor's stream has at radii ``at_r`` where it moves k times as fast.

    A station of width ``at_dr`` across the edge of the stream gets the part that lies inside.
    """
    shrink = 1.0 / math.sqrt(k)
    inside = np.clip((disc_radius * shrink - at_r) / at_dr + 0.5, 0.0, 1.0)
    r = at_r / shrink
    axial = inside * k * np.interp(r, r_m, induced[0])
    around = inside * 2.0 * np.interp(r, r_m, induced[1]) / shrink
    return axial, around


def coaxial(
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
    start: Array | None = None,
) -> CoaxialResult:
    """Solve a coaxial pair.

    Parameters
    ----------
    upper, lower : Blading
        The first rotor of each is taken.
    spacing_m : float
        Distance between the discs, above 0.
    upper_pitch_rad, lower_pitch_rad, upper_speed_rad_s, lower_speed_rad_s : float
        Pitch settings (rad) and speeds (rad/s); the rotors turn against each other.
    climb_m_s : float
        Axial speed of the pair, positive in climb.
    air : Air, optional
        Density and viscosity.
    start : (stations,) array, optional
        First guess of what the lower rotor sends up, ``sent_up_m_s`` of a similar result; saves time, not more.

    Raises
    ------
    InputError
        If the spacing or a speed is not above zero.
    MuflyError
        If the thrusts do not settle, which happens in descents in which the wakes blow back through the discs.
    """
    if not 0.0 < spacing_m < math.inf:
        raise InputError("coaxial", "spacing_m", f"is {spacing_m:g}", "give a distance above 0")
    gas = air or Air()
    radius_u, radius_l = upper.rotors[0].radius_m, lower.rotors[0].radius_m
    down, up = tube_speed(spacing_m, radius_u), tube_speed(-spacing_m, radius_l)
    n_u = upper.r_m[0].size

    def both(to_upper: Array) -> tuple[Array, tuple[Array, Array], float]:
        """Upper rotor in the inflow ``to_upper``, lower rotor below it; the inflow that this sends up again."""
        above = induced_velocities(
            upper, upper_pitch_rad, upper_speed_rad_s, climb_m_s, gas, (to_upper, np.zeros(n_u))
        )
        sent = _carried(upper.r_m[0], above, lower.r_m[0], lower.dr_m[0], radius_u, down)
        below = induced_velocities(lower, lower_pitch_rad, lower_speed_rad_s, climb_m_s, gas, sent)
        pulled = _carried(lower.r_m[0], below, upper.r_m[0], upper.dr_m[0], radius_l, up)[0]
        return pulled, sent, float(np.max(np.abs(above[0])) + np.max(np.abs(below[0])))

    x = np.zeros(n_u) if start is None else start
    last_step, last_image = np.empty(0), np.empty(0)
    for turn in range(1, _TURNS + 1):
        image, sent, size = both(x)
        step = image - x
        if np.max(np.abs(step)) <= _SETTLED * size:
            break
        # Anderson's acceleration with one memory; held to the plain half step where it would leap.
        following = image
        if last_step.size:
            bend = step - last_step
            weight = float(bend @ step) / max(float(bend @ bend), 1e-300)
            following = image - weight * (image - last_image) if abs(weight) < 5.0 else x + 0.5 * step
        if turn > _TURNS // 4:
            following = x + 0.2 * step
        last_step, last_image, x = step, image, following
    else:
        raise MuflyError(
            f"coaxial: the two rotors do not settle at {climb_m_s:g} m/s climb; "
            f"the inflow still changes by {np.max(np.abs(step)) / size:.1e} of itself a turn"
        )
    above = hover(
        upper,
        pitch_rad=upper_pitch_rad,
        speed_rad_s=upper_speed_rad_s,
        climb_m_s=climb_m_s,
        air=gas,
        stream=(x, np.zeros(n_u)),
    )
    below = hover(
        lower,
        pitch_rad=lower_pitch_rad,
        speed_rad_s=lower_speed_rad_s,
        climb_m_s=climb_m_s,
        air=gas,
        stream=sent,
    )
    thrust = above.thrust_N + below.thrust_N
    power = above.power_W + below.power_W
    area = math.pi * max(radius_u, radius_l) ** 2
    useful = thrust > 0 and power > 0
    return CoaxialResult(
        upper=above,
        lower=below,
        thrust_N=thrust,
        power_W=power,
        yaw_torque_Nm=below.torque_Nm - above.torque_Nm,
        figure_of_merit=thrust * math.sqrt(thrust / (2 * gas.density_kg_m3 * area)) / power
        if useful
        else math.nan,
        turns=turn,
        sent_up_m_s=x,
    )


def balance_torque(
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
) -> CoaxialResult:
    """Find the speeds at which the torques cancel.

    Give ``upper_speed_rad_s``, and the lower speed is found; or ``thrust_N``, and both are, so that the pair
    gives this thrust.

    Raises
    ------
    InputError
        If neither or both are given.
    MuflyError
        If no speed balances the torques within a factor of 10, or no speed gives the thrust.
    """
    if (upper_speed_rad_s is None) == (thrust_N is None):
        raise InputError("coaxial", "", "needs one of upper speed and thrust", "give one; the other is found")

    known: list[Array | None] = [None]

    def pair(up: float, low: float) -> CoaxialResult:
        result = coaxial(
            upper, lower, spacing_m=spacing_m, upper_pitch_rad=upper_pitch_rad, lower_pitch_rad=lower_pitch_rad,
            upper_speed_rad_s=up, lower_speed_rad_s=low, climb_m_s=climb_m_s, air=air, start=known[0],
        )  # fmt: skip
        known[0] = result.sent_up_m_s
        return result

    def balanced(up: float, guess: float) -> CoaxialResult:
        return _root(
            lambda x: pair(up, up * x),
            lambda p: p.yaw_torque_Nm / abs(p.upper.torque_Nm),
            guess,
            "balances the torques",
        )

    if upper_speed_rad_s is not None:
        return balanced(upper_speed_rad_s, 1.0)
    assert thrust_N is not None
    if not thrust_N > 0.0:
        raise InputError("coaxial", "thrust_N", f"is {thrust_N:g}", "give a number above 0")
    first = balanced(300.0, 1.0)
    if not first.thrust_N > 0.0:
        raise MuflyError(
            f"coaxial: no thrust at 300 rad/s and these pitches, so {thrust_N:g} N is out of reach"
        )
    ratio = first.lower.speed_rad_s / first.upper.speed_rad_s
    start = 300.0 * math.sqrt(thrust_N / first.thrust_N)
    return _root(
        lambda x: balanced(start * x, ratio),
        lambda p: p.thrust_N / thrust_N - 1.0,
        1.0,
        f"gives {thrust_N:g} N",
    )


def _root(
    solve: Callable[[float], CoaxialResult],
    fault: Callable[[CoaxialResult], float],
    guess: float,
    what: str,
) -> CoaxialResult:
    """Factor at which ``fault`` vanishes: bracket by steps of 1.15 from the guess, then Illinois."""
    a = b = guess
    at_a = at_b = solve(guess)
    fa = fb = fault(at_a)
    while fa > 0.0 and a > 0.1:
        b, at_b, fb = a, at_a, fa
        a /= 1.15
        at_a = solve(a)
        fa = fault(at_a)
    while fb < 0.0 and b < 10.0:
        a, at_a, fa = b, at_b, fb
        b *= 1.15
        at_b = solve(b)
        fb = fault(at_b)
    if fa * fb > 0.0:
        raise MuflyError(f"coaxial: no speed {what} between a tenth and ten times the first guess")
    side = 0
    for _ in range(60):
        if abs(fa) < _BALANCED:
            return at_a
        if abs(fb) < _BALANCED:
            return at_b
        x = b - fb * (b - a) / (fb - fa)
        now = solve(x)
        f = fault(now)
        if abs(f) < _BALANCED:
            return now
        if f * fb > 0.0:
            b, at_b, fb = x, now, f
            fa *= 0.5 if side == 1 else 1.0
            side = 1
        else:
            a, at_a, fa = x, now, f
            fb *= 0.5 if side == -1 else 1.0
            side = -1
    return now


# ----------------------------------------------------------------------------
# The speed or the pitch at which a rotor gives a thrust.


FASTEST_TIP_M_S = 240.0
"""Tip speed (m/s) above which air is no longer incompressible, as polars and theory take it to be: Mach 0.7."""


def solve_thrust(
    blading: Blading | Rotor,
    *,
    thrust_N: float,
    pitch_rad: float | None = None,
    speed_rad_s: float | None = None,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    speed_limits_rad_s: tuple[float, float] | None = None,
    pitch_limits_rad: tuple[float, float] = (-0.35, 0.7),
    which: int = 0,
) -> RotorResult:
    """Find the speed (at given pitch) or the pitch (at given speed) that gives a thrust.

    Give exactly one of ``pitch_rad`` and ``speed_rad_s``; the other is found, to 1e-9 of its range. The unknown
    is sought on 64 points between its limits first, and then between the two lowest ones that enclose the
    thrust, so that of two pitches with the same thrust, below and beyond stall, the lower is returned. Speeds are
    sought up to :data:`FASTEST_TIP_M_S` at the tip.

    Raises
    ------
    InputError
        If neither or both are given, or no value within the limits gives the thrust; the message names the
        greatest thrust there is.
    """
    if (pitch_rad is None) == (speed_rad_s is None):
        raise InputError("rotor", "thrust", "needs one of pitch and speed", "give one; the other is found")
    by_speed, case = speed_rad_s is None, as_blading(blading)
    fastest = FASTEST_TIP_M_S / float(case.radius_m[which])
    low, high = (speed_limits_rad_s or (1.0, fastest)) if by_speed else pitch_limits_rad
    grid = np.geomspace(low, high, 64) if by_speed else np.linspace(low, high, 64)

    def thrust(values: Array) -> Array:
        pitch, speed = (pitch_rad, values) if by_speed else (values, speed_rad_s)
        assert pitch is not None
        assert speed is not None
        return hover_batch(
            case, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb_m_s, air=air, which=which
        ).thrust_N

    for _ in range(8):  # each pass narrows the interval by 63, to below 1e-13 of the first
        short = thrust(grid) - thrust_N
        cross = np.flatnonzero((short[:-1] <= 0.0) & (short[1:] >= 0.0))
        if cross.size == 0:
            key, unit = ("speed", "rad/s") if by_speed else ("pitch", "rad")
            reached = float(short.max() + thrust_N)
            raise InputError(
                "rotor", "thrust", f"{thrust_N:g} N is out of reach: at most {reached:.4g} N",
                f"ask for less, or widen the {key} limits ({low:g} to {high:g} {unit})",
            )  # fmt: skip
        i = int(cross[0])
        if grid[i + 1] - grid[i] <= 1e-12 * max(abs(grid[i]), 1e-3):
            break
        grid = np.linspace(grid[i], grid[i + 1], 64)
    x = float(grid[i] if abs(short[i]) <= abs(short[i + 1]) else grid[i + 1])
    if by_speed:
        assert pitch_rad is not None
        return hover(case, pitch_rad=pitch_rad, speed_rad_s=x, climb_m_s=climb_m_s, air=air, which=which)
    assert speed_rad_s is not None
    return hover(case, pitch_rad=x, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air, which=which)


# ----------------------------------------------------------------------------
# Hover and axial flight by the wake method, with the arguments of the blade element functions they stand beside.


Progress = Callable[[int, float, float], None]

_PAIR_BALANCED = (
    1e-3  # of the upper rotor's torque, or of the thrust asked for: what a converged wake can tell
)
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
    enough = max(_PAIR_BALANCED, how.tolerance)
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


# ----------------------------------------------------------------------------
# The pitch of the lower rotor at which the torques of a coaxial pair cancel, by either method.
#
# At given speeds a pair is balanced by pitch: ln(Q_lower / Q_upper) is a smooth, rising function of the lower pitch,
# close to a line, so secant steps find its root in three to six solutions. With a thrust both speeds are scaled by
# sqrt(T_wanted / T) after every step, their ratio kept: coefficients depend on speed through the Reynolds number
# only.


_TRIM_PITCH_TRIES = 25
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
    for _ in range(_TRIM_PITCH_TRIES):
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
        f"balances the torques in {_TRIM_PITCH_TRIES} tries; they still differ by {100 * abs(math.expm1(fault)):.2g} %"
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
