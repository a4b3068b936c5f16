"""Commands that come twice: programs repeat a command until they hear its acknowledgement.

The same command with the same parameters from the same station, within :data:`REPEAT_S` of the time before (or marked
as a repetition by its ``confirmation``, within :data:`CONFIRMED_S`), is answered as before and not carried out again,
if it was accepted. One that was refused is judged anew: whoever asks again may have done something about it. An
emergency stop is always carried out (:mod:`mufly.link.command_desk`).
"""

from __future__ import annotations

import struct
from collections import OrderedDict

from mufly.link.authority import Sender
from mufly.link.call import Call, Verdict
from mufly.link.dialect import mavlink

__all__ = ["CONFIRMED_S", "REPEAT_S", "Repeats"]

REPEAT_S = 0.8
"""Programs repeat after half a second (MAVSDK) or more; two presses of a key are further apart than this (s)."""
CONFIRMED_S = 10.0
_STATIONS = 32
_PARAMETERS = struct.Struct("<7d")


class Repeats:
    """Remembers the last command of each station."""

    def __init__(self) -> None:
        self._last: OrderedDict[Sender, tuple[float, int, bytes, Verdict]] = OrderedDict()

    def before(self, now_s: float, sender: Sender, call: Call) -> Verdict | None:
        """Return how a command was answered, if it is a repetition of one that was accepted."""
        last = self._last.get(sender)
        if last is None:
            return None
        when_s, number, parameters, verdict = last
        within_s = CONFIRMED_S if call.confirmation else REPEAT_S
        same = number == call.number and parameters == _PARAMETERS.pack(*call.p)
        if not same or now_s - when_s > within_s or verdict.result != mavlink.MAV_RESULT_ACCEPTED:
            return None
        self._last[sender] = (now_s, number, parameters, verdict)
        return verdict

    def note(self, now_s: float, sender: Sender, call: Call, verdict: Verdict) -> None:
        """Remember the answer to a command."""
        self._last[sender] = (now_s, call.number, _PARAMETERS.pack(*call.p), verdict)
        self._last.move_to_end(sender)
        while len(self._last) > _STATIONS:
            self._last.popitem(last=False)
