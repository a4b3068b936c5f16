"""Tables in containers with units: Parquet, Feather (Arrow) and NetCDF 3.

Units stated by a container take precedence: Arrow's types of time with resolution and zone; the metadata ``units`` or
``unit`` of a field; NetCDF's attribute ``units``, with ``"milliseconds since 2024-08-09 10:00"`` for times (CF
conventions). If the name of a column contradicts its metadata, the metadata count, and a note reports it. Files of this
package are restored unchanged.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Set
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.column_map import TimeEntry
from mufly.logs.mcap import encode_dataset_metadata, restore_dataset, split_dataset_into_channels, to_json_value
from mufly.logs.raw_log import RawLog, RawTable
from mufly.logs.tables.clock_columns import extract_row_times, is_time_unit
from mufly.logs.tables.csv_log import TABLE_TOPIC, name_columns_and_units

NETCDF_MAGIC = (b"CDF\x01", b"CDF\x02")
PARQUET_MAGIC = b"PAR1"
FEATHER_MAGIC = (b"ARROW1", b"FEA1")
_METADATA_KEY = b"mufly"
_ATTRIBUTES_KEY = "mufly_attributes"
_UNIT_KEYS = ("units", "unit")


def _import_pyarrow(kind: str) -> ModuleType:
    try:
        import pyarrow
        import pyarrow.compute
        import pyarrow.feather
        import pyarrow.parquet
    except ImportError as error:
        remedy = "install it: pip install 'mufly[parquet]' (or use .nc or .csv)"
        raise InputError(kind, "", "needs pyarrow, which is not installed", remedy) from error
    return pyarrow


def write_parquet(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as one table with a column for each component; units are in the fields' metadata."""
    pyarrow = _import_pyarrow("Parquet")
    columns = split_dataset_into_channels(dataset)
    fields = [pyarrow.field("time", pyarrow.float64(), metadata={"units": "s"})]
    arrays = [pyarrow.array(dataset["time"].values)]
    for column in columns:
        array = pyarrow.array(column.values.tolist() if column.values.dtype.kind in "US" else column.values)
        fields.append(pyarrow.field(column.column_name, array.type, metadata={"units": column.units}))
        arrays.append(array)
    schema = pyarrow.schema(fields, metadata={_METADATA_KEY: encode_dataset_metadata(dataset).encode()})
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)


def read_arrow(path: str | Path, kind: str, time: TimeEntry | None = None) -> tuple[RawLog, xr.Dataset | None]:
    """Read a Parquet or Feather file: its table, and the dataset if this package wrote it.

    Parameters
    ----------
    path : str or Path
    kind : str
        ``"Parquet"`` or ``"Feather"``.
    time : TimeEntry, optional
        As for :func:`mufly.logs.tables.read_csv`.

    Raises
    ------
    InputError
        If the file is damaged, or pyarrow is missing.
    """
    pyarrow = _import_pyarrow(kind)
    where = str(path)
    try:
        table = (pyarrow.parquet if kind == "Parquet" else pyarrow.feather).read_table(where)
        metadata = table.schema.metadata or {}
        names = [str(entry.name) for entry in table.schema]
        given = [_read_arrow_unit(entry, metadata) for entry in table.schema]
        columns = [_arrow_to_numpy(pyarrow, c) for c in table.columns]
        index = _pandas_index_columns(metadata)
    except Exception as error:  # any error of pyarrow on damaged data, including invalid names
        reason = " ".join(str(error).split())[:120]
        raise InputError(where, "", f"is a damaged {kind} file ({reason})", "give another copy") from error
    if _METADATA_KEY in metadata:
        fields = dict(zip(names, columns, strict=True))
        units = {n: u for n, u in zip(names, given, strict=True) if u and n != "time"}
        try:
            clock = fields.pop("time")
            dataset = restore_dataset(clock, fields, metadata[_METADATA_KEY].decode())
        except (KeyError, ValueError, TypeError) as error:
            raise InputError(where, "", f"has a damaged description ({error})", "give another copy") from error
        start = str(dataset.attrs.get("start_time", ""))
        return RawLog(where, kind, {TABLE_TOPIC: RawTable(TABLE_TOPIC, clock, fields, units)}, start), dataset
    # The index of a data frame is the first candidate for the clock.
    order = sorted(range(len(names)), key=lambda k: names[k] not in index)
    names, given, columns = [names[k] for k in order], [given[k] for k in order], [columns[k] for k in order]
    fields, units, notes = name_columns_and_units(names, given, columns)
    local = {str(e.name) for e in table.schema if pyarrow.types.is_timestamp(e.type) and e.type.tz is None}
    return _make_foreign_log(where, kind, fields, units, notes, time, local), None


