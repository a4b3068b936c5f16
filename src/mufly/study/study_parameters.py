"""Parameters of studies and their notation: ``chord=10:30:5mm``, ``airfoil=goe394,naca4412``.

Numbers are written as in :mod:`mufly.quantities.quantity_grammar`, with their unit. Angles are relative to the plane of
the rotor.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import list_help_text_units, parse_quantity, parse_values
from mufly.quantities.units import find_conversion_factor, split_unit_suffix

ParameterValue = float | str


@dataclass(frozen=True)
class StudyParameterSpec:
    """Parameter that a study can vary.

    Attributes
    ----------
    unit : str
        SI unit of the value; ``"text"`` for names.
    display_unit : str
        Unit of the parameter in tables and plots.
    meaning : str
    is_integer : bool
        True for counts.
    is_positive : bool
        True if the value must be above zero.
    """

    unit: str
    display_unit: str
    meaning: str
    is_integer: bool = False
    is_positive: bool = False

    @property
    def accepted_units(self) -> tuple[str, ...]:
        """Units accepted in texts, the display unit first; ``""`` for a bare number."""
        if self.unit == "text" or self.is_integer:
            return ("",) if self.is_integer else ()
        if self.unit == "1":
            return (self.display_unit, "%" if self.display_unit == "" else "")
        return list_help_text_units(self.display_unit)


GEOMETRY_PARAMETERS: dict[str, StudyParameterSpec] = {
    "blades": StudyParameterSpec("1", "", "number of blades", is_integer=True, is_positive=True),
    "radius": StudyParameterSpec("m", "mm", "radius; chords are unchanged", is_positive=True),
    "chord": StudyParameterSpec("m", "mm", "mean chord; all chords are scaled to it", is_positive=True),
    "taper": StudyParameterSpec(
        "1", "", "tip over hub chord, straight between, blade area unchanged", is_positive=True
    ),
    "twist": StudyParameterSpec("rad", "deg", "twist from hub to tip, straight, zero at the tip"),
    "hub_cutout": StudyParameterSpec("1", "", "radius over R at which the blade begins"),
    "airfoil": StudyParameterSpec("text", "", "airfoil of the whole blade: NACA number, database name or file"),
    "thickness": StudyParameterSpec("1", "%", "thickness over chord of a four-digit NACA section"),
    "camber": StudyParameterSpec("1", "%", "camber over chord of a four-digit NACA section"),
    "camber_position": StudyParameterSpec("1", "%", "position of the camber, x/c, of a four-digit NACA section"),
    "trip_upper": StudyParameterSpec("1", "", "position x/c of a turbulator on the upper side; 1: none"),
    "trip_lower": StudyParameterSpec("1", "", "position x/c of a turbulator on the lower side; 1: none"),
}
OPERATION_PARAMETERS: dict[str, StudyParameterSpec] = {
    "pitch": StudyParameterSpec("rad", "deg", "pitch setting, added to the twist"),
    "speed": StudyParameterSpec("rad/s", "rpm", "rotor speed", is_positive=True),
    "thrust": StudyParameterSpec("N", "N", "thrust, for which the speed is found", is_positive=True),
    "duty": StudyParameterSpec("1", "", "share of the supply voltage at the motor", is_positive=True),
    "climb": StudyParameterSpec("m/s", "m/s", "axial speed, positive in climb"),
    "density": StudyParameterSpec("kg/m3", "kg/m3", "density of the air", is_positive=True),
    "viscosity": StudyParameterSpec("Pa s", "uPa s", "dynamic viscosity of the air", is_positive=True),
    "n_crit": StudyParameterSpec("1", "", "amplification exponent of transition in the polars"),
}
DRIVE_PARAMETERS: dict[str, StudyParameterSpec] = {
    "gear": StudyParameterSpec("1", "", "gear ratio; 'adapted' and 'best' find it for the thrust", is_positive=True),
    "voltage": StudyParameterSpec("V", "V", "supply voltage", is_positive=True),
    "back_emf": StudyParameterSpec("V s", "mV s", "back-EMF constant of the motor", is_positive=True),
    "torque_constant": StudyParameterSpec("N m/A", "mN m/A", "torque constant of the motor", is_positive=True),
    "resistance": StudyParameterSpec("ohm", "ohm", "motor and controller resistance", is_positive=True),
    "friction": StudyParameterSpec("N m s", "uN m s", "viscous friction of the motor"),
    "friction_torque": StudyParameterSpec("N m", "mN m", "constant friction of the motor"),
    "gear_efficiency": StudyParameterSpec("1", "", "efficiency of the gear", is_positive=True),
    "controller_efficiency": StudyParameterSpec("1", "", "efficiency of the speed controller", is_positive=True),
}
ROTOR_PARAMETERS: dict[str, StudyParameterSpec] = {
    **GEOMETRY_PARAMETERS,
    **OPERATION_PARAMETERS,
    **DRIVE_PARAMETERS,
}

# Parameters of a study of a coaxial pair; names shared with single rotors have the same meaning.
PAIR_PARAMETERS: dict[str, StudyParameterSpec] = {
    "spacing": StudyParameterSpec("m", "mm", "distance between the discs", is_positive=True),
    "upper_speed": StudyParameterSpec("rad/s", "rpm", "speed of the upper rotor", is_positive=True),
    "lower_speed": StudyParameterSpec(
        "rad/s", "rpm", "speed of the lower rotor; without it and a ratio, the torques are balanced", is_positive=True
    ),
    "speed_ratio": StudyParameterSpec("1", "", "lower over upper speed", is_positive=True),
    "thrust": StudyParameterSpec(
        "N",
        "N",
        "thrust of the pair, for which both speeds are found, torques balanced",
        is_positive=True,
    ),
    "pitch": StudyParameterSpec("rad", "deg", "pitch setting of both rotors, added to the twist"),
    "upper_pitch": StudyParameterSpec("rad", "deg", "pitch setting of the upper rotor"),
    "lower_pitch": StudyParameterSpec("rad", "deg", "pitch setting of the lower rotor"),
    **{
        f"{side}_{name}": StudyParameterSpec(
            p.unit, p.display_unit, f"{side} rotor: {p.meaning}", is_positive=p.is_positive
        )
        for side in ("upper", "lower")
        for name, p in GEOMETRY_PARAMETERS.items()
        if name in ("chord", "taper", "twist")
    },
    **{name: OPERATION_PARAMETERS[name] for name in ("climb", "density", "n_crit")},
}


def find_parameter(name: str) -> StudyParameterSpec:
    """Return a parameter of a rotor or of a pair by name."""
    return ROTOR_PARAMETERS[name] if name in ROTOR_PARAMETERS else PAIR_PARAMETERS[name]


def find_parameter_in_table(
    name: str, where: str, table: Mapping[str, StudyParameterSpec] = ROTOR_PARAMETERS
) -> StudyParameterSpec:
    """Return a parameter by name.

    Raises
    ------
    InputError
        If there is no such parameter.
    """
    if name not in table:
        raise InputError(where, "", f"{name!r} cannot be varied or set", suggest_name(name, table))
    return table[name]


def parse_parameter_value(
    name: str, text: str, table: Mapping[str, StudyParameterSpec] = ROTOR_PARAMETERS
) -> ParameterValue:
    """Return one value in SI units from a text such as ``"12deg"``.

    Raises
    ------
    InputError
        If the parameter or its unit is unknown or the text is not one value.
    """
    values = parse_parameter_and_values(f"{name}={text}", table)[1]
    if len(values) != 1:
        raise InputError(f"{name}={text}", "", f"{len(values)} values where one is wanted", "give one value")
    return values[0]


def parse_parameter_and_values(
    text: str, table: Mapping[str, StudyParameterSpec] = ROTOR_PARAMETERS
) -> tuple[str, tuple[ParameterValue, ...]]:
    """Return name and values (SI) from a text such as ``"chord=10:30:5mm"``; ``table`` lists the known parameters.

    Raises
    ------
    InputError
        If the text is not ``name=values``, or the parameter, its unit or its values are wrong.
    """
    name, equals, listed = (part.strip() for part in text.partition("="))
    if not equals or not listed:
        raise InputError(text, "", "is not NAME=VALUES", "write for example chord=10:30:5mm")
    p = find_parameter_in_table(name, text, table)
    if p.unit == "text":
        return name, tuple(part.strip() for part in listed.split(",") if part.strip())
    if name == "gear" and listed in ("adapted", "best"):
        return name, (listed,)
    values = parse_values(text, listed, p.unit, bare=False)
    for value in values:
        if p.is_integer and value != round(value):
            raise InputError(text, "", f"{name} {value:g} is not a whole number", "give a whole number")
        if p.is_positive and not value > 0:
            raise InputError(text, "", f"{name} {value:g} is out of range", "give a number above 0")
    return name, values


def parse_parameter_settings(
    texts: Iterable[str], table: Mapping[str, StudyParameterSpec] = ROTOR_PARAMETERS
) -> dict[str, tuple[ParameterValue, ...]]:
    """Return ``{name: values}`` from several texts as for :func:`parse_parameter_and_values`.

    Raises
    ------
    InputError
        As :func:`parse_parameter_and_values`, or if a parameter is named twice.
    """
    settings: dict[str, tuple[ParameterValue, ...]] = {}
    for text in texts:
        name, values = parse_parameter_and_values(text, table)
        if name in settings:
            raise InputError(text, "", f"{name} is given twice", "give all its values in one --vary")
        settings[name] = values
    return settings


def to_display_unit(name: str, values: Iterable[ParameterValue]) -> tuple[np.ndarray, str]:
    """Return values in the parameter's display unit, and that unit."""
    p = find_parameter(name)
    listed = list(values)
    if p.unit == "text" or any(isinstance(v, str) for v in listed):
        return np.array([str(v) for v in listed]), ""
    return np.round(
        np.array(listed, dtype=np.float64) / find_conversion_factor(p.display_unit or "1", p.unit), 9
    ), p.display_unit


