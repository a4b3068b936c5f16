"""The camera model, floors and the renderer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mufly.camera import (
    FLOOR_KINDS,
    Floor,
    Renderer,
    VehicleMotion,
    body_from_camera_rotation,
    list_builtin_cameras,
    load_camera,
    load_floor_picture,
    make_random_floor,
    project_points,
    unproject_pixels,
)
from mufly.camera.camera_model import camera_matrix, distortion_coefficients
from mufly.dynamics import body_to_ned_matrix
from mufly.errors import InputError
from mufly.logs import LogWarning
from mufly.rotations import quaternion_from_euler
from mufly.slam import format_camera_toml
from mufly.world import Box, World

STILL = np.zeros(3)


def _motion(height: float = 1.0, attitude: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> VehicleMotion:
    turn = body_to_ned_matrix(quaternion_from_euler(*attitude))
    return VehicleMotion(0.0, np.array([0.1, -0.2, -height]), STILL, turn, STILL)


def _chequered() -> Floor:
    """Fields of 128 mm."""
    n = np.arange(2048) // 128
    a = np.where((n[:, None] + n[None, :]) % 2 == 0, 40, 210)
    levels = [a.reshape(2048 >> k, 1 << k, 2048 >> k, 1 << k).mean(axis=(1, 3)).astype(np.uint8) for k in range(5)]
    one = make_random_floor("plain", size=128)
    return Floor("chequered", tuple(levels), (1e-3, 1e-3), one.detail_map, one.shadow_map)


@pytest.mark.parametrize("name", ["mufly-2.0", "webcam"])
def test_rays_undo_the_distortion(name: str) -> None:
    camera = load_camera(name)
    pixels = np.stack(np.meshgrid(np.arange(0, 320, 20.0), np.arange(0, 240, 20.0)), axis=-1)
    assert np.abs(project_points(camera, unproject_pixels(camera, pixels)) - pixels).max() < 1e-8


def test_a_corner_is_where_the_closed_form_has_it() -> None:
    """To 0.05 pixels, through lens, lever arm, tilt and heading."""
    cv2 = pytest.importorskip("cv2")
    camera = load_camera("mufly-2.0")
    floor = _chequered()
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    off = []
    for attitude in ((0.0, 0.0, 0.0), (0.08, -0.06, 0.7)):
        motion = _motion(0.8, attitude)
        picture = Renderer(camera, floor, perfect=True).render_picture(motion)
        axes = motion.attitude @ body_from_camera_rotation(camera)
        here = motion.position + motion.attitude @ camera.mount.place.to_array()[0]
        k = np.arange(-10, 11) * 0.128
        corners = np.array([[n, e, 0.0] for n in k for e in k])
        seen = (corners - here) @ axes
        seen = seen[seen[:, 2] > 0.3]
        pixels = project_points(camera, seen[np.hypot(*(seen[:, :2] / seen[:, 2:]).T) < 0.7])
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
    one = make_random_floor("plain", size=128)
    floor = Floor("halves", (a.astype(np.uint8),), (1e-3, 1e-3), one.detail_map, one.shadow_map)
    quality = camera.quality.model_copy(
        update={"noise": lens.k1, "blur": lens.k1, "shaking": lens.k1, "vignette": lens.k1, "jpeg": 0}
    )
    camera = camera.model_copy(update={"quality": quality})
    motion = VehicleMotion(0.0, np.array([0.0, 1.024, -1.0]), np.array([0.0, 0.5, 0.0]), np.eye(3), STILL)
    picture = Renderer(camera, floor, own_shadow=0.0).render_picture(motion).astype(float)
    middle = 0.5 * (picture.min() + picture.max())
    edge = [np.interp(middle, row[100:220], np.arange(100, 220)) for row in picture]
    lean = np.polyfit(np.arange(240), edge, 1)[0] * 239
    height = 1.0 - camera.mount.place.to_array()[0][2]
    assert lean == pytest.approx(-0.5 * float(camera.shutter.readout) / height * 250, rel=0.05)


def test_boxes_stand_on_the_floor_and_are_nearer() -> None:
    camera, floor = load_camera("webcam"), make_random_floor("plain", size=128)
    box = Box((0.1, -0.2, -0.1), (0.2, 0.3, 0.2))
    without = Renderer(camera, floor, perfect=True).render_picture(_motion())
    with_box = Renderer(camera, _chequered(), World(boxes=(box,)), perfect=True).render_picture(_motion())
    bare = Renderer(camera, _chequered(), perfect=True).render_picture(_motion())
    changed = np.argwhere(with_box != bare)
    assert without.std() < 1.0
    # The top, 0.8 m away less the lever arm, is seen larger than its foot on the floor would be.
    wide = np.ptp(changed[:, 1])
    assert wide == pytest.approx(0.3 / (0.8 - 0.045) * 250, rel=0.08)


def test_same_seed_same_picture_and_floors_differ() -> None:
    camera = load_camera("mufly-2.0")
    pictures = [
        Renderer(camera, make_random_floor(kind, 3, size=512), seed=5).render_picture(_motion())
        for kind in (*FLOOR_KINDS, "rich")
    ]
    assert (pictures[0] == pictures[-1]).all()
    scatter = [p[80:160, 100:220].astype(float).std() for p in pictures[:4]]
    assert scatter[0] > scatter[1] > 0.9 * scatter[3]


def test_lost_strips_show_what_was_there_before() -> None:
    camera = load_camera("webcam")
    lost = camera.quality.strips_lost.model_copy(update={"value": 1.0})
    camera = camera.model_copy(update={"quality": camera.quality.model_copy(update={"strips_lost": lost})})
    renderer = Renderer(camera, make_random_floor("rich", size=512))
    assert (renderer.render_picture(_motion()) == 128).all()


def test_a_darker_room_is_followed_by_the_exposure() -> None:
    renderer = Renderer(load_camera("webcam"), make_random_floor("rich", size=512))
    means = []
    for k in range(40):
        m = _motion()
        moved = VehicleMotion(k / 30, m.position, STILL, m.attitude, STILL)
        means.append(renderer.render_picture(moved, light=1.0 if k < 5 else 0.4).mean())
    assert means[5] < 0.6 * means[4]
    assert means[-1] > 0.85 * means[4]


def test_a_users_picture_lies_north_up(tmp_path: object) -> None:
    from pathlib import Path

    from PIL import Image

    folder = Path(str(tmp_path))
    a = np.full((64, 64), 50, np.uint8)
    a[:32] = 200  # the upper half is bright
    Image.fromarray(a).save(folder / "floor.png")
    floor = load_floor_picture(folder / "floor.png", 4.0)
    camera = load_camera("webcam")
    north, south = (
        Renderer(camera, floor, perfect=True).render_picture(
            VehicleMotion(0.0, np.array([n, 2.0, -0.3]), STILL, np.eye(3), STILL)
        )
        for n in (3.0, 1.0)
    )
    assert north.mean() > 2 * south.mean()
    (folder / "none.png").write_bytes(b"\x89PNG broken")
    with pytest.raises(InputError, match=r"none\.png.*not a picture"):
        load_floor_picture(folder / "none.png", 4.0)


def test_faulty_files_are_told_in_a_line(tmp_path: object) -> None:
    assert "mufly-2.0" in list_builtin_cameras()
    file = Path(str(tmp_path)) / "c.toml"
    text = format_camera_toml(load_camera("webcam"))
    file.write_text(text)
    assert load_camera(file).lens.k1.value == -0.22
    file.write_text(text.replace("value = -0.22", "value = -1.9"))
    with pytest.raises(InputError, match="ambiguous inside the picture"):
        load_camera(file)


KALIBR = """cam0:
  T_cam_imu:
  - [0.01, -0.99, 0.02, 0.1]
  - [0.99, 0.01, 0.03, 0.2]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, -0.0001]
  distortion_model: radtan
  intrinsics: [458.6, 457.3, 367.2, 248.4]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  camera_model: pinhole
  distortion_coeffs: [0, 0, 0, 0]
  distortion_model: radtan
  intrinsics: [1, 2, 3, 4]
  resolution: [10, 10]
