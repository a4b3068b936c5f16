"""The parameter protocol: list, read and set the parameters of the autopilot and of the link.

All parameters are sent as ``float`` (MAV_PARAM_TYPE_REAL32), whole numbers too. The two ways in which autopilots pack
integers into the field (cast, or byte by byte as PX4 does) then give the same value in every program. A value that is
set as an integer type is read byte by byte, as AUTOPILOT_VERSION declares.

Every PARAM_SET of a known name is answered with the value in force, changed or not
(https://mavlink.io/en/services/parameter.html). A list is sent at :data:`LIST_RATE_HZ` messages a second, which does
not overload a slow radio.
"""

from __future__ import annotations

import math
import struct
from collections import OrderedDict
from dataclasses import replace

from mufly.flight import Autopilot, TunableParameter
from mufly.link.clients import Clients, CommandAuthority
from mufly.link.codec import MavMessage, MessageSource, encode_text_field, mavlink, to_float32

LIST_RATE_HZ = 100.0
_CHANGE_CHECK_PERIOD_S = 0.5
_MAX_LISTS = 16

LINK_PARAMETERS: dict[str, TunableParameter] = {
    p.name: p
    for p in (
        TunableParameter(
            "COM_DL_LOSS_T",
            10.0,
            "s",
            1.0,
            300.0,
            "time without a message from the commanding station in flight until stop and hover",
        ),
        TunableParameter("COM_DL_LAND_T", 20.0, "s", 0.0, 3600.0, "additional time until landing"),
        TunableParameter(
            "EKF2_EV_DELAY",
            0.0,
            "ms",
            0.0,
            900.0,
            "delay of positions by link stamped by another clock, beyond that of the fastest message",
        ),
    )
}
"""The link's own parameters, by name."""

_STRUCT_FORMATS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<B3x",
    mavlink.MAV_PARAM_TYPE_INT8: "<b3x",
    mavlink.MAV_PARAM_TYPE_UINT16: "<H2x",
    mavlink.MAV_PARAM_TYPE_INT16: "<h2x",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}
INTEGER_RANGES: dict[int, tuple[int, int]] = {
    mavlink.MAV_PARAM_TYPE_UINT8: (0, 2**8 - 1),
    mavlink.MAV_PARAM_TYPE_INT8: (-(2**7), 2**7 - 1),
    mavlink.MAV_PARAM_TYPE_UINT16: (0, 2**16 - 1),
    mavlink.MAV_PARAM_TYPE_INT16: (-(2**15), 2**15 - 1),
    mavlink.MAV_PARAM_TYPE_UINT32: (0, 2**32 - 1),
    mavlink.MAV_PARAM_TYPE_INT32: (-(2**31), 2**31 - 1),
}
"""Least and greatest value of each integer type (MAV_PARAM_TYPE)."""


def decode_parameter_value(number: float, kind: int, bytewise: bool = True) -> float:
    """Return the value in the ``float`` field of a PARAM_SET or PARAM_VALUE.

    A ``float`` holds seven digits: 0.60000002 is returned as 0.6. Autopilots pack whole numbers either as a number or,
    ``bytewise``, as the bytes of the integer.
    """
    if bytewise and kind in _STRUCT_FORMATS:
        return float(struct.unpack(_STRUCT_FORMATS[kind], struct.pack("<f", number))[0])
    return float(f"{number:.7g}") if math.isfinite(number) else number


def encode_parameter_value(value: float, kind: int, bytewise: bool = True) -> float:
    """Return the ``float`` field of a value, the inverse of :func:`decode_parameter_value`."""
    if bytewise and kind in _STRUCT_FORMATS:
        return float(struct.unpack("<f", struct.pack(_STRUCT_FORMATS[kind], round(value)))[0])
    return value


