"""What an engine or a measurement says about a section, before it is extended to the full circle.

What an engine computed, kept on disk under a hash of everything it depends on.

The key covers the contour, the engine with its version and settings, and the Reynolds numbers; so an entry is never out
of date, and deleting the folder is always safe. The folder is the platform's cache folder for mufly, or the one that
the environment variable ``MUFLY_CACHE`` names; ``MUFLY_CACHE=off`` keeps nothing. A folder that cannot be written or an
entry that cannot be read is passed over in silence: the engine just computes again.
"""

from __future__ import annotations

import hashlib
import math
import os
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

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


_FORMAT = "1"
_ARRAYS = ("alpha_rad", "reynolds", "cl", "cd", "cm", "known", "valid")
_NUMBERS = ("n_crit", "thickness_ratio", "camber")


def cache_folder() -> Path | None:
    """Return the folder of cached polars, or None if caching is off."""
    chosen = os.environ.get("MUFLY_CACHE", "")
    if chosen.lower() == "off":
        return None
    return (Path(chosen) if chosen else user_cache_path("mufly")) / "polars"


def key_of(*parts: object) -> str:
    """Return the hash under which something that depends on ``parts`` is kept; arrays go in bit by bit."""
    digest = hashlib.sha256(_FORMAT.encode())
    for part in parts:
        digest.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
        digest.update(b"|")
    return digest.hexdigest()


def store(key: str, data: SectionData) -> None:
    """Keep ``data`` under ``key``. The entry appears whole or not at all."""
    folder = cache_folder()
    if folder is None:
        return
    content = {name: getattr(data, name) for name in (*_ARRAYS, *_NUMBERS)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, suffix=".part", delete=False) as file:
            np.savez(file, source=np.array(data.source), **content)
        os.replace(file.name, folder / f"{key}.npz")
    except OSError:
        return


def recall(key: str, name: str) -> SectionData | None:
    """Return what is kept under ``key``, under the airfoil's name of today, or None."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        with np.load(folder / f"{key}.npz", allow_pickle=False) as file:
            alpha, reynolds, cl, cd, cm, known, valid = (file[field] for field in _ARRAYS)
            n_crit, thickness, camber = (float(file[field]) for field in _NUMBERS)
            source = str(file["source"])
    except (OSError, KeyError, ValueError, zipfile.BadZipFile, EOFError):
        return None
    return SectionData(
        name, alpha, reynolds, cl, cd, cm, known, valid, source, n_crit, thickness, camber
    )  # fmt: skip
