"""Detection of limit cycles in the actuators' inputs.

An input *oscillates* if it alternates by half of its range or more, in at least four consecutive even periods of at
most 4 s each, for 2 s or longer, without a steering command. Loops that delay or saturation makes unstable
(docs/explanation/control.md) reach such a limit cycle: they neither settle nor diverge, and the motion may still look
like flight.

A turn is an instant where the input has returned from its extreme by half of its range. The period at a turn is the
time since the turn before the last. Periods are even if each is at most 1.6 times the previous one; gusts are
irregular. Every turn of a pilot's sticks or a program's set-points restarts the count. (Own definition; flights in 1.5
m/s of wind with gusts of 0.6 m/s stay below a tenth of the range.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.mission import State

_Array = NDArray[np.float64]

ACTUATOR_INPUT_NAMES = ("motor_input upper", "motor_input lower", "servo_input 1", "servo_input 2")
ACTUATOR_INPUT_SPANS = (1.0, 1.0, 2.0, 2.0)
MIN_SWING_INPUT_FRACTION, MIN_OSCILLATION_PERIODS, MIN_OSCILLATION_DURATION_S = 0.5, 4, 2.0
"""Smallest swing (fraction of the input's range), number of consecutive periods, and duration (s) of an oscillation."""
MAX_OSCILLATION_PERIOD_S, MAX_PERIOD_RATIO = 4.0, 1.6
"""Longest period (s), and largest ratio of consecutive periods."""

_STEERING_REVERSAL_THRESHOLDS = (0.1, 0.1, 0.1, 0.2, 0.05, 0.05)
"""Reversals that make a turn of a steering command: velocity N-E-D (m/s), yaw rate (rad/s), roll, pitch (rad)."""


@dataclass(slots=True)
class _TurningPoints:
    """Turning points of one signal: extremes from which the signal has returned by ``reversal_threshold``."""

    reversal_threshold: float
    is_rising: bool = True
    last_extreme: float = -float("inf")
    extreme_time_s: float = 0.0
    turn_times_s: list[float] = field(default_factory=list)

    def find_turning_point(self, time_s: float, value: float) -> bool:
        ahead = value - self.last_extreme if self.is_rising else self.last_extreme - value
        if ahead > 0.0:
            self.last_extreme, self.extreme_time_s = value, time_s
            return False
        if -ahead < self.reversal_threshold:
            return False
        self.turn_times_s = [*self.turn_times_s[-2:], self.extreme_time_s]
        self.is_rising, self.last_extreme, self.extreme_time_s = not self.is_rising, value, time_s
        return True


@dataclass(slots=True)
class _InputOscillation:
    """Consecutive half periods of similar length in one input: their number, duration and extremes."""

    turning_points: _TurningPoints
    start_s: float = 0.0
    half_period_count: int = 0
    period_s: float = 0.0
    lowest_value: float = 0.0
    highest_value: float = 0.0

    def clear_half_periods(self) -> None:
        self.half_period_count, self.period_s = 0, 0.0
        self.turning_points.turn_times_s = []


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Oscillation of one input: name, start (s), duration (s), swing (in the input's unit), frequency (Hz)."""

    input_name: str
    start_s: float
    duration_s: float
    swing: float
    frequency_Hz: float

    def __str__(self) -> str:
        return f"{self.input_name} oscillates by {self.swing:.2f} at {self.frequency_Hz:.2g} Hz"


@cached_njit(error_model="numpy")
def may_oscillate(inputs: _Array) -> bool:
    """Return whether any of the inputs (n, 4) reverses often enough for an oscillation; a fast test that ignores the
    period.
    """
    for k in range(4):
        back, rising, extreme, turns = MIN_SWING_INPUT_FRACTION * ACTUATOR_INPUT_SPANS[k], True, -math.inf, 0
        for value in inputs[:, k]:
            ahead = value - extreme if rising else extreme - value
            if ahead > 0.0:
                extreme = value
            elif not -ahead < back:
                rising, extreme, turns = not rising, value, turns + 1
        if turns >= 2 * MIN_OSCILLATION_PERIODS:
            return True
    return False


class OscillationDetector:
    """Detector of oscillations in the inputs of one flight, period by period."""

    def __init__(self) -> None:
        self._inputs = tuple(
            _InputOscillation(_TurningPoints(MIN_SWING_INPUT_FRACTION * r)) for r in ACTUATOR_INPUT_SPANS
        )
        self._asked = tuple(_TurningPoints(back) for back in _STEERING_REVERSAL_THRESHOLDS)

    def find_oscillation(
        self, time_s: float, inputs: Sequence[float], asked: Sequence[float] | None = None
    ) -> Oscillation | None:
        """Process the actuator inputs of one instant, and return the longest oscillation that they continue.

        Parameters
        ----------
        time_s : float
            Time (s).
        inputs : (4,) sequence of float
            Motor upper, lower (0..1), servo 1, 2 (-1..1).
        asked : (6,) sequence of float, optional
            Command of a pilot or a program: velocity N-E-D (m/s), yaw rate (rad/s), roll and pitch (rad); default
            no steering.

        Returns
        -------
        Oscillation or None
            The longest present oscillation, if any.
        """
        if asked is not None and self._is_following_steering(time_s, asked):
            for one in self._inputs:
                one.clear_half_periods()
        longest: Oscillation | None = None
        for name, one, value in zip(ACTUATOR_INPUT_NAMES, self._inputs, inputs, strict=True):
            turned = one.turning_points.find_turning_point(time_s, value)
            if one.half_period_count:
                one.lowest_value, one.highest_value = (
                    min(one.lowest_value, value),
                    max(one.highest_value, value),
                )
            if turned:
                self._add_turning_point(one, value)
            elif one.half_period_count and time_s - one.turning_points.turn_times_s[-1] > MAX_OSCILLATION_PERIOD_S:
                one.clear_half_periods()
            lasting = one.turning_points.turn_times_s[-1] - one.start_s if one.half_period_count else 0.0
            if one.half_period_count >= 2 * MIN_OSCILLATION_PERIODS and lasting >= MIN_OSCILLATION_DURATION_S:
                found = Oscillation(
                    name, one.start_s, lasting, one.highest_value - one.lowest_value, 1.0 / one.period_s
                )
                longest = found if longest is None or lasting > longest.duration_s else longest
        return longest

    def _is_following_steering(self, time_s: float, asked: Sequence[float]) -> bool:
        turned = [t.find_turning_point(time_s, v) for t, v in zip(self._asked, asked, strict=True)]
        return any(turned)

    @staticmethod
    def _add_turning_point(one: _InputOscillation, value: float) -> None:
        turned = one.turning_points.turn_times_s
        if len(turned) < 3:
            return
        begun_s, _, ended_s = turned[-3:]
        period = ended_s - begun_s
        even = period <= MAX_PERIOD_RATIO * one.period_s and one.period_s <= MAX_PERIOD_RATIO * period
        if period > MAX_OSCILLATION_PERIOD_S or (one.half_period_count and not even):
            one.clear_half_periods()
        elif one.half_period_count:
            one.half_period_count, one.period_s = one.half_period_count + 1, period
        else:
            one.half_period_count, one.period_s, one.start_s = 2, period, begun_s
            one.lowest_value = one.highest_value = value


def steering_demands(
    state: str, velocity: Sequence[float], heading_rate: float, roll: float, pitch: float
) -> tuple[float, ...] | None:
    """Return the pilot's or a program's commands (6,): velocity N, E, D, heading rate, roll and pitch.

    Return None in states in which the mission commands.

    In manual flight the reference's horizontal velocity is the measured one, not a command: it is set to 0.
    """
    n, e, d = velocity
    if state == State.RC:
        return 0.0, 0.0, d, heading_rate, roll, pitch
    return (n, e, d, heading_rate, 0.0, 0.0) if state == State.OFFBOARD else None
