"""Optimisation of rotors within limits, with the gain of each change.

The method is differential evolution (Storn and Price, J. Global Optimization 11, 1997; SciPy's, seeded and
reproducible) over the free parameters, always including the pitch. A generation is evaluated as one batch. A free gear
is not searched: the gear of least power follows for every candidate in closed form
(``drive.find_least_power_gear_ratio``).
Airfoils are numbered in the order of a ranking on the initial rotor, so that neighbouring numbers have similar merit.
The cost of cases that fail or violate a limit exceeds that of all other cases and grows with the violation.

Goals, at a given thrust of each rotor: ``thrust-per-power`` is thrust over electrical power; ``endurance`` is the hover
time of the drive's battery with all rotors (``drive.hover_endurance``). For endurance the gear is chosen for the
battery's low voltage instead of its nominal voltage, because a motor that needs more voltage ends the hover earlier.

Gain of each change: from the initial rotor at its best pitch, the change with the greatest gain is made next, and the
pitch is optimised again (to 0.25 degrees). The gains depend on this order; their product is the total gain.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from mufly.drive import hover_endurance
from mufly.errors import InputError, MuflyError
from mufly.results import (
    ResultColumn,
    ShownBlock,
    make_lines_block,
    result,
    tabulate_fields,
    tabulate_results,
)
from mufly.results.result_figure import enable_notebook_display
from mufly.rotor import (
    Rotor,
    draw_blade,
    is_polar_file,
    load_airfoil,
    replace_rotor,
)
from mufly.study.case_evaluation import evaluate_cases
from mufly.study.study_parameters import (
    GEOMETRY_PARAMETERS,
    DesignLimit,
    format_parameter_value,
    parameter_search_bounds,
)
from mufly.study.study_setup import StudySetup, reshape_rotor
from mufly.study.sweeps import rank_airfoils

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]

_MAX_GENERATIONS = 60
_POPULATION_PER_UNKNOWN = 12  # times the number of unknowns


@result
class DesignChange:
    """Change of one parameter from the initial to the optimised rotor, with its gain.

    Attributes
    ----------
    parameter : str
    value : float or str
        New value (SI) or name.
    goal, gain : float
        Goal after the change, and relative gain of the change.
    pitch_rad : float
        Best pitch after the change.
    """

    parameter: str
    value: float | str
    goal: float
    gain: float
    pitch_rad: float

    @property
    def new_value_text(self) -> str:
        """New value with its unit."""
        return format_parameter_value(self.parameter, self.value, ".4g")


@result(
    json="rotor=rotor.toml_tables pitch_rad changes goal unit=goal_unit before=goal_before after=goal_after steps "
    "results"
)
class RotorOptimum:
    """Optimised rotor.

    Attributes
    ----------
    rotor : Rotor
    pitch_rad : float
    changes : dict
        Parameters that differ from the initial rotor, in SI units, and the gear found.
    goal : str
    goal_before, goal_after : float
        Goal (N/W or s) of the initial rotor at its best pitch, and of the optimum.
    steps : tuple of DesignChange
        Changes from the initial rotor to the optimum.
    results : dict
        Results of :func:`mufly.study.evaluate_cases` for the optimum, with ``min_thickness_m`` and ``endurance_s``.
    """

    rotor: Rotor
    pitch_rad: float
    changes: dict[str, float | str]
    goal: str
    goal_before: float
    goal_after: float
    steps: tuple[DesignChange, ...]
    results: dict[str, float]

    @property
    def goal_unit(self) -> str:
        """Unit of the optimised quantity."""
        return "s" if self.goal == "endurance" else "N/W"

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the gain of each change, and the optimum's results."""
        steps = (
            ResultColumn("parameter", head="change"), ResultColumn("new_value_text", head="to"),
            ResultColumn("goal", form=".5g", head=f"{self.goal} ({self.goal_unit})"),
            ResultColumn("gain", form="+.1%"), ResultColumn("pitch_rad", "deg", ".2f"),
        )  # fmt: skip
        results = (
            ResultColumn("electrical_power_W", form=".3f"), "thrust_N", "thrust_per_power_N_W",
            ResultColumn("endurance_s", "min", ".1f"), ResultColumn("speed_rad_s", "rpm", ".0f"),
            ResultColumn("gear_ratio", form=".3g"), ResultColumn("duty", form=".2f"),
            ResultColumn("least_thickness_m", "mm", ".2f"),
        )  # fmt: skip
        return [
            tabulate_results(self.steps, steps),
            make_lines_block(
                f" {self.goal} from the start to the optimum, at the best pitch: {self.goal_before:.5g} to "
                f"{self.goal_after:.5g} {self.goal_unit}",
                head=f"{self.goal_after / self.goal_before - 1:+.1%}",
            ),
            tabulate_fields(self.results, results),
        ]

    def plot(self) -> Figure:
        """Draw the optimum; return a matplotlib figure."""
        return enable_notebook_display(draw_blade(self.rotor))


