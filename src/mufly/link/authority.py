"""Who commands, as the vehicle acts on it: claims, handing over, and what happens when the commander is lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from mufly.link.clients import Authority, Sender, Voice
from mufly.link.codec import MavMessage, mavlink
from mufly.link.conventions import OnArming
from mufly.link.parameters import ParameterDesk
from mufly.link.set_points import Sticks

if TYPE_CHECKING:
    from mufly.flight import Autopilot

_ACK_CONTROL, _NACK_KEY, _NACK_HELD = 0, 2, 3


class Bridge:
    """Where command is held.

    Parameters
    ----------
    autopilot : Autopilot
    voice : Voice
    sticks : Sticks
    on_arming : OnArming
        Sticks, and what was chosen for after arming, end with the commander who had them.
    parameters : ParameterDesk
        Has COM_DL_LOSS_T and COM_DL_LAND_T.

    Attributes
    ----------
    authority : Authority
    """

    def __init__(
        self,
        autopilot: Autopilot,
        voice: Voice,
        sticks: Sticks,
        on_arming: OnArming,
        parameters: ParameterDesk,
    ) -> None:
        self.authority = Authority()
        self._autopilot, self._voice, self._sticks = autopilot, voice, sticks
        self._on_arming, self._parameters = on_arming, parameters
        self._failsafe = Failsafe()
        self._owed: Literal["", "hover", "land"] = ""

    def may(self, now_s: float, sender: Sender) -> bool:
        """Whether a station commands; the first to ask does. One that may not is told who does."""
        before = self.authority.commander
        if self.authority.claim(now_s, sender):
            if sender != before:
                self._let_go(now_s)
                self._autopilot.note(f"commanded by {sender}")
            return True
        self._voice.tell(now_s, sender, f"denied: commanded by {before}; ask it to hand over")
        return False

    def operator_control(self, now_s: float, sender: Sender, m: MavMessage) -> None:
        """Take a CHANGE_OPERATOR_CONTROL: 0 asks for command, 1 hands it over."""
        if m.control_request == 0:
            answer = _NACK_KEY if m.version else _ACK_CONTROL if self.may(now_s, sender) else _NACK_HELD
        elif self.authority.release(sender):
            answer = _ACK_CONTROL
            self._let_go(now_s)
            self._autopilot.note(f"{sender} has handed over command")
        else:
            answer = _NACK_HELD
        self._voice.send(
            sender.peer,
            mavlink.MAVLink_change_operator_control_ack_message(sender.system, m.control_request, answer),
        )

    def watch(self, now_s: float) -> None:
        """Hover, then land, when the commander is lost."""
        status = self._autopilot.status
        mission = self._autopilot.software.mission_state
        silent = self.authority.silent_s(now_s)
        ending = status.state == "landing" or (mission is not None and mission.homing)
        land_s = self._parameters.get("COM_DL_LAND_T").value
        self._failsafe, order = watch_link(
            self._failsafe,
            silent_s=silent,
            flying=status.flying,
            ending=ending,
            loss_s=self._parameters.get("COM_DL_LOSS_T").value,
            land_s=land_s,
        )
        if order == "back":
            self._autopilot.note("the commander is heard again")
        elif order:
            self._sticks.off()
            then = f"stop and hover, land in {land_s:g} s" if order == "hover" else "land"
            self._autopilot.note(f"commander not heard for {silent:.0f} s: {then}", "warning")
            self._owed = order
        # What is refused for the moment (just off the floor, sticks in the hand) is asked for until it is done.
        if self._failsafe.stage == "" or ending:
            self._owed = ""
        if self._owed:
            answer = self._autopilot.pause() if self._owed == "hover" else self._autopilot.land()
            self._owed = "" if answer else self._owed

    def _let_go(self, now_s: float) -> None:
        self._sticks.forget()
        self._on_arming.choose(now_s, "")


# ----------------------------------------------------------------------------
# The commander is lost in flight: hover, then land.
#
# ====================================  ===============================================
# for ``COM_DL_LOSS_T`` not a word      stop and hover
# for ``COM_DL_LAND_T`` more            land
# a word again                          said; whoever commands goes on from there
# ====================================  ===============================================
#
# Without a commander (a flight that was started by itself, or was handed over) there is nobody to lose. A landing,
# and
# a flight home, go on: they end on the floor anyway.


@dataclass(frozen=True, slots=True)
class Failsafe:
    """How far it has gone: "" nothing, "hover" or "land" has been ordered."""

    stage: Literal["", "hover", "land"] = ""


def watch_link(
    failsafe: Failsafe, *, silent_s: float, flying: bool, ending: bool, loss_s: float, land_s: float
) -> tuple[Failsafe, Literal["", "hover", "land", "back"]]:
    """Judge the link once.

    Parameters
    ----------
    failsafe : Failsafe
        From the time before.
    silent_s : float
        For how long the commander has not been heard (s).
    flying, ending : bool
        Whether it is off the floor; whether it is landing or on its way home.
    loss_s, land_s : float
        COM_DL_LOSS_T and COM_DL_LAND_T (s).

    Returns
    -------
    failsafe : Failsafe
    order : str
        What to do now: "hover", "land", nothing (""), or say that the link is "back".
    """
    if silent_s < loss_s or not flying:
        if failsafe.stage == "":
            return failsafe, ""
        return Failsafe(), "back" if flying else ""
    if failsafe.stage == "" and not ending:
        return replace(failsafe, stage="hover"), "hover"
    if failsafe.stage == "hover" and silent_s >= loss_s + land_s:
        return replace(failsafe, stage="land"), "" if ending else "land"
    return failsafe, ""
