r"""Simulator of Betaflight's SITL: UDP packets in real time, and its configuration over MSP.

Betaflight 4.6 (https://betaflight.com/docs/development/SITL; source of the packets: its SITL target) exchanges::

    9001  from Betaflight   uint16 motors, float pwm[16]: motors, then servos (microseconds)
    9003  to Betaflight     18 doubles: time (s), rates (3, rad/s), minus specific force (3, m/s^2), quaternion (4),
                            velocity (3, m/s), position (3, m), pressure (Pa); forward, left, up for the force
    9004  to Betaflight     double time, uint16 channel[16] (microseconds): roll, pitch, throttle, yaw, AUX1, ...
    5761  TCP               MSP

Its mixer DUALCOPTER has two motors, whose difference yaws, and two servos for pitch and roll, as this vehicle has.
Betaflight flies rates and angles; throttle and position are a pilot's. It has no lockstep: its clock follows the times
in the packets, and both run in real time. Attitude comes from the packet, so it is true; rates and accelerations are
those of the vehicle's sensors.

Gains: Betaflight's numbers are those of :mod:`mufly.bridges.autopilot_gains` in its units (degrees, thousandths).
"""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mufly.bridges.autopilot_gains import AutopilotGains
from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.dynamics.model_state import ATTITUDE
from mufly.errors import MuflyError

BETAFLIGHT_RATE_HZ = 400.0
MSP_PORT, OUTPUT_PORT, STATE_PORT, STICKS_PORT = 5761, 9001, 9003, 9004
DUALCOPTER_MIXER = 20
MSP_VERSION, MSP_SET_MODE_RANGE, MSP_MIXER, MSP_SET_MIXER, MSP_STATUS = 1, 35, 42, 43, 150
MSP_SET_PID, MSP_CALIBRATE_ACC, MSP_SAVE = 202, 205, 250
ARM_MODE, ANGLE_MODE = 0, 1
CHANNEL_COUNT = 16
_STATE, _STICKS, _OUTPUTS = struct.Struct("<18d"), struct.Struct("<d16H"), struct.Struct("<Hxx16f")
_CENTRE_US, _HALF_US, _LEAST_US = 1500.0, 500.0, 1000.0
_MODE_STEP_US, _MODE_FIRST_US = 25, 900
# Betaflight's scales of P (per deg/s), I (per deg/s and s), D; of a motor's and of a servo's share.
_P_SCALE, _I_SCALE, _MOTOR_SCALE, _SERVO_SCALE = 0.032029, 0.244381, 1e-3, 0.7 / 500.0
_MAX_GAIN = 250


def betaflight_pids(gains: AutopilotGains) -> list[tuple[int, int, int]]:
    """Return P, I and D of roll, pitch, yaw, and of the level mode, in Betaflight's units."""

    def clip(value: float) -> int:
        return min(max(round(value), 0), _MAX_GAIN)

    out = []
    for axis, share in (("roll", _SERVO_SCALE), ("pitch", _SERVO_SCALE), ("yaw", _MOTOR_SCALE)):
        k = getattr(gains, axis)
        per_rad = math.degrees(1.0) * share
        out.append((clip(k.rate / (_P_SCALE * per_rad)), clip(k.rate_integral / (_I_SCALE * per_rad)), 0))
    level = clip(10.0 * min(gains.roll.angle, gains.pitch.angle))
    return [*out, (level, level, 75)]


class MspClient:
    """Client of Betaflight's MultiWii Serial Protocol over TCP.

    Raises
    ------
    MuflyError
        If nobody answers.
    """

    def __init__(self, port: int = MSP_PORT, timeout_s: float = 5.0) -> None:
        end_s = time.monotonic() + timeout_s
        while True:
            try:
                self._line = socket.create_connection(("127.0.0.1", port), 1.0)
                break
            except OSError as error:
                if time.monotonic() > end_s:
                    raise MuflyError(
                        f"Betaflight does not answer at port {port} ({error.strerror or error}); start its SITL"
                    ) from error
                time.sleep(0.1)
        self._line.settimeout(timeout_s)

    def close(self) -> None:
        """Close the connection: Betaflight does not arm while a configurator is connected."""
        self._line.close()

    def request(self, command: int, content: bytes = b"") -> bytes:
        """Send a command and return the content of its answer."""
        body = bytes([len(content), command]) + content
        self._line.sendall(b"$M<" + body + bytes([_xor(body)]))
        head = self._read(5)
        if head[:3] != b"$M>":
            raise MuflyError(f"Betaflight refuses MSP command {command}")
        answer = self._read(head[3])
        if self._read(1)[0] != _xor(head[3:] + answer):
            raise MuflyError(f"the answer of Betaflight to MSP command {command} is damaged")
        return answer

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            try:
                part = self._line.recv(size - len(data))
            except OSError as error:
                raise MuflyError("Betaflight stopped answering MSP") from error
            if not part:
                raise MuflyError("Betaflight closed its MSP connection")
            data += part
        return data


