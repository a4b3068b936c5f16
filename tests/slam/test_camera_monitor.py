"""Checks of the camera: copies, clock, mounting, focal length, delay and dirt are named; healthy floors raise none."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from mufly.camera import Camera, VehicleMotion, load_camera, make_random_floor
from mufly.flight.fixes.onboard_camera import add_dirt
from mufly.slam import CameraFrame, FrameEstimate, SlamSystem, make_square_path, render_frames
from mufly.slam.datasets.synthetic_datasets import make_handheld_path
from mufly.slam.image_tools import Undistorter
from mufly.slam.images.camera_monitor import (
    CameraMonitor,
    DirtMask,
    FlipTest,
    diagnose_camera_from_motion,
    low_pass_motion,
)
from mufly.vehicle.quantity import Quantity

cv2 = pytest.importorskip("cv2")
SEED, SECONDS = 6, 4.5
Flown = list[tuple[CameraFrame, VehicleMotion]]


@pytest.fixture(scope="module")
def flown() -> Flown:
    camera = load_camera("mufly-2.0")
    path = make_square_path(duration_s=SECONDS, side_m=2.0, speed_m_s=0.4, seed=SEED)
    return list(render_frames(camera, make_random_floor("rich", SEED, size=2048), path, duration_s=SECONDS, seed=SEED))


def _scaled(camera: Camera, factor: float) -> Camera:
    lens = camera.lens
    new = {
        k: q.model_copy(update={"value": factor * q.value}) for k in ("focal_x", "focal_y") if (q := getattr(lens, k))
    }
    return camera.model_copy(update={"lens": lens.model_copy(update=new)})


def _turned(camera: Camera, angle_rad: float) -> Camera:
    turn = Quantity(value=angle_rad, unit="rad", source="estimated")
    return camera.model_copy(update={"mount": camera.mount.model_copy(update={"turn": turn})})


def _first_fault(camera: Camera, frames: list[CameraFrame]) -> tuple[str, float, str]:
    """Return the first fault, the time until it was reported (s) and its message."""
    straight = Undistorter(camera)
    monitor = CameraMonitor(camera, straight.focal_px, straight.smoothing_sigma_px)
    for frame in frames:
        verdict = monitor.check_motion(frame, straight.undistort_picture(frame.picture))
        if verdict.fault:
            return verdict.fault, frame.time_s - frames[0].time_s, verdict.message
    return "", math.inf, ""


@pytest.mark.parametrize(
    ("case", "fault", "words"),
    [
        ("healthy", "", ""),
        ("upside down", "turned", "upside down"),
        ("mirrored", "mirrored", "mirrored"),
        ("turned", "turned", "turned by"),
        ("focal length", "focal length", "check the focal length"),
        ("late", "delay", "ms late against the gyroscopes"),
    ],
)
def test_a_motion_that_contradicts_the_gyroscopes_names_its_cause(
    flown: Flown, case: str, fault: str, words: str
) -> None:
    camera, frames = load_camera("mufly-2.0"), [f for f, _ in flown]
    match case:
        case "upside down":
            frames = [replace(f, picture=np.ascontiguousarray(f.picture[::-1, ::-1])) for f in frames]
        case "mirrored":
            frames = [replace(f, picture=np.ascontiguousarray(f.picture[:, ::-1])) for f in frames]
        case "turned":
            camera = _turned(camera, math.radians(20.0))
        case "focal length":
            camera = _scaled(camera, 1.4)
        case "late":
            frames = [replace(f, picture=g.picture) for f, g in zip(frames[2:], frames[:-2], strict=True)]
    found, after_s, message = _first_fault(camera, frames)
    assert found == fault
    assert words in message
    assert not fault or after_s < 3.0


def test_no_alarm_over_floors_with_little_texture(make_weak_floor: Callable) -> None:
    camera = load_camera("mufly-2.0")
    path = make_square_path(duration_s=3.0, side_m=2.0, speed_m_s=0.4, seed=5)
    for kind in ("felt", "stripes"):
        made = render_frames(camera, make_weak_floor(kind, 5), path, duration_s=3.0, seed=5)
        assert _first_fault(camera, [f for f, _ in made])[0] == ""


def test_a_motion_by_hand_is_judged_by_its_rotation_alone() -> None:
    camera, seconds = load_camera("mufly-2.0"), 4.5
    path = make_handheld_path(duration_s=seconds, seed=1)
    made = render_frames(camera, make_random_floor("rich", 1, size=2048), path, duration_s=seconds, seed=1)
    frames = [f for f, _ in made]
    assert _first_fault(camera, frames)[0] == ""
    mirrored = [replace(f, picture=np.ascontiguousarray(f.picture[:, ::-1])) for f in frames]
    assert _first_fault(camera, mirrored)[0] == "mirrored"


def test_a_picture_turned_against_the_gyroscopes_is_refused(flown: Flown) -> None:
    camera = load_camera("mufly-2.0")
    frames = [f for f, _ in flown[:8]]
    high, wide = frames[7].picture.shape
    for degrees, trusted in ((0.0, True), (4.0, False)):
        slam = SlamSystem(camera, start=[*flown[0][1].position[:2].tolist(), 0.0])
        for f in frames[:7]:
            assert slam.process_frame(f).trusted
        turn = cv2.getRotationMatrix2D((wide / 2, high / 2), degrees, 1.0)
        turned = cv2.warpAffine(frames[7].picture, turn, (wide, high), borderMode=cv2.BORDER_REFLECT)
        result = slam.process_frame(replace(frames[7], picture=turned))
        assert result.trusted == trusted
        assert trusted or "degrees against the gyroscopes" in result.reason


def test_a_verdict_needs_its_standard_deviations() -> None:
    sure, unsure = np.array([0.01, 0.01, 0.001]), np.array([0.05, 0.05, 0.01])
    turned = np.array([cmath.exp(0.2j), 0.0, 0.0])
    assert diagnose_camera_from_motion(turned, sure).fault == "turned"
    assert diagnose_camera_from_motion(turned, unsure).fault == ""
    assert diagnose_camera_from_motion(np.array([1.2, 0.0, 0.0]), sure).fault == "focal length"
    # Stripes hold back one direction: m falls by as much as n grows.
    assert diagnose_camera_from_motion(np.array([0.8, 0.2, 0.0]), sure).fault == ""
    assert diagnose_camera_from_motion(np.array([1.0, 0.0, -0.05]), sure).fault == "delay"
    assert diagnose_camera_from_motion(np.array([1.0, 0.0, 0.0]), sure).fault == ""


def _judge_flips(change: Callable[[complex], complex]) -> tuple[str, float]:
    """Return the fault of a motion that changes after 8 s, and the time until it was found (s)."""
    test, rng = FlipTest(), np.random.default_rng(3)
    for k in range(600):
        t = k / 30
        p = 60.0 * complex(math.sin(5.1 * t), math.cos(3.7 * t))
        y = (p if t < 8.0 else change(p)) + 12.0 * complex(*rng.standard_normal(2))
        test.add_picture(1 / 30, p, y)
        if fault := test.judge_flips().fault:
            return fault, t - 8.0
    return "", math.inf


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda p: -p.conjugate(), "mirrored"),
        (lambda p: p.conjugate(), "mirrored"),
        (lambda p: -p, "turned"),
        (lambda p: 1j * p, ""),
        (lambda p: 0.7 * p, ""),
    ],
)
def test_a_flip_in_flight_is_found_within_two_seconds(change: Callable[[complex], complex], fault: str) -> None:
    found, after_s = _judge_flips(change)
    assert found == fault
    assert not fault or 0.0 < after_s < 2.0


def test_dirt_that_comes_in_flight_is_masked(flown: Flown) -> None:
    straight, mask = Undistorter(load_camera("mufly-2.0")), DirtMask()
    pictures = [f.picture for f, _ in flown[::8]]
    for picture in [*pictures[:8], *map(add_dirt, pictures[8:])]:
        mask.add_picture(straight.undistort_picture(picture))
    assert mask.mask is not None
    assert mask.mask[79, 99]


def test_copies_and_a_stopped_clock_are_no_pictures(flown: Flown) -> None:
    camera = load_camera("mufly-2.0")
    slam = SlamSystem(camera, start=[*flown[0][1].position[:2].tolist(), 0.0])
    frames = [f for f, _ in flown[:24]]
    for f in frames[:12]:
        assert slam.process_frame(f).trusted
    copies = [slam.process_frame(replace(f, picture=frames[11].picture)) for f in frames[12:18]]
    assert not any(a.trusted for a in copies)
    assert "frozen" in copies[-1].reason
    assert slam.process_frame(frames[18]).trusted  # 0.2 s later it goes on
    stopped = [slam.process_frame(replace(f, time_s=frames[18].time_s)) for f in frames[19:]]
    assert not any(a.trusted for a in stopped)
    assert "do not advance" in stopped[-1].reason
    assert set(slam.camera_verdicts) == {"frozen", "clock"}
    dark = np.full_like(frames[0].picture, 5)
    assert "frozen" not in [slam.process_frame(replace(flown[24 + k][0], picture=dark)).reason for k in range(6)][-1]


def test_dirt_is_masked_where_it_is_and_floor_is_not(flown: Flown) -> None:
    straight = Undistorter(load_camera("mufly-2.0"))
    clean, dirty = DirtMask(), DirtMask()
    for frame, _ in flown[::8]:
        clean.add_picture(straight.undistort_picture(frame.picture))
        dirty.add_picture(straight.undistort_picture(add_dirt(frame.picture)))
    assert clean.mask is None
    assert dirty.mask is not None
    assert dirty.mask[79, 99]
    assert dirty.mask[149, 230]
    assert 0.01 < np.mean(dirty.mask > 0) < 0.15


def test_a_hover_over_the_same_floor_shows_no_dirt() -> None:
    """Two shades of smooth tiles stay near their pixels while the vehicle moves to and fro by some pixels."""
    camera, rng = load_camera("mufly-2.0"), np.random.default_rng(4)
    row, column = np.mgrid[:300, :380] // 90
    floor = np.where((row + column) % 2, 200.0, 90.0) + cv2.GaussianBlur(rng.normal(0.0, 5.0, (300, 380)), (0, 0), 1.5)
    monitor, never_moved = CameraMonitor(camera, 250.0, 1.6), DirtMask()
    for k in range(70):
        x, y = 30 + round(8.0 * math.sin(1.3 * k)), 30 + round(8.0 * math.cos(0.9 * k))
        picture = np.clip(floor[y : y + 240, x : x + 320] + rng.normal(0.0, 2.0, (240, 320)), 0, 255).astype(np.uint8)
        monitor.check_motion(CameraFrame(0.033 * k, picture, FrameEstimate(0.0, 0.0, 1.0)), picture)
        if k % 7 == 0:
            never_moved.add_picture(picture)
    assert never_moved.mask is not None  # what pictures of one place show
    assert monitor.dirt_mask is None


@pytest.mark.parametrize("dirty", [False, True])
def test_a_band_along_a_straight_path_is_no_dirt(dirty: bool) -> None:
    """A smooth, bright plank stays at its pixels while the vehicle flies along it; a spot on the lens does, too."""
    rng, mask = np.random.default_rng(7), DirtMask()
    rough = cv2.GaussianBlur(rng.normal(0.0, 60.0, (800, 320)), (0, 0), 3.0)
    rough[:, 200:240] = 25.0 + 0.2 * rough[:, 200:240]
    for k in range(9):
        picture = np.clip(120.0 + rough[50 * k : 50 * k + 240] + rng.normal(0.0, 2.0, (240, 320)), 0, 255)
        mask.shift_stored_positions(-50.0j, 0.0)
        mask.add_picture(add_dirt(picture.astype(np.uint8)) if dirty else picture.astype(np.uint8))
    assert (mask.mask is not None) == dirty
    if mask.mask is not None:
        assert mask.mask[79, 99]
        assert mask.mask[149, 230]
        assert np.mean(mask.mask > 0) < 0.2


def test_places_of_the_mean_move_with_the_floor() -> None:
    mask = DirtMask()
    assert mask.sees_new_floor
    mask.add_picture(np.zeros((24, 32), np.uint8))
    for turned_rad in (0.0, 0.4):  # there and back, as the nose turns in between
        mask.shift_stored_positions(60.0 + 10.0j, 0.0)
        assert mask.sees_new_floor
        mask.shift_stored_positions(0j, turned_rad)
        mask.shift_stored_positions(-(60.0 + 10.0j) * cmath.exp(-1j * turned_rad), 0.0)
        assert not mask.sees_new_floor


def test_a_lasting_tilt_error_is_reported() -> None:
    camera = load_camera("mufly-2.0")
    monitor = CameraMonitor(camera, 250.0, 1.6)
    rng = np.random.default_rng(0)
    for k in range(150):  # errors as the filter expects them
        monitor.check_tilt(0.033 * k, math.radians(0.5) * rng.standard_normal(2), math.radians(0.5))
    assert monitor.diagnose_at(0.033 * 149).fault == ""
    assert monitor.diagnose_tilt_at(0.033 * 149).fault == ""
    for k in range(150, 240):
        monitor.check_tilt(0.033 * k, math.radians(0.5) * rng.standard_normal(2) + [0.04, 0.0], math.radians(0.5))
    assert monitor.diagnose_tilt_at(0.033 * 239).fault == "tilted"
    assert "degrees off the attitude" in monitor.diagnose_tilt_at(0.033 * 239).message
    assert monitor.diagnose_at(0.033 * 239).fault == ""  # poses continue, less accurate
    message = monitor.diagnose_tilt_at(0.033 * 239).message
    for k in range(240, 300):
        monitor.check_tilt(0.033 * k, math.radians(0.5) * rng.standard_normal(2) + [0.035, 0.0], math.radians(0.5))
        assert monitor.diagnose_tilt_at(0.033 * k).message == message
    for k in range(300, 390):
        monitor.check_tilt(0.033 * k, math.radians(0.5) * rng.standard_normal(2) + [0.12, 0.0], math.radians(0.5))
    assert monitor.diagnose_at(0.033 * 389).fault == "tilted"


def test_poses_of_a_tilted_camera_continue_with_a_larger_covariance(flown: Flown) -> None:
    camera, sigma = load_camera("mufly-2.0"), []
    for tilt_rad in (0.0, 0.03):
        slam = SlamSystem(camera, start=[*flown[0][1].position[:2].tolist(), 0.0])
        for k in range(90):
            slam.monitor.check_tilt(flown[0][0].time_s - 3.0 + 0.033 * k, np.array([tilt_rad, 0.0]), math.radians(0.3))
        result = [slam.process_frame(f) for f, _ in flown[:6]][-1]
        assert result.trusted
        assert ("degrees off the attitude" in result.camera_fault) == (tilt_rad > 0.0)
        assert set(slam.camera_verdicts) == ({"tilted"} if tilt_rad else set())
        sigma.append(math.sqrt(result.covariance[0, 0]))
    height_m = flown[0][0].vehicle_estimate.height_m
    assert sigma[1] == pytest.approx(math.hypot(sigma[0], math.radians(4.0) * height_m), rel=0.1)


@pytest.mark.parametrize("yaw_rate", [0.4, -0.4])
def test_a_steady_velocity_is_no_motion_while_the_nose_turns(yaw_rate: float) -> None:
    """A tilt against the wind looks like a steady velocity; it turns in the picture, against the nose."""
    dt, seen, slow = 0.04, 80.0 + 30.0j, np.full(2, 80.0 + 30.0j)
    for _ in range(100):
        seen *= cmath.exp(-1j * yaw_rate * dt)
        slow = low_pass_motion(slow, np.full(2, seen), dt, yaw_rate)
        assert np.allclose(slow, seen)
