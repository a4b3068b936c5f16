"""Tables in files of other programs, and logs that were converted once: text, Parquet, Feather, NetCDF."""

from mufly.logs.tables.columnar_files import (
    FEATHER_MAGIC,
    NETCDF_MAGIC,
    PARQUET_MAGIC,
    read_arrow,
    read_netcdf,
    write_netcdf,
    write_parquet,
)
from mufly.logs.tables.text_table import (
    GZIP_MAGIC,
    TABLE_TOPIC,
    looks_like_table,
    read_csv,
    read_table_columns,
    read_unpacked,
)

__all__ = [
    "FEATHER_MAGIC",
    "GZIP_MAGIC",
    "NETCDF_MAGIC",
    "PARQUET_MAGIC",
    "TABLE_TOPIC",
    "looks_like_table",
    "read_arrow",
    "read_csv",
    "read_netcdf",
    "read_table_columns",
    "read_unpacked",
    "write_netcdf",
    "write_parquet",
]
