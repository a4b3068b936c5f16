"""Spoken alerts: loss of the link, low battery, failures, refusals and completed requests.

:class:`AlertWatch` checks the state shown in one window a few times a second and returns each alert once. The browser
speaks the alert, or sounds a tone without a voice (``static/alerts.js``), unless muted. The page itself detects the
loss of the station.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import takewhile

from mufly.station.signal_history import (
    MissionRow,
    OperatorRequest,
    RequestOutcome,
    StatusMessage,
    VehicleSnapshot,
)

LOW_CHARGE_FRACTION, EMPTY_CHARGE_FRACTION, CHARGE_HYSTERESIS = 0.3, 0.15, 0.05
"""Battery charge (0..1) of a warning and of an error, and the rise that re-arms them."""
ALERT_REPEAT_PERIOD_S = 20.0
"""Time within which the same alert is not repeated (s)."""
MAX_ALERTS_PER_CALL = 3
_NUMBER_PATTERN = re.compile(r"[-+.\d]+")
_RANK_BY_LEVEL = {"info": 0, "warning": 1, "error": 2}


@dataclass(frozen=True, slots=True)
class SpokenAlert:
    """An alert to be spoken; ``level`` is "info", "warning" or "error", as in a status message."""

    level: str
    text: str


@dataclass
class AlertWatch:
    """The alerts already given for one vehicle in one window."""

    _was_connected: bool | None = None
    _charge_level: int = 0
    _was_mission_done: bool | None = None
    _last_message: StatusMessage | None = None
    _has_begun: bool = False
    _answered_requests: deque[OperatorRequest] = field(default_factory=lambda: deque(maxlen=50))
    _last_spoken_s: dict[str, float] = field(default_factory=dict)

    def find_new_alerts(
        self,
        now_s: float,
        s: VehicleSnapshot,
        messages: Sequence[StatusMessage] = (),
        rows: Sequence[MissionRow] = (),
        requests: Iterable[OperatorRequest] = (),
    ) -> list[SpokenAlert]:
        """Return at most three alerts that are new since the last call, the most severe first.

        Parameters
        ----------
        now_s : float
            Our clock (s).
        s : VehicleSnapshot
        messages : sequence of StatusMessage
            Messages of the vehicle, newest last.
        rows : sequence of MissionRow
            Rows of the vehicle's mission.
        requests : iterable of OperatorRequest
            Requests of this window.
        """
        found = [
            *self._check_link(s),
            *self._check_battery(s),
            *self._check_mission(rows),
            *self._check_requests(requests),
            *self._check_messages(messages),
        ]
        self._has_begun = True
        out = []
        for alert in sorted(found, key=lambda a: -_RANK_BY_LEVEL.get(a.level, 0)):
            words = _NUMBER_PATTERN.sub("", alert.text)  # the same with other numbers is the same
            if now_s - self._last_spoken_s.get(words, -math.inf) >= ALERT_REPEAT_PERIOD_S:
                self._last_spoken_s[words] = now_s
                out.append(alert)
        self._last_spoken_s = {
            text: at for text, at in self._last_spoken_s.items() if now_s - at < ALERT_REPEAT_PERIOD_S
        }
        return out[:MAX_ALERTS_PER_CALL]

    def _check_link(self, s: VehicleSnapshot) -> list[SpokenAlert]:
        before, self._was_connected = self._was_connected, s.connected
        if before is None or before == s.connected:
            return []
        return (
            [SpokenAlert("info", "communication regained")]
            if s.connected
            else [SpokenAlert("error", "communication lost")]
        )

    def _check_battery(self, s: VehicleSnapshot) -> list[SpokenAlert]:
        charge = s.battery_charge
        if not math.isfinite(charge) or not s.connected:
            return []
        level = 2 if charge < EMPTY_CHARGE_FRACTION else 1 if charge < LOW_CHARGE_FRACTION else 0
        up = (
            level < self._charge_level
            and charge < (EMPTY_CHARGE_FRACTION if self._charge_level == 2 else LOW_CHARGE_FRACTION) + CHARGE_HYSTERESIS
        )
        before, self._charge_level = self._charge_level, self._charge_level if up else level
        if level <= before:
            return []
        words = f"battery {'critical' if level == 2 else 'low'}, {charge * 100:.0f} percent"
        return [SpokenAlert("error" if level == 2 else "warning", words)]

    def _check_mission(self, rows: Sequence[MissionRow]) -> list[SpokenAlert]:
        before, self._was_mission_done = self._was_mission_done, bool(rows) and all(r.reached for r in rows)
        return [SpokenAlert("info", "mission complete")] if self._was_mission_done and before is False else []

    def _check_requests(self, requests: Iterable[OperatorRequest]) -> list[SpokenAlert]:
        out = []
        for request in requests:
            if not request.is_done or any(request is known for known in self._answered_requests):
                continue
            self._answered_requests.append(request)
            if not self._has_begun or request.outcome is RequestOutcome.ACCEPTED or "superseded by" in request.answer:
                continue
            what = "refused" if request.outcome is RequestOutcome.REFUSED else "no answer"
            out.append(SpokenAlert("warning", f"{what}: {request.text}"))
        return out

    def _check_messages(self, messages: Sequence[StatusMessage]) -> list[SpokenAlert]:
        """Return the vehicle's warnings and errors: failsafes, limit cycles, refusals."""
        fresh = list(takewhile(lambda message: message is not self._last_message, reversed(messages)))
        if fresh:
            self._last_message = fresh[0]
        if not self._has_begun:
            return []
        told = [m for m in reversed(fresh) if m.level != "info" and ": communication lost" not in m.text]
        return [SpokenAlert(m.level, m.text) for m in told]
