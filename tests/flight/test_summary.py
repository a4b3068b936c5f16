"""The summary against flights whose numbers are known."""

import json
import math
from itertools import pairwise

import numpy as np
import pytest

from mufly.flight import summarise_flight, summary_rows
from mufly.logs import make_flight_row_layout, rows_to_dataset
from mufly.world import Box, World

LAYOUT = make_flight_row_layout(8)
STEP_S = 0.01


def flown(knots, states, **columns):
    """A recording along straight lines between knots (time, N, E, D); states as (time, name)."""
    knots = np.array(knots, dtype=float)
    time = np.arange(round(knots[0, 0] / STEP_S), round(knots[-1, 0] / STEP_S) + 1) * STEP_S
    rows = np.zeros((len(time), LAYOUT.column_count))
    rows[:, 0] = time
    position = np.column_stack([np.interp(time, knots[:, 0], knots[:, k]) for k in (1, 2, 3)])
    values = {
        "truth_position": position,
        "truth_velocity": np.gradient(position, STEP_S, axis=0),
        "reference_position": position,
        "motor_input": 0.7,
    }
    for name, value in (values | columns).items():
        rows[:, LAYOUT.column_slices[name]] = value
    names = [[name for begin, name in states if begin <= t + 1e-9][-1] for t in time]
    return rows_to_dataset(rows, names, LAYOUT)


def leg(overshoot=0.0, final=0.0, standing=-0.05):
    """Up to 1 m, 2 m north past the waypoint by ``overshoot``, back to ``final`` off it, wait, down at 0.2 m/s."""
    knots = [
        (0, 0, 0, standing),
        (1, 0, 0, standing),
        (3, 0, 0, -1.0),
        (4, 0, 0, -1.0),
        (8, 2.0 + overshoot, 0, -1.0),
        (9, 2.0 + final, 0, -1.0),
        (12, 2.0 + final, 0, -1.0),
        (12 + (1.0 + standing) / 0.2, 2.0 + final, 0, standing),
        (18, 2.0 + final, 0, standing),
    ]
    states = [
        (0, "init"),
        (1, "take_off"),
        (3, "hover"),
        (4, "waypoint"),
        (9, "hover"),
        (12, "landing"),
        (17.5, "init"),
    ]
    return knots, states


GOAL = (2.0, 0.0, -1.0)


def test_a_perfect_flight():
    knots, states = leg()
    s = summarise_flight(flown(knots, states), [GOAL], take_off=(0, 0, -1), outcome="succeeded")
    top, first = s.waypoints
    assert (top.name, top.reached_s) == ("take-off", pytest.approx(3.0))
    assert (first.name, first.reached_s) == ("1", pytest.approx(9.0))
    assert first.distance_at_reach_m == pytest.approx(0.0, abs=1e-12)
    assert first.overshoot_m == pytest.approx(0.0, abs=1e-12)
    assert (s.waypoints_reached, s.waypoints_asked) == (1, 1)
    assert s.duration_s == pytest.approx(18.0)
    assert s.max_speed_m_s == pytest.approx(0.5)
    assert s.touchdown_speed_m_s == pytest.approx(0.2)
    assert s.landing_distance_m == pytest.approx(0.0, abs=1e-12)
    assert s.max_position_error_m == 0.0
    assert s.longest_railed_s == 0.0


def test_overshoot_is_what_lies_past_the_waypoint_along_the_leg():
    knots, states = leg(overshoot=0.07, final=-0.02)
    first = summarise_flight(flown(knots, states), [GOAL]).waypoints[0]
    assert first.overshoot_horizontal_m == pytest.approx(0.07)
    # Without a take-off point the leg starts on the ground, so there is a climb; nothing went past its top.
    assert first.overshoot_vertical_m == pytest.approx(0.0, abs=1e-12)
    assert first.overshoot_m == pytest.approx(0.07)
    assert first.distance_at_reach_m == pytest.approx(0.02)
    assert first.mean_error_in_wait_m == pytest.approx(0.02)
    assert first.farthest_after_reach_m == pytest.approx(0.02)


def test_overshoot_in_height_counts_while_the_leg_goes_on():
    knots, states = leg()
    knots = [(t, n, e, -1.5 if 8 <= t <= 12 else d) for t, n, e, d in knots]
    knots[4:4] = [(5, 0, 0, -1.54), (6, 0, 0, -1.5)]  # first up, 4 cm too far, then level
    first = summarise_flight(flown(knots, states), [(2.0, 0.0, -1.5)], take_off=(0, 0, -1)).waypoints[1]
    assert first.overshoot_vertical_m == pytest.approx(0.04)
    assert first.overshoot_horizontal_m == pytest.approx(0.0, abs=1e-12)
    assert first.overshoot_m == pytest.approx(0.04)


