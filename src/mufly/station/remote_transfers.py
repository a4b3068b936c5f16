"""The missions of a vehicle: as rows of a table, as items of MAVLink, and sent, fetched and cleared.

Rows are what a page shows (:class:`mufly.station.signal_history.MissionRow`); items are what travels. Ours go in
metres, in the frame LOCAL_NED (x and y in 1e-4 m); items in a global frame are shown in metres from the vehicle's
origin. A mission file becomes items in :mod:`mufly.link.mission_protocol`.

One transfer follows the other; the machines are those of :mod:`mufly.link.mission_transfer`. What the vehicle holds is
known from the last transfer that ended well; when the vehicle counts another number of items (somebody else sent it a
mission) they are fetched anew.
"""

from __future__ import annotations

import math
import re
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mufly.errors import InputError
from mufly.flight import TunableParameter
from mufly.link.codec import (
    FRAMES_ABOVE_ORIGIN,
    FRAMES_ABOVE_SEA,
    FRAMES_ABOVE_TERRAIN,
    GlobalOrigin,
    MavMessage,
    mavlink,
)
from mufly.link.mission_transfer import (
    TRANSFER_TIMEOUT_S,
    AddressedMessages,
    MissionAck,
    MissionClearAll,
    MissionItem,
    MissionReceiver,
    MissionResult,
    MissionSender,
    parse_transfer_message,
    to_mavlink,
)
from mufly.link.parameter_protocol import INTEGER_RANGES, decode_parameter, encode_parameter
from mufly.station.remote_commands import RETRY_PERIOD_S, RepeatedRequest, StatusTextLog
from mufly.station.signal_history import MissionRow, OperatorRequest, RequestOutcome

