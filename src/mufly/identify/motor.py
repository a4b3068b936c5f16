"""Motor constants from a bench: the stationary motor equations, fitted with errors in every channel.

At rest eqs. 4.24, 4.25, 4.27 and 4.28 of the dissertation say, with the voltage ``U = duty * supply`` at the motor,
its current I, the speed W and the torque Q where they were measured (behind a gear of ratio i and efficiency eta, or
i = 1 and eta = 1 at the motor's own shaft),

    e1 = U - R I - a W = 0        a = kE i
    e2 = b I - d W - Q = 0        b = kM i eta,    d = dR i^2 eta.

All four readings y = (U, I, W, Q) of a point err, with covariance N. To first order ``(e1, e2)`` then have the
covariance ``S = E N E'`` with ``E = [[1, -R, -a, 0], [0, b, -d, -1]]``, and the most likely constants minimise

    sum over points of  e' S^-1 e

(Deming's adjustment, Statistical Adjustment of Data, 1943; Fuller, Measurement Error Models, 1987, sec. 1.3: plain
least squares on noisy I and W would be biased low). The expected errors are needed up to one factor for each
equation, which the residuals give. Covariance: :mod:`mufly.bench.covariance`, with the sensitivities at the adjusted
readings.

From a, b, R, d the constants follow once i and eta are known; their own doubt is passed on. If they are not, only the
products are seen, and only they are returned. Intervals are at 95 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.bench import BenchTable, Spread, spread
from mufly.errors import InputError
from mufly.identify.channel_noise import ChannelNoise
from mufly.identify.directions import unseen_combinations
from mufly.identify.motor_data import MotorData, motor_data
from mufly.identify.motor_equations import (
    adjusted_readings,
    expected_errors,
    expected_residuals,
    sensitivities,
    solve_constants,
)
from mufly.identify.result import Estimate
from mufly.vehicle import Vehicle

__all__ = ["GearKnowledge", "MotorFit", "fit_motor"]

Array = NDArray[np.float64]

KEYS = {
    "kE": ("motor.back_emf_constant", "V s"),
    "kM": ("motor.torque_constant", "N m/A"),
    "Rohm": ("motor.resistance", "ohm"),
    "dR": ("motor.friction", "N m s"),
}
_LEAST_POINTS = 6
_EXACT = 1e-6  # residuals this small against the expected errors are rounding, not measurement


@dataclass(frozen=True)
class GearKnowledge:
    """What is known of the gear between motor and where speed and torque were measured.

    Attributes
    ----------
    ratio, efficiency : float or None
        None if unknown. 1 and 1 at the motor's shaft.
    ratio_std, efficiency_std : float
        Standard deviations.
    """

    ratio: float | None = 1.0
    efficiency: float | None = 1.0
    ratio_std: float = 0.0
    efficiency_std: float = 0.0


@dataclass(frozen=True, eq=False)
class MotorFit:
    """Motor constants and what they rest on.

    Attributes
    ----------
    estimates : tuple of Estimate
        kE, kM, Rohm, dR; or products such as ``kM*eta_gear`` where the gear is not known.
    covariance : (4, 4) array
        Of the estimates.
    effective : (4,) array
        R (ohm), a (V s), b (N m/A), d (N m s) of the module docstring, where speed and torque were measured.
    data, adjusted : MotorData
        Readings, and the most likely true values.
    residual : (n, 2) array
        e1 (V) and e2 (N m).
    expected : (n, 2) array
        Their standard deviations after the fit.
    scales : (2,) array
        Found over expected errors of the two equations.
    spread : Spread
    unseen, notes : tuple of str
        What the data do not tell apart; what was assumed, guessed or found, in words.
    """

    estimates: tuple[Estimate, ...]
    covariance: Array
    effective: Array
    data: MotorData
    adjusted: MotorData
    residual: Array
    expected: Array
    scales: Array
    spread: Spread
    unseen: tuple[str, ...]
    notes: tuple[str, ...]

    def estimate(self, symbol: str) -> Estimate:
        """Return an estimate by its symbol; KeyError if there is none."""
        return {e.symbol: e for e in self.estimates}[symbol]


def fit_motor(
    table: BenchTable,
    *,
    gear: GearKnowledge | None = None,
    noise: dict[str, ChannelNoise] | None = None,
    vehicle: Vehicle | None = None,
) -> MotorFit:
    """Fit the stationary motor equations to a bench file.

    Parameters
    ----------
    table : BenchTable
        Columns ``voltage`` (and ``duty``), ``current`` (or ``supply_current`` with ``duty``), ``speed``, ``torque``.
    gear : GearKnowledge, optional
        Default: measured at the motor's shaft.
    noise : dict, optional
        Expected errors of voltage, current, speed, torque; by default 1 % of the reading and 0.3 % of full scale.
    vehicle : Vehicle, optional
        Where the start values in the result come from.

    Raises
    ------
    InputError
        If columns are missing, constant or too short, or break the balance of energy.
    """
    gear = gear or GearKnowledge()
    data, notes = motor_data(table)
    n = data.voltage_V.size
    if n < _LEAST_POINTS:
        raise InputError(table.source, "", f"{n} points are too few", f"give {_LEAST_POINTS} or more")
    std, words = expected_errors(data, noise)
    notes.append(words)
    effective, scales = solve_constants(data, std, friction=True)
    friction_free = bool(effective[3] < 0)
    if friction_free:
        effective, scales = solve_constants(data, std, friction=False)
        notes.append(
            "the friction dR would be below zero and was held at 0: torque or current may have an offset"
        )
    residual, whitening, adjusted = adjusted_readings(data, std, effective, scales)
    jacobian = sensitivities(adjusted, whitening)
    columns = [0, 1, 2] if friction_free else [0, 1, 2, 3]
    white = np.einsum("nij,nj->ni", whitening, residual)
    found = spread(
        jacobian[:, columns], white.ravel(), channel=np.tile([0, 1], n), run=np.repeat(data.run, 2),
        group=np.repeat(_settings(data, std), 2),
    )  # fmt: skip
    covariance = np.zeros((4, 4))
    covariance[np.ix_(columns, columns)] = found.covariance
    if np.max(scales) > _EXACT:
        if found.pattern != "white":
            notes.append(found.in_words())
        notes += _missing_terms(jacobian[:, columns], white, whitening, found)
    estimates, cov, unseen = _constants(effective, covariance, gear, found.quantile, friction_free, vehicle)
    notes += _energy(effective, gear)
    return MotorFit(
        estimates, cov, effective, data, adjusted, residual,
        expected_residuals(effective, std, scales) * found.scale,
        scales, found, unseen, tuple(notes),
    )  # fmt: skip


def _settings(data: MotorData, std: Array) -> NDArray[np.int64]:
    """Number the settings: consecutive lines whose readings agree within their errors are repeats of one."""
    y = np.column_stack(data.channels())
    same = np.all(np.abs(np.diff(y, axis=0)) < 2.5 * std[1:], axis=1) & (np.diff(data.run) == 0)
    return np.cumsum(np.r_[0, ~same]).astype(np.int64)


def _missing_terms(jacobian: Array, white: Array, whitening: Array, found: Spread) -> list[str]:
    """Say whether a constant in either equation would fit better: brush voltage, Coulomb friction."""
    words = []
    n = len(white)
    for row, name, unit, factor in (
        (0, "a constant voltage drop", "V", 1.0),
        (1, "a constant friction", "mN m", 1e3),
    ):
        extra = whitening[:, :, row].reshape(2 * n, 1)
        both = np.hstack([jacobian, extra])
        size = np.linalg.norm(both, axis=0)
        more = np.linalg.lstsq(both / size, white.ravel(), rcond=None)[0] / size
        inverse = np.linalg.inv((both / size).T @ (both / size))
        std = found.scale * math.sqrt(inverse[-1, -1]) / size[-1]
        if abs(more[-1]) > 3.0 * std:
            words.append(
                f"the readings ask for {name} of {abs(more[-1]) * factor:.3g} +- {2 * std * factor:.2g} {unit} that "
                "the equations do not have; the intervals do not cover such a fault of the model"
            )
    return words


def _energy(x: Array, gear: GearKnowledge) -> list[str]:
    """Say if the constants break the balance of energy, or lose more than usual."""
    ratio = x[2] / (x[1] * (gear.efficiency or 1.0))  # kM / kE
    if ratio > 1.05:
        return [
            f"kM/kE = {ratio:.2f}: more mechanical than electrical power; check units and the current's channel"
        ]
    if ratio < 0.3:
        return [
            f"kM/kE = {ratio:.2f} is small: check the units of speed and torque (rpm for rad/s? mN m for N m?)"
        ]
    return []


def _constants(
    x: Array, covariance: Array, gear: GearKnowledge, quantile: float, at_bound: bool, vehicle: Vehicle | None
) -> tuple[tuple[Estimate, ...], Array, tuple[str, ...]]:
    """Turn (R, a, b, d) into constants, or into the products that are seen."""
    i, eta = gear.ratio, gear.efficiency
    unit_ratio, unit_eta = i if i is not None else 1.0, eta if eta is not None else 1.0
    r, a, b, d = x
    value = np.array([a / unit_ratio, b / (unit_ratio * unit_eta), r, d / (unit_ratio**2 * unit_eta)])
    # Columns: R, a, b, d, ratio, efficiency.
    jacobian = np.zeros((4, 6))
    jacobian[0, 1], jacobian[1, 2], jacobian[2, 0] = 1 / unit_ratio, 1 / (unit_ratio * unit_eta), 1.0
    jacobian[3, 3] = 1 / (unit_ratio**2 * unit_eta)
    jacobian[:, 4] = [-value[0] / unit_ratio, -value[1] / unit_ratio, 0.0, -2 * value[3] / unit_ratio]
    jacobian[:, 5] = [0.0, -value[1] / unit_eta, 0.0, -value[3] / unit_eta]
    whole = np.zeros((6, 6))
    whole[:4, :4] = covariance
    whole[4, 4] = gear.ratio_std**2 if i is not None else 0.0
    whole[5, 5] = gear.efficiency_std**2 if eta is not None else 0.0
    cov = jacobian @ whole @ jacobian.T
    tails = {"kE": "", "kM": "", "Rohm": "", "dR": ""}
    unseen: list[str] = []
    if i is None:
        tails["kE"] += "*igear"
        tails["kM"] += "*igear"
        tails["dR"] += "*igear^2"
        unseen.append(
            "kE, kM and dR cannot be told from the gear ratio: only kE*igear, kM*igear and dR*igear^2 are seen"
        )
    if eta is None:
        tails["kM"] += "*eta_gear"
        tails["dR"] += "*eta_gear"
        unseen.append(
            "kM and dR cannot be told from the gear's efficiency: only kM*eta_gear and dR*eta_gear are seen"
        )
    start: dict[str, Any] = {}
    if vehicle is not None:
        m = vehicle.motor
        start = {"kE": m.back_emf_constant, "kM": m.torque_constant, "Rohm": m.resistance, "dR": m.friction}
    estimates = []
    for k, symbol in enumerate(KEYS):
        key, unit = KEYS[symbol]
        std, tail = math.sqrt(cov[k, k]), tails[symbol]
        bound = symbol == "dR" and at_bound
        estimates.append(
            Estimate(
                symbol=symbol + tail, key="" if tail else key, unit=unit,
                start=float(start[symbol]) if symbol in start and not tail else math.nan, value=float(value[k]),
                std=math.nan if bound else std, low=float(value[k] - quantile * std),
                high=float(value[k] + quantile * std), at_bound=bound,
            )
        )  # fmt: skip
    seen = [k for k in range(4) if value[k] != 0]
    relative = cov[np.ix_(seen, seen)] / np.outer(value[seen], value[seen])
    unseen += unseen_combinations([estimates[k].symbol for k in seen], relative)
    return tuple(estimates), cov, tuple(unseen)
