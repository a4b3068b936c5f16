"""What a vehicle says in words: STATUSTEXT, put together again where it came in pieces.

A text longer than fifty bytes comes in chunks with a common id; a chunk that is shorter than that ends it. Pieces that
were lost leave "..." in their place. Source: https://mavlink.io/en/messages/common.html#STATUSTEXT.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from mufly.link.codec import MavMessage, mavlink, single, within
from mufly.station.view import Message, Outcome, Request

KEPT = 500
_CHUNK = 50
_WAIT_S = 2.0
_LEVELS = ("error", "error", "error", "error", "warning", "info", "info", "info")  # MAV_SEVERITY


@dataclass(slots=True)
class _Pieces:
    """A text of which pieces are missing."""

    since_s: float
    severity: int
    pieces: dict[int, str] = field(default_factory=dict)
    last: int | None = None


class Texts:
    """The messages of one vehicle, newest last.

    Attributes
    ----------
    messages : deque of Message
        Of bounded length.
    newest : tuple of (now_s, text)
        What was said last, by our clock; the reason of a refusal comes this way.
    on_message : callable or None
        Told of every message, for a recording.
    """

    def __init__(self) -> None:
        self.messages: deque[Message] = deque(maxlen=KEPT)
        self.newest: tuple[float, str] = (-math.inf, "")
        self.on_message: Callable[[Message], None] | None = None
        self._open: dict[tuple[int, int], _Pieces] = {}

    def handle(self, now_s: float, time_s: float, message: MavMessage) -> None:
        """Take a STATUSTEXT; ``time_s`` is the vehicle's clock."""
        text = str(message.text).rstrip("\0")
        if message.id == 0:
            self._said(now_s, time_s, message.severity, text)
            return
        key = (message.get_srcComponent(), message.id)
        if key not in self._open and len(self._open) >= 8:
            self._close(now_s, time_s, next(iter(self._open)))
        waiting = self._open.setdefault(key, _Pieces(now_s, message.severity))
        waiting.pieces[message.chunk_seq] = text
        if len(text.encode()) < _CHUNK:
            waiting.last = message.chunk_seq
        if waiting.last is not None and len(waiting.pieces) > waiting.last:
            self._close(now_s, time_s, key)

    def step(self, now_s: float, time_s: float) -> None:
        """Say what came of texts that wait for a piece that was lost."""
        for key in [k for k, waiting in self._open.items() if now_s - waiting.since_s > _WAIT_S]:
            self._close(now_s, time_s, key)

    def note(self, time_s: float, level: str, text: str) -> None:
        """Add a message of the station's own."""
        self._add(Message(time_s, level, text))

    def since(self, now_s: float) -> str:
        """Return what was said last if it was said since; "" if nothing was."""
        return self.newest[1] if self.newest[0] >= now_s else ""

    def _close(self, now_s: float, time_s: float, key: tuple[int, int]) -> None:
        waiting = self._open.pop(key)
        last = max(waiting.pieces) if waiting.last is None else waiting.last
        text = "".join(waiting.pieces.get(k, "...") for k in range(last + 1))
        self._said(now_s, time_s, waiting.severity, text + ("..." if waiting.last is None else ""))

    def _said(self, now_s: float, time_s: float, severity: int, text: str) -> None:
        self.newest = (now_s, text)
        self._add(Message(time_s, _LEVELS[min(severity, 7)], text))

    def _add(self, message: Message) -> None:
        self.messages.append(message)
        if self.on_message is not None:
            self.on_message(message)


# ----------------------------------------------------------------------------
# Commands that are asked of a vehicle until it answers.
#
# MAVLink's command protocol (https://mavlink.io/en/services/command.html): a command goes out, the vehicle
# acknowledges
# it with a result; if no answer comes it goes out again with ``confirmation`` counted up, so that the vehicle knows
# it
# for the same. An answer names the command only, so of each kind one is under way at a time and others wait their
# turn.
# Why a command was refused a vehicle says, if at all, in a STATUSTEXT about the same time.


RETRY_S = 0.8
TRIES = 12
"""Asked so often, a tenth of a second short of ten seconds. Of packets lost at 30 % each way, one command in 3000."""
PROGRESS_S = 30.0
"""After "in progress" the answer may take so long (s)."""
REASON_S = 0.4
"""For so long a refusal without words waits for some (s)."""
_NOT_GIVEN, _FARTHEST = 2**31 - 1, 2**31 - 2
_ENQUIRIES = (511, 512)  # SET_MESSAGE_INTERVAL, REQUEST_MESSAGE
_WORDS = {
    1: "not possible now",
    2: "refused",
    3: "the vehicle does not know this command",
    4: "failed",
    6: "cancelled",
    7: "only as a COMMAND_LONG",
    8: "only as a COMMAND_INT",
    9: "not in this frame of reference",
}


