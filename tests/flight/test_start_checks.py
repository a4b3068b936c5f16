"""Checks before the motors start: estimate, measured tilt, charge, an interrupted flight; in Python and in C."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mufly.control import FlightController, design_flight_controller
from mufly.drive import find_charge_from_idle_voltage, open_circuit_voltage
from mufly.dynamics import body_to_ned_matrix, quaternion_from_euler, standing_height
from mufly.dynamics.model_state import MODEL_CHARGE
from mufly.estimate import AuxiliaryStates, Estimate, compute_standing_tilt
from mufly.firmware import FirmwareSoftware, GenericFirmwareSoftware
from mufly.flight import Flight
from mufly.flight.arming import find_arming_faults
from mufly.flight.flight_software import FlightSoftware
from mufly.flight.mission_flight import await_estimate_and_start
from mufly.mission import Command, Mission, SetPoint, parse_mission
from mufly.sensors import parse_fault
from mufly.vehicle import Vehicle, load_vehicle
from mufly.world import World

HOP = parse_mission({"name": "hop", "waypoint": [{"position_m": [0.4, 0.0, -0.6]}]})
STARTS = (
    Command(start=True),
    Command(take_off_height=1.0),
    Command(rc_active=True, pilot_climb_rate=0.5),
    Command(program_set_point=SetPoint((0.0, 0.0, -1.0))),
)


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("mufly-2.0")


@pytest.fixture(scope="module")
def controller(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle)


def standing(t: float, *, valid: bool = True, lean_deg: float = 0.0, force_deg: float = 0.0) -> Estimate:
    z, lean = np.zeros(3), math.radians(force_deg)
    force = np.array([0.0, -9.81 * math.sin(lean), -9.81 * math.cos(lean)])
    beliefs = AuxiliaryStates(z, z, 0.0, np.zeros(4), np.zeros(2), 1.0, z, (), force)
    attitude = np.array([0.0, math.radians(lean_deg), 0.0])
    place = np.array([0.0, 0.0, -0.07 - 1e-6 * t])  # one that is repeated to the last bit is frozen
    covariance = 1e-6 * np.eye(12)
    return Estimate(t, place, z, attitude, z, np.full(8, 1.5), 8.2, covariance, valid, beliefs)


@pytest.mark.parametrize("make", [FlightSoftware, FirmwareSoftware], ids=["python", "c"])
@pytest.mark.parametrize("command", STARTS, ids=["start", "take-off", "sticks", "set-point"])
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"valid": False}, "estimate is not valid; leave the vehicle at rest"),
        ({"lean_deg": 8.0}, "stands tilted 8.0 degrees; limit 6"),
        ({"force_deg": 8.0}, "stands tilted 8.0 degrees; limit 6"),
    ],
)
def test_no_command_starts_the_motors_on_a_wrong_estimate(vehicle, controller, make, command, wrong, words):
    software = make(vehicle, controller, HOP)
    for k in range(60):
        software.step(standing(0.005 * k, **wrong), command)
    assert software.motors == "off"
    texts = [e.text for e in software.mission_state.events]
    assert texts.count(words) == 1, texts
    if not command.rc_active:
        for k in range(60, 120):
            software.step(standing(0.005 * k), command)
        assert software.motors == "spin_up"


def test_the_measured_tilt_is_the_greater_of_estimate_and_accelerometers():
    assert math.degrees(compute_standing_tilt(standing(0.0, lean_deg=3.0, force_deg=1.0))) == pytest.approx(3.0)
    assert math.degrees(compute_standing_tilt(standing(0.0, lean_deg=1.0, force_deg=4.0))) == pytest.approx(4.0)
    assert math.degrees(
        compute_standing_tilt(replace(standing(0.0, lean_deg=2.0), auxiliary_states=None))
    ) == pytest.approx(2.0)


@pytest.mark.parametrize("lean_deg", [8.0, 10.4])
def test_a_vehicle_that_leans_is_not_armed(vehicle, controller, lean_deg):
    """The filter rejects the accelerometers there, and believes that the vehicle stands level."""
    tips = vehicle.contact.legs.to_array() @ body_to_ned_matrix(quaternion_from_euler(math.radians(lean_deg), 0.0, 0.0))
    legs = vehicle.contact.legs.model_copy(update={"value": tuple(map(tuple, tips.tolist()))})
    leaning = vehicle.model_copy(update={"contact": vehicle.contact.model_copy(update={"legs": legs})})
    options = {"controller": controller, "designed_for": vehicle, "sensors": "fitted", "seed": 7, "keep": False}
    with Flight(leaning, HOP, **options) as flight:
        why = await_estimate_and_start(flight)
        assert np.abs(flight.status.estimate.attitude[:2]).max() < math.radians(1.0)
        assert f"stands tilted {lean_deg - 0.3:.1f}"[:-2] in why
        assert "degrees; limit 6; set the vehicle on level ground" in why
        assert not flight.autopilot.armed


@pytest.mark.parametrize("fault", ["", "sonar.bias=0.15@0s"])
def test_the_height_on_the_floor_is_that_of_the_legs(vehicle, controller, fault):
    """A sonar that reads 0.17 m on the floor does not lift the estimate; an estimate that is lifted does not arm."""
    options = {"controller": controller, "sensors": "fitted", "seed": 13, "keep": False}
    with Flight(vehicle, HOP, faults=[parse_fault(fault)] if fault else [], **options) as flight:
        while flight.time_s < 3.0:
            flight.step_period()
        m, legs_m = flight.status.estimate, standing_height(vehicle)
        assert -m.position[2] - m.auxiliary_states.floor_height == pytest.approx(legs_m, abs=0.01)
        answer = flight.autopilot.arm()
        assert answer, answer.reason
    lifted = replace(m, position=m.position - np.array([0.0, 0.0, 0.15]))
    told = [find_arming_faults(e, 0.0, 0.0, World(), 0.1, "", standing_m=legs_m) for e in (m, lifted)]
    assert told[0] == []
    assert f"m above the floor, where the standing vehicle is {legs_m:.2f} m above it" in told[1][0]


@pytest.mark.parametrize("charge", [1.0, 0.93, 0.5, 0.12])
def test_the_charge_is_read_from_the_voltage_at_rest(vehicle, charge):
    battery = vehicle.battery
    volts = open_circuit_voltage(battery, charge) - float(battery.internal_resistance) * float(
        battery.electronics_current
    )
    assert find_charge_from_idle_voltage(battery, volts) == pytest.approx(charge, abs=2e-3)


def test_a_mission_is_judged_by_the_charge_that_the_battery_has(vehicle, controller):
    mission = parse_mission({"name": "long", "waypoint": [{"position_m": [0.4, 0.0, -0.6], "wait_s": 240.0}]})
    for charge, armed in ((1.0, True), (0.6, False)):
        with Flight(vehicle, mission, controller=controller, keep=False) as flight:
            flight.plant.state[MODEL_CHARGE] = charge
            for _ in range(600):
                flight.step_period()
            answer = flight.autopilot.arm()
            assert bool(answer) == armed, answer.reason
            if not armed:
                assert "charged to 6" in answer.reason
                assert "charge it, or wait less" in answer.reason


def test_after_a_drop_arming_asks_for_an_acknowledgement(vehicle, controller):
    with Flight(vehicle, Mission(name="none"), controller=controller, keep=False) as flight:
        autopilot, told = flight.autopilot, []
        autopilot.listeners.append(lambda e: told.append(e.text))

        def run(seconds):
            for _ in range(round(seconds / flight.period_s)):
                flight.step_period()

        run(0.1)
        assert autopilot.arm()
        autopilot.take_off(1.0)
        run(12.0)
        autopilot.emergency_stop()
        run(3.0)
        autopilot.crash_cause = ""  # a drop that nobody saw
        answer = autopilot.arm()
        assert not answer
        assert "last flight interrupted: emergency stop, motors off 0.9 m above the floor" in answer.reason
        assert "inspect the vehicle, then arm again" in autopilot.list_arming_faults()[0]
        assert not autopilot.arm(repeated=True)  # a copy of a message is no second request
        run(0.1)
        assert autopilot.arm()
        assert "acknowledged: emergency stop" in " ".join(told)


def test_a_landing_needs_no_acknowledgement(vehicle, controller):
    with Flight(vehicle, Mission(name="none"), controller=controller, keep=False) as flight:
        autopilot = flight.autopilot
        flight.step_period()
        assert autopilot.arm()
        autopilot.take_off(0.5)
        for _ in range(2000):
            flight.step_period()
        autopilot.land()
        for _ in range(2000):
            flight.step_period()
        assert not autopilot.armed
        assert autopilot.arm()


def test_many_waypoints_are_flown_by_the_compiled_software(vehicle, controller):
    points = [{"position_m": [0.1 * (k % 2), 0.0, -0.6]} for k in range(40)]
    mission = Mission(name="many", waypoint=points)
    software = GenericFirmwareSoftware(vehicle, controller, mission)
    assert isinstance(software, FirmwareSoftware)
    assert software.plan.mission.waypoint[39].position_m == (0.1, 0.0, -0.6)
