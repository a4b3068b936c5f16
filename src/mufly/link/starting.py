"""Commands that start something: arming, flight modes, the mission and its items."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mufly.link.call import ACCEPTED, FORCE, Call, Verdict, denied, refused, verdict_of
from mufly.link.controls import Controls
from mufly.link.dialect import mavlink
from mufly.link.modes import Mode, asked

if TYPE_CHECKING:
    from mufly.flight import Answer

__all__ = ["arm_or_disarm", "set_mode", "start_at", "start_mission"]


def arm_or_disarm(call: Call, c: Controls) -> Verdict:
    """COMPONENT_ARM_DISARM; what was chosen before arming begins with it."""
    on, magic = call.p[0], call.p[1]
    if on == 1.0:
        chosen = c.on_arming.chosen(c.now_s)
        verdict = verdict_of(c.autopilot.arm())
        c.on_arming.choose(c.now_s, "")
        if verdict != ACCEPTED or not chosen:
            return verdict
        begun = start_mission(c) if chosen == "mission" else verdict_of(c.autopilot.take_off())
        return Verdict(verdict.result, begun.reason)
    if on == 0.0:
        return verdict_of(c.autopilot.disarm(force=magic == FORCE))
    return denied(f"COMPONENT_ARM_DISARM with {on:g}: give 1 or 0")


def set_mode(main: int, sub: int, c: Controls) -> Verdict:
    """Do what a flight mode of PX4 stands for; the mission begins with the item that was asked for before."""
    wanted, status, autopilot = asked(Mode(main, sub)), c.autopilot.status, c.autopilot
    c.on_arming.choose(c.now_s, "")
    if not status.armed and not status.flying and (wanted == "take-off" or wanted == "mission"):
        if wanted == "mission" and not status.mission.waypoint:
            return denied("no mission loaded; upload one first")
        c.on_arming.choose(c.now_s, wanted)
        return Verdict(mavlink.MAV_RESULT_ACCEPTED, f"{wanted} once it is armed")
    if wanted == "mission":
        return start_mission(c)
    if wanted == "rc":
        answer = c.sticks.by_hand(c.now_s)
        if isinstance(answer, str):
            return refused(answer) if answer else ACCEPTED
        return verdict_of(answer)
    if wanted == "hover" and (
        status.state == "init" or (status.state == "hover" and not status.mission_running)
    ):
        return ACCEPTED  # programs ask for it before take-off; on the floor it holds anyway
    actions: dict[str, Callable[[], Answer]] = {
        "take-off": autopilot.take_off,
        "hover": autopilot.pause,
        "return": autopilot.return_home,
        "land": autopilot.land,
        "offboard": lambda: autopilot.offboard(True),
    }
    action = actions.get(wanted)
    return denied(f"mode {main}, {sub} is not known here") if action is None else verdict_of(action())


def start_at(item: float, c: Controls) -> Verdict:
    """Go on with item ``item`` of the mission; on the floor, begin with it once the mission is started."""
    first = c.desk.jump(int(item)) if item >= 0.0 and item < 65535.0 else None
    if first is None:
        return denied(f"the mission has no waypoint from item {item:g} on")
    if c.autopilot.status.state == "init":
        c.desk.first = int(item)
        return ACCEPTED
    verdict = verdict_of(c.autopilot.start_mission(first))
    if verdict == ACCEPTED:
        c.desk.begin_at(int(item))
    return verdict


def start_mission(c: Controls) -> Verdict:
    """Start the mission, or go on with it."""
    item = c.desk.first
    if item:
        answer = c.autopilot.start_mission(c.desk.jump(item))
        if answer:
            c.desk.begin_at(item)
        return verdict_of(answer)
    if c.autopilot.status.mission_running:
        return ACCEPTED
    return verdict_of(c.autopilot.start_mission())
