"""Excitation signals: shapes, spectra, crest factors."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.errors import InputError
from mufly.identify import make_excitation
from mufly.identify.flight.excitation_signals import SIGNAL_KINDS, compute_amplitude_spectrum, crest_factor

BAND = (2 * math.pi * 0.2, 2 * math.pi * 2.0)


def make(kind, duration=11.0, sample=0.01, band=BAND):
    return make_excitation(kind, duration_s=duration, sample_s=sample, band_rad_s=band)


@pytest.mark.parametrize("kind", SIGNAL_KINDS)
def test_all_kinds_rest_at_both_ends_and_reach_one(kind):
    e = make(kind)
    assert e.time_s.size == 1101
    assert np.max(np.abs(e.value)) == pytest.approx(1)
    assert not e.value[:50].any()
    assert not e.value[-50:].any()
    assert abs(e.value[50]) < 0.25 or kind in ("3211", "doublet")


@pytest.mark.parametrize("kind", ["chirp", "multisine"])
def test_the_power_lies_in_the_band(kind):
    e = make(kind)
    frequency, amplitude = compute_amplitude_spectrum(e.value[50:-50], 0.01)
    power = amplitude**2
    inside = (frequency >= 0.15) & (frequency <= 2.3)
    assert power[inside].sum() > 0.9 * power.sum()


def test_a_multisine_is_flat_over_its_harmonics_and_flatter_in_time_than_schroeder():
    e = make("multisine")
    active = e.value[50:-50]
    frequency, amplitude = compute_amplitude_spectrum(active, 0.01)
    k = (frequency > 0.19) & (frequency < 2.01)
    assert_allclose(amplitude[k], amplitude[k].mean(), rtol=0.01)
    assert amplitude[~k].max() < 0.02 * amplitude[k].mean()
    n = int(k.sum())
    phases = -np.pi * np.arange(n) * np.arange(1, n + 1) / n
    t = np.arange(4000) / 4000
    schroeder = np.cos(2 * np.pi * np.outer(np.arange(2, 2 + n), t) + phases[:, None]).sum(axis=0)
    aligned = np.cos(2 * np.pi * np.outer(np.arange(2, 2 + n), t)).sum(axis=0)
    assert crest_factor(schroeder) < 2.2 < crest_factor(aligned)
    assert e.crest < 0.85 * crest_factor(schroeder)
    assert abs(active[0]) < 0.1


def test_crest_factors_in_closed_form():
    t = np.arange(1000) / 1000
    assert crest_factor(np.sin(2 * np.pi * 5 * t)) == pytest.approx(math.sqrt(2))
    assert crest_factor(np.sign(np.sin(2 * np.pi * 5 * (t + 1e-4)))) == pytest.approx(1)
    frequency, amplitude = compute_amplitude_spectrum(0.7 * np.sin(2 * np.pi * 5 * t), 1e-3)
    assert frequency[np.argmax(amplitude)] == 5
    assert amplitude.max() == pytest.approx(0.7)


def runs(value):
    edges = np.flatnonzero(np.diff(value)) + 1
    return [(float(part[0]), part.size) for part in np.split(value, edges)]


def test_a_doublet_and_a_3211():
    middle = math.sqrt(BAND[0] * BAND[1])
    width = round(2.3 / middle / 0.01)
    shape = runs(make("doublet").value)
    assert shape[1:4] == [(1.0, width), (-1.0, width), (0.0, 2 * width)]
    assert shape[4:6] == [(-1.0, width), (1.0, width)]
    width = round(1.6 / middle / 0.01)
    assert runs(make("3211").value)[1:5] == [(1.0, 3 * width), (-1.0, 2 * width), (1.0, width), (-1.0, width)]


def test_a_chirp_spends_as_long_in_every_octave():
    e = make("chirp", band=(2 * math.pi * 0.5, 2 * math.pi * 8.0), duration=21.0)
    active = e.value[50:-50]
    crossings = np.flatnonzero((active[:-1] <= 0) & (active[1:] > 0)) * 0.01
    rate = 1.0 / np.diff(crossings)
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    expected = 0.5 * 16 ** (middle / 20.0)
    assert_allclose(rate[2:-2], expected[2:-2], rtol=0.1)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("sawtooth",), "'sawtooth' is unknown"),
        (("chirp", 11.0, 0.01, (5.0, 2.0)), "band_rad_s"),
        (("chirp", 11.0, 0.01, (5.0, 400.0)), "below 50 Hz"),
        (("doublet", 2.0, 0.01, (0.5, 1.0)), "too short"),
        (("3211", 3.5), "one 3211 takes"),
    ],
)
def test_what_cannot_be_made(arguments, what):
    with pytest.raises(InputError, match=what):
        make(*arguments)
