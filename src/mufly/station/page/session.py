"""What all windows share, and what belongs to each: who holds the controls, what is shown, what was asked.

A window is one tab of a browser. The first holds the controls, the others watch until they take them. When the window
that held them is gone, the only one left gets them; of several none does until it asks. The vehicle does not notice.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from mufly.mission import Mission
from mufly.station.page.parameter_sheet import ParameterSheet
from mufly.station.page.source import Source
from mufly.station.page.world import drawn_world
from mufly.station.replay import Recording, Replay
from mufly.station.view import Request

__all__ = ["Session", "Vehicle", "View", "find_recordings"]

ENDINGS = (".mcap", ".tlog", ".ulg", ".csv", ".bin", ".parquet", ".nc")
MOST_RECORDINGS = 200
GRACE_S = 1.0


class Vehicle(Source, Protocol):
    """A vehicle, as the page reads and commands it (:class:`mufly.station.remote.RemoteVehicle`)."""

    @property
    def system(self) -> int:
        """MAVLink system number."""

    @property
    def color(self) -> int:
        """Which of the page's colours is its."""

    def arm(self) -> Request:
        """Let the motors run."""

    def disarm(self) -> Request:
        """Switch the motors off, on the floor."""

    def take_off(self, height_m: float) -> Request:
        """Arm, take off and hover."""

    def start_mission(self) -> Request:
        """Fly the mission, or go on with it."""

    def pause(self) -> Request:
        """Stop and hover."""

    def go_to(self, position: Any, heading_rad: float | None = None) -> Request:
        """Fly to N, E, D (m) and hover."""

    def return_home(self) -> Request:
        """Fly back to where it took off, and land."""

    def land(self) -> Request:
        """Land where it is."""

    def emergency_stop(self) -> Request:
        """Motors off at once."""

    def take_command(self) -> Request:
        """Ask for command of the vehicle."""

    def release_command(self) -> Request:
        """Give command up."""

    def upload_mission(self, rows_or_mission: Any) -> Request:
        """Send a mission."""

    def download_mission(self) -> Request:
        """Fetch the vehicle's mission."""

    def clear_mission(self) -> Request:
        """Delete the vehicle's mission."""

    def show_mission(self, mission: Mission | None) -> None:
        """Say which mission the page shows, for the check that the vehicle holds the same."""

    def set_parameter(self, name: str, value: float) -> Request:
        """Write one parameter."""

    def refresh_parameters(self) -> Request:
        """Fetch all parameters again."""

    def mark(self, text: str) -> Request | None:
        """Put a mark into the recording."""

    def reboot(self) -> Request:
        """Begin anew (a simulation stands on the floor again)."""


@dataclass
class Session:
    """The station as its windows see it.

    Attributes
    ----------
    vehicles : callable
        Returns all vehicles heard so far, in order.
    folder : Path
        Where recordings are looked for.
    mission : Mission or None
        The world to draw around vehicles; of a mission loaded later, that one's.
    rotor_radius_m : float
        Size of the vehicles in the scene.
    recorder : object or None
        A :class:`mufly.station.recorder.StationRecorder`: ``recording``, ``start()``, ``stop()``, ``mark(text)``.
    title : str
    """

    vehicles: Callable[[], Sequence[Vehicle]]
    folder: Path
    mission: Mission | None = None
    rotor_radius_m: float = 0.0875
    recorder: Any = None
    title: str = "mufly station"
    views: dict[str, View] = field(default_factory=dict)
    holder: str = ""
    sheets: dict[str, ParameterSheet] = field(default_factory=dict)
    to_open: Recording | None = None
    clock: Callable[[], float] = time.monotonic

    def open(self, client_id: str) -> View:
        """A window was opened."""
        view = self.views[client_id] = View(client_id, self)
        if self.to_open is not None:
            view.show_recording(self.to_open)
        return view

    def close(self, client_id: str) -> None:
        """A window was closed for good."""
        self.views.pop(client_id, None)

    @property
    def watching(self) -> int:
        """How many windows are open and hear us."""
        return sum(view.live for view in self.views.values())

    def settle(self) -> None:
        """Give the controls to the only window there is, once whoever held them has been gone for a second."""
        holder = self.views.get(self.holder)
        if holder is not None and (holder.live or self.clock() - holder.left_s < GRACE_S):
            return
        live = [view for view in self.views.values() if view.live]
        # The first of all windows gets them without asking; of several that are left, none does.
        self.holder = live[0].client_id if live and (len(live) == 1 or not self.holder) else ""

    def sheet(self, vehicle: Source) -> ParameterSheet:
        """What was done to a vehicle's parameters."""
        sheet = self.sheets.setdefault(vehicle.name, ParameterSheet())
        sheet.observe(vehicle.parameters)
        return sheet


