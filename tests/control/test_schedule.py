"""Roll-pitch scheduled over forward speed: what its form rests on, the law, the conversion, and frozen speeds."""

from __future__ import annotations

from dataclasses import replace

import control
import numpy as np
import pytest

from mufly.control import DesignSettings, FlightController, design_flight_controller
from mufly.control.analysis.comparison import compute_forward_speed_metrics, linearise_roll_pitch_by_speed
from mufly.control.analysis.plots import draw_schedule_margins
from mufly.control.implementation import DiscreteController
from mufly.control.law import roll_pitch_init, roll_pitch_step
from mufly.control.linear_systems import state_space
from mufly.control.synthesis.synthesis_methods import SynthesisedController, SynthesisMethod, SynthesisProblem
from mufly.control.tuning import output_schedule
from mufly.control.tuning.fixed_order import NormGoal, make_goal_plants, tune_controller
from mufly.control.tuning.output_schedule import OutputSchedule, invert_tustin, pack_schedule
from mufly.dynamics import find_trim, linearise_vehicle
from mufly.errors import MuflyError
from mufly.flight.controllers import copy_record
from mufly.vehicle import Vehicle, replace_parameters


@pytest.fixture(scope="module")
def mapped(vehicle: Vehicle) -> Vehicle:
    return replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-hinged"})


@pytest.fixture(scope="module")
def ltr(mapped: Vehicle) -> FlightController:
    return design_flight_controller(mapped, settings=DesignSettings(method="ltr"))


def _schedule(c: FlightController, speed_m_s: float = 2.0) -> OutputSchedule:
    K = c.roll_pitch.discrete
    return OutputSchedule(speed_m_s, 0.2 * K.C[::-1], -0.3 * K.D[::-1], True, (), 0.9, 1.0, 30.0)


def test_backwards_flight_is_forwards_flight_for_roll_and_pitch(mapped: Vehicle) -> None:
    """Half a turn about the vertical turns both axes round, so the plant from servos to tilt stays; sideways not."""
    ahead, back, right = (
        linearise_vehicle(mapped, find_trim(mapped, velocity=v)).roll_pitch
        for v in ((2.0, 0.0, 0.0), (-2.0, 0.0, 0.0), (0.0, 2.0, 0.0))
    )
    assert np.abs(back.A - ahead.A).max() < 1e-4
    assert np.abs(back.B - ahead.B).max() < 1e-4
    assert np.abs(right.A - ahead.A).max() > 0.1


def test_the_law_adds_outputs_by_the_square_of_speed(ltr: FlightController) -> None:
    schedule, K = _schedule(ltr), ltr.roll_pitch.discrete
    gains = copy_record(ltr.roll_pitch_gains)
    for name, value in pack_schedule(schedule).items():
        gains[name] = value
    rng = np.random.default_rng(0)
    start = rng.normal(0.0, 0.02, 4)
    state = roll_pitch_init(gains, start)
    n = K.order
    for speed, share in ((0.0, 0.0), (1.0, 0.25), (-1.0, 0.25), (2.0, 1.0), (7.0, 1.0), (np.nan, 0.0)):
        y = rng.normal(0.0, 0.02, 4)
        servo, moved = roll_pitch_step(gains, state, np.zeros(2), np.append(y, speed))
        right = (K.C + share * schedule.C_forward_change) @ state[:n] - (K.D + share * schedule.D_forward_change) @ y
        assert servo == pytest.approx(right + ltr.roll_pitch_gains["trim"], abs=1e-12)
        plain, plain_moved = roll_pitch_step(ltr.roll_pitch_gains, state, np.zeros(2), y)
        assert (servo.tobytes() == plain.tobytes()) == (share == 0.0)
        assert moved == pytest.approx(plain_moved, abs=1e-12)  # the states do not know the speed
        state = moved


def test_tustins_rule_goes_back_with_the_same_states(ltr: FlightController) -> None:
    K = ltr.roll_pitch.discrete
    A, B, C, D = invert_tustin(K)
    T, one = K.period_s, np.eye(K.order)
    left = np.linalg.inv(one - A * T / 2)
    assert left @ (one + A * T / 2) == pytest.approx(K.A, abs=1e-12)
    assert T * left @ B == pytest.approx(K.B, rel=1e-9)
    assert C @ left == pytest.approx(K.C, rel=1e-9)
    assert D + C @ left @ B * T / 2 == pytest.approx(K.D, rel=1e-9)


def test_tuning_of_outputs_leaves_the_states_alone() -> None:
    def system(*matrices: float) -> control.StateSpace:
        return state_space(*(np.array([[v]]) for v in matrices), inputs=["e"], outputs=["u"])

    plant, start = system(-1.0, 1.0, 2.0, 0.0), system(-0.5, 0.7, 2.0, 1.0)
    goals = [NormGoal("sensitivity", make_goal_plants(plant, np.ones(1), 1)["sensitivity"], 1.0)]
    tuned = tune_controller(goals, [start], max_steps=5, outputs_only=True)
    assert (tuned.controller.A, tuned.controller.B) == (start.A, start.B)
    assert tuned.objective < tuned.start_objective
    free = tune_controller(goals, [start], max_steps=5)
    assert free.controller.A != start.A


