"""Thrust and torque coefficients of single and coaxial rotors from a bench.

    T = c_T rho pi R^4 W^2,      Q = c_Q rho pi R^5 W^2        (eq. 3.3 of the dissertation)

With ``q = rho pi R^4 W^2`` (torque: ``R^5``) each coefficient is a weighted linear least-squares fit ``load = c q``.
If a coaxial bench measures only the total thrust, both coefficients are fitted to ``T = c_up q_up + c_dw q_dw``.
The expected error of a load is the most likely mix of a share of the reading and a share of full scale. Its size
follows from the residuals, whose correlation widens the intervals (:mod:`mufly.bench.residual_covariance`). Errors
common to all readings do not average out and are added:

    cov(c) = cov_scatter + G C G' + c c' (var(rho) / rho^2 + k^2 var(R) / R^2),      G = dc/d(calibration, zeros),

with k = 4 for thrust and 5 for torque. The flight model assumes coefficients that are constant over speed;
:class:`CoefficientTrend` tests this. If a coefficient varies, the estimate is the best constant, and its variance
includes the mean square deviation of the coefficient over the measured speeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from mufly.bench import (
    BenchLoads,
    BenchPrediction,
    CellCalibration,
    CovarianceEstimate,
    estimate_parameter_covariance,
    resolve_air_density,
)
from mufly.bench.unit_conventions import (
    COEFFICIENT_SCALINGS,
    convert_speed_to_rad_s,
    guess_load_units,
    guess_speed_unit,
)
from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import (
    EstimateLookup,
    ParameterEstimate,
    compute_relative_covariance,
    describe_undetermined_combinations,
    select_error_model,
    tabulate_estimates,
)
from mufly.quantities.units import RPM
from mufly.results import ShownBlock, make_lines_block, result, select_fields
from mufly.vehicle import Vehicle

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SYMBOL_SUFFIX_BY_SIDE = {"upper": "_up", "lower": "_dw", "": ""}
COEFFICIENT_DEFINITIONS = {
    "thrust": ("cT", "thrust_coefficient", 4),
    "torque": ("cQ", "torque_coefficient", 5),
}
_CANDIDATE_ERROR_MODELS_PERCENT = (
    (1.0, 0.3),
    (1.0, 0.02),
    (1.0, 0.1),
    (1.0, 1.0),
    (0.0, 1.0),
)  # % of reading, % of full scale
_HOVER_THRUST_COEFFICIENT_RANGE = (0.0005, 0.06)  # range of thrust coefficients of hovering rotors
_PITCH_TOLERANCE_rad = math.radians(0.05)  # largest difference of equal blade pitch settings
_MAX_SPEED_SEQUENCE_CORRELATION = (
    0.8  # rank correlation of speed and order above which drift and trend are not separable
)
_SAME_SPEED_TOLERANCE = 0.02  # relative difference below which speeds count as equal
_AICC_TOLERANCE = 2.0  # difference of AICc below which two models fit equally well


@dataclass(frozen=True, eq=False)
class CoefficientTrend:
    """Trend of a rotor coefficient over speed, compared with a constant coefficient and an offset of the load cell.

    With ``x = ln(W / W_0)`` and ``W_0`` the weighted geometric mean of the speeds,

        load = q (p_0 + p_1 x + p_2 x^2)

    is linear in p. Its degree, up to 2, minimises AICc (Hurvich and Tsai, Biometrika 76, 1989). The coefficient is not
    constant if ``p_1, p_2`` differ from zero by Wald's test at 5 %. The Reynolds number is proportional to the speed,
    so ``p_1 / p_0`` is the exponent of the coefficient over Re. The alternative model ``load = c q + F_0`` describes a
    load cell with a zero offset; the preferred model is reported. If the speed increases or decreases throughout the
    measurement, sensor drift is not separable from a trend, which is reported as well.

    Attributes
    ----------
    channel, symbol : str
    reference_rad_s : float
        Reference speed W_0.
    coefficients : (d + 1,) array
        Polynomial coefficients p_0 ... p_d.
    covariance_estimate : CovarianceEstimate
        Covariance of the polynomial coefficients.
    is_significant : bool
        Whether the coefficient changes with speed by more than its error.
    offset, offset_std : float
        Offset F_0 of the alternative model and its standard deviation (N or N m).
    aicc_offset_minus_trend : float
        AICc of the alternative less that of the trend; positive if the trend fits better.
    range_rad_s : (float, float)
        Lowest and highest speed.
    speed_is_ordered : bool
        Whether speeds increase or decrease throughout the measurement.
    """

    channel: str
    symbol: str
    reference_rad_s: float
    coefficients: Array
    covariance_estimate: CovarianceEstimate
    is_significant: bool
    offset: float
    offset_std: float
    aicc_offset_minus_trend: float
    range_rad_s: tuple[float, float]
    speed_is_ordered: bool

    def _log_speed_powers(self, speed_rad_s: float | Array) -> Array:
        x = np.log(np.abs(np.asarray(speed_rad_s, dtype=np.float64)) / self.reference_rad_s)
        return np.stack([x**k for k in range(self.coefficients.size)], axis=-1)

    def coefficient_at(self, speed_rad_s: float | Array) -> Array:
        """Return the coefficient at speeds (rad/s)."""
        return np.asarray(self._log_speed_powers(speed_rad_s) @ self.coefficients)

    def coefficient_std_at(self, speed_rad_s: float | Array) -> Array:
        """Return the standard deviation of the coefficient at speeds (rad/s)."""
        b = self._log_speed_powers(speed_rad_s)
        return np.sqrt(np.einsum("...i,ij,...j->...", b, self.covariance_estimate.covariance, b))

    def relative_change(self) -> tuple[float, float]:
        """Return the relative change from lowest to highest speed, and half its 95 % confidence interval."""
        low, high = (self._log_speed_powers(w) for w in self.range_rad_s)
        start, end = float(low @ self.coefficients), float(high @ self.coefficients)
        slope = high / start - low * end / start**2
        return end / start - 1.0, self.covariance_estimate.t_quantile_95 * math.sqrt(
            float(slope @ self.covariance_estimate.covariance @ slope)
        )

    def describe_trend(self) -> str:
        """Describe whether the coefficient is constant within its error."""
        low, high = self.range_rad_s
        change, doubt = self.relative_change()
        over = f"{100 * change:+.1f} +- {100 * doubt:.1f} % from {low / RPM:.0f} to {high / RPM:.0f} rpm"
        if not self.is_significant:
            return f"{self.symbol} is constant within its error over a speed range of {high / low:.2g} : 1 ({over})"
        speeds = (low, math.sqrt(low * high), high)
        shape = ", ".join(f"{float(self.coefficient_at(w)):.5f} at {w / RPM:.0f} rpm" for w in speeds)
        text = f"{self.symbol} is not constant: {over} ({shape})"
        unit = "N" if self.channel.startswith("thrust") else "N m"
        offset = f"an offset of the load cell of {self.offset:.3g} +- {2 * self.offset_std:.2g} {unit}"
        if self.aicc_offset_minus_trend < -_AICC_TOLERANCE:
            text += f"; but {offset} explains more: read the zero of the load cell at rest"
        elif self.aicc_offset_minus_trend < _AICC_TOLERANCE:
            text += f"; {offset} explains it equally well: read the zero of the load cell at rest"
        else:
            text += "; a Reynolds trend explains more than an offset of the load cell"
        return text + (", and a drift during the measurement would look the same" if self.speed_is_ordered else "")


def fit_coefficient_trend(
    channel: str, symbol: str, speed: Array, unit: Array, load: Array, expected: Array,
    run: NDArray[np.int64] | None = None,
) -> CoefficientTrend:  # fmt: skip
    """Fit a coefficient as a function of speed, and alternatively as a constant with an offset of the load cell.

    Parameters
    ----------
    channel, symbol : str
        Names of the channel and the coefficient for messages.
    speed, unit, load, expected : (n,) array
        Speed (rad/s), q, load (N or N m), and its expected error up to a factor, for five or more points in the order
        of measurement.
    run : (n,) int array, optional
        Number of the run of each point.
    """
    n, speed, b = load.size, np.abs(speed), load / expected
    weight = (unit / expected) ** 2
    reference = float(np.exp(np.sum(weight * np.log(speed)) / np.sum(weight)))
    x = np.log(speed / reference)
    ordered = (
        bool(np.ptp(speed) > 0)
        and abs(float(stats.spearmanr(np.arange(n), speed).statistic)) > _MAX_SPEED_SEQUENCE_CORRELATION
    )
    # In an ordered measurement correlated errors and a trend over speed are not separable.
    runs = np.arange(n) if ordered else run
    bends = n >= 8 and np.unique(np.round(x / _SAME_SPEED_TOLERANCE)).size >= 4
    columns = [np.vander(x, d + 1, increasing=True) * (unit / expected)[:, None] for d in (1, 2)]
    scores = [_corrected_aic(a, b) for a in columns[: 1 + bends]]
    chosen = 2 if bends and scores[1] < scores[0] - _AICC_TOLERANCE else 1
    p, found = _weighted_least_squares(columns[chosen - 1], b, runs)
    tail = found.covariance[1:, 1:]
    wald = float(p[1:] @ np.linalg.solve(tail, p[1:])) / chosen if np.all(np.diag(tail) > 0) else 0.0
    offset = np.column_stack([unit, np.ones(n)]) / expected[:, None]
    both, rival = _weighted_least_squares(offset, b, runs)
    return CoefficientTrend(
        channel, symbol, reference, p, found, wald > float(stats.f.ppf(0.95, chosen, max(found.dof, 1.0))),
        float(both[1]), math.sqrt(rival.covariance[1, 1]), _corrected_aic(offset, b) - scores[chosen - 1],
        (float(speed.min()), float(speed.max())), ordered,
    )  # fmt: skip


def _weighted_least_squares(
    a: Array, b: Array, run: Integers | None, group: Integers | None = None
) -> tuple[Array, CovarianceEstimate]:
    """Return the least-squares solution of ``a x = b`` and its covariance.

    The covariance depends on the order of the rows, which is that of measurement.
    """
    x = np.asarray(np.linalg.lstsq(a, b, rcond=None)[0], dtype=np.float64)
    return x, estimate_parameter_covariance(a, b - a @ x, run=run, group=group)


def _corrected_aic(a: Array, b: Array) -> float:
    n, k = a.shape[0], a.shape[1] + 1
    rest = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
    return n * math.log(max(float(rest @ rest), 1e-300)) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 0.5)


@dataclass(frozen=True, eq=False)
class LoadCoefficientFit:
    """Fitted coefficients of one load (thrust or torque) of one or two rotors, with covariance and data.

    Attributes
    ----------
    channel : str
        ``"thrust"``, ``"torque_lower"``, ...
    symbols : tuple of str
        ``cT``, ``cQ_up``, ...
    value : (p,) array
        Coefficients (1).
    covariance : (p, p) array
        Covariance of the coefficients.
    systematic_variance_fraction : (p,) array
        Share of each variance caused by calibration, zeros, density and radius.
    speed_rad_s : (n, p) array
    load_per_coefficient : (n, p) array
        Factor q of the module docstring.
    load, expected_std : (n,) array
        Measured load (N, N m) and standard deviation of its scatter.
    covariance_estimate : CovarianceEstimate
    trends : tuple of CoefficientTrend
        One trend for a fit of one rotor; empty otherwise.
    """

    channel: str
    symbols: tuple[str, ...]
    value: Array
    covariance: Array
    systematic_variance_fraction: Array
    speed_rad_s: Array
    load_per_coefficient: Array
    load: Array
    expected_std: Array
    covariance_estimate: CovarianceEstimate
    trends: tuple[CoefficientTrend, ...]

    @property
    def residual(self) -> Array:
        """Measured less fitted load (N, N m), (n,)."""
        return self.load - self.load_per_coefficient @ self.value


@result(
    eq=False,
    json="source coaxial pitch_rad=stated_pitch_rad radius_m density_kg_m3=density_kg_m3.mean estimates "
    "trends=describe_trends undetermined notes",
)
class RotorCoefficientFit(EstimateLookup):
    """Coefficients of the rotors of one bench file at one blade pitch setting.

    Attributes
    ----------
    source : str
    coaxial : bool
    stated_pitch_rad : float
        Blade pitch; NaN if the file does not state it.
    radius_m : float
    density_kg_m3 : (n,) array
    estimates : tuple of ParameterEstimate
        Estimates in the order of the fits.
    fits : tuple of LoadCoefficientFit
    loads : BenchLoads
    undetermined, notes : tuple of str
        Undetermined combinations and unphysical coefficients; guesses and findings.
    """

    source: str
    coaxial: bool
    stated_pitch_rad: float
    radius_m: float
    density_kg_m3: Array
    estimates: tuple[ParameterEstimate, ...]
    fits: tuple[LoadCoefficientFit, ...]
    loads: BenchLoads
    undetermined: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    def describe_trends(self) -> list[str]:
        """Return descriptions of the coefficients' trends over speed."""
        return [t.describe_trend() for f in self.fits for t in f.trends]

    def systematic_variance_fractions(self) -> dict[str, float]:
        """Return the fraction of each coefficient's variance due to calibration, zero offsets, density and radius."""
        return {s: float(v) for f in self.fits for s, v in zip(f.symbols, f.systematic_variance_fraction, strict=True)}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return coefficients, their trends over speed and undetermined combinations as printed text."""
        kind = "coaxial pair" if self.coaxial else "single rotor"
        at = "" if math.isnan(self.stated_pitch_rad) else f" at {math.degrees(self.stated_pitch_rad):.3g} deg"
        shares = {name: f"{100 * share:.0f} %" for name, share in self.systematic_variance_fractions().items()}
        title = f"{self.source}: {kind}{at}, R {1e3 * self.radius_m:g} mm"
        return (
            tabulate_estimates(self.estimates, title, {"systematic": shares}),
            make_lines_block(*self.describe_trends()),
            make_lines_block(*self.undetermined, mark="not observable"),
        )


@result(eq=False)
class RotorIdentification:
    """Coefficients of the rotors of several bench files, beside predictions.

    Attributes
    ----------
    fits : tuple of RotorCoefficientFit
    cells : CellCalibration, optional
        Calibration of the load cells.
    predictions : dict of BenchPrediction
        Loads predicted by blade element theory, by file.
    """

    fits: tuple[RotorCoefficientFit, ...]
    cells: CellCalibration | None
    predictions: dict[str, BenchPrediction]

    def as_record(self) -> dict[str, Any]:
        """Return calibration, fits, interference and errors of the predictions."""
        predictions = {k: select_fields(p, "load error=relative_error") for k, p in self.predictions.items()}
        return {
            "calibration": None if self.cells is None else self.cells.describe_calibration(), "results": self.fits,
            "interference": describe_rotor_interference(self.fits), "prediction": predictions,
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return calibration, fits, notes, interference and errors of the predictions as printed text."""
        cells = self.cells
        calibration = () if cells is None else (
            f"load cells, from {cells.source}:", *(f"  {line}" for line in cells.describe_calibration()),
        )  # fmt: skip
        errors = [f"{source}: {line}" for source, p in self.predictions.items() for line in p.describe_errors()]
        return (
            make_lines_block(*calibration),
            *(block for fit in self.fits for block in fit.make_printed_blocks()),
            make_lines_block(*dict.fromkeys(note for fit in self.fits for note in fit.notes), mark="note"),
            make_lines_block(*describe_rotor_interference(self.fits), *errors),
        )


