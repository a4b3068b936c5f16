"""A rotor with elastic blades in hover and axial flight: blade elements and the beam of the blade in equilibrium.

Blade element momentum theory gives thrust, drag and moment per span of the twisted blade. The beam of
:mod:`mufly.rotor.structure.blade_beam` gives twist and deflection under these loads and the centrifugal field. About
the elastic axis at x_ea (over chord, from the nose) a section has the nose-up moment per span

    m_a = rho/2 W^2 c^2 [c_m + (c_l cos alpha + c_d sin alpha) (x_ea - 1/4)]

with c_m about the quarter chord, from the polar. Newton's method finds the equilibrium K x = F(x). Propeller moment
and tension enter with their exact derivatives. The derivative of the air loads comes from a second solution of the
rotor with 0.2 degrees more pitch, which holds the feedback of the inflow for a uniform change of twist.

Divergence: elastic stiffness K_e is constant, centrifugal stiffness C and the derivative P of the air loads grow with
Omega^2. At the rotor speed at which K_e + Omega^2 (C - P / Omega^2) becomes singular the twist has no equilibrium::

    K_e x = Omega_D^2 (P / Omega^2 - C) x

Left out: the loss of thrust by coning (cos beta, 0.3 % at 4 degrees) and the change of radius.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.results import ShownBlock, ShownLines, ShownTable, result
from mufly.rotor.bemt import solve_rotor
from mufly.rotor.blading import Blading, Corrections, compute_rotor_polars, prepare_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.rotor_system import Air, RotorResult
from mufly.rotor.sections.polar_engines import PolarEngine
from mufly.rotor.sections.polar_table import PolarTable, lookup_moment
from mufly.rotor.structure.blade_beam import (
    NODE_FLAP_DOFS,
    NODE_TWIST_DOFS,
    BladeBeam,
    compute_centrifugal_load_over_speed2,
    stiffness_matrices,
)
from mufly.rotor.structure.blade_structure import BladeStructure
from mufly.rotor.structure.flap_modes import blade_structure, propagate_structure_uncertainty

Array = NDArray[np.float64]

_MAX_TWIST_ITERATIONS = 40
_TWIST_TOLERANCE_RAD = 1e-10
_MAX_TWIST_RAD = math.radians(30.0)
_PITCH_STEP_RAD = math.radians(0.2)
NEAR_DIVERGENCE_SPEED_RATIO = 0.7
"""Rotor speed over divergence speed beyond which a blade is near divergence: loads then twist it twice as much."""


@dataclass(frozen=True, eq=False)
class SpanLoads:
    """Loads per unit span of one blade at the Gauss points of its beam, (elements, 4) arrays.

    Attributes
    ----------
    axial_N_m, inplane_N_m : arrays
        Force along the shaft, up, and in the direction of rotation (N/m).
    elastic_axis_moment_N : array
        Moment about the elastic axis, nose up (N m/m).
    """

    axial_N_m: Array
    inplane_N_m: Array
    elastic_axis_moment_N: Array

    def load_vector(self, beam: BladeBeam) -> Array:
        """Return the loads as the load vector of the beam's degrees of freedom, (size,)."""
        s = beam.shape_functions
        return beam.assemble_load(
            (self.axial_N_m, s["w"]), (self.inplane_N_m, s["v"]), (self.elastic_axis_moment_N, s["p"])
        )


def compute_section_moment_coefficients(
    found: RotorResult, blading: Blading, polars: Mapping[str, PolarTable]
) -> Array:
    """Return the moment coefficient about the quarter chord at the stations of a rotor, (stations,)."""
    rotor = blading.rotors[0]
    cut = rotor.sections_at(found.r_m / rotor.radius_m)
    each = np.stack([lookup_moment(polars[name], found.alpha_rad, found.reynolds) for name in cut.airfoil_names])
    along = np.arange(found.r_m.size)
    inner, outer = each[cut.first_airfoil, along], each[cut.second_airfoil, along]
    return np.asarray((1.0 - cut.second_weight) * inner + cut.second_weight * outer)


