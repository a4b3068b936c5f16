"""Operating point of rotor and drive: closed forms, energy balance, limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.drive import (
    MotorConstants,
    armature_current,
    battery_voltage,
    compute_operating_point,
    find_operating_point,
    find_speed_for_thrust,
    load_drive,
    make_coefficient_load,
    open_circuit_voltage,
    rotor_acceleration,
)
from mufly.errors import InputError, MuflyError

DRIVE = load_drive("mufly")
RADIUS, C_T, C_Q = 0.0875, 0.0138, 0.0025
LOAD = make_coefficient_load(C_T, C_Q, radius_m=RADIUS)
K_Q = 1.2 * np.pi * RADIUS**5 * C_Q
K_T = 1.2 * np.pi * RADIUS**4 * C_T

constants = st.builds(
    MotorConstants,
    back_emf_V_s=st.floats(1e-3, 2e-2),
    torque_Nm_A=st.floats(1e-3, 2e-2),
    resistance_ohm=st.floats(0.05, 5),
    friction_Nm_s=st.floats(0, 1e-6),
    gear_ratio=st.floats(0.5, 10),
    gear_efficiency=st.floats(0.5, 1),
    controller_efficiency=st.floats(0.7, 1),
    friction_Nm=st.floats(0, 1e-3),
)


@given(gear=st.floats(0.5, 8), duty=st.floats(0.05, 1))
def test_speed_is_the_root_of_the_quadratic_with_constant_coefficients(gear: float, duty: float) -> None:
    c, u = DRIVE.motor_constants(), duty * 7.2
    # kM (U - kE i W) / (i R) - dR W - k W^2 / (i^2 eta) = 0, eq. 3.18
    a = K_Q / (gear**2 * c.gear_efficiency)
    b = c.friction_Nm_s + c.torque_Nm_A * c.back_emf_V_s / c.resistance_ohm
    d = c.torque_Nm_A * u / (gear * c.resistance_ohm)
    expected = 2 * d / (b + np.sqrt(b * b + 4 * a * d))
    point = find_operating_point(DRIVE, LOAD, duty=duty, supply_V=7.2, gear_ratio=gear)
    assert point.speed_rad_s == pytest.approx(expected, rel=1e-9)
    assert point.motor_voltage_V == pytest.approx(u, rel=1e-9)
    same = find_operating_point(DRIVE, LOAD, motor_voltage_V=u, supply_V=7.2, gear_ratio=gear)
    assert same.speed_rad_s == pytest.approx(expected, rel=1e-9)


@given(c=constants, speed=st.floats(10, 2000), torque=st.floats(0, 0.05))
def test_power_is_conserved(c: MotorConstants, speed: float, torque: float) -> None:
    p = compute_operating_point(c, speed, 0.5, torque, 12.0)
    losses = p.copper_loss_W + p.conversion_loss_W + p.friction_loss_W + p.gear_loss_W + p.controller_loss_W
    assert p.mechanical_power_W + losses == pytest.approx(p.input_power_W, rel=1e-9, abs=1e-12)
    assert p.input_power_W == pytest.approx(p.voltage_V * p.supply_current_A)


@given(c=constants, speed=st.floats(10, 2000), torque=st.floats(0, 0.05))
def test_steady_means_that_the_flight_models_motor_rests(c: MotorConstants, speed: float, torque: float) -> None:
    p = compute_operating_point(c, speed, 0.5, torque, 12.0)
    current = armature_current(float(p.duty), 12.0, speed, c.back_emf_V_s, c.resistance_ohm, c.gear_ratio)
    drive = c.torque_Nm_A * abs(current) / c.gear_ratio
    rest = rotor_acceleration(
        current, speed, torque, c.torque_Nm_A, c.friction_Nm_s, c.friction_Nm, c.gear_ratio, c.gear_efficiency, 1.0
    )  # fmt: skip
    # The current is a small difference of voltages where the resistance is small.
    size = drive + c.torque_Nm_A * float(p.motor_voltage_V) / (c.resistance_ohm * c.gear_ratio)
    assert rest == pytest.approx(0.0, abs=1e-11 * size)


def test_thrust_and_duty_describe_the_same_point() -> None:
    by_thrust = find_operating_point(DRIVE, LOAD, thrust_N=0.47, charge=0.6)
    by_duty = find_operating_point(DRIVE, LOAD, duty=float(by_thrust.duty), charge=0.6)
    for name, value in vars(by_thrust).items():
        assert getattr(by_duty, name) == pytest.approx(value, rel=1e-8, abs=1e-10), name
    assert by_thrust.speed_rad_s == pytest.approx(np.sqrt(0.47 / K_T), rel=1e-10)


def test_cases_in_an_array_are_those_one_by_one() -> None:
    thrust, gear = np.array([0.1, 0.3, 0.5])[:, None], np.array([1.2, 1.8, 2.4])
    many = find_operating_point(DRIVE, LOAD, thrust_N=thrust, gear_ratio=gear)
    assert many.speed_rad_s.shape == (3, 3)
    for i in range(3):
        for j in range(3):
            one = find_operating_point(DRIVE, LOAD, thrust_N=thrust[i, 0], gear_ratio=gear[j])
            assert many.input_power_W[i, j] == pytest.approx(one.input_power_W, rel=1e-12)


def test_battery_closes_its_circuit() -> None:
    point = find_operating_point(DRIVE, LOAD, duty=0.7, charge=0.5)
    b = DRIVE.battery
    current = 2 * point.supply_current_A + float(b.electronics_current)
    rest = open_circuit_voltage(b, 0.5)
    assert point.voltage_V == pytest.approx(rest - float(b.internal_resistance) * current, rel=1e-10)
    voltage = battery_voltage(b, rest, 2 * point.input_power_W)
    assert voltage == pytest.approx(point.voltage_V, rel=1e-10)


def test_battery_breaks_down_beyond_its_greatest_power() -> None:
    b = DRIVE.battery
    e = 7.4 - float(b.internal_resistance) * float(b.electronics_current)
    greatest = e**2 / (4 * float(b.internal_resistance))
    assert battery_voltage(b, 7.4, 0.999 * greatest) > 0
    assert np.isnan(battery_voltage(b, 7.4, 1.001 * greatest))


def test_without_losses_all_power_reaches_the_rotor() -> None:
    ideal = MotorConstants(0.004, 0.004, 1e-9, 0.0, 2.0, 1.0, 1.0)
    p = compute_operating_point(ideal, 400.0, 0.4, 0.006, 7.2)
    assert p.efficiency == pytest.approx(1.0, abs=1e-6)
    assert p.thrust_per_power_N_W == pytest.approx(0.4 / (400 * 0.006), rel=1e-6)


def test_thrust_out_of_reach_is_said_with_what_can_be_reached() -> None:
    most = find_operating_point(DRIVE, LOAD, duty=1.0, supply_V=7.2)
    with pytest.raises(MuflyError, match=f"2 N is out of reach.*gives {float(most.thrust_N):.4g} N"):
        find_operating_point(DRIVE, LOAD, thrust_N=2.0, supply_V=7.2)
    just = find_operating_point(DRIVE, LOAD, thrust_N=float(most.thrust_N) * (1 - 1e-9), supply_V=7.2)
    assert just.duty == pytest.approx(1.0, abs=1e-6)


def test_load_without_thrust_is_out_of_reach() -> None:
    def flat(speed, case):
        return 0 * speed, 1e-9 * speed**2

    speed, found = find_speed_for_thrust(flat, [0.1])
    assert not found[0]
    assert np.isnan(speed[0])


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"thrust_N": 0.4, "duty": 0.5},
        {"duty": 1.2},
        {"duty": 0.0},
        {"thrust_N": np.nan},
        {"thrust_N": 0.4, "charge": 1.5},
        {"thrust_N": 0.4, "charge": 0.5, "supply_V": 7.2},
        {"thrust_N": 0.4, "supply_V": -1.0},
        {"thrust_N": 0.4, "gear_ratio": 0.0},
    ],
)
def test_what_makes_no_sense_is_refused(arguments) -> None:
    with pytest.raises(InputError):
        find_operating_point(DRIVE, LOAD, **arguments)
