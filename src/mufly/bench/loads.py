"""From readings to loads: zero taken off, gains and cross-talk undone, and what that leaves in doubt.

With sensitivities S and zeros z(t) (:mod:`mufly.bench.calibration`) the loads of a line are
``F = S^-1 (y - z(t))``. An error of a calibration or of a zero shifts many lines together, so it does not average out;
its effect is carried along as

    dF/dS_kl = -S^-1[:, k] F_l,      dF/dz_k = -S^-1[:, k],      z_k = basis(t) a_k

beside the covariance of all S, b and a. A channel in SI units that was never calibrated has S = 1; its zero is still
followed when there are readings at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.bench.calibration import Calibration, ZeroDrift, fit_drift
from mufly.bench.covariance import joined
from mufly.bench.table import SI_UNITS, BenchTable
from mufly.errors import ArgumentError
from mufly.results import result
from mufly.rotor import Air, Blading, Condition, System, hover_batch, solve

Array = NDArray[np.float64]

_FORCES = ("thrust", "torque")


@dataclass(frozen=True, eq=False)
class Loads:
    """Loads at the lines where something turned.

    Attributes
    ----------
    table : BenchTable
        These lines.
    values : dict of str to (n,) array
        Loads by channel (N, N m): ``"thrust"``, ``"torque_upper"``, ...
    by_systematic : dict of str to (n, s) array
        Derivatives of each by the common numbers (calibration, zeros).
    systematic : (s, s) array
        Their covariance.
    drifts : dict of str to ZeroDrift
        Zero of each channel, where it was read, in units of the reading.
    zeros : BenchTable
        The lines at rest.
    notes : tuple of str
    """

    table: BenchTable
    values: dict[str, Array]
    by_systematic: dict[str, Array]
    systematic: Array
    drifts: dict[str, ZeroDrift]
    zeros: BenchTable
    notes: tuple[str, ...]


def corrected_loads(table: BenchTable, calibration: Calibration | None = None) -> Loads:
    """Return the loads of a bench file.

    Parameters
    ----------
    table : BenchTable
        ``thrust``, ``torque`` (with ``_upper``, ``_lower``) in SI units, or ``_raw`` with a calibration; ``speed``
        (``speed_upper``, ``speed_lower``), zero in the lines at rest; optional ``time``.
    calibration : Calibration, optional

    Raises
    ------
    InputError
        If a raw channel has no calibration, or a calibration no raw channel.
    """
    speeds = [c for c in table.columns if c.split("_")[0] == "speed"]
    if not speeds:
        table.require(("speed",))
    table.require(speeds)
    at_rest = np.all([table[c] == 0.0 for c in speeds], axis=0)
    raw = [c.removesuffix("_raw") for c in table.columns if c.endswith("_raw") and c.split("_")[0] in _FORCES]
    known = calibration.channels if calibration is not None else ()
    for channel in raw:
        if channel not in known:
            remedy = f"give --calibration a file with {channel} and {channel}_raw"
            raise table.fault(f"{channel}_raw", "is a reading without a calibration", remedy)
    for channel in known:
        if channel not in raw:
            remedy = f"name the reading {channel}_raw_V, or map it with --columns"
            problem = "is not among the columns, but the calibration has it"
            raise table.fault(f"{channel}_raw", problem, remedy)
    direct = [
        c for c in table.columns if c.split("_")[0] in _FORCES and not c.endswith("_raw") and c not in raw
    ]
    if not raw and not direct:
        table.require(("thrust",))
    time = table["time"] if "time" in table else table.line.astype(np.float64)
    order = np.argsort(time, kind="stable")
    table, time, at_rest = table.ordered(order), time[order], at_rest[order]
    turning, notes, drifts = ~at_rest, list(table.notes), {}
    for channel in (*known, *direct):
        column = f"{channel}_raw" if channel in raw else channel
        rest = at_rest & np.isfinite(table[column])
        drift = fit_drift(time, table[column], rest)
        if drift is not None:
            drifts[channel] = drift
            notes.append(_drift_words(table, channel, drift, time[turning], raw=channel in raw))
    if not drifts:
        notes.append("no reading at zero speed: the zero of the load cells is taken on trust")
    running, t = table.where(turning), time[turning]
    values = {name: running[name] for name in direct}
    inverse, blocks = np.eye(len(direct)), []
    if calibration is not None:
        zero = [
            drifts[c].at(t) if c in drifts else np.full(t.size, b)
            for c, b in zip(known, calibration.offset, strict=True)
        ]
        loads = calibration.loads(
            np.column_stack([running[f"{c}_raw"] for c in known]), np.column_stack(zero)
        )
        values = dict(zip(known, loads.T, strict=True)) | values
        inverse = joined(np.linalg.inv(calibration.sensitivity), inverse)
        blocks = [calibration.covariance]
    k, start = len(known), sum(len(b) for b in blocks)
    blocks += [drifts[c].spread.covariance for c in values if c in drifts]
    systematic = joined(*blocks) if blocks else np.zeros((0, 0))
    by = {name: np.zeros((t.size, len(systematic))) for name in values}
    for j, name in enumerate(known):
        part = by[name][:, :start].reshape(t.size, k, k + 1)
        for i, sensor in enumerate(known):
            part[:, i, 0] = 0.0 if sensor in drifts else -inverse[j, i]
            part[:, i, 1:] = -inverse[j, i] * loads
        by[name][:, :start] = part.reshape(t.size, start)
    for i, sensor in enumerate(values):
        if sensor in drifts:
            d = drifts[sensor]
            if sensor in direct:
                values[sensor] = values[sensor] - d.at(t)
            for j, name in enumerate(values):
                by[name][:, start : start + d.coefficients.size] = -inverse[j, i] * d.basis(t)
            start += d.coefficients.size
    return Loads(running, values, by, systematic, drifts, table.where(at_rest), tuple(notes))


def _drift_words(table: BenchTable, channel: str, d: ZeroDrift, t: Array, *, raw: bool) -> str:
    unit = "units of the reading" if raw else SI_UNITS[channel.split("_")[0]]
    if d.blocks == 1:
        return f"{channel}: zero read once, {d.coefficients[0]:.4g} {unit}; that it stayed there is taken on trust"
    kind = ("constant", "a straight line", "a parabola", "a cubic")[d.coefficients.size - 1]
    doubt = f" +- {2 * float(np.max(d.std_at(t))):.2g}" if d.spread.scale > 0 and t.size else ""
    return (
        f"{channel}: zero read {d.blocks} times, followed as {kind}{doubt}, changes by {d.change:.3g} {unit}"
    )


def air_density(table: BenchTable, density_kg_m3: float | None) -> tuple[Array, str]:
    """Return the density of the air (n,) in kg/m3 and where it comes from.

    A column ``density`` goes first, then dry air's ``p / (287.05 T)`` from ``temperature`` and ``pressure`` (humid air
    is up to 1 % lighter), then the given number, then 1.2.
    """
    n = len(table)
    if density_kg_m3 is not None:
        return np.full(n, density_kg_m3), f"density {density_kg_m3:g} kg/m3 as given"
    if "density" in table:
        table.require(("density",))
        return table["density"], "density from the file"
    if "temperature" in table and "pressure" in table:
        table.require(("temperature", "pressure"))
        rho = table["pressure"] / (287.05 * (table["temperature"] + 273.15))
        return rho, f"density {rho.mean():.4g} kg/m3 from temperature and pressure (dry air)"
    return np.full(n, 1.2), "density 1.2 kg/m3 assumed: every coefficient is wrong by as much as it is"


@result(eq=False)
class Prediction:
    """Predicted loads at the measured points.

    Attributes
    ----------
    speed_rad_s, load : dict of str to (n,) array
        By channel; N or N m.
    error : dict of str to (n,) array
        Prediction over measurement less one.
    """

    speed_rad_s: dict[str, Array]
    load: dict[str, Array]
    error: dict[str, Array]

    def in_words(self) -> list[str]:
        """Return mean and mean absolute error of each channel."""
        return [
            f"{name}: prediction {100 * np.mean(e):+.1f} % from the measured on average, "
            f"{100 * np.mean(np.abs(e)):.1f} % in the mean of absolute errors ({e.size} points)"
            for name, e in self.error.items()
        ]


def predict(
    loads: Loads, blading: Blading, *, density_kg_m3: float, pitch_rad: float | None = None,
    spacing_m: float | None = None, progress: Callable[[int, int], None] | None = None,
) -> Prediction:  # fmt: skip
    """Predict the measured points.

    Parameters
    ----------
    loads : Loads
    blading : Blading
        The rotor; a pair has two of them.
    density_kg_m3 : float
        Of the air.
    pitch_rad : float, optional
        Pitch setting where the file does not say; default 0, the blades as in the rotor file.
    spacing_m : float, optional
        Between the discs of a pair.
    progress : callable, optional
        Called with points done and all points.

    Raises
    ------
    InputError
        For a pair without a spacing.
    """
    table = loads.table
    air = Air(density_kg_m3=density_kg_m3)
    pitch = (
        table["pitch"] if "pitch" in table else np.full(len(table), 0.0 if pitch_rad is None else pitch_rad)
    )
    values: dict[str, Array] = {}
    speeds: dict[str, Array] = {}
    if "speed_upper" in table and "speed_lower" in table:
        if spacing_m is None:
            raise ArgumentError(
                "spacing_m", "", "is missing for a coaxial pair", "give the distance between the discs in m"
            )
        system = System.coaxial(blading, blading, spacing_m=spacing_m)
        up, dw = table["speed_upper"], table["speed_lower"]
        found = np.full((len(table), 4), np.nan)
        both = np.flatnonzero((up > 0) & (dw > 0))
        for done, k in enumerate(both):
            u, d = solve(system, Condition(float(pitch[k]), (up[k], dw[k]), air=air)).rotors
            found[k] = u.thrust_N, u.torque_Nm, d.thrust_N, d.torque_Nm
            if progress is not None:
                progress(done + 1, both.size)
        values = dict(
            zip(("thrust_upper", "torque_upper", "thrust_lower", "torque_lower"), found.T, strict=True)
        )
        values["thrust"] = values["thrust_upper"] + values["thrust_lower"]
        speeds = {name: dw if name.endswith("lower") else up for name in values}
    else:
        table.require(("speed",))
        out = hover_batch(blading, pitch_rad=pitch, speed_rad_s=np.abs(table["speed"]), air=air)
        values = {"thrust": out.thrust_N, "torque": out.torque_Nm}
        speeds = dict.fromkeys(values, table["speed"])
    chosen = {
        name: np.isfinite(v) & np.isfinite(loads.values[name])
        for name, v in values.items()
        if name in loads.values
    }
    return Prediction(
        {name: np.abs(speeds[name][c]) for name, c in chosen.items()},
        {name: values[name][c] for name, c in chosen.items()},
        {name: values[name][c] / np.abs(loads.values[name][c]) - 1.0 for name, c in chosen.items()},
    )
