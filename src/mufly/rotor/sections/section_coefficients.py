"""Lift and drag coefficient of a blade section, interpolated between the polars of two airfoils and corrected.

The corrections: drag of a blunt trailing edge, compressible flow, stall delay by rotation, factors of a calibration.

:mod:`mufly.rotor.sections.polar_table` has the polars of airfoils.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.rotor.sections.polar_table import PolarStack, interpolate_polar_stack

Array = NDArray[np.float64]

_STALL_DELAY_FADE_START_RAD, _STALL_DELAY_FADE_END_RAD = math.radians(30.0), math.radians(50.0)
_KORN_FACTOR = 0.87  # technology factor of Korn's rule for conventional sections
_CRITICAL_MACH_OFFSET = (0.1 / 80.0) ** (1.0 / 3.0)
_MAX_MACH = 0.95  # Mach number above which the rules are held constant, so that every speed has a solution


class SectionParameters(NamedTuple):
    """Parameters of a blade section, as the compiled :func:`section_coefficients` takes them.

    Attributes
    ----------
    first_polar, second_polar : int
        Indices of the two polars that are mixed.
    second_weight : float
        Weight of the second polar.
    polar_zero_lift_rad, stall_delay_strength : float
        Zero-lift angle (rad), strength g of the stall delay model.
    lift_factor, drag_factor : float
        Factors on the coefficients.
    thickness_ratio : float
        Thickness over chord.
    edge_drag : float
        Drag constant of the blunt trailing edge (:func:`mufly.rotor.blading.blunt_edge_drag_product`).
    """

    first_polar: int
    second_polar: int
    second_weight: float
    polar_zero_lift_rad: float
    stall_delay_strength: float
    lift_factor: float
    drag_factor: float
    thickness_ratio: float
    edge_drag: float


class PolarGrid(NamedTuple):
    """Coefficients of a :class:`PolarStack` and the scale of its Reynolds axis, for compiled interpolation."""

    grid: Array
    log_reynolds_min: float
    rows_per_log_reynolds: float


@cached_njit(error_model="numpy")
def equivalent_incompressible_alpha(alpha: float, mach: float, zero_lift: float) -> float:
    """Return the angle of attack (rad) whose incompressible coefficients equal those at ``alpha`` and ``mach`` < 1.

    Prandtl and Glauert's rule as Goethert writes it (NACA TM 1105, 1946): to first order the pressures at an angle a
    from zero lift are those of incompressible flow at a / beta, beta = sqrt(1 - M^2). The lift slope grows by 1 / beta.
    Separation occurs at the same pressures and lift, hence at a smaller angle. The rule applies in full up to
    |alpha| = 30 degrees and fades out at 50. For the drag of shocks see :func:`section_coefficients`.
    """
    fade = min(
        max((_STALL_DELAY_FADE_END_RAD - abs(alpha)) / (_STALL_DELAY_FADE_END_RAD - _STALL_DELAY_FADE_START_RAD), 0.0),
        1.0,
    )
    return alpha + fade * (alpha - zero_lift) * (1.0 / math.sqrt(1.0 - mach * mach) - 1.0)


@cached_njit(error_model="numpy")
def section_coefficients(
    alpha: float, log_re: float, mach: float, section: SectionParameters, polars: PolarStack
) -> tuple[float, float]:
    """Return lift and drag coefficient of a section.

    Two polars are mixed by weight; the module docstring lists the corrections.

    Shocks add Lock's drag, 20 (M - M_cr)^4, M_cr = M_dd - (0.1 / 80)^(1/3), with Korn's drag divergence M_dd = 0.87 -
    t/c - |c_l| / 10 (Mason, AIAA 90-3262, 1990; 0.87: NACA 6 series).
    """
    weight, rotation = section.second_weight, section.stall_delay_strength
    mach = min(mach, _MAX_MACH)
    alpha = equivalent_incompressible_alpha(alpha, mach, section.polar_zero_lift_rad)
    cl, cd = interpolate_polar_stack(polars, section.first_polar, alpha, log_re)
    if weight > 0.0:
        cl2, cd2 = interpolate_polar_stack(polars, section.second_polar, alpha, log_re)
        cl, cd = cl + weight * (cl2 - cl), cd + weight * (cd2 - cd)
    if section.edge_drag > 0.0:
        cd += section.edge_drag / max(cd, 1e-4) ** (1.0 / 3.0)
    if rotation > 0.0:
        fade = min(
            max(
                (_STALL_DELAY_FADE_END_RAD - abs(alpha)) / (_STALL_DELAY_FADE_END_RAD - _STALL_DELAY_FADE_START_RAD),
                0.0,
            ),
            1.0,
        )
        if fade > 0.0:
            a = alpha - section.polar_zero_lift_rad
            attached = 2.0 * math.pi * math.sin(a) * math.cos(a) ** 2
            # Lift of the opposite sign near zero lift is no loss by separation; counted as one it makes cl jump.
            lost = min(attached - max(cl, 0.0), attached) if attached > 0.0 else max(attached - min(cl, 0.0), attached)
            if attached * lost > 0.0:
                gain = rotation * fade * lost
                cl += gain
                cd += max(gain * math.tan(alpha), 0.0)  # the recovered force is normal to the chord
    beyond = mach - (_KORN_FACTOR - section.thickness_ratio - 0.1 * abs(cl) - _CRITICAL_MACH_OFFSET)
    if beyond > 0.0 and mach > 0.0:
        cd += 20.0 * beyond**4
    return section.lift_factor * cl, section.drag_factor * cd
