"""Results on disk: NetCDF for programs, CSV for people and spreadsheets."""

from __future__ import annotations

import csv
from dataclasses import fields
from pathlib import Path

import numpy as np
import xarray as xr

from mufly.errors import InputError
from mufly.rotor import RotorResult
from mufly.study.parameters import PAIR, PARAMETERS

__all__ = ["read_results", "write_results", "write_stations"]


def write_results(data: xr.Dataset, folder: str | Path, name: str = "sweep") -> list[Path]:
    """Write ``name.nc`` and ``name.csv`` into a folder, which is made if need be.

    The CSV has one line a case; its columns are the coordinates, with the SI unit in the name, and the variables.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
        nc, table = target / f"{name}.nc", target / f"{name}.csv"
        data.to_netcdf(nc, engine="scipy")
        names = [str(d) for d in data.dims]
        heads = [_head(d, str(data[d].attrs.get("units", ""))) for d in names]
        columns = [np.asarray(data[v].transpose(*names)).ravel() for v in data.data_vars]
        grid = np.meshgrid(*(data[d].values for d in names), indexing="ij")
        with table.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow([*heads, *(str(v) for v in data.data_vars)])
            for row in zip(*(g.ravel() for g in grid), *columns, strict=True):
                writer.writerow([f"{x:.9g}" if isinstance(x, float) else x for x in row])
    except OSError as error:
        raise InputError(str(folder), "", f"cannot be written ({error})", "give another folder") from error
    return [nc, table]


def _head(name: str, unit: str) -> str:
    known = (name in PARAMETERS or name in PAIR) and unit not in ("", "1", "text")
    return f"{name}_{unit.replace(' ', '').replace('/', '_')}" if known else name


def read_results(file: str | Path) -> xr.Dataset:
    """Read a NetCDF file that :func:`write_results` wrote.

    Raises
    ------
    InputError
        If it is not there or not such a file.
    """
    try:
        with xr.open_dataset(file, engine="scipy") as data:
            return data.load()
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            str(file), "", f"is no result file ({error})", "give a .nc file of a sweep"
        ) from error


def write_stations(result: RotorResult, folder: str | Path, name: str = "stations") -> Path:
    """Write what happens along the blade as ``name.csv``, one line a station, SI units.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    columns = {k: v for k, v in values.items() if np.ndim(v) == 1}
    path = Path(folder) / f"{name}.csv"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([f"{v:.9g}" for v in row])
    except OSError as error:
        raise InputError(str(folder), "", f"cannot be written ({error})", "give another folder") from error
    return path
