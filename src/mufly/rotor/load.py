"""From a rotor file (TOML) to a checked :class:`Rotor`, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import ArrayLike

from mufly.errors import InputError
from mufly.rotor.geometry import Rotor
from mufly.tables import builtin_names, read_tables, validated

__all__ = ["builtin_rotors", "load_rotor", "make_rotor", "replace_rotor", "rotor_from", "rotor_toml"]

_BUILTIN = resources.files("mufly.rotor") / "builtin"


def builtin_rotors() -> list[str]:
    """Return the names of the rotors that come with mufly."""
    return builtin_names(_BUILTIN)


def load_rotor(name_or_path: str | Path) -> Rotor:
    """Read a rotor by built-in name or from a TOML file.

    Airfoil files named in a rotor file are sought beside it first.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`builtin_rotors` lists, or the path of a rotor file.

    Returns
    -------
    Rotor
        Frozen and checked; all values in SI units.

    Raises
    ------
    InputError
        If there is no such rotor, the file is not TOML, or a value is missing, unknown, without a unit or
        impossible. The message names file, key, value and remedy.
    """
    tables, where = read_tables(name_or_path, _BUILTIN, "rotor")
    blade = tables.get("blade")
    if where == str(name_or_path) and isinstance(blade, dict) and isinstance(blade.get("airfoils"), list):
        folder = Path(where).parent
        blade["airfoils"] = [_beside(folder, name) for name in blade["airfoils"]]
    return rotor_from({"name": Path(where).stem, **tables}, where)


def _beside(folder: Path, name: Any) -> Any:
    if (
        isinstance(name, str)
        and name.lower().endswith((".dat", ".txt", ".csv"))
        and (folder / name).is_file()
    ):
        return str(folder / name)
    return name


def rotor_from(tables: Mapping[str, Any], where: str = "rotor") -> Rotor:
    """Make a checked rotor of nested dictionaries with the keys of a rotor file.

    Raises
    ------
    InputError
        As for :func:`load_rotor`.
    """
    return validated(Rotor, tables, where)


def make_rotor(
    *,
    name: str,
    radius_m: float,
    chord_m: ArrayLike,
    twist_rad: ArrayLike = 0.0,
    airfoils: str | Sequence[str] = "naca4412",
    r_over_R: ArrayLike = (0.0, 1.0),
    blades: int = 2,
    hub_cutout: float = 0.15,
    source: str = "specified",
    description: str = "",
) -> Rotor:
    """Make a rotor from arrays.

    Parameters
    ----------
    name, description : str
        As in a rotor file.
    radius_m : float
        Radius (m).
    chord_m, twist_rad : float or (n,) array_like
        Chord (m) and twist (rad) at the stations; one number holds along the blade.
    airfoils : str or n names
        Airfoil of the blade, or of each station.
    r_over_R : (n,) array_like
        Stations, rising to 1.
    blades : int
        Number of blades.
    hub_cutout : float
        Radius over R at which the blade begins.
    source : str
        Provenance of all values: measured, CAD, datasheet, estimated, identified or specified.

    Raises
    ------
    InputError
        If a value is impossible.
    """
    x = np.asarray(r_over_R, dtype=np.float64)

    def column(values: ArrayLike, unit: str) -> dict[str, Any]:
        array = np.asarray(values, dtype=np.float64)
        return {
            "value": (np.full(x.size, array) if array.ndim == 0 else array).tolist(),
            "unit": unit,
            "source": source,
        }

    tables = {
        "name": name,
        "description": description,
        "blades": blades,
        "radius": {"value": radius_m, "unit": "m", "source": source},
        "hub_cutout": {"value": hub_cutout, "unit": "1", "source": source},
        "blade": {
            "r_over_R": column(x, "1"),
            "chord": column(chord_m, "m"),
            "twist": column(twist_rad, "rad"),
            "airfoils": [airfoils] if isinstance(airfoils, str) else list(airfoils),
        },
    }
    return rotor_from(tables, name)


def replace_rotor(rotor: Rotor, values: Mapping[str, Any], *, source: str = "specified") -> Rotor:
    """Return a rotor with some values changed.

    Parameters
    ----------
    rotor : Rotor
        The rotor to start from.
    values : mapping
        New SI values by dotted key, as in ``{"radius": 0.07, "blade.chord": 0.025, "blades": 3}``. One number for a
        column holds at every station.
    source : str
        Provenance that the changed values get.

    Raises
    ------
    InputError
        If a key does not exist or a value is impossible.
    """
    tables = rotor.toml_tables()
    stations = len(rotor.blade.r_over_R.value)
    for key, value in values.items():
        *path, last = key.split(".")
        table: Any = tables
        for part in path:
            table = table.get(part) if isinstance(table, dict) else None
        if not isinstance(table, dict) or last not in table:
            known = (
                "name, blades, radius, hub_cutout, blade.r_over_R, blade.chord, blade.twist, blade.airfoils"
            )
            raise InputError("replace", key, "no such key", f"use one of: {known}")
        if last == "airfoils":
            table[last] = [value] if isinstance(value, str) else list(value)
        elif isinstance(table[last], dict):
            column = isinstance(table[last]["value"], list | tuple)
            listed = np.asarray(value, dtype=np.float64).tolist() if column else value
            if column and not isinstance(listed, list):
                listed = [listed] * stations
            table[last] = {**table[last], "value": listed, "source": source, "note": "set by hand"}
        else:
            table[last] = value
    return rotor_from(tables, rotor.name)


def rotor_toml(rotor: Rotor) -> str:
    """Return the rotor as the text of a rotor file, in SI units, that :func:`load_rotor` reads back."""
    return tomli_w.dumps(rotor.toml_tables())
