"""Analysis of a series: loads with intervals by point and by setting, and checks of their validity.

The uncertainty of a point is for the rotor as mounted. A setting (blades, pitch, speed) is the mean over its mountings,
at the mean of their speeds and densities; with mountings j of m points,

    u^2 = (tau^2 x^2 + D - O) / m + O,      D, O: mean variance of a point, mean covariance of two

where tau is the repeatability of a mounting. It is estimated from all settings with repeated mountings (averaged over
its likelihood on a grid, as in :mod:`mufly.bench.series.random_walk_drift`). Expanded uncertainties are at 95 %:
Student's t with the effective degrees of freedom of the readings (GUM G.4.1).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mufly.bench.rig.bench_devices import BenchFacts
from mufly.bench.series.series_checks import SeriesIssue, find_series_issues
from mufly.bench.series.series_plan import SeriesPlan
from mufly.bench.series.series_readings import (
    LoadChannel,
    SeriesReadings,
    axis_speeds,
    compute_air_density,
    compute_cell_loads,
    extract_record_readings,
    setting_key,
    to_rpm,
)  # fmt: skip
from mufly.bench.series.series_record import SeriesRecord, read_record
from mufly.bench.series.torque_split import TorqueSplit, split_torque
from mufly.errors import InputError
from mufly.files.input_files import validate_model
from mufly.results import result
from mufly.rotor import RotorMeasurements

Array = NDArray[np.float64]

LOAD_NAMES = ("thrust", "torque_upper", "torque_lower")
_CALIBRATION_DOF = 15.0


@result(eq=False)
class LoadInterval:
    """Load with its 95 % interval.

    Attributes
    ----------
    value, std : float
        Value and combined standard uncertainty (N or N m).
    expanded : float
        Half width of the 95 % interval.
    """

    value: float
    std: float
    expanded: float


@result(eq=False)
class SettingResult:
    """Result of one setting: blades at a pitch and a speed.

    Attributes
    ----------
    axis, rotor, lower_rotor : str
    pitch_deg, lower_pitch_deg : float
    speed_upper_rpm, speed_lower_rpm : float
        Mean measured speeds.
    density_kg_m3 : float
    mountings : int
        Number of mountings.
    thrust, torque_upper, torque_lower : LoadInterval or None
    voltage_V, current_A : dict of str to float
        Motor voltage and current by axis.
    time_s : float
        Time since the start of the series.
    use : str
        ``"measure"`` or ``"reference"``.
    nominal_rpm : float
        Planned speed.
    truth : dict of str to float
        True loads of a simulated bench.
    """

    axis: str
    rotor: str
    lower_rotor: str
    pitch_deg: float
    lower_pitch_deg: float
    speed_upper_rpm: float
    speed_lower_rpm: float
    density_kg_m3: float
    mountings: int
    thrust: LoadInterval
    torque_upper: LoadInterval | None
    torque_lower: LoadInterval | None
    voltage_V: dict[str, float]
    current_A: dict[str, float]
    time_s: float
    use: str
    nominal_rpm: float
    truth: dict[str, float] = field(default_factory=dict)

    @property
    def single_rotor_torque(self) -> LoadInterval | None:
        """Torque of the measured rotor, for a setting with a single rotor."""
        return self.torque_lower if self.axis == "lower" else self.torque_upper


@result(
    eq=False,
    json="name points settings doubts notes repeat=relative_repeatability density_relative_std",
)
class SeriesResult:
    """Results of a measurement series: loads of each setting with intervals, and issues.

    Attributes
    ----------
    name : str
    points, settings : tuple of SettingResult
        Single points as mounted, and means over mountings.
    doubts : tuple of SeriesIssue
        Issues that the checks of the series found.
    notes : tuple of str
        Corrections with their size.
    relative_repeatability : dict of str to float
        Relative repeatability tau of each load; NaN without repeated mountings.
    density_relative_std : float
        Relative standard uncertainty of the air density (1).
    """

    name: str
    points: tuple[SettingResult, ...]
    settings: tuple[SettingResult, ...]
    doubts: tuple[SeriesIssue, ...]
    notes: tuple[str, ...]
    relative_repeatability: dict[str, float]
    density_relative_std: float

    @property
    def fatal_issues(self) -> tuple[SeriesIssue, ...]:
        """Issues for which the results of the series are refused."""
        return tuple(d for d in self.doubts if d.is_fatal)


def analyse_series(
    record: SeriesRecord | str | Path, *, known: RotorMeasurements | None = None, known_relative_std: float = 0.01,
    accept: Sequence[str] = (),
) -> SeriesResult:  # fmt: skip
    """Analyse a series: return the loads of each setting with 95 % intervals, and the issues found.

    Parameters
    ----------
    record : SeriesRecord, str or Path
        Record, or the folder that holds it.
    known : RotorMeasurements, optional
        Torque of the reference rotor, for a bench without a torque cell.
    known_relative_std : float
        Relative standard uncertainty of ``known``.
    accept : sequence of str
        Kinds of issues (:mod:`mufly.bench.series.series_checks`) that do not invalidate the series. ``"saturated"``
        omits those points.

    Raises
    ------
    InputError
        If there is no record, or it holds too few readings.
    """
    rec = record if isinstance(record, SeriesRecord) else read_record(record)
    if not rec.lines:
        raise InputError("record", "", "is empty", "run the series first")
    plan = validate_model(SeriesPlan, _parse_plan(rec), "record")
    facts = BenchFacts.from_dict(rec.header_line["facts"])
    start = float(rec.header_line["time"])
    everything, zeros = extract_record_readings(rec, "point"), extract_record_readings(rec, "tare")
    doubts = sorted(find_series_issues(plan, facts, rec, everything, zeros), key=lambda d: not d.is_fatal)
    good = everything.at_speed & everything.settled & ~everything.saturated & (everything.spike_share < 0.02)
    points = everything.select_readings(good)
    if not len(points):
        raise InputError("record", "", "contains no usable point", doubts[0].text if doubts else "measure again")
    zeros = zeros.select_readings(~zeros.saturated & (zeros.spike_share < 0.02))
    density, relative, words = compute_air_density(points, facts)
    speed = axis_speeds(points, plan)
    loads = compute_cell_loads(points, zeros, plan, facts, density, speed, start)
    notes = [words, *_describe_drifts(loads, points)]
    for name, channel in loads.items():
        doubts += find_reference_changes(name, channel, plan)
        doubts += find_outliers(name, channel, points, plan, density, speed)
        if name == "thrust" and np.mean(channel.value < 0) > 0.5:
            doubts.append(SeriesIssue("polarity", "thrust is below zero: invert the sign of the force cell", True))
    torque = loads.get("torque")
    alone = _find_known_reference_torque(points, plan, density, speed, known)
    told = split_torque(points, plan, facts, speed, torque, alone, known_relative_std, start)
    split = None if isinstance(told, str) else told
    if isinstance(told, str) and told:
        doubts.append(SeriesIssue("split", told, False))
    if split is not None:
        doubts += _check_torque_split(split)
        notes += _describe_torque_split(split)
    channels = _loads_by_axis(points, plan, facts, loads, split, alone, known_relative_std)
    relative_repeatability = {q: _estimate_repeatability(c, points, plan, density, speed) for q, c in channels.items()}
    for kind in accept:
        doubts = [SeriesIssue(d.kind, d.text, d.is_fatal and d.kind != kind) for d in doubts]
    one = [[i] for i in range(len(points))]
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, k in enumerate(points.mounting_index):
        groups.setdefault(setting_key(plan.mounting[k], float(points.nominal_rpm[i])), []).append(i)
    made = _SettingAverager(points, plan, density, speed, channels, relative_repeatability, start)
    return SeriesResult(
        plan.name,
        tuple(made.average_setting(g, mounted=True) for g in one),
        tuple(
            sorted(
                (made.average_setting(g, mounted=False) for g in groups.values() if made.is_of_measured_rotor(g)),
                key=_make_setting_sort_key,
            )
        ),
        tuple(doubts),
        tuple(notes),
        {q: t for q, (t, _) in relative_repeatability.items()},
        relative,
    )


def _make_setting_sort_key(s: SettingResult) -> tuple[object, ...]:
    """Return the sorting key of a setting: blades, pitch and speed."""
    return s.use, s.rotor, s.axis, s.pitch_deg, s.lower_pitch_deg, s.speed_upper_rpm + s.speed_lower_rpm


def _parse_plan(record: SeriesRecord) -> dict[str, object]:
    import tomllib

    return tomllib.loads(record.header_line["plan"])


def _describe_drifts(loads: dict[str, LoadChannel], points: SeriesReadings) -> Iterator[str]:
    span = max(float(np.ptp(points.time_s)), 1.0)
    for name, c in loads.items():
        zero, cov = c.zero_drift_model.predict_model_and_drift(points.time_s, np.ones((len(points), 1)))
        yield (
            f"{name}: zero read {c.zero_drift_model.time_s.size} times, went {np.ptp(zero):.3g} of the reading's unit "
            f"in {span / 60:.0f} min; followed to {math.sqrt(float(np.mean(np.diag(cov)))):.2g}"
        )
        if c.gain_drift_model is None:
            yield f"{name}: the reference was not mounted twice, so a drift of the gain is unknown"
        else:
            gain, gcov = c.gain_drift_model.predict_drift(points.time_s)
            yield (
                f"{name}: gain drifts by {100 * (gain[-1]):+.2f} % to the end, corrected to "
                f"{100 * math.sqrt(float(np.mean(np.diag(gcov)))):.2f} % by {len(c.reference_visits)} "
                "visits of "
                f"the reference"
            )


def find_reference_changes(name: str, channel: LoadChannel, plan: SeriesPlan) -> Iterator[SeriesIssue]:
    """Yield an issue for each significant change of the reference rotor's load between successive runs on one axis."""
    visits = channel.reference_visits
    for axis in ("upper", "lower"):
        mine = [
            (log_ratio, sigma) for _, log_ratio, sigma, mounting in visits if plan.mounting[int(mounting)].axis == axis
        ]
        for k, ((before, before_sigma), (after, after_sigma)) in enumerate(itertools.pairwise(mine), 1):
            step, doubt = float(after - before), math.hypot(before_sigma, after_sigma)
            if abs(step) > MAX_REFERENCE_CHANGE and abs(step) > 4.0 * doubt:
                yield SeriesIssue(
                    "reference",
                    f"the reference's {name} on the {axis} axis changed by {100 * step:+.1f} +- "
                    f"{200 * doubt:.1f} % between its mountings {k} and {k + 1}: its blades or the cell "
                    "have moved; the points in between are not reliable",
                    True,
                )


