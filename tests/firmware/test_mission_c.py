"""Mission, trajectories and failsafe on board: the C code is Python's, bit for bit, whatever is asked and believed."""

from __future__ import annotations

import math
import os
import random
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cffi
import numpy as np
import pytest
from driver_library import TRAPS
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mufly.compiled import portable_math
from mufly.control import design_flight_controller
from mufly.estimate import ZERO_COVARIANCE, Estimate, SensorStatus
from mufly.estimate.sensor_status import AuxiliaryStates
from mufly.firmware import Firmware, export_firmware, find_compiler
from mufly.firmware.compiled_software import diff_fields
from mufly.firmware.export.source_export import ONBOARD_SOURCES, find_sources
from mufly.firmware.software_instance import SoftwareInstance, read_active_motion, read_trajectory_point
from mufly.flight.flight_software import FlightSoftware, blind_descent_voltage_fraction
from mufly.flight.oscillation_detector import ACTUATOR_INPUT_NAMES, OscillationDetector
from mufly.mission import (
    Command,
    LogTemplate,
    SetPoint,
    VehicleRequest,
    check_request,
    parse_mission,
    plan_straight,
)
from mufly.mission.machine.offboard import follow_set_point
from mufly.mission.trajectory import TrajectoryLimits, TrajectoryPoint, plan_pending_curve, plan_stop
from mufly.quantities.quantity_table import READINGS_WITH_FUSION_STATUS
from mufly.vehicle import load_vehicle

needs_cc = pytest.mark.skipif(
    not (shutil.which("gcc") or shutil.which("clang")), reason="there is no C compiler on this machine"
)
pytestmark = needs_cc
SOURCES = Path(__file__).parents[2] / "src" / "mufly" / "firmware" / "sources"

SQUARE = {
    "name": "square",
    "waypoint": [
        {"position_m": [1.0, 0.0, -1.0], "wait_s": 0.5},
        {"position_m": [1, 1, -1.5], "heading_deg": 90},
    ],
    "at_end": "return",
}
CURVES = {
    "name": "curves",
    "path": {"kind": "spline"},
    "waypoint": [
        {"position_m": [1, 0, -1]},
        {"position_m": [2, 1, -1.5], "speed_m_s": 0.3},
        {"position_m": [1, 2, -1]},
    ],
    "at_end": "hover",
}
SCANNED = {
    "name": "scanned",
    "avoidance": {"scan": True, "give_up_s": 6.0},
    "waypoint": [{"position_m": [3.0, 0.0, -1.0]}],
}
AROUND = {"name": "around", "avoidance": {"scan": True}, "waypoint": [{"position_m": [3.0, 0.0, -1.0]}]}
NEAR = {"name": "near", "waypoint": [{"position_m": [0.3, 0.0, -1.0]}], "at_end": "hover"}
HEEDLESS = {**NEAR, "name": "heedless", "avoidance": {"enabled": False}}
PATIENT = {"name": "patient", "waypoint": [{"position_m": [0.3, 0.0, -1.0], "wait_s": 60.0}]}


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle):
    return design_flight_controller(vehicle)


@pytest.fixture(scope="module")
def firmware(controller, tmp_path_factory):
    """The exported code, built so that an index beyond its array ends the process."""
    compiler = tmp_path_factory.mktemp("compiler") / "cc"
    compiler.write_text(f'#!/bin/sh\nexec {find_compiler()} {" ".join(TRAPS)} "$@"\n')
    compiler.chmod(0o755)
    return Firmware(controller, cc=str(compiler))


# Numbers


def test_angles_and_lengths_are_the_same_in_both_languages(firmware) -> None:
    lib, rng = firmware.lib, np.random.default_rng(3)
    worst = 0.0
    for y, x in (rng.uniform(-1, 1, (3000, 2)) * 10.0 ** rng.uniform(-6, 3, (3000, 2))).tolist():
        angle = portable_math.portable_atan2(y, x)
        assert lib.real_atan2(y, x) == angle
        worst = max(worst, abs(angle - math.atan2(y, x)) / math.ulp(angle))
        assert lib.real_hypot(x, y) == portable_math.vector_length(x, y)
        turn = 1000.0 * (x + y)
        assert lib.real_wrap_angle(turn) == portable_math.wrap_angle(turn)
        assert abs(turn) > 1e5 or portable_math.wrap_angle(turn) == math.remainder(turn, math.tau)
    assert worst <= 2.0
    for y, x in (
        (0.0, -1.0), (-0.0, -1.0), (0.0, 0.0), (math.nan, 1.0), (1.0, math.nan), (1.0, math.inf), (1.0, -0.0),
    ):  # fmt: skip
        ours = portable_math.portable_atan2(y, x)
        assert math.copysign(1.0, ours) == math.copysign(1.0, lib.real_atan2(y, x))
        assert ours == lib.real_atan2(y, x)
    assert lib.real_wrap_angle(math.pi) == portable_math.wrap_angle(math.pi) == math.pi


