"""Constants of a blade's cross-section: area, centroid, moments of inertia, torsion constant, shear centre.

The section is thin: thickness t and camber line y over x, both from the contour, or a plate of constant thickness on
the camber line. With s the arc length of the camber line::

    A = int t dx                     x_c = int t x dx / A                     (the same for y)
    I_f = int t (y - y_c)^2 + t^3/12 dx                 about the chordwise axis through the centroid (flap)
    I_l = int t (x - x_c)^2 dx                          about the normal axis (lag)
    J = J0 / (1 + 4 J0 / (A s^2)),   J0 = int t^3/3 dx  (Saint-Venant; the divisor by Griffith and Prescott, R&M 399)

Shear centre of a thin open section (Vlasov's sectorial area, Timoshenko 1945; Gjelsvik, Thin Walled Bars, 1981). With
the pole at the centroid, d omega = x dy - y dx, and the shear centre at (a, b) from it::

    int omega x t ds - a S_xy + b S_xx = 0
    int omega y t ds + int x t^3/12 ds - a (S_yy + int t^3/12 ds) + b S_xy = 0

The terms with t^3/12 are the share of a plate that bends about its own middle line (own derivation, for small slopes).
The shear centre of a flat solid section then lies at int x t^3 / int t^3; that of a thin arc follows from its camber.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.rotor.sections.airfoil import load_airfoil, split_sides
from mufly.rotor.sections.polar_file import is_polar_file

Array = NDArray[np.float64]

_CHORD_POINT_COUNT = 121
_CHORD_POINTS: Array = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, _CHORD_POINT_COUNT)))


class SectionGeometry(NamedTuple):
    """Area, moments of inertia, torsion constant, centroid, shear centre and thickness of n sections, (n,) arrays.

    Attributes
    ----------
    area_m2, flap_inertia_m4, lag_inertia_m4, torsion_constant_m4 : arrays
        A, I_f, I_l about the centroid, J.
    centroid_m, shear_centre_m : arrays
        Distance behind the leading edge, along the chord.
    thickness_m : array
        Greatest thickness.
    """

    area_m2: Array
    flap_inertia_m4: Array
    lag_inertia_m4: Array
    torsion_constant_m4: Array
    centroid_m: Array
    shear_centre_m: Array
    thickness_m: Array


def thickness_and_camber_lines(name: str) -> tuple[Array, Array]:
    """Return thickness and camber line over chord of an airfoil at the module's chord points, (points,) each.

    Raises
    ------
    InputError
        If the airfoil is unknown, or a polar without a contour.
    """
    if is_polar_file(name):
        raise InputError(
            "blade.airfoils", name, "is a polar and has no contour", 'name one: blade.structure.contour = "naca4412"'
        )
    upper, lower = split_sides(load_airfoil(name).coordinates)
    high, low = np.interp(_CHORD_POINTS, *upper.T), np.interp(_CHORD_POINTS, *lower.T)
    return np.maximum(high - low, 0.0), 0.5 * (high + low)


def section_geometry(
    chord_m: Array, thickness: Array, camber: Array, plate_m: Array | float | None = None, scale: float = 1.0
) -> SectionGeometry:
    """Return area, moments of inertia, torsion constant, centroid, shear centre and thickness of cross-sections.

    Parameters
    ----------
    chord_m : (n,) array
    thickness, camber : (n, points) arrays
        Thickness and camber line over chord at the module's chord points (:func:`thickness_and_camber_lines`).
    plate_m : (n,) array or float, optional
        Thickness of a plate on the camber line (m), in place of the contour's.
    scale : float
        Factor on the thickness.
    """
    c = np.asarray(chord_m, dtype=np.float64)[:, None]
    x = _CHORD_POINTS * c
    y = camber * c
    t = thickness * c if plate_m is None else np.broadcast_to(np.reshape(plate_m, (-1, 1)), x.shape).copy()
    t = scale * t

    def integrate_over_chord(values: Array) -> Array:
        return np.asarray(np.trapezoid(values, x, axis=1))

    area = integrate_over_chord(t)
    x_c, y_c = integrate_over_chord(t * x) / area, integrate_over_chord(t * y) / area
    dx, dy = x - x_c[:, None], y - y_c[:, None]
    bending = integrate_over_chord(t**3) / 12.0
    slender = 4.0 * bending
    arc = np.sum(np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)), axis=1)
    return SectionGeometry(
        area,
        integrate_over_chord(t * dy**2) + bending,
        integrate_over_chord(t * dx**2),
        slender / (1.0 + 4.0 * slender / (area * arc**2)),
        x_c,
        shear_centre(x, y, t)[0],
        t.max(axis=1),
    )


def shear_centre(x: Array, y: Array, t: Array) -> tuple[Array, Array]:
    """Return the shear centre of thin open sections.

    Parameters
    ----------
    x, y : (..., n) arrays
        Points of the middle line, in order.
    t : (..., n) array
        Thickness at the points.

    Returns
    -------
    x, y : (...) arrays
        In the frame of the points.
    """
    step = np.hypot(np.diff(x), np.diff(y))
    weight = np.zeros_like(x)
    weight[..., :-1] += 0.5 * step
    weight[..., 1:] += 0.5 * step

    def weighted_integral(values: Array, of: Array) -> Array:
        return np.asarray(np.sum(of * values, axis=-1))

    mass = weight * t
    area = np.sum(mass, axis=-1)
    x_c, y_c = weighted_integral(x, mass) / area, weighted_integral(y, mass) / area
    u, v = x - x_c[..., None], y - y_c[..., None]
    omega = np.zeros_like(x)
    swept = 0.5 * ((u[..., 1:] + u[..., :-1]) * np.diff(v) - (v[..., 1:] + v[..., :-1]) * np.diff(u))
    omega[..., 1:] = np.cumsum(swept, axis=-1)
    omega -= (weighted_integral(omega, mass) / area)[..., None]
    plate = weight * t**3 / 12.0
    s_xx, s_yy, s_xy = (weighted_integral(p * q, mass) for p, q in ((u, u), (v, v), (u, v)))
    s_plate = s_yy + np.sum(plate, axis=-1)
    matrix = np.stack((np.stack((s_xy, -s_xx), axis=-1), np.stack((s_plate, -s_xy), axis=-1)), axis=-2)
    right = np.stack(
        (weighted_integral(omega * u, mass), weighted_integral(omega * v, mass) + weighted_integral(u, plate)), axis=-1
    )
    found = np.linalg.pinv(matrix) @ right[..., None]
    return np.asarray(x_c + found[..., 0, 0]), np.asarray(y_c + found[..., 1, 0])
