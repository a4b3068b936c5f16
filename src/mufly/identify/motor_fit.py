"""Motor constants from a bench: fit of the steady-state motor equations with errors in every channel.

In steady state eqs. 4.24, 4.25, 4.27 and 4.28 of the dissertation relate the voltage ``U = duty * supply`` at the
motor, its current I, the torque Q and the speed W (rad/s). Speed and torque are measured after a gear of ratio i and
efficiency eta, or at the motor shaft (i = 1 and eta = 1):

    e1 = U - R I - a W = 0        a = kE i
    e2 = b I - d W - c - Q = 0    b = kM i eta,    d = dR i^2 eta,    c = Mf i eta.

The constant friction Mf (brushes, bearings, iron hysteresis) makes the no-load current nearly independent of the
speed. It is not in the dissertation's equations. It is held at zero unless its estimate differs from zero by more
than three standard deviations.

All four readings y = (U, I, W, Q) of a point have errors with covariance N. To first order ``(e1, e2)`` then have the
covariance ``S = E N E'`` with ``E = [[1, -R, -a, 0], [0, b, -d, -1]]``, and the most likely constants minimise

    sum over points of  e' S^-1 e

(Deming's adjustment, Statistical Adjustment of Data, 1943; Fuller, Measurement Error Models, 1987, sec. 1.3: plain
least squares on noisy I and W would be biased low). The expected errors are needed only up to one factor per
equation, which the residuals give. The covariance comes from :mod:`mufly.bench.residual_covariance`, with the
sensitivities at the adjusted readings.

The constants follow from a, b, R, d, c if i and eta are known, and include their uncertainty. Otherwise only products
of constants are determined and returned. Intervals are at 95 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.bench import BenchTable, CovarianceEstimate, estimate_parameter_covariance
from mufly.errors import InputError
from mufly.identify.fit_result import (
    EstimateLookup,
    ParameterEstimate,
    compute_relative_covariance,
    describe_undetermined_combinations,
    select_error_model,
    tabulate_estimates,
)
from mufly.identify.motor_data import MOTOR_CHANNELS, ChannelNoise, MotorData, extract_motor_data
from mufly.results import ShownBlock, make_lines_block, result
from mufly.vehicle import Vehicle

Array = NDArray[np.float64]

MOTOR_CONSTANT_KEYS = {
    "kE": ("motor.back_emf_constant", "V s"),
    "kM": ("motor.torque_constant", "N m/A"),
    "Rohm": ("motor.resistance", "ohm"),
    "dR": ("motor.friction", "N m s"),
    "Mf": ("motor.friction_torque", "N m"),
}
_DAMPING_INDEX, _FRICTION_INDEX = 3, 4
"""Indices of viscous friction d and constant friction c in (R, a, b, d, c)."""
_MIN_MOTOR_POINTS = 6
_MAX_ROUNDING_RESIDUAL_RATIO = 1e-6
"""Ratio of residuals to expected errors below which the residuals are rounding errors."""
_MAX_TORQUE_TO_BACK_EMF_RATIO = 1.05  # kM / kE
_CANDIDATE_ERROR_MODELS_PERCENT = (
    (1.0, 0.2),
    (1.0, 0.05),
    (1.0, 0.5),
    (1.0, 2.0),
    (0.0, 1.0),
)  # % of reading, % of full scale


@dataclass(frozen=True)
class GearKnowledge:
    """Known data of the gear between the motor and the measurement of speed and torque.

    Attributes
    ----------
    ratio, efficiency : float or None
        Gear ratio and efficiency; None if unknown; 1 for a measurement at the motor shaft.
    ratio_std, efficiency_std : float
        Standard deviations.
    """

    ratio: float | None = 1.0
    efficiency: float | None = 1.0
    ratio_std: float = 0.0
    efficiency_std: float = 0.0


@result(
    eq=False,
    json="source points=data.voltage_V.size estimates covariance scales pattern=covariance_estimate.pattern "
    "undetermined notes",
)
class MotorFit(EstimateLookup):
    """Motor constants with the data and residuals of their fit.

    Attributes
    ----------
    source : str
        Name of the bench file.
    estimates : tuple of ParameterEstimate
        kE, kM, Rohm, dR, and Mf if significant; or products such as ``kM*eta_gear`` for an unknown gear.
    covariance : (n, n) array
        Covariance of the estimates (SI).
    effective : (5,) array
        R (ohm), a (V s), b (N m/A), d (N m s), c (N m) of the module docstring, at the place of measurement.
    data, adjusted : MotorData
        Readings, and the most likely true values.
    residual : (n, 2) array
        Residuals e1 (V) and e2 (N m).
    expected_residual_std : (n, 2) array
        Standard deviations of the residuals after the fit.
    scales : (2,) array
        Ratio of observed to expected errors of the two equations.
    covariance_estimate : CovarianceEstimate
    undetermined, notes : tuple of str
        Undetermined combinations of constants; assumptions, guesses and findings.
    """

    source: str
    estimates: tuple[ParameterEstimate, ...]
    covariance: Array
    effective: Array
    data: MotorData
    adjusted: MotorData
    residual: Array
    expected_residual_std: Array
    scales: Array
    covariance_estimate: CovarianceEstimate
    undetermined: tuple[str, ...]
    notes: tuple[str, ...]

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return constants, residuals and notes as printed text."""
        volts, torque = np.sqrt(np.mean(self.residual**2, axis=0))
        return (
            tabulate_estimates(self.estimates, f"{self.source}: {self.data.voltage_V.size} points"),
            make_lines_block(
                f"residuals: {1e3 * volts:.3g} mV in the voltage's balance, {1e3 * torque:.3g} mN m in the torque's"
            ),
            make_lines_block(*self.notes, mark="note"),
            make_lines_block(*self.undetermined, mark="not observable"),
        )


