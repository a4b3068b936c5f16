"""The repulsive field (eqs 6.14 to 6.17) and the memory of what the beams hit."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.mission.avoidance import (
    MAP_CAPACITY,
    ObstacleMap,
    begin_path_check,
    check_map_part,
    insert_beam_hits,
    make_beam_ring,
    repulsive_force,
)
from mufly.world import Box, Cylinder, World, cast_ranges, compute_obstacle_distances

RING = make_beam_ring(8, math.pi / 8, 1.5)
FAR = [1.5] * 8
LEVEL = np.zeros(3)
some_ranges = st.lists(st.floats(0.05, 1.5), min_size=8, max_size=8)


def beams(x, attitude, world, beam=RING):
    cr, sr = math.cos(attitude[0]), math.sin(attitude[0])
    cp, sp = math.cos(attitude[1]), math.sin(attitude[1])
    cy, sy = math.cos(attitude[2]), math.sin(attitude[2])
    turn = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    turn = turn @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    turn = turn @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    body = np.stack([beam.cos, beam.sin, np.zeros_like(beam.cos)], axis=1)
    return cast_ranges(world, x, body @ turn.T, beam.max_range)


def test_beams_are_numbered_as_in_fig_6_18():
    angles = np.degrees(np.arctan2(RING.sin, RING.cos))
    np.testing.assert_allclose(angles, [22.5, 67.5, 112.5, 157.5, -157.5, -112.5, -67.5, -22.5])
    # Eq. 6.15 gives the direction of the force of beam i, which is opposite to the beam.
    alpha = np.arange(8) * math.pi / 4 + 9 * math.pi / 8
    for i in range(8):
        one = [0.5 if k == i else 1.5 for k in range(8)]
        f = 1 / 0.5 - 1 / 1.2
        np.testing.assert_allclose(repulsive_force(one, RING, 1.2), f * np.array([np.cos(alpha[i]), np.sin(alpha[i])]))


def test_nothing_near_gives_no_force():
    assert repulsive_force(FAR, RING, 1.5) == (0.0, 0.0)
    assert repulsive_force([0.8] * 8, RING, 0.8) == (0.0, 0.0)


@given(some_ranges, st.floats(0.3, 1.5))
def test_equal_ranges_all_round_cancel_and_opposite_ones_reverse(seen, threshold):
    np.testing.assert_allclose(repulsive_force([seen[0]] * 8, RING, threshold), 0.0, atol=1e-9)
    fx, fy = repulsive_force(seen, RING, threshold)
    bx, by = repulsive_force(seen[4:] + seen[:4], RING, threshold)
    np.testing.assert_allclose((bx, by), (-fx, -fy), atol=1e-9)


@given(st.floats(-math.pi, math.pi), st.floats(0.2, 0.9))
def test_the_force_points_away_from_a_wall(heading, gap):
    wall = World((Box((gap + 0.5, 0.0, -1.0), (1.0, 50.0, 4.0)),))
    seen = beams(np.array([0.0, 0.0, -1.0]), (0.0, 0.0, heading), wall).tolist()
    fx, fy = repulsive_force(seen, RING, 1.4)
    north = math.cos(heading) * fx - math.sin(heading) * fy
    assert north < 0.0
    # The wall is symmetrical about its normal, the ring is not quite: most of the force is along the normal.
    assert abs(north) > math.hypot(fx, fy) * 0.7


@given(some_ranges, st.floats(0.3, 1.5), st.integers(0, 7))
def test_nearer_means_stronger(seen, threshold, i):
    seen = [max(v, threshold) for v in seen]
    weak, strong = list(seen), list(seen)
    weak[i], strong[i] = 0.6 * threshold, 0.3 * threshold
    assert (
        math.hypot(*repulsive_force(strong, RING, threshold))
        > math.hypot(*repulsive_force(weak, RING, threshold))
        > 0.0
    )


@given(st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-math.pi, math.pi))
def test_points_remembered_lie_on_the_surface(roll, pitch, yaw):
    world = World((Box((1.2, 0.3, -1.0), (0.8, 2.0, 2.0)), Box((-1.0, 0.0, -1.0), (0.3, 0.3, 2.0))))
    x, attitude = np.array([0.0, 0.0, -1.2]), np.array([roll, pitch, yaw])
    memory = insert_beam_hits(ObstacleMap.make_empty_map(), RING, 0.0, x, attitude, beams(x, attitude, world))
    if memory.point_count:
        assert np.abs(compute_obstacle_distances(world, memory.points[: memory.point_count, :3])[0]).max() < 1e-9


def test_the_floor_is_no_obstacle():
    x, attitude = np.array([0.0, 0.0, -0.2]), np.array([0.0, -0.3, 0.0])
    seen = beams(x, attitude, World())
    assert seen.min() < 1.5
    assert insert_beam_hits(ObstacleMap.make_empty_map(), RING, 0.0, x, attitude, seen).point_count == 0


def test_points_are_kept_5_cm_apart_and_known_ones_stay():
    world = World((Box((1.5, 0.0, -1.0), (1.0, 4.0, 2.0)),))
    memory = ObstacleMap.make_empty_map()
    x = np.array([0.0, 0.0, -1.0])
    first = None
    for yaw in np.linspace(-0.5, 0.5, 300):
        attitude = np.array([0.0, 0.0, yaw])
        memory = insert_beam_hits(memory, RING, 0.0, x, attitude, beams(x, attitude, world))
        first = memory.points[0, :3].copy() if first is None and memory.point_count else first
    p = memory.points[: memory.point_count, :3]
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + 10 * np.eye(len(p))
    assert gaps.min() >= 0.05
    assert gaps.min(axis=1).max() < 0.11
    np.testing.assert_array_equal(memory.points[0, :3], first)


def test_what_has_gone_is_forgotten():
    x = np.array([0.0, 0.0, -1.0])
    someone = World((Box((0.8, 0.0, -1.0), (0.4, 0.4, 2.0)),))
    memory = ObstacleMap.make_empty_map()
    for yaw in np.linspace(-0.4, 0.4, 200):
        attitude = np.array([0.0, 0.0, yaw])
        memory = insert_beam_hits(memory, RING, 0.0, x, attitude, beams(x, attitude, someone))
    seen = memory.point_count
    assert seen > 3
    nowhere = begin_path_check(x, x)
    assert check_map_part(memory, nowhere, 25.0, 0.39)[0].point_count == seen
    # One face is hit again: what is near those hits is confirmed, the rest is not.
    memory = insert_beam_hits(memory, RING, 25.0, x, attitude, beams(x, attitude, someone))
    assert 0 < check_map_part(memory, nowhere, 35.0, 0.39)[0].point_count < seen
    assert check_map_part(memory, nowhere, 60.0, 0.39)[0].point_count == 0


def test_a_beam_that_grazes_a_thin_post_does_not_make_it_forgotten():
    x = np.array([0.0, 0.0, -1.0])
    post = World((), (Cylinder((0.8, 0.0), 0.02, 2.0),))
    memory = ObstacleMap.make_empty_map()
    for k, yaw in enumerate(0.4 * np.sin(np.linspace(0.0, 60.0, 2000))):
        attitude = np.array([0.0, 0.0, yaw])
        before, memory = (
            memory.point_count,
            insert_beam_hits(memory, RING, 0.02 * k, x, attitude, beams(x, attitude, post)),
        )
        assert memory.point_count >= before
    assert memory.point_count == 1


def test_the_memory_does_not_overflow_and_is_not_changed_in_place():
    memory = ObstacleMap.make_empty_map()
    rng = np.random.default_rng(1)
    for k in range(25):
        before = memory.points.copy()
        x = np.array([*rng.uniform(-20, 20, 2), -1.0])
        later = insert_beam_hits(memory, RING, float(k), x, LEVEL, rng.uniform(0.3, 1.4, 8))
        np.testing.assert_array_equal(memory.points, before)
        memory = later
    assert memory.point_count == MAP_CAPACITY
    assert memory.points.shape == (MAP_CAPACITY, 4)


def test_other_rings():
    four = make_beam_ring(4, 0.0, 2.0)
    assert four.spacing == pytest.approx(math.pi / 2)
    np.testing.assert_allclose(repulsive_force([0.5, 2.0, 2.0, 2.0], four, 1.0), (-1.0, 0.0), atol=1e-12)
