"""What the page is put together from: panels that the browser draws, buttons, and the drawers with tables and files."""

from __future__ import annotations

import asyncio
import hashlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nicegui
from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments, UploadEventArguments

from mufly.errors import MuflyError
from mufly.link.commands import FAILURES
from mufly.link.ports import elapsed_s
from mufly.mission import FILE_ENDINGS, Mission, dump_mission, mission_from, mission_tables
from mufly.sensors import TARGETS
from mufly.station.history import Outcome, Request
from mufly.station.page.drafts import kept_back, of_vehicle
from mufly.station.page.session import (
    ANSWER_S,
    Source,
    View,
    availability,
    parameter_file,
    read_parameter_file,
)
from mufly.station.remote import RemoteVehicle
from mufly.station.transfers import refused
from mufly.vehicle_types import AUTOPILOT_COMPONENT

STATIC = Path(__file__).parent / "static"
MOST_BYTES, MOST_RECORDING_BYTES = 2_000_000, 1_000_000_000
WATCHED_S = 30.0
_LOOK_S = 0.05
_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
CONFIRM_S = 3.0
_STOP_WORDS = {
    Outcome.WAITING: "asked",
    Outcome.ACCEPTED: "done: motors off",
    Outcome.REFUSED: "REFUSED",
    Outcome.TIMED_OUT: "NO ANSWER",
}


def static_url() -> str:
    """Where the static files are served: the name changes with their content, so that no browser keeps old ones."""
    digest = hashlib.sha256()
    for path in sorted(STATIC.iterdir()):
        digest.update(path.name.encode() + path.read_bytes())
    return f"/mufly/{digest.hexdigest()[:12]}"


_URL = static_url()


class Panel(Element, component=STATIC / "mufly_panel.js", esm={"nicegui-scene": str(_THREE)}):
    """A panel that the browser draws by itself from the stream of frames: one of the modules in ``static/``.

    Parameters
    ----------
    module : str
        ``scene``, ``plots``, ``flight``, ...
    options : dict, optional
        What its ``mount`` gets.
    """

    def __init__(self, module: str, options: dict[str, Any] | None = None) -> None:
        super().__init__()
        self._props.update(module=module, base=_URL, options=options or {})
        self.classes(f"mf-{module}")

    def call(self, name: str, *arguments: Any) -> None:
        """Call a method of the module in the browser."""
        self.run_method("call", name, *arguments)


def element(tag: str, text: str = "", classes: str = "") -> Element:
    """Return an element with a text."""
    made = ui.element(tag).classes(classes)
    if text:
        made._text = text
    return made


def button(
    text: str, press: Callable[..., object], *, test: str = "", title: str = "", classes: str = ""
) -> Element:
    """Return a plain button."""
    made = element("button", text, classes).props(f'type=button data-testid="{test}" title="{title or text}"')
    return made.on("click", press, args=[])


class Action:
    """A button of two lines: what it does, and why it cannot.

    Parameters
    ----------
    label, test_id : str
    key : str
        That presses it (``static/keys.js``).
    press : callable
    classes : str
    note : str, optional
        The second line of a button that can be used; default the key.
    refuse : callable, optional
        Told of a press that came when it could not be used any more: what it does, and why it cannot.
    """

    def __init__(
        self,
        label: str,
        test_id: str,
        key: str,
        press: Callable[[], None],
        classes: str,
        note: str = "",
        refuse: Callable[[str, str], None] = lambda label, reason: None,
    ) -> None:
        self.label, self._key, self._note = label, key, note or key
        self._press, self._refuse = press, refuse
        self._state: tuple[str, str, str] = ("", "?", "")
        self._caution = False
        self._button = element("button", classes=f"mf-action {classes}")
        self._button.props(f'type=button data-testid={test_id} data-key="{key}"')
        self._button.on("click", self._clicked, args=[])
        with self._button:
            self._lines = (
                element("span", classes="mf-action-label"),
                element("span", classes="mf-action-reason"),
            )
        self.show(label, "")

    def _clicked(self) -> None:
        label, reason, _ = self._state
        if reason:  # the click was under way when it was disabled
            self._refuse(label.lower(), reason)
        else:
            self._press()

    def show(self, label: str, reason: str, note: str = "", caution: bool = False) -> None:
        """Say what it does, why it cannot be used ("": it can), and what else there is to know of it.

        ``caution``: something speaks against it, or it waits for a second press.
        """
        if caution != self._caution:
            self._caution = caution
            self._button.classes(**({"add": "mf-caution"} if caution else {"remove": "mf-caution"}))
        if (label, reason, note) == self._state:
            return
        self._state = (label, reason, note)
        for line, text in zip(self._lines, (label, reason or note or self._note), strict=True):
            line._text = text
            line.update()
        self._button.props("disabled") if reason else self._button.props(remove="disabled")
        self._button.props["title"] = reason or (f"{label}: {note}" if note else f"{label} ({self._note})")
        self._button.update()


