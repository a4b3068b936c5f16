"""Uniformly sampled records for identification: flight records and tables of named columns.

**Flight record: inputs, measured outputs and voltage on one uniform clock, checked before use.**

It is built from the labelled tables that :mod:`mufly.logs` reads (``motor_input``, ``servo_input``,
``measured_attitude``, ...). Time that does not increase and gaps raise an error.
:mod:`mufly.identify.record_consistency` checks the signals against each other. The first noise estimate of a channel
uses third differences. Motion that is slow against the sampling nearly vanishes in them, and white noise of variance
``s^2`` has ``20 s^2`` (own derivation: 1 + 9 + 9 + 1).

**Table for linear fits: named columns on a uniform clock, without gaps.**

It is read from CSV (names from the header), from MATLAB files (columns of an array are ``inr0, inr1``...) and from
every log that ``mufly.logs`` reads. A signal with axes becomes ``measured_rates.p``; ``p`` is sufficient if only one
signal has this ending. A column map, ``lat=inr0``, renames columns.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from mufly.errors import ArgumentError, InputError
from mufly.quantities.quantity_grammar import ColumnMapEntry, parse_column_map_lines
from mufly.quantities.quantity_table import QUANTITIES, find_quantity, make_labelled_dataset
from mufly.quantities.units import unit_conversion
from mufly.results import result

Array = NDArray[np.float64]

FLIGHT_INPUTS = ("motor_upper", "motor_lower", "servo_1", "servo_2")
# variable of the recording -> (output, index in its last axis, sign)
_OUTPUT_SOURCES = {
    "position": (("north", 0, 1.0), ("east", 1, 1.0), ("height", 2, -1.0)),
    "velocity": (("v_north", 0, 1.0), ("v_east", 1, 1.0), ("climb", 2, -1.0)),
    "attitude": (("roll", 0, 1.0), ("pitch", 1, 1.0), ("yaw", 2, 1.0)),
    "rates": (("p", 0, 1.0), ("q", 1, 1.0), ("r", 2, 1.0)),
    "rotor_speed": (("speed_up", 0, 1.0), ("speed_dw", 1, 1.0)),
}
# Outputs that show the excitation of a channel: rates, which are free of slow drift, or else their integrals.
CHANNEL_OUTPUTS = {
    "heave": ("height", "climb"),
    "yaw": ("r", "yaw"),
    "roll": ("p", "roll"),
    "pitch": ("q", "pitch"),
}
_QUANTITY_UNITS = {q.name: q.units for q in QUANTITIES}
OUTPUT_UNITS = {o: _QUANTITY_UNITS[f"measured_{name}"] for name, parts in _OUTPUT_SOURCES.items() for o, _, _ in parts}
OUTPUT_UNITS |= {"voltage": _QUANTITY_UNITS["battery_voltage"]}
FLIGHT_OUTPUTS = tuple(OUTPUT_UNITS)
(
    OUTPUT_NORTH, OUTPUT_EAST, OUTPUT_HEIGHT, OUTPUT_V_NORTH, OUTPUT_V_EAST, OUTPUT_CLIMB, OUTPUT_ROLL,
    OUTPUT_PITCH, OUTPUT_YAW, OUTPUT_P, OUTPUT_Q, OUTPUT_R, OUTPUT_SPEED_UPPER, OUTPUT_SPEED_LOWER, OUTPUT_VOLTAGE,
) = range(len(FLIGHT_OUTPUTS))  # fmt: skip
_MIN_NOISE_STD = {
    "height": 1e-3,
    "north": 1e-3,
    "east": 1e-3,
    "voltage": 1e-3,
}  # least accepted noise, SI
_MIN_PART_SAMPLES = 50  # of a part of a record


@result(eq=False)
class FlightRecord:
    """Inputs and measurements of one flight on a uniform clock.

    Attributes
    ----------
    name : str
    time_s : (n,) array
        Uniform time (s).
    inputs : (n, 4) array
        Upper motor, lower motor (0..1), servo 1, servo 2 (-1..1), constant between samples.
    output_names : tuple of str
        Names of the outputs, from :data:`FLIGHT_OUTPUTS`.
    measured : (n, m) array
        Outputs in SI units; NaN without a measurement; yaw unwrapped.
    voltage : (n,) array or None
        Terminal voltage of the battery (V), if recorded.
    """

    name: str
    time_s: Array
    inputs: Array
    output_names: tuple[str, ...]
    measured: Array
    voltage: Array | None = None

    @property
    def sample_s(self) -> float:
        """Time between samples (s)."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    def select_outputs(self, outputs: Sequence[str]) -> FlightRecord:
        """Return the record with the outputs named in ``outputs``, in the order of the record."""
        kept = [k for k, name in enumerate(self.output_names) if name in outputs]
        return replace(
            self, output_names=tuple(self.output_names[k] for k in kept), measured=self.measured[:, kept]
        )  # fmt: skip

    def slice_samples(self, start: int, stop: int) -> FlightRecord:
        """Return samples ``start`` to ``stop`` (excluded), with unchanged time."""
        voltage = None if self.voltage is None else self.voltage[start:stop]
        inputs, measured = self.inputs[start:stop], self.measured[start:stop]
        return replace(self, time_s=self.time_s[start:stop], inputs=inputs, measured=measured, voltage=voltage)

    def slice_time(self, from_s: float | None, to_s: float | None) -> FlightRecord:
        """Return the samples from ``from_s`` to ``to_s`` (s), both included; None sets no limit.

        Raises
        ------
        InputError
            If fewer than 50 samples remain.
        """
        if from_s is None and to_s is None:
            return self
        start = 0 if from_s is None else int((self.time_s < from_s).sum())
        stop = len(self.time_s) if to_s is None else int((self.time_s <= to_s).sum())
        if stop - start < _MIN_PART_SAMPLES:
            raise InputError(
                self.name, "time", f"holds {max(0, stop - start)} samples between these times",
                f"the record lasts from {self.time_s[0]:.4g} to {self.time_s[-1]:.4g} s",
            )  # fmt: skip
        return self.slice_samples(start, stop)

    def describe_stopped_motors(self) -> str:
        """Return when a motor is off, as a text; an empty text if that is in 1 % of the samples or fewer."""
        off = np.any(self.inputs[:, :2] <= 0.0, axis=1)
        if off.mean() <= 0.01:
            return ""
        running = self.time_s[~off]
        when = f"a motor is off in {off.mean():.0%} of the record"
        return f"{when}; both run from {running[0]:.4g} to {running[-1]:.4g} s" if len(running) else when


