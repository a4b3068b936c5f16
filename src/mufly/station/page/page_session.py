"""State shared by all windows, and state of each window: controls, displayed source, open requests.

A window is one browser tab. The first window holds the controls, the others watch until they take them. When the window
with the controls is closed, a single remaining window gets them. Of several windows none gets them until a user takes
them. The vehicle is not affected. The availability of commands and the parameter edits are here too.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from mufly.camera import PICTURE_RECORDING_FILE_NAME
from mufly.errors import InputError
from mufly.flight import TunableParameter
from mufly.link import SLOW_REAL_TIME_FACTOR
from mufly.link.ports import read_boot_clock
from mufly.mission import Mission, VehicleRequest, check_request
from mufly.slam import TrackedPicture
from mufly.station.page.command_checks import describe_battery, encode_fence
from mufly.station.page.late_requests import FrameTimes
from mufly.station.page.mission_draft import SharedDraft
from mufly.station.page.start_page import Startup
from mufly.station.recording_comparison import COMPARED_PREFIX, RecordingComparison
from mufly.station.remote.remote_vehicle import RemoteVehicle
from mufly.station.replay import FlightRecording, Replay
from mufly.station.signal_history import OperatorRequest, RequestOutcome, VehicleSnapshot
from mufly.station.station_recorder import StationRecorder
from mufly.vehicle_types import AUTOPILOT_COMPONENT, vehicle_shape
from mufly.world import World

RECORDING_SUFFIXES = (".mcap", ".tlog", ".ulg", ".csv", ".bin", ".parquet", ".nc")
MAX_LISTED_RECORDINGS = 200
_FLIGHT_FILE_NAMES = ("flight.mcap", "station.mcap")
"""File names in the folder of a flight, one or both."""
MAX_UNDO_STEPS = 200
CONTROLS_RELEASE_DELAY_S = 1.0
MAX_SHOWN_REQUESTS = 3
ANSWER_DISPLAY_S = 20.0
"""Time for which an answer is shown (s)."""
ALERT_DISPLAY_S = 20.0
"""Time for which a vehicle's warning is shown beside its state (s)."""
MAX_ALERT_LENGTH = 300
"""Number of characters shown of a warning."""
PARAM_TYPE_INT32, PARAM_TYPE_REAL32 = 6, 9  # MAV_PARAM_TYPE

PanelSource = RemoteVehicle | Replay
"""Source of the panels: both types have name, kind, snapshot, history, messages, mission, parameters and checks."""


