"""Frequencies of a rotor file's blade over rotor speed, with bands for properties that the file does not state.

:func:`make_blade_beam` turns a rotor file into a :class:`BladeBeam`. :func:`compute_flap_mode` gives the first flap
mode of a blade at one speed, for models of the rotor in forward flight, and :func:`compute_campbell` the frequencies
over speed.

Bands have a nominal coverage of 90 %. Each cause of uncertainty (:func:`collect_property_stds`) is moved by 1.645
standard deviations to either side, and the changes of the result are added as root sum of squares, upwards and
downwards apart. A root that is unknown is no such cause: the lower end is then that of a free hinge at the shaft.

Lock number gamma = rho a c R^4 / I_b, for a chord that varies (own extension, exact for constant chord)::

    gamma = 4 rho a int_r0^R c r^3 dr / I_b,    a = 5.7 per rad    (Johnson, Helicopter Theory, 1980, ch. 5)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.quantities.units import RPM
from mufly.results import ShownBlock, ShownLines, ShownTable, result
from mufly.rotor.geometry import Rotor
from mufly.rotor.rotor_system import Air
from mufly.rotor.structure.blade_beam import GAUSS_POINTS, NODE_FLAP_DOFS, BeamModes, BladeBeam, compute_modes
from mufly.rotor.structure.blade_structure import BladeStructure, collect_property_stds
from mufly.rotor.structure.cross_section import section_geometry, thickness_and_camber_lines
from mufly.rotor.structure.materials import find_material

Array = NDArray[np.float64]

ELEMENT_COUNT = 20
LIFT_SLOPE_PER_RAD = 5.7
"""Lift slope (1/rad) of the Lock number."""
_SIGMAS_PER_90_PERCENT = 1.645
_STIFFNESS_RADIUS_FRACTION = 0.75  # r/R at which measured stiffnesses hold
_MIN_TIP_CHORD_FRACTION = 1e-3  # of the blade's greatest chord: least chord of a pointed tip

ASSUMED_STRUCTURE = BladeStructure(material="abs")
"""Structure of a blade whose file has none: moulded ABS, solid, with an unknown root."""


def blade_structure(rotor: Rotor) -> BladeStructure:
    """Return the structure of a rotor file.

    Raises
    ------
    InputError
        If the file has no table ``[blade.structure]``.
    """
    if rotor.blade.structure is None:
        raise InputError(
            f"rotor {rotor.name}", "blade.structure", "is missing: the material of the blade is not known",
            'add [blade.structure] with material = "abs" to its file',
        )  # fmt: skip
    return rotor.blade.structure


def _element_edges(rotor: Rotor, elements: int) -> Array:
    """Return the radii of the nodes (m): the stations of the file beyond the cut-out, and equal steps between them."""
    stations = rotor.radius_m * rotor.blade.r_over_R.to_si_array()
    r0, big = rotor.hub_radius_m, rotor.radius_m
    breaks = np.concatenate(([r0], stations[(stations > r0 * (1 + 1e-9)) & (stations < big * (1 - 1e-9))], [big]))
    parts = [np.linspace(a, b, max(1, round(elements * (b - a) / (big - r0))) + 1)[1:] for a, b in pairwise(breaks)]
    return np.concatenate(([r0], *parts))


def make_blade_beam(
    rotor: Rotor,
    structure: BladeStructure | None = None,
    *,
    factors: dict[str, float] | None = None,
    axis_shift: float = 0.0,
    elements: int = ELEMENT_COUNT,
) -> BladeBeam:
    """Return the beam of one blade.

    Parameters
    ----------
    rotor : Rotor
    structure : BladeStructure, optional
        Default: that of the rotor file.
    factors : dict, optional
        Factors on ``young``, ``shear``, ``density``, ``thickness`` and on the measured quantities of the structure, by
        their keys.
    axis_shift : float
        Shift of the elastic axis towards the tail, over chord.
    elements : int
        Elements along the span.

    Raises
    ------
    InputError
        If the structure is missing, an airfoil has no contour, or the hinge lies beyond the cut-out.
    """
    s = structure or blade_structure(rotor)
    f = {**dict.fromkeys(("young", "shear", "density", "thickness"), 1.0), **(factors or {})}
    material, big, r0 = find_material(s.material), rotor.radius_m, rotor.hub_radius_m
    edges = _element_edges(rotor, elements)
    points = edges[:-1, None] + np.diff(edges)[:, None] * GAUSS_POINTS
    at = np.concatenate((points.ravel(), [max(_STIFFNESS_RADIUS_FRACTION * big, r0)])) / big
    cut = rotor.sections_at(at)
    chord = np.maximum(cut.chord_m, _MIN_TIP_CHORD_FRACTION * cut.chord_m.max())
    names = (s.contour,) * len(cut.airfoil_names) if s.contour else cut.airfoil_names
    lines = [thickness_and_camber_lines(name) for name in names]
    share = cut.second_weight[:, None]
    thickness, camber = (
        (1.0 - share) * np.stack([line[k] for line in lines])[cut.first_airfoil]
        + share * np.stack([line[k] for line in lines])[cut.second_airfoil]
        for k in (0, 1)
    )
    plate = None if s.thickness is None else np.full(chord.size, float(s.thickness))
    k = section_geometry(chord, thickness, camber, plate, f["thickness"])
    young, shear = material.young_modulus_Pa * f["young"], material.shear_modulus_Pa * f["shear"]
    density = material.density_kg_m3 * f["density"]
    flap = np.full(chord.size, young)
    twist = np.full(chord.size, shear)
    if s.flap_stiffness is not None:
        flap[:] = float(s.flap_stiffness) * f.get("flap_stiffness", 1.0) / k.flap_inertia_m4[-1]
    if s.torsion_stiffness is not None:
        twist[:] = float(s.torsion_stiffness) * f.get("torsion_stiffness", 1.0) / k.torsion_constant_m4[-1]
    axis = k.shear_centre_m / chord if s.elastic_axis is None else np.full(chord.size, float(s.elastic_axis))
    axis = axis + axis_shift

    def interpolate_to_gauss_points(values: Array) -> Array:
        return np.asarray(values[:-1].reshape(points.shape))

    area = interpolate_to_gauss_points(k.area_m2)
    if s.mass is not None:
        weights = np.diff(edges)[:, None] * 0.5 * np.polynomial.legendre.leggauss(4)[1]
        density = float(s.mass) * f.get("mass", 1.0) / float(np.sum(weights * area))
    hinge, flap_spring = 0.0, math.inf
    if s.root == "hinged":
        hinge = 0.0 if s.hinge_radius is None else float(s.hinge_radius)
        flap_spring = 0.0 if s.flap_spring is None else float(s.flap_spring) * f.get("flap_spring", 1.0)
        if hinge > r0:
            raise InputError(
                f"rotor {rotor.name}", "blade.structure.hinge_radius",
                f"{1e3 * hinge:g} mm lies beyond the cut-out, {1e3 * r0:g} mm", "give a hinge inside the cut-out",
            )  # fmt: skip
    return BladeBeam(
        edges_m=edges,
        mass_kg_m=density * area,
        flap_EI=interpolate_to_gauss_points(flap * k.flap_inertia_m4),
        lag_EI=interpolate_to_gauss_points(flap * k.lag_inertia_m4),
        torsion_GJ=interpolate_to_gauss_points(twist * k.torsion_constant_m4),
        flap_inertia=density * interpolate_to_gauss_points(k.flap_inertia_m4),
        lag_inertia=density * interpolate_to_gauss_points(k.lag_inertia_m4),
        gyration_radius2_m2=interpolate_to_gauss_points((k.flap_inertia_m4 + k.lag_inertia_m4) / k.area_m2),
        centroid_behind_m=interpolate_to_gauss_points(k.centroid_m - axis * chord),
        twist_rad=interpolate_to_gauss_points(cut.twist_rad),
        chord_m=interpolate_to_gauss_points(chord),
        axis_over_chord=interpolate_to_gauss_points(axis),
        flap_root_N_m=flap_spring,
        hinge_radius_m=hinge,
        lag_root_N_m=math.inf if s.lag_spring is None else float(s.lag_spring) * f.get("lag_spring", 1.0),
        pitch_root_N_m=math.inf if s.pitch_spring is None else float(s.pitch_spring) * f.get("pitch_spring", 1.0),
    )


def with_free_flap_hinge(structure: BladeStructure) -> BladeStructure:
    """Return a structure with a free flap hinge at the shaft."""
    return structure.model_copy(update={"root": "hinged", "hinge_radius": None, "flap_spring": None})


def propagate_structure_uncertainty(
    rotor: Rotor, structure: BladeStructure, solve: Callable[[BladeBeam], Array]
) -> tuple[Array, Array, Array]:
    """Return what ``solve`` computes from a blade's beam, with the 90 % band due to uncertain properties of the blade.

    Parameters
    ----------
    rotor : Rotor
    structure : BladeStructure
    solve : callable
        Function of a beam that returns an array.

    Returns
    -------
    value, low, high : arrays
        Result of the nominal beam, and ends of the band.
    """
    value = np.asarray(solve(make_blade_beam(rotor, structure)), dtype=np.float64)
    up, down = np.zeros_like(value), np.zeros_like(value)
    for name, std in collect_property_stds(structure).items():
        both = []
        for sign in (1.0, -1.0):
            change = sign * _SIGMAS_PER_90_PERCENT * std
            if name == "elastic_axis":
                beam = make_blade_beam(rotor, structure, axis_shift=change)
            else:
                beam = make_blade_beam(rotor, structure, factors={name: math.exp(change)})
            both.append(np.asarray(solve(beam)) - value)
        up += np.maximum(np.maximum(*both), 0.0) ** 2
        down += np.minimum(np.minimum(*both), 0.0) ** 2
    return value, value - np.sqrt(down), value + np.sqrt(up)


@result(eq=False)
class FlapMode:
    """First flap mode of a blade at one rotor speed.

    Attributes
    ----------
    speed_rad_s : float
        Rotor speed.
    ratio : float
        Flap frequency in the rotating frame over rotor speed (1/rev).
    ratio_low, ratio_high : float
        Band of the ratio, see :mod:`mufly.rotor.structure.flap_modes`.
    lock_number : float
        Lock number gamma with a lift slope of 5.7 per rad.
    r_m : (n,) array
        Radius of the nodes, from the root to the tip.
    shape : (n,) array
        Deflection of the mode out of the rotor plane, 1 at the tip.
    mass_kg_m : (n,) array
        Mass per length of the blade at those radii (kg/m).
    known : bool
        True if the rotor file has a structure.
    assumptions : str
        Material and root on which the numbers rest.
    """

    speed_rad_s: float
    ratio: float
    ratio_low: float
    ratio_high: float
    lock_number: float
    r_m: Array
    shape: Array
    mass_kg_m: Array
    known: bool
    assumptions: str


def lock_number(rotor: Rotor, beam: BladeBeam, air: Air | None = None) -> float:
    """Return the Lock number of a blade."""
    density = (air or Air()).density_kg_m3
    moment = beam.integrate_over_span(beam.chord_m * beam.gauss_radii_m**3)
    return 4.0 * density * LIFT_SLOPE_PER_RAD * moment / beam.flap_inertia_about_shaft_kg_m2


def _describe_assumptions(structure: BladeStructure, known: bool) -> str:
    plate = "" if structure.thickness is None else f", {1e3 * float(structure.thickness):g} mm thick"
    root = {
        "unknown": "root unknown: clamped, and a free hinge at the shaft as lower end",
        "clamped": "clamped at the cut-out",
        "hinged": "hinged",
    }[structure.root]
    assumed = "" if known else "blade.structure is not in the rotor file; assumed: "
    return f"{assumed}{structure.material}{plate}, {root}"


def compute_flap_mode(rotor: Rotor, speed_rad_s: float, *, pitch_rad: float = 0.0) -> FlapMode:
    """Return the first flap mode of a rotor file's blade at a rotor speed, with the band of its frequency.

    A file without ``[blade.structure]`` gets :data:`ASSUMED_STRUCTURE`, and ``known`` is false.

    Parameters
    ----------
    rotor : Rotor
    speed_rad_s : float
        Rotor speed (rad/s), above 0.
    pitch_rad : float
        Pitch setting (rad).

    Raises
    ------
    InputError
        If the speed is not above 0, or the blade cannot be made (:func:`make_blade_beam`).
    """
    if not 0.0 < speed_rad_s < math.inf:
        raise InputError("rotor", "speed_rad_s", f"is {speed_rad_s:g}", "give a number above 0")
    known = rotor.blade.structure is not None
    s = rotor.blade.structure or ASSUMED_STRUCTURE

    def solve_frequencies(beam: BladeBeam) -> Array:
        found = compute_modes(beam, speed_rad_s, pitch_rad=pitch_rad, count=4)
        return np.array([found.frequency_rad_s[found.find_mode("flap")]]) / speed_rad_s

    value, low, high = propagate_structure_uncertainty(rotor, s, solve_frequencies)
    beam = make_blade_beam(rotor, s)
    if s.root == "unknown":
        low = solve_frequencies(make_blade_beam(rotor, with_free_flap_hinge(s)))
    modes = compute_modes(beam, speed_rad_s, pitch_rad=pitch_rad, count=4)
    x = modes.shape[modes.find_mode("flap")]
    shape = x[NODE_FLAP_DOFS]
    mass = np.interp(beam.edges_m, beam.gauss_radii_m.ravel(), beam.mass_kg_m.ravel())
    return FlapMode(
        speed_rad_s, float(value[0]), float(low[0]), float(high[0]), lock_number(rotor, beam), beam.edges_m,
        shape / shape[-1], mass, known, _describe_assumptions(s, known),
    )  # fmt: skip


_CAMPBELL_MODES = (("flap", 1), ("flap", 2), ("lag", 1), ("torsion", 1))


@result(eq=False)
class CampbellDiagram:
    """Natural frequencies of a blade over rotor speed.

    Attributes
    ----------
    rotor : str
        Name of the rotor.
    assumptions : str
        Material and root on which the numbers rest.
    speed_rad_s : (n,) array
        Rotor speeds.
    modes : tuple of str
        Names of the modes, as ``flap 1``.
    frequency_rad_s, low_rad_s, high_rad_s : (n, modes) arrays
        Frequencies in the rotating frame, and the ends of their bands.
    blade_mass_kg : float
        Mass of one blade outside the hub.
    flap_inertia_about_shaft_kg_m2 : float
        Its moment of inertia about the shaft.
    flap_EI, torsion_GJ : float
        Stiffnesses at 0.75 R (N m2).
    shear_centre, centroid : float
        Elastic axis and centroid at 0.75 R, over chord from the nose.
    lock_number : float
        Lock number with a lift slope of 5.7 per rad.
    hinged_flap_rad_s : (n,) array
        First flap frequency with a free hinge at the shaft.
    root_known : bool
        True if the file states the flap root.
    """

    rotor: str
    assumptions: str
    speed_rad_s: Array
    modes: tuple[str, ...]
    frequency_rad_s: Array
    low_rad_s: Array
    high_rad_s: Array
    blade_mass_kg: float
    flap_inertia_about_shaft_kg_m2: float
    flap_EI: float
    torsion_GJ: float
    shear_centre: float
    centroid: float
    lock_number: float
    hinged_flap_rad_s: Array
    root_known: bool

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the natural frequencies over rotor speed as printed text."""
        head = ShownLines((self.assumptions,), head=f"{self.rotor}: ")
        about = ShownLines((
            f"one blade: {1e3 * self.blade_mass_kg:.3g} g, {1e9 * self.flap_inertia_about_shaft_kg_m2:.4g} g mm2 "
            f"about the "
            f"shaft, Lock number {self.lock_number:.2f} (lift slope {LIFT_SLOPE_PER_RAD:g})",
            f"at 0.75 R: EI {1e3 * self.flap_EI:.3g} mN m2, GJ {1e3 * self.torsion_GJ:.3g} mN m2, elastic axis at "
            f"{self.shear_centre:.3f} c, centroid at {self.centroid:.3f} c",
        ))  # fmt: skip
        rows = []
        for k, speed in enumerate(self.speed_rad_s):
            row = [f"{speed / RPM:.0f}"]
            for j in range(len(self.modes)):
                hz = self.frequency_rad_s[k, j] / (2.0 * math.pi)
                row.append(f"{hz:.1f}" if speed == 0.0 else f"{hz:.1f} ({self.frequency_rad_s[k, j] / speed:.2f})")
            if speed > 0.0:
                low = self.low_rad_s[k, 0] / speed
                row.append(f"{low:.2f} to {self.high_rad_s[k, 0] / speed:.2f}")
            else:
                row.append("-")
            rows.append(tuple(row))
        table = ShownTable(
            ("rpm", *(f"{name} Hz (/rev)" for name in self.modes), "flap 1, 90 % band (/rev)"), tuple(rows)
        )
        tail = () if self.root_known else (
            ShownLines((
                "the root is not known: the band begins at a free hinge at the shaft; "
                'blade.structure.root = "clamped" or "hinged" narrows it',
            )),
        )  # fmt: skip
        return (head, about, table, *tail)


