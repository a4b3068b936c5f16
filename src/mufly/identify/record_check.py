"""Faults of a record that a fit would turn into wrong parameters: degrees, other units, nothing that moves."""

from __future__ import annotations

import numpy as np

from mufly.errors import InputError
from mufly.identify.record import INPUTS, Record, filled

__all__ = ["check_record"]


def check_record(r: Record) -> tuple[str, ...]:
    """Look for faults that a fit would turn into wrong parameters.

    Returns
    -------
    tuple of str
        Warnings: what can still be fitted, but not as it might seem.

    Raises
    ------
    InputError
        For degrees labelled radians, inputs out of range, a record in which no input moves.
    """
    warnings: list[str] = []
    for angle, rate in (("roll", "p"), ("pitch", "q"), ("yaw", "r")):
        _check_degrees(r, angle, rate)
    for k, name in enumerate(INPUTS):
        u = r.inputs[:, k]
        low = 0.0 if k < 2 else -1.0
        top = float(np.max(np.abs(u)))
        if top > 1.5 or float(np.min(u)) < low - 0.5:
            unit = (
                "per cent" if top <= 100 else "microseconds of a servo pulse" if top > 500 else "another unit"
            )
            raise InputError(
                r.name, name, f"reaches {u[np.argmax(np.abs(u))]:g}: it seems to be in {unit}",
                f"scale it to {low:g}..1",
            )  # fmt: skip
    still = [n for k, n in enumerate(INPUTS) if np.ptp(r.inputs[:, k]) < 1e-6]
    if len(still) == 4:
        raise InputError(r.name, "inputs", "none of them moves", "fly an excitation: `mufly identify plan`")
    warnings += [f"{r.name}: {n} is constant; nothing is learnt of what it drives" for n in still]
    for k, name in enumerate(r.outputs):
        y = r.measured[np.isfinite(r.measured[:, k]), k]
        if name != "voltage" and np.ptp(y) < 1e-9:
            warnings.append(f"{r.name}: {name} never changes; is that sensor connected?")
    return tuple(warnings)


def _check_degrees(r: Record, angle: str, rate: str) -> None:
    if angle not in r.outputs:
        return
    a = filled(r.measured[:, r.outputs.index(angle)])
    if rate in r.outputs:
        w = filled(r.measured[:, r.outputs.index(rate)])
        # Slope of the change of angle over 0.2 s against the integrated rate.
        lag = max(1, round(0.2 / r.sample_s))
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1])) * r.sample_s])
        x, y = turned[lag:] - turned[:-lag], a[lag:] - a[:-lag]
        x, y = x - x.mean(), y - y.mean()
        if x.std() > 0 and y.std() > 0 and float(x @ y) / (len(x) * x.std() * y.std()) > 0.6:
            slope = y.std() / x.std()
            if 30.0 < slope < 110.0:
                raise InputError(
                    r.name, angle, f"changes {slope:.0f} times as fast as {rate} says: it seems to be in degrees",
                    "say so in the column map (unit 'deg')",
                )  # fmt: skip
            if 1 / 110.0 < slope < 1 / 30.0:
                raise InputError(
                    r.name, rate, f"is {1 / slope:.0f} times the rate at which {angle} changes: it seems to be "
                    "in degrees a second", "say so in the column map (unit 'deg/s')",
                )  # fmt: skip
    limit = np.pi / 2 + 0.01 if angle == "pitch" else np.pi + 0.01
    if angle != "yaw" and float(np.max(np.abs(a))) > limit:
        raise InputError(
            r.name, angle, f"reaches {a[np.argmax(np.abs(a))]:.3g} rad: it seems to be in degrees",
            "say so in the column map (unit 'deg')",
        )  # fmt: skip
