"""Equation-error regression of each output's derivative on outputs and inputs, with stepwise choice of terms.

The method suits vehicles flown under feedback. There a controller cancels the effect of the inputs, a small model
error grows over a simulated record, and output error has no clear minimum. The regression uses each instant
separately, has no local minima and needs neither initial states nor a stable model. Its disadvantage: noise in the
measured outputs, which are regressors, biases their coefficients towards zero (Klein and Morelli, *Aircraft System
Identification*, 2nd ed., Sec. 5.2).

    y_i' = b_i + sum_j theta_ij phi_j,      phi_j: an output, an input delayed by tau_i, or a product of two

**Two domains.** *time*: all terms pass the same low-pass. The derivative is a six-point central difference of the
low-passed output, exact to 1e-3 below a tenth of the sample rate. Samples within 1 / cut of the ends are omitted.
*frequency*: the equation is multiplied by ``w(t) exp(-j omega t)`` with a Hann window ``w`` over the record and
integrated by parts, ``int w y' e = -int (w' - j omega w) y e``. Neither derivatives nor end values are needed
(modulating functions: Shinbrot 1957; the regression is that of Klein and Morelli, Sec. 7.3). Frequencies run from
1.5 / T to the cut in steps of 1 / T. The rows are weighted by the inverse residual spectrum, a parabola through its
logarithm. The frequency domain is the default. On simulated flights under feedback with gusts it is unbiased and has
half the scatter of the time domain (numbers: docs/log/2026-11-21-linear-model-of-a-trex-550.md).

**Band.** Content below ``low_hz`` is removed, too. :func:`find_coherent_band` finds both ends from the fitted records.

**Stepwise** (Klein and Morelli, Sec. 5.4): of the remaining candidates, the term with the largest partial correlation
is added if its partial ``F = (theta / std)^2`` exceeds ``F_in`` and the predicted square error decreases. Then terms
whose ``F`` is below ``F_in`` are removed. The search ends when nothing changes.

    PSE = MSE + s_max^2 p / N,      s_max^2 = variance of the response      (Barron 1984; Klein and Morelli, Sec. 5.4)

Two numbers differ from the book's, because filtered samples are not independent: ``std`` comes from
:func:`mufly.identify.fit_result.coloured_covariance`, and ``N = 2 (cut - low) T`` is the number of independent samples
in a band of that width. With a correct standard deviation ``F_in`` need not be 20: it is the value that the largest
``F`` of all candidates exceeds by chance in 5 % of cases.

**Actuators.** In each equation the inputs act through one lag and one delay, ``T u_f' + u_f = u(t - tau)``. Without
them the estimated gain is several times too small. Lag and delay are the best of a grid with all linear terms, and are
then refined with the chosen terms by Gauss-Newton (their derivatives are further columns). The refinement propagates
their uncertainty to the other standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter, savgol_filter
from scipy.stats import chi2

from mufly.errors import InputError
from mufly.identify.fit_result import coloured_covariance
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.frequency_response import estimate_frequency_response
from mufly.identify.linear.linear_structure import SIGNAL_UNITS, delay_inputs
from mufly.results import result

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
REGRESSION_DOMAINS = ("time", "frequency")
_DERIVATIVE_LETTERS = {"p": "L", "q": "M", "r": "N", "u": "X", "v": "Y", "w": "Z"}
_BODY_RATES = ("p", "q", "r")
_TERM_ENTRY_SIGNIFICANCE = 0.05
_MAX_STEPWISE_STEPS = 40  # bound on a stepwise search, against cycles
_MIN_INPUT_COHERENCE = 0.5
_MAX_ACTUATOR_ITERATIONS = 20  # iterations of the refinement of lag and delay
RegressorFunction = Callable[[Sequence[tuple[str, ...]], Array], list[Array]]  # (terms, (lag, delay)) -> rows by record
BiasRemover = Callable[[Sequence[Array]], list[Array]]  # removes the bias of each record from rows


@dataclass(frozen=True, eq=False)
class RegressionRecord:
    """One record of outputs and inputs for the regression.

    Attributes
    ----------
    name : str
    role : str
        ``"fit"`` or ``"held out"``.
    time_s : (n,) array
    outputs : (n, outputs) array
        Measured outputs (SI).
    inputs : (n, inputs) array
        Recorded inputs, in the unit of the log.
    """

    name: str
    role: str
    time_s: Array
    outputs: Array
    inputs: Array

    @property
    def dt(self) -> float:
        """Sample time (s)."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))


