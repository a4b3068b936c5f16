"""Section coefficients of every station over the onset angle, for the kernel over azimuth.

The onset angle is that of the chord to the wind at the quarter chord line. It differs from the angle of attack by the
finite chord, onset = alpha + e c_l(alpha) (:mod:`mufly.rotor.blading`). A table holds c_l and c_d of a station
with mixed polars, blunt edge, stall delay, compressible flow and calibration over the onset angle and log Re. Chord
and air fix the Mach number at each Reynolds number.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError
from mufly.rotor.blading import Blading
from mufly.rotor.rotor_system import Air
from mufly.rotor.sections.polar_table import ALPHA_GRID
from mufly.rotor.sections.section_coefficients import PolarGrid, SectionParameters, section_coefficients

Array = NDArray[np.float64]

_ANGLE_CELLS_PER_HALF_CIRCLE = 720  # angles of attack per half circle from which the onset angle is inverted
_MAX_MACH = 0.95


@cached_njit(error_model="numpy", nogil=True)
def _fill_coefficients(
    alpha: Array, log_re: Array, mach: Array, section: SectionParameters, polars: PolarGrid, out: Array
) -> None:
    for j in range(alpha.shape[0]):
        for n in range(alpha.shape[1]):
            out[j, n, 0], out[j, n, 1] = section_coefficients(alpha[j, n], log_re[j], mach[j], section, polars)


def _angles_from_onset_angles(onset: Array, zero: float, alpha: Array, reached: Array) -> Array:
    """Return the angles of attack that give the onset angles (module docstring), the first outward from zero lift."""
    out = np.empty_like(onset)
    middle = alpha.size // 2
    up = np.maximum.accumulate(reached[middle:])
    down = np.minimum.accumulate(reached[middle::-1])
    above = onset >= zero
    out[above] = np.interp(onset[above], up, alpha[middle:])
    out[~above] = np.interp(-onset[~above], -down, alpha[middle::-1])
    return out


@lru_cache(maxsize=16)
def tabulate_section_coefficients(blading: Blading, which: int, air: Air) -> Array:
    """Return a table of c_l and c_d of the stations of a rotor, (stations, Reynolds numbers, angles, 2).

    The angles are those of :data:`mufly.rotor.sections.polar_table.ALPHA_GRID` with one more at each end; the Reynolds
    numbers are those of the blading's polars. The last 16 tables are kept.

    Raises
    ------
    InputError
        For corrections that depend on the pitch setting.
    """
    fixes, stack = blading.corrections, blading.polars
    if fixes.stall_delay == "chaviaropoulos-hansen" or fixes.tip_loss == "effective_radius":
        name = fixes.stall_delay if fixes.stall_delay == "chaviaropoulos-hansen" else fixes.tip_loss
        raise InputError(
            "rotor forward", "corrections", f"{name!r} is not available over azimuth",
            "use --model full or plain (Prandtl's tip loss; stall delay of Dumitrescu and Cardos, Snel or none)",
        )  # fmt: skip
    polars = PolarGrid(stack.grid, stack.log_reynolds_min, stack.rows_per_log_reynolds)
    rows, stations = stack.grid.shape[1], blading.r_m.shape[1]
    steps = np.arange(rows) / stack.rows_per_log_reynolds if rows > 1 else np.zeros(1)
    log_re = stack.log_reynolds_min + steps
    kinematic = air.viscosity_Pa_s / air.density_kg_m3
    out = np.zeros((stations, rows, ALPHA_GRID.size + 2, 2))
    fine = np.linspace(-math.pi, math.pi, 2 * _ANGLE_CELLS_PER_HALF_CIRCLE + 1)
    for i in range(stations):
        first, second = int(blading.first_polar[which, i]), int(blading.second_polar[which, i])
        weight = float(blading.second_weight[which, i])
        mixed = [
            (1.0 - weight) * v[first] + weight * v[second]
            for v in (blading.polar_zero_lift_rad, blading.polar_thickness_ratio)
        ]
        section = SectionParameters(
            first, second, weight, float(mixed[0]), float(blading.stall_delay_strength[which, i]),
            float(fixes.lift_factor), float(fixes.drag_factor), float(mixed[1]), float(blading.edge_drag[which, i]),
        )  # fmt: skip
        e, chord = float(blading.angle_loss_per_cl_rad[which, i]), float(blading.chord_m[which, i])
        mach = np.minimum(np.exp(log_re) * kinematic / (chord * air.sound_m_s), _MAX_MACH)
        alpha = np.tile(ALPHA_GRID, (rows, 1))
        if e > 0.0:
            angles = np.tile(section.polar_zero_lift_rad + fine, (rows, 1))
            known = np.empty((*angles.shape, 2))
            _fill_coefficients(angles, log_re, mach, section, polars, known)
            reached = angles + e * known[..., 0]
            turned = (ALPHA_GRID - section.polar_zero_lift_rad + math.pi) % (2.0 * math.pi) - math.pi
            onset = section.polar_zero_lift_rad + turned
            for j in range(rows):
                alpha[j] = _angles_from_onset_angles(onset, section.polar_zero_lift_rad, angles[j], reached[j])
        _fill_coefficients(alpha, log_re, mach, section, polars, out[i, :, 1:-1])
    circle = out[:, :, 1:-1]  # its last angle is its first
    out[:, :, 0], out[:, :, -1] = circle[:, :, -2], circle[:, :, 1]
    out.setflags(write=False)
    return out
