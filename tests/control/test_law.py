"""Properties of the law on board."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.control import (
    FlightController,
    heave_yaw_init,
    heave_yaw_step,
    limit_heave_reference,
    position_init,
    position_step,
    roll_pitch_init,
    roll_pitch_step,
)
from mufly.control.law import FILTERED_W_INDEX, FILTERED_Z_INDEX, ROLL_PITCH_GAINS_DTYPE, pack_gains
from mufly.errors import MuflyError

INPUT = st.floats(0.0, 1.0)


@given(INPUT, INPUT, st.floats(5.5, 8.4), st.floats(-5, 0), st.floats(-20, 20), st.floats(-0.5, 0.5))
@settings(max_examples=60, deadline=None, suppress_health_check=[])
def test_engages_without_a_bump(upper, lower, volts, z, psi, r):
    g = CONTROLLER.heave_yaw_gains
    measured = np.array([z, psi, r])
    state = heave_yaw_init(g, measured, np.array([upper, lower]), volts)
    motor, _ = heave_yaw_step(g, state, np.array([z, psi, 0.0, 0.0]), measured, volts)
    np.testing.assert_allclose(motor, [upper, lower], atol=2e-3)


@given(st.floats(-10, 10), st.floats(-30, 30), st.floats(-20, 20), st.floats(3.0, 10.0), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_outputs_stay_in_their_ranges_and_yaw_goes_first(dz, dpsi, r, volts, seed):
    g = CONTROLLER.heave_yaw_gains
    rng = np.random.default_rng(seed)
    state = heave_yaw_init(g, np.zeros(3), np.array([0.67, 0.73]), 7.2)
    state[:10] += rng.normal(size=10)
    motor, new = heave_yaw_step(g, state, np.array([dz, dpsi, 0.0, 0.0]), np.array([-dz, -dpsi, r]), volts)
    assert np.all(motor >= 0.0)
    assert np.all(motor <= 1.0)
    assert np.all(np.isfinite(new))
    # The difference asked for is granted as far as the range allows, whatever the mean.
    e = np.array([new[10], new[12], dz, dpsi, -r])
    u = g["C"] @ state[:10] + g["D"] @ e + g["trim"]
    top = new[16] / g["design_voltage"]
    asked = u[1] - u[0]
    granted = (motor[0] - motor[1]) * top
    assert granted == pytest.approx(np.clip(asked, -top, top), abs=1e-9)


def test_rounding_takes_no_input_out_of_its_range(controller: FlightController) -> None:
    """At the upper end of the range a sum may come out a last digit above 1."""
    g = controller.heave_yaw_gains
    rng = np.random.default_rng(0)
    extremes = []
    for _ in range(3000):
        volts = rng.uniform(5.5, 8.4)
        state = heave_yaw_init(g, np.zeros(3), np.array([0.67, 0.73]), volts)
        state[:10] += rng.normal(size=10)
        motor, _ = heave_yaw_step(g, state, np.zeros(4), rng.normal(size=3), volts)
        extremes.append((motor.min(), motor.max()))
    least, greatest = np.array(extremes).T
    assert least.min() >= 0.0
    assert greatest.max() == 1.0


def test_arguments_are_left_alone(controller: FlightController) -> None:
    g = controller.heave_yaw_gains
    state = heave_yaw_init(g, np.zeros(3), np.array([0.6, 0.6]), 7.0)
    reference, measured, before = np.ones(4), np.zeros(3), state.copy()
    heave_yaw_step(g, state, reference, measured, 7.0)
    np.testing.assert_array_equal(state, before)
    np.testing.assert_array_equal(reference, np.ones(4))


def test_heave_yaw_does_not_see_where_it_started(controller: FlightController) -> None:
    """Height and heading at which it is engaged drop out."""
    g = controller.heave_yaw_gains
    runs = []
    for z, psi in ((0.0, 0.0), (-7.0, 40.0)):
        state = heave_yaw_init(g, np.array([z, psi, 0.0]), np.array([0.67, 0.73]), 7.2)
        outputs = []
        for k in range(50):
            motor, state = heave_yaw_step(
                g,
                state,
                np.array([z - 0.3, psi + 0.2, 0, 0]),
                np.array([z - 0.004 * k, psi + 0.002 * k, 0.4]),
                7.2,
            )
            outputs.append(motor)
        runs.append(np.array(outputs))
    np.testing.assert_allclose(runs[0], runs[1], atol=1e-9)


def test_the_motors_get_the_same_voltage_from_any_battery(controller: FlightController) -> None:
    g = controller.heave_yaw_gains
    voltages = []
    for volts in (7.0, 7.6):
        inputs = controller.motor_trim * controller.voltage_V / volts
        state = heave_yaw_init(g, np.zeros(3), inputs, volts)
        for _ in range(20):
            motor, state = heave_yaw_step(g, state, np.array([-0.05, 0.0, 0, 0]), np.zeros(3), volts)
        voltages.append(motor * volts)
    np.testing.assert_allclose(voltages[0], voltages[1], rtol=1e-6)


def test_a_broken_voltage_sensor_does_not_cut_the_motors(controller: FlightController) -> None:
    g = controller.heave_yaw_gains
    state = heave_yaw_init(g, np.zeros(3), controller.motor_trim, controller.voltage_V)
    for _ in range(200):
        motor, state = heave_yaw_step(g, state, np.zeros(4), np.zeros(3), 0.0)
    assert np.all(motor > 0.5)
    assert np.all(motor <= 1.0)


@given(st.floats(-4, 4), st.floats(-6, 6))
@settings(max_examples=30, deadline=None)
def test_reference_filter_arrives_without_overshoot_within_its_limits(dz, dpsi):
    g = CONTROLLER.heave_yaw_gains
    T, a, v = float(g["period"]), float(g["heave_acceleration"]), float(g["heave_speed"])
    state = heave_yaw_init(g, np.zeros(3), np.array([0.67, 0.73]), 7.2)
    rows = []
    for _ in range(int(14 / T)):
        _, state = heave_yaw_step(g, state, np.array([dz, dpsi, 0.0, 0.0]), state[[10, 12, 13]], 7.2)
        rows.append(state[10:14].copy())
    path = np.array(rows)
    for target, value in ((dz, path[:, 0]), (dpsi, path[:, 2])):
        assert value[-1] == pytest.approx(target, abs=1e-3 + 1e-3 * abs(target))
        assert np.max(value * np.sign(target)) <= abs(target) * 1.002 + 1e-4
    assert np.abs(path[:, 1]).max() <= v + 1e-12
    assert np.abs(np.diff(path[:, 1])).max() <= a * T + 1e-12


def test_reference_filter_follows_a_reference_that_brings_its_rate(controller: FlightController) -> None:
    g = controller.heave_yaw_gains
    T = float(g["period"])
    state = heave_yaw_init(g, np.zeros(3), np.array([0.67, 0.73]), 7.2)
    peak = 0.4  # m/s2
    worst = 0.0
    for k in range(int(6 / T)):
        t = (k + 1) * T
        z, w = -peak * (t - np.sin(t)), -peak * (1 - np.cos(t))
        _, state = heave_yaw_step(g, state, np.array([z, 0.0, w, 0.0]), np.zeros(3), 7.2)
        worst = max(worst, abs(state[10] - z))
    assert worst < 1.2 * peak / float(g["heave_bandwidth"]) ** 2 + peak * T


@pytest.mark.parametrize(("climb", "asked", "least"), [(0.25, 0.5, 0.6), (0.1, 0.4, 0.6), (-0.25, -0.5, 0.4)])
def test_a_reference_that_waits_does_not_cut_the_motors(
    controller: FlightController, climb: float, asked: float, least: float
) -> None:
    """A heavy vehicle climbs as fast as it can, its reference faster: the motors stay where they hold it up.

    They lost all thrust in one period where the reference stopped at once, and its rate with it.
    """
    g = controller.heave_yaw_gains
    period = float(g["period"])
    state = heave_yaw_init(g, np.zeros(3), np.array([0.85, 0.93]), 6.5)
    inputs, gaps = [], []
    for k in range(800):
        z = -climb * k * period
        state = limit_heave_reference(g, state, z)
        gaps.append(abs(z - state[FILTERED_Z_INDEX]))
        reference = np.array([-asked * k * period, 0.0, -asked, 0.0])
        motor, state = heave_yaw_step(g, state, reference, np.array([z, 0.0, 0.0]), 6.5)
        inputs.append(motor)
    assert max(gaps) < float(g["heave_tracking_error_limit"])
    assert state[FILTERED_W_INDEX] == pytest.approx(-climb, abs=0.02)  # it follows, as fast as the vehicle climbs
    flown = np.array(inputs)[100:]
    assert np.abs(np.diff(flown, axis=0)).max() < 0.1
    assert flown.min() > least


def test_a_vehicle_that_is_blown_away_finds_its_reference_at_the_slack(controller: FlightController) -> None:
    g = controller.heave_yaw_gains
    slack = float(g["heave_tracking_error_limit"])
    state = heave_yaw_init(g, np.zeros(3), np.array([0.67, 0.73]), 7.2)
    for z in (0.5 * slack, -0.5 * slack):  # a reference at rest may stay where it is
        assert np.array_equal(limit_heave_reference(g, state, z), state)
    for z in (2.0, -2.0):
        blown = limit_heave_reference(g, state, z)
        assert abs(z - blown[FILTERED_Z_INDEX]) == pytest.approx(slack)
        assert blown[FILTERED_W_INDEX] == 0.0
        # The way to the vehicle is free, the way from it only as fast as it brakes.
        towards = state.copy()
        towards[FILTERED_W_INDEX] = np.copysign(0.5, z)
        assert limit_heave_reference(g, towards, z)[FILTERED_W_INDEX] == towards[FILTERED_W_INDEX]
        braked = limit_heave_reference(g, np.where(np.arange(len(state)) == FILTERED_W_INDEX, -towards, state), z)[
            FILTERED_W_INDEX
        ]
        brake = 2.0 * float(g["heave_acceleration"]) * float(g["period"])
        assert abs(braked) == pytest.approx(0.5 - brake)


@given(st.floats(-np.pi, np.pi), st.integers(0, 500))
@settings(max_examples=40, deadline=None)
def test_position_cascade_turns_with_the_world(angle: float, seed: int) -> None:
    """Turning all vectors and the heading by one angle leaves the tilt as it is."""
    g = CONTROLLER.position_gains
    rng = np.random.default_rng(seed)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    one, other = position_init(g), position_init(g)
    for _ in range(8):
        vectors = [rng.normal(size=3) * 0.3 for _ in range(5)]
        heading = rng.uniform(-3, 3)
        tilt, one = position_step(g, one, *vectors, heading)
        turned, other = position_step(g, other, *(turn @ v for v in vectors), heading + angle)
        np.testing.assert_allclose(turned, tilt, atol=1e-6)
        assert np.hypot(*tilt) <= float(g["tilt_limit"]) + 1e-12


def test_signs_of_the_cascade(controller: FlightController) -> None:
    """North of here: nose down. East of here: roll right. At heading east, north is to the left."""
    g, zero = controller.position_gains, np.zeros(3)
    north, _ = position_step(g, position_init(g), np.array([1.0, 0, 0]), zero, zero, zero, zero, 0.0)
    east, _ = position_step(g, position_init(g), np.array([0, 1.0, 0]), zero, zero, zero, zero, 0.0)
    turned, _ = position_step(g, position_init(g), np.array([1.0, 0, 0]), zero, zero, zero, zero, np.pi / 2)
    assert north[1] < 0
    assert abs(north[0]) < 1e-6
    assert east[0] > 0
    assert abs(east[1]) < 1e-6
    assert turned[0] < 0
    assert abs(turned[1]) < 1e-6
    forward, _ = position_step(g, position_init(g), zero, zero, np.array([1.0, 0, 0]), zero, zero, 0.0)
    assert forward[1] == pytest.approx(-1.0 / 9.81)


def test_servos_stop_at_their_limits_on_the_right_side(controller: FlightController) -> None:
    g = controller.roll_pitch_gains
    state = roll_pitch_init(g, np.zeros(4))
    for _ in range(400):
        servo, state = roll_pitch_step(g, state, np.array([0.3, -0.3]), np.zeros(4))
        assert np.all(np.abs(servo) <= 1.0)
        assert np.all(np.isfinite(state))
    assert servo[0] == 1.0  # nose down
    assert servo[1] == 1.0  # right


def test_what_the_servos_did_not_do_goes_back_to_the_controller(controller: FlightController) -> None:
    g = controller.roll_pitch_gains
    state = np.random.default_rng(3).normal(size=8)
    reference, measured = np.array([0.1, -0.2]), np.array([-2.0, 1.5, -5.0, 4.0])
    servo, new = roll_pitch_step(g, state, reference, measured)
    e = np.concatenate([reference, [0.0, 0.0]]) - measured
    wanted = g["C"] @ state + g["D"] @ e + g["trim"]
    assert np.abs(wanted).max() > 1.0
    excess = servo - wanted
    np.testing.assert_allclose(new, state + g["F"] @ state + g["B"] @ e + g["M"] @ excess, rtol=1e-9, atol=1e-12)
    assert np.abs(g["M"] @ excess).max() > 1e-3


def test_tilt_beyond_the_limit_goes_back_to_the_controller(controller: FlightController) -> None:
    g = controller.position_gains
    state = np.random.default_rng(4).normal(size=6)
    zero, far = np.zeros(3), np.array([3.0, -4.0, 0.0])
    tilt, new = position_step(g, state, far, zero, zero, zero, zero, 0.0)
    e = far[:2] * g["speed_limit"] / 5.0
    wanted = g["C"] @ state + g["D"] @ e
    assert np.linalg.norm(wanted) > g["tilt_limit"]
    assert np.linalg.norm(tilt) == pytest.approx(float(g["tilt_limit"]))
    np.testing.assert_allclose(
        new, state + g["F"] @ state + g["B"] @ e + g["M"] @ (tilt - wanted), rtol=1e-9, atol=1e-12
    )


def test_padding_changes_nothing(controller: FlightController) -> None:
    c = controller.roll_pitch.discrete
    g = controller.roll_pitch_gains
    rng = np.random.default_rng(1)
    x, state = np.zeros(c.order), roll_pitch_init(g, np.zeros(4))
    for _ in range(30):
        m = rng.normal(size=4) * 1e-3
        u = c.C @ x - c.D @ m
        x = c.A @ x - c.B @ m
        servo, state = roll_pitch_step(g, state, np.zeros(2), m)
        np.testing.assert_allclose(servo, u + np.asarray(g["trim"]), atol=1e-12)


def test_a_controller_too_large_for_its_record(controller: FlightController) -> None:
    with pytest.raises(MuflyError, match="does not fit"):
        pack_gains(ROLL_PITCH_GAINS_DTYPE, controller.heave_yaw.discrete)


CONTROLLER: FlightController


@pytest.fixture(autouse=True)
def _share(controller: FlightController) -> None:
    """Hypothesis runs a test many times with one fixture: the session's controller, as a module constant."""
    global CONTROLLER
    CONTROLLER = controller