@result
class StepwiseStep:
    """Step of the stepwise choice of terms.

    Attributes
    ----------
    term : str
        Term, with prefix ``+`` if added or ``-`` if removed.
    F : float
        Partial F of the term.
    R2 : float
        Explained share of the response's variance after the step.
    PSE : float
        Predicted square error over the variance of the response.
    """

    term: str
    F: float
    R2: float
    PSE: float


@result(
    eq=False,
    json="output terms=term_names value std std_white covariance lag_s delay_s lag_std_s delay_std_s bias band_hz F_in "
    "steps R2 symbols=coefficient_symbols units=coefficient_units",
)
class DerivativeEquation:
    """Fitted equation of one output's derivative: terms, coefficients, lag and delay.

    Attributes
    ----------
    output : str
    terms : tuple of tuple of str
        Terms in the order of addition, each the tuple of signals of a product.
    value, std, std_white : (t,) array
        Coefficients; standard deviations corrected for coloured residuals, and for white residuals.
    covariance : (t, t) array
        Corrected covariance of the coefficients.
    lag_s, delay_s : float
        Time constant and dead time of the inputs.
    lag_std_s, delay_std_s : float
        Standard deviations; NaN at the end of the range, or without inputs.
    bias : (records,) array
        Bias of each fitted record.
    band_hz : (float, float)
        Frequency band of the regression.
    F_in : float
        Least partial F of a term.
    steps : tuple of StepwiseStep
    R2 : float
        Explained share of the derivative's variance in the fitted records.
    """

    output: str
    terms: tuple[tuple[str, ...], ...]
    value: Array
    std: Array
    std_white: Array
    covariance: Array
    lag_s: float
    delay_s: float
    lag_std_s: float
    delay_std_s: float
    bias: Array
    band_hz: tuple[float, float]
    F_in: float
    steps: tuple[StepwiseStep, ...]
    R2: float

    @property
    def term_names(self) -> list[str]:
        """Return the terms as text: ``p``, ``p*q``."""
        return ["*".join(term) for term in self.terms]

    @property
    def coefficient_symbols(self) -> tuple[str, ...]:
        """Return the symbols of the coefficients: ``L_p``, ``M_lon``, ``N_p*q``."""
        return tuple(coefficient_symbol(self.output, t) for t in self.terms)

    @property
    def coefficient_units(self) -> tuple[str, ...]:
        """Return the units of the coefficients."""
        return tuple(_coefficient_unit(self.output, t) for t in self.terms)


def coefficient_symbol(output: str, term: tuple[str, ...]) -> str:
    """Return the symbol of a term in the equation of an output: ``L_p``, ``M_lon``, ``N_p*q``."""
    return f"{_DERIVATIVE_LETTERS.get(output, output)}_{'*'.join(term)}"


def _coefficient_unit(output: str, term: tuple[str, ...]) -> str:
    below = [SIGNAL_UNITS[t] for t in term if t in SIGNAL_UNITS]
    own = (
        SIGNAL_UNITS.get(output, "1").replace("/s", "/s^2")
        if "/s" in SIGNAL_UNITS.get(output, "")
        else SIGNAL_UNITS.get(output, "1") + "/s"
    )
    if below == [SIGNAL_UNITS.get(output)]:
        return "1/s"
    return own if not below else f"{own} per {' '.join(below)}"


def regress_rate_derivatives(
    rates: Array, u: Array, dt: float, *, rate_names: tuple[str, ...], input_names: tuple[str, ...], cut_hz: float
) -> dict[str, tuple[float, float]]:  # fmt: skip
    """Return the regression of each rate's derivative on all rates and inputs, without delay, to check another fit.

    Parameters
    ----------
    rates, u : (n, k), (n, m) array
        Body rates (rad/s), and inputs in the unit of the log.
    dt : float
    rate_names, input_names : tuple of str
        ``("p", "q")``, ``("lat", "lon")``; p, q, r give symbols L_, M_, N_.
    cut_hz : float
        Cut-off of the low-pass that filters all signals first (Hz).

    Returns
    -------
    dict of symbol to (value, standard deviation)
        ``{"L_p": (-3.1, 0.2), "L_lat": ...}``; the deviations are corrected for coloured residuals.
    """
    used = u.std(axis=0) > 0.0
    names = rate_names + tuple(n for n, k in zip(input_names, used, strict=True) if k)
    smooth = low_pass(np.column_stack([rates, u[:, used]]), dt, cut_hz)
    slope = np.gradient(smooth[:, : rates.shape[1]], dt, axis=0)
    rows = np.column_stack([smooth, np.ones(len(smooth))])
    found = {}
    for j, rate in enumerate(rate_names):
        theta, cov, _ = _least_squares([rows[:, None, :]], [slope[:, [j]]])
        for k, name in enumerate(names):
            found[f"{_DERIVATIVE_LETTERS.get(rate, rate)}_{name}"] = (
                float(theta[k]),
                float(np.sqrt(cov[k, k])),
            )
    return found