def fit_motor(
    table: BenchTable, *, gear: GearKnowledge | None = None, noise: dict[str, ChannelNoise] | None = None,
    vehicle: Vehicle | None = None,
) -> MotorFit:  # fmt: skip
    """Fit the steady-state motor equations to a bench file.

    Parameters
    ----------
    table : BenchTable
        Columns ``voltage`` (and ``duty``), ``current`` (or ``supply_current`` with ``duty``), ``speed``, ``torque``.
    gear : GearKnowledge, optional
        Gear data; by default the measurement is at the motor shaft.
    noise : dict, optional
        Expected errors of voltage, current, speed, torque; by default 1 % of the reading and 0.3 % of full scale.
    vehicle : Vehicle, optional
        Source of the start values in the result.

    Raises
    ------
    InputError
        If columns are missing, constant or too short, or violate the energy balance.

    Thesis: Fig. 5.1; Sec. 5.2.1.
    """
    gear = gear or GearKnowledge()
    data, notes = extract_motor_data(table)
    n = data.voltage_V.size
    if n < _MIN_MOTOR_POINTS:
        raise InputError(table.source, "", f"{n} points are too few", f"give {_MIN_MOTOR_POINTS} or more")
    std, words = _expected_errors(data, noise)
    notes.append(words)
    same = _MotorEquations(data, std)
    # A vehicle with constant friction keeps it as a free constant.
    free = np.array([True, True, True, True, vehicle is not None and float(vehicle.motor.friction_torque) > 0])
    while True:
        effective, scales = same.solve_constants(free)
        if free[_DAMPING_INDEX] and effective[_DAMPING_INDEX] < 0:
            free[_DAMPING_INDEX] = False
            notes.append("the friction dR would be below zero and was held at 0: torque or current may have an offset")
            continue
        jacobian = same.whitened_sensitivities(effective, scales)
        white = same.whitened_residuals(effective, scales)
        found = estimate_parameter_covariance(
            jacobian[:, free], white.ravel(), channel=np.tile([0, 1], n), run=np.repeat(data.run, 2),
            group=np.repeat(_assign_setting_numbers(data, std), 2),
        )  # fmt: skip
        if np.max(scales) <= _MAX_ROUNDING_RESIDUAL_RATIO:
            break
        asked, rubbing = _find_unmodelled_terms(
            jacobian[:, free], white, same.whitening_matrices(effective, scales), found, free
        )
        if not rubbing and _needs_constant_friction(same, effective, scales, free, gear):
            rubbing = True
        if not rubbing:
            notes += [found.describe_error_correlation()] if found.pattern != "white" else []
            notes += asked
            break
        free[_FRICTION_INDEX] = True
    _require_positive_constants(table, data, effective, found.covariance, free, found.t_quantile_95)
    covariance = np.zeros((5, 5))
    covariance[np.ix_(free, free)] = found.covariance
    estimates, cov, undetermined = _make_constant_estimates(
        effective, covariance, gear, found.t_quantile_95, free, vehicle
    )
    notes += _check_energy_balance(effective, gear)
    return MotorFit(
        table.source, estimates, cov, effective, data, same.estimate_true_readings(effective),
        same.equation_residuals(effective),
        same.residual_std(effective, scales) * found.residual_std_ratio, scales, found, undetermined, tuple(notes),
    )  # fmt: skip


