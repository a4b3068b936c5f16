"""Optimisation of the blades and pitches of a coaxial pair: least power at a thrust with balanced torques.

Coaxial blade element theory finds the speeds of every candidate at which the thrust is met and the torques cancel.
ln(thrust) and ln(torque ratio) are nearly linear in ln(speed) and ln(speed ratio), with slopes 2 and, for
interacting rotors, about 2.6, so three to five solutions suffice. Differential evolution (SciPy's, seeded) searches,
the simplex of Nelder and Mead refines. Start and optimum are then compared by the independent wake method
(:func:`verify_optimum_by_wake`); a disagreement about the gain is reported.

Twist is linear from hub to tip and zero at the tip; chords are means (:mod:`mufly.study.study_setup`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, minimize

from mufly.errors import InputError, MuflyError, suggest_name
from mufly.results import (
    ResultColumn,
    ShownBlock,
    make_lines_block,
    make_table_block,
    result,
    select_fields,
    tabulate_results,
)
from mufly.results.result_figure import enable_notebook_display
from mufly.rotor import (
    MAX_TIP_SPEED_M_S,
    OperatingCondition,
    Rotor,
    RotorSystem,
    SystemSolution,
    draw_pair_spanwise_loads,
    replace_rotor,
    solve_system,
)
from mufly.rotor.wake import check_rotors
from mufly.study.case_evaluation import build_operating_condition, build_rotor_system, solve_case
from mufly.study.rotor_optimisation import make_generation_callback
from mufly.study.study_parameters import (
    PAIR_PARAMETERS,
    SEARCH_RANGES,
    DesignLimit,
    format_parameter_value,
    parse_parameter_value,
)
from mufly.study.study_setup import StudySetup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

PAIR_FREE_PARAMETERS = tuple(
    f"{side}_{name}" for name in ("twist", "chord", "pitch", "taper") for side in ("upper", "lower")
)
_PAIR_POPULATION_PER_UNKNOWN = 8  # times the number of unknowns
_MAX_PAIR_GENERATIONS = 30
_SEARCH_STATION_COUNT = 16  # stations along a blade during the search
_IMPOSSIBLE_CANDIDATE_COST_W = 1e3  # W; cost of impossible candidates
_TORQUE_BALANCE_TOLERANCE = 1e-4
_MAX_BLADE_REACH_SPACING_FRACTION = 0.9  # of the spacing: greatest vertical extent of the pitched blades


@result(
    json="upper=upper.toml_tables lower=lower.toml_tables changes at_limit evaluations bemt=bemt_figures "
    "wake=wake_figures"
)
class PairOptimum:
    """Optimised pair.

    Attributes
    ----------
    upper, lower : Rotor
    pitch_rad : (upper, lower)
    initial_solution, before_at_best_pitch, optimum_solution : SystemSolution
        Solutions by blade elements at the thrust with balanced torques: the initial pair; the initial blades at their
        best pitches, if the pitches are free; the optimum.
    changes : dict
        Values of the free parameters (SI).
    at_limit : tuple of str
        Parameters at an end of their range.
    evaluations : int
    wake_solutions : (start, optimum) or None
        Solutions of the initial pair and of the optimum by the wake method, or why there is none.
    """

    upper: Rotor
    lower: Rotor
    pitch_rad: tuple[float, float]
    initial_solution: SystemSolution
    before_at_best_pitch: SystemSolution | None
    optimum_solution: SystemSolution
    changes: dict[str, float]
    at_limit: tuple[str, ...]
    evaluations: int
    wake_solutions: tuple[SystemSolution | str, SystemSolution | str] | None = None

    @property
    def bemt_figures(self) -> dict[str, Any]:
        """Figures of the solutions by blade elements."""
        points = {
            "start": self.initial_solution,
            "pitch_only": self.before_at_best_pitch,
            "optimum": self.optimum_solution,
        }
        return {name: point and _summarise_pair_point(point) for name, point in points.items()}

    @property
    def wake_figures(self) -> dict[str, Any] | None:
        """Figures of the solutions by the wake method."""
        return self.wake_solutions and dict(
            zip(("start", "optimum"), map(_summarise_pair_point, self.wake_solutions), strict=True)
        )

    def plot(self) -> Figure:
        """Draw the optimum, by the wake method if it has a solution; return a matplotlib figure."""
        drawn = (
            self.optimum_solution
            if self.wake_solutions is None or isinstance(self.wake_solutions[1], str)
            else self.wake_solutions[1]
        )
        return enable_notebook_display(draw_pair_spanwise_loads(drawn.upper, drawn.lower))

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the free parameters, the solutions with the change of power, and warnings."""
        start, optimum = self.wake_solutions or ("", "")
        cases = (
            ("start", self.initial_solution, self.initial_solution),
            ("start's blades, best pitch", self.before_at_best_pitch, self.initial_solution),
            ("optimum", self.optimum_solution, self.initial_solution),
            ("start", start, start), ("optimum", optimum, start),
        )  # fmt: skip
        solved = [(name, point, first) for name, point, first in cases if isinstance(point, SystemSolution)]
        names = [
            name if point is first or not isinstance(first, SystemSolution)
            else f"{name} ({point.power_W / first.power_W - 1:+.1%})"
            for name, point, first in solved
        ]  # fmt: skip
        sides = ("upper", "lower")
        columns: tuple[ResultColumn | str, ...] = (
            "method", "power_W",
            *(ResultColumn(f"{side}.speed_rad_s", "rpm", ".0f", f"{side} speed") for side in sides),
            *(ResultColumn(f"{side}.thrust_N", head=f"{side} thrust") for side in sides),
            ResultColumn("figure_of_merit", form=".3f"),
        )  # fmt: skip
        warnings = [
            f"The wake method finds no solution: {text}" for text in self.wake_solutions or () if isinstance(text, str)
        ]
        if share := max(self.optimum_solution.upper.outside_share, self.optimum_solution.lower.outside_share):
            warnings.append(
                f"At the optimum sections outside the range of the polars carry up to {share:.0%} of a thrust"
            )
        free = [
            (
                name,
                format_parameter_value(name, value, ".4g"),
                "at the end of its range" if name in self.at_limit else "",
            )
            for name, value in self.changes.items()
        ]
        return [
            make_table_block(("free", "found", ""), free, text=(0, 2)),
            tabulate_results([point for _, point, _ in solved], columns, names=names),
            make_lines_block(*warnings, style="yellow"),
            make_lines_block(f"{self.evaluations} pairs computed.", style="dim"),
        ]