def optimise_rotor(
    setup: StudySetup,
    goal: OptimisationGoal,
    free: Sequence[str],
    *,
    limits: Sequence[DesignLimit] = (),
    airfoils: Sequence[str] = (),
    seed: int = 0,
    generations: int = _MAX_GENERATIONS,
    progress: ProgressCallback | None = None,
) -> RotorOptimum:
    """Optimise a rotor.

    Parameters
    ----------
    setup : StudySetup
        Initial rotor, drive, and ``thrust`` among the fixed parameters.
    goal : {'thrust-per-power', 'endurance'}
    free : sequence of str
        Free parameters, of :data:`FREE_PARAMETERS`; the pitch is always free unless fixed.
    limits : sequence of DesignLimit
        Limits from :func:`mufly.study.study_parameters.parse_design_limit`; default: the ranges of
        :data:`mufly.study.study_parameters.SEARCH_RANGES`.
    airfoils : sequence of str
        Candidates, if the airfoil is free.
    seed : int
        Seed of the search; equal seeds give equal results.
    generations : int
        Number of generations.
    progress : callable, optional
        ``progress(done, total)``, in generations.

    Raises
    ------
    InputError
        If free, fixed and limited parameters are inconsistent.
    MuflyError
        If no candidate meets the limits.
    """
    problem = OptimisationProblem(setup, goal, tuple(free), tuple(limits), list(airfoils))
    names, low, high, whole = problem.search_space()

    search: Callable[..., Any] = differential_evolution  # its type stubs lack vectorised functions
    found = search(
        lambda x: problem.evaluate_cost(names, np.atleast_2d(x.T)), list(zip(low, high, strict=True)),
        integrality=whole, rng=np.random.default_rng(seed), maxiter=generations, popsize=_POPULATION_PER_UNKNOWN,
        tol=1e-6, mutation=(0.4, 0.9), recombination=0.8, polish=False,
        vectorized=True, updating="deferred", init="sobol",
        callback=make_generation_callback(progress, generations),
    )  # fmt: skip
    best = problem.case_from_point(names, found.x)
    if found.fun >= problem.FAILURE_COST:
        raise MuflyError(f"no rotor within the limits was found; the best one breaks: {problem.explain_failure(best)}")
    return _make_optimum_with_changes(problem, best)


def make_generation_callback(progress: Callable[[int, int], None] | None, total: int) -> Callable[..., None]:
    """Return the callback of a search that reports every generation to ``progress``."""
    done = itertools.count(1)

    def report_generation(*_: Any, **__: Any) -> None:
        if progress is not None:
            progress(min(next(done), total), total)

    return report_generation


