"""What was recorded? Logs of flights and benches, ours and others', as labelled tables on one clock."""

from mufly.logs.delay import Delay, DelayReport, body_rates_of_attitude, check_delays, estimate_delay
from mufly.logs.layout import Event, Layout, columns_of, events_of, standard_layout, to_csv, to_dataset
from mufly.logs.mapping import ColumnMap, builtin_maps, load_map
from mufly.logs.mcap import McapFile, read_mcap
from mufly.logs.quality import (
    ChannelReport,
    UnitGuess,
    channels_of,
    check_channel,
    check_channels,
    find_frozen,
    find_outliers,
    find_saturation,
    guess_angle_units,
)
from mufly.logs.read import FORMATS, chosen, kind_of, read_log, read_raw, write_log
from mufly.logs.recording import read_attachments, read_recording
from mufly.logs.report import LogReport, channels, draw_channels, examine, grouped
from mufly.logs.topics import (
    Channel,
    ClockReport,
    LogWarning,
    RawLog,
    RawTable,
    check_clock,
    common_clock,
    find_gaps,
    resample,
    usable_samples,
)

__all__ = [
    "FORMATS",
    "Channel",
    "ChannelReport",
    "ClockReport",
    "ColumnMap",
    "Delay",
    "DelayReport",
    "Event",
    "Layout",
    "LogReport",
    "LogWarning",
    "McapFile",
    "RawLog",
    "RawTable",
    "UnitGuess",
    "body_rates_of_attitude",
    "builtin_maps",
    "channels",
    "channels_of",
    "check_channel",
    "check_channels",
    "check_clock",
    "check_delays",
    "chosen",
    "columns_of",
    "common_clock",
    "draw_channels",
    "estimate_delay",
    "events_of",
    "examine",
    "find_frozen",
    "find_gaps",
    "find_outliers",
    "find_saturation",
    "grouped",
    "guess_angle_units",
    "kind_of",
    "load_map",
    "read_attachments",
    "read_log",
    "read_mcap",
    "read_raw",
    "read_recording",
    "resample",
    "standard_layout",
    "to_csv",
    "to_dataset",
    "usable_samples",
    "write_log",
]
