"""Initial flow of a case: the slipstream of momentum theory.

A uniformly loaded disc sheds a vortex sheet around its slipstream. Here it consists of rings on the slipstream surface
that follows from continuity (Leishman, *Principles of Helicopter Aerodynamics*, sec. 2.2), with v_h the velocity in the
disc::

    v_h = sqrt(T / (2 rho pi R^2)),   k(z) = 1 + z / sqrt(R^2 + z^2),   R(z) = R / sqrt(k(z)),   z down from the disc
    strength of the sheet  gamma = 2 v_h  per length

Each ring's velocity is exact (elliptic integrals; Lamb, *Hydrodynamics*, sec. 161), with its core smoothed. The field
is free of sources and causes no pressure jump at the start, which would make a large domain oscillate for hundreds of
iterations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ellipe, ellipk

Array = NDArray[np.float64]
_VORTEX_RING_SPACING_RADII = 0.05  # spacing of the rings near the disc, over R


def compute_vortex_ring_velocity(
    r: Array, z: Array, radius: Array, height: Array, core: float | Array
) -> tuple[Array, Array]:
    """Return radial and axial velocity (m/s) at (r, z) due to vortex rings of strength 1 m^2/s; arrays broadcast."""
    dz = z - height
    far = (radius + r) ** 2 + dz**2 + core**2
    near = (radius - r) ** 2 + dz**2 + core**2
    m = 4.0 * radius * r / far
    k, e = ellipk(m), ellipe(m)
    root = np.sqrt(far)
    axial = (k + (radius**2 - r**2 - dz**2 - core**2) / near * e) / (2.0 * np.pi * root)
    radial = dz / np.maximum(r, 1e-12) * (-k + (radius**2 + r**2 + dz**2 + core**2) / near * e) / (2.0 * np.pi * root)
    return np.where(r > 1e-9, radial, 0.0), axial


def compute_momentum_slipstream(points: Array, *, radius_m: float, induced_m_s: float, climb_m_s: float = 0.0) -> Array:
    """Return the velocity of the air by momentum theory.

    Parameters
    ----------
    points : (n, 3) array
        Points (m), with the disc at z = 0, z up.
    radius_m : float
        Radius of the rotor.
    induced_m_s : float
        Induced velocity v_h in the disc, down.
    climb_m_s : float
        Climb velocity of the rotor, which is the oncoming velocity from above.

    Returns
    -------
    (n, 3) array
        Velocity (m/s).
    """
    r = np.hypot(points[:, 0], points[:, 1])
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    grid_r = np.concatenate((np.linspace(0.0, 1.6, 33), np.geomspace(1.7, max(2.0, 1.01 * r.max() / radius_m), 14)))
    up = np.concatenate((np.linspace(0.0, 1.0, 21), np.geomspace(1.1, max(1.2, 1.01 * high / radius_m), 10)))
    down = np.concatenate((np.linspace(0.0, 1.0, 21), np.geomspace(1.1, max(1.2, -1.01 * low / radius_m), 16)))
    grid_z = np.concatenate((-down[:0:-1], up))
    edges = np.concatenate(
        (np.arange(0.0, 8.0, _VORTEX_RING_SPACING_RADII), np.arange(8.0, 40.1, 8.0 * _VORTEX_RING_SPACING_RADII))
    )
    step, z_ring = np.diff(edges), -0.5 * (edges[1:] + edges[:-1])
    size = 1.0 / np.sqrt(1.0 - z_ring / np.sqrt(1.0 + z_ring**2))
    rr, zz = np.meshgrid(grid_r, grid_z, indexing="ij")
    radial, axial = compute_vortex_ring_velocity(rr[..., None], zz[..., None], size, z_ring, core=1.5 * step)
    fields = [
        RegularGridInterpolator((grid_r, grid_z), -2.0 * induced_m_s * (f @ step), bounds_error=False, fill_value=None)
        for f in (radial, axial)
    ]
    at = np.stack((r, points[:, 2]), axis=-1) / radius_m
    out, along = fields[0](at), fields[1](at)
    unit = points[:, :2] / np.maximum(r, 1e-12)[:, None]
    return np.column_stack((out[:, None] * unit, along - climb_m_s))
