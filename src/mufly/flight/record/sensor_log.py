"""Log of a vehicle's sensor readings and the truth on a simulated flight.

The flight uses ideal sensors and logs the fitted ones in parallel. Readings therefore do not affect the flight, so that
seeds, faults and sensors can be compared on the same flight.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mufly.control import design_flight_controller
from mufly.flight.mission_flight import FlightProgress, fly_mission
from mufly.flight.simulated_flight import RANGE_RING_RATE_HZ
from mufly.mission import Mission
from mufly.quantities.quantity_table import DIMENSION_LABELS
from mufly.quantities.sensor_table import READINGS
from mufly.results import result
from mufly.results.result_figure import enable_notebook_display
from mufly.sensors import (
    Fault,
    Reading,
    Readings,
    SensorSet,
    Truth,
    make_fitted_sensors,
    make_ideal_sensors,
)
from mufly.vehicle import Vehicle

_Array = NDArray[np.float64]
_TRUTH_CAPACITY = 2000  # periods: readings may come late by ten seconds at 200 Hz


@result
class ReadingLog:
    """All readings of one name, in the order of arrival.

    Attributes
    ----------
    name : str
    arrival_s, measured_s : list of float
        Times of arrival and of measurement (s).
    value, true : list of arrays
        Reading, and true value at the time of measurement; NaN without a true value.
    valid : list of bool
    """

    name: str
    arrival_s: list[float] = field(default_factory=list)
    measured_s: list[float] = field(default_factory=list)
    value: list[_Array] = field(default_factory=list)
    true: list[_Array] = field(default_factory=list)
    valid: list[bool] = field(default_factory=list)

    def plot(self) -> Figure:
        """Draw the readings; returns a matplotlib figure."""
        return enable_notebook_display(draw_sensor_readings({self.name: self}))

    def component_labels(self) -> Sequence[str]:
        """Return the names of the reading's components, such as x, y, z."""
        known = DIMENSION_LABELS.get(READINGS[self.name].dim or "", ())
        return tuple(map(str, known)) or (
            [str(k) for k in range(self.value[0].size)] if self.value[0].size > 1 else [""]
        )


@result
class ReadingErrors:
    """Errors of one reading on a flight.

    Attributes
    ----------
    name : str
    count : int
        Number of readings.
    rate_Hz : float
        Rate of readings (Hz).
    delay_s : float
        Mean time from measurement to arrival (s).
    invalid_share : float
        Share (1) of readings marked invalid.
    mean, deviation, worst : float
        Error of the worst component of valid readings, in the unit of the reading.
    unit : str
    """

    name: str
    count: int
    rate_Hz: float
    delay_s: float
    invalid_share: float
    mean: float
    deviation: float
    worst: float
    unit: str


class _LoggingSensors(SensorSet):
    """Ideal sensors for a flight, which also sample and log the vehicle's fitted sensors."""

    def __init__(self, ideal: SensorSet, fitted: SensorSet) -> None:
        super().__init__(*ideal.sensors)
        self._fitted = fitted
        self.logs: dict[str, ReadingLog] = {}
        self._clear_history()

    def _clear_history(self) -> None:
        self._last: dict[str, Reading] = {}
        self._right: deque[tuple[float, dict[str, Any]]] = deque(maxlen=_TRUTH_CAPACITY)

    def read(self, truth: Truth) -> Readings:
        right: dict[str, Any] = {}
        said: dict[str, Reading] = {}
        for sensor in self._fitted.sensors:
            said |= sensor.read(truth)
            right |= sensor.error_free_readings(truth)
        self._right.append((truth.time_s, right))
        for name, r in said.items():
            if self._last.get(name) is not r:
                self._log_reading(name, r, truth.time_s)
        self._last = said
        return super().read(truth)

    def _log_reading(self, name: str, r: Reading, time_s: float) -> None:
        log = self.logs.setdefault(name, ReadingLog(name))
        value = np.atleast_1d(np.asarray(r.value, dtype=np.float64))
        then: dict[str, Any] = next((w for t, w in reversed(self._right) if abs(t - r.time_s) < 1e-6), {})
        log.arrival_s.append(time_s)
        log.measured_s.append(r.time_s)
        log.value.append(value)
        log.true.append(np.broadcast_to(np.asarray(then.get(name, np.nan), dtype=np.float64), value.shape))
        log.valid.append(r.valid)

    def reset(self) -> None:
        super().reset()
        self._fitted.reset()
        self.logs.clear()
        self._clear_history()


