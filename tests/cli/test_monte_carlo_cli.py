"""`mufly monte-carlo` as a user calls it."""

import json
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

from mufly import cli
from mufly.flight import read_recording

HOP = """
[take_off]
height_m = 0.4
wait_s = 0.2

[[waypoint]]
position_m = [0.1, 0.0, -0.4]
wait_s = 0.1
"""


def run(monkeypatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["mufly", *map(str, words)])
    try:
        cli.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_failed_flights_are_recorded_and_their_command_flies_them_again(monkeypatch, capsys, tmp_path: Path) -> None:
    """A tolerance of a tenth of a millimetre fails every flight."""
    hop, out = tmp_path / "hop.toml", tmp_path / "out"
    hop.write_text(HOP)
    words = ("monte-carlo", hop, "--flights", 2, "--jobs", 1, "--sensors", "ideal", "--out", out, "--seed", 5)
    words += (
        "--vary",
        "parameters=5%",
        "--vary",
        "m=+-2g",
        "--wind",
        "0.3",
        "--gust",
        "0.1",
        "--tolerance",
        "1e-4",
        "--method",
        "ltr",
    )
    assert run(monkeypatch, *words) == 0
    shown = capsys.readouterr().out
    assert "0 of 2 flights succeeded, 0 %" in shown
    assert "The state machine reports 2 successes." in shown
    for name in ("flights.nc", "flights.csv", "flights.jsonl", "flights-distributions.png", "summary.json"):
        assert (out / name).stat().st_size > 0
    command = shlex.split((out / "failed" / "00001" / "command.txt").read_text())
    assert command[0] == "mufly"
    assert command[command.index("--method") + 1] == "ltr"
    command[command.index("--out") + 1] = str(tmp_path / "again")
    assert run(monkeypatch, *command[1:], "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["outcome"] == "succeeded"
    first, again = (read_recording(p / "flight.mcap") for p in (out / "failed" / "00001", tmp_path / "again"))
    np.testing.assert_array_equal(first.truth_position, again.truth_position)
    np.testing.assert_array_equal(first.servo_input, again.servo_input)
    assert again.attrs["designed_for"] == "mufly-1.1"


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--vary", "m=+-2furlong"), "mufly: --vary: m=+-2furlong: unit 'furlong' in '2 furlong' is unknown"),
        (("--wind", "fast"), "--wind: 'fast' is not a number; give a number"),
        (("--flights", "0"), "--flights: no flights"),
        (("--tolerance", "0"), "--tolerance: 0 m"),
        (("--fault", "sonar.jump"), "--fault: sonar.jump@0s: the true state has no sensor faults"),
        (("--flights", "0", "--search", "3"), "--search: only the noise varies"),
    ],
)
def test_wrong_options_are_said_in_one_line(monkeypatch, capsys, tmp_path: Path, words, why: str) -> None:
    assert run(monkeypatch, "monte-carlo", "--sensors", "ideal", "--jobs", 1, "--out", tmp_path, *words) == 1
    said = capsys.readouterr().err
    assert why in said
    assert len(said.splitlines()) == 1
