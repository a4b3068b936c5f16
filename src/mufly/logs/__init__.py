"""What was recorded? Logs of flights and benches, ours and others', as labelled tables on one clock."""

from mufly.logs.angle_unit import UnitGuess, guess_angle_units
from mufly.logs.clock import ClockReport, check_clock, find_gaps
from mufly.logs.column_map import ColumnMap, builtin_maps, load_map
from mufly.logs.delay import Delay, body_rates_of_attitude, estimate_delay
from mufly.logs.delays import DelayReport, check_delays
from mufly.logs.detect import kind_of
from mufly.logs.faults import find_frozen, find_outliers, find_saturation
from mufly.logs.layout import Event, standard_layout
from mufly.logs.pictures import draw_channels, grouped
from mufly.logs.quality import Channel, ChannelReport, channels_of, check_channel, check_channels
from mufly.logs.raw import LogWarning, RawLog, RawTable
from mufly.logs.read import read_log, read_raw
from mufly.logs.recording import events_of, read_attachments, read_recording, to_csv
from mufly.logs.report import LogReport, channels, examine
from mufly.logs.resample import resample
from mufly.logs.write import FORMATS, write_log

__all__ = [
    "FORMATS",
    "Channel",
    "ChannelReport",
    "ClockReport",
    "ColumnMap",
    "Delay",
    "DelayReport",
    "Event",
    "LogReport",
    "LogWarning",
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
    "read_raw",
    "read_recording",
    "resample",
    "standard_layout",
    "to_csv",
    "write_log",
]
