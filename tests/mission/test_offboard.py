"""The reference that follows set-points: within its limits whatever they are, and where they say in the end."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.mission import (
    MAX_HEIGHT_M,
    MIN_WAYPOINT_HEIGHT_M,
    SetPoint,
    TrajectoryLimits,
    describe_set_point_fault,
    needs_lift_off,
)
from mufly.mission.machine.offboard import follow_set_point
from mufly.mission.trajectory import TrajectoryPoint

LIMITS = TrajectoryLimits(0.6, 0.5, 0.4, 0.4, 0.3, 1.0, 1.6)
DT = 0.02
ZERO = (0.0, 0.0, 0.0)
NAN = math.nan


def at_rest(position=(0.0, 0.0, -1.0), heading=0.0) -> TrajectoryPoint:
    return TrajectoryPoint(position, ZERO, ZERO, heading, 0.0)


def run(set_points, start=None, limits=LIMITS, dt=DT, behind=None, hold_off=None):
    """Follow set-points (one a step); the helicopter is where the reference is, unless ``behind`` says otherwise."""
    trackers = [start or at_rest()]
    for s in set_points:
        t = trackers[-1]
        trackers.append(follow_set_point(t, s, limits, behind or t.position, dt, hold_off))
    return trackers


def series(trackers):
    return (
        np.array([t.position for t in trackers]),
        np.array([t.velocity for t in trackers]),
        np.array([t.heading for t in trackers]),
        np.array([t.heading_rate for t in trackers]),
    )


def check_limits(trackers, limits=LIMITS, dt=DT):
    x, v, psi, r = series(trackers)
    slack = 1.0 + 1e-9
    assert np.hypot(v[:, 0], v[:, 1]).max() <= limits.speed * slack
    assert -v[:, 2].min() <= limits.climb * slack
    assert v[:, 2].max() <= limits.descent * slack
    dv = np.diff(v, axis=0) / dt
    assert np.hypot(dv[:, 0], dv[:, 1]).max() <= limits.acceleration * (1.0 + 1e-6)
    assert np.abs(dv[:, 2]).max() <= limits.climb_acceleration * (1.0 + 1e-6)
    assert np.abs(r).max() <= limits.yaw_rate * slack
    assert np.abs(np.diff(r)).max() / dt <= limits.yaw_acceleration * (1.0 + 1e-6)
    # The reference is the integral of its velocity: it never jumps.
    np.testing.assert_allclose(np.diff(x, axis=0), dt * v[1:], atol=1e-12)
    np.testing.assert_allclose(np.diff(psi), dt * r[1:], atol=1e-12)


number = st.one_of(st.floats(-20.0, 20.0), st.just(NAN))
triple = st.one_of(st.none(), st.tuples(number, number, number))
set_points = st.builds(
    SetPoint, triple, triple, st.one_of(st.none(), number), st.one_of(st.none(), st.floats(-9.0, 9.0))
)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(set_points, st.integers(1, 120)), min_size=1, max_size=6),
    st.builds(
        TrajectoryLimits,
        st.floats(0.05, 3.0),
        st.floats(0.05, 2.0),
        st.floats(0.05, 1.0),
        st.floats(0.05, 2.0),
        st.floats(0.05, 2.0),
        st.floats(0.02, 6.0),
        st.floats(0.1, 17.0),
    ),
)
def test_limits_hold_whatever_is_asked(parts, limits):
    asked = [s for s, times in parts for _ in range(times)]
    trackers = run(asked, limits=limits)
    check_limits(trackers, limits)
    x, _, psi, _ = series(trackers)
    assert np.isfinite(x).all()
    assert np.isfinite(psi).all()
    height = -x[:, 2]
    assert height.min() > MIN_WAYPOINT_HEIGHT_M - 0.02
    assert height.max() < MAX_HEIGHT_M + 0.02


@pytest.mark.parametrize("goal", [(3.0, 0.0, -1.0), (-0.3, 0.4, -1.0), (0.0, 0.0, -3.0), (5.0, -4.0, -0.3)])
def test_arrives_and_stays(goal):
    trackers = run([SetPoint(position_m=goal)] * 1500)
    check_limits(trackers)
    x, v, _, _ = series(trackers)
    np.testing.assert_allclose(x[-1], goal, atol=1e-3)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-3)
    way = np.array(goal) - x[0]
    length = np.linalg.norm(way)
    beyond = (x - x[0]) @ way / length - length
    assert beyond.max() < 0.01, "overshoot below 1 cm"


def test_it_is_not_slower_than_it_has_to_be():
    trackers = run([SetPoint(position_m=(6.0, 0.0, -1.0))] * 2000)
    x, _, _, _ = series(trackers)
    arrived = DT * int(np.argmax(x[:, 0] > 5.98))
    ideal = 6.0 / LIMITS.speed + LIMITS.speed / LIMITS.acceleration
    assert ideal <= arrived < ideal + 3.0


def test_it_brakes_with_half_of_what_it_may_and_says_how_it_accelerates():
    """The other half is for what the helicopter has to make up for; the acceleration told is for feedforward."""
    trackers = run([SetPoint(position_m=(6.0, -8.0, -1.0))] * 2000)
    _, v, _, _ = series(trackers)
    along, told = (np.array(w)[:, :2] @ (0.6, -0.8) for w in (v, [t.acceleration for t in trackers]))
    change = np.diff(along) / DT
    assert change.max() == pytest.approx(LIMITS.acceleration, rel=1e-6)
    assert -0.65 * LIMITS.acceleration < change.min() < -0.5 * LIMITS.acceleration
    # Smoothed, so a little late.
    assert np.abs(told[5:] - change[: len(told) - 5]).sum() < 0.05 * np.abs(change).sum()


def test_a_velocity_is_held_and_let_go():
    going = [SetPoint(velocity_m_s=(0.3, -0.2, 0.1), yaw_rate_rad_s=0.5)] * 300
    trackers = run([*going, *[SetPoint(velocity_m_s=ZERO, yaw_rate_rad_s=0.0)] * 200])
    check_limits(trackers)
    _, v, _, r = series(trackers)
    np.testing.assert_allclose(v[300], (0.3, -0.2, 0.1), atol=1e-6)
    assert r[300] == pytest.approx(0.5, abs=1e-6)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-6)


def test_too_fast_a_velocity_keeps_its_direction():
    trackers = run([SetPoint(velocity_m_s=(3.0, 4.0, 0.0))] * 300)
    np.testing.assert_allclose(trackers[-1].velocity, (0.36, 0.48, 0.0), atol=1e-9)


def test_axes_may_be_mixed():
    """A height to hold, a velocity to fly with: what PX4 calls altitude and velocity control."""
    s = SetPoint(position_m=(NAN, NAN, -2.0), velocity_m_s=(0.4, NAN, NAN))
    trackers = run([s] * 600)
    check_limits(trackers)
    end = trackers[-1]
    assert end.position[2] == pytest.approx(-2.0, abs=1e-3)
    np.testing.assert_allclose(end.velocity, (0.4, 0.0, 0.0), atol=1e-3)


def test_a_moving_position_with_its_velocity_is_followed_without_lag():
    def circle(t):
        w = 0.3
        place = (math.cos(w * t), math.sin(w * t), -1.0)
        return SetPoint(place, (-w * math.sin(w * t), w * math.cos(w * t), 0.0))

    trackers = run([circle(DT * (k + 1)) for k in range(2000)], start=at_rest((1.0, 0.0, -1.0)))
    check_limits(trackers)
    off = [math.dist(t.position, circle(DT * k).position_m) for k, t in enumerate(trackers)]
    assert max(off[1000:]) < 0.05


def test_heading_goes_the_shorter_way_round():
    trackers = run([SetPoint(heading_rad=-3.0)] * 300, start=at_rest(heading=3.0))
    check_limits(trackers)
    assert trackers[-1].heading == pytest.approx(math.tau - 3.0, abs=1e-3)
    assert max(t.heading for t in trackers) < math.tau - 3.0 + math.radians(1.0)


@pytest.mark.parametrize(
    ("s", "height"),
    [
        (SetPoint(velocity_m_s=(0.0, 0.0, 1.0)), MIN_WAYPOINT_HEIGHT_M),
        (SetPoint(position_m=(0.0, 0.0, 3.0)), MIN_WAYPOINT_HEIGHT_M),
        (SetPoint(velocity_m_s=(0.0, 0.0, -9.0)), MAX_HEIGHT_M),
    ],
)
def test_height_stays_in_its_bounds(s, height):
    trackers = run([s] * (8000 if height > 1.0 else 600))
    check_limits(trackers)
    heights = [-t.position[2] for t in trackers]
    assert heights[-1] == pytest.approx(height, abs=0.02)
    assert MIN_WAYPOINT_HEIGHT_M - 0.005 < min(heights) <= max(heights) < MAX_HEIGHT_M + 0.005


def test_from_the_floor_it_rises_to_where_flying_is_allowed():
    trackers = run([SetPoint(velocity_m_s=ZERO)] * 400, start=at_rest((0.0, 0.0, -0.07)))
    check_limits(trackers)
    assert -trackers[-1].position[2] == pytest.approx(MIN_WAYPOINT_HEIGHT_M, abs=1e-3)


def test_takes_over_a_reference_that_moves():
    moving = TrajectoryPoint((1.0, 2.0, -1.5), (0.5, 0.1, -0.2), (0.3, 0.0, 0.0), 2.0, 0.7)
    t = moving
    assert t == moving
    check_limits(run([SetPoint(position_m=(1.0, 2.0, -1.5))] * 500, start=t))


def test_waits_for_a_helicopter_that_does_not_follow():
    trackers = run([SetPoint(velocity_m_s=(0.6, 0.0, 0.0))] * 1500, behind=(0.0, 0.0, -1.0))
    assert trackers[-1].position[0] < 1.05
    assert abs(trackers[-1].velocity[0]) < 0.02


def test_a_wall_ahead_takes_the_velocity_towards_it_away():
    def hold_off(vn, ve):
        return min(vn, 0.0), ve

    trackers = run([SetPoint(velocity_m_s=(0.5, 0.3, 0.0))] * 200, hold_off=hold_off)
    np.testing.assert_allclose(trackers[-1].velocity, (0.0, 0.3, 0.0), atol=1e-6)


def test_limits_that_are_tightened_on_the_way_are_come_down_to():
    fast = run([SetPoint(velocity_m_s=(0.6, 0.0, 0.0))] * 200)[-1]
    slow = TrajectoryLimits(0.2, 0.5, 0.4, 0.4, 0.3, 1.0, 1.6)
    trackers = run([SetPoint(velocity_m_s=(0.6, 0.0, 0.0))] * 200, start=fast, limits=slow)
    _, v, _, _ = series(trackers)
    assert np.abs(np.diff(v[:, 0])).max() <= DT * 0.4 * (1 + 1e-9)
    assert v[-1, 0] == pytest.approx(0.2, abs=1e-6)


def test_long_steps_are_taken_in_parts():
    s = SetPoint(position_m=(2.0, 1.0, -1.5), heading_rad=1.0)
    fine, coarse = run([s] * 500), run([s] * 20, dt=0.5)
    for k, late in enumerate(coarse):
        np.testing.assert_allclose(late.position, fine[25 * k].position, atol=1e-9)
    assert follow_set_point(fine[3], s, LIMITS, ZERO, 0.0) == fine[3]


@pytest.mark.parametrize(
    ("s", "words"),
    [
        (SetPoint(), "is empty"),
        (SetPoint((NAN, NAN, NAN), (NAN, NAN, NAN), NAN, NAN), "is empty"),
        (SetPoint(position_m=(math.inf, 0.0, -1.0)), "a position of inf"),
        (SetPoint(velocity_m_s=(0.0, -1e9, 0.0)), "a velocity of -1e+09"),
        (SetPoint(heading_rad=math.inf), "a heading of inf"),
        (SetPoint(yaw_rate_rad_s=-1e3), "a rate of turn of -1000"),
        (SetPoint(position_m=(1.0, 2.0)), "three numbers"),
    ],
)
def test_absurd_set_points_are_named(s, words):
    assert words in describe_set_point_fault(s)


def test_only_what_leads_up_lifts_off():
    standing = (0.0, 0.0, -0.07)
    assert needs_lift_off(SetPoint(position_m=(0.0, 0.0, -1.0)), standing)
    assert needs_lift_off(SetPoint(velocity_m_s=(0.0, 0.0, -0.5)), standing)
    # From a table too, where that is a clear step up.
    assert needs_lift_off(SetPoint(position_m=(0.0, 0.0, -0.92)), (0.0, 0.0, -0.8))
    assert not needs_lift_off(SetPoint(position_m=(0.0, 0.0, -0.85)), (0.0, 0.0, -0.8))
    for s in (
        SetPoint(position_m=(5.0, 0.0, -0.1)),
        SetPoint(velocity_m_s=(1.0, 0.0, 0.0)),
        SetPoint(position_m=(1.0, NAN, NAN)),
        SetPoint(heading_rad=1.0),
    ):
        assert not needs_lift_off(s, standing)
