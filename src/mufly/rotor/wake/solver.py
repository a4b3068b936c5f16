"""The wake method: one rotor, or two that turn against each other, with prescribed or free wakes.

In steady hover or climb a rotor's wake stands still in the frame that turns with it. A filament's points there obey

    dX/dzeta = (v(X) - V_climb z) / Omega  -  z x X          zeta: age, an angle; X = trailing edge at zeta = 0

with v induced by every vortex of every blade (:mod:`.kernel`). The fixed point is found by relaxation: circulation of
the blades (:mod:`.blade`), velocities at all points, integration along the filaments by the trapezium rule in a frame
that turns with the age (so a rigid helix is exact), and a step of the points towards the result. The N blades of a
rotor are one blade seen N times.

Two rotors: each wake stands still in its own rotor's frame only, so what one rotor induces at the other's blades and
wake is averaged over their relative azimuth; over a revolution the blades see just that. What the passing of blades
adds to the mean is :func:`mufly.rotor.wake.field.blade_passing`. The lower one meets the turning that profile drag
left in the stream above it as well (:func:`drag_swirl`), which no vortex carries. A rotor that turns clockwise is
solved as its mirror image.

Cost of an iteration: (points of one blade) x (segments of all blades), quadratic in the number of wake elements.

A rotor while it is being solved: its vortices, what they induce, and the circulation of its blades.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mufly.rotor.bemt import drag_turning, result_of
from mufly.rotor.system import Air, Placed, Result, RotorResult, Surface, Wake, WakeSettings, check_rotors
from mufly.rotor.tubes import turning_reading
from mufly.rotor.wake.blade import (
    BladeState,
    ages_of,
    blade_loads,
    bound_influence,
    core_radii,
    extended,
    leg_points,
    of_all_blades,
    prescribed,
    solve_circulation,
    surface_of,
    turned,
)
from mufly.rotor.wake.kernel import induce, influence, segments_of

Array = NDArray[np.float64]

_MEMORY = 10
_CORE_LIMITS = (0.15, 0.25, 0.35)  # R; the next one is tried where a wake does not settle
_PAIR_CORE_LIMITS = (0.2, 0.3, 0.4)
_WINDOW = 30  # iterations over which a wake that wanders is averaged
_WANDER = 0.02  # of the loads; a wake that moves them by more winds up
_DAMPING_RAD = 4.0 * math.pi
_THICK, _THINNING = 0.4, 15.0  # core limit (R) at first; iterations in which it fades
_LOOSE = 2.0  # times the residual that a wake which wanders may have
_LAG = 3  # iterations between updates of what the other rotor does to the wake's points; it changes slowly
_SWIRL_STEP = 0.3  # of the way to what it would be, every _LAG iterations
_USUAL = 0.06  # c_T over solidity, before anything is known
_ROLLS = 0.05  # R: height above the ground below which no vortex comes
_MEAN_CHORD = math.radians(15.0)  # of a wake whose mean over azimuths is wanted
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


def _down_the_shaft(velocity: Array) -> None:
    """Let a pair's root vortices go down no slower than the sheet beside them; velocities (edges, points, 3) in place.

    Coils of a root vortex blow upwards through their middle, where hub and shaft are. With free air there the upper
    rotor's settles in either of two ways: down, or up through its disc and away, as nothing can that a blade has shed
    into air that comes down; the upper thrust is then 3 to 4 % higher.
    """
    velocity[0, :, 2] = np.minimum(velocity[0, :, 2], velocity[1, :, 2])


def _c_T(unit: Unit, air: Air) -> float:
    s = unit.surface
    return unit.thrust / (air.density_kg_m3 * math.pi * s.radius_m**4 * s.speed_rad_s**2)


def first_shape(units: Sequence[Unit], start: Result | None, climb: float) -> None:
    """Give units the wakes of a similar solution, scaled, or prescribed ones."""
    for k, unit in enumerate(units):
        s = unit.surface
        known = start.wakes[k] if start is not None and k < len(start.wakes) else None
        if (
            start is not None
            and known is not None
            and known.paths_m.shape[0] == len(unit.free)
            and (known.free_points == unit.age.size)
        ):
            free = known.paths_m[:, 1 : 2 + known.chords * (known.free_points - 1) : known.chords].copy()
            free[..., 1] *= unit.placed.hand
            free[..., 2] -= known.placed.height_m
            unit.free = free * (s.radius_m / known.surface.radius_m)
            gamma = known.circulation_m2_s * (
                s.speed_rad_s * s.radius_m**2 / (known.surface.speed_rad_s * known.surface.radius_m**2)
            )
            was = start.rotors[k]
            faster = s.speed_rad_s * s.radius_m / (known.surface.speed_rad_s * known.surface.radius_m)
            nu = start.air.viscosity_Pa_s / start.air.density_kg_m3
            speed = faster * nu * was.reynolds / known.surface.chord_m
            unit.state = BladeState(gamma, was.alpha_rad, was.cl, was.cd, speed, True)
            unit.free[:, 0] = s.edge_tail_m
        else:
            sigma = s.blades * float(np.sum(s.chord_m * s.width_m)) / (math.pi * s.radius_m**2)
            unit.free = unit.above_ground(prescribed(s, unit.age, _USUAL * sigma, None, climb))


def solve_wake(
    rotors: Sequence[Placed],
    climb_m_s: float = 0.0,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    start: Result | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> Result:
    """Solve one rotor, or two around each other, in their places; :func:`mufly.rotor.solve` is the way to it.

    Parameters
    ----------
    rotors : sequence of Placed
        One, or two with opposite hands and different heights.
    climb_m_s : float
        Axial speed through the air, positive in climb.
    air : Air, optional
    settings : WakeSettings, optional
    start : Result, optional
        A similar result to start from, if it has wakes; saves iterations.
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
    start = start if start is not None and start.wakes else None
    check_rotors(rotors, climb_m_s)
    if how.ground_m is not None:
        how = replace(
            how, far_turns=min(how.far_turns, max(_turns_to(how.ground_m, rotors) - how.turns, 1.0))
        )
    if how.core_limit is not None or how.model == "prescribed":
        how = replace(how, core_limit=how.core_limit if how.core_limit is not None else _CORE_LIMITS[0])
        return _attempt(rotors, gas, climb_m_s, how, start, progress)
    limits: tuple[float, ...] = _CORE_LIMITS if len(rotors) == 1 else _PAIR_CORE_LIMITS
    if start is not None and start.settings is not None and start.settings.core_limit in limits:
        limits = limits[limits.index(start.settings.core_limit) :]
    for limit in limits:
        solution = _attempt(rotors, gas, climb_m_s, replace(how, core_limit=limit), start, progress)
        if solution.converged:
            break
        start = None
    return solution


