"""What a series says: loads with intervals, point by point and setting by setting, and whether to believe it.

Points carry the uncertainty of the rotor as it was mounted. A setting (blades, pitch, speed) is the mean over its
mountings, at the mean of their speeds and densities; with mountings j of m points,

    u^2 = (tau^2 x^2 + D - O) / m + O,      D, O: mean variance of a point, mean covariance of two

where tau, how well mountings repeat, is found from all settings that were mounted more than once (averaged over its
likelihood on a grid, as in :mod:`mufly.bench.series.walk`). Expanded uncertainties are at 95 %: Student's t with the
effective degrees of freedom of the readings (GUM G.4.1).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mufly.bench.rig.devices import Facts
from mufly.bench.series.plan import Plan
from mufly.bench.series.readings import (
    Channel,
    Readings,
    air_of,
    loads_of,
    readings_of,
    rpm,
    setting_of,
    speed_of,
)  # fmt: skip
from mufly.bench.series.record import Record, read_record
from mufly.bench.series.split import Split, split_torque
from mufly.bench.series.trust import Doubt, doubts_of
from mufly.errors import InputError
from mufly.results import result
from mufly.rotor import Measurements
from mufly.tables import validated

Array = NDArray[np.float64]

QUANTITIES = ("thrust", "torque_upper", "torque_lower")
_DOF = 15.0


@result(eq=False)
class Load:
    """A load with its interval.

    Attributes
    ----------
    value, std : float
        N or N m: value and combined standard uncertainty.
    expanded : float
        Half width of the 95 % interval.
    """

    value: float
    std: float
    expanded: float


@result(eq=False)
class Setting:
    """Blades at a pitch and a speed.

    Attributes
    ----------
    axis, rotor, lower_rotor : str
    pitch_deg, lower_pitch_deg : float
    speed_upper_rpm, speed_lower_rpm : float
        Means of what was measured.
    density_kg_m3 : float
    mountings : int
    thrust, torque_upper, torque_lower : Load or None
    voltage_V, current_A : dict of str to float
        By axis.
    time_s : float
        Since the start.
    use : str
        ``"measure"`` or ``"reference"``.
    nominal_rpm : float
        As planned.
    truth : dict of str to float
        Of a simulated bench.
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
    thrust: Load
    torque_upper: Load | None
    torque_lower: Load | None
    voltage_V: dict[str, float]
    current_A: dict[str, float]
    time_s: float
    use: str
    nominal_rpm: float
    truth: dict[str, float] = field(default_factory=dict)

    @property
    def torque(self) -> Load | None:
        """Of the rotor, where it is one."""
        return self.torque_lower if self.axis == "lower" else self.torque_upper


@result(eq=False, picture="mufly.bench.series.pictures:series_picture")
class Series:
    """A series, analysed.

    Attributes
    ----------
    name : str
    points, settings : tuple of Setting
        Each point by itself, as mounted; and the means over mountings.
    doubts : tuple of Doubt
    notes : tuple of str
        What was corrected, and by how much.
    repeat : dict of str to float
        tau of each load, relative; NaN where nothing was mounted twice.
    density_relative_std : float
    """

    name: str
    points: tuple[Setting, ...]
    settings: tuple[Setting, ...]
    doubts: tuple[Doubt, ...]
    notes: tuple[str, ...]
    repeat: dict[str, float]
    density_relative_std: float

    @property
    def refused(self) -> tuple[Doubt, ...]:
        """Reasons for which the series is not to be trusted."""
        return tuple(d for d in self.doubts if d.fatal)


