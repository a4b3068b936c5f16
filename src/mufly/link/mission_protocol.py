"""The vehicle's side of the mission protocol; :mod:`mufly.mission.files.mission_items` defines the items."""

from __future__ import annotations

from collections import OrderedDict

from mufly.flight import Autopilot, FlightState
from mufly.link.clients import Clients, CommandAuthority
from mufly.link.codec import MessageSource
from mufly.link.mission_transfer import (
    MAX_ITEMS,
    TYPE_ALL,
    TYPE_FENCE,
    TYPE_MISSION,
    TYPE_RALLY,
    AddressedMessages,
    MissionAck,
    MissionClearAll,
    MissionCount,
    MissionReceiver,
    MissionRequestItem,
    MissionRequestList,
    MissionSender,
    TransferMessage,
    encode_transfer_message,
)
from mufly.link.telemetry_streams import MissionProgress
from mufly.mission import (
    REQUEST_ACCEPTED,
    Fence,
    RequestAnswer,
    deny_request,
    fence_from_items,
    fence_to_items,
)
from mufly.mission.files.mission_items import (
    GlobalOrigin,
    MissionItem,
    MissionRefusedError,
    MissionResultCode,
    MissionWithItems,
    mission_from_items,
    mission_to_items,
)

_MAX_DOWNLOADS = 16
_CLEAR_TIMEOUT_S = 3.0
_REFUSAL_TEXTS: dict[int, str] = {
    MissionResultCode.NO_SPACE: f"mission refused: more than {MAX_ITEMS} items",
    MissionResultCode.DENIED: "mission refused: another station is uploading a mission; wait until it is done",
    MissionResultCode.UNSUPPORTED: "refused: only missions and fences are supported, no rally points",
}
"""Reasons of refusals that do not depend on the items."""
_STATE_NO_MISSION, _STATE_NOT_STARTED, _STATE_ACTIVE, _STATE_PAUSED, _STATE_COMPLETE = 1, 2, 3, 4, 5


