"""Who takes commands in: may the station, did it say so before, what comes of it, and the acknowledgement."""

from __future__ import annotations

from collections.abc import Callable

from mufly.link.authority import Sender
from mufly.link.bridge import Bridge
from mufly.link.call import Call, Verdict, call_of, from_anyone
from mufly.link.commands import carry_out
from mufly.link.controls import Controls
from mufly.link.dialect import MavMessage, mavlink
from mufly.link.enquiries import ENQUIRIES, enquire
from mufly.link.repeats import Repeats
from mufly.link.starting import set_mode, start_at
from mufly.link.voice import Voice

__all__ = ["CommandDesk"]

_HOLD_S = 0.3


class CommandDesk:
    """Takes COMMAND_LONG, COMMAND_INT and the messages that say the same: SET_MODE, MISSION_SET_CURRENT.

    Parameters
    ----------
    voice : Voice
    bridge : Bridge
    controls : callable
        Time (s) -> what commands act on.
    """

    def __init__(self, voice: Voice, bridge: Bridge, controls: Callable[[float], Controls]) -> None:
        self._voice, self._bridge, self._controls = voice, bridge, controls
        self._repeats = Repeats()
        self._held: tuple[float, Sender, Call] | None = None

    def command(self, now_s: float, sender: Sender, message: MavMessage) -> None:
        """Take a COMMAND_LONG or COMMAND_INT."""
        call, c = call_of(message), self._controls(now_s)
        if call.number in ENQUIRIES:
            client = self._voice.clients.hear(now_s, sender.peer)
            verdict, answers = enquire(now_s, call, client.wishes, c.origin is not None)
            self._acknowledge(sender, call, verdict)
            for answer in answers:
                self._voice.send(sender.peer, answer)
            return
        if from_anyone(call):
            # Never taken for a repetition: somebody may have armed it in between. What waits is not done after it.
            self._held = None
            c.on_arming.choose(now_s, "")
            self._carry_out(sender, call, c)
            return
        if not self._bridge.may(now_s, sender):
            self._acknowledge(sender, call, Verdict(mavlink.MAV_RESULT_DENIED))
            return
        before = self._repeats.before(now_s, sender, call)
        if before is not None:
            self._acknowledge(sender, call, before)
        elif c.sticks.by_mode and c.autopilot.status.sticks:
            # The flight software lets go of the sticks in its next step, and only then hears another command.
            c.sticks.off()
            self._held = (now_s + _HOLD_S, sender, call)
        else:
            self._carry_out(sender, call, c)

    def step(self, now_s: float) -> None:
        """Carry out what had to wait."""
        if self._held is None:
            return
        until_s, sender, call = self._held
        c = self._controls(now_s)
        if now_s >= until_s or c.autopilot.status.state != "rc":
            self._held = None
            self._carry_out(sender, call, c)

    def set_mode(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        """Take a SET_MODE, the older form of DO_SET_MODE."""
        if m.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED and self._bridge.may(now_s, sender):
            main, sub = m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24
            verdict = set_mode(main, sub, self._controls(now_s))
            self._acknowledge(sender, Call(mavlink.MAV_CMD_DO_SET_MODE, (0.0,) * 7, None), verdict)

    def set_current(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        """Take a MISSION_SET_CURRENT, the older form of DO_SET_MISSION_CURRENT; answered by MISSION_CURRENT."""
        if self._bridge.may(now_s, sender):
            verdict = start_at(float(m.seq), self._controls(now_s))
            self._voice.tell(now_s, sender, verdict.reason)
            client = self._voice.clients.get(sender.peer)
            if client is not None:
                client.wishes.ask_once(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)

    def _carry_out(self, sender: Sender, call: Call, c: Controls) -> None:
        verdict = carry_out(call, c)
        self._repeats.note(c.now_s, sender, call, verdict)
        self._acknowledge(sender, call, verdict)

    def _acknowledge(self, sender: Sender, call: Call, verdict: Verdict) -> None:
        if verdict.reason:
            level = "info" if verdict.result == mavlink.MAV_RESULT_ACCEPTED else "warning"
            self._voice.say(verdict.reason, level, sender.peer)
        self._voice.send(
            sender.peer,
            mavlink.MAVLink_command_ack_message(
                call.number, verdict.result, 0, 0, sender.system, sender.component
            ),
        )
