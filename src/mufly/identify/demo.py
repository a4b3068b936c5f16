"""The demonstration: fly a known vehicle, forget half of what is known of it, identify it, and compare.

Twelve numbers are free: the eleven that act on flight and that benches do not give well (torque coefficients with the
stabiliser bar, inertias, linkages, the bar's following time), and the radio's delay. Each starts 50 % off, up or down
at random. Thrust coefficients and motor constants are taken from the benches, as the dissertation does (Table 5.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.identify.demo_flight import NOISE, RADIO_DELAY_S, demo_flights
from mufly.identify.fit import Method, Progress, fit_flights
from mufly.identify.free import choose_free
from mufly.identify.result import Fit, RecordFit
from mufly.vehicle import Vehicle, load_vehicle, parameters, replace

__all__ = ["DEMO_FREE", "Demo", "run_demo"]

DEMO_FREE = (
    "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Iyy", "l_up", "l_dw", "Tf_up", "delay",
)  # fmt: skip
_OFF = 0.5


@dataclass(frozen=True, eq=False)
class Demo:
    """A fit beside the truth.

    Attributes
    ----------
    seed : int
    truth : dict of str to float
        SI values by symbol.
    start : Vehicle
        What the fit started from.
    fit : Fit
    held_out_over_noise : float
        Root mean square of the held-out record's prediction error over the sensors' true noise, all outputs.
    """

    seed: int
    truth: dict[str, float]
    start: Vehicle
    fit: Fit
    held_out_over_noise: float

    def inside(self) -> dict[str, bool]:
        """Return, by symbol, whether the interval holds the truth."""
        return {e.symbol: e.low <= self.truth[e.symbol] <= e.high for e in self.fit.estimates}

    def as_dict(self) -> dict[str, Any]:
        """Return what ``mufly identify demo --json`` prints."""
        return {
            "seed": self.seed,
            "vehicle": self.fit.vehicle,
            "method": self.fit.method,
            "converged": self.fit.converged,
            "message": self.fit.message,
            "parameters": [
                {
                    "symbol": e.symbol, "unit": e.unit, "truth": self.truth[e.symbol], "start": e.start,
                    "estimate": e.value, "std": e.std, "interval": [e.low, e.high],
                    "inside": e.low <= self.truth[e.symbol] <= e.high,
                }
                for e in self.fit.estimates
            ],
            "unseen": list(self.fit.unseen),
            "held_out_error_over_noise_floor": self.held_out_over_noise,
            "cost": self.fit.cost,
            "simulations": self.fit.simulations,
            "seconds": self.fit.seconds,
        }  # fmt: skip


def run_demo(
    *,
    vehicle: str | Vehicle = "mufly-1.1",
    seed: int = 0,
    method: Method = "lm",
    on_progress: Callable[[Progress], None] | None = None,
) -> Demo:
    """Fly, identify, compare.

    Parameters
    ----------
    vehicle : str or Vehicle
        The truth.
    seed : int
        Of pilot, sensor noise and starts.
    method : {"lm", "cma"}
    on_progress : callable, optional
        As in :func:`mufly.identify.fit_flights`.
    """
    truth = load_vehicle(vehicle) if isinstance(vehicle, str) else vehicle
    flights, held_out = demo_flights(truth, seed=seed)
    rows = {r.symbol: r for r in parameters(truth)}
    true = {s: RADIO_DELAY_S if s == "delay" else float(rows[s].value) for s in DEMO_FREE}
    random = np.random.default_rng([seed, 1])
    factor = dict(
        zip(DEMO_FREE, np.where(random.random(len(DEMO_FREE)) < 0.5, 1 - _OFF, 1 + _OFF), strict=True)
    )
    values = {rows[s].key: true[s] * float(factor[s]) for s in DEMO_FREE if s != "delay"}
    start = replace(truth, values, source="estimated")
    free = choose_free(start, DEMO_FREE, flights[0].outputs, delay_s=true["delay"] * float(factor["delay"]))
    fit = fit_flights(
        start,
        free,
        flights,
        held_out=held_out,
        voltage="model",
        method=method,
        seed=seed,
        on_progress=on_progress,
    )
    return Demo(seed, true, start, fit, over_true_noise(fit.records[-1]))


def over_true_noise(record: RecordFit) -> float:
    """Return the root mean square prediction error over the true noise of the demonstration's sensors."""
    std: NDArray[np.float64] = np.array([NOISE[o] for o in record.outputs])
    return float(np.sqrt(np.nanmean((record.residual / std) ** 2)))
