"""Run the exported flight software on this machine with the interface of the Python software.

:class:`FirmwareSoftware` replaces the Python software in a flight. :class:`ComparedSoftware` runs both and compares
them. The records of C are those of :mod:`mufly.firmware.software_instance`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from mufly.control import FlightController
from mufly.errors import InputError, MuflyError
from mufly.estimate import Estimate
from mufly.firmware.export.plan_tables import HOST_MAX_WAYPOINTS, collect_plan_fields, make_mission_plan
from mufly.firmware.host_build import Firmware, FirmwareControllers
from mufly.firmware.software_instance import MISSION_STATES, MOTOR_MODES, SoftwareInstance
from mufly.flight.controllers import Actuators
from mufly.flight.flight_software import FlightSoftware
from mufly.flight.oscillation_detector import Oscillation
from mufly.mission import (
    Command,
    Mission,
    MissionState,
    State,
)
from mufly.mission.avoidance import ObstacleMap
from mufly.vehicle import Vehicle


def diff_fields(ours: Any, theirs: Any, where: str = "") -> list[str]:
    """Return the fields in which two records of the same type differ in any bit, each with both values."""
    if isinstance(ours, ObstacleMap) and isinstance(theirs, ObstacleMap):
        # The content of unused rows is arbitrary in both languages.
        pairs = [
            ("used", ours.point_count, theirs.point_count),
            ("turn", ours.next_replaced_row, theirs.next_replaced_row),
            ("points", ours.points[: ours.point_count], theirs.points[: theirs.point_count]),
        ]
    elif is_dataclass(ours) and type(ours) is type(theirs):
        pairs = [(f.name, getattr(ours, f.name), getattr(theirs, f.name)) for f in fields(ours)]
    elif isinstance(ours, tuple) and isinstance(theirs, tuple) and len(ours) == len(theirs):
        pairs = [(str(k), a, b) for k, (a, b) in enumerate(zip(ours, theirs, strict=True))]
    elif isinstance(ours, np.ndarray) and isinstance(theirs, np.ndarray):
        return [] if ours.tobytes() == theirs.tobytes() else [f"{where}: {ours} and {theirs}"]
    else:
        # The sign of zero is ignored: no result depends on it.
        same = ours == theirs or (ours != ours and theirs != theirs)
        return [] if same else [f"{where}: {ours!r} and {theirs!r}"]
    return [line for name, a, b in pairs for line in diff_fields(a, b, f"{where}.{name}".lstrip("."))]


class FirmwareSoftware(FlightSoftware):
    """A :class:`mufly.flight.flight_software.FlightSoftware` computed entirely by the exported code.

    Parameters
    ----------
    vehicle, controller, mission
        As for :class:`mufly.flight.flight_software.FlightSoftware`.
    firmware : Firmware, optional
        Loaded code; by default it is built from ``controller``.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> None:
        self._software_instance: SoftwareInstance | None = None
        self._initial_values: dict[str, Any] = {}
        self._cached_records: dict[str, Any] = {}
        self.firmware = firmware or Firmware(controller)
        super().__init__(vehicle, controller, mission)

    def _start(self) -> None:
        self._software_instance = SoftwareInstance(self.firmware, self._controller, self.plan)
        self.law = FirmwareControllers(self._controller, self.firmware)

    def reset(self) -> None:
        """Reset to the state before the first step."""
        super().reset()
        self._start()
        self.clear_cached_records()

    def apply_mission_limits(self, mission: Mission) -> None:
        """Apply the limits of another mission with the same waypoints."""
        before = None if self._software_instance is None else (self.plan, self.requested_mission, self.slowdown_note)
        super().apply_mission_limits(mission)
        if self._software_instance is None or before is None:
            return
        try:
            self._software_instance.write_mission_plan(self.plan)
        except InputError:
            self.plan, self.requested_mission, self.slowdown_note = before
            raise

    def load_mission(self, mission: Mission) -> None:
        """Load another mission, which begins at its first waypoint after a start command."""
        self.apply_mission_limits(mission)
        assert self._software_instance is not None
        if self._software_instance.software_record.watch.begun:
            self._software_instance.reset_mission_state(mission.name)
            self.clear_cached_records()

    def retune_controllers(self, controller: FlightController) -> None:
        """Change to other gains of the same control law gradually, without a jump of the outputs."""
        self.law.retune_gains(controller)
        super().retune_controllers(controller)

    @property
    def is_mission_step_due(self) -> bool:
        """Return whether the next step runs the mission logic."""
        return self._software_instance is None or bool(self._software_instance.software_record.tick == 0)

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Compute one control period in the exported code."""
        board = self._software_instance
        assert board is not None
        board.setup_record.gains = self.law.advance_gains()
        actuators = board.step(estimate, command)
        self.clear_cached_records()
        return actuators

    # Records are converted on access: a control period takes a tenth of the time of converting all records.

    def clear_cached_records(self) -> None:
        """Discard the cached Python copies of the C records; call this after a change of those records."""
        self._cached_records = {}

    def _read_record(self, name: str) -> Any:
        """Return a record of the C software, converted to Python; its initial value before the software is started."""
        board = self._software_instance
        if board is None:
            return self._initial_values[name]
        if name not in self._cached_records:
            self._cached_records[name] = getattr(board, name)
        return self._cached_records[name]

    @property
    def software_instance(self) -> SoftwareInstance:
        """Return the instance of the exported software, with its C records."""
        assert self._software_instance is not None
        return self._software_instance

    def make_batch_runner(self, flight: Any) -> Callable[..., bool] | None:
        """Return a function that advances a flight by many periods in one call; None if unsupported."""
        from mufly.firmware.quick import CompiledFlight  # a circular import otherwise

        loop = CompiledFlight(flight)
        return loop.run_periods if loop.is_supported else None

    @property
    def motors(self) -> str:
        """Return the mode of the motors, such as stopped or running."""
        return (
            "off"
            if self._software_instance is None
            else str(MOTOR_MODES[self._software_instance.software_record.motors])
        )

    @property
    def flying(self) -> bool:
        """Return whether the vehicle is off the floor."""
        board = self._software_instance
        return board is not None and bool(self.firmware.lib.software_flying(board.software_record))

    @property
    def logged_event_count(self) -> int:
        """Return the number of log entries so far."""
        return (
            0
            if self._software_instance is None
            else int(self._software_instance.software_record.mission.logged_event_count)
        )

    @property
    def finished(self) -> bool:
        """Return whether the mission has ended."""
        return self._software_instance is not None and bool(self._software_instance.software_record.mission.finished)

    @property
    def state(self) -> State:
        """Return the state of the mission."""
        return (
            State.INIT
            if self._software_instance is None
            else MISSION_STATES[self._software_instance.software_record.mission.state]
        )

    @property
    def mission_state(self) -> MissionState:
        """Return the full state of the mission logic."""
        return cast(MissionState, self._read_record("state"))

    @mission_state.setter
    def mission_state(self, value: MissionState) -> None:
        self._initial_values["state"] = value

    @property
    def oscillation(self) -> Oscillation | None:
        """Return the detected oscillation of an actuator; None without one."""
        return cast("Oscillation | None", self._read_record("oscillation"))

    @oscillation.setter
    def oscillation(self, value: Oscillation | None) -> None:
        self._initial_values["oscillation"] = value

    @property
    def reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the reference: position (m), velocity (m/s), both N-E-D, and roll, pitch, yaw (rad)."""
        if self._software_instance is not None:
            c = self._software_instance.software_record
            self._reference, self._late_s = self._read_record("reference"), c.since_mission_step_s
            self._tilt = np.array(list(c.tilt))
        return super().reference


