"""Unmodified pymavlink reads and sets all parameters, moves missions about, and flies."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
URL = "udpin:127.0.0.1:{port}"
FLIGHTS = {
    "pymavlink": ([], [sys.executable, str(ROOT / "docs/examples/fly_with_pymavlink.py"), URL]),
    "parameters": ([], [sys.executable, str(HERE / "fly_pymavlink.py"), URL]),
}


def test_the_script_flies(flights: dict[str, Any]) -> None:
    said = flights["pymavlink"].finish(240.0)
    assert "take-off height was 1.00 m, is 0.80 m" in said
    assert "upload: 0, download: [(0.5, 0.0, -1.0), (0.5, 0.5, -1.0)], clear: 0" in said
    assert said.rstrip().endswith("landed and disarmed")


def test_it_really_was_there(flights: dict[str, Any]) -> None:
    flights["pymavlink"].finish(240.0)
    flight = flights["pymavlink"].recording()
    position = flight["truth_position"].values
    assert np.linalg.norm(position - np.array((0.5, 0.3, -1.0)), axis=1).min() < 0.12
    assert position[-1, 2] > -0.1
    assert np.all(flight["motor_input"].values[-1] == 0.0)


def test_all_parameters_and_missions_of_many_sizes(flights: dict[str, Any]) -> None:
    said = flights["parameters"].finish(240.0)
    found = re.search(r"(\d+) parameters, (\d+) changed and set back, kept by the vehicle: (.*)", said)
    assert found is not None
    total, changed = int(found[1]), int(found[2])
    assert total >= 25
    assert changed == total, f"could not be set: {found[3]}"
    for count in (1, 2, 25, 90):
        assert f"mission of {count}: up, down, cleared" in said
    assert "mission under the floor refused" in said
    assert said.rstrip().endswith("end of the list")
