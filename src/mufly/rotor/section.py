"""What an engine or a measurement says about a section, before it is extended to the full circle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["SectionData"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SectionData:
    """Coefficients where they are known.

    Attributes
    ----------
    name : str
        Airfoil.
    alpha_rad : (na,) array
        Angles of attack, rising.
    reynolds : (nr,) array
        Chord Reynolds numbers, in geometric progression.
    cl, cd, cm : (nr, na) array
        Coefficients; ``cm`` about the quarter chord. Where ``known`` is false they have no meaning.
    known : (nr, na) array of bool
        Where the engine answered; two angles at least in each row.
    valid : (nr, na) array of bool
        Where its answer is to be trusted; in each row one stretch, which becomes the table's ``alpha_valid_rad``.
    source, n_crit, thickness_ratio, camber
        As in :class:`mufly.rotor.polar.PolarTable`.
    """

    name: str
    alpha_rad: Array
    reynolds: Array
    cl: Array
    cd: Array
    cm: Array
    known: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    source: str
    n_crit: float = math.nan
    thickness_ratio: float = math.nan
    camber: float = math.nan
