"""A vehicle with the whole simulation behind it, and mock stations, all on one clock that the test steps."""

from __future__ import annotations

import math

from mufly.control import design_flight_controller
from mufly.flight import Flight
from mufly.link import (
    FrameDecoder,
    FrameEncoder,
    MissionItem,
    MissionReceiver,
    MissionSender,
    VehicleLink,
    encode_transfer_message,
    parse_transfer_message,
)
from mufly.link import mavlink as m
from mufly.mission import Mission, parse_mission
from mufly.vehicle import load_vehicle

EMPTY = {"name": "no mission"}
_DESIGNS: dict[str, object] = {}


def new_flight(tables=EMPTY, vehicle="mufly-1.1", **options) -> Flight:
    """A flight; the control design is computed once."""
    if vehicle not in _DESIGNS:
        _DESIGNS[vehicle] = design_flight_controller(load_vehicle(vehicle))
    return Flight(load_vehicle(vehicle), _mission(tables), controller=_DESIGNS[vehicle], keep=False, **options)


def _mission(tables):
    return parse_mission(dict(tables)) if "waypoint" in tables else Mission(**tables)


class Station:
    """A mock ground station: says what the test wants, keeps what it hears."""

    def __init__(self, rig, peer, system=255, component=190, there=None, back=None):
        self.rig, self.peer = rig, peer
        self.there, self.back = there, back
        self.encode = FrameEncoder(system, component)
        self.codec = FrameDecoder()
        self.heard = []
        self.alive = True
        self.every = []  # messages that are said 20 times a second
        self.giver = self.taker = None
        self._beat_s = self._said_s = -math.inf

    # saying

    def say(self, message):
        data = self.encode(message)
        if self.there is None:
            self.rig.link.process_bytes(self.rig.now_s, self.peer, data)
        else:
            self.there.send(self.rig.now_s, data)

    def command(self, number, *p, confirmation=0, target=1):
        p = (*p, *[0.0] * (7 - len(p)))
        self.say(m.MAVLink_command_long_message(target, 1, number, confirmation, *p))

    def command_int(self, number, *p, frame=1, x=0, y=0, z=0.0):
        p = (*p, *[0.0] * (4 - len(p)))
        self.say(m.MAVLink_command_int_message(1, 1, frame, number, 0, 0, *p, x, y, z))

    def mode(self, main, sub=0):
        self.command(m.MAV_CMD_DO_SET_MODE, 1, main, sub)

    def upload(self, items, mission_type=0):
        self.giver = MissionSender(self.peer, items, mission_type=mission_type)
        self._notes(self.giver.start_transfer(self.rig.now_s))

    def download(self, mission_type=0):
        got = []
        self.taker = MissionReceiver(lambda items: got.append(items) or 0, mission_type=mission_type)
        self._notes(self.taker.request_items(self.rig.now_s, self.peer))
        return got

    def _notes(self, notes):
        for _, note in notes:
            self.say(encode_transfer_message(note, 1, 1))

    def live(self):
        """What a station does by itself."""
        now_s = self.rig.now_s
        if not self.alive:
            return
        if now_s - self._beat_s >= 1.0:
            self._beat_s = now_s
            self.say(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if now_s - self._said_s >= 0.05:
            self._said_s = now_s
            for message in self.every:
                self.say(message)
        for machine in (self.giver, self.taker):
            if machine is not None:
                self._notes(machine.take_due_messages(now_s))

    # hearing

    def hear(self, data):
        if not self.alive:
            return
        for message in self.codec.decode_bytes(self.rig.now_s, "vehicle", data):
            self.heard.append(message)
            note = parse_transfer_message(message)
            if note is not None and self.giver is not None:
                self._notes(self.giver.handle_message(self.rig.now_s, note))
            if note is not None and self.taker is not None:
                self._notes(self.taker.handle_message(self.rig.now_s, self.peer, note))

    def all(self, kind):
        return [x for x in self.heard if x.get_type() == kind]

    def last(self, kind):
        return next((x for x in reversed(self.heard) if x.get_type() == kind), None)

    @property
    def text(self):
        """All lines, long ones put together."""
        return (
            "\n".join(("" if x.chunk_seq else "\n") + x.text if x.id else "\n" + x.text for x in self.all("STATUSTEXT"))
            .replace("\n\n", "\n")
            .strip()
        )

    @property
    def words(self):
        """All that was said, in one piece."""
        return "".join(x.text if x.id and x.chunk_seq else " | " + x.text for x in self.all("STATUSTEXT"))

    @property
    def acks(self):
        return [(a.command, a.result) for a in self.all("COMMAND_ACK")]


class Rig:
    """Flight, link and stations."""

    def __init__(self, tables=EMPTY, origin=None, **options):
        self.flight = new_flight(tables, **options)
        self.now_s = 100.0
        self.link = VehicleLink(self.flight, origin=origin)
        self.stations = []
        self.sent = 0

    def station(self, peer="gcs", system=255, component=190, there=None, back=None):
        station = Station(self, peer, system, component, there, back)
        self.stations.append(station)
        return station

    @property
    def status(self):
        return self.flight.autopilot.status

    @property
    def position(self):
        return self.flight.status.truth.position

    def tick(self):
        for station in self.stations:
            station.live()
            if station.there is not None:
                for data in station.there.arrived(self.now_s):
                    self.link.process_bytes(self.now_s, station.peer, data)
        self.flight.step_period()
        for out in self.link.take_due_frames(self.now_s):
            self.sent += 1
            for station in self.stations:
                if out.peer == station.peer:
                    if station.back is None:
                        station.hear(out.data)
                    else:
                        station.back.send(self.now_s, out.data)
        for station in self.stations:
            if station.back is not None:
                for data in station.back.arrived(self.now_s):
                    station.hear(data)
        self.now_s += self.flight.period_s

    def run(self, seconds, until=None):
        """Go on for ``seconds`` of the vehicle's time, or until something is so; returns whether it is."""
        for _ in range(round(seconds / self.flight.period_s)):
            self.tick()
            if until is not None and until():
                return True
        return until is None

    def airborne(self, station, height=1.0):
        """Arm and take off through the link."""
        self.run(0.1)
        station.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.run(0.1)
        station.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height)
        assert self.run(15.0, lambda: self.status.state == "hover"), station.words


def waypoint(n, e, d, wait=0.0, heading=math.nan, command=16, frame=1):
    """An item in metres."""
    return MissionItem(0, frame, command, params=(wait, 0.0, 0.0, heading), x=round(n * 1e4), y=round(e * 1e4), z=d)
