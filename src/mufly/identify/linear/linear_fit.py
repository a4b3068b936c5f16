"""Output-error fit of a linear model to one record: Gauss-Newton in a trust region from several starts.

The prediction is a pure simulation from the inputs over the whole record. Its residuals are weighted by their inverse
variance, which is re-estimated until it converges: the maximum-likelihood estimate for unknown noise (Maine and Iliff
1985, NASA RP-1138; Jategaonkar, ch. 4). Initial state, input trim and output bias enter linearly and are eliminated
exactly at every step (variable projection). The search therefore has only the parameters of the dynamics, and their
covariance includes the effect of the eliminated unknowns. For cross-validation a mask omits residuals, while the
simulation runs through the masked samples.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import coloured_covariance, parzen_window
from mufly.identify.linear.linear_structure import (
    LinearStructure,
    SearchCoordinates,
    compute_start_and_bias_responses,
    scale_gains_to_record,
    simulate_linear_structure,
)
from mufly.identify.residual_analysis import compute_residual_autocorrelation
from mufly.results import result

Array = NDArray[np.float64]

_NOISE_WEIGHT_ITERATIONS = 3


@result(eq=False)
class LinearFit:
    """Fitted linear model.

    Attributes
    ----------
    structure : LinearStructure
    values, start : (p,) array
        Fitted parameters, and start values of the best search.
    covariance, cramer_rao_bound : (p, p) array
        Covariance corrected for coloured residuals; Cramer-Rao bound for white residuals.
    at_bound : (p,) array of bool
        Whether a parameter stopped at a bound.
    x0 : (states,) array
        Initial state (SI).
    input_trim : (inputs,) array
        Trim of each input, in its unit.
    output_bias : (outputs,) array
        Bias of each output, in its unit.
    weight : (outputs,) array
        Inverse variance of the residuals.
    log_likelihood_per_sample : float
        Log-likelihood per sample for white Gaussian residuals.
    effective_samples : float
        Equivalent number of independent samples, from the autocorrelation of the residuals.
    history : tuple of dict
    costs : tuple of float
        Final cost of every start, ascending.
    simulations : int
    computing_time_s : float
    converged : bool
    message : str
    hold : bool
        Whether inputs are constant between samples.
    """

    structure: LinearStructure
    values: Array
    start: Array
    covariance: Array
    cramer_rao_bound: Array
    at_bound: NDArray[np.bool_]
    x0: Array
    input_trim: Array
    output_bias: Array
    weight: Array
    log_likelihood_per_sample: float
    effective_samples: float
    history: tuple[dict[str, Any], ...]
    costs: tuple[float, ...]
    simulations: int
    computing_time_s: float
    converged: bool
    message: str
    hold: bool

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Return the eigenvalues of A (1/s), slowest first."""
        a = self.structure.state_space_matrices(self.values)[0]
        e = np.linalg.eigvals(a)
        return np.asarray(e[np.argsort(np.abs(e))], dtype=np.complex128)

    def information_criterion(self, kind: str = "bic") -> float:
        """Return Akaike's ("aic") or Schwarz's ("bic") information criterion of the fit; smaller is better.

        The number of samples in it is that of the independent ones, ``effective_samples``.
        """
        free = self.values.size + self.x0.size + self.input_trim.size + self.output_bias.size
        n = self.effective_samples
        per_sample = -2.0 * self.log_likelihood_per_sample  # per sample, summed over outputs
        return n * per_sample + free * (2.0 if kind == "aic" else float(np.log(max(n, 2.0))))