@dataclass
class StationSession:
    """State of the station that all windows share.

    Attributes
    ----------
    list_vehicles : callable
        Returns all vehicles heard so far, in order.
    recordings_folder : Path
        Folder searched for recordings.
    mission : Mission or None
        Mission whose world is drawn around the vehicles; a mission loaded later replaces it.
    rotor_radius_m : float
        Size of the vehicles in the scene.
    recorder : StationRecorder or None
    title : str
    initial_recording : FlightRecording or None
        Recording that every new window shows.
    battery_data : (hover_current_A, capacity_Ah) or None
        Battery of the vehicle, if known, against which a draft is checked.
    shared_draft : SharedDraft
        Draft of the mission editor.
    get_slam_picture : callable or None
        Returns the last picture processed by SLAM, for a vehicle that flies on pictures.
    startup : Startup or None
        Progress of the vehicle's start, if this station starts a vehicle.
    opened_count : int
        Number of windows opened.
    describe_link_problems : callable or None
        Returns the problems of the links, one line each.
    """

    list_vehicles: Callable[[], Sequence[RemoteVehicle]]
    recordings_folder: Path
    mission: Mission | None = None
    rotor_radius_m: float = 0.0875
    recorder: StationRecorder | None = None
    title: str = "mufly station"
    view_by_client: dict[str, WindowView] = field(default_factory=dict)
    controls_holder: str = ""
    edits_by_vehicle: dict[str, ParameterEdits] = field(default_factory=dict)
    initial_recording: FlightRecording | None = None
    battery_data: tuple[float, float] | None = None
    shared_draft: SharedDraft = field(default_factory=SharedDraft)
    get_slam_picture: Callable[[], TrackedPicture | None] | None = None
    startup: Startup | None = None
    opened_count: int = 0
    describe_link_problems: Callable[[], Sequence[str]] | None = None
    clock: Callable[[], float] = read_boot_clock

    def open_view(self, client_id: str, selected: str = "") -> WindowView:
        """Open the view of a new or reloaded window, with a vehicle selected if given."""
        self.opened_count += 1
        view = self.view_by_client[client_id] = WindowView(client_id, self)
        view.selected = selected
        if self.initial_recording is not None:
            view.show_recording(self.initial_recording)
        return view

    def close_view(self, client_id: str) -> None:
        """Remove the view of a closed window."""
        self.view_by_client.pop(client_id, None)

    @property
    def open_stream_count(self) -> int:
        """Return the number of windows with an open stream."""
        return sum(view.is_stream_open for view in self.view_by_client.values())

    def startup_status(self) -> dict[str, Any] | None:
        """Return the progress of the start; None when done or if no vehicle is started."""
        start = self.startup
        return None if start is None or (start.is_done and not start.fault) else start.status_fields()

    def assign_free_controls(self) -> None:
        """Give the controls to the only window, one second after their holder is gone."""
        holder = self.view_by_client.get(self.controls_holder)
        if holder is not None and (
            holder.is_stream_open or self.clock() - holder.stream_closed_s < CONTROLS_RELEASE_DELAY_S
        ):
            return
        live = [view for view in self.view_by_client.values() if view.is_stream_open]
        # The first of all windows gets them without asking; of several that are left, none does.
        self.controls_holder = live[0].client_id if live and (len(live) == 1 or not self.controls_holder) else ""

    def describe_waiting(self, selected: str) -> str:
        """Return a text on the awaited vehicle and on problems of the links, for a window without a vehicle."""
        trouble = "; ".join(self.describe_link_problems()) if self.describe_link_problems is not None else ""
        if selected and self.list_vehicles():
            system, _, link = selected.partition("@")
            text = f"No communication with system {system} on {link}; select another vehicle above"
        else:
            text = "Waiting for a vehicle to connect"
        return f"{text}. {trouble}" if trouble else text

    def vehicle_label(self, vehicle: RemoteVehicle) -> str:
        """Return the display name of a vehicle; with its link if two names are equal."""
        alike = sum(v.display_name == vehicle.display_name for v in self.list_vehicles()) > 1
        return f"{vehicle.display_name} ({vehicle.key.partition('@')[2]})" if alike else vehicle.display_name

    def parameter_edits(self, vehicle: PanelSource) -> ParameterEdits:
        """Return the edits of a vehicle's parameters."""
        key = vehicle.key if isinstance(vehicle, RemoteVehicle) else vehicle.name
        sheet = self.edits_by_vehicle.setdefault(key, ParameterEdits())
        sheet.record_baseline(vehicle.parameters)
        return sheet


@dataclass(slots=True)
class _ShownRequest:
    """A request, and the time at which its answer was first seen."""

    request: OperatorRequest
    answered_s: float = math.inf


