"""Fly a mission with a board in place of estimator and flight software; plant, sensors and faults are simulated
here.

The board receives the readings of each period and the autopilot's requests; it returns its whole memory, from which
autopilot and recorder read estimate, state of the mission and log (:mod:`mufly.firmware.emulated.boards`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.control import FlightController, design_flight_controller
from mufly.errors import InputError
from mufly.estimate import Estimate, KalmanEstimator
from mufly.estimate.filter.filter_records import READING_RANGE_RING, make_memory_dtype
from mufly.estimate.filter_backend import FilterBackend
from mufly.estimate.sensor_status import describe_reason
from mufly.firmware.compiled_software import FirmwareSoftware
from mufly.firmware.emulated.boards import Board, EmulatedBoard, HostBoard
from mufly.firmware.emulated.image_build import build_board_image, build_host_board
from mufly.firmware.software_instance import SoftwareInstance, TextNumberTable
from mufly.flight import fly_mission
from mufly.flight.controllers import Actuators
from mufly.flight.mission_flight import FlightProgress
from mufly.logs.block_log import split_image_into_sessions
from mufly.logs.mcap import FlightEvent
from mufly.mission import Command, Mission, MissionPlan
from mufly.results import result
from mufly.sensors import Fault, Readings
from mufly.vehicle import Vehicle

if TYPE_CHECKING:
    from cffi import FFI


@result
class BoardFlightResult:
    """Comparison of an emulated board with this machine over a flight.

    Attributes
    ----------
    periods : int
        Number of compared periods.
    mismatch_count : int
        Number of halves of a period after which any byte of the board's memory differs.
    first_mismatch : str
        Period, field and values of the first difference; "" without one.
    periods_per_s : float
        Flown periods per second of wall-clock time (1/s), without builds and start-up.
    realtime_factor : float
        Flight time over wall-clock time.
    worst_instructions : int
        Instructions of the longest period on the emulated board; 0 unless they are counted.
    """

    periods: int
    mismatch_count: int
    first_mismatch: str
    periods_per_s: float
    realtime_factor: float
    worst_instructions: int = 0


def make_board(
    vehicle: Vehicle, controller: FlightController, mission: Mission, *, emulated: bool, single: bool = True
) -> HostBoard | EmulatedBoard:
    """Build the board of a vehicle and a mission.

    Parameters
    ----------
    vehicle, controller, mission
        As for :func:`mufly.firmware.export_firmware`.
    emulated : bool
        Run the image in QEMU, compared with this machine; otherwise this machine runs the same code.
    single : bool
        Single precision, as on the board; an emulated board has no other.

    Raises
    ------
    MuflyError
        If a tool is missing, or the mission is too long for a board.
    """
    host = HostBoard(*build_host_board(vehicle, controller, mission, single=single))
    return EmulatedBoard(build_board_image(vehicle, controller, mission), host) if emulated else host


class BoardEstimator(KalmanEstimator):
    """The estimator on a board: writes the readings of a period to the board and reads its memory.

    Parameters
    ----------
    board : Board
    vehicle, world, rate_Hz
        As for :class:`mufly.estimate.KalmanEstimator`.
    """

    def __init__(self, board: Board, vehicle: Vehicle, world: Any, rate_Hz: float) -> None:
        ffi = board.ffi
        self._board = board
        self._period: Any = ffi.new("board_period_t *")
        readings = self._period.readings
        real = np.float64 if ffi.sizeof("real_t") == 8 else np.float32
        self._sent_values, self._sent_ages, self._sent_ranges = (
            np.frombuffer(ffi.buffer(part), real) for part in (readings.z, readings.age, readings.ranges)
        )
        self._sent_flags = np.frombuffer(ffi.buffer(readings.fresh), np.int32)
        self._kept_values = np.frombuffer(ffi.buffer(board.record.readings.z), real)
        super().__init__(vehicle, world, rate_Hz, real)
        at = ffi.offsetof("board_t", "estimator")
        memory = board.memory[at : at + ffi.sizeof("estimator_t")]
        self._memory_array = memory.view(_estimator_dtype(ffi, real))
        self.memory = m = self._memory_array[0]
        self._output_state, self._output_rates, self._write_output_angles = (
            m["x_output"],
            m["rates_output"],
            m["angles_output"],
        )

    def replace_settings_and_reset(self, settings: Any) -> None:
        """Store the settings and reset; the board's image contains the same settings already."""
        self._settings = settings
        self._copy_vehicle_file_noise()
        self.backend = FilterBackend(
            "board",
            "",
            lambda memory: self._board.restart(),
            lambda memory: self._run_estimate_half(),
            settings=settings,
        )
        self.reset()

    def reset(self) -> None:
        """Return to the state after power-up."""
        super().reset()
        self._missed = 0
        self._sent_values[:] = self._sent_ages[:] = self._sent_ranges[:] = self._sent_flags[:] = 0

    def update(self, readings: Readings, acting: NDArray[np.float64] | None = None, missed: int = 0) -> Estimate:
        self._period.time_s = readings.time_s
        return super().update(readings, acting, missed)

    def process_missed_periods(self, count: int) -> None:
        """Report the number of periods lost before this one to the board, which computes them."""
        self._missed = count

    def _run_estimate_half(self) -> bool:
        self._period.missed, self._missed = self._missed, 0
        self._sent_values[:] = self._input_values
        self._sent_flags[:] = self._input_is_new
        self._sent_ages[:] = self._input_age
        if self._input_is_new[READING_RANGE_RING] == 1:
            self._sent_ranges[: self.ranges.size] = self.ring_scans[2]
        self._board.compute_estimate(self._period)
        # The board's copy of the readings: its filter overwrites some of them.
        self._input_values[:] = self._kept_values
        return bool(self._board.record.belief.valid)


