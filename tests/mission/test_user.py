"""What the user's signals do: take off, pause, go to, turn, return, set-points, stop; and how a flight then counts."""

import math
from itertools import pairwise

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import (
    ROTOR_SPIN_UP_TIME_S,
    Command,
    SetPoint,
    State,
    initial_mission_state,
    load_mission,
    parse_mission,
    step_mission,
)
from mufly.mission.files.mission_timing import plan_return_leg
from mufly.mission.machine.mission_state import LOG_CAPACITY

SQUARE = load_mission("demonstration")
HOP = parse_mission({"take_off": {"wait_s": 0.5}, "waypoint": [{"position_m": [1.0, 0.0, -1.0], "wait_s": 0.5}]})


class Script:
    """Signals at given times, each for one step of 20 ms."""

    def __init__(self, *lines, then=None):
        self.lines, self.then, self.next = lines, then, 0

    def __call__(self, t, s):
        if self.next < len(self.lines) and t >= self.lines[self.next][0]:
            self.next += 1
            return self.lines[self.next - 1][1]
        return self.then(t) if self.then else Command()


def at(flight, t):
    return int(np.searchsorted(flight.time, t))


def check_references(flight, mission, slack=1.05):
    """Positions are the integral of velocities, and these do not jump: whatever the user did in between."""
    flying = [r for r in flight.reference if r.motors == "fly" and not r.rc_active]
    x = np.array([r.position for r in flying])
    v = np.array([r.velocity for r in flying])
    most = max(1.0, mission.limits.acceleration_m_s2)  # braking is harder than flying
    assert np.abs(np.diff(v, axis=0)).max() <= 0.02 * most * slack
    np.testing.assert_allclose(np.diff(x, axis=0), 0.01 * (v[1:] + v[:-1]), atol=3e-4)
    turn = math.radians(mission.limits.yaw_rate_deg_s)
    headings = np.array([r.heading for r in flying])
    assert np.abs(np.diff(headings)).max() <= 0.02 * turn * slack


def test_take_off_to_a_height_and_land(rig):
    flight = rig.fly(SQUARE, signals=Script((0.1, Command(take_off_height=1.6)), (20.0, Command(land=True))))
    assert flight.position[at(flight, 19.0)][2] == pytest.approx(-1.6, abs=0.05)
    assert flight.states[at(flight, 19.9)] == "hover"
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "landed")
    assert flight.state.events[1].text == "take-off signal, to 1.6 m"


def test_a_take_off_without_mission_and_then_the_mission(rig):
    flight = rig.fly(HOP, signals=Script((0.1, Command(take_off_height=1.0)), (15.0, Command(start=True))))
    assert "the mission begins" in flight.text
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "mission complete")
    assert flight.state.reached_waypoint_count == 1


def test_the_mission_may_be_asked_for_during_the_take_off(rig):
    flight = rig.fly(HOP, signals=Script((0.1, Command(take_off_height=1.0)), (1.0, Command(start=True))))
    assert flight.state.reason == "mission complete"


@pytest.mark.parametrize(
    "when",
    [ROTOR_SPIN_UP_TIME_S + 2.2, ROTOR_SPIN_UP_TIME_S + 3.0, ROTOR_SPIN_UP_TIME_S + 7.0, ROTOR_SPIN_UP_TIME_S + 12.0],
)
def test_pause_stops_and_start_goes_on(rig, when):
    script = Script((0.1, Command(start=True)), (when, Command(pause=True)), (when + 8, Command(start=True)))
    flight = rig.fly(SQUARE, signals=script)
    check_references(flight, SQUARE)
    stopped = [flight.position[k] for k in range(at(flight, when + 4), at(flight, when + 8))]
    assert np.ptp(stopped, axis=0).max() < 0.02
    assert set(flight.states[at(flight, when + 2) : at(flight, when + 8)]) == {"hover"}
    assert flight.state.outcome == "succeeded"
    assert flight.state.reached_waypoint_count == 4
    assert all(f"waypoint {k} reached" in flight.text for k in (1, 2, 3, 4))


def test_pause_before_lift_off_stops_the_climb_as_soon_as_it_is_off_the_floor(rig):
    script = Script((0.1, Command(start=True)), (1.0, Command(pause=True)), (9.0, Command(start=True)))
    flight = rig.fly(HOP, signals=script)
    low = np.array(flight.position)[at(flight, 6.0) : at(flight, 8.9), 2]
    assert -0.8 < low.min() < low.max() < -0.2  # of the metre that it climbs to
    assert "hover: paused" in flight.text
    assert flight.state.outcome == "succeeded"
    assert flight.state.reached_waypoint_count == 1