def _turns_to(ground_m: float, rotors: Sequence[Placed]) -> float:
    """Turns after which Landgrebe's tip vortex of the lowest rotor is on the ground, at a usual loading.

    Below, helices would lie on the ground one on the other, and the wake does not settle.
    """
    lowest = min(rotors, key=lambda p: p.height_m)
    rotor = lowest.blading.rotors[lowest.which]
    per_turn = 2.0 * math.pi * 1.41 * math.sqrt(0.5 * _USUAL * rotor.solidity) * rotor.radius_m
    return (ground_m + lowest.height_m) / per_turn


def _attempt(
    rotors: Sequence[Placed], gas: Air, climb_m_s: float, how: WakeSettings, start: Result | None,
    progress: Callable[[int, float, float], None] | None,
) -> Result:  # fmt: skip
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
                    if turn % _LAG == 0:
                        left = drag_swirl(unit, source, climb_m_s, how.phases)
                        # Slowly, or it chases a wake that is still moving.
                        unit.swirl += (_SWIRL_STEP if unit.swirl.any() else 1.0) * (left - unit.swirl)
                    others += unit.swirl
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
                    if unit.thrust > 0.0:  # else its coils blow the other way
                        _down_the_shaft(v.reshape(unit.free.shape))
                aim, far_off = _convected(unit, v.reshape(unit.free.shape), climb_m_s)
                aim = unit.above_ground(aim)
                part = how.relaxation / (1.0 + unit.age / (_DAMPING_RAD))
                step = part[:, None] * (aim - unit.free)
                length = np.linalg.norm(step, axis=2, keepdims=True)
                step *= np.minimum(1.0, _LONGEST_STEP * unit.surface.radius_m / np.maximum(length, 1e-300))
                unit.next = unit.free + step
            else:
                assert unit.state is not None
                c_T = _c_T(unit, gas)
                aim = prescribed(unit.surface, unit.age, c_T, unit.state.circulation, climb_m_s)
                aim = unit.above_ground(aim)
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
        if turn > 3.0 * _THINNING * (start is None):
            converged = residual <= how.residual and _steady(history, how.tolerance)
            if converged:
                message = f"converged after {turn + 1} iterations, core limit {limit:g} R"
                break
            from_here = history[round(3.0 * _THINNING) * (start is None) :]
            converged = residual <= _LOOSE * how.residual and _steady_in_the_mean(from_here, how.tolerance)
            if converged:
                wander = 100.0 * _spread(history, 2 * _WINDOW)
                message = (
                    f"converged in the mean after {turn + 1} iterations, loads wander by {wander:.2f} %, "
                    f"core limit {limit:g} R"
                )
                break
        for unit in units:
            unit.free = unit.next
    else:
        message = (
            f"not converged in {how.iterations} iterations: the wake misses the air by {100 * residual:.1f} % of its "
            f"velocity, thrust or torque moves by {100 * _spread(history):.2f} %"
        )
    return Result(
        rotors=tuple(rotor_result(u, gas, climb_m_s) for u in units),
        placed=tuple(rotors),
        climb_m_s=climb_m_s,
        air=gas,
        method="wake",
        converged=converged,
        message=message,
        iterations=len(history),
        wakes=tuple(wake_of(u) for u in units),
        settings=how,
        residual=residual,
        history=np.array(history),
    )