def make_flight_record(data: xr.Dataset, name: str, *, prefix: str = "measured") -> FlightRecord:
    """Convert a recording to a flight record.

    Parameters
    ----------
    data : xarray.Dataset
        Recording with ``time``, ``motor_input``, ``servo_input`` and some of ``<prefix>_position``, ``_velocity``,
        ``_attitude``, ``_rates``, ``_rotor_speed``, and ``battery_voltage``.
    name : str
        Name of the record in errors and reports.
    prefix : str
        ``"measured"``, ``"estimated"`` or ``"truth"``. Unmeasured position, velocity and attitude of a flight on
        sensors are replaced by the on-board estimates.

    Raises
    ------
    InputError
        If inputs or outputs are missing, or the time is invalid.
    """
    for key in ("motor_input", "servo_input"):
        if key not in data:
            raise InputError(name, key, "is not in this log", "map a column to it (docs/reference/logs.md)")
    time = np.asarray(data["time"].values, dtype=np.float64)
    inputs = np.hstack([np.asarray(data[k].values, np.float64) for k in ("motor_input", "servo_input")])
    columns: dict[str, Array] = {}  # in the order of OUTPUTS
    for suffix, parts in _OUTPUT_SOURCES.items():
        if f"{prefix}_{suffix}" in data:
            values = np.asarray(data[f"{prefix}_{suffix}"].values, dtype=np.float64)
            if prefix == "measured" and not np.isfinite(values).any() and "estimated_valid" in data:
                # A flight on its own sensors without this measurement uses the on-board estimate.
                believed = np.asarray(data[f"estimated_{suffix}"].values, dtype=np.float64)
                values = np.where(data["estimated_valid"].values[:, None] > 0.5, believed, np.nan)
            for output, k, sign in parts:
                if np.isfinite(values[:, k]).sum() >= 10:
                    columns[output] = sign * values[:, k]
    if "battery_voltage" in data and np.isfinite(data["battery_voltage"].values).any():
        columns["voltage"] = np.asarray(data["battery_voltage"].values, np.float64)
    if not columns:
        raise InputError(
            name, f"{prefix}_attitude", "no measured output is in this log",
            f"map columns to {prefix}_attitude, {prefix}_rates or {prefix}_position (docs/reference/logs.md)",
        )  # fmt: skip
    measured = np.column_stack(list(columns.values()))
    record = FlightRecord(name, time, inputs, tuple(columns), measured, columns.get("voltage"))
    _check_clock(record)
    return _clean_record(record)


