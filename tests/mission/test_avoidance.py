"""Going around obstacles: it keeps away, and it arrives or says why not. Flown with a point mass that lags 0.3 s."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.mission import load_mission, parse_mission
from mufly.mission.avoidance import (
    PATH_LOOK_AHEAD_M,
    ObstacleMap,
    begin_path_check,
    check_map_part,
    limit_approach_velocity,
    make_beam_ring,
)
from mufly.mission.detour import begin_detour, follow_contour
from mufly.world import Cylinder, World

# Sweeps over 1100 scenes keep 0.38 m; what is asked for is 0.3 m.
KEPT_M = 0.36
RING = make_beam_ring(8, np.pi / 8, 1.5)


def check_path(memory, position, goal, clearance, ahead=PATH_LOOK_AHEAD_M):
    return check_map_part(memory, begin_path_check(position, goal, ahead), -np.inf, clearance)[1]


def wall(a, b, name="wall"):
    return {"start_m": a, "end_m": b, "height_m": 2.5, "name": name}


def to(*goal, **more):
    return parse_mission({"waypoint": [{"position_m": list(goal)}], **more})


def arrived(flight, goal):
    x = np.array(flight.position)
    landed = flight.states.index("landing")
    return flight.state.outcome == "succeeded" and np.linalg.norm(x[landed] - goal) < 0.05


def test_box_on_the_leg(rig):
    flight = rig.fly(load_mission("box-on-leg"))
    assert flight.state.outcome == "succeeded"
    assert flight.visited.count("obstacle") == 2
    assert flight.clearance > 0.45


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(1000, 10**6), st.booleans())
def test_any_scene(rig, seed, push):
    _, tables = rig.scene(seed)
    try:
        mission = parse_mission(tables)
    except InputError:
        return
    flight = rig.fly(mission, disturb=rig.gusty() if push else None)
    assert flight.clearance > KEPT_M
    assert arrived(flight, mission.waypoint[0].position_m) or "blocked by an obstacle at N" in flight.state.reason


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.floats(-0.9, 0.9), st.floats(0.2, 1.0), st.floats(0.2, 1.0), st.floats(-90, 90), st.floats(-180, 180))
def test_a_box_anywhere_is_passed(rig, off, length, width, yaw, heading):
    box = {"centre_m": [2.0, off, -1.0], "size_m": [length, width, 2.0], "yaw_deg": yaw}
    mission = parse_mission({"waypoint": [{"position_m": [4.0, 0.0, -1.0], "heading_deg": heading}], "box": [box]})
    flight = rig.fly(mission)
    assert flight.clearance > KEPT_M
    assert arrived(flight, (4.0, 0.0, -1.0))


def test_turning_the_scene_turns_the_flight(rig):
    east = parse_mission(
        {
            "waypoint": [{"position_m": [0, 4, -1]}],
            "start_heading_deg": 90,
            "box": [{"centre_m": [-0.1, 2.0, -1], "size_m": [0.6, 0.8, 2.0], "yaw_deg": 110}],
        }
    )
    north = parse_mission(
        {
            "waypoint": [{"position_m": [4, 0, -1]}],
            "box": [{"centre_m": [2.0, 0.1, -1], "size_m": [0.6, 0.8, 2.0], "yaw_deg": 20}],
        }
    )
    a, b = (np.array(rig.fly(m).position) for m in (east, north))
    assert len(a) == len(b)
    np.testing.assert_allclose(a[:, 1], b[:, 0], atol=1e-3)
    np.testing.assert_allclose(a[:, 0], -b[:, 1], atol=1e-3)


def test_out_of_a_pocket(rig):
    walls = [wall([3, -1.2], [3, 1.2]), wall([1.5, -1.2], [3, -1.2]), wall([1.5, 1.2], [3, 1.2])]
    flight = rig.fly(to(5, 0, -1, wall=walls))
    assert arrived(flight, (5, 0, -1))
    assert flight.clearance > KEPT_M


def test_through_a_door(rig):
    walls = [wall([2.5, -4], [2.5, 0.4]), wall([2.5, 1.6], [2.5, 4])]
    flight = rig.fly(to(5, 0, -1, wall=walls, room={"north_m": [-2, 7], "east_m": [-4, 4]}))
    assert arrived(flight, (5, 0, -1))
    assert flight.clearance > KEPT_M


def test_not_through_a_gap_that_is_too_narrow(rig):
    walls = [wall([2.5, -1.4], [2.5, -0.35]), wall([2.5, 0.35], [2.5, 1.4])]
    flight = rig.fly(to(5, 0, -1, wall=walls))
    assert arrived(flight, (5, 0, -1))
    assert flight.clearance > KEPT_M
    x = np.array(flight.position)
    assert np.abs(x[np.abs(x[:, 0] - 2.5) < 0.05, 1]).min() > 1.4


def test_a_goal_behind_closed_walls_is_given_up_and_it_lands(rig):
    walls = [wall([3, -1], [3, 1]), wall([5, -1], [5, 1]), wall([3, -1], [5, -1]), wall([3, 1], [5, 1])]
    flight = rig.fly(to(4, 0, -1, wall=walls, avoidance={"give_up_s": 60.0}))
    assert flight.state.outcome == "failed"
    assert "blocked by an obstacle at N" in flight.state.reason
    assert "no way around it in 60 s" in flight.state.reason
    assert flight.clearance > KEPT_M
    assert flight.visited[-4:] == ["hover", "landing", "landing", "init"]
    assert flight.position[-1][2] == pytest.approx(rig.STANDING)


def test_a_post_between_two_beams_is_seen_by_scanning(rig):
    post = [{"centre_m": [2.0, 0.0], "radius_m": 0.03, "height_m": 2.0}]
    flight = rig.fly(to(4, 0, -1, cylinder=post))
    assert arrived(flight, (4, 0, -1))
    assert flight.clearance > KEPT_M


def test_a_goal_as_near_to_a_wall_as_is_allowed(rig):
    box = [{"centre_m": [2, 0, -1], "size_m": [0.6, 0.6, 2]}]
    flight = rig.fly(to(4, 0, -1, box=box, wall=[wall([4.541, -3], [4.541, 3])]))
    assert arrived(flight, (4, 0, -1))
    assert flight.clearance > KEPT_M


def test_without_avoidance_it_flies_into_the_box(rig):
    box = [{"centre_m": [2, 0, -1], "size_m": [0.6, 0.6, 2]}]
    flight = rig.fly(to(4, 0, -1, box=box, avoidance={"enabled": False}))
    assert "obstacle" not in flight.visited
    assert flight.clearance < 0.0


def test_an_obstacle_that_comes_near_a_hover_pushes_it_away_and_it_comes_back(rig):
    from mufly.world import Box, World

    mission = parse_mission({"waypoint": [{"position_m": [1.0, 0.0, -1.0], "wait_s": 85.0}]})
    someone = World((Box((1.5, 0.0, -1.0), (0.4, 0.4, 2.0)),))

    class Visit:
        """Somebody stands 0.3 m away between 30 s and 50 s."""

        now = World()

    visit = Visit()

    def push(t):
        visit.now = someone if 30.0 < t < 50.0 else World()
        return np.zeros(3)

    flight = rig.fly(mission, disturb=push, world=lambda: visit.now, limit_s=130.0)
    t, x, _ = flight.arrays()
    states = np.array(flight.states)
    assert (states[(t > 30.1) & (t < 31.0)] == "obstacle").any()
    assert np.linalg.norm(x[np.searchsorted(t, 49.0)][:2] - [1.0, 0.0]) > 0.15
    assert states[np.searchsorted(t, 88.0)] == "hover"
    np.testing.assert_allclose(x[np.searchsorted(t, 88.0)], [1.0, 0.0, -1.0], atol=0.02)
    assert flight.state.outcome == "succeeded"


def memory_of(*points):
    table = ObstacleMap.make_empty_map().points
    table[: len(points), :3] = points
    return ObstacleMap(table, len(points))


def test_it_waits_beside_a_goal_that_is_taken_and_goes_there_once_it_is_free(rig):
    """Somebody whom the mission does not know of stands there for 40 s."""
    place, goal = (2.4, -1.8), (2.4, -1.8, -1.0)
    somebody, nobody = World((), (Cylinder(place, 0.3, 2.0, name="somebody"),)), World()
    now = [0.0]

    def clock(t):
        now[0] = t
        return np.zeros(3)

    mission = to(*goal, avoidance={"scan": True})
    flight = rig.fly(mission, world=lambda: somebody if now[0] < 40.0 else nobody, disturb=clock, limit_s=130.0)
    t, x, v = flight.arrays()
    assert flight.clearance > KEPT_M
    waits = (t > 30.0) & (t < 40.0)
    away = np.linalg.norm(x[waits, :2] - place, axis=1) - 0.3
    assert 0.39 < away.min() <= away.max() < 0.8
    assert np.linalg.norm(v[waits], axis=1).max() < 0.02
    assert arrived(flight, goal)


def test_the_reference_waits_for_a_helicopter_that_is_held():
    """Around an obstacle it runs no further than 0.3 m ahead, and comes to rest there."""
    points = [(1.0, 0.05 * k, -1.0) for k in range(-8, 9)]
    memory, here, goal = memory_of(*points), (0.45, 0.0, -1.0), (3.0, 0.0, -1.0)
    detour = begin_detour(here, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), goal, check_path(memory, here, goal, 0.39), None)
    ahead = []
    for _ in range(400):
        sight = check_path(memory, detour.position, goal, 0.39, np.inf)
        detour = follow_contour(detour, sight, RING, here, 0.0, [1.5] * 8, goal, clearance=0.39, speed=0.3, dt=0.02)
        ahead.append(np.hypot(detour.position[0] - here[0], detour.position[1] - here[1]))
    assert 0.2 < ahead[-1] <= max(ahead) < 0.32
    assert np.hypot(*detour.velocity[:2]) < 0.01
    assert detour.lap_count == 0  # it is at the contour, and has gone round nothing


@pytest.mark.parametrize(("away", "kept"), [(1.4, True), (1.6, False)])
def test_an_obstacle_met_again_nearby_is_passed_on_the_same_side(away, kept):
    here, still, goal = (0.0, 0.0, -1.0), (0.0, 0.0, 0.0), (3.0, 0.0, -1.0)
    sight = check_path(memory_of((0.6, -0.2, -1.0)), here, goal, 0.39)
    first = begin_detour(here, still, still, goal, sight, None)
    assert (first.passing_side, first.obstacle_count) == (
        1.0,
        1,
    )  # what blocks it is on the left: it flies to the right
    before = replace(
        first, passing_side=-1.0, obstacle_count=2, side_change_deviation_m=6.0, position=(-away, 0.0, -1.0)
    )
    again = begin_detour(here, still, still, goal, sight, before)
    assert (again.passing_side, again.obstacle_count, again.side_change_deviation_m) == (-1.0 if kept else 1.0, 3, 6.0)


@pytest.mark.parametrize(("across", "changes"), [(2.95, False), (3.05, True), (-2.95, False), (-3.05, True)])
def test_the_other_side_is_tried_3_m_off_the_straight_way(across, changes):
    """Beside the middle of the way from (1, 2) to (4, 6), whose direction is (0.6, 0.8)."""
    still, goal = (0.0, 0.0, 0.0), (4.0, 6.0, -1.0)
    here = (2.5 - 0.8 * across, 4.0 + 0.6 * across, -1.0)
    memory = memory_of((here[0] + 0.5, here[1], -1.0))
    detour = replace(
        begin_detour(here, still, still, goal, check_path(memory, here, goal, 0.39), None),
        passing_side=1.0,
        hit_point=(1.0, 2.0),
        hit_goal_distance=5.0,
    )
    sight = check_path(memory, here, goal, 0.39, np.inf)
    moved = follow_contour(detour, sight, RING, here, 0.0, [1.5] * 8, goal, clearance=0.39, speed=0.3, dt=0.02)
    assert (moved.passing_side, moved.side_change_deviation_m) == ((-1.0, 6.0) if changes else (1.0, 3.0))


def test_far_from_what_blocks_its_way_it_makes_straight_for_the_goal():
    """On its third detour of a leg: as soon as that has brought it nearer, it leaves the detour."""
    here, still, goal = (5.0, 7.0, -1.0), (0.0, 0.0, 0.0), (8.0, 3.0, -1.0)
    memory = memory_of(*((6.8 + 0.04 * k, 4.6 + 0.03 * k, -1.0) for k in range(-8, 9)))
    detour = replace(
        begin_detour(here, still, still, goal, check_path(memory, here, goal, 0.39), None), obstacle_count=3
    )
    for _ in range(150):
        sight = check_path(memory, detour.position, goal, 0.39, np.inf)
        detour = follow_contour(
            detour, sight, RING, detour.position, 0.0, [1.5] * 8, goal, clearance=0.39, speed=0.3, dt=0.02
        )
    moved = np.subtract(detour.position, here)[:2]
    along, across = (float(moved @ u) for u in ((0.6, -0.8), (0.8, 0.6)))
    assert 0.1 < along < 0.5
    assert abs(across) < 0.01
    assert detour.is_leaving_contour
    assert detour.is_finished


def test_what_a_point_means_for_a_way():
    sight = check_path(memory_of((1.5, 0.3, -1.0)), (0.0, 0.0, -1.0), (4.5, 0.0, -1.0), 0.39, 10.0)
    far = np.hypot(0.5, 0.3)
    met = pytest.approx((far, -0.5 / far, -0.3 / far))
    assert sight.find_nearest_blocking_distance((1.0, 0.0)) == sight.find_nearest_point_distance((1.0, 0.0)) == met
    assert sight.path_clearance_sq == pytest.approx(0.3**2)
    assert sight.mean_blocking_offset == pytest.approx(0.3)
    assert sight.goal_clearance_sq == pytest.approx(3.0**2 + 0.3**2)
    # Beyond the stretch that is looked at, behind, and at another height.
    assert check_path(
        memory_of((2.0, 0.3, -1.0)), (0, 0, -1), (5, 0, -1), 0.39, 1.0
    ).path_clearance_sq == pytest.approx(1.0 + 0.3**2)
    assert check_path(memory_of((-0.5, 0.0, -1.0)), (0, 0, -1), (5, 0, -1), 0.39).path_clearance_sq == pytest.approx(
        0.25
    )
    assert (
        check_path(memory_of((-1.0, 0.0, -1.0)), (0, 0, -1), (5, 0, -1), 0.39).path_clearance_sq == np.inf
    )  # too far to matter
    assert check_path(memory_of((2.0, 0.0, -2.0)), (0, 0, -1), (5, 0, -1), 0.39).path_clearance_sq == np.inf
    # A way of no length is a point.
    assert check_path(memory_of((2.0, 0.0, -1.0)), (0, 0, -1), (0, 0, -1), 0.39).path_clearance_sq == pytest.approx(4.0)


speed = st.floats(-1.0, 1.0)
spot = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.just(-1.0))


@given(spot, speed, speed)
def test_holding_off_one_point(p, vn, ve):
    d = float(np.hypot(p[0], p[1]))
    if d < 0.05:
        return
    n = -np.array(p[:2]) / d
    un, ue = limit_approach_velocity(
        check_path(memory_of(p), (0.0, 0.0, -1.0), p, 0.4), (0.0, 0.0, -1.0), (vn, ve), 0.4
    )
    # It comes near no faster than 0.8 /s times the distance left, and nothing is changed across.
    assert -(un * n[0] + ue * n[1]) <= 0.8 * (d - 0.4) + 1e-5
    assert un * n[1] - ue * n[0] == pytest.approx(vn * n[1] - ve * n[0], abs=1e-9)
    if -(vn * n[0] + ve * n[1]) <= 0.8 * (d - 0.4):
        assert (un, ue) == (vn, ve)


@pytest.mark.parametrize(("side", "turn"), [(1.0, 0.9), (-1.0, -2.2)])
def test_a_wall_is_followed_to_3_m_off_the_way_and_then_round_its_other_end(rig, side, turn):
    """It starts towards the long end, since what blocks the way there seems to be less."""
    c, s = np.cos(turn), np.sin(turn)

    def place(along, across):
        return [c * along - s * side * across, s * along + c * side * across]

    long = wall(place(2.5, -1.0), place(2.5, 9.0))
    post = {"centre_m": place(1.9, -0.6), "radius_m": 0.1, "height_m": 2.5}
    goal = (*place(5.0, 0.0), -1.0)
    flight = rig.fly(to(*goal, wall=[long], cylinder=[post]), limit_s=150.0)
    assert arrived(flight, goal)
    assert flight.clearance > KEPT_M
    across = side * (np.array(flight.position)[:, :2] @ [-s, c])
    assert across.max() == pytest.approx(3.0, abs=0.15)
    assert across.min() > -2.0
    # Along the wall it keeps the distance that a contour is followed at, 15 cm more than the clearance, and a little
    # more: the nearest of the points seen lies behind it.
    beside = 2.5 - np.array(flight.position)[:, :2] @ [c, s]
    clear = to(*goal).avoidance.clearance_m
    assert 0.15 < np.median(beside[(across > 2.2) & (across < 2.8)]) - clear < 0.23
