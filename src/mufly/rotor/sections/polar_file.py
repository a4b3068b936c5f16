"""Reader of polar files: users' tables, XFOIL's and XFLR5's polars, Airfoil Tools' CSV, AeroDyn's airfoil tables.

A table has the columns of :data:`_COLUMN_ALIASES`, in any order and notation that :mod:`mufly.files.text_table` reads;
``#`` begins a comment. XFOIL and XFLR5 write a preface with ``Re = 0.100 e 6``, Airfoil Tools one with
``Reynolds number,50000``, AeroDyn lines such as ``0.75 Re ! Reynolds number in millions``: they hold for the rows
below. AeroDyn's files up to version 13 have no header: their rows are angle (degrees), lift, drag and moment, up to
``EOT``. A file without any Reynolds number holds for all.

A doubtful unit is an error: angles without a unit that could be radians, angles in degrees with a lift slope above ten
times 2 pi per radian, and Reynolds numbers below :data:`_MIN_REYNOLDS`.

Each Reynolds number has a block with its own angles. The blocks are interpolated to a geometric progression of equally
many Reynolds numbers (linear in log Re) and to the angles of the densest block, which is exact for a regular file.
Outside its angles a block is extended like the result of an engine.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.files.text_table import decode_text, detect_separator_and_decimal_mark, normalise_number, split_cells
from mufly.quantities.units import normalise_unit
from mufly.rotor.sections.section_data import EnginePolars

Array = NDArray[np.float64]

_COLUMN_ALIASES = {
    "alpha_deg": "alpha alfa aoa angle angle_of_attack \u03b1",
    "cl": "cl c_l",
    "cd": "cd c_d",
    "cm": "cm c_m",
    "reynolds": "reynolds re reynolds_number rn",
}
_IGNORED_COLUMNS = frozenset(["cdp", "top_xtr", "bot_xtr", "cpmin", "chinge", "xcp", "top_itr", "bot_itr", "cpmn"])
_REQUIRED_COLUMNS = ("alpha_deg", "cl", "cd")
_REYNOLDS_UNIT_FACTORS = {
    "": 1.0, "-": 1.0, "millions": 1e6, "million": 1e6, "1e6": 1e6, "10^6": 1e6, "x1e6": 1e6, "x10^6": 1e6, "*1e6": 1e6,
    "thousands": 1e3, "1e3": 1e3, "10^3": 1e3, "x1e3": 1e3, "x10^3": 1e3, "*1e3": 1e3, "k": 1e3,
}  # fmt: skip
_REYNOLDS_PATTERNS: tuple[tuple[re.Pattern[str], Callable[[re.Match[str]], float]], ...] = (
    (re.compile(r"\bRe\s*=\s*([\d.]+)\s*e\s*(\d+)"), lambda m: float(m[1]) * 10.0 ** int(m[2])),
    (re.compile(r"^\s*Reynolds number\s*[,;=:]\s*([\d.]+(?:e\d+)?)", re.IGNORECASE), lambda m: float(m[1])),
    (
        re.compile(r"^\s*([\d.]+)\s+Re(?:ynolds\s+num\w*)?\s.*millions", re.IGNORECASE),
        lambda m: 1e6 * float(m[1]),
    ),
)
_MIN_REYNOLDS = 100.0
_MIN_PLAUSIBLE_MAX_ANGLE_DEG = 1.6  # angles all below this value may be radians
_MAX_LIFT_SLOPE_PER_DEG = 10.0 * 2.0 * math.pi * math.pi / 180.0
_AERODYN_ROW_PATTERN = re.compile(r"\s*(?:[-+]?[\d.]+(?:[eE][-+]?\d+)?\s+){2,3}[-+]?[\d.]+(?:[eE][-+]?\d+)?\s*")
_TWO_WORD_COLUMN_PATTERN = re.compile(r"\b(top|bot) (xtr|itr)\b", re.IGNORECASE)
_MAX_HEADER_LINES = 60  # the header stands within this number of lines


def is_polar_file(name: str) -> bool:
    """Return True if an airfoil's name is a polar file: a ``.csv``, or another file that contains a polar."""
    if name.lower().endswith(".csv"):
        return True
    path = Path(name)
    try:
        lines = decode_text(path.read_bytes()[:20_000]).splitlines() if path.is_file() else []
    except OSError:
        return False
    return _find_header_line(lines) is not None or _is_aerodyn_13_or_older(lines)


