"""Elements of the page: panels drawn by the browser, buttons, and drawers with tables and files."""

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
from mufly.link.command_protocol import FAILURE_NAMES
from mufly.link.ports import read_boot_clock
from mufly.mission import MISSION_FILE_ENDINGS, Mission, format_mission_toml, parse_mission, read_mission_tables
from mufly.sensors import FAULT_TARGETS
from mufly.station.page.command_checks import Confirmation
from mufly.station.page.mission_draft import find_untransmitted_keys, mission_from_vehicle
from mufly.station.page.page_session import (
    ANSWER_DISPLAY_S,
    PanelSource,
    WindowView,
    find_refusal_reasons,
    format_parameter_file,
    read_parameter_file,
)
from mufly.station.remote.remote_transfers import find_parameter_refusal_reason
from mufly.station.remote.remote_vehicle import RemoteVehicle
from mufly.station.signal_history import OperatorRequest, RequestOutcome
from mufly.vehicle_types import AUTOPILOT_COMPONENT

STATIC_FOLDER = Path(__file__).parent / "static"
MAX_UPLOAD_BYTES, MAX_RECORDING_BYTES = 2_000_000, 1_000_000_000
REQUEST_WATCH_TIME_S = 30.0
_POLL_PERIOD_S = 0.05
_THREE_JS_FOLDER = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
STICK_CENTRE_TOLERANCE = 0.15
"""Largest deflection at which sticks are taken up (share of full), so that nothing jumps."""
_STOP_OUTCOME_TEXTS = {
    RequestOutcome.WAITING: "sent",
    RequestOutcome.ACCEPTED: "motors stopped",
    RequestOutcome.REFUSED: "REFUSED",
    RequestOutcome.TIMED_OUT: "NO ANSWER",
}


def static_url() -> str:
    """Return the URL of the static files; it changes with their content, so that browsers keep no old ones."""
    digest = hashlib.sha256()
    for path in sorted(STATIC_FOLDER.iterdir()):
        digest.update(path.name.encode() + path.read_bytes())
    return f"/mufly/{digest.hexdigest()[:12]}"


_STATIC_URL = static_url()


class JavaScriptPanel(
    Element, component=STATIC_FOLDER / "mufly_panel.js", esm={"nicegui-scene": str(_THREE_JS_FOLDER)}
):
    """A panel that the browser draws from the stream of frames: one of the modules in ``static/``.

    Parameters
    ----------
    module : str
        ``scene``, ``plots``, ``flight``, ...
    options : dict, optional
        Arguments of its ``mount``.
    """

    def __init__(self, module: str, options: dict[str, Any] | None = None) -> None:
        super().__init__()
        self._props.update(module=module, base=_STATIC_URL, options=options or {})
        self.classes(f"mf-{module}")

    def call_browser_method(self, name: str, *arguments: Any) -> None:
        """Call a method of the module in the browser."""
        self.run_method("call", name, *arguments)


def make_element(tag: str, text: str = "", classes: str = "") -> Element:
    """Return an HTML element of a kind with a text."""
    made = ui.element(tag).classes(classes)
    if text:
        made._text = text
    return made


def make_button(
    text: str, press: Callable[..., object], *, test: str = "", title: str = "", classes: str = ""
) -> Element:
    """Return a plain button."""
    made = make_element("button", text, classes).props(f'type=button data-testid="{test}" title="{title or text}"')
    return made.on("click", press, args=[])


