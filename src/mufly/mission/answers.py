"""What may be asked of the vehicle in which state: one table for the state machine, the autopilot, links and pages."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from mufly.mission.state import State

TABLE = """
asked     init      take-off  hover     waypoint  obstacle  landing   rc        offboard
arm       at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest
disarm    grounded  grounded  grounded  grounded  grounded  grounded  grounded  grounded
take-off  armed     up        up        up        up        up        up        up
start     armed     knows     knows     knows     knows     lands     by-hand   lifted
pause     floor     lifted    knows     knows     knows     high      by-hand   lifted
go-to     floor     lifted    knows     knows     knows     lands     by-hand   lifted
return    floor     lifted    knows     knows     knows     lands     by-hand   lifted
land      floor     knows     knows     knows     knows     yes       by-hand   knows
offboard  yes       lifted    knows     knows     knows     lands     by-hand   yes
sticks    seen      seen      seen      seen      seen      seen      seen      seen
load      still     busy      waits     busy      busy      busy      busy      busy
stop      yes       yes       yes       yes       yes       yes       yes       yes
"""
"""What is asked, over the states of the mission; each word is a condition below, which says why not."""

GO_AROUND_M = 0.4
"""Height above the floor from which a landing can be broken off (m)."""

OFF_FLOOR_M = 0.2
"""Height above where it stood from which a take-off can be broken off (m)."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Whether something asked for is done; ``bool(answer)`` says so.

    Attributes
    ----------
    accepted : bool
    reason : str
        Why not, with the remedy; or what to know about it.
    temporary : bool
        Refused for now; the same may be accepted later.
    brief : str
        Why not, in two or three words for a button.
    """

    accepted: bool
    reason: str = ""
    temporary: bool = False
    brief: str = ""

    def __bool__(self) -> bool:
        return self.accepted


ACCEPTED = Answer(True)


def never(reason: str) -> Answer:
    """Refused, whenever it is asked."""
    return Answer(False, reason)


def later(reason: str, brief: str = "") -> Answer:
    """Refused for now."""
    return Answer(False, reason, temporary=True, brief=brief or reason)


class Ask(StrEnum):
    """What may be asked of a vehicle."""

    ARM = "arm"
    DISARM = "disarm"
    TAKE_OFF = "take-off"
    START = "start"
    PAUSE = "pause"
    GO_TO = "go-to"
    RETURN = "return"
    LAND = "land"
    OFFBOARD = "offboard"
    STICKS = "sticks"
    LOAD = "load"
    STOP = "stop"


class Situation(Protocol):
    """What decides: a :class:`MissionState`, or any record of a flight that has these."""

    @property
    def state(self) -> str: ...
    @property
    def motors(self) -> str: ...
    @property
    def outcome(self) -> str: ...
    @property
    def reason(self) -> str: ...
    @property
    def manual(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class _Facts:
    s: Situation
    motors: str
    height_m: float
    armed: bool
    flying: bool


STOPPING = "its motors are being stopped; ask again"
"""Why nothing is taken between a stop and the step that carries it out."""

_LOST = later("measurements are lost; it comes down by itself", "comes down")


def _yes(f: _Facts) -> Answer:
    return ACCEPTED


def _at_rest(f: _Facts) -> Answer:
    # Armed now, motors that still run would be given back what was taken from them.
    return ACCEPTED if f.armed or f.motors == "off" else later(STOPPING, "motors running")


def _grounded(f: _Facts) -> Answer:
    return later("it flies; land first, or stop it by force", "in flight") if f.flying else ACCEPTED


def _up(f: _Facts) -> Answer:
    return later(f"it is in state {str(f.s.state)!r} already", "in the air")


def _armed(f: _Facts) -> Answer:
    if f.motors != "off":
        return _up(f)
    return ACCEPTED if f.armed else later("not armed; arm first", "not armed")


def _floor(f: _Facts) -> Answer:
    return later("it does not fly; take off first", "on the floor")


def _seen(f: _Facts) -> Answer:
    return _LOST if f.motors == "blind" else ACCEPTED


def _by_hand(f: _Facts) -> Answer:
    return _seen(f) and later("the pilot flies; let go of the sticks first", "flown by hand")


def _knows(f: _Facts) -> Answer:
    """It knows where it is, and has not given up."""
    failed = f.s.outcome == "failed"
    return _seen(f) and (later(f"it lands: {f.s.reason}", "landing") if failed else ACCEPTED)


def _lands(f: _Facts) -> Answer:
    return _knows(f) and later(f"it lands; pause first (above {GO_AROUND_M:g} m)", "landing")


def _high(f: _Facts) -> Answer:
    """Still high enough for a landing to be broken off."""
    if f.s.outcome == "failed" or f.motors != "fly":
        return _lands(f)
    low = f.height_m <= GO_AROUND_M
    return later(f"landing, and below {GO_AROUND_M:g} m already", "landing") if low else ACCEPTED


def _lifted(f: _Facts) -> Answer:
    """Off the floor for good."""
    if f.motors == "spin_up" or f.height_m < OFF_FLOOR_M:
        return _knows(f) and later(
            f"taking off; wait until it is {OFF_FLOOR_M:g} m off the floor", "taking off"
        )
    return _knows(f)


def _busy(f: _Facts) -> Answer:
    return later(f"in state {str(f.s.state)!r} no mission is taken; pause or land first", "in flight")


def _still(f: _Facts) -> Answer:
    return ACCEPTED if f.motors == "off" else _busy(f)


def _waits(f: _Facts) -> Answer:
    """It hovers, and no mission is being flown."""
    if f.motors != "fly":
        return _busy(f)
    return _knows(f) if f.s.manual else later("a mission is being flown; pause it first", "mission under way")


def _conditions() -> dict[tuple[str, str], Callable[[_Facts], Answer]]:
    head, *rows = (line.split() for line in TABLE.strip().splitlines())
    words = {(ask, state): word for ask, *cells in rows for state, word in zip(head[1:], cells, strict=True)}
    return {key: globals()["_" + word.replace("-", "_")] for key, word in words.items()}


_CONDITIONS = _conditions()


def may(
    ask: Ask,
    situation: Situation,
    *,
    height_m: float = math.nan,
    armed: bool = True,
    flying: bool | None = None,
) -> Answer:
    """Whether the state that a vehicle is in lets it do something; what else there is against it is not asked here.

    Parameters
    ----------
    ask : Ask
    situation : Situation
        ``state`` may be one that is not ours (a flight mode of another autopilot): that counts as a hover or as the
        floor. ``motors`` may be "" where it is not known.
    height_m : float
        Above where it stood (m); NaN where it is not known.
    armed : bool
    flying : bool, optional
        Whether it is off the floor; by default its state says so.
    """
    state = situation.state
    up = state not in ("", State.INIT) if flying is None else flying
    condition = _CONDITIONS.get((ask, state)) or _CONDITIONS[ask, State.HOVER if up else State.INIT]
    motors = situation.motors or ("fly" if up else "off")
    return condition(_Facts(situation, motors, height_m, armed, up))