def test_a_blind_descent_holds_its_rate_alike_in_both_languages(firmware) -> None:
    """Hover voltage at the wanted rate of 0.5 to 0.9 m/s, in proportion between the limits of 0.92 and 1.08."""
    for height, wanted in ((-0.1, 0.5), (0.3, 0.5), (0.7, 0.7), (5.0, 0.9)):
        rates = wanted + np.linspace(-1.0, 1.0, 41)
        shares = [blind_descent_voltage_fraction(height, rate) for rate in rates.tolist()]
        assert shares == [firmware.lib.blind_descent_voltage_fraction(height, rate) for rate in rates.tolist()]
        assert shares[20] == 1.0
        inside = np.abs(rates - wanted) < 0.6
        slopes = np.diff(np.array(shares)[inside]) / np.diff(rates[inside])
        np.testing.assert_allclose(slopes, 1.0 / (2.0 * 9.81 * 0.4), rtol=1e-9)
        assert (shares[0], shares[-1]) == (0.92, 1.08)


def test_words_stand_in_the_same_order_in_both_languages() -> None:
    said = re.search(
        r"enum \{\n(    SAY_.*?)    SAY_COUNT", (SOURCES / "mission/machine/log_messages.h").read_text(), re.S
    )
    assert said
    assert re.findall(r"SAY_(\w+),", said[1]) == [w.name for w in LogTemplate]


def test_words_are_the_same_where_their_numbers_are(firmware) -> None:
    ffi, lib = firmware.ffi, firmware.lib

    def said(code: int, number: float):
        m = ffi.new("message_t *")
        m[0] = lib.make_message_1(code, number)
        return m

    nan = math.nan
    for a, b in ((1.0, 1.0), (1.0, 2.0), (2.0, 1.0), (nan, nan), (nan, 1.0), (1.0, nan)):
        assert lib.is_same_message(said(3, a), said(3, b)) == (f"{a}" == f"{b}")
        assert not lib.is_same_message(said(3, a), said(4, a))


# Trajectories

_place = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda p: tuple(round(v, 3) for v in p))
_heading = st.floats(-7, 7)


def _point_of(ffi, f, *args):
    p = ffi.new("trajectory_point_t *")
    f(*args, p)
    return tuple(p.position), tuple(p.velocity), tuple(p.acceleration), p.heading, p.heading_rate


@settings(max_examples=120, deadline=None, derandomize=True)
@given(
    a=_place, b=_place, ends=st.none() | st.tuples(_place, _place), heading=_heading, final=st.none() | _heading,
    speed=st.floats(0.01, 3), acceleration=st.floats(0.05, 2), brake=st.none() | _place,
)  # fmt: skip
@example((0, 0, -1), (1, 0, -1), ((1, 0, 0), (1, 0, 0.5)), 0.0, None, 0.5, 0.5, None)  # it rises at its end alone
@example((0, 0, -1), (1, 0, -1), ((1, 0, 0), (1, 0, 0)), 0.0, None, 0.5, 0.5, None)  # level all the way
def test_any_leg_is_the_same_in_both_languages(firmware, a, b, ends, heading, final, speed, acceleration, brake):
    ffi, lib = firmware.ffi, firmware.lib
    limits = TrajectoryLimits(speed, 0.5, 0.4, acceleration, 0.4, 1.0, 1.6)
    c, w = ffi.new("trajectory_limits_t *", list(vars_of(limits))), ffi.new("trajectory_t *")
    turned = ffi.NULL if final is None else ffi.new("real_t *", final)
    if ends is None:
        way = plan_straight(a, b, heading, limits, final_heading=final, nose_offset=0.2)
        lib.plan_straight(a, b, heading, c, turned, 0.2, w)
    else:
        way = plan_pending_curve(a, b, *ends, heading, limits, final_heading=final, nose_offset=0.2)
        lib.plan_pending_curve(a, b, *ends, heading, c, turned, 0.2, w)
    if brake is not None:
        first = plan_stop(a, brake, heading, 1.0, heading_rate=0.3, yaw_acceleration=1.6)
        s = ffi.new("braking_motion_t *")
        lib.plan_stop(a, brake, heading, 1.0, 0.3, 1.6, s)
        way = way.add_initial_braking(first)
        lib.add_initial_braking(w, s)
        for t in (0.0, 0.4 * first.rest_time_s, math.inf):
            assert _point_of(ffi, lib.braking_evaluate, s, t) == tuple(first.evaluate(t))
    assert diff_fields(way, read_active_motion(SimpleCourse(w))) == []
    for _ in range(4):
        lib.advance_pending_curve(w)
    way = way.finish_curve()
    assert diff_fields(way, read_active_motion(SimpleCourse(w))) == []
    for share in (-0.1, 0.0, 0.03, 0.2, 0.37, 0.5, 0.81, 0.999, 1.0, 1.1):
        for t in (share * way.duration_s, share * way.path_start_s):
            assert _point_of(ffi, lib.trajectory_evaluate, w, t) == tuple(way.evaluate(t))


