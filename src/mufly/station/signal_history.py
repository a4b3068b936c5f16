"""What a station shows of one vehicle, and what it may ask of it: the seam between links and pages.

A page draws a :class:`VehicleSnapshot` and a :class:`mufly.station.signal_history.SignalHistory`; it does not know
whether they come from a radio, from the simulated helicopter or from a recording. Units SI and radians, axes N-E-D and
body x-y-z. What is not known is NaN (arrays), None or empty text.
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
from mufly.quantities import quantities_recorded_in

_Array = NDArray[np.float64]


def unknown_values(n: int) -> _Array:
    """Return ``n`` values that are not known, shape (n,)."""
    return np.full(n, math.nan)


@dataclass(frozen=True, slots=True)
class VehicleSnapshot(FlightState):
    """The state of a flight as a station knows it, and what it knows besides: of the link, and of who commands.

    Of what belongs to a flight's state a vehicle tells a part; of another autopilot's, ``state`` is the flight mode in
    words. ``mission_begun`` is a mission that is being flown or waits to be gone on with.

    Attributes
    ----------
    connected : bool
        Whether it was heard in the last three seconds; always true in a recording.
    silent_s : float
        For how long nothing was heard (s).
    in_command : bool
        Whether this station commands it; otherwise it watches.
    commander : str
        Who commands it, in words; "" if nobody or unknown.
    rotor_speed : (2,) array
        Upper, lower (rad/s), as measured or, in a simulation, in truth.
    range_angles : (n,) array
        Directions of the range beams from the nose to the right (rad).
    range_max_m : float
        What a beam that sees nothing returns (m).
    mission_row : int or None
        Row of the mission table that is flown to.
    link_loss, link_rate_Hz : float
        Share of packets lost of late (0..1); messages a second.
    real_time_factor : float
        Of late, seconds of the vehicle's clock in one second here: as it tells itself, or else as its stamps go
        against our clock. Below :data:`mufly.link.SLOW_REAL_TIME_FACTOR` time is being lost.
    slips : int or None
        How often the vehicle gave up time that it could not make up for; None where it does not tell.
    """

    connected: bool = False
    silent_s: float = math.inf
    in_command: bool = False
    commander: str = ""
    rotor_speed: _Array = field(default_factory=lambda: unknown_values(2))
    range_angles: _Array = field(default_factory=lambda: unknown_values(0))
    range_max_m: float = math.nan
    mission_row: int | None = None
    link_loss: float = math.nan
    link_rate_Hz: float = math.nan
    real_time_factor: float = math.nan
    slips: int | None = None

    @classmethod
    def from_signals(
        cls,
        signal: Callable[[str], _Array],
        sources: Sequence[str],
        time_s: float,
        ranges: _Array,
        **others: Any,
    ) -> VehicleSnapshot:
        """Return the snapshot of what is told or recorded.

        Parameters
        ----------
        signal : callable
            Value of a variable of :mod:`mufly.quantities` at that moment, NaN where it is not known.
        sources : sequence of str
            Whom to believe of the motion, in this order: "estimated", "measured", "truth".
        time_s : float
        ranges : (n,) array
            Along the beams (m).
        **others
            Fields that are no such variables.
        """

        def most_complete_source(name: str, sources: Sequence[str]) -> _Array:
            told = [signal(f"{source}_{name}") for source in sources]
            # Who knows most of it; of equals the first.
            return max(told, key=lambda v: sum(map(math.isfinite, v.tolist())))

        x, v, angles, rates = (
            most_complete_source(name, sources) for name in ("position", "velocity", "attitude", "rates")
        )
        return cls(
            time_s=time_s,
            estimate=Estimate(time_s, x, v, angles, rates, ranges, float(signal("battery_voltage")[0])),
            reference_position=signal("reference_position"),
            reference_velocity=signal("reference_velocity"),
            reference_attitude=signal("reference_attitude"),
            actuators=Actuators(signal("motor_input"), signal("servo_input")),
            rotor_speed=most_complete_source("rotor_speed", ("measured", "truth")),
            battery_current=float(signal("battery_current")[0]),
            battery_charge=float(signal("battery_charge")[0]),
            **others,
        )


def format_clock(seconds: float) -> str:
    """Return a time as minutes and seconds: "1:18"; "-" where it is not known."""
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
        N, E, D (m); NaN where the action has no place.
    heading_rad : float
        NaN: the nose points along the way.
    wait_s : float
    reached : bool
    text : str
        Anything else worth reading ("0.4 m/s").
    """

    action: str
    position: tuple[float, float, float] = (math.nan, math.nan, math.nan)
    heading_rad: float = math.nan
    wait_s: float = 0.0
    reached: bool = False
    text: str = ""


