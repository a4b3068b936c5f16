"""What a station asks of a vehicle that it has just found, or found again.

First who it is (AUTOPILOT_VERSION); then how often it is to tell what (SET_MESSAGE_INTERVAL, or REQUEST_DATA_STREAM
if it does not know that); then its parameters and its mission.
"""

from __future__ import annotations

import math

from mufly.link.dialect import MavMessage, mavlink
from mufly.station import orders
from mufly.station.modes import PX4
from mufly.station.parameters import Parameters
from mufly.station.requests import Commands
from mufly.station.telemetry import Telemetry
from mufly.station.transfers import Transfers
from mufly.station.view import Outcome, Parameter, Request

__all__ = ["WISHES", "Greeting"]

WISHES: tuple[tuple[str, float], ...] = (
    ("ATTITUDE", 1.0),
    ("LOCAL_POSITION_NED", 1.0),
    ("POSITION_TARGET_LOCAL_NED", 1.0),
    ("ATTITUDE_TARGET", 1.0),
    ("ACTUATOR_OUTPUT_STATUS", 1.0),
    ("VISION_POSITION_ESTIMATE", 0.5),
    ("RAW_RPM", 0.5),
    ("DEBUG_FLOAT_ARRAY", 0.5),
    ("OBSTACLE_DISTANCE", 0.25),
    ("DISTANCE_SENSOR", 0.0),
)
"""Messages, and their rates as a share of the fastest."""
_FOREIGN = (
    ("SERVO_OUTPUT_RAW", 0.1),
    ("RC_CHANNELS", 0.05),
    ("BATTERY_STATUS", 0.01),
    ("EXTENDED_SYS_STATE", 0.02),
)
_STREAM_HZ = 10
_BYTEWISE, _C_CAST = 16, 131072  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_*
_PATIENCE_S = 3.0


class Greeting:
    """The first questions to one vehicle.

    Parameters
    ----------
    commands, parameters, transfers
        What does the asking.
    rate_Hz : float
        Fastest rate.

    Attributes
    ----------
    ours : bool
        Whether it said that it is a mufly vehicle.
    """

    def __init__(
        self, commands: Commands, parameters: Parameters, transfers: Transfers, rate_Hz: float
    ) -> None:
        self._commands, self._parameters, self._transfers = commands, parameters, transfers
        self._rate_Hz = rate_Hz
        self.ours = False
        self._version: MavMessage | None = None
        self._asked_s = math.nan
        self._streams: list[Request] = []
        self._wished = self._read = self._older = False
        self._group: list[MavMessage] = []

    def again(self) -> None:
        """Wish anew: it was away, or is heard from elsewhere."""
        self._wished = self._older = False

    def anew(self) -> None:
        """Ask everything anew: it was started anew."""
        self._version, self._asked_s = None, math.nan
        self._wished = self._read = self._older = False

    def version(self, message: MavMessage) -> None:
        """Take AUTOPILOT_VERSION."""
        self._version = message
        self.ours = bytes(message.flight_custom_version).startswith(b"mufly")
        if self.ours:
            self._parameters.describe(_ours())

    def step(self, now_s: float, telemetry: Telemetry) -> None:
        """Ask for what comes next."""
        if math.isnan(self._asked_s):
            self._asked_s = now_s
            self._commands.ask(
                "who are you?", orders.request_message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            )
        if self._version is None and now_s - self._asked_s < _PATIENCE_S:
            return
        if not self._wished:
            self._wished = True
            self._wish()
        if not self._read:
            self._read = True
            known = self._version.capabilities if self._version is not None else 0
            guess = telemetry.autopilot == PX4
            self._parameters.encode_bytewise(bool(known & _BYTEWISE) or (guess and not known & _C_CAST))
            self._parameters.refresh()
            self._transfers.download()
        if not self._older and any(r.outcome is Outcome.REFUSED for r in self._streams):
            self._older = True
            self._streams = []
            everything = mavlink.MAV_DATA_STREAM_ALL
            self._commands.send(
                mavlink.MAVLink_request_data_stream_message(*self._commands.target, everything, _STREAM_HZ, 1)
            )

    def _wish(self) -> None:
        wanted = WISHES if self.ours else (*WISHES[:-1], *_FOREIGN)
        self._streams = []
        for name, share in wanted:
            number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
            request = self._commands.ask(f"tell {name}", orders.interval(number, share * self._rate_Hz))
            if name == "ATTITUDE":  # every vehicle has it: if it refuses this, it does not know the command
                self._streams.append(request)


def _ours() -> dict[str, Parameter]:
    """What is known of the parameters of our own vehicles: unit, bounds, help."""
    from mufly.flight.parameter_table import TABLE
    from mufly.link.parameters import LINK_PARAMETERS

    known = [Parameter(r.name, math.nan, r.unit, r.least, r.greatest, r.help, r.whole) for r in TABLE]
    known += [Parameter(name, math.nan, *row[1:]) for name, row in LINK_PARAMETERS.items()]
    return {p.name: p for p in known}