def _require_positive_constants(
    table: BenchTable, data: MotorData, effective: Array, covariance: Array, free: NDArray[np.bool_], quantile: float
) -> None:  # fmt: skip
    """Raise an error if a fitted motor constant is not positive.

    Raises
    ------
    InputError
        If R, kE or kM is not positive; the error names a missing column if the voltage reveals it.
    """
    std = np.zeros(5)
    std[free] = np.sqrt(np.diag(covariance))
    for k, (name, unit) in enumerate((("Rohm", "ohm"), ("kE", "V s"), ("kM", "N m/A"))):
        if effective[k] > 0.0:
            continue
        remedy = "check signs, units, and that voltage and current are the motor's"
        supply = data.voltage_V
        spread_ = float(np.ptp(data.speed_rad_s)) / float(np.max(np.abs(data.speed_rad_s)))
        if "duty" not in table and float(np.ptp(supply)) < 0.2 * float(np.max(np.abs(supply))) and spread_ > 0.3:
            remedy = (
                f"{table.headers['voltage']} hardly changes while the speed changes, so it is the supply "
                "voltage: add a column duty, or the ESC's signal in us"
            )
        value = f"{effective[k]:.4g} +- {quantile * std[k]:.2g} {unit}"
        raise InputError(
            table.source, "", f"the fit gives {name} = {value}, which is outside the range of real motors", remedy
        )


