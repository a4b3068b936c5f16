"""INDI: what inversion promises in theory, the same on the vehicle, and where the promise ends."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from mufly.control import DesignSettings, FlightController, design_flight_controller, disk_margin, sample_plant
from mufly.control.linear_systems import analyse_loop, extract_feedback_controller, frequency_response, state_space
from mufly.control.synthesis.indi import IndiGains, design_indi
from mufly.control.synthesis.weighting_schemes import scale_plant
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle, replace_parameters

OUTPUTS = ("phi", "theta", "p", "q")
G = np.array([[0.3, 40.0], [-31.0, 0.5]])  # rad/s2 per servo, axes coupled
LAG, PERIOD = 0.03, 0.005


def _body(second_lag: float | None = None) -> control.StateSpace:
    """Return a body without moments of its own, behind a lag of the servos and, if given, a second one."""
    one, none = np.eye(2), np.zeros((2, 2))
    A = np.block([[none, one, none, none], [none, none, G, none], [none, none, -one / LAG, one / LAG], [none] * 4])
    B = np.vstack([none, none, none, none])
    if second_lag is None:
        A, B = A[:6, :6], np.vstack([none, none, one / LAG])
    else:
        A[6:, 6:], B[6:] = -one / second_lag, one / second_lag
    states = ["phi", "theta", "p", "q", "a_dw", "b_dw", "d1", "d2"][: len(A)]
    C = np.eye(4, len(A))
    return state_space(A, B, C, np.zeros((4, 2)), inputs=("servo_1", "servo_2"), outputs=OUTPUTS, states=states)


@pytest.mark.parametrize("filter_rad_s", [20.0, 50.0, 200.0])
def test_inversion_leaves_the_servos_alone_whatever_the_filter(filter_rad_s: float) -> None:
    """Smeur, Chu and de Croon 2016, eq. 21: with the true servo model wdot = A nu; the filter does not appear."""
    gains = IndiGains(5.0, 12.0, filter_rad_s, delay_periods=2.0)
    law = design_indi(_body(), gains, PERIOD)
    assert law.effectiveness == pytest.approx(G)
    plant = _body(second_lag=2.0 * PERIOD)
    w = np.geomspace(1.0, 300.0, 60)
    g, k = frequency_response(plant, w), frequency_response(law.controller, w)
    follows = np.linalg.solve(np.eye(4) + g @ k, g @ k[:, :, :2])[:, :2]
    s = 1j * w
    servo = 1.0 / ((LAG * s + 1.0) * (2.0 * PERIOD * s + 1.0))
    wanted = gains.rate * gains.attitude * servo / (s * s + gains.rate * servo * (s + gains.attitude))
    assert follows[:, 0, 0] == pytest.approx(wanted, rel=0.01)
    assert follows[:, 1, 1] == pytest.approx(wanted, rel=0.01)
    assert np.abs(follows[:, 0, 1]).max() < 0.01  # the axes no longer couple
    # A servo twice as slow breaks it.
    slow = replace(gains, delay_periods=6.0)
    other = frequency_response(design_indi(_body(), slow, PERIOD).controller, w)
    broken = np.linalg.solve(np.eye(4) + g @ other, g @ other[:, :, :2])[:, 0, 0]
    assert np.abs(broken - wanted).max() > 0.05


def test_moments_at_the_servos_vanish_without_a_model_of_them() -> None:
    law = design_indi(_body(), IndiGains(), PERIOD)
    plant = _body(second_lag=3.0 * PERIOD)
    w = np.array([0.001, 0.01, 20.0])
    g, k = frequency_response(plant, w), frequency_response(law.controller, w)
    tilt = np.abs(np.linalg.solve(np.eye(4) + g @ k, g)[:, 1, 0])
    assert tilt[0] < 0.1 * tilt[2]  # below the leak, 0.05 rad/s, a small rest stays


def test_servos_that_do_not_turn_it_are_refused() -> None:
    plant = _body()
    A = plant.A.copy()
    A[2, 4:] = 0.0
    weak = state_space(
        A, plant.B, plant.C, plant.D, inputs=plant.input_labels, outputs=OUTPUTS, states=plant.state_labels
    )
    with pytest.raises(MuflyError, match="do not turn the vehicle about both axes"):
        design_indi(weak, IndiGains(), PERIOD)


@pytest.fixture(scope="module")
def by_indi(vehicle: Vehicle) -> FlightController:
    return design_flight_controller(vehicle, settings=DesignSettings(method="indi"))


def test_design_for_the_vehicle(by_indi: FlightController) -> None:
    d = by_indi.roll_pitch
    assert (d.method, by_indi.heave_yaw.method, d.discrete.order) == ("indi", "hinf", 8)
    assert d.discrete.anti_windup == "observer"  # the servo model follows the saturated command
    assert d.sampled_loop.sensitivity_peak_dB < 3.8
    assert d.sampled_loop.complementary_peak_dB < 2.5
    loop = sample_plant(d.plant, by_indi.period_s, 1), d.feedback_controller(d.discrete.to_state_space())
    assert disk_margin(*loop).margin > 0.9
    assert not by_indi.design_warnings


def test_law_knows_nothing_of_the_bar(vehicle: Vehicle, by_indi: FlightController) -> None:
    """Another linkage of the bar changes the vehicle, not the law; the law holds it all the same."""
    other = replace_parameters(vehicle, {"stabiliser_bar.linkage": 0.3})
    c = design_flight_controller(other, settings=DesignSettings(method="indi"))
    for name in "ABCD":
        assert getattr(c.roll_pitch.controller, name) == pytest.approx(
            getattr(by_indi.roll_pitch.controller, name), rel=1e-9, abs=1e-12
        )
    d = c.roll_pitch
    plant = sample_plant(by_indi.roll_pitch.plant, c.period_s, 1)
    loop = analyse_loop(
        plant, extract_feedback_controller(d.discrete.to_state_space(), by_indi.roll_pitch.plant, range(4))
    )
    assert loop.stable
    scaled = scale_plant(d.plant, d.scaling)
    assert design_indi(scaled, IndiGains(), c.period_s).effectiveness[0, 1] == pytest.approx(8.0, rel=0.3)