FRAME_LOCAL_NED = 1
TYPE_MISSION, TYPE_FENCE, _TYPE_ALL = 0, 1, 255  # MAV_MISSION_TYPE
COMMAND_WAYPOINT, COMMAND_RETURN, COMMAND_LAND, COMMAND_TAKE_OFF, COMMAND_HEADING, COMMAND_SPEED = (
    16,
    20,
    21,
    22,
    115,
    178,
)  # MAV_CMD
MISSION_SPEED_TEXT = "the mission's own"
"""Text of a row that ends what an earlier row said of speed (-2 in MAVLink)."""
_ACTION_BY_COMMAND = {
    COMMAND_TAKE_OFF: "take off",
    COMMAND_WAYPOINT: "waypoint",
    COMMAND_SPEED: "speed",
    COMMAND_LAND: "land",
    COMMAND_RETURN: "return",
    COMMAND_HEADING: "turn",
}
_OTHER_ACTIONS = {
    17: "stay",
    18: "circles",
    19: "stay for",
    82: "spline waypoint",
    93: "wait",
    112: "wait",
    177: "jump",
}
DELAY_COMMANDS = (93, 112)
"""NAV_DELAY and CONDITION_DELAY: waits that have no place."""
_PLACE_COMMANDS = (COMMAND_WAYPOINT, COMMAND_TAKE_OFF, COMMAND_LAND, 17, 18, 19, 82)
_HOLD_COMMANDS = (COMMAND_WAYPOINT, 19, 82, *DELAY_COMMANDS)
_COMMAND_BY_ACTION = {action: command for command, action in _ACTION_BY_COMMAND.items()}
_HEADING_COMMANDS = (COMMAND_WAYPOINT, COMMAND_TAKE_OFF, COMMAND_LAND, 17)
"""Commands whose parameter 4 is a heading (deg; NaN: none). Of NAV_LOITER_TIME and NAV_LOITER_TURNS it is none."""
_FRAME_LOCAL_ENU = 4
_COORDINATE_NOT_GIVEN = 2**31 - 1
_NO_POSITION = (math.nan, math.nan, math.nan)
_NUMBER_PATTERN = re.compile(r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?")
_PEER_NAME = "vehicle"
_RESULT_TEXTS = {
    1: "the vehicle cannot take a mission now",
    2: "the vehicle does not fly in this frame of reference",
    3: "the vehicle does not know one of the commands",
    4: "too many items",
    5: "one of the items is not valid",
    13: "items came out of order",
    14: "the vehicle does not take missions from this station now",
    15: "stopped by the vehicle",
} | {6 + k: f"parameter {k + 1} of an item is not valid" for k in range(7)}


def items_from_rows(rows: Sequence[MissionRow], where: str = "mission") -> list[MissionItem]:
    """Return the items of the rows of a table.

    Raises
    ------
    InputError
        If a row cannot be sent.
    """
    return [_make_item(row, k, where) for k, row in enumerate(rows)]


def _make_item(row: MissionRow, k: int, where: str) -> MissionItem:
    command, at = _COMMAND_BY_ACTION.get(row.action), f"row {k + 1}"
    placed = all(map(math.isfinite, row.position))
    if command is None:
        raise InputError(where, at, f"{row.action!r} cannot be sent", f"use {', '.join(_COMMAND_BY_ACTION)}")
    if command in (COMMAND_WAYPOINT, COMMAND_TAKE_OFF) and not placed:
        raise InputError(where, at, "has no place", "give N, E and D in metres")
    heading_deg, place = math.degrees(row.heading_rad), row.position if placed else (0.0, 0.0, 0.0)
    params = (row.wait_s, 0.0, 0.0, heading_deg)
    if command == COMMAND_SPEED:
        number = _NUMBER_PATTERN.search("-2" if row.text == MISSION_SPEED_TEXT else row.text)
        if number is None:
            raise InputError(where, at, "has no speed", 'write for example "0.4 m/s"')
        # 1: over ground, -1: throttle as it is
        params, place = (1.0, float(number[0]), -1.0, 0.0), (0.0, 0.0, 0.0)
    elif command == COMMAND_HEADING:
        params, place = (heading_deg, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    x, y = (round(v * 1e4) for v in place[:2])
    return MissionItem(k, FRAME_LOCAL_NED, command, params=params, x=x, y=y, z=place[2])


def rows_from_items(
    items: Sequence[MissionItem], origin: GlobalOrigin | None = None, reached: int = 0
) -> list[MissionRow]:
    """Return the rows of a table of items.

    Parameters
    ----------
    items : sequence of Item
    origin : Origin, optional
        Where N, E, D are 0, for items in a global frame.
    reached : int
        So many of the first rows are behind the vehicle.
    """
    return [_make_row(item, origin, k < reached) for k, item in enumerate(items)]


def _make_row(item: MissionItem, origin: GlobalOrigin | None, reached: bool) -> MissionRow:
    command = item.command
    action = _ACTION_BY_COMMAND.get(command) or _OTHER_ACTIONS.get(command, f"command {command}")
    position, text = _NO_POSITION, ""
    if command == COMMAND_SPEED:
        speed = item.params[1]
        words = {-2.0: MISSION_SPEED_TEXT, -1.0: "as it is"}.get(speed, f"{speed:g} m/s")
        of = {2.0: "climb ", 3.0: "descent "}.get(item.params[0], "")
        return MissionRow(action, reached=reached, text=of + words)
    if command == COMMAND_HEADING:
        return MissionRow(action, heading_rad=math.radians(item.params[0]), reached=reached)
    if item.frame == FRAME_LOCAL_NED and command in _PLACE_COMMANDS:
        position = (item.x / 1e4, item.y / 1e4, item.z)
    elif item.frame == _FRAME_LOCAL_ENU and command in _PLACE_COMMANDS:
        position = (item.y / 1e4, item.x / 1e4, -item.z)
    elif (
        item.frame in (*FRAMES_ABOVE_SEA, *FRAMES_ABOVE_ORIGIN, *FRAMES_ABOVE_TERRAIN)
        and item.x != _COORDINATE_NOT_GIVEN
    ):
        position, text = _local_from_global(item, origin)
    elif command not in _ACTION_BY_COMMAND:
        text = " ".join(f"{p:g}" for p in (*item.params, item.x, item.y, item.z))
    wait_s = item.params[0] if command in _HOLD_COMMANDS and math.isfinite(item.params[0]) else 0.0
    heading = math.radians(item.params[3]) if command in _HEADING_COMMANDS else math.nan
    return MissionRow(action, position, heading, wait_s, reached, text)


def _local_from_global(item: MissionItem, origin: GlobalOrigin | None) -> tuple[tuple[float, float, float], str]:
    latitude, longitude = item.x / 1e7, item.y / 1e7
    if (item.x, item.y) == (0, 0):
        return _NO_POSITION, ""
    over_terrain = item.frame in FRAMES_ABOVE_TERRAIN
    height = f"{item.z:g} m above the terrain" if over_terrain else f"{item.z:g} m"
    if origin is None:
        return _NO_POSITION, f"{latitude:.6f} {longitude:.6f} deg, {height}"
    north, east, down = origin.to_local(latitude, longitude, item.z, item.frame)
    # How high the terrain lies above the origin nobody here knows.
    return (north, east, math.nan if over_terrain else down), height if over_terrain else ""


def is_same_mission(a: Sequence[MissionItem], b: Sequence[MissionItem]) -> bool:
    """Whether two missions would be flown alike; which item is current does not matter, NaN equals NaN."""
    return [_comparison_key(item) for item in a] == [_comparison_key(item) for item in b]


def _comparison_key(item: MissionItem) -> tuple[object, ...]:
    numbers = (None if math.isnan(v) else round(v, 4) for v in (*item.params, item.z))
    return item.frame, item.command, item.x, item.y, *numbers


@dataclass(slots=True, kw_only=True)
class _TransferJob(RepeatedRequest):
    """A transfer; ``items`` are to be sent, None: fetch or clear. What is repeated is a clearing."""

    items: tuple[MissionItem, ...] | None = None
    is_clearing: bool = False
    started_s: float = math.nan


class RemoteMission:
    """The mission of one vehicle.

    Parameters
    ----------
    texts : StatusTexts
        Where the vehicle's reasons are found.
    target : (system, component)
    kind : int
        MAV_MISSION_TYPE: 0 the mission, 1 the geofence.

    Attributes
    ----------
    items : tuple of Item or None
        What the vehicle holds; None while that is not known.
    """

    def __init__(self, texts: StatusTextLog, target: tuple[int, int], kind: int = TYPE_MISSION) -> None:
        self._texts, self.target, self._kind = texts, target, kind
        self._called = "mission" if kind == TYPE_MISSION else "geofence"
        self.items: tuple[MissionItem, ...] | None = None
        self._jobs: deque[_TransferJob] = deque()
        self._sender: MissionSender | None = None
        self._fetched: tuple[MissionItem, ...] | None = None
        self._receiver = MissionReceiver(self._store_items, mission_type=kind, unasked=False)
        self._messy_s: float | None = None
        self._out: AddressedMessages = []

    def upload_items(self, items: Sequence[MissionItem]) -> OperatorRequest:
        """Send items; accepted once the vehicle has taken all of them."""
        return self._queue_job(
            _TransferJob(OperatorRequest(f"send a {self._called} of {len(items)} items"), items=tuple(items))
        )

    def download_items(self) -> OperatorRequest:
        """Fetch the vehicle's items; they become the ``result``."""
        return self._queue_job(_TransferJob(OperatorRequest(f"fetch the {self._called}")))

    def clear_items(self) -> OperatorRequest:
        """Let the vehicle forget its mission."""
        return self._queue_job(_TransferJob(OperatorRequest(f"clear the {self._called}"), is_clearing=True))

    def _queue_job(self, job: _TransferJob) -> OperatorRequest:
        self._jobs.append(job)
        return job.request

    @property
    def is_busy(self) -> bool:
        """Whether a transfer is under way or waits."""
        return bool(self._jobs)

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a message of the mission protocol."""
        note = parse_transfer_message(message)
        if note is None or getattr(note, "mission_type", self._kind) not in (self._kind, _TYPE_ALL):
            return
        job = self._jobs[0] if self._jobs else None
        clearing = job is not None and job.is_clearing and job.send_count
        if (
            job is not None
            and clearing
            and isinstance(note, MissionAck)
            and note.mission_type in (self._kind, _TYPE_ALL)
        ):
            if note.result == MissionResult.ACCEPTED:
                self.items = ()
                job.request.set_outcome(RequestOutcome.ACCEPTED)
            else:
                self._refuse_job(job, note.result)
        elif self._sender is not None:
            self._out += self._sender.receive(now_s, note)
        else:
            self._out += self._receiver.receive(now_s, _PEER_NAME, note)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        if self._messy_s is None:
            self._messy_s = now_s  # a station before us may have left one open
        if self._jobs:
            job = self._jobs[0]
            if math.isnan(job.started_s):
                job.started_s = now_s
                self._start_job(now_s, job)
            if job.is_clearing and job.should_send(now_s):
                self._out.append((_PEER_NAME, MissionClearAll(self._kind)))
            elif not job.is_clearing:
                self._continue_job(now_s, job)
            if job.request.is_done:
                self._jobs.popleft()
        notes, self._out = self._out, []
        return [to_mavlink(note, *self.target) for _, note in notes]

    def give_up(self, answer: str) -> None:
        """End everything that is open."""
        for job in self._jobs:
            job.request.set_outcome(RequestOutcome.TIMED_OUT, answer)
        self._jobs.clear()
        self._sender = None
        self._receiver.cancel()
        self._out = []
        self._messy_s = None

    def give_up_changes(self, answer: str) -> None:
        """End what would change the vehicle's mission; what is fetched goes on."""
        for job in [j for j in self._jobs if j.items is not None or j.is_clearing]:
            job.request.set_outcome(RequestOutcome.REFUSED, answer)
            if job is self._jobs[0]:
                self._sender, self._out = None, []
            self._jobs.remove(job)

    def _start_job(self, now_s: float, job: _TransferJob) -> None:
        if job.items is not None:
            self._sender = MissionSender(_PEER_NAME, job.items, mission_type=self._kind)
            messy = self._messy_s is not None and now_s - self._messy_s < TRANSFER_TIMEOUT_S
            self._out += self._sender.start(now_s, hush=messy)
        elif not job.is_clearing:
            self._fetched = None
            self._out += self._receiver.fetch_items(now_s, _PEER_NAME)

    def _continue_job(self, now_s: float, job: _TransferJob) -> None:
        machine = self._sender if self._sender is not None else self._receiver
        self._out += machine.step(now_s)
        job.request.progress = max(job.request.progress, machine.progress)
        if machine.result is None:
            return
        self._sender = None
        if machine.result == MissionResult.ACCEPTED:
            self._messy_s = -math.inf
            self.items = job.items if job.items is not None else self._fetched
            job.request.result = self.items
            job.request.set_outcome(RequestOutcome.ACCEPTED, f"{len(self.items or ())} items")
            return
        self._messy_s = now_s
        if machine.timed_out:
            job.request.set_outcome(RequestOutcome.TIMED_OUT, f"nothing was heard of it for {TRANSFER_TIMEOUT_S:.0f} s")
        else:
            self._refuse_job(job, int(machine.result))

    def _refuse_job(self, job: _TransferJob, result: int) -> None:
        words = _RESULT_TEXTS.get(result, f"result {result}")
        job.request.set_outcome(RequestOutcome.REFUSED, self._texts.text_since(job.started_s) or words)

    def _store_items(self, items: tuple[MissionItem, ...]) -> int:
        self._fetched = items
        return MissionResult.ACCEPTED


# ----------------------------------------------------------------------------
# The parameters of a vehicle: read until none is missing, set until the vehicle says so.
#
# MAVLink's parameter protocol (https://mavlink.io/en/services/parameter.html) sends the list once, without asking
# whether it arrived. Each value carries its index and the number of all, so what is missing is known and is asked for
# again, a few at a time. A value is a float field; autopilots put whole numbers there either as a number or as the
# bytes of the integer ("bytewise"), and say which in AUTOPILOT_VERSION.


REFUSAL_WAIT_S, SILENT_REFUSAL_WAIT_S = 0.3, 1.2
"""A value that is not the one asked for is a refusal after so long, with and without words (s)."""
MAX_LIST_TRIES = 8
REQUEST_BATCH_SIZE = 12
"""So many missing ones are asked for at a time."""
MAX_PARAMETERS = 5000
"""More than any autopilot has; beyond it the list is not believed."""
_UNBOUNDED_RANGE = (-math.inf, math.inf)


def refusal_reason(known: TunableParameter | None, name: str, value: float) -> str:
    """Return why a value cannot be sent, "" if it can."""
    if known is None:
        return f"the vehicle has no parameter {name}"
    if not math.isfinite(value):
        return "that is no number"
    if not known.minimum <= value <= known.maximum:
        return f"from {known.minimum:g} to {known.maximum:g} {known.unit}".rstrip()
    return "a whole number is needed" if known.is_integer and value != round(value) else ""


@dataclass(slots=True, kw_only=True)
class _ParameterWrite(RepeatedRequest):
    """A value that is being set; since when the vehicle has said another."""

    value: float
    differs_since_s: float = math.inf


class RemoteParameters:
    """The parameters of one vehicle.

    Parameters
    ----------
    texts : StatusTexts
        Where the vehicle says why it keeps a value.
    target : (system, component)

    Attributes
    ----------
    missing_count : int
        How many have not come yet; 0 before the first and when all are there.
    bytewise : bool
        Whether whole numbers travel as the bytes of an integer.
    """

    def __init__(self, texts: StatusTextLog, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self.bytewise = False
        self._about: Mapping[str, TunableParameter] = {}
        self._raw: dict[str, tuple[float, int]] = {}
        self._indices: dict[int, str] = {}
        self._count: int | None = None
        self._list: OperatorRequest | None = None
        self._asked_s = self._came_s = -math.inf
        self._tries = 0
        self._sets: dict[str, _ParameterWrite] = {}
        self._table: dict[str, TunableParameter] | None = None

    @property
    def parameter_table(self) -> dict[str, TunableParameter]:
        """Name -> parameter, by name."""
        if self._table is None:
            self._table = {name: self._make_parameter(name) for name in sorted(self._raw)}
        return self._table

    @property
    def missing_count(self) -> int:
        """How many have not come yet."""
        return 0 if self._count is None else max(0, self._count - len(self._indices))

    def set_descriptions(self, about: Mapping[str, TunableParameter]) -> None:
        """Say what is known of the vehicle's parameters besides their values."""
        self._about, self._table = about, None

    def set_bytewise_encoding(self, yes: bool) -> None:
        """Say how whole numbers travel."""
        if yes != self.bytewise:
            self.bytewise, self._table = yes, None

    def request_all(self) -> OperatorRequest:
        """Read all of them anew."""
        if self._list is None or self._list.is_done:
            self._list = OperatorRequest("read all parameters")
            self._indices, self._count = {}, None
            self._asked_s, self._tries = -math.inf, 0
        return self._list

    def set_parameter(self, name: str, value: float) -> OperatorRequest:
        """Set one; accepted once the vehicle says that it has this value.

        Parameters
        ----------
        name : str
        value : float
        """
        request = OperatorRequest(f"set {name} to {value:g}")
        if why := refusal_reason(self.parameter_table.get(name), name, value):
            request.set_outcome(RequestOutcome.REFUSED, why)
            return request
        if name in self._sets:
            self._sets[name].request.set_outcome(RequestOutcome.REFUSED, "given up for another value")
        self._sets[name] = _ParameterWrite(request, value=value)
        return request

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a PARAM_VALUE."""
        name = message.param_id
        if not name or (len(self._raw) >= MAX_PARAMETERS and name not in self._raw):
            return
        raw = (message.param_value, message.param_type)
        if not _is_same_value(raw, self._raw.get(name)):
            self._raw[name] = raw
            if self._table is not None and name in self._table:
                self._table[name] = self._make_parameter(name)
            else:
                self._table = None
        if self._count != message.param_count and 0 < message.param_count <= MAX_PARAMETERS:
            if self._count is not None:
                self._indices = {}  # another list: the vehicle has learned or lost some
            self._count = message.param_count
        count = self._count or 0
        if message.param_index < count and name not in self._indices.values():
            self._indices[message.param_index] = name
            self._came_s, self._tries = now_s, 0
        if self._list is not None and count:
            self._list.progress = len(self._indices) / count
        self._handle_answer(now_s, name)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        return self._request_missing(now_s) + self._send_writes(now_s)

    def give_up(self, answer: str) -> None:
        """End everything that is open."""
        for request in (*(entry.request for entry in self._sets.values()), self._list):
            if request is not None:
                request.set_outcome(RequestOutcome.TIMED_OUT, answer)
        self._sets.clear()

    def give_up_changes(self, answer: str) -> None:
        """End what would change a parameter; what is read goes on."""
        for entry in self._sets.values():
            entry.request.set_outcome(RequestOutcome.REFUSED, answer)
        self._sets.clear()

    def _request_missing(self, now_s: float) -> list[MavMessage]:
        if self._list is None or self._list.is_done:
            return []
        if self._count is not None and not self.missing_count:
            self._list.set_outcome(RequestOutcome.ACCEPTED, f"{self._count} parameters")
            return []
        if now_s - max(self._asked_s, self._came_s) < RETRY_PERIOD_S:
            return []
        if self._tries >= MAX_LIST_TRIES:
            words = f"{self.missing_count or 'all'} parameters are missing; read them again"
            self._list.set_outcome(RequestOutcome.TIMED_OUT, words)
            return []
        self._asked_s = now_s
        self._tries += 1
        if self._count is None:
            return [mavlink.MAVLink_param_request_list_message(*self.target)]
        gone = [k for k in range(self._count) if k not in self._indices][:REQUEST_BATCH_SIZE]
        return [mavlink.MAVLink_param_request_read_message(*self.target, b"", k) for k in gone]

    def _send_writes(self, now_s: float) -> list[MavMessage]:
        out = []
        for name, entry in list(self._sets.items()):
            if entry.differs_since_s < math.inf:
                reason = self._texts.text_since(entry.first_sent_s)
                if now_s - entry.differs_since_s > (REFUSAL_WAIT_S if reason else SILENT_REFUSAL_WAIT_S):
                    words = reason or f"the vehicle keeps {self._make_parameter(name).value:g}"
                    entry.request.set_outcome(RequestOutcome.REFUSED, words)
            elif entry.should_send(now_s):
                kind = self._raw[name][1]
                value = encode_parameter(entry.value, kind, self.bytewise)
                out.append(mavlink.MAVLink_param_set_message(*self.target, name.encode(), value, kind))
            if entry.request.is_done:
                del self._sets[name]
        return out

    def _handle_answer(self, now_s: float, name: str) -> None:
        entry = self._sets.get(name)
        if entry is None or not entry.send_count:
            return
        if math.isclose(self._make_parameter(name).value, entry.value, rel_tol=2e-7):
            del self._sets[name]
            entry.request.set_outcome(RequestOutcome.ACCEPTED)
        else:
            # It may belong to a list that was under way; only a value that stays is a refusal.
            entry.differs_since_s = min(entry.differs_since_s, now_s)

    def _make_parameter(self, name: str) -> TunableParameter:
        number, kind = self._raw[name]
        value = decode_parameter(number, kind, self.bytewise)
        about = self._about.get(name)
        if about is not None:
            return replace(about, value=value)
        least, greatest = INTEGER_RANGES.get(kind, _UNBOUNDED_RANGE)
        return TunableParameter(name, value, minimum=least, maximum=greatest, is_integer=kind in INTEGER_RANGES)


def _is_same_value(a: tuple[float, int], b: tuple[float, int] | None) -> bool:
    return b is not None and a[1] == b[1] and struct.pack("<f", a[0]) == struct.pack("<f", b[0])