@dataclass(frozen=True, slots=True)
class Order:
    """A command and its parameters; NaN is "not given".

    Attributes
    ----------
    command : int
        MAV_CMD.
    params : (7,) tuple of float
    frame : int or None
        With a frame (MAV_FRAME) it goes as COMMAND_INT, whose x and y are metres times 1e4 or degrees times 1e7.
    urgent : bool
        Goes out at once; whatever else the vehicle has been asked to do and has not answered is given up for it.
    """

    command: int
    params: tuple[float, ...] = (math.nan,) * 7
    frame: int | None = None
    urgent: bool = False

    def message(self, system: int, component: int, confirmation: int) -> MavMessage:
        """Return it as MAVLink puts it."""
        p = (*self.params, *((0.0,) * (7 - len(self.params))))
        if self.frame is None:
            return mavlink.MAVLink_command_long_message(
                system, component, self.command, confirmation, *map(single, p)
            )
        scale = 1e4 if self.frame == 1 else 1e7
        # What does not fit into the field is out of anybody's reach; the vehicle says so.
        x, y = (within(v * scale, -_FARTHEST, _FARTHEST, _NOT_GIVEN) for v in p[4:6])
        return mavlink.MAVLink_command_int_message(
            system, component, self.frame, self.command, 0, 0, *map(single, p[:4]), x, y, single(p[6])
        )


@dataclass(slots=True)
class _Open:
    order: Order
    request: Request
    asked_s: float = -math.inf
    first_s: float = -math.inf
    tries: int = 0
    until_s: float = math.inf
    refused: str | None = None


def end(request: Request, outcome: Outcome, answer: str = "") -> None:
    """Give a request its answer, once."""
    if not request.done:
        request.outcome, request.answer = outcome, answer
        if outcome is Outcome.ACCEPTED:
            request.progress = 1.0


