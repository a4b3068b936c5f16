"""Checks of sensors against healthy readings: statistics of what chance alone shows, and faults beside it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mufly.estimate.filter import filter_inputs
from mufly.estimate.filter.filter_records import (
    AID_COUNT,
    AID_POSITION,
    ERROR_GYRO_BIAS,
    ERROR_STATE_COUNT,
    INPUT_ACCEL_WEIGHT,
    INPUT_NOISE_DENSITY,
    INPUT_ROW_SIZE,
    NOMINAL_ATTITUDE,
    NOMINAL_POSITION,
    PHASE_FLYING,
    PHASE_MOTORS_RUNNING,
    PHASE_STANDING,
    READING_MAGNETIC_FIELD,
    READING_POSITION_FIX,
    ROTOR_ANG_ACCEL,
    ROTOR_FORCE_HISTORY,
    SENSOR_COUNT,
    STATE_COUNT,
    make_filter_settings,
)
from mufly.estimate.filter.measurements import fix_fusion, fusion, sensor_checks
from mufly.estimate.filter.measurements.sensor_checks import STATUS_FAULTY, STATUS_REJECTED
from mufly.vehicle import load_vehicle
from mufly.world import World


@pytest.fixture(scope="module")
def settings() -> Any:
    s = make_filter_settings(load_vehicle("mufly-1.1"), World(), 200.0)
    return SimpleNamespace(**{name: s[name] for name in s.dtype.names})


@pytest.fixture(autouse=True)
def faults(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sensors of which a fault is set; compiled functions are replaced by their Python."""
    found: list[int] = []
    for module in (fusion, sensor_checks):
        monkeypatch.setattr(module, "set_fault", lambda m, s, k, code, why, number: found.append(k))
        monkeypatch.setattr(module, "inflate_variance", lambda *of: None)
    for module, name in (
        (fusion, "height_above_ground"),
        (fusion, "rotation_matrix"),
        (fix_fusion, "adapt_noise_scale"),
        (fix_fusion, "_is_only_height_rejected"),
    ):
        monkeypatch.setattr(module, name, getattr(module, name).py_func)
    return found


def test_white_ratios_of_unit_variance_change_no_estimated_noise() -> None:
    rng = np.random.default_rng(8)
    ratios, changes = rng.standard_normal((40_000, 2)), []
    for now, before in ratios:
        m = SimpleNamespace(
            noise_scale=np.ones(AID_COUNT), bias_walk_scale=np.ones(AID_COUNT), fix_ratio=np.array([now]),
            fix_ratio_prev=np.array([before]), fix_ratio_mean=np.zeros(1), is_heading_aligned=1,
        )  # fmt: skip
        fix_fusion._estimate_fix_noise.py_func(m, 0)
        changes.append((m.noise_scale[AID_POSITION], m.bias_walk_scale[AID_POSITION]))
    assert np.mean(changes, axis=0) == pytest.approx((1.0, 1.0), abs=0.03 * fix_fusion.NOISE_GAIN_POSITION)


def sonar_memory(height_m: float) -> SimpleNamespace:
    x = np.zeros(STATE_COUNT)
    x[NOMINAL_POSITION + 2] = -height_m
    return SimpleNamespace(x=x, sonar_range_prev=0.0, sonar_repeat_chance=1.0, fix_sonar_height_difference=0.0)


def test_equal_readings_of_a_moving_vehicle_are_stuck_unless_it_may_stand(settings: Any) -> None:
    flying, standing = sonar_memory(1.0), sonar_memory(0.4)
    standing.fix_sonar_height_difference = 0.3  # the fix says that it stands
    moves = 0.02 * np.sin(np.arange(100))
    assert any(fusion._sonar_stuck.py_func(flying, settings, 1.0, nu) for nu in moves)
    assert not any(fusion._sonar_stuck.py_func(standing, settings, 0.36, nu) for nu in moves)


def spiking_memory() -> SimpleNamespace:
    three = {
        name: np.zeros(3)
        for name in (
            "axis_work", "gyro_rates", "gyro_rates_prev", "model_rate_step_bias", "rates_with_spikes",
            "spike_residual_carry", "gyro_offset_jump",
        )
    }  # fmt: skip
    return SimpleNamespace(
        **three, tick=1, rotor_model_rows=np.zeros((ROTOR_FORCE_HISTORY, ROTOR_ANG_ACCEL + 3)), rate_residual_lp=0.01,
        divergence_recovery_ticks_left=0, equal_spike_count=0, spike_count=0, flight_phase=PHASE_FLYING,
        u_transposed=None, ud_diagonal=None, u_transposed_h=None, reject_score=np.zeros(SENSOR_COUNT),
    )  # fmt: skip


