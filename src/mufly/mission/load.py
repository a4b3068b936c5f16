"""From a mission file (TOML) to a checked `Mission`, and back."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from mufly.mission.check import check_geometry
from mufly.mission.schema import Mission
from mufly.tables import builtin_names, read_tables, toml_value, validated

__all__ = ["builtin_missions", "dump_mission", "load_mission", "mission_from"]

_BUILTIN = resources.files("mufly.mission") / "builtin"


def builtin_missions() -> list[str]:
    """Names of the missions that come with mufly."""
    return builtin_names(_BUILTIN)


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
    tables, where = read_tables(name_or_path, _BUILTIN, "mission")
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
    mission = validated(Mission, tables, where)
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
            lines.append(f"{key} = {toml_value(value)}")
    for head, table in tables:
        lines += ["", head, *(f"{k} = {toml_value(v)}" for k, v in table.items())]
    return "\n".join(lines) + "\n"
