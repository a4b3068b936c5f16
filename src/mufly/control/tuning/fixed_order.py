"""Controllers of a given order, tuned so that several norms of the loop stay below their levels.

The controller's matrices ``[Ak Bk; Ck Dk]`` are one static gain of a plant whose states include the controller's. With
this gain every goal is the H-infinity norm of a closed loop; the objective is the largest of ``norm / level``. At the
peak, with frequency w and singular vectors u and v, the gradient is ``Re (u* T_zu)' (T_yw v)'`` (Gumussoy and Overton,
ACC 2008). BFGS for functions with kinks descends from reduced controllers of other methods.

Goals of a flight loop, on the scaled plant with 1.5 periods of delay (Pade approximation of second order):

- ``weighted``: the generalised plant's norm, the goal of the H-infinity design;
- ``sensitivity`` and ``complementary``: the peaks of S_u and T_u, which the sampled loop then has nearly;
- ``noise``: from the sensors' noise to the inputs. Without it the tuning buys margins with servo activity;
- ``activity``: the deviation of the inputs by the sensors' noise, an H2 norm. A sampled sequence of noise is modelled
  as white noise behind a pole at ``2 / T``, which has the sequence's variance;
- ``disk``: the inverse of the disk margin with a factor of its own on each input.

A goal is any object with a name, a level and a ``loop`` that returns norm and gradient; see :class:`TuningGoal`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import control
import numpy as np
from scipy import linalg, signal

from mufly.control.analysis.loop_margins import scalar_block_mu
from mufly.control.implementation import balanced_realisations, keep_leading_states, separate_slow_modes
from mufly.control.linear_systems import Array, replace_matrices, state_space
from mufly.control.synthesis.hinf import PartitionedPlant, partition_plant
from mufly.control.tuning.nonsmooth_bfgs import minimise_nonsmooth
from mufly.errors import MuflyError
from mufly.results import result

_FREQUENCIES = np.concatenate([[1e-7, 1e-6, 1e-5, 1e-4], np.geomspace(1e-3, 3e3, 90)])
_SLOW_MODE_LIMITS_RAD_S = (0.1, 3.0)  # rad/s; modes of a start below these are kept by its reduction
_GOAL_MEAN_EXPONENTS = (8.0, 30.0, np.inf)  # of the mean of all goals, in successive descents; inf is the largest
_MIN_POLE_DISTANCE_RAD_S = 1e-5  # rad/s; least distance of the closed loop's poles from the axis


class LoopNormByGain(Protocol):
    """Norm of a loop as a function of the controller's matrices ``[Ak Bk; Ck Dk]``."""

    def norm_and_gradient(self, K: Array) -> tuple[float, Array]:
        """Return the norm, ``inf`` for an unstable loop, and its gradient."""


class TuningGoal(Protocol):
    """Interface of a tuning goal: a norm that is to stay below a level."""

    @property
    def name(self) -> str:
        """Name of the goal in results and messages."""

    @property
    def level(self) -> float:
        """Level that the norm is to stay below."""

    def make_loop_norm(self, order: int) -> LoopNormByGain:
        """Return the norm as a function of the gain of a controller of this order."""


class NormGoal(NamedTuple):
    """Tuning goal: a norm of a closed loop is to stay below a level.

    Attributes
    ----------
    name : str
    plant : PartitionedPlant
        From disturbance to error, with the controller's signals.
    level : float
        Level of the norm.
    kind : str
        ``"hinf"``, ``"h2"`` (of a loop without feedthrough), or ``"disk"``: the structured singular value of one or two
        scalar complex blocks.
    """

    name: str
    plant: PartitionedPlant
    level: float
    kind: str = "hinf"

    def make_loop_norm(self, order: int) -> LoopNormByGain:
        """Return the norm as a function of the gain of a controller of this order."""
        return _StaticLoop(self.plant, order, self.kind)


@result
class TunedController:
    """A tuned controller, with the norm that it reaches for each goal.

    Attributes
    ----------
    controller : control.StateSpace
        Controller in scaled units.
    objective, start_objective : float
        Largest norm over its level: at the end and at the start. Below 1 all goals are reached.
    norms, goal_levels : dict
        Norm and level of every goal, by its name.
    steps : int
        Steps of the descent.
    """

    controller: control.StateSpace
    objective: float
    start_objective: float
    norms: dict[str, float]
    goal_levels: dict[str, float]
    steps: int


