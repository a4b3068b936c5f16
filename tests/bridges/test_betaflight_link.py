"""The simulator of Betaflight: against a scripted peer, and against the real program where there is one."""

import itertools
import math
import socket
import struct
import threading
import time

import numpy as np
import pytest
from betaflight_peer import GAINS, IDLE, REST, Peer, SerialPort

from mufly.bridges.autopilot_plant import AutopilotPlant, warm_up_plant
from mufly.bridges.betaflight import betaflight_link
from mufly.bridges.betaflight.betaflight_cli import find_betaflight, run_betaflight, send_cli_file
from mufly.bridges.betaflight.betaflight_link import (
    BETAFLIGHT_ENDPOINT,
    BETAFLIGHT_RATE_HZ,
    BetaflightPorts,
    BetaflightSimulator,
)
from mufly.bridges.betaflight.betaflight_messages import decode_arming_refusals, decode_outputs
from mufly.bridges.betaflight.betaflight_pilot import BetaflightPilot, PilotPlan, sample_square_path
from mufly.bridges.betaflight.betaflight_settings import convert_rate_gains, format_cli_file
from mufly.errors import InputError, MuflyError
from mufly.link import parse_endpoint
from mufly.link.ports import Endpoint
from mufly.mission import Mission
from mufly.sensors.faults import parse_fault
from mufly.vehicle import load_vehicle

WIND_M_S = 0.3
STARTS, ANSWER_S, FLIGHT_S = 5, 20.0, 300.0


class Session:
    """A simulator in a thread, with its peer and its events."""

    def __init__(self, vehicle: AutopilotPlant, serial_port: int | None = None) -> None:
        self.peer, self.events, self._over = Peer(), [], threading.Event()
        vehicle.listeners.append(lambda event: self.events.append(event.text))
        state, channels, serial = self.peer.ports
        self.simulator = BetaflightSimulator(
            vehicle, BetaflightPilot(GAINS), endpoint=parse_endpoint(f"udpout:127.0.0.1:{state}", "vehicle"),
            ports=BetaflightPorts(0, channels, serial_port or serial),
        )  # fmt: skip
        self.peer.output_port = self.simulator.output_port
        self._thread = threading.Thread(target=self.simulator.run, args=(self._over.is_set,), daemon=True)
        self._thread.start()

    def await_event(self, word: str) -> None:
        end = time.monotonic() + 20.0
        while not any(word in text for text in self.events):
            assert time.monotonic() < end, self.events
            time.sleep(0.005)

    def close(self) -> None:
        self._over.set()
        self._thread.join(10.0)
        assert not self._thread.is_alive()


@pytest.fixture
def plant(monkeypatch):
    monkeypatch.setattr(betaflight_link, "MIN_PORT_OPEN_TIME_S", 0.0)
    faults = (parse_fault("position.jump=2@1s"),)
    with AutopilotPlant(
        load_vehicle("mufly-1.1"), Mission(name="hall"), rate_Hz=BETAFLIGHT_RATE_HZ, autopilot="Betaflight",
        faults=faults,
    ) as vehicle:  # fmt: skip
        yield vehicle


@pytest.fixture
def session(plant):
    made = Session(plant)
    yield made
    made.close()


def test_the_time_stands_until_betaflight_answers_and_advances_by_a_period_with_each_answer(session):
    peer = session.peer
    assert [peer.receive_state()[0] for _ in range(3)] == [0.0, 0.0, 0.0]
    times = [peer.answer()[0] for _ in range(40)]
    assert times[-1] > 0.05
    steps = np.diff(times)
    assert np.all((steps > -1e-12) & (steps < 1.5 / BETAFLIGHT_RATE_HZ))
    session.await_event("position.jump")  # the SITL does not receive it


def test_a_start_that_failed_is_named(plant, monkeypatch):
    monkeypatch.setattr(betaflight_link, "START_TIMEOUT_S", 0.1)
    session = Session(plant)
    session.await_event("answers no state")
    session.peer.answer()
    session.await_event("Betaflight answers from")
    session.close()


def test_the_state_has_the_signs_of_betaflight_and_outputs_move_the_vehicle(session):
    peer, vehicle = session.peer, session.simulator.vehicle
    state = peer.answer()
    assert state[4:7] == pytest.approx((0.0, 0.0, -9.81), abs=0.5)
    assert np.linalg.norm(state[7:11]) == pytest.approx(1.0)
    assert state[17] == pytest.approx(101325.0, abs=500.0)
    for _ in range(700):
        peer.answer((1900, 1900, 1500, 1500))
    assert vehicle.is_armed
    assert vehicle.height_m > 0.075
    before = vehicle.truth.rates.copy()
    for _ in range(30):
        state = peer.answer((1900, 1900, 1700, 1700))  # nose down, roll right
    assert vehicle.truth.rates[0] > before[0] + 0.3
    assert vehicle.truth.rates[1] < before[1] - 0.3
    assert state[1] > 0.2  # p, then q nose up
    assert state[2] < -0.2
    before = vehicle.truth.rates.copy()
    for _ in range(30):
        peer.answer((1600, 1990, 1500, 1500))  # Betaflight's mixer turns right with its second motor
    assert vehicle.truth.rates[2] > before[2] + 0.3


