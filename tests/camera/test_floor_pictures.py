"""Floors by name: generated ones, photographs of installed packages, and picture files with a width."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mufly.camera import FloorSource, copy_package_floors, find_floor, load_camera
from mufly.cli.onboard.camera_options import make_flight_camera, make_position_camera
from mufly.dynamics import initial_state
from mufly.errors import InputError
from mufly.flight.fixes.camera_sensor import CameraConfig, default_to_mission_floor, make_camera
from mufly.flight.monte_carlo import Campaign
from mufly.flight.monte_carlo.campaign import FlightCase
from mufly.mission import Mission, format_mission_toml, load_mission, parse_mission
from mufly.sensors import Truth
from mufly.vehicle import load_vehicle
from mufly.world import World

MISSION = """\
[floor]
texture = "wood.png"
width_m = 0.8

[[waypoint]]
position_m = [0.5, 0.0, -1.0]
"""


def save_picture(path: Path, seed: int = 0, size: tuple[int, int] = (64, 128)) -> Path:
    Image.fromarray(np.random.default_rng(seed).integers(0, 255, size, dtype=np.uint8)).save(path)
    return path


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a package ``skimage`` that has one of its pictures."""
    data = tmp_path / "site" / "skimage" / "data"
    data.mkdir(parents=True)
    (data.parent / "__init__.py").write_text("raise RuntimeError('must not be imported')")
    save_picture(data / "brick.png")
    monkeypatch.syspath_prepend(tmp_path / "site")
    importlib.invalidate_caches()
    return data


def test_a_picture_has_the_width_that_is_given_or_that_of_the_table(tmp_path: Path) -> None:
    picture = save_picture(tmp_path / "wood.png")
    assert find_floor(str(picture)) == FloorSource(str(picture), picture, 2.0)
    (tmp_path / "floors.toml").write_text("[wood]\nwidth_m = 1.6\n")
    assert find_floor(str(picture)).width_m == 1.6
    floor = find_floor(str(picture), 0.64).make_floor(3, shadows=0.5)
    assert floor.pixel_size_m == pytest.approx((0.005, 0.005))
    assert floor.mip_levels[0].shape == (64, 128)
    assert floor.shadow_map.min() < 0.6


@pytest.mark.parametrize(
    ("text", "width", "message"),
    [
        ("rihc", None, "did you mean 'rich'"),
        ("none.png", None, "no such picture"),
        ("rich", 2.0, "leave it out"),
        ("wood.png", 0.0, "out of range"),
        ("text.png", None, "is not a picture"),
        ("gravel", None, "pip install scikit-image"),
    ],
)
def test_invalid_floors_are_refused(
    text: str, width: float | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    save_picture(tmp_path / "wood.png")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match=message):
        find_floor(text, width)


@pytest.mark.parametrize("text", ["[wood", "wood = 1", '[wood]\nwidth_m = "wide"'])
def test_a_table_with_errors_is_named(tmp_path: Path, text: str) -> None:
    picture = save_picture(tmp_path / "wood.png")
    (tmp_path / "floors.toml").write_text(text)
    with pytest.raises(InputError, match=r"floors\.toml"):
        find_floor(str(picture))


def test_photographs_of_packages_are_used_by_name_and_copied(package: Path, tmp_path: Path) -> None:
    """The package itself is not imported."""
    assert find_floor("brick") == FloorSource("brick", package / "brick.png", 0.9)
    out = tmp_path / "set"
    assert [f.name for f in copy_package_floors(out)] == ["brick"]
    assert "CC0" in (out / "floors.toml").read_text()
    assert find_floor(str(out / "brick.png")).width_m == 0.9
    assert (out / "brick.png").read_bytes() == (package / "brick.png").read_bytes()


def test_without_such_packages_no_set_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install"):
        copy_package_floors(tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_a_mission_has_its_floor_and_an_option_replaces_it(tmp_path: Path) -> None:
    picture, other = save_picture(tmp_path / "wood.png"), save_picture(tmp_path / "other.png", 1)
    (tmp_path / "m.toml").write_text(MISSION)
    mission = load_mission(tmp_path / "m.toml")
    assert parse_mission_again(mission) == mission
    lens = load_camera("webcam")
    flown = make_flight_camera("webcam", "", None, mission, "m.toml")
    assert (flown.floor_texture, flown.floor_width_m) == (str(picture.resolve()), 0.8)
    assert make_flight_camera("", str(other), 1.0, mission, "m.toml").floor_texture == str(other)
    assert default_to_mission_floor(CameraConfig(lens), load_mission("demonstration")).floor_name == "rich"
    state = initial_state(position=(0.0, 0.0, -1.0), attitude=(0.0, 0.0, 0.0), rotor_speed=(380.0, 420.0))
    truth = Truth(0.0, 0, state, np.zeros(3), np.zeros(3), 11.0, 5.0)
    seen = [
        make_camera(eye, load_vehicle("mufly-1.1"), World(), 3).render_picture(truth, 1.0)
        for eye in (flown, CameraConfig(lens, str(picture), 0.8), CameraConfig(lens, str(other), 0.8))
    ]
    assert (seen[0] == seen[1]).all()
    assert (seen[0] != seen[2]).mean() > 0.8
    picture.unlink()
    with pytest.raises(InputError, match=r"m\.toml: floor\.texture: .*wood\.png: no such picture"):
        make_flight_camera("", "", None, mission, "m.toml")


def parse_mission_again(mission: Mission) -> Mission:
    return parse_mission(tomllib.loads(format_mission_toml(mission)))


def test_a_campaign_flies_over_the_floor_and_its_commands_name_it(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    picture = save_picture(tmp_path / "wood.png")
    mission, vehicle = load_mission("demonstration"), load_vehicle("mufly-1.1")
    camera = make_position_camera("camera", "fitted", "webcam", str(picture), 0.8, mission, "demonstration")
    campaign = Campaign(vehicle, mission, camera=camera, camera_name="webcam")
    case = FlightCase(0, 7, {}, None, 0)
    assert campaign.make_flight_arguments(case)["eye"] == camera
    command = campaign.format_replay_command(case, tmp_path, None)
    assert f"--position camera --camera webcam --floor {picture} --floor-width 0.8" in command
    assert campaign.settings_hash != Campaign(vehicle, mission).settings_hash
    for options in (("fix", "fitted", "", "rich", None), ("camera", "ideal", "", "", None)):
        with pytest.raises(InputError, match="--position"):
            make_position_camera(*options, mission, "demonstration")