def _spread(history: list[list[float]], memory: int = _MEMORY) -> float:
    """Greatest change of a thrust or torque over the last iterations, over the mean's size."""
    last = np.array(history[-memory:])[:, 1:]
    middle = np.abs(last.mean(axis=0)) + 1e-3 * np.abs(last).max() + 1e-300
    return float(np.max((last.max(axis=0) - last.min(axis=0)) / middle))


def _steady(history: list[list[float]], tolerance: float) -> bool:
    return len(history) >= _MEMORY and _spread(history) <= tolerance


def _steady_in_the_mean(history: list[list[float]], tolerance: float) -> bool:
    """True if the wake only wanders: two windows have the same means, the loads of now are those means.

    Old vortices pair and part for ever, in a real wake as in this one; the loads of each iteration then lie about means
    that do not depend on how far points go in an iteration.
    """
    if len(history) < 2 * _WINDOW or _spread(history, 2 * _WINDOW) > _WANDER:
        return False
    last = np.array(history[-2 * _WINDOW :])[:, 1:]
    mean = last.mean(axis=0)
    size = np.abs(mean) + 1e-3 * np.abs(last).max() + 1e-300
    apart = np.abs(last[:_WINDOW].mean(axis=0) - last[_WINDOW:].mean(axis=0)) / size
    return bool(np.all(apart <= tolerance) and np.all(np.abs(last[-1] - mean) <= 0.5 * tolerance * size))


