"""Results of a fit: estimates with intervals, undetermined directions, and the prediction of every record.

All fits of this package (bench, flight, linear) return these frozen dataclasses; reports, files and commands read
them. Intervals are two-sided at 95 %. ``covariance`` is the covariance of the estimates in SI units, in the order of
``estimates``. It is already corrected for coloured residuals where the method does so
(``docs/explanation/identification.md``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from mufly.errors import ArgumentError
from mufly.files.input_files import validate_model
from mufly.results import (
    ShownBlock,
    ShownTable,
    format_value,
    make_lines_block,
    make_table_block,
    result,
)
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]

MAX_RESIDUAL_OVER_NOISE = 10.0
"""Ratio of residuals to sensor noise above which a minimum, or a prediction, is not credible."""


@result
class ParameterEstimate:
    """One free parameter after a fit, in SI units.

    Attributes
    ----------
    symbol : str
        Symbol as printed by ``mufly vehicle show``: ``"cT_dw"``.
    key : str
        Dotted key in the vehicle file, ``"rotors.lower.thrust_coefficient"``; ``""`` for a parameter that is in no
        vehicle file (a bias, an initial state).
    unit : str
        SI unit; ``"1"`` if dimensionless.
    start, value : float
        Value before and after the fit.
    std : float
        Standard deviation; infinite if the data do not determine the parameter.
    low, high : float
        95 % interval of the estimate.
    at_bound : bool
        Whether the fit stopped at a bound, so that ``std`` and interval are invalid.
    """

    symbol: str
    key: str
    unit: str
    start: float
    value: float
    std: float
    low: float
    high: float
    at_bound: bool = False

    @classmethod
    def from_std(
        cls, symbol: str, key: str, unit: str, start: float | Vehicle | None, value: float, std: float, *,
        quantile: float, at_bound: bool = False,
    ) -> ParameterEstimate:  # fmt: skip
        """Return an estimate whose interval extends ``quantile`` standard deviations to either side.

        ``start`` may be the vehicle that holds the start value under ``key``. None, or no key, gives NaN.
        """
        if not isinstance(start, float):
            start = float(attrgetter(key)(start)) if start is not None and key else math.nan
        return cls(symbol, key, unit, start, value, std, value - quantile * std, value + quantile * std, at_bound)


def tabulate_estimates(
    estimates: Iterable[ParameterEstimate], title: str, beside: Mapping[str, Mapping[str, str]] | None = None
) -> ShownTable:
    """Return a table of estimates with intervals; ``beside`` maps headings of further columns to texts by symbol."""
    more, rows = beside or {}, []
    for e in estimates:
        known = math.isfinite(e.std) and not e.at_bound
        interval = f"{e.low:.4g} to {e.high:.4g}" if known else "at its bound" if e.at_bound else "-"
        rows.append([
            e.symbol, "not observable" if math.isinf(e.std) else f"{e.value:.5g}",
            f"{100 * e.std / abs(e.value):.2g} %" if known and e.value else "-", interval,
            "" if e.unit == "1" else e.unit, format_value(e.start, ".4g"),
            *(m.get(e.symbol, "") for m in more.values()),
        ])  # fmt: skip
    return make_table_block(("symbol", "value", "std", "95 % interval", "unit", "start", *more), rows, title=title)


class EstimateLookup:
    """Base class of fit results: look-up of estimates by their symbol."""

    estimates: tuple[ParameterEstimate, ...]

    def find_estimate(self, symbol: str) -> ParameterEstimate:
        """Return the estimate of a parameter by its symbol.

        Raises
        ------
        KeyError
            If the fit has no such parameter.
        """
        return {e.symbol: e for e in self.estimates}[symbol]


@result(
    eq=False,
    json="name role outputs=output_names noise_std error_over_noise=rms_over_noise converged doubt",
)
class RecordPrediction:
    """One record with the fitted model's prediction from the inputs alone.

    Attributes
    ----------
    name : str
        Name of the log, and of the used part if only a part was used.
    role : {"fit", "held out"}
        Whether the fit used the record.
    time_s : (n,) array
        Increasing time (s).
    output_names : tuple of str
        Names of the ``m`` outputs: ``"p"``, ``"roll"``, ``"height"``, ...
    units : tuple of str
        SI units of the outputs.
    measured, predicted : (n, m) array
        Outputs in SI units; ``measured`` is NaN without a measurement.
    noise_std : (m,) array
        Standard deviation of the measurement noise (the noise floor).
    inputs : (n, k) array
        Inputs, constant between samples.
    input_names : tuple of str
    converged : bool
        Whether the search for the initial state of a held-out record ended in a minimum.
    doubt : str
        Reason, as text, why the prediction is not credible; empty if there is none.
    """

    name: str
    role: Literal["fit", "held out"]
    time_s: _Array
    output_names: tuple[str, ...]
    units: tuple[str, ...]
    measured: _Array
    predicted: _Array
    noise_std: _Array
    inputs: _Array
    input_names: tuple[str, ...]
    converged: bool = True
    doubt: str = ""

    @property
    def residual(self) -> _Array:
        """Residual, measured less predicted, (n, m); NaN without a measurement."""
        return self.measured - self.predicted

    def rms_over_noise(self) -> _Array:
        """Return the RMS residual of every output divided by its noise, (m,); 1 is the noise floor."""
        return np.sqrt(np.nanmean(self.residual**2, axis=0)) / self.noise_std


@result(
    eq=False,
    json="vehicle method converged message parameters=estimates correlation undetermined "
    "held=uncertain_from_held_parameters records cost simulations seconds=computing_time_s",
)
class FitResult(EstimateLookup):
    """Result of a fit.

    Attributes
    ----------
    vehicle : str
        Name of the vehicle (or linear model) that was fitted.
    estimates : tuple of ParameterEstimate
        Estimates of the ``n`` free parameters.
    covariance, correlation : (n, n) array
        Covariance (SI units) and correlation of the estimates, in the order of ``estimates``.
    undetermined : tuple of str
        Descriptions of the directions that the data do not determine; empty if there is none.
    cost : float
        Cost function at the estimates.
    history : tuple of dict
        One row per iteration or generation: ``iteration``, ``cost`` and every symbol with its value.
    method : str
        Description of the method.
    simulations : int
        Records simulated during the fit, counting every trial of the parameters.
    computing_time_s : float
        Wall time (s).
    converged : bool
    message : str
        Reason for the end of the search, and warnings.
    records : tuple of RecordPrediction
        Fitted records first, then held-out records.
    uncertain_from_held_parameters : tuple of str
        Descriptions of estimates whose uncertainty comes mainly from held parameters.
    """

    vehicle: str
    estimates: tuple[ParameterEstimate, ...]
    covariance: _Array
    correlation: _Array
    undetermined: tuple[str, ...]
    cost: float
    history: tuple[dict[str, Any], ...]
    method: str
    simulations: int
    computing_time_s: float
    converged: bool
    message: str
    records: tuple[RecordPrediction, ...]
    uncertain_from_held_parameters: tuple[str, ...] = ()

    def records_with_role(self, role: Literal["fit", "held out"]) -> tuple[RecordPrediction, ...]:
        """Return the records with this role, fitted or held out."""
        return tuple(r for r in self.records if r.role == role)

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the estimates and the notes on the fit as printed text."""
        return (tabulate_estimates(self.estimates, self.vehicle), *self.show_notes())

    def show_notes(self) -> tuple[ShownBlock, ...]:
        """Return undetermined parameters, the errors of each record and the end of the search as printed text."""
        rows = []
        for r in self.records:
            ratios = zip(r.output_names, r.rms_over_noise(), strict=True)
            rows.append((r.name, r.role, ", ".join(f"{o} {v:.2f}" for o, v in ratios)))
        doubts = [f"{r.doubt}." for r in self.records if r.doubt]
        state = "Converged" if self.converged else "NOT converged"
        detail = "" if self.message == "converged" else f" ({self.message})"
        return (
            make_lines_block(*(f"{t}." for t in self.undetermined), mark="Not distinguishable", style="yellow"),
            make_lines_block(
                *(f"{t}." for t in self.uncertain_from_held_parameters), mark="Uncertainty from held parameters"
            ),
            make_table_block(("record", "", "error over sensor noise (1: noise only)"), rows, text=(0, 1, 2)),
            make_lines_block(*doubts, mark="Warning", style="red"),
            make_lines_block(
                f"{state}{detail}: cost {self.cost:.6g}, {self.simulations} simulated flights, "
                f"{self.computing_time_s:.1f} s",
                style="green" if self.converged else "red",
            ),
        )


