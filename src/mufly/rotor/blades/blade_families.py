"""Prior probabilities of the sections of small blades, by families of blades.

The sections of hobby propellers are seldom published. Each family has a prior probability and independent normal
distributions of camber and thickness (% of the chord). They give each four-digit section of the grid
:data:`CAMBER_GRID_PERCENT` by :data:`THICKNESS_GRID_PERCENT` the probability

    p(m, t) = sum_f p_f exp(-((m - m_f) / s_f)^2 / 2 - ((t - t_f) / u_f)^2 / 2) / norm_f

Thin sections are plates with maximum camber at half the chord; thicker sections have it further forward. If a rotor
file names an airfoil as a guess, that section keeps the probability :data:`STATED_SECTION_PROBABILITY`. If it states
the thickness along the blade, only the camber is a guess.

The deviation of the angle at 0.75 R adds to that of the geometry's source (:mod:`mufly.rotor.effective_pitch`): an edge
that is off by h turns a chord c by h / c. Moulded edges are off by 0.1 to 0.2 mm on chords of 10 mm, bent shells by 0.3
mm, machined and printed blades by 0.05 mm.

The numbers are not fitted. They follow the makers' statements (APC: NACA 4412, Clark Y, for slow-flyers E63) and the
look of such blades, and were chosen with the 17 propellers of the benchmark known. docs/explanation/bemt.md lists them;
docs/log/2026-11-28-bemt-accuracy.md has their effect on rotors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mufly.errors import InputError
from mufly.rotor.geometry import BladeFamily, Rotor

CAMBER_GRID_PERCENT, THICKNESS_GRID_PERCENT = (0, 2, 4, 6, 8), (3, 6, 9, 12)  # % of the chord
STATED_SECTION_PROBABILITY = 0.5
"""Probability of the section that a rotor file guesses."""
ZERO_LIFT_RAD_PER_CAMBER_RATIO = 2.0  # rad per chord: thin-airfoil theory, parabolic camber line
DRAG_FACTOR_PER_THICKNESS_RATIO = 2.0  # skin friction of a section of thickness t: 1 + 2 t (Hoerner, 1965, ch. II)


class BladeFamilyPrior(NamedTuple):
    """Prior of a blade family: probability, camber and thickness (% of the chord), angle (degrees), rationale."""

    probability: float
    camber_mean_std_percent: tuple[float, float]
    thickness_mean_std_percent: tuple[float, float]
    pitch_std_deg: float
    rationale: str


BLADE_FAMILY_PRIORS: dict[BladeFamily, BladeFamilyPrior] = {
    "apc": BladeFamilyPrior(
        0.20, (4.0, 1.0), (11.0, 2.0), 0.5, "APC's sport and electric blades: NACA 4412 and Clark Y, as APC says"
    ),
    "slow-flyer": BladeFamilyPrior(
        0.15, (5.0, 1.5), (5.0, 2.0), 1.0, "wide, thin blades at low speed: E63 and similar sections"
    ),
    "gws": BladeFamilyPrior(0.15, (4.0, 2.0), (6.0, 2.5), 1.0, "GWS's moulded blades: a cambered plate, flat below"),
    "hobby": BladeFamilyPrior(0.25, (4.5, 2.5), (5.0, 2.5), 1.5, "other moulded blades, and thin shells of toys"),
    "printed": BladeFamilyPrior(
        0.10, (3.5, 2.0), (8.0, 3.0), 0.3, "printed blades: a named section with the steps of print layers"
    ),
    "machined": BladeFamilyPrior(
        0.15, (3.0, 2.0), (9.0, 3.0), 0.3, "machined blades, or laminates from moulds: a named section"
    ),
}


def find_family_priors(rotor: Rotor, family: str = "") -> list[BladeFamilyPrior]:
    """Return the priors of a family, by default that of the rotor file; those of all families if none is stated.

    Raises
    ------
    InputError
        If there is no such family.
    """
    name = family or rotor.blade.family
    if name and name not in BLADE_FAMILY_PRIORS:
        raise InputError("section", "family", f"{name!r} is unknown", f"use one of: {', '.join(BLADE_FAMILY_PRIORS)}")
    return [one for key, one in BLADE_FAMILY_PRIORS.items() if not name or key == name]


def list_section_probabilities(rotor: Rotor, family: str = "") -> list[tuple[tuple[str, ...], float]]:
    """Return the possible sections of a blade with their probabilities; the section in the rotor file comes first.

    Parameters
    ----------
    rotor : Rotor
    family : str
        One of :data:`BLADE_FAMILY_PRIORS`; empty: that of the rotor file, else all families by their probabilities.

    Raises
    ------
    InputError
        If there is no such family.
    """
    chosen = find_family_priors(rotor, family)
    camber, thickness = np.meshgrid(CAMBER_GRID_PERCENT, THICKNESS_GRID_PERCENT, indexing="ij")
    total = np.zeros(camber.shape)
    for one in chosen:
        part = np.exp(
            -0.5 * ((camber - one.camber_mean_std_percent[0]) / one.camber_mean_std_percent[1]) ** 2
            - 0.5 * ((thickness - one.thickness_mean_std_percent[0]) / one.thickness_mean_std_percent[1]) ** 2
        )
        total += one.probability * part / part.sum()
    total *= (1.0 - STATED_SECTION_PROBABILITY) / total.sum()
    listed: dict[tuple[str, ...], float] = {
        (_naca_name(m, t),): float(total[i, j])
        for i, m in enumerate(CAMBER_GRID_PERCENT)
        for j, t in enumerate(THICKNESS_GRID_PERCENT)
    }
    if rotor.blade.thickness is not None:  # the thickness is known: one section for each camber
        t = 100.0 * float(rotor.stated_thickness(0.75))
        near = THICKNESS_GRID_PERCENT[int(np.argmin(np.abs(np.array(THICKNESS_GRID_PERCENT) - t)))]
        listed = {(_naca_name(m, near),): float(total[i].sum()) for i, m in enumerate(CAMBER_GRID_PERCENT)}
    own = rotor.blade.airfoils
    return list({own: listed.pop(own, 0.0) + STATED_SECTION_PROBABILITY, **listed}.items())


def _naca_name(camber: int, thickness: int) -> str:
    return f"naca{camber}{(5 if thickness < 5 else 4) if camber else 0}{thickness:02d}"


GRID_ROUNDING_STD_RATIOS = (
    0.01 * (CAMBER_GRID_PERCENT[1] - CAMBER_GRID_PERCENT[0]) / math.sqrt(12.0),
    0.01 * (THICKNESS_GRID_PERCENT[1] - THICKNESS_GRID_PERCENT[0]) / math.sqrt(12.0),
)
"""Standard deviation of camber and thickness (of the chord) within one step of the grid."""