def _halved(method: SynthesisMethod, problem: SynthesisProblem, _: object) -> SynthesisedController:
    """Return the given controller with outputs of 0.8 times the size in place of tuned ones."""
    K = problem.given_controller
    assert K is not None
    smaller = control.StateSpace(K.A, K.B, 0.8 * K.C, 0.8 * K.D)
    return SynthesisedController(smaller, np.zeros((K.nstates, 2)), np.nan, np.nan, 1.0)


def _loop(c: FlightController, K: DiscreteController) -> output_schedule.ScheduledLoop:
    s = c.settings
    return output_schedule.ScheduledLoop(K, c.roll_pitch.scaling, lambda scaled: scaled, 1.2, s.roll_pitch_goals)


def test_frozen_speeds_are_those_of_the_blended_controller(
    mapped: Vehicle, ltr: FlightController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output_schedule, "load_or_compute_controller", _halved)
    monkeypatch.setattr(output_schedule, "SPEED_GRID_INTERVAL_COUNT", 2)
    K = ltr.roll_pitch.discrete
    found = output_schedule.tune_output_schedule(
        mapped, _loop(ltr, K), speed_m_s=2.0, voltage=ltr.voltage_V, tilt_limit=0.15
    )
    assert pytest.approx(-0.2 * K.C, rel=1e-6) == found.C_forward_change
    assert pytest.approx(-0.2 * K.D, rel=1e-6) == found.D_forward_change
    assert [(f.speed_m_s, f.share, f.sideways) for f in found.frozen] == [
        (0.0, 0.0, False), (1.0, 0.25, False), (2.0, 1.0, False), (1.0, 0.0, True), (2.0, 0.0, True),
    ]  # fmt: skip
    assert found.frozen[0].disk_margin == pytest.approx(found.frozen[0].hover_disk_margin)
    assert found.frozen[0].sensitivity_peak_dB == pytest.approx(ltr.roll_pitch.sampled_loop.sensitivity_peak_dB)
    assert found.frozen[2].disk_margin != pytest.approx(found.frozen[2].hover_disk_margin, abs=1e-3)
    assert all(f.least_disk_margin <= min(f.disk_margin, f.hover_disk_margin) for f in found.frozen)
    assert found.max_saturated_pole_modulus < 1.0
    flown = replace(ltr, schedule=found)
    plants = linearise_roll_pitch_by_speed(mapped, (1.0, 2.0, 50.0), ltr.voltage_V)
    assert list(plants) == [1.0, 2.0]  # there is no steady flight at 50 m/s
    for f, frozen in zip(compute_forward_speed_metrics(flown, plants), found.frozen[1:3], strict=True):
        assert f.disk_margin == pytest.approx(frozen.disk_margin, rel=1e-9)
        assert f.sensitivity_peak_dB == pytest.approx(frozen.sensitivity_peak_dB, rel=1e-9)
    unscheduled = compute_forward_speed_metrics(ltr, plants)[1]
    assert unscheduled.disk_margin == pytest.approx(found.frozen[2].hover_disk_margin, rel=1e-9)
    axes = draw_schedule_margins(found).axes
    assert axes[0].lines[0].get_xydata()[-1] == pytest.approx([2.0, found.frozen[2].disk_margin])
    assert "2.00 sideways" in str(flown)
    assert found.max_share_rate_1_s == pytest.approx(2 * 9.81 * np.tan(0.15) / 2.0, rel=1e-3)


def test_a_speed_without_steady_flight_is_lowered(
    vehicle: Vehicle, ltr: FlightController, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clamped blades bring the servos to their limit below 1 m/s."""
    clamped = replace_parameters(vehicle, {"rotors.flight_map": "mufly-1.1-clamped"})
    monkeypatch.setattr(output_schedule, "load_or_compute_controller", _halved)
    monkeypatch.setattr(output_schedule, "SPEED_GRID_INTERVAL_COUNT", 2)
    loop = _loop(ltr, ltr.roll_pitch.discrete)
    found = output_schedule.tune_output_schedule(clamped, loop, speed_m_s=1.0, voltage=ltr.voltage_V, tilt_limit=0.15)
    assert 0.0 < found.speed_m_s < 1.0
    assert found.forward_share_per_speed2_s2_m2 == pytest.approx(found.speed_m_s**-2)
    K = ltr.roll_pitch.discrete
    wrong = replace(K, C=-K.C, D=-K.D, M=-K.M)
    with pytest.raises(MuflyError, match="unstable at 0 m/s"):
        output_schedule.tune_output_schedule(
            clamped, replace(loop, hover_controller=wrong), speed_m_s=0.5, voltage=ltr.voltage_V, tilt_limit=0.15
        )
