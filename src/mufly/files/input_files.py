"""Reading of TOML files to validated models; a fault becomes one line that a user can act on.

Vehicles, missions and rotors are all read the same way: by the name of a built-in file or by path, parsed, and
validated by a pydantic model. This module holds the parts that they share: finding and reading the file, and turning
pydantic's list of faults into the one line that a user can act on. A model's own checks raise
:func:`make_validation_error`, whose words are kept.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import PydanticCustomError

from mufly.errors import InputError, suggest_name

ModelT = TypeVar("ModelT", bound=BaseModel)

_LIMIT_WORDS = {
    "greater_than": ("gt", "above"),
    "greater_than_equal": ("ge", "at least"),
    "less_than": ("lt", "below"),
    "less_than_equal": ("le", "at most"),
}


def builtin_file_names(folder: Traversable) -> list[str]:
    """Return the names of the TOML files in a folder of the package."""
    return sorted(f.name.removesuffix(".toml") for f in folder.iterdir() if f.name.endswith(".toml"))


def read_toml(
    name_or_path: str | Path, folder: Traversable, kind: str, base: Path | None = None
) -> tuple[dict[str, Any], str]:
    """Read a TOML file by built-in name or by path.

    Parameters
    ----------
    name_or_path : str or Path
        A name in ``folder``, or the path of a file.
    folder : Traversable
        Folder of the built-in files.
    kind : str
        Kind of file in errors: ``"vehicle"``.
    base : Path, optional
        Folder of relative paths; by default the working directory.

    Returns
    -------
    tables : dict
        Tables as parsed from TOML.
    where : str
        Name of the file in errors.

    Raises
    ------
    InputError
        If there is no such file, or it is not text or not TOML.
    """
    known = builtin_file_names(folder)
    if base is not None and str(name_or_path) not in known:
        name_or_path = base / name_or_path
    name = str(name_or_path)
    if name in known:
        text, where = (folder / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml"
    else:
        path, where = Path(name_or_path), name
        if not path.is_file():
            beside = path.parent.glob("*.toml") if path.parent.is_dir() else ()
            here = [str(f) for f in beside if suggest_name(path.stem, [f.stem], "-") != "-"]
            remedy = suggest_name(
                name, [*known, *here], f"give a {kind} file, or one of the built-in: {', '.join(known)}"
            )
            raise InputError(name, "", f"no such {kind} or file", remedy)
        try:
            text = path.read_text(encoding="utf-8-sig")
        except OSError as error:
            raise InputError(where, "", f"cannot be read ({error.strerror})", "give a readable text file") from error
        except UnicodeDecodeError as error:
            raise InputError(where, "", "is not text in UTF-8", "save it in UTF-8") from error
    try:
        return tomllib.loads(text), where
    except tomllib.TOMLDecodeError as error:
        raise _toml_error(text, where, str(error)) from error


def _toml_error(text: str, where: str, message: str) -> InputError:
    """Return the error for text that is not valid TOML, with the number of the wrong line."""
    found = re.search(r"line (\d+), column (\d+)", message)
    if found is None:
        return InputError(where, "", "ends inside a value", "close its brackets or quotes")
    lines = text.splitlines()
    number = min(int(found[1]), len(lines))
    shown = _shorten_value(lines[number - 1].strip()) if lines else '""'
    problem = f"column {found[2]} of {shown} is not valid TOML"
    return InputError(where, f"line {number}", problem, "correct the line: key = value")


def validate_model(model: type[ModelT], tables: Mapping[str, Any], where: str) -> ModelT:
    """Make a validated model from nested dictionaries.

    Raises
    ------
    InputError
        Naming the first fault, and how many more there are. Members of lists are counted from 1.
    """
    try:
        return model.model_validate(tables)
    except ValidationError as error:
        raise _first_model_error(error, model, where) from None


TOO_MANY_DIGITS_ERROR = ("a whole number of more than 300 digits", "give a value of ordinary size")
_MAX_ORDINARY_INTEGER = 10**300


def make_validation_error(problem: str, remedy: str, key: str = "") -> PydanticCustomError:
    """Return the validation error for a refused value, with the problem and its remedy.

    ``key`` names the field at fault if it is not the validated one.
    """
    context = {"problem": problem, "remedy": remedy} | ({"key": key} if key else {})
    return PydanticCustomError("mufly", "{problem}; {remedy}", context)


# The checker's types of faults -> what a value is not, and what to do.
_TYPE_WORDS = {
    **dict.fromkeys(("float_type", "float_parsing"), ("a number", "give a number without quotes")),
    **dict.fromkeys(
        ("int_type", "int_parsing", "int_from_float"), ("a whole number", "give a whole number without quotes")
    ),
    **dict.fromkeys(("bool_type", "bool_parsing"), ("true or false", "give true or false, without quotes")),
    "string_type": ("a text", "give a text in quotes"),
}


def _first_model_error(error: ValidationError, model: type[BaseModel], where: str) -> InputError:
    faults = error.errors()
    # An unknown key is usually the reason for a missing one, so it is named first.
    fault = min(faults, key=lambda f: f["type"] != "extra_forbidden")
    kind, loc, given = fault["type"], fault["loc"], fault["input"]
    context: dict[str, Any] = fault.get("ctx", {})
    if kind == "missing" and loc and isinstance(loc[-1], int):
        # A tuple that is too short is reported at its first missing place.
        kind, loc = "length", loc[:-1]
    key = _dotted_key(loc)
    beside = _model_at_location(model, loc[:-1])
    field = beside.model_fields.get(str(loc[-1])) if loc else None
    meaning = (field.description or "") if field is not None else ""
    if kind == "mufly":
        problem, remedy, key = context["problem"], context["remedy"], context.get("key", key)
    elif kind == "extra_forbidden":
        problem, keys = "unknown key", list(beside.model_fields)
        remedy = suggest_name(str(loc[-1]), keys, f"known keys here: {', '.join(keys)}")
    elif kind == "missing":
        problem, remedy = "is missing", _describe_missing_key(str(loc[-1]), field)
    elif kind in ("length", "too_long"):
        absent = sum(f["type"] == "missing" and f["loc"][:-1] == loc for f in faults)
        wanted = context.get("max_length") or (len(given) + absent if isinstance(given, list | tuple) else 1)
        problem = f"{_shorten_value(given)} has the wrong length"
        remedy = f"give {wanted} numbers" + (f": {meaning}" if meaning else "")
    elif kind in _LIMIT_WORDS:
        name, words = _LIMIT_WORDS[kind]
        problem, remedy = f"{_shorten_value(given)} is out of range", f"give a number {words} {context[name]:g}"
    elif kind == "finite_number":
        problem, remedy = f"{given} is not a finite number", "give a finite number"
    elif isinstance(given, int) and abs(given) > _MAX_ORDINARY_INTEGER:
        problem, remedy = TOO_MANY_DIGITS_ERROR
    elif kind in _TYPE_WORDS:
        what, remedy = _TYPE_WORDS[kind]
        problem = f"{_shorten_value(given)} is not {what}"
    elif kind in ("string_too_short", "too_short"):
        problem, remedy = f"{_shorten_value(given)} is empty", f"give {meaning}" if meaning else "give one or more"
    elif kind == "literal_error":
        problem, remedy = f"{_shorten_value(given)} is unknown", f"give {context['expected']}"
    elif kind == "tuple_type":
        tables = field is not None and find_model_in_annotation(field.annotation) is not None
        what = "texts" if field is not None and str in getattr(field.annotation, "__args__", ()) else "numbers"
        remedy = f"write one table [[{loc[-1]}]] for each" if tables else f"give {what} in brackets: {meaning}"
        problem, remedy = f"{_shorten_value(given)} is not a list", remedy.rstrip(": ")
    elif kind in ("model_type", "model_attributes_type"):
        problem, remedy = f"{_shorten_value(given)} is not a table", "write its keys under it"
    else:
        problem, remedy = f"{_shorten_value(given)} does not fit", f"give {meaning}" if meaning else "correct the value"
    # A key missing beside an unknown one is the same fault, not another.
    same = sum(f["type"] == "missing" and f["loc"][:-1] == fault["loc"][:-1] for f in faults)
    more = len(faults) - 1 - (same if fault["type"] == "extra_forbidden" else 0)
    if more > 0:
        remedy += f" ({more} more fault{'s' if more > 1 else ''} in this file)"
    return InputError(where, key, problem, remedy)


def _describe_missing_key(name: str, field: Any) -> str:
    declared = field.json_schema_extra if field is not None else None
    if isinstance(declared, dict) and "unit" in declared:
        return f'add {name} = {{ value = ..., unit = "{declared["unit"]}", source = "measured" }}'
    if field is not None and not field.description:
        return f"add the table [{name}]"
    return f"add {name} ({field.description})" if field is not None else f"add {name}"


def format_toml_value(value: Any) -> str:
    """Return a string, number, truth value or list of them as TOML writes it."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007F")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(format_toml_value(v) for v in value)}]"
    return repr(value)


def _shorten_value(given: Any) -> str:
    text = format_toml_value(given) if isinstance(given, str | bool | int | float | list | tuple) else repr(given)
    return text if len(text) <= 60 else text[:57] + "..."


def _dotted_key(loc: tuple[int | str, ...]) -> str:
    """Return the dotted key, with counts from 1: ("waypoint", 0, "position_m") gives waypoint[1].position_m."""
    key = ""
    for part in loc:
        key += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if key else part
    return key


def find_model_in_annotation(annotation: Any) -> type[BaseModel] | None:
    """Return the pydantic model in an annotation such as ``M | None`` or ``tuple[M, ...]``; None without a model."""
    for kind in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return kind
    return None


def _model_at_location(model: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    for part in loc:
        field = model.model_fields.get(str(part))
        inner = find_model_in_annotation(field.annotation) if field is not None else None
        model = inner or model
    return model
