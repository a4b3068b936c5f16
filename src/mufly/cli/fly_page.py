"""``mufly fly`` in real time: the vehicle in a process of its own, and a page or other stations around it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mufly.cli.station import announce
from mufly.errors import MuflyError

if TYPE_CHECKING:
    from rich.console import Console

    from mufly.flight import Event
    from mufly.link import Endpoint, VehicleProcess
    from mufly.mission import Mission
    from mufly.station.page.address import Address
    from mufly.station.page.session import Session
    from mufly.vehicle import Vehicle

__all__ = ["Order", "fly_behind_link", "fly_with_page"]

LONELY_S = 20.0
"""With no page opened for so long it flies the mission by itself (s)."""
LEFT_S = 10.0
"""After the flight it ends when no page has been open for so long (s)."""
_LOOK_S = 0.1
_SETTLE_S = 1.0  # recorded after the motors have stopped


@dataclass(frozen=True)
class Order:
    """What is to be flown, checked; ``links`` are further places where stations may be."""

    vehicle: Vehicle
    mission: Mission
    recording: Path
    wind: list[float] | None
    gust: float | None
    seed: int
    links: tuple[Endpoint, ...]
    start: bool


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _start(order: Order, endpoints: Sequence[Endpoint], autostart: bool) -> VehicleProcess:
    from mufly.link import start_vehicle

    return start_vehicle(
        order.vehicle, order.mission, endpoints=endpoints, path=order.recording,
        tlog=order.recording.with_name("link.tlog") if order.links else None,
        wind=order.wind, gust=order.gust, seed=order.seed, autostart=autostart,
    )  # fmt: skip


class _Watch:
    """Follows a vehicle's process: shows its events, and knows when its flight is over."""

    def __init__(self, process: VehicleProcess, on_event: Callable[[Event], None]) -> None:
        self._process, self._on_event = process, on_event
        self.flown = False
        self._over_s: float | None = None

    def look(self) -> None:
        """Take what has come.

        Raises
        ------
        MuflyError
            If the vehicle's process has ended.
        """
        process = self._process
        while process.events:
            self._on_event(process.events.popleft())
        if process.error:
            raise MuflyError(process.error)
        if process.finished:
            raise MuflyError(f"the vehicle's process has ended; its recording may end early{_why(process)}")
        report = process.report
        if report is None:
            return
        self.flown = self.flown or (report.armed and report.height_m > 0.15)
        resting = self.flown and not report.armed
        if not resting:
            self._over_s = None
        elif self._over_s is None:
            self._over_s = time.monotonic()

    @property
    def over(self) -> bool:
        """Whether it has flown, and stands with its motors off."""
        return self._over_s is not None and time.monotonic() - self._over_s > _SETTLE_S


def _why(process: VehicleProcess) -> str:
    return f" ({process.reason})" if process.reason else ""


def fly_behind_link(order: Order, on_event: Callable[[Event], None], console: Console) -> None:
    """Fly the mission in real time with other stations watching, without a page."""
    for end in order.links:
        console.print(f"It {end.explanation}", highlight=False)
    process = _start(order, order.links, autostart=True)
    try:
        process.wait_ready()
        watch = _Watch(process, on_event)
        while not watch.over:
            time.sleep(_LOOK_S)
            watch.look()
    finally:
        process.stop()
        while process.events:
            on_event(process.events.popleft())


def fly_with_page(
    order: Order, address: Address, on_event: Callable[[Event], None], console: Console, browser: bool
) -> bool:
    """Fly with the station's page.

    Returns
    -------
    bool
        Whether it ended by itself; False: it was stopped (Ctrl-C).
    """
    from mufly.link import parse_endpoint
    from mufly.station import Station
    from mufly.station.page.server import serve
    from mufly.station.page.session import Session

    number = _free_port()
    process = _start(order, [parse_endpoint(f"udp:127.0.0.1:{number}", "vehicle"), *order.links], order.start)
    folder = order.recording.parent
    try:
        ground = Station(
            [parse_endpoint(f"udp:127.0.0.1:{number}", "station")], folder=folder, record_here=True,
            on_vehicle=lambda found: found.show_mission(order.mission),
        )  # fmt: skip
        session = Session(
            lambda: ground.vehicles, folder, mission=order.mission, recorder=ground.recorder,
            rotor_radius_m=float(order.vehicle.rotors.radius), title=f"mufly: {order.mission.name}",
        )  # fmt: skip
        watch = _Watch(process, on_event)

        async def work() -> bool:
            try:
                await ground.start()
                announce(address, [e.explanation for e in order.links])
                return not await serve(
                    session, address, open_browser=browser,
                    beside=lambda: _look_after(watch, process, session, order.start, console),
                )  # fmt: skip
            finally:
                await ground.stop()

        with contextlib.suppress(KeyboardInterrupt):
            return asyncio.run(work())
        return False
    finally:
        process.stop()
        while process.events:
            on_event(process.events.popleft())


async def _look_after(
    watch: _Watch,
    process: VehicleProcess,
    session: Session,
    started: bool,
    console: Console,
) -> None:
    """Return when the flight is over and nobody looks any more; fly the mission where nobody ever looked."""
    await asyncio.to_thread(process.wait_ready)
    began = last_seen = time.monotonic()
    seen = False
    while True:
        await asyncio.sleep(_LOOK_S)
        watch.look()
        now = time.monotonic()
        if session.watching:
            seen, last_seen = True, now
        vehicles = session.vehicles()
        if not seen and not started and now - began > LONELY_S and vehicles and not watch.flown:
            started = True
            console.print(f"No page was opened within {LONELY_S:g} s: the mission is flown without one")
            request = vehicles[0].start_mission()
            while not request.done:
                await asyncio.sleep(_LOOK_S)
                watch.look()
            if request.outcome != "accepted":
                raise MuflyError(f"the mission does not start: {request.answer}")
        if watch.over and not session.watching and (not seen or now - last_seen > LEFT_S):
            return
