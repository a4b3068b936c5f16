"""MCAP: reader and writer of the container, and the signal table of recordings."""

from mufly.logs.mcap.mcap_reader import McapContents, read_mcap
from mufly.logs.mcap.mcap_writer import MAGIC, UNFINISHED_METADATA_NAME, McapWriter
from mufly.logs.mcap.signal_table import (
    FlightEvent,
    RecordingLayout,
    component_channels,
    encode_dataset_metadata,
    flight_layout,
    make_dataset,
    make_event_variables,
    read_events,
    restore_dataset,
    rows_to_dataset,
    to_csv,
    to_json_value,
)

__all__ = [
    "MAGIC",
    "UNFINISHED_METADATA_NAME",
    "FlightEvent",
    "McapContents",
    "McapWriter",
    "RecordingLayout",
    "component_channels",
    "encode_dataset_metadata",
    "flight_layout",
    "make_dataset",
    "make_event_variables",
    "read_events",
    "read_mcap",
    "restore_dataset",
    "rows_to_dataset",
    "to_csv",
    "to_json_value",
]
