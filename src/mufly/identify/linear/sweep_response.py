"""Frequency responses of sweeps from composite windows, and fit of transfer functions.

**Composite windows** (Tischler and Remple, *Aircraft and Rotorcraft System Identification*, 2nd ed., ch. 10). A long
window resolves low frequencies and gives few segments. A short window gives many segments and resolves high
frequencies only. The responses of several lengths are combined for each pair and frequency, with each input first
conditioned on the others:

    W_i = (eps_i / eps_min)^-4,      G = sum W_i^2 G_i / sum W_i^2      for G_xx.r, G_yy.r, G_xy.r
    H = G_xy.r / G_xx.r,             gamma^2 = |G_xy.r|^2 / (G_xx.r G_yy.r)

with the random error ``eps`` of each window (:func:`~mufly.identify.linear.frequency_response.response_random_error`).
The book refines these averages by a further least squares, which is not done here. A window is used from 1.5 periods
on. Windows share the same data and are not independent, so the error of the composite follows from the mean number of
segments, ``n = sum W_i n_i / sum W_i``. The bias of windows too short for a lightly damped mode is not included.

**Transfer functions** (ch. 11): ``H(s) = (b_m s^m + ... + b_0) / (s^n + ... + a_0) exp(-tau s)`` with the least

    J = 20 / n sum W_gamma [(dB)^2 + 0.01745 (deg)^2],      W_gamma = (1.58 (1 - exp(-gamma^2)))^2

over the frequencies with a coherence of 0.6 or more. The search starts from the best of iterated linear fits
(Sanathanan and Koerner 1963, IEEE Trans. Autom. Control 8) over several delays. Standard deviations propagate the
random error through the fit, with the correlation of neighbouring frequencies (a Hann window is 1.5 / T wide). They
are scaled up for a misfit larger than the random error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.errors import ArgumentError, InputError
from mufly.identify.flight_record import UniformLogTable
from mufly.identify.linear.frequency_response import (
    MIN_PARTIAL_COHERENCE,
    FrequencyResponse,
    average_cross_spectra,
    compute_conditioned_responses,
    response_random_error,
)
from mufly.results import ShownBlock, make_lines_block, make_table_block, result, to_plain_data

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_MIN_PERIODS_PER_WINDOW = 1.5  # least number of periods of a frequency in a window
_SQUARED_DEGREE_WEIGHT = 0.01745  # weight of a squared degree relative to a squared decibel
_HANN_BANDWIDTH_BINS = 1.5  # width of the window in 1 / T


def estimate_composite_response(
    inputs: Sequence[Array], outputs: Sequence[Array], dt: float, *, windows_s: Sequence[float], low_hz: float,
    high_hz: float, points: int = 80, input_names: tuple[str, ...] = (), output_names: tuple[str, ...] = (),
) -> FrequencyResponse:  # fmt: skip
    """Estimate conditioned frequency responses from several window lengths.

    Parameters
    ----------
    inputs, outputs : sequence of (n, k) and of (n, m) array
        Signals without gaps, one array per record: sweeps of all inputs, separately or together.
    dt : float
        Sample time (s).
    windows_s : sequence of float
        Lengths of the windows (s).
    low_hz, high_hz : float
        Band; the longest window must hold 1.5 periods of the lowest frequency.
    points : int
        Number of logarithmically spaced frequencies.

    Returns
    -------
    FrequencyResponse
        Composite response; ``averages`` is the value of the shortest window.

    Raises
    ------
    InputError
        If a window is longer than the records, or all windows are too short for the lowest frequency.
    """
    if not windows_s or max(windows_s) * low_hz < _MIN_PERIODS_PER_WINDOW * (1.0 - 1e-9):
        longest = max(windows_s, default=0.0)
        raise ArgumentError(
            "windows_s",
            "",
            f"the longest window, {longest:g} s, has less than {_MIN_PERIODS_PER_WINDOW:g} periods of {low_hz:.3g} Hz",
            f"give one of {_MIN_PERIODS_PER_WINDOW / low_hz:.3g} s, or a band from "
            f"{_MIN_PERIODS_PER_WINDOW / max(longest, 1e-9):.3g} Hz",
        )
    frequency = np.geomspace(low_hz, high_hz, points)
    k, m = inputs[0].shape[1], outputs[0].shape[1]
    shape = (points, m, k)
    xx, yy, weights = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    xy = np.zeros(shape, dtype=np.complex128)
    segments, lengths, plain = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    multiple, multiple_weight = np.zeros((points, m)), np.zeros((points, m))
    found, most = [], 0.0
    for window in windows_s:
        valid = window * frequency >= _MIN_PERIODS_PER_WINDOW * (1.0 - 1e-9)
        if valid.sum() < 2:
            continue
        spectra, averages = average_cross_spectra(inputs, outputs, dt, window, frequency[valid])
        response, own, left, coherence = compute_conditioned_responses(spectra, k)
        response = np.nan_to_num(response)
        output = np.abs(response) ** 2 * own[:, None, :] + left[:, :, None]
        partial = 1.0 - left[:, :, None] / np.maximum(output, 1e-300)
        error = np.maximum(response_random_error(partial, averages, k)[0], 1e-6)
        found.append((valid, window, averages, response, own, output, error, coherence))
        most = max(most, averages)
    least = np.full(shape, np.inf)
    for valid, _, _, _, _, _, error, _ in found:
        least[valid] = np.minimum(least[valid], error)
    for valid, window, averages, response, own, output, error, coherence in found:
        w = (error / least[valid]) ** -4
        weights[valid] += w**2
        xx[valid] += w**2 * own[:, None, :]
        yy[valid] += w**2 * output
        xy[valid] += w**2 * own[:, None, :] * response
        plain[valid] += w
        segments[valid] += w * averages
        lengths[valid] += w * window
        multiple[valid] += w.max(axis=2) * coherence
        multiple_weight[valid] += w.max(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        response = np.where(xx > 0.0, xy / xx, np.nan)
        partial = np.clip(np.nan_to_num(np.abs(xy) ** 2 / (xx * yy)), 0.0, 1.0)
    error, freedom = response_random_error(partial, segments / np.maximum(plain, 1e-300), k)
    return FrequencyResponse(
        frequency, response, multiple / np.maximum(multiple_weight, 1e-300), partial, error, freedom, most,
        input_names, output_names, lengths / np.maximum(plain, 1e-300),
    )  # fmt: skip


def estimate_response_of_records(
    records: Sequence[UniformLogTable], inputs: Mapping[str, str], outputs: Mapping[str, str], *,
    band_hz: tuple[float, float] | None = None, windows_s: Sequence[float] = (), points: int = 80,
) -> FrequencyResponse:  # fmt: skip
    """Estimate the conditioned frequency responses of several records.

    Parameters
    ----------
    records : sequence of UniformLogTable
        Sweeps with the same sample rate.
    inputs, outputs : dict
        Name -> expression (:meth:`UniformLogTable.stack_columns`).
    band_hz : (float, float), optional
        Band; default: from two periods in half the shortest record, to 10 Hz.
    windows_s : sequence of float
        Lengths of the windows (s); default: :func:`choose_window_lengths`.
    points : int
        Number of frequencies.

    Raises
    ------
    InputError
        If the records differ in rate, a column is missing, or a window does not suit.
    """
    dt = records[0].dt
    for r in records:
        if abs(r.dt / dt - 1.0) > 0.01:
            raise InputError(
                r.name, "time", f"has a rate of {1 / r.dt:.4g} Hz, but {records[0].name} has {1 / dt:.4g} Hz",
                "resample one of them",
            )  # fmt: skip
    us = [r.stack_columns(inputs, "inputs") for r in records]
    ys = [r.stack_columns(outputs, "outputs") for r in records]
    shortest = min(len(u) for u in us) * dt
    low, high = band_hz or (4.0 / shortest, min(10.0, 0.4 / dt))
    return estimate_composite_response(
        us, ys, dt, windows_s=windows_s or choose_window_lengths(shortest, low, high), low_hz=low, high_hz=high,
        points=points, input_names=tuple(inputs), output_names=tuple(outputs),
    )  # fmt: skip


def choose_window_lengths(record_s: float, low_hz: float, high_hz: float) -> tuple[float, ...]:
    """Return five window lengths (s) for a record, longest first, spaced geometrically down to a tenth of the longest.

    The longest window suits ``low_hz`` and is at most half the record, so that at least three segments are averaged.
    The shortest holds at least ten periods of ``high_hz``.
    """
    longest = min(0.5 * record_s, max(3.0 / low_hz, 20.0 / high_hz))
    shortest = max(0.1 * longest, min(longest, 10.0 / high_hz))
    return tuple(float(f"{w:.3g}") for w in np.geomspace(longest, shortest, 5))


@result(eq=False)
class TransferFunctionFit:
    """Transfer function fitted to a frequency response.

    Attributes
    ----------
    input, output : str
    numerator, denominator : array
        Coefficients, highest power of s first; the first coefficient of the denominator is 1.
    delay_s : float
    numerator_std, denominator_std : array
        Standard deviations.
    delay_std_s : float
    cost : float
        Cost J; below 100 good, below 50 nearly indistinguishable from the data.
    band_hz : (float, float)
        Band of the points used.
    count : int
        Number of the points used.
    """

    input: str
    output: str
    numerator: Array
    denominator: Array
    delay_s: float
    numerator_std: Array
    denominator_std: Array
    delay_std_s: float
    cost: float
    band_hz: tuple[float, float]
    count: int

    def response_at(self, frequency_hz: Array) -> ComplexArray:
        """Return the complex response at frequencies (f,)."""
        s = 2j * np.pi * np.asarray(frequency_hz)
        shape = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(shape * np.exp(-self.delay_s * s), dtype=np.complex128)

    @property
    def poles(self) -> ComplexArray:
        """Return the roots of the denominator (1/s)."""
        return np.asarray(np.roots(self.denominator), dtype=np.complex128)

    @property
    def zeros(self) -> ComplexArray:
        """Return the roots of the numerator (1/s)."""
        return np.asarray(np.roots(self.numerator), dtype=np.complex128)

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return coefficients, delay and poles as printed text."""
        both = (("b", self.numerator, self.numerator_std), ("a", self.denominator, self.denominator_std))
        rows = [
            (f"{letter}{power}", f"{value:.4g}", f"{std:.2g}")
            for letter, values, stds in both
            for power, value, std in zip(range(len(values) - 1, -1, -1), values, stds, strict=True)
            if std > 0.0
        ]
        rows.append(("delay (s)", f"{self.delay_s:.3g}", f"{self.delay_std_s:.2g}"))
        low, high = self.band_hz
        title = f"{self.input} to {self.output}, {low:.2g} to {high:.2g} Hz, J = {self.cost:.0f}"
        poles = ", ".join(map(format_pole, self.poles))
        return make_table_block(("", "value", "std"), rows, title=title), make_lines_block(f"Poles: {poles} rad/s")


