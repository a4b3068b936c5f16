"""The mission editor tab: files, vehicle, and the exchange between draft and window.

All windows of a station share one draft, which therefore survives a reload. The window with the controls edits it, the
others display it. A thread checks the newest state of the draft during editing.
"""

from __future__ import annotations

from nicegui import ui
from nicegui.events import GenericEventArguments, UploadEventArguments

from mufly.errors import InputError
from mufly.mission import MISSION_FILE_ENDINGS, Mission, TrajectoryLimits, format_mission_toml
from mufly.station.mission_endurance import trajectory_limits_from_parameters
from mufly.station.page import panels
from mufly.station.page.command_checks import encode_fence
from mufly.station.page.mission_draft import (
    DraftCheck,
    MissionDraft,
    SharedDraft,
    apply_draft_edit,
    encode_draft,
    mission_from_vehicle,
    parse_mission_draft,
)
from mufly.station.page.page_session import WindowView, encode_world


class MissionEditor:
    """The mission editor of one window; :meth:`build_tab` builds its tab, :meth:`refresh` updates it.

    Parameters
    ----------
    view : WindowView
    """

    def __init__(self, view: WindowView) -> None:
        self._view = view
        self._order = 0
        self._refused = ""
        self._shown: tuple[object, ...] = ()
        self._panel = panels.JavaScriptPanel("draft")
        self._panel.on("edit", self._handle_edit)
        if not self._shared_draft.version and view.session.mission is not None:
            self._shared_draft.vehicle_mission = view.session.mission
            self._shared_draft.set_draft(MissionDraft(view.session.mission))

    @property
    def _shared_draft(self) -> SharedDraft:
        return self._view.session.shared_draft

    def _controller_limits(self) -> TrajectoryLimits | None:
        """Return the limits of trajectories that the selected vehicle's controllers can follow; None if unknown."""
        vehicle = self._view.selected_vehicle()
        return None if vehicle is None else trajectory_limits_from_parameters(vehicle.parameters)

    def _refusal_reason(self) -> str:
        return "" if self._view.has_controls else "another window has control and edits the mission"

    def build_tab(self) -> None:
        """Build the tab."""
        with panels.make_element("div", classes="mf-tools"):
            panels.make_button(
                "New", self._start_new, test="plan-new", title="new mission without waypoints, in the same world"
            )
            panels.add_file_picker("Open…", ",".join(MISSION_FILE_ENDINGS), self._open_file, "plan-file")
            panels.make_button("Save", self._save_file, test="plan-save", title="save the mission as a file")
            fetched = "download the vehicle's mission for editing"
            panels.make_button(
                "Download from vehicle",
                self._fetch_from_vehicle,
                test="plan-fetch",
                title=fetched,
                classes="mf-live-only",
            )
            sent = "check the mission and upload it to the vehicle"
            panels.make_button(
                "Upload to vehicle", self._send_to_vehicle, test="plan-send", title=sent, classes="mf-live-only"
            )
        panels.JavaScriptPanel("editor")

    def refresh(self) -> None:
        """Send changes of the draft to the window."""
        sketch = self._shared_draft
        reason = self._refusal_reason()
        now = (sketch.version, self._order, self._refused, reason)
        if now == self._shown:
            return
        self._shown = now
        state = encode_draft(sketch.draft, sketch.verdict, self._refused)
        state["world"] = encode_world(sketch.draft.mission.world)
        state["world"]["fence"] = encode_fence(sketch.draft.mission.fence)
        self._panel.call_browser_method("take", {"state": state, "may": reason, "last": self._order})

    # ---- what the window asks for

    async def _handle_edit(self, e: GenericEventArguments) -> None:
        order = e.args if isinstance(e.args, dict) else {}
        number = order.get("order")
        if order.get("op") == "hello":  # a page that was loaded anew counts from one
            self._order, self._shown = number if isinstance(number, int) else 0, ()
        else:
            self._order = number if isinstance(number, int) else self._order
            self._refused = self._refusal_reason()
            if not self._refused:
                try:
                    self._shared_draft.set_draft(apply_draft_edit(self._shared_draft.draft, order))
                except InputError as error:
                    self._refused = f"{error.key}: {error.problem}; {error.remedy}" if error.key else error.problem
        await self._check_draft()

    async def _check_draft(self) -> DraftCheck:
        self.refresh()
        verdict = await self._shared_draft.check_draft(self._view.session.battery_data, self._controller_limits())
        self.refresh()
        return verdict

    async def _replace_mission(self, mission: Mission) -> None:
        """Edit another mission; undo returns to the present one."""
        self._refused = ""
        self._shared_draft.set_draft(self._shared_draft.draft.with_mission(mission))
        await self._check_draft()

    def _refuse_if_blocked(self, what: str) -> bool:
        if why := self._refusal_reason():
            panels.show_refusal(f"not {what}: {why}")
        return bool(why)

    async def _start_new(self) -> None:
        if not self._refuse_if_blocked("replaced"):
            await self._replace_mission(apply_draft_edit(self._shared_draft.draft, {"op": "empty"}).mission)

    async def _open_file(self, e: UploadEventArguments) -> None:
        if self._refuse_if_blocked("opened"):
            return
        try:
            mission = parse_mission_draft((await e.file.read()).decode(), e.file.name)
        except (InputError, ValueError) as error:
            panels.show_refusal(str(error))
            return
        await self._replace_mission(mission)

    def _save_file(self) -> None:
        mission = self._shared_draft.draft.mission
        ui.download.content(format_mission_toml(mission), f"{mission.name or 'mission'}.toml")

    async def _fetch_from_vehicle(self) -> None:
        vehicle = self._view.shown_vehicle()
        if vehicle is None or self._refuse_if_blocked("downloaded"):
            return
        self._view.keep_request(request := vehicle.download_mission())
        if not await panels.wait_until_accepted(request):
            return
        base = self._view.session.mission or self._shared_draft.draft.mission
        try:
            mission = mission_from_vehicle(vehicle.transfers.items or (), base, vehicle.telemetry.origin)
        except InputError as error:
            panels.show_refusal(str(error))
            return
        await self._replace_mission(mission)

    async def _send_to_vehicle(self) -> None:
        vehicle = panels.find_changeable_vehicle(self._view, "uploaded")
        if vehicle is None:
            return
        self._refused = ""  # of what was typed before; the field shows what is sent
        mission = self._shared_draft.draft.mission
        verdict = await self._check_draft()
        if mission is not self._shared_draft.draft.mission or verdict.fault:
            panels.show_refusal(f"not uploaded: {verdict.fault or 'the mission has been changed'}")
            return
        await panels.send_mission(self._view, vehicle, mission)
