"""The page itself: what stands where. The style sheet places it for laptops and tablets."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mufly.station.checks import OWN_CHECKS
from mufly.station.comparison import ALIGNMENTS
from mufly.station.history import Outcome, Request, Snapshot
from mufly.station.page.alerts import Watch
from mufly.station.page.caution import CONFIRMED, Confirmation, Errand, errand_of, failed_checks
from mufly.station.page.editor import MissionEditor
from mufly.station.page.flights import FlightList
from mufly.station.page.hand import StickPanel
from mufly.station.page.panels import (
    Action,
    FlightStrip,
    Panel,
    button,
    check_drawer,
    element,
    mission_drawer,
    parameter_drawer,
    refuse,
    sensor_drawer,
    static_url,
)
from mufly.station.page.session import View, availability, mission_label
from mufly.station.remote import RemoteVehicle

REFRESH_S = 0.2
MOST_OFFSET_S = 1e6
"""By how much a second recording may be moved over the first (s)."""
_KEYS = (
    ("Shift + T, twice", "take off"),
    ("Shift + M, twice", "fly or resume the mission"),
    ("Shift + H", "hover: stop and stay"),
    ("Shift + G", "go to the point in the fields N, E, height"),
    ("Shift + L, twice", "land"),
    ("Shift + R, twice", "return and land"),
    ("Shift + A, twice", "arm; once: disarm"),
    ("Shift + ⌫, twice", "emergency stop: motors off; in text fields and dialogs too"),
    ("space", "play or pause a recording"),
    ("m", "mark this moment in the recording"),
    ("d", "dark or light"),
    ("Ctrl + Z, Ctrl + Y", "in the plan: undo, redo; Del deletes, arrows move the point"),
    ("?", "this list"),
)
_HINTS = (
    "Click on the floor to choose a waypoint; click its mark again, or Send, to fly there.",
    "In the tab Plan the 3-D view draws a mission: click adds, drag moves, ↕ or Shift changes the height.",
    "Drag turns the 3-D view, right drag moves it, the wheel zooms.",
    "In a plot the wheel zooms the time axis, drag moves it, a double click goes back to live.",
    "Commands need Shift, so that a stray letter flies nothing. The emergency stop is on top of everything.",
)


def build(view: View) -> None:
    """Build the page of one window."""
    ui.add_head_html(f'<link rel="stylesheet" href="{static_url()}/station.css">')
    dark = ui.dark_mode(None)
    ui.colors(primary="#2f7fb8")
    strip = FlightStrip(view)
    editor = MissionEditor(view)
    with element("div", classes="mf-page"):
        say = _header(view, dark)
        with _labelled("aside", "instruments", "mf-left"):
            for module, title in (
                ("flight", ""),
                ("actuators", "Motors and servos"),
                ("ranges", "Ranges, nose up"),
            ):
                with _labelled("section", title, f"mf-card mf-card-{module}"):
                    if title:
                        element("h2", title)
                    Panel(module)
        with element("main", classes="mf-centre"):
            scene = Panel("scene")
            Panel("starting")
            sticks = StickPanel(view, lambda: bar.reasons()["sticks"])
            with element("div", classes="mf-replay-row").props("hidden"):
                Panel("replaybar").on("replay", lambda e: _replay(view, e))
        refresh_parameters = _dock(view, editor)
        with _labelled("aside", "commands and mission", "mf-right"):
            bar = CommandBar(
                view,
                lambda height: scene.call("setHeight", height),
                lambda place: scene.call("setTarget", place),
            )
            _right_tabs(view)
    Panel("keys")
    Panel("hints")
    scene.on("place", lambda e: _point(e, bar.choose))
    scene.on("goto", lambda e: _point(e, bar.go_to))

    view.on_late = refuse

    def refresh() -> None:
        if not view.live:
            return  # nobody sees it; what changes meanwhile is shown when the window is back
        strip.refresh()
        bar.refresh()
        refresh_parameters()
        editor.refresh()
        sticks.refresh()
        say()

    ui.timer(REFRESH_S, refresh)


def _labelled(tag: str, label: str, classes: str) -> Element:
    made = element(tag, classes=classes)
    return made.props(f'aria-label="{label}"') if label else made


def _point(e: GenericEventArguments, take: Callable[[float, float, float], None]) -> None:
    content = e.args if isinstance(e.args, dict) else {}
    try:
        north, east, height = (float(content[k]) for k in ("north", "east", "height"))
    except (KeyError, TypeError, ValueError):
        return
    if all(map(math.isfinite, (north, east, height))):
        take(north, east, height)


def _header(view: View, dark: ui.dark_mode) -> Callable[[], None]:
    async def switch() -> None:
        now = await ui.run_javascript("document.body.classList.contains('body--dark')")
        dark.set_value(not now)

    with element("header", classes="mf-header"):
        with element("div", classes="mf-brand"):
            element("span", "mufly", "mf-brand-name")
            Panel("vehicles").on("select", lambda e: view.select(str(e.args)))
        Panel("status")
        with element("div", classes="mf-header-tools"):
            _recorder(view)
            say = _alerts(view)
            _icon("◐", switch, "d", "dark or light", "dark or light (d)")
            with ui.dialog() as keys, element("div", classes="mf-help"):
                _help()
            _icon("?", keys.open, "?", "help", "keyboard and help (?)")
    return say


def _alerts(view: View) -> Callable[[], None]:
    """The switch of what is said aloud. Returns the function that says what is new."""
    panel = Panel("alerts")
    watches: dict[str, Watch] = {}

    def say() -> None:
        vehicle = view.vehicle() or next(iter(view.session.vehicles()), None)
        if vehicle is None:
            return
        watch = watches.setdefault(vehicle.key, Watch())
        found = watch.look(
            time.monotonic(), vehicle.snapshot, list(vehicle.messages), vehicle.mission, view.requests()
        )
        if found:
            panel.call("say", [{"level": a.level, "text": a.text} for a in found])

    return say


def _icon(text: str, press: Callable[[], object], key: str, label: str, title: str) -> None:
    made = button(text, press, title=title, classes="mf-icon-button")
    made.props(f'data-key="{key}" aria-label="{label}"')


def _help() -> None:
    element("h2", "Keyboard")
    with element("dl"):
        for key, meaning in _KEYS:
            element("dt", key)
            element("dd", meaning)
    element("h2", "Pointer")
    with element("ul"):
        for hint in _HINTS:
            element("li", hint)


def _recorder(view: View) -> None:
    recorder = view.session.recorder
    if recorder is None:
        return

    def mark() -> None:
        text = (field.value or "").strip() or "mark"
        recorder.mark(text)
        if view.vehicle() is not None:
            view.ask(Request(f"mark: {text}", Outcome.ACCEPTED))
        field.value = ""
        marks.close()

    def toggle() -> None:
        recorder.stop() if recorder.recording else recorder.start()
        show()

    with ui.dialog() as marks, element("div", classes="mf-help"):
        element("h2", "Mark this moment")
        field = (
            ui.input("text", placeholder="gust from the left").props("autofocus").on("keydown.enter", mark)
        )
        button("Set the mark", mark, classes="mf-primary-button")
    record = button("● Record", toggle, test="record")
    button("Mark", marks.open, title="put a mark into the recording (m)").props('data-key="m"')
    state: list[bool | None] = [None]

    def show() -> None:
        on = bool(recorder.recording)
        if state[0] == on:
            return
        state[0] = on
        record._text = "■ Recording" if on else "● Record"
        title = "recording; press to stop" if on else "record"
        record.props(f'aria-pressed={str(on).lower()} title="{title}"')
        record.classes(add="mf-recording" if on else "", remove="" if on else "mf-recording")
        record.update()

    show()
    ui.timer(0.5, show)


def _dock(view: View, editor: MissionEditor) -> Callable[[], None]:
    with _labelled("section", "plots, spectrum, plan, parameters, recordings, camera", "mf-dock"):
        with ui.tabs().props("dense no-caps align=left inline-label").classes("mf-tabs") as tabs:
            plots, spectrum, plan, parameters, recordings = map(
                ui.tab, ("Plots", "Spectrum", "Plan", "Parameters", "Recordings")
            )
            camera = None if view.session.sight is None else ui.tab("Camera")
        with ui.tab_panels(tabs, value=camera or plots, animated=False, keep_alive=False) as panels:
            panels.classes("mf-tab-panels")
            if camera is not None:
                with ui.tab_panel(camera):
                    Panel("camera")
            with ui.tab_panel(plots):
                Panel("plots")
            with ui.tab_panel(spectrum):
                Panel("spectrum")
            with ui.tab_panel(plan):
                editor.tab()
            with ui.tab_panel(parameters):
                refresh = parameter_drawer(view)
            with ui.tab_panel(recordings):
                FlightList(view)
    return refresh


def _right_tabs(view: View) -> None:
    with ui.tabs().props("dense no-caps align=left").classes("mf-tabs mf-tabs-narrow") as tabs:
        checks, sensors, mission, messages = map(ui.tab, ("Checks", "Sensors", "Mission", "Messages"))
    recording = view.session.to_open is not None
    with ui.tab_panels(tabs, value=mission if recording else checks, animated=False).classes("mf-tab-panels"):
        with ui.tab_panel(checks):
            check_drawer(view)
        with ui.tab_panel(sensors):
            sensor_drawer(view)
        with ui.tab_panel(mission):
            mission_drawer(view)
        with ui.tab_panel(messages):
            Panel("messages")


def _replay(view: View, e: GenericEventArguments) -> None:
    """Do what the slider of a recording says."""
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
    compared = view.comparison()
    if compared is not None and ("by" in content or "offset" in content):
        by, offset = content.get("by", compared.by), content.get("offset", compared.offset_s)
        if by in ALIGNMENTS and isinstance(offset, int | float) and abs(offset) < MOST_OFFSET_S:
            view.compare(compared.second, by, float(offset))
    if content.get("alone"):
        view.compare(None)
    if content.get("close"):
        view.close_recording()


# ----------------------------------------------------------------------------
# The buttons that command the vehicle, each with the reason why it cannot be used, and what became of requests.


HEIGHT_M = (0.2, 50.0)
_MARKS = {
    Outcome.WAITING: "…",
    Outcome.ACCEPTED: "✓",
    Outcome.REFUSED: "✕ refused",
    Outcome.TIMED_OUT: "✕ no answer",
}


def _facts(facts: dict[str, Any]) -> str:
    """What a recording says of itself, in a line."""
    outcome = " ".join(str(facts[k]) for k in ("outcome", "reason") if facts.get(k))
    start = str(facts.get("start_time", ""))[:19].replace("T", " ")
    whole = "" if facts.get("complete", True) else "cut off: shown as far as it goes"
    parts = (str(facts.get("vehicle", "")), str(facts.get("mission", "")), outcome, start, whole)
    return "Recording: " + "; ".join(p for p in parts if p)


def _hide(element: Element, hidden: bool, name: str = "mf-hidden") -> None:
    element.classes(add=name if hidden else "", remove="" if hidden else name)


class _Field:
    """A number that is typed."""

    def __init__(self, label: str, value: float, meaning: str, unit: str = "") -> None:
        self.value = value
        self.on_change: Callable[[float], None] = lambda _: None
        test = "field-" + meaning.split()[0]
        options = {"label": label, "value": value, "meaning": meaning, "unit": unit, "test": test}
        self.panel = Panel("field", options)
        self.panel.on("change", self._changed)

    def _changed(self, e: GenericEventArguments) -> None:
        if isinstance(e.args, int | float) and math.isfinite(e.args):
            self.value = float(e.args)
            self.on_change(self.value)

    def show(self, value: float) -> None:
        """Show another number."""
        if value != self.value:
            self.value = value
            self.panel.call("set", value)


_Place = tuple[float, float, float]
_REACH_M = 0.15
_UNDER_WAY = frozenset({"waypoint", "obstacle"})


@dataclass(slots=True)
class Sent:
    """A place (north, east, height; m) that a vehicle was sent to."""

    vehicle: RemoteVehicle
    request: Request
    place: _Place
    seen: bool = False

    def on_its_way(self, shown: RemoteVehicle | None) -> bool:
        """Whether it flies there still; what the vehicle says of itself decides, where it says it."""
        if shown is not self.vehicle or (self.request.done and self.request.outcome is not Outcome.ACCEPTED):
            return False
        s, (north, east, height) = self.vehicle.snapshot, self.place
        if self.vehicle.kind == "mufly" and self.request.done:
            before, self.seen = self.seen, self.seen or s.state in _UNDER_WAY
            if before and (s.state not in _UNDER_WAY or s.mission_running):
                return False
        away = math.dist(s.estimate.position.tolist(), (north, east, -height))
        return s.flying and not away < _REACH_M


class CommandBar:
    """Commands of one window.

    Parameters
    ----------
    view : View
    place : callable
        Told the height (m) that was typed for the waypoint.
    target : callable
        Told where the vehicle was sent (north, east, height; m) while it is on its way there; then None.
    """

    def __init__(
        self, view: View, place: Callable[[float], None], target: Callable[[_Place | None], None]
    ) -> None:
        self._view, self._tell_target = view, target
        self._sent: Sent | None = None
        self._confirm = Confirmation(view.session.clock)
        self._shown: list[str] = []
        self._banner_shown = ("?", "")
        self._actions: dict[str, Action] = {}
        self._beware = ""
        row = "mf-row"
        with element("section", classes="mf-commands").props('aria-label="commands"') as self._section:
            with element("div", classes="mf-banner").props("role=status") as self._banner:
                self._banner_text, self._banner_button = element("span"), element("button")
                self._banner_button.props("type=button data-testid=take-controls")
                self._banner_button.on("click", self._take, args=[])
            self._action("mission", "Fly the mission", "M", self._do("start_mission"), classes="mf-primary")
            with element("div", classes=row):
                self._action("arm", "Arm", "A", self._toggle_arm, classes="mf-small")
                self._action("take_off", "Take off", "T", self._go_up, "take-off")
                self._height = _Field("to", 1.0, "height of take-off in m", "m")
            with element("div", classes=row):
                self._action("pause", "Hover", "H", self._do("pause"))
                self._action("land", "Land", "L", self._do("land"))
                self._action("return", "Return", "R", self._do("return_home"))
            with element("div", classes=f"{row} mf-goto"):
                self._place = (
                    _Field("N", 0.0, "north in m"),
                    _Field("E", 0.0, "east in m"),
                    _Field("height", 1.0, "height of the waypoint in m"),
                )
                for field in self._place:
                    field.panel.on("enter", self._go_there, args=[])
                self._place[2].on_change = place
                self._action("go_to", "Go", "G", self._go_there, "goto")
            self._log = element("ol", classes="mf-requests").props('role=status aria-label="requests"')
        self.refresh()

    def _action(
        self, name: str, label: str, key: str, press: Callable[[], None], test_id: str = "", classes: str = ""
    ) -> None:
        def sure() -> None:
            """Most of what sets it in motion, or brings it down, is pressed twice."""
            if not self._asks_twice(name) or self._confirm.press((self._view.vehicle(), name)):
                press()
            self.refresh()

        self._actions[name] = Action(
            label, test_id or name, f"Shift+{key}", sure, classes, refuse=self._refuse
        )

    def _asks_twice(self, name: str) -> bool:
        vehicle = self._view.vehicle()
        if name == "arm" and vehicle is not None and vehicle.snapshot.armed:
            return False  # disarmed; in flight the vehicle refuses that
        return name in CONFIRMED

    # ---- what the buttons do

    def _ask(self, ask: Callable[[RemoteVehicle], Request]) -> None:
        vehicle = self._view.vehicle()
        if vehicle is not None:
            self._view.ask(ask(vehicle))
        self.refresh()

    def _do(self, name: str) -> Callable[[], None]:
        return lambda: self._ask(lambda vehicle: getattr(vehicle, name)())

    def _refuse(self, text: str, why: str) -> None:
        self._view.ask(Request(text, Outcome.REFUSED, why))
        self.refresh()

    def _go_up(self) -> None:
        height = self._height.value
        if HEIGHT_M[0] <= height <= HEIGHT_M[1]:
            self._ask(lambda vehicle: vehicle.take_off(height))
        else:
            self._refuse(f"take off to {height:g} m", f"give {HEIGHT_M[0]:g} to {HEIGHT_M[1]:g} m")

    def _go_there(self) -> None:
        self.go_to(*(field.value for field in self._place))

    def go_to(self, north: float, east: float, height: float) -> None:
        """Send the vehicle to a point (m; height above the floor), if that can be done now."""
        self.choose(north, east, height)
        why = self.reasons()["go_to"]
        if not all(math.isfinite(x) and abs(x) < 1e5 for x in (north, east, height)) or height <= 0.0:
            why = "give finite metres and a height above the floor"
        vehicle, place = self._view.vehicle(), (north, east, -height)
        errand = Errand() if vehicle is None or why else errand_of(vehicle, place)
        why = why or errand.refused
        if why:
            self._refuse(f"go to N {north:.2f}, E {east:.2f}, height {height:.2f} m", why)
        elif errand.beware and not self._confirm.press((vehicle, "go_to", place)):
            self._beware = errand.beware
            self.refresh()
        elif vehicle is not None:
            request = vehicle.go_to((north, east, -height))
            self._sent = Sent(vehicle, request, (north, east, height))
            self._tell_target(self._sent.place)
            self._ask(lambda _: request)

    def choose(self, *place: float) -> None:
        """Show a point (north, east, height; m) in the fields, without flying there."""
        for field, value in zip(self._place, place, strict=True):
            field.show(value)

    def _place_typed(self) -> tuple[float, float, float]:
        north, east, height = (field.value for field in self._place)
        return north, east, -height

    def _toggle_arm(self) -> None:
        self._ask(lambda vehicle: vehicle.disarm() if vehicle.snapshot.armed else vehicle.arm())

    def _take(self) -> None:
        if not self._view.has_controls:
            self._view.take_controls()
            self.refresh()
        else:
            self._do("take_command")()

    # ---- what they show

    def reasons(self) -> dict[str, str]:
        """Why each command cannot be given now, "" if it can."""
        vehicle, source = self._view.vehicle(), self._view.source()
        unready = ""
        if vehicle is not None and not vehicle.snapshot.flying:
            # The station's other checks advise; whether it can be armed is for the vehicle to say.
            unready = next((c.text for c in vehicle.checks if c.ok is False and c.name == OWN_CHECKS), "")
        return availability(
            vehicle.snapshot if vehicle is not None else None,
            kind=source.kind if source is not None else "other",
            has_controls=self._view.has_controls,
            rows=len(vehicle.mission) if vehicle is not None else 0,
            unready=unready,
        )

    def refresh(self) -> None:
        """Bring the buttons up to date; what has not changed is not sent."""
        vehicle = self._view.vehicle()
        snapshot = vehicle.snapshot if vehicle is not None else None
        why = self.reasons()
        labels = {"mission": mission_label(snapshot)}
        if snapshot is not None and snapshot.armed:
            labels["arm"], why["arm"] = "Disarm", why["disarm"]
        failed = [] if vehicle is None or vehicle.snapshot.flying else failed_checks(vehicle.checks)
        own = [name for name in failed if name not in ("mission", "time to fly")]
        against = {
            name: f"failed: {', '.join(names)}" if names else ""
            for name, names in (("mission", failed), ("take_off", own))
        }
        for name, action in self._actions.items():
            label, note = labels.get(name, action.label), against.get(name, "")
            caution = bool(note)
            if name == "mission" and note and not why[name]:
                label = f"{label} anyway"
            if self._confirm.waits_for((vehicle, name)):
                label, note, caution = "Press again", f"to {CONFIRMED[name]}", True
            elif name == "go_to" and self._confirm.waits_for((vehicle, name, self._place_typed())):
                label, note, caution = "Again", self._beware, True
            action.show(label, why[name], note, caution)
        self._show_banner(vehicle, snapshot)
        self._show_requests()
        if self._sent is not None and not self._sent.on_its_way(vehicle):
            self._sent = None
            self._tell_target(None)

    def _show_banner(self, vehicle: RemoteVehicle | None, s: Snapshot | None) -> None:
        text, button, replay = "", "", self._view.replay
        if replay is not None:
            text = _facts(replay.recording.facts)
        elif vehicle is None:
            text = self._view.session.waiting_words(self._view.selected)
        elif not self._view.has_controls:
            other = self._view.session.holder
            text = "The controls are with another window" if other else "No window holds the controls"
            button = "Take the controls"
        elif s is not None and s.commander and not s.in_command:
            text, button = f"Watching: commanded by {s.commander}", "Take command"
        if (text, button) == self._banner_shown:
            return
        self._banner_shown = (text, button)
        _hide(self._section, replay is not None, "mf-watching")
        self._banner_text._text, self._banner_button._text = text, button
        _hide(self._banner_button, not button)
        _hide(self._banner, not text)
        for e in (self._banner_text, self._banner_button, self._banner):
            e.update()

    def _show_requests(self) -> None:
        requests = self._view.requests()
        lines = [_line(r) for r in requests]
        if lines == self._shown:
            return
        self._shown = lines
        self._log.clear()
        with self._log:
            for line, request in zip(lines, requests, strict=True):
                element("li", line, f"mf-request-{request.outcome.value.replace(' ', '-')}")


def _line(r: Request) -> str:
    progress = f" {r.progress:.0%}" if not r.done and r.progress else ""
    answer = f": {r.answer}" if r.answer else ""
    return f"{_MARKS[r.outcome]} {r.text}{progress}{answer}"