def record_to_dataset(r: FlightRecord) -> xr.Dataset:
    """Return a record as a recording, with the names that :func:`make_flight_record` reads."""
    data: dict[str, Array] = {}
    for suffix, parts in _OUTPUT_SOURCES.items():
        if not any(o in r.output_names for o, _, _ in parts):
            continue
        data[f"measured_{suffix}"] = values = np.full((len(r.time_s), len(parts)), np.nan)
        for output, k, sign in parts:
            if output in r.output_names:
                values[:, k] = sign * r.measured[:, r.output_names.index(output)]
    data |= {"motor_input": r.inputs[:, :2], "servo_input": r.inputs[:, 2:]}
    if r.voltage is not None:
        data["battery_voltage"] = r.voltage
    return make_labelled_dataset(r.time_s, data)


def _check_clock(r: FlightRecord) -> None:
    step = np.diff(r.time_s)
    if len(r.time_s) < 50:
        raise InputError(r.name, "time", f"has {len(r.time_s)} samples", "give a record of 50 samples or more")
    if not np.all(np.isfinite(r.time_s)):
        raise InputError(r.name, "time", "contains NaN", "remove these rows")
    if np.any(step <= 0):
        k = int(np.argmax(step <= 0))
        raise InputError(
            r.name, "time", f"does not increase: {r.time_s[k]:g} s is followed by {r.time_s[k + 1]:g} s",
            "sort the rows or remove the repeated ones",
        )  # fmt: skip
    usual = float(np.median(step))
    if float(np.max(step)) > 3.0 * usual:
        k = int(np.argmax(step))
        raise InputError(
            r.name, "time", f"has a gap of {step[k]:.3g} s at {r.time_s[k]:g} s",
            "cut the log there and give the parts separately",
        )  # fmt: skip
    if usual > 0.1:
        raise InputError(r.name, "time", f"is sampled every {usual:.3g} s", "give 10 samples a second or more")


def _clean_record(r: FlightRecord) -> FlightRecord:
    """Resample the record to a uniform clock, hold the inputs over NaN, and unwrap yaw."""
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
            raise InputError(r.name, FLIGHT_INPUTS[k], "contains no number", "map another column to it")
        last = np.maximum.accumulate(np.where(good, np.arange(len(t)), -1))
        inputs[:, k] = inputs[np.where(last >= 0, last, int(np.argmax(good))), k]
    if "yaw" in r.output_names:
        k = r.output_names.index("yaw")
        good = np.isfinite(measured[:, k])
        measured[good, k] = np.unwrap(measured[good, k])
    voltage = None
    if r.voltage is not None:
        good = np.isfinite(r.voltage)
        voltage = np.interp(even, t[good], r.voltage[good])
    return replace(r, time_s=even, inputs=inputs, measured=measured, voltage=voltage)


def estimate_noise_from_differences(r: FlightRecord) -> Array:
    """Estimate the standard deviation of white noise on every output (m,) from third differences."""
    out = np.empty(len(r.output_names))
    for k, name in enumerate(r.output_names):
        y = r.measured[np.isfinite(r.measured[:, k]), k]
        d = np.diff(y, 3)
        # The median is robust against outliers and steps; 1.4826 converts it to a normal standard deviation.
        out[k] = max(1.4826 * float(np.median(np.abs(d))) / np.sqrt(20.0), _MIN_NOISE_STD.get(name, 2e-4))
    return out


def signal_over_noise(records: Sequence[FlightRecord]) -> dict[str, float]:
    """Return the ratio of smoothed motion to noise for every output, the largest of all records."""
    most: dict[str, float] = {}
    for r in records:
        for k, (name, noise) in enumerate(zip(r.output_names, estimate_noise_from_differences(r), strict=True)):
            y = smooth_signal(fill_gaps(r.measured[:, k]), r.sample_s, 0.25)
            most[name] = max(most.get(name, 0.0), float(np.std(y) / noise))
    return most