@pytest.mark.parametrize("turn", [0.3, 1.9, -2.4])
def test_nothing_changes_when_the_flight_is_turned_about_the_vertical(turn):
    knots, states = leg(overshoot=0.05, final=0.01)
    c, s = math.cos(turn), math.sin(turn)
    turned = [(t, c * n - s * e, s * n + c * e, d) for t, n, e, d in knots]
    goal = (c * GOAL[0] - s * GOAL[1], s * GOAL[0] + c * GOAL[1], GOAL[2])
    one = summarise_flight(flown(knots, states), [GOAL]).as_record()
    other = summarise_flight(flown(turned, states), [goal]).as_record()
    for key in ("overshoot_m", "distance_at_reach_m", "mean_error_in_wait_m", "reached_s"):
        assert other["waypoints"][0][key] == pytest.approx(one["waypoints"][0][key], abs=1e-12)
    for key in ("touchdown_speed_m_s", "landing_distance_m", "max_speed_m_s"):
        assert other[key] == pytest.approx(one[key], abs=1e-12)


def test_a_waypoint_that_was_not_reached_has_no_numbers():
    knots, states = leg()
    far = (5.0, 5.0, -1.0)
    s = summarise_flight(flown(knots, states), [GOAL, far], outcome="failed", reason="blocked")
    assert s.waypoints[1].reached_s is None
    assert s.waypoints[1].overshoot_m is None
    assert s.waypoints_reached == 1
    assert ("Waypoints reached", "1 of 2") in summary_rows(s)
    assert summary_rows(s)[0] == ("Outcome", "failed: blocked")


def test_a_waypoint_flown_through_without_a_stop_is_reached_when_it_is_near():
    knots, states = leg()
    through = (1.0, 0.0, -1.0)
    s = summarise_flight(flown(knots, states), [through, GOAL], reach_m=0.05)
    assert s.waypoints[0].reached_s == pytest.approx(4 + 2 * 0.95)
    assert s.waypoints[1].reached_s == pytest.approx(9.0)


def test_a_detour_around_an_obstacle_is_still_the_same_leg():
    knots, states = leg()
    states[4:4] = [(5, "obstacle"), (6, "waypoint")]
    assert summarise_flight(flown(knots, states), [GOAL]).waypoints[0].reached_s == pytest.approx(9.0)


def test_times_from_the_mission_come_first():
    knots, states = leg()
    # Also where they were added up in another order than those of the rows.
    for reached in (10.0, 10.0 * (1 - 1e-15), 10.0 * (1 + 1e-15)):
        first = summarise_flight(flown(knots, states), [GOAL], reached_s=[reached]).waypoints[0]
        assert first.reached_s == pytest.approx(10.0)
    # One that was reached as the recording ended.
    assert summarise_flight(flown(knots, states), [GOAL], reached_s=[18.5]).waypoints[0].reached_s == pytest.approx(
        18.0
    )


def test_the_square_of_the_thesis(flight):
    s = summarise_flight(flight.dataset(), flight.waypoints, flight.events, take_off=(0, 0, -1))
    assert s.waypoints_reached == 4
    reached = [w.reached_s for w in s.waypoints]
    expected = [event.time_s for event in flight.events if event.state == "hover"]
    assert reached == pytest.approx(expected, abs=0.021)
    assert all(a < b for a, b in pairwise(reached))


def test_touchdown_speed_sees_a_hard_landing():
    knots, states = leg()
    knots[-2] = (13.0, 2.0, 0.0, -0.05)
    assert summarise_flight(flown(knots, states), [GOAL]).touchdown_speed_m_s == pytest.approx(0.95)


def test_a_flight_that_ends_in_the_air_has_no_touchdown():
    knots, states = leg()
    s = summarise_flight(flown(knots[:7], states[:5]), [GOAL])
    assert s.touchdown_speed_m_s is None
    assert s.landing_distance_m is None


def test_railing_is_timed_in_the_air_only():
    knots, states = leg()
    motor = np.full((1801, 2), 0.7)
    motor[:50] = 0.0  # off, on the ground
    motor[600:612, 1] = 1.0
    motor[700:705, 0] = 0.0
    motor[1790:] = 0.0
    s = summarise_flight(flown(knots, states, motor_input=motor), [GOAL])
    assert s.longest_railed_s == pytest.approx(0.12)
    assert s.longest_railed_input == "motor_input lower"


@pytest.mark.parametrize(
    ("name", "column", "value"),
    [("motor_input", 0, 0.0), ("motor_input", 1, 1.0), ("servo_input", 0, -1.0), ("servo_input", 1, 1.0)],
)
def test_both_ends_of_an_input_are_rails(name, column, value):
    """Also where an input was stored in a way that rounds."""
    knots, states = leg()
    given = np.full((1801, 2), 0.3)
    given[500:530, column] = value * (1 - 1e-12)
    summary = summarise_flight(flown(knots, states, **{name: given}))
    assert summary.longest_railed_s == pytest.approx(0.3)
    assert summary.longest_railed_input.startswith(name)


