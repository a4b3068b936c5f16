"""A flight record as a fit sees it: inputs, measured outputs and voltage on one even clock, checked before use.

Built from the labelled tables that :mod:`mufly.logs` reads (``motor_input``, ``servo_input``, ``measured_attitude``,
...). What cannot be right is refused in one line: time that does not rise, gaps, angles or rates that are degrees
labelled as radians (``d roll/dt = p`` gives them away), inputs beyond their range, inputs that never move. The noise
of a channel is first taken from its third differences, in which a motion slower than the sampling all but vanishes
while white noise of variance ``s^2`` shows with ``20 s^2`` (own derivation: 1 + 9 + 9 + 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from mufly.errors import InputError
from mufly.identify.simulate import OUTPUT_UNITS, OUTPUTS

__all__ = [
    "INPUTS",
    "Record",
    "dataset_of",
    "difference_noise",
    "filled",
    "record_from",
    "smoothed",
    "smoothed_motion",
    "split",
    "units_of",
]

_Array = NDArray[np.float64]

INPUTS = ("motor_upper", "motor_lower", "servo_1", "servo_2")
# variable of the recording -> (output, index in its last axis, sign)
_SOURCES = {
    "position": (("north", 0, 1.0), ("east", 1, 1.0), ("height", 2, -1.0)),
    "velocity": (("v_north", 0, 1.0), ("v_east", 1, 1.0), ("climb", 2, -1.0)),
    "attitude": (("roll", 0, 1.0), ("pitch", 1, 1.0), ("yaw", 2, 1.0)),
    "rates": (("p", 0, 1.0), ("q", 1, 1.0), ("r", 2, 1.0)),
    "rotor_speed": (("speed_up", 0, 1.0), ("speed_dw", 1, 1.0)),
}
_QUIET = {"height": 1e-3, "north": 1e-3, "east": 1e-3, "voltage": 1e-3}  # least noise that is believed, SI


@dataclass(frozen=True, eq=False)
class Record:
    """Inputs and measurements of one flight on an even clock.

    Attributes
    ----------
    name : str
    time_s : (n,) array
        Even steps (s).
    inputs : (n, 4) array
        Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1), each held to the next sample.
    outputs : tuple of str
        Of :data:`mufly.identify.simulate.OUTPUTS`.
    measured : (n, m) array
        SI; NaN where nothing was measured; yaw without jumps.
    voltage : (n,) array or None
        Terminal voltage of the battery (V), if recorded.
    """

    name: str
    time_s: _Array
    inputs: _Array
    outputs: tuple[str, ...]
    measured: _Array
    voltage: _Array | None = None

    @property
    def sample_s(self) -> float:
        """Time between samples (s)."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    def of(self, outputs: Sequence[str]) -> Record:
        """Return the record with some of its outputs only, in their order here."""
        kept = [k for k, name in enumerate(self.outputs) if name in outputs]
        return replace(
            self, outputs=tuple(self.outputs[k] for k in kept), measured=self.measured[:, kept]
        )  # fmt: skip


def record_from(data: xr.Dataset, name: str, *, prefix: str = "measured") -> Record:
    """Make a record of a recording.

    Parameters
    ----------
    data : xarray.Dataset
        With ``time``, ``motor_input``, ``servo_input`` and some of ``<prefix>_position``, ``_velocity``,
        ``_attitude``, ``_rates``, ``_rotor_speed``, and ``battery_voltage``.
    name : str
        What errors and reports call it.
    prefix : str
        ``"measured"``; ``"estimated"`` or ``"truth"`` of recordings that have these.

    Raises
    ------
    InputError
        If inputs or outputs are missing, or the clock cannot be.
    """
    for key in ("motor_input", "servo_input"):
        if key not in data:
            raise InputError(name, key, "is not in this log", "map a column to it (docs/logs.md)")
    time = np.asarray(data["time"].values, dtype=np.float64)
    inputs = np.hstack([np.asarray(data[k].values, np.float64) for k in ("motor_input", "servo_input")])
    names: list[str] = []
    columns: list[_Array] = []
    for suffix, parts in _SOURCES.items():
        variable = f"{prefix}_{suffix}"
        if variable not in data:
            continue
        values = np.asarray(data[variable].values, dtype=np.float64)
        for output, k, sign in parts:
            if np.isfinite(values[:, k]).sum() >= 10:
                names.append(output)
                columns.append(sign * values[:, k])
    voltage = np.asarray(data["battery_voltage"].values, np.float64) if "battery_voltage" in data else None
    if voltage is not None and np.isfinite(voltage).any():
        names.append("voltage")
        columns.append(voltage)
    else:
        voltage = None
    if not columns:
        raise InputError(
            name, f"{prefix}_attitude", "no measured output is in this log",
            f"map columns to {prefix}_attitude, {prefix}_rates or {prefix}_position (docs/logs.md)",
        )  # fmt: skip
    order = sorted(range(len(names)), key=lambda k: OUTPUTS.index(names[k]))
    record = Record(
        name,
        time,
        inputs,
        tuple(names[k] for k in order),
        np.column_stack([columns[k] for k in order]),
        voltage,
    )
    _check_clock(record)
    return _clean(record)


