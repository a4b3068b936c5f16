"""Trajectories: yaw and height first, limits, continuity, degenerate legs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.mission import TrajectoryLimits, plan_straight
from mufly.mission.trajectory import plan_pending_curve, plan_stop, wrap_turn

LIMITS = TrajectoryLimits(0.6, 0.5, 0.4, 0.5, 0.5, 1.0, 2.0)
place = st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, -0.2))
angle = st.floats(-10.0, 10.0)


def sample(trajectory, count=600):
    times = np.linspace(0.0, trajectory.duration_s, count)
    points = [trajectory.evaluate(float(t)) for t in times]
    return times, *(np.array([p[k] for p in points]) for k in range(5))


@settings(max_examples=60)
@given(place, place, angle, st.none() | angle, st.booleans())
def test_ends_limits_and_heading(a, b, psi, final, spline):
    if spline:
        leaving, arriving = (1.0, 0.2, 0.0), (0.3, -1.0, 0.1)
        way = plan_pending_curve(a, b, leaving, arriving, psi, LIMITS, final_heading=final).finish_curve()
    else:
        way = plan_straight(a, b, psi, LIMITS, final_heading=final)
    _, x, v, w, heading, rate = sample(way)
    np.testing.assert_allclose(x[0], a, atol=1e-6)
    end = way.evaluate(way.duration_s + 1e-9)
    np.testing.assert_allclose(end.position, b, atol=2e-3)
    np.testing.assert_allclose(end.velocity, 0.0, atol=1e-9)
    assert np.linalg.norm(v[:, :2], axis=1).max() <= 0.6 * 1.01
    assert -v[:, 2].min() <= 0.5 * 1.01
    assert v[:, 2].max() <= 0.4 * 1.01
    assert np.linalg.norm(w, axis=1).max() <= 0.5 * 1.02
    assert np.abs(rate).max() <= 1.0 + 1e-9
    assert heading[0] == pytest.approx(psi)
    assert abs(heading[-1] - psi) <= math.pi + 1e-9
    if final is not None:
        assert math.cos(heading[-1] - final) == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=60)
@given(place, place, angle)
def test_height_and_heading_come_first(a, b, psi):
    way = plan_straight(a, b, psi, LIMITS)
    before = way.evaluate(way.path_start_s * (1 - 1e-12))
    np.testing.assert_allclose(before.position[:2], a[:2], atol=1e-12)
    assert before.position[2] == pytest.approx(b[2], abs=1e-6)
    gate = way.evaluate(way.path_start_s)
    np.testing.assert_allclose(gate.velocity, 0.0, atol=1e-9)
    flat = np.array(b[:2]) - np.array(a[:2])
    if np.linalg.norm(flat) > 0.01:
        nose = np.array([math.cos(gate.heading), math.sin(gate.heading)])
        assert nose @ flat == pytest.approx(np.linalg.norm(flat), rel=1e-6)


@settings(max_examples=60)
@given(place, place, angle)
def test_velocity_acceleration_and_rate_are_derivatives(a, b, psi):
    way = plan_straight(a, b, psi, LIMITS)
    h = 1e-5
    for share in (0.1, 0.33, 0.5, 0.77):
        t = share * way.duration_s
        after, before, now = way.evaluate(t + h), way.evaluate(t - h), way.evaluate(t)
        for k, tolerance in ((0, 1e-6), (1, 2e-4)):
            slope = (np.array(after[k]) - np.array(before[k])) / (2 * h)
            np.testing.assert_allclose(slope, now[k + 1], atol=tolerance)
        assert (after.heading - before.heading) / (2 * h) == pytest.approx(now.heading_rate, abs=1e-6)


@given(place, place, angle, st.floats(-math.pi, math.pi), st.floats(-3, 3), st.floats(-3, 3))
def test_turning_and_moving_the_frame_changes_nothing(a, b, psi, turn, dn, de):
    def move(p):
        c, s = math.cos(turn), math.sin(turn)
        return c * p[0] - s * p[1] + dn, s * p[0] + c * p[1] + de, p[2]

    one, other = plan_straight(a, b, psi, LIMITS), plan_straight(move(a), move(b), psi + turn, LIMITS)
    if math.hypot(b[0] - a[0], b[1] - a[1]) < 0.01 or abs(abs(one.turn_angle) - math.pi) < 1e-6:
        return
    assert other.duration_s == pytest.approx(one.duration_s, rel=1e-6)
    t = 0.6 * one.duration_s
    np.testing.assert_allclose(other.evaluate(t).position, move(one.evaluate(t).position), atol=1e-6)
    assert other.evaluate(t).heading == pytest.approx(one.evaluate(t).heading + turn, abs=1e-6)


def test_vertical_and_empty_legs():
    up = plan_straight((1, 2, -1), (1, 2, -3), 0.7, LIMITS)
    assert up.path_profile.duration_s == 0.0
    assert up.evaluate(up.duration_s).heading == 0.7
    np.testing.assert_allclose(up.evaluate(up.duration_s / 2).position, (1, 2, -2))
    nothing = plan_straight((1, 2, -1), (1, 2, -1), 0.7, LIMITS)
    assert nothing.duration_s == 0.0
    assert nothing.evaluate(3.0).position == (1, 2, -1)
    turn = plan_straight((1, 2, -1), (1, 2, -1), 0.7, LIMITS, final_heading=2.0)
    assert turn.evaluate(turn.duration_s).heading == pytest.approx(2.0)
    bent = plan_pending_curve((1, 2, -1), (4, 2, -1), (1, 1, 0), (1, -1, 0), 0.7, LIMITS).finish_curve()
    assert max(bent.evaluate(0.1 * k * bent.duration_s).position[1] for k in range(11)) > 2.3
    same = plan_pending_curve((1, 2, -1), (1, 2, -1), (1, 0, 0), (0, 1, 0), 0.7, LIMITS).finish_curve()
    assert same.spline_curve is None
    assert same.duration_s == 0.0


def test_heading_goes_the_short_way_and_does_not_jump():
    # From 170 degrees to -170 degrees it turns by 20, past 180.
    way = plan_straight((0, 0, -1), (0, 0, -1), math.radians(170), LIMITS, final_heading=math.radians(-170))
    assert way.evaluate(way.duration_s).heading == pytest.approx(math.radians(190))
    # Many turns ago or not, a heading is continued from where it is.
    way = plan_straight((0, 0, -1), (5, 0, -1), 4 * math.pi + 0.1, LIMITS)
    assert way.evaluate(way.duration_s).heading == pytest.approx(4 * math.pi)
    assert wrap_turn(math.radians(350)) == pytest.approx(math.radians(-10))


def test_nose_offset_points_past_the_line():
    way = plan_straight((0, 0, -1), (0, 5, -1), 0.0, LIMITS, nose_offset=-math.pi / 8)
    assert way.evaluate(way.duration_s).heading == pytest.approx(math.pi / 2 - math.pi / 8)


@given(place, st.tuples(*[st.floats(-1, 1)] * 3))
def test_stopping(x, v):
    brake = plan_stop(x, v, 0.3, 1.0)
    start, end = brake.evaluate(0.0), brake.evaluate(math.inf)
    np.testing.assert_allclose(start.position, x)
    np.testing.assert_allclose(start.velocity, v, atol=1e-12)
    np.testing.assert_allclose(end.velocity, 0.0)
    samples = [brake.evaluate(k / 50 * brake.duration_s) for k in range(51)]
    assert max(np.linalg.norm(p.acceleration) for p in samples) <= 1.0 + 1e-9
    np.testing.assert_allclose(end.position, np.array(x) + 0.5 * brake.duration_s * np.array(v), atol=1e-12)
    assert brake.evaluate(1e9) == brake.evaluate(math.inf)
