"""`mufly fly` as a user calls it."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mufly import cli
from mufly.errors import InputError
from mufly.flight import read_recording

HOP = """
[take_off]
height_m = 0.5
wait_s = 0.2

[[waypoint]]
position_m = [0.3, 0.0, -0.5]
wait_s = 0.2
"""


@pytest.fixture
def hop(tmp_path: Path) -> Path:
    path = tmp_path / "hop.toml"
    path.write_text(HOP)
    return path


def run(monkeypatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["mufly", *map(str, words)])
    try:
        cli.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


IDEAL = ("--sensors", "ideal")  # what these tests are about does not depend on what it flies on


def test_a_flight_writes_recording_summary_and_pictures(monkeypatch, capsys, tmp_path, hop) -> None:
    out = tmp_path / "out"
    assert run(monkeypatch, "fly", hop, *IDEAL, "--out", out, "--headless", "--gust", "0.1", "--wind", "0.2,0,0") == 0
    shown = capsys.readouterr().out
    assert "succeeded" in shown
    assert "take-off" in shown
    made = {p.name for p in out.iterdir()}
    assert {"flight.mcap", "summary.json", "track.png", "history.png"} <= made
    assert read_recording(out / "flight.mcap").attrs["wind_m_s"] == [0.2, 0.0, 0.0]
    assert (out / "track.png").read_bytes()[:4] == b"\x89PNG"


def test_default_folder_carries_the_date_and_json_is_all_on_standard_output(monkeypatch, capsys, tmp_path, hop) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "fly", hop, *IDEAL, "--headless") == 0
    (first,) = (tmp_path / "flights").iterdir()
    assert first.name.startswith("20")
    capsys.readouterr()
    assert run(monkeypatch, "fly", hop, *IDEAL, "--json", "--vehicle", "mufly-2.0") == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["outcome"] == "succeeded"
    (second,) = set((tmp_path / "flights").iterdir()) - {first}
    assert summary == json.loads((second / "summary.json").read_text())


def test_a_failed_mission_has_a_reason_and_a_status(monkeypatch, capsys, tmp_path, hop) -> None:
    hop.write_text(HOP + "\n[battery]\nlow_V = 7.2\n")
    heavy = tmp_path / "weak.toml"
    from mufly.vehicle import format_vehicle_toml, load_vehicle, replace_parameters

    heavy.write_text(
        format_vehicle_toml(replace_parameters(load_vehicle("mufly-1.1"), {"battery.internal_resistance": 0.55}))
    )
    assert run(monkeypatch, "fly", hop, *IDEAL, "--headless", "--vehicle", heavy, "--out", tmp_path / "out") == 1
    assert "the mission failed: battery low" in capsys.readouterr().err
    assert (tmp_path / "out" / "summary.json").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["--vehicle", "mufly-9"], "mufly-9"),
        (["--wind", "1,2"], "--wind"),
        (["--wind", "a,b,c"], "--wind"),
        (["--wind", "nan,0,0"], "--wind"),
        (["--gust", "-1"], "--gust"),
        (["--gust", "nan"], "--gust"),
        (["--seed", "-1"], "--seed"),
        (["--sensors", "some"], "use one of: fitted, ideal"),
        (["--fault", "sonar.sulks"], "sulks"),
        (["--fault", "sonar.jump", "--sensors", "ideal"], "--sensors ideal"),
        (["--seed", str(10**40)], "--seed"),
        (["--out", "x" * 300], "--out"),
        (["--link", "udp:nowhere"], "--link"),
        (["--link", "udp:127.0.0.1:14599", "--link", "udp:127.0.0.1:14599"], "given twice"),
        (["--host", "no.such.host.invalid"], "--host"),
        (["--host", "0.0.0.0", "--token", "short"], "--token"),
    ],
)
def test_bad_arguments_are_one_clear_line(monkeypatch, capsys, tmp_path, words, message: str) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, "fly", *words) == 1
    shown = capsys.readouterr()
    assert message in shown.err
    assert len(shown.err.strip().splitlines()) == 1
    assert shown.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "message"),
    [(["fly", "--gust", "strong"], "--gust"), (["fly", "--speed", "1"], "--speed"), (["flyy"], "flyy")],
)
def test_a_mistyped_command_line_is_one_line_too(monkeypatch, capsys, words, message: str) -> None:
    # A value that is no quantity is a fault of the input like one that is out of range.
    assert run(monkeypatch, *words) == (1 if message == "--gust" else 2)
    shown = capsys.readouterr()
    assert message in shown.err
    assert ("give a number" if message == "--gust" else "--help") in shown.err
    assert len(shown.err.strip().splitlines()) == 1


def test_what_vehicle_and_mission_cannot_do_together_names_the_file(monkeypatch, capsys, tmp_path, hop) -> None:
    from mufly.vehicle import format_vehicle_toml, load_vehicle, replace_parameters

    high, heavy = tmp_path / "high.toml", tmp_path / "heavy.toml"
    high.write_text(HOP.replace("-0.5]", "-100.0]"))
    heavy.write_text(format_vehicle_toml(replace_parameters(load_vehicle("mufly-1.1"), {"body.mass": 0.2})))
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    for words, place in (
        ([high], f"{high}: waypoint[1].position_m: -100 m"),
        ([hop, "--vehicle", heavy], f"{heavy}: body.mass: too heavy"),
        ([hop, "--out", hop / "below"], f"--out: {hop}: is a file"),
    ):
        assert run(monkeypatch, "fly", *words) == 1
        shown = capsys.readouterr()
        assert place in shown.err
        assert shown.out == ""
    assert run(monkeypatch, "mission", "check", hop, "--vehicle", heavy) == 1
    assert f"{heavy}: body.mass: too heavy" in capsys.readouterr().err
    assert run(monkeypatch, "control", "design", heavy) == 1
    assert f"{heavy}: body.mass: too heavy" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_control_c_leaves_a_readable_recording(tmp_path, hop) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "from mufly.cli import main; main()",
            "fly",
            *IDEAL,
            "--headless",
            "--realtime",
            "--out",
            str(out),
        ],
        stdout=subprocess.DEVNULL,
        env=os.environ,
    )
    recording = out / "flight.mcap"
    for _ in range(600):  # on a busy machine; the reader takes files that are still being written
        time.sleep(0.3)
        try:
            if read_recording(recording).sizes["time"] > 50:
                break
        except InputError:
            continue  # not begun, or no state in it yet
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    read = read_recording(recording)
    assert read.attrs["outcome"] == "interrupted"
    assert read.sizes["time"] > 50


def test_a_page_that_nobody_opens_flies_the_mission_by_itself(monkeypatch, capsys, tmp_path, hop) -> None:
    monkeypatch.setattr("mufly.station.page.page_flight.NO_PAGE_TIMEOUT_S", 0.2)
    out = tmp_path / "out"
    assert run(monkeypatch, "fly", hop, *IDEAL, "--no-browser", "--out", out) == 0
    shown = capsys.readouterr()
    assert "http://127.0.0.1:" in shown.err
    assert "No page was opened" in shown.out
    assert "succeeded" in shown.out
    assert {"flight.mcap", "summary.json", "track.png"} <= {p.name for p in out.iterdir()}
    # What the station heard is kept beside it.
    assert {"station.mcap", "station.tlog"} <= {p.name for p in out.iterdir()}


def test_behind_a_link_it_flies_in_real_time_and_others_hear_it(monkeypatch, tmp_path, hop) -> None:
    out = tmp_path / "out"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        number = listener.getsockname()[1]
        began = time.monotonic()
        words = ("fly", hop, *IDEAL, "--headless", "--link", f"udp:127.0.0.1:{number}", "--out", out)
        assert run(monkeypatch, *words) == 0
        spent = time.monotonic() - began
        assert listener.recv(1000)[0] == 0xFD  # a MAVLink 2 packet
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "succeeded"
    assert spent > 0.95 * summary["duration_s"]
    assert (out / "link.tlog").stat().st_size > 1000


def test_every_command_has_help(monkeypatch, capsys) -> None:
    for words in (
        [],
        ["fly"],
        ["station"],
        ["vehicle"],
        ["vehicle", "show"],
        ["control", "design"],
        ["mission", "check"],
    ):
        assert run(monkeypatch, *words, "--help") == 0
        assert "Usage" in capsys.readouterr().out
    assert run(monkeypatch, "--version") == 0
    assert "mufly 0" in capsys.readouterr().out


def test_what_a_camera_needs_is_said_before_the_flight(monkeypatch, capsys, tmp_path, hop) -> None:
    for words, said in (
        (("--camera", "webcam"), "needs --position camera"),
        (("--position", "camera", *IDEAL), "the true state needs no camera"),
        (("--position", "camera", "--floor", "rihc"), "did you mean 'rich'"),
        (("--position", "camera", "--camera-fault", "blind@3s"), "use one of: covered, dark, unplugged"),
    ):
        assert run(monkeypatch, "fly", hop, "--out", tmp_path / "out", "--headless", *words) == 1
        assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()