def _least_squares(rows: Sequence[Array], right: Sequence[Array]) -> tuple[Array, Array, Array]:
    """Solve a least-squares problem over records, with rows (n, m, t) and right sides (n, m).

    Return values, their covariance for coloured residuals, and the bound for white residuals.
    """
    t = rows[0].shape[2]
    stacked, z = np.concatenate([r.reshape(-1, t) for r in rows]), np.concatenate([b.ravel() for b in right])
    size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    theta = np.linalg.lstsq(stacked / size, z, rcond=None)[0] / size
    left = [b - r @ theta for r, b in zip(rows, right, strict=True)]
    spread = float(np.sqrt(np.mean(np.concatenate([e.ravel() for e in left]) ** 2)))
    spread = max(spread, 1e-12 * float(np.sqrt(np.mean(z**2))), 1e-300)
    cov, bound, _ = coloured_covariance([r / spread for r in rows], [e / spread for e in left])
    return theta, cov, bound


class _RegressionRows:
    """Regression rows of candidate terms for every record, computed for a given lag and delay of the inputs."""

    def __init__(
        self, records: Sequence[RegressionRecord], outputs: tuple[str, ...], inputs: tuple[str, ...], domain: str,
        cut_hz: float, low_hz: float,
    ) -> None:  # fmt: skip
        self.records, self.outputs, self.inputs = records, outputs, inputs
        self.domain, self.cut_hz, self.low_hz = domain, cut_hz, low_hz
        self._fourier_kernels: dict[str, tuple[ComplexArray, ComplexArray]] = {}

    def transform_signal(self, r: RegressionRecord, signal: Array) -> Array:
        """Return a signal (n, k) in the regression domain: low-passed (n', 1, k), or real and imaginary spectrum (f,
        2, k).
        """
        if self.domain == "time":
            return self._trim_edges(r, self._band_pass(r, signal))[:, None, :]
        return _real_and_imaginary(self._fourier_kernel(r)[0] @ signal)

    def transform_derivative(self, r: RegressionRecord, signal: Array) -> Array:
        """Return the derivative of a signal (n, k) in the regression domain."""
        if self.domain == "time":
            smooth = self._band_pass(r, signal)
            width = 7 if len(smooth) >= 7 else 3
            slope = savgol_filter(smooth, width, width - 1, deriv=1, delta=r.dt, axis=0)
            return self._trim_edges(r, np.asarray(slope))[:, None, :]
        return _real_and_imaginary(self._fourier_kernel(r)[1] @ signal)

    def _band_pass(self, r: RegressionRecord, signal: Array) -> Array:
        smooth = low_pass(signal, r.dt, self.cut_hz)
        return smooth - low_pass(smooth, r.dt, self.low_hz) if self.low_hz > 0.0 else smooth

    def _trim_edges(self, r: RegressionRecord, signal: Array) -> Array:
        edge = min(round(1.0 / (self.cut_hz * r.dt)), len(signal) // 10)
        return signal[edge : len(signal) - edge]

    def _fourier_kernel(self, r: RegressionRecord) -> tuple[ComplexArray, ComplexArray]:
        """Return matrices (f, n) that give the windowed Fourier integrals of a signal and, by parts, of its
        derivative.
        """
        if r.name in self._fourier_kernels:
            return self._fourier_kernels[r.name]
        n, dt = len(r.time_s), r.dt
        length = (n - 1) * dt
        f = np.arange(max(1.5, self.low_hz * length), self.cut_hz * length) / length
        t = dt * np.arange(n)
        wave = np.exp(-2j * np.pi * f[:, None] * t) * (dt / np.sqrt(length))
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / length)
        slope = np.pi / length * np.sin(2.0 * np.pi * t / length)
        self._fourier_kernels[r.name] = made = (
            wave * window,
            wave * (2j * np.pi * f[:, None] * window - slope),
        )
        return made

    def evaluate_term(self, r: RegressionRecord, term: tuple[str, ...], acted: Array) -> Array:
        """Return the product (n,) of a term's signals; ``acted`` holds the inputs after lag and delay."""
        product = np.ones(len(r.time_s))
        for name in term:
            from_y = name in self.outputs
            product = product * (
                r.outputs[:, self.outputs.index(name)] if from_y else acted[:, self.inputs.index(name)]
            )
        return product


