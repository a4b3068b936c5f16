"""Measured points of a rotor, as the files of test benches and propeller data sites give them.

A measurement file is a CSV with a header; lines that begin with ``#`` are skipped::

    pitch_deg,speed_rpm,thrust_N,torque_Nm
    12,5000,0.151,0.0015

Columns go by several names, case does not matter, and others are passed over:

=========  ==================================================================================================
pitch      ``pitch_deg``; without it the blades stand as in the rotor file (0)
speed      ``speed_rpm``, ``rpm``
thrust     ``thrust_N``, ``T_N``, ``T(N)``, ``T_meas_N``, or ``CT`` = T / (rho n^2 D^4), n in revolutions a second
torque     ``torque_Nm``, ``Q_Nm``, ``Q(Nm)``, ``Q_meas_Nm``, ``power_W``, ``P(W)``, or ``CP`` = P / (rho n^3 D^5);
           it may be left out
=========  ==================================================================================================

The coefficients are those of propellers (UIUC's data, for one) and need diameter and density.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["Measurements", "read_measurements"]

Array = NDArray[np.float64]

_RPM = math.pi / 30.0
_TORQUE = ("torque_nm", "q_nm", "q(nm)", "q_meas_nm", "power_w", "p(w)", "cp")
_NAMES = {
    "pitch_deg": ("pitch_deg",),
    "speed_rpm": ("speed_rpm", "rpm"),
    "thrust_N": ("thrust_n", "t_n", "t(n)", "t_meas_n", "ct"),
    "torque_Nm": _TORQUE,
}


@dataclass(frozen=True, eq=False)
class Measurements:
    """Points of a test bench.

    Attributes
    ----------
    pitch_rad, speed_rad_s, thrust_N, torque_Nm : (n,) arrays
        Setting and result; torque is nan where it was not measured.
    source : str
        File or paper.
    """

    pitch_rad: Array
    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    source: str


def read_measurements(
    path: str | Path, *, diameter_m: float | None = None, density_kg_m3: float | None = None
) -> Measurements:
    """Read a measurement file.

    Parameters
    ----------
    path : str or Path
    diameter_m, density_kg_m3 : float, optional
        Of the rotor and of the air at the bench; needed where the file gives coefficients.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a value is not a number (thrust: not zero; speed:
        above zero).
    """
    where = str(path)
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(where, "", f"cannot be read ({error})", "give a CSV file") from error
    numbered = [
        (i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")
    ]
    if len(numbered) < 2:
        raise InputError(where, "", "holds no measurements", "give a header and at least one line")
    header = [name.strip() for name in next(csv.reader([numbered[0][1]]))]
    columns = _columns(where, header)
    if {"ct", "cp"} & {header[c].lower() for c in columns.values()} and not (diameter_m and density_kg_m3):
        raise InputError(
            where, "CT", "is a coefficient", "say to which rotor and air it belongs, or give thrust_N"
        )
    rows = []
    for number, line in numbered[1:]:
        cells = next(csv.reader([line]))
        row = {name: _number(where, number, header[c], cells, c) for name, c in columns.items()}
        if not (row["speed_rpm"] > 0.0 and row["thrust_N"] != 0.0 and row.get("torque_Nm", 1.0) != 0.0):
            raise InputError(where, f"line {number}", "has no speed, thrust or torque", "leave it out")
        rows.append(
            [row.get("pitch_deg", 0.0), row["speed_rpm"], row["thrust_N"], row.get("torque_Nm", math.nan)]
        )
    pitch, rpm, thrust, torque = np.array(rows).T
    speed = rpm * _RPM
    named = header[columns["thrust_N"]].lower()
    to_thrust = _thrust_from(named, diameter_m or math.nan, density_kg_m3 or math.nan)
    if "torque_Nm" in columns:
        named = header[columns["torque_Nm"]].lower()
        torque = _torque_from(named, diameter_m or math.nan, density_kg_m3 or math.nan)(torque, speed)
    return Measurements(np.radians(pitch), speed, to_thrust(thrust, speed), torque, Path(path).name)


def _columns(where: str, header: list[str]) -> dict[str, int]:
    lower = [name.lower() for name in header]
    found = {
        quantity: lower.index(next(n for n in names if n in lower))
        for quantity, names in _NAMES.items()
        if any(n in lower for n in names)
    }
    for quantity in ("speed_rpm", "thrust_N"):
        if quantity not in found:
            raise InputError(
                where, quantity, "is not among the columns", f"the header is {', '.join(header)}"
            )
    return found


def _number(where: str, number: int, column: str, cells: list[str], index: int) -> float:
    cell = cells[index].strip() if index < len(cells) else ""
    optional = column.lower() in _TORQUE
    try:
        value = math.nan if optional and not cell else float(cell)
    except ValueError:
        raise InputError(where, f"line {number}, {column}", f"{cell!r} is not a number", "give one") from None
    if not (math.isfinite(value) or (optional and not cell)):
        raise InputError(where, f"line {number}, {column}", f"is {value:g}", "give a finite number")
    return value


_Convert = Callable[[Array, Array], Array]


def _thrust_from(column: str, diameter: float, density: float) -> _Convert:
    if column == "ct":
        return lambda value, speed: value * density * (speed / (2 * np.pi)) ** 2 * diameter**4
    return lambda value, speed: value


def _torque_from(column: str, diameter: float, density: float) -> _Convert:
    if column == "cp":
        return lambda value, speed: value * density * (speed / (2 * np.pi)) ** 3 * diameter**5 / speed
    if column in ("power_w", "p(w)"):
        return lambda value, speed: value / speed
    return lambda value, speed: value