class MissionProtocol:
    """The vehicle's side of the mission protocol: upload, download, and progress of the mission.

    A completely received mission is checked, loaded and acknowledged in one step: it is loaded whole, or refused with
    nothing changed. A fence is treated alike. Rally points are not supported: their list is empty.

    Parameters
    ----------
    autopilot : Autopilot
    clients : Clients
    authority : CommandAuthority
        Decides which station may change the mission.
    origin : GlobalOrigin or None

    Attributes
    ----------
    plan : MissionWithItems
        The mission and its items.
    """

    def __init__(
        self, autopilot: Autopilot, clients: Clients, authority: CommandAuthority, origin: GlobalOrigin | None
    ) -> None:
        self._autopilot, self._clients = autopilot, clients
        self._authority, self._origin = authority, origin
        self.plan = mission_to_items(autopilot.software.requested_mission)
        self._refused = ""  # reason why the last mission was refused, until reported
        self._first = 0  # first item of the mission at its start
        self._receiver = MissionReceiver(self._accept_mission)
        self._fence_receiver = MissionReceiver(self._accept_fence, mission_type=TYPE_FENCE)
        self._fence_items: tuple[Fence | None, tuple[MissionItem, ...]] = (None, ())
        self._senders: OrderedDict[tuple[MessageSource, int], MissionSender] = OrderedDict()
        self._told = 0
        self._clearing: tuple[float, MessageSource, int] | None = None

    def handle_message(self, now_s: float, station: MessageSource, note: TransferMessage) -> None:
        """Process and answer a station's message; only the commander may start an upload or clear the mission."""
        if isinstance(note, MissionCount | MissionClearAll) and not self._authority.claim_command(now_s, station):
            denied = MissionAck(MissionResultCode.DENIED, note.mission_type)  # the authority has reported the reason
            self._clients.send_message(station.peer, encode_transfer_message(denied, station.system, station.component))
        else:
            self._send_messages(self._cancel_foreign_uploads())
            self._send_messages(self._handle_message(now_s, station, note))

    def repeat_lost_messages(self, now_s: float) -> None:
        """Repeat messages that may be lost."""
        self._send_messages(self._cancel_foreign_uploads())
        out = [
            *self._receiver.take_due_messages(now_s),
            *self._fence_receiver.take_due_messages(now_s),
            *self._clear_when_hovering(now_s),
        ]
        for giver in self._senders.values():
            out += giver.take_due_messages(now_s)
        self._send_messages(out)

    def forget_peer(self, peer: object) -> None:
        """End the transfers of a lost peer; the mission is unchanged."""
        for key in [k for k in self._senders if k[0].peer == peer]:
            del self._senders[key]
        for receiver in (self._receiver, self._fence_receiver):
            taker = receiver.peer
            if isinstance(taker, MessageSource) and taker.peer == peer:
                receiver.cancel_transfer()

    def start_mission(self, item: float = 0.0) -> RequestAnswer:
        """Start or resume the mission, from ``item`` if it is above 0, else where it stopped; return the answer."""
        if item > 0.0:
            self._first = int(min(item, 65535.0))
            if self._waypoint_from_item(self._first) is None:
                self._first = 0
                return _refuse_missing_waypoint(item)
        if not self._first:
            running = self._autopilot.status.mission_running
            return REQUEST_ACCEPTED if running else self._autopilot.start_mission()
        answer = self._autopilot.start_mission(self._waypoint_from_item(self._first))
        if answer:
            self._first, self._told = 0, self._first  # items before it are skipped, not reached
        return answer

    def set_current_item(self, item: float) -> RequestAnswer:
        """Resume the mission at an item; on the floor, set the first item of the next start."""
        first = self._waypoint_from_item(int(item)) if item >= 0.0 and item < 65535.0 else None
        if first is None:
            return _refuse_missing_waypoint(item)
        if self._autopilot.status.state == "init":
            self._first = int(item)
            return REQUEST_ACCEPTED
        answer = self._autopilot.start_mission(first)
        if answer:
            self._first, self._told = 0, int(item)
        return answer

    def mission_progress(self, status: FlightState) -> MissionProgress:
        """Return the current mission item, the number of items, MISSION_STATE and MISSION_MODE."""
        self._refresh_plan(status)
        total = len(self.plan.items)
        if not self.plan.mission.waypoint:
            return MissionProgress(0, total, _STATE_NO_MISSION, 2)
        if status.mission_running:
            state = _STATE_ACTIVE
        elif status.mission_begun and status.waypoint_index >= len(self.plan.waypoint_item_index):
            state = _STATE_COMPLETE
        elif status.mission_begun and status.flying:
            state = _STATE_PAUSED
        else:
            state = _STATE_NOT_STARTED
        return MissionProgress(
            min(self._current_item(status), total - 1), total, state, 1 if state == _STATE_ACTIVE else 2
        )

    def take_reached_items(self, status: FlightState) -> list[int]:
        """Return the items completed since the last call, in order."""
        self._refresh_plan(status)
        if not status.mission_begun:
            self._told = 0
            return []
        out = list(range(self._told, self._count_completed_items(status)))
        self._told += len(out)
        return out

    def _send_messages(self, notes: AddressedMessages) -> None:
        for station, note in notes:
            if isinstance(station, MessageSource):
                self._clients.send_message(
                    station.peer, encode_transfer_message(note, station.system, station.component)
                )
                if isinstance(note, MissionAck) and not self._refused and note.result in _REFUSAL_TEXTS:
                    self._clients.send_text(_REFUSAL_TEXTS[note.result], "warning", station.peer)
        if self._refused:
            self._clients.send_text(self._refused, "warning")
            self._refused = ""

    def _handle_message(self, now_s: float, station: MessageSource, note: TransferMessage) -> AddressedMessages:
        kind = note.mission_type
        if kind not in (TYPE_MISSION, TYPE_FENCE, TYPE_RALLY) and not isinstance(note, MissionClearAll):
            return [] if isinstance(note, MissionAck) else [(station, MissionAck(MissionResultCode.UNSUPPORTED, kind))]
        match note:
            case MissionClearAll():
                return self._clear_items(now_s, station, kind)
            case MissionRequestList() | MissionRequestItem():
                return self._serve_download(now_s, station, note)
            case MissionCount() if kind == TYPE_RALLY:
                result = MissionResultCode.UNSUPPORTED if note.item_count else MissionResultCode.ACCEPTED
                return [(station, MissionAck(result, kind))]
            case MissionAck():
                giver = self._senders.get((station, kind))
                given = giver.handle_message(now_s, note) if giver is not None else []
                return [*given, *self._receiver_for_type(kind).handle_message(now_s, station, note)]
            case MissionCount() | MissionItem():
                return self._receiver_for_type(kind).handle_message(now_s, station, note)
        return []

    def _cancel_foreign_uploads(self) -> AddressedMessages:
        """End an upload, without any change, if its sender is no longer the commander."""
        out: AddressedMessages = []
        for receiver in (self._receiver, self._fence_receiver):
            if receiver.peer is not None and receiver.peer != self._authority.commander:
                out += receiver.cancel_transfer()
        return out

    def _receiver_for_type(self, kind: int) -> MissionReceiver:
        return self._fence_receiver if kind == TYPE_FENCE else self._receiver

    def fence_items(self) -> tuple[MissionItem, ...]:
        """Return the fence as uploaded, or the fence of a mission file as items."""
        fence = self._autopilot.software.requested_mission.fence
        if fence != self._fence_items[0]:
            self._fence_items = (fence, fence_to_items(fence, self._origin))
        return self._fence_items[1]

    def _accept_fence(self, items: tuple[MissionItem, ...]) -> int:
        base = self._autopilot.software.requested_mission.fence
        try:
            fence = fence_from_items(items, base, self._origin)
        except MissionRefusedError as refusal:
            self._refused = str(refusal)
            return refusal.result
        answer = self._autopilot.load_fence(fence)
        if not answer:
            self._refused = answer.reason
            return MissionResultCode.DENIED if answer.is_temporary else MissionResultCode.ERROR
        self._fence_items = (fence, items)
        return MissionResultCode.ACCEPTED

    def _waypoint_from_item(self, item: int) -> int | None:
        """Return the index of the first waypoint at mission item ``item`` or after it; None if there is none."""
        return self.plan.first_waypoint_from_item(item) if 0 <= item < len(self.plan.items) else None

    def _count_completed_items(self, status: FlightState) -> int:
        """Return how many mission items, counted from the first, are completed."""
        places, reached = self.plan.waypoint_item_index, status.waypoint_index
        if reached == len(places) and status.mission_running and status.state == "hover":
            reached -= 1  # still waiting there; the last item is completed when nothing of the mission is left
        if status.outcome == "succeeded" and not status.flying and reached >= len(places):
            return len(self.plan.items)
        if reached >= len(places) and self.plan.mission.at_end == "hover" and not status.mission_running:
            return len(self.plan.items)  # including items after the last waypoint, such as a delay
        if 0 < reached < len(places) and status.mission_running and status.state in ("waypoint", "obstacle"):
            return places[reached]
        if reached > 0:
            return places[min(reached, len(places)) - 1] + 1
        # In the air and on the mission: take-off is complete.
        return places[0] if places and status.state in ("waypoint", "obstacle", "hover") else 0

    def _current_item(self, status: FlightState) -> int:
        places = self.plan.waypoint_item_index
        if not status.mission_begun:
            return self._first
        if status.waypoint_index < len(places):
            return 0 if status.state == "take-off" else places[status.waypoint_index]
        return len(self.plan.items) - 1

    def _refresh_plan(self, status: FlightState) -> None:
        """Update the mission items in ``plan`` if the flight has another mission, set without this protocol."""
        mission = status.mission
        if mission is None or mission is self.plan.mission:
            return
        if mission.waypoint != self.plan.mission.waypoint or mission.at_end != self.plan.mission.at_end:
            self.plan, self._told = mission_to_items(mission), 0
        else:
            self.plan = MissionWithItems(mission, self.plan.items, self.plan.waypoint_item_index)

    def _serve_download(
        self, now_s: float, station: MessageSource, note: MissionRequestList | MissionRequestItem
    ) -> AddressedMessages:
        key = (station, note.mission_type)
        before = self._senders.get(key)
        # A station that continues a download gets the items of the list offered to it, or none: never a mixture.
        if before is not None and isinstance(note, MissionRequestItem):
            return before.handle_message(now_s, note)
        held = {TYPE_MISSION: lambda: self.plan.items, TYPE_FENCE: self.fence_items}.get(note.mission_type, tuple)
        items: tuple[MissionItem, ...] = held()
        giver = MissionSender(station, items, mission_type=note.mission_type, uploading=False)
        # A list requested again may belong to another mission than the one whose download was not completed.
        if before is not None and before.result is None and before.items == giver.items:
            return before.handle_message(now_s, note)
        self._senders[key] = giver
        while len(self._senders) > _MAX_DOWNLOADS:
            self._senders.popitem(last=False)
        offer = giver.start_transfer(now_s)
        return offer if isinstance(note, MissionRequestList) else giver.handle_message(now_s, note)

    def _clear_items(self, now_s: float, station: MessageSource, kind: int) -> AddressedMessages:
        if kind in (TYPE_FENCE, TYPE_ALL):
            result = self._accept_fence(())
            if kind == TYPE_FENCE or result != MissionResultCode.ACCEPTED:
                return [(station, MissionAck(result, kind))]
        if kind not in (TYPE_MISSION, TYPE_ALL):
            known = kind == TYPE_RALLY
            return [(station, MissionAck(MissionResultCode.ACCEPTED if known else MissionResultCode.UNSUPPORTED, kind))]
        if self._clearing is not None:
            return []  # a repetition
        if self._autopilot.status.mission_running and self._autopilot.pause():
            self._clearing = (now_s + _CLEAR_TIMEOUT_S, station, kind)
            return []
        return [(station, MissionAck(self._accept_mission(()), kind))]

    def _clear_when_hovering(self, now_s: float) -> AddressedMessages:
        """Once the helicopter hovers, clear the mission, as a station requested in flight; return the answer."""
        if self._clearing is None:
            return []
        until_s, station, kind = self._clearing
        status = self._autopilot.status
        if now_s < until_s and (status.mission_running or status.state != "hover"):
            return []
        self._clearing = None
        return [(station, MissionAck(self._accept_mission(()), kind))]

    def _accept_mission(self, items: tuple[MissionItem, ...]) -> int:
        try:
            plan = mission_from_items(items, self._autopilot.software.requested_mission, self._origin)
        except MissionRefusedError as refusal:
            self._refused = str(refusal)
            return refusal.result
        answer = self._autopilot.load_mission(plan.mission)
        if not answer:
            self._refused = f"mission refused: {answer.reason}"
            return MissionResultCode.DENIED if answer.is_temporary else MissionResultCode.ERROR
        self._first = 0
        self.plan, self._told = (
            MissionWithItems(self._autopilot.software.requested_mission, items, plan.waypoint_item_index),
            0,
        )
        return MissionResultCode.ACCEPTED


def _refuse_missing_waypoint(item: float) -> RequestAnswer:
    return deny_request(f"the mission has no waypoint from item {item:g} on")
