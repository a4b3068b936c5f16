"""What an engine or a measurement says about a section, before it is extended to the full circle.

Polars from the user's own table: a CSV file with the columns alpha_deg, cl, cd, and if known cm and reynolds.

Lines that begin with # are comments. Several Reynolds numbers make several blocks, each with its own angles; they
are brought to a geometric progression of as many numbers (linear in log Re) and to the angles of the densest block,
which is exact where the file is regular. Outside its angles a block is extended like an engine's answer.

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

from mufly.errors import InputError
from mufly.tables import text_columns

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


_NEEDED = ("alpha_deg", "cl", "cd")
_KNOWN = (*_NEEDED, "cm", "reynolds")


def read_polar_csv(path: str | Path) -> SectionData:
    """Read a table of section coefficients.

    Raises
    ------
    InputError
        If a column is missing, a cell is no number, an angle appears twice, drag is not positive or a block has fewer
        than three angles.
    """
    where = str(path)
    blocks = _blocks(_rows(Path(path), where), where)
    numbers = np.array(sorted(blocks))
    single = not math.isfinite(numbers[0])
    reynolds = np.array([1e5]) if single else np.geomspace(numbers[0], numbers[-1], numbers.size)
    alpha = max(blocks.values(), key=len)[:, 0]
    tables = np.full((3, numbers.size, alpha.size), np.nan)
    for j, number in enumerate(numbers):
        block = blocks[float(number)]
        inside = (alpha >= block[0, 0] - 1e-9) & (alpha <= block[-1, 0] + 1e-9)
        for c in range(3):
            tables[c, j, inside] = np.interp(alpha[inside], block[:, 0], block[:, c + 1])
    if not single:
        tables = np.stack([_at_log_reynolds(t, np.log(numbers), np.log(reynolds)) for t in tables])
    known = np.all(np.isfinite(tables), axis=0)
    cl, cd, cm = np.nan_to_num(tables)
    if single:  # one polar for every Reynolds number
        reynolds = np.array([1.0, 1e9])
        cl, cd, cm, known = (np.repeat(v, 2, axis=0) for v in (cl, cd, cm, known))
    return SectionData(
        Path(path).stem, np.deg2rad(alpha), reynolds, cl, cd, cm, known, known.copy(), f"table {where}"
    )


def _at_log_reynolds(table: Array, own: Array, wanted: Array) -> Array:
    if own.size == 1:
        return table
    j = np.clip(np.searchsorted(own, wanted, side="right") - 1, 0, own.size - 2)
    s = np.clip((wanted - own[j]) / (own[j + 1] - own[j]), 0, 1)[:, None]
    s = np.where(np.abs(s - np.round(s)) < 1e-9, np.round(s), s)
    # A weight of exactly zero must not bring in a neighbour's missing angles.
    low = np.where(s < 1, table[j] * (1 - s), 0.0)
    return low + np.where(s > 0, table[j + 1] * s, 0.0)


def _rows(path: Path, where: str) -> list[tuple[int, dict[str, str]]]:
    written, rows = text_columns(path)
    header = [name.lower() for name in written]
    for name in _NEEDED:
        if name not in header:
            raise InputError(where, name, "the column is missing", f"give the columns {', '.join(_NEEDED)}")
    for name in header:
        if name not in _KNOWN:
            raise InputError(where, name, "unknown column", f"known columns: {', '.join(_KNOWN)}")
    for number, cells in rows:
        if len(cells) != len(header):
            raise InputError(where, f"line {number}", f"{len(cells)} cells", f"give {len(header)}")
    return [(n, dict(zip(header, cells, strict=True))) for n, cells in rows]


def _blocks(rows: list[tuple[int, dict[str, str]]], where: str) -> dict[float, Array]:
    """Arrays (n, 4) of alpha_deg, cl, cd, cm with rising angles, by Reynolds number (infinity if there is none)."""
    blocks: dict[float, list[list[float]]] = {}
    for number, cells in rows:
        values = {}
        for name, cell in cells.items():
            try:
                values[name] = float(cell)
            except ValueError:
                values[name] = math.nan
            if not math.isfinite(values[name]):
                raise InputError(
                    where, f"line {number}", f"{name} {cell!r} is no number", "give finite numbers"
                )
        re = values.get("reynolds", math.inf)
        if not re > 0:
            raise InputError(
                where, f"line {number}", f"reynolds {re:g} is not possible", "give values above 0"
            )
        if not values["cd"] > 0:
            raise InputError(
                where, f"line {number}", f"cd {values['cd']:g} is not possible", "give values above 0"
            )
        if not -180 <= values["alpha_deg"] <= 180:
            raise InputError(
                where, f"line {number}", f"alpha_deg {values['alpha_deg']:g}", "give -180 to 180"
            )
        blocks.setdefault(re, []).append([values[k] for k in _NEEDED] + [values.get("cm", 0.0)])
    result = {}
    for re, points in blocks.items():
        block = np.array(sorted(points))
        label = "" if math.isinf(re) else f" at reynolds {re:g}"
        if len(block) < 3:
            raise InputError(
                where, "alpha_deg", f"{len(block)} angles{label} are too few", "give three at least"
            )
        if np.any(np.diff(block[:, 0]) < 1e-9):
            raise InputError(where, "alpha_deg", f"an angle appears twice{label}", "give each angle once")
        result[re] = block
    if not result:
        raise InputError(where, "", "has no rows", "give angles and coefficients")
    return result


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
