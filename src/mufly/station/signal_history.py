"""Data types of a station's vehicle, and its signal history: the interface between links and pages.

A page draws a :class:`VehicleSnapshot` and a :class:`mufly.station.signal_history.SignalHistory`. Their source is a
radio, the simulated helicopter or a recording. Units SI and radians, axes N-E-D and body x-y-z.
Unknown values are NaN (arrays), None or empty text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.estimate import Estimate
from mufly.flight import Actuators, FlightState
from mufly.logs.mcap import RecordingLayout
from mufly.quantities.quantity_table import quantities_recorded_in

_Array = NDArray[np.float64]


def make_unknown_values(n: int) -> _Array:
    """Return ``n`` unknown values (NaN), shape (n,)."""
    return np.full(n, math.nan)


@dataclass(frozen=True, slots=True)
class VehicleSnapshot(FlightState):
    """State of a vehicle as known to a station, with the state of the link and the commander.

    A vehicle publishes part of a flight's state; for other autopilots ``state`` is the flight mode in words.
    ``mission_begun`` is true for a mission that is being flown or can be resumed.

    Attributes
    ----------
    connected : bool
        Whether the vehicle was heard in the last three seconds; always true in a recording.
    silent_s : float
        Time since the last message (s).
    in_command : bool
        Whether this station commands the vehicle; otherwise it only monitors.
    commander : str
        Commander of the vehicle, as text; "" if none or unknown.
    rotor_speed : (2,) array
        Upper, lower (rad/s), as measured or, in a simulation, in truth.
    range_angles : (n,) array
        Directions of the range beams from the nose to the right (rad).
    range_max_m : float
        Range of a beam that detects nothing (m).
    mission_row : int or None
        Active row of the mission table.
    link_loss, link_rate_Hz : float
        Recent share of packets lost (0..1); message rate (Hz).
    real_time_factor : float
        Recent seconds of the vehicle's clock per second here, as published or from its time stamps. Below
        :data:`mufly.link.SLOW_REAL_TIME_FACTOR` the simulation is slower than real time.
    timing_overrun_count : int or None
        Number of times the vehicle skipped time that it could not make up; None if not published.
    """

    connected: bool = False
    silent_s: float = math.inf
    in_command: bool = False
    commander: str = ""
    rotor_speed: _Array = field(default_factory=lambda: make_unknown_values(2))
    range_angles: _Array = field(default_factory=lambda: make_unknown_values(0))
    range_max_m: float = math.nan
    mission_row: int | None = None
    link_loss: float = math.nan
    link_rate_Hz: float = math.nan
    real_time_factor: float = math.nan
    timing_overrun_count: int | None = None

    @classmethod
    def from_signals(
        cls,
        signal: Callable[[str], _Array],
        sources: Sequence[str],
        time_s: float,
        ranges: _Array,
        **others: Any,
    ) -> VehicleSnapshot:
        """Return the snapshot from published or recorded signals.

        Parameters
        ----------
        signal : callable
            Returns the value of a variable of :mod:`mufly.quantities.quantity_table`; NaN if unknown.
        sources : sequence of str
            Sources of the motion by priority: "estimated", "measured", "truth".
        time_s : float
        ranges : (n,) array
            Distances along the beams (m).
        **others
            Fields that are no such variables.
        """

        def select_most_complete_values(name: str, sources: Sequence[str]) -> _Array:
            told = [signal(f"{source}_{name}") for source in sources]
            # The source with most components; of equals the first.
            return max(told, key=lambda v: sum(map(math.isfinite, v.tolist())))

        x, v, angles, rates = (
            select_most_complete_values(name, sources) for name in ("position", "velocity", "attitude", "rates")
        )
        return cls(
            time_s=time_s,
            estimate=Estimate(time_s, x, v, angles, rates, ranges, float(signal("battery_voltage")[0])),
            reference_position=signal("reference_position"),
            reference_velocity=signal("reference_velocity"),
            reference_attitude=signal("reference_attitude"),
            actuators=Actuators(signal("motor_input"), signal("servo_input")),
            rotor_speed=select_most_complete_values("rotor_speed", ("measured", "truth")),
            battery_current=float(signal("battery_current")[0]),
            battery_charge=float(signal("battery_charge")[0]),
            **others,
        )


def format_minutes_seconds(seconds: float) -> str:
    """Return a time as minutes and seconds: "1:18"; "-" if unknown."""
    if not math.isfinite(seconds):
        return "-"
    whole = max(0, math.floor(seconds + 0.5))
    return f"{whole // 60}:{whole % 60:02d}"


@dataclass(frozen=True, slots=True)
class StatusMessage:
    """One line of the message log; ``level`` is "info", "warning" or "error", as in a recording's events."""

    time_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class MissionRow:
    """One row of the mission table.

    Attributes
    ----------
    action : str
        "take off", "waypoint", "speed", "land", "return", ...
    position : (3,) tuple
        N, E, D (m); NaN if the action has no position.
    heading_rad : float
        NaN: the nose points along the track.
    wait_s : float
    reached : bool
    text : str
        Further settings ("0.4 m/s").
    """

    action: str
    position: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    heading_rad: float = math.nan
    wait_s: float = 0.0
    reached: bool = False
    text: str = ""


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One preflight check; ``ok`` is None if undecided."""

    name: str
    ok: bool | None
    text: str


class RequestOutcome(StrEnum):
    """Outcome of a request to a vehicle: waiting, accepted, refused or timed out."""

    WAITING = "waiting"
    ACCEPTED = "accepted"
    REFUSED = "refused"
    TIMED_OUT = "timed out"


@dataclass(slots=True)
class OperatorRequest:
    """A request to the vehicle, with its outcome and answer.

    Attributes
    ----------
    text : str
        Description of the request: "take off to 1 m".
    outcome : RequestOutcome
    answer : str
        Reason given by the vehicle, or the error.
    progress : float
        Progress of a transfer (0..1).
    result : object
        Downloaded content.
    """

    text: str
    outcome: RequestOutcome = RequestOutcome.WAITING
    answer: str = ""
    progress: float = 0.0
    result: Sequence[Any] | None = None

    @property
    def is_done(self) -> bool:
        """Return whether the request is answered."""
        return self.outcome is not RequestOutcome.WAITING

    def set_outcome(self, outcome: RequestOutcome, answer: str = "") -> None:
        """Set outcome and answer of the request; only the first call has an effect."""
        if not self.is_done:
            self.outcome, self.answer = outcome, answer
            if outcome is RequestOutcome.ACCEPTED:
                self.progress = 1.0


# ----------------------------------------------------------------------------
# The station's signals of a vehicle: the last ten minutes of every signal, and the present values.
#
# Signals are the quantities (:mod:`mufly.quantities.quantity_table`) of a flight's recording and those that a vehicle
# sends over a link: its estimates (``estimated_``), measured rotor speeds, the pilot's sticks and the link quality. As
# plain columns they are named ``variable_label`` (``estimated_position_N``).


MAX_KEPT_BEAMS = 8
"""Number of range beams kept; ranges of a vehicle with more beams are shown, but not kept."""
PILOT_CHANNEL_COUNT = 8
_MAX_HEADING_RAD = 1e4
"""Largest plausible heading (rad)."""
SIGNAL_TIMEOUT_S = 1.5
"""Age at which a signal becomes unknown (s)."""
SLOW_SIGNAL_TIMEOUT_S = 6.0
"""Age limit of signals sent once a second or less: battery, link (s)."""
_SLOW_GROUPS = ("battery", "link")


def make_station_layout() -> RecordingLayout:
    """Return the layout of a vehicle's history and recordings."""
    labels = (("channel", tuple(range(1, PILOT_CHANNEL_COUNT + 1))),)
    return RecordingLayout(quantities_recorded_in("flight", "station"), MAX_KEPT_BEAMS, labels)


