"""The parameters of a vehicle: read until none is missing, set until the vehicle says so.

MAVLink's parameter protocol (https://mavlink.io/en/services/parameter.html) sends the list once, without asking
whether it arrived. Each value carries its index and the number of all, so what is missing is known and is asked for
again, a few at a time. A value is a float field; autopilots put whole numbers there either as a number or as the
bytes of the integer ("bytewise"), and say which in AUTOPILOT_VERSION.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace

from mufly.flight import Parameter
from mufly.link.codec import MavMessage, mavlink
from mufly.link.parameters import WHOLE_RANGE, decoded, encoded
from mufly.station.commands import RETRY_S, Repeated, StatusTexts
from mufly.station.view import Outcome, Request

REASON_S, STAYS_S = 0.3, 1.2
"""A value that is not the one asked for is a refusal after so long, with and without words (s)."""
LIST_TRIES = 8
BATCH = 12
"""So many missing ones are asked for at a time."""
MOST = 5000
"""More than any autopilot has; beyond it the list is not believed."""
_UNBOUNDED = (-math.inf, math.inf)


def refused(known: Parameter | None, name: str, value: float) -> str:
    """Return why a value cannot be sent, "" if it can."""
    if known is None:
        return f"the vehicle has no parameter {name}"
    if not math.isfinite(value):
        return "that is no number"
    if not known.least <= value <= known.greatest:
        return f"from {known.least:g} to {known.greatest:g} {known.unit}".rstrip()
    return "a whole number is needed" if known.whole and value != round(value) else ""


@dataclass(slots=True, kw_only=True)
class _Set(Repeated):
    """A value that is being set; since when the vehicle has said another."""

    value: float
    differs_s: float = math.inf


class RemoteParameters:
    """The parameters of one vehicle.

    Parameters
    ----------
    texts : StatusTexts
        Where the vehicle says why it keeps a value.
    target : (system, component)

    Attributes
    ----------
    missing : int
        How many have not come yet; 0 before the first and when all are there.
    bytewise : bool
        Whether whole numbers travel as the bytes of an integer.
    """

    def __init__(self, texts: StatusTexts, target: tuple[int, int]) -> None:
        self._texts, self.target = texts, target
        self.bytewise = False
        self._about: Mapping[str, Parameter] = {}
        self._raw: dict[str, tuple[float, int]] = {}
        self._indices: dict[int, str] = {}
        self._count: int | None = None
        self._list: Request | None = None
        self._asked_s = self._came_s = -math.inf
        self._tries = 0
        self._sets: dict[str, _Set] = {}
        self._table: dict[str, Parameter] | None = None

    @property
    def table(self) -> dict[str, Parameter]:
        """Name -> parameter, by name."""
        if self._table is None:
            self._table = {name: self._known(name) for name in sorted(self._raw)}
        return self._table

    @property
    def missing(self) -> int:
        """How many have not come yet."""
        return 0 if self._count is None else max(0, self._count - len(self._indices))

    def describe(self, about: Mapping[str, Parameter]) -> None:
        """Say what is known of the vehicle's parameters besides their values."""
        self._about, self._table = about, None

    def encode_bytewise(self, yes: bool) -> None:
        """Say how whole numbers travel."""
        if yes != self.bytewise:
            self.bytewise, self._table = yes, None

    def refresh(self) -> Request:
        """Read all of them anew."""
        if self._list is None or self._list.done:
            self._list = Request("read all parameters")
            self._indices, self._count = {}, None
            self._asked_s, self._tries = -math.inf, 0
        return self._list

    def set(self, name: str, value: float) -> Request:
        """Set one; accepted once the vehicle says that it has this value.

        Parameters
        ----------
        name : str
        value : float
        """
        request = Request(f"set {name} to {value:g}")
        if why := refused(self.table.get(name), name, value):
            request.end(Outcome.REFUSED, why)
            return request
        if name in self._sets:
            self._sets[name].request.end(Outcome.REFUSED, "given up for another value")
        self._sets[name] = _Set(request, value=value)
        return request

    def handle(self, now_s: float, message: MavMessage) -> None:
        """Take a PARAM_VALUE."""
        name = message.param_id
        if not name or (len(self._raw) >= MOST and name not in self._raw):
            return
        raw = (message.param_value, message.param_type)
        if not _same(raw, self._raw.get(name)):
            self._raw[name] = raw
            if self._table is not None and name in self._table:
                self._table[name] = self._known(name)
            else:
                self._table = None
        if self._count != message.param_count and 0 < message.param_count <= MOST:
            if self._count is not None:
                self._indices = {}  # another list: the vehicle has learned or lost some
            self._count = message.param_count
        count = self._count or 0
        if message.param_index < count and name not in self._indices.values():
            self._indices[message.param_index] = name
            self._came_s, self._tries = now_s, 0
        if self._list is not None and count:
            self._list.progress = len(self._indices) / count
        self._answered(now_s, name)

    def step(self, now_s: float) -> list[MavMessage]:
        """Return what is to be sent now."""
        return self._read(now_s) + self._write(now_s)

    def give_up(self, answer: str) -> None:
        """End everything that is open."""
        for request in (*(entry.request for entry in self._sets.values()), self._list):
            if request is not None:
                request.end(Outcome.TIMED_OUT, answer)
        self._sets.clear()

    def _read(self, now_s: float) -> list[MavMessage]:
        if self._list is None or self._list.done:
            return []
        if self._count is not None and not self.missing:
            self._list.end(Outcome.ACCEPTED, f"{self._count} parameters")
            return []
        if now_s - max(self._asked_s, self._came_s) < RETRY_S:
            return []
        if self._tries >= LIST_TRIES:
            words = f"{self.missing or 'all'} parameters are missing; read them again"
            self._list.end(Outcome.TIMED_OUT, words)
            return []
        self._asked_s = now_s
        self._tries += 1
        if self._count is None:
            return [mavlink.MAVLink_param_request_list_message(*self.target)]
        gone = [k for k in range(self._count) if k not in self._indices][:BATCH]
        return [mavlink.MAVLink_param_request_read_message(*self.target, b"", k) for k in gone]

    def _write(self, now_s: float) -> list[MavMessage]:
        out = []
        for name, entry in list(self._sets.items()):
            if entry.differs_s < math.inf:
                reason = self._texts.since(entry.first_s)
                if now_s - entry.differs_s > (REASON_S if reason else STAYS_S):
                    words = reason or f"the vehicle keeps {self._known(name).value:g}"
                    entry.request.end(Outcome.REFUSED, words)
            elif entry.due(now_s):
                kind = self._raw[name][1]
                value = encoded(entry.value, kind, self.bytewise)
                out.append(mavlink.MAVLink_param_set_message(*self.target, name.encode(), value, kind))
            if entry.request.done:
                del self._sets[name]
        return out

    def _answered(self, now_s: float, name: str) -> None:
        entry = self._sets.get(name)
        if entry is None or not entry.tries:
            return
        if math.isclose(self._known(name).value, entry.value, rel_tol=2e-7):
            del self._sets[name]
            entry.request.end(Outcome.ACCEPTED)
        else:
            # It may belong to a list that was under way; only a value that stays is a refusal.
            entry.differs_s = min(entry.differs_s, now_s)

    def _known(self, name: str) -> Parameter:
        number, kind = self._raw[name]
        value = decoded(number, kind, self.bytewise)
        about = self._about.get(name)
        if about is not None:
            return replace(about, value=value)
        least, greatest = WHOLE_RANGE.get(kind, _UNBOUNDED)
        return Parameter(name, value, least=least, greatest=greatest, whole=kind in WHOLE_RANGE)


def _same(a: tuple[float, int], b: tuple[float, int] | None) -> bool:
    return b is not None and a[1] == b[1] and struct.pack("<f", a[0]) == struct.pack("<f", b[0])
