"""Peers of a vehicle on its link: packet numbering, message rates and time of last contact of each.

A peer is a byte channel with one or more stations behind it, each a system and component. Every peer sets its own
message rates: by default those of :data:`mufly.link.telemetry_streams.MESSAGE_STREAMS`, else those requested by
SET_MESSAGE_INTERVAL (one message, interval in us; 0: default, -1: never) or, from older programs, by
REQUEST_DATA_STREAM (a group of messages at a rate).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Literal

from mufly.flight import Autopilot
from mufly.link.codec import FrameEncoder, MavMessage, MessageSource, OutgoingFrame, StatusTextSplitter, mavlink
from mufly.link.steering_input import StickInputHandler
from mufly.link.telemetry_streams import MESSAGE_STREAMS

MAX_STREAM_HZ = 200.0
"""Highest rate of a streamed message (Hz)."""
MAX_CLIENTS = 32
"""Largest number of peers served; the peer that was silent for longest makes room for a new one."""
CLIENT_TIMEOUT_S = 15.0
"""Silence (s) after which a calling peer is no longer served."""
_REFUSAL_PERIOD_S = 2.0

_STREAM_INDICES_BY_MESSAGE_ID = {
    n: [k for k, s in enumerate(MESSAGE_STREAMS) if s.message_id == n] for n in {s.message_id for s in MESSAGE_STREAMS}
}


class StreamSchedule:
    """The message rates of one peer, and the time at which each message is due.

    Parameters
    ----------
    now_s : float
    """

    def __init__(self, now_s: float) -> None:
        self._period_s = [_period_from_rate(s.default_rate_Hz) for s in MESSAGE_STREAMS]
        self._due_s = [now_s] * len(MESSAGE_STREAMS)
        self._once: list[int] = []

    def is_streamable(self, number: int) -> bool:
        """Return whether a message can be streamed or requested."""
        return number in _STREAM_INDICES_BY_MESSAGE_ID

    def set_message_interval(self, now_s: float, number: int, interval_us: float) -> bool:
        """Set the interval (us) at which this peer receives message ``number``: 0 default rate, -1 never.

        Return False if the message or interval is invalid.
        """
        if number not in _STREAM_INDICES_BY_MESSAGE_ID or not (interval_us == -1.0 or 0.0 <= interval_us < math.inf):
            return False
        for k in _STREAM_INDICES_BY_MESSAGE_ID[number]:
            if interval_us == 0.0:
                period = _period_from_rate(MESSAGE_STREAMS[k].default_rate_Hz)
            else:
                period = math.inf if interval_us < 0.0 else max(interval_us * 1e-6, 1.0 / MAX_STREAM_HZ)
            self._set_period(now_s, k, period)
        return True

    def interval_us(self, number: int) -> int:
        """Return the interval of a message (us); -1: never, 0: there is no such message."""
        if number not in _STREAM_INDICES_BY_MESSAGE_ID:
            return 0
        period = min(self._period_s[k] for k in _STREAM_INDICES_BY_MESSAGE_ID[number])
        return -1 if period == math.inf else min(round(period * 1e6), 2**31 - 1)

    def set_group_rate(self, now_s: float, group: int, rate_Hz: float) -> None:
        """Set the rate of a message group by the older message REQUEST_DATA_STREAM (0: all default streams)."""
        for k, stream in enumerate(MESSAGE_STREAMS):
            if stream.default_rate_Hz and stream.stream_group and group in (0, stream.stream_group):
                self._set_period(now_s, k, _period_from_rate(min(rate_Hz, MAX_STREAM_HZ)))

    def request_once(self, number: int) -> bool:
        """Request a message once, at the next step; return whether there is such a message."""
        wanted = _STREAM_INDICES_BY_MESSAGE_ID.get(number, [])
        self._once += [k for k in wanted if k not in self._once]
        return bool(wanted)

    def take_due_streams(self, now_s: float) -> Iterator[int]:
        """Yield the indices in :data:`MESSAGE_STREAMS` of the messages that are due, and mark them as sent.

        A peer that could not be served for a while gets the next message of each kind, not every missed one.
        """
        once, self._once = self._once, []
        yield from once
        for k, due_s in enumerate(self._due_s):
            if now_s >= due_s - 1e-6:
                period = self._period_s[k]
                self._due_s[k] = due_s + period if now_s - due_s < period else now_s + period
                if k not in once and period < math.inf:
                    yield k

    def _set_period(self, now_s: float, k: int, period_s: float) -> None:
        if period_s != self._period_s[k]:
            self._period_s[k] = period_s
            self._due_s[k] = now_s if period_s < math.inf else math.inf


def _period_from_rate(rate_Hz: float) -> float:
    return 1.0 / rate_Hz if rate_Hz > 0.0 else math.inf


@dataclass(slots=True)
class Client:
    """Record of one peer: its message encoder, its message rates, and the times of its messages.

    Attributes
    ----------
    peer : hashable
    encode : FrameEncoder
    schedule : StreamSchedule
    is_permanent : bool
        Whether the peer was configured by the user, and is kept when it is silent.
    last_heard_s : float
        Time of its last message (s).
    last_refusal_s : float
        Time of the last report why it may not command (s).
    """

    peer: Hashable
    encode: FrameEncoder
    schedule: StreamSchedule
    is_permanent: bool
    last_heard_s: float
    last_refusal_s: float = -math.inf


class Clients:
    """All peers, and the frames queued for each of them.

    Parameters
    ----------
    system, component : int
        MAVLink address of the vehicle.
    """

    def __init__(self, system: int, component: int) -> None:
        self._who = (system, component)
        self._all: dict[Hashable, Client] = {}
        self._texts = StatusTextSplitter()
        self._out: list[OutgoingFrame] = []

    def __iter__(self) -> Iterator[Client]:
        return iter(list(self._all.values()))

    def __len__(self) -> int:
        return len(self._all)

    def find_client(self, peer: Hashable) -> Client | None:
        """Return the record of a connected peer; None for an unknown peer."""
        return self._all.get(peer)

    def mark_heard(self, now_s: float, peer: Hashable) -> Client:
        """Record that a peer was heard; an unknown peer is added."""
        client = self._all.get(peer)
        if client is None:
            client = self.add_client(now_s, peer, fixed=False)
        client.last_heard_s = now_s
        return client

    def add_client(self, now_s: float, peer: Hashable, *, fixed: bool) -> Client:
        """Add a peer, which then receives the default messages."""
        client = self._all[peer] = Client(peer, FrameEncoder(*self._who), StreamSchedule(now_s), fixed, now_s)
        return client

    def drop_silent_clients(self, now_s: float) -> list[Hashable]:
        """Drop peers that are silent for too long, and the longest silent ones beyond the maximum; return them."""
        guests = sorted((c for c in self._all.values() if not c.is_permanent), key=lambda c: c.last_heard_s)
        surplus = max(0, len(self._all) - MAX_CLIENTS)
        leaving = [c.peer for k, c in enumerate(guests) if k < surplus or now_s - c.last_heard_s > CLIENT_TIMEOUT_S]
        for peer in leaving:
            del self._all[peer]
        return leaving

    def send_message(self, peer: Hashable | None, message: MavMessage) -> None:
        """Send a message to a peer; to all peers if None."""
        for client in self._all.values():
            if peer is None or client.peer == peer:
                self._out.append(OutgoingFrame(client.peer, client.encode(message)))

    def send_text(self, text: str, level: str = "info", peer: Hashable | None = None) -> None:
        """Send a text line to a peer; to all peers if None."""
        for message in self._texts(text, level):
            self.send_message(peer, message)

    def send_refusal(self, now_s: float, station: MessageSource, why: str) -> None:
        """Report to a station why a request is refused, at a limited rate."""
        client = self._all.get(station.peer)
        if why and client is not None and now_s - client.last_refusal_s > _REFUSAL_PERIOD_S:
            client.last_refusal_s = now_s
            self.send_text(why, "warning", station.peer)

    def take_outgoing(self) -> list[OutgoingFrame]:
        """Return the queued frames, and clear the queue."""
        out, self._out = self._out, []
        return out


# ----------------------------------------------------------------------------
# Operator control: one station commands, the others watch; loss of the commander has a failsafe.
#
# The first station that sends a command becomes the commander. It stays so until it hands over
# (CHANGE_OPERATOR_CONTROL), or was silent for :data:`COMMANDER_TIMEOUT_S` and another station sends a command. Every
# message of a station is a sign of life. In flight:
#
# ====================================  ===============================================
# commander's silence                   action
# ====================================  ===============================================
# ``COM_DL_LOSS_T``                     stop and hover
# ``COM_DL_LAND_T`` more                land
# ends                                  report it; the commander continues from there
# ====================================  ===============================================
#
# A flight without a commander (started by itself, or handed over) has no link failsafe. A landing and a return
# continue, because they end on the floor.


COMMANDER_TIMEOUT_S = 5.0
"""Silence after which another station may replace the commander (s)."""
_CONTROL_GRANTED, _CONTROL_WRONG_KEY, _CONTROL_HELD_BY_OTHER = 0, 2, 3

FailsafeStage = Literal["", "hover", "land"]
"""Stage of the link failsafe: none, or the requested action."""


class CommandAuthority:
    """Operator control: the station that commands the vehicle, and its link failsafe.

    Parameters
    ----------
    autopilot : Autopilot
    clients : Clients
    stick_input : StickInputHandler
        Manual control, which ends when its commander changes.

    Attributes
    ----------
    commander : MessageSource or None
    on_change : list of callables
        Called when the commander changes or leaves, to end the actions of the former commander.
    """

    def __init__(self, autopilot: Autopilot, clients: Clients, stick_input: StickInputHandler) -> None:
        self.commander: MessageSource | None = None
        self.on_change: list[Callable[[], None]] = [stick_input.forget_sticks]
        self._autopilot, self._clients, self._stick_input = autopilot, clients, stick_input
        self._heard_s = -math.inf
        self._stage: FailsafeStage = ""
        self._owed: FailsafeStage = ""

    def mark_heard(self, now_s: float, station: MessageSource) -> None:
        """Record a sign of life of a station."""
        if station == self.commander:
            self._heard_s = now_s

    def commander_silence_s(self, now_s: float) -> float:
        """Return the time (s) since the commander was last heard; 0 if there is no commander."""
        return 0.0 if self.commander is None else max(0.0, now_s - self._heard_s)

    def claim_command(self, now_s: float, station: MessageSource) -> bool:
        """Return whether a station may command the vehicle.

        If there is no commander, or it is silent, the station becomes commander; else the station receives a refusal.
        """
        if self.commander not in (None, station) and self.commander_silence_s(now_s) < COMMANDER_TIMEOUT_S:
            self._clients.send_refusal(
                now_s, station, f"denied: {self.commander} has operator control; release it there first"
            )
            return False
        self._heard_s = now_s
        if station != self.commander:
            self._set_commander(station)
            self._autopilot.log_event(f"commanded by {station}")
        return True

    def handle_operator_control(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        """Process a CHANGE_OPERATOR_CONTROL: 0 requests command, 1 releases it."""
        if m.control_request == 0:
            answer = (
                _CONTROL_WRONG_KEY
                if m.version
                else _CONTROL_GRANTED
                if self.claim_command(now_s, station)
                else _CONTROL_HELD_BY_OTHER
            )
        elif station == self.commander:
            answer = _CONTROL_GRANTED
            self._set_commander(None)
            self._autopilot.log_event(f"{station} has released operator control")
        else:
            answer = _CONTROL_HELD_BY_OTHER
        self._clients.send_message(
            station.peer,
            mavlink.MAVLink_change_operator_control_ack_message(station.system, m.control_request, answer),
        )

    def step_link_failsafe(self, now_s: float, *, loss_s: float, land_s: float) -> None:
        """Step the link failsafe: hover ``loss_s`` after the commander's last message, land ``land_s`` later (s)."""
        status, silent = self._autopilot.status, self.commander_silence_s(now_s)
        ending = status.state == "landing" or status.returning_home
        self._stage, order = next_link_loss_stage(
            self._stage, silent_s=silent, flying=status.flying, ending=ending, loss_s=loss_s, land_s=land_s
        )
        if order == "back":
            self._autopilot.log_event("commanding station connected again")
        elif order:
            self._stick_input.release_sticks()
            then = f"stop and hover, land in {land_s:g} s" if order == "hover" else "land"
            self._autopilot.log_event(f"commander not heard for {silent:.0f} s: {then}", "warning")
            self._owed = order
        # A temporarily rejected request (just off the floor, sticks in use) is repeated until it is accepted.
        if self._stage == "" or ending:
            self._owed = ""
        if self._owed:
            answer = self._autopilot.pause() if self._owed == "hover" else self._autopilot.land()
            self._owed = "" if answer else self._owed

    def _set_commander(self, station: MessageSource | None) -> None:
        self.commander = station
        for changed in self.on_change:
            changed()


def next_link_loss_stage(
    stage: FailsafeStage, *, silent_s: float, flying: bool, ending: bool, loss_s: float, land_s: float
) -> tuple[FailsafeStage, Literal["", "hover", "land", "back"]]:
    """Return the next stage of the link failsafe, and the action to take now.

    Parameters
    ----------
    stage : str
        Stage so far.
    silent_s : float
        Silence of the commander (s).
    flying, ending : bool
        Whether the vehicle is off the floor; whether it is landing or returning.
    loss_s, land_s : float
        COM_DL_LOSS_T and COM_DL_LAND_T (s).

    Returns
    -------
    stage : str
    order : str
        Order: "hover", "land", "back" (report that the link is back) or "" (none).
    """
    if silent_s < loss_s or not flying:
        return "", "back" if stage and flying else ""
    if stage == "" and not ending:
        return "hover", "hover"
    if stage == "hover" and silent_s >= loss_s + land_s:
        return "land", "" if ending else "land"
    return stage, ""
