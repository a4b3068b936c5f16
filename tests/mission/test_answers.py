"""One table says what may be asked in which state; the state machine goes by it."""

from dataclasses import replace

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import (
    NO_SIGNAL,
    Ask,
    Command,
    MissionState,
    SetPoint,
    State,
    begin,
    load_mission,
    may,
    prepare,
    step,
)
from mufly.vehicle import load_vehicle

MISSION = load_mission("demonstration")
PLAN = prepare(MISSION, load_vehicle("mufly-1.1"))
SIGNALS = {
    Ask.TAKE_OFF: Command(take_off=1.0),
    Ask.START: Command(start=True, first=1),
    Ask.PAUSE: Command(pause=True),
    Ask.GO_TO: Command(waypoint=(0.5, 0.5, -1.0)),
    Ask.RETURN: Command(home=True),
    Ask.LAND: Command(land=True),
    Ask.OFFBOARD: Command(set_point=SetPoint((0.5, 0.5, -1.0))),
}


def at_height(height: float, time: float = 0.0) -> Estimate:
    return Estimate(
        time, np.array([0.0, 0.0, -height]), np.zeros(3), np.zeros(3), np.zeros(3), np.full(8, 1.5), 7.4
    )


def in_state(state: State) -> MissionState:
    """The machine in a state, by the way that a flight takes to it where a motion belongs to it."""
    s = begin(PLAN, at_height(0.07))
    if state is State.INIT:
        return s
    s, _ = step(PLAN, s, at_height(0.07, 0.02), Command(take_off=1.0))
    s = replace(s, motors="fly", clock_s=1.0)
    m = at_height(1.0, 0.04)
    way = {
        State.TAKE_OFF: NO_SIGNAL,
        State.HOVER: Command(pause=True),
        State.WAYPOINT: Command(waypoint=(0.0, 0.3, -1.0)),
        State.LANDING: Command(land=True),
    }[state]
    s, _ = step(PLAN, s, m, way)
    assert s.state is state
    return s


@pytest.mark.parametrize("height", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("state", [State.INIT, State.TAKE_OFF, State.HOVER, State.WAYPOINT, State.LANDING])
@pytest.mark.parametrize("ask", SIGNALS)
def test_the_machine_does_what_the_table_lets_it(ask: Ask, state: State, height: float) -> None:
    s = in_state(state)
    m = at_height(0.07 if state is State.INIT else height, 0.08)
    answer = may(ask, s, height_m=s.standing[2] - m.position[2])
    idle, _ = step(PLAN, s, m, NO_SIGNAL)
    asked, _ = step(PLAN, s, m, SIGNALS[ask])
    changed = asked.events != idle.events or asked.motion is not idle.motion
    nothing_to_do = (ask, state) in {(Ask.LAND, State.LANDING), (Ask.PAUSE, State.HOVER)}
    assert changed == (bool(answer) and not nothing_to_do)


@pytest.mark.parametrize("ask", Ask)
@pytest.mark.parametrize("state", State)
def test_every_question_has_an_answer_and_a_refusal_a_reason(ask: Ask, state: State) -> None:
    for motors in ("off", "spin_up", "fly", "ramp_down", "blind"):
        for outcome in ("", "failed"):
            s = MissionState(state=state, motors=motors, outcome=outcome, reason="no way around")
            answer = may(ask, s, height_m=1.0, armed=False)
            assert bool(answer) == (answer.reason == "") == (answer.brief == "")
            assert answer or answer.temporary


def test_the_state_of_another_autopilot_counts_as_a_hover_or_as_the_floor() -> None:
    other = replace(MissionState(), motors="off")
    object.__setattr__(other, "state", "POSCTL")
    object.__setattr__(other, "motors", "")
    assert may(Ask.LAND, other, flying=True)
    assert may(Ask.LAND, other, flying=False).brief == "on the floor"
    assert may(Ask.TAKE_OFF, other, flying=False)
    assert may(Ask.TAKE_OFF, other, flying=True).brief == "in the air"


LIFTS, LANDS, HANGS = (
    {"state": State.TAKE_OFF, "motors": "fly"},
    {"state": State.LANDING, "motors": "fly"},
    {"state": State.HOVER, "motors": "fly"},
)


@pytest.mark.parametrize(
    ("ask", "height", "facts", "brief"),
    [
        (Ask.ARM, 0.0, {"armed": False}, ""),
        (Ask.ARM, 0.0, {"armed": False, "motors": "ramp_down"}, "motors running"),
        (Ask.ARM, 1.0, {"armed": True, **HANGS}, ""),
        (Ask.DISARM, 1.0, HANGS, "in flight"),
        (Ask.TAKE_OFF, 0.0, {"armed": False}, "not armed"),
        (Ask.TAKE_OFF, 0.0, {"motors": "ramp_down"}, "in the air"),
        (Ask.TAKE_OFF, 0.0, {}, ""),
        (Ask.GO_TO, 0.18, LIFTS, "taking off"),
        (Ask.GO_TO, 0.22, LIFTS, ""),
        (Ask.GO_TO, 0.3, LIFTS | {"motors": "spin_up"}, "taking off"),
        (Ask.PAUSE, 0.38, LANDS, "landing"),
        (Ask.PAUSE, 0.42, LANDS, ""),
        (Ask.PAUSE, 0.42, LANDS | {"motors": "ramp_down"}, "landing"),
        (Ask.PAUSE, 0.42, LANDS | {"outcome": "failed"}, "landing"),
        (Ask.RETURN, 1.0, LANDS, "landing"),
        (Ask.LAND, 1.0, LANDS, ""),
        (Ask.LAND, 1.0, {"state": State.RC, "motors": "fly"}, "flown by hand"),
        (Ask.START, 1.0, HANGS | {"outcome": "failed"}, "landing"),
        (Ask.START, 1.0, HANGS, ""),
        (Ask.STICKS, 1.0, LANDS | {"motors": "blind"}, "comes down"),
        (Ask.STICKS, 1.0, LANDS, ""),
        (Ask.LOAD, 0.0, {}, ""),
        (Ask.LOAD, 0.0, {"motors": "ramp_down"}, "in flight"),
        (Ask.LOAD, 1.0, HANGS, "mission under way"),
        (Ask.LOAD, 1.0, HANGS | {"manual": True}, ""),
        (Ask.LOAD, 1.0, HANGS | {"manual": True, "motors": "ramp_down"}, "in flight"),
        (Ask.LOAD, 1.0, HANGS | {"manual": True, "outcome": "failed"}, "landing"),
    ],
)
def test_what_a_button_says(ask: Ask, height: float, facts: dict, brief: str) -> None:
    facts = dict(facts)
    armed = facts.pop("armed", True)
    answer = may(ask, MissionState(**facts), height_m=height, armed=armed)
    assert (bool(answer), answer.brief) == (not brief, brief)