def apply_actuator(u: Array, lag_s: float, delay_s: float, dt: float) -> Array:
    """Return inputs (n, k) after a first-order lag and a delay; they are linear between samples, constant before the
    record.
    """
    late = delay_inputs(u, np.full(u.shape[1], delay_s), dt)
    if lag_s <= 0.0:
        return late
    a = float(np.exp(-dt / lag_s))
    rising = 1.0 - (1.0 - a) * lag_s / dt  # weight of the new sample; a + rising + falling = 1
    falling = (1.0 - a) - rising
    moved, _ = lfilter([rising, falling], [1.0, -a], late - late[0], axis=0, zi=np.zeros((1, u.shape[1])))
    return np.asarray(moved + late[0], dtype=np.float64)


def _real_and_imaginary(spectrum: ComplexArray) -> Array:
    return np.stack([spectrum.real, spectrum.imag], axis=1)


def candidate_terms(
    inputs: Sequence[str], outputs: Sequence[str], *, products: bool = False
) -> tuple[tuple[str, ...], ...]:
    """Return the candidate terms: every output and input, and with ``products`` all products of two rates.

    Products of rates are the gyroscopic terms of Euler's equations, ``q r (I_yy - I_zz) / I_xx`` and the like.
    """
    single = tuple((n,) for n in (*outputs, *inputs))
    rates = [o for o in outputs if o in _BODY_RATES]
    return single + (tuple(combinations(rates, 2)) if products else ())