class ActionButton:
    """A button with two lines: its action, and the reason if unavailable.

    Parameters
    ----------
    label, test_id : str
    key : str
        Key that presses the button (``static/keys.js``).
    press : callable
    classes : str
    note : str, optional
        Second line of an available button; default: the key.
    refuse : callable, optional
        Called with action and reason if a press arrives when the button is unavailable.
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
        self._button = make_element("button", classes=f"mf-action {classes}")
        self._button.props(f'type=button data-testid={test_id} data-key="{key}"')
        self._button.on("click", self._handle_click, args=[])
        with self._button:
            self._lines = (
                make_element("span", classes="mf-action-label"),
                make_element("span", classes="mf-action-reason"),
            )
        self.show_state(label, "")

    def _handle_click(self) -> None:
        label, reason, _ = self._state
        if reason:  # the click was under way when it was disabled
            self._refuse(label.lower(), reason)
        else:
            self._press()

    def show_state(self, label: str, reason: str, note: str = "", caution: bool = False) -> None:
        """Set the action's label, the reason of unavailability ("" if available), and a note.

        ``caution`` marks a button with a warning, or one that waits for a second press.
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


def add_file_picker(
    label: str,
    ending: str,
    taken: Callable[[UploadEventArguments], object],
    test: str,
    most_bytes: int = MAX_UPLOAD_BYTES,
    classes: str = "",
) -> None:
    """Add a button by which the user chooses a file, which is uploaded and given to ``taken``."""
    upload = ui.upload(auto_upload=True, max_file_size=most_bytes, on_upload=taken)
    upload.props(f'accept="{ending}" data-testid="{test}"').classes("mf-hidden")
    upload.props(':headers="() => window.muflyLive.headers()"')
    upload.on_rejected(lambda: show_refusal("file not accepted: too large or of another type"))
    upload.on(
        "failed",
        lambda: show_refusal("file not accepted: it reached the station too late; choose it again"),
        args=[],
    )

    async def open_picker() -> None:
        upload.run_method("pickFiles")

    make_button(label, open_picker, title=f"{label} ({ending})", classes=classes)


def show_notice(text: str, good: bool = True) -> None:
    kind: Any = "positive" if good else "warning"
    ui.notify(text, type=kind, position="bottom", timeout=4000, close_button="OK")


def show_refusal(text: str) -> None:
    show_notice(text, good=False)


def _find_blocking_reason(view: WindowView) -> str:
    """Return why this window may not change the vehicle; "" if it may."""
    vehicle = view.shown_vehicle()
    if vehicle is None:
        return "no vehicle is displayed"
    if not view.has_controls:
        return "another window has control"
    s = vehicle.snapshot
    return f"{s.commander} has operator control" if s.commander and not s.in_command else ""


def find_changeable_vehicle(view: WindowView, what: str) -> RemoteVehicle | None:
    """Return the vehicle if this window may change it; else report why ``what`` is refused and return None."""
    if why := _find_blocking_reason(view):
        show_refusal(f"not {what}: {why}")
        return None
    return view.shown_vehicle()


def build_check_drawer(view: WindowView) -> None:
    """Build the drawer of preflight checks, with actions before and after a flight."""

    def release_operator_control() -> None:
        vehicle = view.shown_vehicle()
        if vehicle is None or not view.has_controls:
            show_refusal("not released: " + _find_blocking_reason(view))
        else:
            view.keep_request(vehicle.release_operator_control())

    def restart_autopilot() -> None:
        vehicle = find_changeable_vehicle(view, "rebooted")
        if vehicle is not None and vehicle.snapshot.flying:
            show_refusal("not rebooted: the vehicle is flying")
        elif vehicle is not None:
            view.keep_request(vehicle.reboot())

    JavaScriptPanel("checks")
    with make_element("div", classes="mf-tools mf-foot mf-live-only"):
        make_button("Release control", release_operator_control, title="release operator control")
        make_button(
            "Reboot vehicle",
            restart_autopilot,
            title="reboot the vehicle's autopilot; a simulated flight restarts",
        )


async def wait_until_accepted(request: OperatorRequest) -> bool:
    """Wait for the outcome of a request; return whether it was accepted. The command bar shows the outcome."""
    for _ in range(int(REQUEST_WATCH_TIME_S / _POLL_PERIOD_S)):
        if request.is_done:
            break
        await asyncio.sleep(_POLL_PERIOD_S)
    return request.outcome is RequestOutcome.ACCEPTED


