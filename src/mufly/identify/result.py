"""What a fit returns: estimates with intervals, what the data do not see, and how well every record is predicted.

Plain frozen data, made by the fits of this room (bench, flight, linear) and read by reports, files and commands.
Intervals are at 95 % and two-sided; ``covariance`` is that of the estimates in SI units, in the order of
``estimates``, already corrected for coloured residuals where the method does so (``docs/identification.md``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from operator import attrgetter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError
from mufly.results import result
from mufly.tables import validated
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]


@result
class Estimate:
    """One free parameter after a fit, in SI units.

    Attributes
    ----------
    symbol : str
        As ``mufly vehicle show`` prints it: ``"cT_dw"``.
    key : str
        Dotted key in the vehicle file, ``"rotors.lower.thrust_coefficient"``; ``""`` for what is in no vehicle file
        (a bias, an initial state).
    unit : str
        SI unit; ``"1"`` for none.
    start, value : float
        Before and after the fit.
    std : float
        Standard deviation; infinite if the data do not see the parameter.
    low, high : float
        95 % interval of the estimate.
    at_bound : bool
        The fit stopped at a bound, so that ``std`` and interval do not hold.
    """

    symbol: str
    key: str
    unit: str
    start: float
    value: float
    std: float
    low: float
    high: float
    at_bound: bool = False

    @classmethod
    def of(
        cls, symbol: str, key: str, unit: str, start: float | Vehicle | None, value: float, std: float, *,
        quantile: float, at_bound: bool = False,
    ) -> Estimate:  # fmt: skip
        """Return an estimate whose interval is ``quantile`` deviations to either side.

        ``start`` may be the vehicle that holds it under ``key``; NaN if there is none.
        """
        if not isinstance(start, float):
            start = float(attrgetter(key)(start)) if start is not None and key else math.nan
        return cls(
            symbol, key, unit, start, value, std, value - quantile * std, value + quantile * std, at_bound
        )


class Estimates:
    """What the results of all fits have: estimates that are found by their symbol."""

    estimates: tuple[Estimate, ...]

    def estimate(self, symbol: str) -> Estimate:
        """Return the estimate of a parameter by its symbol.

        Raises
        ------
        KeyError
            If the fit has no such parameter.
        """
        return {e.symbol: e for e in self.estimates}[symbol]


@result(eq=False)
class RecordFit:
    """One record beside what the fitted model predicts for it from its inputs alone.

    Attributes
    ----------
    name : str
        Name of the log, with its part if only a part was used.
    role : {"fit", "held out"}
        Whether the fit used it.
    time_s : (n,) array
        Rising (s).
    outputs : tuple of str
        Names of the ``m`` outputs: ``"p"``, ``"roll"``, ``"height"``, ...
    units : tuple of str
        Their SI units.
    measured, predicted : (n, m) array
        ``measured`` is NaN where nothing was measured.
    noise_std : (m,) array
        Standard deviation of the measurement noise (the noise floor).
    inputs : (n, k) array
        Held from each sample to the next.
    input_names : tuple of str
    """

    name: str
    role: Literal["fit", "held out"]
    time_s: _Array
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    measured: _Array
    predicted: _Array
    noise_std: _Array
    inputs: _Array
    input_names: tuple[str, ...]

    @property
    def residual(self) -> _Array:
        """Measured less predicted, (n, m); NaN where nothing was measured."""
        return self.measured - self.predicted

    def rms_over_noise(self) -> _Array:
        """Return root mean square of the residual of every output over its noise, (m,): 1 is the noise floor."""
        return np.sqrt(np.nanmean(self.residual**2, axis=0)) / self.noise_std


@result(eq=False)
class Fit(Estimates):
    """Result of a fit.

    Attributes
    ----------
    vehicle : str
        Name of the vehicle (or linear model) that was fitted.
    estimates : tuple of Estimate
        The ``n`` free parameters.
    covariance, correlation : (n, n) array
        Of the estimates, in their order, SI units.
    unseen : tuple of str
        Directions that the data do not determine, each in words; empty if all are seen.
    cost : float
        What was minimised, at the estimates.
    history : tuple of dict
        One row an iteration or generation: ``iteration``, ``cost`` and every symbol with its value.
    method : str
        In words.
    simulations : int
        Records simulated during the fit, counting every trial of the parameters.
    seconds : float
        Wall time.
    converged : bool
    message : str
        Why it stopped, and warnings, in words.
    records : tuple of RecordFit
        Used first, held-out ones after them.
    """

    vehicle: str
    estimates: tuple[Estimate, ...]
    covariance: _Array
    correlation: _Array
    unseen: tuple[str, ...]
    cost: float
    history: tuple[dict[str, Any], ...]
    method: str
    simulations: int
    seconds: float
    converged: bool
    message: str
    records: tuple[RecordFit, ...]

    def records_of(self, role: Literal["fit", "held out"]) -> tuple[RecordFit, ...]:
        """Return the records of one role."""
        return tuple(r for r in self.records if r.role == role)


# ----------------------------------------------------------------------------
# Estimates written into a vehicle, each with its provenance and its doubt.


def with_estimates(vehicle: Vehicle, estimates: Iterable[Estimate], note: str) -> Vehicle:
    """Return a vehicle with some parameters replaced by what a fit found.

    Parameters
    ----------
    vehicle : Vehicle
        To start from.
    estimates : iterable of Estimate
        Those without a key, and those that the data do not see, are passed over.
    note : str
        Where they come from; standard deviation and interval are added to it.

    Raises
    ------
    InputError
        If no estimate belongs into a vehicle file, or a value is impossible there.
    """
    tables = vehicle.model_dump()
    written = 0
    found = list(estimates)
    for e in found:
        if not e.key or not np.isfinite(e.value) or np.isinf(e.std):
            continue
        *path, last = e.key.split(".")
        table = tables
        for part in path:
            table = table[part]
        doubt = (
            "held at its bound" if e.at_bound else f"std {e.std:.2g}, 95 % from {e.low:.4g} to {e.high:.4g}"
        )
        table[last] = {**table[last], "value": e.value, "source": "identified", "note": f"{note}; {doubt}"}
        written += 1
    if not written:
        raise ArgumentError(
            "estimates",
            "",
            "nothing was found that belongs into a vehicle file",
            "see what is not seen above",
        )
    if any(e.key == "body.mass" for e in found):
        tables["mass_budget"] = None  # it no longer adds up
    return validated(Vehicle, tables, vehicle.name)