def _estimator_dtype(ffi: FFI, real: Any) -> np.dtype:
    """Return the NumPy type of the filter's memory, ``estimator_t``, with the buffer sizes compiled into the board.

    Raises
    ------
    ValueError
        If it differs from the record in C.
    """
    kind = ffi.typeof("estimator_t")
    full = make_memory_dtype(real)
    fields = []
    for name, field in kind.fields:
        base, shape = full[name].subdtype or (full[name], ())
        if shape:
            shape = (field.type.length, *shape[1:])
        fields.append((name, base, shape))
    found = np.dtype(fields, align=True)
    if found.itemsize != ffi.sizeof("estimator_t"):
        raise ValueError(f"estimator_t has {ffi.sizeof('estimator_t')} bytes in C, {found.itemsize} in Python")
    return found


class BoardInstance(SoftwareInstance):
    """The flight software on a board: sends commands, reads the board's memory."""

    def __init__(self, board: Board, plan: MissionPlan) -> None:
        ffi = board.ffi
        self._board = board
        self.firmware: Any = _BoardFirmware(board)
        self.text_table = TextNumberTable()
        self._request: Any = ffi.new("board_request_t *")
        self.command_record = ffi.addressof(self._request, "given", "command")
        self.software_record = ffi.addressof(board.record, "software")
        self._last_command: Command | None = None
        self._mission_name = plan.mission.name
        self._events: tuple[FlightEvent, ...] = ()
        self._log_count = 0

    def run_control_half(self, command: Command | None, armed: bool) -> Actuators:
        """Run the control half of a period; return the inputs that the board sends to its actuators.

        Without a command, the board takes its commands from its own link and supervisor.
        """
        self._request.is_given = command is not None
        if command is not None:
            self._write_command_record(command)
            self._request.given.armed = armed
        self._board.compute_control(self._request)
        self.read_log()
        out = self._board.record.sent
        return Actuators(np.array(list(out.motor_input)), np.array(list(out.servo_input)))

    def read_sensor_reason(self, b: Any) -> str:
        """Return the reason for the status in a ``message_sensor_t`` as a text; the board stores the reason's code."""
        return describe_reason(b.why, b.number, b.sensor)


class _BoardFirmware:
    """Stand-in for :class:`mufly.firmware.host_build.Firmware` that converts a board's C records to Python."""

    def __init__(self, board: Board) -> None:
        self.ffi, self.lib, self.is_generic = board.ffi, board.lib, False
        self.real_dtype = np.dtype(np.float64 if board.ffi.sizeof("real_t") == 8 else np.float32)


