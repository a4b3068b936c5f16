"""Safety of the flight software on a board, equal in C and Python: starts, arming, missed periods, resets."""

from __future__ import annotations

import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from driver_library import TRAPS

from mufly.control import design_flight_controller
from mufly.dynamics import standing_height
from mufly.estimate import KalmanEstimator
from mufly.estimate.filter.filter_records import (
    READING_ACCELERATION,
    READING_RANGE_RING,
    READING_SONAR,
    READING_STARTS,
)
from mufly.firmware import FirmwareSoftware, GenericFirmwareSoftware
from mufly.firmware.compiled_software import diff_fields
from mufly.firmware.emulated import HostBoard, image_build
from mufly.firmware.emulated.board_flight import _BoardFirmware
from mufly.firmware.emulated.image_build import build_host_board
from mufly.firmware.software_instance import SoftwareInstance
from mufly.flight import Flight
from mufly.flight.autopilot import DISARM_WITHOUT_TAKE_OFF_S
from mufly.flight.flight_software import FlightSoftware
from mufly.link.clients import Clients, CommandAuthority
from mufly.link.parameter_protocol import LINK_PARAMETERS
from mufly.link.steering_input import StickInputHandler
from mufly.mission import NO_COMMAND, Command, SetPoint, load_mission
from mufly.vehicle import load_vehicle

pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler: install gcc or clang"
)
NOT_MEASURED, STALE, NO_VOLTAGE, BATTERY_LOW, NOT_VALID, TILTED, MOVED = (1 << k for k in range(7))
CLIMB_STICK, NOT_STANDING = 256, 512  # bits of supervisor.h
AROUND = 24
"""Periods before and after the first valid estimate in which a start is asked for."""


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle):
    return design_flight_controller(vehicle)


@pytest.fixture(scope="module")
def aligning(vehicle, controller):
    """Estimates of a filter on the floor, from AROUND periods before the first valid one to as many after it."""
    found = []
    with Flight(vehicle, "demonstration", controller=controller, sensors="fitted", seed=2) as flight:
        assert isinstance(flight.estimator, KalmanEstimator)
        while len(found) < AROUND or not found[-AROUND].valid:
            flight.step_period()
            found.append(flight.estimate)
    return found[-2 * AROUND :]


def _both(vehicle, controller):
    mission = load_mission("demonstration")
    return FlightSoftware(vehicle, controller, mission), FirmwareSoftware(vehicle, controller, mission)


WAYS = {
    "start": Command(start=True),
    "take-off": Command(take_off_height=0.5),
    "sticks": Command(rc_active=True, pilot_climb_rate=0.3),
}


@pytest.mark.parametrize("way", WAYS)
def test_no_start_before_the_first_valid_estimate(vehicle, controller, aligning, way) -> None:
    first = next(k for k, m in enumerate(aligning) if m.valid)
    python, c = _both(vehicle, controller)
    started = []
    for asked in range(2 * AROUND - 4):
        python.reset()
        c.reset()
        # Sticks are repeated by their sender, a request is not.
        until = 2 * AROUND if way == "sticks" else asked + 1
        for k, m in enumerate(aligning):
            command = WAYS[way] if asked <= k < until else NO_COMMAND
            one, other = python.step(m, command), c.step(m, command)
            assert one.input_array.tobytes() == other.input_array.tobytes()
            assert m.valid or python.motors == c.motors == "off"
        s = python.mission_state
        assert diff_fields(s, c.mission_state) == []
        started.append(python.motors != "off")
        assert any("not valid" in e.text for e in s.events) == (not started[-1] or asked < first - 3)
        if started[-1]:
            assert abs(s.home_position[2] - float(aligning[-1].position[2])) < 0.01
    if way == "sticks":
        assert all(started)
    else:
        # A request in the four periods of a mission step is handled at the end of the step.
        assert started == [False] * sum(not one for one in started) + [True] * sum(started)
        assert first - 4 <= started.index(True) <= first


@pytest.mark.parametrize("name", ["position", "velocity", "attitude", "rates"])
def test_no_start_with_a_valid_estimate_that_lacks_a_quantity(vehicle, controller, aligning, name) -> None:
    python, c = _both(vehicle, controller)
    for k in range(12):
        m = replace(aligning[-12 + k], **{name: np.array([0.0, np.nan, 0.0])})
        assert m.valid
        for software in (python, c):
            software.step(m, Command(start=True) if k == 4 else NO_COMMAND)
            assert software.motors == "off"
    assert diff_fields(python.mission_state, c.mission_state) == []
    assert any("not valid" in e.text for e in python.mission_state.events)


# The supervisor, twin of the autopilot and of the link failsafe