class View:
    """One window: what it shows and what it asked for (:class:`mufly.station.page.feed.Viewer`)."""

    def __init__(self, client_id: str, session: Session) -> None:
        self.client_id, self.session = client_id, session
        self.selected = ""
        self.replay: Replay | None = None
        self.requests: deque[Request] = deque(maxlen=20)
        self._shows = 0
        self._streams = 0
        self.left_s = math.inf  # its stream was never open yet: whoever presses so early is about to open it

    @property
    def live(self) -> bool:
        """Whether its stream of frames is open."""
        return self._streams > 0

    def connected(self) -> None:
        """Its stream of frames was opened."""
        self._streams += 1
        self.session.settle()

    def disconnected(self) -> None:
        """Its stream of frames was closed; it may come back."""
        self._streams -= 1
        self.left_s = self.session.clock()

    # ---- what is shown

    def vehicle(self) -> Vehicle | None:
        """The vehicle that is selected: the first one unless another was chosen; None in a recording."""
        if self.replay is not None:
            return None
        known = self.session.vehicles()
        return next((v for v in known if v.name == self.selected), known[0] if known else None)

    def source(self) -> Source | None:
        """What the panels show."""
        return self.replay or self.vehicle()

    def select(self, name: str) -> None:
        """Show another vehicle."""
        self.selected = name
        self.close_recording()

    def show_recording(self, recording: Recording) -> None:
        """Show a recording instead of the vehicles."""
        self.replay = Replay(recording)
        self._shows += 1

    def close_recording(self) -> None:
        """Go back to the vehicles."""
        self.replay = None
        self._shows += 1

    # ---- for the feed

    def epoch(self) -> str:
        """Changes when another source is shown or the slider jumps."""
        source = self.source()
        jumps = self.replay.jumps if self.replay is not None else 0
        return f"{self._shows}/{id(source)}/{jumps}"

    def others(self) -> list[tuple[Source, int]]:
        """The vehicles that are not selected."""
        if self.replay is not None:
            return []
        chosen = self.vehicle()
        return [(v, v.color) for v in self.session.vehicles() if v is not chosen]

    def scenery(self) -> dict[str, Any]:
        """World and size of the vehicle."""
        mission = self.replay.recording.mission if self.replay is not None else self.session.mission
        world = mission.world if mission is not None else None
        # The epoch belongs to it: after a jump the trail is drawn anew.
        return {
            "world": drawn_world(world),
            "rotor_radius": self.session.rotor_radius_m,
            "epoch": self.epoch(),
        }

    def about(self) -> dict[str, Any]:
        """Replay and recorder, in every frame."""
        r = self.replay
        recorder = self.session.recorder
        return {
            "replay": r and {
                "t": r.time_s, "from": r.start_s, "to": r.end_s, "playing": r.playing, "speed": r.speed, "name": r.name,
            },
            "recording": bool(recorder is not None and recorder.recording),
            "vehicles": [v.name for v in self.session.vehicles()],
            "selected": "" if (v := self.vehicle()) is None else v.name,
            "color": 0 if v is None else v.color,
        }  # fmt: skip

    def baseline(self) -> Mapping[str, float]:
        """First values of the parameters."""
        source = self.source()
        return self.session.sheet(source).baseline if source is not None and self.replay is None else {}

    # ---- the controls

    @property
    def has_controls(self) -> bool:
        """Whether this window may command."""
        self.session.settle()
        return self.session.holder == self.client_id

    def take_controls(self) -> None:
        """Hold the controls; whichever window had them watches from now on."""
        self.session.holder = self.client_id

    def ask(self, request: Request | None) -> None:
        """Keep a request, to show what becomes of it."""
        if request is not None:
            self.requests.append(request)


def find_recordings(folder: Path) -> list[Path]:
    """Return the recordings in a folder and its sub-folders, newest first."""
    if not folder.is_dir():
        return []
    found = [p for p in folder.rglob("*") if p.suffix.lower() in ENDINGS and p.is_file()]
    return sorted(found, key=lambda p: p.stat().st_mtime, reverse=True)[:MOST_RECORDINGS]
