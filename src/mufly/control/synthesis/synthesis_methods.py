"""Methods of controller synthesis with a common result: the controller, its anti-windup input, and the norm that it
claims and reaches.

All methods start from the same scaled plant and the same generalised plant, so their loops are comparable. The
H-infinity norm is computed from the loop, also for methods that do not minimise it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import control
import numpy as np

from mufly.control.linear_systems import Array, hinf_norm, state_space
from mufly.control.robust.dk_iteration import iterate_dk
from mufly.control.robust.uncertain_plant import add_uncertainty
from mufly.control.synthesis.h2 import h2syn
from mufly.control.synthesis.hinf import compute_lower_lft, hinfsyn
from mufly.control.synthesis.indi import IndiGains, design_indi
from mufly.control.synthesis.lqg import LqgWeights, design_lqg, find_largest_ltr_parameter
from mufly.control.tuning.fixed_order import (
    NormGoal,
    add_input_delay,
    evaluate_goal_norms,
    make_flight_goals,
    reduce_start_controllers,
    tune_controller,
)
from mufly.errors import MuflyError

SynthesisMethod = Literal["hinf", "h2", "lqg", "ltr", "mu", "fixed", "scheduled", "indi"]
SYNTHESIS_METHODS: tuple[SynthesisMethod, ...] = get_args(SynthesisMethod)
SYNTHESIS_METHOD_NAMES: dict[SynthesisMethod, str] = {
    "hinf": "H-infinity",
    "h2": "H2",
    "lqg": "LQG",
    "ltr": "LQG/LTR",
    "mu": "mu (D-K)",
    "fixed": "fixed order",
    "scheduled": "scheduled",
    "indi": "INDI",
}


@dataclass(frozen=True)
class FixedOrderGoals:
    """Order of a tuned controller, and the levels that the norms of its loop are to stay below.

    Attributes
    ----------
    order : int
    sensitivity_dB, complementary_dB : float
        Levels of the peaks of S_u and T_u with the delay of the sampled loop.
    weighted_norm_ratio, noise_norm_ratio : float
        Levels of the weighted norm, and of the norm from sensor noise to the inputs, relative to H-infinity.
    output_noise_std : tuple of float
        Noise of every output (SI).
    descents : int
        Number of starts from which the tuning descends.
    """

    order: int
    sensitivity_dB: float
    complementary_dB: float
    output_noise_std: tuple[float, ...]
    weighted_norm_ratio: float = 1.015
    noise_norm_ratio: float = 1.0
    descents: int = 2


@dataclass(frozen=True)
class DkIterationSettings:
    """Settings of D-K iteration.

    Attributes
    ----------
    rounds : int
        Rounds of the iteration.
    filter_order : int
        Largest order of a scaling's filter.
    input_uncertainty : float
        Relative uncertainty of every plant input at low frequency; see ``robust.uncertain_plant``.
    frequencies : tuple of (float, float, int)
        Lowest and highest frequency (rad/s) of the D step, and their number.
    relaxation : float
        Factor on the smallest level; see ``hinfsyn``.
    """

    rounds: int = 3
    filter_order: int = 1
    input_uncertainty: float = 0.2
    frequencies: tuple[float, float, int] = (0.3, 300.0, 30)
    relaxation: float = 1.05


@dataclass(frozen=True)
class GivenController:
    """A controller of continuous time in physical units, from references (if any) and errors to the plant's inputs.

    Attributes
    ----------
    A, B, C, D : tuple of tuple of float
        Matrices by rows.
    """

    A: tuple[tuple[float, ...], ...]
    B: tuple[tuple[float, ...], ...]
    C: tuple[tuple[float, ...], ...]
    D: tuple[tuple[float, ...], ...]

    @classmethod
    def from_matrices(cls, A: Array, B: Array, C: Array, D: Array) -> GivenController:
        """Make the controller from its state-space matrices A, B, C and D."""
        return cls(*(tuple(tuple(float(v) for v in row) for row in np.asarray(M)) for M in (A, B, C, D)))

    @property
    def order(self) -> int:
        """Number of states of the controller."""
        return len(self.A)

    def to_scaled_units(
        self, generalised: control.StateSpace, read_scale: Array, input_scale: Array
    ) -> control.StateSpace:
        """Return the controller in scaled units, with the signals of the generalised plant.

        Raises
        ------
        MuflyError
            If its size does not fit the plant.
        """
        n, m = len(read_scale), len(input_scale)
        A, B, C, D = (np.array(M, dtype=float) for M in (self.A, self.B, self.C, self.D))
        k = self.order
        if A.shape != (k, k) or B.shape != (k, n) or C.shape != (m, k) or D.shape != (m, n):
            raise MuflyError(f"the given controller is not one of {n} inputs and {m} outputs; tune it for this loop")
        out = np.asarray(input_scale)[:, None]
        return state_space(
            A, B * read_scale, C / out, D * read_scale / out,
            inputs=generalised.output_labels[-n:], outputs=generalised.input_labels[-m:],
        )  # fmt: skip


class SynthesisProblem(NamedTuple):
    """One loop to design, in scaled units.

    Attributes
    ----------
    generalised_plant : control.StateSpace
        Plant with weights; its last outputs and inputs are those of the controller.
    plant : control.StateSpace
        Plant without weights.
    referenced_outputs : tuple of int
        Outputs of the plant with a reference.
    two_degrees : bool
        Whether the controller reads references and errors apart.
    n_measurements : int
        Number of the controller's inputs.
    relaxation : float
        Factor on the smallest H-infinity level; see ``hinfsyn``.
    lqg : LqgWeights or None
        Weights of LQG and LTR.
    fixed : FixedOrderGoals or None
        Goals of a tuned controller, with the noise in scaled units.
    generalise : callable
        Function from the scaled plant to the plant with weights.
    sampling_rate_rad_s : float
        Sampling rate of the controller (rad/s).
    given_controller : control.StateSpace or None
        Controller that exists, in place of a synthesis; for ``scheduled`` the one whose states are kept.
    derivatives : tuple of array
        Derivatives ``[dA dB]`` of the plant by uncertain parameters, one spread each, for ``mu``.
    robust : DkIterationSettings
        Settings of ``mu``.
    indi : IndiGains or None
        Gains of INDI.
    """

    generalised_plant: control.StateSpace
    plant: control.StateSpace
    referenced_outputs: tuple[int, ...]
    two_degrees: bool
    n_measurements: int
    relaxation: float
    lqg: LqgWeights | None
    fixed: FixedOrderGoals | None
    generalise: Callable[[control.StateSpace], control.StateSpace]
    sampling_rate_rad_s: float
    given_controller: control.StateSpace | None = None
    derivatives: tuple[Array, ...] = ()
    robust: DkIterationSettings = DkIterationSettings()
    indi: IndiGains | None = None


class SynthesisedController(NamedTuple):
    """A controller in scaled units.

    Attributes
    ----------
    controller : control.StateSpace
    anti_windup_matrix : array, shape (states, controls)
        Effect of actuation beyond the command on its states; see ``hinf.HinfResult.anti_windup_matrix``.
    gamma, gamma_optimal : float
        Level claimed and smallest level, of mu for D-K iteration; nan for a method that claims none.
    norm : float
        H-infinity norm of the weighted loop.
    """

    controller: control.StateSpace
    anti_windup_matrix: Array
    gamma: float
    gamma_optimal: float
    norm: float


def synthesise_controller(method: SynthesisMethod, problem: SynthesisProblem) -> SynthesisedController:
    """Synthesise a controller by a method, or by H-infinity if the problem has no settings for this method.

    The method ``fixed`` gives its own order, the others the full order.

    ``scheduled`` tunes C and D of the given controller; see :mod:`mufly.control.tuning.output_schedule`.

    Raises
    ------
    MuflyError
        If the method finds no controller; the message names the cause.
    """
    p, n_controls = problem, problem.plant.ninputs
    if method == "scheduled" and p.fixed is not None and p.given_controller is not None:
        goals, _ = _make_fixed_order_goals(p, p.fixed, _delayed_plants(p))
        tuned = tune_controller(goals, [p.given_controller], outputs_only=True)
        return _wrap_given_controller(p, tuned.controller)
    if p.given_controller is not None:
        return _wrap_given_controller(p, p.given_controller)
    if method == "h2":
        optimal = h2syn(p.generalised_plant, p.n_measurements, n_controls)
        norm = hinf_norm(optimal.closed_loop)[0]
        return SynthesisedController(optimal.controller, optimal.anti_windup_matrix, np.nan, np.nan, norm)
    if method in ("lqg", "ltr") and p.lqg is not None:
        recovery = find_largest_ltr_parameter(p.plant, p.lqg, p.sampling_rate_rad_s) if method == "ltr" else None
        lqg = design_lqg(p.plant, p.referenced_outputs, p.lqg, recovery=recovery, two_degrees=p.two_degrees)
        norm = hinf_norm(compute_lower_lft(p.generalised_plant, lqg.controller))[0]
        return SynthesisedController(lqg.controller, lqg.anti_windup_matrix, np.nan, np.nan, norm)
    if method == "indi" and p.indi is not None:
        law = design_indi(p.plant, p.indi, 2 * np.pi / p.sampling_rate_rad_s)
        norm = hinf_norm(compute_lower_lft(p.generalised_plant, law.controller))[0]
        return SynthesisedController(law.controller, law.anti_windup_matrix, np.nan, np.nan, norm)
    if method == "mu":
        return _iterate_dk(p, p.robust)
    if method == "fixed" and p.fixed is not None:
        return _tune_fixed_order(p, p.fixed)
    found = hinfsyn(p.generalised_plant, p.n_measurements, n_controls, relaxation=p.relaxation)
    return SynthesisedController(
        found.controller, found.anti_windup_matrix, found.gamma, found.gamma_optimal, found.norm
    )


def _iterate_dk(p: SynthesisProblem, goals: DkIterationSettings) -> SynthesisedController:
    """Return the controller of D-K iteration for the plant with delay and uncertainty, starting from H-infinity."""
    n_controls = p.plant.ninputs
    generalised = p.generalise(add_input_delay(p.plant, 1.5 * 2 * np.pi / p.sampling_rate_rad_s))
    uncertain, channels = add_uncertainty(
        generalised, p.plant, p.n_measurements, p.derivatives, goals.input_uncertainty
    )
    found = iterate_dk(
        uncertain,
        channels,
        p.n_measurements,
        n_controls,
        np.geomspace(*goals.frequencies),
        start=hinfsyn(p.generalised_plant, p.n_measurements, n_controls, relaxation=p.relaxation).controller,
        rounds=goals.rounds,
        order_max=goals.filter_order,
        fit_tolerance=0.1,
        relaxation=goals.relaxation,
    )
    norm = hinf_norm(compute_lower_lft(p.generalised_plant, found.controller))[0]
    return SynthesisedController(found.controller, found.anti_windup_matrix, found.gamma, found.gamma, norm)


def _tune_fixed_order(p: SynthesisProblem, fixed: FixedOrderGoals) -> SynthesisedController:
    """Return the best tuned controller; the starting points are reduced H-infinity (with and without delay) and LTR
    designs.
    """
    delayed = _delayed_plants(p)
    goals, plain = _make_fixed_order_goals(p, fixed, delayed)
    generalised = delayed[0]
    starts = [plain, hinfsyn(generalised, p.n_measurements, p.plant.ninputs, relaxation=p.relaxation).controller]
    if p.lqg is not None:
        starts.append(synthesise_controller("ltr", p).controller)
    tuned = tune_controller(goals, reduce_start_controllers(generalised, starts, fixed.order), descents=fixed.descents)
    return _wrap_given_controller(p, tuned.controller)


def _delayed_plants(p: SynthesisProblem) -> tuple[control.StateSpace, control.StateSpace]:
    """Return the generalised plant and the plant without weights, both with 1.5 periods of delay."""
    delayed = add_input_delay(p.plant, 1.5 * 2 * np.pi / p.sampling_rate_rad_s)
    return p.generalise(delayed), delayed


def _make_fixed_order_goals(
    p: SynthesisProblem, fixed: FixedOrderGoals, delayed: tuple[control.StateSpace, control.StateSpace]
) -> tuple[list[NormGoal], control.StateSpace]:
    """Return the tuning goals on the delayed plants, and the H-infinity controller whose norms scale the levels."""
    plain = hinfsyn(p.generalised_plant, p.n_measurements, p.plant.ninputs, relaxation=p.relaxation)
    levels = {
        "weighted": fixed.weighted_norm_ratio * plain.norm,
        "sensitivity": 10 ** (fixed.sensitivity_dB / 20),
        "complementary": 10 ** (fixed.complementary_dB / 20),
        "noise": 1.0,
    }
    noise = np.array(fixed.output_noise_std)
    goals = make_flight_goals(*delayed, p.n_measurements, noise, levels)
    reached = evaluate_goal_norms(goals, plain.controller)["noise"]
    goals = [goal._replace(level=fixed.noise_norm_ratio * reached) if goal.name == "noise" else goal for goal in goals]
    return goals, plain.controller


def _wrap_given_controller(p: SynthesisProblem, K: control.StateSpace) -> SynthesisedController:
    """Return a given controller as a result of synthesis: with the norm of its loop and without anti-windup input."""
    norm = hinf_norm(compute_lower_lft(p.generalised_plant, K))[0]
    return SynthesisedController(K, np.zeros((K.nstates, p.plant.ninputs)), np.nan, np.nan, norm)
