"""A ground station at the link of a board on this machine, for tests."""

from __future__ import annotations

import os

os.environ.setdefault("MAVLINK20", "1")

from pymavlink.dialects.v20 import common as mavlink

from mufly.firmware.emulated import HostBoard


class Station:
    """A ground station at the link of a board on this machine; periods pass as it waits."""

    def __init__(self, library, system=255) -> None:
        self.ffi, self.lib = library
        self.board = HostBoard(*library)
        self.codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
        self.codec.robust_parsing = True
        self.decode = mavlink.MAVLink(None)
        self.decode.robust_parsing = True
        self.heard, self.k = [], 0
        self.period, self.request = self.ffi.new("board_period_t *"), self.ffi.new("board_request_t *")

    def send(self, message):
        self.feed(message.pack(self.codec))

    def feed(self, data):
        for at in range(0, max(1, len(data)), 64):
            self.step(data[at : at + 64])

    def step(self, data=b""):
        self.k += 1
        self.period.time_s = 0.005 * self.k
        self.board.compute_estimate(self.period)
        self.board.compute_control(self.request)
        self.heard += self.decode.parse_buffer(self.board.exchange_bytes(data)) or []

    def wait_for(self, kind, periods=50):
        for _ in range(periods):
            for k, m in enumerate(self.heard):
                if m.get_type() == kind:
                    del self.heard[k]
                    return m
            self.step()
        raise AssertionError(f"no {kind}")

    def command(self, number, *params, system=None, confirmation=0):
        if system is not None:
            self.codec.srcSystem = system
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, confirmation, *params, *[0.0] * (7 - len(params))))
        return self.wait_for("COMMAND_ACK").result


def mission_item(seq, command, x=0.0, y=0.0, z=-1.0, frame=1, p1=0.0, p4=float("nan")):
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, seq, frame, command, 0, 1, p1, 0.0, 0.0, p4, round(x * 1e4), round(y * 1e4), z
    )
