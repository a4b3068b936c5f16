"""Uncertainty of predicted thrust and torque: intervals from unknown blade sections and errors of the method.

Causes are varied one at a time about the nominal rotor, each by one standard deviation:

* ``n_crit``: transition early or late, 4 and 9 beside the nominal value (the dissertation's Table 3.1);
* ``engine``: 4 % of the lift coefficient, 8 % of the drag coefficient, the disagreement of network, boundary-layer
  code and wind tunnel below Re 1e5 (docs/log/2026-11-28-polars.md);
* ``camber``: 0.3 % of the chord for a known section; zero-lift angle -2 f (thin airfoil, parabola);
* ``thickness``: 0.5 % of the chord; drag 1 + 2 t (Hoerner, Fluid-Dynamic Drag, 1965, ch. II);
* ``pitch``: the prior of the effective pitch (:mod:`mufly.rotor.effective_pitch`), by source of geometry and family;
* ``method``: 5 % of thrust, 8 % of torque, the order of the difference to a vortex lattice with a contracting wake
  (docs/log/2026-11-28-bemt-accuracy.md).

If the section is guessed, the prediction is the mean over the candidate sections
(:mod:`mufly.rotor.blades.blade_families`), weighted with their probabilities, and their variance adds to the causes.
Camber and thickness then vary only within one step of the grid of candidates.

The causes are treated as independent: variances add to s^2. Their standard deviations are not fitted. Errors of rotors
have heavy tails (a wrong geometry, an unlisted cause), so error / (k s) is taken to follow Student's distribution with
three degrees of freedom, the fewest whole number with a variance. The interval of level p is

    prediction +- k t_3((1 + p) / 2) s

The scales k of thrust and torque (:data:`THRUST_TORQUE_ERROR_SCALES`) are the likeliest for the rotors of the benchmark
(:func:`fit_student_scale`), each rotor counting once: its points share its error. `mufly rotor benchmark --held-out`
measures the coverage on families that had no part in the fit (docs/accuracy.md). The interval of a rotor fitted to a
bench is normal, with k = 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri, stdtrit

from mufly.errors import ArgumentError, InputError
from mufly.results import ShownBlock, format_value, make_table_block, result
from mufly.rotor.bemt import solve_rotor_batch
from mufly.rotor.blades.blade_families import (
    DRAG_FACTOR_PER_THICKNESS_RATIO,
    GRID_ROUNDING_STD_RATIOS,
    ZERO_LIFT_RAD_PER_CAMBER_RATIO,
    find_family_priors,
    list_section_probabilities,
)
from mufly.rotor.blading import Blading, Corrections, compute_rotor_polars, prepare_blading
from mufly.rotor.effective_pitch import estimate_pitch_offset_prior
from mufly.rotor.geometry import Rotor, SectionCandidate, SectionFit, replace_rotor
from mufly.rotor.rotor_solver import solve_system
from mufly.rotor.rotor_system import Air, OperatingCondition, RotorSystem, SystemSolution
from mufly.rotor.sections.polar_engines import PolarEngine
from mufly.rotor.sections.polar_table import PolarTable

Array = NDArray[np.float64]
SectionKnowledge = Literal["known", "guessed", "measured"]
SECTION_KNOWLEDGE_LEVELS: tuple[SectionKnowledge, ...] = ("known", "guessed", "measured")

THRUST_TORQUE_ERROR_SCALES = (0.623, 0.813)
"""Scales k of the errors of thrust and torque over their deviations, fitted to 21 rotors (docs/accuracy.md)."""
_STUDENT_DEGREES_OF_FREEDOM = 3.0  # degrees of freedom of the errors
_MAX_SCALE_ITERATIONS = 1000
_MIN_SECTION_PROBABILITY = 0.003  # sections below this probability are left out of the mean


@dataclass(frozen=True)
class InputUncertainty:
    """Standard deviations of the causes of prediction errors; the defaults are those of a blade of known section."""

    n_crit_cases: tuple[float, ...] = (4.0, 9.0)
    lift: float = 0.04
    drag: float = 0.08
    camber: float = 0.003
    thickness: float = 0.005
    pitch_rad: float = math.radians(0.5)
    method_thrust: float = 0.05
    method_torque: float = 0.08

    def __post_init__(self) -> None:
        for key in ("lift", "drag", "camber", "thickness", "pitch_rad", "method_thrust", "method_torque"):
            if not 0.0 <= getattr(self, key) < 1.0:
                raise InputError("uncertainty", key, f"is {getattr(self, key):g}", "give 0 or more, below 1")

    @classmethod
    def for_guessed_section(cls) -> InputUncertainty:
        """Return the remaining uncertainty when the prediction is the mean over candidate sections."""
        return cls(camber=GRID_ROUNDING_STD_RATIOS[0], thickness=GRID_ROUNDING_STD_RATIOS[1])


@result(eq=False)
class PredictionInterval:
    """Predicted thrust and torque with intervals.

    Attributes
    ----------
    thrust_N, torque_Nm : (n,) arrays
        Nominal prediction.
    thrust_low_N, thrust_high_N, torque_low_Nm, torque_high_Nm : (n,) arrays
        Bounds of the intervals.
    level : float
        Nominal coverage probability.
    thrust_relative_std_by_cause, torque_relative_std_by_cause : dict of str to (n,) arrays
        Relative standard deviation due to each cause.
    """

    thrust_N: Array
    torque_Nm: Array
    thrust_low_N: Array
    thrust_high_N: Array
    torque_low_Nm: Array
    torque_high_Nm: Array
    level: float
    thrust_relative_std_by_cause: Mapping[str, Array]
    torque_relative_std_by_cause: Mapping[str, Array]

    def as_record(self, k: int = 0) -> dict[str, Any]:
        """Return level, nominal values and intervals of point ``k``."""
        return {
            "level": self.level,
            "mean_thrust_N": float(self.thrust_N[k]),
            "mean_torque_Nm": float(self.torque_Nm[k]),
            "thrust_N": [float(self.thrust_low_N[k]), float(self.thrust_high_N[k])],
            "torque_Nm": [float(self.torque_low_Nm[k]), float(self.torque_high_Nm[k])],
        }

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return means and intervals of thrust and torque as printed text; two elements are upper and lower rotor."""
        loads = {
            "thrust (N)": (self.thrust_N, self.thrust_low_N, self.thrust_high_N),
            "torque (N m)": (self.torque_Nm, self.torque_low_Nm, self.torque_high_Nm),
        }
        sides = ("upper ", "lower ") if self.thrust_N.size == 2 else ("",)
        rows = [
            (f"{side}{name}", *(format_value(v[k : k + 1], ".4g") for v in values))
            for k, side in enumerate(sides)
            for name, values in loads.items()
        ]
        title = f"nominal {self.level:.0%} interval"
        return (make_table_block(("", "mean", "low", "high"), rows, title=title),)


