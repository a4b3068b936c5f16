"""Readings of a motor bench in SI units, their expected errors, and mistakes of units that the energy balance shows.

Wrong units violate the energy balance: over all points the sum of torque times speed cannot exceed the sum of voltage
times current. In this case the usual mistakes (rpm for rad/s, mN m for N m) are tested, and the error names the one
that restores the balance. A file without a unit of the speed gets this unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mufly.bench import SI_UNITS, BenchTable
from mufly.errors import ArgumentError, InputError
from mufly.quantities.units import RPM

Array = NDArray[np.float64]

MOTOR_CHANNELS = ("voltage", "current", "speed", "torque")
_UNIT_MISTAKES = (
    ("speed", "rpm", RPM), ("speed", "revolutions a second", 2 * math.pi), ("torque", "mN m", 1e-3),
    ("torque", "N cm", 1e-2),
)  # fmt: skip
_MIN_PLAUSIBLE_EFFICIENCY = 0.02  # efficiency below which units are doubtful
_MAX_PLAUSIBLE_EFFICIENCY = 1.02  # efficiency above which units are wrong


@dataclass(frozen=True)
class ChannelNoise:
    """Assumed error of a channel: a fraction of the reading, a fraction of full scale, and an absolute part.

    Attributes
    ----------
    reading_fraction, largest_reading_fraction : float
        Fractions of the reading and of the largest reading.
    absolute_std : float
        Absolute standard deviation (SI).
    """

    reading_fraction: float = 0.01
    largest_reading_fraction: float = 0.003
    absolute_std: float = 0.0

    def error_std(self, value: Array) -> Array:
        """Return the standard deviations (n,) of readings (n,)."""
        full = self.largest_reading_fraction * float(np.max(np.abs(value)))
        return np.sqrt((self.reading_fraction * value) ** 2 + full**2 + self.absolute_std**2)


def parse_channel_noise(text: str | None, channels: tuple[str, ...]) -> dict[str, ChannelNoise]:
    """Parse channel errors such as ``"current=1%+0.01,voltage=0.02"``; other channels keep the default.

    ``"1%"`` is a share of the reading, ``"0.5%fs"`` a share of the largest reading, and a bare number is in SI units.
    Independent parts are joined with ``+``.

    Raises
    ------
    InputError
        If a channel is unknown or an amount is not a positive number.
    """
    result = {name: ChannelNoise() for name in channels}
    for part in (text or "").split(","):
        if not part.strip():
            continue
        name, _, amounts = (t.strip() for t in part.partition("="))
        if name not in result:
            raise ArgumentError("noise", name, "is not a channel", f"use one of {', '.join(channels)}")
        amount = {"reading_fraction": 0.0, "largest_reading_fraction": 0.0, "absolute_std": 0.0}
        for piece in amounts.lower().replace(" ", "").split("+"):
            kind, number = "absolute_std", piece
            if piece.endswith("%fs"):
                kind, number = "largest_reading_fraction", piece[:-3]
            elif piece.endswith("%"):
                kind, number = "reading_fraction", piece[:-1]
            try:
                value = float(number) * (1.0 if kind == "absolute_std" else 0.01)
            except ValueError:
                value = math.nan
            if not (math.isfinite(value) and value >= 0):
                raise ArgumentError(
                    "noise", name, f"{piece!r} is not an amount", "write 1%, 0.5%fs or a number in SI units"
                )
            amount[kind] += value
        if not any(amount.values()):
            raise ArgumentError("noise", name, "is zero", "omit this noise, or give an amount above zero")
        result[name] = ChannelNoise(**amount)
    return result


@dataclass(frozen=True, eq=False)
class MotorData:
    """Steady-state points of a motor, arrays (n,): motor voltage, current, speed, torque, and number of the run."""

    voltage_V: Array
    current_A: Array
    speed_rad_s: Array
    torque_Nm: Array
    run: NDArray[np.int64]

    def channel_arrays(self) -> tuple[Array, Array, Array, Array]:
        """Return voltage (V), current (A), speed (rad/s) and torque (N m)."""
        return self.voltage_V, self.current_A, self.speed_rad_s, self.torque_Nm


def extract_motor_data(table: BenchTable) -> tuple[MotorData, list[str]]:
    """Return the readings of a motor bench in SI units, and notes on guessed units and derived channels.

    Raises
    ------
    InputError
        If a column is missing, constant, or has an impossible unit.
    """
    notes = list(table.notes)
    table.require_columns(("voltage", "speed", "torque"))
    voltage = table["voltage"]
    if "duty" in table:
        table.require_columns(("duty",))
        duty = table["duty"]
        outside = np.flatnonzero((duty < 0) | (duty > 1))
        if outside.size:
            raise InputError(
                table.source, f"line {table.line_numbers[outside[0]]}, {table.headers['duty']}",
                f"{duty[outside[0]]:g} is not a share of the voltage",
                "give duty from 0 to 1, duty_% up to 100, or a pulse of 1000 to 2000 us",
            )  # fmt: skip
        voltage = duty * voltage
        notes.append("voltage at the motor = duty * voltage")
    if "current" in table or "supply_current" not in table:
        table.require_columns(("current",))
        current = table["current"]
    elif "duty" in table:
        table.require_columns(("supply_current",))
        idle = table["duty"] == 0
        turning_idle = np.flatnonzero(idle & (table["speed"] != 0))
        if turning_idle.size:
            where = f"line {table.line_numbers[turning_idle[0]]}, {table.headers['duty']}"
            raise InputError(table.source, where, "is 0 while the rotor turns", "delete the line, or correct the duty")
        current = np.where(idle, 0.0, table["supply_current"]) / np.where(idle, 1.0, table["duty"])
        notes.append("motor current = supply current / duty (mean of the chopped current)")
    else:
        header = table.headers["supply_current"]
        raise InputError(table.source, header, "is not the motor's current", "add the column duty")
    turning = (np.abs(table["speed"]) > 0) | (np.abs(current) > 0)
    if not turning.all():
        notes.append(f"{int(np.sum(~turning))} lines without speed and current were omitted")
    run = table["run"].astype(np.int64) if "run" in table else np.zeros(len(table), dtype=np.int64)
    u, i, w, q = (v[turning] for v in (voltage, current, table["speed"], table["torque"]))
    data = MotorData(u, i, w, q, run[turning])
    _check_variation(table, data)
    return _resolve_speed_unit(table, data, notes), notes


def _check_variation(table: BenchTable, data: MotorData) -> None:
    for name, v in (("current", data.current_A), ("speed", data.speed_rad_s)):
        if v.size and float(np.ptp(v)) <= 1e-3 * float(np.max(np.abs(v), initial=0.0)):
            constant = f"is constant ({v[0]:.4g} in SI units)"
            remedy = "vary the load or the voltage between lines"
            raise InputError(table.source, table.headers.get(name, name), constant, remedy)
    if data.torque_Nm.size and not np.any(data.torque_Nm):
        raise InputError(
            table.source, table.headers["torque"], "is zero in every line",
            "load the motor: without load only the ratio of friction dR and torque constant kM can be fitted",
        )  # fmt: skip


def _mean_efficiency(data: MotorData) -> float:
    electrical = float(np.sum(data.voltage_V * data.current_A))
    return float(np.sum(data.torque_Nm * data.speed_rad_s)) / electrical if electrical > 0 else math.inf


def _resolve_speed_unit(table: BenchTable, data: MotorData, notes: list[str]) -> MotorData:
    """Choose the unit of speed by the energy balance if the file states none; raise an error for impossible units."""
    e = _mean_efficiency(data)
    if "speed" in table.columns_without_unit:
        unit, factor = ("rpm", RPM) if e > 0.95 else ("rad/s", 1.0)
        notes.append(
            f"speed has no unit: taken as {unit}, with which {100 * e * factor:.0f} % of the electrical power becomes "
            "mechanical power"
        )
        data = replace(data, speed_rad_s=data.speed_rad_s * factor)
        e = _mean_efficiency(data)
    for name, unit in (("voltage", "mV"), ("current", "mA")):
        if name in table.columns_without_unit and e < _MIN_PLAUSIBLE_EFFICIENCY < 1e3 * e < _MAX_PLAUSIBLE_EFFICIENCY:
            notes.append(
                f"{table.headers[name]}: as {SI_UNITS[name]} only {100 * e:.2g} % would be mechanical: taken as {unit}"
            )
            data = replace(data, **{f"{name}_{SI_UNITS[name]}": 1e-3 * getattr(data, f"{name}_{SI_UNITS[name]}")})
            notes[:] = [n for n in notes if not n.startswith(f"{table.headers[name]}: no unit is written")]
            e = _mean_efficiency(data)
    if e < 0:
        against = "the motor delivers no power (torque against speed)"
        raise InputError(table.source, "", against, "give both with the same sign")
    if e > _MAX_PLAUSIBLE_EFFICIENCY:
        # The mistake whose correction restores the balance with the highest efficiency is the most likely.
        mended = [(e * f, name, unit) for name, unit, f in _UNIT_MISTAKES if _MIN_PLAUSIBLE_EFFICIENCY < e * f <= 1.0]
        guess = "check the units"
        if mended:
            best = max(mended, key=lambda m: m[0] if m[1] == "speed" else 0.5 * m[0])
            guess = (
                f"{table.headers[best[1]]} is probably in {best[2]} (efficiency {100 * best[0]:.0f} %): "
                "correct the header, or map it with columns=NAME=COLUMN(unit)"
            )
        much = f"the motor would deliver {e:.3g} times the power that it takes"
        raise InputError(table.source, "", much, guess)
    if e < _MIN_PLAUSIBLE_EFFICIENCY:
        notes.append(
            f"only {100 * e:.2g} % of the electrical power becomes mechanical: unless the motor ran without load, "
            "a unit is wrong (rad/s for rpm, N m for mN m)"
        )
    return data
