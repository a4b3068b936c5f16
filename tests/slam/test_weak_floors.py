"""Information of patches against their scatter, and flights over floors with little texture."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from mufly.camera import Floor, load_camera
from mufly.slam import SlamSystem, make_square_path, render_frames
from mufly.slam.image_tools import subtract_local_mean, track_points, warp_over_picture
from mufly.slam.images.direct_alignment import add_point_errors
from mufly.slam.images.patch_information import measure_patch_shifts

cv2 = pytest.importorskip("cv2")
SMOOTH_PX, NOISE = 1.6, 8.0
LEVEL_AXES = np.eye(2)[None]


def _noisy(rng: np.random.Generator, grey: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur((grey + NOISE * rng.standard_normal(grey.shape)).astype(np.float32), (0, 0), SMOOTH_PX)


def test_the_covariance_of_a_patch_is_its_scatter_and_the_cramer_rao_bound() -> None:
    """Known gradients: 60 and 45 grey levels, waves of 28 and 32 pixels; 300 draws of noise in both pictures."""
    rng, off, information = np.random.default_rng(0), [], []
    y, x = np.mgrid[:61, :61]

    def floor(dx: float, dy: float) -> np.ndarray:
        return 60 * np.sin(2 * np.pi * (x - dx) / 28 + 1) + 45 * np.sin(2 * np.pi * (y - dy) / 32 + 0.3)

    middle = np.array([[30.0, 30.0]])
    for _ in range(300):
        shift = rng.uniform(-0.3, 0.3, 2)
        template, picture = _noisy(rng, floor(0.0, 0.0)), _noisy(rng, floor(*shift))
        found = measure_patch_shifts(template, picture, middle, middle + shift, SMOOTH_PX, LEVEL_AXES)
        off.append(found.shift_px[0])
        information.append(found.information[0])
    variance = np.diag(np.linalg.inv(np.mean(information, axis=0)))
    assert np.var(off, axis=0) / variance == pytest.approx(1.0, abs=0.2)
    # Least variance of a shift between two pictures: 2 sigma^2 / sum of squared gradients, blurred, without their mean
    smoothed = cv2.GaussianBlur(floor(0.0, 0.0), (0, 0), SMOOTH_PX)[21:40, 21:40]
    # Blur carries the gradients of one more spot into the patch, on each side.
    side = (1.0 + math.sqrt(math.pi) * SMOOTH_PX / 19.0) ** 2
    bound = [2 * NOISE**2 / (side * 361 * np.gradient(smoothed, axis=k).var()) for k in (1, 0)]
    assert variance / bound == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("contrast", [0.0, 25.0])
def test_a_direction_without_texture_has_no_information(contrast: float) -> None:
    rng = np.random.default_rng(1)
    columns, rows = np.meshgrid(np.arange(20, 310, 21), np.arange(20, 230, 21))
    points = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    stripes = 128 + contrast * np.sin(2 * np.pi * np.mgrid[:240, :320][1] / 24)
    pair = [subtract_local_mean(np.clip(_noisy(rng, stripes), 0, 255).astype(np.uint8)) for _ in range(2)]
    # North is up in the picture, east to the right.
    axes = np.tile([[0.0, 1.0], [-1.0, 0.0]], (len(points), 1, 1))
    found = measure_patch_shifts(*pair, points, points, SMOOTH_PX, axes)
    assert found.textured_directions.tolist() == [False, contrast > 0.0]
    along = axes @ found.directions[0]
    assert np.abs(np.einsum("nij,nj->ni", found.information, along)).max() < 1e-9
    assert np.abs(np.einsum("ni,ni->n", found.shift_px, along)).max() < 1e-9
    assert math.isinf(found.cramer_rao_bound_px[0])
    if contrast:
        assert abs(found.directions[0] @ [1.0, 0.0]) > 0.999  # along the columns, hence north
        assert found.cramer_rao_bound_px[1] < 0.02
        errors = np.full(len(points), 0.5)
        assert np.abs(np.linalg.det(add_point_errors(found.information, errors))).max() < 1e-9


def test_weak_texture_is_tracked_under_shading_that_moves_with_the_camera() -> None:
    """A keyframe 90 pixels away, predicted 3 pixels off, under a vignette and the soft edge of the vehicle's shadow."""
    rng = np.random.default_rng(2)
    texture = cv2.GaussianBlur(rng.standard_normal((500, 500)).astype(np.float32), (0, 0), 3.0)
    floor = 100 + 14 * texture / texture.std()
    y, x = np.mgrid[:240, :320]
    light = 1 - 0.35 * np.hypot(x - 160, y - 120) ** 2 / 200**2
    light *= 1 - 0.25 / (1 + np.exp(-(y - 110) / 15))
    moved, error = np.array([20.0, 90.0]), np.array([2.0, -2.0])

    def view(corner: np.ndarray) -> np.ndarray:
        seen = cv2.getRectSubPix(floor, (320, 240), tuple(corner + np.array([159.5, 119.5])))
        return np.clip(_noisy(rng, seen * light), 0, 255).astype(np.uint8)

    corner = np.array([100.0, 120.0])
    keyframe, picture = view(corner), view(corner - moved)
    homography = np.array([[1.0, 0, moved[0] + error[0]], [0, 1, moved[1] + error[1]], [0, 0, 1]])
    template, covered = warp_over_picture(keyframe, homography, picture)
    columns, rows = np.meshgrid(np.arange(20, 310, 20), np.arange(20, 230, 20))
    points = np.column_stack([columns.ravel(), rows.ravel()]).astype(float)
    points = points[covered[points[:, 1].astype(int), points[:, 0].astype(int)] > 0]
    seen, correlation, _ = track_points(template, picture, points, SMOOTH_PX, math.inf)
    good = (np.hypot(*(seen - points + error).T) < 1.5) & (correlation > 0.5)
    assert good.mean() > 0.9