class BoardSoftware(FirmwareSoftware):
    """The flight software on a board; each subclass sets ``board`` (:func:`make_board_software`)."""

    board: Board

    def __init__(self, vehicle: Vehicle, controller: FlightController, mission: Mission) -> None:
        super().__init__(vehicle, controller, mission, _BoardFirmware(self.board))  # type: ignore[arg-type]

    def _start(self) -> None:
        self._software_instance = BoardInstance(self.board, self.plan)

    def apply_mission_limits(self, mission: Mission) -> None:
        """Refuse another mission in flight: the board's image contains its mission."""
        if self._software_instance is not None:
            raise InputError(
                "mission",
                mission.name,
                "the board's image contains another mission",
                "build the image again with this mission",
            )
        super().apply_mission_limits(mission)

    def step(self, estimate: Estimate, command: Command) -> Actuators:
        """Advance by one period; the board uses its own estimate."""
        board = self._software_instance
        assert isinstance(board, BoardInstance)
        actuators = board.run_control_half(None if self.commands_itself else command, self.is_armed)
        if self.commands_itself:
            self.is_armed = bool(self.board.record.supervisor.armed)
        self.clear_cached_records()
        return actuators

    def make_batch_runner(self, flight: Any) -> Callable[..., bool] | None:
        """Return None: every period needs the board."""
        return None


def make_board_software(board: Board) -> type[BoardSoftware]:
    """Return a class of flight software whose control periods are computed by a board."""
    return type("BoardSoftware", (BoardSoftware,), {"board": board})


def fly_board(
    vehicle: Vehicle,
    mission: Mission,
    *,
    emulated: bool,
    wind: Sequence[float] | None = None,
    gust: float | None = None,
    seed: int = 0,
    faults: Sequence[Fault] = (),
    path: Path | None = None,
    log_path: Path | None = None,
    single: bool = True,
    on_progress: Callable[[FlightProgress], None] | None = None,
    on_event: Callable[[FlightEvent], None] | None = None,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> tuple[xr.Dataset, BoardFlightResult]:
    """Fly a mission with a board in place of estimator and flight software.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with sensors.
    mission : Mission
        At most 32 waypoints.
    emulated, single
        As for :func:`make_board`.
    wind, gust, seed, faults, path, on_progress, on_event
        As for :func:`mufly.flight.fly_mission`.
    log_path : Path, optional
        File for the log that the board has written (ULog); it lacks the rows that a power cut at the end would lose.
    on_stage : callable, optional
        Called with the name of each stage before the flight.

    Returns
    -------
    xarray.Dataset
        The recording, with truth.
    BoardFlightResult
        Comparison of the emulated board with this machine; without emulation nothing is compared.

    Raises
    ------
    MuflyError
        If a tool is missing, the vehicle has no sensors, or the emulation ends by itself.
    """
    if vehicle.sensors is None:
        raise InputError("vehicle", vehicle.name, "has no table [sensors]", "add it (docs/reference/sensors.md)")
    on_stage("designing the controllers")
    controller = design_flight_controller(vehicle)
    on_stage("building the board's image")
    board = make_board(vehicle, controller, mission, emulated=emulated, single=single)
    on_stage("compiling the model")
    try:
        record = fly_mission(
            vehicle, mission, controller=controller, wind=wind, gust=gust, seed=seed, faults=faults, path=path,
            sensors="fitted", estimator=BoardEstimator(board, vehicle, mission.world, controller.rate_Hz),
            controllers=make_board_software(board), on_progress=on_progress, on_event=on_event,
        )  # fmt: skip
        if log_path is not None:
            log_path.write_bytes(split_image_into_sessions(board.log_blocks.tobytes())[-1].ulog)
    finally:
        board.close()
    factor = float(record.attrs["realtime_factor"])
    compared = board if isinstance(board, EmulatedBoard) else None
    return record, BoardFlightResult(
        periods=compared.period_count if compared else 0,
        mismatch_count=compared.mismatch_count if compared else 0,
        first_mismatch=compared.first_mismatch if compared else "",
        periods_per_s=factor * controller.rate_Hz,
        realtime_factor=factor,
    )