def _is_aerodyn_13_or_older(lines: Sequence[str]) -> bool:
    """Return True for a file of AeroDyn up to version 13."""
    first = [line.lower() for line in lines[:_MAX_HEADER_LINES]]
    return any("number of airfoil tables" in s for s in first) and any("in millions" in s for s in first)


def read_polar_file(path: str | Path) -> EnginePolars:
    """Read a table of section coefficients; the module docstring lists formats and errors.

    Raises
    ------
    InputError
        If a column is missing or unknown, a cell is no number, an angle appears twice, drag is not
        positive, the unit of a column is in doubt or a block has fewer than three angles.
    """
    where = str(path)
    blocks = _group_by_reynolds(_read_rows(Path(path), where), where)
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
        tables = np.stack([_interpolate_log_reynolds(t, np.log(numbers), np.log(reynolds)) for t in tables])
    known = np.all(np.isfinite(tables), axis=0)
    cl, cd, cm = np.nan_to_num(tables)
    if single:  # one polar for every Reynolds number
        reynolds = np.array([1.0, 1e9])
        cl, cd, cm, known = (np.repeat(v, 2, axis=0) for v in (cl, cd, cm, known))
    return EnginePolars(Path(path).stem, np.deg2rad(alpha), reynolds, cl, cd, cm, known, known.copy(), f"table {where}")


def _interpolate_log_reynolds(table: Array, own: Array, wanted: Array) -> Array:
    if own.size == 1:
        return table
    j = np.clip(np.searchsorted(own, wanted, side="right") - 1, 0, own.size - 2)
    s = np.clip((wanted - own[j]) / (own[j + 1] - own[j]), 0, 1)[:, None]
    s = np.where(np.abs(s - np.round(s)) < 1e-9, np.round(s), s)
    # A weight of exactly zero must not include a neighbour's missing angles.
    low = np.where(s < 1, table[j] * (1 - s), 0.0)
    return low + np.where(s > 0, table[j + 1] * s, 0.0)


def _identify_column(header: str) -> tuple[str, str]:
    """Return the quantity that a column's header names, an unknown one in lower case, and its unit in lower case."""
    low = " ".join(header.strip().strip('"').lower().split())
    match = re.fullmatch(r"(.*?)\s*[(\[]([^)\]]*)[)\]]", low)
    stem, unit = (match[1], match[2].strip()) if match else (low, "")
    stem = stem.replace(" ", "_")
    names = {word: column for column, words in _COLUMN_ALIASES.items() for word in words.split()}
    if not match and stem not in names:
        first, _, last = stem.rpartition("_")
        if first in names and (last in _REYNOLDS_UNIT_FACTORS or normalise_unit(last, "rad")):
            stem, unit = first, last
    return names.get(stem, stem), unit


def _find_header_line(lines: Sequence[str]) -> int | None:
    """Return the index of the first line that names angle, lift and drag; None if there is none."""
    for k, line in enumerate(lines[:_MAX_HEADER_LINES]):
        words = line.lstrip("! \t")
        if "c" in words.lower() and any(
            {_identify_column(c)[0] for c in split_cells(words, s)} >= set(_REQUIRED_COLUMNS)
            for s in ("\t", ";", ",", " ")
        ):
            return k
    return None