class WindowView:
    """One window: its displayed source and its requests."""

    def __init__(self, client_id: str, session: StationSession) -> None:
        self.client_id, self.session = client_id, session
        self.selected = ""
        self.replay: Replay | None = None
        self.compared_recording: RecordingComparison | None = None
        self.frames = FrameTimes(session.clock)
        self.on_late: Callable[[str], None] | None = None
        self._asked: deque[_ShownRequest] = deque(maxlen=20)
        self._shows = 0
        self._streams = self.newest_stream = 0
        self.stream_closed_s = math.inf  # its stream was never open yet: whoever presses so early is about to open it

    @property
    def is_stream_open(self) -> bool:
        """Return whether the window's stream of frames is open."""
        return self._streams > 0

    def open_stream(self) -> int:
        """Register a new stream of frames and return its number; only the stream with the greatest number is in use."""
        self._streams += 1
        self.newest_stream += 1
        self.session.assign_free_controls()
        return self.newest_stream

    def close_stream(self) -> None:
        """Register the end of the stream of frames; the window may reconnect."""
        self._streams -= 1
        self.stream_closed_s = self.session.clock()

    # ---- what is shown

    def selected_vehicle(self) -> RemoteVehicle | None:
        """Return the selected vehicle, by default the first one heard; it may be hidden by a recording.

        The selection is kept: if that vehicle is unknown the result is None, and no other replaces it.
        """
        known = self.session.list_vehicles()
        if not self.selected and known:
            self.selected = known[0].key
        return next((v for v in known if v.key == self.selected), None)

    def shown_vehicle(self) -> RemoteVehicle | None:
        """Return the displayed vehicle; None while a recording is shown."""
        return None if self.replay is not None else self.selected_vehicle()

    def shown_source(self) -> PanelSource | None:
        """Return the source that the panels display."""
        return self.replay or self.shown_vehicle()

    def select_vehicle(self, key: str) -> None:
        """Show another vehicle."""
        self.selected = key
        self.close_recording()

    def show_recording(self, recording: FlightRecording) -> None:
        """Show a recording instead of the vehicles."""
        self.replay = Replay(recording)
        self.compared_recording = None
        self._shows += 1

    def close_recording(self) -> None:
        """Show the vehicles again."""
        self.replay = self.compared_recording = None
        self._shows += 1

    def compare_recording(self, second: FlightRecording | None, by: str = "take-off", offset_s: float = 0.0) -> None:
        """Overlay a second recording on the displayed one; None removes it."""
        if self.replay is None:
            return
        self.compared_recording = c = (
            None if second is None else RecordingComparison(self.replay.recording, second, by, offset_s)
        )

        def sample_compared_recording(name: str, times: Any) -> Any:
            return (
                c.sample_second_recording(name.removeprefix(COMPARED_PREFIX), times)
                if c and name.startswith(COMPARED_PREFIX)
                else None
            )

        self.replay.history.extra_values = sample_compared_recording
        self._shows += 1

    def shown_comparison(self) -> RecordingComparison | None:
        """Return the comparison with an overlaid recording, if any."""
        return self.compared_recording if self.replay is not None else None

    # ---- for the frames

    def display_change_key(self) -> str:
        """Return a value that changes with the displayed source and with jumps of the time slider."""
        jumps = self.replay.jumps if self.replay is not None else 0
        return f"{self._shows}/{id(self.shown_source())}/{jumps}"

    def shown_slam_picture(self) -> TrackedPicture | None:
        """Return the last SLAM picture of the displayed vehicle."""
        return (
            None
            if self.replay is not None or self.session.get_slam_picture is None
            else self.session.get_slam_picture()
        )

    def other_vehicles(self) -> list[RemoteVehicle]:
        """Return the vehicles in the scene that are not selected."""
        chosen = self.shown_vehicle()
        return [v for v in self.session.list_vehicles() if v is not chosen] if self.replay is None else []

    def encode_scenery(self) -> dict[str, Any]:
        """Return world, fence, and shape and size of the vehicle for the 3-D scene.

        ``epoch`` changes after a jump of the slider; the trail is then drawn again.
        """
        mission = self.replay.recording.mission if self.replay is not None else self.session.mission
        world = encode_world(mission.world if mission is not None else None)
        v = self.shown_vehicle()
        world["fence"] = encode_fence(v.fence if v is not None else mission.fence if mission is not None else None)
        return {
            "world": world, "rotor_radius": self.session.rotor_radius_m, "epoch": self.display_change_key(),
            "shape": scene_shape(self.shown_vehicle()),
        }  # fmt: skip

    def status_fields(self) -> dict[str, Any]:
        """Return the state of replay and recorder, for every frame."""
        r, v, recorder, c = self.replay, self.shown_vehicle(), self.session.recorder, self.shown_comparison()
        return {
            "replay": r
            and {
                "t": r.time_s,
                "from": r.start_s,
                "to": r.end_s,
                "playing": r.playing,
                "speed": r.speed,
                "name": r.name,
            },
            "compared": c
            and {
                "name": c.second_recording.name,
                "by": c.alignment_event,
                "offset": c.manual_offset_s,
                "shift": c.total_shift_s,
                "note": c.alignment_note,
            },
            "recording": recorder is not None and recorder.recording,
            "vehicles": [(v.key, self.session.vehicle_label(v)) for v in self.session.list_vehicles()],
            "selected": self.selected,
            "trouble": "; ".join(self.session.describe_link_problems())
            if self.session.describe_link_problems is not None
            else "",
            "color": 0 if v is None else v.color,
            "flight": self.encode_selected_vehicle(),
            "start": self.session.startup_status(),
        }

    def encode_selected_vehicle(self) -> dict[str, Any] | None:
        """Return the state of the selected vehicle, also during a replay; None without a vehicle."""
        v = self.selected_vehicle()
        if v is None:
            return None
        s = v.snapshot
        others = [
            self.session.vehicle_label(o) for o in self.session.list_vehicles() if o is not v and o.snapshot.armed
        ]
        fresh = takewhile(lambda m: not s.time_s - m.time_s > ALERT_DISPLAY_S, reversed(v.status_messages))
        told = next((m for m in fresh if m.level != "info"), None)
        return {
            "name": self.session.vehicle_label(v),
            "connected": s.connected,
            "silent_s": s.silent_s,
            "armed": s.armed,
            "flying": s.flying,
            "state": s.state,
            "height": -float(s.estimate.position[2]),
            "others": others,
            "battery": describe_battery(s),
            "pace": describe_slow_pace(s),
            "slow": s.real_time_factor < SLOW_REAL_TIME_FACTOR,
            "alert": None if told is None else (told.level, told.text[:MAX_ALERT_LENGTH], s.time_s - told.time_s),
        }

    def parameter_baseline(self) -> Mapping[str, float]:
        """Return the values that the parameters had before any edit on this page."""
        vehicle = self.shown_vehicle()
        return {} if vehicle is None else self.session.parameter_edits(vehicle).baseline

    # ---- the controls

    @property
    def has_controls(self) -> bool:
        """Return whether this window may command."""
        self.session.assign_free_controls()
        return self.session.controls_holder == self.client_id

    def take_controls(self) -> None:
        """Take the controls for this window; the window that had them can then only watch."""
        self.session.controls_holder = self.client_id

    def keep_request(self, request: OperatorRequest) -> None:
        """Keep a request, to show its outcome."""
        if all(asked.request is not request for asked in self._asked):
            self._asked.append(_ShownRequest(request))

    def refuse_late_request(self, request: OperatorRequest) -> None:
        """Report a late request as dropped."""
        self.keep_request(request)
        if self.on_late is not None:
            self.on_late(f"{request.text}: {request.answer}")

    def recent_requests(self) -> list[OperatorRequest]:
        """Return the requests to show: open ones and recent answers, without refusals followed by a success."""
        now = self.session.clock()
        for asked in self._asked:
            if asked.request.is_done:
                asked.answered_s = min(asked.answered_s, now)
        newest = list(self._asked)[-MAX_SHOWN_REQUESTS:]
        granted = [k for k, a in enumerate(newest) if a.request.outcome is RequestOutcome.ACCEPTED]
        last = granted[-1] if granted else -1
        return [
            a.request
            for k, a in enumerate(newest)
            if now - a.answered_s < ANSWER_DISPLAY_S
            and (k >= last or a.request.outcome in (RequestOutcome.ACCEPTED, RequestOutcome.WAITING))
        ]