def _signal_units(layout: RecordingLayout) -> dict[str, str]:
    """Return the unit of every column after the time, by name (``truth_position_N``)."""
    out: dict[str, str] = {}
    for q in layout.quantities:
        out |= dict.fromkeys(
            [f"{q.name}_{label}" for label in layout.component_labels(q)] if q.dim else [q.name], q.units
        )
    return out


class SignalHistory:
    """The last ten minutes of signals, in bounded memory.

    A ring buffer holds rows of numbers on one clock. Times are float64 (a float32 clock has a resolution of 8 ms after
    a day), values float32, with seven digits.

    Parameters
    ----------
    layout : RecordingLayout, optional
        Columns of a row; default :func:`make_station_layout`.
    seconds, rate_Hz : float
        Duration (s) at this row rate (Hz); longer at lower rates.
    """

    def __init__(self, layout: RecordingLayout | None = None, seconds: float = 600.0, rate_Hz: float = 100.0) -> None:
        self.layout = layout or make_station_layout()
        self._units = _signal_units(self.layout)
        self.names = tuple(self._units)
        self._index = {name: k for k, name in enumerate(self.names)}
        self._size = max(2, round(seconds * rate_Hz))
        # Uninitialised: memory is allocated as rows arrive, so a vehicle with few messages needs little.
        self._times = np.empty(self._size)
        # One additional column for all unknown names.
        self._values = np.empty((self._size, len(self.names) + 1), dtype=np.float32)
        self._next = self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def newest_s(self) -> float:
        """Return the time of the newest row (s); NaN if empty."""
        return float(self._times[self._next - 1]) if self._count else math.nan

    def signal_unit(self, name: str) -> str:
        """Return the unit of a signal; ``"1"`` is a pure number.

        Raises
        ------
        KeyError
            If the signal does not exist.
        """
        return self._units[name]

    def append_row(self, time_s: float, values: NDArray[np.floating]) -> None:
        """Add the values of all signals at one time.

        Parameters
        ----------
        time_s : float
            Must exceed the last row's time, else the row is dropped.
        values : (n_signals,) array
            Values in the order of :attr:`names`.
        """
        if self._count and not time_s > self._times[self._next - 1]:
            return
        self._times[self._next] = time_s
        self._values[self._next, :-1] = values
        self._values[self._next, -1] = math.nan
        self._next = (self._next + 1) % self._size
        self._count = min(self._count + 1, self._size)

    def rows_since(
        self, time_s: float, names: Sequence[str] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the rows later than a time.

        Parameters
        ----------
        time_s : float
        names : sequence of k names, optional
            Default: all signals.

        Returns
        -------
        times : (n,) array
            s, increasing.
        values : (n, k) array
            NaN where a signal was unknown, or its name does not exist.
        """
        picked = [self._index.get(name, -1) for name in (self.names if names is None else names)]
        older = slice(self._next, self._size) if self._count == self._size else slice(0, 0)
        newer = sum(
            len(part) - int(np.searchsorted(part, time_s, side="right"))
            for part in (self._times[older], self._times[: self._next])
        )
        rows = np.arange(self._next - newer, self._next) % self._size
        return self._times[rows], self._values[rows[:, None], picked]

    def recent_rows(
        self, seconds: float, names: Sequence[str] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Return the rows of the last ``seconds``, as :meth:`rows_since` does."""
        return self.rows_since(self.newest_s - seconds if self._count else 0.0, names)

    def clear(self) -> None:
        """Clear the history."""
        self._next = self._count = 0


class PresentSignals:
    """The present values of a vehicle's signals, each from the best-ranked source and only until it expires.

    Several messages may carry the same group of signals; the best-ranked message received is used. A signal sent less
    often than the history's rows is held for a time (`SIGNAL_TIMEOUT_S`) and then becomes unknown. Headings are
    unwrapped across north, so that their plots do not jump.

    Parameters
    ----------
    history : SignalHistory
        Defines the signals.

    Attributes
    ----------
    values : (n_signals,) array
        In the order of ``history.names``; NaN if unknown.
    index_by_signal : dict
        Index of each signal, by name.
    slice_by_variable : dict
        Slice of indices of each variable, by name (``"estimated_position"``).
    """

    def __init__(self, history: SignalHistory) -> None:
        self._names = history.names
        self.index_by_signal = {name: k for k, name in enumerate(self._names)}
        self.values: NDArray[np.float64] = np.full(len(self._names), np.nan)
        # Column 0 of a recording is the time.
        self.slice_by_variable = {
            name: slice(c.start - 1, c.stop - 1) for name, c in history.layout.column_slices.items()
        }
        self._told: dict[str, tuple[int, float]] = {}  # group -> rank and time of the message last accepted
        self._owned: dict[str, set[int]] = {}  # group -> its indices

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return the present value of a variable, NaN if unknown."""
        return self.values[self.slice_by_variable[name]].copy()

    def accept_message(self, now_s: float, group: str, rank: int = 0) -> bool:
        """Return whether a message may set its group's signals: no message of better rank (0 is best) came recently."""
        told = self._told.get(group)
        if told is not None and told[0] < rank and now_s - told[1] < SIGNAL_TIMEOUT_S:
            return False
        self._told[group] = rank, now_s
        return True

    def set_value(self, group: str, k: int, value: float) -> None:
        """Set ``values[k]``, from a message of a group."""
        self._owned.setdefault(group, set()).add(k)
        if self._names[k].endswith("_attitude_yaw") and math.isfinite(value):
            value = self._unwrap_heading(k, value)
        self.values[k] = value

    def set_variable(self, group: str, name: str, values: Iterable[float]) -> None:
        """Set the values of a variable."""
        for k, value in enumerate(values, self.slice_by_variable[name].start):
            self.set_value(group, k, float(value))

    def forget_stale(self, now_s: float) -> list[str]:
        """Clear the values that are too old; return the message groups to which they belong."""
        gone = [
            group
            for group, (_, told_s) in self._told.items()
            if now_s - told_s > (SLOW_SIGNAL_TIMEOUT_S if group in _SLOW_GROUPS else SIGNAL_TIMEOUT_S)
        ]
        for group in gone:
            del self._told[group]
            self.values[list(self._owned.get(group, ()))] = math.nan
        return gone

    def _unwrap_heading(self, k: int, angle: float) -> float:
        """Return the heading plus the full turns that bring it closest to its last value, or to the estimated one."""
        for near in (self.values[k], self.values[self.index_by_signal["estimated_attitude_yaw"]]):
            if abs(near) < _MAX_HEADING_RAD:  # an implausible heading must not affect later ones
                return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))
        return angle