def format_parameter_value(name: str, value: ParameterValue, form: str = "g") -> str:
    """Return a parameter's value with its unit as text to print."""
    values, unit = to_display_unit(name, [value])
    return f"{values[0]:{form}} {unit}".strip() if values.dtype.kind == "f" else str(values[0])


# ----------------------------------------------------------------------------
# Limits of an optimisation: ``chord<=25mm``, ``thickness_mm>=0.8``, ``speed_rpm<=7000``.
#
# A limit on a searched parameter narrows its range; a limit on a derived quantity (:data:`DERIVED_LIMITS`) is checked
# for every candidate. A range has two limits.


_DEGREE_RAD = math.pi / 180.0

# Default search ranges (SI).
SEARCH_RANGES: dict[str, tuple[float, float]] = {
    "chord": (0.008, 0.035),
    "twist": (0.0, 20.0 * _DEGREE_RAD),
    "taper": (0.2, 1.5),
    "radius": (0.04, 0.09),
    "hub_cutout": (0.1, 0.35),
    "blades": (2.0, 5.0),
    "pitch": (2.0 * _DEGREE_RAD, 26.0 * _DEGREE_RAD),
}
DERIVED_LIMITS: dict[str, str] = {
    "thickness_mm": "least thickness of the blade along its span",
    "tip_chord_mm": "chord at the tip",
    "solidity": "blade area over disc area",
    "speed_rpm": "rotor speed",
    "motor_current_A": "motor current",
    "gear": "gear ratio",
}


