"""The layout of the page; the style sheet arranges it for laptops and tablets."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mufly.station.page.alerts import AlertWatch
from mufly.station.page.command_checks import (
    COMMANDS_NEEDING_CONFIRMATION,
    Confirmation,
    DestinationCheck,
    check_vehicle_destination,
    failed_check_names,
)
from mufly.station.page.flight_list import FlightList
from mufly.station.page.mission_editor import MissionEditor
from mufly.station.page.page_session import WindowView, find_refusal_reasons, mission_button_label
from mufly.station.page.panels import (
    ActionButton,
    FlightStrip,
    JavaScriptPanel,
    StickPanel,
    build_check_drawer,
    build_mission_drawer,
    build_parameter_drawer,
    build_sensor_drawer,
    make_button,
    make_element,
    show_refusal,
    static_url,
)
from mufly.station.preflight_checks import PREARM_CHECKS_NAME
from mufly.station.recording_comparison import ALIGNMENT_EVENTS
from mufly.station.remote.remote_vehicle import RemoteVehicle
from mufly.station.signal_history import OperatorRequest, RequestOutcome, VehicleSnapshot

REFRESH_PERIOD_S = 0.2
MAX_COMPARISON_OFFSET_S = 1e6
"""Largest time shift of a second recording (s)."""
_KEYBOARD_HELP = (
    ("Shift + T, twice", "take off"),
    ("Shift + M, twice", "start or resume the mission"),
    ("Shift + H", "hover at the present position"),
    ("Shift + G", "go to the position in the fields N, E, height"),
    ("Shift + L, twice", "land"),
    ("Shift + R, twice", "return and land"),
    ("Shift + A, twice", "arm; pressed once: disarm"),
    ("Shift + ⌫, twice", "emergency stop: stop the motors (also in text fields and dialogs)"),
    ("space", "play or pause a recording"),
    ("m", "add a mark to the recording"),
    ("d", "dark or light theme"),
    ("Ctrl + Z, Ctrl + Y", "in the plan: undo, redo; Del deletes, arrows move the waypoint"),
    ("?", "keyboard and pointer help"),
)
_POINTER_HINTS = (
    "Click the floor to set a destination; click its marker again, or Send, to fly there.",
    "In the tab Plan, click the 3-D view to add a waypoint and drag to move it; ↕ or Shift changes its height.",
    "In the 3-D view, drag rotates, right drag pans, the wheel zooms.",
    "In a plot, the wheel zooms the time axis, drag pans, a double click returns to live.",
    "Commands need Shift, which prevents accidental commands. The emergency stop is always visible.",
)


def build_page(view: WindowView) -> None:
    """Build all elements of the page of one browser window."""
    ui.add_head_html(f'<link rel="stylesheet" href="{static_url()}/station.css">')
    dark = ui.dark_mode(None)
    ui.colors(primary="#2f7fb8")
    strip = FlightStrip(view)
    editor = MissionEditor(view)
    with make_element("div", classes="mf-page"):
        say = _build_header(view, dark)
        with _make_labelled_element("aside", "instruments", "mf-left"):
            for module, title in (
                ("flight", ""),
                ("actuators", "Motors and servos"),
                ("ranges", "Ranges (nose up)"),
            ):
                with _make_labelled_element("section", title, f"mf-card mf-card-{module}"):
                    if title:
                        make_element("h2", title)
                    JavaScriptPanel(module)
        with make_element("main", classes="mf-centre"):
            scene = JavaScriptPanel("scene")
            JavaScriptPanel("starting")
            sticks = StickPanel(view, lambda: bar.refusal_reasons()["sticks"])
            with make_element("div", classes="mf-replay-row").props("hidden"):
                JavaScriptPanel("replaybar").on("replay", lambda e: _control_replay(view, e))
        refresh_parameters = _build_dock(view, editor)
        with _make_labelled_element("aside", "commands and mission", "mf-right"):
            bar = CommandBar(
                view,
                lambda height: scene.call_browser_method("setHeight", height),
                lambda place: scene.call_browser_method("setTarget", place),
            )
            _build_right_tabs(view)
    JavaScriptPanel("keys")
    JavaScriptPanel("hints")
    scene.on("place", lambda e: _forward_event_point(e, bar.fill_destination_fields))
    scene.on("goto", lambda e: _forward_event_point(e, bar.go_to))

    view.on_late = show_refusal

    def refresh_all() -> None:
        if not view.is_stream_open:
            return  # nobody sees it; what changes meanwhile is shown when the window is back
        strip.refresh()
        bar.refresh()
        refresh_parameters()
        editor.refresh()
        sticks.refresh()
        say()

    ui.timer(REFRESH_PERIOD_S, refresh_all)


def _make_labelled_element(tag: str, label: str, classes: str) -> Element:
    made = make_element(tag, classes=classes)
    return made.props(f'aria-label="{label}"') if label else made


def _forward_event_point(e: GenericEventArguments, take: Callable[[float, float, float], None]) -> None:
    content = e.args if isinstance(e.args, dict) else {}
    try:
        north, east, height = (float(content[k]) for k in ("north", "east", "height"))
    except (KeyError, TypeError, ValueError):
        return
    if all(map(math.isfinite, (north, east, height))):
        take(north, east, height)


def _build_header(view: WindowView, dark: ui.dark_mode) -> Callable[[], None]:
    async def toggle_dark() -> None:
        now = await ui.run_javascript("document.body.classList.contains('body--dark')")
        dark.set_value(not now)

    with make_element("header", classes="mf-header"):
        with make_element("div", classes="mf-brand"):
            make_element("span", "mufly", "mf-brand-name")
            JavaScriptPanel("vehicles").on("select", lambda e: view.select_vehicle(str(e.args)))
        JavaScriptPanel("status")
        with make_element("div", classes="mf-header-tools"):
            _build_recorder(view)
            say = _build_alert_switch(view)
            _add_icon_button("◐", toggle_dark, "d", "dark or light", "dark or light theme (d)")
            with ui.dialog() as keys, make_element("div", classes="mf-help"):
                _build_help()
            _add_icon_button("?", keys.open, "?", "help", "keyboard and help (?)")
    return say


def _build_alert_switch(view: WindowView) -> Callable[[], None]:
    """Build the switch for spoken alerts; return the function that speaks new alerts."""
    panel = JavaScriptPanel("alerts")
    watches: dict[str, AlertWatch] = {}

    def speak_alerts() -> None:
        vehicle = view.shown_vehicle() or next(iter(view.session.list_vehicles()), None)
        if vehicle is None:
            return
        watch = watches.setdefault(vehicle.key, AlertWatch())
        found = watch.find_new_alerts(
            time.monotonic(),
            vehicle.snapshot,
            list(vehicle.status_messages),
            vehicle.mission_rows,
            view.recent_requests(),
        )
        if found:
            panel.call_browser_method("say", [{"level": a.level, "text": a.text} for a in found])

    return speak_alerts


def _add_icon_button(text: str, press: Callable[[], object], key: str, label: str, title: str) -> None:
    made = make_button(text, press, title=title, classes="mf-icon-button")
    made.props(f'data-key="{key}" aria-label="{label}"')


def _build_help() -> None:
    make_element("h2", "Keyboard")
    with make_element("dl"):
        for key, meaning in _KEYBOARD_HELP:
            make_element("dt", key)
            make_element("dd", meaning)
    make_element("h2", "Pointer")
    with make_element("ul"):
        for hint in _POINTER_HINTS:
            make_element("li", hint)


def _build_recorder(view: WindowView) -> None:
    recorder = view.session.recorder
    if recorder is None:
        return

    def add_mark() -> None:
        text = (field.value or "").strip() or "mark"
        recorder.add_mark(text)
        if view.shown_vehicle() is not None:
            view.keep_request(OperatorRequest(f"mark: {text}", RequestOutcome.ACCEPTED))
        field.value = ""
        marks.close()

    def toggle_recording() -> None:
        recorder.stop_recording() if recorder.recording else recorder.start_recording()
        show_recording_state()

    with ui.dialog() as marks, make_element("div", classes="mf-help"):
        make_element("h2", "Add a mark")
        field = ui.input("text", placeholder="gust from the left").props("autofocus").on("keydown.enter", add_mark)
        make_button("Add", add_mark, classes="mf-primary-button")
    record = make_button("● Record", toggle_recording, test="record")
    make_button("Mark", marks.open, title="add a mark to the recording (m)").props('data-key="m"')
    state: list[bool | None] = [None]

    def show_recording_state() -> None:
        on = bool(recorder.recording)
        if state[0] == on:
            return
        state[0] = on
        record._text = "■ Recording" if on else "● Record"
        title = "stop recording" if on else "start recording"
        record.props(f'aria-pressed={str(on).lower()} title="{title}"')
        record.classes(add="mf-recording" if on else "", remove="" if on else "mf-recording")
        record.update()

    show_recording_state()
    ui.timer(0.5, show_recording_state)


def _build_dock(view: WindowView, editor: MissionEditor) -> Callable[[], None]:
    with _make_labelled_element("section", "plots, spectrum, plan, parameters, recordings, camera", "mf-dock"):
        with ui.tabs().props("dense no-caps align=left inline-label").classes("mf-tabs") as tabs:
            plots, spectrum, plan, parameters, recordings = map(
                ui.tab, ("Plots", "Spectrum", "Plan", "Parameters", "Recordings")
            )
            camera = None if view.session.get_slam_picture is None else ui.tab("Camera")
        with ui.tab_panels(tabs, value=camera or plots, animated=False, keep_alive=False) as panels:
            panels.classes("mf-tab-panels")
            if camera is not None:
                with ui.tab_panel(camera):
                    JavaScriptPanel("camera")
            with ui.tab_panel(plots):
                JavaScriptPanel("plots")
            with ui.tab_panel(spectrum):
                JavaScriptPanel("spectrum")
            with ui.tab_panel(plan):
                editor.build_tab()
            with ui.tab_panel(parameters):
                refresh = build_parameter_drawer(view)
            with ui.tab_panel(recordings):
                FlightList(view)
    return refresh


def _build_right_tabs(view: WindowView) -> None:
    with ui.tabs().props("dense no-caps align=left").classes("mf-tabs mf-tabs-narrow") as tabs:
        checks, sensors, mission, messages = map(ui.tab, ("Checks", "Sensors", "Mission", "Messages"))
    recording = view.session.initial_recording is not None
    with ui.tab_panels(tabs, value=mission if recording else checks, animated=False).classes("mf-tab-panels"):
        with ui.tab_panel(checks):
            build_check_drawer(view)
        with ui.tab_panel(sensors):
            build_sensor_drawer(view)
        with ui.tab_panel(mission):
            build_mission_drawer(view)
        with ui.tab_panel(messages):
            JavaScriptPanel("messages")


def _control_replay(view: WindowView, e: GenericEventArguments) -> None:
    """Apply a command of a recording's slider."""
    replay, content = view.replay, e.args if isinstance(e.args, dict) else {}
    if replay is None:
        return
    if "play" in content:
        replay.play() if content["play"] else replay.pause()
    moment, speed = content.get("seek"), content.get("speed")
    if isinstance(moment, int | float) and math.isfinite(moment):
        replay.seek(float(moment))
    if isinstance(speed, int | float) and 0.0 < speed <= 64.0:
        replay.speed = float(speed)
    compared = view.shown_comparison()
    if compared is not None and ("by" in content or "offset" in content):
        by, offset = (
            content.get("by", compared.alignment_event),
            content.get("offset", compared.manual_offset_s),
        )
        if by in ALIGNMENT_EVENTS and isinstance(offset, int | float) and abs(offset) < MAX_COMPARISON_OFFSET_S:
            view.compare_recording(compared.second_recording, by, float(offset))
    if content.get("alone"):
        view.compare_recording(None)
    if content.get("close"):
        view.close_recording()


