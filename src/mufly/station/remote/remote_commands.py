"""Commands to a vehicle, repeated until acknowledged, and the vehicle's status texts.

MAVLink's command protocol (https://mavlink.io/en/services/command.html): the vehicle acknowledges a command with a
result. Without an answer the command is sent again with an incremented ``confirmation``, which marks a repetition.
An answer names only the command number, so one command of each number is open at a time and others wait. The reason of
a refusal arrives, if at all, in a STATUSTEXT at about the same time. Operator control (CHANGE_OPERATOR_CONTROL) is
requested in the same way.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mufly.link.codec import MavMessage, StatusTextAssembler, mavlink
from mufly.link.command_protocol import Command
from mufly.station.signal_history import OperatorRequest, RequestOutcome, StatusMessage

RETRY_PERIOD_S = 0.8
MAX_COMMAND_TRIES = 12
"""Tries of a command, within 9.9 s. At 30 % packet loss each way, one command in 3000 fails."""
PROGRESS_TIMEOUT_S = 30.0
"""Time limit of the answer after "in progress" (s)."""
REFUSAL_REASON_WAIT_S = 0.4
"""Wait of a refusal without a reason for a status text (s)."""
MAX_KEPT_MESSAGES = 500
_QUERY_COMMANDS = (511, 512)  # SET_MESSAGE_INTERVAL, REQUEST_MESSAGE
_INJECT_FAILURE_COMMAND = 420
_COMMAND_RESULT_TEXTS = {
    1: "temporarily rejected",
    2: "denied",
    3: "command not supported by the vehicle",
    4: "failed",
    6: "cancelled",
    7: "accepted as COMMAND_LONG only",
    8: "accepted as COMMAND_INT only",
    9: "coordinate frame not supported",
}
_CONTROL_RESULT_TEXTS = {
    1: "passkey required",
    2: "passkeys not supported",
    3: "another station has control and must release it",
}
_LEVEL_BY_SEVERITY = ("error", "error", "error", "error", "warning", "info", "info", "info")  # MAV_SEVERITY


class StatusTextLog:
    """Status texts (STATUSTEXT) of one vehicle, newest last.

    Attributes
    ----------
    messages : deque of StatusMessage
        Of bounded length.
    newest_text : tuple of (now_s, text)
        Latest text with the station's time (s); used as the reason of a refusal.
    on_message : callable or None
        Called with every message, for a recording.
    """

    def __init__(self) -> None:
        self.messages: deque[StatusMessage] = deque(maxlen=MAX_KEPT_MESSAGES)
        self.newest_text: tuple[float, str] = (-math.inf, "")
        self.on_message: Callable[[StatusMessage], None] | None = None
        self._pieces = StatusTextAssembler()

    def handle_status_text(self, now_s: float, time_s: float, message: MavMessage) -> None:
        """Process a STATUSTEXT; ``time_s`` is the vehicle's clock."""
        self._add_texts(now_s, time_s, self._pieces.add_chunk(now_s, message))

    def add_overdue_texts(self, now_s: float, time_s: float) -> None:
        """Add the incomplete texts whose missing piece is overdue."""
        self._add_texts(now_s, time_s, self._pieces.take_overdue(now_s))

    def add_message(self, time_s: float, level: str, text: str) -> None:
        """Add a message of the station itself to the log."""
        self.messages.append(message := StatusMessage(time_s, level, text))
        if self.on_message is not None:
            self.on_message(message)

    def latest_text_since(self, now_s: float) -> str:
        """Return the latest text if received after ``now_s``, else ""."""
        return self.newest_text[1] if self.newest_text[0] >= now_s else ""

    def _add_texts(self, now_s: float, time_s: float, texts: Sequence[tuple[int, str]]) -> None:
        for severity, text in texts:
            self.newest_text = (now_s, text)
            self.add_message(time_s, _LEVEL_BY_SEVERITY[min(severity, 7)], text)


