"""What a linear identification returns: the fitted model, and how it did on what it had not seen."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from mufly.errors import InputError
from mufly.identify.covariance import coloured_covariance, parzen
from mufly.identify.linear.structure import Structure, responses, simulate_linear
from mufly.identify.residuals import Quality, autocorrelation
from mufly.identify.result import Fit

if TYPE_CHECKING:
    from mufly.identify.linear.check import CrossValidation, Disturbance, NoiseFloor, Subspace
    from mufly.identify.linear.frequency import SpectralFit

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fitted linear model.

    Attributes
    ----------
    structure : Structure
    values, start : (p,) array
        Parameters, fitted and where the best search began.
    covariance, bound : (p, p) array
        Corrected for coloured residuals; Cramer-Rao bound for white ones.
    at_bound : (p,) array of bool
    x0 : (states,) array
    input_trim : (inputs,) array
    output_bias : (outputs,) array
    weight : (outputs,) array
        Inverse variance of the residuals.
    log_likelihood : float
        Of Gaussian residuals, white.
    effective_samples : float
        Independent residuals, from their autocorrelation.
    history : tuple of dict
    costs : tuple of float
        Of every start, ascending.
    simulations : int
    seconds : float
    converged : bool
    message : str
    hold : bool
        Inputs held between samples.
    """

    structure: Structure
    values: Array
    start: Array
    covariance: Array
    bound: Array
    at_bound: NDArray[np.bool_]
    x0: Array
    input_trim: Array
    output_bias: Array
    weight: Array
    log_likelihood: float
    effective_samples: float
    history: tuple[dict[str, Any], ...]
    costs: tuple[float, ...]
    simulations: int
    seconds: float
    converged: bool
    message: str
    hold: bool

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Eigenvalues of A (rad/s), slowest first."""
        a = self.structure.matrices(self.values)[0]
        e = np.linalg.eigvals(a)
        return np.asarray(e[np.argsort(np.abs(e))], dtype=np.complex128)

    def criterion(self, kind: str = "bic") -> float:
        """Return Akaike's ("aic") or Schwarz's ("bic") criterion, in effective samples; smaller is better."""
        free = self.values.size + self.x0.size + self.input_trim.size + self.output_bias.size
        n = self.effective_samples
        per_sample = -2.0 * self.log_likelihood  # per sample, summed over outputs
        return n * per_sample + free * (2.0 if kind == "aic" else float(np.log(max(n, 2.0))))


@dataclass(frozen=True)
class Ahead:
    """Prediction a time ahead on the held-out part, of every output.

    ``horizon_s`` is infinite for the pure simulation. ``fit_percent`` is against the measurement as recorded,
    ``fit_percent_slow`` against both low-passed at ``LinearResult.slow_hz``, ``persistence_percent`` what the last
    measured value would reach, causally low-passed (NaN for the simulation).
    """

    horizon_s: float
    fit_percent: tuple[float, ...]
    fit_percent_slow: tuple[float, ...]
    rms_over_noise: tuple[float, ...]
    persistence_percent: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LinearResult:
    """A linear identification.

    Attributes
    ----------
    fit : Fit
        As a report wants it, with the fitted and the held-out part.
    linear : LinearFit
        The model itself.
    candidates : tuple of CrossValidation
        Structures tried, best first; empty if one was asked for.
    floors : dict of role to tuple of NoiseFloor
        Of every output, from that part.
    disturbance : Disturbance
    ahead : tuple of Ahead
        Empty without held-out part.
    quality, quality_slow : dict of role to tuple of Quality
        Of the simulation, against the record and against both low-passed at ``slow_hz``.
    ceiling, ceiling_slow : dict of role to tuple of float
        Fit (per cent) of a model whose error is the noise floor alone, as recorded and below ``slow_hz``; the latter is
        NaN where no angle was measured beside a rate.
    against_angle : dict of role to tuple of float
        Fit (per cent) below ``slow_hz`` against the derivative of the measured angle instead of the gyro; NaN without.
    slow_hz : float
    missing : tuple of str
        What the residuals of the fitted part show.
    equation_error : dict of symbol to (value, std)
        Cross-check; empty where no rate was measured.
    subspace : Subspace or None
        Cross-check of the same number of states, fitted to the same samples.
    subspace_percent : tuple of float
        Its pure simulation on the held-out part, low-passed.
    spectral : SpectralFit or None
        Cross-check: fitted to frequency responses; None where too little is coherent.
    notes : tuple of str
        About the record.
    """

    fit: Fit
    linear: LinearFit
    candidates: tuple[CrossValidation, ...]
    floors: Mapping[str, tuple[NoiseFloor, ...]]
    disturbance: Disturbance
    ahead: tuple[Ahead, ...]
    quality: Mapping[str, tuple[Quality, ...]]
    quality_slow: Mapping[str, tuple[Quality, ...]]
    ceiling: Mapping[str, tuple[float, ...]]
    ceiling_slow: Mapping[str, tuple[float, ...]]
    against_angle: Mapping[str, tuple[float, ...]]
    slow_hz: float
    missing: tuple[str, ...]
    equation_error: Mapping[str, tuple[float, float]]
    subspace: Subspace | None
    subspace_percent: tuple[float, ...]
    spectral: SpectralFit | None
    notes: tuple[str, ...]


# ----------------------------------------------------------------------------
# Output-error fit of a linear model: Gauss-Newton in a trust region, several starts, the whole record in one piece.
#
# The prediction is a pure simulation from the inputs. Its residuals are weighted by the inverse of their own
# variance,
# which is re-estimated until it stands still: the maximum-likelihood estimate for unknown noise (Maine and Iliff
# 1985,
# NASA RP-1138; Jategaonkar, ch. 4). Initial state, trim of the inputs and bias of the outputs enter linearly and are
# eliminated exactly at every step (variable projection), so the search has only the parameters of the dynamics, and
# their covariance counts what those unknowns cost. A mask leaves out samples for cross-validation while the
# simulation
# runs through them.


_ROUNDS = 3


class _Problem:
    """Residual of the parameters in search coordinates, with the linear unknowns eliminated."""

    def __init__(
        self, structure: Structure, u: Array, y: Array, dt: float, hold: bool, mask: Array | None
    ) -> None:
        self.structure, self.u, self.y, self.dt, self.hold = structure, u, y, dt, hold
        self.good = np.isfinite(y) & (np.ones(len(y), dtype=bool) if mask is None else mask)[:, None]
        self.weight = np.ones(y.shape[1])
        self.simulations = 0
        p = structure.parameters
        self.low, self.high = np.array([q.low for q in p]), np.array([q.high for q in p])
        self.log = self.low > 0.0
        start = np.array([q.start for q in p])
        self.scale = np.where(self.log, 1.0, np.maximum(np.abs(start), 0.02 * (self.high - self.low)))

    def coordinates(self, values: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.log, np.log(np.where(self.log, values, 1.0)), values / self.scale)

    def values(self, z: Array) -> Array:
        return np.clip(
            np.where(self.log, np.exp(np.where(self.log, z, 0.0)), z * self.scale), self.low, self.high
        )

    def predict(self, values: Array) -> tuple[Array, Array, Array] | None:
        """Prediction without linear unknowns, what one unit of each adds, and their estimate; None on overflow."""
        self.simulations += 1
        try:
            with np.errstate(over="raise", invalid="raise"):
                forced, _ = simulate_linear(self.structure, values, self.u, self.dt, hold=self.hold)
                added = responses(self.structure, values, len(self.u), self.dt)
                root = np.sqrt(self.weight)
                weighted = added * root[None, :, None]
                # Sizes over all samples: what acts only where the mask is then counts as unseen and stays zero.
                size = np.sqrt(np.maximum(np.einsum("nmj,nmj->j", weighted, weighted), 1e-300))
                rows, right = weighted[self.good], ((self.y - forced) * root)[self.good]
        except FloatingPointError:
            return None
        if not (np.isfinite(size).all() and size.max() < 1e12):
            return None
        rows /= size
        # Normal equations: a hundred rows a column are many times faster so, and columns of unit length lose little.
        inverse = np.linalg.pinv(rows.T @ rows, rcond=1e-11, hermitian=True)
        return forced, added, inverse @ (rows.T @ right) / size

    def residual(self, z: Array) -> Array:
        got = self.predict(self.values(z))
        if got is None:
            return np.full(int(self.good.sum()), 1e6)
        forced, added, linear = got
        return ((self.y - forced - added @ linear) * np.sqrt(self.weight))[self.good]

    def jacobian(self, z: Array, base: Array | None = None) -> Array:
        base = self.residual(z) if base is None else base
        columns = np.empty((base.size, z.size))
        for k in range(z.size):
            step = 1e-5 * max(1.0, abs(z[k]))
            moved = z.copy()
            moved[k] += step
            if self.values(moved)[k] == self.values(z)[k]:
                step = -step
                moved[k] = z[k] + step
            columns[:, k] = (self.residual(moved) - base) / step
        return columns


def fit_linear(
    structure: Structure, u: Array, y: Array, dt: float, *, starts: int = 8, seed: int = 0, hold: bool = False,
    mask: Array | None = None, first: Array | None = None, progress: Callable[[int, int], None] | None = None,
    covariance: bool = True,
) -> LinearFit:  # fmt: skip
    """Fit a linear model to one record.

    Parameters
    ----------
    structure : Structure
    u : (n, inputs) array
        As recorded; trims are estimated.
    y : (n, outputs) array
        NaN where nothing was measured.
    dt : float
        Sample time (s).
    starts : int
        Searches, from the structure's start and from random ones between the bounds.
    seed : int
        Of the random starts.
    hold : bool
        Inputs are held between samples; default straight lines.
    mask : (n,) array of bool, optional
        False where residuals are not to count.
    first : (p,) array, optional
        Values for the first start, of an equation-error or a simpler fit.
    progress : callable, optional
        Called with (starts done, starts).
    covariance : bool
        Whether to compute it.

    Raises
    ------
    InputError
        If no start leads to a model that can be simulated, or there are fewer samples than parameters.
    """
    # The products are small: threads of a linear algebra library cost more than they bring.
    with threadpool_limits(1, "blas"):
        return _fitted(structure, u, y, dt, starts, seed, hold, mask, first, progress, covariance)


def _fitted(
    structure: Structure, u: Array, y: Array, dt: float, starts: int, seed: int, hold: bool, mask: Array | None,
    first: Array | None, progress: Callable[[int, int], None] | None, covariance: bool,
) -> LinearFit:  # fmt: skip
    begun = time.perf_counter()
    problem = _Problem(structure, u, y, dt, hold, mask)
    spread = np.array([np.std(y[problem.good[:, k], k]) for k in range(y.shape[1])])
    if (spread == 0.0).any() or problem.good.sum() < 3 * len(structure.parameters):
        name = structure.outputs[int(np.argmin(spread))]
        raise InputError("record", name, "is constant or too short", "give a record in which it moves")
    problem.weight = 1.0 / spread**2
    generator = np.random.default_rng(seed)
    nominal = np.array([p.start for p in structure.parameters])
    trials = [nominal if first is None else np.clip(first, problem.low, problem.high)]
    trials += [_random_start(problem, nominal, generator) for _ in range(starts - 1)]
    best, costs, history = None, [], []
    for done, trial in enumerate(trials):
        solution = _search(problem, problem.coordinates(trial), 25 if starts > 1 else 200, 1e-5)
        costs.append(float(2.0 * solution.cost))
        if best is None or solution.cost < best[0].cost:
            best = (solution, trial)
        history.append(_row(structure, problem, done, costs[-1], solution.x))
        if progress is not None:
            progress(done + 1, starts + _ROUNDS)
    assert best is not None
    solution, start = best
    if not np.isfinite(solution.cost) or solution.cost >= 0.4e12 * problem.good.sum():
        raise InputError("--model", structure.name, "cannot be simulated from any start", "try a simpler one")
    z = solution.x
    for k in range(_ROUNDS):
        # Maximum likelihood: weights from the residuals, then the parameters again.
        rows = _rows(problem, z)
        weight = 1.0 / np.maximum(np.nanvar(rows, axis=0), (1e-9 * spread) ** 2)
        if k and (np.abs(weight / problem.weight - 1.0) < 1e-3).all():
            break
        problem.weight = weight
        solution = _search(problem, z, 100)
        z = solution.x
        history.append(_row(structure, problem, starts + k, float(2.0 * solution.cost), z))
        if progress is not None:
            progress(starts + k + 1, starts + _ROUNDS)
    return _finish(structure, problem, solution, start, costs, history, begun, covariance)


def _search(problem: _Problem, z0: Array, most: int, tolerance: float = 1e-8) -> Any:
    low, high = problem.coordinates(problem.low), problem.coordinates(problem.high)
    inside = np.clip(z0, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
    return least_squares(
        problem.residual, inside, jac=problem.jacobian, bounds=(low, high), method="trf", x_scale="jac",
        ftol=tolerance, xtol=tolerance, gtol=1e-10, max_nfev=most,
    )  # fmt: skip


def _random_start(problem: _Problem, nominal: Array, generator: np.random.Generator) -> Array:
    """Logarithmic parameters within a factor of ten of their start, the others within three times their scale."""
    p = nominal.size
    factor = np.exp(generator.uniform(-2.3, 2.3, p))
    shift = nominal * np.exp(generator.normal(0.0, 1.0, p)) + 0.5 * problem.scale * generator.normal(size=p)
    return np.clip(np.where(problem.log, nominal * factor, shift), problem.low, problem.high)


def _row(structure: Structure, problem: _Problem, k: int, cost: float, z: Array) -> dict[str, Any]:
    values = problem.values(z)
    return {"iteration": k, "cost": cost, **dict(zip(structure.symbols, values.tolist(), strict=True))}


def _rows(problem: _Problem, z: Array) -> Array:
    """Residuals (n, outputs), NaN where they do not count."""
    got = problem.predict(problem.values(z))
    if got is None:
        raise InputError("--model", problem.structure.name, "cannot be simulated", "try a simpler one")
    forced, added, linear = got
    return np.where(problem.good, problem.y - forced - added @ linear, np.nan)


def _finish(
    structure: Structure, problem: _Problem, solution: Any, start: Array, costs: list[float],
    history: list[dict[str, Any]], begun: float, covariance: bool,
) -> LinearFit:  # fmt: skip
    z = solution.x
    values = problem.values(z)
    got = problem.predict(values)
    assert got is not None
    linear = got[2]
    rows = _rows(problem, z)
    variance = np.nanvar(rows, axis=0)
    likelihood = -0.5 * float(np.sum(np.log(2.0 * np.pi * np.maximum(variance, 1e-300)) + 1.0))
    p, nx, nu = values.size, len(structure.states), len(structure.inputs)
    cov = bound = np.full((p, p), np.nan)
    if covariance:
        cov, bound = _covariance(problem, z, rows)
    low, high = problem.coordinates(problem.low), problem.coordinates(problem.high)
    at_bound = (z - low < 1e-4 * (high - low)) | (high - z < 1e-4 * (high - low))
    near = sum(c < 1.02 * min(costs) for c in costs)
    message = (
        f"{'search settled' if solution.status > 0 else 'search ran out of steps'}; {near} of {len(costs)} starts "
        "reached the best cost within 2 %"
    )
    return LinearFit(
        structure, values, start, cov, bound, at_bound, linear[:nx], linear[nx : nx + nu], linear[nx + nu :],
        1.0 / np.maximum(variance, 1e-300), likelihood, _effective(rows), tuple(history), tuple(sorted(costs)),
        problem.simulations, time.perf_counter() - begun, bool(solution.status > 0), message, problem.hold,
    )  # fmt: skip


def _covariance(problem: _Problem, z: Array, rows: Array) -> tuple[Array, Array]:
    n, m = rows.shape
    root = np.sqrt(problem.weight)
    jacobian = problem.jacobian(z)
    # What is left of the sensitivities once the linear unknowns had their say.
    got = problem.predict(problem.values(z))
    assert got is not None
    basis = (got[1] * root[None, :, None])[problem.good]
    basis = basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    q, r, _ = qr(basis, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(r)) > 1e-7 * abs(r[0, 0])).sum())
    q = q[:, :rank]
    jacobian -= q @ (q.T @ jacobian)
    sensitivity = np.zeros((n, m, z.size))
    sensitivity[problem.good] = jacobian
    cov, bound, _ = coloured_covariance([sensitivity], [root * np.nan_to_num(rows)])
    to_values = np.where(problem.log, problem.values(z), problem.scale)
    outer = np.outer(to_values, to_values)
    return cov * outer, bound * outer


def _effective(rows: Array) -> float:
    """Independent samples: n over the integrated autocorrelation time, the mean over the outputs."""
    n = len(rows)
    counts = []
    for e in rows.T:
        r = autocorrelation(e, 1.0, max_lag_s=n // 5).value
        window = parzen(r.size - 1)[r.size - 1 :]
        counts.append(np.isfinite(e).sum() / max(1.0, 1.0 + 2.0 * float(np.sum((window * r**2)[1:]))))
    return float(np.mean(counts))


def predict_linear(fit: LinearFit, u: Array, dt: float) -> tuple[Array, Array]:
    """Simulate a fitted model from the beginning of the record that it was fitted to, as far as the inputs go.

    Parameters
    ----------
    fit : LinearFit
    u : (n, inputs) array
        As recorded, beginning with the fitted record; what follows it is predicted from inputs alone.
    dt : float

    Returns
    -------
    y : (n, outputs) array
    x : (n, states) array
    """
    y, x = simulate_linear(fit.structure, fit.values, u - fit.input_trim, dt, x0=fit.x0, hold=fit.hold)
    # The delayed inputs before the record stand at their first value: the trim is taken off there, too.
    return y + fit.output_bias, x
