"""What may be asked of a vehicle: the commanding half of :class:`mufly.station.remote.RemoteVehicle`.

Everything returns a :class:`mufly.station.view.Request` at once, which tells what becomes of it. What a vehicle could
never do is refused here; all else is for the vehicle to judge.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path

from mufly.errors import InputError
from mufly.link.missions import items_of as items_of_mission
from mufly.mission import Mission, load_mission
from mufly.station import orders
from mufly.station.checks import Surroundings
from mufly.station.command_desk import CommandDesk
from mufly.station.missions import items_of
from mufly.station.parameters import Parameters
from mufly.station.requests import Chain, Commands, Order, end
from mufly.station.telemetry import Telemetry
from mufly.station.texts import Texts
from mufly.station.transfers import Transfers
from mufly.station.view import MissionRow, Outcome, Request

__all__ = ["Asking"]


class Asking(ABC):
    """The requests of a vehicle; the parts that carry them out are those of the vehicle."""

    telemetry: Telemetry
    texts: Texts
    commands: Commands
    transfers: Transfers
    surroundings: Surroundings
    on_mark: Callable[[str], bool] | None
    _parameters: Parameters
    _desk: CommandDesk
    _chains: list[Chain]
    _reached: int

    @property
    @abstractmethod
    def dialect(self) -> orders.Dialect:
        """How the vehicle wants to be asked."""

    def arm(self) -> Request:
        """Let the motors run."""
        return self._ask("arm", orders.arm())

    def disarm(self) -> Request:
        """Stop the motors; it refuses in flight."""
        return self._ask("disarm", orders.disarm())

    def take_off(self, height_m: float) -> Request:
        """Arm if needed, take off to a height above where it stands (m), and hover."""
        text = f"take off to {height_m:g} m"
        if not (math.isfinite(height_m) and height_m > 0.0):
            return _refused(text, "a height above the floor is needed")
        return self._chain(text, self._armed_first(orders.take_off(self.dialect, height_m), height_m))

    def start_mission(self) -> Request:
        """Fly the mission, or go on with it; arms if needed."""
        if self.transfers.items is not None and not self.transfers.items:
            return _refused("fly the mission", "the vehicle holds no mission; send one first")
        return self._chain("fly the mission", self._armed_first(orders.mission_start(self.dialect)))

    def pause(self) -> Request:
        """Stop and hover."""
        return self._ask("hover here", orders.pause(self.dialect))

    def go_to(self, position: Sequence[float], heading_rad: float | None = None) -> Request:
        """Fly to a place (N, E, D; m) and hold."""
        n, e, d = (float(v) for v in position)
        text = f"fly to N {n:.2f}, E {e:.2f}, D {d:.2f} m"
        if not all(map(math.isfinite, (n, e, d))):
            return _refused(text, "N, E and D are needed")
        heading = math.nan if heading_rad is None else heading_rad
        order = orders.go_to(self.dialect, (n, e, d), heading, self.telemetry.origin)
        return _refused(text, order) if isinstance(order, str) else self._ask(text, order)

    def return_home(self) -> Request:
        """Return to where it took off, and land."""
        return self._ask("return and land", orders.home(self.dialect))

    def land(self) -> Request:
        """Land here."""
        return self._ask("land", orders.land(self.dialect))

    def emergency_stop(self) -> Request:
        """Stop the motors at once, in flight too; nothing that was asked for before goes on after it."""
        for chain in self._chains:
            end(chain.request, Outcome.REFUSED, "given up for: EMERGENCY STOP")
        return self._ask("EMERGENCY STOP", orders.emergency_stop())

    def reboot(self) -> Request:
        """Start the autopilot anew; a simulation begins anew."""
        return self._ask("start anew", orders.reboot())

    def take_command(self) -> Request:
        """Become the station that commands it."""
        return self._desk.take()

    def release_command(self) -> Request:
        """Let another station command it."""
        return self._desk.release()

    def upload_mission(self, mission: Mission | Sequence[MissionRow] | str | Path) -> Request:
        """Send a mission: one of ours, rows of the table, or the name of a file."""
        try:
            if isinstance(mission, str | Path):
                mission = load_mission(mission)
            items = items_of_mission(mission).items if isinstance(mission, Mission) else items_of(mission)
        except InputError as error:
            return _refused("send a mission", str(error))
        self._reached = -1
        return self.transfers.upload(items)

    def download_mission(self) -> Request:
        """Fetch the mission that it holds."""
        return self.transfers.download()

    def clear_mission(self) -> Request:
        """Let it forget its mission."""
        return self.transfers.clear()

    def set_parameter(self, name: str, value: float) -> Request:
        """Set a parameter."""
        return self._parameters.set(name, value)

    def refresh_parameters(self) -> Request:
        """Read all parameters anew."""
        return self._parameters.refresh()

    def show_mission(self, mission: Mission | None) -> None:
        """Say which mission the page shows, for the check that the vehicle holds the same."""
        self.surroundings.shown = None if mission is None else tuple(items_of_mission(mission).items)

    def mark(self, text: str) -> Request:
        """Put a mark into the recording, and among the messages."""
        request = Request(f"mark: {text}")
        recorded = self.on_mark is not None and self.on_mark(text)
        self.texts.note(self.telemetry.time_s, "info", f"mark: {text}")
        end(request, Outcome.ACCEPTED, "" if recorded else "not recorded: the recorder is off")
        return request

    def _ask(self, text: str, order: Order) -> Request:
        return self.commands.ask(text, order)

    def _chain(self, text: str, links: Sequence[Callable[[], Request | None]]) -> Request:
        chain = Chain(text, links)
        self._chains.append(chain)
        return chain.request

    def _armed_first(
        self, then: Sequence[Order], height_m: float | None = None
    ) -> list[Callable[[], Request | None]]:
        """Links of a chain: what comes before arming, arming unless it is armed, and the orders."""

        def arm() -> Request | None:
            return None if self.telemetry.armed else self._ask("arm", orders.arm())

        def ask(order: Order) -> Callable[[], Request]:
            return lambda: self._ask("take off" if height_m is not None else "start", order)

        links: list[Callable[[], Request | None]] = []
        if height_m is not None:
            if self.dialect == "PX4":
                links.append(lambda: self._parameters.set("MIS_TAKEOFF_ALT", height_m))
            links += [ask(order) for order in orders.before_arming(self.dialect)]
        return [*links, arm, *(ask(order) for order in then)]


def _refused(text: str, answer: str) -> Request:
    return Request(text, Outcome.REFUSED, answer)