class GenericFirmwareSoftware(FirmwareSoftware):
    """A :class:`FirmwareSoftware` with gains passed at run time, so that no build precedes a flight.

    Results are equal bit for bit. Without a compiler, or for a mission that is too long for a board, the constructor
    returns a :class:`FlightSoftware`.
    """

    def __new__(
        cls,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> Any:
        """Return software that runs the exported code, or the Python software if the code is unavailable."""
        try:
            Firmware(None)
            collect_plan_fields(make_mission_plan(vehicle, controller, mission), HOST_MAX_WAYPOINTS)
        except (MuflyError, OSError):
            return FlightSoftware(vehicle, controller, mission)
        return super().__new__(cls)

    def __init__(
        self,
        vehicle: Vehicle,
        controller: FlightController,
        mission: Mission,
        firmware: Firmware | None = None,
    ) -> None:
        super().__init__(vehicle, controller, mission, firmware or Firmware(None))


class ComparedSoftware(FlightSoftware):
    """Flight software in Python that compares outputs and state with the exported code on the same inputs.

    Attributes
    ----------
    period_count, mismatch_count : int
        Number of compared periods, and of periods with a difference.
    log_entry_count : int
        Number of compared log entries.
    first_mismatch : str
        Time, field and values of the first difference; "" without a difference.
    """

    firmware: Firmware
    controllers: Any

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        self.period_count = self.mismatch_count = 0
        self.first_mismatch = ""
        self._software_instance: SoftwareInstance | None = None
        super().__init__(vehicle, controller, mission)
        self.replace_controllers(self.controllers)

    def reset(self) -> None:
        """Reset to the state before the first step."""
        super().reset()
        if self._software_instance is not None:
            self._software_instance.reset_software()

    def apply_mission_limits(self, mission: Mission) -> None:
        """Apply the limits of another mission with the same waypoints."""
        super().apply_mission_limits(mission)
        if self._software_instance is not None:
            self._software_instance.write_mission_plan(self.plan)

    @property
    def log_entry_count(self) -> int:
        """Return the number of compared log entries."""
        return self.mission_state.logged_event_count

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Compute one control period in Python and in the exported code, and compare both."""
        if self._software_instance is None:
            self._software_instance = SoftwareInstance(self.firmware, self._controller, self.plan)
        board, logged = self._software_instance, self.mission_state.logged_event_count
        ours, theirs = super().step(estimate, command), board.step(estimate, command)
        wrong = diff_fields(ours.input_array, theirs.input_array, "actuators")
        wrong += diff_fields(self._reference, board.reference, "reference")
        if self._late_s == 0.0 or self.mission_state.logged_event_count != logged:
            wrong += diff_fields(self.mission_state, board.state, "mission")
        self.period_count += 1
        self.mismatch_count += bool(wrong)
        if wrong and not self.first_mismatch:
            self.first_mismatch = f"{estimate.time_s:.3f} s: {wrong[0]}"
        return ours


def make_compared_software(
    controllers: Any, firmware: Firmware, kept: list[ComparedSoftware]
) -> type[ComparedSoftware]:
    """Return a subclass of :class:`ComparedSoftware` that appends each new instance to ``kept``.

    Parameters
    ----------
    controllers : callable
        Control law of the Python side.
    firmware : Firmware
    kept : list
        List to which each new instance is appended.
    """

    class RegisteredComparison(ComparedSoftware):
        def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
            super().__init__(vehicle, controller, mission)
            kept.append(self)

    RegisteredComparison.firmware, RegisteredComparison.controllers = firmware, staticmethod(controllers)
    return RegisteredComparison
