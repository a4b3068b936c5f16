"""Lines for people: STATUSTEXT, cut into pieces of 50 bytes where a line is longer.

The pieces of a line carry the same id and count from 0; the last one is the first that is not full
(https://mavlink.io/en/messages/common.html#STATUSTEXT).
"""

from __future__ import annotations

from mufly.link.dialect import MavMessage, mavlink

__all__ = ["LONGEST", "SEVERITY", "Texts"]

_PIECE = 50
LONGEST = 400
"""Bytes of the longest line; what is beyond is cut."""
SEVERITY = {
    "error": mavlink.MAV_SEVERITY_ERROR,
    "warning": mavlink.MAV_SEVERITY_WARNING,
    "info": mavlink.MAV_SEVERITY_INFO,
}


class Texts:
    """Makes messages of lines."""

    def __init__(self) -> None:
        self._last_id = 0

    def __call__(self, text: str, level: str = "info") -> list[MavMessage]:
        """Return the messages that carry a line, in order; ``level`` is "info", "warning" or "error"."""
        severity = SEVERITY.get(level, mavlink.MAV_SEVERITY_INFO)
        data = " ".join(text.split()).encode(errors="replace")[:LONGEST]
        if len(data) <= _PIECE:
            return [mavlink.MAVLink_statustext_message(severity, data)]
        self._last_id = self._last_id % 65535 + 1
        pieces = [data[k : k + _PIECE] for k in range(0, len(data), _PIECE)]
        if len(pieces[-1]) == _PIECE:
            pieces.append(b"")  # so that there is one that is not full
        return [
            mavlink.MAVLink_statustext_message(severity, piece, self._last_id, k)
            for k, piece in enumerate(pieces)
        ]
