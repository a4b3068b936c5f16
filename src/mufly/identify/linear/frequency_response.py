"""Frequency responses and coherence: estimation from records, comparison with a model, and fit of a model.

**Estimation and comparison with a model.**

A record is divided into overlapping segments with a Hann window. Each segment is transformed at the wanted
frequencies, which need not be multiples of 1 / segment (Tischler and Remple, *Aircraft and Rotorcraft System
Identification*, 2nd ed., ch. 7), and the products are averaged:

    S_uu = <U* U^T>,   S_uy = <U* y>,   H = S_uu^-1 S_uy                      response to all inputs at once
    gamma^2   = S_uy^H S_uu^-1 S_uy / S_yy                                    multiple coherence
    gamma_j^2 = |S_jy.r|^2 / (S_jj.r S_yy.r)                                  partial coherence of input j

where ``.r`` means conditioned: the part explained by all other inputs is removed (Bendat and Piersol, *Random Data*,
ch. 7). At each frequency this is a regression of the output's transforms on those of ``k`` inputs over ``n`` segments.
The random error of the magnitude, and of the phase in radians, therefore has the residual's degrees of freedom (Bendat
and Piersol, Sec. 9.2.4 with their F instead of a normal distribution; own derivation of the effect of overlap)

    eps = sqrt((1 - gamma_j^2) / gamma_j^2) / sqrt(2 (n - k)),      nu = 2 (n - k),      95 %: t(0.975, nu) eps

with ``n`` the number of half-overlapping segments, each equivalent to 18/19 independent segments. Transforms of white
noise in neighbouring Hann windows have a correlation of 1/6. The variance of a mean of N such products is therefore
(1 + 2 (1/6)^2) / N of the variance of one. For many segments this is Tischler and Remple's eq. 7.46,
``C sqrt(1 - gamma^2) / (gamma sqrt(2 n_d))`` with C^2 = 0.55 and ``n_d`` the record over the segment. The error is
relative to the estimated magnitude; the phase interval is ``arcsin(t eps)``. The misfit of a model is Tischler and
Remple's

    J = 20 / n sum W_gamma [(20 log10 |H_m / H|)^2 + 0.01745 (phase_m - phase)^2 / deg^2],
    W_gamma = (1.58 (1 - exp(-gamma_j^2)))^2

where J < 100 is a good fit and J < 50 a hardly noticeable difference.

**Fit of a structured linear model to frequency responses: a cross-check of the fit to time histories.**

The parameters minimise Tischler and Remple's cost (:func:`compute_response_fit_cost`) summed over the input-output
pairs, each weighted by its partial coherence. Trims, biases, initial states and incoherent signals have no influence.
Feedback from an output to an input causes a bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import get_window
from scipy.special import stdtrit

from mufly.errors import InputError
from mufly.identify.linear.linear_structure import LinearStructure, SearchCoordinates, scale_gains_to_record
from mufly.results import ResultColumn, ShownBlock, result, tabulate_results

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

MIN_PARTIAL_COHERENCE = 0.6
"""Least partial coherence of a point (Tischler and Remple, Sec. 7.5.3)."""
_MIN_FIT_COHERENCE = 0.5  # of a structured model
_FIT_FREQUENCY_COUNT = 60  # number of frequencies of a fit
_INDEPENDENT_SEGMENT_FRACTION = 18.0 / 19.0  # independent segments per half-overlapping Hann segment


@result(
    eq=False,
    json="frequency_hz responses=tabulate_pair_responses coherence",
)
class FrequencyResponse:
    """Responses of all outputs to all inputs, estimated from one or several records.

    Attributes
    ----------
    frequency_hz : (f,) array
    response : (f, outputs, inputs) complex array
        NaN where an input has no power.
    coherence : (f, outputs) array
        Multiple coherence: share of each output's power explained linearly by the inputs.
    partial : (f, outputs, inputs) array
        Partial coherence.
    error : (f, outputs, inputs) array
        Random error (one standard deviation) of the magnitude, relative; it equals the error of the phase (rad).
    degrees_of_freedom : (f, outputs, inputs) array
        Degrees of freedom of ``error``.
    averages : float
        Equivalent number of independent segments.
    inputs, outputs : tuple of str
    window_s : (f, outputs, inputs) array, optional
        Window length (s) by frequency and pair, for a composite response.
    """

    frequency_hz: Array
    response: ComplexArray
    coherence: Array
    partial: Array
    error: Array
    degrees_of_freedom: Array
    averages: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    window_s: Array | None = None

    def tabulate_pair_responses(self) -> dict[str, dict[str, Array]]:
        """Return the response of every input-output pair as ``{"input to output": {quantity: array over frequency}}``.

        The quantities are magnitude (dB), phase (deg), random error and partial coherence.
        """
        return {
            f"{self.inputs[i]} to {self.outputs[o]}": {
                "magnitude_dB": 20.0 * np.log10(np.maximum(np.abs(self.response[:, o, i]), 1e-12)),
                "phase_deg": np.degrees(np.angle(self.response[:, o, i])),
                "random_error": self.error[:, o, i], "partial_coherence": self.partial[:, o, i],
            }
            for o in range(len(self.outputs)) for i in range(len(self.inputs))
        }  # fmt: skip

    @property
    def is_coherent(self) -> NDArray[np.bool_]:
        """Whether the partial coherence is at least :data:`MIN_PARTIAL_COHERENCE`; (f, outputs, inputs)."""
        return np.asarray(self.partial >= MIN_PARTIAL_COHERENCE)

    def select_inputs(self, names: Sequence[str]) -> FrequencyResponse:
        """Return the responses to some of the inputs."""
        k = [self.inputs.index(name) for name in names]
        pairs = ("response", "partial", "error", "degrees_of_freedom")
        parts: dict[str, Any] = {name: getattr(self, name)[:, :, k] for name in pairs}
        window = None if self.window_s is None else self.window_s[:, :, k]
        return replace(self, inputs=tuple(names), window_s=window, **parts)

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the coherent band and the random error of each pair as printed text."""
        rows = []
        for o, i in np.ndindex(len(self.outputs), len(self.inputs)):
            good = self.is_coherent[:, o, i]
            f = self.frequency_hz[good]
            rows.append({
                "pair": f"{self.inputs[i]} to {self.outputs[o]}",
                "band": f"{f[0]:.2g} to {f[-1]:.2g}" if f.size else "none",
                "points": f"{f.size} of {len(good)}", "most": self.partial[:, o, i].max(),
                "random_error": np.median(self.error[good, o, i]) if f.size else np.nan,
            })  # fmt: skip
        band = ResultColumn("band", head=f"coherence >= {MIN_PARTIAL_COHERENCE:g} (Hz)")
        error = ResultColumn("random_error", "%", ".1f")
        columns = (ResultColumn("pair"), band, ResultColumn("points"), ResultColumn("most", form=".2f"), error)
        return (tabulate_results(rows, columns, title="Frequency responses, each input conditioned on the others"),)

    @property
    def relative_half_interval(self) -> Array:
        """Return half the width of the 95 % interval of the magnitude, relative to the magnitude.

        Its arcsine is half the width of the interval of the phase (rad).
        """
        return np.asarray(stdtrit(self.degrees_of_freedom, 0.975) * self.error)