def make_coefficient_estimates(fit: LoadCoefficientFit, vehicle: Vehicle | None) -> list[ParameterEstimate]:
    """Return the fitted coefficients as parameter estimates, whose start values are those in the vehicle's file."""
    out = []
    for k, symbol in enumerate(fit.symbols):
        side = {"up": "upper", "dw": "lower"}.get(symbol.partition("_")[2], "")
        _, name, _ = COEFFICIENT_DEFINITIONS["thrust" if symbol.startswith("cT") else "torque"]
        key, std = f"rotors.{side}.{name}" if side else "", math.sqrt(fit.covariance[k, k])
        quantile = fit.covariance_estimate.t_quantile_95
        out.append(ParameterEstimate.from_std(symbol, key, "1", vehicle, float(fit.value[k]), std, quantile=quantile))
    return out


def assign_rotor_side(fit: RotorCoefficientFit, side: str, vehicle: Vehicle | None) -> RotorCoefficientFit:
    """Assign the fit of a single rotor to a vehicle's ``"upper"`` or ``"lower"`` rotor; a pair is unchanged."""
    if fit.coaxial:
        return fit
    end = SYMBOL_SUFFIX_BY_SIDE[side]
    fits = tuple(
        replace(
            f,
            symbols=tuple(s + end for s in f.symbols),
            trends=tuple(replace(t, symbol=t.symbol + end) for t in f.trends),
        )
        for f in fit.fits
    )
    return replace(fit, fits=fits, estimates=tuple(e for f in fits for e in make_coefficient_estimates(f, vehicle)))