def dataset_of(r: Record) -> xr.Dataset:
    """Return a record as a recording, with the names that :func:`record_from` reads."""
    data: dict[str, tuple[tuple[str, ...], _Array, dict[str, str]]] = {}
    dims = {
        "position": "axis",
        "velocity": "axis",
        "attitude": "angle",
        "rates": "rate",
        "rotor_speed": "rotor",
    }
    labels = {"axis": ["N", "E", "D"], "angle": ["roll", "pitch", "yaw"], "rate": ["p", "q", "r"],
              "rotor": ["upper", "lower"], "servo": ["1", "2"]}  # fmt: skip
    for suffix, parts in _SOURCES.items():
        if not any(o in r.outputs for o, _, _ in parts):
            continue
        values = np.full((len(r.time_s), len(labels[dims[suffix]])), np.nan)
        for output, k, sign in parts:
            if output in r.outputs:
                values[:, k] = sign * r.measured[:, r.outputs.index(output)]
        unit = OUTPUT_UNITS[parts[0][0]]
        data[f"measured_{suffix}"] = (("time", dims[suffix]), values, {"units": unit})
    data["motor_input"] = (("time", "rotor"), r.inputs[:, :2], {"units": "1"})
    data["servo_input"] = (("time", "servo"), r.inputs[:, 2:], {"units": "1"})
    if r.voltage is not None:
        data["battery_voltage"] = (("time",), r.voltage, {"units": "V"})
    used = {d for dims_, _, _ in data.values() for d in dims_} - {"time"}
    coords: dict[str, object] = {d: labels[d] for d in used}
    coords["time"] = ("time", r.time_s, {"units": "s"})
    return xr.Dataset(data, coords=coords)


def _check_clock(r: Record) -> None:
    step = np.diff(r.time_s)
    if len(r.time_s) < 50:
        raise InputError(
            r.name, "time", f"has {len(r.time_s)} samples", "give a record of 50 samples or more"
        )
    if not np.all(np.isfinite(r.time_s)):
        raise InputError(r.name, "time", "holds NaN", "remove these rows")
    if np.any(step <= 0):
        k = int(np.argmax(step <= 0))
        raise InputError(
            r.name, "time", f"does not rise: {r.time_s[k]:g} s is followed by {r.time_s[k + 1]:g} s",
            "sort the rows or remove the repeated ones",
        )  # fmt: skip
    usual = float(np.median(step))
    if float(np.max(step)) > 3.0 * usual:
        k = int(np.argmax(step))
        raise InputError(
            r.name, "time", f"has a gap of {step[k]:.3g} s at {r.time_s[k]:g} s",
            "cut the log there and give the parts one by one",
        )  # fmt: skip
    if usual > 0.1:
        raise InputError(
            r.name, "time", f"is sampled every {usual:.3g} s", "give 10 samples a second or more"
        )


def _clean(r: Record) -> Record:
    """Put the record on an exactly even clock, hold the inputs over NaN, and make yaw continuous."""
    t = r.time_s
    even = np.linspace(t[0], t[-1], len(t))
    measured = r.measured.copy()
    step = (t[-1] - t[0]) / (len(t) - 1)
    if np.max(np.abs(t - even)) > 0.05 * step:
        for k in range(measured.shape[1]):
            good = np.isfinite(measured[:, k])
            near = np.interp(even, t[good], measured[good, k])
            hole = np.interp(even, t, (~good).astype(float)) > 0.0
            measured[:, k] = np.where(hole, np.nan, near)
    inputs = r.inputs.copy()
    held = np.clip(np.searchsorted(t, even + 1e-9 * step, side="right") - 1, 0, len(t) - 1)
    inputs = inputs[held]
    for k in range(4):
        good = np.isfinite(inputs[:, k])
        if not good.any():
            raise InputError(r.name, INPUTS[k], "holds no number", "map another column to it")
        last = np.maximum.accumulate(np.where(good, np.arange(len(t)), -1))
        inputs[:, k] = inputs[np.where(last >= 0, last, int(np.argmax(good))), k]
    if "yaw" in r.outputs:
        k = r.outputs.index("yaw")
        good = np.isfinite(measured[:, k])
        measured[good, k] = np.unwrap(measured[good, k])
    voltage = None
    if r.voltage is not None:
        good = np.isfinite(r.voltage)
        voltage = np.interp(even, t[good], r.voltage[good])
    return replace(r, time_s=even, inputs=inputs, measured=measured, voltage=voltage)


