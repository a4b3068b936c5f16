"""Fly the simulated helicopter with pymavlink: parameters, a mission, take-off, a go-to in metres, landing.

In one terminal ``mufly link``, in another::

    python docs/examples/fly_with_pymavlink.py                      # or: ... udpin:127.0.0.1:14551

pymavlink hands you the messages and nothing more, so this is also what the protocols look like on the wire.
"""

from __future__ import annotations

import os

os.environ["MAVLINK20"] = "1"  # before pymavlink is imported, or it packs MAVLink 1

import sys
import time
from collections.abc import Callable
from typing import Any

from pymavlink import mavutil

mavlink = mavutil.mavlink
PATIENCE_S = 45.0
POSITION_ONLY = 0x0DF8  # type_mask of a set-point that gives x, y and z alone


class Vehicle:
    """The helicopter, asked and answered."""

    def __init__(self, url: str) -> None:
        self.link = mavutil.mavlink_connection(url, source_system=255, source_component=190)
        if self.link.wait_heartbeat(timeout=PATIENCE_S) is None:
            raise SystemExit(f"no vehicle at {url}; is `mufly link` running?")
        self._beat_s = 0.0

    def wait(
        self,
        names: str | list[str],
        that: Callable[[Any], bool] = lambda m: True,
        seconds: float = PATIENCE_S,
    ) -> Any:
        """Return the first message that fits; say that we are here meanwhile, as the vehicle expects once a second."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.beat()
            message = self.link.recv_match(type=names, blocking=True, timeout=0.2)
            if message is not None and that(message):
                return message
        raise TimeoutError(f"no {names} in {seconds:g} s")

    def beat(self) -> None:
        """Heartbeat of a ground station; without it the vehicle holds and lands after a while."""
        if time.monotonic() - self._beat_s > 1.0:
            self._beat_s = time.monotonic()
            self.link.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def command(self, command: int, *parameters: float) -> int:
        """Send a command, again if need be; return the answer (MAV_RESULT)."""
        filled = [*parameters, *([0.0] * (7 - len(parameters)))]
        for attempt in range(5):
            self.link.mav.command_long_send(1, 1, command, attempt, *filled)
            try:
                return int(self.wait("COMMAND_ACK", lambda m: m.command == command, 2.0).result)
            except TimeoutError:
                continue
        raise TimeoutError(f"command {command} was never answered")

    def ask(self, command: int, *parameters: float) -> None:
        """Send a command that has to be accepted."""
        result = self.command(command, *parameters)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise RuntimeError(f"command {command} refused: {mavlink.enums['MAV_RESULT'][result].name}")

    def fetch(
        self,
        send: Callable[[], Any],
        names: str | list[str],
        that: Callable[[Any], bool] = lambda m: True,
    ) -> Any:
        """Send a request until its answer comes: UDP loses packets, and MAVLink has whoever asks ask again."""
        for _ in range(20):
            send()
            try:
                return self.wait(names, that, 2.0)
            except TimeoutError:
                continue
        raise TimeoutError(f"no {names} was ever sent")

    # parameters

    def parameters(self) -> dict[str, tuple[float, int]]:
        """All of them: value and type by name."""
        found: dict[int, Any] = {}
        message = self.fetch(lambda: self.link.mav.param_request_list_send(1, 1), "PARAM_VALUE")
        while True:
            if message.param_index < message.param_count:
                found[message.param_index] = message
            if len(found) == message.param_count:
                return {m.param_id: (m.param_value, m.param_type) for m in found.values()}
            try:
                message = self.wait("PARAM_VALUE", seconds=2.0)
            except TimeoutError:  # some were lost
                lost = next(k for k in range(message.param_count) if k not in found)
                message = self.fetch(
                    lambda k=lost: self.link.mav.param_request_read_send(1, 1, b"", k),
                    "PARAM_VALUE",
                    lambda m, k=lost: m.param_index == k,
                )

    def set_parameter(self, name: str, value: float, kind: int) -> float:
        """Set one; return the value now in force."""
        for _ in range(5):
            self.link.mav.param_set_send(1, 1, name.encode(), value, kind)
            try:
                return float(self.wait("PARAM_VALUE", lambda m: m.param_id == name, 2.0).param_value)
            except TimeoutError:
                continue
        raise TimeoutError(f"{name} was never answered")

    # missions

    def upload(self, places: list[tuple[float, float, float]]) -> int:
        """Give it waypoints N, E, D in metres; return its word (MAV_MISSION_RESULT)."""
        answers = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
        m = self.fetch(lambda: self.link.mav.mission_count_send(1, 1, len(places)), answers)
        while True:
            if m.get_type() == "MISSION_ACK":
                return int(m.type)
            north, east, down = places[m.seq]
            self.link.mav.mission_item_int_send(
                1, 1, m.seq, mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_CMD_NAV_WAYPOINT, int(m.seq == 0), 1,
                0.5, 0.0, 0.0, float("nan"), round(north * 1e4), round(east * 1e4), down,
            )  # fmt: skip
            m = self.wait(answers)

    def download(self) -> list[tuple[float, float, float]]:
        """Fetch its waypoints."""
        mav, places = self.link.mav, []
        count = self.fetch(lambda: mav.mission_request_list_send(1, 1), "MISSION_COUNT").count
        for seq in range(count):
            m = self.fetch(
                lambda seq=seq: mav.mission_request_int_send(1, 1, seq),
                "MISSION_ITEM_INT",
                lambda m, seq=seq: m.seq == seq,
            )
            places.append((m.x * 1e-4, m.y * 1e-4, m.z))
        self.link.mav.mission_ack_send(1, 1, mavlink.MAV_MISSION_ACCEPTED)
        return places

    def clear(self) -> int:
        """Take its mission away."""
        return int(self.fetch(lambda: self.link.mav.mission_clear_all_send(1, 1), "MISSION_ACK").type)

    # flight

    def go_to(self, north: float, east: float, down: float) -> None:
        """Fly somewhere by set-points: a stream of them, then offboard mode, until it is there."""
        end_s = time.monotonic() + PATIENCE_S
        offboard = False
        while time.monotonic() < end_s:
            self.link.mav.set_position_target_local_ned_send(
                0, 1, 1, mavlink.MAV_FRAME_LOCAL_NED, POSITION_ONLY, north, east, down, *([0.0] * 8)
            )
            if not offboard:
                # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, PX4's main mode 6: offboard
                self.link.mav.command_long_send(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 6, 0, 0, 0, 0, 0)
                offboard = True
            self.beat()
            m = self.link.recv_match(type="LOCAL_POSITION_NED", blocking=True, timeout=0.1)
            if m is not None and max(abs(m.x - north), abs(m.y - east), abs(m.z - down)) < 0.1:
                return
        raise TimeoutError("not there")


def fly(url: str) -> None:
    vehicle = Vehicle(url)
    print("connected", flush=True)

    parameters = vehicle.parameters()
    value, kind = parameters["MIS_TAKEOFF_ALT"]
    now = vehicle.set_parameter("MIS_TAKEOFF_ALT", 0.8, kind)
    print(f"{len(parameters)} parameters; take-off height was {value:.2f} m, is {now:.2f} m", flush=True)

    places = [(0.5, 0.0, -1.0), (0.5, 0.5, -1.0)]
    print(
        f"upload: {vehicle.upload(places)}, download: {vehicle.download()}, clear: {vehicle.clear()}",
        flush=True,
    )

    vehicle.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    nan = float("nan")
    vehicle.ask(mavlink.MAV_CMD_NAV_TAKEOFF, nan, nan, nan, nan, nan, nan, 0.8)
    vehicle.wait("LOCAL_POSITION_NED", lambda m: abs(m.z + 0.8) < 0.1 and abs(m.vz) < 0.1)
    print("in the air", flush=True)

    vehicle.go_to(0.5, 0.3, -1.0)
    print("at 0.5 m N, 0.3 m E, 1.0 m high", flush=True)

    vehicle.ask(mavlink.MAV_CMD_NAV_LAND)
    vehicle.wait("EXTENDED_SYS_STATE", lambda m: m.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)
    vehicle.wait("HEARTBEAT", lambda m: not m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    print("landed and disarmed", flush=True)


if __name__ == "__main__":
    fly(sys.argv[1] if len(sys.argv) > 1 else "udpin:127.0.0.1:14550")
