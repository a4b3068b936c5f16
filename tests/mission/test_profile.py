"""Profiles: limits kept, ends at rest, derivatives consistent."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.mission.trajectory import compute_stop_time_and_distance, make_motion_profile, smooth_step_down

way = st.floats(1e-4, 50.0)
limit = st.floats(0.05, 5.0)


@given(way, limit, limit)
def test_keeps_its_limits_and_arrives_at_rest(d, v, a):
    p = make_motion_profile(d, v, a)
    n = 400
    samples = [p.evaluate(k / n * p.duration_s) for k in range(n + 1)]
    assert max(s[1] for s in samples) <= v * (1 + 1e-9)
    assert max(abs(s[2]) for s in samples) <= a * (1 + 1e-9)
    assert samples[0] == (0.0, 0.0, 0.0)
    assert p.evaluate(p.duration_s + 1.0) == (d, 0.0, 0.0)
    assert samples[-1][0] == pytest.approx(d, rel=1e-9)
    assert all(after[0] >= before[0] - 1e-12 for before, after in pairwise(samples))


@given(way, limit, limit, st.floats(0.02, 0.98))
def test_speed_and_acceleration_are_derivatives(d, v, a, share):
    p = make_motion_profile(d, v, a)
    t, h = share * p.duration_s, 1e-5 * p.duration_s
    after, before, now = p.evaluate(t + h), p.evaluate(t - h), p.evaluate(t)
    assert (after[0] - before[0]) / (2 * h) == pytest.approx(now[1], abs=1e-5 * v)
    assert (after[1] - before[1]) / (2 * h) == pytest.approx(now[2], abs=2e-4 * a)


@given(way, limit, limit, st.floats(0.0, 1.0))
def test_symmetric_in_time(d, v, a, share):
    p = make_motion_profile(d, v, a)
    t = share * p.duration_s
    s, ds, dds = p.evaluate(t)
    r, dr, ddr = p.evaluate(p.duration_s - t)
    assert s + r == pytest.approx(d, rel=1e-9)
    assert ds == pytest.approx(dr, abs=1e-9 * v)
    assert dds == pytest.approx(-ddr, abs=1e-6 * a)


@given(way, limit, limit)
def test_uses_one_of_its_limits(d, v, a):
    p = make_motion_profile(d, v, a)
    peak = max(abs(p.evaluate(p.ramp_s / 2)[2]), 0.0)
    assert p.peak_speed == pytest.approx(v) or peak == pytest.approx(a)
    # Nothing gets there sooner than at full speed all the way, nor than with infinite jerk.
    assert p.duration_s >= d / v
    assert p.duration_s >= 2.0 * math.sqrt(d / a) * (1 - 1e-12)


def test_no_way_takes_no_time():
    p = make_motion_profile(0.0, 1.0, 1.0)
    assert p.duration_s == 0.0
    assert p.evaluate(0.5) == (0.0, 0.0, 0.0)


def test_step_down_is_a_step_with_its_integral():
    assert smooth_step_down(-1.0) == (1.0, 0.0, 0.0)
    assert smooth_step_down(0.5)[0] == pytest.approx(0.5)
    assert smooth_step_down(2.0) == (0.0, 0.0, 0.5)
    h = 1e-6
    for x in (0.1, 0.37, 0.8):
        value, slope, _ = smooth_step_down(x)
        assert (smooth_step_down(x + h)[0] - smooth_step_down(x - h)[0]) / (2 * h) == pytest.approx(slope, abs=1e-6)
        assert (smooth_step_down(x + h)[2] - smooth_step_down(x - h)[2]) / (2 * h) == pytest.approx(value, abs=1e-6)
    time, way_ = compute_stop_time_and_distance(-0.6, 1.0)
    assert time == pytest.approx(1.125)
    assert way_ == pytest.approx(0.3375)
