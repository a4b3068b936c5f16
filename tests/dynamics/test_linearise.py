"""Appendix B, entry by entry, and what the linear model predicts of the nonlinear one."""

import math

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from mufly.dynamics import (
    body_to_ned_matrix,
    euler_from_quaternion,
    find_trim,
    integrate_state,
    linearise_vehicle,
    model_parameters,
)
from mufly.vehicle import load_vehicle, replace_parameters


def appendix_b(v, voltage):
    """B.1 to B.18 written out for a vehicle, at the hover point of eq. 5.1; signs as in thesis-errata.md."""
    f = float
    m, up, dw = f(v.body.mass), v.rotors.upper, v.rotors.lower
    Ixx, Iyy, Izz = f(v.body.inertia_xx), f(v.body.inertia_yy), f(v.body.inertia_zz)
    kT = math.pi * f(v.air.density) * f(v.rotors.radius) ** 4
    kQ = kT * f(v.rotors.radius)
    cT_up, cT_dw = f(up.thrust_coefficient), f(dw.thrust_coefficient)
    cQ_up, cQ_dw = f(up.torque_coefficient), f(dw.torque_coefficient)
    J_up, J_dw = f(up.drive_inertia), f(dw.drive_inertia)
    kE, kM, dR, R = (f(getattr(v.motor, n)) for n in ("back_emf_constant", "torque_constant", "friction", "resistance"))
    i, eta = f(v.gear.ratio), f(v.gear.efficiency)
    T_dw, T_up = f(v.swash_plate.time_constant), f(v.stabiliser_bar.time_constant)
    gain, l_up = f(v.swash_plate.linkage) * f(v.swash_plate.max_tilt), f(v.stabiliser_bar.linkage)
    z_up, z_dw = f(up.hub_z), f(dw.hub_z)

    hov_up = math.sqrt((m * 9.81 + f(v.body.downwash_drag)) / (kT * (cT_up + cT_dw * cQ_up / cQ_dw)))
    hov_dw = hov_up * math.sqrt(cQ_up / cQ_dw)

    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = 1
    A[1, 4] = -2 * cT_dw * kT * hov_dw / m
    A[1, 5] = -2 * cT_up * kT * hov_up / m
    q_dw, q_up = 2 * cQ_dw * kQ * hov_dw, 2 * cQ_up * kQ * hov_up
    A[3, 4] = dR / Izz - q_dw / Izz + q_dw / (eta * i**2 * Izz) + kE * kM / (R * Izz)  # B.2
    A[3, 5] = -dR / Izz + q_up / Izz - q_up / (eta * i**2 * Izz) - kE * kM / (R * Izz)  # B.3
    A[4, 4] = -dR / J_dw - q_dw / (eta * i**2 * J_dw) - kE * kM / (R * J_dw)  # B.4
    A[5, 5] = -dR / J_up - q_up / (eta * i**2 * J_up) - kE * kM / (R * J_up)  # B.5
    B = np.zeros((6, 2))
    b = kM * voltage / (i * R)
    B[3] = -b / Izz, b / Izz  # B.6
    B[4, 0], B[5, 1] = b / J_dw, b / J_up

    a = np.zeros((8, 8))
    a[0, 2] = a[1, 3] = 1
    lift_up, lift_dw = cT_up * kT * hov_up**2, cT_dw * kT * hov_dw**2
    a[2, 0] = lift_up * l_up * z_up / Ixx  # B.10
    a[2, 5] = -lift_dw * z_dw / Ixx  # B.11
    a[2, 6] = -a[2, 0]  # B.12
    a[3, 1] = lift_up * l_up * z_up / Iyy  # B.13
    a[3, 4] = lift_dw * z_dw / Iyy  # B.14
    a[3, 7] = -a[3, 1]  # B.15
    a[4, 4] = a[5, 5] = -1 / T_dw
    a[6, 0] = a[7, 1] = 1 / T_up
    a[6, 6] = a[7, 7] = -1 / T_up
    c = np.zeros((8, 2))
    c[4, 0] = c[5, 1] = gain / T_dw  # B.16
    return A, B, a, c


def assert_matrix(found, expected) -> None:
    # Relative to each entry; zeros of appendix B have to be exact zeros.
    assert_allclose(found, expected, rtol=2e-7, atol=0)


