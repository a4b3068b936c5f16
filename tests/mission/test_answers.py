"""One table says what may be asked in which state; the state machine goes by it."""

from dataclasses import replace

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import (
    NO_COMMAND,
    Command,
    MissionState,
    SetPoint,
    State,
    VehicleRequest,
    check_request,
    initial_mission_state,
    load_mission,
    prepare_mission_plan,
    step_mission,
)
from mufly.vehicle import load_vehicle

MISSION = load_mission("demonstration")
PLAN = prepare_mission_plan(MISSION, load_vehicle("mufly-1.1"))
SIGNALS = {
    VehicleRequest.TAKE_OFF: Command(take_off_height=1.0),
    VehicleRequest.START: Command(start=True, first_waypoint=1),
    VehicleRequest.PAUSE: Command(pause=True),
    VehicleRequest.GO_TO: Command(waypoint=(0.5, 0.5, -1.0)),
    VehicleRequest.RETURN: Command(return_requested=True),
    VehicleRequest.LAND: Command(land=True),
    VehicleRequest.OFFBOARD: Command(program_set_point=SetPoint((0.5, 0.5, -1.0))),
}


def at_height(height: float, time: float = 0.0) -> Estimate:
    return Estimate(time, np.array([0.0, 0.0, -height]), np.zeros(3), np.zeros(3), np.zeros(3), np.full(8, 1.5), 7.4)


def in_state(state: State) -> MissionState:
    """The machine in a state, by the way that a flight takes to it where a motion belongs to it."""
    s = initial_mission_state(PLAN, at_height(0.07))
    if state is State.INIT:
        return s
    s, _ = step_mission(PLAN, s, at_height(0.07, 0.02), Command(take_off_height=1.0))
    s = replace(s, motors="fly", motion_clock_s=1.0)
    m = at_height(1.0, 0.04)
    way = {
        State.TAKE_OFF: NO_COMMAND,
        State.HOVER: Command(pause=True),
        State.WAYPOINT: Command(waypoint=(0.0, 0.3, -1.0)),
        State.LANDING: Command(land=True),
    }[state]
    s, _ = step_mission(PLAN, s, m, way)
    assert s.state is state
    return s


@pytest.mark.parametrize("height", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("state", [State.INIT, State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.LANDING])
@pytest.mark.parametrize("ask", SIGNALS)
def test_the_machine_does_what_the_table_lets_it(ask: VehicleRequest, state: State, height: float) -> None:
    s = in_state(state)
    m = at_height(0.07 if state is State.INIT else height, 0.08)
    answer = check_request(ask, s, height_m=s.home_position[2] - m.position[2])
    idle, _ = step_mission(PLAN, s, m, NO_COMMAND)
    asked, _ = step_mission(PLAN, s, m, SIGNALS[ask])
    changed = asked.events != idle.events or asked.motion is not idle.motion
    nothing_to_do = (ask, state) in {
        (VehicleRequest.LAND, State.LANDING),
        (VehicleRequest.PAUSE, State.HOVER),
    }
    assert changed == (bool(answer) and not nothing_to_do)


@pytest.mark.parametrize("ask", VehicleRequest)
@pytest.mark.parametrize("state", State)
def test_every_question_has_an_answer_and_a_refusal_a_reason(ask: VehicleRequest, state: State) -> None:
    for motors in ("off", "spin_up", "fly", "ramp_down", "blind"):
        for outcome in ("", "failed"):
            s = MissionState(state=state, motors=motors, outcome=outcome, reason="no way around")
            answer = check_request(ask, s, height_m=1.0, armed=False)
            assert bool(answer) == (answer.reason == "") == (answer.short_reason == "")
            assert answer or answer.is_temporary


def test_the_state_of_another_autopilot_counts_as_a_hover_or_as_the_floor() -> None:
    other = replace(MissionState(), motors="off")
    object.__setattr__(other, "state", "POSCTL")
    object.__setattr__(other, "motors", "")
    assert check_request(VehicleRequest.LAND, other, flying=True)
    assert check_request(VehicleRequest.LAND, other, flying=False).short_reason == "on the floor"
    assert check_request(VehicleRequest.TAKE_OFF, other, flying=False)
    assert check_request(VehicleRequest.TAKE_OFF, other, flying=True).short_reason == "in the air"


LIFTS, LANDS, HANGS = (
    {"state": State.TAKE_OFF, "motors": "fly"},
    {"state": State.LANDING, "motors": "fly"},
    {"state": State.HOVER, "motors": "fly"},
)


@pytest.mark.parametrize(
    ("ask", "height", "facts", "brief"),
    [
        (VehicleRequest.ARM, 0.0, {"armed": False}, ""),
        (VehicleRequest.ARM, 0.0, {"armed": False, "motors": "ramp_down"}, "motors running"),
        (VehicleRequest.ARM, 1.0, {"armed": True, **HANGS}, ""),
        (VehicleRequest.DISARM, 1.0, HANGS, "in flight"),
        (VehicleRequest.TAKE_OFF, 0.0, {"armed": False}, "not armed"),
        (VehicleRequest.TAKE_OFF, 0.0, {"motors": "ramp_down"}, "in the air"),
        (VehicleRequest.TAKE_OFF, 0.0, {}, ""),
        (VehicleRequest.GO_TO, 0.18, LIFTS, "taking off"),
        (VehicleRequest.GO_TO, 0.22, LIFTS, ""),
        (VehicleRequest.GO_TO, 0.3, LIFTS | {"motors": "spin_up"}, "taking off"),
        (VehicleRequest.PAUSE, 0.38, LANDS, "landing"),
        (VehicleRequest.PAUSE, 0.42, LANDS, ""),
        (VehicleRequest.PAUSE, 0.42, LANDS | {"motors": "ramp_down"}, "landing"),
        (VehicleRequest.PAUSE, 0.42, LANDS | {"outcome": "failed"}, "landing"),
        (VehicleRequest.RETURN, 1.0, LANDS, "landing"),
        (VehicleRequest.LAND, 1.0, LANDS, ""),
        (VehicleRequest.LAND, 1.0, {"state": State.RC, "motors": "fly"}, "flown by hand"),
        (VehicleRequest.START, 1.0, HANGS | {"outcome": "failed"}, "landing"),
        (VehicleRequest.START, 1.0, HANGS, ""),
        (VehicleRequest.STICKS, 1.0, LANDS | {"motors": "blind"}, "comes down"),
        (VehicleRequest.STICKS, 1.0, LANDS, ""),
        (VehicleRequest.LOAD, 0.0, {}, ""),
        (VehicleRequest.LOAD, 0.0, {"motors": "ramp_down"}, "in flight"),
        (VehicleRequest.LOAD, 1.0, HANGS, "mission under way"),
        (VehicleRequest.LOAD, 1.0, HANGS | {"user_in_control": True}, ""),
        (VehicleRequest.LOAD, 1.0, HANGS | {"user_in_control": True, "motors": "ramp_down"}, "in flight"),
        (VehicleRequest.LOAD, 1.0, HANGS | {"user_in_control": True, "outcome": "failed"}, "landing"),
    ],
)
def test_what_a_button_says(ask: VehicleRequest, height: float, facts: dict, brief: str) -> None:
    facts = dict(facts)
    armed = facts.pop("armed", True)
    answer = check_request(ask, MissionState(**facts), height_m=height, armed=armed)
    assert (bool(answer), answer.short_reason) == (not brief, brief)
