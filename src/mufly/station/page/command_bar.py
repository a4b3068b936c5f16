"""The buttons that command the vehicle, each with the reason why it cannot be used, and what became of requests.

The emergency stop needs two presses within three seconds. It works from every window and whoever commands.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from nicegui import ui
from nicegui.events import GenericEventArguments

from mufly.station.page.panels import Panel
from mufly.station.page.session import Vehicle, View, availability, mission_label
from mufly.station.view import Outcome, Request, Snapshot

CONFIRM_S = 3.0
HEIGHT_M = (0.2, 50.0)
OWN_CHECK = "vehicle's own checks"
_WORDS = {
    Outcome.WAITING: "…",
    Outcome.ACCEPTED: "✓",
    Outcome.REFUSED: "✕ refused",
    Outcome.TIMED_OUT: "✕ no answer",
}


def _facts(facts: dict[str, Any]) -> str:
    """What a recording says of itself, in a line."""
    outcome = " ".join(str(facts[k]) for k in ("outcome", "reason") if facts.get(k))
    parts = [
        str(facts.get("vehicle", "")),
        str(facts.get("mission", "")),
        outcome,
        str(facts.get("start_time", ""))[:19],
    ]
    whole = "" if facts.get("complete", True) else "cut off: shown as far as it goes"
    return "Recording: " + "; ".join(
        p.replace("T", " ") if p[:2] == "20" else p for p in (*parts, whole) if p
    )


class _Action:
    """A button of two lines: what it does, and why it cannot."""

    def __init__(
        self, label: str, test_id: str, key: str, press: Callable[[], None], classes: str = ""
    ) -> None:
        self.element = (
            ui.element("button")
            .classes(f"mf-action {classes}")
            .on("click", lambda: self._click(press), args=[])
        )
        self.element.props(f'type=button data-testid={test_id} data-key="{key}"')
        with self.element:
            self._label = ui.element("span").classes("mf-action-label")
            self._reason = ui.element("span").classes("mf-action-reason")
        self._state: tuple[str, str] = ("", "?")
        self._key = key
        self.show(label, "")

    def _click(self, press: Callable[[], None]) -> None:
        if not self._state[1]:  # a click that was under way when it was disabled
            press()

    def show(self, label: str, reason: str) -> None:
        """Say what it does, and why it cannot be used ("": it can)."""
        if (label, reason) == self._state:
            return
        self._state = (label, reason)
        self._label._text = label
        self._reason._text = reason or self._key.replace("Backspace", "⌫")
        self._label.update()
        self._reason.update()
        if reason:
            self.element.props("disabled")
        else:
            self.element.props(remove="disabled")
        self.element.props["title"] = reason or f"{label} ({self._key})"
        self.element.update()


class _Field:
    """A number that is typed."""

    def __init__(
        self,
        label: str,
        value: float,
        meaning: str,
        unit: str,
        on_change: Callable[[float], None] | None,
        on_enter: Callable[[], None],
    ) -> None:
        self.value, self._on_change = value, on_change
        test = "field-" + meaning.split()[0]
        options = {"label": label, "value": value, "meaning": meaning, "unit": unit, "test": test}
        self._panel = Panel("field", options)
        self._panel.on("change", self._changed)
        if not unit:
            self._panel.on("enter", on_enter, args=[])

    def _changed(self, e: GenericEventArguments) -> None:
        if isinstance(e.args, int | float) and math.isfinite(e.args):
            self.value = float(e.args)
            if self._on_change is not None:
                self._on_change(self.value)

    def show(self, value: float) -> None:
        """Show another number."""
        self.value = value
        self._panel.call("set", value)


class CommandBar:
    """Commands of one window."""

    def __init__(self, view: View, place: Callable[[float], None]) -> None:
        self._view, self._place = view, place
        self._stop_armed = 0.0
        self._section = ui.element("section").classes("mf-commands").props('aria-label="commands"')
        with self._section:
            self._banner = ui.element("div").classes("mf-banner").props("role=status")
            with self._banner:
                self._banner_text = ui.element("span")
                self._banner_button = ui.element("button").props("type=button data-testid=take-controls")
                self._banner_button.on("click", self._take, args=[])
            self._mission = _Action(
                "Fly the mission", "mission", "Shift+M", self._do("start_mission"), "mf-primary"
            )
            with ui.element("div").classes("mf-row"):
                self._take_off = _Action("Take off", "take-off", "Shift+T", self._go_up)
                self._height = self._field("to", 1.0, "height of take-off in m", "m")
            with ui.element("div").classes("mf-row"):
                self._pause = _Action("Hover", "pause", "Shift+H", self._do("pause"))
                self._land = _Action("Land", "land", "Shift+L", self._do("land"))
                self._return = _Action("Return", "return", "Shift+R", self._do("return_home"))
            with ui.element("div").classes("mf-row mf-goto"):
                self._north = self._field("N", 0.0, "north in m")
                self._east = self._field("E", 0.0, "east in m")
                self._high = self._field("height", 1.0, "height of the waypoint in m", on_change=self._moved)
                self._go = _Action("Go", "goto", "Shift+G", self._go_there)
            with ui.element("div").classes("mf-row"):
                self._arm = _Action("Arm", "arm", "Shift+A", self._toggle_arm, "mf-small")
                self._stop = _Action(
                    "EMERGENCY STOP", "emergency-stop", "Shift+Backspace", self._emergency, "mf-stop"
                )
            self._log = ui.element("ol").classes("mf-requests").props('role=status aria-label="requests"')
        self._shown: list[str] = []
        self._banner_state = ("?", "")
        self.refresh()

    def _field(
        self,
        label: str,
        value: float,
        meaning: str,
        unit: str = "",
        on_change: Callable[[float], None] | None = None,
    ) -> _Field:
        return _Field(label, value, meaning, unit, on_change, lambda: self._go_there())

    # ---- what the buttons do

    def _vehicle(self) -> Vehicle | None:
        return self._view.vehicle()

    def _do(self, name: str) -> Callable[[], None]:
        def press() -> None:
            vehicle = self._vehicle()
            if vehicle is not None:
                self._view.ask(getattr(vehicle, name)())
            self.refresh()

        return press

    def _refuse(self, text: str, why: str) -> None:
        self._view.ask(Request(text, Outcome.REFUSED, why))
        self.refresh()

    def _go_up(self) -> None:
        vehicle, height = self._vehicle(), self._height.value
        if not HEIGHT_M[0] <= height <= HEIGHT_M[1]:
            self._refuse(f"take off to {height:g} m", f"give {HEIGHT_M[0]:g} to {HEIGHT_M[1]:g} m")
        elif vehicle is not None:
            self._view.ask(vehicle.take_off(height))
            self.refresh()

    def _go_there(self) -> None:
        self.go_to(self._north.value, self._east.value, self._high.value)

    def go_to(self, north: float, east: float, height: float) -> None:
        """Send the vehicle to a point (m; height above the floor), if that can be done now."""
        self.choose(north, east, height)
        vehicle, text = self._vehicle(), f"go to N {north:.2f}, E {east:.2f}, height {height:.2f} m"
        why = self._reasons()["go_to"]
        if not all(math.isfinite(x) and abs(x) < 1e5 for x in (north, east, height)) or height <= 0.0:
            why = "give finite metres and a height above the floor"
        if why or vehicle is None:
            self._refuse(text, why or "no vehicle heard")
            return
        self._view.ask(vehicle.go_to((north, east, -height)))
        self.refresh()

    def choose(self, north: float, east: float, height: float) -> None:
        """Show a point in the fields, without flying there."""
        for field, value in ((self._north, north), (self._east, east), (self._high, height)):
            if field.value != value:
                field.show(value)

    def _moved(self, height: float) -> None:
        self._place(height)

    def _toggle_arm(self) -> None:
        vehicle = self._vehicle()
        if vehicle is not None:
            self._view.ask(vehicle.disarm() if vehicle.snapshot.armed else vehicle.arm())
            self.refresh()

    def _emergency(self) -> None:
        now = time.monotonic()
        if now - self._stop_armed < CONFIRM_S:
            self._stop_armed = 0.0
            self._do("emergency_stop")()
        else:
            self._stop_armed = now
            self.refresh()

    def _take(self) -> None:
        vehicle = self._vehicle()
        if not self._view.has_controls:
            self._view.take_controls()
        elif vehicle is not None:
            self._view.ask(vehicle.take_command())
        self.refresh()

    # ---- what they show

    def _reasons(self) -> dict[str, str]:
        vehicle = self._vehicle()
        source = self._view.source()
        unready = ""
        if vehicle is not None:
            # The station's other checks advise; whether it can be armed is for the vehicle to say.
            bad = [c.text for c in vehicle.checks if c.ok is False and c.name == OWN_CHECK]
            unready = bad[0] if bad and not vehicle.snapshot.flying else ""
        return availability(
            vehicle.snapshot if vehicle is not None else None,
            kind=source.kind if source is not None else "other",
            has_controls=self._view.has_controls,
            rows=len(vehicle.mission) if vehicle is not None else 0,
            unready=unready,
        )

    def refresh(self) -> None:
        """Bring the buttons up to date; what has not changed is not sent."""
        vehicle = self._vehicle()
        snapshot = vehicle.snapshot if vehicle is not None else None
        why = self._reasons()
        begun = vehicle is not None and any(r.reached for r in vehicle.mission if r.action == "waypoint")
        self._mission.show(mission_label(snapshot, begun), why["mission"])
        self._take_off.show("Take off", why["take_off"])
        self._pause.show("Hover", why["pause"])
        self._land.show("Land", why["land"])
        self._return.show("Return", why["return"])
        self._go.show("Go", why["go_to"])
        armed = snapshot is not None and snapshot.armed
        self._arm.show("Disarm" if armed else "Arm", why["disarm"] if armed else why["arm"])
        waiting = time.monotonic() - self._stop_armed < CONFIRM_S
        self._stop.show("PRESS AGAIN TO STOP" if waiting else "EMERGENCY STOP", why["stop"])
        self._show_banner(vehicle, snapshot)
        self._show_requests()

    def _show_banner(self, vehicle: Vehicle | None, s: Snapshot | None) -> None:
        text, button = "", ""
        if self._view.replay is not None:
            text = _facts(self._view.replay.recording.facts)
        elif vehicle is None:
            text = "Waiting for a vehicle on the link"
        elif not self._view.has_controls:
            other = self._view.session.holder
            text = "The controls are with another window" if other else "No window holds the controls"
            button = "Take the controls"
        elif s is not None and s.commander and not s.in_command:
            text, button = f"Watching: commanded by {s.commander}", "Take command"
        if (text, button) == self._banner_state:
            return
        self._banner_state = (text, button)
        watching = self._view.replay is not None
        self._section.classes(add="mf-watching" if watching else "", remove="" if watching else "mf-watching")
        self._banner_text._text = text
        self._banner_button._text = button
        self._banner_button.classes(
            add="mf-hidden" if not button else "", remove="mf-hidden" if button else ""
        )
        self._banner.classes(add="mf-hidden" if not text else "", remove="mf-hidden" if text else "")
        for e in (self._banner_text, self._banner_button, self._banner):
            e.update()

    def _show_requests(self) -> None:
        lines = [self._line(r) for r in list(self._view.requests)[-3:]]
        if lines == self._shown:
            return
        self._shown = lines
        self._log.clear()
        with self._log:
            for line, request in zip(lines, list(self._view.requests)[-3:], strict=True):
                item = ui.element("li").classes(f"mf-request-{request.outcome.value.replace(' ', '-')}")
                item._text = line

    @staticmethod
    def _line(r: Request) -> str:
        progress = f" {r.progress:.0%}" if not r.done and r.progress else ""
        answer = f": {r.answer}" if r.answer else ""
        return f"{_WORDS[r.outcome]} {r.text}{progress}{answer}"