def describe_rotor_interference(fits: Sequence[RotorCoefficientFit]) -> list[str]:
    """Describe the ratio of each coefficient in a coaxial pair to that of the single rotor, if both were measured."""
    single = [f for f in fits if not f.coaxial]
    pairs = [f for f in fits if f.coaxial]
    words = []
    for alone, pair in ((a, b) for a in single for b in pairs):
        for e in pair.estimates:
            own = [s for s in alone.estimates if s.symbol.partition("_")[0] == e.symbol.partition("_")[0]]
            if not own or math.isinf(e.std) or math.isinf(own[0].std):
                continue
            ratio = e.value / own[0].value
            doubt = 2 * ratio * math.hypot(e.std / e.value, own[0].std / own[0].value)
            changed = "" if abs(ratio - 1) > doubt else ": unaffected within its error"
            words.append(f"{e.symbol} of {pair.source} is {ratio:.3f} +- {doubt:.3f} of {alone.source}{changed}")
    return words


def fit_rotor_coefficients(
    loads: BenchLoads, *, radius_m: float, radius_std_m: float = 0.0, density_kg_m3: float | None = None,
    density_std_kg_m3: float = 0.0, at_speed_rad_s: float | None = None, vehicle: Vehicle | None = None,
) -> tuple[RotorCoefficientFit, ...]:  # fmt: skip
    """Fit thrust and torque coefficients; return one result per pitch setting in the file.

    Parameters
    ----------
    loads : BenchLoads
        Loads from :func:`mufly.bench.compute_loads`.
    radius_m, radius_std_m : float
        Radius of both rotors and its standard deviation.
    density_kg_m3, density_std_kg_m3 : float, optional
        Air density and its standard deviation; by default the density of the file, else 1.2 kg/m^3.
    at_speed_rad_s : float, optional
        Speed at which to evaluate a coefficient that varies; by default the mean over all speeds is returned.
    vehicle : Vehicle, optional
        Source of the start values in the result.

    Raises
    ------
    InputError
        If speeds are missing, there are fewer than two points, or the radius is impossible.

    Thesis: Table 5.2; Sec. 5.2.2.
    """
    if not (math.isfinite(radius_m) and radius_m > 0):
        raise ArgumentError("radius_m", "", f"{radius_m:g} m is out of range", "give the rotor's radius in metres")
    loads, doubts = _resolve_speed_unit(loads, radius_m)
    density, words = resolve_air_density(loads.turning_lines, density_kg_m3)
    if len(loads.turning_lines) > 0:
        loads, more_words = _resolve_load_units(loads, radius_m, float(density.mean()))
        doubts += more_words
    table = loads.turning_lines
    coaxial = any(name.endswith(("_upper", "_lower")) for name in (*table.columns, *loads.values))
    computed = math.isfinite(table.diameter_m)  # computed data of a manufacturer: one point is sufficient
    if len(table) < (1 if computed else 2):
        raise InputError(table.source, "", f"{len(table)} points with a turning rotor", "give two or more")
    if computed and abs(0.5 * table.diameter_m / radius_m - 1.0) > 0.02:
        doubts.append(f"the file's rotor has R {500.0 * table.diameter_m:.4g} mm, this one {1e3 * radius_m:.4g} mm")
    if all(table.headers.get(c) == c and c not in table.columns_without_unit for c in loads.values) and any(
        c in table for c in COEFFICIENT_SCALINGS
    ):
        words = "the file's coefficients depend on no density"
    notes = [*loads.notes, *doubts, words]
    pitch = table["pitch"] if "pitch" in table else np.full(len(table), np.nan)
    settings = np.unique(np.round(pitch / _PITCH_TOLERANCE_rad)) if "pitch" in table else np.array([np.nan])
    results = []
    for setting in settings:
        chosen = np.isnan(pitch) if np.isnan(setting) else np.round(pitch / _PITCH_TOLERANCE_rad) == setting
        fits: list[LoadCoefficientFit] = []
        more: list[str] = []
        for channel in loads.values:
            fit = _fit_channel(
                loads, channel, chosen, density, radius_m, coaxial=coaxial, at_speed=at_speed_rad_s,
                common=(density_std_kg_m3 / float(density.mean()), radius_std_m / radius_m), notes=more,
            )  # fmt: skip
            if fit is not None:
                fits.append(fit)
        estimates = tuple(e for fit in fits for e in make_coefficient_estimates(fit, vehicle))
        impossible = _describe_unphysical(estimates)
        estimates = tuple(e if e.value > 0.0 else replace(e, key="") for e in estimates)
        results.append(
            RotorCoefficientFit(
                table.source, coaxial, float(pitch[chosen][0]), radius_m, density[chosen], estimates, tuple(fits),
                loads, (*impossible, *(u for fit in fits for u in _describe_undetermined_coefficients(fit))), (*notes,
                *more),
            )
        )  # fmt: skip
    return tuple(results)


