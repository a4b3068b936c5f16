"""Tables in files of other programs, and logs that were converted once: text, Parquet, Feather, NetCDF."""

from mufly.logs.tables.containers import (
    FEATHER_MAGIC,
    NETCDF_MAGIC,
    PARQUET_MAGIC,
    read_arrow,
    read_netcdf,
    write_netcdf,
    write_parquet,
)
from mufly.logs.tables.text import GZIP_MAGIC, TOPIC, looks_like_table, read_csv, read_fields, unpacked

__all__ = [
    "FEATHER_MAGIC",
    "GZIP_MAGIC",
    "NETCDF_MAGIC",
    "PARQUET_MAGIC",
    "TOPIC",
    "looks_like_table",
    "read_arrow",
    "read_csv",
    "read_fields",
    "read_netcdf",
    "unpacked",
    "write_netcdf",
    "write_parquet",
]