def fly_and_log_sensors(
    vehicle: Vehicle,
    mission: Mission,
    *,
    seed: int = 0,
    faults: Sequence[Fault] = (),
    wind: _Array | None = None,
    gust: float | None = None,
    on_progress: Callable[[FlightProgress], None] | None = None,
) -> dict[str, ReadingLog]:
    """Fly a mission on ideal sensors and return the readings of the vehicle's own sensors.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the table ``sensors``.
    mission : Mission
    seed : int
        Seed of the gusts and of all sensor errors.
    faults : sequence of Fault
    wind, gust, on_progress : optional
        See :func:`mufly.flight.fly_mission`.

    Returns
    -------
    dict
        :class:`ReadingLog` of each reading, by name.

    Raises
    ------
    InputError
        If the vehicle has no sensors, or lacks the sensor of a fault.
    """
    fitted = make_fitted_sensors(vehicle, mission.world, seed=seed, faults=faults)
    controller = design_flight_controller(vehicle)
    every = max(1, round(controller.rate_Hz / RANGE_RING_RATE_HZ))  # as without a listener: the same flight
    listener = _LoggingSensors(make_ideal_sensors(vehicle, mission.world, every), fitted)
    fly_mission(
        vehicle, mission, controller=controller, seed=seed, wind=wind, gust=gust, on_progress=on_progress,
        sensors=listener,
    )  # fmt: skip
    return listener.logs


def compute_reading_errors(log: ReadingLog) -> ReadingErrors:
    """Return the errors (measured less true values) of all readings of one name."""
    error = np.array(log.value) - np.array(log.true)
    turns = [k for k, label in enumerate(log.component_labels()) if label == "heading"]
    error[:, turns] = np.angle(np.exp(1j * error[:, turns]))
    good = np.array(log.valid) & np.isfinite(error).all(axis=1)
    span = log.arrival_s[-1] - log.arrival_s[0] if len(log.arrival_s) > 1 else np.nan
    e = error[good]
    spread = e.std(axis=0) if e.size else np.full(1, np.nan)
    worst = int(np.argmax(spread))
    some = e[:, worst] if e.size else np.full(1, np.nan)
    return ReadingErrors(
        name=log.name, count=len(log.arrival_s), rate_Hz=(len(log.arrival_s) - 1) / span,
        delay_s=float(np.mean(np.array(log.arrival_s) - np.array(log.measured_s))),
        invalid_share=1.0 - float(np.mean(log.valid)), mean=float(some.mean()), deviation=float(some.std()),
        worst=float(np.abs(some).max()), unit=READINGS[log.name].unit,
    )  # fmt: skip


def draw_sensor_readings(logs: Mapping[str, ReadingLog]) -> Figure:
    """Draw every reading over its measurement time, with the truth."""
    shown = [log for log in logs.values() if log.arrival_s]
    figure = Figure(figsize=(11.0, 2.0 * len(shown)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    for ax, log in zip(axes, shown, strict=True):
        t, order = np.array(log.measured_s), np.argsort(log.measured_s, kind="stable")
        value, true = np.array(log.value), np.array(log.true)
        bad = ~np.array(log.valid)
        for k, label in enumerate(log.component_labels()):
            line = ax.plot(t[order], value[order, k], ".", ms=2, label=label or None)[0]
            ax.plot(
                t[order],
                true[order, k],
                "-",
                lw=0.9,
                color="0.15" if value.shape[1] == 1 else line.get_color(),
            )
        if bad.any():
            for x in t[bad]:
                ax.axvline(x, color="0.8", lw=0.5, zorder=0)
        unit = READINGS[log.name].unit
        ax.set_ylabel(f"{log.name.replace('_', ' ')}\n({unit})" if unit not in ("", "1") else log.name)
        if any(log.component_labels()):
            ax.legend(loc="upper right", ncols=4, fontsize="x-small")
        ax.grid(alpha=0.3)
    axes[-1].set_xlabel("measurement time (s)")
    figure.suptitle("Readings (dots) and truth (lines); grey: not valid")
    return figure


def write_sensor_logs(logs: Mapping[str, ReadingLog], folder: Path) -> list[Path]:
    """Write a CSV for every reading: arrival time, measurement time, value, true value."""
    files = []
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs.values():
        labels = [f"_{label}" if label else "" for label in log.component_labels()]
        heads = ["arrival_s", "measured_s", "valid", *(f"said{x}" for x in labels), *(f"true{x}" for x in labels)]
        table = np.column_stack([log.arrival_s, log.measured_s, log.valid, np.array(log.value), np.array(log.true)])
        unit = READINGS[log.name].unit
        path = folder / f"{log.name}.csv"
        np.savetxt(path, table, "%.9g", ",", header=f"{log.name} in {unit}\n" + ",".join(heads), comments="# ")
        files.append(path)
    return files