def _resolve_speed_unit(loads: BenchLoads, radius: float) -> tuple[BenchLoads, list[str]]:
    """Choose the unit of speed by the thrust coefficient if the file states none; note implausible stated units."""
    table, notes = loads.turning_lines, []
    quantity = next((c for c in loads.values if c.startswith("thrust") and c not in table.columns_without_unit), None)
    for name in [c for c in table.columns if c.startswith("speed")]:
        side = name.partition("_")[2]
        channel = f"thrust_{side}" if f"thrust_{side}" in loads.values else quantity
        if channel is None:
            table = convert_speed_to_rad_s(table, radius) if name == "speed" else table
            continue
        if name in table.columns_without_unit:
            unit, factor = guess_speed_unit(table[name], loads.values[channel], radius)
            table = table.rescale_column(name, factor, f"{table.headers[name]} has no unit: taken as {unit}")
            notes.append(table.notes[-1])
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            c = loads.values[channel] / (1.2 * math.pi * radius**4 * table[name] ** 2)
        typical = float(np.nanmedian(np.abs(c)))
        if not _HOVER_THRUST_COEFFICIENT_RANGE[0] < typical < _HOVER_THRUST_COEFFICIENT_RANGE[1]:
            notes.append(
                f"{table.headers[name]}: c_T near {typical:.2g} is far from the usual "
                f"{_HOVER_THRUST_COEFFICIENT_RANGE[0]} to "
                f"{_HOVER_THRUST_COEFFICIENT_RANGE[1]}; check the units (rpm or rad/s), the radius and the thrust"
            )
    return replace(loads, turning_lines=table), notes