def _diverged(history: list[list[float]], how: WakeSettings) -> str:
    now = np.array(history[-1])
    if not np.all(np.isfinite(now)) or now[0] > 1e3:
        return f"diverged in iteration {len(history)}: the history is kept"
    return ""


class Unit:
    """A rotor while it is being solved, in its own frame: counter-clockwise, hub at the origin."""

    def __init__(self, placed: Placed, settings: WakeSettings) -> None:
        self.placed = placed
        self.surface = surface_of(placed.blading, placed.which, placed.pitch_rad, placed.speed_rad_s)
        s = self.surface
        n = s.chord_m.size
        self.induce = induce
        if settings.gpu:
            from mufly.rotor.wake.gpu import induce_gpu

            self.induce = induce_gpu
        self.age = ages_of(settings.turns, math.radians(settings.step_deg))
        self.parts = max(round(settings.step_deg / settings.chord_deg), 1)
        self.free = np.empty((n + 1, self.age.size, 3))
        ground = math.inf if settings.ground_m is None else settings.ground_m
        self.floor = -(ground + placed.height_m)
        self.sensors = np.concatenate([s.control_m, s.quarter_m, leg_points(s)])
        self.bound = self.with_image(self.sensors, lambda p: bound_influence(s, p))
        # Circulation of the filament at edge j, towards the wake: what the inboard panel brings less the next one's.
        self.shed = np.zeros((n + 1, n))
        self.shed[np.arange(n), np.arange(n)] = -1.0
        self.shed[np.arange(1, n + 1), np.arange(n)] = 1.0
        self.state: BladeState | None = None
        self.wind_quarter = np.zeros((n, 3))
        self.next = self.free
        self.from_others: Array | None = None  # velocity at the free points
        self.swirl = np.zeros_like(self.sensors)  # of the other rotor's profile drag
        self.thrust, self.torque = 0.0, 0.0
        self.dT, self.dQ = np.zeros(n), np.zeros(n)

    def with_image(self, points: Array, velocity: Callable[[Array], Array]) -> Array:
        """Velocity of vortices at points, and of what the ground mirrors of them: v(x) + M v(M x), M: z about it."""
        v = velocity(points)
        if math.isfinite(self.floor):
            below = points.copy()
            below[:, 2] = 2.0 * self.floor - below[:, 2]
            v += velocity(below) * [1.0, 1.0, -1.0]
        return v

    def above_ground(self, points: Array) -> Array:
        """Points, those in the ground lifted to where a vortex rolls on it."""
        if math.isfinite(self.floor):
            points[..., 2] = np.maximum(points[..., 2], self.floor + _ROLLS * self.surface.radius_m)
        return points

    def strength(self) -> Array:
        return self.shed @ self.state.circulation if self.state is not None else np.zeros(self.shed.shape[0])

    def lay_out(self, settings: WakeSettings, viscosity: float) -> None:
        """Whole filaments with cores, and the segments that everybody feels, for the present circulation."""
        self.paths, self.path_age = extended(
            self.surface,
            self.free,
            self.age,
            settings.far_turns,
            math.radians(settings.far_step_deg),
            self.parts,
        )
        self.paths = self.above_ground(self.paths)
        # The same in few chords, on radii that give their polygons the area of the arcs.
        end = 1 + self.parts * (self.age.size - 1)
        far = np.unique(np.append(np.arange(end, self.path_age.size, 2), self.path_age.size - 1))
        piece = (self.age[1] - self.age[0]) / self.parts
        skip = max(round(_MEAN_CHORD / piece), 1)
        kept = np.concatenate([[0], np.arange(1, end, skip), far])
        self.few_paths, self.few_age = self.paths[:, kept], self.path_age[kept]
        chord, far_chord = skip * piece, math.radians(settings.far_step_deg)
        self.few_paths[:, 2:, :2] *= np.where(
            kept[2:, None] > end, 1.0 / math.sqrt(math.cos(far_chord)), math.sqrt(chord / math.sin(chord))
        )
        self.refresh(settings, viscosity)

    def refresh(self, settings: WakeSettings, viscosity: float) -> None:
        strength = self.strength()
        limit = settings.core_limit or 0.0
        self.core = core_radii(self.surface, self.path_age, strength, viscosity, settings.core, limit)
        gamma = self.state.circulation if self.state is not None else np.zeros(self.shed.shape[1])
        self.segments = vortices_of(self.surface, self.paths, self.core, strength, gamma)
        core = core_radii(self.surface, self.few_age, strength, viscosity, settings.core, limit)
        self.few_segments = vortices_of(self.surface, self.few_paths, core, strength, gamma)

    def velocity(self, points: Array, *, few: bool = False) -> Array:
        """What this rotor induces at points of its own frame; ``few``: its wake in few chords."""
        vortices = self.few_segments if few else self.segments
        return self.with_image(
            points, lambda x: of_all_blades(x, self.surface.blades, lambda p: self.induce(p, vortices))
        )


