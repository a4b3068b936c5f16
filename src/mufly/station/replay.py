"""A finished recording behind the interface of a vehicle, with playback and a time slider.

:func:`open_recording` reads any log that :func:`mufly.logs.read_log` reads. A :class:`Replay` is one viewer's position
in a recording; many may share one :class:`FlightRecording`. The vehicle's own estimate is taken from ``estimated_*`` if
recorded, else from ``measured_*``, else from ``truth_*``.
"""

from __future__ import annotations

import bisect
import math
import tomllib
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.flight.tunable_parameters import TunableParameter
from mufly.logs import detect_log_format, read_attachments, read_events, read_log
from mufly.logs.mcap import split_dataset_into_channels
from mufly.mission import Mission, parse_mission
from mufly.quantities.quantity_table import find_quantity
from mufly.station.signal_history import (
    MissionRow,
    PreflightCheck,
    StatusMessage,
    VehicleSnapshot,
    make_unknown_values,
)

MOTION_SOURCES = ("estimated", "measured", "truth")
"""Sources of the vehicle's motion, by priority."""
MIN_AIRBORNE_HEIGHT_M = 0.02

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlightRecording:
    """A log, read into memory.

    Attributes
    ----------
    name : str
        Name of the file.
    times_s : (n,) array
        s, increasing.
    columns : dict of str to (n,) array
        Flat names as in :mod:`mufly.quantities.quantity_table` (``measured_attitude_roll``), SI units.
    units : dict of str to str
        Unit of each column.
    mission_states : (n,) array of str
        State of the mission machine, or "".
    messages : tuple of StatusMessage
    mission : Mission or None
        The mission flown, with its world, if the file contains it.
    range_angles : (b,) array
        Directions of the range beams from the nose to the right (rad).
    range_max_m : float
        Range of a beam that detects nothing (m).
    recording_facts : dict
        Vehicle, outcome and other facts stated by the file.
    """

    name: str
    times_s: _Array
    columns: dict[str, _Array]
    units: dict[str, str]
    mission_states: NDArray[Any]
    messages: tuple[StatusMessage, ...]
    mission: Mission | None
    range_angles: _Array
    range_max_m: float
    recording_facts: dict[str, Any]


def open_recording(path: str | Path, progress: Callable[[int, int], None] | None = None) -> FlightRecording:
    """Read a recording of any known format.

    Parameters
    ----------
    path : str or Path
        MCAP, ULog, tlog, DataFlash, CSV, Parquet or NetCDF.
    progress : callable, optional
        Called with (bytes read, bytes in all).

    Raises
    ------
    InputError
        If the file is no log, or has no signal that mufly names.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # repairs are in the attribute "notes", shown with the facts
        data = read_log(path, progress=progress)
    times = data["time"].values.astype(np.float64)
    if not len(times):
        raise InputError(str(path), "", "contains no samples", "choose another recording")
    numbers = [c for c in split_dataset_into_channels(data) if c.values.dtype.kind in "fiub"]
    columns = {c.column_name: c.values.astype(np.float64) for c in numbers}
    states = np.full(len(times), "")
    if "mission_state" in data:
        states = data["mission_state"].values.astype(str)
    has_events = all(f"event_{part}" in data for part in ("time", "state", "text", "level"))
    messages = [StatusMessage(e.time_s, e.level, e.text) for e in read_events(data)] if has_events else []
    vehicle, mission = _read_vehicle_and_mission(path)
    beams = sum(1 for name in columns if name.startswith("range_"))
    ring = vehicle.get("range_ring", {})
    first = _number_or_default(ring.get("first_angle"), math.pi / beams if beams else 0.0)
    farthest = _number_or_default(ring.get("max_range"), _largest_range(columns, beams))
    return FlightRecording(
        name=Path(path).name,
        times_s=times,
        columns=columns,
        units={c.column_name: c.units for c in numbers},
        mission_states=states,
        messages=tuple(sorted(messages, key=lambda m: m.time_s)),
        mission=mission,
        range_angles=first + 2.0 * math.pi * np.arange(beams) / max(beams, 1),
        range_max_m=farthest,
        recording_facts=dict(data.attrs),
    )


def _read_vehicle_and_mission(path: str | Path) -> tuple[dict[str, Any], Mission | None]:
    """Return the vehicle's tables and the mission of a recording; empty and None if absent."""
    if detect_log_format(path) != "MCAP":
        return {}, None
    attachments = read_attachments(path)
    vehicle: dict[str, Any] = {}
    mission: Mission | None = None
    try:
        vehicle = tomllib.loads(attachments.get("vehicle.toml", b"").decode())
        if "mission.toml" in attachments:
            mission = parse_mission(tomllib.loads(attachments["mission.toml"].decode()), str(path))
    except (ValueError, InputError):
        pass  # a file of an incompatible version is shown without its world
    return vehicle, mission