def _resolve_load_units(loads: BenchLoads, radius: float, density: float) -> tuple[BenchLoads, list[str]]:
    """Choose the units of loads without unit by the size of the coefficients, or raise an error."""
    found = guess_load_units(loads.turning_lines, loads.values, radius, density)
    table, values, by = loads.turning_lines, dict(loads.values), dict(loads.systematic_parameter_jacobian)
    for channel, (factor, words) in found.items():
        table = table.rescale_column(channel, factor, words)
        values[channel], by[channel] = factor * values[channel], factor * by[channel]
    converted = replace(loads, turning_lines=table, values=values, systematic_parameter_jacobian=by)
    return converted, [words for _, words in found.values()]


def _describe_unphysical(estimates: Sequence[ParameterEstimate]) -> list[str]:
    """Describe unphysical coefficients: negative values, or a figure of merit above one."""
    words = [
        f"{e.symbol} = {e.value:.3g} is negative, which is not physical, and is not written: check the zero "
        "of the load cells, the sign and the unit"
        for e in estimates
        if not e.value > 0.0
    ]
    known = {e.symbol: e.value for e in estimates if e.value > 0.0}
    for end in SYMBOL_SUFFIX_BY_SIDE.values():
        thrust, torque = known.get(f"cT{end}", math.nan), known.get(f"cQ{end}", math.nan)
        merit = thrust**1.5 / (math.sqrt(2.0) * torque)
        if merit > 1.0:
            words.append(
                f"cT{end} and cQ{end} give a figure of merit of {merit:.3g}, above 1, which no rotor has: check the "
                "radius, the density and the units"
            )
    return words