class SimpleCourse:
    def __init__(self, way) -> None:
        self.kind, self.way = 1, way


def vars_of(q: TrajectoryLimits):
    names = (
        "speed",
        "climb",
        "descent",
        "acceleration",
        "climb_acceleration",
        "yaw_rate",
        "yaw_acceleration",
    )
    return [getattr(q, n) for n in names]


@pytest.mark.parametrize("dt", [0.0, 1e-12, 0.005, 0.02, 0.020000000020000003, 0.5])
def test_set_points_are_followed_alike_in_steps_of_any_length(firmware, dt) -> None:
    ffi, lib = firmware.ffi, firmware.lib
    limits = TrajectoryLimits(1.0, 0.5, 0.4, 1.0, 0.4, 1.0, 1.6)
    wanted = SetPoint((1.0, -1.0, -1.2), heading_rad=1.0)
    nan, at = math.nan, TrajectoryPoint((0.0, 0.1, -1.0), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0), 0.2, 0.1)
    theirs = ffi.new("trajectory_point_t *", [at.position, at.velocity, at.acceleration, at.heading, at.heading_rate])
    ask = ffi.new("set_point_t *", [wanted.position_m, (nan, nan, nan), 1.0, nan])
    lib.follow_set_point(
        theirs, ask, ffi.new("trajectory_limits_t *", vars_of(limits)), (0.0, 0.0, -1.0), dt, ffi.NULL, 0.5
    )
    assert diff_fields(follow_set_point(at, wanted, limits, (0.0, 0.0, -1.0), dt), read_trajectory_point(theirs)) == []


# Oscillations


def test_of_inputs_that_oscillate_at_once_both_name_the_one_that_lasts_longest(firmware) -> None:
    ffi, lib, ours = firmware.ffi, firmware.lib, OscillationDetector()
    theirs, found = ffi.new("oscillation_detector_t *"), ffi.new("oscillation_t *")
    lib.oscillation_detector_reset(theirs)
    named = set()
    for k in range(400):
        t = 0.02 * k
        # The third ends before it has lasted for 2 s; the second begins before the first, and ends before it.
        swings = (t > 2.0, 1.0 < t < 6.0, t < 1.5, False)
        inputs = [
            size * (0.5 + 0.5 * on * math.sin(2 * math.pi * f * t))
            for on, f, size in zip(swings, (1.5, 2.0, 8.0, 1.0), (1.0, 1.0, 2.0, 2.0), strict=True)
        ]
        one = ours.find_oscillation(t, inputs)
        lib.oscillation_detector_step(theirs, t, inputs, ffi.NULL, found)
        assert found.is_present == (one is not None)
        if one is not None:
            assert (ACTUATOR_INPUT_NAMES[found.input_name], found.duration_s, found.swing) == (
                one.input_name,
                one.duration_s,
                one.swing,
            )
            named.add(one.input_name)
    assert named == set(ACTUATOR_INPUT_NAMES[:2])


# The estimate


@pytest.mark.parametrize("beams", [0, 3, 8, 63])
def test_an_estimate_has_as_many_ranges_as_there_are_beams(firmware, beams) -> None:
    """The entries behind the last beam stay as they are: they are neither copied nor checked."""
    ffi, lib = firmware.ffi, firmware.lib
    m, copy = ffi.new("estimate_t *"), ffi.new("estimate_t *")
    m.ranges, copy.ranges = [1.5] * 64, [7.0] * 64
    lib.copy_estimate(m, beams, copy)
    assert list(copy.ranges) == [1.5] * beams + [7.0] * (64 - beams)
    monitor, ring = ffi.new("estimate_monitor_t *"), ffi.new("beam_ring_t *", {"count": beams, "max_range": 2.0})
    m.ranges, monitor.good.ranges = [math.nan] * 64, [math.inf] * 64
    lib.check_estimate(monitor, m, 0.02, ring)
    assert list(monitor.good.ranges) == [2.0] * beams + [math.inf] * (64 - beams)


def test_values_beyond_any_flight_are_replaced_in_c_as_in_python(firmware) -> None:
    ffi, lib = firmware.ffi, firmware.lib
    ring = ffi.new("beam_ring_t *", {"count": 0, "max_range": 2.0})
    for value, lost in ((9e5, 0), (1e6, 2), (-1e197, 2), (math.inf, 2), (math.nan, 2)):
        m, monitor = ffi.new("estimate_t *", {"valid": True}), ffi.new("estimate_monitor_t *")
        m.motion.velocity = [0.1, value, 0.3]
        lib.check_estimate(monitor, m, 0.005, ring)
        assert monitor.what == lost, value


# What may be asked


