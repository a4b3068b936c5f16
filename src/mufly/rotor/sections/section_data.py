"""Coefficients of an airfoil, computed or measured, before their extension to all angles of attack; their cache.

The cache key covers the contour, the engine with its version and settings, and the Reynolds numbers. Entries are
therefore never out of date, and deleting the folder (:func:`mufly.files.answer_store.cache_folder`) is safe. If the
folder cannot be written or an entry cannot be read, the engine computes again without a message.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.files.answer_store import cache_folder, read_stored_result, write_stored_result

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EnginePolars:
    """Lift, drag and moment coefficients of a section at known angles and Reynolds numbers.

    Attributes
    ----------
    name : str
        Name of the airfoil.
    alpha_rad : (na,) array
        Angles of attack, increasing.
    reynolds : (nr,) array
        Chord Reynolds numbers, in geometric progression.
    cl, cd, cm : (nr, na) array
        Coefficients; ``cm`` about the quarter chord. They are undefined if ``known`` is false.
    known : (nr, na) array of bool
        True for computed points, at least two angles in each row.
    valid : (nr, na) array of bool
        True for reliable points, one interval in each row, which becomes the table's ``alpha_valid_rad``.
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


def store_cached_polars(key: str, data: EnginePolars) -> None:
    """Store section coefficients ``data`` on disk under the hash ``key``."""
    folder = cache_folder("polars")
    if folder is not None:
        with suppress(InputError):
            write_stored_result(folder / f"{key}.npz", key, {k: v for k, v in vars(data).items() if k != "name"})


def load_cached_polars(key: str, name: str) -> EnginePolars | None:
    """Return the section coefficients stored on disk under the hash ``key``, with the present name of the airfoil;
    None if absent.
    """
    folder = cache_folder("polars")
    found = None if folder is None else read_stored_result(folder / f"{key}.npz", key)
    if found is None:
        return None
    return EnginePolars(name, **{k: v if v.ndim else v.item() for k, v in found.items()})