class Commands:
    """The commands asked of one vehicle.

    Parameters
    ----------
    texts : Texts
        Where the vehicle's reasons are found.
    target : (system, component)
    """

    def __init__(self, texts: Texts, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self._open: dict[int, _Open] = {}
        self._waiting: deque[_Open] = deque(maxlen=256)
        self._unanswered: list[MavMessage] = []

    def ask(self, text: str, order: Order) -> Request:
        """Ask for something; the request tells what becomes of it.

        Parameters
        ----------
        text : str
            What is asked for, in words.
        order : Order
        """
        request = Request(text)
        entry = _Open(order, request)
        if order.urgent:
            self._give_up_acts(f"given up for: {text}")
            self._open[order.command] = entry
        else:
            if len(self._waiting) == self._waiting.maxlen:
                end(self._waiting[0].request, Outcome.TIMED_OUT, "too many requests are waiting")
            self._waiting.append(entry)
        return request

    def send(self, message: MavMessage) -> None:
        """Send something that is not answered."""
        self._unanswered.append(message)

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a COMMAND_ACK that is meant for us."""
        entry = self._open.get(message.command)
        if entry is None or entry.refused is not None or not entry.tries:
            return
        if message.result == 0:
            del self._open[message.command]
            end(entry.request, Outcome.ACCEPTED)
        elif message.result == 5:
            entry.until_s = now_s + PROGRESS_S
            if message.progress <= 100:
                entry.request.progress = message.progress / 100.0
        else:
            entry.refused = _WORDS.get(message.result, f"result {message.result}")
            entry.until_s = now_s + REASON_S

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        for _ in range(len(self._waiting)):
            entry = self._waiting.popleft()
            if entry.order.command in self._open:
                self._waiting.append(entry)
            else:
                self._open[entry.order.command] = entry
        out, self._unanswered = self._unanswered, []
        for command, entry in list(self._open.items()):
            if entry.refused is not None:
                reason = self._texts.since(entry.first_s)
                if reason or now_s >= entry.until_s:
                    del self._open[command]
                    end(entry.request, Outcome.REFUSED, reason or entry.refused)
            elif entry.until_s < math.inf:
                if now_s >= entry.until_s:
                    del self._open[command]
                    end(entry.request, Outcome.TIMED_OUT, "begun, but it was never said to be done")
            elif now_s - entry.asked_s >= RETRY_S:
                if entry.tries >= TRIES:
                    del self._open[command]
                    waited = now_s - entry.first_s
                    end(entry.request, Outcome.TIMED_OUT, f"no answer in {waited:.0f} s; is the link up?")
                    continue
                if not entry.tries:
                    entry.first_s = now_s
                out.append(entry.order.message(*self.target, min(entry.tries, 255)))
                entry.asked_s = now_s
                entry.tries += 1
        return out

    def _give_up_acts(self, answer: str) -> None:
        """End all that would make the vehicle do something: an arming that waits must not follow a stop."""
        acts = [e for e in (*self._open.values(), *self._waiting) if e.order.command not in _ENQUIRIES]
        for entry in acts:
            end(entry.request, Outcome.REFUSED, answer)
            self._open.pop(entry.order.command, None)
        asks = [e for e in self._waiting if e.order.command in _ENQUIRIES]
        self._waiting.clear()
        self._waiting.extend(asks)

    def give_up(self, answer: str) -> None:
        """End everything that is open: the vehicle is gone or was started anew."""
        for entry in (*self._open.values(), *self._waiting):
            end(entry.request, Outcome.TIMED_OUT, answer)
        self._open.clear()
        self._waiting.clear()


class Chain:
    """Requests that follow each other: each is made when the one before was accepted; the first refusal ends it.

    Parameters
    ----------
    text : str
        What all of it is, in words.
    links : sequence of callables
        Each makes a request, or returns None if there is nothing to ask for.
    """

    def __init__(self, text: str, links: Sequence[Callable[[], Request | None]]) -> None:
        self.request = Request(text)
        self._links = deque(links)
        self._now: Request | None = None
        self.step()

    def step(self) -> None:
        """Go on if the present link has its answer."""
        while not self.request.done:
            if self._now is not None:
                if not self._now.done:
                    return
                if self._now.outcome is not Outcome.ACCEPTED:
                    end(self.request, self._now.outcome, f"{self._now.text}: {self._now.answer}")
                    return
            if not self._links:
                end(self.request, Outcome.ACCEPTED, self._now.answer if self._now else "")
                return
            self._now = self._links.popleft()()


# ----------------------------------------------------------------------------
# Taking and handing over the command of a vehicle (CHANGE_OPERATOR_CONTROL).
#
# A vehicle obeys one station at a time. A request is answered by CHANGE_OPERATOR_CONTROL_ACK; it is repeated until
# then.


AUTHORITY_RETRY_S = 0.8
AUTHORITY_TRIES = 12
_AUTHORITY_WORDS = {
    1: "the vehicle wants a key",
    2: "the vehicle knows no keys",
    3: "another station commands it; it has to hand over",
}


class CommandDesk:
    """Our place in the command of one vehicle.

    Parameters
    ----------
    system : int
        The vehicle's.
    us : (system, component)
    """

    def __init__(self, system: int, us: tuple[int, int]) -> None:
        self._system, self._us = system, us
        self._open: tuple[Request, int] | None = None
        self._asked_s, self._tries = -math.inf, 0

    def take(self) -> Request:
        """Ask for command."""
        return self._begin(Request("take command"), 0)

    def release(self) -> Request:
        """Hand command over."""
        return self._begin(Request("hand over command"), 1)

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take CHANGE_OPERATOR_CONTROL_ACK."""
        if (
            self._open is None
            or message.gcs_system_id != self._us[0]
            or message.control_request != self._open[1]
        ):
            return
        request, _ = self._open
        self._open = None
        if message.ack == 0:
            end(request, Outcome.ACCEPTED)
        else:
            end(request, Outcome.REFUSED, _AUTHORITY_WORDS.get(message.ack, f"result {message.ack}"))

    def step(self, now_s: float, commander: int | None) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._open is None or now_s - self._asked_s < AUTHORITY_RETRY_S:
            return []
        request, wish = self._open
        if self._tries >= AUTHORITY_TRIES:
            self._open = None
            words = (
                "this vehicle does not tell who commands it; it may obey every station"
                if commander is None
                else ""
            )
            end(request, Outcome.TIMED_OUT, words or "no answer; is the link up?")
            return []
        self._asked_s = now_s
        self._tries += 1
        return [mavlink.MAVLink_change_operator_control_message(self._system, wish, 0, b"")]

    def _begin(self, request: Request, wish: int) -> Request:
        if self._open is not None:
            end(self._open[0], Outcome.REFUSED, f"given up for: {request.text}")
        self._open = (request, wish)
        self._asked_s, self._tries = -math.inf, 0
        return request