def analyse(
    record: Record | str | Path, *, known: Measurements | None = None, known_relative_std: float = 0.01,
    accept: Sequence[str] = (),
) -> Series:  # fmt: skip
    """Analyse a series.

    Parameters
    ----------
    record : Record, str or Path
        Or the folder that holds it.
    known : Measurements, optional
        Torque of the reference rotor, for a bench without a torque cell.
    known_relative_std : float
        Its relative standard uncertainty.
    accept : sequence of str
        Kinds of doubts (:mod:`mufly.bench.series.trust`) that are not to refuse the series. ``"saturated"`` leaves
        those points out.

    Raises
    ------
    InputError
        If there is no record, or it holds too little to say anything.
    """
    rec = record if isinstance(record, Record) else read_record(record)
    if not rec.lines:
        raise InputError("record", "", "is empty", "run the series first")
    plan = validated(Plan, _plan_tables(rec), "record")
    facts = Facts.of(rec.head["facts"])
    start = float(rec.head["time"])
    everything, zeros = readings_of(rec, "point"), readings_of(rec, "tare")
    doubts = list(doubts_of(plan, facts, rec, everything, zeros))
    good = everything.at_speed & everything.settled & ~everything.saturated & (everything.wild < 0.02)
    points = everything.where(good)
    if not len(points):
        raise InputError(
            "record", "", "holds no point that can be used", doubts[0].text if doubts else "measure again"
        )
    zeros = zeros.where(~zeros.saturated & (zeros.wild < 0.02))
    density, relative, words = air_of(points, facts)
    speed = speed_of(points, plan)
    loads = loads_of(points, zeros, plan, facts, density, speed, start)
    notes = [words, *_drift_words(loads, points)]
    for name, channel in loads.items():
        doubts += doubts_of_reference(name, channel, plan)
        doubts += outliers(name, channel, points, plan, density, speed)
        if name == "thrust" and np.mean(channel.value < 0) > 0.5:
            doubts.append(
                Doubt("polarity", "thrust is below zero: the force cell's sign is the wrong way round", True)
            )
    torque = loads.get("torque")
    alone = _known_torque(points, plan, density, speed, known)
    told = split_torque(points, plan, facts, speed, torque, alone, known_relative_std, start)
    split = None if isinstance(told, str) else told
    if isinstance(told, str) and told:
        doubts.append(Doubt("split", told, False))
    if split is not None:
        doubts += _split_doubts(split)
        notes += _split_words(split)
    channels = _by_axis(points, plan, facts, loads, split, alone, known_relative_std)
    repeat = {q: _repeatability(c, points, plan, density, speed) for q, c in channels.items()}
    for kind in accept:
        doubts = [Doubt(d.kind, d.text, d.fatal and d.kind != kind) for d in doubts]
    one = [[i] for i in range(len(points))]
    groups: dict[tuple[object, ...], list[int]] = {}
    for i, k in enumerate(points.mounting):
        groups.setdefault(setting_of(plan.mounting[k], float(points.nominal_rpm[i])), []).append(i)
    made = _Maker(points, plan, density, speed, channels, repeat, start)
    return Series(
        plan.name, tuple(made.setting(g, mounted=True) for g in one),
        tuple(sorted((made.setting(g, mounted=False) for g in groups.values() if made.is_measured(g)), key=_order)),
        tuple(doubts), tuple(notes), {q: t for q, (t, _) in repeat.items()}, relative,
    )  # fmt: skip


def _order(s: Setting) -> tuple[object, ...]:
    """Settings stand by blades, pitch and speed, whatever the order of measurement was."""
    return s.use, s.rotor, s.axis, s.pitch_deg, s.lower_pitch_deg, s.speed_upper_rpm + s.speed_lower_rpm


def _plan_tables(record: Record) -> dict[str, object]:
    import tomllib

    return tomllib.loads(record.head["plan"])


def _drift_words(loads: dict[str, Channel], points: Readings) -> list[str]:
    out = []
    span = max(float(np.ptp(points.time)), 1.0)
    for name, c in loads.items():
        zero, cov = c.zero.predict(points.time, np.ones((len(points), 1)))
        out.append(
            f"{name}: zero read {c.zero.time.size} times, went {np.ptp(zero):.3g} of the reading's unit in "
            f"{span / 60:.0f} min; followed to {math.sqrt(float(np.mean(np.diag(cov)))):.2g}"
        )
        if c.gain is None:
            out.append(
                f"{name}: the reference was not mounted twice, so that a drift of the gain is not seen"
            )
        else:
            gain, gcov = c.gain.drift(points.time)
            out.append(
                f"{name}: gain drifts by {100 * (gain[-1]):+.2f} % to the end, corrected to "
                f"{100 * math.sqrt(float(np.mean(np.diag(gcov)))):.2f} % by {len(c.visits)} visits of the reference"
            )
    return out


