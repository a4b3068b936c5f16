"""Calibration by hand: a camera that differs from its file is found from simulated tracks and rendered pictures."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.camera import Camera, body_from_camera_rotation, load_camera, project_points, unproject_pixels
from mufly.cli import app
from mufly.dynamics import GRAVITY
from mufly.errors import InputError
from mufly.slam import VehiclePath, format_camera_toml
from mufly.slam.calibration.hand_calibration import HandCalibration, fit_camera
from mufly.slam.calibration.inertial_motion import InertialData, integrate_inertial_data
from mufly.slam.calibration.point_tracks import PointTracks
from mufly.slam.datasets.dataset_writers import ideal_imu_rows
from mufly.slam.datasets.synthetic_datasets import add_imu_errors, make_handheld_path, make_square_path

FILE = load_camera("mufly-2.0")
DELAY_S, ANGLES_RAD, PLACE_M = 0.04, np.radians([2.0, -3.0, 1.5]), (0.045, -0.01, 0.06)


def change_camera(delay_s: float = DELAY_S, focal: float = 1.05) -> Camera:
    """Return a camera that differs from its file: focal length, mount, delay."""

    def put(quantity, value):
        return quantity.model_copy(update={"value": float(value)})

    lens, mount = FILE.lens, FILE.mount
    roll, pitch, turn = ANGLES_RAD
    return FILE.model_copy(
        update={
            "lens": lens.model_copy(
                update={
                    "focal_x": put(lens.focal_x, focal * float(lens.focal_x)),
                    "focal_y": put(lens.focal_y, focal * float(lens.focal_y)),
                    "centre_x": put(lens.centre_x, float(lens.centre_x) + 3.0),
                    "k1": put(lens.k1, float(lens.k1) + 0.01),
                }
            ),
            "mount": mount.model_copy(
                update={
                    "roll": put(mount.roll, roll), "pitch": put(mount.pitch, pitch), "turn": put(mount.turn, turn),
                    "place": mount.place.model_copy(update={"value": (PLACE_M,)}),
                }
            ),
            "shutter": FILE.shutter.model_copy(update={"delay": put(FILE.shutter.delay, delay_s)}),
        }
    )  # fmt: skip


def simulate_tracks(camera: Camera, path: VehiclePath, duration_s: float, noise_px: float = 0.0) -> PointTracks:
    """Return tracks by projection of floor points at the times of their rows."""
    rng, turn = np.random.default_rng(1), body_from_camera_rotation(camera)
    readout, rows = float(camera.shutter.readout), camera.sensor.height - 1.0
    grid = np.stack(np.meshgrid(np.linspace(20, 300, 7), np.linspace(20, 220, 6)), axis=-1).reshape(-1, 2)

    def pose_at(time_s: float):
        motion = path.motion_at(time_s)
        return motion.attitude @ turn, motion.position + motion.attitude @ np.array(PLACE_M)

    stamps, owner, first, last = [], [], [], []
    for k in range(int(duration_s / 0.1)):
        begin, end = 0.5 + 0.1 * k, 0.6 + 0.1 * k
        pixels = grid + rng.uniform(-10, 10, grid.shape)
        for pixel, ray in zip(pixels, unproject_pixels(camera, pixels), strict=True):
            axes, at = pose_at(begin + (pixel[1] / rows - 0.5) * readout)
            d = axes @ [*ray, 1.0]
            point, row = at - d * (at[2] / d[2]), pixel[1]
            for _ in range(6):
                axes, at = pose_at(end + (row / rows - 0.5) * readout)
                there = project_points(camera, (point - at) @ axes)
                row = there[1]
            if 0 < there[0] < 319 and 0 < there[1] < 239:
                owner.append(k)
                first.append(pixel)
                last.append(there + noise_px * rng.standard_normal(2))
        stamps.append((begin + DELAY_S, end + DELAY_S))
    return PointTracks(np.array(stamps), np.array(owner), np.array(first), np.array(last))


def make_imu(path: VehiclePath, errors: bool) -> InertialData:
    rows = ideal_imu_rows(path)
    rows = add_imu_errors(rows, 3) if errors else rows
    return InertialData(rows[:, 0], rows[:, 1:4], rows[:, 4:7])


@pytest.fixture(scope="module")
def path() -> VehiclePath:
    return make_handheld_path(duration_s=12.0, seed=2)


@pytest.fixture(scope="module")
def tracks(path: VehiclePath) -> PointTracks:
    return simulate_tracks(change_camera(), path, 11.0)


def fit(tracks: PointTracks, path: VehiclePath, errors: bool) -> HandCalibration:
    return fit_camera(
        tracks, FILE, make_imu(path, errors), height_m=lambda t: -np.interp(t, path.time_s, path.position_m[:, 2])
    )


def true_values() -> dict[str, float]:
    roll, pitch, turn = np.degrees(ANGLES_RAD)
    return {
        "focal_x_px": 1.05 * 250.0, "centre_x_px": 165.3, "k1": -0.21, "mount_roll_deg": roll,
        "mount_pitch_deg": pitch, "mount_turn_deg": turn, "delay_ms": 1e3 * DELAY_S, "lever_x_mm": 1e3 * PLACE_M[0],
    }  # fmt: skip


def test_exact_tracks_give_the_camera(tracks: PointTracks, path: VehiclePath) -> None:
    found = fit(tracks, path, errors=False)
    limits = {"focal_x_px": 0.1, "centre_x_px": 0.1, "k1": 5e-4, "delay_ms": 0.1, "lever_x_mm": 2.0}
    for name, true in true_values().items():
        assert found.values[name] == pytest.approx(true, abs=limits.get(name, 0.02)), name
    written = found.camera
    assert float(written.shutter.delay) == pytest.approx(DELAY_S, abs=1e-4)
    np.testing.assert_allclose(
        body_from_camera_rotation(written), body_from_camera_rotation(change_camera()), atol=1e-3
    )


def test_gyroscope_errors_stay_inside_the_intervals(tracks: PointTracks, path: VehiclePath) -> None:
    found = fit(tracks, path, errors=True)
    for name, true in true_values().items():
        assert abs(found.values[name] - true) < 3.0 * found.deviations[name], name
    assert found.deviations["focal_x_px"] < 2.0


def test_mirrored_pictures_and_small_motion_are_refused(tracks: PointTracks, path: VehiclePath) -> None:
    mirror = np.array([-1.0, 1.0])
    flipped = dataclasses.replace(
        tracks, first_px=tracks.first_px * mirror + [319.0, 0.0], last_px=tracks.last_px * mirror + [319.0, 0.0]
    )
    with pytest.raises(InputError, match="mirrored"):
        fit(flipped, path, errors=False)
    calm = make_square_path(duration_s=12.0, side_m=0.0, seed=1)
    with pytest.raises(InputError, match=r"leaves the focal length uncertain|does not follow the gyroscopes"):
        fit(simulate_tracks(change_camera(), calm, 4.0, noise_px=0.3), calm, errors=True)


def test_constant_rate_integrates_exactly() -> None:
    """A turn at 1 rad/s about x for 1 s from level: gravity alone, so the velocity stays zero."""
    t = np.linspace(0.0, 1.0, 101)
    force = -GRAVITY * np.stack([np.zeros_like(t), np.sin(t), np.cos(t)], axis=1)
    imu = InertialData(t, np.tile([1.0, 0.0, 0.0], (101, 1)), force)
    zero = np.zeros(3)
    motion = integrate_inertial_data(imu, np.array([1.0, 0, 0, 0]), gyro_bias=zero, gyro_scale=zero, accel_bias=zero)
    np.testing.assert_allclose(motion.quaternion[-1], [math.cos(0.5), math.sin(0.5), 0, 0], atol=1e-12)
    np.testing.assert_allclose(motion.velocity, 0.0, atol=1e-4)


def test_command_calibrates_rendered_pictures(tmp_path: Path) -> None:
    made, true = tmp_path / "hand", tmp_path / "true.toml"
    true.write_text(format_camera_toml(change_camera()))
    run = CliRunner().invoke
    options = ["--motion", "hand", "--height", "0.8", "--duration", "7", "--camera", str(true), "--seed", "4"]
    assert run(app, ["slam", "render", "-o", str(made), *options]).exit_code == 0
    out = tmp_path / "found.toml"
    answer = run(app, ["slam", "calibrate", str(made), "--by", "hand", "--camera", "mufly-2.0", "--out", str(out)])
    assert answer.exit_code == 0, answer.output
    found = load_camera(out)
    assert float(found.lens.focal_x) == pytest.approx(262.5, abs=3.0 * found.lens.focal_x.std)
    assert float(found.shutter.delay) == pytest.approx(DELAY_S, abs=1.5e-3)
    assert found.lens.focal_x.std < 4.0
    (made / "imu.csv").unlink()
    lost = run(app, ["slam", "calibrate", str(made), "--by", "hand", "--camera", "mufly-2.0"])
    assert lost.exit_code != 0
    assert "imu.csv" in str(lost.exception)
