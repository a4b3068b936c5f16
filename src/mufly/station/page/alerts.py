"""What is said aloud: that the link or the battery goes, that something failed, was refused or is done.

:class:`Watch` looks at what one window shows, a few times a second, and returns each alert once. The browser speaks it,
or sounds a tone where it has no voice (``static/alerts.js``), unless it is muted. That the page has lost the station it
notices by itself.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from mufly.station.history import Message, MissionRow, Outcome, Request, Snapshot

LOW, EMPTY, AGAIN = 0.3, 0.15, 0.05
"""Charge of the battery from which it is a warning and an error, and what it has to rise by to be one again."""
REPEAT_S = 20.0
"""The same words are not said again within this time (s)."""
MOST_AT_ONCE = 3
_NUMBERS = re.compile(r"[-+.\d]+")
_RANK = {"info": 0, "warning": 1, "error": 2}


@dataclass(frozen=True, slots=True)
class Alert:
    """Something to be said aloud; ``level`` is "info", "warning" or "error", as of a message."""

    level: str
    text: str


@dataclass
class Watch:
    """What was alerted to already; one for each vehicle that a window shows."""

    _linked: bool | None = None
    _charge: int = 0
    _done: bool | None = None
    _heard: Message | None = None
    _begun: bool = False
    _answered: deque[Request] = field(default_factory=lambda: deque(maxlen=50))
    _said: dict[str, float] = field(default_factory=dict)

    def look(
        self,
        now_s: float,
        s: Snapshot,
        messages: Sequence[Message] = (),
        rows: Sequence[MissionRow] = (),
        requests: Iterable[Request] = (),
    ) -> list[Alert]:
        """Return what is new since the last look, the gravest first, at most three.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        s : Snapshot
        messages : sequence of Message
            Of the vehicle, newest last.
        rows : sequence of MissionRow
            Its mission.
        requests : iterable of Request
            Of this window.
        """
        found = [
            *self._link(s),
            *self._battery(s),
            *self._mission(rows),
            *self._requests(requests),
            *self._messages(messages),
        ]
        self._begun = True
        out = []
        for alert in sorted(found, key=lambda a: -_RANK.get(a.level, 0)):
            words = _NUMBERS.sub("", alert.text)  # the same with other numbers is the same
            if now_s - self._said.get(words, -math.inf) >= REPEAT_S:
                self._said[words] = now_s
                out.append(alert)
        self._said = {text: at for text, at in self._said.items() if now_s - at < REPEAT_S}
        return out[:MOST_AT_ONCE]

    def _link(self, s: Snapshot) -> list[Alert]:
        before, self._linked = self._linked, s.connected
        if before is None or before == s.connected:
            return []
        return [Alert("info", "link is back")] if s.connected else [Alert("error", "link lost")]

    def _battery(self, s: Snapshot) -> list[Alert]:
        charge = s.battery_charge
        if not math.isfinite(charge) or not s.connected:
            return []
        level = 2 if charge < EMPTY else 1 if charge < LOW else 0
        up = level < self._charge and charge < (EMPTY if self._charge == 2 else LOW) + AGAIN
        before, self._charge = self._charge, self._charge if up else level
        if level <= before:
            return []
        words = f"battery {'very ' if level == 2 else ''}low, {charge * 100:.0f} percent"
        return [Alert("error" if level == 2 else "warning", words)]

    def _mission(self, rows: Sequence[MissionRow]) -> list[Alert]:
        before, self._done = self._done, bool(rows) and all(r.reached for r in rows)
        return [Alert("info", "mission done")] if self._done and before is False else []

    def _requests(self, requests: Iterable[Request]) -> list[Alert]:
        out = []
        for request in requests:
            if not request.done or any(request is known for known in self._answered):
                continue
            self._answered.append(request)
            if not self._begun or request.outcome is Outcome.ACCEPTED or "given up for" in request.answer:
                continue
            what = "refused" if request.outcome is Outcome.REFUSED else "no answer"
            out.append(Alert("warning", f"{what}: {request.text}"))
        return out

    def _messages(self, messages: Sequence[Message]) -> list[Alert]:
        """Warnings and errors that the vehicle tells in words: a failsafe, a limit cycle, what it did not take."""
        fresh: list[Message] = []
        for message in reversed(messages):
            if message is self._heard:
                break
            fresh.append(message)
        if fresh:
            self._heard = fresh[0]
        if not self._begun:
            return []
        told = [m for m in reversed(fresh) if m.level != "info" and " is not heard any more" not in m.text]
        return [Alert(m.level, m.text) for m in told]
