"""Dryden turbulence: variance, spectrum, seeds, blocks."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats
from scipy.optimize import brentq
from scipy.signal import welch

from mufly.dynamics import (
    DrydenWind,
    describe_excess_wind,
    find_model_airspeed_limits,
    find_step_limiting_parameter,
    model_parameters,
)
from mufly.dynamics.simulation import dryden_filter
from mufly.errors import InputError
from mufly.vehicle import replace_parameters


@pytest.mark.parametrize("step_s", [1e-4, 1e-3, 0.02, 0.5, 10.0])
@pytest.mark.parametrize("time_constant_s", [0.2, 2.0, 40.0])
def test_the_filter_is_stationary_with_unit_variance(step_s, time_constant_s) -> None:
    transition, noise, output, start = dryden_filter(time_constant_s, step_s)
    covariance = start @ start.T
    assert_allclose(
        transition @ covariance @ transition.T + noise @ noise.T, covariance, atol=1e-12 * np.max(covariance)
    )
    assert output @ covariance @ output == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("lag_steps", [1, 3, 10])
def test_autocorrelation_of_the_lateral_gust(lag_steps) -> None:
    # Inverse transform of the lateral spectrum: R(t) = (1 - t / 2T) exp(-t / T).
    T, step = 2.0, 0.3
    transition, _, output, start = dryden_filter(T, step)
    found = output @ np.linalg.matrix_power(transition, lag_steps) @ (start @ start.T) @ output
    t = lag_steps * step
    assert found == pytest.approx((1 - t / (2 * T)) * math.exp(-t / T), rel=1e-10)


@pytest.mark.parametrize("step_s", [0.05, 1.0])
def test_variance_of_samples_at_any_step(step_s) -> None:
    sigma, n = 0.3, 60_000
    wind = DrydenWind((0.5, 0, 0), sigma, step_s=step_s, length_m=0.25, seed=5).draw_wind_samples(n) - [0.5, 0, 0]
    # The mean square of a process with correlation rho has variance 2 sum(rho^2) / n, at most 2 T / step here.
    independent = n / max(1.0, 2 * 0.5 / step_s)
    spread = 5 * math.sqrt(2 / independent)
    assert_allclose(np.mean(wind**2, axis=0), sigma**2, rtol=spread)


def test_spectrum_is_drydens() -> None:
    # One-sided spectra over frequency f (Hz), omega = 2 pi f, T = L / V:
    #   along    4 sigma^2 T / (1 + (omega T)^2)
    #   across   2 sigma^2 T (1 + 3 (omega T)^2) / (1 + (omega T)^2)^2
    sigma, step, T = 0.4, 0.02, 0.5
    gusts = DrydenWind((2.0, 0, 0), sigma, step_s=step, length_m=1.0, seed=11).draw_wind_samples(120_000) - [
        2.0,
        0,
        0,
    ]
    f, found = welch(gusts, fs=1 / step, nperseg=2048, axis=0, detrend=False, window="hann")
    w = (2 * math.pi * f * T) ** 2
    along, across = 4 * sigma**2 * T / (1 + w), 2 * sigma**2 * T * (1 + 3 * w) / (1 + w) ** 2
    # Bands of frequencies, below the aliases of sampling; a band's mean ratio follows chi-square / degrees.
    segments = 2 * 120_000 / 2048 - 1
    for low, high in ((0.05, 0.3), (0.3, 1.0), (1.0, 3.0), (3.0, 6.0)):
        band = (f >= low) & (f < high)
        degrees = 2 * segments * (36 / 19) / 2 * band.sum() / 1.5
        least, most = stats.chi2.ppf([1e-5, 1 - 1e-5], degrees) / degrees
        aliasing = 1.06 if high > 3 else 1.02
        for axis, expected in enumerate((along, across, across)):
            ratio = np.mean(found[band, axis] / expected[band])
            assert least < ratio < most * aliasing, (low, axis)


def test_the_seed_repeats_a_wind_and_another_does_not() -> None:
    first, again, other = (DrydenWind((0.5, 0, 0), 0.3, step_s=0.01, seed=s).draw_wind_samples(50) for s in (4, 4, 5))
    assert_array_equal(first, again)
    assert np.max(np.abs(first - other)) > 0.05


def test_blocks_join() -> None:
    whole = DrydenWind((0.5, 0.2, 0), 0.3, step_s=0.01, seed=1).draw_wind_samples(100)
    wind = DrydenWind((0.5, 0.2, 0), 0.3, step_s=0.01, seed=1)
    assert_array_equal(np.vstack([wind.draw_wind_samples(n) for n in (1, 30, 69)]), whole)


def test_without_gusts_it_is_steady() -> None:
    wind = DrydenWind((0.5, -0.2, 0.1), step_s=0.01).draw_wind_samples(20)
    assert_array_equal(wind, np.tile([0.5, -0.2, 0.1], (20, 1)))


def test_turbulence_is_laid_out_along_the_mean_wind() -> None:
    # The same seed in a wind from elsewhere gives the same gusts, turned.
    north = DrydenWind((1.0, 0, 0), 0.3, step_s=0.01, seed=2).draw_wind_samples(40)
    east = DrydenWind((0, 1.0, 0), 0.3, step_s=0.01, seed=2).draw_wind_samples(40)
    assert_allclose(east, np.column_stack([-north[:, 1], north[:, 0], north[:, 2]]), atol=1e-12)


@pytest.mark.parametrize(
    "bad",
    [
        {"gust": -0.1},
        {"gust": float("nan")},
        {"step_s": 0.0},
        {"length_m": 0.0},
        {"seed": -1},
        {"steady": (1, 2)},
        {"steady": (1, float("inf"), 0)},
    ],
)
def test_impossible_winds_are_named(bad) -> None:
    with pytest.raises(InputError, match="wind"):
        DrydenWind(**{"gust": 0.1, "step_s": 0.01, **bad})


def test_the_air_in_which_the_model_holds(vehicle) -> None:
    """Ten per cent of the hover's inflow, by momentum theory solved anew; gusts count twice their rms."""
    p = model_parameters(vehicle)
    induced, along, across = find_model_airspeed_limits(vehicle)
    disc = np.pi * float(vehicle.rotors.radius) ** 2
    thrust = p["mass"] * 9.81 + float(vehicle.body.downwash_drag)
    assert 2 * 1.2 * disc * induced**2 == pytest.approx(thrust)
    # T = 2 rho A |U| v, U the velocity through the disc: along it climb + v, or with the flow across.
    for flow, expected in (((along, 0.0), 1.1), ((0.0, across), 0.9)):
        v = brentq(lambda v, f=flow: 2 * 1.2 * disc * np.hypot(f[0] + v, f[1]) * v - thrust, 0.1, 20)
        assert (flow[0] + v) / induced == pytest.approx(expected)
    assert describe_excess_wind(vehicle, (0.5, 0, 0), 0.3) == ""
    assert describe_excess_wind(vehicle, (0.98 * across, 0, 0.98 * along), 0.0) == ""
    assert describe_excess_wind(vehicle, (0, -1.02 * across, 0), 0.0)
    assert describe_excess_wind(vehicle, (0, 0, 1.02 * along), 0.0)
    assert "rises" not in describe_excess_wind(vehicle, (0, 0, 12), 0.0)
    assert "7.0 m/s across and 4.0 m/s along" in describe_excess_wind(vehicle, (3, 0, 0), 2.0)
    assert "air that rises at 3.0 m/s rotors are in vortex ring state" in describe_excess_wind(vehicle, (0, 0, -3), 0.0)
    assert "air that rises at 12.0 m/s rotors are in windmill state" in describe_excess_wind(vehicle, (0, 0, -12), 0.0)
    # A map of climb and descent holds further along the mast, not across it.
    mapped = replace_parameters(vehicle, {"rotors.coefficient_map": "walkera-5g6-bemt"})
    assert find_model_airspeed_limits(mapped) == (induced, pytest.approx(0.5 * induced), across)


@pytest.mark.parametrize(
    ("key", "value"),
    [("swash_plate.time_constant", 2e-5), ("rotors.upper.drive_inertia", 1e-9), ("contact.stiffness", 1e7),
     ("contact.damping", 100.0), ("rotors.lower.drive_inertia", 1e-9)],
)  # fmt: skip
def test_the_part_that_asks_for_short_steps_is_named(vehicle, key: str, value: float) -> None:
    assert find_step_limiting_parameter(model_parameters(replace_parameters(vehicle, {key: value}))) == key
