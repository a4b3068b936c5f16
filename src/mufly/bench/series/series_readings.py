"""Loads of a series with covariance, from its record: correction of zeros, calibration and gains.

Measurement model (docs/explanation/bench.md, "Model of a series"): cell k reads at time t

    y_k = z_k(t) + sum_l S_kl G_l(t) F_l + e_k,      z_k = b_k + W_k(t),     G_l = exp(g_l(t))

Zeros z are read at rest and modelled as a random walk (:mod:`mufly.bench.series.random_walk_drift`); S comes from the
calibration of the cells. The gain drift g follows from visits v of the reference rotor, each with the same speeds s,

    ln(F_vs / (rho_vs W_vs^2)) = beta_s + g(t_v) + error,      g(t_0) = 0,

where t_0 is the start of the series, at which the calibration is valid. To first order

    cov F_ij = sum_k (S^-1)_jk^2 (delta u_k^2 + cov z_k) + J cov(S) J' + linearity + F_i F_j cov(g_i, g_j).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.bench.rig.bench_devices import BenchFacts
from mufly.bench.series.moist_air import compute_moist_air_density, compute_relative_density_std
from mufly.bench.series.random_walk_drift import RandomWalkDrift, fit_random_walk
from mufly.bench.series.series_plan import BladeMounting, SeriesPlan
from mufly.bench.series.series_record import SeriesRecord, parse_block_mean
from mufly.errors import InputError
from mufly.quantities.units import RPM

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

CELL_LOADS = ("thrust", "torque")


@dataclass(frozen=True, eq=False)
class SeriesReadings:
    """Readings of one kind (zeros or points) of a series, in the order of time.

    Attributes
    ----------
    mounting_index : (n,) array of int
        Mounting in the plan, from 0.
    step_in_mounting : (n,) array of int
        Step within the mounting, from 0.
    time_s : (n,) array
        Middle of the averaging (s).
    nominal_rpm : (n,) array
        Planned speed (rpm).
    mean, std, dof : dict of str to (n,) array
        Block mean, its standard uncertainty and degrees of freedom by channel; NaN without a reading.
    settled, at_speed, saturated : (n,) arrays of bool
        Whether the readings were steady, the speed was reached, and a channel was saturated.
    spike_share : (n,) array
        Largest share of outliers among the samples of the cells.
    record_entries : list of dict
        Entries of the record.
    """

    mounting_index: Integers
    step_in_mounting: Integers
    time_s: Array
    nominal_rpm: Array
    mean: dict[str, Array]
    std: dict[str, Array]
    dof: dict[str, Array]
    settled: NDArray[np.bool_]
    at_speed: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    spike_share: Array
    record_entries: list[dict[str, Any]]

    def __len__(self) -> int:
        return int(self.time_s.size)

    def channel_means(self, name: str) -> Array:
        """Return the means of a channel (n,); NaN if the bench lacks the channel."""
        return self.mean.get(name, np.full(len(self), np.nan))

    def select_readings(self, keep: NDArray[np.bool_]) -> SeriesReadings:
        """Return the readings selected by ``keep`` (n,)."""
        k = np.flatnonzero(keep)

        def select_channels(d: dict[str, Array]) -> dict[str, Array]:
            return {n: v[k] for n, v in d.items()}

        return SeriesReadings(
            self.mounting_index[k],
            self.step_in_mounting[k],
            self.time_s[k],
            self.nominal_rpm[k],
            select_channels(self.mean),
            select_channels(self.std),
            select_channels(self.dof),
            self.settled[k],
            self.at_speed[k],
            self.saturated[k],
            self.spike_share[k],
            [self.record_entries[i] for i in k],
        )


def extract_record_readings(record: SeriesRecord, what: str) -> SeriesReadings:
    """Return the zero readings (``"tare"``) or measured points (``"point"``) of a record.

    A repeated point replaces the earlier one.
    """
    last: dict[tuple[int, int, float], dict[str, Any]] = {}
    for x in record.readings:
        if x["what"] == what:
            # A zero repeated after an interruption counts as an additional zero.
            last[x["mounting"], x["step"], x["time"] if x["step"] < 0 else 0.0] = x
    lines = sorted(last.values(), key=lambda x: float(x["time"]))
    names = sorted({n for x in lines for n in x["channels"]})
    table = {n: [parse_block_mean(x["channels"][n]) if n in x["channels"] else None for x in lines] for n in names}

    def channel_column(n: str, field: str) -> Array:
        return np.array([np.nan if m is None else getattr(m, field) for m in table[n]], dtype=np.float64)

    def flag_column(key: str) -> NDArray[np.bool_]:
        return np.array([bool(x[key]) for x in lines], dtype=bool)

    wild = [
        max(
            (
                m.outlier_count / max(m.sample_count, 1)
                for n in names
                if n.startswith(CELL_LOADS) and (m := table[n][i])
            ),
            default=0.0,
        )
        for i in range(len(lines))
    ]
    return SeriesReadings(
        np.array([x["mounting"] for x in lines], dtype=np.int64),
        np.array([x["step"] for x in lines], dtype=np.int64),
        np.array([x["time"] for x in lines], dtype=np.float64),
        np.array([x["speed_rpm"] for x in lines], dtype=np.float64),
        {n: channel_column(n, "value") for n in names},
        {n: channel_column(n, "std") for n in names},
        {n: channel_column(n, "dof") for n in names},
        flag_column("settled"),
        flag_column("at_speed"),
        flag_column("saturated"),
        np.array(wild),
        lines,
    )


@dataclass(frozen=True, eq=False)
class LoadChannel:
    """Values of one load (a thrust or a torque) at the points of a series, with their covariance.

    Attributes
    ----------
    value : (n,) array
        Load (N or N m).
    common_covariance : (n, n) array
        Covariance from common errors: calibration, linearity, gain.
    own_covariance : (n, n) array
        Covariance from readings and zeros.
    zero_drift_model : RandomWalkDrift
        Zero drift of the cell of this load.
    gain_drift_model : RandomWalkDrift or None
        Drift of the logarithmic gain; None for fewer than two reference visits.
    reference_visits : (v, 4) array
        Time, logarithm of load over mean load, standard uncertainty and mounting of each reference visit.
    """

    value: Array
    common_covariance: Array
    own_covariance: Array
    zero_drift_model: RandomWalkDrift
    gain_drift_model: RandomWalkDrift | None
    reference_visits: Array

    @property
    def total_covariance(self) -> Array:
        """Total covariance of the values, (n, n)."""
        return self.common_covariance + self.own_covariance


def compute_air_density(points: SeriesReadings, facts: BenchFacts) -> tuple[Array, float, str]:
    """Return air density (n,) in kg/m3, one relative standard uncertainty for all points, and the source in words."""
    t, p, h = (points.channel_means(n) for n in ("temperature", "pressure", "humidity"))
    if np.all(np.isnan(p)) or np.all(np.isnan(t)):
        return np.full(len(points), 1.2), 0.03, "no sensors of the air: density 1.2 kg/m3 +- 3 % assumed"
    humid = np.where(np.isnan(h), 0.5, h)
    std_h = 0.25 if np.all(np.isnan(h)) else facts.humidity_std
    rho = compute_moist_air_density(p, t, np.clip(humid, 0.0, 1.0))
    relative = compute_relative_density_std(
        float(np.nanmean(p)), float(np.nanmean(t)), float(np.clip(np.mean(humid), 0, 1)),
        pressure_std_Pa=facts.pressure_std_Pa, temperature_std_K=facts.temperature_std_K, humidity_std=std_h,
    )  # fmt: skip
    return rho, relative, f"density {rho.mean():.4f} kg/m3 +- {100 * relative:.2f} % (CIPM-2007)"


def axis_speeds(points: SeriesReadings, plan: SeriesPlan) -> dict[str, Array]:
    """Return the speed (rad/s) of each axis at each point, 0 for an axis at rest."""
    out = {a: np.zeros(len(points)) for a in ("upper", "lower")}
    for i, k in enumerate(points.mounting_index):
        nominal = plan.mounting[k].speeds_rad_s(float(points.nominal_rpm[i]))
        for a in plan.mounting[k].driven_rotors:
            measured = points.channel_means(f"speed_{a}")[i]
            out[a][i] = nominal[a] if np.isnan(measured) else measured
    return out


def compute_cell_loads(
    points: SeriesReadings,
    zeros: SeriesReadings,
    plan: SeriesPlan,
    facts: BenchFacts,
    density: Array,
    speed: dict[str, Array],
    start: float,
) -> dict[str, LoadChannel]:
    """Return thrust and torque of all rotors together, as the load cells measure them at the points, by load name.

    Raises
    ------
    InputError
        If the bench has no force cell, or no zero was read.
    """
    cells = facts.cell_calibration()
    raw = cells is not None
    names = cells.channels if cells is not None else tuple(n for n in CELL_LOADS if n in points.mean)
    columns = [f"{n}_raw" if raw else n for n in names]
    if "thrust" not in names or any(c not in points.mean for c in columns):
        missing = next((c for c in columns if c not in points.mean), "thrust")
        raise InputError("record", missing, "has no readings", "name this column in the bench file")
    if not len(zeros):
        raise InputError(
            "record",
            "tare",
            "contains no zero reading (the load cells without load)",
            "complete the measurement of one mounting",
        )
    inverse = np.eye(len(names)) if cells is None else np.linalg.inv(cells.sensitivity)
    walks = [fit_random_walk(zeros.time_s, zeros.mean[c], zeros.std[c], start=start) for c in columns]
    n = len(points)
    above, doubt = np.empty((n, len(names))), []
    for k, (c, walk) in enumerate(zip(columns, walks, strict=True)):
        zero, cov = walk.predict_model_and_drift(points.time_s, np.ones((n, 1)))
        above[:, k] = points.mean[c] - zero
        # The variance of readings is inflated like the variance of zeros of the same cell.
        doubt.append(cov + np.diag(points.std[c] ** 2 * min(walk.mean_variance_inflation, 4.0)))
    loads = above @ inverse.T
    out: dict[str, LoadChannel] = {}
    for j, name in enumerate(names):
        own = np.sum([inverse[j, k] ** 2 * doubt[k] for k in range(len(names))], axis=0)
        common = np.zeros((n, n))
        if cells is not None:
            by = np.zeros((n, len(names), len(names) + 1))
            for k in range(len(names)):
                by[:, k, 1:] = -inverse[j, k] * loads
            flat = by.reshape(n, -1)
            common = flat @ cells.covariance @ flat.T
        value = loads[:, j]
        if facts.nonlinearity.get(name):
            full = facts.full_scale.get(name, float(np.abs(value).max()))
            # The linearity error of a cell is correlated for similar loads.
            apart = np.subtract.outer(value, value) / (0.2 * full)
            common = common + (facts.nonlinearity[name] * full) ** 2 / 3.0 * np.exp(-(apart**2))
        if name in CELL_LOADS:
            out[name] = _correct_gain_drift(
                LoadChannel(value, common, own, walks[j], None, np.zeros((0, 4))),
                name,
                points,
                plan,
                facts,
                density,
                speed,
                start,
            )
    return out


def _correct_gain_drift(
    channel: LoadChannel,
    name: str,
    points: SeriesReadings,
    plan: SeriesPlan,
    facts: BenchFacts,
    density: Array,
    speed: dict[str, Array],
    start: float,
) -> LoadChannel:
    """Correct a load for the gain drift that repeated runs of the reference rotor reveal."""
    visits = compute_reference_log_loads(channel, name, points, plan, facts, density, speed)
    if not visits.size:
        return channel
    time_s, log_ratio, sigma, mounting = visits.T
    axes = sorted({plan.mounting[int(k)].axis for k in mounting})
    design = np.array([[float(plan.mounting[int(k)].axis == a) for a in axes] for k in mounting])
    design = design[:, design.any(axis=0)]
    if len(visits) < design.shape[1] + 1:
        return LoadChannel(
            channel.value, channel.common_covariance, channel.own_covariance, channel.zero_drift_model, None, visits
        )
    walk = fit_random_walk(time_s, log_ratio, sigma, design, start)
    gain, cov = walk.predict_drift(points.time_s)
    value = channel.value * np.exp(-gain)
    scale = np.outer(np.exp(-gain), np.exp(-gain))
    common = scale * channel.common_covariance + np.outer(value, value) * cov
    return LoadChannel(value, common, scale * channel.own_covariance, channel.zero_drift_model, walk, visits)


def compute_reference_log_loads(
    channel: LoadChannel,
    name: str,
    points: SeriesReadings,
    plan: SeriesPlan,
    facts: BenchFacts,
    density: Array,
    speed: dict[str, Array],
) -> Array:
    """Return one row for every run of the reference rotor: time, ln(load / mean load), the standard uncertainty of this
    logarithm, and the index of the mounting.
    """
    load = np.full(len(points), np.nan)
    for i, k in enumerate(points.mounting_index):
        m = plan.mounting[k]
        if m.use == "reference":
            sign = facts.torque_signs[m.axis] if name == "torque" else 1.0
            load[i] = sign * channel.value[i] / (density[i] * speed[m.axis][i] ** 2)
    known = load > 0  # NaN compares as False
    key = [
        (plan.mounting[k].axis, round(float(r))) for k, r in zip(points.mounting_index, points.nominal_rpm, strict=True)
    ]
    log = np.full(len(points), np.nan)
    for one in set(key):
        at = np.flatnonzero([k == one and good for k, good in zip(key, known, strict=True)])
        if at.size >= 2:
            log[at] = np.log(load[at]) - np.mean(np.log(load[at]))
    rows = []
    for k in sorted(set(points.mounting_index[np.isfinite(log)].tolist())):
        at = np.flatnonzero((points.mounting_index == k) & np.isfinite(log))
        relative = channel.own_covariance[np.ix_(at, at)] / np.outer(channel.value[at], channel.value[at])
        # Weighted mean over speeds, because zero and noise matter more at low speeds. An added uncertainty of 1e-3
        # avoids negative weights of nearly equal errors.
        weight = np.linalg.solve(relative + 1e-6 * np.eye(at.size), np.ones(at.size))
        std = float(np.sqrt(1.0 / weight.sum()))
        rows.append((float(np.mean(points.time_s[at])), float(weight @ log[at] * std**2), std, k))
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def setting_key(m: BladeMounting, nominal_rpm: float) -> tuple[Any, ...]:
    """Return a key that is equal for all points with the same blades, pitch and speed."""
    return (
        m.axis,
        m.rotor,
        m.lower_rotor,
        m.pitch_deg,
        m.lower_pitch_deg,
        m.speed_ratio,
        round(nominal_rpm, 3),
    )


def to_rpm(speed: Sequence[float] | Array) -> Array:
    """Convert speeds (rad/s) to revolutions per minute."""
    return np.asarray(speed, dtype=np.float64) / RPM
