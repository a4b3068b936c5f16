"""The simulated vehicle in a process of its own.

:func:`start_vehicle_process` starts the process, so that a page that draws and a vehicle that flies do not wait for
each other. A pipe connects it with the parent. The vehicle sends its events; the parent sends faults of sensors, and
``None`` to end the flight. When the parent dies the pipe breaks, and the vehicle ends. However it ends (request,
Ctrl-C, termination, death of the parent), it finishes its recording.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mufly.control import design_flight_controller
from mufly.errors import MuflyError
from mufly.flight import Flight, FlightEvent
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.flight_software import ControlImplementation
from mufly.flight.record.live_view import LiveViewConfig
from mufly.link.codec import GlobalOrigin
from mufly.link.ports import Endpoint
from mufly.link.real_time.real_time_loop import LoopReport, SensorMode, fly_in_real_time, precompile_flight_code
from mufly.link.vehicle_link import VehicleLink
from mufly.logs.tlog import TlogWriter
from mufly.mission import Mission, load_mission
from mufly.sensors import Fault
from mufly.slam import TrackedPicture
from mufly.vehicle import Vehicle, load_vehicle

START_TIMEOUT_S = 120.0
"""Time without a new stage after which the start of a vehicle's process is given up (s)."""
STAGE_DESIGNING, STAGE_COMPILING = "designing the controllers", "compiling the model"
"""Stages of a start; the second takes longest on a machine that has not compiled the model yet."""
_MAX_QUEUED_EVENTS = 1000
_MAX_QUEUED_REPORTS = 1000


class VehicleProcess:
    """A vehicle that flies in its own process.

    Attributes
    ----------
    events : deque of FlightEvent
        The latest 1000 events; a display removes them.
    notices : deque of str
        Events of the ports.
    report : LoopReport or None
        State of its loop.
    sight : TrackedPicture or None
        The latest picture and result, of a flight on pictures.
    stage : str
        Present or last stage of its start.
    outcome, reason : str
        Outcome of the flight; "" during the flight.
    error : str
        Error that ended the process, if any.
    """

    def __init__(self, order: Mapping[str, Any], on_stage: Callable[[str], None] | None = None) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._on_stage = on_stage or (lambda _: None)
        self.stage = "loading the vehicle's libraries"
        self.events: deque[FlightEvent] = deque(maxlen=_MAX_QUEUED_EVENTS)
        self.notices: deque[str] = deque(maxlen=_MAX_QUEUED_EVENTS)
        self.report: LoopReport | None = None
        self.sight: TrackedPicture | None = None
        self.outcome = self.reason = self.error = ""
        self._ready = threading.Event()
        self._staged_s = time.monotonic()
        self._on_stage(self.stage)
        self._process = context.Process(
            target=_run_vehicle_process, args=(order, theirs), name="mufly vehicle", daemon=True
        )
        self._process.start()
        theirs.close()
        self._reader = threading.Thread(target=self._read_pipe, name="mufly vehicle reader", daemon=True)
        self._reader.start()

    @property
    def is_finished(self) -> bool:
        """Return whether the process has ended."""
        return not self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Process id of the vehicle's process."""
        return self._process.pid

    @property
    def is_ready(self) -> bool:
        """Return whether the vehicle's link is open and its simulation runs.

        Raises
        ------
        MuflyError
            If it cannot start, or makes no progress within :data:`START_TIMEOUT_S`.
        """
        if self._ready.is_set():
            if self.error:
                raise MuflyError(self.error)
            return True
        if time.monotonic() - self._staged_s > START_TIMEOUT_S:
            raise MuflyError(
                f"the vehicle did not start: {self.stage} took more than {START_TIMEOUT_S:g} s; reduce the "
                "load of the machine"
            )
        return False

    def wait_until_ready(self) -> None:
        """Wait until the vehicle's link is open and its simulation runs.

        Raises
        ------
        MuflyError
            If it cannot start, with the message of the vehicle's process.
        """
        while not self.is_ready:
            self._ready.wait(0.1)

    def stop(self, timeout_s: float = 10.0) -> None:
        """Stop the process, and wait until its recording is complete."""
        with contextlib.suppress(OSError, ValueError):
            self._pipe.send(None)
        self._process.join(timeout_s)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._reader.join(1.0)

    def inject_fault(self, fault: Fault) -> None:
        """Inject a sensor fault (:meth:`mufly.flight.Flight.inject_fault`); an event reports it."""
        self._send_sensor_fault(fault)

    def clear_faults(self) -> None:
        """Clear all sensor faults of the vehicle."""
        self._send_sensor_fault(None)

    def _send_sensor_fault(self, fault: Fault | None) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._pipe.send((fault,))

    def __enter__(self) -> VehicleProcess:
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def _read_pipe(self) -> None:
        ended = False
        while True:
            try:
                kind, content = self._pipe.recv()
            except (EOFError, OSError):
                break
            if kind == "event":
                self.events.append(content)
            elif kind == "notice":
                self.notices.append(content)
            elif kind == "report":
                self.report = content
                self.outcome = content.state.outcome
            elif kind == "sight":
                self.sight = content
            elif kind == "stage":
                self.stage, self._staged_s = content, time.monotonic()
                self._on_stage(content)
            elif kind == "ready":
                self._ready.set()
            elif kind == "done":
                self.outcome, self.reason = content
                ended = True
            elif kind == "error":
                self.error = content
        if not ended and not self.error:
            when = "while it flew" if self._ready.is_set() else "before it was ready"
            during = "" if self._ready.is_set() else f" ({self.stage})"
            self.error = f"the vehicle's process ended {when}{during} without a message (killed, or out of memory)"
        self._ready.set()


