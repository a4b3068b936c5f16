"""What a filter believes beyond position, velocity, attitude and rates, and what it says of each of its sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from mufly.estimate import sensor_checks as g
from mufly.estimate.layout import CHECKED, R_FIX, R_MAGNET, R_PRESSURE, R_SONAR
from mufly.sensors import READINGS

_Array = NDArray[np.float64]

Status = Literal["fused", "rejected", "missing", "faulty", "waiting"]


@dataclass(frozen=True, slots=True)
class Check:
    """What is thought of one sensor.

    Attributes
    ----------
    name : str
        Of its reading (:data:`mufly.sensors.READINGS`).
    status : str
        ``"fused"``: believed. ``"rejected"``: it comes, but what it says does not fit. ``"missing"``: it was there and
        comes no more. ``"faulty"``: what it says cannot be right in itself. ``"waiting"``: not needed, or nothing yet.
    innovation, sigma, ratio : float
        Of its worst component: reading less what was expected, the deviation that this was expected to have (both in
        SI units), and the quotient.
    age_s : float
        Since the last measurement that was used (s).
    reason : str
        Why it is so, in plain words; empty while all is well.
    odd : bool
        Whether something is wrong with it though it is fused: the reason says what.
    """

    name: str
    status: Status = "waiting"
    innovation: float = 0.0
    sigma: float = 0.0
    ratio: float = 0.0
    age_s: float = 0.0
    reason: str = ""
    odd: bool = False


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What a filter believes besides the motion.

    Attributes
    ----------
    gyro_bias : (3,) array
        (rad/s), body axes.
    accelerometer_bias : (3,) array
        (m/s^2), body axes.
    floor_height : float
        Of the surface under the sonar above D = 0 (m, positive up).
    fix_bias : (4,) array
        What the position fix is off by: N, E, D (m), heading (rad).
    wind : (2,) array
        N, E (m/s).
    thrust_scale : float
        True thrust over that of the model (1).
    sigma : (n,) array
        Standard deviations of the whole error state, in the order of :data:`mufly.estimate.layout.ERROR_STATES`.
    checks : sequence of Check
        One for each sensor of the vehicle.
    """

    gyro_bias: _Array
    accelerometer_bias: _Array
    floor_height: float
    fix_bias: _Array
    wind: _Array
    thrust_scale: float
    sigma: _Array
    checks: Sequence[Check] = ()


_STATUS: tuple[Status, ...] = ("waiting", "fused", "rejected", "missing", "faulty")
_WORDS: Mapping[int, Callable[[float, str], str]] = {
    g.FINE: lambda x, u: "",
    g.NOTHING_YET: lambda x, u: "nothing has come yet",
    g.SILENT: lambda x, u: f"nothing has come for {x:.2f} s",
    g.LATE: lambda x, u: f"comes {1e3 * x:.0f} ms after it was measured, later than it should",
    g.INSANE: lambda x, u: "says what is no number, or beyond all bounds",
    g.FROZEN: lambda x, u: f"has said the same to the last digit for {x:.2f} s",
    g.DOUBLED: lambda x, u: "every reading comes twice: the second ones are left out",
    g.OFF: lambda x, u: f"is off by {x:.3g} {u} from what all others say",
    g.CLIPS: lambda x, u: f"clips {100 * x:.0f} % of its samples: the rotor model takes over",
    g.STEP: lambda x, u: f"sees a step: what lies below is {x:.2f} m above the floor",
    g.TAKEN_OVER: lambda x, u: (
        f"was off by {x:.3g} {u} for a second and agreed with itself: it is believed anew"
    ),
    g.NO_ECHO: lambda x, u: f"has had no echo for {x:.2f} s",
    g.TOO_FAR: lambda x, u: "sees no wall: all are too far",
    g.NO_WALL: lambda x, u: "sees something, but no wall of the room",
    g.SPIKES: lambda x, u: f"has spikes of {x:.2g} {u}: the flight model fills in",
    g.SLOPE: lambda x, u: f"leads away by {x:.3g} {u} and more: the surface below slopes, or it drifts",
    g.AWAY: lambda x, u: f"is {x:.2f} m apart from the sonar about the height: one of them is wrong",
    g.STUCK_: lambda x, u: f"says {x:.2f} m again and again, more alike than a flight is",
    g.WANDERS: lambda x, u: f"has a bias of {x:.2g} {u} by now, more than it can have",
    g.STRAINED: lambda x, u: f"keeps being off, by {x:.3g} {u} now: it or the gyroscopes drift",
    g.JUMPED: lambda x, u: f"has jumped by {x:.2g} {u}, which no moment has made",
}

