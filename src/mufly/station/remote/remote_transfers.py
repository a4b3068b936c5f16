"""Mission, geofence and parameters of a vehicle: upload, download and clearing.

Items become rows of a table in :mod:`mufly.station.mission_rows`, a mission file becomes items in
:mod:`mufly.mission.files.mission_items`.

Transfers run one after another on the state machines of :mod:`mufly.link.mission_transfer`. The vehicle's items are
those of the last successful transfer. When the vehicle reports another item count (another station sent a mission),
they are fetched again.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from mufly.flight import TunableParameter
from mufly.link.codec import MavMessage, mavlink
from mufly.link.mission_transfer import (
    TRANSFER_TIMEOUT_S,
    TYPE_ALL,
    TYPE_MISSION,
    AddressedMessages,
    MissionAck,
    MissionClearAll,
    MissionItem,
    MissionReceiver,
    MissionResultCode,
    MissionSender,
    encode_transfer_message,
    parse_transfer_message,
)
from mufly.link.parameter_protocol import INTEGER_RANGES, decode_parameter_value, encode_parameter_value
from mufly.station.remote.remote_commands import RETRY_PERIOD_S, RepeatedRequest, StatusTextLog
from mufly.station.signal_history import OperatorRequest, RequestOutcome

_PEER_NAME = "vehicle"
_RESULT_TEXTS: dict[int, str] = {
    MissionResultCode.ERROR: "the vehicle cannot accept a mission now",
    MissionResultCode.UNSUPPORTED_FRAME: "coordinate frame not supported by the vehicle",
    MissionResultCode.UNSUPPORTED: "a command is not supported by the vehicle",
    MissionResultCode.NO_SPACE: "too many items",
    MissionResultCode.INVALID: "an item is invalid",
    MissionResultCode.INVALID_SEQUENCE: "items received out of order",
    MissionResultCode.DENIED: "denied: the vehicle accepts no mission from this station now",
    MissionResultCode.OPERATION_CANCELLED: "cancelled by the vehicle",
} | {MissionResultCode.INVALID_PARAM1 + k: f"parameter {k + 1} of an item is invalid" for k in range(7)}


@dataclass(slots=True, kw_only=True)
class _TransferJob(RepeatedRequest):
    """Mission transfer: upload of ``items`` or, if None, download or clearing.

    Only the request to clear is repeated until answered.
    """

    items: tuple[MissionItem, ...] | None = None
    is_clearing: bool = False
    started_s: float = math.nan


class RemoteMission:
    """The mission of one vehicle.

    Parameters
    ----------
    texts : StatusTextLog
        Source of the reasons of refusals.
    target : (system, component)
    kind : int
        MAV_MISSION_TYPE: 0 the mission, 1 the geofence.

    Attributes
    ----------
    items : tuple of MissionItem or None
        The vehicle's items; None while unknown.
    """

    def __init__(self, texts: StatusTextLog, target: tuple[int, int], kind: int = TYPE_MISSION) -> None:
        self._texts, self.target, self._kind = texts, target, kind
        self._called = "mission" if kind == TYPE_MISSION else "geofence"
        self.items: tuple[MissionItem, ...] | None = None
        self._jobs: deque[_TransferJob] = deque()
        self._sender: MissionSender | None = None
        self._fetched: tuple[MissionItem, ...] | None = None
        self._receiver = MissionReceiver(self._accept_items, mission_type=kind, unasked=False)
        self._messy_s: float | None = None
        self._out: AddressedMessages = []

    def upload_items(self, items: Sequence[MissionItem]) -> OperatorRequest:
        """Upload items; the request is accepted once the vehicle has all items."""
        return self._queue_job(
            _TransferJob(OperatorRequest(f"upload a {self._called} of {len(items)} items"), items=tuple(items))
        )

    def download_items(self) -> OperatorRequest:
        """Download the vehicle's items; they become the request's ``result``."""
        return self._queue_job(_TransferJob(OperatorRequest(f"download the {self._called}")))

    def clear_items(self) -> OperatorRequest:
        """Clear the vehicle's mission."""
        return self._queue_job(_TransferJob(OperatorRequest(f"clear the {self._called}"), is_clearing=True))

    def _queue_job(self, job: _TransferJob) -> OperatorRequest:
        self._jobs.append(job)
        return job.request

    @property
    def is_busy(self) -> bool:
        """Return whether a transfer is active or queued."""
        return bool(self._jobs)

    def handle_message(self, now_s: float, message: MavMessage) -> None:
        """Process a message of the mission protocol."""
        note = parse_transfer_message(message)
        if note is None or getattr(note, "mission_type", self._kind) not in (self._kind, TYPE_ALL):
            return
        job = self._jobs[0] if self._jobs else None
        clearing = job is not None and job.is_clearing and job.send_count
        if (
            job is not None
            and clearing
            and isinstance(note, MissionAck)
            and note.mission_type in (self._kind, TYPE_ALL)
        ):
            if note.result == MissionResultCode.ACCEPTED:
                self.items = ()
                job.request.set_outcome(RequestOutcome.ACCEPTED)
            else:
                self._refuse_job(job, note.result)
        elif self._sender is not None:
            self._out += self._sender.handle_message(now_s, note)
        else:
            self._out += self._receiver.handle_message(now_s, _PEER_NAME, note)

    def take_due_messages(self, now_s: float) -> list[MavMessage]:
        """Return the messages of the mission transfer to send at present."""
        if self._messy_s is None:
            self._messy_s = now_s  # an earlier station may have left a transfer open
        if self._jobs:
            job = self._jobs[0]
            if math.isnan(job.started_s):
                job.started_s = now_s
                self._start_job(now_s, job)
            if job.is_clearing and job.count_try_if_due(now_s):
                self._out.append((_PEER_NAME, MissionClearAll(self._kind)))
            elif not job.is_clearing:
                self._continue_job(now_s, job)
            if job.request.is_done:
                self._jobs.popleft()
        notes, self._out = self._out, []
        return [encode_transfer_message(note, *self.target) for _, note in notes]

    def end_open_requests(self, answer: str) -> None:
        """End all open mission transfers."""
        for job in self._jobs:
            job.request.set_outcome(RequestOutcome.TIMED_OUT, answer)
        self._jobs.clear()
        self._sender = None
        self._receiver.cancel_transfer()
        self._out = []
        self._messy_s = None

    def cancel_changes(self, answer: str) -> None:
        """Cancel transfers that change the vehicle's mission; downloads continue."""
        for job in [j for j in self._jobs if j.items is not None or j.is_clearing]:
            job.request.set_outcome(RequestOutcome.REFUSED, answer)
            if job is self._jobs[0]:
                self._sender, self._out = None, []
            self._jobs.remove(job)

    def _start_job(self, now_s: float, job: _TransferJob) -> None:
        if job.items is not None:
            self._sender = MissionSender(_PEER_NAME, job.items, mission_type=self._kind)
            messy = self._messy_s is not None and now_s - self._messy_s < TRANSFER_TIMEOUT_S
            self._out += self._sender.start_transfer(now_s, hush=messy)
        elif not job.is_clearing:
            self._fetched = None
            self._out += self._receiver.request_items(now_s, _PEER_NAME)

    def _continue_job(self, now_s: float, job: _TransferJob) -> None:
        machine = self._sender if self._sender is not None else self._receiver
        self._out += machine.take_due_messages(now_s)
        job.request.progress = max(job.request.progress, machine.completed_fraction)
        if machine.result is None:
            return
        self._sender = None
        if machine.result == MissionResultCode.ACCEPTED:
            self._messy_s = -math.inf
            self.items = job.items if job.items is not None else self._fetched
            job.request.result = self.items
            job.request.set_outcome(RequestOutcome.ACCEPTED, f"{len(self.items or ())} items")
            return
        self._messy_s = now_s
        if machine.timed_out:
            job.request.set_outcome(RequestOutcome.TIMED_OUT, f"no message for {TRANSFER_TIMEOUT_S:.0f} s")
        else:
            self._refuse_job(job, int(machine.result))

    def _refuse_job(self, job: _TransferJob, result: int) -> None:
        words = _RESULT_TEXTS.get(result, f"result {result}")
        job.request.set_outcome(RequestOutcome.REFUSED, self._texts.latest_text_since(job.started_s) or words)

    def _accept_items(self, items: tuple[MissionItem, ...]) -> int:
        self._fetched = items
        return MissionResultCode.ACCEPTED


