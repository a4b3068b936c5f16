"""One command and its verdict: what COMMAND_LONG and COMMAND_INT have in common."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.dialect import MavMessage, mavlink

if TYPE_CHECKING:
    from mufly.flight import Answer

__all__ = [
    "ACCEPTED", "FORCE", "LOCAL_FRAMES", "Call", "Verdict", "call_of", "denied", "from_anyone", "refused", "verdict_of",
]  # fmt: skip

FORCE = 21196.0
"""The magic number of COMPONENT_ARM_DISARM that stops the motors in flight."""

LOCAL_FRAMES = (1, 4, 7, 8, 9, 12)
"""Values of MAV_FRAME in metres."""
_NOT_GIVEN = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Call:
    """One command.

    Attributes
    ----------
    number : int
        MAV_CMD.
    p : tuple of 7 floats
        Its parameters; 5 and 6 in degrees or metres; NaN where not given.
    frame : int or None
        MAV_FRAME of a COMMAND_INT.
    confirmation : int
        Above 0: a repetition.
    """

    number: int
    p: tuple[float, ...]
    frame: int | None
    confirmation: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to acknowledge (MAV_RESULT), and why, in words."""

    result: int
    reason: str = ""


ACCEPTED = Verdict(mavlink.MAV_RESULT_ACCEPTED)


def verdict_of(answer: Answer) -> Verdict:
    """The autopilot's answer as a verdict."""
    if answer:
        return ACCEPTED
    return refused(answer.reason) if answer.temporary else denied(answer.reason)


def refused(why: str) -> Verdict:
    """Not now."""
    return Verdict(mavlink.MAV_RESULT_TEMPORARILY_REJECTED, why)


def denied(why: str) -> Verdict:
    """Not at all."""
    return Verdict(mavlink.MAV_RESULT_DENIED, why)


def call_of(message: MavMessage) -> Call:
    """Return the command of a COMMAND_LONG or COMMAND_INT."""
    m = message
    first = (m.param1, m.param2, m.param3, m.param4)
    if m.get_type() == "COMMAND_LONG":
        return Call(m.command, (*first, m.param5, m.param6, m.param7), None, m.confirmation)
    scale = 1e-4 if m.frame in LOCAL_FRAMES else 1e-7
    x, y = (math.nan if v == _NOT_GIVEN else v * scale for v in (m.x, m.y))
    return Call(m.command, (*first, x, y, m.z), m.frame)


def from_anyone(call: Call) -> bool:
    """Whether a command is an emergency stop, which anyone may give."""
    if call.number == mavlink.MAV_CMD_DO_FLIGHTTERMINATION:
        return call.p[0] > 0.5
    return call.number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM and call.p[0] == 0.0 and call.p[1] == FORCE