def compute_beam_loads(
    beam: BladeBeam, found: RotorResult, blading: Blading, polars: Mapping[str, PolarTable], air: Air
) -> SpanLoads:
    """Return the loads of a blade-element solution on a beam.

    Parameters
    ----------
    beam : BladeBeam
    found : RotorResult
    blading : Blading
        The blading solved, of one rotor.
    polars : mapping
        Polar by airfoil name.
    air : Air
    """
    count = blading.rotors[0].blades
    wind = found.reynolds * air.viscosity_Pa_s / (air.density_kg_m3 * found.chord_m)
    size = 0.5 * air.density_kg_m3 * wind**2 * found.chord_m**2
    normal = found.cl * np.cos(found.alpha_rad) + found.cd * np.sin(found.alpha_rad)
    axial = found.dT_N / (found.dr_m * count)
    inplane = -found.dQ_Nm / (found.r_m * found.dr_m * count)

    def interpolate_to_gauss_points(values: Array) -> Array:
        return np.interp(beam.gauss_radii_m, found.r_m, values)

    arm = interpolate_to_gauss_points(size * normal) * (beam.axis_over_chord - 0.25)
    return SpanLoads(
        interpolate_to_gauss_points(axial),
        interpolate_to_gauss_points(inplane),
        interpolate_to_gauss_points(size * compute_section_moment_coefficients(found, blading, polars)) + arm,
    )


@dataclass(frozen=True, eq=False)
class BladeEquilibrium:
    """Equilibrium of a rotor with elastic blades.

    Attributes
    ----------
    rotor : RotorResult
        Loads of the deformed rotor.
    beam : BladeBeam
    displacement : (size,) array
        Degrees of freedom of the beam.
    loads : SpanLoads
        Air loads of the equilibrium.
    divergence_rad_s : float
        Rotor speed of static divergence with the derivatives of this state; infinite if there is none.
    rounds : int
        Newton steps.
    """

    rotor: RotorResult
    beam: BladeBeam
    displacement: Array
    loads: SpanLoads
    divergence_rad_s: float
    rounds: int

    @property
    def twist_rad(self) -> Array:
        """Elastic twist at the nodes, nose up."""
        return np.asarray(self.displacement[NODE_TWIST_DOFS])

    @property
    def deflection_m(self) -> Array:
        """Deflection along the shaft at the nodes, up."""
        return np.asarray(self.displacement[NODE_FLAP_DOFS])


def differentiate_air_loads(beam: BladeBeam, below: SpanLoads, above: SpanLoads, step_rad: float) -> Array:
    """Return the derivative of the air loads with respect to the displacement, (size, size).

    ``below`` and ``above`` are the loads at two pitch angles, ``step_rad`` apart.
    """
    s = beam.shape_functions
    out = np.zeros((beam.dof_count, beam.dof_count))
    for name, change in (
        ("w", above.axial_N_m - below.axial_N_m),
        ("v", above.inplane_N_m - below.inplane_N_m),
        ("p", above.elastic_axis_moment_N - below.elastic_axis_moment_N),
    ):
        out += beam.assemble_matrix((change / step_rad, s[name], s["p"]), symmetric=False)
    return out


def divergence_speed(beam: BladeBeam, elastic: Array, destabilising: Array) -> float:
    """Return the rotor speed (rad/s) at which the blade diverges; infinite if there is none.

    It is the root of the least positive eigenvalue mu of K_e x = mu D x.

    Parameters
    ----------
    beam : BladeBeam
    elastic : (size, size) array
        K_e.
    destabilising : (size, size) array
        D, which grows with the square of the speed: derivative of the loads less centrifugal stiffness, over Omega^2.
    """
    root = beam.root_transform
    flexible = np.linalg.solve(root.T @ elastic @ root, root.T @ destabilising @ root)
    values = np.asarray(linalg.eigvals(flexible), dtype=np.complex128)
    real = values.real[(np.abs(values.imag) < 1e-6 * np.abs(values)) & (values.real > 0.0)]
    return math.sqrt(1.0 / float(real.max())) if real.size else math.inf


def solve_twisted_rotor(
    blading: Blading,
    beam: BladeBeam,
    polars: Mapping[str, PolarTable],
    twist_rad: Array,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float,
    air: Air,
    more_rad: float = 0.0,
) -> tuple[RotorResult, SpanLoads]:
    """Solve a rotor whose blades have an elastic twist at the Gauss points; return the solution and the span loads.

    ``more_rad`` is added to the pitch.
    """
    there = np.interp(blading.r_m[0], beam.gauss_radii_m.ravel(), twist_rad.ravel())
    bent = replace(blading, twist_rad=blading.twist_rad + there)
    found = solve_rotor(bent, pitch_rad=pitch_rad + more_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air)
    return found, compute_beam_loads(beam, found, blading, polars, air)


