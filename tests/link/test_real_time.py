"""The loop by the clock on the wall, over real sockets: in a thread, and in a process of its own."""

import contextlib
import itertools
import math
import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import pytest
from link_rig import new_flight

from mufly.errors import InputError, MuflyError
from mufly.link import (
    Endpoint,
    FrameDecoder,
    FrameEncoder,
    TlogWriter,
    VehicleLink,
    fly_in_real_time,
    open_port,
    start_vehicle_process,
    wait_for_input,
)
from mufly.link import mavlink as m
from mufly.link.real_time.real_time_loop import (
    CATCH_UP_SPEED_FACTOR,
    MAX_CAUGHT_UP_STALL_S,
    PACE_WINDOW_S,
    RealTimePacer,
)
from mufly.logs import read_log, read_raw_log
from mufly.mission import REQUEST_ACCEPTED, Mission


def ticks(clock, period, busy, until):
    """Times of the ticks of a loop whose work takes ``is_busy(k)`` seconds."""
    pace, out, now = RealTimePacer(clock, period), [], clock
    while now < until:
        rest = pace.sleep_time_s(now)
        now += max(0.0, rest)
        pace.record_tick(now)
        out.append(now)
        now += busy(len(out))
    return pace, out


def test_the_pace_does_not_drift():
    pace, out = ticks(10.0, 0.01, lambda k: 0.003 * (k % 3), 70.0)
    assert len(out) == pytest.approx(6000, abs=2)
    assert pace.lost_time_s == 0.0


def test_a_short_stall_is_made_up_for_without_a_burst():
    pace, out = ticks(10.0, 0.01, lambda k: 0.5 if k == 100 else 0.0, 20.0)
    assert len(out) == pytest.approx(1000, abs=2)
    assert min(b - a for a, b in itertools.pairwise(out)) > 0.99 * 0.01 / CATCH_UP_SPEED_FACTOR
    assert pace.lost_time_s == 0.0
    assert pace.worst_lateness_s > 0.4


def test_a_long_stall_is_not():
    pace, out = ticks(10.0, 0.01, lambda k: 4.0 if k == 100 else 0.0, 20.0)
    assert pace.lost_time_s == pytest.approx(4.0 - 0.01)
    assert len(out) == pytest.approx(600, abs=3)
    assert MAX_CAUGHT_UP_STALL_S < 4.0


def test_real_time_that_is_lost_is_measured_and_said(monkeypatch):
    """A clock that goes five times as fast as the machine can tick, from 8 s to 18 s; no load is needed for that."""
    monkeypatch.setattr("mufly.link.real_time.real_time_loop.wait_for_input", lambda ports, timeout_s: None)
    flight, said, told = new_flight(), [], {}
    link = VehicleLink(flight)
    flight.autopilot.listeners.append(lambda e: "real time" in e.text and said.append((e.level, e.text)))
    wall = 0.0

    def clock():
        nonlocal wall
        wall += (5.0 if 8.0 < wall < 18.0 else 0.5) * flight.period_s
        return wall

    def stop():
        told[wall] = link.real_time_factor
        return wall > 29.0

    pace = fly_in_real_time(flight, [], link=link, stop=stop, clock=clock)
    assert all(math.isnan(f) for t, f in told.items() if t < PACE_WINDOW_S)
    for begin, end, least, most in (
        (5.1, 8.0, 0.99, 1.01),
        (13.2, 18.0, 0.18, 0.22),
        (24.5, 29.0, 0.99, 1.01),
    ):
        found = [f for t, f in told.items() if begin < t < end]
        assert least < min(found), (begin, min(found))
        assert max(found) < most, (begin, max(found))
    # 8 s of 10 are lost; what is not more than CATCH_UP_S behind is made up for.
    assert pace.slip_count == link.slip_count == 7
    assert pace.lost_time_s == pytest.approx(8.0, abs=MAX_CAUGHT_UP_STALL_S + 0.1)
    assert flight.time_s == pytest.approx(29.0 - pace.lost_time_s, abs=0.1)
    kept = pace.recording_attributes
    assert kept["realtime_factor"] == pytest.approx(flight.time_s / 29.0, abs=0.01)
    assert kept["realtime_factor_least"] == pytest.approx(0.2, abs=0.02)
    assert [level for level, _ in said] == ["warning", "info"]
    assert said[0][1].startswith("slower than real time: factor 0.9")
    assert said[1][1].startswith("in real time again; 7 timing overruns, 7.")


