"""What is asked of a vehicle until it answers, and what it says in words.

MAVLink's command protocol (https://mavlink.io/en/services/command.html): a command goes out, the vehicle acknowledges
it with a result; if no answer comes it goes out again with ``confirmation`` counted up, so that the vehicle knows it
for the same. An answer names the command only, so of each kind one is under way at a time and others wait their turn.
Why a command was refused a vehicle says, if at all, in a STATUSTEXT about the same time. Who commands a vehicle that
obeys one station at a time is asked for in the same way (CHANGE_OPERATOR_CONTROL).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mufly.link.codec import MavMessage, TextPieces, mavlink
from mufly.link.commands import Command
from mufly.station.history import Message, Outcome, Request

RETRY_S = 0.8
TRIES = 12
"""Asked so often, a tenth of a second short of ten seconds. Of packets lost at 30 % each way, one command in 3000."""
PROGRESS_S = 30.0
"""After "in progress" the answer may take so long (s)."""
REASON_S = 0.4
"""For so long a refusal without words waits for some (s)."""
KEPT_MESSAGES = 500
_ENQUIRIES = (511, 512)  # SET_MESSAGE_INTERVAL, REQUEST_MESSAGE
_INJECT_FAILURE = 420
_RESULTS = {
    1: "not possible now",
    2: "refused",
    3: "the vehicle does not know this command",
    4: "failed",
    6: "cancelled",
    7: "only as a COMMAND_LONG",
    8: "only as a COMMAND_INT",
    9: "not in this frame of reference",
}
_CONTROL_RESULTS = {
    1: "the vehicle wants a key",
    2: "the vehicle knows no keys",
    3: "another station commands it; it has to hand over",
}
_LEVELS = ("error", "error", "error", "error", "warning", "info", "info", "info")  # MAV_SEVERITY


class StatusTexts:
    """What one vehicle says (STATUSTEXT), newest last.

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
        self.messages: deque[Message] = deque(maxlen=KEPT_MESSAGES)
        self.newest: tuple[float, str] = (-math.inf, "")
        self.on_message: Callable[[Message], None] | None = None
        self._pieces = TextPieces()

    def handle(self, now_s: float, time_s: float, message: MavMessage) -> None:
        """Take a STATUSTEXT; ``time_s`` is the vehicle's clock."""
        self._say(now_s, time_s, self._pieces.take(now_s, message))

    def step(self, now_s: float, time_s: float) -> None:
        """Say what came of texts that wait for a piece that was lost."""
        self._say(now_s, time_s, self._pieces.overdue(now_s))

    def note(self, time_s: float, level: str, text: str) -> None:
        """Add a message of the station's own."""
        self.messages.append(message := Message(time_s, level, text))
        if self.on_message is not None:
            self.on_message(message)

    def since(self, now_s: float) -> str:
        """Return what was said last if it was said since; "" if nothing was."""
        return self.newest[1] if self.newest[0] >= now_s else ""

    def _say(self, now_s: float, time_s: float, texts: Sequence[tuple[int, str]]) -> None:
        for severity, text in texts:
            self.newest = (now_s, text)
            self.note(time_s, _LEVELS[min(severity, 7)], text)


@dataclass(slots=True)
class Repeated:
    """Something that is sent again until it is answered, and then given up."""

    request: Request
    asked_s: float = -math.inf
    first_s: float = -math.inf
    tries: int = 0

    def due(self, now_s: float) -> bool:
        """Whether to send it now; counts that it was. Sent often enough, the request is ended."""
        if self.request.done or now_s - self.asked_s < RETRY_S:
            return False
        if self.tries >= TRIES:
            self.request.end(Outcome.TIMED_OUT, f"no answer in {now_s - self.first_s:.0f} s; is the link up?")
            return False
        if not self.tries:
            self.first_s = now_s
        self.asked_s = now_s
        self.tries += 1
        return True


@dataclass(slots=True, kw_only=True)
class _Open(Repeated):
    """A command, and what is known of its answer."""

    command: Command
    until_s: float = math.inf
    refused: str | None = None


