"""The loop in real time: the flight ticks by the clock on the wall, and in between the link is served.

Tick ``k`` is due at ``start + k period``, counted from the start so that errors do not add up. Until it is due the
loop sleeps in the ports, and hears at once what comes in. After a stall (the machine was busy, or asleep) of up to
:data:`CATCH_UP_S` the ticks that were missed follow at no more than :data:`HURRY` times the normal pace, so that
neither the flight nor its stations see a burst; a longer one is not made up for: the clock of the vehicle stood still
meanwhile.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mufly.link.endpoint import Endpoint
from mufly.link.ports import Peer, Port, open_port, wait
from mufly.link.tlog import TlogWriter
from mufly.link.vehicle import VehicleLink

if TYPE_CHECKING:
    from mufly.control import FlightController
    from mufly.flight import Event, Flight
    from mufly.vehicle import Vehicle

__all__ = ["Pace", "Report", "run", "warm_up"]

CATCH_UP_S = 1.0
"""Stalls up to so long are made up for (s)."""
HURRY = 2.0
"""How much faster than real time the loop goes while it makes up for a stall."""
_REPORT_S = 0.2
_WARM_UP_S = 8.0
_START_WITHIN_S = 3.0
_LATE_BLEND = 0.02


@dataclass(frozen=True, slots=True)
class Report:
    """How the loop is doing, for a display.

    Attributes
    ----------
    time_s : float
        The vehicle's clock.
    state, outcome, commander : str
        Of the mission, of the flight ("" while it is open); who commands, or "".
    armed : bool
    height_m, battery_V : float
    received_Hz, sent_Hz : float
        Messages a second.
    late_ms, worst_ms : float
        How late ticks are: lately on average, and the worst since the last report.
    slipped_s : float
        Time that was not made up for, since the start.
    """

    time_s: float
    state: str
    outcome: str
    commander: str
    armed: bool
    height_m: float
    battery_V: float
    received_Hz: float
    sent_Hz: float
    late_ms: float
    worst_ms: float
    slipped_s: float


class Pace:
    """When the next tick is due.

    Parameters
    ----------
    now_s : float
    period_s : float

    Attributes
    ----------
    due_s : float
        When the next tick is due by the clock on the wall.
    slipped_s : float
        Time that was given up.
    late_s, worst_s : float
        How late ticks are: lately on average, and the worst so far.
    """

    def __init__(self, now_s: float, period_s: float) -> None:
        self.period_s = period_s
        self.due_s = now_s
        self.slipped_s = self.late_s = self.worst_s = 0.0
        self._last_s = -1e9

    def wait_s(self, now_s: float) -> float:
        """How long to sleep until the next tick (s)."""
        # While hurrying, ticks are still some time apart.
        return max(self.due_s, self._last_s + self.period_s / HURRY) - now_s

    def tick(self, now_s: float) -> None:
        """A tick happens now."""
        late = max(0.0, now_s - self.due_s)
        if late > CATCH_UP_S:
            self.slipped_s += late
            self.due_s = now_s
        self.late_s += _LATE_BLEND * (late - self.late_s)
        self.worst_s = max(self.worst_s, late)
        self.due_s += self.period_s
        self._last_s = now_s


class _Wire:
    """The ports, and who is behind each peer."""

    def __init__(self, ports: Sequence[Port], tlog: TlogWriter | None) -> None:
        self.ports, self._tlog = ports, tlog
        self._by_name = {str(port.endpoint): port for port in ports}

    def receive(self, link: VehicleLink, now_s: float) -> None:
        for port in self.ports:
            for peer, data in port.receive():
                link.receive(now_s, peer, data)
            for peer in port.targets:
                link.connect(now_s, peer)

    def send(self, link: VehicleLink, now_s: float) -> None:
        logged: set[bytes] = set()
        for out in link.step(now_s):
            peer = out.peer
            if isinstance(peer, Peer):
                self._by_name[peer.endpoint].send(peer, out.data)
                if self._tlog is not None:
                    # Several peers get the same, numbered differently: the same from the sender to the checksum.
                    content = out.data[5:-2]
                    if content not in logged:
                        logged.add(content)
                        self._tlog.write(out.data)

    def close(self) -> None:
        for port in self.ports:
            port.close()


def warm_up(vehicle: Vehicle, controller: FlightController) -> None:
    """Fly a few seconds that nobody sees, so that everything is compiled before the clock runs.

    Parameters
    ----------
    vehicle : Vehicle
    controller : FlightController
    """
    from mufly.flight import Flight
    from mufly.mission import Mission

    flight = Flight(vehicle, Mission(name="warm-up"), controller=controller, keep=False)
    flight.autopilot.arm()
    flight.autopilot.take_off()
    for k in range(round(_WARM_UP_S / flight.period_s)):
        flight.tick()
        if k == round(0.9 * _WARM_UP_S / flight.period_s):
            flight.autopilot.go_to((0.2, 0.0, -1.0))
    flight.close()


def run(
    flight: Flight,
    endpoints: Sequence[Endpoint],
    *,
    stop: Callable[[], bool],
    link: VehicleLink | None = None,
    tlog: TlogWriter | None = None,
    on_event: Callable[[Event], None] | None = None,
    on_open: Callable[[], None] | None = None,
    on_notice: Callable[[str], None] | None = None,
    on_report: Callable[[Report], None] | None = None,
    autostart: bool = False,
    where: str = "--link",
) -> None:
    """Fly in real time behind a MAVLink link, until told to stop.

    Parameters
    ----------
    flight : Flight
        Not closed here.
    endpoints : sequence of Endpoint
        Where stations are, or may call. None: nobody listens, it only flies.
    stop : callable
        Asked before every tick.
    link : VehicleLink, optional
        By default system 1, component 1.
    tlog : TlogWriter, optional
        Takes what is heard and what is said, once however many peers it goes to. Not closed here.
    on_event, on_notice : callable, optional
        Called with every event of the flight; with a line when something happens to a port.
    on_open : callable, optional
        Called once all endpoints are open.
    on_report : callable, optional
        Called with a :class:`Report` five times a second.
    autostart : bool
        Arm and fly the mission by itself, as soon as it is ready.
    where : str
        Option that names the endpoints, for the message of an error.

    Raises
    ------
    InputError
        If an endpoint cannot be opened.
    """
    link = VehicleLink(flight) if link is None else link
    ports: list[Port] = []
    try:
        for endpoint in endpoints:
            ports.append(open_port(endpoint, where))
        if on_event is not None:
            flight.autopilot.listeners.append(on_event)
        if on_open is not None:
            on_open()
        if tlog is not None:
            link.on_received = tlog.write
        _loop(flight, link, _Wire(ports, tlog), stop, on_notice, on_report, autostart)
    finally:
        if on_event is not None and on_event in flight.autopilot.listeners:
            flight.autopilot.listeners.remove(on_event)
        for port in ports:
            port.close()


def _loop(
    flight: Flight,
    link: VehicleLink,
    wire: _Wire,
    stop: Callable[[], bool],
    on_notice: Callable[[str], None] | None,
    on_report: Callable[[Report], None] | None,
    autostart: bool,
) -> None:
    pace = Pace(time.monotonic(), flight.period_s)
    report_s, counted = time.monotonic(), (0, 0)
    while not stop():
        now_s = time.monotonic()
        rest = pace.wait_s(now_s)
        while rest > 0.0:
            wait(wire.ports, rest)
            now_s = time.monotonic()
            wire.receive(link, now_s)
            rest = pace.wait_s(now_s)
        pace.tick(now_s)
        wire.receive(link, now_s)
        if autostart and (flight.time_s > _START_WITHIN_S or not flight.autopilot.not_ready()):
            autostart = False
            _start(flight)
        flight.tick()
        wire.send(link, now_s)
        if now_s - report_s >= _REPORT_S:
            spent, report_s = now_s - report_s, now_s
            if on_notice is not None:
                for port in wire.ports:
                    for line in port.notices():
                        on_notice(line)
            if on_report is not None:
                on_report(_report(flight, link, pace, spent, counted))
            counted = (link.received, link.sent)
            pace.worst_s = 0.0


def _start(flight: Flight) -> None:
    answer = flight.autopilot.arm()
    if answer:
        answer = flight.autopilot.start_mission()
    if not answer:
        flight.note(f"the mission does not start: {answer.reason}", "warning")


def _report(flight: Flight, link: VehicleLink, pace: Pace, spent_s: float, before: tuple[int, int]) -> Report:
    view, status, commander = flight.view, flight.autopilot.status, link.authority.commander
    return Report(
        time_s=flight.time_s,
        state=status.state,
        outcome=status.outcome,
        commander="" if commander is None else str(commander),
        armed=status.armed,
        height_m=-float(view.position[2]),
        battery_V=view.battery_voltage,
        received_Hz=(link.received - before[0]) / spent_s,
        sent_Hz=(link.sent - before[1]) / spent_s,
        late_ms=pace.late_s * 1e3,
        worst_ms=pace.worst_s * 1e3,
        slipped_s=pace.slipped_s,
    )
