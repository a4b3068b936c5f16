"""Packets of Betaflight's software in the loop ("SITL"), and its MSP status; everything little endian.

====================== ========= =====================================================================================
packet                 UDP port  content
====================== ========= =====================================================================================
state, to Betaflight   9003      18 doubles: time (s), rates p q r (rad/s), acceleration (m/s^2), quaternion w x y z,
                                 velocity E N U (m/s), longitude latitude altitude, pressure (Pa)
channels, to it        9004      double time (s), 16 uint16: pulses of the transmitter's channels (us)
outputs, from it       9001      uint16 number of motors, 2 bytes of padding, 16 floats: pulses (us), motors first
====================== ========= =====================================================================================

Betaflight's body axes are x forward, y left, z up. It turns the signs of q and r, and of all accelerations. So rates go
out in our body axes (x forward, y right, z down), and accelerations with the sign of x turned. The quaternion turns our
body axes into N-E-D. Velocity and place serve a virtual GPS alone, which no mode of the CLI file uses: they are zero.

MSP is Betaflight's serial protocol: ``$M<``, length, command, data, and the exclusive-or of these bytes
(https://betaflight.com/docs/development/API/MSP-Extensions). The layouts and units are those of Betaflight 4.6; no code
is copied from it.
"""

from __future__ import annotations

import functools
import operator
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.model_state import ATTITUDE_SLICE
from mufly.sensors import Readings, Truth
from mufly.sensors.pressure import STANDARD_PRESSURE_PA

_STATE_STRUCT = struct.Struct("<d3d3d4d3d3dd")
_CHANNELS_STRUCT = struct.Struct("<d16H")
_OUTPUTS_STRUCT = struct.Struct("<H2x16f")
GAZEBO_PACKET_BYTES = 16
"""Size of the packets that Betaflight sends to port 9002, which carry four motors and no servo."""
PULSE_CENTRE_US, PULSE_HALF_RANGE_US, MIN_PULSE_US, MAX_PULSE_US = 1500.0, 500.0, 1000.0, 2000.0
_CHANNEL_COUNT = 16
_MSP_REQUEST_HEAD, _MSP_ANSWER_HEAD = b"$M<", b"$M>"
_MSP_STATUS_EX = 150
_MSP_BODY_OFFSET, _MSP_PAYLOAD_OFFSET = 3, 5  # from the start of an answer: size and command; the payload
_ARMING_FLAG_BYTES = 4
_MODE_BYTE_COUNT_OFFSET = 15  # of the status: number of further bytes of flight modes

ARMING_OBSTACLES = (
    "no gyro", "failsafe", "no receiver", "arm switch was on", "failsafe switch", "runaway take-off", "crash detected",
    "throttle not low", "not level", "boot grace time", "no pre-arm", "processor load", "calibrating", "CLI open",
    "menu open", "telemetry bus", "MSP connection", "paralysed", "GPS", "rescue switch", "ESC telemetry",
    "reboot required", "ESC timing", "accelerometer not calibrated", "motor protocol", "crash flip",
    "altitude hold switch", "position hold switch", "arm switch",
)  # fmt: skip
"""Betaflight's reasons not to arm, in the order of its bits."""


@dataclass(frozen=True, slots=True)
class BetaflightOutputs:
    """Motor and servo outputs that Betaflight sends to its simulator.

    Attributes
    ----------
    motor_count : int
    pulse_us : (16,) array
        Motors first, then servos; 0 where there is no output.
    """

    motor_count: int
    pulse_us: NDArray[np.float64]

    @property
    def vehicle_inputs(self) -> NDArray[np.float64]:
        """Inputs of the vehicle by the mixer DUALCOPTER: upper and lower motor (0..1), servo 1 and servo 2 (-1..1).

        The mixer's second motor speeds up for a turn to the right, as the upper motor of the vehicle does. The mixer's
        servos are pitch, nose down, and roll, right.
        """
        lower, upper, pitch, roll = self.pulse_us[:4]
        motors = (np.array([upper, lower]) - MIN_PULSE_US) / (MAX_PULSE_US - MIN_PULSE_US)
        return np.array(
            [*motors, (pitch - PULSE_CENTRE_US) / PULSE_HALF_RANGE_US, (roll - PULSE_CENTRE_US) / PULSE_HALF_RANGE_US]
        )


def decode_outputs(data: bytes) -> BetaflightOutputs | None:
    """Return the content of a packet of outputs; None if it is another packet."""
    if len(data) != _OUTPUTS_STRUCT.size:
        return None
    count, *pulses = _OUTPUTS_STRUCT.unpack(data)
    return BetaflightOutputs(count, np.nan_to_num(np.asarray(pulses, dtype=np.float64)))


def encode_state(time_s: float, truth: Truth, readings: Readings) -> bytes:
    """Return the packet of one instant: inertial readings and pressure of the sensors, and the true attitude.

    Parameters
    ----------
    time_s : float
        Simulated time, which Betaflight's clock follows (s).
    truth : Truth
    readings : Readings
        With ``rates`` and ``acceleration``.
    """
    ax, ay, az = readings["acceleration"].value
    pressure = readings.latest.get("pressure")
    return _STATE_STRUCT.pack(
        time_s, *readings["rates"].value, -ax, ay, az, *truth.state[ATTITUDE_SLICE], *[0.0] * 6,
        STANDARD_PRESSURE_PA if pressure is None or not pressure.valid else float(pressure.value),
    )  # fmt: skip


def encode_channels(time_s: float, pulse_us: NDArray[np.float64]) -> bytes:
    """Return the packet of the transmitter's channels (us), at most 16: roll, pitch, throttle, yaw, auxiliary ones."""
    pulses = np.full(_CHANNEL_COUNT, MIN_PULSE_US)
    pulses[: len(pulse_us)] = pulse_us
    return _CHANNELS_STRUCT.pack(time_s, *np.clip(np.rint(pulses), MIN_PULSE_US, MAX_PULSE_US).astype(int).tolist())


def encode_status_request() -> bytes:
    """Return the MSP request of the status."""
    body = bytes([0, _MSP_STATUS_EX])
    return _MSP_REQUEST_HEAD + body + bytes([functools.reduce(operator.xor, body)])


def decode_arming_refusals(data: bytes) -> list[str] | None:
    """Return the reasons against arming from an MSP answer; None until ``data`` contains a complete status message."""
    at = data.find(_MSP_ANSWER_HEAD)
    while at >= 0:
        head = data[at + _MSP_BODY_OFFSET : at + _MSP_PAYLOAD_OFFSET]
        end = at + _MSP_PAYLOAD_OFFSET + (head[0] if head else 0)
        body = data[at + _MSP_BODY_OFFSET : end]
        if len(head) < 2 or len(data) <= end:
            return None
        if head[1] == _MSP_STATUS_EX and functools.reduce(operator.xor, body) == data[end]:
            payload = body[2:]
            flags_at = _MODE_BYTE_COUNT_OFFSET + 1 + (payload[_MODE_BYTE_COUNT_OFFSET] & 15) + 1
            flags = int.from_bytes(payload[flags_at : flags_at + _ARMING_FLAG_BYTES], "little")
            return [name for k, name in enumerate(ARMING_OBSTACLES) if flags >> k & 1]
        at = data.find(_MSP_ANSWER_HEAD, at + 1)
    return None
