"""The simulated vehicle in real time, in this process or in one of its own.

:func:`run_real_time` is the loop: the flight ticks by the wall clock, and the link is served between ticks. Tick ``k``
is due at ``start + k period``, counted from the start so that errors do not accumulate. Until then the loop sleeps in
the ports, which wake it on input.

After a stall (of the process or the machine) of up to :data:`MAX_CATCH_UP_S` the missed ticks follow at no more than
:data:`CATCH_UP_SPEED` times the normal pace, so that flight and stations see no burst. A longer stall is a timing
overrun: the vehicle's clock stops meanwhile. :class:`RealTimePacer` measures the real-time factor. It is published to
stations and stands in recording and summary. Events of the flight report when it falls below
:data:`mufly.link.telemetry_streams.SLOW_REAL_TIME_FACTOR`, and when it is restored.

:func:`start_vehicle` runs the vehicle in its own process, so that a page that draws and a vehicle that flies do not
wait for each other. A pipe connects it with the parent. The vehicle sends its events; the parent sends faults of
sensors, and ``None`` to end the flight. When the parent dies the pipe breaks, and the vehicle ends. However it ends
(request, Ctrl-C, termination, death of the parent), it finishes its recording.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

from mufly.control import FlightController, design_flight_controller
from mufly.errors import MuflyError
from mufly.flight import ALIGNMENT_TIMEOUT_S, Flight, FlightEvent, FlightState
from mufly.flight.fixes.camera_sensor import CameraConfig
from mufly.flight.flight_software import ControlImplementation
from mufly.link.codec import GlobalOrigin
from mufly.link.ports import MAX_STALL_S, Endpoint, Peer, Port, open_port, read_boot_clock, wait_readable
from mufly.link.telemetry_streams import SLOW_REAL_TIME_FACTOR
from mufly.link.vehicle_link import VehicleLink
from mufly.logs.tlog import TlogWriter
from mufly.mission import Mission, load_mission
from mufly.sensors import Fault
from mufly.slam import TrackedPicture
from mufly.vehicle import Vehicle, load_vehicle

SensorMode = Literal["ideal", "fitted"]
"""Sensors of a simulated vehicle (:class:`mufly.flight.Flight`)."""

MAX_CATCH_UP_S = 1.0
"""Longest stall that is made up for (s)."""
START_TIMEOUT_S = 120.0
"""Time without a new stage after which the start of a vehicle's process is given up (s)."""
CATCH_UP_SPEED = 2.0
"""Speed of the loop relative to real time while it makes up for a stall."""
PACE_WINDOW_S = 5.0
"""Averaging time of the real-time factor (s)."""
STAGE_DESIGNING, STAGE_COMPILING = "designing the controllers", "compiling the model"
"""Stages of a start; the second takes longest on a machine that has not compiled the model yet."""
_PACE_SAMPLE_PERIOD_S = 0.1
_REPORT_PERIOD_S = 0.2
_WARM_UP_S = 8.0
_READY_TIMEOUT_S = 3.0
_LATENESS_FILTER_GAIN = 0.02
_MAX_EVENTS = 1000
_MAX_QUEUED_REPORTS = 1000


@dataclass(frozen=True, slots=True)
class LoopReport:
    """The state of the loop, for a display.

    Attributes
    ----------
    state : FlightState
    commander : str
        Commander as text, or "".
    received_rate_Hz, sent_rate_Hz : float
        Messages per second.
    mean_lateness_ms, worst_lateness_ms : float
        Delay of ticks (ms): recent mean, and maximum since the last report.
    lost_time_s : float
        Skipped time since the start (s).
    slip_count : int
        Number of skipped stretches of time.
    real_time_factor : float
        Simulated seconds per second of wall-clock time, over the last :data:`PACE_WINDOW_S`; NaN in the first window.
    """

    state: FlightState
    commander: str
    received_rate_Hz: float
    sent_rate_Hz: float
    mean_lateness_ms: float
    worst_lateness_ms: float
    lost_time_s: float
    slip_count: int = 0
    real_time_factor: float = math.nan


