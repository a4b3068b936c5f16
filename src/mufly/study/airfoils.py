"""Sets of airfoils for rankings: the dissertation's 247, the whole database, a folder of files, or names.

The dissertation ranks 247 airfoils "from a data base" and names eight of them (Table 3.3). Which the others were it
does not say. The rule here: the eight, then of AeroSandbox's database (the UIUC collection, 2 174 contours in version
4.2.10), in alphabetical order without the eight, those at the places floor(k n / 239), k = 0 to 238; where a contour is
unsound, the next one that is not. Nothing about an airfoil's shape or merit enters, so the sample is as thick and
as odd as the database.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mufly.errors import InputError, MuflyError
from mufly.rotor import database_airfoils, load_airfoil

__all__ = ["TABLE_3_3", "choose_airfoils", "thesis_airfoils"]

# Name in Table 3.3 -> name here. n642-015 is "n64015" in the database, the only 64-015 there. NACA "25516" is no
# five-digit section: its third digit must be 0 (normal) or 1 (reflexed); 25016 is the nearest that exists.
TABLE_3_3: dict[str, str] = {
    "goe394": "goe394",
    "goe342": "goe342",
    "gm15sm": "gm15sm",
    "goe142": "goe142",
    "lnv109a": "lnv109a",
    "NACA25516": "naca25016",
    "n642-015": "n64015",
    "NACA6415": "naca6415",
}
_COUNT = 247
_SUFFIXES = (".dat", ".txt")


def thesis_airfoils() -> list[str]:
    """Return the 247 names by the rule of the module docstring, the eight of Table 3.3 first.

    Raises
    ------
    MuflyError
        If the database is not installed.
    """
    eight = list(TABLE_3_3.values())
    rest = [name for name in database_airfoils() if name not in eight]
    if len(rest) < _COUNT - len(eight):
        raise MuflyError("AeroSandbox's airfoil database is not installed; pip install aerosandbox")
    n = _COUNT - len(eight)
    chosen = list(eight)
    for k in range(n):
        place, end = k * len(rest) // n, (k + 1) * len(rest) // n
        chosen.append(next((name for name in rest[place:end] if _is_sound(name)), rest[place]))
    return chosen


def _is_sound(name: str) -> bool:
    try:
        load_airfoil(name)
    except InputError:
        return False
    return True


def choose_airfoils(wanted: str | Sequence[str]) -> list[str]:
    """Return airfoils by set or by name.

    Parameters
    ----------
    wanted : str or sequence of str
        ``"thesis"`` (the 247), ``"database"`` (all), a folder with .dat or .txt files, or names as
        :func:`mufly.rotor.load_airfoil` takes them; several may be given, in a sequence or separated by commas.

    Raises
    ------
    InputError
        If a folder holds no airfoil file or nothing is named.
    """
    items = wanted.split(",") if isinstance(wanted, str) else [p for w in wanted for p in w.split(",")]
    names: list[str] = []
    for item in (i.strip() for i in items):
        if item == "thesis":
            names += thesis_airfoils()
        elif item == "database":
            names += database_airfoils()
        elif item and Path(item).is_dir():
            files = sorted(str(f) for f in Path(item).iterdir() if f.suffix.lower() in _SUFFIXES)
            if not files:
                raise InputError(item, "", "holds no airfoil file", "give a folder with .dat files")
            names += files
        elif item:
            names.append(item)
    if not names:
        raise InputError("airfoils", "", "none is named", "give names, a folder, 'thesis' or 'database'")
    return list(dict.fromkeys(names))
