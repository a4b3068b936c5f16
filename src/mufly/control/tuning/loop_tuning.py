"""Tuning of a vehicle's heave-yaw or roll-pitch loop for several goals at once, in rounds that can be continued.

A round minimises the largest ratio of a goal to its level (:func:`tune_controller`), then finds new scalings of mu
(:class:`RobustnessGoal`). Each start has its own sequence of rounds, a line; the result is the best controller of all
rounds. After each round the state contains everything that the next round needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import control
import numpy as np

from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import FlightController
from mufly.control.linear_systems import Array, replace_matrices
from mufly.control.robust.parameter_robustness import UncertainLoop
from mufly.control.robust.parameter_spreads import differentiate_plants_by_parameters
from mufly.control.synthesis.hinf import hinfsyn
from mufly.control.synthesis.synthesis_methods import GivenController, SynthesisProblem, synthesise_controller
from mufly.control.synthesis.weighting_schemes import (
    DesignSettings,
    scale_plant,
    weight_heave_yaw_plant,
    weight_roll_pitch_plant,
)
from mufly.control.tuning.fixed_order import (
    TuningGoal,
    add_input_delay,
    evaluate_goal_norms,
    make_flight_goals,
    reduce_start_controllers,
    stack_controller_matrices,
    tune_controller,
)
from mufly.control.tuning.robustness_goal import RobustnessGoal
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle

LoopName = Literal["heave-yaw", "roll-pitch"]
_PADDING_POLE_RAD_S = 300.0  # rad/s, of states that a start of lower order gets
_INPUT_DELAY_PERIODS = 1.5


@dataclass(frozen=True)
class GoalLevels:
    """Upper limits of the goals of a tuning; None leaves out a goal.

    Attributes
    ----------
    gamma : float or None
        Norm of the weighted loop, with the delay.
    sensitivity_dB, complementary_dB : float or None
        Peaks of S_u and T_u.
    disk_margin : float or None
        Disk margin with a disturbance of its own on each input.
    activity : float or None
        Deviation of the inputs by sensor noise (root of the sum of squares), relative to the H-infinity design.
    mu : float or None
        Upper bound of mu over the vehicle's parameters.
    """

    gamma: float | None = None
    sensitivity_dB: float | None = None
    complementary_dB: float | None = None
    disk_margin: float | None = None
    activity: float | None = None
    mu: float | None = None

    def norm_levels(self) -> dict[str, float]:
        """Return the levels of all goals except mu, converted to norms, by the names of :func:`make_flight_goals`."""
        found = {
            "weighted": self.gamma,
            "sensitivity": None if self.sensitivity_dB is None else 10 ** (self.sensitivity_dB / 20),
            "complementary": None if self.complementary_dB is None else 10 ** (self.complementary_dB / 20),
            "disk": None if self.disk_margin is None else 1.0 / self.disk_margin,
            "activity": self.activity,
        }
        return {name: level for name, level in found.items() if level is not None}

    def replace_levels(self, other: Mapping[str, float | None]) -> GoalLevels:
        """Return the goal levels; a level that ``other`` states replaces the former one."""
        changes: dict[str, Any] = {k: v for k, v in other.items() if v is not None}
        return replace(self, **changes)


DEFAULT_GOALS: dict[LoopName, GoalLevels] = {
    "heave-yaw": GoalLevels(gamma=1.05, sensitivity_dB=3.2, complementary_dB=3.1, activity=1.2),
    "roll-pitch": GoalLevels(
        gamma=0.66, sensitivity_dB=2.5, complementary_dB=2.4, disk_margin=0.97, activity=1.0, mu=0.6
    ),
}
"""Goals of a tuning by the name of the loop."""
DEFAULT_ORDERS: dict[LoopName, int] = {"heave-yaw": 6, "roll-pitch": 4}
HIGHEST_ORDERS: dict[LoopName, int] = {"heave-yaw": 10, "roll-pitch": 8}
"""Largest orders that the law on board holds."""


class LoopTuningProblem(NamedTuple):
    """Tuning problem of one loop: design, plant, goals and scales.

    Attributes
    ----------
    name : str
    design : ControllerDesign
        H-infinity design of the loop.
    generalised_plant : control.StateSpace
        Scaled plant with weights and delay.
    goals : list of TuningGoal
    mu : RobustnessGoal or None
    read_scale, input_scale : array
        Scales of the controller's inputs and outputs.
    synthesis : SynthesisProblem
        The loop without delay.
    """

    name: LoopName
    design: ControllerDesign
    generalised_plant: control.StateSpace
    goals: list[TuningGoal]
    mu: RobustnessGoal | None
    read_scale: Array
    input_scale: Array
    synthesis: SynthesisProblem


class TuningState(NamedTuple):
    """State of a tuning between two rounds; JSON data by :meth:`to_record`.

    Attributes
    ----------
    lines : tuple
        For each start its controller ``[A B; C D]`` (scaled) as rows, and the objective after every round.
    """

    lines: tuple[tuple[tuple[tuple[float, ...], ...], tuple[float, ...]], ...] = ()

    def to_record(self) -> list[dict[str, Any]]:
        """Return the state as JSON data."""
        return [{"gain": K, "objectives": history} for K, history in self.lines]

    @classmethod
    def from_record(cls, record: Sequence[Mapping[str, Any]]) -> TuningState:
        """Return the state from JSON data, the inverse of :meth:`to_record`."""
        return cls(tuple((tuple(tuple(row) for row in line["gain"]), tuple(line["objectives"])) for line in record))


def make_loop_tuning_problem(
    vehicle: Vehicle,
    base: FlightController,
    name: LoopName,
    goal_levels: GoalLevels,
    noise: Array,
    spreads: Mapping[str, float],
) -> LoopTuningProblem:
    """Return the tuning problem of a loop: its design, its delayed plant, goals and scales.

    Parameters
    ----------
    vehicle : Vehicle
    base : FlightController
        H-infinity design of the vehicle.
    name : str
    goal_levels : GoalLevels
    noise : array, shape (outputs,)
        Deviation of each measured output from sample to sample (SI).
    spreads : mapping
        Spread of every parameter (SI) by its key, for mu.
    """
    heave = name == "heave-yaw"
    d, s = (base.heave_yaw if heave else base.roll_pitch), base.settings
    weight = weight_heave_yaw_plant if heave else weight_roll_pitch_plant
    output_scale, input_scale = np.array(d.scaling.outputs), np.array(d.scaling.inputs)
    n_references = d.controller.ninputs - d.plant.noutputs
    read = np.concatenate([output_scale[:n_references], output_scale])
    plant = scale_plant(d.plant, d.scaling)
    delayed = add_input_delay(plant, _INPUT_DELAY_PERIODS * base.period_s)
    generalised = weight(delayed, s)
    levels = goal_levels.norm_levels()
    norms = make_flight_goals(generalised, delayed, read.size, noise / output_scale, levels, base.period_s)
    if "activity" in levels:
        reached = evaluate_goal_norms(
            [a for a in norms if a.name == "activity"], _scale_controller(d.reduced, read, input_scale)
        )
        norms = [a._replace(level=a.level * reached["activity"]) if a.name == "activity" else a for a in norms]
    goals: list[TuningGoal] = [*norms]
    mu = None
    if goal_levels.mu is not None:
        E = differentiate_plants_by_parameters(vehicle, base.voltage_V, list(spreads), np.diag(list(spreads.values())))[
            name
        ]
        mu = RobustnessGoal(UncertainLoop(d, E), d.error_inputs, read, input_scale, goal_levels.mu)
        goals.append(mu)
    synthesis = SynthesisProblem(
        weight(plant, s), plant, (0, 1), n_references > 0, read.size,
        s.heave_yaw_relaxation if heave else s.roll_pitch_relaxation,
        s.heave_yaw_lqg if heave else s.roll_pitch_lqg, None,
        lambda scaled: weight(scaled, s), 2 * np.pi / base.period_s,
    )  # fmt: skip
    return LoopTuningProblem(name, d, generalised, goals, mu, read, input_scale, synthesis)


def _scale_controller(K: control.StateSpace, read: Array, input_scale: Array) -> control.StateSpace:
    out = input_scale[:, None]
    return replace_matrices(K, B=K.B * read, C=K.C / out, D=K.D * read / out)


def find_start_controllers(problem: LoopTuningProblem, names: Sequence[str], order: int) -> list[control.StateSpace]:
    """Return starting points of a given order: balanced reductions of the controllers of other methods.

    ``delay`` names the H-infinity controller whose plant has the delay.
    """
    full = []
    for name in names:
        if name == "delay":
            p = problem.synthesis
            full.append(hinfsyn(problem.generalised_plant, p.n_measurements, 2, relaxation=p.relaxation).controller)
        else:
            full.append(synthesise_controller(name, problem.synthesis).controller)  # type: ignore[arg-type]
    found = reduce_start_controllers(problem.generalised_plant, full, order)
    return [K for K in found if np.isfinite(max(evaluate_goal_norms(problem.goals, K).values()))]


def add_fast_states(controller: control.StateSpace, order: int) -> control.StateSpace:
    """Raise the order of a controller by fast states, which hardly change its response before the tuning."""
    k = order - controller.nstates
    if k <= 0:
        return controller
    K, rng = controller, np.random.default_rng(0)
    poles = -_PADDING_POLE_RAD_S * np.linspace(0.5, 1.0, k)
    size = 1e-2 * np.linalg.norm(K.D) / np.sqrt(K.ninputs * K.noutputs) if K.D.any() else 1e-2
    A = np.block([[K.A, np.zeros((K.nstates, k))], [np.zeros((k, K.nstates)), np.diag(poles)]])
    B = np.vstack([K.B, rng.normal(size=(k, K.ninputs)) * np.sqrt(_PADDING_POLE_RAD_S)])
    C = np.hstack([K.C, rng.normal(size=(K.noutputs, k)) * np.sqrt(_PADDING_POLE_RAD_S) * size])
    return replace_matrices(K, A=A, B=B, C=C)


def continue_tuning(
    problem: LoopTuningProblem,
    starts: Sequence[control.StateSpace],
    *,
    rounds: int,
    steps: int,
    state: TuningState | None = None,
    progress: Callable[[int, int, TuningState], None] | None = None,
) -> tuple[control.StateSpace, TuningState]:
    """Continue the tuning from each start until it has run the given number of rounds; return the best controller.

    Parameters
    ----------
    problem : LoopTuningProblem
    starts : sequence of control.StateSpace
        Starts of one order (scaled); descents begin at the best two of them.
    rounds, steps : int
        Rounds of a line, and steps of every descent in a round.
    state : TuningState, optional
        State of an earlier tuning with the same starts.
    progress : callable, optional
        Called after each round with (rounds done, all rounds, state).

    Returns
    -------
    controller : control.StateSpace
        The best one, scaled.
    state : TuningState

    Raises
    ------
    MuflyError
        If no start stabilises the loop.
    """
    if not starts:
        raise MuflyError(
            f"{problem.name}: no starting controller of this order stabilises the loop; give a higher order"
        )
    order = starts[0].nstates
    if state is None or not state.lines:
        quick = [goal for goal in problem.goals if goal is not problem.mu] or problem.goals
        levels = [goal.level for goal in quick]
        ranked = sorted(
            (max(n / v for n, v in zip(evaluate_goal_norms(quick, K).values(), levels, strict=True)), i)
            for i, K in enumerate(starts)
        )
        picked = [starts[i] for value, i in ranked if np.isfinite(value)][:2]
        if not picked:
            raise MuflyError(
                f"{problem.name}: no starting controller of order {order} stabilises the loop; give a higher order"
            )
        state = TuningState(
            tuple(
                (_matrix_rows(stack_controller_matrices(K)), (_largest_norm_level_ratio(problem, K),)) for K in picked
            )
        )
    every = list(state.lines)
    total = rounds * len(every)
    for i in range(len(every)):
        while len(every[i][1]) <= rounds:
            K = _controller_from_gain(starts[0], np.array(every[i][0]))
            if problem.mu is not None:
                problem.mu.update_scalings(stack_controller_matrices(K), order)
            found = tune_controller(problem.goals, [K], descents=1, max_steps=steps, budget_s=np.inf)
            value = _largest_norm_level_ratio(problem, found.controller)
            history = every[i][1]
            better = value < history[-1]
            every[i] = (
                _matrix_rows(stack_controller_matrices(found.controller)) if better else every[i][0],
                (*history, min(value, history[-1])),
            )
            if not better or value > history[-1] - 1e-4:  # nothing is left to gain on this line
                every[i] = (every[i][0], every[i][1] + (every[i][1][-1],) * (rounds + 1 - len(every[i][1])))
            state = TuningState(tuple(every))
            if progress is not None:
                progress(sum(len(h) - 1 for _, h in every), total, state)
    best = min(every, key=lambda line: line[1][-1])
    return _controller_from_gain(starts[0], np.array(best[0])), TuningState(tuple(every))


def _largest_norm_level_ratio(problem: LoopTuningProblem, K: control.StateSpace) -> float:
    """Return the largest ratio of a goal's norm to its level, with the mu goal's scalings updated for ``K``."""
    if problem.mu is not None:
        problem.mu.update_scalings(stack_controller_matrices(K), K.nstates)
    return max(
        norm / goal.level
        for goal, norm in zip(problem.goals, evaluate_goal_norms(problem.goals, K).values(), strict=True)
    )


def _matrix_rows(K: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in K)


def _controller_from_gain(like: control.StateSpace, gain: Array) -> control.StateSpace:
    k = like.nstates
    return replace_matrices(like, A=gain[:k, :k], B=gain[:k, k:], C=gain[k:, :k], D=gain[k:, k:])


def settings_with_tuned_controller(
    base: DesignSettings, problem: LoopTuningProblem, controller: control.StateSpace
) -> DesignSettings:
    """Return design settings in which one loop uses a tuned controller (given in scaled units)."""
    K, read, out = controller, problem.read_scale, problem.input_scale[:, None]
    given = GivenController.from_matrices(K.A, K.B / read, K.C * out, K.D * out / read)
    key = "heave_yaw_given" if problem.name == "heave-yaw" else "roll_pitch_given"
    changes: dict[str, Any] = {key: given}
    return replace(base, **changes)