def find_outliers(
    name: str,
    channel: LoadChannel,
    points: SeriesReadings,
    plan: SeriesPlan,
    density: Array,
    speed: dict[str, Array],
) -> Iterator[SeriesIssue]:
    """Yield issues about points that deviate from the other points of the same mounting.

    The logarithm of a load over ``rho W^2`` changes slowly with the logarithm of the speed (Reynolds number). A point
    is an outlier if it deviates from the line through the others by 2.5 % and five standard uncertainties.
    """
    for k in sorted(set(points.mounting_index.tolist())):
        m = plan.mounting[k]
        at = np.flatnonzero((points.mounting_index == k) & (channel.value != 0))
        if at.size < 4 or (name == "torque" and m.axis == "pair"):
            continue
        w = speed[m.driven_rotors[0]][at]
        y, x = np.log(np.abs(channel.value[at]) / (density[at] * w**2)), np.log(w)
        u = np.sqrt(np.diag(channel.own_covariance)[at]) / np.abs(channel.value[at])
        off, std = np.empty(at.size), np.empty(at.size)
        for i in range(at.size):
            rest = np.arange(at.size) != i
            design = np.column_stack([np.ones(at.size), x - x.mean()])
            fit = np.linalg.lstsq(design[rest] / u[rest, None], y[rest] / u[rest], rcond=None)[0]
            cov = np.linalg.inv(design[rest].T @ (design[rest] / u[rest, None] ** 2))
            off[i] = y[i] - design[i] @ fit
            std[i] = math.sqrt(u[i] ** 2 + float(design[i] @ cov @ design[i]))
        # An outlier also shifts the line of the other points, so only the worst point is reported.
        i = int(np.argmax(np.abs(off) / std))
        if abs(off[i]) > MAX_OUTLIER_DEVIATION and abs(off[i]) > 5.0 * std[i]:
            yield SeriesIssue(
                "outlier",
                f"{name} of {m.describe_mounting()} at {points.nominal_rpm[at[i]]:g} rpm is {100 * off[i]:+.1f} +- "
                f"{200 * std[i]:.1f} % from the line through its other speeds: measure it again",
                False,
            )