# ----------------------------------------------------------------------------
# The parameters of a vehicle: read until complete, set until the vehicle confirms the value.
#
# MAVLink's parameter protocol (https://mavlink.io/en/services/parameter.html) sends the list once, unconfirmed. Each
# value holds its index and the total count, so missing values are known and requested again, a few at a time. A value
# is a float field; autopilots store integers there either as a number or as the bytes of the integer ("bytewise"), and
# publish the encoding in AUTOPILOT_VERSION.


REFUSAL_WAIT_S, SILENT_REFUSAL_WAIT_S = 0.3, 1.2
"""Times after which a value other than requested counts as a refusal (s), with and without a status text."""
MAX_LIST_TRIES = 8
REQUEST_BATCH_SIZE = 12
"""Number of missing values requested at a time."""
MAX_PARAMETERS = 5000
"""Longest plausible list; longer ones are rejected."""
_UNBOUNDED_RANGE = (-math.inf, math.inf)


def find_parameter_refusal_reason(known: TunableParameter | None, name: str, value: float) -> str:
    """Return the reason why a value cannot be sent, "" if it can."""
    if known is None:
        return f"the vehicle has no parameter {name}"
    if not math.isfinite(value):
        return "not a number"
    if not known.minimum <= value <= known.maximum:
        return f"outside {known.minimum:g} to {known.maximum:g} {known.unit}".rstrip()
    return "integer required" if known.is_integer and value != round(value) else ""


@dataclass(slots=True, kw_only=True)
class _ParameterWrite(RepeatedRequest):
    """A parameter value being set, and the time since which the vehicle reports another value."""

    value: float
    differs_since_s: float = math.inf


