"""Solver of rotors on one shaft: operating points, trim and methods.

:func:`solve_system` takes a :class:`RotorSystem` (rotors, positions, senses of rotation), an
:class:`OperatingCondition` (pitch, speed, thrust, climb, air) and the name of a method: ``"bemt"``, blade element
momentum theory, milliseconds; ``"tubes"``, vortex tubes (:mod:`mufly.rotor.vortex_tube`); ``"wake"``, vortex wakes,
seconds. It finds the unknowns of the condition: the speed or the pitch at which a rotor gives a thrust, or the speed or
the pitch of the lower rotor of a pair at which the torques cancel.

Coupling of several rotors by blade elements: the wake of a rotor is a semi-infinite tube of ring vortices that starts
at its disc. For a disc of radius R with induced velocity v, the tube induces at distance z below the disc (above: z <
0) the velocity (Leishman, sec. 2.2; exact on the axis of a uniform tube)

    v(z) = v k(z),   k(z) = 1 + z / sqrt(R^2 + z^2)      0 far above, 1 at the disc, 2 far below

and by continuity a stream surface moves from r to r / sqrt(k). With h the distance between two discs:

* Inside R / sqrt(k(h)) the lower rotor is in the slipstream of the upper rotor. Its axial velocity is k v_u; its swirl
  has the moment of momentum of lift and profile drag (:func:`mufly.rotor.bemt.compute_slipstream`), against the motion
  of a lower rotor that turns the other way. Outside the slipstream the air is at rest.
* The upper rotor has the inflow k(-h) v_l of the lower rotor over its whole disc, because the stream widens upwards.
  Swirl does not propagate upwards.

The rotors are solved from the top down until the inflow from below converges; each iteration is one BEMT solution of
each rotor. The tube is that of the isolated upper rotor: the effect of the lower rotor on the shape of the upper wake
and the passing of blades are neglected. The streams of three or more rotors add up; no measurement of such systems has
been compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.root_finding import find_rising_root
from mufly.rotor.bemt import (
    compute_slipstream,
    solve_placed_rotor,
    solve_rotor,
    solve_rotor_batch,
    warn_reynolds_range,
)
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.rotor_system import (
    Air,
    OperatingCondition,
    PerRotor,
    PlacedRotor,
    RotorResult,
    RotorSystem,
    SolverMethod,
    SystemSolution,
    WakeSettings,
)
from mufly.rotor.validity_checks import (
    SUPERSONIC_TIP_REMEDY,
    check_pitch,
    compute_tip_mach,
    describe_supersonic_tips,
    warn_tip_mach,
    warn_upward_flow,
    warn_vortex_ring,
)
from mufly.rotor.vortex_tube import (
    compute_tube_axis_velocity_ratio,
    make_lower_rotor_swirl_matrix,
    make_stream_interpolation,
    solve_tubes,
)
from mufly.rotor.wake.wake_solver import solve_wake

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
ProgressCallback = Callable[[int, float, float], None]
PointSolver = Callable[
    [Sequence[float], Sequence[float], SystemSolution | None], SystemSolution
]  # pitches, speeds, similar result

_MAX_COUPLING_ITERATIONS = 200
_COUPLING_TOLERANCE = 1e-8  # of the greatest induced velocity
_BEMT_TRIM_TOLERANCE = 1e-7  # of the upper rotor's torque, or of the required thrust
_WAKE_TRIM_TOLERANCE = 1e-3  # of the same: accuracy of a converged wake
_TUBES_TRIM_TOLERANCE = 1e-4  # accuracy of converged tubes
_INITIAL_SPEED_GUESS_RAD_S = 300.0  # rad/s, first guess of the upper rotor's speed for a thrust
_MAX_THRUST_ITERATIONS, _MAX_SPEED_ITERATIONS, _MAX_PITCH_ITERATIONS = 8, 12, 25
_INITIAL_TORQUE_SLOPE_PER_RAD = 8.0  # 1/rad: torque grows about like pitch^1.5
_TORQUE_SLOPE_RANGE_PER_RAD = (1.0, 80.0)  # range of secant slopes of blades that do not stall
_MAX_PITCH_STEP_RAD = math.radians(4.0)
_PITCH_RANGE_RAD = (math.radians(-10.0), math.radians(45.0))

MAX_TIP_SPEED_M_S = 240.0
"""Tip speed (m/s) up to which the correction for compressible flow is valid: Mach 0.7."""


def solve_system(
    system: RotorSystem,
    condition: OperatingCondition,
    method: SolverMethod = "bemt",
    *,
    settings: WakeSettings | None = None,
    start: SystemSolution | None = None,
    progress: ProgressCallback | None = None,
) -> SystemSolution:
    """Solve a system of rotors; the condition decides the unknowns:

    ======================  =========================  ==========================================================
    one rotor               ``pitch``, ``speed``       the point
    .                       one of them, ``thrust_N``  the other one
    a pair                  pitches, speeds            the point
    .                       pitches, upper speed       the lower speed at which the torques cancel
    .                       pitches, ``thrust_N``      both speeds, torques cancelled
    .                       upper pitch, speeds        the lower pitch at which the torques cancel; with ``thrust_N``
                                                       the speeds are scaled at constant ratio
    ======================  =========================  ==========================================================

    Parameters
    ----------
    system : RotorSystem
    condition : OperatingCondition
        Given values.
    method : 'bemt', 'tubes' or 'wake'
    settings : WakeSettings, optional
        Settings of the wake method.
    start : SystemSolution, optional
        Similar result to start from; it saves time only.
    progress : callable, optional
        Called by the wake method with iteration, residual and thrust (N) of all rotors.

    Returns
    -------
    SystemSolution
        A wake at a given point that does not converge is returned with ``converged`` false and its history.

    Raises
    ------
    InputError
        If a condition is under- or overdetermined, a value is impossible, a thrust is out of reach, or wakes cannot be
        solved together (see :func:`mufly.rotor.wake.check_rotors`).
    MuflyError
        If blade elements do not converge, as in descents with the wakes blown back through the discs; if no torque
        balance is found, or a wake during the search does not converge.

    Examples
    --------
    >>> pair = RotorSystem.from_coaxial_pair(upper, lower, spacing_m=0.02)  # doctest: +SKIP
    >>> solve_system(pair, OperatingCondition(0.24, thrust_N=0.9)).power_W  # doctest: +SKIP

    Thesis: Sec. 3.3.
    """
    if method not in _METHOD_SOLVERS:
        raise InputError("rotor", "method", f"{method!r} is unknown", f"use one of: {', '.join(_METHOD_SOLVERS)}")
    count = len(system.bladings)
    pitch = _per_rotor_values("pitch_rad", condition.pitch_rad, count)
    speed = _per_rotor_values("speed_rad_s", condition.speed_rad_s, count)
    check_pitch("rotor", "pitch_rad", [p for p in pitch if p is not None])
    climb = condition.climb_m_s
    if math.isfinite(climb) and abs(climb) >= condition.air.sound_m_s:
        problem = f"{climb:g} m/s is Mach {abs(climb) / condition.air.sound_m_s:.2f}"
        raise ArgumentError("climb_m_s", "", problem, SUPERSONIC_TIP_REMEDY)
    for blading, which, given in zip(system.bladings, system.indices_in_blading, speed, strict=True):
        if given is not None:
            radius = blading.rotors[which].radius_m
            fault = describe_supersonic_tips(radius, given, condition.air, climb)
            if fault:
                raise ArgumentError("speed_rad_s", "", fault, SUPERSONIC_TIP_REMEDY)
            warn_tip_mach(compute_tip_mach(radius, given, condition.air, climb))
    found = _solve_unknowns(system, condition, method, pitch, speed, settings, start, progress)
    for blading, which, rotor in zip(system.bladings, system.indices_in_blading, found.rotors, strict=True):
        warn_reynolds_range(blading, which, rotor.speed_rad_s, condition.air)
    area = system.bladings[0].rotors[system.indices_in_blading[0]].disc_area_m2
    warn_vortex_ring(condition.climb_m_s, found.thrust_N, area, condition.air)
    return found


def _solve_unknowns(
    system: RotorSystem,
    condition: OperatingCondition,
    method: SolverMethod,
    pitch: tuple[float | None, ...],
    speed: tuple[float | None, ...],
    settings: WakeSettings | None,
    start: SystemSolution | None,
    progress: ProgressCallback | None,
) -> SystemSolution:
    """Find the unknowns of a condition; parameters as for :func:`solve_system`, with pitch and speed of each rotor."""
    count, thrust = len(system.bladings), condition.thrust_N

    def solve_point(pitches: Sequence[float], speeds: Sequence[float], start: SystemSolution | None) -> SystemSolution:
        return _METHOD_SOLVERS[method](
            system.place_rotors(pitches, speeds),
            condition.climb_m_s,
            condition.air,
            settings,
            start,
            progress,
        )

    known_pitch = tuple(p for p in pitch if p is not None)
    known_speed = tuple(s for s in speed if s is not None)
    if len(known_pitch) == len(known_speed) == count and thrust is None:
        return solve_point(known_pitch, known_speed, start)
    enough = {"bemt": _BEMT_TRIM_TOLERANCE, "tubes": _TUBES_TRIM_TOLERANCE}.get(
        method, max(_WAKE_TRIM_TOLERANCE, (settings or WakeSettings()).tolerance)
    )
    if count == 1:
        return _solve_for_thrust(solve_point, system, condition, pitch[0], speed[0], enough, start)
    if count != 2:
        raise InputError(
            "rotor", "", f"a system of {count} rotors cannot be trimmed", "give pitch and speed of each rotor"
        )
    if len(known_pitch) == 2:
        if thrust is not None and not 0.0 < thrust < math.inf:
            raise InputError("coaxial", "thrust_N", f"is {thrust:g}", "give a number above 0")
        if speed[1] is not None or (speed[0] is None) == (thrust is None):
            raise InputError("coaxial", "", "needs one of upper speed and thrust", "give one; the other is found")
        try:
            return _trim_by_secant(solve_point, known_pitch, speed[0], thrust, enough, start)
        except MuflyError:
            if method != "bemt":
                raise
        return _trim_by_bracketing(
            solve_point, known_pitch, speed[0], thrust, start
        )  # secant steps may diverge where blades stall
    if pitch[0] is None or len(known_speed) != 2:
        raise InputError("coaxial", "", "has more than one unknown", "give the upper pitch and both speeds")
    return _trim_lower_pitch(solve_point, pitch[0], known_speed, thrust, enough, start)


def solve_from_neighbour(solved: Callable[..., SystemSolution], neighbour: SystemSolution | None) -> SystemSolution:
    """Return ``solved(start=neighbour)``, or ``solved(start=None)`` if the first fails or does not converge."""
    if neighbour is not None:
        try:
            found = solved(start=neighbour)
        except InputError:
            raise
        except MuflyError:
            pass
        else:
            if found.converged:
                return found
    return solved(start=None)


def _per_rotor_values(name: str, value: PerRotor, count: int) -> tuple[float | None, ...]:
    """Return a tuple with the value of each rotor."""
    values = [value] * count if value is None or np.ndim(value) == 0 else list(value)  # type: ignore[arg-type]
    if len(values) != count:
        raise InputError(
            "rotor", name, f"has {len(values)} values for {count} rotors", "give one, or one for each rotor"
        )
    return tuple(None if v is None else float(v) for v in values)  # type: ignore[arg-type]


# Blade elements: rotors at a point


def _make_interference_matrix(source: PlacedRotor, target: PlacedRotor) -> Array:
    """Return the matrix from a rotor's axial induced velocities to those at another rotor's stations."""
    disc_radius = source.blading.rotors[source.index_in_blading].radius_m
    at_r, at_dr = target.blading.r_m[target.index_in_blading], target.blading.dr_m[target.index_in_blading]
    k = compute_tube_axis_velocity_ratio(source.height_m - target.height_m, disc_radius)
    return k * make_stream_interpolation(
        source.blading.r_m[source.index_in_blading], disc_radius, 1.0 / math.sqrt(k), at_r, at_dr
    )


def _solve_bemt(
    rotors: tuple[PlacedRotor, ...],
    climb_m_s: float,
    air: Air,
    settings: WakeSettings | None,
    start: SystemSolution | None,
    progress: ProgressCallback | None,
) -> SystemSolution:
    """Solve placed rotors by blade elements, each in the streams that the others induce."""
    if len(rotors) == 1:
        return SystemSolution((solve_placed_rotor(rotors[0], climb_m_s, air),), rotors, climb_m_s, air, "bemt")
    ways = {
        (a, b): _make_interference_matrix(p, q) for a, p in enumerate(rotors) for b, q in enumerate(rotors) if a != b
    }
    turned = {(a, b): make_lower_rotor_swirl_matrix(rotors[a], p) for b, p in enumerate(rotors) for a in range(b)}
    stations = [p.blading.r_m.shape[1] for p in rotors]
    cuts = np.cumsum(stations[:-1])[:-1]

    def iterate_streams(x: Array) -> tuple[Array, list[tuple[Array, Array]], float]:
        """Compute the streams from the top rotor down, given the velocities ``x`` that lower rotors induce above them.

        Returns the new ``x``, the stream that meets each rotor, and a velocity that scales the residual.
        """
        met: list[tuple[Array, Array]] = []
        given: list[tuple[Array, Array, Array]] = []
        for b, p in enumerate(rotors):
            axial = np.split(x, cuts)[b] if b < len(stations) - 1 else np.zeros(stations[b])
            around = np.zeros(stations[b])
            for a in range(b):
                axial = axial + ways[a, b] @ given[a][0]
                around = around + turned[a, b] @ given[a][2]
            met.append((axial, around))
            given.append(compute_slipstream(p, climb_m_s, air, (*met[b], met[b][0]), turns=b < len(rotors) - 1))
        pulled = [sum(ways[b, a] @ given[b][0] for b in range(a + 1, len(rotors))) for a in range(len(rotors) - 1)]
        return np.concatenate(pulled), met, sum(float(np.max(np.abs(v[0]))) for v in given)

    x = np.zeros(sum(stations[:-1]))
    if start is not None and [v.size for v in start.coupling_variables] == stations[:-1]:
        x = np.concatenate(start.coupling_variables)
    last_step, last_image = np.empty(0), np.empty(0)
    for turn in range(1, _MAX_COUPLING_ITERATIONS + 1):
        image, met, size = iterate_streams(x)
        step = image - x
        if np.max(np.abs(step)) <= _COUPLING_TOLERANCE * size:
            break
        # Anderson acceleration of depth one; limited to the plain half step where it would be too large.
        following = image
        if last_step.size:
            bend = step - last_step
            weight = float(bend @ step) / max(float(bend @ bend), 1e-300)
            following = image - weight * (image - last_image) if abs(weight) < 5.0 else x + 0.5 * step
        if turn > _MAX_COUPLING_ITERATIONS // 4:
            following = x + 0.2 * step
        last_step, last_image, x = step, image, following
    else:
        raise MuflyError(
            f"coaxial: the two rotors do not converge at {climb_m_s:g} m/s climb; "
            f"the inflow still changes by {np.max(np.abs(step)) / size:.1e} of its value per iteration; "
            + (
                "raise the pitch, or sink slower"
                if climb_m_s < 0.0
                else "raise the pitch, or bring the speeds together"
            )
        )
    found = tuple(solve_placed_rotor(p, climb_m_s, air, (*m, m[0])) for p, m in zip(rotors, met, strict=True))
    upper = found[0]
    through = climb_m_s + met[0][0] + upper.loss * upper.axial_induced_m_s
    warn_upward_flow(float(np.average(through, weights=upper.r_m * upper.dr_m)))
    return SystemSolution(
        found,
        rotors,
        climb_m_s,
        air,
        "bemt",
        True,
        f"settled in {turn} turns",
        turn,
        tuple(np.split(x, cuts)),
    )


_METHOD_SOLVERS = {"bemt": _solve_bemt, "tubes": solve_tubes, "wake": solve_wake}
METHODS = tuple(_METHOD_SOLVERS)


# One rotor: the speed or the pitch for a thrust


def solve_for_thrust(
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
    """Find the speed (at given pitch) or the pitch (at given speed) that gives a thrust, by blade elements.

    Give exactly one of ``pitch_rad`` and ``speed_rad_s``; the other is found to 1e-9 of its range. The search uses 64
    points between the limits, then the lowest interval that brackets the thrust. Of two pitches with the same thrust,
    below and beyond stall, the lower is therefore returned. Speeds are limited to :data:`MAX_TIP_SPEED_M_S` at the tip.

    Raises
    ------
    InputError
        If neither or both are given, or no value within the limits gives the thrust; the message states the greatest
        thrust.
    """
    if (pitch_rad is None) == (speed_rad_s is None):
        raise InputError("rotor", "thrust", "needs one of pitch and speed", "give one; the other is found")
    by_speed, case = speed_rad_s is None, ensure_blading(blading)
    fastest = MAX_TIP_SPEED_M_S / float(case.radius_m[which])
    low, high = (speed_limits_rad_s or (1.0, fastest)) if by_speed else pitch_limits_rad
    grid = np.geomspace(low, high, 64) if by_speed else np.linspace(low, high, 64)

    def make_solver_arguments(value: Any) -> dict[str, Any]:
        pitch, speed = (pitch_rad, value) if by_speed else (value, speed_rad_s)
        return {"pitch_rad": pitch, "speed_rad_s": speed, "climb_m_s": climb_m_s, "air": air, "which": which}

    for _ in range(8):  # each pass divides the interval by 63, to below 1e-13 of the first
        short = solve_rotor_batch(case, **make_solver_arguments(grid)).thrust_N - thrust_N
        cross = np.flatnonzero((short[:-1] <= 0.0) & (short[1:] >= 0.0))
        if cross.size == 0:
            key, unit = ("speed", "rad/s") if by_speed else ("pitch", "rad")
            least, most = float(short.min() + thrust_N), float(short.max() + thrust_N)
            below = thrust_N < least
            raise InputError(
                "rotor", "thrust",
                f"{thrust_N:g} N is out of reach: at {'least' if below else 'most'} {least if below else most:.4g} N",
                f"give {'more' if below else 'less'} thrust, or widen the {key} limits ({low:g} to {high:g} "
                f"{unit})",
            )  # fmt: skip
        i = int(cross[0])
        if grid[i + 1] - grid[i] <= 1e-12 * max(abs(grid[i]), 1e-3):
            break
        grid = np.linspace(grid[i], grid[i + 1], 64)
    return solve_rotor(
        case, **make_solver_arguments(float(grid[i] if abs(short[i]) <= abs(short[i + 1]) else grid[i + 1]))
    )


def _solve_for_thrust(
    at: PointSolver,
    system: RotorSystem,
    condition: OperatingCondition,
    pitch: float | None,
    speed: float | None,
    close: float,
    known: SystemSolution | None,
) -> SystemSolution:
    """Find pitch or speed of one rotor for a thrust.

    A wake is expensive, blade element momentum theory (BEMT) is cheap, and the ratio of their thrusts varies slowly.
    BEMT, scaled to the wake at the last point, therefore predicts the next point: with T_w / T_b the ratio at the last
    point, BEMT is solved for the thrust T_wanted T_b / T_w. Two or three wakes are sufficient.
    """
    thrust = condition.thrust_N
    if thrust is None or not math.isfinite(thrust):
        raise InputError("rotor", "", "needs two of pitch, speed and thrust", "give two; the third is found")
    wanted, reached = thrust, math.nan
    for _ in range(_MAX_THRUST_ITERATIONS):
        b = solve_for_thrust(
            system.bladings[0], thrust_N=wanted, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=condition.climb_m_s,
            air=condition.air, which=system.indices_in_blading[0],
        )  # fmt: skip
        known = at((b.pitch_rad,), (b.speed_rad_s,), known)
        if known.method == "bemt":
            return known
        if not thrust > 0.0:
            raise InputError("rotor", "thrust", f"is {thrust:g} N", "give a number above 0")
        reached = known.thrust_N
        if not known.converged or abs(reached / thrust - 1.0) <= close:
            return known
        if not reached > 0.0:
            break
        wanted = thrust * b.thrust_N / reached
    raise MuflyError(
        f"rotor: {thrust:g} N was not reached in {_MAX_THRUST_ITERATIONS} iterations; the last wake gives "
        f"{reached:.4g} N"
    )


# Two rotors: speeds or a pitch at which the torques cancel


def _trim_by_bracketing(
    at: PointSolver,
    pitch: Sequence[float],
    upper_speed: float | None,
    thrust_N: float | None,
    start: SystemSolution | None,
) -> SystemSolution:
    """Trim a pair by bracketing: find the lower rotor's speed or, with a thrust, both speeds.

    Bracketing is slower and more robust than secant steps.
    """
    known = [start]

    def solve_pair(up: float, low: float) -> SystemSolution:
        now = at(pitch, (up, low), known[0])
        known[0] = now
        return now

    def solve_torque_balance(up: float, guess: float) -> SystemSolution:
        return _find_root_solution(
            lambda x: solve_pair(up, up * x),
            lambda p: p.yaw_torque_Nm / abs(p.upper.torque_Nm),
            guess,
            "balances the torques",
        )

    if thrust_N is None:
        assert upper_speed is not None
        return solve_torque_balance(upper_speed, 1.0)
    first = solve_torque_balance(_INITIAL_SPEED_GUESS_RAD_S, 1.0)
    if not first.thrust_N > 0.0:
        raise MuflyError(f"coaxial: no thrust at 300 rad/s and these pitches, so {thrust_N:g} N is out of reach")
    ratio = first.lower.speed_rad_s / first.upper.speed_rad_s
    guess = _INITIAL_SPEED_GUESS_RAD_S * math.sqrt(thrust_N / first.thrust_N)
    return _find_root_solution(
        lambda x: solve_torque_balance(guess * x, ratio),
        lambda p: p.thrust_N / thrust_N - 1.0,
        1.0,
        f"gives {thrust_N:g} N",
    )


def _find_root_solution(
    solve_at: Callable[[float], SystemSolution], fault: Callable[[SystemSolution], float], guess: float, what: str
) -> SystemSolution:
    """Return the solution at which ``fault`` vanishes; ``solve_at`` takes a speed factor from 0.1 to 10."""
    found: list[SystemSolution] = []

    def root_function_at(factor: Array, case: Integers) -> Array:
        found[:] = [solve_at(float(factor[0]))]
        left = fault(found[0])
        return np.array([0.0 if abs(left) < _BEMT_TRIM_TOLERANCE else left])

    _, settled = find_rising_root(root_function_at, [guess], lowest=0.1, highest=10.0)
    if not settled[0]:
        raise MuflyError(f"coaxial: no speed {what} between a tenth and ten times the first guess")
    return found[0]


def _trim_by_secant(
    at: PointSolver, pitch: Sequence[float], upper_speed: float | None, thrust_N: float | None, close: float,
    known: SystemSolution | None,
) -> SystemSolution:  # fmt: skip
    """Trim a pair as :func:`_trim_by_bracketing` does, but by secant steps.

    Each step starts from the previous wake, because a solution is expensive.
    """
    up = upper_speed if upper_speed is not None else _INITIAL_SPEED_GUESS_RAD_S
    ratio = 1.1
    torque_slope = None
    last: tuple[float, float] | None = None
    for _ in range(_MAX_SPEED_ITERATIONS):
        known = at(pitch, (up, up * ratio), known)
        if not known.converged:
            raise MuflyError(
                f"coaxial: at {up:.4g} and {up * ratio:.4g} rad/s the wake is {known.message}; try a larger core_limit"
            )
        total = known.thrust_N
        fault = math.log(max(known.lower.torque_Nm, 1e-12) / max(known.upper.torque_Nm, 1e-12))
        short = 0.0 if thrust_N is None else math.log(thrust_N / total) if total > 0.0 else math.nan
        if not (math.isfinite(fault) and math.isfinite(short)):
            raise MuflyError("coaxial: no thrust at these pitches, so no speed gives the required thrust")
        if abs(fault) <= close and abs(short) <= close:
            return known
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
        f"coaxial: no balance found in {_MAX_SPEED_ITERATIONS} tries; the torques still differ by {100 * fault:.2g} %"
    )


def _trim_lower_pitch(
    at: PointSolver,
    upper_pitch: float,
    speed: Sequence[float],
    thrust_N: float | None,
    close: float,
    start: SystemSolution | None,
) -> SystemSolution:
    """Find the lower pitch at which the torques cancel.

    ln(Q_lower / Q_upper) is a smooth, rising function of the lower pitch, close to a line, so secant steps find its
    root in three to six solutions. With a thrust both speeds are scaled by sqrt(T_wanted / T) after every step at
    constant ratio: coefficients depend on speed through the Reynolds number only.
    """
    if thrust_N is not None and not 0.0 < thrust_N < math.inf:
        raise InputError("coaxial", "thrust_N", f"is {thrust_N:g}", "give a number above 0")
    pitch, factor, slope = upper_pitch, 1.0, _INITIAL_TORQUE_SLOPE_PER_RAD
    last: tuple[float, float] | None = None
    fault = math.nan
    for _ in range(_MAX_PITCH_ITERATIONS):
        now = at((upper_pitch, pitch), (factor * speed[0], factor * speed[1]), start)
        if not now.converged:
            raise MuflyError(f"coaxial: at {math.degrees(pitch):.2f} degrees below the wake is {now.message}")
        if now.method == "wake":
            start = now
        if not now.upper.torque_Nm > 0.0:
            raise MuflyError("coaxial: the upper rotor takes no torque at this pitch, so no balance exists")
        if thrust_N is not None and not now.thrust_N > 0.0:
            raise MuflyError("coaxial: no thrust at these pitches, so no speed gives the required thrust")
        fault = math.log(max(now.lower.torque_Nm / now.upper.torque_Nm, 1e-3))
        short = 0.0 if thrust_N is None else math.log(thrust_N / now.thrust_N)
        if abs(fault) <= close and abs(short) <= close:
            return now
        if last is not None and abs(pitch - last[0]) > 1e-7:
            slope = min(
                max((fault - last[1]) / (pitch - last[0]), _TORQUE_SLOPE_RANGE_PER_RAD[0]),
                _TORQUE_SLOPE_RANGE_PER_RAD[1],
            )
        last = (pitch, fault)
        pitch -= max(min(fault / slope, _MAX_PITCH_STEP_RAD), -_MAX_PITCH_STEP_RAD)
        pitch = min(max(pitch, _PITCH_RANGE_RAD[0]), _PITCH_RANGE_RAD[1])
        factor *= math.exp(max(min(0.5 * short, 1.0), -1.0))
    raise MuflyError(
        f"coaxial: no lower pitch between {math.degrees(_PITCH_RANGE_RAD[0]):.0f} and "
        f"{math.degrees(_PITCH_RANGE_RAD[1]):.0f} degrees "
        f"balances the torques in {_MAX_PITCH_ITERATIONS} tries; they still differ by "
        f"{100 * abs(math.expm1(fault)):.2g} %"
    )