def pick(
    label: str,
    ending: str,
    taken: Callable[[UploadEventArguments], object],
    test: str,
    most_bytes: int = MOST_BYTES,
    classes: str = "",
) -> None:
    """Add a button that opens a file: the uploader itself stays out of sight."""
    upload = ui.upload(auto_upload=True, max_file_size=most_bytes, on_upload=taken)
    upload.props(f'accept="{ending}" data-testid="{test}"').classes("mf-hidden")
    upload.props(':headers="() => window.muflyLive.headers()"')
    upload.on_rejected(lambda: refuse("that file is too large or of another kind"))
    upload.on(
        "failed",
        lambda: refuse("that file was not taken: it reached the station too late; choose it again"),
        args=[],
    )

    async def choose() -> None:
        upload.run_method("pickFiles")

    button(label, choose, title=f"{label} ({ending})", classes=classes)


def say(text: str, good: bool = True) -> None:
    kind: Any = "positive" if good else "warning"
    ui.notify(text, type=kind, position="bottom", timeout=4000, close_button="OK")


def refuse(text: str) -> None:
    say(text, good=False)


def _blocked(view: View) -> str:
    """Why this window may not change the vehicle; "" if it may."""
    vehicle = view.vehicle()
    if vehicle is None:
        return "no vehicle is shown"
    if not view.has_controls:
        return "another window has the controls"
    s = vehicle.snapshot
    return f"commanded by {s.commander}" if s.commander and not s.in_command else ""


def may_change(view: View, what: str) -> RemoteVehicle | None:
    """The vehicle, if this window may change it; else None, and why ``what`` was not done is said."""
    if why := _blocked(view):
        refuse(f"not {what}: {why}")
        return None
    return view.vehicle()


def check_drawer(view: View) -> None:
    """Pre-flight checks, and what one does before and after a flight."""

    def release() -> None:
        vehicle = view.vehicle()
        if vehicle is None or not view.has_controls:
            refuse("not released: " + _blocked(view))
        else:
            view.ask(vehicle.release_command())

    def restart() -> None:
        vehicle = may_change(view, "started anew")
        if vehicle is not None and vehicle.snapshot.flying:
            refuse("not started anew: it flies")
        elif vehicle is not None:
            view.ask(vehicle.reboot())

    Panel("checks")
    with element("div", classes="mf-tools mf-foot mf-live-only"):
        button("Release command", release, title="let another station command the vehicle")
        button("Start anew", restart, title="reboot the vehicle; a simulation stands at its start again")


async def ended(request: Request) -> bool:
    """Wait for what becomes of a request; whether it was accepted. What became of it stands with the commands."""
    for _ in range(int(WATCHED_S / _LOOK_S)):
        if request.done:
            break
        await asyncio.sleep(_LOOK_S)
    return request.outcome is Outcome.ACCEPTED


async def send_mission(view: View, vehicle: RemoteVehicle, mission: Mission) -> None:
    """Send a mission; once the vehicle has taken it, show it, and say what of it the vehicle did not get."""
    if mission.fence is not None and mission.fence != vehicle.fence:
        view.ask(request := vehicle.upload_fence(mission.fence))  # first: the mission may need it
        if not await ended(request):
            return
    view.ask(request := vehicle.upload_mission(mission))
    if not await ended(request):
        return
    kept = kept_back(mission, view.session.sketch.held)
    view.session.mission = mission
    vehicle.show_mission(mission)
    words = f"sent: {len(mission.waypoint)} waypoints"
    say(words + (f"; the vehicle keeps its own {', '.join(kept)}" if kept else ""))