def test_what_may_be_asked_is_one_table(firmware, vehicle, controller) -> None:
    board = SoftwareInstance(firmware, controller, FlightSoftware(vehicle, controller, parse_mission(SQUARE)).plan)
    s = firmware.ffi.addressof(board.software_record, "mission")
    board.step(at_rest(0.0), Command())
    for k, ask in enumerate(VehicleRequest):
        for state in range(8):
            for motors in range(5):
                for outcome in range(3):
                    for height, armed, user_in_control in ((0.1, True, True), (0.3, False, True), (1.0, True, False)):
                        s.state, s.motors, s.outcome, s.user_in_control = state, motors, outcome, user_in_control
                        flying = state != 0
                        right = check_request(ask, board.state, height_m=height, armed=armed, flying=flying)
                        assert firmware.lib.check_request(k, s, height, armed, flying) == bool(right), (
                            ask,
                            state,
                        )


# The whole flight software


def at_rest(t: float) -> Estimate:
    zero = np.zeros(3)
    return Estimate(t, np.array([0.1, -0.2, -0.07]), zero, zero.copy(), zero.copy(), np.full(8, 1.5), 7.4)


class StandIn:
    """A vehicle that follows its reference with a lag, and whatever goes wrong with what is believed of it."""

    def __init__(self, rng: random.Random, judged: bool) -> None:
        self.rng, self.judged, self.t = rng, judged, 0.0
        self.x, self.v, self.psi = np.array([0.1, -0.2, -0.07]), np.zeros(3), 0.3
        self.volts, self.tilt, self.beams = 7.4, 0.0, np.full(8, 1.5)
        self.spread = {"place": 0.01, "height": 0.01, "tilt": 0.01, "heading": 0.02}
        self.status = dict.fromkeys(READINGS_WITH_FUSION_STATUS, "fused")
        self.shake = 0.0
        self.broken = ""
        self.force, self.valid = np.array([0.1, 0.0, -9.8]), True
        self.ceiling, self.held, self.drops, self.sinks = math.inf, False, False, False
        self.post: tuple[float, float] | None = None  # N, E of a round post of 0.1 m radius
        self.last: Estimate | None = None

    def follow(self, software: FlightSoftware, dt: float) -> None:
        self.t += dt
        if software.motors in ("fly", "blind"):
            where, _, attitude = software.reference
            away = where - self.x
            self.v = np.clip(2.0 * away, -0.8, 0.8) + self.shake * np.array([self.rng.uniform(-1, 1) for _ in range(3)])
            self.v *= 0.0 if self.held else 1.0
            if self.drops:
                self.v[2] = 0.7
            self.psi += dt * float(np.clip(2.0 * (attitude[2] - self.psi), -2, 2))
        elif self.x[2] < -0.07:
            self.v = np.array([0.0, 0.0, 0.7])
        else:
            self.v = np.zeros(3)
        self.x = self.x + dt * self.v
        self.x[2] = max(self.x[2], -self.ceiling)
        if self.x[2] > -0.07:
            self.x[2], self.v[2] = -0.07, 0.0
        if self.post is not None:
            ring, north, east = software.plan.beam_ring, self.post[0] - self.x[0], self.post[1] - self.x[1]
            ahead = north * math.cos(self.psi) + east * math.sin(self.psi)
            right = east * math.cos(self.psi) - north * math.sin(self.psi)
            along, across = ahead * ring.cos + right * ring.sin, right * ring.cos - ahead * ring.sin
            hits = (along > 0.0) & (abs(across) < 0.1)
            reach = along - np.sqrt(np.where(hits, 0.01 - across**2, 0.0))
            self.beams = np.where(hits, np.minimum(reach, 1.5), 1.5)

    def believed(self) -> Estimate:
        u = self.rng.uniform
        noise = np.array([u(-1e-3, 1e-3) for _ in range(3)])
        attitude = np.array([u(-0.05, 0.05) + self.tilt, u(-0.05, 0.05), self.psi])
        sinks = np.array([0.0, 0.0, 0.5 * self.sinks])
        m = Estimate(self.t, self.x + noise, self.v + sinks, attitude, 10 * noise, self.beams.copy(), self.volts)
        if self.broken == "frozen" and self.last is not None:
            return replace(self.last, time_s=self.t)
        if self.broken in ("position", "velocity", "attitude", "rates"):
            m = replace(m, **{self.broken: np.array([math.nan, 0.0, 0.0])})
        if self.broken == "all":
            m = replace(m, time_s=math.nan, ranges=np.full(8, math.nan), battery_voltage=-1.0, valid=False)
        if self.judged:
            variance = ZERO_COVARIANCE.copy()
            s = self.spread
            for k, size in (
                (0, s["place"]),
                (1, 0.9 * s["place"]),
                (2, s["height"]),
                (6, s["tilt"]),
                (7, 0.01),
            ):
                variance[k, k] = size * size
            variance[8, 8] = s["heading"] ** 2
            why = {"missing": "nothing has come", "faulty": "clips", "rejected": "is off by 1 m"}
            checks = tuple(SensorStatus(n, k, reason=why.get(k, "")) for n, k in self.status.items() if n != "pressure")
            none = np.zeros(3)
            m = replace(
                m,
                covariance=variance,
                valid=m.valid and self.valid,
                auxiliary_states=AuxiliaryStates(
                    none, none, 0.0, np.zeros(4), np.zeros(2), 1.0, none, checks, self.force
                ),
            )
        self.last = m
        return m


