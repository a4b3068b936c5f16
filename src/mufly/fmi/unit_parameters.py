"""Parameters of a vehicle file that a co-simulation unit offers for change.

A parameter is offered if its effect on the model's record (:class:`mufly.dynamics.ModelParameters`) is one of four
simple ones: a field equals it, is its inverse, is it times a constant, or keeps a ratio to it. The effect is found by
comparing the records of changed vehicles, so that it follows :func:`mufly.dynamics.model_parameters`. Parameters with
other effects, such as the rotor radius, are fixed in the unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import PARAMETER_DTYPE, model_parameters
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle, list_parameters, replace_parameters

EffectKind = Literal["EQUAL", "INVERSE", "SCALED", "RATIO"]

_MODEL_TABLES = (
    "body", "air", "rotors", "swash_plate", "stabiliser_bar", "motor", "gear", "battery", "contact",
)  # fmt: skip
_RATIO_EFFECT_TOLERANCE = 1e-13
_PROBE_FOR_ZERO_VALUE = 2.0**-4


@dataclass(frozen=True)
class ParameterEffect:
    """Effect of a parameter on a field of the flight model's record.

    For the kind ``SCALED`` it is ``field = factor * value``.
    """

    field: str
    kind: EffectKind
    factor: float = 1.0


@dataclass(frozen=True)
class UnitParameter:
    """Parameter of a co-simulation unit: its entry in the vehicle file, its effects, and its limits."""

    key: str
    value: float
    unit: str
    description: str
    effects: tuple[ParameterEffect, ...]
    lowest: float
    highest: float


def list_fmu_parameters(vehicle: Vehicle) -> tuple[list[UnitParameter], list[str]]:
    """Return the parameters that a unit offers, and the keys of those that are fixed in it.

    Keys without effect on the flight model are in neither list. If several parameters change one field, all but one of
    them scale it by their ratio; ratios come last.

    Parameters
    ----------
    vehicle : Vehicle
    """
    listed = [p for p in list_parameters(vehicle) if p.key.partition(".")[0] in _MODEL_TABLES]
    fixed = [p.key for p in listed if not isinstance(p.value, float | int)]
    values = {p.key: float(p.value) for p in listed if p.key not in fixed}
    # Parameters that are zero would hide the effect of others on the same field.
    occupied, start = vehicle, dict(values)
    for key, value in values.items():
        if value == 0.0:
            try:
                occupied = replace_parameters(occupied, {key: _PROBE_FOR_ZERO_VALUE})
                start[key] = _PROBE_FOR_ZERO_VALUE
            except MuflyError:
                fixed.append(key)
    nominal = model_parameters(occupied)
    found = {key: _find_effects(occupied, key, start[key], nominal) for key in values if key not in fixed}
    fixed += [key for key, effects in found.items() if effects is None]
    shared = _convert_to_ratio_effects({key: effects for key, effects in found.items() if effects}, values)
    fixed += [key for key, effects in shared.items() if effects is None]
    offered = []
    for p in listed:
        effects = shared.get(p.key)
        if effects:
            limits = _value_limits(vehicle, p.key)
            offered.append(UnitParameter(p.key, values[p.key], p.unit, p.description, tuple(effects), *limits))
    return offered, fixed


def _find_effects(vehicle: Vehicle, key: str, value: float, nominal: np.void) -> list[ParameterEffect] | None:
    """Return how fields of the flight model's record depend on a parameter, found by changing its value.

    Return None if the vehicle refuses other values, or if a field depends on the parameter in none of the forms of
    :class:`ParameterEffect`.
    """
    # A power of two near the value gives the factor of a product without rounding.
    base = math.copysign(2.0 ** math.floor(math.log2(abs(value))), value)
    points = [(value, nominal)]
    for probe in (base, 1.1875 * base):
        if probe != value:
            try:
                points.append((probe, model_parameters(replace_parameters(vehicle, {key: probe}))))
            except MuflyError:
                return None
    effects = []
    for field in PARAMETER_DTYPE.names or ():
        if all(np.array_equal(record[field], nominal[field]) for _, record in points):
            continue
        effect = _find_parameter_effect(field, base, [(at, np.asarray(record[field])) for at, record in points])
        if effect is None:
            return None
        effects.append(effect)
    return effects


def _convert_to_ratio_effects(
    found: dict[str, list[ParameterEffect]], values: dict[str, float]
) -> dict[str, list[ParameterEffect] | None]:
    """Return ``found``, changed so that the effects of several parameters on one field can be combined.

    The first parameter keeps its effect; those of the others become ratios. A ratio multiplies the field by the new
    value over the nominal value of the parameter. A parameter whose effect cannot be converted gets None.
    """
    out: dict[str, list[ParameterEffect] | None] = dict(found)
    for field in PARAMETER_DTYPE.names or ():
        users = [key for key, effects in found.items() if any(e.field == field for e in effects)]
        users.sort(key=lambda key: (values[key] != 0.0, len(found[key])))  # zero has no ratio; density has many effects
        for key in users:
            (effect,) = (e for e in found[key] if e.field == field)
            can_share = effect.kind in ("SCALED", "RATIO") and values[key] != 0.0
            is_first = key == users[0]
            if not can_share and (effect.kind == "RATIO" or not is_first):
                out[key] = None
            elif not is_first:
                out[key] = [replace(e, kind="RATIO", factor=1.0) if e is effect else e for e in out[key] or []] or None
    return out


def _find_parameter_effect(field: str, base: float, points: list[tuple[float, NDArray[Any]]]) -> ParameterEffect | None:
    """Return the form of a field's dependence that fits all ``points`` (parameter value, field); None if none fits.

    One of the parameter values is ``base``.
    """
    value, before = points[0]
    if before.dtype.kind != "f":
        return None
    if before.ndim == 0:
        if all(after == at for at, after in points):
            return ParameterEffect(field, "EQUAL")
        if all(after == 1.0 / at for at, after in points):
            return ParameterEffect(field, "INVERSE")
        factor = next(float(after) for at, after in points if at == base) / base
        if all(after == at * factor for at, after in points):
            return ParameterEffect(field, "SCALED", factor)
    finite = np.isfinite(before)
    if all(
        np.array_equal(np.isfinite(after), finite)
        and np.allclose(after[finite], before[finite] * (at / value), rtol=_RATIO_EFFECT_TOLERANCE, atol=0.0)
        for at, after in points
    ):
        return ParameterEffect(field, "RATIO")
    return None


def _value_limits(vehicle: Vehicle, key: str) -> tuple[float, float]:
    """Return the least and the greatest value that the vehicle file allows."""
    limits = dict(_schema_limits(vehicle, key))
    low, high = limits.get("at_least", -math.inf), limits.get("at_most", math.inf)
    if "above" in limits:
        low = max(low, math.nextafter(limits["above"], math.inf))
    if "below" in limits:
        high = min(high, math.nextafter(limits["below"], -math.inf))
    return low, high


def _schema_limits(vehicle: Vehicle, key: str) -> Iterator[tuple[str, float]]:
    group: Any = vehicle
    *path, last = key.split(".")
    for part in path:
        group = getattr(group, part)
    extra = type(group).model_fields[last].json_schema_extra or {}
    for name in ("above", "at_least", "below", "at_most"):
        if extra.get(name) is not None:
            yield name, float(extra[name])
