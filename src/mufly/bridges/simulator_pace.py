"""Simulation loop for external autopilots, its pace relative to real time, and reports of its state."""

from __future__ import annotations

import math
import select
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.errors import InputError
from mufly.link.ports import Port
from mufly.link.real_time.real_time_loop import RealTimePacer

MAX_REAL_TIME_FACTOR = 100.0
REPORT_PERIOD_S = 0.5
SILENCE_TIMEOUT_S = 2.0
"""Wall-clock time without an answer after which an autopilot counts as silent (s)."""


@dataclass(frozen=True, slots=True)
class SimulatorReport:
    """State of a simulation, for a display.

    Attributes
    ----------
    time_s : float
        Simulated time.
    link_state : str
        "waiting", "starting", "lockstep", "free-running" or "silent".
    is_armed : bool
    height_m, voltage_V : float
        True height above the floor, and battery voltage.
    lockstep_period_count, unanswered_count : int
        Periods in lockstep, and those that the autopilot did not answer.
    real_time_factor : float
        Simulated seconds per second of wall-clock time since the last report.
    """

    time_s: float
    link_state: str
    is_armed: bool
    height_m: float
    voltage_V: float
    lockstep_period_count: int
    unanswered_count: int
    real_time_factor: float

    def __str__(self) -> str:
        lost = f", {self.unanswered_count} unanswered" if self.unanswered_count else ""
        return (
            f"{self.time_s:7.1f} s  {self.link_state:<9}  {'armed' if self.is_armed else 'disarmed'}  "
            f"{self.height_m:5.2f} m  {self.voltage_V:.2f} V  {self.lockstep_period_count} steps{lost}  "
            f"{self.real_time_factor:.2f} times real time"
        )


def check_real_time_factor(speed: float, where: str = "speed") -> float:
    """Check a speed relative to real time (0: as fast as possible), and return it.

    Raises
    ------
    InputError
        If it is not between 0 and :data:`MAX_REAL_TIME_FACTOR`.
    """
    if not 0.0 <= speed <= MAX_REAL_TIME_FACTOR:
        raise InputError(
            where, "", f"{speed:g} is not a valid speed", f"give 0 (as fast as possible) to {MAX_REAL_TIME_FACTOR:g}"
        )
    return speed


class SimulatorPace:
    """Timer of a simulation's periods against the wall clock, and source of its reports (:class:`SimulatorReport`).

    Parameters
    ----------
    vehicle : AutopilotPlant
    speed : float
        Simulated seconds per second of wall-clock time; 0: as fast as possible.
    clock : callable
        Wall clock (s).
    """

    def __init__(self, vehicle: AutopilotPlant, speed: float, clock: Callable[[], float]) -> None:
        self._vehicle, self.speed, self._clock = vehicle, check_real_time_factor(speed), clock
        self.restart_period_timing()
        self._report_s, self._report_time_s = clock(), vehicle.time_s

    def restart_period_timing(self) -> None:
        """Restart the timing of periods from the present time, after the simulation has waited."""
        period_s = self._vehicle.period_s
        self._pacer = RealTimePacer(self._clock(), period_s / (self.speed or 1.0))

    def time_to_next_period_s(self, *, in_real_time: bool = False) -> float:
        """Return the wall-clock time until the next period (s): 0 or less if the period is due, 0 if the speed is
        unlimited.
        """
        if self.speed == 0.0 and not in_real_time:
            return 0.0
        return self._pacer.sleep_time_s(self._clock())

    def record_period(self) -> None:
        """Count a period; log when real time is not kept, or is kept again."""
        self._pacer.record_tick(self._clock())
        if self.speed == 1.0 and (notice := self._pacer.take_pace_warning(self._clock())):
            self._vehicle.log_event(notice, "warning" if "slower" in notice else "info")

    def make_report_if_due(
        self, state: str, lockstep_period_count: int, unanswered_count: int
    ) -> SimulatorReport | None:
        """Return the state of the simulation if :data:`REPORT_PERIOD_S` has passed since the last report, else None."""
        now_s, vehicle = self._clock(), self._vehicle
        if now_s - self._report_s < REPORT_PERIOD_S:
            return None
        speed = (vehicle.time_s - self._report_time_s) / (now_s - self._report_s)
        self._report_s, self._report_time_s = now_s, vehicle.time_s
        return SimulatorReport(
            vehicle.time_s, state, vehicle.is_armed, vehicle.height_m, float(vehicle.truth.battery_voltage_V),
            lockstep_period_count, unanswered_count, speed if math.isfinite(speed) else 0.0,
        )  # fmt: skip


class AutopilotSimulator(ABC):
    """Simulator of a vehicle that one instance of an autopilot flies.

    Parameters
    ----------
    vehicle : AutopilotPlant
    port : Port
        Port where the autopilot's messages arrive.
    speed : float
        Simulated seconds per second of wall-clock time; 0: as fast as possible.
    clock : callable
        Wall clock (s).

    Attributes
    ----------
    state : str
        As in :class:`SimulatorReport`.
    lockstep_period_count, unanswered_count : int
        Periods, and those without an answer.
    on_period : callable
        Called after every period; a program that commands the autopilot in simulated time uses it.
    """

    def __init__(self, vehicle: AutopilotPlant, port: Port, speed: float, clock: Callable[[], float]) -> None:
        self.vehicle, self.port, self._clock = vehicle, port, clock
        self.pace = SimulatorPace(vehicle, speed, clock)
        self.state = "waiting"
        self.lockstep_period_count = self.unanswered_count = 0
        self.on_period: Callable[[], None] = lambda: None

    def run(
        self,
        stop: Callable[[], bool],
        on_report: Callable[[SimulatorReport], None] = lambda report: None,
    ) -> None:
        """Simulate until ``stop()``; the ports are closed at the end."""
        self._log_waiting_for_autopilot()
        try:
            while not stop():
                self._simulate_period(stop)
                report = self.pace.make_report_if_due(self.state, self.lockstep_period_count, self.unanswered_count)
                if report is not None:
                    on_report(report)
        finally:
            self._close_ports()

    @abstractmethod
    def _log_waiting_for_autopilot(self) -> None:
        """Log that the simulator waits for its autopilot."""

    @abstractmethod
    def _simulate_period(self, stop: Callable[[], bool]) -> None:
        """Receive messages and simulate one period; return after a short wait if the autopilot is not ready."""

    def _close_ports(self) -> None:
        self.port.close()

    def _wait_for_message(self, timeout_s: float) -> None:
        """Sleep until a message has come, for ``timeout_s`` at most."""
        select.select([self.port.fileno()], [], [], max(0.0, timeout_s))
