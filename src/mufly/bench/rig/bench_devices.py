"""What every device of a bench can do, and the bench that they make up.

A driver is a class with the calls of :class:`Device`, a file each. It speaks SI: rad/s, A, V, K, Pa; the readings of
cells that are still to be calibrated come in the device's own unit, on channels that end in ``_raw``. Rules that keep
a bench safe: no call blocks for longer than ``patience_s``; :meth:`Device.stop` may be called at any time, as often
as one likes, before :meth:`Device.open` too, and does not wait for answers that may not come; bytes that make no
sense are passed over and counted, never taken for a reading.

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

STOP_TRIES = 3


class DeviceError(MuflyError):
    """A device does not do what it should: it is silent, talks nonsense, was reset or reports a fault."""


class StopError(MuflyError):
    """A motor could not be told to stop. The message says so in capitals: somebody has to cut the power."""


class Device(Protocol):
    """A device of a bench.

    Attributes
    ----------
    name : str
        As messages call it, ``"EPOS upper (/dev/ttyUSB0)"``.
    channels : tuple of str
        What it reads.
    axes : tuple of str
        What it turns: ``"upper"``, ``"lower"``; empty for a sensor.
    """

    @property
    def name(self) -> str: ...
    @property
    def channels(self) -> tuple[str, ...]: ...
    @property
    def axes(self) -> tuple[str, ...]: ...

    def open(self) -> None:
        """Connect and make ready, at rest; raises DeviceError. Also mends a connection that broke."""

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        """Command a speed; raises DeviceError unless the device has taken it."""

    def read(self) -> Samples:
        """Return all samples since the last call; raises DeviceError if there have been none for too long."""

    def stop(self) -> None:
        """Stop whatever turns, now; raises DeviceError if that cannot be known to have been heard."""

    def close(self) -> None:
        """Stop, and give the connection back."""


class Clock:
    """The time of a bench, in seconds: the day's, or ``pace`` times as fast for a bench that is emulated."""

    def __init__(self, pace: float = 1.0) -> None:
        self.pace = pace
        self._wall_start_s, self._monotonic_start_s = time.time(), time.monotonic()

    def now(self) -> float:
        """Return the time (s); since 1970 at pace 1, as it runs on evenly whatever is done to the system's clock."""
        return self._wall_start_s + self.pace * (time.monotonic() - self._monotonic_start_s)

    def sleep(self, seconds: float) -> None:
        """Wait."""
        time.sleep(max(0.0, seconds) / self.pace)


