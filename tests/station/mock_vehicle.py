"""A vehicle that does what a test tells it, and a channel that treats packets as radios do; the clock is stepped."""

from __future__ import annotations

import heapq
import math
import random
import struct
from itertools import count

from mufly.link import (
    FrameDecoder,
    FrameEncoder,
    MissionAck,
    MissionClearAll,
    MissionReceiver,
    MissionRequestItem,
    MissionRequestList,
    MissionSender,
    encode_transfer_message,
    mavlink,
    parse_transfer_message,
)
from mufly.station import GroundLink


class Channel:
    """Carries datagrams one way; what it does to them follows from its seed."""

    def __init__(self, seed=0, loss=0.0, delay_s=0.0, doubles=0.0):
        self.random = random.Random(seed)
        self.loss, self.delay_s, self.doubles = loss, delay_s, doubles
        self.under_way, self.order = [], count()
        self.cut = False

    def send(self, now_s, data):
        for _ in range(1 + (self.random.random() < self.doubles)):
            if not self.cut and self.random.random() >= self.loss:
                due = now_s + self.delay_s * self.random.uniform(0.75, 1.25)
                heapq.heappush(self.under_way, (due, next(self.order), data))

    def arrived(self, now_s):
        while self.under_way and self.under_way[0][0] <= now_s:
            yield heapq.heappop(self.under_way)[2]


class MockVehicle:
    """Answers like a PX4 or ArduPilot; attributes say what it is and has."""

    def __init__(self, system=1, autopilot=12, vehicle_type=13, ours=False, parameters=None, rate_Hz=20.0):
        self.system, self.autopilot, self.vehicle_type, self.ours = system, autopilot, vehicle_type, ours
        self.parameters = dict(parameters or {"A": (1.5, 9)})
        self.rate_Hz = rate_Hz
        self.boot_s = 0.0
        self.armed = False
        self.custom_mode = 0
        self.refuse = {}  # command -> (result, text)
        self.silent_on = set()  # commands that are not answered
        self.commands = []  # (command, params or COMMAND_INT)
        self.capabilities = 0
        self.commander = None
        self.mission, self.mission_result = (), 0
        self.extra = []  # messages to be sent next
        self.codec, self.encode = FrameDecoder(), FrameEncoder(system, 1)
        self._receiver = MissionReceiver(self._take)
        self._sender = None
        self._due = {}
        self._out = []

    def _take(self, items):
        self.mission = self.mission if self.mission_result else items
        return self.mission_result

    def restart(self):
        self.boot_s = self._now_s

    def receive(self, now_s, data):
        self._now_s = now_s
        for m in self.codec.decode_bytes(now_s, "station", data):
            self._message(now_s, m)

    def _message(self, now_s, m):
        kind = m.get_type()
        who = (m.get_srcSystem(), m.get_srcComponent())
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            self.commands.append(m)
            if m.command in self.silent_on:
                return
            result, text = self.refuse.get(m.command, (0, ""))
            if text:
                self._out.append(mavlink.MAVLink_statustext_message(4, text.encode()))
            if result == 0:
                if m.command == 400:
                    self.armed = bool(m.param1)
                if m.command == 512 and m.param1 == 148:
                    self._out.append(self._version())
            self._out.append(mavlink.MAVLink_command_ack_message(m.command, result, 255, 0, *who))
        elif kind == "PARAM_REQUEST_LIST":
            self._out += [self._value(k) for k in range(len(self.parameters))]
        elif kind == "PARAM_REQUEST_READ":
            if 0 <= m.param_index < len(self.parameters):
                self._out.append(self._value(m.param_index))
        elif kind == "PARAM_SET" and m.param_id in self.parameters:
            old = self.parameters[m.param_id]
            if m.param_id not in self.refuse:
                self.parameters[m.param_id] = (m.param_value, old[1])
            self._out.append(self._value(list(self.parameters).index(m.param_id)))
        elif kind.startswith("MISSION_"):
            self._mission_message(now_s, parse_transfer_message(m), who)

    def _mission_message(self, now_s, note, who):
        notes = []
        if isinstance(note, MissionClearAll):
            self.mission = ()
            notes = [MissionAck(0)]
        elif isinstance(note, MissionRequestList):
            self._sender = MissionSender(who, self.mission, uploading=False)
            notes = [n for _, n in self._sender.start_transfer(now_s)]
        elif self._sender and isinstance(note, MissionRequestItem | MissionAck) and not self._receiver.is_busy:
            notes = [n for _, n in self._sender.handle_message(now_s, note)]
        elif note is not None:
            notes = [n for _, n in self._receiver.handle_message(now_s, who, note)]
        self._out += [encode_transfer_message(n, *who) for n in notes]

    def _value(self, k):
        name = list(self.parameters)[k]
        value, kind = self.parameters[name]
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), k)

    def _version(self):
        custom = list(b"mufly\0\0\0" if self.ours else bytes(8))
        return mavlink.MAVLink_autopilot_version_message(
            self.capabilities, 0, 0, 0, 0, custom, [0] * 8, [0] * 8, 0, 0, 0
        )

    def _every(self, now_s, name, period_s):
        if now_s >= self._due.get(name, -math.inf) - 1e-9:
            self._due[name] = now_s + period_s
            return True
        return False

    def step(self, now_s):
        self._now_s = now_s
        out, self._out = self._out + self.extra, []
        self.extra = []
        boot_ms = round((now_s - self.boot_s) * 1e3)
        if self._every(now_s, "beat", 1.0):
            mode = 1 | (128 if self.armed else 0)
            out.append(
                mavlink.MAVLink_heartbeat_message(self.vehicle_type, self.autopilot, mode, self.custom_mode, 4, 3)
            )
            if self.commander is not None:
                out.append(mavlink.MAVLink_named_value_int_message(boot_ms, b"command", self.commander))
        if self._every(now_s, "motion", 1.0 / self.rate_Hz):
            t = now_s - self.boot_s
            out.append(mavlink.MAVLink_attitude_message(boot_ms, 0.1, -0.1, math.remainder(t, math.tau), 0, 0, 1))
            out.append(mavlink.MAVLink_local_position_ned_message(boot_ms, t, 2.0, -1.0, 1.0, 0.0, 0.0))
        notes = self._receiver.take_due_messages(now_s)
        if self._sender:
            notes += self._sender.take_due_messages(now_s)
        out += [encode_transfer_message(n, *who) for who, n in notes]
        return [self.encode(m) for m in out]


