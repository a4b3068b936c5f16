"""Newton and Euler: free fall, conservation laws, order of the integration, balance of forces."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.dynamics import (
    GRAVITY,
    body_to_ned_matrix,
    find_trim,
    initial_state,
    integrate_state,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)
from mufly.vehicle import replace_parameters

STILL_AIR = np.zeros(3)
NO_INPUT = np.zeros(4)


def fly(x, p, duration, step, u=NO_INPUT):
    y = x.copy()
    integrate_state(y, np.asarray(u, float), STILL_AIR, p, step, round(duration / step))
    return y


def test_free_fall_in_vacuum_is_a_parabola(vacuum) -> None:
    x = initial_state(position=(1, 2, -100), velocity=(3, -2, -4), attitude=(0.3, -0.2, 1.0))
    t = 1.7
    y = fly(x, model_parameters(vacuum), t, 1e-3)
    assert_allclose(y[0:3], [1 + 3 * t, 2 - 2 * t, -100 - 4 * t + GRAVITY * t**2 / 2], rtol=1e-12)
    assert_allclose(y[3:6], [3, -2, -4 + GRAVITY * t], rtol=1e-12)
    assert_allclose(y[6:10], x[6:10], atol=1e-14)


def tumbling(x0_rates=(4.0, 2.5, -7.0)):
    return initial_state(position=(0, 0, -1000), attitude=(0.2, 0.5, -1.0), rates=x0_rates)


def angular_momentum(x, p):
    inertia = np.array([p["Ixx"], p["Iyy"], p["Izz"]])
    return body_to_ned_matrix(x[6:10]) @ (inertia * x[10:13]), 0.5 * np.sum(inertia * x[10:13] ** 2)


def test_torque_free_tumbling_keeps_angular_momentum_and_energy(vacuum) -> None:
    p, x = model_parameters(vacuum), tumbling()
    h0, e0 = angular_momentum(x, p)
    h1, e1 = angular_momentum(fly(x, p, 10.0, 1e-3), p)
    assert_allclose(h1, h0, atol=1e-9 * np.linalg.norm(h0))
    assert e1 == pytest.approx(e0, rel=1e-9)


def test_errors_shrink_with_the_fourth_power_of_the_step(vacuum) -> None:
    p, x = model_parameters(vacuum), tumbling()
    exact = fly(x, p, 1.0, 2.5e-4)
    errors = [np.max(np.abs(fly(x, p, 1.0, h)[6:13] - exact[6:13])) for h in (8e-3, 4e-3, 2e-3)]
    assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 16.0, rtol=0.1)


def test_driven_flight_converges_with_fourth_order_too(vehicle) -> None:
    # With the swash plate slow enough to be resolved by the coarse step.
    p = model_parameters(replace_parameters(vehicle, {"swash_plate.time_constant": 0.02}))
    x = initial_state(position=(0, 0, -50), attitude=(0.1, -0.2, 0.3), rates=(0.5, 0.3, -1), rotor_speed=(350, 420))
    u = (0.7, 0.75, 0.2, -0.3)
    exact = fly(x, p, 0.8, 2.5e-4, u)
    scale = np.abs(exact) + 1e-3
    errors = [np.max(np.abs(fly(x, p, 0.8, h, u) - exact) / scale) for h in (8e-3, 4e-3, 2e-3)]
    assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 16.0, rtol=0.15)


def test_rotors_and_fuselage_exchange_spin_without_loss(vacuum) -> None:
    # Without drag torque of the air only inner torques act about z: motors, gears and friction.
    p = model_parameters(vacuum, 7.2).copy()
    p["torque_up"] = p["torque_dw"] = 0.0

    def spin(x):
        return p["Izz"] * x[12] + p["Jreact_dw"] * x[19] - p["Jreact_up"] * x[18]

    x = initial_state(position=(0, 0, -1000), rotor_speed=(300, 400), rates=(0, 0, 2.0))
    before = spin(x)
    for motors in ((0.9, 0.2), (0.0, 0.0), (0.3, 1.0)):
        x = fly(x, p, 0.4, 1e-3, (*motors, 0, 0))
        assert abs(x[12]) > 5.0  # it does turn
        assert spin(x) == pytest.approx(before, abs=1e-9 * p["Jreact_up"] * 400)


def test_upper_rotor_accelerating_turns_the_nose_right(vehicle) -> None:
    # The upper rotor turns anticlockwise seen from above (eq. 4.15: its drag turns the fuselage to +z).
    t = find_trim(vehicle)
    p, dx = model_parameters(vehicle, 7.2), np.empty(21)
    x = t.state.copy()
    x[2] = -10
    state_derivative(x, t.input + np.array([0.05, 0, 0, 0]), STILL_AIR, p, dx)
    assert dx[18] > 0
    assert dx[12] > 0


@pytest.mark.parametrize("velocity", [(0, 0, 0), (0, 0, -0.5), (0, 0, 0.5), (1.5, -1, -0.3)])
def test_forces_balance_in_steady_flight(published, velocity) -> None:
    vehicle = published
    t = find_trim(vehicle, velocity=velocity, wind=(0.2, 0.1, 0.0), heading=0.4)
    a = body_to_ned_matrix(t.state[6:10])
    air = a.T @ (np.asarray(velocity) - t.wind)
    areas = [float(getattr(vehicle.body, f"drag_area_{i}")) for i in "xyz"]
    drag = -0.5 * float(vehicle.air.density) * np.array(areas) * np.abs(air) * air
    thrust = np.array([0, 0, -t.thrust_N.sum() + float(vehicle.body.downwash_drag)])
    weight = np.array([0, 0, float(vehicle.body.mass) * GRAVITY])
    assert_allclose(a @ (thrust + drag) + weight, 0.0, atol=1e-8)
    assert t.torque_Nm[0] == pytest.approx(t.torque_Nm[1], rel=1e-8)


def test_climbing_costs_more_than_hovering(vehicle) -> None:
    climb, hover = find_trim(vehicle, velocity=(0, 0, -3)), find_trim(vehicle)
    assert climb.battery_power_W > hover.battery_power_W
    assert np.all(climb.motor_input > hover.motor_input)


def test_terminal_speed_and_the_way_to_it(vehicle) -> None:
    # m dv/dt = m g - k v^2 gives v = v_t tanh(g t / v_t), v_t = sqrt(m g / k), once the rotors stand still.
    p = model_parameters(vehicle)
    terminal = np.sqrt(p["mass"] * GRAVITY / p["drag_over_speed2_z"])
    x = initial_state(position=(0, 0, -2000))
    for t in (0.5, 3.0, 12.0):
        y = fly(x, p, t, 1e-3)
        assert y[5] == pytest.approx(terminal * np.tanh(GRAVITY * t / terminal), rel=1e-9)
    assert terminal == pytest.approx(31.2, abs=0.1)


def test_wind_carries_a_body_along(vehicle) -> None:
    # In the frame of the air, horizontal drag slows it like m dv/dt = -k v^2: v = v0 / (1 + k v0 t / m).
    p = model_parameters(vehicle)
    x = initial_state(position=(0, 0, -5000))
    wind, t = np.array([6.0, 0, 0]), 4.0
    y = x.copy()
    integrate_state(y, NO_INPUT, wind, p, 1e-3, 4000)
    assert y[3] - 6.0 == pytest.approx(-6.0 / (1 + p["drag_over_speed2_x"] * 6.0 * t / p["mass"]), rel=1e-9)


def test_simulate_samples_what_advance_integrates(vehicle) -> None:
    t = find_trim(vehicle)
    x = t.state.copy()
    x[2] = -2.0
    u = t.input + np.array([0.02, 0.0, 0.05, -0.02])
    data = simulate_open_loop(vehicle, x, u, duration_s=0.5, voltage=7.2)
    y = fly(x, model_parameters(vehicle, 7.2), 0.5, 1e-3, u)
    assert_allclose(data.truth_position.values[-1], y[0:3], rtol=0, atol=1e-13)
    assert data.sizes["time"] == 51
    assert all(data[name].attrs["units"] for name in data.data_vars)
