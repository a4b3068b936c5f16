"""The simulator of PX4 against a scripted peer (px4_peer.py): lockstep, restarts, silence, rates, airframes."""

import math
import threading
import time

import numpy as np
import pytest
from px4_peer import CascadeLaw, ScriptedPx4, idle

from mufly.bridges.autopilot_gains import MAX_SENSITIVITY, design_autopilot_gains
from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.bridges.px4.px4_airframe import airframe_file_name, format_airframe_file, list_px4_parameters
from mufly.bridges.px4.px4_link import DEFAULT_ORIGIN, PX4_RATE_HZ, Px4Simulator
from mufly.bridges.px4.px4_messages import SensorMessageEncoder
from mufly.dynamics import find_trim, hover_performance
from mufly.errors import InputError
from mufly.link import parse_endpoint
from mufly.mission import Mission
from mufly.sensors.faults import parse_fault
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def gains():
    return design_autopilot_gains(load_vehicle("mufly-1.1"))


@pytest.fixture(scope="module")
def parameters(gains):
    return {p.name: p.value for p in list_px4_parameters(load_vehicle("mufly-1.1"), gains)}


def plant(**settings) -> AutopilotPlant:
    settings = {"rate_Hz": PX4_RATE_HZ, "autopilot": "PX4", "keep": True} | settings
    return AutopilotPlant(load_vehicle("mufly-1.1"), Mission(name="hall"), **settings)


class Session:
    """A simulator in a thread, its events, and its end."""

    def __init__(self, vehicle: AutopilotPlant, **settings) -> None:
        self.vehicle, self.events = vehicle, []
        vehicle.listeners.append(lambda event: self.events.append(event.text))
        endpoint = parse_endpoint("tcpin:127.0.0.1:0", "vehicle", least_port=0)
        self.simulator = Px4Simulator(vehicle, endpoint=endpoint, **({"speed": 0.0} | settings))
        self.over = threading.Event()
        self._thread = threading.Thread(target=self.simulator.run, args=(self.over.is_set,), daemon=True)

    def __enter__(self) -> "Session":
        self._thread.start()
        return self

    def __exit__(self, *exc) -> None:
        self.over.set()
        self._thread.join(10.0)
        assert not self._thread.is_alive()

    @property
    def port(self) -> int:
        return self.simulator.port.bound_port_number

    def wait(self, ready, seconds=30.0) -> None:
        end = time.monotonic() + seconds
        while not ready():
            assert time.monotonic() < end, self.events
            time.sleep(0.01)

    def told(self, word: str) -> bool:
        return any(word in text for text in self.events)


def test_a_scripted_px4_flies_on_the_gains_of_its_airframe_file(parameters, gains):
    law = CascadeLaw(parameters, (0.0, 0.0, -1.0), DEFAULT_ORIGIN)
    with plant(wind=(0.5, 0.0, 0.0), gust=0.0) as vehicle, Session(vehicle) as session:
        peer = ScriptedPx4(session.port, law)
        session.wait(lambda: vehicle.time_s > 7.0, 120.0)
        peer.close()
        assert session.simulator.unanswered_count == 0
        steps = np.diff(peer.times_us)
        assert set(steps) == {4000}  # no period is lost
        record = vehicle.to_dataset()
    late = record.sel(time=slice(5.5, 7.0))
    assert abs(late.truth_position.values[:, 2].mean() + 1.0) < 0.15
    assert np.abs(late.truth_position.values[:, :2]).max() < 0.2  # wind of 0.5 m/s
    assert np.degrees(np.abs(record.truth_attitude.values[:, :2])).max() < 15.0
    assert abs(late.motor_input.values.mean() - gains.hover_thrust) < 0.08
    assert np.isfinite(record.measured_acceleration.values).all()
    for name in ("HIL_SENSOR", "VISION_POSITION_ESTIMATE", "DISTANCE_SENSOR", "HIL_STATE_QUATERNION"):
        assert peer.messages[name]


def test_margins_are_those_asked_for(gains):
    for margins in gains.margins:
        assert margins.sensitivity < 1.05 * MAX_SENSITIVITY, margins
        assert not margins.outer_sensitivity > 1.05 * MAX_SENSITIVITY
        assert margins.gain_margin_dB > 6.0
        assert margins.phase_margin_deg > 30.0


