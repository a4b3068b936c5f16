"""MCAP: reader and writer of the container, and the signal table of recordings."""

from mufly.logs.mcap.mcap_reader import McapContents, read_mcap
from mufly.logs.mcap.mcap_writer import MAGIC, UNFINISHED_METADATA_NAME, McapWriter
from mufly.logs.mcap.signal_table import (
    FlightEvent,
    RecordingLayout,
    encode_dataset_metadata,
    make_dataset_from_channels,
    make_event_variables,
    make_flight_row_layout,
    read_events,
    restore_dataset,
    rows_to_dataset,
    split_dataset_into_channels,
    to_json_value,
    write_recording_csv,
)

__all__ = [
    "MAGIC",
    "UNFINISHED_METADATA_NAME",
    "FlightEvent",
    "McapContents",
    "McapWriter",
    "RecordingLayout",
    "encode_dataset_metadata",
    "make_dataset_from_channels",
    "make_event_variables",
    "make_flight_row_layout",
    "read_events",
    "read_mcap",
    "restore_dataset",
    "rows_to_dataset",
    "split_dataset_into_channels",
    "to_json_value",
    "write_recording_csv",
]
