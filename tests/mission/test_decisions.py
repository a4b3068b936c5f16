"""Single decisions of the state machine, asked directly: one state, measurement and signal, and what comes of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import (
    Command,
    SetPoint,
    State,
    initial_mission_state,
    parse_mission,
    step_mission,
    update_obstacle_map,
)
from mufly.mission.avoidance import ObstacleMap, begin_path_check, check_map_part

TWO = {"waypoint": [{"position_m": [1.0, 0.0, -1.0]}, {"position_m": [2.0, 0.0, -1.0]}]}
HIGH = (0.0, 0.0, -1.0)


def measured(t=0.02, x=HIGH, attitude=(0.0, 0.0, 0.0), volts=7.4):
    return Estimate(t, np.array(x), np.zeros(3), np.array(attitude), np.zeros(3), np.full(8, 1.5), volts)


def in_state(plan, m, *commands):
    """The machine after some commands, a step of 20 ms each, at one place."""
    s = initial_mission_state(plan, measured(0.0, (0.0, 0.0, -0.07)))
    for k, c in enumerate(commands):
        s, _ = step_mission(plan, s, replace(m, time_s=0.02 * (k + 1)), c)
    return s


def hovering(rig, tables=TWO, **changes):
    """A plan, and a hover at 1 m with the mission begun and its wait over."""
    plan = rig.plan_for(parse_mission(tables))
    s = initial_mission_state(plan, measured(0.0, (0.0, 0.0, -0.07)))
    usual = {
        "state": State.HOVER,
        "motors": "fly",
        "has_taken_off": True,
        "mission_begun": True,
        "hold_position": HIGH,
        "goal": HIGH,
    }
    return plan, replace(s, **(usual | changes))


def point_at(north, down):
    """What is remembered and seen of one point."""
    points = ObstacleMap.make_empty_map().points
    points[0, :3] = (north, 0.0, down)
    memory, here = ObstacleMap(points, 1), (0.0, 0.0, down)
    seen = check_map_part(memory, begin_path_check(here, here), -math.inf, 0.39)[1]
    return {"obstacle_map": memory, "path_check": seen}


@pytest.mark.parametrize(("motors", "told"), [("fly", 1), ("off", 0)])
def test_a_low_battery_is_told_to_a_pilot_who_flies_once(rig, motors, told):
    plan, s = hovering(rig, state=State.RC, motors=motors, mission_begun=False, battery_V=5.5)
    for k in range(1, 120):
        s, _ = step_mission(plan, s, measured(0.02 * k, volts=5.5), Command(rc_active=True))
    low = [e for e in s.events if "battery low" in e.text]
    assert [e.level for e in low] == ["warning"] * told
    assert s.state is State.RC
    assert s.outcome == ""


@pytest.mark.parametrize(("before", "after"), [("", "failed"), ("succeeded", "succeeded")])
def test_a_low_battery_lands_and_fails_only_what_was_open(rig, before, after):
    plan, s = hovering(rig, outcome=before, user_in_control=True, battery_V=5.5)
    for k in range(1, 60):
        s, _ = step_mission(plan, s, measured(0.02 * k, volts=5.5), Command())
    assert s.state is State.LANDING
    assert s.outcome == after
    assert ("battery low: 5.50 V, below 6.00 V" in s.reason) is (after == "failed")


@pytest.mark.parametrize(("index", "state", "text"), [(0, "waypoint", "waypoint 1"), (1, "waypoint", "waypoint 2")])
def test_after_a_wait_the_next_waypoint_is_flown_to_down_to_the_last(rig, index, state, text):
    plan, s = hovering(rig, waypoint_index=index)
    s, _ = step_mission(plan, s, measured(), Command())
    assert (s.state, s.events[-1].text) == (state, text)
    assert s.goal == (index + 1.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("at_end", "state", "outcome"),
    [("land", "landing", ""), ("hover", "hover", "succeeded"), ("return", "waypoint", "")],
)
def test_after_the_last_wait_it_does_what_the_mission_says(rig, at_end, state, outcome):
    plan, s = hovering(rig, TWO | {"at_end": at_end}, waypoint_index=2)
    s, _ = step_mission(plan, s, measured(), Command())
    assert (s.state, s.outcome) == (state, outcome)
    assert "mission complete" in s.events[-1].text
    assert s.returning_home is (at_end == "return")


@pytest.mark.parametrize(
    ("index", "begun", "outcome", "first", "then"),
    [(1, True, "", None, 1), (2, True, "succeeded", None, 0), (0, True, "", 1, 1), (1, False, "", None, 1)],
)
def test_start_goes_on_where_it_was_and_anew_when_it_was_over(rig, index, begun, outcome, first, then):
    plan, s = hovering(rig, waypoint_index=index, mission_begun=begun, outcome=outcome, user_in_control=True)
    s, _ = step_mission(plan, s, measured(), Command(start=True, first_waypoint=first))
    assert (s.state, s.waypoint_index, s.outcome) == (State.WAYPOINT, then, "")
    texts = [e.text for e in s.events]
    goes_on = "the mission goes on" if begun and not outcome else "the mission begins"
    assert (f"on to waypoint {first + 1}" if first is not None else goes_on) in texts


@pytest.mark.parametrize(("signal", "word"), [({"land": True}, "land"), ({"return_requested": True}, "return")])
@pytest.mark.parametrize(("index", "left"), [(0, "2 waypoints to go"), (1, "1 waypoint to go"), (2, "")])
def test_what_a_user_breaks_off_is_counted(rig, signal, word, index, left):
    plan, s = hovering(rig, waypoint_index=index, user_in_control=index == 2)
    s, _ = step_mission(plan, s, measured(), Command(**signal))
    assert s.abort_reason == (f"{word} signal with {left}" if left else "")


@pytest.mark.parametrize(("height", "tilt", "stops"), [(0.25, 70.0, True), (0.36, 70.0, False), (0.25, 50.0, False)])
def test_tipped_over_near_the_floor_stops_the_motors(rig, height, tilt, stops):
    plan, s = hovering(rig)
    s, r = step_mission(
        plan, s, measured(x=(0.0, 0.0, -0.07 - height), attitude=(0.0, math.radians(tilt), 0.0)), Command()
    )
    assert (r.motors == "off") is stops
    assert (s.outcome == "failed") is stops


@pytest.mark.parametrize(
    ("started", "begun", "outcome"), [(True, True, "failed"), (True, False, "failed"), (False, False, "")]
)
def test_a_stop_fails_a_flight_with_a_mission_or_without_but_not_none(rig, started, begun, outcome):
    plan, s = hovering(rig, has_taken_off=started, mission_begun=begun)
    s, r = step_mission(plan, s, measured(), Command(motor_stop_reason="emergency stop"))
    assert (s.state, s.outcome, s.finished, r.motors) == (State.INIT, outcome, outcome != "", "off")


@pytest.mark.parametrize(
    ("late", "height", "state"),
    [(2.9, 0.05, "take-off"), (3.1, 0.09, "init"), (3.1, 0.11, "take-off"), (3.6, 0.05, "init")],
)
def test_a_take_off_that_does_not_lift_is_given_up_after_three_seconds(rig, late, height, state):
    plan = rig.plan_for(parse_mission(TWO))
    s = in_state(plan, measured(x=(0.0, 0.0, -0.07)), Command(start=True))
    s = replace(s, motors="fly", motion_clock_s=s.motion.duration_s + late - 0.02)
    s, r = step_mission(plan, s, measured(0.04, (0.0, 0.0, -0.07 - height)), Command())
    assert s.state == state
    assert (r.motors == "ramp_down") is (state == "init")


@pytest.mark.parametrize(("more", "state"), [(-0.1, "take-off"), (0.1, "landing")])
def test_a_take_off_that_hangs_half_way_lands_8_s_and_half_a_climb_late(rig, more, state):
    plan = rig.plan_for(parse_mission(TWO))
    s = in_state(plan, measured(x=(0.0, 0.0, -0.07)), Command(start=True))
    climb = s.motion.duration_s
    s = replace(s, motors="fly", motion_clock_s=1.5 * climb + 8.0 + more - 0.02)
    s, _ = step_mission(plan, s, measured(0.04, (0.0, 0.0, -0.6)), Command())
    assert s.state == state
    assert ("0.60 m high in place of 1.00 m" in s.reason) is (state == "landing")


@pytest.mark.parametrize(
    ("aside", "more", "state"),
    [(0.03, -8.0, "hover"), (0.4, -8.0, "take-off"), (0.4, -0.1, "take-off"), (0.4, 0.1, "hover")],
)
def test_a_take_off_ends_above_its_start_or_8_s_and_half_a_climb_late(rig, aside, more, state):
    """Wind pushes a climbing helicopter aside until its controllers have learned it."""
    plan = rig.plan_for(parse_mission(TWO))
    s = in_state(plan, measured(x=(0.0, 0.0, -0.07)), Command(start=True))
    s = replace(s, motors="fly", motion_clock_s=1.5 * s.motion.duration_s + 8.0 + more)
    s, _ = step_mission(plan, s, measured(0.04, (aside, 0.0, -1.0)), Command())
    assert s.state == state


@pytest.mark.parametrize(("height", "moves", "motors"), [(0.1, 0.0, "off"), (0.1, 0.06, "fly"), (1.0, 0.0, "fly")])
def test_what_does_not_sink_any_more_lies_on_something(rig, height, moves, motors):
    """A box, or a floor that is believed to be lower; what sinks, or waits far up to be told to, does not lie."""
    plan = rig.plan_for(parse_mission(TWO))
    s = in_state(plan, measured(x=(0.0, 0.0, -0.07)), Command(start=True))
    s = replace(s, state=State.LANDING, motors="fly", hold_position=(0.0, 0.0, -0.05 if height < 0.5 else -1.07))
    for k in range(200):
        m = replace(measured(0.02 * k, (0.0, 0.0, -0.07 - height)), velocity=np.array([0.0, 0.0, moves]))
        s, r = step_mission(plan, s, m, Command())
        if height > 0.5 and s.hold_position[2] > -0.07 - height + 0.2:
            break
    assert r.motors == motors


@pytest.mark.parametrize(("rise", "state"), [(0.15, "take-off"), (0.25, "obstacle")])
def test_a_take_off_gives_way_once_it_is_off_its_legs(rig, rise, state):
    plan = rig.plan_for(parse_mission(TWO))
    s = in_state(plan, measured(x=(0.0, 0.0, -0.07)), Command(start=True))
    s = replace(s, motors="fly", motion_clock_s=0.5 * s.motion.duration_s, **point_at(0.3, -0.3))
    s, _ = step_mission(plan, s, measured(0.04, (0.0, 0.0, -0.07 - rise)), Command())
    assert s.state == state


def follow(plan, s, steps):
    """The state, and the reference, after some steps of 20 ms in which the helicopter is where it has to be."""
    x, heading = HIGH, 0.0
    for k in range(1, steps + 1):
        s, r = step_mission(plan, s, measured(0.02 * k, x, (0.0, 0.0, heading)), Command())
        x, heading = tuple(r.position), r.heading
    return s, r


@pytest.mark.parametrize("when", [50, 250])
@pytest.mark.parametrize(
    "command",
    [
        Command(waypoint=(0.0, 1.5, -1.5)),
        Command(return_requested=True),
        Command(pause=True),
        Command(land=True),
    ],
)
def test_what_breaks_off_a_leg_goes_on_from_how_it_moves(rig, command, when):
    """While it turns towards its goal, and at speed: the reference goes on without a jump."""
    plan, s = hovering(rig, {"waypoint": [{"position_m": [0.0, 3.0, -1.0]}]})
    s, before = follow(plan, s, when)
    speed, turning = np.linalg.norm(before.velocity), abs(before.heading_rate)
    assert (speed > 0.2, turning > 0.2) == (when == 250, when == 50)
    now = measured(0.02 * when + 0.02, before.position, (0.0, 0.0, before.heading))
    s, now = step_mission(plan, s, now, command)
    np.testing.assert_allclose(now.velocity, before.velocity, atol=0.03)
    np.testing.assert_allclose(now.position, before.position + 0.02 * before.velocity, atol=0.002)
    assert now.heading == pytest.approx(before.heading + 0.02 * before.heading_rate, abs=0.003)
    if not command.land:
        assert now.heading_rate == pytest.approx(before.heading_rate, abs=0.1)


def test_a_program_that_ends_leaves_a_reference_that_goes_on_from_how_it_moves(rig):
    plan, s = hovering(rig)
    x = HIGH
    for k in range(1, 151):
        s, before = step_mission(
            plan, s, measured(0.02 * k, x), Command(program_set_point=SetPoint(velocity_m_s=(0.3, 0.2, -0.25)))
        )
        x = tuple(before.position)
    assert before.velocity == pytest.approx((0.3, 0.2, -0.25), abs=0.02)
    s, now = step_mission(plan, s, measured(3.02, x), Command())
    assert s.state is State.HOVER
    np.testing.assert_allclose(now.velocity, before.velocity, atol=0.03)
    np.testing.assert_allclose(now.position, before.position + 0.02 * before.velocity, atol=0.002)


@pytest.mark.parametrize("goal", [[0.0, 3.0, -1.0], [3.0, 0.0, -2.0]])
def test_the_nose_swings_on_the_level_way_and_not_while_it_turns_or_climbs_before(rig, goal):
    plan, s = hovering(rig, {"waypoint": [{"position_m": goal}], "avoidance": {"scan": True}})
    for steps, swings in ((30, False), (250, True)):
        after, _ = follow(plan, s, steps)
        assert after.state is State.WAYPOINT
        assert (after.scan_duration_s > 0.0) is swings


@pytest.mark.parametrize(
    ("tables", "outcome", "state"),
    [
        ({}, "", "obstacle"),
        ({"enabled": False}, "", "hover"),
        ({}, "failed", "hover"),
        ({}, "succeeded", "obstacle"),
    ],
)
def test_what_was_seen_near_is_avoided_unless_that_is_off_or_it_lands(rig, tables, outcome, state):
    seen = point_at(0.3, -1.0)
    plan, s = hovering(
        rig, TWO | {"avoidance": tables}, user_in_control=True, outcome=outcome, hover_until_s=9.0, **seen
    )
    s, _ = step_mission(plan, s, measured(), Command())
    assert s.state == state


@pytest.mark.parametrize(("tables", "through"), [({}, False), ({"enabled": False}, True)])
def test_set_points_lead_into_nothing_that_was_seen_unless_avoidance_is_off(rig, tables, through):
    plan, s = hovering(rig, TWO | {"avoidance": tables}, **point_at(0.5, -1.0))
    x = HIGH
    for k in range(1, 120):
        s, r = step_mission(
            plan, s, measured(0.02 * k, x), Command(program_set_point=SetPoint(velocity_m_s=(0.5, 0.0, 0.0)))
        )
        s = update_obstacle_map(plan, s, measured(0.02 * k, x))
        x = tuple(r.position)
    assert s.state is State.OFFBOARD
    assert bool(x[0] > 0.12) is through


@pytest.mark.parametrize(("rise", "state"), [(0.08, "init"), (0.12, "hover")])
def test_a_pilot_who_lets_go_has_landed_only_on_the_floor(rig, rise, state):
    plan, s = hovering(rig, state=State.RC, mission_begun=False)
    s, r = step_mission(plan, s, measured(x=(0.0, 0.0, -0.07 - rise)), Command())
    assert s.state == state
    assert (r.motors == "ramp_down") is (state == "init")


@pytest.mark.parametrize("level", [0.0, 0.4, 2.0])
def test_a_pilot_who_lets_go_in_a_dive_is_braked_to_the_floor_and_not_below(rig, level):
    """At 3 m/s it needs 8 m and has 1.5: the reference is that of a fall that can still be stopped there."""
    plan, s = hovering(rig, state=State.RC, mission_begun=False)
    m = replace(measured(x=(0.0, 0.0, -1.57)), velocity=np.array([level, 0.0, 3.0]))
    s, _ = step_mission(plan, s, m, Command())
    assert s.state is State.HOVER
    assert s.goal[2] == pytest.approx(-0.07, abs=1e-6)
    assert s.motion.evaluate(0.0).velocity[0] == level
    assert 0.5 < s.motion.evaluate(0.0).velocity[2] < 3.0


def test_a_stop_stops_rotors_that_run_down_too(rig):
    plan, s = hovering(rig, state=State.INIT, motors="ramp_down", outcome="succeeded")
    s, r = step_mission(plan, s, measured(x=(0.0, 0.0, -0.07)), Command(motor_stop_reason="emergency stop"))
    assert r.motors == "off"
    assert s.events[-1].text == "emergency stop"


@pytest.mark.parametrize("more", [-1.0, 1.0])
def test_a_leg_is_given_up_after_twice_its_time_and_20_s(rig, more):
    plan, s = hovering(rig, waypoint_index=1)
    s, _ = step_mission(plan, s, measured(), Command())
    planned = s.motion.duration_s
    late = 2.0 * planned + 20.0 + more
    s = replace(s, time_s=late, motion_clock_s=planned + 1.0)
    s, _ = step_mission(plan, s, measured(late + 0.02), Command())
    assert s.outcome == ("failed" if more > 0 else "")


def test_a_pilots_height_answers_at_once_after_a_long_climb_that_did_not_happen(rig):
    """The reference is never far from the helicopter: a second and a half of stick brings it back."""
    for climb in (0.3, -0.3):
        plan, s = hovering(rig, state=State.RC, mission_begun=False)
        for k in range(500):
            s, r = step_mission(plan, s, measured(0.02 * k), Command(rc_active=True, pilot_climb_rate=climb))
        assert abs(r.position[2] - HIGH[2]) > 0.4
        for k in range(500, 590):
            s, r = step_mission(plan, s, measured(0.02 * k), Command(rc_active=True, pilot_climb_rate=-climb))
        assert (r.position[2] - HIGH[2]) * climb > 0.0


@pytest.mark.parametrize(
    ("tables", "swings"),
    [({}, False), ({"scan": False}, False), ({"scan": True}, True), ({"enabled": False}, False)],
)
def test_the_nose_swings_by_half_the_gap_of_two_beams_while_it_scans(rig, tables, swings):
    """To both sides of a beam that looks along the way; every direction is looked into every two seconds."""
    box = [] if not tables else [{"centre_m": [1.0, 3.0, -1.0], "size_m": [0.4, 0.4, 2.0]}]
    mission = parse_mission({"waypoint": [{"position_m": [3.0, 0.0, -1.0]}], "box": box, "avoidance": tables})
    assert rig.plan_for(mission).scans_by_yawing is swings
    flight = rig.fly(mission, limit_s=22.0)
    flying = [s in ("waypoint", "hover") for s in flight.states]
    t, heading, rate = (
        np.array([v for v, f in zip(values, flying, strict=True) if f])
        for values in (
            flight.time,
            [r.heading for r in flight.reference],
            [r.heading_rate for r in flight.reference],
        )
    )
    np.testing.assert_allclose(np.diff(heading) / np.diff(t), 0.5 * (rate[1:] + rate[:-1]), atol=0.02)
    level = np.array([abs(r.velocity[0]) > 0.02 for r, f in zip(flight.reference, flying, strict=True) if f])
    degrees = np.degrees(heading[level])
    assert degrees.max() - degrees.min() == pytest.approx(45.0 if swings else 0.0, abs=0.5)
    assert abs(0.5 * (degrees.max() + degrees.min())) == pytest.approx(22.5 if swings else 0.0, abs=0.5)
