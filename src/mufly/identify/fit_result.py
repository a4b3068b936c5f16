"""What a fit returns: estimates with intervals, what the data do not see, and how well every record is predicted.

Plain frozen data, made by the fits of this room (bench, flight, linear) and read by reports, files and commands.
Intervals are at 95 % and two-sided; ``covariance`` is that of the estimates in SI units, in the order of
``estimates``, already corrected for coloured residuals where the method does so
(``docs/explanation/identification.md``).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from mufly.errors import ArgumentError
from mufly.input_files import validate_model
from mufly.results import result
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]

MAX_RESIDUAL_OVER_NOISE = (
    10.0  # residuals over the sensor's noise from which a minimum, or a prediction, is not to be believed
)


@result
class ParameterEstimate:
    """One free parameter after a fit, in SI units.

    Attributes
    ----------
    symbol : str
        As ``mufly vehicle show`` prints it: ``"cT_dw"``.
    key : str
        Dotted key in the vehicle file, ``"rotors.lower.thrust_coefficient"``; ``""`` for what is in no vehicle file
        (a bias, an initial state).
    unit : str
        SI unit; ``"1"`` for none.
    start, value : float
        Before and after the fit.
    std : float
        Standard deviation; infinite if the data do not see the parameter.
    low, high : float
        95 % interval of the estimate.
    at_bound : bool
        The fit stopped at a bound, so that ``std`` and interval do not hold.
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
        """Return an estimate whose interval is ``quantile`` deviations to either side.

        ``start`` may be the vehicle that holds it under ``key``; NaN if there is none.
        """
        if not isinstance(start, float):
            start = float(attrgetter(key)(start)) if start is not None and key else math.nan
        return cls(symbol, key, unit, start, value, std, value - quantile * std, value + quantile * std, at_bound)


class EstimateLookup:
    """What the results of all fits have: estimates that are found by their symbol."""

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
    picture="mufly.identify.fit_pictures:prediction_picture",
    json="name role outputs noise_std error_over_noise=rms_over_noise converged doubt",
)
class RecordPrediction:
    """One record beside what the fitted model predicts for it from its inputs alone.

    Attributes
    ----------
    name : str
        Name of the log, with its part if only a part was used.
    role : {"fit", "held out"}
        Whether the fit used it.
    time_s : (n,) array
        Rising (s).
    output_names : tuple of str
        Names of the ``m`` outputs: ``"p"``, ``"roll"``, ``"height"``, ...
    units : tuple of str
        Their SI units.
    measured, predicted : (n, m) array
        ``measured`` is NaN where nothing was measured.
    noise_std : (m,) array
        Standard deviation of the measurement noise (the noise floor).
    inputs : (n, k) array
        Held from each sample to the next.
    input_names : tuple of str
    converged : bool
        Whether the search for the start values of a held-out record ended in a minimum.
    doubt : str
        Why a prediction is not to be believed, in words; empty if nothing speaks against it.
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
        """Measured less predicted, (n, m); NaN where nothing was measured."""
        return self.measured - self.predicted

    def rms_over_noise(self) -> _Array:
        """Return root mean square of the residual of every output over its noise, (m,): 1 is the noise floor."""
        return np.sqrt(np.nanmean(self.residual**2, axis=0)) / self.noise_std


@result(
    eq=False,
    picture="mufly.identify.fit_pictures:fit_picture",
    json="vehicle method converged message parameters=estimates correlation unseen held records cost "
    "simulations seconds",
)
class FitResult(EstimateLookup):
    """Result of a fit.

    Attributes
    ----------
    vehicle : str
        Name of the vehicle (or linear model) that was fitted.
    estimates : tuple of Estimate
        The ``n`` free parameters.
    covariance, correlation : (n, n) array
        Of the estimates, in their order, SI units.
    unseen : tuple of str
        Directions that the data do not determine, each in words; empty if all are seen.
    cost : float
        What was minimised, at the estimates.
    history : tuple of dict
        One row an iteration or generation: ``iteration``, ``cost`` and every symbol with its value.
    method : str
        In words.
    simulations : int
        Records simulated during the fit, counting every trial of the parameters.
    seconds : float
        Wall time.
    converged : bool
    message : str
        Why it stopped, and warnings, in words.
    records : tuple of RecordFit
        Used first, held-out ones after them.
    held : tuple of str
        Estimates whose interval is wide above all because of parameters that were held, each in words.
    """

    vehicle: str
    estimates: tuple[ParameterEstimate, ...]
    covariance: _Array
    correlation: _Array
    unseen: tuple[str, ...]
    cost: float
    history: tuple[dict[str, Any], ...]
    method: str
    simulations: int
    seconds: float
    converged: bool
    message: str
    records: tuple[RecordPrediction, ...]
    held: tuple[str, ...] = ()

    def records_with_role(self, role: Literal["fit", "held out"]) -> tuple[RecordPrediction, ...]:
        """Return the records of one role."""
        return tuple(r for r in self.records if r.role == role)


# ----------------------------------------------------------------------------
# Estimates written into a vehicle, each with its provenance and its doubt.


def apply_estimates(vehicle: Vehicle, estimates: Iterable[ParameterEstimate], note: str) -> Vehicle:
    """Return a vehicle with some parameters replaced by what a fit found.

    Parameters
    ----------
    vehicle : Vehicle
        To start from.
    estimates : iterable of Estimate
        Those without a key, and those that the data do not see, are passed over.
    note : str
        Where they come from; standard deviation and interval are added to it.

    Raises
    ------
    InputError
        If no estimate belongs into a vehicle file, or a value is impossible there.
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
            "see the parameters marked 'not seen'",
        )
    if any(e.key == "body.mass" for e in found):
        tables["mass_budget"] = None  # it no longer adds up
    return validate_model(Vehicle, tables, vehicle.name)