def _make_optimum_with_changes(problem: OptimisationProblem, best: dict[str, float | str]) -> RotorOptimum:
    """Compute the changes from the initial rotor to the best case, the greatest gain first."""
    changes = {k: v for k, v in best.items() if k != "pitch"}
    before, _ = problem.optimise_pitch({}, True)
    goal, values, _ = problem.evaluate_goal([best])
    after = float(goal[0])
    left, at, own = list(changes), before, "gear" in problem.free
    made: dict[str, float | str] = {}
    if own:
        left.append("gear")
    steps: list[DesignChange] = []
    while left:
        tried = []
        for name in left:
            case = made if name == "gear" else {**made, name: changes[name]}
            reached, pitch = problem.optimise_pitch(case, own and name != "gear")
            tried.append((reached if math.isfinite(reached) else -math.inf, name, pitch))
        reached, name, pitch = max(tried, key=lambda t: t[0])
        if len(left) == 1:  # the last step ends at the optimum with its pitch
            reached, pitch = after, float(best.get("pitch", pitch))
        value: float | str = float(values["gear_ratio"][0]) if name == "gear" else changes[name]
        steps.append(DesignChange(name, value, reached, reached / at - 1.0 if at > 0 else math.nan, pitch))
        at = reached
        left.remove(name)
        if name == "gear":
            own = False
        else:
            made = {**made, name: changes[name]}
    start = problem.setup.rotor
    told = {"name": f"{start.name}-optimised", "description": f"{start.name}, optimised for {problem.goal}"}
    rotor = replace_rotor(problem.rotor_of_case(best), told)
    results = {k: float(v[0]) for k, v in values.items() if k != "outside_share"}
    results["least_thickness_m"] = min_thickness_m(rotor)
    if "gear" in problem.free:
        changes["gear"] = results["gear_ratio"]
    pitch = float(best.get("pitch", problem.setup.fixed_parameters.get("pitch", math.nan)))
    return RotorOptimum(rotor, pitch, changes, problem.goal, before, after, tuple(steps), results)


# ----------------------------------------------------------------------------
# The optimisation problem: free parameters, limits and goal as a cost function (see ``optimise_rotor``).


OptimisationGoal = Literal["thrust-per-power", "endurance"]

FREE_PARAMETERS = ("chord", "twist", "taper", "radius", "hub_cutout", "blades", "airfoil", "gear")
_MAX_AIRFOIL_CANDIDATES = 30  # number of airfoils in the search: the best of the ranking within the limits
_RANKING_PITCHES_rad = tuple(float(p) for p in np.radians(np.arange(8.0, 21.0, 2.0)))
SEARCH_PITCHES_rad = np.radians(np.arange(2.0, 26.1, 0.25))


@lru_cache(maxsize=4096)
def _thickness_ratio(name: str) -> float:
    return math.nan if is_polar_file(name) else load_airfoil(name).thickness_ratio


def min_thickness_m(rotor: Rotor) -> float:
    """Return the least thickness of the blade along its span (m): chord times thickness ratio of the section."""
    s = rotor.sections_at(np.linspace(float(rotor.hub_cutout), 1.0, 41))
    ratio = np.array([_thickness_ratio(name) for name in s.airfoil_names])
    return float(
        np.min(s.chord_m * ((1 - s.second_weight) * ratio[s.first_airfoil] + s.second_weight * ratio[s.second_airfoil]))
    )


