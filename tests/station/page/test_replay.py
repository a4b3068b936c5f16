"""A recording behind the same seam as a vehicle."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.flight import fly_mission
from mufly.mission import parse_mission
from mufly.station.replay import FlightRecording, Replay, open_recording

HOP = {
    "take_off": {"height_m": 0.5, "wait_s": 0.5},
    "waypoint": [{"position_m": [0.4, 0.0, -0.5], "wait_s": 0.5}],
    "box": [{"name": "far box", "centre_m": [3.0, 3.0, -0.5], "size_m": [1.0, 1.0, 1.0]}],
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> FlightRecording:
    path = tmp_path_factory.mktemp("replay") / "hop.mcap"
    fly_mission("mufly-1.1", parse_mission(HOP), path=path)
    return open_recording(path)


@pytest.fixture
def replay(recording: FlightRecording) -> Replay:
    return Replay(recording)


def test_it_carries_its_mission_and_its_world(recording: FlightRecording) -> None:
    assert recording.mission is not None
    assert recording.mission.world.boxes[0].name == "far box"
    assert len(recording.range_angles) == 8
    assert np.degrees(recording.range_angles) == pytest.approx(22.5 + 45.0 * np.arange(8))
    assert recording.range_max_m == pytest.approx(1.5)
    assert recording.recording_facts["outcome"] == "succeeded"


def test_the_moment_that_is_shown_is_that_of_the_file(replay: Replay) -> None:
    k = len(replay.recording.times_s) // 2
    replay.seek(float(replay.recording.times_s[k]))
    s = replay.snapshot
    columns = replay.recording.columns
    assert s.time_s == replay.recording.times_s[k]
    assert s.estimate.position.tolist() == [columns[f"measured_position_{a}"][k] for a in "NED"]
    assert s.rotor_speed.tolist() == [columns[f"truth_rotor_speed_{r}"][k] for r in ("upper", "lower")]
    assert s.state == replay.recording.mission_states[k]
    assert s.connected
    assert s.armed
    assert s.flying


def test_nothing_of_the_future_is_shown(replay: Replay) -> None:
    replay.seek(replay.start_s + 3.0)
    times, values = replay.history.recent_rows(100.0, ["measured_position_D", "no such signal"])
    assert times[-1] <= replay.time_s
    assert values.shape == (len(times), 2)
    assert np.isnan(values[:, 1]).all()
    assert all(m.time_s <= replay.time_s for m in replay.status_messages)
    before = len(replay.status_messages)
    replay.seek(replay.end_s)
    assert len(replay.status_messages) > before
    times, _ = replay.history.recent_rows(0.5, ["measured_position_D"])
    assert (times[0], times[-1]) == (pytest.approx(replay.end_s - 0.5, abs=0.011), replay.end_s)


def test_the_mission_goes_on_as_it_went_then(replay: Replay) -> None:
    assert [r.action for r in replay.mission_rows] == ["take off", "waypoint", "land"]
    reached = []
    for time_s in np.linspace(replay.start_s, replay.end_s, 200):
        replay.seek(float(time_s))
        reached.append(sum(r.reached for r in replay.mission_rows))
    assert reached[0] == 0
    assert reached[-1] == 3
    assert all(b >= a for a, b in pairwise(reached))
    # A row is behind it from the sample on at which it hovers.
    times, states = replay.recording.times_s, replay.recording.mission_states.tolist()
    for row, leg in enumerate(("take-off", "waypoint")):
        k = next(k for k, (a, b) in enumerate(pairwise(states), 1) if (a, b) == (leg, "hover"))
        replay.seek(float(times[k - 1]))
        assert (replay.passed_row_count, replay.snapshot.mission_row) == (row, row)
        replay.seek(float(times[k]))
        assert (replay.passed_row_count, replay.snapshot.mission_row) == (row + 1, row + 1)
        assert replay.snapshot.flying
    for time_s in (replay.start_s, replay.end_s):
        replay.seek(time_s)
        assert not replay.snapshot.flying


def test_play_pause_speed_and_the_end(replay: Replay) -> None:
    replay.advance_playback(5.0)
    assert replay.time_s == replay.start_s  # it does not play yet
    replay.play()
    replay.advance_playback(0.5)
    assert replay.time_s == pytest.approx(replay.start_s + 0.5)
    replay.speed = 4.0
    replay.advance_playback(0.375)
    assert replay.time_s == pytest.approx(replay.start_s + 2.0)
    jumps = replay.jumps
    replay.pause()
    replay.advance_playback(1.0)
    assert replay.time_s == pytest.approx(replay.start_s + 2.0)
    assert replay.jumps == jumps  # playing is no jump
    replay.play()
    replay.advance_playback(1e6)
    assert replay.time_s == replay.end_s
    assert not replay.playing
    replay.play()  # from the beginning
    assert replay.time_s == replay.start_s
    for nonsense in (math.nan, -1e9, 1e9):
        replay.seek(nonsense)
        assert replay.start_s <= replay.time_s <= replay.end_s


def test_two_viewers_share_a_recording_and_not_their_place(recording: FlightRecording) -> None:
    one, two = Replay(recording), Replay(recording)
    one.seek(one.end_s)
    assert two.time_s == two.start_s
    assert len(two.history.recent_rows(1e9, ["measured_position_N"])[0]) == 1


def test_a_bare_table_is_a_recording_too(tmp_path: Path) -> None:
    path = tmp_path / "bench.csv"
    rows = "\n".join(f"{k / 50:.2f},{0.01 * k:.3f},{7.4 - k * 1e-3:.3f}" for k in range(100))
    path.write_text("time [s],measured_attitude_roll [rad],battery_voltage [V]\n" + rows + "\n")
    replay = Replay(open_recording(path))
    replay.seek(replay.end_s)
    s = replay.snapshot
    assert s.estimate.attitude[0] == pytest.approx(0.99)
    assert np.isnan(s.estimate.position).all()
    assert s.estimate.battery_voltage == pytest.approx(7.301)
    assert not s.flying
    assert replay.mission_rows == []


def test_beams_of_a_bare_table_stand_evenly_around_the_nose(tmp_path: Path) -> None:
    path = tmp_path / "beams.csv"
    rows = "\n".join(f"{k / 50:.2f},{1 + 0.01 * k:.2f},2.5,,0.5" for k in range(100))
    path.write_text("time [s],range_0 [m],range_1 [m],range_2 [m],range_3 [m]\n" + rows + "\n")
    recording = open_recording(path)
    assert np.degrees(recording.range_angles) == pytest.approx([45.0, 135.0, 225.0, 315.0])
    assert recording.range_max_m == 2.5  # as far as any of them saw
    replay = Replay(recording)
    replay.seek(1.0)
    assert replay.snapshot.estimate.ranges == pytest.approx([1.5, 2.5, math.nan, 0.5], nan_ok=True)


def test_what_is_no_recording_is_said_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"nonsense" * 100)
    with pytest.raises(InputError):
        open_recording(path)