def test_pause_around_an_obstacle_and_on(rig):
    mission = load_mission("box-on-leg")
    seen = []

    def signals(t, s):
        if s.state is State.OBSTACLE and s.detour_duration_s > 2.0 and not seen:
            seen.append(t)
            return Command(pause=True)
        return Command(start=t < 0.1 or bool(seen and seen[0] + 5.0 < t < seen[0] + 5.03))

    flight = rig.fly(mission, signals=signals)
    check_references(flight, mission)
    assert flight.states[at(flight, seen[0] + 4.0)] == "hover"
    assert flight.state.outcome == "succeeded"
    assert flight.clearance > 0.35


def test_a_landing_can_be_broken_off_while_it_is_high(rig):
    def signals(t, s):
        low = s.state is State.LANDING and s.hold_position[2] > -0.6
        if t < 0.1:
            return Command(start=True)
        return Command(land=18.0 < t < 18.03, pause=low and t < 24.0, start=30.0 < t < 30.03)

    flight = rig.fly(SQUARE, signals=signals)
    check_references(flight, SQUARE)
    assert "landing broken off" in flight.text
    assert flight.states[at(flight, 29.0)] == "hover"
    assert min(-x[2] for x in flight.position[at(flight, 18.0) : at(flight, 30.0)]) > 0.25
    # The land signal is forgotten: the mission was flown to its end.
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "mission complete")


def test_a_landing_for_a_low_battery_goes_on(rig):
    flight = rig.fly(
        SQUARE,
        voltage=lambda t: 7.4 if t < ROTOR_SPIN_UP_TIME_S + 7.5 else 5.9,
        signals=lambda t, s: Command(start=t < 0.1, pause=s.state is State.LANDING),
    )
    assert flight.visited[-3:] == ["landing", "landing", "init"]
    assert flight.state.reason.startswith("battery low")


def test_a_users_waypoint_on_the_run_does_not_make_the_reference_jump(rig):
    script = Script(
        (0.1, Command(take_off_height=1.0)),
        (12.0, Command(waypoint=(3.0, 0.0, -1.0))),
        (17.0, Command(waypoint=(0.0, 2.0, -1.5), heading=1.0)),
        (21.0, Command(heading=-2.0)),
        (22.0, Command(waypoint=(0.0, -1.0, -1.0))),
        (45.0, Command(land=True)),
    )
    flight = rig.fly(SQUARE, signals=script)
    check_references(flight, SQUARE)
    np.testing.assert_allclose(flight.position[at(flight, 44.0)], (0.0, -1.0, -1.0), atol=0.05)
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "landed")


def test_turn_on_the_spot(rig):
    script = Script((0.1, Command(take_off_height=1.0)), (12.0, Command(heading=2.0)), (20.0, Command(land=True)))
    flight = rig.fly(SQUARE, signals=script)
    check_references(flight, SQUARE)
    k = at(flight, 19.0)
    assert flight.reference[k].heading == pytest.approx(2.0, abs=1e-6)
    np.testing.assert_allclose(flight.position[k], (0.0, 0.0, -1.0), atol=0.05)
    assert "turning to 115 deg" in flight.text


def test_return_flies_home_and_lands(rig):
    script = Script((0.1, Command(start=True)), (26.0, Command(return_requested=True)))
    flight = rig.fly(SQUARE, signals=script)
    check_references(flight, SQUARE)
    assert flight.state.outcome == "failed"
    assert flight.state.reason == "return signal with 3 waypoints to go"
    np.testing.assert_allclose(flight.position[-1], (0.0, 0.0, rig.STANDING), atol=0.05)
    heights = [-x[2] for x, s in zip(flight.position, flight.states, strict=True) if s == "waypoint"]
    back = heights[-200:]
    assert min(back) > back[0] - 0.06, "no lower than it was"


def test_return_from_a_flight_without_mission_succeeds(rig):
    script = Script(
        (0.1, Command(take_off_height=1.0)),
        (12.0, Command(waypoint=(2.0, 1.0, -1.0))),
        (22.0, Command(return_requested=True)),
    )
    flight = rig.fly(SQUARE, signals=script)
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "landed")
    np.testing.assert_allclose(flight.position[-1][:2], (0.0, 0.0), atol=0.05)


