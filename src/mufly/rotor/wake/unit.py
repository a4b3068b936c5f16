"""A rotor while it is being solved: its vortices, what they induce, and the circulation of its blades."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mufly.rotor.hover import Air, RotorResult, result_of
from mufly.rotor.wake.blade import (
    BladeState,
    Surface,
    blade_loads,
    bound_influence,
    leg_points,
    of_all_blades,
    solve_circulation,
    surface_of,
    turned,
)
from mufly.rotor.wake.kernel import induce, influence, segments_of
from mufly.rotor.wake.result import Placed, Wake, WakeSettings
from mufly.rotor.wake.shape import ages_of, core_radii, extended

__all__ = [
    "Unit",
    "from_other",
    "from_other_at",
    "rotor_result",
    "solve_blade",
    "trailing",
    "vortices_of",
    "wake_of",
]

Array = NDArray[np.float64]


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
        self.free = np.empty((n + 1, self.age.size, 3))
        self.sensors = np.concatenate([s.control_m, s.quarter_m, leg_points(s)])
        self.bound = bound_influence(s, self.sensors)
        # Circulation of the filament at edge j, towards the wake: what the inboard panel brings less the next one's.
        self.shed = np.zeros((n + 1, n))
        self.shed[np.arange(n), np.arange(n)] = -1.0
        self.shed[np.arange(1, n + 1), np.arange(n)] = 1.0
        self.state: BladeState | None = None
        self.wind_quarter = np.zeros((n, 3))
        self.next = self.free
        self.from_others: Array | None = None  # velocity at the free points
        self.thrust, self.torque = 0.0, 0.0
        self.dT, self.dQ = np.zeros(n), np.zeros(n)

    def strength(self) -> Array:
        return self.shed @ self.state.circulation if self.state is not None else np.zeros(self.shed.shape[0])

    def lay_out(self, settings: WakeSettings, viscosity: float) -> None:
        """Whole filaments with cores, and the segments that everybody feels, for the present circulation."""
        self.paths, self.path_age = extended(
            self.surface, self.free, self.age, settings.far_turns, math.radians(settings.far_step_deg)
        )
        self.refresh(settings, viscosity)

    def refresh(self, settings: WakeSettings, viscosity: float) -> None:
        strength = self.strength()
        limit = settings.core_limit or 0.0
        self.core = core_radii(self.surface, self.path_age, strength, viscosity, settings.core, limit)
        gamma = self.state.circulation if self.state is not None else np.zeros(self.shed.shape[1])
        self.segments = vortices_of(self.surface, self.paths, self.core, strength, gamma)

    def velocity(self, points: Array) -> Array:
        """What this rotor induces at points of its own frame."""
        return of_all_blades(points, self.surface.blades, lambda p: self.induce(p, self.segments))


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
    legs = of_all_blades(unit.sensors, unit.surface.blades, lambda p: influence(p, unit.paths, unit.core))
    return unit.bound + np.einsum("ijc,jk->ikc", legs, unit.shed)


def _into(points: Array, of: Unit, other: Unit) -> Array:
    """Points of one rotor's frame in another's (both at azimuth zero)."""
    moved = points.copy()
    moved[..., 1] *= of.placed.hand * other.placed.hand
    moved[..., 2] += of.placed.height_m - other.placed.height_m
    return moved


def from_other_at(target: Unit, source: Unit, points: Array, azimuth_rad: float) -> Array:
    """Velocity at points of the target's frame that another rotor induces when its blade 1 has turned by an azimuth."""
    there = _into(points, target, source)
    v = turned(source.velocity(turned(there, -azimuth_rad)), azimuth_rad)
    v[..., 1] *= target.placed.hand * source.placed.hand
    return v


def from_other(target: Unit, source: Unit, points: Array, phases: int) -> Array:
    """The same, averaged over the relative azimuth."""
    step = 2.0 * math.pi / (phases * source.surface.blades)
    total = from_other_at(target, source, points, 0.5 * step)
    for k in range(1, phases):
        total += from_other_at(target, source, points, (k + 0.5) * step)
    return total / phases


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
    s, state, p = unit.surface, unit.state, unit.placed
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
    return result_of(
        p.blading, p.which, p.pitch_rad, p.speed_rad_s, climb, air, unit.thrust, unit.torque, columns
    )


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
    )
