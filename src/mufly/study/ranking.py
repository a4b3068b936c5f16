"""Airfoils in the order of what a rotor makes of them, each at its best pitch.

As the dissertation's Table 3.3: every airfoil is put on the whole blade, the rotor is evaluated at each pitch
with the gear adapted to the thrust, and the greatest value over the pitch counts. A section that fails at every
pitch comes last, with the reason.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr

from mufly.errors import InputError, MuflyError
from mufly.rotor import database_airfoils, load_airfoil
from mufly.study.setup import Setup
from mufly.study.sweeps import Progress, sweep

_OUTPUTS = ("electrical_power_W", "power_W", "speed_rad_s", "gear_ratio", "figure_of_merit", "reynolds_75")


def rank_airfoils(
    setup: Setup,
    airfoils: Sequence[str],
    pitch_rad: Sequence[float],
    *,
    by: str | None = None,
    folder: str | Path | None = None,
    progress: Progress | None = None,
    cluster: str | None = None,
) -> xr.Dataset:
    """Rank airfoils on one rotor.

    Parameters
    ----------
    setup : Setup
        Rotor, drive and thrust (or speed).
    airfoils : sequence of str
        Names or files, each once.
    pitch_rad : sequence of float
        Pitch settings to try.
    by : str, optional
        Variable to rank by, the greatest first. Default: ``thrust_per_power_N_W`` with a drive, else
        ``figure_of_merit``.
    folder, progress, cluster
        As for :func:`mufly.study.sweep`.

    Returns
    -------
    xarray.Dataset
        Over ``airfoil``, best first: ``rank``, the value ranked by, ``pitch`` where it is reached, what else
        holds there, ``thickness_ratio``, ``camber`` and ``fault``.

    Raises
    ------
    InputError
        If there is no such variable, or as :func:`mufly.study.sweep`.
    """
    key = by or ("thrust_per_power_N_W" if setup.drive is not None else "figure_of_merit")
    if key not in setup.outputs():
        raise InputError("rank", key, "is no result", f"use one of: {', '.join(setup.outputs())}")
    data = sweep(
        setup,
        {"airfoil": list(airfoils), "pitch": list(pitch_rad)},
        folder=folder,
        progress=progress,
        cluster=cluster,
    )
    value = data[key].values
    solved = np.isfinite(value)
    best = np.argmax(np.where(solved, value, -np.inf), axis=1)
    rows = np.arange(value.shape[0])
    order = np.argsort(-np.where(solved.any(axis=1), value[rows, best], -np.inf), kind="stable")
    at = (rows[order], best[order])
    kept = [key, *(name for name in _OUTPUTS if name in data and name != key)]
    variables = {name: ("airfoil", data[name].values[at], data[name].attrs) for name in kept}
    ok = solved.any(axis=1)[order]
    names = [str(airfoils[k]) for k in order]
    shapes = np.array([_shape(name) for name in names])
    pitch = np.where(ok, np.asarray(pitch_rad)[best[order]], np.nan)
    return xr.Dataset(
        {
            "rank": ("airfoil", np.arange(1, len(names) + 1)),
            **variables,
            "pitch": ("airfoil", pitch, data["pitch"].attrs),
            "thickness_ratio": ("airfoil", shapes[:, 0], {"units": "1", "long_name": "thickness over chord"}),
            "camber": ("airfoil", shapes[:, 1], {"units": "1", "long_name": "camber over chord"}),
            "fault": ("airfoil", np.where(ok, "", data["fault"].values[at])),
        },
        {"airfoil": np.array(names)},
        {**data.attrs, "by": key},
    )


def _shape(name: str) -> tuple[float, float]:
    try:
        section = load_airfoil(name)
    except MuflyError:
        return np.nan, np.nan
    return section.thickness_ratio, section.camber


# ----------------------------------------------------------------------------
# Sets of airfoils for rankings: the dissertation's 247, the whole database, a folder of files, or names.
#
# The dissertation ranks 247 airfoils "from a data base" and names eight of them (Table 3.3). Which the others were it
# does not say. The rule here: the eight, then of AeroSandbox's database (the UIUC collection, 2 174 contours in
# version
# 4.2.10), in alphabetical order without the eight, those at the places floor(k n / 239), k = 0 to 238; where a
# contour is
# unsound, the next one that is not. Nothing about an airfoil's shape or merit enters, so the sample is as thick and
# as odd as the database.


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