# ----------------------------------------------------------------------------
# The command buttons, with reasons of unavailability, and the outcomes of requests.


TAKE_OFF_HEIGHT_RANGE_M = (0.2, 50.0)
_OUTCOME_MARKS = {
    RequestOutcome.WAITING: "…",
    RequestOutcome.ACCEPTED: "✓",
    RequestOutcome.REFUSED: "✕ refused",
    RequestOutcome.TIMED_OUT: "✕ no answer",
}


def _describe_facts(facts: dict[str, Any]) -> str:
    """Return the facts of a recording in one line."""
    outcome = " ".join(str(facts[k]) for k in ("outcome", "reason") if facts.get(k))
    start = str(facts.get("start_time", ""))[:19].replace("T", " ")
    whole = "" if facts.get("complete", True) else "incomplete: shown up to its last sample"
    parts = (str(facts.get("vehicle", "")), str(facts.get("mission", "")), outcome, start, whole)
    return "Recording: " + "; ".join(p for p in parts if p)


def _set_hidden(element: Element, hidden: bool, name: str = "mf-hidden") -> None:
    element.classes(add=name if hidden else "", remove="" if hidden else name)


class _NumberField:
    """An input field for a number."""

    def __init__(self, label: str, value: float, meaning: str, unit: str = "") -> None:
        self.value = value
        self.on_change: Callable[[float], None] = lambda _: None
        test = "field-" + meaning.split()[0]
        options = {"label": label, "value": value, "meaning": meaning, "unit": unit, "test": test}
        self.panel = JavaScriptPanel("field", options)
        self.panel.on("change", self._handle_change)

    def _handle_change(self, e: GenericEventArguments) -> None:
        if isinstance(e.args, int | float) and math.isfinite(e.args):
            self.value = float(e.args)
            self.on_change(self.value)

    def show_value(self, value: float) -> None:
        """Set the displayed number."""
        if value != self.value:
            self.value = value
            self.panel.call_browser_method("set", value)


