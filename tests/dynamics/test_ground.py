"""Standing, dropping, tipping over, taking off and landing."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mufly.dynamics import (
    GRAVITY,
    body_to_ned_matrix,
    euler_from_quaternion,
    find_deepest_contact,
    find_trim,
    initial_state,
    integrate_state,
    model_parameters,
    simulate_open_loop,
    standing_height,
)
from mufly.dynamics.equations_of_motion import contact_wrench
from mufly.vehicle import replace_parameters

CALM = np.zeros(3)
NO_INPUT = np.zeros(4)


@pytest.fixture(scope="module")
def p(vehicle):
    return model_parameters(vehicle)


def energy(x, p):
    """Kinetic, potential and elastic energy (J)."""
    a = body_to_ned_matrix(x[6:10])
    inertia = np.array([p["Ixx"], p["Iyy"], p["Izz"]])
    depth = x[2] + p["contact_points"][: p["contact_count"]] @ a[2]
    return (
        0.5 * p["mass"] * x[3:6] @ x[3:6]
        + 0.5 * inertia @ x[10:13] ** 2
        - p["mass"] * GRAVITY * x[2]
        + 0.5 * p["leg_stiffness"] * np.sum(np.maximum(depth, 0) ** 2)
    )


def history(x, p, duration, step=1e-3, u=NO_INPUT, wind=CALM):
    states = [x.copy()]
    y = x.copy()
    for _ in range(round(duration / step)):
        integrate_state(y, u, wind, p, step, 1)
        states.append(y.copy())
    return np.array(states)


def test_it_stands_still(vehicle, p) -> None:
    h = standing_height(vehicle)
    assert h == pytest.approx(0.070 - 0.095 * GRAVITY / (4 * 150), rel=1e-12)
    x = initial_state(position=(0.3, -0.2, -h), attitude=(0, 0, 1.0))
    y = x.copy()
    integrate_state(y, NO_INPUT, CALM, p, 1e-3, 60_000)
    assert_allclose(y[0:3], x[0:3], atol=1e-6)  # a minute; 1 mm is asked for
    assert np.max(np.abs(y[3:6])) < 1e-9


@pytest.mark.parametrize(("wind", "creep_mm_per_min"), [(0.5, 4.0), (1.0, 15.0)])
def test_creep_in_wind_is_what_the_smoothing_says(vehicle, p, wind, creep_mm_per_min) -> None:
    # v_slip F / (mu N) for a push F far below mu N.
    push = p["drag_over_speed2_x"] * wind**2
    x = initial_state(position=(0, 0, -standing_height(vehicle)))
    integrate_state(x, NO_INPUT, np.array([wind, 0, 0]), p, 1e-3, 20_000)
    expected = p["slip_speed"] * push / (p["leg_friction"] * p["mass"] * GRAVITY)
    assert x[3] == pytest.approx(expected, rel=0.01)
    assert x[0] * 3e3 < creep_mm_per_min


def test_drop_from_5_cm_settles_and_loses_energy(vehicle, p) -> None:
    h = standing_height(vehicle)
    states = history(initial_state(position=(0, 0, -h - 0.05)), p, 2.0)
    energies = np.array([energy(x, p) for x in states])
    assert np.max(np.diff(energies)) < 1e-6 * energies[0]
    assert states[-1, 2] == pytest.approx(-h, abs=1e-6)
    assert np.max(np.abs(states[-1, 3:6])) < 1e-6
    rebound = np.max(-states[300:, 2]) - h
    assert rebound < 0.01
    assert np.max(states[:, 2]) < -0.05  # pressed in by less than 20 mm


def test_a_slide_stops_after_v_squared_over_2_mu_g(vehicle) -> None:
    # Coulomb's law; the last centimetres per second are smoothed. Little friction, so that it does not rock.
    v = replace_parameters(vehicle, {"contact.slip_speed": 1e-3, "contact.friction": 0.2, "body.drag_area_x": 0.0})
    x = initial_state(position=(0, 0, -standing_height(v)), velocity=(1.0, 0, 0))
    states = history(x, model_parameters(v), 2.0)
    assert states[-1, 0] == pytest.approx(1.0 / (2 * 0.2 * GRAVITY), rel=0.01)
    assert np.max(np.abs(states[-1, 3:6])) < 1e-9


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1))
def test_friction_stays_in_its_cone_and_opposes_motion(p, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    x = random_state(rng, rng.uniform(0.0, 0.09))
    f = np.array(contact_wrench(x, p)[0:3])
    assert f[2] <= 0.0  # the floor only pushes
    assert math.hypot(f[0], f[1]) <= p["leg_friction"] * -f[2] * (1 + 1e-12)
    gliding = x.copy()
    gliding[10:13] = 0.0
    f = np.array(contact_wrench(gliding, p)[0:3])
    assert f[0:2] @ gliding[3:5] <= 0.0


@pytest.mark.parametrize("speed", [0.3, 0.01])
def test_wrench_of_four_legs_by_hand(vehicle, speed) -> None:
    p = model_parameters(replace_parameters(vehicle, {"contact.slip_speed": 0.04}))
    x = initial_state(position=(0, 0, -0.069), velocity=(speed, 0, 0.1))
    normal = 4 * (150 * 0.001 + 1.9 * 0.1)
    bound = 4 * 2000 * 2.66e-5 / (4 * 2 * 0.045**2)  # 13.1 N s/m, so that yaw on the legs is no faster than 2000 1/s
    rub = min(0.6 * normal / math.hypot(speed, 0.04), bound) * speed
    f_n, f_e, f_d, m_x, m_y, m_z = contact_wrench(x, p)
    assert_allclose((f_n, f_e, f_d), (-rub, 0, -normal), atol=1e-12)
    assert_allclose((m_x, m_y, m_z), (0, -rub * 0.07, 0), atol=1e-12)


@pytest.mark.parametrize("roll_deg", [20, 45, 70, 90, 120, 179])
def test_tilted_it_rights_or_tips_over_and_comes_to_rest(vehicle, p, roll_deg) -> None:
    x = initial_state(position=(0, 0, -0.2), attitude=(math.radians(roll_deg), 0.1, 0.5), rates=(1, 0, 3))
    states = history(x, p, 5.0)
    energies = np.array([energy(s, p) for s in states])
    assert np.all(np.isfinite(states))
    assert np.max(np.diff(energies)) < 1e-5 * energies[0]
    assert np.max(np.abs(states[-1, 3:6])) < 1e-6
    assert np.max(np.abs(states[-1, 10:13])) < 1e-4
    tilt = math.degrees(math.acos(body_to_ned_matrix(states[-1, 6:10])[2, 2]))
    depth, _ = find_deepest_contact(states[-1], p)
    assert 0 < depth < 0.005
    if roll_deg == 20:
        assert tilt < 0.01
    elif roll_deg < 150:
        assert 60 < tilt < 90  # on two legs and the rim of the upper rotor
        depths = states[-1, 2] + p["contact_points"][: p["contact_count"]] @ body_to_ned_matrix(states[-1, 6:10])[2]
        assert set(np.flatnonzero(depths > 0)) & set(range(4))
        assert set(np.flatnonzero(depths > 0)) & set(range(4, 12))
    else:
        assert tilt == pytest.approx(180, abs=0.01)  # on its head: on the rotor


@pytest.mark.parametrize("roll_deg", [10, 60, 179])
def test_half_the_step_changes_little(p, roll_deg) -> None:
    x = initial_state(position=(0, 0, -0.15), attitude=(math.radians(roll_deg), 0, 0.5), rates=(1, 0, 3))
    coarse, fine = history(x, p, 3.0)[-1], history(x, p, 3.0, step=5e-4)[-1]
    assert_allclose(coarse[0:3], fine[0:3], atol=1e-3)
    assert_allclose(coarse[6:10], fine[6:10], atol=1e-2)


def test_a_hard_landing_does_not_turn_the_nose(p, vehicle) -> None:
    # Friction under ten times the weight would be stiffer than a 1 ms step if it were not bounded.
    h = standing_height(vehicle)
    x = initial_state(position=(0, 0, -h - 0.02), velocity=(0.05, 0, 1.5), rates=(0, 0, 0.2))
    states = history(x, p, 2.0)
    yaw = euler_from_quaternion(states[:, 6:10])[:, 2]
    assert np.max(np.abs(states[30:, 12])) < 0.2
    assert np.max(np.abs(yaw)) < 0.05
    assert np.max(np.abs(states[-1, 10:13])) < 1e-6


def test_take_off_open_loop(vehicle) -> None:
    h, t = standing_height(vehicle), find_trim(vehicle)
    x = initial_state(position=(0, 0, -h))
    light = simulate_open_loop(vehicle, x, t.input * 0.9, duration_s=4.0, voltage=7.2)
    assert float(light.truth_position[-1, 2]) == pytest.approx(-0.0696, abs=5e-4)  # lighter on its legs
    up = simulate_open_loop(vehicle, x, t.input * 1.1, duration_s=4.0, voltage=7.2)
    height = -up.truth_position.values[:, 2]
    assert height[-1] > 0.5
    assert np.max(np.abs(up.truth_attitude.values[:, 0:2])) < 1e-6
    assert height.min() >= h - 1e-6


def test_thrust_down_to_the_floor_and_rotors_off(vehicle) -> None:
    h, t = standing_height(vehicle), find_trim(vehicle)
    x = t.state.copy()
    x[2], x[5] = -h - 0.2, 0.3
    flight = simulate_open_loop(
        vehicle, x, np.vstack([np.tile(t.input * 0.97, (100, 1)), NO_INPUT]), duration_s=6.0, voltage=7.2
    )
    assert float(flight.truth_position[-1, 2]) == pytest.approx(-h, abs=1e-4)
    assert float(np.abs(flight.truth_velocity[-1]).max()) < 1e-3
