"""The model does not know where north is, which side is left, or how many vehicles fly beside it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from mufly.dynamics import (
    GRAVITY,
    PARAMETER_DTYPE,
    STATE_SIZE,
    body_to_ned_matrix,
    integrate_batch,
    integrate_state,
    model_parameters,
    quaternion_from_euler,
    state_derivative,
)
from mufly.vehicle import load_vehicle, replace_parameters

seeds = st.integers(0, 2**32 - 1)


def rates(x, u, wind, p):
    dx = np.empty(STATE_SIZE)
    state_derivative(x, np.asarray(u, float), np.asarray(wind, float), p, dx)
    return dx


def product(a, b):
    """Hamilton product of two quaternions (w, x, y, z)."""
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def turned(x, q):
    """The same state seen in a world turned by ``q``."""
    r, y = body_to_ned_matrix(q), x.copy()
    y[0:3], y[3:6], y[15:18] = r @ x[0:3], r @ x[3:6], r @ x[15:18]
    y[6:10] = product(q, x[6:10])
    return y


@settings(max_examples=40)
@given(seed=seeds, heading=st.floats(-np.pi, np.pi), height=st.sampled_from([0.05, 50.0]))
def test_any_heading_gives_the_turned_motion(vehicle, random_state, seed, heading, height) -> None:
    # Height 0.05 m is in contact with the floor, which is the same in every direction too.
    rng = np.random.default_rng(seed)
    p = model_parameters(vehicle)
    x, u, wind = random_state(rng, height), rng.uniform(-0.2, 1.2, size=4), rng.normal(size=3)
    q = quaternion_from_euler(0.0, 0.0, heading)
    expected = turned(rates(x, u, wind, p), q)
    found = rates(turned(x, q), u, body_to_ned_matrix(q) @ wind, p)
    assert_allclose(found, expected, atol=1e-9 * (1 + np.abs(expected).max()))


@settings(max_examples=40)
@given(seed=seeds)
def test_without_gravity_and_floor_any_rotation_does(vehicle, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    p = model_parameters(vehicle)
    x, u, wind = random_state(rng, 5000.0), rng.uniform(0, 1, size=4), rng.normal(size=3)
    q = random_state(rng)[6:10]
    fall = np.zeros(STATE_SIZE)
    fall[5] = GRAVITY
    expected = turned(rates(x, u, wind, p) - fall, q)
    y = turned(x, q)
    y[2] = -5000.0
    found = rates(y, u, body_to_ned_matrix(q) @ wind, p) - fall
    assert_allclose(found, expected, atol=1e-9 * (1 + np.abs(expected).max()))


def test_a_flight_to_the_east_is_the_flight_to_the_north_turned(vehicle, random_state) -> None:
    rng = np.random.default_rng(3)
    p, q = model_parameters(vehicle), quaternion_from_euler(0, 0, np.pi / 2)
    x = random_state(rng)
    x[6:10] = quaternion_from_euler(0.1, -0.2, 0.3)
    x[15:18] = (0, 0, -1)
    x[10:13] *= 0.1
    y = turned(x, q)
    u, wind = np.array([0.7, 0.72, 0.1, -0.2]), np.array([0.4, 0.1, -0.1])
    integrate_state(x, u, wind, p, 1e-3, 500)
    integrate_state(y, u, body_to_ned_matrix(q) @ wind, p, 1e-3, 500)
    assert_allclose(y, turned(x, q), atol=1e-9)


# Mirrors: which state components change sign when left and right, or front and back, are exchanged.
LEFT_RIGHT = {"flip": [1, 4, 7, 9, 10, 12, 13, 16], "servo": 3, "wind": 1}
FRONT_BACK = {"flip": [0, 3, 8, 9, 11, 12, 14, 15], "servo": 2, "wind": 0}


@settings(max_examples=40)
@given(seed=seeds, mirror=st.sampled_from([LEFT_RIGHT, FRONT_BACK]))
def test_all_but_the_rotors_yaw_torque_is_mirror_symmetric(vehicle, random_state, seed, mirror) -> None:
    # Mirroring turns each rotor into one that spins the other way, so its torque about z keeps its sign where the
    # mirrored problem would reverse it. That one term apart, left and right (front and back) are alike.
    rng = np.random.default_rng(seed)
    p = model_parameters(vehicle)
    x, u, wind = random_state(rng), rng.uniform(0, 1, size=4), rng.normal(size=3)
    sign = np.ones(STATE_SIZE)
    sign[mirror["flip"]] = -1
    v, w = u.copy(), wind.copy()
    v[mirror["servo"]] *= -1
    w[mirror["wind"]] *= -1
    dx, dm = rates(x, u, wind, p), rates(sign * x, v, w, p)
    rotor = (
        p["torque_up"] * x[18] ** 2 - p["torque_dw"] * x[19] ** 2 + p["Jreact_up"] * dx[18] - p["Jreact_dw"] * dx[19]
    )
    expected = sign * dx
    expected[12] += 2 * rotor / p["Izz"]
    assert_allclose(dm, expected, atol=1e-10 * (1 + np.abs(dx).max()))


@pytest.fixture(scope="module")
def fleet(random_state):
    """Different vehicles in different states with different inputs, some on the floor."""
    rng = np.random.default_rng(7)
    base = load_vehicle("mufly-1.1")
    vehicles = [base, load_vehicle("mufly-2.0")]
    vehicles += [
        replace_parameters(base, {"body.mass": m, "gear.ratio": g}) for m, g in ((0.08, 1.6), (0.1, 1.4), (0.12, 2.0))
    ]
    n = 40
    p = np.array([model_parameters(vehicles[k % 5], 7.0 if k % 3 else None) for k in range(n)], dtype=PARAMETER_DTYPE)
    x = np.array([random_state(rng, 0.06 if k % 4 == 0 else 20.0) for k in range(n)])
    return x, rng.uniform(-0.1, 1.1, size=(n, 4)), rng.normal(size=(n, 3)), p


def test_batch_is_the_single_flight_but_for_the_last_bits_of_its_sine(fleet) -> None:
    x, u, wind, p = fleet
    together = x.copy()
    integrate_batch(together, u, wind, p, 1e-3, 300)
    alone = x.copy()
    for k in range(len(x)):
        integrate_state(alone[k], u[k], wind[k], p[k], 1e-3, 300)
    assert np.all(np.isfinite(together))
    assert_allclose(together, alone, rtol=1e-9, atol=1e-9)


def test_order_in_a_batch_does_not_matter(fleet) -> None:
    x, u, wind, p = fleet
    order = np.random.default_rng(0).permutation(len(x))
    first, second = x.copy(), x[order]
    integrate_batch(first, u, wind, p, 1e-3, 100)
    integrate_batch(second, u[order], wind[order], p[order], 1e-3, 100)
    assert_array_equal(first[order], second)


@settings(max_examples=30)
@given(seed=seeds)
def test_inputs_saturate(vehicle, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    p, x, wind = model_parameters(vehicle), random_state(rng), rng.normal(size=3)
    u = rng.normal(size=4) * 3
    clipped = np.clip(u, [0, 0, -1, -1], 1)
    assert_array_equal(rates(x, u, wind, p), rates(x, clipped, wind, p))
