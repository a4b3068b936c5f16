"""From a mission file (TOML) to a checked `Mission`, and back."""

from __future__ import annotations

import difflib
import json
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from mufly.errors import InputError
from mufly.mission.check import check_geometry
from mufly.mission.schema import Mission

__all__ = ["builtin_missions", "dump_mission", "load_mission", "mission_from"]

_BUILTIN = resources.files("mufly.mission") / "builtin"
_LIMITS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def builtin_missions() -> list[str]:
    """Names of the missions that come with mufly."""
    return sorted(f.name.removesuffix(".toml") for f in _BUILTIN.iterdir() if f.name.endswith(".toml"))


def load_mission(name_or_path: str | Path) -> Mission:
    """Read a mission by built-in name or from a TOML file, and check it.

    Parameters
    ----------
    name_or_path : str or Path
        A name that `builtin_missions` lists, or the path of a mission file.

    Returns
    -------
    Mission
        Frozen and checked: nothing unknown, nothing impossible, every waypoint in free air.

    Raises
    ------
    InputError
        Naming file, key, value and remedy. Waypoints are counted from 1.
    """
    name = str(name_or_path)
    if name in builtin_missions():
        text, where = (_BUILTIN / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"
    else:
        path = Path(name_or_path)
        if not path.is_file():
            known = ", ".join(builtin_missions())
            raise InputError(
                name, "", "no such mission or file", f"give a mission file, or one of the built-in: {known}"
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
    return mission_from({"name": Path(where).stem, **tables}, where)


def mission_from(tables: Mapping[str, Any], where: str = "mission") -> Mission:
    """Make a checked mission of nested dictionaries with the keys of a mission file.

    Parameters
    ----------
    tables : mapping
        As TOML gives it: ``{"waypoint": [{"position_m": [1, 0, -1]}], ...}``.
    where : str
        What an error calls the place.

    Raises
    ------
    InputError
        As for `load_mission`.
    """
    try:
        mission = Mission.model_validate(tables)
    except ValidationError as error:
        raise _first_fault(error, where) from None
    check_geometry(mission, where)
    return mission


def dump_mission(mission: Mission) -> str:
    """The mission as the text of a file that `load_mission` reads back to an equal mission, defaults included."""
    lines: list[str] = []
    tables: list[tuple[str, dict[str, Any]]] = []
    for key, value in mission.model_dump(exclude_none=True).items():
        if isinstance(value, dict):
            tables.append((f"[{key}]", value))
        elif isinstance(value, list | tuple) and (not value or isinstance(value[0], dict)):
            tables += [(f"[[{key}]]", item) for item in value]
        else:
            lines.append(f"{key} = {_toml(value)}")
    for head, table in tables:
        lines += ["", head, *(f"{k} = {_toml(v)}" for k, v in table.items())]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(v) for v in value)}]"
    return repr(value)


def _first_fault(error: ValidationError, where: str) -> InputError:
    faults = error.errors()
    # An unknown key is usually the reason for a missing one, so it is named first.
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    kind, loc, given = fault["type"], fault["loc"], fault["input"]
    context: dict[str, Any] = fault.get("ctx", {})
    if kind == "missing" and loc and isinstance(loc[-1], int):
        # A tuple that is too short is reported at its first missing place.
        kind, loc = "length", loc[:-1]
    key = _key(loc)
    if kind == "extra_forbidden":
        known = list(_model_at(loc[:-1]).model_fields)
        near = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
        problem = "unknown key"
        remedy = f"did you mean {near[0]!r}?" if near else f"known keys here: {', '.join(known)}"
    elif kind == "missing":
        field = _model_at(loc[:-1]).model_fields[str(loc[-1])]
        problem, remedy = "is missing", f"add {loc[-1]} ({field.description})"
    elif kind in ("length", "too_long"):
        field = _model_at(loc[:-1]).model_fields[str(loc[-1])]
        wanted = len(getattr(field.annotation, "__args__", ()))
        problem = f"{_shown(given)} has the wrong length"
        remedy = f"give {wanted} numbers: {field.description}"
    elif kind in _LIMITS:
        name, words = _LIMITS[kind]
        problem, remedy = f"{_shown(given)} is not sensible", f"give a number {words} {context[name]:g}"
    elif kind == "finite_number":
        problem, remedy = f"{given} is not a number", "give a finite number"
    elif kind in ("float_type", "float_parsing"):
        problem, remedy = f"{_shown(given)} is not a number", "give a number without quotes"
    elif kind == "literal_error":
        problem, remedy = f"{_shown(given)} is unknown", f"give {context['expected']}"
    elif kind == "tuple_type":
        problem, remedy = f"{_shown(given)} is not a list", _list_remedy(loc)
    elif kind in ("model_type", "model_attributes_type"):
        problem, remedy = f"{_shown(given)} is not a table", "write its keys under it"
    else:
        problem, remedy = f"{_shown(given)} is wrong ({fault['msg']})", "correct the value"
    # A key missing beside an unknown one is the same fault, not another.
    same = sum(f["type"] == "missing" and f["loc"][:-1] == fault["loc"][:-1] for f in faults)
    more = len(faults) - 1 - (same if fault["type"] == "extra_forbidden" else 0)
    if more > 0:
        remedy += f" ({more} more fault{'s' if more > 1 else ''} in this file)"
    return InputError(where, key, problem, remedy)


def _shown(given: Any) -> str:
    text = _toml(given) if isinstance(given, str | bool | int | float | list | tuple) else repr(given)
    return text if len(text) <= 60 else text[:57] + "..."


def _list_remedy(loc: tuple[int | str, ...]) -> str:
    field = _model_at(loc[:-1]).model_fields.get(str(loc[-1]))
    if field is not None and _inner_model(field.annotation) is not None:
        return f"write one table [[{loc[-1]}]] for each"
    return f"give numbers in brackets: {field.description if field else ''}".rstrip(": ")


def _key(loc: tuple[int | str, ...]) -> str:
    """Dotted key with counts from 1: ("waypoint", 0, "position_m") is waypoint[1].position_m."""
    key = ""
    for part in loc:
        key += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if key else part
    return key


def _inner_model(annotation: Any) -> type[BaseModel] | None:
    for kind in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def _model_at(loc: tuple[int | str, ...]) -> type[BaseModel]:
    model: type[BaseModel] = Mission
    for part in loc:
        field = model.model_fields.get(str(part))
        inner = _inner_model(field.annotation) if field is not None else None
        model = inner or model
    return model
