"""From a vehicle file (TOML) to a checked :class:`Vehicle`, and back."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import tomli_w
from pydantic import BaseModel, ValidationError

from mufly.errors import InputError
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
    return sorted(f.name.removesuffix(".toml") for f in _BUILTIN.iterdir() if f.name.endswith(".toml"))


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
    name = str(name_or_path)
    if name in builtin_vehicles():
        text, where = (_BUILTIN / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"
    else:
        path = Path(name_or_path)
        if not path.is_file():
            known = ", ".join(builtin_vehicles())
            raise InputError(
                name, "", "no such vehicle or file", f"give a vehicle file, or one of the built-in: {known}"
            )
        where = name
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(where, "", f"cannot be read ({error})", "give a text file in UTF-8") from error
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, "", f"is not valid TOML ({error})", "correct that line") from error
    return _validated(tables, where)


def _validated(tables: Mapping[str, Any], where: str) -> Vehicle:
    try:
        return Vehicle.model_validate(tables)
    except ValidationError as error:
        raise _first_fault(error, where) from error


def _first_fault(error: ValidationError, where: str) -> InputError:
    faults = error.errors()
    # An unknown key is usually the reason for a missing one, so it is named first.
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in fault["loc"])
    context: dict[str, Any] = fault.get("ctx", {})
    if fault["type"] == "mufly":
        problem, remedy = context["problem"], context["remedy"]
        key = context.get("key", key)
    elif fault["type"] == "extra_forbidden":
        known = _keys_beside(fault["loc"])
        near = difflib.get_close_matches(str(fault["loc"][-1]), known, n=1)
        problem = "unknown key"
        remedy = f"did you mean {near[0]!r}?" if near else f"known keys here: {', '.join(known)}"
    elif fault["type"] == "missing":
        problem, remedy = "is missing", _how_to_write(fault["loc"])
    else:
        problem = f"{fault['input']!r} is wrong ({fault['msg']})"
        remedy = "correct the value"
    if len(faults) > 1:
        remedy += f" ({len(faults) - 1} more fault{'s' if len(faults) > 2 else ''} in this file)"
    return InputError(where, key, problem, remedy)


def _model_at(loc: tuple[int | str, ...]) -> type[BaseModel]:
    model: type[BaseModel] = Vehicle
    for part in loc:
        field = model.model_fields.get(str(part))
        kinds = [] if field is None else [field.annotation, *getattr(field.annotation, "__args__", ())]
        inner = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
        if not inner:
            break
        model = inner[0]
    return model


def _keys_beside(loc: tuple[int | str, ...]) -> list[str]:
    return list(_model_at(loc[:-1]).model_fields)


def _how_to_write(loc: tuple[int | str, ...]) -> str:
    name = str(loc[-1])
    field = _model_at(loc[:-1]).model_fields.get(name)
    declared = field.json_schema_extra if field is not None else None
    if isinstance(declared, dict) and "unit" in declared:
        return f'add {name} = {{ value = ..., unit = "{declared["unit"]}", source = "measured" }}'
    return f"add {name}" if field is None or field.description else f"add the table [{name}]"


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


def replace(vehicle: Vehicle, values: Mapping[str, float | str], *, source: str = "estimated") -> Vehicle:
    """Return a vehicle with some parameters changed.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle to start from.
    values : mapping of str to float or str
        New SI values by dotted key, as in ``{"body.mass": 0.08, "battery.model": "constant"}``.
        A new ``body.mass`` drops the mass budget, which no longer adds up.
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
        if isinstance(table[last], dict):
            table[last] = {**table[last], "value": value, "source": source, "note": "set by hand"}
        else:
            table[last] = value
    if "body.mass" in values:
        tables["mass_budget"] = None
    return _validated(tables, vehicle.name)


def vehicle_toml(vehicle: Vehicle) -> str:
    """Return the vehicle as the text of a vehicle file, in SI units, that :func:`load_vehicle` reads back."""
    return tomli_w.dumps(vehicle.model_dump(exclude_none=True))
