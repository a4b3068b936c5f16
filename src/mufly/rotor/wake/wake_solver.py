"""Wake solver for one rotor or a counter-rotating pair with prescribed or free wakes.

In steady hover or climb the wake of a rotor is steady in the rotating frame. The points of a filament satisfy

    dX/dzeta = (v(X) - V_climb z) / Omega  -  z x X          zeta: age, an angle; X = trailing edge at zeta = 0

with v induced by all vortices of all blades (:mod:`.biot_savart`). The fixed point is found by relaxation. An iteration
computes the circulation of the blades (:mod:`.lifting_surface`) and the velocities at all points, integrates along the
filaments, and moves the points towards the result. Integration is by the trapezium rule in a frame that turns with the
age, which is exact for a rigid helix. The N blades of a rotor are copies of one blade.

Two rotors: each wake is steady in the frame of its own rotor only. The velocity that one rotor induces at the other's
blades and wake is therefore averaged over the relative azimuth. The unsteady part follows from
:func:`mufly.rotor.wake.induced_flow.compute_blade_passing_loads`. The lower rotor also receives the swirl due to
profile drag
of the upper rotor (:func:`compute_upper_drag_swirl`), which vortices do not represent. A clockwise rotor is solved as
its mirror image.

Cost of an iteration: (points of one blade) x (segments of all blades), quadratic in the number of wake elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.rotor.bemt import build_rotor_result, compute_drag_swirl_momentum
from mufly.rotor.rotor_system import (
    Air,
    LiftingSurface,
    PlacedRotor,
    RotorResult,
    RotorWake,
    SystemSolution,
    WakeSettings,
)
from mufly.rotor.validity_checks import check_rotors
from mufly.rotor.vortex_tube import make_swirl_influence_matrix
from mufly.rotor.wake.biot_savart import (
    convert_segments_to_single,
    filament_influence,
    induce_velocity,
    induce_velocity_by_group,
    make_segments,
)
from mufly.rotor.wake.lifting_surface import (
    CHORDWISE_CORE_RADII,
    BladeState,
    chordwise_leg_points,
    compute_bound_vortex_influence,
    compute_core_radii,
    compute_panel_loads,
    extend_filaments,
    free_wake_ages,
    make_lifting_surface,
    prescribe_landgrebe_wake,
    rotate_vectors,
    solve_circulation,
    sum_over_blades,
)

Array = NDArray[np.float64]

_STEADY_WINDOW_ITERATIONS = 10
_SINGLE_ROTOR_CORE_LIMITS = (0.15, 0.25, 0.35)  # R; the next limit is tried if a wake does not converge
_PAIR_CORE_LIMITS = (0.2, 0.3, 0.4)
_MEAN_WINDOW_ITERATIONS = 30  # iterations over which a fluctuating wake is averaged
_MAX_LOAD_FLUCTUATION = 0.02  # of the loads; greatest fluctuation of a wake that counts as steady in the mean
_WAKE_DAMPING_AGE_RAD = 4.0 * math.pi
_INITIAL_CORE_LIMIT = 0.4  # initial core limit (R)
_CORE_LIMIT_DECAY_ITERATIONS = 15.0  # iterations until it has decreased
_FLUCTUATING_RESIDUAL_FACTOR = 2.0  # factor on the permitted residual of a fluctuating wake
_MUTUAL_UPDATE_INTERVAL_ITERATIONS = 4  # iterations between updates of the mutual influence on the wakes
_SWIRL_RELAXATION_FACTOR = 0.3  # relaxation of the swirl at each update
_TYPICAL_BLADE_LOADING = 0.06  # c_T over solidity, first guess
_MIN_GROUND_CLEARANCE_RADII = 0.05  # R: least height of vortices above the ground
_COARSE_WAKE_CHORD_RAD = math.radians(15.0)  # chords of a wake for averages over azimuth
_MAX_POINT_STEP_RADII = 0.15  # R; greatest step of a point in one iteration
_PRESCRIBED_WAKE_ITERATIONS = 6  # iterations with Landgrebe's wake before the wake is free


def _convect_filaments(unit: RotorState, velocity: Array, climb: float) -> tuple[Array, float]:
    """Return the points of the filaments moved with the flow, and the residual of the wake.

    The points are the integral along the filaments from the trailing edge. The residual is the mismatch of dX/dzeta and
    velocity over the velocity (root mean squares).
    """
    s = unit.surface
    step = unit.free_ages_rad[1] - unit.free_ages_rad[0]
    v = velocity / s.speed_rad_s
    v[..., 2] -= climb / s.speed_rad_s
    moved = 0.5 * step * (v[:, :-1] + rotate_vectors(v, step)[:, 1:])
    out = np.empty_like(unit.free_points_m)
    out[:, 0] = s.trailing_edge_m
    for k in range(unit.free_ages_rad.size - 1):
        out[:, k + 1] = rotate_vectors(out[:, k] + moved[:, k], -step)
    still = unit.free_points_m[:, 1:] - rotate_vectors(unit.free_points_m[:, :-1] + moved, -step)
    size = max(float(np.mean(np.sum(moved**2, axis=2))), 1e-30)
    return out, math.sqrt(float(np.mean(np.sum(still**2, axis=2))) / size)


def _limit_root_vortex_upwash(velocity: Array) -> None:
    """Limit the upwash of a pair's root vortices: they descend at least as fast as the vortex sheet beside them.

    The velocities, (edges, points, 3), change in place. Coils of a root vortex induce upwash through their middle, the
    place of hub and shaft. Without the limit the upper rotor's root vortex has two solutions: down, or up through its
    disc, which is unphysical in descending air and raises the upper thrust by 3 to 4 %.
    """
    velocity[0, :, 2] = np.minimum(velocity[0, :, 2], velocity[1, :, 2])


def _thrust_coefficient(unit: RotorState, air: Air) -> float:
    s = unit.surface
    return unit.thrust_N / (air.density_kg_m3 * math.pi * s.radius_m**4 * s.speed_rad_s**2)


def initialise_wakes(units: Sequence[RotorState], start: SystemSolution | None, climb: float) -> None:
    """Initialise the rotors with the scaled wakes of a similar solution or with prescribed wakes."""
    for k, unit in enumerate(units):
        s = unit.surface
        known = start.wakes[k] if start is not None and k < len(start.wakes) else None
        if (
            start is not None
            and known is not None
            and known.filament_paths_m.shape[0] == len(unit.free_points_m)
            and (known.free_point_count == unit.free_ages_rad.size)
        ):
            free = known.filament_paths_m[
                :, 1 : 2 + known.segments_per_free_step * (known.free_point_count - 1) : known.segments_per_free_step
            ].copy()
            free[..., 1] *= unit.placed.rotation_sign
            free[..., 2] -= known.placed.height_m
            unit.free_points_m = free * (s.radius_m / known.surface.radius_m)
            gamma = known.bound_circulation_m2_s * (
                s.speed_rad_s * s.radius_m**2 / (known.surface.speed_rad_s * known.surface.radius_m**2)
            )
            was = start.rotors[k]
            faster = s.speed_rad_s * s.radius_m / (known.surface.speed_rad_s * known.surface.radius_m)
            nu = start.air.viscosity_Pa_s / start.air.density_kg_m3
            speed = faster * nu * was.reynolds / known.surface.chord_m
            unit.blade_state = BladeState(gamma, was.alpha_rad, was.cl, was.cd, speed, True)
            unit.free_points_m[:, 0] = s.trailing_edge_m
        else:
            sigma = s.blade_count * float(np.sum(s.chord_m * s.panel_width_m)) / (math.pi * s.radius_m**2)
            unit.free_points_m = unit.lift_above_ground(
                prescribe_landgrebe_wake(s, unit.free_ages_rad, _TYPICAL_BLADE_LOADING * sigma, None, climb)
            )


def solve_wake(
    rotors: Sequence[PlacedRotor],
    climb_m_s: float = 0.0,
    air: Air | None = None,
    settings: WakeSettings | None = None,
    start: SystemSolution | None = None,
    progress: Callable[[int, float, float], None] | None = None,
) -> SystemSolution:
    """Solve one rotor or a coaxial pair by the vortex wake method; called by :func:`mufly.rotor.solve_system`.

    Parameters
    ----------
    rotors : sequence of PlacedRotor
        One rotor, or two with opposite senses of rotation and different heights.
    climb_m_s : float
        Axial speed through the air (m/s), positive in climb.
    air : Air, optional
    settings : WakeSettings, optional
    start : SystemSolution, optional
        Similar result to start from, if it has wakes; it saves iterations.
    progress : callable, optional
        Called with iteration, residual and thrust (N) of all rotors.

    Raises
    ------
    InputError
        If a speed or chord is zero, or both rotors have the same height or sense of rotation.

    Notes
    -----
    A solution that does not converge is returned with ``converged`` false and its history.
    """
    gas, how = air or Air(), settings or WakeSettings()
    start = start if start is not None and start.wakes else None
    check_rotors(rotors, climb_m_s)
    if how.ground_m is not None:
        how = replace(how, far_turns=min(how.far_turns, max(_turns_to_ground(how.ground_m, rotors) - how.turns, 1.0)))
    if how.core_limit is not None or how.model == "prescribed":
        how = replace(how, core_limit=how.core_limit if how.core_limit is not None else _SINGLE_ROTOR_CORE_LIMITS[0])
        return _solve_with_core_limit(rotors, gas, climb_m_s, how, start, progress)
    limits: tuple[float, ...] = _SINGLE_ROTOR_CORE_LIMITS if len(rotors) == 1 else _PAIR_CORE_LIMITS
    if start is not None and start.settings is not None and start.settings.core_limit in limits:
        limits = limits[limits.index(start.settings.core_limit) :]
    for limit in limits:
        solution = _solve_with_core_limit(rotors, gas, climb_m_s, replace(how, core_limit=limit), start, progress)
        if solution.converged:
            break
        start = None
    return solution


def _turns_to_ground(ground_m: float, rotors: Sequence[PlacedRotor]) -> float:
    """Return the number of rotor turns after which the lowest tip vortex reaches the ground (Landgrebe's formula,
    typical loading).

    Beyond, helices would pile up on the ground, and the wake would not converge.
    """
    lowest = min(rotors, key=lambda p: p.height_m)
    rotor = lowest.blading.rotors[lowest.index_in_blading]
    per_turn = 2.0 * math.pi * 1.41 * math.sqrt(0.5 * _TYPICAL_BLADE_LOADING * rotor.solidity) * rotor.radius_m
    return (ground_m + lowest.height_m) / per_turn


def _solve_with_core_limit(
    rotors: Sequence[PlacedRotor], gas: Air, climb_m_s: float, how: WakeSettings, start: SystemSolution | None,
    progress: Callable[[int, float, float], None] | None,
) -> SystemSolution:  # fmt: skip
    """Solve the wake with the core limit of ``how``, starting from a similar solution or from a prescribed wake."""
    nu = gas.viscosity_Pa_s / gas.density_kg_m3
    units = [RotorState(p, how) for p in rotors]
    initialise_wakes(units, start, climb_m_s)
    free = how.model == "free"
    history: list[list[float]] = []
    message, converged, residual = "", False, math.inf
    limit = how.core_limit or 0.0
    for turn in range(how.iterations):
        # Thick cores first: a wake far from its solution would otherwise roll up.
        now = replace(
            how,
            core_limit=limit
            + max(_INITIAL_CORE_LIMIT - limit, 0.0) * math.exp(-turn / _CORE_LIMIT_DECAY_ITERATIONS) * (start is None),
        )
        for unit in units:
            unit.build_filaments(now, nu)
        for unit in units:
            others = np.zeros_like(unit.evaluation_points_m)
            for source in units:
                if source is not unit and source.blade_state is not None:
                    others += average_mutual_inflow(unit, source, unit.evaluation_points_m, how.phases)
                    if turn % _MUTUAL_UPDATE_INTERVAL_ITERATIONS == 0:
                        left = compute_upper_drag_swirl(unit, source, climb_m_s, how.phases)
                        # Slow relaxation, because the wake is still moving.
                        unit.swirl_velocity_m_s += (
                            _SWIRL_RELAXATION_FACTOR if unit.swirl_velocity_m_s.any() else 1.0
                        ) * (left - unit.swirl_velocity_m_s)
                    others += unit.swirl_velocity_m_s
            solve_blade_loads(unit, others, gas, climb_m_s, how)
            unit.update_segments(now, nu)
        residuals = []
        for unit in units:
            if free and turn >= _PRESCRIBED_WAKE_ITERATIONS * (start is None):
                points = unit.free_points_m.reshape(-1, 3)
                if len(units) > 1 and (
                    unit.mutual_velocity_m_s is None or turn % _MUTUAL_UPDATE_INTERVAL_ITERATIONS == 0
                ):
                    other = units[0] if unit is units[1] else units[1]
                    unit.mutual_velocity_m_s = average_mutual_inflow(unit, other, points, how.phases)
                v = unit.induced_velocity(points)
                if unit.mutual_velocity_m_s is not None:
                    v += unit.mutual_velocity_m_s
                    if unit.thrust_N > 0.0:  # with negative thrust the coils induce downwash
                        _limit_root_vortex_upwash(v.reshape(unit.free_points_m.shape))
                aim, far_off = _convect_filaments(unit, v.reshape(unit.free_points_m.shape), climb_m_s)
                aim = unit.lift_above_ground(aim)
                part = how.relaxation / (1.0 + unit.free_ages_rad / (_WAKE_DAMPING_AGE_RAD))
                step = part[:, None] * (aim - unit.free_points_m)
                length = np.linalg.norm(step, axis=2, keepdims=True)
                step *= np.minimum(1.0, _MAX_POINT_STEP_RADII * unit.surface.radius_m / np.maximum(length, 1e-300))
                unit.next_free_points_m = unit.free_points_m + step
            else:
                assert unit.blade_state is not None
                c_T = _thrust_coefficient(unit, gas)
                aim = prescribe_landgrebe_wake(
                    unit.surface, unit.free_ages_rad, c_T, unit.blade_state.circulation_m2_s, climb_m_s
                )
                aim = unit.lift_above_ground(aim)
                unit.next_free_points_m = unit.free_points_m + 0.4 * (aim - unit.free_points_m)
                far_off = math.sqrt(np.mean(np.sum((aim - unit.free_points_m) ** 2, axis=2))) / unit.surface.radius_m
                far_off += 10.0 * free  # not yet the requested core limit or free wake
            residuals.append(far_off)
        residual = float(max(residuals))
        history.append([residual, *(x for u in units for x in (u.thrust_N, u.torque_Nm))])
        if progress is not None:
            progress(turn + 1, residual, sum(u.thrust_N for u in units))
        message = _divergence_message(history, how)
        if message:
            break
        if turn > 3.0 * _CORE_LIMIT_DECAY_ITERATIONS * (start is None):
            converged = residual <= how.residual and _is_wake_steady(history, how.tolerance)
            if converged:
                message = f"converged after {turn + 1} iterations, core limit {limit:g} R"
                break
            from_here = history[round(3.0 * _CORE_LIMIT_DECAY_ITERATIONS) * (start is None) :]
            converged = residual <= _FLUCTUATING_RESIDUAL_FACTOR * how.residual and _is_steady_in_mean(
                from_here, how.tolerance
            )
            if converged:
                wander = 100.0 * _find_max_load_spread(history, 2 * _MEAN_WINDOW_ITERATIONS)
                message = (
                    f"converged in the mean after {turn + 1} iterations, loads vary by {wander:.2f} %, "
                    f"core limit {limit:g} R"
                )
                break
        for unit in units:
            unit.free_points_m = unit.next_free_points_m
    else:
        message = (
            f"not converged in {how.iterations} iterations: the wake misses the air by {100 * residual:.1f} % of its "
            f"velocity, thrust or torque moves by {100 * _find_max_load_spread(history):.2f} %"
        )
    return SystemSolution(
        rotors=tuple(make_rotor_result(u, gas, climb_m_s) for u in units),
        placed=tuple(rotors),
        climb_m_s=climb_m_s,
        air=gas,
        method="wake",
        converged=converged,
        message=message,
        iterations=len(history),
        wakes=tuple(make_rotor_wake(u) for u in units),
        settings=how,
        residual=residual,
        history=np.array(history),
    )


def _find_max_load_spread(history: list[list[float]], memory: int = _STEADY_WINDOW_ITERATIONS) -> float:
    """Return the greatest relative spread of a thrust or torque over the last iterations."""
    last = np.array(history[-memory:])[:, 1:]
    middle = np.abs(last.mean(axis=0)) + 1e-3 * np.abs(last).max() + 1e-300
    return float(np.max((last.max(axis=0) - last.min(axis=0)) / middle))


def _is_wake_steady(history: list[list[float]], tolerance: float) -> bool:
    return len(history) >= _STEADY_WINDOW_ITERATIONS and _find_max_load_spread(history) <= tolerance


def _is_steady_in_mean(history: list[list[float]], tolerance: float) -> bool:
    """Return True if the mean loads of the last two windows of iterations agree, and the present loads with them.

    Old vortices keep pairing and separating, in real wakes as in this model. The loads then fluctuate about means that
    do not depend on the relaxation.
    """
    if (
        len(history) < 2 * _MEAN_WINDOW_ITERATIONS
        or _find_max_load_spread(history, 2 * _MEAN_WINDOW_ITERATIONS) > _MAX_LOAD_FLUCTUATION
    ):
        return False
    last = np.array(history[-2 * _MEAN_WINDOW_ITERATIONS :])[:, 1:]
    mean = last.mean(axis=0)
    size = np.abs(mean) + 1e-3 * np.abs(last).max() + 1e-300
    apart = np.abs(last[:_MEAN_WINDOW_ITERATIONS].mean(axis=0) - last[_MEAN_WINDOW_ITERATIONS:].mean(axis=0)) / size
    return bool(np.all(apart <= tolerance) and np.all(np.abs(last[-1] - mean) <= 0.5 * tolerance * size))


def _divergence_message(history: list[list[float]], how: WakeSettings) -> str:
    now = np.array(history[-1])
    if not np.all(np.isfinite(now)) or now[0] > 1e3:
        return f"diverged in iteration {len(history)}; the history is kept"
    return ""


class RotorState:
    """State of a rotor during the solution in its own frame: counter-clockwise, hub at the origin."""

    def __init__(self, placed: PlacedRotor, settings: WakeSettings) -> None:
        self.placed = placed
        self.surface = make_lifting_surface(
            placed.blading, placed.index_in_blading, placed.pitch_rad, placed.speed_rad_s
        )
        s = self.surface
        n = s.chord_m.size
        self.induce_function: Callable[..., Array] = induce_velocity
        self.pack_segments: Callable[..., Any] = convert_segments_to_single
        if settings.gpu:
            from mufly.rotor.wake.biot_savart_gpu import induce_velocity_gpu

            self.induce_function, self.pack_segments = induce_velocity_gpu, tuple
        self.free_ages_rad = free_wake_ages(settings.turns, math.radians(settings.step_deg))
        self.segments_per_free_step = max(round(settings.step_deg / settings.chord_deg), 1)
        self.free_points_m = np.empty((n + 1, self.free_ages_rad.size, 3))
        ground = math.inf if settings.ground_m is None else settings.ground_m
        self.ground_z_m = -(ground + placed.height_m)
        self.evaluation_points_m = np.concatenate([s.control_points_m, s.quarter_chord_m, chordwise_leg_points(s)])
        # Circulation of the filament at edge j, towards the wake: inboard panel less outboard panel.
        self.shed_matrix = np.zeros((n + 1, n))
        self.shed_matrix[np.arange(n), np.arange(n)] = -1.0
        self.shed_matrix[np.arange(1, n + 1), np.arange(n)] = 1.0
        # Bound vortices and the trailing vortices on the chord do not move.
        chordwise = np.stack([s.edge_quarter_chord_m, s.trailing_edge_m], axis=1)
        core = np.full((n + 1, 1), CHORDWISE_CORE_RADII * s.radius_m)
        self.blade_influence_matrix = self.add_ground_image_velocity(
            self.evaluation_points_m, lambda p: compute_bound_vortex_influence(s, p)
        ) + self.circulation_influence(lambda p: filament_influence(p, chordwise, core))
        self.blade_state: BladeState | None = None
        self.quarter_chord_wind_m_s = np.zeros((n, 3))
        self.next_free_points_m = self.free_points_m
        self.mutual_velocity_m_s: Array | None = None  # velocity at the free points
        self.swirl_velocity_m_s = np.zeros_like(self.evaluation_points_m)  # due to the other rotor's profile drag
        self.thrust_N, self.torque_Nm = 0.0, 0.0
        self.panel_thrust_N, self.panel_torque_Nm = np.zeros(n), np.zeros(n)

    def add_ground_image_velocity(self, points: Array, velocity: Callable[[Array], Array]) -> Array:
        """Return the velocity of vortices and their ground images at points: v(x) + M v(M x), with M the reflection in
        z."""
        v = velocity(points)
        if math.isfinite(self.ground_z_m):
            below = points.copy()
            below[:, 2] = 2.0 * self.ground_z_m - below[:, 2]
            v += velocity(below) * [1.0, 1.0, -1.0]
        return v

    def lift_above_ground(self, points: Array) -> Array:
        """Return the points; those near or below the ground are lifted to the least height that vortices have."""
        if math.isfinite(self.ground_z_m):
            points[..., 2] = np.maximum(
                points[..., 2], self.ground_z_m + _MIN_GROUND_CLEARANCE_RADII * self.surface.radius_m
            )
        return points

    def circulation_influence(self, one: Callable[[Array], Array]) -> Array:
        """Return the velocity at the evaluation points per panel circulation, (m, panels, 3).

        ``one`` computes at points (m, 3) the velocity due to one blade's filaments of unit circulation,
        (m, filaments, 3).
        """
        legs = self.add_ground_image_velocity(
            self.evaluation_points_m, lambda x: sum_over_blades(x, self.surface.blade_count, one)
        )
        return np.einsum("ijc,jk->ikc", legs, self.shed_matrix)

    def filament_circulation(self) -> Array:
        return (
            self.shed_matrix @ self.blade_state.circulation_m2_s
            if self.blade_state is not None
            else np.zeros(self.shed_matrix.shape[0])
        )

    def build_filaments(self, settings: WakeSettings, viscosity: float) -> None:
        """Build complete filaments, core radii and the segments that induce velocity, for the present circulation."""
        self.filament_paths_m, self.filament_ages_rad = extend_filaments(
            self.surface,
            self.free_points_m,
            self.free_ages_rad,
            settings.far_turns,
            math.radians(settings.far_step_deg),
            self.segments_per_free_step,
        )
        self.filament_paths_m = self.lift_above_ground(self.filament_paths_m)
        # The same with coarse chords, on radii that give their polygons the area of the arcs.
        end = 1 + self.segments_per_free_step * (self.free_ages_rad.size - 1)
        far = np.unique(np.append(np.arange(end, self.filament_ages_rad.size, 2), self.filament_ages_rad.size - 1))
        piece = (self.free_ages_rad[1] - self.free_ages_rad[0]) / self.segments_per_free_step
        skip = max(round(_COARSE_WAKE_CHORD_RAD / piece), 1)
        kept = np.concatenate([[0], np.arange(1, end, skip), far])
        self.coarse_paths_m = self.filament_paths_m[:, kept]
        self.coarse_ages_rad = self.filament_ages_rad[kept]
        chord, far_chord = skip * piece, math.radians(settings.far_step_deg)
        self.coarse_paths_m[:, 2:, :2] *= np.where(
            kept[2:, None] > end, 1.0 / math.sqrt(math.cos(far_chord)), math.sqrt(chord / math.sin(chord))
        )
        self.update_segments(settings, viscosity)

    def update_segments(self, settings: WakeSettings, viscosity: float) -> None:
        strength = self.filament_circulation()
        limit = settings.core_limit or 0.0
        self.core_radius_m = compute_core_radii(
            self.surface, self.filament_ages_rad, strength, viscosity, settings.core, limit
        )
        gamma = (
            self.blade_state.circulation_m2_s if self.blade_state is not None else np.zeros(self.shed_matrix.shape[1])
        )
        coarse = compute_core_radii(self.surface, self.coarse_ages_rad, strength, viscosity, settings.core, limit)
        wakes = ((self.filament_paths_m, self.core_radius_m), (self.coarse_paths_m, coarse))
        self._collect = [partial(collect_blade_segments, self.surface, *wake, strength, gamma) for wake in wakes]
        self._packed: list[Any] = [None, None]  # on first use

    def induced_velocity(self, points: Array, *, few: bool = False) -> Array:
        """Return the velocity induced by this rotor at points of its own frame; ``few`` selects coarse segments."""
        if self._packed[few] is None:
            self._packed[few] = self.pack_segments(self._collect[few]())
        vortices = self._packed[few]
        return self.add_ground_image_velocity(
            points,
            lambda x: sum_over_blades(x, self.surface.blade_count, lambda p: self.induce_function(p, vortices)),
        )


def collect_blade_segments(
    surface: LiftingSurface, paths: Array, core: Array, strength: Array, circulation: Array
) -> tuple[Array, Array, Array, Array]:
    """Collect all vortices of one blade as segments: trailing filaments, bound vortices, and closing segments at the
    far end.

    The closing segments at the end of the far wake satisfy Helmholtz's theorem. Wake points may pass close below a
    blade: for them the bound vortex has a core of a tenth of the chord, like a thick section.
    """
    edge, ends = surface.edge_quarter_chord_m, paths[:, -1]
    unit = np.ones(circulation.size)
    bound = make_segments(np.stack([edge[:-1], edge[1:]], axis=1), 0.1 * surface.chord_m[:, None], unit)
    closing = make_segments(np.stack([ends[1:], ends[:-1]], axis=1), core[1:, -1:], unit)
    parts = [make_segments(paths, core, strength)]
    parts += [(a, b, unit * circulation, c) for a, b, unit, c in (bound, closing)]
    start, end, strengths, cores = (np.concatenate(p, axis=-1) for p in zip(*parts, strict=True))
    return start, end, strengths, cores


def wake_influence(unit: RotorState) -> Array:
    """Return the velocity at the rotor's evaluation points per panel circulation, from the wake behind the trailing
    edges."""
    paths, core = unit.filament_paths_m[:, 1:], unit.core_radius_m[:, 1:]
    wake = convert_segments_to_single(make_segments(paths, core, np.ones(len(paths))), len(paths))
    return unit.circulation_influence(lambda p: induce_velocity_by_group(p, wake))


def _transform_to_rotor_frame(points: Array, of: RotorState, other: RotorState) -> Array:
    """Transform points from one rotor's frame to another's, both at azimuth 0."""
    moved = points.copy()
    moved[..., 1] *= of.placed.rotation_sign * other.placed.rotation_sign
    moved[..., 2] += of.placed.height_m - other.placed.height_m
    return moved


def mutual_inflow_at(
    target: RotorState, source: RotorState, points: Array, azimuth_rad: float | NDArray[Any], *, few: bool = False
) -> Array:
    """Return the velocity that the rotor ``source`` induces at points in the frame of the rotor ``target``.

    ``azimuth_rad`` is the azimuth of the source's blade 1; of shape (k, 1), it gives an array (k, points, 3). ``few``
    selects coarse segments.
    """
    there = rotate_vectors(_transform_to_rotor_frame(points, target, source), -azimuth_rad)
    v = source.induced_velocity(there.reshape(-1, 3), few=few).reshape(there.shape)
    v = rotate_vectors(v, azimuth_rad)
    v[..., 1] *= target.placed.rotation_sign * source.placed.rotation_sign
    return v


def average_mutual_inflow(target: RotorState, source: RotorState, points: Array, phases: int) -> Array:
    """Return the mutual inflow averaged over the relative azimuth, from wakes with coarse segments."""
    step = 2.0 * math.pi / (phases * source.surface.blade_count)
    azimuths = step * (np.arange(phases)[:, None] + 0.5)
    average: Array = mutual_inflow_at(target, source, points, azimuths, few=True).mean(axis=0)
    return average


def compute_upper_drag_swirl(target: RotorState, source: RotorState, climb: float, phases: int) -> Array:
    """Return the swirl velocity (m/s) at a rotor's evaluation points due to the profile drag of the rotor above.

    Vortices represent only the swirl due to lift. The moment of momentum is
    :func:`mufly.rotor.bemt.compute_drag_swirl_momentum`, convected by
    :func:`mufly.rotor.vortex_tube.make_swirl_influence_matrix`. Above the disc the swirl is zero.
    """
    u = np.zeros_like(target.evaluation_points_m)
    state, above = source.blade_state, source.placed.height_m - target.placed.height_m
    if state is None or above <= 0.0:
        return u
    s = source.surface
    through = average_mutual_inflow(source, source, s.quarter_chord_m, phases)[:, 2] - climb
    if target.blade_state is not None:
        through += average_mutual_inflow(source, target, s.quarter_chord_m, phases)[:, 2]
    pull = 0.5 * s.blade_count * state.speed_m_s**2 * s.chord_m * state.cd * np.cos(s.pitch_rad - state.alpha_rad)
    r = np.hypot(s.quarter_chord_m[:, 0], s.quarter_chord_m[:, 1])
    moment = compute_drag_swirl_momentum(pull, -through, 1.0, r, s.panel_width_m)  # drag over density
    x, y = target.evaluation_points_m[:, 0], target.evaluation_points_m[:, 1]
    at = np.hypot(x, y)
    width = np.interp(at, target.surface.quarter_chord_m[:, 0], target.surface.panel_width_m)
    turning = make_swirl_influence_matrix(r, s.radius_m, above, at, width) @ moment / at
    turning *= target.placed.rotation_sign * source.placed.rotation_sign
    u[:, 0], u[:, 1] = -turning * y, turning * x
    return u


def solve_blade_loads(unit: RotorState, others: Array, air: Air, climb: float, settings: WakeSettings) -> None:
    """Solve circulation and loads of the blades; ``others``: velocity due to the other rotor at the evaluation
    points."""
    s, p = unit.surface, unit.placed
    n = s.chord_m.size
    matrix = unit.blade_influence_matrix + wake_influence(unit)
    x = unit.evaluation_points_m
    own = np.stack([x[:, 1], -x[:, 0], np.zeros(len(x))], axis=1) * s.speed_rad_s  # air past the rotating blade
    wind = own + others
    wind[:, 2] -= climb
    start = unit.blade_state.circulation_m2_s if unit.blade_state is not None else None
    state = solve_circulation(
        s, p.blading, p.index_in_blading, wind[:n], matrix[:n], air, start, inviscid=settings.inviscid
    )
    unit.blade_state = state
    complete = wind + matrix.transpose(0, 2, 1) @ state.circulation_m2_s
    unit.quarter_chord_wind_m_s = complete[n : 2 * n]
    unit.panel_thrust_N, unit.panel_torque_Nm = compute_panel_loads(
        s, state, unit.quarter_chord_wind_m_s, complete[2 * n :], air
    )
    unit.thrust_N, unit.torque_Nm = float(unit.panel_thrust_N.sum()), float(unit.panel_torque_Nm.sum())


def make_rotor_result(unit: RotorState, air: Air, climb: float) -> RotorResult:
    s, state = unit.surface, unit.blade_state
    assert state is not None
    wy, wz = unit.quarter_chord_wind_m_s[:, 1], unit.quarter_chord_wind_m_s[:, 2]
    nu = air.viscosity_Pa_s / air.density_kg_m3
    columns = {
        "alpha_rad": state.alpha_rad,
        "phi_rad": np.arctan2(-wz, -wy),
        "axial_induced_m_s": -wz - climb,
        "swirl_m_s": s.speed_rad_s * s.quarter_chord_m[:, 0] + wy,
        "cl": state.cl,
        "cd": state.cd,
        "reynolds": np.maximum(state.speed_m_s * s.chord_m / nu, 1e-9),
        "loss": np.ones_like(wy),
        "dT_N": unit.panel_thrust_N,
        "dQ_Nm": unit.panel_torque_Nm,
    }
    return build_rotor_result(unit.placed, climb, air, unit.thrust_N, unit.torque_Nm, columns)


def make_rotor_wake(unit: RotorState) -> RotorWake:
    assert unit.blade_state is not None
    paths = unit.filament_paths_m.copy()
    paths[..., 1] *= unit.placed.rotation_sign
    paths[..., 2] += unit.placed.height_m
    return RotorWake(
        placed=unit.placed,
        surface=unit.surface,
        filament_paths_m=paths,
        filament_ages_rad=unit.filament_ages_rad,
        filament_circulation_m2_s=unit.filament_circulation(),
        core_radius_m=unit.core_radius_m,
        bound_circulation_m2_s=unit.blade_state.circulation_m2_s,
        free_point_count=unit.free_ages_rad.size,
        segments_per_free_step=unit.segments_per_free_step,
    )
