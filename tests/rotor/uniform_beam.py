"""A beam whose modes have closed forms."""

from __future__ import annotations

import math

import numpy as np

from mufly.rotor.structure.blade_beam import Array, BladeBeam


def uniform_beam(
    length_m: float,
    *,
    mass_kg_m: float,
    flap_EI: float,
    lag_EI: float,
    torsion_GJ: float,
    flap_inertia: float = 0.0,
    lag_inertia: float = 1e-9,
    root_radius_m: float = 0.0,
    elements: int = 24,
    flap_root_N_m: float = math.inf,
    hinge_radius_m: float = 0.0,
) -> BladeBeam:
    """Return a beam of constant section without twist and offsets, for comparison with closed forms.

    Parameters
    ----------
    length_m, root_radius_m : float
        Length, and radius of the root (m).
    mass_kg_m, flap_EI, lag_EI, torsion_GJ, flap_inertia, lag_inertia : float
        As for :class:`BladeBeam`.
    elements : int
    flap_root_N_m, hinge_radius_m : float
        As for :class:`BladeBeam`.
    """
    edges = root_radius_m + np.linspace(0.0, length_m, elements + 1)

    def fill(value: float) -> Array:
        return np.full((elements, 4), value)

    return BladeBeam(
        edges, fill(mass_kg_m), fill(flap_EI), fill(lag_EI), fill(torsion_GJ), fill(flap_inertia), fill(lag_inertia),
        fill((flap_inertia + lag_inertia) / mass_kg_m), fill(0.0), fill(0.0), fill(0.1 * length_m),
        fill(0.25), flap_root_N_m, hinge_radius_m,
    )  # fmt: skip
