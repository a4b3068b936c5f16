"""Which section may a small blade have? Families of blades with probabilities, before any bench has spoken.

The sections of hobby propellers are seldom told. What can be said beforehand is said here: how likely each family of
blades is, and how camber and thickness (of the chord) are spread in it, as independent normal distributions. On the
grid of four-digit sections :data:`CAMBER` by :data:`THICKNESS` that gives each section its probability,

    p(m, t) = sum_f p_f exp(-((m - m_f) / s_f)^2 / 2 - ((t - t_f) / u_f)^2 / 2) / norm_f

Thin ones are plates bent in the middle (camber at half the chord), thicker ones are bent before it. Whoever names an
airfoil in a rotor file and calls it a guess has looked at the blade: that section keeps :data:`OWN` of the probability.

None of these numbers was fitted. They are what the makers say (APC: NACA 4412, Clark Y, for slow-flyers E63) and what
such blades look like, written down with the 17 propellers of the benchmark known; docs/bemt.md lists them, and what
they are worth on rotors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mufly.errors import InputError
from mufly.rotor.geometry import Rotor

CAMBER, THICKNESS = (0, 2, 4, 6, 8), (3, 6, 9, 12)  # % of the chord
OWN = 0.5
"""Probability of the section that a rotor file guesses."""
ZERO_LIFT_PER_CAMBER = 2.0  # rad per chord: thin-airfoil theory, parabolic camber line
DRAG_PER_THICKNESS = 2.0  # skin friction of a section of thickness t: 1 + 2 t (Hoerner, 1965, ch. II)


class Family(NamedTuple):
    """Probability among small blades; mean and deviation of camber and thickness, % of the chord; why."""

    share: float
    camber: tuple[float, float]
    thickness: tuple[float, float]
    why: str


FAMILIES: dict[str, Family] = {
    "apc": Family(
        0.20, (4.0, 1.0), (11.0, 2.0), "APC's sport and electric blades: NACA 4412 and Clark Y, as APC says"
    ),
    "slow-flyer": Family(0.15, (5.0, 1.5), (5.0, 2.0), "wide, thin blades at low speed: E63 and its like"),
    "gws": Family(0.15, (4.0, 2.0), (6.0, 2.5), "GWS's moulded blades: a cambered plate, flat below"),
    "hobby": Family(0.25, (4.5, 2.5), (5.0, 2.5), "other moulded blades and thin shells of toys"),
    "printed": Family(0.10, (3.5, 2.0), (8.0, 3.0), "printed ones: a section by name, layers on it"),
    "machined": Family(0.15, (3.0, 2.0), (9.0, 3.0), "machined or laid up in moulds: a section by name"),
}


def section_weights(rotor: Rotor, family: str = "") -> list[tuple[tuple[str, ...], float]]:
    """Sections that a blade may have, with their probabilities; the rotor file's own first.

    Parameters
    ----------
    rotor : Rotor
    family : str
        One of :data:`FAMILIES`; nothing: all of them by their probabilities.

    Raises
    ------
    InputError
        If there is no such family.
    """
    if family and family not in FAMILIES:
        raise InputError("section", "family", f"{family!r} is unknown", f"use one of: {', '.join(FAMILIES)}")
    chosen = [FAMILIES[family]] if family else list(FAMILIES.values())
    camber, thickness = np.meshgrid(CAMBER, THICKNESS, indexing="ij")
    total = np.zeros(camber.shape)
    for one in chosen:
        part = np.exp(
            -0.5 * ((camber - one.camber[0]) / one.camber[1]) ** 2
            - 0.5 * ((thickness - one.thickness[0]) / one.thickness[1]) ** 2
        )
        total += one.share * part / part.sum()
    total *= (1.0 - OWN) / total.sum()
    listed: dict[tuple[str, ...], float] = {
        (_four_digits(m, t),): float(total[i, j])
        for i, m in enumerate(CAMBER)
        for j, t in enumerate(THICKNESS)
    }
    own = rotor.blade.airfoils
    return list({own: listed.pop(own, 0.0) + OWN, **listed}.items())


def _four_digits(camber: int, thickness: int) -> str:
    return f"naca{camber}{(5 if thickness < 5 else 4) if camber else 0}{thickness:02d}"


BETWEEN = (
    0.01 * (CAMBER[1] - CAMBER[0]) / math.sqrt(12.0),
    0.01 * (THICKNESS[1] - THICKNESS[0]) / math.sqrt(12.0),
)
"""Deviation of camber and thickness (of the chord) between neighbours of the grid."""
