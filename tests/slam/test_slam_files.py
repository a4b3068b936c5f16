"""Data sets in three layouts, trajectories, calibration, and what is wrong with files."""

from __future__ import annotations

import json
import math
import re
import shutil
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from mufly.camera import (
    LivePictures,
    PictureRecorder,
    StreamServer,
    encode_jpeg,
    load_camera,
    parse_camera,
    project_points,
)
from mufly.cli import app
from mufly.errors import InputError
from mufly.logs import LogWarning, read_recording, write_log
from mufly.slam import (
    CameraFrame,
    SlamSystem,
    calibrate_lens,
    evaluate_trajectory,
    format_camera_toml,
    list_board_pictures,
    make_square_path,
    open_live_pictures,
    open_picture_source,
    read_telemetry_interpolator,
    read_trajectory,
    read_truth_trajectory,
    render_frames,
    run_slam,
    write_dataset,
)
from mufly.slam.calibration.lens_calibration import resize_camera
from mufly.slam.slam_trajectory import SlamTrajectory

CAMERA = load_camera("webcam")


@pytest.fixture(scope="module")
def layouts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    from mufly.camera import make_random_floor

    path = make_square_path(duration_s=0.5, side_m=1.0, seed=1)
    made = list(render_frames(CAMERA, make_random_floor("rich", size=256), path, seed=1))
    out = {}
    for layout in ("mufly", "euroc", "tum"):
        out[layout] = tmp_path_factory.mktemp(layout)
        write_dataset(out[layout], CAMERA, path, made, layout)
    return out


def test_layouts_say_the_same(layouts: dict[str, Path]) -> None:
    sources = {name: open_picture_source(folder, CAMERA) for name, folder in layouts.items()}
    read = {name: list(s.read_frames()) for name, s in sources.items()}
    ours = read["mufly"]
    for name, theirs in read.items():
        assert len(theirs) == len(ours) > 10
        assert (theirs[3].picture == ours[3].picture).all()
        step = theirs[5].time_s - theirs[4].time_s
        assert step == pytest.approx(float(CAMERA.sensor.period), abs=2e-6)
        truth = sources[name].truth
        assert truth is not None
        assert np.ptp(truth[1][:, 2]) < 0.2
        assert truth[1][0] == pytest.approx(sources["mufly"].truth[1][0], abs=1e-5)  # type: ignore[index]
        off = [
            abs(a.vehicle_estimate.roll - b.vehicle_estimate.roll)
            + abs(a.vehicle_estimate.pitch - b.vehicle_estimate.pitch)
            for a, b in zip(theirs, ours, strict=True)
        ]
        assert [b.vehicle_estimate.height_m for b in theirs] == pytest.approx(
            [b.vehicle_estimate.height_m for b in ours], abs=0.01
        )
        assert max(off) < 0.09  # an inertial unit that tilts and accelerates feels both


