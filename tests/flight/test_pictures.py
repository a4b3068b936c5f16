"""The pictures: what is on them, at which scale, and that they come out the same every time."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from mufly.flight import draw_flight_pictures
from mufly.flight.record.flight_pictures import STATE_COLOURS, draw_history, draw_position, draw_track
from mufly.world import Box, Cylinder, World

WORLD = World((Box((-1.5, 0.9, -0.6), (0.5, 0.6, 1.2), 0.4),), (Cylinder((-1.0, 2.2), 0.25, 1.4, 0.1),))


@pytest.fixture(scope="module")
def data(flight):
    return flight.dataset()


def test_pictures_are_not_blank_and_the_same_every_time(tmp_path, data, flight):
    how = {"waypoints": flight.waypoints, "world": WORLD}
    paths, again = (draw_flight_pictures(data, tmp_path / place, **how) for place in ("new", "again"))
    assert [path.name for path in paths] == ["track.png", "history.png", "position.png"]
    assert [p.read_bytes() for p in paths] == [p.read_bytes() for p in again]
    for path in paths:
        image = imread(path)
        assert min(image.shape[:2]) > 700
        assert 0.02 < np.mean(image[..., :3].min(axis=-1) < 0.9) < 0.9


def test_the_track_has_one_scale_on_all_axes_and_stands_on_the_floor(data, flight):
    ax = draw_track(data, waypoints=flight.waypoints, world=WORLD).axes[0]
    spans = np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim()), np.ptp(ax.get_zlim())])
    assert ax._box_aspect / ax._box_aspect[0] == pytest.approx(spans / spans[0])
    assert ax.get_zlim()[0] == 0.0
    assert ax.get_zlabel() == "Height (m)"
    for mark in flight.waypoints:
        assert ax.get_xlim()[0] < mark[1] < ax.get_xlim()[1]
        assert ax.get_ylim()[0] < mark[0] < ax.get_ylim()[1]
        assert -mark[2] < ax.get_zlim()[1]


def test_the_waypoints_carry_their_numbers(data, flight):
    ax = draw_track(data, waypoints=flight.waypoints).axes[0]
    places = {text.get_text(): text.get_position_3d() for text in ax.texts}
    for number, mark in enumerate(flight.waypoints, 1):
        assert places[str(number)] == pytest.approx((mark[1], mark[0], -mark[2]))


def test_obstacles_are_drawn_where_they_stand():
    from mufly.flight.record.flight_pictures import _obstacle_faces

    box, post = (np.concatenate(faces) for faces in _obstacle_faces(WORLD))
    half = 0.5 * np.hypot(0.5, 0.6)
    assert np.hypot(*(box[:, :2] - (0.9, -1.5)).T) == pytest.approx(half)
    assert (box[:, 2].min(), box[:, 2].max()) == pytest.approx((0.0, 1.2))
    assert np.hypot(*(post[:, :2] - (2.2, -1.0)).T) == pytest.approx(0.25)
    assert (post[:, 2].min(), post[:, 2].max()) == pytest.approx((0.1, 1.5))
    # A box turned by yaw from north towards east has its long edge there.
    turned = _obstacle_faces(World((Box((0, 0, -1), (4, 1, 1), np.pi / 2),)))[0]
    assert np.ptp(np.concatenate(turned), axis=0) == pytest.approx((4.0, 1.0, 1.0))


def test_obstacles_reach_the_figure(data):
    ax = draw_track(data, world=WORLD).axes[0]
    assert sum(isinstance(item, Poly3DCollection) for item in ax.collections) == 2


def test_every_panel_names_its_unit_and_shares_the_time(data):
    figure = draw_history(data)
    titles = [ax.get_title(loc) for ax in figure.axes for loc in ("left", "center") if ax.get_title(loc)]
    assert len(titles) == 10
    assert all(title.endswith(")") for title in titles)
    assert {ax.get_xlabel() for ax in figure.axes} == {"", "Time (s)"}
    assert len({ax.get_xlim() for ax in figure.axes}) == 1


def test_the_bands_follow_the_states(data, flight):
    figure = draw_position(data)
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert legend == [name for name in STATE_COLOURS if name in flight.states]
    (bands,) = figure.axes[0].collections
    edges = [path.vertices[0, 0] for path in bands.get_paths()]
    assert edges == pytest.approx([0.0, *(e.time_s for e in flight.events[1:])], abs=0.021)
    assert len({tuple(colour) for colour in bands.get_facecolor()}) == len(legend)


def test_height_is_drawn_upwards(data):
    line = next(line for line in draw_position(data).axes[2].lines if line.get_label() == "true")
    np.testing.assert_array_equal(line.get_ydata(), -data.truth_position.values[:, 2])


def test_a_flight_without_references_or_movement_can_be_drawn(tmp_path, data):
    still = data.isel(time=slice(0, 40)).copy(deep=True)
    for name in ("reference_position", "reference_attitude", "measured_position", "truth_rotor_speed"):
        still[name][:] = np.nan
    assert len(draw_flight_pictures(still, tmp_path)) == 3


def test_one_row_can_be_drawn(tmp_path, data):
    assert len(draw_flight_pictures(data.isel(time=[0]), tmp_path)) == 3


def test_an_unknown_state_is_drawn_too(tmp_path, data):
    odd = data.copy()
    odd["mission_state"] = odd.mission_state.copy(data=np.full(odd.sizes["time"], "acrobatics"))
    figure = draw_history(odd)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["acrobatics"]


def test_the_colours_differ_in_lightness_or_hue():
    colours = np.array([to_rgb(colour) for colour in STATE_COLOURS.values()])
    apart = np.linalg.norm(colours[:, None] - colours[None], axis=-1) + 9 * np.eye(len(colours))
    assert apart.min() > 0.25
