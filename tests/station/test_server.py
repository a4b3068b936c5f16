"""The station at work with real sockets on the loopback address."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time

import pytest
from free_ports import free_port
from mock_vehicle import MockVehicle

from mufly.errors import InputError
from mufly.link import Endpoint, parse_endpoint
from mufly.station import GroundStation, ground_station
from mufly.station.ground_station import choose_telemetry_rate


class Caller:
    """A mock vehicle with a socket."""

    def __init__(self, port, **about):
        self.mock = MockVehicle(**about)
        self.line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.line.setblocking(False)
        self.line.connect(("127.0.0.1", port))

    def serve(self):
        now_s = time.monotonic()
        try:
            while True:
                self.mock.receive(now_s, self.line.recv(4096))
        except (BlockingIOError, ConnectionRefusedError):
            pass
        for data in self.mock.step(now_s):
            with contextlib.suppress(ConnectionRefusedError):
                self.line.send(data)


async def until(callers, condition, seconds=8.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"it did not come in {seconds} s"
        for caller in callers:
            caller.serve()
        await asyncio.sleep(0.005)


def test_two_endpoints_two_vehicles_one_station(tmp_path):
    ports = [free_port(), free_port()]
    station = GroundStation([f"udp:127.0.0.1:{p}" for p in ports], folder=tmp_path)
    callers = [Caller(p, parameters={"A": (float(k), 9)}) for k, p in enumerate(ports)]

    async def work():
        await station.start()
        await until(callers, lambda: len(station.vehicles) == 2 and all(v.parameters for v in station.vehicles))
        request = station.vehicles[0].arm()
        await until(callers, lambda: request.is_done)
        assert request.outcome.value == "accepted"
        await until(callers, lambda: all(v.station_context.is_recording for v in station.vehicles))
        assert station.vehicles[0].station_context.free_disk_bytes > 0
        await until(callers, lambda: all(len(v.history) for v in station.vehicles))
        # Motion is wished for a hundred times a second.
        await until(callers, lambda: all(any(m.command == 511 for m in c.mock.commands) for c in callers))
        wishes = [m.param2 for c in callers for m in c.mock.commands if m.command == 511 and m.param1 == 30]
        assert wishes[0] == pytest.approx(1e4)
        await station.stop()

    asyncio.run(work())
    assert sorted(c.mock.armed for c in callers) == [False, True]
    assert [v.color for v in station.vehicles] == [0, 1]
    assert (station.recorder.path / "station-2.mcap").exists()


def test_a_port_that_is_taken_is_told_and_nothing_stays_open(tmp_path):
    port, other = free_port(), free_port()

    async def work():
        first = GroundStation([f"udp:127.0.0.1:{port}"], record=False)
        await first.start()
        second = GroundStation([f"udp:127.0.0.1:{other}", f"udp:127.0.0.1:{port}"], folder=tmp_path)
        with pytest.raises(InputError, match=str(port)):
            await second.start()
        third = GroundStation([f"udp:127.0.0.1:{other}"], record=False)
        await third.start()
        await third.stop()
        await first.stop()

    asyncio.run(work())
    assert not list(tmp_path.iterdir())


def test_an_endpoint_that_is_none_is_refused_before_anything_is_opened():
    with pytest.raises(InputError):
        GroundStation(["udp:here"])


def test_a_fault_in_the_loop_is_told_and_the_station_goes_on(tmp_path):
    port = free_port()
    station = GroundStation([f"udp:127.0.0.1:{port}"], record=False)
    caller = Caller(port)

    async def work():
        await station.start()
        await until([caller], lambda: station.vehicles)
        step, faults = station._step_links, [RuntimeError("broken")]
        station._step_links = lambda now_s: (_ for _ in ()).throw(faults.pop()) if faults else step(now_s)
        await until([caller], lambda: station.notices)
        assert "broken" in station.notices[-1][1]
        request = station.vehicles[0].arm()
        await until([caller], lambda: request.is_done)
        await station.stop()

    asyncio.run(work())


def test_a_fault_is_told_once_and_ever_new_ones_not_for_ever():
    station = GroundStation(["udp:127.0.0.1:14550"], record=False)
    for text in ("broken", "broken", *map(str, range(150))):
        with station._contain_faults():
            raise RuntimeError(text)
    assert [text for _, text in station.notices if "broken" in text] == [
        "internal error, the station continues (RuntimeError: broken)"
    ]
    assert len(station.notices) == 100


def test_it_answers_when_something_comes_and_sleeps_in_between(monkeypatch):
    """With half a minute between its steps it still meets a vehicle at once."""
    monkeypatch.setattr(ground_station, "STEP_PERIOD_S", 30.0)
    port = free_port()
    station, caller = GroundStation([f"udp:127.0.0.1:{port}"], record=False), Caller(port)

    async def work():
        await station.start()
        await until([caller], lambda: station.vehicles and station.vehicles[0].parameters)
        await station.stop()

    asyncio.run(work())


def test_it_calls_by_itself_at_its_own_pace(monkeypatch):
    """Heartbeats to whom nothing was heard from, and no step more than is due."""
    monkeypatch.setattr(ground_station, "HEARTBEAT_PERIOD_S", 0.03)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        vehicle.setblocking(False)
        station = GroundStation([f"udpout:127.0.0.1:{vehicle.getsockname()[1]}"], record=False)
        steps, step = [], station._step_links
        station._step_links = lambda now_s: (steps.append(now_s), step(now_s))
        heard = []

        def beats():
            with contextlib.suppress(BlockingIOError):
                heard.append(vehicle.recv(1000))
            return len(heard) >= 4

        async def work():
            await station.start()
            began = time.monotonic()
            await until([], beats)
            assert len(steps) <= 2 + (time.monotonic() - began) / ground_station.STEP_PERIOD_S
            await station.stop()

        asyncio.run(work())


class Radio:
    """A port that nobody can watch."""

    def __init__(self, endpoint):
        self.endpoint, self.reachable_peers, self.sent, self.closed = endpoint, ["it"], [], False
        self.mock, self.told = MockVehicle(), ["the radio is warm"]

    def fileno(self):
        return -1

    def receive_bytes(self):
        for data in self.sent:
            self.mock.receive(time.monotonic(), data)
        self.sent = []
        return [("it", data) for data in self.mock.step(time.monotonic())]

    def send_frame(self, peer, data):
        self.sent.append(data)

    def take_notices(self):
        told, self.told = self.told, []
        return told

    def close(self):
        self.closed = True


def test_a_port_without_a_descriptor_is_asked_again_and_again(monkeypatch):
    monkeypatch.setattr(ground_station, "open_port", Radio)
    station = GroundStation(["serial:/dev/ttyUSB0:57600"], record=False)

    async def work():
        await station.start()
        (radio,) = station.open_ports
        await until([], lambda: station.vehicles and station.vehicles[0].parameters and station.notices)
        assert station.notices[0][1] == "the radio is warm"
        await station.stop()
        assert radio.closed
        assert station.open_ports == []

    asyncio.run(work())


def test_over_a_slow_line_less_is_asked():
    assert choose_telemetry_rate(parse_endpoint("udp:127.0.0.1:14550", "station")) == 100.0
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 57_600)) == pytest.approx(7.7, abs=0.1)
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 921_600)) == 100.0
    assert choose_telemetry_rate(Endpoint("serial", "/dev/ttyUSB0", 300)) == 1.0