class RealTimePacer:
    """Timer of the loop's ticks, with a measure of real time kept.

    Parameters
    ----------
    now_s : float
    period_s : float

    Attributes
    ----------
    next_tick_s : float
        Wall-clock time of the next tick (s).
    lost_time_s : float
        Skipped time (s).
    slip_count : int
        Number of skipped stretches of time.
    real_time_factor : float
        Simulated seconds per second of wall-clock time, over the last :data:`PACE_WINDOW_S`; NaN in the first window.
        Above 1 while a stall is made up for.
    min_real_time_factor : float
        Minimum of the factor so far.
    mean_lateness_s, worst_lateness_s : float
        Delay of ticks (s): recent mean, and maximum so far.
    """

    def __init__(self, now_s: float, period_s: float) -> None:
        self.period_s = period_s
        self.next_tick_s = now_s
        self.lost_time_s = self.mean_lateness_s = self.worst_lateness_s = 0.0
        self.slip_count = 0
        self.real_time_factor, self.min_real_time_factor = math.nan, math.inf
        self._last_s = -1e9
        self._began_s, self._ticks = now_s, 0
        self._marks = deque([(now_s, 0)])  # (time, number of ticks made), since before the window
        self._slow, self._whole_s = False, now_s

    def sleep_time_s(self, now_s: float) -> float:
        """Return the sleep time until the next tick (s)."""
        # While catching up, ticks keep a distance.
        return max(self.next_tick_s, self._last_s + self.period_s / CATCH_UP_SPEED) - now_s

    def record_tick(self, now_s: float) -> None:
        """Record that a tick happens now."""
        late = max(0.0, now_s - self.next_tick_s)
        if late > MAX_CATCH_UP_S:
            self.lost_time_s += late
            self.slip_count += 1
            self.next_tick_s = now_s
        self.mean_lateness_s += _LATENESS_FILTER_GAIN * (late - self.mean_lateness_s)
        self.worst_lateness_s = max(self.worst_lateness_s, late)
        self.next_tick_s += self.period_s
        self._last_s = now_s
        self._ticks += 1
        if now_s - self._marks[-1][0] >= _PACE_SAMPLE_PERIOD_S:
            self._measure_pace(now_s)

    def _measure_pace(self, now_s: float) -> None:
        marks = self._marks
        marks.append((now_s, self._ticks))
        while len(marks) > 2 and marks[1][0] <= now_s - PACE_WINDOW_S:
            marks.popleft()
        if now_s - self._began_s >= PACE_WINDOW_S:
            since_s, ticks = marks[0]
            self.real_time_factor = (self._ticks - ticks) * self.period_s / (now_s - since_s)
            self.min_real_time_factor = min(self.real_time_factor, self.min_real_time_factor)

    def mean_real_time_factor(self) -> float:
        """Return simulated seconds per second of wall-clock time, from the start to the last tick; NaN before that."""
        spent_s = self._last_s - self._began_s
        return self._ticks * self.period_s / (spent_s + self.period_s) if self._ticks else math.nan

    def take_notice(self, now_s: float) -> str:
        """Return a message when the loop falls behind real time, or is back in it for a whole window; else ""."""
        if self.real_time_factor < SLOW_REAL_TIME_FACTOR:
            self._whole_s = now_s
            if not self._slow:
                self._slow = True
                return (
                    f"slower than real time: factor {self.real_time_factor:.2f} over the last "
                    f"{PACE_WINDOW_S:g} s{self.loss_text}"
                )
        elif self._slow and now_s - self._whole_s > PACE_WINDOW_S:
            self._slow = False
            return f"in real time again{self.loss_text}"
        return ""

    @property
    def loss_text(self) -> str:
        """Return the count of overruns and the dropped time as the end of a sentence; "" without overruns."""
        overruns = f"{self.slip_count} timing overrun{'s' if self.slip_count > 1 else ''}"
        return f"; {overruns}, {self.lost_time_s:.1f} s dropped since the start" if self.slip_count else ""

    @property
    def recording_attributes(self) -> dict[str, Any]:
        """Return the figures for a recording."""
        overall = self.mean_real_time_factor()
        least = min(self.min_real_time_factor, overall)
        return {"realtime_factor": overall, "realtime_factor_least": least, "slips": self.slip_count}


class _PortGroup:
    """The ports, and the port of each peer."""

    def __init__(self, ports: Sequence[Port], tlog: TlogWriter | None, clock: Callable[[], float]) -> None:
        self.ports, self._tlog, self._clock = ports, tlog, clock
        self._by_name = {str(port.endpoint): port for port in ports}
        self._heard_s = clock()

    def receive(self, link: VehicleLink, now_s: float) -> None:
        came = [one for port in self.ports for one in port.receive()]
        # The process may be suspended at any line, so the clock is read after the bytes.
        stood_s = (self._clock() if came else now_s) - self._heard_s
        self._heard_s = now_s
        if stood_s > MAX_STALL_S and self.ports:
            for port in self.ports:
                port.discard_input()
            link.resume_after_stall(now_s)
            link.flight.log_event(
                f"simulation stalled for {stood_s:.1f} s; requests of that time are dropped", "warning"
            )
            came = []
        for peer, data in came:
            link.receive(now_s, peer, data)
        for port in self.ports:
            for peer in port.call_targets:
                link.add_peer(now_s, peer)

    def send(self, link: VehicleLink, now_s: float) -> None:
        logged: set[bytes] = set()
        for out in link.step(now_s):
            peer = out.peer
            if isinstance(peer, Peer):
                self._by_name[peer.endpoint].send(peer, out.data)
                if self._tlog is not None:
                    # Peers get the same frames with different numbers: equal from the sender id to the checksum.
                    content = out.data[5:-2]
                    if content not in logged:
                        logged.add(content)
                        self._tlog.write_packet(out.data)


