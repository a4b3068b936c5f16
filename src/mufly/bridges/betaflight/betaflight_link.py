"""Simulator for Betaflight's software in the loop ("SITL") over UDP, with mufly's own simulated pilot.

Betaflight answers each state of the vehicle with at most one packet of outputs. The simulation waits for it, so both
run in lockstep; a lost packet is sent again. A state that comes while Betaflight starts can crash it. So states are
sent, and sent again, only after its serial port has been open for :data:`MIN_PORT_OPEN_TIME_S`.

Betaflight's clock follows the ratio of simulated to wall-clock time between the last two states. So states come at
even intervals, and a slow machine slows both down. Its loop has 8000 periods per simulated second, and sleeps 0.05 ms
or more in each; faster than real time it would miss some.

====================== ========================================================================================
state                  condition
====================== ========================================================================================
waiting                no Betaflight has answered; the simulated time stands
running                every period waits for its answer
silent                 Betaflight has not answered for SILENCE_TIMEOUT_S; the simulated time stands
====================== ========================================================================================

Inertial readings and pressure are those of the vehicle's sensors, with their faults. The SITL takes the attitude from
the simulator, which is the true one here; it has no further sensors, and no battery. A Betaflight with another address
is a restarted one: the vehicle returns to the start, and the pilot begins anew.

The outputs answer a state before Betaflight's filters have seen it: one more period of delay, of 2 ms at
:data:`BETAFLIGHT_RATE_HZ`. With the plant's own one and a half periods this is 5 ms, where the design of the gains
assumes 6 ms.
"""

from __future__ import annotations

import math
import socket
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.bridges.betaflight.betaflight_messages import (
    GAZEBO_PACKET_BYTES,
    MIN_PULSE_US,
    BetaflightOutputs,
    decode_arming_refusals,
    decode_outputs,
    encode_channels,
    encode_state,
    encode_status_request,
)
from mufly.bridges.betaflight.betaflight_pilot import REST_PULSES_US, BetaflightPilot
from mufly.bridges.betaflight.betaflight_settings import MOTOR_IDLE, PILOT_RATE_HZ
from mufly.bridges.simulator_pace import SILENCE_TIMEOUT_S, AutopilotSimulator
from mufly.errors import InputError
from mufly.link.ports import Endpoint, Peer, Port, UdpPort, open_port

BETAFLIGHT_ENDPOINT = Endpoint("udpout", "127.0.0.1", 9003)
"""Address where Betaflight receives the state of the vehicle."""
BETAFLIGHT_RATE_HZ = 500.0
"""Rate of the simulation."""
MIN_PORT_OPEN_TIME_S = 0.5
"""Wall-clock time that Betaflight's serial port has been open before it receives states (s)."""
START_TIMEOUT_S = 10.0
"""Wall-clock time that the port has been open without an answer, after which the start counts as failed (s)."""
ARMING_REFUSAL_TIMEOUT_S = 4.0
"""Simulated time of a refused arming after which Betaflight is asked for its reasons (s)."""
_PERIODS_PER_PILOT_COMMAND = round(BETAFLIGHT_RATE_HZ / PILOT_RATE_HZ)
_RESEND_PERIOD_S, _RECEIVE_TIMEOUT_S, _PORT_PROBE_PERIOD_S = 0.1, 0.02, 0.5
_ARMED_MOTOR_PULSE_US = MIN_PULSE_US + 500.0 * MOTOR_IDLE
_MAX_REAL_TIME_FACTOR = 1.0
_SERVO_PULSE_SLICE = slice(2, 4)  # of the outputs; the motors come before
_SENT_SENSORS = ("imu", "pressure")


class BetaflightPorts(NamedTuple):
    """Ports of Betaflight's simulator interface: actuator outputs and stick channels (UDP), status by MSP (TCP)."""

    outputs: int = 9001
    channels: int = 9004
    msp: int = 5761