def sensor_drawer(view: View) -> None:
    """What the estimator thinks of each sensor; a simulation's may be let fail."""

    def ask(kind: int, text: str, amount: float = math.nan, duration_s: float = math.nan) -> None:
        vehicle = view.vehicle()
        if vehicle is None or not view.has_controls:
            refuse(f"{text}: " + _blocked(view))
        else:
            view.ask(vehicle.inject(int(unit.value), kind, text, amount, duration_s))

    def inject() -> None:
        how, much, lasts = (
            kinds[kind.value],
            (amount.enabled and amount.value) or math.nan,
            seconds.value or math.nan,
        )
        text = f"{units[unit.value]}: {how}"
        text += "" if math.isnan(much) else f" {much:g} {unit_of(int(unit.value), how)}"
        ask(int(kind.value), text + ("" if math.isnan(lasts) else f", {lasts:g} s"), much, lasts)

    def unit_of(which: int, how: str) -> str:
        return "s" if how == "late" else TARGETS[FAILURES[0][float(which)]].unit

    def usual() -> None:
        """Say in the field how much is usual, and in which unit."""
        how = kinds[kind.value]
        known = TARGETS[FAILURES[0][float(unit.value)]].amount.get(how)
        words = "nothing" if known is None else f"{known:g} {unit_of(int(unit.value), how)}"
        amount.props(f'placeholder="{words}"')
        amount.set_enabled(known is not None)

    Panel("sensors")
    units = {int(k): name.replace("_", " ") for k, name in FAILURES[0].items()}
    kinds = {int(k): name for k, name in FAILURES[1].items()}
    with element("div", classes="mf-tools mf-foot mf-faults mf-live-only"):
        unit = ui.select(units, value=next(iter(units))).props(
            "dense options-dense outlined aria-label=sensor"
        )
        kind = ui.select(kinds, value=next(iter(kinds))).props(
            "dense options-dense outlined aria-label=fault"
        )
        amount = ui.number("how much").props("dense outlined stack-label clearable aria-label=amount")
        seconds = ui.number("for (s)", min=0).props(
            'dense outlined stack-label clearable aria-label=seconds placeholder="ever"'
        )
        for one in (unit, kind):
            one.on_value_change(usual)
        usual()
        button("Inject", inject, test="inject", title="let this sensor of a simulated flight go wrong")
        button(
            "Clear", lambda: ask(0, "clear faults"), test="clear-faults", title="nothing is wrong any more"
        )


def mission_drawer(view: View) -> None:
    """Table of the mission, with files up and down."""

    async def upload(e: UploadEventArguments) -> None:
        vehicle = may_change(view, "sent")
        if vehicle is None:
            return
        try:
            text = (await e.file.read()).decode()
            mission = mission_from(mission_tables(text, e.file.name), e.file.name)
        except (MuflyError, ValueError) as error:
            refuse(str(error))
            return
        await send_mission(view, vehicle, mission)

    def download() -> None:
        if (vehicle := view.vehicle()) is not None:
            view.ask(vehicle.download_mission())

    def clear() -> None:
        if (vehicle := may_change(view, "cleared")) is not None:
            view.ask(vehicle.clear_mission())

    def save() -> None:
        vehicle, mission = view.vehicle(), None
        try:
            if view.replay is not None:
                mission = view.replay.recording.mission
            elif vehicle is not None and vehicle.transfers.items:
                base = view.session.mission or Mission(name="from-vehicle")
                mission = of_vehicle(vehicle.transfers.items, base, vehicle.telemetry.origin)
        except MuflyError as error:
            refuse(f"not saved: {error}")
            return
        if mission is None:
            refuse("there is no mission to save")
            return
        ui.download.content(dump_mission(mission), f"{mission.name or 'mission'}.toml")

    with element("div", classes="mf-tools"):
        pick("Upload…", ",".join(FILE_ENDINGS), upload, "mission-file", classes="mf-live-only")
        button("Fetch", download, title="fetch the mission that is in the vehicle", classes="mf-live-only")
        button("Save", save, title="save the mission as a file")
        button("Clear", clear, title="delete the mission in the vehicle", classes="mf-live-only")
    Panel("mission")


