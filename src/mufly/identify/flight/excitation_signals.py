"""Excitation signals for identification: chirp, multisine, 3-2-1-1 and doublet.

All signals are scaled to a largest absolute value of 1, begin and end with rest, and start from zero.

* Chirp: ``sin(2 pi int f dt)``. The frequency rises exponentially over the band, so that every octave gets the same
  time. The signal is faded in and out over a tenth of its length.
* Multisine: ``sum_k cos(2 pi k t / T + phi_k)`` over the harmonics in the band, with equal amplitudes. The phases start
  at Schroeder's ``phi_k = -pi k (k - 1) / N`` (IEEE Trans. Inf. Theory 16, 1970) and at random values. An optimiser
  minimises the p-norm of the signal over one period for p = 4, 8, 16 (Guillaume, Schoukens, Pintelon and Kollar, IEEE
  Trans. Instrum. Meas. 40, 1991). A time shift lets the signal start at an upward zero crossing (Morelli). The crest
  factor is the largest absolute value over the root mean square; a single sine has sqrt(2).
* Doublet and 3-2-1-1: steps, with ``dt = 2.3 / w`` and ``dt = 1.6 / w`` for the middle w of the band (Jategaonkar,
  Flight Vehicle System Identification, 2nd ed., ch. 2). They are repeated with inverted sign, after pauses of 2 dt,
  until the time is filled.
"""

from __future__ import annotations

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from mufly.errors import ArgumentError
from mufly.results import result

Array = NDArray[np.floating[Any]]
SignalKind = Literal["chirp", "multisine", "3211", "doublet"]
SIGNAL_KINDS: tuple[SignalKind, ...] = get_args(SignalKind)

_SIGNAL_END_REST_S = 0.5
_CHIRP_FADE_FRACTION = 0.1  # fraction of the chirp's duration for each fade
_PHASE_OPTIMISATION_STARTS = 6  # Schroeder's phases and random phases; the first is often not the best


@result(eq=False)
class ExcitationSignal:
    """Sampled excitation signal.

    Attributes
    ----------
    kind : str
    time_s, value : (n,) array
        Uniform time (s) and value, constant between samples; largest absolute value 1.
    crest : float
        Crest factor of the part between the rests.
    description : str
        Description of the construction with its numbers.
    """

    kind: SignalKind
    time_s: NDArray[np.float64]
    value: Array
    crest: float
    description: str


def crest_factor(value: Array) -> float:
    """Return the crest factor: the largest absolute value over the root mean square."""
    return float(np.max(np.abs(value)) / np.sqrt(np.mean(value**2)))


def compute_amplitude_spectrum(value: Array, sample_s: float) -> tuple[Array, Array]:
    """Return frequencies (Hz) and amplitudes of a signal, scaled so that a sine of amplitude 1 has amplitude 1."""
    n = value.size
    return np.fft.rfftfreq(n, sample_s), 2.0 / n * np.abs(np.fft.rfft(value))


def make_excitation(
    kind: SignalKind, *, duration_s: float, sample_s: float, band_rad_s: tuple[float, float]
) -> ExcitationSignal:
    """Create an excitation signal.

    Parameters
    ----------
    kind : {"chirp", "multisine", "3211", "doublet"}
    duration_s, sample_s : float
        Whole duration, including rests of 0.5 s at both ends, and sample time (s).
    band_rad_s : (float, float)
        Lowest and highest frequency (rad/s).

    Raises
    ------
    InputError
        If the kind is unknown, the band is invalid or the duration is too short.
    """
    if kind not in SIGNAL_KINDS:
        raise ArgumentError("kind", "", f"{kind!r} is unknown", f"use one of: {', '.join(SIGNAL_KINDS)}")
    low, high = band_rad_s
    if not 0 < low < high < math.pi / sample_s:
        remedy = f"give two rising frequencies below {0.5 / sample_s:.3g} Hz"
        raise ArgumentError(
            "band_rad_s",
            "",
            f"{low / 2 / math.pi:.3g} to {high / 2 / math.pi:.3g} Hz is out of range",
            remedy,
        )
    n = round(duration_s / sample_s) + 1
    rest = round(_SIGNAL_END_REST_S / sample_s)
    active = n - 2 * rest
    if active * sample_s < 2 * math.pi / math.sqrt(low * high) or active < 20:
        raise ArgumentError("duration_s", "", f"{duration_s:g} s is too short for this band", "give a longer duration")
    t = np.arange(active) * sample_s
    if kind == "chirp":
        value, words = _make_chirp(t, low, high)
    elif kind == "multisine":
        value, words = _make_multisine(t, sample_s, low, high)
    else:
        value, words = _make_step_sequence(t, sample_s, low, high, kind)
    value = value / np.max(np.abs(value))
    whole = np.zeros(n)
    whole[rest : rest + active] = value
    return ExcitationSignal(kind, np.arange(n, dtype=np.float64) * sample_s, whole, crest_factor(value), words)