def test_return_goes_round_obstacles(rig):
    mission = parse_mission(
        {
            "waypoint": [{"position_m": [0.0, 3.0, -1.0]}],
            "box": [{"centre_m": [1.7, 1.6, -1.0], "size_m": [0.5, 0.5, 2.0], "name": "crate"}],
        }
    )
    script = Script(
        (0.1, Command(take_off_height=1.0)),
        (10.0, Command(waypoint=(3.2, 0.0, -1.0))),
        (40.0, Command(waypoint=(3.2, 3.2, -1.0))),
        (60.0, Command(return_requested=True)),
    )
    flight = rig.fly(mission, signals=script)
    assert "obstacle" in {s for s, t in zip(flight.states, flight.time, strict=True) if t > 60.0}
    assert flight.clearance > 0.35
    np.testing.assert_allclose(flight.position[-1][:2], (0.0, 0.0), atol=0.05)


def test_another_waypoint_of_the_mission_first(rig):
    script = Script((0.1, Command(start=True, first_waypoint=2)), (30.0, Command(start=True, first_waypoint=1)))
    flight = rig.fly(SQUARE, signals=script)
    check_references(flight, SQUARE)
    order = [e.text for e in flight.state.events if e.state == "waypoint"]
    assert order[0] == "waypoint 3"
    assert "on to waypoint 2" in flight.text
    assert order[-3:] == ["waypoint 2", "waypoint 3", "waypoint 4"]
    assert flight.state.outcome == "succeeded"


@pytest.mark.parametrize(
    "when", [0.5, ROTOR_SPIN_UP_TIME_S + 1.6, ROTOR_SPIN_UP_TIME_S + 8.0, ROTOR_SPIN_UP_TIME_S + 17.0]
)
def test_stop_turns_the_motors_off_from_any_state(rig, when):
    script = Script((0.1, Command(start=True)), (when, Command(motor_stop_reason="emergency stop")))
    flight = rig.fly(SQUARE, signals=script)
    assert flight.reference[-1].motors == "off"
    assert flight.time[-1] == pytest.approx(when, abs=0.03)
    assert (flight.state.outcome, flight.state.reason) == ("failed", "emergency stop")
    assert flight.state.events[-1].level == "error"


# at the end


def ending(how):
    return parse_mission({**HOP.model_dump(exclude_none=True), "at_end": how})


def test_at_the_end_it_may_return(rig):
    mission = ending("return")
    assert plan_return_leg(mission).goal == (0.0, 0.0, -1.0)
    flight = rig.fly(mission)
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "mission complete")
    assert "home reached" in flight.text
    np.testing.assert_allclose(flight.position[-1][:2], (0.0, 0.0), atol=0.05)


def test_at_the_end_it_may_hover_until_told(rig):
    flight = rig.fly(ending("hover"), signals=Script((0.1, Command(start=True)), (60.0, Command(land=True))))
    k = at(flight, 59.0)
    assert flight.states[k] == "hover"
    np.testing.assert_allclose(flight.position[k], (1.0, 0.0, -1.0), atol=0.05)
    assert "mission complete, holding" in flight.text
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "mission complete")


def test_at_the_end_it_hovers_until_the_battery_is_low_and_has_not_failed(rig):
    flight = rig.fly(ending("hover"), voltage=lambda t: 7.4 if t < 50.0 else 5.9)
    assert 51.0 < flight.time[-1] < 62.0
    assert (flight.state.outcome, flight.state.reason) == ("succeeded", "mission complete")


def test_a_mission_that_is_complete_can_be_flown_again_in_the_air(rig):
    script = Script((0.1, Command(start=True)), (40.0, Command(start=True)), (80.0, Command(pause=True, land=True)))
    flight = rig.fly(ending("hover"), signals=script)
    assert sum("waypoint 1 reached" in e.text for e in flight.state.events) == 2
    assert flight.state.outcome == "succeeded"


def test_a_waypoint_with_its_own_speed(rig):
    mission = parse_mission(
        {
            "waypoint": [
                {"position_m": [2.0, 0.0, -1.0], "speed_m_s": 0.25},
                {"position_m": [0.0, 0.0, -1.0]},
            ]
        }
    )
    assert mission.leg_limits(0).speed == 0.25
    assert mission.leg_limits(1).speed == 0.6
    flight = rig.fly(mission)
    speed = np.array([np.hypot(*r.velocity[:2]) for r in flight.reference])
    out = speed[at(flight, ROTOR_SPIN_UP_TIME_S) : next(k for k, x in enumerate(flight.position) if x[0] > 1.9)]
    assert out.max() == pytest.approx(0.25, abs=1e-6)
    assert speed.max() == pytest.approx(0.6, abs=1e-6)


# set-points


def towards(*place):
    return lambda t: Command(program_set_point=SetPoint(position_m=place))