def fill_gaps(y: Array) -> Array:
    """Return ``y`` (n,) with gaps (NaN) filled by linear interpolation."""
    good = np.isfinite(y)
    return np.interp(np.arange(len(y)), np.flatnonzero(good), y[good])


def smooth_signal(y: Array, sample_s: float, span_s: float = 0.15, *, slope: bool = False) -> Array:
    """Return ``y`` (n,) smoothed by local cubics over ``span_s`` (Savitzky and Golay), or its slope (per second)."""
    n = len(y)
    width = min(max(5, round(span_s / sample_s) | 1), (n - 1) | 1)
    return np.asarray(savgol_filter(y, width, 3, deriv=int(slope), delta=sample_s), dtype=np.float64)


MOTION_POSITION, MOTION_VELOCITY, MOTION_EULER, MOTION_RATES = 0, 3, 6, 9
"""Indices in a row of motion: start of position N, E, D, of velocity N, E, D, of roll, pitch, yaw, and of p, q, r."""


def smooth_motion(r: FlightRecord) -> Array:
    """Return position and velocity N, E, D, roll, pitch, yaw, p, q, r at every sample, (n, 12), in SI units.

    They are local cubics through the measurements (Savitzky and Golay) and their slopes; zero without a measurement.
    """
    n, dt = len(r.time_s), r.sample_s
    motion = np.zeros((n, 12))

    def smooth_output(name: str, span_s: float, slope: bool = False) -> Array | None:
        if name not in r.output_names:
            return None
        y = fill_gaps(r.measured[:, r.output_names.index(name)])
        return smooth_signal(y, dt, span_s, slope=slope)

    # Columns of a value and of its rate, their names, and the smoothing spans of value, rate and slope (s).
    pairs = (
        (MOTION_POSITION, MOTION_VELOCITY, "north", "v_north", 0.3, 0.2, 0.5),
        (MOTION_POSITION + 1, MOTION_VELOCITY + 1, "east", "v_east", 0.3, 0.2, 0.5),
        (MOTION_POSITION + 2, MOTION_VELOCITY + 2, "height", "climb", 0.3, 0.2, 0.5),
        (MOTION_EULER, MOTION_RATES, "roll", "p", 0.15, 0.1, 0.25),
        (MOTION_EULER + 1, MOTION_RATES + 1, "pitch", "q", 0.15, 0.1, 0.25),
        (MOTION_EULER + 2, MOTION_RATES + 2, "yaw", "r", 0.15, 0.1, 0.25),
    )
    for at, at_rate, name, rate_name, span_s, rate_span_s, slope_span_s in pairs:
        sign = -1.0 if name == "height" else 1.0
        value, rate = smooth_output(name, span_s), smooth_output(rate_name, rate_span_s)
        if value is not None:
            motion[:, at] = sign * value
        if rate is None:
            rate = smooth_output(name, slope_span_s, slope=True)
        if rate is not None:
            motion[:, at_rate] = sign * rate
    return motion


def split_record(r: FlightRecord, share: float) -> tuple[FlightRecord, FlightRecord]:
    """Split a record into two parts; the second part is the last ``share`` of the record.

    Raises
    ------
    InputError
        If either part would be shorter than 50 samples.
    """
    n = len(r.time_s)
    cut = round((1.0 - share) * n)
    if cut < _MIN_PART_SAMPLES or n - cut < _MIN_PART_SAMPLES:
        raise InputError(r.name, "", f"is too short to hold out {share:.0%} of it", "give a longer record")

    def named_slice(a: int, b: int) -> FlightRecord:
        return replace(r.slice_samples(a, b), name=f"{r.name} ({r.time_s[a]:.4g} to {r.time_s[b - 1]:.4g} s)")

    return named_slice(0, cut), named_slice(cut, n)


def output_units(outputs: Sequence[str]) -> tuple[str, ...]:
    """Return the SI units of these outputs."""
    return tuple(OUTPUT_UNITS[o] for o in outputs)


