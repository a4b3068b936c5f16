"""Uncertainty of predicted thrust and torque: intervals from unknown blade sections and errors of the method.

Causes are varied one at a time about the nominal rotor, each by one standard deviation:

* ``n_crit``: transition early or late, 4 and 9 beside the nominal value (the dissertation's Table 3.1);
* ``engine``: 4 % of the lift coefficient, 8 % of the drag coefficient, the disagreement of network, boundary-layer
  code and wind tunnel below Re 1e5 (docs/log/2026-11-28-polars.md);
* ``camber``: 0.3 % of the chord for a known section; zero-lift angle -2 f (thin airfoil, parabola);
* ``thickness``: 0.5 % of the chord; drag 1 + 2 t (Hoerner, Fluid-Dynamic Drag, 1965, ch. II);
* ``pitch``: the prior of the effective pitch (:mod:`mufly.rotor.effective_pitch`), by the source of the geometry;
* ``method``: 5 % of thrust, 8 % of torque, the order of the difference to a vortex lattice with a contracting wake
  (docs/log/2026-11-28-bemt-accuracy.md).

If the section is guessed, the prediction is the mean over the candidate sections (:mod:`mufly.rotor.blade_families`),
weighted with their probabilities, and their variance adds to the causes. Camber and thickness then vary only within one
step of the grid of candidates.

The causes are treated as independent: variances add. Their standard deviations are not fitted. The sum is widened by
:data:`INTERVAL_WIDENING` for unlisted causes. These two factors are fitted: nominal 90 % intervals then contain 90 % of
the points of the benchmark's rotors, each rotor with the same weight. `mufly rotor benchmark --held-out` measures the
coverage on held-out families of rotors (docs/accuracy.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.errors import ArgumentError, InputError
from mufly.results import result
from mufly.rotor.bemt import solve_rotor_batch
from mufly.rotor.blade_families import (
    DRAG_PER_THICKNESS,
    GRID_STEP_STD,
    ZERO_LIFT_PER_CAMBER,
    section_probabilities,
)
from mufly.rotor.blading import Blading, Corrections, compute_rotor_polars, prepare_blading
from mufly.rotor.effective_pitch import effective_pitch_prior
from mufly.rotor.geometry import Rotor, SectionCandidate, SectionFit, replace_rotor
from mufly.rotor.rotor_system import Air
from mufly.rotor.sections.polar_engines import PolarEngine

Array = NDArray[np.float64]
SectionKnowledge = Literal["known", "guessed", "measured"]
SECTION_KNOWLEDGE_LEVELS: tuple[SectionKnowledge, ...] = ("known", "guessed", "measured")

INTERVAL_WIDENING = (0.98, 1.33)
"""Factors on the deviations of thrust and torque, fitted to the 90 % intervals of 21 rotors (docs/accuracy.md)."""
_MIN_SECTION_PROBABILITY = 0.003  # sections below this probability are left out of the mean


@dataclass(frozen=True)
class InputUncertainty:
    """Standard deviations of the causes; the defaults are those of a known section."""

    n_crit: tuple[float, ...] = (4.0, 9.0)
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
        return cls(camber=GRID_STEP_STD[0], thickness=GRID_STEP_STD[1])


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
    thrust_share, torque_share : dict of str to (n,) arrays
        Relative standard deviation due to each cause.
    """

    thrust_N: Array
    torque_Nm: Array
    thrust_low_N: Array
    thrust_high_N: Array
    torque_low_Nm: Array
    torque_high_Nm: Array
    level: float
    thrust_share: Mapping[str, Array]
    torque_share: Mapping[str, Array]

    def as_record(self, k: int = 0) -> dict[str, Any]:
        """Return level, nominal values and intervals of point ``k``."""
        return {
            "level": self.level,
            "mean_thrust_N": float(self.thrust_N[k]),
            "mean_torque_Nm": float(self.torque_Nm[k]),
            "thrust_N": [float(self.thrust_low_N[k]), float(self.thrust_high_N[k])],
            "torque_Nm": [float(self.torque_low_Nm[k]), float(self.torque_high_Nm[k])],
        }