def estimate_frequency_response(
    inputs: Array | Sequence[Array], outputs: Array | Sequence[Array], dt: float, *, segment_s: float,
    low_hz: float = 0.0, high_hz: float = 0.0, points: int = 100, frequency_hz: Array | None = None,
    input_names: tuple[str, ...] = (), output_names: tuple[str, ...] = (),
) -> FrequencyResponse:  # fmt: skip
    """Estimate frequency responses and coherences.

    Parameters
    ----------
    inputs, outputs : (n, k) and (n, m) array, or lists of such
        Signals without gaps; a list holds one array per record.
    dt : float
        Sample time (s).
    segment_s : float
        Length of a segment (s): long enough for the lowest frequency, short enough for several in the record.
    low_hz, high_hz : float
        Band; ``high_hz`` at most the Nyquist frequency.
    points : int
        Number of uniformly spaced frequencies.
    frequency_hz : (f,) array, optional
        Increasing frequencies, instead of the three arguments above.
    input_names, output_names : tuple of str

    Raises
    ------
    InputError
        If the band is empty, or a record is shorter than a segment.
    """
    us = [np.asarray(inputs)] if isinstance(inputs, np.ndarray) else [np.asarray(u) for u in inputs]
    ys = [np.asarray(outputs)] if isinstance(outputs, np.ndarray) else [np.asarray(y) for y in outputs]
    frequency = np.linspace(low_hz, high_hz, points) if frequency_hz is None else np.asarray(frequency_hz)
    spectra, averages = average_cross_spectra(us, ys, dt, segment_s, frequency)
    return response_from_spectra(frequency, spectra, us[0].shape[1], averages, input_names, output_names)


