"""The page itself: what stands where. The style sheet places it for laptops and tablets."""

from __future__ import annotations

import math
from collections.abc import Callable

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from mufly.station.page.command_bar import CommandBar
from mufly.station.page.panels import (
    Panel,
    button,
    check_drawer,
    element,
    mission_drawer,
    parameter_drawer,
    recording_drawer,
    static_url,
)
from mufly.station.page.session import View
from mufly.station.view import Outcome, Request

REFRESH_S = 0.2
_KEYS = (
    ("Shift + T", "take off"),
    ("Shift + M", "fly or resume the mission"),
    ("Shift + H", "hover: stop and stay"),
    ("Shift + G", "go to the point in the fields N, E, height"),
    ("Shift + L", "land"),
    ("Shift + R", "return and land"),
    ("Shift + A", "arm or disarm"),
    ("Shift + ⌫, twice", "emergency stop: motors off"),
    ("space", "play or pause a recording"),
    ("m", "mark this moment in the recording"),
    ("d", "dark or light"),
    ("?", "this list"),
)
_HINTS = (
    "Click on the floor to choose a waypoint; click its mark again, or Send, to fly there.",
    "Drag turns the 3-D view, right drag moves it, the wheel zooms.",
    "In a plot the wheel zooms the time axis, drag moves it, a double click goes back to live.",
    "Commands need Shift, so that a stray letter flies nothing. The emergency stop works from every window.",
)


def build(view: View) -> None:
    """Build the page of one window."""
    ui.add_head_html(f'<link rel="stylesheet" href="{static_url()}/station.css">')
    dark = ui.dark_mode(None)
    ui.colors(primary="#2f7fb8")
    with element("div", classes="mf-page"):
        _header(view, dark)
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
            with element("div", classes="mf-replay-row").props("hidden"):
                Panel("replaybar").on("replay", lambda e: _replay(view, e))
        refresh_parameters = _dock(view)
        with _labelled("aside", "commands and mission", "mf-right"):
            bar = CommandBar(view, lambda height: scene.call("setHeight", height))
            _right_tabs(view)
    Panel("keys")
    scene.on("place", lambda e: _point(e, bar.choose))
    scene.on("goto", lambda e: _point(e, bar.go_to))

    def refresh() -> None:
        bar.refresh()
        refresh_parameters()

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


def _header(view: View, dark: ui.dark_mode) -> None:
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
            _icon("◐", switch, "d", "dark or light", "dark or light (d)")
            with ui.dialog() as keys, element("div", classes="mf-help"):
                _help()
            _icon("?", keys.open, "?", "help", "keyboard and help (?)")


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


def _dock(view: View) -> Callable[[], None]:
    with _labelled("section", "plots, spectrum, parameters, recordings", "mf-dock"):
        with ui.tabs().props("dense no-caps align=left inline-label").classes("mf-tabs") as tabs:
            plots, spectrum, parameters, recordings = map(
                ui.tab, ("Plots", "Spectrum", "Parameters", "Recordings")
            )
        with ui.tab_panels(tabs, value=plots, animated=False, keep_alive=False) as panels:
            panels.classes("mf-tab-panels")
            with ui.tab_panel(plots):
                Panel("plots")
            with ui.tab_panel(spectrum):
                Panel("spectrum")
            with ui.tab_panel(parameters):
                refresh = parameter_drawer(view)
            with ui.tab_panel(recordings):
                look_again = recording_drawer(view)
    panels.on_value_change(lambda e: look_again() if e.value == "Recordings" else None)
    return refresh


def _right_tabs(view: View) -> None:
    with ui.tabs().props("dense no-caps align=left").classes("mf-tabs") as tabs:
        checks, mission, messages = map(ui.tab, ("Checks", "Mission", "Messages"))
    recording = view.session.to_open is not None
    with ui.tab_panels(tabs, value=mission if recording else checks, animated=False).classes("mf-tab-panels"):
        with ui.tab_panel(checks):
            check_drawer(view)
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
    if content.get("close"):
        view.close_recording()
