"""Validation of linear models: cross-validation, multi-step prediction, noise floor, subspace identification.

**Blocked cross-validation.** The record is divided into blocks. Each block is omitted from the cost once, while the
simulation runs through it, and is then predicted from inputs alone. Neighbouring samples are dependent; whole blocks
are nearly independent.

**Disturbance model.** The simulation error ``e = y - y_sim`` obeys the model's homogeneous equation driven by the
disturbance, ``d_(k+1) = Phi d_k + w_k, e_k = C d_k + v_k``. The variances of ``w`` and ``v`` are fitted by maximum
likelihood of the one-step innovations (Ljung, Sec. 7.4; Jategaonkar's filter-error method, ch. 5, for a fixed model).
A steady Kalman filter then estimates the state from past samples. The prediction ``h`` seconds ahead is
``y_sim(t + h) + C Phi^h d(t|t)``: it uses measurements up to t and inputs up to t + h.

**Noise floor** of a rate: its content above the band in which the inputs have power, and, below, its difference from
the derivative of the measured angle. The model need not explain these two parts.

**Subspace identification**, a cross-check that shares neither the search nor the structure of the fit (PBSIDopt;
Chiuso 2007, Automatica 43, 1034-1048; van der Veen, van Wingerden, Bergamasco, Lovera and Verhaegen 2013, IET Control
Theory Appl. 7(10)). The innovation form ``x+ = A x + B u + K e, y = C x + D u + e`` is ``x+ = Ac x + Bc z`` with
``z = (u, y)``, ``Ac = A - K C``, so after ``p`` samples ``x ~ [Ac^(p-1) Bc ... Bc] Z_p``. A long ARX model gives the
products ``C Ac^i Bc``; stacked over a future window they form ``Gamma K``. The directions of the largest singular
values of ``Gamma K Z`` are the states, and A, B, C, D follow by least squares. The method is valid in closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize
from scipy.signal import periodogram

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import InputError
from mufly.identify.flight_record import low_pass
from mufly.identify.linear.linear_fit import LinearFit, fit_linear_model, simulate_linear_fit
from mufly.identify.linear.linear_structure import LinearStructure, discretise_first_order_hold
from mufly.identify.residual_analysis import estimate_high_frequency_noise
from mufly.results import result

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CrossValidation:
    """Errors with which one model structure predicts omitted blocks of the fitted part of a record.

    Attributes
    ----------
    name : str
    parameters : int
        Number of free parameters.
    left_out_error : float
        Mean square residual in the omitted blocks over the variance of the output, averaged over the outputs;
        1 is as good as the mean.
    left_out_error_by_output : tuple of float
        ``left_out_error`` of each output.
    in_sample_fit_percent : tuple of float
        In-sample fit to all blocks.
    aic, bic : float
        Information criteria for the effective samples, relative to the best structure.
    """

    name: str
    parameters: int
    left_out_error: float
    left_out_error_by_output: tuple[float, ...]
    in_sample_fit_percent: tuple[float, ...]
    aic: float
    bic: float


def cross_validate_structure(
    structure: LinearStructure, u: Array, y: Array, dt: float, *, blocks: int = 4, starts: int = 3, hold: bool = False,
) -> tuple[CrossValidation, LinearFit]:  # fmt: skip
    """Score a model structure by cross-validation: each block of the record is predicted by a fit to the other blocks.

    Parameters
    ----------
    structure : LinearStructure
    u, y : (n, inputs), (n, outputs) array
    dt : float
    blocks : int
        Number of blocks, each omitted once.
    starts, hold
        See :func:`mufly.identify.linear.linear_fit.fit_linear_model`; each fold starts at the fit to all blocks.

    Returns
    -------
    score : CrossValidation
        Score with absolute ``aic`` and ``bic``.
    fit : LinearFit
        Fit to all blocks, without covariance.
    """
    whole = fit_linear_model(structure, u, y, dt, starts=starts, hold=hold, covariance=False)
    edges = np.linspace(0, len(y), blocks + 1).astype(int)
    square = np.zeros_like(y)
    for a, b in pairwise(edges.tolist()):
        mask = np.ones(len(y), dtype=bool)
        mask[a:b] = False
        fold = fit_linear_model(
            structure, u, y, dt, starts=1, hold=hold, mask=mask, first=whole.values, covariance=False
        )
        square[a:b] = (y - simulate_linear_fit(fold, u, dt)[0])[a:b] ** 2
    left_out = np.nanmean(square, axis=0) / np.nanvar(y, axis=0)
    error = y - simulate_linear_fit(whole, u, dt)[0]
    percent = 100.0 * (1.0 - np.sqrt(np.nanmean(error**2, axis=0) / np.nanvar(y, axis=0)))
    return CrossValidation(
        structure.name, len(structure.parameters), float(left_out.mean()), tuple(left_out.tolist()),
        tuple(percent.tolist()), whole.information_criterion("aic"), whole.information_criterion("bic"),
    ), whole  # fmt: skip


@dataclass(frozen=True, eq=False)
class DisturbanceModel:
    """Process noise and measurement noise that explain the simulation error of a fitted model.

    Attributes
    ----------
    process_noise_std : (states,) array
        Standard deviation of ``w`` per sample.
    measurement_noise_std : (outputs,) array
        Standard deviation of ``v``.
    transition_matrix, kalman_gain : array
        Transition of one sample (states, states), and Kalman gain (states, outputs).
    """

    process_noise_std: Array
    measurement_noise_std: Array
    transition_matrix: Array
    kalman_gain: Array


def fit_disturbance_model(fit: LinearFit, residual: Array, dt: float) -> DisturbanceModel:
    """Fit a disturbance model to the simulation residuals (n, outputs) of the samples used in ``fit``, without gaps."""
    a, b, c, _, _ = fit.structure.state_space_matrices(fit.values)
    phi = discretise_first_order_hold(a, b, dt)[0]
    scale = residual.std(axis=0)
    # Measured states have the size of their output; the others have the mean size.
    size = np.array(
        [float(np.mean(scale[c[:, j] != 0.0])) if c[:, j].any() else float(scale.mean()) for j in range(len(a))]
    )
    step = np.sqrt(dt)

    def kalman_gain(z: Array) -> tuple[Array, Array]:
        q, r = np.diag((size * step * np.exp(z[: len(a)])) ** 2), np.diag((scale * np.exp(z[len(a) :])) ** 2)
        p = solve_discrete_are(phi.T, c.T, q, r)
        s = c @ p @ c.T + r
        return np.asarray(np.linalg.solve(s, c @ p).T, dtype=np.float64), s

    def negative_log_likelihood(z: Array) -> float:
        if (np.abs(z) > 12.0).any():
            return 1e12
        try:
            gain, s = kalman_gain(z)
        except (np.linalg.LinAlgError, ValueError):
            return 1e12
        e = _run_steady_kalman_filter(phi, np.ascontiguousarray(gain), np.ascontiguousarray(c), residual)[1]
        sign, logdet = np.linalg.slogdet(s)
        if sign <= 0.0 or not np.isfinite(e).all():
            return 1e12
        return 0.5 * len(e) * logdet + 0.5 * float(np.einsum("ni,ij,nj->", e, np.linalg.inv(s), e))

    z0 = np.r_[np.zeros(len(a)), np.full(len(c), -0.5)]
    simplex = np.vstack([z0, z0 + np.eye(z0.size)])
    options: Any = {"maxfev": 150 * z0.size, "xatol": 0.02, "fatol": 0.1, "initial_simplex": simplex}
    best = minimize(negative_log_likelihood, z0, method="Nelder-Mead", options=options)
    gain, _ = kalman_gain(best.x)
    return DisturbanceModel(size * step * np.exp(best.x[: len(a)]), scale * np.exp(best.x[len(a) :]), phi, gain)


@cached_njit
def _run_steady_kalman_filter(
    phi: Array, gain: Array, c: Array, e: Array
) -> tuple[Array, Array]:  # pragma: no cover (compiled)
    """Return the updated states (n, nx) and innovations (n, ny) of a Kalman filter with constant ``gain`` (nx, ny).

    ``phi`` (nx, nx) is the transition matrix, ``c`` (ny, nx) the output matrix, and ``e`` (n, ny) the filtered signals.
    """
    n, ny, nx = e.shape[0], c.shape[0], phi.shape[0]
    states, innovations = np.empty((n, nx)), np.empty((n, ny))
    ahead = np.zeros(nx)
    for k in range(n):
        for o in range(ny):
            total = e[k, o]
            for i in range(nx):
                total -= c[o, i] * ahead[i]
            innovations[k, o] = total
        for i in range(nx):
            total = ahead[i]
            for o in range(ny):
                total += gain[i, o] * innovations[k, o]
            states[k, i] = total
        for i in range(nx):
            total = 0.0
            for j in range(nx):
                total += phi[i, j] * states[k, j]
            ahead[i] = total
    return states, innovations


def predict_outputs_ahead(
    fit: LinearFit, disturbance: DisturbanceModel, y: Array, simulated: Array, dt: float, horizon_s: float
) -> Array:
    """Predict every sample from measurements at least ``horizon_s`` old, and from the inputs since.

    Parameters
    ----------
    fit : LinearFit
    disturbance : DisturbanceModel
        Disturbance model of the fitted part.
    y, simulated : (n, outputs) array
        Measured outputs, and simulation from inputs alone, which is returned for the first ``horizon_s``.
    dt, horizon_s : float
        Sample time and horizon (s).

    Returns
    -------
    (n, outputs) array
        Predicted outputs.
    """
    c = fit.structure.state_space_matrices(fit.values)[2]
    gain, c_ = np.ascontiguousarray(disturbance.kalman_gain), np.ascontiguousarray(c)
    states, _ = _run_steady_kalman_filter(disturbance.transition_matrix, gain, c_, np.nan_to_num(y - simulated))
    steps = max(1, round(horizon_s / dt))
    ahead = c @ np.linalg.matrix_power(disturbance.transition_matrix, steps)
    predicted = simulated.copy()
    predicted[steps:] += states[:-steps] @ ahead.T
    return predicted


@result(json="split_hz above below input_power_below_fraction total=total_std")
class NoiseFloor:
    """Noise of one measured output below and above a frequency; standard deviations in the unit of the output.

    Attributes
    ----------
    split_hz : float
        Frequency between the two parts.
    above : float
        Content of the output above ``split_hz``.
    below : float
        Difference to the measured angle's derivative below ``split_hz``; zero without a measured angle.
    input_power_below_fraction : float
        Share of the normalised inputs' power below ``split_hz``.
    """

    split_hz: float
    above: float
    below: float
    input_power_below_fraction: float

    @property
    def total_std(self) -> float:
        """Total noise: root sum square of ``above`` and ``below``."""
        return float(np.hypot(self.above, self.below))


def estimate_noise_floor(
    signal: Array, u: Array, dt: float, *, split_hz: float, angle: Array | None = None
) -> NoiseFloor:
    """Estimate the noise floor of an output.

    Parameters
    ----------
    signal : (n,) array
        Output, in its unit.
    u : (n, k) array
        All inputs.
    dt : float
        Sample time (s).
    split_hz : float
        Frequency above which the vehicle does not respond to its inputs.
    angle : (n,) array, optional
        Measured angle whose derivative is the signal (small angles).
    """
    moved = u[:, u.std(axis=0) > 0.0]
    share = 1.0
    if moved.shape[1]:
        scaled = (moved - moved.mean(0)) / moved.std(0)
        f, power = periodogram(scaled, 1.0 / dt, axis=0, window="hann", detrend="constant")
        share = float(power[f <= split_hz].sum() / power.sum())
    below = 0.0
    if angle is not None:
        both = low_pass(np.column_stack([signal, np.gradient(angle, dt)]), dt, split_hz)
        edge = min(len(signal) // 10, round(1.0 / (split_hz * dt)))
        below = float(np.std((both[:, 0] - both[:, 1])[edge : len(signal) - edge]))
    return NoiseFloor(split_hz, estimate_high_frequency_noise(signal, dt, above_hz=split_hz), below, share)


@dataclass(frozen=True, eq=False)
class SubspaceModel:
    """Discrete-time linear state-space model whose states have no physical meaning.

    Attributes
    ----------
    a, b, c, d, kalman_gain : array
        Matrices (n, n), (n, inputs), (outputs, n), (outputs, inputs), (n, outputs).
    singular_values : array
        Singular values, largest first; a gap indicates the order.
    input_mean, output_mean : array
        Means subtracted before the fit.
    dt : float
        Sample time (s).
    """

    a: Array
    b: Array
    c: Array
    d: Array
    kalman_gain: Array
    singular_values: Array
    input_mean: Array
    output_mean: Array
    dt: float

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Return the continuous-time poles (1/s), slowest first."""
        e = np.log(np.linalg.eigvals(self.a).astype(complex)) / self.dt
        return np.asarray(e[np.argsort(np.abs(e))], dtype=np.complex128)

    def simulate_outputs(self, u: Array, x0: Array | None = None) -> Array:
        """Simulate outputs (n, outputs) from inputs (n, inputs)."""
        x = np.zeros(len(self.a)) if x0 is None else x0
        y = np.empty((len(u), len(self.c)))
        for i, v in enumerate(u - self.input_mean):
            y[i] = self.c @ x + self.d @ v
            x = self.a @ x + self.b @ v
        return y + self.output_mean

    def estimate_initial_state(self, u: Array, y: Array) -> Array:
        """Return the initial state (n,) whose simulation fits outputs ``y`` best."""
        n = len(self.a)
        power, rows = np.eye(n), []
        for _ in range(len(u)):
            rows.append(self.c @ power)
            power = self.a @ power
        missed = (y - self.simulate_outputs(u)).ravel()
        return np.asarray(np.linalg.lstsq(np.concatenate(rows), missed, rcond=1e-8)[0])