def average_cross_spectra(
    inputs: Sequence[Array], outputs: Sequence[Array], dt: float, segment_s: float, frequency_hz: Array
) -> tuple[ComplexArray, float]:
    """Return the cross-spectral densities of inputs and outputs, and the equivalent number of independent segments.

    Returns
    -------
    spectra : (f, k + m, k + m) complex array
        ``<z_i* z_j>``, two-sided, per Hz; white noise has its variance times ``dt`` for any segment length.
    averages : float

    Raises
    ------
    InputError
        If the band is empty, or no record is as long as a segment.
    """
    size = round(segment_s / dt)
    low_hz, high_hz = float(frequency_hz[0]), float(frequency_hz[-1])
    if not (0.0 < low_hz < high_hz <= 0.5 / dt * (1.0 + 1e-9)):
        raise InputError(
            "frequency response", "", f"the band {low_hz:g} to {high_hz:g} Hz is not resolved by samples "
            f"{dt:g} s apart", f"give 0 < low < high <= {0.5 / dt:g} Hz",
        )  # fmt: skip
    if size < 8 or min(len(u) for u in inputs) < size:
        raise InputError(
            "frequency response", "", f"a segment of {segment_s:g} s ({size} samples) does not fit the record",
            "give a segment shorter than every record",
        )  # fmt: skip
    window = get_window("hann", size)
    wave = window * np.exp(-2j * np.pi * frequency_hz[:, None] * dt * np.arange(size))
    wave *= np.sqrt(dt / float(window @ window))
    width = inputs[0].shape[1] + outputs[0].shape[1]
    spectra = np.zeros((len(frequency_hz), width, width), dtype=np.complex128)
    count = 0
    slope = np.linspace(-0.5, 0.5, size)[:, None]
    for u, y in zip(inputs, outputs, strict=True):
        z = np.column_stack([u, y])
        for start in range(0, len(z) - size + 1, max(1, size // 2)):
            part = z[start : start + size]
            part = part - part.mean(0) - slope * ((slope * part).sum(0) / (slope**2).sum())
            transform = wave @ part
            spectra += np.conj(transform)[:, :, None] * transform[:, None, :]
            count += 1
    spectra /= count
    return spectra, _INDEPENDENT_SEGMENT_FRACTION * count


def compute_conditioned_responses(s: ComplexArray, k: int) -> tuple[ComplexArray, Array, Array, Array]:
    """Return the responses of ``m`` outputs to ``k`` inputs from cross-spectral matrices ``s`` (f, k + m, k + m).

    The rows of ``s`` are the inputs, then the outputs; ``f`` is the number of frequencies.

    Returns
    -------
    response : (f, m, k) complex array
        Response; NaN for an input without power.
    own : (f, k) array
        Spectrum of each input, without the part explained by the other inputs.
    left : (f, m) array
        Spectrum of each output, without the part explained by all inputs.
    coherence : (f, m) array
        Multiple coherence.
    """
    points, m = len(s), s.shape[1] - k
    response, own = np.full((points, m, k), np.nan + 0j), np.zeros((points, k))
    left, coherence = np.zeros((points, m)), np.zeros((points, m))
    power = np.real(np.einsum("fii->fi", s))
    used = np.flatnonzero(power[:, :k].sum(0) > 1e-24 * max(power[:, :k].sum(), 1e-300))
    for f in range(points):
        if used.size == 0:
            break
        suu, suy = s[f][np.ix_(used, used)], s[f][np.ix_(used, np.arange(k, k + m))]
        # The effects of proportional inputs are not separable; the pseudo-inverse distributes the response among them.
        inverse = np.linalg.pinv(suu, rcond=1e-10, hermitian=True)
        h = inverse @ suy
        response[f][:, used] = h.T
        explained = np.real(np.einsum("ij,ij->j", np.conj(suy), h))
        coherence[f] = np.clip(explained / np.maximum(power[f, k:], 1e-300), 0.0, 1.0)
        left[f] = np.maximum(power[f, k:] - explained, 0.0)
        diagonal = np.real(np.diag(inverse))
        own[f, used] = np.where(diagonal > 0.0, 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
    return response, own, left, coherence


def response_from_spectra(
    frequency: Array, s: ComplexArray, k: int, averages: float, inputs: tuple[str, ...], outputs: tuple[str, ...]
) -> FrequencyResponse:  # fmt: skip
    """Return responses and coherences from averaged cross-spectral matrices ``s`` (f, k + m, k + m), inputs first."""
    response, own, left, coherence = compute_conditioned_responses(s, k)
    # |H_j|^2 S_jj.r is the explained power that input j alone adds.
    alone = np.abs(np.nan_to_num(response)) ** 2 * own[:, None, :]
    partial = alone / np.maximum(alone + left[:, :, None], 1e-300)
    error, degrees_of_freedom = response_random_error(partial, averages, k)
    return FrequencyResponse(
        frequency, response, coherence, partial, error, degrees_of_freedom, averages, inputs, outputs
    )


def response_random_error(coherence: Array, averages: float | Array, inputs: int) -> tuple[Array, Array]:
    """Return the random error of a response (relative in magnitude, rad in phase), and its degrees of freedom."""
    square = np.clip(coherence, 1e-12, 1.0)
    # As many inputs as segments explain any output: half a degree of freedom then gives a very wide interval.
    degrees_of_freedom = np.full_like(square, 1.0) * np.maximum(2.0 * (averages - inputs), 0.5)
    return np.sqrt((1.0 - square) / (square * degrees_of_freedom)), degrees_of_freedom


def state_space_frequency_response(
    a: Array, b: Array, c: Array, d: Array, frequency_hz: Array, delay_s: Array | None = None
) -> ComplexArray:
    """Return the response of ``x' = A x + B u(t - delay), y = C x + D u(t - delay)``.

    Parameters
    ----------
    a, b, c, d : arrays
        State-space matrices (n, n), (n, k), (m, n), (m, k).
    frequency_hz : (f,) array
    delay_s : (k,) array, optional
        Delay of each input (s).

    Returns
    -------
    (f, m, k) complex array
    """
    s = 2j * np.pi * np.asarray(frequency_hz)
    eye = np.eye(len(a))
    x = np.linalg.solve(s[:, None, None] * eye - a, np.broadcast_to(b.astype(complex), (len(s), *b.shape)))
    h = c @ x + d
    turned = h if delay_s is None else h * np.exp(-s[:, None, None] * delay_s)
    return np.asarray(turned, dtype=np.complex128)


def compute_response_fit_cost(data: FrequencyResponse, model: ComplexArray, *, least: float = 0.3) -> Array:
    """Return Tischler and Remple's cost J of every input-output pair.

    Parameters
    ----------
    data : FrequencyResponse
    model : (f, outputs, inputs) complex array
        Response of the model at the same frequencies.
    least : float
        Least partial coherence; other frequencies are omitted.

    Returns
    -------
    (outputs, inputs) array
        Cost; NaN for pairs without a coherent frequency.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = model / data.response
        level = 20.0 * np.log10(np.abs(ratio))
        phase = np.degrees(np.angle(ratio))
    weight = (1.58 * (1.0 - np.exp(-data.partial))) ** 2
    good = np.isfinite(level) & (data.partial >= least)
    cost = np.where(good, weight * (level**2 + 0.01745 * phase**2), 0.0).sum(0)
    number = good.sum(0)
    return np.where(number > 0, 20.0 * cost / np.maximum(number, 1), np.nan)


@dataclass(frozen=True, eq=False)
class FrequencyResponseFit:
    """Model structure fitted to frequency responses.

    Attributes
    ----------
    values : (p,) array
        Parameters of the structure (SI).
    value_std : (p,) array
        Standard deviations from curvature and size of the cost for independent frequencies: a lower bound.
    measured_response : FrequencyResponse
    model_response : (f, outputs, inputs) complex array
        Response at ``values``.
    cost : (outputs, inputs) array
        Tischler and Remple's J at ``values``; NaN for pairs without coherence.
    cost_before : (outputs, inputs) array
        Cost J at the start values.
    """

    values: Array
    value_std: Array
    measured_response: FrequencyResponse
    model_response: ComplexArray
    cost: Array
    cost_before: Array


def compute_structure_frequency_response(
    structure: LinearStructure, values: Array, frequency_hz: Array
) -> ComplexArray:
    """Return the frequency response (f, outputs, inputs) of a model structure with given parameter values."""
    a, b, c, d, delay = structure.state_space_matrices(values)
    return state_space_frequency_response(a, b, c, d, frequency_hz, delay)


def _chance_coherence(averages: float, inputs: int, frequencies: float) -> float:
    """Return the partial coherence that unrelated signals exceed at one or more frequencies in 5 % of records."""
    degrees_of_freedom = max(averages - inputs, 1.0)
    return float(1.0 - (0.05 / max(frequencies, 1.0)) ** (1.0 / degrees_of_freedom))


def fit_frequency_response(
    structure: LinearStructure, u: Array, y: Array, dt: float, *, first: Array, segment_s: float, high_hz: float,
) -> FrequencyResponseFit:  # fmt: skip
    """Fit a structure to the frequency responses of a record.

    Parameters
    ----------
    structure : LinearStructure
    u, y : (n, inputs), (n, outputs) array
        Inputs and outputs without gaps.
    dt : float
        Sample time (s).
    first : (p,) array
        Start values of the parameters.
    segment_s : float
        Length of the segments (s); the lowest frequency is 1.5 / ``segment_s``.
    high_hz : float
        Highest frequency.

    Raises
    ------
    InputError
        If no frequency is coherent, or the record is too short.
    """
    structure = scale_gains_to_record(structure, u, y)
    data = estimate_frequency_response(
        u, y, dt, segment_s=segment_s, low_hz=1.5 / segment_s, high_hz=high_hz, points=_FIT_FREQUENCY_COUNT,
        input_names=structure.inputs, output_names=structure.outputs,
    )  # fmt: skip
    least = max(
        _MIN_FIT_COHERENCE,
        _chance_coherence(data.averages, len(structure.inputs), (high_hz - 1.5 / segment_s) * segment_s / 1.5),
    )
    good = (data.partial >= least) & np.isfinite(data.response)
    good &= good.sum(0) >= 4
    if 2 * good.sum() < len(structure.parameters):
        raise InputError(
            "frequency response", "",
            f"{int(good.sum())} coherent points are too few for {len(structure.parameters)} parameters",
            "give a longer record or more excitation",
        )  # fmt: skip
    weight = 1.58 * (1.0 - np.exp(-data.partial))
    share = 20.0 / np.maximum(good.sum(0), 1)

    at = SearchCoordinates(structure.parameters, first)

    def response_residual(z: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = compute_structure_frequency_response(structure, at.to_values(z), data.frequency_hz) / data.response
            level, phase = 20.0 * np.log10(np.maximum(np.abs(ratio), 1e-12)), np.degrees(np.angle(ratio))
        scaled = np.sqrt(share) * weight
        rows = np.stack([scaled * level, np.sqrt(0.01745) * scaled * phase])
        return np.asarray(rows[:, good].ravel())

    lower, upper = at.bounds
    start = np.clip(at.to_search_coordinates(np.clip(first, at.low, at.high)), lower + 1e-9, upper - 1e-9)
    solution = least_squares(response_residual, start, bounds=(lower, upper), x_scale="jac", max_nfev=200)
    found = at.to_values(solution.x)
    model = compute_structure_frequency_response(structure, found, data.frequency_hz)
    used = np.where(good.any(axis=0), 1.0, np.nan)
    before = used * compute_response_fit_cost(
        data, compute_structure_frequency_response(structure, first, data.frequency_hz), least=least
    )
    jacobian = np.asarray(solution.jac, dtype=np.float64)
    curvature = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)
    error = 2.0 * solution.cost / max(solution.fun.size - found.size, 1)
    std = np.sqrt(np.maximum(np.diag(curvature), 0.0) * error) * at.value_derivatives(solution.x)
    return FrequencyResponseFit(
        found, std, data, model, used * compute_response_fit_cost(data, model, least=least), before
    )
