"""The gain of a motion to its inputs under feedback, where plain regression gives the wrong sign."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mufly.identify.flight.causal_gain import estimate_causal_gain

STEP_S, GAIN = 0.01, 1.5


def fly_yaw(seed, *, feedback, excitation=0.0, turned=1.0, dither=0.02):
    """Return yaw rate and yaw (measured), and the acceleration that the model predicts from the motors (rad/s2).

    ``turned`` -1: the record's motors are exchanged. The vehicle itself stays stable, as it flew.
    """
    rng, n, late = np.random.default_rng(seed), 1200, 3
    torque = lfilter([0.02], [1.0, -0.98], 60.0 * rng.standard_normal(n))  # gusts, correlated over 0.5 s
    motors, rate, yaw = np.zeros(n), np.zeros(n), np.zeros(n)
    wanted = excitation * np.sin(2 * np.pi * np.cumsum(np.linspace(0.2, 3.0, n)) * STEP_S)
    rate[0] = 0.8  # begun in motion
    for k in range(1, n):
        felt = rate[k - 1] + dither * rng.standard_normal()
        motors[k] = wanted[k] - feedback * (felt + 0.5 * yaw[k - 1])
        rate[k] = rate[k - 1] + STEP_S * (GAIN * motors[max(k - late, 0)] + torque[k])
        yaw[k] = yaw[k - 1] + STEP_S * rate[k]
    rate, yaw = rate + 0.01 * rng.standard_normal(n), yaw + 0.005 * rng.standard_normal(n)
    return rate, yaw, turned * motors[:, None]


@pytest.mark.parametrize("turned", [1.0, -1.0])
@pytest.mark.parametrize("feedback", [0.0, 1.0])
def test_an_excited_motion_tells_its_gain_in_open_and_closed_loop(feedback, turned):
    options = {"sample_s": STEP_S, "skip_s": 1.0, "longest_lag_s": 0.16}
    for seed in range(5):
        rate, yaw, made = fly_yaw(seed, feedback=feedback, excitation=3.0, turned=turned)
        by_rate = estimate_causal_gain(rate, made, is_rate=True, **options)
        assert by_rate.value[0] == pytest.approx(turned * GAIN, rel=0.25)
        assert by_rate.sign_log_likelihood_ratio > 10.0
        by_angle = estimate_causal_gain(yaw, made, is_rate=False, **options)
        assert by_angle.value[0] == pytest.approx(turned * GAIN, rel=0.4)


def test_the_gain_of_feedback_alone_is_right_or_undecided():
    """Gusts drive the motors through the loop; the gain has the right sign wherever the evidence suffices."""
    for seed in range(10):
        rate, _, made = fly_yaw(seed, feedback=(0.1, 0.4, 1.0, 4.0)[seed % 4], dither=0.0)
        found = estimate_causal_gain(rate, made, STEP_S, is_rate=True, skip_s=1.0, longest_lag_s=0.16)
        assert found.sign_log_likelihood_ratio < 10.0 or found.value[0] > 0.0


def test_a_disturbance_that_the_loop_rejects_in_part_does_not_turn_the_sign():
    """With ``m = -c w`` one sample late, ``a = g m + w`` regressed on ``m`` has the gain ``g - 1/c``."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        w = lfilter([1.0], [1.0, -0.98], rng.standard_normal(1500))
        made = np.zeros((1500, 1))
        made[4:, 0] = -0.3 * w[:-4] + 0.5 * rng.standard_normal(1496)
        change = GAIN * made[:, 0] + w
        rate = np.concatenate([[0.0], np.cumsum(0.5 * (change[1:] + change[:-1]))]) * STEP_S
        x, y = made[:, 0] - made.mean(), change - change.mean()
        assert x @ y / (x @ x) < -0.5
        found = estimate_causal_gain(rate, made, STEP_S, is_rate=True, skip_s=0.5, longest_lag_s=0.0)
        assert found.sign_log_likelihood_ratio < 10.0 or found.value[0] > 0.0


def test_a_short_record_or_one_without_values_has_no_gain():
    made = np.ones((100, 1))
    assert estimate_causal_gain(np.zeros(100), made, STEP_S, is_rate=True) is None
    assert estimate_causal_gain(np.full(100, np.nan), made, STEP_S, is_rate=True) is None
