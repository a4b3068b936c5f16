r"""Simulator of ArduPilot: its JSON interface over UDP.

ArduPilot sends a packet and waits for its answer, so that both run in lockstep
(https://github.com/ArduPilot/ardupilot/tree/master/libraries/SITL/examples/JSON)::

    to the simulator    uint16 magic, uint16 frame_rate, uint32 frame_count, uint16 pwm[16 or 32], little endian
    to ArduPilot        one line: {"timestamp": s, "imu": {"gyro": [...], "accel_body": [...]}, "position": [...],
                        "attitude": [...], "velocity": [...], "rng_1": m, "battery": {"voltage": V, "current": A}}\n

Inertial readings, sonar and battery are those of the vehicle's sensors, with their faults. ArduPilot makes GPS,
pressure and magnetometer itself from position, attitude and velocity, which are true values here. So faults of the
vehicle's position fix, pressure sensor and magnetometer have no effect.

The frame is ArduPilot's "CoaxCopter" (FRAME_CLASS 8): two motors of fixed pitch on one mast (outputs 5 and 6), roll and
pitch by surfaces (outputs 1 to 4, opposite ones mirrored), which are the swash plate here. Its helicopter frames need a
collective pitch and a constant rotor speed, which this vehicle lacks.
"""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.bridges.simulator_pace import SILENCE_TIMEOUT_S, AutopilotSimulator
from mufly.link.ports import Endpoint, Peer, open_port

ARDUPILOT_ENDPOINT = Endpoint("udpin", "127.0.0.1", 9002)
"""Address where ArduPilot sends to its simulator."""
ARDUPILOT_RATE_HZ = 400.0
"""Rate of the simulation: the loop rate of ArduPilot's copters."""
ROLL_OUTPUT, PITCH_OUTPUT, ROLL_MIRROR_OUTPUT, PITCH_MIRROR_OUTPUT, UPPER_OUTPUT, LOWER_OUTPUT = range(6)
"""Outputs of ArduPilot's CoaxCopter; the fifth one is the motor that yaws right."""
_CHANNELS_BY_MAGIC = {18458: 16, 29569: 32}
_SERVO_HEAD_STRUCT = struct.Struct("<HHI")
_PULSE_CENTRE_US, _PULSE_HALF_RANGE_US, _MIN_PULSE_US = 1500.0, 500.0, 1000.0
_MIRROR_TOLERANCE_US = 40.0  # largest difference of mirrored outputs from their mean
_MIN_SPINNING_MOTOR_INPUT = 0.01
_RECEIVE_TIMEOUT_S = 0.05
_MAX_FIRST_FRAME = 10  # of an ArduPilot that has just started
_REPLY_DIGITS = 9
_SENSORS_NOT_SENT = ("position_fix", "pressure", "magnetometer")


@dataclass(frozen=True, slots=True)
class ServoPacket:
    """Packet with the actuator pulses that ArduPilot sends.

    Attributes
    ----------
    rate_Hz : int
        Rate that ArduPilot asks for.
    frame : int
        Number of the packet since its start.
    pulse_us : (16,) or (32,) array
        Outputs.
    """

    rate_Hz: int
    frame: int
    pulse_us: NDArray[np.float64]

    @property
    def vehicle_inputs(self) -> NDArray[np.float64]:
        """Inputs of the vehicle from these pulses: upper and lower motor (0..1), servo 1 and servo 2 (-1..1)."""
        p = self.pulse_us
        motors = (p[[UPPER_OUTPUT, LOWER_OUTPUT]] - _MIN_PULSE_US) / (2.0 * _PULSE_HALF_RANGE_US)
        roll, pitch = (p[[ROLL_OUTPUT, PITCH_OUTPUT]] - _PULSE_CENTRE_US) / _PULSE_HALF_RANGE_US
        return np.array([*motors, -pitch, roll])

    @property
    def is_autopilot_started(self) -> bool:
        """Whether ArduPilot commands the outputs; they are zero while ArduPilot starts."""
        return bool(np.all(self.pulse_us[: LOWER_OUTPUT + 1] > 0.0))


def decode_servo_packet(data: bytes) -> ServoPacket | None:
    """Return the content of a packet; None if it is no packet of ArduPilot."""
    if len(data) < _SERVO_HEAD_STRUCT.size:
        return None
    magic, rate, frame = _SERVO_HEAD_STRUCT.unpack_from(data)
    count = _CHANNELS_BY_MAGIC.get(magic)
    if count is None or len(data) != _SERVO_HEAD_STRUCT.size + 2 * count:
        return None
    return ServoPacket(rate, frame, np.frombuffer(data, "<u2", count, _SERVO_HEAD_STRUCT.size).astype(np.float64))


def encode_state(vehicle: AutopilotPlant, start_s: float) -> bytes:
    """Return the vehicle's state as a packet for ArduPilot; ``start_s`` is the time at which ArduPilot started (s)."""
    truth, readings = vehicle.truth, vehicle.readings

    def round_numbers(values: Any) -> list[float]:
        return [round(float(v), _REPLY_DIGITS) for v in values]

    state: dict[str, Any] = {
        "timestamp": round(truth.time_s - start_s, 6),
        "imu": {
            "gyro": round_numbers(readings["rates"].value),
            "accel_body": round_numbers(readings["acceleration"].value),
        },
        "position": round_numbers(truth.position),
        "attitude": round_numbers([*truth.attitude[:2], math.remainder(truth.attitude[2], 2.0 * math.pi)]),
        "velocity": round_numbers(truth.velocity),
    }
    if "ground_distance" in readings and readings["ground_distance"].valid:
        state["rng_1"] = round(float(readings["ground_distance"].value), 4)
    if "battery_voltage" in readings and "battery_current" in readings:
        state["battery"] = {
            "voltage": round(float(readings["battery_voltage"].value), 4),
            "current": round(float(readings["battery_current"].value), 4),
        }
    # ArduPilot's parser wants a space after the commas of a list.
    return (json.dumps(state) + "\n").encode()