@dataclass(frozen=True, slots=True)
class PreflightCheck:
    """One pre-flight check; ``ok`` is None while it cannot be judged."""

    name: str
    ok: bool | None
    text: str


class RequestOutcome(StrEnum):
    """What became of a request."""

    WAITING = "waiting"
    ACCEPTED = "accepted"
    REFUSED = "refused"
    TIMED_OUT = "timed out"


@dataclass(slots=True)
class OperatorRequest:
    """Something asked of the vehicle; whoever asked looks here for the answer.

    Attributes
    ----------
    text : str
        What was asked, in words: "take off to 1 m".
    outcome : Outcome
    answer : str
        The vehicle's reason, or what went wrong.
    progress : float
        0..1, of a transfer.
    result : object
        What a download brought.
    """

    text: str
    outcome: RequestOutcome = RequestOutcome.WAITING
    answer: str = ""
    progress: float = 0.0
    result: Sequence[Any] | None = None

    @property
    def is_done(self) -> bool:
        """Whether there is an answer."""
        return self.outcome is not RequestOutcome.WAITING

    def set_outcome(self, outcome: RequestOutcome, answer: str = "") -> None:
        """Give it its answer, once."""
        if not self.is_done:
            self.outcome, self.answer = outcome, answer
            if outcome is RequestOutcome.ACCEPTED:
                self.progress = 1.0


# ----------------------------------------------------------------------------
# What a station remembers of a vehicle: the last ten minutes of every signal, and what it is told at the moment.
#
# Signals are the quantities (:mod:`mufly.quantities`) of a flight's recording with what else a vehicle tells over a
# link: what it believes of itself (``estimated_``), what its rotors were measured to turn at, the pilot's sticks, and
# how good the link is. As plain columns they are called ``variable_label`` (``estimated_position_N``).


MAX_BEAMS = 8
"""So many beams are kept; a vehicle with more is shown, but its ranges are not kept."""
PILOT_CHANNELS = 8
_MAX_HEADING_RAD = 1e4
"""A heading beyond is none (rad)."""
SIGNAL_TIMEOUT_S = 1.5
"""A signal that was not told for so long is not known (s)."""
SLOW_SIGNAL_TIMEOUT_S = 6.0
"""The same for what vehicles tell once a second or less: battery, link (s)."""
_SLOW_GROUPS = ("battery", "link")


def station_layout() -> RecordingLayout:
    """Return the table of what a station keeps of one vehicle: columns of its history and of its recordings."""
    labels = (("channel", tuple(range(1, PILOT_CHANNELS + 1))),)
    return RecordingLayout(quantities_recorded_in("flight", "station"), MAX_BEAMS, labels)


def _signal_units(layout: RecordingLayout) -> dict[str, str]:
    """Name of every column behind the time (``truth_position_N``) -> its unit."""
    out: dict[str, str] = {}
    for q in layout.quantities:
        out |= dict.fromkeys(
            [f"{q.name}_{label}" for label in layout.component_labels(q)] if q.dim else [q.name], q.units
        )
    return out


