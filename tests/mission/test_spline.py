"""Cubic splines against eqs 6.11 to 6.13 and against geometry."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mufly.mission import make_spline
from mufly.mission.trajectory import CubicSpline, PendingCurve, TimedSpline

vector = st.tuples(*[st.floats(-3.0, 3.0)] * 3).map(np.array)
T = np.linspace(0.0, 1.0, 11)


def time_spline(curve: CubicSpline, **limits: float) -> TimedSpline | None:
    return PendingCurve(curve.axis_cubics, **limits).compute_timed_spline()


def curvature(curve: CubicSpline, t: np.ndarray) -> np.ndarray:
    _, tangent, second = curve.evaluate(t)
    return np.linalg.norm(np.cross(tangent, second), axis=1) / np.linalg.norm(tangent, axis=1) ** 3


@given(vector, vector, vector, vector)
def test_boundary_conditions(a, b, da, db):
    curve = make_spline(a, b, da, db)
    p, t, _ = curve.evaluate([0.0, 1.0])
    np.testing.assert_allclose(p, [a, b], atol=1e-12)
    np.testing.assert_allclose(t, [da, db], atol=1e-12)


@given(vector, vector, vector, vector)
def test_tangent_and_second_derivative(a, b, da, db):
    curve = make_spline(a, b, da, db)
    h = 1e-6
    np.testing.assert_allclose(
        (curve.evaluate(T + h)[0] - curve.evaluate(T - h)[0]) / (2 * h), curve.evaluate(T)[1], atol=1e-7
    )
    np.testing.assert_allclose(
        (curve.evaluate(T + h)[1] - curve.evaluate(T - h)[1]) / (2 * h), curve.evaluate(T)[2], atol=1e-6
    )


def test_a_quarter_circle_has_nearly_its_curvature():
    # The cubic with derivatives 3 * 0.5523 R along the ends' tangents is the usual Bezier quarter circle, whose
    # radius is right within 0.03 % and its curvature within 2.2 %.
    radius, length = 2.0, 3.0 * 0.5522847498 * 2.0
    curve = make_spline((radius, 0, -1), (0, radius, -1), (0, length, 0), (-length, 0, 0))
    np.testing.assert_allclose(np.linalg.norm(curve.evaluate(T)[0][:, :2], axis=1), radius, rtol=3e-4)
    np.testing.assert_allclose(curvature(curve, T), 1.0 / radius, rtol=0.025)
    path = time_spline(curve, speed=0.8, climb=0.5, descent=0.5, acceleration=0.4)
    assert path.speed_profile.distance == pytest.approx(np.pi, rel=3e-4)
    # So short a way is limited by the ramps, not by the bend: V^2 = 8 a d / 15 with the share a / sqrt(2).
    assert path.speed_profile.peak_speed == pytest.approx(np.sqrt(8 / 15 * 0.4 / np.sqrt(2) * np.pi), rel=1e-3)


def test_a_tight_bend_is_flown_slowly():
    # A long way with a short bend of curvature k in its middle: V^2 k = a / sqrt(2).
    curve = make_spline((0, 0, -1), (10, 0, -1), (-30, 60, 0), (-30, -60, 0))
    path = time_spline(curve, speed=3.0, climb=0.5, descent=0.5, acceleration=0.4)
    k = curvature(curve, np.linspace(0, 1, 2001)).max()
    assert path.speed_profile.peak_speed == pytest.approx(np.sqrt(0.4 / np.sqrt(2) / k), rel=1e-2)


def test_straight_tangents_make_a_straight_line():
    a, b = np.array([1.0, 2.0, -1.0]), np.array([4.0, 6.0, -1.0])
    path = time_spline(make_spline(a, b, b - a, b - a), speed=0.5, climb=1, descent=1, acceleration=0.4)
    assert path.speed_profile.distance == pytest.approx(5.0)
    for t in np.linspace(0.0, path.speed_profile.duration_s, 13):
        position, velocity, acceleration = path.evaluate(t)
        s, v, w = path.speed_profile.evaluate(t)
        np.testing.assert_allclose(position, a + s * np.array([0.6, 0.8, 0.0]), atol=1e-9)
        np.testing.assert_allclose(velocity, v * np.array([0.6, 0.8, 0.0]), atol=1e-9)
        np.testing.assert_allclose(acceleration, w * np.array([0.6, 0.8, 0.0]), atol=1e-9)


@settings(max_examples=40)
@given(vector, vector, vector, vector)
def test_flown_within_limits_and_consistent(a, b, da, db):
    limits = {"speed": 0.6, "climb": 0.5, "descent": 0.3, "acceleration": 0.4}
    path = time_spline(make_spline(a, b, da, db), **limits)
    assume(path is not None)
    end = path.speed_profile.duration_s
    times = np.linspace(0.0, end, 300)
    x, v, w = (np.array(q) for q in zip(*[path.evaluate(t) for t in times], strict=True))
    np.testing.assert_allclose(x[0], a, atol=1e-6)
    np.testing.assert_allclose(x[-1], b, atol=1e-6)
    assert np.linalg.norm(v[:, :2], axis=1).max() <= 0.6 * 1.01
    assert -v[:, 2].min() <= 0.5 * 1.01
    assert v[:, 2].max() <= 0.3 * 1.01
    assert np.linalg.norm(w, axis=1).max() <= 0.4 * 1.02
    h = 1e-4
    for t in np.linspace(0.05, 0.95, 7) * end:
        slope = (np.array(path.evaluate(t + h)[0]) - np.array(path.evaluate(t - h)[0])) / (2 * h)
        np.testing.assert_allclose(slope, path.evaluate(t)[1], atol=2e-3)
        # It is where its timing says: so far along the curve, at that speed, and what is felt is the change of that.
        np.testing.assert_allclose(np.linalg.norm(path.evaluate(t)[1]), path.speed_profile.evaluate(t)[1], atol=1e-9)
        bend = (np.array(path.evaluate(t + h)[1]) - np.array(path.evaluate(t - h)[1])) / (2 * h)
        np.testing.assert_allclose(bend, path.evaluate(t)[2], atol=2e-2)


def test_a_cusp_is_no_path():
    assert (
        time_spline(
            make_spline((0, 0, -1), (1, 0, -1), (0, 0, 0), (0, 0, 0)),
            speed=1,
            climb=1,
            descent=1,
            acceleration=1,
        )
        is None
    )
    same = make_spline((0, 0, -1), (0, 0, -1), (0, 0, 0), (0, 0, 0))
    assert time_spline(same, speed=1, climb=1, descent=1, acceleration=1) is None