class RemoteParameters:
    """The parameters of one vehicle.

    Parameters
    ----------
    texts : StatusTextLog
        Source of the reasons of refusals.
    target : (system, component)

    Attributes
    ----------
    missing_count : int
        Number of parameters not received; 0 before the first and when complete.
    bytewise : bool
        Whether integers are sent as bytes.
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
        """Return the parameters by name."""
        if self._table is None:
            self._table = {name: self._make_parameter(name) for name in sorted(self._raw)}
        return self._table

    @property
    def missing_count(self) -> int:
        """Return the number of parameters not received."""
        return 0 if self._count is None else max(0, self._count - len(self._indices))

    def set_descriptions(self, about: Mapping[str, TunableParameter]) -> None:
        """Set the descriptions (unit, bounds, help) of the vehicle's parameters."""
        self._about, self._table = about, None

    def set_bytewise_encoding(self, yes: bool) -> None:
        """Set whether the vehicle sends integers bytewise in the ``float`` field."""
        if yes != self.bytewise:
            self.bytewise, self._table = yes, None

    def request_all_parameters(self) -> OperatorRequest:
        """Request all parameters again."""
        if self._list is None or self._list.is_done:
            self._list = OperatorRequest("download all parameters")
            self._indices, self._count = {}, None
            self._asked_s, self._tries = -math.inf, 0
        return self._list

    def set_parameter(self, name: str, value: float) -> OperatorRequest:
        """Set a parameter; the request is accepted once the vehicle reports this value.

        Parameters
        ----------
        name : str
        value : float
        """
        request = OperatorRequest(f"set {name} to {value:g}")
        if why := find_parameter_refusal_reason(self.parameter_table.get(name), name, value):
            request.set_outcome(RequestOutcome.REFUSED, why)
            return request
        if name in self._sets:
            self._sets[name].request.set_outcome(RequestOutcome.REFUSED, "superseded by another value")
        self._sets[name] = _ParameterWrite(request, value=value)
        return request

    def handle_parameter_value(self, now_s: float, message: MavMessage) -> None:
        """Store the parameter value of a PARAM_VALUE."""
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
                self._indices = {}  # the vehicle's list has changed
            self._count = message.param_count
        count = self._count or 0
        if message.param_index < count and name not in self._indices.values():
            self._indices[message.param_index] = name
            self._came_s, self._tries = now_s, 0
        if self._list is not None and count:
            self._list.progress = len(self._indices) / count
        self._handle_parameter_answer(now_s, name)

    def take_due_messages(self, now_s: float) -> list[MavMessage]:
        """Return the requests for parameters to send at present."""
        return self._request_missing(now_s) + self._send_writes(now_s)

    def end_open_requests(self, answer: str) -> None:
        """End all open requests for parameters."""
        for request in (*(entry.request for entry in self._sets.values()), self._list):
            if request is not None:
                request.set_outcome(RequestOutcome.TIMED_OUT, answer)
        self._sets.clear()

    def cancel_writes(self, answer: str) -> None:
        """Cancel parameter writes; reading continues."""
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
            words = f"{self.missing_count or 'all'} parameters are missing; press Refresh"
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
                reason = self._texts.latest_text_since(entry.first_sent_s)
                if now_s - entry.differs_since_s > (REFUSAL_WAIT_S if reason else SILENT_REFUSAL_WAIT_S):
                    words = reason or f"the vehicle keeps {self._make_parameter(name).value:g}"
                    entry.request.set_outcome(RequestOutcome.REFUSED, words)
            elif entry.count_try_if_due(now_s):
                kind = self._raw[name][1]
                value = encode_parameter_value(entry.value, kind, self.bytewise)
                out.append(mavlink.MAVLink_param_set_message(*self.target, name.encode(), value, kind))
            if entry.request.is_done:
                del self._sets[name]
        return out

    def _handle_parameter_answer(self, now_s: float, name: str) -> None:
        entry = self._sets.get(name)
        if entry is None or not entry.send_count:
            return
        if math.isclose(self._make_parameter(name).value, entry.value, rel_tol=2e-7):
            del self._sets[name]
            entry.request.set_outcome(RequestOutcome.ACCEPTED)
        else:
            # The value may belong to an earlier list; only a persistent value is a refusal.
            entry.differs_since_s = min(entry.differs_since_s, now_s)

    def _make_parameter(self, name: str) -> TunableParameter:
        number, kind = self._raw[name]
        value = decode_parameter_value(number, kind, self.bytewise)
        about = self._about.get(name)
        if about is not None:
            return replace(about, value=value)
        least, greatest = INTEGER_RANGES.get(kind, _UNBOUNDED_RANGE)
        return TunableParameter(name, value, minimum=least, maximum=greatest, is_integer=kind in INTEGER_RANGES)


def _is_same_value(a: tuple[float, int], b: tuple[float, int] | None) -> bool:
    return b is not None and a[1] == b[1] and struct.pack("<f", a[0]) == struct.pack("<f", b[0])