KINDS = {
    "arm": (lambda a, x: a.arm(), "USER_ARM"),
    "force": (lambda a, x: a.arm(force=True), "USER_ARM"),
    "disarm": (lambda a, x: a.disarm(), "USER_DISARM"),
    "stop": (lambda a, x: a.disarm(force=True), "USER_DISARM"),
    "start": (lambda a, x: a.start_mission(), "USER_START"),
    "start at": (lambda a, x: a.start_mission(int(x[0] * 10)), "USER_START"),
    "take-off": (lambda a, x: a.take_off(float(x[0])), "USER_TAKE_OFF"),
    "pause": (lambda a, x: a.pause(), "USER_PAUSE"),
    "return": (lambda a, x: a.return_home(), "USER_RETURN"),
    "land": (lambda a, x: a.land(), "USER_LAND"),
    "go to": (lambda a, x: a.go_to(x, float(x[1])), "USER_GO_TO"),
    "turn": (lambda a, x: a.turn_to(float(x[1])), "USER_GO_TO"),
    "sticks": (lambda a, x: a.set_sticks(0.3 * x[0], 0.1 * x[1], x[1], 0.5 + x[2]), "USER_STICKS"),
    "release": (lambda a, x: a.release_sticks(), "USER_RELEASE_STICKS"),
    "set-point": (lambda a, x: a.send_set_point(SetPoint(position_m=tuple(x))), "USER_SET_POINT"),
    "offboard": (lambda a, x: a.set_offboard(True), "USER_OFFBOARD"),
    "no offboard": (lambda a, x: a.set_offboard(False), "USER_END_OFFBOARD"),
}


class BoardSupervisor:
    """The supervisor and the flight software in C, with estimates from outside."""

    def __init__(self, vehicle, controller, mission) -> None:
        self.ffi, self.lib = build_host_board(vehicle, controller, mission, single=False)
        board = HostBoard(self.ffi, self.lib)
        plan = FlightSoftware(vehicle, controller, mission).plan
        self.instance = SoftwareInstance(_BoardFirmware(board), controller, plan)
        for text in ("disarmed", "emergency stop, motors off"):
            self.instance.text_table.assign_number(text)
        self.supervisor = self.ffi.new("supervisor_t *")
        self.lib.supervisor_start(self.supervisor, self.ffi.addressof(self.lib, "mufly_supervisor"), 0)
        self.parts = (self.instance.setup_record, self.instance.software_record, self.instance.estimate_record)

    def ask(self, what, x) -> int:
        nan = float("nan")
        ask = self.ffi.new("user_request_t *", {"kind": getattr(self.lib, KINDS[what][1])})
        ask.force = what in ("force", "stop")
        ask.has_first, ask.first = what == "start at", int(x[0] * 10)
        ask.has_height, ask.height = True, x[0]
        ask.has_position, ask.position = what != "turn", list(x)
        ask.has_heading, ask.heading = True, x[1]
        ask.roll, ask.pitch, ask.yaw_rate, ask.climb_rate = 0.3 * x[0], 0.1 * x[1], x[1], 0.5 + x[2]
        ask.set_point.position, ask.set_point.velocity = list(x), [nan] * 3
        ask.set_point.heading = ask.set_point.yaw_rate = nan
        return self.lib.supervisor_request(self.supervisor, *self.parts, ask)

    def step(self, estimate):
        lib, s, command = self.lib, self.supervisor, self.instance.command_record
        setup, software, belief = self.parts
        self.instance.write_estimate(estimate)
        more = estimate.auxiliary_states
        lib.supervisor_observe(s, setup, belief, float("nan") if more is None else more.floor_height)
        due = software.tick == 0
        lib.supervisor_collect(s, software, command)
        out = self.instance.actuators_record
        lib.software_step(setup, software, belief, command, out)
        self.instance.read_log()
        lib.supervisor_conclude(s, software, due)
        sent = [*out.motor_input, *out.servo_input] if s.armed else [0.0] * 4
        lib.supervisor_step_link(s, setup, software, belief)
        return np.array(sent)


@pytest.mark.parametrize("seed", [1, 3])
def test_the_supervisor_answers_arms_and_disarms_as_the_autopilot_does(vehicle, controller, seed) -> None:
    rng, mission = np.random.default_rng(seed), load_mission("demonstration")
    twin = BoardSupervisor(vehicle, controller, mission)
    accepted, refused, silent = Counter(), Counter(), 0.0
    times = twin.supervisor.settings
    defaults = (LINK_PARAMETERS["COM_DL_LOSS_T"].value, LINK_PARAMETERS["COM_DL_LAND_T"].value)
    assert (times.link_loss_s, times.link_land_s) == defaults
    times.link_loss_s, times.link_land_s = 2.0, 3.0
    # The flight software in C is equal to that in Python, and faster.
    software = GenericFirmwareSoftware
    with Flight(
        vehicle, mission, controller=controller, controllers=software, sensors="fitted", seed=seed, brief=True
    ) as flight:
        autopilot = flight.autopilot
        authority = CommandAuthority(autopilot, Clients(1, 1), StickInputHandler(autopilot))
        original = autopilot.step
        authority.commander = "somebody"

        def step(estimate):
            ours, theirs = original(estimate), twin.step(estimate)
            assert ours.input_array.tobytes() == (theirs + 0.0).tobytes()
            authority.step_link_failsafe(autopilot._now, loss_s=2.0, land_s=3.0)
            assert autopilot.armed == twin.supervisor.armed
            return ours

        autopilot.step = step
        # A likely course of events, with random requests in between.
        plan = {300: "arm", 304: "start" if seed != 3 else "take-off", 2900: "arm"}
        heard = True
        for k in range(4000):
            what = plan.get(k) or (rng.choice(list(KINDS)) if k > 1000 and rng.random() < 0.02 else "")
            if what in ("stop", "force") and rng.random() < 0.8:
                what = "pause"
            x = np.array([rng.uniform(-0.2, 1.2), rng.uniform(-1.0, 1.0), rng.uniform(-1.5, 0.1)])
            if what:
                if k == 304:
                    x[0] = 0.6
                answer = KINDS[what][0](autopilot, x)
                theirs = twin.ask(what, x)
                assert bool(answer) == (theirs == 0), (k, what, answer, theirs)
                (accepted if answer else refused)[what] += 1
            heard = heard and k < 2400  # the commander falls silent
            if heard:
                authority._heard_s = autopilot._now
                twin.lib.supervisor_hear_commander(twin.supervisor)
            flight.step_period()
            if k % 50 == 0:
                assert diff_fields(autopilot.software.mission_state, twin.instance.state) == []
                silent = max(silent, authority.commander_silence_s(autopilot._now))
    assert diff_fields(autopilot.software.mission_state, twin.instance.state) == []
    assert len(accepted) > 6
    assert len(refused) > 6
    assert silent > 5.0