def _read_rows(path: Path, where: str) -> list[tuple[int, dict[str, float]]]:
    """Read the table's rows, each as line number and values by column; angles are in degrees.

    ``reynolds`` is infinite if not stated.
    """
    try:
        lines = decode_text(path.read_bytes()).splitlines()
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give a text file") from error
    written = [(n, s) for n, s in enumerate(lines, 1) if s.strip() and not s.lstrip().startswith("#")]
    if not written:
        raise InputError(where, "", "is empty", "give a header and at least one line")
    if _find_header_line([s for _, s in written]) is None and _is_aerodyn_13_or_older([s for _, s in written]):
        table = [
            (n, s) for n, s in written if _find_stated_reynolds(s, math.nan) > 0 or _AERODYN_ROW_PATTERN.fullmatch(s)
        ]
        written = [(0, "alpha_deg cl cd cm"[: 18 if len(table[-1][1].split()) > 3 else 15]), *table]
    start = _find_header_line([s for _, s in written]) or 0
    lined = [
        (n, _TWO_WORD_COLUMN_PATTERN.sub(r"\1_\2", s.lstrip("! \t")) if k == start else s)
        for k, (n, s) in enumerate(written)
    ]
    separator, decimal = detect_separator_and_decimal_mark(
        [s for _, s in lined[start:] if not s.lstrip().startswith(("!", "-"))]
    )
    header = split_cells(lined[start][1], separator)
    columns = _identify_columns(header, where)
    reynolds = math.inf
    for _, line in lined[:start]:
        reynolds = _find_stated_reynolds(line, reynolds)
    rows: list[tuple[int, dict[str, float]]] = []
    for number, line in lined[start + 1 :]:
        stated = _find_stated_reynolds(line, math.nan)
        if math.isfinite(stated):
            reynolds = stated
        # AeroDyn has remarks and counts between its tables, XFOIL a rule and units below the header.
        data, remark, _ = ("", "", "") if math.isfinite(stated) else line.partition("!")
        if set(data.strip()) <= set("-= \t") or data.lstrip().startswith(("(", "[")):
            continue
        cells = [normalise_number(c, decimal) for c in split_cells(data, separator)]
        if remark and len(cells) != len(header):
            continue
        if len(cells) != len(header):
            raise InputError(where, f"line {number}", f"{len(cells)} cells", f"give {len(header)}")
        values = {"reynolds": reynolds}
        for (name, factor), cell in zip(columns, cells, strict=True):
            if not name:
                continue
            try:
                values[name] = float(cell) * factor
            except ValueError:
                values[name] = math.nan
            if not math.isfinite(values[name]):
                raise InputError(where, f"line {number}", f"{name} {cell!r} is not a number", "give finite numbers")
        rows.append((number, values))
    _check_units(rows, dict(zip((n for n, _ in columns), header, strict=True)), where)
    return rows


def _find_stated_reynolds(line: str, otherwise: float) -> float:
    """Return the Reynolds number stated in a line outside the table, or ``otherwise`` if it states none."""
    for pattern, value in _REYNOLDS_PATTERNS:
        match = pattern.search(line)
        if match is not None:
            return value(match)
    return otherwise


def _identify_columns(header: Sequence[str], where: str) -> list[tuple[str, float]]:
    """Return each column's quantity, empty for an ignored column, and the factor that converts its unit.

    Angles are converted to degrees, Reynolds numbers from millions or thousands to 1.
    """
    found = []
    for written in header:
        name, unit = _identify_column(written)
        factor = 1.0
        if name == "alpha_deg" and unit:
            known = normalise_unit(unit, "rad")
            if known not in ("deg", "rad"):
                raise InputError(where, written, f"has the unit {unit!r}", "give degrees or radians")
            factor = 1.0 if known == "deg" else 180.0 / math.pi
        elif name == "reynolds":
            if unit.replace(" ", "") not in _REYNOLDS_UNIT_FACTORS:
                raise InputError(where, written, f"has the unit {unit!r}", "write Re, or Re (millions)")
            factor = _REYNOLDS_UNIT_FACTORS[unit.replace(" ", "")]
        elif name not in _COLUMN_ALIASES:
            if name not in _IGNORED_COLUMNS:
                raise InputError(where, written, "unknown column", f"known columns: {', '.join(_COLUMN_ALIASES)}")
            name = ""
        found.append((name, factor))
    names = [name for name, _ in found]
    for name in _REQUIRED_COLUMNS:
        if name not in names:
            raise InputError(where, name, "the column is missing", f"give the columns {', '.join(_REQUIRED_COLUMNS)}")
    for k, name in enumerate(names):
        if name and name in names[:k]:
            raise InputError(where, header[k], f"is a second column of {name}", "give one column of each quantity")
    return found