# ----------------------------------------------------------------------------
# How sure are estimates from time series, and which directions in their space do the data not see?
#
# One covariance for every fit to records: flights, linear models, equation error. (Bench data are few and come in
# settings, not in time: theirs is :mod:`mufly.bench.residual_covariance`.) With whitened sensitivities ``S`` (start
# values,
# trims and biases eliminated), residual ``e`` and the priors' information ``P``::
#
#     H = S^T S + P                                                Cramer-Rao: covariance H^-1 for white residuals
#     covariance = H^-1 (sum_ij S_i^T R(i - j) S_j + P) H^-1       coloured residuals, R their autocorrelation
#
# (Maine and Iliff, NASA RP 1168, Sec. 8.2; Morelli and Klein 1997, "Accuracy of aerodynamic model parameters
# estimated from flight test data", J. Guidance 20(1); Klein and Morelli, Sec. 6.3). Residuals of flight data are not
# white (vibration, wind, what the model leaves out), and the bound is then too small by a factor of 5 to 10 in
# standard deviation. ``R`` is estimated from the residuals with Parzen's window, which keeps the sum positive
# semi-definite and reaches four times as far as the autocorrelation stands out of its noise (3.9 deviations); where
# none does, the residual
# counts as white, because the estimate of a correlation that is not there only adds noise. Convolution makes the
# double sum an FFT. No variance is taken to be smaller than Cramer-Rao's.
#
# What the data do not see is told from the covariance C of parameters in relative terms, C_ij = cov_ij / (theta_i
# theta_j), or of their logarithms: its eigenvectors with large eigenvalues are the directions that the data hardly
# see. Moving all parameters along one of them, each by its share, changes nothing that was measured by more than its
# error.


Array = NDArray[np.float64]

UNSEEN_RELATIVE_STD = 0.5  # relative standard deviation from which a direction counts as unseen
_UNINFORMATIVE_STD = 100.0  # relative standard deviation that says nothing
_MIN_DIRECTION_SHARE = 0.15  # of the largest part of a direction, below which a parameter is left out of the sentence
_MIN_PAIR_CORRELATION = 0.98  # correlation of a pair that is hardly told apart ...
_MIN_PAIR_STD = 0.005  # ... if that leaves each of them open by more than this
_MAX_CORRELATION_LAG, _WHITE_LAGS_TO_STOP = 300, 10  # samples
_DECISIVE_LIKELIHOOD_DIFFERENCE = 4.0  # difference of 2 log L, as by AIC
_LAG_WINDOW_PER_CORRELATION_REACH = (
    4  # times that reach; 2 leaves out a quarter of the variance of a slowly varying sensitivity
)
_SIGNIFICANT_DEVIATIONS = 3.9  # deviations; some 300 lags of a fit are looked at, and none should by chance


def parzen_window(lags: int) -> Array:
    """Return Parzen's lag window at lags -lags..lags; its transform is never negative."""
    x = np.abs(np.arange(-lags, lags + 1)) / max(lags, 1)
    return np.where(x <= 0.5, 1.0 - 6.0 * x**2 + 6.0 * x**3, 2.0 * np.clip(1.0 - x, 0.0, None) ** 3)


def correlation_reach(residual: Array, longest: int) -> int:
    """Return the lag up to which the autocorrelation of a residual (n,) stands out of its noise; 0 if white."""
    e = residual - residual.mean()
    n, power = len(e), float(e @ e)
    if power <= 0.0:
        return 0
    full = np.asarray(np.fft.irfft(np.abs(np.fft.rfft(e, 2 * n)) ** 2)[: longest + 1], np.float64) / power
    reach = 0
    for lag in range(1, len(full)):
        if abs(full[lag]) > _SIGNIFICANT_DEVIATIONS / np.sqrt(n):
            reach = lag
        elif lag - reach >= _WHITE_LAGS_TO_STOP:
            break
    return reach