def test_set_points_in_flight_and_back(rig):
    def signals(t, s):
        if t < 0.1:
            return Command(start=True)
        if 18.0 < t < 28.0:
            return Command(program_set_point=SetPoint(position_m=(0.5, 1.0, -1.5), heading_rad=1.0))
        return Command(start=40.0 < t < 40.03)

    flight = rig.fly(SQUARE, signals=signals)
    check_references(flight, SQUARE)
    k = at(flight, 27.9)
    assert flight.states[k] == "offboard"
    np.testing.assert_allclose(flight.position[k], (0.5, 1.0, -1.5), atol=0.05)
    assert flight.states[at(flight, 39.0)] == "hover"
    assert (flight.state.outcome, flight.state.reached_waypoint_count) == ("succeeded", 4)


def test_a_stream_that_ends_at_speed_comes_to_rest_smoothly(rig):
    def signals(t, s):
        if t < 0.1:
            return Command(take_off_height=1.0)
        if 12.0 < t < 18.0:
            return Command(program_set_point=SetPoint(velocity_m_s=(0.6, 0.0, 0.0), yaw_rate_rad_s=0.8))
        return Command(land=t > 25.0 and s.state is State.HOVER)

    flight = rig.fly(SQUARE, signals=signals)
    check_references(flight, SQUARE)
    assert flight.states[at(flight, 24.0)] == "hover"
    assert np.linalg.norm(flight.velocity[at(flight, 24.0)]) < 0.01
    assert flight.state.outcome == "succeeded"


def test_set_points_lift_off_and_the_rest_is_up_to_them(rig):
    flight = rig.fly(
        SQUARE, signals=lambda t, s: Command(program_set_point=SetPoint(position_m=(1.0, 0.0, -1.0))), limit_s=20.0
    )
    motors = [a for a, b in pairwise([*(r.motors for r in flight.reference), None]) if a != b]
    assert motors == ["off", "spin_up", "fly"] or motors == ["spin_up", "fly"]
    np.testing.assert_allclose(flight.position[-1], (1.0, 0.0, -1.0), atol=0.05)
    check_references(flight, SQUARE)


def test_set_points_that_do_not_lead_up_leave_it_on_the_floor(rig):
    level = SetPoint(velocity_m_s=(0.5, 0.0, 0.0))
    flight = rig.fly(SQUARE, signals=lambda t, s: Command(program_set_point=level), limit_s=3.0)
    assert {r.motors for r in flight.reference} == {"off"}


def test_a_stream_that_ends_before_lift_off_stops_the_rotors(rig):
    flight = rig.fly(SQUARE, signals=lambda t, s: towards(0.0, 0.0, -1.0)(t) if t < 1.0 else Command(), limit_s=5.0)
    assert flight.reference[-1].motors == "off"
    assert flight.states[-1] == "init"


def test_battery_low_ends_offboard(rig):
    def signals(t, s):
        return Command(take_off_height=1.0) if t < 0.1 else towards(1.0, 0.0, -1.0)(t) if t > 10 else Command()

    flight = rig.fly(SQUARE, signals=signals, voltage=lambda t: 7.4 if t < 15.0 else 5.9)
    assert flight.visited[-3:] == ["landing", "landing", "init"]
    assert flight.state.reason.startswith("battery low")


def test_set_points_into_a_wall_stop_at_the_clearance(rig):
    mission = parse_mission(
        {
            "waypoint": [{"position_m": [0.0, 0.0, -1.0]}],
            "wall": [{"start_m": [2.0, -3.0], "end_m": [2.0, 3.0], "height_m": 2.5}],
        }
    )

    def signals(t, s):
        if t < 0.1:
            return Command(take_off_height=1.0)
        return Command(program_set_point=SetPoint(velocity_m_s=(0.5, 0.0, 0.0))) if t > 12.0 else Command()

    flight = rig.fly(mission, signals=signals, limit_s=40.0)
    assert flight.states[-1] == "offboard"
    assert flight.clearance > 0.33


# the log


def test_the_log_stays_short_and_counts_on(rig):
    plan = rig.plan_for(SQUARE)
    m = Estimate(0.0, np.array([0, 0, -0.07]), np.zeros(3), np.zeros(3), np.zeros(3), np.full(8, 1.5), 7.4)
    s = initial_mission_state(plan, m)
    for k in range(1000):
        t = 0.04 * k
        s, _ = step_mission(
            plan,
            s,
            Estimate(t, *([*map(np.copy, (m.position, m.velocity, m.attitude, m.rates))]), m.ranges, 7.4),
            Command(rc_active=bool(k % 2)),
        )
    assert s.logged_event_count == 1000
    assert len(s.events) == LOG_CAPACITY
    assert s.events[-1].text.startswith("RC")
