"""Elastic blades with another solver's loads: deform the blade, solve, deform again, until the twist converges.

The solver, for example a Navier-Stokes solver, is a function of a rotor. Each round hands it the rotor with the elastic
twist added to the built-in twist, and takes back the loads along the span. Blade element momentum theory gives the
first twist and the derivative of the loads with respect to twist, so that two or three rounds suffice:

    K x_(k+1) = F_c(x_(k+1)) + F_solver(phi_k) + P_bemt (x_(k+1) - x_k)

The fixed point is that of the solver's loads alone. Flap deflection is not handed over: it changes no load of a rotor
in hover to first order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.results import ShownBlock, make_lines_block, result
from mufly.rotor.blading import compute_rotor_polars, prepare_blading
from mufly.rotor.geometry import Rotor, rotor_from_tables
from mufly.rotor.rotor_system import Air
from mufly.rotor.structure.blade_beam import (
    NODE_FLAP_DOFS,
    NODE_TWIST_DOFS,
    BladeBeam,
    compute_centrifugal_load_over_speed2,
    stiffness_matrices,
)
from mufly.rotor.structure.elastic_rotor import (
    SpanLoads,
    differentiate_air_loads,
    solve_elastic_equilibrium,
    solve_twisted_rotor,
)

Array = NDArray[np.float64]

TWIST_TOLERANCE_RAD = math.radians(0.05)
"""Change of the tip's twist at which the rounds end."""
_MAX_TWIST_ITERATIONS = 8
_DEFORMED_STATION_COUNT = 33


@dataclass(frozen=True, eq=False)
class StripLoads:
    """Loads per unit span of one blade at the radii ``r_m``, (strips,) arrays.

    Attributes
    ----------
    r_m : array
        Radii, rising.
    axial_N_m, inplane_N_m : array
        Force along the shaft, up, and in the direction of rotation (N/m).
    quarter_chord_moment_N : array
        Moment about the quarter chord line, nose up (N m/m).
    """

    r_m: Array
    axial_N_m: Array
    inplane_N_m: Array
    quarter_chord_moment_N: Array

    def map_to_beam(self, beam: BladeBeam, pitch_rad: float, twist_rad: Array) -> SpanLoads:
        """Return the loads about the elastic axis at the Gauss points of a beam with an elastic twist."""

        def interpolate_to_gauss_points(values: Array) -> Array:
            return np.interp(beam.gauss_radii_m, self.r_m, values)

        theta = beam.twist_rad + pitch_rad + twist_rad
        axial, inplane = interpolate_to_gauss_points(self.axial_N_m), interpolate_to_gauss_points(self.inplane_N_m)
        normal = axial * np.cos(theta) - inplane * np.sin(theta)
        arm = (beam.axis_over_chord - 0.25) * beam.chord_m
        return SpanLoads(axial, inplane, interpolate_to_gauss_points(self.quarter_chord_moment_N) + arm * normal)


def add_elastic_twist(rotor: Rotor, beam: BladeBeam, twist_rad: Array) -> Rotor:
    """Return the rotor with an elastic twist at the nodes of its beam added to the built-in twist."""
    tables = rotor.toml_tables()
    stations = rotor.blade.r_over_R.to_si_array()
    cutout = float(rotor.hub_cutout)
    x = np.unique(np.concatenate((stations, np.linspace(max(cutout, stations[0]), 1.0, _DEFORMED_STATION_COUNT))))
    blade = tables["blade"]
    listed = list(rotor.blade.airfoils)
    if len(listed) > 1 and len(set(listed)) > 1:
        x = stations  # sections between stations are mixtures, which a file cannot name
    if rotor.blade.thickness is not None:
        blade["thickness"] = {**blade["thickness"], "value": rotor.stated_thickness(x).tolist()}
    more = np.interp(x * rotor.radius_m, beam.edges_m, twist_rad)
    for key, values in (("r_over_R", x), ("chord", rotor.chord_m(x)), ("twist", rotor.twist_rad(x) + more)):
        blade[key] = {**blade[key], "value": values.tolist()}
    blade["airfoils"] = listed if x.size == stations.size else listed[:1]
    return rotor_from_tables(tables, rotor.name)