def test_airframe_file(gains):
    vehicle = load_vehicle("mufly-1.1")
    text = format_airframe_file(vehicle, gains, "vision", "mufly autopilot gains px4")
    assert airframe_file_name(vehicle) == "22001_mufly_1_1"
    for line in (
        "CA_AIRFRAME 12",
        "CA_SP0_ANG0 180",
        "CA_SP0_ANG1 270",
        "PWM_MAIN_FUNC4 202",
        "EKF2_EV_CTRL 11",
        "SDLOG_PROFILE 25",
    ):
        assert f"param set-default {line}" in text
    assert "EKF2_GPS_CTRL" not in format_airframe_file(vehicle, gains, "gps")


def test_px4_simulates_the_voltage_of_the_vehicle_in_hover(parameters):
    vehicle = load_vehicle("mufly-1.1")
    hover, p = hover_performance(vehicle), parameters
    full_V = p["BAT1_N_CELLS"] * p["BAT1_V_CHARGED"]
    assert full_V == pytest.approx(find_trim(vehicle, charge=1.0).battery_voltage_V)
    # The time at which hover has used half of the charge.
    spent = 0.5 * float(vehicle.battery.capacity) / hover.battery_current_A / p["SIM_BAT_DRAIN"]
    voltage_V = full_V - spent * (full_V - p["BAT1_N_CELLS"] * p["BAT1_V_EMPTY"])
    assert voltage_V == pytest.approx(hover.battery_voltage_V, rel=2e-3)


def test_a_px4_that_dies_and_calls_again_starts_anew():
    def arm(time_s, state):
        return time_s > 0.3, (0.9, 0.9, 0.0, 0.0)

    with plant() as vehicle, Session(vehicle) as session:
        first = ScriptedPx4(session.port, arm)
        session.wait(lambda: vehicle.is_armed and vehicle.time_s > 0.6)
        first.close()
        session.wait(lambda: session.told("closed the connection"))
        stood_s = vehicle.time_s
        time.sleep(0.1)
        assert vehicle.time_s == stood_s
        second = ScriptedPx4(session.port, idle)
        session.wait(lambda: session.told("back at the start") and vehicle.time_s > stood_s + 0.5)
        assert second.times_us[0] == 4000  # the clock of a new PX4 begins
        assert not vehicle.is_armed
        assert vehicle.height_m < 0.1
        second.close()


def test_a_simulator_without_px4_names_the_remedy_once(monkeypatch):
    from mufly.bridges.px4 import px4_link

    monkeypatch.setattr(px4_link, "NO_CALL_TIMEOUT_S", 0.2)
    remedy = "restart PX4"
    with plant() as vehicle, Session(vehicle) as session:
        session.wait(lambda: session.told(remedy))
        time.sleep(0.5)
        assert sum(remedy in text for text in session.events) == 1
        peer = ScriptedPx4(session.port, idle)
        session.wait(lambda: session.told("runs in lockstep"))
        peer.close()
        session.wait(lambda: sum(remedy in text for text in session.events) == 2)


def test_a_silent_px4_stops_the_time(monkeypatch):
    from mufly.bridges.px4 import px4_link

    monkeypatch.setattr(px4_link, "SILENCE_TIMEOUT_S", 0.2)
    monkeypatch.setattr(px4_link, "ANSWER_TIMEOUT_S", 0.1)
    stuck = threading.Event()

    def law(time_s, state):
        if stuck.is_set():
            stuck.clear()
            time.sleep(1.0)
        return False, ()

    with plant() as vehicle, Session(vehicle) as session:
        peer = ScriptedPx4(session.port, law)
        session.wait(lambda: session.told("runs in lockstep"))
        stuck.set()
        session.wait(lambda: session.told("has not answered"))
        session.wait(lambda: session.told("answers again"))
        assert session.simulator.unanswered_count == 1
        steps = session.simulator.lockstep_period_count
        session.wait(lambda: session.simulator.lockstep_period_count > steps + 20)
        peer.close()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"answer_every": 2}, "answers only some of the periods"),
        ({"copies": 2}, "answers a period"),
        ({"lockstep": False}, "built without lockstep"),
    ],
)
def test_other_rates_are_named(monkeypatch, settings, word):
    from mufly.bridges.px4 import px4_link

    monkeypatch.setattr(px4_link, "ANSWER_TIMEOUT_S", 0.02)
    monkeypatch.setattr(px4_link, "_PERIODS_BETWEEN_CHECKS", 50)
    with plant() as vehicle, Session(vehicle) as session:
        peer = ScriptedPx4(session.port, idle, **settings)
        session.wait(lambda: session.told(word))
        peer.close()


