"""From symbols to the numbers of the equations of motion."""

import numpy as np
import pytest

import mufly
from mufly.dynamics import PARAMETERS, model_parameters
from mufly.errors import InputError
from mufly.identify import choose_free
from mufly.identify.flight.free import (
    HEAVE_YAW,
    ROLL_PITCH,
    batch_parameters,
    held_parameters,
    numbers_at,
    physical,
)
from mufly.vehicle import parameters, replace

OUTPUTS = ("height", "r", "p")


@pytest.fixture(scope="module")
def vehicle():
    return mufly.load_vehicle("mufly-1.1")


@pytest.mark.parametrize("symbol", [*HEAVE_YAW, *ROLL_PITCH, "R", "rho"])
def test_scaled_numbers_are_those_of_a_vehicle_with_the_new_value(vehicle, symbol):
    # A motor whose constants are far apart, because neither may pass the other, and with what may be left out.
    vehicle = replace(
        vehicle,
        {"motor.torque_constant": 0.001, "motor.back_emf_constant": 0.02, "motor.friction_torque": 2e-5},
    )
    (free,) = choose_free(vehicle, [symbol], OUTPUTS)
    base, powers = batch_parameters(vehicle, [free], None)
    theta = np.array([[0.6 * free.low], [0.5 * free.high]])
    made = numbers_at(base, powers, theta)
    for row, value in zip(made, physical([free], theta)[:, 0], strict=True):
        try:
            wanted = model_parameters(replace(vehicle, {free.key: float(value)}))
        except InputError:  # a value that other parameters forbid
            continue
        for name in PARAMETERS.names:
            if name not in ("contact_points", "contact_count", "contact_reach", "friction_bound"):
                assert np.allclose(row[name], wanted[name], rtol=1e-12, atol=0), name


def test_several_parameters_multiply(vehicle):
    free = choose_free(vehicle, ["cT_up", "R", "rho"], OUTPUTS)
    base, powers = batch_parameters(vehicle, free, 7.2)
    theta = np.array([[0.1, -0.02, 0.03]])
    values = dict(zip([f.key for f in free], physical(free, theta)[0].tolist(), strict=True))
    wanted = model_parameters(replace(vehicle, values), 7.2)
    made = numbers_at(base, powers, theta)[0]
    assert made["thrust_up"] == pytest.approx(wanted["thrust_up"], rel=1e-12)
    assert made["torque_dw"] == pytest.approx(wanted["torque_dw"], rel=1e-12)


def test_theta_and_value_are_inverse(vehicle):
    free = choose_free(vehicle, ["z_up", "Izz", "delay", "bias_p"], OUTPUTS, delay_s=0.02)
    theta = np.array([0.3, -0.4, 0.7, 0.2])
    assert [f.theta(v) for f, v in zip(free, physical(free, theta), strict=True)] == pytest.approx(theta)
    assert physical(free, theta)[0] < 0  # a hub above stays above


def test_bounds_respect_the_schema(vehicle):
    (free,) = choose_free(vehicle, ["eta_gear"], OUTPUTS)
    assert free.value(free.high) == pytest.approx(1.0)


def test_provenance_sets_the_prior(vehicle):
    rows = {f.symbol: f for f in choose_free(vehicle, ["m", "Ixx", "cQ_up", "cDAx"], OUTPUTS)}
    stds = [rows[s].prior_std for s in ("m", "Ixx", "cQ_up", "cDAx")]  # measured, CAD, identified, estimated
    assert stds == sorted(stds)
    assert len(set(stds)) == 4


@pytest.mark.parametrize(
    ("symbols", "words"),
    [
        (["cTdw"], "did you mean 'cT_dw'"),
        (["IXX"], "did you mean 'Ixx'"),
        (["qqqqqqqq"], "use symbols of `mufly vehicle show`"),
        (["legs"], "is no parameter"),
        (["Izz", "Izz"], "is named twice"),
        (["bias_yaw"], "bias of nothing"),
        ([], "no parameter is free"),
    ],
)
def test_what_cannot_be_free_is_said_in_one_line(vehicle, symbols, words):
    with pytest.raises(InputError, match=words) as caught:
        choose_free(vehicle, symbols, OUTPUTS)
    assert "\n" not in str(caught.value)


def test_a_start_of_zero_is_refused(vehicle):
    still = replace(vehicle, {"body.downwash_drag": 0.0})
    with pytest.raises(InputError, match="starts at 0"):
        choose_free(still, ["Whub"], OUTPUTS)


def test_every_symbol_of_the_parts_exists(vehicle):
    known = {r.symbol for r in parameters(vehicle)}
    assert set(HEAVE_YAW) | set(ROLL_PITCH) <= known


def test_a_map_in_place_of_the_coefficients_is_refused(vehicle):
    mapped = replace(vehicle, {"rotors.coefficient_map": "walkera-5g6-bemt"})
    with pytest.raises(InputError, match=r"coefficient_map.*take it out"):
        choose_free(mapped, ["Izz"], OUTPUTS)


@pytest.mark.parametrize("name", mufly.vehicle.builtin_vehicles())
def test_what_is_held_is_doubted_as_the_vehicle_file_states(name):
    """Air, gear and thrust counted as uncertain as anything estimated or identified."""
    known = mufly.load_vehicle(name)
    held = {h.symbol: h for h in held_parameters(known, choose_free(known, ["Izz"], OUTPUTS), 0.0, None)}
    rows = {r.symbol: r for r in parameters(known)}
    for symbol in ("rho", "eta_gear", "cT_up", "cT_dw", "m", "R"):
        assert 0.0 < held[symbol].prior_std == rows[symbol].std / rows[symbol].value < 0.06
        assert "std: " in rows[symbol].note