def _make_chirp(t: Array, low: float, high: float) -> tuple[Array, str]:
    length = t[-1]
    rate = math.log(high / low)
    phase = low * length / rate * np.expm1(rate * t / length)
    fade = np.clip(np.minimum(t, length - t) / (_CHIRP_FADE_FRACTION * length), 0.0, 1.0)
    return np.sin(phase) * fade, f"{low / 2 / math.pi:.2g} to {high / 2 / math.pi:.2g} Hz, exponential"


def _make_multisine(t: Array, sample_s: float, low: float, high: float) -> tuple[Array, str]:
    period = t.size * sample_s
    # A harmonic at the edge of the band is included.
    first = max(1, math.ceil(low * period / (2 * math.pi) - 0.05))
    last = math.floor(high * period / (2 * math.pi) + 0.05)
    if last < first + 1:
        raise ArgumentError(
            "duration_s",
            "",
            f"a period of {period:.3g} s has fewer than two harmonics in this band",
            "give a longer duration",
        )
    k = np.arange(first, last + 1)
    start = -np.pi * np.arange(k.size) * np.arange(1, k.size + 1) / k.size
    # 16 samples per cycle of the highest harmonic resolve the peaks of the signal.
    fine = np.arange(16 * last) / (16 * last)
    arguments = 2 * np.pi * np.outer(k, fine)

    def sum_cosines(phases: Array) -> Array:
        return np.cos(arguments + phases[:, None]).sum(axis=0)

    rng = np.random.default_rng(0)
    phases = start
    for attempt in range(_PHASE_OPTIMISATION_STARTS):
        found = start if attempt == 0 else rng.uniform(-np.pi, np.pi, k.size)
        for p in (4, 8, 16):
            found = minimize(
                _log_p_norm, found, args=(arguments, p), jac=True, method="L-BFGS-B", options={"maxiter": 120}
            ).x
        phases = min(phases, found, key=lambda x: crest_factor(sum_cosines(x)))
    x = sum_cosines(phases)
    rising = np.flatnonzero((x <= 0) & (np.roll(x, -1) > 0))
    at = fine[rising[np.argmin(np.abs(x[rising]))]] if rising.size else 0.0
    value = np.cos(2 * np.pi * np.outer(k, t / period + at) + phases[:, None]).sum(axis=0)
    words = (
        f"{k.size} harmonics from {first / period:.2g} to {last / period:.2g} Hz, crest factor {crest_factor(x):.2f} "
        f"(Schroeder's phases: {crest_factor(sum_cosines(start)):.2f})"
    )
    return value, words


def _log_p_norm(phases: Array, arguments: Array, p: int) -> tuple[float, Array]:
    """Return the logarithm of the p-norm of a multisine over a period, and its gradient with respect to the phases."""
    waves = arguments + phases[:, None]
    x = np.cos(waves).sum(axis=0)
    scale = float(np.max(np.abs(x)))
    y = x / scale
    total = float(np.mean(y**p))
    gradient = -(np.sin(waves) * y ** (p - 1)).mean(axis=1) / (scale * total)
    return math.log(scale) + math.log(total) / p, gradient


def _make_step_sequence(t: Array, sample_s: float, low: float, high: float, kind: SignalKind) -> tuple[Array, str]:
    middle = math.sqrt(low * high)
    factor, pattern = (2.3, (1, -1)) if kind == "doublet" else (1.6, (1, 1, 1, -1, -1, 1, -1))
    width = max(2, round(factor / middle / sample_s))
    unit = np.repeat(np.array(pattern, dtype=np.float64), width)
    gap = np.zeros(2 * width)
    value, at, sign, count = np.zeros(t.size), 0, 1.0, 0
    while at + unit.size <= t.size:
        value[at : at + unit.size] = sign * unit
        at, sign, count = at + unit.size + gap.size, -sign, count + 1
    if count == 0:
        raise ArgumentError(
            "duration_s", "", f"one {kind} takes {unit.size * sample_s:.3g} s", "give a longer duration"
        )
    times = "once" if count == 1 else f"{count} times, every second one inverted"
    return value, f"steps of {width * sample_s:.2g} s, {times}"