MAX_OUTLIER_DEVIATION = 0.025
MAX_REFERENCE_CHANGE = 0.02
"""Relative change of the reference's loads between visits above which an issue is reported."""


def _find_known_reference_torque(
    points: SeriesReadings,
    plan: SeriesPlan,
    density: Array,
    speed: dict[str, Array],
    known: RotorMeasurements | None,
) -> Array:
    """Return the reference rotor's torque from another bench, scaled to this air and speed; NaN for other rotors."""
    out = np.full(len(points), np.nan)
    if known is None:
        return out
    order = np.argsort(known.speed_rad_s)
    c = known.torque_Nm[order] / (known.air.density_kg_m3 * known.speed_rad_s[order] ** 2)
    for i, k in enumerate(points.mounting_index):
        m = plan.mounting[k]
        if m.use == "reference":
            w = speed[m.axis][i]
            out[i] = np.interp(w, known.speed_rad_s[order], c) * density[i] * w**2
    return out


def _check_torque_split(split: TorqueSplit) -> list[SeriesIssue]:
    off = split.cell_mismatch_over_std[np.isfinite(split.cell_mismatch_over_std)]
    if off.size and float(np.median(np.abs(off))) > 3.0:
        return [
            SeriesIssue(
                "split",
                f"currents and torque cell differ for the pair by {np.median(np.abs(off)):.1f} standard "
                "uncertainties in the median: a motor has changed since it was calibrated",
                True,
            )
        ]
    return []