def run_gyros(m: SimpleNamespace, settings: Any, readings: np.ndarray) -> list[float]:
    """Rates that the filter uses."""
    used = []
    for reading in readings:
        m.gyro_rates_prev[:] = m.gyro_rates
        m.gyro_rates[:] = reading - m.gyro_offset_jump
        sensor_checks.replace_gyro_spikes.py_func(m, settings, True)
        used.append(float(np.abs(m.gyro_rates).max()))
    return used


def test_two_agreeing_outliers_of_gyroscopes_are_no_jump_and_a_jump_is_removed(settings: Any) -> None:
    twice = np.zeros((40, 3))
    twice[[10, 11]] = 0.5, -0.3, 0.2
    m = spiking_memory()
    assert max(run_gyros(m, settings, twice)) < 0.05
    assert np.all(m.gyro_offset_jump == 0.0)
    lasting = np.zeros((40, 3))
    lasting[10:] = 0.2
    m = spiking_memory()
    assert max(run_gyros(m, settings, lasting)) < 0.05
    assert m.gyro_offset_jump == pytest.approx(np.full(3, 0.2), abs=0.02)


@pytest.mark.parametrize(
    ("factor", "current_A", "told"),
    [(1.0, 2.7, False), (1.2, 2.7, False), (0.5, 2.7, True), (1.6, 2.7, True), (1.45, 2.7, True), (1.45, 4.0, False)],
)
def test_a_field_of_another_strength_than_the_earth_s_is_no_heading(
    settings: Any, faults: list[int], monkeypatch: pytest.MonkeyPatch, factor: float, current_A: float, told: bool
) -> None:
    """Errors of the file make 4 uT of 48 in hover: five deviations are 20 uT, in a lift-off 23 uT."""
    fused: list[float] = []
    monkeypatch.setattr(fusion, "_fuse_drifting_aid", lambda m, s, k, bias, nu, *rest: fused.append(nu))
    for name in ("h_row_begin", "h_row_add"):
        monkeypatch.setattr(fusion, name, lambda *of: None)
    x = np.zeros(STATE_COUNT)
    x[NOMINAL_ATTITUDE] = 1.0
    m = SimpleNamespace(x=x, noise_scale=np.ones(AID_COUNT), yaw_rate=0.0, supply_current=current_A)
    fusion.fuse_magnetic_heading.py_func(m, settings, factor * settings.earth_field, 0.0, np.zeros(9))
    assert (faults == [READING_MAGNETIC_FIELD], bool(fused)) == (told, not told)


@pytest.mark.parametrize(("component", "status"), [(0, STATUS_REJECTED), (2, STATUS_FAULTY), (3, STATUS_REJECTED)])
def test_a_fix_off_in_height_alone_does_not_contradict_the_attitude(component: int, status: int) -> None:
    ratios = np.zeros(4)
    ratios[component] = 9.0
    m = SimpleNamespace(status=np.full(SENSOR_COUNT, STATUS_REJECTED), worst_fix_component=component, fix_ratio=ratios)
    fix_fusion._mark_fix_height_faulty.py_func(m)
    assert m.status[READING_POSITION_FIX] == status
    ratios[0], m.status[READING_POSITION_FIX] = 6.0, STATUS_REJECTED  # a jump on several axes
    fix_fusion._mark_fix_height_faulty.py_func(m)
    assert m.status[READING_POSITION_FIX] == STATUS_REJECTED


@pytest.mark.parametrize(
    ("phase", "axis", "learnt"),
    [(PHASE_STANDING, 2, True), (PHASE_MOTORS_RUNNING, 0, True), (PHASE_MOTORS_RUNNING, 2, False)],
)
def test_a_turn_on_the_legs_under_running_rotors_is_no_gyroscope_bias(
    settings: Any, monkeypatch: pytest.MonkeyPatch, phase: int, axis: int, learnt: bool
) -> None:
    """Torque turns the vehicle about the mast; the legs hold roll and pitch."""
    rows: list[int] = []
    monkeypatch.setattr(fusion, "h_row_begin", lambda m, i, h: rows.append(i))
    monkeypatch.setattr(fusion, "h_row_add", lambda *of: None)
    monkeypatch.setattr(fusion, "fuse_error_state", lambda *of: None)
    monkeypatch.setattr(fusion, "innovation_ratio", lambda *of: 1.0)
    monkeypatch.setattr(fusion, "fuse_scalar", lambda *of: None)
    x = np.zeros(STATE_COUNT)
    x[NOMINAL_ATTITUDE] = 1.0
    m = SimpleNamespace(
        x=x, gyro_mean=np.full(3, 0.01), gyro_mean_prev=np.zeros(3), accel_mean=np.array([0.0, 0.0, -9.81])
    )
    fusion.fuse_zero_motion.py_func(m, settings, np.empty(9), 8, phase, axis)
    assert (ERROR_GYRO_BIAS + axis in rows) == learnt