class ParameterProtocol:
    """The vehicle's side of the parameter protocol.

    Parameters
    ----------
    autopilot : Autopilot
    clients : Clients
    authority : CommandAuthority
        Decides which station may set parameters.
    """

    def __init__(self, autopilot: Autopilot, clients: Clients, authority: CommandAuthority) -> None:
        self._autopilot, self._clients, self._authority = autopilot, clients, authority
        self._own = dict(LINK_PARAMETERS)
        self._names = sorted([*autopilot.parameters, *self._own])
        self._places = {name: k for k, name in enumerate(self._names)}
        self._lists: OrderedDict[MessageSource, int] = OrderedDict()
        self._due_s = self._looked_s = -math.inf
        self._told = {name: self[name] for name in self._names}

    def __getitem__(self, name: str) -> float:
        """Return the value of a parameter."""
        return (self._own[name] if name in self._own else self._autopilot.parameters[name]).value

    def handle_request_list(self, now_s: float, station: MessageSource, message: MavMessage) -> None:
        """Process a PARAM_REQUEST_LIST: start to send the station all parameters, from the first, one at a time."""
        self._lists.pop(station, None)
        if len(self._lists) < _MAX_LISTS:
            self._lists[station] = 0

    def handle_request_read(self, now_s: float, station: MessageSource, message: MavMessage) -> None:
        """Answer a PARAM_REQUEST_READ, by index or by name."""
        k = message.param_index
        name = message.param_id if k == -1 else self._names[k] if 0 <= k < len(self._names) else ""
        self._send_value_or_error(station, name, message, k)

    def handle_parameter_set(self, now_s: float, station: MessageSource, message: MavMessage) -> None:
        """Process a PARAM_SET; all peers receive the resulting value."""
        name = message.param_id
        if not self._authority.claim_command(now_s, station):
            self._send_value_or_error(station, name, message)
            return
        why = self._set_value(name, decode_parameter_value(message.param_value, message.param_type))
        if why:
            self._clients.send_text(why, "warning", station.peer)
        if name in self._places:
            self._told[name] = self[name]
            self._clients.send_message(None, self._make_value_message(name))
        else:
            self._send_value_or_error(station, name, message)

    def _set_value(self, name: str, value: float) -> str:
        """Set a parameter; return the reason of a refusal, or ""."""
        if name not in self._places:
            return f"there is no parameter {name[:16]!r}"
        if name not in self._own:
            answer = self._autopilot.set_parameter(name, value)
            return "" if answer else answer.reason
        p = self._own[name]
        if not p.minimum <= value <= p.maximum:
            return f"{name} must be {p.minimum:g} to {p.maximum:g} {p.unit}"
        self._own[name] = replace(p, value=value)
        return ""

    def send_next_values(self, now_s: float) -> None:
        """Send one message to each peer with an unfinished list, and all changed values."""
        if self._lists and now_s >= self._due_s:
            self._due_s = max(self._due_s + 1.0 / LIST_RATE_HZ, now_s)  # counted from the last message
            for station, k in list(self._lists.items()):
                self._clients.send_message(station.peer, self._make_value_message(self._names[k]))
                if k + 1 < len(self._names):
                    self._lists[station] = k + 1
                else:
                    del self._lists[station]
        # A command, a mission or another limit may also have changed a value.
        if now_s - self._looked_s >= _CHANGE_CHECK_PERIOD_S:
            self._looked_s = now_s
            told, self._told = self._told, {name: self[name] for name in self._names}
            for name in self._names:
                if self._told[name] != told[name]:
                    self._clients.send_message(None, self._make_value_message(name))

    def _send_value_or_error(self, station: MessageSource, name: str, message: MavMessage, index: int = -1) -> None:
        """Send a value, or a report that no parameter has this name or index."""
        if name in self._places:
            self._clients.send_message(station.peer, self._make_value_message(name))
            return
        self._clients.send_message(
            station.peer,
            mavlink.MAVLink_param_error_message(
                station.system,
                station.component,
                encode_text_field(message.param_id, 16),
                index,
                mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST,
            ),
        )

    def _make_value_message(self, name: str) -> MavMessage:
        return mavlink.MAVLink_param_value_message(
            encode_text_field(name, 16),
            to_float32(self[name]),
            mavlink.MAV_PARAM_TYPE_REAL32,
            len(self._names),
            self._places[name],
        )