def describe_slow_pace(s: VehicleSnapshot) -> str:
    """Return a vehicle's low real-time factor and number of timing overruns as text; "" if it keeps real time."""
    lost = [f"real-time factor {s.real_time_factor:.2f}"] if s.real_time_factor < SLOW_REAL_TIME_FACTOR else []
    if s.timing_overrun_count:
        lost.append(f"{s.timing_overrun_count} timing overrun{'s' if s.timing_overrun_count > 1 else ''}")
    return ", ".join(lost)


def find_recordings(folder: Path) -> list[Path]:
    """Return the recordings in a folder, in its sub-folders and in other flights' folders beside it, newest first.

    Each flight has a separate folder, so that other flights are found from the folder of one.
    """
    found = set(_filter_recordings(folder.rglob("*"))) if folder.is_dir() else set()
    with contextlib.suppress(OSError):
        for beside in folder.absolute().parent.iterdir():
            with contextlib.suppress(OSError):  # a folder of somebody else
                if beside != folder.absolute() and is_flight_folder(beside):
                    found |= set(_filter_recordings(beside.iterdir()))
    return sorted(found, key=lambda p: p.stat().st_mtime, reverse=True)[:MAX_LISTED_RECORDINGS]


def is_flight_folder(folder: Path) -> bool:
    """Whether a folder is that of a flight."""
    return any((folder / name).is_file() for name in _FLIGHT_FILE_NAMES)


def _filter_recordings(paths: Iterable[Path]) -> Iterator[Path]:
    # A flight's pictures are no flight.
    return (
        p
        for p in paths
        if p.suffix.lower() in RECORDING_SUFFIXES and p.name != PICTURE_RECORDING_FILE_NAME and p.is_file()
    )


