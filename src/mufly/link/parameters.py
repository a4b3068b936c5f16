"""Parameters over the link: the autopilot's and the link's own, listed, read and set.

All travel as ``float`` (MAV_PARAM_TYPE_REAL32), also whole numbers: the two ways in which autopilots pack integers
into the field (cast, and byte by byte as PX4 does) then do not matter, and every program reads the same value. A
value that is set as an integer type is taken byte by byte, which is what AUTOPILOT_VERSION declares.

Every PARAM_SET of a known name is answered with the value in force, be it the new one or the old
(https://mavlink.io/en/services/parameter.html). A list goes out at :data:`LIST_HZ` messages a second, so that a slow
radio does not drown.
"""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING

from mufly.link.clients import Sender
from mufly.link.codec import MavMessage, mavlink, single, text_of

if TYPE_CHECKING:
    from mufly.flight import Autopilot, Parameter

LIST_HZ = 100.0
_LOOK_S = 0.5
_LISTS = 16
_BYTEWISE = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B3x",
    mavlink.MAV_PARAM_TYPE_INT8: "<b3x",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H2x",
    mavlink.MAV_PARAM_TYPE_INT16: "<h2x",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}

LINK_PARAMETERS: dict[str, tuple[float, str, float, float, str]] = {
    "COM_DL_LOSS_T": (10.0, "s", 1.0, 300.0, "commander not heard for so long in flight: stop and hover"),
    "COM_DL_LAND_T": (20.0, "s", 0.0, 3600.0, "and for so much longer: land"),
}
"""The link's own: name -> value, unit, least, greatest, help."""


def value_of(number: float, kind: int) -> float:
    """Return the value that a PARAM_SET carries.

    A ``float`` holds seven digits; 0.6 comes as 0.60000002, and is 0.6 again here.
    """
    layout = _BYTEWISE.get(kind)
    if layout is not None:
        return float(struct.unpack(layout, struct.pack("<f", number))[0])
    return float(f"{number:.7g}")


class ParameterDesk:
    """Answers whoever asks for parameters.

    Parameters
    ----------
    autopilot : Autopilot
    """

    def __init__(self, autopilot: Autopilot) -> None:
        from mufly.flight import Parameter

        self._autopilot = autopilot
        self._own = {
            name: Parameter(name, value, unit, least, greatest, text)
            for name, (value, unit, least, greatest, text) in LINK_PARAMETERS.items()
        }
        self._names = sorted([*autopilot.parameters, *self._own])
        self._places = {name: k for k, name in enumerate(self._names)}
        self._lists: OrderedDict[Sender, int] = OrderedDict()
        self._due_s = self._looked_s = -math.inf
        self._told = {name: self.get(name).value for name in self._names}

    @property
    def names(self) -> list[str]:
        """All names, in the order of their index."""
        return list(self._names)

    def get(self, name: str) -> Parameter:
        """Return a parameter."""
        return self._own[name] if name in self._own else self._autopilot.parameters[name]

    def request_list(self, sender: Sender) -> None:
        """Begin a list, anew if one is under way."""
        self._lists.pop(sender, None)
        if len(self._lists) < _LISTS:
            self._lists[sender] = 0

    def read(self, message: MavMessage) -> MavMessage | None:
        """Answer a PARAM_REQUEST_READ, by index or by name; None if there is no such parameter."""
        k = message.param_index
        if k == -1:
            name = message.param_id
            return self._value(name) if name in self._places else None
        return self._value(self._names[k]) if 0 <= k < len(self._names) else None

    def no_such(self, sender: Sender, message: MavMessage) -> MavMessage:
        """Say that there is no parameter of that name or index, so that nobody waits for it."""
        index = getattr(message, "param_index", -1)
        return mavlink.MAVLink_param_error_message(
            sender.system,
            sender.component,
            text_of(message.param_id, 16),
            index,
            mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST,
        )

    def set(self, message: MavMessage) -> tuple[MavMessage | None, str]:
        """Take a PARAM_SET; returns the answer, and why not (or "")."""
        name = message.param_id
        if name not in self._places:
            return None, f"there is no parameter {name[:16]!r}"
        value = value_of(message.param_value, message.param_type)
        if name in self._own:
            p = self._own[name]
            if not p.least <= value <= p.greatest:
                return self._value(name), f"{name} has to be {p.least:g} to {p.greatest:g} {p.unit}"
            self._own[name] = replace(p, value=value)
            self._told[name] = value
            return self._value(name), ""
        answer = self._autopilot.set_parameter(name, value)
        self._told[name] = self.get(name).value
        return self._value(name), "" if answer else answer.reason

    def step(self, now_s: float) -> list[tuple[Sender, MavMessage]]:
        """The next messages of the lists that are under way, one for each who waits."""
        if not self._lists or now_s < self._due_s:
            return []
        self._due_s = now_s + 1.0 / LIST_HZ
        out = []
        for sender, k in list(self._lists.items()):
            out.append((sender, self._value(self._names[k])))
            if k + 1 < len(self._names):
                self._lists[sender] = k + 1
            else:
                del self._lists[sender]
        return out

    def changed(self, now_s: float) -> list[MavMessage]:
        """Values that something other than a PARAM_SET of theirs has changed: a command, a mission, another limit."""
        if now_s - self._looked_s < _LOOK_S:
            return []
        self._looked_s = now_s
        now = {name: self.get(name).value for name in self._names}
        names = [name for name in self._names if now[name] != self._told[name]]
        self._told = now
        return [self._value(name) for name in names]

    def forget(self, peer: object) -> None:
        """A peer has gone."""
        for sender in [s for s in self._lists if s.peer == peer]:
            del self._lists[sender]

    def _value(self, name: str) -> MavMessage:
        return mavlink.MAVLink_param_value_message(
            text_of(name, 16),
            single(self.get(name).value),
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(self._names),
            self._places[name],
        )