class RemoteCommands:
    """The commands asked of one vehicle.

    Parameters
    ----------
    texts : StatusTexts
        Where the vehicle's reasons are found.
    target : (system, component)
    """

    def __init__(self, texts: StatusTexts, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self._open: dict[int, _Open] = {}
        self._waiting: deque[_Open] = deque(maxlen=256)
        self._unanswered: list[MavMessage] = []

    def ask(self, text: str, command: Command) -> Request:
        """Ask for something; the request tells what becomes of it.

        An emergency stop goes out at once; whatever else the vehicle has been asked to do and has not answered is
        given up for it.

        Parameters
        ----------
        text : str
            What is asked for, in words.
        command : Command
        """
        request = Request(text)
        entry = _Open(request, command=command)
        if command.stops:
            self.give_up_acts(f"given up for: {text}")
            self._open[command.number] = entry
        else:
            if len(self._waiting) == self._waiting.maxlen:
                self._waiting[0].request.end(Outcome.TIMED_OUT, "too many requests are waiting")
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
        if message.result == mavlink.MAV_RESULT_ACCEPTED:
            del self._open[message.command]
            entry.request.end(Outcome.ACCEPTED)
        elif message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            entry.until_s = now_s + PROGRESS_S
            if message.progress <= 100:
                entry.request.progress = message.progress / 100.0
        else:
            entry.refused = _RESULTS.get(message.result, f"result {message.result}")
            entry.until_s = now_s + REASON_S

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        for _ in range(len(self._waiting)):
            entry = self._waiting.popleft()
            if entry.command.number in self._open:
                self._waiting.append(entry)
            else:
                self._open[entry.command.number] = entry
        out, self._unanswered = self._unanswered, []
        for number, entry in list(self._open.items()):
            if entry.refused is not None:
                reason = self._texts.since(entry.first_s)
                if reason or now_s >= entry.until_s:
                    entry.request.end(Outcome.REFUSED, reason or entry.refused)
            elif entry.until_s < math.inf:
                if now_s >= entry.until_s:
                    entry.request.end(Outcome.TIMED_OUT, "begun, but it was never said to be done")
            elif entry.due(now_s):
                out.append(entry.command.message(*self.target, min(entry.tries - 1, 255)))
            if entry.request.done:
                del self._open[number]
        return out

    def give_up_acts(self, answer: str, *, moves_only: bool = False, stops: bool = True) -> None:
        """End all that would make the vehicle do something: an arming that waits must not follow a stop.

        Parameters
        ----------
        answer : str
            Why, for whoever asked.
        moves_only : bool
            Leave what does not move it: faults of a simulation.
        stops : bool
            Whether an emergency stop is given up too.
        """

        def kept(entry: _Open) -> bool:
            number, stop = entry.command.number, entry.command.stops and not stops
            return number in _ENQUIRIES or stop or (moves_only and number == _INJECT_FAILURE)

        for entry in (*self._open.values(), *self._waiting):
            if not kept(entry):
                entry.request.end(Outcome.REFUSED, answer)
        self._open = {k: e for k, e in self._open.items() if kept(e)}
        self._waiting = deque(filter(kept, self._waiting), self._waiting.maxlen)

    @property
    def acting(self) -> bool:
        """Whether something that would make the vehicle do something is not answered yet."""
        return any(e.command.number not in _ENQUIRIES for e in (*self._open.values(), *self._waiting))

    def give_up(self, answer: str) -> None:
        """End everything that is open: the vehicle is gone or was started anew."""
        for entry in (*self._open.values(), *self._waiting):
            entry.request.end(Outcome.TIMED_OUT, answer)
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
            now = self._now
            if now is not None and not now.done:
                return
            if now is not None and now.outcome is not Outcome.ACCEPTED:
                self.request.end(now.outcome, f"{now.text}: {now.answer}")
            elif not self._links:
                self.request.end(Outcome.ACCEPTED, now.answer if now is not None else "")
            else:
                self._now = self._links.popleft()()


class OperatorControl:
    """Taking and handing over the command of a vehicle, which obeys one station at a time.

    Parameters
    ----------
    system : int
        The vehicle's.
    us : (system, component)
    """

    def __init__(self, system: int, us: tuple[int, int]) -> None:
        self._system, self._us = system, us
        self._open: Repeated | None = None
        self._wish = 0

    def take(self) -> Request:
        """Ask for command."""
        return self._begin(Request("take command"), 0)

    def release(self) -> Request:
        """Hand command over."""
        return self._begin(Request("hand over command"), 1)

    def give_up(self, answer: str) -> None:
        """End what is open."""
        if self._open is not None:
            self._open.request.end(Outcome.REFUSED, answer)
            self._open = None

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take CHANGE_OPERATOR_CONTROL_ACK."""
        if self._open is None or (message.gcs_system_id, message.control_request) != (
            self._us[0],
            self._wish,
        ):
            return
        request, self._open = self._open.request, None
        if message.ack == 0:
            request.end(Outcome.ACCEPTED)
        else:
            request.end(Outcome.REFUSED, _CONTROL_RESULTS.get(message.ack, f"result {message.ack}"))

    def step(self, now_s: float, commander: int | None) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._open is None:
            return []
        if self._open.due(now_s):
            return [mavlink.MAVLink_change_operator_control_message(self._system, self._wish, 0, b"")]
        if self._open.request.done:
            if commander is None:
                words = "this vehicle does not tell who commands it; it may obey every station"
                self._open.request.answer = words
            self._open = None
        return []

    def _begin(self, request: Request, wish: int) -> Request:
        if self._open is not None:
            self._open.request.end(Outcome.REFUSED, f"given up for: {request.text}")
        self._open, self._wish = Repeated(request), wish
        return request