# ----------------------------------------------------------------------------
# Estimates written into a vehicle, each with provenance and uncertainty.


def apply_estimates(vehicle: Vehicle, estimates: Iterable[ParameterEstimate], note: str) -> Vehicle:
    """Return a vehicle whose parameters are replaced by the estimates of a fit.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle before the replacement.
    estimates : iterable of ParameterEstimate
        Estimates without a key, or not determined by the data, are skipped.
    note : str
        Provenance note; standard deviation and interval are appended.

    Raises
    ------
    InputError
        If no estimate has a key in the vehicle file, or a value is invalid there.
    """
    tables = vehicle.model_dump()
    written = 0
    found = list(estimates)
    for e in found:
        if not e.key or not np.isfinite(e.value) or np.isinf(e.std):
            continue
        *path, last = e.key.split(".")
        table = tables
        for part in path:
            table = table[part]
        doubt = "held at its bound" if e.at_bound else f"std {e.std:.2g}, 95 % from {e.low:.4g} to {e.high:.4g}"
        told = {"source": "identified", "note": f"{note}; {doubt}", "std": None if e.at_bound else e.std}
        table[last] = {**table[last], "value": e.value, **told}
        written += 1
    if not written:
        raise ArgumentError(
            "estimates",
            "",
            "no estimate has a key in a vehicle file",
            "see the parameters marked 'not observable'",
        )
    if any(e.key == "body.mass" for e in found):
        tables["mass_budget"] = None  # its sum differs from the estimated mass
    return validate_model(Vehicle, tables, vehicle.name)


