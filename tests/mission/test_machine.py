"""The state machine of Fig. 6.15: every state, every transition, and what the references do."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from mufly.estimate import AuxiliaryStates, Estimate
from mufly.mission import (
    ROTOR_SPIN_UP_TIME_S,
    Command,
    State,
    fail_and_land,
    initial_mission_state,
    load_mission,
    parse_mission,
    step_mission,
)

SQUARE = load_mission("demonstration")
HOP = parse_mission({"take_off": {"wait_s": 0.5}, "waypoint": [{"position_m": [1.0, 0.0, -1.0], "wait_s": 0.5}]})


def measurement(t=0.0, x=(0.0, 0.0, -0.07), v=(0.0, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), volts=7.4):
    return Estimate(t, np.array(x), np.array(v), np.array(attitude), np.zeros(3), np.full(8, 1.5), volts)


def after(flight, state):
    """Time of the first event of a state."""
    return next(e.time_s for e in flight.state.events if e.state == state)


def test_the_demonstration(rig):
    flight = rig.fly(SQUARE)
    assert flight.state.outcome == "succeeded"
    assert flight.state.finished
    assert flight.visited == [
        "init",
        "take-off",
        *(["hover", "waypoint"] * 4),
        "hover",
        "landing",
        "landing",
        "init",
    ]
    t, x, v = flight.arrays()
    # Every waypoint is reached within 5 cm before the wait starts, and the wait is as long as asked.
    reached = [e.time_s for e in flight.state.events if e.state == State.HOVER]
    left = [e.time_s for e in flight.state.events if e.state in (State.WAYPOINT, State.LANDING)]
    goals = [(0.0, 0.0, -1.0), *(w.position_m for w in SQUARE.waypoint)]
    for goal, start, end in zip(goals, reached, left, strict=False):
        at = np.searchsorted(t, start - 1e-9)
        assert np.linalg.norm(x[at] - goal) < 0.05
        assert np.linalg.norm(v[at]) < 0.1
        assert end - start == pytest.approx(2.5, abs=0.021)
        waiting = (t >= start) & (t < end)
        assert np.linalg.norm(x[waiting] - goal, axis=1).max() < 0.05
    down = np.flatnonzero(x[:, 2] > rig.STANDING - 0.005)
    touchdown = down[down > len(t) // 2][0]
    assert v[touchdown - 1, 2] < 0.2
    np.testing.assert_allclose(x[-1, :2], (0.0, 0.0), atol=0.1)


def test_references_are_continuous_and_within_limits(rig):
    flight = rig.fly(SQUARE)
    q = SQUARE.limits
    flying = [r for r in flight.reference if r.motors == "fly"]
    x = np.array([r.position for r in flying])
    v = np.array([r.velocity for r in flying])
    a = np.array([r.acceleration for r in flying])
    assert np.linalg.norm(v[:, :2], axis=1).max() <= q.speed_m_s + 1e-9
    assert -v[:, 2].min() <= q.climb_m_s + 1e-9
    assert v[:, 2].max() <= q.descent_m_s * 1.05
    assert np.linalg.norm(a, axis=1).max() <= q.acceleration_m_s2 * 1.05
    assert np.abs(np.diff(v, axis=0)).max() <= 0.02 * q.acceleration_m_s2 * 1.05
    np.testing.assert_allclose(np.diff(x, axis=0), 0.01 * (v[1:] + v[:-1]), atol=2e-4)
    for before, now in pairwise(flying):
        assert abs(now.heading - before.heading) < 0.02 * math.radians(q.yaw_rate_deg_s) + 1e-9


def test_motors_in_order(rig):
    flight = rig.fly(HOP)
    order = [a for a, b in pairwise([*(r.motors for r in flight.reference), None]) if a != b]
    assert order == ["off", "spin_up", "fly", "ramp_down", "off"]


def test_landing_slows_down_before_the_floor(rig):
    flight = rig.fly(HOP)
    sinking = [r for r, s in zip(flight.reference, flight.states, strict=True) if s == "landing" and r.motors == "fly"]
    depth = np.array([r.position[2] for r in sinking])
    speed = np.array([r.velocity[2] for r in sinking])
    assert speed.max() <= HOP.limits.descent_m_s * 1.05
    assert speed[(depth > rig.STANDING - 0.2) & (depth < rig.STANDING + 0.1)].max() <= 0.2
    # It goes on below the floor until the touchdown is certain, but not without end.
    assert rig.STANDING + 0.1 < depth.max() < rig.STANDING + 0.5


def test_a_yawed_landing_and_start_elsewhere(rig):
    mission = parse_mission(
        {
            "start_m": [2.0, -1.0],
            "start_heading_deg": 120.0,
            "waypoint": [{"position_m": [2.0, -1.0, -2.0], "heading_deg": -170.0}],
        }
    )
    flight = rig.fly(mission)
    assert flight.state.outcome == "succeeded"
    np.testing.assert_allclose(flight.position[-1][:2], (2.0, -1.0), atol=0.05)
    assert max(r.heading for r in flight.reference) == pytest.approx(math.radians(190.0), abs=1e-6)


def test_nothing_happens_without_a_start_signal(rig):
    flight = rig.fly(HOP, signals=lambda t, s: Command(), limit_s=5.0)
    assert set(flight.states) == {"init"}
    assert {r.motors for r in flight.reference} == {"off"}


def test_take_off_that_does_not_lift_goes_back_to_init(rig):
    flight = rig.fly(HOP, lift=False)
    assert flight.visited == ["init", "take-off", "init"]
    assert flight.state.outcome == "failed"
    assert "take-off failed: 0.00 m gained" in flight.state.reason
    assert [r.motors for r in flight.reference][-1] == "off"
    assert "ramp_down" in {r.motors for r in flight.reference}


def test_take_off_that_gets_stuck_half_way_lands(rig):
    # A weak motor: it hangs 0.4 m below where it should be.
    flight = rig.fly(HOP, disturb=lambda t: np.array([0.0, 0.0, 6.4]))
    assert flight.visited[:3] == ["init", "take-off", "landing"]
    assert flight.state.outcome == "failed"
    assert "m high in place of 1.00 m" in flight.state.reason


def test_a_waypoint_that_cannot_be_reached_fails_the_mission(rig):
    def storm(t):
        return np.array([0.0, 8.0, 0.0]) if t > ROTOR_SPIN_UP_TIME_S + 6.5 else np.zeros(3)

    flight = rig.fly(HOP, disturb=storm)
    assert flight.state.outcome == "failed"
    assert "waypoint 1 not reached within" in flight.state.reason
    assert flight.visited[-4:] == ["hover", "landing", "landing", "init"]
    settled = after(flight, State.LANDING) - flight.state.events[-4].time_s
    assert settled == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("when", [1.5, 7.5, 10.5, 18.5])
def test_battery_low_lands_from_any_flying_state(rig, when):
    flight = rig.fly(SQUARE, voltage=lambda t: 7.4 if t < ROTOR_SPIN_UP_TIME_S + when else 5.9)
    assert flight.state.outcome == "failed"
    assert flight.state.reason.startswith("battery low: ")
    assert 1.0 < after(flight, State.LANDING) - ROTOR_SPIN_UP_TIME_S - when < 3.0
    assert flight.visited[-1] == "init"


def test_a_short_sag_of_the_battery_is_ignored(rig):
    # Deep enough for the filtered voltage to be low, for a quarter of a second.
    flight = rig.fly(HOP, voltage=lambda t: 5.0 if ROTOR_SPIN_UP_TIME_S + 5.5 < t < ROTOR_SPIN_UP_TIME_S + 6.1 else 7.4)
    assert flight.state.outcome == "succeeded"


def test_land_signal(rig):
    flight = rig.fly(
        SQUARE,
        signals=lambda t, s: Command(
            start=t < 0.2, land=ROTOR_SPIN_UP_TIME_S + 13.5 < t < ROTOR_SPIN_UP_TIME_S + 13.53
        ),
    )
    assert flight.visited[-3:] == ["landing", "landing", "init"]
    assert flight.state.outcome == "failed"
    assert flight.state.reason == "land signal with 4 waypoints to go"
    # It was at speed on its first leg: it brakes and comes down where it stopped.
    assert -3.0 < flight.position[-1][0] < -0.1


def test_users_waypoint_suspends_the_mission_and_start_resumes_it(rig):
    def signals(t, s):
        if t < 0.2:
            return Command(start=True)
        if 10.0 < t < 10.5:
            return Command(waypoint=(0.0, 1.0, -1.5))
        return Command(start=30.0 < t < 30.03)

    flight = rig.fly(SQUARE, signals=signals)
    t, x, _ = flight.arrays()
    np.testing.assert_allclose(x[np.searchsorted(t, 29.0)], (0.0, 1.0, -1.5), atol=0.05)
    assert flight.states[np.searchsorted(t, 29.0)] == "hover"
    assert flight.state.outcome == "succeeded"
    assert sum("waypoint 1 reached" in e.text for e in flight.state.events) == 1
    assert sum(e.text == "user's waypoint [0, 1, -1.5]" for e in flight.state.events) == 1


@pytest.mark.parametrize("where", [(0.0, 0.0, 0.5), (math.nan, 0.0, -1.0), (0.0, 0.0, -0.1)])
def test_an_impossible_waypoint_is_refused(rig, where):
    def signals(t, s):
        return Command(start=t < 0.2, waypoint=where if s.state is State.WAYPOINT else None)

    flight = rig.fly(HOP, signals=signals)
    assert flight.state.outcome == "succeeded"
    assert sum("refused" in e.text for e in flight.state.events) == 1


def test_rc_in_flight_and_back(rig):
    def signals(t, s):
        return Command(
            start=t < 0.2 or 20.0 < t < 20.03,
            rc_active=10.0 < t < 15.0,
            pilot_roll=0.02,
            pilot_climb_rate=0.1,
            pilot_yaw_rate=0.2,
        )

    flight = rig.fly(SQUARE, signals=signals)
    t, x, _ = flight.arrays()
    hand = (t > 10.1) & (t < 14.9)
    assert set(np.array(flight.states)[hand]) == {"rc"}
    references = [r for r, h in zip(flight.reference, hand, strict=True) if h]
    assert all(r.rc_active and r.roll == 0.02 and r.motors == "fly" for r in references)
    assert references[-1].heading - references[0].heading == pytest.approx(0.2 * 4.78, abs=0.02)
    climbed = x[np.searchsorted(t, 14.9), 2] - x[np.searchsorted(t, 10.1), 2]
    assert climbed == pytest.approx(-0.48, abs=0.1)
    assert x[np.searchsorted(t, 14.9), 1] > x[np.searchsorted(t, 10.1), 1] + 0.3
    assert flight.states[np.searchsorted(t, 19.0)] == "hover"
    assert flight.state.outcome == "succeeded"


def test_rc_from_the_floor_and_back_to_it(rig):
    def signals(t, s):
        return Command(
            rc_active=t < ROTOR_SPIN_UP_TIME_S + 11.0,
            pilot_climb_rate=0.3 if 1.0 < t < ROTOR_SPIN_UP_TIME_S + 3.5 else -0.2,
        )

    flight = rig.fly(HOP, signals=signals, limit_s=ROTOR_SPIN_UP_TIME_S + 18.0)
    motors = [a for a, b in pairwise([*(r.motors for r in flight.reference), None]) if a != b]
    assert motors == ["off", "spin_up", "fly", "ramp_down", "off"]
    assert min(x[2] for x in flight.position) < -0.4
    assert flight.states[-1] == "init"
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "landed by the pilot")


def test_tipping_over_on_the_floor_stops_the_motors(rig):
    flight = rig.fly(HOP, roll=lambda t: 1.2 if t > 1.0 else 0.0)
    assert flight.state.outcome == "failed"
    assert flight.state.reason == "tipped over"
    assert flight.reference[-1].motors == "off"


def test_a_finished_mission_can_be_flown_again(rig):
    plan = rig.plan_for(HOP)
    s = initial_mission_state(plan, measurement())
    for k in range(3):
        s, _ = step_mission(plan, s, measurement(0.02 * k), Command(start=True))
    assert s.state is State.TAKE_OFF
    again = rig.fly(HOP).state
    s, r = step_mission(plan, again, measurement(100.0), Command(start=True))
    assert s.state is State.TAKE_OFF
    assert s.waypoint_index == 0
    assert s.outcome == ""
    assert not s.finished
    assert r.motors == "spin_up"


def test_a_step_is_a_pure_function(rig):
    """The same state and measurement give the same answer, and the old state stays as it was."""
    flight = rig.fly(load_mission("box-on-leg"), limit_s=16.0)
    plan, s = rig.plan_for(load_mission("box-on-leg")), flight.state
    assert s.state is State.OBSTACLE
    m = measurement(16.0, x=flight.position[-1])
    points = s.obstacle_map.points.copy()
    first, second = step_mission(plan, s, m, Command()), step_mission(plan, s, m, Command())
    np.testing.assert_array_equal(first[1].position, second[1].position)
    assert first[0].detour == second[0].detour
    np.testing.assert_array_equal(s.obstacle_map.points, points)
    assert s is flight.state


@pytest.mark.parametrize("dt", [0.01, 0.04])
def test_other_rates(rig, dt):
    flight = rig.fly(load_mission("box-on-leg"), dt=dt)
    assert flight.state.outcome == "succeeded"
    assert flight.clearance > 0.4


def test_time_that_stands_still_or_jumps_does_no_harm(rig):
    plan = rig.plan_for(SQUARE)
    s = initial_mission_state(plan, measurement())
    s, _ = step_mission(plan, s, measurement(0.0), Command(start=True))
    for t in (0.0, 0.0, 5.0, 4.0, 100.0):
        s, r = step_mission(plan, s, measurement(t), Command())
        assert np.isfinite(r.position).all()


def test_spline_mission(rig):
    tables = SQUARE.model_dump(exclude_none=True)
    flight = rig.fly(parse_mission({**tables, "path": {"kind": "spline"}}))
    assert flight.state.outcome == "succeeded"
    x = np.array(flight.position)
    # It is no longer a square: the curve swings out of the straight legs.
    assert x[:, 1].max() > 3.05 or x[:, 0].min() < -3.05


NOTHING = np.zeros(0)
BELIEFS = AuxiliaryStates(NOTHING, NOTHING, 0.0, np.zeros(4), np.zeros(2), 1.0, NOTHING, ())


@pytest.mark.parametrize(
    ("speed", "believed", "on_floor", "text", "level"),
    [
        (0.29, None, 0.0, "touchdown", "info"),
        (1.7, None, 0.0, "hard touchdown", "warning"),
        (0.29, None, 1.7, "hard touchdown", "warning"),
        (0.29, BELIEFS, 1.7, "touchdown", "info"),  # a filter that has not noticed the floor yet
        (1.7, BELIEFS, 0.0, "hard touchdown", "warning"),
    ],
)
def test_a_touchdown_says_how_hard_it_was(rig, speed, believed, on_floor, text, level):
    """What it falls at higher up, or does on the floor later, is not the touchdown."""
    plan = rig.plan_for(HOP)
    begun = initial_mission_state(plan, measurement())
    s = replace(begun, state=State.LANDING, motors="fly", has_taken_off=True, hold_position=(0.0, 0.0, -0.1))
    falls = [(-0.5, 2.5), (-0.19, 2.0), (-0.16, speed), (-0.08, on_floor), *[(-0.07, 0.0)] * 150]
    for k, (down, sink) in enumerate(falls):
        m = measurement(0.02 * k, (0.0, 0.0, down), (0.0, 0.0, sink))
        s, _ = step_mission(plan, s, replace(m, auxiliary_states=believed), Command())
    touched = [e for e in s.events if "touchdown" in e.text]
    assert [(e.text.split(":")[0], e.level) for e in touched] == [(text, level)]
    assert ("1.70 m/s, above 0.3 m/s" in touched[0].text) is (level == "warning")


def test_oscillating_actuators_end_a_mission_but_not_a_pilots_flight(rig):
    flying = replace(
        initial_mission_state(rig.plan_for(HOP), measurement()), state=State.HOVER, motors="fly", has_taken_off=True
    )
    why = "servo_input 1 oscillates"
    for state, then, outcome in (
        (State.HOVER, State.LANDING, "failed"),
        (State.LANDING, State.LANDING, "failed"),
        (State.RC, State.RC, ""),
    ):
        s = fail_and_land(replace(flying, state=state), why)
        assert (s.state, s.outcome, s.motors) == (then, outcome, "fly")
        assert (s.events[-1].text, s.events[-1].level) == (why, "error")
        assert s.logged_event_count == flying.logged_event_count + 1


def test_rotors_that_lift_it_already_are_spun_up(rig):
    """2 cm above where it stood the controllers take over, whoever took off, and not at 1 cm."""
    plan = rig.plan_for(HOP)
    for command in (
        Command(start=True),
        Command(take_off_height=1.0),
        Command(rc_active=True, pilot_climb_rate=0.2),
    ):
        for rise, motors in ((0.01, "spin_up"), (0.03, "fly")):
            s = initial_mission_state(plan, measurement())
            for k in range(1, 20):
                x = (0.0, 0.0, -0.07 - (rise if k > 10 else 0.0))
                s, r = step_mission(
                    plan, s, measurement(0.02 * k, x), command if k == 5 or command.rc_active else Command()
                )
            assert r.motors == motors