def start_vehicle_process(
    vehicle: Vehicle | str | Path,
    mission: Mission | str | Path,
    *,
    endpoints: Sequence[Endpoint],
    path: str | Path | None = None,
    tlog: str | Path | None = None,
    wind: Sequence[float] | None = None,
    gust: float | None = None,
    seed: int = 0,
    sensors: SensorMode = "ideal",
    faults: Sequence[Fault] = (),
    controllers: ControlImplementation | None = None,
    designed_for: Vehicle | None = None,
    eye: CameraConfig | None = None,
    outside: bool = False,
    autostart: bool = False,
    system: int = 1,
    origin: GlobalOrigin | None = None,
    where: str = "endpoint",
    views: Sequence[LiveViewConfig] = (),
    on_stage: Callable[[str], None] | None = None,
) -> VehicleProcess:
    """Start a simulated vehicle in a process of its own, behind a MAVLink link, in real time.

    Parameters
    ----------
    vehicle, mission : Vehicle and Mission, or their names or files
    endpoints : sequence of Endpoint
    path, tlog : str or Path, optional
        Recording (MCAP) and telemetry log to write.
    wind, gust, seed, sensors, faults, controllers, designed_for, eye, outside
        As for :class:`mufly.flight.Flight`.
    autostart : bool
        Arm and fly the mission by itself.
    system : int
        MAVLink system of the vehicle, 1..255.
    origin : GlobalOrigin, optional
        Global position of N = E = D = 0.
    where : str
        Source of the endpoints, for error messages.
    views : sequence of LiveViewConfig
        Live views.
    on_stage : callable, optional
        Called from another thread with every stage of the start as it begins ("compiling the model").

    Returns
    -------
    VehicleProcess
        The process, which is starting; :meth:`VehicleProcess.wait_until_ready` waits for it, or raises its error.
    """
    order = {
        "vehicle": vehicle,
        "mission": mission,
        "endpoints": tuple(endpoints),
        "tlog": tlog,
        "autostart": autostart,
        "system": system,
        "origin": origin,
        "where": where,
        "views": tuple(views),
        "flight": {
            "path": path,
            "wind": None if wind is None else tuple(wind),
            "gust": gust,
            "seed": seed,
            "sensors": sensors,
            "faults": tuple(faults),
            "controllers": controllers,
            "designed_for": designed_for,
            "eye": eye,
            "outside": outside,
        },
    }
    return VehicleProcess(order, on_stage)


