"""A tuned loop as a result and as a file that designs, flights and exports read."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from mufly.control.analysis.comparison import LoopMetrics, compute_loop_metrics, compute_output_noise_std
from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import FlightController, design_flight_controller
from mufly.control.robust.parameter_robustness import analyse_parameter_robustness
from mufly.control.robust.parameter_spreads import default_spreads
from mufly.control.synthesis.synthesis_methods import GivenController
from mufly.control.synthesis.weighting_schemes import DesignSettings, scale_plant
from mufly.control.tuning.fixed_order import evaluate_goal_norms
from mufly.control.tuning.loop_tuning import (
    HIGHEST_ORDERS,
    GoalLevels,
    LoopName,
    LoopTuningProblem,
    TuningState,
    add_fast_states,
    continue_tuning,
    find_start_controllers,
    make_loop_tuning_problem,
    settings_with_tuned_controller,
)
from mufly.errors import ArgumentError, InputError
from mufly.files.answer_store import hash_inputs, read_stored_result, write_stored_result
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle

DEFAULT_START_METHODS = ("hinf", "delay", "ltr")
_FILE_FORMAT = "mufly tuned controller 2"
_SETTINGS_KEY_BY_LOOP = {"heave-yaw": "heave_yaw_given", "roll-pitch": "roll_pitch_given"}
_GOAL_UNITS = {"weighted": "", "sensitivity": "dB", "complementary": "dB", "disk": "", "activity": "%", "mu": ""}


@result
class TunedLoop:
    """Tuned controller of one loop, with its figures.

    Attributes
    ----------
    loop : str
    order : int
    goal_levels, norms : dict
        Required bound and reached norm of each goal, by its name.
    figures : LoopMetrics
        Figures of the sampled controller; mu at frequencies other than the tuning's.
    flight_controller : FlightController
        The vehicle's whole controller, with this loop in place of its own.
    """

    loop: LoopName
    order: int
    goal_levels: dict[str, float]
    norms: dict[str, float]
    figures: LoopMetrics
    flight_controller: FlightController

    @property
    def objective(self) -> float:
        """Largest ratio of a goal's norm to its level; all goals are reached if it is below 1."""
        return max(self.norms[name] / level for name, level in self.goal_levels.items())

    @property
    def controller_design(self) -> ControllerDesign:
        """Complete design of the loop with the tuned controller: reduced, sampled and analysed."""
        c = self.flight_controller
        return c.heave_yaw if self.loop == "heave-yaw" else c.roll_pitch

    def as_record(self) -> dict[str, Any]:
        """Return goals and figures as JSON data."""
        f = self.figures
        return {
            "loop": self.loop,
            "order": self.order,
            "objective": self.objective,
            "goals": {name: {"level": level, "reached": self.norms[name]} for name, level in self.goal_levels.items()},
            "sampled": {
                "gamma": f.norm,
                "sensitivity_peak_dB": f.sampled.sensitivity_peak_dB,
                "complementary_peak_dB": f.sampled.complementary_peak_dB,
                "disk_margin": f.disk.margin,
                "input_noise": f.input_noise,
                "mu_upper": f.mu_upper,
                "mu_lower": f.mu_lower,
                "multiply_adds": f.multiply_adds,
            },
        }

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the text of the result: each goal with its level, and the figures of the loop."""
        rows = []
        for name, level in self.goal_levels.items():
            reached = self.norms[name]
            if _GOAL_UNITS[name] == "dB":
                level, shown, reached = 20 * np.log10(level), 20 * np.log10(reached), reached
                rows.append((f"{name} (dB)", f"{level:.2f}", f"{shown:.2f}", f"{reached / self.goal_levels[name]:.3f}"))
            else:
                rows.append((name, f"{level:.4g}", f"{reached:.4g}", f"{reached / level:.3f}"))
        f, s = self.figures, self.figures.sampled
        c = self.flight_controller
        title = f"{c.vehicle_name}, {self.loop}, order {self.order}"
        return [
            make_table_block(("goal", "level", "reached", "share"), rows, title=title),
            make_lines_block(
                f"Sampled at {c.rate_Hz:g} Hz: gamma {f.norm:.3f}, S_u {s.sensitivity_peak_dB:.2f} dB, "
                f"T_u {s.complementary_peak_dB:.2f} dB, disk margin {f.disk.margin:.2f}, mu {f.mu_upper:.3f}, input "
                f"noise {100 * f.input_noise:.2f} %, {f.multiply_adds} multiply-adds",
                "All goals are reached" if self.objective <= 1.0 else "Not all goals are reached: shares above 1",
            ),
        ]


def tune_loop(
    vehicle: Vehicle,
    loop: LoopName,
    order: int,
    goal_levels: GoalLevels,
    *,
    starts: Sequence[str] = DEFAULT_START_METHODS,
    rounds: int = 4,
    steps: int = 60,
    rate_Hz: float | None = None,
    spreads: Mapping[str, float] | None = None,
    path: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> TunedLoop:
    """Tune one loop of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    loop : str
        ``"heave-yaw"`` or ``"roll-pitch"``.
    order : int
        Order of the controller.
    goal_levels : GoalLevels
    starts : sequence of str
        Methods whose reduced controllers are starts, ``"delay"`` (H-infinity with the delay), or files of tuned loops.
    rounds, steps : int
        Rounds for each of the two best starts, and steps of every descent.
    rate_Hz : float, optional
    spreads : mapping, optional
        Spread of every parameter (SI) by its key; :func:`default_spreads` by default.
    path : Path, optional
        File written after every round. A tuning of the same problem is continued from it.
    progress : callable, optional
        Called with (rounds done, all rounds).

    Returns
    -------
    TunedLoop

    Raises
    ------
    ArgumentError
        If the order is out of range or there is no goal.
    MuflyError
        If no start stabilises the loop.
    """
    if not 2 <= order <= HIGHEST_ORDERS[loop]:
        raise ArgumentError("order", "", f"{order} is out of range", f"give 2 to {HIGHEST_ORDERS[loop]} for {loop}")
    if not any(v is not None for v in asdict(goal_levels).values()):
        raise ArgumentError("goals", "", "no goal is given", "give one of " + ", ".join(asdict(goal_levels)))
    base = design_flight_controller(vehicle, rate_Hz=rate_Hz)
    spreads = default_spreads(vehicle) if spreads is None else dict(spreads)
    d = base.heave_yaw if loop == "heave-yaw" else base.roll_pitch
    problem = make_loop_tuning_problem(
        vehicle, base, loop, goal_levels, compute_output_noise_std(vehicle, d.plant.output_labels), spreads
    )
    tuning = {
        "format": _FILE_FORMAT, "vehicle": vehicle.name, "loop": loop, "order": order, "rate_Hz": base.rate_Hz,
        "goals": asdict(goal_levels), "starts": list(starts), "steps": steps, "plant": _plant_fingerprint(d),
    }  # fmt: skip
    state = _read_tuning_state(path, tuning)
    files = [name for name in starts if name.endswith(".json")]
    methods = [name for name in starts if name not in files]
    first = find_start_controllers(problem, methods, order) if methods else []
    for file in files:
        given = _read_tuning_record(Path(file))[1]
        K = given.to_scaled_units(problem.generalised_plant, problem.read_scale, problem.input_scale)
        if K.nstates > order:
            raise InputError(
                file, "", f"contains a controller of order {K.nstates}", f"give --order {K.nstates} or more"
            )
        first.insert(0, add_fast_states(K, order))

    def report(done: int, total: int, reached: TuningState) -> None:
        if path is not None:
            _write_tuning_record(path, tuning, problem, reached)
        if progress is not None:
            progress(done, total)

    K, state = continue_tuning(problem, first, rounds=rounds, steps=steps, state=state, progress=report)
    if path is not None:
        _write_tuning_record(path, tuning, problem, state)
    norms = evaluate_goal_norms([a for a in problem.goals if a is not problem.mu], K)
    if problem.mu is not None:
        gain = np.block([[K.A, K.B], [K.C, K.D]])
        norms["mu"] = problem.mu.update_scalings(gain, order)
    c = design_flight_controller(
        vehicle, rate_Hz=rate_Hz, settings=settings_with_tuned_controller(DesignSettings(), problem, K)
    )
    robust = analyse_parameter_robustness(vehicle, c, spreads, points=40)
    mu = robust.heave_yaw if loop == "heave-yaw" else robust.roll_pitch
    figures = compute_loop_metrics(
        vehicle, c.heave_yaw if loop == "heave-yaw" else c.roll_pitch, (mu.peak, mu.peak_lower_bound)
    )
    return TunedLoop(loop, order, {a.name: a.level for a in problem.goals}, norms, figures, c)


def _plant_fingerprint(d: ControllerDesign) -> list[float]:
    """Return numbers that differ between plants, to tell whether a file belongs to the same problem."""
    scaled = scale_plant(d.plant, d.scaling)
    return [float(f"{np.linalg.norm(M):.9g}") for M in (scaled.A, scaled.B, scaled.C)]


def _read_tuning_state(path: Path | None, tuning: Mapping[str, Any]) -> TuningState | None:
    if path is None:
        return None
    words = (
        "contains the results of another tuning",
        "give another --out, delete the file, or repeat the options of that tuning to continue it",
    )
    record = read_stored_result(path, hash_inputs(tuning), damaged=words, other=words)
    return None if record is None else TuningState.from_record(record["lines"])


def _write_tuning_record(path: Path, tuning: Mapping[str, Any], problem: LoopTuningProblem, state: TuningState) -> None:
    gain, history = min(state.lines, key=lambda line: line[1][-1])
    k = len(gain) - len(problem.input_scale)
    g, read, out = np.array(gain), problem.read_scale, problem.input_scale[:, None]
    given = GivenController.from_matrices(g[:k, :k], g[:k, k:] / read, g[k:, :k] * out, g[k:, k:] * out / read)
    record = {
        "tuning": dict(tuning), "objective": history[-1], "controller": asdict(given), "lines": state.to_record()
    }  # fmt: skip
    write_stored_result(path, hash_inputs(tuning), record, indent=1)


def _read_tuning_record(path: Path) -> tuple[dict[str, Any], GivenController]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        tuning = record["tuning"]
        if tuning["format"] != _FILE_FORMAT:
            raise KeyError("format")
        return tuning, GivenController.from_matrices(*(record["controller"][k] for k in "ABCD"))
    except OSError as error:
        raise InputError(
            str(path), "", error.strerror or "cannot be read", "give a file of `mufly control tune`"
        ) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(str(path), "", "is not a tuned controller", "give a file of `mufly control tune`") from None


def load_tuned_settings(paths: Sequence[str | Path], base: DesignSettings | None = None) -> DesignSettings:
    """Return design settings that use the tuned controllers in files; other loops keep their synthesis method.

    Raises
    ------
    InputError
        If a file is no tuned controller, or two are for the same loop.
    """
    settings = DesignSettings() if base is None else base
    for path in paths:
        tuning, given = _read_tuning_record(Path(path))
        key = _SETTINGS_KEY_BY_LOOP[tuning["loop"]]
        if getattr(settings, key) is not None:
            raise InputError(str(path), "", f"is a second controller for {tuning['loop']}", "give one file per loop")
        changes: dict[str, Any] = {key: given}
        settings = replace(settings, **changes)
    return settings