def fit_derivative_equation(
    records: Sequence[RegressionRecord], output: str, outputs: tuple[str, ...], inputs: tuple[str, ...],
    candidates: Sequence[tuple[str, ...]], *, domain: str = "frequency", cut_hz: float = 5.0,
    low_hz: float = 0.0, most_s: float = 0.2, fixed: bool = False,
) -> DerivativeEquation:  # fmt: skip
    """Fit the equation of one output's derivative.

    Parameters
    ----------
    records : sequence of RegressionRecord
        Records; only those with the role ``"fit"`` are used.
    output : str
    outputs, inputs : tuple of str
        Names of the records' columns.
    candidates : sequence of tuple of str
        Candidate terms.
    domain : {"time", "frequency"}
    cut_hz, low_hz : float
        Upper and lower end of the band.
    most_s : float
        Upper end of the range of lag and delay (s); 0 for neither.
    fixed : bool
        Use all candidates without choice.

    Raises
    ------
    InputError
        If the output is constant.
    """
    used = [r for r in records if r.role == "fit"]
    at = _RegressionRows(used, outputs, inputs, domain, cut_hz, low_hz)
    k = outputs.index(output)
    response = [at.transform_derivative(r, r.outputs[:, [k]])[:, :, 0] for r in used]
    # The constant 1 in the regression domain, the regressor of a record's bias.
    constants = [at.transform_signal(r, np.ones((len(r.time_s), 1)))[:, :, 0] for r in used]
    effective = sum(2.0 * (cut_hz - low_hz) * (r.time_s[-1] - r.time_s[0]) for r in used)
    plain = _remove_bias(constants, response)
    variance = float(np.mean(np.concatenate([b.ravel() for b in plain]) ** 2))
    if variance <= 0.0:
        raise InputError("record", output, "never moves", "give a record in which it does")

    def regression_columns(terms: Sequence[tuple[str, ...]], actuator: Array) -> list[Array]:
        acted = [apply_actuator(r.inputs, float(actuator[0]), float(actuator[1]), r.dt) for r in used]
        return [
            at.transform_signal(r, np.column_stack([at.evaluate_term(r, t, u) for t in terms])) if terms
            else np.zeros((*b.shape, 0))
            for r, b, u in zip(used, response, acted, strict=True)
        ]  # fmt: skip

    def remove_biases(blocks: Sequence[Array]) -> list[Array]:
        return [_project_out(c, b) for c, b in zip(constants, blocks, strict=True)]

    linear = [t for t in candidates if len(t) == 1]
    driven = any(set(t) & set(inputs) for t in candidates)
    actuator = np.zeros(2)
    if driven and most_s > 0.0:
        actuator = _search_actuator_grid(linear, regression_columns, remove_biases, plain, most_s, used[0].dt)
    weights = [np.ones(b.shape[0]) for b in response]
    pool = remove_biases(regression_columns(candidates, actuator))
    chosen: list[int] = []
    steps: list[StepwiseStep] = []
    f_in = float(chi2.isf(_TERM_ENTRY_SIGNIFICANCE / max(len(candidates), 1), 1))
    for _ in range(2 if domain == "frequency" else 1):
        weighted = [p * w[:, None, None] for p, w in zip(pool, weights, strict=True)]
        right = [b * w[:, None] for b, w in zip(plain, weights, strict=True)]
        if fixed:
            chosen, steps = list(range(len(candidates))), []
        else:
            chosen, steps = _select_terms_stepwise(weighted, right, candidates, f_in, effective)
        theta = _least_squares([p[:, :, chosen] for p in weighted], right)[0] if chosen else np.zeros(0)
        left = [b - p[:, :, chosen] @ theta for p, b in zip(pool, plain, strict=True)]
        if domain == "frequency":
            weights = _whitening_weights(left)
    terms = [candidates[j] for j in chosen]
    driven = any(set(t) & set(inputs) for t in terms)
    value, cov, bound, actuator, doubt = _fit_coefficients_and_actuator(
        regression_columns,
        remove_biases,
        plain,
        weights,
        terms,
        actuator,
        most_s if driven else 0.0,
        used[0].dt,
    )
    whole = regression_columns(terms, actuator)
    missed = [b - p @ value for p, b in zip(whole, response, strict=True)]
    bias = np.array([_compute_record_bias(r, at, k, terms, value, actuator) for r in used])
    left = _remove_bias(constants, missed)
    explained = 1.0 - float(np.mean(np.concatenate([e.ravel() for e in left]) ** 2)) / variance
    return DerivativeEquation(
        output, tuple(terms), value, np.sqrt(np.diag(cov)), np.sqrt(np.diag(bound)), cov,
        float(actuator[0]), float(actuator[1]), float(doubt[0]), float(doubt[1]), bias,
        (low_hz, cut_hz), f_in, tuple(steps), explained,
    )  # fmt: skip


def _compute_record_bias(
    r: RegressionRecord,
    at: _RegressionRows,
    k: int,
    terms: Sequence[tuple[str, ...]],
    value: Array,
    actuator: Array,
) -> float:
    """Return the bias of an output's derivative in a record: its mean less the mean of the fitted terms."""
    acted = apply_actuator(r.inputs, float(actuator[0]), float(actuator[1]), r.dt)
    length = float(r.time_s[-1] - r.time_s[0])
    told = sum(v * float(at.evaluate_term(r, t, acted).mean()) for v, t in zip(value.tolist(), terms, strict=True))
    return float(r.outputs[-1, k] - r.outputs[0, k]) / length - told


