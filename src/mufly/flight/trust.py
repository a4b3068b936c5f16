"""What the flight software makes of an estimate that knows how good it is: go on, hold, land; what it says of sensors.

An estimator says how uncertain it is (its covariance), whether it stands by what it says, and what it thinks of each
sensor. Flying goes by the first two alone, whatever the reason; the third gives the words.

================================================ ===================================================================
horizontal position uncertain by more than 0.25 m the mission waits in a hover; below 0.15 m for a second, it goes on
... by more than 0.6 m, or waiting for 10 s       it lands where it is
height uncertain by more than 0.3 m for 0.3 s     it lands
roll or pitch uncertain by more than 8 degrees,   it sinks with its servos at trim, which the stabiliser bar makes a
or two of fix, sonar and compass not believed     level attitude
for 0.15 s at once
heading uncertain by more than 30 degrees, or     it lands; without gyroscopes on the rates of turn of the rotor
a bias of the gyroscopes that they cannot have,   model, and 3 cm above the floor its servos go to trim and its
or gyroscopes gone for 0.1 s                      motors run down
================================================ ===================================================================

Uncertainties are standard deviations, that of the position beyond the one with which it stood on the floor. Besides
them what is thought of sensors decides in two cases: without gyroscopes the attitude is what a model says, and
where two that know nothing of each other contradict, it is the attitude between them that is wrong. In
the air only, and not against a pilot, who is told and decides.

What the controllers get moves on smoothly (:class:`Smooth`): a filter corrects itself at every measurement, a few
millimetres at a time, and heave control answers a step of 1 cm with a fifth of the motors' range.

Something is said of a sensor when it has not been used, or not believed, for most of a quarter of a second, or is used
though something is wrong with it, and again when it has been fused for a second. A reading that is left out now and
then is none of these: a level rises with the time that a sensor is not believed and sinks with a tenth of the time that
it is.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.compiled import compiled
from mufly.estimate import Check, Estimate
from mufly.estimate.layout import EX_ATT, EX_POS
from mufly.trigonometry import sine_cosine

_Array = NDArray[np.float64]

HOLD_M, CERTAIN_M, LAND_M = 0.25, 0.15, 0.6
"""Horizontal standard deviations from which it waits, below which it goes on, from which it lands (m)."""
CERTAIN_S, WAIT_S = 1.0, 10.0
"""For how long it has to be certain to go on; how long it waits at most (s)."""
HEIGHT_M, HEIGHT_S = 0.3, 0.3
"""Standard deviation of the height from which it lands (m), once it has lasted (s): a board that is shaken until it
clips does not know its height for an instant as it leaves the floor, and the sonar tells it right after."""
GONE_S, CONTRADICTED_S = 0.1, 0.15
"""For how long gyroscopes may be gone, two aids contradict (s)."""
TILT, HEADING = math.radians(8.0), math.radians(30.0)

BAD_S, GOOD_S = 0.2, 1.0
"""For how long a sensor is not believed until that is said; fused, until it is said to be used again (s)."""
_FORGET = 0.1

Demand = Literal["", "hold", "land", "sink"]


class Doubt(NamedTuple):
    """What an estimate is not good enough for, and why."""

    demand: Demand = ""
    why: str = ""


NO_DOUBT = Doubt()

_NAMES = {
    "acceleration": "accelerometer", "rates": "gyroscope", "ground_distance": "sonar", "ranges": "laser ring",
    "pressure": "pressure sensor", "magnetic_field": "magnetometer", "rotor_speed": "rotor speed",
    "position_fix": "position fix", "battery_voltage": "battery monitor",
}  # fmt: skip
_PLACE = ("position_fix", "ranges")
_HEIGHT = ("ground_distance", "position_fix", "pressure")
_LEVEL = ("rates", "acceleration")
_APART = ("position_fix", "ground_distance", "magnetic_field")
_HEADING = ("position_fix", "magnetic_field", "rates")


def sensor_name(reading: str) -> str:
    """Return what a reading comes from, in words."""
    return _NAMES.get(reading, reading.replace("_", " "))


def checks_of(m: Estimate) -> Sequence[Check]:
    """Return what the estimator thinks of its sensors; nothing where it is told the truth."""
    return () if m.beliefs is None else m.beliefs.checks


def turns_unfelt(m: Estimate) -> bool:
    """Whether the rates of turn are those of the rotor model, as its gyroscopes say nothing that can be right."""
    return any(c.name == "rates" and c.status in ("missing", "faulty", "rejected") for c in checks_of(m))


def told(check: Check) -> str:
    """A sensor, what is thought of it, and why."""
    state = {"missing": "says nothing", "rejected": "is not believed", "faulty": "is faulty"}
    if check.odd:
        state["fused"] = "is used, but something is wrong"
    return f"{sensor_name(check.name)} {state.get(check.status, check.status)}" + (
        f": {check.reason}" if check.reason else ""
    )


def _because(m: Estimate, sources: tuple[str, ...]) -> str:
    """What is wrong with the sensors that would tell."""
    wrong = [
        told(c) for c in checks_of(m) if c.name in sources and c.status in ("missing", "rejected", "faulty")
    ]
    return f" ({'; '.join(wrong)})" if wrong else ""


def strayed(m: Estimate, stood: float = 0.0) -> float:
    """By how much the horizontal position is uncertain beyond the variance ``stood`` (m2) with which it stood (m)."""
    variance = m.covariance.diagonal()
    return math.sqrt(max(float(variance[0]), float(variance[1]), stood) - stood)


def judge(m: Estimate, stood: float = 0.0, *, height_counts: bool = True) -> Doubt:
    """Return what an estimate is not good enough for, whatever it was before.

    Parameters
    ----------
    m : Estimate
    stood : float
        Greatest variance of the horizontal position on the floor (m2): one that nothing tells where it is takes off
        where it believes to stand, and can go on for as long as that does not become much worse.
    height_counts : bool
        Whether an uncertain height has lasted for long enough to land for.
    """
    if m.beliefs is None:
        return NO_DOUBT
    variance = m.covariance.diagonal()
    place, height = strayed(m, stood), math.sqrt(variance[EX_POS + 2])
    tilt = math.sqrt(max(variance[EX_ATT], variance[EX_ATT + 1]))
    heading = math.sqrt(variance[EX_ATT + 2])
    if tilt > TILT:
        return Doubt("sink", f"attitude uncertain by {math.degrees(tilt):.0f} deg{_because(m, _LEVEL)}")
    if heading > HEADING:
        return Doubt("land", f"heading uncertain by {math.degrees(heading):.0f} deg{_because(m, _HEADING)}")
    rates = next((c for c in checks_of(m) if c.name == "rates"), None)
    if rates is not None and rates.status == "rejected":
        return Doubt("land", told(rates))
    if height > HEIGHT_M and height_counts:
        return Doubt("land", f"height uncertain by {height:.2f} m{_because(m, _HEIGHT)}")
    if place > HOLD_M:
        why = f"position uncertain by {place:.2f} m{_because(m, _PLACE)}"
        return Doubt("land" if place > LAND_M else "hold", why)
    return NO_DOUBT


@dataclass
class Doubts:
    """What is remembered of doubts, for their hysteresis.

    Attributes
    ----------
    now : Doubt
    stood : float
        Variance of the horizontal position on the floor (m2).
    """

    now: Doubt = NO_DOUBT
    stood: float = 0.0
    _wrong_s: dict[str, float] = field(default_factory=dict)
    _since_s: float = math.nan
    _certain_s: float = math.nan
    _height_s: float = math.nan

    def step(self, m: Estimate) -> Doubt:
        """Judge an estimate in the air; what was doubted stays so until it is certain again."""
        t = m.time_s
        if not math.sqrt(m.covariance[2, 2]) > HEIGHT_M:
            self._height_s = math.nan
        elif math.isnan(self._height_s):
            self._height_s = t
        found = judge(m, self.stood, height_counts=t - self._height_s >= HEIGHT_S)
        apart = self._contradicted(m)
        if apart.demand and found.demand != "sink":
            found = apart
        if self.now.demand in ("land", "sink"):
            return self.now if found.demand != "sink" else self._say(found)
        if found.demand in ("land", "sink"):
            return self._say(found)
        if found.demand == "hold":
            self._certain_s = math.nan
            if self.now.demand != "hold":
                self._since_s = t
                return self._say(found)
        elif self.now.demand == "hold":
            if strayed(m, self.stood) >= CERTAIN_M:
                self._certain_s = math.nan
            elif math.isnan(self._certain_s):
                self._certain_s = t
            elif t - self._certain_s >= CERTAIN_S:
                return self._say(NO_DOUBT)
        if self.now.demand == "hold" and t - self._since_s > WAIT_S:
            return self._say(Doubt("land", f"{found.why or self.now.why}, for {WAIT_S:g} s"))
        return self.now

    def _contradicted(self, m: Estimate) -> Doubt:
        """What is thought of sensors that an attitude depends on: it cannot be right, or is told by the model."""
        for c in checks_of(m):
            bad = c.status in (("missing", "faulty") if c.name == "rates" else ("rejected",))
            if not bad:
                self._wrong_s.pop(c.name, None)
            elif c.name == "rates" or c.name in _APART:
                self._wrong_s.setdefault(c.name, m.time_s)
        lasting = {n: m.time_s - since for n, since in self._wrong_s.items()}
        against = [n for n in _APART if lasting.get(n, 0.0) > CONTRADICTED_S]
        if len(against) > 1:
            why = f"attitude contradicted by {' and '.join(sensor_name(n) for n in against)}"
            return Doubt("sink", why)
        if lasting.get("rates", 0.0) > GONE_S:
            return Doubt("land", next(told(c) for c in checks_of(m) if c.name == "rates"))
        return NO_DOUBT

    def _say(self, found: Doubt) -> Doubt:
        self.now = found
        return found


SMOOTH_S = 0.3
"""Time constant with which corrections of position and heading reach the controllers (s)."""
FASTEST_M_S, FASTEST_RAD_S = 0.5, 0.5
"""How fast, at most."""


class Smooth:
    """Position and heading without the steps of a filter's corrections.

    They move with the estimated velocity and rate of turn, and are pulled towards the estimate::

        x' = v + clip((x_est - x) / tau, +-v_max)

    so that motion comes without lag and corrections within a second: what autopilots call an output predictor.
    """

    def __init__(self) -> None:
        self._last: Estimate | None = None
        self._place = np.zeros(3)
        self._heading = 0.0

    def step(self, m: Estimate, *, anew: bool = False) -> Estimate:
        """Return the estimate to control by; ``anew``: nothing is controlled yet."""
        last, self._last = self._last, m
        if anew or last is None or not 0.0 < m.time_s - last.time_s < 0.1:
            self._place, self._heading = m.position.copy(), float(m.attitude[2])
            return m
        self._place, attitude = _moved_on(
            self._place,
            self._heading,
            last.velocity,
            m.position,
            m.velocity,
            m.attitude,
            m.rates,
            m.time_s - last.time_s,
        )
        self._heading = float(attitude[2])
        return Estimate(
            m.time_s, self._place, m.velocity, attitude, m.rates, m.ranges, m.battery_voltage, m.covariance, m.valid,
            m.beliefs,
        )  # fmt: skip


@compiled
def _moved_on(
    place: _Array,
    heading: float,
    before: _Array,
    position: _Array,
    velocity: _Array,
    attitude: _Array,
    rates: _Array,
    dt: float,
) -> tuple[_Array, _Array]:
    """Position and attitude a period later; ``before`` is the velocity then."""
    moved, turned = np.empty(3), np.empty(3)
    for k in range(3):
        v = 0.5 * (before[k] + velocity[k])
        off = (position[k] - place[k] - dt * v) / SMOOTH_S
        moved[k] = place[k] + dt * (v + min(max(off, -FASTEST_M_S), FASTEST_M_S))
    roll, pitch = attitude[0], attitude[1]
    sine, cosine = sine_cosine(roll)
    turn = (sine * rates[1] + cosine * rates[2]) / max(sine_cosine(pitch)[1], 0.1)
    away = (attitude[2] - heading - dt * turn) / SMOOTH_S
    turned[0], turned[1] = roll, pitch
    turned[2] = heading + dt * (turn + min(max(away, -FASTEST_RAD_S), FASTEST_RAD_S))
    return moved, turned


@dataclass
class SensorWatch:
    """Turns what an estimator thinks of its sensors into events that are worth a line.

    Attributes
    ----------
    told : dict
        Reading to the status that was told last, of those that are not believed.
    """

    told: dict[str, str] = field(default_factory=dict)
    _level: dict[str, float] = field(default_factory=dict)
    _good_s: dict[str, float] = field(default_factory=dict)
    _wrong: dict[str, Check] = field(default_factory=dict)

    def calm(self, checks: Sequence[Check]) -> bool:
        """Whether a step with these changes nothing: all is believed, and nothing else was told."""
        return (
            not self.told
            and all(level <= 0.0 for level in self._level.values())
            and all(c.status in ("fused", "waiting") and not c.odd for c in checks)
        )

    def step(
        self, checks: Sequence[Check], period_s: float, excused: Collection[str] = ()
    ) -> list[tuple[str, str]]:
        """Return (text, level) of what has changed, a period later; of those that are ``excused`` nothing is said
        when they are missing."""
        said: list[tuple[str, str]] = []
        for check in checks:
            name = check.name
            if check.status == "missing" and name in excused:
                continue
            if check.odd or check.status in ("rejected", "missing", "faulty"):
                self._wrong[name] = check
                self._good_s[name] = 0.0
                # What is missing has been waited for already.
                more = 4.0 * period_s if check.status == "missing" else period_s
                level = self._level[name] = min(self._level.get(name, 0.0) + more, BAD_S + period_s)
                if level >= BAD_S and name not in self.told:
                    self.told[name] = check.status
                    said.append((told(check), "warning"))
            elif check.status == "fused":
                level = self._level.get(name, 0.0)
                if level > 0.0:
                    self._level[name] = level - _FORGET * period_s
                if name in self.told:
                    self._good_s[name] += period_s
                    if self._good_s[name] >= GOOD_S:
                        del self.told[name]
                        self._level[name] = 0.0
                        said.append((f"{sensor_name(name)} is used again", "info"))
        return said


# Before take-off: what cannot work


def outlook(m: Estimate, reach_m: float) -> str:
    """One line on what an estimate that is valid on the floor will not be good for in the air; "" if nothing.

    Parameters
    ----------
    m : Estimate
    reach_m : float
        How far the laser ring sees (m).
    """
    checks = {c.name: c for c in checks_of(m)}
    if not checks:
        return ""
    fix, ring = checks.get("position_fix"), checks.get("ranges")
    fixed = fix is not None and fix.status == "fused"
    walls = ring is not None and bool(np.any(m.ranges < reach_m))
    lines = []
    if not fixed and not walls:
        why = (
            "no position fix on board"
            if fix is None
            else told(fix)
            if fix.status != "waiting"
            else "no position fix"
        )
        seen = "no laser ring" if ring is None else f"no wall within the {reach_m:g} m of the lasers"
        lines.append(
            f"nothing tells where it is: {why}, {seen}; it holds by drag and rotor model for as long as that goes, "
            "then lands"
        )
    return "; ".join(lines)