def _summarise_pair_point(point: SystemSolution | str) -> dict[str, Any]:
    if isinstance(point, str):
        return {"fault": point}
    each = "pitch_rad speed_rad_s thrust_N torque_Nm power_W outside_share"
    sides = {side: select_fields(getattr(point, side), each) for side in ("upper", "lower")}
    return {**select_fields(point, "power_W thrust_N figure_of_merit"), **sides}


def parse_pair_limit(text: str) -> DesignLimit:
    """Return a limit on a searched parameter from a text such as ``"upper_chord<=25mm"``.

    Raises
    ------
    InputError
        If the text is no limit.
    """
    match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(.+?)\s*", text)
    if match is None:
        raise InputError(text, "", "is not a limit", "write for example upper_chord<=25mm")
    name, sign, number = match.groups()
    if name not in PAIR_FREE_PARAMETERS:
        raise InputError(text, "", f"{name!r} cannot be limited", suggest_name(name, PAIR_FREE_PARAMETERS))
    return DesignLimit(name, sign == ">=", float(parse_parameter_value(name, number, PAIR_PARAMETERS)))


def _search_bounds(name: str, limits: Sequence[DesignLimit]) -> tuple[float, float]:
    low, high = SEARCH_RANGES[name.split("_", 1)[1]]
    low = max([v.value for v in limits if v.name == name and v.is_lower_bound], default=low)
    high = min([v.value for v in limits if v.name == name and not v.is_lower_bound], default=high)
    if not low < high:
        raise InputError(
            "limit",
            name,
            f"{low:g} to {high:g} {PAIR_PARAMETERS[name].unit} is an empty range",
            "give limits that leave a range",
        )
    return low, high


