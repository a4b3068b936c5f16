"""Names and units of the columns of a bench file: what ``torque_mNm``, ``T_A (N)`` or ``RPM`` stand for.

A header is a name and a unit, in brackets or after the last underscore: ``current_A``, ``Current [mA]``, ``Q(Nm)``.
The name may carry the rotor (``upper`` or ``lower``), and ``raw`` for the reading of a sensor that is still to be
calibrated: ``thrust_upper_N``, ``torque_raw_V``. Capitals do not matter.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from mufly.errors import InputError

__all__ = ["QUANTITIES", "SI_UNITS", "Column", "parse_header", "renamed"]

_RPM = math.pi / 30.0

QUANTITIES: dict[str, tuple[tuple[str, ...], dict[str, float]]] = {
    # quantity: its names; its units (in lower case) and what one of them is in SI, the SI unit first
    "voltage": (("voltage", "u", "v", "volts", "supply_voltage", "motor_voltage"), {"v": 1.0, "mv": 1e-3}),
    "duty": (("duty", "pwm", "throttle", "motor_input"), {"1": 1.0, "%": 1e-2, "percent": 1e-2}),
    "current": (("current", "i", "motor_current", "amps"), {"a": 1.0, "ma": 1e-3}),
    "supply_current": (("supply_current", "battery_current"), {"a": 1.0, "ma": 1e-3}),
    "speed": (
        ("speed", "rpm", "omega", "rotor_speed", "motor_speed", "w"),
        {"rad/s": 1.0, "rad_s": 1.0, "rads": 1.0, "rpm": _RPM, "1/min": _RPM, "rps": 2 * math.pi, "hz": 2 * math.pi},
    ),
    "torque": (
        ("torque", "q", "moment", "load"),
        {"nm": 1.0, "n m": 1.0, "mnm": 1e-3, "mn m": 1e-3, "nmm": 1e-3, "n mm": 1e-3, "ncm": 1e-2, "n cm": 1e-2},
    ),
    "thrust": (
        ("thrust", "t", "force", "lift", "t_meas"),
        {"n": 1.0, "mn": 1e-3, "gf": 9.80665e-3, "g": 9.80665e-3, "kgf": 9.80665, "kg": 9.80665},
    ),
    "power": (("power", "p"), {"w": 1.0, "mw": 1e-3}),
    "pitch": (("pitch", "blade_pitch"), {"rad": 1.0, "deg": math.pi / 180.0}),
    "time": (("time", "t_s", "seconds"), {"s": 1.0, "ms": 1e-3, "min": 60.0}),
    "run": (("run", "series", "test", "repeat"), {"1": 1.0}),
    "density": (("density", "rho", "air_density"), {"kg/m3": 1.0, "kg_m3": 1.0}),
    "temperature": (("temperature", "temp"), {"degc": 1.0, "c": 1.0, "k": 1.0}),
    "pressure": (("pressure",), {"pa": 1.0, "hpa": 100.0, "mbar": 100.0, "kpa": 1000.0}),
}  # fmt: skip
SI_UNITS = {
    "voltage": "V", "duty": "1", "current": "A", "supply_current": "A", "speed": "rad/s", "torque": "N m",
    "thrust": "N", "power": "W", "pitch": "rad", "time": "s", "run": "1", "density": "kg/m3", "temperature": "degC",
    "pressure": "Pa",
}  # fmt: skip

_SIDES = {"upper": "upper", "up": "upper", "top": "upper", "lower": "lower", "dw": "lower", "low": "lower",
          "down": "lower", "bottom": "lower"}  # fmt: skip
_BRACKETS = re.compile(r"^(.*?)\s*[\(\[]\s*([^\)\]]*?)\s*[\)\]]$")
_NEEDS_NO_UNIT = ("duty", "run")
_OWN_UNIT = {"rpm": "rpm", "omega": "rad/s"}


@dataclass(frozen=True)
class Column:
    """What a header means.

    Attributes
    ----------
    name : str
        Quantity, with ``_upper`` or ``_lower`` and ``_raw`` where the header says so: ``"torque_lower_raw"``.
    factor, offset : float
        SI value = factor * written value + offset.
    unit : str
        As written, ``""`` if the header has none.
    """

    name: str
    factor: float
    unit: str
    offset: float = 0.0

    @property
    def quantity(self) -> str:
        """The quantity without rotor and ``_raw``."""
        return re.sub(r"(_upper|_lower)?(_raw)?$", "", self.name)


def parse_header(header: str) -> Column | None:
    """Return what one header means, None if it is no quantity of a bench.

    Examples: ``"torque_mNm"``, ``"T(N)"``, ``"RPM"``, ``"speed_upper_rpm"``, ``"thrust_raw_mV"``.
    """
    text = " ".join(header.strip().lower().split())
    match = _BRACKETS.match(text)
    whole = match[1] if match else text
    candidates = [(whole, match[2])] if match else [(whole, "")]
    if not match:
        parts = whole.split("_")
        # The unit may hold an underscore itself (rad_s), so one and two last parts are tried, longest first.
        candidates = [
            ("_".join(parts[:-k]), "_".join(parts[-k:])) for k in (2, 1) if len(parts) > k
        ] + candidates
    for name, unit in candidates:
        found = _named(name, unit)
        if found is not None:
            return found
    return None


def _named(name: str, unit: str) -> Column | None:
    words = [w for w in re.split(r"[_\s]+", name) if w]
    raw = "raw" in words
    side = next((_SIDES[w] for w in words if w in _SIDES), "")
    stem = "_".join(w for w in words if w != "raw" and w not in _SIDES)
    for quantity, (names, units) in QUANTITIES.items():
        if stem not in names:
            continue
        full = quantity + (f"_{side}" if side else "") + ("_raw" if raw else "")
        if raw:
            return Column(full, 1.0, unit)
        own = _OWN_UNIT.get(stem, "")
        if unit == "" and (own or quantity in _NEEDS_NO_UNIT):
            return Column(full, units[own] if own else 1.0, own or "1")
        if unit == "":
            return Column(full, 1.0, "")
        if unit in units:
            offset = -273.15 if quantity == "temperature" and unit == "k" else 0.0
            return Column(full, units[unit], unit, offset)
    return None


def renamed(headers: list[str], columns: str | None, where: str) -> list[str]:
    """Apply a user's map ``"T_A(N)=thrust_lower_N,RPM=speed_lower_rpm"`` to headers.

    Raises
    ------
    InputError
        If the map names a column that is not there, is no map, or its right side is no known quantity.
    """
    result = list(headers)
    for part in (columns or "").split(","):
        if not part.strip():
            continue
        old, equals, new = (t.strip() for t in part.partition("="))
        if not equals or not old or not new:
            raise InputError(
                "--columns", part.strip(), "is no OLD=NEW", "write --columns 'RPM=speed_upper_rpm'"
            )
        if old not in headers:
            raise InputError(where, old, "is not among the columns", f"the header is {', '.join(headers)}")
        if parse_header(new) is None:
            raise InputError(
                "--columns",
                new,
                "is no quantity with a unit",
                f"use one of {', '.join(QUANTITIES)} with its unit",
            )
        result[headers.index(old)] = new
    return result
