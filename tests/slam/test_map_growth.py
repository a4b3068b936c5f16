"""Growth of the map: a loop is not closed to one of two places that look the same."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mufly.camera import body_from_camera_rotation, load_camera
from mufly.slam import CameraFrame, FrameEstimate
from mufly.slam.camera_frame import MotionPrior
from mufly.slam.camera_pose import POSE_SIZE, PoseEstimate, ViewPrior
from mufly.slam.image_tools import Undistorter
from mufly.slam.keyframe_map import FloorMap
from mufly.slam.keyframe_matching import FrameContext
from mufly.slam.map_growth import LoopSearch, create_keyframe, make_node
from mufly.slam.place_recognition import are_places_apart, correlate_pictures
from mufly.slam.pose_graph import PLACE_SLICE, GraphEdge, relative_pose

cv2 = pytest.importorskip("cv2")
HIGH, WIDE, FOCAL_PX = 240, 320, 250.0
HERE = 3


def _draw_texture(seed: int, amplitude: float = 200.0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((HIGH + 80, WIDE + 80))
    return np.clip(128.0 + amplitude * cv2.GaussianBlur(noise, (0, 0), 3.0), 0, 255).astype(np.uint8)


def _make_context(picture: np.ndarray) -> FrameContext:
    camera = load_camera("mufly-2.0")
    view = ViewPrior(
        FOCAL_PX, body_from_camera_rotation(camera), 0.0, 0.0, np.zeros(3), np.zeros(3), 1.0, 0.01, 0.0, np.zeros(2)
    )
    return FrameContext(
        CameraFrame(1.0, picture, FrameEstimate(0.0, 0.0, 1.0)), picture, view, np.full(picture.shape, 255, np.uint8),
        MotionPrior(), 0.0, np.zeros(3), (np.ones(3), np.full(3, 1e-10)), Undistorter(camera), 0.3, 0.0, 0.0,
        np.random.default_rng(0),
    )  # fmt: skip


def _make_map(pictures: list[tuple[tuple[float, float], np.ndarray]], sigma: float) -> FloorMap:
    """Return a map of keyframes in a row, level, 1 m high; edges of the deviation ``sigma`` in position."""
    out = FloorMap()
    for k, ((north, east), picture) in enumerate(pictures):
        state = np.array([north, east, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        nothing = np.zeros((POSE_SIZE, POSE_SIZE))
        pose = PoseEstimate(state, np.zeros(8), nothing, nothing, np.zeros(8), 1.0, np.zeros(0), np.zeros((0, 2)))
        context = _make_context(picture)
        keyframe = create_keyframe(context, pose, 0.4)
        assert keyframe is not None
        node, ties = make_node(context, pose), []
        if k:
            information = np.diag([sigma**-2, sigma**-2, 1e4, 1e4, 0.0, 0.0, 0.0, 0.0])
            relation = np.append(relative_pose(out.nodes[k - 1], node), np.zeros(4))
            ties = [GraphEdge(k - 1, k, relation, information)]
        out.add_keyframe(keyframe, node, ties)
    return out


def _crop(texture: np.ndarray, shift: int = 0) -> np.ndarray:
    return np.ascontiguousarray(texture[40 + shift : 40 + shift + HIGH, 40 : 40 + WIDE])


@pytest.mark.parametrize(("alike", "closes"), [(False, True), (True, False)])
def test_no_loop_is_closed_to_one_of_two_places_that_look_the_same(alike: bool, closes: bool) -> None:
    """The place at north 0 is seen again; a copy lies 0.7 m beside it, both within the deviation of the map."""
    first = _draw_texture(1)
    other = first if alike else _draw_texture(2)
    floor_map = _make_map(
        [((0.0, 0.0), _crop(first)), ((0.0, 0.7), _crop(other)), ((3.0, 0.7), _crop(_draw_texture(3))),
         ((3.0, 3.0), _crop(_draw_texture(4)))], 0.3,
    )  # fmt: skip
    last = floor_map.nodes[0, PLACE_SLICE] + [0.05, 0.05, 0.0, 0.0]
    found = LoopSearch().match_next_candidate(floor_map, HERE, _make_context(_crop(first, 12)), last)
    assert (found is not None) == closes
    if found is not None:
        assert found.keyframe_index == 0
        assert math.hypot(*(np.abs(found.pose.state[:2]) - [12 / FOCAL_PX, 0.0])) < 0.01


def test_the_second_peak_of_a_correlation_makes_it_ambiguous() -> None:
    texture = _draw_texture(5)
    clear = correlate_pictures(_crop(texture), _crop(texture, 12), 60.0)
    assert clear is not None
    assert np.allclose(np.abs(clear.shift_px), [0.0, 12.0])
    assert not clear.is_ambiguous
    tile = _draw_texture(6)[:40, :40]
    tiles = np.tile(tile, (8, 10))
    repeated = correlate_pictures(_crop(tiles), _crop(tiles, 12), 60.0)
    assert repeated is not None
    assert repeated.is_ambiguous


def test_places_are_apart_by_their_distance_over_the_height() -> None:
    a, b = np.zeros(4), np.array([0.0, 0.4, 2.0, 1.0])
    assert are_places_apart(a, b, 1.0)
    assert not are_places_apart(a, b, 1.5)
