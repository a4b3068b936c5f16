"""A parameter as a vehicle file states it: value, unit and where the number came from.

In a file::

    mass = { value = 95, unit = "g", source = "measured", note = "on a scale" }

Values are converted to SI when the file is read; the unit must be given, so that no number is ever guessed at.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

__all__ = ["Curve", "Group", "Points", "Quantity", "parameter"]

Source = Literal["measured", "CAD", "datasheet", "estimated", "identified", "specified"]

# Accepted spellings of each SI unit, and what one of them is in SI.
UNITS: dict[str, dict[str, float]] = {
    "kg": {"kg": 1.0, "g": 1e-3},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "m2": {"m2": 1.0, "cm2": 1e-4, "mm2": 1e-6},
    "s": {"s": 1.0, "ms": 1e-3},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "kg m2": {"kg m2": 1.0, "g cm2": 1e-7},
    "kg/m3": {"kg/m3": 1.0},
    "N": {"N": 1.0, "mN": 1e-3},
    "N/m": {"N/m": 1.0},
    "N s/m": {"N s/m": 1.0},
    "N m s": {"N m s": 1.0},
    "N m/A": {"N m/A": 1.0, "mN m/A": 1e-3},
    "V s": {"V s": 1.0, "mV s": 1e-3},
    "V": {"V": 1.0},
    "A": {"A": 1.0, "mA": 1e-3},
    "A s": {"A s": 1.0, "A h": 3600.0, "mA h": 3.6},
    "ohm": {"ohm": 1.0, "mohm": 1e-3},
    "m/s": {"m/s": 1.0},
    "1": {"1": 1.0, "%": 1e-2},
}


_ABSURD = 1e9  # no parameter of a vehicle is as large in SI units; powers of larger ones overflow


def _fault(problem: str, remedy: str) -> PydanticCustomError:
    return PydanticCustomError(
        "mufly", "{problem}; {remedy}", {"problem": problem, "remedy": remedy}
    )  # fmt: skip


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Quantity(_Frozen):
    """One number with its unit and provenance. ``float(quantity)`` is the SI value."""

    value: float
    unit: str
    source: Source
    note: str = ""

    def __float__(self) -> float:
        return self.value


class Points(_Frozen):
    """Points in body axes (x forward, y right, z down from the centre of gravity)."""

    value: tuple[tuple[float, float, float], ...]
    unit: str
    source: Source
    note: str = ""

    def array(self) -> NDArray[np.float64]:
        """Return the points as an (n, 3) array in SI units."""
        return np.array(self.value, dtype=np.float64).reshape(-1, 3)


class Curve(_Frozen):
    """A quantity tabulated over a fraction that rises from 0 to 1."""

    fraction: tuple[float, ...]
    value: tuple[float, ...]
    unit: str
    source: Source
    note: str = ""

    def sample(self, n: int) -> NDArray[np.float64]:
        """Return ``n`` values at equal steps of the fraction, interpolated linearly."""
        return np.interp(np.linspace(0.0, 1.0, n), self.fraction, self.value)


def parameter(
    unit: str,
    symbol: str,
    description: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
) -> Any:
    """Declare a parameter of a vehicle: its SI unit, symbol, meaning and the values that make sense."""
    limits = {"above": above, "at_least": at_least, "below": below, "at_most": at_most}
    return Field(
        description=description,
        json_schema_extra={"unit": unit, "symbol": symbol, **limits},
    )


def _in_words(limits: dict[str, Any]) -> str:
    words = {"above": "above", "at_least": "at least", "below": "below", "at_most": "at most"}
    return " and ".join(f"{words[k]} {limits[k]:g}" for k in words if limits.get(k) is not None)


def _check_limits(value: float, unit: str, limits: dict[str, Any]) -> None:
    wrong = (
        not abs(value) < _ABSURD
        or (limits.get("above") is not None and not value > limits["above"])
        or (limits.get("at_least") is not None and not value >= limits["at_least"])
        or (limits.get("below") is not None and not value < limits["below"])
        or (limits.get("at_most") is not None and not value <= limits["at_most"])
    )
    if wrong:
        wanted = "of ordinary size" if abs(value) >= _ABSURD else _in_words(limits) or "that is finite"
        raise _fault(f"{value:g} {unit} is not possible", f"give a value {wanted} ({unit})")


def _scaled(value: Any, factor: float) -> Any:
    if isinstance(value, list | tuple):
        return [_scaled(v, factor) for v in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _fault(f"{value!r} is not a number", "give a number")
    try:
        return float(value) * factor
    except OverflowError:
        raise _fault("a whole number of more than 300 digits", "give a value of ordinary size") from None


def _flat(value: Any) -> list[float]:
    return [x for v in value for x in _flat(v)] if isinstance(value, list) else [value]


class Group(_Frozen):
    """A named group of parameters. Converts what the file says to SI and checks it against the declaration."""

    @field_validator("*", mode="before")
    @classmethod
    def _to_si(cls, raw: Any, info: ValidationInfo) -> Any:
        declared = cls.model_fields[str(info.field_name)].json_schema_extra
        if not isinstance(declared, dict) or "unit" not in declared or isinstance(raw, _Frozen):
            return raw
        si = str(declared["unit"])
        example = f'{{ value = ..., unit = "{si}", source = "measured" }}'
        if not isinstance(raw, dict):
            raise _fault(f"{raw!r} has no unit and no source", f"write {info.field_name} = {example}")
        if "unit" not in raw:
            raise _fault("the unit is missing", f"write {info.field_name} = {example}")
        if not isinstance(raw["unit"], str) or raw["unit"] not in UNITS[si]:
            accepted = ", ".join(UNITS[si])
            raise _fault(f"unit {raw['unit']!r} does not fit here", f"use one of: {accepted}")
        if "value" not in raw:
            raise _fault("the value is missing", f"write {info.field_name} = {example}")
        value = _scaled(raw["value"], UNITS[si][raw["unit"]])
        for v in _flat(value):
            _check_limits(v, si, declared)
        return {**raw, "value": value, "unit": si}
