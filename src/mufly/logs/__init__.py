"""What was recorded? Logs of flights and benches, ours and others', as labelled tables on one clock."""

from mufly.logs.layout import Event, standard_layout
from mufly.logs.recording import events_of, read_attachments, read_recording, to_csv

__all__ = [
    "Event",
    "events_of",
    "read_attachments",
    "read_recording",
    "standard_layout",
    "to_csv",
]
