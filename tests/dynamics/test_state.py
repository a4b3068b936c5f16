"""Attitude: quaternion, matrix and Euler angles say the same, and turn at the rates that eq. 4.3 should have."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.dynamics import (
    body_to_ned_matrix,
    euler_from_quaternion,
    initial_state,
    integrate_state,
    model_parameters,
    quaternion_from_euler,
    state_derivative,
)

angles = st.floats(-3.1, 3.1)
pitches = st.floats(-1.5, 1.5)


@given(roll=angles, pitch=pitches, yaw=angles)
def test_matrix_is_eq_4_2_transposed(roll, pitch, yaw) -> None:
    c, s = math.cos, math.sin
    to_body = np.array(
        [
            [c(pitch) * c(yaw), c(pitch) * s(yaw), -s(pitch)],
            [
                -c(roll) * s(yaw) + s(roll) * s(pitch) * c(yaw),
                c(roll) * c(yaw) + s(roll) * s(pitch) * s(yaw),
                s(roll) * c(pitch),
            ],
            [
                s(roll) * s(yaw) + c(roll) * s(pitch) * c(yaw),
                -s(roll) * c(yaw) + c(roll) * s(pitch) * s(yaw),
                c(roll) * c(pitch),
            ],
        ]
    )
    q = quaternion_from_euler(roll, pitch, yaw)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    assert_allclose(body_to_ned_matrix(q), to_body.T, atol=1e-14)
    assert_allclose(euler_from_quaternion(q), [roll, pitch, yaw], atol=1e-7)
    assert_allclose(euler_from_quaternion(-q), [roll, pitch, yaw], atol=1e-7)


def test_euler_angles_of_many_quaternions_and_at_the_pole() -> None:
    q = np.array([[quaternion_from_euler(0.1 * i, 0.2, -0.3) for i in range(3)]])
    assert euler_from_quaternion(q).shape == (1, 3, 3)
    up = euler_from_quaternion(quaternion_from_euler(0.0, math.pi / 2, 0.0))
    assert up[1] == pytest.approx(math.pi / 2, abs=1e-7)


@given(roll=angles, pitch=st.floats(-1.3, 1.3), yaw=angles, p=angles, q=angles, r=angles)
def test_euler_rates(vehicle, roll, pitch, yaw, p, q, r) -> None:
    # Eq. 4.4 with tangent and cosine where they belong (errata, point 4).
    x, dx, h = (
        initial_state(position=(0, 0, -50), attitude=(roll, pitch, yaw), rates=(p, q, r)),
        np.empty(21),
        1e-5,
    )
    state_derivative(x, np.zeros(4), np.zeros(3), model_parameters(vehicle), dx)
    change = euler_from_quaternion(x[6:10] + h * dx[6:10]) - euler_from_quaternion(x[6:10] - h * dx[6:10])
    turn = q * math.sin(roll) + r * math.cos(roll)
    expected = [
        p + turn * math.tan(pitch),
        q * math.cos(roll) - r * math.sin(roll),
        turn / math.cos(pitch),
    ]
    change = (change + math.pi) % (2 * math.pi) - math.pi
    assert_allclose(change / (2 * h), expected, atol=1e-4)


def test_constant_rate_about_one_axis(vehicle) -> None:
    x = initial_state(position=(0, 0, -500), rates=(0, 0, 2.0))
    integrate_state(x, np.zeros(4), np.zeros(3), model_parameters(vehicle), 1e-3, 700)
    assert_allclose(euler_from_quaternion(x[6:10]), [0, 0, 1.4], atol=1e-12)


def test_initial_state_puts_the_bar_where_it_is_told() -> None:
    square = initial_state(attitude=(0.3, -0.2, 1.1))
    assert_allclose(square[15:18], -body_to_ned_matrix(square[6:10])[:, 2], atol=1e-15)
    level = initial_state(attitude=(0.3, -0.2, 1.1), bar_attitude=(0, 0))
    assert_allclose(level[15:18], [0, 0, -1], atol=1e-15)
    assert level[20] == 1.0
