"""Endurance: closed forms, and agreement with the flight model."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mufly.drive import (
    battery_voltage,
    drive_of_vehicle,
    find_operating_point,
    hover_endurance,
    load_drive,
    make_coefficient_load,
    terminal_voltage,
)
from mufly.dynamics import hover_performance
from mufly.errors import MuflyError
from mufly.vehicle import load_vehicle, replace_parameters

VEHICLE = load_vehicle("mufly-1.1")
BATTERY = VEHICLE.battery


def test_constant_voltage_lasts_as_long_as_charge_over_current() -> None:
    flat = replace_parameters(VEHICLE, {"battery.model": "constant"}).battery
    e = hover_endurance(flat, power_W=14.4, motor_voltage_V=5.0)
    assert e.time_s == pytest.approx(900.0 / (14.4 / 7.2 + 0.4), rel=1e-12)
    assert e.ends_by == "empty"
    assert e.charge_left == 0.0


def test_agrees_with_the_differential_equation() -> None:
    power = 16.0
    e = hover_endurance(BATTERY, power_W=power, motor_voltage_V=5.5)
    curve = BATTERY.open_circuit_voltage

    def slope(t, z):
        u = battery_voltage(BATTERY, np.interp(z, curve.fraction, curve.value), power)
        return -(power / u + float(BATTERY.electronics_current)) / float(BATTERY.capacity)

    def end(t, z):
        return z[0] - e.charge_left

    end.terminal = True
    run = solve_ivp(slope, (0, 3600), [1.0], events=end, rtol=1e-9, atol=1e-12, max_step=2.0)
    assert e.time_s == pytest.approx(run.t_events[0][0], rel=1e-6)


def test_end_is_where_the_voltage_says() -> None:
    e = hover_endurance(BATTERY, power_W=14.0, motor_voltage_V=5.5)
    assert e.ends_by == "low voltage"
    assert e.voltage_end_V == pytest.approx(6.0)
    e = hover_endurance(BATTERY, power_W=14.0, motor_voltage_V=6.5)
    assert e.ends_by == "full duty"
    assert e.voltage_end_V == pytest.approx(6.5)
    assert e.mean_current_A * e.time_s == pytest.approx(float(BATTERY.capacity) * (1 - e.charge_left))


def test_more_power_never_lasts_longer() -> None:
    times = [hover_endurance(BATTERY, power_W=p, motor_voltage_V=5.0).time_s for p in np.linspace(1, 30, 30)]
    assert np.all(np.diff(times) < 0)


def test_breakdown_ends_a_hover_without_any_voltage_limit() -> None:
    free = replace_parameters(VEHICLE, {"battery.low_voltage": 0.5}).battery
    power = 35.0
    e = hover_endurance(free, power_W=power, motor_voltage_V=0.1)
    assert e.ends_by == "breakdown"
    assert e.voltage_end_V == pytest.approx(np.sqrt(0.35 * power), rel=1e-6)


def test_too_much_power_is_refused() -> None:
    with pytest.raises(MuflyError, match="full battery cannot hold"):
        hover_endurance(BATTERY, power_W=60.0, motor_voltage_V=5.0)
    with pytest.raises(MuflyError, match="full duty"):
        hover_endurance(BATTERY, power_W=10.0, motor_voltage_V=8.3)


def test_agrees_with_the_flight_models_hover() -> None:
    flown, drive = hover_performance(VEHICLE), drive_of_vehicle(VEHICLE)
    power, voltage = 0.0, 0.0
    for thrust, rotor in zip(flown.thrust_N, (VEHICLE.rotors.upper, VEHICLE.rotors.lower), strict=True):
        load = make_coefficient_load(
            float(rotor.thrust_coefficient),
            float(rotor.torque_coefficient),
            radius_m=float(VEHICLE.rotors.radius),
        )
        p = find_operating_point(drive, load, thrust_N=thrust)
        power, voltage = power + float(p.input_power_W), max(voltage, float(p.motor_voltage_V))
    e = hover_endurance(BATTERY, power_W=power, motor_voltage_V=voltage)
    # There the end is looked for on 21 charges and rounded up to one of them.
    assert e.time_s == pytest.approx(flown.endurance_s, rel=0.05)
    current = power / flown.battery_voltage_V + float(BATTERY.electronics_current)
    assert current == pytest.approx(flown.battery_current_A, rel=1e-3)


def test_constant_power_and_given_duty_see_the_same_terminal_voltage() -> None:
    duty, resistance = 0.7, 1.4
    u = terminal_voltage(7.7, 0.35, 2 * duty**2 / resistance, 2 * duty * 2.5 / resistance, 0.4)
    power = 2 * duty * u * (duty * u - 2.5) / resistance
    assert battery_voltage(BATTERY, 7.7, power) == pytest.approx(u, rel=1e-12)


def test_drive_of_a_vehicle_is_the_built_in_one() -> None:
    assert load_drive("mufly") == drive_of_vehicle(VEHICLE)
