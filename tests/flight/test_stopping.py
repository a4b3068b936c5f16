"""What is stopped stays stopped: requests that come with or right after a stop, sticks while rotors run down."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.flight import Autopilot, Flight, RequestAnswer, SetPoint
from mufly.mission import Mission, parse_mission
from mufly.vehicle import Vehicle, load_vehicle

VEHICLE: Vehicle = load_vehicle("mufly-1.1")
ROW = parse_mission({"waypoint": [{"position_m": [0.4 * k, 0.0, -0.6]} for k in range(1, 4)]})
UP = SetPoint(position_m=(0.0, 0.0, -0.6))


@pytest.fixture(scope="module")
def controller() -> FlightController:
    return design_flight_controller(VEHICLE)


@pytest.fixture
def flight(controller: FlightController) -> Flight:
    made = Flight(VEHICLE, ROW, controller=controller, keep=False)
    run(made, 0.05)
    return made


def run(
    flight: Flight,
    seconds: float,
    until: Callable[[], bool] = lambda: False,
    each: Callable[[], object] = lambda: None,
) -> bool:
    for _ in range(round(seconds / flight.period_s)):
        each()
        flight.step_period()
        if until():
            return True
    return False


def hovering(flight: Flight, height: float = 0.5) -> Autopilot:
    a = flight.autopilot
    assert a.arm()
    assert a.take_off(height)
    assert run(flight, 10.0, until=lambda: a.status.state == "hover")
    return a


def motors(flight: Flight) -> float:
    return float(np.abs(flight.status.actuators.input_array).max())


REQUESTS: list[Callable[[Autopilot], RequestAnswer]] = [
    lambda a: a.land(),
    lambda a: a.pause(),
    lambda a: a.go_to((0.5, 0.0, -0.5)),
    lambda a: a.return_home(),
    lambda a: a.turn_to(1.0),
    lambda a: a.start_mission(),
    lambda a: a.arm() and a.go_to((0.5, 0.0, -0.5)),
    lambda a: a.arm(force=True) and a.land(),
    lambda a: a.send_set_point(UP) and a.set_offboard(True),
]


@pytest.mark.parametrize("request_", REQUESTS)
def test_nothing_takes_the_place_of_a_stop(flight: Flight, request_: Callable[[Autopilot], RequestAnswer]) -> None:
    """Two stations may be heard between two steps: one stops it, the other asks for something else."""
    a = hovering(flight, 0.3)
    assert a.emergency_stop()
    answer = request_(a)
    assert not answer
    assert "stopped" in answer.reason
    run(flight, 2.0)
    assert (a.status.state, a.status.motors, a.status.armed) == ("init", "off", False)
    # Armed again it stands there with its motors off, until it is told to take off.
    if not a.status.crash_cause:
        first = a.arm()
        assert first or ("arm again" in first.reason and a.arm())  # a stop in the air asks for a second request
        run(flight, 0.5)
        assert motors(flight) == 0.0


def test_sticks_in_their_middle_do_not_start_rotors_that_run_down(flight: Flight) -> None:
    a = hovering(flight)
    assert a.land()
    assert run(flight, 20.0, until=lambda: a.status.motors == "ramp_down")
    run(flight, 0.3)
    before = motors(flight)
    highest = []
    run(flight, 3.0, each=lambda: (a.set_sticks(0.0, 0.0, 0.0, 0.0), highest.append(motors(flight))))
    assert max(highest) <= before
    assert motors(flight) == 0.0
    assert not a.status.armed
    assert a.status.state == "rc"
    assert a.status.outcome == "succeeded"


def test_sticks_while_rotors_speed_up_let_them_do_so(flight: Flight) -> None:
    a = flight.autopilot
    assert a.arm()
    assert a.take_off(0.5)
    run(flight, 0.5)
    run(flight, 1.0, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.0))
    assert (a.status.state, a.status.motors) == ("rc", "spin_up")
    assert run(flight, 4.0, until=lambda: a.status.flying, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.4))


def test_offboard_during_a_take_off_is_refused_rather_than_forgotten(flight: Flight) -> None:
    a = flight.autopilot
    assert a.arm()
    assert a.take_off(0.8)
    for seconds in (1.0, 2.4):  # rotors speed up; just off the floor
        run(flight, seconds)
        assert a.send_set_point(UP)
        answer = a.set_offboard(True)
        assert not answer
        assert answer.is_temporary
        assert "height of 0.2 m" in answer.reason
    assert run(flight, 6.0, until=lambda: flight.status.truth.position[2] < -0.35)
    assert a.send_set_point(UP)
    assert a.set_offboard(True)
    run(flight, 0.1)
    assert a.status.state == "offboard"


def test_a_mission_does_not_begin_from_set_points_that_have_not_lifted_it(flight: Flight) -> None:
    a = flight.autopilot
    assert a.arm()
    assert a.send_set_point(UP)
    assert a.set_offboard(True)
    run(flight, 1.0, each=lambda: a.send_set_point(UP))
    assert (a.status.state, a.status.motors) == ("offboard", "spin_up")
    assert not a.start_mission()
    run(flight, 1.0, each=lambda: a.send_set_point(UP))
    assert a.status.state == "offboard"


def test_another_first_waypoint_may_be_asked_for_during_the_take_off(flight: Flight) -> None:
    a = flight.autopilot
    assert a.arm()
    assert a.start_mission()
    run(flight, 3.5)
    assert a.start_mission(2)
    assert run(flight, 10.0, until=lambda: a.status.state == "waypoint")
    assert a.status.waypoint_index == 2


def test_a_failed_flight_takes_no_mission_instead_of_landing(flight: Flight) -> None:
    a = hovering(flight)
    software = a.software
    software.mission_state = replace(
        software.mission_state, outcome="failed", reason="no way around", hover_until_s=flight.time_s + 1.0
    )
    answer = a.load_mission(Mission(name="other"))
    assert not answer
    assert "the vehicle lands: no way around" in answer.reason
    assert run(flight, 15.0, until=lambda: not a.status.armed)


def test_a_clock_of_measurements_that_was_set_back_is_no_reason_not_to_arm(flight: Flight) -> None:
    a = flight.autopilot
    m = flight.status.estimate
    a.store_estimate(replace(m, time_s=1000.0))
    for k in range(1, 200):
        a.store_estimate(replace(m, time_s=k * flight.period_s))
    assert a.list_arming_faults() == []
    for _ in range(200):
        a.store_estimate(replace(m, time_s=3.0))
    assert "0.9 s old" in a.list_arming_faults()[0] or "1.0 s old" in a.list_arming_faults()[0]
    a.store_estimate(replace(m, time_s=float("nan")))
    assert "old" in a.list_arming_faults()[0]


def test_a_pilot_by_hand_is_told_of_a_low_battery(flight: Flight) -> None:
    a, events = hovering(flight), []
    a.listeners.append(events.append)
    run(flight, 0.2, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.0))
    flight.plant.state[20] = 0.04
    run(flight, 3.0, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.0))
    assert a.status.state == "rc"
    assert sum("battery low" in e.text and e.level == "warning" for e in events) == 1
    assert run(flight, 3.0, until=lambda: a.status.state == "landing")


def test_tipped_over_by_hand_stops_the_motors(flight: Flight) -> None:
    a = hovering(flight, 0.25)
    run(flight, 0.2, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.0))
    m = flight.status.estimate
    tipped = replace(m, time_s=m.time_s + 0.02, attitude=np.array([1.2, 0.0, 0.0]))
    for k in range(8):
        a.set_sticks(0.0, 0.0, 0.0, 0.0)
        sent = a.step(replace(tipped, time_s=m.time_s + 0.005 * (k + 1), rates=m.rates + k * 1e-6))
    assert (sent.input_array == 0.0).all()
    assert not a.status.armed