@pytest.mark.parametrize("first", [True, False])
def test_the_longest_oscillation_of_a_flight_is_told(first):
    knots, states = leg()
    time = np.arange(1801) * STEP_S
    long, short = ((2.0, 9.0), (11.0, 15.0)) if first else ((8.0, 15.0), (2.0, 6.0))
    swinging = sum(((time > a) & (time < b)) for a, b in (long, short))
    servo = np.column_stack([0.9 * np.sin(math.tau * 2.0 * time) * swinging, np.zeros(1801)])
    summary = summarise_flight(flown(knots, states, servo_input=servo))
    assert summary.longest_oscillation_s == pytest.approx(7.0, abs=0.8)
    assert "servo_input 1 oscillates" in summary.longest_oscillation


def test_a_hop_of_one_instant_is_a_flight_too():
    knots, states = leg()
    position = np.tile([0.0, 0.0, -0.05], (1801, 1))
    position[900, 2] = -0.5
    summary = summarise_flight(flown(knots, states, truth_position=position))
    assert summary.max_tilt_deg == 0.0
    assert summary.longest_oscillation_s == 0.0


def test_tilt_combines_roll_and_pitch():
    knots, states = leg()
    attitude = np.zeros((1801, 3))
    attitude[600] = (math.radians(10), math.radians(20), 1.0)
    s = summarise_flight(flown(knots, states, truth_attitude=attitude))
    expected = math.degrees(math.acos(math.cos(math.radians(10)) * math.cos(math.radians(20))))
    assert s.max_tilt_deg == pytest.approx(expected)


def test_energy_is_voltage_times_current_over_time():
    knots, states = leg()
    s = summarise_flight(flown(knots, states, battery_voltage=7.5, battery_current=2.0, battery_charge=0.8))
    assert s.energy_used_J == pytest.approx(7.5 * 2.0 * 18.0)
    assert (s.battery_end_V, s.battery_end_charge) == (7.5, 0.8)


def test_what_is_unknown_is_none_and_json_can_hold_it():
    knots, states = leg()
    nan = np.nan
    data = flown(knots, states, battery_current=nan, battery_charge=nan, reference_position=nan)
    s = summarise_flight(data, [GOAL], [(1.0, "take-off", "start")], realtime_factor=80.0)
    assert s.energy_used_J is None
    assert s.battery_end_charge is None
    assert s.max_position_error_m is None
    content = json.loads(json.dumps(s.as_record(), allow_nan=False))
    assert content["events"] == [{"time_s": 1.0, "state": "take-off", "text": "start"}]
    assert content["waypoints"][0]["position_m"] == [2.0, 0.0, -1.0]
    labels = [label for label, _ in summary_rows(s)]
    assert "Energy used" not in labels
    assert ("Real-time factor", "80") in summary_rows(s)


def test_air_beyond_the_model_counts_the_vehicles_own_motion_and_tilt():
    """2.4 m/s of wind is within 2.6; flying against it at 0.5 m/s is not, and was not said."""
    knots, states = leg()

    def said(**columns):
        dataset = flown(knots, states, **columns)
        dataset.attrs["model_air_m_s"] = (0.8, 2.6)
        return summarise_flight(dataset).outside_model

    assert said(wind=(-2.4, 0, 0)).startswith(
        "the flight model was not valid for 26 % of the time in the air: its rotors met 2.9"
    )
    assert said(wind=(2.4, 0, 0)) == "" == said()
    assert "0.5 m/s across and 1.3 m/s along the mast, and hold up to 2.6 and 0.8" in said(wind=(0, 0, 0.8))
    assert "2.5 m/s along" in said(wind=(-2.0, 0, 0), truth_attitude=(0, math.pi / 2, 0))  # on its nose
    assert "2.0 m/s along" in said(wind=(0, -2.0, 0), truth_attitude=(math.pi / 2, 0, 0))  # on its side
    assert "2.0 m/s along" in said(wind=(0, -2.0, 0), truth_attitude=(0, math.pi / 2, math.pi / 2))  # nose to the east


def test_clearance_names_the_nearest_obstacle():
    knots, states = leg()
    world = World((Box((1.0, 1.0, -1.0), (1.0, 1.0, 2.0), name="crate"), Box((9, 9, -1), (1, 1, 2), name="far")))
    s = summarise_flight(flown(knots, states), [GOAL], world=world)
    assert s.least_clearance_m == pytest.approx(0.5)
    assert ("Least distance to an obstacle", "0.50 m (crate)") in summary_rows(s)