REASONS = len(_WORDS)
ODD = (g.DOUBLED, g.SPIKES, g.JUMPED, g.STRAINED)
"""Reasons of sensors that are fused though something is wrong with them; that some clip is usual, and weighed."""


class Checks(Sequence[Check]):
    """What is thought of each sensor that is on board, put into words when somebody looks.

    Parameters
    ----------
    m, s : records
        Memory and settings of the filter; what they hold is not to change any more.
    fitted : sequence of int
        Which of :data:`mufly.estimate.layout.CHECKED`.
    """

    def __init__(self, m: Mapping[str, Any] | np.void, s: np.void, fitted: Sequence[int]) -> None:
        self._of = (m, s, fitted)
        self._said: tuple[Check, ...] | None = None

    @overload
    def __getitem__(self, k: int) -> Check: ...
    @overload
    def __getitem__(self, k: slice) -> tuple[Check, ...]: ...
    def __getitem__(self, k: int | slice) -> Check | tuple[Check, ...]:
        return self._all()[k]

    def __iter__(self) -> Iterator[Check]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._of[2])

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Checks | tuple) and tuple(self) == tuple(other)

    def __hash__(self) -> int:
        return hash(self._all())

    def __repr__(self) -> str:
        return repr(self._all())

    def _all(self) -> tuple[Check, ...]:
        if self._said is None:
            m, s, fitted = self._of
            dt, tick = float(s["dt"]), int(m["tick"])
            rows = zip(*(m[name].tolist() for name in _NUMBERS), strict=True)
            part = int(m["fault_component"])
            self._said = tuple(_check(k, row, dt, tick, part) for k, row in enumerate(rows) if k in fitted)
        return self._said


_NUMBERS = (
    "status", "reason", "fault_number", "innovation", "innovation_sigma", "last_fused_tick", "last_new_tick",
)  # fmt: skip


def _check(k: int, row: Sequence[float], dt: float, tick: int, part: int) -> Check:
    code, why, number, nu, spread, used, came = row
    if code == g.NOTHING and why == g.FINE:
        why = g.FINE if came else g.NOTHING_YET
    return Check(
        CHECKED[k], _STATUS[int(code)], nu, spread, nu / spread if spread > 0.0 else 0.0,
        (tick - int(used)) * dt, reason(int(why), number, k, part), code == g.FUSED and int(why) in ODD,
    )  # fmt: skip


_HEADING_COMPONENT = 3
_INNOVATIONS = (g.OFF, g.TAKEN_OVER, g.STRAINED)


def reason(why: int, number: float, sensor: int, component: int = 0) -> str:
    """Return why a sensor, by its place in :data:`mufly.estimate.layout.CHECKED`, is thought of as it is.

    ``component`` is that of a position fix that the number is of: N, E, D (m) or the heading (rad).
    """
    if sensor == R_FIX and component == _HEADING_COMPONENT and why in _INNOVATIONS:
        return _WORDS[why](math.degrees(number), "deg in heading")
    return _WORDS[why](number, _unit(sensor))


def _unit(k: int) -> str:
    unit = READINGS[CHECKED[k]].unit
    return {R_FIX: "m", R_MAGNET: "rad", R_SONAR: "m", R_PRESSURE: "Pa"}.get(k, unit)
