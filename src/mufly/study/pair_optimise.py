"""Blades and pitches of a coaxial pair for the least power at a thrust, torques balanced.

Every candidate is brought to the thrust, both speeds found at which the torques cancel, by coaxial blade element
theory: (ln speed, ln speed ratio) follow ln(thrust) and ln(torque ratio) nearly in straight lines (slopes 2 and, for
rotors that disturb each other, about 2.6), so three to five solutions do. Differential evolution (SciPy's, seeded)
searches, Nelder and Mead's simplex polishes. Start and optimum are then set beside each other by the wake method
(:func:`check_by_wake`), which the search never sees: where the two methods disagree about the gain, the user reads so.

Twist runs straight from hub to tip and is zero at the tip; chords are means (``study/shape.py``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, minimize

from mufly.errors import InputError, MuflyError
from mufly.rotor import Blading, CoaxialResult, Rotor, coaxial, replace_rotor
from mufly.rotor.thrust import FASTEST_TIP_M_S
from mufly.rotor.wake import Placed, WakeSolution
from mufly.rotor.wake.result import check_rotors
from mufly.study.limits import RANGES, Limit
from mufly.study.pair import PairPoint, PairSetup, air_of, bladings_of, solve_pair
from mufly.study.parameters import PAIR, parse_quantity

__all__ = ["PAIR_FREE", "PairOptimum", "check_by_wake", "optimise_pair", "pair_limit"]

Array = NDArray[np.float64]

PAIR_FREE = tuple(
    f"{side}_{name}" for name in ("twist", "chord", "pitch", "taper") for side in ("upper", "lower")
)
_POPULATION = 8  # times the number of unknowns
_GENERATIONS = 30
_STATIONS = 16  # in the search
_BROKEN = 1e3  # W; cost of what cannot be
_CLOSE = 1e-4
_CLEAR = 0.9  # of the spacing, that pitched blades may take up


@dataclass(frozen=True)
class PairOptimum:
    """A better pair.

    Attributes
    ----------
    upper, lower : Rotor
    pitch_rad : (upper, lower)
    before, pitched, after : PairPoint
        By blade elements, at the thrust and balanced: the start; the start's blades at their best pitches, if the
        pitches were free; the optimum.
    changes : dict
        What was free, and its value (SI).
    at_limit : tuple of str
        What ended at an end of its range.
    evaluations : int
    """

    upper: Rotor
    lower: Rotor
    pitch_rad: tuple[float, float]
    before: PairPoint
    pitched: PairPoint | None
    after: PairPoint
    changes: dict[str, float]
    at_limit: tuple[str, ...]
    evaluations: int


def pair_limit(text: str) -> Limit:
    """Return a limit on what is searched from text as ``"upper_chord<=25mm"``.

    Raises
    ------
    InputError
        If it is none.
    """
    match = re.fullmatch(r"\s*(\w+)\s*(>=|<=)\s*(.+?)\s*", text)
    if match is None:
        raise InputError(text, "", "is no limit", "write for example upper_chord<=25mm")
    if match[1] not in PAIR_FREE:
        raise InputError(text, "", f"{match[1]!r} cannot be limited", f"use one of: {', '.join(PAIR_FREE)}")
    return Limit(match[1], match[2] == ">=", float(parse_quantity(match[1], match[3], PAIR)))


def _bounds(name: str, limits: Sequence[Limit]) -> tuple[float, float]:
    low, high = RANGES[name.split("_", 1)[1]]
    low = max([v.value for v in limits if v.name == name and v.at_least], default=low)
    high = min([v.value for v in limits if v.name == name and not v.at_least], default=high)
    if not low < high:
        raise InputError(
            "limit", name, f"{low:g} to {high:g} {PAIR[name].unit} holds nothing", "widen the limits"
        )
    return low, high


def _balanced(
    upper: Blading, lower: Blading, setup: PairSetup, case: Mapping[str, Any], start: list[float]
) -> CoaxialResult | None:
    """The pair at its thrust with torques balanced to 1e-4, quickly; ``start`` (upper speed, ratio) is moved along."""
    every = {**setup.fixed, **case}
    spacing, climb, air = float(every["spacing"]), float(every.get("climb", 0.0)), air_of(setup, every)
    speed, ratio, slope = start[0], start[1], 2.6
    last: tuple[float, float] | None = None
    known: Array | None = None
    for _ in range(15):
        r = coaxial(
            upper, lower, spacing_m=spacing, upper_pitch_rad=every["upper_pitch"], lower_pitch_rad=every["lower_pitch"],
            upper_speed_rad_s=speed, lower_speed_rad_s=speed * ratio, climb_m_s=climb, air=air, start=known,
        )  # fmt: skip
        if not (r.thrust_N > 0.0 and r.upper.torque_Nm > 0.0 and r.lower.torque_Nm > 0.0):
            return None
        known = r.sent_up_m_s
        fault, short = math.log(r.lower.torque_Nm / r.upper.torque_Nm), math.log(every["thrust"] / r.thrust_N)
        if abs(fault) < _CLOSE and abs(short) < _CLOSE:
            start[:] = [speed, ratio]
            return r
        at = math.log(ratio)
        if last is not None and abs(at - last[0]) > 1e-6:
            slope = min(max((fault - last[1]) / (at - last[0]), 1.0), 10.0)
        last = (at, fault)
        ratio = math.exp(at - max(min(fault / slope, 0.4), -0.4))
        speed *= math.exp(max(min(0.5 * short, 1.0), -1.0))
        if max(speed, speed * ratio) > 3e4:
            return None
    return None


def optimise_pair(
    setup: PairSetup,
    free: Sequence[str],
    *,
    limits: Sequence[Limit] = (),
    seed: int = 0,
    generations: int = _GENERATIONS,
    progress: Callable[[int, int], None] | None = None,
) -> PairOptimum:
    """Search for a pair that needs less power.

    Parameters
    ----------
    setup : PairSetup
        The pair to start from; ``fixed`` holds thrust, spacing and both pitches. Its method plays no part.
    free : sequence of str
        Of :data:`PAIR_FREE`.
    limits : sequence of Limit
        From :func:`pair_limit`; without, the ranges of :data:`mufly.study.limits.RANGES`.
    seed, generations : int
        Same seed, same answer; how long to search.
    progress : callable, optional
        ``progress(done, total)`` in generations.

    Raises
    ------
    InputError
        If something cannot be free, or thrust, spacing or a pitch is missing.
    MuflyError
        If the start cannot be balanced at the thrust.
    """
    fast = replace(setup, method="bemt", free="lower-speed")
    names = list(dict.fromkeys(free))
    for name in names:
        if name not in PAIR_FREE:
            raise InputError("optimise", name, "cannot be free", f"free some of: {', '.join(PAIR_FREE)}")
    for name in ("thrust", "spacing", "upper_pitch", "lower_pitch"):
        if name not in setup.fixed:
            raise InputError("optimise", name, "is missing", "fix it")
    if not names:
        raise InputError("optimise", "", "nothing is free", f"free some of: {', '.join(PAIR_FREE)}")
    before = solve_pair(fast)
    rough = replace(fast, stations=min(_STATIONS, setup.stations))
    bounds = [_bounds(n, limits) for n in names]
    count, done = 0, 0
    start = [before.upper.speed_rad_s, before.lower.speed_rad_s / before.upper.speed_rad_s]
    still: tuple[Blading, Blading] | None = None  # both blades, where only pitches are free
    if all(n.endswith("pitch") for n in names):
        still = bladings_of(rough, {})

    def power(x: Array) -> float:
        nonlocal count
        count += 1
        case = dict(zip(names, map(float, np.clip(x, *np.transpose(bounds))), strict=True))
        try:
            upper, lower = still or bladings_of(rough, case)
            every: dict[str, Any] = {**rough.fixed, **case}
            above = Placed(upper, every["upper_pitch"], 1.0, 0.0, 1)
            check_rotors(
                (above, Placed(lower, every["lower_pitch"], 1.0, -_CLEAR * every["spacing"], -1)), 0.0
            )
            r = _balanced(upper, lower, rough, case, list(start))
        except MuflyError:
            return 2.0 * _BROKEN
        if r is None:
            return 2.0 * _BROKEN
        tips = (
            r.upper.speed_rad_s * upper.rotors[0].radius_m,
            r.lower.speed_rad_s * lower.rotors[0].radius_m,
        )
        return r.power_W if max(tips) <= FASTEST_TIP_M_S else _BROKEN

    def after_generation(*_: Any, **__: Any) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(min(done, generations), generations)

    search: Callable[..., Any] = differential_evolution
    first = np.clip([_of_start(setup, n) for n in names], *np.transpose(bounds))
    found = search(
        power, bounds, rng=np.random.default_rng(seed), maxiter=generations, popsize=_POPULATION, tol=1e-4, x0=first,
        mutation=(0.4, 0.9), recombination=0.8, polish=False, init="sobol", callback=after_generation,
    )  # fmt: skip
    effort = {"maxfev": 60 * len(names), "xatol": 1e-5, "fatol": 1e-5}
    simplex: Callable[..., Any] = minimize  # its types know no plain dictionary
    fine = simplex(power, found.x, method="Nelder-Mead", bounds=bounds, options=effort)
    x = np.clip(fine.x if fine.fun < found.fun else found.x, *np.transpose(bounds))
    changes = dict(zip(names, map(float, x), strict=True))
    after = solve_pair(fast, changes)
    pitched = None
    both = [n for n in names if n.endswith("pitch")]
    if both and len(both) < len(names):
        pitched = optimise_pair(
            fast, both, limits=limits, seed=seed, generations=max(generations // 3, 5)
        ).after
    edge = tuple(
        n
        for n, v, (low, high) in zip(names, x, bounds, strict=True)
        if min(v - low, high - v) < 0.005 * (high - low)
    )
    upper, lower = (
        replace_rotor(b.rotors[0], {"name": f"{b.rotors[0].name}-{side}"})
        for b, side in zip(bladings_of(fast, changes), ("upper", "lower"), strict=True)
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


def _of_start(setup: PairSetup, name: str) -> float:
    """Value of something free at the start."""
    side, what = name.split("_", 1)
    rotor = setup.upper if side == "upper" else setup.lower
    if name in setup.fixed:
        return float(setup.fixed[name])
    hub, tip = float(rotor.hub_cutout), 1.0
    if what == "chord":
        return float(np.mean(rotor.chord_m(np.linspace(hub, tip, 101))))
    if what == "taper":
        return float(rotor.chord_m(tip) / rotor.chord_m(hub))
    return float(rotor.twist_rad(hub) - rotor.twist_rad(tip))


def check_by_wake(
    setup: PairSetup, best: PairOptimum, progress: Callable[[int, float, float], None] | None = None
) -> tuple[PairPoint | str, PairPoint | str]:
    """Start and optimum at the same thrust, balanced, by the wake method; the reason where one cannot be had."""
    slow = replace(setup, method="wake", free="lower-speed")
    answers: list[PairPoint | str] = []
    known: WakeSolution | None = None
    for case in ({}, best.changes):
        try:
            point = solve_pair(slow, case, start=known, progress=progress)
            known = point.solution
            answers.append(point)
        except MuflyError as error:
            answers.append(str(error))
    return answers[0], answers[1]