def add_input_delay(plant: control.StateSpace, delay_s: float) -> control.StateSpace:
    """Return the plant with a delay at every input, as a Pade approximation of second order."""
    A1, B1, C1, D1 = (np.kron(np.eye(plant.ninputs), X) for X in signal.tf2ss(*control.pade(delay_s, 2)))
    A = np.block([[plant.A, plant.B @ C1], [np.zeros((len(A1), plant.nstates)), A1]])
    return state_space(
        A,
        np.vstack([plant.B @ D1, B1]),
        np.hstack([plant.C, np.zeros((plant.noutputs, len(A1)))]),
        np.zeros((plant.noutputs, plant.ninputs)),
        inputs=plant.input_labels,
        outputs=plant.output_labels,
    )


def make_goal_plants(
    plant: control.StateSpace, noise: Array, n_measurements: int, period_s: float = 0.0
) -> dict[str, PartitionedPlant]:
    """Return the generalised plant of each tuning goal except ``weighted``.

    The last inputs of the controller are ``-y``.

    ``activity`` is among them if a sampling period is given.
    """
    n, p, m = plant.nstates, plant.noutputs, plant.ninputs
    C2 = np.vstack([np.zeros((n_measurements - p, n)), -plant.C])
    none, eye = np.zeros((n_measurements, m)), np.eye(m)
    N = np.vstack([np.zeros((n_measurements - p, p)), -np.diag(noise)])
    zero = np.zeros((m, n))
    found = {
        "sensitivity": PartitionedPlant(plant.A, plant.B, plant.B, zero, C2, eye, eye, none, none),
        "disk": PartitionedPlant(plant.A, plant.B, plant.B, zero, C2, 0.5 * eye, eye, none, none),
        "complementary": PartitionedPlant(plant.A, plant.B, plant.B, zero, C2, 0 * eye, eye, none, none),
        "noise": PartitionedPlant(plant.A, np.zeros((n, p)), plant.B, zero, C2, np.zeros((m, p)), eye, N, none),
    }
    if period_s > 0.0:
        pole = 2.0 / period_s
        found["activity"] = PartitionedPlant(
            linalg.block_diag(plant.A, -pole * np.eye(p)),
            np.vstack([np.zeros((n, p)), np.sqrt(period_s) * pole * np.eye(p)]),
            np.vstack([plant.B, np.zeros((p, m))]),
            np.zeros((m, n + p)),
            np.hstack([C2, N]),
            np.zeros((m, p)),
            eye,
            0.0 * N,
            none,
        )
    return found