async def send_mission(view: WindowView, vehicle: RemoteVehicle, mission: Mission) -> None:
    """Send a mission; once accepted, show it and list the parts that the vehicle did not receive."""
    if mission.fence is not None and mission.fence != vehicle.fence:
        view.keep_request(request := vehicle.upload_fence(mission.fence))  # first: the mission may need it
        if not await wait_until_accepted(request):
            return
    view.keep_request(request := vehicle.upload_mission(mission))
    if not await wait_until_accepted(request):
        return
    kept = find_untransmitted_keys(mission, view.session.shared_draft.vehicle_mission)
    view.session.mission = mission
    vehicle.set_shown_mission(mission)
    words = f"uploaded: {len(mission.waypoint)} waypoints"
    show_notice(words + (f"; not transmitted, the vehicle keeps its own: {', '.join(kept)}" if kept else ""))


def build_sensor_drawer(view: WindowView) -> None:
    """Build the drawer with the estimator's status of each sensor, and controls to inject failures in a simulation."""

    def request_fault_injection(kind: int, text: str, amount: float = math.nan, duration_s: float = math.nan) -> None:
        vehicle = view.shown_vehicle()
        if vehicle is None or not view.has_controls:
            show_refusal(f"{text}: " + _find_blocking_reason(view))
        else:
            view.keep_request(vehicle.inject_failure(int(unit.value), kind, text, amount, duration_s))

    def inject_selected() -> None:
        how, much, lasts = (
            kinds[kind.value],
            (amount.enabled and amount.value) or math.nan,
            seconds.value or math.nan,
        )
        text = f"{units[unit.value]}: {how}"
        text += "" if math.isnan(much) else f" {much:g} {find_fault_unit(int(unit.value), how)}"
        request_fault_injection(int(kind.value), text + ("" if math.isnan(lasts) else f", {lasts:g} s"), much, lasts)

    def find_fault_unit(which: int, how: str) -> str:
        return "s" if how == "late" else FAULT_TARGETS[FAILURE_NAMES[0][float(which)]].reading_unit

    def show_default_amount() -> None:
        """Show the default amount of the chosen failure, with its unit, in the amount field."""
        how = kinds[kind.value]
        known = FAULT_TARGETS[FAILURE_NAMES[0][float(unit.value)]].default_amounts.get(how)
        words = "none" if known is None else f"{known:g} {find_fault_unit(int(unit.value), how)}"
        amount.props(f'placeholder="{words}"')
        amount.set_enabled(known is not None)

    JavaScriptPanel("sensors")
    units = {int(k): name.replace("_", " ") for k, name in FAILURE_NAMES[0].items()}
    kinds = {int(k): name for k, name in FAILURE_NAMES[1].items()}
    with make_element("div", classes="mf-tools mf-foot mf-faults mf-live-only"):
        unit = ui.select(units, value=next(iter(units))).props("dense options-dense outlined aria-label=sensor")
        kind = ui.select(kinds, value=next(iter(kinds))).props("dense options-dense outlined aria-label=fault")
        amount = ui.number("amount").props("dense outlined stack-label clearable aria-label=amount")
        seconds = ui.number("duration (s)", min=0).props(
            'dense outlined stack-label clearable aria-label=seconds placeholder="until cleared"'
        )
        for one in (unit, kind):
            one.on_value_change(show_default_amount)
        show_default_amount()
        make_button("Inject", inject_selected, test="inject", title="inject a failure into this simulated sensor")
        make_button(
            "Clear",
            lambda: request_fault_injection(0, "clear all injected failures"),
            test="clear-faults",
            title="clear all injected failures",
        )


