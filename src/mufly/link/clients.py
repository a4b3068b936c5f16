"""The peers of a vehicle: each with its own packet numbering, message rates and time of last contact.

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
from mufly.link.steering_input import ManualControl
from mufly.link.telemetry_streams import MESSAGE_STREAMS

MAX_STREAM_HZ = 200.0
"""Highest rate of a streamed message (Hz)."""
MAX_CLIENTS = 32
"""So many peers are served; the one that was silent for longest makes room."""
CLIENT_TIMEOUT_S = 15.0
"""A peer that called and has been silent for so long is sent nothing more (s)."""
_REFUSAL_PERIOD_S = 2.0

_STREAMS_BY_MESSAGE_ID = {
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
        return number in _STREAMS_BY_MESSAGE_ID

    def set_message_interval(self, now_s: float, number: int, interval_us: float) -> bool:
        """Set a requested interval; return False if the message or interval is invalid."""
        if number not in _STREAMS_BY_MESSAGE_ID or not (interval_us == -1.0 or 0.0 <= interval_us < math.inf):
            return False
        for k in _STREAMS_BY_MESSAGE_ID[number]:
            if interval_us == 0.0:
                period = _period_from_rate(MESSAGE_STREAMS[k].default_rate_Hz)
            else:
                period = math.inf if interval_us < 0.0 else max(interval_us * 1e-6, 1.0 / MAX_STREAM_HZ)
            self._set_period(now_s, k, period)
        return True

    def interval_us(self, number: int) -> int:
        """The interval of a message (us); -1: never, 0: there is no such message."""
        if number not in _STREAMS_BY_MESSAGE_ID:
            return 0
        period = min(self._period_s[k] for k in _STREAMS_BY_MESSAGE_ID[number])
        return -1 if period == math.inf else min(round(period * 1e6), 2**31 - 1)

    def set_group_rate(self, now_s: float, group: int, rate_Hz: float) -> None:
        """Set the rate of a message group, in the older form (0: all default streams)."""
        for k, stream in enumerate(MESSAGE_STREAMS):
            if stream.default_rate_Hz and stream.stream_group and group in (0, stream.stream_group):
                self._set_period(now_s, k, _period_from_rate(min(rate_Hz, MAX_STREAM_HZ)))

    def request_once(self, number: int) -> bool:
        """Want a message once, now; returns whether there is such a message."""
        wanted = _STREAMS_BY_MESSAGE_ID.get(number, [])
        self._once += [k for k in wanted if k not in self._once]
        return bool(wanted)

    def take_due_streams(self, now_s: float) -> Iterator[int]:
        """Yield the places in :data:`MESSAGE_STREAMS` of what is due, and count it as sent.

        A peer that could not be served for a while gets the next message of each kind, not all that it missed.
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
    """One peer.

    Attributes
    ----------
    peer : hashable
    encode : Encoder
    schedule : Wishes
    is_permanent : bool
        Whether the vehicle was told to send there, whoever may listen.
    last_heard_s : float
        When it was last heard.
    last_refusal_s : float
        When it was last told why it may not command.
    """

    peer: Hashable
    encode: FrameEncoder
    schedule: StreamSchedule
    is_permanent: bool
    last_heard_s: float
    last_refusal_s: float = -math.inf