@result(eq=False)
class AeroelasticSolution:
    """Result of solving rotor and blade beam in turn: the elastic twist after each round, and the final deflection.

    Attributes
    ----------
    tip_twist_by_round_rad : (rounds + 1,) array
        Elastic twist of the tip before the first round and after each.
    twist_rad : (nodes,) array
        Elastic twist at the end, nose up.
    r_m : (nodes,) array
        Radius of the nodes.
    deflection_m : (nodes,) array
        Deflection along the shaft, up.
    """

    tip_twist_by_round_rad: Array
    twist_rad: Array
    r_m: Array
    deflection_m: Array

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return twist and deflection of the tip as printed text."""
        twist = ", ".join(f"{angle:+.2f}" for angle in np.degrees(self.tip_twist_by_round_rad))
        return (
            make_lines_block(
                f"elastic blade, twist of the tip: {twist} degrees (blade elements, then after each round); tip up "
                f"{1e3 * self.deflection_m[-1]:.2f} mm"
            ),
        )


def iterate_elastic_twist(
    rotor: Rotor,
    beam: BladeBeam,
    solve: Callable[[Rotor, Array, int], StripLoads],
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    n_crit: float = 0.1,
    tolerance_rad: float = TWIST_TOLERANCE_RAD,
) -> AeroelasticSolution:
    """Alternate between a solver of rigid rotors and the beam of the blade until the tip's twist converges.

    Parameters
    ----------
    rotor : Rotor
        The undeformed rotor.
    beam : BladeBeam
    solve : callable
        Function of the deformed rotor, the elastic twist at the nodes (rad) and the round, from 1.
    pitch_rad, speed_rad_s, climb_m_s, air
        As for :func:`mufly.rotor.solve_rotor`.
    n_crit : float
        Of the polars that give the first twist and the derivative of the loads.
    tolerance_rad : float
        Greatest change of the tip's twist in the last round.

    Raises
    ------
    MuflyError
        If the twist does not converge within eight rounds, or the blade diverges.
    """
    polars = compute_rotor_polars(rotor, n_crit=n_crit)
    blading, gas = prepare_blading(rotor, polars), air or Air()
    point = {"pitch_rad": pitch_rad, "speed_rad_s": speed_rad_s, "climb_m_s": climb_m_s}
    first = solve_elastic_equilibrium(blading, beam, polars, **point, air=gas)
    x, root = first.displacement, beam.root_transform
    tips = [float(x[NODE_TWIST_DOFS][-1])]
    for turn in range(1, _MAX_TWIST_ITERATIONS + 1):
        held = beam.evaluate_shape("p", x)
        strips = solve(add_elastic_twist(rotor, beam, x[NODE_TWIST_DOFS]), x[NODE_TWIST_DOFS].copy(), turn)
        loads = strips.map_to_beam(beam, pitch_rad, held)
        step = math.radians(0.2)
        below, above = (
            solve_twisted_rotor(blading, beam, polars, held, **point, air=gas, more_rad=more)[1] for more in (0.0, step)
        )
        slope = differentiate_air_loads(beam, below, above, step)
        new, force = x.copy(), loads.load_vector(beam)
        for _ in range(20):
            phi = beam.evaluate_shape("p", new)
            elastic, centrifugal = stiffness_matrices(beam, pitch_rad, phi)
            stiff = elastic + speed_rad_s**2 * centrifugal
            right = (
                force
                + slope @ (new - x)
                + speed_rad_s**2 * compute_centrifugal_load_over_speed2(beam, pitch_rad, phi)
                - stiff @ new
            )
            change = root @ np.linalg.solve(root.T @ (stiff - slope) @ root, root.T @ right)
            new = new + change
            if np.max(np.abs(beam.evaluate_shape("p", change))) < 1e-9:
                break
        x = new
        tips.append(float(x[NODE_TWIST_DOFS][-1]))
        if abs(tips[-1] - tips[-2]) < tolerance_rad:
            return AeroelasticSolution(
                np.array(tips), x[NODE_TWIST_DOFS].copy(), beam.edges_m, x[NODE_FLAP_DOFS].copy()
            )
    raise MuflyError(
        f"rotor {rotor.name}: the tip's twist still changes by {math.degrees(abs(tips[-1] - tips[-2])):.2f} degrees "
        f"after {_MAX_TWIST_ITERATIONS} rounds; reduce the speed, or give a stiffer blade"
    )
