"""Tables of other programs and converted logs: text, Parquet, Feather, NetCDF."""

from mufly.logs.tables.columnar_files import (
    FEATHER_MAGIC,
    NETCDF_MAGIC,
    PARQUET_MAGIC,
    read_arrow,
    read_netcdf,
    write_netcdf,
    write_parquet,
)
from mufly.logs.tables.csv_log import TABLE_TOPIC, read_csv

__all__ = [
    "FEATHER_MAGIC",
    "NETCDF_MAGIC",
    "PARQUET_MAGIC",
    "TABLE_TOPIC",
    "read_arrow",
    "read_csv",
    "read_netcdf",
    "write_netcdf",
    "write_parquet",
]
