"""Scores of prediction codes against measurements: errors by rotor and group, held-out points and cross-validation.

An error is prediction / measurement - 1. The score of a rotor is the mean absolute error of its points, the score of a
group the mean over its rotors. No code is fitted to the points on which it is scored: :func:`score_held_out_points`
fits some points of a sweep and scores the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.files.answer_store import hash_inputs, read_stored_result, write_stored_result
from mufly.results import ResultColumn, result
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor import fit_rotor, predict_interval
from mufly.rotor.measured.uncertainty import fit_student_scale, interval_quantile
from mufly.study.benchmark.prediction_codes import PredictionCode, RotorPrediction, make_rotor_description
from mufly.study.benchmark.rotor_cases import RotorCase
from mufly.version import __version__

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
ProgressCallback = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class RotorScore:
    """Errors of a code on a rotor.

    Attributes
    ----------
    code : str
    case : RotorCase
        Rotor with the predicted points.
    thrust_error, torque_error : (points,) arrays
        Relative errors; nan without prediction or measurement.
    inside_interval : (2, points) array, optional
        1 if the nominal 90 % interval contains the measured thrust or torque, 0 if not, nan without interval.
    fault : str
        Reason why points have no prediction.
    relative_half_width : (2, points) array, optional
        Half width of the interval over the predicted thrust or torque.
    standardised_error : (2, points) array, optional
        Measured less predicted thrust and torque over the summed standard deviation of the causes.
    """

    code: str
    case: RotorCase
    thrust_error: Array
    torque_error: Array
    inside_interval: Array | None = None
    fault: str = ""
    relative_half_width: Array | None = None
    standardised_error: Array | None = None

    def mean_abs_error(self, of: str) -> float:
        """Return the mean absolute error of ``"thrust"`` or ``"torque"``; nan if there is none."""
        return _finite_mean(np.abs(getattr(self, f"{of}_error")))

    def mean_error(self, of: str) -> float:
        """Return the mean relative error with sign (bias) of ``"thrust"`` or ``"torque"``; nan if there is none."""
        return _finite_mean(getattr(self, f"{of}_error"))


def _finite_mean(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else math.nan


def select_points(case: RotorCase, index: NDArray[np.intp]) -> RotorCase:
    """Return a benchmark case that contains only the selected points."""
    return replace(case, measured=case.measured.select_points(index))


def thin_points(case: RotorCase, points: int) -> RotorCase:
    """Return a case with a limited number of points, evenly spaced over the sweep; 0 keeps all."""
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
    """Run every code on every rotor.

    Parameters
    ----------
    cases, codes
    points, slow_points : int
        Greatest number of points per rotor for fast codes, and for codes that take seconds per point; 0 for all.
    folder : Path, optional
        Folder of stored predictions, one file per code and rotor. A later run with the same inputs and version of mufly
        reads them. A changed external code needs another name or folder.
    progress : callable, optional
        ``progress(done, total)`` after each rotor.
    """
    scores = []
    for done, (code, case) in enumerate((code, case) for code in codes for case in cases):
        if progress is not None:
            progress(done, len(codes) * len(cases))
        asked = thin_points(case, slow_points if code.is_slow else points)
        file = None if folder is None else folder / "answers" / code.name / f"{case.name}.json"
        found = _read_cache(file, _make_prediction_cache_key(code, asked)) or _predict_and_cache(code, asked, file)
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
        write_stored_result(file, _make_prediction_cache_key(code, case), vars(found))
    return found


def _make_prediction_cache_key(code: PredictionCode, case: RotorCase) -> str:
    return hash_inputs(__version__, code.cache_settings, make_rotor_description(case))


def _read_cache(file: Path | None, key: str) -> RotorPrediction | None:
    kept = None if file is None else read_stored_result(file, key)
    if kept is None:
        return None
    return RotorPrediction(np.array(kept["thrust_N"], float), np.array(kept["torque_Nm"], float), kept["fault"])


def score_held_out_points(
    cases: Sequence[RotorCase], share: str, progress: ProgressCallback | None = None
) -> list[RotorScore]:
    """Fit a part of each rotor's sweep (:func:`mufly.rotor.fit_rotor`) and score the rest.

    Parameters
    ----------
    cases
        Cases; those with fewer than four points are skipped.
    share : 'one' or 'half'
        Fitted points: the middle point, or every other point.
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


