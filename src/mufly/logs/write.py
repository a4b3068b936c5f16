"""One door out: a dataset as CSV, Parquet, NetCDF, MCAP or ULog, told by the name of the file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import xarray as xr

from mufly.errors import InputError
from mufly.logs.mcap_write import write_mcap
from mufly.logs.recording import to_csv
from mufly.logs.tables_file import write_netcdf, write_parquet
from mufly.logs.ulog_write import write_ulog

__all__ = ["FORMATS", "write_log"]


def _csv(dataset: xr.Dataset, path: Path) -> None:
    to_csv(dataset, path)


FORMATS: dict[str, Callable[[xr.Dataset, Path], None]] = {
    ".csv": _csv,
    ".parquet": write_parquet,
    ".nc": write_netcdf,
    ".mcap": write_mcap,
    ".ulg": write_ulog,
}
"""How each kind of file is written."""


def write_log(dataset: xr.Dataset, path: str | Path) -> Path:
    """Write signals on one clock to a file; a file that is already there stays until the new one is whole.

    Parameters
    ----------
    dataset : xarray.Dataset
        As :func:`read_log` returns.
    path : str or Path
        Its ending says what to write: .csv, .parquet, .nc (NetCDF 3), .mcap (a recording of ours) or .ulg.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        If the ending is none of these, pyarrow is missing for Parquet, or the file cannot be written.
    """
    target = Path(path)
    writer = FORMATS.get(target.suffix.lower())
    if writer is None:
        problem = f"the ending {target.suffix!r} says nothing"
        raise InputError(str(path), "", problem, f"use one of: {', '.join(FORMATS)}")
    part = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        writer(dataset, part)
        os.replace(part, target)
    except OSError as error:
        problem = f"cannot be written ({error.strerror or error})"
        raise InputError(str(path), "", problem, "choose another place or make room") from error
    finally:
        part.unlink(missing_ok=True)
    return target