def test_what_is_wrong_is_one_line(layouts: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="contains no pictures"):
        open_picture_source(tmp_path, CAMERA, height_m=1.0)
    data = encode_jpeg(np.zeros((240, 320), np.uint8), 80)
    (tmp_path / "1.0.jpg").write_bytes(data)
    with pytest.raises(InputError, match="height above the floor; give --height"):
        open_picture_source(tmp_path, CAMERA)
    (tmp_path / "2.0.jpg").write_bytes(data[: len(data) // 3])
    (tmp_path / "3.0.png").write_bytes(encode_jpeg(np.zeros((10, 320, 3), np.uint8), 80))
    source = open_picture_source(tmp_path, CAMERA, height_m=1.0)
    some = source.read_frames()
    assert next(some).time_s == 1.0
    with pytest.raises(InputError, match=r"2\.0\.jpg: is damaged"):
        next(some)
    (tmp_path / "2.0.jpg").unlink()
    some = source.read_frames()
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(InputError, match=r"x\.png: is not a time"):
        open_picture_source(tmp_path, CAMERA, height_m=1.0)
    (tmp_path / "pictures.csv").write_text("time_s,file\n1.0,a.jpg\n0.5,b.jpg\n")
    with pytest.raises(InputError, match=r"b\.jpg: its time, 0\.500000 s, is not after"):
        open_picture_source(tmp_path, CAMERA, height_m=1.0)
    with pytest.raises(InputError, match="no such folder"):
        open_picture_source(tmp_path / "nowhere", CAMERA)
    with pytest.raises(InputError, match="is 320 by 10 pixels"):
        list(open_picture_source(_named(tmp_path, "3.0.png"), CAMERA, height_m=1.0).read_frames())


def test_a_stream_gives_the_trajectory_that_its_folder_gives(layouts: dict[str, Path]) -> None:
    """From the renderer over MJPEG to the trajectory; the sender's clock, so that both are the same."""
    pytest.importorskip("cv2")
    folder = layouts["mufly"]
    source = open_picture_source(folder, CAMERA)
    truth = source.truth
    assert truth is not None
    start = (*truth[1][0, :2], truth[2][0])
    direct = run_slam(SlamSystem(CAMERA, start=start), source.read_frames())
    with StreamServer() as server, LivePictures(server.url, CAMERA, clock="sender", give_up_s=0.2) as live:
        frames = open_live_pictures(live, read_telemetry_interpolator(folder / "telemetry.csv")).read_frames()

        def sent() -> Iterator[CameraFrame]:
            for k, frame in enumerate(source.read_frames()):
                data = (folder / "pictures" / f"{k:06d}.jpg").read_bytes()
                server.publish_picture(data, frame.time_s)
                yield next(frames)

        while not server.client_count:
            time.sleep(0.001)
        streamed = run_slam(SlamSystem(CAMERA, start=start), sent())
    assert len(streamed.time) == len(direct.time) > 10
    assert streamed.time == pytest.approx(direct.time, abs=1e-6)
    assert streamed.position == pytest.approx(direct.position, abs=1e-9)
    off = streamed.position[:, :2] - np.stack([np.interp(streamed.time, truth[0], c) for c in truth[1].T[:2]], axis=1)
    assert np.abs(off).max() < 0.08


def test_pictures_of_a_recording_or_what_is_wrong_with_it(layouts: dict[str, Path], tmp_path: Path) -> None:
    frames = list(open_picture_source(layouts["mufly"], CAMERA).read_frames())
    recorder = PictureRecorder(tmp_path / "camera.mcap", format_camera_toml(CAMERA), 10**18, {"floor": "rich"})
    for f in frames:
        recorder.add_picture(f.time_s, encode_jpeg(f.picture, 95), asdict(f.vehicle_estimate))
    recorder.close()
    for place in (tmp_path, tmp_path / "camera.mcap"):
        back = list(open_picture_source(place, CAMERA).read_frames())
        assert [f.time_s for f in back] == pytest.approx([f.time_s for f in frames], abs=1e-9)
        assert back[4].vehicle_estimate.roll == frames[4].vehicle_estimate.roll
        assert back[4].vehicle_estimate.rotor_phase == pytest.approx(frames[4].vehicle_estimate.rotor_phase)
        assert np.abs(back[4].picture.astype(int) - frames[4].picture).mean() < 3
    whole = (tmp_path / "camera.mcap").read_bytes()
    (tmp_path / "cut").mkdir()
    cut = tmp_path / "cut" / "camera.mcap"
    cut.write_bytes(whole[: len(whole) - 400])
    assert open_picture_source(cut, CAMERA).frame_count == len(frames)  # its index alone is gone
    cut.write_bytes(whole[:2000])
    with pytest.raises(InputError, match=r"contains no pictures; give camera\.mcap of a flight on the camera"):
        open_picture_source(cut, CAMERA)
    cut.write_bytes(b"no such thing")
    with pytest.raises(InputError, match="is not an MCAP file"):
        open_picture_source(cut, CAMERA)
    data = encode_jpeg(np.zeros((240, 320), np.uint8), 80)
    for times, jpeg, why in (
        ((0.0, 0.2, 0.1), data, "picture 3: its time, 0.100000 s, is not after 0.200000 s"),
        ((0.0, 0.1, 0.2), data[:300], r"picture at 0.000 s: is damaged"),
        ((0.0, 0.1, 0.2), encode_jpeg(np.zeros((24, 32), np.uint8), 80), "is 32 by 24 pixels"),
    ):
        recorder = PictureRecorder(cut, "", 10**18, {})
        for t in times:
            recorder.add_picture(t, jpeg, asdict(frames[0].vehicle_estimate))
        recorder.close()
        with pytest.raises(InputError, match=why):
            list(open_picture_source(cut, CAMERA).read_frames())


def test_a_video_with_times_and_a_recording_beside_it(layouts: dict[str, Path], tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    film = tmp_path / "film.avi"
    out = cv2.VideoWriter(str(film), cv2.VideoWriter_fourcc(*"MJPG"), 30, (320, 240))
    for f in list(open_picture_source(layouts["mufly"], CAMERA).read_frames())[:5]:
        out.write(cv2.cvtColor(f.picture, cv2.COLOR_GRAY2BGR))
    out.release()
    with pytest.raises(InputError, match="does not state the height above the floor; give --height or --telemetry"):
        open_picture_source(film, CAMERA)
    told = read_telemetry_interpolator(layouts["mufly"] / "telemetry.csv", -100.0)
    (tmp_path / "film.csv").write_text("time,frame\n" + "".join(f"{100.1 + 0.04 * k},{k}\n" for k in range(5)))
    some = list(open_picture_source(film, CAMERA, told=told).read_frames())
    assert [f.time_s for f in some] == pytest.approx([100.1, 100.14, 100.18, 100.22, 100.26])
    direct = read_telemetry_interpolator(layouts["mufly"] / "telemetry.csv")(np.array([0.1, 0.26]))
    assert [some[k].vehicle_estimate.roll for k in (0, 4)] == pytest.approx([t.roll for t in direct])
    log = tmp_path / "log.mcap"
    t = np.arange(100.0, 101.0, 0.01)
    write_log(xr.Dataset(
        {"estimated_attitude": (("time", "euler"), np.stack([0.1 * (t - 100), 0 * t, 0 * t], axis=1)),
         "estimated_position": (("time", "axis"), np.stack([t, t, -1.0 - 0 * t], axis=1))},
        {"time": t, "euler": ["roll", "pitch", "yaw"], "axis": ["N", "E", "D"]},
    ), log)  # fmt: skip
    one = list(open_picture_source(film, CAMERA, told=read_telemetry_interpolator(log, 0.0)).read_frames())[
        2
    ].vehicle_estimate
    assert (one.roll, one.height_m) == pytest.approx((0.018, 1.0), abs=1e-6)
    with pytest.raises(InputError, match="give --offset: clock of the recording minus clock of the pictures"):
        open_picture_source(film, CAMERA, told=read_telemetry_interpolator(log, -50.0))
    for text, why in (
        ("1\n2\n3\n", "has 3 times, but the video has 5 pictures"),
        ("1\n2\nx\n4\n5\n", "line 3, column 1: 'x' is not a number"),
        ("1\n2\n1.5\n4\n5\n", "row 3: its time, 1.500000 s, is not after"), ("", "is empty"),
    ):  # fmt: skip
        (tmp_path / "film.csv").write_text(text)
        with pytest.raises(InputError, match=why):
            open_picture_source(film, CAMERA, told=told)


def test_what_was_answered_before_a_fault_is_written(layouts: dict[str, Path], tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    folder, out = tmp_path / "damaged", tmp_path / "out"
    shutil.copytree(layouts["mufly"], folder)
    last = sorted((folder / "pictures").iterdir())[-2]
    last.write_bytes(last.read_bytes()[:500])
    said = CliRunner().invoke(app, ["slam", "run", str(folder), "-o", str(out)])
    assert isinstance(said.exception, InputError)
    assert "is damaged" in str(said.exception)
    for name in ("trajectory.txt", "trajectory.mcap", "trajectory.png"):
        assert (out / name).stat().st_size > 500, said.output
    assert len(read_trajectory(out / "trajectory.txt").time) > 8
    assert float(read_recording(out / "trajectory.mcap")["estimated_position_sigma"].max()) < 0.2


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["/dev/video99", "--camera", "webcam", "--height", "1"], "there is no such device"),
        (["http://127.0.0.1:9/stream", "--camera", "webcam", "--height", "1"], "refused"),
        (["http://127.0.0.1:9/stream"], "does not name its camera; give --camera"),
        (["http://127.0.0.1:9/stream", "--camera", "webcam"], "give --height or --telemetry"),
        (["nowhere"], "no such folder, video or recording"),
        ([".", "--clock", "mine"], "--clock"),
        (["FOLDER", "--camera", "webcam"], "camera.toml|is missing|contains no pictures"),
    ],
)
def test_what_is_wrong_with_the_words_is_one_line(words: list[str], why: str, tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["slam", "run", *(str(tmp_path) if w == "FOLDER" else w for w in words)])
    assert isinstance(said.exception, InputError)
    assert re.search(why, str(said.exception)), said.exception


def _named(folder: Path, name: str) -> Path:
    out = folder / "one"
    out.mkdir()
    (out / name).write_bytes((folder / name).read_bytes())
    return out


def test_a_trajectory_comes_back_with_its_covariance(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal((5, 4, 4))
    one = SlamTrajectory(
        np.arange(5.0), rng.standard_normal((5, 3)), rng.uniform(-3, 3, 5), a @ a.swapaxes(1, 2), 5, {}
    )
    one.write_tum_file(tmp_path / "t.txt")
    back = read_trajectory(tmp_path / "t.txt")
    assert back.position == pytest.approx(one.position, abs=1e-5)
    assert back.heading == pytest.approx(one.heading, abs=1e-5)
    assert back.covariance == pytest.approx(one.covariance, rel=1e-3, abs=1e-4)


def test_errors_of_a_known_kind() -> None:
    t = np.linspace(0, 20, 400)
    true = np.stack([t * 0.3, np.sin(t), -np.ones(400)], axis=1)
    turn, shift = 0.1, np.array([0.2, -0.1, 0.0])
    c, s = np.cos(turn), np.sin(turn)
    off = true @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + shift
    e = evaluate_trajectory(t, off, np.full(400, turn), None, t, true, np.zeros(400), 500)
    assert e.ate_m < 1e-9
    assert e.rpe_m < 1e-9
    assert e.lost_share == pytest.approx(0.2)
    assert e.heading_rms_rad == pytest.approx(turn)
    noisy = true + 0.02 * np.random.default_rng(0).standard_normal((400, 3))
    p = np.tile(np.diag([4e-4, 4e-4, 4e-4, 1e-4]), (400, 1, 1))
    heading = 0.01 * np.random.default_rng(1).standard_normal(400)
    e = evaluate_trajectory(t, noisy, heading, p, t, true, np.zeros(400))
    assert e.nees == pytest.approx(1.0, abs=0.15)
    assert e.inside_share == pytest.approx(0.95, abs=0.04)


def poses(n=100, start=1_403_636_579.0):
    """Time, position N-E-D and heading of a curve at 10 Hz."""
    t = start + 0.1 * np.arange(n)
    u = t - start
    return t, np.stack([np.cos(u), np.sin(u), -1 - 0.1 * u], axis=1), 0.3 * u


def tum_rows(t, x, heading, scale=1.0):
    q = scale * np.stack([0 * heading, 0 * heading, np.sin(heading / 2), np.cos(heading / 2)], axis=1)
    return [" ".join(f"{v:.9f}" for v in row) for row in np.column_stack([t, x, q])]


def errors(file, truth):
    """What the command `slam evaluate` prints, and its notes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        one, true = read_trajectory(file), read_truth_trajectory(truth)
    found = evaluate_trajectory(one.time, one.position, one.heading, None, *true, one.pictures)
    return asdict(found), [str(w.message) for w in caught if w.category is LogWarning]


@pytest.fixture
def trajectory(tmp_path):
    """Write rows as a trajectory and evaluate it against the curve."""
    truth = tmp_path / "truth.txt"
    truth.write_text("\n".join(tum_rows(*poses())))

    def write(rows, name="est.txt", head=""):
        file = tmp_path / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(head + "\n".join(rows) + "\n")
        return errors(file, truth)

    return write


def test_rows_without_numbers_are_left_out_told_and_counted(trajectory):
    rows = tum_rows(*poses())
    rows[20] = rows[20].split()[0] + " nan" * 7
    rows[30] = rows[30].replace(rows[30].split()[2], "inf")
    rows[40] = " ".join(rows[40].split()[:4]) + " 0 0 0 0"
    found, said = trajectory(rows, head="# of a camera\n")
    assert found["lost_share"] == pytest.approx(0.03)
    assert found["horizontal_rms_m"] < 1e-6
    assert found["pictures"] == 100
    assert said == [
        "est.txt: 2 rows with NaN or infinity, skipped (the first in line 22)",
        "est.txt: 1 row with a quaternion of zeros, skipped (line 42)",
    ]
    found, said = trajectory([*rows[50:], "1403636589.9 1.0"])
    assert said == ["est.txt: the last row (line 51) is truncated and skipped"]
    with pytest.raises(InputError, match=r"est\.txt: line 3: '1403636579\.3\d* 0\.9' is not 8 numbers"):
        trajectory([*rows[1:3], "1403636579.3 0.9", *rows[4:]])


def test_quaternions_are_brought_to_unit_length(trajectory):
    found, said = trajectory(tum_rows(*poses(), scale=2.0))
    assert found["heading_rms_rad"] < 1e-6
    assert found["rpe_m"] < 1e-6
    assert "100 rows whose quaternion is not of unit length (2), normalised" in said[0]
    assert trajectory(tum_rows(*poses(), scale=1.0004))[1] == []


def test_rows_out_of_order_and_repeated_are_sorted(trajectory):
    rows = tum_rows(*poses())
    straight, _ = trajectory(rows)
    mixed = [*rows[:10], *rows[60:], *rows[10:60], rows[-1]]
    found, said = trajectory(mixed)
    assert found["way_m"] == pytest.approx(straight["way_m"])
    assert found["lost_share"] == 0
    assert said == [
        "est.txt: 1 row earlier than the previous row, sorted by time (line 51)",
        "est.txt: 1 row with the time of another row; the last of them is kept (line 50)",
    ]


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_stamps_tell_their_unit_by_their_size(trajectory, factor, unit):
    t, x, heading = poses()
    rows = tum_rows(t, x, heading)
    rows = [" ".join([f"{round(factor * s)}", *row.split()[1:]]) for s, row in zip(t, rows, strict=True)]
    found, said = trajectory(rows)
    assert found["horizontal_rms_m"] < 1e-5
    assert said == [f"est.txt: its time stamps are read as {unit}"]


def test_stamps_that_do_not_meet_the_truth_get_the_right_hint(trajectory):
    t, x, heading = poses()
    with pytest.raises(InputError, match=r"give its own truth, or --offset -1403636579\.000 if both begin together"):
        trajectory(tum_rows(t - t[0], x, heading))
    with pytest.raises(InputError, match=r"the trajectory's are in ns: give them in s"):
        trajectory(tum_rows(1e9 * (t - t[0]), x, heading))
    with pytest.raises(InputError, match=r"est\.txt: line 1: has 12 numbers: KITTI's poses, which have no times"):
        trajectory(["1 0 0 0 0 1 0 0 0 0 1 0"] * 5)


def test_tables_of_other_programs_are_the_same_trajectory(trajectory):
    t, x, heading = poses()
    tum = tum_rows(t, x, heading)
    flip = np.array([1, -1, -1])
    wxyz = [0, 1, 2, 3, 7, 4, 5, 6]
    euroc = [[row.split()[k] for k in wxyz] for row in tum_rows(t, x * flip, -heading)]
    euroc = [",".join([f"{round(1e9 * s)}", *row[1:], "0,0,0"]) for s, row in zip(t, euroc, strict=True)]
    names = ",".join(f"p_RS_R_{a} [m]" for a in "xyz") + "".join(f",q_RS_{a} []" for a in "wxyz")
    up = tum_rows(t, np.stack([x[:, 1], x[:, 0], -x[:, 2]], axis=1), np.pi / 2 - heading)
    first = [" ".join(row.split()[k] for k in wxyz) for row in tum]
    for rows, name, head in (
        ([",".join(row.split()) for row in tum], "commas.txt", "timestamp,x,y,z,qx,qy,qz,qw\n"),
        ([", ".join(row.split()) + "  # odometry" for row in tum], "blanks.txt", ""),
        ([";".join(row.split()).replace(".", ",") for row in tum], "decimals.txt", ""),
        ([row.replace(".", ",") for row in tum], "decimals2.txt", ""),
        (first, "first.txt", "# timestamp tx ty tz qw qx qy qz\n"),
        (euroc, "state_groundtruth_estimate0/data.csv", f"#timestamp [ns],{names}\n"),
        (tum_rows(t, x * flip, -heading), "groundtruth.txt", "# ground truth\n"),
        (tum_rows(t, x * flip, -heading), "any.txt", "# x north, y west, z up\n"),
        (up, "east.txt", "# x east, y north, z up\n"),
    ):
        found, said = trajectory(rows, name, head)
        assert found["horizontal_rms_m"] < 1e-5, name
        assert found["height_rms_m"] < 1e-5, name
        assert found["heading_rms_rad"] < 1e-5, name
        assert said == [], name


def test_quaternions_with_w_first_and_no_names_are_told(trajectory):
    t, x, heading = poses()
    wxyz = [[row.split()[k] for k in (0, 1, 2, 3, 7, 4, 5, 6)] for row in tum_rows(t, x, 0.3 * heading)]
    ns = [",".join([f"{round(1e9 * s)}", *row[1:], ""]) for s, row in zip(t, wxyz, strict=True)]
    found, said = trajectory(ns)  # VINS writes so
    assert found["heading_rms_rad"] == pytest.approx(trajectory(tum_rows(t, x, 0.3 * heading))[0]["heading_rms_rad"])
    assert "est.txt: its quaternions are read with w first; otherwise the vehicle would be upside down" in said
    said = trajectory([" ".join(row) for row in wxyz])[1]
    assert said == [
        "est.txt: the vehicle is upside down; if w is the first number of its "
        "quaternions, name the columns: # t x y z qw qx qy qz"
    ]


def test_stamps_with_too_few_digits_are_no_clock(trajectory):
    t, x, heading = poses()
    with pytest.raises(InputError, match="the trajectory has 1 usable rows with different times"):
        trajectory(tum_rows(0 * t + t[0], x, heading))


def test_a_folder_and_the_file_in_it_are_one_truth(tmp_path):
    t, x, heading = poses()
    est = tmp_path / "est.txt"
    est.write_text("\n".join(tum_rows(t, x + 0.01, heading)))
    up = tum_rows(t, x * [1, -1, -1], -heading)
    for inside in ("groundtruth.txt", "truth.txt", "mav0/state_groundtruth_estimate0/data.csv"):
        folder = tmp_path / inside.replace("/", "_")
        (folder / inside).parent.mkdir(parents=True)
        rows = tum_rows(t, x, heading) if inside == "truth.txt" else up
        (folder / inside).write_text("\n".join(rows))
        found = errors(est, folder)
        assert found == errors(est, folder / inside)
        assert found[0]["horizontal_rms_m"] == pytest.approx(0.01 * 2**0.5, abs=1e-6)
    other, odd = tmp_path / "other.txt", tmp_path / "odd.txt"
    other.write_text("\n".join(up))
    odd.write_text("\n".join(tum_rows(t, x, heading)) + f"\n{t[-1] + 1} nan" + " 0" * 6)
    said = CliRunner().invoke(app, ["slam", "evaluate", str(odd), str(folder), "--json"])
    assert json.loads(said.stdout)["left_out"] == 1
    assert json.loads(said.stdout)["errors"]["lost_share"] == pytest.approx(1 / 101)
    said = CliRunner().invoke(app, ["slam", "evaluate", str(est), str(other)])
    assert "fits better (ATE 0.0 cm in place of" in " ".join(said.output.split())


def test_nothing_is_compared_within_a_gap_of_the_truth_and_a_pose_may_stand_still():
    t, x, heading = poses()
    some = np.r_[0:20, 60:100]
    found = evaluate_trajectory(t, x, heading, None, t[some], x[some], heading[some])
    assert found.horizontal_rms_m < 1e-9
    still = evaluate_trajectory(t, np.tile(x[0], (100, 1)), np.zeros(100), None, t, x, heading)
    assert np.isfinite([still.ate_m, still.rpe_m, still.horizontal_rms_m]).all()
    shifted = evaluate_trajectory(t + 0.05, x, heading, None, t, x, heading)
    assert shifted.horizontal_rms_m == pytest.approx(0.05, rel=0.05)


def test_a_lens_is_found_from_a_chessboard(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(5)
    for k in range(8):
        picture = np.full((240, 320), 200, np.uint8)
        turn, _ = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))
        for i in range(-1, 9):
            for j in range(-1, 6):
                if (i + j) % 2 == 0:
                    side = np.linspace(0, 1, 8)
                    edge = [*((s, 0) for s in side), *((1, s) for s in side)]
                    edge += [*((1 - s, 1) for s in side), *((0, 1 - s) for s in side)]
                    at = np.array([((i + a - 4) * 0.025, (j + b - 2.5) * 0.025, 0.0) for a, b in edge]) @ turn.T
                    pixels = project_points(CAMERA, at + 0.26 * np.eye(3)[2])
                    cv2.fillPoly(picture, [np.rint(pixels * 16).astype(np.int32)], 40, cv2.LINE_AA, 4)
        (tmp_path / f"{k}.png").write_bytes(encode_jpeg(cv2.GaussianBlur(picture, (0, 0), 0.7), 98))
    found = calibrate_lens(list_board_pictures(tmp_path), CAMERA, columns=9, rows=6)
    assert found.used >= 6
    assert found.residual_px < 0.3
    assert found.values["focal_x"] == pytest.approx(250, abs=8)
    other = resize_camera(CAMERA, 800, 500)
    assert float(other.lens.focal_x) == pytest.approx(2.5 * float(CAMERA.lens.focal_x))
    again = calibrate_lens(list_board_pictures(tmp_path), other, columns=9, rows=6)
    assert again.values == found.values
    assert (again.camera.sensor.width, again.camera.sensor.height) == (320, 240)
    assert parse_camera(format_camera_toml(again.camera), "") == again.camera
    with pytest.raises(InputError, match="board of 7 by 5 inner corners is in 0 of 8"):
        calibrate_lens(list_board_pictures(tmp_path), CAMERA, columns=7, rows=5)


def test_telemetry_of_a_log_gives_its_velocity_and_place(tmp_path: Path) -> None:
    t = np.arange(0.0, 4.0, 0.02)
    axis = {"axis": ["N", "E", "D"]}
    still = np.zeros((len(t), 3))
    place, speed, attitude = still.copy(), still.copy(), still.copy()
    place[:, 0], place[:, 2], speed[:, 0], attitude[:, 2] = 0.5 * t, -1.0, 0.5, 3.0 + 0.2 * t
    attitude[:, 2] = np.angle(np.exp(1j * attitude[:, 2]))
    signals = {"attitude": attitude, "position": place, "velocity": speed, "velocity_sigma": still + 0.03}
    log = xr.Dataset({f"estimated_{k}": (("time", "axis"), v) for k, v in signals.items()}, {"time": t, **axis})
    infos = read_telemetry_interpolator(write_log(log, tmp_path / "log.nc"))(np.array([1.0, 2.01]))
    assert infos[1].velocity == pytest.approx([0.5, 0.0, 0.0])
    assert infos[1].place == pytest.approx([1.005, 0.0, 3.0 + 0.402], abs=1e-3)  # continuous over half a turn
    assert (infos[0].velocity_sigma, *infos[0].place_sigma) == pytest.approx((0.03, 0.1, math.radians(2.0)))
    bare = log.drop_vars(["estimated_velocity"])
    info = read_telemetry_interpolator(write_log(bare, tmp_path / "bare.nc"))(np.array([1.0]))[0]
    assert info.velocity is None
    assert info.place is None
    assert info.height_m == pytest.approx(1.0)


def test_still_pictures_of_a_survey_are_refused(tmp_path: Path) -> None:
    for k in range(5):
        (tmp_path / f"{2.1 * k:.3f}.png").write_bytes(encode_jpeg(np.full((240, 320), 90, np.uint8), 90))
    (tmp_path / "camera.toml").write_text(format_camera_toml(CAMERA))
    said = CliRunner().invoke(app, ["slam", "run", str(tmp_path), "--height", "40"])
    assert said.exit_code == 1
    assert "the pictures are 2.1 s apart" in str(said.exception)
    assert "photogrammetry" in str(said.exception)


def test_pictures_that_share_too_little_floor_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    from mufly.camera import make_random_floor

    path = make_square_path(duration_s=8.0, side_m=2.0, speed_m_s=0.4, seed=5)
    for k, (frame, _) in enumerate(render_frames(CAMERA, make_random_floor("rich"), path, seed=1)):
        if k % 20:
            continue
        (tmp_path / f"{frame.time_s:.3f}.png").write_bytes(encode_jpeg(frame.picture, 90))
    (tmp_path / "camera.toml").write_text(format_camera_toml(CAMERA))
    said = CliRunner().invoke(app, ["slam", "run", str(tmp_path), "--height", "1"])
    assert said.exit_code == 1
    assert re.search(r"neighbouring pictures share [78]\d% of the floor, and tracking needs 90%", str(said.exception))
    assert "photogrammetry" in str(said.exception)


def test_from_rendering_to_errors_on_the_command_line(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    data, out = str(tmp_path / "data"), tmp_path / "out"
    call = CliRunner().invoke
    made = call(app, ["slam", "render", "-o", data, "--camera", "webcam", "--duration", "0.7", "--side", "1"])
    assert made.exit_code == 0, made.output
    flown = call(app, ["slam", "run", data, "-o", str(out), "--save-map", str(tmp_path / "m")])
    assert flown.exit_code == 0, flown.output
    assert "20 of 20 pictures have a position" in flown.output or "21 of 21" in flown.output
    assert {p.name for p in out.iterdir()} == {"trajectory.txt", "trajectory.mcap", "trajectory.png"}
    judged = call(app, ["slam", "evaluate", str(out / "trajectory.txt"), data, "--json"])
    assert judged.exit_code == 0, judged.output
    assert '"nees"' in judged.output