def test_what_was_asked_while_the_vehicle_stood_still_is_not_carried_out(monkeypatch):
    """Its process was stopped for seven seconds: commands wait in the socket. The link does not count as lost."""
    flight, here = new_flight(), listener()
    link, said = VehicleLink(flight), []
    flight.autopilot.listeners.append(lambda e: said.append(e.text))
    clock = [100.0]
    monkeypatch.setattr(
        "mufly.link.real_time.real_time_loop.wait_for_input",
        lambda ports, timeout_s: clock.__setitem__(0, clock[0] + timeout_s),
    )
    encode, turns = FrameEncoder(255, 190), itertools.count()
    arm = m.MAVLink_command_long_message(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    heard = []
    monkeypatch.setattr(link.autopilot, "arm", lambda **_: heard.append("arm") or REQUEST_ACCEPTED)

    def stop():
        turn = next(turns)
        if turn in (50, 100):
            here.receive_bytes()
            here.send_frame(None, encode(arm))
            time.sleep(0.05)
        if turn == 100:
            clock[0] += 7.0
        return turn > 150

    with contextlib.closing(here):
        fly_in_real_time(
            flight,
            [Endpoint("udpout", "127.0.0.1", here.bound_port_number)],
            link=link,
            stop=stop,
            clock=lambda: clock[0],
        )
    assert heard == ["arm"]  # the first of two
    assert any("simulation stalled for 7.0 s" in text for text in said)
    assert link.authority.commander_silence_s(clock[0]) < 1.0


def listener():
    return open_port(Endpoint("udpin", "127.0.0.1", 0))


def hear(port, seconds, want=lambda message: False):
    """Messages that come in within some time, or until one is wanted."""
    codec, out, end = FrameDecoder(), [], time.monotonic() + seconds
    while time.monotonic() < end:
        wait_for_input([port], 0.05)
        for peer, data in port.receive_bytes():
            for message in codec.decode_bytes(0.0, peer, data):
                out.append(message)
                if want(message):
                    return out
    return out


def test_a_vehicle_in_real_time_and_its_telemetry_log(tmp_path):
    port, other = listener(), listener()
    flight, over = new_flight(), threading.Event()
    log = tmp_path / "link.tlog"
    with TlogWriter(log) as tlog:
        loop = threading.Thread(
            target=fly_in_real_time,
            args=(flight, [Endpoint("udpout", "127.0.0.1", p.bound_port_number) for p in (port, other)]),
            kwargs={"stop": over.is_set, "tlog": tlog},
        )
        loop.start()
        try:
            heard = hear(port, 1.5)
            arm = m.MAVLink_command_long_message(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
            port.send_frame(port.reachable_peers[0], FrameEncoder(255, 190)(arm))
            heard += hear(port, 2.0, lambda x: x.get_type() == "COMMAND_ACK")
        finally:
            over.set()
            loop.join(5.0)
    assert heard[-1].get_type() == "COMMAND_ACK"
    assert heard[-1].result == 0
    times = [x.time_boot_ms for x in heard if x.get_type() == "ATTITUDE"]
    assert times == sorted(times)
    assert len(set(times)) > 5
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # its messages are placed by the vehicle's clock, not by their arrival
        assert read_log(log).sizes["time"] > 10
    tables = read_raw_log(log)
    assert len(tables["COMMAND_LONG@255.190"].time) == 1  # what it heard
    assert len(tables["COMMAND_ACK"].time) == 1  # what it said
    # A second peer that gets the same does not double it.
    written = tables["ATTITUDE"].fields["time_boot_ms"]
    assert len(written) == len(set(written.tolist()))
    port.close()
    other.close()


def within(seconds, condition):
    """Whether it comes to be so; the limit is for a machine that is busy with other things."""
    end = time.monotonic() + seconds
    while not (so := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return so


def has_rows(recording):
    try:
        return read_log(recording).sizes["time"] > 0
    except InputError:
        return False


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_vehicle_in_its_own_process_that_is_killed_is_missed(tmp_path):
    port = listener()
    recording = tmp_path / "flight.mcap"
    end = Endpoint("udpout", "127.0.0.1", port.bound_port_number)
    with start_vehicle_process("mufly-1.1", Mission(name="none"), endpoints=[end], path=recording, system=7) as vehicle:
        vehicle.wait_until_ready()
        heard = hear(port, 60.0, lambda x: x.get_type() == "HEARTBEAT")
        assert heard[-1].get_srcSystem() == 7
        # What reaches all processes of a terminal is not its business.
        os.kill(vehicle.pid, signal.SIGINT)
        os.kill(vehicle.pid, signal.SIGHUP)
        assert within(120.0, lambda: has_rows(recording))
        assert not vehicle.is_finished
        assert vehicle.error == ""
        os.kill(vehicle.pid, signal.SIGKILL)
        assert within(60.0, lambda: vehicle.error)
        assert "while it flew" in vehicle.error
        with pytest.raises(MuflyError, match="while it flew"):
            vehicle.wait_until_ready()
    assert vehicle.is_finished
    assert not read_log(recording).attrs["complete"]
    port.close()


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_vehicle_that_is_stopped_while_it_starts_does_not_start_first():
    vehicle = start_vehicle_process("mufly-1.1", Mission(name="none"), endpoints=[])
    assert not vehicle.is_ready
    vehicle.stop(timeout_s=60.0)
    assert vehicle.is_finished
    assert "before it was ready" in vehicle.error


PARENT = """
import sys, time
from mufly.link import start_vehicle_process, Endpoint
from mufly.mission import Mission
if __name__ == "__main__":
    v = start_vehicle_process("mufly-1.1", Mission(name="none"), endpoints=[], path=sys.argv[1])
    v.wait_until_ready()
    print(v.pid, flush=True)
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_a_vehicle_ends_well_when_its_parent_is_killed(tmp_path):
    script, recording = tmp_path / "parent.py", tmp_path / "flight.mcap"
    script.write_text(PARENT)
    parent = subprocess.Popen([sys.executable, script, recording], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    time.sleep(0.5)
    parent.kill()
    parent.wait()
    assert within(60.0, lambda: not _alive(child))
    data = read_log(recording)
    assert data.attrs["outcome"] == "unfinished"
    assert data.attrs["complete"]


def _alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_what_is_wrong_in_the_process_is_told_here(tmp_path):
    vehicle = start_vehicle_process("mufly-1.1", "no such mission", endpoints=[])
    with pytest.raises(MuflyError, match="no such mission"):
        vehicle.wait_until_ready()
    vehicle.stop()
