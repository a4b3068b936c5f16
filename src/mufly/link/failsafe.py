"""The commander is lost in flight: hover, then land.

====================================  ===============================================
for ``COM_DL_LOSS_T`` not a word      stop and hover
for ``COM_DL_LAND_T`` more            land
a word again                          said; whoever commands goes on from there
====================================  ===============================================

Without a commander (a flight that was started by itself, or was handed over) there is nobody to lose. A landing, and
a flight home, go on: they end on the floor anyway.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

__all__ = ["Failsafe", "watch_link"]


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
