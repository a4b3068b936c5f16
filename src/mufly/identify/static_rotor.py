"""Thrust and torque coefficients of rotors from a bench, single and coaxial, with what they rest on.

    T = c_T rho pi R^4 W^2,      Q = c_Q rho pi R^5 W^2        (eq. 3.3 of the dissertation)

With ``q = rho pi R^4 W^2`` (torque: ``R^5``) each coefficient is a weighted linear least-squares fit ``load = c q``.
Where a coaxial bench measures only the total thrust, both coefficients are fitted to ``T = c_up q_up + c_dw q_dw``.
The expected error of a load is taken in proportion to the likeliest shape between a share of the reading and a share
of full scale; its size follows from the residuals, whose pattern widens the intervals
(:mod:`mufly.bench.covariance`). Errors that all readings share do not average out and are added:

    cov(c) = cov_scatter + G C G' + c c' (var(rho) / rho^2 + k^2 var(R) / R^2),      G = dc/d(calibration, zeros),

with k = 4 for thrust and 5 for torque. Whether a coefficient is constant over speed, as the flight model takes it, is
tested (:mod:`mufly.identify.rotor_trend`). If it is not, the estimate is still the best single number, and its
variance grows by the mean square of the coefficient's distance from it over the measured speeds.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mufly.bench import Loads, Spread, air_density, spread
from mufly.errors import InputError
from mufly.identify.directions import unseen_combinations
from mufly.identify.rotor_fit import COEFFICIENTS, SIDES, CoefficientFit, RotorFit, estimates_of
from mufly.identify.rotor_trend import Trend, fit_trend
from mufly.vehicle import Vehicle

__all__ = ["fit_rotor"]

Array = NDArray[np.float64]

# % of reading, % of full scale; the first holds unless another is clearly likelier (2 log L, as by AIC).
_SHAPES = ((1.0, 0.3), (1.0, 0.02), (1.0, 0.1), (1.0, 1.0), (0.0, 1.0))
_CLEARLY = 4.0
_TYPICAL, _ORDINARY = 0.01, (0.0005, 0.06)  # thrust coefficients of hovering rotors
_RPM = math.pi / 30.0
_PITCH = math.radians(0.05)  # settings of the blades closer than this are one


def fit_rotor(
    loads: Loads, *, radius_m: float, radius_std_m: float = 0.0, density_kg_m3: float | None = None,
    density_std_kg_m3: float = 0.0, at_speed_rad_s: float | None = None, vehicle: Vehicle | None = None,
) -> tuple[RotorFit, ...]:  # fmt: skip
    """Fit thrust and torque coefficients, a result for every pitch setting in the file.

    Parameters
    ----------
    loads : Loads
        From :func:`mufly.bench.corrected_loads`.
    radius_m, radius_std_m : float
        Of both rotors, and its standard deviation.
    density_kg_m3, density_std_kg_m3 : float, optional
        Of the air; by default from the file, else 1.2.
    at_speed_rad_s : float, optional
        Where a coefficient changes with speed, give its value at this one instead of the mean over all speeds.
    vehicle : Vehicle, optional
        Start values in the result.

    Raises
    ------
    InputError
        If speeds are missing, there are fewer than two points, or the radius cannot be right.
    """
    if not (math.isfinite(radius_m) and radius_m > 0):
        raise InputError(
            "--radius", "", f"{radius_m:g} m is not possible", "give the rotor's radius in metres"
        )
    loads, doubts = _speed_unit(loads, radius_m)
    table = loads.table
    coaxial = any(name.endswith(("_upper", "_lower")) for name in (*table.columns, *loads.values))
    if len(table) < 2:
        raise InputError(table.source, "", f"{len(table)} points with a turning rotor", "give two or more")
    density, words = air_density(table, density_kg_m3)
    notes = [*loads.notes, *doubts, words]
    pitch = table["pitch"] if "pitch" in table else np.full(len(table), np.nan)
    settings = np.unique(np.round(pitch / _PITCH)) if "pitch" in table else np.array([np.nan])
    results = []
    for setting in settings:
        chosen = np.isnan(pitch) if np.isnan(setting) else np.round(pitch / _PITCH) == setting
        fits: list[CoefficientFit] = []
        more: list[str] = []
        for channel in loads.values:
            fit = _fit_channel(
                loads, channel, chosen, density, radius_m, coaxial=coaxial, at_speed=at_speed_rad_s,
                common=(density_std_kg_m3 / float(density.mean()), radius_std_m / radius_m), notes=more,
            )  # fmt: skip
            if fit is not None:
                fits.append(fit)
        estimates = tuple(e for fit in fits for e in estimates_of(fit, vehicle))
        results.append(
            RotorFit(
                table.source, coaxial, float(pitch[chosen][0]), radius_m, density[chosen], estimates, tuple(fits),
                loads, tuple(u for fit in fits for u in _unseen(fit)), (*notes, *more),
            )
        )  # fmt: skip
    return tuple(results)


def _speed_unit(loads: Loads, radius: float) -> tuple[Loads, list[str]]:
    """Take speeds without a unit as rpm or rad/s, whichever gives an ordinary coefficient; doubt stated units."""
    table, notes = loads.table, []
    quantity = next((c for c in loads.values if c.startswith("thrust")), None)
    for name in [c for c in table.columns if c.startswith("speed")]:
        if quantity is None:
            break
        side = name.partition("_")[2]
        channel = f"thrust_{side}" if f"thrust_{side}" in loads.values else quantity
        with np.errstate(divide="ignore", invalid="ignore"):
            c = loads.values[channel] / (1.2 * math.pi * radius**4 * table[name] ** 2)
        typical = float(np.nanmedian(np.abs(c)))
        off, off_rpm = abs(math.log(typical / _TYPICAL)), abs(math.log(typical / _RPM**2 / _TYPICAL))
        if name in table.unitless:
            unit, factor = ("rpm", _RPM) if off_rpm < off else ("rad/s", 1.0)
            table = table.rescaled(name, factor, f"{table.headers[name]} has no unit: taken as {unit}")
            notes.append(table.notes[-1])
        elif not _ORDINARY[0] < typical < _ORDINARY[1]:
            notes.append(
                f"{table.headers[name]}: c_T near {typical:.2g} is far from the usual {_ORDINARY[0]} to "
                f"{_ORDINARY[1]}; check the units (rpm or rad/s), the radius and the thrust"
            )
    return replace(loads, table=table), notes


def _rotors_of(channel: str, coaxial: bool) -> tuple[str, tuple[str, ...]]:
    """Return the quantity of a channel and the rotors whose loads it holds."""
    quantity, _, side = channel.partition("_")
    return quantity, (side,) if side or not coaxial else ("upper", "lower")


def _fit_channel(
    loads: Loads, channel: str, chosen: NDArray[np.bool_], density: Array, radius: float, *, coaxial: bool,
    at_speed: float | None, common: tuple[float, float], notes: list[str],
) -> CoefficientFit | None:  # fmt: skip
    quantity, sides = _rotors_of(channel, coaxial)
    if quantity == "torque" and len(sides) == 2:
        notes.append("the total torque of a coaxial pair is the difference of two and is not used; give torque_upper "
                     "and torque_lower, for example from the motors' currents")  # fmt: skip
        return None
    table = loads.table
    speeds = []
    for side in sides:
        name = f"speed_{side}" if side and f"speed_{side}" in table else "speed"
        table.require((name,))
        speeds.append(table[name])
    measured = np.isfinite(loads.values[channel]) & chosen & (np.min(np.abs(speeds), axis=0) > 0)
    p = len(sides)
    if measured.sum() < p + 1:
        notes.append(f"{channel}: {int(measured.sum())} points are too few")
        return None
    symbol, _, power = COEFFICIENTS[quantity]
    speed = np.column_stack(speeds)[measured]
    unit = density[measured][:, None] * math.pi * radius**power * speed**2
    load = loads.values[channel][measured]
    if np.median(load) < 0:
        load = -load
        why = (
            "is that of the sense of rotation"
            if quantity == "torque"
            else "is taken for that of the load cell"
        )
        notes.append(f"{channel} is negative and was turned round: its sign {why}")
    run = table["run"].astype(np.int64)[measured] if "run" in table else None
    expected, words = _expected(unit, load)
    notes.append(f"{channel}: scatter taken in proportion to {words}")
    symbols = tuple(symbol + SIDES[s] for s in sides)
    a, b = unit / expected[:, None], load / expected
    size = np.linalg.norm(a, axis=0)
    if np.linalg.cond(a / size) > 1e4:
        # Both rotors at one ratio of speeds: only one sum is seen. The shortest vector is returned with infinite doubt.
        value = np.linalg.lstsq(a / size, b, rcond=1e-4)[0] / size
        spread_ = Spread(np.full((p, p), np.inf), math.nan, 1.0, "white", 0.0)
        infinite = np.full((p, p), np.inf)
        return CoefficientFit(
            channel, symbols, value, infinite, np.zeros(p), speed, unit, load, expected, spread_, ()
        )
    value = np.linalg.lstsq(a, b, rcond=None)[0]
    found = spread(a, b - a @ value, run=run, group=_settings(speed, run))
    trends: tuple[Trend, ...] = ()
    scatter = found.covariance
    speeds_seen = np.unique(_settings(speed, None)).size
    if p == 1 and speeds_seen == 1:
        notes.append(f"{channel}: one speed only, so whether the coefficient changes with speed is not seen")
    elif p == 1 and load.size >= 5:
        trend = fit_trend(channel, symbols[0], speed[:, 0], unit[:, 0], load, expected, run)
        trends = (trend,)
        if trend.significant and at_speed is not None:
            value = np.array([float(trend.value_at(at_speed))])
            scatter, found = np.array([[float(trend.std_at(at_speed)) ** 2]]), trend.spread
        elif trend.significant:
            # One number for all speeds: its interval has to hold the coefficient's change with speed.
            over = a[:, 0] ** 2 / float(a[:, 0] @ a[:, 0])
            away = float(over @ (trend.value_at(speed[:, 0]) - value[0]) ** 2)
            scatter = np.array([[float(trend.std_at(trend.reference_rad_s)) ** 2 + away]])
            found = replace(trend.spread, scale=found.scale)
    if found.pattern != "white":
        notes.append(f"{channel}: {found.in_words()}")
    gain = np.linalg.lstsq(a, loads.by_systematic[channel][measured] / expected[:, None], rcond=None)[0]
    shared = gain @ loads.systematic @ gain.T
    shared = shared + np.outer(value, value) * (common[0] ** 2 + (power * common[1]) ** 2)
    covariance = scatter + shared
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(np.diag(covariance) > 0, np.diag(shared) / np.diag(covariance), 0.0)
    return CoefficientFit(
        channel, symbols, value, covariance, share, speed, unit, load, expected * found.scale, found, trends
    )


def _expected(unit: Array, load: Array) -> tuple[Array, str]:
    """Return the likeliest shape of errors (n,), not yet scaled, and what it is in words."""
    best, shape, least = np.empty(0), _SHAPES[0], math.inf
    n = load.size
    for reading, full_scale in _SHAPES:
        fitted = np.abs(unit @ np.linalg.lstsq(unit, load, rcond=None)[0])
        std = 0.01 * np.hypot(reading * fitted, full_scale * np.max(np.abs(load)))
        r = (
            load / std
            - (unit / std[:, None]) @ np.linalg.lstsq(unit / std[:, None], load / std, rcond=None)[0]
        )
        minus_log = n * np.log(max(float(r @ r), 1e-300)) + 2 * float(np.sum(np.log(std)))
        minus_log -= _CLEARLY if (reading, full_scale) == _SHAPES[0] else 0.0
        if minus_log < least:
            best, shape, least = std, (reading, full_scale), minus_log
    parts = zip(shape, ("the reading", "full scale"), strict=True)
    return best, " and ".join(f"{v:g} % of {what}" for v, what in parts if v)


def _settings(speed: Array, run: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Number the settings: lines at one speed (within 0.2 %) in one run are repeats."""
    key = np.round(np.log(np.abs(speed)) / 0.002)
    whole = np.column_stack([key, np.zeros(len(key)) if run is None else run])
    return np.unique(whole, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _unseen(fit: CoefficientFit) -> tuple[str, ...]:
    if not np.all(np.isfinite(fit.covariance)):
        return (
            f"{' and '.join(fit.symbols)}: both rotors turn at one ratio of speeds, so only a weighted sum is seen",
        )
    return unseen_combinations(fit.symbols, fit.covariance / np.outer(fit.value, fit.value))
