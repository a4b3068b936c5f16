"""Outliers, frozen and saturated channels, degrees taken for radians, and delays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.logs import (
    LogWarning,
    compute_body_rates,
    compute_saturated_fractions,
    estimate_channel_delays,
    estimate_delay,
    examine_channel,
    examine_log,
    examine_time_stamps,
    find_frozen_runs,
    find_outliers,
    guess_angle_units,
    read_log,
    write_log,
)
from mufly.logs.channel_checks import fit_angle_rate_slope
from mufly.logs.delay_estimation import _interpolate_lag

TIME = 0.01 * np.arange(2000)
RNG = np.random.default_rng(5)
NOISE = RNG.standard_normal(2000)


@given(st.lists(st.integers(10, 1980), max_size=6, unique=True), st.sampled_from([-12.0, 12.0, 40.0]))
def test_single_outliers_in_noise_are_found_and_nothing_else(places, size):
    places = sorted(p for p in places if all(abs(p - q) > 40 or p == q for q in places))
    x = 3 * np.sin(TIME) + 0.1 * NOISE
    x[places] += 0.1 * size
    assert set(find_outliers(x)) <= set(places)
    x[places] += 0.1 * size
    assert find_outliers(x).tolist() == places


def test_noise_steps_and_fast_sines_hold_no_outliers():
    assert len(find_outliers(np.random.default_rng(0).standard_normal(200_000))) == 0
    assert len(find_outliers(np.sign(np.sin(3 * TIME)))) == 0
    assert len(find_outliers(np.sin(60 * TIME))) == 0
    assert len(find_outliers(np.where(TIME > 10, 5.0, 0.0) + 0.01 * NOISE)) == 0


def test_a_coarse_signal_may_step_by_what_it_steps_as_a_rule():
    """A fuel gauge of ten levels: a step now and then is what it does, one that is ten times as large is not."""
    x = np.round(5 - 0.4 * TIME + 0.5 * np.sin(3 * TIME))
    assert 0 < np.count_nonzero(np.diff(x)) < 100
    assert len(find_outliers(x)) == 0
    x[1200] += 1  # for one sample, as a value between two levels does
    assert len(find_outliers(x)) == 0
    x[700] += 10
    assert find_outliers(x).tolist() == [700]


def test_a_frozen_sensor_is_found_and_a_held_input_is_not():
    x = NOISE.copy()
    x[500:520] = x[500]
    assert find_frozen_runs(x).tolist() == [[500, 520]]
    assert len(find_frozen_runs(np.repeat(NOISE[:200], 10))) == 0
    assert len(find_frozen_runs(x[490:515])) == 0  # what stands still to the end of the record may be over


def test_where_a_coarse_angle_turns_it_is_not_frozen():
    time = np.arange(0, 60, 0.02)
    yaw = np.radians(np.round(20 * np.sin(0.3 * time), 2))  # hundredths of a degree, as ArduPilot logs them
    assert len(find_frozen_runs(yaw)) == 0
    yaw[500:530] = yaw[500]
    assert find_frozen_runs(yaw).tolist() == [[500, 530]]


def test_few_samples_hold_no_outlier_and_enough_do():
    x = 0.1 * NOISE[:61]
    x[30] = 9.0
    assert find_outliers(x).tolist() == [30]
    assert len(find_outliers(x[:60])) == 0


def test_a_limit_that_is_met_less_often_than_what_lies_beside_it_is_none():
    """Beside it is within 2 % of the range."""
    spread = np.linspace(-1.0, 0.9, 500)
    for beside, share in ((np.linspace(0.949, 0.958, 100), 60 / 660), (np.linspace(0.961, 0.99, 100), 0.0)):
        assert compute_saturated_fractions(np.concatenate((spread, beside, np.ones(60))))[1] == pytest.approx(share)


def test_a_second_and_a_fifth_of_angle_and_rate_can_be_compared():
    """Ten means over a tenth of a second, and one more for the last difference."""
    slope, correlation = fit_angle_rate_slope(TIME[:120], ANGLE[:120], RATE[:120])
    assert slope == pytest.approx(1.0, abs=0.05)
    assert correlation > 0.99
    assert np.isnan(fit_angle_rate_slope(TIME[:105], ANGLE[:105], RATE[:105])[0])


def test_saturation_is_measured_at_either_end():
    x = np.clip(2 * np.sin(TIME) + 0.01 * NOISE, -1.5, 1.0)
    low, high = compute_saturated_fractions(x)
    assert low == pytest.approx(np.mean(x == -1.5), abs=0.005)
    assert high == pytest.approx(np.mean(x == 1.0), abs=0.005)
    assert compute_saturated_fractions(np.sin(TIME) + 0.01 * NOISE) == (0, 0)


def test_the_words_of_a_channel():
    x = 0.1 * NOISE
    x[300] = 5.0
    x[700:800] = np.nan
    words = examine_channel(TIME, x, "p", "rad/s").describe_faults()
    assert words == ["p: 5 % of the values are missing", "p: 1 outlier, at 3.00 s"]
    clipped = examine_channel(TIME, np.clip(NOISE, -0.5, 9.0).repeat(6), "tilt", "rad").describe_faults()
    assert clipped == ["tilt: 29 % of the values sit at its minimum, -0.5 rad"]
    assert examine_channel(TIME, np.full(2000, 2.0), "u").constant
    assert examine_channel(TIME, np.full(2000, np.nan), "u").describe_faults() == ["u: no values"]


ANGLE = 0.3 * np.sin(2 * TIME) + 0.1 * np.sin(9 * TIME)
RATE = 0.6 * np.cos(2 * TIME) + 0.9 * np.cos(9 * TIME)


@pytest.mark.parametrize(
    ("angle", "rate", "wanted"),
    [
        (ANGLE, RATE, ("rad", "rad")),
        (np.degrees(ANGLE), RATE, ("deg", "rad")),
        (ANGLE, np.degrees(RATE), ("rad", "deg")),
        (np.degrees(ANGLE), np.degrees(RATE), ("deg", "deg")),
        (np.degrees(ANGLE), None, ("deg", "")),
        (0.05 * np.degrees(ANGLE), None, ("", "")),
        (None, np.degrees(RATE), ("", "deg")),
        (0.02 * np.degrees(ANGLE), 0.02 * RATE + 0.0005 * NOISE, ("deg", "rad")),
        (None, 34.9 / RATE.max() * RATE, ("", "")),  # 2000 deg/s, the end of most gyroscopes
        (None, 40.0 / RATE.max() * RATE, ("", "deg")),
        (0.6 * ANGLE, 0.6 * RATE, ("rad", "rad")),  # up to 0.24 rad: a quarter of a degree would be odd
        (0.45 * ANGLE, 0.45 * RATE, ("", "")),
    ],
)
def test_degrees_are_told_from_radians(angle, rate, wanted):
    guess = guess_angle_units(TIME, angle, rate)
    assert (guess.angle, guess.rate) == wanted
    assert guess.reason or wanted == ("", "")


def csv(tmp_path, head, *columns):
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([TIME, *columns]), delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def test_an_angle_without_unit_is_guessed_and_said(tmp_path):
    path = csv(tmp_path, "t_s,measured_attitude_roll,measured_rates_p", np.degrees(ANGLE), RATE)
    with pytest.warns(LogWarning) as said:
        data = read_log(path)
    words = [str(w.message) for w in said]
    assert any("measured_attitude names no unit and is taken to be in deg" in w for w in words)
    assert any("measured_rates names no unit and is taken to be in rad/s" in w for w in words)
    assert data.measured_attitude.sel(angle="roll").values == pytest.approx(ANGLE, abs=1e-6)
    assert data.attrs["notes"]


def test_degrees_labelled_radians_are_said_but_not_changed(tmp_path):
    path = csv(tmp_path, "t_s,measured_attitude_roll [rad],measured_rates_p [rad/s]", np.degrees(ANGLE), RATE)
    with pytest.warns(LogWarning, match="is said to be in rad but looks like deg"):
        data = read_log(path)
    assert data.measured_attitude.sel(angle="roll").values == pytest.approx(np.degrees(ANGLE), abs=1e-6)


def delayed_pair(tau_s, seed, band_hz=8.0, n=1500, rate=100.0):
    """Band-limited noise and the same later, exactly (a phase ramp over a record four times as long)."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft(rng.standard_normal(4 * n))
    f = np.fft.rfftfreq(4 * n, 1 / rate)
    spectrum[f > band_hz] = 0
    x = np.fft.irfft(spectrum)[:n]
    y = np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * tau_s))[:n]
    return np.arange(n) / rate, x / x.std(), y / y.std(), rng