def _number_or_default(entry: Any, otherwise: float) -> float:
    value = entry.get("value") if isinstance(entry, dict) else entry
    return float(value) if isinstance(value, int | float) else otherwise


def _largest_range(columns: dict[str, _Array], beams: int) -> float:
    seen = [columns[f"range_{k}"] for k in range(beams) if f"range_{k}" in columns]
    finite = [float(np.nanmax(c)) for c in seen if np.isfinite(c).any()]
    return max(finite, default=math.nan)


def make_mission_rows(mission: Mission, reached: int = 0) -> list[MissionRow]:
    """Return the mission table of a mission file: take-off, its waypoints, landing.

    Parameters
    ----------
    mission : Mission
    reached : int
        Number of rows that the vehicle has passed.
    """
    climb = mission.take_off
    rows = [MissionRow("take off", (*mission.start_m, -climb.height_m), wait_s=climb.wait_s)]
    for w in mission.waypoint:
        heading = math.nan if w.heading_deg is None else math.radians(w.heading_deg)
        rows.append(MissionRow("waypoint", w.position_m, heading, w.wait_s))
    rows.append(MissionRow("land", (*rows[-1].position[:2], 0.0)))
    return [replace(row, reached=k < reached) for k, row in enumerate(rows)]


class ReplayHistory:
    """Signals of a recording up to the displayed time; read like :class:`mufly.station.signal_history.SignalHistory`.

    Attributes
    ----------
    extra_values : callable
        Returns values at given times of a signal missing in the recording; None if unknown.
    """

    def __init__(self, recording: FlightRecording) -> None:
        self._recording = recording
        self.names = tuple(recording.columns)
        self.end = len(recording.times_s)
        self.extra_values: Callable[[str, _Array], _Array | None] = lambda name, times: None

    def signal_unit(self, name: str) -> str:
        """Return the unit of a signal, "1" for a pure number."""
        return self._recording.units.get(name, "1")

    def rows_since(self, time_s: float, names: Sequence[str]) -> tuple[_Array, _Array]:
        """Return the times (n,) later than ``time_s`` and the values (n, k) of ``names``; unknown names are NaN."""
        first = int(np.searchsorted(self._recording.times_s[: self.end], time_s, side="right"))
        times = self._recording.times_s[first : self.end]
        values = np.full((len(times), len(names)), math.nan)
        for k, name in enumerate(names):
            if name in self._recording.columns:
                values[:, k] = self._recording.columns[name][first : self.end]
            elif (found := self.extra_values(name, times)) is not None:
                values[:, k] = found
        return times, values

    def recent_rows(self, seconds: float, names: Sequence[str]) -> tuple[_Array, _Array]:
        """Return the rows of the last ``seconds``, as :meth:`rows_since`."""
        newest_s = self._recording.times_s[self.end - 1] if self.end else 0.0
        return self.rows_since(float(newest_s) - seconds - 1e-9, names)