def warm_up(vehicle: Vehicle, controller: FlightController, sensors: SensorMode = "ideal") -> None:
    """Fly a few seconds without output, so that everything is compiled before the clock starts.

    Parameters
    ----------
    vehicle : Vehicle
    controller : FlightController
    sensors : "ideal" or "fitted"
    """
    flight = Flight(vehicle, Mission(name="warm-up"), controller=controller, keep=False, sensors=sensors)
    while flight.uses_fitted_sensors and flight.autopilot.list_arming_faults() and flight.time_s < _READY_TIMEOUT_S:
        flight.step_period()
    flight.autopilot.arm()
    flight.autopilot.take_off()
    for k in range(round(_WARM_UP_S / flight.period_s)):
        flight.step_period()
        if k == round(0.9 * _WARM_UP_S / flight.period_s):
            flight.autopilot.go_to((0.2, 0.0, -1.0))
    flight.close()


def run_real_time(
    flight: Flight,
    endpoints: Sequence[Endpoint],
    *,
    stop: Callable[[], bool],
    link: VehicleLink | None = None,
    tlog: TlogWriter | None = None,
    on_event: Callable[[FlightEvent], None] | None = None,
    on_open: Callable[[], None] | None = None,
    on_notice: Callable[[str], None] | None = None,
    on_report: Callable[[LoopReport], None] | None = None,
    autostart: bool = False,
    where: str = "endpoint",
    clock: Callable[[], float] = read_boot_clock,
) -> RealTimePacer:
    """Fly in real time behind a MAVLink link, until told to stop.

    Parameters
    ----------
    flight : Flight
        Flight, which is not closed here.
    endpoints : sequence of Endpoint
        Endpoints of the link. None: a flight without a link.
    stop : callable
        Called before every tick; true ends the flight.
    link : VehicleLink, optional
        By default system 1, component 1.
    tlog : TlogWriter, optional
        Log of received and sent messages, each written once for all peers. It is not closed here.
    on_event, on_notice : callable, optional
        Called with every event of the flight; with a text line for every event of a port.
    on_open : callable, optional
        Called once all endpoints are open.
    on_report : callable, optional
        Called with a :class:`LoopReport` five times a second.
    autostart : bool
        Arm and fly the mission by itself, as soon as it is ready.
    where : str
        Source of the endpoints, for error messages.
    clock : callable
        Wall clock (s).

    Returns
    -------
    RealTimePacer
        Timing of the flight, with the real time kept.

    Raises
    ------
    InputError
        If an endpoint cannot be opened.
    """
    link = VehicleLink(flight) if link is None else link
    with contextlib.ExitStack() as stack:
        ports = []
        for endpoint in endpoints:
            ports.append(open_port(endpoint, where))
            stack.callback(ports[-1].close)
        if on_event is not None:
            flight.autopilot.listeners.append(on_event)
            stack.callback(flight.autopilot.listeners.remove, on_event)
        if on_open is not None:
            on_open()
        if tlog is not None:
            link.on_received = tlog.write_packet
        wire, period_s = _PortGroup(ports, tlog, clock), flight.period_s
        pace, report_s, counted = RealTimePacer(clock(), period_s), clock(), (0, 0)
        start_within_s = ALIGNMENT_TIMEOUT_S if flight.uses_fitted_sensors else _READY_TIMEOUT_S
        while not stop():
            now_s = clock()
            rest = pace.sleep_time_s(now_s)
            while rest > 0.0:
                wait_readable(ports, rest)
                now_s = clock()
                wire.receive(link, now_s)
                rest = pace.sleep_time_s(now_s)
            pace.record_tick(now_s)
            link.real_time_factor, link.slip_count = pace.real_time_factor, pace.slip_count
            if news := pace.take_notice(now_s):
                flight.log_event(news, "warning" if pace.real_time_factor < SLOW_REAL_TIME_FACTOR else "info")
            wire.receive(link, now_s)
            if autostart and (flight.time_s > start_within_s or not flight.autopilot.list_arming_faults()):
                autostart = False
                _start_mission(flight)
            flight.step_period()
            wire.send(link, now_s)
            if now_s - report_s >= _REPORT_PERIOD_S:
                spent, report_s = now_s - report_s, now_s
                if on_notice is not None:
                    for line in (line for port in ports for line in port.take_notices()):
                        on_notice(line)
                if on_report is not None:
                    on_report(_make_report(flight, link, pace, spent, counted))
                counted = (link.received_count, link.sent_count)
                pace.worst_lateness_s = 0.0
    return pace


