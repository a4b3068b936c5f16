"""What a station keeps on disk, whatever happens to it."""

from __future__ import annotations

import shutil
from collections import namedtuple
from datetime import datetime

import numpy as np
import orjson
import pytest
from mock_vehicle import BEGIN_S, MockVehicle, World

from mufly.errors import InputError
from mufly.flight import read_recording
from mufly.link import FrameDecoder
from mufly.logs import read_log, read_mcap
from mufly.station import StationRecorder

DAY_S = 1.9e9


def recorded(tmp_path, *vehicles):
    """A world whose vehicles are recorded, the clock of the day running with it."""
    world = World(*vehicles)
    said = []
    recorder = StationRecorder(tmp_path, on_end=said.append, wall_s=lambda: DAY_S + world.t - BEGIN_S)
    world.station._on_vehicle = recorder.attach_vehicle
    world.station._on_packet = recorder.record_packet
    return world, recorder, said


def test_the_first_recording_may_stand_beside_that_of_the_vehicle(tmp_path):
    recorder = StationRecorder(tmp_path, first_here=True, wall_s=lambda: DAY_S)
    for k in range(2):
        recorder.start_recording()
        recorder.stop_recording()
        assert (recorder.path == tmp_path) is (k == 0)
    assert len(list(tmp_path.rglob("station.tlog"))) == 2
    names = []
    for _ in range(3):  # within one second
        recorder.start_recording()
        names.append(recorder.path.name)
        recorder.stop_recording()
    stamp = datetime.fromtimestamp(DAY_S).strftime("%Y-%m-%d_%H-%M-%S")
    assert names == [f"{stamp}_2", f"{stamp}_3", f"{stamp}_4"]


def test_signals_messages_and_marks_are_kept(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle(rate_Hz=100.0))
    world.run(2.0)  # it is begun later than the vehicle
    recorder.start_recording()
    world.run(5.0)
    assert recorder.add_mark("look here")
    world.run(1.0)
    recorder.stop_recording()
    data = read_recording(recorder.path / "station.mcap")
    assert data.attrs["complete"]
    assert data.attrs["vehicle"] == "PX4 hexarotor, system 1"
    seen = np.isfinite(data["estimated_position"].sel(axis="N"))
    # The mock moves north at 1 m/s on the same clock.
    np.testing.assert_allclose(data["estimated_position"].sel(axis="N")[seen], data["time"][seen], atol=0.011)
    assert len(data["time"]) == pytest.approx(600, abs=20)
    # The vehicle's clock began with ours: its instant 0 is that of the day at which the recording was begun.
    assert datetime.fromisoformat(data.attrs["start_time"]).timestamp() == pytest.approx(DAY_S, abs=0.05)
    assert data["event_text"].values.tolist()[-1] == "mark: look here"


def test_the_3d_view_of_a_vehicle_that_tells_no_truth_shows_what_it_believes(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle())
    recorder.start_recording()
    world.run(5.0)
    recorder.stop_recording()
    poses = read_mcap(recorder.path / "station.mcap").messages_by_topic["/tf"]
    assert len(poses) == pytest.approx(100, abs=5)
    last = orjson.loads(poses[-1][1])["transforms"][1]["translation"]
    assert last["x"] == pytest.approx(5.0, abs=0.2)


def test_all_packets_are_kept_both_ways_and_can_be_read(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle())
    recorder.start_recording()
    world.run(3.0)
    recorder.stop_recording()
    data = (recorder.path / "station.tlog").read_bytes()
    stamps = int.from_bytes(data[:8], "big") / 1e6
    assert 0.0 < stamps - DAY_S < 1.5
    codec, at, senders = FrameDecoder(), 0, []
    while at < len(data):
        size = 12 + data[at + 9]
        (message,) = codec.decode_bytes(0.0, "tlog", data[at + 8 : at + 8 + size])
        senders.append(message.get_srcSystem())
        at += 8 + size
    assert senders.count(1) > 100
    assert senders.count(255) > 10
    log = read_log(recorder.path / "station.tlog")
    assert len(log["time"]) > 40


