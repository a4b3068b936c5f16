"""Residual statistics against closed forms and against how often they are wrong on data where the answer is known."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from mufly.identify import ParameterEstimate, RecordPrediction, assess_prediction, describe_model_deficiencies
from mufly.identify.fit_result import (
    coloured_covariance,
    compute_relative_covariance,
    covariance_from_information,
    describe_undetermined_combinations,
    find_largest_correlated_lag,
    parzen_window,
    select_error_model,
)
from mufly.identify.residual_analysis import (
    compute_input_cross_correlation,
    compute_residual_autocorrelation,
    estimate_high_frequency_noise,
    find_spectral_lines,
    ljung_box_test,
    residual_determinant,
)
from mufly.vehicle import load_vehicle


def record(measured, predicted, inputs, dt=0.02, outputs=("q",), names=("lon",)):
    n = len(measured)
    return RecordPrediction(
        "made", "fit", dt * np.arange(n), outputs, ("rad/s",) * len(outputs), measured.reshape(n, -1),
        predicted.reshape(n, -1), np.full(len(outputs), 0.1), inputs.reshape(n, -1), names,
    )  # fmt: skip


def share_outside(c):
    return np.mean(np.abs(c.value) > c.confidence_bound)


def test_autocorrelation_of_a_first_order_process_is_its_power_series():
    rng = np.random.default_rng(1)
    e = lfilter([1.0], [1.0, -0.9], rng.normal(size=200_000))
    c = compute_residual_autocorrelation(e, 0.1, max_lag_s=2.0)
    assert c.lag_s == pytest.approx(0.1 * np.arange(21))
    assert c.value == pytest.approx(0.9 ** np.arange(21), abs=0.02)
    assert (
        0.03 < share_outside(compute_residual_autocorrelation(rng.normal(size=4000), 0.1, max_lag_s=100.0)) < 0.07
    )  # 95 %


def test_ljung_box_is_wrong_as_often_as_it_says_on_white_noise_and_finds_colour():
    rng = np.random.default_rng(2)
    p = np.array([ljung_box_test(rng.normal(size=400), lags=20).p_value for _ in range(1000)])
    assert 0.03 < np.mean(p < 0.05) < 0.08
    assert ljung_box_test(lfilter([1.0], [1.0, -0.3], rng.normal(size=400)), lags=20).p_value < 1e-3


@pytest.mark.parametrize(("colour", "samples", "records"), [(0.0, 2000, 150), (0.95, 2000, 150), (0.95, 200, 400)])
def test_cross_correlation_bounds_hold_for_independent_signals_of_any_colour(colour, samples, records):
    rng = np.random.default_rng(3)
    outside = []
    for _ in range(records):
        u, e = (lfilter([1.0], [1.0, -colour], rng.normal(size=samples)) for _ in range(2))
        outside.append(share_outside(compute_input_cross_correlation(u, e, 0.01, max_lag_s=0.5)))
    assert 0.03 < np.mean(outside) < 0.075


def test_cross_correlation_peaks_at_the_lag_by_which_the_residual_follows():
    rng = np.random.default_rng(4)
    u = rng.normal(size=3000)
    c = compute_input_cross_correlation(u, np.roll(u, 17), 0.01, max_lag_s=0.5)
    assert c.lag_s[c.value.argmax()] == pytest.approx(0.17)


def test_a_constant_input_correlates_with_nothing():
    c = compute_input_cross_correlation(np.ones(100), np.arange(100.0), 0.1, max_lag_s=1.0)
    assert not c.value.any()


def test_theil_parts_are_those_of_their_definition_and_sum_to_one():
    rng = np.random.default_rng(5)
    z = rng.normal(size=5000)
    z -= z.mean()
    offset, half, noisy = (
        assess_prediction(z, z + 0.5),
        assess_prediction(z, 0.5 * z),
        assess_prediction(z, z + rng.normal(size=5000)),
    )
    assert offset.bias == pytest.approx(1.0)
    assert half.variance == pytest.approx(1.0, abs=1e-3)
    assert half.theil == pytest.approx(1.0 / 3.0, abs=1e-6)  # 0.5 rms / 1.5 rms
    assert noisy.covariance > 0.8
    for q in (offset, half, noisy):
        assert q.bias + q.variance + q.covariance == pytest.approx(1.0)


def test_fit_is_100_for_the_measurement_itself_and_0_for_its_mean():
    z = np.sin(np.arange(200.0))
    assert assess_prediction(z, z).fit_percent == 100.0
    assert assess_prediction(z, np.full(200, z.mean())).fit_percent == pytest.approx(0.0, abs=1e-9)
    assert assess_prediction(z, z + 0.3, 0.1).rms_over_noise == pytest.approx(3.0)


def test_gaps_are_left_out():
    z, y = np.arange(50.0), np.arange(50.0) + 1.0
    z[10:20] = np.nan
    assert assess_prediction(z, y).rms == pytest.approx(1.0)
    assert np.isfinite(compute_residual_autocorrelation(z, 1.0, max_lag_s=5).value).all()
    assert np.isnan(assess_prediction(np.full(5, np.nan), np.zeros(5)).fit_percent)


def test_determinant_of_fit_is_the_product_of_independent_variances():
    rng = np.random.default_rng(6)
    e = rng.normal(size=(20_000, 2)) * [0.5, 2.0]
    r = record(e, np.zeros_like(e), e[:, :1], outputs=("p", "q"))
    assert residual_determinant([r]) == pytest.approx(0.25 * 4.0, rel=0.05)


def test_high_frequency_noise_of_white_noise_is_its_share_of_the_band():
    e = np.random.default_rng(7).normal(size=50_000)
    assert estimate_high_frequency_noise(e, 0.01, above_hz=10.0) == pytest.approx(np.sqrt(0.8), rel=0.03)


# --- in words ---------------------------------------------------------------------------------------------------------


def simulate(u, pole, dt=0.02):
    a = np.exp(-pole * dt)
    return lfilter([0.0, 1.0 - a], [1.0, -a], u)


def steps(n, seed):
    return np.repeat(np.random.default_rng(seed).normal(size=n // 25), 25)


def test_a_missing_lag_is_said_with_its_input_and_a_complete_model_is_silent():
    rng = np.random.default_rng(8)
    u = steps(6000, 9)
    noise = 0.05 * rng.normal(size=6000)
    measured = simulate(u, 2.0) + noise
    assert not [w for w in describe_model_deficiencies(record(measured, simulate(u, 2.0), u)) if "correlates" in w]
    words = describe_model_deficiencies(record(measured, u * 0.8, u))
    assert any("residual of q correlates with lon" in w for w in words)


def test_what_comes_late_and_what_comes_slowly_have_different_causes():
    noise = 0.02 * np.random.default_rng(16).normal(size=6000)
    u, held = np.random.default_rng(17).normal(size=6000), steps(6000, 0)
    late = np.roll(u, 10) + noise
    words = describe_model_deficiencies(record(late, 0.0 * late, u))
    assert any("lon at 0.2 s lag" in w and "the delay or the damping between" in w for w in words)
    slow = simulate(held, 0.5) + noise
    words = describe_model_deficiencies(record(slow, 0.0 * slow, held))
    assert any("lon at 0.4" in w and "a lag or a slow mode between lon and q" in w for w in words)


def test_independent_signals_are_called_correlated_once_in_a_hundred_records():
    said = 0
    for seed in range(100):
        u, e = np.random.default_rng(100 + seed).normal(size=(2, 300))
        said += any("correl" in w for w in describe_model_deficiencies(record(e, 0.0 * e, u)))
    assert said <= 3


def test_a_slow_disturbance_is_told_with_its_share_and_its_time_and_a_short_one_is_none():
    white, shaped = np.random.default_rng(18).normal(size=(2, 20_000))
    slow, short = (lfilter([1.0], [1.0, -a], shaped) for a in (0.98, 0.8))
    words = describe_model_deficiencies(record(white + slow / slow.std(), 0.0 * white, steps(20_000, 1)))
    (said,) = (w for w in words if "varies slower" in w)
    share, time = re.match(r"(\d+) % .* correlated over (\S+) s: a disturbance", said).groups()
    assert float(share) == pytest.approx(50.0, abs=5.0)
    assert float(time) == pytest.approx(0.99, abs=0.2)  # -0.02 s / ln 0.98
    for e in (white, short):
        assert not any("varies slower" in w for w in describe_model_deficiencies(record(e, 0.0 * e, steps(20_000, 1))))


def test_feedback_is_told_from_a_fault_of_the_model():
    rng = np.random.default_rng(10)
    disturbance = lfilter([1.0], [1.0, -0.95], rng.normal(size=6000)) * 0.1
    u = -np.roll(disturbance, 25) + 0.01 * rng.normal(size=6000)  # the pilot answers half a second later
    words = describe_model_deficiencies(record(disturbance, np.zeros(6000), u), max_lag_s=1.0)
    assert any("feedback from q to lon" in w for w in words)
    assert not any("is off" in w or "slow mode" in w for w in words)


def test_vibration_is_named_with_its_frequency():
    rng = np.random.default_rng(11)
    t = 0.02 * np.arange(6000)
    e = 0.3 * np.sin(2 * np.pi * 17.3 * t) + 0.1 * rng.normal(size=6000)
    (frequency, power), *_ = find_spectral_lines(e, 0.02)
    assert frequency == pytest.approx(17.3, abs=0.1)
    assert power == pytest.approx(0.045, rel=0.15)
    assert any(
        "17.3 Hz" in w and "vibration" in w for w in describe_model_deficiencies(record(e, 0 * e, steps(6000, 1)))
    )
    slow = lfilter([1.0], [1.0, -0.98], rng.normal(size=6000))
    slow /= slow.std()
    for share, said in ((0.043, False), (0.057, True)):  # a word from a twentieth of the power on
        e = np.sqrt(1.0 - share) * slow + np.sqrt(2.0 * share) * np.sin(2 * np.pi * 17.3 * t)
        assert any("17.3 Hz" in w for w in describe_model_deficiencies(record(e, 0 * e, steps(6000, 1)))) is said


def test_wrong_gain_bias_and_an_input_that_never_moved_are_named():
    u = steps(4000, 12)
    y = simulate(u, 3.0)
    noise = 0.02 * np.random.default_rng(13).normal(size=4000)
    assert any("too small" in w for w in describe_model_deficiencies(record(y + noise, 0.5 * y, u)))
    offset = describe_model_deficiencies(record(y + noise + 0.5, y, u))
    assert any("constant offset" in w and w.startswith("100 % of") for w in offset)
    assert any("never moved" in w for w in describe_model_deficiencies(record(y + noise, y, np.ones(4000))))


# --- covariance -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_coloured_covariance_is_the_scatter_of_least_squares(colour):
    rng = np.random.default_rng(14)
    n = 1500
    x = np.column_stack([lfilter([1.0], [1.0, -0.95], rng.normal(size=n)), np.sin(0.01 * np.arange(n))])
    found, claimed, plain = [], [], []
    for _ in range(600):
        e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.normal(size=n))
        theta = np.linalg.lstsq(x, e, rcond=None)[0]
        left = e - x @ theta
        cov, bound, _ = coloured_covariance([x[:, None, :] / left.std()], [left[:, None] / left.std()])
        found.append(theta)
        claimed.append(np.diag(cov))
        plain.append(np.diag(bound))
    scatter = np.var(found, axis=0)
    assert np.mean(claimed, axis=0) == pytest.approx(scatter, rel=0.3)
    if colour:
        assert (np.mean(plain, axis=0) < 0.3 * scatter).all()


def test_a_white_output_beside_a_coloured_one_counts_as_a_record_of_its_own():
    rng = np.random.default_rng(19)
    s, white = rng.normal(size=(1500, 2, 2)), rng.normal(size=1500)
    e = np.column_stack([lfilter([1.0], [1.0, -0.9], rng.normal(size=1500)), white])
    together, *_ = coloured_covariance([s], [e])
    apart, *_ = coloured_covariance([s[:, :1], s[:, 1:]], [e[:, :1], e[:, 1:]])
    assert together == pytest.approx(apart, rel=1e-9)


def test_parzen_window_has_no_negative_transform():
    assert np.fft.fft(np.fft.ifftshift(parzen_window(40))).real.min() > -1e-12


def test_what_cannot_be_told_apart_is_said():
    cov = np.array([[1.0, 0.999, 0.0], [0.999, 1.0, 0.0], [0.0, 0.0, 100.0]])
    words = describe_undetermined_combinations(
        ("a", "b", "c"), compute_relative_covariance(cov, np.array([5.0, 5.0, 1.0]))
    )
    assert any("a and b can hardly be separated" in w for w in words)
    assert any("c is hardly seen" in w for w in words)


@pytest.mark.parametrize(("second", "shape"), [(7.0, "1 % of the reading"), (5.0, "0.5 % of full scale")])
def test_the_first_shape_of_errors_holds_unless_another_is_clearly_likelier(second, shape):
    minus_log = {(1.0, 0.0): 10.0, (0.0, 0.5): second}

    def tried(reading, full):
        return np.array([reading, full]), minus_log[reading, full]

    std, words = select_error_model(list(minus_log), tried)
    assert words == shape
    assert tuple(std) == ((1.0, 0.0) if second > 6.0 else (0.0, 0.5))


def test_an_offset_is_no_colour():
    white = np.random.default_rng(15).standard_normal(2000)
    assert find_largest_correlated_lag(white + 100.0, 300) == find_largest_correlated_lag(white, 300) == 0
    assert find_largest_correlated_lag(np.zeros(50), 20) == 0


def test_colour_that_swings_reaches_beyond_where_it_passes_zero():
    """A period of 24 samples that dies within some 50: its autocorrelation passes zero after 6."""
    poles = 0.95 * np.exp([2j * np.pi / 24, -2j * np.pi / 24])
    e = lfilter([1.0], np.poly(poles).real, np.random.default_rng(20).standard_normal(4000))
    assert 30 < find_largest_correlated_lag(e, 300) < 150


def test_directions_that_nothing_shows_are_told_with_the_shares_by_which_parameters_move():
    assert covariance_from_information(np.diag([4.0, 0.0, 16.0])) == pytest.approx(np.diag([0.25, np.inf, 0.0625]))
    along = np.array([1.0, 0.5, -0.5])
    (words,) = describe_undetermined_combinations(("a", "b"), 4.0 * np.outer(along, along)[:2, :2] + 1e-6 * np.eye(2))
    assert (
        "a +10 % with b +5 % has no effect on the measured outputs" in words
    )  # neither their ratio nor their product is seen
    (words,) = describe_undetermined_combinations(("a", "b", "c"), 4.0 * np.outer(along, along) + 1e-6 * np.eye(3))
    assert all(part in words for part in ("a +10 %", "b +5 %", "c -5 %"))


def test_an_interval_lies_around_its_estimate():
    e = ParameterEstimate.from_std("a", "", "m", None, 5.0, 0.25, quantile=2.0)
    assert (e.low, e.high) == (4.5, 5.5)
    assert np.isnan(e.start)
    vehicle = load_vehicle("mufly-1.1")
    assert ParameterEstimate.from_std("m", "body.mass", "kg", vehicle, 1.0, 0.1, quantile=2.0).start == 0.095