@pytest.mark.parametrize(
    ("outputs", "word"),
    [
        ((0.5, 0.5, 0.5, 0.5), "as a quadrotor"),
        ((0.5, 0.5, 0.0, 0.0, 0.5, 0.5), "more than 4 outputs"),
        ((0.0, 0.0, 0.5, -0.5), "outputs 1 and 2 are off"),
        ((math.nan, 0.0, 0.0, 0.0), "not finite numbers"),
    ],
)
def test_another_airframe_is_named(monkeypatch, outputs, word):
    from mufly.bridges.px4 import px4_link

    monkeypatch.setattr(px4_link, "_PERIODS_BETWEEN_CHECKS", 50)
    with plant() as vehicle, Session(vehicle) as session:
        peer = ScriptedPx4(session.port, lambda time_s, state: (True, outputs))
        session.wait(lambda: session.told(word))
        peer.close()
        assert np.isfinite(vehicle.truth.state).all()


def test_a_program_without_mavlink_is_named():
    import socket

    with (
        plant() as vehicle,
        Session(vehicle) as session,
        socket.create_connection(("127.0.0.1", session.port)) as line,
    ):
        line.sendall(b"GET / HTTP/1.1\r\n" * 100)
        session.wait(lambda: session.told("sends no MAVLink messages"))


def test_messages_have_the_units_of_mavlink_and_each_reading_once():
    with plant(seed=3) as vehicle:
        messages = SensorMessageEncoder(vehicle.vehicle, "vision", DEFAULT_ORIGIN)
        seen: dict[str, list] = {}
        for _ in range(250):
            for m in messages.encode_readings(round(vehicle.time_s * 1e6), vehicle.readings):
                seen.setdefault(m.get_type(), []).append(m)
            vehicle.advance_period(np.zeros(4), False)
    assert len(seen["HIL_SENSOR"]) == 250
    assert abs(np.mean([m.zacc for m in seen["HIL_SENSOR"]]) + 9.81) < 0.3
    magnetic = [m for m in seen["HIL_SENSOR"] if m.fields_updated & (1 << 6)]
    assert 45 <= len(magnetic) <= 55  # every 20 ms
    assert 0.4 < np.linalg.norm([magnetic[0].xmag, magnetic[0].ymag, magnetic[0].zmag]) < 0.56  # gauss
    pressure = [m.abs_pressure for m in seen["HIL_SENSOR"] if m.fields_updated & (1 << 9)]
    assert abs(np.mean(pressure) - 1013.25) < 1.0  # hPa
    assert 9 <= len(seen["VISION_POSITION_ESTIMATE"]) <= 13  # 15 Hz, the first after 0.2 s
    assert seen["VISION_POSITION_ESTIMATE"][0].covariance[0] == pytest.approx(0.03**2 + 0.005**2, rel=1e-3)


def test_gps_comes_from_the_fixes_and_stops_with_them():
    faults = (parse_fault("position.dropout@0.6s"),)
    with plant(faults=faults) as vehicle:
        messages = SensorMessageEncoder(vehicle.vehicle, "gps", DEFAULT_ORIGIN)
        times = []
        for _ in range(500):
            found = [m for m in messages.encode_readings(0, vehicle.readings) if m.get_type() == "HIL_GPS"]
            if found:
                times.append(vehicle.time_s)
                assert found[0].lat == pytest.approx(DEFAULT_ORIGIN.lat_deg * 1e7, abs=30)
            vehicle.advance_period(np.zeros(4), False)
    assert times
    assert max(times) < 1.1  # a fix measured before 0.6 s is published up to 0.3 s later


def test_a_vehicle_without_inertial_unit_is_refused():
    bare = load_vehicle("mufly-1.1").model_copy(update={"sensors": None})
    with pytest.raises(InputError, match=r"sensors\.imu.*needs an inertial unit"):
        AutopilotPlant(bare, Mission(name="hall"), rate_Hz=250.0, autopilot="PX4")


def test_a_recording_tells_autopilot_and_crash(tmp_path):
    from mufly.flight import read_recording

    path = tmp_path / "flight.mcap"
    with plant(path=path, keep=False) as vehicle:
        for _ in range(1000):  # full throttle, nose down
            vehicle.advance_period(np.array([1.0, 1.0, 1.0, 0.0]), True)
    record = read_recording(path)
    assert record.attrs["autopilot"] == "PX4"
    assert record.attrs["outcome"] == "failed"
    assert set(record.mission_state.values) == {"disarmed", "armed"}
