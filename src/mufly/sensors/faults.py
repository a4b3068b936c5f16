"""Catalogue of sensor faults, each with a start, an amount and a duration.

    accelerometer.clip@20s            from 20 s on
    sonar.jump=0.3@15s+2s             0.3 m, from 15 s, for 2 s
    position.dropout@10s+5s

A fault changes the published reading, not the measurement. The exception is an accelerometer, which clips at its
element, before the filter. Readings keep the time stamps of a healthy sensor, except for faults of timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_quantity, parse_time_span
from mufly.quantities.sensor_table import READINGS, SENSORS
from mufly.sensors.imu import Imu
from mufly.sensors.readings import Reading, Sensor, Truth

FAULT_KINDS: Mapping[str, str] = {
    "freeze": "repeats the last value with new time stamps",
    "dropout": "publishes no readings",
    "jump": "adds the amount to each reading, from the start",
    "bias": "adds an offset that grows to the amount within 1 s",
    "drift": "adds an offset that grows by the amount each second",
    "clip": "limits readings to plus or minus the amount (accelerometer: before its low-pass filter)",
    "stuck": "replaces each reading by the amount",
    "outliers": "adds a random error of at most the amount to one reading in four",
    "late": "delays each reading by the amount (s)",
    "doubled": "sends each reading twice, the second time as a new reading",
    "insane": "replaces readings by NaN or values far out of range",
}
"""Kinds of fault and their descriptions."""


@dataclass(frozen=True)
class FaultTarget:
    """Target of a fault: sensor of the vehicle, name of its reading, and the default amount of each kind of fault."""

    sensor: str
    reading: str
    default_amounts: Mapping[str, float]

    @property
    def reading_unit(self) -> str:
        """Unit of the amount of a fault of this reading; the amount of a fault of the kind ``late`` is in s instead."""
        return READINGS[self.reading].unit


def _make_default_amounts(jump: float, drift: float, clip: float, stuck: float) -> dict[str, float]:
    return {
        "jump": jump, "bias": jump, "drift": drift, "clip": clip, "stuck": stuck, "outliers": 3 * jump, "late": 0.3
    }  # fmt: skip


FAULT_TARGETS: Mapping[str, FaultTarget] = {
    row.fault: FaultTarget(sensor, row.name, _make_default_amounts(*row.default_fault_amounts))
    for sensor, rows in SENSORS.items()
    for row in rows
    if row.fault
}
"""Fault targets by their names in the text of a fault, such as ``sonar``."""

_MAX_FAULT_START_S = 86400.0  # latest start of a fault: a day, longer than any battery lasts
_MAX_AMOUNT_FACTOR = 1000.0  # relative to the default amount of a kind, or of a jump

_FAULT_SYNTAX = "NAME.KIND=AMOUNT@STARTs+DURATIONs, as sonar.jump=0.3@15s+2s"


@dataclass(frozen=True)
class Fault:
    """A fault of one reading.

    Attributes
    ----------
    name, kind : str
        Keys of :data:`FAULT_TARGETS` and :data:`FAULT_KINDS`.
    start_s, stop_s : float
        Start and end of the fault (s).
    amount : float
        Size of the fault in the reading's unit; seconds for ``late``.
    """

    name: str
    kind: str
    start_s: float = 0.0
    stop_s: float = math.inf
    amount: float = math.nan

    def __post_init__(self) -> None:
        if self.name not in FAULT_TARGETS:
            raise ArgumentError("fault", self.name, "is not a sensor", suggest_name(self.name, FAULT_TARGETS))
        if self.kind not in FAULT_KINDS:
            raise ArgumentError("fault", self.kind, "is not a fault", suggest_name(self.kind, FAULT_KINDS))
        if not (0.0 <= self.start_s <= _MAX_FAULT_START_S and self.stop_s > self.start_s):
            span = f"{self.start_s:g} to {self.stop_s:g} s"
            raise ArgumentError("fault", str(self), f"{span} is not a time", f"write {_FAULT_SYNTAX}")
        if math.isnan(self.amount):
            object.__setattr__(self, "amount", FAULT_TARGETS[self.name].default_amounts.get(self.kind, 0.0))
        usual = FAULT_TARGETS[self.name].default_amounts
        most = _MAX_AMOUNT_FACTOR * max(usual.get(self.kind, 0.0), usual["jump"])
        if not abs(self.amount) <= most:
            unit = "s" if self.kind == "late" else FAULT_TARGETS[self.name].reading_unit
            raise ArgumentError(
                "fault", str(self), f"{self.amount:g} {unit} is larger than any error of a reading",
                f"give up to {most:g} {unit}",
            )  # fmt: skip

    @property
    def sensor_name(self) -> str:
        """Name of the sensor in the suite."""
        return FAULT_TARGETS[self.name].sensor

    def __str__(self) -> str:
        span = "" if math.isinf(self.stop_s) else f"+{self.stop_s - self.start_s:g}s"
        return f"{self.name}.{self.kind}@{self.start_s:g}s{span}"


def parse_fault(text: str) -> Fault:
    """Return the fault that a text such as ``"sonar.jump=0.3@15s+2s"`` describes.

    Amount, start and duration may be left out.

    Raises
    ------
    InputError
        If the text describes no fault.
    """
    what, _, when = text.partition("@")
    named, _, amount = what.partition("=")
    name, point, kind = (part.strip() for part in named.partition("."))
    if not (point and name and kind):
        raise ArgumentError("fault", text, "is none", f"write {_FAULT_SYNTAX}")
    if name not in FAULT_TARGETS:
        raise ArgumentError("fault", name, "is not a sensor", suggest_name(name, FAULT_TARGETS))
    unit = "s" if kind == "late" else FAULT_TARGETS[name].reading_unit
    try:
        size = parse_quantity("", amount, unit) if amount.strip() else math.nan
        return Fault(name, kind, *parse_time_span("", when), size)
    except ArgumentError:
        raise
    except InputError as error:
        raise ArgumentError("fault", text, error.problem, error.remedy) from None


class FaultySensor(Sensor):
    """Wrapper of a sensor that applies ``faults``, which may change in flight; readings without a fault are unchanged.

    ``is_altered`` says whether a fault was active at the last reading. A compiled loop that samples the sensor itself
    sets it to False.
    """

    def __init__(self, sensor: Sensor, faults: Sequence[Fault], rng: np.random.Generator) -> None:
        self.sensor, self.faults, self._rng = sensor, tuple(faults), rng
        self._imu = sensor if isinstance(sensor, Imu) else None
        self._clear_history()

    def error_free_readings(self, truth: Truth) -> Mapping[str, Any]:
        return self.sensor.error_free_readings(truth)

    def reset(self) -> None:
        self.sensor.reset()
        self._clear_history()

    def _clear_history(self) -> None:
        self._last_output: Mapping[str, Reading] = {}  # as last published
        self.is_altered = False
        self._last_input: dict[str, Reading] = {}  # as last received from the sensor
        self._delayed_readings: list[tuple[float, str, Reading]] = []

    def read(self, truth: Truth) -> Mapping[str, Reading]:
        t = truth.time_s
        active = [f for f in self.faults if f.start_s <= t < f.stop_s] if self.faults else ()
        if self._imu is not None:
            clips = [f.amount for f in active if f.name == "accelerometer" and f.kind == "clip"]
            self._imu.set_clipping_limit(min(clips) if clips else None)
        if not active:
            self.is_altered = False
            said = self._last_output = self.sensor.read(truth)
            return said
        self._last_output, self.is_altered = self.latest_readings, True
        said = dict(self.sensor.read(truth))
        for f in active:
            name = FAULT_TARGETS[f.name].reading
            if name in said:
                self._apply_fault(f, name, said, truth)
        self._last_output = {**self._last_output, **said}
        return said

    @property
    def latest_readings(self) -> Mapping[str, Reading]:
        own = None if self.is_altered else self.sensor.latest_readings
        return self._last_output if own is None else own

    def _apply_fault(self, f: Fault, name: str, said: dict[str, Reading], truth: Truth) -> None:
        """Replace the reading ``name`` in ``said`` by the faulty one; delete it if none was published."""
        t, r = truth.time_s, said[name]
        new = self._last_input.get(name) is not r
        self._last_input[name] = r
        last = self._last_output.get(name)
        if not new and last is not None and f.kind not in ("late", "doubled", "freeze"):
            said[name] = last  # no new reading: the last published one stays
            return
        value = np.asarray(r.value, dtype=np.float64)
        own = slice(READINGS[name].unit_component_count)  # the fault's unit does not hold for angles
        if f.kind == "freeze":
            said[name] = r if last is None else Reading(last.value, r.time_s, last.valid)
        elif f.kind == "dropout":
            if last is None:
                del said[name]
            else:
                said[name] = last
        elif f.kind == "late":
            if new:
                self._delayed_readings.append((t + f.amount, name, r))
            there = [x for x in self._delayed_readings if x[0] <= t + 1e-9 and x[1] == name]
            self._delayed_readings = [x for x in self._delayed_readings if x not in there]
            if there:
                said[name] = there[-1][2]
            elif last is None:
                del said[name]
            else:
                said[name] = last
        elif f.kind == "doubled":
            said[name] = r if new or last is None else Reading(last.value, t, last.valid)
        elif f.kind == "clip" and name == "acceleration":
            pass  # applied at the element
        else:
            said[name] = Reading(self._faulty_value(f, value, own, t), r.time_s, r.valid)

    def _faulty_value(self, f: Fault, value: np.ndarray, own: slice, t: float) -> np.ndarray | float:
        out = np.atleast_1d(value).copy()
        part = out[own]
        match f.kind:
            case "jump":
                part += f.amount
            case "bias":
                part += f.amount * min(1.0, t - f.start_s)
            case "drift":
                part += f.amount * (t - f.start_s)
            case "clip":
                np.clip(part, -f.amount, f.amount, out=part)
            case "stuck":
                part[:] = f.amount
            case "outliers":
                if self._rng.uniform() < 0.25:
                    part += f.amount * self._rng.uniform(-1.0, 1.0, part.shape)
            case "insane":
                part[:] = self._rng.choice([math.nan, math.inf, -math.inf, 1e30])
        return float(out[0]) if value.ndim == 0 else out
