"""Endurance and thrust to weight against closed forms for a battery that does not sag."""

import numpy as np
import pytest
from scipy.integrate import simpson

from mufly.dynamics import find_trim, hover_performance, model_parameters
from mufly.errors import MuflyError
from mufly.vehicle import replace_parameters


def test_a_constant_battery_lasts_capacity_over_current(vehicle) -> None:
    h = hover_performance(replace_parameters(vehicle, {"battery.model": "constant"}))
    assert h.endurance_s == pytest.approx(900.0 / find_trim(vehicle).battery_current_A, rel=1e-9)
    assert h.thrust_to_weight_full == pytest.approx(h.thrust_to_weight_half, rel=1e-9)


def test_thrust_at_full_input_in_closed_form(vehicle) -> None:
    # Each rotor settles where eq. 4.29 is a quadratic in its speed.
    h = hover_performance(replace_parameters(vehicle, {"battery.model": "constant"}))
    p = model_parameters(vehicle, 7.2)
    thrust = 0.0
    for torque, gain in ((p["torque_up"], p["thrust_up"]), (p["torque_dw"], p["thrust_dw"])):
        a = torque / (p["gear_ratio"] ** 2 * p["gear_efficiency"])
        b = p["dR"] + p["kM"] * p["kE"] / p["R_ohm"]
        c = -p["kM"] * 7.2 / (p["gear_ratio"] * p["R_ohm"])
        thrust += gain * ((-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)) ** 2
    assert h.thrust_to_weight_full == pytest.approx(thrust / (0.095 * 9.81), rel=1e-8)
    assert h.thrust_to_weight_full == pytest.approx(1.6, abs=0.05)


def test_hover_on_a_half_full_battery(vehicle) -> None:
    h, t = hover_performance(vehicle), find_trim(vehicle, charge=0.5)
    assert h.motor_input == pytest.approx(tuple(t.motor_input))
    assert h.battery_power_W == pytest.approx(19.25, abs=0.01)
    assert 240 < h.endurance_s < 330
    assert 1.2 < h.thrust_to_weight_half < h.thrust_to_weight_full < 1.6


def test_what_cannot_hover_has_no_performance(vehicle) -> None:
    with pytest.raises(MuflyError, match="too heavy"):
        hover_performance(replace_parameters(vehicle, {"body.mass": 0.2}))


def test_endurance_is_the_integral_over_the_charge(vehicle) -> None:
    # Lowest voltage out of the way, so that the whole charge is used: Simpson's rule on a finer grid.
    v = replace_parameters(vehicle, {"battery.low_voltage": 3.0})
    charges = np.linspace(0, 1, 101)
    seconds = [900.0 / find_trim(v, charge=c).battery_current_A for c in charges]
    assert hover_performance(v).endurance_s == pytest.approx(simpson(seconds, x=charges), rel=1e-3)
    assert hover_performance(vehicle).endurance_s < hover_performance(v).endurance_s