def solve_elastic_equilibrium(
    blading: Blading,
    beam: BladeBeam,
    polars: Mapping[str, PolarTable],
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
) -> BladeEquilibrium:
    """Solve one rotor with elastic blades.

    Parameters
    ----------
    blading : Blading
        Blading of one rotor, undeformed.
    beam : BladeBeam
        From :func:`mufly.rotor.structure.flap_modes.make_blade_beam`.
    polars : mapping
        Polar by airfoil name.
    pitch_rad, speed_rad_s, climb_m_s, air
        As for :func:`mufly.rotor.solve_rotor`.

    Raises
    ------
    InputError
        If the speed is not above zero or a number is not finite.
    MuflyError
        If the twist has no equilibrium below 30 degrees: the blade diverges.
    """
    gas, root = air or Air(), beam.root_transform

    def solve_loads(twist: Array, more: float = 0.0) -> tuple[RotorResult, SpanLoads]:
        return solve_twisted_rotor(
            blading, beam, polars, twist, pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=gas,
            more_rad=more,
        )  # fmt: skip

    x = np.zeros(beam.dof_count)
    phi = beam.evaluate_shape("p", x)
    for turn in range(1, _MAX_TWIST_ITERATIONS + 1):
        found, loads = solve_loads(phi)
        _, above = solve_loads(phi, _PITCH_STEP_RAD)
        slope = differentiate_air_loads(beam, loads, above, _PITCH_STEP_RAD)
        elastic, centrifugal = stiffness_matrices(beam, pitch_rad, phi)
        stiff = elastic + speed_rad_s**2 * centrifugal
        force = loads.load_vector(beam) + speed_rad_s**2 * compute_centrifugal_load_over_speed2(beam, pitch_rad, phi)
        step = root @ np.linalg.solve(root.T @ (stiff - slope) @ root, root.T @ (force - stiff @ x))
        x = x + step
        phi = beam.evaluate_shape("p", x)
        if not np.max(np.abs(phi)) < _MAX_TWIST_RAD:
            break
        if np.max(np.abs(beam.evaluate_shape("p", step))) < _TWIST_TOLERANCE_RAD:
            found, loads = solve_loads(phi)
            limit = divergence_speed(beam, elastic, slope / speed_rad_s**2 - centrifugal)
            return BladeEquilibrium(found, beam, x, loads, limit, turn)
    raise MuflyError(
        f"rotor {blading.rotors[0].name}: at {speed_rad_s / RPM:.0f} rpm and {math.degrees(pitch_rad):.1f} degrees the "
        f"blade diverges: its elastic twist finds no equilibrium below {math.degrees(_MAX_TWIST_RAD):.0f} degrees; "
        "turn slower, or give a thicker blade or a stiffer material"
    )


