"""What may be asked of the autopilot, when it is refused, and what becomes of it: on the simulated helicopter."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import quaternion_from_euler
from mufly.estimate import Estimate
from mufly.flight import Flight, SetPoint
from mufly.flight.arming import BATTERY_MARGIN_V, find_arming_faults
from mufly.flight.autopilot import DISARM_WITHOUT_TAKE_OFF_S, SET_POINT_TIMEOUT_S, STICKS_TIMEOUT_S
from mufly.mission import Mission, load_mission, parse_mission
from mufly.vehicle import Vehicle, load_vehicle
from mufly.world import World


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


HOP = parse_mission(
    {
        "name": "hop",
        "take_off": {"height_m": 0.6, "wait_s": 0.2},
        "waypoint": [{"position_m": [0.4, 0.0, -0.6]}, {"position_m": [0.4, 0.4, -0.6]}],
    }
)


class Pilot:
    """A flight and somebody who runs it."""

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission = HOP) -> None:
        self.flight = Flight(vehicle, mission, controller=controller, keep=False)
        self.autopilot = self.flight.autopilot
        self.sent: list[np.ndarray] = []
        self.texts: list[str] = []
        self.autopilot.listeners.append(lambda e: self.texts.append(e.text))
        self.run(0.05)

    def run(
        self,
        seconds: float,
        until: Callable[[], bool] = lambda: False,
        each: Callable[[], object] | None = None,
    ) -> None:
        end = self.flight.time_s + seconds
        while self.flight.time_s < end - 1e-9 and not until():
            if each is not None:
                each()
            self.flight.step_period()
            self.sent.append(self.flight.status.actuators.input_array)

    def fly_to(self, state: str, seconds: float = 20.0) -> None:
        self.run(seconds, until=lambda: self.autopilot.status.state == state)
        assert self.autopilot.status.state == state

    def take_off(self, height: float | None = None) -> None:
        assert self.autopilot.arm()
        assert self.autopilot.take_off(height)
        self.fly_to("hover")

    @property
    def position(self) -> np.ndarray:
        return self.flight.status.truth.position


@pytest.fixture
def pilot(vehicle: Vehicle, controller: FlightController) -> Pilot:
    return Pilot(vehicle, controller)


def test_nothing_happens_unarmed(pilot: Pilot) -> None:
    a = pilot.autopilot
    for answer in (a.take_off(), a.start_mission()):
        assert not answer
        assert answer.reason == "not armed; arm first"
        assert answer.is_temporary
    for answer in (a.go_to((1.0, 0.0, -1.0)), a.land(), a.pause(), a.return_home(), a.turn_to(1.0)):
        assert not answer
        assert answer.reason == "the vehicle does not fly; take off first"
    pilot.run(1.0)
    assert np.all(np.array(pilot.sent) == 0.0)
    assert a.status.home_position is None


def test_takes_off_to_the_parameter_s_height_hovers_and_lands(pilot: Pilot) -> None:
    a = pilot.autopilot
    assert a.set_parameter("MIS_TAKEOFF_ALT", 0.9)
    pilot.take_off()
    s = a.status
    assert (s.armed, s.flying, s.user_in_control, s.mission_running) == (True, True, True, False)
    assert pilot.position[2] == pytest.approx(-0.9, abs=0.06)
    assert s.home_position == pytest.approx((0.0, 0.0, s.home_position[2]))
    pilot.run(2.0)
    assert a.land()
    assert a.land(), "asked twice"
    pilot.run(20.0, until=lambda: pilot.position[2] > -0.075)
    pilot.run(0.3)
    s = a.status
    assert (s.state, s.motors, s.flying) == ("landing", "fly", False), "on its legs, before the rotors stop"
    pilot.fly_to("init")
    pilot.run(0.1)
    s = a.status
    assert (s.armed, s.flying, s.outcome, s.reason) == (False, False, "succeeded", "landed")
    pilot.run(1.0)
    assert np.all(np.array(pilot.sent[-100:]) == 0.0)


@pytest.mark.parametrize("height", [0.1, 51.0, -1.0, math.nan, math.inf])
def test_an_absurd_height_is_refused_for_good(pilot: Pilot, height: float) -> None:
    pilot.autopilot.arm()
    answer = pilot.autopilot.take_off(height)
    assert not answer
    assert not answer.is_temporary
    assert "give 0.2 to 50 m" in answer.reason


def test_flies_the_mission_paused_and_resumed(pilot: Pilot) -> None:
    a = pilot.autopilot
    assert a.arm()
    assert a.start_mission()
    pilot.fly_to("waypoint")
    assert a.status.mission_running
    pilot.run(1.0)
    assert not a.load_mission(HOP), "while it is flown"
    assert a.pause()
    pilot.fly_to("hover")
    assert not a.status.mission_running
    pilot.run(2.0)
    assert a.start_mission()
    pilot.run(30.0, until=lambda: not a.status.armed)
    s = a.status
    assert (s.outcome, s.reason, s.reached_waypoint_count, s.waypoint_index) == ("succeeded", "mission complete", 2, 2)
    assert sum("waypoint 1 reached" in t for t in pilot.texts) == 1


def test_the_mission_can_begin_elsewhere(pilot: Pilot) -> None:
    a = pilot.autopilot
    assert not a.start_mission(2)
    assert a.arm()
    assert a.start_mission(1)
    pilot.run(30.0, until=lambda: not a.status.armed)
    assert "waypoint 1" not in pilot.texts
    assert "waypoint 2" in pilot.texts
    assert a.status.outcome == "succeeded"


def test_goes_turns_and_returns(pilot: Pilot) -> None:
    a = pilot.autopilot
    pilot.take_off(0.6)
    # On the floor it is what is less than 5 cm above where it stood and hardly moves.
    held, stood = pilot.autopilot._estimate, pilot.autopilot.software.mission_state.home_position[2]
    for height, speed, flies in (
        (0.055, 0.0, True),
        (0.045, 0.0, False),
        (0.045, 0.12, True),
        (0.045, 0.08, False),
    ):
        place, velocity = np.array([0.0, 0.0, stood - height]), np.array([0.0, speed, 0.0])
        pilot.autopilot._estimate = replace(held, position=place, velocity=velocity)
        assert pilot.autopilot.status.flying == flies, (height, speed)
    pilot.autopilot._estimate = held
    assert a.go_to((0.5, 0.2, -0.8), heading_rad=0.5)
    pilot.run(15.0, until=lambda: any("waypoint reached" in t for t in pilot.texts) or a.status.state == "hover")
    pilot.run(8.0)
    np.testing.assert_allclose(pilot.position, (0.5, 0.2, -0.8), atol=0.03)
    assert pilot.flight.status.truth.attitude[2] == pytest.approx(0.5, abs=0.03)
    assert a.turn_to(-1.0)
    pilot.run(5.0)
    assert pilot.flight.status.truth.attitude[2] == pytest.approx(-1.0, abs=0.03)
    assert a.return_home()
    pilot.run(0.1)
    assert a.status.returning_home
    pilot.run(25.0, until=lambda: not a.status.armed)
    np.testing.assert_allclose(pilot.position[:2], (0.0, 0.0), atol=0.05)
    assert a.status.reason == "landed"


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ((0.0, 0.0, 0.5), "D has to be at most -0.2 m"),
        ((math.nan, 0.0, -1.0), "D has to be at most"),
        ((0.0, 0.0, -60.0), "too far away"),
        ((1e6, 0.0, -1.0), "too far away"),
        ((1.0, 2.0), "three numbers"),
    ],
)
def test_impossible_places_are_refused(pilot: Pilot, place, words: str) -> None:
    answer = pilot.autopilot.go_to(place)
    assert not answer
    assert not answer.is_temporary
    assert words in answer.reason


def test_places_beside_what_is_known_are_refused(vehicle: Vehicle, controller: FlightController) -> None:
    boxed = load_mission("box-on-leg")
    a = Pilot(vehicle, controller, boxed).autopilot
    crate = boxed.box[0]
    answer = a.go_to(crate.centre_m)
    assert "crate; keep 0.39 m from it" in answer.reason
    room = parse_mission(
        {
            "waypoint": [{"position_m": [0.0, 0.0, -1.0]}],
            "room": {"north_m": [-2, 2], "east_m": [-2, 2], "height_m": 2.0},
        }
    )
    a = Pilot(vehicle, controller, room).autopilot
    assert a.arm()
    assert "ceiling" in a.take_off(1.9).reason
    assert a.take_off(1.5)


def test_disarming_and_stopping(pilot: Pilot) -> None:
    a = pilot.autopilot
    assert a.arm()
    assert a.disarm()
    assert not a.status.armed
    assert pilot.texts[-2:] == ["armed", "disarmed"]
    assert a.arm()
    assert a.start_mission()
    pilot.run(1.5)
    assert a.status.motors == "spin_up"
    assert a.disarm(), "on the floor it may"
    pilot.run(0.02)
    assert np.all(pilot.flight.status.actuators.input_array == 0.0)
    assert a.status.outcome == "failed"
    pilot.take_off()
    answer = a.disarm()
    assert answer.reason == "the vehicle flies; land first, or disarm with force"
    assert a.disarm(force=True)
    n = len(pilot.sent)
    pilot.run(0.1)
    # One period until it is computed, one until it acts.
    assert np.all(np.array(pilot.sent[n + 2 :]) == 0.0)
    assert not a.status.armed
    assert a.status.reason == "emergency stop, motors off"


def test_disarms_when_it_is_not_used(pilot: Pilot) -> None:
    assert pilot.autopilot.arm()
    pilot.run(DISARM_WITHOUT_TAKE_OFF_S - 0.5)
    assert pilot.autopilot.status.armed
    pilot.run(1.0)
    assert not pilot.autopilot.status.armed
    assert pilot.texts[-1] == "disarmed: no take-off within 10 s"


# arming rules


def standing() -> Estimate:
    z = np.zeros(3)
    return Estimate(1.0, np.array([0.0, 0.0, -0.07]), z, z, z, np.full(8, 1.5), 8.2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"battery_voltage": 6.0},
            "battery low: 6.00 V at rest; flights end at 6.00 V; charge the battery to 6.20 V",
        ),
        ({"battery_voltage": math.nan}, "battery voltage not measured"),
        (
            {"attitude": np.array([0.3, 0.0, 0.0])},
            "stands tilted 17.2 degrees; limit 6; set the vehicle on level ground, or check the accelerometers",
        ),
        (
            {"attitude": np.radians([0.0, -11.0, 90.0])},
            "stands tilted 11.0 degrees; limit 6; set the vehicle on level ground, or check the accelerometers",
        ),
        ({"velocity": np.array([0.0, 0.5, 0.0])}, "the vehicle is moving"),
        ({"rates": np.array([0.0, 0.0, 1.0])}, "the vehicle is moving"),
        ({"position": np.array([math.nan, 0.0, 0.0])}, "position not measured; check the sensors"),
        (
            {"position": np.array([0.0, 0.0, math.inf]), "rates": np.full(3, math.nan)},
            "position and rates not",
        ),
    ],
)
def test_every_reason_not_to_arm(change, words: str) -> None:
    m = standing()
    assert find_arming_faults(m, 0.0, 6.0, World(), 0.09, "") == []
    why = find_arming_faults(replace(m, **change), 0.0, 6.0, World(), 0.09, "")
    assert len(why) == 1
    assert words in why[0]


def test_a_slope_of_4_degrees_is_level_enough() -> None:
    assert (
        find_arming_faults(replace(standing(), attitude=np.radians([3.0, -3.0, 90.0])), 0.0, 6.0, World(), 0.09, "")
        == []
    )


def test_carried_about_it_does_not_fly(pilot: Pilot) -> None:
    m = pilot.flight.status.estimate
    pilot.autopilot.store_estimate(replace(m, time_s=m.time_s + 0.005, position=np.array([0.0, 0.0, -1.0])))
    assert not pilot.autopilot.status.flying


def test_a_mission_is_taken_where_the_position_is_not_known_yet(pilot: Pilot) -> None:
    m = pilot.flight.status.estimate
    lost = np.full(3, math.nan)
    pilot.autopilot.store_estimate(replace(m, time_s=m.time_s + 0.005, position=lost, attitude=lost))
    assert pilot.autopilot.load_mission(HOP)


def test_arming_needs_measurements_that_are_fresh() -> None:
    assert "wait a moment" in find_arming_faults(None, 0.0, 6.0, World(), 0.09, "")[0]
    assert "1.2 s old" in find_arming_faults(standing(), 1.2, 6.0, World(), 0.09, "")[0]
    assert "reset the vehicle first" in find_arming_faults(standing(), 0.0, 6.0, World(), 0.09, "hit a wall")[0]


def test_arming_needs_room_and_a_mission_that_suits(vehicle: Vehicle, controller: FlightController) -> None:
    a = Pilot(vehicle, controller, load_mission("box-on-leg")).autopilot
    assert a.list_arming_faults() == []
    m = a.status.estimate
    beside = np.array([*load_mission("box-on-leg").box[0].centre_m[:2], -0.07])
    a.store_estimate(replace(m, time_s=m.time_s + 0.005, position=beside))
    why = a.list_arming_faults()
    assert "in or beyond the crate" in why[0]
    assert "the take-off passes" in why[1]
    answer = a.arm()
    assert answer.is_temporary
    assert answer.reason.endswith("(and 1 more)")


def test_a_used_battery_is_not_armed_with(pilot: Pilot) -> None:
    a = pilot.autopilot
    volts = pilot.flight.status.truth.battery_voltage_V
    pilot.flight.plant.state[20] = 0.0
    pilot.run(0.1)
    empty = pilot.flight.status.truth.battery_voltage_V
    assert empty < volts - 1.0
    assert a.set_parameter("BAT_LOW_V", round(empty - 0.5 * BATTERY_MARGIN_V, 3))
    assert "battery low" in a.arm().reason
    assert "more)" not in a.arm().reason
    assert a.set_parameter("BAT_LOW_V", round(empty - 1.5 * BATTERY_MARGIN_V, 3))
    assert a.arm()


# set-points and sticks


def test_offboard_needs_a_stream_and_hovers_without(pilot: Pilot) -> None:
    a = pilot.autopilot
    pilot.take_off(0.6)
    assert "stream them first" in a.set_offboard(True).reason

    def stream() -> None:
        assert a.send_set_point(SetPoint(velocity_m_s=(0.3, 0.0, 0.0)))

    stream()
    assert a.set_offboard(True)
    pilot.run(4.0, each=stream)
    assert a.status.state == "offboard"
    assert pilot.flight.status.truth.velocity[0] == pytest.approx(0.3, abs=0.03)
    assert a.set_offboard(False)
    pilot.run(0.02)
    assert (a.status.state, a.status.offboard_active) == ("hover", False)
    assert a.send_set_point(SetPoint(velocity_m_s=(0.3, 0.0, 0.0)))
    assert a.set_offboard(True)
    pilot.run(2.0, each=stream)
    pilot.run(SET_POINT_TIMEOUT_S + 0.05)
    assert a.status.state == "hover"
    assert not a.status.offboard_active
    assert "set-points lost: no message for 0.5 s" in pilot.texts
    pilot.run(3.0)
    assert np.linalg.norm(pilot.flight.status.truth.velocity) < 0.02


def test_offboard_flies_a_square_from_the_floor(pilot: Pilot) -> None:
    a = pilot.autopilot
    corners = [(0.0, 0.0, -0.6), (0.5, 0.0, -0.6), (0.5, 0.5, -0.6), (0.0, 0.5, -0.6), (0.0, 0.0, -0.6)]
    a.send_set_point(SetPoint(position_m=corners[0]))
    assert a.set_offboard(True)
    pilot.run(0.2, each=lambda: a.send_set_point(SetPoint(position_m=corners[0])))
    assert np.all(np.array(pilot.sent) == 0.0), "not armed yet"
    assert a.arm()
    for k, corner in enumerate(corners):
        pilot.run(9.0 if k == 0 else 6.0, each=lambda c=corner: a.send_set_point(SetPoint(position_m=c)))
        np.testing.assert_allclose(pilot.position, corner, atol=0.04)
    assert a.land()
    pilot.run(15.0, until=lambda: not a.status.armed)
    assert a.status.outcome == "succeeded"


@pytest.mark.parametrize(
    "s", [SetPoint(), SetPoint(position_m=(math.inf, 0.0, -1.0)), SetPoint(velocity_m_s=(1e9, 0.0, 0.0))]
)
def test_absurd_set_points_are_refused(pilot: Pilot, s: SetPoint) -> None:
    answer = pilot.autopilot.send_set_point(s)
    assert answer.reason.startswith("set-point refused: ")
    assert not pilot.autopilot.set_offboard(True)


def test_sticks_fly_and_are_missed(pilot: Pilot) -> None:
    a = pilot.autopilot
    pilot.run(1.0, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.3))
    assert a.status.state == "rc"
    assert np.all(np.array(pilot.sent) == 0.0), "unarmed"
    assert a.arm().reason == "the climb stick is up; lower it first"
    assert a.set_sticks(0.0, 0.0, 0.0, 0.0)
    assert a.arm()
    pilot.run(8.0, each=lambda: a.set_sticks(0.0, 0.0, 0.0, 0.3))
    assert -pilot.position[2] > 0.5
    assert "release the sticks" in a.land().reason
    pilot.run(STICKS_TIMEOUT_S + 0.1)
    assert a.status.state == "hover"
    assert "sticks lost: no message for 1 s" in pilot.texts
    assert a.set_sticks(9.0, -9.0, 9.0, -9.0)
    assert a.release_sticks()
    assert not a.set_sticks(math.nan, 0.0, 0.0, 0.0)
    assert a.land()
    pilot.run(20.0, until=lambda: not a.status.armed)
    assert a.status.outcome == "succeeded"


def test_sticks_are_limited_by_their_parameters(pilot: Pilot) -> None:
    a = pilot.autopilot
    pilot.take_off(0.6)
    assert a.set_parameter("STK_TILT", 2.0)
    pilot.run(0.5, each=lambda: a.set_sticks(1.0, 0.0, 0.0, 0.0))
    assert pilot.flight.status.reference_attitude[0] == pytest.approx(math.radians(2.0))


# missions


def test_a_mission_is_taken_whole_or_not_at_all(pilot: Pilot) -> None:
    a = pilot.autopilot
    low = Mission(waypoint=({"position_m": (1.0, 0.0, -0.1)},))
    answer = a.load_mission(low)
    assert "too low to fly" in answer.reason
    far = parse_mission({"waypoint": [{"position_m": [900.0, 0.0, -1.0]}]})
    assert "out of reach" in a.load_mission(far).reason
    assert a.status.mission.waypoint == HOP.waypoint
    other = parse_mission({"name": "other", "waypoint": [{"position_m": [0.3, 0.0, -0.5]}]})
    assert a.load_mission(other)
    assert a.status.mission is other
    pilot.take_off(0.5)
    assert a.load_mission(HOP), "in a hover without mission"
    assert a.start_mission(1)
    assert "repeat the request" in a.load_mission(other).reason, "it might not have that waypoint"
    pilot.run(40.0, until=lambda: not a.status.armed)
    assert a.status.reached_waypoint_count == 1
    assert "hop: 2 waypoints loaded" in pilot.texts


def test_without_waypoints_there_is_no_mission_to_start(vehicle: Vehicle, controller: FlightController) -> None:
    pilot = Pilot(vehicle, controller, Mission(name="none"))
    a = pilot.autopilot
    assert a.arm()
    assert a.start_mission().reason == "no mission loaded; load one first"
    pilot.take_off(0.5)
    assert a.land()
    pilot.run(20.0, until=lambda: not a.status.armed)
    assert a.status.outcome == "succeeded"


def test_a_take_off_breaks_off_for_land_and_waits_for_go_to(pilot: Pilot) -> None:
    a = pilot.autopilot
    a.arm()
    a.take_off(0.6)
    pilot.run(1.0)
    assert "wait for a height" in a.go_to((0.3, 0.0, -0.6)).reason
    assert a.land()
    pilot.run(0.1)
    assert (a.status.state, a.status.motors) == ("init", "ramp_down")
    assert a.emergency_stop(), "rotors that run down are stopped too"
    pilot.run(0.02)
    assert a.status.motors == "off"
    pilot.run(2.0)
    assert not a.status.armed
    assert np.all(np.array(pilot.sent[-10:]) == 0.0)


# reset, events


def test_a_crash_is_final_until_the_simulation_is_reset(pilot: Pilot) -> None:
    a, plant = pilot.autopilot, pilot.flight.plant
    pilot.take_off(0.6)
    plant.state[6:10] = quaternion_from_euler(math.pi, 0.0, 0.0)  # somebody turned it over
    pilot.run(5.0)
    assert "tipped over" in a.status.crash_cause
    assert not a.status.armed
    assert np.all(np.array(pilot.sent[-10:]) == 0.0)
    assert "reset the vehicle first" in a.arm().reason
    before = pilot.flight.time_s
    pilot.flight.reset()
    pilot.run(0.1)
    assert pilot.flight.time_s > before
    assert a.status.crash_cause == ""
    assert a.status.state == "init"
    pilot.take_off(0.6)
    np.testing.assert_allclose(pilot.position, (0.0, 0.0, -0.6), atol=0.06)


def test_thousands_of_requests_leave_no_trace_in_memory(pilot: Pilot) -> None:
    a = pilot.autopilot
    pilot.take_off(0.6)
    for k in range(600):
        _ = a.pause() if k % 2 else a.go_to((0.5, 0.0, -0.6))
        pilot.run(0.02)
    s = a.software.mission_state
    assert s.logged_event_count > 600
    assert len(s.events) <= 256