@pytest.fixture(scope="module")
def supervised(board):
    """A supervisor that has seen one estimate of a vehicle that may be armed."""
    ffi, lib = board.ffi, board.lib
    s, m, setup = ffi.new("supervisor_t *"), ffi.new("estimate_t *"), ffi.addressof(lib, "mufly_setup")

    def begin():
        ffi.memmove(m, ffi.new("estimate_t *"), ffi.sizeof("estimate_t"))
        m.valid, m.time_s, m.motion.voltage, m.specific_force[2] = True, 2.0, 8.0, -9.81
        lib.supervisor_start(s, ffi.addressof(lib, "mufly_supervisor"), lib.INTERRUPTION_NONE)
        m.motion.position[2] = -0.3 - s.settings.standing_m
        lib.supervisor_observe(s, setup, m, 0.3)
        return lib, s, setup, m

    return begin


def test_each_reason_against_arming_has_its_bit(supervised) -> None:
    lib, s, setup, m = supervised()
    assert lib.supervisor_arming_faults(s, setup, m) == 0
    for name in ("position", "velocity", "attitude", "rates"):
        for axis in range(3):
            for wrong in (np.nan, np.inf):
                lib, s, setup, m = supervised()
                getattr(m.motion, name)[axis] = wrong
                assert lib.supervisor_arming_faults(s, setup, m) == NOT_MEASURED, (name, axis)
    lib, s, setup, m = supervised()
    s.begun = False  # no estimate yet
    assert lib.supervisor_arming_faults(s, setup, m) == NOT_MEASURED
    cases = {
        NO_VOLTAGE: [("voltage", np.nan), ("voltage", 0.0)],
        BATTERY_LOW: [("voltage", setup.plan.low_voltage + 0.19)],
        MOVED: [("velocity", [0.0, 0.0, 0.11]), ("rates", [0.0, -0.21, 0.0])],
        TILTED: [("attitude", [0.0, 0.5, 0.0])],
    }
    for reason, values in cases.items():
        for name, value in values:
            lib, s, setup, m = supervised()
            setattr(m.motion, name, value)
            assert lib.supervisor_arming_faults(s, setup, m) == reason, (name, value)


# Offboard control and sticks: which of the two every request leaves, in the air and on the floor
LEFT_IN_AIR = {
    "arm": "both", "disarm": "both", "stop": "none", "start": "sticks", "take-off": "both", "pause": "sticks",
    "go to": "sticks", "return": "sticks", "land": "sticks", "sticks": "sticks", "release": "offboard",
    "set-point": "both", "offboard": "both", "no offboard": "sticks",
}  # fmt: skip
LEFT_ON_FLOOR = {
    **LEFT_IN_AIR, "disarm": "none", "take-off": "sticks", "pause": "both", "go to": "both", "return": "both",
    "land": "both",
}  # fmt: skip


class OffboardFlight:
    """An armed vehicle under offboard control, and with sticks, in a state of the mission set from outside."""

    def __init__(self, supervised, board, in_air=True) -> None:
        self.ffi, self.lib = board.ffi, board.lib
        _, self.s, self.setup, self.m = supervised()
        self.software, self.out = self.ffi.new("software_t *"), self.ffi.new("command_t *")
        x = self.software.mission
        if in_air:
            self.m.motion.position[2] = -1.3
            x.state, x.has_taken_off = self.lib.STATE_OFFBOARD, True
            x.motors = self.software.motors = self.lib.MOTORS_FLY
            self.software.is_lifted = True
        self.s.armed, self.s.armed_s = True, self.s.now_s
        for what in ("sticks", "set-point", "offboard"):
            assert self.ask(what) == self.lib.ANSWER_ACCEPTED
        assert self.left() == "both"

    def ask(self, what) -> int:
        nan = float("nan")
        ask = self.ffi.new("user_request_t *", {"kind": getattr(self.lib, KINDS[what][1]), "force": what == "stop"})
        ask.has_position, ask.position = True, [1.0, 2.0, -1.5]
        ask.set_point.position, ask.set_point.velocity = [1.0, 2.0, -1.5], [nan] * 3
        ask.set_point.heading = ask.set_point.yaw_rate = nan
        return self.lib.supervisor_request(self.s, self.setup, self.software, self.m, ask)

    def left(self) -> str:
        """Return what is held, and check that the flight software is commanded so."""
        sticks, offboard = bool(self.s.has_sticks), bool(self.s.offboard)
        self.lib.supervisor_collect(self.s, self.software, self.out)
        assert (self.out.rc_active, self.out.has_program_set_point) == (sticks, offboard and self.s.armed)
        return ("none", "sticks", "offboard", "both")[sticks + 2 * offboard]

    def wait(self, duration_s) -> None:
        self.m.time_s += duration_s
        self.lib.supervisor_observe(self.s, self.setup, self.m, 0.3)


