"""Unmodified pymavlink reads and sets all parameters, moves missions about, and flies."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).parent
SCRIPTS = (ROOT / "docs/examples/fly_with_pymavlink.py", HERE / "fly_pymavlink.py")
ONE_AFTER_THE_OTHER = f"""
import subprocess, sys
for script in {[str(path) for path in SCRIPTS]}:
    print("==", script, flush=True)
    subprocess.run([sys.executable, script, "udpin:127.0.0.1:{{port}}"], check=True)
"""
FLIGHTS = {"pymavlink": ([], [sys.executable, "-c", ONE_AFTER_THE_OTHER])}


def said_by(flights: dict[str, Any], script: Path) -> str:
    """What one of the two scripts said, which have the same vehicle after each other."""
    return flights["pymavlink"].finish(300.0).partition(f"== {script}\n")[2].partition("\n== ")[0].rstrip()


def test_the_script_flies(flights: dict[str, Any]) -> None:
    said = said_by(flights, SCRIPTS[0])
    assert "take-off height was 1.00 m, is 0.80 m" in said
    assert "upload: 0, download: [(0.5, 0.0, -1.0), (0.5, 0.5, -1.0)], clear: 0" in said
    assert said.endswith("landed and disarmed")


def test_it_really_was_there(flights: dict[str, Any]) -> None:
    flights["pymavlink"].finish(300.0)
    flight = flights["pymavlink"].recording()
    position = flight["truth_position"].values
    assert np.linalg.norm(position - np.array((0.5, 0.3, -1.0)), axis=1).min() < 0.12
    assert position[-1, 2] > -0.1
    assert np.all(flight["motor_input"].values[-1] == 0.0)


def test_all_parameters_and_missions_of_many_sizes(flights: dict[str, Any]) -> None:
    said = said_by(flights, SCRIPTS[1])
    found = re.search(r"(\d+) parameters, (\d+) changed and set back, kept by the vehicle: (.*)", said)
    assert found is not None
    total, changed = int(found[1]), int(found[2])
    assert total >= 25
    assert changed == total, f"could not be set: {found[3]}"
    for count in (1, 2, 25, 90):
        assert f"mission of {count}: up, down, cleared" in said
    assert "mission under the floor refused" in said
    assert said.endswith("end of the list")
