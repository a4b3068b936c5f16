"""A simulated vehicle in a separate process, operated from the station's page or from other ground stations."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mufly.errors import MuflyError
from mufly.link import Endpoint, VehicleProcess, parse_endpoint

if TYPE_CHECKING:
    from mufly.flight import FlightEvent
    from mufly.mission import Mission
    from mufly.station.page.page_address import PageAddress
    from mufly.station.page.page_session import StationSession
    from mufly.station.page.start_page import StartPage, Startup
    from mufly.vehicle import Vehicle

NO_PAGE_TIMEOUT_S = 20.0
"""Time without an open page after which the mission starts by itself (s)."""
PAGE_CLOSED_TIMEOUT_S = 10.0
"""Time without an open page after which the session ends, once the flight is over (s)."""
_POLL_INTERVAL_S = 0.1
_ERROR_DISPLAY_S = 2.0  # an open page shows what went wrong before its server ends
_MOTORS_OFF_RECORDING_S = 1.0  # recorded after the motors have stopped


class FlightMonitor:
    """Monitor of a simulated vehicle's process: forwards its events and detects the end of its flight.

    Parameters
    ----------
    process : VehicleProcess
    on_event : callable
        Called with each event of the flight.
    """

    def __init__(self, process: VehicleProcess, on_event: Callable[[FlightEvent], None]) -> None:
        self._process, self._on_event = process, on_event
        self.has_flown = False
        self._over_s: float | None = None

    def process_events(self) -> None:
        """Process the messages received from the vehicle's process.

        Raises
        ------
        MuflyError
            If the vehicle's process has ended.
        """
        process = self._process
        self._forward_events()
        if process.error:
            raise MuflyError(process.error)
        if process.is_finished:
            reason = f" ({process.reason})" if process.reason else ""
            raise MuflyError(f"the vehicle's process has ended; its recording may end early{reason}")
        report = process.report
        if report is None:
            return
        state = report.state
        self.has_flown = self.has_flown or (state.armed and -state.estimate.position[2] > 0.15)
        resting = self.has_flown and not state.armed
        if not resting:
            self._over_s = None
        elif self._over_s is None:
            self._over_s = time.monotonic()

    @property
    def is_over(self) -> bool:
        """Whether the vehicle has flown and stands with its motors off."""
        return self._over_s is not None and time.monotonic() - self._over_s > _MOTORS_OFF_RECORDING_S

    def stop_process(self) -> str:
        """End the process; return the outcome of the flight, "" if there was none."""
        self._process.stop()
        self._forward_events()
        return self._process.outcome if self.has_flown else ""

    def _forward_events(self) -> None:
        while self._process.events:
            self._on_event(self._process.events.popleft())


def fly_without_page(
    process: VehicleProcess,
    startup: Startup,
    *,
    on_event: Callable[[FlightEvent], None],
    stop: Callable[[], bool],
) -> str:
    """Follow a flight that starts by itself, without a page; return its outcome, "" if there was none."""
    monitor = FlightMonitor(process, on_event)
    try:
        while not (monitor.is_over or stop()):
            time.sleep(_POLL_INTERVAL_S)
            if process.is_ready:
                startup.mark_succeeded()
                monitor.process_events()
    finally:
        outcome = monitor.stop_process()
    return outcome


@dataclass(frozen=True)
class PageFlight:
    """A flight operated from the station's page.

    Attributes
    ----------
    process : VehicleProcess
        Process of the vehicle; its first endpoint is ``list_vehicle_endpoints(port)``.
    vehicle : Vehicle
    mission : Mission
    port : int
        UDP port between the vehicle and the station of the page.
    folder : Path
        Folder for the station's recordings.
    startup : Startup
    starts_at_once : bool
        Whether the mission starts without a command from the page.
    has_camera : bool
        Whether the vehicle's process runs SLAM on pictures of a camera.
    on_event, on_notice : callable
        Called with each event of the flight, and with each notice about the session (text).
    should_stop : callable
        Returns whether the session should end.
    """

    process: VehicleProcess
    vehicle: Vehicle
    mission: Mission
    port: int
    folder: Path
    startup: Startup
    starts_at_once: bool
    has_camera: bool
    on_event: Callable[[FlightEvent], None]
    on_notice: Callable[[str], None]
    should_stop: Callable[[], bool]


def list_vehicle_endpoints(port: int, links: Sequence[Endpoint] = ()) -> list[Endpoint]:
    """Return the endpoints of the vehicle's link: that of the page's own station, then ``links``."""
    return [parse_endpoint(f"udp:127.0.0.1:{port}", "vehicle"), *links]


def fly_with_page(flight: PageFlight, address: PageAddress, page: StartPage) -> str:
    """Serve the station's page until the flight is over and no page is open; return its outcome, "" if there was none.

    Raises
    ------
    MuflyError
        If the vehicle does not start or its process fails; an open page shows the reason first.
    """
    from mufly.dynamics import hover_performance

    process, vehicle = flight.process, flight.vehicle
    folder = flight.folder
    monitor = FlightMonitor(process, flight.on_event)
    try:
        # The vehicle's process loads and compiles meanwhile.
        from mufly.station import GroundStation
        from mufly.station.page.page_server import serve_page
        from mufly.station.page.page_session import StationSession

        ground = GroundStation(
            [parse_endpoint(f"udp:127.0.0.1:{flight.port}", "station")], folder=folder, record_here=True,
            name="simulation", on_vehicle=lambda found: found.set_base_mission(flight.mission),
        )  # fmt: skip
        session = StationSession(
            lambda: ground.vehicles, folder, mission=flight.mission, recorder=ground.recorder,
            rotor_radius_m=float(vehicle.rotors.radius),
            battery_data=(hover_performance(vehicle).battery_current_A, float(vehicle.battery.capacity) / 3600.0),
            title=f"mufly: {flight.mission.name}",
            get_slam_picture=(lambda: process.sight) if flight.has_camera else None,
            startup=flight.startup,
        )  # fmt: skip

        async def run_station() -> None:
            try:
                await ground.start()
                page.stop_serving()
                await serve_page(
                    session, address, open_browser=False, stop=flight.should_stop,
                    beside=lambda: _supervise_flight(flight, monitor, session),
                )  # fmt: skip
            finally:
                await ground.stop()

        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(run_station())
    finally:
        outcome = monitor.stop_process()
    return outcome


async def _supervise_flight(flight: PageFlight, monitor: FlightMonitor, session: StationSession) -> None:
    """Return when the flight is over and no page is open; an open page shows what went wrong before it is raised."""
    try:
        await _wait_until_over(flight, monitor, session)
    except MuflyError as error:
        flight.startup.end_with_fault(str(error))
        if session.open_stream_count:
            await asyncio.sleep(_ERROR_DISPLAY_S)
        raise


async def _wait_until_over(flight: PageFlight, monitor: FlightMonitor, session: StationSession) -> None:
    """Wait for the end; fly the mission if no page is ever opened."""
    startup, started = flight.startup, flight.starts_at_once
    # Not in a thread: an end that is asked for would have to wait for it.
    while not flight.process.is_ready:
        await asyncio.sleep(_POLL_INTERVAL_S)
    startup.begin_stage("waiting for the vehicle's first heartbeat")
    began = last_seen = time.monotonic()
    while True:
        await asyncio.sleep(_POLL_INTERVAL_S)
        monitor.process_events()
        now = time.monotonic()
        seen = bool(startup.visit_count or session.opened_count)
        if session.open_stream_count:
            last_seen = now
        vehicles = session.list_vehicles()
        if vehicles:
            startup.mark_succeeded()
        if not seen and not started and now - began > NO_PAGE_TIMEOUT_S and vehicles and not monitor.has_flown:
            started = True
            flight.on_notice(f"No page was opened within {NO_PAGE_TIMEOUT_S:g} s: the mission starts without a page")
            request = vehicles[0].start_mission()
            while not request.is_done:
                await asyncio.sleep(_POLL_INTERVAL_S)
                monitor.process_events()
            if request.outcome != "accepted":
                raise MuflyError(f"mission start failed: {request.answer}")
        if monitor.is_over and not session.open_stream_count and (not seen or now - last_seen > PAGE_CLOSED_TIMEOUT_S):
            return