class ArduPilotSimulator(AutopilotSimulator):
    """Simulator of a vehicle that one instance of ArduPilot flies.

    Parameters
    ----------
    vehicle : AutopilotPlant
        With a rate of :data:`ARDUPILOT_RATE_HZ`.
    endpoint : Endpoint
        Address where ArduPilot sends.
    speed : float
        Simulated seconds per second of wall-clock time; 0: as fast as possible.
    where : str
        Source of the endpoint, for error messages.
    clock : callable
        Wall clock (s).

    Raises
    ------
    InputError
        If the port is in use.
    """

    def __init__(
        self,
        vehicle: AutopilotPlant,
        *,
        endpoint: Endpoint = ARDUPILOT_ENDPOINT,
        speed: float = 1.0,
        where: str = "endpoint",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(vehicle, open_port(endpoint, where), speed, clock)
        self._heard_s = clock()
        self._start_s = 0.0
        self._last: ServoPacket | None = None
        self._reply = b""

    def _log_waiting_for_autopilot(self) -> None:
        self.vehicle.log_event(f"waiting for ArduPilot at {self.port.endpoint}")
        self.vehicle.warn_of_unseen_faults(
            lambda name: name not in _SENSORS_NOT_SENT, "ArduPilot simulates this sensor itself"
        )

    def _simulate_period(self, stop: Callable[[], bool]) -> None:
        self._wait_for_message(_RECEIVE_TIMEOUT_S)
        for peer, data in self.port.receive_bytes():
            self._answer_servo_packet(peer, data, stop)
        if self.state == "lockstep" and self._clock() - self._heard_s > SILENCE_TIMEOUT_S:
            self.state = "silent"
            self.vehicle.log_event(
                f"ArduPilot has sent nothing for {SILENCE_TIMEOUT_S:g} s of wall-clock time; the simulation waits",
                "warning",
            )

    def _answer_servo_packet(self, peer: Peer, data: bytes, stop: Callable[[], bool]) -> None:
        packet = decode_servo_packet(data)
        if packet is None:
            self.vehicle.warn_once(
                "packet", f"{peer.address} sends packets that are not ArduPilot's; close that program"
            )
            return
        self._heard_s = self._clock()
        if self.state == "silent" and self._last is not None and packet.frame >= self._last.frame:
            self.vehicle.log_event("ArduPilot sends again")
            self.pace.restart_period_timing()
        last = self._last
        if last is None or packet.frame < last.frame:
            self._begin_session(peer, packet.frame, again=last is not None)
        elif packet.frame == last.frame:  # its answer was lost
            self.port.send_frame(peer, self._reply)
            return
        elif packet.frame > last.frame + 1:
            self.unanswered_count += packet.frame - last.frame - 1
        self._last, self.state = packet, "lockstep"
        self._check_channels(packet)
        while (time_to_next_period_s := self.pace.time_to_next_period_s()) > 0.0 and not stop():
            time.sleep(min(time_to_next_period_s, _RECEIVE_TIMEOUT_S))
        self.pace.record_period()
        inputs = packet.vehicle_inputs if packet.is_autopilot_started else np.zeros(4)
        self.vehicle.advance_period(inputs, bool(np.any(inputs[:2] > _MIN_SPINNING_MOTOR_INPUT)))
        self.lockstep_period_count += 1
        self._reply = encode_state(self.vehicle, self._start_s)
        self.port.send_frame(peer, self._reply)
        self.on_period()

    def _begin_session(self, peer: Peer, frame: int, *, again: bool) -> None:
        if not again and frame > _MAX_FIRST_FRAME:
            self.vehicle.log_event(
                f"ArduPilot sends from {peer.address}, at its packet {frame}: it ran with an earlier simulator, and "
                "the vehicle is at its start; disarm ArduPilot or restart it",
                "warning",
            )
        else:
            self.vehicle.log_event(f"ArduPilot {'has restarted' if again else 'sends'} from {peer.address}")
        self.vehicle.allow_repeated_warnings()
        if self.vehicle.has_been_armed:
            self.vehicle.reset()
        self._start_s = self.vehicle.time_s
        self.pace.restart_period_timing()

    def _check_channels(self, packet: ServoPacket) -> None:
        rate_Hz = 1.0 / self.vehicle.period_s
        if abs(packet.rate_Hz - rate_Hz) > 1.0:
            self.vehicle.warn_once(
                "rate",
                f"ArduPilot asks for {packet.rate_Hz} Hz, the simulation has {rate_Hz:g} Hz; set SIM_RATE_HZ to it",
            )
        if problem := describe_wrong_channels(packet):
            self.vehicle.warn_once("frame", problem)


def describe_wrong_channels(packet: ServoPacket) -> str:
    """Return why the outputs do not match ArduPilot's frame CoaxCopter; an empty text if they match."""
    if not packet.is_autopilot_started:
        return ""
    pairs = ((ROLL_OUTPUT, ROLL_MIRROR_OUTPUT), (PITCH_OUTPUT, PITCH_MIRROR_OUTPUT))
    if any(
        abs(float(packet.pulse_us[[a, b]].sum()) - 2.0 * _PULSE_CENTRE_US) > 2.0 * _MIRROR_TOLERANCE_US
        for a, b in pairs
    ):
        return (
            "ArduPilot's outputs 1 to 4 are not mirrored, so it uses another frame; load the file of "
            "`mufly autopilot gains ardupilot` (FRAME_CLASS 8)"
        )
    return ""