def _describe_torque_split(split: TorqueSplit) -> Iterator[str]:
    for side, fit in split.motor_fits.items():
        b, cov = fit.estimate_coefficients()
        yield (
            f"{side} motor: torque constant {1e3 * b[0]:.2f} +- {2e3 * math.sqrt(cov[0, 0]):.2f} mN m/A, friction "
            f"{1e3 * b[1]:.2f} +- {2e3 * math.sqrt(cov[1, 1]):.2f} mN m, from {fit.time_s.size} points alone"
        )


def _loads_by_axis(
    points: SeriesReadings,
    plan: SeriesPlan,
    facts: BenchFacts,
    loads: dict[str, LoadChannel],
    split: TorqueSplit | None,
    alone: Array,
    alone_relative: float,
) -> dict[str, LoadChannel]:
    """Return the thrust, and the torque about each rotor's shaft (axis), at all points; NaN if unknown."""
    n = len(points)
    axis = np.array([plan.mounting[k].axis for k in points.mounting_index])
    out = {"thrust": loads["thrust"]}
    blank = loads["thrust"]
    for side in ("upper", "lower"):
        value, own, common = np.full(n, np.nan), np.zeros((n, n)), np.zeros((n, n))
        single = np.flatnonzero(axis == side)
        if (torque := loads.get("torque")) is not None:
            value[single] = facts.torque_signs[side] * torque.value[single]
            ix = np.ix_(single, single)
            own[ix], common[ix] = torque.own_covariance[ix], torque.common_covariance[ix]
        else:
            value[single] = alone[single]
            filled = np.nan_to_num(value)
            common = np.outer(filled, filled) * alone_relative**2
        if split is not None:
            turns = np.isin(split.point_index, np.flatnonzero((axis == "pair") | (axis == side)))
            where = split.point_index[turns]
            value[where] = split.torque_Nm[side][turns]
            common[np.ix_(where, where)] = split.covariance[side][np.ix_(turns, turns)]
        if np.isfinite(value).any():
            out[f"torque_{side}"] = LoadChannel(value, common, own, blank.zero_drift_model, None, np.zeros((0, 4)))
    return out


def _estimate_repeatability(
    channel: LoadChannel, points: SeriesReadings, plan: SeriesPlan, density: Array, speed: dict[str, Array]
) -> tuple[float, float]:
    """Return the relative repeatability tau (NaN without repeated mountings), and the posterior mean of its square."""
    scale = density * (speed["upper"] ** 2 + speed["lower"] ** 2)
    coefficient = channel.value / scale
    contrasts: list[tuple[Array, Array]] = []
    blades: dict[tuple[object, ...], dict[int, list[int]]] = {}
    for i, k in enumerate(points.mounting_index):
        m = plan.mounting[k]
        if m.use == "measure" and np.isfinite(channel.value[i]):
            blades.setdefault(setting_key(m, 0.0), {}).setdefault(int(k), []).append(i)
    for mountings in blades.values():
        rows = list(mountings.values())
        shared = set.intersection(*({round(float(points.nominal_rpm[i])) for i in r} for r in rows))
        rows = [[i for i in r if round(float(points.nominal_rpm[i])) in shared] for r in rows]
        if len(rows) < 2 or not shared:
            continue
        mean = {
            s: np.mean([coefficient[i] for r in rows for i in r if round(float(points.nominal_rpm[i])) == s])
            for s in shared
        }
        off = np.array([np.mean([coefficient[i] / mean[round(float(points.nominal_rpm[i]))] for i in r]) for r in rows])
        all_of = [i for r in rows for i in r]
        relative = channel.total_covariance[np.ix_(all_of, all_of)] / np.outer(
            channel.value[all_of], channel.value[all_of]
        )
        average = np.zeros((len(rows), len(all_of)))
        at = 0
        for j, r in enumerate(rows):
            average[j, at : at + len(r)] = 1.0 / len(r)
            at += len(r)
        # Differences of the mountings from their mean, in an orthonormal basis.
        basis = np.linalg.svd(np.eye(len(rows)) - 1.0 / len(rows))[0][:, : len(rows) - 1].T
        contrasts.append((basis @ off, basis @ average @ relative @ average.T @ basis.T))
    if not contrasts:
        return math.nan, 0.0
    taus = np.concatenate(([0.0], np.geomspace(3e-4, 0.08, 24)))
    # Prior: uniform in ln tau up to the observed difference of mountings, decreasing beyond.
    typical = math.sqrt(float(np.mean(np.concatenate([off**2 for off, _ in contrasts]))))
    log = -np.log1p((taus / max(typical, 1e-4)) ** 2)
    for off, cov in contrasts:
        for i, tau in enumerate(taus):
            log[i] += stats.multivariate_normal.logpdf(off, cov=cov + (tau**2 + 1e-14) * np.eye(off.size))
    weight = np.exp(log - log.max())
    square = float(weight @ taus**2 / weight.sum())
    return math.sqrt(square), square