def _read_arrow_unit(entry: Any, metadata: Mapping[bytes, bytes]) -> str:
    """Return the unit in a field's metadata, or in the table's attributes as written by pandas."""
    own = {k.decode(errors="replace").lower(): v.decode(errors="replace") for k, v in (entry.metadata or {}).items()}
    unit = next((own[k] for k in _UNIT_KEYS if k in own), "")
    if not unit and b"PANDAS_ATTRS" in metadata:
        attrs = json.loads(metadata[b"PANDAS_ATTRS"])
        known: dict[str, Any] = next((attrs[k] for k in _UNIT_KEYS if isinstance(attrs.get(k), dict)), {})
        unit = str(known.get(entry.name, ""))
    return unit


def _pandas_index_columns(metadata: Mapping[bytes, bytes]) -> set[str]:
    """Return the names of the columns in which pandas stored the index of its frame."""
    said = json.loads(metadata[b"pandas"]) if b"pandas" in metadata else {}
    return {name for name in said.get("index_columns", ()) if isinstance(name, str)}


def _arrow_to_numpy(pyarrow: ModuleType, column: Any) -> NDArray[Any]:
    """Return a column as numbers, text or NumPy times; integers without gaps stay integers."""
    kinds = pyarrow.types
    if kinds.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if kinds.is_timestamp(column.type):
        return np.asarray(column.cast(pyarrow.timestamp(column.type.unit))).astype(f"datetime64[{column.type.unit}]")
    if kinds.is_duration(column.type):
        return np.asarray(column).astype(f"timedelta64[{column.type.unit}]")
    if kinds.is_date(column.type):
        return np.asarray(column.cast(pyarrow.timestamp("s"))).astype("datetime64[s]")
    if kinds.is_time(column.type):
        unit = column.type.unit
        counts = column.cast(pyarrow.int32() if unit in ("s", "ms") else pyarrow.int64())
        return np.asarray(counts.cast(pyarrow.duration(unit))).astype(f"timedelta64[{unit}]")
    if kinds.is_decimal(column.type) or kinds.is_boolean(column.type) or kinds.is_null(column.type):
        return np.asarray(column.cast(pyarrow.float64()))
    values = np.asarray(
        column.to_pylist() if kinds.is_string(column.type) or kinds.is_large_string(column.type) else column
    )
    if values.dtype.kind not in "iufU":
        values = np.array(["" if v is None else str(v) for v in column.to_pylist()], dtype=str)
    return values


def _make_foreign_log(
    where: str,
    kind: str,
    fields: dict[str, NDArray[Any]],
    units: dict[str, str],
    notes: list[str],
    time: TimeEntry | None,
    zoneless: Set[str] = frozenset(),
) -> RawLog:
    """Return the log of another program's table: clock extracted, other times in seconds, numbers as floats.

    Columns in ``zoneless`` state no time zone.
    """
    before = set(fields)
    clock, start, said = extract_row_times(where, fields, units, time)
    said += [f"column {n} names no time zone: taken as UTC" for n in before - set(fields) if n in zoneless]
    for name, values in fields.items():
        if values.dtype.kind in "Mm":
            missing = np.isnat(values)
            ns = values.astype(f"{'datetime64' if values.dtype.kind == 'M' else 'timedelta64'}[ns]").astype(np.int64)
            fields[name], units[name] = np.where(missing, np.nan, ns / 1e9), "s"
        elif values.dtype.kind != "U":
            fields[name] = values.astype(np.float64, copy=False)
    table = RawTable(TABLE_TOPIC, clock, fields, units)
    return RawLog(where, kind, {TABLE_TOPIC: table}, start, notes=(*notes, *said))


