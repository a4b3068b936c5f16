"""The delays that a flight's record shows: from references to measurements, from attitude to rates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.logs.delay import Delay, body_rates_of_attitude, estimate_delay
from mufly.logs.resample import unwrap

__all__ = ["DelayReport", "check_delays"]

_Array = NDArray[np.float64]
_FEWEST = 30


@dataclass(frozen=True)
class DelayReport:
    """The delay from one channel to another, by name."""

    reference: str
    response: str
    delay: Delay

    def words(self) -> str:
        """In one line."""
        return f"{self.response} after {self.reference}: {self.delay.words()}"


def check_delays(data: xr.Dataset, *, least_correlation: float = 0.3) -> list[DelayReport]:
    """Estimate the delays that a flight's record can show.

    From references to measurements, component by component, and from the derivative of the measured attitude to the
    measured body rates: these two are one motion, so a delay there is one of the instrument or the logger.

    Parameters
    ----------
    data : xarray.Dataset
        On an even clock.
    least_correlation : float
        Pairs that agree less, with the delay taken out, are left out.
    """
    time = data["time"].values
    if len(time) < _FEWEST:
        return []
    pairs: list[tuple[str, str, _Array, _Array, bool]] = []
    for kind in ("attitude", "rates", "velocity", "position"):
        wanted, seen = f"reference_{kind}", f"measured_{kind}"
        if wanted in data and seen in data and data[wanted].dims == data[seen].dims:
            for label in data[seen][str(data[seen].dims[1])].values.tolist():
                place = f".{label}"
                a = data[wanted].loc[:, label].values
                b = data[seen].loc[:, label].values
                if kind == "attitude":
                    a, b = unwrap(a), unwrap(b)
                pairs.append((wanted + place, seen + place, a, b, True))
    if "measured_attitude" in data and "measured_rates" in data:
        implied = body_rates_of_attitude(time, unwrap(data["measured_attitude"].values))
        for k, label in enumerate("pqr"):
            name = f"d(measured_attitude)/dt, {label}"
            rate = data["measured_rates"].values[:, k]
            pairs.append((name, f"measured_rates.{label}", implied[:, k], rate, False))
    out = []
    for reference, response, x, y, causal in pairs:
        try:
            found = estimate_delay(time, x.astype(np.float64), y.astype(np.float64), causal=causal)
        except InputError:  # constant, or too short: nothing to say
            continue
        if abs(found.correlation) >= least_correlation and not found.at_limit:
            out.append(DelayReport(reference, response, found))
    return out
