"""Vehicles that lie: a short run, and its findings.

A long run, printed: ``pytest -s tests/station/test_fuzz.py --fuzz-messages 1000000 [--fuzz-seed N]``. Its last test
sends a tenth as many to a page in a browser, a thousand a second; without the option it is skipped.
"""

from __future__ import annotations

import math
from pathlib import Path

import fuzz_station
import numpy as np
import pytest

from mufly.link import FrameEncoder
from mufly.link import mavlink as m
from mufly.station import GroundLink, SignalHistory

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def test_lying_vehicles_break_nothing(request: pytest.FixtureRequest) -> None:
    long = request.config.getoption("--fuzz-messages")
    if long:
        found = fuzz_station.fuzz(long, request.config.getoption("--fuzz-seed"))
        fuzz_station.report(found)
    else:
        found = fuzz_station.fuzz(12_000, 3, samples=4)
    assert found.faults == []
    assert found.vehicles > 5
    assert found.requests > 20
    assert found.open_requests == 0
    assert found.honest_off < 1e-6
    assert found.bytes_out < found.bytes_in


def test_a_page_in_a_browser_stays_usable(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A long run only: its judgement depends on the speed of the machine."""
    long = request.config.getoption("--fuzz-messages")
    if not long:
        pytest.skip("runs with --fuzz-messages N")
    pytest.importorskip("playwright.sync_api", reason="no playwright installed")
    monkeypatch.syspath_prepend(BENCHMARKS)  # frozen_page
    assert fuzz_station.watch_page(max(1, long // 10), request.config.getoption("--fuzz-seed"), 1000.0)


def heard(ground: GroundLink, *messages: object) -> None:
    encode = FrameEncoder(9, 1)
    for message in (m.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3), *messages):
        ground.process_bytes(1.0, "liar", encode(message))


@pytest.mark.parametrize(
    "place",
    [
        m.MAVLink_gps_global_origin_message(2**31 - 1, 5, 0, 0),
        m.MAVLink_gps_global_origin_message(900_000_000, 5, 0, 0),
        m.MAVLink_global_position_int_message(0, -(2**31), 2**31 - 1, 0, 0, 0, 0, 0, 0),
    ],
)
def test_an_origin_that_is_no_place_on_earth_is_none(place: object) -> None:
    ground = GroundLink()
    heard(ground, place)
    (vehicle,) = ground.vehicles
    assert vehicle.telemetry.origin is None
    request = vehicle.go_to((1.0, 0.0, -1.0))
    ground.take_due_frames(1.1)
    assert "not reported its origin" in request.answer


@pytest.mark.parametrize("far", [1e6, 1e30, 1e300])
def test_what_does_not_fit_into_a_message_is_sent_as_far_as_it_does(far: float) -> None:
    """It is out of reach in any case, and the vehicle says so; the station must not stumble."""
    ground = GroundLink()
    heard(ground, m.MAVLink_gps_global_origin_message(470_000_000, 80_000_000, 400_000, 0))
    (vehicle,) = ground.vehicles
    vehicle.go_to((far, -far, -far))
    vehicle.take_off(far)
    sent = [out for k in range(30) for out in ground.take_due_frames(1.0 + 0.1 * k)]
    assert sent


def test_a_history_takes_memory_as_it_fills() -> None:
    """Thirty-two vehicles that say nothing but that they are there must not cost 19 MB each."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("needs /proc to see what memory is in use")
    before = int(statm.read_text().split()[1])
    histories = [SignalHistory() for _ in range(32)]
    for history in histories:
        history.append_row(0.0, np.zeros(len(history.names)))
        assert math.isnan(history.recent_rows(1.0, ["no such signal"])[1][0, 0])
    pages = int(statm.read_text().split()[1]) - before
    assert pages * 4096 < 50e6
