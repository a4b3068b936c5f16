"""Every driver against a device that speaks its bytes over a pseudo-terminal: lost bytes, silence, resets, nonsense."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pty")

from bench_emulators import Bench, FarCells, FarEpos, FarEsc, FarStand

import mufly.bench.rig.esc_bridge
from mufly.bench.rig.bench_devices import BenchFacts, Clock, DeviceError, DeviceRig, StopError
from mufly.bench.rig.epos_controller import EposController, FrameParser, build_frame
from mufly.bench.rig.esc_bridge import EscBridge
from mufly.bench.rig.ni_daq import NiDaq
from mufly.bench.rig.rig_file import DeviceTable, load_rig
from mufly.bench.rig.serial_line import append_checksum, compute_crc16
from mufly.bench.rig.serial_load_cells import SerialLoadCells
from mufly.bench.rig.simulated_rig import SimulatedRig
from mufly.bench.rig.thrust_stand import ThrustStand
from mufly.bench.series.series_plan import BladeMounting, StepDurations, make_series_plan
from mufly.bench.series.series_record import SeriesRecord, read_valid_lines
from mufly.bench.series.series_runner import run_series
from mufly.errors import InputError
from mufly.files.input_files import validate_model
from mufly.quantities.units import RPM

NACA = "naca0012-r60-c20"
COUNTS = 1e6


def world(seed=0):
    rig = SimulatedRig(seed)
    rig.record_mounting(BladeMounting(use="measure", axis="upper", rotor=NACA, pitch_deg=12, speeds_rpm=(5000,)))
    rig.advance_time(0.1)  # polars and maps are made now, not while a device has to answer
    return rig


def until(read, good, seconds=4.0):
    """Read until it is good; return everything that came."""
    got, end = {}, time.monotonic() + seconds
    while time.monotonic() < end:
        for name, values in read().items():
            got.setdefault(name, []).extend(values)
        if good(got):
            return got
        time.sleep(0.01)
    raise AssertionError(f"not in {seconds} s: { {k: v[-3:] for k, v in got.items()} }")


def near(name, value, share=0.01):
    return lambda got: len(got.get(name, [])) > 3 and abs(got[name][-1] - value) < share * abs(value)


# --- bytes ------------------------------------------------------------------------------------------------------------


def test_frames_are_those_of_the_guide():
    """EPOS4 Communication Guide, ch. 2.2.9: home position read from node 1, and the answer with a doubled 0x90."""
    request = bytes.fromhex("9002 6002 01B03000 2E62".replace(" ", ""))
    assert build_frame(0x60, bytes.fromhex("01B03000")) == request
    answer = bytes.fromhex("90020004000000000190900000" + "9A5C")
    assert FrameParser().feed_bytes(answer) == [(0x00, bytes.fromhex("0000000001900000"))]
    assert build_frame(0x00, bytes.fromhex("0000000001900000")) == answer


def test_frames_survive_being_cut_and_damage_gives_no_wrong_one():
    rng = random.Random(1)
    sent = [
        (
            rng.randrange(256),
            bytes(rng.choice((0x90, 0x02, rng.randrange(256))) for _ in range(2 * rng.randrange(9))),
        )
        for _ in range(300)
    ]
    stream, frames, got = b"".join(build_frame(o, d) for o, d in sent), FrameParser(), []
    while stream:
        n = rng.randrange(1, 12)
        got += frames.feed_bytes(stream[:n])
        stream = stream[n:]
    assert got == sent
    for opcode, data in sent:
        raw = bytearray(build_frame(opcode, data))
        raw[rng.randrange(2, len(raw))] ^= 1 << rng.randrange(8)
        found = FrameParser().feed_bytes(bytes(raw) + build_frame(1, b"ab"))
        # Damage at the very end may look like the beginning of what follows, which is then lost as well, never wrong.
        assert all(f in ((opcode, data), (1, b"ab")) for f in found)


def test_check_sum_of_text_lines():
    assert compute_crc16(b"123456789") == 0x29B1  # the check value of CRC-16/IBM-3740
    assert append_checksum("X") == b"$X*3A0D\n"


# --- devices ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("generation", [4, 2])
def test_epos_turns_reads_stops_and_bears_a_bad_line(generation):
    rig = world()
    far = FarEpos(rig, "upper", generation)
    with Bench(rig, [far], pace=20.0):
        epos = EposController(far.port, "upper", generation=generation)
        epos.open()
        far.lose = far.flip = 0.004
        epos.set_speed("upper", 5000 * RPM)
        got = until(epos.read_new_samples, near("speed_upper", 5000 * RPM))
        assert got["current_upper"][-1] == pytest.approx(0.16, abs=0.05)
        far.lose = far.flip = 0.0
        epos.stop()
        assert rig.commanded_speed["upper"] == 0.0
        epos.set_speed("upper", 3000 * RPM)  # and again, after a quick stop
        until(epos.read_new_samples, near("speed_upper", 3000 * RPM))
        far.reset()
        with pytest.raises(DeviceError, match="was it reset"):
            until(epos.read_new_samples, lambda got: False)
        epos.open()
        far.mute = True
        began = time.monotonic()
        with pytest.raises(DeviceError, match="does not answer"):
            epos.read_new_samples()
        assert time.monotonic() - began < 2.0
        with pytest.raises(DeviceError):
            epos.stop()
        far.mute = False
        epos.close()


def test_bridge_turns_reads_and_its_watchdog_stops_what_is_left_alone():
    rig = world()
    far = FarEsc(rig, ("upper", "lower"))
    with Bench(rig, [far], pace=10.0):
        esc = EscBridge(far.port, ("upper", "lower"))
        esc.open()
        far.lose = far.flip = 0.002
        esc.set_speed("upper", 4000 * RPM)
        got = until(esc.read_new_samples, near("speed_upper", 4000 * RPM))
        assert max(got["speed_lower"]) == 0.0
        assert got["voltage_upper"][-1] > 5.0
        assert got["motor_temperature_upper"][-1] > 280.0
        far.lose = far.flip = 0.0
        time.sleep(0.7)  # the program hangs
        assert rig.commanded_speed["upper"] == 0.0
        with pytest.raises(DeviceError, match="watchdog"):
            until(esc.read_new_samples, lambda got: False)
        esc.set_speed("upper", 4000 * RPM)
        far.reset()
        with pytest.raises(DeviceError, match="was reset"):
            until(esc.read_new_samples, lambda got: False)
        esc.stop()
        far.mute = True
        with pytest.raises(DeviceError, match="silent"):
            until(esc.read_new_samples, lambda got: False)
        far.mute = False
        esc.close()


def test_cells_give_no_number_that_was_not_sent():
    rig = world()
    far = FarCells(rig)
    with Bench(rig, [far], pace=10.0):
        cells = SerialLoadCells(far.port)
        cells.open()
        far.lose = far.flip = 0.01
        got = until(cells.read_new_samples, lambda got: len(got.get("thrust_raw", [])) > 150 and got["pressure"])
        assert cells.broken_line_count > 0
        assert cells.lost_samples > 0
        volts = np.array(got["thrust_raw"]) / COUNTS
        assert np.all(np.abs(volts - np.median(volts)) < 0.1)  # at rest: nothing but noise and zero
        assert np.median(got["pressure"]) == pytest.approx(97000, rel=0.05)
        far.lose = far.flip = 0.0
        far.reset()
        with pytest.raises(DeviceError, match="was reset"):
            until(cells.read_new_samples, lambda got: False)
        far.send(b"\x00\xff$$$*garbage\n" * 50)
        assert until(cells.read_new_samples, lambda got: len(got.get("thrust_raw", [])) > 5)
        far.mute = True
        with pytest.raises(DeviceError, match="silent"):
            until(cells.read_new_samples, lambda got: False)
        cells.close()


def test_stand_finds_the_pulse_that_gives_the_speed():
    rig = world()
    far = FarStand(rig)
    with Bench(rig, [far], pace=15.0):
        stand = ThrustStand(far.port, pace=15.0)
        stand.open()
        stand.set_speed("upper", 5000 * RPM)
        got = until(stand.read_new_samples, near("speed_upper", 5000 * RPM, 0.005), 6.0)
        assert got["thrust"][-1] == pytest.approx(0.144, rel=0.2)
        far.send(b"1,2,3\nnan,nan,nan,nan,nan,nan,nan\n5,1e30,0,0,0,0,0\n\xff\xfe\n")
        more = until(stand.read_new_samples, lambda got: len(got.get("thrust", [])) > 10)
        assert max(more["thrust"]) < 1.0
        assert stand.broken_rows >= 4
        stand.stop()
        until(stand.read_new_samples, lambda got: rig.commanded_speed["upper"] == 0.0)
        far.mute = True
        with pytest.raises(DeviceError, match="silent"):
            until(stand.read_new_samples, lambda got: False)
        stand.close()


@pytest.mark.parametrize(
    ("table", "remedy"),
    [
        ({"kind": "nidaq", "port": "COM3", "inputs": {"thrust_raw": "Dev1/ai0"}}, "remove port"),
        ({"kind": "cells"}, "write port"),
    ],
)
def test_a_port_is_for_every_device_but_a_nidaq(table, remedy):
    with pytest.raises(InputError, match=remedy):
        validate_model(DeviceTable, table, "bench.toml")


def test_nidaq_averages_and_says_what_is_missing(monkeypatch):
    daq = NiDaq({"thrust_raw": "Dev1/ai0", "vibration": "Dev1/ai1"}, scale={"vibration": 100.0}, average=10)
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(DeviceError, match="needs the package nidaqmx"):
        daq.open()
    t = np.arange(25)

    class Task:
        def __init__(self):
            self.ai_channels = types.SimpleNamespace(add_ai_voltage_chan=lambda *a, **k: None)
            self.timing = types.SimpleNamespace(cfg_samp_clk_timing=lambda *a, **k: None)

        def start(self):
            pass

        def close(self):
            pass

        def read(self, number_of_samples_per_channel):
            return np.vstack([2.0 + 0 * t, np.where(t % 2, 0.1, -0.1)])

    constants = types.SimpleNamespace(AcquisitionType=types.SimpleNamespace(CONTINUOUS=1))
    monkeypatch.setitem(sys.modules, "nidaqmx", types.SimpleNamespace(Task=Task, constants=constants))
    monkeypatch.setitem(sys.modules, "nidaqmx.constants", constants)
    daq.open()
    first, second = daq.read_new_samples(), daq.read_new_samples()
    assert [len(first["thrust_raw"]), len(second["thrust_raw"])] == [2, 3]  # 25 samples, then 5 left and 25
    assert first["thrust_raw"] == pytest.approx(2.0)
    assert first["vibration"] == pytest.approx(10.0)
    daq.close()


# --- the bench --------------------------------------------------------------------------------------------------------


class Stubborn:
    name, channel_names, driven_axes = "stubborn", (), ("upper",)

    def __init__(self, failures):
        self.failures, self.asked = failures, 0

    def stop(self):
        self.asked += 1
        if self.asked <= self.failures:
            raise DeviceError("no")

    def close(self):
        pass


def test_every_motor_is_stopped_whatever_another_one_does():
    good, bad, dead = Stubborn(0), Stubborn(2), Stubborn(99)
    rig = DeviceRig([bad, good], BenchFacts("b"))
    rig.stop()
    assert (good.asked, bad.asked) == (1, 3)
    with pytest.raises(StopError, match="CUT THE POWER"):
        DeviceRig([dead, good], BenchFacts("b")).stop()
    assert good.asked == 2


def facts_in_counts(rig):
    c = dict(rig.facts.calibration)
    c["offset"] = (COUNTS * np.array(c["offset"])).tolist()
    c["sensitivity"] = (COUNTS * np.array(c["sensitivity"])).tolist()
    c["covariance"] = (COUNTS**2 * np.array(c["covariance"])).tolist()
    return BenchFacts(
        "emulated", c, dict.fromkeys(("thrust_raw", "torque_raw"), (-5 * COUNTS, 5 * COUNTS)), manual=False
    )


def test_a_series_over_devices_bears_a_reset():
    made = make_series_plan("p", [NACA], [12], [3500, 5500], reference=NACA, reference_pitch_deg=12, repetitions=1,
                     times=StepDurations(warm_up_s=2, average_s=1, longest_s=1, tare_s=1, window_s=0.5))  # fmt: skip
    made = made.model_copy(update={"mounting": made.mounting[:1]})
    rig = world()
    far_esc, far_cells = FarEsc(rig), FarCells(rig)
    pace, count = 20.0, [0]

    def told(progress):
        count[0] += progress.record_line is not None
        if count[0] == 2 and progress.record_line is not None:
            far_cells.reset()

    with Bench(rig, [far_esc, far_cells], pace):
        devices = [EscBridge(far_esc.port), SerialLoadCells(far_cells.port)]
        bench = DeviceRig(devices, facts_in_counts(rig), Clock(pace))
        record = run_series(made, bench, SeriesRecord(), told=told)
        bench.close()
    points = [x for x in record.readings if x["what"] == "point"]
    assert [p["speed_rpm"] for p in points] == list(made.mounting[0].speeds_rpm)
    assert any(x["kind"] == "event" and "was reset" in x.get("why", "") for x in record.lines)
    assert rig.commanded_speed["upper"] == 0.0
    p = max(points, key=lambda x: x["speed_rpm"])
    truth = (
        rig.find_loads_at_map_density({"upper": np.array(5500 * RPM), "lower": np.array(0.0)})[0]
        * rig.true_density()
        / 1.2
    )
    assert p["quick"]["thrust"] == pytest.approx(float(truth), rel=0.05)


RIG = """
name = "emulated"
cells = "cells.csv"
manual = false
pace = {pace}
[[device]]
kind = "esc"
port = "{esc}"
axes = ["upper"]
[[device]]
kind = "cells"
port = "{cells}"
"""


def cells_file(path, rig):
    loads = np.array([[f, m] for f in (0.0, 0.2, 0.5) for m in (0.0, 0.002, 0.005)])
    y = COUNTS * (loads @ np.array(rig.facts.calibration["sensitivity"]).T + np.array([0.12, -0.4]))
    rows = [f"{f},{m},{a:.0f},{b:.0f}" for (f, m), (a, b) in zip(loads, y, strict=True)]
    path.write_text("\n".join(["thrust_N,torque_Nm,thrust_raw,torque_raw", *rows]), encoding="utf-8")


def test_signals_and_a_kill_leave_no_motor_turning(tmp_path):
    """A series in a process of its own: SIGTERM stops it in order, SIGKILL leaves it to the watchdog."""
    made = make_series_plan("p", [NACA], [12], [3500, 5500], reference=NACA, reference_pitch_deg=12,
                     times=StepDurations(warm_up_s=0, average_s=2, tare_s=1))  # fmt: skip
    (tmp_path / "plan.toml").write_text(made.to_toml(), encoding="utf-8")
    rig = world()
    far_esc, far_cells = FarEsc(rig), FarCells(rig)
    cells_file(tmp_path / "cells.csv", rig)
    text = RIG.format(pace=5.0, esc=far_esc.port, cells=far_cells.port)
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    words = [sys.executable, "-m", "mufly", "bench", "run", "plan.toml", "--rig", "rig.toml", "--out", "s"]
    raw, before = tmp_path / "s" / "raw.jsonl", 0
    with Bench(rig, [far_esc, far_cells], 5.0):
        for number in (signal.SIGTERM, signal.SIGKILL):
            child = subprocess.Popen(
                words, cwd=tmp_path, env=dict(os.environ), stdout=subprocess.PIPE, stderr=subprocess.STDOUT
            )
            end = time.monotonic() + 60
            while (not rig.commanded_speed["upper"] or not raw.exists()) and time.monotonic() < end:
                time.sleep(0.02)
            assert rig.commanded_speed["upper"], child.communicate(timeout=5)[0].decode()
            child.send_signal(number)
            said = child.communicate(timeout=30)[0].decode()
            assert child.returncode == (143 if number == signal.SIGTERM else -9), said
            time.sleep(0.0 if number == signal.SIGTERM else 0.8)
            assert rig.commanded_speed["upper"] == 0.0
            lines, _ = read_valid_lines(raw)
            readings = [x for x in lines if x["kind"] == "reading"]
            assert len(readings) > before
            before = len(readings)
    assert far_esc.watchdog_trips == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('kind = "esc"', 'kind = "esp"'), r"device\[1\].kind.*unknown"),
        (('axes = ["upper"]', ""), "names no axis"),
        (('cells = "cells.csv"', ""), "there are raw readings"),
        (("pace = 5.0", "paces = 5"), "did you mean 'pace'"),
        (('port = "/dev/b"', 'port = "/dev/b"\nchannels = ["thrust_raw"]'), "which no device measures"),
    ],
)
def test_a_bench_file_says_what_is_wrong_with_it(tmp_path, change, message):
    cells_file(tmp_path / "cells.csv", world())
    text = RIG.format(pace=5.0, esc="/dev/a", cells="/dev/b").replace(*change)
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        load_rig(tmp_path / "rig.toml")


# --- sketches ---------------------------------------------------------------------------------------------------------

SKETCHES = Path(mufly.bench.rig.esc_bridge.__file__).with_name("sketches")
BOARD = Path(__file__).with_name("board")


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    """A function that builds a sketch for this machine (tests/bench/board) and returns the program."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    folder = tmp_path_factory.mktemp("board")

    def built(name):
        out, sketch = folder / name, f'-DSKETCH="{SKETCHES / name}.ino"'
        words = [compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", f"-I{BOARD}", sketch]
        subprocess.run([*words, str(BOARD / "main.cpp"), "-o", str(out)], check=True)
        return out

    return built


@pytest.mark.parametrize("name", ["esc_bridge", "hx711_cells"])
def test_sketches_compile(board, name):
    assert board(name).is_file()


def test_dshot_sketch_holds_a_speed_by_the_controllers_answers(board):
    """The sketch itself, its frames heard and answered edge by edge; our driver on the other side of a terminal."""
    import pty
    import tty

    program = board("dshot_bridge")
    for dumb in (False, True):
        master, slave = pty.openpty()
        tty.setraw(slave)
        env = os.environ | ({"DSHOT_DUMB": "1"} if dumb else {})
        child = subprocess.Popen([program], stdin=master, stdout=master, env=env)
        try:
            esc = EscBridge(os.ttyname(slave), ("upper", "lower"))
            esc.open()
            esc.set_speed("upper", 6000 * RPM)
            if dumb:  # one without bidirectional DShot does not turn without anybody's knowing how fast
                with pytest.raises(DeviceError, match="does not answer"):
                    until(esc.read_new_samples, lambda got: False)
                continue
            got = until(esc.read_new_samples, near("speed_upper", 6000 * RPM, 0.005), seconds=8.0)
            assert max(got["speed_lower"]) == 0.0
            assert got["current_upper"][-1] == pytest.approx(1.0, abs=0.05)
            assert 4.0 < got["voltage_upper"][-1] < 7.0  # half of 11 V
            esc.stop()
            until(esc.read_new_samples, lambda got: got.get("speed_upper", [9.0])[-1] < 200 * RPM)
            esc.set_speed("upper", 3000 * RPM)
            time.sleep(0.6)  # the program hangs
            with pytest.raises(DeviceError, match="watchdog"):
                until(esc.read_new_samples, lambda got: False)
        finally:
            child.kill()
            child.wait()
            os.close(master)
            os.close(slave)
