"""Closed forms of the actuators, the battery and the energy that passes through them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from mufly.dynamics import (
    compute_battery_supply,
    find_trim,
    initial_state,
    integrate_state,
    model_parameters,
    simulate_open_loop,
    state_derivative,
)
from mufly.vehicle import replace_parameters

CALM = np.zeros(3)
seeds = st.integers(0, 2**32 - 1)


def test_swash_plate_is_a_first_order_lag(vehicle) -> None:
    p, x = model_parameters(vehicle), initial_state(position=(0, 0, -100))
    T = float(vehicle.swash_plate.time_constant)
    full = float(vehicle.swash_plate.linkage) * float(vehicle.swash_plate.max_tilt)
    for k in range(1, 6):
        integrate_state(x, np.array([0, 0, 0.5, -0.25]), CALM, p, T / 100, 100)
        # Servo 2 rolls: tilt about x. Servo 1 pitches the nose down: negative tilt about y.
        assert x[13] == pytest.approx(-0.25 * full * (1 - np.exp(-k)), rel=1e-8)
        assert x[14] == pytest.approx(-0.5 * full * (1 - np.exp(-k)), rel=1e-8)


def test_one_motor_step_follows_its_linear_pole(vehicle) -> None:
    # A small step of one input: Omega(t) = b / lambda (exp(lambda t) - 1) with appendix B's lambda.
    t, p = find_trim(vehicle), model_parameters(vehicle, 7.2)
    cases = ((0, 18, p["torque_up"], p["J_up"], -1.4778), (1, 19, p["torque_dw"], p["J_dw"], -4.0148))
    for motor, index, torque, inertia, published in cases:
        speed = t.state[index]
        damping = p["dR"] + 2 * torque * speed / (p["gear_efficiency"] * p["gear_ratio"] ** 2)
        pole = -(damping + p["kE"] * p["kM"] / p["R_ohm"]) / inertia
        assert pole == pytest.approx(published, abs=1e-4)
        gain = p["kM"] * 7.2 / (p["gear_ratio"] * p["R_ohm"] * inertia)
        u, step = t.input.copy(), 1e-4
        u[motor] += step
        x = t.state.copy()
        x[2] = -500.0
        for time in (0.3, 0.6, 0.9):
            integrate_state(x, u, CALM, p, 1e-3, 300)
            assert x[index] - speed == pytest.approx(step * gain / pole * (np.exp(pole * time) - 1), rel=1e-4)


def test_bar_follows_a_held_mast_as_tan_half_angle(vehicle) -> None:
    # ds/dt = (u - (u.s) s) / T means d(angle)/dt = -sin(angle) / T, so tan(angle/2) decays with exp(-t/T):
    # for small angles the lag of eq. 4.22. Rotors at rest hold the mast, as nothing turns the fuselage.
    T = float(vehicle.stabiliser_bar.time_constant)
    p, first = model_parameters(vehicle), 0.5
    x = initial_state(position=(0, 0, -500), attitude=(0.2, 0.3, -1), bar_attitude=(0.2, 0.3 - first))
    mast = initial_state(attitude=(0.2, 0.3, -1))[15:18]
    start = np.tan(np.arccos(mast @ x[15:18]) / 2)
    for k in range(1, 5):
        integrate_state(x, np.zeros(4), CALM, p, 1e-3, 240)
        assert np.tan(np.arccos(mast @ x[15:18]) / 2) == pytest.approx(start * np.exp(-k * 0.24 / T), rel=1e-7)


def test_unit_vectors_stay_unit(vehicle, random_state) -> None:
    x = random_state(np.random.default_rng(2))
    x[6:10] *= 1.01
    x[15:18] *= 0.99
    for steps in (1, 3000):
        integrate_state(x, np.array([0.7, 0.7, 0.3, -0.2]), CALM, model_parameters(vehicle), 1e-3, steps)
        assert np.linalg.norm(x[6:10]) == pytest.approx(1.0, abs=1e-15)
        assert np.linalg.norm(x[15:18]) == pytest.approx(1.0, abs=1e-15)


def test_bar_does_not_turn_with_the_heading(vehicle) -> None:
    # Errata, point 3: eq. 4.22 would let the bar's tilt turn with the fuselage.
    slow = replace_parameters(vehicle, {"stabiliser_bar.time_constant": 1e8})
    x = initial_state(position=(0, 0, -500), bar_attitude=(0.2, 0.0), rates=(0, 0, 6.0))
    before = x[15:18].copy()
    integrate_state(x, np.zeros(4), CALM, model_parameters(slow), 1e-3, 1000)
    assert_allclose(x[15:18], before, atol=1e-7)


@settings(max_examples=50)
@given(seed=seeds)
def test_power_from_the_battery_is_accounted_for(vehicle, random_state, seed) -> None:
    # U I = U I_el + sum[R I_A^2 + kE i Omega I_A]  and  kM i Omega I_A = stored + friction + shaft / efficiency.
    # kE > kM in Table 5.3: (kE - kM) i Omega I_A is a loss that the identification lumps there (iron, brushes, PWM).
    rng = np.random.default_rng(seed)
    rubs = replace_parameters(vehicle, {"motor.friction_torque": rng.choice([0.0, 3e-4])})
    p, x, u = model_parameters(rubs), random_state(rng), rng.uniform(0, 1, size=4)
    dx = np.empty(21)
    state_derivative(x, u, CALM, p, dx)
    voltage, current = compute_battery_supply(x, u[0], u[1], p)
    i, copper, lumped, mechanical = p["gear_ratio"], 0.0, 0.0, 0.0
    for motor, k, torque, inertia in ((0, 18, p["torque_up"], p["J_up"]), (1, 19, p["torque_dw"], p["J_dw"])):
        speed, armature = x[k], (u[motor] * voltage - p["kE"] * i * x[k]) / p["R_ohm"]
        copper += p["R_ohm"] * armature**2
        lumped += (p["kE"] - p["kM"]) * i * speed * armature
        kinetic = i**2 * inertia * speed * dx[k]
        friction = i**2 * p["dR"] * speed**2 + i * p["Mf"] * speed
        mechanical += kinetic + friction + torque * speed**3 / p["gear_efficiency"]
    electronics = voltage * p["electronics_current"]
    assert voltage * current == pytest.approx(electronics + copper + lumped + mechanical, rel=1e-9, abs=1e-9)
    assert dx[20] == pytest.approx(-current / p["battery_capacity"], rel=1e-12)


@settings(max_examples=50)
@given(seed=seeds)
def test_sagging_voltage_solves_the_circuit(vehicle, random_state, seed) -> None:
    rng = np.random.default_rng(seed)
    p, x, u = model_parameters(vehicle), random_state(rng), rng.uniform(0, 1, size=2)
    open_circuit = np.interp(x[20], np.linspace(0, 1, 101), p["battery_curve"])

    def load(voltage):
        armature = (u * voltage - p["kE"] * p["gear_ratio"] * x[18:20]) / p["R_ohm"]
        return p["electronics_current"] + u @ armature

    solved = brentq(lambda v: open_circuit - p["battery_resistance"] * load(v) - v, 0.0, 20.0, xtol=1e-13)
    voltage, current = compute_battery_supply(x, u[0], u[1], p)
    assert voltage == pytest.approx(solved, rel=1e-11)
    assert current == pytest.approx(load(solved), rel=1e-9, abs=1e-9)


def test_constant_voltage_does_not_sag(vehicle) -> None:
    x = initial_state(rotor_speed=(376, 444), charge=0.1)
    assert compute_battery_supply(x, 1.0, 1.0, model_parameters(vehicle, 6.4))[0] == pytest.approx(6.4, abs=1e-12)
    constant = replace_parameters(vehicle, {"battery.model": "constant"})
    assert compute_battery_supply(x, 1.0, 1.0, model_parameters(constant))[0] == pytest.approx(7.2, abs=1e-12)


def test_battery_empties_in_capacity_over_current(vehicle) -> None:
    p = model_parameters(replace_parameters(vehicle, {"battery.capacity": 4.0}))
    x = initial_state(position=(0, 0, -5000))
    integrate_state(x, np.zeros(4), CALM, p, 1e-3, 5000)  # electronics alone: 0.4 A for 5 s of 10 s
    assert x[20] == pytest.approx(0.5, abs=1e-12)
    integrate_state(x, np.zeros(4), CALM, p, 1e-3, 6000)
    assert x[20] == 0.0


def test_hovering_time_at_constant_voltage(vehicle) -> None:
    small = replace_parameters(vehicle, {"battery.capacity": 20.0})
    t = find_trim(small, voltage=7.2)
    x = t.state.copy()
    x[2] = -5.0
    flight = simulate_open_loop(small, x, t.input, duration_s=5.0, voltage=7.2)
    used = 1.0 - float(flight.battery_charge[-1])
    assert used == pytest.approx(t.battery_current_A * 5.0 / 20.0, rel=1e-6)


def test_full_input_lifts_about_one_and_a_half_weights(vehicle) -> None:
    flight = simulate_open_loop(
        vehicle, initial_state(position=(0, 0, -50)), (1, 1, 0, 0), duration_s=4.0, sample_s=0.1, voltage=7.2
    )
    p = model_parameters(vehicle)
    up, dw = flight.truth_rotor_speed.values[-1]
    ratio = (p["thrust_up"] * up**2 + p["thrust_dw"] * dw**2) / (p["mass"] * 9.81)
    assert ratio == pytest.approx(1.6, abs=0.1)


def test_downwash_needs_thrust(vehicle, vacuum) -> None:
    # Constant in flight (eq. 4.19), none at rest.
    for speed, push in (((0, 0), 0.0), ((376, 444), 0.009), ((340, 400), 0.009), ((188, 222), 0.009 * 0.504)):
        with_drag, without = np.empty(21), np.empty(21)
        x = initial_state(position=(0, 0, -9), rotor_speed=speed)
        state_derivative(x, np.zeros(4), CALM, model_parameters(vehicle), with_drag)
        state_derivative(x, np.zeros(4), CALM, model_parameters(vacuum), without)
        assert 0.095 * (with_drag[5] - without[5]) == pytest.approx(push, rel=1e-2, abs=1e-12)