class SignalHistory:
    """The last ten minutes, in memory that does not grow.

    Rows of numbers on one clock, in a ring: a new row takes the place of the oldest. Times are float64 (a float32 clock
    would tick in steps of 8 ms after a day), values float32, which hold every signal to seven digits.

    Parameters
    ----------
    layout : Layout, optional
        What the columns are; default :func:`station_layout`.
    seconds, rate_Hz : float
        How far back it reaches at that many rows a second; at fewer it reaches further.
    """

    def __init__(self, layout: RecordingLayout | None = None, seconds: float = 600.0, rate_Hz: float = 100.0) -> None:
        self.layout = layout or station_layout()
        self._units = _signal_units(self.layout)
        self.names = tuple(self._units)
        self._index = {name: k for k, name in enumerate(self.names)}
        self._size = max(2, round(seconds * rate_Hz))
        # Not filled: memory is taken row by row as they come, so a vehicle that says little costs little.
        self._times = np.empty(self._size)
        # One column more than there are signals: that of every name that is none.
        self._values = np.empty((self._size, len(self.names) + 1), dtype=np.float32)
        self._next = self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def newest_s(self) -> float:
        """Time of the newest row (s); NaN while there is none."""
        return float(self._times[self._next - 1]) if self._count else math.nan

    @property
    def oldest_s(self) -> float:
        """Time of the oldest row (s); NaN while there is none."""
        return float(self._times[self._next if self._count == self._size else 0]) if self._count else math.nan

    def signal_unit(self, name: str) -> str:
        """Unit of a signal; ``"1"`` is a pure number.

        Raises
        ------
        KeyError
            If there is no such signal.
        """
        return self._units[name]

    def append_row(self, time_s: float, values: NDArray[np.floating]) -> None:
        """Add a row.

        Parameters
        ----------
        time_s : float
            Later than that of the last row, or the row is left out.
        values : (n_signals,) array
            In the order of :attr:`names`.
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
            Default all.

        Returns
        -------
        times : (n,) array
            s, increasing.
        values : (n, k) array
            NaN where a signal was not known then, or has a name that is not known at all.
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
        """Forget everything."""
        self._next = self._count = 0


class PresentSignals:
    """What a vehicle's signals are at the moment: who told them, and until when they are believed.

    Several messages may tell the same; of such a group the best that comes is believed. A signal that comes more seldom
    than rows of the history do is held for a while (`SIGNAL_TIMEOUT_S`) and then is not known any more. Headings are
    carried on past north, so that lines of them do not jump.

    Parameters
    ----------
    history : History
        Which has the signals.

    Attributes
    ----------
    values : (n_signals,) array
        In the order of ``history.names``; NaN is not known.
    index_by_signal : dict
        Name of a signal -> its place.
    slice_by_variable : dict
        Name of a variable (``"estimated_position"``) -> slice of its places.
    """

    def __init__(self, history: SignalHistory) -> None:
        self._names = history.names
        self.index_by_signal = {name: k for k, name in enumerate(self._names)}
        self.values: NDArray[np.float64] = np.full(len(self._names), np.nan)
        # Column 0 of a recording is the time.
        self.slice_by_variable = {
            name: slice(c.start - 1, c.stop - 1) for name, c in history.layout.column_slices.items()
        }
        self._told: dict[str, tuple[int, float]] = {}  # group -> rank and time of the message last believed
        self._owned: dict[str, set[int]] = {}  # group -> its places

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """The present value of a variable, NaN where it is not known."""
        return self.values[self.slice_by_variable[name]].copy()

    def accept_message(self, now_s: float, group: str, rank: int = 0) -> bool:
        """Whether to believe a message of this rank now (0 is best); notes that it told."""
        told = self._told.get(group)
        if told is not None and told[0] < rank and now_s - told[1] < SIGNAL_TIMEOUT_S:
            return False
        self._told[group] = rank, now_s
        return True

    def set_value(self, group: str, k: int, value: float) -> None:
        """Put a value in place ``k``, told by a message of a group."""
        self._owned.setdefault(group, set()).add(k)
        if self._names[k].endswith("_attitude_yaw") and math.isfinite(value):
            value = self._unwrap_heading(k, value)
        self.values[k] = value

    def set_variable(self, group: str, name: str, values: Iterable[float]) -> None:
        """Put the values of a variable."""
        for k, value in enumerate(values, self.slice_by_variable[name].start):
            self.set_value(group, k, float(value))

    def forget_stale(self, now_s: float) -> list[str]:
        """Take away what was not told for long; returns the groups."""
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
        """Return the angle in the turn nearest to its last value, or else to the estimated heading."""
        for near in (self.values[k], self.values[self.index_by_signal["estimated_attitude_yaw"]]):
            if abs(near) < _MAX_HEADING_RAD:  # one absurd heading must not carry all that follow with it
                return angle + 2.0 * math.pi * round((near - angle) / (2.0 * math.pi))
        return angle
