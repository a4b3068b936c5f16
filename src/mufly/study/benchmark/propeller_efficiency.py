"""Propellers in a tunnel: errors of the greatest efficiency, its advance ratio, and the advance ratio of zero thrust.

With propeller coefficients, eta = J c_T / c_P = V T / P. The greatest measured efficiency follows from the parabola
through the greatest eta of a run and its neighbours. The advance ratio of zero thrust is interpolated linearly. Both
are nan if the run does not cover them. Predicted values follow in the same way from the code's curve on a finer grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mufly.errors import MuflyError
from mufly.results import ResultColumn
from mufly.rotor import RotorMeasurements
from mufly.study.benchmark.prediction_codes import PredictionCode
from mufly.study.benchmark.rotor_cases import RotorCase

Array = NDArray[np.float64]

_ADVANCE_GRID_POINT_COUNT, _SLOW_ADVANCE_GRID_POINT_COUNT = 45, 9
# Range of the predicted points, of the advance ratio of zero thrust.
_MIN_ADVANCE_FRACTION, _MAX_ADVANCE_FRACTION = 0.25, 1.4


@dataclass(frozen=True)
class EfficiencyFigures:
    """Greatest efficiency, its advance ratio, and the advance ratio of zero thrust; nan if not covered."""

    max_efficiency: float
    best_advance_ratio: float
    zero_thrust_advance_ratio: float


@dataclass(frozen=True)
class PropellerScore:
    """Measured efficiency curve of a propeller run, and the curve that one prediction code predicts."""

    code: str
    case: RotorCase
    speed_rad_s: float
    measured: EfficiencyFigures
    predicted: EfficiencyFigures
    fault: str = ""

    @property
    def relative_errors(self) -> tuple[float, float, float]:
        """Relative errors of the greatest efficiency, its advance ratio, and the advance ratio of zero thrust."""
        p, m = self.predicted, self.measured
        return (
            p.max_efficiency / m.max_efficiency - 1.0,
            p.best_advance_ratio / m.best_advance_ratio - 1.0,
            p.zero_thrust_advance_ratio / m.zero_thrust_advance_ratio - 1.0,
        )


def compute_efficiency_curve(advance: Array, thrust_N: Array, power_W: Array, airspeed_m_s: Array) -> EfficiencyFigures:
    """Return the efficiency curve of a run; all arrays (points,), in order of increasing advance ratio."""
    known = np.isfinite(thrust_N) & np.isfinite(power_W) & (power_W > 0.0)
    j, t = advance[known], thrust_N[known]
    eta = airspeed_m_s[known] * t / power_W[known]
    efficiency = best = math.nan
    k = int(np.argmax(eta)) if eta.size else 0
    if 0 < k < eta.size - 1:
        a, b, _ = np.polyfit(j[k - 1 : k + 2] - j[k], eta[k - 1 : k + 2], 2)
        efficiency, best = float(eta[k] - 0.25 * b * b / a), float(j[k] - 0.5 * b / a)
    ends = np.flatnonzero((t[:-1] > 0.0) & (t[1:] <= 0.0))
    zero = math.nan
    if ends.size:
        i = int(ends[0])
        zero = float(j[i] + t[i] * (j[i + 1] - j[i]) / (t[i] - t[i + 1]))
    return EfficiencyFigures(efficiency, best, zero)


def score_propellers(
    cases: Sequence[RotorCase],
    codes: Sequence[PredictionCode],
    progress: Callable[[int, int], None] | None = None,
) -> list[PropellerScore]:
    """Run every code on every tunnel run; slow codes (seconds per point) use a coarser grid."""
    runs = [(code, case, run) for code in codes for case in cases for run in case.tunnel_runs]
    scores = []
    for done, (code, case, run) in enumerate(runs):
        if progress is not None:
            progress(done, len(runs))
        speed = float(run.speed_rad_s[0])
        per_speed = 2.0 * case.rotor.radius_m * speed / (2.0 * math.pi)  # m/s of V for J = 1
        j = run.climb_m_s / per_speed
        measured = compute_efficiency_curve(j, run.thrust_N, run.torque_Nm * speed, run.climb_m_s)
        end = (
            measured.zero_thrust_advance_ratio
            if math.isfinite(measured.zero_thrust_advance_ratio)
            else 1.15 * float(j[-1])
        )
        grid = end * np.linspace(
            _MIN_ADVANCE_FRACTION,
            _MAX_ADVANCE_FRACTION,
            _SLOW_ADVANCE_GRID_POINT_COUNT if code.is_slow else _ADVANCE_GRID_POINT_COUNT,
        )
        same = np.full(grid.size, 1.0)
        asked = RotorMeasurements(run.pitch_rad[0] * same, speed * same, same, same, run.source, grid * per_speed)
        try:
            found = code.predict(replace(case, measured=asked))
            predicted = compute_efficiency_curve(grid, found.thrust_N, found.torque_Nm * speed, asked.climb_m_s)
            fault = found.fault
        except MuflyError as error:
            predicted, fault = EfficiencyFigures(math.nan, math.nan, math.nan), str(error)
        scores.append(PropellerScore(code.name, case, speed, measured, predicted, fault))
    if progress is not None:
        progress(len(runs), len(runs))
    return scores


@dataclass(frozen=True)
class PropellerScoreRow:
    """Score of a code on a group or family of propellers: mean absolute value and bias of the relative errors."""

    code: str
    group: str
    rotors: int
    runs: int
    size: tuple[float, ...]
    bias: tuple[float, ...]


PROPELLER_SCORE_COLUMNS: tuple[ResultColumn | str, ...] = (
    "code",
    "group",
    "rotors",
    "runs",
    *(
        ResultColumn(f"{kind}.{k}", form=form, head=f"{name} {head}")
        for k, name in enumerate(("peak efficiency", "its advance ratio", "zero-thrust advance ratio"))
        for kind, form, head in (("size", ".1%", "error"), ("bias", "+.1%", "bias"))
    ),
)
"""Columns of printed scores in a wind tunnel."""


def tabulate_propeller_scores(scores: Sequence[PropellerScore], by_family: bool = False) -> list[PropellerScoreRow]:
    """Return means over rotors, each with the same weight, by code and group, or by code and family."""

    def group_key(s: PropellerScore) -> tuple[str, str]:
        return s.code, s.case.family if by_family else s.case.group

    rows = []
    for code, group in dict.fromkeys(group_key(s) for s in scores):
        part = [s for s in scores if group_key(s) == (code, group)]
        names = list(dict.fromkeys(s.case.name for s in part))
        errors = [np.array([s.relative_errors for s in part if s.case.name == n]) for n in names]
        rows.append(
            PropellerScoreRow(
                code,
                group,
                len(names),
                len(part),
                _mean_over_rotors([np.abs(e) for e in errors]),
                _mean_over_rotors(errors),
            )
        )
    return rows


def _mean_over_rotors(errors: Sequence[Array]) -> tuple[float, ...]:
    """Return the mean over rotors of the means over their runs, (runs, 3) arrays; nan are left out."""
    out = []
    for column in range(3):
        each = [e[:, column][np.isfinite(e[:, column])] for e in errors]
        known = [float(e.mean()) for e in each if e.size]
        out.append(float(np.mean(known)) if known else math.nan)
    return tuple(out)
