"""The blade as a beam of finite elements: flap, lag and torsion in the frame that turns with the rotor.

Axes: r along the blade, y in the direction of rotation, z up the shaft; theta(r) is the angle of the chord line, nose
up. v, w are the deflections of the elastic axis along y and z, phi the elastic twist. The centroid, at which mass and
tension act, lies e behind the elastic axis. Potential energy per span, to second order in v, w, phi (own derivation;
the terms are those of Houbolt and Doggett, NACA TN 3905, 1957, and Bramwell, Helicopter Dynamics, ch. 7 and 9)::

    1/2 EI_f (w'' cos theta - v'' sin theta)^2 + 1/2 EI_l (v'' cos theta + w'' sin theta)^2    bending
    1/2 GJ phi'^2                                                                 torsion
    1/2 T [(v - e cos(theta + phi))'^2 + (w - e sin(theta + phi))'^2]             tension on the line of centroids
    1/2 T k_A^2 (theta' + phi')^2                                                 tension on twisted fibres
    -1/2 m Omega^2 (v - e cos(theta + phi))^2                                     centrifugal field in the plane
    -1/2 Omega^2 (I_f sin^2 + I_l cos^2)(theta + phi)                             propeller moment

with T = Omega^2 int_r^R m r dr, k_A^2 = (I_f + I_l) / A, I = rho times the area's moments. Kinetic energy: m times the
squared velocity of the centroid, and (I_f + I_l) phi-dot^2. Coriolis forces are left out: they couple flap and lag of a
coned blade and leave the frequencies of a stiff blade unchanged to second order in the coning angle.

Elements: Hermite cubics in v and w, quadratics in phi; four Gauss points each, at which all section properties are
evaluated. Root: clamped, or sprung hinges. A flap hinge at radius e < r0 makes w(r0) = (r0 - e) w'(r0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from mufly.errors import InputError

Array = NDArray[np.float64]

_LEGENDRE_NODES, _LEGENDRE_WEIGHTS = np.polynomial.legendre.leggauss(4)
GAUSS_POINTS: Array = 0.5 * (_LEGENDRE_NODES + 1.0)
"""Places of the Gauss points in an element, 0 to 1."""
_GAUSS_WEIGHTS: Array = 0.5 * _LEGENDRE_WEIGHTS
# Degrees of freedom of an element: v, v', w, w', phi of the inner node, phi of the middle, the same five outside.
_LAG_DOFS, _FLAP_DOFS, _TWIST_DOFS, _ELEMENT_DOF_COUNT = (0, 1, 6, 7), (2, 3, 8, 9), (4, 5, 10), 11
# Those of the root's node.
_ROOT_LAG_SLOPE_DOF, _ROOT_FLAP_DEFLECTION_DOF, _ROOT_FLAP_SLOPE_DOF, _ROOT_TWIST_DOF, _ROOT_DOF_COUNT = 1, 2, 3, 4, 5


def _make_integration_matrix() -> Array:
    """Return the matrix that integrates values at the Gauss points from each point to the end of the element."""
    powers = np.vander(GAUSS_POINTS, increasing=True)
    upto = (1.0 - GAUSS_POINTS[:, None] ** np.arange(1, 5)) / np.arange(1, 5)
    return np.asarray(upto @ np.linalg.inv(powers))


def _make_differentiation_matrix() -> Array:
    """Return the matrix from values at the Gauss points to the derivatives there, for an element of length 1."""
    powers = np.vander(GAUSS_POINTS, increasing=True)
    slopes = np.zeros_like(powers)
    slopes[:, 1:] = np.arange(1, 4) * powers[:, :-1]
    return np.asarray(slopes @ np.linalg.inv(powers))


NODE_FLAP_DOFS, NODE_TWIST_DOFS = slice(2, None, 6), slice(4, None, 6)
"""Places of the flap displacement (m) and the twist (rad) of the nodes in a displacement of the beam."""
_INTEGRATION_MATRIX, _DIFFERENTIATION_MATRIX = _make_integration_matrix(), _make_differentiation_matrix()


@dataclass(frozen=True, eq=False)
class BladeBeam:
    """Blade as a beam; section properties at four Gauss points of each element.

    Attributes
    ----------
    edges_m : (elements + 1,) array
        Radius of the nodes, from the root to the tip.
    mass_kg_m, flap_EI, lag_EI, torsion_GJ : (elements, 4) arrays
        Mass per length, EI_f, EI_l, GJ (N m2).
    flap_inertia, lag_inertia : (elements, 4) arrays
        Mass moments of inertia per length about the centroid, I_f and I_l (kg m).
    gyration_radius2_m2 : (elements, 4) array
        k_A^2 about the centroid.
    centroid_behind_m : (elements, 4) array
        e: centroid behind the elastic axis.
    twist_rad : (elements, 4) array
        Built-in twist.
    chord_m, axis_over_chord : (elements, 4) arrays
        Chord, and elastic axis over chord from the leading edge.
    flap_root_N_m : float
        Spring of the flap hinge (N m/rad); infinite: clamped.
    hinge_radius_m : float
        Radius of the flap hinge.
    lag_root_N_m, pitch_root_N_m : float
        Springs at the root (N m/rad); infinite: clamped, rigid.
    """

    edges_m: Array
    mass_kg_m: Array
    flap_EI: Array
    lag_EI: Array
    torsion_GJ: Array
    flap_inertia: Array
    lag_inertia: Array
    gyration_radius2_m2: Array
    centroid_behind_m: Array
    twist_rad: Array
    chord_m: Array
    axis_over_chord: Array
    flap_root_N_m: float = math.inf
    hinge_radius_m: float = 0.0
    lag_root_N_m: float = math.inf
    pitch_root_N_m: float = math.inf

    @cached_property
    def element_length_m(self) -> Array:
        """Length of each element."""
        return np.diff(self.edges_m)

    @cached_property
    def gauss_radii_m(self) -> Array:
        """Radius of the Gauss points, (elements, 4)."""
        return self.edges_m[:-1, None] + self.element_length_m[:, None] * GAUSS_POINTS

    @cached_property
    def gauss_weights_m(self) -> Array:
        """Integration weight of each Gauss point, as a length along the span, (elements, 4)."""
        return self.element_length_m[:, None] * _GAUSS_WEIGHTS

    def integrate_over_span(self, values: Array) -> float:
        """Return the integral of values at the Gauss points over the span."""
        return float(np.sum(self.gauss_weights_m * values))

    @property
    def blade_mass_kg(self) -> float:
        """Mass of the blade."""
        return self.integrate_over_span(self.mass_kg_m)

    @property
    def flap_inertia_about_shaft_kg_m2(self) -> float:
        """Moment of inertia of the blade about the shaft."""
        return self.integrate_over_span(self.mass_kg_m * self.gauss_radii_m**2)

    def differentiate_along_span(self, values: Array) -> Array:
        """Return the derivative along the span of values at the Gauss points, (elements, 4)."""
        return np.asarray(values @ _DIFFERENTIATION_MATRIX.T / self.element_length_m[:, None])

    @cached_property
    def tension_over_speed2_kg_m(self) -> Array:
        """Tension over Omega^2 at the Gauss points, (elements, 4)."""
        pull = self.mass_kg_m * self.gauss_radii_m
        each = np.sum(self.gauss_weights_m * pull, axis=1)
        beyond = np.concatenate((np.cumsum(each[::-1])[::-1][1:], [0.0]))
        return np.asarray(beyond[:, None] + self.element_length_m[:, None] * (pull @ _INTEGRATION_MATRIX.T))

    @cached_property
    def dof_count(self) -> int:
        """Number of degrees of freedom before the root conditions."""
        return 6 * self.element_length_m.size + 5

    @cached_property
    def _dof_indices(self) -> NDArray[np.int64]:
        return np.asarray(
            6 * np.arange(self.element_length_m.size)[:, None] + np.arange(_ELEMENT_DOF_COUNT), dtype=np.int64
        )

    @cached_property
    def shape_functions(self) -> dict[str, Array]:
        """Shape functions at the Gauss points, (elements, 4, 11): v, w, p, their slopes v1, w1, p1, bending v2, w2."""
        q, L = GAUSS_POINTS, self.element_length_m[:, None]
        one = np.ones_like(L)
        hermite = np.stack(
            (one * (1 - 3 * q**2 + 2 * q**3), L * (q - 2 * q**2 + q**3), one * (3 * q**2 - 2 * q**3), L * (q**3 - q**2))
        )
        slope = np.stack(((6 * q**2 - 6 * q) / L, one * (1 - 4 * q + 3 * q**2), (6 * q - 6 * q**2) / L,
                          one * (3 * q**2 - 2 * q)))  # fmt: skip
        bend = np.stack(((12 * q - 6) / L**2, (6 * q - 4) / L, (6 - 12 * q) / L**2, (6 * q - 2) / L))
        quad = np.stack((one * (1 - q) * (1 - 2 * q), one * 4 * q * (1 - q), one * q * (2 * q - 1)))
        turn = np.stack(((4 * q - 3) / L, (4 - 8 * q) / L, (4 * q - 1) / L))
        out = {}
        for name, values, where in (
            ("v", hermite, _LAG_DOFS), ("w", hermite, _FLAP_DOFS), ("p", quad, _TWIST_DOFS),
            ("v1", slope, _LAG_DOFS), ("w1", slope, _FLAP_DOFS), ("p1", turn, _TWIST_DOFS),
            ("v2", bend, _LAG_DOFS), ("w2", bend, _FLAP_DOFS),
        ):  # fmt: skip
            full = np.zeros((*self.gauss_radii_m.shape, _ELEMENT_DOF_COUNT))
            full[..., where] = np.moveaxis(values, 0, -1)
            out[name] = full
        return out

    @cached_property
    def root_transform(self) -> Array:
        """Matrix (size, free) from the free degrees of freedom to all: root conditions and hinge."""
        keep = np.eye(self.dof_count)[:, _ROOT_DOF_COUNT:]
        extra = []
        r0 = float(self.edges_m[0])
        for row, spring in (
            (_ROOT_LAG_SLOPE_DOF, self.lag_root_N_m),
            (_ROOT_FLAP_SLOPE_DOF, self.flap_root_N_m),
            (_ROOT_TWIST_DOF, self.pitch_root_N_m),
        ):
            if math.isfinite(spring):
                column = np.zeros(self.dof_count)
                column[row] = 1.0
                if row == _ROOT_FLAP_SLOPE_DOF:
                    column[_ROOT_FLAP_DEFLECTION_DOF] = r0 - self.hinge_radius_m
                extra.append(column)
        return np.column_stack([*extra, keep]) if extra else keep

    def assemble_matrix(self, *parts: tuple[Array | float, Array, Array], symmetric: bool = True) -> Array:
        """Return the integral of factor left right^T along the span, summed over (factor, left, right) in ``parts``.

        The matrix is (size, size); with ``symmetric``, only its symmetric part is returned.
        """
        total = np.zeros((self.element_length_m.size, _ELEMENT_DOF_COUNT, _ELEMENT_DOF_COUNT))
        for factor, left, right in parts:
            total += np.swapaxes((self.gauss_weights_m * factor)[..., None] * left, 1, 2) @ right
        if symmetric:
            total = 0.5 * (total + np.swapaxes(total, 1, 2))
        out = np.zeros((self.dof_count, self.dof_count))
        np.add.at(out, (self._dof_indices[:, :, None], self._dof_indices[:, None, :]), total)
        return out

    def assemble_load(self, *parts: tuple[Array | float, Array]) -> Array:
        """Return the load vector, the integral of factor times shape along the span, summed over all parts: (size,)."""
        out = np.zeros(self.dof_count)
        for factor, shape in parts:
            np.add.at(out, self._dof_indices, np.einsum("eg,egi->ei", self.gauss_weights_m * factor, shape))
        return out

    def evaluate_shape(self, name: str, x: Array) -> Array:
        """Return the deflection or slope ``name`` at the Gauss points, (elements, 4), of degrees of freedom ``x``.

        ``name`` is a key of :attr:`shape_functions`.
        """
        return np.asarray(np.einsum("egi,ei->eg", self.shape_functions[name], x[self._dof_indices]))


def stiffness_matrices(beam: BladeBeam, pitch_rad: float, twist_rad: Array | None = None) -> tuple[Array, Array]:
    """Return elastic stiffness, and centrifugal stiffness over Omega^2, both (size, size).

    Parameters
    ----------
    beam : BladeBeam
    pitch_rad : float
        Pitch setting, added to the built-in twist.
    twist_rad : (elements, 4) array, optional
        Elastic twist about which the centrifugal part is linear; default zero.
    """
    s = beam.shape_functions
    theta = beam.twist_rad + pitch_rad
    turned = theta if twist_rad is None else theta + twist_rad
    sine, cosine = np.sin(theta), np.cos(theta)
    flap = cosine[..., None] * s["w2"] - sine[..., None] * s["v2"]
    lag = cosine[..., None] * s["v2"] + sine[..., None] * s["w2"]
    elastic = beam.assemble_matrix(
        (beam.flap_EI, flap, flap), (beam.lag_EI, lag, lag), (beam.torsion_GJ, s["p1"], s["p1"])
    )
    for row, spring in (
        (_ROOT_LAG_SLOPE_DOF, beam.lag_root_N_m),
        (_ROOT_FLAP_SLOPE_DOF, beam.flap_root_N_m),
        (_ROOT_TWIST_DOF, beam.pitch_root_N_m),
    ):
        if math.isfinite(spring):
            elastic[row, row] += spring
    T, e, m = beam.tension_over_speed2_kg_m, beam.centroid_behind_m, beam.mass_kg_m
    sine, cosine = np.sin(turned), np.cos(turned)
    # (e cos phi)' and -(e sin phi)': the slopes of the centroid's line change by these with the twist.
    up = (e * cosine)[..., None] * s["p1"] + beam.differentiate_along_span(e * cosine)[..., None] * s["p"]
    back = -((e * sine)[..., None] * s["p1"] + beam.differentiate_along_span(e * sine)[..., None] * s["p"])
    inertia = beam.lag_inertia - beam.flap_inertia + m * e**2
    centrifugal = beam.assemble_matrix(
        (T, s["w1"], s["w1"]),
        (T, s["v1"], s["v1"]),
        (T * (beam.gyration_radius2_m2 + e**2), s["p1"], s["p1"]),
        (-2.0 * T, s["w1"], up),
        (-2.0 * T, s["v1"], back),
        (-m, s["v"], s["v"]),
        (-2.0 * m * e * sine, s["v"], s["p"]),
        (inertia * np.cos(2.0 * turned), s["p"], s["p"]),
    )
    if math.isfinite(beam.flap_root_N_m):  # tension in the rigid arm between hinge and blade
        arm = float(beam.edges_m[0]) - beam.hinge_radius_m
        centrifugal[_ROOT_FLAP_SLOPE_DOF, _ROOT_FLAP_SLOPE_DOF] += arm * beam.integrate_over_span(
            m * beam.gauss_radii_m
        )
    return elastic, centrifugal


def mass_matrix(beam: BladeBeam, pitch_rad: float) -> Array:
    """Return the mass matrix of the beam of the blade, (size, size)."""
    s, theta = beam.shape_functions, beam.twist_rad + pitch_rad
    m, e = beam.mass_kg_m, beam.centroid_behind_m
    turn = beam.flap_inertia + beam.lag_inertia + m * e**2
    return beam.assemble_matrix(
        (m, s["v"], s["v"]),
        (m, s["w"], s["w"]),
        (turn, s["p"], s["p"]),
        (-2.0 * m * e * np.cos(theta), s["w"], s["p"]),
        (2.0 * m * e * np.sin(theta), s["v"], s["p"]),
    )


def compute_centrifugal_load_over_speed2(beam: BladeBeam, pitch_rad: float, twist_rad: Array | None = None) -> Array:
    """Return the centrifugal load on the straight blade, divided by Omega^2, (size,).

    The load consists of propeller moment, untwisting by tension, and tension on the line of the centroids. With
    ``twist_rad`` (elements, 4) it is the load of the twisted blade, minus the linear part in
    :func:`stiffness_matrices`.
    """
    s, theta = beam.shape_functions, beam.twist_rad + pitch_rad
    phi = np.zeros_like(theta) if twist_rad is None else twist_rad
    turned = theta + phi
    T, e, m = beam.tension_over_speed2_kg_m, beam.centroid_behind_m, beam.mass_kg_m
    inertia = beam.lag_inertia - beam.flap_inertia + m * e**2
    moment = -0.5 * inertia * np.sin(2.0 * turned) + inertia * np.cos(2.0 * turned) * phi
    return beam.assemble_load(
        (moment, s["p"]),
        (-T * (beam.gyration_radius2_m2 + e**2) * beam.differentiate_along_span(beam.twist_rad), s["p1"]),
        (T * beam.differentiate_along_span(e * np.sin(theta)), s["w1"]),
        (T * beam.differentiate_along_span(e * np.cos(theta)), s["v1"]),
        (-m * e * np.cos(theta), s["v"]),
    )


@dataclass(frozen=True, eq=False)
class BeamModes:
    """Modes of a blade at one rotor speed, the lowest first.

    Attributes
    ----------
    speed_rad_s : float
        Rotor speed.
    frequency_rad_s : (n,) array
        Natural frequencies in the rotating frame; 0 where the motion diverges.
    kind : tuple of str
        ``flap``, ``lag`` or ``torsion`` by the greatest share of the kinetic energy.
    shape : (n, size) array
        Degrees of freedom of each mode, of unit generalised mass.
    """

    speed_rad_s: float
    frequency_rad_s: Array
    kind: tuple[str, ...]
    shape: Array

    def find_mode(self, kind: str, order: int = 1) -> int:
        """Return the index of the ``order``-th mode of a kind (flap, lag or torsion).

        Raises
        ------
        InputError
            If it is not among the computed modes.
        """
        places = [k for k, name in enumerate(self.kind) if name == kind]
        if len(places) < order:
            raise InputError("beam", kind, f"mode {order} is not among {len(self.kind)} modes", "ask for more modes")
        return places[order - 1]


def compute_modes(beam: BladeBeam, speed_rad_s: float, *, pitch_rad: float = 0.0, count: int = 8) -> BeamModes:
    """Compute the natural frequencies and mode shapes of a blade at a rotor speed.

    Parameters
    ----------
    beam : BladeBeam
    speed_rad_s : float
        Rotor speed, 0 or more.
    pitch_rad : float
        Pitch setting, added to the built-in twist.
    count : int
        Number of modes.
    """
    elastic, centrifugal = stiffness_matrices(beam, pitch_rad)
    full = mass_matrix(beam, pitch_rad)
    root = beam.root_transform
    stiff, mass = root.T @ (elastic + speed_rad_s**2 * centrifugal) @ root, root.T @ full @ root
    values, vectors = linalg.eigh(stiff, mass, subset_by_index=(0, min(count, mass.shape[0]) - 1))
    shape = (root @ vectors).T
    m, turn = beam.mass_kg_m, beam.flap_inertia + beam.lag_inertia
    kinds = []
    for x in shape:
        parts = {
            "flap": beam.integrate_over_span(m * beam.evaluate_shape("w", x) ** 2),
            "lag": beam.integrate_over_span(m * beam.evaluate_shape("v", x) ** 2),
            "torsion": beam.integrate_over_span(turn * beam.evaluate_shape("p", x) ** 2),
        }
        kinds.append(max(parts, key=lambda name: parts[name]))
    return BeamModes(speed_rad_s, np.sqrt(np.maximum(values, 0.0)), tuple(kinds), shape)
