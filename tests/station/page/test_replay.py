"""A recording behind the same seam as a vehicle."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.flight import fly
from mufly.mission import mission_from
from mufly.station.replay import Recording, Replay, open_recording

HOP = {
    "take_off": {"height_m": 0.5, "wait_s": 0.5},
    "waypoint": [{"position_m": [0.4, 0.0, -0.5], "wait_s": 0.5}],
    "box": [{"name": "far box", "centre_m": [3.0, 3.0, -0.5], "size_m": [1.0, 1.0, 1.0]}],
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("replay") / "hop.mcap"
    fly("mufly-1.1", mission_from(HOP), path=path)
    return open_recording(path)


@pytest.fixture
def replay(recording: Recording) -> Replay:
    return Replay(recording)


def test_it_carries_its_mission_and_its_world(recording: Recording) -> None:
    assert recording.mission is not None
    assert recording.mission.world.boxes[0].name == "far box"
    assert len(recording.range_angles) == 8
    assert recording.range_angles[0] == pytest.approx(math.radians(22.5))
    assert recording.range_max_m == pytest.approx(1.5)
    assert recording.facts["outcome"] == "succeeded"


def test_the_moment_that_is_shown_is_that_of_the_file(replay: Replay) -> None:
    k = len(replay.recording.times) // 2
    replay.seek(float(replay.recording.times[k]))
    s = replay.snapshot
    columns = replay.recording.columns
    assert s.time_s == replay.recording.times[k]
    assert s.estimate.position.tolist() == [columns[f"measured_position_{a}"][k] for a in "NED"]
    assert s.rotor_speed.tolist() == [columns[f"truth_rotor_speed_{r}"][k] for r in ("upper", "lower")]
    assert s.state == replay.recording.states[k]
    assert s.connected
    assert s.armed
    assert s.flying


def test_nothing_of_the_future_is_shown(replay: Replay) -> None:
    replay.seek(replay.start_s + 3.0)
    times, values = replay.history.window(100.0, ["measured_position_D", "no such signal"])
    assert times[-1] <= replay.time_s
    assert values.shape == (len(times), 2)
    assert np.isnan(values[:, 1]).all()
    assert all(m.time_s <= replay.time_s for m in replay.messages)
    before = len(replay.messages)
    replay.seek(replay.end_s)
    assert len(replay.messages) > before


def test_the_mission_goes_on_as_it_went_then(replay: Replay) -> None:
    assert [r.action for r in replay.mission] == ["take off", "waypoint", "land"]
    reached = []
    for time_s in np.linspace(replay.start_s, replay.end_s, 200):
        replay.seek(float(time_s))
        reached.append(sum(r.reached for r in replay.mission))
    assert reached[0] == 0
    assert reached[-1] == 3
    assert all(b >= a for a, b in pairwise(reached))


def test_play_pause_speed_and_the_end(replay: Replay) -> None:
    replay.advance(5.0)
    assert replay.time_s == replay.start_s  # it does not play yet
    replay.play()
    replay.speed = 4.0
    replay.advance(0.5)
    assert replay.time_s == pytest.approx(replay.start_s + 2.0)
    jumps = replay.jumps
    replay.pause()
    replay.advance(1.0)
    assert replay.time_s == pytest.approx(replay.start_s + 2.0)
    assert replay.jumps == jumps  # playing is no jump
    replay.play()
    replay.advance(1e6)
    assert replay.time_s == replay.end_s
    assert not replay.playing
    replay.play()  # from the beginning
    assert replay.time_s == replay.start_s
    for nonsense in (math.nan, -1e9, 1e9):
        replay.seek(nonsense)
        assert replay.start_s <= replay.time_s <= replay.end_s


def test_two_viewers_share_a_recording_and_not_their_place(recording: Recording) -> None:
    one, two = Replay(recording), Replay(recording)
    one.seek(one.end_s)
    assert two.time_s == two.start_s
    assert len(two.history.window(1e9, ["measured_position_N"])[0]) == 1


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
    assert replay.mission == []


def test_what_is_no_recording_is_said_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"nonsense" * 100)
    with pytest.raises(InputError):
        open_recording(path)