_Place = tuple[float, float, float]
_REACHED_DISTANCE_M = 0.15
_MOVING_STATES = frozenset({"waypoint", "obstacle"})


@dataclass(slots=True)
class SentDestination:
    """Destination (north, east, height; m) that this window has sent to a vehicle."""

    vehicle: RemoteVehicle
    request: OperatorRequest
    place: _Place
    was_under_way: bool = False

    def is_under_way(self, shown: RemoteVehicle | None) -> bool:
        """Return whether the vehicle still flies to this destination, judged by its own state if it publishes one."""
        if shown is not self.vehicle or (self.request.is_done and self.request.outcome is not RequestOutcome.ACCEPTED):
            return False
        s, (north, east, height) = self.vehicle.snapshot, self.place
        if self.vehicle.kind == "mufly" and self.request.is_done:
            before, self.was_under_way = self.was_under_way, self.was_under_way or s.state in _MOVING_STATES
            if before and (s.state not in _MOVING_STATES or s.mission_running):
                return False
        away = math.dist(s.estimate.position.tolist(), (north, east, -height))
        return s.flying and not away < _REACHED_DISTANCE_M


class CommandBar:
    """Bar with the command buttons and destination fields of one browser window.

    Parameters
    ----------
    view : WindowView
    place : callable
        Called with the height typed for the waypoint (m).
    target : callable
        Called with the destination (north, east, height; m) while the vehicle flies there, and then with None.
    """

    def __init__(
        self, view: WindowView, place: Callable[[float], None], target: Callable[[_Place | None], None]
    ) -> None:
        self._view, self._tell_target = view, target
        self._sent: SentDestination | None = None
        self._confirm = Confirmation(view.session.clock)
        self._shown: list[str] = []
        self._banner_shown = ("?", "")
        self._actions: dict[str, ActionButton] = {}
        self._beware = ""
        row = "mf-row"
        with make_element("section", classes="mf-commands").props('aria-label="commands"') as self._section:
            with make_element("div", classes="mf-banner").props("role=status") as self._banner:
                self._banner_text, self._banner_button = make_element("span"), make_element("button")
                self._banner_button.props("type=button data-testid=take-controls")
                self._banner_button.on("click", self._take_over_control, args=[])
            self._add_action_button(
                "mission", "Start mission", "M", self._make_command_action("start_mission"), classes="mf-primary"
            )
            with make_element("div", classes=row):
                self._add_action_button("arm", "Arm", "A", self._toggle_arm, classes="mf-small")
                self._add_action_button("take_off", "Take off", "T", self._take_off_to_height, "take-off")
                self._height = _NumberField("to", 1.0, "take-off height (m)", "m")
            with make_element("div", classes=row):
                self._add_action_button("pause", "Hover", "H", self._make_command_action("pause"))
                self._add_action_button("land", "Land", "L", self._make_command_action("land"))
                self._add_action_button("return", "Return", "R", self._make_command_action("return_home"))
            with make_element("div", classes=f"{row} mf-goto"):
                self._place = (
                    _NumberField("N", 0.0, "north (m)"),
                    _NumberField("E", 0.0, "east (m)"),
                    _NumberField("height", 1.0, "height of the destination (m)"),
                )
                for field in self._place:
                    field.panel.on("enter", self._go_to_typed_position, args=[])
                self._place[2].on_change = place
                self._add_action_button("go_to", "Go", "G", self._go_to_typed_position, "goto")
            self._log = make_element("ol", classes="mf-requests").props('role=status aria-label="requests"')
        self.refresh()

    def _add_action_button(
        self, name: str, label: str, key: str, press: Callable[[], None], test_id: str = "", classes: str = ""
    ) -> None:
        def press_confirmed() -> None:
            """Press the action; most actions that start motion or a descent need a second press."""
            if not self._needs_confirmation(name) or self._confirm.register_press((self._view.shown_vehicle(), name)):
                press()
            self.refresh()

        self._actions[name] = ActionButton(
            label, test_id or name, f"Shift+{key}", press_confirmed, classes, refuse=self._show_refusal
        )

    def _needs_confirmation(self, name: str) -> bool:
        vehicle = self._view.shown_vehicle()
        if name == "arm" and vehicle is not None and vehicle.snapshot.armed:
            return False  # disarmed; in flight the vehicle refuses that
        return name in COMMANDS_NEEDING_CONFIRMATION

    # ---- what the buttons do

    def _send_request(self, ask: Callable[[RemoteVehicle], OperatorRequest]) -> None:
        vehicle = self._view.shown_vehicle()
        if vehicle is not None:
            self._view.keep_request(ask(vehicle))
        self.refresh()

    def _make_command_action(self, name: str) -> Callable[[], None]:
        return lambda: self._send_request(lambda vehicle: getattr(vehicle, name)())

    def _show_refusal(self, text: str, why: str) -> None:
        self._view.keep_request(OperatorRequest(text, RequestOutcome.REFUSED, why))
        self.refresh()

    def _take_off_to_height(self) -> None:
        height = self._height.value
        if TAKE_OFF_HEIGHT_RANGE_M[0] <= height <= TAKE_OFF_HEIGHT_RANGE_M[1]:
            self._send_request(lambda vehicle: vehicle.take_off(height))
        else:
            self._show_refusal(
                f"take off to {height:g} m",
                f"enter {TAKE_OFF_HEIGHT_RANGE_M[0]:g} to {TAKE_OFF_HEIGHT_RANGE_M[1]:g} m",
            )

    def _go_to_typed_position(self) -> None:
        self.go_to(*(field.value for field in self._place))

    def go_to(self, north: float, east: float, height: float) -> None:
        """Send the vehicle to a point (m; height above the floor), if that can be done now."""
        self.fill_destination_fields(north, east, height)
        why = self.refusal_reasons()["go_to"]
        if not all(math.isfinite(x) and abs(x) < 1e5 for x in (north, east, height)) or height <= 0.0:
            why = "enter finite numbers and a height above the floor"
        vehicle, place = self._view.shown_vehicle(), (north, east, -height)
        errand = DestinationCheck() if vehicle is None or why else check_vehicle_destination(vehicle, place)
        why = why or errand.refusal_reason
        if why:
            self._show_refusal(f"go to N {north:.2f}, E {east:.2f}, height {height:.2f} m", why)
        elif errand.caution_reason and not self._confirm.register_press((vehicle, "go_to", place)):
            self._beware = errand.caution_reason
            self.refresh()
        elif vehicle is not None:
            request = vehicle.go_to((north, east, -height))
            self._sent = SentDestination(vehicle, request, (north, east, height))
            self._tell_target(self._sent.place)
            self._send_request(lambda _: request)

    def fill_destination_fields(self, *place: float) -> None:
        """Show a point (north, east, height; m) in the fields, without flying there."""
        for field, value in zip(self._place, place, strict=True):
            field.show_value(value)

    def _typed_position(self) -> tuple[float, float, float]:
        north, east, height = (field.value for field in self._place)
        return north, east, -height

    def _toggle_arm(self) -> None:
        self._send_request(lambda vehicle: vehicle.disarm() if vehicle.snapshot.armed else vehicle.arm())

    def _take_over_control(self) -> None:
        if not self._view.has_controls:
            self._view.take_controls()
            self.refresh()
        else:
            self._make_command_action("request_operator_control")()

    # ---- what they show

    def refusal_reasons(self) -> dict[str, str]:
        """Return the reason why each command is unavailable, "" if available."""
        vehicle, source = self._view.shown_vehicle(), self._view.shown_source()
        unready = ""
        if vehicle is not None and not vehicle.snapshot.flying:
            # The station's other checks advise; whether it can be armed is for the vehicle to say.
            unready = next(
                (c.text for c in vehicle.preflight_checks if c.ok is False and c.name == PREARM_CHECKS_NAME), ""
            )
        return find_refusal_reasons(
            vehicle.snapshot if vehicle is not None else None,
            kind=source.kind if source is not None else "other",
            has_controls=self._view.has_controls,
            rows=len(vehicle.mission_rows) if vehicle is not None else 0,
            unready=unready,
        )

    def refresh(self) -> None:
        """Update the buttons; unchanged ones are not sent."""
        vehicle = self._view.shown_vehicle()
        snapshot = vehicle.snapshot if vehicle is not None else None
        why = self.refusal_reasons()
        labels = {"mission": mission_button_label(snapshot)}
        if snapshot is not None and snapshot.armed:
            labels["arm"], why["arm"] = "Disarm", why["disarm"]
        failed = [] if vehicle is None or vehicle.snapshot.flying else failed_check_names(vehicle.preflight_checks)
        own = [name for name in failed if name not in ("mission", "endurance")]
        against = {
            name: f"checks failed: {', '.join(names)}" if names else ""
            for name, names in (("mission", failed), ("take_off", own))
        }
        for name, action in self._actions.items():
            label, note = labels.get(name, action.label), against.get(name, "")
            caution = bool(note)
            if name == "mission" and note and not why[name]:
                label = f"{label} anyway"
            if self._confirm.would_be_second_press((vehicle, name)):
                label, note, caution = "Confirm", f"press again to {COMMANDS_NEEDING_CONFIRMATION[name]}", True
            elif name == "go_to" and self._confirm.would_be_second_press((vehicle, name, self._typed_position())):
                label, note, caution = "Confirm", self._beware, True
            action.show_state(label, why[name], note, caution)
        self._show_banner(vehicle, snapshot)
        self._show_requests()
        if self._sent is not None and not self._sent.is_under_way(vehicle):
            self._sent = None
            self._tell_target(None)

    def _show_banner(self, vehicle: RemoteVehicle | None, s: VehicleSnapshot | None) -> None:
        text, button, replay = "", "", self._view.replay
        if replay is not None:
            text = _describe_facts(replay.recording.recording_facts)
        elif vehicle is None:
            text = self._view.session.describe_waiting(self._view.selected)
        elif not self._view.has_controls:
            other = self._view.session.controls_holder
            text = "Another window has control" if other else "No window has control"
            button = "Take control in this window"
        elif s is not None and s.commander and not s.in_command:
            text, button = f"View only: {s.commander} has operator control", "Take operator control"
        if (text, button) == self._banner_shown:
            return
        self._banner_shown = (text, button)
        _set_hidden(self._section, replay is not None, "mf-watching")
        self._banner_text._text, self._banner_button._text = text, button
        _set_hidden(self._banner_button, not button)
        _set_hidden(self._banner, not text)
        for e in (self._banner_text, self._banner_button, self._banner):
            e.update()

    def _show_requests(self) -> None:
        requests = self._view.recent_requests()
        lines = [_describe_request(r) for r in requests]
        if lines == self._shown:
            return
        self._shown = lines
        self._log.clear()
        with self._log:
            for line, request in zip(lines, requests, strict=True):
                make_element("li", line, f"mf-request-{request.outcome.value.replace(' ', '-')}")


def _describe_request(r: OperatorRequest) -> str:
    progress = f" {r.progress:.0%}" if not r.is_done and r.progress else ""
    answer = f": {r.answer}" if r.answer else ""
    return f"{_OUTCOME_MARKS[r.outcome]} {r.text}{progress}{answer}"
