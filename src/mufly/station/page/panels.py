"""A panel that the browser draws by itself from the stream of frames."""

from __future__ import annotations

import asyncio
import hashlib
import time
import tomllib
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import nicegui
from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments, UploadEventArguments

from mufly.errors import MuflyError
from mufly.mission import Mission, dump_mission, mission_from
from mufly.station.page.session import View, find_recordings, parameter_file, read_parameter_file, refused
from mufly.station.replay import open_recording
from mufly.station.view import MissionRow, Outcome, Request

STATIC = Path(__file__).parent / "static"
_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"


def static_url() -> str:
    """Where the static files are served: the name changes with their content, so that no browser keeps old ones."""
    digest = hashlib.sha256()
    for path in sorted(STATIC.iterdir()):
        digest.update(path.name.encode() + path.read_bytes())
    return f"/mufly/{digest.hexdigest()[:12]}"


_URL = static_url()


class Panel(Element, component=STATIC / "mufly_panel.js", esm={"nicegui-scene": str(_THREE)}):
    """One of the modules in ``static/`` on the page.

    Parameters
    ----------
    module : str
        ``scene``, ``plots``, ``flight``, ...
    options : dict, optional
        What its ``mount`` gets.
    """

    def __init__(self, module: str, options: dict[str, Any] | None = None) -> None:
        super().__init__()
        self._props["module"] = module
        self._props["base"] = _URL
        self._props["options"] = options or {}
        self.classes(f"mf-{module}")

    def call(self, name: str, *arguments: Any) -> None:
        """Call a method of the module in the browser."""
        self.run_method("call", name, *arguments)


# ----------------------------------------------------------------------------
# The slower parts of the page: mission, parameters, recordings, and what their buttons do.


MOST_BYTES = 2_000_000


def button(
    text: str, press: Callable[..., object], *, test: str = "", title: str = "", classes: str = ""
) -> Element:
    """Return a plain button."""
    made = (
        ui.element("button")
        .props(f'type=button data-testid="{test}" title="{title or text}"')
        .classes(classes)
    )
    made._text = text
    made.on("click", press, args=[])
    return made


def _say(text: str, good: bool = True) -> None:
    ui.notify(
        text, type="positive" if good else "warning", position="bottom", timeout=4000, close_button="OK"
    )


def _blocked(view: View) -> str:
    """Why this window may not change the vehicle; "" if it may."""
    vehicle = view.vehicle()
    if vehicle is None:
        return "no vehicle is shown"
    if not view.has_controls:
        return "another window has the controls"
    s = vehicle.snapshot
    return f"commanded by {s.commander}" if s.commander and not s.in_command else ""