@pytest.mark.parametrize("in_air", [True, False])
def test_each_request_ends_offboard_control_or_sticks_as_stated(supervised, board, in_air) -> None:
    expected = LEFT_IN_AIR if in_air else LEFT_ON_FLOOR
    assert {KINDS[what][1] for what in expected} == {kind for _, kind in KINDS.values()}
    for what, left in expected.items():
        vehicle = OffboardFlight(supervised, board, in_air)
        vehicle.ask(what)
        assert vehicle.left() == left, what


def test_an_accepted_request_is_commanded_once(supervised, board) -> None:
    fields = {
        "start": "start", "pause": "pause", "go to": "has_waypoint", "return": "return_requested", "land": "land",
        "stop": "motor_stop_reason",
    }  # fmt: skip
    for what, field, in_air in [*((w, f, True) for w, f in fields.items()), ("take-off", "has_take_off_height", False)]:
        vehicle = OffboardFlight(supervised, board, in_air)
        vehicle.ask("release")
        assert vehicle.ask(what) == vehicle.lib.ANSWER_ACCEPTED
        for expected in (True, False):
            assert vehicle.left() == "none"
            assert bool(getattr(vehicle.out, field)) == expected, what


def test_offboard_control_and_sticks_end_when_they_are_old(supervised, board) -> None:
    for after_s, left in ((0.49, "both"), (0.51, "sticks"), (0.99, "sticks"), (1.01, "none")):
        vehicle = OffboardFlight(supervised, board)
        vehicle.wait(after_s)
        vehicle.lib.supervisor_collect(vehicle.s, vehicle.software, vehicle.out)
        assert vehicle.left() == left, after_s
        # A set-point that comes too late does not resume what has ended.
        assert vehicle.ask("set-point") == vehicle.lib.ANSWER_ACCEPTED
        assert vehicle.left() == left, after_s


def test_offboard_control_ends_with_its_state_and_with_the_arming(supervised, board) -> None:
    lib = board.lib
    for state in range(lib.MISSION_STATE_COUNT):
        for due in (False, True):
            vehicle = OffboardFlight(supervised, board)
            vehicle.software.mission.state = state
            lib.supervisor_conclude(vehicle.s, vehicle.software, due)
            stays = not due or state in (lib.STATE_OFFBOARD, lib.STATE_INIT)
            assert vehicle.left() == ("both" if stays else "sticks"), state
    # The motors stop: the vehicle is disarmed, and a request that waits is dropped with it.
    vehicle = OffboardFlight(supervised, board)
    lib.supervisor_conclude(vehicle.s, vehicle.software, True)
    vehicle.s.is_pending, vehicle.s.pending.start, vehicle.s.has_sticks = True, True, False
    vehicle.software.motors = lib.MOTORS_OFF
    lib.supervisor_conclude(vehicle.s, vehicle.software, True)
    assert (vehicle.s.armed, vehicle.left(), vehicle.out.start) == (False, "none", False)


def test_a_lost_link_ends_offboard_control_and_sticks(supervised, board) -> None:
    """The first stage hovers and the second lands; sticks that are given in between end too."""
    lib = board.lib
    vehicle = OffboardFlight(supervised, board)
    s = vehicle.s
    lib.supervisor_hear_commander(s)
    for silent_s, stage, requested in (
        (s.settings.link_loss_s + 0.1, lib.LINK_HOVER, "pause"),
        (s.settings.link_land_s, lib.LINK_LAND, "land"),
    ):
        vehicle.wait(silent_s - 0.2)
        for what in ("sticks", "set-point", "offboard"):
            assert vehicle.ask(what) == lib.ANSWER_ACCEPTED
        lib.supervisor_step_link(s, vehicle.setup, vehicle.software, vehicle.m)
        assert vehicle.left() == "both"
        vehicle.wait(0.2)
        lib.supervisor_step_link(s, vehicle.setup, vehicle.software, vehicle.m)
        assert (s.link_stage, vehicle.left()) == (stage, "none")
        assert getattr(vehicle.out, requested)


