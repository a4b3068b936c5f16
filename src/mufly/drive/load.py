"""From a drive file or a vehicle to a checked :class:`Drive`, and back."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import tomli_w

from mufly.drive.schema import Drive
from mufly.tables import builtin_names, read_tables, validated
from mufly.vehicle import Vehicle

__all__ = ["builtin_drives", "drive_of", "drive_toml", "load_drive"]

_VEHICLES = resources.files("mufly.vehicle") / "builtin"
_MUFLY = "mufly-1.1"  # muFly's drive train is the one identified on this prototype


def builtin_drives() -> list[str]:
    """Return the names of the drives that come with mufly: ``mufly``, and those of the built-in vehicles."""
    return ["mufly", *builtin_names(_VEHICLES)]


def drive_of(vehicle: Vehicle) -> Drive:
    """Return the drive train of a vehicle: two rotors, each with its motor and gear, on one battery."""
    return Drive(
        name=vehicle.name,
        description=f"drive train of {vehicle.description or vehicle.name}",
        rotors=2,
        motor=vehicle.motor,
        gear=vehicle.gear,
        battery=vehicle.battery,
    )


def load_drive(name_or_path: str | Path) -> Drive:
    """Read a drive train by built-in name, from a drive file or from a vehicle file (TOML).

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`builtin_drives` lists (``"mufly"`` is the drive of prototype 1.1), or a file's path. A
        vehicle file gives the drive of that vehicle.

    Raises
    ------
    InputError
        If there is no such drive, the file is not TOML, or a value is missing, unknown, without a unit or impossible.
    """
    name = _MUFLY if str(name_or_path) == "mufly" else name_or_path
    tables, where = read_tables(name, _VEHICLES, "drive or vehicle")
    if "body" in tables or ("rotors" in tables and isinstance(tables["rotors"], dict)):
        return drive_of(validated(Vehicle, tables, where))
    return validated(Drive, {"name": Path(where).stem, **tables}, where)


def drive_toml(drive: Drive) -> str:
    """Return the drive as the text of a drive file, in SI units, that :func:`load_drive` reads back."""
    return tomli_w.dumps(drive.model_dump(exclude_none=True))
