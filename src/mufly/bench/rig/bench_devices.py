"""Interface of bench devices, and the bench composed of them.

A driver is a class with the methods of :class:`Device`, one per file. It uses SI units: rad/s, A, V, K, Pa.
Uncalibrated load cells use the device's own unit, on channels that end in ``_raw``. Safety rules:

* No call blocks for longer than ``patience_s``.
* :meth:`Device.stop` may be called at any time and repeatedly, also before :meth:`Device.open`. It does not wait for
  missing answers.
* Invalid bytes are discarded and counted, never interpreted as a reading.

Channels: ``thrust_raw``, ``torque_raw``; ``speed_upper``, ``current_upper``, ``voltage_upper`` (mean voltage at the
motor), ``motor_temperature_upper`` and the same of ``lower``; ``vibration`` (m/s2); ``temperature`` (K),
``pressure`` (Pa), ``humidity`` (0 to 1).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.bench.bench_loads import CellCalibration
from mufly.bench.residual_covariance import CovarianceEstimate
from mufly.bench.series.series_plan import BladeMounting
from mufly.errors import MuflyError

Array = NDArray[np.float64]
Samples = Mapping[str, Sequence[float] | Array]
SampleCallback = Callable[[Samples], None]

MAX_STOP_TRIES = 3


class DeviceError(MuflyError):
    """Error of a device that is silent, sends invalid data, was reset or reports a fault."""


class StopError(MuflyError):
    """Error of a motor that did not acknowledge a stop command; its message tells the user to cut the power."""


class Device(Protocol):
    """Interface of a bench device.

    Attributes
    ----------
    name : str
        Name in messages, ``"EPOS upper (/dev/ttyUSB0)"``.
    channel_names : tuple of str
        Measured channels.
    driven_axes : tuple of str
        Driven axes, ``"upper"``, ``"lower"``; empty for a sensor.
    """

    @property
    def name(self) -> str: ...
    @property
    def channel_names(self) -> tuple[str, ...]: ...
    @property
    def driven_axes(self) -> tuple[str, ...]: ...

    def open(self) -> None:
        """Connect, or reconnect, and initialise the device at rest; raise DeviceError on failure."""

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        """Command a speed (rad/s); raise DeviceError unless the device acknowledges it."""

    def read_new_samples(self) -> Samples:
        """Return all samples since the last call; raise DeviceError after a long silence."""

    def stop(self) -> None:
        """Stop all axes at once; raise DeviceError if the device does not acknowledge it."""

    def close(self) -> None:
        """Stop and close the connection."""


class Clock:
    """Clock of a bench (s): wall time, or ``pace`` times as fast for an emulated bench."""

    def __init__(self, pace: float = 1.0) -> None:
        self.pace = pace
        self._wall_start_s, self._monotonic_start_s = time.time(), time.monotonic()

    def now(self) -> float:
        """Return the monotonic time (s), which ignores changes of the system clock; at pace 1, it counts from 1970."""
        return self._wall_start_s + self.pace * (time.monotonic() - self._monotonic_start_s)

    def sleep(self, seconds: float) -> None:
        """Wait for a number of seconds of this clock."""
        time.sleep(max(0.0, seconds) / self.pace)


@dataclass(frozen=True)
class BenchFacts:
    """Properties of a bench needed to interpret its readings; the first line of every record.

    Attributes
    ----------
    name : str
    calibration : dict
        Calibration of the cells, see :func:`calibration_to_dict`; empty for readings in N and N m.
    ranges : dict of str to (float, float)
        Smallest and largest reading of a channel; a sample at either end is saturated.
    nonlinearity : dict of str to float
        Largest deviation of a cell from linearity, as a share of ``full_scale`` (data sheet).
    full_scale : dict of str to float
        Full scale of a load (N, N m).
    pressure_std_Pa, temperature_std_K, humidity_std, speed_relative_std : float
        Standard uncertainties that do not average out (type B).
    torque_signs : dict of str to float
        Sign of an axis: +1 or -1 times the rotor's drag torque acts on the torque cell.
    manual : bool
        Whether blades are changed by hand.
    """

    name: str
    calibration: dict[str, Any] = field(default_factory=dict)
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)
    nonlinearity: dict[str, float] = field(default_factory=dict)
    full_scale: dict[str, float] = field(default_factory=dict)
    pressure_std_Pa: float = 100.0
    temperature_std_K: float = 0.3
    humidity_std: float = 0.03
    speed_relative_std: float = 1e-4
    torque_signs: dict[str, float] = field(default_factory=lambda: {"upper": 1.0, "lower": -1.0})
    manual: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Return the properties as a dictionary for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, tables: Mapping[str, Any]) -> BenchFacts:
        """Create the properties from the dictionary of :meth:`to_dict`."""
        known = dict(tables)
        known["ranges"] = {k: (float(a), float(b)) for k, (a, b) in known["ranges"].items()}
        return cls(**known)

    def cell_calibration(self) -> CellCalibration | None:
        """Return the calibration of the cells; None if the readings are loads."""
        c = self.calibration
        if not c:
            return None
        blank = CovarianceEstimate(np.zeros((0, 0)), 0.0, float(c["dof"]), "white", 0.0)
        return CellCalibration(
            tuple(c["channels"]), np.array(c["offset"]), np.array(c["sensitivity"]), np.array(c["covariance"]),
            (blank,) * len(c["channels"]), np.array(c["applied"]), c["source"], (),
        )  # fmt: skip


def calibration_to_dict(cells: CellCalibration) -> dict[str, Any]:
    """Return the calibration of load cells as a dictionary for JSON, for :attr:`BenchFacts.calibration`."""
    return {
        "channels": list(cells.channels), "offset": cells.offset.tolist(), "sensitivity": cells.sensitivity.tolist(),
        "covariance": cells.covariance.tolist(), "applied": cells.applied_load_range.tolist(), "source": cells.source,
        "dof": min(s.dof for s in cells.sensor_fit_covariances),
    }  # fmt: skip


class BenchRig(Protocol):
    """Interface of a bench for :func:`mufly.bench.series.series_runner.run_series`."""

    @property
    def facts(self) -> BenchFacts: ...
    @property
    def driven_axes(self) -> tuple[str, ...]: ...

    def now(self) -> float:
        """Return the time of the bench (s)."""

    def open(self) -> None:
        """Connect all devices, or reconnect them after a failure, and initialise them with the motors at rest."""

    def record_mounting(self, mounting: BladeMounting) -> None:
        """Record which blades are mounted."""

    def set_speeds(self, speeds_rad_s: Mapping[str, float]) -> None:
        """Command the speeds of axes (rad/s); axes that are not named stop."""

    def collect_samples(self, duration_s: float, watch: SampleCallback) -> dict[str, Array]:
        """Return the samples of ``duration_s``; ``watch`` is called with each batch and may raise an error."""

    def stop(self) -> None:
        """Stop all motors; raise StopError if a motor may still turn."""

    def close(self) -> None:
        """Stop and close all devices."""


class DeviceRig:
    """Bench composed of devices.

    Parameters
    ----------
    devices : sequence of Device
    facts : BenchFacts
    clock : Clock, optional
    poll_Hz : float
        Polling rate of the devices, in the time of the clock.
    """

    def __init__(
        self, devices: Sequence[Device], facts: BenchFacts, clock: Clock | None = None, poll_Hz: float = 20.0
    ) -> None:
        self.devices, self.facts = tuple(devices), facts
        self.clock = clock or Clock()
        self.driven_axes = tuple(a for d in devices for a in d.driven_axes)
        self._poll_interval_s = 1.0 / poll_Hz

    def now(self) -> float:
        return self.clock.now()

    def open(self) -> None:
        for d in self.devices:
            d.open()

    def record_mounting(self, mounting: BladeMounting) -> None:
        for d in self.devices:
            if (tell := getattr(d, "record_mounting", None)) is not None:
                tell(mounting)

    def set_speeds(self, speeds_rad_s: Mapping[str, float]) -> None:
        for d in self.devices:
            for axis in d.driven_axes:
                d.set_speed(axis, float(speeds_rad_s.get(axis, 0.0)))

    def collect_samples(self, duration_s: float, watch: SampleCallback) -> dict[str, Array]:
        for d in self.devices:
            watch(d.read_new_samples())  # older samples are not returned, but limits apply to them
        end = self.now() + duration_s
        got: dict[str, list[float]] = {}
        while True:
            began = self.now()
            part: dict[str, Sequence[float] | Array] = {}
            for d in self.devices:
                part.update(d.read_new_samples())
            watch(part)
            for name, values in part.items():
                got.setdefault(name, []).extend(float(v) for v in values)
            if self.now() >= end:
                return {name: np.array(values) for name, values in got.items()}
            self.clock.sleep(min(self._poll_interval_s - (self.now() - began), end - self.now()))

    def stop(self) -> None:
        left = [d for d in self.devices if d.driven_axes]
        reasons: dict[str, str] = {}
        interrupted: BaseException | None = None
        for _ in range(MAX_STOP_TRIES):
            failed = []
            for d in left:
                try:
                    d.stop()
                except BaseException as error:  # any error, also Ctrl-C: stopping the motors has priority
                    failed.append(d)
                    reasons[d.name] = str(error) or type(error).__name__
                    interrupted = error if not isinstance(error, Exception) else interrupted
            left = failed
            if not left:
                break
        if not left:
            if interrupted is not None:
                raise interrupted
            return
        names = "; ".join(f"{d.name}: {reasons[d.name]}" for d in left)
        raise StopError(f"CUT THE POWER: a motor may still turn ({names})")

    def close(self) -> None:
        try:
            self.stop()
        finally:
            for d in self.devices:
                try:
                    d.close()
                except Exception:  # a failed close must not prevent closing the next device
                    continue