def doubts_of_reference(name: str, channel: Channel, plan: Plan) -> list[Doubt]:
    """Return whether the reference rotor stayed what it was between its visits (per axis)."""
    out: list[Doubt] = []
    visits = channel.visits
    for axis in ("upper", "lower"):
        mine = [v for v in visits if plan.mounting[int(v[3])].axis == axis]
        for k, (a, b) in enumerate(itertools.pairwise(mine), 1):
            step, doubt = float(b[1] - a[1]), math.hypot(a[2], b[2])
            if abs(step) > REFERENCE_LIMIT and abs(step) > 4.0 * doubt:
                out.append(
                    Doubt(
                        "reference",
                        f"the reference's {name} on the {axis} axis went by {100 * step:+.1f} +- "
                        f"{200 * doubt:.1f} % between its mountings {k} and {k + 1}: its blades have moved, or the "
                        "cell has; no point in between can be trusted",
                        True,
                    )
                )
    return out


def outliers(
    name: str, channel: Channel, points: Readings, plan: Plan, density: Array, speed: dict[str, Array]
) -> list[Doubt]:
    """Return points that do not lie with the others of their mounting.

    The logarithm of a load over ``rho W^2`` changes slowly with that of the speed (Reynolds number): each point is set
    beside the straight line through the others, and stands out if it is off by 2.5 % and five standard uncertainties.
    """
    out: list[Doubt] = []
    for k in sorted(set(points.mounting.tolist())):
        m = plan.mounting[k]
        at = np.flatnonzero((points.mounting == k) & (channel.value != 0))
        if at.size < 4 or (name == "torque" and m.axis == "pair"):
            continue
        w = speed[m.axes[0]][at]
        y, x = np.log(np.abs(channel.value[at]) / (density[at] * w**2)), np.log(w)
        u = np.sqrt(np.diag(channel.own)[at]) / np.abs(channel.value[at])
        off, std = np.empty(at.size), np.empty(at.size)
        for i in range(at.size):
            rest = np.arange(at.size) != i
            design = np.column_stack([np.ones(at.size), x - x.mean()])
            fit = np.linalg.lstsq(design[rest] / u[rest, None], y[rest] / u[rest], rcond=None)[0]
            cov = np.linalg.inv(design[rest].T @ (design[rest] / u[rest, None] ** 2))
            off[i] = y[i] - design[i] @ fit
            std[i] = math.sqrt(u[i] ** 2 + float(design[i] @ cov @ design[i]))
        # One point that is off pulls the line from under the others: only the worst is told.
        i = int(np.argmax(np.abs(off) / std))
        if abs(off[i]) > OUTLIER_LIMIT and abs(off[i]) > 5.0 * std[i]:
            out.append(
                Doubt(
                    "outlier",
                    f"{name} of {m.in_words()} at {points.nominal_rpm[at[i]]:g} rpm is {100 * off[i]:+.1f} +- "
                    f"{200 * std[i]:.1f} % off the line of its other speeds: measure it again",
                    False,
                )
            )
    return out


OUTLIER_LIMIT = 0.025
REFERENCE_LIMIT = 0.02
"""Change of the reference's loads from one visit to the next beyond which it is not the same reference."""


def _known_torque(
    points: Readings, plan: Plan, density: Array, speed: dict[str, Array], known: Measurements | None
) -> Array:
    """Torque of the reference where it is known from another bench, in this one's air; NaN elsewhere."""
    out = np.full(len(points), np.nan)
    if known is None:
        return out
    order = np.argsort(known.speed_rad_s)
    c = known.torque_Nm[order] / (known.air.density_kg_m3 * known.speed_rad_s[order] ** 2)
    for i, k in enumerate(points.mounting):
        m = plan.mounting[k]
        if m.use == "reference":
            w = speed[m.axis][i]
            out[i] = np.interp(w, known.speed_rad_s[order], c) * density[i] * w**2
    return out


