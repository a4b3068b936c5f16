"""The world's geometry: closed forms, symmetries, and rays against distances."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.world import (
    Box,
    Cylinder,
    Room,
    World,
    cast_ranges,
    compute_obstacle_distances,
    find_nearest_obstacle,
    make_wall,
)

CRATE = Box((2.0, 0.0, -0.5), (1.0, 2.0, 1.0), name="crate")
POST = Cylinder((0.0, 3.0), 0.5, 2.0, name="post")
ROOM = Room((-5.0, 5.0), (-4.0, 4.0), 3.0)
number = st.floats(-4.0, 4.0)
angle = st.floats(-math.pi, math.pi)


def unit(azimuth, elevation=0.0):
    c = math.cos(elevation)
    return np.array([c * math.cos(azimuth), c * math.sin(azimuth), -math.sin(elevation)])


def furnished(dn=0.0, de=0.0, turn=0.0):
    """The same furniture moved and turned about the vertical through the origin."""

    def move(n, e):
        return (
            math.cos(turn) * n - math.sin(turn) * e + dn,
            math.sin(turn) * n + math.cos(turn) * e + de,
        )

    boxes = tuple(
        Box((*move(b.centre[0], b.centre[1]), b.centre[2]), b.size, b.yaw + turn, b.name)
        for b in (CRATE, Box((-1.0, -2.0, -1.2), (0.4, 0.7, 0.6), 0.7, "shelf"))
    )
    return World(boxes, (Cylinder(move(*POST.centre), POST.radius, POST.height, name="post"),)), move


def test_rays_closed_forms():
    world = World((CRATE,), (POST,), ROOM)
    x = np.array([0.0, 0.0, -0.8])
    got = cast_ranges(world, x, [unit(0.0), unit(math.pi / 2), unit(math.pi), unit(-math.pi / 2)])
    np.testing.assert_allclose(got, [1.5, 2.5, 5.0, 4.0], rtol=1e-14)
    up_down = cast_ranges(world, x, [(0, 0, -1.0), (0, 0, 1.0)])
    np.testing.assert_allclose(up_down, [2.2, 0.8], rtol=1e-14)
    # Over the crate's top and down on it.
    assert cast_ranges(world, [2.0, 0.0, -1.6], [(0, 0, 1.0)])[0] == pytest.approx(0.6)
    # A beam 30 degrees off meets the crate's face, 1.5 m ahead, at 1.5 / cos 30.
    assert cast_ranges(world, x, [unit(math.pi / 6)])[0] == pytest.approx(1.5 / math.cos(math.pi / 6))


def test_max_range_and_empty_world():
    assert cast_ranges(World(), [0, 0, -1.0], [unit(0.3)])[0] == math.inf
    assert cast_ranges(World(), [0, 0, -1.0], [unit(0.3)], 1.5)[0] == 1.5
    assert find_nearest_obstacle(World(), [0, 0, -1.0]) == (math.inf, "")
    assert cast_ranges(World(has_floor=False), [0, 0, -1.0], [(0, 0, 1.0)])[0] == math.inf
    assert World().is_empty
    assert not World(room=ROOM).is_empty


def test_distance_closed_forms():
    world = World((CRATE,), (POST,), ROOM)
    assert find_nearest_obstacle(world, [0.0, 0.0, -0.8]) == (pytest.approx(1.5), "crate")
    assert find_nearest_obstacle(world, [2.0, 0.0, -0.9]) == (pytest.approx(-0.1), "crate")
    assert find_nearest_obstacle(world, [0.0, 2.0, -1.0]) == (pytest.approx(0.5), "post")
    assert find_nearest_obstacle(world, [0.0, 3.1, -1.0]) == (pytest.approx(-0.4), "post")
    assert find_nearest_obstacle(world, [-4.6, 0.0, -1.0]) == (pytest.approx(0.4), "south wall")
    assert find_nearest_obstacle(world, [4.6, 0.0, -2.0]) == (pytest.approx(0.4), "north wall")
    assert find_nearest_obstacle(world, [-2.0, -3.7, -1.0]) == (pytest.approx(0.3), "west wall")
    assert find_nearest_obstacle(world, [-2.0, 3.7, -1.0]) == (pytest.approx(0.3), "east wall")
    assert find_nearest_obstacle(world, [-2.0, 0.0, -2.8]) == (pytest.approx(0.2), "ceiling")
    # Off a corner of the crate: 0.3, 0.4 away in plan.
    assert find_nearest_obstacle(world, [1.2, 1.4, -0.5])[0] == pytest.approx(0.5)


def test_inside_the_distance_is_negative():
    world = World((CRATE,), (POST,), ROOM)
    for place, name in (([2.0, 0.0, -0.5], "crate"), ([6.0, 0.0, -0.5], "north wall")):
        least, nearest = find_nearest_obstacle(world, place)
        assert least < 0.0
        assert nearest == name
    assert find_nearest_obstacle(world, [0.0, 0.0, -0.5])[0] > 0.0


@given(number, number, st.floats(-3.0, -0.05), angle, st.floats(-1.4, 1.4), angle, number, number)
def test_moving_and_turning_everything_changes_nothing(n, e, d, azimuth, elevation, turn, dn, de):
    world, _ = furnished()
    turned, move = furnished(dn, de, turn)
    a = np.array([n, e, d])
    b = np.array([*move(n, e), d])
    # Beams that graze an edge may fall on either side of it: compare where a hair's breadth makes no difference.
    beams = [unit(azimuth + h, elevation) for h in (-1e-7, 0.0, 1e-7)]
    first = cast_ranges(world, a, beams, 20.0)
    if np.ptp(first) < 1e-3:
        got = cast_ranges(turned, b, [unit(azimuth + turn, elevation)], 20.0)[0]
        assert got == pytest.approx(first[1], abs=1e-3)
    assert find_nearest_obstacle(turned, b)[0] == pytest.approx(find_nearest_obstacle(world, a)[0], abs=1e-9)


@given(number, number, st.floats(-2.9, -0.05), angle, st.floats(-1.4, 1.4))
def test_no_beam_ends_nearer_than_the_nearest_surface_and_it_ends_on_one(n, e, d, azimuth, elevation):
    furniture, _ = furnished()
    world = World(furniture.boxes, furniture.cylinders, ROOM, has_floor=False)
    x, u = np.array([n, e, d]), unit(azimuth, elevation)
    least, _name = find_nearest_obstacle(world, x)
    reach = cast_ranges(world, x, [u], 50.0)[0]
    if least < 0.0:
        assert reach == 0.0
        return
    assert reach >= least - 1e-9
    if reach < 50.0:
        assert abs(find_nearest_obstacle(world, x + reach * u)[0]) < 1e-9
        along = x + np.linspace(0.0, 1.0, 50)[1:-1, None] * reach * u
        assert compute_obstacle_distances(world, along)[0].min() > -1e-9


@given(number, number, st.floats(-3.0, 0.0), angle, st.floats(0.0, 0.5))
def test_distance_is_one_lipschitz(n, e, d, azimuth, step):
    world, _ = furnished()
    a = np.array([n, e, d])
    assert (
        abs(find_nearest_obstacle(world, a)[0] - find_nearest_obstacle(world, a + step * unit(azimuth))[0])
        <= step + 1e-12
    )


@settings(max_examples=50)
@given(st.lists(st.tuples(number, number, st.floats(-3.0, 0.0)), min_size=1, max_size=20))
def test_batch_equals_scalar(points):
    world = World((CRATE,), (POST,), ROOM)
    batch, which = compute_obstacle_distances(world, np.array(points))
    for p, d, w in zip(points, batch, which, strict=True):
        assert find_nearest_obstacle(world, p) == (d, world.obstacle_names[w])


def test_wall_is_a_turned_box():
    w = make_wall((0.0, 0.0), (3.0, 4.0), height=2.0, thickness=0.2, name="partition")
    world = World((w,))
    normal = np.array([-0.8, 0.6, 0.0])
    foot = np.array([1.5, 2.0, -1.0])
    assert find_nearest_obstacle(world, foot + 0.7 * normal) == (pytest.approx(0.6), "partition")
    assert cast_ranges(world, foot + 0.7 * normal, [-normal])[0] == pytest.approx(0.6)
    assert find_nearest_obstacle(world, foot) == (pytest.approx(-0.1), "partition")


def test_hanging_obstacles_leave_room_below():
    world = World((), (Cylinder((0, 0), 0.5, 1.0, foot=1.5, name="lamp"),))
    assert find_nearest_obstacle(world, [0.0, 0.0, -1.0]) == (pytest.approx(0.5), "lamp")
    assert cast_ranges(world, [0, 0, -1.0], [(0, 0, -1.0), (1.0, 0, 0)]).tolist() == [
        pytest.approx(0.5),
        math.inf,
    ]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Box((0, 0, math.nan), (1, 1, 1)),
        lambda: Box((0, 0, 0), (1, -1, 1)),
        lambda: Cylinder((0, 0), 0.0, 1.0),
        lambda: Room((1.0, -1.0), (0.0, 1.0)),
        lambda: Room((-1.0, 1.0), (0.0, 1.0), -2.0),
        lambda: make_wall((0, 0), (0, 0), height=1.0),
    ],
)
def test_impossible_obstacles_are_refused(make):
    with pytest.raises(InputError):
        make()