def _happen(kind: str, v: StandIn, n: int) -> Command:
    """What a segment of the flight is about: a command, or something that goes wrong."""
    u = v.rng.uniform
    place = (round(u(-2, 2), 2), round(u(-2, 2), 2), -round(u(0.1, 2), 2))
    commands = {
        "start": Command(start=True),
        "first": Command(start=True, first_waypoint=v.rng.randrange(n)),
        "take-off": Command(take_off_height=round(u(0.3, 2), 2)),
        "pause": Command(pause=True),
        "waypoint": Command(waypoint=place),
        "turned": Command(waypoint=place, heading=round(u(-4, 4), 2)),
        "heading": Command(heading=round(u(-4, 9), 2)),
        "refused": Command(waypoint=v.rng.choice(((math.nan, 0.0, 0.0), (0.0, 0.0, math.nan), (0.0, 0.0, -1e4)))),
        "far": Command(waypoint=(0.0, 2e4, -1.0), heading=v.rng.choice((None, 0.1, math.inf))),
        "home": Command(return_requested=True),
        "land": Command(land=True),
        "stop": Command(motor_stop_reason=v.rng.choice(("emergency stop, motors off", "disarmed"))),
        "sticks": Command(
            rc_active=True,
            pilot_roll=u(-0.1, 0.1),
            pilot_pitch=0.02,
            pilot_yaw_rate=u(-0.5, 0.5),
            pilot_climb_rate=u(-0.6, 0.6),
        ),
        "points": Command(program_set_point=SetPoint(place, yaw_rate_rad_s=u(-0.5, 0.5))),
        "speeds": Command(
            program_set_point=SetPoint(velocity_m_s=(u(-1, 1), u(-1, 1), u(-0.4, 0.4)), heading_rad=u(-4, 4))
        ),
        "nothing": Command(program_set_point=SetPoint()),
    }
    if kind in commands:
        return commands[kind]
    if kind == "stream":  # a target that moves on, with a heading at times
        place = (0.4 * v.t, 1.0 + 0.2 * math.sin(v.t), -1.0 - 0.3 * math.cos(0.7 * v.t))
        return Command(waypoint=place, heading=v.rng.choice((None, None, 0.3 * v.t)))
    if kind == "turns":
        return Command(heading=0.8 * v.t)
    if kind.startswith("asked "):
        return Command(waypoint=tuple(float(w) for w in kind.split()[1:]))
    if kind.startswith("turn "):
        return Command(heading=float(kind.split()[1]))
    if kind in ("roll", "pitch", "yaw_rate", "climb"):  # a stick moves while no pilot flies
        return Command(**{"pilot_climb_rate" if kind == "climb" else f"pilot_{kind}": 0.1})
    if kind == "battery":
        v.volts = v.rng.choice((5.0, 7.4))
    elif kind == "beams":
        v.beams = np.array([v.rng.choice((1.5, 1.5, u(0.15, 1.4))) for _ in range(8)])
    elif kind == "clear":
        v.force, v.valid = np.array([0.1, 0.0, -9.8]), True
        v.beams, v.status, v.broken, v.tilt = (
            np.full(8, 1.5),
            dict.fromkeys(READINGS_WITH_FUSION_STATUS, "fused"),
            "",
            0.0,
        )
        v.spread = {"place": 0.01, "height": 0.01, "tilt": 0.01, "heading": 0.02}
        v.shake = 0.0
    elif kind == "doubt":
        v.spread[v.rng.choice(("place", "place", "height", "tilt", "heading"))] = u(0.1, 0.7)
        v.status[v.rng.choice(READINGS_WITH_FUSION_STATUS)] = v.rng.choice(("missing", "rejected", "faulty", "waiting"))
    elif kind == "contradict":
        for name in v.rng.sample(("position_fix", "ground_distance", "magnetic_field", "rates"), 2):
            v.status[name] = v.rng.choice(("rejected", "missing"))
    elif kind == "broken":
        v.broken = v.rng.choice(("position", "velocity", "attitude", "rates", "frozen", "all", ""))
    elif kind == "lean":
        v.force = np.array([u(-3, 3), u(1, 3), u(-11, -9)])
    elif kind == "invalid":
        v.valid = False
    elif kind == "tipped":
        v.tilt = v.rng.choice((1.2, 0.0))
    elif kind.startswith("spread"):
        _, name, size = kind.split()
        v.spread[name] = float(size)
    elif kind.startswith("wrong"):
        _, name, status = kind.split()
        v.status[name] = status
    elif kind.startswith("volts"):
        v.volts = float(kind.split()[1])
    elif kind == "late":
        v.t += 0.2
    elif kind.startswith("ceiling"):
        v.ceiling = float(kind.split()[1])
    elif kind in ("held", "drops", "sinks"):
        setattr(v, kind, True)
    elif kind.startswith("post"):
        v.post = tuple(float(w) for w in kind.split()[1:])
    elif kind == "shut in":
        v.beams = np.full(8, 0.33)
    elif kind == "shake":
        v.shake = v.rng.choice((0.0, 2.0))
    return Command()


