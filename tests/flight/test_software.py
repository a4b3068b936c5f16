"""The flight software by itself, through `step`: user's signals, the pilot's sticks, replay, and bad measurements."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.dynamics import DrydenWind, initial_state, standing_height
from mufly.estimate import Estimate, IdealEstimator
from mufly.flight import Actuators, Controllers, FlightSoftware, SimulatedPlant
from mufly.flight.controllers import derive_trajectory_limits
from mufly.mission import Command, Mission, parse_mission
from mufly.sensors import make_ideal_sensors
from mufly.vehicle import Vehicle, load_vehicle
from mufly.world import World


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


MISSION = parse_mission({"waypoint": [{"position_m": [1.0, 0.0, -1.0], "wait_s": 60.0}]})
DOWN_SPEED = 5  # of the state of the flight model
NO_SIGNAL, START, LAND = Command(), Command(start=True), Command(land=True)


class Bench:
    """A plant and a flight software; `run` joins them for a while."""

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission = MISSION) -> None:
        air = DrydenWind(step_s=controller.period_s)
        state = initial_state(position=(0.0, 0.0, -standing_height(vehicle)))
        self.plant = SimulatedPlant(vehicle, World(), air, controller.rate_Hz, state)
        self.sensors, self.estimator = make_ideal_sensors(vehicle, World(), 8), IdealEstimator()
        self.software = FlightSoftware(vehicle, controller, mission)
        self.pending = Actuators.make_zero_inputs()
        self.seen: list[Estimate] = []
        self.given: list[Command] = []
        self.sent: list[np.ndarray] = []

    @property
    def height(self) -> float:
        return -float(self.plant.state[2])

    def run(
        self,
        seconds: float,
        command: Command | Callable[[float], Command] = NO_SIGNAL,
        spoil: Callable[[Estimate], Estimate] = lambda m: m,
        until: Callable[[], bool] = lambda: False,
    ) -> None:
        end = self.plant.time_s + seconds
        while self.plant.time_s < end - 1e-9 and not until():
            if self.plant.period_count % 8 == 0:
                self.plant.detect_collision()
            m = spoil(self.estimator.update(self.sensors.read(self.plant.truth)))
            c = command(m.time_s) if callable(command) else command
            actuators = self.software.step(m, c)
            self.seen.append(m)
            self.given.append(c)
            self.sent.append(actuators.input_array)
            self.plant.advance_period(self.pending)
            self.pending = actuators

    def take_off(self) -> None:
        self.run(0.02, START)
        self.run(15.0, until=lambda: self.software.mission_state.state == "hover")
        assert self.software.mission_state.state == "hover"
        assert self.height == pytest.approx(1.0, abs=0.05)

    def texts(self) -> str:
        return " | ".join(f"{e.state}: {e.text}" for e in self.software.mission_state.events)


@pytest.fixture
def bench(vehicle: Vehicle, controller: FlightController) -> Bench:
    return Bench(vehicle, controller)


def test_a_pilot_takes_off_steers_and_lets_go(bench: Bench) -> None:
    hands_off = Command(rc_active=True)
    bench.run(1.0, hands_off)
    assert bench.software.mission_state.state == "rc"
    assert np.all(np.array(bench.sent) == 0.0), "the rotors wait for the stick"
    bench.run(9.0, Command(rc_active=True, pilot_climb_rate=0.3))
    assert bench.height > 0.8
    bench.run(2.0, hands_off)
    held = bench.height
    bench.run(2.0, hands_off)
    assert bench.height == pytest.approx(held, abs=0.03)
    bench.run(1.5, Command(rc_active=True, pilot_pitch=-math.radians(3.0)))
    assert bench.plant.state[3] > 0.3, "nose down flies forward"
    bench.run(1.5, Command(rc_active=True, pilot_roll=math.radians(3.0)))
    assert bench.plant.state[4] > 0.3, "right wing down flies to the right"
    heading = float(bench.seen[-1].attitude[2])
    bench.run(2.0, Command(rc_active=True, pilot_yaw_rate=0.5))
    assert bench.seen[-1].attitude[2] - heading == pytest.approx(1.0, abs=0.15)
    bench.run(5.0)
    assert bench.software.mission_state.state == "hover"
    assert np.linalg.norm(bench.plant.state[3:6]) < 0.02
    bench.run(30.0, LAND, until=lambda: bench.software.mission_state.finished)
    assert bench.software.mission_state.state == "init"
    assert bench.height == pytest.approx(standing_height(load_vehicle("mufly-1.1")), abs=0.01)
    assert bench.plant.crash_cause == ""


def test_a_pilot_interrupts_a_mission_and_hands_it_back(bench: Bench) -> None:
    bench.take_off()
    bench.run(1.0, Command(rc_active=True))
    bench.run(3.0)
    assert bench.software.mission_state.state == "hover"
    bench.run(0.02, START)
    bench.run(20.0, until=lambda: "waypoint 1 reached" in bench.texts())
    assert bench.plant.state[0] == pytest.approx(1.0, abs=0.05)


def test_spins_up_to_a_little_less_than_it_takes_to_lift_off(bench: Bench, controller: FlightController) -> None:
    bench.run(0.02, START)
    bench.run(2.9)
    volts = np.array([u[:2] * m.battery_voltage for u, m in zip(bench.sent, bench.seen, strict=True)])
    # It rises evenly, and for the latter half the slow upper rotor has time to follow.
    np.testing.assert_allclose(volts[len(volts) // 4] / volts[-1], 0.5, atol=0.03)
    np.testing.assert_allclose(volts[int(0.45 * len(volts))] / volts[-1], 0.9, atol=0.04)
    np.testing.assert_allclose(
        volts[int(0.53 * len(volts)) :],
        np.broadcast_to(volts[-1], volts[int(0.53 * len(volts)) :].shape),
        rtol=1e-6,
    )
    volts = volts[-1]
    np.testing.assert_allclose(volts, 0.9 * controller.motor_trim * controller.voltage_V, rtol=1e-6)
    assert bench.height == pytest.approx(standing_height(load_vehicle("mufly-1.1")), abs=3e-3), "legs unload, no more"


def test_on_its_legs_the_servos_stay_neutral(bench: Bench) -> None:
    """A slope, or a biased attitude, cannot be steered away there; trying to would wind the integrators up."""

    def leaning(m: Estimate) -> Estimate:
        return replace(m, attitude=m.attitude + np.array([0.05, 0.0, 0.0]))

    floor = bench.height
    bench.run(0.02, START)
    bench.run(8.0, spoil=leaning, until=lambda: bench.height > floor + 0.019)
    assert bench.height > floor + 0.019
    assert np.all(np.array(bench.sent)[:, 2:] == 0.0)
    bench.run(0.5)
    assert np.any(np.array(bench.sent)[:, 2:] != 0.0)


def test_between_steps_of_the_mission_the_reference_moves_on(
    bench: Bench, controller: FlightController, monkeypatch
) -> None:
    followed, shown, cascade = [], [], []
    step, compute_tilt_command = Controllers.step, Controllers.compute_tilt_command

    def spy(self, measured, heave_yaw, tilt):
        followed.append(heave_yaw)
        return step(self, measured, heave_yaw, tilt)

    def count(self, *arguments):
        cascade.append(len(followed))
        return compute_tilt_command(self, *arguments)

    monkeypatch.setattr(Controllers, "step", spy)
    monkeypatch.setattr(Controllers, "compute_tilt_command", count)
    assert not bench.software.flying
    bench.run(0.02, START)
    bench.run(4.9, until=lambda: shown.append(bench.software.reference) and False)
    shown.append(bench.software.reference)
    assert bench.software.flying
    z, _, speed, _ = np.array(followed).T
    climbing = np.abs(speed[:-1]) > 0.1
    assert climbing.sum() > 20
    moved = np.diff(z)[climbing] / controller.period_s
    np.testing.assert_allclose(moved, speed[:-1][climbing], atol=0.02)
    # What is shown is what is followed, and the position cascade keeps to the rate that it was designed for.
    np.testing.assert_allclose([position[2] for position, *_ in shown][-len(z) :], z)
    assert set(np.diff(cascade)) == {controller.position_divider}


def test_users_waypoint_is_flown_to_and_held(bench: Bench) -> None:
    bench.take_off()
    bench.run(0.02, Command(waypoint=(0.0, -1.0, -0.6)))
    bench.run(20.0)
    assert bench.software.mission_state.state == "hover"
    np.testing.assert_allclose(bench.plant.state[0:3], [0.0, -1.0, -0.6], atol=0.02)
    bench.run(0.1, Command(waypoint=(0.0, 0.0, 0.5)))
    assert "refused" in bench.texts()
    bench.run(2.0)
    np.testing.assert_allclose(bench.plant.state[0:3], [0.0, -1.0, -0.6], atol=0.02)


def test_lands_on_the_signal_and_flies_again(bench: Bench) -> None:
    bench.take_off()
    bench.run(0.02, LAND)
    bench.run(20.0, until=lambda: bench.software.mission_state.finished)
    s = bench.software.mission_state
    assert (s.outcome, s.reason) == (
        "failed",
        "land signal with 1 waypoint to go",
    )
    assert np.all(bench.sent[-1] == 0.0)
    assert not bench.software.flying
    bench.take_off()
    assert bench.software.mission_state.outcome == ""
    assert bench.plant.crash_cause == ""


def test_the_same_measurements_give_the_same_actuators(vehicle: Vehicle, controller: FlightController) -> None:
    flown = Bench(vehicle, controller)
    flown.take_off()
    flown.run(6.0, Command(waypoint=(0.5, 0.5, -0.8)))
    flown.run(1.0, Command(rc_active=True, pilot_roll=0.05))
    again = FlightSoftware(vehicle, controller, MISSION)
    sent = [again.step(m, c).input_array for m, c in zip(flown.seen, flown.given, strict=True)]
    np.testing.assert_array_equal(sent, flown.sent)


NAN = np.full(3, math.nan)


def _without(name: str) -> Callable[[Estimate], Estimate]:
    return lambda m: replace(m, **{name: NAN})


@pytest.mark.parametrize("name", ["position", "velocity", "attitude", "rates"])
def test_a_short_gap_is_bridged(bench: Bench, name: str) -> None:
    bench.take_off()
    bench.run(0.3, spoil=_without(name))
    bench.run(4.0)
    assert bench.software.mission_state.state in ("hover", "waypoint")
    assert np.all(np.isfinite(bench.sent))
    away = bench.plant.state[0:3] - bench.software.reference[0]
    assert np.linalg.norm(away) < 0.05


def _freezer() -> Callable[[Estimate], Estimate]:
    first: list[Estimate] = []

    def freeze(m: Estimate) -> Estimate:
        first.append(m)
        return replace(first[0], time_s=m.time_s)

    return freeze


@pytest.mark.parametrize("spoil", [*map(_without, ["position", "velocity", "attitude", "rates"]), _freezer()])
def test_lost_for_good_it_comes_down_without_railing(bench: Bench, spoil) -> None:
    bench.take_off()
    bench.run(0.5)
    lost_at = len(bench.sent)
    touchdown = []

    def down() -> bool:
        if not touchdown and bench.height < 0.075:
            touchdown.append(float(np.linalg.norm(bench.plant.state[3:6])))
        return bench.software.mission_state.finished

    bench.run(20.0, spoil=spoil, until=down)
    sent = np.array(bench.sent[lost_at:])
    assert np.all(np.isfinite(sent))
    assert np.abs(sent[:, :2]).max() < 0.95
    assert np.abs(sent[:, 2:]).max() < 0.5
    assert bench.software.mission_state.outcome == "failed"
    assert "measurement lost" in bench.software.mission_state.reason
    assert bench.plant.crash_cause == ""
    assert touchdown[0] < 1.5
    np.testing.assert_array_equal(sent[-1], 0.0)


def test_what_it_does_not_need_may_be_missing(bench: Bench) -> None:
    def spoil(m: Estimate) -> Estimate:
        return replace(m, ranges=np.full_like(m.ranges, math.nan), battery_voltage=math.nan)

    bench.take_off()
    bench.run(12.0, spoil=spoil)
    assert "waypoint 1 reached" in bench.texts()


def test_does_not_leave_the_floor_without_measurements(bench: Bench) -> None:
    bench.run(0.02, START)
    bench.run(0.5)
    bench.run(10.0, spoil=_without("position"), until=lambda: bench.software.mission_state.finished)
    assert bench.software.mission_state.outcome == "failed"
    assert bench.height < 0.08


def test_a_mission_is_flown_no_faster_than_the_controllers_can(vehicle: Vehicle, controller: FlightController) -> None:
    hasty = parse_mission(
        {
            "waypoint": [{"position_m": [0.0, 0.0, -4.0], "wait_s": 60.0}],
            "limits": {"climb_m_s": 2.0, "climb_acceleration_m_s2": 2.0},
        }
    )
    bench = Bench(vehicle, controller, hasty)
    assert "climb_m_s 0.8 in place of 2" in bench.software.slowdown_note
    bench.take_off()
    top = 0.0
    while bench.plant.time_s < 25.0:
        bench.run(0.05)
        top = max(top, bench.height)
    assert top < 4.03
    assert "waypoint 1 reached" in bench.texts()


def test_a_mission_within_its_limits_is_left_alone(vehicle: Vehicle, controller: FlightController) -> None:
    assert FlightSoftware(vehicle, controller, MISSION).slowdown_note == ""
    assert derive_trajectory_limits(controller).climb_acceleration > 0.5


@pytest.mark.parametrize("blow_m_s", [-3.0, -1.25, 1.25, 2.5])
def test_a_hover_survives_a_vertical_blow(vehicle: Vehicle, controller: FlightController, blow_m_s: float) -> None:
    """Also where the reference does not wait for the height: its integrator follows the motors that rail."""
    high = parse_mission(
        {"take_off": {"height_m": 3.0, "wait_s": 60.0}, "waypoint": [{"position_m": [1.0, 0.0, -3.0]}]}
    )
    stands = []
    for slack in (float(controller.heave_yaw_gains["heave_tracking_error_limit"]), math.inf):
        gains = controller.heave_yaw_gains.copy()
        gains["heave_tracking_error_limit"] = slack
        bench = Bench(vehicle, replace(controller, heave_yaw_gains=gains), high)
        bench.run(0.02, START)
        bench.run(20.0, until=lambda bench=bench: bench.software.mission_state.state == "hover")
        bench.run(2.0)
        bench.plant.state[DOWN_SPEED] += blow_m_s
        bench.run(12.0)
        before = len(bench.seen)
        bench.run(2.0)
        heights = [m.position[2] for m in bench.seen[before:]]
        stands.append(max(heights) - min(heights) < 0.1)
    assert stands == [True, True]
