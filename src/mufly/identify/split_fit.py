"""Heave and yaw first, then roll and pitch (thesis Sec. 5.3.3): two small fits instead of one.

Each sees its own outputs and parameters, and takes the other half of the motion to be absent. Roll and pitch start
from the vehicle that heave and yaw made, because thrusts and their shares come from there; so does the delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mufly.errors import InputError
from mufly.identify.fit import fit_flights
from mufly.identify.free import HEAVE_YAW, ROLL_PITCH, Free
from mufly.identify.problem import PART_OUTPUTS
from mufly.identify.record import Record
from mufly.identify.result import Fit
from mufly.identify.written import with_estimates
from mufly.vehicle import Vehicle

__all__ = ["combined", "fit_split"]


def _part_of(f: Free) -> str:
    if f.symbol.startswith("bias_"):
        return "heave-yaw" if f.symbol[5:] in PART_OUTPUTS["heave-yaw"] else "roll-pitch"
    if f.symbol in HEAVE_YAW or f.symbol == "delay":
        return "heave-yaw"
    if f.symbol in ROLL_PITCH:
        return "roll-pitch"
    raise InputError(
        "--free", f.symbol, "acts on heave and yaw and on roll and pitch", "fit with --part both"
    )


def fit_split(vehicle: Vehicle, free: Sequence[Free], records: Sequence[Record], **options: Any) -> Fit:
    """Fit heave and yaw, then roll and pitch; parameters and options are those of :func:`fit_flights`.

    Records without an input of the part moving, or without its outputs, are left out of it.

    Raises
    ------
    InputError
        If a parameter acts on both halves.
    """
    fits: list[Fit] = []
    checkpoint = options.pop("checkpoint", None)
    delay = options.pop("delay_s", 0.0)
    held_out = options.pop("held_out", ())
    for part, columns in (("heave-yaw", slice(0, 2)), ("roll-pitch", slice(2, 4))):
        own = [f for f in free if _part_of(f) == part]
        if not own:
            continue

        def shows(r: Record, part: str = part, columns: slice = columns) -> bool:
            moves = float(np.max(np.std(r.inputs[:, columns], axis=0))) > 0.01
            return moves and bool(set(r.outputs) & (set(PART_OUTPUTS[part]) - {"voltage"}))

        used = [r for r in records if shows(r)]
        if not used:
            raise InputError(
                "records", part, "no record moves these inputs", "fly them, or free other parameters"
            )
        fit = fit_flights(
            vehicle, own, used, part=part, delay_s=delay, held_out=[r for r in held_out if shows(r)],  # type: ignore[arg-type]
            checkpoint=None if checkpoint is None else checkpoint.with_name(f"{checkpoint.name}.{part}"), **options,
        )  # fmt: skip
        fits.append(fit)
        if any(e.key for e in fit.estimates):
            vehicle = with_estimates(vehicle, fit.estimates, "heave and yaw")
        delay = next((e.value for e in fit.estimates if e.symbol == "delay"), delay)
    return combined(fits)


def combined(fits: Sequence[Fit]) -> Fit:
    """Return several fits of different parameters as one; parameters of different fits count as independent."""
    if len(fits) == 1:
        return fits[0]
    size = [len(f.estimates) for f in fits]
    covariance, correlation = np.zeros((sum(size), sum(size))), np.eye(sum(size))
    at = 0
    history: list[dict[str, Any]] = []
    for f, n in zip(fits, size, strict=True):
        covariance[at : at + n, at : at + n] = f.covariance
        correlation[at : at + n, at : at + n] = f.correlation
        at += n
        history += [{**row, "iteration": len(history) + k + 1} for k, row in enumerate(f.history)]
    records = [r for f in fits for r in f.records]
    return replace(
        fits[0],
        estimates=tuple(e for f in fits for e in f.estimates),
        covariance=covariance,
        correlation=correlation,
        unseen=tuple(u for f in fits for u in f.unseen),
        cost=sum(f.cost for f in fits),
        history=tuple(history),
        method=" then ".join(f.method for f in fits),
        simulations=sum(f.simulations for f in fits),
        seconds=sum(f.seconds for f in fits),
        converged=all(f.converged for f in fits),
        message="; ".join(dict.fromkeys(f.message for f in fits)),
        records=tuple(sorted(records, key=lambda r: r.role != "fit")),
    )