BEGIN_S = 5000.0
"""What our clock says at the beginning: no clock begins at zero when somebody looks at it first."""


class World:
    """A station and vehicles on one link, over damaged channels; :meth:`run` steps all clocks."""

    def __init__(self, *vehicles, seed=0, us=(255, 190), **damage):
        self.t = BEGIN_S
        self.station = GroundLink(us)
        self.vehicles = list(vehicles)
        for vehicle in vehicles:
            vehicle.boot_s = BEGIN_S
        self.down = [Channel(seed + 2 * k, **damage) for k in range(len(vehicles))]
        self.up = [Channel(seed + 2 * k + 1, **damage) for k in range(len(vehicles))]

    def peer(self, k):
        return f"peer {k}"

    def run(self, seconds, until=None, step_s=0.01):
        """Step until a condition holds; returns how long that took, or fails if it never did."""
        begin = self.t
        while self.t < begin + seconds:
            self.t += step_s
            for k, vehicle in enumerate(self.vehicles):
                for data in self.up[k].arrived(self.t):
                    vehicle.receive(self.t, data)
                for data in vehicle.step(self.t):
                    self.down[k].send(self.t, data)
                for data in self.down[k].arrived(self.t):
                    self.station.process_bytes(self.t, self.peer(k), data)
            for peer, data in self.station.take_due_frames(self.t):
                self.up[int(str(peer).split()[1])].send(self.t, data)
            if until is not None and until():
                return self.t - begin
        assert until is None, f"it did not come in {seconds} s"
        return seconds

    @property
    def seen(self):
        return self.station.vehicles

    def answer(self, request, seconds=30.0):
        """Run until a request has its answer; return its outcome in words, and the answer."""
        self.run(seconds, lambda: request.is_done)
        return request.outcome.value, request.answer


def as_float(kind, number):
    """The bytes of an integer in a float field."""
    return struct.unpack("<f", struct.pack(kind, number))[0]