@pytest.mark.parametrize("name", ["mufly-1.1", "mufly-2.0"])
@pytest.mark.parametrize("voltage", [7.2, 6.4])
def test_matrices_are_appendix_b(name, voltage) -> None:
    v = replace_parameters(load_vehicle(name), {"rotors.inplane_drag": 0.0})  # which the thesis does not have
    linear = linearise_vehicle(v, voltage=voltage)
    A, B, a, c = appendix_b(v, voltage)
    assert_matrix(linear.heave_yaw.A, A)
    assert_matrix(linear.heave_yaw.B, B)
    assert_matrix(linear.roll_pitch.A, a)
    assert_matrix(linear.roll_pitch.B, c)
    assert linear.heave_yaw.output_labels == ["z", "psi", "r"]
    assert linear.roll_pitch.output_labels == ["phi", "theta", "p", "q"]
    assert_allclose(linear.heave_yaw.C, np.eye(6)[[0, 2, 3]])
    assert_allclose(linear.roll_pitch.C, np.eye(8)[:4])


FACTORS = {
    key: st.floats(0.75, 1.25)
    for key in (
        "body.mass",
        "body.inertia_xx",
        "body.inertia_yy",
        "body.inertia_zz",
        "body.downwash_drag",
        "air.density",
        "rotors.upper.thrust_coefficient",
        "rotors.upper.torque_coefficient",
        "rotors.upper.hub_z",
        "rotors.upper.drive_inertia",
        "rotors.lower.thrust_coefficient",
        "rotors.lower.torque_coefficient",
        "rotors.lower.hub_z",
        "rotors.lower.drive_inertia",
        "swash_plate.time_constant",
        "swash_plate.linkage",
        "stabiliser_bar.time_constant",
        "stabiliser_bar.linkage",
        "motor.back_emf_constant",
        "motor.friction",
        "motor.resistance",
        "gear.ratio",
    )
} | {"motor.torque_constant": st.floats(0.6, 0.98)}  # below every back-EMF constant above


def value_of(v, key):
    for part in key.split("."):
        v = getattr(v, part)
    return float(v)


@settings(max_examples=30)
@given(factors=st.fixed_dictionaries(FACTORS), heading=st.floats(-3, 3))
def test_matrices_are_appendix_b_for_any_vehicle(published, factors, heading) -> None:
    values = {key: value_of(published, key) * factor for key, factor in factors.items()}
    for rotor in ("upper", "lower"):
        values[f"rotors.{rotor}.reaction_inertia"] = values[f"rotors.{rotor}.drive_inertia"]
    v, voltage = replace_parameters(published, values), 30.0  # any of them hovers at that voltage
    linear = linearise_vehicle(v, find_trim(v, voltage=voltage, heading=heading))
    A, B, a, c = appendix_b(v, voltage)
    assert_matrix(linear.heave_yaw.A, A)
    assert_matrix(linear.heave_yaw.B, B)
    assert_matrix(linear.roll_pitch.A, a)
    assert_matrix(linear.roll_pitch.B, c)


def test_published_poles(published) -> None:
    linear = linearise_vehicle(published)
    motors = np.sort(np.diag(linear.heave_yaw.A)[4:])
    assert_allclose(motors, [-4.01, -1.48], atol=0.006)
    assert_allclose(np.sort(linear.heave_yaw.poles().real)[:2], motors, atol=1e-9)
    assert np.sum(np.abs(linear.heave_yaw.poles()) == 0) == 4
    poles = linear.roll_pitch.poles()
    for expected in (-2.08 + 12.81j, -2.08 + 11.30j, -2.08 - 12.81j, -2.08 - 11.30j, -1000):
        assert np.min(np.abs(poles - expected)) < 0.006
    # The swinging pair is s^2 + s / T + |a31| after the free mode (bar and mast tilted together) is divided out.
    stiffness, T = -linear.roll_pitch.A[2, 0], 0.24
    assert np.min(np.abs(poles - np.roots([1, 1 / T, stiffness])[0])) < 1e-7