def _split_doubts(split: Split) -> list[Doubt]:
    off = split.mismatch[np.isfinite(split.mismatch)]
    if off.size and float(np.median(np.abs(off))) > 3.0:
        return [
            Doubt(
                "split",
                f"currents and torque cell disagree about the pair by {np.median(np.abs(off)):.1f} standard "
                "uncertainties in the median: a motor has changed since it was calibrated",
                True,
            )
        ]
    return []


def _split_words(split: Split) -> list[str]:
    out = []
    for side, fit in split.fits.items():
        b, cov = fit.coefficients()
        out.append(
            f"{side} motor: torque constant {1e3 * b[0]:.2f} +- {2e3 * math.sqrt(cov[0, 0]):.2f} mN m/A, friction "
            f"{1e3 * b[1]:.2f} +- {2e3 * math.sqrt(cov[1, 1]):.2f} mN m, from {fit.time.size} points alone"
        )
    return out


def _by_axis(
    points: Readings, plan: Plan, facts: Facts, loads: dict[str, Channel], split: Split | None, alone: Array,
    alone_relative: float,
) -> dict[str, Channel]:  # fmt: skip
    """Thrust, and torque of each axis, at all points; NaN where it is not known."""
    n = len(points)
    axis = np.array([plan.mounting[k].axis for k in points.mounting])
    out = {"thrust": loads["thrust"]}
    blank = loads["thrust"]
    for side in ("upper", "lower"):
        value, own, common = np.full(n, np.nan), np.zeros((n, n)), np.zeros((n, n))
        single = np.flatnonzero(axis == side)
        if (torque := loads.get("torque")) is not None:
            value[single] = facts.torque_signs[side] * torque.value[single]
            ix = np.ix_(single, single)
            own[ix], common[ix] = torque.own[ix], torque.common[ix]
        else:
            value[single] = alone[single]
            filled = np.nan_to_num(value)
            common = np.outer(filled, filled) * alone_relative**2
        if split is not None:
            turns = np.isin(split.where, np.flatnonzero((axis == "pair") | (axis == side)))
            where = split.where[turns]
            value[where] = split.value[side][turns]
            common[np.ix_(where, where)] = split.covariance[side][np.ix_(turns, turns)]
        if np.isfinite(value).any():
            out[f"torque_{side}"] = Channel(value, common, own, blank.zero, None, np.zeros((0, 4)))
    return out


def _repeatability(
    channel: Channel, points: Readings, plan: Plan, density: Array, speed: dict[str, Array]
) -> tuple[float, float]:
    """Return tau, relative (NaN where nothing was mounted twice), and the mean of its square over its likelihood."""
    scale = density * (speed["upper"] ** 2 + speed["lower"] ** 2)
    coefficient = channel.value / scale
    contrasts: list[tuple[Array, Array]] = []
    blades: dict[tuple[object, ...], dict[int, list[int]]] = {}
    for i, k in enumerate(points.mounting):
        m = plan.mounting[k]
        if m.use == "measure" and np.isfinite(channel.value[i]):
            blades.setdefault(setting_of(m, 0.0), {}).setdefault(int(k), []).append(i)
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
        off = np.array(
            [np.mean([coefficient[i] / mean[round(float(points.nominal_rpm[i]))] for i in r]) for r in rows]
        )
        all_of = [i for r in rows for i in r]
        relative = channel.covariance[np.ix_(all_of, all_of)] / np.outer(
            channel.value[all_of], channel.value[all_of]
        )
        average = np.zeros((len(rows), len(all_of)))
        at = 0
        for j, r in enumerate(rows):
            average[j, at : at + len(r)] = 1.0 / len(r)
            at += len(r)
        # Differences from the mean of the mountings, in an orthonormal basis of them.
        basis = np.linalg.svd(np.eye(len(rows)) - 1.0 / len(rows))[0][:, : len(rows) - 1].T
        contrasts.append((basis @ off, basis @ average @ relative @ average.T @ basis.T))
    if not contrasts:
        return math.nan, 0.0
    taus = np.concatenate(([0.0], np.geomspace(3e-4, 0.08, 24)))
    # Before the data: even in its logarithm up to what the mountings differ by, and falling off beyond.
    typical = math.sqrt(float(np.mean(np.concatenate([off**2 for off, _ in contrasts]))))
    log = -np.log1p((taus / max(typical, 1e-4)) ** 2)
    for off, cov in contrasts:
        for i, tau in enumerate(taus):
            log[i] += stats.multivariate_normal.logpdf(off, cov=cov + (tau**2 + 1e-14) * np.eye(off.size))
    weight = np.exp(log - log.max())
    square = float(weight @ taus**2 / weight.sum())
    return math.sqrt(square), square


