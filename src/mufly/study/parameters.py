"""What a study can vary, and how a command line writes it: ``chord=10:30:5mm``, ``airfoil=goe394,naca4412``.

A range is ``first:last:step`` (the last value included when the steps meet it), a list is separated by commas,
and the unit follows the last number. Angles are against the plane of the rotor.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mufly.errors import InputError

__all__ = ["PARAMETERS", "Parameter", "Value", "parse_quantity", "parse_settings", "parse_values"]

Value = float | str

_RPM = math.pi / 30.0
_LENGTH = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_ANGLE = {"deg": math.pi / 180.0, "rad": 1.0}
_SPEED = {"rpm": _RPM, "rad/s": 1.0}
_RATIO = {"": 1.0, "%": 1e-2}
_MOST_VALUES = 100_000


@dataclass(frozen=True)
class Parameter:
    """One thing that a study can vary.

    Attributes
    ----------
    unit : str
        SI unit of the value; ``"text"`` for names.
    units : dict
        Accepted spellings, and what one of them is in SI; the first is the one that plots use.
    meaning : str
    whole : bool
        True for counts.
    positive : bool
        True if the value has to be above zero.
    """

    unit: str
    units: Mapping[str, float]
    meaning: str
    whole: bool = False
    positive: bool = False


GEOMETRY: dict[str, Parameter] = {
    "blades": Parameter("1", {"": 1.0}, "number of blades", whole=True, positive=True),
    "radius": Parameter("m", _LENGTH, "radius; chords stay as they are", positive=True),
    "chord": Parameter("m", _LENGTH, "mean chord; all chords are scaled to it", positive=True),
    "taper": Parameter(
        "1", _RATIO, "tip over hub chord, straight between, blade area unchanged", positive=True
    ),
    "twist": Parameter("rad", _ANGLE, "twist from hub to tip, straight, zero at the tip"),
    "hub_cutout": Parameter("1", _RATIO, "radius over R at which the blade begins"),
    "airfoil": Parameter("text", {}, "airfoil of the whole blade: NACA number, database name or file"),
    "thickness": Parameter("1", {"%": 1e-2, "": 1.0}, "thickness over chord of a four-digit NACA section"),
    "camber": Parameter("1", {"%": 1e-2, "": 1.0}, "camber over chord of a four-digit NACA section"),
    "camber_position": Parameter(
        "1", {"%": 1e-2, "": 1.0}, "place of the camber, x/c, of a four-digit NACA section"
    ),
}
OPERATION: dict[str, Parameter] = {
    "pitch": Parameter("rad", _ANGLE, "pitch setting, added to the twist"),
    "speed": Parameter("rad/s", _SPEED, "rotor speed", positive=True),
    "thrust": Parameter("N", {"N": 1.0, "mN": 1e-3}, "thrust, for which the speed is found", positive=True),
    "duty": Parameter("1", _RATIO, "share of the supply voltage at the motor", positive=True),
    "climb": Parameter("m/s", {"m/s": 1.0}, "axial speed, positive in climb"),
    "density": Parameter("kg/m3", {"kg/m3": 1.0}, "density of the air", positive=True),
    "viscosity": Parameter(
        "Pa s", {"uPa s": 1e-6, "Pa s": 1.0}, "dynamic viscosity of the air", positive=True
    ),
    "n_crit": Parameter("1", {"": 1.0}, "amplification exponent of transition in the polars"),
}
DRIVE: dict[str, Parameter] = {
    "gear": Parameter(
        "1", {"": 1.0}, "gear ratio; 'adapted' and 'best' find it for the thrust", positive=True
    ),
    "voltage": Parameter("V", {"V": 1.0}, "supply voltage", positive=True),
    "back_emf": Parameter("V s", {"mV s": 1e-3, "V s": 1.0}, "back-EMF constant of the motor", positive=True),
    "torque_constant": Parameter(
        "N m/A", {"mN m/A": 1e-3, "N m/A": 1.0}, "torque constant of the motor", positive=True
    ),
    "resistance": Parameter(
        "ohm", {"ohm": 1.0, "mohm": 1e-3}, "motor and controller resistance", positive=True
    ),
    "friction": Parameter("N m s", {"uN m s": 1e-6, "N m s": 1.0}, "viscous friction of the motor"),
    "gear_efficiency": Parameter("1", _RATIO, "efficiency of the gear", positive=True),
    "controller_efficiency": Parameter("1", _RATIO, "efficiency of the speed controller", positive=True),
}
PARAMETERS: dict[str, Parameter] = {**GEOMETRY, **OPERATION, **DRIVE}

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def parameter(name: str, where: str) -> Parameter:
    """Return a parameter by name.

    Raises
    ------
    InputError
        If there is none.
    """
    if name not in PARAMETERS:
        near = difflib.get_close_matches(name, PARAMETERS, n=1)
        remedy = f"did you mean {near[0]!r}?" if near else f"use one of: {', '.join(PARAMETERS)}"
        raise InputError(where, "", f"{name!r} cannot be varied or set", remedy)
    return PARAMETERS[name]


def _split_unit(text: str, where: str) -> tuple[str, str]:
    match = re.fullmatch(rf"\s*((?:{_NUMBER}[\s,:]*)+)(.*?)\s*", text)
    if match is None:
        raise InputError(where, "", f"{text!r} is no number", "write for example 10:30:5mm or 10,15,20mm")
    return match[1].strip(), match[2]


def _factor(name: str, unit: str, where: str) -> float:
    units = PARAMETERS[name].units
    if unit not in units:
        accepted = ", ".join(u or "none" for u in units)
        problem = f"{name} has no unit" if not unit else f"{name} is not measured in {unit!r}"
        raise InputError(where, "", problem, f"use one of: {accepted}")
    return units[unit]


def parse_quantity(name: str, text: str) -> Value:
    """Return one value in SI units from text as ``"12deg"``.

    Raises
    ------
    InputError
        If the parameter or its unit is unknown or the text is not one value.
    """
    values = parse_values(f"{name}={text}")[1]
    if len(values) != 1:
        raise InputError(f"{name}={text}", "", f"{len(values)} values where one is wanted", "give one value")
    return values[0]


def parse_values(text: str) -> tuple[str, tuple[Value, ...]]:
    """Return name and values, in SI units, of text as ``"chord=10:30:5mm"``.

    Raises
    ------
    InputError
        If the text is not ``name=values``, or the parameter, its unit or its values are wrong.
    """
    name, equals, listed = (part.strip() for part in text.partition("="))
    if not equals or not listed:
        raise InputError(text, "", "is not NAME=VALUES", "write for example chord=10:30:5mm")
    p = parameter(name, text)
    if p.unit == "text":
        return name, tuple(part.strip() for part in listed.split(",") if part.strip())
    if name == "gear" and listed in ("adapted", "best"):
        return name, (listed,)
    numbers, unit = _split_unit(listed, text)
    factor = _factor(name, unit, text)
    values: list[float] = []
    for part in numbers.split(","):
        parts = [float(x) for x in part.split(":")] if part.strip() else []
        if len(parts) == 1:
            values += parts
        elif len(parts) in (2, 3):
            values += _range(parts, text)
        else:
            raise InputError(text, "", f"{part!r} is no range", "write first:last:step")
    return name, tuple(_checked(name, p, v, factor, text) for v in values)


def _range(parts: list[float], where: str) -> list[float]:
    first, last, step = (*parts, 1.0)[:3]
    if step <= 0 or last < first:
        raise InputError(
            where, "", f"{first:g}:{last:g}:{step:g} holds no value", "let it rise by a step above 0"
        )
    count = math.floor((last - first) / step + 1e-9) + 1
    if count > _MOST_VALUES:
        raise InputError(where, "", f"{count} values", f"take larger steps ({_MOST_VALUES} values at most)")
    return [round(first + k * step, 12) for k in range(count)]


def _checked(name: str, p: Parameter, value: float, factor: float, where: str) -> float:
    si = value * factor
    if p.whole and value != round(value):
        raise InputError(where, "", f"{name} {value:g} is no whole number", "give a whole number")
    if p.positive and not si > 0:
        raise InputError(where, "", f"{name} {value:g} is not possible", "give a number above 0")
    if not math.isfinite(si):
        raise InputError(where, "", f"{name} is not finite", "give a finite number")
    return si


def parse_settings(texts: Iterable[str]) -> dict[str, tuple[Value, ...]]:
    """Return ``{name: values}`` of several texts as :func:`parse_values` reads them.

    Raises
    ------
    InputError
        As :func:`parse_values`, and if a parameter is named twice.
    """
    settings: dict[str, tuple[Value, ...]] = {}
    for text in texts:
        name, values = parse_values(text)
        if name in settings:
            raise InputError(text, "", f"{name} is given twice", "give all its values at once")
        settings[name] = values
    return settings


def in_unit(name: str, values: Iterable[Value]) -> tuple[np.ndarray, str]:
    """Return values for reading, in the parameter's first unit, and that unit."""
    p = PARAMETERS[name]
    listed = list(values)
    if p.unit == "text" or any(isinstance(v, str) for v in listed):
        return np.array([str(v) for v in listed]), ""
    unit = next(iter(p.units))
    return np.round(np.array(listed, dtype=np.float64) / p.units[unit], 9), unit