class _StatusPublisher:
    """Sender of a vehicle process's state and events to its parent process; drops them rather than wait."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._queue: queue.Queue[tuple[str, Any] | None] = queue.Queue(_MAX_QUEUED_REPORTS)
        self._thread = threading.Thread(target=self._flush_report_queue, daemon=True)
        self._thread.start()

    def __call__(self, kind: str, content: Any = None) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait((kind, content))

    def close(self) -> None:
        """Send the queued reports to the parent process, for at most about a second, and stop."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=1.0)
        self._thread.join(1.0)

    def _flush_report_queue(self) -> None:
        while (said := self._queue.get()) is not None:
            try:
                self._pipe.send(said)
            except (OSError, ValueError):
                return  # the parent has closed the pipe


def _run_vehicle_process(order: Mapping[str, Any], pipe: Connection) -> None:
    """Run the vehicle in its process."""
    asked = threading.Event()
    flying = threading.Event()

    def request_stop(*_: object) -> None:
        asked.set()
        if not flying.is_set():
            os._exit(0)  # designing and compiling cannot be interrupted soon, and no file is open yet

    # Ctrl-C and a closed terminal reach all processes; the parent decides, and requests the end.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, request_stop)
    tell = _StatusPublisher(pipe)

    wishes: deque[Fault | None] = deque()

    def receive_faults_from_pipe() -> None:
        with contextlib.suppress(EOFError, OSError):
            while (said := pipe.recv()) is not None:
                wishes.append(said[0])
        request_stop()

    threading.Thread(target=receive_faults_from_pipe, daemon=True).start()
    try:
        _fly_vehicle(order, tell, asked, flying, wishes)
    except MuflyError as error:
        tell("error", str(error))
    except OSError as error:
        tell("error", f"{error.filename or 'the vehicle'}: {error.strerror or error}")
    finally:
        tell.close()
    os._exit(0)  # all is closed; finalising the interpreter takes a second or more


def _inject_received_faults(flight: Flight, wishes: deque[Fault | None]) -> bool:
    """Inject the faults that the parent process sent (None clears all); return False: the flight continues."""
    while wishes:
        fault = wishes.popleft()
        try:
            flight.clear_faults() if fault is None else flight.inject_fault(fault)
        except MuflyError as error:
            flight.log_event(str(error), "warning")
    return False


def _fly_vehicle(
    order: Mapping[str, Any],
    tell: _StatusPublisher,
    asked: threading.Event,
    flying: threading.Event,
    wishes: deque[Fault | None],
) -> None:
    vehicle, mission = order["vehicle"], order["mission"]
    vehicle = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
    mission = mission if isinstance(mission, Mission) else load_mission(mission)
    tell("stage", STAGE_DESIGNING)
    controller = design_flight_controller(order["flight"]["designed_for"] or vehicle)
    tell("stage", STAGE_COMPILING)
    precompile_flight_code(vehicle, controller, order["flight"]["sensors"])
    tell("stage", "starting the camera" if order["flight"]["eye"] is not None else "starting the vehicle")
    flying.set()
    flight = Flight(vehicle, mission, controller=controller, keep=False, **order["flight"])
    if flight.camera is not None:
        flight.camera.on_map_view = lambda sight: tell("sight", sight)
    with flight, contextlib.ExitStack() as stack:
        log = None if order["tlog"] is None else stack.enter_context(TlogWriter(order["tlog"]))
        pace = fly_in_real_time(
            flight,
            order["endpoints"],
            link=VehicleLink(flight, system=order["system"], origin=order["origin"]),
            stop=lambda: _inject_received_faults(flight, wishes) or asked.is_set(),
            tlog=log,
            on_event=lambda event: tell("event", event),
            on_open=lambda: tell("ready"),
            on_notice=lambda line: tell("notice", line),
            on_report=lambda report: tell("report", report),
            autostart=order["autostart"],
            where=order["where"],
            views=order["views"],
        )
        outcome, reason = flight.judge_outcome()
        flight.close(outcome, reason, **pace.recording_attributes)
        tell("done", (outcome, reason))
