"""What was recorded? Logs of flights and benches, ours and others', as labelled tables on one clock."""

from mufly.logs.column_map import ColumnMap, builtin_maps, load_map
from mufly.logs.layout import Event, standard_layout
from mufly.logs.raw import LogWarning, RawLog, RawTable
from mufly.logs.read import kind_of, read_log, read_raw
from mufly.logs.recording import events_of, read_attachments, read_recording, to_csv
from mufly.logs.write import write_log

__all__ = [
    "ColumnMap",
    "Event",
    "LogWarning",
    "RawLog",
    "RawTable",
    "builtin_maps",
    "events_of",
    "kind_of",
    "load_map",
    "read_attachments",
    "read_log",
    "read_raw",
    "read_recording",
    "standard_layout",
    "to_csv",
    "write_log",
]