KINDS = (
    "start", "start", "first", "take-off", "take-off", "pause", "waypoint", "turned", "heading", "refused", "far",
    "home", "land", "stop", "sticks", "sticks", "points", "points", "speeds", "nothing", "battery", "beams", "beams",
    "clear", "clear", "clear", "doubt", "contradict", "broken", "tipped", "shake", "wait", "wait", "stream", "stream",
    "turns",
)  # fmt: skip
HELD = ("sticks", "points", "speeds", "nothing")
STREAMED = ("stream", "turns")


def fly_both(software, board, kinds, seed: int, judged: bool, periods: int, step_s: float | None = None) -> set[str]:
    """Fly segments of ``periods`` each by both and compare everything; return the states visited."""
    rng = random.Random(seed)
    v, visited = StandIn(rng, judged), set()
    logged = -1
    for kind in kinds:
        # "this & that": both at once; "this * 20": for so many periods
        what, _, count = kind.partition(" * ")
        for one in what.split(" & "):
            command = _happen(one, v, len(software.plan.mission.waypoint))
        for k in range(int(count or periods)):
            v.follow(software, step_s or rng.choice((0.005, 0.02, 0.02)))
            m, c = v.believed(), command if k == 0 or one in HELD else Command()
            if one in STREAMED and k % 3 == 0:
                c = _happen(one, v, 1)
            ours, theirs = software.step(m, c), board.step(m, c)
            where = f"{kind} at {m.time_s:.3f} s, period {k}"
            assert ours.input_array.tobytes() == theirs.input_array.tobytes(), where
            assert diff_fields(software._reference, board.reference) == [], where
            assert board.firmware.lib.software_flying(board.software_record) == software.flying, where
            if software._late_s == 0.0 or software.mission_state.logged_event_count != logged:
                logged = software.mission_state.logged_event_count
                assert diff_fields(software.mission_state, board.state) == [], where
                assert str(software.oscillation) == str(board.oscillation)
        visited |= {e.state for e in board.state.events} | {software.motors}
    return visited


@settings(max_examples=int(os.environ.get("MUFLY_EXAMPLES", "30")), deadline=None, derandomize=True)
@given(
    kinds=st.lists(st.sampled_from(KINDS), min_size=4, max_size=14), seed=st.integers(0, 2**20),
    mission=st.sampled_from((SQUARE, CURVES, SCANNED)), judged=st.booleans(),
    begin=st.sampled_from(("start", "take-off")),
)  # fmt: skip
def test_any_sequence_of_commands_and_faults_is_the_same(
    firmware, vehicle, controller, kinds, seed, mission, judged, begin
):
    software = FlightSoftware(vehicle, controller, parse_mission(mission))
    board = SoftwareInstance(firmware, controller, software.plan)
    fly_both(software, board, [begin, *["wait"] * 4, *kinds], seed, judged, 80)