@settings(max_examples=30)
@given(st.floats(-0.3, 0.3), st.integers(0, 1000), st.sampled_from([-3.0, 0.5]))
def test_a_known_delay_is_estimated_to_a_tenth_of_a_sample(tau_s, seed, gain):
    t, x, y, rng = delayed_pair(tau_s, seed)
    found = estimate_delay(t, x, gain * (y + 0.1 * rng.standard_normal(len(t))) + 2.0 + 0.3 * t)
    assert abs(found.delay_s - tau_s) < 0.1 * found.sampling_step_s
    assert np.sign(found.correlation) == np.sign(gain)
    assert not found.at_limit


@pytest.mark.parametrize("burst", [False, True])
def test_the_interval_of_a_delay_holds_it_as_often_as_it_says(burst):
    """Under coloured noise, and where it comes in bursts, as vibration does."""
    inside, delays, halves = 0, [], []
    for seed in range(80):
        t, x, y, rng = delayed_pair(0.0437, seed)
        noise = np.convolve(rng.standard_normal(len(t) + 9), np.ones(10) / np.sqrt(10), "valid")  # coloured
        noise *= np.where(t % 5 < 1, 2.2, 0.1) if burst else 1.0
        found = estimate_delay(t, x, y + 0.4 * noise)
        assert found.is_determined
        inside += found.low_s <= 0.0437 <= found.high_s
        delays.append(found.delay_s)
        halves.append((found.high_s - found.low_s) / 2)
    assert inside >= 0.88 * 80
    assert np.mean(halves) < 2 * 1.96 * np.std(delays)  # and is no wider for it