@dataclass(frozen=True)
class DesignLimit:
    """Limit: ``name`` is at least or at most ``value``.

    The value is in SI for a searched parameter, else in the unit that the name states.
    """

    name: str
    is_lower_bound: bool
    value: float

    def relative_violation(self, value: float) -> float:
        """Return the violation of the limit by a value, relative to the limit; 0 if there is none."""
        short = self.value - value if self.is_lower_bound else value - self.value
        return 0.0 if short <= 1e-9 * abs(self.value) else short / (abs(self.value) or 1.0)

    def __str__(self) -> str:
        return f"{self.name} {'>=' if self.is_lower_bound else '<='} {self.value:g}"


def parse_design_limit(text: str) -> DesignLimit:
    """Return a limit from a text such as ``"thickness_mm>=0.8"`` or ``"radius<=60mm"``.

    Raises
    ------
    InputError
        If the text is no limit, or the limited quantity is unknown.
    """
    match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(.+?)\s*", text)
    if match is None:
        raise InputError(text, "", "is not a limit", "write for example thickness_mm>=0.8 or radius<=60mm")
    name, sign, number = match.groups()
    if name in DERIVED_LIMITS:
        value = parse_quantity(text, number, split_unit_suffix(name)[1] or "1")
    elif name in SEARCH_RANGES:
        value = float(parse_parameter_value(name, number))
    else:
        raise InputError(text, "", f"{name!r} cannot be limited", suggest_name(name, [*SEARCH_RANGES, *DERIVED_LIMITS]))
    return DesignLimit(name, sign == ">=", value)


def parameter_search_bounds(name: str, limits: Sequence[DesignLimit]) -> tuple[float, float]:
    """Return the search range of a parameter (SI), narrowed by the limits.

    Raises
    ------
    InputError
        If the range is empty.
    """
    low, high = SEARCH_RANGES[name]
    floors = [lim.value for lim in limits if lim.name == name and lim.is_lower_bound]
    tops = [lim.value for lim in limits if lim.name == name and not lim.is_lower_bound]
    low = max(floors) if floors else min(low, *tops) if tops else low
    high = min(tops) if tops else max(high, low)
    if low > high:
        unit = ROTOR_PARAMETERS[name].unit
        raise InputError(
            "limit", name, f"{low:g} to {high:g} {unit} is an empty range", "give limits that leave a range"
        )
    return low, high