class _MotorEquations:
    """Data and residuals of the two steady-state motor equations, and the fit of their constants.

    All readings have errors.
    Constants are ``x = (R, a, b, d, c)`` of the module docstring. ``reading_std`` (n, 4) are the expected errors of
    voltage, current, speed and torque. ``scales`` (2,) are the ratios of observed to expected residuals of the two
    equations.
    """

    def __init__(self, data: MotorData, std: Array) -> None:
        self.data, self.reading_std = data, std

    def equation_residuals(self, x: Array) -> Array:
        """Return the residuals (n, 2) of U = R I + a w (e1, V), Q = b I - d w - c (e2, N m), ``x``: R, a, b, d, c."""
        r, a, b, d, c = x
        u, i, w, q = self.data.channel_arrays()
        return np.column_stack([u - r * i - a * w, b * i - d * w - c - q])

    def whitening_matrices(self, x: Array, scales: Array) -> Array:
        """Return the inverse Cholesky factor of the covariance of both equation residuals at every point, (n, 2, 2)."""
        r, a, b, d, _ = x
        vu, vi, vw, vq = (self.reading_std**2).T
        s11 = (vu + r**2 * vi + a**2 * vw) * scales[0] ** 2
        s22 = (vq + b**2 * vi + d**2 * vw) * scales[1] ** 2
        s12 = (-r * b * vi + a * d * vw) * scales[0] * scales[1]
        l11 = np.sqrt(s11)
        l21 = s12 / l11
        l22 = np.sqrt(s22 - l21**2)
        out = np.zeros((len(self.reading_std), 2, 2))
        out[:, 0, 0], out[:, 1, 1], out[:, 1, 0] = 1 / l11, 1 / l22, -l21 / (l11 * l22)
        return out

    def whitened_residuals(self, x: Array, scales: Array) -> Array:
        """Return the equation residuals (n, 2), divided by their expected errors and decorrelated."""
        return np.einsum("nij,nj->ni", self.whitening_matrices(x, scales), self.equation_residuals(x))

    def residual_std(self, x: Array, scales: Array) -> Array:
        """Return the standard deviations (n, 2) of the residuals of the voltage (V) and torque equations (N m)."""
        return np.linalg.norm(np.linalg.inv(self.whitening_matrices(x, scales)), axis=2)

    def solve_constants(self, free: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Fit the constants R, a, b, d, c of U = R I + a w and Q = b I - d w - c.

        The second array (2,) is the ratio of observed to expected errors of each equation.

        Constants that are not ``free`` (5,), the frictions d and c, are held at zero.
        """
        u, i, w, q = self.data.channel_arrays()
        start = np.zeros(5)
        start[:2] = np.linalg.lstsq(np.column_stack([i, w]), u, rcond=None)[0]
        start[2:][free[2:]] = np.linalg.lstsq(np.column_stack([i, -w, -np.ones_like(w)])[:, free[2:]], q, rcond=None)[0]
        size = np.abs(start) + 1e-12 * np.max(np.abs(start))
        size[_DAMPING_INDEX] = max(size[_DAMPING_INDEX], 1e-3 * float(np.max(np.abs(q)) / np.max(np.abs(w))))
        size[_FRICTION_INDEX] = max(size[_FRICTION_INDEX], 1e-3 * float(np.max(np.abs(q))))
        mechanical = int(np.sum(free[2:]))

        def expand_free_constants(z: Array) -> Array:
            full = np.where(free, 0.0, start)
            full[free] = z * size[free]
            return full

        scales, x = np.ones(2), start
        for _ in range(3):

            def scaled_residuals(z: Array, scales: Array = scales) -> Array:
                return self.whitened_residuals(expand_free_constants(z), scales).ravel()

            found = least_squares(
                scaled_residuals, x[free] / size[free], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14
            )
            x = expand_free_constants(found.x)
            # Scale of each equation from its residuals over expected errors, with its own degrees of freedom.
            e = self.equation_residuals(x) / self.residual_std(x, np.ones(2))
            scales = np.maximum(np.sqrt(np.sum(e**2, axis=0) / (len(e) - np.array([2, mechanical]))), 1e-9)
        return x, scales

    def estimate_true_readings(self, x: Array) -> MotorData:
        """Return the most likely true readings, at which both equations hold exactly."""
        r, a, b, d, _ = x
        plain = self.whitening_matrices(x, np.ones(2))
        weighted = np.einsum("nji,njk,nk->ni", plain, plain, self.equation_residuals(x))  # S^-1 e
        shift = self.reading_std**2 * (weighted @ np.array([[1.0, -r, -a, 0.0], [0.0, b, -d, -1.0]]))
        u, i, w, q = (np.column_stack(self.data.channel_arrays()) - shift).T
        return MotorData(u, i, w, q, self.data.run)

    def whitened_sensitivities(self, x: Array, scales: Array) -> Array:
        """Return the whitened derivatives (2 n, 5) of both residuals by R, a, b, d and c, at the adjusted readings."""
        _, i, w, _ = self.estimate_true_readings(x).channel_arrays()
        raw = np.zeros((i.size, 2, 5))
        raw[:, 0, 0], raw[:, 0, 1], raw[:, 1, 2], raw[:, 1, _DAMPING_INDEX], raw[:, 1, _FRICTION_INDEX] = (
            -i,
            -w,
            i,
            -w,
            -1.0,
        )
        return np.einsum("nij,njk->nik", self.whitening_matrices(x, scales), raw).reshape(-1, 5)


def _expected_errors(data: MotorData, noise: dict[str, ChannelNoise] | None) -> tuple[Array, str]:
    """Return the expected errors (n, 4) of the readings and a description of the assumption.

    Without ``noise`` the most likely mix of errors proportional to the reading and constant errors is chosen; the fit
    scales it afterwards.
    """
    if noise is not None:
        std = np.column_stack(
            [noise[c].error_std(v) for c, v in zip(MOTOR_CHANNELS, data.channel_arrays(), strict=True)]
        )
        return std, "shape of the errors as given; their size from the residuals"

    def likelihood_of_error_model(reading: float, full_scale: float) -> tuple[Array, float]:
        channel = ChannelNoise(0.01 * reading, 0.01 * full_scale)
        std = np.column_stack([channel.error_std(v) for v in data.channel_arrays()])
        same = _MotorEquations(data, std)
        x, scales = same.solve_constants(np.array([True, True, True, True, False]))
        w = same.whitening_matrices(x, scales)
        size = np.sum(same.whitened_residuals(x, scales) ** 2)
        return std, float(size - 2 * np.sum(np.log(w[:, 0, 0] * w[:, 1, 1])))

    std, words = select_error_model(_CANDIDATE_ERROR_MODELS_PERCENT, likelihood_of_error_model)
    shape = f"errors in all four channels assumed in proportion to {words} (the most likely shape)"
    return std, f"{shape}; size from the residuals"


def _assign_setting_numbers(data: MotorData, std: Array) -> NDArray[np.int64]:
    """Return each line's bench setting as a number; consecutive lines equal within their errors have the same one."""
    y = np.column_stack(data.channel_arrays())
    same = np.all(np.abs(np.diff(y, axis=0)) < 2.5 * std[1:], axis=1) & (np.diff(data.run) == 0)
    return np.cumsum(np.r_[0, ~same]).astype(np.int64)


def _needs_constant_friction(
    same: _MotorEquations, effective: Array, scales: Array, free: NDArray[np.bool_], gear: GearKnowledge
) -> bool:
    """Return whether the fit needs a constant friction.

    It does if the friction restores the energy balance and halves the residual of the torque equation.
    """
    if free[_FRICTION_INDEX] or not _torque_to_back_emf_ratio(effective, gear) > _MAX_TORQUE_TO_BACK_EMF_RATIO:
        return False
    x, s = same.solve_constants(np.array([True, True, True, True, True]))
    if x[_DAMPING_INDEX] < 0.0:
        x, s = same.solve_constants(np.array([True, True, True, False, True]))
    return bool(
        x[_FRICTION_INDEX] > 0.0
        and s[1] < 0.5 * scales[1]
        and _torque_to_back_emf_ratio(x, gear) <= _MAX_TORQUE_TO_BACK_EMF_RATIO
    )


def _torque_to_back_emf_ratio(x: Array, gear: GearKnowledge) -> float:
    """Return the ratio kM / kE."""
    return float(x[2] / (x[1] * (gear.efficiency or 1.0)))


def _find_unmodelled_terms(
    jacobian: Array, white: Array, whitening: Array, found: CovarianceEstimate, free: NDArray[np.bool_]
) -> tuple[list[str], bool]:
    """Describe a constant voltage drop or friction that the motor equations lack and the residuals show.

    The second value is True if the fit should contain a constant friction.
    """
    words: list[str] = []
    n = len(white)
    terms = [(0, "a constant voltage drop", "V", 1.0)]
    if not free[_FRICTION_INDEX]:
        terms.append((1, "a constant friction", "mN m", 1e3))
    for row, name, unit, factor in terms:
        extra = whitening[:, :, row].reshape(2 * n, 1)
        both = np.hstack([jacobian, extra])
        size = np.linalg.norm(both, axis=0)
        more = np.linalg.lstsq(both / size, white.ravel(), rcond=None)[0] / size
        inverse = np.linalg.inv((both / size).T @ (both / size))
        std = found.residual_std_ratio * math.sqrt(inverse[-1, -1]) / size[-1]
        if abs(more[-1]) > 3.0 * std:
            if row == 1 and more[-1] > 0:
                return words, True
            words.append(
                f"the readings suggest {name} of {abs(more[-1]) * factor:.3g} +- {2 * std * factor:.2g} "
                f"{unit} that the equations do not contain; the intervals do not include such a model error"
            )
    return words, False


def _check_energy_balance(x: Array, gear: GearKnowledge) -> list[str]:
    """Describe constants that violate the energy balance, or have unusual losses."""
    ratio = _torque_to_back_emf_ratio(x, gear)
    if ratio > _MAX_TORQUE_TO_BACK_EMF_RATIO:
        return [f"kM/kE = {ratio:.2f}: more mechanical than electrical power; check units and the current's channel"]
    if ratio < 0.3:
        return [f"kM/kE = {ratio:.2f} is small: check the units of speed and torque (rpm for rad/s? mN m for N m?)"]
    return []


def _make_constant_estimates(
    x: Array,
    covariance: Array,
    gear: GearKnowledge,
    quantile: float,
    free: NDArray[np.bool_],
    vehicle: Vehicle | None,
) -> tuple[tuple[ParameterEstimate, ...], Array, tuple[str, ...]]:
    """Convert the fitted constants ``x`` = (R, a, b, d, c) to motor constants.

    Without a gear ratio or efficiency, only the products with them are estimated.
    """
    i, eta = gear.ratio, gear.efficiency
    unit_ratio, unit_eta = i if i is not None else 1.0, eta if eta is not None else 1.0
    r, a, b, d, c = x
    both = unit_ratio * unit_eta
    value = np.array([a / unit_ratio, b / both, r, d / (unit_ratio * both), c / both])
    # Columns: R, a, b, d, c, then
    ratio, efficiency = 5, 6
    jacobian = np.zeros((5, 7))
    jacobian[0, 1], jacobian[1, 2], jacobian[2, 0] = 1 / unit_ratio, 1 / both, 1.0
    jacobian[_DAMPING_INDEX, _DAMPING_INDEX], jacobian[_FRICTION_INDEX, _FRICTION_INDEX] = (
        1 / (unit_ratio * both),
        1 / both,
    )
    jacobian[:, ratio] = np.array([-1.0, -1.0, 0.0, -2.0, -1.0]) * value / unit_ratio
    jacobian[:, efficiency] = np.array([0.0, -1.0, 0.0, -1.0, -1.0]) * value / unit_eta
    whole = np.zeros((7, 7))
    whole[:5, :5] = covariance
    whole[ratio, ratio] = gear.ratio_std**2 if i is not None else 0.0
    whole[efficiency, efficiency] = gear.efficiency_std**2 if eta is not None else 0.0
    cov = jacobian @ whole @ jacobian.T
    tails = dict.fromkeys(MOTOR_CONSTANT_KEYS, "")
    undetermined: list[str] = []
    if i is None:
        tails |= {"kE": "*igear", "kM": "*igear", "dR": "*igear^2", "Mf": "*igear"}
        undetermined.append(
            "kE, kM and dR cannot be separated from the gear ratio: only kE*igear, kM*igear and dR*igear^2 are "
            "observable"
        )
    if eta is None:
        tails |= {k: tails[k] + "*eta_gear" for k in ("kM", "dR", "Mf")}
        undetermined.append(
            "kM and dR cannot be separated from the gear's efficiency: only kM*eta_gear and dR*eta_gear are observable"
        )
    estimates = []
    told = [*range(4), *([_FRICTION_INDEX] if free[_FRICTION_INDEX] else [])]
    cov, value = cov[np.ix_(told, told)], value[told]
    for k, (symbol, (key, unit)) in enumerate(list(MOTOR_CONSTANT_KEYS.items())[: len(told)]):
        std, tail, bound = math.sqrt(cov[k, k]), tails[symbol], symbol == "dR" and not free[_DAMPING_INDEX]
        names = symbol + tail, "" if tail else key, unit
        e = ParameterEstimate.from_std(*names, vehicle, float(value[k]), std, quantile=quantile, at_bound=bound)
        estimates.append(replace(e, std=math.nan) if bound else e)
    seen = [k for k in range(len(told)) if value[k] != 0]
    of_seen = compute_relative_covariance(cov, value)[np.ix_(seen, seen)]
    return (
        tuple(estimates),
        cov,
        (*undetermined, *describe_undetermined_combinations([estimates[k].symbol for k in seen], of_seen)),
    )