def test_a_delay_that_the_record_does_not_tell_is_not_determined():
    t, x, y, rng = delayed_pair(0.0437, 4)
    weak = estimate_delay(t, x, 0.3 * y + rng.standard_normal(len(t)))
    assert 0.2 < weak.correlation < 0.45
    assert not weak.is_determined
    assert "not determined (correlation 0." in weak.describe_delay()
    assert "ms" not in weak.describe_delay()
    clear = estimate_delay(t, x, y + 0.2 * rng.standard_normal(len(t)))
    assert clear.describe_delay().startswith("43.")
    wave = np.sin(2 * np.pi * t / 0.3)  # seen a period later it is the same
    swinging = estimate_delay(t, wave, np.roll(wave, 5) + 0.05 * rng.standard_normal(len(t)), causal=True)
    assert not swinging.is_determined
    turns = (swinging.second_peak_delay_s - swinging.delay_s) / 0.3
    assert turns == pytest.approx(round(turns), abs=0.07)
    assert abs(turns) > 0.5
    both = f"{1e3 * swinging.delay_s:.1f} ms and {1e3 * swinging.second_peak_delay_s:.0f} ms"
    assert f"not determined ({both} fit equally well)" == swinging.describe_delay()
    tones = sum(np.sin(2 * np.pi * f * t) for f in (4.7, 5.0, 5.3))  # nearly as high a period later, but never higher
    assert estimate_delay(t, tones, np.roll(tones, 3)).is_determined
    late = estimate_delay(t, x, np.roll(x, 52), longest_s=0.5)
    assert late.at_limit
    assert not late.is_determined
    short = estimate_delay(t[:30], x[:30], y[:30])
    assert short.degrees_of_freedom == 2  # three pieces are all that 30 samples give
    assert estimate_delay(t[:32], x[:32], y[:32]).degrees_of_freedom == 3