def _start_mission(flight: Flight) -> None:
    answer = flight.autopilot.arm()
    if answer:
        answer = flight.autopilot.start_mission()
    if not answer:
        flight.log_event(f"the mission does not start: {answer.reason}", "warning")


def _make_report(
    flight: Flight, link: VehicleLink, pace: RealTimePacer, spent_s: float, before: tuple[int, int]
) -> LoopReport:
    commander = link.authority.commander
    return LoopReport(
        state=flight.status,
        commander="" if commander is None else str(commander),
        received_rate_Hz=(link.received_count - before[0]) / spent_s,
        sent_rate_Hz=(link.sent_count - before[1]) / spent_s,
        mean_lateness_ms=pace.mean_lateness_s * 1e3,
        worst_lateness_ms=pace.worst_lateness_s * 1e3,
        lost_time_s=pace.lost_time_s,
        slip_count=pace.slip_count,
        real_time_factor=pace.real_time_factor,
    )


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
        self.events: deque[FlightEvent] = deque(maxlen=_MAX_EVENTS)
        self.notices: deque[str] = deque(maxlen=_MAX_EVENTS)
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
        """Number of the process."""
        return self._process.pid

    @property
    def is_ready(self) -> bool:
        """Return whether the vehicle listens and ticks.

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
                f"the vehicle did not start: {self.stage} took more than {START_TIMEOUT_S:g} s; "
                "is the machine very busy?"
            )
        return False

    def wait_until_ready(self) -> None:
        """Wait until the vehicle listens and ticks.

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
        self._send_fault(fault)

    def clear_faults(self) -> None:
        """Clear all sensor faults."""
        self._send_fault(None)

    def _send_fault(self, fault: Fault | None) -> None:
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
            self.error = f"the vehicle's process ended {when}{during}, without a word (killed, or out of memory?)"
        self._ready.set()


def start_vehicle(
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
    """Publisher of the vehicle's state to its parent, which never blocks."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._queue: queue.Queue[tuple[str, Any] | None] = queue.Queue(_MAX_QUEUED_REPORTS)
        self._thread = threading.Thread(target=self._send_queue, daemon=True)
        self._thread.start()

    def __call__(self, kind: str, content: Any = None) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait((kind, content))

    def close(self) -> None:
        """Send the remaining queue, for at most a second."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=1.0)
        self._thread.join(1.0)

    def _send_queue(self) -> None:
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

    def read_faults() -> None:
        with contextlib.suppress(EOFError, OSError):
            while (said := pipe.recv()) is not None:
                wishes.append(said[0])
        request_stop()

    threading.Thread(target=read_faults, daemon=True).start()
    try:
        _fly_vehicle(order, tell, asked, flying, wishes)
    except MuflyError as error:
        tell("error", str(error))
    except OSError as error:
        tell("error", f"{error.filename or 'the vehicle'}: {error.strerror or error}")
    finally:
        tell.close()
    os._exit(0)  # all is closed; finalising the interpreter takes a second or more


def _handle_faults(flight: Flight, wishes: deque[Fault | None]) -> bool:
    """Inject the faults that the parent sent (None: clear all); return False, which ends no flight."""
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
    warm_up(vehicle, controller, order["flight"]["sensors"])
    tell("stage", "starting the camera" if order["flight"]["eye"] is not None else "starting the vehicle")
    flying.set()
    flight = Flight(vehicle, mission, controller=controller, keep=False, **order["flight"])
    if flight.camera is not None:
        flight.camera.on_map_view = lambda sight: tell("sight", sight)
    with flight, contextlib.ExitStack() as stack:
        log = None if order["tlog"] is None else stack.enter_context(TlogWriter(order["tlog"]))
        pace = run_real_time(
            flight,
            order["endpoints"],
            link=VehicleLink(flight, system=order["system"], origin=order["origin"]),
            stop=lambda: _handle_faults(flight, wishes) or asked.is_set(),
            tlog=log,
            on_event=lambda event: tell("event", event),
            on_open=lambda: tell("ready"),
            on_notice=lambda line: tell("notice", line),
            on_report=lambda report: tell("report", report),
            autostart=order["autostart"],
            where=order["where"],
        )
        outcome, reason = flight.judge_outcome()
        flight.close(outcome, reason, **pace.recording_attributes)
        tell("done", (outcome, reason))
