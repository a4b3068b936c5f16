"""The simulated vehicle that another program's autopilot flies: plant, wind, sensors, battery and recording.

One period at time ``t_k``::

    plant integrated from t_(k-1) to t_k under the inputs that act, and the wind
    truth(t_k) --> sensors --> readings --> the other autopilot --> inputs u_k
    a row of the recording: truth, readings, inputs

As in :mod:`mufly.flight.simulated_flight`, the inputs u_k act from t_(k+1): one period is the computing time of the
onboard processor. The autopilot never receives the truth; PX4 records it beside its estimate
(:mod:`mufly.bridges.px4.px4_messages`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.dynamics import DrydenWind, standing_state
from mufly.errors import InputError
from mufly.flight.controllers import Actuators
from mufly.flight.record.recorder import open_flight_recorder
from mufly.flight.record.sensor_recording import make_sensed_row_writer
from mufly.flight.simulated_flight import GUST_LENGTH_M, RANGE_RING_RATE_HZ
from mufly.flight.simulated_plant import SimulatedPlant
from mufly.logs.mcap import FlightEvent
from mufly.mission import Mission
from mufly.sensors import Fault, Readings, Truth, make_fitted_sensors, randomise_leg_lengths
from mufly.vehicle import Vehicle
from mufly.version import __version__

_Array = NDArray[np.float64]

ARMED_STATE, DISARMED_STATE = "armed", "disarmed"
"""States of a flight in the recording."""
_MIN_INPUTS = np.array([0.0, 0.0, -1.0, -1.0])
_NO_REFERENCE = (np.full(3, math.nan), np.full(3, math.nan), np.full(3, math.nan))


class AutopilotPlant:
    """Simulated vehicle with sensors, controlled by the inputs of another autopilot; it starts on the floor.

    Parameters
    ----------
    vehicle : Vehicle
        With a table ``[sensors]`` that has an inertial unit.
    mission : Mission
        Start, obstacles and wind; its waypoints have no effect.
    rate_Hz : float
        Rate of the autopilot's inertial readings (Hz).
    autopilot : str
        Name of the autopilot, for messages and the recording.
    wind : sequence of 3 floats, optional
        Steady wind N, E, D (m/s); default the mission's.
    gust : float, optional
        Standard deviation of the gusts (m/s); default the mission's.
    seed : int
        Seed of gusts and sensor errors.
    faults : sequence of Fault
    path : str or Path, optional
        MCAP file to record to.
    keep : bool
        Whether the rows stay in memory, for :meth:`to_dataset`.

    Attributes
    ----------
    truth : Truth
    readings : Readings
        Those of the present time.
    listeners : list of callables
        Called with each :class:`FlightEvent`.

    Raises
    ------
    InputError
        If the vehicle has no inertial unit, or lacks the sensor of a fault.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        mission: Mission,
        *,
        rate_Hz: float,
        autopilot: str,
        wind: Sequence[float] | None = None,
        gust: float | None = None,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        path: str | Path | None = None,
        keep: bool = False,
    ) -> None:
        if vehicle.sensors is None or vehicle.sensors.imu is None:
            raise InputError(
                vehicle.name, "sensors.imu", f"is missing, and {autopilot} needs an inertial unit",
                "add the table (docs/reference/sensors.md)",
            )  # fmt: skip
        self.vehicle, self.autopilot_name, self.period_s = vehicle, autopilot, 1.0 / rate_Hz
        steady = np.asarray(mission.wind.steady_m_s if wind is None else wind, dtype=np.float64)
        gust = mission.wind.gust_m_s if gust is None else gust
        unit = randomise_leg_lengths(vehicle, seed=seed)
        self._start = standing_state(unit, mission.start_m, math.radians(mission.start_heading_deg))
        air = DrydenWind(steady, gust, step_s=self.period_s, length_m=GUST_LENGTH_M, seed=seed)
        self.plant = SimulatedPlant(unit, mission.world, air, rate_Hz, self._start)
        self.sensors = make_fitted_sensors(vehicle, mission.world, seed=seed, faults=faults)
        self.recorder = open_flight_recorder(
            path,
            {
                "vehicle": vehicle.name, "mission": mission.name, "autopilot": autopilot, "seed": seed,
                "wind_m_s": steady.tolist(), "gust_m_s": gust, "rate_Hz": rate_Hz, "sensors": "fitted",
                "faults": [str(f) for f in faults], "version": __version__,
            },
            vehicle, mission, sensors=True, keep=keep,
        )  # fmt: skip
        self._write = make_sensed_row_writer(self.recorder)
        self._look_periods = max(1, round(rate_Hz / RANGE_RING_RATE_HZ))
        self._low_voltage, self._battery_was_low = float(vehicle.battery.low_voltage), False
        self._crash_told = ""
        self._warned: set[str] = set()
        self.listeners: list[Callable[[FlightEvent], None]] = []
        self.acting = self.sent = Actuators.make_zero_inputs()
        self.is_armed = self._has_flown = self._has_moved = False
        self.sensors.reset()
        self._read_and_record_sensors()

    @property
    def time_s(self) -> float:
        """Simulated time of the latest readings (s)."""
        return self.truth.time_s

    @property
    def height_m(self) -> float:
        """True height above the start's floor (m)."""
        return -float(self.truth.position[2])

    @property
    def has_been_armed(self) -> bool:
        """Whether the vehicle has been armed, and so may have moved, since it was last placed at the start."""
        return self._has_moved

    def advance_period(self, inputs: _Array, armed: bool) -> None:
        """Apply the autopilot's inputs and advance by one period.

        Parameters
        ----------
        inputs : (4,) array
            Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1). They are clipped; NaN counts as zero.
        armed : bool
            Whether the autopilot is armed; otherwise the motors are off.
        """
        clipped = np.clip(np.nan_to_num(np.asarray(inputs, dtype=np.float64), nan=0.0), _MIN_INPUTS, 1.0)
        if not armed:
            clipped[:2] = 0.0
        self.set_armed(armed)
        self.sent = Actuators(clipped[:2], clipped[2:])
        self.plant.advance_period(self.acting)
        self.acting = self.sent
        self._read_and_record_sensors()
        if self.plant.period_count % self._look_periods == 0:
            self._log_new_events()

    def set_armed(self, armed: bool) -> None:
        """Set whether the autopilot is armed, and log a change."""
        if armed != self.is_armed:
            self.is_armed = armed
            self._has_flown |= armed
            self._has_moved |= armed
            self.log_event(f"{self.autopilot_name} has {'armed' if armed else 'disarmed'}")

    def reset(self) -> None:
        """Return to the start with a full battery and motors off; clock, recording and sensors' errors continue."""
        self.set_armed(False)
        self.plant.reset(self._start)
        self.acting = self.sent = Actuators.make_zero_inputs()
        self._crash_told, self._battery_was_low, self._has_moved = "", False, False
        self._read_and_record_sensors()
        self.log_event("the vehicle is back at the start")

    def log_event(self, text: str, level: str = "info") -> None:
        """Append an event to the recording; ``level`` is "info", "warning" or "error"."""
        state = ARMED_STATE if self.is_armed else DISARMED_STATE
        event = FlightEvent(self.truth.time_s if hasattr(self, "truth") else 0.0, state, text, level)
        self.recorder.add_event(*event)
        for listener in self.listeners:
            listener(event)

    def warn_once(self, topic: str, text: str) -> None:
        """Append a warning, unless one of this topic was given since :meth:`allow_repeated_warnings`."""
        if topic not in self._warned:
            self._warned.add(topic)
            self.log_event(text, "warning")

    def has_warned(self, topic: str) -> bool:
        """Return whether a warning of this topic was given."""
        return topic in self._warned

    def allow_repeated_warnings(self) -> None:
        """Permit the warning of every topic again, for an autopilot that has restarted."""
        self._warned.clear()

    def warn_of_unseen_faults(self, is_seen: Callable[[str], bool], why: str) -> None:
        """Append a warning for each fault that has no effect, because the autopilot does not receive its sensor.

        Parameters
        ----------
        is_seen : callable
            Whether the autopilot receives the sensor of this name.
        why : str
            Why it does not, with the autopilot as subject.
        """
        for fault in self.sensors.all_faults:
            if not is_seen(fault.sensor_name):
                self.log_event(f"{fault}: {why}, so the fault has no effect", "warning")

    def to_dataset(self) -> xr.Dataset:
        """Return the rows of the recording as a dataset."""
        return self.recorder.to_dataset()

    def close(self) -> None:
        """Finish the recording; its outcome states whether the vehicle crashed."""
        if self.plant.crash_cause:
            self.recorder.set_outcome("failed", self.plant.crash_cause, mission_flown=self._has_flown)
        else:
            why = f"{self.autopilot_name} flew the vehicle" if self._has_flown else f"{self.autopilot_name} never armed"
            self.recorder.set_outcome("unfinished", why, mission_flown=self._has_flown)
        self.recorder.close()

    def __enter__(self) -> AutopilotPlant:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.recorder.__exit__(kind, error, trace)

    def _read_and_record_sensors(self) -> None:
        self.truth: Truth = self.plant.truth
        self.readings: Readings = self.sensors.read(self.truth)
        state = ARMED_STATE if self.is_armed else DISARMED_STATE
        self._write(self.truth, self.readings, None, self.acting, _NO_REFERENCE, state)

    def _log_new_events(self) -> None:
        self.plant.detect_collision()
        if self.plant.crash_cause and self.plant.crash_cause != self._crash_told:
            self._crash_told = self.plant.crash_cause
            self.log_event(self.plant.crash_cause, "error")
        if not self._battery_was_low and self.truth.battery_voltage_V < self._low_voltage:
            self._battery_was_low = True
            self.log_event(f"the battery is low: {self.truth.battery_voltage_V:.2f} V", "warning")


def warm_up_plant(vehicle: Vehicle, rate_Hz: float) -> None:
    """Simulate a few periods, so that everything is compiled before an autopilot calls."""
    with AutopilotPlant(vehicle, Mission(name="warm-up"), rate_Hz=rate_Hz, autopilot="warm-up") as plant:
        for _ in range(round(0.2 * rate_Hz)):
            plant.advance_period(np.full(4, 0.1), True)
