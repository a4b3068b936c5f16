"""Codes set beside measurements: answers that are kept, errors by rotor, scores by group, what a bench run brings.

An error is prediction over measurement less one. A rotor's score is the mean size of its points' errors, a group's the
mean of its rotors'. Nothing is fitted here on what it is scored on: :func:`score_held_out_points` shows a fit some
points of a sweep and scores the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.answer_store import hash_question, read_answer, write_answer
from mufly.errors import MuflyError
from mufly.rotor import fit_rotor, predict_interval
from mufly.study.benchmark.prediction_codes import PredictionCode, RotorPrediction, describe_case
from mufly.study.benchmark.rotor_cases import RotorCase
from mufly.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class RotorScore:
    """A code on a rotor.

    Attributes
    ----------
    code : str
    case : RotorCase
        With the points that were asked.
    thrust_error, torque_error : (points,) arrays
        nan where there is no answer or no measurement.
    inside_interval : (2, points) array, optional
        1 where a nominal 90 % interval holds the measured thrust, torque; 0 where not, nan where there is neither.
    fault : str
        Why points have no answer.
    """

    code: str
    case: RotorCase
    thrust_error: Array
    torque_error: Array
    inside_interval: Array | None = None
    fault: str = ""

    def mean_abs_error(self, of: str) -> float:
        """Mean size of the error of ``"thrust"`` or ``"torque"``; nan if there is none."""
        return _mean_of_known(np.abs(getattr(self, f"{of}_error")))

    def mean_error(self, of: str) -> float:
        """Mean error."""
        return _mean_of_known(getattr(self, f"{of}_error"))


def _mean_of_known(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def select_points(case: RotorCase, index: NDArray[np.intp]) -> RotorCase:
    """Return a case with some of its points."""
    return replace(case, measured=case.measured.select_points(index))


def thin_points(case: RotorCase, points: int) -> RotorCase:
    """Return a case with so many of its points at most, evenly over the sweep; 0: all."""
    n = case.measured.thrust_N.size
    if not 0 < points < n:
        return case
    return select_points(case, np.unique(np.linspace(0, n - 1, points + 2)[1:-1].round().astype(np.intp)))


def score_codes(
    cases: Sequence[RotorCase],
    codes: Sequence[PredictionCode],
    *,
    points: int = 0,
    slow_points: int = 3,
    folder: Path | None = None,
    progress: ProgressCallback | None = None,
) -> list[RotorScore]:
    """Ask every code about every rotor.

    Parameters
    ----------
    cases, codes
    points, slow_points : int
        Points a rotor, at most, of quick codes and of those that take seconds a point; 0: all.
    folder : Path, optional
        Answers are kept there, one file a code and rotor, and found again by the next run with the same question and
        the same version of mufly; an outside code that has changed wants another name or folder.
    progress : callable, optional
        Rotors done, and in all.
    """
    scores = []
    for done, (code, case) in enumerate((code, case) for code in codes for case in cases):
        if progress is not None:
            progress(done, len(codes) * len(cases))
        asked = thin_points(case, slow_points if code.is_slow else points)
        file = None if folder is None else folder / "answers" / code.name / f"{case.name}.json"
        found = _read_cache(file, _cache_key(code, asked)) or _predict_and_cache(code, asked, file)
        m = asked.measured
        scores.append(
            RotorScore(
                code.name, asked, found.thrust_N / m.thrust_N - 1.0, found.torque_Nm / m.torque_Nm - 1.0,
                fault=found.fault,
            )
        )  # fmt: skip
    if progress is not None:
        progress(len(codes) * len(cases), len(codes) * len(cases))
    return scores


def _predict_and_cache(code: PredictionCode, case: RotorCase, file: Path | None) -> RotorPrediction:
    try:
        found = code.predict(case)
    except MuflyError as error:
        nothing = np.full(case.measured.thrust_N.size, math.nan)
        found = RotorPrediction(nothing, nothing, str(error))
    if file is not None:
        write_answer(file, _cache_key(code, case), vars(found))
    return found


def _cache_key(code: PredictionCode, case: RotorCase) -> str:
    return hash_question(__version__, code.cache_settings, describe_case(case))


def _read_cache(file: Path | None, key: str) -> RotorPrediction | None:
    kept = None if file is None else read_answer(file, key)
    if kept is None:
        return None
    return RotorPrediction(np.array(kept["thrust_N"], float), np.array(kept["torque_Nm"], float), kept["fault"])


def score_held_out_points(
    cases: Sequence[RotorCase], share: str, progress: ProgressCallback | None = None
) -> list[RotorScore]:
    """Fit a part of each rotor's sweep (:func:`mufly.rotor.fit_rotor`), score the rest.

    Parameters
    ----------
    cases
        Those with fewer than four points are left out.
    share : 'one' or 'half'
        The middle point, or every other one.
    progress : callable, optional
    """
    scores = []
    for done, case in enumerate(cases):
        if progress is not None:
            progress(done, len(cases))
        n = case.measured.thrust_N.size
        if n < 4:
            continue
        seen = np.array([n // 2]) if share == "one" else np.arange(0, n, 2)
        shown, rest = select_points(case, seen), select_points(case, np.setdiff1d(np.arange(n), seen))
        m, label = rest.measured, f"bemt, {'1 point' if share == 'one' else 'half'} seen"
        try:
            known = "known" if case.section_known else "guessed"
            fitted = fit_rotor(case.rotor, shown.measured, section=known, air=case.air).rotor  # type: ignore[arg-type]
        except MuflyError as error:
            nothing = np.full(m.thrust_N.size, math.nan)
            scores.append(RotorScore(label, rest, nothing, nothing, fault=str(error)))
            continue
        band = predict_interval(fitted, pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s, air=case.air)
        inside = np.stack(
            (
                _is_within(m.thrust_N, band.thrust_low_N, band.thrust_high_N),
                _is_within(m.torque_Nm, band.torque_low_Nm, band.torque_high_Nm),
            )
        )
        scores.append(
            RotorScore(label, rest, band.thrust_N / m.thrust_N - 1.0, band.torque_Nm / m.torque_Nm - 1.0, inside)
        )
    return scores


def score_cross_validated(cases: Sequence[RotorCase], progress: ProgressCallback | None = None) -> list[RotorScore]:
    """Nominal 90 % intervals (:func:`mufly.rotor.predict_interval`), their widths fitted to the families that they are
    not for.

    For each family the factor that widens the intervals is that with which 90 % of the other families' points lie
    inside, each rotor with the same weight. Where the section is a guess, the prediction is the mean over what it may
    be.
    """
    bands, label = [], "bemt, families"
    for done, case in enumerate(cases):
        if progress is not None:
            progress(done, len(cases))
        m = case.measured
        bands.append(
            predict_interval(
                case.rotor, pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s, air=case.air, wider=(1.0, 1.0),
                section="known" if case.section_known else "guessed",
            )
        )  # fmt: skip
    means = [np.stack((b.thrust_N, b.torque_Nm)) for b in bands]
    truths = [np.stack((c.measured.thrust_N, c.measured.torque_Nm)) for c in cases]
    highs = [np.stack((b.thrust_high_N, b.torque_high_Nm)) for b in bands]
    off = [np.abs(t - p) / (h - p) for t, p, h in zip(truths, means, highs, strict=True)]
    scores = []
    for case, mean, truth, miss in zip(cases, means, truths, off, strict=True):
        others = [o for c, o in zip(cases, off, strict=True) if c.family != case.family]
        factor = np.array([[fit_interval_factor([o[k] for o in others])] for k in (0, 1)])
        inside = np.where(np.isfinite(miss), (miss <= factor).astype(np.float64), math.nan)
        scores.append(RotorScore(label, case, mean[0] / truth[0] - 1.0, mean[1] / truth[1] - 1.0, inside))
    return scores


def fit_interval_factor(off: Sequence[Array], level: float = 0.9) -> float:
    """Return the factor on half widths with which ``level`` of the points lie inside; 1 if there are none.

    Parameters
    ----------
    off : sequence of (points,) arrays
        Distance of each rotor's measured points from the prediction over the half width; nan without measurement.
        Every rotor has the same weight.
    level : float
    """
    known = [o[np.isfinite(o)] for o in off]
    known = [o for o in known if o.size]
    if not known:
        return 1.0
    values = np.concatenate(known)
    weights = np.concatenate([np.full(o.size, 1.0 / (o.size * len(known))) for o in known])
    order = np.argsort(values)
    at = int(np.searchsorted(np.cumsum(weights[order]), level - 1e-12))
    return float(values[order][min(at, values.size - 1)])


def _is_within(value: Array, low: Array, high: Array) -> Array:
    held = ((value >= low) & (value <= high)).astype(np.float64)
    return np.where(np.isfinite(value), held, math.nan)


@dataclass(frozen=True)
class ScoreRow:
    """A code on a group: rotors, points, mean sizes and biases of the errors, shares of points inside the intervals."""

    code: str
    group: str
    rotors: int
    points: int
    thrust: float
    thrust_bias: float
    torque: float
    torque_bias: float
    thrust_inside: float
    torque_inside: float
    without: int
    """Points without an answer."""


def tabulate_by_group(scores: Sequence[RotorScore]) -> list[ScoreRow]:
    """Return the scores by code and group, in the order in which they came; and of families, see
    :func:`tabulate_by_family`."""
    pairs = dict.fromkeys((s.code, s.case.group) for s in scores)
    return [_make_row(c, g, [s for s in scores if (s.code, s.case.group) == (c, g)]) for c, g in pairs]


def tabulate_by_family(scores: Sequence[RotorScore]) -> list[ScoreRow]:
    """Return the scores by code and family."""
    pairs = dict.fromkeys((s.code, s.case.family) for s in scores)
    return [_make_row(c, f, [s for s in scores if (s.code, s.case.family) == (c, f)]) for c, f in pairs]


def _make_row(code: str, group: str, part: list[RotorScore]) -> ScoreRow:
    def mean_over_part(value: Callable[[RotorScore], float]) -> float:
        return _mean_of_known(np.array([value(s) for s in part]))

    inside = [s.inside_interval for s in part if s.inside_interval is not None]
    shares = np.concatenate(inside, axis=1) if inside else np.full((2, 1), math.nan)
    return ScoreRow(
        code, group, len(part), sum(s.thrust_error.size for s in part),
        mean_over_part(lambda s: s.mean_abs_error("thrust")), mean_over_part(lambda s: s.mean_error("thrust")),
        mean_over_part(lambda s: s.mean_abs_error("torque")), mean_over_part(lambda s: s.mean_error("torque")),
        _mean_of_known(shares[0]), _mean_of_known(shares[1]),
        sum(int((~np.isfinite(s.thrust_error)).sum()) for s in part),
    )  # fmt: skip


_MAX_ROTOR_LINES = 60


def score_picture(scores: Sequence[RotorScore]) -> Figure:
    """Draw the errors: a line a rotor, and for more than sixty rotors the share of rotors within an error."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(s.case.name for s in scores))
    codes = list(dict.fromkeys(s.code for s in scores))
    single = len(names) <= _MAX_ROTOR_LINES
    figure = Figure(figsize=(9.0, max(3.2, 1.4 + 0.21 * len(names)) if single else 4.5), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, of in zip(panels, ("thrust", "torque"), strict=True):
        for k, code in enumerate(codes):
            mine = [s for s in scores if s.code == code]
            if single:
                y = np.array([names.index(s.case.name) for s in mine]) + 0.18 * (k - 0.5 * (len(codes) - 1))
                middle = 100.0 * np.array([s.mean_error(of) for s in mine])
                ends = np.array([_finite_range(100.0 * getattr(s, f"{of}_error")) for s in mine])
                axes.hlines(y, ends[:, 0], ends[:, 1], color=f"C{k}", linewidth=1.0, alpha=0.6)
                axes.plot(middle, y, "o", markersize=4.0, color=f"C{k}", label=code)
            else:
                size = np.sort(100.0 * np.array([s.mean_abs_error(of) for s in mine]))
                size = size[np.isfinite(size)]
                axes.step(size, 100.0 * np.arange(1, size.size + 1) / max(size.size, 1), where="post", label=code)
        if single:
            axes.axvline(0.0, color="black", linewidth=0.8)
            axes.set_yticks(range(len(names)), names)
            axes.set_ylim(len(names) - 0.4, -0.6)
        else:
            axes.set_xlim(0.0, 60.0)
            axes.set_ylabel("rotors within it (%)")
        axes.set_xlabel(f"error of the {of} (%)" + ("; line: all points, dot: mean" if single else ", mean size"))
        axes.grid(alpha=0.3)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4), fontsize="small")
    return figure


def _finite_range(errors: Array) -> tuple[float, float]:
    known = errors[np.isfinite(errors)]
    return (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