@dataclass(slots=True)
class RepeatedRequest:
    """A request that is repeated until answered or out of tries."""

    request: OperatorRequest
    last_sent_s: float = -math.inf
    first_sent_s: float = -math.inf
    send_count: int = 0

    def count_try_if_due(self, now_s: float) -> bool:
        """Return whether to send the request at this time, and count the try; end the request after the last try."""
        if self.request.is_done or now_s - self.last_sent_s < RETRY_PERIOD_S:
            return False
        if self.send_count >= MAX_COMMAND_TRIES:
            self.request.set_outcome(
                RequestOutcome.TIMED_OUT, f"no answer in {now_s - self.first_sent_s:.0f} s; check the link"
            )
            return False
        if not self.send_count:
            self.first_sent_s = now_s
        self.last_sent_s = now_s
        self.send_count += 1
        return True


@dataclass(slots=True, kw_only=True)
class _OpenCommand(RepeatedRequest):
    """A command and the state of its answer."""

    command: Command
    answer_deadline_s: float = math.inf
    refusal_text: str | None = None


class RemoteCommands:
    """The open commands of one vehicle.

    Parameters
    ----------
    texts : StatusTextLog
        Source of the reasons of refusals.
    target : (system, component)
    """

    def __init__(self, texts: StatusTextLog, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self._open: dict[int, _OpenCommand] = {}
        self._waiting: deque[_OpenCommand] = deque(maxlen=256)
        self._unanswered: list[MavMessage] = []

    def request_command(self, text: str, command: Command) -> OperatorRequest:
        """Queue a command and return its request, which reports the outcome.

        An emergency stop is sent at once and cancels all unanswered actions.

        Parameters
        ----------
        text : str
            Description of the action.
        command : Command
        """
        request = OperatorRequest(text)
        entry = _OpenCommand(request, command=command)
        if command.is_emergency_stop:
            self.cancel_actions(f"superseded by: {text}")
            self._open[command.command_id] = entry
        else:
            if len(self._waiting) == self._waiting.maxlen:
                self._waiting[0].request.set_outcome(RequestOutcome.TIMED_OUT, "too many waiting requests")
            self._waiting.append(entry)
        return request

    def send_message(self, message: MavMessage) -> None:
        """Queue a message that has no answer."""
        self._unanswered.append(message)

    def handle_command_ack(self, now_s: float, message: MavMessage) -> None:
        """Process a COMMAND_ACK addressed to this station."""
        entry = self._open.get(message.command)
        if entry is None or entry.refusal_text is not None or not entry.send_count:
            return
        if message.result == mavlink.MAV_RESULT_ACCEPTED:
            del self._open[message.command]
            entry.request.set_outcome(RequestOutcome.ACCEPTED)
        elif message.result == mavlink.MAV_RESULT_IN_PROGRESS:
            entry.answer_deadline_s = now_s + PROGRESS_TIMEOUT_S
            if message.progress <= 100:
                entry.request.progress = message.progress / 100.0
        else:
            entry.refusal_text = _COMMAND_RESULT_TEXTS.get(message.result, f"result {message.result}")
            entry.answer_deadline_s = now_s + REFUSAL_REASON_WAIT_S

    def take_due_messages(self, now_s: float) -> list[MavMessage]:
        """Return the commands and messages to send at present, repetitions included."""
        for _ in range(len(self._waiting)):
            entry = self._waiting.popleft()
            if entry.command.command_id in self._open:
                self._waiting.append(entry)
            else:
                self._open[entry.command.command_id] = entry
        out, self._unanswered = self._unanswered, []
        for number, entry in list(self._open.items()):
            if entry.refusal_text is not None:
                reason = self._texts.latest_text_since(entry.first_sent_s)
                if reason or now_s >= entry.answer_deadline_s:
                    entry.request.set_outcome(RequestOutcome.REFUSED, reason or entry.refusal_text)
            elif entry.answer_deadline_s < math.inf:
                if now_s >= entry.answer_deadline_s:
                    entry.request.set_outcome(RequestOutcome.TIMED_OUT, "started, but completion not reported")
            elif entry.count_try_if_due(now_s):
                out.append(entry.command.to_message(*self.target, min(entry.send_count - 1, 255)))
            if entry.request.is_done:
                del self._open[number]
        return out

    def cancel_actions(self, answer: str, *, moves_only: bool = False, stops: bool = True) -> None:
        """Cancel all open actions, so that a waiting arming cannot follow a stop.

        Parameters
        ----------
        answer : str
            Reason, for the requests' answers.
        moves_only : bool
            Keep requests that do not move the vehicle: faults of a simulation.
        stops : bool
            Whether emergency stops are cancelled too.
        """

        def is_kept(entry: _OpenCommand) -> bool:
            number, stop = entry.command.command_id, entry.command.is_emergency_stop and not stops
            return number in _QUERY_COMMANDS or stop or (moves_only and number == _INJECT_FAILURE_COMMAND)

        for entry in (*self._open.values(), *self._waiting):
            if not is_kept(entry):
                entry.request.set_outcome(RequestOutcome.REFUSED, answer)
        self._open = {k: e for k, e in self._open.items() if is_kept(e)}
        self._waiting = deque(filter(is_kept, self._waiting), self._waiting.maxlen)

    def end_open_requests(self, answer: str) -> None:
        """End all open commands: the vehicle is lost or was restarted."""
        for entry in (*self._open.values(), *self._waiting):
            entry.request.set_outcome(RequestOutcome.TIMED_OUT, answer)
        self._open.clear()
        self._waiting.clear()


class RequestChain:
    """A sequence of requests: each starts once the preceding one is accepted; the first refusal ends the chain.

    Parameters
    ----------
    text : str
        Description of the whole chain.
    links : sequence of callables
        Each makes a request, or returns None if its step is not needed.
    """

    def __init__(self, text: str, links: Sequence[Callable[[], OperatorRequest | None]]) -> None:
        self.request = OperatorRequest(text)
        self._links = deque(links)
        self._now: OperatorRequest | None = None
        self.continue_if_answered()

    def continue_if_answered(self) -> None:
        """Continue if the present request is answered."""
        while not self.request.is_done:
            now = self._now
            if now is not None and not now.is_done:
                return
            if now is not None and now.outcome is not RequestOutcome.ACCEPTED:
                self.request.set_outcome(now.outcome, f"{now.text}: {now.answer}")
            elif not self._links:
                self.request.set_outcome(RequestOutcome.ACCEPTED, now.answer if now is not None else "")
            else:
                self._now = self._links.popleft()()


class OperatorControlClient:
    """Operator control of a vehicle, which accepts one station at a time.

    Parameters
    ----------
    system : int
        System number of the vehicle.
    us : (system, component)
        MAVLink address of the station.
    """

    def __init__(self, system: int, us: tuple[int, int]) -> None:
        self._system, self._us = system, us
        self._open: RepeatedRequest | None = None
        self._wish = 0

    def request_operator_control(self) -> OperatorRequest:
        """Request operator control."""
        return self._start_request(OperatorRequest("take operator control"), 0)

    def release_operator_control(self) -> OperatorRequest:
        """Release operator control."""
        return self._start_request(OperatorRequest("release operator control"), 1)

    def end_open_request(self, answer: str) -> None:
        """End the open request for operator control."""
        if self._open is not None:
            self._open.request.set_outcome(RequestOutcome.REFUSED, answer)
            self._open = None

    def handle_control_answer(self, now_s: float, message: MavMessage) -> None:
        """Process the vehicle's answer to a request for operator control (CHANGE_OPERATOR_CONTROL_ACK)."""
        if self._open is None or (message.gcs_system_id, message.control_request) != (
            self._us[0],
            self._wish,
        ):
            return
        request, self._open = self._open.request, None
        if message.ack == 0:
            request.set_outcome(RequestOutcome.ACCEPTED)
        else:
            request.set_outcome(RequestOutcome.REFUSED, _CONTROL_RESULT_TEXTS.get(message.ack, f"result {message.ack}"))

    def take_due_messages(self, now_s: float, commander: int | None) -> list[MavMessage]:
        """Return the requests for operator control to send at present."""
        if self._open is None:
            return []
        if self._open.count_try_if_due(now_s):
            return [mavlink.MAVLink_change_operator_control_message(self._system, self._wish, 0, b"")]
        if self._open.request.is_done:
            if commander is None:
                words = "the vehicle does not report which station has control; it may accept all stations"
                self._open.request.answer = words
            self._open = None
        return []

    def _start_request(self, request: OperatorRequest, wish: int) -> OperatorRequest:
        if self._open is not None:
            self._open.request.set_outcome(RequestOutcome.REFUSED, f"superseded by: {request.text}")
        self._open, self._wish = RepeatedRequest(request), wish
        return request