def test_the_vehicle_is_in_the_air_from_the_stated_height_or_speed_on(board) -> None:
    """It lies on the floor below 5 cm and below 10 cm/s along each axis; motors and lift-off decide first."""
    lib, software, m = board.lib, board.ffi.new("software_t *"), board.ffi.new("estimate_t *")
    software.is_lifted, software.motors = True, lib.MOTORS_FLY
    for height_m, velocity_m_s, expected in (
        (0.049, (0.099, -0.099, 0.099), False), (0.05, (0.0, 0.0, 0.0), True), (0.3, (0.0, 0.0, 0.0), True),
        (0.0, (0.1, 0.0, 0.0), True), (0.0, (0.0, -0.1, 0.0), True), (0.0, (0.0, 0.0, -0.1), True),
        (float("nan"), (0.0, 0.0, 0.0), True),
    ):  # fmt: skip
        m.motion.position[2], m.motion.velocity = -height_m, velocity_m_s
        assert lib.supervisor_in_air(software, m) == expected, (height_m, velocity_m_s)
    for lifted in (False, True):
        for motors in range(lib.MOTORS_BLIND + 1):
            software.is_lifted, software.motors = lifted, motors
            flies = lifted and motors in (lib.MOTORS_FLY, lib.MOTORS_BLIND)
            assert lib.supervisor_in_air(software, m) == flies, motors


def test_a_height_other_than_that_of_standing_refuses_arming(supervised, vehicle) -> None:
    lib, s, setup, m = supervised()
    assert s.settings.standing_m == standing_height(vehicle)
    for floor_m, refused in ((0.251, False), (0.349, False), (0.249, True), (0.351, True), (float("nan"), False)):
        lib.supervisor_observe(s, setup, m, floor_m)
        assert lib.supervisor_arming_faults(s, setup, m) == (NOT_STANDING if refused else 0), floor_m


def test_an_armed_vehicle_disarms_without_a_take_off(supervised, board) -> None:
    software = board.ffi.new("software_t *")
    for motors, stays in ((board.lib.MOTORS_OFF, False), (board.lib.MOTORS_FLY, True)):
        lib, s, setup, m = supervised()
        assert not s.armed
        lib.supervisor_conclude(s, software, True)
        s.armed, s.armed_s, software.motors = True, s.now_s, motors
        count = round(DISARM_WITHOUT_TAKE_OFF_S / setup.period_s)
        for k in range(count + 1):
            assert s.armed or k == count, k
            m.time_s += setup.period_s
            lib.supervisor_observe(s, setup, m, 0.3)
            lib.supervisor_conclude(s, software, k % 4 == 0)
        assert bool(s.armed) == stays


def test_an_estimate_whose_clock_stands_still_refuses_arming_until_it_runs(supervised) -> None:
    lib, s, setup, m = supervised()
    for _ in range(round(0.5 / setup.period_s) - 1):
        lib.supervisor_observe(s, setup, m, 0.3)
    assert lib.supervisor_arming_faults(s, setup, m) == 0
    for _ in range(2):
        lib.supervisor_observe(s, setup, m, 0.3)
    assert lib.supervisor_arming_faults(s, setup, m) == STALE
    assert s.now_s == pytest.approx(2.0 + 0.5 + setup.period_s)  # its own clock runs on
    m.time_s = 2.6
    lib.supervisor_observe(s, setup, m, 0.3)
    assert lib.supervisor_arming_faults(s, setup, m) == 0


def test_a_clock_that_jumps_back_or_is_no_number_does_not_stop_the_supervisor(supervised) -> None:
    lib, s, setup, m = supervised()
    for time_s, now_s, stale_s in (
        (1.0, 2.0 + setup.period_s, 0.0), (float("nan"), 2.0 + 2 * setup.period_s, setup.period_s), (3.0, 3.0, 0.0),
        (float("-inf"), 3.0 + setup.period_s, setup.period_s),
    ):  # fmt: skip
        m.time_s = time_s
        lib.supervisor_observe(s, setup, m, 0.3)
        assert (s.now_s, s.stale_s) == pytest.approx((now_s, stale_s)), time_s
    lib, s, setup, m = supervised()
    m.motion.voltage = float("inf")
    assert lib.supervisor_arming_faults(s, setup, m) == NO_VOLTAGE
    m.motion.voltage = 8.0
    for climb, reasons in ((-0.1, 0), (0.1, CLIMB_STICK)):
        s.has_sticks, s.sticks.pilot_climb_rate = True, climb
        assert lib.supervisor_arming_faults(s, setup, m) == reasons


class Requests:
    """A supervisor in a flight whose state a test sets; requests are answered at once."""

    def __init__(self, supervised, board) -> None:
        self.ffi = board.ffi
        self.lib, self.s, self.setup, self.m = supervised()
        self.software = self.ffi.new("software_t *")

    def fly(self, state="HOVER", height=1.0) -> None:
        x, software = self.software.mission, self.software
        self.s.armed, software.is_lifted = True, True
        software.motors = x.motors = self.lib.MOTORS_FLY
        x.state, x.has_taken_off = getattr(self.lib, f"STATE_{state}"), True
        x.home_position[2] = self.m.motion.position[2] + height

    def ask(self, kind, **fields) -> int:
        request = self.ffi.new("user_request_t *", {"kind": getattr(self.lib, f"USER_{kind}"), **fields})
        return int(self.lib.supervisor_request(self.s, self.setup, self.software, self.m, request))


