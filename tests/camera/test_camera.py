"""The camera model, floors and the renderer."""

from __future__ import annotations

import numpy as np
import pytest

from mufly.camera import (
    FLOORS,
    Floor,
    Motion,
    Renderer,
    body_from_camera,
    builtin_cameras,
    floor_of_picture,
    load_camera,
    make_floor,
    project,
    rays,
)
from mufly.dynamics import rotation
from mufly.dynamics.state import quaternion_from_euler
from mufly.errors import InputError
from mufly.world import Box, World

STILL = np.zeros(3)


def _motion(height: float = 1.0, attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Motion:
    turn = rotation(quaternion_from_euler(*attitude))
    return Motion(0.0, np.array([0.1, -0.2, -height]), STILL, turn, STILL)


def _chequered() -> Floor:
    """Fields of 128 mm."""
    n = np.arange(2048) // 128
    a = np.where((n[:, None] + n[None, :]) % 2 == 0, 40, 210)
    levels = [
        a.reshape(2048 >> k, 1 << k, 2048 >> k, 1 << k).mean(axis=(1, 3)).astype(np.uint8) for k in range(5)
    ]
    one = make_floor("plain", size=128)
    return Floor("chequered", tuple(levels), (1e-3, 1e-3), one.detail, one.shade)


@pytest.mark.parametrize("name", ["mufly-2.0", "webcam"])
def test_rays_undo_the_distortion(name: str) -> None:
    camera = load_camera(name)
    pixels = np.stack(np.meshgrid(np.arange(0, 320, 20.0), np.arange(0, 240, 20.0)), axis=-1)
    assert np.abs(project(camera, rays(camera, pixels)) - pixels).max() < 1e-8


def test_a_corner_is_where_the_closed_form_has_it() -> None:
    """To 0.05 pixels, through lens, lever arm, tilt and heading."""
    cv2 = pytest.importorskip("cv2")
    camera = load_camera("mufly-2.0")
    floor = _chequered()
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    off = []
    for attitude in ((0.0, 0.0, 0.0), (0.08, -0.06, 0.7)):
        motion = _motion(0.8, attitude)
        picture = Renderer(camera, floor, perfect=True).render(motion)
        axes = motion.attitude @ body_from_camera(camera)
        here = motion.position + motion.attitude @ camera.mount.place.array()[0]
        k = np.arange(-10, 11) * 0.128
        corners = np.array([[n, e, 0.0] for n in k for e in k])
        seen = (corners - here) @ axes
        seen = seen[seen[:, 2] > 0.3]
        pixels = project(camera, seen[np.hypot(*(seen[:, :2] / seen[:, 2:]).T) < 0.7])
        pixels = pixels[(pixels > 15).all(axis=1) & (pixels < [304, 224]).all(axis=1)]
        begin = np.array(pixels[:, None], np.float32, order="C")
        found = cv2.cornerSubPix(picture, begin, (6, 6), (-1, -1), stop)[:, 0]
        off.append(found - pixels)
    away = np.concatenate(off)
    assert len(away) > 20
    assert np.sqrt((away**2).sum(axis=1).mean()) < 0.05  # most of it is the finder's
    assert np.abs(away.mean(axis=0)).max() < 0.02


def test_the_first_row_is_seen_before_the_last() -> None:
    """A camera that moves to the north by v sees the floor's edge lean by v T_roll / h f over all rows."""
    camera = load_camera("mufly-2.0")
    lens = camera.lens.model_copy(update=dict.fromkeys(("k1", "k2", "p1", "p2"), camera.lens.k3))
    camera = camera.model_copy(update={"lens": lens})
    a = np.where(np.arange(2048)[None, :] < 1024, 30, 220) * np.ones((2048, 1))
    one = make_floor("plain", size=128)
    floor = Floor("halves", (a.astype(np.uint8),), (1e-3, 1e-3), one.detail, one.shade)
    quality = camera.quality.model_copy(
        update={"noise": lens.k1, "blur": lens.k1, "shaking": lens.k1, "vignette": lens.k1, "jpeg": 0}
    )
    camera = camera.model_copy(update={"quality": quality})
    motion = Motion(0.0, np.array([0.0, 1.024, -1.0]), np.array([0.0, 0.5, 0.0]), np.eye(3), STILL)
    picture = Renderer(camera, floor, own_shadow=0.0).render(motion).astype(float)
    middle = 0.5 * (picture.min() + picture.max())
    edge = [np.interp(middle, row[100:220], np.arange(100, 220)) for row in picture]
    lean = np.polyfit(np.arange(240), edge, 1)[0] * 239
    height = 1.0 - camera.mount.place.array()[0][2]
    assert lean == pytest.approx(-0.5 * float(camera.shutter.readout) / height * 250, rel=0.05)


def test_boxes_stand_on_the_floor_and_are_nearer() -> None:
    camera, floor = load_camera("webcam"), make_floor("plain", size=128)
    box = Box((0.1, -0.2, -0.1), (0.2, 0.3, 0.2))
    without = Renderer(camera, floor, perfect=True).render(_motion())
    with_box = Renderer(camera, _chequered(), World(boxes=(box,)), perfect=True).render(_motion())
    bare = Renderer(camera, _chequered(), perfect=True).render(_motion())
    changed = np.argwhere(with_box != bare)
    assert without.std() < 1.0
    # The top, 0.8 m away less the lever arm, is seen larger than its foot on the floor would be.
    wide = np.ptp(changed[:, 1])
    assert wide == pytest.approx(0.3 / (0.8 - 0.045) * 250, rel=0.08)


def test_same_seed_same_picture_and_floors_differ() -> None:
    camera = load_camera("mufly-2.0")
    pictures = [
        Renderer(camera, make_floor(kind, 3, size=512), seed=5).render(_motion())
        for kind in (*FLOORS, "rich")
    ]
    assert (pictures[0] == pictures[-1]).all()
    scatter = [p[80:160, 100:220].astype(float).std() for p in pictures[:4]]
    assert scatter[0] > scatter[1] > 0.9 * scatter[3]


def test_lost_strips_show_what_was_there_before() -> None:
    camera = load_camera("webcam")
    lost = camera.quality.strips_lost.model_copy(update={"value": 1.0})
    camera = camera.model_copy(update={"quality": camera.quality.model_copy(update={"strips_lost": lost})})
    renderer = Renderer(camera, make_floor("rich", size=512))
    assert (renderer.render(_motion()) == 128).all()


def test_a_darker_room_is_followed_by_the_exposure() -> None:
    renderer = Renderer(load_camera("webcam"), make_floor("rich", size=512))
    means = []
    for k in range(40):
        m = _motion()
        moved = Motion(k / 30, m.position, STILL, m.attitude, STILL)
        means.append(renderer.render(moved, light=1.0 if k < 5 else 0.4).mean())
    assert means[5] < 0.6 * means[4]
    assert means[-1] > 0.85 * means[4]


def test_a_users_picture_lies_north_up(tmp_path: object) -> None:
    from pathlib import Path

    from PIL import Image

    folder = Path(str(tmp_path))
    a = np.full((64, 64), 50, np.uint8)
    a[:32] = 200  # the upper half is bright
    Image.fromarray(a).save(folder / "floor.png")
    floor = floor_of_picture(folder / "floor.png", 4.0)
    camera = load_camera("webcam")
    north, south = (
        Renderer(camera, floor, perfect=True).render(
            Motion(0.0, np.array([n, 2.0, -0.3]), STILL, np.eye(3), STILL)
        )
        for n in (3.0, 1.0)
    )
    assert north.mean() > 2 * south.mean()
    (folder / "none.png").write_bytes(b"\x89PNG broken")
    with pytest.raises(InputError, match=r"none\.png.*no picture"):
        floor_of_picture(folder / "none.png", 4.0)


def test_faulty_files_are_told_in_a_line(tmp_path: object) -> None:
    from pathlib import Path

    from mufly.slam import camera_toml

    assert "mufly-2.0" in builtin_cameras()
    file = Path(str(tmp_path)) / "c.toml"
    text = camera_toml(load_camera("webcam"))
    file.write_text(text)
    assert load_camera(file).lens.k1.value == -0.22
    file.write_text(text.replace("value = -0.22", "value = -1.9"))
    with pytest.raises(InputError, match="folds the picture over"):
        load_camera(file)
