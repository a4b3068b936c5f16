"""What a station shows of one vehicle, and what it may ask of it: the seam between links and pages.

A page draws a :class:`Snapshot` and a :class:`mufly.station.history.History`; it does not know whether they come from a
radio, from the simulated helicopter or from a recording. Units SI and radians, axes N-E-D and body x-y-z. What is not
known is NaN (arrays), None or empty text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.estimate import Estimate
from mufly.flight import Actuators, FlightState

_Array = NDArray[np.float64]


def unknown(n: int) -> _Array:
    """Return ``n`` values that are not known, shape (n,)."""
    return np.full(n, math.nan)


@dataclass(frozen=True, slots=True)
class Snapshot(FlightState):
    """The state of a flight as a station knows it, and what it knows besides: of the link, and of who commands.

    Of what belongs to a flight's state a vehicle tells a part; of another autopilot's, ``state`` is the flight mode in
    words.

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
    """

    connected: bool = False
    silent_s: float = math.inf
    in_command: bool = False
    commander: str = ""
    rotor_speed: _Array = field(default_factory=lambda: unknown(2))
    range_angles: _Array = field(default_factory=lambda: unknown(0))
    range_max_m: float = math.nan
    mission_row: int | None = None
    link_loss: float = math.nan
    link_rate_Hz: float = math.nan

    @classmethod
    def of(
        cls,
        signal: Callable[[str], _Array],
        sources: Sequence[str],
        time_s: float,
        ranges: _Array,
        **others: Any,
    ) -> Snapshot:
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

        def believed(name: str, sources: Sequence[str]) -> _Array:
            told = [signal(f"{source}_{name}") for source in sources]
            # Who knows most of it; of equals the first.
            return max(told, key=lambda v: sum(map(math.isfinite, v.tolist())))

        x, v, angles, rates = (
            believed(name, sources) for name in ("position", "velocity", "attitude", "rates")
        )
        return cls(
            time_s=time_s,
            estimate=Estimate(time_s, x, v, angles, rates, ranges, float(signal("battery_voltage")[0])),
            reference_position=signal("reference_position"),
            reference_velocity=signal("reference_velocity"),
            reference_attitude=signal("reference_attitude"),
            actuators=Actuators(signal("motor_input"), signal("servo_input")),
            rotor_speed=believed("rotor_speed", ("measured", "truth")),
            battery_current=float(signal("battery_current")[0]),
            battery_charge=float(signal("battery_charge")[0]),
            **others,
        )


@dataclass(frozen=True, slots=True)
class Message:
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
class Check:
    """One pre-flight check; ``ok`` is None while it cannot be judged."""

    name: str
    ok: bool | None
    text: str


class Outcome(StrEnum):
    """What became of a request."""

    WAITING = "waiting"
    ACCEPTED = "accepted"
    REFUSED = "refused"
    TIMED_OUT = "timed out"


@dataclass(slots=True)
class Request:
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
    outcome: Outcome = Outcome.WAITING
    answer: str = ""
    progress: float = 0.0
    result: Sequence[Any] | None = None

    @property
    def done(self) -> bool:
        """Whether there is an answer."""
        return self.outcome is not Outcome.WAITING

    def end(self, outcome: Outcome, answer: str = "") -> None:
        """Give it its answer, once."""
        if not self.done:
            self.outcome, self.answer = outcome, answer
            if outcome is Outcome.ACCEPTED:
                self.progress = 1.0
