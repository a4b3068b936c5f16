"""The wake method: one rotor, or two that turn against each other, with prescribed or free wakes.

In steady hover or climb a rotor's wake stands still in the frame that turns with it. A filament's points there obey

    dX/dzeta = (v(X) - V_climb z) / Omega  -  z x X          zeta: age, an angle; X = trailing edge at zeta = 0

with v induced by every vortex of every blade (:mod:`.kernel`). The fixed point is found by relaxation: circulation of
the blades (:mod:`.blade`), velocities at all points, integration along the filaments by the trapezium rule in a frame
that turns with the age (so a rigid helix is exact), and a step of the points towards the result. The N blades of a
rotor are one blade seen N times.

Two rotors: each wake stands still in its own rotor's frame only, so what one rotor induces at the other's blades and
wake is averaged over their relative azimuth; over a revolution the blades see just that. What the passing of blades
adds to the mean is :func:`mufly.rotor.wake.phase.blade_passing`. A rotor that turns clockwise is solved as its mirror
image.

Cost of an iteration: (points of one blade) x (segments of all blades), quadratic in the number of wake elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mufly.rotor.hover import Air
from mufly.rotor.wake.blade import BladeState, turned
from mufly.rotor.wake.result import Placed, WakeSettings, WakeSolution, check_rotors
from mufly.rotor.wake.shape import prescribed
from mufly.rotor.wake.unit import Unit, from_other, rotor_result, solve_blade, wake_of

__all__ = ["first_shape", "solve"]

Array = NDArray[np.float64]

_MEMORY = 10
_CORE_LIMITS = (0.15, 0.25, 0.35)  # R; the next one is tried where a wake does not settle
_PAIR_CORE_LIMITS = (0.2, 0.3, 0.4)
_DAMPING_RAD = 4.0 * math.pi
_THICK, _THINNING = 0.4, 15.0  # core limit (R) at first; iterations in which it fades
_LAG = 3  # iterations between updates of what the other rotor does to the wake's points; it changes slowly
_LONGEST_STEP = 0.15  # R; a point never goes farther in one iteration
_PRESCRIBED_FIRST = 6  # iterations with Landgrebe's wake before the free wake is let go


def _convected(unit: Unit, velocity: Array, climb: float) -> tuple[Array, float]:
    """Where the air takes the points, and how far the wake is from standing still.

    The first is the integral along the filaments from the trailing edge; the second the mismatch of dX/dzeta and the
    velocity over the velocity, root mean squares.
    """
    s = unit.surface
    step = unit.age[1] - unit.age[0]
    v = velocity / s.speed_rad_s
    v[..., 2] -= climb / s.speed_rad_s
    moved = 0.5 * step * (v[:, :-1] + turned(v, step)[:, 1:])
    out = np.empty_like(unit.free)
    out[:, 0] = s.edge_tail_m
    for k in range(unit.age.size - 1):
        out[:, k + 1] = turned(out[:, k] + moved[:, k], -step)
    still = unit.free[:, 1:] - turned(unit.free[:, :-1] + moved, -step)
    size = max(float(np.mean(np.sum(moved**2, axis=2))), 1e-30)
    return out, math.sqrt(float(np.mean(np.sum(still**2, axis=2))) / size)


def _c_T(unit: Unit, air: Air) -> float:
    s = unit.surface
    return unit.thrust / (air.density_kg_m3 * math.pi * s.radius_m**4 * s.speed_rad_s**2)


def first_shape(units: Sequence[Unit], start: WakeSolution | None, climb: float) -> None:
    """Give units the wakes of a similar solution, scaled, or prescribed ones."""
    for k, unit in enumerate(units):
        s = unit.surface
        known = start.wakes[k] if start is not None and k < len(start.wakes) else None
        if known is not None and known.free_points == unit.age.size and len(known.paths_m) == len(unit.free):
            free = known.paths_m[:, 1 : 1 + unit.age.size].copy()
            free[..., 1] *= unit.placed.hand
            free[..., 2] -= known.placed.height_m
            unit.free = free * (s.radius_m / known.surface.radius_m)
            gamma = known.circulation_m2_s * (
                s.speed_rad_s * s.radius_m**2 / (known.surface.speed_rad_s * known.surface.radius_m**2)
            )
            unit.state = BladeState(gamma, gamma, gamma, gamma, gamma, True)
            unit.free[:, 0] = s.edge_tail_m
        else:
            sigma = s.blades * float(np.sum(s.chord_m * s.width_m)) / (math.pi * s.radius_m**2)
            unit.free = prescribed(s, unit.age, 0.06 * sigma, None, climb)


def solve(
    rotors: Sequence[Placed],
    *,
    air: Air | None = None,
    climb_m_s: float = 0.0,
    settings: WakeSettings | None = None,
    start: WakeSolution | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> WakeSolution:
    """Solve one rotor, or two around each other.

    Parameters
    ----------
    rotors : sequence of Placed
        One, or two with opposite hands and different heights.
    air : Air, optional
    climb_m_s : float
        Axial speed through the air, positive in climb.
    settings : WakeSettings, optional
    start : WakeSolution, optional
        A similar solution to start from; saves iterations.
    progress : callable, optional
        Called with iteration, residual and thrust (N) of all rotors.

    Raises
    ------
    InputError
        If the rotors cannot be: no speed, the same place, the same sense of rotation, blades without chord.

    Notes
    -----
    A solution that does not converge is returned, marked so, with its history.
    """
    gas, how = air or Air(), settings or WakeSettings()
    check_rotors(rotors, climb_m_s)
    if how.core_limit is not None or how.model == "prescribed":
        how = replace(how, core_limit=how.core_limit if how.core_limit is not None else _CORE_LIMITS[0])
        return _attempt(rotors, gas, climb_m_s, how, start, progress)
    limits: tuple[float, ...] = _CORE_LIMITS if len(rotors) == 1 else _PAIR_CORE_LIMITS
    if start is not None and start.settings.core_limit in limits:
        limits = limits[limits.index(start.settings.core_limit) :]
    for limit in limits:
        solution = _attempt(rotors, gas, climb_m_s, replace(how, core_limit=limit), start, progress)
        if solution.converged:
            break
        start = None
    return solution


def _attempt(
    rotors: Sequence[Placed], gas: Air, climb_m_s: float, how: WakeSettings, start: WakeSolution | None,
    progress: Callable[[int, float, float], None] | None,
) -> WakeSolution:  # fmt: skip
    """Solve with one core limit, from a similar solution or from a prescribed wake."""
    nu = gas.viscosity_Pa_s / gas.density_kg_m3
    units = [Unit(p, how) for p in rotors]
    first_shape(units, start, climb_m_s)
    free = how.model == "free"
    history: list[list[float]] = []
    message, converged, residual = "", False, math.inf
    limit = how.core_limit or 0.0
    for turn in range(how.iterations):
        # Thick cores first: a wake that is still far off would otherwise wind itself up.
        now = replace(
            how, core_limit=limit + max(_THICK - limit, 0.0) * math.exp(-turn / _THINNING) * (start is None)
        )
        for unit in units:
            unit.lay_out(now, nu)
        for unit in units:
            others = np.zeros_like(unit.sensors)
            for source in units:
                if source is not unit and source.state is not None:
                    others += from_other(unit, source, unit.sensors, how.phases)
            solve_blade(unit, others, gas, climb_m_s, how)
            unit.refresh(now, nu)
        residuals = []
        for unit in units:
            if free and turn >= _PRESCRIBED_FIRST * (start is None):
                points = unit.free.reshape(-1, 3)
                if len(units) > 1 and (unit.from_others is None or turn % _LAG == 0):
                    other = units[0] if unit is units[1] else units[1]
                    unit.from_others = from_other(unit, other, points, how.phases)
                v = unit.velocity(points)
                if unit.from_others is not None:
                    v += unit.from_others
                aim, far_off = _convected(unit, v.reshape(unit.free.shape), climb_m_s)
                part = how.relaxation / (1.0 + unit.age / (_DAMPING_RAD))
                step = part[:, None] * (aim - unit.free)
                length = np.linalg.norm(step, axis=2, keepdims=True)
                step *= np.minimum(1.0, _LONGEST_STEP * unit.surface.radius_m / np.maximum(length, 1e-300))
                unit.next = unit.free + step
            else:
                assert unit.state is not None
                c_T = _c_T(unit, gas)
                aim = prescribed(unit.surface, unit.age, c_T, unit.state.circulation, climb_m_s)
                unit.next = unit.free + 0.4 * (aim - unit.free)
                far_off = math.sqrt(np.mean(np.sum((aim - unit.free) ** 2, axis=2))) / unit.surface.radius_m
                far_off += 10.0 * free  # not yet the wake that was asked for
            residuals.append(far_off)
        residual = float(max(residuals))
        history.append([residual, *(x for u in units for x in (u.thrust, u.torque))])
        if progress is not None:
            progress(turn + 1, residual, sum(u.thrust for u in units))
        message = _diverged(history, how)
        if message:
            break
        converged = (
            turn > 3.0 * _THINNING * (start is None)
            and residual <= how.residual
            and _steady(history, how.tolerance)
        )
        if converged:
            message = f"converged after {turn + 1} iterations, core limit {limit:g} R"
            break
        for unit in units:
            unit.free = unit.next
    else:
        message = (
            f"not converged in {how.iterations} iterations: the wake misses the air by {100 * residual:.1f} % of its "
            f"velocity, thrust or torque moves by {100 * _spread(history):.2f} %"
        )
    rows = np.array(history)
    return WakeSolution(
        rotors=tuple(rotor_result(u, gas, climb_m_s) for u in units),
        wakes=tuple(wake_of(u) for u in units),
        converged=converged,
        message=message,
        residual=residual,
        iterations=len(history),
        history=rows,
        settings=how,
        air=gas,
        climb_m_s=climb_m_s,
    )


def _spread(history: list[list[float]]) -> float:
    """Greatest change of a thrust or torque over the last iterations, over the mean's size."""
    last = np.array(history[-_MEMORY:])[:, 1:]
    middle = np.abs(last.mean(axis=0)) + 1e-3 * np.abs(last).max() + 1e-300
    return float(np.max((last.max(axis=0) - last.min(axis=0)) / middle))


def _steady(history: list[list[float]], tolerance: float) -> bool:
    return len(history) >= _MEMORY and _spread(history) <= tolerance


def _diverged(history: list[list[float]], how: WakeSettings) -> str:
    now = np.array(history[-1])
    if not np.all(np.isfinite(now)) or now[0] > 1e3:
        return f"diverged in iteration {len(history)}: the history is kept"
    return ""
