"""Telemetry log, written as it comes: each packet behind the time of its arrival or departure.

Eight bytes, big-endian, count microseconds since 1970; the packet follows as it is on the air. That is what every
ground station for MAVLink reads, and :func:`mufly.logs.read_log`. The file is flushed every second, so that a process
that is killed loses no more.
"""

from __future__ import annotations

import struct
import time
from pathlib import Path
from types import TracebackType

from mufly.errors import InputError

__all__ = ["TlogWriter"]

FLUSH_S = 1.0
_STAMP = struct.Struct(">Q")


class TlogWriter:
    """An open telemetry log.

    Parameters
    ----------
    path : str or Path
        Its folder is made if need be; a file of that name is replaced.

    Raises
    ------
    InputError
        If it cannot be written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._flushed_s = time.monotonic()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("wb")
        except OSError as error:
            raise InputError(
                str(self.path), "", f"cannot be written ({error.strerror})", "give another folder"
            ) from error

    def write(self, packet: bytes, time_us: int | None = None) -> None:
        """Add one packet.

        Parameters
        ----------
        packet : bytes
            One frame of MAVLink.
        time_us : int, optional
            Microseconds since 1970; by default now.
        """
        self._file.write(_STAMP.pack(time.time_ns() // 1000 if time_us is None else time_us) + packet)
        now_s = time.monotonic()
        if now_s - self._flushed_s >= FLUSH_S:
            self._flushed_s = now_s
            self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        self._file.close()

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
