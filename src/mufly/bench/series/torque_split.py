"""Torques of the two rotors of a pair, separated by the motor currents (dissertation, Sec. 3.2.1).

The torque cell under both rotors reads the sum ``M = s_up Q_up + s_dw Q_dw`` (s = +1, -1). Each motor current gives

    Q = k I - c_0 - c_1 W + w(t) + error                  torque constant, constant and viscous friction

with a random walk w of the friction as bearings and magnets warm up (:mod:`mufly.bench.series.random_walk_drift`). k,
c_0, c_1 of each axis are fitted to the points with a single rotor, mostly the reference, where the cell reads Q
directly. The errors of the fit are those of cell and current, ``u_Q^2 + k^2 u_I^2``. For a pair the fit is evaluated
at its currents and times, and updated by the cell's reading M, a more accurate measurement of the sum:

    Q' = Q + P H' (H P H' + C_M)^-1 (M - H Q),     P' = P - P H' (H P H' + C_M)^-1 H P,     H = [s_up, s_dw]

(constrained least squares; Deming 1943). The innovation ``M - H Q`` tests the split, which is valid only if the
innovation agrees with its covariance. Without a torque cell, known torques of the reference replace its readings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.bench.rig.bench_devices import BenchFacts
from mufly.bench.series.random_walk_drift import RandomWalkDrift, fit_random_walk
from mufly.bench.series.series_plan import SeriesPlan
from mufly.bench.series.series_readings import LoadChannel, SeriesReadings

Array = NDArray[np.float64]

_MIN_TRAINING_POINTS = 5


@dataclass(frozen=True, eq=False)
class TorqueSplit:
    """Torque of each rotor of a pair at the measured points, separated by the motor currents.

    Attributes
    ----------
    point_index : (m,) array of int
        Indices of the points.
    torque_Nm : dict of str to (m,) array
        Torque of ``"upper"`` and ``"lower"``.
    covariance : dict of str to (m, m) array
        Covariance of these torques ((N m)^2).
    motor_fits : dict of str to RandomWalkDrift
        Fit of k, c_0, c_1 of each axis.
    cell_mismatch_over_std : (m,) array
        Cell reading less the sum from currents, in standard uncertainties; NaN without a torque cell.
    """

    point_index: NDArray[np.int64]
    torque_Nm: dict[str, Array]
    covariance: dict[str, Array]
    motor_fits: dict[str, RandomWalkDrift]
    cell_mismatch_over_std: Array


def split_torque(
    points: SeriesReadings, plan: SeriesPlan, facts: BenchFacts, speed: dict[str, Array], torque: LoadChannel | None,
    known: Array, known_relative: float, start: float,
) -> TorqueSplit | str:  # fmt: skip
    """Estimate the torque of each rotor of a pair from the motor currents; return it, or the reason for a failure.

    Without a torque cell, the torques of single rotors are estimated as well.

    Parameters
    ----------
    points, plan, facts, speed
        See :mod:`mufly.bench.series.series_readings`.
    torque : LoadChannel, optional
        Torque measured by the cell.
    known : (n,) array
        Torque of a single rotor known without a cell (N m); NaN elsewhere.
    known_relative : float
        Common relative standard uncertainty of ``known``.
    start : float
        Start of the series (s).

    Returns
    -------
    TorqueSplit or str
        Torques, or the reason for a failure.
    """
    axis = np.array([plan.mounting[k].axis for k in points.mounting_index])
    where = np.flatnonzero(axis == "pair") if torque is not None else np.flatnonzero(np.isnan(known))
    if not where.size:
        return ""
    n = len(points)
    value, covariance, fits = {}, {}, {}
    for side in ("upper", "lower"):
        current, std = points.channel_means(f"current_{side}"), points.std.get(f"current_{side}", np.zeros(n))
        if torque is not None:
            q, own = facts.torque_signs[side] * torque.value, np.diag(torque.own_covariance)
        else:
            q, own = known, np.zeros(n)
        train = np.flatnonzero((axis == side) & np.isfinite(q) & np.isfinite(current))
        turns = where[speed[side][where] > 0]
        value[side], covariance[side] = np.zeros(where.size), np.zeros((where.size, where.size))
        if not turns.size:
            continue
        if train.size < _MIN_TRAINING_POINTS or np.ptp(speed[side][train]) < 0.2 * speed[side][train].max():
            return (
                f"the torques of a pair cannot be separated: the {side} motor's current was calibrated at "
                f"{train.size} points; mount the reference alone on that axis, at five speeds over the "
                "whole range"
            )
        design = np.column_stack([current, -np.ones(n), -speed[side]])
        k = float(np.linalg.lstsq(design[train], q[train], rcond=None)[0][0])
        u = np.sqrt(own[train] + (k * std[train]) ** 2)
        fit = fits[side] = fit_random_walk(points.time_s[train], q[train], u, design[train], start)
        mean, cov = fit.predict_model_and_drift(points.time_s[turns], design[turns])
        # Scatter of the currents, and of the friction between mountings as found by the fit.
        own_part = (k * std[turns]) ** 2 * fit.mean_variance_inflation + 0.25 * np.median(u) ** 2 * (
            fit.mean_variance_inflation - 1.0
        )
        cov = cov + np.diag(own_part)
        scale = known_relative**2
        if torque is not None:
            # All torques share the gain error of the cell.
            relative = torque.common_covariance[np.ix_(train, train)] / np.outer(
                torque.value[train], torque.value[train]
            )
            scale = float(np.abs(relative).mean())
        cov = cov + scale * np.outer(mean, mean)
        at = np.flatnonzero(speed[side][where] > 0)
        value[side][at] = mean
        covariance[side][np.ix_(at, at)] = cov
    mismatch = np.full(where.size, np.nan)
    if torque is not None:
        m = where.size
        h = np.hstack([facts.torque_signs[s] * np.eye(m) for s in ("upper", "lower")])
        p = np.zeros((2 * m, 2 * m))
        p[:m, :m], p[m:, m:] = covariance["upper"], covariance["lower"]
        q = np.concatenate([value["upper"], value["lower"]])
        total = torque.total_covariance[np.ix_(where, where)]
        middle = h @ p @ h.T + total
        off = torque.value[where] - h @ q
        mismatch = off / np.sqrt(np.diag(middle))
        gain = p @ h.T @ np.linalg.inv(middle)
        q = q + gain @ off
        p = p - gain @ h @ p
        value = {"upper": q[:m], "lower": q[m:]}
        covariance = {"upper": p[:m, :m], "lower": p[m:, m:]}
    return TorqueSplit(where.astype(np.int64), value, covariance, fits, mismatch)