def build_mission_drawer(view: WindowView) -> None:
    """Build the drawer of the mission table, with upload and download of files."""

    async def upload_file(e: UploadEventArguments) -> None:
        vehicle = find_changeable_vehicle(view, "sent")
        if vehicle is None:
            return
        try:
            text = (await e.file.read()).decode()
            mission = parse_mission(read_mission_tables(text, e.file.name), e.file.name)
        except (MuflyError, ValueError) as error:
            show_refusal(str(error))
            return
        await send_mission(view, vehicle, mission)

    def download_mission() -> None:
        if (vehicle := view.shown_vehicle()) is not None:
            view.keep_request(vehicle.download_mission())

    def clear_mission() -> None:
        if (vehicle := find_changeable_vehicle(view, "cleared")) is not None:
            view.keep_request(vehicle.clear_mission())

    def save_file() -> None:
        vehicle, mission = view.shown_vehicle(), None
        try:
            if view.replay is not None:
                mission = view.replay.recording.mission
            elif vehicle is not None and vehicle.transfers.items:
                base = view.session.mission or Mission(name="from-vehicle")
                mission = mission_from_vehicle(vehicle.transfers.items, base, vehicle.telemetry.origin)
        except MuflyError as error:
            show_refusal(f"not saved: {error}")
            return
        if mission is None:
            show_refusal("no mission to save")
            return
        ui.download.content(format_mission_toml(mission), f"{mission.name or 'mission'}.toml")

    with make_element("div", classes="mf-tools"):
        add_file_picker("Upload…", ",".join(MISSION_FILE_ENDINGS), upload_file, "mission-file", classes="mf-live-only")
        make_button(
            "Download",
            download_mission,
            title="download the vehicle's mission",
            classes="mf-live-only",
        )
        make_button("Save", save_file, title="save the mission as a file")
        make_button("Clear", clear_mission, title="clear the vehicle's mission", classes="mf-live-only")
    JavaScriptPanel("mission")


