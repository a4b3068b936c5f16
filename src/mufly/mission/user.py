"""What the user's signals do to a flight: waypoints, pause, return, land, stop.

As in `mufly.mission.phases`, every function takes a state and returns the next one. A reference that moves comes to
rest before it does anything else, so that none of them makes it jump.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.mission.landing import land
from mufly.mission.offboard import HIGHEST_M
from mufly.mission.phases import braking, go_home, set_out
from mufly.mission.schema import LOWEST_M
from mufly.mission.signals import State, Triple
from mufly.mission.state import MissionPlan, MissionState, enter, fail, log
from mufly.mission.trajectory import Trajectory, straight

__all__ = [
    "GO_AROUND_M",
    "OFF_FLOOR_M",
    "go_on",
    "go_on_after_take_off",
    "land_now",
    "pause",
    "return_home",
    "stop_at_once",
    "to_users_waypoint",
    "waypoint_fault",
]

GO_AROUND_M = 0.4
"""Height above the floor from which a landing can be broken off (m)."""

OFF_FLOOR_M = 0.2
"""Height above where it stood from which a take-off can be broken off (m)."""


def stop_at_once(s: MissionState, why: str) -> MissionState:
    """Motors off, whatever the state."""
    if s.state is State.INIT and s.motors == "off":
        return s
    if s.started or s.begun:
        s = fail(s, why)
    return enter(
        s,
        State.INIT,
        why,
        level="error",
        motors="off",
        motion=None,
        detour=None,
        tracker=None,
        finished=s.outcome != "",
    )


# waypoints, pause, home


def waypoint_fault(where: Triple | None, heading: float | None) -> str:
    """Why a user's waypoint is refused; "" if it is not."""
    if heading is not None and not math.isfinite(heading):
        return f"heading {heading:g} refused: give a finite angle"
    if where is None:
        return ""
    text = f"user's waypoint [{where[0]:g}, {where[1]:g}, {where[2]:g}] refused"
    if not all(math.isfinite(v) for v in where) or where[2] > -LOWEST_M:
        return f"{text}: D has to be at most {-LOWEST_M:g} m"
    if where[2] < -HIGHEST_M or math.hypot(where[0], where[1]) > 1e4:
        return f"{text}: too far away, D has to be at least {-HIGHEST_M:g} m"
    return ""


def to_users_waypoint(
    plan: MissionPlan, s: MissionState, where: Triple | None, heading: float | None
) -> MissionState:
    """Waypoint signal: stop, go there and hold; the mission waits. Without ``where`` only turn, on the spot."""
    refused = waypoint_fault(where, heading)
    if refused:
        return s if s.events[-1].text == refused else log(s, refused, level="warning")
    goal = None if where is None else (float(where[0]), float(where[1]), float(where[2]))
    if s.manual and not s.homing and s.asked_heading == heading and goal in (None, s.goal):
        return s
    text = "" if goal is None else f"user's waypoint [{goal[0]:g}, {goal[1]:g}, {goal[2]:g}]"
    if heading is not None:
        text = f"{text}, heading {math.degrees(heading):.0f} deg" if text else _turning(heading)

    def way(at: Triple, psi: float) -> Trajectory:
        return straight(at, at if goal is None else goal, psi, plan.limits, final_heading=heading)

    return set_out(plan, s, text, way, manual=True, asked_heading=heading)


def _turning(heading: float) -> str:
    return f"turning to {math.degrees(heading) % 360.0:.0f} deg"


def pause(plan: MissionPlan, s: MissionState, why: str = "paused") -> MissionState:
    """Stop and hover; the mission waits."""
    if s.state is State.HOVER:
        return s if s.manual else replace(log(s, why), manual=True, quit="")
    brake = braking(plan, s)
    at = brake.at(math.inf)
    n, e, d = at.position
    rest = (n, e, min(d, -LOWEST_M) if s.state is State.LANDING else d)
    return enter(
        s,
        State.HOVER,
        why,
        motion=brake,
        hold=rest,
        goal=rest,
        heading=at.heading,
        ready_s=s.time_s,
        manual=True,
        homing=False,
        quit="",
        tracker=None,
        asked_heading=None,
        motors="fly",
    )


def go_on(plan: MissionPlan, s: MissionState, first: int | None) -> MissionState:
    """Start signal in flight: go on with the mission, or with another waypoint of it."""
    n = len(plan.mission.waypoint)
    over = s.outcome == "succeeded" or s.index >= n
    index = first if first is not None else 0 if over and s.begun else s.index
    if s.state is State.WAYPOINT and not s.manual and index == s.index:
        return s
    why = "the mission goes on" if s.begun and not over else "the mission begins"
    if first is not None:
        why = f"on to waypoint {first + 1}"
    s = replace(log(s, why), ready_s=s.time_s) if s.state is State.HOVER else pause(plan, s, why)
    return replace(s, manual=False, begun=True, index=index, outcome="", reason="", quit="")


def go_on_after_take_off(s: MissionState, first: int | None) -> MissionState:
    """Start signal during a take-off: the mission follows, from waypoint ``first`` (from 0) if given."""
    s = log(s, "the mission follows the take-off" + (f", from waypoint {first + 1}" if first else ""))
    return replace(s, manual=False, begun=True, index=first or 0, quit="")


def return_home(plan: MissionPlan, s: MissionState) -> MissionState:
    """Return signal: to above where it took off, and down."""
    return s if s.homing else go_home(plan, _broken_off(plan, s, "return"), "return signal")


def land_now(plan: MissionPlan, s: MissionState) -> MissionState:
    """Land signal."""
    return land(_broken_off(plan, s, "land"), "land signal")


def _broken_off(plan: MissionPlan, s: MissionState, signal: str) -> MissionState:
    rest = len(plan.mission.waypoint) - s.index
    if not s.begun or rest <= 0 or s.outcome != "":
        return s
    return replace(s, quit=f"{signal} signal with {rest} waypoint{'s' if rest > 1 else ''} to go")
