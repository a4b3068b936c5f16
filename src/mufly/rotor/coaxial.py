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

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.rotor.blading import Blading
from mufly.rotor.hover import Air, RotorResult, hover, induced_velocities

__all__ = ["CoaxialResult", "balance_torque", "coaxial", "tube_speed"]

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