@pytest.mark.parametrize("cycles", [0.05, 0.2, 0.4])
def test_between_whole_lags_a_wave_is_itself(cycles):
    """In cycles a lag; the windowed sinc has 24 lags on either side."""
    lags = np.arange(-24, 25)
    for at in (-0.9, -0.5, 0.0, 0.37, 0.81):
        found = _interpolate_lag(lags, np.cos(2 * np.pi * cycles * lags + 0.3), at)
        assert found == pytest.approx(np.cos(2 * np.pi * cycles * at + 0.3), abs=1e-3)


def test_missing_values_do_not_spoil_a_delay():
    t, x, y, _ = delayed_pair(0.123, 3)
    y[400:430] = np.nan
    assert estimate_delay(t, x, y).delay_s == pytest.approx(0.123, abs=0.001)


def test_a_causal_delay_does_not_lead():
    t = TIME
    wave = np.sin(2 * np.pi * t)
    found = estimate_delay(t, wave, np.sin(2 * np.pi * (t - 0.6)) * (1 + 0.1 * np.sin(t)), causal=True)
    assert found.delay_s == pytest.approx(0.6, abs=0.01)


@pytest.mark.parametrize(
    ("t", "x", "y", "words"),
    [
        (TIME, np.ones(2000), NOISE, "constant"),
        (TIME[:20], NOISE[:20], NOISE[:20], "at least 30"),
        (np.sort(RNG.random(2000)), NOISE, NOISE, "evenly"),
        (np.r_[TIME[:1000], TIME[999:1999]], NOISE, NOISE, "evenly"),
        (np.r_[TIME[:1000], TIME[1001], TIME[1000], TIME[1002:]], NOISE, NOISE, "evenly"),
    ],
)
def test_delays_that_cannot_be_are_refused(t, x, y, words):
    with pytest.raises(InputError, match=words):
        estimate_delay(t, x, y)


def test_one_repeated_stamp_in_a_long_record_is_no_even_clock():
    """Among so many steps it is no jitter."""
    t = 0.01 * np.arange(60_000)
    assert examine_time_stamps(t).jitter_ratio < examine_time_stamps(np.r_[t[:1000], t[999:-1]]).jitter_ratio < 0.02
    with pytest.raises(InputError, match="evenly"):
        estimate_delay(np.r_[t[:1000], t[999:-1]], np.sin(t), np.sin(t - 0.1))


def test_body_rates_of_an_attitude_follow_the_rotation():
    """Against the rotation that the equations of motion use: R(t)^T R(t + dt) turns by omega dt."""
    from mufly.dynamics import body_to_ned_matrix, quaternion_from_euler

    t = 1e-3 * np.arange(400)
    attitude = np.column_stack([0.4 * np.sin(5 * t), 0.3 * np.cos(4 * t), 2 * t])
    rates = compute_body_rates(t, attitude)
    for k in (50, 200, 333):
        before, after = (body_to_ned_matrix(quaternion_from_euler(*attitude[j])) for j in (k - 1, k + 1))
        turn = before.T @ after
        omega = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2 * 2e-3)
        assert rates[k] == pytest.approx(omega, abs=1e-4)


def test_delays_of_a_record_are_those_put_in(make_signals, tmp_path):
    t, x, y, _ = delayed_pair(0.07, 11, band_hz=3.0)
    data = make_signals(n=1500, rate=100.0)
    zero = np.zeros(len(t))
    data["reference_attitude"] = (("time", "angle"), 0.1 * np.column_stack([x, zero, zero]), {"units": "rad"})
    data["measured_attitude"] = (("time", "angle"), 0.1 * np.column_stack([y, zero, zero]), {"units": "rad"})
    rates = compute_body_rates(t, data.measured_attitude.values)
    rates[2:] = rates[:-2].copy()  # the gyroscope reports two samples late
    data["measured_rates"] = (("time", "rate"), rates, {"units": "rad/s"})
    of_log = examine_log(write_log(data, tmp_path / "log.nc"))
    for delays in (estimate_channel_delays(data), of_log.delays):
        found = {d.response: d.delay.delay_s for d in delays}
        assert found["measured_attitude.roll"] == pytest.approx(0.07, abs=0.002)
        assert found["measured_rates.p"] == pytest.approx(0.02, abs=0.001)
    assert examine_log(tmp_path / "log.nc", delays=False).delays == []
