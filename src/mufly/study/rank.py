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
from mufly.rotor import load_airfoil
from mufly.study.setup import Setup
from mufly.study.sweep import Progress, sweep

__all__ = ["rank_airfoils"]

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
