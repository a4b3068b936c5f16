"""Loads from bench readings: correction of zero, gain and cross-talk, with uncertainty.

With sensitivities S and zeros z(t) the loads of a line are ``F = S^-1 (y - z(t))``. An error of a calibration or of a
zero shifts many lines together and does not average out. Its effect is propagated by the derivatives

    dF/dS_kl = -S^-1[:, k] F_l,      dF/dz_k = -S^-1[:, k],      z_k = basis(t) a_k

and the covariance of all S, b and a. An uncalibrated channel in SI units has S = 1; its zero is still corrected if
there are readings at rest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from mufly.bench.bench_table import SI_UNITS, BenchTable, strip_rotor_and_raw_suffix
from mufly.bench.residual_covariance import CovarianceEstimate, estimate_parameter_covariance, join_covariances
from mufly.bench.series.moist_air import compute_moist_air_density
from mufly.bench.unit_conventions import (
    LOAD_QUANTITIES,
    add_loads_from_coefficients,
    mask_axial_flight_lines,
    mask_rest_and_lost_speed,
)
from mufly.errors import ArgumentError
from mufly.results import result
from mufly.rotor import (
    Air,
    Blading,
    OperatingCondition,
    RotorSystem,
    solve_rotor_batch,
    solve_system,
    warn_reynolds_range,
)

# ----------------------------------------------------------------------------
# Load cell calibration: gain, offset and cross-talk from known loads, with uncertainty.
#
# Sensor ``k`` reads, under the loads ``F_1 ... F_c`` (thrust, torque, ...),
#
#     y_k = b_k + sum_l S_kl F_l + error          so          F = S^-1 (y - b).
#
# Every row of ``[b S]`` is a linear least-squares fit over the lines of a calibration file, with its covariance from
# :mod:`mufly.bench.residual_covariance` (drift during the calibration widens it). The off-diagonal terms are the
# cross-talk; loads that the file does not name are assumed to have none. Known weights count as exact. Own derivation;
# textbook treatment of multi-component balances: Tropea, Yarin and Foss (eds.), Springer Handbook of Experimental Fluid
# Mechanics, 2007.
#
# Zero drift: readings at zero speed come in blocks (consecutive lines at rest). Over the time ``t`` of the
# measurement, or the line number without a time, a polynomial
#
#     zero(t) = a_0 + a_1 tau + ... + a_d tau^d,      tau = (t - middle) / half the span of the zeros
#
# is fitted to them. Its degree, at most one less than the number of blocks and at most 3, has the least AICc (Hurvich
# and Tsai, Biometrika 76, 1989) of the readings; the covariance of ``a`` is that of
# :mod:`mufly.bench.residual_covariance`, with a common error of the readings of one block. With a single block the zero
# is assumed constant, which a note reports.


Array = NDArray[np.float64]


@result(eq=False)
class CellCalibration:
    """Calibrated load cells: sensitivity matrix with its covariance.

    Attributes
    ----------
    channels : tuple of str
        Names of the loads: ``"thrust"``, ``"torque"``, ``"torque_upper"``, ...; reading k is ``<channel>_raw``.
    offset : (c,) array
        Readings without load.
    sensitivity : (c, c) array
        Reading (row) per load (column, N or N m).
    covariance : (c (c + 1), c (c + 1)) array
        Covariance of offsets and sensitivities: row by row ``b_k, S_k1 ... S_kc``.
    sensor_fit_covariances : tuple of CovarianceEstimate
        Covariance of the unweighted fit of every sensor; ``residual_std_ratio`` is the standard deviation of its
        readings.
    applied_load_range : (c, 2) array
        Smallest and largest calibration load of each channel (N or N m).
    source : str
    notes : tuple of str
    """

    channels: tuple[str, ...]
    offset: Array
    sensitivity: Array
    covariance: Array
    sensor_fit_covariances: tuple[CovarianceEstimate, ...]
    applied_load_range: Array
    source: str
    notes: tuple[str, ...]

    def readings_to_loads(self, readings: Array, zero: Array | None = None) -> Array:
        """Return loads (n, c) of readings (n, c).

        Parameters
        ----------
        readings : (n, c) array
            Readings of the cells, in their unit.
        zero : (n, c) or (c,) array, optional
            Readings without load at that time; by default the offsets of the calibration.
        """
        above = readings - (self.offset if zero is None else zero)
        return np.asarray(np.linalg.solve(self.sensitivity, above.T).T, dtype=np.float64)

    def channel_gains(self) -> tuple[Array, Array]:
        """Return the gain of each load channel (c,), N or N m per unit of its reading, and its standard deviation."""
        c = len(self.channels)
        inverse = np.linalg.inv(self.sensitivity)
        gain = np.diag(inverse)
        # d(S^-1) = -S^-1 dS S^-1
        jacobian = np.zeros((c, c, c + 1))
        for k in range(c):
            jacobian[k, :, 1:] = -np.outer(inverse[k], inverse[:, k])
        flat = jacobian.reshape(c, -1)
        return gain, np.sqrt(np.diag(flat @ self.covariance @ flat.T))

    def describe_calibration(self) -> list[str]:
        """Return lines that describe gains, offsets and cross-talk with 95 % intervals."""
        gain, gain_std = self.channel_gains()
        c = len(self.channels)
        std = np.sqrt(np.diag(self.covariance)).reshape(c, c + 1)
        lines = []
        for k, name in enumerate(self.channels):
            t, unit = self.sensor_fit_covariances[k].t_quantile_95, SI_UNITS[name.split("_")[0]]
            scatter = self.sensor_fit_covariances[k].residual_std_ratio
            lines.append(
                f"{name}: gain {gain[k]:.6g} +- {t * gain_std[k]:.2g} {unit} per unit of reading, reading without load "
                f"{self.offset[k]:.6g} +- {t * std[k, 0]:.2g}; readings scatter by {scatter:.2g}"
            )
            for j, other in enumerate(self.channels):
                s, doubt = self.sensitivity[k, j], t * std[k, 1 + j]
                if j != k and doubt > 0:
                    per = SI_UNITS[other.split("_")[0]]
                    seen = "is there" if abs(s) > doubt else "is within its error"
                    lines.append(f"  cross-talk of {other} on {name}: {s:.3g} +- {doubt:.2g} per {per}, {seen}")
        return lines + list(self.notes)


def fit_cell_calibration(table: BenchTable) -> CellCalibration:
    """Fit load cells to known loads.

    Parameters
    ----------
    table : BenchTable
        Pairs of columns ``<channel>`` (known load) and ``<channel>_raw`` (reading); optional ``time``, ``run``.

    Raises
    ------
    InputError
        If there is no such pair, a load was not varied, or the lines are too few.
    """
    channels = tuple(n for n in table.columns if not n.endswith("_raw") and f"{n}_raw" in table)
    if not channels:
        remedy = "give columns as thrust_N and thrust_raw_V"
        raise table.make_column_error("", "has no pair of known load and reading", remedy)
    table.require_columns([*channels, *(f"{n}_raw" for n in channels)])
    loads = np.column_stack([table[n] for n in channels])
    notes: list[str] = []
    for k, name in enumerate(channels):
        if np.ptp(loads[:, k]) == 0:
            raise table.make_column_error(name, "is the same in every line", "hang different known loads on the cell")
    a = np.column_stack([np.ones(len(table)), loads])
    n, p = a.shape
    if n < p + 2:
        raise table.make_column_error(
            "", f"{n} lines are too few to fit {p} coefficients per cell", f"give {p + 2} or more"
        )
    size = np.abs(loads).max(axis=0)
    if np.linalg.matrix_rank(a / np.r_[1.0, size], tol=1e-6) < p:
        problem = "vary together, so cross-talk and gain cannot be separated"
        raise table.make_column_error(" and ".join(channels), problem, "also load each cell alone")
    order = np.argsort(table["time"], kind="stable") if "time" in table else np.arange(n)
    a, run = a[order], (table["run"].astype(np.int64)[order] if "run" in table else None)
    group = np.unique(loads[order], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    rows, sensor_fit_covariances = [], []
    for name in channels:
        y = table[f"{name}_raw"][order]
        solution = np.linalg.lstsq(a, y, rcond=None)[0]
        s = estimate_parameter_covariance(a, y - a @ solution, run=run, group=group)
        if s.pattern != "white":
            notes.append(f"{name}: {s.describe_error_correlation()}")
        rows.append(solution)
        sensor_fit_covariances.append(s)
    b = np.array(rows)
    if abs(np.linalg.det(b[:, 1:] / np.abs(b[:, 1:]).max(axis=0))) < 1e-9:
        raise table.make_column_error("", "the readings cannot separate the loads", "check the columns")
    return CellCalibration(
        channels=channels,
        offset=b[:, 0],
        sensitivity=b[:, 1:],
        covariance=join_covariances(*(s.covariance for s in sensor_fit_covariances)),
        sensor_fit_covariances=tuple(sensor_fit_covariances),
        applied_load_range=np.column_stack([loads.min(axis=0), loads.max(axis=0)]),
        source=table.source,
        notes=tuple(notes),
    )


_MAX_DRIFT_DEGREE = 3


@result(eq=False)
class ZeroDrift:
    """Zero reading of one sensor (its reading without load) as a polynomial of time.

    Attributes
    ----------
    coefficients : (d + 1,) array
        a of the module docstring, in units of the reading.
    covariance_estimate : CovarianceEstimate
        Covariance of the coefficients; ``residual_std_ratio`` is the scatter of the zero readings.
    middle_time_s, half_span_s : float
        Middle and half span of the time of the zeros.
    rest_block_count : int
        Number of blocks at rest.
    total_change : float
        Zero at the end less zero at the beginning of the span.
    """

    coefficients: Array
    covariance_estimate: CovarianceEstimate
    middle_time_s: float
    half_span_s: float
    rest_block_count: int
    total_change: float

    def scaled_time_powers(self, time: Array) -> Array:
        """Return the powers of the scaled time tau that form the drift polynomial, (n, d + 1)."""
        return np.vander((time - self.middle_time_s) / self.half_span_s, self.coefficients.size, increasing=True)

    def zero_at(self, time: Array) -> Array:
        """Return the zero reading (n,) at times (n,)."""
        return self.scaled_time_powers(time) @ self.coefficients

    def zero_std_at(self, time: Array) -> Array:
        """Return the standard deviation (n,) of the zero reading at times (n,)."""
        b = self.scaled_time_powers(time)
        return np.sqrt(np.einsum("ij,jk,ik->i", b, self.covariance_estimate.covariance, b))


def fit_zero_drift(time: Array, reading: Array, at_rest: NDArray[np.bool_]) -> ZeroDrift | None:
    """Fit the zero drift of a sensor to its readings without load; return None if there are none.

    Parameters
    ----------
    time : (n,) array
        Time of all readings, in the order of measurement.
    reading : (n,) array
        Readings of the sensor, in its unit.
    at_rest : (n,) array of bool
        Whether a reading is without load.

    Returns
    -------
    ZeroDrift or None
        Fitted drift; None without a reading at rest.
    """
    if not at_rest.any():
        return None
    starts = np.diff(np.r_[False, at_rest].astype(int)) == 1
    block = np.cumsum(starts)[at_rest].astype(np.int64)
    t, y = time[at_rest], reading[at_rest]
    blocks = int(block.max())
    middle, half = 0.5 * (t.max() + t.min()), max(0.5 * float(np.ptp(t)), 1e-9)
    tau, n = (t - middle) / half, y.size
    chosen, least = 0, np.inf
    for degree in range(min(_MAX_DRIFT_DEGREE, blocks - 1, n - 3) + 1 if n > 3 else 1):
        a = np.vander(tau, degree + 1, increasing=True)
        rest = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
        k = degree + 2
        if n - k - 1 <= 0:
            break
        score = n * np.log(max(float(rest @ rest) / n, 1e-300)) + 2 * k + 2 * k * (k + 1) / (n - k - 1)
        if score < least:
            chosen, least = degree, score
    if n <= 3 and blocks >= 2:
        chosen = 1  # two blocks determine a straight line without residual
    a = np.vander(tau, chosen + 1, increasing=True)
    solution = np.asarray(np.linalg.lstsq(a, y, rcond=None)[0], dtype=np.float64)
    if n > chosen + 1:
        s = estimate_parameter_covariance(a, y - a @ solution, group=block)
    else:
        s = CovarianceEstimate(np.zeros((chosen + 1, chosen + 1)), 0.0, 1.0, "white", 0.0)
    ends = np.vander(np.array([-1.0, 1.0]), chosen + 1, increasing=True) @ solution
    return ZeroDrift(solution, s, float(middle), half, blocks, float(ends[1] - ends[0]))


@result(eq=False)
class BenchLoads:
    """Loads (thrust, torque) measured while the rotors turn, with their covariance.

    Attributes
    ----------
    turning_lines : BenchTable
        Lines with turning rotors.
    values : dict of str to (n,) array
        Loads by channel (N, N m): ``"thrust"``, ``"torque_upper"``, ...
    systematic_parameter_jacobian : dict of str to (n, s) array
        Derivatives of each load by the common parameters (calibration, zeros).
    systematic_parameter_covariance : (s, s) array
        Covariance of the common parameters.
    zero_drifts : dict of str to ZeroDrift
        Zero of each channel with readings at rest, in units of the reading.
    zeros : BenchTable
        Lines at rest.
    notes : tuple of str
    """

    turning_lines: BenchTable
    values: dict[str, Array]
    systematic_parameter_jacobian: dict[str, Array]
    systematic_parameter_covariance: Array
    zero_drifts: dict[str, ZeroDrift]
    zeros: BenchTable
    notes: tuple[str, ...]


def compute_loads(
    table: BenchTable,
    calibration: CellCalibration | None = None,
    *,
    radius_m: float | None = None,
    density_kg_m3: float | None = None,
) -> BenchLoads:
    """Return the loads with uncertainty, from the rows of a bench file in which rotors turn without axial flow.

    Parameters
    ----------
    table : BenchTable
        Table with ``thrust``, ``torque`` (with ``_upper``, ``_lower``) in SI units, or ``_raw`` with a calibration, and
        ``speed`` (``speed_upper``, ``speed_lower``), zero in the lines at rest; optional ``time``. Coefficients instead
        of loads need the radius (:mod:`mufly.bench.unit_conventions`).
    calibration : CellCalibration, optional
    radius_m, density_kg_m3 : float, optional
        Rotor radius, and air density (default: :func:`resolve_air_density`), for coefficients.

    Raises
    ------
    InputError
        If a raw channel has no calibration, a calibration has no raw channel, or a column has a wrong unit. Also if a
        coefficient has no radius, all lines are in axial flight, or a load has no speed.
    """
    table.reject_wrong_units(
        c for c in table.mismatched_units if strip_rotor_and_raw_suffix(c) in (*LOAD_QUANTITIES, "speed")
    )
    table = add_loads_from_coefficients(table, radius_m, resolve_air_density(table, density_kg_m3)[0])
    axial = mask_axial_flight_lines(table, radius_m)
    if axial.any():
        left = int(np.sum(~axial))
        if not left:
            raise table.make_column_error(
                "", "has no static line: all are in axial flight", "give lines at airspeed or J 0"
            )
        table = table.select_lines(~axial).with_columns(
            f"{int(axial.sum())} lines in axial flight are not used; {left} static lines remain"
        )
    speeds = [c for c in table.columns if c.split("_")[0] == "speed"]
    if not speeds:
        table.require_columns(("speed",))
    table.require_columns(speeds)
    raw = [
        c.removesuffix("_raw")
        for c in table.columns
        if c.endswith("_raw") and strip_rotor_and_raw_suffix(c) in LOAD_QUANTITIES
    ]
    known = calibration.channels if calibration is not None else ()
    for channel in raw:
        if channel not in known:
            remedy = f"give calibration=FILE, with {channel} and {channel}_raw in it"
            raise table.make_column_error(f"{channel}_raw", "is a reading without a calibration", remedy)
    for channel in known:
        if channel not in raw:
            remedy = f"name the reading {channel}_raw_V, or map it with columns={channel}_raw=COLUMN(V)"
            problem = "is not among the columns, but the calibration has it"
            raise table.make_column_error(f"{channel}_raw", problem, remedy)
    direct = [
        c
        for c in table.columns
        if strip_rotor_and_raw_suffix(c) in LOAD_QUANTITIES and not c.endswith("_raw") and c not in raw
    ]
    if not raw and not direct:
        table.require_columns(("thrust",))
    time = table["time"] if "time" in table else table.line_numbers.astype(np.float64)
    order = np.argsort(time, kind="stable")
    table, time = table.reorder_lines(order), time[order]
    at_rest, lost = mask_rest_and_lost_speed(table, speeds)
    turning, notes, drifts = ~at_rest & ~lost, list(table.notes), {}
    if lost.any():
        if not turning.any():
            remedy = "map another column of speed, columns=speed=COLUMN(rpm)"
            raise table.make_column_error(speeds[0], "is 0 in every line, although there are loads", remedy)
        notes.append(
            f"{int(lost.sum())} lines (first: {table.line_numbers[lost].min()}) have speed 0 under load or throttle "
            "and are not used: their speed reading failed"
        )
    for channel in (*known, *direct):
        column = f"{channel}_raw" if channel in raw else channel
        rest = at_rest & np.isfinite(table[column])
        drift = fit_zero_drift(time, table[column], rest)
        if drift is not None:
            drifts[channel] = drift
            notes.append(_describe_drift(table, channel, drift, time[turning], raw=channel in raw))
    if not drifts:
        notes.append("no reading at zero speed: the zero of the load cells is assumed to be correct")
    running, t = table.select_lines(turning), time[turning]
    values = {name: running[name] for name in direct}
    inverse, blocks = np.eye(len(direct)), []
    if calibration is not None:
        zero = [
            drifts[c].zero_at(t) if c in drifts else np.full(t.size, b)
            for c, b in zip(known, calibration.offset, strict=True)
        ]
        loads = calibration.readings_to_loads(
            np.column_stack([running[f"{c}_raw"] for c in known]), np.column_stack(zero)
        )
        values = dict(zip(known, loads.T, strict=True)) | values
        inverse = join_covariances(np.linalg.inv(calibration.sensitivity), inverse)
        blocks = [calibration.covariance]
    k, start = len(known), sum(len(b) for b in blocks)
    blocks += [drifts[c].covariance_estimate.covariance for c in values if c in drifts]
    systematic_parameter_covariance = join_covariances(*blocks) if blocks else np.zeros((0, 0))
    by = {name: np.zeros((t.size, len(systematic_parameter_covariance))) for name in values}
    for j, name in enumerate(known):
        part = by[name][:, :start].reshape(t.size, k, k + 1)
        for i, sensor in enumerate(known):
            part[:, i, 0] = 0.0 if sensor in drifts else -inverse[j, i]
            part[:, i, 1:] = -inverse[j, i] * loads
        by[name][:, :start] = part.reshape(t.size, start)
    for i, sensor in enumerate(values):
        if sensor in drifts:
            d = drifts[sensor]
            if sensor in direct:
                values[sensor] = values[sensor] - d.zero_at(t)
            for j, name in enumerate(values):
                by[name][:, start : start + d.coefficients.size] = -inverse[j, i] * d.scaled_time_powers(t)
            start += d.coefficients.size
    return BenchLoads(
        running, values, by, systematic_parameter_covariance, drifts, table.select_lines(at_rest), tuple(notes)
    )


def _describe_drift(table: BenchTable, channel: str, d: ZeroDrift, t: Array, *, raw: bool) -> str:
    unit = "units of the reading" if raw else SI_UNITS[channel.split("_")[0]]
    if d.rest_block_count == 1:
        return f"{channel}: zero read once, {d.coefficients[0]:.4g} {unit}; its drift is assumed to be zero"
    kind = ("constant", "a straight line", "a parabola", "a cubic")[d.coefficients.size - 1]
    known = d.covariance_estimate.residual_std_ratio > 0 and t.size
    doubt = f" +- {2 * float(np.max(d.zero_std_at(t))):.2g}" if known else ""
    change = f"changes by {d.total_change:.3g} {unit}"
    return f"{channel}: zero read {d.rest_block_count} times, followed as {kind}{doubt}, {change}"


def resolve_air_density(table: BenchTable, density_kg_m3: float | None) -> tuple[Array, str]:
    """Return the air density (n,) in kg/m3 and a description of its source.

    The order of sources is: the given number, a column ``density``, ``temperature`` and ``pressure``, and 1.2 kg/m3.
    With ``humidity`` the CIPM-2007 formula is used, else dry air, ``p / (287.05 T)`` (humid air is up to 1 % lighter).
    """
    n = len(table)
    if density_kg_m3 is not None:
        return np.full(n, density_kg_m3), f"density {density_kg_m3:g} kg/m3 as given"
    if "density" in table:
        table.require_columns(("density",))
        return table["density"], "density from the file"
    if "temperature" in table and "pressure" in table:
        table.require_columns(("temperature", "pressure"))
        if "humidity" in table:
            table.require_columns(("humidity",))
            moist = compute_moist_air_density(table["pressure"], table["temperature"] + 273.15, table["humidity"])
            return moist, f"density {moist.mean():.4g} kg/m3 from temperature, pressure and humidity"
        rho = table["pressure"] / (287.05 * (table["temperature"] + 273.15))
        return rho, f"density {rho.mean():.4g} kg/m3 from temperature and pressure (dry air)"
    return np.full(n, 1.2), "density 1.2 kg/m3 assumed: its relative error is that of every coefficient"


@result(eq=False)
class BenchPrediction:
    """Loads at the measured points, predicted by blade elements, with their relative errors.

    Attributes
    ----------
    speed_rad_s, load : dict of str to (n,) array
        Speed and predicted load (N or N m) by channel.
    relative_error : dict of str to (n,) array
        Relative error by channel: prediction over measurement, less one.
    """

    speed_rad_s: dict[str, Array]
    load: dict[str, Array]
    relative_error: dict[str, Array]

    def describe_errors(self) -> list[str]:
        """Return a line for each load, with the mean and the mean absolute error of its prediction."""
        return [
            f"{name}: prediction {100 * np.mean(e):+.1f} % from the measured on average, "
            f"{100 * np.mean(np.abs(e)):.1f} % in the mean of absolute errors ({e.size} points)"
            for name, e in self.relative_error.items()
        ]


def predict_loads(
    loads: BenchLoads, blading: Blading, *, density_kg_m3: float, pitch_rad: float | None = None,
    spacing_m: float | None = None, progress: Callable[[int, int], None] | None = None,
) -> BenchPrediction:  # fmt: skip
    """Predict the loads at the measured points by blade element momentum theory.

    Parameters
    ----------
    loads : BenchLoads
    blading : Blading
        Blading of the rotor, or of both rotors of a pair.
    density_kg_m3 : float
        Air density.
    pitch_rad : float, optional
        Pitch setting for a file without pitch; 0 by default, the blades as in the rotor file.
    spacing_m : float, optional
        Distance between the discs of a pair.
    progress : callable, optional
        Called with the number of points done and of all points.

    Raises
    ------
    InputError
        For a pair without a spacing.
    """
    table = loads.turning_lines
    air = Air(density_kg_m3=density_kg_m3)
    pitch = table["pitch"] if "pitch" in table else np.full(len(table), 0.0 if pitch_rad is None else pitch_rad)
    values: dict[str, Array] = {}
    speeds: dict[str, Array] = {}
    if "speed_upper" in table and "speed_lower" in table:
        if spacing_m is None:
            raise ArgumentError(
                "spacing_m", "", "is missing for a coaxial pair", "give the distance between the discs in m"
            )
        system = RotorSystem.from_coaxial_pair(blading, blading, spacing_m=spacing_m)
        up, dw = table["speed_upper"], table["speed_lower"]
        found = np.full((len(table), 4), np.nan)
        both = np.flatnonzero((up > 0) & (dw > 0))
        for done, k in enumerate(both):
            u, d = solve_system(system, OperatingCondition(float(pitch[k]), (up[k], dw[k]), air=air)).rotors
            found[k] = u.thrust_N, u.torque_Nm, d.thrust_N, d.torque_Nm
            if progress is not None:
                progress(done + 1, both.size)
        values = dict(zip(("thrust_upper", "torque_upper", "thrust_lower", "torque_lower"), found.T, strict=True))
        values["thrust"] = values["thrust_upper"] + values["thrust_lower"]
        speeds = {name: dw if name.endswith("lower") else up for name in values}
    else:
        table.require_columns(("speed",))
        speed = np.abs(table["speed"])
        warn_reynolds_range(blading, np.zeros(speed.size, dtype=np.int64), speed, air)
        out = solve_rotor_batch(blading, pitch_rad=pitch, speed_rad_s=speed, air=air)
        values = {"thrust": out.thrust_N, "torque": out.torque_Nm}
        speeds = dict.fromkeys(values, table["speed"])
    chosen = {
        name: np.isfinite(v) & np.isfinite(loads.values[name]) for name, v in values.items() if name in loads.values
    }
    return BenchPrediction(
        {name: np.abs(speeds[name][c]) for name, c in chosen.items()},
        {name: values[name][c] for name, c in chosen.items()},
        {name: values[name][c] / np.abs(loads.values[name][c]) - 1.0 for name, c in chosen.items()},
    )