def _solve_balanced_pair(system: RotorSystem, at: OperatingCondition, start: list[float]) -> SystemSolution | None:
    """Solve the pair at its thrust with torques balanced to 1e-4; None on failure.

    ``start`` holds the upper speed and the ratio of the speeds, and is updated.
    """
    assert at.thrust_N is not None
    speed, ratio, slope = start[0], start[1], 2.6
    last: tuple[float, float] | None = None
    r: SystemSolution | None = None
    for _ in range(15):
        r = solve_system(system, replace(at, speed_rad_s=(speed, speed * ratio), thrust_N=None), start=r)
        if not (r.thrust_N > 0.0 and r.upper.torque_Nm > 0.0 and r.lower.torque_Nm > 0.0):
            return None
        fault, short = math.log(r.lower.torque_Nm / r.upper.torque_Nm), math.log(at.thrust_N / r.thrust_N)
        if abs(fault) < _TORQUE_BALANCE_TOLERANCE and abs(short) < _TORQUE_BALANCE_TOLERANCE:
            start[:] = [speed, ratio]
            return r
        place = math.log(ratio)
        if last is not None and abs(place - last[0]) > 1e-6:
            slope = min(max((fault - last[1]) / (place - last[0]), 1.0), 10.0)
        last = (place, fault)
        ratio = math.exp(place - max(min(fault / slope, 0.4), -0.4))
        speed *= math.exp(max(min(0.5 * short, 1.0), -1.0))
        if max(speed, speed * ratio) > 3e4:
            return None
    return None