def test_it_can_be_read_up_to_the_last_second_after_a_kill(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle(rate_Hz=100.0))
    recorder.start_recording()
    world.run(10.0)
    (tmp_path / "cut").mkdir()
    cut = shutil.copy(recorder.path / "station.mcap", tmp_path / "cut")
    data = read_recording(cut)
    assert not data.attrs["complete"]
    assert world.t - BEGIN_S - float(data["time"][-1]) < 1.2
    recorder.stop_recording()


def test_a_full_disk_ends_the_recording_with_a_message_and_not_the_station(tmp_path, monkeypatch):
    free, looked = [57e6], []
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda place: looked.append(place) or usage(1e9, 1e9, free[0]))
    world, recorder, said = recorded(tmp_path / "not" / "there yet", MockVehicle())
    recorder.check_disk_space_if_due(world.t)
    assert recorder.free_bytes == 57e6
    assert looked == [tmp_path]  # the nearest folder that is there
    recorder.start_recording()
    world.run(3.0)
    recorder.check_disk_space_if_due(100.0)
    assert recorder.recording  # there is room for a while
    free[0] = 49.4e6
    recorder.check_disk_space_if_due(104.9)
    assert recorder.recording
    recorder.check_disk_space_if_due(105.1)  # it looks every five seconds
    assert not recorder.recording
    assert said == ["the recording has ended: the disk is full (49 MB left)"]
    assert world.seen[0].status_messages[-1].text == said[0]
    world.run(1.0)
    assert world.seen[0].snapshot.connected
    data = read_recording(recorder.path / "station.mcap")
    assert data.attrs["outcome"] == "interrupted"
    recorder.check_disk_space_if_due(200.0)  # what does not run does not end again
    assert len(said) == 1


def test_a_write_that_fails_ends_the_recording_with_a_message(tmp_path):
    world, recorder, said = recorded(tmp_path, MockVehicle())
    recorder.start_recording()
    world.run(2.0)

    class Full:
        def write_packet(self, *_):
            raise OSError(28, "No space left on device")

        def close(self):
            raise OSError(28, "No space left on device")

    recorder._tlog = Full()
    world.run(1.0)
    assert not recorder.recording
    assert said == ["the recording has ended: the tlog cannot be written (No space left on device)"]
    assert world.seen[0].snapshot.connected


def test_recordings_follow_each_other_in_folders_of_their_own(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle())
    recorder.start_recording()
    world.run(2.0)
    first = recorder.path
    recorder.stop_recording()
    recorder.start_recording()
    assert recorder.path != first
    world.run(2.0)
    recorder.stop_recording()
    ends = [float(read_recording(p / "station.mcap")["time"][-1]) for p in (first, recorder.path)]
    assert ends[0] < ends[1]
    assert not recorder.add_mark("nobody writes")
    assert world.seen[0].add_mark("nor here").answer.startswith("not recorded")


def test_every_vehicle_has_a_file(tmp_path):
    world, recorder, _ = recorded(tmp_path, MockVehicle(system=1), MockVehicle(system=2))
    recorder.start_recording()
    world.run(3.0)
    recorder.stop_recording()
    systems = [read_recording(recorder.path / n).attrs["system"] for n in ("station.mcap", "station-2.mcap")]
    assert sorted(systems) == [1, 2]


def test_a_vehicle_that_starts_anew_stays_in_one_recording(tmp_path):
    mock = MockVehicle()
    world, recorder, said = recorded(tmp_path, mock)
    recorder.start_recording()
    world.run(5.0)
    mock.restart()
    world.run(5.0)
    recorder.stop_recording()
    assert said == []
    times = read_recording(recorder.path / "station.mcap")["time"].values
    assert (np.diff(times) > 0).all()
    assert times[-1] > 8.0


def test_a_folder_that_cannot_be_made_is_told_at_once(tmp_path):
    (tmp_path / "taken").write_text("")
    recorder = StationRecorder(tmp_path / "taken")
    with pytest.raises(InputError, match="cannot be written"):
        recorder.start_recording()
    assert not recorder.recording