# ----------------------------------------------------------------------------
# Covariance of estimates from time series, and directions in their space that the data do not determine.
#
# All fits to records (flights, linear models, equation error) use this covariance. Bench data come in few settings,
# not as time series, and use :mod:`mufly.bench.residual_covariance`. With whitened sensitivities ``S`` (initial
# states, trims and biases eliminated), residual ``e`` and prior information ``P``::
#
#     H = S^T S + P                                                Cramer-Rao: covariance H^-1 for white residuals
#     covariance = H^-1 (sum_ij S_i^T R(i - j) S_j + P) H^-1       coloured residuals, R their autocorrelation
#
# (Maine and Iliff, NASA RP 1168, Sec. 8.2; Morelli and Klein 1997, "Accuracy of aerodynamic model parameters
# estimated from flight test data", J. Guidance 20(1); Klein and Morelli, Sec. 6.3). Residuals of flight data are not
# white (vibration, wind, unmodelled dynamics), and the bound is then too small by a factor of 5 to 10 in standard
# deviation. ``R`` is estimated from the residuals with Parzen's window, which keeps the sum positive semi-definite.
# The window is four times as long as the largest lag with a significant autocorrelation (3.9 deviations). Without
# such a lag the residual counts as white, because the estimate of an absent correlation only adds noise. The double
# sum is a convolution and is computed by FFT. No variance may be smaller than the Cramer-Rao bound.
#
# Undetermined directions follow from the relative covariance C_ij = cov_ij / (theta_i theta_j), or from the covariance
# of the logarithms. Eigenvectors with large eigenvalues are directions that the data hardly determine. A change of all
# parameters along such a direction, each by its share, changes no measured quantity by more than its error.


Array = NDArray[np.float64]

UNDETERMINED_RELATIVE_STD = 0.5  # relative standard deviation above which a direction counts as undetermined
_MAX_PRINTED_RELATIVE_STD = 100.0  # relative standard deviation above which no number is printed
_MIN_COMPONENT_FRACTION = 0.15  # fraction of a direction's largest component below which a parameter is not named
_MIN_PAIR_CORRELATION = 0.98  # correlation above which a pair of parameters is hardly separable ...
_MIN_PAIR_RELATIVE_STD = 0.005  # ... if the relative standard deviation of each exceeds this value
_MAX_CORRELATION_LAG_SAMPLES, _INSIGNIFICANT_LAGS_TO_STOP = 300, 10  # samples
_DECISIVE_LIKELIHOOD_DIFFERENCE = 4.0  # difference of 2 log L that decides between error shapes, as for AIC
_LAG_WINDOW_PER_CORRELATION_REACH = 4
"""Window length per correlation reach; 2 loses a quarter of the variance of a slowly varying sensitivity."""
_SIGNIFICANT_CORRELATION_SIGMAS = 3.9
"""Standard deviations; about 300 lags are tested, and none should exceed it by chance."""


def parzen_window(lags: int) -> Array:
    """Return Parzen's lag window at lags -lags..lags; the window's Fourier transform is never negative."""
    x = np.abs(np.arange(-lags, lags + 1)) / max(lags, 1)
    return np.where(x <= 0.5, 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * np.clip(1.0 - x, 0.0, None) ** 3)


