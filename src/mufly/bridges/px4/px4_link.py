"""Simulator of PX4: lockstep over TCP, as PX4's module ``simulator_mavlink`` speaks it.

PX4 calls the simulator. Its clock follows the time in HIL_SENSOR, so PX4 computes as long as it needs, and the
simulation waits for its answer, HIL_ACTUATOR_CONTROLS with the same time. While PX4 starts it does not answer, and the
simulation runs in real time. A PX4 built without lockstep is served in real time throughout.

====================== ========================================================================================
state                  condition
====================== ========================================================================================
waiting                no PX4 is connected; the simulated time stands
starting               PX4 is connected and does not answer every period yet; real time
lockstep               every period waits for its answer
free-running           PX4 has no lockstep; real time
silent                 PX4 has not answered for SILENCE_TIMEOUT_S; the simulated time stands
====================== ========================================================================================

A PX4 that hangs up and calls again is a new one: the vehicle returns to the start. PX4 itself does not call again after
it has lost its simulator: it must be restarted.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.bridges.px4.px4_messages import (
    OUTPUT_COUNT,
    ActuatorCommand,
    PositionSource,
    SensorMessageEncoder,
    decode_actuator_command,
)
from mufly.bridges.simulator_pace import SILENCE_TIMEOUT_S, AutopilotSimulator
from mufly.link.codec import FrameDecoder, FrameEncoder, GlobalOrigin, MavMessage, mavlink
from mufly.link.ports import Endpoint, Peer, open_port

PX4_ENDPOINT = Endpoint("tcpin", "127.0.0.1", 4560)
"""Address where PX4 calls its simulator."""
PX4_RATE_HZ = 250.0
"""Rate of HIL_SENSOR, which PX4's start-up script for simulators expects (IMU_INTEG_RATE)."""
DEFAULT_ORIGIN = GlobalOrigin(47.3977, 8.5456, 488.0)
"""Global position of N = E = D = 0 (deg, m): the start that PX4's own simulators use."""
ANSWER_TIMEOUT_S = 1.0
"""Wall-clock time without an answer after which one further period is sent (s)."""
NO_CALL_TIMEOUT_S = 10.0
"""Wall-clock time without a connection after which a warning is logged (s)."""
_RECEIVE_TIMEOUT_S = 0.05
_FIRST_ANSWER_TIMEOUT_S = 0.02  # while PX4 starts
_START_ANSWER_TIMEOUT_S = 0.2  # while PX4 starts, if it has answered the previous period
_PERIODS_BEFORE_LOCKSTEP = 50  # answered in a row, after which the lockstep begins
_PERIODS_BETWEEN_TRUTHS = 5
_PERIODS_BETWEEN_CHECKS = 250  # of one check of rates and outputs
_ANSWERS_PER_PERIOD_TOLERANCE = 1.2  # answers to a period
_SKIPS_BEFORE_RATE_WARNING = 3  # skipped periods with an answer after each
_MAX_GARBAGE_BYTES = 500
_EQUAL_OUTPUT_TOLERANCE, _ACTIVE_OUTPUT_THRESHOLD = 0.02, 0.05  # of outputs