_TIME_COLUMN_NAMES = ("time", "t", "time_s", "timestamp", "timestamp_s")
# Symbol of the kinematics -> ending of a signal's name in `mufly log`. Without a measurement the truth of a simulated
# flight is used, or else the on-board estimate.
_SIGNAL_OF_SYMBOL = {
    "p": "rates.p", "q": "rates.q", "r": "rates.r",
    "ax": "acceleration.x", "ay": "acceleration.y", "az": "acceleration.z",
    "phi": "attitude.roll", "theta": "attitude.pitch", "psi": "attitude.yaw",
    "v_north": "velocity.N", "v_east": "velocity.E", "v_down": "velocity.D",
    "north": "position.N", "east": "position.E", "down": "position.D",
}  # fmt: skip
_SIGNAL_SOURCES = ("measured", "truth", "estimated")


@dataclass(frozen=True, eq=False)
class UniformLogTable:
    """Table of columns on a uniform clock.

    Attributes
    ----------
    name : str
    time_s : (n,) array
        Time of the log (s), uniform to within 1 % of a sample or resampled.
    columns : dict of str to (n,) array
        Columns by name, in the units of the log.
    notes : tuple of str
        Notes on the changes made to the log.
    empty_columns : tuple of str
        Columns of the log without numbers.
    filled_counts : dict of str to int
        Number of missing samples of a column that were interpolated.
    """

    name: str
    time_s: Array
    columns: Mapping[str, Array]
    notes: tuple[str, ...] = ()
    empty_columns: tuple[str, ...] = ()
    filled_counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Sample time (s)."""
        return float((self.time_s[-1] - self.time_s[0]) / (len(self.time_s) - 1))

    def column_by_name(self, name: str, argument: str) -> Array:
        """Return the column with a full name, with a unique end of a name, or with a symbol (``ax``, ``phi``).

        Raises
        ------
        ArgumentError
            If no column or several columns match; the error names ``argument``.
        """
        return self.columns[self.full_column_name(name, argument)]

    def full_column_name(self, name: str, argument: str) -> str:
        """Return the full name of the column that :meth:`column_by_name` returns."""
        if name in self.columns:
            return name
        ends = [c for c in self.columns if c.endswith(f".{name}")]
        best = [c for c in ends if c.startswith("measured_")] or ends
        if len(best) == 1:
            return best[0]
        meant = [f"{source}_{_SIGNAL_OF_SYMBOL[name]}" for source in _SIGNAL_SOURCES if name in _SIGNAL_OF_SYMBOL]
        known = [c for c in meant if c in self.columns]
        if known:
            return known[0]
        shown = ", ".join(list(self.columns)[:24]) + (" ..." if len(self.columns) > 24 else "")
        missing = "contains no numbers" if name in self.empty_columns else "is not a column of this log"
        problem = "is in several columns" if best else missing
        remedy = f"write {name}=COLUMN with one of: {', '.join(best) or shown}"
        arrays = [c[:-1] for c in self.columns if c.endswith("0") and f"{c[:-1]}1" in self.columns]
        if arrays and not best:  # of a MATLAB file
            remedy += f"; {arrays[0]}0 is the first column of the array {arrays[0]}"
        raise ArgumentError(argument, name, problem, remedy)

    def stack_columns(self, wanted: Mapping[str, str], argument: str) -> Array:
        """Return an array (n, k) of columns or of their weighted sums, such as ``-q``, ``m1-m2`` or ``9.81*az``.

        Parameters
        ----------
        wanted : dict
            Name -> expression: column names with sign ``+`` or ``-``, and optional factor with ``*``.
        argument : str
            Name of the argument, for errors.

        Raises
        ------
        ArgumentError
            If ``wanted`` is empty, or a column is missing.
        """
        if not wanted:
            raise ArgumentError(argument, "", "is empty", "give names from the log, such as p,q")
        sums = [self._parse_terms(text or name, argument) for name, text in wanted.items()]
        zero = np.zeros(len(self.time_s))
        return np.column_stack([sum((f * self.columns[c] for f, c in terms), zero) for terms in sums])

    def column_notes(self, *wanted: Mapping[str, str]) -> list[str]:
        """Return the notes on the table, and notes on filled gaps of the columns that the expressions ``wanted``
        use.
        """
        used = [c for names in wanted for n, text in names.items() for _, c in self._parse_terms(text or n, "columns")]
        holes = [c for c in dict.fromkeys(used) if c in self.filled_counts]
        return [
            *self.notes,
            *(f"{self.filled_counts[c]} samples of {c} are missing and were bridged" for c in holes),
        ]

    def _parse_terms(self, text: str, argument: str) -> list[tuple[float, str]]:
        """Return factor and column of each term of a sum."""
        known = (*self.columns, *self.empty_columns)
        parts = [text] if text in known else re.findall(r"[+-]?[^+-]+(?:(?<=\de)[+-]\d+[^+-]*)?", text) or [text]
        terms = []
        for part in parts:
            size, times, name = part.lstrip("+-").partition("*")
            try:
                factor = float(size) if times else 1.0
            except ValueError:
                raise ArgumentError(argument, text, f"{size!r} is not a number", "write 9.81*COLUMN") from None
            column = self.full_column_name((name if times else size).strip(), argument)
            terms.append((-factor if part.startswith("-") else factor, column))
        return terms

    def slice_samples(self, start: int, stop: int) -> UniformLogTable:
        """Return samples ``start`` to ``stop`` (excluded)."""
        columns = {k: v[start:stop] for k, v in self.columns.items()}
        return replace(self, time_s=self.time_s[start:stop], columns=columns)

    def slice_time(self, from_s: float | None, to_s: float | None) -> UniformLogTable:
        """Return the samples from ``from_s`` to ``to_s`` (s), both included; None sets no limit."""
        if from_s is None and to_s is None:
            return self
        start = 0 if from_s is None else int((self.time_s < from_s).sum())
        stop = len(self.time_s) if to_s is None else int((self.time_s <= to_s).sum())
        return self.slice_samples(start, stop)


def read_columns(
    path: str | Path, *, columns: Mapping[str, str] | Sequence[str] = (), rate_hz: float | None = None
) -> UniformLogTable:
    """Read a log into a table with a uniform clock.

    Parameters
    ----------
    path : str or Path
    columns : sequence of str, or dict
        Column map, ``"lat=inr0"``, ``"time=1(ms)"`` (:func:`mufly.quantities.quantity_grammar.parse_column_map_lines`).
        Columns are numbered from 1 in a table without header, from 0 in an array of a MATLAB file (``inr0``).
    rate_hz : float, optional
        Sample rate of the table; by default the rate of the log.

    Raises
    ------
    InputError
        If the log cannot be read, its time does not increase, or it has too few samples.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(str(path), "", "no such file", "give a CSV, MATLAB or flight log")
    suffix = path.suffix.lower()
    notes: list[str] = []
    if suffix == ".mat":
        found = _name_columns(_read_matlab(path), {}, parse_column_map_lines(columns))
    elif suffix in (".csv", ".txt", ".tsv"):
        found = _read_csv(path, parse_column_map_lines(columns))
    else:
        found = _read_log_columns(path, columns, notes)
    return _resample_evenly(path.name, found, rate_hz, notes)