def vortices_of(
    surface: Surface, paths: Array, core: Array, strength: Array, circulation: Array
) -> tuple[Array, Array, Array, Array]:
    """All vortices of one blade as segments: trailing filaments, bound vortices, and what closes them at the far end.

    Vortex lines do not end; the closing segments lie where the far wake is cut off. Wake points may pass close below a
    blade: to them the bound vortex has the core of a thick section, a tenth of the chord.
    """
    edge, ends = surface.edge_quarter_m, paths[:, -1]
    unit = np.ones(circulation.size)
    bound = segments_of(np.stack([edge[:-1], edge[1:]], axis=1), 0.1 * surface.chord_m[:, None], unit)
    closing = segments_of(np.stack([ends[1:], ends[:-1]], axis=1), core[1:, -1:], unit)
    parts = [segments_of(paths, core, strength)]
    parts += [(a, b, unit * circulation, c) for a, b, unit, c in (bound, closing)]
    start, end, strengths, cores = (np.concatenate(p, axis=-1) for p in zip(*parts, strict=True))
    return start, end, strengths, cores


def trailing(unit: Unit) -> Array:
    """Velocity at a rotor's own control and quarter chord points per circulation of its panels, blades and wake."""
    legs = unit.with_image(
        unit.sensors,
        lambda x: of_all_blades(x, unit.surface.blades, lambda p: influence(p, unit.paths, unit.core)),
    )
    return unit.bound + np.einsum("ijc,jk->ikc", legs, unit.shed)


def _into(points: Array, of: Unit, other: Unit) -> Array:
    """Points of one rotor's frame in another's (both at azimuth zero)."""
    moved = points.copy()
    moved[..., 1] *= of.placed.hand * other.placed.hand
    moved[..., 2] += of.placed.height_m - other.placed.height_m
    return moved


def from_other_at(
    target: Unit, source: Unit, points: Array, azimuth_rad: float, *, few: bool = False
) -> Array:
    """Velocity at points of the target's frame that another rotor induces when its blade 1 has turned by an azimuth."""
    there = _into(points, target, source)
    v = turned(source.velocity(turned(there, -azimuth_rad), few=few), azimuth_rad)
    v[..., 1] *= target.placed.hand * source.placed.hand
    return v


def from_other(target: Unit, source: Unit, points: Array, phases: int) -> Array:
    """The same, averaged over the relative azimuth, which smears the source's vortices anyway: in few chords."""
    step = 2.0 * math.pi / (phases * source.surface.blades)
    total = np.zeros_like(points)
    for k in range(phases):
        total += from_other_at(target, source, points, (k + 0.5) * step, few=True)
    return total / phases