class Px4Simulator(AutopilotSimulator):
    """Simulator of a vehicle that one instance of PX4 flies.

    Parameters
    ----------
    vehicle : AutopilotPlant
        With a rate of :data:`PX4_RATE_HZ`.
    endpoint : Endpoint
        Address where PX4 calls.
    position : "vision" or "gps"
    origin : GlobalOrigin
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

    # Of the present PX4; _forget_autopilot sets them
    _time_us: int
    _periods: int
    _answer_count: int
    _skip_count: int
    _answered_in_a_row: int
    _truth_periods: int
    _was_answered: bool
    _skipped: bool
    _noise_reported: bool

    def __init__(
        self,
        vehicle: AutopilotPlant,
        *,
        endpoint: Endpoint = PX4_ENDPOINT,
        position: PositionSource = "vision",
        origin: GlobalOrigin = DEFAULT_ORIGIN,
        speed: float = 1.0,
        where: str = "endpoint",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(vehicle, open_port(endpoint, where), speed, clock)
        self._settings = (vehicle.vehicle, position, origin)
        self._decoder, self._encode = FrameDecoder(keep_duplicates=True), FrameEncoder(1, 200)
        self._peer: Peer | None = None
        self._waiting_since_s = clock()
        self._forget_autopilot()

    def _log_waiting_for_autopilot(self) -> None:
        self.vehicle.log_event(f"waiting for PX4 at {self.port.endpoint}")

    def _simulate_period(self, stop: Callable[[], bool]) -> None:
        self._receive_messages()
        if self._peer is None:
            self._wait_for_message(_RECEIVE_TIMEOUT_S)
            if self._clock() - self._waiting_since_s > NO_CALL_TIMEOUT_S:
                self._waiting_since_s = math.inf
                self.vehicle.log_event(
                    f"no PX4 has connected for {NO_CALL_TIMEOUT_S:g} s of wall-clock time; a PX4 that has lost its "
                    "simulator does not connect again: restart PX4",
                    "warning",
                )
        else:
            self._run_period(stop)

    # One period

    def _run_period(self, stop: Callable[[], bool]) -> None:
        vehicle = self.vehicle
        self._send_sensors()
        if self.state in ("lockstep", "silent"):
            self._await_answer(stop)
        begun_s = self._clock()
        while self._peer is not None and not stop():
            time_to_next_period_s = self.pace.time_to_next_period_s(in_real_time=self.state != "lockstep")
            if self.state == "starting" and self._command is not None and not self._is_answered:
                patience_s = _START_ANSWER_TIMEOUT_S if self._answered_in_a_row else _FIRST_ANSWER_TIMEOUT_S
                time_to_next_period_s = max(time_to_next_period_s, begun_s + patience_s - self._clock())
            if time_to_next_period_s <= 0.0:
                break
            self._wait_for_message(time_to_next_period_s)
            self._receive_messages()
        if self._peer is None or stop():
            return
        if self.state == "starting":
            self._answered_in_a_row = self._answered_in_a_row + 1 if self._is_answered else 0
            if self._answered_in_a_row >= _PERIODS_BEFORE_LOCKSTEP:
                self._begin_lockstep()
        self.pace.record_period()
        self._periods += 1
        self.lockstep_period_count += self.state == "lockstep"
        vehicle.advance_period(
            np.zeros(4) if self._command is None else self._command.vehicle_inputs,
            self._command is not None and self._command.is_armed,
        )
        if self._periods % _PERIODS_BETWEEN_CHECKS == 0:
            self._check_outputs()
        self.on_period()

    def _send_sensors(self) -> None:
        vehicle = self.vehicle
        self._time_us = round((self._periods + 1) * vehicle.period_s * 1e6)
        messages: list[MavMessage] = []
        if self._periods % self._truth_periods == 0:
            force = vehicle.sensors.sensors[0].error_free_readings(vehicle.truth)["acceleration"]
            messages.append(self._sensors.encode_truth(self._time_us, vehicle.truth, force))
        messages += self._sensors.encode_readings(self._time_us, vehicle.readings)
        self.port.send_frame(self._peer, b"".join(self._encode(m) for m in messages))

    def _await_answer(self, stop: Callable[[], bool]) -> None:
        """Wait for PX4's answer to the last HIL_SENSOR.

        After a timeout, continue without an answer if PX4 answered the previous message.
        """
        begun_s = self._clock()
        while not self._is_answered and self._peer is not None and not stop():
            self._wait_for_message(_RECEIVE_TIMEOUT_S)
            self._receive_messages()
            waited_s = self._clock() - begun_s
            if self._was_answered and not self._is_answered and waited_s > ANSWER_TIMEOUT_S:
                self.unanswered_count += 1
                self._was_answered = False
                self._skipped = True
                return
            if self.state != "silent" and waited_s > SILENCE_TIMEOUT_S:
                self.state = "silent"
                self.vehicle.log_event(
                    f"PX4 has not answered for {SILENCE_TIMEOUT_S:g} s of wall-clock time; the simulation waits for it",
                    "warning",
                )
        if not self._is_answered:
            return
        if self.state == "silent":
            self.state = "lockstep"
            self.vehicle.log_event("PX4 answers again")
            self.pace.restart_period_timing()
        if self._skipped and not self._was_answered:
            self._skip_count += 1
            if self._skip_count == _SKIPS_BEFORE_RATE_WARNING:
                self.vehicle.log_event(
                    f"PX4 answers only some of the periods; set IMU_GYRO_RATEMAX and IMU_INTEG_RATE to "
                    f"{1.0 / self.vehicle.period_s:g} Hz or more",
                    "warning",
                )
        self._was_answered = True

    @property
    def _is_answered(self) -> bool:
        return self._command is not None and self._command.time_us >= self._time_us

    # Messages of PX4

    def _receive_messages(self) -> None:
        for peer, data in self.port.receive_bytes():
            if peer != self._peer:
                self._register_autopilot(peer)
            for message in self._decoder.decode_bytes(self._clock(), peer, data):
                self._handle_message(message)
            counts = self._decoder.packet_counts(peer)
            if not counts.received_count and counts.garbage_bytes > _MAX_GARBAGE_BYTES and not self._noise_reported:
                self._noise_reported = True
                self.vehicle.log_event(f"{peer.address} sends no MAVLink messages; connect PX4 instead", "warning")
        gone = self._peer is not None and self._peer not in self.port.reachable_peers
        if gone:
            self._decoder.forget_peer(self._peer)
            self._peer, self.state, self._waiting_since_s = None, "waiting", self._clock()
            self.vehicle.log_event("PX4 has closed the connection; the simulation waits for a new one", "warning")
        if self._peer is None:
            for peer in self.port.reachable_peers:
                self._register_autopilot(peer)

    def _register_autopilot(self, peer: Peer) -> None:
        if self._peer is not None:
            self.vehicle.log_event("another PX4 has connected and replaces the first one", "warning")
        self._peer, self.state = peer, "starting"
        self.vehicle.log_event(f"PX4 has connected from {peer.address}")
        self._forget_autopilot()
        if self.vehicle.has_been_armed:
            self.vehicle.reset()
        self.pace.restart_period_timing()

    def _forget_autopilot(self) -> None:
        self._sensors = SensorMessageEncoder(*self._settings)
        self._command: ActuatorCommand | None = None
        self._time_us = 0
        self._periods = 0
        self._answer_count = 0
        self._skip_count = 0
        self._answered_in_a_row = 0
        self._truth_periods = _PERIODS_BETWEEN_TRUTHS
        self._was_answered = False
        self._skipped = False
        self._noise_reported = False
        self.vehicle.allow_repeated_warnings()

    def _handle_message(self, message: MavMessage) -> None:
        kind = message.get_type()
        if kind == "HIL_ACTUATOR_CONTROLS":
            self._answer_count += 1
            self._command = decode_actuator_command(message)
            if self.state == "starting" and not self._command.has_lockstep:
                self.state = "free-running"
                self.vehicle.log_event("PX4 was built without lockstep; the simulation runs in real time", "warning")
        elif (
            kind == "COMMAND_LONG"
            and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            and int(message.param1) == mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
            and message.param2 > 0
        ):
            self._truth_periods = max(1, math.ceil(message.param2 * 1e-6 / self.vehicle.period_s - 1e-6))

    def _begin_lockstep(self) -> None:
        self.state, self._answer_count, self._was_answered = "lockstep", 0, True
        self.vehicle.log_event("PX4 runs in lockstep")
        self.pace.restart_period_timing()

    # Checks of its outputs

    def _check_outputs(self) -> None:
        answers, self._answer_count = self._answer_count, 0
        command = self._command
        if command is None:
            return
        if self.state == "lockstep" and answers > _ANSWERS_PER_PERIOD_TOLERANCE * _PERIODS_BETWEEN_CHECKS:
            self.vehicle.warn_once(
                "rate",
                f"PX4 sends {answers / _PERIODS_BETWEEN_CHECKS:.1f} answers a period; set IMU_GYRO_RATEMAX to "
                f"{1.0 / self.vehicle.period_s:g} Hz",
            )
        if self.state == "free-running" and answers < _PERIODS_BETWEEN_CHECKS / _ANSWERS_PER_PERIOD_TOLERANCE:
            rate_Hz = answers / _PERIODS_BETWEEN_CHECKS / self.vehicle.period_s
            self.vehicle.warn_once(
                "rate", f"PX4 sends its outputs at {rate_Hz:.0f} Hz, less often than the sensors' rate"
            )
        if problem := describe_wrong_outputs(command):
            self.vehicle.warn_once("airframe", problem)


def describe_wrong_outputs(command: ActuatorCommand) -> str:
    """Return why the outputs do not match a coaxial helicopter with two motors and two servos; an empty text if they
    match.
    """
    remedy = "load the airframe file of `mufly autopilot gains px4`"
    u: Any = command.outputs
    if not command.is_armed:
        return ""
    if not np.isfinite(u).all():
        return f"PX4's outputs are not finite numbers; {remedy}"
    if np.any(np.abs(u[OUTPUT_COUNT:]) > _ACTIVE_OUTPUT_THRESHOLD):
        return f"PX4 drives more than {OUTPUT_COUNT} outputs, so it uses another airframe; {remedy}"
    motors, servos = u[:2], u[2:OUTPUT_COUNT]
    if np.all(servos > _ACTIVE_OUTPUT_THRESHOLD) and np.ptp(u[:OUTPUT_COUNT]) < _EQUAL_OUTPUT_TOLERANCE:
        return f"PX4 drives outputs 1 to {OUTPUT_COUNT} alike, as a quadrotor; {remedy}"
    if np.all(motors == 0.0) and np.any(np.abs(servos) > _ACTIVE_OUTPUT_THRESHOLD):
        return f"PX4 is armed and outputs 1 and 2 are off; {remedy}"
    return ""