def _fit_channel(
    loads: BenchLoads, channel: str, chosen: NDArray[np.bool_], density: Array, radius: float, *, coaxial: bool,
    at_speed: float | None, common: tuple[float, float], notes: list[str],
) -> LoadCoefficientFit | None:  # fmt: skip
    quantity, _, side = channel.partition("_")
    sides = (side,) if side or not coaxial else ("upper", "lower")  # rotors whose loads the channel holds
    if quantity == "torque" and len(sides) == 2:
        notes.append("the total torque of a coaxial pair is the difference of two and is not used; give torque_upper "
                     "and torque_lower, for example from the motors' currents")  # fmt: skip
        return None
    table = loads.turning_lines
    speeds = []
    for side in sides:
        name = f"speed_{side}" if side and f"speed_{side}" in table else "speed"
        table.require_columns((name,))
        speeds.append(table[name])
    measured = np.isfinite(loads.values[channel]) & chosen & (np.min(np.abs(speeds), axis=0) > 0)
    p = len(sides)
    one = p == 1 and int(measured.sum()) == 1 and math.isfinite(table.diameter_m)
    if measured.sum() < p + 1 and not one:
        notes.append(f"{channel}: {int(measured.sum())} points are too few")
        return None
    symbol, _, power = COEFFICIENT_DEFINITIONS[quantity]
    speed = np.column_stack(speeds)[measured]
    unit = density[measured][:, None] * math.pi * radius**power * speed**2
    load = loads.values[channel][measured]
    if np.median(load) < 0:
        load = -load
        why = "that of the sense of rotation" if quantity == "torque" else "taken for that of the load cell"
        notes.append(f"{channel} is negative and was inverted: its sign is {why}")
    run = table["run"].astype(np.int64)[measured] if "run" in table else None
    expected, words = _expected_errors(unit, load)
    notes.append(f"{channel}: scatter taken in proportion to {words}")
    symbols = tuple(symbol + SYMBOL_SUFFIX_BY_SIDE[s] for s in sides)
    a, b = unit / expected[:, None], load / expected
    size = np.linalg.norm(a, axis=0)
    if one:
        notes.append(f"{channel}: one static line, so its scatter is unknown")
    if one or np.linalg.cond(a / size) > 1e4:
        # A constant speed ratio determines only one sum of the two coefficients. The minimum-norm solution is returned
        # with infinite variance, or with NaN for a single line.
        value = np.linalg.lstsq(a / size, b, rcond=1e-4)[0] / size
        none = CovarianceEstimate(np.full((p, p), math.nan if one else np.inf), math.nan, 1.0, "white", 0.0)
        return LoadCoefficientFit(
            channel, symbols, value, none.covariance, np.zeros(p), speed, unit, load, expected, none, ()
        )
    value, found = _weighted_least_squares(a, b, run, _assign_setting_numbers(speed, run))
    trends: tuple[CoefficientTrend, ...] = ()
    scatter = found.covariance
    speeds_seen = np.unique(_assign_setting_numbers(speed, None)).size
    if p == 1 and speeds_seen == 1:
        notes.append(f"{channel}: one speed only, so the dependence of the coefficient on speed is unknown")
    elif p == 1 and load.size >= 5:
        trend = fit_coefficient_trend(channel, symbols[0], speed[:, 0], unit[:, 0], load, expected, run)
        trends = (trend,)
        if trend.is_significant and at_speed is not None:
            value = np.array([float(trend.coefficient_at(at_speed))])
            scatter = np.array([[float(trend.coefficient_std_at(at_speed)) ** 2]])
            found = trend.covariance_estimate
        elif trend.is_significant:
            # The interval of a constant coefficient includes its change with speed.
            over = a[:, 0] ** 2 / float(a[:, 0] @ a[:, 0])
            away = float(over @ (trend.coefficient_at(speed[:, 0]) - value[0]) ** 2)
            scatter = np.array([[float(trend.coefficient_std_at(trend.reference_rad_s)) ** 2 + away]])
            found = replace(trend.covariance_estimate, residual_std_ratio=found.residual_std_ratio)
    if found.pattern != "white":
        notes.append(f"{channel}: {found.describe_error_correlation()}")
    gain = np.linalg.lstsq(a, loads.systematic_parameter_jacobian[channel][measured] / expected[:, None], rcond=None)[0]
    shared = gain @ loads.systematic_parameter_covariance @ gain.T
    shared = shared + np.outer(value, value) * (common[0] ** 2 + (power * common[1]) ** 2)
    covariance = scatter + shared
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.diag(covariance) > 0, np.diag(shared) / np.diag(covariance), 0.0)
    return LoadCoefficientFit(
        channel, symbols, value, covariance, share, speed, unit, load, expected * found.residual_std_ratio, found,
        trends,
    )  # fmt: skip


