"""Gear ratios in closed form, and the claims of Fig. 3.7."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.drive import (
    compute_operating_point,
    find_full_voltage_gear_ratio,
    find_gear_optima,
    find_least_power_gear_ratio,
    load_drive,
    make_coefficient_load,
    sweep_gear_ratio,
)

DRIVE = load_drive("mufly")
UPPER = make_coefficient_load(0.0138, 0.0025, radius_m=0.0875)
LOWER = make_coefficient_load(0.0117, 0.0018, radius_m=0.0875)


def power(gear, speed, torque, rub=0.0):
    return compute_operating_point(
        DRIVE.motor_constants(gear_ratio=np.asarray(gear), friction_Nm=rub), speed, 0.4, torque, 7.2
    )


@given(speed=st.floats(200, 900), torque=st.floats(5e-4, 4e-3))
def test_adapted_gear_needs_exactly_full_voltage(speed: float, torque: float) -> None:
    gear = find_full_voltage_gear_ratio(DRIVE.motor_constants(), speed, torque, 7.2)
    assert power(gear, speed, torque).motor_voltage_V == pytest.approx(7.2, rel=1e-9)
    beyond = power(gear * 1.001, speed, torque)
    assert beyond.motor_voltage_V > 7.2  # the largest ratio that will do


@given(speed=st.floats(200, 900), torque=st.floats(5e-4, 3.5e-3), rub=st.sampled_from([0.0, 1e-5, 1e-3]))
def test_best_gear_is_the_least_power_of_a_search(speed: float, torque: float, rub: float) -> None:
    gear = find_least_power_gear_ratio(DRIVE.motor_constants(friction_Nm=rub), speed, torque, 7.2)
    tried = power(np.geomspace(0.05, 100, 4001), speed, torque, rub)
    allowed = tried.input_power_W[tried.motor_voltage_V <= 7.2]
    found = power(gear, speed, torque, rub)
    assert found.motor_voltage_V <= 7.2 * (1 + 1e-9)
    assert found.input_power_W <= allowed.min() * (1 + 1e-9)


def test_no_gear_makes_more_than_the_motors_greatest_power() -> None:
    c = DRIVE.motor_constants()
    a = c.torque_Nm_A * 7.2 / c.resistance_ohm
    b = c.torque_Nm_A * c.back_emf_V_s / c.resistance_ohm + c.friction_Nm_s
    greatest = c.gear_efficiency * a**2 / (4 * b)
    assert np.isfinite(find_full_voltage_gear_ratio(c, 500.0, 0.999 * greatest / 500, 7.2))
    assert np.isnan(find_full_voltage_gear_ratio(c, 500.0, 1.001 * greatest / 500, 7.2))
    assert np.isnan(find_least_power_gear_ratio(c, 500.0, 1.001 * greatest / 500, 7.2))


def test_greatest_mechanical_power_is_half_the_free_speed() -> None:
    # P = (A - B w) w eta is greatest at w = A / (2 B), whatever the rotor.
    c = DRIVE.motor_constants()
    a = c.torque_Nm_A * 7.2 / c.resistance_ohm
    b = c.torque_Nm_A * c.back_emf_V_s / c.resistance_ohm + c.friction_Nm_s
    for load in (UPPER, LOWER):
        best = find_gear_optima(DRIVE, load).mechanical_power
        curve = sweep_gear_ratio(DRIVE, load, [best])
        assert float(curve.motor_speed_rad_s[0]) == pytest.approx(a / (2 * b), rel=2e-4)
        assert float(curve.mechanical_power_W[0]) == pytest.approx(c.gear_efficiency * a**2 / (4 * b), rel=1e-6)


def test_thrust_and_mechanical_power_peak_together_at_constant_coefficients() -> None:
    best = find_gear_optima(DRIVE, UPPER)
    assert best.thrust == pytest.approx(best.mechanical_power, rel=1e-4)


def test_optima_of_fig_3_7() -> None:
    # Read off there: 1.5 for power and thrust, 3 for efficiency, 4 for thrust per power. Table 5.3's coefficients:
    upper, lower = find_gear_optima(DRIVE, UPPER, thrust_N=0.6), find_gear_optima(DRIVE, LOWER, thrust_N=0.6)
    assert lower.thrust < 1.5 < upper.thrust
    assert lower.efficiency < 3 < upper.efficiency
    assert lower.thrust_per_power < 4 < upper.thrust_per_power
    # 0.6 N at a ratio of 2 is what this drive does not do: it reaches 0.6 N still at 2.5.
    assert lower.for_required_thrust == pytest.approx(2.51, abs=0.02)
    assert upper.for_required_thrust == pytest.approx(2.64, abs=0.02)


def test_wanted_thrust_is_reached_at_the_gear_that_is_said() -> None:
    best = find_gear_optima(DRIVE, UPPER, thrust_N=0.5)
    curve = sweep_gear_ratio(DRIVE, UPPER, [best.for_required_thrust])
    assert float(curve.thrust_N[0]) == pytest.approx(0.5, rel=1e-4)
    assert np.isnan(find_gear_optima(DRIVE, UPPER, thrust_N=5.0).for_required_thrust)


def test_input_power_falls_with_the_gear() -> None:
    curve = sweep_gear_ratio(DRIVE, UPPER, np.linspace(0.5, 8, 50))
    assert np.all(np.diff(curve.input_power_W) < 0)
    assert curve.input_power_W.attrs["units"] == "W"