def identify_subspace_model(u: Array, y: Array, dt: float, *, order: int, past: int = 20) -> SubspaceModel:
    """Identify a subspace model of given order.

    Parameters
    ----------
    u, y : (n, inputs), (n, outputs) array
        Signals without gaps. Records with a high sample rate should be decimated: ``past`` must span the slow modes.
    dt : float
        Sample time (s).
    order : int
        Number of states.
    past : int
        Length of the windows before and after a sample (samples).

    Raises
    ------
    InputError
        If the record is too short for the windows, or the order does not fit them.
    """
    m, l = u.shape[1], y.shape[1]
    n = len(u) - past
    if n < 3 * past * (m + l) or not 1 <= order <= past * l:
        raise InputError(
            "subspace", "", f"order {order} with windows of {past} and {past} does not fit {len(u)} samples",
            "give a longer record, a smaller order or a shorter window",
        )  # fmt: skip
    u_mean, y_mean = u.mean(0), y.mean(0)
    u, y = u - u_mean, y - y_mean
    z = np.column_stack([u, y])
    # Columns: Z_p at each time, oldest first; then the direct input.
    history = np.concatenate([z[i : i + n].T for i in range(past)])
    now_u, now_y = u[past:].T, y[past:].T
    regressor = np.concatenate([history, now_u])
    scale = np.sqrt((regressor**2).mean(1))
    scale[scale == 0.0] = 1.0
    gram = (regressor / scale[:, None]) @ (regressor / scale[:, None]).T
    ridge = 1e-9 * np.trace(gram) / len(gram)
    theta = np.linalg.solve(gram + ridge * np.eye(len(gram)), (regressor / scale[:, None]) @ now_y.T).T / scale
    markov = theta[:, : past * (m + l)]
    w = m + l
    gamma = np.zeros((past * l, past * w))
    for i in range(past):
        gamma[i * l : (i + 1) * l, i * w :] = markov[:, : (past - i) * w]
    _, singular, vt = np.linalg.svd(gamma @ history, full_matrices=False)
    x = np.sqrt(singular[:order])[:, None] * vt[:order]
    cd = np.linalg.lstsq(np.concatenate([x, now_u]).T, now_y.T, rcond=None)[0].T
    e = now_y - cd @ np.concatenate([x, now_u])
    abk = np.linalg.lstsq(np.concatenate([x, now_u, e])[:, :-1].T, x[:, 1:].T, rcond=None)[0].T
    return SubspaceModel(
        abk[:, :order], abk[:, order : order + m], cd[:, :order], cd[:, order:], abk[:, order + m :],
        singular, u_mean, y_mean, dt,
    )  # fmt: skip