class Clients:
    """All peers, and what is to be sent to them: packed for each, and kept until it is taken.

    Parameters
    ----------
    system, component : int
        Who the vehicle is.
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
        """Return a peer that is served."""
        return self._all.get(peer)

    def mark_heard(self, now_s: float, peer: Hashable) -> Client:
        """Note a sign of life of a peer, which is served from now on."""
        client = self._all.get(peer)
        if client is None:
            client = self.add_client(now_s, peer, fixed=False)
        client.last_heard_s = now_s
        return client

    def add_client(self, now_s: float, peer: Hashable, *, fixed: bool) -> Client:
        """Serve a peer."""
        client = self._all[peer] = Client(peer, FrameEncoder(*self._who), StreamSchedule(now_s), fixed, now_s)
        return client

    def drop_silent_clients(self, now_s: float) -> list[Hashable]:
        """Serve no more who has been silent for too long, and whom there is no room for; returns who that is."""
        guests = sorted((c for c in self._all.values() if not c.is_permanent), key=lambda c: c.last_heard_s)
        surplus = max(0, len(self._all) - MAX_CLIENTS)
        leaving = [c.peer for k, c in enumerate(guests) if k < surplus or now_s - c.last_heard_s > CLIENT_TIMEOUT_S]
        for peer in leaving:
            del self._all[peer]
        return leaving

    def send_message(self, peer: Hashable | None, message: MavMessage) -> None:
        """Send a message to a peer; to all if None."""
        for client in self._all.values():
            if peer is None or client.peer == peer:
                self._out.append(OutgoingFrame(client.peer, client.encode(message)))

    def send_text(self, text: str, level: str = "info", peer: Hashable | None = None) -> None:
        """Send a text line to a peer; to all if None."""
        for message in self._texts(text, level):
            self.send_message(peer, message)

    def send_refusal(self, now_s: float, station: MessageSource, why: str) -> None:
        """Report to a station why a request is refused, at a limited rate."""
        client = self._all.get(station.peer)
        if why and client is not None and now_s - client.last_refusal_s > _REFUSAL_PERIOD_S:
            client.last_refusal_s = now_s
            self.send_text(why, "warning", station.peer)

    def take_outgoing(self) -> list[OutgoingFrame]:
        """Return the frames to send."""
        out, self._out = self._out, []
        return out


# ----------------------------------------------------------------------------
# Who commands: one station at a time, the others watch; and what happens when the commander is lost.
#
# The first to command takes command. It keeps it until it hands over (CHANGE_OPERATOR_CONTROL), or has not been heard
# for :data:`COMMANDER_TIMEOUT_S`; then the next to command has it. Anything that a station says is a sign of life. In
# flight:
#
# ====================================  ===============================================
# for ``COM_DL_LOSS_T`` not a word      stop and hover
# for ``COM_DL_LAND_T`` more            land
# a word again                          said; whoever commands goes on from there
# ====================================  ===============================================
#
# Without a commander (a flight that was started by itself, or was handed over) there is nobody to lose. A landing,
# and a flight home, go on: they end on the floor anyway.


COMMANDER_TIMEOUT_S = 5.0
"""After so long without a word the commander may be replaced (s)."""
_CONTROL_GRANTED, _CONTROL_WRONG_KEY, _CONTROL_HELD_BY_OTHER = 0, 2, 3

FailsafeStage = Literal["", "hover", "land"]
"""The stage of the failsafe: none, or the action ordered."""


class CommandAuthority:
    """Where command is held.

    Parameters
    ----------
    autopilot : Autopilot
    clients : Clients
    manual : ManualControl
        Sticks end with the commander who had them.

    Attributes
    ----------
    commander : Source or None
    on_change : list of callables
        Called when somebody else commands, or nobody: what the one before has begun ends.
    """

    def __init__(self, autopilot: Autopilot, clients: Clients, manual: ManualControl) -> None:
        self.commander: MessageSource | None = None
        self.on_change: list[Callable[[], None]] = [manual.forget_sticks]
        self._autopilot, self._clients, self._manual = autopilot, clients, manual
        self._heard_s = -math.inf
        self._stage: FailsafeStage = ""
        self._owed: FailsafeStage = ""

    def mark_heard(self, now_s: float, station: MessageSource) -> None:
        """Note a sign of life."""
        if station == self.commander:
            self._heard_s = now_s

    def commander_silence_s(self, now_s: float) -> float:
        """For how long the commander has not been heard (s); 0 if there is none."""
        return 0.0 if self.commander is None else max(0.0, now_s - self._heard_s)

    def may_command(self, now_s: float, station: MessageSource) -> bool:
        """Whether a station commands; the first to ask does. One that may not is told who does."""
        if self.commander not in (None, station) and self.commander_silence_s(now_s) < COMMANDER_TIMEOUT_S:
            self._clients.send_refusal(now_s, station, f"denied: commanded by {self.commander}; ask it to hand over")
            return False
        self._heard_s = now_s
        if station != self.commander:
            self._set_commander(station)
            self._autopilot.log_event(f"commanded by {station}")
        return True

    def handle_operator_control(self, now_s: float, station: MessageSource, m: MavMessage) -> None:
        """Take a CHANGE_OPERATOR_CONTROL: 0 asks for command, 1 hands it over."""
        if m.control_request == 0:
            answer = (
                _CONTROL_WRONG_KEY
                if m.version
                else _CONTROL_GRANTED
                if self.may_command(now_s, station)
                else _CONTROL_HELD_BY_OTHER
            )
        elif station == self.commander:
            answer = _CONTROL_GRANTED
            self._set_commander(None)
            self._autopilot.log_event(f"{station} has handed over command")
        else:
            answer = _CONTROL_HELD_BY_OTHER
        self._clients.send_message(
            station.peer,
            mavlink.MAVLink_change_operator_control_ack_message(station.system, m.control_request, answer),
        )

    def step_link_failsafe(self, now_s: float, *, loss_s: float, land_s: float) -> None:
        """Hover, then land, when the commander is lost: after COM_DL_LOSS_T, and COM_DL_LAND_T more (s)."""
        status, silent = self._autopilot.status, self.commander_silence_s(now_s)
        ending = status.state == "landing" or status.returning_home
        self._stage, order = judge_link_loss(
            self._stage, silent_s=silent, flying=status.flying, ending=ending, loss_s=loss_s, land_s=land_s
        )
        if order == "back":
            self._autopilot.log_event("the commander is heard again")
        elif order:
            self._manual.release_sticks()
            then = f"stop and hover, land in {land_s:g} s" if order == "hover" else "land"
            self._autopilot.log_event(f"commander not heard for {silent:.0f} s: {then}", "warning")
            self._owed = order
        # What is refused for the moment (just off the floor, sticks in the hand) is asked for until it is done.
        if self._stage == "" or ending:
            self._owed = ""
        if self._owed:
            answer = self._autopilot.pause() if self._owed == "hover" else self._autopilot.land()
            self._owed = "" if answer else self._owed

    def _set_commander(self, station: MessageSource | None) -> None:
        self.commander = station
        for changed in self.on_change:
            changed()


def judge_link_loss(
    stage: FailsafeStage, *, silent_s: float, flying: bool, ending: bool, loss_s: float, land_s: float
) -> tuple[FailsafeStage, Literal["", "hover", "land", "back"]]:
    """Judge the link once.

    Parameters
    ----------
    stage : str
        How far the failsafe had gone before.
    silent_s : float
        For how long the commander has not been heard (s).
    flying, ending : bool
        Whether it is off the floor; whether it is landing or on its way home.
    loss_s, land_s : float
        COM_DL_LOSS_T and COM_DL_LAND_T (s).

    Returns
    -------
    stage : str
    order : str
        What to do now: "hover", "land", nothing (""), or say that the link is "back".
    """
    if silent_s < loss_s or not flying:
        return "", "back" if stage and flying else ""
    if stage == "" and not ending:
        return "hover", "hover"
    if stage == "hover" and silent_s >= loss_s + land_s:
        return "land", "" if ending else "land"
    return stage, ""