class _StaticLoop:
    """Closed loop of one goal as static output feedback: the plant is augmented by the states of the controller."""

    def __init__(self, p: PartitionedPlant, order: int, kind: str = "hinf") -> None:
        self.kind = kind
        n, m, ny, k = p.A.shape[0], p.B2.shape[1], p.C2.shape[0], order
        self.A = linalg.block_diag(p.A, np.zeros((k, k)))
        self.B = np.block([[np.zeros((n, k)), p.B2], [np.eye(k), np.zeros((k, m))]])
        self.C = np.block([[np.zeros((k, n)), np.eye(k)], [p.C2, np.zeros((ny, k))]])
        self.B1 = np.vstack([p.B1, np.zeros((k, p.B1.shape[1]))])
        self.C1 = np.hstack([p.C1, np.zeros((p.C1.shape[0], k))])
        self.D11 = p.D11
        self.D12 = np.hstack([np.zeros((p.D12.shape[0], k)), p.D12])
        self.D21 = np.vstack([np.zeros((k, p.D21.shape[1])), p.D21])

    def norm_and_gradient(self, K: Array) -> tuple[float, Array]:
        """Return the norm with the gain K, ``inf`` for an unstable loop, and its gradient by K."""
        A = self.A + self.B @ K @ self.C
        B, C = self.B1 + self.B @ K @ self.D21, self.C1 + self.D12 @ K @ self.C
        D = self.D11 + self.D12 @ K @ self.D21
        values, V = np.linalg.eig(A)
        if values.real.max() >= -_MIN_POLE_DISTANCE_RAD_S:
            return np.inf, np.zeros_like(K)
        if self.kind == "h2":
            P = linalg.solve_continuous_lyapunov(A, -B @ B.T)
            Q = linalg.solve_continuous_lyapunov(A.T, -C.T @ C)
            norm = float(np.sqrt(max(np.trace(C @ P @ C.T), 0.0)))
            slope = (self.B.T @ Q + self.D12.T @ C) @ P @ self.C.T + self.B.T @ Q @ B @ self.D21.T
            return norm, slope / max(norm, 1e-300)
        try:
            VB = np.linalg.solve(V, B.astype(complex))
        except np.linalg.LinAlgError:
            return np.inf, np.zeros_like(K)
        CV = C @ V

        def largest_gain_or_mu(w: Array) -> Array:
            response = (CV[None] / (1j * w[:, None, None] - values)) @ VB + D
            if self.kind == "disk":
                return scalar_block_mu(response)
            # Singular values of small matrices by the smaller Gram matrix.
            wide = response.shape[1] > response.shape[2]
            turned = response.conj().swapaxes(1, 2)
            gram = turned @ response if wide else response @ turned
            return np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[:, -1], 0.0))

        w = np.unique(np.concatenate([_FREQUENCIES, np.abs(values), np.abs(values.imag[values.imag > 1e-3])]))
        size = largest_gain_or_mu(w)
        # Every peak near the largest is refined, so that the norm is continuous where two of them change places.
        inside = size[1:-1]
        peaks = 1 + np.flatnonzero((inside >= size[:-2]) & (inside >= size[2:]) & (inside > 0.9 * size.max()))
        best, top = float(w[int(np.argmax(size))]), float(size.max())
        for i in peaks:
            around, height = w[[i - 1, i, i + 1]], size[[i - 1, i, i + 1]]
            for _ in range(4):
                k = int(np.argmax(height))
                around = np.geomspace(around[max(k - 1, 0)], around[min(k + 1, around.size - 1)], 9)
                height = largest_gain_or_mu(around)
            k = int(np.argmax(height))
            if height[k] > top:
                best, top = float(around[k]), float(height[k])
        T = np.linalg.inv(1j * best * np.eye(len(A)) - A)
        M = C @ T @ B + D
        rows, columns = np.ones(M.shape[0]), np.ones(M.shape[1])
        if self.kind == "disk" and len(M) == 2:  # the scaling that attains the structured singular value
            rows[0] = columns[0] = np.sqrt(max(abs(M[1, 0]), 1e-12) / max(abs(M[0, 1]), 1e-12))
        U, s, Vh = np.linalg.svd(rows[:, None] * M / columns)
        left = (U[:, 0].conj() * rows) @ (C @ T @ self.B + self.D12)
        right = (self.C @ T @ B + self.D21) @ (Vh[0].conj() / columns)
        return float(s[0]), np.outer(left, right).real


def stack_controller_matrices(K: control.StateSpace) -> Array:
    """Return the matrices A, B, C, D of a controller as one gain matrix ``[A B; C D]``."""
    return np.block([[K.A, K.B], [K.C, K.D]])


def evaluate_goal_norms(goals: Sequence[TuningGoal], controller: control.StateSpace) -> dict[str, float]:
    """Return the norm of every goal with a controller, by name; ``inf`` for an unstable loop."""
    K = stack_controller_matrices(controller)
    return {goal.name: goal.make_loop_norm(controller.nstates).norm_and_gradient(K)[0] for goal in goals}


def reduce_start_controllers(
    generalised: control.StateSpace, controllers: Sequence[control.StateSpace], order: int
) -> list[control.StateSpace]:
    """Return all balanced reductions of ``controllers`` to one order, as starting points of a tuning."""
    found = []
    for K in controllers:
        if K.nstates < order:
            continue
        counts = set()
        for threshold in _SLOW_MODE_LIMITS_RAD_S:
            Z, kept = separate_slow_modes(K.A, threshold)
            if kept in counts or kept > order:
                continue
            counts.add(kept)
            actuation = np.zeros((K.nstates, K.noutputs))
            for whole, M in balanced_realisations(generalised, K, actuation, Z, kept).values():
                for match in (True, False):
                    removed = keep_leading_states(whole, M, order, match)
                    if removed is not None:
                        found.append(removed[0])
    return found