class OptimisationProblem:
    """Goal and limits as a cost function of the unknowns of :func:`mufly.study.optimise_rotor`."""

    FAILURE_COST = 1e3  # least cost of cases that fail or violate a limit

    def __init__(
        self,
        setup: StudySetup,
        goal: OptimisationGoal,
        free: tuple[str, ...],
        limits: tuple[DesignLimit, ...],
        airfoils: list[str],
    ) -> None:
        if setup.drive is None or "thrust" not in setup.fixed_parameters:
            raise InputError("optimise", "", "drive or thrust is missing", "give a drive and a thrust, as thrust=0.4N")
        if goal not in ("thrust-per-power", "endurance"):
            raise InputError("optimise", str(goal), "is unknown", "use thrust-per-power or endurance")
        for name in free:
            if name not in FREE_PARAMETERS:
                raise InputError("optimise", name, "cannot be free", f"free some of: {', '.join(FREE_PARAMETERS)}")
            if name in setup.fixed_parameters:
                raise InputError("optimise", name, "is both fixed and to be optimised", "omit one of the two")
        if len(set(free)) != len(free):
            raise InputError("optimise", "", "names a parameter twice", "name each parameter once")
        fixed = dict(setup.fixed_parameters)
        if goal == "endurance":
            fixed.setdefault("voltage", float(setup.drive.battery.low_voltage))
        self.setup = replace(setup, fixed_parameters=fixed, with_outside_share=False)
        self.drive, self.goal, self.free, self.limits = setup.drive, goal, free, limits
        self.candidates = self._rank_candidates(airfoils) if "airfoil" in free else []

    def _rank_candidates(self, airfoils: list[str]) -> list[str]:
        if not airfoils:
            raise InputError(
                "optimise", "airfoil", "is to be optimised, but there are no candidates", "give candidate airfoils"
            )
        start = replace(
            self.setup,
            fixed_parameters={k: v for k, v in self.setup.fixed_parameters.items() if k != "pitch"}
            | self._make_gear_setting(),
        )
        ranking = rank_airfoils(start, airfoils, _RANKING_PITCHES_rad, by="thrust_per_power_N_W")
        order = [str(n) for n, f in zip(ranking.airfoil.values, ranking.fault.values, strict=True) if not f]
        least = max(
            (lim.value for lim in self.limits if lim.name == "thickness_mm" and lim.is_lower_bound),
            default=0.0,
        )
        widest = (
            parameter_search_bounds("chord", self.limits)[1]
            if "chord" in self.free
            else float(np.max(self.setup.rotor.blade.chord.value))
        )
        order = [n for n in order if not _thickness_ratio(n) * widest * 1e3 < least]
        if not order:
            raise MuflyError("none of the named airfoils satisfies the limits on this rotor")
        return order[:_MAX_AIRFOIL_CANDIDATES]

    def _make_gear_setting(self) -> dict[str, float | str]:
        return {"gear": "best"} if "gear" in self.free else {}

    def search_space(self) -> tuple[list[str], list[float], list[float], list[bool]]:
        """Return names and bounds of the unknowns, and whether they are integers."""
        names = [n for n in self.free if n != "gear"]
        if "pitch" not in self.setup.fixed_parameters:
            names.append("pitch")
        if not names:
            raise InputError(
                "optimise", "", "there is no parameter to optimise", "name a parameter, or do not fix the pitch"
            )
        low, high = [], []
        for name in names:
            bounds = (
                (0.0, len(self.candidates) - 1.0) if name == "airfoil" else parameter_search_bounds(name, self.limits)
            )
            low.append(bounds[0])
            # SciPy requires an interval, also for a single candidate.
            high.append(bounds[1] if bounds[1] > bounds[0] else bounds[0] + 1e-9)
        return names, low, high, [n in ("airfoil", "blades") for n in names]

    def case_from_point(self, names: Sequence[str], x: Array) -> dict[str, float | str]:
        """Return the parameters of a point of the search."""
        values: dict[str, float | str] = dict(zip(names, (float(v) for v in x), strict=True))
        if "airfoil" in values:
            values["airfoil"] = self.candidates[min(round(float(values["airfoil"])), len(self.candidates) - 1)]
        if "blades" in values:
            values["blades"] = float(round(float(values["blades"])))
        return values

    def evaluate_goal(
        self, cases: Sequence[Mapping[str, float | str]], *, own_gear: bool = False
    ) -> tuple[Array, dict[str, Array], list[str]]:
        """Return for each case the value of the goal (nan if it failed), all results, and the reason of a failure.

        With ``own_gear`` the gear ratio is that of the setup, even if it is a free parameter.
        """
        extra = {} if own_gear else self._make_gear_setting()
        results = evaluate_cases(replace(self.setup, fixed_parameters={**self.setup.fixed_parameters, **extra}), cases)
        per_power = results.values["thrust_per_power_N_W"]
        voltage = float(self.setup.fixed_parameters.get("voltage", float(self.drive.battery.nominal_voltage)))
        times = np.full(per_power.size, np.nan)
        for k in np.flatnonzero(np.isfinite(per_power)):
            try:
                times[k] = hover_endurance(
                    self.drive.battery,
                    power_W=self.drive.rotors * float(results.values["electrical_power_W"][k]),
                    motor_voltage_V=float(results.values["duty"][k]) * voltage,
                ).time_s
            except MuflyError:
                continue
        values = {**results.values, "endurance_s": times}
        return (times if self.goal == "endurance" else per_power), values, results.fault

    def rotor_of_case(self, case: Mapping[str, float | str]) -> Rotor:
        """Return the rotor with the parameters of a case."""
        every = {**self.setup.fixed_parameters, **case}
        return reshape_rotor(self.setup.rotor, {name: every[name] for name in GEOMETRY_PARAMETERS if name in every})

    def _limit_violation(self, case: Mapping[str, float | str], values: Mapping[str, float]) -> float:
        return sum(limit.relative_violation(v) for limit, v in self._limited_quantities(case, values))

    def _limited_quantities(
        self, case: Mapping[str, float | str], values: Mapping[str, float]
    ) -> list[tuple[DesignLimit, float]]:
        if not self.limits:
            return []
        rotor = self.rotor_of_case(case)
        derived = {
            "thickness_mm": lambda: 1e3 * min_thickness_m(rotor),
            "tip_chord_mm": lambda: 1e3 * float(rotor.chord_m(1.0)),
            "solidity": lambda: rotor.solidity,
            "speed_rpm": lambda: values["speed_rad_s"] * 30 / math.pi,
            "motor_current_A": lambda: values["motor_current_A"],
            "gear": lambda: values["gear_ratio"],
        }
        return [(limit, derived[limit.name]()) for limit in self.limits if limit.name in derived]

    def evaluate_cost(self, names: Sequence[str], points: Array) -> Array:
        """Return the cost of points (n, unknowns): the negative goal, or a value above ``FAILURE_COST``."""
        cases = [self.case_from_point(names, x) for x in points]
        goal, values, _ = self.evaluate_goal(cases)
        cost = np.where(np.isfinite(goal), -goal, 2.0 * self.FAILURE_COST)
        if self.goal == "endurance":
            cost = np.where(np.isfinite(goal), cost / 3600.0, cost)
        for k in np.flatnonzero(np.isfinite(goal)):
            breach = self._limit_violation(cases[k], {n: float(v[k]) for n, v in values.items()})
            if breach > 0.0:
                cost[k] = self.FAILURE_COST + min(breach, 0.9 * self.FAILURE_COST)
        return cost

    def explain_failure(self, case: Mapping[str, float | str]) -> str:
        """Return a text about the limits that a case violates."""
        _, values, fault = self.evaluate_goal([case])
        if fault[0]:
            return fault[0]
        broken = [
            f"{limit} (is {v:.4g})"
            for limit, v in self._limited_quantities(case, {n: float(x[0]) for n, x in values.items()})
            if limit.relative_violation(v) > 0
        ]
        return "; ".join(broken) or "the battery cannot hold the hover"

    def optimise_pitch(self, case: Mapping[str, float | str], own_gear: bool) -> tuple[float, float]:
        """Return the greatest value of the goal over the pitch, and that pitch (rad).

        With ``own_gear`` the gear ratio is that of the setup, even if it is a free parameter.
        """
        if "pitch" in self.setup.fixed_parameters:
            goal, _, _ = self.evaluate_goal([case], own_gear=own_gear)
            return float(goal[0]), float(self.setup.fixed_parameters["pitch"])
        low, high = parameter_search_bounds("pitch", self.limits)
        pitches = [float(p) for p in SEARCH_PITCHES_rad if low <= p <= high] or [0.5 * (low + high)]
        goal, _, _ = self.evaluate_goal([{**case, "pitch": p} for p in pitches], own_gear=own_gear)
        best = int(np.argmax(np.where(np.isfinite(goal), goal, -np.inf)))
        return float(goal[best]), pitches[best]