def find_coherent_band(records: Sequence[RegressionRecord], k: int, cut_hz: float) -> tuple[float, float]:
    """Return the band (Hz), the widest on a logarithmic scale, in which the inputs explain at least half of an output.

    Below the band, trims drift and the controller's response to disturbances dominates; above it, noise dominates.
    The criterion is the multiple coherence of the fitted records less its chance level. If it is nowhere sufficient,
    the whole band is returned.

    Parameters
    ----------
    records : sequence of RegressionRecord
    k : int
        Index of the output.
    cut_hz : float
        Upper limit of the band.
    """
    used = [r for r in records if r.role == "fit"]
    shortest = min(float(r.time_s[-1] - r.time_s[0]) for r in used)
    segment = float(np.clip(shortest / 6.0, 10.0 / cut_hz, 8.0))
    if 3.0 / segment > cut_hz or segment > shortest:
        return 0.0, cut_hz
    moving = np.concatenate([r.inputs - r.inputs.mean(0) for r in used]).std(axis=0) > 0.0
    data = estimate_frequency_response(
        [r.inputs[:, moving] for r in used], [r.outputs[:, [k]] for r in used], used[0].dt, segment_s=segment,
        frequency_hz=np.geomspace(1.5 / segment, cut_hz, 40),
    )  # fmt: skip
    chance = min(0.9, float(moving.sum()) / max(data.averages, 1.0))
    good = (data.coherence[:, 0] - chance) / (1.0 - chance) >= _MIN_INPUT_COHERENCE
    edges = np.flatnonzero(np.diff(np.r_[False, good, False].astype(int)))
    if not edges.size:
        return 0.0, cut_hz
    start, stop = max(edges.reshape(-1, 2).tolist(), key=lambda ab: ab[1] - ab[0])
    low, high = data.frequency_hz[start], data.frequency_hz[stop - 1]
    # If the coherence reaches down to the lowest frequency, there is no drift and the band starts at zero.
    return (0.0 if start == 0 else float(low)), float(max(high, min(cut_hz, 2.0 * low)))


def _project_out(constant: Array, block: Array) -> Array:
    """Subtract from each column of a block (n, m, t) its projection on ``constant`` (n, m)."""
    share = np.einsum("nm,nmt->t", constant, block) / max(float((constant**2).sum()), 1e-300)
    return block - constant[:, :, None] * share


def _remove_bias(constants: Sequence[Array], blocks: Sequence[Array]) -> list[Array]:
    return [_project_out(c, b[:, :, None])[:, :, 0] for c, b in zip(constants, blocks, strict=True)]


def _whitening_weights(left: Sequence[Array]) -> list[Array]:
    """Return weights that whiten residuals: the inverse of their spectrum, smoothed by a parabola of its logarithm."""
    weights = []
    for e in left:
        power = np.log(np.maximum((e**2).sum(1), 1e-300))
        x = np.linspace(-1.0, 1.0, len(power))
        weights.append(np.exp(-0.5 * np.polyval(np.polyfit(x, power, min(2, len(power) - 1)), x)))
    scale = np.sqrt(np.mean(np.concatenate(weights) ** 2))
    return [w / scale for w in weights]


def _search_actuator_grid(
    terms: Sequence[tuple[str, ...]],
    columns: RegressorFunction,
    cleared: BiasRemover,
    plain: Sequence[Array],
    most: float,
    dt: float,
) -> Array:
    """Return the lag and delay (s), from a grid of both, with which ``terms`` leave the smallest residual.

    ``columns`` computes the terms' rows, ``cleared`` removes biases from rows, ``plain`` is the response without.
    """
    z = np.concatenate([b.ravel() for b in plain])
    best, least = np.zeros(2), np.inf
    for lag in most * np.array([0.0, 0.1, 0.2, 0.35, 0.55, 0.8]):
        for delay in np.arange(0.0, 0.5 * most + 1e-9, max(dt, most / 12.0)):
            at = np.array([lag, delay])
            rows = np.concatenate([p.reshape(-1, len(terms)) for p in cleared(columns(terms, at))])
            gram = rows.T @ rows
            scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
            inverse = np.linalg.pinv(gram * np.outer(scale, scale), rcond=1e-10, hermitian=True) * np.outer(
                scale, scale
            )
            right = rows.T @ z
            cost = float(z @ z - right @ inverse @ right)
            if cost < least:
                best, least = at, cost
    return best