def compute_campbell(
    rotor: Rotor,
    speed_rad_s: Sequence[float] | Array,
    *,
    pitch_rad: float = 0.0,
    air: Air | None = None,
    structure: BladeStructure | None = None,
) -> CampbellDiagram:
    """Return the first two flap modes and the first of lag and torsion over rotor speed, with their bands.

    Parameters
    ----------
    rotor : Rotor
    speed_rad_s : (n,) array_like
        Rotor speeds (rad/s), 0 or more.
    pitch_rad : float
        Pitch setting (rad).
    air : Air, optional
        For the Lock number.
    structure : BladeStructure, optional
        In place of the file's.

    Raises
    ------
    InputError
        If the rotor file has no structure, or the blade cannot be made.
    """
    s = structure or blade_structure(rotor)
    speeds = np.asarray(speed_rad_s, dtype=np.float64)

    def solve_frequencies(beam: BladeBeam) -> Array:
        return np.array(
            [select_campbell_frequencies(compute_modes(beam, w, pitch_rad=pitch_rad, count=9)) for w in speeds]
        )

    value, low, high = propagate_structure_uncertainty(rotor, s, solve_frequencies)
    beam = make_blade_beam(rotor, s)
    hinged = make_blade_beam(rotor, with_free_flap_hinge(s))
    found = [compute_modes(hinged, w, pitch_rad=pitch_rad, count=3) for w in speeds]
    free = np.array([m.frequency_rad_s[m.find_mode("flap")] for m in found])
    if s.root == "unknown":
        low[:, 0] = free
    places, at = beam.gauss_radii_m.ravel(), _STIFFNESS_RADIUS_FRACTION * rotor.radius_m

    def interpolate_at_station(values: Array) -> float:
        return float(np.interp(at, places, values.ravel()))

    axis = interpolate_at_station(beam.axis_over_chord)
    return CampbellDiagram(
        rotor.name, _describe_assumptions(s, True), speeds,
        tuple(f"{kind} {k}" for kind, k in _CAMPBELL_MODES), value, low, high,
        beam.blade_mass_kg, beam.flap_inertia_about_shaft_kg_m2, interpolate_at_station(beam.flap_EI),
        interpolate_at_station(beam.torsion_GJ), axis,
        axis + interpolate_at_station(beam.centroid_behind_m) / interpolate_at_station(beam.chord_m),
        lock_number(rotor, beam, air), free, s.root != "unknown",
    )  # fmt: skip


def select_campbell_frequencies(found: BeamModes) -> Array:
    """Return the frequencies (rad/s) of a Campbell diagram's modes: flap 1 and 2, lag 1, torsion 1; nan if missing."""
    out = []
    for kind, order in _CAMPBELL_MODES:
        places = [k for k, name in enumerate(found.kind) if name == kind]
        out.append(found.frequency_rad_s[places[order - 1]] if len(places) >= order else math.nan)
    return np.array(out)