@pytest.mark.parametrize(
    ("voltage", "low", "high"),
    [(7.2, 2.9458, 646.72), (6.4, 2.8098, 574.87)],
)
def test_crossings_of_the_heave_yaw_plant(vehicle, voltage, low, high) -> None:
    plant = linearise_vehicle(vehicle, voltage=voltage).heave_yaw

    def gain(w, k):
        return np.linalg.svd(plant(1j * w), compute_uv=False)[k]

    found_low = brentq(lambda w: gain(w, 1) - 1, 1.0, 10.0)
    found_high = brentq(lambda w: gain(w, 0) - 1, 100.0, 5000.0)
    assert found_low == pytest.approx(low, rel=1e-4)
    assert found_high == pytest.approx(high, rel=1e-4)
    if voltage == 6.4:
        # The thesis prints 2.82 and 575: the first points below 0 dB on a grid of 100 points a decade.
        grid = 10 ** (np.arange(-500, 501) / 100)
        assert grid[grid > found_low][0] == pytest.approx(2.82, abs=0.005)
        assert grid[grid > found_high][0] == pytest.approx(575, abs=0.5)


def test_hover_matrices_do_not_depend_on_the_drag_areas(published, vacuum) -> None:
    with_drag = linearise_vehicle(published)
    body = {"body.downwash_drag": 0.009}
    assert_allclose(with_drag.full.A, linearise_vehicle(replace_parameters(vacuum, body)).full.A, rtol=1e-7, atol=1e-9)


def thesis_state(x, heading):
    """The 19 coordinates of the linear model."""
    body, (c, s) = body_to_ned_matrix(x[6:10]).T, (np.cos(heading), np.sin(heading))
    bar = np.array([c * x[15] + s * x[16], -s * x[15] + c * x[16], x[17]])
    euler = euler_from_quaternion(x[6:10])
    bar_angles = [np.arcsin(bar[1]), np.arctan2(-bar[0], -bar[2])]
    return np.hstack([x[0:3], body @ x[3:6], euler, x[10:13], -x[14], x[13], bar_angles, x[19], x[18], x[20]])


@pytest.mark.parametrize("velocity", [(0, 0, 0), (2.0, -1.0, -0.4), (14.0, -10.0, -1.0)])
@pytest.mark.parametrize("charge", [None, 0.6])
def test_linear_model_predicts_small_motions(vehicle, velocity, charge) -> None:
    # A large battery, because one that runs down is no steady point; in fast flight little drag of the rotors, whose
    # moment would be beyond the swash plate.
    fast = {"rotors.inplane_drag": 5e-4} if velocity[0] > 3.0 else {}
    large = replace_parameters(vehicle, {"battery.capacity": 9e4} | fast)
    t = find_trim(large, velocity=velocity, heading=0.8, charge=charge)
    linear, p = linearise_vehicle(large, t), model_parameters(large, t.constant_voltage_V)
    du = np.array([2e-7, -1e-7, 3e-7, -2e-7])  # motor upper, lower, servo 1, 2

    def fly(u):
        x, states = t.state.copy(), []
        x[2] = -8.0  # a small number, for the sake of round-off
        for _ in range(61):
            states.append(thesis_state(x, 0.8))
            # Servos move the swash plate at 1000 rad/s, hence the short step.
            integrate_state(x, u, t.wind, p, 2.5e-4, 40)
        return np.array(states)

    change = fly(t.input + du) - fly(t.input)
    time = np.arange(61) * 0.01
    response = control.forced_response(linear.full, time, np.tile(du[[1, 0, 2, 3], None], time.size))
    for k, name in enumerate(linear.full.state_labels):
        expected = np.asarray(response.outputs)[k]
        assert_allclose(change[:, k], expected, rtol=0, atol=2e-13 + 1e-3 * np.max(np.abs(expected)), err_msg=name)


def test_a_sagging_battery_couples_the_rotors(vehicle) -> None:
    # The source resistance acts like more armature resistance: less back-EMF damping, and both rotors couple.
    stiff = linearise_vehicle(
        vehicle, find_trim(vehicle, voltage=find_trim(vehicle, charge=0.5).battery_voltage_V)
    ).full
    sagging = linearise_vehicle(vehicle, find_trim(vehicle, charge=0.5)).full
    names = stiff.state_labels
    i, j = names.index("Omega_up"), names.index("Omega_dw")
    assert stiff.A[i, j] == 0.0
    assert sagging.A[i, j] > 0.0  # a faster lower rotor draws less current, so the upper gets more voltage
    assert sagging.A[i, names.index("charge")] > 0.0
