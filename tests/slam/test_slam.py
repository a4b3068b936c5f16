"""Visual SLAM: its equations against closed forms, a short flight over floors, and what it refuses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mufly.camera import body_from_camera_rotation, load_camera, make_random_floor
from mufly.dynamics import GRAVITY
from mufly.errors import InputError
from mufly.slam import SlamSystem, evaluate_trajectory, make_square_path, render_frames, run_slam
from mufly.slam.camera_frame import CameraFrame, FrameEstimate, MotionPrior, Odometry
from mufly.slam.camera_pose import (
    PoseEstimate,
    ViewPrior,
    attitude_matrix,
    compute_ray_slopes,
    d_rays_d_tilt,
    solve_pose,
    solve_pose_by_ransac,
)
from mufly.slam.image_tools import find_repeat_shifts
from mufly.slam.keyframe_map import residuals_without_pose_error
from mufly.slam.keyframe_matching import POINT_VARIANCE_INFLATION, KeyframeMatch
from mufly.slam.place_recognition import is_unambiguous
from mufly.slam.pose_graph import (
    GraphEdge,
    KeyframePriors,
    relative_pose,
    relative_pose_jacobians,
    solve_graph,
)
from mufly.slam.tracking_breaks import TrackingBreaks

TILT = math.radians(0.5)


def _case(rng: np.random.Generator, noise: float) -> tuple:
    """A view and points of the floor that it sees: with shaking, rolling shutter, velocity."""
    tilt, shakes = TILT * rng.standard_normal(2), 1.5 * rng.standard_normal(8)
    view = ViewPrior(
        250.0, body_from_camera_rotation(load_camera("mufly-2.0")), 0.05, -0.03, np.array([0.2, -0.3, 0.1]),
        np.array([0.3, -0.2, 0.05]), 1.0 + 0.01 * rng.standard_normal(), 0.01, 1.5, np.array([370.0, 430.0]),
    )  # fmt: skip
    n, height, heading = 90, 1.0, 0.4
    pixels = np.column_stack([rng.uniform(-150, 150, n), rng.uniform(-110, 110, n)])
    seconds = pixels[:, 1] / 240 * 0.03
    m = compute_ray_slopes(view, pixels, seconds, attitude_matrix(view, tilt, heading), shakes)
    down = height - view.velocity_m_s[2] * seconds
    points = np.column_stack([0.2 + 0.3 * seconds + down * m.real, -0.1 - 0.2 * seconds + down * m.imag, np.zeros(n)])
    truth = np.array([0.2, -0.1, height, heading, *tilt, 0.0, 0.0])
    return view, points, pixels + noise * rng.standard_normal((n, 2)), seconds, truth


def test_the_covariance_of_a_pose_is_true() -> None:
    rng, nees = np.random.default_rng(1), []
    bend, tilts, sigma = (
        np.zeros((90, 2, 2)),
        np.diag([TILT**2, TILT**2, 1e-12, 1e-12]),
        np.full((90, 1, 1), 0.3**-2) * np.eye(2),
    )
    for _ in range(200):
        view, points, pixels, seconds, truth = _case(rng, 0.3)
        pose = solve_pose(view, np.array([0.1, 0.0, 1.0, 0.3]), points, bend, tilts, pixels, seconds, sigma)
        off = (pose.state - truth)[:6]
        nees.append(off @ np.linalg.solve(pose.covariance[:6, :6], off) / 6)
        # What pixels say alone, and what was known before, are together what was found.
        prior = np.zeros((8, 8))
        prior[2, 2], prior[4:, 4:] = view.height_sigma_m**-2, np.linalg.inv(tilts)
        known = np.array([*pose.state[:2], view.height_m, pose.state[3], *np.zeros(4)])
        assert np.linalg.inv(pose.pixel_information + prior) == pytest.approx(pose.covariance)
        assert pose.covariance @ (
            pose.pixel_gradient + prior @ (known - pose.state) / max(1.0, pose.residual_ratio) ** 2
        ) == pytest.approx(np.zeros(8), abs=1e-9)
    assert 0.75 < np.mean(nees) < 1.2


def test_a_tilt_that_all_keyframes_share_is_in_the_covariance_of_the_heading() -> None:
    """A way of fifteen heights; edges do not tell tilts, as where shaking hides the shear."""
    rng, n, sigma, nees, told = np.random.default_rng(4), 30, np.array([0.003, 0.003, 0.002, 0.003]), [], []
    true = np.zeros((n, 7))
    true[:, 0] = 0.5 * np.arange(n)
    known = KeyframePriors(
        np.arange(n, dtype=float), np.zeros(n), *(np.full(n, q) for q in (0.01, 2.0, TILT, 1e3, 0.0))
    )
    information = np.zeros((8, 8))
    # What pixels see: the step's heading less half a slope's way times the roll that both are off by
    to = np.hstack([np.eye(4), np.zeros((4, 4))])
    to[2, 4] = to[2, 6] = -0.25 * 0.5
    information = to.T @ np.diag(sigma**-2) @ to
    for _ in range(60):
        true[:, 4:6] = TILT * rng.standard_normal(2)
        true[:, 6] = -true[:, 3]
        edges = []
        for k in range(n - 1):
            seen = relative_pose(true[k], true[k + 1]) + sigma * rng.standard_normal(4)
            seen[2] -= 0.25 * true[k, 4]
            edges.append(GraphEdge(k, k + 1, np.concatenate([seen, np.zeros(4)]), information))
        solution = solve_graph(true, edges, known, (0.0, 0.0))
        off = (solution.nodes - true)[-1, :3]
        covariance = solution.joint_covariance([n - 1])[:3, :3]
        nees.append(off @ np.linalg.solve(covariance, off) / 3)
        told.append(math.sqrt(covariance[2, 2]))
    assert 0.7 < np.mean(nees) < 1.35
    alone = 0.002 * math.sqrt(n - 1)
    assert np.mean(told) == pytest.approx(math.hypot(alone, 0.25 * (n - 1) * TILT), rel=0.02)


def test_two_points_and_the_tilt_among_wrong_matches() -> None:
    rng = np.random.default_rng(2)
    m = rng.uniform(-0.6, 0.6, 60) + 1j * rng.uniform(-0.5, 0.5, 60)
    places = 0.3 - 0.2j + 1.1 * np.exp(0.7j) * m
    places[::2] += rng.uniform(0.2, 1.0, 30)
    c, h, heading, fits = solve_pose_by_ransac(places, m, np.full(60, 0.004), 1.1, 0.02, rng)
    assert abs(c - (0.3 - 0.2j)) < 1e-9
    assert (h, heading) == pytest.approx((1.1, 0.7))
    assert fits.tolist() == [k % 2 == 1 for k in range(60)]


@pytest.mark.filterwarnings("error")
def test_two_points_of_one_place_are_no_height_of_zero() -> None:
    """On the floor the height is known to less than itself, and words of ORB may speak of one place twice."""
    rng = np.random.default_rng(2)
    m = rng.uniform(-0.6, 0.6, 60) + 1j * rng.uniform(-0.5, 0.5, 60)
    places: np.ndarray = 0.05 * m
    places[::3] = places[0]
    _, h, _, fits = solve_pose_by_ransac(places, m, np.full(60, 0.004), 0.05, 0.02, rng)
    assert h == pytest.approx(0.05)
    assert fits.sum() >= 40
    assert not solve_pose_by_ransac(0.0 * m, m, np.full(60, 0.004), 0.05, 0.02, rng)[3].any()


def test_a_graph_closes_its_loop_and_shrugs_off_a_wrong_closure() -> None:
    rng = np.random.default_rng(3)
    angles = np.linspace(0, 6.0, 25)
    true = np.zeros((25, 7))
    true[:, :4] = np.array([[math.cos(a), math.sin(a), a, 0.05 * math.sin(3 * a)] for a in angles])
    sigma = np.array([0.01, 0.01, 0.01, 0.003])
    information = np.diag([*sigma**-2, *np.zeros(4)])

    def edge(first: int, second: int, noise: np.ndarray, closes: bool = False) -> GraphEdge:
        seen = relative_pose(true[first], true[second]) + noise
        return GraphEdge(first, second, np.concatenate([seen, np.zeros(4)]), information, is_loop_closure=closes)

    edges = [edge(k, k + 1, sigma * rng.standard_normal(4)) for k in range(24)]
    heights = true[:, 3] + 0.01 * rng.standard_normal(25)
    known = KeyframePriors(angles, heights, *(np.full(25, q) for q in (0.01, 0.1, TILT, 2.0, 0.0)))
    open_ = solve_graph(true, edges, known, (0.0, 0.0))
    closure = edge(0, 24, np.zeros(4), True)
    closed = solve_graph(true, [*edges, closure], known, (0.0, 0.0))
    away = [np.hypot(*(s.nodes - true)[-1, :2]) for s in (open_, closed)]
    assert away[1] < 0.4 * away[0]
    wrong = edge(0, 12, 0.5 * np.eye(4)[0], True)
    borne = solve_graph(true, [*edges, closure, wrong], known, (0.0, 0.0))
    assert np.abs(borne.nodes - closed.nodes)[:, :2].max() < 0.05
    off = (open_.nodes - true)[-1, :4]
    assert off @ np.linalg.solve(open_.joint_covariance([24])[:4, :4], off) < 20


def test_what_pose_and_tilts_explain_is_not_the_floors_shape() -> None:
    rng = np.random.default_rng(5)
    own, seen, noise = 0.4 * rng.standard_normal((3, 160)).view(np.complex128)
    weight = rng.uniform(0.5, 2.0, 80)
    turns = d_rays_d_tilt(own) @ [0.004, -0.002] + d_rays_d_tilt(seen) @ [-0.003, 0.001]
    pose = 0.01 - 0.02j + (0.003 + 0.005j) * own + turns[:, 0] + 1j * turns[:, 1]
    assert np.abs(residuals_without_pose_error(pose, own, seen, weight)).max() < 1e-12
    left = residuals_without_pose_error(pose + noise, own, seen, weight)
    assert left == pytest.approx(residuals_without_pose_error(noise, own, seen, weight), abs=1e-12)
    assert abs(np.sum(weight**2 * left)) < 1e-9
    assert 0.8 < np.linalg.norm(left) / np.linalg.norm(noise) < 1.0  # eight of 160 numbers are gone


def test_the_slopes_of_a_relation() -> None:
    a, b = np.array([0.3, -0.2, 0.5, 0.1]), np.array([0.9, 0.4, 0.8, -0.1])
    by_a, by_b = relative_pose_jacobians(a, b)
    for k in range(4):
        d = 1e-6 * np.eye(4)[k]
        assert (relative_pose(a + d, b) - relative_pose(a - d, b)) / 2e-6 == pytest.approx(by_a[:, k], abs=1e-6)
        assert (relative_pose(a, b + d) - relative_pose(a, b - d)) / 2e-6 == pytest.approx(by_b[:, k], abs=1e-6)


def _flown(camera: str, floor: str, pictures: int, **more: float) -> tuple:
    lens = load_camera(camera)
    seconds = pictures * float(lens.sensor.period)
    path = make_square_path(duration_s=seconds, side_m=1.0, seed=4, **more)
    made = list(render_frames(lens, make_random_floor(floor, 4, size=1024), path, seed=4))
    return lens, path, made


def test_at_the_dissertations_quality_it_knows_where_it_is_and_finds_itself_again(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    lens, path, made = _flown("mufly-2.0", "rich", 90)
    motion = made[0][1]
    slam = SlamSystem(lens, start=(*motion.position[:2], math.atan2(motion.attitude[1, 0], motion.attitude[0, 0])))
    found = run_slam(slam, (f for f, _ in made))
    result = evaluate_trajectory(
        found.time,
        found.position,
        found.heading,
        found.covariance,
        path.time_s,
        path.position_m,
        path.attitude_rad[:, 2],
        found.pictures,
    )
    assert result.lost_share < 0.05
    assert result.horizontal_rms_m < 0.05
    assert 0.2 < result.nees < 3.0
    # The map is kept, and who starts anywhere in it finds where that is.
    slam.floor_map.save(tmp_path / "map")
    from mufly.slam import FloorMap

    again = SlamSystem(lens, FloorMap.load(tmp_path / "map"))
    here = [again.process_frame(f) for f, _ in made[60:90]]
    first = next(k for k, a in enumerate(here) if a.trusted)
    assert np.hypot(*(here[first].position - made[60 + first][1].position)[:2]) < 0.1
    (tmp_path / "map").write_bytes(b"PK damaged")
    with pytest.raises(InputError, match="is not a map"):
        FloorMap.load(tmp_path / "map")


def test_what_it_cannot_see_it_does_not_answer() -> None:
    pytest.importorskip("cv2")
    lens, _, made = _flown("webcam", "rich", 45)
    slam = SlamSystem(lens)
    for k, (f, _) in enumerate(made):
        if k >= 20:  # the lens is covered
            noise = np.random.default_rng(k).normal(6, 2, f.picture.shape).clip(0, 255).astype(np.uint8)
            f = type(f)(f.time_s, noise, f.vehicle_estimate)
        last = slam.process_frame(f)
        assert last.trusted == (k < 20)
    assert "too few points of the floor" in last.reason
    with pytest.raises(InputError, match="is 100 by 80 pixels, the camera file states 320 by 240"):
        slam.process_frame(type(f)(99.0, np.zeros((80, 100), np.uint8), f.vehicle_estimate))
    assert not slam.process_frame(made[0][0]).trusted  # older than the last


def test_the_way_since_an_answer_is_added_up_from_told_velocities() -> None:
    """Picture by picture, some lost: a way that speeds up evenly comes out exactly, and is known to s_v t."""
    v, a = np.array([0.3, -0.1, 0.0]), np.array([0.8, 0.5, 0.0])
    way = Odometry(0.0, FrameEstimate(0.0, 0.0, 1.0, velocity=v))
    silent = Odometry(0.0, FrameEstimate(0.0, 0.0, 1.0))
    for t in (0.03, 0.06, 0.13, 0.16, 0.2):
        told = FrameEstimate(0.0, 0.0, 1.0, np.array([0.0, 0.0, 2.0 * t]), velocity=v + a * t, velocity_sigma=0.05)
        way, silent = way.advance_to(t, told), silent.advance_to(t, replace(told, velocity=None))
    moved, sigma_m = way.predict_displacement(np.zeros(2))
    assert moved == pytest.approx([*(v * 0.2 + 0.5 * a * 0.04)[:2], 0.04])
    assert 0.05 * 0.2 < sigma_m < 0.05 * 0.2 + 0.003
    # Without a told velocity: that of the answers before, and all that is not foreseen
    moved, sigma_m = silent.predict_displacement(v[:2])
    assert moved[:2] == pytest.approx(v[:2] * 0.2)
    assert sigma_m == pytest.approx(0.02 * 0.2 + 0.5 * 0.04)
    assert not silent.advance_to(0.23, told).has_all_velocities  # a velocity that comes late says nothing of before


def test_a_tilted_helicopter_accelerates_and_a_carried_one_may_not() -> None:
    level = FrameEstimate(0.0, 0.0, 1.0, rotor_speed=np.full(2, 400.0))
    for rotors, gained in ((400.0, GRAVITY * 0.1 * math.tan(0.1)), (0.0, 0.0)):
        motion = MotionPrior().restart_at(CameraFrame(0.0, np.zeros((2, 2), np.uint8), replace(level, pitch=-0.1)))
        told = replace(level, pitch=-0.1, rotor_speed=np.full(2, rotors))
        motion = motion.advance_to(CameraFrame(0.1, np.zeros((2, 2), np.uint8), told), heading_rad=0.5 * math.pi)
        assert motion.velocity_m_s == pytest.approx([0.0, gained], abs=1e-12)  # nose down, nose to the east


def test_more_points_never_beat_the_error_that_all_share() -> None:
    pose = PoseEstimate(
        np.zeros(8), np.zeros(8), np.eye(8), np.eye(8), np.zeros(8), 1.0, np.zeros(1), np.zeros((1, 2))
    )  # fmt: skip
    match = replace(KeyframeMatch.from_pose(pose), inlier_indices=np.zeros(1, np.intp), common_variance_m2=1e-6)
    for scale in (1e2, 1e5, 1e8):
        rich = replace(match, pose=replace(pose, pixel_information=scale * np.eye(8)))
        variance = rich.mean_position_variance * rich.variance_inflation
        assert variance == pytest.approx(POINT_VARIANCE_INFLATION / scale + 1e-6)
    striped = replace(match, untextured_directions=np.array([[1.0, 0.0]]))
    assert striped.variance_inflation == POINT_VARIANCE_INFLATION


def test_what_repeats_is_told_apart_only_by_a_way_that_is_known() -> None:
    pytest.importorskip("cv2")
    one = np.random.default_rng(6).normal(120, 40, (8, 8)).clip(0, 255).repeat(4, axis=0).repeat(4, axis=1)
    tiles = np.tile(one, (8, 10))[:240, :320].astype(np.uint8)
    found = find_repeat_shifts(tiles)
    assert np.hypot(*found.T).min() == pytest.approx(32.0)
    rough = np.random.default_rng(7).normal(120, 40, (60, 80)).clip(0, 255).astype(np.uint8)
    assert not len(find_repeat_shifts(rough.repeat(4, axis=0).repeat(4, axis=1)))
    tile = 0.256 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    assert is_unambiguous(np.zeros(2), tile, 0.06)
    assert not is_unambiguous(np.zeros(2), tile, 0.08)
    assert is_unambiguous(np.array([0.05, 0.05]), tile, 0.04)
    assert not is_unambiguous(np.array([0.13, 0.0]), tile, 0.001)
    assert is_unambiguous(np.array([0.5, 0.0]), tile[:0], 1.0)  # nothing looks alike


@pytest.mark.parametrize("floor", ["tiles", "rich"])
def test_over_tiles_only_the_way_since_tells_which_tile_it_is(floor: str) -> None:
    """0.4 s without a picture: told rightly, the place is found at once; told 0.3 m/s wrongly, half a tile by then,
    the next tile is refused and it begins anew where it believes to be; a floor that repeats nothing is found."""
    pytest.importorskip("cv2")
    lens, _, made = _flown("webcam", floor, 75, speed_m_s=0.8)
    nothing = np.full_like(made[0][0].picture, 6)
    gap = range(50, 62)
    headings = [math.atan2(m.attitude[1, 0], m.attitude[0, 0]) for _, m in made]
    for wrong in (0.0, 0.3):
        slam = SlamSystem(lens, start=(*made[0][1].position[:2], headings[0]))
        answers = []
        for k, (f, m) in enumerate(made):
            faster = wrong * (k >= gap[0])
            # The place that it believes goes wrong with the velocity, as the filter's does.
            lag = faster * (f.time_s - made[gap[0]][0].time_s)
            told = replace(
                f.vehicle_estimate, velocity=m.velocity + np.array([faster, 0.0, 0.0]), velocity_sigma=0.1,
                place=np.array([m.position[0] + lag, m.position[1], headings[k]]), place_sigma=(0.05, 0.01),
            )  # fmt: skip
            answers.append(
                slam.process_frame(replace(f, picture=nothing if k in gap else f.picture, vehicle_estimate=told))
            )
        after = next(k for k in range(gap[-1] + 1, len(made)) if answers[k].trusted)
        off = np.hypot(*(answers[after].position - made[after][1].position)[:2])
        if wrong and floor == "tiles":  # later, but not never; as wrong as told, not by a tile
            assert "the floor repeats every 0.2" in answers[gap[-1] + 1].reason
            assert 0.1 < off < 0.2
        else:
            assert after == gap[-1] + 1
            assert off < 0.03


def test_a_place_found_far_from_the_prediction_is_a_look_alike() -> None:
    """After a gap, in which the vehicle moves by one metre or stays, the same pictures return."""
    pytest.importorskip("cv2")
    lens, _, made = _flown("webcam", "rich", 60)
    period = made[1][0].time_s - made[0][0].time_s
    before, gap = 45, round(1.0 / period)
    for moved_m in (0.0, 1.0):
        motion = made[0][1]
        slam = SlamSystem(lens, start=(*motion.position[:2], math.atan2(motion.attitude[1, 0], motion.attitude[0, 0])))
        results = []
        for k in range(before + gap + 15):
            in_gap = before <= k < before + gap
            frame, motion = made[k if k < before else before - 1 if in_gap else before - 1 - (k - before - gap)]
            velocity = np.array([0.0, moved_m, 0.0]) if in_gap else motion.velocity
            told = replace(frame.vehicle_estimate, velocity=velocity, velocity_sigma=0.1)
            picture = np.full_like(frame.picture, 6) if in_gap else frame.picture
            results.append(slam.process_frame(CameraFrame(k * period, picture, told)))
        assert any(r.trusted for r in results[before + gap :]) == (moved_m == 0.0)


@pytest.mark.parametrize("flip", ["upside down", "mirrored"])
def test_pictures_that_flip_in_flight_give_no_pose_and_are_reported(flip: str) -> None:
    """The tracker finds points in any picture; what it shares with the keyframe tells that it is another one."""
    pytest.importorskip("cv2")
    lens, _, made = _flown("mufly-2.0", "rich", 100, speed_m_s=0.5)
    headings = [math.atan2(m.attitude[1, 0], m.attitude[0, 0]) for _, m in made]
    slam = SlamSystem(lens, start=(*made[0][1].position[:2], headings[0]))
    results = []
    for k, (frame, motion) in enumerate(made):
        picture = frame.picture
        if k >= 60:
            picture = np.ascontiguousarray(picture[::-1, ::-1] if flip == "upside down" else picture[::-1])
        told = replace(
            frame.vehicle_estimate, velocity=motion.velocity, velocity_sigma=0.1,
            place=np.array([*motion.position[:2], headings[k]]), place_sigma=(0.05, 0.01),
            rotor_speed=np.array([370.0, 430.0]),
        )  # fmt: skip
        results.append(slam.process_frame(replace(frame, picture=picture, vehicle_estimate=told)))
    assert sum(r.trusted for r in results[20:60]) > 35
    assert not any(r.trusted for r in results[60:])
    assert "check mount.turn" in results[-1].camera_fault or "mirrored" in results[-1].camera_fault


def test_a_break_needs_several_rich_pictures_of_a_floor_that_should_be_seen() -> None:
    rng = np.random.default_rng(1)
    rich = rng.integers(0, 255, (40, 60)).astype(np.uint8)
    dark = np.full_like(rich, 5)
    seen = [(0.9, rich)] * 2
    for also, broken in (((0.9, rich), True), ((0.9, dark), False), ((0.3, rich), False)):
        breaks = TrackingBreaks()
        assert [breaks.add_failure(share, q, rich, 7) for share, q in [*seen, also]] == [False, False, broken]
        assert breaks.keyframe_count == (7 if broken else 0)


def test_a_match_with_little_of_the_usual_texture_is_refused_on_rich_floors_only() -> None:
    none = np.zeros(8)
    pose = PoseEstimate(none, none, np.eye(8), np.eye(8), none, 1.0, np.zeros(1), np.zeros((1, 2)))
    match = KeyframeMatch.from_pose(pose)
    for usual, refused in ((12.0, True), (2.0, False)):
        breaks = TrackingBreaks()
        breaks.add_match(replace(match, significances=np.array([usual, 1.5 * usual])))
        assert not breaks.rejection_reason(replace(match, significances=np.array([1.0, 0.5]) * usual))
        poorer = replace(match, significances=np.array([0.2, 1.5]) * usual)
        assert bool(breaks.rejection_reason(poorer)) == refused
        # A keyframe made over a poorer floor after a loss has its own usual texture.
        assert not breaks.rejection_reason(replace(poorer, keyframe_index=3))
        breaks.add_match(replace(poorer, keyframe_index=3))
        assert not breaks.rejection_reason(replace(poorer, keyframe_index=3))
