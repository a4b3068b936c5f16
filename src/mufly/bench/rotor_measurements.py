"""Measured points of a rotor from files of test benches and propeller databases.

A file is a bench file (:mod:`mufly.bench.bench_table`: units in the headers, several separators) with the columns

=========  ===========================================================================================
pitch      ``pitch_deg``; by default the caller's value, else 0 (the blades as in the rotor file)
speed      ``speed_rpm``, ``RPM``
thrust     ``thrust_N``, ``T(gf)``, or a coefficient, as ``CT`` = T / (rho n^2 D^4), n in revolutions a second
torque     ``torque_mNm``, ``Q(Nm)``, ``power_W``, or a coefficient, as ``CP`` = P / (rho n^3 D^5); it may be left out
air        ``airspeed_m_s``, ``climb_m_s`` along the shaft, or ``J`` = V / (n D); without it the rotor hovers
=========  ===========================================================================================

Coefficients need diameter and density. :mod:`mufly.bench.unit_conventions` decides conventions of coefficients and
missing units. APC performance files are read, too. A power equal to the product of voltage and current is electrical
and not used. A torque that is negative throughout is inverted. If the file states the air (``density_kg_m3``, or
``temperature_degC`` and ``pressure_hPa``), the loads are scaled to the mean of its densities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mufly.bench.bench_loads import resolve_air_density
from mufly.bench.bench_table import SI_UNITS, BenchTable, read_bench_file
from mufly.bench.unit_conventions import (
    COEFFICIENT_SCALINGS,
    add_loads_from_coefficients,
    convert_speed_to_rad_s,
    guess_load_units,
    is_power_column_electrical,
)
from mufly.errors import InputError
from mufly.quantities.units import RPM
from mufly.rotor import Air, RotorMeasurements

_MAX_PITCH_RAD = math.pi / 2
_SHOWN_UNITS = {"pitch": (math.radians(1.0), "degrees"), "speed": (RPM, "rpm")}


def read_measurements(
    path: str | Path,
    *,
    columns: Sequence[str] | Mapping[str, str] = (),
    diameter_m: float | None = None,
    density_kg_m3: float | None = None,
    speed_rad_s: float | None = None,
    pitch_rad: float | None = None,
) -> RotorMeasurements:
    """Read the measured points of a rotor.

    Parameters
    ----------
    path : str or Path
    columns : sequence of str, or dict
        Column map, as for :func:`mufly.bench.read_bench_files`.
    diameter_m, density_kg_m3 : float, optional
        Rotor diameter, needed for coefficients, and air density at the bench, 1.2 kg/m3 by default. A given density
        takes precedence over the file's density.
    speed_rad_s : float, optional
        Speed of all points, for a file without a speed column (as in tunnel runs of UIUC).
    pitch_rad : float, optional
        Pitch setting of all points, for a file without a pitch column; 0 by default.

    Raises
    ------
    InputError
        If the file cannot be read, a column is missing, or a value is invalid: speed, torque and power must be
        positive, thrust nonzero except in axial flight, and the pitch within 90 degrees.
    """
    table = read_bench_file(path, columns=columns)
    radius = 0.5 * diameter_m if diameter_m else None
    if "speed" in table and speed_rad_s is not None:
        raise table.make_column_error("speed", "is a column of the file", "omit the speed given in addition")
    if "speed" not in table and speed_rad_s:
        table = table.with_columns(speed=np.full(len(table), speed_rad_s))
    each, density = np.ones(len(table)), density_kg_m3 or math.nan
    coefficients = [n for n in COEFFICIENT_SCALINGS if n in table]
    if density_kg_m3 is None and ("density" in table or ("temperature" in table and "pressure" in table)):
        each, _ = resolve_air_density(table, None)
        density = float(each.mean())
    elif density_kg_m3 is None and any(c.partition("_")[0] not in table for c in coefficients):
        density = Air().density_kg_m3
    table.reject_wrong_units(("thrust", "torque", "speed"))
    if "power" in table and "torque" not in table and is_power_column_electrical(table):
        words = f"{table.headers['power']} is the product of voltage and current: no torque is read from it"
        kept = {k: v for k, v in table.columns.items() if k != "power"}
        table = replace(table, columns=kept, notes=(*table.notes, words))
    # Loads from coefficients use the mean density, to which measured loads are scaled below.
    table = add_loads_from_coefficients(table, radius, density)
    made = {n for n in ("thrust", "torque") if n in table and table.headers[n] == n and coefficients}
    if "torque" not in table and "power" in table:
        table.require_columns(("speed",))
        header = table.headers["power"]
        with np.errstate(divide="ignore", invalid="ignore"):
            table = table.with_columns(torque=table["power"] / table["speed"])
        table = replace(table, headers={**table.headers, "torque": header})
    table.require_columns(("speed", "thrust"))
    _check_pitch_and_speed(table, pitch_rad)
    table = _resolve_units(table, radius, density if math.isfinite(density) else Air().density_kg_m3)
    table = _invert_negative_loads(table)
    if not {"airspeed", "advance_ratio"} & set(table.columns):
        # In a tunnel the thrust may vanish or become negative (windmilling).
        _require_column_values(table, "thrust", table["thrust"] != 0.0, "not be 0; delete the line")
        if "torque" in table:  # an empty cell is a point without torque
            must = "be above 0 for either sense of rotation: it loads the motor"
            _require_column_values(table, "torque", ~(table["torque"] <= 0.0), must)
    speed = table["speed"]
    thinner = {n: 1.0 if n in made or not math.isfinite(density) else density / each for n in ("thrust", "torque")}
    if density_kg_m3 is not None:
        thinner = dict.fromkeys(thinner, 1.0)
    torque = table["torque"] * thinner["torque"] if "torque" in table else np.full(len(table), math.nan)
    pitch = table["pitch"] if "pitch" in table else np.full(len(table), pitch_rad or 0.0)
    climb = table["airspeed"] if "airspeed" in table else np.zeros(len(table))
    if "airspeed" not in table and "advance_ratio" in table:
        if not diameter_m:
            raise table.make_column_error(
                "advance_ratio", "needs the rotor's diameter", "name the rotor, or give airspeed_m_s"
            )
        climb = table["advance_ratio"] * speed / (2.0 * math.pi) * diameter_m
    notes = list(table.notes)
    if math.isfinite(table.diameter_m) and diameter_m and abs(table.diameter_m / diameter_m - 1.0) > 0.02:
        notes.append(f"the file's rotor is {1e3 * table.diameter_m:.4g} mm across, this one {1e3 * diameter_m:.4g} mm")
    return RotorMeasurements(
        pitch, speed, table["thrust"] * thinner["thrust"], torque, table.source, climb, density, tuple(notes)
    )


def _check_pitch_and_speed(table: BenchTable, pitch_rad: float | None) -> None:
    """Raise an error for invalid pitch or speed."""
    if "pitch" in table:
        table.require_columns(("pitch",))
        if pitch_rad is not None:
            raise table.make_column_error("pitch", "is a column of the file", "omit the pitch given in addition")
        within = np.abs(table["pitch"]) <= _MAX_PITCH_RAD
        _require_column_values(table, "pitch", within, "lie within 90 degrees; check its unit")
    _require_column_values(table, "speed", table["speed"] > 0.0, "be above 0")
    table.require_columns([n for n in ("airspeed", "advance_ratio") if n in table])


def _resolve_units(table: BenchTable, radius_m: float | None, density_kg_m3: float) -> BenchTable:
    """Choose missing units of speed and loads by the size of the coefficients, or raise an error."""
    unsaid = [n for n in ("speed", "thrust", "torque") if n in table.columns_without_unit]
    if unsaid and radius_m is None:
        example = {"speed": "speed_rpm", "thrust": "thrust_N", "torque": "torque_Nm"}[unsaid[0]]
        raise table.make_column_error(unsaid[0], "has no unit", f"name it with its unit, as {example}")
    if unsaid and radius_m is not None:
        table = convert_speed_to_rad_s(table, radius_m)
        loads = {n: table[n] for n in ("thrust", "torque") if n in table}
        for name, (factor, words) in guess_load_units(table, loads, radius_m, density_kg_m3).items():
            table = table.rescale_column(name, factor, words)
    return table


def _invert_negative_loads(table: BenchTable) -> BenchTable:
    """Invert a thrust or torque that is negative in every line, with a note."""
    for name, sign in (("thrust", "the load cell"), ("torque", "the sense of rotation")):
        if name in table:
            known = table[name][np.isfinite(table[name])]
            if known.size and np.all(known < 0.0):
                words = f"{table.headers[name]} is negative throughout and was turned round: the sign of {sign}"
                table = table.rescale_column(name, -1.0, words)
    return table


def _require_column_values(
    table: BenchTable, name: str, good: np.ndarray[tuple[int], np.dtype[np.bool_]], must: str
) -> None:
    bad = np.flatnonzero(~good)
    if bad.size:
        where = f"line {table.line_numbers[bad[0]]}, {table.headers[name]}"
        factor, unit = _SHOWN_UNITS.get(name, (1.0, SI_UNITS[name]))
        raise InputError(table.source, where, f"is {table[name][bad[0]] / factor:.6g} {unit}", f"it must {must}")
