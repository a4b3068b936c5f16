"""A learned policy flies a mission from the command line, and is refused where it does not belong."""

from __future__ import annotations

import dataclasses
import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

from mufly import cli
from mufly.flight.policy import LearnedPolicy, PolicyControlLaw, PolicyLayer, save_policy
from mufly.flight.policy.observation import OBS_HEADING, OBS_POSITION_ERROR, OBS_RATES, OBS_SUPPLY_VOLTAGE, OBS_VELOCITY

HOP = """
[take_off]
height_m = 0.5
wait_s = 0.2

[[waypoint]]
position_m = [0.3, 0.0, -0.5]
wait_s = 0.2
"""


def proportional_policy() -> LearnedPolicy:
    """A network of one linear layer: proportional and derivative control, with the battery's voltage made up for."""
    gain = np.zeros((4, 20))
    gain[0, OBS_POSITION_ERROR + 2], gain[0, OBS_VELOCITY + 2], gain[0, OBS_SUPPLY_VOLTAGE] = -1.5, 1.5, -2.4
    gain[1, OBS_HEADING], gain[1, OBS_RATES + 2] = 1.0, -0.5
    for i in range(2):
        gain[2 + i, OBS_POSITION_ERROR + i], gain[2 + i, OBS_VELOCITY + i] = 0.5, -0.7
    return LearnedPolicy(
        "hover", "mufly-1.1", 0.02, np.array([0.678, 0.745, 0.0, 0.0]), 7.2, np.zeros(20), np.ones(20), 50.0,
        (PolicyLayer(gain, np.array([-0.033, 0.0, 0.0, 0.0]), "linear"),),
    )  # fmt: skip


@pytest.fixture
def file(tmp_path: Path) -> Path:
    save_policy(proportional_policy(), tmp_path / "policy.json")
    (tmp_path / "hop.toml").write_text(HOP)
    return tmp_path / "policy.json"


def run(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr(sys, "argv", ["mufly", *map(str, words)])
    try:
        cli.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def test_policy_flies_a_mission_and_the_summary_is_the_same(monkeypatch, capsys, tmp_path, file) -> None:
    words = ("fly", tmp_path / "hop.toml", "--sensors", "ideal", "--policy", file, "--out", tmp_path / "out", "--json")
    assert run(monkeypatch, *words) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["outcome"] == "succeeded"
    assert summary["waypoints_reached"] == 1
    assert summary["touchdown_speed_m_s"] < 0.5


@pytest.mark.parametrize(("words", "line"), [
    (("fly", "--vehicle", "mufly-2.0"), "vehicle: trained for mufly-1.1, not for mufly-2.0; fly mufly-1.1, or train"),
    (("fly", "--firmware"), "--policy: cannot be combined with --firmware; give one of the two"),
    (("monte-carlo", "--vehicle", "mufly-2.0"), "vehicle: trained for mufly-1.1, not for mufly-2.0"),
])  # fmt: skip
def test_policy_of_another_vehicle_is_refused(monkeypatch, capsys, tmp_path, file, words, line) -> None:
    more = ("--headless",) if words[0] == "fly" else ()
    assert run(monkeypatch, *words, *more, "--policy", file, "--out", tmp_path / "out") != 0
    told = " ".join(capsys.readouterr().err.split())
    assert line in told
    assert not (tmp_path / "out" / "flight.mcap").exists()


def test_command_writes_the_policy_as_c(monkeypatch, capsys, tmp_path, file) -> None:
    assert run(monkeypatch, "firmware", "policy", file, "--out", tmp_path / "c") == 0
    assert "network 20 x 4, 84 numbers" in " ".join(capsys.readouterr().out.split())
    text = (tmp_path / "c" / "policy" / "policy_numbers.c").read_text()
    assert text.count("REAL(") == 4 * 20 + 80 + 4 + 4 + 3
    assert "malloc" not in "".join(p.read_text() for p in (tmp_path / "c").rglob("*.[ch]"))


def test_control_law_reaches_another_process_and_its_name_follows_the_numbers() -> None:
    law = PolicyControlLaw(proportional_policy())
    assert pickle.loads(pickle.dumps(law)).__name__ == law.__name__
    assert PolicyControlLaw(dataclasses.replace(law.policy, observation_limit=10.0)).__name__ != law.__name__
