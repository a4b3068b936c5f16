"""Data sets in three layouts, trajectories, calibration, and what is wrong with files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.camera import encode, load_camera, project
from mufly.cli import app
from mufly.errors import InputError
from mufly.slam import (
    board_pictures,
    calibrate,
    evaluate,
    frames,
    open_pictures,
    read_trajectory,
    rounds,
    write_dataset,
)
from mufly.slam.trajectory import Trajectory

CAMERA = load_camera("webcam")


@pytest.fixture(scope="module")
def layouts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    from mufly.camera import make_floor

    path = rounds(duration_s=0.5, side_m=1.0, seed=1)
    made = list(frames(CAMERA, make_floor("rich", size=256), path, seed=1))
    out = {}
    for layout in ("mufly", "euroc", "tum"):
        out[layout] = tmp_path_factory.mktemp(layout)
        write_dataset(out[layout], CAMERA, path, made, layout)
    return out


def test_layouts_say_the_same(layouts: dict[str, Path]) -> None:
    sources = {name: open_pictures(folder, CAMERA) for name, folder in layouts.items()}
    read = {name: list(s.frames()) for name, s in sources.items()}
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
            abs(a.told.roll - b.told.roll) + abs(a.told.pitch - b.told.pitch)
            for a, b in zip(theirs, ours, strict=True)
        ]
        assert max(off) < 0.09  # an inertial unit that tilts and accelerates feels both


def test_what_is_wrong_is_one_line(layouts: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no pictures"):
        open_pictures(tmp_path, CAMERA, height_m=1.0)
    data = encode(np.zeros((240, 320), np.uint8), 80)
    (tmp_path / "1.0.jpg").write_bytes(data)
    with pytest.raises(InputError, match="height above the floor; give --height"):
        open_pictures(tmp_path, CAMERA)
    (tmp_path / "2.0.jpg").write_bytes(data[: len(data) // 3])
    (tmp_path / "3.0.png").write_bytes(encode(np.zeros((10, 320, 3), np.uint8), 80))
    source = open_pictures(tmp_path, CAMERA, height_m=1.0)
    some = source.frames()
    assert next(some).time_s == 1.0
    with pytest.raises(InputError, match=r"2\.0\.jpg: is damaged"):
        next(some)
    (tmp_path / "2.0.jpg").unlink()
    some = source.frames()
    (tmp_path / "x.png").write_bytes(data)
    with pytest.raises(InputError, match=r"x\.png: is no time"):
        open_pictures(tmp_path, CAMERA, height_m=1.0)
    (tmp_path / "pictures.csv").write_text("time_s,file\n1.0,a.jpg\n0.5,b.jpg\n")
    with pytest.raises(InputError, match=r"b\.jpg: its time, 0\.500000 s, is not after"):
        open_pictures(tmp_path, CAMERA, height_m=1.0)
    with pytest.raises(InputError, match="no such folder"):
        open_pictures(tmp_path / "nowhere", CAMERA)
    with pytest.raises(InputError, match="is 320 by 10 pixels"):
        list(open_pictures(_named(tmp_path, "3.0.png"), CAMERA, height_m=1.0).frames())


def _named(folder: Path, name: str) -> Path:
    out = folder / "one"
    out.mkdir()
    (out / name).write_bytes((folder / name).read_bytes())
    return out


def test_a_trajectory_comes_back_with_its_covariance(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    a = rng.standard_normal((5, 4, 4))
    one = Trajectory(
        np.arange(5.0), rng.standard_normal((5, 3)), rng.uniform(-3, 3, 5), a @ a.swapaxes(1, 2), 5, {}
    )
    one.write(tmp_path / "t.txt")
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
    e = evaluate(t, off, np.full(400, turn), None, t, true, np.zeros(400), 500)
    assert e.ate_m < 1e-9
    assert e.rpe_m < 1e-9
    assert e.lost == pytest.approx(0.2)
    assert e.heading_rms_rad == pytest.approx(turn)
    noisy = true + 0.02 * np.random.default_rng(0).standard_normal((400, 3))
    p = np.tile(np.diag([4e-4, 4e-4, 4e-4, 1e-4]), (400, 1, 1))
    heading = 0.01 * np.random.default_rng(1).standard_normal(400)
    e = evaluate(t, noisy, heading, p, t, true, np.zeros(400))
    assert e.nees == pytest.approx(1.0, abs=0.15)
    assert e.inside == pytest.approx(0.95, abs=0.04)


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
                    at = (
                        np.array([((i + a - 4) * 0.025, (j + b - 2.5) * 0.025, 0.0) for a, b in edge])
                        @ turn.T
                    )
                    pixels = project(CAMERA, at + 0.26 * np.eye(3)[2])
                    cv2.fillPoly(picture, [np.rint(pixels * 16).astype(np.int32)], 40, cv2.LINE_AA, 4)
        (tmp_path / f"{k}.png").write_bytes(encode(cv2.GaussianBlur(picture, (0, 0), 0.7), 98))
    found = calibrate(board_pictures(tmp_path), CAMERA, columns=9, rows=6)
    assert found.used >= 6
    assert found.residual_px < 0.3
    assert found.values["focal_x"] == pytest.approx(250, abs=8)
    with pytest.raises(InputError, match="board of 7 by 5 inner corners is in 0 of 8"):
        calibrate(board_pictures(tmp_path), CAMERA, columns=7, rows=5)


def test_from_rendering_to_errors_on_the_command_line(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    data, out = str(tmp_path / "data"), tmp_path / "out"
    call = CliRunner().invoke
    made = call(app, ["slam", "render", "-o", data, "--camera", "webcam", "--duration", "0.7", "--side", "1"])
    assert made.exit_code == 0, made.output
    flown = call(app, ["slam", "run", data, "-o", str(out), "--save-map", str(tmp_path / "m")])
    assert flown.exit_code == 0, flown.output
    assert "20 of 20 pictures answered" in flown.output or "21 of 21" in flown.output
    assert {p.name for p in out.iterdir()} == {"trajectory.txt", "trajectory.mcap", "trajectory.png"}
    judged = call(app, ["slam", "evaluate", str(out / "trajectory.txt"), data, "--json"])
    assert judged.exit_code == 0, judged.output
    assert '"nees"' in judged.output