PREDICTION_INTERVAL_LEVELS = (0.5, 0.68, 0.8, 0.9, 0.95, 0.99)


def predict_interval(
    rotor: Rotor,
    *,
    pitch_rad: ArrayLike,
    speed_rad_s: ArrayLike,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
    corrections: Corrections | None = None,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    section: SectionKnowledge = "known",
    family: str = "",
    doubt: InputUncertainty | None = None,
    level: float = 0.9,
    scales: tuple[float, float] = THRUST_TORQUE_ERROR_SCALES,
) -> PredictionInterval:
    """Predict thrust and torque with an interval.

    For a fitted rotor (:func:`mufly.rotor.fit_rotor`) the interval includes the posterior of the seven parameters, the
    candidate sections and the scatter of points. Outside the measured range the uncertainty of the method is added. It
    counts in full at a distance of 5 degrees of pitch, a factor of two in speed or an airspeed of 0.1 of the tip speed.
    For other rotors the interval follows from the causes of the module docstring.

    Parameters
    ----------
    rotor : Rotor
        The rotor.
    pitch_rad, speed_rad_s, climb_m_s : array_like
        Points, broadcast against each other.
    air, corrections, n_crit, engine
        As for :func:`mufly.rotor.blading.prepare_blading` and :func:`mufly.rotor.bemt.solve_rotor`.
    section : 'known', 'guessed' or 'measured'
        Status of the rotor file's airfoils; for a fitted rotor always 'measured'.
    family : str
        Family of a guessed section, if known: one of :data:`mufly.rotor.blades.blade_families.BLADE_FAMILY_PRIORS`.
    doubt : InputUncertainty, optional
        Standard deviations of the causes; default: those of a known or guessed section.
    level : float
        Coverage: 0.5, 0.68, 0.8, 0.9, 0.95 or 0.99.
    scales : (float, float)
        Scales of thrust and torque in place of :data:`THRUST_TORQUE_ERROR_SCALES`.

    Raises
    ------
    InputError
        If level, section or family is invalid, or the section is 'measured' and the rotor is not fitted.
    """
    _check_request((rotor,), level, section)
    pitch, speed, climb = np.broadcast_arrays(*np.atleast_1d(pitch_rad, speed_rad_s, climb_m_s))

    def solve_loads(bladings: Sequence[Blading], turned_rad: Sequence[float]) -> Array:
        out = solve_rotor_batch(
            bladings[0], pitch_rad=pitch + turned_rad[0], speed_rad_s=speed, climb_m_s=climb, air=air
        )
        return np.stack((out.thrust_N, out.torque_Nm))

    knowledge = _Knowledge(corrections or Corrections(), n_crit, engine, section, family, doubt)
    points = (pitch, speed, climb / (rotor.radius_m * speed))
    return _predict_loads((rotor,), solve_loads, points, knowledge, level, scales)