FLIES = ("start", *["wait"] * 4)  # of 100 periods of 0.03 s each
UP = ("take-off", *["wait"] * 3)
REFUSED = ("nan 0 -1", "nan 0 -1", "0 inf -1", "0 0 nan", "0 0 -0.01", "0 0 -99", "0 2e4 -1")
STORIES = (
    (
        SQUARE,
        True,
        [*FLIES, *["wait"] * 16],
        "MISSION_COMPLETE_RETURNING WAYPOINT_REACHED HOME_REACHED TOUCHDOWN LANDED",
    ),
    (CURVES, True, [*FLIES, *["wait"] * 16, "start", "wait"], "MISSION_COMPLETE_HOLDING MISSION_BEGINS"),
    (SCANNED, False, [*FLIES, *["wait"] * 10], "MISSION_COMPLETE"),
    (
        SQUARE,
        True,
        [*FLIES, "spread place 0.3", "clear", "wait", "wait"],
        "WAITING_FOR_POSITION POSITION_KNOWN_AGAIN MISSION_CONTINUES",
    ),
    (SQUARE, True, [*FLIES, *["spread place 0.3"] * 5, "wait"], "POSITION_UNCERTAIN_TOO_LONG"),
    (SQUARE, True, [*FLIES, "spread place 0.7", "wait"], "POSITION_UNCERTAIN"),
    (SQUARE, True, [*FLIES, "spread height 0.4"], "HEIGHT_UNCERTAIN"),
    (SQUARE, True, [*FLIES, "spread heading 0.6"], "HEADING_UNCERTAIN"),
    (SQUARE, True, [*FLIES, "spread tilt 0.2", *["wait"] * 4], "ATTITUDE_UNCERTAIN MOTORS_OFF_AFTER_DESCENT"),
    (SQUARE, True, [*FLIES, "wrong rates rejected", "wait"], "GIVEN_TEXT"),
    (SQUARE, False, ["ceiling 0.05", *FLIES], "TAKE_OFF_FAILED"),
    (SQUARE, False, ["ceiling 0.5", *FLIES, "wait", "wait"], "TAKE_OFF_SHORT"),
    (SQUARE, False, [*FLIES, "held", *["wait"] * 12], "WAYPOINT_MISSED"),
    (SQUARE, False, [*FLIES, "sinks", *["wait"] * 12], "WAYPOINT_MISSED"),  # it is there, and believes to be too fast
    (SQUARE, False, [*FLIES, "waypoint", "held", *["wait"] * 14], "USER_WAYPOINT_MISSED"),
    (SQUARE, False, [*FLIES, "home", "held", *["wait"] * 14], "HOME_MISSED"),
    (SQUARE, False, [*FLIES, "land", "drops", "wait", "wait"], "LAND_WITH_WAYPOINTS_LEFT HARD_TOUCHDOWN"),
    (
        SQUARE,
        False,
        [*FLIES, "sinks & land", *["wait"] * 8],
        "LAND_SIGNAL",
    ),  # it believes to sink, and lies on the floor
    (
        SQUARE,
        True,
        [*FLIES, "spread height 0.1", "land", *["wait"] * 2],
        "LAND_SIGNAL TOUCHDOWN",
    ),  # down, as far as it knows
    (SQUARE, False, [*FLIES, "battery", "sticks", "wait"], "RC_ON"),
    (SCANNED, False, [*FLIES, "shut in", *["wait"] * 8], "BLOCKED_BY_OBSTACLE"),
    # Once on the way to the mission's waypoint, once to the user's.
    (AROUND, False, ["post 1.6 -0.1", *FLIES, *["wait"] * 12], "OBSTACLE_AHEAD OBSTACLE_AVOIDED WAYPOINT_REACHED"),
    (
        AROUND,
        False,
        ["post 1.6 -0.1", *UP, "asked 3 0 -1", *["wait"] * 12],
        "OBSTACLE_AHEAD OBSTACLE_AVOIDED USER_WAYPOINT_REACHED",
    ),
    (SCANNED, False, [*UP, "turn 0.5", "wait"], "TURNING_TO_HEADING"),
    (SQUARE, False, [*UP, *["stream"] * 4, *["wait"] * 4], "TO_USER_WAYPOINT USER_WAYPOINT_REACHED"),
    (SQUARE, False, [*UP, "waypoint * 40", "turns", "turned * 40", "turned", *["wait"] * 4], "USER_WAYPOINT_REACHED"),
    (SCANNED, False, [*UP, "stream", "beams", *["stream"] * 4, "clear", *["wait"] * 4], "TO_USER_WAYPOINT"),
    (SQUARE, True, ["invalid", "start", "take-off", "sticks", "speeds", "clear", *UP], "ESTIMATE_NOT_VALID"),
    (SQUARE, True, ["lean", "start", "take-off", "speeds", "clear", *UP], "STANDS_TILTED ALTITUDE_REACHED"),
    (SQUARE, False, [*UP, *(f"asked {w} * 4" for w in REFUSED)], "USER_WAYPOINT_TOO_LOW USER_WAYPOINT_TOO_FAR"),
    (SQUARE, False, [*UP, *(f"{w} * 5" for w in ("roll", "pitch", "yaw_rate", "climb", "late"))], "ALTITUDE_REACHED"),
    (SQUARE, False, [*UP, "ceiling 0.05", "points", "wait"], "OFFBOARD_OFF_ON_FLOOR LANDED"),
    (NEAR, False, [*FLIES, "wait", "ceiling 0.05", "points", "wait"], "MISSION_COMPLETE_HOLDING OFFBOARD_OFF_ON_FLOOR"),
    (NEAR, False, [*FLIES, "wait", "volts 5.0", "wait"], "MISSION_COMPLETE_HOLDING BATTERY_LOW"),
    (NEAR, True, [*FLIES, "wait", "land * 10", "pause", "start", "wait"], "LANDING_ABORTED MISSION_BEGINS"),
    (SQUARE, True, [*UP, "spread place 0.3", *["spread place 0.2"] * 4], "POSITION_UNCERTAIN_TOO_LONG"),
    (SQUARE, True, ["take-off * 150", "spread place 0.3"], "POSITION_UNCERTAIN"),
    (
        SQUARE,
        True,
        [*FLIES, "spread place 0.3 * 30", "waypoint * 20", "clear"],
        "WAITING_FOR_POSITION TO_USER_WAYPOINT",
    ),
    (PATIENT, True, [*FLIES, "pause * 20", "spread place 0.3 * 30", "clear"], "MISSION_PAUSED POSITION_UNCERTAIN"),
    (PATIENT, True, [*FLIES, "spread place 0.3 * 30", "start", "clear"], "WAITING_FOR_POSITION MISSION_BEGINS"),
    (CURVES, False, [*FLIES, *["first"] * 6], "ON_TO_WAYPOINT"),
    (SQUARE, False, [*["points"] * 6], "OFFBOARD_ON"),
    (HEEDLESS, False, [*UP, "beams", *["points"] * 3, "clear", "wait"], "OFFBOARD_ON OFFBOARD_OFF"),
    (SQUARE, False, [*UP, "asked 0.1 0 -3 * 90", "asked 0.1 0 -1 * 20", *["wait"] * 3], "USER_WAYPOINT_REACHED"),
    (
        SCANNED,
        True,
        [*FLIES, "shut in", "wait * 115", "spread place 0.3 * 40"],
        "BLOCKED_BY_OBSTACLE POSITION_UNCERTAIN",
    ),
    (
        SQUARE,
        True,
        [*UP, "sticks * 20", "spread place 0.3 & sticks", "clear & sticks"],
        "POSITION_UNCERTAIN POSITION_KNOWN_AGAIN",
    ),
)


