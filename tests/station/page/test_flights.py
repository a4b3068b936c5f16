"""The list of flights: what recordings say of themselves, and those that cannot be read; without a browser."""

import math
import os
import time
from pathlib import Path

import numpy as np
import pytest

from mufly.flight import FlightRecorder
from mufly.logs import read_recording, read_recording_summary
from mufly.station.page.flight_list import (
    FlightFacts,
    has_better_recording,
    make_flight_row,
    read_flight_facts,
    recording_read_sort_key,
)

BEGAN_S = 1_700_000_000.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight of 3 s, whole and cut off, a table of another's, and files that are no logs."""
    folder = tmp_path_factory.mktemp("list") / "flight"  # flights in folders beside each other find one another
    folder.mkdir()
    about = {"vehicle": "mufly-1.1", "mission": "square"}
    with FlightRecorder(folder / "flight.mcap", about, start_time_ns=int(BEGAN_S * 1e9), keep=False) as recorder:
        for k in range(301):
            row = np.full(recorder.layout.column_count, 0.5)
            row[0] = 0.01 * k
            recorder.append_row(row, "hover")
        recorder.set_outcome("failed", "battery low")
    whole = (folder / "flight.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: int(0.8 * len(whole))])
    (folder / "stump.mcap").write_bytes(whole[:40])
    (folder / "noise.bin").write_bytes(bytes(range(256)) * 9)
    (folder / "empty.ulg").write_bytes(b"")
    lines = [f"{0.1 * k:.1f},{k % 7}" for k in range(50)]
    (folder / "table.csv").write_text("\n".join(["time,height", *lines]))
    for name in ("cut.mcap", "stump.mcap"):
        os.utime(folder / name, (BEGAN_S, BEGAN_S))
    return folder


def test_the_facts_of_a_recording_are_those_of_the_whole_of_it(folder: Path) -> None:
    facts, whole = read_recording_summary(folder / "flight.mcap"), read_recording(folder / "flight.mcap")
    assert whole.attrs.items() <= facts.items()
    assert facts["duration_s"] == pytest.approx(float(whole["time"][-1] - whole["time"][0]), abs=1e-6)
    assert read_flight_facts(folder / "flight.mcap") == FlightFacts(
        "MCAP", pytest.approx(BEGAN_S), pytest.approx(3.0), "mufly-1.1", "square", "failed: battery low"
    )


def test_a_recording_without_its_end_is_cut_off_or_goes_on(folder: Path) -> None:
    cut = read_flight_facts(folder / "cut.mcap")
    assert (cut.outcome, cut.read_error, cut.vehicle) == ("incomplete", "", "mufly-1.1")
    assert 1.0 < cut.duration_s < 3.0
    now = time.time()
    os.utime(folder / "cut.mcap", (now, now))
    assert read_flight_facts(folder / "cut.mcap").outcome == "being recorded"


def test_what_cannot_be_read_says_why_and_what_is_of_others_says_what_it_can(folder: Path) -> None:
    for name, words in (
        ("stump.mcap", "contains no messages"),
        ("noise.bin", "not a log in a known format"),
        ("empty.ulg", "is empty"),
    ):
        found = read_flight_facts(folder / name)
        assert words in found.read_error
        assert str(folder) not in found.read_error
    table = read_flight_facts(folder / "table.csv")
    assert (table.file_format, table.read_error, table.mission) == ("CSV", "", "")
    assert table.duration_s == pytest.approx(4.9)


def test_a_row_stands_before_the_file_is_read_and_after(folder: Path) -> None:
    path = folder / "flight.mcap"
    early = make_flight_row(path, folder.parent, None)
    assert (early["known"], early["length"], early["start"]) == (False, None, path.stat().st_mtime)
    late = make_flight_row(path, folder.parent, read_flight_facts(path))
    assert late["name"] == f"{folder.name}/flight.mcap"
    assert (late["known"], late["length"], late["start"]) == (
        True,
        pytest.approx(3.0),
        pytest.approx(BEGAN_S),
    )
    assert not math.isnan(late["start"])


def test_one_row_a_flight(tmp_path: Path) -> None:
    """What the vehicle wrote stands for a flight; without it the station's signals; packets only by themselves."""
    names = "a/flight.mcap a/station.mcap a/station.tlog a/link.tlog a/mine.csv b/station.mcap b/station-2.mcap"
    for name in (names + " b/station.tlog c/station.tlog c/mine.csv").split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    beside = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.*") if has_better_recording(p)}
    assert beside == {"a/station.mcap", "a/station.tlog", "a/link.tlog", "b/station.tlog"}


def test_a_recording_that_grows_is_read_as_fast_as_a_finished_one_and_last(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its chunks are not unpacked; of the files that wait to be read it holds up none."""

    def never(path: Path) -> None:
        raise AssertionError(f"{path} is read whole")

    monkeypatch.setattr("mufly.logs.mcap_recording.read_mcap", never)
    facts = read_recording_summary(folder / "cut.mcap")
    assert (facts["vehicle"], facts["mission"], facts["complete"]) == ("mufly-1.1", "square", False)
    assert 1.0 < facts["duration_s"] < 3.0
    now = time.time()
    for name, age_s in (("cut.mcap", 0.0), ("flight.mcap", 60.0), ("table.csv", 60.0)):
        os.utime(folder / name, (now - age_s, now - age_s))
    assert sorted((folder / n for n in ("table.csv", "cut.mcap", "flight.mcap")), key=recording_read_sort_key) == [
        folder / n for n in ("flight.mcap", "cut.mcap", "table.csv")
    ]