_SIGMAS_BY_LEVEL = {0.5: 0.674, 0.68: 0.994, 0.8: 1.282, 0.9: 1.645, 0.95: 1.960, 0.99: 2.576}


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
    wider: tuple[float, float] | None = None,
) -> PredictionInterval:
    """Predict thrust and torque with an interval.

    For a fitted rotor (:func:`mufly.rotor.fit_rotor`) the interval includes the posterior of the five parameters, the
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
        Family of a guessed section, if known: one of :data:`mufly.rotor.blade_families.BLADE_FAMILIES`.
    doubt : InputUncertainty, optional
        Standard deviations of the causes; default: those of a known or guessed section.
    level : float
        Coverage: 0.5, 0.68, 0.8, 0.9, 0.95 or 0.99.
    wider : (float, float), optional
        Factors in place of :data:`INTERVAL_WIDENING`.

    Raises
    ------
    InputError
        If level, section or family is invalid, or the section is 'measured' and the rotor is not fitted.
    """
    if level not in _SIGMAS_BY_LEVEL:
        known = ", ".join(map(str, _SIGMAS_BY_LEVEL))
        raise ArgumentError("band", f"{level:g}", "is not a probability of a known interval", f"choose one of {known}")
    if section not in SECTION_KNOWLEDGE_LEVELS:
        raise InputError(
            "uncertainty",
            "section",
            f"{section!r} is unknown",
            f"use one of: {', '.join(SECTION_KNOWLEDGE_LEVELS)}",
        )
    if section == "measured" and rotor.fit is None:
        raise InputError(
            f"rotor {rotor.name}", "fit", "is missing: its sections have no measurement",
            "run `mufly rotor fit` on a bench file, or give section known or guessed",
        )  # fmt: skip
    guessed = section == "guessed" and rotor.fit is None
    unsure = doubt or replace(
        InputUncertainty.for_guessed_section() if guessed else InputUncertainty(),
        pitch_rad=effective_pitch_prior(rotor).std_rad,
    )
    fixes = corrections or Corrections()
    pitch, speed, climb = np.broadcast_arrays(*np.atleast_1d(pitch_rad, speed_rad_s, climb_m_s))
    if rotor.fit is not None:

        def solve_rotor_loads(one: Rotor) -> Array:
            blading = prepare_blading(one, n_crit=n_crit, engine=engine, corrections=fixes)
            out = solve_rotor_batch(blading, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=air)
            return np.stack((out.thrust_N, out.torque_Nm))

        ratio = climb / (rotor.radius_m * speed)
        values, parts = _predict_fitted_rotor(rotor, rotor.fit, solve_rotor_loads, (pitch, speed, ratio), unsure)
        return _make_interval(values, parts, level)
    nominal = prepare_blading(rotor, n_crit=n_crit, engine=engine, corrections=fixes)

    def solve_loads(blading: Blading = nominal, turned: float = 0.0) -> tuple[Array, Array]:
        out = solve_rotor_batch(blading, pitch_rad=pitch + turned, speed_rad_s=speed, climb_m_s=climb, air=air)
        return out.thrust_N, out.torque_Nm

    def solve_scaled_loads(lift: float, drag: float) -> tuple[Array, Array]:
        changed = replace(fixes, lift_factor=fixes.lift_factor * lift, drag_factor=fixes.drag_factor * drag)
        return solve_loads(replace(nominal, corrections=changed))

    thrust, torque = solve_loads()

    def rms_departure(*others: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the root mean square deviation from the nominal point."""
        return (
            np.sqrt(np.mean([(t - thrust) ** 2 for t, _ in others], axis=0)),
            np.sqrt(np.mean([(q - torque) ** 2 for _, q in others], axis=0)),
        )

    shift = ZERO_LIFT_PER_CAMBER * unsure.camber
    causes = {
        "n_crit": rms_departure(
            *(solve_loads(prepare_blading(rotor, n_crit=n, engine=engine, corrections=fixes)) for n in unsure.n_crit),
            (thrust, torque),
        ),
        "engine": _combine_deviations(
            rms_departure(solve_scaled_loads(1 + unsure.lift, 1.0), solve_scaled_loads(1 - unsure.lift, 1.0)),
            rms_departure(solve_scaled_loads(1.0, 1 + unsure.drag), solve_scaled_loads(1.0, 1 - unsure.drag)),
        ),
        "camber": rms_departure(solve_loads(turned=shift), solve_loads(turned=-shift)),
        "thickness": rms_departure(
            solve_scaled_loads(1.0, 1 + DRAG_PER_THICKNESS * unsure.thickness),
            solve_scaled_loads(1.0, 1 - DRAG_PER_THICKNESS * unsure.thickness),
        ),
        "pitch": rms_departure(solve_loads(turned=unsure.pitch_rad), solve_loads(turned=-unsure.pitch_rad)),
        "method": (unsure.method_thrust * np.abs(thrust), unsure.method_torque * np.abs(torque)),
    }
    values, all_causes = np.stack((thrust, torque)), {name: np.stack(pair) for name, pair in causes.items()}
    if guessed:
        listed = [(a, w) for a, w in section_probabilities(rotor, family) if w >= _MIN_SECTION_PROBABILITY]
        ones = [replace_rotor(rotor, {"blade.airfoils": a}) for a, _ in listed]
        every = {name for one in ones for name in one.airfoil_names()}
        tables = compute_rotor_polars(rotor, every, n_crit=n_crit, engine=engine)
        several = np.array([solve_loads(prepare_blading(one, tables, corrections=fixes)) for one in ones])
        weights = np.array([w for _, w in listed])
        weights /= weights.sum()
        values = np.tensordot(weights, several, 1)
        all_causes["section"] = np.sqrt(np.tensordot(weights, (several - values) ** 2, 1))
    return _make_interval(values, all_causes, level, wider or INTERVAL_WIDENING)


def _make_interval(
    values: Array, causes: Mapping[str, Array], level: float, wider: tuple[float, float] = (1.0, 1.0)
) -> PredictionInterval:
    """Make the interval from nominal thrust and torque (2, n) and standard deviations of each cause (2, n)."""
    sigma = (
        np.array(wider)[:, None]
        * _SIGMAS_BY_LEVEL[level]
        * np.sqrt(np.sum([np.square(c) for c in causes.values()], axis=0))
    )
    size = np.where(values == 0.0, np.nan, np.abs(values))
    low, high = values - sigma, values + sigma
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
) -> tuple[Array, dict[str, Array]]:
    """Return the prediction of a fitted rotor and the standard deviation due to each cause, (2, n) each."""
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
    value = means[0]
    method = np.array([[unsure.method_thrust], [unsure.method_torque]]) * away * np.abs(value)
    return value, {
        "fit": np.sqrt(np.tensordot(weights, np.array(within), 1)),
        "section": np.sqrt(between),
        "scatter": np.array(fit.scatter)[:, None] * np.abs(value),
        "method": method,
    }


def _combine_deviations(*pairs: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the combined standard deviation of independent causes."""

    def root_sum_square(parts: Sequence[Array]) -> Array:
        return np.sqrt(np.sum(np.square(parts), axis=0))

    return root_sum_square([t for t, _ in pairs]), root_sum_square([q for _, q in pairs])