class BetaflightSimulator(AutopilotSimulator):
    """Simulator of a vehicle that one instance of Betaflight flies.

    Parameters
    ----------
    vehicle : AutopilotPlant
        With a rate of :data:`BETAFLIGHT_RATE_HZ`.
    pilot : BetaflightPilot, optional
        Sender of the channels; without one another program sends them.
    endpoint : Endpoint
        Address where Betaflight receives the state.
    ports : BetaflightPorts
    speed : float
        Simulated seconds per second of wall-clock time, at most 1.
    where : str
        Source of the endpoint, for error messages.
    clock : callable
        Wall clock (s).

    Attributes
    ----------
    output_port : int
        Number of the UDP port where the outputs arrive.

    Raises
    ------
    InputError
        If a port is in use, or the speed is not between 0 and 1.
    """

    def __init__(
        self,
        vehicle: AutopilotPlant,
        pilot: BetaflightPilot | None = None,
        *,
        endpoint: Endpoint = BETAFLIGHT_ENDPOINT,
        ports: BetaflightPorts | None = None,
        speed: float = 1.0,
        where: str = "endpoint",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not 0.0 < speed <= _MAX_REAL_TIME_FACTOR:
            raise InputError(
                "speed", "", f"{speed:g} is too fast for Betaflight's loop",
                f"give a speed up to {_MAX_REAL_TIME_FACTOR:g}"
            )  # fmt: skip
        ports = ports or BetaflightPorts()
        listens = "127.0.0.1" if endpoint.host in ("127.0.0.1", "localhost") else "0.0.0.0"
        outputs = open_port(Endpoint("udpin", listens, ports.outputs), where)
        assert isinstance(outputs, UdpPort)
        super().__init__(vehicle, outputs, speed, clock)
        self.pilot, self.output_port = pilot, outputs.bound_port_number
        self._state_port = open_port(endpoint, where)
        self._channel_port = open_port(Endpoint("udpout", endpoint.host, ports.channels), where)
        self._msp_endpoint = Endpoint("tcp", endpoint.host, ports.msp)
        self._msp: Port | None = None
        self._msp_data = b""
        self._interval_s = vehicle.period_s / speed
        self._peer: Peer | None = None
        self._command: BetaflightOutputs | None = None
        self._is_answered = False
        self._refused_s = 0.0
        self._open_s = self._probed_s = math.nan

    def _log_waiting_for_autopilot(self) -> None:
        self.vehicle.log_event(f"waiting for Betaflight at {self._state_port.endpoint}")
        self.vehicle.warn_of_unseen_faults(_SENT_SENSORS.__contains__, "Betaflight does not receive this sensor")

    def _simulate_period(self, stop: Callable[[], bool]) -> None:
        if self.state == "waiting":
            if self._is_ready():
                self._send_state()
                self._check_start()
            self._wait_for_message(_RECEIVE_TIMEOUT_S)
            self._receive_outputs()
        else:
            self._run_period(stop)

    def _close_ports(self) -> None:
        for port in (self.port, self._state_port, self._channel_port, self._msp):
            if port is not None:
                port.close()

    # One period

    def _run_period(self, stop: Callable[[], bool]) -> None:
        vehicle = self.vehicle
        self._receive_outputs()  # answers to states that were sent twice
        self._is_answered, self._open_s = False, math.nan
        sent_s = self._clock()
        self._send_state()
        self._await_answer(sent_s, stop)
        while (
            time_to_next_period_s := max(self.pace.time_to_next_period_s(), sent_s + self._interval_s - self._clock())
        ) > 0.0 and not stop():
            time.sleep(min(time_to_next_period_s, _RECEIVE_TIMEOUT_S))
        if stop() or self.state != "running" or self._command is None:
            return
        self.pace.record_period()
        problem = describe_wrong_outputs(self._command)
        if problem:
            self.vehicle.warn_once("outputs", problem)
        inputs = np.zeros(4) if problem else self._command.vehicle_inputs
        is_armed = not problem and bool(np.all(self._command.pulse_us[:2] > _ARMED_MOTOR_PULSE_US))
        vehicle.advance_period(inputs, is_armed)
        self.lockstep_period_count += 1
        self._watch_arming(is_armed)
        self.on_period()

    def _send_state(self) -> None:
        """Send the vehicle's state and, every ``_PERIODS_PER_PILOT_COMMAND`` periods, the channels of the
        transmitter.
        """
        vehicle = self.vehicle
        if self.pilot is not None and self.lockstep_period_count % _PERIODS_PER_PILOT_COMMAND == 0:
            if self.state == "running":
                pulses = self.pilot.compute_channel_pulses(vehicle.truth, vehicle.readings, vehicle.is_armed)
            else:
                pulses = REST_PULSES_US
            for peer in self._channel_port.configured_targets:
                self._channel_port.send_frame(peer, encode_channels(vehicle.time_s, pulses))
        for peer in self._state_port.configured_targets:
            self._state_port.send_frame(peer, encode_state(vehicle.time_s, vehicle.truth, vehicle.readings))

    def _await_answer(self, begun_s: float, stop: Callable[[], bool]) -> None:
        again_s = begun_s + _RESEND_PERIOD_S
        while not self._is_answered and not stop():
            self._wait_for_message(_RECEIVE_TIMEOUT_S)
            self._receive_outputs()
            now_s = self._clock()
            if self.state == "running" and now_s - begun_s > SILENCE_TIMEOUT_S and not self._is_answered:
                self.state = "silent"
                self.vehicle.log_event(
                    f"Betaflight has not answered for {SILENCE_TIMEOUT_S:g} s of wall-clock time; "
                    "the simulation waits for it",
                    "warning",
                )
            if not self._is_answered and now_s >= again_s and self._is_ready():
                again_s = now_s + _RESEND_PERIOD_S
                self.unanswered_count += 1
                self._send_state()
        if self._is_answered and self.state == "silent":
            self.state = "running"
            self.vehicle.log_event("Betaflight answers again")
            self.pace.restart_period_timing()

    def _is_ready(self) -> bool:
        """Probe Betaflight's serial port; return whether it has been open for :data:`MIN_PORT_OPEN_TIME_S`."""
        now_s = self._clock()
        if not now_s - self._probed_s < _PORT_PROBE_PERIOD_S:
            self._probed_s = now_s
            try:
                socket.create_connection(
                    (self._msp_endpoint.host, self._msp_endpoint.port), timeout=_PORT_PROBE_PERIOD_S
                ).close()
            except OSError:
                self._open_s = math.nan
            else:
                self._open_s = now_s if math.isnan(self._open_s) else self._open_s
        return now_s - self._open_s >= MIN_PORT_OPEN_TIME_S

    def _check_start(self) -> None:
        """Warn if Betaflight has opened its port but answers no state, because its clock has not started to advance."""
        if self._clock() - self._open_s > START_TIMEOUT_S:
            self.vehicle.warn_once(
                "start", f"Betaflight's port is open, but it answers no state for {START_TIMEOUT_S:g} s; start it again"
            )

    # Packets of Betaflight

    def _receive_outputs(self) -> None:
        for peer, data in self.port.receive_bytes():
            outputs = decode_outputs(data)
            if outputs is None:
                what = (
                    "the packets of port 9002, which carry no servos; Betaflight's outputs are at 9001"
                    if len(data) == GAZEBO_PACKET_BYTES
                    else "packets that are not Betaflight's; close that program"
                )
                self.vehicle.warn_once("packet", f"{peer.address} sends {what}")
                continue
            if peer != self._peer:
                self._register_autopilot(peer)
            self._command, self._is_answered = outputs, True

    def _register_autopilot(self, peer: Peer) -> None:
        again, self._peer, self.state = self._peer is not None, peer, "running"
        self.vehicle.log_event(f"Betaflight {'has restarted' if again else 'answers'} from {peer.address}")
        self.vehicle.allow_repeated_warnings()
        self._refused_s = 0.0
        self._close_msp()
        if self.vehicle.has_been_armed:
            self.vehicle.reset()
        if self.pilot is not None:
            self.pilot.reset()
        self.pace.restart_period_timing()

    # Arming

    def _watch_arming(self, is_armed: bool) -> None:
        """Request and log Betaflight's reasons if it refuses to arm."""
        if self.pilot is None or is_armed or not self.pilot.wants_arming:
            self._refused_s = 0.0
            self._close_msp()
            return
        self._refused_s += self.vehicle.period_s
        if self._refused_s < ARMING_REFUSAL_TIMEOUT_S or self.vehicle.has_warned("arming"):
            return
        if self._msp is None:
            self._msp, self._msp_data = open_port(self._msp_endpoint), b""
        for _, data in self._msp.receive_bytes():
            self._msp_data += data
        obstacles = decode_arming_refusals(self._msp_data)
        if obstacles is None:
            if self.lockstep_period_count % round(BETAFLIGHT_RATE_HZ) == 0:
                for peer in self._msp.reachable_peers:
                    self._msp.send_frame(peer, encode_status_request())
            return
        reasons = [name for name in obstacles if name != "arm switch"] or obstacles
        self.vehicle.warn_once("arming", f"Betaflight does not arm: {', '.join(reasons) or 'it gives no reason'}")
        self._close_msp()

    def _close_msp(self) -> None:
        if self._msp is not None:
            self._msp.close()
            self._msp = None


def describe_wrong_outputs(outputs: BetaflightOutputs) -> str:
    """Return why the outputs do not match Betaflight's mixer DUALCOPTER; an empty text if they match."""
    remedy = "load the file of `mufly autopilot gains betaflight`"
    if outputs.motor_count != 2:
        return f"Betaflight drives {outputs.motor_count} motors, so its mixer is not DUALCOPTER; {remedy}"
    if np.any(outputs.pulse_us[_SERVO_PULSE_SLICE] <= 0.0):
        return "Betaflight drives no servos; build it with servos (make TARGET=SITL EXTRA_FLAGS=-DUSE_SERVOS)"
    return ""