@dataclass(frozen=True, eq=False)
class _SettingAverager:
    """Data of a series, from which :meth:`average_setting` computes mean loads of each point and each setting."""

    points: SeriesReadings
    plan: SeriesPlan
    air_density_kg_m3: Array
    axis_speeds: dict[str, Array]
    channels: dict[str, LoadChannel]
    repeatability: dict[str, tuple[float, float]]
    start_time_s: float

    def is_of_measured_rotor(self, at: list[int]) -> bool:
        """Return whether the points with indices ``at`` are those of a measured rotor, not of the reference."""
        return self.plan.mounting[self.points.mounting_index[at[0]]].use == "measure"

    def average_setting(self, at: list[int], *, mounted: bool) -> SettingResult:
        """Return the mean loads over the points ``at`` of a setting, with 95 % intervals.

        With ``mounted``, the intervals exclude the scatter between mountings.
        """
        m = self.plan.mounting[self.points.mounting_index[at[0]]]
        mean = {a: float(np.mean(self.axis_speeds[a][at])) for a in ("upper", "lower")}
        rho = float(np.mean(self.air_density_kg_m3[at]))
        made = {q: self._average_load(q, at, mean, rho, mounted) for q in LOAD_NAMES}
        for side in ("upper", "lower"):
            if side not in m.driven_rotors:
                made[f"torque_{side}"] = None
        thrust = made["thrust"]
        assert thrust is not None
        truths = [self.points.record_entries[i].get("truth", {}) for i in at]
        electric = {
            q: {
                a: v
                for a in m.driven_rotors
                if np.isfinite(v := float(np.mean(self.points.channel_means(f"{q}_{a}")[at])))
            }
            for q in ("voltage", "current")
        }
        return SettingResult(
            m.axis, m.rotor, m.lower_rotor, m.pitch_deg, m.lower_pitch_deg, float(to_rpm([mean["upper"]])[0]),
            float(to_rpm([mean["lower"]])[0]), rho, len(set(self.points.mounting_index[at].tolist())), thrust,
            made["torque_upper"], made["torque_lower"], electric["voltage"], electric["current"],
            float(np.mean(self.points.time_s[at])) - self.start_time_s, m.use, float(self.points.nominal_rpm[at[0]]),
            {k: float(np.mean([t[k] for t in truths])) for k in truths[0]},
        )  # fmt: skip

    def _average_load(
        self, name: str, at: list[int], mean: dict[str, float], rho: float, mounted: bool
    ) -> LoadInterval | None:
        channel = self.channels.get(name)
        if channel is None or not np.all(np.isfinite(channel.value[at])):
            return None
        size = np.array([self.axis_speeds["upper"][i] ** 2 + self.axis_speeds["lower"][i] ** 2 for i in at])
        scale = rho * (mean["upper"] ** 2 + mean["lower"] ** 2) / (self.air_density_kg_m3[at] * size)
        x = channel.value[at] * scale
        ix = np.ix_(at, at)
        cov = channel.total_covariance[ix] * np.outer(scale, scale)
        n = len(at)
        value, variance = float(x.mean()), float(cov.mean())
        own = float(np.trace(channel.own_covariance[ix])) / n**2
        tau2 = self.repeatability[name][1]
        if not mounted:
            variance += tau2 * value**2 / len(set(self.points.mounting_index[at].tolist()))
        dof = _CALIBRATION_DOF * n * (variance / own) ** 2 if own > 0 else np.inf
        return LoadInterval(value, math.sqrt(variance), float(stats.t.ppf(0.975, max(dof, 1.0))) * math.sqrt(variance))