def _read_matlab(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(path)
    except (MatReadError, NotImplementedError, ValueError, OSError) as error:
        raise InputError(str(path), "", f"cannot be read ({error})", "save it as MATLAB 7 or CSV") from error
    arrays = {
        k: np.atleast_2d(np.asarray(v, dtype=np.float64))
        for k, v in content.items()
        if not k.startswith("__") and isinstance(v, np.ndarray) and v.dtype.kind in "fiu"
    }
    found: dict[str, Array] = {}
    for key, a in arrays.items():
        a = a.T if a.shape[0] == 1 else a
        found |= {key: a[:, 0]} if a.shape[1] == 1 else {f"{key}{j}": column for j, column in enumerate(a.T)}
    return found


def _read_csv(path: Path, lines: Sequence[ColumnMapEntry]) -> dict[str, Array]:
    from mufly.logs import read_raw_log
    from mufly.logs.column_map import TimeEntry

    clock = next((line for line in lines if line.name == "time"), None)
    entry = None if clock is None else TimeEntry(column=",".join(clock.columns), unit=clock.unit or None, rate_hz=None)
    table = read_raw_log(path, time=entry)["table"]
    fields = {k: v for k, v in table.fields.items() if v.dtype.kind in "fiu" and k.lower() not in _TIME_COLUMN_NAMES}
    return {"time": table.time} | _name_columns(fields, table.units, [line for line in lines if line is not clock])


def _name_columns(
    fields: Mapping[str, Array], units: Mapping[str, str], lines: Sequence[ColumnMapEntry]
) -> dict[str, Array]:
    """Return columns in SI units: mapped columns under their new names, all others under their own names."""
    mapped = {}
    for line in lines:
        quantity = find_quantity(line.name)
        labels = (quantity.component_labels if quantity is not None else ()) or range(1, len(line.columns) + 1)
        names = [line.name] if len(line.columns) == 1 else [f"{line.name}.{label}" for label in labels]
        if len(names) != len(line.columns):
            problem = f"has {len(line.columns)} columns"
            raise ArgumentError("columns", line.name, problem, f"give {len(names)}, or name one component: {names[0]}")
        for name, column, sign in zip(names, line.columns, line.signs, strict=True):
            if column not in fields:
                remedy = f"it has: {', '.join(fields)}"
                raise ArgumentError("columns", column, "is not a column of this log", remedy)
            mapped[name] = (column, sign, line.unit or units.get(column, ""))
    found = {}
    for name, (column, sign, unit) in (
        mapped | {k: (k, 1.0, units.get(k, "")) for k in fields if k not in mapped}
    ).items():
        _, factor, offset = unit_conversion(unit or "1")
        found[name] = sign * factor * fields[column].astype(np.float64) + offset
    return found


def _read_log_columns(path: Path, columns: Mapping[str, str] | Sequence[str], notes: list[str]) -> dict[str, Array]:
    from mufly.logs import LogWarning, numeric_channels, read_log

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)  # they go into the notes
        data = read_log(path, columns=columns or None)
    notes += [str(n) for n in data.attrs.get("notes", [])]
    return {
        "time": data["time"].values.astype(np.float64),
        **{c.name: c.values for c in numeric_channels(data)},
    }