def write_netcdf(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as NetCDF 3; attributes that NetCDF cannot hold are written as JSON."""
    out = dataset.copy()
    out.attrs = {_ATTRIBUTES_KEY: json.dumps(to_json_value(dataset.attrs))}
    out.attrs |= {k: v for k, v in dataset.attrs.items() if isinstance(v, str) and v}
    for name in [*out.data_vars, *out.coords]:
        variable = out[name]
        variable.attrs = {
            k: v for k, v in to_json_value(variable.attrs).items() if isinstance(v, str | int | float) and v != ""
        }
        variable.attrs = {k: int(v) if isinstance(v, bool) else v for k, v in variable.attrs.items()}
        if variable.size == 0 and variable.dtype.kind == "U":
            out[name] = variable.astype("U1")
    out.to_netcdf(path, engine="scipy")


def read_netcdf(path: str | Path, time: TimeEntry | None = None) -> tuple[RawLog, xr.Dataset | None]:
    """Read a NetCDF file: its variables over time, and the dataset if this package wrote it.

    Parameters
    ----------
    path : str or Path
    time : TimeEntry, optional
        As for :func:`mufly.logs.tables.read_csv`.

    Raises
    ------
    InputError
        If the file is damaged, has no variable over time, or its time has an unknown unit.
    """
    where = str(path)
    try:
        with xr.open_dataset(where, engine="scipy", decode_times=False) as stream:
            data = stream.load()
    except Exception as error:
        raise InputError(where, "", f"is a damaged NetCDF file ({error})", "give another copy") from error
    for name in data.variables:
        if data[name].dtype.kind in "SO":
            data[name] = data[name].astype(str)
    if _ATTRIBUTES_KEY in data.attrs:
        return _restore_own_netcdf(where, data)
    dim = _find_time_dimension(data)
    if not dim:
        raise InputError(where, "", "has no coordinate 'time'", "give a log (.nc) with its variables over time")
    names: list[str] = []
    given: list[str] = []
    columns: list[NDArray[Any]] = []
    for key, variable in data.variables.items():
        if dim not in variable.dims or variable.ndim > 2:
            continue
        unit = next((str(v) for k, v in variable.attrs.items() if k.lower() in _UNIT_KEYS), "")
        other = next((d for d in variable.dims if d != dim), None)
        labels = [""] if other is None else [f"_{k}" for k in data[other].values.tolist()]
        block = variable.values if other is None else variable.transpose(dim, other).values
        names += [f"{key}{label}" for label in labels]
        given += [unit] * len(labels)
        columns += [block] if other is None else list(block.T)
    fields, units, notes = name_columns_and_units(names, given, columns)
    return _make_foreign_log(where, "NetCDF", fields, units, notes, time), None


def _restore_own_netcdf(where: str, data: xr.Dataset) -> tuple[RawLog, xr.Dataset]:
    try:
        data.attrs = dict(json.loads(data.attrs[_ATTRIBUTES_KEY]))
    except (ValueError, TypeError) as error:
        raise InputError(where, "", f"has damaged attributes ({error})", "give another copy") from error
    if "time" not in data.dims or "time" not in data.coords:
        raise InputError(where, "", "has no coordinate 'time'", "give a log (.nc) with its variables over time")
    columns = split_dataset_into_channels(data)
    fields, units = {c.column_name: c.values for c in columns}, {c.column_name: c.units for c in columns}
    table = RawTable(TABLE_TOPIC, data["time"].values.astype(np.float64), fields, units)
    return RawLog(where, "NetCDF", {TABLE_TOPIC: table}, str(data.attrs.get("start_time", ""))), data


def _find_time_dimension(data: xr.Dataset) -> str:
    """Return the time dimension: the dimension with a variable of its name or with a unit of time."""
    if "time" in data.dims:
        return "time" if "time" in data.variables else ""
    for key, variable in data.variables.items():
        unit = next((str(v) for k, v in variable.attrs.items() if k.lower() in _UNIT_KEYS), "")
        if variable.ndim == 1 and ((unit and is_time_unit(unit)) or str(key).lower() in ("time", "t", "timestamp")):
            return str(variable.dims[0])
    return ""
