"""Table of the user requests permitted in each state of the mission, and functions that look it up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from mufly.estimate import Estimate
from mufly.mission.machine.mission_state import MissionState, State

REQUEST_PERMISSION_TABLE = """
asked     init      take-off  hover     waypoint  obstacle  landing   rc        offboard
arm       at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest   at-rest
disarm    grounded  grounded  grounded  grounded  grounded  grounded  grounded  grounded
take-off  armed     up        up        up        up        up        up        up
start     armed     knows     knows     knows     knows     lands     by-hand   lifted
pause     floor     knows     knows     knows     knows     high      by-hand   lifted
go-to     floor     lifted    knows     knows     knows     lands     by-hand   lifted
return    floor     lifted    knows     knows     knows     lands     by-hand   lifted
land      floor     knows     knows     knows     knows     yes       by-hand   knows
offboard  yes       lifted    knows     knows     knows     lands     by-hand   yes
sticks    seen      seen      seen      seen      seen      seen      seen      seen
load      still     waits     waits     waits     waits     busy      busy      busy
stop      yes       yes       yes       yes       yes       yes       yes       yes
"""
"""Permitted requests by state; each word names a condition below, which gives the reason for a refusal."""

MIN_GO_AROUND_HEIGHT_M = 0.4
"""Height above the floor above which a landing can be aborted (m)."""

MIN_TAKE_OFF_ABORT_HEIGHT_M = 0.2
"""Height above the standing position above which a take-off can be aborted (m)."""


@dataclass(frozen=True, slots=True)
class RequestAnswer:
    """Answer to a request; ``bool(answer)`` is True if it is accepted.

    Attributes
    ----------
    accepted : bool
    reason : str
        Reason for a refusal, with the remedy; or a remark on an accepted request.
    is_temporary : bool
        The request may be accepted later.
    short_reason : str
        Reason in two or three words for a button.
    """

    accepted: bool
    reason: str = ""
    is_temporary: bool = False
    short_reason: str = ""

    def __bool__(self) -> bool:
        return self.accepted


REQUEST_ACCEPTED = RequestAnswer(True)


def deny_request(reason: str) -> RequestAnswer:
    """Return a refusal that waiting does not change (MAV_RESULT_DENIED)."""
    return RequestAnswer(False, reason)


def reject_temporarily(reason: str, brief: str = "") -> RequestAnswer:
    """Return a refusal that holds only at present (MAV_RESULT_TEMPORARILY_REJECTED)."""
    return RequestAnswer(False, reason, is_temporary=True, short_reason=brief or reason)


class VehicleRequest(StrEnum):
    """Requests to a vehicle, such as arm, take off and land."""

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


class RequestContext(Protocol):
    """Facts that decide whether a request is permitted: a :class:`MissionState`, or a record with these attributes.

    ``reason`` is that of the outcome, or of the last change of state.
    """

    @property
    def state(self) -> str: ...
    @property
    def motors(self) -> str: ...
    @property
    def outcome(self) -> str: ...
    @property
    def reason(self) -> str: ...
    @property
    def user_in_control(self) -> bool: ...


@dataclass(frozen=True, slots=True)
class _RequestFacts:
    context: RequestContext
    motors: str
    height_m: float
    armed: bool
    flying: bool


MOTORS_STOPPING_REASON = "the motors are being stopped; repeat the request"
"""Reason for refusals between a stop and the step that executes it."""

_MEASUREMENTS_LOST_REFUSAL = reject_temporarily("measurements are lost; the vehicle descends by itself", "comes down")


def _allow_always(f: _RequestFacts) -> RequestAnswer:
    return REQUEST_ACCEPTED


def _allow_at_rest(f: _RequestFacts) -> RequestAnswer:
    # Arming would restore power to motors that are being stopped.
    return (
        REQUEST_ACCEPTED
        if f.armed or f.motors == "off"
        else reject_temporarily(MOTORS_STOPPING_REASON, "motors running")
    )


def _allow_grounded(f: _RequestFacts) -> RequestAnswer:
    return (
        reject_temporarily("the vehicle flies; land first, or disarm with force", "in flight")
        if f.flying
        else REQUEST_ACCEPTED
    )


def _deny_as_in_air(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily(f"the vehicle is already in state {str(f.context.state)!r}", "in the air")


def _allow_armed(f: _RequestFacts) -> RequestAnswer:
    if f.motors != "off":
        return _deny_as_in_air(f)
    return REQUEST_ACCEPTED if f.armed else reject_temporarily("not armed; arm first", "not armed")


def _deny_as_on_floor(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily("the vehicle does not fly; take off first", "on the floor")


def _allow_unless_blind(f: _RequestFacts) -> RequestAnswer:
    return _MEASUREMENTS_LOST_REFUSAL if f.motors == "blind" else REQUEST_ACCEPTED


def _deny_as_manual(f: _RequestFacts) -> RequestAnswer:
    return _allow_unless_blind(f) and reject_temporarily("the pilot flies; release the sticks first", "flown by hand")


def _allow_unless_failed(f: _RequestFacts) -> RequestAnswer:
    """Accept a request if the vehicle knows its position and the mission has not failed; else state the reason."""
    failed = f.context.outcome == "failed"
    return _allow_unless_blind(f) and (
        reject_temporarily(f"the vehicle lands: {f.context.reason}", "landing") if failed else REQUEST_ACCEPTED
    )


def _deny_as_landing(f: _RequestFacts) -> RequestAnswer:
    return _allow_unless_failed(f) and reject_temporarily(
        f"the vehicle lands; pause first (above {MIN_GO_AROUND_HEIGHT_M:g} m)", "landing"
    )


def _allow_go_around(f: _RequestFacts) -> RequestAnswer:
    """Accept a request during a landing if the height suffices to abort it; else state the reason."""
    if f.context.outcome == "failed" or f.motors != "fly":
        return _deny_as_landing(f)
    low = f.height_m <= MIN_GO_AROUND_HEIGHT_M
    return (
        reject_temporarily(f"landing below {MIN_GO_AROUND_HEIGHT_M:g} m, too low to abort", "landing")
        if low
        else REQUEST_ACCEPTED
    )


def _allow_lifted(f: _RequestFacts) -> RequestAnswer:
    """Accept a request if the vehicle is safely off the floor; else state the reason."""
    if f.motors == "spin_up" or f.height_m < MIN_TAKE_OFF_ABORT_HEIGHT_M:
        return _allow_unless_failed(f) and reject_temporarily(
            f"taking off; wait for a height of {MIN_TAKE_OFF_ABORT_HEIGHT_M:g} m", "taking off"
        )
    return _allow_unless_failed(f)


def _deny_as_busy(f: _RequestFacts) -> RequestAnswer:
    return reject_temporarily(
        f"in state {str(f.context.state)!r} no mission can be loaded; pause or land first", "in flight"
    )


def _allow_motors_off(f: _RequestFacts) -> RequestAnswer:
    return REQUEST_ACCEPTED if f.motors == "off" else _deny_as_busy(f)


def _allow_mission_waiting(f: _RequestFacts) -> RequestAnswer:
    """Accept a request if the motors run and the user, not a mission, commands the flight; else state the reason."""
    if f.motors not in ("spin_up", "fly"):
        return _deny_as_busy(f)
    return (
        _allow_unless_failed(f)
        if f.context.user_in_control
        else reject_temporarily("a mission is being flown; pause it first", "mission under way")
    )


_CONDITION_BY_WORD: dict[str, Callable[[_RequestFacts], RequestAnswer]] = {
    "yes": _allow_always,
    "at-rest": _allow_at_rest,
    "grounded": _allow_grounded,
    "up": _deny_as_in_air,
    "armed": _allow_armed,
    "floor": _deny_as_on_floor,
    "seen": _allow_unless_blind,
    "by-hand": _deny_as_manual,
    "knows": _allow_unless_failed,
    "lands": _deny_as_landing,
    "high": _allow_go_around,
    "lifted": _allow_lifted,
    "busy": _deny_as_busy,
    "still": _allow_motors_off,
    "waits": _allow_mission_waiting,
}
"""Condition functions by the words of :data:`REQUEST_PERMISSION_TABLE`."""


def _parse_permission_table() -> dict[tuple[str, str], Callable[[_RequestFacts], RequestAnswer]]:
    head, *rows = (line.split() for line in REQUEST_PERMISSION_TABLE.strip().splitlines())
    words = {(ask, state): word for ask, *cells in rows for state, word in zip(head[1:], cells, strict=True)}
    return {key: _CONDITION_BY_WORD[word] for key, word in words.items()}


_CONDITION_BY_REQUEST = _parse_permission_table()


def check_request(
    ask: VehicleRequest,
    situation: RequestContext,
    *,
    height_m: float = math.nan,
    armed: bool = True,
    flying: bool | None = None,
) -> RequestAnswer:
    """Return whether the vehicle's state permits a request; no other condition is checked.

    Parameters
    ----------
    ask : VehicleRequest
    situation : RequestContext
        ``state`` may be a flight mode of another autopilot: it counts as a hover or as on the floor. ``motors`` may be
        "" if unknown.
    height_m : float
        Height above the standing position (m); NaN if unknown.
    armed : bool
    flying : bool, optional
        Whether the vehicle is off the floor; derived from the state by default.
    """
    state = situation.state
    up = state not in ("", State.INIT) if flying is None else flying
    condition = _CONDITION_BY_REQUEST.get((ask, state)) or _CONDITION_BY_REQUEST[ask, State.HOVER if up else State.INIT]
    motors = situation.motors or ("fly" if up else "off")
    return condition(_RequestFacts(situation, motors, height_m, armed, up))


def is_request_permitted(ask: VehicleRequest, s: MissionState, m: Estimate) -> bool:
    """Return whether the state permits a request of an armed vehicle at the estimated height."""
    return bool(check_request(ask, s, height_m=s.home_position[2] - float(m.position[2])))