def test_each_request_is_answered_by_its_numbers_and_the_state(supervised, board) -> None:
    r = Requests(supervised, board)
    accepted, later, denied, nan = 0, 1, 2, float("nan")
    assert (
        int(r.lib.supervisor_request(r.s, r.setup, r.software, r.m, r.ffi.new("user_request_t *", {"kind": 99})))
        == denied
    )
    assert r.ask("LAND") == r.ask("PAUSE") == r.ask("RETURN") == later  # on the floor
    assert r.ask("GO_TO", has_heading=True) == later
    for height, answer in ((nan, denied), (float("inf"), denied), (0.05, denied), (51.0, denied), (1.0, later)):
        assert r.ask("TAKE_OFF", has_height=True, height=height) == answer, height
    assert r.ask("ARM") == accepted
    assert r.ask("ARM") == accepted  # it is armed already
    assert r.ask("TAKE_OFF") == accepted  # to the height of the mission
    for attitude, answer in (([0.0, 0.5, 0.0], later), ([nan, 0.0, 0.0], accepted), ([0.0, 0.0, 0.0], accepted)):
        r.m.motion.attitude = attitude  # an unknown attitude is the estimator's case, which bridges it
        assert r.ask("TAKE_OFF", has_height=True, height=1.0) == answer, attitude
    for first, answer in ((-1, denied), (r.setup.plan.count, denied), (0, accepted)):
        assert r.ask("START", has_first=True, first=first) == answer, first
    plan = r.ffi.new("plan_t *")
    setup = r.ffi.new("flight_setup_t *", r.setup[0])
    setup.plan, r.setup = plan, setup
    assert r.ask("START") == later  # no mission
    for name in ("roll", "pitch", "yaw_rate", "climb_rate"):
        for wrong in (nan, float("inf")):
            assert r.ask("STICKS", **{name: wrong}) == denied
    r.fly()
    assert r.ask("GO_TO") == denied  # neither place nor heading
    assert r.ask("GO_TO", has_heading=True, heading=nan) == denied
    assert r.ask("GO_TO", has_position=True, position=[0.0, 0.0, 0.5]) == denied
    assert r.ask("GO_TO", has_position=True, position=[0.0, 0.0, -1.0]) == accepted
    assert list(r.s.pending.waypoint) == [0.0, 0.0, -1.0]
    assert (r.s.pending.has_heading, r.s.pending.heading) == (False, 0.0)
    assert r.ask("DISARM") == later  # in the air
    for set_point, answer in (([nan] * 3, denied), ([0.0, 0.0, -1.0], accepted)):
        where = {"position": set_point, "velocity": [nan] * 3, "heading": nan, "yaw_rate": nan}
        assert r.ask("SET_POINT", set_point=where) == answer
    r.software.mission.state = r.lib.STATE_LANDING
    r.software.mission.motors = r.lib.MOTORS_BLIND
    assert r.ask("LAND") == accepted  # it lands already
    assert r.ask("STICKS") == later  # without a position
    assert r.ask("OFFBOARD") == later
    # While a stop of the motors waits, nothing else is taken.
    r.fly()
    assert r.ask("DISARM", force=True) == accepted
    assert r.s.interruption == r.lib.INTERRUPTION_STOPPED
    assert r.s.pending.motor_stop_reason == r.lib.STOP_EMERGENCY
    for kind in ("ARM", "PAUSE", "OFFBOARD"):
        r.s.armed = kind != "ARM"
        r.s.set_point_s = r.s.now_s
        assert r.ask(kind) == later, kind


def test_a_stop_near_the_floor_is_no_interruption_and_at_rest_none_is_pending(supervised, board) -> None:
    for height, state, pending, interruption in (
        (0.05, "LANDING", True, "NONE"), (0.5, "LANDING", True, "STOPPED"), (None, "INIT", False, "NONE"),
        (None, "RC", True, "NONE"),
    ):  # fmt: skip
        r = Requests(supervised, board)
        if height is not None:
            r.fly(state, height)
        r.software.mission.state = getattr(r.lib, f"STATE_{state}")
        assert r.ask("DISARM", force=True) == 0
        assert bool(r.s.is_pending) == pending
        assert r.s.interruption == getattr(r.lib, f"INTERRUPTION_{interruption}")


def test_an_interruption_is_acknowledged_by_a_second_request_or_by_force(supervised, board) -> None:
    accepted, later = 0, 1
    for requests in (
        (({}, later), ({"repeated": True}, later), ({}, accepted)),
        (({"force": True}, accepted),),
    ):
        r = Requests(supervised, board)
        r.s.interruption = r.lib.INTERRUPTION_TIPPED
        for fields, answer in requests:
            assert r.ask("ARM", **fields) == answer
        assert r.s.interruption == r.lib.INTERRUPTION_NONE
    # Force does not arm with a climb stick, nor in flight without arming.
    r = Requests(supervised, board)
    r.s.has_sticks, r.s.sticks.pilot_climb_rate = True, 0.5
    assert r.ask("ARM", force=True) == later
    r = Requests(supervised, board)
    r.fly()
    r.s.armed = False
    assert r.ask("ARM", force=True) == later


