"""The controllers on the nonlinear, saturated model: steps and references as in Figs 6.10 and 6.12."""

import numpy as np
import pytest

import mufly
from mufly.control import design_flight_controller
from mufly.flight import ControllerReference, simulate_controller_response
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def controller(vehicle):
    return design_flight_controller(vehicle)


@pytest.mark.parametrize("charge", [1.0, 0.8, 0.5, 0.2])
def test_heave_step_of_half_a_metre(vehicle, controller, charge: float) -> None:
    """Fig 6.10: no overshoot; settled to 2 % within 2.5 s, at most 1 % over, hardly any yaw."""
    ds = simulate_controller_response(
        vehicle,
        lambda t: ControllerReference(down_m=-0.5 if t >= 1.0 else 0.0),
        duration_s=8.0,
        controller=controller,
        charge=charge,
    )
    assert ds.time.values[[0, -1]] == pytest.approx([0.0, 8.0])
    y = ds.truth_position.values[:, 2] / -0.5
    outside = ds.time.values[np.abs(y - 1.0) > 0.02]
    assert outside[-1] - 1.0 <= 2.5
    assert y.max() <= 1.01
    assert np.abs(ds.truth_attitude.values[:, 2]).max() < 0.02
    assert np.all((ds.motor_input.values >= 0) & (ds.motor_input.values <= 1))


@pytest.mark.parametrize("size", [0.5, -0.5])
def test_yaw_step_does_not_disturb_the_height(vehicle, controller, size: float) -> None:
    ds = simulate_controller_response(
        vehicle,
        lambda t: ControllerReference(heading=size if t >= 0.5 else 0.0),
        duration_s=6.0,
        controller=controller,
    )
    yaw = ds.truth_attitude.values[:, 2]
    assert yaw[-1] == pytest.approx(size, abs=0.01)
    assert np.max(yaw / size) < 1.1
    assert np.abs(ds.truth_position.values[:, 2]).max() < 0.02
    assert ds.battery_charge.values[0] == pytest.approx(0.8, abs=1e-3)  # where nothing else is asked for


def steps_of_figure_6_12(t: float) -> float:
    """Steps between the values that Fig 6.12's reference takes (rad)."""
    for begin, value in ((7.0, 0.0), (5.5, -0.06), (4.0, -0.14), (2.5, -0.04), (1.0, -0.10)):
        if t >= begin:
            return value
    return 0.0


@pytest.mark.parametrize("axis", ["pitch", "roll"])
def test_tilt_follows_its_reference(vehicle, controller, axis: str) -> None:
    ds = simulate_controller_response(
        vehicle,
        lambda t: ControllerReference(**{axis: steps_of_figure_6_12(t)}),
        duration_s=8.5,
        controller=controller,
    )
    k = {"roll": 0, "pitch": 1}[axis]
    angle, wanted = ds.truth_attitude.values[:, k], ds.reference_attitude.values[:, k]
    time = ds.time.values
    since = time - np.array([max((b for b in (0, 1, 2.5, 4, 5.5, 7) if b <= t), default=0) for t in time])
    assert np.abs(angle - wanted)[since > 1.0].max() < 0.005
    assert np.abs(angle - wanted)[since > 0.3].max() < 0.02
    assert np.abs(ds.truth_attitude.values[:, 1 - k]).max() < 1e-3  # no cross-coupling
    assert np.abs(ds.servo_input.values).max() <= 1.0


def test_railed_motors_recover_without_windup(vehicle, controller) -> None:
    """A 3 m step at a weak battery asks for all there is; anti-windup keeps the overshoot small and yaw still."""
    ds = simulate_controller_response(
        vehicle,
        lambda t: ControllerReference(down_m=-3.0, heading=1.0),
        duration_s=15.0,
        controller=controller,
        charge=0.1,
    )
    y = ds.truth_position.values[:, 2] / -3.0
    assert y.max() < 1.05
    assert y[-1] == pytest.approx(1.0, abs=0.01)
    assert ds.truth_attitude.values[-1, 2] == pytest.approx(1.0, abs=0.01)


def test_bad_duration_is_refused(vehicle, controller) -> None:
    with pytest.raises(mufly.InputError, match="duration_s"):
        simulate_controller_response(vehicle, lambda t: ControllerReference(), duration_s=-1.0, controller=controller)
