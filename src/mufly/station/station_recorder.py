"""Recording of a station: every packet (tlog), and the signals of each vehicle (MCAP), written continuously.

Both files are readable up to the last second after a crash or a power failure. The MCAP is written once a second
(:class:`mufly.flight.FlightRecorder`), the tlog is flushed once a second. Each recording has its own folder::

    flights/2031-05-06_14-07-01/station.mcap     signals, messages and marks of the first vehicle
                                station-2.mcap   of the next one
                                station.tlog     all packets, both ways

A full disk ends the recording with a message; the station continues.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError, MuflyError
from mufly.flight import FlightRecorder
from mufly.link import TlogWriter
from mufly.station.remote.remote_vehicle import RemoteVehicle
from mufly.station.signal_history import StatusMessage
from mufly.version import __version__

DISK_CHECK_PERIOD_S = 5.0
MIN_DISK_BYTES = 50e6
"""Free space below which the recording ends, so that its files stay complete (bytes)."""


@dataclass(slots=True)
class _VehicleRecording:
    """The recording of one vehicle; its file is opened when the first row of signals arrives."""

    vehicle: RemoteVehicle
    vehicle_number: int
    recorder: FlightRecorder | None = None
    latest_row: NDArray[np.float64] | None = None
    last_time_s: float = -math.inf
    early_messages: tuple[StatusMessage, ...] = ()


class StationRecorder:
    """Recorder of vehicles and packets, between :meth:`start_recording` and :meth:`stop_recording`.

    Parameters
    ----------
    folder : str or Path
        Parent of the recordings' folders.
    first_here : bool
        The first recording goes into ``folder`` itself, beside the vehicle's recording, and replaces an earlier one.
    on_end : callable, optional
        Called with the reason when a recording ends by itself.
    wall_s : callable
        Clock of the day (s since 1970).

    Attributes
    ----------
    recording : bool
    path : Path or None
        Folder of the present or last recording.
    free_bytes : float
        Free disk space; NaN until determined.
    """

    def __init__(
        self,
        folder: str | Path = "flights",
        *,
        first_here: bool = False,
        on_end: Callable[[str], None] | None = None,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        self.folder = Path(folder)
        self.recording = False
        self.path: Path | None = None
        self.free_bytes = math.nan
        self._on_end, self._wall_s = on_end, wall_s
        self._here = first_here
        self._tracks: dict[int, _VehicleRecording] = {}
        self._tlog: TlogWriter | None = None
        self._looked_s = -math.inf

    def start_recording(self) -> None:
        """Start a recording in its own folder.

        Raises
        ------
        InputError
            If the folder or a file cannot be created.
        """
        if self.recording:
            return
        path = self.folder if self._here else self._make_dated_folder()
        try:
            path.mkdir(parents=True, exist_ok=self._here)
            self._here = False
            self._tlog = TlogWriter(path / "station.tlog")
        except OSError as error:
            problem = f"cannot be written ({error.strerror})"
            raise InputError(str(path), "", problem, "choose another folder") from error
        self.path, self.recording = path, True
        self._looked_s = -math.inf

    def _make_dated_folder(self) -> Path:
        """Return a new folder name from the date and time."""
        stamp = datetime.fromtimestamp(self._wall_s()).strftime("%Y-%m-%d_%H-%M-%S")
        path, k = self.folder / stamp, 1
        while path.exists():  # another station, or two starts within a second
            k += 1
            path = self.folder / f"{stamp}_{k}"
        return path

    def stop_recording(self, outcome: str = "stopped", reason: str = "") -> None:
        """Close the files of the recording with an outcome."""
        if not self.recording:
            return
        self.recording = False
        faults = []
        for track in self._tracks.values():
            recorder, track.recorder, track.last_time_s = track.recorder, None, -math.inf
            if recorder is not None:
                recorder.set_outcome(outcome, reason)
                try:
                    recorder.close()
                except MuflyError as error:
                    faults.append(str(error))
        if self._tlog is not None:
            try:
                self._tlog.close()
            except OSError as error:
                faults.append(f"{self.path}: the tlog cannot be written ({error.strerror})")
            self._tlog = None
        if faults and self._on_end is not None and not reason:
            self._on_end(faults[0])

    def attach_vehicle(self, vehicle: RemoteVehicle) -> None:
        """Add a vehicle to all present and later recordings."""
        track = _VehicleRecording(vehicle, len(self._tracks) + 1)
        self._tracks[id(vehicle)] = track
        vehicle.telemetry.on_row = lambda time_s, values, state: self._record_row(track, time_s, values, state)
        vehicle.texts.on_message = lambda message: self._record_message(track, message)
        vehicle.on_mark = lambda text: self.recording

    def record_packet(self, data: bytes) -> None:
        """Record a packet, in the order of reception and sending."""
        if self._tlog is None:
            return
        try:
            self._tlog.write_packet(data, int(self._wall_s() * 1e6))
        except OSError as error:
            self._abort_recording(f"the tlog cannot be written ({error.strerror})")

    def add_mark(self, text: str) -> bool:
        """Add a mark to the recordings of all vehicles; return False if none runs."""
        for track in self._tracks.values():
            track.vehicle.add_mark(text)
        return self.recording

    def check_disk_space_if_due(self, now_s: float) -> None:
        """Check the free disk space periodically."""
        if now_s - self._looked_s >= DISK_CHECK_PERIOD_S:
            self._looked_s = now_s
            self._check_disk()

    def _check_disk(self) -> None:
        place = self.path or self.folder
        while not place.exists() and place != place.parent:
            place = place.parent
        with contextlib.suppress(OSError):
            self.free_bytes = float(shutil.disk_usage(place).free)
        if self.recording and self.free_bytes < MIN_DISK_BYTES:
            self._abort_recording(f"the disk is full ({self.free_bytes / 1e6:.0f} MB left)")

    def _record_row(self, track: _VehicleRecording, time_s: float, values: NDArray[np.float64], state: str) -> None:
        if not self.recording or not time_s > track.last_time_s:
            return
        try:
            if track.recorder is None:
                self._open_vehicle_recording(track, time_s)
            assert track.recorder is not None
            assert track.latest_row is not None
            track.latest_row[0] = time_s
            track.latest_row[1:] = values
            track.recorder.append_row(track.latest_row, state)
            track.last_time_s = time_s
        except MuflyError as error:
            self._abort_recording(str(error))

    def _open_vehicle_recording(self, track: _VehicleRecording, time_s: float) -> None:
        assert self.path is not None
        name = "station.mcap" if track.vehicle_number == 1 else f"station-{track.vehicle_number}.mcap"
        layout = track.vehicle.history.layout
        track.recorder = FlightRecorder(
            self.path / name,
            {
                "vehicle": track.vehicle.display_name,
                "system": track.vehicle.system,
                "recorded_by": "station",
                "version": __version__,
                "range_first_angle_rad": _first_beam_angle(track.vehicle),
                "range_max_m": track.vehicle.telemetry.ranges.max_range_m,
            },
            layout=layout,
            start_time_ns=int((self._wall_s() - time_s) * 1e9),
            keep=False,
        )
        track.latest_row = np.full(layout.column_count, math.nan)
        for message in track.early_messages:
            self._record_event(track, message, time_s)
        track.early_messages = ()

    def _record_message(self, track: _VehicleRecording, message: StatusMessage) -> None:
        if not self.recording:
            return
        if track.recorder is None:
            track.early_messages = (*track.early_messages[-20:], message)  # received before the first row
        else:
            self._record_event(track, message, track.last_time_s)

    def _record_event(self, track: _VehicleRecording, message: StatusMessage, otherwise_s: float) -> None:
        assert track.recorder is not None
        time_s = message.time_s if math.isfinite(message.time_s) else otherwise_s
        track.recorder.add_event(time_s, track.vehicle.telemetry.mission_state_or_mode, message.text, message.level)

    def _abort_recording(self, why: str) -> None:
        """End the recording because of a fault."""
        self.stop_recording("interrupted", why)
        text = f"the recording has ended: {why}"
        for track in self._tracks.values():
            track.vehicle.add_note("error", text)
        if self._on_end is not None:
            self._on_end(text)


def _first_beam_angle(vehicle: RemoteVehicle) -> float:
    angles = vehicle.telemetry.ranges.angles_rad
    return float(angles[0]) if len(angles) else math.nan
