"""A scripted PX4: the conduct of its module simulator_mavlink, and of its cascades, as a peer of the simulator.

Source: https://docs.px4.io/main/en/simulation/#simulator-mavlink-api, and the messages that PX4 1.16 alpha exchanged
with the simulator. It calls by TCP, asks for HIL_STATE_QUATERNION, and answers each HIL_SENSOR with
HIL_ACTUATOR_CONTROLS of the same time. It flies on the true state, which PX4 does not, with PX4's control law.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable

import numpy as np

from mufly.link.codec import FrameDecoder, FrameEncoder, mavlink

Outputs = tuple[float, ...]


class ScriptedPx4:
    """PX4 in a thread: ``law(time_s, message)`` returns whether it is armed, and its outputs.

    ``message`` is the last HIL_STATE_QUATERNION. ``answer_every`` skips answers, ``copies`` repeats them.
    """

    def __init__(
        self,
        port: int,
        law: Callable[[float, object], tuple[bool, Outputs]],
        *,
        lockstep: bool = True,
        answer_every: int = 1,
        copies: int = 1,
    ) -> None:
        self.line = socket.create_connection(("127.0.0.1", port), 5.0)
        # As PX4 does. Without it an answer may wait for the simulator's next message, and every answer is one late.
        self.line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._law, self._flags, self._every, self._copies = law, int(lockstep), answer_every, copies
        self.times_us: list[int] = []
        self.messages: dict[str, list] = {}
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self.line.shutdown(socket.SHUT_RDWR)
        self._thread.join(5.0)
        self.line.close()

    def _run(self) -> None:
        encode, decode = FrameEncoder(1, 1), FrameDecoder(keep_duplicates=True)
        self.line.sendall(encode(mavlink.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3)))
        interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        wanted = mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION
        self.line.sendall(encode(mavlink.MAVLink_command_long_message(0, 0, interval, 0, wanted, 4e3, 0, 0, 0, 0, 0)))
        state = None
        while True:
            try:
                data = self.line.recv(65536)
            except OSError:
                return
            if not data:
                return
            for message in decode.decode_bytes(time.monotonic(), "simulator", data):
                self.messages.setdefault(message.get_type(), []).append(message)
                if message.get_type() == "HIL_STATE_QUATERNION":
                    state = message
                if message.get_type() != "HIL_SENSOR":
                    continue
                self.times_us.append(message.time_usec)
                if len(self.times_us) > 300 and len(self.times_us) % self._every:
                    continue
                armed, outputs = self._law(message.time_usec * 1e-6, state)
                controls = [*outputs, *[0.0] * (16 - len(outputs))]
                mode = 1 | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
                out = mavlink.MAVLink_hil_actuator_controls_message(message.time_usec, controls, mode, self._flags)
                try:
                    self.line.sendall(b"".join(encode(out) for _ in range(self._copies)))
                except OSError:
                    return


def idle(time_s: float, state: object) -> tuple[bool, Outputs]:
    """A disarmed PX4."""
    return False, ()


class CascadeLaw:
    """PX4's cascades with the parameters of an airframe file, in its own order and signs; arms at 0.5 s."""

    def __init__(self, parameters: dict[str, float], target: tuple[float, float, float], origin) -> None:
        self.p, self.target, self._origin = parameters, np.array(target), origin
        self.speed_integral, self.rate_integral = np.zeros(3), np.zeros(3)
        self.speed_before, self.slope = None, np.zeros(3)

    def __call__(self, time_s: float, state) -> tuple[bool, Outputs]:
        p = self.p
        if time_s < 0.5 or state is None:
            return False, ()
        dt, g = 0.004, 9.81
        place = np.array(self._origin.to_local(state.lat * 1e-7, state.lon * 1e-7, state.alt * 1e-3))
        speed = np.array([state.vx, state.vy, state.vz]) * 0.01
        rates = np.array([state.rollspeed, state.pitchspeed, state.yawspeed])
        w, x, y, z = state.attitude_quaternion
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        level, up = "XY", "Z"
        wanted = (self.target - place) * [p["MPC_XY_P"], p["MPC_XY_P"], p["MPC_Z_P"]]
        wanted = np.clip(wanted, [-1.0, -1.0, -0.6], [1.0, 1.0, 0.5])
        gain = np.array([[p[f"MPC_{a}_VEL_{k}_ACC"] for a in (level, level, up)] for k in "PID"])
        change = speed - (speed if self.speed_before is None else self.speed_before)
        self.speed_before = speed
        self.slope += 0.12 * (change / dt - self.slope)  # low pass of 5 Hz
        error = wanted - speed
        acceleration = gain[0] * error + self.speed_integral - gain[2] * self.slope
        flying = place[2] < -0.15
        self.speed_integral += gain[1] * error * dt * flying
        ahead = math.cos(yaw) * acceleration[0] + math.sin(yaw) * acceleration[1]
        aside = -math.sin(yaw) * acceleration[0] + math.cos(yaw) * acceleration[1]
        angle = np.clip(np.array([aside, -ahead]) / g, -0.35, 0.35)
        throttle = float(np.clip(p["MPC_THR_HOVER"] * (1.0 - acceleration[2] / g), 0.2, 1.0))
        throttle *= min(1.0, (time_s - 0.5) / p["COM_SPOOLUP_TIME"])
        turn = np.array(
            [
                p["MC_ROLL_P"] * (angle[0] - roll),
                p["MC_PITCH_P"] * (angle[1] - pitch),
                p["MC_YAW_P"] * math.remainder(-yaw, 2 * math.pi),
            ]
        )
        torque = np.empty(3)
        for k, axis in enumerate(("ROLL", "PITCH", "YAW")):
            wrong = turn[k] - rates[k]
            if flying:
                self.rate_integral[k] += p[f"MC_{axis}RATE_I"] * wrong * dt
            self.rate_integral[k] = np.clip(self.rate_integral[k], -0.15, 0.15)
            torque[k] = p[f"MC_{axis}RATE_P"] * wrong + self.rate_integral[k]
        servos = []
        for k in range(2):
            at = math.radians(p[f"CA_SP0_ANG{k}"])
            servos.append(float(np.clip(math.cos(at) * torque[1] - math.sin(at) * torque[0], -1.0, 1.0)))
        motors = np.clip([throttle - torque[2], throttle + torque[2]], 0.0, 1.0)
        return True, (*map(float, motors), *servos)