def test_rates_that_change_on_the_legs_are_motion_and_lasting_ones_a_bias(
    settings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wind rocks a light vehicle on its legs by 0.3 rad/s, 34 deviations of the bias of its gyroscopes."""
    fused: list[tuple[float, float]] = []
    monkeypatch.setattr(fusion, "h_row_begin", lambda *of: None)
    monkeypatch.setattr(fusion, "h_row_add", lambda *of: None)
    monkeypatch.setattr(fusion, "fuse_error_state", lambda *of: None)
    monkeypatch.setattr(fusion, "innovation_ratio", lambda *of: 99.0)
    monkeypatch.setattr(fusion, "fuse_scalar", lambda m, nu, r: fused.append((nu, r)))
    x = np.zeros(STATE_COUNT)
    x[NOMINAL_ATTITUDE] = 1.0
    m = SimpleNamespace(x=x, gyro_mean=np.zeros(3), gyro_mean_prev=np.zeros(3), accel_mean=np.array([0.0, 0.0, -9.81]))
    for rate in (-0.28, 0.085, 0.02, 0.02):
        m.gyro_mean[1] = rate
        fusion.fuse_zero_motion.py_func(m, settings, np.empty(9), 8, PHASE_STANDING, 1)
    innovations, variances = np.array(fused).T
    assert innovations == pytest.approx([-0.28, 0.085, 0.02, 0.02])
    assert np.all(np.sqrt(variances[:3]) >= np.abs([0.28, 0.365, 0.065]) - 1e-12)
    assert variances[3] == pytest.approx(2.0 * settings.rest_gyro_sigma**2 / 8)


@pytest.mark.parametrize("rate_rad_s", [376.0, 444.0])
def test_the_velocity_of_vibration_has_the_variance_of_its_integral(
    settings: Any, monkeypatch: pytest.MonkeyPatch, rate_rad_s: float
) -> None:
    """The filter sums a sin(w t) and adds the last sample over the lag of the unit; a constant error leaks away."""
    monkeypatch.setattr(filter_inputs, "_backdate_accel_noise", lambda *of: None)
    row = np.zeros(INPUT_ROW_SIZE)
    row[INPUT_ACCEL_WEIGHT : INPUT_ACCEL_WEIGHT + 3], row[INPUT_NOISE_DENSITY : INPUT_NOISE_DENSITY + 3] = 0.5, 1e-3
    three = {
        name: np.zeros(3)
        for name in (
            "accel_low_frequency_noise_density", "slow_residual_sum", "slow_residual_mean_prev",
            "vibration_velocity", "vibration_velocity_variance", "axis_work", "clipped_fraction",
        )
    }  # fmt: skip
    m = SimpleNamespace(
        **three, inputs_now=row, x=np.zeros(STATE_COUNT), sigma_output=np.zeros(ERROR_STATE_COUNT),
        slow_residual_count=0, slow_residual_mean_count=0, flight_phase=PHASE_MOTORS_RUNNING, tick=0,
        last_grounded_tick=0, status=np.ones(SENSOR_COUNT, dtype=int), fault_until_tick=np.zeros(SENSOR_COUNT),
    )  # fmt: skip
    found = []
    for m.tick in range(4000):
        z = np.array([9.0, 0.3, 0.0]) * (np.sin(rate_rad_s * settings.dt * m.tick), 1.0, 0.0)
        filter_inputs.estimate_accel_noise.py_func(m, settings, z)
        found.append(m.vibration_velocity_variance.copy())
    x, y, z = np.mean(found[3000:], axis=0)
    half = 0.5 * rate_rad_s * settings.dt  # the sum of samples: dt / (2 sin(w dt / 2)), half a sample later
    size = np.hypot(0.5 * settings.dt + settings.imu_lag, 0.5 * settings.dt / np.tan(half))
    assert x == pytest.approx(0.5 * (9.0 * size) ** 2, rel=0.15)
    assert y < 1e-3 * x
    assert z == 0.0
