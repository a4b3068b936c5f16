"""Unmodified MAVProxy, its commands piped in, flies `mufly link`.

MAVProxy is GPL and heavy (it brings opencv), so it is no dependency: it is run as a program, found by the environment
variable MUFLY_MAVPROXY or on PATH.
"""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

PROGRAM = os.environ.get("MUFLY_MAVPROXY") or shutil.which("mavproxy.py")
if PROGRAM is None:
    pytest.skip(
        "no MAVProxy: python -m venv /tmp/mavproxy && /tmp/mavproxy/bin/pip install mavproxy 'setuptools<80', then "
        "MUFLY_MAVPROXY=/tmp/mavproxy/bin/mavproxy.py pytest tests/interop",
        allow_module_level=True,
    )

DRIVER = Path(__file__).parent / "fly_mavproxy.py"
FLIGHTS = {"mavproxy": (["demonstration"], [sys.executable, str(DRIVER), PROGRAM, "{port}"])}


def test_it_lists_waypoints_takes_off_and_lands(flights: dict[str, Any]) -> None:
    said = flights["mavproxy"].finish(240.0)
    for line in ("parameters", "waypoints listed", "armed", "in the air", "landed and disarmed"):
        assert f"== {line}" in said or f" {line}\n" in said, f"{line}\n{said}"
    flight = flights["mavproxy"].recording()
    height = -flight["truth_position"].values[:, 2]
    assert 0.7 < height.max() < 0.95  # it was told 0.8 m
    assert height[-1] < 0.1
