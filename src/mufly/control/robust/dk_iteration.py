"""D-K iteration: a controller with a small structured singular value for full complex blocks.

The generalised plant has the channels of the uncertainty before those of the performance, then the controller's
signals. With positive scalings D(w), one for each block, mu is at most the largest singular value of ``D N D^-1``, N
the closed loop. Two steps alternate (Doyle 1985; Skogestad and Postlethwaite, *Multivariable Feedback Control*, 2006,
Sec. 8.12):

- K: an H-infinity controller for the plant with the present scalings;
- D: the scalings that are best for the loop at every frequency, then their magnitudes as stable filters with stable
  inverses: a gain times factors ``(s + z) / (s + p)``, fitted by least squares to the logarithms, with more weight
  where mu is large. The order of a filter is the smallest one whose error stays below a tolerance.

Neither step raises the bound but for the error of the filters. The iteration may end in a local minimum.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from scipy import linalg, optimize

from mufly.control.linear_systems import Array, ComplexArray, frequency_response, replace_matrices
from mufly.control.robust.structured_singular_value import Block, mu_upper_bound
from mufly.control.synthesis.hinf import HinfResult, compute_lower_lft, hinfsyn
from mufly.errors import ArgumentError, MuflyError
from mufly.results import result

_SYNTHESIS_REGULARISATION = 1e-5  # of the synthesis where rounding denies it an exact one
_FIT_WEIGHT_EXPONENT = 4.0  # power of mu's bound, relative to its peak, that weights the errors of a filter


class UncertaintyChannel(NamedTuple):
    """A full complex block of the uncertainty: how many outputs of the plant enter it, and how many inputs leave it."""

    outputs: int
    inputs: int


class ScalingFilter(NamedTuple):
    """``gain * prod (s + zeros) / (s + poles)``; zeros and poles are positive (rad/s)."""

    gain: float
    zeros: Array
    poles: Array

    @property
    def inverse_filter(self) -> ScalingFilter:
        """The filter with the reciprocal transfer function."""
        return ScalingFilter(1.0 / self.gain, self.poles, self.zeros)

    def magnitude_at(self, frequency: Array) -> Array:
        """Return the magnitude at the frequencies (rad/s)."""
        w2 = np.asarray(frequency)[:, None] ** 2
        size: Array = self.gain * np.sqrt(np.prod((w2 + self.zeros**2) / (w2 + self.poles**2), axis=1))
        return size

    def to_matrices(self) -> tuple[Array, Array, Array, Array]:
        """Return the state-space matrices A, B, C, D of the filter, its factors in series."""
        n = len(self.poles)
        A, B, C, D = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n)), 1.0
        for i, (z, p) in enumerate(zip(self.zeros, self.poles, strict=True)):
            A[i], B[i] = C[0], D  # the factor's input is the output of the factors before it
            A[i, i] = -p
            C[0, i] = z - p
        return A, B, C * self.gain, np.array([[D * self.gain]])


@result
class DkIterationRound:
    """One round of a D-K iteration.

    Attributes
    ----------
    gamma : float
        Level of the scaled plant's controller.
    mu : float
        Largest upper bound of mu over the frequencies with this controller.
    order : int
        Order of the controller.
    """

    gamma: float
    mu: float
    order: int


@result
class DkIterationResult:
    """The best controller of a D-K iteration, with its bound of mu and the rounds.

    Attributes
    ----------
    controller : control.StateSpace
    anti_windup_matrix : array, shape (states, controls)
        See ``HinfResult.anti_windup_matrix``.
    gamma : float
        Level of its scaled plant.
    mu : float
        Largest upper bound of mu over the frequencies.
    frequency, bound : array, shape (n,)
        Frequencies (rad/s) and upper bound of mu.
    rounds : tuple of DkIterationRound
    """

    controller: control.StateSpace
    anti_windup_matrix: Array
    gamma: float
    mu: float
    frequency: Array
    bound: Array
    rounds: tuple[DkIterationRound, ...]


def fit_filter_to_magnitude(
    frequency: Array, magnitude: Array, order_max: int, tolerance: float, weight: Array | None = None
) -> ScalingFilter:
    """Fit a filter of low order to a magnitude.

    Parameters
    ----------
    frequency, magnitude : array, shape (n,)
        Frequencies (rad/s) and positive magnitudes.
    order_max : int
        Largest order.
    tolerance : float
        Weighted root-mean-square error of the logarithm at which no higher order is tried.
    weight : array, shape (n,), optional
        Weights of the squared errors; equal ones by default.

    Returns
    -------
    ScalingFilter
        Its order is the lowest that meets the tolerance, or the best one.
    """
    log = np.log(magnitude)
    share = np.ones_like(log) if weight is None else np.asarray(weight, dtype=float)
    share = np.sqrt(share / share.sum())
    low, high = np.log(frequency[0]), np.log(frequency[-1])
    w2 = frequency[:, None] ** 2
    best = ScalingFilter(float(np.exp(share**2 @ log)), np.zeros(0), np.zeros(0))
    least = float(np.linalg.norm(share * (log - np.log(best.gain))))
    for order in range(1, order_max + 1):
        if least <= tolerance:
            break

        def weighted_log_errors(x: Array, n: int = order) -> Array:
            z, p = np.exp(2.0 * x[1 : n + 1]), np.exp(2.0 * x[n + 1 :])
            value: Array = x[0] + 0.5 * (np.log(w2 + z) - np.log(w2 + p)).sum(axis=1) - log
            return share * value

        def log_magnitude_jacobian(x: Array, n: int = order) -> Array:
            z, p = np.exp(2.0 * x[1 : n + 1]), np.exp(2.0 * x[n + 1 :])
            return share[:, None] * np.hstack([np.ones_like(w2), z / (w2 + z), -p / (w2 + p)])

        bounds = (
            np.concatenate([[-50.0], np.full(2 * order, low)]),
            np.concatenate([[50.0], np.full(2 * order, high)]),
        )
        centre = low + (np.arange(order) + 0.5) / order * (high - low)
        for shift in (0.3, -0.3):
            x0 = np.concatenate([[np.log(best.gain)], centre + shift, centre - shift])
            found = optimize.least_squares(
                weighted_log_errors, x0, jac=log_magnitude_jacobian, bounds=bounds, max_nfev=200
            )
            rms = float(np.sqrt(2.0 * found.cost))
            if rms < least:
                k, z, p = found.x[0], found.x[1 : order + 1], found.x[order + 1 :]
                best, least = ScalingFilter(float(np.exp(k)), np.exp(z), np.exp(p)), rms
    return best


def scale_uncertainty_channels(
    plant: control.StateSpace, channels: Sequence[UncertaintyChannel], filters: Sequence[ScalingFilter]
) -> control.StateSpace:
    """Scale the uncertainty channels of a plant: outputs by their filters, inputs by the inverse filters.

    Parameters
    ----------
    plant : control.StateSpace
    channels : sequence of UncertaintyChannel
        The plant's first channels.
    filters : sequence of ScalingFilter
        One for each channel.
    """
    rows = sum(c.outputs for c in channels)
    columns = sum(c.inputs for c in channels)
    left = [f.to_matrices() for c, f in zip(channels, filters, strict=True) for _ in range(c.outputs)]
    right = [f.inverse_filter.to_matrices() for c, f in zip(channels, filters, strict=True) for _ in range(c.inputs)]
    Al, Bl, Cl, Dl = (linalg.block_diag(*M) for M in zip(*left, strict=True))
    Ar, Br, Cr, Dr = (linalg.block_diag(*M) for M in zip(*right, strict=True))
    Bl = np.hstack([Bl, np.zeros((len(Al), plant.noutputs - rows))])
    Cl = np.vstack([Cl, np.zeros((plant.noutputs - rows, len(Al)))])
    Dl = linalg.block_diag(Dl, np.eye(plant.noutputs - rows))
    Br = np.hstack([Br, np.zeros((len(Ar), plant.ninputs - columns))])
    Cr = np.vstack([Cr, np.zeros((plant.ninputs - columns, len(Ar)))])
    Dr = linalg.block_diag(Dr, np.eye(plant.ninputs - columns))
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    n, k, m = len(A), len(Ar), len(Al)
    return replace_matrices(
        plant,
        A=np.block(
            [[A, B @ Cr, np.zeros((n, m))], [np.zeros((k, n)), Ar, np.zeros((k, m))], [Bl @ C, Bl @ D @ Cr, Al]]
        ),
        B=np.vstack([B @ Dr, Br, Bl @ D @ Dr]),
        C=np.hstack([Dl @ C, Dl @ D @ Cr, Cl]),
        D=Dl @ D @ Dr,
    )


def sweep_complex_mu(response: ComplexArray, channels: Sequence[UncertaintyChannel]) -> tuple[Array, Array]:
    """Return the upper bound of mu over frequency, and the D scaling of each channel relative to that of the last
    channel.

    Parameters
    ----------
    response : complex array, shape (n, outputs, inputs)
        Closed loop of all channels.
    channels : sequence of UncertaintyChannel

    Returns
    -------
    bound : array, shape (n,)
        Upper bound of mu.
    scalings : array, shape (n, channels)
        Magnitude of each channel's scaling over that of the last channel.
    """
    sizes = [max(c) for c in channels]
    blocks = [Block(size, False) for size in sizes]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    rows = np.concatenate([s + np.arange(c.outputs) for s, c in zip(starts, channels, strict=True)])
    columns = np.concatenate([s + np.arange(c.inputs) for s, c in zip(starts, channels, strict=True)])
    square = np.zeros((len(response), sum(sizes), sum(sizes)), dtype=complex)
    square[:, rows[:, None], columns] = response  # a row or column of zeros leaves mu
    bound, scalings, start = np.empty(len(response)), np.empty((len(response), len(channels))), None
    for i, M in enumerate(square):
        found = mu_upper_bound(M, blocks, start=start, restarts=0, tolerance=1e-4)
        start = found.scaling_parameters
        d = np.sqrt(np.diag(found.scaling).real[starts])
        bound[i], scalings[i] = found.value, d / d[-1]
    return bound, scalings


def iterate_dk(
    plant: control.StateSpace,
    channels: Sequence[UncertaintyChannel],
    n_measurements: int,
    n_controls: int,
    frequency: Array,
    *,
    scalings: Sequence[float] | None = None,
    start: control.StateSpace | None = None,
    rounds: int = 8,
    order_max: int = 4,
    fit_tolerance: float = 0.01,
    relaxation: float = 1.002,
) -> DkIterationResult:
    """Synthesise a controller by D-K iteration.

    Parameters
    ----------
    plant : control.StateSpace
        Generalised plant, continuous time: the channels' signals, then those of the controller.
    channels : sequence of UncertaintyChannel
        Full complex blocks in the order of the signals; the last one keeps the scaling 1.
    n_measurements, n_controls : int
        Numbers of the controller's inputs and outputs.
    frequency : array, shape (n,)
        Frequencies of the D step (rad/s), ascending.
    scalings : sequence of float, optional
        Constant scalings of the first K step, one for each channel; 1 by default.
    start : control.StateSpace, optional
        Controller whose loop gives the first scalings instead.
    rounds : int
        Largest number of rounds; the second one in succession that lowers mu by less than 0.1 % is the last.
    order_max : int
        Largest order of a scaling's filter.
    fit_tolerance : float
        Error of a filter's logarithm; see :func:`fit_filter_to_magnitude`.
    relaxation : float
        Factor on the smallest level; see ``hinfsyn``.

    Returns
    -------
    DkIterationResult

    Raises
    ------
    ArgumentError
        If the channels do not cover all signals of the plant but the controller's.
    MuflyError
        If the first K step finds no controller.
    """
    have = plant.noutputs - n_measurements, plant.ninputs - n_controls
    need = sum(c.outputs for c in channels), sum(c.inputs for c in channels)
    if have != need:
        raise ArgumentError(
            "channels", "",
            f"have {need[0]} outputs and {need[1]} inputs, but the plant has {have[0]} and {have[1]} of them",
            "give channels for all outputs and inputs",
        )  # fmt: skip
    none = np.zeros(0)
    filters = [ScalingFilter(float(d), none, none) for d in (scalings or [1.0] * len(channels))]
    done: list[DkIterationRound] = []
    best: DkIterationResult | None = None
    poor = 0

    def sweep_controller_mu(K: control.StateSpace) -> tuple[Array, Array]:
        return sweep_complex_mu(frequency_response(compute_lower_lft(plant, K), frequency), channels)

    def fit_scaling_filters(bound: Array, magnitudes: Array) -> list[ScalingFilter]:
        share = (bound / bound.max()) ** _FIT_WEIGHT_EXPONENT
        fitted = [fit_filter_to_magnitude(frequency, d, order_max, fit_tolerance, share) for d in magnitudes.T[:-1]]
        return [*fitted, ScalingFilter(1.0, none, none)]

    if start is not None:
        filters = fit_scaling_filters(*sweep_controller_mu(start))
    for k in range(rounds):
        try:
            found = _synthesise_hinf_controller(
                scale_uncertainty_channels(plant, channels, filters), n_measurements, n_controls, relaxation
            )
        except MuflyError:
            if best is None:
                raise
            break
        bound, magnitudes = sweep_controller_mu(found.controller)
        peak = float(bound.max())
        done.append(DkIterationRound(found.gamma, peak, found.controller.nstates))
        poor = poor + 1 if best is not None and peak > 0.999 * best.mu else 0
        if best is None or peak < best.mu:
            best = DkIterationResult(
                found.controller, found.anti_windup_matrix, found.gamma, peak, frequency, bound, ()
            )
        if poor == 2 or k + 1 == rounds:
            break
        filters = fit_scaling_filters(bound, magnitudes)
    assert best is not None
    return DkIterationResult(
        best.controller, best.anti_windup_matrix, best.gamma, best.mu, frequency, best.bound, tuple(done)
    )


def _synthesise_hinf_controller(
    plant: control.StateSpace, n_measurements: int, n_controls: int, relaxation: float
) -> HinfResult:
    try:
        return hinfsyn(plant, n_measurements, n_controls, relaxation=relaxation)
    except MuflyError:
        return hinfsyn(
            plant, n_measurements, n_controls, relaxation=relaxation, regularisation=_SYNTHESIS_REGULARISATION
        )