def optimise_pair(
    setup: StudySetup,
    free: Sequence[str],
    *,
    limits: Sequence[DesignLimit] = (),
    seed: int = 0,
    generations: int = _MAX_PAIR_GENERATIONS,
    progress: Callable[[int, int], None] | None = None,
) -> PairOptimum:
    """Optimise a pair for the least power.

    Parameters
    ----------
    setup : StudySetup
        Initial pair; its fixed parameters contain thrust, spacing and both pitches. Its method is ignored.
    free : sequence of str
        Free parameters, of :data:`PAIR_FREE_PARAMETERS`.
    limits : sequence of DesignLimit
        Limits from :func:`parse_pair_limit`; default: the ranges of :data:`mufly.study.study_parameters.SEARCH_RANGES`.
    seed, generations : int
        Seed of the search (equal seeds give equal results), and number of generations.
    progress : callable, optional
        ``progress(done, total)`` in generations.

    Raises
    ------
    InputError
        If a parameter cannot be free, or thrust, spacing or a pitch is missing.
    MuflyError
        If the initial pair cannot be balanced at the thrust.
    """
    fast = replace(setup, method="bemt", balance_by="lower-speed")
    names = list(dict.fromkeys(free))
    for name in names:
        if name not in PAIR_FREE_PARAMETERS:
            raise InputError("optimise", name, "cannot be free", f"free some of: {', '.join(PAIR_FREE_PARAMETERS)}")
    for name in ("thrust", "spacing", "upper_pitch", "lower_pitch"):
        if name not in setup.fixed_parameters:
            raise InputError("optimise", name, "is missing", "fix it")
    if not names:
        raise InputError("optimise", "", "no parameter is free", f"free some of: {', '.join(PAIR_FREE_PARAMETERS)}")
    before = solve_case(fast)
    rough = replace(fast, station_count=min(_SEARCH_STATION_COUNT, setup.station_count))
    bounds = [_search_bounds(n, limits) for n in names]
    count = 0
    start = [before.upper.speed_rad_s, before.lower.speed_rad_s / before.upper.speed_rad_s]
    # The blades are prepared once if only pitches are free.
    still = build_rotor_system(rough) if all(n.endswith("pitch") for n in names) else None
    spacing = float(setup.fixed_parameters["spacing"])

    def evaluate_power(x: Array) -> float:
        nonlocal count
        count += 1
        case = dict(zip(names, map(float, np.clip(x, *np.transpose(bounds))), strict=True))
        try:
            system, at = still or build_rotor_system(rough, case), build_operating_condition(rough, case)
            near = RotorSystem.from_coaxial_pair(
                *system.bladings, spacing_m=_MAX_BLADE_REACH_SPACING_FRACTION * spacing
            )
            check_rotors(near.place_rotors(tuple(at.pitch_rad), (1.0, 1.0)), 0.0)  # type: ignore[arg-type]
            r = _solve_balanced_pair(system, at, list(start))
        except MuflyError:
            return 2.0 * _IMPOSSIBLE_CANDIDATE_COST_W
        if r is None:
            return 2.0 * _IMPOSSIBLE_CANDIDATE_COST_W
        tips = [p.speed_rad_s * b.rotors[0].radius_m for p, b in zip(r.rotors, system.bladings, strict=True)]
        return r.power_W if max(tips) <= MAX_TIP_SPEED_M_S else _IMPOSSIBLE_CANDIDATE_COST_W

    search: Callable[..., Any] = differential_evolution
    first = np.clip([_start_value(setup, n) for n in names], *np.transpose(bounds))
    found = search(
        evaluate_power, bounds, rng=np.random.default_rng(seed), maxiter=generations,
        popsize=_PAIR_POPULATION_PER_UNKNOWN, tol=1e-4, x0=first,
        mutation=(0.4, 0.9), recombination=0.8, polish=False, init="sobol",
        callback=make_generation_callback(progress, generations),
    )  # fmt: skip
    effort = {"maxfev": 60 * len(names), "xatol": 1e-5, "fatol": 1e-5}
    simplex: Callable[..., Any] = minimize  # its type stubs reject a plain dictionary
    fine = simplex(evaluate_power, found.x, method="Nelder-Mead", bounds=bounds, options=effort)
    x = np.clip(fine.x if fine.fun < found.fun else found.x, *np.transpose(bounds))
    changes = dict(zip(names, map(float, x), strict=True))
    after = solve_case(fast, changes)
    pitched = None
    both = [n for n in names if n.endswith("pitch")]
    if both and len(both) < len(names):
        pitched = optimise_pair(
            fast, both, limits=limits, seed=seed, generations=max(generations // 3, 5)
        ).optimum_solution
    edge = tuple(
        n for n, v, (low, high) in zip(names, x, bounds, strict=True) if min(v - low, high - v) < 0.005 * (high - low)
    )
    upper, lower = (
        replace_rotor(b.rotors[0], {"name": f"{b.rotors[0].name}-{side}"})
        for b, side in zip(build_rotor_system(fast, changes).bladings, ("upper", "lower"), strict=True)
    )
    return PairOptimum(
        upper,
        lower,
        (after.upper.pitch_rad, after.lower.pitch_rad),
        before,
        pitched,
        after,
        changes,
        edge,
        count,
    )


def _start_value(setup: StudySetup, name: str) -> float:
    """Return the initial value of a free parameter."""
    side, what = name.split("_", 1)
    rotor = setup.rotors[0 if side == "upper" else 1]
    if name in setup.fixed_parameters:
        return float(setup.fixed_parameters[name])
    hub, tip = float(rotor.hub_cutout), 1.0
    if what == "chord":
        return float(np.mean(rotor.chord_m(np.linspace(hub, tip, 101))))
    if what == "taper":
        return float(rotor.chord_m(tip) / rotor.chord_m(hub))
    return float(rotor.twist_rad(hub) - rotor.twist_rad(tip))


def verify_optimum_by_wake(
    setup: StudySetup, best: PairOptimum, progress: Callable[[int, float, float], None] | None = None
) -> PairOptimum:
    """Return the optimum with ``checked``: initial pair and optimum solved by the wake method at the same thrust with
    balanced torques.
    """
    slow = replace(setup, method="wake", balance_by="lower-speed")
    answers: list[SystemSolution | str] = []
    known: SystemSolution | None = None
    for case in ({}, best.changes):
        try:
            known = solve_case(slow, case, start=known, progress=progress)
            answers.append(known)
        except MuflyError as error:
            answers.append(str(error))
    return replace(best, wake_solutions=(answers[0], answers[1]))
