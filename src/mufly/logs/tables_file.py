"""NetCDF and Parquet: logs that were converted once, and tables that other programs wrote.

What ``mufly log convert`` wrote comes back as it was. Any other NetCDF (version 3) needs a dimension ``time``; any
other Parquet file is a table whose columns are read like those of a CSV file.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.column_map import TimeEntry
from mufly.logs.csv_file import TOPIC, table_clock
from mufly.logs.flat import columns_of, describe, plain, restore
from mufly.logs.raw import RawLog, RawTable
from mufly.logs.units import split_header

__all__ = ["NETCDF_MAGIC", "PARQUET_MAGIC", "read_netcdf", "read_parquet", "write_netcdf", "write_parquet"]

NETCDF_MAGIC = (b"CDF\x01", b"CDF\x02")
PARQUET_MAGIC = b"PAR1"
_KEY = b"mufly"
_ATTRIBUTES = "mufly_attributes"


def _pyarrow() -> ModuleType:
    try:
        import pyarrow.parquet as module
    except ImportError as error:
        remedy = "install it: pip install 'mufly[parquet]' (or use .nc or .csv)"
        raise InputError("Parquet", "", "needs pyarrow, which is not installed", remedy) from error
    return module


def write_parquet(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as one table, a column a component; units stand in the fields' metadata."""
    module = _pyarrow()
    import pyarrow

    columns = columns_of(dataset)
    fields = [pyarrow.field("time", pyarrow.float64(), metadata={"units": "s"})]
    arrays = [pyarrow.array(dataset["time"].values)]
    for column in columns:
        array = pyarrow.array(column.values.tolist() if column.values.dtype.kind in "US" else column.values)
        fields.append(pyarrow.field(column.name, array.type, metadata={"units": column.units}))
        arrays.append(array)
    schema = pyarrow.schema(fields, metadata={_KEY: describe(dataset).encode()})
    module.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)


def read_parquet(path: str | Path, time: TimeEntry | None = None) -> tuple[RawLog, xr.Dataset | None]:
    """Read a Parquet file: its table, and the dataset if this package wrote it.

    Raises
    ------
    InputError
        If it is damaged, or pyarrow is missing.
    """
    module = _pyarrow()
    where = str(path)
    try:
        table = module.read_table(where)
        fields, units = _columns(table)
    except Exception as error:  # whatever damage provokes in pyarrow, names that are no text included
        reason = " ".join(str(error).split())[:120]
        raise InputError(where, "", f"is no sound Parquet file ({reason})", "give another copy") from error
    metadata = table.schema.metadata or {}
    if _KEY in metadata:
        try:
            clock = fields.pop("time")
            units.pop("time", None)
            dataset = restore(clock, fields, metadata[_KEY].decode())
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(
                where, "", f"has a damaged description ({error})", "give another copy"
            ) from error
        start = str(dataset.attrs.get("start_time", ""))
        return RawLog(where, "Parquet", {TOPIC: RawTable(TOPIC, clock, fields, units)}, start), dataset
    clock, start, notes = table_clock(where, fields, units, time)
    raw = RawLog(where, "Parquet", {TOPIC: RawTable(TOPIC, clock, fields, units)}, start, notes=tuple(notes))
    return raw, None


def _columns(table: Any) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Columns and units of a Parquet table."""
    fields: dict[str, NDArray[Any]] = {}
    units: dict[str, str] = {}
    for entry, column in zip(table.schema, table.columns, strict=True):
        name, unit = split_header(entry.name)
        given = (entry.metadata or {}).get(b"units", b"").decode(errors="replace")
        name, unit = (entry.name, given) if given else (name, unit)
        values = np.asarray(column.to_pylist() if str(entry.type) in ("string", "large_string") else column)
        if values.dtype.kind not in "biufU":
            values = np.array([str(v) for v in column.to_pylist()], dtype=str)
        fields[name] = values if values.dtype.kind == "U" else values.astype(np.float64)
        units |= {name: unit} if unit else {}
    return fields, units


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as NetCDF 3, for any program that reads that; attributes that NetCDF cannot hold as JSON."""
    out = dataset.copy()
    out.attrs = {_ATTRIBUTES: json.dumps(plain(dataset.attrs))}
    out.attrs |= {k: v for k, v in dataset.attrs.items() if isinstance(v, str) and v}
    for name in [*out.data_vars, *out.coords]:
        variable = out[name]
        variable.attrs = {
            k: v for k, v in plain(variable.attrs).items() if isinstance(v, str | int | float) and v != ""
        }
        variable.attrs = {k: int(v) if isinstance(v, bool) else v for k, v in variable.attrs.items()}
        if variable.size == 0 and variable.dtype.kind == "U":
            out[name] = variable.astype("U1")
    out.to_netcdf(path, engine="scipy")


def read_netcdf(path: str | Path) -> xr.Dataset:
    """Read a NetCDF file with a dimension ``time``.

    Raises
    ------
    InputError
        If it is damaged or holds nothing over time.
    """
    where = str(path)
    try:
        with xr.open_dataset(where, engine="scipy", decode_times=False) as stream:
            data = stream.load()
    except Exception as error:
        raise InputError(where, "", f"is no sound NetCDF file ({error})", "give another copy") from error
    if "time" not in data.dims or "time" not in data.coords:
        raise InputError(
            where, "", "has no coordinate 'time'", "give a log (.nc) with its variables over time"
        )
    if _ATTRIBUTES in data.attrs:
        try:
            data.attrs = dict(json.loads(data.attrs[_ATTRIBUTES]))
        except (ValueError, TypeError) as error:
            problem = f"has damaged attributes ({error})"
            raise InputError(where, "", problem, "give another copy") from error
    for name in data.variables:
        if data[name].dtype.kind in "SO":
            data[name] = data[name].astype(str)
    return data
