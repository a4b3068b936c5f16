"""MCAP: its container written and read, and the table of signals on one clock that recordings hold."""

from mufly.logs.mcap.mcap_reader import McapContents, read_mcap
from mufly.logs.mcap.mcap_writer import MAGIC, UNFINISHED, McapFile
from mufly.logs.mcap.signal_table import (
    Event,
    Layout,
    columns_of,
    dataset_of,
    describe,
    events_of,
    plain,
    restore,
    standard_layout,
    to_csv,
    to_dataset,
)

__all__ = [
    "MAGIC",
    "UNFINISHED",
    "Event",
    "Layout",
    "McapContents",
    "McapFile",
    "columns_of",
    "dataset_of",
    "describe",
    "events_of",
    "plain",
    "read_mcap",
    "restore",
    "standard_layout",
    "to_csv",
    "to_dataset",
]
