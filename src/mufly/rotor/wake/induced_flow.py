"""Flow around a solved wake: velocities, momentum through a plane, and unsteady loads of blade passing.

For blade passing the wakes of the solved pair are frozen in the frames of their rotors. At every relative azimuth the
circulation follows from the instantaneous positions of the other rotor's vortices. This is quasi-steady: vorticity shed
by changes of circulation is neglected, so peaks are overestimated. Blades of rotors with N blades each pass N times in
a relative revolution, at the frequency N (Omega_1 + Omega_2) / 2 pi.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import InputError
from mufly.results import result
from mufly.rotor.rotor_system import RotorWake, SystemSolution, WakeSettings
from mufly.rotor.wake.biot_savart import induce_velocity
from mufly.rotor.wake.lifting_surface import rotate_vectors
from mufly.rotor.wake.wake_solver import (
    RotorState,
    collect_blade_segments,
    compute_upper_drag_swirl,
    initialise_wakes,
    mutual_inflow_at,
    solve_blade_loads,
)

Array = NDArray[np.float64]


def _segments_in_rotor_frame(wake: RotorWake) -> tuple[Array, Array, Array, Array]:
    """Return one blade's vortices as segments, in a frame where the rotor turns counter-clockwise, hub at z = 0."""
    paths = wake.filament_paths_m.copy()
    paths[..., 1] *= wake.placed.rotation_sign
    paths[..., 2] -= wake.placed.height_m
    return collect_blade_segments(
        wake.surface, paths, wake.core_radius_m, wake.filament_circulation_m2_s, wake.bound_circulation_m2_s
    )


def induced_velocity(solution: SystemSolution, points_m: ArrayLike, azimuth_rad: ArrayLike = 0.0) -> Array:
    """Return the velocity induced by all rotors (m/s); the axial flow of climb, -V_climb along z, is not included.

    Parameters
    ----------
    solution : SystemSolution
    points_m : (..., 3) array_like
        Points in space (m): z up along the shaft, blade 1 of every rotor on the x axis at azimuth 0.
    azimuth_rad : float or sequence
        Azimuth of each rotor in its own sense of rotation (rad).
    """
    if not solution.wakes:
        raise InputError("wake", "solution", "has no wakes", "solve by the method 'wake'")
    points = np.asarray(points_m, dtype=np.float64)
    flat = points.reshape(-1, 3)
    if flat.shape[0] and not np.all(np.isfinite(flat)):
        raise InputError("wake", "points_m", "contain NaN or infinity", "give finite points")
    azimuths = np.broadcast_to(np.asarray(azimuth_rad, dtype=np.float64), (len(solution.wakes),))
    total = _sum_wake_velocities(solution, flat, azimuths)
    ground = None if solution.settings is None else solution.settings.ground_m
    if ground is not None:  # image vortices
        total += _sum_wake_velocities(solution, flat * [1.0, 1.0, -1.0] - [0.0, 0.0, 2.0 * ground], azimuths) * [
            1.0,
            1.0,
            -1.0,
        ]
    return total.reshape(points.shape)


def _sum_wake_velocities(solution: SystemSolution, flat: Array, azimuths: Array) -> Array:
    """Return the velocity induced at points (n, 3) by the vortices of all rotors, without images in the ground."""
    total = np.zeros_like(flat)
    for wake, azimuth in zip(solution.wakes, azimuths, strict=True):
        segments, hand = _segments_in_rotor_frame(wake), wake.placed.rotation_sign
        there = flat.copy()
        there[:, 1] *= hand
        there[:, 2] -= wake.placed.height_m
        sum_ = np.zeros_like(flat)
        for b in range(wake.surface.blade_count):
            angle = float(azimuth) + 2.0 * math.pi * b / wake.surface.blade_count
            sum_ += rotate_vectors(induce_velocity(rotate_vectors(there, -angle), segments), angle)
        sum_[:, 1] *= hand
        total += sum_
    return total