def find_largest_correlated_lag(residual: Array, longest: int) -> int:
    """Return the largest lag (samples) with significant autocorrelation of a residual (n,); 0 if white."""
    e = residual - residual.mean()
    n, power = len(e), float(e @ e)
    if power <= 0.0:
        return 0
    full = np.asarray(np.fft.irfft(np.abs(np.fft.rfft(e, 2 * n)) ** 2)[: longest + 1], np.float64) / power
    reach = 0
    for lag in range(1, len(full)):
        if abs(full[lag]) > _SIGNIFICANT_CORRELATION_SIGMAS / np.sqrt(n):
            reach = lag
        elif lag - reach >= _INSIGNIFICANT_LAGS_TO_STOP:
            break
    return reach


def coloured_covariance(
    sensitivities: Sequence[Array], residuals: Sequence[Array], prior_std: Array | None = None
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Return the covariance of estimates under coloured residuals, and the Cramer-Rao bound for white residuals.

    Parameters
    ----------
    sensitivities : sequence of (n, m, t) array
        Whitened sensitivities of the ``m`` outputs to the ``t`` parameters, one array per record; zero without a
        measurement.
    residuals : sequence of (n, m) array
        Whitened residuals; zero without a measurement.
    prior_std : (t,) array, optional
        Prior standard deviations; infinite without a prior.

    Returns
    -------
    covariance, bound : (t, t) array
        Corrected covariance and Cramer-Rao bound; infinite on the diagonal for a parameter that neither data nor
        prior determine.
    coloured : bool
        Whether any residual was coloured.
    """
    t = sensitivities[0].shape[2]
    prior = np.zeros((t, t)) if prior_std is None else np.diag(1.0 / prior_std**2)
    information = prior + sum(np.einsum("nmt,nmu->tu", s, s) for s in sensitivities)
    known = np.diag(information) > 0.0
    scale = 1.0 / np.sqrt(np.where(known, np.diag(information), 1.0))
    bound = np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-14, hermitian=True)
    bound = bound * np.outer(scale, scale)
    middle, coloured = prior.copy(), False
    for s, e in zip(sensitivities, residuals, strict=True):
        n, m, _ = s.shape
        reach = [find_largest_correlated_lag(e[:, k], min(_MAX_CORRELATION_LAG_SAMPLES, n // 4)) for k in range(m)]
        coloured = coloured or any(reach)
        for a in range(m):
            for b in range(m):
                far = max(reach[a], reach[b])
                if a == b and far == 0:
                    middle += s[:, a].T @ s[:, a]
                elif far > 0 and (a == b or (reach[a] and reach[b])):
                    r = _lagged_mean_product(e[:, a], e[:, b], _LAG_WINDOW_PER_CORRELATION_REACH * far) * parzen_window(
                        _LAG_WINDOW_PER_CORRELATION_REACH * far
                    )
                    spread = fftconvolve(s[:, b], r[::-1, None], mode="full", axes=0)[
                        _LAG_WINDOW_PER_CORRELATION_REACH * far : _LAG_WINDOW_PER_CORRELATION_REACH * far + n
                    ]
                    middle += s[:, a].T @ spread
    middle = 0.5 * (middle + middle.T)
    covariance = bound @ middle @ bound
    grow = np.sqrt(np.maximum(1.0, np.diag(bound) / np.maximum(np.diag(covariance), 1e-300)))
    unknown = np.diag(np.where(known, 0.0, np.inf)) if not known.all() else 0.0
    return covariance * np.outer(grow, grow) + unknown, bound + unknown, coloured


def _lagged_mean_product(a: Array, b: Array, far: int) -> Array:
    """Return ``<a_i b_(i+k)>`` for k = -far..far."""
    n = len(a)
    size = 2 * n
    count = max(int(np.count_nonzero(a)), 1)
    r = np.fft.irfft(np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size), size) / count
    k = np.arange(-far, far + 1)
    return np.where(np.abs(k) < n, r[k % size], 0.0)


def correlation_matrix(covariance: Array) -> Array:
    """Return the correlation matrix of a covariance."""
    std = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    known = np.isfinite(std)
    whole = np.where(np.outer(known, known), covariance, 0.0) / np.outer(std, std)
    return np.where(np.eye(len(std), dtype=bool), 1.0, np.clip(whole, -1.0, 1.0))


def compute_relative_covariance(covariance: Array, values: Array) -> Array:
    """Return the relative covariance, ``cov_ij / (value_i value_j)``."""
    size = np.where(values == 0.0, 1e-12, values)
    return covariance / np.outer(size, size)


def covariance_from_information(information: Array) -> Array:
    """Return the covariance (p, p) that inverts the Fisher information of relative parameters.

    A parameter without information gets an infinite diagonal entry. A direction without information gets a standard
    deviation of 1e6.
    """
    known = np.diag(information) > 0.0
    covariance = np.diag(np.where(known, 0.0, np.inf))
    size, vectors = np.linalg.eigh(0.5 * (information + information.T)[np.ix_(known, known)])
    covariance[np.ix_(known, known)] = (vectors / np.maximum(size, 1e-12)) @ vectors.T
    return covariance


def describe_undetermined_combinations(
    symbols: Sequence[str], covariance: Array, within: Array | None = None
) -> tuple[str, ...]:
    """Describe the parameters, and combinations of parameters, that the data do not determine.

    Parameters
    ----------
    symbols : sequence of str
    covariance : (p, p) array
        Covariance of the relative parameters from the data alone. A direction is named if its standard deviation
        exceeds ``UNDETERMINED_RELATIVE_STD``.
    within : (p, p) array, optional
        Covariance with the priors, searched for hardly separable pairs; by default ``covariance``.
    """
    found = np.isfinite(np.diag(covariance))
    said = [f"{s} is not determined by the data" for s, known in zip(symbols, found, strict=True) if not known]
    names = [s for s, known in zip(symbols, found, strict=True) if known]
    inner = covariance[np.ix_(found, found)]
    size, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    covered: list[set[str]] = []
    for k in np.argsort(-size):
        if size[k] > UNDETERMINED_RELATIVE_STD**2:
            share = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
            parts = [j for j in np.argsort(-np.abs(share)) if abs(share[j]) >= _MIN_COMPONENT_FRACTION]
            covered.append({names[j] for j in parts})
            said.append(_describe_direction([names[j] for j in parts], share[parts], float(np.sqrt(size[k]))))
    whole = inner if within is None else within[np.ix_(found, found)]
    std, correlation = np.sqrt(np.diag(whole)), correlation_matrix(whole)
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        c = float(correlation[i, j])
        if (
            abs(c) < _MIN_PAIR_CORRELATION
            or min(std[i], std[j]) < _MIN_PAIR_RELATIVE_STD
            or any({names[i], names[j]} <= s for s in covered)
        ):
            continue
        said.append(
            f"{names[i]} and {names[j]} can hardly be separated (correlation {c:+.4f}): the data determine their "
            f"{'sum' if c < 0 else 'ratio'} {1.0 / np.sqrt(max(1.0 - c * c, 1e-12)):.0f} times better than either"
        )
    return tuple(said)


def _describe_direction(names: Sequence[str], share: Array, std: float) -> str:
    """Describe in words a combination of parameters that the data do not determine.

    ``share`` holds the relative change of each parameter, divided by the largest of them.
    """
    doubt = "no bound" if std > _MAX_PRINTED_RELATIVE_STD else f"standard deviation {100 * std:.0f} %"
    if len(names) == 1:
        return (
            f"{names[0]} is not determined by the data"
            if std > _MAX_PRINTED_RELATIVE_STD
            else f"{names[0]} is hardly seen: {doubt} of its value"
        )
    if len(names) == 2 and abs(abs(share[1]) - 1.0) < 0.2:
        kind = "ratio" if share[1] > 0 else "product"
        return f"only the {kind} of {names[0]} and {names[1]} is seen ({doubt} along it)"
    moves = " with ".join(f"{n} {10 * s:+.0f} %" for n, s in zip(names, share, strict=True))
    what = f"{moves} has no effect on the measured outputs ({doubt} in this direction)"
    return f"{', '.join(names)} are determined only in combination: {what}"


def select_error_model(
    shapes: Sequence[tuple[float, float]], tried: Callable[[float, float], tuple[Array, float]]
) -> tuple[Array, str]:
    """Return the standard deviations of the measurements by the most likely error model, and that model as a text.

    Parameters
    ----------
    shapes : sequence of (% of reading, % of full scale)
        Candidate error models. The first is chosen unless another is clearly more likely.
    tried : callable
        Function from an error model to expected errors and minus twice the log-likelihood of the data.
    """
    best, shape, least = np.empty(0), shapes[0], np.inf
    for k, one in enumerate(shapes):
        std, minus_log = tried(*one)
        minus_log -= 0.0 if k else _DECISIVE_LIKELIHOOD_DIFFERENCE
        if minus_log < least:
            best, shape, least = std, one, minus_log
    parts = zip(shape, ("the reading", "full scale"), strict=True)
    return best, " and ".join(f"{v:g} % of {what}" for v, what in parts if v)
