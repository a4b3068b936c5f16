"""The tab in which a mission is drawn: files, vehicle, and what goes between the draft and the window.

All windows of a station share one draft, so that it outlives a reload; the window that holds the controls edits it, the
others look on. It is checked in a thread, the newest state only, while one draws on.
"""

from __future__ import annotations

from nicegui import ui
from nicegui.events import GenericEventArguments, UploadEventArguments

from mufly.errors import InputError
from mufly.mission import FILE_ENDINGS, Limits, Mission, dump_mission
from mufly.station.endurance import told_ability
from mufly.station.page import panels
from mufly.station.page.caution import drawn_fence
from mufly.station.page.drafts import Draft, Sketch, Verdict, edited, of_vehicle, opened, shown
from mufly.station.page.session import View, drawn_world


class MissionEditor:
    """The mission editor of one window; :meth:`tab` builds its tab, :meth:`refresh` brings it up to date.

    Parameters
    ----------
    view : View
    """

    def __init__(self, view: View) -> None:
        self._view = view
        self._order = 0
        self._refused = ""
        self._shown: tuple[object, ...] = ()
        self._panel = panels.Panel("draft")
        self._panel.on("edit", self._edit)
        if not self._sketch.version and view.session.mission is not None:
            self._sketch.held = view.session.mission
            self._sketch.take(Draft(view.session.mission))

    @property
    def _sketch(self) -> Sketch:
        return self._view.session.sketch

    def _able(self) -> Limits | None:
        """What the controllers of the selected vehicle can follow, where it tells."""
        vehicle = self._view.aircraft()
        return None if vehicle is None else told_ability(vehicle.parameters)

    def _may_not(self) -> str:
        return "" if self._view.has_controls else "another window has the controls and edits the mission"

    def tab(self) -> None:
        """Build the tab."""
        with panels.element("div", classes="mf-tools"):
            panels.button(
                "New", self._new, test="plan-new", title="a mission without waypoints in the same world"
            )
            panels.pick("Open…", ",".join(FILE_ENDINGS), self._open, "plan-file")
            panels.button("Save", self._save, test="plan-save", title="save as a mission file")
            fetched = "edit the mission that is in the vehicle"
            panels.button(
                "From vehicle", self._fetch, test="plan-fetch", title=fetched, classes="mf-live-only"
            )
            sent = "check it and send it to the vehicle"
            panels.button("Send to vehicle", self._send, test="plan-send", title=sent, classes="mf-live-only")
        panels.Panel("editor")

    def refresh(self) -> None:
        """Tell the window what has changed; what has not is not sent."""
        sketch = self._sketch
        now = (sketch.version, self._order, self._refused, self._may_not())
        if now == self._shown:
            return
        self._shown = now
        state = shown(sketch.draft, sketch.verdict, self._refused)
        state["world"] = drawn_world(sketch.draft.mission.world)
        state["world"]["fence"] = drawn_fence(sketch.draft.mission.fence)
        self._panel.call("take", {"state": state, "may": now[3], "last": self._order})

    # ---- what the window asks for

    async def _edit(self, e: GenericEventArguments) -> None:
        order = e.args if isinstance(e.args, dict) else {}
        number = order.get("order")
        if order.get("op") == "hello":  # a page that was loaded anew counts from one
            self._order, self._shown = number if isinstance(number, int) else 0, ()
        else:
            self._order = number if isinstance(number, int) else self._order
            self._refused = self._may_not()
            if not self._refused:
                try:
                    self._sketch.take(edited(self._sketch.draft, order))
                except InputError as error:
                    self._refused = (
                        f"{error.key}: {error.problem}; {error.remedy}" if error.key else error.problem
                    )
        await self._checked()

    async def _checked(self) -> Verdict:
        self.refresh()
        verdict = await self._sketch.check(self._view.session.battery, self._able())
        self.refresh()
        return verdict

    async def _replace(self, mission: Mission) -> None:
        """Edit another mission; undo goes back to the one before."""
        self._refused = ""
        self._sketch.take(self._sketch.draft.to(mission))
        await self._checked()

    def _held_up(self, what: str) -> bool:
        if why := self._may_not():
            panels.refuse(f"not {what}: {why}")
        return bool(why)

    async def _new(self) -> None:
        if not self._held_up("begun anew"):
            await self._replace(edited(self._sketch.draft, {"op": "empty"}).mission)

    async def _open(self, e: UploadEventArguments) -> None:
        if self._held_up("opened"):
            return
        try:
            mission = opened((await e.file.read()).decode(), e.file.name)
        except (InputError, ValueError) as error:
            panels.refuse(str(error))
            return
        await self._replace(mission)

    def _save(self) -> None:
        mission = self._sketch.draft.mission
        ui.download.content(dump_mission(mission), f"{mission.name or 'mission'}.toml")

    async def _fetch(self) -> None:
        vehicle = self._view.vehicle()
        if vehicle is None or self._held_up("fetched"):
            return
        self._view.ask(request := vehicle.download_mission())
        if not await panels.ended(request):
            return
        base = self._view.session.mission or self._sketch.draft.mission
        try:
            mission = of_vehicle(vehicle.transfers.items or (), base, vehicle.telemetry.origin)
        except InputError as error:
            panels.refuse(str(error))
            return
        await self._replace(mission)

    async def _send(self) -> None:
        vehicle = panels.may_change(self._view, "sent")
        if vehicle is None:
            return
        self._refused = ""  # of what was typed before; the field shows what is sent
        mission = self._sketch.draft.mission
        verdict = await self._checked()
        if mission is not self._sketch.draft.mission or verdict.fault:
            panels.refuse(f"not sent: {verdict.fault or 'it was changed meanwhile'}")
            return
        await panels.send_mission(self._view, vehicle, mission)
