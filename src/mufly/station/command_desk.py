"""Taking and handing over the command of a vehicle (CHANGE_OPERATOR_CONTROL).

A vehicle obeys one station at a time. A request is answered by CHANGE_OPERATOR_CONTROL_ACK; it is repeated until then.
"""

from __future__ import annotations

import math

from mufly.link.dialect import MavMessage, mavlink
from mufly.station.requests import end
from mufly.station.view import Outcome, Request

__all__ = ["CommandDesk"]

RETRY_S = 0.8
TRIES = 12
_WORDS = {
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
            end(request, Outcome.REFUSED, _WORDS.get(message.ack, f"result {message.ack}"))

    def step(self, now_s: float, commander: int | None) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._open is None or now_s - self._asked_s < RETRY_S:
            return []
        request, wish = self._open
        if self._tries >= TRIES:
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