def coloured_covariance(
    sensitivities: Sequence[Array], residuals: Sequence[Array], prior_std: Array | None = None
) -> tuple[Array, Array, bool]:  # fmt: skip
    """Return the covariance of estimates, corrected for coloured residuals, and the bound for white ones.

    Parameters
    ----------
    sensitivities : sequence of (n, m, t) array
        Of the ``m`` outputs to the ``t`` parameters, whitened; one a record. Zero where nothing was measured.
    residuals : sequence of (n, m) array
        Whitened, zero where nothing was measured.
    prior_std : (t,) array, optional
        Infinite for none.

    Returns
    -------
    covariance, bound : (t, t) array
        Infinite on the diagonal for a parameter that neither data nor prior know of. ``bound`` is Cramer-Rao's.
    coloured : bool
        Whether any residual was.
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
        reach = [correlation_reach(e[:, k], min(_MAX_CORRELATION_LAG, n // 4)) for k in range(m)]
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


def divide_by_values(covariance: Array, values: Array) -> Array:
    """Return the covariance of parameters over their values."""
    size = np.where(values == 0.0, 1e-12, values)
    return covariance / np.outer(size, size)


def covariance_from_information(information: Array) -> Array:
    """Return the covariance that belongs to a Fisher information of relative parameters, (p, p).

    Infinite on the diagonal for a parameter without information; a direction without gets a deviation of 1e6.
    """
    known = np.diag(information) > 0.0
    covariance = np.diag(np.where(known, 0.0, np.inf))
    size, vectors = np.linalg.eigh(0.5 * (information + information.T)[np.ix_(known, known)])
    covariance[np.ix_(known, known)] = (vectors / np.maximum(size, 1e-12)) @ vectors.T
    return covariance


def describe_unseen_combinations(
    symbols: Sequence[str], covariance: Array, within: Array | None = None
) -> tuple[str, ...]:
    """Say which parameters, and which combinations of them, the data do not determine.

    Parameters
    ----------
    symbols : sequence of str
    covariance : (p, p) array
        Of the relative parameters, as the data alone give it. A direction is named if its standard deviation exceeds
        ``UNSEEN_RELATIVE_STD``.
    within : (p, p) array, optional
        With the priors; pairs that are hardly told apart are looked for in it. Default: the same.
    """
    found = np.isfinite(np.diag(covariance))
    said = [f"{s} is not seen at all" for s, known in zip(symbols, found, strict=True) if not known]
    names = [s for s, known in zip(symbols, found, strict=True) if known]
    inner = covariance[np.ix_(found, found)]
    size, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    covered: list[set[str]] = []
    for k in np.argsort(-size):
        if size[k] > UNSEEN_RELATIVE_STD**2:
            share = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
            parts = [j for j in np.argsort(-np.abs(share)) if abs(share[j]) >= _MIN_DIRECTION_SHARE]
            covered.append({names[j] for j in parts})
            said.append(_describe_direction([names[j] for j in parts], share[parts], float(np.sqrt(size[k]))))
    whole = inner if within is None else within[np.ix_(found, found)]
    std, correlation = np.sqrt(np.diag(whole)), correlation_matrix(whole)
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        c = float(correlation[i, j])
        if (
            abs(c) < _MIN_PAIR_CORRELATION
            or min(std[i], std[j]) < _MIN_PAIR_STD
            or any({names[i], names[j]} <= s for s in covered)
        ):
            continue
        said.append(
            f"{names[i]} and {names[j]} are hardly told apart (correlation {c:+.4f}): the data see their "
            f"{'sum' if c < 0 else 'ratio'} {1.0 / np.sqrt(max(1.0 - c * c, 1e-12)):.0f} times better than either"
        )
    return tuple(said)


def _describe_direction(names: Sequence[str], share: Array, std: float) -> str:
    """Describe one direction of relative changes, ``share`` of the largest."""
    doubt = "no bound" if std > _UNINFORMATIVE_STD else f"standard deviation {100 * std:.0f} %"
    if len(names) == 1:
        return (
            f"{names[0]} is not seen at all"
            if std > _UNINFORMATIVE_STD
            else f"{names[0]} is hardly seen: {doubt} of its value"
        )
    if len(names) == 2 and abs(abs(share[1]) - 1.0) < 0.2:
        kind = "ratio" if share[1] > 0 else "product"
        return f"only the {kind} of {names[0]} and {names[1]} is seen ({doubt} along it)"
    moves = " with ".join(f"{n} {10 * s:+.0f} %" for n, s in zip(names, share, strict=True))
    what = f"{moves} changes nothing that the data show ({doubt} along it)"
    return f"{', '.join(names)} are seen only in combination: {what}"


def choose_error_shape(
    shapes: Sequence[tuple[float, float]], tried: Callable[[float, float], tuple[Array, float]]
) -> tuple[Array, str]:
    """Return the likeliest shape of errors, not yet scaled, and what it is in words.

    Parameters
    ----------
    shapes : sequence of (% of reading, % of full scale)
        The first holds unless another is clearly likelier.
    tried : callable
        From a shape to expected errors and minus twice the logarithm of the data's likelihood with them.
    """
    best, shape, least = np.empty(0), shapes[0], np.inf
    for k, one in enumerate(shapes):
        std, minus_log = tried(*one)
        minus_log -= 0.0 if k else _DECISIVE_LIKELIHOOD_DIFFERENCE
        if minus_log < least:
            best, shape, least = std, one, minus_log
    parts = zip(shape, ("the reading", "full scale"), strict=True)
    return best, " and ".join(f"{v:g} % of {what}" for v, what in parts if v)
