"""Rotations: one attitude in three forms, and what is no attitude."""

import numpy as np
import pytest

from mufly.rotations import (
    body_to_ned_matrices,
    euler_from_quaternion,
    euler_from_unnormalised_quaternion,
    quaternion_from_euler,
    quaternions_from_euler,
)


@pytest.mark.parametrize(
    ("attitude", "forward", "down"),
    [
        ((0.0, 0.0, np.pi / 2), (0, 1, 0), (0, 0, 1)),
        ((0.0, np.pi / 2, 0.0), (0, 0, -1), (1, 0, 0)),
        ((np.pi / 2, 0.0, 0.0), (1, 0, 0), (0, -1, 0)),
        ((np.pi / 2, 0.0, np.pi / 2), (0, 1, 0), (1, 0, 0)),
    ],
)
def test_quaternions_turn_the_body_axes_as_in_aviation(attitude, forward, down):
    w, x, y, z = quaternions_from_euler(np.array([attitude]))[0]
    first = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    third = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    assert first == pytest.approx(forward, abs=1e-12)
    assert third == pytest.approx(down, abs=1e-12)


def test_all_forms_of_an_attitude_agree():
    attitude = np.random.default_rng(3).uniform(-1.5, 1.5, (50, 3))
    q = quaternions_from_euler(attitude)
    np.testing.assert_allclose(q, [quaternion_from_euler(*row) for row in attitude.tolist()], rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(euler_from_quaternion(q), attitude, atol=1e-12)
    np.testing.assert_allclose([euler_from_quaternion(row) for row in q], attitude, atol=1e-12)
    w, v = q[:, :1], q[:, 1:]
    body = np.array([0.3, -0.2, 0.9])
    turned = body + 2.0 * np.cross(v, np.cross(v, body) + w * body)  # q b q*
    np.testing.assert_allclose(body_to_ned_matrices(attitude) @ body, turned, atol=1e-14)


def test_a_measured_quaternion_is_scaled_and_a_short_one_is_no_attitude():
    q = quaternion_from_euler(0.3, -0.4, 1.1)
    told = euler_from_unnormalised_quaternion(np.array([q, 1.6 * q, 0.4 * q, np.zeros(4), np.full(4, np.nan)]))
    np.testing.assert_allclose(told[:2], [(0.3, -0.4, 1.1)] * 2, atol=1e-12)
    assert np.isnan(told[2:]).all()