"""
ROS = """image_width: 752
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [458.6, 0, 367.2, 0, 457.3, 248.4, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.28, 0.07, 0.0002, -0.0001, 0]
projection_matrix:
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
"""
INFO = """header:
  frame_id: cam
height: 480
width: 752
distortion_model: plumb_bob
d:
- -0.28
- 0.07
- 0.0002
- -0.0001
- 0.0
k:
- 458.6
- 0.0
- 367.2
- 0.0
- 457.3
- 248.4
- 0.0
- 0.0
- 1.0
"""
OPENCV = """%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024"
image_width: 752
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 4.586e+02, 0., 3.672e+02, 0.,
       4.573e+02, 2.484e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.8e-01, 7.0e-02, 2.0e-04,
       -1.0e-04, 0. ]
"""
XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>752</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>458.6 0. 367.2 0. 457.3 248.4 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
  <data>-0.28 0.07 0.0002 -0.0001 0.</data></distortion_coefficients>
</opencv_storage>
"""
EUROC = """#Default imu sensor yaml file
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS:
  cols: 4
  rows: 4
  data: [0.0148655429818, -0.999880929698, 0.00414029679422, -0.0216401454975,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.6, 457.3, 367.2, 248.4] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, -0.0001]
"""
ORB = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 458.6
Camera.fy: 457.3
Camera.cx: 367.2
Camera.cy: 248.4
Camera.k1: -0.28
Camera.k2: 0.07
Camera.p1: 0.0002
Camera.p2: -0.0001
Camera.width: 752
Camera.height: 480
Camera.fps: 20.0
"""
VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 752
image_height: 480
distortion_parameters:
   k1: -0.28
   k2: 0.07
   p1: 0.0002
   p2: -0.0001
projection_parameters:
   fx: 458.6
   fy: 457.3
   cx: 367.2
   cy: 248.4
"""
COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
1 OPENCV 752 480 458.6 457.3 367.7 248.9 -0.28 0.07 0.0002 -0.0001
"""
BASALT = """{"value0": {"T_imu_cam": [{"px": 0.1}], "intrinsics": [{"camera_type": "pinhole", "intrinsics":
{"fx": 458.6, "fy": 457.3, "cx": 367.2, "cy": 248.4}}], "resolution": [[752, 480]]}}"""
CALIBRATIONS = {
    "Kalibr's camchain": KALIBR, "ROS's camera_info": ROS, "OpenCV's calibration": OPENCV, "EuRoC's sensor": EUROC,
    "COLMAP's cameras": COLMAP, "a calibration": ORB, "Basalt's calibration": BASALT,
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "whose"),
    [
        *((text, whose) for whose, text in CALIBRATIONS.items()),
        (INFO, "ROS's"),
        (XML, "OpenCV's"),
        (VINS, ""),
    ],
)
def test_calibrations_of_other_programs_give_the_lens(tmp_path: Path, text: str, whose: str) -> None:
    file = tmp_path / "calibration.yaml"
    file.write_text(text)
    with pytest.warns(LogWarning, match=f"is .*{whose}.*lens and size are read; .* are those of webcam"):
        camera = load_camera(file)
    assert (camera.sensor.width, camera.sensor.height) == (752, 480)
    assert camera_matrix(camera) == pytest.approx(np.array([[458.6, 0, 367.2], [0, 457.3, 248.4], [0, 0, 1]]))
    bent = np.zeros(5) if text is BASALT else np.array([-0.28, 0.07, 0.0002, -0.0001, 0])
    assert distortion_coefficients(camera) == pytest.approx(bent)
    assert float(camera.sensor.period) == pytest.approx(0.05 if text in (EUROC, ORB) else 0.0333)
    back = tmp_path / "camera.toml"  # and a file of ours to change the rest in
    back.write_text(format_camera_toml(camera))
    assert load_camera(back) == camera


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (KALIBR.replace("radtan", "equidistant"), "is Kalibr's camchain with the model 'equidistant'"),
        (KALIBR.replace("pinhole", "ds"), "is Kalibr's camchain with the model 'ds'"),
        (ROS.replace("-0.0001, 0]", "-0.0001, 0, 0.1, 0.2, 0.3]"), "ROS's camera_info with 8 coefficients"),
        (BASALT.replace("pinhole", "kb4"), "is Basalt's calibration with the model 'kb4'"),
        (
            COLMAP.replace("OPENCV", "FULL_OPENCV"),
            "FULL_OPENCV: is a COLMAP model that mufly cannot read",
        ),
        (ROS.replace("image_width", "width_of"), "is not a calibration in a known format, or has no size"),
        ("plain text\nof some kind\n", "is not a calibration in a known format"),
        ("<opencv_storage><a>", "is damaged"),
        ("", "is missing"),
        ("[sensor]\nwidth = = 3\n", "is not valid TOML"),
    ],
)
def test_a_lens_of_another_model_is_refused_by_its_name(tmp_path: Path, text: str, why: str) -> None:
    file = tmp_path / "calibration.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as caught:
        load_camera(file)
    assert why in str(caught.value)
    assert "\n" not in str(caught.value)


def test_low_light_makes_pictures_noisy_smeared_and_dark() -> None:
    """With the light of the file nothing changes; with a third of it exposure and gain make up for it."""
    camera, floor = load_camera("webcam"), make_random_floor("plain", 1, size=1024)
    standing = replace(_motion(), velocity=np.zeros(3), rates=np.zeros(3))

    def render_pair(light: float) -> np.ndarray:
        renderer = Renderer(camera, floor, seed=3)
        return np.array([renderer.render_picture(standing, light) for _ in range(2)], dtype=float)

    level, noise = {}, {}
    for light in (1.0, 0.3, 0.03):
        a, b = render_pair(light)
        level[light], noise[light] = a.mean(), (a - b).std() / np.sqrt(2.0)
    assert level[0.3] == pytest.approx(level[1.0], rel=0.05)
    assert noise[0.3] > 1.3 * noise[1.0]
    assert level[0.03] < 0.2 * level[1.0]
    assert noise[0.03] / level[0.03] > 8.0 * noise[1.0] / level[1.0]
    lit = make_random_floor("rich", 1, size=1024)
    silent = camera.quality.noise.model_copy(update={"value": 0.0})
    clear = camera.model_copy(update={"quality": camera.quality.model_copy(update={"noise": silent})})
    fast = replace(_motion(), velocity=np.array([3.0, 0.0, 0.0]), rates=np.zeros(3))
    sharp, smeared = (
        float(np.abs(np.diff(Renderer(clear, lit, seed=3).render_picture(fast, light).astype(float), axis=0)).mean())
        for light in (1.0, 0.3)
    )
    assert smeared < 0.95 * sharp
