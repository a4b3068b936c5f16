"""The simulator of ArduPilot against a scripted peer, by the documentation of its JSON interface."""

import json
import socket
import struct
import threading
import time

import numpy as np
import pytest

from mufly.bridges.ardupilot.ardupilot_link import ARDUPILOT_RATE_HZ, ArduPilotSimulator, decode_servo_packet
from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.link import parse_endpoint
from mufly.mission import Mission
from mufly.sensors.faults import parse_fault
from mufly.vehicle import load_vehicle

REST = (1500, 1500, 1500, 1500, 1000, 1000)


class Peer:
    """ArduPilot: sends a packet of outputs and waits for the answer."""

    def __init__(self, port: int) -> None:
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.connect(("127.0.0.1", port))
        self._line.settimeout(20.0)
        self.frame = 0

    def send(self, pulses, *, rate: int = 400, again: bool = False, magic: int = 18458) -> dict:
        if not again:
            self.frame += 1
        count = 32 if magic == 29569 else 16
        words = [*pulses, *[0] * (count - len(pulses))]
        self._line.send(struct.pack(f"<HHI{count}H", magic, rate, self.frame, *words))
        return json.loads(self._line.recv(65536))


@pytest.fixture
def session():
    events: list[str] = []
    over = threading.Event()
    faults = (parse_fault("pressure.jump=20@1s"),)
    with AutopilotPlant(
        load_vehicle("mufly-1.1"), Mission(name="hall"), rate_Hz=ARDUPILOT_RATE_HZ, autopilot="ArduPilot", keep=True,
        faults=faults,
    ) as vehicle:  # fmt: skip
        vehicle.listeners.append(lambda event: events.append(event.text))
        endpoint = parse_endpoint("udpin:127.0.0.1:0", "vehicle", least_port=0)
        simulator = ArduPilotSimulator(vehicle, endpoint=endpoint, speed=0.0)
        thread = threading.Thread(target=simulator.run, args=(over.is_set,), daemon=True)
        thread.start()
        yield simulator, events
        over.set()
        thread.join(10.0)
        assert not thread.is_alive()


def told(events, word):
    end = time.monotonic() + 20.0
    while not any(word in text for text in events):
        assert time.monotonic() < end, events
        time.sleep(0.01)


def test_a_packet_is_a_period_and_its_answer_is_the_state(session):
    simulator, _ = session
    peer = Peer(simulator.port.bound_port_number)
    first = peer.send(REST)
    assert first["timestamp"] == pytest.approx(1 / ARDUPILOT_RATE_HZ)
    for _ in range(99):
        state = peer.send(REST)
    assert state["timestamp"] == pytest.approx(100 / ARDUPILOT_RATE_HZ)
    assert state["imu"]["accel_body"][2] == pytest.approx(-9.81, abs=0.5)
    assert state["battery"]["voltage"] == pytest.approx(8.2, abs=0.3)
    assert state["rng_1"] > 0.0
    repeated = peer.send(REST, again=True)  # its answer was lost
    assert repeated == state
    assert simulator.lockstep_period_count == 100


def test_outputs_move_the_vehicle_as_a_coax_copter(session):
    simulator, events = session
    peer = Peer(simulator.port.bound_port_number)
    for _ in range(600):
        state = peer.send((1500, 1500, 1500, 1500, 1900, 1940))
    assert state["position"][2] < -0.075
    before = simulator.vehicle.truth.rates.copy()
    for _ in range(24):
        state = peer.send((1700, 1500, 1300, 1500, 1950, 1950))  # roll right
    assert state["imu"]["gyro"][0] > before[0] + 0.3
    before = simulator.vehicle.truth.rates.copy()
    for _ in range(24):
        peer.send((1500, 1700, 1500, 1300, 1990, 1600))  # nose up, yaw right
    assert simulator.vehicle.truth.rates[1] > before[1] + 0.3
    assert simulator.vehicle.truth.rates[2] > before[2] + 0.5
    assert not any("mirrored" in text for text in events)


def test_a_restarted_ardupilot_starts_anew(session):
    simulator, events = session
    peer = Peer(simulator.port.bound_port_number)
    for _ in range(300):
        peer.send((1500, 1500, 1500, 1500, 1900, 1900))
    peer.frame = 0
    state = peer.send(REST)
    told(events, "has restarted")
    told(events, "back at the start")
    assert state["timestamp"] == pytest.approx(1 / ARDUPILOT_RATE_HZ)
    assert abs(state["position"][2]) < 0.1


def test_an_ardupilot_that_outlived_its_simulator_is_named(session):
    simulator, events = session
    peer = Peer(simulator.port.bound_port_number)
    peer.frame = 5000
    state = peer.send((1500, 1500, 1500, 1500, 1700, 1730))
    told(events, "at its packet 5001: it ran with an earlier simulator")
    assert state["timestamp"] == pytest.approx(1 / ARDUPILOT_RATE_HZ)
    peer.send((1500, 1500, 1500, 1500, 1700, 1730))
    assert simulator.vehicle.is_armed
    assert simulator.unanswered_count == 0


def test_wrong_rate_frame_program_and_lost_packets_are_named(session):
    simulator, events = session
    peer = Peer(simulator.port.bound_port_number)
    peer.send((1100, 1100, 1100, 1100, 0, 0), rate=1200)
    told(events, "asks for 1200 Hz")
    peer.send((1300, 1300, 1300, 1300, 1100, 1100))
    told(events, "not mirrored")
    peer.frame += 3
    peer.send(REST)
    assert simulator.unanswered_count == 3
    other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    other.sendto(b"hello", ("127.0.0.1", simulator.port.bound_port_number))
    told(events, "not ArduPilot's")
    told(events, "has no effect")  # ArduPilot makes the pressure itself


def test_silence_is_named(session, monkeypatch):
    from mufly.bridges.ardupilot import ardupilot_link

    monkeypatch.setattr(ardupilot_link, "SILENCE_TIMEOUT_S", 0.2)
    simulator, events = session
    peer = Peer(simulator.port.bound_port_number)
    peer.send(REST)
    told(events, "has sent nothing")
    peer.send(REST)
    told(events, "sends again")


def test_a_packet_of_32_outputs_is_read_and_others_are_not():
    packet = decode_servo_packet(struct.pack("<HHI32H", 29569, 400, 7, *[1500] * 32))
    assert packet is not None
    assert packet.frame == 7
    assert packet.vehicle_inputs == pytest.approx(np.array([0.5, 0.5, 0.0, 0.0]))
    assert decode_servo_packet(struct.pack("<HHI16H", 1, 400, 7, *[1500] * 16)) is None
    assert decode_servo_packet(b"") is None