def encode_world(world: World | None) -> dict[str, Any]:
    """Return the objects of the world in the format of the 3-D scene: N-E-D metres, lists and numbers only.

    Boxes are ``{name, c: [N, E, D], s: [x, y, z], yaw}``, cylinders ``{name, c: [N, E], r, h, foot}``, the room
    ``{n: [least, greatest], e: [...], h: height or None}``.
    """
    if world is None:
        return {"boxes": [], "cylinders": [], "room": None}
    room = world.room
    return {
        "boxes": [{"name": b.name, "c": list(b.centre), "s": list(b.size), "yaw": b.yaw} for b in world.boxes],
        "cylinders": [
            {"name": c.name, "c": list(c.centre), "r": c.radius, "h": c.height, "foot": c.foot}
            for c in world.cylinders
        ],
        "room": room and {
            "n": list(room.north), "e": list(room.east), "h": room.height if math.isfinite(room.height) else None,
        },
    }  # fmt: skip


def scene_shape(vehicle: RemoteVehicle | None) -> str:
    """Return the shape drawn for a vehicle; a coaxial helicopter for a recording or an unknown type."""
    known = 0 if vehicle is None else vehicle.telemetry.vehicle_type
    return vehicle_shape(known) if known else "coaxial"


# Which commands make sense now, and why the others do not: shown on the buttons themselves.

_REQUEST_BY_COMMAND = {
    "arm": VehicleRequest.ARM,
    "disarm": VehicleRequest.DISARM,
    "take_off": VehicleRequest.TAKE_OFF,
    "pause": VehicleRequest.PAUSE,
    "mission": VehicleRequest.START,
    "go_to": VehicleRequest.GO_TO,
    "land": VehicleRequest.LAND,
    "return": VehicleRequest.RETURN,
    "sticks": VehicleRequest.STICKS,
    "stop": VehicleRequest.STOP,
}
COMMAND_NAMES = tuple(_REQUEST_BY_COMMAND)


def find_refusal_reasons(
    s: VehicleSnapshot | None, *, kind: str, has_controls: bool, rows: int, unready: str = ""
) -> dict[str, str]:
    """Return for every command the reason why it is not permitted at present; "" if it is.

    :func:`mufly.mission.check_request` decides by the vehicle's state. Of another autopilot's vehicle only whether it
    flies is known.

    Parameters
    ----------
    s : VehicleSnapshot or None
        State of the vehicle; None without a vehicle.
    kind : str
        "mufly", "other" or "recording".
    has_controls : bool
        Whether this window holds the controls.
    rows : int
        Length of the vehicle's mission.
    unready : str
        Reason why the vehicle cannot be armed; "" if it can.
    """
    if kind == "recording" or s is None:
        return dict.fromkeys(COMMAND_NAMES, "recording shown" if kind == "recording" else "no vehicle connected")
    watching = not has_controls or (s.commander and not s.in_command)
    if not s.connected or watching:  # it may still hear us
        return dict.fromkeys(COMMAND_NAMES, "view only" if s.connected else "no link") | {"stop": ""}
    situation = s if kind == "mufly" else replace(s, state="")
    height_m = math.nan if s.flying else 0.0
    why = {
        name: check_request(
            ask, situation, height_m=height_m, armed=s.armed or ask is not VehicleRequest.ARM, flying=s.flying
        ).short_reason
        for name, ask in _REQUEST_BY_COMMAND.items()
    }
    if s.mission_running:  # from the first turn of the rotors on, its waits among it
        why["mission"] = "running; Hover pauses it"
    if s.armed:
        why["arm"] = "armed"
    else:  # taking off and the mission arm it first
        why |= {name: why[name] or unready for name in ("arm", "take_off", "mission")}
        why["disarm"] = why["disarm"] or "not armed"
    return why if rows else why | {"mission": "no mission in the vehicle"}


def mission_button_label(s: VehicleSnapshot | None) -> str:
    """Return the text of the mission button: "Start mission", "Mission running" or "Resume mission"."""
    if s is None or not s.mission_begun:
        return "Start mission"
    return "Mission running" if s.mission_running else "Resume mission"


# Parameters: what was done to them here, and files of them. Files are those that other ground stations write too: one
# parameter a line, ``system component NAME value type`` with tabs (QGroundControl), or ``NAME,value`` (Mission
# Planner); both are read, the first is written.


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """Name of a parameter, with its value before and after a change."""

    name: str
    old_value: float
    new_value: float


