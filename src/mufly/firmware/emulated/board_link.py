"""Fly an emulated board that takes commands on its own MAVLink link: ground stations connect to its UART by TCP."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mufly.control import design_flight_controller
from mufly.firmware.emulated.board_flight import BoardEstimator, BoardFlightResult, make_board_software
from mufly.firmware.emulated.boards import EmulatedBoard, HostBoard
from mufly.firmware.emulated.image_build import build_board_image, build_host_board
from mufly.flight import Flight
from mufly.logs.mcap import FlightEvent
from mufly.mission import Mission
from mufly.sensors import Fault
from mufly.vehicle import Vehicle

_MAX_CAUGHT_UP_LAG_S = 0.2  # of the flight behind the clock; a longer delay is dropped
_MAX_UNTHROTTLED_SILENCE_FRACTION = 0.5  # of COM_DL_LOSS_T that a silent commander's flight may exceed real time


def _limit_pace_for_silent_commander(pace: float, supervisor: Any) -> float:
    """Return the simulation's pace relative to real time: ``pace``, but at most 1 if the link has long been silent.

    Heartbeats follow the wall clock (one a second), but the timeout COM_DL_LOSS_T follows the clock of the flight. At
    ten times real time a heartbeat would arrive every 10 s of flight, and the board would hold because of a lost link.
    """
    silent_s = supervisor.now_s - supervisor.commander_heard_s if supervisor.has_commander else 0.0
    if silent_s <= _MAX_UNTHROTTLED_SILENCE_FRACTION * supervisor.settings.link_loss_s:
        return pace
    return min(pace, 1.0) if pace > 0.0 else 1.0


def run_linked_board(
    vehicle: Vehicle,
    mission: Mission,
    *,
    port: int,
    wind: Sequence[float] | None = None,
    gust: float | None = None,
    seed: int = 0,
    faults: Sequence[Fault] = (),
    path: Path | None = None,
    pace: float = 1.0,
    counts_instructions: bool = False,
    receiver: str = "",
    receiver_port: int = 0,
    stop: Callable[[Flight], bool] = lambda flight: False,
    on_event: Callable[[FlightEvent], None] | None = None,
    on_open: Callable[[], None] = lambda: None,
) -> BoardFlightResult:
    """Fly an emulated board, which stations command through its own link, until ``stop`` returns True.

    Parameters
    ----------
    vehicle, mission, wind, gust, seed, faults, path
        As for :func:`mufly.firmware.emulated.fly_board`; the mission is that of the image, and waits for its start.
    port : int
        Port of this machine at which the UART of the board listens (TCP).
    pace : float
        Flight time over wall-clock time; 0: as fast as possible. A commander's silence of half COM_DL_LOSS_T limits
        it to real time, because stations send heartbeats by the wall clock.
    counts_instructions : bool
        Count the instructions of each period; slower.
    receiver, receiver_port
        Kind of a pilot's receiver, ``crsf`` or ``sbus``, and the port at which its UART listens; "" without one.
    stop : callable
        Called with the flight after every period; True ends it.
    on_event, on_open : callable
        Called with every event; called when stations can connect.

    Raises
    ------
    MuflyError
        If a tool is missing, or the emulation ends by itself.
    """
    controller = design_flight_controller(vehicle)
    uart, receiver_uart = (f"tcp:127.0.0.1:{p},server=on,wait=off,nodelay=on" for p in (port, receiver_port))
    twin = HostBoard(*build_host_board(vehicle, controller, mission))
    board = EmulatedBoard(
        build_board_image(vehicle, controller, mission),
        twin,
        uart,
        counts_instructions,
        receiver,
        receiver_uart if receiver else "none",
    )
    try:
        with Flight(
            vehicle, mission, controller=controller, wind=wind, gust=gust, seed=seed, faults=faults, path=path,
            keep=False, sensors="fitted", estimator=BoardEstimator(board, vehicle, mission.world, controller.rate_Hz),
            controllers=make_board_software(board),
        ) as flight:  # fmt: skip
            flight.autopilot.software.commands_itself = True
            if on_event is not None:
                flight.autopilot.listeners.append(on_event)
            on_open()
            began = ahead = time.perf_counter()
            while not stop(flight):
                flight.step_period()
                now, limit = time.perf_counter(), _limit_pace_for_silent_commander(pace, board.record.supervisor)
                if limit > 0.0:
                    ahead = max(ahead + flight.period_s / limit, now - _MAX_CAUGHT_UP_LAG_S)
                    time.sleep(max(0.0, ahead - now))
                else:
                    ahead = now
            wall_s = max(time.perf_counter() - began, 1e-9)
            flown_s = flight.time_s
    finally:
        board.close()
    return BoardFlightResult(
        periods=board.period_count, mismatch_count=board.mismatch_count, first_mismatch=board.first_mismatch,
        periods_per_s=board.period_count / wall_s, realtime_factor=flown_s / wall_s,
        worst_instructions=board.worst_instructions,
    )  # fmt: skip