@result(eq=False)
class ElasticRotorResult:
    """Rotor with elastic blades beside the same rotor with rigid blades, with 90 % bands.

    Attributes
    ----------
    rigid, elastic : RotorResult
        Loads of the rigid and of the deformed rotor.
    r_m : (n,) array
        Radius of the nodes of the beam.
    twist_rad, twist_low_rad, twist_high_rad : (n,) arrays
        Elastic twist, nose up, and the ends of its band.
    deflection_m : (n,) array
        Deflection along the shaft, up.
    tip_twist_rad : float
        Elastic twist of the tip, nose up.
    coning_rad : float
        Slope of the line from the root to the tip.
    thrust_low_N, thrust_high_N, torque_low_Nm, torque_high_Nm : float
        Ends of the bands; infinite where a blade of the band diverges.
    divergence_rad_s, divergence_low_rad_s : float
        Rotor speed of static divergence, and the least of the band's blades; infinite if there is none.
    elastic_axis : float
        Elastic axis at 0.75 R over chord, from the nose.
    axis_known : bool
        True if the rotor file states the elastic axis.
    """

    rigid: RotorResult
    elastic: RotorResult
    r_m: Array
    twist_rad: Array
    twist_low_rad: Array
    twist_high_rad: Array
    deflection_m: Array
    tip_twist_rad: float
    coning_rad: float
    thrust_low_N: float
    thrust_high_N: float
    torque_low_Nm: float
    torque_high_Nm: float
    divergence_rad_s: float
    divergence_low_rad_s: float
    elastic_axis: float
    axis_known: bool

    @property
    def is_near_divergence(self) -> bool:
        """True if the rotor turns faster than 0.7 of the lower end of the divergence speed's 90 % band."""
        return self.rigid.speed_rad_s > NEAR_DIVERGENCE_SPEED_RATIO * self.divergence_low_rad_s

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return loads and twist of the elastic and the rigid rotor as printed text."""
        rigid, bent = self.rigid, self.elastic

        def format_change(new: float, old: float) -> str:
            return f"{100.0 * (new / old - 1.0):+.1f} %" if old else "-"

        def format_band(low: float, high: float, form: str) -> str:
            end = f"{high:{form}}" if math.isfinite(high) else "diverges"
            return f"{low:{form}} to {end}"

        rows = (
            ("thrust (N)", f"{rigid.thrust_N:.4g}",
             f"{bent.thrust_N:.4g} ({format_change(bent.thrust_N, rigid.thrust_N)})",
             format_band(self.thrust_low_N, self.thrust_high_N, ".4g")),
            ("torque (mN m)", f"{1e3 * rigid.torque_Nm:.4g}",
             f"{1e3 * bent.torque_Nm:.4g} ({format_change(bent.torque_Nm, rigid.torque_Nm)})",
             format_band(1e3 * self.torque_low_Nm, 1e3 * self.torque_high_Nm, ".4g")),
            ("figure of merit", f"{rigid.figure_of_merit:.3f}", f"{bent.figure_of_merit:.3f}", ""),
            ("tip twist (deg)", "0", f"{math.degrees(self.tip_twist_rad):+.2f}",
             format_band(math.degrees(self.twist_low_rad[-1]), math.degrees(self.twist_high_rad[-1]), "+.2f")),
            ("tip deflection (mm)", "0", f"{1e3 * self.deflection_m[-1]:.2f}", ""),
            ("coning (deg)", "0", f"{math.degrees(self.coning_rad):.2f}", ""),
        )  # fmt: skip
        table = ShownTable(("", "rigid", "elastic", "90 % band"), rows, text=(0, 1, 2, 3))
        lines = []
        if self.is_near_divergence:
            low, value = (f"{v / RPM:.0f}" for v in (self.divergence_low_rad_s, self.divergence_rad_s))
            lines.append(
                f"near divergence: the twist has no equilibrium from {value} rpm on, in the band from {low} rpm on; "
                "turn slower, or give a thicker blade or a stiffer material"
            )
        if not self.axis_known:
            lines.append(
                f"the elastic axis is not known: {self.elastic_axis:.3f} c from the contour, ± 0.08 c in the band; "
                "blade.structure.elastic_axis narrows it"
            )
        return (table, ShownLines(tuple(lines), style="yellow")) if lines else (table,)


def solve_elastic_rotor(
    rotor: Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    structure: BladeStructure | None = None,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    corrections: Corrections | None = None,
) -> ElasticRotorResult:
    """Solve a rotor with elastic and with rigid blades; 90 % bands cover properties that the rotor file leaves open.

    Parameters
    ----------
    rotor : Rotor
    pitch_rad, speed_rad_s, climb_m_s, air
        As for :func:`mufly.rotor.solve_rotor`.
    structure : BladeStructure, optional
        In place of the file's.
    n_crit, engine, corrections
        As for :func:`mufly.rotor.prepare_blading`.

    Raises
    ------
    InputError
        If the rotor has no structure, or a value is impossible.
    MuflyError
        If the blade diverges.
    """
    s = structure or blade_structure(rotor)
    if rotor.fit is not None:
        raise InputError(
            f"rotor {rotor.name}", "fit", "holds the twist of the loaded blade", "delete [fit] from the file"
        )
    polars = compute_rotor_polars(rotor, n_crit=n_crit, engine=engine)
    blading = prepare_blading(rotor, polars, corrections=corrections)
    point = {"pitch_rad": pitch_rad, "speed_rad_s": speed_rad_s, "climb_m_s": climb_m_s}
    rigid = solve_rotor(blading, pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air)
    states: list[BladeEquilibrium] = []
    limits: list[float] = []

    def solve_loads_and_twist(beam: BladeBeam) -> Array:
        try:
            state = solve_elastic_equilibrium(blading, beam, polars, **point, air=air)
        except InputError:
            raise
        except MuflyError:
            if not states:
                raise
            limits.append(speed_rad_s)
            return np.full(2 + beam.edges_m.size, math.inf)
        states.append(state)
        limits.append(state.divergence_rad_s)
        return np.concatenate(([state.rotor.thrust_N, state.rotor.torque_Nm], state.twist_rad))

    _, low, high = propagate_structure_uncertainty(rotor, s, solve_loads_and_twist)
    first = states[0]
    beam = first.beam
    reach = float(beam.edges_m[-1]) - (beam.hinge_radius_m if s.root == "hinged" else float(beam.edges_m[0]))
    axis = float(np.interp(0.75 * rotor.radius_m, beam.gauss_radii_m.ravel(), beam.axis_over_chord.ravel()))
    return ElasticRotorResult(
        rigid, first.rotor, beam.edges_m, first.twist_rad, low[2:], high[2:], first.deflection_m,
        float(first.twist_rad[-1]), math.atan(float(first.deflection_m[-1]) / reach), float(low[0]), float(high[0]),
        float(low[1]), float(high[1]), first.divergence_rad_s, min(limits), axis,
        s.elastic_axis is not None,
    )  # fmt: skip
