"""The loop of a simulated vehicle in real time.

:func:`fly_in_real_time` is the loop: the flight ticks by the wall clock, and the link is served between ticks. Tick
``k`` is due at ``start + k period``, counted from the start so that errors do not accumulate. Until then the loop
sleeps in the ports, which wake it on input.

After a stall (of the process or the machine) of up to :data:`MAX_CAUGHT_UP_STALL_S` the missed ticks follow at no more
than :data:`CATCH_UP_SPEED_FACTOR` times the normal pace, so that flight and stations see no burst. A longer stall is a
timing overrun: the vehicle's clock stops meanwhile. :class:`RealTimePacer` measures the real-time factor. It is
published to stations and stands in recording and summary. Events of the flight report when it falls below
:data:`mufly.link.telemetry_streams.SLOW_REAL_TIME_FACTOR`, and when it is restored.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from mufly.control import FlightController
from mufly.flight import ALIGNMENT_TIMEOUT_S, Flight, FlightEvent, FlightState
from mufly.flight.record.live_view import LiveViewConfig
from mufly.link.ports import MAX_REQUEST_AGE_S, Endpoint, Peer, Port, open_port, read_boot_clock, wait_for_input
from mufly.link.telemetry_streams import SLOW_REAL_TIME_FACTOR
from mufly.link.vehicle_link import VehicleLink
from mufly.logs.tlog import TlogWriter
from mufly.mission import Mission
from mufly.vehicle import Vehicle

SensorMode = Literal["ideal", "fitted"]
"""Sensors of a simulated vehicle (:class:`mufly.flight.Flight`)."""

MAX_CAUGHT_UP_STALL_S = 1.0
"""Longest stall that is made up for (s)."""
CATCH_UP_SPEED_FACTOR = 2.0
"""Speed of the loop relative to real time while it makes up for a stall."""
PACE_WINDOW_S = 5.0
"""Averaging time of the real-time factor (s)."""
_PACE_SAMPLE_PERIOD_S = 0.1
_REPORT_PERIOD_S = 0.2
_WARM_UP_FLIGHT_TIME_S = 8.0
_READY_TIMEOUT_S = 3.0
_LATENESS_FILTER_GAIN = 0.02
_FRAME_CONTENT_SLICE = slice(5, -2)  # bytes of a MAVLink frame after its number


@dataclass(frozen=True, slots=True)
class LoopReport:
    """State of a simulated vehicle's real-time loop, for a display.

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
    """Timer that says when the next tick of a real-time loop is due, and measures how far the loop lags.

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
        return max(self.next_tick_s, self._last_s + self.period_s / CATCH_UP_SPEED_FACTOR) - now_s

    def record_tick(self, now_s: float) -> None:
        """Record that a tick happens now."""
        late = max(0.0, now_s - self.next_tick_s)
        if late > MAX_CAUGHT_UP_STALL_S:
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

    def take_pace_warning(self, now_s: float) -> str:
        """Return a text when the loop falls behind real time, or has kept up again for ``PACE_WINDOW_S``; else ""."""
        if self.real_time_factor < SLOW_REAL_TIME_FACTOR:
            self._whole_s = now_s
            if not self._slow:
                self._slow = True
                return (
                    f"slower than real time: factor {self.real_time_factor:.2f} over the last "
                    f"{PACE_WINDOW_S:g} s{self.overrun_summary}"
                )
        elif self._slow and now_s - self._whole_s > PACE_WINDOW_S:
            self._slow = False
            return f"in real time again{self.overrun_summary}"
        return ""

    @property
    def overrun_summary(self) -> str:
        """Return a text on the number of overruns and the dropped time, to end a sentence; "" without overruns."""
        overruns = f"{self.slip_count} timing overrun{'s' if self.slip_count > 1 else ''}"
        return f"; {overruns}, {self.lost_time_s:.1f} s dropped since the start" if self.slip_count else ""

    @property
    def recording_attributes(self) -> dict[str, Any]:
        """Return mean and least real-time factor and the number of timing overruns, as attributes of a recording."""
        overall = self.mean_real_time_factor()
        least = min(self.min_real_time_factor, overall)
        return {"realtime_factor": overall, "realtime_factor_least": least, "slips": self.slip_count}


class _PortGroup:
    """The open ports of a vehicle: receives from all of them, and sends each frame by the port of its peer."""

    def __init__(self, ports: Sequence[Port], tlog: TlogWriter | None, clock: Callable[[], float]) -> None:
        self.ports, self._tlog, self._clock = ports, tlog, clock
        self._by_name = {str(port.endpoint): port for port in ports}
        self._heard_s = clock()

    def pass_received_bytes(self, link: VehicleLink, now_s: float) -> None:
        came = [one for port in self.ports for one in port.receive_bytes()]
        # The process may be suspended at any line, so the clock is read after the bytes.
        stood_s = (self._clock() if came else now_s) - self._heard_s
        self._heard_s = now_s
        if stood_s > MAX_REQUEST_AGE_S and self.ports:
            for port in self.ports:
                port.discard_input()
            link.resume_after_stall(now_s)
            link.flight.log_event(
                f"simulation stalled for {stood_s:.1f} s; requests received in that time are dropped", "warning"
            )
            came = []
        for peer, data in came:
            link.process_bytes(now_s, peer, data)
        for port in self.ports:
            for peer in port.configured_targets:
                link.add_peer(now_s, peer)

    def send_due_frames(self, link: VehicleLink, now_s: float) -> None:
        logged: set[bytes] = set()
        for out in link.take_due_frames(now_s):
            peer = out.peer
            if isinstance(peer, Peer):
                self._by_name[peer.endpoint].send_frame(peer, out.data)
                if self._tlog is not None:
                    # Peers get the same frames with different numbers.
                    content = out.data[_FRAME_CONTENT_SLICE]
                    if content not in logged:
                        logged.add(content)
                        self._tlog.write_packet(out.data)


def precompile_flight_code(vehicle: Vehicle, controller: FlightController, sensors: SensorMode = "ideal") -> None:
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
    for k in range(round(_WARM_UP_FLIGHT_TIME_S / flight.period_s)):
        flight.step_period()
        if k == round(0.9 * _WARM_UP_FLIGHT_TIME_S / flight.period_s):
            flight.autopilot.go_to((0.2, 0.0, -1.0))
    flight.close()


def fly_in_real_time(
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
    views: Sequence[LiveViewConfig] = (),
    clock: Callable[[], float] = read_boot_clock,
) -> RealTimePacer:
    """Fly in real time behind a MAVLink link, until a stop is requested.

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
    views : sequence of LiveViewConfig
        Live views; their requests are carried out before a tick.
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
        shown = []
        for view in views:
            shown.append(view.open_view(flight))
            stack.callback(shown[-1].close)
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
                wait_for_input(ports, rest)
                now_s = clock()
                wire.pass_received_bytes(link, now_s)
                rest = pace.sleep_time_s(now_s)
            pace.record_tick(now_s)
            link.real_time_factor, link.slip_count = pace.real_time_factor, pace.slip_count
            if news := pace.take_pace_warning(now_s):
                flight.log_event(news, "warning" if pace.real_time_factor < SLOW_REAL_TIME_FACTOR else "info")
            wire.pass_received_bytes(link, now_s)
            for one in shown:
                one.serve_requests()
            if autostart and (flight.time_s > start_within_s or not flight.autopilot.list_arming_faults()):
                autostart = False
                _start_mission(flight)
            flight.step_period()
            wire.send_due_frames(link, now_s)
            if now_s - report_s >= _REPORT_PERIOD_S:
                spent, report_s = now_s - report_s, now_s
                if on_notice is not None:
                    for line in (line for port in ports for line in port.take_notices()):
                        on_notice(line)
                if on_report is not None:
                    on_report(_make_loop_report(flight, link, pace, spent, counted))
                counted = (link.received_count, link.sent_count)
                pace.worst_lateness_s = 0.0
    return pace


def _start_mission(flight: Flight) -> None:
    answer = flight.autopilot.arm()
    if answer:
        answer = flight.autopilot.start_mission()
    if not answer:
        flight.log_event(f"the mission does not start: {answer.reason}", "warning")


def _make_loop_report(
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