@result(eq=False)
class ResponseFits:
    """Frequency responses with the transfer functions fitted to their pairs.

    Attributes
    ----------
    response : FrequencyResponse
    transfer_functions : tuple of TransferFunctionFit
    not_fitted : tuple of str
        Pairs with too few coherent points.
    reason : str
        Reason for the last pair that was not fitted.
    """

    response: FrequencyResponse
    transfer_functions: tuple[TransferFunctionFit, ...] = ()
    not_fitted: tuple[str, ...] = ()
    reason: str = ""

    def as_record(self) -> dict[str, Any]:
        """Return the responses, the transfer functions and the pairs that were not fitted."""
        fits = {"transfer_functions": self.transfer_functions, "not_fitted": self.not_fitted}
        return {**to_plain_data(self.response), **fits}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the responses and the fits as printed text."""
        missing = (f"{', '.join(self.not_fitted)}: {self.reason}",) if self.not_fitted else ()
        fits = [block for fit in self.transfer_functions for block in fit.make_printed_blocks()]
        return *self.response.make_printed_blocks(), *fits, make_lines_block(*missing, mark="Not fitted")


def format_pole(p: complex) -> str:
    """Return a pole (1/s) as text with two decimals."""
    return f"{p.real:.2f}" if abs(p.imag) < 1e-9 else f"{p.real:.2f}{p.imag:+.2f}j"


def fit_transfer_functions(data: FrequencyResponse, *, zeros: int, poles: int) -> ResponseFits:
    """Fit a transfer function with a delay to every pair with enough coherent points.

    Raises
    ------
    ArgumentError
        If the orders are invalid.
    """
    fits, missing, reason = [], [], ""
    for o, i in np.ndindex(len(data.outputs), len(data.inputs)):
        try:
            fits.append(fit_transfer_function(data, o, i, zeros=zeros, poles=poles))
        except ArgumentError:
            raise
        except InputError as error:
            missing.append(f"{data.inputs[i]} to {data.outputs[o]}")
            reason = str(error.problem)
    return ResponseFits(data, tuple(fits), tuple(missing), reason)


def fit_transfer_function(
    data: FrequencyResponse, output: int, input: int, *, zeros: int, poles: int
) -> TransferFunctionFit:
    """Fit a transfer function with a delay to the response of one input-output pair.

    Parameters
    ----------
    data : FrequencyResponse
    output, input : int
        Indices of the pair.
    zeros, poles : int
        Numbers of zeros and poles, with no more zeros than poles.

    Raises
    ------
    InputError
        If the orders are invalid, or too few points are coherent.
    """
    if not 0 <= zeros <= poles or poles < 1:
        raise ArgumentError("zeros", "", f"{zeros} zeros and {poles} poles", "give 1 pole or more, and no more zeros")
    h, gamma = data.response[:, output, input], data.partial[:, output, input]
    good = np.isfinite(h) & (gamma >= MIN_PARTIAL_COHERENCE) & (np.abs(np.nan_to_num(h)) > 0.0)
    name = f"{_signal_name(data.inputs, input)} to {_signal_name(data.outputs, output)}"
    if good.sum() < zeros + poles + 3:
        raise InputError(
            "transfer function", name,
            f"only {int(good.sum())} points have a coherence of {MIN_PARTIAL_COHERENCE:g} or more",
            "give more excitation, longer records or fewer poles and zeros",
        )  # fmt: skip
    f, h, gamma = data.frequency_hz[good], h[good], gamma[good]
    middle = 2.0 * np.pi * float(np.sqrt(f[0] * f[-1]))
    s = np.asarray(2j * np.pi * f / middle, dtype=np.complex128)
    weight = 1.58 * (1.0 - np.exp(-gamma))
    scale = np.sqrt(20.0 / len(f)) * weight

    def split_numerator_denominator_delay(x: Array) -> tuple[Array, Array, float]:
        return x[: zeros + 1], np.r_[1.0, x[zeros + 1 : zeros + 1 + poles]], float(x[-1])

    def weighted_residual(x: Array) -> Array:
        b, a, tau = split_numerator_denominator_delay(x)
        ratio = np.polyval(b, s) / np.polyval(a, s) * np.exp(-tau * s) / h
        level = 20.0 * np.log10(np.maximum(np.abs(ratio), 1e-12))
        return np.r_[scale * level, np.sqrt(_SQUARED_DEGREE_WEIGHT) * scale * np.degrees(np.angle(ratio))]

    trials = []
    for tau in np.r_[0.0, np.geomspace(0.02, 2.0, 9) / np.abs(s).max()]:
        x = np.r_[_fit_linearised_transfer_function(s, h * np.exp(tau * s), weight, zeros, poles), tau]
        trials.append((float((weighted_residual(x) ** 2).sum()), x.tolist()))
    best = None
    for _, start in sorted(trials)[:3]:
        x0 = np.array(start)
        low = np.full(len(x0), -np.inf)
        low[-1] = 0.0
        x0[-1] = max(x0[-1], 1e-6)
        solution = least_squares(weighted_residual, x0, bounds=(low, np.inf), x_scale="jac", max_nfev=300)
        if best is None or solution.cost < best.cost:
            best = solution
    assert best is not None
    b, a, tau = split_numerator_denominator_delay(best.x)
    # Random error propagated through the fit; frequencies within one window's bandwidth are fully correlated.
    eps = np.maximum(data.error[:, output, input][good], 1e-9)
    noise = np.r_[8.686 * scale * eps, np.sqrt(_SQUARED_DEGREE_WEIGHT) * np.degrees(1.0) * scale * eps]
    width = data.window_s[:, output, input][good] if data.window_s is not None else np.full(len(f), 1.0 / f[0])
    shared = np.maximum(1.0, _HANN_BANDWIDTH_BINS / (width * np.gradient(f)))
    jac = np.asarray(best.jac)
    inverse = np.linalg.pinv(jac.T @ jac, rcond=1e-14)
    weighted = jac * (noise * np.sqrt(np.r_[shared, shared]))[:, None]
    misfit = float(np.mean((best.fun / noise) ** 2))
    std = np.sqrt(np.diag(inverse @ (weighted.T @ weighted) @ inverse) * max(1.0, misfit))
    up, down = middle ** np.arange(poles - zeros, poles + 1.0), middle ** np.arange(0.0, poles + 1.0)
    return TransferFunctionFit(
        _signal_name(data.inputs, input),
        _signal_name(data.outputs, output),
        b * up,
        a * down,
        tau / middle,
        std[: zeros + 1] * up,
        np.r_[0.0, std[zeros + 1 : zeros + 1 + poles]] * down,
        std[-1] / middle,
        2.0 * float(best.cost),
        (float(f[0]), float(f[-1])),
        len(f),
    )


def _signal_name(names: tuple[str, ...], k: int) -> str:
    return names[k] if k < len(names) else str(k)


def _fit_linearised_transfer_function(s: ComplexArray, h: ComplexArray, weight: Array, zeros: int, poles: int) -> Array:
    """Fit numerator and denominator (without its leading 1) by linear least squares, reweighted iteratively."""
    a = np.r_[1.0, np.ones(poles)]
    x = np.zeros(zeros + 1 + poles)
    for _ in range(12):
        scale = weight / np.maximum(np.abs(np.polyval(a, s) * h), 1e-300)
        columns = [s**p for p in range(zeros, -1, -1)] + [-h * s**p for p in range(poles - 1, -1, -1)]
        left, right = np.stack(columns, axis=1) * scale[:, None], h * s**poles * scale
        x = np.linalg.lstsq(
            np.concatenate([left.real, left.imag]), np.concatenate([right.real, right.imag]), rcond=None
        )[0]
        a = np.r_[1.0, x[zeros + 1 :]]
    return x