class _LinearFitProblem:
    """Least-squares problem of a linear fit, over the search coordinates of the parameters.

    Initial states, input trims and output biases enter linearly; they are solved for each set of parameters.
    """

    def __init__(
        self, structure: LinearStructure, u: Array, y: Array, dt: float, hold: bool, mask: Array | None
    ) -> None:
        self.structure, self.inputs, self.measured, self.dt, self.holds_inputs = structure, u, y, dt, hold
        self.is_used = np.isfinite(y) & (np.ones(len(y), dtype=bool) if mask is None else mask)[:, None]
        self.output_weight = np.ones(y.shape[1])
        self.output_std = np.array([np.std(y[self.is_used[:, k], k]) for k in range(y.shape[1])])
        self.simulation_count = 0
        self.start_values = np.array([q.start_value for q in structure.parameters])
        self.coordinates = SearchCoordinates(structure.parameters, self.start_values)

    def simulate_with_linear_unknowns(self, values: Array) -> tuple[Array, Array, Array] | None:
        """Return the response to the inputs, to each linear unknown of size 1, and the estimates of the unknowns.

        The linear unknowns are the initial states, input trims and output biases. None if the simulation overflows.
        """
        self.simulation_count += 1
        try:
            with np.errstate(over="raise", invalid="raise"):
                forced, _ = simulate_linear_structure(
                    self.structure, values, self.inputs, self.dt, hold=self.holds_inputs
                )
                added = compute_start_and_bias_responses(self.structure, values, len(self.inputs), self.dt)
                root = np.sqrt(self.output_weight)
                weighted = added * root[None, :, None]
                # Norms over all samples: an unknown that acts only on masked samples counts as undetermined, stays 0.
                size = np.sqrt(np.maximum(np.einsum("nmj,nmj->j", weighted, weighted), 1e-300))
                rows, right = weighted[self.is_used], ((self.measured - forced) * root)[self.is_used]
        except FloatingPointError:
            return None
        # Relative to the record, not to the changing weights: a simulation stays valid during the search.
        over = float(np.max(root * np.maximum(self.output_std, 1e-300)))
        if not (np.isfinite(size).all() and size.max() < 1e12 * over):
            return None
        rows /= size
        # Normal equations are much faster for a hundred rows per column; unit columns limit the loss of accuracy.
        inverse = np.linalg.pinv(rows.T @ rows, rcond=1e-11, hermitian=True)
        return forced, added, inverse @ (rows.T @ right) / size

    def weighted_residual(self, z: Array) -> Array:
        got = self.simulate_with_linear_unknowns(self.coordinates.to_values(z))
        if got is None:
            return np.full(int(self.is_used.sum()), 1e6)
        forced, added, linear = got
        return ((self.measured - forced - added @ linear) * np.sqrt(self.output_weight))[self.is_used]

    def solve_linear_unknowns(self, z: Array) -> tuple[Array, Array, Array]:
        """Return the residuals, the responses to a unit of each linear unknown, and the estimates of the unknowns.

        The linear unknowns are the initial states, input trims and output biases.
        Residuals have the shape (n, outputs); masked samples are NaN.
        """
        got = self.simulate_with_linear_unknowns(self.coordinates.to_values(z))
        if got is None:
            raise ArgumentError("structure", self.structure.name, "cannot be simulated", "choose a simpler structure")
        forced, added, linear = got
        return np.where(self.is_used, self.measured - forced - added @ linear, np.nan), added, linear

    def residual_jacobian(self, z: Array) -> Array:
        base = self.weighted_residual(z)
        columns = np.empty((base.size, z.size))
        for k in range(z.size):
            step = 1e-5 * max(1.0, abs(z[k]))
            moved = z.copy()
            moved[k] += step
            if self.coordinates.to_values(moved)[k] == self.coordinates.to_values(z)[k]:
                step = -step
                moved[k] = z[k] + step
            columns[:, k] = (self.weighted_residual(moved) - base) / step
        return columns

    def search_minimum(self, z0: Array, most: int, tolerance: float = 1e-8) -> Any:
        low, high = self.coordinates.bounds
        inside = np.clip(z0, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
        return least_squares(
            self.weighted_residual, inside, jac=self.residual_jacobian, bounds=(low, high), method="trf", x_scale="jac",
            ftol=tolerance, xtol=tolerance, gtol=1e-10, max_nfev=most,
        )  # fmt: skip

    def random_start(self, generator: np.random.Generator) -> Array:
        """Return random start values of the parameters.

        Logarithmic parameters lie within a factor of ten of their nominal start values; the others scatter about
        theirs.
        """
        at, nominal, p = self.coordinates, self.start_values, self.start_values.size
        factor = np.exp(generator.uniform(-2.3, 2.3, p))
        shift = nominal * np.exp(generator.normal(0.0, 1.0, p)) + 0.5 * at.linear_scale * generator.normal(size=p)
        return np.clip(np.where(at.is_logarithmic, nominal * factor, shift), at.low, at.high)

    def parameter_covariance(self, z: Array) -> tuple[Array, Array]:
        """Return the covariance of the parameters, and the Cramer-Rao bound, which holds for white residuals."""
        rows, added, _ = self.solve_linear_unknowns(z)
        n, m = rows.shape
        root = np.sqrt(self.output_weight)
        jacobian = self.residual_jacobian(z)
        # Sensitivities with the linear unknowns projected out.
        basis = (added * root[None, :, None])[self.is_used]
        basis = basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
        q, r, _ = qr(basis, mode="economic", pivoting=True)
        q = q[:, : int((np.abs(np.diag(r)) > 1e-7 * abs(r[0, 0])).sum())]
        sensitivity = np.zeros((n, m, z.size))
        sensitivity[self.is_used] = jacobian - q @ (q.T @ jacobian)
        cov, bound, _ = coloured_covariance([sensitivity], [root * np.nan_to_num(rows)])
        slope = self.coordinates.value_derivatives(z)
        return cov * np.outer(slope, slope), bound * np.outer(slope, slope)


def fit_linear_model(
    structure: LinearStructure, u: Array, y: Array, dt: float, *, starts: int = 8, seed: int = 0, hold: bool = False,
    mask: Array | None = None, first: Array | None = None, progress: Callable[[int, int], None] | None = None,
    covariance: bool = True,
) -> LinearFit:  # fmt: skip
    """Fit a linear model to one record.

    Parameters
    ----------
    structure : LinearStructure
    u : (n, inputs) array
        Inputs as recorded; their trims are estimated.
    y : (n, outputs) array
        Outputs; NaN without a measurement.
    dt : float
        Sample time (s).
    starts : int
        Number of searches: one from the structure's start values, the others from random values within the bounds.
    seed : int
        Random seed of the starts.
    hold : bool
        Whether inputs are constant between samples; linear by default.
    mask : (n,) array of bool, optional
        False for samples whose residuals are omitted.
    first : (p,) array, optional
        Values of the first start, from an equation-error or a simpler fit.
    progress : callable, optional
        Called with (starts done, starts).
    covariance : bool
        Whether to compute the covariance.

    Raises
    ------
    InputError
        If no start leads to a stable simulation, or there are fewer samples than parameters.
    """
    begun = time.perf_counter()
    structure = scale_gains_to_record(structure, u, y)
    problem = _LinearFitProblem(structure, u, y, dt, hold, mask)
    spread = problem.output_std
    if (spread == 0.0).any() or problem.is_used.sum() < 3 * len(structure.parameters):
        name = structure.outputs[int(np.argmin(spread))]
        raise InputError("record", name, "is constant or too short", "give a record with motion of this signal")
    problem.output_weight = 1.0 / spread**2
    generator = np.random.default_rng(seed)
    at = problem.coordinates
    trials = [problem.start_values if first is None else np.clip(first, at.low, at.high)]
    trials += [problem.random_start(generator) for _ in range(starts - 1)]
    costs: list[float] = []
    history: list[dict[str, Any]] = []

    def search_minimum_from(z0: Array, most: int, tolerance: float = 1e-8) -> Any:
        solution = problem.search_minimum(z0, most, tolerance)
        values = zip(structure.symbols, at.to_values(solution.x).tolist(), strict=True)
        history.append({"iteration": len(history), "cost": float(2.0 * solution.cost), **dict(values)})
        if progress is not None:
            progress(len(history), starts + _NOISE_WEIGHT_ITERATIONS)
        return solution

    # The matrix products are small: BLAS threads cost more than they gain.
    with threadpool_limits(1, "blas"):
        best = None
        for trial in trials:
            solution = search_minimum_from(at.to_search_coordinates(trial), 25 if starts > 1 else 200, 1e-5)
            costs.append(history[-1]["cost"])
            if best is None or solution.cost < best[0].cost:
                best = (solution, trial)
        assert best is not None
        solution, start = best
        if not np.isfinite(solution.cost) or solution.cost >= 0.4e12 * problem.is_used.sum():
            raise ArgumentError(
                "structure",
                structure.name,
                "cannot be simulated with any initial parameters",
                "choose a simpler structure",
            )
        for k in range(_NOISE_WEIGHT_ITERATIONS):
            # Maximum likelihood: alternate between weights from the residuals and parameters.
            variance = np.nanvar(problem.solve_linear_unknowns(solution.x)[0], axis=0)
            weight = 1.0 / np.maximum(variance, (1e-9 * spread) ** 2)
            if k and (np.abs(weight / problem.output_weight - 1.0) < 1e-3).all():
                break
            problem.output_weight = weight
            solution = search_minimum_from(solution.x, 100)
        z, values = solution.x, at.to_values(solution.x)
        rows, _, linear = problem.solve_linear_unknowns(z)
        cov = bound = np.full((z.size, z.size), np.nan)
        if covariance:
            cov, bound = problem.parameter_covariance(z)
    variance = np.nanvar(rows, axis=0)
    nx, nu = len(structure.states), len(structure.inputs)
    low, high = at.bounds
    near = sum(c < 1.02 * min(costs) for c in costs)
    at_bound = (z - low < 1e-4 * (high - low)) | (high - z < 1e-4 * (high - low))
    held = ", ".join(
        f"{p.symbol} = {v:.4g} {p.unit}".rstrip()
        for p, v, b in zip(structure.parameters, values.tolist(), at_bound, strict=True)
        if b
    )
    return LinearFit(
        structure=structure,
        values=values,
        start=start,
        covariance=cov,
        cramer_rao_bound=bound,
        at_bound=at_bound,
        x0=linear[:nx],
        input_trim=linear[nx : nx + nu],
        output_bias=linear[nx + nu :],
        weight=1.0 / np.maximum(variance, 1e-300),
        log_likelihood_per_sample=-0.5 * float(np.sum(np.log(2.0 * np.pi * np.maximum(variance, 1e-300)) + 1.0)),
        effective_samples=_effective_samples(rows),
        history=tuple(history),
        costs=tuple(sorted(costs)),
        simulations=problem.simulation_count,
        computing_time_s=time.perf_counter() - begun,
        converged=bool(solution.status > 0),
        message=(
            f"{'search settled' if solution.status > 0 else 'search ran out of steps'}; {near} of {len(costs)} starts "
            "reached the best cost within 2 %"
            + (f"; at a bound, which makes the other intervals conditional: {held}" if held else "")
        ),
        hold=hold,
    )


def _effective_samples(rows: Array) -> float:
    """Return the number of independent samples: n over the integrated autocorrelation time, averaged over outputs."""
    n = len(rows)
    counts = []
    for e in rows.T:
        r = compute_residual_autocorrelation(e, 1.0, max_lag_s=n // 5).value
        window = parzen_window(r.size - 1)[r.size - 1 :]
        counts.append(np.isfinite(e).sum() / max(1.0, 1.0 + 2.0 * float(np.sum((window * r**2)[1:]))))
    return float(np.mean(counts))


def simulate_linear_fit(fit: LinearFit, u: Array, dt: float) -> tuple[Array, Array]:
    """Simulate a fitted model from the beginning of the fitted record to the end of the inputs.

    Parameters
    ----------
    fit : LinearFit
    u : (n, inputs) array
        Recorded inputs of the fitted record and of the time to predict after it.
    dt : float

    Returns
    -------
    y : (n, outputs) array
        Outputs, in their units.
    x : (n, states) array
        States (SI).
    """
    y, x = simulate_linear_structure(fit.structure, fit.values, u - fit.input_trim, dt, x0=fit.x0, hold=fit.hold)
    # Delayed inputs before the record equal the first value, less the trim.
    return y + fit.output_bias, x