def test_the_pilot_arms_then_raises_the_throttle(session):
    peer = session.peer
    armed_at, channels = None, (0,) * 16
    for k in range(700):
        if k % 5 == 4:
            channels = peer.receive_channels()
        if channels[4] > 1700 and armed_at is None:
            armed_at = k
            assert channels[2] == 1000
        peer.answer(REST if armed_at is None else IDLE)
    assert armed_at is not None
    assert session.simulator.pilot.phase == "spool-up"
    assert channels[2] > 1200
    session.await_event("Betaflight has armed")


def test_a_refused_arming_is_explained_by_its_reasons(plant, monkeypatch):
    monkeypatch.setattr(betaflight_link, "ARMING_REFUSAL_TIMEOUT_S", 0.1)
    serial = SerialPort(flags=1 << 12 | 1 << 28)
    session = Session(plant, serial.port)
    try:
        end = time.monotonic() + 20.0
        while not any("does not arm" in text for text in session.events):
            assert time.monotonic() < end, session.events
            session.peer.answer()
    finally:
        session.close()
    assert "Betaflight does not arm: calibrating" in session.events
    assert serial.requests == 1


def test_silence_and_a_restart_are_named(session, monkeypatch):
    monkeypatch.setattr(betaflight_link, "SILENCE_TIMEOUT_S", 0.2)
    peer, vehicle = session.peer, session.simulator.vehicle
    for _ in range(500):
        peer.answer((1900, 1900, 1500, 1500))
    session.await_event("has not answered")
    assert session.simulator.state == "silent"
    stands_s = vehicle.time_s
    assert session.simulator.unanswered_count > 0
    peer.send_outputs((1900, 1900, 1500, 1500))
    session.await_event("answers again")
    peer.restart()
    peer.send_outputs()
    session.await_event("has restarted")
    session.await_event("back at the start")
    assert vehicle.time_s >= stands_s
    assert abs(vehicle.height_m) < 0.1


@pytest.mark.parametrize(
    ("send", "word"),
    [
        (lambda peer: peer.answer((1000,) * 4, motors=4), "4 motors"),
        (lambda peer: peer.answer((1000, 1000, 0, 0)), "no servos"),
        (lambda peer: peer.send(struct.pack("<4f", 0, 0, 0, 0)), "port 9002"),
        (lambda peer: peer.send(b"hello"), "close that program"),
    ],
)
def test_a_wrong_mixer_and_a_wrong_port_are_named_once(session, send, word):
    for _ in range(3):
        send(session.peer)
    session.await_event(word)
    assert sum(word in text for text in session.events) == 1
    assert not session.simulator.vehicle.is_armed


def test_a_port_in_use_and_a_speed_above_real_time_are_refused(plant, session):
    taken = BetaflightPorts(session.peer.output_port)
    with pytest.raises(InputError, match="in use"):
        BetaflightSimulator(plant, ports=taken)
    with pytest.raises(InputError, match="too fast"):
        BetaflightSimulator(plant, speed=2.0, ports=BetaflightPorts(0))


def test_packets_of_other_sizes_are_no_outputs_and_broken_answers_no_status():
    assert decode_outputs(b"") is None
    outputs = decode_outputs(struct.pack("<H2x16f", 2, 1250, 1750, 1600, 1400, *[0.0] * 12))
    assert outputs is not None
    assert outputs.vehicle_inputs == pytest.approx([0.75, 0.25, 0.2, -0.2])
    assert decode_arming_refusals(b"$M>\x05") is None
    assert decode_arming_refusals(b"noise$M>\x01\x96\x00\x00") is None


def test_gains_in_betaflights_units_give_the_same_input():
    """An error of 1 rad/s, its integral of 1 rad and a slope of 1 rad/s^2 move the actuator as the design says."""
    deg = 180.0 / math.pi
    for axis, full in (("roll", 0.7 / 500.0), ("pitch", 0.7 / 500.0), ("yaw", 0.95 / 1000.0)):
        gains = getattr(GAINS, axis)
        k = convert_rate_gains(axis, gains)
        integral = 0.244381 * (2.5 if axis == "yaw" else 1.0)
        assert full * 0.032029 * k.P * deg == pytest.approx(gains.rate_proportional, rel=0.02)
        assert full * integral * k.I * deg == pytest.approx(gains.rate_integral, rel=0.03)
    text = format_cli_file(load_vehicle("mufly-1.1"), GAINS)
    assert "mixer DUALCOPTER" in text
    assert text.rstrip().endswith("save")
    weak = type(GAINS.roll)(rate_proportional=1.0)
    with pytest.raises(MuflyError, match="beyond its limit"):
        convert_rate_gains("roll", weak)


