"""What an engine or a measurement says about a section, before it is extended to the full circle.

What an engine computed, kept on disk under a hash of everything it depends on.

The key covers the contour, the engine with its version and settings, and the Reynolds numbers; so an entry is never out
of date, and deleting the folder (:func:`mufly.answer_store.cache_folder`) is always safe. A folder that cannot be
written or an entry that cannot be read is passed over in silence: the engine just computes again.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.answer_store import cache_folder, read_answer, write_answer
from mufly.errors import InputError

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
        As in :class:`mufly.rotor.sections.polar_table.PolarTable`.
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


def cache_put(key: str, data: SectionData) -> None:
    """Keep ``data`` under ``key``."""
    folder = cache_folder("polars")
    if folder is not None:
        with suppress(InputError):
            write_answer(folder / f"{key}.npz", key, {k: v for k, v in vars(data).items() if k != "name"})


def cache_get(key: str, name: str) -> SectionData | None:
    """Return what is kept under ``key``, under the airfoil's name of today, or None."""
    folder = cache_folder("polars")
    found = None if folder is None else read_answer(folder / f"{key}.npz", key)
    if found is None:
        return None
    return SectionData(name, **{k: v if v.ndim else v.item() for k, v in found.items()})