def _select_terms_stepwise(
    pool: Sequence[Array], right: Sequence[Array], candidates: Sequence[tuple[str, ...]], f_in: float, effective: float
) -> tuple[list[int], list[StepwiseStep]]:  # fmt: skip
    t = pool[0].shape[2]
    rows, z = np.concatenate([p.reshape(-1, t) for p in pool]), np.concatenate([b.ravel() for b in right])
    total = float(z @ z)

    def regress_terms(terms: list[int]) -> tuple[Array, Array, Array]:
        theta, cov, _ = _least_squares([p[:, :, terms] for p in pool], right)
        return theta, np.diag(cov), z - rows[:, terms] @ theta

    def predicted_squared_error(left: Array, count: int) -> float:
        return float(left @ left) / total + count / effective

    chosen: list[int] = []
    steps: list[StepwiseStep] = []
    left = z
    seen: set[frozenset[int]] = {frozenset()}
    for _ in range(_MAX_STEPWISE_STEPS):
        new = [j for j in range(t) if j not in chosen]
        basis = np.linalg.qr(rows[:, chosen])[0] if chosen else np.zeros((len(z), 0))
        free = rows[:, new] - basis @ (basis.T @ rows[:, new])
        size = np.linalg.norm(free, axis=0)
        partial = np.abs(free.T @ left) / np.maximum(size * np.linalg.norm(left), 1e-300)
        partial[size < 1e-8 * np.linalg.norm(rows[:, new], axis=0)] = 0.0
        moved = False
        for place in np.argsort(-partial):
            trial = [*chosen, new[place]]
            if partial[place] <= 0.0 or frozenset(trial) in seen:
                continue
            theta, variance, rest = regress_terms(trial)
            f = float(theta[-1] ** 2 / max(variance[-1], 1e-300))
            if f >= f_in and predicted_squared_error(rest, len(trial)) < predicted_squared_error(left, len(chosen)):
                chosen, left, moved = trial, rest, True
                seen.add(frozenset(chosen))
                steps.append(
                    StepwiseStep(
                        f"+{'*'.join(candidates[new[place]])}",
                        f,
                        1.0 - float(rest @ rest) / total,
                        predicted_squared_error(rest, len(trial)),
                    )
                )
                break
        if not moved:
            break
        while len(chosen) > 1:
            theta, variance, _ = regress_terms(chosen)
            strength = theta**2 / np.maximum(variance, 1e-300)
            weakest = int(np.argmin(strength))
            if strength[weakest] >= f_in:
                break
            out = chosen.pop(weakest)
            left = regress_terms(chosen)[2]
            seen.add(frozenset(chosen))
            steps.append(
                StepwiseStep(
                    f"-{'*'.join(candidates[out])}",
                    float(strength[weakest]),
                    1.0 - float(left @ left) / total,
                    predicted_squared_error(left, len(chosen)),
                )
            )
    return chosen, steps


def _fit_coefficients_and_actuator(
    columns: RegressorFunction, cleared: BiasRemover, plain: Sequence[Array], weights: Sequence[Array],
    terms: Sequence[tuple[str, ...]], actuator: Array, most: float, dt: float,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Fit the coefficients of an equation, and its lag and delay unless ``most`` is 0.

    Return values, covariance and bound of the coefficients, (lag, delay), and the deviations of both.
    """
    right = [b * w[:, None] for b, w in zip(plain, weights, strict=True)]

    def weighted_rows(at: Array) -> list[Array]:
        return [p * w[:, None, None] for p, w in zip(cleared(columns(terms, at)), weights, strict=True)]

    doubt = np.full(2, np.nan)
    if not terms:
        return np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)), actuator, doubt
    free = np.array([True, True])
    for _ in range(_MAX_ACTUATOR_ITERATIONS if most else 0):
        rows = weighted_rows(actuator)
        theta = _least_squares(rows, right)[0]
        columns_of: list[list[Array]] = []
        for j in np.flatnonzero(free):
            late, early = actuator.copy(), actuator.copy()
            late[j], early[j] = actuator[j] + 0.25 * dt, max(actuator[j] - 0.25 * dt, 0.0)
            sides = zip(weighted_rows(late), weighted_rows(early), strict=True)
            columns_of.append([((a - b) @ theta / (late[j] - early[j]))[:, :, None] for a, b in sides])
        both = [np.concatenate([r, *(c[k] for c in columns_of)], axis=2) for k, r in enumerate(rows)]
        found, cov, bound = _least_squares(both, right)
        new, t = actuator.copy(), len(terms)
        new[free] = np.clip(actuator[free] + np.clip(found[t:], -2.0 * dt, 2.0 * dt), 0.0, most)
        rest = bool((np.abs(new - actuator) < 0.01 * dt).all())
        ended = free & ((new == 0.0) | (new == most)) & (new == actuator)
        actuator = new
        if ended.any():
            free = free & ~ended  # a value at the end of its range is held
            if not free.any():
                break
        elif rest:
            doubt[free] = np.sqrt(np.diag(cov)[t:])
            return found[:t], cov[:t, :t], bound[:t, :t], actuator, doubt
    return *_least_squares(weighted_rows(actuator), right), actuator, doubt