@dataclass(frozen=True)
class BenchFacts:
    """What has to be known of a bench to make sense of its readings; the first line of every record.

    Attributes
    ----------
    name : str
    calibration : dict
        Of the cells: see :func:`calibration_to_dict`; empty where readings are in N and N m already.
    ranges : dict of str to (float, float)
        Least and greatest reading of a channel; a sample at either end is saturated.
    nonlinearity : dict of str to float
        Of a cell: greatest departure from its straight line, as a share of ``full_scale`` (data sheet).
    full_scale : dict of str to float
        Of a load (N, N m).
    pressure_std_Pa, temperature_std_K, humidity_std, speed_relative_std : float
        Standard uncertainties of what is not averaged out (type B).
    torque_signs : dict of str to float
        +1 or -1: what a rotor's drag torque on this axis adds to the torque cell.
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
        """Return them as JSON takes them."""
        return asdict(self)

    @classmethod
    def from_dict(cls, tables: Mapping[str, Any]) -> BenchFacts:
        """Return what :meth:`to_dict` gave."""
        known = dict(tables)
        known["ranges"] = {k: (float(a), float(b)) for k, (a, b) in known["ranges"].items()}
        return cls(**known)

    def cell_calibration(self) -> CellCalibration | None:
        """Return the calibration of the cells, None where readings are loads already."""
        c = self.calibration
        if not c:
            return None
        blank = CovarianceEstimate(np.zeros((0, 0)), 0.0, float(c["dof"]), "white", 0.0)
        return CellCalibration(
            tuple(c["channels"]), np.array(c["offset"]), np.array(c["sensitivity"]), np.array(c["covariance"]),
            (blank,) * len(c["channels"]), np.array(c["applied"]), c["source"], (),
        )  # fmt: skip


def calibration_to_dict(cells: CellCalibration) -> dict[str, Any]:
    """Return what :attr:`BenchFacts.calibration_noise_V` holds of load cells."""
    return {
        "channels": list(cells.channels), "offset": cells.offset.tolist(), "sensitivity": cells.sensitivity.tolist(),
        "covariance": cells.covariance.tolist(), "applied": cells.applied.tolist(), "source": cells.source,
        "dof": min(s.dof for s in cells.spreads),
    }  # fmt: skip


class BenchRig(Protocol):
    """A bench: what :func:`mufly.bench.series.series_runner.run_series` needs of it."""

    @property
    def facts(self) -> BenchFacts: ...
    @property
    def axes(self) -> tuple[str, ...]: ...

    def now(self) -> float:
        """Return its time (s)."""

    def open(self) -> None:
        """Make every device ready, at rest; also after a failure."""

    def mount(self, mounting: BladeMounting) -> None:
        """Be told which blades are on."""

    def set_speeds(self, speeds_rad_s: Mapping[str, float]) -> None:
        """Command speeds; axes that are not named stop."""

    def collect_samples(self, duration_s: float, watch: SampleCallback) -> dict[str, Array]:
        """Return the samples of a time; ``watch`` sees them as they come and may raise."""

    def stop(self) -> None:
        """Stop everything; raises StopError if some motor may still turn."""

    def close(self) -> None:
        """Stop and let go."""


class DeviceRig:
    """A bench made of devices.

    Parameters
    ----------
    devices : sequence of Device
    facts : Facts
    clock : Clock, optional
    poll_Hz : float
        How often devices are asked, of the clock's seconds.
    """

    def __init__(
        self, devices: Sequence[Device], facts: BenchFacts, clock: Clock | None = None, poll_Hz: float = 20.0
    ) -> None:
        self.devices, self.facts = tuple(devices), facts
        self.clock = clock or Clock()
        self.axes = tuple(a for d in devices for a in d.axes)
        self._poll_interval_s = 1.0 / poll_Hz

    def now(self) -> float:
        return self.clock.now()

    def open(self) -> None:
        for d in self.devices:
            d.open()

    def mount(self, mounting: BladeMounting) -> None:
        for d in self.devices:
            if (tell := getattr(d, "mount", None)) is not None:
                tell(mounting)

    def set_speeds(self, speeds_rad_s: Mapping[str, float]) -> None:
        for d in self.devices:
            for axis in d.axes:
                d.set_speed(axis, float(speeds_rad_s.get(axis, 0.0)))

    def collect_samples(self, duration_s: float, watch: SampleCallback) -> dict[str, Array]:
        for d in self.devices:
            watch(d.read())  # what was said before is of another time, but a limit is a limit
        end = self.now() + duration_s
        got: dict[str, list[float]] = {}
        while True:
            began = self.now()
            part: dict[str, Sequence[float] | Array] = {}
            for d in self.devices:
                part.update(d.read())
            watch(part)
            for name, values in part.items():
                got.setdefault(name, []).extend(float(v) for v in values)
            if self.now() >= end:
                return {name: np.array(values) for name, values in got.items()}
            self.clock.sleep(min(self._poll_interval_s - (self.now() - began), end - self.now()))

    def stop(self) -> None:
        left = [d for d in self.devices if d.axes]
        reasons: dict[str, str] = {}
        interrupted: BaseException | None = None
        for _ in range(STOP_TRIES):
            failed = []
            for d in left:
                try:
                    d.stop()
                except BaseException as error:  # whatever it is, Ctrl-C too: the motors have to be stopped first
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
                except Exception:  # closing one must not keep the next from being closed
                    continue