@dataclass
class ParameterEdits:
    """The changes made to one vehicle's parameters, for undo and redo.

    Attributes
    ----------
    baseline : dict of str to float
        First value received of each parameter.
    """

    baseline: dict[str, float] = field(default_factory=dict)
    _undo: deque[ParameterChange] = field(default_factory=lambda: deque(maxlen=MAX_UNDO_STEPS))
    _redo: deque[ParameterChange] = field(default_factory=deque)

    def record_baseline(self, parameters: Mapping[str, TunableParameter]) -> None:
        """Store the first received value of every parameter, as the value before any edit."""
        if len(parameters) != len(self.baseline):
            for name, parameter in parameters.items():
                self.baseline.setdefault(name, parameter.value)

    def record_change(self, name: str, before: float, after: float) -> None:
        """Record a change; undone changes can then not be redone."""
        self._undo.append(ParameterChange(name, before, after))
        self._redo.clear()

    @property
    def undo_name(self) -> str:
        """Return the name of the parameter that undo would change, "" if none."""
        return self._undo[-1].name if self._undo else ""

    @property
    def redo_name(self) -> str:
        """Return the name of the parameter that redo would change, "" if none."""
        return self._redo[-1].name if self._redo else ""

    def pop_undo_value(self) -> tuple[str, float] | None:
        """Undo the last change: return name and value to write, None if there is none."""
        if not self._undo:
            return None
        self._redo.append(change := self._undo.pop())
        return change.name, change.old_value

    def pop_redo_value(self) -> tuple[str, float] | None:
        """Redo the last undone change: return name and value to write, None if there is none."""
        if not self._redo:
            return None
        self._undo.append(change := self._redo.pop())
        return change.name, change.new_value


def format_parameter_file(
    parameters: Mapping[str, TunableParameter], system: int, component: int = AUTOPILOT_COMPONENT
) -> str:
    """Return parameters of a component as the text of a file."""
    lines = ["# Vehicle-Id Component-Id Name Value Type, as QGroundControl and mufly write them"]
    for name in sorted(parameters):
        p = parameters[name]
        if not math.isfinite(p.value):
            lines.append(f"# {name} is {p.value}: not a finite number, omitted")
            continue
        value, kind = (f"{round(p.value)}", PARAM_TYPE_INT32) if p.is_integer else (f"{p.value:.9g}", PARAM_TYPE_REAL32)
        lines.append(f"{system}\t{component}\t{name}\t{value}\t{kind}")
    return "\n".join(lines) + "\n"


_COMMENT_PATTERN = re.compile(r"\s*(?:#|//|;).*$")
_READ_ONLY_PATTERN = re.compile(r"\s+@READONLY\s*$", re.IGNORECASE)


def read_parameter_file(text: str, where: str, component: int = AUTOPILOT_COMPONENT) -> dict[str, float]:
    """Return parameter values by name from a file with a name and a value a line, or QGroundControl's five columns.

    A comment may follow a value (``#``, ``//`` or ``;``), as may ``@READONLY``, ArduPilot's mark of parameters that a
    user cannot change. If a file holds the parameters of several components, those of one component are read.

    Parameters
    ----------
    text : str
        Content of the file: ``.params`` (QGroundControl), ``.param`` or ``.parm`` (Mission Planner, ArduPilot).
    where : str
        Name of the file, for errors.
    component : int
        MAV_COMPONENT whose parameters are read; lines with only name and value belong to any component.

    Raises
    ------
    InputError
        If a line is no parameter or gives a parameter a second value, or if the file has no parameters of the
        component. The error names the line or the file's components.
    """
    out: dict[str, float] = {}
    lines: dict[str, int] = {}
    others: set[str] = set()
    for k, whole in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        line = _READ_ONLY_PATTERN.sub("", _COMMENT_PATTERN.sub("", whole)).strip()
        if not line:
            continue
        parts = line.replace(",", " ").replace("=", " ").split()
        named = len(parts) == 5 and parts[0].isdigit() and parts[1].isdigit()
        name, value = parts[2:-1] if named else (parts[0], parts[1] if len(parts) == 2 else "")
        try:
            number = float(int(value, 16)) if value.lower().startswith("0x") else float(value)
        except ValueError:
            remedy = "use lines NAME,value or QGroundControl's format"
            raise InputError(where, f"line {k}", f"{whole.strip()[:60]!r} is not a parameter", remedy) from None
        if named and int(parts[1]) != component:
            others.add(parts[1])
            continue
        if out.setdefault(name, number) != number:
            problem = f"{name} is {number:g}, but {out[name]:g} in line {lines[name]}"
            raise InputError(where, f"line {k}", problem, "delete one of the two lines")
        lines.setdefault(name, k)
    if not out and others:
        problem = f"holds parameters of component {', '.join(sorted(others))}, none of component {component}"
        raise InputError(where, "", problem, "choose the autopilot's file")
    if not out:
        raise InputError(where, "", "contains no parameters", "choose another file")
    return out