def predict_system_interval(
    solution: SystemSolution,
    *,
    corrections: Corrections | None = None,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    section: SectionKnowledge = "known",
    family: str = "",
    doubt: InputUncertainty | None = None,
    level: float = 0.9,
    scales: tuple[float, float] = THRUST_TORQUE_ERROR_SCALES,
) -> PredictionInterval:
    """Return intervals of the loads of each rotor of a system at a solved point, by any method.

    The deviations by each cause are those of blade elements with the rotors coupled, at the pitch, speed and climb of
    the solution; they are added to the loads of the solution's own method. A cause changes all rotors at once, for
    rotors on one shaft are commonly of one series; fits change the rotors that have the same fit.

    Parameters
    ----------
    solution : SystemSolution
    corrections, n_crit, engine, section, family, doubt, level, scales
        As for :func:`predict_interval`.

    Returns
    -------
    PredictionInterval
        Arrays with one element for each rotor, the uppermost first.

    Raises
    ------
    InputError
        As :func:`predict_interval`.
    MuflyError
        If blade elements do not converge at a changed point.
    """
    placed = solution.placed
    rotors = tuple(p.blading.rotors[p.index_in_blading] for p in placed)
    _check_request(rotors, level, section)
    heights, signs = tuple(p.height_m for p in placed), tuple(p.rotation_sign for p in placed)
    near: list[SystemSolution] = []

    def solve_loads(bladings: Sequence[Blading], turned_rad: Sequence[float]) -> Array:
        system = RotorSystem(tuple(bladings), heights, signs, (0,) * len(placed))
        condition = OperatingCondition(
            [p.pitch_rad + turn for p, turn in zip(placed, turned_rad, strict=True)],
            [p.speed_rad_s for p in placed], climb_m_s=solution.climb_m_s, air=solution.air,
        )  # fmt: skip
        found = solve_system(system, condition, start=near[0] if near else None)
        near[:] = near or [found]
        return np.array([[r.thrust_N for r in found.rotors], [r.torque_Nm for r in found.rotors]])

    points = (
        np.array([p.pitch_rad for p in placed]), np.array([p.speed_rad_s for p in placed]),
        np.array([solution.climb_m_s / (r.radius_m * p.speed_rad_s) for r, p in zip(rotors, placed, strict=True)]),
    )  # fmt: skip
    own = np.array([[r.thrust_N for r in solution.rotors], [r.torque_Nm for r in solution.rotors]])
    knowledge = _Knowledge(corrections or Corrections(), n_crit, engine, section, family, doubt)
    return _predict_loads(rotors, solve_loads, points, knowledge, level, scales, own)


LoadSolver = Callable[[Sequence[Blading], Sequence[float]], Array]
"""Loads (2, n), thrust and torque, of rotors with these bladings and added pitch angles (rad)."""