def tune_controller(
    goals: Sequence[TuningGoal],
    starts: Sequence[control.StateSpace],
    *,
    descents: int = 2,
    max_steps: int = 400,
    budget_s: float = 30.0,
    outputs_only: bool = False,
) -> TunedController:
    """Tune a controller of fixed order for several goals.

    Parameters
    ----------
    goals : sequence of TuningGoal
    starts : sequence of control.StateSpace
        Controllers of the required order; descents begin at the best of them.
    descents : int
        Number of starts used.
    max_steps : int
        Steps of one descent.
    budget_s : float
        Processor time for one descent (s).
    outputs_only : bool
        Whether A and B of the controller stay as they are, so that only C and D are tuned.

    Returns
    -------
    TunedController
        Never worse than the best start.

    Raises
    ------
    MuflyError
        If no start stabilises all plants.
    """
    if not starts:
        raise MuflyError("tuning: no starting controller has this order; choose another order")
    order = starts[0].nstates
    loops = [goal.make_loop_norm(order) for goal in goals]
    shape = stack_controller_matrices(starts[0]).shape

    def objective(K: Array, power: float = np.inf) -> tuple[float, Array]:
        """Return the largest ratio of norm to level, or the power mean of all ratios, and its gradient by K."""
        shares, slopes = np.empty(len(goals)), np.empty((len(goals), *shape))
        for i, (goal, loop) in enumerate(zip(goals, loops, strict=True)):
            norm, gradient = loop.norm_and_gradient(K)
            if not np.isfinite(norm):
                return np.inf, np.zeros(shape)
            shares[i], slopes[i] = norm / goal.level, gradient / goal.level
        if outputs_only:
            slopes[:, :order] = 0.0
        worst = int(np.argmax(shares))
        if not np.isfinite(power):
            return float(shares[worst]), slopes[worst]
        weights = (shares / shares[worst]) ** power
        value = shares[worst] * weights.mean() ** (1.0 / power)
        return float(value), np.tensordot(weights / shares / weights.sum(), slopes, 1) * value

    ranked = sorted(((objective(stack_controller_matrices(K))[0], i) for i, K in enumerate(starts)))
    ranked = [r for r in ranked if np.isfinite(r[0])][:descents]
    if not ranked:
        raise MuflyError(f"tuning: no starting controller of order {order} stabilises the loop; choose a higher order")
    best, best_K, first, steps = np.inf, stack_controller_matrices(starts[0]), ranked[0][0], 0
    for _, i in ranked:
        K, value, done, began = stack_controller_matrices(starts[i]), np.inf, 0, time.process_time()
        for power in _GOAL_MEAN_EXPONENTS:
            K0 = K
            row, column = np.abs(K0).max(axis=1, keepdims=True), np.abs(K0).max(axis=0, keepdims=True)
            unit = np.abs(K0) + 0.05 * np.sqrt(row * column) + 1e-6  # entries of size one for the search

            def scaled_objective(
                x: Array, K0: Array = K0, unit: Array = unit, power: float = power
            ) -> tuple[float, Array]:
                mean, slope = objective(K0 + unit * x.reshape(shape), power)
                return mean, (slope * unit).ravel()

            left = budget_s - (time.process_time() - began)
            found = minimise_nonsmooth(
                scaled_objective,
                np.zeros(K0.size),
                max_steps=max_steps,
                tolerance=1e-4,
                window=20,
                first_step=0.1,
                budget_s=left,
            )
            K, done = K0 + unit * found.x.reshape(shape), done + found.steps
            value = objective(K)[0]
            if value < best:
                best, best_K, steps = value, K, done
            if left <= 0.0:
                break
    k = order
    tuned = replace_matrices(starts[0], A=best_K[:k, :k], B=best_K[:k, k:], C=best_K[k:, :k], D=best_K[k:, k:])
    return TunedController(
        tuned, best, first, evaluate_goal_norms(goals, tuned), {goal.name: goal.level for goal in goals}, steps
    )


def make_flight_goals(
    generalised: control.StateSpace,
    plant: control.StateSpace,
    n_measurements: int,
    noise: Array,
    levels: Mapping[str, float],
    period_s: float = 0.0,
) -> list[NormGoal]:
    """Return the goals of a flight loop; ``generalised`` and ``plant`` carry the delay.

    Parameters
    ----------
    generalised, plant : control.StateSpace
        Generalised and bare plant, scaled, with delay.
    n_measurements : int
        Number of the controller's inputs, the last of them the negative outputs of the plant.
    noise : array, shape (outputs,)
        Noise of the scaled outputs.
    levels : mapping
        Levels by name: ``weighted``, ``sensitivity``, ``complementary``, ``noise``, ``activity``, ``disk``; an absent
        name sets no goal.
    period_s : float
        Sampling period, for ``activity``.
    """
    weighted = partition_plant(
        generalised.A, generalised.B, generalised.C, generalised.D, n_measurements, plant.ninputs
    )
    plants = {"weighted": weighted, **make_goal_plants(plant, noise, n_measurements, period_s)}
    kinds = {"activity": "h2", "disk": "disk"}
    return [NormGoal(name, plants[name], level, kinds.get(name, "hinf")) for name, level in levels.items()]
