"""From a bench file to the four readings of a motor, checked: columns, constant channels, mistaken units.

Mistaken units break the balance of energy: over all points ``sum Q W`` cannot exceed ``sum U I``. Where it does, the
usual slips (rpm for rad/s, mN m for N m) are tried, and the one that mends it is named; where the file does not state
the unit of the speed, it is taken.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.bench import BenchTable
from mufly.errors import InputError

__all__ = ["CHANNELS", "MotorData", "motor_data"]

Array = NDArray[np.float64]

CHANNELS = ("voltage", "current", "speed", "torque")
_RPM = math.pi / 30.0
_SLIPS = {
    "speed": (("rpm", _RPM), ("revolutions a second", 2 * math.pi)),
    "torque": (("mN m", 1e-3), ("N cm", 1e-2)),
    "current": (("mA", 1e-3),),
    "voltage": (("mV", 1e-3),),
}
_POOR, _MOST = 0.02, 1.02  # efficiency below which units are doubtful, and above which they are wrong


@dataclass(frozen=True, eq=False)
class MotorData:
    """Stationary points of a motor, arrays (n,): voltage at the motor, its current, speed and torque, and the run."""

    voltage_V: Array
    current_A: Array
    speed_rad_s: Array
    torque_Nm: Array
    run: NDArray[np.int64]

    def channels(self) -> tuple[Array, Array, Array, Array]:
        """Return voltage, current, speed, torque."""
        return self.voltage_V, self.current_A, self.speed_rad_s, self.torque_Nm


def motor_data(table: BenchTable) -> tuple[MotorData, list[str]]:
    """Return the readings of a motor bench and notes on what was guessed.

    Raises
    ------
    InputError
        If a column is missing, constant, or its unit cannot be right.
    """
    notes = list(table.notes)
    table.require(("voltage", "speed", "torque"))
    voltage = table["voltage"]
    if "duty" in table:
        table.require(("duty",))
        duty = table["duty"]
        outside = np.flatnonzero((duty < 0) | (duty > 1))
        if outside.size:
            raise InputError(
                table.source, f"line {table.line[outside[0]]}, {table.headers['duty']}",
                f"{duty[outside[0]]:g} is no share of the voltage", "give duty from 0 to 1, or duty_% up to 100",
            )  # fmt: skip
        voltage = duty * voltage
        notes.append("voltage at the motor = duty * voltage")
    if "current" in table or "supply_current" not in table:
        table.require(("current",))
        current = table["current"]
    elif "duty" in table:
        table.require(("supply_current",))
        if np.any(table["duty"] == 0):
            raise InputError(table.source, table.headers["duty"], "is 0 in a line", "leave that line out")
        current = table["supply_current"] / table["duty"]
        notes.append("motor current = supply current / duty (mean of the chopped current)")
    else:
        raise InputError(
            table.source, table.headers["supply_current"], "is not the motor's current", "add the column duty"
        )
    turning = (np.abs(table["speed"]) > 0) | (np.abs(current) > 0)
    if not turning.all():
        notes.append(f"{int(np.sum(~turning))} lines without speed and current are left out")
    run = table["run"].astype(np.int64) if "run" in table else np.zeros(len(table), dtype=np.int64)
    data = {"voltage": voltage, "current": current, "speed": table["speed"], "torque": table["torque"]}
    data = {k: v[turning] for k, v in data.items()}
    _check_varied(table, data)
    data = _check_units(table, data, notes)
    return MotorData(data["voltage"], data["current"], data["speed"], data["torque"], run[turning]), notes


def _check_varied(table: BenchTable, data: dict[str, Array]) -> None:
    for name in ("current", "speed"):
        v = data[name]
        size = float(np.max(np.abs(v), initial=0.0))
        if v.size and float(np.ptp(v)) <= 1e-3 * size:
            header = table.headers.get(name, name)
            raise InputError(
                table.source,
                header,
                f"is constant ({v[0]:.4g} in SI units)",
                "vary the load or the voltage between lines",
            )
    if data["torque"].size and not np.any(data["torque"]):
        raise InputError(
            table.source, table.headers["torque"], "is zero in every line",
            "load the motor: without load only the ratio of dR and kM is seen",
        )  # fmt: skip


def _efficiency(data: dict[str, Array]) -> float:
    electrical = float(np.sum(data["voltage"] * data["current"]))
    return float(np.sum(data["torque"] * data["speed"])) / electrical if electrical > 0 else math.inf


def _check_units(table: BenchTable, data: dict[str, Array], notes: list[str]) -> dict[str, Array]:
    e = _efficiency(data)
    if "speed" in table.unitless:
        unit, factor = ("rpm", _RPM) if e > 0.95 else ("rad/s", 1.0)
        notes.append(
            f"speed has no unit: taken as {unit}, with which {100 * e * factor:.0f} % of the electrical power comes "
            "out as mechanical power"
        )
        data = {**data, "speed": data["speed"] * factor}
        e = _efficiency(data)
    if e < 0:
        raise InputError(
            table.source,
            "",
            "the motor delivers no power (torque against speed)",
            "give both with the same sign",
        )
    if e > _MOST:
        # The slip that mends the balance and leaves the most power is the likeliest.
        mended = [
            (e * f, name, unit)
            for name, slips in _SLIPS.items()
            for unit, f in slips
            if name in ("speed", "torque") and _POOR < e * f <= 1.0
        ]
        guess = "check the units"
        if mended:
            best = max(mended, key=lambda m: m[0] if m[1] == "speed" else 0.5 * m[0])
            guess = (
                f"{table.headers[best[1]]} is probably in {best[2]} (efficiency {100 * best[0]:.0f} %): "
                "correct the header, or map it with --columns"
            )
        raise InputError(
            table.source, "", f"the motor would deliver {e:.3g} times the power that it takes", guess
        )
    if e < _POOR:
        notes.append(
            f"only {100 * e:.2g} % of the electrical power comes out: unless the motor ran without load, a unit is "
            "wrong (rad/s for rpm, N m for mN m)"
        )
    return data