def _check_units(rows: list[tuple[int, dict[str, float]]], headers: dict[str, str], where: str) -> None:
    """Raise an error for angles that may be radians and Reynolds numbers that may be in millions."""
    if not rows:
        return
    alpha, cl = (np.array([v[k] for _, v in rows]) for k in ("alpha_deg", "cl"))
    header, widest = headers["alpha_deg"], float(np.max(np.abs(alpha)))
    if not _identify_column(header)[1] and 0.0 < widest <= _MIN_PLAUSIBLE_MAX_ANGLE_DEG:
        raise InputError(
            where, header, f"goes up to {widest:g} without a unit: degrees or radians?",
            "name the column alpha_deg or alpha_rad",
        )  # fmt: skip
    near = np.abs(alpha) <= max(0.5 * widest, 1e-9)
    rise = float(np.ptp(cl[near])) / max(float(np.ptp(alpha[near])), 1e-9) if near.sum() > 2 else 0.0
    if rise > _MAX_LIFT_SLOPE_PER_DEG:
        raise InputError(
            where, header,
            f"the lift coefficient would rise by {rise:.3g} per degree", "name the column alpha_rad if that is its unit"
        )  # fmt: skip
    numbers = np.array([v["reynolds"] for _, v in rows])
    if np.any(numbers > 0) and float(np.max(numbers)) < _MIN_REYNOLDS:
        least, most = float(np.min(numbers)), float(np.max(numbers))
        raise InputError(
            where, headers.get("reynolds", "reynolds"), f"{least:g} to {most:g} is not a Reynolds number of a blade",
            "name the column 'Re (millions)' if it counts those, or write 10000 for 0.01",
        )  # fmt: skip


def _group_by_reynolds(rows: list[tuple[int, dict[str, float]]], where: str) -> dict[float, Array]:
    """Group rows into arrays (n, 4) of alpha_deg, cl, cd, cm with increasing angles, by Reynolds number (or
    infinity)."""
    blocks: dict[float, list[list[float]]] = {}
    for number, values in rows:
        re_, cd, alpha = values["reynolds"], values["cd"], values["alpha_deg"]
        if not re_ > 0:
            raise InputError(where, f"line {number}", f"reynolds {re_:g} is out of range", "give values above 0")
        if not cd > 0:
            raise InputError(where, f"line {number}", f"cd {cd:g} is out of range", "give values above 0")
        if not -180.0 - 1e-9 <= alpha <= 180.0 + 1e-9:
            raise InputError(where, f"line {number}", f"alpha_deg {alpha:g}", "give -180 to 180")
        point = [min(max(alpha, -180.0), 180.0), values["cl"], cd, values.get("cm", 0.0)]
        blocks.setdefault(re_, []).append(point)
    result = {}
    for number_, points in blocks.items():
        block = np.array(sorted(points))
        label = "" if math.isinf(number_) else f" at reynolds {number_:g}"
        if len(block) < 3:
            raise InputError(where, "alpha_deg", f"{len(block)} angles{label} are too few", "give three at least")
        if np.any(np.diff(block[:, 0]) < 1e-9):
            raise InputError(where, "alpha_deg", f"an angle appears twice{label}", "give each angle once")
        result[number_] = block
    if not result:
        raise InputError(where, "", "has no rows", "give angles and coefficients")
    return result
