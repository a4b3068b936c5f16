"""Which format a log has, judged by its content, never by its name."""

from __future__ import annotations

from pathlib import Path

from mufly.errors import InputError
from mufly.logs.csv_file import looks_like_table
from mufly.logs.dataflash import MAGIC as DATAFLASH_MAGIC
from mufly.logs.dataflash import is_text_log
from mufly.logs.mcap_file import MAGIC as MCAP_MAGIC
from mufly.logs.tables_file import NETCDF_MAGIC, PARQUET_MAGIC
from mufly.logs.tlog import looks_like_tlog
from mufly.logs.ulog import MAGIC as ULOG_MAGIC

__all__ = ["kind_of"]


def kind_of(path: str | Path) -> str:
    """Return the format of a log, judged by its content.

    Raises
    ------
    InputError
        If it cannot be read, is empty, or is none of the formats.
    """
    where = str(path)
    try:
        with open(path, "rb") as stream:
            head = stream.read(65536)
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give the path of a log") from error
    if not head:
        raise InputError(where, "", "is empty", "give a log")
    if head.startswith(MCAP_MAGIC):
        return "MCAP"
    if head.startswith(ULOG_MAGIC):
        return "ULog"
    if head.startswith(PARQUET_MAGIC):
        return "Parquet"
    if head.startswith(NETCDF_MAGIC):
        return "NetCDF"
    if head.startswith(DATAFLASH_MAGIC) or is_text_log(head):
        return "DataFlash"
    if looks_like_tlog(head):
        return "MAVLink tlog"
    if head.startswith(b"version https://git-lfs"):
        raise InputError(where, "", "is only a pointer of Git LFS to the file", "fetch it: git lfs pull")
    if looks_like_table(head):
        return "CSV"
    if head.startswith(b"\x89HDF") or head.startswith(b"MATLAB"):
        name = "HDF5" if head.startswith(b"\x89HDF") else "MATLAB"
        raise InputError(
            where, "", f"is a {name} file, which is not read here", "export it as CSV or NetCDF 3"
        )
    raise InputError(
        where, "", "is no log that is known here",
        "give MCAP, ULog, DataFlash (.bin, .log), MAVLink tlog, CSV, Parquet or NetCDF",
    )  # fmt: skip