def score_prediction_intervals(
    cases: Sequence[RotorCase], progress: ProgressCallback | None = None
) -> list[RotorScore]:
    """Score nominal 90 % intervals (:func:`mufly.rotor.predict_interval`) by cross-validation over families.

    For each family the scales of the intervals are fitted to the other families
    (:func:`mufly.rotor.measured.uncertainty.fit_student_scale`). If the section is guessed, the prediction is the mean
    over its candidates. Rotors of known and of guessed sections are scored apart.
    """
    bands = []
    for done, case in enumerate(cases):
        if progress is not None:
            progress(done, len(cases))
        m = case.measured
        bands.append(
            predict_interval(
                case.rotor, pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s, air=case.air, scales=(1.0, 1.0),
                section="known" if case.section_known else "guessed",
            )
        )  # fmt: skip
    means = [np.stack((b.thrust_N, b.torque_Nm)) for b in bands]
    truths = [np.stack((c.measured.thrust_N, c.measured.torque_Nm)) for c in cases]
    highs = [np.stack((b.thrust_high_N, b.torque_high_Nm)) for b in bands]
    quantile = interval_quantile(0.9)
    off = [quantile * (t - p) / (h - p) for t, p, h in zip(truths, means, highs, strict=True)]
    scores = []
    for case, mean, truth, high, miss in zip(cases, means, truths, highs, off, strict=True):
        others = [o for c, o in zip(cases, off, strict=True) if c.family != case.family]
        scale = np.array([[fit_student_scale([o[k] for o in others])] for k in (0, 1)])
        width = scale * (high - mean) / np.abs(mean)
        inside = np.where(np.isfinite(miss), (np.abs(miss) <= quantile * scale).astype(np.float64), math.nan)
        label = f"bemt, families, section {'known' if case.section_known else 'guessed'}"
        error = mean / truth - 1.0
        scores.append(
            RotorScore(label, case, error[0], error[1], inside, relative_half_width=width, standardised_error=miss)
        )
    return scores


def _is_within(value: Array, low: Array, high: Array) -> Array:
    held = ((value >= low) & (value <= high)).astype(np.float64)
    return np.where(np.isfinite(value), held, math.nan)


@result
class ScoreRow:
    """Score of a code on a group of rotors.

    Attributes
    ----------
    code, group : str
    rotors, points : int
    thrust, thrust_bias, torque, torque_bias : float
        Mean absolute errors and biases, relative, each rotor with the same weight.
    thrust_inside, torque_inside : float
        Fractions of points inside their 90 % intervals.
    unpredicted : int
        Number of points without a prediction.
    """

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
    unpredicted: int


SCORE_COLUMNS: tuple[ResultColumn | str, ...] = (
    "code",
    "group",
    "rotors",
    "points",
    "unpredicted",
    *(ResultColumn(name, form=".1%", head=f"{name} error") for name in ("thrust", "torque")),
    *(ResultColumn(f"{name}_bias", form="+.1%") for name in ("thrust", "torque")),
    *(ResultColumn(f"{name}_inside", form=".0%", head=f"{name} inside 90 %") for name in ("thrust", "torque")),
)
"""Columns of printed scores."""


def tabulate_by_group(scores: Sequence[RotorScore]) -> list[ScoreRow]:
    """Return the scores of each code for each group of rotors, in order of appearance; see also
    :func:`tabulate_by_family`.
    """
    pairs = dict.fromkeys((s.code, s.case.group) for s in scores)
    return [_make_row(c, g, [s for s in scores if (s.code, s.case.group) == (c, g)]) for c, g in pairs]


def tabulate_by_family(scores: Sequence[RotorScore]) -> list[ScoreRow]:
    """Return the scores of each code for each family of rotors."""
    pairs = dict.fromkeys((s.code, s.case.family) for s in scores)
    return [_make_row(c, f, [s for s in scores if (s.code, s.case.family) == (c, f)]) for c, f in pairs]


def _make_row(code: str, group: str, part: list[RotorScore]) -> ScoreRow:
    def mean_over_part(value: Callable[[RotorScore], float]) -> float:
        return _finite_mean(np.array([value(s) for s in part]))

    inside = [s.inside_interval for s in part if s.inside_interval is not None]
    shares = np.concatenate(inside, axis=1) if inside else np.full((2, 1), math.nan)
    return ScoreRow(
        code, group, len(part), sum(s.thrust_error.size for s in part),
        mean_over_part(lambda s: s.mean_abs_error("thrust")), mean_over_part(lambda s: s.mean_error("thrust")),
        mean_over_part(lambda s: s.mean_abs_error("torque")), mean_over_part(lambda s: s.mean_error("torque")),
        _finite_mean(shares[0]), _finite_mean(shares[1]),
        sum(int((~np.isfinite(s.thrust_error)).sum()) for s in part),
    )  # fmt: skip


_MAX_ROTOR_LINES = 60


def draw_scores(scores: Sequence[RotorScore]) -> Figure:
    """Draw the errors of the codes: a line for each rotor or, for more than sixty rotors, their distribution."""

    names = list(dict.fromkeys(s.case.name for s in scores))
    codes = list(dict.fromkeys(s.code for s in scores))
    single = len(names) <= _MAX_ROTOR_LINES
    figure = blank_figure(9.0, max(3.2, 1.4 + 0.21 * len(names)) if single else 4.5)
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
            label_axes(
                axes,
                f"error of the {of} (%)" + ("; line: all points, dot: mean" if single else ", mean size"),
                "rotors within it (%)",
            )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 4), fontsize="small")
    return figure


def _finite_range(errors: Array) -> tuple[float, float]:
    known = errors[np.isfinite(errors)]
    return (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