def difference_noise(r: Record) -> _Array:
    """Return the standard deviation of white noise on every output, from third differences, (m,)."""
    out = np.empty(len(r.outputs))
    for k, name in enumerate(r.outputs):
        y = r.measured[np.isfinite(r.measured[:, k]), k]
        d = np.diff(y, 3)
        # The median is not moved by a few outliers or steps; 1.4826 makes it the deviation of a normal law.
        out[k] = max(1.4826 * float(np.median(np.abs(d))) / np.sqrt(20.0), _QUIET.get(name, 2e-4))
    return out


def filled(y: _Array) -> _Array:
    """Return ``y`` (n,) with straight lines over its holes (NaN)."""
    good = np.isfinite(y)
    return np.interp(np.arange(len(y)), np.flatnonzero(good), y[good])


def smoothed(y: _Array, sample_s: float, span_s: float = 0.15, *, slope: bool = False) -> _Array:
    """Return local cubics through ``y`` (n,) over ``span_s`` (Savitzky and Golay), or their slopes (per second)."""
    n = len(y)
    width = min(max(5, round(span_s / sample_s) | 1), (n - 1) | 1)
    return np.asarray(savgol_filter(y, width, 3, deriv=int(slope), delta=sample_s), dtype=np.float64)


def smoothed_motion(r: Record) -> _Array:
    """Return position and velocity N, E, D, roll, pitch, yaw, p, q, r at every sample, (n, 12).

    From local cubics through the measurements (Savitzky and Golay) and their slopes; zero where nothing is known.
    """
    n, dt = len(r.time_s), r.sample_s
    motion = np.zeros((n, 12))

    def smooth(name: str, span_s: float, slope: bool = False) -> _Array | None:
        if name not in r.outputs:
            return None
        y = filled(r.measured[:, r.outputs.index(name)])
        return smoothed(y, dt, span_s, slope=slope)

    for k, (place, speed) in enumerate((("north", "v_north"), ("east", "v_east"), ("height", "climb"))):
        sign = -1.0 if place == "height" else 1.0
        position, velocity = smooth(place, 0.3), smooth(speed, 0.2)
        if position is not None:
            motion[:, k] = sign * position
        if velocity is None:
            velocity = smooth(place, 0.5, slope=True)
        if velocity is not None:
            motion[:, 3 + k] = sign * velocity
    for k, (angle, rate) in enumerate((("roll", "p"), ("pitch", "q"), ("yaw", "r"))):
        turned, turning = smooth(angle, 0.15), smooth(rate, 0.1)
        if turned is not None:
            motion[:, 6 + k] = turned
        if turning is None:
            turning = smooth(angle, 0.25, slope=True)
        if turning is not None:
            motion[:, 9 + k] = turning
    return motion


def split(r: Record, share: float) -> tuple[Record, Record]:
    """Cut a record in two; the second part holds the last ``share`` of it.

    Raises
    ------
    InputError
        If either part would be shorter than 50 samples.
    """
    n = len(r.time_s)
    cut = round((1.0 - share) * n)
    if cut < 50 or n - cut < 50:
        raise InputError(r.name, "", f"is too short to hold out {share:.0%} of it", "give a longer record")

    def part(a: int, b: int) -> Record:
        name = f"{r.name} ({r.time_s[a]:.4g} to {r.time_s[b - 1]:.4g} s)"
        voltage = None if r.voltage is None else r.voltage[a:b]
        return replace(
            r,
            name=name,
            time_s=r.time_s[a:b],
            inputs=r.inputs[a:b],
            measured=r.measured[a:b],
            voltage=voltage,
        )

    return part(0, cut), part(cut, n)


def units_of(outputs: Sequence[str]) -> tuple[str, ...]:
    """Return the units of outputs."""
    return tuple(OUTPUT_UNITS[o] for o in outputs)
