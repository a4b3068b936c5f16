"""From symbols to the numbers of the equations of motion."""

import numpy as np
import pytest

import mufly
from mufly.dynamics import PARAMETER_DTYPE, model_parameters
from mufly.errors import InputError
from mufly.identify import choose_free_parameters
from mufly.identify.flight.free_parameters import (
    HEAVE_YAW_SYMBOLS,
    ROLL_PITCH_SYMBOLS,
    find_field_changes,
    list_held_parameters,
    parameters_at_theta,
    theta_to_values,
)
from mufly.vehicle import list_parameters, replace_parameters

OUTPUTS = ("height", "r", "p")


@pytest.fixture(scope="module")
def vehicle():
    return mufly.load_vehicle("mufly-1.1")


@pytest.mark.parametrize("symbol", [*HEAVE_YAW_SYMBOLS, *ROLL_PITCH_SYMBOLS, "R", "rho"])
def test_scaled_numbers_are_those_of_a_vehicle_with_the_new_value(vehicle, symbol):
    # A motor whose constants are far apart, because neither may pass the other, and with what may be left out.
    vehicle = replace_parameters(
        vehicle,
        {"motor.torque_constant": 0.001, "motor.back_emf_constant": 0.02, "motor.friction_torque": 2e-5},
    )
    (free,) = choose_free_parameters(vehicle, [symbol], OUTPUTS)
    base, changes = find_field_changes(vehicle, [free], None)
    theta = np.array([[0.6 * free.theta_low], [0.5 * free.theta_high]])
    made = parameters_at_theta(base, changes, theta)
    for row, value in zip(made, theta_to_values([free], theta)[:, 0], strict=True):
        try:
            wanted = model_parameters(replace_parameters(vehicle, {free.key: float(value)}))
        except InputError:  # a value that other parameters forbid
            continue
        for name in PARAMETER_DTYPE.names:
            if name not in ("contact_points", "contact_count", "contact_reach", "contact_friction_damping_limit"):
                assert np.allclose(row[name], wanted[name], rtol=1e-12, atol=0), name


def test_an_angle_may_start_at_zero_and_pass_it(vehicle):
    (free,) = choose_free_parameters(vehicle, ["phi_SP"], OUTPUTS)
    base, changes = find_field_changes(vehicle, [free], None)
    theta = np.array([[free.value_to_theta(v)] for v in (-0.2, 0.0, 0.35)])
    assert parameters_at_theta(base, changes, theta)["swash_phase"] == pytest.approx([-0.2, 0.0, 0.35])
    assert theta_to_values([free], np.array([free.theta_low, free.theta_high])[:, None])[:, 0] == pytest.approx(
        [-3.2, 3.2]
    )


def test_several_parameters_multiply(vehicle):
    free = choose_free_parameters(vehicle, ["cT_up", "R", "rho"], OUTPUTS)
    base, changes = find_field_changes(vehicle, free, 7.2)
    theta = np.array([[0.1, -0.02, 0.03]])
    values = dict(zip([f.key for f in free], theta_to_values(free, theta)[0].tolist(), strict=True))
    wanted = model_parameters(replace_parameters(vehicle, values), 7.2)
    made = parameters_at_theta(base, changes, theta)[0]
    assert made["thrust_up"] == pytest.approx(wanted["thrust_up"], rel=1e-12)
    assert made["torque_dw"] == pytest.approx(wanted["torque_dw"], rel=1e-12)


def test_theta_and_value_are_inverse(vehicle):
    free = choose_free_parameters(vehicle, ["z_up", "Izz", "delay", "bias_p"], OUTPUTS, delay_s=0.02)
    theta = np.array([0.3, -0.4, 0.7, 0.2])
    assert [f.value_to_theta(v) for f, v in zip(free, theta_to_values(free, theta), strict=True)] == pytest.approx(
        theta
    )
    assert theta_to_values(free, theta)[0] < 0  # a hub above stays above


def test_bounds_respect_the_schema(vehicle):
    (free,) = choose_free_parameters(vehicle, ["eta_gear"], OUTPUTS)
    assert theta_to_values([free], np.array([free.theta_high]))[0] == pytest.approx(1.0)


def test_provenance_sets_the_prior(vehicle):
    rows = {f.symbol: f for f in choose_free_parameters(vehicle, ["m", "Ixx", "cQ_up", "cDAx"], OUTPUTS)}
    stds = [rows[s].prior_std for s in ("m", "Ixx", "cQ_up", "cDAx")]  # measured, CAD, identified, estimated
    assert stds == sorted(stds)
    assert len(set(stds)) == 4


@pytest.mark.parametrize(
    ("symbols", "words"),
    [
        (["cTdw"], "did you mean 'cT_dw'"),
        (["IXX"], "did you mean 'Ixx'"),
        (["qqqqqqqq"], "use symbols of `mufly vehicle show`"),
        (["legs"], "is not a parameter"),
        (["Izz", "Izz"], "is named twice"),
        (["bias_yaw"], "not the bias of a measured output"),
        ([], "no parameter is free"),
    ],
)
def test_what_cannot_be_free_is_said_in_one_line(vehicle, symbols, words):
    with pytest.raises(InputError, match=words) as caught:
        choose_free_parameters(vehicle, symbols, OUTPUTS)
    assert "\n" not in str(caught.value)


def test_a_start_of_zero_is_refused(vehicle):
    still = replace_parameters(vehicle, {"body.downwash_drag": 0.0})
    with pytest.raises(InputError, match="starts at 0"):
        choose_free_parameters(still, ["Whub"], OUTPUTS)


def test_every_symbol_of_the_parts_exists(vehicle):
    known = {r.symbol for r in list_parameters(vehicle)}
    assert set(HEAVE_YAW_SYMBOLS) | set(ROLL_PITCH_SYMBOLS) <= known


def test_a_map_in_place_of_the_coefficients_is_refused(vehicle):
    mapped = replace_parameters(vehicle, {"rotors.coefficient_map": "walkera-5g6-bemt"})
    with pytest.raises(InputError, match=r"coefficient_map.*remove it"):
        choose_free_parameters(mapped, ["Izz"], OUTPUTS)


@pytest.mark.parametrize("name", mufly.vehicle.list_builtin_vehicles())
def test_what_is_held_is_doubted_as_the_vehicle_file_states(name):
    """Air, gear and thrust counted as uncertain as anything estimated or identified."""
    known = mufly.load_vehicle(name)
    held = {
        h.symbol: h for h in list_held_parameters(known, choose_free_parameters(known, ["Izz"], OUTPUTS), 0.0, None)
    }
    rows = {r.symbol: r for r in list_parameters(known)}
    for symbol in ("rho", "eta_gear", "cT_up", "cT_dw", "m", "R"):
        assert 0.0 < held[symbol].prior_std == rows[symbol].std / rows[symbol].value < 0.06
        assert "std: " in rows[symbol].note