class Replay:
    """One viewer's position in a recording: the read interface of a vehicle, with play, pause, speed and a slider.

    Attributes
    ----------
    recording : FlightRecording
    name : str
        Name of the recording's file.
    start_s, end_s, time_s : float
        First, last and displayed time (s).
    history : ReplayHistory
    playing : bool
    speed : float
        Playback speed: recorded seconds per second.
    jumps : int
        Number of slider moves, so that a plot knows when to restart.
    """

    kind = "recording"
    system = 0
    color = 0
    missing_parameter_count = 0

    def __init__(self, recording: FlightRecording) -> None:
        self.recording, self.name = recording, recording.name
        self.start_s, self.end_s = float(recording.times_s[0]), float(recording.times_s[-1])
        self.history = ReplayHistory(recording)
        self.playing = False
        self.speed = 1.0
        self.jumps = 0
        self.parameters: dict[str, TunableParameter] = {}
        self.preflight_checks: list[PreflightCheck] = []
        self._rows = make_mission_rows(recording.mission) if recording.mission is not None else []
        # A change of state to "hover" after a leg marks a reached mission row.
        states = recording.mission_states
        legs = {"waypoint", "obstacle", "take-off"}
        turned = [k for k in range(1, len(states)) if states[k] == "hover" and states[k - 1] in legs]
        self._reached_at = [float(recording.times_s[k]) for k in turned]
        self.seek(self.start_s)

    def seek(self, time_s: float) -> None:
        """Set the displayed time (s), clipped to the recording."""
        self._set_displayed_time(time_s)
        self.jumps += 1

    def play(self) -> None:
        """Start playback; from the beginning if at the end."""
        if self.time_s >= self.end_s:
            self.seek(self.start_s)
        self.playing = True

    def pause(self) -> None:
        """Pause playback."""
        self.playing = False

    def advance_playback(self, seconds: float) -> None:
        """Advance playback by ``seconds`` of wall-clock time."""
        if self.playing:
            self._set_displayed_time(self.time_s + seconds * self.speed)
            if self.time_s >= self.end_s:
                self.playing = False

    def _set_displayed_time(self, time_s: float) -> None:
        self.time_s = min(max(time_s, self.start_s), self.end_s) if math.isfinite(time_s) else self.start_s
        self.history.end = int(np.searchsorted(self.recording.times_s, self.time_s, side="right"))

    @property
    def status_messages(self) -> list[StatusMessage]:
        """Return the status messages up to the displayed time."""
        known = self.recording.messages
        return list(known[: bisect.bisect_right([m.time_s for m in known], self.time_s)])

    @property
    def passed_row_count(self) -> int:
        """Return the number of mission rows reached at the displayed time."""
        return min(bisect.bisect_right(self._reached_at, self.time_s), len(self._rows))

    @property
    def mission_rows(self) -> list[MissionRow]:
        """Return the mission table at the displayed time."""
        if self.recording.mission is None:
            return []
        landed = self.time_s >= self.end_s and self.recording.recording_facts.get("outcome") == "succeeded"
        return make_mission_rows(self.recording.mission, len(self._rows) if landed else self.passed_row_count)

    @property
    def snapshot(self) -> VehicleSnapshot:
        """Return the vehicle's state at the displayed time."""
        recording, progress = self.recording, self.passed_row_count
        beams = [f"range_{b}" for b in range(len(recording.range_angles))]
        motors = self._value_at_displayed_time("motor_input")
        s = VehicleSnapshot.from_signals(
            self._value_at_displayed_time,
            MOTION_SOURCES,
            self.time_s,
            self._row_values(beams),
            connected=True,
            silent_s=0.0,
            armed=bool(np.nanmax(np.nan_to_num(motors)) > 0.0),
            state=str(recording.mission_states[self._row_index]),
            range_angles=recording.range_angles,
            range_max_m=recording.range_max_m,
            mission_row=progress if progress < len(self._rows) else None,
        )
        # Not flying, if the recording lacks the ground height.
        return replace(s, flying=bool(s.estimate.position[2] < self._initial_down_m - MIN_AIRBORNE_HEIGHT_M))

    @property
    def _row_index(self) -> int:
        return max(self.history.end - 1, 0)

    def _value_at_displayed_time(self, name: str) -> _Array:
        """Return a variable at the displayed time; NaN if not recorded."""
        known = find_quantity(name)
        labels = known.component_labels if known is not None else ()
        return self._row_values([f"{name}_{label}" for label in labels] or [name])

    def _row_values(self, names: Sequence[str]) -> _Array:
        columns = self.recording.columns
        return np.array([columns[name][self._row_index] if name in columns else math.nan for name in names])

    @cached_property
    def _initial_down_m(self) -> float:
        """Return the first known coordinate D (m) in the recording; NaN if there is none."""
        columns = [
            self.recording.columns.get(f"{source}_position_D", make_unknown_values(0)) for source in MOTION_SOURCES
        ]
        return next((float(c[np.isfinite(c)][0]) for c in columns if np.isfinite(c).any()), math.nan)