class _Knowledge(NamedTuple):
    """Theory and knowledge of the sections, as for :func:`predict_interval`."""

    corrections: Corrections
    n_crit: float
    engine: PolarEngine
    section: SectionKnowledge
    family: str
    doubt: InputUncertainty | None

    def prepare_blading(
        self, rotor: Rotor, polars: Mapping[str, PolarTable] | None = None, *, n_crit: float | None = None
    ) -> Blading:
        """Return the blading of a rotor by this theory."""
        return prepare_blading(
            rotor, polars, n_crit=self.n_crit if n_crit is None else n_crit, engine=self.engine,
            corrections=self.corrections,
        )  # fmt: skip

    def estimate_input_uncertainty(self, rotor: Rotor) -> InputUncertainty:
        """Return the standard deviations of the causes for a rotor."""
        if self.doubt is not None:
            return self.doubt
        guessed = self.section == "guessed" and rotor.fit is None
        families = find_family_priors(rotor, self.family) if guessed or self.family else ()
        return replace(
            InputUncertainty.for_guessed_section() if guessed else InputUncertainty(),
            pitch_rad=estimate_pitch_offset_prior(rotor, families).offset_std_rad,
        )


def _check_request(rotors: Sequence[Rotor], level: float, section: SectionKnowledge) -> None:
    if level not in PREDICTION_INTERVAL_LEVELS:
        known = ", ".join(map(str, PREDICTION_INTERVAL_LEVELS))
        raise ArgumentError("band", f"{level:g}", "is not an available probability", f"choose one of {known}")
    if section not in SECTION_KNOWLEDGE_LEVELS:
        raise InputError(
            "uncertainty",
            "section",
            f"{section!r} is unknown",
            f"use one of: {', '.join(SECTION_KNOWLEDGE_LEVELS)}",
        )
    for rotor in rotors:
        if section == "measured" and rotor.fit is None:
            raise InputError(
                f"rotor {rotor.name}", "fit", "is missing: its sections have no measurement",
                "run `mufly rotor fit` on a bench file, or give section known or guessed",
            )  # fmt: skip


def _predict_loads(
    rotors: Sequence[Rotor],
    solve: LoadSolver,
    points: tuple[Array, Array, Array],
    knowledge: _Knowledge,
    level: float,
    scales: tuple[float, float],
    own: Array | None = None,
) -> PredictionInterval:
    """Return the interval of loads (2, n); ``own`` are those of the user's method, by default those of ``solve``.

    ``points`` are pitch (rad), speed (rad/s) and climb over tip speed of each of the n points of one rotor, or of each
    of n rotors.
    """
    nominal = [knowledge.prepare_blading(r) for r in rotors]
    unsure = [knowledge.estimate_input_uncertainty(r) for r in rotors]
    still = [0.0] * len(rotors)
    base = solve(nominal, still)
    values = base.copy() if own is None else own.copy()
    fitted = np.broadcast_to([r.fit is not None for r in rotors], points[0].shape)
    distinct = [r for k, r in enumerate(rotors) if r not in rotors[:k]]

    def replace_blading(old: Rotor, new: Blading) -> list[Blading]:
        return [new if r == old else b for r, b in zip(rotors, nominal, strict=True)]

    causes = _vary_inputs(rotors, nominal, unsure, solve, base, values, knowledge) if not fitted.all() else {}
    for rotor in distinct:
        if rotor.fit is not None:
            which = np.broadcast_to([r == rotor for r in rotors], points[0].shape)

            def solve_fitted(one: Rotor, rotor: Rotor = rotor) -> Array:
                return solve(replace_blading(rotor, knowledge.prepare_blading(one)), still)

            parts = _predict_fitted_rotor(
                rotor, rotor.fit, solve_fitted, points, unsure[rotors.index(rotor)], values * which
            )
        elif knowledge.section == "guessed":

            def solve_section(blading: Blading, rotor: Rotor = rotor) -> Array:
                return solve(replace_blading(rotor, blading), still)

            mean, between = _average_over_sections(rotor, knowledge, solve_section)
            values += mean - base
            parts = {"section": between}
        else:
            continue
        for name, part in parts.items():
            causes[name] = np.hypot(causes[name], part) if name in causes else part
    quantiles = np.where(fitted, float(ndtri(0.5 + 0.5 * level)), interval_quantile(level) * np.array(scales)[:, None])
    return _make_interval(values, causes, level, quantiles)