def compute_momentum_flux_thrust(solution: SystemSolution, height_m: float, *, reach: float = 6.0) -> float:
    """Return the thrust (N) from the momentum flux through a plane below the rotors.

    For a consistent wake it equals the thrust of the loads. The pressure follows from the unsteady Bernoulli equation.
    The potential of a rotor turns with it, so d phi/d t = -Omega r u_theta, with u_theta in its own sense of rotation
    (own derivation)::

        T = integral of (p - p_inf + rho w^2)
          = rho integral of [sum_k Omega_k r u_theta,k + (w^2 - u_r^2 - u_theta^2) / 2]

    with w downwards. In climb the plane moves with the rotors, and the flux rho V w cancels the pressure term rho V w.
    The formula is exact outside vortex cores. The wake contains no profile drag, whose contribution to thrust (about -1
    %) is missing.

    Parameters
    ----------
    solution : SystemSolution
    height_m : float
        Height of the plane (m), below all discs and above the end of the free wakes.
    reach : float
        Radius of the plane over that of the largest rotor.

    Raises
    ------
    InputError
        If the plane does not lie below the discs.
    """
    lowest = min(w.placed.height_m for w in solution.wakes)
    big = max(w.surface.radius_m for w in solution.wakes)
    if not height_m < lowest:
        raise InputError("wake", "height_m", f"{height_m:g} m is not below the rotors", f"give less than {lowest:g}")
    inner, w_in = np.polynomial.legendre.leggauss(48)
    outer, w_out = np.polynomial.legendre.leggauss(24)
    # Uniform within the wake, logarithmic outside up to the reach.
    split = 1.3 * big
    r = np.concatenate([0.5 * split * (inner + 1.0), split * (reach / 1.3) ** (0.5 * (outer + 1.0))])
    far = r[inner.size :]
    weight = np.concatenate([0.5 * split * w_in, 0.5 * math.log(reach / 1.3) * far * w_out])
    blades = solution.wakes[0].surface.blade_count
    sectors, count = (blades, 24) if len(solution.wakes) == 1 else (1, 48)
    angle = 2.0 * math.pi / sectors * (np.arange(count) + 0.5) / count
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    points = np.stack([r * c, r * s, np.full_like(r * c, height_m)], axis=-1)
    rho = solution.air.density_kg_m3
    total = np.zeros_like(points)
    swirl = np.zeros(r.size)
    for k, wake in enumerate(solution.wakes):
        v = induced_velocity(replace(solution, wakes=(wake,), rotors=(solution.rotors[k],)), points)
        total += v
        around = np.mean(c * v[..., 1] - s * v[..., 0], axis=0) * wake.placed.rotation_sign
        swirl += wake.surface.speed_rad_s * r * around
    down = -total[..., 2]
    outwards, around2 = c * total[..., 0] + s * total[..., 1], c * total[..., 1] - s * total[..., 0]
    flux = 0.5 * np.mean(down**2 - outwards**2 - around2**2, axis=0)
    return float(rho * 2.0 * math.pi * np.sum(weight * r * (swirl + flux)))


@result(eq=False)
class BladePassingLoads:
    """Loads of a coaxial pair over the relative azimuth.

    Attributes
    ----------
    relative_azimuth_rad : (m,) array
        Relative azimuth of the blades (rad); 0 where they lie above each other.
    thrust_N, torque_Nm : (2, m) arrays
        Loads of upper and lower rotor, in the order of the solution's rotors.
    passing_hz : float
        Frequency at which blades pass.
    """

    relative_azimuth_rad: Array
    thrust_N: Array
    torque_Nm: Array
    passing_hz: float


def compute_blade_passing_loads(solution: SystemSolution, *, points: int = 24) -> BladePassingLoads:
    """Compute the loads of a solved pair over one blade passage.

    Parameters
    ----------
    solution : SystemSolution
        Solution of two rotors with equal numbers of blades.
    points : int
        Number of relative azimuths.

    Raises
    ------
    InputError
        If the solution does not have two rotors, or their numbers of blades differ.
    """
    if len(solution.wakes) != 2:
        raise InputError("wake", "solution", "is not one of a pair", "solve two rotors")
    rotors = [wake.placed for wake in solution.wakes]
    settings, air, climb = solution.settings or WakeSettings(), solution.air, solution.climb_m_s
    units = [RotorState(p, settings) for p in rotors]
    if units[0].surface.blade_count != units[1].surface.blade_count:
        raise InputError(
            "wake", "blades", "differ in number between the rotors", "give rotors with equal numbers of blades"
        )
    initialise_wakes(units, solution, climb)
    for unit in units:
        unit.build_filaments(settings, air.viscosity_Pa_s / air.density_kg_m3)
    circulation = [unit.blade_state for unit in units]
    blades = units[0].surface.blade_count
    azimuth = np.arange(points) * 2.0 * math.pi / blades / points
    swirls = [compute_upper_drag_swirl(a, b, climb, settings.phases) for a, b in (units, units[::-1])]
    thrust, torque = np.empty((2, points)), np.empty((2, points))
    for i, angle in enumerate(azimuth):
        winds = [
            mutual_inflow_at(a, b, a.evaluation_points_m, float(angle)) + swirl
            for (a, b), swirl in zip((units, units[::-1]), swirls, strict=True)
        ]
        for k, unit in enumerate(units):
            unit.blade_state = circulation[k]
            solve_blade_loads(unit, winds[k], air, climb, settings)
            thrust[k, i], torque[k, i] = unit.thrust_N, unit.torque_Nm
    relative = sum(p.speed_rad_s for p in rotors)
    return BladePassingLoads(azimuth, thrust, torque, blades * relative / (2.0 * math.pi))
