"""Connection to a remote vehicle: its identity, message rates, parameters and mission are requested in turn."""

from __future__ import annotations

import math
from dataclasses import replace

from mufly.flight import TunableParameter
from mufly.flight.tunable_parameters import TUNABLE_PARAMETERS
from mufly.link.codec import MavMessage, mavlink
from mufly.link.parameter_protocol import LINK_PARAMETERS
from mufly.station.remote import autopilots
from mufly.station.remote.remote_commands import RemoteCommands
from mufly.station.remote.remote_transfers import RemoteMission, RemoteParameters
from mufly.station.remote.vehicle_telemetry import VehicleTelemetry
from mufly.station.signal_history import OperatorRequest, RequestOutcome
from mufly.vehicle_types import MAV_AUTOPILOT_PX4

REQUESTED_MESSAGES: tuple[tuple[str, float], ...] = (
    ("ATTITUDE", 1.0),
    ("LOCAL_POSITION_NED", 1.0),
    ("POSITION_TARGET_LOCAL_NED", 1.0),
    ("ATTITUDE_TARGET", 1.0),
    ("ODOMETRY", 0.2),
    ("ESTIMATOR_STATUS", 0.04),
    ("ACTUATOR_OUTPUT_STATUS", 1.0),
    ("VISION_POSITION_ESTIMATE", 0.5),
    ("RAW_RPM", 0.5),
    ("DEBUG_FLOAT_ARRAY", 0.5),
    ("OBSTACLE_DISTANCE", 0.25),
    ("DISTANCE_SENSOR", 0.0),
)
"""Requested messages, with their rates as a share of the fastest."""
_OTHER_AUTOPILOT_MESSAGES = (
    ("SERVO_OUTPUT_RAW", 0.1),
    ("RC_CHANNELS", 0.05),
    ("BATTERY_STATUS", 0.01),
    ("EXTENDED_SYS_STATE", 0.02),
)
_STREAM_RATE_HZ = 10
_CAPABILITY_BYTEWISE, _CAPABILITY_C_CAST = 16, 131072  # MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_*
_VERSION_TIMEOUT_S = 3.0


class ConnectionSetup:
    """Sequence of requests to a vehicle that is heard for the first time, or again after a loss.

    The first is the identity (AUTOPILOT_VERSION), then the message rates (SET_MESSAGE_INTERVAL, or REQUEST_DATA_STREAM
    if unsupported), then the parameters and the mission.

    Parameters
    ----------
    commands, parameters, transfers
        Parts that send the requests; transfers of missions and of geofences.
    rate_Hz : float
        Fastest message rate (Hz).

    Attributes
    ----------
    is_mufly : bool
        Whether the vehicle identified itself as a mufly vehicle.
    """

    def __init__(
        self,
        commands: RemoteCommands,
        parameters: RemoteParameters,
        transfers: tuple[RemoteMission, RemoteMission],
        rate_Hz: float,
    ) -> None:
        self._commands, self._parameters = commands, parameters
        self._mission, self._fence = transfers
        self._rate_Hz = rate_Hz
        self.is_mufly = False
        self.restart_setup()

    def request_streams_again(self) -> None:
        """Request the message streams again, after a loss of the link or a change of the vehicle's address."""
        self._wished: OperatorRequest | None = None
        self._older = False

    def restart_setup(self) -> None:
        """Repeat all requests after a restart of the vehicle."""
        self._version: MavMessage | None = None
        self._asked_s = math.nan
        self._read = False
        self.request_streams_again()

    def handle_version(self, message: MavMessage) -> None:
        """Read from AUTOPILOT_VERSION whether the vehicle runs mufly."""
        self._version = message
        self.is_mufly = bytes(message.flight_custom_version).startswith(b"mufly")
        if self.is_mufly:
            self._parameters.set_descriptions(_mufly_parameter_descriptions())

    def send_due_request(self, now_s: float, telemetry: VehicleTelemetry) -> None:
        """Send the next request of the connection sequence that is due."""
        if math.isnan(self._asked_s):
            self._asked_s = now_s
            version = autopilots.make_request_message_command(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            self._commands.request_command("request the version", version)
        if self._version is None and now_s - self._asked_s < _VERSION_TIMEOUT_S:
            return
        if self._wished is None:
            for name, share in (
                REQUESTED_MESSAGES if self.is_mufly else (*REQUESTED_MESSAGES[:-1], *_OTHER_AUTOPILOT_MESSAGES)
            ):
                number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
                command = autopilots.make_message_interval_command(number, share * self._rate_Hz)
                request = self._commands.request_command(f"request {name}", command)
                # All vehicles have the first message: its refusal means that the command is unsupported.
                self._wished = self._wished or request
        if not self._read:
            self._read = True
            known = self._version.capabilities if self._version is not None else 0
            guess = telemetry.autopilot == MAV_AUTOPILOT_PX4
            self._parameters.set_bytewise_encoding(
                bool(known & _CAPABILITY_BYTEWISE) or (guess and not known & _CAPABILITY_C_CAST)
            )
            self._parameters.request_all_parameters()
            self._mission.download_items()
            if known & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE:
                self._fence.download_items()
        if not self._older and self._wished is not None and self._wished.outcome is RequestOutcome.REFUSED:
            self._older = True
            everything = mavlink.MAV_DATA_STREAM_ALL
            self._commands.send_message(
                mavlink.MAVLink_request_data_stream_message(*self._commands.target, everything, _STREAM_RATE_HZ, 1)
            )


def _mufly_parameter_descriptions() -> dict[str, TunableParameter]:
    """Return unit, bounds and help of the parameters of mufly vehicles."""
    return TUNABLE_PARAMETERS | {name: replace(p, value=math.nan) for name, p in LINK_PARAMETERS.items()}