def _expected_errors(unit: Array, load: Array) -> tuple[Array, str]:
    """Return the expected errors (n,), up to a common factor, by the likeliest error model, and its description."""

    def likelihood_of_error_model(reading: float, full_scale: float) -> tuple[Array, float]:
        fitted = np.abs(unit @ np.linalg.lstsq(unit, load, rcond=None)[0])
        std = 0.01 * np.hypot(reading * fitted, full_scale * np.max(np.abs(load)))
        a, b = unit / std[:, None], load / std
        r = b - a @ np.linalg.lstsq(a, b, rcond=None)[0]
        size = load.size * np.log(max(float(r @ r), 1e-300))
        return std, size + 2 * float(np.sum(np.log(std)))

    return select_error_model(_CANDIDATE_ERROR_MODELS_PERCENT, likelihood_of_error_model)


def _assign_setting_numbers(speed: Array, run: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Return each line's bench setting as a number; lines of one run within 0.2 % of speed have the same one."""
    key = np.round(np.log(np.abs(speed)) / 0.002)
    whole = np.column_stack([key, np.zeros(len(key)) if run is None else run])
    return np.unique(whole, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _describe_undetermined_coefficients(fit: LoadCoefficientFit) -> tuple[str, ...]:
    if np.isnan(fit.covariance).any():  # one line
        return ()
    if not np.all(np.isfinite(fit.covariance)):
        return (
            f"{' and '.join(fit.symbols)}: both rotors turn at one ratio of speeds, so only a weighted sum "
            "is determined",
        )
    return describe_undetermined_combinations(fit.symbols, compute_relative_covariance(fit.covariance, fit.value))
