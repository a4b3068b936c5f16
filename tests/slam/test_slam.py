"""Visual SLAM: its equations against closed forms, a short flight over floors, and what it refuses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mufly.camera import body_from_camera, load_camera, make_floor
from mufly.errors import InputError
from mufly.slam import Slam, evaluate, frames, rounds, run
from mufly.slam.graph import Edge, relation, slopes_of, solve_graph
from mufly.slam.pose import View, level, slopes, solve, two_points

TILT = math.radians(0.5)


def _case(rng: np.random.Generator, noise: float) -> tuple:
    """A view and points of the floor that it sees: with shaking, rolling shutter, velocity."""
    tilt, shakes = TILT * rng.standard_normal(2), 1.5 * rng.standard_normal(8)
    view = View(
        250.0, body_from_camera(load_camera("mufly-2.0")), 0.05, -0.03, np.array([0.2, -0.3, 0.1]),
        np.array([0.3, -0.2, 0.05]), 1.0 + 0.01 * rng.standard_normal(), 0.01, TILT, 1.5, np.array([370.0, 430.0]),
    )  # fmt: skip
    n, height, heading = 90, 1.0, 0.4
    pixels = np.column_stack([rng.uniform(-150, 150, n), rng.uniform(-110, 110, n)])
    seconds = pixels[:, 1] / 240 * 0.03
    m = slopes(view, pixels, seconds, level(view, tilt, heading), shakes)
    down = height - view.velocity[2] * seconds
    points = np.column_stack(
        [0.2 + 0.3 * seconds + down * m.real, -0.1 - 0.2 * seconds + down * m.imag, np.zeros(n)]
    )
    truth = np.array([0.2, -0.1, height, heading, *tilt, 0.0, 0.0])
    return view, points, pixels + noise * rng.standard_normal((n, 2)), seconds, truth


def test_the_covariance_of_a_pose_is_true() -> None:
    rng, nees = np.random.default_rng(1), []
    bend, tiny, sigma = np.zeros((90, 2, 2)), 1e-12 * np.eye(2), np.full(90, 0.3)
    for _ in range(200):
        view, points, pixels, seconds, truth = _case(rng, 0.3)
        pose = solve(view, np.array([0.1, 0.0, 1.0, 0.3]), points, bend, tiny, pixels, seconds, sigma)
        off = (pose.x - truth)[:6]
        nees.append(off @ np.linalg.solve(pose.covariance[:6, :6], off) / 6)
    assert 0.75 < np.mean(nees) < 1.2


def test_two_points_and_the_tilt_among_wrong_matches() -> None:
    rng = np.random.default_rng(2)
    m = rng.uniform(-0.6, 0.6, 60) + 1j * rng.uniform(-0.5, 0.5, 60)
    places = 0.3 - 0.2j + 1.1 * np.exp(0.7j) * m
    places[::2] += rng.uniform(0.2, 1.0, 30)
    c, h, heading, fits = two_points(places, m, np.full(60, 0.004), 1.1, 0.02, rng)
    assert abs(c - (0.3 - 0.2j)) < 1e-9
    assert (h, heading) == pytest.approx((1.1, 0.7))
    assert fits.tolist() == [k % 2 == 1 for k in range(60)]


def test_a_graph_closes_its_loop_and_shrugs_off_a_wrong_closure() -> None:
    rng = np.random.default_rng(3)
    true = np.array([[math.cos(a), math.sin(a), a, 0.05 * math.sin(3 * a)] for a in np.linspace(0, 6.0, 25)])
    sigma = np.array([0.01, 0.01, 0.01, 0.003])
    edges = [
        Edge(k, k + 1, relation(true[k], true[k + 1]) + sigma * rng.standard_normal(4), np.diag(sigma**-2))
        for k in range(24)
    ]
    begin = np.zeros((25, 4))
    begin[0] = true[0]
    heights, spread = true[:, 3] + 0.01 * rng.standard_normal(25), np.full(25, 0.01)
    open_ = solve_graph(true, edges, heights, spread, (0.0, 0.0))
    closure = Edge(0, 24, relation(true[0], true[24]), np.diag(sigma**-2), closes=True)
    closed = solve_graph(true, [*edges, closure], heights, spread, (0.0, 0.0))
    away = [np.hypot(*(s.nodes - true)[-1, :2]) for s in (open_, closed)]
    assert away[1] < 0.4 * away[0]
    wrong = Edge(0, 12, relation(true[0], true[12]) + 0.5 * np.eye(4)[0], np.diag(sigma**-2), closes=True)
    borne = solve_graph(true, [*edges, closure, wrong], heights, spread, (0.0, 0.0))
    assert np.abs(borne.nodes - closed.nodes)[:, :2].max() < 0.05
    off = (open_.nodes - true)[-1]
    assert off @ np.linalg.solve(open_.covariance([24]), off) < 20


def test_the_slopes_of_a_relation() -> None:
    a, b = np.array([0.3, -0.2, 0.5, 0.1]), np.array([0.9, 0.4, 0.8, -0.1])
    by_a, by_b = slopes_of(a, b)
    for k in range(4):
        d = 1e-6 * np.eye(4)[k]
        assert (relation(a + d, b) - relation(a - d, b)) / 2e-6 == pytest.approx(by_a[:, k], abs=1e-6)
        assert (relation(a, b + d) - relation(a, b - d)) / 2e-6 == pytest.approx(by_b[:, k], abs=1e-6)


def _flown(camera: str, floor: str, pictures: int, **more: float) -> tuple:
    lens = load_camera(camera)
    seconds = pictures * float(lens.sensor.period)
    path = rounds(duration_s=seconds, side_m=1.0, seed=4, **more)
    made = list(frames(lens, make_floor(floor, 4, size=1024), path, seed=4))
    return lens, path, made


def test_at_the_dissertations_quality_it_knows_where_it_is_and_finds_itself_again(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    lens, path, made = _flown("mufly-2.0", "rich", 90)
    slam = Slam(lens, start=(*path.position[0, :2], made[0][1].attitude[1, 0]))
    found = run(slam, (f for f, _ in made))
    result = evaluate(
        found.time, found.position, found.heading, found.covariance, path.time, path.position, path.attitude[:, 2],
        found.pictures,
    )  # fmt: skip
    assert result.lost < 0.05
    assert result.rms_m < 0.05
    assert result.nees < 4.0
    # The map is kept, and who starts anywhere in it finds where that is.
    slam.map.save(tmp_path / "map")
    from mufly.slam import Map

    again = Slam(lens, Map.load(tmp_path / "map"))
    here = [again.step(f) for f, _ in made[60:90]]
    first = next(k for k, a in enumerate(here) if a.trusted)
    assert np.hypot(*(here[first].position - made[60 + first][1].position)[:2]) < 0.1
    (tmp_path / "map").write_bytes(b"PK damaged")
    with pytest.raises(InputError, match="is no map"):
        Map.load(tmp_path / "map")


def test_what_it_cannot_see_it_does_not_answer() -> None:
    pytest.importorskip("cv2")
    lens, _, made = _flown("webcam", "rich", 45)
    slam = Slam(lens)
    for k, (f, _) in enumerate(made):
        if k >= 20:  # the lens is covered
            noise = np.random.default_rng(k).normal(6, 2, f.picture.shape).clip(0, 255).astype(np.uint8)
            f = type(f)(f.time_s, noise, f.told)
        last = slam.step(f)
        assert last.trusted == (k < 20)
    assert "too little of the floor" in last.reason
    with pytest.raises(InputError, match="is 100 by 80 pixels, the camera file says 320 by 240"):
        slam.step(type(f)(99.0, np.zeros((80, 100), np.uint8), f.told))
    assert not slam.step(made[0][0]).trusted  # older than the last
