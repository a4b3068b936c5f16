"""MCAP: reader and writer of the container, and the signal table of recordings."""

from mufly.logs.mcap.mcap_reader import McapContents, read_mcap
from mufly.logs.mcap.mcap_writer import MAGIC, UNFINISHED_METADATA, McapWriter
from mufly.logs.mcap.signal_table import (
    FlightEvent,
    RecordingLayout,
    component_channels,
    encode_dataset_metadata,
    event_variables,
    flight_layout,
    make_dataset,
    read_events,
    restore_dataset,
    rows_to_dataset,
    to_csv,
    to_json_value,
)

__all__ = [
    "MAGIC",
    "UNFINISHED_METADATA",
    "FlightEvent",
    "McapContents",
    "McapWriter",
    "RecordingLayout",
    "component_channels",
    "encode_dataset_metadata",
    "event_variables",
    "flight_layout",
    "make_dataset",
    "read_events",
    "read_mcap",
    "restore_dataset",
    "rows_to_dataset",
    "to_csv",
    "to_json_value",
]
