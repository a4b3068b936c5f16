"""Estimates written into a vehicle, each with its provenance and its doubt."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mufly.errors import InputError
from mufly.identify.result import Estimate
from mufly.tables import validated
from mufly.vehicle import Vehicle

__all__ = ["with_estimates"]


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
        raise InputError(
            "--write", "", "nothing was found that belongs into a vehicle file", "see what is not seen above"
        )
    if any(e.key == "body.mass" for e in found):
        tables["mass_budget"] = None  # it no longer adds up
    return validated(Vehicle, tables, vehicle.name)