def _vary_inputs(
    rotors: Sequence[Rotor],
    nominal: Sequence[Blading],
    unsure: Sequence[InputUncertainty],
    solve: LoadSolver,
    base: Array,
    values: Array,
    knowledge: _Knowledge,
) -> dict[str, Array]:
    """Return the deviation of the loads ``base`` due to each cause, varied at all rotors without a fit, (2, n).

    The deviation of the method is a share of ``values``.
    """
    unfitted = [r.fit is None for r in rotors]
    first = unsure[unfitted.index(True)]

    def solve_changed(
        turned: Callable[[InputUncertainty], float] = lambda _: 0.0, lift: float = 1.0, drag: float = 1.0
    ) -> Array:
        fixes = replace(
            knowledge.corrections, lift_factor=knowledge.corrections.lift_factor * lift,
            drag_factor=knowledge.corrections.drag_factor * drag,
        )  # fmt: skip
        changed = [replace(b, corrections=fixes) if one else b for b, one in zip(nominal, unfitted, strict=True)]
        return solve(changed, [turned(u) if one else 0.0 for u, one in zip(unsure, unfitted, strict=True)])

    def rms_deviation(*others: Array) -> Array:
        """Return the RMS deviation of loads from the nominal ones."""
        return np.asarray(np.sqrt(np.mean([(o - base) ** 2 for o in others], axis=0)))

    thick = DRAG_FACTOR_PER_THICKNESS_RATIO * first.thickness
    shift = ZERO_LIFT_RAD_PER_CAMBER_RATIO * first.camber
    bladings_by_n_crit = [
        [knowledge.prepare_blading(r, n_crit=n) if r.fit is None else b for r, b in zip(rotors, nominal, strict=True)]
        for n in first.n_crit_cases
    ]
    return {
        "n_crit": rms_deviation(*(solve(bladings, [0.0] * len(rotors)) for bladings in bladings_by_n_crit), base),
        "engine": np.hypot(
            rms_deviation(solve_changed(lift=1 + first.lift), solve_changed(lift=1 - first.lift)),
            rms_deviation(solve_changed(drag=1 + first.drag), solve_changed(drag=1 - first.drag)),
        ),
        "camber": rms_deviation(solve_changed(lambda _: shift), solve_changed(lambda _: -shift)),
        "thickness": rms_deviation(solve_changed(drag=1 + thick), solve_changed(drag=1 - thick)),
        "pitch": rms_deviation(solve_changed(lambda u: u.pitch_rad), solve_changed(lambda u: -u.pitch_rad)),
        "method": np.array([[first.method_thrust], [first.method_torque]]) * np.abs(values) * unfitted,
    }


def _average_over_sections(
    rotor: Rotor, knowledge: _Knowledge, solve: Callable[[Blading], Array]
) -> tuple[Array, Array]:
    """Return mean and standard deviation of the loads over the likely sections of a rotor, (2, n) each."""
    listed = [(a, w) for a, w in list_section_probabilities(rotor, knowledge.family) if w >= _MIN_SECTION_PROBABILITY]
    ones = [replace_rotor(rotor, {"blade.airfoils": a}) for a, _ in listed]
    every = {name for one in ones for name in one.airfoil_names()}
    tables = compute_rotor_polars(rotor, every, n_crit=knowledge.n_crit, engine=knowledge.engine)
    several = np.array([solve(knowledge.prepare_blading(one, tables)) for one in ones])
    weights = np.array([w for _, w in listed])
    weights /= weights.sum()
    mean = np.tensordot(weights, several, 1)
    return mean, np.sqrt(np.tensordot(weights, (several - mean) ** 2, 1))


def interval_quantile(level: float) -> float:
    """Return the half width of an interval over the scale of Student's distribution: t_3((1 + level) / 2)."""
    return float(stdtrit(_STUDENT_DEGREES_OF_FREEDOM, 0.5 + 0.5 * level))


