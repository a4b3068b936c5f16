"""Reader of APC's performance files (PER3_10x5.dat and the like), propeller tables computed by the manufacturer.

A file has a title with the size in inches, and blocks of ``PROP RPM = 3000`` with columns V, J, Ct, Cp, power, torque
and thrust, with units in the line below the names. The coefficients use the diameter D of the title,

    T = Ct rho n^2 D^4,      P = Cp rho n^3 D^5,      n in revolutions a second,

which gives the manufacturer's density. Thrust is read in newtons if the file has that column. Torque is power over
speed, because the power has more digits. Lines without numbers (``-NaN``) are skipped.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.files.text_table import decode_text
from mufly.quantities.units import RPM, normalise_unit, unit_conversion

Array = NDArray[np.float64]

_SPEED_LINE_PATTERN = re.compile(r"PROP(?:ELLER)?\s+RPM\s*=\s*(\d+\.?\d*)", re.IGNORECASE)
_DIAMETER_IN_NAME_PATTERN = re.compile(r"(\d+(?:\.\d+)?)\s*x\s*\d")
_UNIT_IN_HEADER_PATTERN = re.compile(r"\(([^)]*)\)|(?<=\s)-(?=\s|$)")
_INCH_M = 0.0254
_MIN_DENSITY_FIT_CT = 0.02  # least thrust coefficient of a line used to find the density
_COLUMN_UNITS = {"v": "m/s", "thrust": "N", "torque": "N m", "pwr": "W"}


class ApcPerformance(NamedTuple):
    """Contents of an APC performance file: columns (SI) with names of :mod:`mufly.bench.bench_table`, their lines in
    the file, diameter (m), notes.
    """

    columns: dict[str, Array]
    line_numbers: NDArray[np.int64]
    diameter_m: float
    notes: tuple[str, ...]


def read_apc_performance(path: str | Path) -> ApcPerformance | None:
    """Read an APC performance file; return None for any other file.

    Raises
    ------
    InputError
        If a block has no columns V, J, Ct, Cp, or a line has another number of cells.
    """
    where = Path(path).name
    try:
        text = decode_text(Path(path).read_bytes())
    except OSError:
        return None  # the table reader reports the error
    if not _SPEED_LINE_PATTERN.search(text):
        return None
    lines = text.splitlines()
    size = next((_DIAMETER_IN_NAME_PATTERN.search(line) for line in lines if line.strip()), None)
    speed, names, units = math.nan, [], []  # type: tuple[float, list[str], list[str]]
    rows: list[tuple[int, dict[str, float]]] = []
    lost = 0
    for number, line in enumerate(lines, 1):
        words = line.split()
        block = _SPEED_LINE_PATTERN.search(line)
        if block is not None:
            speed = RPM * float(block[1])
        elif [w.lower() for w in words[:2]] == ["v", "j"]:
            names, units = [w.lower() for w in words], []
        elif names and not units and "(" in line:
            units = [m[1] or "" for m in _UNIT_IN_HEADER_PATTERN.finditer(line)]
        elif names and words and re.fullmatch(r"[-+]?[\d.]+", words[0]):
            if len(words) != len(names):
                raise InputError(
                    where,
                    f"line {number}",
                    f"has {len(words)} cells, but the header has {len(names)}",
                    "complete the line",
                )
            try:
                row = _convert_row(names, units, [float(w.replace("-NaN", "nan")) for w in words], speed)
            except ValueError:
                row = {"speed": math.nan}
            if all(map(math.isfinite, row.values())) and (not rows or row.keys() == rows[0][1].keys()):
                rows.append((number, row))
            else:
                lost += 1
    wanted = ("speed", "advance_ratio", "thrust_coefficient", "power_coefficient")
    if not rows or any(name not in rows[0][1] for name in wanted):
        raise InputError(
            where,
            "",
            "has no lines of V, J, Ct and Cp below a PROP RPM",
            "give an unchanged copy of the manufacturer's file",
        )
    columns = {name: np.array([row[name] for _, row in rows]) for name in rows[0][1]}
    diameter = _INCH_M * float(size[1]) if size else math.nan
    notes = [f"{where} is the manufacturer's computed performance, not a measurement"]
    if lost:
        notes.append(f"{lost} lines without numbers are omitted")
    if "power" in columns:
        columns["torque"] = columns.pop("power") / columns["speed"]
    if "thrust" in columns and math.isfinite(diameter):
        seen = columns["thrust_coefficient"] > _MIN_DENSITY_FIT_CT
        turns = columns["speed"][seen] / (2.0 * math.pi)
        if seen.any():
            unit = columns["thrust_coefficient"][seen] * turns**2 * diameter**4
            density = round(float(np.sum(columns["thrust"][seen] * unit) / np.sum(unit**2)), 3)
            columns["density"] = np.full(len(rows), density)
            notes.append(
                f"its thrust and Ct agree at a diameter of {1e3 * diameter:.4g} mm in air of {density:g} kg/m3"
            )
    return ApcPerformance(columns, np.array([n for n, _ in rows], dtype=np.int64), diameter, tuple(notes))


def _convert_row(names: list[str], units: list[str], values: list[float], speed: float) -> dict[str, float]:
    """Return the SI values of one line of the file by quantity, at a rotor ``speed`` (rad/s).

    If several columns hold one quantity, the last one is read, which is in SI units.
    """
    row = {"speed": speed}
    own = {"j": "advance_ratio", "ct": "thrust_coefficient", "cp": "power_coefficient"}
    known = {"v": "airspeed", "thrust": "thrust", "torque": "torque", "pwr": "power"}
    units = units if len(units) == len(names) else [""] * len(names)
    for name, unit, value in zip(names, units, values, strict=True):
        if name in own:
            row[own[name]] = value
        elif name in known and normalise_unit(unit.replace("-", " "), _COLUMN_UNITS[name]):
            _, factor, _ = unit_conversion(
                normalise_unit(unit.replace("-", " "), _COLUMN_UNITS[name]), _COLUMN_UNITS[name]
            )
            row[known[name]] = factor * value
    return row