def test_the_end_of_a_flight_is_classified_by_the_latest_entries_since_arming(supervised, board) -> None:
    lib, ffi = board.lib, board.ffi
    tipped, blind, usual = lib.SAY_TIPPED_MOTORS_OFF, lib.SAY_MOTORS_OFF_AFTER_DESCENT, lib.SAY_LANDED
    for codes, times, expected in (
        ((tipped,), (5.0,), lib.INTERRUPTION_TIPPED), ((blind, usual), (5.0, 5.1), lib.INTERRUPTION_BLIND),
        ((tipped,), (0.5,), lib.INTERRUPTION_NONE), ((usual,) * 20, (5.0,) * 20, lib.INTERRUPTION_NONE),
        ((tipped, *(usual,) * 4), (5.0,) * 5, lib.INTERRUPTION_NONE), ((), (), lib.INTERRUPTION_NONE),
    ):  # fmt: skip
        lib, s, *_ = supervised()
        software = ffi.new("software_t *")
        x = software.mission
        for code, time_s in zip(codes, times, strict=True):
            entry = x.log[x.logged_event_count % len(x.log)]
            entry.message.code, entry.time_s = code, time_s
            x.logged_event_count += 1
        s.armed, s.armed_s, s.ran = True, 1.0, True
        lib.supervisor_conclude(s, software, True)
        assert not s.armed
        assert s.interruption == expected, (codes, times)


def test_a_silent_commander_is_followed_by_hover_then_land(supervised, board) -> None:
    """An order is repeated until it is accepted; a vehicle that returns or lands goes on."""
    r = Requests(supervised, board)
    s, x, lib = r.s, r.software.mission, r.lib

    def step(silent_s) -> bool:
        """Return what is newly pending."""
        s.is_pending = False
        s.commander_heard_s = s.now_s - silent_s
        lib.supervisor_step_link(s, r.setup, r.software, r.m)
        return ("pause" if s.pending.pause else "land" if s.pending.land else "other") if s.is_pending else ""

    loss, land = s.settings.link_loss_s, s.settings.link_land_s
    r.fly("WAYPOINT")
    lib.supervisor_step_link(s, r.setup, r.software, r.m)
    assert not s.is_pending  # nobody has commanded yet
    s.has_commander = True
    assert [step(t) for t in (loss - 0.1, loss, loss + 0.1)] == ["", "pause", ""]
    x.state = lib.STATE_HOVER
    assert [step(t) for t in (loss + land - 0.1, loss + land, loss + land + 1.0)] == ["", "land", ""]
    # In a landing or a return nothing is ordered, then or later.
    for state, returning in (("LANDING", False), ("WAYPOINT", True)):
        r.fly(state)
        assert step(0.0) == ""
        x.returning_home = returning
        assert [step(t) for t in (loss, loss + land)] == ["", ""]
        x.returning_home = False
    # It begins to return while it hovers: no landing is ordered.
    r.fly("WAYPOINT")
    step(0.0)
    assert step(loss) == "pause"
    x.returning_home = True
    assert step(loss + land) == ""
    assert s.link_stage == lib.LINK_LAND
    # A stop that waits: the order is repeated after it.
    x.returning_home = False
    step(0.0)
    x.outcome = lib.OUTCOME_FAILED  # neither pause nor landing are permitted
    assert [step(loss), step(loss + 0.1)] == ["", ""]
    assert s.link_owed == lib.LINK_HOVER
    x.outcome = lib.OUTCOME_OPEN
    assert step(loss + 0.2) == "pause"
    assert s.link_owed == lib.LINK_HEARD


def test_set_points_wait_for_arming_and_end_with_their_stream(supervised, board) -> None:
    r = Requests(supervised, board)
    s, lib, command = r.s, r.lib, r.ffi.new("command_t *")
    s.has_set_point, s.offboard, s.set_point_s = True, True, s.now_s
    lib.supervisor_collect(s, r.software, command)
    assert (command.has_program_set_point, s.offboard) == (False, True)
    s.armed = True
    lib.supervisor_collect(s, r.software, command)
    assert command.has_program_set_point
    s.now_s += 0.6
    lib.supervisor_collect(s, r.software, command)
    assert (command.has_program_set_point, s.offboard) == (False, False)
    r.fly()
    assert r.ask("OFFBOARD") == 1  # the set-point is old
    s.has_set_point = False
    assert r.ask("OFFBOARD") == 1


# Periods


def test_lost_periods_are_repeated_with_the_inertial_readings_after_them(board) -> None:
    lib, b = board.lib, board.record
    sensors = len(b.readings.fresh)
    count = {}
    for missed in (0, 3, 10, 99):
        board.restart()
        readings = b.readings
        readings.fresh = [1] * sensors
        readings.z[READING_STARTS[READING_ACCELERATION] + 2] = -9.81
        lib.board_estimate(b, 0.005, missed)
        count[missed] = b.period_count
        assert list(readings.fresh)[READING_SONAR:] == [1] * (sensors - READING_SONAR)
        assert readings.z[READING_STARTS[READING_ACCELERATION] + 2] == pytest.approx(-9.81)
    assert count == {0: 1, 3: 4, 10: 11, 99: 11}  # at most ten
    board.restart()


