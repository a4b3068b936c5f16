"""What a fit of rotor coefficients returns, and what a single rotor and a pair say of each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from mufly.bench import Loads, Spread
from mufly.identify.result import Estimate
from mufly.identify.rotor_trend import Trend
from mufly.vehicle import Vehicle

__all__ = ["COEFFICIENTS", "SIDES", "CoefficientFit", "RotorFit", "estimates_of", "interference", "placed"]

Array = NDArray[np.float64]

SIDES = {"upper": "_up", "lower": "_dw", "": ""}
COEFFICIENTS = {"thrust": ("cT", "thrust_coefficient", 4), "torque": ("cQ", "torque_coefficient", 5)}


@dataclass(frozen=True, eq=False)
class CoefficientFit:
    """One fit: the loads of one channel on one or two rotors.

    Attributes
    ----------
    channel : str
        ``"thrust"``, ``"torque_lower"``, ...
    symbols : tuple of str
        ``cT``, ``cQ_up``, ...
    value : (p,) array
    covariance : (p, p) array
    systematic_share : (p,) array
        Part of each variance that calibration, zeros, density and radius make up.
    speed_rad_s : (n, p) array
    unit_load : (n, p) array
        q of the module docstring.
    load, expected : (n,) array
        Measured (N, N m) and standard deviation of its scatter.
    spread : Spread
    trends : tuple of Trend
        One for a fit of one rotor; empty otherwise.
    """

    channel: str
    symbols: tuple[str, ...]
    value: Array
    covariance: Array
    systematic_share: Array
    speed_rad_s: Array
    unit_load: Array
    load: Array
    expected: Array
    spread: Spread
    trends: tuple[Trend, ...]

    @property
    def residual(self) -> Array:
        """Measured less fitted, (n,)."""
        return self.load - self.unit_load @ self.value


@dataclass(frozen=True, eq=False)
class RotorFit:
    """Coefficients of the rotors of one bench file at one setting of the blades.

    Attributes
    ----------
    source : str
    coaxial : bool
    pitch_rad : float
        NaN if the file does not say.
    radius_m : float
    density_kg_m3 : (n,) array
    estimates : tuple of Estimate
        In the order of the fits.
    fits : tuple of CoefficientFit
    loads : Loads
    unseen, notes : tuple of str
    """

    source: str
    coaxial: bool
    pitch_rad: float
    radius_m: float
    density_kg_m3: Array
    estimates: tuple[Estimate, ...]
    fits: tuple[CoefficientFit, ...]
    loads: Loads
    unseen: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    def estimate(self, symbol: str) -> Estimate:
        """Return an estimate by its symbol; KeyError if there is none."""
        return {e.symbol: e for e in self.estimates}[symbol]

    def systematic_shares(self) -> dict[str, float]:
        """Return the part of each variance that calibration, zeros, density and radius make up."""
        return {s: float(v) for f in self.fits for s, v in zip(f.symbols, f.systematic_share, strict=True)}


def estimates_of(fit: CoefficientFit, vehicle: Vehicle | None) -> list[Estimate]:
    """Return the estimates of a fit, with start values of a vehicle."""
    out = []
    for k, symbol in enumerate(fit.symbols):
        side = {"up": "upper", "dw": "lower"}.get(symbol.partition("_")[2], "")
        _, name, _ = COEFFICIENTS["thrust" if symbol.startswith("cT") else "torque"]
        start = math.nan
        if vehicle is not None and side:
            start = float(getattr(getattr(vehicle.rotors, side), name))
        value, std = float(fit.value[k]), math.sqrt(fit.covariance[k, k])
        half = std * fit.spread.quantile
        out.append(
            Estimate(
                symbol,
                f"rotors.{side}.{name}" if side else "",
                "1",
                start,
                value,
                std,
                value - half,
                value + half,
            )
        )
    return out


def placed(fit: RotorFit, side: str, vehicle: Vehicle | None) -> RotorFit:
    """Return the fit of a single rotor as that of a vehicle's ``"upper"`` or ``"lower"`` rotor; a pair stays."""
    if fit.coaxial:
        return fit
    end = SIDES[side]
    fits = tuple(
        replace(
            f,
            symbols=tuple(s + end for s in f.symbols),
            trends=tuple(replace(t, symbol=t.symbol + end) for t in f.trends),
        )
        for f in fit.fits
    )
    return replace(fit, fits=fits, estimates=tuple(e for f in fits for e in estimates_of(f, vehicle)))


def interference(fits: Sequence[RotorFit]) -> list[str]:
    """Say what each rotor of a pair keeps of a single rotor's coefficients, where both were measured."""
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
            words.append(
                f"{e.symbol} of {pair.source} is {ratio:.3f} +- {doubt:.3f} of {alone.source}{changed}"
            )
    return words