def test_the_square_is_closed_rests_in_its_corners_and_has_the_velocity_of_its_positions():
    plan = PilotPlan(square_side_m=1.0, leg_duration_s=6.0)
    corners = [sample_square_path(plan, k * plan.leg_duration_s)[0] for k in range(5)]
    assert np.allclose(corners, [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)])
    assert all(np.allclose(sample_square_path(plan, k * plan.leg_duration_s)[1], 0.0) for k in range(5))
    for t, dt in itertools.product((1.0, 8.3, 13.1, 22.9), (1e-5,)):
        ahead, behind = sample_square_path(plan, t + dt)[0], sample_square_path(plan, t - dt)[0]
        assert (ahead - behind) / (2.0 * dt) == pytest.approx(sample_square_path(plan, t)[1], abs=1e-6)


def test_a_cli_file_is_sent_line_by_line_and_a_refused_line_is_named():
    serial = SerialPort()
    text = "# head\nmixer DUALCOPTER\n\nset p_roll = 1\nsave\n"
    send_cli_file(text, endpoint=Endpoint("tcp", "127.0.0.1", serial.port))
    assert serial.lines == ["mixer DUALCOPTER", "set p_roll = 1", "save"]
    serial = SerialPort(refused="set p_roll")
    with pytest.raises(MuflyError, match=r"refuses 'set p_roll = 1': .*INVALID NAME"):
        send_cli_file("set p_roll = 1\nsave\n", endpoint=Endpoint("tcp", "127.0.0.1", serial.port))
    assert "save" not in serial.lines


def test_the_real_betaflight_arms_takes_off_hovers_in_wind_and_lands(tmp_path):
    program = find_betaflight()
    if program is None:
        pytest.skip("no Betaflight SITL: set MUFLY_BETAFLIGHT to its program")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", BETAFLIGHT_ENDPOINT.port))
        except OSError:
            pytest.skip(f"another program uses Betaflight's UDP port {BETAFLIGHT_ENDPOINT.port}")
    vehicle = load_vehicle("mufly-1.1")
    warm_up_plant(vehicle, BETAFLIGHT_RATE_HZ)
    plan = PilotPlan(height_m=0.6, hover_s=10.0, square_side_m=0.0)
    for _ in range(STARTS):  # one start in ten of the program never answers a state on a busy machine
        pilot, events, rows = BetaflightPilot(GAINS, plan), [], []
        with (
            run_betaflight(program, tmp_path, format_cli_file(vehicle, GAINS)),
            AutopilotPlant(
                vehicle, Mission(name="hall"), rate_Hz=BETAFLIGHT_RATE_HZ, autopilot="Betaflight",
                wind=(WIND_M_S, 0.0, 0.0),
            ) as plant,
        ):  # fmt: skip
            plant.listeners.append(lambda event, events=events: events.append(event.text))
            simulator = BetaflightSimulator(plant, pilot)

            def keep_row(pilot=pilot, rows=rows, plant=plant) -> None:
                if pilot.phase == "hover":
                    rows.append(pilot.reference - plant.truth.position)

            simulator.on_period = keep_row
            begun = time.monotonic()

            def is_over(pilot=pilot, simulator=simulator, begun=begun) -> bool:
                spent = time.monotonic() - begun
                landed = pilot.phase == "landed" and pilot.phase_s > 0.5
                return landed or spent > FLIGHT_S or (simulator.lockstep_period_count == 0 and spent > ANSWER_S)

            simulator.run(is_over)
            truth, height_m, crash = plant.truth, plant.height_m, plant.plant.crash_cause
        if simulator.lockstep_period_count:
            break
    assert pilot.phase == "landed", (pilot.phase, events)
    assert not crash
    assert "Betaflight has armed" in events
    assert "Betaflight has disarmed" in events
    errors = np.array(rows)
    assert len(errors) == pytest.approx(plan.hover_s * BETAFLIGHT_RATE_HZ, rel=0.01)
    assert np.max(np.hypot(errors[:, 0], errors[:, 1])) < 0.2
    assert np.max(np.abs(errors[:, 2])) < 0.2
    settled = errors[len(errors) // 2 :]
    assert np.sqrt(np.mean(np.sum(settled**2, axis=1))) < 0.1
    assert height_m < 0.1
    assert np.max(np.abs(truth.attitude[:2])) < math.radians(5.0)