def build_parameter_drawer(view: WindowView) -> Callable[[], None]:
    """Build the drawer of the parameter table, undo and files; return the function that updates its buttons."""

    written: list[tuple[str, OperatorRequest]] = []  # what was sent and is not answered yet

    def write_parameter(name: str, value: float, undoable: bool = True) -> str:
        """Write one parameter; return the reason of a refusal, "" if sent."""
        vehicle, why = view.shown_vehicle(), _find_blocking_reason(view)
        if why or vehicle is None:
            return f"{name} not written: {why}"
        known = vehicle.parameters.get(name)
        if why := find_parameter_refusal_reason(known, name, value):
            return f"{name}: {why}"
        view.keep_request(request := vehicle.set_parameter(name, value))
        written.append((name, request))
        # A number that is none cannot be written again.
        if undoable and known is not None and math.isfinite(known.value):
            view.session.parameter_edits(vehicle).record_change(name, known.value, value)
        return ""

    def handle_edit(e: GenericEventArguments) -> None:
        content = e.args if isinstance(e.args, dict) else {}
        name, value = content.get("name"), content.get("value")
        if view.shown_vehicle() is None or not isinstance(name, str) or not isinstance(value, int | float):
            return
        if why := write_parameter(name, float(value)):
            show_refusal(why)
            table.call_browser_method("refused", name, why)
        refresh_buttons()

    def undo_or_redo(which: str) -> None:
        vehicle = view.shown_vehicle()
        if vehicle is None:
            return
        why = _find_blocking_reason(view)
        edits = view.session.parameter_edits(vehicle)
        if not why and (found := edits.pop_undo_value() if which == "undo" else edits.pop_redo_value()) is not None:
            name, value = found
            why = write_parameter(name, value, undoable=False)
        if why:
            show_refusal(why)
        refresh_buttons()

    def find_component_id(vehicle: PanelSource | None) -> int:
        return vehicle.component if isinstance(vehicle, RemoteVehicle) else AUTOPILOT_COMPONENT

    def save_file() -> None:
        vehicle = view.shown_vehicle()
        if vehicle is None or not vehicle.parameters:
            show_refusal("no parameters to save")
            return
        text = format_parameter_file(vehicle.parameters, vehicle.system, find_component_id(vehicle))
        ui.download.content(text, f"{vehicle.display_name.split(',')[0].replace(' ', '-')}.params")

    async def load_file(e: UploadEventArguments) -> None:
        vehicle = view.shown_vehicle()
        try:
            text = (await e.file.read()).decode()
            values = read_parameter_file(text, e.file.name, find_component_id(vehicle))
        except (MuflyError, ValueError) as error:
            show_refusal(str(error))
            return
        if vehicle is None:
            return
        # All or nothing: a file with one bad line changes nothing.
        faults = [
            f"{n}: {w}"
            for n, v in values.items()
            if (w := find_parameter_refusal_reason(vehicle.parameters.get(n), n, v))
        ]
        if why := _find_blocking_reason(view) or (faults[0] if faults else ""):
            show_refusal(f"no parameter written: {why}")
            return
        changed = {n: v for n, v in values.items() if vehicle.parameters[n].value != v}
        for name, value in changed.items():
            write_parameter(name, value)
        show_notice(f"{len(changed)} of {len(values)} parameters differ and have been sent")
        refresh_buttons()

    def fetch_parameters() -> None:
        if (vehicle := view.shown_vehicle()) is not None:
            view.keep_request(vehicle.refresh_parameters())

    with make_element("div", classes="mf-tools"):
        undo = make_button("↶ Undo", lambda: undo_or_redo("undo"), test="undo")
        redo = make_button("↷ Redo", lambda: undo_or_redo("redo"), test="redo")
        make_button("Refresh", fetch_parameters, title="download all parameters again")
        add_file_picker("Load from file…", ".params,.param,.parm,.txt", load_file, "parameter-file")
        make_button("Save to file", save_file, title="save all parameters as a file")
    table = JavaScriptPanel("parameters").on("write", handle_edit)
    shown: list[object] = [None]

    def refresh_buttons() -> None:
        for name, request in [entry for entry in written if entry[1].is_done]:
            written.remove((name, request))
            if request.outcome is not RequestOutcome.ACCEPTED:
                table.call_browser_method("refused", name, request.answer)
        vehicle = view.shown_vehicle()
        sheet = view.session.parameter_edits(vehicle) if vehicle is not None else None
        state = (sheet.undo_name, sheet.redo_name) if sheet is not None else ("", "")
        if state == shown[0]:
            return
        shown[0] = state
        for made, name, word in ((undo, state[0], "undo"), (redo, state[1], "redo")):
            made.props["title"] = f"{word} the change of {name}" if name else f"nothing to {word}"
            made.props(*([] if name else ["disabled"]), remove="disabled" if name else "")
            made.update()

    refresh_buttons()
    return refresh_buttons


class FlightStrip:
    """Top strip of the page: flight state of the vehicle, and the emergency stop.

    The strip stays above tabs, dialogs and recordings, at every width. It shows the selected vehicle even while a
    recording is shown. The stop works in every window and for every commander; it needs two presses within three
    seconds. Its key takes effect before any field or dialog receives it (``static/keys.js``).

    Parameters
    ----------
    view : WindowView
    """

    def __init__(self, view: WindowView) -> None:
        self._view = view
        self._confirmation, self._asked_s = Confirmation(read_boot_clock), -math.inf
        self._request: OperatorRequest | None = None
        with make_element("section", classes="mf-flightbar").props('aria-label="flight and emergency stop"'):
            JavaScriptPanel("strip")
            self._stop = ActionButton(
                "EMERGENCY STOP",
                "emergency-stop",
                "Shift+Backspace",
                self._press_stop,
                "mf-stop",
                "Shift+⌫ twice",
            )
        self.refresh()

    def _press_stop(self) -> None:
        vehicle = self._view.selected_vehicle()
        if self._confirmation.register_press(vehicle) and vehicle is not None:
            self._asked_s, self._request = read_boot_clock(), vehicle.emergency_stop()
            self._view.keep_request(self._request)
        self.refresh()

    def refresh(self) -> None:
        """Update the emergency stop button."""
        vehicle = self._view.selected_vehicle()
        label, note = "EMERGENCY STOP", ""
        if vehicle is not None and self._confirmation.would_be_second_press(vehicle):
            label = "PRESS AGAIN TO STOP"
        elif self._request is not None and read_boot_clock() - self._asked_s < ANSWER_DISPLAY_S:
            note = _STOP_OUTCOME_TEXTS[self._request.outcome]
        reasons = find_refusal_reasons(
            None if vehicle is None else vehicle.snapshot,
            kind="other" if vehicle is None else vehicle.kind,
            has_controls=self._view.has_controls,
            rows=0,
        )
        # Of several vehicles the button says which one it stops.
        if vehicle is not None and len(self._view.session.list_vehicles()) > 1:
            note = ": ".join(filter(None, (self._view.session.vehicle_label(vehicle), note)))
        self._stop.show_state(label, reasons["stop"], note)


