"""Limits of an optimisation: ``chord<=25mm``, ``thickness_mm>=0.8``, ``speed_rpm<=7000``.

A limit on something that is searched narrows its range; a limit on something that follows (:data:`DERIVED`) is
checked for every candidate. Both sides of a range are two limits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from mufly.errors import InputError
from mufly.study.parameters import PARAMETERS, parse_quantity

__all__ = ["DERIVED", "RANGES", "Limit", "bounds_of", "parse_limit"]

_DEG = math.pi / 180.0

# Where is searched if nothing else is said (SI).
RANGES: dict[str, tuple[float, float]] = {
    "chord": (0.008, 0.035),
    "twist": (0.0, 20.0 * _DEG),
    "taper": (0.2, 1.5),
    "radius": (0.04, 0.09),
    "hub_cutout": (0.1, 0.35),
    "blades": (2.0, 5.0),
    "pitch": (2.0 * _DEG, 26.0 * _DEG),
}
DERIVED: dict[str, str] = {
    "thickness_mm": "least thickness of the blade along its span",
    "tip_chord_mm": "chord at the tip",
    "solidity": "blade area over disc area",
    "speed_rpm": "rotor speed",
    "motor_current_A": "motor current",
    "gear": "gear ratio",
}


@dataclass(frozen=True)
class Limit:
    """``name`` at least or at most ``value``: SI units for what is searched, the unit in the name for what follows."""

    name: str
    at_least: bool
    value: float

    def breach(self, value: float) -> float:
        """Return by how much a value breaks the limit, relative to the limit; 0 if it does not."""
        short = self.value - value if self.at_least else value - self.value
        return 0.0 if short <= 1e-9 * abs(self.value) else short / (abs(self.value) or 1.0)

    def __str__(self) -> str:
        return f"{self.name} {'>=' if self.at_least else '<='} {self.value:g}"


def parse_limit(text: str) -> Limit:
    """Return a limit from text as ``"thickness_mm>=0.8"`` or ``"radius<=60mm"``.

    Raises
    ------
    InputError
        If it is none, or what it limits is not known.
    """
    match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(.+?)\s*", text)
    if match is None:
        raise InputError(text, "", "is no limit", "write for example thickness_mm>=0.8 or radius<=60mm")
    name, sign, number = match[1], match[2], match[3]
    if name in DERIVED:
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(text, "", f"{number!r} is no number", "give one without a unit") from None
    elif name in RANGES:
        value = float(parse_quantity(name, number))
    else:
        raise InputError(
            text, "", f"{name!r} cannot be limited", f"use one of: {', '.join([*RANGES, *DERIVED])}"
        )
    return Limit(name, sign == ">=", value)


def bounds_of(name: str, limits: Sequence[Limit]) -> tuple[float, float]:
    """Return where a parameter is searched (SI): its range, moved to what the limits say.

    Raises
    ------
    InputError
        If the limits leave nothing.
    """
    low, high = RANGES[name]
    floors = [lim.value for lim in limits if lim.name == name and lim.at_least]
    tops = [lim.value for lim in limits if lim.name == name and not lim.at_least]
    low = max(floors) if floors else min(low, *tops) if tops else low
    high = min(tops) if tops else max(high, low)
    if low > high:
        unit = PARAMETERS[name].unit
        raise InputError("limit", name, f"{low:g} to {high:g} {unit} holds nothing", "widen the limits")
    return low, high