def _pick(
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
    upload.on_rejected(lambda: _say("that file is too large or of another kind", good=False))

    async def taken_and_ready() -> None:
        upload.run_method("pickFiles")

    button(label, taken_and_ready, title=f"{label} ({ending})", classes=classes)


def check_drawer(view: View) -> None:
    """Pre-flight checks, and what one does before and after a flight."""

    def release() -> None:
        vehicle = view.vehicle()
        if vehicle is None or not view.has_controls:
            _say("not released: " + _blocked(view), good=False)
        else:
            view.ask(vehicle.release_command())

    def restart() -> None:
        vehicle = view.vehicle()
        why = _blocked(view)
        if vehicle is None or why:
            _say(f"not started anew: {why}", good=False)
        elif vehicle.snapshot.flying:
            _say("not started anew: it flies", good=False)
        else:
            view.ask(vehicle.reboot())

    Panel("checks")
    with ui.element("div").classes("mf-tools mf-foot mf-live-only"):
        button("Release command", release, title="let another station command the vehicle")
        button("Start anew", restart, title="reboot the vehicle; a simulation stands at its start again")


def mission_drawer(view: View) -> None:
    """Table of the mission, with files up and down."""

    async def upload(e: UploadEventArguments) -> None:
        if why := _blocked(view):
            _say(f"not sent: {why}", good=False)
            return
        try:
            text = (await e.file.read()).decode()
            mission = mission_from({"name": Path(e.file.name).stem, **tomllib.loads(text)}, e.file.name)
        except (MuflyError, ValueError) as error:
            _say(str(error), good=False)
            return
        vehicle = view.vehicle()
        if vehicle is not None:
            view.ask(vehicle.upload_mission(mission))
            vehicle.show_mission(mission)
            view.session.mission = mission

    def download() -> None:
        vehicle = view.vehicle()
        if vehicle is not None:
            view.ask(vehicle.download_mission())

    def clear() -> None:
        vehicle = view.vehicle()
        if why := _blocked(view):
            _say(f"not cleared: {why}", good=False)
        elif vehicle is not None:
            view.ask(vehicle.clear_mission())

    def save() -> None:
        source = view.source()
        rows = list(source.mission) if source is not None else []
        mission = view.replay.recording.mission if view.replay is not None else _mission_of(rows)
        if mission is None:
            _say("there is no mission to save", good=False)
            return
        ui.download.content(dump_mission(mission), f"{mission.name or 'mission'}.toml")

    with ui.element("div").classes("mf-tools"):
        _pick("Upload…", ".toml", upload, "mission-file", classes="mf-live-only")
        button("Fetch", download, title="fetch the mission that is in the vehicle", classes="mf-live-only")
        button("Save", save, title="save the mission as a file")
        button("Clear", clear, title="delete the mission in the vehicle", classes="mf-live-only")
    Panel("mission")


def _mission_of(rows: list[MissionRow]) -> Mission | None:
    """Return a mission file's content of a vehicle's table; None if it does not begin with a take-off."""
    points = [r for r in rows if r.action == "waypoint"]
    first = next((r for r in rows if r.action == "take off"), None)
    if not rows:
        return None
    tables: dict[str, object] = {
        "name": "from-vehicle",
        "waypoint": [{"position_m": list(p.position), "wait_s": p.wait_s} for p in points],
    }
    if first is not None and first.position[2] == first.position[2]:
        tables["take_off"] = {"height_m": -first.position[2], "wait_s": first.wait_s}
    try:
        return mission_from(tables)
    except MuflyError:
        return None


def parameter_drawer(view: View) -> Callable[[], None]:
    """Table of the parameters, undo, files. Returns the function that brings its buttons up to date."""

    def write(name: str, value: float) -> str:
        """Write one parameter; return why not, "" if it was sent."""
        vehicle = view.vehicle()
        why = _blocked(view)
        if why or vehicle is None:
            return f"{name} not written: {why}"
        if why := refused(vehicle.parameters.get(name), name, value):
            return why
        view.ask(vehicle.set_parameter(name, value))
        return ""

    def edited(e: GenericEventArguments) -> None:
        vehicle, content = view.vehicle(), e.args if isinstance(e.args, dict) else {}
        name, value = content.get("name"), content.get("value")
        if vehicle is None or not isinstance(name, str) or not isinstance(value, int | float):
            return
        known = vehicle.parameters.get(name)
        if why := write(name, float(value)):
            _say(why, good=False)
        elif known is not None:
            view.session.sheet(vehicle).wrote(name, known.value, float(value))
        refresh()

    def step(which: str) -> None:
        vehicle = view.vehicle()
        if vehicle is None:
            return
        if why := _blocked(view):
            _say(why, good=False)
            return
        found = getattr(view.session.sheet(vehicle), which)()
        if found is not None and (why := write(*found)):
            _say(why, good=False)
        refresh()

    def save() -> None:
        vehicle = view.vehicle()
        if vehicle is None or not vehicle.parameters:
            _say("there are no parameters to save", good=False)
            return
        text = parameter_file(vehicle.parameters, vehicle.system)
        ui.download.content(text, f"{vehicle.name.split(',')[0].replace(' ', '-')}.params")

    async def load(e: UploadEventArguments) -> None:
        vehicle = view.vehicle()
        try:
            values = read_parameter_file((await e.file.read()).decode(), e.file.name)
        except (MuflyError, ValueError) as error:
            _say(str(error), good=False)
            return
        if vehicle is None:
            return
        # All or nothing: a file with one bad line changes nothing.
        faults = [w for n, v in values.items() if (w := refused(vehicle.parameters.get(n), n, v))]
        if why := _blocked(view) or (faults[0] if faults else ""):
            _say(f"nothing was written: {why}", good=False)
            return
        changed = {n: v for n, v in values.items() if vehicle.parameters[n].value != v}
        for name, value in changed.items():
            before = vehicle.parameters[name].value
            if not write(name, value):
                view.session.sheet(vehicle).wrote(name, before, value)
        _say(f"{len(changed)} of {len(values)} parameters differed and were written")
        refresh()

    def fetch() -> None:
        vehicle = view.vehicle()
        if vehicle is not None:
            view.ask(vehicle.refresh_parameters())

    with ui.element("div").classes("mf-tools"):
        undo = button("↶ Undo", lambda: step("undo"), test="undo")
        redo = button("↷ Redo", lambda: step("redo"), test="redo")
        button("Fetch", fetch, title="fetch all parameters again")
        _pick("Load…", ".params,.param,.txt", load, "parameter-file")
        button("Save", save, title="save all parameters as a file")
    Panel("parameters").on("write", edited)
    shown: list[object] = [None]

    def refresh() -> None:
        vehicle = view.vehicle()
        sheet = view.session.sheet(vehicle) if vehicle is not None else None
        state = (sheet.can_undo, sheet.can_redo) if sheet is not None else ("", "")
        if state == shown[0]:
            return
        shown[0] = state
        for element, name, word in ((undo, state[0], "undo"), (redo, state[1], "redo")):
            element.props["title"] = f"{word} the change of {name}" if name else f"nothing to {word}"
            element.props(*([] if name else ["disabled"]), remove="disabled" if name else "")
            element.update()

    refresh()
    return refresh


def recording_drawer(view: View) -> Callable[[], None]:
    """List of recordings; one is opened in the same page. Returns the function that looks for them again."""
    with ui.element("div").classes("mf-tools"):
        button("Refresh", lambda: fill(), title="look for recordings again")
        _pick(
            "Open a file…",
            ".mcap,.tlog,.ulg,.csv,.bin",
            lambda e: uploaded(e),
            "recording-file",
            1_000_000_000,
        )
        note = ui.element("span").classes("mf-dim mf-note")
        note._text = f"in {view.session.folder}"
    holder = ui.element("div").classes("mf-scroll")

    async def show(path: Path) -> None:
        request = Request(f"open {path.name}")
        view.ask(request)
        began = time.monotonic()
        try:
            recording = await asyncio.to_thread(open_recording, path)
        except MuflyError as error:
            request.outcome, request.answer = Outcome.REFUSED, str(error)
            _say(str(error), good=False)
            return
        request.outcome = Outcome.ACCEPTED
        request.answer = (
            f"{recording.times[-1] - recording.times[0]:.0f} s, read in {time.monotonic() - began:.1f} s"
        )
        view.show_recording(recording)

    async def uploaded(e: UploadEventArguments) -> None:
        import tempfile

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / Path(e.file.name).name
            await e.file.save(path)
            await show(path)

    def fill() -> None:
        holder.clear()
        found = find_recordings(view.session.folder)
        with holder, ui.element("table").classes("mf-table"), ui.element("tbody"):
            for path in found:
                about = path.stat()
                with ui.element("tr"):
                    with ui.element("td"):
                        button(
                            "Open", lambda path=path: show(path), test="open-recording", title=f"open {path}"
                        )
                    for text in (
                        str(path.relative_to(view.session.folder)),
                        datetime.fromtimestamp(about.st_mtime).strftime("%Y-%m-%d %H:%M:%S"),
                        f"{about.st_size / 1e6:.1f} MB",
                    ):
                        ui.element("td")._text = text
            if not found:
                with ui.element("tr"):
                    cell = ui.element("td").classes("mf-empty")
                    cell._text = "no recordings there yet"

    fill()
    return fill
