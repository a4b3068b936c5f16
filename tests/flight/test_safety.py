"""Whatever is asked of the autopilot, with whatever arguments: actuators stay finite and in range, off unless armed."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mufly.control import FlightController, design_flight_controller
from mufly.flight import Flight, RequestAnswer, SetPoint
from mufly.mission import Mission, load_mission, parse_mission
from mufly.vehicle import Vehicle, load_vehicle

VEHICLE: Vehicle = load_vehicle("mufly-1.1")
MISSIONS = [
    parse_mission({"waypoint": [{"position_m": [0.5, 0.2, -0.7], "wait_s": 0.5}], "at_end": "return"}),
    load_mission("box-on-leg"),
    Mission(name="none"),
    Mission(waypoint=({"position_m": (0.0, 0.0, 5.0)},)),
]


@pytest.fixture(scope="module")
def controller() -> FlightController:
    return design_flight_controller(VEHICLE)


wild = st.one_of(
    st.floats(-2.0, 2.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, 1e308, -1e308, math.nan, math.inf, -math.inf, 1e-320]),
)
triples = st.tuples(wild, wild, wild)
sane = st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-2.0, -0.3))
maybe = st.one_of(st.none(), wild)
NAMES = ["LIM_SPEED", "LIM_CLIMB_ACC", "CTL_POS_GAIN", "CTL_TILT_MAX", "CTL_HEAVE_BW", "CTL_YAW_ACC"]
NAMES += ["AVD_ENABLE", "BAT_LOW_V", "MIS_TAKEOFF_ALT", "STK_TILT", "NONSENSE", "\0" * 99]
names = st.sampled_from(NAMES)
numbers = st.one_of(st.floats(0.0, 20.0), wild)

CALLS = st.one_of(
    *[
        st.tuples(st.just(name))
        for name in (
            "arm",
            "start_mission",
            "pause",
            "land",
            "return_home",
            "release_sticks",
            "reset",
            "take_off",
        )
    ],
    st.tuples(st.just("arm")),
    st.tuples(st.just("take_off"), st.floats(0.2, 1.5)),
    st.tuples(st.just("take_off"), wild),
    st.tuples(st.just("disarm"), st.booleans()),
    st.tuples(st.just("start_mission"), st.integers(-3, 5)),
    st.tuples(st.just("go_to"), st.one_of(sane, triples), maybe),
    st.tuples(st.just("turn_to"), wild),
    st.tuples(st.just("set_speed"), wild),
    st.tuples(st.just("set_offboard"), st.booleans()),
    st.tuples(
        st.just("send_set_point"),
        st.builds(SetPoint, st.one_of(st.none(), sane, triples), st.one_of(st.none(), triples), maybe, maybe),
    ),
    st.tuples(st.just("set_sticks"), wild, wild, wild, wild),
    st.tuples(st.just("set_sticks"), *[st.floats(-0.5, 0.5)] * 4),
    st.tuples(st.just("load_mission"), st.sampled_from(MISSIONS)),
    st.tuples(st.just("set_parameter"), names, numbers),
    st.tuples(st.just("emergency_stop")),
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(CALLS, st.floats(0.005, 4.0)), min_size=3, max_size=14),
    st.sampled_from(MISSIONS[:2]),
    st.booleans(),
)
def test_whatever_is_asked(controller, script, mission, already_flying):
    flight = Flight(VEHICLE, mission, controller=controller, keep=False, gust=0.3)
    autopilot = flight.autopilot
    armed_before = False

    def run(seconds):
        nonlocal armed_before
        sent, armed, references = [], [], []
        for _ in range(max(1, round(seconds / flight.period_s))):
            flight.step_period()
            now = autopilot.status
            sent.append(flight.sent_actuators.input_array)  # what was computed now; it acts a period later
            armed.append(now.armed)
            references.append(
                np.concatenate((now.reference_position, now.reference_velocity, now.reference_attitude), axis=None)
            )
        sent, armed = np.array(sent), np.array(armed)
        assert np.isfinite(sent).all()
        assert ((sent >= [0.0, 0.0, -1.0, -1.0]) & (sent <= 1.0)).all()
        assert (sent[~armed & ~np.append(armed_before, armed[:-1])] == 0.0).all()
        assert np.isfinite(references).all()
        assert flight.status.battery_left_s >= 0.0
        armed_before = armed[-1]

    run(0.05)
    if already_flying:
        assert autopilot.arm()
        assert autopilot.take_off(0.6)
        run(5.5)
    for (name, *arguments), seconds in script:
        if name == "reset":
            flight.reset()
            continue
        answer = getattr(autopilot, name)(*arguments)
        assert isinstance(answer, RequestAnswer)
        assert answer or answer.reason
        if name in ("send_set_point", "set_sticks"):
            seconds = min(seconds, 0.4)
        run(seconds)
    assert autopilot.emergency_stop()
    run(0.01)
    assert (flight.sent_actuators.input_array == 0.0).all()
    assert not autopilot.status.armed