def drag_swirl(target: Unit, source: Unit, climb: float, phases: int) -> Array:
    """Velocity at a rotor's sensors by the turning that the profile drag of the one above gave to its stream (m/s).

    Vortices carry only the turning that comes with lift; this is :func:`mufly.rotor.bemt.drag_turning`, on its way
    down as :func:`mufly.rotor.tubes.turning_reading` says. Above the disc there is none.
    """
    u = np.zeros_like(target.sensors)
    state, above = source.state, source.placed.height_m - target.placed.height_m
    if state is None or above <= 0.0:
        return u
    s = source.surface
    through = from_other(source, source, s.quarter_m, phases)[:, 2] - climb
    if target.state is not None:
        through += from_other(source, target, s.quarter_m, phases)[:, 2]
    pull = 0.5 * s.blades * state.speed_m_s**2 * s.chord_m * state.cd * np.cos(s.theta_rad - state.alpha_rad)
    moment = drag_turning(pull, -through, 1.0)  # pull over the density
    r = np.hypot(s.quarter_m[:, 0], s.quarter_m[:, 1])
    x, y = target.sensors[:, 0], target.sensors[:, 1]
    at = np.hypot(x, y)
    width = np.interp(at, target.surface.quarter_m[:, 0], target.surface.width_m)
    turning = turning_reading(r, s.radius_m, above, at, width) @ moment / at
    turning *= target.placed.hand * source.placed.hand
    u[:, 0], u[:, 1] = -turning * y, turning * x
    return u


def solve_blade(unit: Unit, others: Array, air: Air, climb: float, settings: WakeSettings) -> None:
    """Circulation and loads of a rotor's blades; ``others``: velocity at its sensors from the other rotor."""
    s, p = unit.surface, unit.placed
    n = s.chord_m.size
    matrix = trailing(unit)
    x = unit.sensors
    own = (
        np.stack([x[:, 1], -x[:, 0], np.zeros(len(x))], axis=1) * s.speed_rad_s
    )  # air past the turning blade
    wind = own + others
    wind[:, 2] -= climb
    start = unit.state.circulation if unit.state is not None else None
    state = solve_circulation(
        s, p.blading, p.which, wind[:n], matrix[:n], air, start, inviscid=settings.inviscid
    )
    unit.state = state
    complete = wind + matrix.transpose(0, 2, 1) @ state.circulation
    unit.wind_quarter = complete[n : 2 * n]
    unit.dT, unit.dQ = blade_loads(s, state, unit.wind_quarter, complete[2 * n :], air)
    unit.thrust, unit.torque = float(unit.dT.sum()), float(unit.dQ.sum())


def rotor_result(unit: Unit, air: Air, climb: float) -> RotorResult:
    s, state = unit.surface, unit.state
    assert state is not None
    wy, wz = unit.wind_quarter[:, 1], unit.wind_quarter[:, 2]
    nu = air.viscosity_Pa_s / air.density_kg_m3
    columns = {
        "alpha_rad": state.alpha_rad,
        "phi_rad": np.arctan2(-wz, -wy),
        "inflow_m_s": -wz - climb,
        "swirl_m_s": s.speed_rad_s * s.quarter_m[:, 0] + wy,
        "cl": state.cl,
        "cd": state.cd,
        "reynolds": np.maximum(state.speed_m_s * s.chord_m / nu, 1e-9),
        "loss": np.ones_like(wy),
        "dT_N": unit.dT,
        "dQ_Nm": unit.dQ,
    }
    return result_of(unit.placed, climb, air, unit.thrust, unit.torque, columns)


def wake_of(unit: Unit) -> Wake:
    assert unit.state is not None
    paths = unit.paths.copy()
    paths[..., 1] *= unit.placed.hand
    paths[..., 2] += unit.placed.height_m
    return Wake(
        placed=unit.placed,
        surface=unit.surface,
        paths_m=paths,
        age_rad=unit.path_age,
        strength_m2_s=unit.strength(),
        core_m=unit.core,
        circulation_m2_s=unit.state.circulation,
        free_points=unit.age.size,
        chords=unit.parts,
    )
