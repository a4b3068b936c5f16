"""Measured points of a rotor, from the files of test benches and of propeller data sites.

A file is a bench file as any other (:mod:`mufly.bench.table`: units in the headers, several separators). Of its columns

=========  ===========================================================================================
pitch      ``pitch_deg``; without it as the caller says, else the blades stand as in the rotor file (0)
speed      ``speed_rpm``, ``RPM``
thrust     ``thrust_N``, ``T(gf)``, or ``CT`` = T / (rho n^2 D^4), n in revolutions a second
torque     ``torque_mNm``, ``Q(Nm)``, ``power_W``, or ``CP`` = P / (rho n^3 D^5); it may be left out
air        ``airspeed_m_s``, ``climb_m_s`` along the shaft, or ``J`` = V / (n D); without it the rotor hovers
=========  ===========================================================================================

are used. The coefficients are those of propellers (UIUC's data, for one) and need diameter and density. Where the file
says in which air it was measured (``density_kg_m3``, or ``temperature_degC`` and ``pressure_hPa``), its loads are taken
to the mean of its densities, as they go with it.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.bench.loads import air_density
from mufly.bench.table import BenchTable, read_bench
from mufly.errors import InputError
from mufly.rotor import Air, Measurements

_PITCH_LIMIT_RAD = math.pi / 2


def read_measurements(
    path: str | Path,
    *,
    columns: str | None = None,
    diameter_m: float | None = None,
    density_kg_m3: float | None = None,
    speed_rad_s: float | None = None,
    pitch_rad: float | None = None,
) -> Measurements:
    """Read the measured points of a rotor.

    Parameters
    ----------
    path : str or Path
    columns : str, optional
        Map of headers, as for :func:`mufly.bench.read_bench`.
    diameter_m, density_kg_m3 : float, optional
        Of the rotor and of the air at the bench; the diameter is needed where the file gives coefficients, the density
        is 1.2 there unless given. A density that is given goes before the file's.
    speed_rad_s : float, optional
        Of all points, where the file has no column of it (UIUC's runs in a tunnel have it in their names).
    pitch_rad : float, optional
        Pitch setting of all points, where the file has no column of it; 0 unless given.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a value is not possible: speed, torque and power are above
        zero and thrust is not zero but in axial flight, the pitch lies within 90 degrees.
    """
    table = read_bench(path, columns=columns)
    thrust_in = next((n for n in ("thrust", "thrust_coefficient") if n in table), "thrust")
    torque_in = next((n for n in ("torque", "power", "power_coefficient") if n in table), "")
    table.require((thrust_in,) if speed_rad_s and "speed" not in table else ("speed", thrust_in))
    if "speed" in table and speed_rad_s is not None:
        raise table.fault("speed", "is a column of the file", "leave out the speed given beside it")
    if "pitch" in table:
        table.require(("pitch",))
        if pitch_rad is not None:
            raise table.fault("pitch", "is a column of the file", "leave out the pitch given beside it")
        _check(
            table,
            "pitch",
            np.abs(table["pitch"]) <= _PITCH_LIMIT_RAD,
            "lie within 90 degrees; is its unit right?",
        )
    if "speed" in table:
        _check(table, "speed", table["speed"] > 0.0, "be above 0")
    air = next((n for n in ("airspeed", "advance_ratio") if n in table), "")
    if air:
        table.require((air,))
    if not air:  # in a tunnel thrust ends, and beyond that the air turns the rotor
        _check(table, thrust_in, table[thrust_in] != 0.0, "not be 0; leave the line out")
    if torque_in and not air:
        # An empty cell is a point without torque.
        known = ~(table[torque_in] <= 0.0)
        _check(
            table,
            torque_in,
            known,
            "be above 0: what the motor has to overcome, whichever way the rotor turns",
        )
    coefficients = {thrust_in, torque_in} & {"thrust_coefficient", "power_coefficient"}
    if coefficients and not diameter_m:
        key = thrust_in if thrust_in == "thrust_coefficient" else torque_in
        raise table.fault(key, "is a coefficient", "say to which rotor it belongs, or give thrust_N")
    if air == "advance_ratio" and not diameter_m:
        raise table.fault(air, "is a ratio", "say to which rotor it belongs, or give airspeed_m_s")
    speed = table["speed"] if "speed" in table else np.full(len(table), speed_rad_s or math.nan)
    density = density_kg_m3 or (Air().density_kg_m3 if coefficients else math.nan)
    thinner: NDArray[np.float64] | float = 1.0  # what loads of the mean density are of those measured
    if density_kg_m3 is None and ("density" in table or ("temperature" in table and "pressure" in table)):
        each, _ = air_density(table, None)
        density = float(each.mean())
        thinner = density / each
    turns, diameter = speed / (2.0 * math.pi), diameter_m or math.nan
    thrust = table[thrust_in]
    by_coefficient = thrust_in == "thrust_coefficient"
    thrust = thrust * (density * turns**2 * diameter**4 if by_coefficient else thinner)
    torque = table[torque_in] if torque_in else np.full(len(table), math.nan)
    if torque_in == "power_coefficient":
        torque = torque * density * turns**3 * diameter**5 / speed
    else:
        torque = (torque / speed if torque_in == "power" else torque) * thinner
    pitch = table["pitch"] if "pitch" in table else np.full(len(table), pitch_rad or 0.0)
    climb = table[air] if air else np.zeros(len(table))
    if air == "advance_ratio":
        climb = climb * turns * diameter
    return Measurements(pitch, speed, thrust, torque, table.source, climb, density)


def _check(table: BenchTable, name: str, good: np.ndarray[tuple[int], np.dtype[np.bool_]], must: str) -> None:
    bad = np.flatnonzero(~good)
    if bad.size:
        where = f"line {table.line[bad[0]]}, {table.headers[name]}"
        raise InputError(table.source, where, f"is {table[name][bad[0]]:g} in SI units", f"it must {must}")