@dataclass(frozen=True, eq=False)
class _Maker:
    """Makes points and settings of everything that was found."""

    points: Readings
    plan: Plan
    density: Array
    speed: dict[str, Array]
    channels: dict[str, Channel]
    repeat: dict[str, tuple[float, float]]
    start: float

    def is_measured(self, at: list[int]) -> bool:
        """Whether points are not the reference's."""
        return self.plan.mounting[self.points.mounting[at[0]]].use == "measure"

    def setting(self, at: list[int], *, mounted: bool) -> Setting:
        """Return the mean over some points of one setting."""
        m = self.plan.mounting[self.points.mounting[at[0]]]
        mean = {a: float(np.mean(self.speed[a][at])) for a in ("upper", "lower")}
        rho = float(np.mean(self.density[at]))
        made = {q: self._load(q, at, mean, rho, mounted) for q in QUANTITIES}
        for side in ("upper", "lower"):
            if side not in m.axes:
                made[f"torque_{side}"] = None
        thrust = made["thrust"]
        assert thrust is not None
        truths = [self.points.lines[i].get("truth", {}) for i in at]
        electric = {
            q: {a: v for a in m.axes if np.isfinite(v := float(np.mean(self.points.channel(f"{q}_{a}")[at])))}
            for q in ("voltage", "current")
        }
        return Setting(
            m.axis, m.rotor, m.lower_rotor, m.pitch_deg, m.lower_pitch_deg, float(rpm([mean["upper"]])[0]),
            float(rpm([mean["lower"]])[0]), rho, len(set(self.points.mounting[at].tolist())), thrust,
            made["torque_upper"], made["torque_lower"], electric["voltage"], electric["current"],
            float(np.mean(self.points.time[at])) - self.start, m.use, float(self.points.nominal_rpm[at[0]]),
            {k: float(np.mean([t[k] for t in truths])) for k in truths[0]},
        )  # fmt: skip

    def _load(
        self, name: str, at: list[int], mean: dict[str, float], rho: float, mounted: bool
    ) -> Load | None:
        channel = self.channels.get(name)
        if channel is None or not np.all(np.isfinite(channel.value[at])):
            return None
        size = np.array([self.speed["upper"][i] ** 2 + self.speed["lower"][i] ** 2 for i in at])
        scale = rho * (mean["upper"] ** 2 + mean["lower"] ** 2) / (self.density[at] * size)
        x = channel.value[at] * scale
        ix = np.ix_(at, at)
        cov = channel.covariance[ix] * np.outer(scale, scale)
        n = len(at)
        value, variance = float(x.mean()), float(cov.mean())
        own = float(np.trace(channel.own[ix])) / n**2
        tau2 = self.repeat[name][1]
        if not mounted:
            variance += tau2 * value**2 / len(set(self.points.mounting[at].tolist()))
        dof = _DOF * n * (variance / own) ** 2 if own > 0 else np.inf
        return Load(
            value, math.sqrt(variance), float(stats.t.ppf(0.975, max(dof, 1.0))) * math.sqrt(variance)
        )