def _fly(floor: Floor, seed: int, seconds: float) -> tuple[list, list]:
    camera = load_camera("mufly-2.0")
    path = make_square_path(duration_s=seconds, side_m=2.0, speed_m_s=0.4, seed=seed)
    slam, answers, truth = None, [], []
    for frame, motion in render_frames(camera, floor, path, duration_s=seconds, seed=seed):
        heading = math.atan2(motion.attitude[1, 0], motion.attitude[0, 0])
        slam = slam or SlamSystem(camera, start=(*motion.position[:2], heading), seed=seed)
        answers.append(slam.process_frame(frame))
        truth.append((*motion.position, heading))
    return answers, truth


@pytest.mark.parametrize("kind", ["concrete", "felt"])
def test_a_floor_below_the_noise_is_tracked_by_all_patches_together(
    kind: str, make_weak_floor: Callable[[str, int], Floor]
) -> None:
    answers, truth = _fly(make_weak_floor(kind, 6), 6, 3.0)
    trusted = [(a, t) for a, t in zip(answers, truth, strict=True) if a.trusted]
    assert len(trusted) > 0.95 * len(answers)
    off = np.array([np.append(a.position, a.heading) - t for a, t in trusted[1:]])
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.06
    nees = [e @ np.linalg.solve(a.covariance, e) / 4 for e, (a, _) in zip(off, trusted[1:], strict=True)]
    assert np.mean(nees) < 2.0
    assert all(a.known_axes.all() for a, _ in trusted)
    assert 1e-5 < answers[20].texture_bound_m < 0.005


def test_along_stripes_the_place_is_only_predicted(make_weak_floor: Callable[[str, int], Floor]) -> None:
    answers, truth = _fly(make_weak_floor("stripes", 6), 6, 1.5)
    trusted = [(a, np.array(t)) for a, t in zip(answers, truth, strict=True) if a.trusted][1:]
    assert len(trusted) > 12
    north, east = (np.sqrt([a.covariance[k, k] for a, _ in trusted]) for k in (0, 1))
    assert north[-1] > 0.1  # it grows with time, while east stays known
    assert np.median(east) < 0.02
    for a, true in trusted:
        e = a.position[:2] - true[:2]
        assert e @ np.linalg.solve(a.covariance[:2, :2], e) < 16.0
    assert not answers[-1].trusted or answers[-1].covariance[0, 0] > 0.1**2
