"""Whether actuators oscillate: a limit cycle, told from what they do.

An input *oscillates* when it goes to and fro by half of its range or more, in even periods of at most 4 s, four of them
on end and for 2 s or longer, and nobody asked for it. Loops that are unstable with their delay, or that saturation
makes so (docs/control.md), end like that: they neither settle nor diverge, and what the helicopter does meanwhile may
look like flying.

A turn is where the input has come back from its extreme by half of the range; the period at a turn is the time since
the one before the last. Even means that it differs from the period before by no more than a factor of 1.6: gusts do not
keep time. Where a pilot's sticks or a program's set-points go to and fro themselves, counting begins anew with each of
their turns. (Own definition; flights in 1.5 m/s of wind with gusts of 0.6 m/s stay below a tenth of the range.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.mission import State

_Array = NDArray[np.float64]

INPUTS = ("motor_input upper", "motor_input lower", "servo_input 1", "servo_input 2")
RANGES = (1.0, 1.0, 2.0, 2.0)
SHARE, PERIODS, LASTING_S = 0.5, 4, 2.0
"""Part of its range that an input has to go to and fro by, how often on end, and for how long (s)."""
SLOWEST_S, EVEN = 4.0, 1.6
"""Longest period (s), and by what factor one may differ from the one before."""

_ASKED = (0.1, 0.1, 0.1, 0.2, 0.05, 0.05)
"""What counts as a turn of what is asked for: velocity N-E-D (m/s), rate of turn (rad/s), roll, pitch (rad)."""


@dataclass(slots=True)
class _Turns:
    """Turns of one signal: it has turned when it has come back by ``back`` from its extreme."""

    back: float
    rising: bool = True
    extreme: float = -float("inf")
    at_s: float = 0.0
    turned_s: list[float] = field(default_factory=list)

    def step(self, time_s: float, value: float) -> bool:
        ahead = value - self.extreme if self.rising else self.extreme - value
        if ahead > 0.0:
            self.extreme, self.at_s = value, time_s
            return False
        if -ahead < self.back:
            return False
        self.turned_s = [*self.turned_s[-2:], self.at_s]
        self.rising, self.extreme, self.at_s = not self.rising, value, time_s
        return True


@dataclass(slots=True)
class _Input:
    """Even periods of one input so far, and how far it went in them."""

    turns: _Turns
    since_s: float = 0.0
    count: int = 0
    period_s: float = 0.0
    low: float = 0.0
    high: float = 0.0

    def forget(self) -> None:
        self.count, self.period_s = 0, 0.0
        self.turns.turned_s = []


@dataclass(frozen=True, slots=True)
class Oscillation:
    """One input's oscillation: name, since when and for how long (s), size (in its unit), frequency (Hz)."""

    input: str
    since_s: float
    lasting_s: float
    size: float
    frequency_Hz: float

    def __str__(self) -> str:
        return f"{self.input} oscillates by {self.size:.2f} at {self.frequency_Hz:.2g} Hz"


@compiled(error_model="numpy")
def may_oscillate(inputs: _Array) -> bool:
    """Whether any of the inputs (n, 4) turns often enough to oscillate, however slowly and whoever asks for it."""
    for k in range(4):
        back, rising, extreme, turns = SHARE * RANGES[k], True, -math.inf, 0
        for value in inputs[:, k]:
            ahead = value - extreme if rising else extreme - value
            if ahead > 0.0:
                extreme = value
            elif not -ahead < back:
                rising, extreme, turns = not rising, value, turns + 1
        if turns >= 2 * PERIODS:
            return True
    return False


class OscillationWatch:
    """Looks at the inputs of one flight, period by period."""

    def __init__(self) -> None:
        self._inputs = tuple(_Input(_Turns(SHARE * r)) for r in RANGES)
        self._asked = tuple(_Turns(back) for back in _ASKED)

    def step(
        self, time_s: float, inputs: Sequence[float], asked: Sequence[float] | None = None
    ) -> Oscillation | None:
        """Take one more instant.

        Parameters
        ----------
        time_s : float
        inputs : (4,) sequence of float
            Motor upper, lower (0..1), servo 1, 2 (-1..1).
        asked : (6,) sequence of float, optional
            What a pilot or a program asks for: velocity N-E-D (m/s), rate of turn (rad/s), roll and pitch (rad);
            without it, nobody steers.

        Returns
        -------
        Oscillation or None
            That which lasts longest, if any.
        """
        if asked is not None and self._turned(time_s, asked):
            for one in self._inputs:
                one.forget()
        longest: Oscillation | None = None
        for name, one, value in zip(INPUTS, self._inputs, inputs, strict=True):
            turned = one.turns.step(time_s, value)
            if one.count:
                one.low, one.high = min(one.low, value), max(one.high, value)
            if turned:
                self._turn(one, value)
            elif one.count and time_s - one.turns.turned_s[-1] > SLOWEST_S:
                one.forget()
            lasting = one.turns.turned_s[-1] - one.since_s if one.count else 0.0
            if one.count >= 2 * PERIODS and lasting >= LASTING_S:
                found = Oscillation(name, one.since_s, lasting, one.high - one.low, 1.0 / one.period_s)
                longest = found if longest is None or lasting > longest.lasting_s else longest
        return longest

    def _turned(self, time_s: float, asked: Sequence[float]) -> bool:
        turned = [t.step(time_s, v) for t, v in zip(self._asked, asked, strict=True)]
        return any(turned)

    @staticmethod
    def _turn(one: _Input, value: float) -> None:
        turned = one.turns.turned_s
        if len(turned) < 3:
            return
        period = turned[-1] - turned[-3]
        even = period <= EVEN * one.period_s and one.period_s <= EVEN * period
        if period > SLOWEST_S or (one.count and not even):
            one.forget()
        elif one.count:
            one.count, one.period_s = one.count + 1, period
        else:
            one.count, one.period_s, one.since_s = 2, period, turned[-3]
            one.low = one.high = value


def steered(
    state: str, velocity: Sequence[float], heading_rate: float, roll: float, pitch: float
) -> tuple[float, ...] | None:
    """What a pilot or a program asks for in this state of the mission; None where the mission flies.

    Of a pilot's references the horizontal velocity is the measured one, which he does not ask for.
    """
    n, e, d = velocity
    if state == State.RC:
        return 0.0, 0.0, d, heading_rate, roll, pitch
    return (n, e, d, heading_rate, 0.0, 0.0) if state == State.OFFBOARD else None
