"""Resolution of ambiguities in bench files: coefficient conventions, units of loads and speeds, lines at rest.

**Coefficients** of propellers, with n in revolutions per second and diameter D (UIUC, APC), and of rotors (Leishman):

    CT = T / (rho n^2 D^4),    CQ = Q / (rho n^2 D^5),    CP = P / (rho n^3 D^5) = 2 pi CQ
    c_T = T / (rho A (Omega R)^2) = 4 CT / pi^3,    c_Q = Q / (rho A (Omega R)^2 R) = 4 CP / pi^4

``CT`` denotes the propeller convention, ``c_T`` the rotor convention. In hover a median of ``CT`` below
:data:`_MIN_PROPELLER_CT` is ambiguous and raises an error.

**Units.** Missing units are chosen by the size of the result. A speed gives c_T nearest to
:data:`TYPICAL_THRUST_COEFFICIENT`, and a thrust gives c_T within :data:`_HOVER_THRUST_COEFFICIENT_RANGE`. A torque, and
a thrust with two possible units, gives a figure of merit within :data:`_HOVER_FIGURE_OF_MERIT_RANGE`. If no unit or
several units are possible, an error is raised.

**Rest.** A line gives the zero of the load cells under three conditions: the speed is 0, the throttle is below
:data:`_MAX_REST_DUTY`, and the load differs from the adjacent turning lines. The difference must exceed
:data:`_LOST_SPEED_LOAD_DIFFERENCE_FRACTION` of ``c W^2``, with c from ``load = zero + c W^2`` at the turning lines.
Other lines
without speed are omitted as failed speed readings. Loads ``c W^2`` below :data:`_MIN_COMPARED_LOAD_FRACTION` of the
largest are not used for this decision.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mufly.bench.bench_table import BenchTable, strip_rotor_and_raw_suffix
from mufly.quantities.units import RPM, find_conversion_factor

Array = NDArray[np.float64]
LineMask = NDArray[np.bool_]

TYPICAL_THRUST_COEFFICIENT = 0.01
"""Thrust coefficient c_T of a typical hovering rotor."""
LOAD_QUANTITIES = ("thrust", "torque")
_HOVER_THRUST_COEFFICIENT_RANGE = 0.0015, 0.045  # range of c_T of hovering rotors
_HOVER_TORQUE_COEFFICIENT_RANGE = 1e-4, 6e-3  # range of c_Q
_MIN_GRAM_THRUST_COEFFICIENT, _MAX_KILOGRAM_THRUST_COEFFICIENT = 0.025, 2e-4  # c_T at which newtons may be grams
_HOVER_FIGURE_OF_MERIT_RANGE = (0.15, 0.95)  # range of the figure of merit of hovering rotors
_MIN_PROPELLER_CT = 0.02
_CANDIDATE_THRUST_UNITS = ("N", "gf", "kgf")
_CANDIDATE_TORQUE_UNITS = ("N m", "mN m", "N cm", "gf cm", "kgf cm", "ozf in", "lbf in")
_MAX_TIP_SPEED_M_S = 300.0
_MAX_REST_DUTY, _LOST_SPEED_LOAD_DIFFERENCE_FRACTION, _MIN_COMPARED_LOAD_FRACTION = 0.05, 0.4, 0.05
_MAX_HOVER_ADVANCE_RATIO = 0.02  # advance ratio V / (n D) below which a rotor hovers
_ELECTRICAL_POWER_TOLERANCE = 0.03  # relative tolerance of power to voltage times current

COEFFICIENT_SCALINGS = {
    # column: load, power of D, and factor; of propellers in n, of rotors with 4 CT = pi^3 c_T, 4 CP = pi^4 c_Q
    "thrust_coefficient": ("thrust", 4, 1.0),
    "propeller_thrust_coefficient": ("thrust", 4, 1.0),
    "rotor_thrust_coefficient": ("thrust", 4, math.pi**3 / 4.0),
    "power_coefficient": ("torque", 5, 1.0 / (2.0 * math.pi)),
    "torque_coefficient": ("torque", 5, 1.0),
    "rotor_torque_coefficient": ("torque", 5, math.pi**3 / 8.0),
}


def add_loads_from_coefficients(table: BenchTable, radius_m: float | None, density_kg_m3: Array | float) -> BenchTable:
    """Return the table with thrust and torque computed from their coefficients.

    Parameters
    ----------
    table : BenchTable
    radius_m : float, optional
        Rotor radius, needed for coefficients.
    density_kg_m3 : float or (n,) array

    Raises
    ------
    InputError
        If the radius or the speed is missing, or the convention is ambiguous.
    """
    for name, (load, power, factor) in COEFFICIENT_SCALINGS.items():
        if name not in table or load in table:
            continue
        if not radius_m:
            raise table.make_column_error(
                name, "is a coefficient, and the rotor is unknown", "name the rotor, or give thrust_N"
            )
        table = convert_speed_to_rad_s(table, radius_m)
        table.require_columns(("speed",))
        _check_convention(table, name)
        turns, diameter = np.abs(table["speed"]) / (2.0 * math.pi), 2.0 * radius_m
        table = table.with_columns(
            f"{table.headers[name]}: {_CONVENTION_DESCRIPTIONS[name]}, in air of "
            f"{float(np.mean(density_kg_m3)):.4g} kg/m3",
            **{load: table[name] * (factor * density_kg_m3 * turns**2 * diameter**power)},
        )
    return table


_CONVENTION_DESCRIPTIONS = {
    "thrust_coefficient": "read as the propeller's T / (rho n^2 D^4)",
    "propeller_thrust_coefficient": "read as the propeller's T / (rho n^2 D^4)",
    "rotor_thrust_coefficient": "read as the rotor's T / (rho A (Omega R)^2)",
    "power_coefficient": "read as the propeller's P / (rho n^3 D^5)",
    "torque_coefficient": "read as the propeller's Q / (rho n^2 D^5)",
    "rotor_torque_coefficient": "read as the rotor's Q / (rho A (Omega R)^2 R)",
}


def _check_convention(table: BenchTable, name: str) -> None:
    typical = float(np.nanmedian(np.abs(table[name])))
    if name == "thrust_coefficient" and not mask_axial_flight_lines(table, None).any() and typical < _MIN_PROPELLER_CT:
        raise table.make_column_error(
            name, f"is near {typical:.3g}: T / (rho n^2 D^4) of a propeller or T / (rho A (Omega R)^2) of a rotor?",
            f"choose one: columns=propeller_CT={table.headers[name]} or columns=rotor_CT={table.headers[name]}",
        )  # fmt: skip


def mask_axial_flight_lines(table: BenchTable, radius_m: float | None) -> LineMask:
    """Return a mask (n,) of lines in axial flight: advance ratio V / (n D) above 0.02."""
    if "advance_ratio" in table:
        return np.abs(np.nan_to_num(table["advance_ratio"])) > _MAX_HOVER_ADVANCE_RATIO
    if "airspeed" not in table:
        return np.zeros(len(table), dtype=np.bool_)
    air = np.abs(np.nan_to_num(table["airspeed"]))
    if radius_m is None or "speed" not in table:
        return air > 0.0
    return air > _MAX_HOVER_ADVANCE_RATIO * np.abs(table["speed"]) / math.pi * radius_m


def convert_speed_to_rad_s(table: BenchTable, radius_m: float) -> BenchTable:
    """Return the table with the speed in rad/s; a missing unit is inferred from the thrust or from the tip speed.

    Raises
    ------
    InputError
        If both units are possible.
    """
    if "speed" not in table.columns_without_unit:
        return table
    speed, header = table["speed"], table.headers["speed"]
    if "thrust" in table and "thrust" not in table.columns_without_unit:
        unit, factor = guess_speed_unit(speed, table["thrust"], radius_m)
        return table.rescale_column("speed", factor, f"{header} has no unit: taken as {unit}")
    if float(np.nanmax(np.abs(speed))) * radius_m > _MAX_TIP_SPEED_M_S:
        return table.rescale_column(
            "speed",
            RPM,
            f"{header} has no unit: taken as rpm; in rad/s the tip would move faster than {_MAX_TIP_SPEED_M_S:g} m/s",
        )
    raise table.make_column_error("speed", "has no unit: rpm or rad/s?", "name it speed_rpm or speed_rad_s")


def guess_speed_unit(speed: Array, thrust: Array, radius_m: float) -> tuple[str, float]:
    """Return the unit of a speed, rpm or rad/s, that gives the more typical thrust coefficient, and its SI factor."""
    with np.errstate(divide="ignore", invalid="ignore"):
        typical = float(np.nanmedian(np.abs(thrust / (1.2 * math.pi * radius_m**4 * speed**2))))
    off = abs(math.log(typical / TYPICAL_THRUST_COEFFICIENT))
    off_rpm = abs(math.log(typical / RPM**2 / TYPICAL_THRUST_COEFFICIENT))
    return ("rpm", RPM) if off_rpm < off else ("rad/s", 1.0)


def guess_load_units(
    table: BenchTable, loads: Mapping[str, Array], radius_m: float, density_kg_m3: float
) -> dict[str, tuple[float, str]]:
    """Return the SI factor and a note for each load without a unit.

    Parameters
    ----------
    table : BenchTable
        Table with speeds in rad/s and the names of loads without unit.
    loads : mapping of str to (n,) array
        Loads as written, ``thrust``, ``torque_upper`` ..., at the same lines.
    radius_m, density_kg_m3 : float

    Raises
    ------
    InputError
        If no unit or several units are possible.
    """
    found: dict[str, tuple[float, str]] = {}
    scale = density_kg_m3 * math.pi * radius_m**4
    for channel in sorted(set(loads) & set(table.columns_without_unit)):  # thrust before torque
        quantity, _, side = channel.partition("_")
        names = [n for n in table.columns if strip_rotor_and_raw_suffix(n) == "speed" and n.endswith(side)]
        squares = np.sum([table[n] ** 2 for n in names], axis=0)
        other = ("torque" if quantity == "thrust" else "thrust") + (f"_{side}" if side else "")
        beside = None if other in table.columns_without_unit and other not in found else loads.get(other)
        if beside is not None:
            beside = beside * found.get(other, (1.0, ""))[0]
        units = _CANDIDATE_THRUST_UNITS if quantity == "thrust" else _CANDIDATE_TORQUE_UNITS
        low, high = _HOVER_THRUST_COEFFICIENT_RANGE if quantity == "thrust" else _HOVER_TORQUE_COEFFICIENT_RANGE
        arm = 1.0 if quantity == "thrust" else radius_m
        with np.errstate(divide="ignore", invalid="ignore"):
            size = float(np.nanmedian(np.abs(loads[channel]) / (scale * arm * squares)))
        fits = []
        for unit in units:
            factor = find_conversion_factor(unit)
            load = loads[channel] * factor
            pair = (load, beside) if quantity == "thrust" else (beside, load)
            merit = compute_median_figure_of_merit(pair[0], pair[1], squares, density_kg_m3, radius_m)
            ordinary = low < factor * size < high or (quantity == "torque" and beside is not None)
            if ordinary and (
                math.isnan(merit) or _HOVER_FIGURE_OF_MERIT_RANGE[0] < merit < _HOVER_FIGURE_OF_MERIT_RANGE[1]
            ):
                fits.append((unit, factor, merit))
        if quantity == "thrust" and [u for u, _, _ in fits] == ["N"]:
            # Grams of a rotor at low pitch look like newtons of a heavily loaded one.
            light = find_conversion_factor("gf") * size
            merit = compute_median_figure_of_merit(
                loads[channel] * find_conversion_factor("gf"), beside, squares, density_kg_m3, radius_m
            )
            if size > _MIN_GRAM_THRUST_COEFFICIENT and light > _MAX_KILOGRAM_THRUST_COEFFICIENT and math.isnan(merit):
                fits.append(("gf", find_conversion_factor("gf"), merit))
        if len(fits) != 1:
            what = " or ".join(u for u, _, _ in fits) if fits else "no unit"
            stem = table.headers[channel].strip()
            example = fits[-1][0] if fits else "gf" if quantity == "thrust" else "mNm"
            raise table.make_column_error(
                channel, f"has no unit, and its size suits {what}",
                f"name its unit in the header, as {channel}_{'N' if quantity == 'thrust' else 'Nm'} or "
                f"{channel} ({example}), or map it with columns={channel}={stem}({example})",
            )  # fmt: skip
        unit, factor, merit = fits[0]
        symbol = "c_T" if quantity == "thrust" else "c_Q"
        sized = f"{symbol} near {factor * size:.2g}" + ("" if math.isnan(merit) else f", figure of merit {merit:.2f}")
        found[channel] = factor, f"{table.headers[channel]}: no unit is written, taken as {unit} ({sized})"
    return found


def compute_median_figure_of_merit(
    thrust: Array | None, torque: Array | None, speed_squared: Array, density_kg_m3: float, radius_m: float
) -> float:
    """Return the median figure of merit, T^1.5 / (sqrt(2 rho A) Q Omega); NaN if a load is missing."""
    if thrust is None or torque is None:
        return math.nan
    ideal = np.abs(thrust) ** 1.5 / math.sqrt(2.0 * density_kg_m3 * math.pi * radius_m**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        merit = ideal / (np.abs(torque) * np.sqrt(speed_squared))
    known = merit[np.isfinite(merit)]
    return float(np.median(known)) if known.size else math.nan


def is_power_column_electrical(table: BenchTable) -> bool:
    """Return whether the power column equals voltage times current."""
    current = next((n for n in ("supply_current", "current") if n in table), "")
    if not ("power" in table and "voltage" in table and current):
        return False
    product = table["voltage"] * table[current]
    seen = product > 0.0
    return (
        bool(seen.any())
        and float(np.nanmedian(np.abs(table["power"][seen] / product[seen] - 1.0))) < _ELECTRICAL_POWER_TOLERANCE
    )


def mask_rest_and_lost_speed(table: BenchTable, speeds: list[str]) -> tuple[LineMask, LineMask]:
    """Return masks (n,) of the lines at rest, and of lines with a lost speed reading.

    Parameters
    ----------
    table : BenchTable
        Table in the order of measurement.
    speeds : list of str
        Names of the speed columns.
    """
    still: LineMask = np.all([table[c] == 0.0 for c in speeds], axis=0)
    if not still.any():
        return still, np.zeros_like(still)
    lost = np.zeros_like(still)
    if "duty" in table:
        lost |= still & (np.nan_to_num(table["duty"]) > _MAX_REST_DUTY)
    for channel in (c for c in table.columns if strip_rotor_and_raw_suffix(c) in LOAD_QUANTITIES):
        side = channel.removesuffix("_raw").partition("_")[2]
        own = [c for c in speeds if not side or c.endswith(side)] or speeds
        squares, y = np.sum([table[c] ** 2 for c in own], axis=0), table[channel]
        turning = ~still & np.isfinite(y) & (squares > 0.0)
        resting = still & ~lost & np.isfinite(y)
        if np.unique(squares[turning]).size < 2 or not resting.any():
            continue
        rows, top = np.flatnonzero(turning), float(squares[turning].max())
        a = np.column_stack([np.ones(rows.size), squares[turning] / top])
        load = np.abs(np.linalg.lstsq(a, y[turning], rcond=None)[0][1]) * squares / top
        after = np.searchsorted(rows, np.flatnonzero(resting))
        for beside in (rows[np.maximum(after - 1, 0)], rows[np.minimum(after, rows.size - 1)]):
            alike = np.abs(y[resting] - y[beside]) < _LOST_SPEED_LOAD_DIFFERENCE_FRACTION * load[beside]
            lost[resting] |= alike & (load[beside] > _MIN_COMPARED_LOAD_FRACTION * load[turning].max())
    return still & ~lost, lost