def test_a_beam_without_a_number_reads_the_full_range_and_missing_sensors_are_named(board) -> None:
    lib, b = board.lib, board.record
    ring = lib.mufly_plan.beam_ring
    board.restart()
    for ranges in (0.5, 0.6, float("nan"), float("inf")):
        b.readings.fresh[READING_RANGE_RING] = 1
        b.readings.ranges = [ranges] * len(b.readings.ranges)
        lib.board_estimate(b, 0.005, 0)
    assert list(b.belief.ranges)[: ring.count] == [ring.max_range] * ring.count
    lib.board_start(b, 1 << READING_SONAR, lib.RESTART_COLD)
    lib.board_estimate(b, 0.005, 0)
    statuses = [b.belief.checks[k].status == lib.SENSOR_NOT_FITTED for k in range(len(b.readings.fresh))]
    assert statuses == [k != READING_SONAR for k in range(len(statuses))]
    board.restart()


# Resets


@pytest.fixture(scope="module")
def board(vehicle, controller):
    """A board whose process ends at an index beyond its array."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(image_build, "COMPILER_FLAGS", (*image_build.COMPILER_FLAGS, *TRAPS))
        return HostBoard(*build_host_board(vehicle, controller, load_mission("demonstration"), single=False))


def test_kept_memory_tells_a_reset_in_flight_from_a_power_up(board) -> None:
    ffi, lib = board.ffi, board.lib
    r = ffi.new("fault_record_t *")
    memory = ffi.buffer(r)
    rng = np.random.default_rng(1)
    memory[:] = rng.bytes(len(memory))  # as after a power-up
    assert lib.fault_record_begin(r, lib.RESET_BY_WATCHDOG) == lib.RESTART_COLD
    assert lib.fault_record_begin(r, lib.RESET_BY_PIN) == lib.RESTART_ON_FLOOR
    lib.fault_record_update(r, True, 3, 12.345)
    lib.fault_record_fault(r, 0x08001234, 7)
    kept = bytes(memory)
    # A memory with any bit changed is not believed, and nor is one after the power was off.
    for bit in range(8 * len(kept)):
        changed = bytearray(kept)
        changed[bit // 8] ^= 1 << bit % 8
        memory[:] = bytes(changed)
        assert lib.fault_record_begin(r, lib.RESET_BY_BROWN_OUT) == lib.RESTART_COLD, bit
        assert r.fault_address == 0
    memory[:] = kept
    assert lib.fault_record_begin(r, lib.RESET_BY_POWER) == lib.RESTART_COLD
    memory[:] = kept
    assert lib.fault_record_begin(r, lib.RESET_BY_BROWN_OUT) == lib.RESTART_IN_FLIGHT
    assert (r.restarts, r.in_flight, r.cause) == (2, 1, lib.RESET_BY_BROWN_OUT)
    assert (r.state, r.time_ms, r.fault_address, r.fault_status) == (3, 12345, 0x08001234, 7)
    # The motors have not run since: another reset is none in flight.
    assert lib.fault_record_begin(r, lib.RESET_BY_WATCHDOG) == lib.RESTART_ON_FLOOR
    for time_s, time_ms in ((0.0, 0), (-1.0, 0), (4e6, 0), (float("nan"), 0), (2.5, 2500)):
        lib.fault_record_update(r, True, 3, time_s)
        assert r.time_ms == time_ms
    lib.fault_record_update(r, False, 0, 13.0)  # landed
    assert lib.fault_record_begin(r, lib.RESET_BY_WATCHDOG) == lib.RESTART_ON_FLOOR


def test_motors_stay_off_after_a_reset_in_flight_until_it_is_acknowledged(board, aligning) -> None:
    ffi, lib, b = board.ffi, board.lib, board.record
    board.restart()
    for restart in (lib.RESTART_ON_FLOOR, lib.RESTART_IN_FLIGHT):
        lib.board_start(b, 0, restart)
        setup = ffi.addressof(lib, "mufly_setup")
        for k in range(300):
            lib.board_estimate(b, 0.005 * k, 0)
            lib.board_control(b, ffi.NULL)
            assert list(b.sent.motor_input) + list(b.sent.servo_input) == [0.0] * 4
        m = ffi.new("estimate_t *")
        m.motion.voltage, m.valid, m.time_s = 8.0, True, 2.0
        m.motion.position[2] = -b.supervisor.floor_m - b.supervisor.settings.standing_m
        m.specific_force[2] = -9.81
        ask = ffi.new("user_request_t *", {"kind": lib.USER_ARM})
        answers = [
            lib.supervisor_request(ffi.addressof(b, "supervisor"), setup, ffi.addressof(b, "software"), m, ask)
            for _ in range(2)
        ]
        if restart == lib.RESTART_IN_FLIGHT:
            assert answers == [lib.ANSWER_REJECTED_FOR_NOW, lib.ANSWER_ACCEPTED]
        else:
            assert answers == [lib.ANSWER_ACCEPTED] * 2
    board.restart()