def parameter_drawer(view: View) -> Callable[[], None]:
    """Table of the parameters, undo, files. Returns the function that brings its buttons up to date."""

    written: list[tuple[str, Request]] = []  # what was sent and is not answered yet

    def write(name: str, value: float, undoable: bool = True) -> str:
        """Write one parameter; return why not, "" if it was sent."""
        vehicle, why = view.vehicle(), _blocked(view)
        if why or vehicle is None:
            return f"{name} not written: {why}"
        known = vehicle.parameters.get(name)
        if why := refused(known, name, value):
            return f"{name}: {why}"
        view.ask(request := vehicle.set_parameter(name, value))
        written.append((name, request))
        # A number that is none cannot be written again.
        if undoable and known is not None and math.isfinite(known.value):
            view.session.sheet(vehicle).wrote(name, known.value, value)
        return ""

    def edited(e: GenericEventArguments) -> None:
        content = e.args if isinstance(e.args, dict) else {}
        name, value = content.get("name"), content.get("value")
        if view.vehicle() is None or not isinstance(name, str) or not isinstance(value, int | float):
            return
        if why := write(name, float(value)):
            refuse(why)
            table.call("refused", name, why)
        refresh()

    def step(which: str) -> None:
        vehicle = view.vehicle()
        if vehicle is None:
            return
        why = _blocked(view)
        if not why and (found := getattr(view.session.sheet(vehicle), which)()) is not None:
            name, value = found
            why = write(name, value, undoable=False)
        if why:
            refuse(why)
        refresh()

    def component_of(vehicle: Source | None) -> int:
        return vehicle.component if isinstance(vehicle, RemoteVehicle) else AUTOPILOT_COMPONENT

    def save() -> None:
        vehicle = view.vehicle()
        if vehicle is None or not vehicle.parameters:
            refuse("there are no parameters to save")
            return
        text = parameter_file(vehicle.parameters, vehicle.system, component_of(vehicle))
        ui.download.content(text, f"{vehicle.name.split(',')[0].replace(' ', '-')}.params")

    async def load(e: UploadEventArguments) -> None:
        vehicle = view.vehicle()
        try:
            text = (await e.file.read()).decode()
            values = read_parameter_file(text, e.file.name, component_of(vehicle))
        except (MuflyError, ValueError) as error:
            refuse(str(error))
            return
        if vehicle is None:
            return
        # All or nothing: a file with one bad line changes nothing.
        faults = [f"{n}: {w}" for n, v in values.items() if (w := refused(vehicle.parameters.get(n), n, v))]
        if why := _blocked(view) or (faults[0] if faults else ""):
            refuse(f"nothing was written: {why}")
            return
        changed = {n: v for n, v in values.items() if vehicle.parameters[n].value != v}
        for name, value in changed.items():
            write(name, value)
        say(f"{len(changed)} of {len(values)} parameters differed and were written")
        refresh()

    def fetch() -> None:
        if (vehicle := view.vehicle()) is not None:
            view.ask(vehicle.refresh_parameters())

    with element("div", classes="mf-tools"):
        undo = button("↶ Undo", lambda: step("undo"), test="undo")
        redo = button("↷ Redo", lambda: step("redo"), test="redo")
        button("Fetch", fetch, title="fetch all parameters again")
        pick("Load…", ".params,.param,.parm,.txt", load, "parameter-file")
        button("Save", save, title="save all parameters as a file")
    table = Panel("parameters").on("write", edited)
    shown: list[object] = [None]

    def refresh() -> None:
        for name, request in [entry for entry in written if entry[1].done]:
            written.remove((name, request))
            if request.outcome is not Outcome.ACCEPTED:
                table.call("refused", name, request.answer)
        vehicle = view.vehicle()
        sheet = view.session.sheet(vehicle) if vehicle is not None else None
        state = (sheet.can_undo, sheet.can_redo) if sheet is not None else ("", "")
        if state == shown[0]:
            return
        shown[0] = state
        for made, name, word in ((undo, state[0], "undo"), (redo, state[1], "redo")):
            made.props["title"] = f"{word} the change of {name}" if name else f"nothing to {word}"
            made.props(*([] if name else ["disabled"]), remove="disabled" if name else "")
            made.update()

    refresh()
    return refresh


class FlightStrip:
    """The strip above everything: whether the vehicle flies, and the emergency stop.

    It stands on top of tabs, dialogs and recordings, at every width, and speaks of the selected vehicle even while a
    recording is shown. The stop works from every window and whoever commands; it needs two presses within three
    seconds. Its key is heard before any field or dialog hears it (``static/keys.js``).

    Parameters
    ----------
    view : View
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._aimed_s = self._asked_s = -math.inf
        self._aim: RemoteVehicle | None = None
        self._request: Request | None = None
        with element("section", classes="mf-flightbar").props('aria-label="flight and emergency stop"'):
            Panel("strip")
            self._stop = Action(
                "EMERGENCY STOP", "emergency-stop", "Shift+Backspace", self._press, "mf-stop", "Shift+⌫ twice"
            )
        self.refresh()

    def _press(self) -> None:
        now, vehicle = elapsed_s(), self._view.aircraft()
        if not self._sure(now, vehicle):
            self._aim, self._aimed_s = vehicle, now
        elif vehicle is not None:
            self._aim, self._asked_s = None, now
            self._request = vehicle.emergency_stop()
            self._view.ask(self._request)
        self.refresh()

    def _sure(self, now: float, vehicle: RemoteVehicle | None) -> bool:
        """Whether a press is the second one for this vehicle."""
        return vehicle is self._aim is not None and now - self._aimed_s < CONFIRM_S

    def refresh(self) -> None:
        """Bring the button up to date."""
        vehicle, now = self._view.aircraft(), elapsed_s()
        label, note = "EMERGENCY STOP", ""
        if self._sure(now, vehicle):
            label = "PRESS AGAIN TO STOP"
        elif self._request is not None and now - self._asked_s < ANSWER_S:
            note = _STOP_WORDS[self._request.outcome]
        reasons = availability(
            None if vehicle is None else vehicle.snapshot,
            kind="other" if vehicle is None else vehicle.kind,
            has_controls=self._view.has_controls,
            rows=0,
        )
        # Of several vehicles the button says which one it stops.
        if vehicle is not None and len(self._view.session.vehicles()) > 1:
            note = ": ".join(filter(None, (self._view.session.label(vehicle), note)))
        self._stop.show(label, reasons["stop"], note)