class StickPanel:
    """The sticks of one window: virtual sticks or a joystick in the browser, and the permission to fly by them.

    The window sends the stick positions twenty times a second; every message is checked for permission here. Manual
    flight ends when the window is hidden or loses its focus, joystick or connection. It also ends when another window
    takes the controls, or another vehicle or a recording is shown. The vehicle then hovers.

    Parameters
    ----------
    view : WindowView
    reason : callable
        Returns why manual flight is unavailable now, "" if available.
    """

    def __init__(self, view: WindowView, reason: Callable[[], str]) -> None:
        self._view, self._reason = view, reason
        self._flown: RemoteVehicle | None = None
        self._request: OperatorRequest | None = None
        self._shown: tuple[object, ...] = ()
        self._panel = JavaScriptPanel("sticks").classes("mf-live-only")
        self._panel.on("sticks", self._handle_sticks, throttle=0.0)

    def refresh(self) -> None:
        """Send the window the reason why it may not use the sticks, "" if it may, and whether they fly the vehicle."""
        if self._flown is not None and (why := self._manual_end_reason()):
            self._release_sticks(why)
        now = (self._reason(), self._flown is not None)
        if now != self._shown:
            self._shown = now
            self._panel.call_browser_method("show", {"reason": now[0], "held": now[1]})

    def _manual_end_reason(self) -> str:
        vehicle = self._flown
        if vehicle is None:
            return ""
        if self._view.shown_vehicle() is not vehicle:
            return "another vehicle is displayed"
        if why := self._reason():
            return why
        if self._request is not None and self._request.is_done and self._request.outcome is not RequestOutcome.ACCEPTED:
            return self._request.answer
        return "" if vehicle.sticks.is_held else "no stick input received"

    def _release_sticks(self, why: str) -> None:
        vehicle, self._flown, self._request = self._flown, None, None
        if vehicle is not None and (request := vehicle.release_sticks()) is not None:
            self._view.keep_request(request)
        self._panel.call_browser_method("ended", why)

    def _handle_sticks(self, e: GenericEventArguments) -> None:
        content = e.args if isinstance(e.args, dict) else {}
        if "end" in content:
            self._release_sticks(str(content["end"])[:120])
            self.refresh()
            return
        at = content.get("at")
        if not isinstance(at, list) or len(at) != 4 or not all(isinstance(v, int | float) for v in at):
            return
        if content.get("begin"):
            self._start_flying(at)
        elif self._flown is not None and not self._manual_end_reason():
            self._flown.sticks.set_deflections(*map(float, at))
        self.refresh()

    def _start_flying(self, at: list[float]) -> None:
        vehicle, why = self._view.shown_vehicle(), self._reason()
        if any(abs(v) > STICK_CENTRE_TOLERANCE for v in at):
            why = why or "sticks not centred; release them first"
        if vehicle is None or why:
            self._panel.call_browser_method("ended", why or "no vehicle is displayed")
            return
        vehicle.sticks.set_deflections(*map(float, at))
        self._flown, self._request = vehicle, vehicle.fly_manually()
        self._view.keep_request(self._request)