@pytest.mark.parametrize("story", STORIES, ids=lambda s: s[3].replace(" ", "-").lower())
def test_what_can_happen_is_said_in_the_same_words(firmware, vehicle, controller, story) -> None:
    mission, judged, kinds, words = story
    software = FlightSoftware(vehicle, controller, parse_mission(mission))
    board = SoftwareInstance(firmware, controller, software.plan)
    fly_both(software, board, kinds, 1, judged, 100, 0.03)
    said = [*(e.text for e in board.state.events), board.state.reason]
    for name in words.split():
        begins = LogTemplate[name].value.split("{", 1)[0]
        assert any(text.startswith(begins) for text in said), (name, said)


@pytest.mark.parametrize("before", [["wait * 2"], UP], ids=["on-the-floor", "in-flight"])
def test_another_mission_that_is_loaded_is_the_same(firmware, vehicle, controller, before) -> None:
    software = FlightSoftware(vehicle, controller, parse_mission(SQUARE))
    board = SoftwareInstance(firmware, controller, software.plan)
    fly_both(software, board, before, 1, False, 100, 0.03)
    for mission, said in ((CURVES, "curves: 3 waypoints loaded"), (NEAR, "near: 1 waypoint loaded")):
        software.load_mission(parse_mission(mission))
        board.write_mission_plan(software.plan)
        board.reset_mission_state(mission["name"])
        assert board.state.events[-1].text == software.mission_state.events[-1].text == said
        assert diff_fields(software.mission_state, board.state) == []


# Boards: what of them can be had without one


def test_templates_of_boards_compile_and_four_motors_turn_as_two_do(tmp_path, vehicle, controller) -> None:
    export_firmware(controller, tmp_path, vehicle, mission=parse_mission(SQUARE))
    strict = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror", "-I.")
    onboard = [f"../{p.relative_to(tmp_path)}" for p in find_sources(tmp_path, ONBOARD_SOURCES)]
    for name in ("board.c", "board_loop.c", "stm32/stm32.c", "crazyflie/four_motors.c", *onboard):
        done = subprocess.run(
            [find_compiler(), "-std=c99", "-DREGISTER_MODEL", *strict, "-c", f"boards/{name}", "-o", "out.o"],
            cwd=tmp_path, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    ffi = cffi.FFI()
    ffi.cdef(
        "typedef struct { double motor_input[2], servo_input[2]; } actuators_t;"
        "typedef struct { double yaw, pitch, roll; } four_motors_t;"
        "void four_motors_mix(const four_motors_t *g, const actuators_t *in, double out[4]);"
    )
    command = [
        find_compiler(),
        "-std=c99",
        "-I.",
        "-shared",
        "-fPIC",
        "boards/crazyflie/four_motors.c",
        "real.c",
        "-o",
        "four.so",
    ]
    subprocess.run([*command, "-lm"], cwd=tmp_path, check=True)
    lib, out = ffi.dlopen(str(tmp_path / "four.so")), ffi.new("double[4]")
    gains = ffi.new("four_motors_t *", [0.5, 0.2, 0.2])

    def mixed(upper, lower, nose_down, right):
        lib.four_motors_mix(gains, ffi.new("actuators_t *", [[upper, lower], [nose_down, right]]), out)
        return np.array(list(out))

    # Front left, front right, rear right, rear left; the first and third turn clockwise, and so the body to the left.
    x, y, drag = np.array([1, 1, -1, -1]), np.array([-1, 1, 1, -1]), np.array([-1, 1, -1, 1])
    for upper, lower, nose_down, right in np.random.default_rng(5).uniform(
        [0.4, 0.4, -1, -1], [0.6, 0.6, 1, 1], (50, 4)
    ):
        f = mixed(upper, lower, nose_down, right)
        assert f.mean() == pytest.approx(0.5 * (upper + lower))
        assert -x @ f == pytest.approx(4 * 0.2 * nose_down)
        assert -y @ f == pytest.approx(4 * 0.2 * right)
        assert drag @ f == pytest.approx(4 * 0.5 * (upper - lower))  # the upper rotor's torque turns it to the right
    for one in np.random.default_rng(6).uniform([0, 0, -1, -1], [1, 1, 1, 1], (300, 4)):
        f = mixed(*one)
        assert (f >= 0.0).all()
        assert (f <= 1.0).all()
