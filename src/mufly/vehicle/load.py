"""From a vehicle file (TOML) to a checked :class:`Vehicle`, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w
from pydantic import BaseModel

from mufly.errors import InputError
from mufly.tables import builtin_names, read_tables, validated
from mufly.vehicle.coefficient_map import named_maps
from mufly.vehicle.quantity import Curve, Points, Quantity
from mufly.vehicle.schema import Vehicle

__all__ = [
    "Parameter",
    "builtin_vehicles",
    "load_vehicle",
    "parameters",
    "replace",
    "vehicle_toml",
]

_BUILTIN = resources.files("mufly.vehicle") / "builtin"


class Parameter(NamedTuple):
    """One row of a vehicle's parameter table; ``value`` is in SI units."""

    key: str
    symbol: str
    value: Any
    unit: str
    source: str
    description: str
    note: str


def builtin_vehicles() -> list[str]:
    """Return the names of the vehicles that come with mufly."""
    return builtin_names(_BUILTIN)


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle by built-in name or from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`builtin_vehicles` lists, or the path of a vehicle file.

    Returns
    -------
    Vehicle
        Frozen and checked; all values in SI units.

    Raises
    ------
    InputError
        If there is no such vehicle, the file is not TOML, or a parameter is missing, unknown, without a unit
        or impossible. The message names file, key, value and remedy.
    """
    tables, where = read_tables(name_or_path, _BUILTIN, "vehicle")
    folder = None if str(name_or_path) in builtin_vehicles() else Path(name_or_path).parent
    return validated(Vehicle, named_maps(tables, folder, where), where)


def _walk(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, dict[str, Any], Any, str]]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        if isinstance(value, Quantity | Points | Curve):
            yield f"{prefix}{name}", extra, value, field.description or ""
        elif isinstance(value, BaseModel):
            yield from _walk(value, f"{prefix}{name}.")


def parameters(vehicle: Vehicle) -> list[Parameter]:
    """Return every parameter of a vehicle with symbol, SI value, unit, source and meaning, in file order."""
    rows = []
    for key, extra, q, description in _walk(vehicle):
        symbol = str(extra["symbol"])
        if key.startswith("rotors.upper."):
            symbol += "_up"
        elif key.startswith("rotors.lower."):
            symbol += "_dw"
        rows.append(Parameter(key, symbol, q.value, q.unit, q.source, description, q.note))
    return rows


def replace(
    vehicle: Vehicle, values: Mapping[str, float | str | None], *, source: str = "estimated"
) -> Vehicle:
    """Return a vehicle with some parameters changed.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle to start from.
    values : mapping of str to float, str or None
        New SI values by dotted key, as in ``{"body.mass": 0.08, "battery.model": "constant"}``.
        ``"rotors.coefficient_map"`` takes the name or path of a map, or None for the constants. A new
        ``body.mass`` drops the mass budget, which no longer adds up.
    source : str
        Provenance that the changed parameters get.

    Raises
    ------
    InputError
        If a key does not exist or a value is impossible.
    """
    tables = vehicle.model_dump()
    for key, value in values.items():
        *path, last = key.split(".")
        table: Any = tables
        for part in path:
            table = table.get(part) if isinstance(table, dict) else None
        if not isinstance(table, dict) or last not in table:
            raise InputError("replace", key, "no such parameter", "use a key that `mufly vehicle show` lists")
        if isinstance(table[last], dict) and "source" in table[last]:
            table[last] = {**table[last], "value": value, "source": source, "note": "set by hand"}
        else:
            table[last] = value
    if "body.mass" in values:
        tables["mass_budget"] = None
    return validated(Vehicle, named_maps(tables, None, vehicle.name), vehicle.name)


def vehicle_toml(vehicle: Vehicle) -> str:
    """Return the vehicle as the text of a vehicle file, in SI units, that :func:`load_vehicle` reads back.

    A coefficient map is written out in full, so the text needs no other file.
    """
    tables = vehicle.model_dump(exclude_none=True)
    return tomli_w.dumps(tables, multiline_strings=True)
