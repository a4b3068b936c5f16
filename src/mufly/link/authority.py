"""Who commands: one station at a time, the others watch; and what happens when the commander is lost.

The first to command takes command. It keeps it until it hands over (CHANGE_OPERATOR_CONTROL), or has not been heard for
:data:`SILENT_S`; then the next to command has it. Anything that a station says is a sign of life. In flight:

====================================  ===============================================
for ``COM_DL_LOSS_T`` not a word      stop and hover
for ``COM_DL_LAND_T`` more            land
a word again                          said; whoever commands goes on from there
====================================  ===============================================

Without a commander (a flight that was started by itself, or was handed over) there is nobody to lose. A landing, and
a flight home, go on: they end on the floor anyway.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from mufly.flight import Autopilot
from mufly.link.clients import Clients, Source
from mufly.link.codec import MavMessage, mavlink
from mufly.link.set_points import ManualControl

SILENT_S = 5.0
"""After so long without a word the commander may be replaced (s)."""
_ACK_CONTROL, _NACK_KEY, _NACK_HELD = 0, 2, 3

Stage = Literal["", "hover", "land"]
"""How far the failsafe has gone: nothing, or what has been ordered."""


class Authority:
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
        self.commander: Source | None = None
        self.on_change: list[Callable[[], None]] = [manual.forget]
        self._autopilot, self._clients, self._manual = autopilot, clients, manual
        self._heard_s = -math.inf
        self._stage: Stage = ""
        self._owed: Stage = ""

    def hear(self, now_s: float, station: Source) -> None:
        """Note a sign of life."""
        if station == self.commander:
            self._heard_s = now_s

    def silent_s(self, now_s: float) -> float:
        """For how long the commander has not been heard (s); 0 if there is none."""
        return 0.0 if self.commander is None else max(0.0, now_s - self._heard_s)

    def may(self, now_s: float, station: Source) -> bool:
        """Whether a station commands; the first to ask does. One that may not is told who does."""
        if self.commander not in (None, station) and self.silent_s(now_s) < SILENT_S:
            self._clients.tell(now_s, station, f"denied: commanded by {self.commander}; ask it to hand over")
            return False
        self._heard_s = now_s
        if station != self.commander:
            self._give(station)
            self._autopilot.note(f"commanded by {station}")
        return True

    def operator_control(self, now_s: float, station: Source, m: MavMessage) -> None:
        """Take a CHANGE_OPERATOR_CONTROL: 0 asks for command, 1 hands it over."""
        if m.control_request == 0:
            answer = _NACK_KEY if m.version else _ACK_CONTROL if self.may(now_s, station) else _NACK_HELD
        elif station == self.commander:
            answer = _ACK_CONTROL
            self._give(None)
            self._autopilot.note(f"{station} has handed over command")
        else:
            answer = _NACK_HELD
        self._clients.send(
            station.peer,
            mavlink.MAVLink_change_operator_control_ack_message(station.system, m.control_request, answer),
        )

    def watch(self, now_s: float, *, loss_s: float, land_s: float) -> None:
        """Hover, then land, when the commander is lost: after COM_DL_LOSS_T, and COM_DL_LAND_T more (s)."""
        status, silent = self._autopilot.status, self.silent_s(now_s)
        ending = status.state == "landing" or status.homing
        self._stage, order = watch_link(
            self._stage, silent_s=silent, flying=status.flying, ending=ending, loss_s=loss_s, land_s=land_s
        )
        if order == "back":
            self._autopilot.note("the commander is heard again")
        elif order:
            self._manual.off()
            then = f"stop and hover, land in {land_s:g} s" if order == "hover" else "land"
            self._autopilot.note(f"commander not heard for {silent:.0f} s: {then}", "warning")
            self._owed = order
        # What is refused for the moment (just off the floor, sticks in the hand) is asked for until it is done.
        if self._stage == "" or ending:
            self._owed = ""
        if self._owed:
            answer = self._autopilot.pause() if self._owed == "hover" else self._autopilot.land()
            self._owed = "" if answer else self._owed

    def _give(self, station: Source | None) -> None:
        self.commander = station
        for changed in self.on_change:
            changed()


def watch_link(
    stage: Stage, *, silent_s: float, flying: bool, ending: bool, loss_s: float, land_s: float
) -> tuple[Stage, Literal["", "hover", "land", "back"]]:
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
