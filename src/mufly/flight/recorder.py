"""The recorder: rows of a flight into a file that can be cut off at any moment.

A row is copied into a block; once a second of recorded time the block goes to disk as one finished chunk of an
MCAP file. A crash, a full disk or a pulled plug costs at most the second that was being collected.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
import orjson
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.flight.encoder import Encoder
from mufly.logs.mcap_file import McapFile
from mufly.logs.recording import (
    FORMAT,
    METADATA_FLIGHT,
    METADATA_LAYOUT,
    METADATA_OUTCOME,
    Event,
    Layout,
    seal,
    standard_layout,
    to_dataset,
)

__all__ = ["Recorder"]

BLOCK_S = 1.0
BLOCK_ROWS = 1024


class Recorder:
    """Record a flight, row by row.

    Parameters
    ----------
    path : str, Path or None
        MCAP file to write (overwritten); None records to memory only.
    attributes : mapping, optional
        Vehicle name, mission name, seed, wind, versions, ...: whatever JSON can hold. ``start_time`` (ISO 8601,
        UTC), ``start_time_ns`` and ``format`` are added.
    layout : Layout, optional
        Columns of a row; default :func:`standard_layout` with eight beams.
    attachments : mapping, optional
        Texts to carry along, ``{"mission.toml": ..., "vehicle.toml": ...}``.
    scene_view : mapping, optional
        Keyword arguments of :func:`mufly.flight.scene.scene_message`: what the 3-D view shows.
    start_time_ns : int, optional
        Wall time of the instant 0 (ns since 1970); default now.
    keep : bool
        Keep all rows in memory for :meth:`dataset`; without it a flight of hours needs no more than one of seconds.

    Raises
    ------
    InputError
        The file cannot be created, or an attribute is nothing that JSON can hold.

    Notes
    -----
    Use as a context manager. Leaving the block by an exception finishes the file as well, with the outcome
    "interrupted" (Ctrl-C) or "crashed".
    """

    def __init__(
        self,
        path: str | Path | None,
        attributes: Mapping[str, Any] | None = None,
        *,
        layout: Layout | None = None,
        attachments: Mapping[str, str | bytes] | None = None,
        scene_view: Mapping[str, Any] | None = None,
        start_time_ns: int | None = None,
        keep: bool = True,
    ) -> None:
        self._keep = keep
        self.layout = layout or standard_layout()
        self.start_time_ns = time.time_ns() if start_time_ns is None else start_time_ns
        started = datetime.fromtimestamp(self.start_time_ns / 1e9, UTC).isoformat(timespec="milliseconds")
        clock = {"start_time": started, "start_time_ns": self.start_time_ns, "format": FORMAT}
        self._attributes: dict[str, Any] = {**(attributes or {}), **clock}
        self._outcome: dict[str, Any] = {"outcome": "unfinished", "reason": ""}
        self._block = np.empty((BLOCK_ROWS, self.layout.width))
        self._states: list[str] = []
        self._n = 0
        self._flush_at = -np.inf
        self._last_time = -np.inf
        self._events: list[Event] = []
        self._all_rows: list[NDArray[np.float64]] = []
        self._all_states: list[str] = []
        self._all_events: list[Event] = []
        self._closed = False
        self._path = None if path is None else Path(path)
        self._stream: BinaryIO | None = None
        if self._path is not None:
            self._open(self._path, attachments or {}, scene_view or {})

    def _open(
        self, path: Path, attachments: Mapping[str, str | bytes], scene_view: Mapping[str, Any]
    ) -> None:
        values = _json_values(str(path), self._attributes)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("wb")
        except OSError as error:
            problem = f"cannot be written ({error.strerror})"
            raise InputError(str(path), "", problem, "choose another folder") from error
        self._file = McapFile(self._stream, f"mufly {self._attributes.get('version', '')}".strip())
        self._encoder = Encoder(self._file, self.layout, self.start_time_ns)
        self._file.write_metadata(METADATA_FLIGHT, seal(values))
        self._file.write_metadata(METADATA_LAYOUT, seal({"layout": self.layout.to_json()}))
        for name, content in attachments.items():
            data = content.encode() if isinstance(content, str) else bytes(content)
            self._file.write_attachment(name, "text/plain", data, self.start_time_ns)
        self._file.write_chunk([self._encoder.scene(scene_view)])

    def append(self, row: NDArray[np.float64], state: str) -> None:
        """Add one instant.

        Parameters
        ----------
        row : (layout.width,) float64 array
            Time (s) and the columns of the layout; copied. Times must increase.
        state : str
            State of the mission.
        """
        if row[0] >= self._flush_at or self._n == BLOCK_ROWS:
            self._roll(float(row[0]))
        self._block[self._n] = row
        self._states.append(state)
        self._n += 1

    def event(self, time_s: float, state: str, text: str, level: str = "info") -> None:
        """Add an event: a transition, a warning (``level="warning"``) or an error."""
        self._events.append(Event(float(time_s), state, text, level))

    def finish(self, outcome: str, reason: str = "", **attributes: Any) -> None:
        """State how the flight ended; written when the recorder closes, with any further attributes."""
        self._outcome = {"outcome": outcome, "reason": reason, **attributes}

    def close(self) -> None:
        """Write what is left, the outcome, the index and the end mark. Closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        if self._stream is None:
            self._roll(np.inf)
            return
        try:
            self._roll(np.inf)
            outcome = _json_values(str(self._path), self._outcome)
            self._file.write_metadata(METADATA_OUTCOME, seal(outcome))
            self._file.finish()
        except OSError as error:
            raise self._write_error(error) from error
        finally:
            with suppress(OSError):  # what the buffer could not get rid of on a full disk
                self._stream.close()

    def dataset(self) -> xr.Dataset:
        """The flight so far, as :func:`mufly.flight.read_recording` would return it.

        Raises
        ------
        MuflyError
            The rows were not kept in memory.
        """
        if not self._keep:
            raise MuflyError(f"the rows were not kept in memory; read {self._path or 'a recording on disk'}")
        rows = np.concatenate([*self._all_rows, self._block[: self._n]])
        attributes = {**self._attributes, **(self._outcome if self._closed else {}), "complete": self._closed}
        return to_dataset(
            rows,
            self._all_states + self._states,
            self.layout,
            attributes=attributes,
            events=self._all_events + self._events,
        )

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and self._outcome["outcome"] == "unfinished":
            stopped = isinstance(error, KeyboardInterrupt)
            self.finish("interrupted" if stopped else "crashed", "" if stopped else str(error))
        self.close()

    def _roll(self, time_s: float) -> None:
        """Put the block on disk and begin the next one at ``time_s``."""
        rows = self._block[: self._n].copy()
        times = np.concatenate(([self._last_time], rows[:, 0]))
        wrong = ~(np.diff(times) > 0)
        if wrong.any():
            first = int(wrong.argmax())
            self._n, self._states = first, self._states[:first]  # the sound rows still reach the disk
            raise MuflyError(
                f"rows of a recording must follow each other in time: {times[first + 1]:g} s came after "
                f"{times[first]:g} s"
            )
        states, events = self._states, self._events
        if self._stream is not None and (len(rows) or events):
            try:
                self._file.write_chunk(self._encoder.messages(rows, states, events))
            except OSError as error:
                raise self._write_error(error) from error
        # Nothing here calls out, so that Ctrl-C falls before or after these lines, not between them.
        self._n = 0
        self._states = []
        self._events = []
        self._last_time = times[-1]
        self._flush_at = time_s + BLOCK_S
        if self._keep:
            self._all_rows += (rows,)
            self._all_states += states
            self._all_events += events

    def _write_error(self, error: OSError) -> MuflyError:
        return MuflyError(f"{self._path}: the recording cannot be written ({error.strerror})")


def _json_values(where: str, content: Mapping[str, Any]) -> dict[str, str]:
    """Attributes as MCAP metadata: every value is JSON."""
    out: dict[str, str] = {}
    for key, value in content.items():
        try:
            out[key] = orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY).decode()
        except TypeError as error:
            problem = f"cannot be recorded ({error})"
            raise InputError(where, key, problem, "give text, numbers, lists or tables") from error
    return out