def _resample_evenly(name: str, found: dict[str, Array], rate_hz: float | None, notes: list[str]) -> UniformLogTable:
    key = next((c for c in found if c.lower() in _TIME_COLUMN_NAMES), None)
    if key is None:
        raise InputError(
            name, "", "has no column of time", f"call it one of {', '.join(_TIME_COLUMN_NAMES)}, in seconds"
        )
    time = found.pop(key)
    if time.size < 20:
        raise InputError(name, key, f"has {time.size} samples", "give a record of at least 20")
    steps = np.diff(time)
    if not (steps > 0.0).all():
        at = int(np.flatnonzero(~(steps > 0.0))[0]) + 1
        raise InputError(name, key, f"does not increase at row {at + 1}", "sort the record, or cut it there")
    found = {k: v for k, v in found.items() if len(v) == len(time)}
    step = float(np.median(steps)) if rate_hz is None else 1.0 / rate_hz
    gaps = int((steps > 3.0 * np.median(steps)).sum())
    if gaps:
        notes.append(f"{gaps} gaps in time, the longest {steps.max():.3g} s, were bridged by straight lines")
    missing = {k: int((~np.isfinite(v)).sum()) for k, v in found.items()}
    even = rate_hz is None and bool((np.abs(steps - step) < 0.01 * step).all())
    t = time if even else np.arange(time[0], time[-1] + 0.5 * step, step)
    t = t[t <= time[-1] + 1e-9 * step]
    if not even:
        notes.append(f"resampled to {1.0 / step:.6g} Hz")
    columns, empty = {}, []
    for k, v in found.items():
        good = np.isfinite(v)
        if good.sum() < 2:
            empty.append(k)
            continue
        columns[k] = v if even and good.all() else np.interp(t, time[good], v[good])
    return UniformLogTable(name, t, columns, tuple(notes), tuple(empty), {k: missing[k] for k in columns if missing[k]})


def low_pass(signal: Array, dt: float, cut_hz: float) -> Array:
    """Low-pass columns (n, k) with zero phase; inputs and outputs filtered alike keep their linear relation.

    The filter is a fourth-order Butterworth filter, applied forwards and backwards.

    Raises
    ------
    InputError
        If the cut-off is not below the Nyquist frequency.
    """
    from scipy.signal import butter, sosfiltfilt

    if not 0.0 < cut_hz < 0.5 / dt:
        raise ArgumentError(
            "cut_hz", "", f"{cut_hz:g} Hz is not below the Nyquist frequency", f"give less than {0.5 / dt:g} Hz"
        )
    return np.asarray(sosfiltfilt(butter(4, cut_hz, fs=1.0 / dt, output="sos"), signal, axis=0))