def fit_student_scale(errors: Sequence[Array]) -> float:
    """Return the most likely scale k of Student's distribution for errors divided by their predicted standard
    deviations.

    The root mean square z_i of a rotor's errors counts as one draw, so that neither long sweeps nor copies of a point
    count more than others. The maximum of sum_i log(f_3(z_i / k) / k), f_3 Student's density with n = 3 degrees of
    freedom, is where (own derivation)

        k^2 = (n + 1) / N sum_i z_i^2 / (n + z_i^2 / k^2)

    which is solved by iteration (Lange, Little, Taylor, J. Am. Stat. Assoc. 84, 1989).

    Parameters
    ----------
    errors : sequence of (points,) arrays
        Measured less predicted over the standard deviation s, one array a rotor; nan without measurement.

    Returns
    -------
    float
        1 if nothing was measured.
    """
    z2 = np.array([np.mean(e[np.isfinite(e)] ** 2) for e in errors if np.isfinite(e).any()])
    if not z2.any():
        return 1.0
    k2 = float(np.median(z2)) or float(z2.mean())
    for _ in range(_MAX_SCALE_ITERATIONS):
        before, k2 = (
            k2,
            (_STUDENT_DEGREES_OF_FREEDOM + 1.0) * float(np.mean(z2 / (_STUDENT_DEGREES_OF_FREEDOM + z2 / k2))),
        )
        if abs(k2 - before) < 1e-12 * k2:
            break
    return math.sqrt(k2)


def _make_interval(values: Array, causes: Mapping[str, Array], level: float, quantiles: Array) -> PredictionInterval:
    """Return the prediction interval of nominal loads from the standard deviations of all causes of errors.

    ``values``: nominal thrust and torque (2, n). ``causes``: standard deviations due to each cause, (2, n).
    ``quantiles``: half widths in standard deviations, (2, n).
    """
    half = quantiles * np.sqrt(np.sum([np.square(c) for c in causes.values()], axis=0))
    size = np.where(values == 0.0, np.nan, np.abs(values))
    low, high = values - half, values + half
    return PredictionInterval(
        values[0], values[1], low[0], high[0], low[1], high[1], level,
        {name: c[0] / size[0] for name, c in causes.items()}, {name: c[1] / size[1] for name, c in causes.items()},
    )  # fmt: skip


def _predict_fitted_rotor(
    rotor: Rotor,
    fit: SectionFit,
    at: Callable[[Rotor], Array],
    points: tuple[Array, Array, Array],
    unsure: InputUncertainty,
    values: Array,
) -> dict[str, Array]:
    """Return the standard deviation of a fitted rotor's loads ``values`` due to each cause, (2, n) each."""
    pitch, speed, climb = points
    weights = np.array([c.probability for c in fit.candidates])
    means, within = [], []
    for candidate in fit.candidates:
        one = replace_rotor(rotor, {"blade.airfoils": candidate.airfoils})

        def solve_with_change(change: Array, one: Rotor = one, candidate: SectionCandidate = candidate) -> Array:
            now = candidate.model_copy(update={"change": tuple(change.tolist())})
            return at(one.model_copy(update={"fit": fit.model_copy(update={"candidates": (now,)})}))

        change, covariance = np.array(candidate.change), np.array(candidate.covariance)
        # One standard deviation to either side along each principal axis
        size, axes = np.linalg.eigh(covariance)
        mean = solve_with_change(change)
        spread = [
            0.5 * (solve_with_change(change + step) - solve_with_change(change - step))
            for step in (np.sqrt(np.maximum(size, 0.0)) * axes).T
        ]
        means.append(mean)
        within.append(np.sum(np.square(spread), axis=0))
    between = np.tensordot(weights, (np.array(means) - means[0]) ** 2, 1)
    off_pitch = np.maximum(np.maximum(fit.pitch_rad[0] - pitch, pitch - fit.pitch_rad[1]), 0.0) / math.radians(5.0)
    off_speed = np.maximum(np.maximum(fit.speed_rad_s[0] / speed, speed / fit.speed_rad_s[1]), 1.0)
    off_climb = np.maximum(np.maximum(fit.climb_ratio[0] - climb, climb - fit.climb_ratio[1]), 0.0) / 0.1
    away = np.minimum(np.sqrt(off_pitch**2 + np.log2(off_speed) ** 2 + off_climb**2), 1.0)
    method = np.array([[unsure.method_thrust], [unsure.method_torque]]) * away * np.abs(values)
    return {
        "fit": np.sqrt(np.tensordot(weights, np.array(within), 1)),
        "section": np.sqrt(between),
        "scatter": np.array(fit.scatter)[:, None] * np.abs(values),
        "method": method,
    }