def _xor(data: bytes) -> int:
    out = 0
    for byte in data:
        out ^= byte
    return out


def configure_betaflight(client: MspClient, gains: AutopilotGains) -> None:
    """Set mixer, modes and gains, and save them; they act after a restart of Betaflight.

    AUX1 above 1700 microseconds arms; the level mode is always on. The accelerometers are calibrated, so the vehicle
    must stand while :class:`BetaflightLink` steps.
    """
    client.request(MSP_SET_MIXER, bytes([DUALCOPTER_MIXER, 0]))
    for index, (mode, least_us) in enumerate(((ARM_MODE, 1700), (ANGLE_MODE, _MODE_FIRST_US))):
        steps = [(us - _MODE_FIRST_US) // _MODE_STEP_US for us in (least_us, 2100)]
        client.request(MSP_SET_MODE_RANGE, bytes([index, mode, 0, *steps]))
    client.request(MSP_SET_PID, bytes([g for row in betaflight_pids(gains) for g in row] + [40, 0, 0]))
    client.request(MSP_CALIBRATE_ACC)


class BetaflightLink:
    """Exchange of packets between the plant and one Betaflight, a period at a time.

    Parameters
    ----------
    vehicle : AutopilotPlant
        With a rate of :data:`BETAFLIGHT_RATE_HZ`.

    Attributes
    ----------
    pulse_us : (4,) array
        Last outputs: two motors, two servos.
    answer_count : int
        Packets of outputs received.

    Raises
    ------
    MuflyError
        If another program listens at the port of the outputs.
    """

    def __init__(self, vehicle: AutopilotPlant) -> None:
        self.vehicle = vehicle
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._in.bind(("127.0.0.1", OUTPUT_PORT))
        except OSError as error:
            raise MuflyError(f"cannot listen at UDP port {OUTPUT_PORT} ({error.strerror or error})") from error
        self._in.setblocking(False)
        self.pulse_us: NDArray[np.float64] = np.array([_LEAST_US, _LEAST_US, _CENTRE_US, _CENTRE_US])
        self.answer_count = 0

    def close(self) -> None:
        """Close the sockets."""
        self._out.close()
        self._in.close()

    def step_period(self, channels_us: Sequence[float] | None) -> None:
        """Send the present state and the pilot's channels, take the last outputs, and advance by one period.

        Without channels (None) no sticks are sent: Betaflight forgets a receiver that it meets while it starts.
        """
        self.send_state(channels_us)
        self.receive_outputs()
        inputs = self.inputs
        self.vehicle.advance_period(inputs, bool(np.any(inputs[:2] > 0.0)))

    @property
    def inputs(self) -> NDArray[np.float64]:
        """Motor upper, motor lower (0..1), servo 1, servo 2 (-1..1)."""
        lower, upper = (self.pulse_us[:2] - _LEAST_US) / (2.0 * _HALF_US)  # the second one yaws right
        servos = np.where(self.pulse_us[2:] > 0.0, self.pulse_us[2:], _CENTRE_US)  # zero until they are driven
        pitch, roll = (servos - _CENTRE_US) / _HALF_US
        return np.array([upper, lower, pitch, roll])

    def send_state(self, channels_us: Sequence[float] | None) -> None:
        """Send readings, attitude and the pilot's channels (microseconds)."""
        truth, readings = self.vehicle.truth, self.vehicle.readings
        p, q, r = readings["rates"].value
        x, y, z = readings["acceleration"].value
        pressure = float(readings["pressure"].value) if "pressure" in readings else 101_325.0
        state = (
            truth.time_s, p, q, r, -x, y, z, *truth.state[ATTITUDE], *truth.velocity, *truth.position, pressure,
        )  # fmt: skip
        self._out.sendto(_STATE.pack(*(float(v) for v in state)), ("127.0.0.1", STATE_PORT))
        if channels_us is None:
            return
        channels = [round(c) for c in channels_us] + [round(_LEAST_US)] * (CHANNEL_COUNT - len(channels_us))
        self._out.sendto(_STICKS.pack(truth.time_s, *channels), ("127.0.0.1", STICKS_PORT))

    def receive_outputs(self) -> None:
        """Take the last packet of outputs, if one has come."""
        while True:
            try:
                data = self._in.recv(1024)
            except BlockingIOError:
                return
            if len(data) == _OUTPUTS.size:
                motors, *pulses = _OUTPUTS.unpack(data)
                if motors == 2:
                    self.pulse_us = np.array(pulses[:4])
                self.answer_count += 1
